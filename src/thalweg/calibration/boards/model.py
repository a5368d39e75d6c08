"""Relative orientation of camera and lidar from a flat board instead of cones.

The camera sees a pattern on the board and knows its plane; the lidar sees points on it. Unknowns are the
relative orientation ``T_ccs_scs`` (six), the plane at each pose (three: tilt about its sides and offset along
its normal, observed by the camera with their covariance), and on request one offset of all ranges. Each lidar
point observes the range at which its nominal beam meets the plane, as in
`thalweg.calibration.camera_lidar.model`.

One pose gives three of the six; poses with normals in all three directions give all. A board that is turned
about its own normal, or only moved, adds nothing. Ranges of a lidar are off by millimetres to centimetres
that all points of a board share, so a board counts with ``sigma_board_m`` besides the noise of its points,
and the scatter of the boards is estimated along; leaving one pose out at a time says the same without a
model.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.calibration.boards.images import BoardView
from thalweg.calibration.camera_lidar.model import ORIENTATION, by_transform
from thalweg.calibration.cones.search import SearchRange, normal_set
from thalweg.calibration.cones.selection import BeamVariances
from thalweg.core.adjustment.solve import Adjusted, Linear, Observations, UnobservableError, adjust
from thalweg.core.errors import GeometryError
from thalweg.core.rigid import Rigid, exp_rotation
from thalweg.core.types import AnyArray, ArrayB, ArrayF

# ---------------------------------------------------------------- which points of a scan lie on a board:
# found from a rough orientation, without cropping by hand
#
# As for cones (`thalweg.calibration.cones.search`), many orientations around the nominal one are judged by
# beams that should meet the boards: on it, through it, or stopped before it. All pictures and scans count
# together, so that a wall which looks like the board in one of them does not win.


_BEAMS: Final = 500
"""Beams of each scan that judge an orientation."""
_KEPT: Final = 30
_WIDTHS_M: Final = (0.4, 0.2, 0.1, 0.06)
_STEPS: Final = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardBeams:
    """Beams seen from a board.

    ``range_m`` (n,) at which the plane is met, NaN where it is not; ``place_m`` (n, 2) there along the sides
    of the board; ``slope`` (n,) ``n . d``, negative on the side of the pattern.
    """

    range_m: ArrayF
    place_m: ArrayF
    slope: ArrayF

    def inside(self, half_m: ArrayF, margin_m: float) -> ArrayB:
        """Which beams meet the front of the board at least a margin inside its edges."""
        on = (np.abs(self.place_m) < half_m - margin_m).all(axis=1)
        return np.asarray(on & (self.range_m > 0) & (self.slope < 0))


def meet_board(view: BoardView, origin_m: ArrayF, beam: ArrayF) -> BoardBeams:
    """Where beams (n, 3), unit vectors in ccs from an origin (3,), meet the plane of a board."""
    T = view.T_ccs_board
    slope = beam @ view.normal
    with np.errstate(divide="ignore", invalid="ignore"):
        way = (view.normal @ (T.shift_m - origin_m)) / slope
        place = (origin_m + way[:, None] * beam - T.shift_m) @ T.R[:, :2]
    return BoardBeams(range_m=way, place_m=place, slope=slope)


def search_boards(
    views: Sequence[BoardView], scans: Sequence[ArrayF], nominal: Rigid, within: SearchRange
) -> tuple[Rigid, float]:
    """Orientation ``T_ccs_scs`` near the nominal one that puts boards onto scans, and its balance of beams.

    Parameters
    ----------
    views : board in the camera frame at each pose.
    scans : (n, 3) whole scan of each pose, in scs.
    nominal : T_ccs_scs.
    within : how far it may be off.

    Raises
    ------
    GeometryError : no beam passes near a board.
    """
    tries = normal_set(within.tries) * np.repeat([within.shift_m, np.deg2rad(within.angle_deg)], 3)
    near = [_near(v, s, nominal, within) for v, s in zip(views, scans, strict=True)]
    if not any(len(n) for n in near):
        raise GeometryError(
            "no beam of the lidar passes near a board",
            expected="boards in the view of the lidar",
            cure="Check the nominal orientation between camera and lidar",
        )
    candidates = [nominal, *(nominal.moved(t) for t in tries)]
    scores = [_score(c, views, near, 0.15)[0] for c in candidates]
    best = np.argsort([-s for s in scores], kind="stable")[:_KEPT]
    sigmas = np.repeat([2 * within.shift_m, 2 * np.deg2rad(within.angle_deg)], 3)
    refined = [_refined(candidates[i], nominal, sigmas, views, near) for i in best]
    finals = [_score(c, views, near, 0.06) for c in refined]
    winner = int(np.argmax([s for s, _ in finals]))
    score, beams = finals[winner]
    return refined[winner], score / max(beams, 1)


def _near(view: BoardView, scan: ArrayF, nominal: Rigid, within: SearchRange) -> ArrayF:
    T = view.T_ccs_board
    beam = scan @ nominal.R.T
    beam /= np.linalg.norm(beam, axis=1, keepdims=True)
    arm = T.shift_m - nominal.shift_m
    radius = float(np.hypot(*view.half_m)) + 2 * within.shift_m
    radius += float(np.linalg.norm(arm)) * 2 * np.sqrt(3) * np.deg2rad(within.angle_deg)
    along = beam @ arm
    rows = np.flatnonzero((along > 0) & (arm @ arm - along**2 < radius**2))
    if len(rows) > _BEAMS:
        rows = rows[np.linspace(0, len(rows) - 1, _BEAMS).astype(np.int64)]
    return np.asarray(scan[rows])


def _score(
    T: Rigid, views: Sequence[BoardView], scans: Sequence[ArrayF], width_m: float
) -> tuple[float, int]:
    score, beams = 0.0, 0
    for view, scan in zip(views, scans, strict=True):
        reach = np.linalg.norm(scan, axis=1)
        met = meet_board(view, T.shift_m, scan @ T.R.T / reach[:, None])
        on = met.inside(view.half_m, 0.0)
        off = reach[on] - met.range_m[on]
        score += float(np.sum(np.abs(off) < width_m) - np.sum(off >= width_m))
        beams += int(on.sum())
    return score, beams


def _refined(
    T: Rigid, nominal: Rigid, sigmas: ArrayF, views: Sequence[BoardView], scans: Sequence[ArrayF]
) -> Rigid:
    """Robust distances from the planes, of points inside the boards; the nominal orientation is observed."""
    for width in _WIDTHS_M:
        for _ in range(_STEPS):
            N, n = np.diag(1 / sigmas**2), T.error_from(nominal) / sigmas**2
            for view, scan in zip(views, scans, strict=True):
                at = T.apply(scan)
                local = (at - view.T_ccs_board.shift_m) @ view.T_ccs_board.R
                on = (np.abs(local[:, :2]) < view.half_m).all(axis=1)
                r = local[on, 2]
                weight = np.maximum(1 - (r / width) ** 2, 0.0) ** 2
                if not weight.any():
                    continue
                P = weight / (width / 3) ** 2 * (30.0 / max(float(weight.sum()), 30.0))
                arm = at[on] - T.shift_m
                J = np.hstack([np.tile(view.normal, (len(r), 1)), np.cross(arm, view.normal)])
                N = N + J.T @ (J * P[:, None])
                n = n + J.T @ (P * r)
            dx: AnyArray = -np.linalg.solve(N, n)
            T = Rigid(R=exp_rotation(dx[3:]) @ T.R, shift_m=T.shift_m + dx[:3])
            if np.abs(dx).max() < 1e-4:
                break
    return T


# ---------------------------------------------------------------- edges of a board in a scan: what tells
# where in its plane the board is
#
# Along a ring of the scanner one beam is the last on the board and the next one passes it. The edge lies
# between both, anywhere with equal chance, and the beam midway is an observation of it. Spots that lie half
# on the board count as on it or not by their strength; that shifts opposite edges in opposite directions, so
# that the middle of the board stays.


_ON_M: Final = 0.06
_PAST_M: Final = 0.15
"""A beam is on the board within the first distance of its plane, and past it beyond the second."""

_REACH_M: Final = 0.06
_CORNER_M: Final = 0.04
"""How far from the predicted edge one is looked for, and how far it must be from the corners."""

_LARGEST_STEP_RAD: Final = np.deg2rad(1.0)
_CROSSING: Final = 0.5
"""Sine of the least angle between ring and edge. Nearly along an edge the ring leaves the board as often at
what stands there, the stand above all; turn the board so that its corners look up and down."""

_SPOT_M: Final = 0.003
"""Standard deviation of what the size of the spot and the cut of the board leave."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Edges:
    """Beams (n, 3) in scs midway between on and past; ``side`` (n,): 0 along columns, 1 along rows."""

    beam_scs: ArrayF
    side: AnyArray
    sign: ArrayF
    variance_m2: ArrayF

    @classmethod
    def none(cls) -> "Edges":
        """No edges."""
        return cls(
            beam_scs=np.zeros((0, 3)), side=np.zeros(0, np.int64), sign=np.zeros(0), variance_m2=np.zeros(0)
        )

    def taken(self, rows: AnyArray) -> "Edges":
        """Some of them: what else is near the board, its stand above all, has edges that lie elsewhere."""
        return Edges(
            beam_scs=self.beam_scs[rows],
            side=self.side[rows],
            sign=self.sign[rows],
            variance_m2=self.variance_m2[rows],
        )


def find_edges(
    view: BoardView, T_ccs_scs: Rigid, points_scs_m: ArrayF, ring: AnyArray, var_across_m2: ArrayF
) -> Edges:
    """Edges of a board in a whole scan.

    Parameters
    ----------
    view : of the camera.
    T_ccs_scs : orientation, to a few centimetres and degrees.
    points_scs_m, ring : (n, 3) and (n,) of the whole scan, in any order.
    var_across_m2 : (n,) variance of points across their beams in each direction.
    """
    azimuth = np.arctan2(points_scs_m[:, 1], points_scs_m[:, 0])
    order = np.lexsort((azimuth, ring))
    points, rings, azimuth, across = (a[order] for a in (points_scs_m, ring, azimuth, var_across_m2))
    reach = np.linalg.norm(points, axis=1)
    beam = points / np.maximum(reach, 1e-9)[:, None]
    met = meet_board(view, T_ccs_scs.shift_m, beam @ T_ccs_scs.R.T)
    off = reach - met.range_m
    wide = met.inside(view.half_m, -2 * _REACH_M)
    on = wide & (np.abs(off * met.slope) < _ON_M)
    past = wide & (off > _PAST_M)
    near = (rings[1:] == rings[:-1]) & (np.diff(azimuth) < _LARGEST_STEP_RAD)
    pair = np.flatnonzero(near & ((on[:-1] & past[1:]) | (past[:-1] & on[1:])))
    if not len(pair):
        return Edges.none()
    middle = (met.place_m[pair] + met.place_m[pair + 1]) / 2
    gap = np.abs(met.place_m[pair + 1] - met.place_m[pair])
    short = np.abs(middle) - view.half_m
    side = np.argmin(np.abs(short), axis=1)
    row = np.arange(len(pair))
    other = np.abs(middle[row, 1 - side]) < view.half_m[1 - side] - _CORNER_M
    across_edge = gap[row, side] > _CROSSING * np.linalg.norm(gap, axis=1)
    good = (np.abs(short[row, side]) < _REACH_M) & other & across_edge
    row, pair, side = row[good], pair[good], side[good]
    mid = beam[pair] + beam[pair + 1]
    return Edges(
        beam_scs=mid / np.linalg.norm(mid, axis=1, keepdims=True),
        side=side,
        sign=np.sign(middle[row, side]),
        variance_m2=gap[row, side] ** 2 / 12 + across[pair] + _SPOT_M**2,
    )


def edge_rows(view: BoardView, T_ccs_scs: Rigid, edges: Edges) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Distances (n,) of edges past the board's own; derivatives by orientation (n, 6) and plane (n, 3)."""
    beam = edges.beam_scs @ T_ccs_scs.R.T
    met = meet_board(view, T_ccs_scs.shift_m, beam)
    row = np.arange(len(edges.side))
    axis = view.T_ccs_board.R[:, :2].T[edges.side]
    residual = edges.sign * met.place_m[row, edges.side] - view.half_m[edges.side]
    share = np.einsum("ij,ij->i", axis, beam) / met.slope
    # A shift of the beam by x moves its place by x less the way along the beam back into the plane.
    g = edges.sign[:, None] * (axis - share[:, None] * view.normal)
    arm = met.range_m[:, None] * beam
    by_height = edges.sign * share
    by_plane = by_height[:, None] * np.stack(
        [np.ones(len(row)), met.place_m[:, 1], -met.place_m[:, 0]], axis=1
    )
    return residual, np.hstack([g, np.cross(arm, g)]), by_plane


# ---------------------------------------------------------------- model


_SLACK_M: Final = (0.06, 0.03, 0.0, 0.0, 0.0, 0.0, 0.0)
"""What points and edges may be off besides their sigmas, round by round; edges wait for the second one."""

_STAYS: Final = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardPose:
    """One pose of the board.

    Parameters
    ----------
    view : of the camera.
    points_scs_m : (n, 3) scan of the lidar, whole or cropped.
    reflectivity : (n,) percent.
    ring : (n,) number of the laser; with it the edges of the board count, which takes the whole scan.
    """

    view: BoardView
    points_scs_m: ArrayF
    reflectivity: ArrayF | None = None
    ring: AnyArray | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardSettings:
    """How to calibrate with a board.

    Parameters
    ----------
    within : how far the nominal orientation may be off; None: it is good enough to start from.
    margin_m : distance of beams from the edges of the board, within which they are left out.
    reject_sigmas : distance of a point from the plane that makes it something else.
    max_incidence_deg : greatest angle between beam and normal.
    least_points : on a board, below which the pose is left out.
    least_angle_deg : spread of the normals in the direction in which they spread least.
    sigma_board_m : range error that all points of one board share.
    flatness_m : standard deviation of a board's offset from its pattern's plane.
    free_range_offset : one offset of all ranges is an unknown.
    """

    within: SearchRange | None = field(
        default_factory=lambda: SearchRange(shift_m=0.15, angle_deg=5.0, tries=1500)
    )
    margin_m: float = 0.04
    reject_sigmas: float = 3.5
    max_incidence_deg: float = 70.0
    least_points: int = 30
    least_angle_deg: float = 5.0
    sigma_board_m: float = 0.005
    flatness_m: float = 0.002
    free_range_offset: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardCalibration:
    """Result of `calibrate_board`.

    Parameters
    ----------
    T_ccs_scs : with covariance.
    range_offset_m : added to all ranges; 0 if it was not asked for.
    adjusted : the adjustment.
    lidar_factor, board_factor : of the variances of points and of boards, estimated.
    table : one line a pose: points, rejected, mean and RMS distance, used or why not.
    score : balance of the beams in the first search.
    """

    T_ccs_scs: Rigid
    range_offset_m: float
    adjusted: Adjusted["_State"]
    lidar_factor: float
    board_factor: float
    table: pd.DataFrame
    score: float


@dataclass(frozen=True, slots=True, kw_only=True)
class _State:
    T: Rigid
    views: tuple[BoardView, ...]
    offset_m: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _OnBoard:
    """Points of a pose that take part."""

    reach_m: ArrayF
    beam_scs: ArrayF
    variance_m2: ArrayF
    rejected: int
    edges: Edges


def calibrate_board(
    poses: Sequence[BoardPose],
    nominal: Rigid,
    beam_errors: BeamVariances,
    settings: BoardSettings | None = None,
) -> BoardCalibration:
    """Relative orientation of camera and lidar from poses of a board.

    Parameters
    ----------
    poses : of the board.
    nominal : T_ccs_scs, roughly.
    beam_errors : accuracy of the scanner.
    settings : see there.

    Raises
    ------
    UnobservableError : too few poses, or boards seen alike: names the poses and the orientation that is
        missing.
    GeometryError : the boards were not found in the scans.
    """
    settings = settings or BoardSettings()
    refuse_alike([p.view for p in poses], settings.least_angle_deg)
    start, score = nominal, float("nan")
    if settings.within is not None:
        start, score = search_boards(
            [p.view for p in poses], [p.points_scs_m for p in poses], nominal, settings.within
        )
    state = _State(T=start, views=tuple(p.view for p in poses))
    lidar, boards = 1.0, 1.0
    for slack in _SLACK_M:
        scans = [_select(state, i, p, beam_errors, settings, slack, lidar) for i, p in enumerate(poses)]
        used = [i for i, s in enumerate(scans) if len(s.reach_m) >= settings.least_points]
        refuse_alike([poses[i].view for i in used], settings.least_angle_deg, asked=len(poses))
        adjusted = _adjusted(
            replace(state, views=tuple(state.views[i] for i in used)),
            [poses[i].view for i in used],
            [scans[i] for i in used],
            settings,
            boards,
        )
        step = adjusted.x.T.error_from(state.T)
        stays = slack == 0 and bool(np.all(np.abs(step) < _STAYS * adjusted.sigmas[:6]))
        # The camera's planes stay the selection's: a plane that followed its points would choose its own.
        state = replace(state, T=adjusted.x.T, offset_m=adjusted.x.offset_m)
        if slack == 0:
            lidar *= adjusted.group_sigma0["lidar"] ** 2
            boards *= max(adjusted.group_sigma0["boards"] ** 2, 1.0 / boards)
        if stays:
            break
    return BoardCalibration(
        T_ccs_scs=adjusted.x.T.with_cov(adjusted.cov[:6, :6]),
        range_offset_m=adjusted.x.offset_m,
        adjusted=adjusted,
        lidar_factor=lidar,
        board_factor=boards,
        table=_table(poses, scans, used, state, settings),
        score=score,
    )


def refuse_alike(views: Sequence[BoardView], least_angle_deg: float, *, asked: int | None = None) -> None:
    """Refuse poses that leave a direction undetermined.

    Raises
    ------
    UnobservableError : fewer than three poses, or normals that spread too little; names the poses that are
        alike.
    """
    names = [v.name for v in views]
    if len(views) < 3:
        of = f" of {asked}" if asked is not None else ""
        raise UnobservableError(
            ["lever arm", f"with {len(views)}{of} poses of the board ({', '.join(names) or 'none'})"],
            defects=3,
            cure="Record three poses of the board or more, turned by 20 degrees about two axes, where "
            "camera and lidar both see all of it",
        )
    normals = np.stack([v.normal for v in views])
    values, vectors = np.linalg.eigh(normals.T @ normals / len(views))
    spread = np.rad2deg(np.arcsin(np.sqrt(np.clip(values, 0.0, 1.0))))
    if spread[0] >= least_angle_deg:
        return
    free = vectors[:, 0]
    angle = np.rad2deg(np.arccos(np.clip(np.abs(normals @ normals.T), 0.0, 1.0)))
    alike = [
        f"{names[i]} and {names[j]} ({angle[i, j]:.1f} deg)"
        for i in range(len(names)) for j in range(i) if angle[i, j] < 2 * least_angle_deg
    ]  # fmt: skip
    axis = np.cross(normals.mean(axis=0), free)
    words = ", ".join(f"{v:.2f}" for v in free)
    turn = ", ".join(f"{v:.2f}" for v in axis / np.linalg.norm(axis))
    raise UnobservableError(
        [f"a shift along ({words}) in ccs"],
        defects=int(np.sum(spread < least_angle_deg)),
        cure=(f"Seen the same way: {'; '.join(alike[:6])}. " if alike else "")
        + f"The normals of {len(names)} poses spread by only {spread[0]:.1f} deg in this direction. "
        f"Record poses with the board tilted by 20 degrees and more about the axis ({turn}) of the camera, "
        "both ways",
    )


def _select(
    state: _State,
    i: int,
    pose: BoardPose,
    beam_errors: BeamVariances,
    settings: BoardSettings,
    slack_m: float,
    factor: float,
) -> _OnBoard:
    reach = np.linalg.norm(pose.points_scs_m, axis=1)
    beam = pose.points_scs_m / np.maximum(reach, 1e-9)[:, None]
    met = meet_board(state.views[i], state.T.shift_m, beam @ state.T.R.T)
    on = met.inside(pose.view.half_m, settings.margin_m)
    on &= -met.slope > np.cos(np.deg2rad(settings.max_incidence_deg))
    rows: AnyArray = np.flatnonzero(on)
    brightness = np.full(len(reach), 50.0) if pose.reflectivity is None else pose.reflectivity
    along, across = beam_errors.variances(reach[rows], brightness[rows])
    slope = met.slope[rows]
    variance = factor * (along + across * (1 - slope**2) / slope**2)
    off = (reach[rows] + state.offset_m - met.range_m[rows]) * np.abs(slope)
    # What all points of the board share is no reason to reject them.
    shared = float(np.median(off[np.abs(off) < 0.1])) if np.any(np.abs(off) < 0.1) else 0.0
    if slack_m == 0 and abs(shared) < 0.05:
        off = off - shared
    good = np.abs(off) <= settings.reject_sigmas * np.sqrt(variance) * np.abs(slope) + slack_m
    kept = rows[good]
    edges = Edges.none()
    if pose.ring is not None and slack_m < _SLACK_M[0]:
        across = beam_errors.variances(reach, brightness)[1]
        found = find_edges(state.views[i], state.T, pose.points_scs_m, pose.ring, across)
        past = np.abs(edge_rows(state.views[i], state.T, found)[0])
        edges = found.taken(past < settings.reject_sigmas * np.sqrt(found.variance_m2) + slack_m)
    return _OnBoard(
        edges=edges,
        reach_m=reach[kept],
        beam_scs=beam[kept],
        variance_m2=variance[good],
        rejected=int(np.count_nonzero(~good)),
    )


def _adjusted(
    state: _State,
    measured: Sequence[BoardView],
    scans: Sequence[_OnBoard],
    settings: BoardSettings,
    board_factor: float,
) -> Adjusted[_State]:
    b, extra = len(measured), int(settings.free_range_offset)
    u = 6 + 3 * b + extra
    names = [
        *ORIENTATION,
        *(f"{v.name}.{w}" for v in measured for w in ("offset", "tilt_1", "tilt_2")),
        *(["range_offset"] if extra else []),
    ]
    covs = np.stack([board_factor * _plane_cov(v, settings) for v in measured])

    def update(x: _State, dx: ArrayF) -> _State:
        """Small changes put on the state."""
        views = [_shifted(v, dx[6 + 3 * i : 9 + 3 * i]) for i, v in enumerate(x.views)]
        return _State(
            T=x.T.moved(dx[:6]), views=tuple(views), offset_m=x.offset_m + (float(dx[-1]) if extra else 0.0)
        )

    def boards(x: _State) -> Linear:
        """Planes of the boards as the camera measured them."""
        residual = np.concatenate([_difference(v, m) for v, m in zip(x.views, measured, strict=True)])
        J = np.zeros((3 * b, u))
        J[:, 6 : 6 + 3 * b] = np.eye(3 * b)
        return Linear(residual=residual, jacobian=J, cov=covs)

    def lidar(x: _State) -> Linear:
        """Ranges to the planes."""
        parts, rows = [], []
        for i, (view, scan) in enumerate(zip(x.views, scans, strict=True)):
            beam = scan.beam_scs @ x.T.R.T
            met = meet_board(view, x.T.shift_m, beam)
            arm = met.range_m[:, None] * beam
            J = np.zeros((len(beam), u))
            J[:, :6] = by_transform(np.broadcast_to(view.normal, beam.shape), arm)
            J[:, 6 + 3 * i] = -1.0
            # A tilt about the first side lowers the normal along the second, and so on.
            J[:, 7 + 3 * i], J[:, 8 + 3 * i] = -met.place_m[:, 1], met.place_m[:, 0]
            J /= met.slope[:, None]
            if extra:
                J[:, -1] = 1.0
            parts.append(scan.reach_m + x.offset_m - met.range_m)
            rows.append(J)
        variance = np.concatenate([s.variance_m2 for s in scans])
        return Linear(residual=np.concatenate(parts), jacobian=np.concatenate(rows), cov=variance)

    def edges(x: _State) -> Linear:
        """Ends of the scan lines at the sides of the boards."""
        parts, rows = [], []
        for i, (view, scan) in enumerate(zip(x.views, scans, strict=True)):
            r, by_T, by_plane = edge_rows(view, x.T, scan.edges)
            J = np.zeros((len(r), u))
            J[:, :6], J[:, 6 + 3 * i : 9 + 3 * i] = by_T, by_plane
            parts.append(r)
            rows.append(J)
        variance = np.concatenate([s.edges.variance_m2 for s in scans])
        return Linear(residual=np.concatenate(parts), jacobian=np.concatenate(rows), cov=variance)

    start = replace(state, views=tuple(measured))
    groups = [Observations("boards", boards), Observations("lidar", lidar)]
    if any(len(s.edges.side) for s in scans):
        groups.append(Observations("edges", edges))
    return adjust(
        groups, start, names, update=update,
        cure="Record more poses of the board, at other distances and with other tilts",
    )  # fmt: skip


def _shifted(view: BoardView, d: ArrayF) -> BoardView:
    """The plane moved along its normal and tilted about its sides."""
    T = view.T_ccs_board
    turn = T.R[:, 0] * d[1] + T.R[:, 1] * d[2]
    moved = Rigid(R=exp_rotation(turn) @ T.R, shift_m=T.shift_m + d[0] * view.normal, cov=T.cov)
    return replace(view, T_ccs_board=moved)


def _difference(view: BoardView, measured: BoardView) -> ArrayF:
    """Offset and tilts (3,) that lead from the measured plane to this one."""
    error = view.T_ccs_board.error_from(measured.T_ccs_board)
    R = measured.T_ccs_board.R
    return np.array([measured.normal @ error[:3], R[:, 0] @ error[3:], R[:, 1] @ error[3:]])


def _plane_cov(view: BoardView, settings: BoardSettings) -> ArrayF:
    R = view.T_ccs_board.R
    K = np.zeros((3, 6))
    K[0, :3], K[1, 3:], K[2, 3:] = R[:, 2], R[:, 0], R[:, 1]
    offset = settings.flatness_m**2 + settings.sigma_board_m**2
    tilt = settings.flatness_m**2 / view.half_m[::-1] ** 2
    return np.asarray(K @ view.T_ccs_board.cov @ K.T + np.diag([offset, *tilt]))


def _table(
    poses: Sequence[BoardPose],
    scans: Sequence[_OnBoard],
    used: Sequence[int],
    state: _State,
    settings: BoardSettings,
) -> pd.DataFrame:
    lines: list[dict[str, Any]] = []
    for i, (pose, scan) in enumerate(zip(poses, scans, strict=True)):
        met = meet_board(pose.view, state.T.shift_m, scan.beam_scs @ state.T.R.T)
        d = (scan.reach_m + state.offset_m - met.range_m) * -met.slope
        n = len(d)
        reason = "" if i in used else f"{n} points on the board, at least {settings.least_points} are needed"
        lines.append(
            {
                "pose": pose.view.name,
                "points": n,
                "rejected": scan.rejected,
                "edges": len(scan.edges.side),
                "mean_mm": 1e3 * float(d.mean()) if n else np.nan,
                "rms_mm": 1e3 * float(np.sqrt(np.mean(d**2))) if n else np.nan,
                "distance_m": float(np.linalg.norm(pose.view.T_ccs_board.shift_m)),
                "rms_px": pose.view.rms_px,
                "used": i in used,
                "reason": reason,
            }
        )
    return pd.DataFrame(lines)
