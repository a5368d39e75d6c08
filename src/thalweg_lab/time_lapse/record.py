"""The recording: images, control points' survey, and the truth apart."""

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core import (
    ArrayF,
    ArrayF32,
    ArrayU8,
    Camera,
    ConfigError,
    GeometryError,
    LocalFrame,
    Rigid,
    steps,
)
from thalweg_lab.random_numbers import generator
from thalweg_lab.reach import River
from thalweg_lab.river import Material, Scene, Waves, metered
from thalweg_lab.river_images import Sun
from thalweg_lab.settings import TwinConfig, TwinLens, TwinTimeLapse
from thalweg_lab.time_lapse.foreground import OwnBoat, Targets, place_targets
from thalweg_lab.time_lapse.renderer import Renderer, World
from thalweg_lab.voyage import Voyage, read_true_mounts, start_unix
from thalweg_lab.writers import PhotoFacts, true_poses, write_jpeg
from thalweg_lab.yard_images import (
    BOAT_SENSOR_MM,
    FULL_FRAME_MM,
    LensRays,
    exposed,
    mount_of,
    run_name,
    true_camera,
)
from thalweg_lab.yard_records import clock_minus_utc_s, run_times

# ---------------------------------------------------------------- which images the boat's camera takes:
# times, names, true poses, smear


_USUAL_WAY_M: Final = 12.0
"""Distance of the bank for the smear by the boat's speed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """One exposure.

    Parameters
    ----------
    name : of the file.
    t_gps_s : true middle of the exposure, adjusted standard GPS time.
    since_s : the same after the begin of the lidar log.
    stamp_us : reading of the camera's clock, microseconds since 1970, whole milliseconds.
    T_wcs_ccs : true pose.
    smear_px : way of the image over the sensor during the exposure, to the right and down.
    """

    name: str
    t_gps_s: float
    since_s: float
    stamp_us: int
    T_wcs_ccs: Rigid
    smear_px: tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """All exposures in order of time; ``lens`` with its sharpness, ``camera`` its geometry."""

    shots: tuple[Shot, ...]
    lens: TwinLens
    camera: Camera

    @property
    def poses(self) -> list[Rigid]:
        """True poses of all exposures."""
        return [shot.T_wcs_ccs for shot in self.shots]


def scaled_lens(lens: TwinLens, size_px: tuple[int, int]) -> TwinLens:
    """The lens with pixels of another size, as if the camera stored smaller images of its full width.

    Where the heights do not agree in proportion, upper and lower rims are cut or added alike.
    """
    scale = size_px[0] / lens.size_px[0]
    x, y = lens.principal_offset_px
    changes = {
        "size_px": size_px,
        "focal_px": lens.focal_px * scale,
        "principal_offset_px": (x * scale, y * scale),
    }
    return TwinLens(**{name: getattr(lens, name) for name in TwinLens.model_fields} | changes)


def plan_images(config: TwinConfig, time_lapse: TwinTimeLapse, seed: int, mounts: Mapping[str, Any]) -> Plan:
    """Times and poses of the images of a voyage.

    Parameters
    ----------
    config : section ``twin``.
    time_lapse : section ``twin.time_lapse``.
    seed : seed of the campaign.
    mounts : true mounts with ``camera``.

    Raises
    ------
    ConfigError : the mounts hold no camera, or the share leaves no image.
    """
    if "camera" not in mounts:
        raise ConfigError(
            f"true mounts of {', '.join(mounts)} only",
            expected="the mount of the camera",
            where="mounts.camera",
            cure="State mounts.camera in the campaign file, or take a calibration that has it",
        )
    voyage = Voyage(config, seed)
    lens = scaled_lens(config.camera, time_lapse.size_px)
    timed = config.camera.model_copy(update={"rate_hz": time_lapse.rate_hz})
    times = run_times(config.model_copy(update={"camera": timed}), seed)
    since = times.t_gps_s - voyage.start_gps_s
    n = int(np.sum(since <= time_lapse.share * config.duration_s))
    if n == 0:
        raise ConfigError(
            f"no image in {time_lapse.share:g} of {config.duration_s:g} s",
            expected="at least one image",
            where="twin.time_lapse.share",
            cure="Raise share or rate_hz",
        )
    at = times.t_gps_s[:n]
    place, R = voyage.position_wcs_m(at), voyage.R_wcs_ics(at)
    T_ics_ccs = mount_of(mounts["camera"])
    poses = [Rigid(R=R[k], shift_m=place[k]) @ T_ics_ccs for k in range(n)]
    smears = _smears(voyage, at, poses, T_ics_ccs.shift_m, config.camera.exposure_s * lens.focal_px)
    shots = tuple(
        Shot(
            name=run_name(stamp),
            t_gps_s=float(at[k]),
            since_s=float(since[k]),
            stamp_us=stamp,
            T_wcs_ccs=poses[k],
            smear_px=smears[k],
        )
        for k, stamp in enumerate(times.stamp_us[:n].tolist())
    )
    return Plan(shots=shots, lens=lens, camera=true_camera(lens, "boat"))


def _smears(
    voyage: Voyage, at: ArrayF, poses: list[Rigid], lever_ics_m: ArrayF, scale_px_s: float
) -> list[tuple[float, float]]:
    """Way of what is 12 m before the camera during its exposure, to the right and down, pixels."""
    to_ccs = np.stack([p.R.T for p in poses])
    rate = np.einsum("nij,nj->ni", to_ccs @ voyage.R_wcs_ics(at), voyage.rates_ics_radps(at))
    speed = np.einsum("nij,nj->ni", to_ccs, voyage.sensor_velocity_wcs_mps(at, lever_ics_m))
    across = -rate[:, 1] - speed[:, 0] / _USUAL_WAY_M
    down = rate[:, 0] - speed[:, 1] / _USUAL_WAY_M
    return [(scale_px_s * float(x), scale_px_s * float(y)) for x, y in zip(across, down, strict=True)]


# ---------------------------------------------------------------- the survey of the control points as a user
# would bring it, and the truth about points and camera


KIND: Final = "thalweg twin time lapse"
"""Kind of the JSON file of the truth."""

_AXES: Final = ("east", "north", "up")


def surveyed(targets: Targets, settings: TwinTimeLapse, seed: int) -> pd.DataFrame:
    """The table of control points.

    Columns ``id``, ``east_m``, ``north_m``, ``up_m`` in wcs, ``sigma_east_m``, ``sigma_north_m``,
    ``sigma_up_m``, ``role`` (``control`` or ``check``).
    """
    n = len(targets.names)
    sigma = np.asarray(settings.sigma_target_m)
    error = sigma * generator(seed, "control points survey").standard_normal((n, 3))
    place = np.round(targets.centre_wcs_m + error, 4)
    columns: dict[str, Any] = {"id": list(targets.names)}
    columns |= {f"{axis}_m": place[:, i] for i, axis in enumerate(_AXES)}
    columns |= {f"sigma_{axis}_m": np.full(n, sigma[i]) for i, axis in enumerate(_AXES)}
    columns["role"] = np.where(targets.check, "check", "control")
    return pd.DataFrame(columns)


def write_survey(path: Path, table: pd.DataFrame) -> None:
    """Write the table of `surveyed` as CSV, coordinates to a tenth of a millimetre."""
    path.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(path, index=False, float_format="%.4f", lineterminator="\n")


def write_poses(path: Path, plan: Plan, frame: LocalFrame) -> None:
    """True poses and times of all images, table kind ``image_poses`` with covariances of zero."""
    names, t_gps_s = [shot.name for shot in plan.shots], [shot.t_gps_s for shot in plan.shots]
    true_poses(names, t_gps_s, plan.poses, frame, "digital twin, true poses").write(path)


def write_truth(path: Path, plan: Plan, targets: Targets, clock: ArrayF) -> None:
    """True interior orientation, true control points and times of images, as JSON.

    Parameters
    ----------
    path : target.
    plan : of the images.
    targets : the boards.
    clock : (n,) what the camera's clock was ahead of UTC at each exposure, seconds.
    """
    camera = plan.camera
    facts = {
        "kind": KIND,
        "version": 1,
        "camera": {
            "model": camera.model,
            "size_px": list(camera.size_px),
            "parameters": dict(zip(camera.parameter_names, camera.parameters.tolist(), strict=True)),
        },
        "target_size_m": targets.size_m,
        "targets": [
            {
                "id": name,
                "role": "check" if check else "control",
                **{f"{axis}_m": float(place[i]) for i, axis in enumerate(_AXES)},
                "normal_wcs": normal.tolist(),
                "right_wcs": right.tolist(),
                "images": int(seen),
            }
            for name, check, place, normal, right, seen in zip(
                targets.names,
                targets.check.tolist(),
                targets.centre_wcs_m,
                targets.normal_wcs,
                targets.right_wcs,
                targets.seen,
                strict=True,
            )
        ],
        "images": [
            {
                "file": shot.name,
                "t_gps_s": shot.t_gps_s,
                "stamp_us": shot.stamp_us,
                "clock_minus_utc_s": float(ahead),
            }
            for shot, ahead in zip(plan.shots, clock, strict=True)
        ],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(facts, indent=1) + "\n")


# ---------------------------------------------------------------- record


_FALLBACK_SUN: Final = Sun(azimuth_rad=float(np.deg2rad(150.0)), elevation_rad=float(np.deg2rad(42.0)))
"""For campaigns at night."""

_LOW_SUN_RAD: Final = float(np.deg2rad(8.0))
_METERED: Final = 2.3 * 0.85
"""The exposure of `metered` is for light that becomes white at 1; here that is 2.3, in another tone curve."""

_EXPOSURES: Final = (0.4, 2.5)


@dataclass(frozen=True)
class TimeLapse:
    """Everything that the images of a campaign are made from.

    Parameters
    ----------
    config, settings : sections ``twin`` and ``twin.time_lapse``.
    seed : seed of the campaign.
    frame : local frame; says where the sun stands.
    scene : the twin's world.
    mounts : true mounts, with ``camera``.
    plan : exposures and lens.
    targets : boards on the bank.
    """

    config: TwinConfig
    settings: TwinTimeLapse
    seed: int
    frame: LocalFrame
    scene: Scene
    mounts: Mapping[str, Any]
    plan: Plan
    targets: Targets

    @classmethod
    def of(
        cls,
        config: TwinConfig,
        settings: TwinTimeLapse,
        seed: int,
        frame: LocalFrame,
        scene: Scene,
        mounts: Mapping[str, Any],
    ) -> "TimeLapse":
        """Plan the images and place the boards.

        Parameters
        ----------
        config, settings : sections ``twin`` and ``twin.time_lapse``.
        seed : seed of the campaign.
        frame : local frame.
        scene : the twin's world.
        mounts : true mounts, with ``camera``.

        Raises
        ------
        ConfigError : no mount of the camera, no image, or no places for the control points.
        """
        plan = plan_images(config, settings, seed, mounts)
        bare = scene.without(Material.WATER).caster()
        targets = place_targets(River(config.scene, seed), bare, plan.camera, plan.poses, settings, seed)
        return cls(config, settings, seed, frame, scene, mounts, plan, targets)

    @cached_property
    def renderer(self) -> Renderer:
        """What sees; it takes a while to build."""
        config, T_ics_ccs = self.config, mount_of(self.mounts["camera"])
        lens = LensRays(self.plan.camera, field_of_view_deg=self.plan.lens.field_of_view_deg)
        return Renderer(
            World(self.scene, self.targets, sun_of(config, self.frame)),
            lens,
            waves=Waves.draw(self.seed, rms_slope=config.lidar.wave_slope),
            boat=OwnBoat.seen(lens, self.mounts, T_ics_ccs, waterline_m=config.boat.height_m),
            supersampling=self.settings.supersampling,
        )

    @cached_property
    def voyage(self) -> Voyage:
        """True motion."""
        return Voyage(self.config, self.seed)

    def light(self, k: int) -> ArrayF32:
        """Linear light (h, w, 3) of image k before lens and sensor."""
        shot = self.plan.shots[k]
        R = self.voyage.R_wcs_ics(np.array([shot.t_gps_s]))[0]
        return self.renderer.see(shot.T_wcs_ccs, R, t_s=shot.since_s, grain=k + 1)

    def render_image(self, k: int) -> ArrayU8:
        """Image k (h, w, 3), sRGB; it depends on no other image.

        Raises
        ------
        GeometryError : there is no such image.
        """
        if not 0 <= k < len(self.plan.shots):
            raise GeometryError(f"image {k}", expected=f"0 to {len(self.plan.shots) - 1}")
        light = self.light(k)
        return exposed(
            light,
            self.plan.lens,
            generator(self.seed, f"time lapse sensor {k}"),
            smear_px=self.plan.shots[k].smear_px,
            exposure=metered_exposure(light),
        )

    def write_image(self, k: int, folder: Path) -> str:
        """Render and write image k; gives the name of the file."""
        shot = self.plan.shots[k]
        facts = self._facts(shot)
        write_jpeg(folder / shot.name, self.render_image(k), facts, quality=93)
        return shot.name

    def _facts(self, shot: Shot) -> PhotoFacts:
        lens = self.plan.lens
        wide = lens.focal_px / lens.size_px[0]
        return PhotoFacts(
            model="boat camera",
            clock_us=shot.stamp_us,
            sub_seconds=3,
            zone="+00:00",
            focal_mm=round(wide * BOAT_SENSOR_MM, 1),
            focal_35mm=round(wide * FULL_FRAME_MM),
            exposure_s=self.config.camera.exposure_s,
        )


def draw_images(
    config: TwinConfig,
    settings: TwinTimeLapse,
    seed: int,
    frame: LocalFrame,
    scene: Path,
    true_mounts: Path,
    out_images: Path,
    *,
    part: int,
    parts: int,
) -> None:
    """Draw and write one part of the images, each ``parts``-th from number ``part`` on.

    ``true_mounts`` is the file of the mounts; all else and the errors are those of `simulate_time_lapse`.
    """
    mounts = read_true_mounts(true_mounts)
    recording = TimeLapse.of(config, settings, seed, frame, Scene.read(scene), mounts)
    out_images.mkdir(parents=True, exist_ok=True)
    for k in steps(range(part, len(recording.plan.shots), parts), "image"):
        recording.write_image(k, out_images)


def simulate_time_lapse(
    config: TwinConfig,
    settings: TwinTimeLapse,
    seed: int,
    frame: LocalFrame,
    scene: Path,
    mounts: Mapping[str, Any],
    out_images: Path,
    out_control_points: Path,
    *,
    out_poses: Path,
    out_truth: Path,
    drawn: Sequence[Path] = (),
) -> int:
    """Take and write the images of a voyage, the survey of the control points, and the truth.

    Parameters
    ----------
    config, settings : sections ``twin`` and ``twin.time_lapse``.
    seed : seed of the campaign.
    frame : local frame of the campaign.
    scene : written by `simulate_scene`.
    mounts : true mounts, with ``camera``.
    out_images : folder for the images.
    out_control_points : CSV, see `survey.surveyed`.
    out_poses : true poses of the images, table kind ``image_poses``.
    out_truth : true camera, control points and times, JSON.
    drawn : folders of all parts of the images by `draw_images`; none: they are drawn here.

    Returns
    -------
    n : number of written images.

    Raises
    ------
    ConfigError : no mount of the camera, no image, or no places for the control points.
    """
    recording = TimeLapse.of(config, settings, seed, frame, Scene.read(scene), mounts)
    plan = recording.plan
    out_images.mkdir(parents=True, exist_ok=True)
    for folder in drawn:
        shutil.copytree(folder, out_images, dirs_exist_ok=True)
    for k in steps(range(0 if drawn else len(plan.shots)), "image"):
        recording.write_image(k, out_images)
    write_survey(out_control_points, surveyed(recording.targets, settings, seed))
    write_poses(out_poses, plan, frame)
    since = np.array([shot.since_s for shot in plan.shots])
    write_truth(out_truth, plan, recording.targets, clock_minus_utc_s(config.camera, since))
    return len(plan.shots)


def metered_exposure(light: ArrayF32) -> float:
    """Exposure of `exposed` that a camera's automatic would choose for the light (h, w, 3) of a picture."""
    return float(np.clip(_METERED * metered(light[::4, ::4].astype(np.float64)), *_EXPOSURES))


def sun_of(config: TwinConfig, frame: LocalFrame) -> Sun:
    """The sun at the begin of the campaign, or, if that is at night, one of a late morning."""
    whole, _ = start_unix(config)
    try:
        sun = Sun.at(float(whole), frame.lat_deg, frame.lon_deg)
    except GeometryError:
        return _FALLBACK_SUN
    return sun if sun.elevation_rad > _LOW_SUN_RAD else _FALLBACK_SUN
