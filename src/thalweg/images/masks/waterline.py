"""The line between land and water: one row per column, the best path through an image.

What a path costs is the sum, over all pixels, of how unlikely water is below it and land or sky above it
(the region's, not only the edge's evidence), a price on its bends, and what is known beforehand about where
it lies. Dynamic programming finds the best of all paths.
"""

from typing import Final

import numba as nb
import numpy as np

from thalweg.core.types import ArrayF32, ArrayI

_MOST: Final = 1.0
"""Evidence of one pixel counts up to this much: neighbours err alike."""

STEEPEST: Final = 3
"""Rows that a line may climb from one column to the next."""


@nb.njit(cache=True, error_model="numpy")
def _best_path(cost, bend, steepest):  # type: ignore[no-untyped-def]
    """Row in each column of the path of least cost (rows, columns) plus ``bend`` times squared steps."""
    n, m = cost.shape
    back = np.zeros((m, n), np.int8)
    now, last = np.empty(n), cost[:, 0].astype(np.float64)
    for x in range(1, m):
        for r in range(n):
            best, at = np.inf, 0
            for d in range(-steepest, steepest + 1):
                k = r + d
                if k < 0 or k >= n:
                    continue
                c = last[k] + bend * d * d
                if c < best:
                    best, at = c, d
            now[r] = best + cost[r, x]
            back[x, r] = at
        for r in range(n):
            last[r] = now[r]
    rows = np.empty(m, np.int64)
    at_row = np.argmin(last)
    for x in range(m - 1, -1, -1):
        rows[x] = at_row
        at_row += back[x, at_row]
    return rows


def water_line(log_ratio: ArrayF32, prior: ArrayF32, *, bend: float) -> ArrayI:
    """First row of water in each column; the number of rows where a column has no water.

    Parameters
    ----------
    log_ratio : (h, w) logarithm of the probability of water over that of anything else; 0: no evidence.
    prior : (h + 1, w) cost of a line above row r, in the same unit.
    bend : price of a step of one row, in the same unit; two rows cost four times as much.
    """
    h = len(log_ratio)
    cost = prior.astype(np.float32, copy=True)
    # A pixel of water above the line is as wrong as one of land below it.
    cost[1:] += np.cumsum(np.clip(log_ratio, -_MOST, _MOST), axis=0)
    rows = _best_path(cost, bend, STEEPEST)
    return np.minimum(rows, h)
