"""Soundings from a swaying and turning boat over a surveyed bed, in memory and without files."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.calibration import Bed
from thalweg.calibration.ins_lidar import PoseErrors
from thalweg.core import ArrayF, Trajectory, rotation_enu_body
from thalweg_lab.random_numbers import generator
from thalweg_lab.studies.cone_runs import START_S, RunSpec, measured_trajectory

POSE_ERRORS: Final = PoseErrors(
    sigma_position_m=np.array([0.02, 0.02, 0.03]), sigma_attitude_rad=np.deg2rad([0.1, 0.1, 0.2])
)
TRUE_LEVER_M: Final = np.array([-0.42, 0.13, 0.31])
SIGMA_RULER_M: Final = np.array([0.03, 0.03, 0.03])
_HZ: Final = 50.0


@dataclass(frozen=True, slots=True, kw_only=True)
class EchoSpec:
    """What kind of run: its duration, relief of the bed (height of waves of 7 and 11 m), turning or not, how
    much it sways (1: 3 deg roll, 2 deg pitch, 5 cm heave), how far the surveyed bed reaches from its middle.
    """

    duration_s: float = 300.0
    relief_m: float = 0.5
    reach_m: float = 12.0
    turning: bool = True
    sway: float = 1.0
    lag_s: float = 0.0
    sigma_depth_m: float = 0.02
    sigma_datum_m: float = 0.01
    sigma_sound_speed: float = 0.002
    blunders: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class EchoRun:
    """Soundings as recorded (n,), trajectory and bed as measured, the ruler's lever arm (3,)."""

    t_gps_s: ArrayF
    depth_m: ArrayF
    trajectory: Trajectory
    bed: Bed
    ruler_m: ArrayF


def bed_height_m(places: ArrayF, relief_m: float) -> ArrayF:
    """True height (n,) of the bed at places (n, 2)."""
    x, y = np.asarray(places).T
    return np.asarray(
        -3.0 + relief_m * (np.sin(2 * np.pi * x / 11.0) + 0.7 * np.sin(2 * np.pi * y / 7.0 + 0.4))
    )


def make_echo_run(seed: int, spec: EchoSpec | None = None) -> EchoRun:
    """A run of a seed."""
    s = spec or EchoSpec()
    since = np.arange(int(s.duration_s * _HZ) + 1) / _HZ
    heading = 2 * np.pi * since / 60.0 if s.turning else 0.4 + 0.02 * np.sin(0.3 * since)
    roll = s.sway * np.deg2rad(3) * np.sin(1.7 * since)
    pitch = s.sway * np.deg2rad(2) * np.sin(1.3 * since)
    R = rotation_enu_body(roll, pitch, heading)
    step = 0.7 / _HZ
    along = np.cumsum(step * np.column_stack([np.sin(heading), np.cos(heading)]), axis=0)
    if not s.turning:
        along = 8.0 * np.column_stack([np.sin(heading), np.cos(heading)]) * np.sin(since / 12.0)[:, None]
    position = np.column_stack([along, 0.05 * s.sway * np.sin(2.1 * since)])
    trajectory = measured_trajectory(seed, RunSpec(), START_S + since, R, position)
    rng = generator(seed, "echo")
    rows = np.arange(5, len(since) - 5, 5)
    depth = _depths(R[rows], position[rows], s.relief_m)
    depth = depth * (1 + s.sigma_sound_speed * rng.standard_normal())
    depth = depth + s.sigma_depth_m * rng.standard_normal(len(depth))
    depth[rng.uniform(size=len(depth)) < s.blunders] *= 0.6
    side = np.arange(-s.reach_m, s.reach_m, 0.4)
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2) + along.mean(axis=0)
    height = bed_height_m(grid, s.relief_m) + s.sigma_datum_m * generator(seed, "bed").standard_normal()
    bed = Bed(points_wcs_m=np.column_stack([grid, height]), sigma_m=0.01, sigma_datum_m=s.sigma_datum_m)
    return EchoRun(
        t_gps_s=START_S + since[rows] - s.lag_s,
        depth_m=depth,
        trajectory=trajectory,
        bed=bed,
        ruler_m=TRUE_LEVER_M + SIGMA_RULER_M * generator(seed, "ruler").standard_normal(3),
    )


def _depths(R: ArrayF, position: ArrayF, relief_m: float) -> ArrayF:
    """Way (n,) from the transducer down the boat's axis to the bed, by a secant search."""
    start = position + R @ TRUE_LEVER_M
    down = R[:, :, 2]
    d = np.full(len(R), 3.0)
    for _ in range(30):
        x = start + d[:, None] * down
        d -= (x[:, 2] - bed_height_m(x[:, :2], relief_m)) / down[:, 2] * 0.8
    return d
