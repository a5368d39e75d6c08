"""Photogrammetric points of a bed, seen through the surface of the water: correction of refraction.

Structure from motion takes rays for straight, so that the bed appears too shallow. For a camera whose ray
leaves the apparent point at the angle r from the vertical (in air; i below the surface, sin r = n sin i), the
bed lies at

    depth = apparent depth * tan r / tan i = apparent depth * sqrt((n^2 - sin^2 r) / (1 - sin^2 r))

The mean over all cameras that look steeply enough is the correction (Dietrich 2017, Earth Surface Processes
and Landforms 42, 355-364); seen from above the factor is n.
"""

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from thalweg.core import ArrayF, GeometryError, InputError
from thalweg.ingest import read_places

__all__ = ["correct_refraction", "read_columns"]

CORRECTED: Final = "corrected"
DRY: Final = "above the water"
NO_LEVEL: Final = "no water level"
UNSEEN: Final = "no camera looks steeply enough"
_CHUNK: Final = 1 << 16
"""Points at once: bounds the memory of points times cameras."""


def correct_refraction(
    points_m: ArrayLike,
    water_m: ArrayLike,
    cameras_m: ArrayLike,
    *,
    index: float = 1.333,
    sigma_index: float = 0.001,
    sigma_point_m: float = 0.0,
    sigma_water_m: float = 0.0,
    max_off_nadir_deg: float = 35.0,
) -> pd.DataFrame:
    """Heights of a bed from its apparent points, with standard deviations.

    The standard deviation joins those of the apparent point (grown by the factor), of the water level and of
    the refractive index with the scatter of the factor over the cameras, because which of them took part in a
    point is not known.

    Parameters
    ----------
    points_m : (n, 3) east, north, height as structure from motion gives them.
    water_m : (n,) or one, height of the water's surface above each point.
    cameras_m : (k, 3) projection centres, in the same frame.
    index : refractive index of water relative to air; 1.333 in fresh water of 20 degrees at 589 nm.
    sigma_index, sigma_point_m, sigma_water_m : standard deviations of the index, of an apparent height, and
        of the water level.
    max_off_nadir_deg : cameras that see a point at a larger angle from the vertical are left out.

    Returns
    -------
    A row a point: ``east_m, north_m, height_m`` (corrected), ``sigma_height_m, depth_m, apparent_depth_m,
    factor, n_cameras, state``. Points above the water keep their height; without a level or a camera the
    height is missing, and ``state`` says why.

    Raises
    ------
    InputError : shapes that do not fit, no camera, or an index or an angle without a meaning.
    GeometryError : cameras below the surface of the water.
    """
    points = np.asarray(points_m, dtype=np.float64)
    cameras = np.asarray(cameras_m, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or cameras.ndim != 2 or cameras.shape[1:] != (3,):
        raise InputError(f"points {points.shape}, cameras {cameras.shape}", expected="(n, 3) and (k, 3)")
    if not len(cameras) or not np.isfinite(cameras).all():
        raise InputError("no cameras, or some without finite coordinates", expected="a place for each")
    if not 1.0 < index < 2.0 or not 0.0 < max_off_nadir_deg < 90.0:
        raise InputError(
            f"index {index:g}, angle {max_off_nadir_deg:g} degrees",
            expected="an index of water against air such as 1.333, an angle between 0 and 90 degrees",
        )
    water = np.broadcast_to(np.asarray(water_m, dtype=np.float64), len(points))
    if (low := cameras[:, 2] <= np.nanmax(water, initial=-np.inf)).any():
        raise GeometryError(
            f"{low.sum()} of {len(cameras)} cameras stand at or below the water, the lowest at "
            f"{cameras[low, 2].min():.2f} m",
            expected="cameras above the water, heights of cameras, points and water in one system",
            cure="Compare the height systems: ellipsoid and geoid differ by tens of metres",
        )
    apparent = water - points[:, 2]
    wet = apparent > 0
    factor, scatter, by_index = np.ones((3, len(points))) * [[1.0], [0.0], [0.0]]
    seen = np.zeros(len(points), dtype=np.int64)
    for first in range(0, len(points), _CHUNK):
        rows = first + np.flatnonzero(wet[first : first + _CHUNK])
        factor[rows], scatter[rows], by_index[rows], seen[rows] = _factors(
            points[rows], cameras, index, np.sin(np.deg2rad(max_off_nadir_deg)) ** 2
        )
    lost = np.isnan(apparent) | (wet & (seen == 0))
    depth = np.where(lost, np.nan, apparent * factor)
    variance = (
        (factor * sigma_point_m) ** 2
        + ((factor - 1) * sigma_water_m) ** 2
        + (np.where(wet, apparent, 0.0) * np.hypot(by_index * sigma_index, scatter)) ** 2
    )
    return pd.DataFrame(
        {
            "east_m": points[:, 0],
            "north_m": points[:, 1],
            "height_m": np.where(wet | lost, water - depth, points[:, 2]),
            "sigma_height_m": np.where(lost, np.nan, np.sqrt(variance)),
            "depth_m": np.where(wet, depth, np.nan),
            "apparent_depth_m": np.where(wet, apparent, np.nan),
            "factor": np.where(lost, np.nan, factor),
            "n_cameras": seen,
            "state": np.select(
                [np.isnan(apparent), ~wet, seen == 0], [NO_LEVEL, DRY, UNSEEN], default=CORRECTED
            ),
        }
    )


def _factors(
    points: ArrayF, cameras: ArrayF, index: float, max_square: float
) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF]:
    """Mean factor over the cameras that see a point, its scatter, derivative by the index; their number."""
    away = cameras[None] - points[:, None]
    square = 1.0 - away[..., 2] ** 2 / np.einsum("pkx,pkx->pk", away, away)  # sin^2 r
    use = square <= max_square
    n = use.sum(axis=1)
    each = np.sqrt((index**2 - square) / (1.0 - square))
    by_index = index / np.sqrt((index**2 - square) * (1.0 - square))
    weight = use / np.maximum(n, 1)[:, None]
    mean = np.sum(weight * each, axis=1)
    scatter = np.sqrt(np.sum(weight * (each - mean[:, None]) ** 2, axis=1))
    return mean, scatter, np.sum(weight * by_index, axis=1), n


def read_columns(path: Path, *, height: str | None = None, water: str | None = None) -> tuple[ArrayF, ArrayF]:
    """Places (n, 3) of a table with a header (CSV), and its water level (n,), NaN without a column.

    Parameters
    ----------
    path : CSV with columns x, y, z, or east, north, height.
    height : name of the column with heights, if it is another one.
    water : name of the column with the height of the water's surface.

    Raises
    ------
    InputError : no table, no such column, or text where numbers are expected.
    """
    table, found = read_places(path, None, any_system=True)
    up = table.find("height") if height is None else table.column(height)
    if up is None:
        raise InputError(
            f"columns {table.listed()}",
            expected="a column of heights",
            where=path,
            cure="Name the column of heights by --height",
        )
    xyz = np.column_stack([found.xy_m, table.numbers(up, "height")])
    bad = np.flatnonzero(~np.isfinite(xyz).all(axis=1))
    if len(bad) or not len(xyz):
        raise InputError(
            f"{len(bad)} of {len(xyz)} rows without coordinates",
            expected="x, y and height in each row",
            where=f"{path}:{table.line[bad[0]]}" if len(bad) else path,
            cure="Leave these rows out",
        )
    level = np.full(len(xyz), np.nan) if water is None else table.numbers(table.column(water), "level")
    return xyz, level
