"""Which images the boat's camera takes: times, names, true poses, smear, and which of them are defective."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from thalweg.core.camera.model import Camera
from thalweg.core.errors import ConfigError
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayF
from thalweg.settings.twin.camera import TwinLens
from thalweg.settings.twin.sections import TwinConfig
from thalweg.settings.twin.time_lapse import TwinTimeLapse
from thalweg_lab.base.random import generator
from thalweg_lab.voyage.voyage import Voyage
from thalweg_lab.yard_images.images import mount_of, run_name, true_camera
from thalweg_lab.yard_records.image_times import run_times

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
    stamped : whether name and EXIF carry the stamp.
    sharp : false if it is out of focus.
    copy_name : name of the second file with the same content; empty if there is none.
    """

    name: str
    t_gps_s: float
    since_s: float
    stamp_us: int
    T_wcs_ccs: Rigid
    smear_px: tuple[float, float]
    stamped: bool = True
    sharp: bool = True
    copy_name: str = ""


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
    """Times, poses and defects of the images of a voyage.

    Parameters
    ----------
    config : section ``twin``.
    time_lapse : section ``twin.time_lapse``.
    seed : seed of the campaign.
    mounts : true mounts with ``camera``.

    Raises
    ------
    ConfigError : the mounts hold no camera, the share leaves no image, or fewer images than defects.
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
    unstamped, copied, soft = _defective(time_lapse, seed, n)
    shots = []
    for k, stamp in enumerate(times.stamp_us[:n].tolist()):
        name = f"P{1050000 + k + 1}.jpg" if unstamped[k] else run_name(stamp)
        shots.append(
            Shot(
                name=name,
                t_gps_s=float(at[k]),
                since_s=float(since[k]),
                stamp_us=stamp,
                T_wcs_ccs=poses[k],
                smear_px=smears[k],
                stamped=not unstamped[k],
                sharp=not soft[k],
                copy_name=name.replace(".jpg", " (2).jpg") if copied[k] else "",
            )
        )
    return Plan(shots=tuple(shots), lens=lens, camera=true_camera(lens, "boat"))


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


def _defective(time_lapse: TwinTimeLapse, seed: int, n: int) -> list[list[bool]]:
    """Whether each image has no stamp, is there twice, is out of focus."""
    effects = time_lapse.effects
    flags = []
    for name, count in (
        ("unstamped", effects.unstamped),
        ("duplicated", effects.duplicated),
        ("blurred", effects.blurred),
    ):
        if count > n:
            raise ConfigError(
                f"{count} images {name} of {n}",
                expected="at most all of them",
                where=f"twin.time_lapse.effects.{name}",
                cure="Lower the number",
            )
        chosen = generator(seed, f"time lapse {name}").permutation(n)[:count]
        flags.append([k in set(chosen.tolist()) for k in range(n)])
    return flags
