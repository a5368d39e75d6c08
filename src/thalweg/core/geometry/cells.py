"""Cells of equal width (which one a point lies in, as one integer), and plane polygons (area, crossing
edges).
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
import shapely
from numpy.typing import ArrayLike

from thalweg.core import ArrayB, ArrayF, ArrayI, GeometryError

# ---------------------------------------------------------------- plane polygons

LEAST_AREA_M2: Final = 1e-6
"""A smaller polygon is a line."""


def polygon_area_m2(polygon: ArrayLike) -> float:
    """Area of a polygon with corners (k, 2), by the shoelace formula; parts of the other sense are negative.

    Examples
    --------
    >>> polygon_area_m2([[0, 0], [4, 0], [4, 3]])
    6.0
    """
    east, north = _about_middle(polygon).T
    return float(abs(np.sum(east * np.roll(north, -1) - np.roll(east, -1) * north)) / 2)


def first_crossing(polygon: ArrayLike) -> tuple[int, int] | None:
    """Numbers from 0 of the first two edges that cross; edges that only touch do not count.

    Parameters
    ----------
    polygon : (k, 2) corners; edge i goes from corner i to the next one.

    Examples
    --------
    >>> first_crossing([[0, 0], [4, 4], [4, 0], [0, 4]])
    (0, 2)
    """
    a = _about_middle(polygon)
    edges = shapely.linestrings(np.stack([a, np.roll(a, -1, axis=0)], axis=1))
    pairs = shapely.STRtree(edges).query(edges, predicate="crosses").T.tolist()
    one, other = min(((i, j) for i, j in pairs if i < j), default=(-1, -1))
    return (one, other) if one >= 0 else None


def crossing_in_words(polygon: ArrayLike, edges: tuple[int, int]) -> str:
    """The two edges by the numbers of their corners, from 1, and their coordinates."""
    p = np.asarray(polygon, dtype=np.float64)
    told = []
    for i in edges:
        j = (i + 1) % len(p)
        told.append(f"{i + 1} to {j + 1} ({p[i, 0]:.2f}, {p[i, 1]:.2f} to {p[j, 0]:.2f}, {p[j, 1]:.2f})")
    return f"the edges from corner {told[0]} and from corner {told[1]} cross"


def _about_middle(polygon: ArrayLike) -> ArrayF:
    """Corners about their middle: at map coordinates products of 1e12 m2 would hide a crossing."""
    p = np.asarray(polygon, dtype=np.float64)
    return np.asarray(p - p.mean(axis=0))


# ---------------------------------------------------------------- cells

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
