"""From line points of one picture to observations: levels, pieces of line, pairs of their ends."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core.errors import GeometryError, InputError
from thalweg.core.types import ArrayB, ArrayF, ArrayI, ArrayU8
from thalweg.lightsheet.calibration.edges import Edges, Pairs, edges_of, match
from thalweg.lightsheet.calibration.grid import GridObject
from thalweg.lightsheet.calibration.line_levels import OFF_LEVELS, Segment, levels_of_points, segments_of
from thalweg.lightsheet.calibration.model import LineObservations, PairObservations
from thalweg.lightsheet.calibration.settings import CalibrationSettings
from thalweg.lightsheet.optics.intersection import intersect
from thalweg.lightsheet.optics.refracted_rays import Status
from thalweg.lightsheet.optics.sensor import Sensor

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
        line=line, pairs=pairs, rows=rows, segment=number, level=level, edges=edges, matched=matched,
        counts={what: n for what, n in counts.items() if n}, gaps=gaps,
        lost=lost,
    )  # fmt: skip


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
    )  # fmt: skip


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
            cure="Check the depths of the levels, and whether the camera was mounted upside down",
        )
    if not first and matched.overlap > _MOST_OVERLAP:
        raise GeometryError(
            f"{matched.overlap:.0%} of the line below is lit by sub-beams that the level above stops as well "
            f"({told})",
            expected="pieces on the lower level only where the upper one has gaps",
            where=where,
            cure="Check the stated depths and the nominal design; take out reflections, and points of other "
            "pictures",
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
