"""Distances between two clouds along the normals of core points (M3C2), and which points made them.

M3C2 (Lague, Brodu and Leroux 2013, ISPRS J. 82): around each core point a cylinder along the local normal
cuts a piece out of each cloud; the distance is the difference of the two mean positions along the normal. A
distance is thus a weighted sum of points, and its error the weighted sum of theirs. For clouds from a moving
boat the points of one moment share the errors of that moment's pose; `Weights` keeps what
`thalweg.deformation.field` needs to add them up.
"""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from thalweg.core import AnyArray, ArrayF, ArrayI, GeometryError, njit, prange

_MOST_COLUMNS = 200_000_000
"""Columns of the index: 800 MB."""


@dataclass(frozen=True, slots=True)
class ColumnIndex:
    """Points in vertical columns of a horizontal grid, sorted by height in each.

    Attributes
    ----------
    xyz_m : (n, 3) points in the order of the index.
    order : (n,) row of each in the cloud as it was given.
    start : (nx * ny + 1,) first point of each column.
    low_m : (2,) corner of the first column; ``width_m`` edge of a column; ``size`` (2,) number of columns.
    """

    xyz_m: ArrayF
    order: ArrayI
    start: ArrayI
    low_m: ArrayF
    size: ArrayI
    width_m: float

    @classmethod
    def of(cls, xyz_m: ArrayF, width_m: float) -> Self:
        """Index points (n, 3), n >= 1, by columns of this width.

        Raises
        ------
        GeometryError : no points, coordinates that are not finite, or an extent of too many columns.
        """
        if not len(xyz_m) or not np.isfinite(xyz_m).all():
            bad = int((~np.isfinite(xyz_m)).any(axis=1).sum()) if len(xyz_m) else 0
            raise GeometryError(
                f"a cloud of {len(xyz_m)} points, {bad} of them with coordinates that are not finite",
                expected="at least one point, and finite coordinates",
            )
        low = xyz_m[:, :2].min(axis=0)
        size = np.floor(np.ptp(xyz_m[:, :2], axis=0) / width_m).astype(np.int64) + 1
        if float(size[0]) * float(size[1]) > _MOST_COLUMNS:
            raise GeometryError(
                f"a cloud over {size[0] * width_m:.0f} m x {size[1] * width_m:.0f} m",
                expected=f"at most {_MOST_COLUMNS:,} columns of {width_m:g} m",
                cure="Look for points far from all others, or take a wider cylinder",
            )
        place = np.floor((xyz_m[:, :2] - low) / width_m).astype(np.int64)
        column = place[:, 0] * size[1] + place[:, 1]
        order = np.lexsort((xyz_m[:, 2], column))
        start = np.searchsorted(column[order], np.arange(size[0] * size[1] + 1))
        return cls(np.ascontiguousarray(xyz_m[order]), order, start.astype(np.int64), low, size, width_m)


@dataclass(frozen=True, slots=True)
class Cylinders:
    """What the cylinders around core points cut out of one cloud, along their normals.

    Attributes
    ----------
    n : (k,) number of points; distances and spreads are NaN where it is too small.
    along_m : (k,) mean position along the normal from the core point.
    std_m : (k,) standard deviation along the normal (n - 1).
    """

    n: ArrayI
    along_m: ArrayF
    std_m: ArrayF


@dataclass(frozen=True, slots=True)
class Weights:
    """How errors of poses act on positions along normals: sparse rows, one for each core point.

    Row ``i`` has the entries ``start[i]:start[i + 1]``; ``node`` (m,) names the moment (node of the
    trajectory), ``shift`` (m, 3) is the derivative of the mean position to that moment's position error
    (east, north, up) and ``turn_m`` (m, 3) that to its small rotation about east, north, up.
    """

    start: ArrayI
    node: ArrayI
    shift: ArrayF
    turn_m: ArrayF


def multiscale_normals(
    cores_m: ArrayF, cloud: ColumnIndex, radii_m: tuple[float, ...], *, towards: ArrayF
) -> tuple[ArrayF, ArrayF]:
    """Normals of planes through the neighbours of core points, each at the scale where they are most planar.

    Planarity is (l2 - l1) / l3 of the eigenvalues l1 <= l2 <= l3 of the neighbours' scatter.

    Parameters
    ----------
    cores_m : (k, 3) core points.
    cloud : neighbours are searched in it.
    radii_m : radii of the spheres; the most planar one counts.
    towards : (3,) direction into which normals point, or (k, 3), one for each core point.

    Returns
    -------
    normals : (k, 3) unit vectors; NaN where no sphere holds three points that are not on a line.
    radius_m : (k,) the scale that was taken.
    """
    sight = np.ascontiguousarray(np.broadcast_to(np.asarray(towards, float), cores_m.shape))
    normals = np.full(cores_m.shape, np.nan)
    best = np.full(len(cores_m), -1.0)
    radius = np.full(len(cores_m), np.nan)
    for each in radii_m:
        scatter, n = _scatter(
            cores_m, float(each), cloud.xyz_m, cloud.start, cloud.low_m, cloud.size, cloud.width_m
        )
        values, vectors = np.linalg.eigh(scatter)
        with np.errstate(invalid="ignore", divide="ignore"):
            planarity = (values[:, 1] - values[:, 0]) / values[:, 2]
        better = (n >= 3) & (planarity > best) & (values[:, 1] > 1e-12 * values[:, 2])
        best[better], radius[better] = planarity[better], each
        normals[better] = vectors[better, :, 0]
    normals *= np.where((normals * sight).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
    return normals, radius


def cut_cylinders(
    cores_m: ArrayF,
    normals: ArrayF,
    cloud: ColumnIndex,
    *,
    radius_m: float,
    half_length_m: float,
    least: int = 2,
) -> Cylinders:
    """Mean and spread along the normals of the points in the cylinders of core points.

    Parameters
    ----------
    cores_m, normals : (k, 3) centres of the cylinders and unit vectors of their axes.
    cloud : points, indexed.
    radius_m, half_length_m : of the cylinders.
    least : points that a mean needs; with fewer, mean and spread are NaN.
    """
    sums = _cylinder_sums(
        cores_m,
        normals,
        radius_m,
        half_length_m,
        cloud.xyz_m,
        cloud.start,
        cloud.low_m,
        cloud.size,
        cloud.width_m,
    )
    n = sums[:, 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(n >= least, sums[:, 1] / n, np.nan)
        variance = np.where(n >= max(least, 2), (sums[:, 2] - n * mean**2) / (n - 1.0), np.nan)
    return Cylinders(n.astype(np.int64), mean, np.sqrt(np.maximum(variance, 0.0)))


def mean_in_cylinders(
    cores_m: ArrayF,
    normals: ArrayF,
    cloud: ColumnIndex,
    values: AnyArray,
    *,
    radius_m: float,
    half_length_m: float,
) -> ArrayF:
    """Means (k, c) of values (n, c) of the points in the cylinders of `cut_cylinders`; NaN without points.

    Parameters
    ----------
    values : in the order in which the cloud was given.
    """
    ordered = np.ascontiguousarray(values[cloud.order], dtype=np.float64)
    place = (cloud.xyz_m, cloud.start, cloud.low_m, cloud.size, cloud.width_m)
    return np.asarray(_cylinder_means(cores_m, normals, radius_m, half_length_m, *place, ordered))


def pose_weights(
    cores_m: ArrayF,
    normals: ArrayF,
    cloud: ColumnIndex,
    node: ArrayI,
    boat_m: ArrayF,
    *,
    radius_m: float,
    half_length_m: float,
) -> Weights:
    """Derivatives of the mean positions of `cut_cylinders` to the errors of the scanner's poses.

    A pose that errs by a shift dp and a small rotation dw (world axes, about the boat) moves its points by
    dp + dw x r with r = point - boat, and their mean along a normal n by n . dp / N + (r x n) . dw / N each.

    Parameters
    ----------
    cores_m, normals, cloud, radius_m, half_length_m : see `cut_cylinders`.
    node : (n,) moment of each point of the cloud, in the order in which the cloud was given.
    boat_m : (m, 3) place of the boat at each moment.
    """
    of_point = np.ascontiguousarray(node[cloud.order])
    place = (cloud.xyz_m, cloud.start, cloud.low_m, cloud.size, cloud.width_m)
    boat = np.ascontiguousarray(boat_m)
    room = 64 * _BLOCK  # entries of a block of core points; more where they see more moments
    counts = [np.zeros(0, np.int64)]
    parts = [[np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3))]]
    first = 0
    while first < len(cores_m):
        some = slice(first, first + _CHUNK)
        count, *filled = _fill_weights(
            cores_m[some], normals[some], radius_m, half_length_m, *place, of_point, boat, room
        )
        if (count < 0).any():
            room *= 2
            continue
        of_block = np.add.reduceat(count, np.arange(0, len(count), _BLOCK))
        kept = (np.arange(room) < of_block[:, None]).ravel()
        counts.append(count)
        parts.append([each[kept] for each in filled])
        first += _CHUNK
    nodes, shift, turn = (np.concatenate(each) for each in zip(*parts, strict=True))
    return Weights(np.r_[0, np.cumsum(np.concatenate(counts))].astype(np.int64), nodes, shift, turn)


# ---------------------------------------------------------------- kernels


@njit(cache=True)
def _range_of_column(
    cx: float,
    cy: float,
    cz: float,
    nx: float,
    ny: float,
    nz: float,
    r: float,
    length: float,
    mx: float,
    my: float,
    half: float,
) -> tuple[float, float]:
    """Heights between which a cylinder can have points in a column; low > high if there are none."""
    level = math.sqrt(nx * nx + ny * ny)
    dx, dy = mx - cx, my - cy
    reach = half * 1.4142135623730951 + r
    low, high = -length, length
    if level > 1e-9:
        ux, uy = nx / level, ny / level
        ahead, aside = dx * ux + dy * uy, dx * uy - dy * ux
        if abs(aside) > reach:
            return 1.0, 0.0
        low, high = max(low, (ahead - reach) / level), min(high, (ahead + reach) / level)
        if low > high:
            return 1.0, 0.0
    elif dx * dx + dy * dy > reach * reach:
        return 1.0, 0.0
    a, b = cz + low * nz, cz + high * nz
    spread = r * level
    return min(a, b) - spread - 1e-9, max(a, b) + spread + 1e-9


@njit(cache=True)
def _first_at_least(z: AnyArray, first: int, stop: int, value: float) -> int:
    while first < stop:
        middle = (first + stop) // 2
        if z[middle, 2] < value:
            first = middle + 1
        else:
            stop = middle
    return first


@njit(cache=True)
def _members(
    c: AnyArray,
    n: AnyArray,
    r: float,
    length: float,
    xyz: AnyArray,
    start: AnyArray,
    low: AnyArray,
    size: AnyArray,
    width: float,
    found: AnyArray,
) -> tuple[int, AnyArray]:
    """Points of a cylinder; the buffer grows where it has to."""
    many = 0
    if not (n[0] == n[0] and c[0] == c[0]):
        return many, found
    ex = length * abs(n[0]) + r * math.sqrt(max(0.0, 1.0 - n[0] * n[0]))
    ey = length * abs(n[1]) + r * math.sqrt(max(0.0, 1.0 - n[1] * n[1]))
    i0, i1 = math.floor((c[0] - ex - low[0]) / width), math.floor((c[0] + ex - low[0]) / width)
    j0, j1 = math.floor((c[1] - ey - low[1]) / width), math.floor((c[1] + ey - low[1]) / width)
    for i in range(max(i0, 0), min(i1, size[0] - 1) + 1):
        for j in range(max(j0, 0), min(j1, size[1] - 1) + 1):
            first, stop = start[i * size[1] + j], start[i * size[1] + j + 1]
            if first == stop:
                continue
            mx, my = low[0] + (i + 0.5) * width, low[1] + (j + 0.5) * width
            bottom, top = _range_of_column(c[0], c[1], c[2], n[0], n[1], n[2], r, length, mx, my, 0.5 * width)
            if bottom > top:
                continue
            for k in range(_first_at_least(xyz, first, stop, bottom), stop):
                if xyz[k, 2] > top:
                    break
                dx, dy, dz = xyz[k, 0] - c[0], xyz[k, 1] - c[1], xyz[k, 2] - c[2]
                along = dx * n[0] + dy * n[1] + dz * n[2]
                if abs(along) <= length and dx * dx + dy * dy + dz * dz - along * along <= r * r:
                    if many == len(found):
                        larger = np.empty(2 * many, np.int64)
                        for i in range(many):  # a slice takes numba three seconds longer to compile
                            larger[i] = found[i]
                        found = larger
                    found[many] = k
                    many += 1
    return many, found


_BLOCK = 256
"""Core points of one piece of work; a piece keeps its buffer."""
_CHUNK = 32 * _BLOCK
"""Core points whose entries are held twice at once."""


@njit(cache=True, parallel=True)
def _cylinder_sums(
    cores: AnyArray,
    normals: AnyArray,
    r: float,
    length: float,
    xyz: AnyArray,
    start: AnyArray,
    low: AnyArray,
    size: AnyArray,
    width: float,
) -> AnyArray:
    out = np.zeros((len(cores), 3))
    for b in prange((len(cores) + _BLOCK - 1) // _BLOCK):
        found = np.empty(1024, np.int64)
        for i in range(b * _BLOCK, min(len(cores), (b + 1) * _BLOCK)):
            many, found = _members(cores[i], normals[i], r, length, xyz, start, low, size, width, found)
            total = 0.0
            for m in range(many):
                k = found[m]
                for axis in range(3):
                    total += (xyz[k, axis] - cores[i, axis]) * normals[i, axis]
            mean = total / many if many else 0.0
            squares = 0.0
            for m in range(many):
                k = found[m]
                along = 0.0
                for axis in range(3):
                    along += (xyz[k, axis] - cores[i, axis]) * normals[i, axis]
                squares += (along - mean) ** 2
            out[i, 0] = many
            out[i, 1] = total
            out[i, 2] = squares + many * mean * mean
    return out


@njit(cache=True, parallel=True)
def _cylinder_means(
    cores: AnyArray,
    normals: AnyArray,
    r: float,
    length: float,
    xyz: AnyArray,
    start: AnyArray,
    low: AnyArray,
    size: AnyArray,
    width: float,
    values: AnyArray,
) -> AnyArray:
    out = np.full((len(cores), values.shape[1]), np.nan)
    for b in prange((len(cores) + _BLOCK - 1) // _BLOCK):
        found = np.empty(1024, np.int64)
        for i in range(b * _BLOCK, min(len(cores), (b + 1) * _BLOCK)):
            many, found = _members(cores[i], normals[i], r, length, xyz, start, low, size, width, found)
            if many:
                out[i] = 0.0
            for m in range(many):
                for c in range(values.shape[1]):
                    out[i, c] += values[found[m], c] / many
    return out


@njit(cache=True, parallel=True)
def _fill_weights(
    cores: AnyArray,
    normals: AnyArray,
    r: float,
    length: float,
    xyz: AnyArray,
    start: AnyArray,
    low: AnyArray,
    size: AnyArray,
    width: float,
    node: AnyArray,
    boat: AnyArray,
    room: int,
) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    """Entries of each core point in order of the moments, those of a block from ``block * room`` on.

    Numbers of entries (k,), nodes, shifts and turns; the numbers of a block for which the room is not enough
    are negative.
    """
    blocks = (len(cores) + _BLOCK - 1) // _BLOCK
    count = np.zeros(len(cores), np.int64)
    nodes = np.empty(blocks * room, np.int64)
    shift, turn = np.empty((blocks * room, 3)), np.empty((blocks * room, 3))
    for b in prange(blocks):
        found = np.empty(1024, np.int64)
        last = np.full(len(boat), -1)  # core point that saw each moment last
        points = np.zeros(len(boat))  # of a moment in the cylinder, and the sum of their places
        place = np.zeros((len(boat), 3))
        seen = np.empty(len(boat), np.int64)
        e = b * room
        for i in range(b * _BLOCK, min(len(cores), (b + 1) * _BLOCK)):
            many, found = _members(cores[i], normals[i], r, length, xyz, start, low, size, width, found)
            n = 0
            lowest, highest = len(boat), -1
            for m in range(many):
                k = found[m]
                moment = node[k]
                if last[moment] != i:
                    last[moment] = i
                    seen[n] = moment
                    n += 1
                    lowest, highest = min(lowest, moment), max(highest, moment)
                    points[moment] = 0.0
                    place[moment, 0] = place[moment, 1] = place[moment, 2] = 0.0
                points[moment] += 1.0
                place[moment, 0] += xyz[k, 0] - cores[i, 0]
                place[moment, 1] += xyz[k, 1] - cores[i, 1]
                place[moment, 2] += xyz[k, 2] - cores[i, 2]
            if e + n > (b + 1) * room:
                for j in range(b * _BLOCK, min(len(cores), (b + 1) * _BLOCK)):
                    count[j] = -1
                break
            count[i] = n
            if n == 0:
                continue
            if highest - lowest < 16 * n:  # one passage: its moments are close to each other
                n = 0
                for moment in range(lowest, highest + 1):
                    if last[moment] == i:
                        seen[n] = moment
                        n += 1
            else:
                seen[:n].sort()
            n0, n1, n2 = normals[i, 0] / many, normals[i, 1] / many, normals[i, 2] / many
            for m in range(n):
                moment = seen[m]
                own = points[moment]
                rx = place[moment, 0] + own * (cores[i, 0] - boat[moment, 0])
                ry = place[moment, 1] + own * (cores[i, 1] - boat[moment, 1])
                rz = place[moment, 2] + own * (cores[i, 2] - boat[moment, 2])
                nodes[e] = moment
                shift[e, 0], shift[e, 1], shift[e, 2] = own * n0, own * n1, own * n2
                turn[e, 0] = ry * n2 - rz * n1
                turn[e, 1] = rz * n0 - rx * n2
                turn[e, 2] = rx * n1 - ry * n0
                e += 1
    return count, nodes, shift, turn


@njit(cache=True, parallel=True)
def _scatter(
    cores: AnyArray, r: float, xyz: AnyArray, start: AnyArray, low: AnyArray, size: AnyArray, width: float
) -> tuple[AnyArray, AnyArray]:
    """Covariance of the points within a sphere around each core point, and their number."""
    out = np.zeros((len(cores), 3, 3))
    many = np.zeros(len(cores), np.int64)
    for c in prange(len(cores)):
        x, y, z = cores[c, 0], cores[c, 1], cores[c, 2]
        if x != x:
            continue
        n = 0
        mean = np.zeros(3)
        square = np.zeros((3, 3))
        d = np.zeros(3)
        i0, i1 = math.floor((x - r - low[0]) / width), math.floor((x + r - low[0]) / width)
        j0, j1 = math.floor((y - r - low[1]) / width), math.floor((y + r - low[1]) / width)
        for i in range(max(i0, 0), min(i1, size[0] - 1) + 1):
            for j in range(max(j0, 0), min(j1, size[1] - 1) + 1):
                first, stop = start[i * size[1] + j], start[i * size[1] + j + 1]
                for k in range(_first_at_least(xyz, first, stop, z - r), stop):
                    if xyz[k, 2] > z + r:
                        break
                    d[0], d[1], d[2] = xyz[k, 0] - x, xyz[k, 1] - y, xyz[k, 2] - z
                    if d[0] * d[0] + d[1] * d[1] + d[2] * d[2] > r * r:
                        continue
                    n += 1
                    for a in range(3):
                        mean[a] += d[a]
                        for b in range(a + 1):
                            square[a, b] += d[a] * d[b]
        many[c] = n
        if n:
            for a in range(3):
                for b in range(a + 1):
                    value = square[a, b] / n - mean[a] / n * (mean[b] / n)
                    out[c, a, b] = value
                    out[c, b, a] = value
    return out, many
