"""Heights of the area of interest, and its corners in files of a GIS."""

from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pytest
import shapely
import yaml
from pyproj import CRS

from tests.settings.conftest import mistakes_of
from thalweg.core import LocalFrame
from thalweg.settings import load_campaign


@pytest.mark.parametrize(
    ("origin_m", "area"),
    [
        (0, "{frame: map, min_height_m: 140, max_height_m: 144}"),
        (300, "{frame: map, min_height_m: 300.2, max_height_m: 304}"),
        (300, "{min_height_m: 0.15, max_height_m: 4}"),
        (90, "{frame: map, min_height_m: 45}"),
    ],
)
def test_heights_that_fit_either_frame_are_not_doubted(write, origin_m, area):
    """An origin at zero, a mountain of 400 m, or ellipsoidal heights in the frame of the map."""
    campaign = load_campaign(write(f"{{campaign.origin.h_ell_m: {origin_m}, accuracy.area: {area}}}"))
    assert campaign.accuracy.area.min_height_m == yaml.safe_load(area)["min_height_m"]


ORIGIN_EAST_NORTH = np.array([377386.9, 5656838.5])
"""About the origin of the campaign of these tests, EPSG:25833."""


def drawn(path: Path, shapes: list[Any], crs: str | None = "EPSG:25833", **columns: list[str]) -> str:
    gpd.GeoDataFrame(columns, geometry=shapes, crs=crs).to_file(path)
    return path.name


SQUARE = shapely.box(0.0, 0.0, 40.0, 30.0)


def test_a_file_of_a_gis_in_place_of_corners(write, tmp_path, caplog):
    """Each setting of corners by hand takes a file: in degrees, of several polygons one, on the map.

    What the file made us leave out is told.
    """
    frame = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
    corners = np.array([[0.0, 0.0], [40.0, 0.0], [40.0, 30.0], [0.0, 30.0]])
    on_map = frame.to_map(np.column_stack([corners, np.zeros(4)]), CRS("EPSG:25833"))[:, :2]
    area = shapely.Polygon(on_map)
    away = shapely.transform(area, lambda xy: xy + 200.0)
    drawn(tmp_path / "areas.gpkg", [area, away], name=["bank", "meadow"])
    drawn(tmp_path / "weir.shp", [shapely.Point(on_map[1]), None])
    gpd.GeoDataFrame(geometry=[area], crs="EPSG:25833").to_crs(4326).to_file(tmp_path / "area.geojson")
    campaign = load_campaign(
        write("""
            accuracy.area: {polygon: area.geojson}
            deformation.area: {polygon: "areas.gpkg?name=bank", frame: map}
            fusion.fit: {stable: "areas.gpkg?name=meadow"}
            bathymetry.islands: area.geojson
            fusion.weir: weir.shp
        """)
    )

    def same(found, right):
        """The same corners, whichever is first and whichever way round, to the tenth of a millimetre."""
        assert shapely.Polygon(found).symmetric_difference(shapely.Polygon(right)).area < 0.02

    same(campaign.accuracy.area.polygon, corners)
    same(campaign.deformation.area.polygon, on_map)
    assert len(campaign.fusion.fit.stable) == 1
    same(campaign.bathymetry.islands[0], corners)
    np.testing.assert_allclose(campaign.fusion.weir, corners[1], atol=1e-3)
    assert caplog.messages == ["fusion.weir: weir.shp: 1 without a geometry, left out"]


@pytest.mark.parametrize(
    ("shapes", "crs", "answer"),
    [
        ([SQUARE, SQUARE], "EPSG:25833", "2 polygons"),
        ([shapely.LineString([(0, 0), (1, 1)])], "EPSG:25833", "0 polygons"),
        ([SQUARE.difference(shapely.box(5, 5, 9, 9))], "EPSG:25833", "1 holes"),
        (None, None, "file not found"),
    ],
)
def test_a_file_that_does_not_fit_is_a_mistake_of_its_setting(shapes, crs, answer, write, tmp_path):
    if shapes is not None:
        moved = [shapely.transform(s, lambda xy: xy + ORIGIN_EAST_NORTH) for s in shapes]
        drawn(tmp_path / "a.gpkg", moved, crs)
    (told,) = mistakes_of(write("accuracy.area: {polygon: a.gpkg}")).mistakes
    assert told.dotted == "accuracy.area.polygon"
    assert answer in str(told)
    assert told.expected or told.cure
