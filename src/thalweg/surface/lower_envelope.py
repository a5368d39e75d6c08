"""How far points stand in front of the ground: a lower envelope of a cloud, from coarse to fine.

In the frame of the bank, "low" is into the bank. The cloud becomes a raster of its lowest points first, so
that each piece of the bank has the same say, whether ten points or ten thousand lie on it. Then the envelope
is refined: each level adds what the low quantile of the remaining heights is in its cells, interpolated
bilinearly, and takes part only what can still be ground, given the level before.

A quantile, not the lowest: points behind the surface (multipath, mirror images) must not pull the envelope
down. A dense patch of them of more than a tenth of a coarsest cell (1.6 m2) still does: cut mirror images
under water off by a lowest height.

The finest cells are smaller than a boulder, so a boulder lifts the envelope and stays; a bush does not,
because ground is seen through it or beside it.

Related: progressive morphological filters (Zhang et al. 2003), hierarchic robust interpolation (Kraus and
Pfeifer 1998). Tested on the digital twin in ``tests/accuracy``.
"""

from typing import Final

import numpy as np
from scipy import ndimage

from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayF, ArrayI

LEVELS_M: Final = (4.0, 2.0, 1.0, 0.5)
"""Widths of the cells, metres: from crowns of trees to boulders."""
QUANTILE: Final = 0.1
"""Share of a cell's area that may lie below the envelope."""
RASTER_M: Final = 0.1
"""Width of the raster of lowest points: at least 25 in a cell of the finest level."""
SLOPE: Final = 1.0
"""Steepest ground against the plane of the bank: a wall and a meadow behind it are at 45 degrees each."""
MOST_CELLS: Final = 50_000_000


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
    plane = points_bank_m[:, :2] - points_bank_m[:, :2].min(axis=0)
    height = np.array(points_bank_m[:, 2])
    extent = plane.max(axis=0)
    if np.prod(extent / LEVELS_M[-1] + 2) > MOST_CELLS:
        raise GeometryError(
            f"a reference of {extent[0]:.0f} m by {extent[1]:.0f} m",
            expected=f"at most {MOST_CELLS * LEVELS_M[-1] ** 2 / 1e6:.0f} km2 in the plane of the bank",
            cure="Set accuracy.area, or look for stray points far away",
        )
    lowest = _lowest_of_cells(plane, height)
    ground = np.ones(len(lowest), dtype=np.bool_)
    for level, size in enumerate(LEVELS_M):
        grid = _quantiles(plane[lowest[ground]], height[lowest[ground]], size, extent)
        # a cell without ground keeps what the coarser level says
        grid = _cone_envelope(_filled(grid), SLOPE * size) if level == 0 else np.nan_to_num(grid, nan=0.0)
        height -= _interpolated(grid, plane / size)
        left = height[lowest]
        ground = (left < clearance_m + SLOPE * size / 2) & (left > -2 * clearance_m - SLOPE * size)
    return height


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
