"""Whether an epoch could have seen a core point, and why not: what was not seen is never called eroded.

Beams are followed through cubic cells from the scanner to the point that they hit. A beam that passed through
the cylinder of a core point and hit something well behind it proves that there was no surface: free space.
"""

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy.spatial import cKDTree

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayI, column, frame_of, njit, prange, table_kind
from thalweg.deformation.epochs import Epoch
from thalweg.deformation.field import ErrorGroup
from thalweg.settings.sections import Deformation

REASONS = ("", "water", "range", "incidence", "occlusion", "not swept", "free space", "no trajectory")
"""Why an epoch has no points at a core point; nothing if it has. Of an epoch of files nobody knows."""

VISIBILITY = table_kind(
    "visibility",
    1,
    [
        column("core", "1", "number of the core point", pa.int64()),
        *(
            item
            for i, which in ((1, "first"), (2, "second"))
            for item in (
                column(f"seen_{i}", "1", f"the {which} epoch has points there", pa.bool_()),
                column(
                    f"reason_{i}",
                    "1",
                    f"why the {which} epoch has none: {', '.join(REASONS[1:])}",
                    pa.string(),
                ),
                column(
                    f"beams_through_{i}", "1", f"beams of the {which} epoch that passed through", pa.int64()
                ),
            )
        ),
    ],
)
"""One row a core point."""

_WATER_MARGIN_M = 0.1
"""Places lower than this above the water of the epoch are water."""
_VOXEL_M = 0.25
"""Cells in which beams look for what is in their way."""
_LOOKS = 12
"""Places of the boat from which a core point is looked at."""
_LEAST_BEAMS = 3
"""Beams that must have passed through a place to prove that it was free."""
_MOST_BEAMS = 2_000_000


def observe_visibility(
    cores_m: ArrayF, normals: ArrayF, n: ArrayI, epochs: tuple[Epoch, Epoch], settings: Deformation
) -> pd.DataFrame:
    """Table `VISIBILITY`: for each core point whether both epochs saw it, and why not.

    Parameters
    ----------
    cores_m, normals : (k, 3), normals towards the boat.
    n : (k, 2) points of both epochs in the cylinders.
    epochs : first and second.
    """
    columns: dict[str, AnyArray] = {"core": np.arange(len(cores_m))}
    for i, epoch in enumerate(epochs, start=1):
        seen = n[:, i - 1] >= settings.least_in_cylinder
        if not len(epoch.scanner_m):
            columns |= {
                f"seen_{i}": seen,
                f"reason_{i}": np.where(seen, "", REASONS[-1]),
                f"beams_through_{i}": np.zeros(len(seen), dtype=np.int64),
            }
            continue
        through = beams_through(cores_m, normals, epoch, settings)
        reason = _reasons(cores_m, normals, epoch, settings)
        # a beam through the place where the other epoch has a surface outranks all other reasons
        reason = np.where(through >= _LEAST_BEAMS, "free space", reason)
        columns |= {
            f"seen_{i}": seen,
            f"reason_{i}": np.where(seen, "", reason),
            f"beams_through_{i}": through,
        }
    return frame_of(VISIBILITY, columns)


def _reasons(cores_m: ArrayF, normals: ArrayF, epoch: Epoch, settings: Deformation) -> AnyArray:
    """Why an epoch might not have seen core points (k,), the strongest reason first."""
    limits = settings.visibility
    near, place = cKDTree(epoch.scanner_m).query(cores_m)
    water = epoch.water_m[place] + _WATER_MARGIN_M
    looks = min(_LOOKS, len(epoch.scanner_m))
    within = np.asarray(near <= limits.max_range_m)
    every = epoch.scanner_m[:: max(1, len(epoch.scanner_m) // 2000)]
    nearest = cKDTree(every).query(cores_m, k=min(looks, len(every)))[1].reshape(len(cores_m), -1)
    sight = every[nearest] - cores_m[:, None]
    length = np.linalg.norm(sight, axis=2)
    cosine = np.einsum("klx,kx->kl", sight, normals) / length
    steep = cosine.max(axis=1) < np.cos(np.deg2rad(limits.max_incidence_deg))
    blocked = _blocked(cores_m, every, nearest, epoch, _VOXEL_M)
    kinds = [cores_m[:, 2] < water, np.asarray(~within), np.asarray(steep), blocked]
    return np.select(kinds, [np.array(reason) for reason in REASONS[1:5]], default="not swept")


def _blocked(cores_m: ArrayF, scanner_m: ArrayF, looks: ArrayI, epoch: Epoch, voxel_m: float) -> ArrayB:
    """Whether something of the epoch stands in every line of sight (k,)."""
    grid = _Voxels(epoch.xyz_m, voxel_m)
    return np.asarray(
        _all_blocked(cores_m, scanner_m, looks, grid.keys, grid.low, grid.size, voxel_m, 4.0 * voxel_m)
    )


def beams_through(cores_m: ArrayF, normals: ArrayF, epoch: Epoch, settings: Deformation) -> ArrayI:
    """Beams (k,) that passed within half a cylinder of each core point and hit something clear behind it.

    Clear is three standard deviations of where pose and core point lie to each other, and not less than the
    radius of the cylinder.
    """
    radius = 0.5 * settings.cylinder_radius_m
    sigma = 0.0
    for group in epoch.groups:
        chain = isinstance(group, ErrorGroup) and group.link is not None
        if group.name.startswith("position") or chain:
            sigma += float(np.mean(np.sum(group.root[:, :3] ** 2, axis=(1, 2)))) / 3.0
    clear = max(settings.cylinder_radius_m, 3.0 * np.sqrt(2.0 * sigma))
    edge = max(settings.core_spacing_m, 2.0 * radius)
    grid = _Voxels(cores_m, edge)
    step = -(-len(epoch.xyz_m) // _MOST_BEAMS)
    ends = np.ascontiguousarray(epoch.xyz_m[::step])
    starts = np.ascontiguousarray(epoch.scanner_m[epoch.moment[::step]])
    reach = float(settings.visibility.max_range_m)
    hits = _passes(
        starts,
        ends,
        np.ascontiguousarray(cores_m),
        np.ascontiguousarray(normals),
        grid.keys,
        grid.order,
        grid.low,
        grid.size,
        edge,
        radius,
        clear,
        reach,
    )
    return np.asarray(hits) * step


class _Voxels:
    """Points sorted by the cubic cell that they lie in."""

    def __init__(self, xyz_m: ArrayF, edge_m: float) -> None:
        place = np.floor(xyz_m / edge_m).astype(np.int64)
        self.low = place.min(axis=0) - 1
        self.size = place.max(axis=0) - self.low + 2
        key = np.ravel_multi_index(tuple((place - self.low).T), tuple(self.size))
        self.order = np.argsort(key, kind="stable")
        self.keys = key[self.order]


@njit(cache=True)
def _first(keys: AnyArray, value: int) -> int:
    """Index of the first key that is not smaller."""
    low, high = 0, len(keys)
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < value:
            low = middle + 1
        else:
            high = middle
    return low


@njit(cache=True, parallel=True)
def _all_blocked(
    cores: AnyArray,
    scanner: AnyArray,
    looks: AnyArray,
    keys: AnyArray,
    low: AnyArray,
    size: AnyArray,
    edge: float,
    margin: float,
) -> AnyArray:
    """For each core point whether an occupied cell stands in each line of sight, but near its ends."""
    out = np.zeros(len(cores), np.bool_)
    for i in prange(len(cores)):
        free = False
        for j in range(looks.shape[1]):
            s = scanner[looks[i, j]]
            dx, dy, dz = s[0] - cores[i, 0], s[1] - cores[i, 1], s[2] - cores[i, 2]
            length = np.sqrt(dx * dx + dy * dy + dz * dz)
            hit = False
            for k in range(int(max(0.0, length - margin - edge) / (0.5 * edge))):
                share = (margin + 0.5 * edge * k) / length
                a = int(np.floor((cores[i, 0] + share * dx) / edge)) - low[0]
                b = int(np.floor((cores[i, 1] + share * dy) / edge)) - low[1]
                c = int(np.floor((cores[i, 2] + share * dz) / edge)) - low[2]
                if not (0 <= a < size[0] and 0 <= b < size[1] and 0 <= c < size[2]):
                    continue
                key = (a * size[1] + b) * size[2] + c
                at = _first(keys, key)
                if at < len(keys) and keys[at] == key:
                    hit = True
                    break
            if not hit:
                free = True
                break
        out[i] = not free
    return out


@njit(cache=True)
def _passes(
    starts: AnyArray,
    ends: AnyArray,
    cores: AnyArray,
    normals: AnyArray,
    keys: AnyArray,
    order: AnyArray,
    low: AnyArray,
    size: AnyArray,
    edge: float,
    radius: float,
    clear: float,
    reach: float,
) -> AnyArray:
    """Beams that pass a core point within the radius, through its surface, and end so far behind it."""
    out = np.zeros(len(cores), np.int64)
    last = np.full(len(cores), -1, np.int64)
    for b in range(len(starts)):
        dx, dy, dz = ends[b, 0] - starts[b, 0], ends[b, 1] - starts[b, 1], ends[b, 2] - starts[b, 2]
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        if length < clear or length > 4.0 * reach:
            continue
        dx, dy, dz = dx / length, dy / length, dz / length
        # the stretch of the beam inside the box of the core points
        t0, t1 = 0.0, length - clear
        for axis in range(3):
            d = dx if axis == 0 else (dy if axis == 1 else dz)
            lower, upper = (
                low[axis] * edge - starts[b, axis],
                (low[axis] + size[axis]) * edge - starts[b, axis],
            )
            if abs(d) < 1e-12:
                if lower > 0.0 or upper < 0.0:
                    t1 = -1.0
                continue
            first, second = lower / d, upper / d
            t0, t1 = max(t0, min(first, second)), min(t1, max(first, second))
        k = 0
        while t0 + 0.5 * edge * k <= t1:
            t = t0 + 0.5 * edge * k
            k += 1
            i0 = int(np.floor((starts[b, 0] + t * dx) / edge)) - low[0]
            j0 = int(np.floor((starts[b, 1] + t * dy) / edge)) - low[1]
            k0 = int(np.floor((starts[b, 2] + t * dz) / edge)) - low[2]
            if not (0 <= i0 < size[0] and 0 <= j0 < size[1] and 0 <= k0 < size[2]):
                continue
            key = (i0 * size[1] + j0) * size[2] + k0
            at = _first(keys, key)
            while at < len(keys) and keys[at] == key:
                c = order[at]
                at += 1
                if last[c] == b:
                    continue
                rx, ry, rz = (
                    cores[c, 0] - starts[b, 0],
                    cores[c, 1] - starts[b, 1],
                    cores[c, 2] - starts[b, 2],
                )
                along = rx * dx + ry * dy + rz * dz
                if along > length - clear:
                    continue
                if rx * rx + ry * ry + rz * rz - along * along > radius * radius:
                    continue
                # behind the surface itself, not along it: the end lies clear behind the core's plane
                behind = (
                    (ends[b, 0] - cores[c, 0]) * normals[c, 0]
                    + (ends[b, 1] - cores[c, 1]) * normals[c, 1]
                    + (ends[b, 2] - cores[c, 2]) * normals[c, 2]
                )
                if behind < -clear:
                    last[c] = b
                    out[c] += 1
    return out
