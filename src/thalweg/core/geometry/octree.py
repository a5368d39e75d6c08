"""Levels of detail: an octree whose nodes hold points of their own, coarse ones first.

A node is a cube and holds one point for each of its cells, 64 along an edge; the points that are left go to
its eight children, whose cells are half as wide. Drawing a node and some of its descendants therefore adds
points and repeats none. Points are sorted along a Z-order curve (Morton 1966), on which nodes and cells of
every level are runs of neighbours, so that each level costs one pass.

A cloud that memory does not hold is cut into parts along this curve (`parts_of`): the largest cubes of the
tree with so many points at most. What a node takes in one of its cells depends on that cell alone, so that a
part is sorted without the others. Cells that are larger than a part, of coarse nodes, take one point each:
which one follows from counts. The tree is that of the whole cloud (`tests/lidar/test_copc.py`).
"""

from bisect import bisect, bisect_left, insort
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from thalweg.core import ArrayF, ArrayI, CoverageError

CELLS_BITS: Final = 6
"""A node has 2^6 = 64 cells along an edge."""
LEAF_POINTS: Final = 6000
"""A node takes all points that are left in it if they are so few: small files cost more than they hold."""
_BITS: Final = 21
"""Bits of a coordinate in the code of a point: three of them fit 64."""


_LAST: Final = _BITS - CELLS_BITS
"""The finest level: its nodes take all that is left."""
_AT_ONCE: Final = 1_000_000
"""Points whose codes are made at a time."""
_LEAST_PART: Final = 50_000
"""A cube with more points is no leaf: coarser nodes have taken 32^3 + 16^3 + ... = 37,449 of them at most."""
_DEEPER: Final = 6
"""Levels by which cubes that are too full are divided in one pass over the points."""
Codes: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.uint64]]


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


def build_octree(xyz_m: ArrayF, most_points: int | None = None) -> list[Node]:
    """Sort points into an octree, thinned evenly to so many at most, if a number is given.

    It takes some 40 bytes a point beside the points themselves.

    Parameters
    ----------
    xyz_m : (n, 3) points, m.
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
    low = xyz_m.min(axis=0)
    size = cube_size_m(low, xyz_m.max(axis=0))
    pieces = range(0, len(xyz_m), _AT_ONCE)
    code = np.concatenate([codes_of(xyz_m[k : k + _AT_ONCE], low, size) for k in pieces])
    order = np.argsort(code, kind="stable")
    code = code[order]
    if most_points is not None:
        kept = _thinned(code, most_points)
        code, order = code[kept], order[kept]
    return [
        _node(node_key(level, cube), low, size, order[places], occupied)
        for level, cube, places, occupied in grow(code)
    ]


def cube_size_m(low_m: ArrayF, high_m: ArrayF) -> float:
    """Edge of the root's cube, of which ``low_m`` is a corner."""
    return float(max((high_m - low_m).max(), 0.01))


def codes_of(xyz_m: ArrayF, low_m: ArrayF, size_m: float) -> Codes:
    """Places (n,) of points (n, 3) on the curve that fills the root's cube."""
    # the last point lies on the border of the last cell, and in it
    cell = np.minimum((xyz_m - low_m) * (2**_BITS / size_m), 2**_BITS - 1)
    return _morton(cell.astype(np.uint64))


def node_key(level: int, cube: int) -> str:
    """Key of a node by its place among all cubes of its level, in the order of the curve."""
    return "".join(str(cube >> 3 * k & 7) for k in reversed(range(level)))


@dataclass(frozen=True, slots=True)
class Part:
    """A cube of the tree whose points are in memory together.

    Parameters
    ----------
    level, cube : the node: of which level, and which in the order of the curve.
    begin, n : points before it on the curve, and in it.
    taken : of each coarse level the points, counted from the begin, that nodes take whose cells are larger
        than this cube.
    """

    level: int
    cube: int
    begin: int
    n: int
    taken: dict[int, list[int]]

    @property
    def first_code(self) -> int:
        """The first place of the cube on the curve."""
        return self.cube << 3 * (_BITS - self.level)

    def cube_at(self, level: int) -> int:
        """Cube of another level that its first place lies in."""
        return self.first_code >> 3 * (_BITS - level)


def parts_of(pieces: Callable[[], Iterable[Codes]], most_points: int) -> list[Part]:
    """Cut a cloud into the largest cubes of the tree with so many points at most, in the order of the curve.

    Memory is that of a piece, and of the counts of some thousand cubes. Only where one node of the finest
    level holds more points, a part does, too.

    Parameters
    ----------
    pieces : codes of all points, piece by piece; asked for once for each six levels that are needed.
    most_points : of a part, at least 50,000.
    """
    assert most_points >= _LEAST_PART, "whether a coarse node is a leaf would have to be counted"
    found: list[tuple[int, int, int, int]] = []
    level, full = 0, np.zeros(1, np.uint64)
    while len(full):
        finest = min(level + _DEEPER, _LAST)
        cubes, count = np.empty(0, np.uint64), np.empty(0, np.int64)
        for code in pieces():
            inside = code[np.isin(code >> np.uint64(3 * (_BITS - level)), full)]
            more, n_more = np.unique(inside >> np.uint64(3 * (_BITS - finest)), return_counts=True)
            cubes, at = np.unique(np.concatenate([cubes, more]), return_inverse=True)
            count = np.bincount(at, np.concatenate([count, n_more]), len(cubes)).astype(np.int64)
        for depth in range(level, finest + 1):
            at_depth, of_cube = np.unique(cubes >> np.uint64(3 * (finest - depth)), return_inverse=True)
            n = np.bincount(of_cube, count, len(at_depth)).astype(np.int64)
            fits = (n <= most_points) | (depth == _LAST)
            for cube, n_points in zip(at_depth[fits].tolist(), n[fits].tolist(), strict=True):
                found.append((cube << 3 * (_BITS - depth), depth, cube, n_points))
            rest = ~fits[of_cube]
            cubes, count = cubes[rest], count[rest]
        level, full = finest, cubes
    parts, begin = [], 0
    for _, depth, cube, n_points in sorted(found):
        parts.append(Part(depth, cube, begin, n_points, {}))
        begin += n_points
    _take_coarse(parts)
    return parts


def _take_coarse(parts: list[Part]) -> None:
    """Find the middles of cells that hold whole parts, among what coarser nodes have left in them."""
    taken: list[int] = []
    begins = [part.begin for part in parts]
    for level in range(max(part.level for part in parts) - CELLS_BITS):
        cells: dict[int, list[Part]] = {}
        for part in parts:
            if part.level > level + CELLS_BITS:
                cells.setdefault(part.cube_at(level + CELLS_BITS), []).append(part)
        for inside in cells.values():
            begin, end = inside[0].begin, inside[-1].begin + inside[-1].n
            before = taken[bisect_left(taken, begin) : bisect_left(taken, end)]
            middle = begin + (end - begin - len(before)) // 2
            for place in before:
                middle += place <= middle
            insort(taken, middle)
            of = parts[bisect(begins, middle) - 1]
            of.taken.setdefault(level, []).append(middle - of.begin)


def grow(code: Codes, part: Part | None = None) -> Iterator[tuple[int, int, ArrayI, int]]:
    """Deal out points to the nodes of all levels.

    Parameters
    ----------
    code : (n,) of the points, ascending.
    part : of the cloud that these points are; None: the whole cloud.

    Yields
    ------
    level, cube : a node, coarse ones first; those that hold more than the part have points of others, too.
    places : its points, of these n.
    occupied : number of its cells that hold points.
    """
    whole = 0 if part is None else part.level
    left = np.arange(len(code))
    for level in range(_LAST + 1):
        if not len(left):
            return
        cube = code >> np.uint64(3 * (_BITS - level))
        first = np.flatnonzero(np.diff(cube, prepend=cube[0] + np.uint64(1)))
        count = np.diff(first, append=len(code))
        own = np.zeros(len(code), dtype=np.bool_)
        if part is not None and level + CELLS_BITS < whole:
            own[np.searchsorted(left, part.taken.get(level, []))] = True
        else:
            own[_middles(code >> np.uint64(3 * (_BITS - level - CELLS_BITS)))] = True
        cells = np.add.reduceat(own, first, dtype=np.int64)
        if level >= whole:
            # what the finest cells do not tell apart stays together
            own |= np.repeat((count <= LEAF_POINTS) | (level == _LAST), count)
        for start, n, occupied in zip(first, count, cells, strict=True):
            yield level, int(cube[start]), left[start : start + n][own[start : start + n]], int(occupied)
        code, left = code[~own], left[~own]


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
