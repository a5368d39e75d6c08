"""Which points of a scan lie on a board: found from a rough orientation, without cropping by hand.

As for cones (`thalweg.calibration.cones.search`), many orientations around the nominal one are judged by
beams
that should meet the boards: on it, through it, or stopped before it. All pictures and scans count together,
so that a wall which looks like the board in one of them does not win.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.calibration.boards.images import BoardView
from thalweg.calibration.cones.search import SearchRange, normal_set
from thalweg.core.errors import GeometryError
from thalweg.core.rigid import Rigid, exp_rotation
from thalweg.core.types import AnyArray, ArrayB, ArrayF

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
