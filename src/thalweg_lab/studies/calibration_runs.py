"""Calibrations from the moving boat over many seeds: does the error agree with the stated covariance?

The normalised square ``e^T C^-1 e / k`` of an error ``e`` of k components has the expectation 1 if ``C``
is right. Its mean over n seeds lies in the chi-square band of n k degrees of freedom. *Formal* covariances,
which take points as independent, are judged beside: they are what publications state, and far too small.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from thalweg.calibration.echo_sounder.adjustment import Bed, EchoSettings, estimate_echo_sounder
from thalweg.calibration.ins_lidar.adjustment import InsLidarSettings, calibrate
from thalweg.calibration.ins_lidar.checks import RunGates
from thalweg.calibration.ins_lidar.motion_search import MountRange
from thalweg.calibration.ins_lidar.pose_errors import PoseErrors
from thalweg.calibration.ins_lidar.run_points import RunPoints
from thalweg.core.errors import ThalwegError
from thalweg.core.frames import LocalFrame, rotation_enu_body
from thalweg.core.rigid import Rigid
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayF
from thalweg.settings.sections.calibration import RunErrors
from thalweg_lab.base.random import gauss_markov, generator
from thalweg_lab.studies import cone_runs

# ---------------------------------------------------------------- soundings over a surveyed bed at the level
# of observations, for studies over many seeds; no files


TRUE_LEVER_M: Final = np.array([-0.42, 0.13, 0.31])
LEVER_ANTENNA_M: Final = np.array([0.100, 0.0, -0.450])
SIGMA_RULER_M: Final = np.array([0.03, 0.03, 0.03])
_HZ: Final = 50.0
_START_S: Final = 4.0e8


@dataclass(frozen=True, slots=True, kw_only=True)
class EchoSpec:
    """What kind of run: its duration, relief of the bed (height of waves of 7 and 11 m), turning or not, how
    much it sways (1: 3 deg roll, 2 deg pitch, 5 cm heave).
    """

    duration_s: float = 300.0
    relief_m: float = 0.5
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
    trajectory = _measured(seed, since, roll, pitch, heading, R, position)
    rng = generator(seed, "echo")
    rows = np.arange(5, len(since) - 5, 5)
    depth = _depths(R[rows], position[rows], s.relief_m)
    depth = depth * (1 + s.sigma_sound_speed * rng.standard_normal())
    depth = depth + s.sigma_depth_m * rng.standard_normal(len(depth))
    depth[rng.uniform(size=len(depth)) < s.blunders] *= 0.6
    side = np.arange(-22.0, 22.0, 0.4)
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2) + along.mean(axis=0)
    height = bed_height_m(grid, s.relief_m) + s.sigma_datum_m * generator(seed, "bed").standard_normal()
    bed = Bed(points_wcs_m=np.column_stack([grid, height]), sigma_m=0.01, sigma_datum_m=s.sigma_datum_m)
    return EchoRun(
        t_gps_s=_START_S + since[rows] - s.lag_s,
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


def _measured(
    seed: int, since: ArrayF, roll: ArrayF, pitch: ArrayF, heading: ArrayF, R: ArrayF, position: ArrayF
) -> Trajectory:
    rng = generator(seed, "ins")
    e = [gauss_markov(rng, len(since), 1 / _HZ, np.deg2rad(sigma), 20.0) for sigma in (0.1, 0.1, 0.2)]
    stated = rotation_enu_body(roll + e[0], pitch + e[1], heading + e[2])
    rng = generator(seed, "gnss")
    epochs = np.arange(-1.0, since[-1] + 1.05, 0.1)
    error = np.column_stack([
        sigma * (np.sqrt(0.75) * gauss_markov(rng, len(epochs), 0.1, 1.0, 10.0)
        + np.sqrt(0.25) * rng.standard_normal(len(epochs))) for sigma in (0.02, 0.02, 0.03)
    ])  # fmt: skip
    antenna = position + R @ LEVER_ANTENNA_M + CubicSpline(epochs, error)(since)
    return Trajectory(
        frame=LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0),
        t_gps_s=_START_S + since,
        position_wcs_m=antenna - stated @ LEVER_ANTENNA_M,
        quaternion_wcs_ics=Rotation.from_matrix(stated).as_quat(),
        cov_pose_wcs=np.zeros((len(since), 6, 6)),
        valid=np.ones(len(since), dtype=np.bool_),
    )


# ---------------------------------------------------------------- calibration runs


Trial = Callable[[int], dict[str, Any]]
"""From a seed to the line of its calibration."""

RUN: Final = cone_runs.RunSpec(duration_s=30.0, points=30_000)
NEAR: Final = Rigid.from_opk(np.deg2rad([0.0, -90.0, 0.0]), [-0.350, 0.0, -0.250])
"""The mount by a ruler, so that seeds need not search."""

SOUNDINGS: Final = EchoSpec(duration_s=180.0)

INS_LIDAR: Final = {"honest": 6, "without_antenna": 6, "formal": 6}
ECHO_SOUNDER: Final = {"honest": 3, "ruler": 3, "formal": 3}
"""What is judged, and its number of components."""

LEVEL: Final = 0.05
"""Share of studies that leave their band although the covariances are right; as in the other studies."""

WORDS: Final = {
    "honest": "covariance as stated",
    "without_antenna": "as stated, without the antenna's marker",
    "ruler": "the ruler alone",
    "formal": "formal: independent points, poses without error",
}


def ins_lidar_trial(seed: int) -> dict[str, Any]:
    """Mount of the lidar from a run of half a minute past six cones.

    The errors of the poses are presumed as the defaults of a campaign state them, whatever `RUN` draws: so
    short a run could not tell. What other errors do is the matter of `prior_study_calibration`.
    """
    run = cone_runs.make_run(seed, RUN)
    how = InsLidarSettings(
        errors=PoseErrors.from_section(RunErrors().model_dump()), gates_m=(0.12,),
        search=MountRange(lever_m=0.0, angle_deg=0.0), gates=RunGates(min_points_per_cone=40),
    )  # fmt: skip
    found = calibrate(
        RunPoints.on(run.trajectory, run.xyz_scs_m, run.t_gps_s), run.cones, run.T_wcs_pcs, how,
        lever_ics_antenna_m=cone_runs.LEVER_ANTENNA_M, antenna=run.antenna, start=NEAR,
    )  # fmt: skip
    error = found.T_ics_scs.error_from(run.true_mount)
    alone = found.without_antenna.error_from(run.true_mount)
    return {
        "error_mm": 1e3 * float(np.linalg.norm(error[:3])),
        "error_deg": float(np.rad2deg(np.linalg.norm(error[3:]))),
        "honest": _square(error, found.T_ics_scs.cov),
        "without_antenna": _square(alone, found.without_antenna.cov),
        "formal": _square(alone, found.cov_formal),
    }


def echo_sounder_trial(seed: int) -> dict[str, Any]:
    """Place of the echo sounder from three minutes of soundings over a bed with relief."""
    run = make_echo_run(seed, SOUNDINGS)
    errors = PoseErrors(
        sigma_position_m=np.array([0.02, 0.02, 0.03]), sigma_attitude_rad=np.deg2rad([0.1, 0.1, 0.2])
    )
    cov_ruler = np.diag(np.square(SIGMA_RULER_M))
    found = estimate_echo_sounder(
        run.t_gps_s, run.depth_m, run.trajectory, run.bed, EchoSettings(errors=errors),
        ruler_ics_m=run.ruler_m, cov_ruler_m2=cov_ruler, lever_ics_antenna_m=LEVER_ANTENNA_M,
    )  # fmt: skip
    error = found.lever_ics_m - TRUE_LEVER_M
    return {
        "error_mm": 1e3 * float(np.linalg.norm(error)),
        "determined": " ".join(found.observed),
        "honest": _square(error, found.cov_m2),
        "ruler": _square(run.ruler_m - TRUE_LEVER_M, cov_ruler),
        "formal": _square(error, found.cov_formal_m2),
    }


def study(trial: Trial, seeds: Sequence[int]) -> pd.DataFrame:
    """One line a seed: errors and normalised squares, or the failure."""
    return pd.DataFrame([_line(trial, seed) for seed in seeds])


def judged(found: pd.DataFrame, components: dict[str, int], level: float = LEVEL) -> pd.DataFrame:
    """Means of the normalised squares of a study, each with its chi-square band.

    Parameters
    ----------
    found : what `study` gave.
    components : columns that are judged, with their numbers of components.
    level : share of studies that lie outside the band although their covariances are right.

    Returns
    -------
    Columns ``covariance``, ``seeds``, ``failures``, ``normalised``, ``band_low``, ``band_high``, ``inside``;
    ``median_error_mm`` and, where there are angles, ``median_error_deg``: of the estimate, alike in all rows.
    """
    good = found[found["failure"] == ""]
    rows = []
    for name, k in components.items():
        n = k * len(good)
        mean = float(good[name].mean()) if n else float("nan")
        low, high = (float(chi2.ppf(q, n)) / n if n else np.nan for q in (level / 2, 1 - level / 2))
        rows.append((name, len(found), len(found) - len(good), mean, low, high, bool(low <= mean <= high)))
    names = ("covariance", "seeds", "failures", "normalised", "band_low", "band_high", "inside")
    table = pd.DataFrame(rows, columns=list(names))
    medians = {f"median_{name}": good[name].median() for name in ("error_mm", "error_deg") if name in good}
    return table.assign(**medians)


def as_markdown(found: pd.DataFrame, components: dict[str, int], title: str) -> str:
    """Page of a study."""
    good = found[found["failure"] == ""]
    table = judged(found, components)
    lines = [
        f"# {title}",
        "",
        "Mean normalised square errors over many seeds. They are 1 in expectation, and lie in the band in",
        f"{100 * (1 - LEVEL):.0f} of 100 studies, if the covariance is right; above it sigmas are too small,",
        "below too large.",
        "",
        "| covariance | seeds | normalised | band | |",
        "| --- | --- | --- | --- | --- |",
    ]
    for row in table.to_dict("records"):
        verdict = "inside" if row["inside"] else "outside"
        failed = f" ({row['failures']} failed)" if row["failures"] else ""
        lines.append(
            f"| {WORDS[row['covariance']]} | {row['seeds']}{failed} | {row['normalised']:.2f} "
            f"| {row['band_low']:.2f} to {row['band_high']:.2f} | {verdict} |"
        )
    if len(good):
        medians = [f"{good['error_mm'].median():.1f} mm"]
        medians += [f"{good['error_deg'].median():.3f} deg"] if "error_deg" in good else []
        lines += ["", f"Median error: {', '.join(medians)}."]
    return "\n".join(lines) + "\n"


def _line(trial: Trial, seed: int) -> dict[str, Any]:
    try:
        return {"seed": seed, "failure": "", **trial(seed)}
    except ThalwegError as error:
        return {"seed": seed, "failure": str(error)}


def _square(error: ArrayF, cov: ArrayF) -> float:
    """Normalised square; 0 if the covariance is without bounds."""
    return float(error @ np.linalg.solve(cov, error)) / len(error) if np.isfinite(cov).all() else 0.0
