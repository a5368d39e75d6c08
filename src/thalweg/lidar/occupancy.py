"""How many points lie about a place: a sparse grid of counts over a whole cloud.

Space is cut into cells of half the radius of interest, 8 x 8 x 8 cells make a block, and only blocks that
hold a point exist. An open-addressing hash table leads from the place of a block to its 512 counts, one byte
each. The points themselves are not kept, so memory grows with the surface that was seen, not with the points
on it.

**What a count promises.** All cells that a sphere of the radius about a place touches are added up. So every
point within the radius is counted, and none farther away than the radius and the diagonal of a cell
(``1.87 radius``). A point that is found to have fewer than ``k`` others about it has fewer than ``k`` within
the radius: that error is never made. A point whose company is between 1 and 1.87 radii away may be kept.

The counts do not depend on the order of the points or on the pieces in which they come.
"""

from typing import Final

import numba as nb
import numpy as np
from numpy.typing import ArrayLike

from thalweg.core.errors import GeometryError
from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayI, ArrayU8

# Open3D brings an old TBB into the process, which numba would try first and complain about.
nb.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]

CELLS_PER_RADIUS: Final = 2
"""Finer cells come nearer to a sphere, but twice as fine means eight times as many in foliage."""

MOST_COUNTED: Final = 254
"""Largest number of points that can be asked for; a cell counts up to 255."""

_FIRST_BLOCKS: Final = 1 << 12


class Occupancy:
    """Counts of points per cell: first all points are added, then any place can be asked.

    Parameters
    ----------
    radius_m : distance within which points count as neighbours.

    Raises
    ------
    GeometryError : the radius is not a positive number.

    Examples
    --------
    >>> grid = Occupancy(0.5)
    >>> grid.add(np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [9.0, 0.0, 0.0]]))
    >>> grid.freeze()
    >>> grid.near([[0.1, 0.0, 0.0], [5.0, 0.0, 0.0]], enough=10).tolist()
    [2, 0]
    """

    def __init__(self, radius_m: float) -> None:
        if not (np.isfinite(radius_m) and radius_m > 0):
            raise GeometryError(f"a radius of {radius_m} m", expected="a positive number")
        self.radius_m = float(radius_m)
        self._frozen = False
        self._n_points = 0
        self._n_blocks = np.zeros(1, dtype=np.int64)
        self._counts = np.zeros((_FIRST_BLOCKS, 512), dtype=np.uint8)
        self._keys, self._rows = _empty_table(2 * _FIRST_BLOCKS)

    @property
    def cell_m(self) -> float:
        """Edge of a cell."""
        return self.radius_m / CELLS_PER_RADIUS

    @property
    def reach_m(self) -> float:
        """No point farther away than this is ever counted."""
        return self.radius_m + np.sqrt(3.0) * self.cell_m

    @property
    def n_points(self) -> int:
        """Points added so far."""
        return self._n_points

    @property
    def n_bytes(self) -> int:
        """Memory of the table and of the blocks in use."""
        return self._keys.nbytes + self._rows.nbytes + 512 * int(self._n_blocks[0])

    def add(self, points_wcs_m: ArrayLike, where: ArrayLike | None = None) -> None:
        """Count points.

        Parameters
        ----------
        points_wcs_m : (n, 3) in wcs.
        where : (n,) false for points that are not to be counted, whatever their coordinates; by default all.

        Raises
        ------
        GeometryError : a point to be counted has no coordinates or lies absurdly far away.
        RuntimeError : the grid is frozen.
        """
        if self._frozen:
            raise RuntimeError("points cannot be added to a frozen grid")
        points = _points(points_wcs_m)
        use = np.ones(len(points), np.bool_) if where is None else np.ascontiguousarray(where, np.bool_)
        if use.shape != (len(points),):
            raise GeometryError(f"{points.shape=}, {use.shape=}", expected="(n, 3) points and (n,) where")
        start = 0
        while start < len(points):
            start, wrong = _add(
                points, use, start, 1.0 / self.cell_m, self._keys, self._rows, self._counts, self._n_blocks
            )
            if wrong:
                raise GeometryError(
                    f"a point at {points[start].tolist()} m",
                    expected=f"finite coordinates within {2**22 * self.cell_m / 1000:.0f} km of the origin",
                    cure="Look at the trajectory: do its positions belong to this campaign?",
                )
            if start < len(points):
                self._grow()
        self._n_points += int(np.count_nonzero(use))

    def freeze(self) -> None:
        """End the adding: from now on places can be asked."""
        self._frozen = True

    def near(self, places_wcs_m: ArrayLike, *, enough: int, radii: int = 1) -> ArrayU8:
        """Number of added points about places, counted no further than ``enough``.

        Parameters
        ----------
        places_wcs_m : (n, 3) in wcs; 0 is returned where a coordinate is not finite.
        enough : where counting stops; it makes the question cheap on a dense surface.
        radii : so many times the radius of the grid is looked about.

        Returns
        -------
        (n,) the smaller of ``enough`` and the count. A place that is itself an added point counts itself.

        Raises
        ------
        GeometryError : ``enough`` is not between 1 and 254, or ``radii`` not between 1 and 16.
        RuntimeError : the grid is not frozen, so that the answer would depend on the pieces of the cloud.
        """
        if not self._frozen:
            raise RuntimeError("a grid is asked after freeze(), when all points have been added")
        if not 1 <= enough <= MOST_COUNTED:
            raise GeometryError(f"{enough=}", expected=f"1 to {MOST_COUNTED}")
        if not 1 <= radii <= 16:
            raise GeometryError(f"{radii=}", expected="1 to 16")
        places = _points(places_wcs_m)
        out = np.empty(len(places), dtype=np.uint8)
        cells = radii * CELLS_PER_RADIUS
        _near(places, 1.0 / self.cell_m, cells, enough, self._keys, self._rows, self._counts, out)
        return out

    def neighbours(self, points_wcs_m: ArrayLike, *, enough: int = MOST_COUNTED - 1) -> ArrayU8:
        """Number of *other* points about points that were themselves added, no further than ``enough``.

        Parameters
        ----------
        points_wcs_m : (n, 3) in wcs, the very coordinates that were added.
        enough : where counting stops.
        """
        n = self.near(points_wcs_m, enough=enough + 1)
        return np.asarray(n - (n > 0), dtype=np.uint8)

    def _grow(self) -> None:
        """Room for twice as many blocks; zeroed memory costs nothing until it is written."""
        n = int(self._n_blocks[0])
        counts = np.zeros((2 * len(self._counts), 512), dtype=np.uint8)
        counts[:n] = self._counts[:n]
        self._counts = counts
        keys, rows = _empty_table(2 * len(counts))
        _rehash(self._keys, self._rows, keys, rows)
        self._keys, self._rows = keys, rows


def _points(points_wcs_m: ArrayLike) -> ArrayF:
    points = np.ascontiguousarray(points_wcs_m, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise GeometryError(f"points of shape {points.shape}", expected="(n, 3)")
    return points


def _empty_table(size: int) -> tuple[ArrayI, AnyArray]:
    """Hash table of ``size`` entries, a power of two: keys of blocks (-1 is free) and their rows."""
    return np.full(size, -1, dtype=np.int64), np.zeros(size, dtype=np.int32)


@nb.njit(cache=True, nogil=True)
def _place(key: int, mask: int) -> np.int64:
    """Where the search for a key begins: its bits stirred by the finaliser of MurmurHash3 (Appleby)."""
    h = np.uint64(key)
    h ^= h >> np.uint64(33)
    h *= np.uint64(0xFF51AFD7ED558CCD)
    h ^= h >> np.uint64(33)
    h *= np.uint64(0xC4CEB9FE1A85EC53)
    h ^= h >> np.uint64(33)
    return np.int64(h & np.uint64(mask))


@nb.njit(cache=True, nogil=True)
def _key(bx: int, by: int, bz: int) -> int:
    """Place of a block as one number: 20 bits for each axis."""
    half = 1 << 19
    return ((bx + half) << 40) | ((by + half) << 20) | (bz + half)


@nb.njit(cache=True, nogil=True)
def _row(key: int, keys: ArrayI, rows: AnyArray) -> np.int64:
    """Row of a block's counts, -1 if the block holds no point."""
    mask = len(keys) - 1
    at = _place(key, mask)
    while True:
        if keys[at] == key:
            return np.int64(rows[at])
        if keys[at] == -1:
            return np.int64(-1)
        at = (at + 1) & mask


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _add(
    points: ArrayF,
    use: ArrayB,
    start: int,
    per_m: float,
    keys: ArrayI,
    rows: AnyArray,
    counts: ArrayU8,
    n_blocks: ArrayI,
) -> tuple[int, bool]:
    """Count points from ``start`` on; returns where it stopped, and whether that point has no place.

    It stops before a point that needs a block when all rows are taken. The table has twice as many entries as
    there are rows, so that a search always meets a free one.
    """
    mask = len(keys) - 1
    limit = float((1 << 22) - 64)
    last_key, last_row = np.int64(-1), np.int64(-1)
    for i in range(start, len(points)):
        if not use[i]:
            continue
        x, y, z = points[i, 0] * per_m, points[i, 1] * per_m, points[i, 2] * per_m
        if not (abs(x) < limit and abs(y) < limit and abs(z) < limit):
            return i, True
        ix, iy, iz = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
        key = _key(ix >> 3, iy >> 3, iz >> 3)
        if key != last_key:
            at = _place(key, mask)
            while keys[at] != key and keys[at] != -1:
                at = (at + 1) & mask
            if keys[at] == -1:
                if n_blocks[0] == len(counts):
                    return i, False
                keys[at] = key
                rows[at] = n_blocks[0]
                n_blocks[0] += 1
            last_key, last_row = key, np.int64(rows[at])
        cell = ((ix & 7) << 6) | ((iy & 7) << 3) | (iz & 7)
        if counts[last_row, cell] < 255:
            counts[last_row, cell] += np.uint8(1)
    return len(points), False


@nb.njit(cache=True, nogil=True)
def _rehash(keys: ArrayI, rows: AnyArray, new_keys: ArrayI, new_rows: AnyArray) -> None:
    mask = len(new_keys) - 1
    for old in range(len(keys)):
        if keys[old] != -1:
            at = _place(keys[old], mask)
            while new_keys[at] != -1:
                at = (at + 1) & mask
            new_keys[at] = keys[old]
            new_rows[at] = rows[old]


@nb.njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def _near(
    places: ArrayF,
    per_m: float,
    cells: int,
    enough: int,
    keys: ArrayI,
    rows: AnyArray,
    counts: ArrayU8,
    out: ArrayU8,
) -> None:
    n = len(places)
    limit = float((1 << 22) - 64)
    radius2 = float(cells * cells)  # in cells
    block = 16384  # small enough to balance two cores
    for b in nb.prange((n + block - 1) // block):
        last_key, last_row = np.int64(-1), np.int64(-1)
        for i in range(b * block, min((b + 1) * block, n)):
            x, y, z = places[i, 0] * per_m, places[i, 1] * per_m, places[i, 2] * per_m
            if not (abs(x) < limit and abs(y) < limit and abs(z) < limit):
                out[i] = 0
                continue
            ix, iy, iz = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(z))
            key = _key(ix >> 3, iy >> 3, iz >> 3)
            if key != last_key:
                last_key, last_row = key, _row(key, keys, rows)
            total = 0
            if last_row >= 0:
                # most points of a surface have enough company in their own cell
                total += int(counts[last_row, ((ix & 7) << 6) | ((iy & 7) << 3) | (iz & 7)])
            if total < enough:
                total += _around(
                    x - ix, y - iy, z - iz, ix, iy, iz, cells, radius2, enough - total, keys, rows, counts
                )
            out[i] = np.uint8(min(int(total), enough))


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _around(
    x: float,
    y: float,
    z: float,
    ix: int,
    iy: int,
    iz: int,
    cells: int,
    radius2: float,
    enough: int,
    keys: ArrayI,
    rows: AnyArray,
    counts: ArrayU8,
) -> int:
    """Points in the cells that a sphere touches, without its own; ``x, y, z`` are its place in its cell.

    Stops at ``enough``, which the sum may then exceed.
    """
    total = 0
    for bx in range((ix - cells) >> 3, ((ix + cells) >> 3) + 1):
        for by in range((iy - cells) >> 3, ((iy + cells) >> 3) + 1):
            for bz in range((iz - cells) >> 3, ((iz + cells) >> 3) + 1):
                row = _row(_key(bx, by, bz), keys, rows)
                if row < 0:
                    continue
                for jx in range(max(8 * bx, ix - cells), min(8 * bx + 7, ix + cells) + 1):
                    # distance from the place to the nearer face of the cell, in cells
                    gx = max(jx - ix - x, x + (ix - jx - 1), 0.0)
                    for jy in range(max(8 * by, iy - cells), min(8 * by + 7, iy + cells) + 1):
                        gy = max(jy - iy - y, y + (iy - jy - 1), 0.0)
                        for jz in range(max(8 * bz, iz - cells), min(8 * bz + 7, iz + cells) + 1):
                            n = int(counts[row, ((jx & 7) << 6) | ((jy & 7) << 3) | (jz & 7)])
                            if n > 0 and not (jx == ix and jy == iy and jz == iz):
                                gz = max(jz - iz - z, z + (iz - jz - 1), 0.0)
                                if gx * gx + gy * gy + gz * gz <= radius2:
                                    total += n
                                    if total >= enough:
                                        return total
    return total
