"""Core points: where change is asked for, even over the surfaces of the first and of the last epoch."""

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy.spatial import cKDTree

from thalweg.core import ArrayB, ArrayF, ArrayI, CoverageError, column, frame_of, table_kind
from thalweg.deformation.epochs import Epoch
from thalweg.deformation.m3c2 import ColumnIndex, multiscale_normals
from thalweg.settings.sections import Deformation
from thalweg.surface import Area

CORE_POINTS = table_kind(
    "core_points",
    1,
    [
        column("core", "1", "number of the core point", pa.int64()),
        column("surface", "1", "number of the epoch on whose surface it lies", pa.int64()),
        *(column(f"{axis}_m", "m", f"core point, {axis} in wcs") for axis in ("east", "north", "up")),
        *(
            column(f"normal_{axis}", "1", f"normal towards the boat, {axis}")
            for axis in ("east", "north", "up")
        ),
        column("scale_m", "m", "radius at which the normal was fitted: the most planar"),
        column("area_m2", "m2", "area of the surface that the core point stands for"),
        column("s_m", "m", "along the bank, to the right when looking from the river"),
    ],
)
"""One row a core point."""


def place_core_points(epochs: list[Epoch], settings: Deformation, area: Area) -> pd.DataFrame:
    """Core points on the first surface, and on the last where the first is far; table `CORE_POINTS`.

    A core point is the mean of the points of a cubic cell of edge h. Along the axis that its normal is
    nearest to, the surface crosses a column of cells in the area ``h^2 / max |n|``; the cells of the column
    share it by their points.

    Raises
    ------
    CoverageError : no cell in the area holds enough points, or no core point has a normal.
    """
    spacing = settings.core_spacing_m
    first, last = epochs[0], epochs[-1]
    taken: ArrayI | None = None
    parts = []
    for number, epoch in ((1, first), (len(epochs), last)):
        cells, place, n = _cells(epoch.xyz_m, spacing)
        use = (n >= settings.least_in_cylinder) & area.contains(place)
        if taken is not None and use.any():
            far = cKDTree(taken).query(cells[use], distance_upper_bound=1.8)[0] > 1.8  # no neighbouring cell
            use[np.flatnonzero(use)[~far]] = False
        if taken is None:
            taken = cells[use]
        if not use.any():
            continue
        index = ColumnIndex.of(epoch.xyz_m, max(settings.cylinder_radius_m, 0.5 * max(settings.scales_m)))
        cores = place[use]
        towards = _sight(cores, epoch, epochs, settings)
        normals, scale = multiscale_normals(cores, index, tuple(settings.scales_m), towards=towards)
        known = np.isfinite(normals).all(axis=1)
        area_m2 = _areas(cells[use][known], n[use][known], normals[known], spacing)
        parts.append((np.full(known.sum(), number), cores[known], normals[known], scale[known], area_m2))
    if not parts or not sum(len(part[0]) for part in parts):
        raise CoverageError(
            f"no cell of {spacing:g} m in deformation.area holds {settings.least_in_cylinder} points of "
            f"{first.name!r}",
            expected="an area that the first and the last epoch cover",
            cure="Check deformation.area, or take a larger core_spacing_m",
        )
    surface, cores, normals, scale, area_m2 = (np.concatenate(each) for each in zip(*parts, strict=True))
    axes = ("east", "north", "up")
    return frame_of(
        CORE_POINTS,
        {
            "core": np.arange(len(cores)),
            "surface": surface,
            **{f"{axis}_m": cores[:, i] for i, axis in enumerate(axes)},
            **{f"normal_{axis}": normals[:, i] for i, axis in enumerate(axes)},
            "scale_m": scale,
            "area_m2": area_m2,
            "s_m": (cores[:, :2] - cores[:, :2].mean(axis=0)) @ _along(cores, normals),
        },
    )


def _sight(cores_m: ArrayF, epoch: Epoch, epochs: list[Epoch], settings: Deformation) -> ArrayF:
    """Direction (c, 3) to the scanner of an epoch, of another one if it has none, or as stated."""
    scanner = next((each.scanner_m for each in (epoch, *epochs) if len(each.scanner_m)), None)
    if scanner is None:
        return np.broadcast_to(np.asarray(settings.towards, float), cores_m.shape)
    return np.asarray(scanner[cKDTree(scanner).query(cores_m)[1]] - cores_m)


def _cells(xyz_m: ArrayF, edge_m: float) -> tuple[ArrayI, ArrayF, ArrayI]:
    """Cubic cells (c, 3) that hold points, the means (c, 3) of their points, and how many (c,)."""
    place = np.floor(xyz_m / edge_m).astype(np.int64)
    low = place.min(axis=0)
    size = place.max(axis=0) - low + 1
    key = np.ravel_multi_index(tuple((place - low).T), tuple(size))
    names, of, n = np.unique(key, return_inverse=True, return_counts=True)
    mean = np.stack([np.bincount(of, xyz_m[:, i]) / n for i in range(3)], axis=1)
    return np.stack(np.unravel_index(names, tuple(size)), axis=1) + low, mean, n


def _areas(cells: ArrayI, n: ArrayI, normals: ArrayF, edge_m: float) -> ArrayF:
    """Area (c,) of the surface in each cell, see `place_core_points`."""
    axis = np.argmax(np.abs(normals), axis=1)
    area = np.empty(len(cells))
    for j in range(3):
        order = np.lexsort((cells[:, j], cells[:, (j + 2) % 3], cells[:, (j + 1) % 3]))
        step = np.diff(cells[order], axis=0)
        # another column, or another surface in the same one
        new = (step[:, (j + 1) % 3] != 0) | (step[:, (j + 2) % 3] != 0) | (step[:, j] > 1)
        column = np.empty(len(cells), dtype=np.int64)
        column[order] = np.r_[0, np.cumsum(new)]
        share = n / np.bincount(column, n)[column]
        own = axis == j
        area[own] = edge_m**2 / np.abs(normals[own, j]) * share[own]
    return area


def _along(cores_m: ArrayF, normals: ArrayF) -> ArrayF:
    """Unit vector (2,) along the bank: the longest extent, to the right when looking from the river."""
    plan = cores_m[:, :2] - cores_m[:, :2].mean(axis=0)
    along = np.linalg.eigh(plan.T @ plan)[1][:, -1]
    out = normals[:, :2].mean(axis=0)
    right = np.array([-out[1], out[0]])
    return np.asarray(along if along @ right >= 0 else -along)


# ---------------------------------------------------------------- lines of the bank

LINES = ("bank line", "bank top")
"""What retreats: the contour of one height, and the upper edge of the bank's face."""
_FACE = float(np.sin(np.deg2rad(20.0)))
"""Horizontal part of the normals of the bank's face; flatter ground has no line that moves to the side."""
_BAND_M = 0.25
"""Core points within this height of a line stand for it."""
_TOP = 0.95
"""Share of the core points of the face that lie below its upper edge."""
_LEAST_ON_LINE = 3


def lines_of_bank(
    cores: pd.DataFrame, use: ArrayB, settings: Deformation, line_height_m: float
) -> tuple[pd.DataFrame, ArrayF]:
    """Both lines of a bank in stretches, as weighted sums of distances.

    A face that moves by m to the side, in the direction c across the bank, has the distances ``d = m n'c``.
    The movement of a line in a stretch is the least squares estimate of m from the core points within 0.25 m
    of its height, with c the mean horizontal normal there.

    Parameters
    ----------
    cores : table `thalweg.deformation.core_points.CORE_POINTS`.
    use : (k,) core points that count.
    settings : length of the stretches.
    line_height_m : of the bank line.

    Returns
    -------
    rows : ``line, height_m, s_from_m, s_to_m, cores``, a row a line and stretch that has three core points.
    products : (q, k) weights of the distances, a row each.
    """
    s, up = cores["s_m"].to_numpy(), cores["up_m"].to_numpy()
    normal = cores[["normal_east", "normal_north"]].to_numpy()
    face = use & (np.linalg.norm(normal, axis=1) > _FACE)
    stretch = np.floor(s / settings.station_m).astype(np.int64)
    rows, products = [], []
    for line in LINES:
        for number in np.unique(stretch[face]):
            here = face & (stretch == number)
            height = line_height_m if line == LINES[0] else float(np.quantile(up[here], _TOP)) - _BAND_M
            on_line = here & (np.abs(up - height) <= _BAND_M)
            if on_line.sum() < _LEAST_ON_LINE:
                continue
            ends = {"s_from_m": number * settings.station_m, "s_to_m": (number + 1) * settings.station_m}
            rows.append({"line": line, "height_m": height, **ends, "cores": int(on_line.sum())})
            across = normal[on_line].mean(axis=0)
            share = np.where(on_line, normal @ (across / np.linalg.norm(across)), 0.0)
            products.append(share / np.sum(share**2))
    names = ["line", "height_m", "s_from_m", "s_to_m", "cores"]
    return pd.DataFrame(rows, columns=names), np.array(products).reshape(len(rows), len(s))


def bank_line_m(settings: Deformation, water_m: float) -> float:
    """Height of the bank line: as stated, or half a metre above the water."""
    return water_m + 0.5 if settings.line_height_m is None else settings.line_height_m
