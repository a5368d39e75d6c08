"""Ends of the pieces of line, and which two ends belong to one sub-beam.

Where a bar of an upper level ends, its line ends, and at the same sub-beam a piece of line on a lower level
begins (P3 fig. 4, P4 fig. 9). Along the fan the pieces of all levels follow each other without overlap, so
that each end has at most one partner: the nearest beginning on another level.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayI
from thalweg.lightsheet.calibration.line_levels import Segment

_FITTED: Final = 15
"""Points at the end of a piece that give its direction."""
_PROFILE: Final = 4
"""Points at the end of a piece among which its brightness may fall to half."""
_GRID: Final = 2000
"""Fan angles at which the pieces of two levels are laid over each other."""
_SMALL_SHIFT: Final = 0.3
_NEAR: Final = 0.4
"""Of the narrower of piece and gap: farther apart two ends do not belong together."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Edges:
    """Ends of pieces.

    Parameters
    ----------
    xy_px : (e, 2).
    outward : (e, 2) unit direction along the line, out of the piece.
    sigma_px : (e,) along the line by the distance of the points alone; 0 where the brightness shows the end.
    level, segment : (e,) indices.
    side : (e,) +1 at the end with the larger fan angle, -1 at the other one.
    at_border : (e,) near the edge of the picture: no shadow.
    """

    xy_px: ArrayF
    outward: ArrayF
    sigma_px: ArrayF
    level: ArrayI
    segment: ArrayI
    side: ArrayI
    at_border: ArrayB


@dataclass(frozen=True, slots=True, kw_only=True)
class Pairs:
    """Pairs of ends of one sub-beam, as rows of `Edges`, and what is left over.

    Parameters
    ----------
    upper, lower : (p,) rows of the edges.
    apart_rad : (p,) fan angle of the upper end less that of the lower one, after the alignment of the levels.
    lonely : rows of edges inside the line without a partner.
    overlap : share of the line below which is lit although the level above it is lit, too; 0 if all is right.
    """

    upper: ArrayI
    lower: ArrayI
    apart_rad: ArrayF
    lonely: ArrayI
    overlap: float


def edges_of(
    xy_px: ArrayF, peak_dn: ArrayF, segments: list[Segment], size_px: tuple[int, int], *, border_px: float
) -> Edges:
    """Both ends of each piece.

    The line is taken as ended half a point distance beyond its last point or, where the brightness falls
    within the last points, where it has fallen to half.

    Parameters
    ----------
    xy_px, peak_dn : (n, 2) and (n,) of all line points; brightness may be NaN.
    segments : pieces.
    size_px : of the picture.
    border_px : ends nearer to its edge are cut off there.
    """
    place, out, sigma, level, number, side = [], [], [], [], [], []
    for i, segment in enumerate(segments):
        for sign in (-1, 1):
            rows = segment.rows[::sign][::-1]
            # rows[0] is the end, the others lead inward
            xy, bright = xy_px[rows], peak_dn[rows]
            end, direction, coarse = _end(xy, bright)
            place.append(end)
            sigma.append(coarse)
            out.append(direction)
            level.append(segment.level)
            number.append(i)
            side.append(sign)
    place_px = np.array(place, dtype=np.float64).reshape(-1, 2)
    far = np.asarray(size_px, dtype=np.float64) - border_px
    return Edges(
        xy_px=place_px,
        outward=np.array(out, dtype=np.float64).reshape(-1, 2),
        sigma_px=np.array(sigma, dtype=np.float64),
        level=np.array(level, dtype=np.int64),
        segment=np.array(number, dtype=np.int64),
        side=np.array(side, dtype=np.int64),
        at_border=np.asarray(((place_px < border_px) | (place_px > far)).any(axis=1)),
    )


def _end(xy: ArrayF, bright: ArrayF) -> tuple[ArrayF, ArrayF, float]:
    """End of a piece whose points (m, 2) lead inward from it, direction (2,) out of it, sigma along it."""
    near = xy[:_FITTED]
    middle = near.mean(axis=0)
    direction = np.linalg.svd(near - middle, full_matrices=False)[2][0]
    if direction @ (near[0] - near[-1]) < 0:
        direction = -direction
    along = (near - middle) @ direction
    step = float(np.median(-np.diff(along))) if len(along) > 1 else 1.0
    place, coarse = float(along[0]) + 0.5 * step, step / np.sqrt(12.0)
    inner = bright[_PROFILE:_FITTED]
    if len(inner) >= 3 and np.isfinite(bright[:_FITTED]).all():
        half = 0.5 * float(np.median(inner))
        below = np.flatnonzero(bright[:_PROFILE] < half)
        if len(below):
            k = int(below[-1])
            share = (half - bright[k]) / (bright[k + 1] - bright[k])
            place, coarse = float(along[k] + share * (along[k + 1] - along[k])), 0.0
    return middle + place * direction, direction, coarse


def match(edges: Edges, fan_rad: ArrayF, n_levels: int, *, reach_rad: float) -> Pairs:
    """Pairs of ends of one sub-beam.

    Approximate values that are wrong shift and stretch the fan angles on one level against those on another.
    Each level is first laid on those above it, so that it is lit where they are not.

    Parameters
    ----------
    edges : ends of pieces.
    fan_rad : (e,) fan angle of each end.
    n_levels : number of levels; 1 for no pairs at all.
    reach_rad : largest shift between two levels that is searched.
    """
    aligned = fan_rad.copy()
    overlap = 0.0
    for k in range(1, n_levels):
        above, mine = edges.level < k, edges.level == k
        if not mine.any() or not above.any():
            continue
        shift, scale, over = _alignment(
            _intervals(aligned, edges, above), _intervals(fan_rad, edges, mine), reach_rad
        )
        middle = float(np.median(fan_rad[mine]))
        aligned[mine] = middle + scale * (fan_rad[mine] - middle) + shift
        overlap = max(overlap, over)
    if n_levels < 2:
        nothing = np.empty(0, dtype=np.int64)
        return Pairs(upper=nothing, lower=nothing, apart_rad=np.empty(0), lonely=nothing, overlap=0.0)
    upper, lower, apart = _nearest(edges, aligned)
    paired = np.zeros(len(fan_rad), dtype=np.bool_)
    paired[upper] = paired[lower] = True
    inside = ~edges.at_border & ~paired
    if len(aligned):
        # the fan's own ends have no partner
        inside &= (aligned > aligned.min()) & (aligned < aligned.max())
    return Pairs(upper=upper, lower=lower, apart_rad=apart, lonely=np.flatnonzero(inside), overlap=overlap)


def _intervals(fan: ArrayF, edges: Edges, chosen: ArrayB) -> ArrayF:
    """(m, 2) fan angles where pieces begin and end."""
    rows = np.flatnonzero(chosen)
    low, high = rows[edges.side[rows] < 0], rows[edges.side[rows] > 0]
    return np.sort(np.stack([fan[low], fan[high]], axis=1), axis=1)


def _lit(at: ArrayF, intervals: ArrayF) -> AnyArray:
    """Whether fan angles lie in some interval."""
    order = np.argsort(intervals[:, 0])
    begin, end = intervals[order, 0], np.maximum.accumulate(intervals[order, 1])
    k = np.searchsorted(begin, at, side="right") - 1
    return np.asarray((k >= 0) & (at <= end[np.maximum(k, 0)]))


def _alignment(above: ArrayF, mine: ArrayF, reach: float) -> tuple[float, float, float]:
    """Shift and scale of the lower pieces (m, 2) that lay them into the gaps above, and the overlap left."""
    low, high = above.min(), above.max()
    at = np.linspace(low - reach, high + reach, _GRID)
    dark = ~_lit(at, above) & (at > low) & (at < high)
    light = _lit(at, above)
    middle = float(np.median(mine))
    total = max(float((mine[:, 1] - mine[:, 0]).sum()), 1e-12)
    grain = (high - low + 2 * reach) / _GRID
    pitch = float(np.median(np.diff(np.sort(mine[:, 0])))) if len(mine) > 1 else reach
    best, found = np.inf, (0.0, 1.0, 1.0)
    # two passes, the second one finer around the best of the first
    shifts, scales = np.linspace(-reach, reach, 51), np.linspace(0.94, 1.06, 9)
    for _ in range(2):
        for scale in scales:
            for shift in shifts:
                moved = _lit(at, middle + scale * (mine - middle) + shift)
                over = float((moved & light).sum()) * grain / total
                open_ = float((dark & ~moved).sum()) * grain / total
                # equal gaps fit one gap off nearly as well: the smaller shift is right
                cost = over + 0.5 * open_ + _SMALL_SHIFT * abs(shift) / pitch + abs(scale - 1)
                if cost < best:
                    best, found = cost, (float(shift), float(scale), over)
        shifts = found[0] + np.linspace(-1, 1, 9) * reach / 25
        scales = found[1] + np.linspace(-1, 1, 5) * 0.015
    return found


def _nearest(edges: Edges, aligned: ArrayF) -> tuple[ArrayI, ArrayI, ArrayF]:
    """Ends that are each other's nearest opposite ends on another level, and how far apart they are."""
    n = len(aligned)
    width = np.empty(n)
    for segment in np.unique(edges.segment):
        rows = np.flatnonzero(edges.segment == segment)
        width[rows] = np.ptp(aligned[rows])
    far = np.abs(aligned[:, None] - aligned[None, :])
    partner = (edges.side[:, None] != edges.side[None, :]) & (edges.level[:, None] != edges.level[None, :])
    partner &= ~edges.at_border[:, None] & ~edges.at_border[None, :]
    partner &= far <= _NEAR * np.minimum(width[:, None], width[None, :])
    far = np.where(partner, far, np.inf)
    upper, lower = [], []
    for i in range(n):
        if not np.isfinite(far[i]).any():
            continue
        j = int(far[i].argmin())
        if int(far[j].argmin()) == i and edges.level[i] < edges.level[j]:
            upper.append(i)
            lower.append(j)
    at_upper, at_lower = np.array(upper, dtype=np.int64), np.array(lower, dtype=np.int64)
    return at_upper, at_lower, aligned[at_upper] - aligned[at_lower]
