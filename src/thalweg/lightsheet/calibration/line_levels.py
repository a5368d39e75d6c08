"""Which level of the calibration object each measured line point lies on, and the pieces of line on each.

The nominal geometry gives a depth for each line point. It may be off by centimetres, yet smoothly along the
line: depths on one level follow a low polynomial of the fan angle. The levels are found as such curves at
about the stated distances from each other, whatever the shift, slope and scale that wrong approximate values
leave.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.types import ArrayB, ArrayF, ArrayI

OFF_LEVELS: Final = -1

_SAMPLE: Final = 250
"""Points that take part in the search for shift, slope and scale."""
_SHIFTS_MM: Final = np.arange(-60.0, 60.1, 2.0)
_SLOPES_MM: Final = np.linspace(-50.0, 50.0, 21)
"""Millimetres a radian of fan angle: an error of 4 degrees about the normal of the window leaves about 30."""
_SCALES: Final = np.linspace(0.7, 1.3, 9)
_NEAR_SHARE: Final = 0.25
"""Of the distance between levels: farther from a level's curve a point is on none."""
_LEAST_TOLERANCE_MM: Final = 0.5
_SCATTERS: Final = 6.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Segment:
    """An uninterrupted piece of line on one level.

    Parameters
    ----------
    level : index of the level.
    rows : (m,) places of its points in the table, in the order of the fan angle.
    """

    level: int
    rows: ArrayI


def levels_of_points(depth_mm: ArrayF, fan_rad: ArrayF, depths_mm: ArrayF, *, search: bool = True) -> ArrayI:
    """Level (n,) of each point, `OFF_LEVELS` where it is near none.

    Parameters
    ----------
    depth_mm, fan_rad : (n,) by the nominal geometry, finite.
    depths_mm : (k,) stated depths, growing.
    search : whether the approximate values may be far off.
    """
    if len(depth_mm) == 0:
        return np.empty(0, np.int64)
    spacing = float(np.diff(depths_mm).min()) if len(depths_mm) > 1 else 20.0
    curves = np.broadcast_to(depths_mm, (len(depth_mm), len(depths_mm))).copy()
    if search:
        curves = _start(depth_mm, fan_rad, depths_mm, 0.5 * _NEAR_SHARE * spacing)
    off = np.abs(depth_mm[:, None] - curves)
    level = off.argmin(axis=1)
    reach = np.full(len(depths_mm), _NEAR_SHARE * spacing)
    for degree in (1, 2, 2, 3, 3):
        for k in range(len(depths_mm)):
            mine = (level == k) & (off[:, k] <= reach[k])
            # a curve of a few points would follow each of them
            used = min(degree, int(mine.sum()) // 8)
            if mine.sum() < 4:
                continue
            curves[:, k] = _robust_curve(fan_rad, depth_mm, mine, used)
            scatter = 1.4826 * float(np.median(np.abs(depth_mm - curves[:, k])[mine]))
            reach[k] = np.clip(_SCATTERS * scatter, _LEAST_TOLERANCE_MM, _NEAR_SHARE * spacing)
        off = np.abs(depth_mm[:, None] - curves)
        level = off.argmin(axis=1)
    near = off[np.arange(len(level)), level] <= reach[level]
    return np.where(near, level, OFF_LEVELS).astype(np.int64)


def _start(depth: ArrayF, fan: ArrayF, depths: ArrayF, cap: float) -> ArrayF:
    """(n, k) depths of the levels at each fan angle: the best common shift, slope and scale."""
    pick = np.linspace(0, len(depth) - 1, min(_SAMPLE, len(depth))).astype(np.int64)
    order = np.argsort(fan, kind="stable")[pick]
    middle, mean = float(np.median(fan)), float(depths.mean())
    straight = depth[order][:, None] - _SLOPES_MM * (fan[order] - middle)[:, None]
    best, found = np.inf, (0.0, 0.0, 1.0)
    for scale in _SCALES:
        scaled = mean + scale * (depths - mean)
        away = np.full((len(order), len(_SLOPES_MM), len(_SHIFTS_MM)), cap)
        for level in scaled:
            # shift outermost: every level in turn, the nearest one counts
            away = np.minimum(away, np.abs(straight[:, :, None] - level - _SHIFTS_MM))
        cost = away.mean(axis=0)
        # equally good far away means nothing: among equals the smallest correction
        cost = cost + 1e-4 * cap * (
            np.abs(_SHIFTS_MM) / 10 + np.abs(_SLOPES_MM)[:, None] / 10 + 10 * abs(scale - 1)
        )
        i, j = np.unravel_index(int(cost.argmin()), cost.shape)
        if cost[i, j] < best:
            best, found = float(cost[i, j]), (float(_SHIFTS_MM[j]), float(_SLOPES_MM[i]), float(scale))
    shift, slope, scale = found
    return np.asarray(mean + scale * (depths - mean) + shift + slope * (fan - middle)[:, None])


def _robust_curve(fan: ArrayF, depth: ArrayF, mine: ArrayB, degree: int) -> ArrayF:
    """(n,) polynomial through the points of one level, by weights that fall with the distance."""
    low, high = fan[mine].min(), fan[mine].max()
    t = (fan - (low + high) / 2) / max((high - low) / 2, 1e-9)
    A = np.vander(t, degree + 1)
    weight = mine.astype(np.float64)
    for _ in range(6):
        x = np.linalg.lstsq(A * weight[:, None], depth * weight, rcond=None)[0]
        off = np.abs(depth - A @ x)
        scale = 1.4826 * float(np.median(off[mine])) + 1e-6
        weight = mine / np.sqrt(1.0 + np.square(off / (2.0 * scale)))
    # outside the points a polynomial runs away: hold it at the ends
    return np.asarray(np.vander(np.clip(t, -1.0, 1.0), degree + 1) @ x)


def segments_of(
    xy_px: ArrayF, fan_rad: ArrayF, level: ArrayI, *, least_gap_px: float, least_points: int
) -> tuple[list[Segment], ArrayB]:
    """Pieces of line of each level, in the order of the fan angle.

    Parameters
    ----------
    xy_px : (n, 2).
    fan_rad, level : (n,).
    least_gap_px : a larger distance between neighbours ends a piece, as does one of 2.5 usual distances.
    least_points : shorter pieces are stray points.

    Returns
    -------
    Segments, and (n,) which points stood in a piece that was too short.
    """
    found: list[Segment] = []
    short = np.zeros(len(level), dtype=np.bool_)
    for k in range(int(level.max(initial=-1)) + 1):
        rows = np.flatnonzero(level == k)
        rows = rows[np.argsort(fan_rad[rows], kind="stable")]
        if len(rows) == 0:
            continue
        step = np.linalg.norm(np.diff(xy_px[rows], axis=0), axis=1)
        usual = float(np.median(step)) if len(step) else 1.0
        breaks = np.flatnonzero(step > max(least_gap_px, 2.5 * usual)) + 1
        for part in np.split(rows, breaks):
            if len(part) < least_points:
                short[part] = True
            else:
                found.append(Segment(level=k, rows=part))
    return found, short
