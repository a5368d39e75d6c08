"""Trajectory from GNSS antenna positions and INS attitudes (T 3.1.1, P1 eq. 7-8).

The antenna track is interpolated to the times of the INS states, and the lever arm is taken off with the
attitude of that moment: ``x_wcs_ics = x_wcs_antenna - R_wcs_ics @ lever_ics_antenna``.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from thalweg.core import (
    ArrayB,
    ArrayF,
    CoverageError,
    InputError,
    LocalFrame,
    Trajectory,
    attitude_axes,
    rotation_enu_body,
    utc_text_from_gps,
)
from thalweg.ingest import INS_STATE, NAVIGATION_INITIALISED
from thalweg.navigation.ins_gnss.interpolation import (
    JITTER_S,
    Interpolated,
    bridge_with_velocity,
    interpolate_positions,
)

ATTITUDE_INITIALISED: Final = 0b101
"""Bits of the ANPP filter status without which an attitude is arbitrary: orientation and heading."""
PLAIN_SLACK_M: Final = 5.0
HEIGHT_SLACK_M: Final = 10.0
"""Slack of the INS's coarse position in plan and height: lever arm, and filters too sure of themselves."""
ANY_HEADING_RAD: Final = np.pi / np.sqrt(3.0)
"""Standard deviation of a heading of which nothing is known: uniform over the circle."""
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


# ---------------------------------------------------------------- trajectory


def build_trajectory(
    positions: pd.DataFrame,
    states: pd.DataFrame,
    frame: LocalFrame,
    *,
    lever_ics_antenna_m: ArrayLike,
    sigma_lever_m: ArrayLike,
    accept_fixes: Sequence[str] | Literal["auto"],
    max_gap_s: float,
    max_attitude_gap_s: float,
    sigma_attitude_rad: ArrayLike,
    interpolation: Literal["cubic", "ins_velocity"] = "cubic",
) -> tuple[Trajectory, TrajectorySummary]:
    """Join antenna positions and INS attitudes.

    Parameters
    ----------
    positions : table kind ``gnss_position``: the antenna.
    states : table kind ``ins_state``: attitudes, at the rate that the nodes will have.
    frame : the world frame.
    lever_ics_antenna_m : (3,) antenna phase centre in the body frame ics.
    sigma_lever_m : (3,) its standard deviations.
    accept_fixes : kinds of solution that may enter, for instance ``["fixed"]``; ``auto``: see
        `usable_positions`.
    max_gap_s : longest hole between positions that is interpolated.
    max_attitude_gap_s : longest hole between INS states that is interpolated.
    sigma_attitude_rad : (3,) roll, pitch, heading; stands in where the log states none.
    interpolation : positions between epochs by a cubic spline, or along the velocity of the INS.

    Raises
    ------
    InputError : no position of an accepted fix, or no state with GPS time.
    CoverageError : positions and states do not overlap in time.
    """
    summary = TrajectorySummary(n_positions=len(positions), n_states=len(states))
    used = usable_positions(positions, accept_fixes, summary, max_gap_s)
    ins = usable_states(states, summary, max_attitude_gap_s, ATTITUDE_INITIALISED)
    t_states = ins["t_gps_s"].to_numpy()
    t_positions = used["t_gps_s"].to_numpy()
    if t_states[-1] < t_positions[0] or t_positions[-1] < t_states[0]:
        raise CoverageError(
            f"INS states cover {utc_text_from_gps(t_states[0])} .. {utc_text_from_gps(t_states[-1])}, "
            f"positions {utc_text_from_gps(t_positions[0])} .. {utc_text_from_gps(t_positions[-1])}",
            expected="streams of the same survey that overlap in time",
            cure="Check that the logs belong together, and the dates and time scales of both",
        )
    used = agree_with_ins(used, ins, frame, summary)
    lever = np.asarray(lever_ics_antenna_m, dtype=np.float64)
    found = _antenna_at(
        used,
        ins,
        frame,
        lever,
        summary,
        max_gap_s=max_gap_s,
        max_attitude_gap_s=max_attitude_gap_s,
        interpolation=interpolation,
    )
    covered = found.covered
    antenna = np.where(covered[:, None], found.position_m, 0.0)
    cov_antenna = np.where(covered[:, None, None], found.cov_m2, 0.0)
    check_origin(antenna[covered], frame)
    lat_deg, lon_deg, _ = frame.to_geodetic(antenna)
    R_wcs_ics = _attitude(ins, frame, lat_deg, lon_deg)
    sigma_att = np.column_stack(
        [
            np.where(np.isfinite(stated), stated, fallback)
            for stated, fallback in zip(
                ins[["sigma_roll_rad", "sigma_pitch_rad", "sigma_heading_rad"]].to_numpy().T,
                np.asarray(sigma_attitude_rad, dtype=np.float64),
                strict=True,
            )
        ]
    )
    nodes = Trajectory(
        frame=frame,
        t_gps_s=t_states,
        position_wcs_m=antenna - R_wcs_ics @ lever,
        quaternion_wcs_ics=Rotation.from_matrix(R_wcs_ics).as_quat(),
        cov_pose_wcs=pose_covariance(
            R_wcs_ics,
            cov_antenna,
            sigma_att,
            lever_ics_m=lever,
            sigma_lever_m=np.asarray(sigma_lever_m, dtype=np.float64),
        ),
        valid=covered,
    )
    trajectory = break_at_gaps(nodes, max_attitude_gap_s, summary)
    summary.n_nodes_valid = int(trajectory.valid.sum())
    trajectory.span()  # refuses a trajectory without any valid node
    return trajectory, summary


def trajectory_from_states(
    states: pd.DataFrame,
    frame: LocalFrame,
    *,
    max_attitude_gap_s: float,
    sigma_attitude_rad: ArrayLike,
    sigma_position_m: ArrayLike | None = None,
) -> tuple[Trajectory, TrajectorySummary]:
    """Trajectory of an INS that gives position and attitude itself (its own filter, or SBET).

    Parameters
    ----------
    states : table kind ``ins_state``, positions at the ics origin.
    frame, max_attitude_gap_s, sigma_attitude_rad : as in `build_trajectory`.
    sigma_position_m : (3,) east, north, up; stands in where the log states none.

    Raises
    ------
    InputError : no state carries GPS time, or there are no sigmas of the positions.
    """
    summary = TrajectorySummary(n_positions=len(states), n_states=len(states))
    ins = usable_states(states, summary, max_attitude_gap_s, NAVIGATION_INITIALISED)
    placed = ins.dropna(subset=["lat_deg", "lon_deg", "h_ell_m"])
    if len(placed) < len(ins):
        summary.notes.append(f"{len(ins) - len(placed)} INS states without a position were left out")
    ins = placed
    sigma = ins[["sigma_east_m", "sigma_north_m", "sigma_up_m"]].to_numpy()
    if sigma_position_m is not None:
        sigma = np.where(np.isfinite(sigma), sigma, np.asarray(sigma_position_m, dtype=np.float64))
    if len(ins) < 2 or not np.isfinite(sigma).all(axis=1).any():
        raise InputError(
            f"{len(ins)} states with a position, none of them with sigmas"
            if len(ins)
            else "no position at all",
            expected="positions whose accuracy is known",
            cure="Give the SMRMSG file of an SBET in logs.smrmsg, or ins.sigma_position_m",
        )
    summary.n_positions_used = len(ins)
    stated = ins[["sigma_roll_rad", "sigma_pitch_rad", "sigma_heading_rad"]].to_numpy()
    known = np.isfinite(sigma).all(axis=1)
    R_wcs_ics = _attitude(ins, frame, ins["lat_deg"].to_numpy(), ins["lon_deg"].to_numpy())
    nodes = Trajectory(
        frame=frame,
        t_gps_s=ins["t_gps_s"].to_numpy(),
        position_wcs_m=frame.from_geodetic(ins["lat_deg"], ins["lon_deg"], ins["h_ell_m"]),
        quaternion_wcs_ics=Rotation.from_matrix(R_wcs_ics).as_quat(),
        cov_pose_wcs=pose_covariance(
            R_wcs_ics,
            np.square(np.where(known[:, None], sigma, 0.0))[:, :, None] * np.eye(3),
            np.where(np.isfinite(stated), stated, np.asarray(sigma_attitude_rad)),
        ),
        valid=known,
    )
    trajectory = break_at_gaps(nodes, max_attitude_gap_s, summary)
    summary.n_nodes_valid = int(trajectory.valid.sum())
    trajectory.span()
    return trajectory, summary


def with_stated(
    positions: pd.DataFrame, *, sigma_position_m: ArrayLike | None, antenna_h_ell_m: float | None
) -> pd.DataFrame:
    """Positions whose missing standard deviations and heights are those that the user states.

    A stated height stands in only where no position of the log has one: beside measured heights it would be
    a jump.

    Parameters
    ----------
    positions : table kind ``gnss_position``.
    sigma_position_m : (3,) east, north, up; None: nothing stands in.
    antenna_h_ell_m : ellipsoidal height of the antenna; None: nothing stands in.
    """
    table = positions.copy()
    if antenna_h_ell_m is not None and table["h_ell_m"].isna().all():
        table["h_ell_m"] = antenna_h_ell_m
    if sigma_position_m is not None:
        names = ("sigma_east_m", "sigma_north_m", "sigma_up_m")
        for name, sigma in zip(names, np.asarray(sigma_position_m, dtype=np.float64), strict=True):
            table[name] = table[name].fillna(float(sigma))
    return table


def states_along_course(
    positions: pd.DataFrame,
    frame: LocalFrame,
    *,
    accept_fixes: Sequence[str] | Literal["auto"],
    max_gap_s: float,
    sigma_level_deg: float,
    sigma_course_deg: float,
) -> pd.DataFrame:
    """Attitudes of a boat without an INS: level, and heading along its course.

    The course at an epoch is the direction from the epoch before to the one after. Where these are so near
    that their errors turn it, the heading is less certain, up to that of any direction.

    Parameters
    ----------
    positions : table kind ``gnss_position``.
    frame : the world frame.
    accept_fixes, max_gap_s : as in `build_trajectory`.
    sigma_level_deg : standard deviation of roll and pitch, which are zero.
    sigma_course_deg : standard deviation of the heading against the true course (drift).

    Returns
    -------
    states : table kind ``ins_state`` without positions, one row an epoch of `positions` that may be used.

    Raises
    ------
    InputError : no usable positions, or they are rarer than `max_gap_s`.
    """
    used = usable_positions(positions, accept_fixes, TrajectorySummary(), max_gap_s)
    t = used["t_gps_s"].to_numpy(np.float64)
    step_s = float(np.median(np.diff(t)))
    if step_s > max_gap_s + JITTER_S:
        raise InputError(
            f"positions come every {step_s:g} s, and there is no INS",
            expected=f"at most orientation.max_gap_s = {max_gap_s:g} s between them",
            cure="Raise orientation.max_gap_s if the boat runs evenly enough for that rate",
        )
    enu = frame.from_geodetic(used["lat_deg"], used["lon_deg"], used["h_ell_m"])
    after = np.minimum(np.arange(len(t)) + 1, len(t) - 1)
    before = np.maximum(np.arange(len(t)) - 1, 0)
    step = enu[after, :2] - enu[before, :2]
    sigma_m = np.hypot(used["sigma_east_m"].to_numpy(), used["sigma_north_m"].to_numpy())
    # both ends of the step err across it by sigma_m / sqrt(2); errors that last longer cancel in part
    turned = sigma_m / np.maximum(np.linalg.norm(step, axis=1), 1e-9)
    sigma_heading = np.minimum(np.hypot(np.deg2rad(sigma_course_deg), turned), ANY_HEADING_RAD)
    states = INS_STATE.empty_table().to_pandas().reindex(range(len(t)))
    level = np.full(len(t), np.deg2rad(sigma_level_deg))
    return states.assign(
        t_gps_s=t,
        roll_rad=0.0,
        pitch_rad=0.0,
        heading_rad=np.arctan2(step[:, 0], step[:, 1]) % (2 * np.pi),
        sigma_roll_rad=level,
        sigma_pitch_rad=level,
        sigma_heading_rad=sigma_heading,
        fix="none",
        system_status=0,
        filter_status=NAVIGATION_INITIALISED,
    )


def break_at_gaps(trajectory: Trajectory, max_gap_s: float, summary: TrajectorySummary) -> Trajectory:
    """Put an invalid node into each hole longer than ``max_gap_s``: nothing is interpolated across it."""
    t = trajectory.t_gps_s
    holes = np.flatnonzero(np.diff(t) > max_gap_s + JITTER_S)
    if not holes.size:
        return trajectory
    for i in holes:
        summary.gaps.append((float(t[i]), float(t[i + 1] - t[i])))
    summary.notes.append(f"{holes.size} holes in the INS states longer than {max_gap_s:g} s were not bridged")
    at = holes + 1

    def insert(values: ArrayF) -> ArrayF:
        """Values with a node in the middle of each hole, a copy of the node before it."""
        return np.insert(values, at, values[holes], axis=0)

    return Trajectory(
        frame=trajectory.frame,
        t_gps_s=np.insert(t, at, (t[holes] + t[at]) / 2),
        position_wcs_m=insert(trajectory.position_wcs_m),
        quaternion_wcs_ics=insert(trajectory.quaternion_wcs_ics),
        cov_pose_wcs=insert(trajectory.cov_pose_wcs),
        valid=np.insert(trajectory.valid, at, False),
    )


def pose_covariance(
    R_wcs_ics: ArrayF,
    cov_position_m2: ArrayF,
    sigma_attitude_rad: ArrayF,
    *,
    lever_ics_m: ArrayLike = (0.0, 0.0, 0.0),
    sigma_lever_m: ArrayLike = (0.0, 0.0, 0.0),
) -> ArrayF:
    """Covariance (n, 6, 6) of ics origin and attitude from a measured point of the boat and three angles.

    With ``x_ics = x_antenna - R l`` and a small rotation ``dtheta`` in wcs::

        dx_ics = dx_antenna + (R l) x dtheta - R dl

    Parameters
    ----------
    R_wcs_ics : (n, 3, 3).
    cov_position_m2 : (n, 3, 3) of the measured point (the antenna) in wcs.
    sigma_attitude_rad : (n, 3) roll, pitch, heading, taken as uncorrelated.
    lever_ics_m, sigma_lever_m : (3,) the measured point in ics, and its standard deviations.
    """
    axes = np.swapaxes(attitude_axes(R_wcs_ics), 1, 2) * sigma_attitude_rad[:, None, :]
    cov_rotation = axes @ np.swapaxes(axes, 1, 2)
    x, y, z = np.moveaxis(R_wcs_ics @ np.asarray(lever_ics_m, dtype=np.float64), -1, 0)
    o = np.zeros_like(x)
    turn = np.stack([o, -z, y, z, o, -x, -y, x, o], axis=-1).reshape(-1, 3, 3)
    lever = R_wcs_ics * np.asarray(sigma_lever_m, dtype=np.float64)
    cov = np.empty((len(R_wcs_ics), 6, 6))
    cov[:, 3:, 3:] = cov_rotation
    cov[:, :3, 3:] = turn @ cov_rotation
    cov[:, 3:, :3] = np.swapaxes(cov[:, :3, 3:], 1, 2)
    cov[:, :3, :3] = (
        cov_position_m2 + cov[:, :3, 3:] @ np.swapaxes(turn, 1, 2) + lever @ np.swapaxes(lever, 1, 2)
    )
    return cov


def _attitude(states: pd.DataFrame, frame: LocalFrame, lat_deg: ArrayF, lon_deg: ArrayF) -> ArrayF:
    """``R_wcs_ics`` (n, 3, 3): the INS states its angles in the local level of where it is."""
    R_enu_ics = rotation_enu_body(states["roll_rad"], states["pitch_rad"], states["heading_rad"])
    return np.asarray(frame.R_wcs_enu(lat_deg, lon_deg) @ R_enu_ics)


def _antenna_at(
    positions: pd.DataFrame,
    ins: pd.DataFrame,
    frame: LocalFrame,
    lever_ics_m: ArrayF,
    summary: TrajectorySummary,
    *,
    max_gap_s: float,
    max_attitude_gap_s: float,
    interpolation: str,
) -> Interpolated:
    """The antenna at the times of the INS states, in wcs."""
    epochs = positions["t_gps_s"].to_numpy()
    enu = frame.from_geodetic(positions["lat_deg"], positions["lon_deg"], positions["h_ell_m"])
    at = ins["t_gps_s"].to_numpy()
    if interpolation == "cubic":
        found = interpolate_positions(epochs, enu, _covariances(positions), at, max_gap_s=max_gap_s)
    else:
        lat_deg, lon_deg, _ = frame.to_geodetic(np.stack([np.interp(at, epochs, a) for a in enu.T], axis=1))
        enu_mps = ins[["v_east_mps", "v_north_mps", "v_down_mps"]].to_numpy() * [1.0, 1.0, -1.0]
        known = np.isfinite(enu_mps).all(axis=1)
        if known.sum() < len(known):
            summary.notes.append(f"{int((~known).sum())} INS states without a velocity guide no position")
        found = bridge_with_velocity(
            epochs,
            enu,
            _covariances(positions),
            at,
            max_gap_s=max_gap_s,
            velocity_t_s=at[known],
            velocity_mps=np.einsum("nij,nj->ni", frame.R_wcs_enu(lat_deg, lon_deg), enu_mps)[known],
            sigma_velocity_mps=None,
            offset_m=(_attitude(ins, frame, lat_deg, lon_deg) @ lever_ics_m)[known],
            max_velocity_gap_s=max_attitude_gap_s,
        )
    summary.gaps += found.gaps
    if found.gaps:
        summary.notes.append(
            f"{len(found.gaps)} holes in the positions longer than {max_gap_s:g} s were not bridged"
        )
    for start_s, n in found.short_segments:
        summary.notes.append(f"{n} positions from {utc_text_from_gps(start_s)} stand alone between holes")
    outside = int((~found.covered).sum())
    if outside:
        summary.notes.append(f"{outside} INS states have no position (outside the track, or in a hole of it)")
    if found.covered.any():
        worst = found.sigma_interpolation_m[found.covered].max(axis=0)
        summary.sigma_interpolation_m = tuple(float(value) for value in worst)
    return found


def _covariances(positions: pd.DataFrame) -> ArrayF:
    cov = np.zeros((len(positions), 3, 3))
    for i, name in enumerate(("sigma_east_m", "sigma_north_m", "sigma_up_m")):
        cov[:, i, i] = np.square(positions[name].to_numpy())
    for name, i, j in (("cov_en_m2", 0, 1), ("cov_eu_m2", 0, 2), ("cov_nu_m2", 1, 2)):
        cov[:, i, j] = cov[:, j, i] = np.nan_to_num(positions[name].to_numpy())
    return cov


# ---------------------------------------------------------------- which positions and states may enter


def usable_positions(
    positions: pd.DataFrame,
    accept_fixes: Sequence[str] | Literal["auto"],
    summary: TrajectorySummary,
    max_gap_s: float = np.inf,
) -> pd.DataFrame:
    """Positions (table kind ``gnss_position``) of an accepted fix with time, height and sigmas, in order.

    With ``auto`` fixed ones are accepted, and float ones in holes of these longer than ``max_gap_s``.

    Raises
    ------
    InputError : fewer than four are left.
    """
    summary.fixes = {str(k): int(v) for k, v in positions["fix"].value_counts().sort_index().items()}
    if accept_fixes == "auto":
        accepted = positions[_fixed_or_in_holes(positions, max_gap_s)]
    else:
        accepted = positions[positions["fix"].isin(accept_fixes)]
    sigmas = ["sigma_east_m", "sigma_north_m", "sigma_up_m"]
    timed = accepted.dropna(subset=["t_gps_s", "lat_deg", "lon_deg", "h_ell_m", *sigmas])
    timed = timed.sort_values("t_gps_s", kind="stable").drop_duplicates("t_gps_s")
    if len(timed) < 4:
        cures = {
            "h_ell_m": "state orientation.antenna_h_ell_m, as the log has no heights",
            "sigma_up_m": "state orientation.sigma_position_m, as the log has no standard deviations",
        }
        cure = "; ".join(words for name, words in cures.items() if accepted[name].isna().all())
        known = cure if len(accepted) else ""
        raise InputError(
            f"{len(timed)} usable positions of {len(positions)} (fixes met: {summary.fixes or 'none'})",
            expected=f"at least 4 epochs with GPS time, height, sigmas and a fix among {accept_fixes}",
            cure=known.capitalize() or "Check the position log, or allow more in orientation.accept_fixes",
        )
    summary.n_positions_used = len(timed)
    refused = len(positions) - len(accepted)
    if refused:
        summary.notes.append(f"{refused} positions were left out for their fix; accepted: {accept_fixes}")
    if len(timed) < len(accepted):
        lacking = len(accepted) - len(timed)
        summary.notes.append(f"{lacking} positions without time, height or sigmas, or with a repeated time")
    return timed


def _fixed_or_in_holes(positions: pd.DataFrame, max_gap_s: float) -> ArrayB:
    """Which positions (n,) are fixed, or float where fixed ones leave a hole longer than ``max_gap_s``."""
    fixed = (positions["fix"] == "fixed").to_numpy()
    t = positions["t_gps_s"].to_numpy(np.float64)
    known = np.concatenate([[-np.inf], np.sort(t[fixed & np.isfinite(t)]), [np.inf]])
    after = np.searchsorted(known, t, side="left").clip(1, len(known) - 1)
    hole = known[after] - known[after - 1] > max_gap_s
    return np.asarray(fixed | (hole & (positions["fix"] == "float").to_numpy()))


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
        summary.notes.append("No INS with positions of its own: the positions could not be checked")
        return positions
    t_ins = known["t_gps_s"].to_numpy()
    coarse = frame.from_geodetic(known["lat_deg"], known["lon_deg"], known["h_ell_m"])
    enu = frame.from_geodetic(positions["lat_deg"], positions["lon_deg"], positions["h_ell_m"])
    d = enu - np.column_stack([np.interp(t, t_ins, coarse[:, axis]) for axis in range(3)])
    sigma = np.column_stack(
        [np.interp(t, t_ins, known[name]) for name in ("sigma_east_m", "sigma_north_m", "sigma_up_m")]
    )
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
