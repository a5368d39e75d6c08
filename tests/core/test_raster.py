"""Rasters: cells, names of bands, same bytes, refused files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
from numpy.testing import assert_allclose, assert_array_equal
from pyproj import CRS

from thalweg.core import (
    Dsm,
    GeometryError,
    Grid,
    InputError,
    UnsupportedError,
    read_dsm,
    read_raster,
    write_raster,
)
from thalweg.ingest.registry import recognise

UTM = CRS("EPSG:25833")


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")  # of affine, inside rasterio
def test_written_read_and_read_by_others(tmp_path):
    grid = Grid.around(np.array([[10.2, 20.1], [14.9, 23.0]]), 0.5, UTM, margin_m=1.0)
    height = np.arange(grid.rows * grid.columns, dtype=float)
    height[7] = np.nan
    write_raster(tmp_path / "a.tif", grid, {"height_m": height, "sigma_m": height / 10}, tags={"kind": "bed"})
    again, bands, tags = read_raster(tmp_path / "a.tif")
    assert again == grid
    assert tags["kind"] == "bed"
    assert_array_equal(bands["height_m"].ravel(), height)
    with rasterio.open(tmp_path / "a.tif") as file:
        assert file.descriptions == ("height_m", "sigma_m")
        assert file.crs.to_epsg() == 25833
        places = grid.centres_m()
        found = np.array([v[0] for v in file.sample(places[:20].tolist())])
    assert_array_equal(found, height[:20].astype(np.float32))
    write_raster(tmp_path / "b.tif", grid, {"height_m": height, "sigma_m": height / 10}, tags={"kind": "bed"})
    assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "b.tif").read_bytes()


def test_cells_of_places():
    grid = Grid(west_m=10.0, north_m=30.0, cell_m=2.0, rows=3, columns=4, crs=UTM)
    row, column = grid.at(np.array([[10.5, 29.5], [17.9, 24.1], [9.9, 29.0], [12.0, 23.9]]))
    assert row.tolist() == [0, 2, -1, -1]
    assert column.tolist() == [0, 3, -1, -1]
    assert_array_equal(grid.at(grid.centres_m())[0], np.repeat([0, 1, 2], 4))
    around = Grid.around(np.array([[11.0, 21.5], [16.5, 29.0]]), 2.0, UTM, margin_m=0.5)
    assert around == Grid(west_m=10.0, north_m=30.0, cell_m=2.0, rows=5, columns=4, crs=UTM)


def test_a_raster_of_thousands_of_millions_of_cells_is_refused(tmp_path):
    """Of which the file holds none: some kilobytes, and 14 GB as numbers."""
    path = tmp_path / "sparse.tif"
    place = rasterio.Affine(1.0, 0.0, 400_000.0, 0.0, -1.0, 5_600_000.0)
    size = {"height": 60_000, "width": 60_000, "count": 1, "dtype": "float32", "tiled": True, "nodata": -9999}
    rasterio.open(path, "w", driver="GTiff", transform=place, crs=UTM, sparse_ok=True, **size).close()
    for read in (read_raster, read_dsm):
        with pytest.raises(InputError, match=r"60,000 by 60,000 cells; expected at most 400 million at once"):
            read(path)
    assert recognise(path) == "geotiff"  # a BigTIFF


def test_bad_rasters_are_named(tmp_path):
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


# ---------------------------------------------------------------- rasters of heights


def test_cells_of_a_raster_of_heights_by_hand():
    """Two rows, three columns, 2 m wide and 3 m high; one cell without a height."""
    dsm = Dsm(
        height_m=np.array([[1.0, 2.0, 4.0], [3.0, np.nan, 8.0]]),
        corner_m=np.array([100.0, 50.0]),
        cell_m=np.array([2.0, 3.0]),
        frame=UTM,
        path=Path("a.tif"),
    )
    assert dsm.cell_area_m2 == 6.0
    centres = [[101, 48.5], [103, 48.5], [105, 48.5], [101, 45.5], [103, 45.5], [105, 45.5]]
    assert dsm.centres_m().tolist() == centres
    assert dsm.points_m().tolist() == [
        [101, 48.5, 1], [103, 48.5, 2], [105, 48.5, 4], [101, 45.5, 3], [105, 45.5, 8],
    ]  # fmt: skip
    mesh = dsm.mesh(0.02)
    assert mesh.faces.tolist() == [[0, 3, 1]]  # the other three have the cell without a height
    assert mesh.face_normals()[0][2] > 0
    assert mesh.sigma_m.tolist() == [0.02] * 5
    assert dsm.mesh().sigma_m.max() == 0.0
    assert dsm.places(np.array([[101.0, 48.5], [105.0, 45.5], [102.0, 47.0]])).tolist() == [
        [0, 0], [1, 2], [0.5, 0.5],
    ]  # fmt: skip
    within = np.array([[100.1, 47.1], [105.9, 44.1], [103.0, 46.9], [101.9, 49.9]])
    assert_array_equal(dsm.at(within), [1, 8, np.nan, 1])
    beside = np.array([[99.9, 48.5], [106.1, 48.5], [101.0, 50.1], [101.0, 43.9]])
    assert np.isnan(dsm.at(beside)).all()
    places = np.array([[102.0, 48.5], [104.5, 48.5], [101.0, 47.75], [100.5, 48.5]])
    assert np.isnan(dsm.at(places, "bilinear")).all()  # beside the cell without a height
    whole = replace(dsm, height_m=np.array([[1.0, 2.0, 4.0], [3.0, 5.0, 8.0]]))
    assert_allclose(whole.at(places, "bilinear"), [1.5, 3.5, 1.5, np.nan])


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")
def test_a_bed_of_this_pipeline_is_read_with_its_sigmas_and_heights(tmp_path):
    """Also its exact zeros, of which others have none; sigmas only where there is a height."""
    grid = Grid(west_m=400_000.0, north_m=5_600_000.0, cell_m=0.5, rows=3, columns=5, crs=UTM)
    height, sigma = np.zeros((3, 5)), np.arange(15.0).reshape(3, 5)
    height[1, 2] = np.nan
    path = tmp_path / "bed.tif"

    def written(**tags):
        bands = {"height_m": height, "sigma_m": sigma, "sigma_common_m": 2 * sigma}
        write_raster(path, grid, bands, tags=tags)
        return read_dsm(path)

    dsm = written(heights="EPSG:7837")
    assert_array_equal(dsm.height_m, height)
    for found, factor in ((dsm.sigma_m, 1), (dsm.common_m, 2)):
        assert_array_equal(found, np.where(np.isfinite(height), factor * sigma, np.nan))
    assert dsm.frame.name == "ETRS89 / UTM zone 33N + DHHN2016 height"
    assert [part.to_epsg() for part in dsm.frame.sub_crs_list] == [25833, 7837]
    assert (dsm.corner_m.tolist(), dsm.cell_m.tolist()) == ([400_000.0, 5_600_000.0], [0.5, 0.5])
    assert written(heights="ellipsoidal (GRS 80)").frame == UTM.to_3d() == written().frame
    with pytest.raises(UnsupportedError, match="heights 'Elbe'; expected a height system that PROJ knows"):
        written(heights="Elbe")


@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")
@pytest.mark.parametrize("east", [1, -1])
@pytest.mark.parametrize("north", [1, -1])
@pytest.mark.parametrize("code", [25833, 2263])
def test_rows_and_columns_may_run_either_way(tmp_path, east, north, code):
    """Heights lie where they lie; a map in US survey feet comes into metres with its corners and cells."""
    path = tmp_path / "a.tif"
    heights = np.array([[11.5, 12.5, 13.5], [21.5, 22.5, 23.5]])[::north, ::east]
    west, top = (400_000.0, 5_650_000.0) if code == 25833 else (1_000_000.0, 200_000.0)
    place = rasterio.Affine(
        2.0 * east, 0.0, west if east > 0 else west + 6.0, 0.0, -3.0 * north, top if north > 0 else top - 6.0
    )
    kind = {"driver": "GTiff", "height": 2, "width": 3, "count": 1, "dtype": "float32"}
    with rasterio.open(path, "w", crs=CRS.from_epsg(code).to_wkt(), transform=place, **kind) as file:
        file.write(np.ascontiguousarray(heights).astype(np.float32), 1)
    found = read_dsm(path)
    unit = 1.0 if code == 25833 else 1200 / 3937
    assert_allclose(found.corner_m, np.array([west, top]) * unit, rtol=1e-12)
    assert_allclose(found.cell_m, np.array([2.0, 3.0]) * unit, rtol=1e-9)
    assert_array_equal(found.height_m, [[11.5, 12.5, 13.5], [21.5, 22.5, 23.5]])


@pytest.mark.parametrize(
    ("stated", "metres"), [("METERS", 1.0), ("NO", 1.0), ("FEET", 0.3048), ("Feet", 0.3048)]
)
def test_heights_have_the_unit_of_an_old_prj(tmp_path, stated, metres):
    """Arc/Info states the unit of heights in a line of the .prj, which GDAL passes over."""
    path = tmp_path / "a.asc"
    path.write_text(
        "ncols 2\nnrows 2\nxllcorner 400000\nyllcorner 5650000\ncellsize 1\n101.5 102.5\n103.5 104.5\n"
    )
    path.with_suffix(".prj").write_text(
        f"Projection  UTM\nZone  33\nDatum  WGS84\nZunits  {stated}\nUnits  METERS\nParameters\n"
    )
    assert_allclose(read_dsm(path).height_m, np.array([[101.5, 102.5], [103.5, 104.5]]) * metres, rtol=1e-6)
