"""Trajectory from GNSS antenna positions and INS attitudes (T 3.1.1, P1 eq. 7-8).

The antenna track is interpolated to the times of the INS states, and the lever arm is taken off with the
attitude of that moment: ``x_wcs_ics = x_wcs_antenna - R_wcs_ics @ lever_ics_antenna``.
"""

from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from thalweg.core.errors import CoverageError, InputError
from thalweg.core.frames import LocalFrame, attitude_axes, rotation_enu_body
from thalweg.core.timescales import utc_text_from_gps
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayF
from thalweg.navigation.ins_gnss.interpolation import (
    JITTER_S,
    Interpolated,
    bridge_with_velocity,
    interpolate_positions,
)
from thalweg.navigation.ins_gnss.selection import (
    ATTITUDE_INITIALISED,
    NAVIGATION_INITIALISED,
    TrajectorySummary,
    agree_with_ins,
    check_origin,
    usable_positions,
    usable_states,
)


def build_trajectory(
    positions: pd.DataFrame,
    states: pd.DataFrame,
    frame: LocalFrame,
    *,
    lever_ics_antenna_m: ArrayLike,
    sigma_lever_m: ArrayLike,
    accept_fixes: list[str],
    max_gap_s: float,
    max_attitude_gap_s: float,
    sigma_attitude_rad: ArrayLike,
    required_status: int = ATTITUDE_INITIALISED,
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
    accept_fixes : kinds of solution that may enter, for instance ``["fixed"]``.
    max_gap_s : longest hole between positions that is interpolated.
    max_attitude_gap_s : longest hole between INS states that is interpolated.
    sigma_attitude_rad : (3,) roll, pitch, heading; stands in where the log states none.
    required_status : bits of the filter status that a state must have; others are left out and counted.
    interpolation : positions between epochs by a cubic spline, or along the velocity of the INS.

    Raises
    ------
    InputError : no position of an accepted fix, or no state with GPS time.
    CoverageError : positions and states do not overlap in time.
    """
    summary = TrajectorySummary(n_positions=len(positions), n_states=len(states))
    used = usable_positions(positions, accept_fixes, summary)
    ins = usable_states(states, summary, max_attitude_gap_s, required_status)
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
    sigma_att = np.column_stack([
        np.where(np.isfinite(stated), stated, fallback)
        for stated, fallback in zip(
            ins[["sigma_roll_rad", "sigma_pitch_rad", "sigma_heading_rad"]].to_numpy().T,
            np.asarray(sigma_attitude_rad, dtype=np.float64),
            strict=True,
        )
    ])  # fmt: skip
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
    required_status: int = NAVIGATION_INITIALISED,
) -> tuple[Trajectory, TrajectorySummary]:
    """Trajectory of an INS that gives position and attitude itself (its own filter, or SBET).

    Parameters
    ----------
    states : table kind ``ins_state``, positions at the ics origin.
    frame, max_attitude_gap_s, sigma_attitude_rad, required_status : as in `build_trajectory`; an SBET knows
        no status, so nothing can be required of it.
    sigma_position_m : (3,) east, north, up; stands in where the log states none.

    Raises
    ------
    InputError : no state carries GPS time, or there are no sigmas of the positions.
    """
    summary = TrajectorySummary(n_positions=len(states), n_states=len(states))
    ins = usable_states(states, summary, max_attitude_gap_s, required_status)
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
