"""A camera with two fisheye lenses: its pictures of the river and of a room of markers, and its truth.

The device has true lenses, their places, and both image circles in a file. The room of marker sheets around
it is the cubic field of T 2.2.2, with its survey and its pictures. Recorded are the files of the survey and
of the room, the survey of the room, and the truth apart.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.calibration import SADDLES_MODULES, SHEET_MODULES, MarkerLayout
from thalweg.calibration.field import FieldPoints
from thalweg.core import (
    ArrayF,
    ArrayF32,
    ArrayI,
    ArrayU8,
    Camera,
    LocalFrame,
    Rigid,
    exp_rotation,
    steps,
    write_marked,
)
from thalweg.images.model import ImagePoses
from thalweg.settings.sections import Rig as RigSettings
from thalweg.settings.twin import TwinConfig, TwinDualFisheye, TwinLens
from thalweg_lab.random_numbers import generator
from thalweg_lab.river import Scene, Waves
from thalweg_lab.river_images import Sun
from thalweg_lab.time_lapse import OwnBoat, Renderer, World, metered_exposure, sun_of
from thalweg_lab.voyage import Voyage, true_mounts
from thalweg_lab.writers import PhotoFacts, start_us, write_jpeg
from thalweg_lab.yard import Plane, Sheet, Yard
from thalweg_lab.yard_images import LensRays, Photographer, exposed, mount_of, run_name

# ---------------------------------------------------------------- the device

LENSES: Final = ("front", "back")
_SCATTER: Final = np.array([1e-3, 1e-3, 5e-4, 1e-4])
"""Scatter of the distortion of single lenses of one kind."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueRig:
    """The rig as it really is.

    Parameters
    ----------
    settings : section ``twin.dual_fisheye``.
    cameras : interior orientation by lens.
    T_back_front : relative orientation.
    """

    settings: TwinDualFisheye
    cameras: dict[str, Camera]
    T_back_front: Rigid

    @property
    def T_front_lens(self) -> dict[str, Rigid]:
        """Place of each lens in the frame of the front lens."""
        return {"front": Rigid(R=np.eye(3), shift_m=np.zeros(3)), "back": self.T_back_front.inverse()}

    @property
    def centre_front_m(self) -> ArrayF:
        """(3,) middle of both projection centres in the frame of the front lens."""
        return np.asarray(self.T_front_lens["back"].shift_m / 2)

    def rays(self) -> dict[str, LensRays]:
        """Ray of each pixel of both upright views."""
        return {
            name: LensRays(camera, field_of_view_deg=self.settings.field_of_view_deg)
            for name, camera in self.cameras.items()
        }

    def facts(self) -> dict[str, Any]:
        """Plain values for the truth."""
        return {
            "base_m": float(np.linalg.norm(self.T_back_front.shift_m)),
            "axes_deg": float(np.rad2deg(np.arccos(self.T_back_front.R[2, 2]))),
            "T_back_front": self.T_back_front.matrix.tolist(),
            "lenses": {
                name: dict(zip(camera.parameter_names, camera.parameters.tolist(), strict=True))
                for name, camera in self.cameras.items()
            },
        }

    def file_of(self, light: dict[str, ArrayF32], rng: np.random.Generator, exposure: float) -> ArrayU8:
        """Both image circles (h, 2 h, 3) as the device stores them, from light (h, h, 3) by lens."""
        s = self.settings
        lens = TwinLens(
            model="fisheye",
            size_px=(s.circle_px, s.circle_px),
            distortion=s.distortion,
            sharpness_px=s.sharpness_px,
            noise=s.noise,
        )
        views = {}
        for name in LENSES:
            rim = self._rim(name)
            gain = exposure * (s.back_exposure if name == "back" else 1.0)
            views[name] = exposed(light[name] * rim[..., None], lens, rng, exposure=gain)
            # what no ray reaches stays dark but for the sensor's noise
        if s.lens_missing:
            views["back"] = np.zeros_like(views["back"])
        turned = np.rot90(views["back"], s.back_turn_deg // 90)
        boxes = [turned, views["front"]] if s.lenses_swapped else [views["front"], turned]
        return np.ascontiguousarray(np.concatenate(boxes, axis=1))

    def _rim(self, name: str) -> ArrayF32:
        """Share of the light (h, h) that the lens lets through at each pixel."""
        n, camera = self.settings.circle_px, self.cameras[name]
        y, x = np.mgrid[0:n, 0:n] + 0.5
        off = np.hypot(x - camera.parameters[2], y - camera.parameters[3]) / (n / 2)
        return np.asarray(1.0 - self.settings.vignetting * np.minimum(off, 1.0) ** 2, dtype=np.float32)


def true_rig(settings: TwinDualFisheye, seed: int) -> TrueRig:
    """The rig of a seed: both lenses, the base along the view of the front lens, the tilt of the axes."""
    rng = generator(seed, "dual fisheye")
    n = settings.circle_px
    offset = np.asarray(settings.principal_offset_px)
    cameras = {}
    for name, sign, more in (("front", 1.0, 0.0), ("back", -1.0, settings.focal_difference_px)):
        f = settings.focal_px + more
        shape = np.asarray(settings.distortion) + _SCATTER * rng.standard_normal(4) * 0.2
        cameras[name] = Camera(
            model="fisheye",
            size_px=(n, n),
            parameters=np.array([f, f, n / 2 + sign * offset[0], n / 2 + sign * offset[1], *shape]),
            name=name,
        )
    # the axes miss 180 degrees about an axis across the view that chance gives; the views are upright alike
    azimuth = rng.uniform(0, 2 * np.pi)
    tilt = np.deg2rad(180.0 - settings.axes_deg) * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    roll = np.array([0.0, 0.0, np.deg2rad(0.15) * rng.standard_normal()])
    R_back_front = exp_rotation(tilt) @ exp_rotation(roll) @ np.diag([-1.0, 1.0, -1.0])
    # the back lens sits behind the front lens, a little beside its axis
    beside = 0.0003 * rng.standard_normal(2)
    back_in_front = np.array([*beside, 0.0])
    back_in_front[2] = -np.sqrt(settings.base_m**2 - float(beside @ beside))
    return TrueRig(
        settings=settings,
        cameras=cameras,
        T_back_front=Rigid(R=R_back_front, shift_m=-R_back_front @ back_in_front),
    )


# ---------------------------------------------------------------- the room

MODULE_M: Final = 0.035
LAYOUT: Final = MarkerLayout(module_m=MODULE_M)
HALF_M: Final = 1.3
HEIGHT_M: Final = 2.4
_SUN: Final = Sun(azimuth_rad=float(np.deg2rad(130.0)), elevation_rad=float(np.deg2rad(60.0)))
_EACH_WAY: Final = 4
_MIDDLE_M: Final = np.array([0.0, 0.0, HEIGHT_M / 2])
_AMID_M: Final = np.array([0.65, 0.65, 0.5])
"""How far from the middle the rig is held: near walls tell its base from the lenses."""


def room_sheets() -> tuple[Sheet, ...]:
    """Sheets on the floor and on four walls, four by four on each; there is no ceiling."""
    faces = {"board floor": np.array([0.0, 0.0, -1.0])}
    for k, name in enumerate(("east", "north", "west", "south")):
        angle = k * np.pi / 2
        faces[f"board {name}"] = np.array([np.cos(angle), np.sin(angle), 0.0])
    sheets, marker = [], 0
    for thing, into in faces.items():
        down = np.array([0.0, -1.0, 0.0]) if into[2] < 0 else np.array([0.0, 0.0, -1.0])
        middle = _MIDDLE_M + into * (HEIGHT_M / 2 if into[2] < 0 else HALF_M)
        plane = Plane(origin_wcs_m=middle, right_wcs=np.cross(down, into), down_wcs=down)
        across, along = 2 * HALF_M / _EACH_WAY, (2 * HALF_M if into[2] < 0 else HEIGHT_M) / _EACH_WAY
        for i in range(_EACH_WAY):
            for j in range(_EACH_WAY):
                place = ((j - (_EACH_WAY - 1) / 2) * across, (i - (_EACH_WAY - 1) / 2) * along)
                sheets.append(
                    Sheet(marker=marker, module_m=MODULE_M, thing=thing, surface=plane, place=place)
                )
                marker += 1
    return tuple(sheets)


def room_points(seed: int, sigma_m: float) -> tuple[FieldPoints, ArrayF]:
    """The survey of the room's saddles with errors of a standard deviation, and where they are (n, 3)."""
    sheets = room_sheets()
    keys = tuple((sheet.marker, corner) for sheet in sheets for corner in range(4))
    true = np.concatenate([sheet.to_wcs(SADDLES_MODULES) for sheet in sheets])
    error = sigma_m * generator(seed, "room survey").standard_normal(true.shape)
    cov = sigma_m**2 * np.eye(3 * len(true))
    return FieldPoints(points=keys, points_pcs=true + error, cov=cov), true


def room_poses(seed: int, n: int) -> list[Rigid]:
    """Poses of the front lens amid the room: views all around, turned about them by quarters."""
    rng = generator(seed, "room poses")
    poses = []
    for k in range(n):
        heading, pitch = 2 * np.pi * k / n + rng.normal(0, 0.2), rng.uniform(-0.5, 0.5)
        view = np.array([np.cos(heading) * np.cos(pitch), np.sin(heading) * np.cos(pitch), np.sin(pitch)])
        right = np.cross(view, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        level = np.stack([right, np.cross(view, right), view], axis=1)
        roll = exp_rotation(np.array([0.0, 0.0, k % 4 * np.pi / 2 + rng.normal(0, 0.1)]))
        poses.append(Rigid(R=level @ roll, shift_m=_MIDDLE_M + rng.uniform(-1, 1, 3) * _AMID_M))
    return poses


def room_photographer() -> Photographer:
    """The room in daylight."""
    sheets = room_sheets()
    vertices, triangles, things, names = [], [], [], []
    for number, thing in enumerate(dict.fromkeys(sheet.thing for sheet in sheets)):
        plane = next(sheet.surface for sheet in sheets if sheet.thing == thing)
        assert isinstance(plane, Plane)
        high = HALF_M if thing == "board floor" else HEIGHT_M / 2
        corners = [(-HALF_M, -high), (HALF_M, -high), (HALF_M, high), (-HALF_M, high)]
        first = 4 * number
        vertices += [plane.origin_wcs_m + a * plane.right_wcs + b * plane.down_wcs for a, b in corners]
        triangles += [(first, first + 2, first + 1), (first, first + 3, first + 2)]
        things += [number, number]
        names.append(thing)
    yard = Yard(
        vertices_wcs_m=np.array(vertices),
        triangles=np.array(triangles, dtype=np.int64),
        things=np.array(things, dtype=np.int64),
        names=tuple(names),
        sheets=sheets,
        layout=LAYOUT,
    )
    return Photographer(yard, _SUN)


def room_marks(
    rig: TrueRig, seed: int, n: int, *, sigma_px: float, least_px: float = 1.6
) -> tuple[pd.DataFrame, list[Rigid]]:
    """Marks of the room as a detector would measure them, without pictures, and the poses (for studies).

    Parameters
    ----------
    rig : the true one.
    seed, n : of the poses, and how many exposures.
    sigma_px : noise of each coordinate.
    least_px : a sheet counts if a module is so large in the picture.

    Returns
    -------
    As `thalweg.calibration.detect_rig_marks` gives them.
    """
    rng = generator(seed, "room marks")
    sheets, poses = room_sheets(), room_poses(seed, n)
    widest = np.cos(np.deg2rad(rig.settings.field_of_view_deg) / 2)
    rows = []
    for k, pose in enumerate(poses):
        for name in LENSES:
            T = (pose @ rig.T_front_lens[name]).inverse()
            for sheet in sheets:
                local = T.apply(sheet.to_wcs(SADDLES_MODULES))
                if (local[:, 2] / np.linalg.norm(local, axis=1) < widest).any():
                    continue
                xy = rig.cameras[name].project(local)
                sides = np.linalg.norm(xy - np.roll(xy, 1, axis=0), axis=1) / (SHEET_MODULES - 2)
                if not sides.min() > least_px or not rig.cameras[name].inside(xy, 3.0).all():
                    continue
                seen = xy + sigma_px * rng.standard_normal(xy.shape)
                for corner in range(4):
                    file = f"{k:03d}.jpg"
                    rows.append(
                        (f"{name}/{file}", file, name, sheet.marker, corner, *seen[corner], sigma_px, 8.0)
                    )
    columns = ["image", "file", "camera", "marker", "corner", "x_px", "y_px", "sigma_px", "size_px"]
    return pd.DataFrame(rows, columns=columns), poses


KIND: Final = "thalweg twin dual fisheye"
_SENSOR_MM: Final = 6.2
_FULL_FRAME_MM: Final = 36.0
_FIELD_DAY_S: Final = 86_400
"""The room was photographed the day before."""


def offset_of(zone: str) -> float:
    """Seconds of a zone such as ``+02:00``."""
    hours, minutes = zone[1:].split(":")
    return (1 if zone[0] == "+" else -1) * (3600.0 * int(hours) + 60.0 * int(minutes))


def simulate_dual_fisheye(
    config: TwinConfig,
    settings: TwinDualFisheye,
    seed: int,
    frame: LocalFrame,
    scene: Path,
    mounts: Mapping[str, Any],
    rig: RigSettings,
    *,
    images: Path,
    field_images: Path,
    field: Path,
    field_points: Path,
    poses: Path,
    panorama: Path,
    truth: Path,
) -> None:
    """Write the files of the survey and of the calibration, and the truth.

    Parameters
    ----------
    config, settings : sections ``twin`` and ``twin.dual_fisheye``.
    seed : seed of the campaign.
    frame : local frame; says where the sun stands.
    scene : written by `simulate_scene`.
    mounts : true mounts of the boat's other sensors.
    rig : section ``rig``: the mount that the true one is drawn about.
    images, field_images : folders of files by the local time in ms.
    field, field_points : description of the room's markers, and their survey.
    poses : true poses of the front lens, table kind ``image_poses``.
    panorama : ``.npz``: what is seen from the centre of the rig at the middle exposure: ``light`` (h, w, 3),
        ``range_m`` (h, w), and its pose; level, as `thalweg.panorama` has it.
    truth : true interiors, relative orientation, mount and times, JSON.
    """
    device = true_rig(settings, seed)
    mount = true_mounts({"rig": rig.mount.model_dump()}, seed, on=config.effects.mount_errors)["rig"]
    T_ics_front = mount_of(mount)
    voyage = Voyage(config, seed)
    released, exposed_s, ahead, stamp_us = _times(config, settings, seed)
    at = voyage.start_gps_s + exposed_s
    place, R = voyage.position_wcs_m(at), voyage.R_wcs_ics(at)
    fronts = [Rigid(R=R[k], shift_m=place[k]) @ T_ics_front for k in range(len(at))]
    world = World(Scene.read(scene), None, sun_of(config, frame))
    waves = Waves.draw(seed, rms_slope=config.lidar.wave_slope)
    renderers = {}
    for name, rays in device.rays().items():
        T_ics_lens = T_ics_front @ device.T_front_lens[name]
        boat = (
            OwnBoat.seen(rays, mounts, T_ics_lens, waterline_m=config.boat.height_m)
            if settings.hull
            else None
        )
        renderers[name] = Renderer(
            world, rays, waves=waves, boat=boat, glare=False, supersampling=settings.supersampling
        )
    zone_us = int(1e6 * offset_of(settings.zone))
    names = [run_name(stamp + zone_us) for stamp in stamp_us.tolist()]
    for k in steps(range(len(at)), "exposure"):
        light: dict[str, ArrayF32] = {}
        for name in LENSES:
            pose = fronts[k] @ device.T_front_lens[name]
            light[name] = renderers[name].see(pose, R[k], t_s=float(exposed_s[k]), grain=k + 1)
        picture = device.file_of(
            light, generator(seed, f"dual fisheye {k}"), metered_exposure(light["front"][160:-160, 160:-160])
        )
        write_jpeg(
            images / names[k],
            picture,
            _facts(settings, int(stamp_us[k]) + zone_us),
            quality=settings.jpeg_quality,
        )
    _write_room(device, seed, config, field_images, field, field_points)
    _write_poses(poses, names, at, fronts, frame)
    _write_panorama(panorama, world, waves, fronts[len(at) // 2], device, exposed_s[len(at) // 2])
    write_marked(
        truth,
        kind=KIND,
        version=1,
        content={
            "rig": device.facts(),
            "mount": mount,
            "images": [
                {"file": name, "t_gps_s": float(t), "clock_minus_utc_s": float(c), "stamp_error_s": float(e)}
                for name, t, c, e in zip(names, at, ahead, exposed_s - released, strict=True)
            ],
        },
    )


def _times(config: TwinConfig, settings: TwinDualFisheye, seed: int) -> tuple[ArrayF, ArrayF, ArrayF, ArrayI]:
    """Release and exposure since the begin of the survey, what the clock is ahead, its stamps in us."""
    rng = generator(seed, "dual fisheye shutter")
    n = settings.images
    released = np.asarray(config.duration_s / 2 + (np.arange(n) - (n - 1) / 2) / settings.rate_hz)
    exposed_s: ArrayF = released + settings.jitter_s * rng.standard_normal(n)
    ahead: ArrayF = settings.clock_offset_s + 1e-6 * settings.clock_drift_ppm * released
    stamp_us = 1000 * np.rint((released + ahead) * 1e3 + start_us(config) * 1e-3).astype(np.int64)
    return released, exposed_s, ahead, stamp_us


def _facts(settings: TwinDualFisheye, clock_us: int) -> PhotoFacts:
    wide = settings.focal_px / settings.circle_px
    return PhotoFacts(
        model="dual fisheye",
        clock_us=clock_us,
        sub_seconds=0,
        zone=None,
        focal_mm=round(wide * _SENSOR_MM, 1),
        focal_35mm=round(wide * _FULL_FRAME_MM),
    )


def _write_room(
    device: TrueRig, seed: int, config: TwinConfig, folder: Path, field: Path, field_points: Path
) -> None:
    settings = device.settings
    points, _ = room_points(seed, settings.sigma_field_m)
    field.parent.mkdir(parents=True, exist_ok=True)
    points.table().to_csv(field_points, index=False, float_format="%.6f", lineterminator="\n")
    field.write_text(
        "# A room of marker sheets around the rig.\nthalweg_field: 1\n"
        f"markers: {{dictionary: {LAYOUT.dictionary}, module_m: {LAYOUT.module_m}}}\n"
    )
    photographer, rays = room_photographer(), device.rays()
    begin = start_us(config) - 1_000_000 * _FIELD_DAY_S + int(1e6 * offset_of(settings.zone))
    for k, pose in enumerate(room_poses(seed, settings.field_images)):
        light = {
            name: photographer.see(rays[name], pose @ device.T_front_lens[name]).light for name in LENSES
        }
        picture = device.file_of(light, generator(seed, f"dual fisheye room {k}"), 1.3)
        stamp = begin + 5_000_000 * k
        write_jpeg(folder / run_name(stamp), picture, _facts(settings, stamp), quality=settings.jpeg_quality)


def _write_poses(path: Path, names: list[str], at: ArrayF, fronts: list[Rigid], frame: LocalFrame) -> None:
    n = len(names)
    ImagePoses(
        frame=frame,
        images=tuple(names),
        t_gps_s=np.asarray(at),
        sigma_t_s=np.zeros(n),
        oriented=np.ones(n, dtype=np.bool_),
        reasons=("",) * n,
        centre_wcs_m=np.array([pose.shift_m for pose in fronts]).reshape(n, 3),
        R_wcs_ccs=np.array([pose.R for pose in fronts]).reshape(n, 3, 3),
        cov_pose_wcs=np.zeros((n, 6, 6)),
        cov_next=np.zeros((n, 6, 6)),
        n_marks=np.zeros(n),
        rms_px=np.full(n, np.nan),
        facts={"source": "digital twin, true poses of the front lens"},
    ).write(path)


class _Sphere(LensRays):
    """Rays of an equirectangular picture, see `thalweg.panorama`."""

    def __init__(self, width_px: int) -> None:
        from thalweg.panorama import sphere_rays

        self.rays_ccs = sphere_rays(width_px).astype(np.float32)


def _write_panorama(
    path: Path, world: World, waves: Waves, front: Rigid, device: TrueRig, since_s: float
) -> None:
    """What is seen from the middle of the rig, by ray casting."""
    from thalweg.panorama import default_width_px, level_attitude

    pose = Rigid(R=level_attitude(front.R), shift_m=front.apply(device.centre_front_m[None])[0])
    rays = _Sphere(default_width_px(device.cameras["front"]))
    renderer = Renderer(world, rays, waves=waves, boat=None, glare=False)
    light = renderer.see(pose, np.eye(3), t_s=float(since_s), grain=1)
    way = rays.rays_ccs.reshape(-1, 3) @ pose.R.T.astype(np.float32)
    range_m = world.caster.cast(pose.shift_m, way).t_hit_m.reshape(light.shape[:2])
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        path, light=light.astype(np.float16), range_m=range_m.astype(np.float32), T_wcs_pano=pose.matrix
    )
