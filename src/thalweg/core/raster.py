"""Rasters of heights with named bands: cloud-optimised GeoTIFF, written and read by rasterio."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from pyproj import CRS

from thalweg.core.errors import GeometryError, InputError
from thalweg.core.types import AnyArray, ArrayF, ArrayI


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """Cells of a raster, from north to south and west to east.

    Parameters
    ----------
    west_m, north_m : outer corner of the first cell, on the map.
    cell_m : width and height of a cell.
    rows, columns : their numbers.
    crs : of the map.
    """

    west_m: float
    north_m: float
    cell_m: float
    rows: int
    columns: int
    crs: CRS

    @classmethod
    def around(cls, places_m: ArrayF, cell_m: float, crs: CRS, *, margin_m: float = 0.0) -> Self:
        """Cells at whole multiples of their width about places (n, 2).

        Raises
        ------
        GeometryError : more than 400 million cells.
        """
        low, high = places_m.min(axis=0) - margin_m, places_m.max(axis=0) + margin_m
        first, last = np.floor(low / cell_m), np.ceil(high / cell_m)
        columns, rows = (last - first).astype(np.int64).tolist()
        if rows * columns > 400_000_000:
            raise GeometryError(
                f"{columns} by {rows} cells of {cell_m:g} m",
                expected="at most 400 million",
                cure="Choose larger cells, or look for a place far away from the others",
            )
        return cls(
            west_m=float(first[0] * cell_m),
            north_m=float(last[1] * cell_m),
            cell_m=cell_m,
            rows=max(rows, 1),
            columns=max(columns, 1),
            crs=crs,
        )

    def centres_m(self) -> ArrayF:
        """Centres (rows * columns, 2) of the cells, row by row."""
        east = self.west_m + (np.arange(self.columns) + 0.5) * self.cell_m
        north = self.north_m - (np.arange(self.rows) + 0.5) * self.cell_m
        return np.column_stack([np.tile(east, self.rows), np.repeat(north, self.columns)])

    def at(self, places_m: ArrayF) -> tuple[ArrayI, ArrayI]:
        """Row and column (n,) of places (n, 2); -1 outside."""
        column = np.floor((places_m[:, 0] - self.west_m) / self.cell_m)
        row = np.floor((self.north_m - places_m[:, 1]) / self.cell_m)
        inside = (row >= 0) & (row < self.rows) & (column >= 0) & (column < self.columns)
        return np.where(inside, row, -1).astype(np.int64), np.where(inside, column, -1).astype(np.int64)


def write_raster(
    path: Path, grid: Grid, bands: Mapping[str, AnyArray], *, tags: Mapping[str, str] | None = None
) -> None:
    """Write bands (rows, columns) as float32, NaN where there is no value; same values, same bytes."""
    import rasterio

    with rasterio.open(
        path,
        "w",
        driver="COG",
        height=grid.rows,
        width=grid.columns,
        count=len(bands),
        dtype="float32",
        crs=grid.crs.to_wkt(),
        transform=rasterio.Affine(grid.cell_m, 0.0, grid.west_m, 0.0, -grid.cell_m, grid.north_m),
        nodata=float("nan"),
        compress="deflate",
        predictor="yes",
        overview_resampling="nearest",
        num_threads=1,
    ) as out:
        for k, (name, values) in enumerate(bands.items(), 1):
            out.write(np.asarray(values, dtype=np.float32).reshape(grid.rows, grid.columns), k)
            out.set_band_description(k, name)
        out.update_tags(**(tags or {}))


def read_raster(path: Path) -> tuple[Grid, dict[str, ArrayF], dict[str, str]]:
    """Grid, bands by name (``band 1``, ... where they have none) with NaN for nodata, and tags.

    Raises
    ------
    InputError : no raster, no CRS, a raster that is turned, or cells that are not square.
    """
    import rasterio
    from rasterio.errors import RasterioError

    try:
        with rasterio.open(path) as file:
            t = file.transform
            if file.crs is None or t.b != 0 or t.d != 0 or abs(t.a + t.e) > 1e-9 * t.a:
                raise InputError(
                    f"a raster with CRS {file.crs} and transform {tuple(t)[:6]}",
                    where=path,
                    expected="a CRS, and square cells whose rows run from north to south",
                )
            grid = Grid(
                west_m=t.c,
                north_m=t.f,
                cell_m=t.a,
                rows=file.height,
                columns=file.width,
                crs=CRS.from_wkt(file.crs.to_wkt()),
            )
            values: Any = file.read(masked=True).astype(np.float64).filled(np.nan)
            names = [name or f"band {k}" for k, name in enumerate(file.descriptions, 1)]
            return grid, dict(zip(names, values, strict=True)), dict(file.tags())
    except RasterioError as error:
        raise InputError(f"{error}", where=path, expected="a GeoTIFF") from error
