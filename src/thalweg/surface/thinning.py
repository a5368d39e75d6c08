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
from scipy.spatial import cKDTree

from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.surface.thinning_kernels import (
    deviations,
    local_planes,
    medians,
    medians_about,
    pooled,
    pooled_spread,
    trimmed_means,
)

NEIGHBOURS: Final = 16
"""A cell and those about it, from which its plane and scatter are estimated."""
TRIM: Final = 3.5
"""Points of a cell farther from its median than so many standard deviations (from the MAD) stay out."""
SPIKE: Final = 0.75
"""A point higher above the median of its neighbours than so many times the radius about them is a spike.

A ridge of two planes stands 0.4 times the radius and its slope above the median of its surroundings: it
stays up to a slope of 62 degrees on either side.
"""
_MAD_TO_SIGMA: Final = 1.4826
_SMALL_SAMPLE: Final = np.array([1.0, 1.0, 1.196, 1.495, 1.363, 1.206, 1.200, 1.140, 1.129, 1.107])
"""Factor that makes the MAD of 0 to 9 values unbiased; above ``n / (n - 0.8)`` (Croux and Rousseeuw 1992)."""
_LEAST_FREEDOM: Final = 12
"""With fewer degrees of freedom within the cells, the scatter of their points about a plane helps out."""
_LEAST_SIGMA_M: Final = 1e-4
"""No surface is known better: clouds are stored in steps of a millimetre or less."""


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
    limit = TRIM * _MAD_TO_SIGMA * pooled_spread(n, spread * factor, near)
    mean, n_in, squares = trimmed_means(p, start, normal, middle, np.maximum(limit, _LEAST_SIGMA_M))
    sigma = np.sqrt(_scatter(n_in, squares, near, variance) / n_in)
    return Thinned(
        points=mean,
        normals=normal,
        sigma_m=np.maximum(sigma, _LEAST_SIGMA_M),
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
