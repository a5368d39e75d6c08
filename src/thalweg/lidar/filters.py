"""Which points of a georeferenced cloud are left out, and why: one reason each, every one counted.

The cloud is streamed twice. In the first pass `classify` without a grid finds what a point tells by itself,
and what is kept goes into an `Occupancy`. In the second pass `classify` with the frozen grid also knows what
lies about each point::

    for block in blocks:  # first pass
        occupancy.add(points_wcs_m, classify(..., occupancy=None) == Reason.KEPT)
    occupancy.freeze()
    for block in blocks:  # second pass
        reasons = classify(..., occupancy=occupancy)

**Below the water.** Light of 905 nm sees no ground through water: absorption (6.8 per metre; Hale and Querry
1973) leaves half of the light on its way through 0.05 m and back, 2 % through 0.3 m, and the water mirrors
flat beams away. A point lower than the water level at the boat by more than ``below_water_m`` and
``below_water_sigmas`` times the sigma of its height is therefore taken for no surface. Most such points are
*mirror ghosts*: the water reflects the beam onto the bank, and as the sensor knows one straight way only, the
point appears where the bank's mirror image is. It is named so if the place mirrored at the water level of its
own shot lies on the cloud above the water: within `GHOST_RADII` neighbourhood radii of so many points that it
would not be isolated. Waves of slope ``a`` shift the image by ``2 a`` times the way behind the reflection. On
a bank 10 to 25 m away all ghosts are named on still water, 99.8 % with waves of 0.5 degrees (one sigma in
each direction), 91 % with 1 degree, 66 % with 2 degrees; the others are called below the water. Both are left
out: only the name is at stake. `tests/lidar/test_filters.py`.

*Limits.* The water level is that of the boat, for all points of a shot: land below a weir, or down a river of
1 per mille beyond 300 m, lies lower and needs a larger margin. Ghosts of things lower than the margin stay.

**Isolated points.** Fewer than ``isolated_neighbours`` others of the whole cloud within
``isolated_radius_m``; what `Occupancy` promises holds: no point with enough others within the radius is left
out. A shot gives at most two returns, so with 2 or more wanted it cannot save itself; a bird or a swarm of
insects hit by several shots of one revolution can. On a 1:2 slope 40 to 90 m beside a boat at up to 1 m/s
less than 1e-5 of a VLP-16's points are lost. Beyond each 50 m the radius grows by itself once, as shots
lie wider there. Land seen at a grazing angle below 1 degree, with tens of metres between shots, still loses
points: switch the filter off where such land matters.
"""

from enum import IntEnum
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from thalweg.core import (
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayF32,
    ArrayI,
    ArrayU8,
    GeometryError,
    Trajectory,
    njit,
    prange,
)
from thalweg.settings.sections import Filters

GHOST_RADII: Final = 2
"""How many neighbourhood radii a mirror image may miss the cloud by: waves blur it."""
FAR_STEP_M: Final = 50.0
"""Beyond this range, and each multiple of it, the radius of the isolated points grows by itself once."""

MOST_RADII: Final = 16
"""So many neighbourhood radii are looked about at most."""

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

    def blocks(self) -> tuple[ArrayI, ArrayU8]:
        """Places (b,) of the blocks that hold points, ascending, and their counts (b, 512)."""
        used = self._keys >= 0
        order = np.argsort(self._keys[used])
        return self._keys[used][order], self._counts[self._rows[used][order]]

    def add_blocks(self, keys: ArrayI, counts: ArrayU8) -> None:
        """Add what another grid of the same radius has counted: the sums are those of one grid for all.

        Parameters
        ----------
        keys, counts : of `blocks`.

        Raises
        ------
        RuntimeError : the grid is frozen.
        """
        if self._frozen:
            raise RuntimeError("points cannot be added to a frozen grid")
        start = 0
        while start < len(keys):
            start = _add_blocks(keys, counts, start, self._keys, self._rows, self._counts, self._n_blocks)
            if start < len(keys):
                self._grow()

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
        if not 1 <= radii <= MOST_RADII:
            raise GeometryError(f"{radii=}", expected=f"1 to {MOST_RADII}")
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


# ---------------------------------------------------------------- filters


class Reason(IntEnum):
    """Why a point was left out, in the order of precedence; 0 is kept."""

    KEPT = 0
    NO_GPS_TIME = 1
    NO_POSE = 2
    TOO_NEAR = 3
    TOO_FAR = 4
    OWN_HULL = 5
    UNCERTAIN = 6
    BELOW_WATER = 7
    MIRROR_GHOST = 8
    ISOLATED = 9


REMOVED: Final = tuple(reason for reason in Reason if reason != Reason.KEPT)
"""All reasons for which points are left out."""


WORDS: Final[dict[Reason, str]] = {
    Reason.KEPT: "in the cloud",
    Reason.NO_GPS_TIME: "shot while the lidar's clock was not synchronised",
    Reason.NO_POSE: "shot outside the trajectory or in one of its gaps",
    Reason.TOO_NEAR: "nearer than the shortest range",
    Reason.TOO_FAR: "farther than the longest range",
    Reason.OWN_HULL: "on the own boat",
    Reason.UNCERTAIN: "predicted sigma above the limit",
    Reason.BELOW_WATER: "below the water, where no surface can be seen",
    Reason.MIRROR_GHOST: "mirror image of the bank, reflected by the water",
    Reason.ISOLATED: "too few other points about it",
}
"""What each reason says to people."""


def water_level_m(t_gps_s: ArrayLike, trajectory: Trajectory, water_line_ics_m: float) -> ArrayF:
    """Height of the water at the boat at given times, (n,) up in wcs.

    It is the height of the ics origin, linear between nodes, less the depth of the water line below it. Roll
    and pitch are not regarded: the line below the INS moves by ``0.2 m (1 - cos 5 deg)`` = 1 mm only. Heave
    and errors of the height move boat, water and points alike.

    Parameters
    ----------
    t_gps_s : (n,) times; the value means nothing where there is no pose.
    trajectory : poses of the boat.
    water_line_ics_m : down coordinate of the water line in the body frame.
    """
    t = np.asarray(t_gps_s, dtype=np.float64)
    up_m = np.interp(t, trajectory.t_gps_s, trajectory.position_wcs_m[:, 2])
    return np.asarray(up_m - water_line_ics_m)


def classify(
    *,
    timed: ArrayB,
    has_pose: ArrayB,
    range_m: ArrayLike,
    x_ics_m: ArrayLike,
    points_wcs_m: ArrayF,
    water_level_m: ArrayLike,
    settings: Filters,
    min_range_m: float,
    max_range_m: float,
    sigma_max_m: ArrayLike | None = None,
    sigma_up_m: ArrayLike | None = None,
    occupancy: Occupancy | None = None,
) -> ArrayU8:
    """The reason of each point, the first in the order of `Reason` that holds.

    Parameters
    ----------
    timed : (n,) the shot has a GPS time.
    has_pose : (n,) the shot has a pose.
    range_m : (n,) measured range.
    x_ics_m : (n, 3) points in the body frame; float32 is used.
    points_wcs_m : (n, 3) points in wcs; not looked at without a pose.
    water_level_m : (n,) height of the water at the boat, from `water_level_m`.
    settings : what is to be left out.
    min_range_m, max_range_m : both ends belong to the cloud.
    sigma_max_m : (n,) largest predicted sigma of the point's coordinates; NaN is above each limit.
    sigma_up_m : (n,) predicted sigma of its height above the boat, for the margin below the water; None
        counts as 0.
    occupancy : frozen grid of the points that were kept without it; None in the first pass.

    Returns
    -------
    (n,) values of `Reason`. Without a grid mirror ghosts are `Reason.BELOW_WATER`, and none is isolated.

    Raises
    ------
    GeometryError : arrays of different lengths, or a limit of sigma without sigmas.
    """
    with_sigma = settings.max_sigma_m is not None
    if with_sigma and sigma_max_m is None:
        raise GeometryError("filters.max_sigma_m is set, but no sigmas were predicted")
    with_hull = settings.hull_low_ics_m is not None and settings.hull_high_ics_m is not None
    points = np.ascontiguousarray(points_wcs_m, dtype=np.float64)
    ranges: ArrayF32 = np.ascontiguousarray(range_m, dtype=np.float32)
    level = np.ascontiguousarray(water_level_m, dtype=np.float64)
    arrays = {
        "timed": np.ascontiguousarray(timed, dtype=np.bool_),
        "has_pose": np.ascontiguousarray(has_pose, dtype=np.bool_),
        "range_m": ranges,
        "x_ics_m": np.ascontiguousarray(x_ics_m, dtype=np.float32),
        "points_wcs_m": points,
        "water_level_m": level,
    }
    if sigma_up_m is not None:
        arrays["sigma_up_m"] = np.ascontiguousarray(sigma_up_m, dtype=np.float64)
    if with_sigma:
        arrays["sigma_max_m"] = np.ascontiguousarray(sigma_max_m, dtype=np.float32)
    n = len(points)
    for name, values in arrays.items():
        if values.shape != ((n, 3) if name in {"x_ics_m", "points_wcs_m"} else (n,)):
            raise GeometryError(f"{name}.shape={values.shape}", expected=f"one entry for each of {n} points")
    if sigma_up_m is None:
        lowered = level
    else:
        lowered = level - settings.below_water_sigmas * np.asarray(sigma_up_m, dtype=np.float64)
    out = np.empty(n, dtype=np.uint8)
    _first_reason(
        arrays["timed"],
        arrays["has_pose"],
        ranges,
        arrays["x_ics_m"],
        points,
        lowered,
        arrays.get("sigma_max_m", np.empty(0, dtype=np.float32)),
        np.array([min_range_m, max_range_m], dtype=np.float32),
        with_hull,
        np.array([settings.hull_low_ics_m, settings.hull_high_ics_m] if with_hull else np.zeros((2, 3))),
        np.inf if settings.max_sigma_m is None else settings.max_sigma_m,
        np.inf if settings.below_water_m is None else settings.below_water_m,
        out,
    )
    if occupancy is not None:
        _look_around(out, points, ranges, level, settings, occupancy)
    return out


def _look_around(
    reasons: ArrayU8,
    points: ArrayF,
    range_m: ArrayF32,
    level: ArrayF,
    settings: Filters,
    occupancy: Occupancy,
) -> None:
    """Change `reasons` by what the grid tells: ghosts among the points below the water, isolated ones."""
    least = settings.isolated_neighbours
    if settings.mirror_ghosts:
        below = np.flatnonzero(reasons == Reason.BELOW_WATER)
        image = points[below]
        image[:, 2] = 2.0 * level[below] - image[:, 2]
        # an image needs no company of its own: it is no point of the cloud
        enough = max(least, 1)
        on_cloud = occupancy.near(image, enough=enough, radii=GHOST_RADII) >= enough
        reasons[below[on_cloud]] = Reason.MIRROR_GHOST
    if least > 0:
        kept = np.flatnonzero(reasons == Reason.KEPT)
        alone = kept[occupancy.neighbours(points[kept], enough=least) < least]
        # Beams spread: far points may have their neighbours farther away. Each one counts itself.
        reach = 1 + (range_m[alone] // FAR_STEP_M).astype(np.int64)
        for radii in np.unique(reach[reach > 1]).tolist():
            far = reach == radii
            some = occupancy.near(points[alone[far]], enough=least + 1, radii=min(radii, MOST_RADII)) > least
            reach[far] = np.where(some, 0, radii)
        reasons[alone[reach > 0]] = Reason.ISOLATED


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def _first_reason(
    timed: ArrayB,
    has_pose: ArrayB,
    range_m: ArrayF32,
    x_ics: ArrayF32,
    points: ArrayF,
    level: ArrayF,
    sigma: ArrayF32,
    ranges: ArrayF32,
    with_hull: bool,
    hull: ArrayF,
    max_sigma: float,
    below_water: float,
    out: ArrayU8,
) -> None:
    """Reasons that a point tells by itself; the numbers are those of `Reason`."""
    for i in prange(len(out)):
        if not timed[i]:
            out[i] = 1
        elif not has_pose[i]:
            out[i] = 2
        elif not range_m[i] >= ranges[0]:
            out[i] = 3
        elif not range_m[i] <= ranges[1]:
            out[i] = 4
        elif (
            with_hull
            and hull[0, 0] <= x_ics[i, 0] <= hull[1, 0]
            and hull[0, 1] <= x_ics[i, 1] <= hull[1, 1]
            and hull[0, 2] <= x_ics[i, 2] <= hull[1, 2]
        ):
            out[i] = 5
        elif len(sigma) > 0 and not sigma[i] <= max_sigma:
            out[i] = 6
        elif points[i, 2] < level[i] - below_water:
            out[i] = 7
        else:
            out[i] = 0


def count_reasons(reasons: ArrayU8) -> ArrayI:
    """Number of points of each reason, (10,); sums over chunks add up."""
    return np.bincount(reasons, minlength=len(Reason)).astype(np.int64)


def reason_table(counts: ArrayLike) -> pd.DataFrame:
    """Numbers for people: columns ``reason``, ``n``, ``share`` of all points, ``words``.

    Parameters
    ----------
    counts : (10,) from `count_reasons`; kept points included, so that they add up to all decoded points.

    Examples
    --------
    >>> reason_table([6, 0, 0, 2, 0, 0, 0, 0, 0, 0]).query("n > 0")[["reason", "n", "share"]]
         reason  n  share
    0      kept  6   0.75
    3  too_near  2   0.25
    """
    n = np.asarray(counts, dtype=np.int64)
    return pd.DataFrame(
        {
            "reason": [reason.name.lower() for reason in Reason],
            "n": n,
            "share": n / max(int(n.sum()), 1),
            "words": [WORDS[reason] for reason in Reason],
        }
    )


# ---------------------------------------------------------------- how many points lie about a place: a sparse
# grid of counts
#
# Space is cut into cells of half the radius of interest, 8 x 8 x 8 cells make a block, and only blocks that
# hold a point exist. An open-addressing hash table leads from the place of a block to its 512 counts, one
# byte each. The points themselves are not kept, so memory grows with the surface that was seen, not with
# the points on it.
#
# **What a count promises.** All cells that a sphere of the radius about a place touches are added up. So
# every point within the radius is counted, and none farther away than the radius and the diagonal of a cell
# (``1.87 radius``). A point that is found to have fewer than ``k`` others about it has fewer than ``k``
# within the radius: that error is never made. A point whose company is between 1 and 1.87 radii away may be
# kept.
#
# The counts do not depend on the order of the points or on the pieces in which they come.


def _points(points_wcs_m: ArrayLike) -> ArrayF:
    points = np.ascontiguousarray(points_wcs_m, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise GeometryError(f"points of shape {points.shape}", expected="(n, 3)")
    return points


def _empty_table(size: int) -> tuple[ArrayI, AnyArray]:
    """Hash table of ``size`` entries, a power of two: keys of blocks (-1 is free) and their rows."""
    return np.full(size, -1, dtype=np.int64), np.zeros(size, dtype=np.int32)


@njit(cache=True, nogil=True)
def _place(key: int, mask: int) -> np.int64:
    """Where the search for a key begins: its bits stirred by the finaliser of MurmurHash3 (Appleby)."""
    h = np.uint64(key)
    h ^= h >> np.uint64(33)
    h *= np.uint64(0xFF51AFD7ED558CCD)
    h ^= h >> np.uint64(33)
    h *= np.uint64(0xC4CEB9FE1A85EC53)
    h ^= h >> np.uint64(33)
    return np.int64(h & np.uint64(mask))


@njit(cache=True, nogil=True)
def _key(bx: int, by: int, bz: int) -> int:
    """Place of a block as one number: 20 bits for each axis."""
    half = 1 << 19
    return ((bx + half) << 40) | ((by + half) << 20) | (bz + half)


def blocks_within(keys: ArrayI, cell_m: float, low_en_m: ArrayF, high_en_m: ArrayF) -> ArrayB:
    """Which blocks (b,) touch a box (2,), (2,) of east and north, metres."""
    half, edge_m = 1 << 19, 8 * cell_m
    low_m = np.stack([(keys >> 40) - half, ((keys >> 20) & (2 * half - 1)) - half], axis=1) * edge_m
    return np.asarray(((low_m <= high_en_m) & (low_m + edge_m >= low_en_m)).all(axis=1))


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True)
def _add_blocks(
    new: ArrayI, more: ArrayU8, start: int, keys: ArrayI, rows: AnyArray, counts: ArrayU8, n_blocks: ArrayI
) -> int:
    """Add the counts of blocks from ``start`` on; returns where it stopped as all rows are taken."""
    mask = len(keys) - 1
    for i in range(start, len(new)):
        at = _place(new[i], mask)
        while keys[at] != new[i] and keys[at] != -1:
            at = (at + 1) & mask
        if keys[at] == -1:
            if n_blocks[0] == len(counts):
                return i
            keys[at] = new[i]
            rows[at] = n_blocks[0]
            n_blocks[0] += 1
        row = rows[at]
        for cell in range(512):
            total = np.int64(counts[row, cell]) + np.int64(more[i, cell])
            counts[row, cell] = np.uint8(total) if total < 255 else np.uint8(255)
    return len(new)


@njit(cache=True, nogil=True)
def _rehash(keys: ArrayI, rows: AnyArray, new_keys: ArrayI, new_rows: AnyArray) -> None:
    mask = len(new_keys) - 1
    for old in range(len(keys)):
        if keys[old] != -1:
            at = _place(keys[old], mask)
            while new_keys[at] != -1:
                at = (at + 1) & mask
            new_keys[at] = keys[old]
            new_rows[at] = rows[old]


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
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
    for b in prange((n + block - 1) // block):
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


@njit(cache=True, nogil=True, error_model="numpy")
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
