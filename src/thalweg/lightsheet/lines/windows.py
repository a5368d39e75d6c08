"""Which pixels belong to a patch, and first guesses of its peak and background: before `patch` fits it."""

import numba as nb
import numpy as np

from thalweg.core.types import ArrayF, ArrayF32, ArrayI


@nb.njit(cache=True, error_model="numpy", nogil=True)
def _row_ranges(
    row: int, x: float, cosine: float, sine: float, tilt: float, h_n: float, h_t: float, top: int, bottom:
    int, width: int, ranges: ArrayI,
) -> None:  # fmt: skip
    """Columns (first, end) of the rows of a patch from ``top`` to ``bottom``.

    A pixel belongs to it if its centre is within ``h_t`` along and ``h_n`` across, both plus half a pixel.
    """
    for r in range(top, bottom):
        dy = float(r - row)
        first, end = width, 0
        # both conditions are linear in the column
        centre = x - 0.5
        reach = (h_n + 0.5 + h_t * (abs(sine) + abs(tilt)) + 1.0) / max(abs(cosine), 0.3)
        low = max(0, int(np.floor(centre - reach - abs(dy))))
        high = min(width, int(np.ceil(centre + reach + abs(dy))) + 1)
        for c in range(low, high):
            dx = c + 0.5 - x
            along = -dx * sine + dy * cosine
            if abs(along) <= h_t + 0.5 and abs(dx * cosine + dy * sine - tilt * along) <= h_n + 0.5:
                first = min(first, c)
                end = max(end, c + 1)
        ranges[r - top, 0] = first
        ranges[r - top, 1] = max(end, first)


@nb.njit(cache=True, error_model="numpy", nogil=True)
def _start(
    dn: ArrayF32, top: int, bottom: int, ranges: ArrayI, row: int, x: float, cosine: float, sine: float,
    half_width: float, slope: float, out: ArrayF,
) -> None:  # fmt: skip
    """Peak and background by a linear fit, lowest and highest grey value, number of pixels."""
    e1 = e2 = y1 = ye = 0.0
    lowest, highest = 1e30, -1e30
    n = 0
    for i in range(bottom - top):
        dy = float(top + i - row)
        for c in range(ranges[i, 0], ranges[i, 1]):
            dx = c + 0.5 - x
            across = dx * cosine + dy * sine
            d = (across - slope * (-dx * sine + dy * cosine)) / half_width
            e = np.exp(-2.0 * d * d)
            value = dn[top + i, c]
            e1 += e
            e2 += e * e
            y1 += value
            ye += e * value
            lowest = min(lowest, value)
            highest = max(highest, value)
            n += 1
    spread = e2 * n - e1 * e1
    peak = (ye * n - y1 * e1) / spread if spread > 0.0 else 0.0
    out[0] = max(peak, 0.1 * (highest - lowest), 1e-3)
    out[1] = min(max((y1 - peak * e1) / max(n, 1), lowest), highest)
    out[2] = lowest
    out[3] = highest
    out[4] = n


@nb.njit(cache=True, error_model="numpy", nogil=True)
def patch_windows(
    dn: ArrayF32, row: ArrayI, x_px: ArrayF, first_row: ArrayI, last_row: ArrayI, slope: ArrayF,
    normal_rad: ArrayF, half_across: ArrayF, half_along: ArrayF, half_width: ArrayF, follow: bool,
) -> tuple[ArrayI, ArrayI, ArrayF]:  # fmt: skip
    """Windows of patches; parameters as in `patch.fit_patches`.

    Returns
    -------
    rows : (n, 2) first row and end.
    ranges : (n, most rows, 2) first column and end in each of them.
    guess : (n, 5) peak and background by a linear fit, lowest and highest grey value, number of pixels.
    """
    height, width = dn.shape
    n = row.size
    rows = np.empty((n, 2), np.int64)
    for i in range(n):
        cosine, sine = abs(np.cos(normal_rad[i])), abs(np.sin(normal_rad[i]))
        reach = int(half_along[i] * cosine + half_across[i] * sine) + (0 if sine == 0.0 else 1)
        # rows beyond the piece of line show something else
        rows[i, 0] = max(0, row[i] - reach, first_row[i])
        rows[i, 1] = min(height, row[i] + reach + 1, last_row[i] + 1)
    ranges = np.zeros((n, np.max(rows[:, 1] - rows[:, 0]), 2), np.int64)
    guess = np.empty((n, 5))
    for i in range(n):
        cosine, sine = np.cos(normal_rad[i]), np.sin(normal_rad[i])
        _row_ranges(
            row[i], x_px[i], cosine, sine, slope[i] if follow else 0.0, half_across[i], half_along[i],
            rows[i, 0], rows[i, 1], width, ranges[i],
        )  # fmt: skip
        _start(
            dn, rows[i, 0], rows[i, 1], ranges[i], row[i], x_px[i], cosine, sine, half_width[i], slope[i],
            guess[i],
        )  # fmt: skip
    return rows, ranges, guess
