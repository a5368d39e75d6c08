"""From line points of one picture to observations: levels, pieces of line, pairs of their ends."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core import NMAD, AnyArray, ArrayB, ArrayF, ArrayI, ArrayU8, GeometryError, InputError
from thalweg.lightsheet.calibration.grid import GridObject
from thalweg.lightsheet.calibration.model import LineObservations, PairObservations
from thalweg.lightsheet.calibration.settings import CalibrationSettings
from thalweg.lightsheet.optics import Sensor, Status, intersect

# ---------------------------------------------------------------- which level of the calibration object each
# measured line point lies on, and the pieces of line on each
#
# The nominal geometry gives a depth for each line point. It may be off by centimetres, yet smoothly along the
# line: depths on one level follow a low polynomial of the fan angle. The levels are found as such curves at
# about the stated distances from each other, whatever the shift, slope and scale that wrong approximate
# values leave.


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
            scatter = NMAD * float(np.median(np.abs(depth_mm - curves[:, k])[mine]))
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
        scale = NMAD * float(np.median(off[mine])) + 1e-6
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


# ---------------------------------------------------------------- ends of the pieces of line, and which two
# ends belong to one sub-beam
#
# Where a bar of an upper level ends, its line ends, and at the same sub-beam a piece of line on a lower level
# begins (P3 fig. 4, P4 fig. 9). Along the fan the pieces of all levels follow each other without overlap, so
# that each end has at most one partner: the nearest beginning on another level.


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


# ---------------------------------------------------------------- correspondence


COLUMNS: Final = ("x_px", "y_px", "sigma_px", "angle_rad")
"""Columns that a table of line points must have; ``peak_dn`` and ``flags`` are used if they are there."""

LEAST_POINTS: Final = 40
LEAST_SHARE: Final = 0.6
"""Of the points that must meet the sheet under water by the nominal design."""
LEAST_PAIRS: Final = 4
"""Two gaps: with fewer, one wrong end spoils the laser's place along the line and nothing shows it."""
POINTS_ON_LEVEL: Final = 6
"""Line points that a level must keep to say anything about the sheet's slope there."""
_REACH_RAD: Final = 0.15
_MOST_OVERLAP: Final = 0.35
_CLEARLY: Final = 0.2
"""Logarithm by which a ratio must be nearer to that of gaps and bars than to that of bars and gaps."""
_THICK_MM: Final = 0.05
_LEAST_ON_LEVEL: Final = 0.02

NO_NUMBER: Final = "no number in the table"
FLAGGED: Final = "flagged by the detector"
OFF: Final = "on no level"
SHORT: Final = "in a piece too short"
END: Final = "at the end of a piece"
LONELY: Final = "ends without a partner"
THICK: Final = "ends in the shadow of a thick bar"


@dataclass(frozen=True, slots=True, kw_only=True)
class Correspondence:
    """Observations of one picture and where they come from.

    Parameters
    ----------
    line, pairs : observations.
    rows : (n,) rows of the table that the line points come from.
    segment : (n,) number of the piece of line that each line point is on.
    level : (m,) level of every row of the table, -1 for none.
    edges, matched : ends of the pieces, and how they were matched.
    counts : what was dropped, and how much of it.
    gaps : by level, gaps between its pieces.
    lost : names of levels on which the line was seen, and none or hardly any of its points was left.
    """

    line: LineObservations
    pairs: PairObservations
    rows: ArrayI
    segment: ArrayI
    level: ArrayI
    edges: Edges
    matched: Pairs
    counts: dict[str, int]
    gaps: tuple[int, ...]
    lost: tuple[str, ...]


def correspond(
    sensor: Sensor,
    points: pd.DataFrame,
    grid: GridObject,
    settings: CalibrationSettings,
    *,
    first: bool = False,
) -> Correspondence:
    """Assign the line points of a picture to levels and their ends to each other.

    Parameters
    ----------
    sensor : approximate values.
    points : line points, see `COLUMNS`.
    grid : calibration object.
    settings : what counts as a piece, a gap, a flagged point.
    first : whether this is the first look with poor approximate values, when pairs may still be few.

    Raises
    ------
    InputError : columns are missing, or too few points have numbers.
    GeometryError : the line does not look as the object and the nominal design say: no sheet under water, one
        level only, no gaps, swapped levels.
    """
    xy, sigma, direction, peak, good, flagged, counts = _measured(points, settings.drop_flags)
    met = intersect(sensor, np.where(good[:, None], xy, np.nan))
    depth, fan, wet = _under_water(met.depth_mm, met.fan_angle_rad, met.status, good, counts, sensor)
    level = np.full(len(xy), OFF_LEVELS, dtype=np.int64)
    level[wet] = levels_of_points(depth[wet], fan[wet], grid.depths_mm, search=first)
    counts[OFF] = int((level[wet] == OFF_LEVELS).sum())
    segments, short = segments_of(
        xy,
        np.where(wet, fan, 0.0),
        level,
        least_gap_px=settings.least_gap_px,
        least_points=settings.least_points,
    )
    level[short] = OFF_LEVELS
    counts[SHORT] = int(short.sum())
    _require_levels(level, segments, int(wet.sum()), grid)
    edges = edges_of(xy, peak, segments, sensor.camera.size_px, border_px=settings.least_gap_px)
    at_edges = intersect(sensor, edges.xy_px)
    # an end whose ray misses the sheet stands beside its piece: no partner
    fan_edges = np.where(at_edges.ok, at_edges.fan_angle_rad, _fan_of_pieces(fan, segments, edges))
    matched = match(edges, fan_edges, 1 if first else len(grid.levels), reach_rad=_REACH_RAD)
    gaps = tuple(max(0, sum(s.level == k for s in segments) - 1) for k in range(len(grid.levels)))
    _require_gaps(xy, matched, segments, grid, gaps, first=first)
    upper, lower, thick = _without_thick(edges, matched, fan_edges, grid, sensor)
    counts[LONELY], counts[THICK] = len(matched.lonely), thick
    if len(upper) < LEAST_PAIRS and not first:
        raise GeometryError(
            f"{len(upper)} pairs of ends on one sub-beam ({', '.join(_pieces(segments, grid))})",
            expected=f"at least {LEAST_PAIRS}, the ends of two gaps",
            where=f"calibration object {grid.name!r}",
            cure="Let more gaps of the grid lie under the line, and check that the camera sees the pieces "
            "below "
            "them",
        )
    rows, number, trimmed = _inner(segments, settings.trim)
    counts[END], counts[FLAGGED] = trimmed, int(flagged[rows].sum())
    rows, number = rows[~flagged[rows]], number[~flagged[rows]]
    lost = _lost_levels(level, rows, grid, counts)
    line = LineObservations(
        xy_px=xy[rows], sigma_px=sigma[rows], direction=direction[rows], level=level[rows]
    )
    pairs = PairObservations(
        upper_px=edges.xy_px[upper],
        upper_out=edges.outward[upper],
        lower_px=edges.xy_px[lower],
        lower_out=edges.outward[lower],
        side=edges.side[upper],
        sigma_px=np.hypot(
            settings.sigma_edge_px, np.stack([edges.sigma_px[upper], edges.sigma_px[lower]], axis=1)
        ),
    )
    return Correspondence(
        line=line,
        pairs=pairs,
        rows=rows,
        segment=number,
        level=level,
        edges=edges,
        matched=matched,
        counts={what: n for what, n in counts.items() if n},
        gaps=gaps,
        lost=lost,
    )


def _measured(
    points: pd.DataFrame, drop_flags: int
) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF, ArrayB, ArrayB, dict[str, int]]:
    """Pixels, sigmas, measured directions, brightness, rows with numbers, flagged rows, what was dropped."""
    missing = [name for name in COLUMNS if name not in points.columns]
    if missing:
        raise InputError(
            f"columns missing: {', '.join(missing)}", expected=", ".join(COLUMNS), where="line points"
        )
    values = points[list(COLUMNS)].to_numpy(np.float64)
    finite = np.isfinite(values).all(axis=1) & (values[:, 2] > 0)
    flags = (
        points["flags"].to_numpy(np.int64) if "flags" in points.columns else np.zeros(len(points), np.int64)
    )
    flagged = finite & ((flags & drop_flags) != 0)
    usable = int((finite & ~flagged).sum())
    counts = {NO_NUMBER: int((~finite).sum())}
    if usable < LEAST_POINTS:
        raise InputError(
            f"{usable} usable line points of {len(points)} ({counts[NO_NUMBER]} without numbers, "
            f"{int(flagged.sum())} flagged)",
            expected=f"at least {LEAST_POINTS}: a line over most of the picture",
            where="line points",
            cure="Look at the picture: is the laser on, in focus, neither black nor over-exposed?",
        )
    angle = values[:, 3]
    peak = (
        points["peak_dn"].to_numpy(np.float64)
        if "peak_dn" in points.columns
        else np.full(len(points), np.nan)
    )
    return (
        values[:, :2],
        values[:, 2],
        np.stack([np.cos(angle), np.sin(angle)], axis=1),
        peak,
        finite,
        flagged,
        counts,
    )


def _under_water(
    depth: ArrayF, fan: ArrayF, status: ArrayU8, good: ArrayB, counts: dict[str, int], sensor: Sensor
) -> tuple[ArrayF, ArrayF, ArrayB]:
    """Depths, fan angles and where there are such; the others are counted by their status."""
    wet = good & (status == Status.OK)
    lost = {s: int((good & (status == s)).sum()) for s in Status if s != Status.OK}
    counts |= {f"ray: {s.name.lower().replace('_', ' ')}": n for s, n in lost.items()}
    if wet.sum() < LEAST_SHARE * good.sum():
        told = ", ".join(f"{n} {s.name.lower().replace('_', ' ')}" for s, n in lost.items() if n)
        raise GeometryError(
            f"only {int(wet.sum())} of {int(good.sum())} line points meet the light sheet under water by the "
            "nominal "
            f"design ({told})",
            expected=f"at least {LEAST_SHARE:.0%}",
            where=f"sensor {sensor.name!r}",
            cure="Check the orientation of the picture (a camera mounted upside down?) and the angles of the "
            "design",
        )
    return depth, fan, wet


def _require_levels(level: ArrayI, segments: list[Segment], wet: int, grid: GridObject) -> None:
    """Refuse a line that is not seen on every level, or that lies mostly on none."""
    where = f"calibration object {grid.name!r}"
    seen = np.array([(level == k).sum() for k in range(len(grid.levels))])
    total = int(seen.sum())
    told = ", ".join(f"{n} on {g.name} ({g.depth_mm:g} mm)" for n, g in zip(seen, grid.levels, strict=True))
    if total < LEAST_SHARE * wet:
        raise GeometryError(
            f"only {total} of {wet} line points lie in pieces of line on the levels ({told})",
            expected=f"at least {LEAST_SHARE:.0%}",
            where=where,
            cure="Look at the picture: reflections, other light, a line that was not found; and check the "
            "stated depths",
        )
    missing = [grid.levels[k].name for k in np.flatnonzero(seen < max(_LEAST_ON_LEVEL * total, 1))]
    if missing:
        raise GeometryError(
            f"the line is seen on {len(grid.levels) - len(missing)} of {len(grid.levels)} levels: {told}; "
            "none on "
            f"{', '.join(missing)} ({', '.join(_pieces(segments, grid))})",
            expected="an interrupted line on the grid, and its fragments on every level below",
            where=where,
            cure="Check that gaps lie under the line, that the camera sees through them, and the stated "
            "depths",
        )


def _lost_levels(level: ArrayI, rows: ArrayI, grid: GridObject, counts: dict[str, int]) -> tuple[str, ...]:
    """Levels that keep hardly a line point; refuses a line that is left on one level only.

    Pieces of few rows, as a small picture shows them behind narrow gaps, are near a jump all along.
    """
    seen = [int((level == k).sum()) for k in range(len(grid.levels))]
    kept = np.bincount(level[rows], minlength=len(grid.levels)).tolist()
    lost = tuple(g.name for g, n in zip(grid.levels, kept, strict=True) if n < POINTS_ON_LEVEL)
    if len(grid.levels) - len(lost) >= 2:
        return lost
    told = ", ".join(f"{n} of {m} on {g.name}" for n, m, g in zip(kept, seen, grid.levels, strict=True))
    raise GeometryError(
        f"line points are left on {len(grid.levels) - len(lost)} of {len(grid.levels)} levels: {told} "
        f"({counts[FLAGGED]} flagged, {counts[END]} at ends of pieces)",
        expected=f"at least {POINTS_ON_LEVEL} points on two levels",
        where=f"calibration object {grid.name!r}",
        cure="Take pictures with more pixels, or an object with wider gaps: the pieces of line are too short",
    )


def _fan_of_pieces(fan: ArrayF, segments: list[Segment], edges: Edges) -> ArrayF:
    """(e,) fan angle of the last point before each end."""
    ends = [
        segments[s].rows[-1 if side > 0 else 0] for s, side in zip(edges.segment, edges.side, strict=True)
    ]
    return fan[np.array(ends, dtype=np.int64)]


def _pieces(segments: list[Segment], grid: GridObject) -> list[str]:
    return [
        f"{sum(s.level == k for s in segments)} "
        f"piece{'s' if sum(s.level == k for s in segments) != 1 else ''} of "
        f"line on {level.name}"
        for k, level in enumerate(grid.levels)
    ]


def _require_gaps(
    xy_px: ArrayF,
    matched: Pairs,
    segments: list[Segment],
    grid: GridObject,
    gaps: tuple[int, ...],
    *,
    first: bool,
) -> None:
    """Refuse a line whose gaps and pieces are not those of a grid over a plate."""
    where = f"calibration object {grid.name!r}"
    told = ", ".join(_pieces(segments, grid))
    if gaps[0] == 0:
        raise GeometryError(
            f"the line on {grid.levels[0].name} has no gap ({told})",
            expected="a line that the gaps of the grid interrupt, with pieces on the level below",
            where=where,
            cure="Turn or move the object so that the line crosses the bars; a detector that bridges gaps "
            "must "
            "not smooth along the line",
        )
    lit, dark, bar, gap = _proportions(xy_px, segments, grid)
    if abs(np.log(lit / dark * bar / gap)) + _CLEARLY < abs(np.log(lit / dark * gap / bar)):
        raise GeometryError(
            f"the levels are swapped: on {grid.levels[0].name} pieces of line and gaps are as "
            f"{lit / dark:.2f} to 1, "
            f"bars and gaps of the grid as {bar / gap:.2f} to 1 ({told})",
            expected="the interrupted line on the grid, and its fragments on the level below",
            where=where,
            cure="Check the depths of the levels, and whether the camera was mounted upside down or the "
            "picture mirrored",
        )
    if not first and matched.overlap > _MOST_OVERLAP:
        raise GeometryError(
            f"{matched.overlap:.0%} of the line below is lit by sub-beams that the level above stops as well "
            f"({told})",
            expected="pieces on the lower level only where the upper one has gaps",
            where=where,
            cure="Check the stated depths, the nominal design, and whether the housing was dry; take out "
            "reflections, and points of other pictures",
        )


def _proportions(
    xy_px: ArrayF, segments: list[Segment], grid: GridObject
) -> tuple[float, float, float, float]:
    """Usual length of pieces and gaps on the first level in pixels, and of bars and gaps of the grid in mm.

    Ones if the object's gaps are not described, or too few are seen.
    """
    gaps = grid.gaps_x_mm if len(grid.gaps_x_mm) >= len(grid.gaps_y_mm) else grid.gaps_y_mm
    top = [segment for segment in segments if segment.level == 0]
    if len(gaps) < 2 or len(top) < 4:
        return 1.0, 1.0, 1.0, 1.0
    ends = np.array([[xy_px[s.rows[0]], xy_px[s.rows[-1]]] for s in top])
    # the first and the last piece may be cut off by the picture or by the end of the fan
    lit = float(np.median(np.linalg.norm(ends[1:-1, 1] - ends[1:-1, 0], axis=1)))
    dark = float(np.median(np.linalg.norm(ends[1:, 0] - ends[:-1, 1], axis=1)))
    return lit, dark, float(np.median(gaps[1:, 0] - gaps[:-1, 1])), float(np.median(gaps[:, 1] - gaps[:, 0]))


def _without_thick(
    edges: Edges, matched: Pairs, fan: ArrayF, grid: GridObject, sensor: Sensor
) -> tuple[ArrayI, ArrayI, int]:
    """Pairs without those whose lower end is the shadow of a bar's lower rim.

    A sub-beam that leans outward and passes the upper rim of the bar before a gap passes the bar. At the far
    side of the gap it hits the side of the next bar, down to its lower rim, which the line on top does not
    show.
    """
    lean = np.abs(np.sin(fan[matched.upper])) / sensor.window.n_water
    outward = edges.side[matched.upper] * fan[matched.upper] >= 0
    keep = outward | (grid.thickness_mm * lean < _THICK_MM)
    return matched.upper[keep], matched.lower[keep], int((~keep).sum())


def _inner(segments: list[Segment], trim: int) -> tuple[ArrayI, ArrayI, int]:
    """Rows of the points of all pieces without their ends, number of the piece, how many ends there were."""
    rows, number, trimmed = [], [], 0
    for i, segment in enumerate(segments):
        cut = min(trim, (len(segment.rows) - 2) // 2)
        inner = segment.rows[cut : len(segment.rows) - cut] if cut > 0 else segment.rows
        rows.append(inner)
        number.append(np.full(len(inner), i))
        trimmed += len(segment.rows) - len(inner)
    return np.concatenate(rows), np.concatenate(number).astype(np.int64), trimmed
