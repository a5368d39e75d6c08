"""Kernels of `thalweg.surface.thinning`: points sorted by cell -> one robust point a cell."""

import numba as nb
import numpy as np

from thalweg.core.types import ArrayF, ArrayI

# Open3D brings an old TBB into the process, which numba would try first and complain about.
nb.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]

_BLOCK = 4096


@nb.njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def medians(points: ArrayF, start: ArrayI) -> ArrayF:
    """Median (k, 3) of each coordinate in each cell.

    Parameters
    ----------
    points : (n, 3) sorted by cell.
    start : (k + 1,) first point of each cell, and n.
    """
    k = len(start) - 1
    out = np.empty((k, 3))
    for b in nb.prange((k + _BLOCK - 1) // _BLOCK):
        for c in range(b * _BLOCK, min((b + 1) * _BLOCK, k)):
            for axis in range(3):
                out[c, axis] = np.median(points[start[c] : start[c + 1], axis])
    return out


@nb.njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def local_planes(centre: ArrayF, near: ArrayI) -> tuple[ArrayF, ArrayF]:
    """Unit normals (k, 3), third component not negative, and residual variance (k,) of planes.

    Parameters
    ----------
    centre : (k, 3).
    near : (k, m) neighbours of each, itself among them; k stands for a missing one.
    """
    k, m = near.shape
    normal, variance = np.empty((k, 3)), np.empty(k)
    for b in nb.prange((k + _BLOCK - 1) // _BLOCK):
        for c in range(b * _BLOCK, min((b + 1) * _BLOCK, k)):
            n = 0
            x, y, z = 0.0, 0.0, 0.0
            for j in range(m):
                at = near[c, j]
                if at < k:
                    n += 1
                    x += centre[at, 0]
                    y += centre[at, 1]
                    z += centre[at, 2]
            x, y, z = x / n, y / n, z / n
            xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(m):
                at = near[c, j]
                if at < k:
                    dx, dy, dz = centre[at, 0] - x, centre[at, 1] - y, centre[at, 2] - z
                    xx += dx * dx
                    xy += dx * dy
                    xz += dx * dz
                    yy += dy * dy
                    yz += dy * dz
                    zz += dz * dz
            if n < 4:
                normal[c, 0], normal[c, 1], normal[c, 2] = 0.0, 0.0, 1.0
                variance[c] = zz / max(n - 1, 1)
                continue
            least, nx, ny, nz = _smallest(xx, xy, xz, yy, yz, zz)
            sign = -1.0 if nz < 0.0 else 1.0
            normal[c, 0], normal[c, 1], normal[c, 2] = sign * nx, sign * ny, sign * nz
            variance[c] = max(least, 0.0) / (n - 3)
    return normal, variance


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _smallest(
    xx: float, xy: float, xz: float, yy: float, yz: float, zz: float
) -> tuple[float, float, float, float]:
    """Smallest eigenvalue of a symmetric matrix and its unit eigenvector (closed form, Smith 1961)."""
    mean = (xx + yy + zz) / 3.0
    off = xy * xy + xz * xz + yz * yz
    a, b, c = xx - mean, yy - mean, zz - mean
    size = np.sqrt((a * a + b * b + c * c + 2.0 * off) / 6.0)
    if size <= 1e-15 * (abs(mean) + 1e-300):
        return mean, 0.0, 0.0, 1.0
    det = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    angle = np.arccos(min(1.0, max(-1.0, det / (2.0 * size**3)))) / 3.0
    least = mean + 2.0 * size * np.cos(angle + 2.0 * np.pi / 3.0)
    # rows of M - least I span the plane across the eigenvector: the longest of their products is the best one
    a, b, c = xx - least, yy - least, zz - least
    x1, y1, z1 = xy * yz - xz * b, xz * xy - a * yz, a * b - xy * xy
    x2, y2, z2 = xy * c - xz * yz, xz * xz - a * c, a * yz - xy * xz
    x3, y3, z3 = b * c - yz * yz, yz * xz - xy * c, xy * yz - b * xz
    s1, s2, s3 = x1 * x1 + y1 * y1 + z1 * z1, x2 * x2 + y2 * y2 + z2 * z2, x3 * x3 + y3 * y3 + z3 * z3
    if s2 >= s1 and s2 >= s3:
        x1, y1, z1, s1 = x2, y2, z2, s2
    elif s3 >= s1:
        x1, y1, z1, s1 = x3, y3, z3, s3
    if s1 <= 0.0:
        return least, 0.0, 0.0, 1.0
    length = np.sqrt(s1)
    return least, x1 / length, y1 / length, z1 / length


@nb.njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def deviations(points: ArrayF, start: ArrayI, normal: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Median (k,) of the points of each cell along its normal, and median (k,) of the distances from it."""
    k = len(start) - 1
    middle, spread = np.empty(k), np.empty(k)
    for b in nb.prange((k + _BLOCK - 1) // _BLOCK):
        for c in range(b * _BLOCK, min((b + 1) * _BLOCK, k)):
            along = np.empty(start[c + 1] - start[c])
            for i in range(len(along)):
                p = start[c] + i
                along[i] = (
                    points[p, 0] * normal[c, 0] + points[p, 1] * normal[c, 1] + points[p, 2] * normal[c, 2]
                )
            middle[c] = np.median(along)
            spread[c] = np.median(np.abs(along - middle[c]))
    return middle, spread


@nb.njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def trimmed_means(
    points: ArrayF, start: ArrayI, normal: ArrayF, middle: ArrayF, limit: ArrayF
) -> tuple[ArrayF, ArrayI, ArrayF]:
    """Means (k, 3) of the points no farther than ``limit`` from the middle of their cell along its normal.

    Returns
    -------
    mean : (k, 3).
    n : (k,) points that took part, at least 1.
    squares : (k,) their squared distances from the mean along the normal, summed.
    """
    k = len(start) - 1
    mean, n, squares = np.zeros((k, 3)), np.zeros(k, dtype=np.int64), np.zeros(k)
    for b in nb.prange((k + _BLOCK - 1) // _BLOCK):
        for c in range(b * _BLOCK, min((b + 1) * _BLOCK, k)):
            total, square = 0.0, 0.0
            for p in range(start[c], start[c + 1]):
                d = -middle[c]
                for axis in range(3):
                    d += points[p, axis] * normal[c, axis]
                if abs(d) <= limit[c]:
                    n[c] += 1
                    total += d
                    square += d * d
                    for axis in range(3):
                        mean[c, axis] += points[p, axis]
            if n[c] == 0:  # two points, or pairs, whose median lies between them and far from both
                n[c] = start[c + 1] - start[c]
                for p in range(start[c], start[c + 1]):
                    d = -middle[c]
                    for axis in range(3):
                        d += points[p, axis] * normal[c, axis]
                    total += d
                    square += d * d
                    for axis in range(3):
                        mean[c, axis] += points[p, axis]
            for axis in range(3):
                mean[c, axis] /= n[c]
            squares[c] = max(square - total * total / n[c], 0.0)
    return mean, n, squares


@nb.njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def pooled(n: ArrayI, squares: ArrayF, near: ArrayI) -> tuple[ArrayF, ArrayI]:
    """Sums (k,) of squares, and their degrees of freedom (k,), over each cell and its neighbours."""
    k, m = near.shape
    total, freedom = np.zeros(k), np.zeros(k, dtype=np.int64)
    for c in nb.prange(k):
        for j in range(m):
            at = near[c, j]
            if at < k:
                total[c] += squares[at]
                freedom[c] += n[at] - 1
    return total, freedom


@nb.njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def pooled_spread(n: ArrayI, spread: ArrayF, near: ArrayI) -> ArrayF:
    """Median (k,) of the spreads of a cell and its neighbours with three points; infinite without any."""
    k, m = near.shape
    out = np.full(k, np.inf)
    for b in nb.prange((k + _BLOCK - 1) // _BLOCK):
        some = np.empty(m)
        for c in range(b * _BLOCK, min((b + 1) * _BLOCK, k)):
            i = 0
            for j in range(m):
                at = near[c, j]
                if at < k and n[at] >= 3:
                    some[i] = spread[at]
                    i += 1
            if i > 0:
                out[c] = np.median(some[:i])
    return out


@nb.njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def medians_about(value: ArrayF, near: ArrayI) -> ArrayF:
    """Median (k,) of the values (k,) at the neighbours (k, m) of each."""
    k, m = near.shape
    out = np.empty(k)
    for b in nb.prange((k + _BLOCK - 1) // _BLOCK):
        some = np.empty(m)
        for c in range(b * _BLOCK, min((b + 1) * _BLOCK, k)):
            for j in range(m):
                some[j] = value[near[c, j]]
            out[c] = np.median(some)
    return out
