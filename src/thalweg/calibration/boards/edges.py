"""Edges of a board in a scan: what tells where in its plane the board is.

Along a ring of the scanner one beam is the last on the board and the next one passes it. The edge lies
between both, anywhere with equal chance, and the beam midway is an observation of it. Spots that lie half on
the board count as on it or not by their strength; that shifts opposite edges in opposite directions, so that
the middle of the board stays.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.calibration.boards.images import BoardView
from thalweg.calibration.boards.search import meet_board
from thalweg.core.rigid import Rigid
from thalweg.core.types import AnyArray, ArrayF

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
