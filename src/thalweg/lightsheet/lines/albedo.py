"""Edges of the brightness of a surface: points near them are flagged; a shift with the line's width is
removed.

On white markers the line is over-exposed. A halo on one side (towards the laser, P4 7.2) then widens it on
that side and pulls its centre along; the distances from the object become bi-modal. Where the brightness
jumps while the surface goes on, the jump of the line's place per jump of its width is the coefficient of
that shift ::

    x - x_true = k (w - w_0),       dx = k dw + c

over all edges of the image, c being what a curved line leaves at all of them. ``w_0`` is the width of the
line where it is not saturated. The correction is used only if ``k`` stands out of its own sigma, which goes
into the points.

The shift is pooled over the images of a series. A single image has some ten edges of brightness, too few to
tell the coefficient from nothing. The surface, the lens and the exposure of a series are the same in all of
its images::

    k = sum(k_i / s_i^2) / sum(1 / s_i^2),      s_k^2 = max(1, chi^2 / (n - 1)) / sum(1 / s_i^2)
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from thalweg.core import NMAD, ArrayB, ArrayF, ArrayI
from thalweg.lightsheet.lines.points import LinePoints
from thalweg.lightsheet.lines.settings import LineFlag

_SIDE: Final = 6
"""Rows on each side of an edge whose mean brightness is compared."""
_RATIO: Final = 1.6
"""Change between the means of the rows on both sides that counts."""
_GAP: Final = 2
"""Rows beside an edge that see both sides at least: of pixels, smoothing and the marker's own rim."""
_APART: Final = 3
"""Rows from which on speckle no longer correlates."""
_LEAST_EDGES: Final = 4
_ENOUGH_EDGES: Final = 7
"""From which on a change of the curvature along the line is estimated as well."""
_TURNS: Final = 5
SIGNIFICANT: Final = 4.0
"""Sigmas by which a coefficient must differ from zero to be used."""
_LEAST_WIDTH_JUMP: Final = 0.1
"""Change of the width, relative, from which on an edge says something about the shift."""


@dataclass(frozen=True, slots=True)
class WidthShift:
    """Shift of a line per pixel of its width: ``coefficient``, its ``sigma``, number of ``edges``.

    ``usual_width_px`` of the points that are not saturated, NaN if it is not of one image.
    """

    coefficient: float
    sigma: float
    edges: int
    applied: bool
    usual_width_px: float = float("nan")


def albedo_edges(piece: ArrayI, peak_dn: ArrayF, rows: ArrayI) -> tuple[ArrayB, ArrayI]:
    """Points near a change of brightness along the line, and the edges themselves.

    Parameters
    ----------
    piece, peak_dn, rows : (n,) sorted by piece and row; ``rows`` is the height of each patch.

    Returns
    -------
    near : (n,) points whose patch sees both sides.
    edges : (m,) indices; the change is before that point.
    """
    n = piece.size
    log_peak = np.log(np.maximum(peak_dn, 1e-3))
    near = np.zeros(n, bool)
    if n < 2 * _SIDE + 1:
        return near, np.zeros(0, np.int64)
    total = np.r_[0.0, np.cumsum(log_peak)]
    at = np.arange(_SIDE, n - _SIDE + 1)
    change = np.zeros(n + 1)
    change[at] = np.abs(total[at + _SIDE] - 2.0 * total[at] + total[at - _SIDE]) / _SIDE
    whole = np.zeros(n + 1, bool)
    whole[at] = piece[at + _SIDE - 1] == piece[at - _SIDE]
    change[~whole] = 0.0
    # speckle changes the peak of a row too; its mean over the rows of a side is compared with that scatter
    steps = np.abs(log_peak[_APART:] - log_peak[:-_APART])
    scatter = NMAD * float(np.median(steps)) / np.sqrt(2.0)
    level = max(np.log(_RATIO), 4.5 * scatter * np.sqrt(2.0 / _SIDE))
    index = np.flatnonzero(change > level)
    edges = [int(k) for k in index if change[k] >= change[max(0, k - _SIDE) : k + _SIDE + 1].max() - 1e-12]
    for k in edges:
        low, high = max(0, k - _SIDE - int(rows.max())), min(n, k + _SIDE + int(rows.max()))
        here = np.arange(low, high)
        touched = np.abs(here + 0.5 - k) <= rows[here] // 2 + 1
        near[here[touched & (piece[here] == piece[min(k, n - 1)])]] = True
    return near, np.asarray(edges, np.int64)


def width_shift(
    x_px: ArrayF,
    width_px: ArrayF,
    sigma_px: ArrayF,
    saturated: ArrayB,
    piece: ArrayI,
    edges: ArrayI,
    rows: ArrayI,
) -> WidthShift:
    """How far a line's place goes with its width.

    Each edge compares straight lines through the rows on both sides, extrapolated to the edge, so that the
    slope of the surface does not count. Rows whose patches, ``rows`` (n,) high, see both sides take no part:
    their places and widths lie between both, at other shares.
    """
    differences = [_jump(x_px, width_px, sigma_px, piece, int(k), _gap(rows, int(k))) for k in edges]
    known = [i for i, d in enumerate(differences) if d is not None]
    usable = np.array([differences[i] for i in known]).reshape(-1, 3)
    clear = np.abs(usable[:, 1]) > _LEAST_WIDTH_JUMP * np.median(width_px)
    usable, at = usable[clear], edges[known][clear].astype(np.float64)
    usual = float(np.median(width_px[~saturated])) if not saturated.all() else float("nan")
    if len(usable) < _LEAST_EDGES or not saturated.any() or saturated.all():
        return WidthShift(0.0, float("nan"), len(usable), False, usual)
    k, sigma_k = _slope(usable[:, 0], usable[:, 1], usable[:, 2], at)
    return WidthShift(k, sigma_k, len(usable), abs(k) > SIGNIFICANT * sigma_k, usual)


def pooled_shift(facts: Sequence[Mapping[str, float]]) -> WidthShift:
    """Coefficient of a series from the ones that `detect_lines` has found in each image.

    Parameters
    ----------
    facts : of `LinePoints`; images without a coefficient or its sigma take no part.
    """
    found = np.array(
        [
            (each["width_shift"], each["sigma_width_shift"], each["width_shift_edges"])
            for each in facts
            if np.isfinite(each.get("sigma_width_shift", np.nan))
        ]
    ).reshape(-1, 3)
    if not len(found):
        return WidthShift(0.0, float("nan"), 0, False)
    k, sigma, edges = found.T
    weight = 1.0 / np.square(sigma)
    mean = float(np.sum(weight * k) / weight.sum())
    factor = max(1.0, float(np.sum(weight * np.square(k - mean))) / max(len(k) - 1, 1))
    sigma_k = float(np.sqrt(factor / weight.sum()))
    return WidthShift(mean, sigma_k, int(edges.sum()), bool(abs(mean) > SIGNIFICANT * sigma_k))


def without_shift(points: LinePoints, shift: WidthShift) -> LinePoints:
    """Points of one image without the shift of a series; as they are if it does not stand out or is removed.

    Parameters
    ----------
    points : as `detect_lines` gives them.
    shift : see `pooled_shift`.
    """
    usual = points.facts.get("width_unsaturated_px", float("nan"))
    done = points.facts.get("width_shift_applied", 0.0) > 0.0
    if done or not shift.applied or not np.isfinite(usual):
        return points
    wider = np.where(points.has(LineFlag.SATURATED), points.width_px - usual, 0.0)
    along = np.stack([np.cos(points.angle_rad), np.sin(points.angle_rad)])
    # the coefficient counts along a row or a column, whichever the line was measured in
    step = -shift.coefficient * wider * along / np.abs(along).max(axis=0)
    return replace(
        points,
        x_px=points.x_px + step[0],
        y_px=points.y_px + step[1],
        sigma_px=np.hypot(points.sigma_px, shift.sigma * np.abs(wider)),
        facts=points.facts
        | {"width_shift": shift.coefficient, "sigma_width_shift": shift.sigma, "width_shift_applied": 1.0},
    )


def _slope(dx: ArrayF, dw: ArrayF, sigma: ArrayF, at: ArrayF) -> tuple[float, float]:
    """Jump of the place per jump of the width over edges, and its standard deviation.

    A line that is curved in the image leaves the same jump at rising and falling edges; it changes slowly
    along the line, and is an unknown as well.
    """
    columns = [dw, np.ones(len(dx))]
    if len(dx) >= _ENOUGH_EDGES:
        columns.append((at - at.mean()) / max(float(np.ptp(at)), 1.0))
    design, weight = np.stack(columns, axis=1), 1.0 / sigma
    for _ in range(_TURNS):
        inverse = np.linalg.pinv((design * weight[:, None]).T @ (design * weight[:, None]))
        x = inverse @ (design * np.square(weight)[:, None]).T @ dx
        off = np.abs(dx - design @ x) / sigma
        usual = max(NMAD * float(np.median(off)), 1.0)
        weight = np.sqrt(np.minimum(1.0, 2.0 * usual / np.maximum(off, 1e-9))) / sigma
    free = max(len(dx) - design.shape[1], 1)
    factor = max(1.0, float(np.sum(np.square(weight * (dx - design @ x)))) / free)
    return float(x[0]), float(np.sqrt(factor * inverse[0, 0]))


def _gap(rows: ArrayI, edge: int) -> int:
    """Rows beside an edge whose patches reach over it."""
    near = rows[max(0, edge - _SIDE) : edge + _SIDE]
    return max(_GAP, int(near.max(initial=1)) // 2 + 1)


def _jump(
    x_px: ArrayF, width_px: ArrayF, sigma_px: ArrayF, piece: ArrayI, edge: int, gap: int
) -> tuple[float, float, float] | None:
    """Jump of place and width at an edge, and the sigma of the former; None where a side is missing."""
    before = np.arange(edge - gap - _SIDE, edge - gap)
    after = np.arange(edge + gap, edge + gap + _SIDE)
    both = np.r_[before, after]
    if before[0] < 0 or after[-1] >= piece.size or np.any(piece[both] != piece[edge]):
        return None
    side = np.r_[np.zeros(_SIDE), np.ones(_SIDE)]
    design = np.stack([np.ones(both.size), side, both - float(edge)], axis=1)
    inverse = np.linalg.pinv(design)
    place = inverse[1] @ x_px[both]
    spread = float(np.sqrt(np.sum((inverse[1] * sigma_px[both]) ** 2)))
    width = float(np.median(width_px[after]) - np.median(width_px[before]))
    return float(place), width, max(spread, 1e-3)
