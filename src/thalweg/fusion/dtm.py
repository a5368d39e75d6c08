r"""One terrain model of bed and banks: height, sigma, source, distance to data.

**Cells.** Points of a cloud become one height a cell: their mean, brought to the centre of the cell along the
slope about it. Their scatter ``w`` about the slope is noise that is new in each point, as far as the sigma
``s`` that they state allows it; the rest of ``s`` is shared, and the rest of ``w`` is relief, stones and
tufts, which no number of points averages away: the height of a place within the cell differs by it. A cell of
n points has ``max(s^2 - w^2, 0) + min(w^2, s^2) / n + max(w^2 - s^2, 0)``, and where the middle of its points
lies ``d`` off the cell's, ``(b d)^2`` besides, with the change of slope ``b`` from cell to cell thereabouts.
Where the part ``p`` of the pose is known, less what a mean over the time of a cell's points takes off it,
no scatter makes the shared part smaller: plants and relief scatter as noise does, and would pass for it, so
that ``min(w^2, s^2 - p^2)`` is what counts as new.

**Ground that hangs together.** The lower envelope of a cloud is ground only where beams reached the ground:
behind a bank, what is lowest may be a crown, a roof, the top of a wall. Cells that lie within two cells (at
least 1 m) of each other, and rise by no more than 45 degrees from one to the other, hang together (the slope
filter of Vosselman 2000, on cells). A patch of the boat's lidar that hangs together neither with the water
line nor over 100 m2 is no ground for certain: it has no height, and is counted. A larger roof passes.

**Water.** Where the bed has a height inside the water line, no cloud has one: what a lidar or a drone saw
there is the dry edge of a cell, a plant, the surface.

**Blending.** Where several sources have a height, the model is their mean with the weights
``taper^2 / sigma^2``. The taper rises from 0 to 1 over `fusion.blend_m` from the border of a source inward,
wherever another source goes on: no source ends with a step. The bed's shorelines come from the lidar and the
surroundings are laid on it, so that sigmas are averaged, not variances. Sources that contradict each other
beyond their sigmas raise the sigma (Birge 1932). No step is left then, however far they lie apart, so that
contradictions are told of the layers, before they are blended.

**Gaps.** Cells without a height inside the water line, and others on request, take the membrane through
their borders (Laplace's equation). Its error at distance d from data is what the model itself shows: the
difference of known heights from the mean of those d to either side. The band of sources names such cells.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import numpy as np
import scipy.sparse as sp
from pyproj import CRS, Transformer
from scipy import ndimage
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree

from thalweg.core import (
    NMAD,
    ArrayB,
    ArrayF,
    ArrayI,
    ArrayU8,
    CoverageError,
    InputError,
    LocalFrame,
    open_raster,
    parse_json,
)
from thalweg.fusion.clouds import SOURCE_WORDS, Cloud, Source
from thalweg.settings.sections import Fusion

BANDS: Final = ("height", "sigma", "source", "distance", "sigma_common")
MOST_CELLS: Final = 100_000_000
_GEOID_PLACES: Final = 400
"""Places of the model that the plane through a geoid is fitted to: many more than its three numbers."""
_LAGS: Final = (1, 2, 4, 8, 16, 32)
_LEAST_SIGMA_M: Final = 1e-3
HANGS_M: Final = 1.0
"""Cells farther apart than this, and than two cells, do not hang together."""
STEEPEST: Final = 1.0
"""Steepest ground from cell to cell, as of `thalweg.surface.LowerEnvelope`."""
LEAST_GROUND_M2: Final = 100.0
"""A smaller patch without a way to the water may be a crown or a roof."""
_LEAST_LAG_CELLS: Final = 30


@dataclass(frozen=True, slots=True, kw_only=True)
class Dtm:
    """A terrain model on a grid.

    Parameters
    ----------
    height_m : (rows, columns) from north to south, west to east; NaN without a height.
    sigma_m : (rows, columns) standard deviation of each height, common part included.
    source : (rows, columns) `Source` that has the largest weight.
    distance_m : (rows, columns) distance to the nearest measurement.
    sigma_common_m : (rows, columns) part of the sigma that all heights share.
    corner_m : (2,) east and north of the north-west corner.
    cell_m : width of a cell.
    crs : the map grid.
    vertical : name of the height system; empty: ellipsoidal heights.
    separation : height of its zero above the ellipsoid as a plane: value where east and north are zero,
        metres; rise per metre to the east and to the north.
    layers : what was seen of the layers that it is made of, for people; no file holds it.
    """

    height_m: ArrayF
    sigma_m: ArrayF
    source: ArrayU8
    distance_m: ArrayF
    sigma_common_m: ArrayF
    corner_m: ArrayF
    cell_m: float
    crs: CRS
    vertical: str = ""
    separation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    layers: Mapping[str, Any] = field(default_factory=dict)

    def centres_m(self) -> ArrayF:
        """East and north (rows, columns, 2) of the centres of the cells."""
        return _centres(self.corner_m, self.cell_m, self.height_m.shape)

    def at(self, places_m: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Height and sigma (m,) at places (m, 2): bilinear between four known cells, else the nearest."""
        column, row = ((places_m - self.corner_m) * (1.0, -1.0) / self.cell_m - 0.5).T
        found = []
        for band in (self.height_m, self.sigma_m):
            smooth = ndimage.map_coordinates(band, (row, column), order=1, cval=np.nan)
            near = ndimage.map_coordinates(band, (row, column), order=0, cval=np.nan)
            found.append(np.where(np.isfinite(smooth), smooth, near))
        return found[0], found[1]

    def at_common(self, places_m: ArrayF) -> ArrayF:
        """Common part of the sigma (m,) at places (m, 2), of the nearest cell."""
        column, row = ((places_m - self.corner_m) * (1.0, -1.0) / self.cell_m - 0.5).T
        return np.asarray(
            ndimage.map_coordinates(self.sigma_common_m, (row, column), order=0, mode="nearest")
        )

    def write(self, path: Path) -> None:
        """Write a cloud-optimised GeoTIFF with the bands `BANDS`; NaN where there is no height.

        Raises
        ------
        InputError : the file cannot be written.
        """
        import rasterio
        from rasterio import Affine
        from rasterio.errors import RasterioError

        bands = (self.height_m, self.sigma_m, self.source, self.distance_m, self.sigma_common_m)
        try:
            with rasterio.open(
                path, "w", driver="COG", width=self.height_m.shape[1], height=self.height_m.shape[0],
                count=len(BANDS), dtype="float32", nodata=np.nan, crs=self.crs.to_wkt(), compress="DEFLATE",
                transform=_placed(Affine, self.corner_m, self.cell_m), overviews="AUTO",
                resampling="nearest",
            ) as file:  # fmt: skip
                for i, (name, band) in enumerate(zip(BANDS, bands, strict=True), start=1):
                    file.write(np.asarray(band, np.float32), i)
                    file.set_band_description(i, name)
                file.update_tags(
                    heights=self.vertical or "ellipsoidal",
                    separation=json.dumps(self.separation),
                    **{f"source_{int(k)}": words for k, words in SOURCE_WORDS.items()},
                )
        except (RasterioError, OSError) as wrong:
            raise InputError(
                f"cannot be written ({wrong})", expected="a folder with room on its disk", where=path
            ) from wrong

    @classmethod
    def read(cls, path: Path) -> "Dtm":
        """A model as `write` wrote it.

        Raises
        ------
        InputError : no such file, or a raster with other bands.
        """
        bands, corner, cell, crs, tags = read_bands(path, len(BANDS))
        return cls(
            height_m=bands[0], sigma_m=bands[1], source=np.nan_to_num(bands[2]).astype(np.uint8),
            distance_m=bands[3], sigma_common_m=bands[4], corner_m=corner, cell_m=cell, crs=crs,
            vertical="" if tags.get("heights", "ellipsoidal") == "ellipsoidal" else tags["heights"],
            separation=tuple(parse_json(tags.get("separation", "[0, 0, 0]"), path)),
        )  # fmt: skip


def read_bands(path: Path, n: int) -> tuple[ArrayF, ArrayF, float, CRS, dict[str, str]]:
    """First bands (n, rows, columns) of a raster, its north-west corner, cell, grid and tags.

    Raises
    ------
    InputError : no such file, too few bands, cells that are turned or not square, or no grid.
    """
    with open_raster(path) as file:
        turn, crs = file.transform, file.crs
        if file.count < n or crs is None or turn.b or turn.d or not np.isclose(turn.a, -turn.e):
            grid = "none" if crs is None else CRS.from_wkt(crs.to_wkt()).name
            raise InputError(
                f"{file.count} bands, grid {grid}, cells {turn.a:g} by {-turn.e:g}",
                expected=f"at least {n} bands in a map grid, square cells, north up", where=path,
            )  # fmt: skip
        bands = file.read(list(range(1, n + 1)), masked=True).astype(np.float64).filled(np.nan)
        corner = np.array([turn.c, turn.f])
        return bands, corner, float(turn.a), CRS.from_wkt(crs.to_wkt()), dict(file.tags())


def _placed(affine: Any, corner_m: ArrayF, cell_m: float) -> Any:
    """The transform of a grid from column and row to east and north."""
    return affine(cell_m, 0.0, corner_m[0], 0.0, -cell_m, corner_m[1])


def _centres(corner_m: ArrayF, cell_m: float, shape: tuple[int, ...]) -> ArrayF:
    east = corner_m[0] + (np.arange(shape[1]) + 0.5) * cell_m
    north = corner_m[1] - (np.arange(shape[0]) + 0.5) * cell_m
    return np.stack(np.meshgrid(east, north), axis=-1)


# ---------------------------------------------------------------- layers


@dataclass(frozen=True, slots=True, kw_only=True)
class Layer:
    """Height, sigma, common sigma and distance (rows, columns) by one source; NaN: nothing known."""

    source: Source
    height_m: ArrayF
    sigma_m: ArrayF
    sigma_common_m: ArrayF
    distance_m: ArrayF

    def without(self, cells: ArrayB) -> "Layer":
        """The same, nothing known in some cells (rows, columns)."""
        bands = ("height_m", "sigma_m", "sigma_common_m", "distance_m")
        changed: dict[str, Any] = {name: np.where(cells, np.nan, getattr(self, name)) for name in bands}
        return replace(self, **changed)


def layer_of_cloud(
    source: Source, cloud_map: Cloud, corner_m: ArrayF, cell_m: float, shape: tuple[int, int]
) -> Layer:
    """Cells of a cloud.

    Parameters
    ----------
    cloud_map : points in the map grid with ellipsoidal heights.
    corner_m, cell_m, shape : of the grid.
    """
    place = (cloud_map.xyz_m[:, :2] - corner_m) * (1.0, -1.0) / cell_m
    column, row = np.floor(place).astype(np.int64).T
    inside = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    cell = (row * shape[1] + column)[inside]
    z, size = cloud_map.xyz_m[inside, 2], shape[0] * shape[1]
    n = np.bincount(cell, minlength=size)
    offset = (place[inside] - np.floor(place[inside]) - 0.5) * (1.0, -1.0) * cell_m
    with np.errstate(invalid="ignore", divide="ignore"):

        def mean(values: ArrayF) -> ArrayF:
            """Mean of the points of each cell."""
            return np.asarray(np.bincount(cell, weights=values, minlength=size) / n)

        first = mean(z)
        east, north, bend = _slopes(first.reshape(shape), cell_m)
        level = z - east.ravel()[cell] * offset[:, 0] - north.ravel()[cell] * offset[:, 1]
        height = mean(level)
        squares = np.bincount(cell, weights=(level - height[cell]) ** 2, minlength=size).astype(float)
        steep = np.hypot(east, north).ravel()[cell]
        stated = mean(cloud_map.sigma_up_m[inside] ** 2 + (steep * cloud_map.sigma_horizontal_m[inside]) ** 2)
        pose = np.zeros(size)
        if cloud_map.pose is not None:
            horizontal, up, age = cloud_map.pose[inside].T
            # the mean of a Gauss-Markov error over a time that has this spread
            spread = np.sqrt(12.0 * np.maximum(mean(age**2) - mean(age) ** 2, 1e-12))
            lasting = 2.0 * (spread - 1.0 + np.exp(-spread)) / spread**2
            pose = np.minimum(mean(up + steep**2 * horizontal) * np.minimum(lasting, 1.0), stated)
        white, free = _pooled(
            squares.reshape(shape), np.maximum(n - 1, 0).reshape(shape), stated.reshape(shape)
        )
        # scatter beyond the stated one that is no chance of so few points
        beyond = white.ravel() > stated * (1 + 2 * np.sqrt(2 / free.ravel()))
        own, relief = np.minimum(white.ravel(), stated - pose), np.where(beyond, white.ravel() - stated, 0.0)
        # noise of three heights, 1, -2, 1, makes a change of slope too
        bend = np.maximum(bend.ravel() - 6.0 * own / n / cell_m**2, 0.0)
        off = mean(offset[:, 0]) ** 2 + mean(offset[:, 1]) ** 2
        variance = stated - own + own / n + relief + bend * off
    known = n > 0
    sigma = np.where(known, np.sqrt(np.maximum(variance, _LEAST_SIGMA_M**2)), np.nan)
    return Layer(
        source=source,
        height_m=np.where(known, height, np.nan).reshape(shape),
        sigma_m=sigma.reshape(shape),
        sigma_common_m=np.where(known, 0.0, np.nan).reshape(shape),
        distance_m=np.where(known, 0.0, np.nan).reshape(shape),
    )


def loose_patches(height_m: ArrayF, water: ArrayB, cell_m: float) -> ArrayB:
    """Known cells (rows, columns) that hang neither together with the water nor over `LEAST_GROUND_M2`.

    Parameters
    ----------
    height_m : (rows, columns); NaN: nothing known.
    water : (rows, columns) cells inside the water line.
    """
    known = np.isfinite(height_m)
    reach = max(HANGS_M, 2 * cell_m) / cell_m + 1e-6
    place, height = np.argwhere(known), height_m[known]
    a, b = cKDTree(place).query_pairs(reach, output_type="ndarray").T
    together = np.abs(height[a] - height[b]) <= STEEPEST * cell_m * np.linalg.norm(
        place[a] - place[b], axis=1
    )
    n, size = int(together.sum()), len(place)
    links = sp.coo_matrix((np.ones(n), (a[together], b[together])), shape=(size, size))
    patch = connected_components(links, directed=False)[1]
    shore = known & (ndimage.distance_transform_edt(~water) <= reach) if water.any() else np.zeros_like(known)
    held = np.bincount(patch) * cell_m**2 >= LEAST_GROUND_M2
    held[patch[shore[known]]] = True
    loose = np.zeros_like(known)
    loose[known] = ~held[patch]
    return loose


def contradictions(layers: list[Layer]) -> dict[str, dict[str, float]]:
    """How two layers differ in the cells that both know, by their names: first less second."""
    found = {}
    for one, other in combinations(layers, 2):
        apart = one.height_m - other.height_m
        both = np.isfinite(apart)
        if both.any():
            of, sigma = apart[both], np.hypot(one.sigma_m, other.sigma_m)[both]
            found[f"{SOURCE_WORDS[one.source]} less {SOURCE_WORDS[other.source]}"] = {
                "cells": int(both.sum()),
                "median_m": float(np.median(of)),
                "spread_m": NMAD * float(np.median(np.abs(of - np.median(of)))),
                "above_two_sigma": float(np.mean(np.abs(of) > 2 * sigma)),
            }
    return found


def _slopes(height: ArrayF, cell_m: float) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Slopes to the east and to the north between neighbouring cells, one-sided at borders, else zero; and
    the squared change of slope from cell to cell, mean of three by three cells.
    """
    found, bends, counts = [], np.zeros(height.shape), np.zeros(height.shape)
    for axis, sign in ((1, 1.0), (0, -1.0)):
        ahead = np.diff(height, axis=axis) * sign / cell_m
        pad = [(0, 0), (0, 0)]
        pad[axis] = (1, 1)
        both = np.pad(ahead, pad, constant_values=np.nan)
        a = np.take(both, range(height.shape[axis]), axis=axis)
        b = np.take(both, range(1, height.shape[axis] + 1), axis=axis)
        n = np.isfinite(a).astype(int) + np.isfinite(b)
        found.append((np.nan_to_num(a) + np.nan_to_num(b)) / np.maximum(n, 1))
        bends += np.nan_to_num(a - b) ** 2
        counts += n == 2
    total, of = (ndimage.uniform_filter(x, 3, mode="constant") for x in (bends, counts))
    return found[0], found[1], np.where(of > 0.05, total / np.maximum(of, 0.05), 0.0)


def _pooled(squares: ArrayF, freedom: ArrayI, stated: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Variance (rows, columns) of single points about the slope, pooled over three by three cells, and its
    degrees of freedom.
    """
    total = ndimage.uniform_filter(np.nan_to_num(squares), 3, mode="constant")
    free = ndimage.uniform_filter(freedom.astype(float), 3, mode="constant")
    return np.where(free > 0.5, total / np.maximum(free, 0.1), stated), np.maximum(9 * free, 1.0)


def layer_of_bed(path: Path, corner_m: ArrayF, cell_m: float, shape: tuple[int, int]) -> Layer:
    """The bed (``bed.tif``) on a grid: its own cells where both grids are the same, else bilinear.

    Raises
    ------
    InputError : no bed, or one without any height.
    """
    bands, corner, cell, _, _ = read_bands(path, 4)
    if not np.isfinite(bands[0]).any():
        raise InputError("a bed without heights", expected="heights under the water", where=path)
    places = _centres(corner_m, cell_m, shape).reshape(-1, 2)
    column, row = ((places - corner) * (1.0, -1.0) / cell - 0.5).T
    same = np.isclose(cell, cell_m) and np.allclose(column, np.rint(column), atol=1e-6)
    if same:
        row, column = np.rint(row), np.rint(column)
    found = [
        ndimage.map_coordinates(b, (row, column), order=0 if same else 1, cval=np.nan).reshape(shape)
        for b in bands
    ]
    known = np.isfinite(found[0]) & np.isfinite(found[1])
    height, sigma, common, distance = (np.where(known, b, np.nan) for b in found)
    common = np.where(known, np.nan_to_num(common), np.nan)
    return Layer(
        source=Source.BED,
        height_m=height,
        sigma_m=np.maximum(sigma, _LEAST_SIGMA_M),
        sigma_common_m=common,
        distance_m=np.where(known, np.nan_to_num(distance), np.nan),
    )


# ---------------------------------------------------------------- the model


def build_dtm(
    bed: Path,
    clouds: Mapping[Source, Cloud],
    water_m: ArrayF,
    frame: LocalFrame,
    settings: Fusion,
    *,
    geoid: Path | None = None,
) -> Dtm:
    """The terrain model.

    Parameters
    ----------
    bed : ``bed.tif``.
    clouds : points in wcs by source, ground alone, fitted.
    water_m : (k, 2) water line in the map grid of the bed, closed by itself.
    frame : wcs.
    settings : cell, blending, gaps, heights.
    geoid : grid of the separation; None: the one that the settings state.

    Raises
    ------
    InputError : no bed, a grid too large, or no grid of a geoid that covers the model.
    CoverageError : cells inside the water line that no measured cell is connected with.
    """
    _, _, own_cell, crs, _ = read_bands(bed, 4)
    cell = settings.cell_m or own_cell
    in_map = {source: _to_map(cloud, frame, crs) for source, cloud in clouds.items() if len(cloud.xyz_m)}
    corner, shape = _grid(bed, in_map, water_m, cell)
    water = cells_inside(water_m, corner, cell, shape)
    layers = [layer_of_bed(bed, corner, cell, shape)]
    wet = water & np.isfinite(layers[0].height_m)
    no_ground = 0
    for source, cloud in in_map.items():
        layer = layer_of_cloud(source, cloud, corner, cell, shape).without(wet)
        if source is Source.LIDAR:
            loose = loose_patches(layer.height_m, water, cell)
            layer, no_ground = layer.without(loose), int(loose.sum())
        layers.append(layer)
    model = blend(layers, corner, cell, crs, blend_m=settings.blend_m)
    seen = {"banks_not_ground_for_certain": no_ground, "contradictions": contradictions(layers)}
    model = replace(_filled(model, water, settings), layers=seen)
    vertical = settings.vertical
    if vertical.name is None:
        return model
    known, places = np.isfinite(model.height_m), model.centres_m()
    plane, sigma = (vertical.separation_m, 0.0, 0.0), vertical.sigma_separation_m
    if geoid is not None:
        plane, beside = _plane_of_grid(geoid, places[known], crs)
        sigma = float(np.hypot(sigma, beside))
    return replace(
        model,
        height_m=model.height_m - separation_at(plane, places),
        sigma_m=np.hypot(model.sigma_m, sigma),
        sigma_common_m=np.where(known, np.hypot(model.sigma_common_m, sigma), np.nan),
        vertical=vertical.name,
        separation=plane,
    )


def separation_at(plane: tuple[float, float, float], places_m: ArrayF) -> ArrayF:
    """Height (...) of the zero of a model's heights above the ellipsoid at places (..., 2) in the map."""
    return np.asarray(plane[0] + places_m[..., :2] @ np.array(plane[1:]))


def _plane_of_grid(path: Path, places_m: ArrayF, crs: CRS) -> tuple[tuple[float, float, float], float]:
    """A plane through the grid of a geoid about places (n, 2), and how far the grid lies off it (rms)."""
    some = places_m[:: -(-len(places_m) // _GEOID_PLACES)]
    with open_raster(path, whole=False) as file:
        if file.crs is None:
            raise InputError("no coordinate system", expected="a grid of a geoid", where=path)
        onto = Transformer.from_crs(crs, CRS.from_wkt(file.crs.to_wkt()), always_xy=True)
        x, y = onto.transform(some[:, 0], some[:, 1])
        if file.crs.is_geographic:  # some grids count from 0 to 360 degrees
            x = file.bounds.left + (np.asarray(x) - file.bounds.left) % 360.0
        turn = file.transform
        column, row = (np.asarray(x) - turn.c) / turn.a, (np.asarray(y) - turn.f) / turn.e
        (top, below), (left, right) = (
            np.clip([np.floor(k.min()) - 2, np.ceil(k.max()) + 2], 0, most).astype(int)
            for k, most in ((row, file.height), (column, file.width))
        )
        band = np.full((1, 1), np.nan)  # the grid lies elsewhere
        if below > top and right > left:
            part = ((top, below), (left, right))
            band = file.read(1, window=part, masked=True).astype(float).filled(np.nan)
    at = (row - top - 0.5, column - left - 0.5)
    found = ndimage.map_coordinates(band, at, order=1, cval=np.nan)
    if not np.isfinite(found).all():
        raise InputError(
            f"no value at {int((~np.isfinite(found)).sum())} of {len(found)} places of the model",
            expected="a geoid that covers the survey", where=path,
        )  # fmt: skip
    middle = some.mean(axis=0)
    rows = np.column_stack([np.ones(len(some)), some - middle])
    value = np.linalg.lstsq(rows, found, rcond=None)[0]
    rest = float(np.sqrt(np.mean((found - rows @ value) ** 2)))
    return (float(value[0] - value[1:] @ middle), float(value[1]), float(value[2])), rest


def _to_map(cloud: Cloud, frame: LocalFrame, crs: CRS) -> Cloud:
    return replace(cloud, xyz_m=frame.to_map(cloud.xyz_m, crs), rgb=None)


def _grid(
    bed: Path, clouds: Mapping[Source, Cloud], water_m: ArrayF, cell: float
) -> tuple[ArrayF, tuple[int, int]]:
    bands, corner, own, _, _ = read_bands(bed, 1)
    ends = [corner, corner + np.array([bands.shape[2], -bands.shape[1]]) * own, *water_m]
    ends += [f(cloud.xyz_m[:, :2], axis=0) for cloud in clouds.values() for f in (np.min, np.max)]
    low, high = np.min(ends, axis=0), np.max(ends, axis=0)
    # cells stay those of the bed: its corner is a corner of the model
    west_north = np.array([low[0], high[1]]) - corner
    steps = np.array([np.floor(west_north[0] / cell + 1e-9), np.ceil(west_north[1] / cell - 1e-9)])
    start = corner + steps * cell
    shape = np.ceil((np.array([high[0], -low[1]]) - start * (1, -1)) / cell - 1e-9).astype(int)[::-1]
    if float(shape[0]) * float(shape[1]) > MOST_CELLS:
        raise InputError(
            f"a model of {shape[0]:,} by {shape[1]:,} cells of {cell:g} m",
            expected=f"at most {MOST_CELLS:,} cells",
            where="fusion.cell_m",
            cure="Take a larger cell, or cut stray points off the clouds",
        )
    return start, (int(shape[0]), int(shape[1]))


def cells_inside(polygon_m: ArrayF, corner_m: ArrayF, cell_m: float, shape: tuple[int, int]) -> ArrayB:
    """Cells whose centres lie inside a polygon."""
    from rasterio import Affine
    from rasterio.features import rasterize

    ring = [tuple(p) for p in np.vstack([polygon_m, polygon_m[:1]]).tolist()]
    burnt = rasterize(
        [({"type": "Polygon", "coordinates": [ring]}, 1)],
        out_shape=shape,
        transform=_placed(Affine, corner_m, cell_m),
        dtype="uint8",
    )
    return np.asarray(burnt == 1)


def blend(layers: list[Layer], corner_m: ArrayF, cell_m: float, crs: CRS, *, blend_m: float) -> Dtm:
    """Sources as one surface: means by sigma and taper, sigmas raised where sources contradict each other."""
    shape = layers[0].height_m.shape
    known = np.array([np.isfinite(layer.height_m) for layer in layers])
    weight, total = np.zeros((len(layers), *shape)), np.zeros(shape)
    for i, layer in enumerate(layers):
        others = known[np.arange(len(layers)) != i].any(axis=0) if len(layers) > 1 else np.zeros(shape, bool)
        # a source fades toward cells that it does not know and another does
        ends = ~known[i] & others
        away = ndimage.distance_transform_edt(~ends) * cell_m if ends.any() else np.full(shape, np.inf)
        taper = np.clip(away / (blend_m + cell_m), 1e-3, 1.0)
        weight[i][known[i]] = (taper[known[i]] / layer.sigma_m[known[i]]) ** 2
    total = weight.sum(axis=0)
    some = total > 0
    share = np.divide(weight, total, out=np.zeros_like(weight), where=some)

    def mixed(name: str) -> ArrayF:
        """A band of all layers, weighted by their shares in each cell."""
        return np.sum(
            [s * np.nan_to_num(getattr(x, name)) for s, x in zip(share, layers, strict=True)], axis=0
        )

    height, common = mixed("height_m"), mixed("sigma_common_m")
    # the shorelines of the bed come from the lidar, and the surroundings were laid on it: errors are shared
    variance = mixed("sigma_m") ** 2
    chi = np.sum(
        [
            k * s * (np.nan_to_num(x.height_m) - height) ** 2
            for k, s, x in zip(known, share, layers, strict=True)
        ],
        axis=0,
    )
    # their spread about the mean holds what their own sigmas do not explain
    variance = np.maximum(variance, np.where(known.sum(axis=0) > 1, chi, 0.0))
    codes = np.array([int(layer.source) for layer in layers], np.uint8)
    sources = np.where(some, codes[share.argmax(axis=0)], int(Source.NONE)).astype(np.uint8)

    def where(values: ArrayF) -> ArrayF:
        """Values where some layer has a height, else NaN."""
        return np.where(some, values, np.nan)

    return Dtm(
        height_m=where(height),
        sigma_m=where(np.sqrt(variance)),
        source=sources,
        distance_m=where(mixed("distance_m")),
        sigma_common_m=where(common),
        corner_m=corner_m,
        cell_m=cell_m,
        crs=crs,
    )


def interpolation_error(height_m: ArrayF, cell_m: float) -> tuple[ArrayF, ArrayF]:
    """Distances and robust errors of the mean of heights so far to either side, from the model itself.

    Returns
    -------
    distance_m, sigma_m : (k,) from zero upward; errors never fall with the distance.
    """
    distances, sigmas = [0.0], [0.0]
    for lag in _LAGS:
        errors = [
            np.take(height_m, range(lag, height_m.shape[axis] - lag), axis=axis)
            - (
                np.take(height_m, range(height_m.shape[axis] - 2 * lag), axis=axis)
                + np.take(height_m, range(2 * lag, height_m.shape[axis]), axis=axis)
            )
            / 2
            for axis in (0, 1)
            if height_m.shape[axis] > 2 * lag
        ]
        every = np.concatenate([e[np.isfinite(e)] for e in errors]) if errors else np.zeros(0)
        if len(every) < _LEAST_LAG_CELLS:
            break
        distances.append(lag * cell_m)
        sigmas.append(
            max(float(np.sqrt(np.mean(np.minimum(every**2, np.quantile(every**2, 0.99))))), sigmas[-1])
        )
    return np.array(distances), np.array(sigmas)


def _filled(model: Dtm, water: ArrayB, settings: Fusion) -> Dtm:
    known = np.isfinite(model.height_m)
    if not known.any():
        raise CoverageError("no cell has a height", expected="a bed or banks inside the grid")
    apart, nearest = ndimage.distance_transform_edt(~known, return_indices=True)
    apart = apart * model.cell_m
    gap = water & ~known
    if settings.fill == "interpolate":
        gap |= ~known & (apart <= settings.fill_m)
    if not gap.any():
        return model
    height = membrane(model.height_m, gap)
    lost = gap & ~np.isfinite(height)
    if (lost & water).any():
        raise CoverageError(
            f"{int((lost & water).sum()):,} cells inside the water line that no measured cell touches",
            expected="a bed that reaches every part of the water line",
            cure="Shorten the bank lines to the reach that was sounded",
        )
    gap &= ~lost
    distances, errors = interpolation_error(model.height_m, model.cell_m)
    slope = errors[-1] / distances[-1] if len(distances) > 1 else 1.0
    grown = np.interp(apart, distances, errors) + slope * np.maximum(apart - distances[-1], 0.0)
    at = tuple(nearest)
    sigma = np.where(gap, np.hypot(model.sigma_m[at], grown), model.sigma_m)
    return replace(
        model,
        height_m=np.where(gap, height, model.height_m),
        sigma_m=sigma,
        source=np.where(gap, np.uint8(Source.FILLED), model.source).astype(np.uint8),
        distance_m=np.where(gap, apart + model.distance_m[at], model.distance_m),
        sigma_common_m=np.where(gap, model.sigma_common_m[at], model.sigma_common_m),
    )


def membrane(height_m: ArrayF, gap: ArrayB) -> ArrayF:
    """Heights (rows, columns) with cells of a gap on the membrane through known cells about it.

    Cells that are neither known nor of the gap are a free border. Parts of the gap that touch no known cell
    stay NaN.
    """
    known = np.isfinite(height_m) & ~gap
    parts, n_parts = ndimage.label(gap)
    edge = ndimage.binary_dilation(known) & gap
    held = np.zeros(n_parts + 1, dtype=np.bool_)
    held[np.unique(parts[edge])] = True
    solve = gap & held[parts]
    number = np.full(height_m.shape, -1)
    n = int(solve.sum())
    number[solve] = np.arange(n)
    out = np.where(known, height_m, np.nan)
    if not n:
        return out
    diagonal, right = np.zeros(n), np.zeros(n)
    rows, columns = [], []
    for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
        moved: Any = _shifted(number, axis, step, -1)
        value = _shifted(np.where(known, height_m, np.nan), axis, step, np.nan)
        here = number[solve]
        other, fixed = moved[solve], value[solve]
        inner, border = other >= 0, np.isfinite(fixed)
        diagonal += inner.astype(float) + border
        right += np.where(border, np.nan_to_num(fixed), 0.0)
        rows.append(here[inner])
        columns.append(other[inner])
    r, c = np.concatenate(rows), np.concatenate(columns)
    matrix = sp.csc_matrix(
        (np.concatenate([np.full(len(r), -1.0), diagonal]), (np.r_[r, np.arange(n)], np.r_[c, np.arange(n)])),
        shape=(n, n),
    )
    out[solve] = spsolve(matrix, right)
    return out


def _shifted(values: Any, axis: int, step: int, outside: float) -> Any:
    """The neighbour of each cell one step along an axis."""
    out = np.roll(values, -step, axis=axis)
    border = [slice(None), slice(None)]
    border[axis] = slice(-1, None) if step > 0 else slice(0, 1)
    out[tuple(border)] = outside
    return out


# ---------------------------------------------------------------- seams


def seam_steps(model: Dtm) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Steps between neighbouring cells of different source beside the slope to both sides.

    A step is the difference of both cells less the mean of the differences beyond either of them: on an even
    slope, however steep, it is zero. Ground without any step that bends once within the four cells, as at the
    toe of a bank, gives up to half the change of the difference, by where between them it bends.

    Returns
    -------
    steps_m, sigmas_m : (k,).
    bends_m : (k,) as much of a step, to either side, as a bend of the ground can be.
    """
    steps, sigmas, bends = [], [], []
    for axis in (0, 1):
        size = model.height_m.shape[axis]
        if size < 4:
            continue
        h = [np.take(model.height_m, range(k, size - 3 + k), axis=axis) for k in range(4)]
        v = [np.take(model.sigma_m**2, range(k, size - 3 + k), axis=axis) for k in range(4)]
        a, b = (np.take(model.source, range(k, size - 3 + k), axis=axis) for k in (1, 2))
        step = 1.5 * (h[2] - h[1]) - 0.5 * (h[3] - h[0])
        # h2 - h1 - ((h1 - h0) + (h3 - h2)) / 2 = 1.5 (h2 - h1) - (h3 - h0) / 2
        variance = 2.25 * (v[1] + v[2]) + 0.25 * (v[0] + v[3])
        seam = (a != b) & np.isfinite(step) & np.isfinite(variance)
        steps.append(step[seam])
        sigmas.append(np.sqrt(variance[seam]))
        bends.append(np.abs((h[3] - h[2]) - (h[1] - h[0]))[seam] / 2)
    none = [np.zeros(0)]
    return np.concatenate(steps or none), np.concatenate(sigmas or none), np.concatenate(bends or none)


def dtm_facts(model: Dtm) -> dict[str, Any]:
    """Cells by source, sigmas, steps at seams, and what was seen of the layers, for people."""
    known = np.isfinite(model.height_m)
    step, sigma, bend = seam_steps(model)
    size = np.abs(step)
    return {
        **model.layers,
        "cells": int(known.sum()),
        "cell_m": model.cell_m,
        "heights": model.vertical or "ellipsoidal",
        "by_source": {
            SOURCE_WORDS[s]: int((model.source == int(s)).sum())
            for s in Source
            if s is not Source.NONE and (model.source == int(s)).any()
        },
        "median_sigma_m": float(np.median(model.sigma_m[known])),
        "seam_cells": len(step),
        "seam_above_two_sigma": float(np.mean(size - bend > 2 * sigma)) if len(step) else 0.0,
        "seam_and_bend_above_two_sigma": float(np.mean(size > 2 * sigma)) if len(step) else 0.0,
        "seam_spread_m": NMAD * float(np.median(size)) if len(step) else 0.0,
    }
