"""Ridges of the smoothed image, after Steger (1998, *An unbiased detector of curvilinear structures*).

The image is convolved with derivatives of a Gaussian. Across a ridge (the direction of the largest negative
second derivative) the first derivative vanishes ::

    t = -r_n / r_nn,       r_n = n . grad r,       r_nn = n^T H n

Here the derivatives are taken at a place between the pixels that moves along its row until ``t`` is zero, so
that the point lies in the centre of its row. Its sigma comes from the same convolution: ``dt = -dr_n /
r_nn``.
"""

from typing import Final

import numba as nb
import numpy as np

from thalweg.core.types import ArrayF, ArrayF32, ArrayI
from thalweg.lightsheet.lines.green import GreenImage
from thalweg.lightsheet.lines.noise import PixelNoise

_REACH: Final = 3.5
"""Half size of the convolution in standard deviations."""
_TURNS: Final = 30


def ridge_points(image: GreenImage, row: ArrayI, x_px: ArrayF, scale_px: float, noise: PixelNoise) -> ArrayF:
    """Place, sigma, width, height and background of the ridge near each start.

    Parameters
    ----------
    image : green light.
    row, x_px : (n,) starts.
    scale_px : standard deviation of the smoothing; at least ``half width / sqrt(3)`` (Steger eq. 7, for
        bars).
    noise : for the sigma.

    Returns
    -------
    fitted : (n, 11) in the columns of `patch.fit_patches`; NaN where no ridge is near. Its MEAN counts from
        the start. The height is that of the smoothed ridge, the width follows from its curvature.
    """
    return np.asarray(
        _ridges(
            image.dn,
            image.bits,
            row,
            x_px,
            float(scale_px),
            _REACH,
            _TURNS,
            noise.vector(),
            noise.correlation,
        )
    )


@nb.njit(cache=True, error_model="numpy", nogil=True)
def _correlated(v: ArrayF, rows: int, columns: int, rho: ArrayF) -> float:
    """Sum over all pairs of v_i v_j rho_ij as in `patch`: compiled files share no code."""
    lag = rho.shape[0] - 1
    total = 0.0
    for i in range(rows):
        for j in range(columns):
            value = v[i, j]
            if value == 0.0:
                continue
            total += value * value
            near = 0.0
            for q in range(1, lag + 1):
                if j + q < columns:
                    near += rho[0, lag + q] * v[i, j + q]
            for p in range(1, lag + 1):
                if i + p >= rows:
                    break
                for q in range(-lag, lag + 1):
                    if 0 <= j + q < columns:
                        near += rho[p, lag + q] * v[i + p, j + q]
            total += 2.0 * value * near
    return total


@nb.njit(cache=True, error_model="numpy", nogil=True)
def _ridges(
    dn: ArrayF32,
    bits: ArrayF32,
    row: ArrayI,
    x_px: ArrayF,
    scale: float,
    reach: float,
    turns: int,
    noise: ArrayF,
    rho: ArrayF,
) -> ArrayF:
    """See `ridge_points`."""
    height, width = dn.shape
    half = int(np.ceil(reach * scale))
    size = 2 * half + 2
    out = np.full((row.size, 11), np.nan)
    influence = np.zeros((size, size))
    gy, gx = np.empty(size), np.empty(size)
    s2 = scale * scale
    for i in range(row.size):
        y = row[i] + 0.5
        x = x_px[i]
        top, bottom = max(0, row[i] - half), min(height, row[i] + half + 1)
        for turn in range(turns):
            left, right = max(0, int(x) - half), min(width, int(x) + half + 1)
            lowest = 1e30
            for r in range(top, bottom):
                gy[r - top] = np.exp(-0.5 * (r + 0.5 - y) ** 2 / s2)
            for c in range(left, right):
                gx[c - left] = np.exp(-0.5 * (c + 0.5 - x) ** 2 / s2)
            # the background is subtracted, so that a kernel cut off by the border does not see it
            for r in range(top, bottom):
                lowest = min(lowest, min(dn[r, left], dn[r, right - 1]))
            rx = ry = rxx = rxy = ryy = r0 = total = 0.0
            for r in range(top, bottom):
                dy = y - (r + 0.5)
                for c in range(left, right):
                    dx = x - (c + 0.5)
                    k = gy[r - top] * gx[c - left]
                    v = k * (dn[r, c] - lowest)
                    r0 += v
                    total += k
                    rx -= v * dx / s2
                    ry -= v * dy / s2
                    rxx += v * (dx * dx / s2 - 1.0) / s2
                    ryy += v * (dy * dy / s2 - 1.0) / s2
                    rxy += v * dx * dy / (s2 * s2)
            # direction of the largest negative second derivative
            turned = 0.5 * np.arctan2(2.0 * rxy, rxx - ryy)
            nx, ny = np.cos(turned), np.sin(turned)
            first = rxx * nx * nx + 2.0 * rxy * nx * ny + ryy * ny * ny
            if first > rxx + ryy - first:
                nx, ny = -ny, nx
                first = rxx + ryy - first
            if first >= 0.0 or abs(nx) < 0.3:
                break
            t = -(rx * nx + ry * ny) / first
            # along the row, the ridge is further away than along its normal
            move = min(max(t / nx, -0.5 * scale), 0.5 * scale)
            x += move
            if abs(x - x_px[i]) > 2.0 * scale or x < 1.0 or x > width - 1.0:
                break
            if abs(move) < 5e-4 and turn > 0:
                independent = 0.0
                saturated = 0
                pixels = 0
                for r in range(top, bottom):
                    dy = y - (r + 0.5)
                    for c in range(left, right):
                        dx = x - (c + 0.5)
                        k = gy[r - top] * gx[c - left]
                        u = k * (dx * nx + dy * ny) / (s2 * first * nx)
                        light = max(dn[r, c] - lowest, 0.0)
                        clipped = bits[r, c] & 2
                        independent += u * u * (noise[0] + noise[1] * max(float(dn[r, c]), 0.0))
                        # a grey value carries its own speckle: E v^2 = (1 + contrast^2) mu^2
                        influence[r - top, c - left] = (
                            0.0 if clipped else u * light * np.sqrt(noise[2] / (1.0 + noise[2]))
                        )
                        if clipped and abs(dx) < scale and abs(dy) <= 0.5:
                            saturated += 1
                        pixels += 1
                variance = independent + _correlated(influence, bottom - top, right - left, rho)
                smooth = r0 / total
                out[i, 0] = x - x_px[i]
                out[i, 1] = np.sqrt(variance)
                # a smoothed Gaussian of variance v has the curvature -height / v along its normal
                spread = max(-r0 / first - s2, 0.25)
                out[i, 2] = 2.0 * np.sqrt(spread)
                out[i, 3] = smooth * np.sqrt((spread + s2) / spread)
                out[i, 4] = lowest
                out[i, 5] = -ny / nx
                out[i, 6] = 1.0
                out[i, 7] = pixels
                out[i, 8] = saturated
                out[i, 9] = out[i, 10] = 0.0
                break
    return out
