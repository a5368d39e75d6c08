"""Which pieces of line are no laser: bright strips of a pattern in daylight are bright in red and blue, too.

A laser of one colour hardly reaches the other pixels of a mosaic. Across each candidate the light of red and
blue pixels is compared with that of the green ones, pixel by pixel, and its slope is taken over the whole
piece::

    slope = sum(g - g_mean)(o - o_mean) / sum(g - g_mean) ^ 2

Green pixels near saturation are left out: an over-exposed line goes on growing in red and blue.
"""

from typing import Final

import cv2
import numba as nb
import numpy as np

from thalweg.core.types import ArrayB, ArrayF, ArrayF32, ArrayI
from thalweg.lightsheet.lines.green import SATURATED, GreenImage

_LEAST_PIXELS: Final = 24
"""Unsaturated pixels of a piece below which it is not judged."""
_BESIDE: Final = np.ones((3, 5), np.uint8)


def colour_slopes(image: GreenImage, row: ArrayI, x_px: ArrayF, piece: ArrayI, reach_px: int) -> ArrayF:
    """Slope of red and blue against green light for each piece; NaN where it cannot be judged.

    Parameters
    ----------
    image : with red and blue light, else all pieces are NaN.
    row, x_px, piece : (n,) candidates.
    reach_px : pixels on both sides of a candidate that count.
    """
    n = int(piece.max(initial=-1)) + 1
    if image.other is None or not n:
        return np.full(n, np.nan)
    clipped = cv2.dilate((image.bits & SATURATED > 0).astype(np.uint8), _BESIDE) > 0
    sums = np.zeros((n, 3))
    _sums(image.dn, image.other, clipped, row, x_px, piece, reach_px, sums)
    known = (sums[:, 0] >= _LEAST_PIXELS) & (sums[:, 1] > 0.0)
    return np.where(known, sums[:, 2] / np.where(known, sums[:, 1], 1.0), np.nan)


@nb.njit(cache=True, error_model="numpy", nogil=True)
def _sums(
    green: ArrayF32, other: ArrayF32, clipped: ArrayB, row: ArrayI, x: ArrayF, piece: ArrayI, reach: int,
    out: ArrayF,
) -> None:  # fmt: skip
    """Number of pixels, sum of squares of green, sum of products, by piece; each row about its own means."""
    width = green.shape[1]
    for i in range(len(row)):
        r, c = row[i], int(x[i])
        n, g, o, gg, go = 0, 0.0, 0.0, 0.0, 0.0
        for k in range(max(0, c - reach), min(width, c + reach + 1)):
            if clipped[r, k]:
                continue
            n += 1
            g += green[r, k]
            o += other[r, k]
            gg += green[r, k] * green[r, k]
            go += green[r, k] * other[r, k]
        if n > 2:
            out[piece[i], 0] += n
            out[piece[i], 1] += gg - g * g / n
            out[piece[i], 2] += go - g * o / n
