"""One trajectory from INS, antenna positions and image poses: a batch smoother.

All inputs enter one least-squares problem over the whole survey, each with errors of the kind it has: slow
errors of INS attitudes, of its velocity and of the positions (Gauss-Markov), the images' own covariances with
those of neighbours, one mount and one clock for all images, and jitter of each image's time along the motion.
What an input does not give, the others carry; what none gives is refused.
"""

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from thalweg.core.errors import CoverageError, InputError
from thalweg.core.frames import LocalFrame
from thalweg.core.rigid import Rigid
from thalweg.core.timescales import utc_text_from_gps
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayF
from thalweg.images.model.poses import ImagePoses
from thalweg.navigation.fusion.errors import ErrorModel, with_errors
from thalweg.navigation.fusion.inputs import Antenna, Camera, Nodes, antenna_of, camera_of, place_nodes
from thalweg.navigation.fusion.model import clock_unit
from thalweg.navigation.fusion.outages import outages_of
from thalweg.navigation.fusion.output import poses, trajectory_of
from thalweg.navigation.fusion.report import Counts, facts_of, observation_table
from thalweg.navigation.fusion.screen import jumped_images, jumped_positions
from thalweg.navigation.fusion.settings import FusionSettings, Layout
from thalweg.navigation.fusion.solver import Observed, Solved, solve
from thalweg.navigation.fusion.walk import walk_factors
from thalweg.navigation.ins_gnss.reference import Reference, make_reference
from thalweg.navigation.ins_gnss.selection import (
    ATTITUDE_INITIALISED,
    TrajectorySummary,
    agree_with_ins,
    check_origin,
    usable_positions,
    usable_states,
)
from thalweg.navigation.ins_gnss.trajectory import break_at_gaps

_MOVE_NODES_S = 0.02
"""A clock offset beyond this moves the nodes of the images: within it motion of 1 m/s^2 is even to 0.2 mm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fused:
    """The fused trajectory and how it came about.

    Parameters
    ----------
    trajectory : at the times of the INS.
    observations : one line an observation: see `fused_report.observation_table`.
    facts : JSON-able: counts, groups, clock offset, mount, sigmas.
    """

    trajectory: Trajectory
    observations: pd.DataFrame
    facts: dict[str, Any]
    reference: Reference
    nodes: Nodes
    solved: Solved
    settings: FusionSettings
    errors: ErrorModel

    def poses(self, t_gps_s: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF]:
        """Position (k, 3), ``R_wcs_ics`` (k, 3, 3) and covariance (k, 6, 6) at any times within the INS."""
        return poses(t_gps_s, self.reference, self.nodes, self.solved, self.settings)


def fuse_trajectory(
    states: pd.DataFrame,
    frame: LocalFrame,
    settings: FusionSettings,
    *,
    positions: pd.DataFrame | None = None,
    lever_ics_antenna_m: ArrayLike = (0.0, 0.0, 0.0),
    sigma_lever_m: ArrayLike = (0.0, 0.0, 0.0),
    images: ImagePoses | None = None,
    T_ccs_ics: Rigid | None = None,
    images_hold_positions: bool = False,
    sigma_attitude_rad: ArrayLike,
    max_attitude_gap_s: float,
    required_status: int = ATTITUDE_INITIALISED,
) -> Fused:
    """Join INS, antenna positions and image poses.

    Parameters
    ----------
    states : table kind ``ins_state``.
    frame : the world frame.
    settings : how the inputs err.
    positions : table kind ``gnss_position``, or None.
    lever_ics_antenna_m, sigma_lever_m : (3,) antenna in ics and its standard deviations.
    images : poses of images, or None.
    T_ccs_ics : mount of the camera with its covariance; needed with ``images``.
    images_hold_positions : whether the antenna's positions were observations of the image block. Those
        between its first and last image are then part of the image poses and are not counted once more.
    sigma_attitude_rad : (3,) roll, pitch, heading; stands in where the INS log states none.
    max_attitude_gap_s : longest hole between INS states that is bridged.
    required_status : bits of the filter status that a state must have.

    Raises
    ------
    InputError : no usable INS state; neither positions nor image poses that could place the boat; the images
        lie in another world frame, or their mount is missing.
    CoverageError : the inputs do not overlap in time, or no pose is known well enough.
    """
    summary = TrajectorySummary(n_positions=0 if positions is None else len(positions), n_states=len(states))
    ins = usable_states(states, summary, max_attitude_gap_s, required_status)
    counts = Counts()
    usable = _positions(positions, ins, frame, settings, summary, counts)
    _check_images(images, frame, T_ccs_ics)
    if images_hold_positions and usable is not None and images is not None:
        usable = _beside_images(usable, images, counts)
    near_t, near = _whereabouts(usable, images, frame)
    reference = make_reference(
        ins, frame, sigma_attitude_rad=sigma_attitude_rad, max_attitude_gap_s=max_attitude_gap_s,
        use_velocity=settings.use_ins_velocity, near_t_s=near_t, near_wcs_m=near,
    )  # fmt: skip
    antenna = _antenna(usable, reference, frame, lever_ics_antenna_m, sigma_lever_m, counts)
    camera = _camera(images, reference, T_ccs_ics, settings, counts)
    _refuse_nothing(antenna, camera, reference, counts)
    layout = Layout.of(gnss=antenna is not None, camera=camera is not None)
    nodes, observed, solved, shift_s = _solved(reference, antenna, camera, layout, settings)
    nodes, settings, solved, errors = with_errors(
        reference, nodes, observed, solved, layout, settings, clock_start_s=-shift_s
    )
    trajectory = trajectory_of(frame, reference, nodes, solved, settings)
    check_origin(trajectory.position_wcs_m, frame)
    n_valid = int(trajectory.valid.sum())
    if n_valid == 0:
        best = trajectory.sigma_position_m.max(axis=1).min()
        angle = np.rad2deg(trajectory.sigma_roll_pitch_heading_rad().max(axis=1).min())
        raise CoverageError(
            f"no pose is known well enough: sigmas are at least {best:.3f} m and {angle:.2f} deg",
            expected=f"sigmas below {settings.max_sigma_position_m:g} m and "
            f"{settings.max_sigma_attitude_deg:g} deg (fused.max_sigma_position_m, max_sigma_attitude_deg)",
            cure="Add what is missing: " + (", ".join(counts.missing()) or "better positions or images"),
        )
    notes = [*summary.notes, *errors.notes()]
    facts = facts_of(
        solved, observed, layout, settings, counts, trajectory, clock_shift_s=shift_s, notes=notes
    )
    facts |= {"errors": errors.facts(), "outages": outages_of(observed, reference)}
    whole = break_at_gaps(trajectory, max_attitude_gap_s, summary)
    return Fused(
        trajectory=whole,
        observations=observation_table(observed, solved, layout, images, settings, clock_shift_s=shift_s),
        facts=facts,
        reference=reference,
        nodes=nodes,
        solved=solved,
        settings=settings,
        errors=errors,
    )


def _solved(
    reference: Reference,
    antenna: Antenna | None,
    camera: Camera | None,
    layout: Layout,
    settings: FusionSettings,
) -> tuple[Nodes, Observed, Solved, float]:
    """The solution; nodes of the images move with the clock offset until it is found at their times."""
    shift = 0.0
    nothing = np.zeros(0)
    for attempt in range(3):
        t_antenna = nothing if antenna is None else antenna.t_gps_s
        t_camera = nothing if camera is None else camera.t_gps_s
        nodes, of_antenna, of_camera = place_nodes(reference, settings, t_antenna, t_camera)
        antenna = None if antenna is None else dataclasses.replace(antenna, node=of_antenna)
        camera = None if camera is None else dataclasses.replace(camera, node=of_camera)
        none = np.zeros(0, dtype=np.bool_)
        observed = Observed.of(
            antenna,
            camera,
            none if antenna is None else jumped_positions(antenna, reference, settings),
            none if camera is None else jumped_images(camera, reference, settings),
        )
        solved = solve(reference, nodes, observed, layout, settings, clock_start_s=-shift)
        if camera is None:
            break
        more = float(np.mean(solved.x[of_camera, layout.clock])) * clock_unit(settings)
        moved = camera.t_gps_s + more
        if abs(more) < _MOVE_NODES_S or attempt == 2 or not reference.inside(moved).all():
            break
        shift += more
        camera = dataclasses.replace(camera, t_gps_s=moved)
    walk = walk_factors(reference, nodes, observed, solved, settings)
    if walk is not None:
        nodes = dataclasses.replace(nodes, walk=walk)
        again = solve(
            reference, nodes, observed, layout, settings,
            clock_start_s=-shift, factors=solved.factors, start=solved.x,
        )  # fmt: skip
        solved = dataclasses.replace(again, n_solutions=solved.n_solutions + again.n_solutions)
    return nodes, observed, solved, shift


def _positions(
    positions: pd.DataFrame | None,
    ins: pd.DataFrame,
    frame: LocalFrame,
    settings: FusionSettings,
    summary: TrajectorySummary,
    counts: Counts,
) -> pd.DataFrame | None:
    """Usable positions, or None if there are none at all."""
    if positions is None or not len(positions):
        return None
    counts.given["position"] = len(positions)
    accepted = positions["fix"].isin(settings.accept_fixes)
    counts.dropped["position"] = {"kind of solution": int((~accepted).sum())}
    if not accepted.any():
        return None
    used = usable_positions(positions, list(settings.accept_fixes), summary)
    sigmas = used[["sigma_east_m", "sigma_north_m", "sigma_up_m"]].to_numpy()
    timed, positive = len(used), np.asarray(np.min(sigmas, axis=1) > 0)
    agreeing = agree_with_ins(used.iloc[np.flatnonzero(positive)], ins, frame, summary)
    counts.dropped["position"] |= {
        "no time, height or sigma, or a repeated time": int(accepted.sum()) - timed,
        "a sigma of zero": int((~positive).sum()),
        "far from the INS's own": int(positive.sum()) - len(agreeing),
    }
    return agreeing


def _beside_images(positions: pd.DataFrame, images: ImagePoses, counts: Counts) -> pd.DataFrame:
    """Positions before the first and after the last image that is timed and oriented."""
    t = images.t_gps_s[images.oriented & np.isfinite(images.t_gps_s)]
    begin, end = (t.min(), t.max()) if len(t) else (np.inf, -np.inf)
    held = positions["t_gps_s"].between(begin, end).to_numpy()
    counts.dropped["position"]["part of the image poses"] = int(held.sum())
    return positions[~held]


def _check_images(images: ImagePoses | None, frame: LocalFrame, T_ccs_ics: Rigid | None) -> None:
    if images is None:
        return
    if T_ccs_ics is None:
        raise InputError(
            "there are image poses, but no mount of the camera",
            expected="T_ccs_ics with its covariance",
            cure="State mounts.camera, or the calibration of the boat",
        )
    if images.frame != frame:
        raise InputError(
            f"the image poses lie in the world frame of {images.frame}",
            expected=str(frame),
            cure="Orient the images in the campaign's frame, or set campaign.origin to theirs",
        )


def _whereabouts(
    positions: pd.DataFrame | None, images: ImagePoses | None, frame: LocalFrame
) -> tuple[ArrayF, ArrayF]:
    """Times and places by which the INS's level is turned into wcs; the frame's origin if there are none."""
    if positions is not None and len(positions):
        place = frame.from_geodetic(positions["lat_deg"], positions["lon_deg"], positions["h_ell_m"])
        return positions["t_gps_s"].to_numpy(), place
    if images is not None:
        use = images.oriented & np.isfinite(images.t_gps_s)
        order = np.argsort(images.t_gps_s[use], kind="stable")
        if use.any():
            return images.t_gps_s[use][order], images.centre_wcs_m[use][order]
    return np.zeros(1), np.zeros((1, 3))


def _antenna(
    positions: pd.DataFrame | None,
    reference: Reference,
    frame: LocalFrame,
    lever_ics_m: ArrayLike,
    sigma_lever_m: ArrayLike,
    counts: Counts,
) -> Antenna | None:
    if positions is None:
        return None
    inside = reference.inside(positions["t_gps_s"].to_numpy())
    counts.dropped["position"]["outside the INS or in a hole of it"] = int((~inside).sum())
    if not inside.any():
        return None
    return antenna_of(positions[inside], frame, lever_ics_m, sigma_lever_m)


def _camera(
    images: ImagePoses | None,
    reference: Reference,
    T_ccs_ics: Rigid | None,
    settings: FusionSettings,
    counts: Counts,
) -> Camera | None:
    if images is None or T_ccs_ics is None:
        return None
    timed = images.oriented & np.isfinite(images.t_gps_s)
    sound = timed & np.isfinite(images.cov_pose_wcs).all(axis=(1, 2))
    use = sound & reference.inside(images.t_gps_s)
    counts.given["image"] = len(images.images)
    counts.dropped["image"] = {
        "not oriented": int((~images.oriented).sum()),
        "no time": int((images.oriented & ~timed).sum()),
        "no covariance": int((timed & ~sound).sum()),
        "outside the INS or in a hole of it": int((sound & ~use).sum()),
    }
    return camera_of(images, use, T_ccs_ics, settings.sigma_jitter_s) if use.any() else None


def _refuse_nothing(
    antenna: Antenna | None, camera: Camera | None, reference: Reference, counts: Counts
) -> None:
    if antenna is not None or camera is not None:
        return
    span = " .. ".join(utc_text_from_gps(float(reference.t_gps_s[i])) for i in (0, -1))
    raise InputError(
        "nothing places the boat in the world: " + "; ".join(counts.words()),
        expected=f"antenna positions or oriented images with times within the INS, {span}",
        cure="Check fused.accept_fixes and the clocks of both; the INS alone cannot tell where it is",
    )
