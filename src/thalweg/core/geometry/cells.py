"""Cells of equal width on a plane or in space: which one a point lies in, as one integer."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from thalweg.core import ArrayB, ArrayF, ArrayI, GeometryError

_MOST_CELLS = 2**62


@dataclass(frozen=True, slots=True)
class CellGrid:
    """Squares (k = 2) or cubes (k = 3) that begin at a corner.

    ``low_m`` (k,) is the corner of the first cell, ``size`` (k,) the number of cells in each direction,
    ``width_m`` the edge of a cell.
    """

    low_m: ArrayF
    size: ArrayI
    width_m: float

    @classmethod
    def around(cls, points_m: ArrayF, width_m: float) -> Self:
        """The grid that holds all points (n, k) and begins at their lowest coordinates.

        Raises
        ------
        GeometryError : no points, coordinates that are not finite, or more cells than an integer can number.
        """
        if not len(points_m) or not np.isfinite(points_m).all():
            raise GeometryError(
                f"{len(points_m)} points to be put into cells, {int((~np.isfinite(points_m)).sum())} of "
                "their coordinates not finite",
                expected="at least one point, and finite coordinates",
            )
        low = points_m.min(axis=0)
        size = np.floor((points_m.max(axis=0) - low) / width_m) + 1
        if np.prod(size) > _MOST_CELLS:
            raise GeometryError(
                f"points over {np.ptp(points_m, axis=0).max():.3g} m in cells of {width_m:g} m",
                expected="an extent that fits the width of the cells",
                cure="Check the coordinates for points that are far from all others",
            )
        return cls(low, size.astype(np.int64), width_m)

    def contains(self, points_m: ArrayF) -> ArrayB:
        """Whether each point (n, k) lies in the grid."""
        place = self._place(points_m)
        return np.asarray(((place >= 0) & (place < self.size)).all(axis=1))

    def keys(self, points_m: ArrayF) -> ArrayI:
        """The number (n,) of each point's cell: equal for points of one cell, from 0 to all cells - 1.

        Points must lie in the grid; those outside get numbers that mean nothing.
        """
        place = self._place(points_m)
        key = place[:, 0]
        for axis in range(1, len(self.size)):
            key = key * self.size[axis] + place[:, axis]
        return np.asarray(key)

    def _place(self, points_m: ArrayF) -> ArrayI:
        return np.floor((points_m - self.low_m) / self.width_m).astype(np.int64)


def cell_numbers(points_m: ArrayF, width_m: float) -> ArrayI:
    """Number the cells that hold points from 0 without gaps: the cell (n,) of each point (n, k).

    Cells begin at the lowest coordinates of the points.

    Raises
    ------
    GeometryError : see `CellGrid.around`.

    Examples
    --------
    >>> cell_numbers(np.array([[0.0, 0.0], [7.2, 3.1], [0.9, 0.5]]), 1.0).tolist()
    [0, 1, 0]
    """
    keys = CellGrid.around(points_m, width_m).keys(points_m)
    return np.asarray(np.unique(keys, return_inverse=True)[1], dtype=np.int64)
