"""Plane polygons: area, and edges that cross."""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import ArrayF

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
    b, k = np.roll(a, -1, axis=0), len(a)
    for i in range(k - 2):
        others = slice(i + 2, k - 1 if i == 0 else k)
        c, d = a[others], b[others]
        c_side, d_side = _side(a[i], b[i], c), _side(a[i], b[i], d)
        a_side, b_side = _side(c, d, a[i]), _side(c, d, b[i])
        crosses = np.flatnonzero((c_side * d_side < 0) & (a_side * b_side < 0))
        if len(crosses):
            return i, int(i + 2 + crosses[0])
    return None


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


def _side(a: ArrayF, b: ArrayF, p: ArrayF) -> ArrayF:
    """Positive where p lies to the left of the line from a to b."""
    along, way = b - a, p - a
    return np.asarray(along[..., 0] * way[..., 1] - along[..., 1] * way[..., 0])
