"""Cones and boards in lidar scans: orientation of a scanner near a nominal one, without cropping by hand.

The nominal mounts may be off by decimetres and several degrees, more than a target is wide; ground, stands
and people are near. So many orientations around the nominal one are tried, each judged by its beams:

    +1   a beam that should meet a target and does
    -1   a beam that should meet a target and was reflected behind it: it went through
     0   a beam that was reflected before: something stood in front

The second line is what keeps a target from being found in the ground or in a passer-by. The best
orientations are refined by robust point distances with a width that shrinks, and judged again. All scans
count together, so that what looks like a target in one of them does not win.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import ndtri

from thalweg.calibration.cones import Cone
from thalweg.core import AnyArray, ArrayF, GeometryError, Rigid, exp_rotation, njit
from thalweg.settings.sections import CameraLidarFit

_BEAMS: Final = 2500
"""Beams that judge an orientation, of all positions together."""
_KEPT: Final = 24
_FARTHEST: Final = 3.0
"""Times the search range that a refined orientation may be off; tries end at two."""
_STEPS: Final = 6
_FIRST_M, _FINAL_M = 0.15, 0.06
"""Distance from a target within which a beam counts as one that met it, before and after the refinement."""
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

    shift_m: float = CameraLidarFit().search_shift_m
    angle_deg: float = CameraLidarFit().search_angle_deg
    tries: int = 2000

    @property
    def sigmas(self) -> ArrayF:
        """(6,) of shift and rotation."""
        return np.repeat([self.shift_m, np.deg2rad(self.angle_deg)], 3)


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """Orientation found; ``score``: mean of its beams' judgements, ``beams``: how many should meet one."""

    T_ccs_scs: Rigid
    score: float
    beams: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Targets:
    """Surfaces to look for in pcs, as the compiled loops take them.

    ``table`` (t, 16): the scan that shows the target, -1 for all; whether it is a board; apex or middle;
    axis, or normal toward the scanner; of a cone the squared cosine of its half angle and its length, of a
    board its two axes and half its sides. ``centre`` (t, 3) and ``radius_m`` (t,) of spheres around them.
    """

    table: ArrayF
    centre: ArrayF
    radius_m: ArrayF

    @classmethod
    def cones(cls, cones: Sequence[Cone], lengths_m: Sequence[float]) -> "Targets":
        """Cones, which all scans show."""
        both = list(zip(cones, lengths_m, strict=True))
        rows = [
            [-1, 0, *c.apex_m, *c.axis, np.cos(c.half_angle_rad) ** 2, length, *np.zeros(6)]
            for c, length in both
        ]
        return cls(
            table=np.array(rows),
            centre=np.array([c.apex_m + c.axis * length / 2 for c, length in both]),
            radius_m=np.array([np.hypot(n / 2, n * np.tan(c.half_angle_rad)) for c, n in both]),
        )

    @classmethod
    def boards(cls, poses: Sequence[Rigid], half_m: ArrayF) -> "Targets":
        """A board (x and y along its sides, z its normal) with half its sides (b, 2) in each scan."""
        rows = [
            [k, 1, *T.shift_m, *T.R[:, 2], *T.R[:, 0], *T.R[:, 1], *half]
            for k, (T, half) in enumerate(zip(poses, half_m, strict=True))
        ]
        return cls(
            table=np.array(rows), centre=np.array([T.shift_m for T in poses]), radius_m=np.hypot(*half_m.T)
        )

    def near(self, scan: int, points_scs_m: ArrayF, T_pcs_scs: Rigid, margin_m: float, most: int) -> ArrayF:
        """Points whose beams pass near a target, thinned evenly in the order of recording."""
        beam = points_scs_m @ T_pcs_scs.R.T / np.linalg.norm(points_scs_m, axis=1, keepdims=True)
        near = np.zeros(len(beam), dtype=np.bool_)
        for row, centre, radius in zip(self.table, self.centre, self.radius_m, strict=True):
            if row[0] in (-1, scan):
                near[passing(centre, radius + margin_m, T_pcs_scs.shift_m, beam)] = True
        rows = np.flatnonzero(near)
        if len(rows) > most:
            rows = rows[np.linspace(0, len(rows) - 1, most).astype(np.int64)]
        return np.asarray(points_scs_m[rows])


def passing(centre: ArrayF, radius_m: float, origin_m: ArrayF, beam: ArrayF) -> AnyArray:
    """Rows of the beams (n, 3), unit vectors from an origin, that pass a sphere: a cheap first choice."""
    arm = centre - origin_m
    along = beam @ arm
    return np.flatnonzero((along > 0) & (arm @ arm - along**2 < radius_m**2))


def search_targets(
    targets: Targets,
    at: Sequence[Rigid],
    scans: Sequence[ArrayF],
    nominal: Rigid,
    within: SearchRange,
    *,
    widths_m: Sequence[float] = (0.2, 0.1, 0.06),
    what: str = "cone",
) -> Found:
    """Orientation of the scanner near the nominal one that brings scans and targets together.

    Parameters
    ----------
    targets : in pcs.
    at : T_pcs_ccs of each scan.
    scans : (n, 3) points of each, in scs.
    nominal : T_ccs_scs from the mounts.
    within : how far it may be off.
    widths_m : of the refinement, from rough to fine.
    what : a target is called, in messages.

    Raises
    ------
    GeometryError : no beam passes near a target.
    """
    reach = max(float(np.linalg.norm(c - T.shift_m)) for c in targets.table[:, 2:5] for T in at)
    margin = 2 * within.shift_m + reach * 2 * np.deg2rad(within.angle_deg)
    most = _BEAMS // len(scans)
    chosen = [
        targets.near(k, points, T @ nominal, margin, most)
        for k, (T, points) in enumerate(zip(at, scans, strict=True))
    ]
    if not any(len(points) for points in chosen):
        raise GeometryError(
            f"no beam of the lidar passes near a {what}",
            expected=f"{what}s in the view of the lidar",
            cure="Check the mounts of camera and lidar, and the exterior orientations of the camera",
        )
    which, points = np.repeat(np.arange(len(chosen)), [len(p) for p in chosen]), np.concatenate(chosen)
    # The same orientations for all inputs: a low-discrepancy set (Roberts 2018) turned into normal numbers.
    tries = np.vstack([np.zeros(6), normal_set(within.tries) * within.sigmas])
    turned = Rotation.from_rotvec(tries[:, 3:]).as_matrix() @ nominal.R
    R = np.stack([pose.R for pose in at]) @ turned[:, None]
    origins = np.stack([pose.apply(nominal.shift_m + tries[:, :3]) for pose in at], axis=1)
    given = points, which, targets.table
    scores = [_judge(*place, *given, _FIRST_M)[0] for place in zip(R, origins, strict=True)]
    best = np.argsort(-np.array(scores), kind="stable")[:_KEPT]
    refined = [_refined(nominal.moved(tries[i]), nominal, within, at, *given, widths_m) for i in best]
    # A refinement may run away to other things that look like targets.
    refined = [T for T in refined if np.abs(T.error_from(nominal) / within.sigmas).max() < _FARTHEST] or [
        nominal
    ]
    finals = [_score(T, at, *given) for T in refined]
    winner = int(np.argmax([s for s, _ in finals]))
    score, beams = finals[winner]
    return Found(T_ccs_scs=refined[winner], score=score / max(beams, 1), beams=beams)


def balance(targets: Targets, T_pcs_ccs: Rigid, points_scs_m: ArrayF, T_ccs_scs: Rigid) -> float:
    """Balance of the beams of one scan (n, 3) at an orientation of the scanner; -1 if few meet a target."""
    points = targets.near(0, points_scs_m, T_pcs_ccs @ T_ccs_scs, 0.0, _BEAMS)
    score, beams = _score(T_ccs_scs, [T_pcs_ccs], points, np.zeros(len(points), np.int64), targets.table)
    return score / beams if beams >= _LEAST_BEAMS else -1.0


def _score(
    T: Rigid, at: Sequence[Rigid], points: ArrayF, which: AnyArray, table: ArrayF
) -> tuple[float, int]:
    R = np.stack([pose.R @ T.R for pose in at])
    shift = np.stack([pose.R @ T.shift_m + pose.shift_m for pose in at])
    score, beams = _judge(R, shift, points, which, table, _FINAL_M)
    return float(score), int(beams)


@njit(cache=True, error_model="numpy")
def _judge(R, shift, points, which, table, width):  # type: ignore[no-untyped-def]
    """Beams on the targets less those that went through, and how many should meet them."""
    score, beams = 0.0, 0
    d = np.empty(3)
    # origins of each scan from each target: vector, along its axis, and c of a cone's quadratic equation
    o = np.empty((len(shift), len(table), 5))
    for s in range(len(shift)):
        for k in range(len(table)):
            o_u = o_o = 0.0
            for j in range(3):
                o[s, k, j] = shift[s, j] - table[k, 2 + j]
                o_u += o[s, k, j] * table[k, 5 + j]
                o_o += o[s, k, j] * o[s, k, j]
            o[s, k, 3], o[s, k, 4] = o_u, o_u * o_u - table[k, 8] * o_o
    for i in range(len(points)):
        M, p = R[which[i]], points[i]
        reach = np.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2)
        for j in range(3):
            d[j] = (M[j, 0] * p[0] + M[j, 1] * p[1] + M[j, 2] * p[2]) / reach
        first = np.inf
        for k in range(len(table)):
            row, at = table[k], o[which[i], k]
            if row[0] >= 0 and row[0] != which[i]:
                continue
            o_u, c = at[3], at[4]
            d_u = d[0] * row[5] + d[1] * row[6] + d[2] * row[7]
            if row[1] == 1:
                # a beam that meets the front, and in front of the scanner
                if d_u >= 0 or o_u <= 0:
                    continue
                t = -o_u / d_u
                across = along = 0.0
                for j in range(3):
                    off = t * d[j] + at[j]
                    across += off * row[8 + j]
                    along += off * row[11 + j]
                inside = abs(across) < row[14] and abs(along) < row[15]
            else:
                d_o = d[0] * at[0] + d[1] * at[1] + d[2] * at[2]
                a, b = d_u * d_u - row[8], d_u * o_u - row[8] * d_o
                under = b * b - a * c
                if c >= 0 or under < 0 or abs(a) < 1e-14:
                    continue
                t = (-b + np.sqrt(under)) / a
                z = o_u + t * d_u
                inside = t > 0 and 0 < z <= row[9]
            if inside and t < first:
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
    within: SearchRange,
    at: Sequence[Rigid],
    points: ArrayF,
    which: AnyArray,
    table: ArrayF,
    widths_m: Sequence[float],
) -> Rigid:
    """Robust point distances; the nominal orientation is an observation, so that nothing is undetermined."""
    R_pc = np.stack([pose.R for pose in at])
    shift = np.stack([pose.shift_m for pose in at])
    sigmas = 2 * within.sigmas
    for width in widths_m:
        for _ in range(_STEPS):
            N, n, weight = _pulled(T.R, T.shift_m, R_pc, shift, points, which, table, width)
            # A third of the width as sigma of a point, few of which are independent of their neighbours.
            P = 1 / (width / 3) ** 2 * (100.0 / max(weight, 100.0))
            back = T.error_from(nominal)
            dx = -np.linalg.solve(P * N + np.diag(1 / sigmas**2), P * n + back / sigmas**2)
            T = Rigid(R=exp_rotation(dx[3:]) @ T.R, shift_m=T.shift_m + dx[:3])
            if np.abs(dx).max() < 1e-4:
                break
    return T


@njit(cache=True, error_model="numpy")
def _pulled(turn, place, R, shift, points, which, table, width):  # type: ignore[no-untyped-def]
    """Normal equations (6, 6) and (6,) of distances from the nearest targets by the scanner's orientation,
    with Tukey's weights, and the sum of these; rates as of `plane_rates`.
    """
    N, n, total = np.zeros((6, 6)), np.zeros(6), 0.0
    arm, x, d, normal, J = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(6)
    cos, sin = np.sqrt(table[:, 8]), np.sqrt(1.0 - table[:, 8])
    for i in range(len(points)):
        M, p = R[which[i]], points[i]
        for j in range(3):
            arm[j] = turn[j, 0] * p[0] + turn[j, 1] * p[1] + turn[j, 2] * p[2]
        for j in range(3):
            x[j] = shift[which[i], j]
            for m in range(3):
                x[j] += M[j, m] * (arm[m] + place[m])
        best = width
        for k in range(len(table)):
            row = table[k]
            if row[0] >= 0 and row[0] != which[i]:
                continue
            z = across = along = rho = 0.0
            for j in range(3):
                d[j] = x[j] - row[2 + j]
                z += d[j] * row[5 + j]
                across += d[j] * row[8 + j]
                along += d[j] * row[11 + j]
            if row[1] == 1:
                if abs(across) < row[14] and abs(along) < row[15] and abs(z) < abs(best):
                    best = z
                    for j in range(3):
                        normal[j] = row[5 + j]
                continue
            for j in range(3):
                d[j] -= z * row[5 + j]
                rho += d[j] * d[j]
            rho = np.sqrt(rho)
            slant, distance = z * cos[k] + rho * sin[k], rho * cos[k] - z * sin[k]
            if 0.0 < slant < row[9] / cos[k] and abs(distance) < abs(best):
                best = distance
                for j in range(3):
                    normal[j] = cos[k] * d[j] / max(rho, 1e-12) - sin[k] * row[5 + j]
        if abs(best) >= width:
            continue
        weight = (1 - (best / width) ** 2) ** 2
        for j in range(3):
            J[j] = M[0, j] * normal[0] + M[1, j] * normal[1] + M[2, j] * normal[2]
        J[3] = arm[1] * J[2] - arm[2] * J[1]
        J[4] = arm[2] * J[0] - arm[0] * J[2]
        J[5] = arm[0] * J[1] - arm[1] * J[0]
        for j in range(6):
            n[j] += weight * J[j] * best
            for m in range(j + 1):
                N[j, m] += weight * J[j] * J[m]
        total += weight
    for j in range(6):
        for m in range(j):
            N[m, j] = N[j, m]
    return N, n, total


def normal_set(n: int) -> ArrayF:
    """(n, 6) numbers that fill a normal distribution evenly, cut at two sigmas."""
    ratio = 1.0
    for _ in range(50):
        ratio = (1 + ratio) ** (1 / 7)
    steps = (1 / ratio) ** np.arange(1, 7)
    uniform = np.mod(0.5 + np.outer(np.arange(1, n + 1), steps), 1.0)
    return np.asarray(ndtri(0.0228 + uniform * (1 - 2 * 0.0228)))
