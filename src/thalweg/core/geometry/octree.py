"""Levels of detail: an octree whose nodes hold points of their own, coarse ones first.

A node is a cube and holds one point for each of its cells, 64 along an edge; the points that are left go to
its eight children, whose cells are half as wide. Drawing a node and some of its descendants therefore adds
points and repeats none. Points are sorted along a Z-order curve (Morton 1966), on which nodes and cells of
every level are runs of neighbours, so that each level costs one pass.
"""

from dataclasses import dataclass
from typing import Final, Protocol, TypeAlias

import numpy as np

from thalweg.core import ArrayF, ArrayI, CoverageError

CELLS_BITS: Final = 6
"""A node has 2^6 = 64 cells along an edge."""
LEAF_POINTS: Final = 6000
"""A node takes all points that are left in it if they are so few: small files cost more than they hold."""
_BITS: Final = 21
"""Bits of a coordinate in the code of a point: three of them fit 64."""


_AT_ONCE: Final = 1_000_000
"""Points whose coordinates are in memory at a time."""


Codes: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.uint64]]


class Places(Protocol):
    """Points (n, 3), m, of which slices of rows are asked for: an array, or a file that is read by and by."""

    def __len__(self) -> int: ...
    def __getitem__(self, rows: slice, /) -> ArrayF: ...


@dataclass(frozen=True, slots=True)
class Node:
    """A cube of the tree.

    Parameters
    ----------
    key : a digit for each level below the root, the child: 1 for the upper half in x + 2 in y + 4 in z.
    corner_m, size_m : (3,) lower corner and edge.
    rows : (n,) its points, rows of the cloud.
    spacing_m : distance of neighbours: a cell's edge, less where a node took more points than one a cell.
    """

    key: str
    corner_m: ArrayF
    size_m: float
    rows: ArrayI
    spacing_m: float


def build_octree(xyz_m: Places, most_points: int | None = None) -> list[Node]:
    """Sort points into an octree, thinned evenly to so many at most, if a number is given.

    It takes some 40 bytes a point beside the points themselves.

    Parameters
    ----------
    xyz_m : (n, 3) points, m; asked for twice, by slices.
    most_points : of more points one in each of the finest cells that are few enough, and some more; of
        points at one place one. None: each point.

    Returns
    -------
    nodes : the root first, parents before children; no point stands in two of them.

    Raises
    ------
    CoverageError : there are no points.
    """
    if not len(xyz_m):
        raise CoverageError("a cloud of no points", expected="points to show", cure="Look at its filters")
    slices = [slice(k, k + _AT_ONCE) for k in range(0, len(xyz_m), _AT_ONCE)]
    ends = np.array([[part.min(axis=0), part.max(axis=0)] for part in map(xyz_m.__getitem__, slices)])
    low = ends[:, 0].min(axis=0)
    size = float(max((ends[:, 1].max(axis=0) - low).max(), 0.01))
    code = np.empty(len(xyz_m), dtype=np.uint64)
    for piece in slices:
        # the last point lies on the border of the last cell, and in it
        cell = np.minimum((xyz_m[piece] - low) * (2**_BITS / size), 2**_BITS - 1)
        code[piece] = _morton(cell.astype(np.uint64))
    order = np.argsort(code, kind="stable")
    code = code[order]
    if most_points is not None:
        kept = _thinned(code, most_points)
        code, order = code[kept], order[kept]
    nodes: list[Node] = []
    last = _BITS - CELLS_BITS
    for level in range(last + 1):
        if not len(code):
            break
        of_node = code >> np.uint64(3 * (_BITS - level))
        first = np.flatnonzero(np.diff(of_node, prepend=of_node[0] + np.uint64(1)))
        count = np.diff(first, append=len(code))
        own = np.zeros(len(code), dtype=np.bool_)
        own[_middles(code >> np.uint64(3 * (_BITS - level - CELLS_BITS)))] = True
        cells = np.add.reduceat(own, first, dtype=np.int64)
        # what the finest cells do not tell apart stays together
        own |= np.repeat((count <= LEAF_POINTS) | (level == last), count)
        for start, n, occupied in zip(first, count, cells, strict=True):
            key = "".join(str(int(of_node[start]) >> 3 * k & 7) for k in reversed(range(level)))
            rows = order[start : start + n][own[start : start + n]]
            nodes.append(_node(key, low, size, rows, int(occupied)))
        code, order = code[~own], order[~own]
    return nodes


def _node(key: str, low: ArrayF, size: float, rows: ArrayI, occupied: int) -> Node:
    """A node by its key within the root's cube, and the number of its cells that hold points."""
    corner = low.astype(np.float64).copy()
    for digit in key:
        size /= 2
        corner += size * (int(digit) >> np.arange(3) & 1)
    # as on a surface: four times the points lie half as far apart
    spacing = size / 2**CELLS_BITS * float(np.sqrt(occupied / len(rows)))
    return Node(key=key, corner_m=corner, size_m=size, rows=rows, spacing_m=spacing)


def _morton(cell: Codes) -> Codes:
    """Codes (n,) of cells (n, 3): the bits of x, y, z by turns, those of z highest."""
    code = np.zeros(len(cell), dtype=np.uint64)
    for axis in range(3):
        x = cell[:, axis].copy()
        for shift, mask in (
            (32, 0x1F00000000FFFF),
            (16, 0x1F0000FF0000FF),
            (8, 0x100F00F00F00F00F),
            (4, 0x10C30C30C30C30C3),
            (2, 0x1249249249249249),
        ):
            x = (x | x << np.uint64(shift)) & np.uint64(mask)
        code |= x << np.uint64(axis)
    return code


def _middles(cell: Codes) -> ArrayI:
    """The middle of each run of equal cells: the first ones, all in one corner, would show as a pattern."""
    first = np.flatnonzero(np.diff(cell, prepend=cell[0] + np.uint64(1)))
    return first + np.diff(first, append=len(cell)) // 2


def _thinned(code: Codes, most: int) -> ArrayI:
    """Points to keep, in order: one for each of the finest cells that are few enough, others by turns."""
    # two points in one of the finest cells, a 2-millionth of the cloud, cannot be told apart on a screen
    kept = _middles(code)
    if len(kept) <= most:
        return kept
    level = 1
    while len(cells := _middles(code >> np.uint64(3 * level))) > most:
        level += 1
    other = np.ones(len(code), dtype=np.bool_)
    other[cells] = False
    rest = np.flatnonzero(other)
    more = rest[np.linspace(0, len(rest) - 1, min(most - len(cells), len(rest))).astype(np.int64)]
    return np.union1d(cells, more)
