"""A dense cloud -> one point a cell, robust against grass, with the standard deviation of that point.

A cell's point is the mean of those of its points that lie near their median along the local normal. A mean of
all would follow blades of grass outward, a median alone wastes a third of the points; on an inclined
surface a median of one coordinate does not even lie on it, while the mean of points of a plane does.

The standard deviation along the normal comes from the scatter within the cell and its neighbours, pooled,
over the root of the number of points: a cell of one point has the scatter of its neighbourhood, not zero.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from thalweg.core import NMAD, ArrayB, ArrayF, ArrayI, GeometryError, njit, prange

NEIGHBOURS: Final = 16
"""A cell and those about it, from which its plane and scatter are estimated."""
TRIM: Final = 3.5
"""Points of a cell farther from its median than so many standard deviations (from the MAD) stay out."""
SPIKE: Final = 0.75
"""A point higher above the median of its neighbours than so many times the radius about them is a spike.

A ridge of two planes stands 0.4 times the radius and its slope above the median of its surroundings: it
stays up to a slope of 62 degrees on either side.
"""
_SMALL_SAMPLE: Final = np.array([1.0, 1.0, 1.196, 1.495, 1.363, 1.206, 1.200, 1.140, 1.129, 1.107])
"""Factor that makes the MAD of 0 to 9 values unbiased; above ``n / (n - 0.8)`` (Croux and Rousseeuw 1992)."""
_LEAST_FREEDOM: Final = 12
"""With fewer degrees of freedom within the cells, the scatter of their points about a plane helps out."""
_LEAST_SIGMA: Final = (1e-4, 1e-2)
"""Metres and share of a cell: no surface is known better than the smaller one; clouds are stored in steps."""
_BLOCK = 4096

LEVELS_M: Final = (4.0, 2.0, 1.0, 0.5)
"""Widths of the cells, metres: from crowns of trees to boulders."""
QUANTILE: Final = 0.1
"""Share of a cell's area that may lie below the envelope."""
RASTER_M: Final = 0.1
"""Width of the raster of lowest points: at least 25 in a cell of the finest level."""
SLOPE: Final = 1.0
"""Steepest ground against the plane of the bank: a wall and a meadow behind it are at 45 degrees each."""
MOST_CELLS: Final = 50_000_000


# ---------------------------------------------------------------- thinning


@dataclass(frozen=True, slots=True, kw_only=True)
class Thinned:
    """One point for each cell that holds any.

    Parameters
    ----------
    points : (k, 3) in the frame of the input.
    normals : (k, 3) of the surface about them; third component not negative.
    sigma_m : (k,) standard deviation of each point along its normal.
    n_merged : (k,) points that it is the mean of.
    n_trimmed : points that lay too far from the median of their cell.
    """

    points: ArrayF
    normals: ArrayF
    sigma_m: ArrayF
    n_merged: ArrayI
    n_trimmed: int


def thin(points_m: ArrayF, cell_m: float, *, cubes: bool) -> Thinned:
    """One robust point a cell.

    Parameters
    ----------
    points_m : (n, 3), at least one.
    cell_m : width of the cells.
    cubes : cells are cubes; otherwise they are columns along the third axis.

    Raises
    ------
    GeometryError : so many cells in a row that they cannot be numbered.
    """
    order, start = _cells(points_m, cell_m, cubes)
    p = np.ascontiguousarray(points_m[order])
    n = np.diff(start)
    centre = medians(p, start)
    near = _neighbours(centre)
    normal, variance = local_planes(centre, near)
    middle, spread = deviations(p, start, normal)
    factor = np.where(n < len(_SMALL_SAMPLE), _SMALL_SAMPLE[np.minimum(n, 9)], n / (n - 0.8))
    limit = TRIM * NMAD * pooled_spread(n, spread * factor, near)
    least_m = min(_LEAST_SIGMA[0], _LEAST_SIGMA[1] * cell_m)
    mean, n_in, squares = trimmed_means(p, start, normal, middle, np.maximum(limit, least_m))
    sigma = np.sqrt(_scatter(n_in, squares, near, variance) / n_in)
    return Thinned(
        points=mean,
        normals=normal,
        sigma_m=np.maximum(sigma, least_m),
        n_merged=n_in,
        n_trimmed=int(n.sum() - n_in.sum()),
    )


def spikes(points_bank_m: ArrayF) -> ArrayB:
    """Points (n,) of a thinned cloud that stand alone in front of those about them: stalks and blades.

    Parameters
    ----------
    points_bank_m : (n, 3), one point a column of the bank's plane.

    Notes
    -----
    A stone holds several cells side by side, a blade of grass seldom more than one. Plants lower than the
    clearance are found in no other way.
    """
    if len(points_bank_m) < NEIGHBOURS:
        return np.zeros(len(points_bank_m), dtype=np.bool_)
    plane = points_bank_m[:, :2]
    distance, near = cKDTree(plane).query(plane, k=NEIGHBOURS, workers=-1)
    height = np.ascontiguousarray(points_bank_m[:, 2])
    about = medians_about(height, np.asarray(near, dtype=np.int64))
    return np.asarray(height - about > SPIKE * np.asarray(distance)[:, -1])


def _scatter(n: ArrayI, squares: ArrayF, near: ArrayI, variance: ArrayF) -> ArrayF:
    """Variance (k,) of single points along the normal.

    Where the cells about a place hold too few points to tell, the distances of their means from a common
    plane take part: a mean of n points scatters by the n-th part. On curved ground that is an upper bound.
    """
    total, freedom = pooled(n, squares, near)
    n_plane = max(near.shape[1] - 3, 1)
    poor = freedom < _LEAST_FREEDOM
    total[poor] += (variance * n_plane * n[near].mean(axis=1))[poor]
    return np.asarray(total / (freedom + poor * n_plane))


def _cells(p: ArrayF, cell_m: float, cubes: bool) -> tuple[ArrayI, ArrayI]:
    """Order (n,) of the points by cell, and the first point (k + 1,) of each cell in that order."""
    axes = 3 if cubes else 2
    index = np.floor((p[:, :axes] - p[:, :axes].min(axis=0)) / cell_m).astype(np.int64)
    width = index.max(axis=0) + 1
    if np.prod(width.astype(np.float64)) > 2.0**62:
        raise GeometryError(f"{width.tolist()} cells of {cell_m} m", expected="fewer than 2^62 in all")
    key = index[:, 0]
    for axis in range(1, axes):
        key = key * width[axis] + index[:, axis]
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    return order, np.append(first, len(p)).astype(np.int64)


def _neighbours(centre: ArrayF) -> ArrayI:
    """The nearest cells (k, m) of each, itself among them."""
    near = cKDTree(centre).query(centre, k=min(NEIGHBOURS, len(centre)), workers=-1)[1]
    return np.asarray(near, dtype=np.int64).reshape(len(centre), -1)


# ---------------------------------------------------------------- kernels: points sorted by cell -> one
# robust point a cell


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def medians(points: ArrayF, start: ArrayI) -> ArrayF:
    """Median (k, 3) of each coordinate in each cell.

    Parameters
    ----------
    points : (n, 3) sorted by cell.
    start : (k + 1,) first point of each cell, and n.
    """
    k = len(start) - 1
    out = np.empty((k, 3))
    for b in prange((k + _BLOCK - 1) // _BLOCK):
        for c in range(b * _BLOCK, min((b + 1) * _BLOCK, k)):
            for axis in range(3):
                out[c, axis] = np.median(points[start[c] : start[c + 1], axis])
    return out


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def local_planes(centre: ArrayF, near: ArrayI) -> tuple[ArrayF, ArrayF]:
    """Unit normals (k, 3), third component not negative, and residual variance (k,) of planes.

    Parameters
    ----------
    centre : (k, 3).
    near : (k, m) neighbours of each, itself among them; k stands for a missing one.
    """
    k, m = near.shape
    normal, variance = np.empty((k, 3)), np.empty(k)
    for b in prange((k + _BLOCK - 1) // _BLOCK):
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


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def deviations(points: ArrayF, start: ArrayI, normal: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Median (k,) of the points of each cell along its normal, and median (k,) of the distances from it."""
    k = len(start) - 1
    middle, spread = np.empty(k), np.empty(k)
    for b in prange((k + _BLOCK - 1) // _BLOCK):
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


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
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
    for b in prange((k + _BLOCK - 1) // _BLOCK):
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


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def pooled(n: ArrayI, squares: ArrayF, near: ArrayI) -> tuple[ArrayF, ArrayI]:
    """Sums (k,) of squares, and their degrees of freedom (k,), over each cell and its neighbours."""
    k, m = near.shape
    total, freedom = np.zeros(k), np.zeros(k, dtype=np.int64)
    for c in prange(k):
        for j in range(m):
            at = near[c, j]
            if at < k:
                total[c] += squares[at]
                freedom[c] += n[at] - 1
    return total, freedom


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def pooled_spread(n: ArrayI, spread: ArrayF, near: ArrayI) -> ArrayF:
    """Median (k,) of the spreads of a cell and its neighbours with three points; infinite without any."""
    k, m = near.shape
    out = np.full(k, np.inf)
    for b in prange((k + _BLOCK - 1) // _BLOCK):
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


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def medians_about(value: ArrayF, near: ArrayI) -> ArrayF:
    """Median (k,) of the values (k,) at the neighbours (k, m) of each."""
    k, m = near.shape
    out = np.empty(k)
    for b in prange((k + _BLOCK - 1) // _BLOCK):
        some = np.empty(m)
        for c in range(b * _BLOCK, min((b + 1) * _BLOCK, k)):
            for j in range(m):
                some[j] = value[near[c, j]]
            out[c] = np.median(some)
    return out


# ---------------------------------------------------------------- lower envelope of a cloud, from coarse to
# fine
#
# In the frame of the bank, "low" is into the bank. The cloud becomes a raster of its lowest points first,
# so that each piece of the bank has the same say, whether ten points or ten thousand lie on it. Then the
# envelope is refined: each level adds what the low quantile of the remaining heights is in its cells,
# interpolated bilinearly, and takes part only what can still be ground, given the level before.
#
# A quantile, not the lowest: points behind the surface (multipath, mirror images) must not pull the envelope
# down. A dense patch of them of more than a tenth of a coarsest cell (1.6 m2) still does: cut mirror images
# under water off by a lowest height.
#
# The finest cells are smaller than a boulder, so a boulder lifts the envelope and stays; a bush does not,
# because ground is seen through it or beside it.
#
# Related: progressive morphological filters (Zhang et al. 2003), hierarchic robust interpolation (Kraus and
# Pfeifer 1998). Tested on the digital twin in ``tests/accuracy``.


def heights_above_envelope(points_bank_m: ArrayF, *, clearance_m: float) -> ArrayF:
    """Heights (n,) of points above the lower envelope of all of them, metres along `out`.

    Parameters
    ----------
    points_bank_m : (n, 3) along, up the slope, out.
    clearance_m : what is taken as ground on the way from one level to the next: points below
        ``clearance_m + SLOPE * cell / 2``. That far a ridge of that slope stands out of the plane through
        the middles of the cells beside it. What lies twice as far behind is no ground either; a crown that
        fills a coarse cell lifts the envelope so far at most.

    Raises
    ------
    GeometryError : the cloud is so wide that its raster would not fit into memory.
    """
    low_m, high_m = points_bank_m[:, :2].min(axis=0), points_bank_m[:, :2].max(axis=0)
    envelope = LowerEnvelope(low_m, high_m, clearance_m=clearance_m)
    envelope.add(points_bank_m)
    return envelope.heights_above(points_bank_m)


class LowerEnvelope:
    """Lower envelope of points that come in pieces: it holds the lowest of each cell of the raster alone.

    Parameters
    ----------
    low_m, high_m : (2,) extremes of all points in the plane.
    clearance_m : as of `heights_above_envelope`.

    Raises
    ------
    GeometryError : as of `heights_above_envelope`.
    """

    def __init__(self, low_m: ArrayF, high_m: ArrayF, *, clearance_m: float) -> None:
        self._low, self._extent, self._clearance = low_m, high_m - low_m, clearance_m
        if np.prod(self._extent / LEVELS_M[-1] + 2) > MOST_CELLS:
            raise GeometryError(
                f"a reference of {self._extent[0]:.0f} m by {self._extent[1]:.0f} m",
                expected=f"at most {MOST_CELLS * LEVELS_M[-1] ** 2 / 1e6:.0f} km2 in the plane of the bank",
                cure="Take a smaller accuracy.area, or look for stray points far away",
            )
        self._lowest = np.empty((0, 3))
        self._levels: list[ArrayF] = []

    def add(self, points_m: ArrayF) -> None:
        """Take in points (n, 3)."""
        plane = np.concatenate([self._lowest[:, :2], points_m[:, :2] - self._low])
        height = np.concatenate([self._lowest[:, 2], points_m[:, 2]])
        lowest = _lowest_of_cells(plane, height)
        self._lowest = np.column_stack([plane[lowest], height[lowest]])
        self._levels = []

    def heights_above(self, points_m: ArrayF) -> ArrayF:
        """Heights (n,) of points (n, 3) above the envelope of all that were added."""
        if not self._levels:
            self._find_levels()
        plane, height = points_m[:, :2] - self._low, np.array(points_m[:, 2])
        for size, grid in zip(LEVELS_M, self._levels, strict=True):
            height -= _interpolated(grid, plane / size)
        return height

    def _find_levels(self) -> None:
        """From coarse to fine, each level what is left of the ground above those before it."""
        plane, left = self._lowest[:, :2], self._lowest[:, 2].copy()
        ground = np.ones(len(left), dtype=np.bool_)
        for level, size in enumerate(LEVELS_M):
            grid = _quantiles(plane[ground], left[ground], size, self._extent)
            # a cell without ground keeps what the coarser level says
            grid = _cone_envelope(_filled(grid), SLOPE * size) if level == 0 else np.nan_to_num(grid, nan=0.0)
            left -= _interpolated(grid, plane / size)
            ground = (left < self._clearance + SLOPE * size / 2) & (
                left > -2 * self._clearance - SLOPE * size
            )
            self._levels.append(grid)


def _lowest_of_cells(plane: ArrayF, height: ArrayF) -> ArrayI:
    """Index of the lowest point of each cell of the raster."""
    cell = np.floor(plane / RASTER_M).astype(np.int64)
    key = cell[:, 0] * (cell[:, 1].max() + 1) + cell[:, 1]
    order = np.lexsort((height, key))
    first = np.ones(len(order), dtype=np.bool_)
    first[1:] = np.diff(key[order]) != 0
    return np.asarray(order[first])


def _quantiles(plane: ArrayF, height: ArrayF, size: float, extent: ArrayF) -> ArrayF:
    """Low quantile of the heights in each cell (i, j); NaN where there are none."""
    shape = tuple(np.floor(extent / size).astype(np.int64) + 1)
    cell = np.floor(plane / size).astype(np.int64)
    key = cell[:, 0] * shape[1] + cell[:, 1]
    order = np.lexsort((height, key))
    count = np.bincount(key, minlength=shape[0] * shape[1])
    there = np.flatnonzero(count)
    start = (np.cumsum(count) - count)[there]
    grid = np.full(shape[0] * shape[1], np.nan)
    grid[there] = height[order[start + np.floor(QUANTILE * (count[there] - 1)).astype(np.int64)]]
    return np.asarray(grid.reshape(shape))


def _filled(grid: ArrayF) -> ArrayF:
    """Empty cells take the value of the nearest cell that has one."""
    nearest = ndimage.distance_transform_edt(np.isnan(grid), return_distances=False, return_indices=True)
    return np.asarray(grid[tuple(nearest)])


def _cone_envelope(grid: ArrayF, rise_m: float) -> ArrayF:
    """The largest surface below a grid that rises no more than ``rise_m`` a cell in any direction.

    A crown that fills a whole cell would lift the ground to its own height; its neighbours know better.
    """
    out = grid.copy()
    for _ in range(sum(grid.shape)):
        before = out.copy()
        around = np.pad(before, 1, mode="edge")
        for i in range(3):
            for j in range(3):
                shifted = around[i : i + grid.shape[0], j : j + grid.shape[1]]
                np.minimum(out, shifted + rise_m * np.hypot(i - 1, j - 1), out=out)
        if np.array_equal(out, before):
            break
    return out


def _interpolated(grid: ArrayF, place: ArrayF) -> ArrayF:
    """Bilinear values at places in units of cells; beyond the outermost middles the slope goes on."""
    wide = np.pad(grid, 1, mode="reflect", reflect_type="odd")
    return np.asarray(ndimage.map_coordinates(wide, (place + 0.5).T, order=1, mode="nearest"))
