"""Lidar points of the calibration field in memory: the sensor of the packets without the packets.

Noise, dropouts, footprint and mixed pixels are those of `thalweg_lab.instruments.scanner`. Studies over many
seeds need the surroundings of the cones only; the other beams are then not cast at all.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numba as nb
import numpy as np

from thalweg.core.types import ArrayB, ArrayF, ArrayI, ArrayU8
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.instruments.beams import FIRING_S, LASER_S, VLP_16, Beams, Lasers
from thalweg_lab.instruments.scanner import LidarSensor, Shots
from thalweg_lab.voyage.motion import Motion
from thalweg_lab.voyage.yard_motion import FieldRun, standing, static_seed
from thalweg_lab.yard.layout import Field, build_field
from thalweg_lab.yard.scene import FieldScene, field_scene, people

_CHUNK: Final = 6144
"""Firings at a time, as in `thalweg_lab.instruments.lidar`."""

_UNIT_M: Final = 0.002
"""Step of the ranges that a VLP-16 reports."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scan:
    """Returns of n shots, in the order of time.

    Parameters
    ----------
    points_scs_m : (n, 3) as the sensor's reader computes them, noise included.
    ring : (n,) laser, 0 the lowest.
    t_gps_s : (n,) adjusted standard GPS time of the shots, without error.
    reflectivity : (n,) 1 to 100.
    cone : (n,) truth: index of the cone that the echo arose on, -1 if on none or on several things.
    kind : (n,) truth: values of `EchoKind`.
    """

    points_scs_m: ArrayF
    ring: ArrayI
    t_gps_s: ArrayF
    reflectivity: ArrayI
    cone: ArrayI
    kind: ArrayU8


def static_scan(
    config: TwinConfig,
    seed: int,
    number: int,
    *,
    R_ics_scs: ArrayF,
    lever_ics_scs_m: ArrayF,
    revolutions: int | None = None,
    lasers: Lasers = VLP_16,
    near_cones_m: float | None = 0.3,
) -> Scan:
    """Lidar recording of a static position.

    Parameters
    ----------
    config : section ``twin`` with ``field``.
    seed : seed of the campaign.
    number : of the position, from 1.
    R_ics_scs, lever_ics_scs_m : true mount of the scanner.
    revolutions : number of turns; None: as long as ``twin.field.position_s``.
    lasers : of the scanner; P2 Fig. 4: ``Lasers.even(8, 4.0)``.
    near_cones_m : only beams that pass the sphere about a cone within this distance are cast; None: all.
    """
    motion = standing(config, number)
    field, scene = _recorded(config, seed, f"position {number}")
    duration_s = motion.config.duration_s
    if revolutions is not None:
        duration_s = revolutions / config.lidar.rotation_hz
    sensor = LidarSensor.on_board(
        motion.config, static_seed(seed, number), motion, scene.scene,
        R_ics_scs=R_ics_scs, lever_ics_scs_m=lever_ics_scs_m, lasers=lasers,
    )  # fmt: skip
    return scan(sensor, field, duration_s=duration_s, near_cones_m=near_cones_m)


def run_scan(
    config: TwinConfig,
    seed: int,
    *,
    R_ics_scs: ArrayF,
    lever_ics_scs_m: ArrayF,
    near_cones_m: float | None = 0.3,
    motion: Motion | None = None,
) -> Scan:
    """Lidar recording of the dynamic run; parameters as in `static_scan`.

    Without ``near_cones_m`` it holds the returns of the capture file of `simulate_lidar`, but for the effects
    on packets and the rounding of azimuths to 0.01 degrees there.
    """
    motion = FieldRun(config, seed) if motion is None else motion
    field, scene = _recorded(config, seed, "run")
    sensor = LidarSensor.on_board(
        config, seed, motion, scene.scene, R_ics_scs=R_ics_scs, lever_ics_scs_m=lever_ics_scs_m
    )
    return scan(sensor, field, duration_s=config.duration_s, near_cones_m=near_cones_m)


def scan(sensor: LidarSensor, field: Field, *, duration_s: float, near_cones_m: float | None) -> Scan:
    """What a sensor records in a time from its start; one return a shot, as in the modes with one return.

    Parameters
    ----------
    sensor : on the boat in the field.
    field : for the truth, and for the beams that are worth casting.
    duration_s : whole firings within.
    near_cones_m : see `static_scan`.
    """
    wanted = None if near_cones_m is None else _near(field, near_cones_m)
    total = int(duration_s / FIRING_S)
    parts = [
        _points(sensor, sensor.fire(np.arange(first, min(first + _CHUNK, total)), wanted))
        for first in range(0, total, _CHUNK)
    ]
    points, ring, t_s, reflectivity, surface, kind = (np.concatenate(p) for p in zip(*parts, strict=True))
    return Scan(
        points_scs_m=points,
        ring=ring,
        t_gps_s=sensor.motion.start_gps_s + t_s,
        reflectivity=reflectivity,
        cone=field.cone_of(surface),
        kind=kind,
    )


def _recorded(config: TwinConfig, seed: int, recording: str) -> tuple[Field, FieldScene]:
    field = build_field(config, seed, when="boat")
    return field, field_scene(field, people_wcs_m=people(config, seed, recording, field))


def _points(sensor: LidarSensor, shots: Shots) -> tuple[Any, ...]:
    """Points in scs, rings, times, reflectivities, true surface points and kinds of the returns."""
    lasers = sensor.lasers
    row, laser = np.divmod(shots.shot, len(lasers.elevation_rad))
    t_s = shots.t_s[row] + LASER_S * laser
    azimuth, elevation = np.deg2rad(sensor.azimuth_deg(t_s)), lasers.elevation_rad[laser]
    range_m = _UNIT_M * shots.distance[0][shots.shot]
    level = range_m * np.cos(elevation)
    height = range_m * np.sin(elevation)
    if sensor.config.lidar.vertical_offsets:
        height = height + lasers.height_m[laser]
    at = np.arange(len(row))
    return (
        np.stack([level * np.sin(azimuth), level * np.cos(azimuth), height], axis=1),
        lasers.ring[laser],
        t_s,
        shots.brightness[0][shots.shot],
        shots.echoes.point_wcs_m[at, shots.last],
        shots.echoes.kind[at, shots.last],
    )


def _near(field: Field, margin_m: float) -> Callable[[Beams], ArrayB]:
    """Tells which beams pass a cone within a margin."""
    spheres = [c.sphere for c in field.cones]
    centre = np.stack([c for c, _ in spheres])
    radius = np.array([r for _, r in spheres]) + margin_m

    def wanted(rays: Beams) -> ArrayB:
        """Beams (n, m) that pass a cone within the margin."""
        out = np.zeros(rays.origin_wcs_m.shape[:2], dtype=np.bool_)
        _passes(rays.origin_wcs_m, rays.direction_wcs, centre, radius, out)
        return out

    return wanted


@nb.njit(cache=True, error_model="numpy")
def _passes(origin: ArrayF, direction: ArrayF, centre: ArrayF, radius: ArrayF, out: ArrayB) -> None:
    for i in range(origin.shape[0]):
        for j in range(origin.shape[1]):
            o, d = origin[i, j], direction[i, j]
            for k in range(len(radius)):
                x, y, z = centre[k, 0] - o[0], centre[k, 1] - o[1], centre[k, 2] - o[2]
                along = x * d[0] + y * d[1] + z * d[2]
                if along > 0.0 and x * x + y * y + z * z - along * along < radius[k] * radius[k]:
                    out[i, j] = True
                    break
