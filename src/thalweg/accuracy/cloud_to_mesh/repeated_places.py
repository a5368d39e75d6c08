"""Do offsets come back where a place is measured again? What tells a place from the moment it was measured.

The points of a cell are parted at the longest pause that leaves enough of them before and after. If it lasts
`PAUSE` correlation times and more, the errors of poses at both visits are independent, and the covariance of
the cells' means at both is the variance of what belongs to the places:

    cov(m_1, m_2) = var(place),    m_k = place + moment_k + noise_k

**Significance.** Cells that lie together are measured together and share a moment: two smooth maps that have
nothing to do with one another are correlated by chance far more often than their number of cells says. The
number of independent cells follows from how smooth both are (Clifford, Richardson, Hemon 1989),

    1 / (N - 1) = sum_ij C_1(i, j) C_2(i, j) / (sum_i C_1(i, i) sum_j C_2(j, j))

with the autocovariances by classes of distance, and ``r sqrt((N - 2) / (1 - r^2))`` follows Student's
distribution. One-sided: places that differ have a positive correlation.

What is the same at all visits is found here, whatever its cause: the bank that moved, the reference, plants,
but also a wrong mount, if the boat came along the same way again.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.distance import pdist
from scipy.stats import t as student

from thalweg.core.cells import cell_numbers
from thalweg.core.types import ArrayF, ArrayI

PAUSE: Final = 3.0
"""Correlation times between two visits; exp(-3) of an error, 5 %, is left."""

LEAST_CELLS: Final = 30
"""Fewer cells that were measured twice give no answer."""

LEAST_INDEPENDENT: Final = 4.0
"""Fewer independent cells give none either."""

_MOST_CELLS: Final = 2_500
_CLASS_WIDTHS: Final = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Repeated:
    """Result of `repeated_places`.

    ``n_cells`` were measured twice, at least ``gap_s`` apart. ``correlation`` of their means is None if
    they are too few; they are worth ``independent`` cells, ``p`` is the probability of such a correlation
    without any differences between places, which otherwise are ``std_of_places_m``.
    """

    n_cells: int
    gap_s: float
    correlation: float | None = None
    independent: float = np.nan
    p: float = np.nan
    std_of_places_m: float = np.nan


def repeated_places(
    points_m: ArrayF,
    values_m: ArrayF,
    t_gps_s: ArrayF,
    *,
    width_m: float,
    correlation_s: float,
    least_points: int,
) -> Repeated:
    """Correlate the means of cells with those of the same cells at another time.

    Parameters
    ----------
    points_m : (n, 3) places.
    values_m, t_gps_s : (n,) what was measured there, and when.
    width_m : width of the cells.
    correlation_s : correlation time of the slowest error that changes.
    least_points : so many points a cell must have at both visits.
    """
    number = cell_numbers(points_m, width_m)
    gap_s = PAUSE * correlation_s
    cell, start, split, end = _visits(number, t_gps_s, gap_s, least_points)
    n_cells = len(cell)
    if n_cells < LEAST_CELLS:
        return Repeated(n_cells=n_cells, gap_s=gap_s)
    some = slice(None, None, -(-n_cells // _MOST_CELLS))
    start, split, end = start[some], split[some], end[some]
    order = np.lexsort((t_gps_s, number))
    sums = np.vstack([np.zeros(4), np.cumsum(np.column_stack([points_m, values_m])[order], axis=0)])
    one = (sums[split, 3] - sums[start, 3]) / (split - start)
    two = (sums[end, 3] - sums[split, 3]) / (end - split)
    middle = (sums[end, :3] - sums[start, :3]) / (end - start)[:, None]
    one, two = one - one.mean(), two - two.mean()
    covariance = float(np.mean(one * two))
    scale = float(np.sqrt(np.mean(one**2) * np.mean(two**2)))
    if scale == 0:
        return Repeated(n_cells=n_cells, gap_s=gap_s)
    independent = independent_cells(middle, one, two, class_m=_CLASS_WIDTHS * width_m)
    if independent < LEAST_INDEPENDENT:
        return Repeated(n_cells=n_cells, gap_s=gap_s)
    r = covariance / scale
    size = r * np.sqrt((independent - 2) / max(1 - r**2, 1e-12))
    return Repeated(
        n_cells=n_cells,
        gap_s=gap_s,
        correlation=r,
        independent=independent,
        p=float(student.sf(size, independent - 2)),
        std_of_places_m=float(np.sqrt(max(covariance, 0.0))),
    )


def independent_cells(middle_m: ArrayF, one: ArrayF, two: ArrayF, *, class_m: float) -> float:
    """So many independent cells two maps on the same cells are worth in a correlation of both.

    Parameters
    ----------
    middle_m : (c, 3) places of the cells.
    one, two : (c,) their values, with a mean of zero.
    class_m : width of the classes of distance.
    """
    n = len(one)
    number = (pdist(middle_m) / class_m).astype(np.int64)
    first, second = np.triu_indices(n, 1)
    count = np.bincount(number)
    products = [np.bincount(number, weights=m[first] * m[second]) / np.maximum(count, 1) for m in (one, two)]
    diagonal = float(np.mean(one**2) * np.mean(two**2))
    # noise of empty or far classes has both signs and must not make more of the cells than there are
    shared = n * diagonal + 2 * float(np.sum(count * products[0] * products[1]))
    if shared <= 0:
        return float(n)
    return float(min(1 + n**2 * diagonal / shared, n))


def _visits(
    number: ArrayI, t_gps_s: ArrayF, gap_s: float, least_points: int
) -> tuple[ArrayI, ArrayI, ArrayI, ArrayI]:
    """Cells with two visits; rows where each, its second visit and the next cell begin, by cell and time."""
    order = np.lexsort((t_gps_s, number))
    t = t_gps_s[order]
    count = np.bincount(number)
    end = np.cumsum(count)
    start = end - count
    row = np.arange(len(t))
    owner = number[order]
    before, after = row - start[owner], end[owner] - row
    pause = np.diff(t, prepend=t[:1])
    pause[(before < least_points) | (after < least_points)] = -1.0
    longest = np.maximum.reduceat(pause, start)
    # the first row of each cell where its longest pause ends
    split = np.full(len(count), len(t))
    is_longest = (pause == longest[owner]) & (pause >= gap_s)
    np.minimum.at(split, owner[is_longest], row[is_longest])
    cell = np.flatnonzero(longest >= gap_s)
    return cell, start[cell], split[cell], end[cell]
