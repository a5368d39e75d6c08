"""Surface models: files, differences, sigmas of volumes, masks, and published figures of a beach."""

from dataclasses import replace
from datetime import date
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import rasterio
from geopandas import GeoDataFrame
from PIL import Image, TiffImagePlugin
from pyproj import CRS
from rasterio.enums import ColorInterp
from shapely import Polygon

from thalweg.cli import main
from thalweg.core import ArrayF, Dsm, GeometryError, InputError, UnsupportedError, read_dsm, read_table
from thalweg.core.values import Vectors, read_vectors
from thalweg.deformation.foreign import (
    HeightErrors,
    difference_of_surfaces,
    difference_on_lines,
    onto_grid,
    write_difference,
)
from thalweg.deformation.foreign.surfaces import VOLUMES, volume_variance
from thalweg.deformation.m3c2 import ColumnIndex, cut_cylinders, multiscale_normals
from thalweg.deformation.series import closure, find_jumps, fit_series

CORNER = (440_000.0, 5_640_000.0)


def a_tif(
    path: Path,
    height: ArrayF,
    *,
    keys: tuple[int, ...] = (3072, 0, 1, 25833),
    corner: tuple[float, float] = CORNER,
    cell: float = 2.0,
    nodata: str | None = None,
    placed: bool = True,
) -> Path:
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    if placed:
        tags[33550] = (cell, cell, 0.0)
        tags[33922] = (0.0, 0.0, 0.0, *corner, 0.0)
        tags.tagtype[33550] = tags.tagtype[33922] = 12
    tags[34735] = (1, 1, 0, len(keys) // 4, *keys)
    tags.tagtype[34735] = 3
    if nodata is not None:
        tags[42113] = nodata
        tags.tagtype[42113] = 2
    Image.fromarray(np.asarray(height, np.float32)).save(path, tiffinfo=tags)
    return path


def relief(lift: float = 0.0) -> ArrayF:
    """20 x 30 cells between 10 and 13 m."""
    row, col = np.indices((20, 30))
    return 10.0 + 0.1 * col + 0.2 * np.sin(row) + lift


def a_package(path: Path, rings: list[list[tuple[float, float]]], code: int = 25833) -> Path:
    """A GeoPackage with one polygon and its holes."""
    water = GeoDataFrame({"day": [20180727]}, geometry=[Polygon(rings[0], rings[1:])], crs=code)
    water.to_file(path, layer="water")
    return path


# ---------------------------------------------------------------- reading


def test_heights_lie_where_the_file_says(tmp_path):
    height = relief()
    height[3, 4] = -10_000.0
    dsm = read_dsm(a_tif(tmp_path / "a.tif", height))
    assert dsm.frame.to_epsg() == 25833
    assert dsm.notes == (
        "a.tif: 1 of 600 cells without a height (undeclared value -10000).",
        "a.tif: The file states no unit of heights: metres.",
    )
    assert np.isnan(dsm.height_m[3, 4])
    # row 2, column 5: centre at 5.5 cells east and 2.5 cells south of the corner
    assert dsm.centres_m()[2 * 30 + 5].tolist() == [440_011.0, 5_639_995.0]
    assert dsm.at(np.array([[440_011.9, 5_639_994.1]]))[0] == np.float32(relief()[2, 5])
    assert np.isnan(dsm.at(np.array([[439_999.9, 5_639_995.0]]))[0])
    between = dsm.at(np.array([[440_012.5, 5_639_995.0]]), "bilinear")[0]
    assert between == pytest.approx(0.25 * relief()[2, 5] + 0.75 * relief()[2, 6], abs=1e-6)
    point = read_dsm(a_tif(tmp_path / "b.tif", relief(), keys=(1025, 0, 1, 2, 3072, 0, 1, 25833)))
    assert point.corner_m.tolist() == [439_999.0, 5_640_001.0]


def test_declared_and_stated_values_are_no_heights(tmp_path):
    height = relief()
    height[:2], height[5] = 0.0, -99.0
    path = a_tif(tmp_path / "a.tif", height, nodata="-99")
    with pytest.raises(InputError, match=r"60 of 600 cells are exactly 0 m.*--nodata 0 where.*--nodata none"):
        read_dsm(path)
    dsm = read_dsm(path, nodata=0.0)
    assert int(np.isnan(dsm.height_m).sum()) == 90
    assert [note.split("(")[1] for note in dsm.notes[:-1]] == ["declared value -99).", "value 0, as stated)."]
    assert int((read_dsm(path, nodata=np.nan).height_m == 0.0).sum()) == 60


@pytest.mark.parametrize(
    ("keys", "error", "text"),
    [
        ((2048, 0, 1, 4326), UnsupportedError, "cells in degrees"),
        ((1024, 0, 1, 2, 2048, 0, 1, 4258), UnsupportedError, r"cells in degrees.*gdalwarp.*-t_srs EPSG:326"),
        ((3072, 0, 1, 32767), UnsupportedError, "expected one that GDAL knows"),
        ((3072, 0, 1, 25833, 4099, 0, 1, 9101), InputError, "heights in 'radian'"),
    ],
)
def test_coordinates_that_are_no_lengths_are_refused(tmp_path, keys, error, text):
    with pytest.raises(error, match=text):
        read_dsm(a_tif(tmp_path / "a.tif", relief(), keys=keys, corner=(13.0, 51.0), cell=1e-5))


def test_files_that_are_no_heights_are_refused(tmp_path):
    empty, text = tmp_path / "empty.tif", tmp_path / "text.tif"
    empty.write_bytes(b"")
    text.write_text("no raster")
    cut = a_tif(tmp_path / "cut.tif", relief())
    cut.write_bytes(cut.read_bytes()[:1500])
    for path, found in (
        (empty, "the file is empty"),
        (text, "no raster"),
        (cut, "no raster that can be read"),
    ):
        with pytest.raises(InputError, match=found):
            read_dsm(path)
    with pytest.raises(InputError, match="file not found"):
        read_dsm(tmp_path / "none.tif")
    with pytest.raises(InputError, match="no cell has a height"):
        read_dsm(a_tif(tmp_path / "a.tif", np.full((4, 5), -9999.0)))
    with pytest.raises(InputError, match=r"heights from 10 to 20000 m.*--nodata"):
        read_dsm(a_tif(tmp_path / "b.tif", np.array([[10.0, 20_000.0]])))
    with pytest.raises(InputError, match="without a place on the map"):
        read_dsm(a_tif(tmp_path / "c.tif", relief(), placed=False))


def a_gis_tif(path: Path, bands: ArrayF, names: tuple[str, ...] = (), crs: int = 25833, **tags: str) -> Path:
    """A GeoTIFF by GDAL, its last of several bands for opacity."""
    bands = np.asarray(bands, np.float32).reshape(-1, 20, 30)
    corner = {3857: (1_503_000.0, 6_621_000.0)}.get(crs, CORNER)
    how = {"driver": "GTiff", "count": len(bands), "height": 20, "width": 30, "dtype": "float32"}
    place = rasterio.Affine(1.0, 0.0, corner[0], 0.0, -1.0, corner[1])
    with rasterio.open(path, "w", crs=CRS(crs).to_wkt(), transform=place, nodata=-9999.0, **how) as file:
        file.write(bands)
        for k, name in enumerate(names, 1):
            file.set_band_description(k, name)
        file.update_tags(1, **tags)
    if len(bands) > 1:
        with rasterio.open(path, "r+") as file:
            file.colorinterp = [*[ColorInterp.gray] * (len(bands) - 1), ColorInterp.alpha]
    return path


@pytest.mark.parametrize(
    ("names", "tags", "crs", "found"),
    [
        (("Tiefe",), {}, 25833, r"depths \(Tiefe\)"),
        ((), {"NETCDF_VARNAME": "depth"}, 25833, r"depths \(depth\)"),
        ((), {"positive": "Down"}, 25833, r"depths \(positive down\)"),
        ((), {"standard_name": "sea_floor_depth_below_geoid"}, 25833, r"depths \(sea_floor_depth"),
        (("stdev",), {}, 25833, "a band of 'stdev'"),
        (("Slope (degree)",), {}, 25833, r"a band of 'Slope \(degree\)'"),
        # each was read as heights
        (("ELEVATION_ERROR",), {}, 25833, "a band of 'ELEVATION_ERROR'"),
        (("sigma of height (m)",), {}, 25833, "a band of 'sigma of height"),
        ((), {"long_name": "slope of the ground"}, 25833, "a band of 'slope of the ground'"),
        ((), {}, 3857, r"has 1\.5\d m for a metre of ground.*zone of UTM \(EPSG:32633\)"),
        ((), {}, 31468, "expected coordinates in DHDN / 3-degree Gauss-Kruger zone 4"),
    ],
)
def test_bands_and_maps_of_something_else_are_refused(tmp_path, names, tags, crs, found):
    path = a_gis_tif(tmp_path / "a.tif", relief(), names, crs, **tags)
    with pytest.raises((InputError, UnsupportedError), match=found):
        read_dsm(path)
    assert len(read_dsm(a_gis_tif(path, relief(), ("dem slope-corrected",))).points_m()) == 600


def test_numbers_of_colours_are_no_heights_and_a_height_stands_beside_its_error(tmp_path):
    bands = np.stack([relief(), np.full((20, 30), 0.1), np.full((20, 30), 255.0)])
    path = a_gis_tif(tmp_path / "a.tif", bands, ("height", "height_error", "opaque"))
    assert read_dsm(path).height_m == pytest.approx(relief(), abs=1e-5)
    with rasterio.open(tmp_path / "b.tif", "w", driver="GTiff", width=3, height=2, count=1, dtype="uint8",
                       crs=25833, transform=rasterio.Affine(1, 0, 4e5, 0, -1, 5.65e6)) as file:  # fmt: skip
        file.write(np.arange(1, 7, dtype=np.uint8).reshape(1, 2, 3))
        file.write_colormap(1, {k: (k, k, k, 255) for k in range(256)})
    with pytest.raises(UnsupportedError, match="a band of numbers of colours"):
        read_dsm(tmp_path / "b.tif")


def test_what_tags_and_names_of_bands_say_of_heights(tmp_path):
    notes = read_dsm(a_gis_tif(tmp_path / "b.tif", relief(), ("bathymetry",))).notes
    assert "b.tif: Positive values of 'bathymetry' are taken as heights, not as depths." in notes
    dsm = read_dsm(a_gis_tif(tmp_path / "a.tif", relief() / 0.3048, VERTICAL_UNITS="Feet"))
    assert dsm.height_m == pytest.approx(relief(), abs=1e-5)


def test_an_opaque_band_of_any_type_is_a_mask(tmp_path):
    """As gdalwarp -dstalpha makes of a raster of 32-bit numbers, which GDAL itself takes for no mask."""
    bands = np.stack([relief(), np.where(np.arange(20)[:, None] < 4, 0.0, 255.0) * np.ones(30)])
    bands[0, :4] = 35.0 + relief()[:4]
    dsm = read_dsm(a_gis_tif(tmp_path / "a.tif", bands))
    assert np.isnan(dsm.height_m[:4]).all()
    assert np.isfinite(dsm.height_m[4:]).all()
    assert "120 of 600 cells without a height (mask of the file)" in dsm.notes[0]


def test_means_of_heights_and_of_the_value_for_none_are_refused(tmp_path):
    """Resampled before the value was declared; a deep place that no cell without a height is beside stays."""
    height = relief()
    height[:, :4] = -9999.0
    share = np.linspace(0.06, 0.94, 20)
    height[:, 4] = share * -9999.0 + (1 - share) * relief()[:, 4]
    with pytest.raises(
        InputError, match=r"20 cells beside those.*and -9999: means of both.*-srcnodata -9999"
    ):
        read_dsm(a_gis_tif(tmp_path / "a.tif", height))
    height[:, 4] = relief()[:, 4]
    height[10, 20] = -800.0
    assert np.nanmin(read_dsm(a_gis_tif(tmp_path / "b.tif", height)).height_m) == -800.0


# ---------------------------------------------------------------- sigmas of volumes


@pytest.mark.parametrize("correlation", [0.0, 0.7, 5.0, 40.0, np.inf])
def test_the_variance_of_a_volume_is_the_sum_over_all_pairs(correlation):
    rng = np.random.default_rng(1)
    cells = rng.uniform(size=(17, 23)) < 0.4
    cell = np.array([1.5, 0.8])
    row, col = np.nonzero(cells)
    distance = np.hypot((row[:, None] - row) * 0.8, (col[:, None] - col) * 1.5)
    with np.errstate(divide="ignore", invalid="ignore"):
        C = np.where(distance == 0, 1.0, np.exp(-distance / correlation) if correlation else 0.0)
    found = volume_variance(cells, cell, HeightErrors(0.3, correlation))
    assert found == pytest.approx((1.5 * 0.8 * 0.3) ** 2 * C.sum(), rel=1e-10)


def test_a_large_area_has_the_variance_of_rolstad_haug_and_denby():
    """Exponential correlation: sigma^2 2 pi L^2 / A for a mean height; a border takes some of it."""
    cells = np.ones((700, 700), bool)
    cell, length = np.array([1.0, 1.0]), 6.0
    mean = volume_variance(cells, cell, HeightErrors(0.2, length)) / cells.sum() ** 2
    limit = 0.2**2 * 2.0 * np.pi * length**2 / cells.sum()
    assert 0.95 * limit < mean < limit
    # far pairs are left out: against the whole sum of a square with two directions apart
    lag = np.arange(-699, 700)
    pairs = np.outer(700 - np.abs(lag), 700 - np.abs(lag))
    whole = 0.2**2 * (pairs * np.exp(-np.hypot(lag[:, None], lag) / length)).sum() / cells.sum() ** 2
    assert mean == pytest.approx(whole, rel=1e-6)


# ---------------------------------------------------------------- differences


def two(tmp_path: Path) -> tuple[Dsm, Dsm]:
    """Erosion of 0.5 m in 40 cells, deposition of 0.25 m in 20, 0.01 m elsewhere; 30 and 60 cells unseen."""
    before, after = relief(), relief(0.01)
    after[4:8, 10:20] = before[4:8, 10:20] - 0.5
    after[12:14, 5:15] = before[12:14, 5:15] + 0.25
    before[0], after[18:] = -9999.0, -10_000.0
    return read_dsm(a_tif(tmp_path / "a.tif", before)), read_dsm(a_tif(tmp_path / "b.tif", after))


def test_volumes_areas_and_intervals_by_hand(tmp_path):
    before, after = two(tmp_path)
    errors = (HeightErrors(0.03), HeightErrors(0.04))
    found = difference_of_surfaces(before, after, errors, sigma_registration_m=0.02)
    table = found.volumes.set_index("part")
    # cells of 4 m2: 510 seen in both, 40 lowered, 20 raised, 450 raised by a centimetre
    assert table.loc["net", "n_cells"] == 510
    assert table.loc["net", "volume_m3"] == pytest.approx(4 * (450 * 0.01 + 20 * 0.25 - 40 * 0.5), abs=1e-3)
    assert table.loc["erosion", "volume_m3"] == pytest.approx(-80.0, abs=1e-3)
    assert table.loc["deposition", "n_cells"] == 470
    deposition = table.loc["deposition beyond the level of detection"]
    assert deposition.n_cells == 20
    assert deposition.volume_m3 == pytest.approx(20.0, abs=1e-3)
    # independent cells and one offset: (4 m2)^2 (20 * 0.05^2 + (20 * 0.02)^2)
    sigma = 4.0 * np.sqrt(20 * 0.05**2 + (20 * 0.02) ** 2)
    assert deposition.sigma_m3 == pytest.approx(sigma, rel=1e-9)
    assert deposition.high_m3 - deposition.low_m3 == pytest.approx(2 * 1.959964 * sigma, rel=1e-6)
    assert table.loc["not seen in first", "area_m2"] == 4.0 * 30
    assert table.loc["not seen in second", "area_m2"] == 4.0 * 60
    assert np.isnan(table.loc["not seen in second", "volume_m3"])
    assert np.nanmax(found.sigma_m) == pytest.approx(np.sqrt(0.05**2 + 0.02**2))
    bare = difference_of_surfaces(before, after)
    assert "no limits and no intervals" in bare.notes[-1]
    assert bare.volumes["sigma_m3"].isna().all()
    assert "erosion beyond the level of detection" not in set(bare.volumes["part"])


def test_polygons_are_left_out_but_not_their_holes(tmp_path):
    before, after = two(tmp_path)

    def ring(row: int, rows: int, col: int, cols: int) -> list[tuple[float, float]]:
        x, y = CORNER[0] + 2.0 * np.array([col, col + cols]), CORNER[1] - 2.0 * np.array([row, row + rows])
        return [(x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1]), (x[0], y[0])]

    path = a_package(tmp_path / "water.gpkg", [ring(2, 6, 8, 12), ring(4, 2, 10, 3)])
    water = read_vectors(path, where={"day": "20180727"})
    found = difference_of_surfaces(before, after, leave_out=[water])
    table = found.volumes.set_index("part")
    assert table.loc["left out", "n_cells"] == 6 * 12 - 2 * 3
    assert table.loc["erosion", "n_cells"] == 6  # rows 4-5, columns 10-12 stand in the hole
    with pytest.raises(InputError, match="nothing that is drawn with day=1"):
        read_vectors(path, where={"day": "1"})
    with pytest.raises(InputError, match="no column place; expected one of day"):
        read_vectors(path, where={"place": "1"})
    with pytest.raises(InputError, match="no format of a map"):
        read_vectors(before.path)
    # the same water on another map, and one that lies elsewhere
    water.table.to_crs(32632).to_file(tmp_path / "other.gpkg")
    other = difference_of_surfaces(before, after, leave_out=[read_vectors(tmp_path / "other.gpkg")])
    assert other.volumes["n_cells"].tolist() == found.volumes["n_cells"].tolist()
    away = read_vectors(a_package(tmp_path / "away.gpkg", [[(0, 0), (1, 0), (1, 1)]]))
    assert any(
        "No cell lies in" in note for note in difference_of_surfaces(before, after, leave_out=[away]).notes
    )


def test_rasters_that_do_not_fit_are_refused(tmp_path):
    before, _ = two(tmp_path)

    def after(height: ArrayF, **how: object) -> Dsm:
        return read_dsm(a_tif(tmp_path / "c.tif", height, **how))

    with pytest.raises(InputError, match=r"UTM zone 33N.*UTM zone 32N.*one coordinate system"):
        difference_of_surfaces(before, after(relief(), keys=(3072, 0, 1, 25832)))
    vertical = [replace(before, frame=CRS(f"EPSG:25833+{code}")) for code in (7837, 5773)]
    with pytest.raises(InputError, match=r"heights of DHHN2016 height.*of EGM96 height"):
        difference_of_surfaces(*vertical)
    with pytest.raises(GeometryError, match="share no cell"):
        difference_of_surfaces(before, after(relief(), corner=(450_000.0, 5_640_000.0)))
    with pytest.raises(InputError, match=r"rise 3.28 times.*look like feet: export metres"):
        difference_of_surfaces(before, after(relief() / 0.3048))
    shifted = after(relief(), corner=(CORNER[0] + 0.5, CORNER[1]))
    with pytest.raises(InputError, match=r"another grid.*--resample"):
        difference_of_surfaces(before, shifted)
    found = difference_of_surfaces(before, shifted, resample="bilinear")
    beside = difference_of_surfaces(before, after(relief(), corner=(CORNER[0] + 10.0, CORNER[1])))
    assert "400.0 m2 of the second raster lie beyond the first and are in no part." in beside.notes
    # the slope of 0.05 along east, a quarter of a cell away
    assert np.nanmedian(found.raster.height_m) == pytest.approx(-0.025, abs=1e-5)
    assert "up to 0.500 m away" in found.notes[-2]
    holes = np.full((20, 30), -9999.0)
    holes[0] = 10.0
    with pytest.raises(GeometryError, match="no cell has a height in both"):
        difference_of_surfaces(before, after(holes))


def test_the_command_writes_bands_and_volumes(tmp_path, capsys):
    before, after = two(tmp_path)
    words = ["compare-clouds", str(before.path), str(after.path), "--sigma-a", "0.03", "--sigma-b", "0.04"]
    out = tmp_path / "changes.tif"
    assert main([*words, "-o", str(out)]) == 0
    assert "note: No --correlation-m is stated: errors of cells count as" in capsys.readouterr().out
    assert main([*words, "--correlation", "4", "-o", str(out), "--force"]) == 0
    printed = capsys.readouterr().out
    assert "errors of cells count" not in printed
    assert "600 cells, 510 with a difference" in printed
    assert "  erosion: 160.0 m2, -80.0 m3 (sigma " in printed
    assert "note: a.tif: 30 of 600 cells without a height (undeclared value -9999)." in printed
    with rasterio.open(out) as file:
        bands, crs, place = file.read(), file.crs, file.transform
        assert file.descriptions == ("difference_m", "sigma_m")
    found = difference_of_surfaces(before, after, (HeightErrors(0.03, 4.0), HeightErrors(0.04, 4.0)))
    np.testing.assert_array_equal(bands[0], found.raster.height_m.astype(np.float32))
    np.testing.assert_array_equal(bands[1], found.sigma_m.astype(np.float32))
    assert (crs.to_epsg(), place.c, place.f, place.e) == (25833, *CORNER, -2.0)
    for suffix in ("csv", "parquet"):
        assert main([*words, "--correlation", "4", "-o", str(tmp_path / f"changes.{suffix}")]) == 0
    table, _ = read_table(tmp_path / "changes.parquet", VOLUMES)
    assert table["sigma_m3"].to_numpy() == pytest.approx(found.volumes["sigma_m3"].to_numpy(), nan_ok=True)
    capsys.readouterr()
    assert main([*words[:2], str(tmp_path / "b.laz"), "-o", str(out), "--force"]) == 2
    assert "two clouds or two surface models" in capsys.readouterr().err
    with pytest.raises(InputError, match="suffix"):
        write_difference(tmp_path / "changes.laz", found)


# ---------------------------------------------------------------- figures of others on a real beach

DAYS = (
    "20180601",
    "20180621",
    "20180727",
    "20180925",
    "20181113",
    "20181211",
    "20190205",
    "20190313",
    "20190516",
)
LIMITS_M = np.array([0.030544, 0.049026, 0.028770, 0.091381, 0.098746, 0.078057, 0.044897, 0.097589])
"""Published by sandpyper: NMAD on stable transects between consecutive epochs."""


@pytest.fixture(scope="module")
def beach(data_dir):
    return data_dir / "sandpyper_dsm"


@pytest.fixture(scope="module")
def epochs(beach):
    return [read_dsm(beach / f"dsm_1m/mar_{day}_dsm_resampled_1m.tif") for day in DAYS]


@pytest.mark.real
def test_the_undeclared_value_of_the_beach_is_masked_and_counted(epochs):
    assert epochs[2].notes == (
        "mar_20180727_dsm_resampled_1m.tif: 30,739 of 141,780 cells without a height "
        "(undeclared value -10000).",
        "mar_20180727_dsm_resampled_1m.tif: The file states no unit of heights: metres.",
    )
    assert len(epochs[2].points_m()) == 111_041
    assert len(epochs[3].points_m()) == 83_438


@pytest.mark.real
def test_the_published_limits_of_all_eight_steps(beach, epochs):
    """sandpyper rounds places in units of cells, so that it reads half a cell too far south-east."""
    lines = read_vectors(beach / "lod_transects/mar_lod_transects.gpkg")
    theirs = [replace(each, corner_m=each.corner_m + each.cell_m * (-0.5, 0.5)) for each in epochs]
    found = [difference_on_lines(a, b, lines) for a, b in pairwise(theirs)]
    # 6 digits of numbers that it computed with 32 bits
    assert [each.nmad_m for each in found] == pytest.approx(LIMITS_M, abs=1e-6)
    assert [each.n for each in found] == [93] * 6 + [66] * 2
    own = [difference_on_lines(a, b, lines) for a, b in pairwise(epochs)]
    expected = [0.025530, 0.036676, 0.021320, 0.041880, 0.061493, 0.042446, 0.045846, 0.067879]
    assert [each.nmad_m for each in own] == pytest.approx(expected, abs=1e-6)
    # stable ground of the last step has sunk by 0.2 m: an offset that no spread tells
    assert own[-1].median_m == pytest.approx(-0.2031, abs=1e-4)
    assert max(abs(each.median_m) for each in own[:-1]) < 0.041


OFFSET_M = np.array([731_360.0, 5_705_142.0, 0.0])


@pytest.mark.real
@pytest.mark.parametrize(
    ("normal", "valid", "mean", "median", "std", "limit", "significant"),
    [
        ("fitted", 15_478, -0.036014, -0.073303, 0.748454, 0.091365, 10_162),
        ("up", 15_454, -0.042674, -0.073847, 0.732868, 0.107381, 9_517),
    ],
)
def test_distances_of_py4dgeo_on_the_beach(epochs, normal, valid, mean, median, std, limit, significant):
    """Every 5th point, normals at 3 m, cylinders of 2 m; its limit adds the registration error linearly."""
    before, after = (each.points_m() - OFFSET_M for each in epochs[2:4])
    cores = before[::5]
    assert len(cores) == 22_209
    indices = [ColumnIndex.of(each, 2.0) for each in (before, after)]
    normals = np.tile([0.0, 0.0, 1.0], (len(cores), 1))
    if normal == "fitted":
        normals, _ = multiscale_normals(cores, indices[0], (3.0,), towards=normals[0])
    cuts = [
        cut_cylinders(cores, normals, each, radius_m=2.0, half_length_m=10.0, least=1) for each in indices
    ]
    distance = cuts[1].along_m - cuts[0].along_m
    known = distance[np.isfinite(distance)]
    assert len(known) == valid
    assert [known.mean(), np.median(known), known.std()] == pytest.approx([mean, median, std], abs=1e-6)
    # single points have no spread, and no limit
    limits = 1.96 * (np.sqrt(sum(cut.std_m**2 / cut.n for cut in cuts)) + LIMITS_M[2])
    assert np.nanmedian(limits) == pytest.approx(limit, abs=1e-6)
    assert int((np.abs(distance) > limits).sum()) == significant


@pytest.fixture(scope="module")
def stack(epochs):
    return np.array([onto_grid(each, epochs[0], "nearest")[0].height_m.ravel() for each in epochs])


@pytest.fixture(scope="module")
def dry(beach, epochs, stack):
    """Without the water of each day."""
    heights = stack.copy()
    for each, day in zip(heights, DAYS, strict=True):
        each[waters(beach, day).contain(epochs[0].centres_m())] = np.nan
    return heights


def waters(beach: Path, day: str) -> Vectors:
    return read_vectors(beach / "clean/watermasks.gpkg", where={"location": "mar", "raw_date": day})


@pytest.mark.real
def test_the_series_of_nine_epochs(epochs, stack):
    with pytest.raises(InputError, match="another grid"):
        onto_grid(epochs[1], epochs[0])
    seen = stack[:, np.isfinite(stack).all(axis=0)]
    assert seen.shape == (9, 38_484)
    heights = np.diff(seen, axis=0).sum(axis=1)
    # published with cells of 1 m2; those of the file have 1.0020 m2
    expected = [-2657.7, 4401.0, -4751.4, 3019.5, 2118.8, -1520.0, 23441.1, -26772.3]
    assert heights == pytest.approx(expected, abs=0.051)
    assert heights.sum() == pytest.approx(-2721.1, abs=0.051)
    assert epochs[0].cell_area_m2 == pytest.approx(1.002021, abs=1e-6)
    closed = closure(np.diff(stack, axis=0), stack[-1] - stack[0])
    assert closed.n == 38_484
    assert closed.largest_m < 1e-12
    # each pair over what it shares: the changes no longer add up
    pairs = [np.nansum(step) for step in np.diff(stack, axis=0)]
    left = (sum(pairs) - np.nansum(stack[-1] - stack[0])) * epochs[0].cell_area_m2
    assert left == pytest.approx(12_289.0, abs=1.0)


@pytest.mark.real
def test_the_epoch_that_jumps_and_returns_is_flagged(stack, dry):
    jumps = find_jumps(stack, LIMITS_M)
    assert [DAYS[jump.epoch] for jump in jumps if jump.flagged] == ["20190313"]
    assert jumps[6].before_m == pytest.approx(0.27, abs=0.005)
    assert jumps[6].after_m == pytest.approx(-0.35, abs=0.005)
    # water of each epoch left out: it is still there, but smaller
    jumps = find_jumps(dry, LIMITS_M)
    assert [DAYS[jump.epoch] for jump in jumps if jump.flagged] == ["20190313"]
    assert jumps[6].before_m == pytest.approx(0.149, abs=0.005)


@pytest.mark.real
def test_trends_of_the_beach_with_errors_that_epochs_have_in_common(dry):
    t_a = np.array([date.fromisoformat(f"{d[:4]}-{d[4:6]}-{d[6:]}").toordinal() for d in DAYS]) / 365.25
    seen = dry[:, np.isfinite(dry).all(axis=0)]
    assert seen.shape == (9, 25_794)
    table = fit_series(t_a, seen, np.full(9, 0.02), np.eye(9) * 0.03**2)
    # by hand: white in time, so that the trend's variance is (0.02^2 + 0.03^2) / sum (t - mean)^2
    spread = np.sqrt(((t_a - t_a.mean()) ** 2).sum())
    assert table["sigma_trend_m_a"].to_numpy() == pytest.approx(np.hypot(0.02, 0.03) / spread, rel=1e-9)
    assert table["sigma_trend_common_m_a"].to_numpy() == pytest.approx(0.03 / spread, rel=1e-9)
    assert table["trend_m_a"].median() == pytest.approx(-0.047, abs=0.002)
    assert table["chi2_trend"].median() == pytest.approx(240.0, abs=5.0)  # 7 degrees of freedom
    others = np.arange(9) != 7
    table = fit_series(t_a[others], seen[others], np.full(8, 0.02), np.eye(8) * 0.03**2)
    assert table["trend_m_a"].median() == pytest.approx(-0.156, abs=0.002)


@pytest.mark.real
def test_volumes_of_the_beach_without_water(beach, epochs):
    before, after = epochs[2:4]
    errors = (HeightErrors(0.0213 / np.sqrt(2.0), 20.0),) * 2
    dry = [waters(beach, day) for day in DAYS[2:4]]
    for water, n, net, sigma in (([], 76_408, -3643.6, 262.7), (dry, 45_498, 6668.8, 192.2)):
        row = difference_of_surfaces(before, after, errors, leave_out=water).volumes.loc[0]
        assert row.n_cells == n
        assert (row.volume_m3, row.sigma_m3) == pytest.approx((net, sigma), abs=0.05)
