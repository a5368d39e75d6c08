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
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.calibration.camera_lidar import CAPTURES, ORIENTATION, input as recorded
from thalweg.calibration.markers import read_grey
from thalweg.calibration.target_search import SearchRange, Targets, search_targets
from thalweg.core import (
    Adjusted,
    AnyArray,
    ArrayB,
    ArrayF,
    Camera,
    GeometryError,
    InputError,
    Linear,
    Observations,
    Rigid,
    UnobservableError,
    adjust,
    exp_rotation,
    optional,
    plane_rates,
    root_mean_square,
    rows_of,
)
from thalweg.core.calibration import Calibration, Source, pose_block
from thalweg.ingest import LidarOptions
from thalweg.ingest.clouds import read_cloud
from thalweg.ingest.registry import lidar_reader
from thalweg.settings.sections import Board, LidarAccuracy

cv2 = optional("cv2")

_SLACK_M: Final = (0.06, 0.03, 0.0, 0.0, 0.0, 0.0, 0.0)
"""What points and edges may be off besides their sigmas, round by round; edges wait for the second one."""
_STAYS: Final = 0.05
_WIDTHS_M: Final = (0.4, 0.2, 0.1, 0.06)
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

METHOD: Final = "relative orientation of camera and lidar from poses of a flat board"
_TRIES: Final = (
    (0.5, ""), (1.0, "NORMALIZE_IMAGE"), (0.7, ""), (0.35, "NORMALIZE_IMAGE"), (0.5, "EXHAUSTIVE"),
)  # fmt: skip
"""Size of the picture and flags of the detector, in the order in which they are tried.

Half the size takes a fifth of the time; corners are refined in the full picture whichever finds them.
"""
_HALF_PX: Final = 0.5
"""OpenCV counts pixels from the centre of the first one."""
LEAST_SIGMA_PX: Final = 0.1


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
        return rows_of(self, rows)


@dataclass(frozen=True, slots=True, kw_only=True)
class Checkerboard:
    """A printed checkerboard on a flat board.

    Parameters
    ----------
    columns, rows : inner corners along the longer and the shorter side of the pattern.
    square_m : side of a square.
    width_m, height_m : of the board, along columns and rows.
    flatness_m : standard deviation of the board's surface about a plane.

    Raises
    ------
    GeometryError : fewer than 3 by 3 corners, or sizes that do not fit.
    """

    columns: int
    rows: int
    square_m: float
    width_m: float
    height_m: float
    flatness_m: float = Board().flatness_m

    def __post_init__(self) -> None:
        fits = self.width_m >= (self.columns - 1) * self.square_m > 0
        if min(self.columns, self.rows) < 3 or not fits or self.height_m < (self.rows - 1) * self.square_m:
            raise GeometryError(
                f"{self.columns} x {self.rows} corners of {self.square_m} m on a board of {self.width_m} x "
                f"{self.height_m} m",
                expected="at least 3 x 3 inner corners, and a board at least as large as the pattern",
            )

    @property
    def points_m(self) -> ArrayF:
        """(n, 3) corners in the frame of the board: from its middle, x along columns, z toward the viewer."""
        x = (np.arange(self.columns) - (self.columns - 1) / 2) * self.square_m
        y = (np.arange(self.rows) - (self.rows - 1) / 2) * self.square_m
        X, Y = np.meshgrid(x, -y)
        return np.stack([X.ravel(), Y.ravel(), np.zeros(X.size)], axis=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardView:
    """Where a board is: ``T_ccs_board`` with covariance; ``half_m`` (2,) of its sides; RMS of the corners."""

    name: str
    T_ccs_board: Rigid
    half_m: ArrayF
    rms_px: float = 0.0

    @property
    def normal(self) -> ArrayF:
        """(3,) in ccs, toward the camera."""
        return self.T_ccs_board.R[:, 2]


# ---------------------------------------------------------------- adjustment


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
    flatness_m: float = Board().flatness_m


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardCalibration:
    """Result of `calibrate_board`.

    Parameters
    ----------
    T_ccs_scs : with covariance.
    adjusted : the adjustment.
    lidar_factor, board_factor : of the variances of points and of boards, estimated.
    table : one line a pose: points, rejected, mean and RMS distance, used or why not.
    score : balance of the beams in the first search.
    """

    T_ccs_scs: Rigid
    adjusted: Adjusted["_State"]
    lidar_factor: float
    board_factor: float
    table: pd.DataFrame
    score: float


@dataclass(frozen=True, slots=True, kw_only=True)
class _State:
    T: Rigid
    views: tuple[BoardView, ...]


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
    beam_errors: LidarAccuracy,
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
        found = search_targets(
            Targets.boards([p.view.T_ccs_board for p in poses], np.array([p.view.half_m for p in poses])),
            [Rigid()] * len(poses),
            [p.points_scs_m for p in poses],
            nominal,
            settings.within,
            widths_m=_WIDTHS_M,
            what="board",
        )
        start, score = found.T_ccs_scs, found.score
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
        state = replace(state, T=adjusted.x.T)
        if slack == 0:
            lidar *= adjusted.group_sigma0["lidar"] ** 2
            boards *= max(adjusted.group_sigma0["boards"] ** 2, 1.0 / boards)
        if stays:
            break
    return BoardCalibration(
        T_ccs_scs=adjusted.x.T.with_cov(adjusted.cov[:6, :6]),
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
    axis = np.cross(normals.mean(axis=0), free)
    words = ", ".join(f"{v:.2f}" for v in free)
    turn = ", ".join(f"{v:.2f}" for v in axis / np.linalg.norm(axis))
    raise UnobservableError(
        [f"a shift along ({words}) in ccs"],
        defects=int(np.sum(spread < least_angle_deg)),
        cure=f"The normals of {len(names)} poses spread by only {spread[0]:.1f} deg in this direction. "
        f"Record poses with the board tilted by 20 degrees and more about the axis ({turn}) of the camera, "
        "both ways",
    )


def _select(
    state: _State,
    i: int,
    pose: BoardPose,
    beam_errors: LidarAccuracy,
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
    off = (reach[rows] - met.range_m[rows]) * np.abs(slope)
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
    b = len(measured)
    u = 6 + 3 * b
    names = [*ORIENTATION, *(f"{v.name}.{w}" for v in measured for w in ("offset", "tilt_1", "tilt_2"))]
    covs = np.stack([board_factor * _plane_cov(v, settings) for v in measured])

    def update(x: _State, dx: ArrayF) -> _State:
        """Small changes put on the state."""
        views = [_shifted(v, dx[6 + 3 * i : 9 + 3 * i]) for i, v in enumerate(x.views)]
        return _State(T=x.T.moved(dx[:6]), views=tuple(views))

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
            J[:, :6] = plane_rates(np.broadcast_to(view.normal, beam.shape), arm)
            J[:, 6 + 3 * i] = -1.0
            # A tilt about the first side lowers the normal along the second, and so on.
            J[:, 7 + 3 * i], J[:, 8 + 3 * i] = -met.place_m[:, 1], met.place_m[:, 0]
            J /= met.slope[:, None]
            parts.append(scan.reach_m - met.range_m)
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
        groups,
        start,
        names,
        update=update,
        cure="Record more poses of the board, at other distances and with other tilts",
    )


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
        d = (scan.reach_m - met.range_m) * -met.slope
        n = len(d)
        reason = "" if i in used else f"{n} points on the board, at least {settings.least_points} are needed"
        lines.append(
            {
                "pose": pose.view.name,
                "points": n,
                "rejected": scan.rejected,
                "edges": len(scan.edges.side),
                "mean_mm": 1e3 * float(d.mean()) if n else np.nan,
                "rms_mm": 1e3 * root_mean_square(d) if n else np.nan,
                "distance_m": float(np.linalg.norm(pose.view.T_ccs_board.shift_m)),
                "rms_px": pose.view.rms_px,
                "used": i in used,
                "reason": reason,
            }
        )
    return pd.DataFrame(lines)


# ---------------------------------------------------------------- which points of a scan lie on a board


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


# ---------------------------------------------------------------- edges of a board in a scan: what tells
# where in its plane the board is
#
# Along a ring of the scanner one beam is the last on the board and the next one passes it. The edge lies
# between both, anywhere with equal chance, and the beam midway is an observation of it. Spots that lie half
# on the board count as on it or not by their strength; that shifts opposite edges in opposite directions, so
# that the middle of the board stays.


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
    return residual, plane_rates(g, arm), by_plane


# ---------------------------------------------------------------- board calibrations from files


def read_scan(path: Path, options: LidarOptions) -> tuple[ArrayF, ArrayF, AnyArray | None]:
    """Points (n, 3) in scs, reflectivities (n,) and rings (n,) of a capture or of a cloud, such as PCD.

    A cloud without ``ring`` gives None, without ``intensity`` 50 percent.
    """
    if path.suffix.lower() not in CAPTURES:
        cloud = read_cloud(path)
        n = len(cloud.points)
        brightness = np.full(n, 50.0) if cloud.intensity is None else cloud.intensity.astype(np.float64)
        return cloud.points, brightness, cloud.ring
    found = recorded.read_scan(lidar_reader([path], options))
    if not len(found[0]):
        raise InputError("no points", expected="a lidar recording", where=path)
    return found


def read_board_poses(
    images: Sequence[Path], scans: Sequence[Path], board: Checkerboard, camera: Camera, options: LidarOptions
) -> tuple[list[BoardPose], pd.DataFrame]:
    """Poses of the board, and pictures in which it was not found, as (pose, reason).

    Parameters
    ----------
    images, scans : a picture and a lidar recording or cloud of each pose, in the same order.
    board, camera : the board and the interior orientation.
    options : how to read captures.

    Raises
    ------
    InputError : not as many pictures as scans, or a file cannot be read.
    """
    if len(images) != len(scans):
        raise InputError(
            f"{len(images)} pictures and {len(scans)} scans of a board",
            expected="one of each for each pose, in the same order",
        )
    poses, lost = [], []
    for image, scan in zip(images, scans, strict=True):
        try:
            corners = find_corners(read_grey(image), board, where=image.name)
            view = board_view(image.stem, corners, board, camera)
        except GeometryError as error:
            lost.append({"pose": image.stem, "used": False, "reason": str(error)})
            continue
        points, brightness, ring = read_scan(scan, options)
        poses.append(BoardPose(view=view, points_scs_m=points, reflectivity=brightness, ring=ring))
    return poses, pd.DataFrame(lost, columns=["pose", "used", "reason"])


def board_calibration(
    T_ccs_scs: Rigid, run: str, *, observations: int, sigma0: float = float("nan")
) -> Calibration:
    """The relative orientation as a calibration with the pose block ``camera_lidar``."""
    block, cov = pose_block("camera_lidar", T_ccs_scs)
    source = Source(run=run, method=METHOD, observations=observations, sigma0=sigma0)
    return Calibration(title="Lidar relative to the camera", blocks=(block,), cov=cov, source=source)


def pose_table(result: BoardCalibration, lost: pd.DataFrame) -> pd.DataFrame:
    """One line a pose, with those whose board was not found in the picture."""
    return result.table if lost.empty else pd.concat([result.table, lost], ignore_index=True)


# ---------------------------------------------------------------- a checkerboard in an image
#
# Lenses with much distortion and boards that fill the picture defeat a single try of OpenCV's detector, so
# several sizes of the picture are tried; the corners are refined in the full one. A pattern of m by n corners
# looks the same upside down. Its plane and its middle do not tell, and no more is used.


def find_corners(picture: AnyArray, board: Checkerboard, *, where: str = "") -> ArrayF:
    """Corners (n, 2) of a checkerboard in pixels from the upper left corner of the picture.

    Raises
    ------
    GeometryError : no such checkerboard in the picture.
    """
    pattern = (board.columns, board.rows)
    for size, flag in _TRIES:
        small = (
            picture
            if size == 1.0
            else cv2.resize(picture, None, fx=size, fy=size, interpolation=cv2.INTER_AREA)
        )
        flags = cv2.CALIB_CB_ACCURACY | (getattr(cv2, f"CALIB_CB_{flag}") if flag else 0)
        found, corners = cv2.findChessboardCornersSB(small, pattern, flags=flags)
        if found:
            # Pixels of the small picture, counted from its corner, and back to centres of the full one.
            xy = (corners.reshape(-1, 2) + _HALF_PX) / size - _HALF_PX
            grid = xy.reshape(board.rows, board.columns, 2)
            step = min(float(np.linalg.norm(np.diff(grid, axis=k), axis=2).min()) for k in (0, 1))
            window = int(np.clip(0.25 * step, 3, 12))
            stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)
            fine = cv2.cornerSubPix(
                picture, xy.astype(np.float32).reshape(-1, 1, 2), (window, window), (-1, -1), stop
            )
            return np.asarray(fine.reshape(-1, 2), dtype=np.float64) + _HALF_PX
    raise GeometryError(
        f"no checkerboard of {board.columns} x {board.rows} inner corners was found",
        expected="the whole pattern in the picture, sharp, with a white margin",
        where=where,
        cure="Check the numbers of inner corners (squares less one), or leave the picture out",
    )


def board_view(name: str, corners_px: ArrayF, board: Checkerboard, camera: Camera) -> BoardView:
    """Pose of a board from its corners, with covariance.

    The corners' sigma is their own scatter about the pose, at least `LEAST_SIGMA_PX`; the interior
    orientation counts with its covariance.

    Raises
    ------
    GeometryError : the pose cannot be found, or the corners are off by more than five pixels.
    """
    object_m = board.points_m
    rays = camera.rays(corners_px)
    if not np.isfinite(rays).all() or not (rays[:, 2] > 0.05).all():
        raise GeometryError("corners that the camera model cannot image", where=name)
    plane = (rays[:, :2] / rays[:, 2:]).reshape(-1, 1, 2)
    done, turn, shift = cv2.solvePnP(object_m, plane, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    if not done:
        raise GeometryError("no pose of the board fits its corners", where=name)
    start = Rigid(R=cv2.Rodrigues(turn)[0], shift_m=shift.ravel())

    def model(sigma_px: float) -> Observations[Rigid]:
        """Corners with one sigma for all."""

        def linear(T: Rigid) -> Linear:
            """Pixels of the corners less the measured ones."""
            at = T.apply(object_m)
            xy, by_point, by_parameters = camera.project_with_derivatives(at)
            J = by_point @ T.by_error(object_m)
            cov = by_parameters @ camera.cov @ np.swapaxes(by_parameters, 1, 2) + sigma_px**2 * np.eye(2)
            return Linear(residual=(xy - corners_px).ravel(), jacobian=J.reshape(-1, 6), cov=cov)

        return Observations("corners", linear)

    names = ("x", "y", "z", "rotation_x", "rotation_y", "rotation_z")
    first = adjust([model(1.0)], start, names, update=Rigid.moved)
    rms = root_mean_square(first.residuals["corners"])
    if rms > 5.0:
        raise GeometryError(
            f"the corners are off by {rms:.1f} pixels from any pose of the board",
            expected="less than one pixel",
            where=name,
            cure="Check the camera's calibration and the size of the squares",
        )
    sigma = max(LEAST_SIGMA_PX, float(np.sqrt(first.sigma0_squared)))
    final = adjust([model(sigma)], first.x, names, update=Rigid.moved)
    T = final.x.with_cov(final.cov)
    half = np.array([board.width_m, board.height_m]) / 2
    return BoardView(name=name, T_ccs_board=T, half_m=half, rms_px=rms)
