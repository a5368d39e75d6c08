"""One trajectory from INS, antenna positions and image poses: a batch smoother.

All inputs enter one least-squares problem over the whole survey, each with errors of the kind it has: slow
errors of INS attitudes, of its velocity and of the positions (Gauss-Markov), the images' own covariances with
those of neighbours, one mount and one clock for all images, and jitter of each image's time along the motion.
What an input does not give, the others carry; what none gives is refused.
"""

import dataclasses
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from thalweg.core import (
    ArrayB,
    ArrayF,
    ArrayI,
    CoverageError,
    ErrorChain,
    InputError,
    LocalFrame,
    Rigid,
    Trajectory,
    cross_matrix,
    exp_rotation,
    frame_in_words,
    root_mean_square,
    utc_text_from_gps,
    with_rest,
)
from thalweg.images.model import ImagePoses
from thalweg.navigation.fusion.errors import FusionErrors, spread_over, with_errors
from thalweg.navigation.fusion.model import (
    GROUPS,
    MODEL,
    POSE,
    RESET,
    WHITE_SHARE,
    Antenna,
    Camera,
    Factors,
    FusionSettings,
    Layout,
    Nodes,
    Reference,
    Sampled,
    antenna_of,
    attitude,
    camera_of,
    clock_unit,
    make_reference,
    pair_transition,
    place_nodes,
)
from thalweg.navigation.fusion.solver import (
    Observed,
    Solved,
    first_offset,
    jumped_images,
    jumped_positions,
    smooth,
    solve,
)
from thalweg.navigation.ins_gnss import (
    ATTITUDE_INITIALISED,
    TrajectorySummary,
    agree_with_ins,
    break_at_gaps,
    check_origin,
    usable_positions,
    usable_states,
)

_MOVE_NODES_S = 0.02
"""A clock offset beyond this moves the nodes of the images: within it motion of 1 m/s^2 is even to 0.2 mm."""
CHAIN_STEP_S: Final = 0.05
"""Least interval of the nodes at which errors are told: a boat's pose is one within a tenth of a second."""
_CHUNK: Final = 5000
"""Times that are computed at once: some 10 MB of matrices."""
_LONG: Final = 3.0
"""A gap longer than this many usual ones is one."""
_LAG_RATIO: Final = 1.5
"""Ratio of the lengths of windows from one to the next."""
_STARTS: Final = 8
"""Windows begin every so many-th of their length."""
_LEAST_WINDOWS: Final = 3
_MOST_WINDOWS: Final = 2000
"""Of one length; a long survey holds more than are needed."""
_LEAST_DENSITY: Final = 1e-12
"""A boat that moves as evenly, to a micrometre in a second, m^2/s^3."""
_BOUNDS: Final = (1.0, 1e8)
"""Of the factors. A smaller walk than that of the steps would contradict the velocities at both ends."""
LEAST_S: Final = 1.0
"""Shorter gaps are none."""
_USUAL: Final = 3.0
"""Neither are those of less than so many usual intervals."""

_KINDS = {"position": "antenna positions", "image": "image poses"}


@dataclass(slots=True)
class Counts:
    """How many observations of each kind were given, and why some could not enter."""

    given: dict[str, int] = field(default_factory=dict)
    dropped: dict[str, dict[str, int]] = field(default_factory=dict)

    def words(self) -> list[str]:
        """One phrase for each kind of observation: how many there were, and what became of them."""
        out = []
        for kind, name in _KINDS.items():
            why = ", ".join(f"{n} {text}" for text, n in self.dropped.get(kind, {}).items() if n)
            n = self.given.get(kind, 0)
            out.append(f"{n} {name}" + (f" ({why})" if why else "") if n else f"no {name}")
        return out

    def missing(self) -> list[str]:
        """Kinds of observations that there are none of."""
        return [name for kind, name in _KINDS.items() if not self.given.get(kind, 0)]


# ---------------------------------------------------------------- trajectory


@dataclass(frozen=True, slots=True, kw_only=True)
class Fused:
    """The fused trajectory and how it came about.

    Parameters
    ----------
    trajectory : at the times of the INS.
    observations : one line an observation: see `fused_report.observation_table`.
    facts : JSON-able: counts, groups, clock offset, mount, sigmas.
    reference, nodes, observed, layout, solved, errors : the task and its solution.
    stated, settings : as stated, and with the times that the survey shows.
    clock_start_s : prior mean of the clock offset about the nodes of the images.
    """

    trajectory: Trajectory
    observations: pd.DataFrame
    facts: dict[str, Any]
    reference: Reference
    nodes: Nodes
    observed: Observed
    layout: Layout
    solved: Solved
    stated: FusionSettings
    settings: FusionSettings
    errors: FusionErrors
    clock_start_s: float

    def poses(self, t_gps_s: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF]:
        """Position (k, 3), ``R_wcs_ics`` (k, 3, 3) and covariance (k, 6, 6) at any times within the INS."""
        return poses(t_gps_s, self.reference, self.nodes, self.solved, self.settings)

    def whole(self) -> Solved:
        """The solution with covariances of all states: also of those beside the pose."""
        task = (self.reference, self.nodes, self.observed, self.solved, self.layout)
        if self.errors.priors:
            return spread_over(
                self.errors, *task, self.stated, clock_start_s=self.clock_start_s, part=self.layout.n
            )
        at = self.reference.at(self.nodes.t_gps_s)
        return smooth(
            self.solved.x, at, self.nodes, self.observed, self.layout, self.settings, self.solved.factors,
            start_m=first_offset(at, self.observed), clock_start_s=self.clock_start_s, part=self.layout.n,
        )  # fmt: skip

    def image_poses(self, images: ImagePoses, whole: Solved) -> ImagePoses:
        """The poses of the images, moved by the errors that all sensors together find in them.

        A block on antenna positions alone can turn about the way of the boat; the INS knows better, and where
        the camera sits on the boat follows from the whole survey. Images that did not enter keep their pose.

        Parameters
        ----------
        images : as `fuse_trajectory` took them.
        whole : of this trajectory.

        Returns
        -------
        poses : each with its covariance; those of neighbours are not told (zero).
        """
        camera = self.observed.camera
        if camera is None:
            return images
        k, own = camera.index, slice(self.layout.camera, self.layout.camera + 6)
        # errors of the body's pose as errors of the image's: the lever turns with it
        lever = camera.position_wcs_m - images.centre_wcs_m[k]
        root = camera.root.copy()
        root[:, :3] += cross_matrix(lever) @ camera.root[:, 3:]
        slow = np.sqrt(1 - WHITE_SHARE) * root
        white = np.sqrt(WHITE_SHARE) * self.solved.factors["camera"] * root
        move = np.einsum("nij,nj->ni", slow, self.solved.x[camera.node, own])
        centre, R = images.centre_wcs_m.copy(), images.R_wcs_ccs.copy()
        cov, following = images.cov_pose_wcs.copy(), images.cov_next.copy()
        centre[k] += move[:, :3]
        R[k] = exp_rotation(move[:, 3:]) @ R[k]
        known = whole.cov[camera.node][:, own, own]
        cov[k] = slow @ known @ np.swapaxes(slow, 1, 2) + white @ np.swapaxes(white, 1, 2)
        following[k] = 0.0
        return dataclasses.replace(
            images, centre_wcs_m=centre, R_wcs_ccs=R, cov_pose_wcs=cov, cov_next=following
        )

    def error_chains(self, whole: Solved | None = None) -> list[ErrorChain]:
        """How the errors of the poses hang together over time.

        All states of the smoother are one Markov chain: also those beside the pose (slow errors of positions
        and images, mount, clock), which is why poses far from each other still err alike.
        """
        whole = self.whole() if whole is None else whole
        pose = _pose_by_states(self.solved.x, self.reference.at(self.nodes.t_gps_s), self.settings)
        chain = ErrorChain.of_covariances(
            "smoothed trajectory", self.nodes.t_gps_s, whole.cov, whole.cross, pose, step_s=CHAIN_STEP_S
        )
        return with_rest(self.trajectory, [chain], chain.t_gps_s, step_s=CHAIN_STEP_S)


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

    Raises
    ------
    InputError : no usable INS state; neither positions nor image poses that could place the boat; the images
        lie in another world frame, or their mount is missing.
    CoverageError : the inputs do not overlap in time, or no pose is known well enough.
    """
    summary = TrajectorySummary(n_positions=0 if positions is None else len(positions), n_states=len(states))
    ins = usable_states(states, summary, max_attitude_gap_s, ATTITUDE_INITIALISED)
    counts = Counts()
    usable = _positions(positions, ins, frame, settings, summary, counts)
    _check_images(images, frame, T_ccs_ics)
    if images_hold_positions and usable is not None and images is not None:
        usable = _beside_images(usable, images, counts)
    near_t, near = _whereabouts(usable, images, frame)
    reference = make_reference(
        ins,
        frame,
        sigma_attitude_rad=sigma_attitude_rad,
        max_attitude_gap_s=max_attitude_gap_s,
        use_velocity=settings.use_ins_velocity,
        near_t_s=near_t,
        near_wcs_m=near,
    )
    antenna = _antenna(usable, reference, frame, lever_ics_antenna_m, sigma_lever_m, counts)
    camera = _camera(images, reference, T_ccs_ics, settings, counts)
    _refuse_nothing(antenna, camera, reference, counts)
    layout = Layout.of(gnss=antenna is not None, camera=camera is not None)
    nodes, observed, solved, shift_s = _solved(reference, antenna, camera, layout, settings)
    as_stated = settings
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
        observed=observed,
        layout=layout,
        solved=solved,
        stated=as_stated,
        settings=settings,
        errors=errors,
        clock_start_s=-shift_s,
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
            reference,
            nodes,
            observed,
            layout,
            settings,
            clock_start_s=-shift,
            factors=solved.factors,
            start=solved.x,
        )
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
    used = usable_positions(positions, settings.accept_fixes, summary)
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
            f"the image poses lie in the world frame of {frame_in_words(images.frame)}",
            expected=frame_in_words(frame),
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


# ---------------------------------------------------------------- the pose between nodes: mean and covariance
# given the states of both neighbours
#
# Between two nodes no observation lies, so the states there depend on those of both nodes only::
#
#     x(t) = A x_k + B x_k+1 + w,     B = Q_s F_r^T Q^-1,     A = F_s - B F,     cov w = Q_s - B F_r Q_s
#
# with transition and noise ``F_s, Q_s`` from the node to ``t``, ``F_r`` from there to the next node, and ``F,
# Q`` of the whole interval.


def pose_states(
    t_gps_s: ArrayF, nodes: Nodes, solved: Solved, settings: FusionSettings
) -> tuple[ArrayF, ArrayF]:
    """States of the pose (k, 10) and their covariance (k, 10, 10) at times within the nodes."""
    t = np.asarray(t_gps_s, dtype=np.float64)
    node = nodes.t_gps_s
    left = np.searchsorted(node, t, side="right") - 1
    # the last node, and those of the same time, belong to the interval before them
    left = np.minimum(left, int(np.searchsorted(node, node[-1], side="left")) - 1)
    A, B, extra = _between(t, left, nodes, settings, solved.factors)
    here, there = solved.x[left, :POSE], solved.x[left + 1, :POSE]
    mean = (A @ here[:, :, None] + B @ there[:, :, None])[:, :, 0]
    C, D, X = solved.cov[left], solved.cov[left + 1], solved.cross[left]
    At, Bt = np.swapaxes(A, 1, 2), np.swapaxes(B, 1, 2)
    mixed = A @ X @ Bt
    cov = A @ C @ At + B @ D @ Bt + mixed + np.swapaxes(mixed, 1, 2) + extra
    return mean, (cov + np.swapaxes(cov, 1, 2)) / 2


def poses(
    t_gps_s: ArrayF, reference: Reference, nodes: Nodes, solved: Solved, settings: FusionSettings
) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Position (k, 3), ``R_wcs_ics`` (k, 3, 3) and covariance (k, 6, 6) at times within the nodes."""
    t = np.asarray(t_gps_s, dtype=np.float64)
    parts = [
        _poses(t[first : first + _CHUNK], reference, nodes, solved, settings)
        for first in range(0, max(len(t), 1), _CHUNK)
    ]
    position, R, cov = (np.concatenate(values) for values in zip(*parts, strict=True))
    return position, R, cov


def _poses(
    t_gps_s: ArrayF, reference: Reference, nodes: Nodes, solved: Solved, settings: FusionSettings
) -> tuple[ArrayF, ArrayF, ArrayF]:
    mean, cov = pose_states(t_gps_s, nodes, solved, settings)
    at = reference.at(t_gps_s)
    R, _ = attitude(mean, at, settings)
    J = _pose_by_states(mean, at, settings)
    return at.way_m + mean[:, :3], R, J @ cov @ np.swapaxes(J, 1, 2)


def _pose_by_states(x: ArrayF, at: Sampled, settings: FusionSettings) -> ArrayF:
    """Derivative (k, 6, 10) of shift and small rotation in wcs to the states of the pose."""
    J = np.zeros((len(x), 6, POSE))
    J[:, :3, :3] = np.eye(3)
    J[:, 3:, 6:] = attitude(x, at, settings)[1]
    return J


def trajectory_of(
    frame: LocalFrame, reference: Reference, nodes: Nodes, solved: Solved, settings: FusionSettings
) -> Trajectory:
    """Trajectory at the times of the INS; valid where position and attitude are known well enough."""
    t = reference.t_gps_s
    position, R, cov = poses(t, reference, nodes, solved, settings)
    made = Trajectory(
        frame=frame,
        t_gps_s=t,
        position_wcs_m=position,
        quaternion_wcs_ics=Rotation.from_matrix(R).as_quat(),
        cov_pose_wcs=cov,
        valid=np.ones(len(t), dtype=np.bool_),
    )
    valid = (made.sigma_position_m < settings.max_sigma_position_m).all(axis=1)
    limit = np.deg2rad(settings.max_sigma_attitude_deg)
    valid &= (made.sigma_roll_pitch_heading_rad() < limit).all(axis=1)
    made.valid[:] = valid
    return made


def _between(
    t: ArrayF, left: ArrayI, nodes: Nodes, settings: FusionSettings, factors: Factors
) -> tuple[ArrayF, ArrayF, ArrayF]:
    """``A, B, cov w`` (k, 10, 10) of times in the intervals from nodes ``left``."""
    k = len(t)
    T = nodes.t_gps_s[left + 1] - nodes.t_gps_s[left]
    s = np.clip(t - nodes.t_gps_s[left], 0.0, T)
    kind = nodes.kind[left + 1]
    A, B, extra = (np.zeros((k, POSE, POSE)) for _ in range(3))
    F, Q = _pair(T, kind, settings, factors)
    Fs, Qs = _pair(s, kind, settings, factors)
    Fr, _ = _pair(T - s, kind, settings, factors)
    b = Qs @ np.swapaxes(Fr, 1, 2) @ np.linalg.inv(Q)
    a = Fs - b @ F
    w = Qs - b @ Fr @ Qs
    for axis in range(3):
        both = np.ix_(np.arange(k), np.array([axis, 3 + axis]), np.array([axis, 3 + axis]))
        A[both], B[both] = a, b
        # the factor of the noise drops out of a and b
        extra[both] = w * nodes.walk[left + 1, axis, None, None]
    singles = ("roll_pitch", 6), ("roll_pitch", 7), ("heading", 8), ("disturbance", 9)
    for group, i in singles:
        time = settings.disturbance_time_s if group == "disturbance" else settings.attitude_time_s
        phi, phi_s, phi_r = (np.exp(-x / time) for x in (T, s, T - s))
        q, q_s = -np.expm1(-2 * T / time), -np.expm1(-2 * s / time)
        B[:, i, i] = q_s * phi_r / q
        A[:, i, i] = phi_s - B[:, i, i] * phi
        extra[:, i, i] = np.maximum(q_s - B[:, i, i] * phi_r * q_s, 0.0) * factors[group] ** 2
    return A, B, extra


def _pair(step_s: ArrayF, kind: ArrayI, settings: FusionSettings, factors: Factors) -> tuple[ArrayF, ArrayF]:
    """Transition and noise (k, 2, 2) of position and rate."""
    f, g, dd, de, ee = pair_transition(step_s, np.where(kind == RESET, 0, kind), settings, factors).T
    one, zero = np.ones_like(f), np.zeros_like(f)
    F = np.stack([one, f, zero, g], axis=-1).reshape(-1, 2, 2)
    return F, np.stack([dd, de, de, ee], axis=-1).reshape(-1, 2, 2)


# ---------------------------------------------------------------- how far the boat moves by itself in a gap
# between observations, taken from the rest of its track
#
# Where the INS gives no velocity the boat's own is taken for a random walk, whose size the observations tell.
# They tell it for the steps between them: of a tenth of a second, in which a boat heaves and does not turn.
# In a gap of a minute a boat that turns every half minute goes several times as far as such a walk does,
# because accelerations are no white noise: they last.
#
# So the walk of a gap of length L gets the size that gaps of this length would have needed elsewhere, if that
# is more. In the parts of the track that are known, both ends of windows of length L, with their velocities,
# are taken for known and the middle is compared with what lies between them::
#
#     e = p(L/2) - (p(0) + p(L)) / 2 - L (v(0) - v(L)) / 8,      q(L) = 192 mean(e^2) / L^3
#
# as the middle of a bridged random walk of the density q has the variance q L^3 / 192 (from its covariance
# given both ends). Beyond the longest windows the accelerations are taken to walk in their turn, so that q
# grows with the square of L, until the boat would have to be faster than it is: one that turns about in the
# middle, at the standard deviation of its velocity, asks for ``q = 12 var(v) / L``. A few seconds on a
# straight leg need less than the steps do; there the sigmas stay on the safe side, as a walk has but one size
# for changes of the place and of the velocity.


def walk_factors(
    reference: Reference, nodes: Nodes, observed: Observed, solved: Solved, settings: FusionSettings
) -> ArrayF | None:
    """Factors (m, 3) of the noise of position and rate into each node; None where no gap asks for any.

    Parameters
    ----------
    reference, nodes, observed, settings : of the solution.
    solved : a solution with factors of 1.
    """
    t = nodes.t_gps_s
    seen = _seen_s(observed)
    gap_s = _gaps_s(t, seen)
    own = nodes.kind == MODEL
    steps = np.diff(seen)
    usual_s = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    long = own & (gap_s > _LONG * usual_s)
    if usual_s == 0 or not long.any():
        return None
    density = (settings.sigma_acceleration * solved.factors["acceleration"]) ** 2
    known = ~long
    known[0] = known[min(1, len(known) - 1)]
    lags_s, q, variance = _by_lag(reference, nodes, solved, settings, known, _LONG * usual_s)
    out = np.ones((len(t), 3))
    gaps = gap_s[long]
    for axis in range(3):
        out[long, axis] = _at(gaps, lags_s, q[:, axis], float(variance[axis]), density, usual_s) / density
    return np.clip(out, *_BOUNDS)


def _seen_s(observed: Observed) -> ArrayF:
    """Times of all observations that are used, in order."""
    parts = []
    if observed.antenna is not None:
        parts.append(observed.antenna.t_gps_s[observed.weight_antenna > 0])
    if observed.camera is not None:
        parts.append(observed.camera.t_gps_s[observed.weight_camera > 0])
    return np.sort(np.concatenate(parts))


def _gaps_s(t: ArrayF, seen_s: ArrayF) -> ArrayF:
    """Length (m,) of the gap between observations that the step into each node lies in.

    Before the first and behind the last one nothing holds the other end: counted twice.
    """
    middle = t - np.diff(t, prepend=t[0]) / 2
    after = np.searchsorted(seen_s, middle)
    first, last = 2 * (seen_s[0] - t[0]), 2 * (t[-1] - seen_s[-1])
    edges = np.concatenate([[first], np.diff(seen_s), [last]])
    return np.asarray(edges[after])


def _by_lag(
    reference: Reference,
    nodes: Nodes,
    solved: Solved,
    settings: FusionSettings,
    known: ArrayB,
    shortest_s: float,
) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Lengths (k,) of windows, the density (k, 3) each asks for, and the variance (3,) of the velocity."""
    t = nodes.t_gps_s
    edge = np.diff(np.concatenate([[0], known.astype(np.int64), [0]]))
    begin, end = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1) - 1
    stretches = [
        (float(t[max(i - 1, 0)]), float(t[j])) for i, j in zip(begin.tolist(), end.tolist(), strict=True)
    ]
    longest_s = max((b - a for a, b in stretches), default=0.0)
    lags: list[float] = []
    density: list[ArrayF] = []
    variance = np.full(3, np.inf)
    lag = shortest_s
    while lag * (1 + (_LEAST_WINDOWS - 1) / _STARTS) <= longest_s:
        starts = np.concatenate([np.arange(a, b - lag, lag / _STARTS) for a, b in stretches if b - a > lag])
        if len(starts) < _LEAST_WINDOWS:
            break
        every = -(-len(starts) // _MOST_WINDOWS)
        (p0, v0), (p1, _), (p2, v2) = (
            _track(starts[::every] + share * lag, reference, nodes, solved, settings)
            for share in (0.0, 0.5, 1.0)
        )
        e = p1 - (p0 + p2) / 2 - lag * (v0 - v2) / 8
        lags.append(lag)
        density.append(192 * np.mean(e**2, axis=0) / lag**3)
        if len(lags) == 1:
            variance = np.var(v0, axis=0)
        lag *= _LAG_RATIO
    return np.array(lags), np.array(density).reshape(-1, 3), variance


def _track(
    t: ArrayF, reference: Reference, nodes: Nodes, solved: Solved, settings: FusionSettings
) -> tuple[ArrayF, ArrayF]:
    """Position and velocity (k, 3) of the solution."""
    mean, _ = pose_states(t, nodes, solved, settings)
    at = reference.at(t)
    return at.way_m + mean[:, :3], at.velocity_mps + mean[:, 3:6]


def _at(gap_s: ArrayF, lags_s: ArrayF, q: ArrayF, variance: float, density: float, usual_s: float) -> ArrayF:
    """Density (n,) for gaps of a length."""
    if not len(lags_s):
        lags_s, q = np.array([usual_s]), np.array([density])
    inner = np.exp(np.interp(np.log(gap_s), np.log(lags_s), np.log(np.maximum(q, _LEAST_DENSITY))))
    # the greatest that was seen: the longest windows are few and may show a lull
    beyond = np.minimum(float(q.max()) * (gap_s / lags_s[-1]) ** 2, 12 * variance / gap_s)
    return np.where(gap_s > lags_s[-1], beyond, inner)


# ---------------------------------------------------------------- stretches that the fused trajectory had to
# bridge: without GNSS, or without images


def outages_of(observed: Observed, reference: Reference) -> list[dict[str, Any]]:
    """Spans of the INS without positions, and without images, that were used.

    Returns
    -------
    ``without`` (positions, images), ``begin_gps_s``, ``end_gps_s`` of each, in order of time; of a kind that
    there is nothing of, the whole survey.
    """
    first, last = float(reference.t_gps_s[0]), float(reference.t_gps_s[-1])
    out: list[dict[str, Any]] = []
    for kind, given, weight in (
        ("positions", observed.antenna, observed.weight_antenna),
        ("images", observed.camera, observed.weight_camera),
    ):
        t = np.zeros(0) if given is None else given.t_gps_s[weight > 0]
        out += [{"without": kind, "begin_gps_s": a, "end_gps_s": b} for a, b in _gaps(t, first, last)]
    return sorted(out, key=lambda gap: gap["begin_gps_s"])


def _gaps(t_gps_s: ArrayF, first: float, last: float) -> list[tuple[float, float]]:
    steps = np.diff(t_gps_s)
    usual_s = float(np.median(steps)) if len(steps) else 0.0
    edges = np.concatenate([[first], np.sort(t_gps_s), [last]])
    limit = max(LEAST_S, _USUAL * usual_s)
    return [(float(a), float(b)) for a, b in pairwise(edges.tolist()) if b - a > limit]


# ---------------------------------------------------------------- report: counts, groups of residuals, clock,
# mount


def group_facts(solved: Solved, level: float = 0.01) -> dict[str, dict[str, float | bool]]:
    """By group: normalised squares of the residuals, redundancy, chi-square band and factor of the sigma.

    ``chi_square`` is the weighted sum of squares over the redundancy; 1 if the sigmas, times their factor,
    are right. ``inside`` its band of 99 %.
    """
    out: dict[str, dict[str, float | bool]] = {}
    for group in GROUPS:
        square, redundancy = solved.groups[group]
        if redundancy < 1e-6:
            continue
        low, high = (float(chi2.ppf(p, redundancy)) / redundancy for p in (level / 2, 1 - level / 2))
        ratio = square / redundancy
        out[group] = {
            "chi_square": ratio,
            "redundancy": redundancy,
            "band_low": low,
            "band_high": high,
            "inside": bool(low <= ratio <= high),
            "sigma_factor": solved.factors[group],
        }
    return out


def camera_facts(
    solved: Solved, observed: Observed, layout: Layout, settings: FusionSettings, clock_shift_s: float
) -> dict[str, Any]:
    """Clock offset, and the mount's correction between camera and INS, each with its sigma."""
    camera = observed.camera
    if camera is None:
        return {}
    unit = clock_unit(settings)
    mount = slice(layout.mount, layout.mount + 6)
    units = np.array([1e3, 1e3, 1e3, *np.rad2deg([1.0, 1.0, 1.0])])
    correction = camera.mount_root @ solved.x[-1, mount]
    cov = camera.mount_root @ solved.last[mount, mount] @ camera.mount_root.T
    sigma = np.sqrt(np.maximum(np.diag(cov), 0.0)) * units
    prior = np.linalg.norm(camera.mount_root, axis=1) * units
    correction = correction * units
    clock = solved.x[camera.node, layout.clock] * unit + clock_shift_s
    jitter = solved.x[camera.node, layout.jitter] * camera.jitter_s
    return {
        "clock_offset_s": float(np.mean(clock)),
        "clock_offset_sigma_s": float(np.sqrt(solved.last[layout.clock, layout.clock]) * unit),
        "clock_offset_range_s": float(np.ptp(clock)),
        "jitter_rms_s": root_mean_square(jitter),
        "boresight": {
            "meaning": "correction of T_ccs_ics by INS against camera, in ccs: shift; rotation vector",
            "shift_mm": correction[:3].tolist(),
            "sigma_shift_mm": sigma[:3].tolist(),
            "prior_sigma_shift_mm": prior[:3].tolist(),
            "rotation_deg": correction[3:].tolist(),
            "sigma_rotation_deg": sigma[3:].tolist(),
            "prior_sigma_rotation_deg": prior[3:].tolist(),
        },
    }


def facts_of(
    solved: Solved,
    observed: Observed,
    layout: Layout,
    settings: FusionSettings,
    counts: Counts,
    trajectory: Trajectory,
    *,
    clock_shift_s: float,
    notes: list[str],
) -> dict[str, Any]:
    """All facts of a fused trajectory, JSON-able."""
    weights = {"position": observed.weight_antenna, "image": observed.weight_camera}
    observations = {}
    for kind, weight in weights.items():
        observations[kind] = {
            "given": counts.given.get(kind, 0),
            "used": int((weight > 0).sum()),
            "rejected": int((weight == 0).sum()),
            "dropped": {k: n for k, n in counts.dropped.get(kind, {}).items() if n},
        }
    valid = trajectory.valid
    sigma = np.median(trajectory.sigma_position_m[valid], axis=0)
    angles = np.rad2deg(np.median(trajectory.sigma_roll_pitch_heading_rad()[valid], axis=0))
    return {
        "observations": observations,
        "groups": group_facts(solved),
        **camera_facts(solved, observed, layout, settings, clock_shift_s),
        "n_nodes": len(trajectory.t_gps_s),
        "n_valid": int(valid.sum()),
        "median_sigma_east_north_up_m": sigma.tolist(),
        "median_sigma_roll_pitch_heading_deg": angles.tolist(),
        "solutions": solved.n_solutions,
        "settled": solved.settled,
        "notes": list(notes),
    }


def observation_table(
    observed: Observed,
    solved: Solved,
    layout: Layout,
    images: ImagePoses | None,
    settings: FusionSettings,
    *,
    clock_shift_s: float,
) -> pd.DataFrame:
    """One line an observation that could enter.

    Columns ``kind`` (position, image), ``name``, ``t_gps_s`` (of images as their table has it),
    ``normalised`` (root of the total error's quadratic form over its components; expected below 1), ``used``,
    and for images ``time_error_s``: offset and jitter together.
    """
    parts = []
    if observed.antenna is not None:
        n = len(observed.antenna.t_gps_s)
        parts.append(
            pd.DataFrame(
                {
                    "kind": "position",
                    "name": "",
                    "t_gps_s": observed.antenna.t_gps_s,
                    "normalised": observed.normalised_antenna / np.sqrt(3.0),
                    "used": observed.weight_antenna > 0,
                    "time_error_s": np.full(n, np.nan),
                }
            )
        )
    camera = observed.camera
    if camera is not None and images is not None:
        x = solved.x[camera.node]
        late = x[:, layout.clock] * clock_unit(settings) + x[:, layout.jitter] * camera.jitter_s
        parts.append(
            pd.DataFrame(
                {
                    "kind": "image",
                    "name": [images.images[i] for i in camera.index.tolist()],
                    "t_gps_s": images.t_gps_s[camera.index],
                    "normalised": observed.normalised_camera / np.sqrt(7.0),
                    "used": observed.weight_camera > 0,
                    "time_error_s": late + clock_shift_s,
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def count_table(facts: dict[str, Any]) -> pd.DataFrame:
    """Columns ``kind, what, n``: how many observations were given, used, rejected, or dropped and why."""
    rows: list[tuple[str, str, int]] = []
    for kind, found in facts["observations"].items():
        rows += [(kind, what, int(found[what])) for what in ("given", "used", "rejected")]
        rows += [(kind, why, n) for why, n in found["dropped"].items()]
    return pd.DataFrame(rows, columns=["kind", "what", "n"])
