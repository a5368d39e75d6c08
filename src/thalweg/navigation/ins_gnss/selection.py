"""Which positions and which states of the INS may enter a trajectory; what is left out is counted."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core.errors import InputError
from thalweg.core.frames import LocalFrame
from thalweg.core.types import ArrayF
from thalweg.navigation.ins_gnss.interpolation import JITTER_S

ATTITUDE_INITIALISED: Final = 0b101
"""Bits of the ANPP filter status without which an attitude is arbitrary: orientation and heading."""

NAVIGATION_INITIALISED: Final = 0b111
"""The same, and the navigation filter, without which the INS's own position is arbitrary."""

PLAIN_SLACK_M: Final = 5.0
HEIGHT_SLACK_M: Final = 10.0
"""Slack of the INS's coarse position in plan and height: lever arm, and filters too sure of themselves."""

MAX_DISTANCE_M: Final = 20_000.0
"""Farthest a survey may be from the origin of its local frame."""


@dataclass(slots=True, kw_only=True)
class TrajectorySummary:
    """What was used and what was left out on the way to a trajectory."""

    n_positions: int = 0
    n_positions_used: int = 0
    n_states: int = 0
    n_nodes_valid: int = 0
    fixes: dict[str, int] = field(default_factory=dict)
    gaps: list[tuple[float, float]] = field(default_factory=list)
    """Start (adjusted GPS time) and length in seconds of the holes that were not bridged."""
    sigma_interpolation_m: tuple[float, ...] | None = None
    """Largest standard deviation east, north, up that the interpolation of the positions adds."""
    notes: list[str] = field(default_factory=list)


def usable_positions(
    positions: pd.DataFrame, accept_fixes: list[str], summary: TrajectorySummary
) -> pd.DataFrame:
    """The positions (table kind ``gnss_position``) of an accepted fix with time, height and sigmas, in order.

    Raises
    ------
    InputError : fewer than four are left.
    """
    summary.fixes = {str(k): int(v) for k, v in positions["fix"].value_counts().sort_index().items()}
    accepted = positions[positions["fix"].isin(accept_fixes)]
    sigmas = ["sigma_east_m", "sigma_north_m", "sigma_up_m"]
    timed = accepted.dropna(subset=["t_gps_s", "lat_deg", "lon_deg", "h_ell_m", *sigmas])
    timed = timed.sort_values("t_gps_s", kind="stable").drop_duplicates("t_gps_s")
    if len(timed) < 4:
        raise InputError(
            f"{len(timed)} usable positions of {len(positions)} (fixes met: {summary.fixes or 'none'})",
            expected=f"at least 4 epochs with GPS time, height, sigmas and a fix among {accept_fixes}",
            cure="Check the position log, or allow more kinds in orientation.accept_fixes",
        )
    summary.n_positions_used = len(timed)
    refused = len(positions) - len(accepted)
    if refused:
        summary.notes.append(f"{refused} positions were left out for their fix; accepted: {accept_fixes}")
    if len(timed) < len(accepted):
        lacking = len(accepted) - len(timed)
        summary.notes.append(f"{lacking} positions without time, height or sigmas, or with a repeated time")
    return timed


def usable_states(
    states: pd.DataFrame, summary: TrajectorySummary, max_attitude_gap_s: float, required_status: int
) -> pd.DataFrame:
    """The states (table kind ``ins_state``) with GPS time and an initialised attitude, in order.

    Raises
    ------
    InputError : fewer than two are left, or they are rarer than ``max_attitude_gap_s`` allows.
    """
    ready = states[(states["filter_status"].to_numpy(dtype=np.int64) & required_status) == required_status]
    if len(ready) < len(states):
        summary.notes.append(
            f"{len(states) - len(ready)} INS states from before the filter was initialised were left out"
        )
    timed = ready.dropna(subset=["t_gps_s", "roll_rad", "pitch_rad", "heading_rad"])
    timed = timed.sort_values("t_gps_s", kind="stable").drop_duplicates("t_gps_s")
    if len(timed) < 2:
        raise InputError(
            f"{len(timed)} of {len(states)} INS states carry GPS time and an initialised attitude",
            expected="an INS log whose UTC, orientation and heading are initialised",
            cure="Start logging after the INS has GNSS reception; look at the integrity report of the INS",
        )
    if len(timed) < len(ready):
        summary.notes.append(
            f"{len(ready) - len(timed)} INS states without GPS time or repeated were left out"
        )
    step_s = float(np.median(np.diff(timed["t_gps_s"])))
    if step_s > max_attitude_gap_s + JITTER_S:
        raise InputError(
            f"INS states come every {step_s:g} s",
            expected=f"at most orientation.max_attitude_gap_s = {max_attitude_gap_s:g} s between them",
            cure="Raise orientation.max_attitude_gap_s if the boat turns slowly enough for that rate",
        )
    return timed


def agree_with_ins(
    positions: pd.DataFrame, ins: pd.DataFrame, frame: LocalFrame, summary: TrajectorySummary
) -> pd.DataFrame:
    """The positions that agree with what the INS itself says of its place, within its own accuracy.

    A base that is 500 m off, heights above the geoid instead of the ellipsoid, a wrong time scale, a damaged
    digit: the INS's coarse position sees them all.

    Raises
    ------
    InputError : more than a fifth of the positions disagree.
    """
    known = ins.dropna(
        subset=["lat_deg", "lon_deg", "h_ell_m", "sigma_north_m", "sigma_east_m", "sigma_up_m"]
    )
    status = known["filter_status"].to_numpy(dtype=np.int64)
    known = known[(status & NAVIGATION_INITIALISED) == NAVIGATION_INITIALISED]
    t = positions["t_gps_s"].to_numpy()
    if len(known) < 2:
        summary.notes.append("The INS states no position of its own: the positions could not be checked")
        return positions
    t_ins = known["t_gps_s"].to_numpy()
    coarse = frame.from_geodetic(known["lat_deg"], known["lon_deg"], known["h_ell_m"])
    enu = frame.from_geodetic(positions["lat_deg"], positions["lon_deg"], positions["h_ell_m"])
    d = enu - np.column_stack([np.interp(t, t_ins, coarse[:, axis]) for axis in range(3)])
    sigma = np.column_stack([
        np.interp(t, t_ins, known[name]) for name in ("sigma_east_m", "sigma_north_m", "sigma_up_m")
    ])  # fmt: skip
    plan = np.hypot(d[:, 0], d[:, 1])
    limit_plan = PLAIN_SLACK_M + 6 * np.hypot(sigma[:, 0], sigma[:, 1])
    limit_height = HEIGHT_SLACK_M + 6 * sigma[:, 2]
    inside = (t >= t_ins[0]) & (t <= t_ins[-1])
    off = inside & ((plan > limit_plan) | (np.abs(d[:, 2]) > limit_height))
    if off.sum() > 0.2 * max(inside.sum(), 1):
        in_plan, in_height = float(np.median(plan[inside])), float(np.median(d[inside, 2]))
        raise InputError(
            f"{int(off.sum())} of {int(inside.sum())} positions disagree with the INS's own: in the median "
            f"{in_plan:.1f} m in plan and {in_height:+.1f} m in height",
            expected=f"at most {float(np.median(limit_plan)):.1f} m and "
            f"{float(np.median(limit_height)):.1f} m, six sigmas of the INS and some slack",
            cure="Check the base position, the time scale (GPST or UTC) and the kind of heights (ellipsoidal "
            "or above the geoid) of the position log",
        )
    if off.any():
        summary.notes.append(f"{int(off.sum())} positions far from the INS's own were left out")
        summary.n_positions_used -= int(off.sum())
    return positions[~off]


def check_origin(points_wcs_m: ArrayF, frame: LocalFrame) -> None:
    """Refuse a survey far from the origin: heights of a tangent plane are 31 m off the ellipsoid at 20 km."""
    if not len(points_wcs_m):
        return
    distance_m = float(np.median(np.linalg.norm(points_wcs_m[:, :2], axis=1)))
    if distance_m > MAX_DISTANCE_M:
        raise InputError(
            f"the survey is {distance_m / 1000:.0f} km from the origin of the local frame "
            f"({frame.lat_deg}, {frame.lon_deg})",
            expected=f"an origin within {MAX_DISTANCE_M / 1000:.0f} km",
            cure="Set campaign.origin to a point of the survey",
        )
