"""Difference of the surfaces of two epochs on a grid of the map, with the sigma of each cell and of volumes.

Of two surface models it is the difference of their rasters, see `difference_of_surfaces`. Of clouds the
mean height of the points in a vertical cylinder about the centre of each cell, whose section has the area of
the cell, is one more weighted sum of points: it has the same errors as the distances along normals, and loses
the same motion. A steep bank is better measured along its normals.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import scipy.sparse as sp
from pyproj import CRS
from scipy.stats import norm

from thalweg.core import ArrayB, ArrayF, ArrayI, CoverageError, Dsm, Grid, LocalFrame, frame_of
from thalweg.deformation import (
    CORE_POINTS,
    Compared,
    Distances,
    Epoch,
    ErrorField,
    Pair,
    Registration,
    design_of,
    measure_pair,
    registered_distances,
)
from thalweg.deformation.foreign.epochs import dsm_of, masks_of
from thalweg.deformation.foreign.surfaces import (
    HeightErrors,
    SurfaceDifference,
    difference_of_surfaces,
    volume_table,
)
from thalweg.settings.sections import Deformation, Epoch as Statement
from thalweg.surface import Area

_UP = np.array([0.0, 0.0, 1.0])


def difference_of_models(
    before: Statement,
    after: Statement,
    settings: Deformation,
    crs: str,
    registration: Registration | None = None,
) -> SurfaceDifference:
    """Difference of two surface models on the grid of the first, without the height that was taken off.

    Parameters
    ----------
    before, after : epochs whose ``dsm`` is a file.
    settings : ``resample``.
    crs : map grid of rasters that state none.
    registration : motion of the second epoch, of which rasters show the height.

    Raises
    ------
    InputError, GeometryError : see `difference_of_surfaces`.
    """
    models = [dsm_of(each) for each in (before, after)]
    models = [
        each if each.frame is not None else replace(each, frame=CRS.from_user_input(crs)) for each in models
    ]
    errors = [
        HeightErrors.of_bands(model, stated.correlation_m)
        if stated.sigma_m is None
        else HeightErrors(stated.sigma_m, stated.correlation_m or 0.0, stated.sigma_common_m or 0.0)
        for model, stated in zip(models, (before, after), strict=True)
    ]
    facts = {} if registration is None else registration.facts
    sigma_m = 0.0 if registration is None else float(np.sqrt(registration.cov[2, 2]))
    if registration is not None:
        models[1] = replace(models[1], height_m=models[1].height_m - registration.parameters[2])
    if facts.get("areas") == "drawn":  # what all heights of an epoch share was taken off
        errors = [each and replace(each, common_m=0.0) for each in errors]
    if "estimated" in facts:
        errors = [HeightErrors(**facts["estimated"])] * 2
    elif sigma_m and None in errors:  # all that is known of the heights is how far they may lie off
        errors = [each or HeightErrors(0.0) for each in errors]
    masks = [mask for stated in (before, after) for mask in masks_of(stated)]
    return difference_of_surfaces(
        models[0],
        models[1],
        (errors[0], errors[1]),
        sigma_registration_m=sigma_m,
        resample=settings.resample,
        leave_out=masks,
    )


def difference_of_epochs(
    cores: pd.DataFrame,
    before: Epoch,
    after: Epoch,
    registration: Registration,
    settings: Deformation,
    area: Area,
    *,
    frame: LocalFrame,
    crs: str,
) -> SurfaceDifference:
    """Difference of the mean heights of two epochs in cells of ``core_spacing_m`` on the map, registered.

    Parameters
    ----------
    cores : table `CORE_POINTS`, which the registration rests on.
    before, after : epochs in one frame.
    registration : motion of the second epoch, see `thalweg.deformation.changes.register_pair`.
    area : cells outside have no difference.
    frame : of the epochs; crs : of the raster.

    Raises
    ------
    CoverageError : no cell in the area holds points of the first epoch.
    GeometryError : no cell has enough points of both epochs.
    """
    grid, cells, middles = _cells(before, area, frame, CRS.from_user_input(crs), settings.core_spacing_m)
    k = len(cores)
    places = _as_cores(middles, settings.core_spacing_m)
    vertical = settings.replace(cylinder_radius_m=settings.core_spacing_m / np.sqrt(np.pi))
    pair = _joined(
        measure_pair(cores, before, after, settings), measure_pair(places, before, after, vertical)
    )
    centre = cores[["east_m", "north_m", "up_m"]].to_numpy().mean(axis=0)
    moved = replace(
        registration,
        design=np.concatenate(
            [registration.design, design_of(middles, np.broadcast_to(_UP, middles.shape), centre)]
        ),
        weights=np.column_stack([registration.weights, np.zeros((6, len(places)))]),
        stable=np.r_[registration.stable, np.zeros(len(places), bool)],
    )
    compared = registered_distances(pair, moved)
    height = np.full(grid.rows * grid.columns, np.nan)
    sigma = height.copy()
    n = pair.found.n[k:]
    use = np.isfinite(compared.distance_m[k:]) & (n >= settings.least_in_cylinder).all(axis=1)
    height[cells[use]] = compared.distance_m[k:][use]
    sigma[cells[use]] = compared.sigma_m[k:][use]
    shape = (grid.rows, grid.columns)
    raster = Dsm(
        height.reshape(shape),
        np.array([grid.west_m, grid.north_m]),
        np.full(2, grid.cell_m),
        grid.crs,
        Path("dod.tif"),
    )
    return SurfaceDifference(raster, sigma.reshape(shape), _volumes(compared, k, use, n, grid.cell_m), [])


def _cells(
    epoch: Epoch, area: Area, frame: LocalFrame, crs: CRS, cell_m: float
) -> tuple[Grid, ArrayI, ArrayF]:
    """Grid of the map, cells (c,) of it in the area that hold points, their middles (c, 3) in the frame."""
    inside = area.contains(epoch.xyz_m)
    if not inside.any():
        raise CoverageError(
            f"no point of {epoch.name!r} lies in deformation.area", expected="an area that it covers",
            cure="Check the polygon and its frame",
        )  # fmt: skip
    points = epoch.xyz_m[inside]
    in_map = frame.to_map(points, crs)
    grid = Grid.around(in_map[:, :2], cell_m, crs)
    row, column = grid.at(in_map[:, :2])
    names, of = np.unique(row * grid.columns + column, return_inverse=True)
    up = np.bincount(of, in_map[:, 2]) / np.bincount(of)
    middles = frame.from_map(np.column_stack([grid.centres_m()[names], up]), crs)
    return grid, names, middles


def _as_cores(middles_m: ArrayF, cell_m: float) -> pd.DataFrame:
    """Table `CORE_POINTS` of the middles (c, 3) of cells, with vertical normals."""
    c = len(middles_m)
    axes = ("east", "north", "up")
    return frame_of(
        CORE_POINTS,
        {
            "core": np.arange(c),
            "surface": np.ones(c, dtype=np.int64),
            **{f"{axis}_m": middles_m[:, i] for i, axis in enumerate(axes)},
            **{f"normal_{axis}": np.full(c, _UP[i]) for i, axis in enumerate(axes)},
            "scale_m": np.full(c, np.nan),
            "area_m2": np.full(c, cell_m**2),
            "s_m": np.zeros(c),
        },
    )


def _joined(one: Pair, two: Pair) -> Pair:
    """Distances of two sets of places between the same epochs, with the field of both."""
    a, b = one.found, two.found
    rows = tuple(sp.vstack(both).tocsr() for both in zip(one.field.rows, two.field.rows, strict=True))
    found = Distances(
        *(
            np.concatenate([getattr(a, name), getattr(b, name)])
            for name in ("cores_m", "normals", "scale_m", "n", "distance_m", "roughness_m")
        )
    )
    return Pair(
        cores=pd.concat([one.cores, two.cores], ignore_index=True),
        epochs=one.epochs,
        found=found,
        field=ErrorField(one.field.groups, rows),
        white_m=np.concatenate([one.white_m, two.white_m]),
        scatter_m=np.concatenate([one.scatter_m, two.scatter_m]),
        several=np.concatenate([one.several, two.several]),
    )


def _volumes(compared: Compared, k: int, use: ArrayB, n: ArrayI, cell_m: float) -> pd.DataFrame:
    """Table `VOLUMES` of the cells behind the first k places."""
    distance, sigma = compared.distance_m[k:], compared.sigma_m[k:]
    limit = float(norm.isf(0.025)) * sigma
    seen = n > 0
    with np.errstate(invalid="ignore"):
        parts: Sequence[tuple[str, ArrayB]] = (
            ("net", use),
            ("erosion", use & (distance < 0)),
            ("deposition", use & (distance > 0)),
            ("erosion beyond the level of detection", use & (distance < -limit)),
            ("deposition beyond the level of detection", use & (distance > limit)),
        )
    products = np.zeros((len(parts), k + len(use)))
    for product, (_, cells) in zip(products, parts, strict=True):
        product[k:] = np.where(cells, cell_m**2, 0.0)
    spread = np.sqrt(np.sum(compared.variances(products), axis=0))
    volume = products @ np.nan_to_num(compared.distance_m)
    rows = [
        (name, int(cells.sum()), float(cells.sum()) * cell_m**2, float(v), float(s))
        for (name, cells), v, s in zip(parts, volume, spread, strict=True)
    ]
    for name, cells in (
        ("not seen in second", ~use & seen[:, 0] & ~seen[:, 1]),
        ("too few points", ~use & seen.all(axis=1)),
    ):
        rows.append((name, int(cells.sum()), float(cells.sum()) * cell_m**2, np.nan, np.nan))
    return volume_table(rows)
