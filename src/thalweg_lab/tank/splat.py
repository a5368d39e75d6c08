"""Light of single points on the pixels: each point spreads as a Gaussian that is integrated over the pixels.

No finer grid is needed, so no half pixel can be lost between two grids: pixel i covers i to i + 1, and the
share of a point at x with the standard deviation s is ``Phi((i + 1 - x) / s) - Phi((i - x) / s)``.
"""

import math
from typing import Final

import numba as nb
import numpy as np

from thalweg.core.types import ArrayF, ArrayF32

_REACH: Final = 4.0
"""Sigmas that a point reaches; 1.3e-4 of its light lies outside and is given to what is inside."""


def splat(image: ArrayF32, xy_px: ArrayF, light: ArrayF, sigma_px: ArrayF) -> None:
    """Add points to an image in place.

    Parameters
    ----------
    image : (h, w); what falls outside is lost.
    xy_px : (n, 2), counted from the upper left corner.
    light : (n,) sum over the pixels of each point.
    sigma_px : (n,) standard deviation of its Gaussian.
    """
    finite = np.isfinite(xy_px).all(axis=1) & np.isfinite(light) & (light > 0)
    _splat(image, np.ascontiguousarray(xy_px[finite]), light[finite], sigma_px[finite], _REACH)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _splat(image: ArrayF32, xy: ArrayF, light: ArrayF, sigma: ArrayF, reach: float) -> None:
    height, width = image.shape
    for n in range(len(xy)):
        x, y, s = xy[n, 0], xy[n, 1], sigma[n]
        if not (x > -reach * s and y > -reach * s and x < width + reach * s and y < height + reach * s):
            continue
        left, right = math.floor(x - reach * s), math.floor(x + reach * s)
        top, bottom = math.floor(y - reach * s), math.floor(y + reach * s)
        nx, ny = int(right - left) + 1, int(bottom - top) + 1
        along, down = np.empty(nx), np.empty(ny)
        scale = 1.0 / (s * math.sqrt(2.0))
        before, total_x = math.erf((left - x) * scale), 0.0
        for i in range(nx):
            after = math.erf((left + i + 1 - x) * scale)
            along[i] = after - before
            total_x += along[i]
            before = after
        before, total_y = math.erf((top - y) * scale), 0.0
        for j in range(ny):
            after = math.erf((top + j + 1 - y) * scale)
            down[j] = after - before
            total_y += down[j]
            before = after
        share = light[n] / (total_x * total_y)
        for j in range(ny):
            row = int(top) + j
            if row < 0 or row >= height:
                continue
            part = share * down[j]
            for i in range(nx):
                column = int(left) + i
                if column >= 0 and column < width:
                    image[row, column] += part * along[i]
