"""The images of a calibration run: a tour with a reflex camera, the boat's camera standing and in motion."""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy.spatial.transform import Rotation

from thalweg.core import (
    ArrayF,
    ArrayF32,
    ArrayI,
    ArrayU8,
    Camera,
    ConfigError,
    Rigid,
    column,
    frame_of,
    steps,
    table_kind,
    write_table,
)
from thalweg_lab.instruments import Lasers
from thalweg_lab.random_numbers import generator
from thalweg_lab.river_images import Sun
from thalweg_lab.settings import TwinConfig, TwinLens
from thalweg_lab.voyage import FieldRun, read_true_mounts, standing, start_gps_s
from thalweg_lab.writers import PhotoFacts, start_us, write_jpeg
from thalweg_lab.yard import (
    Field,
    Yard,
    boat_views,
    build_field,
    field_of,
    field_scene,
    tour,
    with_boat,
    yard_of,
)
from thalweg_lab.yard_images.camera import LensRays, exposed
from thalweg_lab.yard_images.render import Photographer
from thalweg_lab.yard_records import ImageTimes, run_times, static_scan, static_times

KINDS: Final = ("reference", "positions", "run")
"""Sets of images."""
SUN: Final = Sun(azimuth_rad=float(np.deg2rad(205.0)), elevation_rad=float(np.deg2rad(48.0)))
"""Where the sun stands over the yard, behind thin cloud."""
BOAT_IMAGES: Final = 2
"""Last images of the reference, which show the boat at position 1."""
BOAT_SENSOR_MM: Final = 17.3
FULL_FRAME_MM: Final = 36.0
"""Widths of the sensors."""
_TOUR_BEFORE_S: Final = 3600.0
_TOUR_STEP_S: Final = 11.0
IMAGE_TIMES: Final = table_kind(
    "twin_image_times",
    1,
    [
        column("file", "1", "name of the image", pa.string()),
        column("t_true_gps_s", "s", "true middle of the exposure, adjusted standard GPS time"),
        column("stamp_us", "us", "what the camera's clock wrote, microseconds since 1970", pa.int64()),
        column("stamp_error_s", "s", "stamp minus true time in UTC minus what the clock is ahead of UTC"),
        column("clock_minus_utc_s", "s", "what the camera's clock is ahead of UTC"),
        *(column(f"{a}_m", "m", f"{a} of the projection centre, wcs") for a in ("east", "north", "up")),
        *(column(f"q_{a}", "1", f"quaternion of R_wcs_ccs, {a}, scalar last") for a in "xyzw"),
    ],
)

LASERS: Final = Lasers.even(8, 4.0)
"""P2 Fig. 4: eight scan lines, four degrees apart."""
_GREY: Final = np.array([0.299, 0.587, 0.114])
"""Weights of red, green and blue in brightness (ITU-R BT.601)."""


# ---------------------------------------------------------------- images


def true_camera(lens: TwinLens, name: str) -> Camera:
    """The interior orientation of the configuration."""
    w, h = lens.size_px
    x, y = lens.principal_offset_px
    parameters = [lens.focal_px, lens.focal_px, w / 2 + x, h / 2 + y, *lens.distortion]
    return Camera(model=lens.model, size_px=lens.size_px, parameters=np.array(parameters), name=name)


def simulate_field_images(
    config: TwinConfig,
    seed: int,
    kind: str,
    mounts: Mapping[str, Any],
    out_folder: Path,
    out_times: Path,
    *,
    drawn: Sequence[Path] = (),
) -> pd.DataFrame:
    """Take and write one set of images.

    Parameters
    ----------
    config : section ``twin`` with ``field``.
    seed : seed of the campaign.
    kind : ``reference``: ``IMG_0001.jpg`` and so on of the reflex camera, the boat at position 1 in the last
        two; ``positions``: ``position_1.jpg`` and so on; ``run``: one a second, named by the camera's clock.
    mounts : true mounts, with ``camera``, ``lidar`` and ``antenna``.
    out_folder : for the images.
    out_times : true times and poses, table kind ``twin_image_times``.
    drawn : folders of all parts of the images by `draw_field_images`; none: they are drawn here.

    Returns
    -------
    times : as written.

    Raises
    ------
    ConfigError : another kind, or the section ``twin.field`` is missing.
    """
    if kind not in KINDS:
        raise ConfigError(f"images of the kind '{kind}'", expected=f"one of {', '.join(KINDS)}")
    planned = names, times, poses = _planned(config, seed, kind, mounts)
    for folder in drawn:
        shutil.copytree(folder, out_folder, dirs_exist_ok=True)
    if not drawn:
        _draw(config, seed, kind, mounts, planned, out_folder, range(len(poses)))
    place = np.stack([p.shift_m for p in poses])
    q = Rotation.from_matrix(np.stack([p.R for p in poses])).as_quat()
    since_s = times.t_gps_s - start_gps_s(config)
    error = (times.stamp_us - start_us(config)) * 1e-6 - since_s - times.clock_minus_utc_s
    table = frame_of(
        IMAGE_TIMES,
        {
            "file": names,
            "t_true_gps_s": times.t_gps_s,
            "stamp_us": times.stamp_us,
            "stamp_error_s": error,
            "clock_minus_utc_s": times.clock_minus_utc_s,
            **{f"{a}_m": place[:, i] for i, a in enumerate(("east", "north", "up"))},
            **{f"q_{a}": q[:, i] for i, a in enumerate("xyzw")},
        },
    )
    write_table(out_times, table, IMAGE_TIMES, {"kind_of_images": kind})
    return table


def draw_field_images(
    config: TwinConfig, seed: int, kind: str, true_mounts: Path, out_images: Path, *, part: int, parts: int
) -> None:
    """Draw and write one part of a set of images, each ``parts``-th from number ``part`` on.

    ``true_mounts`` is the file of the mounts; all else is that of `simulate_field_images`.
    """
    mounts = read_true_mounts(true_mounts)
    planned = _planned(config, seed, kind, mounts)
    _draw(config, seed, kind, mounts, planned, out_images, range(part, len(planned[0]), parts))


def _draw(
    config: TwinConfig,
    seed: int,
    kind: str,
    mounts: Mapping[str, Any],
    planned: tuple[list[str], ImageTimes, list[Rigid]],
    folder: Path,
    chosen: range,
) -> None:
    """Write the images of those numbers."""
    names, times, poses = planned
    lens = _lens(config, kind)
    folder.mkdir(parents=True, exist_ok=True)
    smears = _smears(config, seed, times, poses, lens) if kind == "run" else [(0.0, 0.0)] * len(poses)
    images = _taken(config, seed, kind, mounts, poses, smears, chosen)
    for k, image in zip(chosen, images, strict=True):
        facts = _facts(config, kind, int(times.stamp_us[k]))
        write_jpeg(folder / names[k], image, facts, quality=92)


def _planned(
    config: TwinConfig, seed: int, kind: str, mounts: Mapping[str, Any]
) -> tuple[list[str], ImageTimes, list[Rigid]]:
    """Names, times and poses of the images of a set."""
    T_ics_ccs = mount_of(mounts["camera"])
    if kind == "reference":
        boat = standing(config, 1).T_wcs_ics
        antenna = boat.apply([mounts["antenna"]["lever_ics_m"]])[0]
        heading = float(np.arctan2(boat.R[0, 0], boat.R[1, 0]))
        reference = config.camera.reference
        poses = [
            *tour(build_field(config, seed), reference, seed),
            *boat_views(reference, antenna, heading, seed),
        ]
        since = _TOUR_STEP_S * np.arange(len(poses), dtype=np.float64) - _TOUR_BEFORE_S
        whole = (start_us(config) // 1_000_000 + np.rint(since).astype(np.int64)) * 1_000_000
        times = ImageTimes(
            t_gps_s=np.asarray(start_gps_s(config) + since),
            stamp_us=whole,
            clock_minus_utc_s=np.zeros(len(poses)),
        )
        return [f"IMG_{k + 1:04d}.jpg" for k in range(len(poses))], times, poses
    if kind == "positions":
        boats = [standing(config, k + 1) for k in range(len(field_of(config).positions))]
        times = static_times(config, seed, np.array([b.start_gps_s for b in boats]))
        poses = [b.T_wcs_ics @ T_ics_ccs for b in boats]
        return [f"position_{k + 1}.jpg" for k in range(len(boats))], times, poses
    run = FieldRun(config, seed)
    times = run_times(config, seed)
    at, R = run.position_wcs_m(times.t_gps_s), run.R_wcs_ics(times.t_gps_s)
    poses = [Rigid(R=R[k], shift_m=at[k]) @ T_ics_ccs for k in range(len(at))]
    return [run_name(int(us)) for us in times.stamp_us], times, poses


def run_name(stamp_us: int) -> str:
    """Name of an image of the run by the reading of the camera's clock.

    Examples
    --------
    >>> run_name(1620808267_042000)
    'R20210512_083107042.jpg'
    """
    moment = pd.Timestamp(stamp_us, unit="us")
    return f"R{moment:%Y%m%d_%H%M%S}{stamp_us % 1_000_000 // 1000:03d}.jpg"


def mount_of(mount: Mapping[str, Any]) -> Rigid:
    """``T_ics_sensor`` of a section of the mounts, without its sigmas."""
    angles = np.deg2rad([float(mount[f"{name}_deg"]) for name in ("omega", "phi", "kappa")])
    return Rigid.from_opk(angles, mount["lever_ics_m"])


def _smears(
    config: TwinConfig, seed: int, times: ImageTimes, poses: Sequence[Rigid], lens: TwinLens
) -> list[tuple[float, float]]:
    """Way of the middle of each image during its exposure, to the right and down, pixels."""
    run = FieldRun(config, seed)
    R_ccs_ics = np.stack([p.R.T for p in poses]) @ run.R_wcs_ics(times.t_gps_s)
    rate = np.einsum("nij,nj->ni", R_ccs_ics, run.rates_ics_radps(times.t_gps_s))
    way = config.camera.exposure_s * lens.focal_px * np.stack([-rate[:, 1], rate[:, 0]], axis=1)
    return [(float(x), float(y)) for x, y in way]


def _taken(
    config: TwinConfig,
    seed: int,
    kind: str,
    mounts: Mapping[str, Any],
    poses: Sequence[Rigid],
    smears: Sequence[tuple[float, float]],
    chosen: range,
) -> Iterator[ArrayU8]:
    """The images of those numbers one after the other."""
    lens = _lens(config, kind)
    rays = LensRays(true_camera(lens, kind), field_of_view_deg=lens.field_of_view_deg)
    # The light on the ground under the boat is taken as that of the yard without it.
    usual = Photographer(yard_of(config, seed, kind), SUN)
    T_ccs_ics = mount_of(mounts["camera"]).inverse()
    for k in steps(chosen, "image"):
        pose, photographer = poses[k], usual
        if kind == "positions" and field_of(config).effects.passers_by:
            photographer = usual.with_yard(yard_of(config, seed, f"position {k + 1}"))
        if kind == "reference" and k >= len(poses) - BOAT_IMAGES:
            boat = standing(config, 1).T_wcs_ics
            photographer = usual.with_yard(with_boat(usual.yard, mounts, boat, camera=True))
        elif kind != "reference" and lens.model == "fisheye":
            yard = with_boat(photographer.yard, mounts, pose @ T_ccs_ics, camera=False)
            photographer = photographer.with_yard(yard)
        seen = photographer.see(rays, pose)
        rng = generator(seed, f"field images {kind} {k}")
        yield exposed(seen.light, lens, rng, smear_px=smears[k])


def _lens(config: TwinConfig, kind: str) -> TwinLens:
    return config.camera.reference if kind == "reference" else config.camera


def _facts(config: TwinConfig, kind: str, stamp_us: int) -> PhotoFacts:
    """EXIF: the reflex camera writes whole seconds of a clock that nobody set to a zone."""
    lens, own = _lens(config, kind), kind != "reference"
    return PhotoFacts(
        model="boat camera" if own else "reflex camera",
        clock_us=stamp_us,
        sub_seconds=3 if own else 0,
        zone="+00:00" if own else None,
        focal_mm=round(lens.focal_px / lens.size_px[0] * (BOAT_SENSOR_MM if own else FULL_FRAME_MM), 1),
        focal_35mm=round(lens.focal_px / lens.size_px[0] * FULL_FRAME_MM),
        exposure_s=config.camera.exposure_s,
    )


# ---------------------------------------------------------------- synthetic image and lidar frame (P2 Fig. 4)


def simulate_synthetic_view(
    config: TwinConfig, seed: int, mounts: Mapping[str, Any], out_view: Path, out_frame: Path
) -> None:
    """Write what camera and lidar see at the first static position.

    Parameters
    ----------
    config : section ``twin`` with ``field``.
    seed : seed of the campaign.
    mounts : true mounts, with ``camera`` and ``lidar``.
    out_view : ``.npz`` with ``height_m`` (h, w), of the cone that a pixel shows above the ground, NaN
        elsewhere, and ``shade`` (h, w) uint8.
    out_frame : Parquet of one revolution: ``x_m, y_m, z_m`` in wcs, ``ring``, ``on_cone``.
    """
    T_wcs_ics = standing(config, 1).T_wcs_ics
    camera = true_camera(config.camera, "boat")
    view = synthetic_view(build_field(config, seed), camera, T_wcs_ics @ mount_of(mounts["camera"]), SUN)
    height = np.append(view.height_m, np.nan)[view.cone]
    out_view.parent.mkdir(parents=True, exist_ok=True)
    shade = np.rint(view.image @ _GREY).astype(np.uint8)
    np.savez_compressed(out_view, height_m=height.astype(np.float32), shade=shade)
    lidar = mount_of(mounts["lidar"])
    scan = static_scan(
        config,
        seed,
        1,
        R_ics_scs=lidar.R,
        lever_ics_scs_m=lidar.shift_m,
        lasers=LASERS,
        near_cones_m=None,
        revolutions=1,
    )
    points = (T_wcs_ics @ Rigid(R=lidar.R, shift_m=lidar.shift_m)).apply(scan.points_scs_m)
    table = pd.DataFrame(points, columns=["x_m", "y_m", "z_m"])
    table.assign(ring=scan.ring, on_cone=scan.cone >= 0).to_parquet(out_frame, index=False)


# ---------------------------------------------------------------- a clean picture of the cones (P2 Fig. 4a)


@dataclass(frozen=True, slots=True, kw_only=True)
class SyntheticView:
    """A picture and what it shows.

    Parameters
    ----------
    image : (h, w, 3) uint8, sRGB; black outside the image circle of a fisheye.
    cone : (h, w) index of the cone that a pixel meets, -1 elsewhere.
    height_m : (cones,) height of the middle of each cone above the ground.
    range_m : (h, w) distance, infinite where nothing was met.
    """

    image: ArrayU8
    cone: ArrayI
    height_m: ArrayF
    range_m: ArrayF32


def synthetic_view(field: Field, camera: Camera, T_wcs_ccs: Rigid, sun: Sun) -> SyntheticView:
    """A clean picture of the field, without noise and without the printed markers.

    Parameters
    ----------
    field : the yard.
    camera : of any model.
    T_wcs_ccs : its pose.
    sun : the light.
    """
    yard = Yard.of(field_scene(field), ())
    heights = np.array([cone.middle_wcs_m[2] for cone in field.cones])
    seen = Photographer(yard, sun).see(LensRays(camera, field_of_view_deg=190.0), T_wcs_ccs)
    number = np.full(len(yard.names) + 1, -1, dtype=np.int64)
    number[[yard.names.index(cone.name) for cone in field.cones]] = np.arange(len(field.cones))
    lens = TwinLens(noise=0.0, sharpness_px=0.4)
    image = exposed(seen.light, lens, np.random.default_rng(0))
    return SyntheticView(image=image, cone=number[seen.thing], height_m=heights, range_m=seen.range_m)
