"""Rasters: cells, names of bands, same bytes, refused files."""

from pathlib import Path

import numpy as np
import pytest
import rasterio
from pyproj import CRS

from thalweg.core import GeometryError, Grid, InputError, read_dsm, read_raster, write_raster
from thalweg.ingest.registry import recognise

UTM = CRS("EPSG:25833")


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")  # of affine, inside rasterio
def test_written_read_and_read_by_others(tmp_path: Path) -> None:
    grid = Grid.around(np.array([[10.2, 20.1], [14.9, 23.0]]), 0.5, UTM, margin_m=1.0)
    height = np.arange(grid.rows * grid.columns, dtype=float)
    height[7] = np.nan
    write_raster(tmp_path / "a.tif", grid, {"height_m": height, "sigma_m": height / 10}, tags={"kind": "bed"})
    again, bands, tags = read_raster(tmp_path / "a.tif")
    assert again == grid
    assert tags["kind"] == "bed"
    np.testing.assert_array_equal(bands["height_m"].ravel(), height)
    with rasterio.open(tmp_path / "a.tif") as file:
        assert file.descriptions == ("height_m", "sigma_m")
        assert file.crs.to_epsg() == 25833
        places = grid.centres_m()
        found = np.array([v[0] for v in file.sample(places[:20].tolist())])
    np.testing.assert_array_equal(found, height[:20].astype(np.float32))
    write_raster(tmp_path / "b.tif", grid, {"height_m": height, "sigma_m": height / 10}, tags={"kind": "bed"})
    assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "b.tif").read_bytes()


def test_cells_of_places() -> None:
    grid = Grid(west_m=10.0, north_m=30.0, cell_m=2.0, rows=3, columns=4, crs=UTM)
    row, column = grid.at(np.array([[10.5, 29.5], [17.9, 24.1], [9.9, 29.0], [12.0, 23.9]]))
    assert row.tolist() == [0, 2, -1, -1]
    assert column.tolist() == [0, 3, -1, -1]
    np.testing.assert_array_equal(grid.at(grid.centres_m())[0], np.repeat([0, 1, 2], 4))


def test_a_raster_of_thousands_of_millions_of_cells_is_refused(tmp_path: Path) -> None:
    """Of which the file holds none: some kilobytes, and 14 GB as numbers."""
    path = tmp_path / "sparse.tif"
    place = rasterio.Affine(1.0, 0.0, 400_000.0, 0.0, -1.0, 5_600_000.0)
    size = {"height": 60_000, "width": 60_000, "count": 1, "dtype": "float32", "tiled": True, "nodata": -9999}
    rasterio.open(path, "w", driver="GTiff", transform=place, crs=UTM, sparse_ok=True, **size).close()
    for read in (read_raster, read_dsm):
        with pytest.raises(InputError, match=r"60,000 by 60,000 cells; expected at most 400 million at once"):
            read(path)
    assert recognise(path) == "geotiff"  # a BigTIFF


def test_bad_rasters_are_named(tmp_path: Path) -> None:
    with pytest.raises(GeometryError, match="at most 400 million"):
        Grid.around(np.array([[0.0, 0.0], [1e6, 1e6]]), 0.5, UTM)
    (tmp_path / "no.tif").write_text("nothing")
    with pytest.raises(InputError, match=r"no\.tif"):
        read_raster(tmp_path / "no.tif")
    size = {"height": 2, "width": 2, "count": 1, "dtype": "float32"}
    place = rasterio.Affine(1.0, 0.0, 5.0, 0.0, -1.0, 7.0)
    with rasterio.open(tmp_path / "bare.tif", "w", driver="GTiff", transform=place, **size) as out:
        out.write(np.zeros((1, 2, 2), dtype=np.float32))
    with pytest.raises(InputError, match="CRS None"):
        read_raster(tmp_path / "bare.tif")
