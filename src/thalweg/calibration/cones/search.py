"""The relative orientation of the lidar, roughly, from all cones at once and without cropping by hand.

The nominal mounts may be off by decimetres and several degrees, more than a cone is wide; ground, stands and
people are near. So many orientations around the nominal one are tried, and each is judged by its beams:

    +1   a beam that should meet a cone and does
    -1   a beam that should meet a cone and was reflected behind it: it went through
     0   a beam that was reflected before: something stood in front

The second line is what keeps a cone from being found in the ground or in a passer-by. The best orientations
are refined by robust point distances with a width that shrinks, and judged again.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numba as nb
import numpy as np
from scipy.special import ndtri

from thalweg.calibration.cones.cone import Cone
from thalweg.calibration.cones.selection import Position, passing
from thalweg.core.errors import GeometryError
from thalweg.core.rigid import Rigid, exp_rotation
from thalweg.core.types import AnyArray, ArrayF

_BEAMS: Final = 2500
"""Beams that judge an orientation, of all positions together."""
_KEPT: Final = 24
_FARTHEST: Final = 3.0
"""Times the search range that a refined orientation may be off; tries end at two."""

_WIDTHS_M: Final = (0.2, 0.1, 0.06)
_STEPS: Final = 6
_FINAL_M: Final = 0.06
"""Distance from a cone within which a beam counts as one that met it, after the refinement."""
_LEAST_BEAMS: Final = 25


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchRange:
    """How far the orientation may be from the nominal one: standard deviations for each axis.

    Parameters
    ----------
    shift_m : of the lever arm.
    angle_deg : of the rotation.
    tries : number of orientations.
    """

    shift_m: float = 0.10
    angle_deg: float = 3.0
    tries: int = 2000


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """Orientation found; ``score``: mean of its beams' judgements, ``beams``: how many should meet a cone."""

    T_ccs_scs: Rigid
    score: float
    beams: int


def search(
    cones: Sequence[Cone],
    lengths_m: Sequence[float],
    positions: Sequence[Position],
    nominal: Rigid,
    within: SearchRange,
) -> Found:
    """Orientation of the scanner near the nominal one that brings scans and cones together.

    Parameters
    ----------
    cones, lengths_m : in pcs.
    positions : with the camera's orientations.
    nominal : T_ccs_scs from the mounts.
    within : how far it may be off.

    Raises
    ------
    GeometryError : no beam passes near a cone.
    """
    tables = _cone_table(cones, lengths_m)
    reach = max(float(np.linalg.norm(c.apex_m - p.T_pcs_ccs.shift_m)) for c in cones for p in positions)
    margin = 2 * within.shift_m + reach * 2 * np.deg2rad(within.angle_deg)
    scans = [_near(cones, lengths_m, p, nominal, margin, _BEAMS // len(positions)) for p in positions]
    if not any(len(points) for points in scans):
        raise GeometryError(
            "no beam of the lidar passes near a cone",
            expected="cones in the view of the lidar",
            cure="Check the mounts of camera and lidar, and the exterior orientations of the camera",
        )
    which = np.repeat(np.arange(len(scans)), [len(points) for points in scans])
    points = np.concatenate(scans)
    at = [p.T_pcs_ccs for p in positions]
    # The same orientations for all inputs: a low-discrepancy set (Roberts 2018) turned into normal numbers.
    tries = normal_set(within.tries)
    tries *= np.repeat([within.shift_m, np.deg2rad(within.angle_deg)], 3)
    candidates = [nominal, *(nominal.moved(t) for t in tries)]
    scores = [_score(c, at, points, which, tables, 0.15) for c in candidates]
    best = np.argsort([-s for s, _ in scores], kind="stable")[:_KEPT]
    sigmas = np.repeat([2 * within.shift_m, 2 * np.deg2rad(within.angle_deg)], 3)
    refined = [_refined(candidates[i], nominal, sigmas, cones, lengths_m, at, points, which) for i in best]
    # A refinement may run away to other things that look like cones.
    refined = [c for c in refined if _distance(c, nominal, within) < _FARTHEST] or [nominal]
    finals = [_score(c, at, points, which, tables, _FINAL_M) for c in refined]
    winner = int(np.argmax([s for s, _ in finals]))
    score, beams = finals[winner]
    return Found(T_ccs_scs=refined[winner], score=score / max(beams, 1), beams=beams)


def fit_of(
    T_ccs_scs: Rigid, cones: Sequence[Cone], lengths_m: Sequence[float], T_pcs_ccs: Rigid, position: Position
) -> float:
    """Balance of the beams of one scan with one exterior orientation of the camera; -1 if few meet a cone.

    Parameters
    ----------
    T_ccs_scs : orientation of the scanner.
    cones, lengths_m : in pcs.
    T_pcs_ccs : exterior orientation of the camera.
    position : whose points are taken.
    """
    points = _near(cones, lengths_m, position.at(T_pcs_ccs), T_ccs_scs, 0.0, _BEAMS)
    table, which = _cone_table(cones, lengths_m), np.zeros(len(points), dtype=np.int64)
    score, beams = _score(T_ccs_scs, [T_pcs_ccs], points, which, table, _FINAL_M)
    return score / beams if beams >= _LEAST_BEAMS else -1.0


def _distance(T: Rigid, nominal: Rigid, within: SearchRange) -> float:
    """Greatest component of a change in units of the search range."""
    sigmas = np.repeat([within.shift_m, np.deg2rad(within.angle_deg)], 3)
    return float(np.abs(T.error_from(nominal) / sigmas).max())


def _near(
    cones: Sequence[Cone],
    lengths: Sequence[float],
    position: Position,
    nominal: Rigid,
    margin: float,
    most: int,
) -> ArrayF:
    """Points whose beams pass near a cone, thinned evenly in the order of recording."""
    T = position.T_pcs_ccs @ nominal
    points = position.points_scs_m
    beam = points @ T.R.T / np.linalg.norm(points, axis=1, keepdims=True)
    near = np.zeros(len(points), dtype=np.bool_)
    for cone, length in zip(cones, lengths, strict=True):
        near[passing(cone, length, T.shift_m, beam, margin)] = True
    rows = np.flatnonzero(near)
    if len(rows) > most:
        rows = rows[np.linspace(0, len(rows) - 1, most).astype(np.int64)]
    return np.asarray(points[rows])


def _cone_table(cones: Sequence[Cone], lengths: Sequence[float]) -> ArrayF:
    return np.array(
        [
            [*c.apex_m, *c.axis, np.cos(c.half_angle_rad) ** 2, length]
            for c, length in zip(cones, lengths, strict=True)
        ]
    )


def _score(
    T: Rigid, at: Sequence[Rigid], points: ArrayF, which: AnyArray, table: ArrayF, width: float
) -> tuple[float, int]:
    R = np.stack([pose.R @ T.R for pose in at])
    shift = np.stack([pose.R @ T.shift_m + pose.shift_m for pose in at])
    score, beams = _judge(R, shift, points, which, table, width)
    return float(score), int(beams)


@nb.njit(cache=True, error_model="numpy")
def _judge(R, shift, points, which, table, width):  # type: ignore[no-untyped-def]
    score, beams = 0.0, 0
    d, o = np.empty(3), np.empty(3)
    for i in range(len(points)):
        M, s, p = R[which[i]], shift[which[i]], points[i]
        reach = np.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2)
        for j in range(3):
            d[j] = (M[j, 0] * p[0] + M[j, 1] * p[1] + M[j, 2] * p[2]) / reach
        first = np.inf
        for k in range(len(table)):
            cos2 = table[k, 6]
            d_u = o_u = d_o = o_o = 0.0
            for j in range(3):
                o[j] = s[j] - table[k, j]
                d_u += d[j] * table[k, 3 + j]
                o_u += o[j] * table[k, 3 + j]
                d_o += d[j] * o[j]
                o_o += o[j] * o[j]
            a, b, c = d_u * d_u - cos2, d_u * o_u - cos2 * d_o, o_u * o_u - cos2 * o_o
            under = b * b - a * c
            if c >= 0 or under < 0 or abs(a) < 1e-14:
                continue
            t = (-b + np.sqrt(under)) / a
            z = o_u + t * d_u
            if t > 0 and 0 < z <= table[k, 7] and t < first:
                first = t
        if first < np.inf:
            beams += 1
            off = reach - first
            if abs(off) < width:
                score += 1.0
            elif off > 0:
                score -= 1.0
    return score, beams


def _refined(
    T: Rigid,
    nominal: Rigid,
    sigmas: ArrayF,
    cones: Sequence[Cone],
    lengths: Sequence[float],
    at: Sequence[Rigid],
    points: ArrayF,
    which: AnyArray,
) -> Rigid:
    """Robust point distances; the nominal orientation is an observation, so that nothing is undetermined."""
    R_pc = np.stack([pose.R for pose in at])[which]
    shift = np.stack([pose.shift_m for pose in at])[which]
    for width in _WIDTHS_M:
        for _ in range(_STEPS):
            in_ccs = T.apply(points)
            in_pcs = np.einsum("nij,nj->ni", R_pc, in_ccs) + shift
            r, normal = _nearest(in_pcs, cones, lengths)
            weight = np.maximum(1 - (r / width) ** 2, 0.0) ** 2
            n_ccs = np.einsum("nji,nj->ni", R_pc, normal)
            arm = in_ccs - T.shift_m
            J = np.hstack([n_ccs, np.cross(arm, n_ccs)])
            # A third of the width as sigma of a point, few of which are independent of their neighbours.
            P = weight / (width / 3) ** 2 * (100.0 / max(float(weight.sum()), 100.0))
            back = T.error_from(nominal)
            N = J.T @ (J * P[:, None]) + np.diag(1 / sigmas**2)
            dx = -np.linalg.solve(N, J.T @ (P * r) + back / sigmas**2)
            T = Rigid(R=exp_rotation(dx[3:]) @ T.R, shift_m=T.shift_m + dx[:3])
            if np.abs(dx).max() < 1e-4:
                break
    return T


def _nearest(points: ArrayF, cones: Sequence[Cone], lengths: Sequence[float]) -> tuple[ArrayF, ArrayF]:
    """Distance (n,) from the nearest cone, with its normal (n, 3); beyond the ends it counts as 9 m."""
    best, normal = np.full(len(points), 9.0), np.zeros((len(points), 3))
    for cone, length in zip(cones, lengths, strict=True):
        seen = cone.see(points)
        slant = length / np.cos(cone.half_angle_rad)
        nearer = (np.abs(seen.distance_m) < np.abs(best)) & (seen.slant_m > 0) & (seen.slant_m < slant)
        best[nearer], normal[nearer] = seen.distance_m[nearer], seen.normal[nearer]
    return best, normal


def normal_set(n: int) -> ArrayF:
    """(n, 6) numbers that fill a normal distribution evenly, cut at two sigmas."""
    ratio = 1.0
    for _ in range(50):
        ratio = (1 + ratio) ** (1 / 7)
    steps = (1 / ratio) ** np.arange(1, 7)
    uniform = np.mod(0.5 + np.outer(np.arange(1, n + 1), steps), 1.0)
    return np.asarray(ndtri(0.0228 + uniform * (1 - 2 * 0.0228)))
