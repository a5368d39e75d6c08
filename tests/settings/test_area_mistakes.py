"""Mistakes in the area of interest, and in what is made of the reference."""

from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pytest
import shapely
from pyproj import CRS

from thalweg.core import LocalFrame
from thalweg.settings.load import load_campaign
from thalweg.settings.messages import CampaignError

TABLE: list[tuple[dict[str, Any], str, tuple[str, ...]]] = [
    (
        {"accuracy.area": {"polygon": [[0, 0], [1, 1], [2, 2]]}},
        "accuracy.area.polygon",
        ("enclose no area", "not on one line"),
    ),
    (
        {"accuracy.area": {"polygon": [[377000, 5656000], [377100, 5656000], [377100, 5656100]]}},
        "accuracy.area.polygon[0]",
        ("km from campaign.origin", "write frame: map"),
    ),
    (
        {"accuracy.area": {"frame": "map", "polygon": [[0, 0], [100, 0], [100, 100]]}},
        "accuracy.area.polygon[0]",
        ("in EPSG:25833", "write frame: local"),
    ),
    (
        {
            "accuracy.area": {
                "frame": "map",
                "polygon": [[5656700, 377300], [5656800, 377300], [5656800, 377400]],
            }
        },
        "accuracy.area.polygon[0]",
        ("km from campaign.origin", "East comes first: swap"),
    ),
    (
        {"accuracy.area": {"min_height_m": 5, "max_height_m": 5}},
        "accuracy.area",
        ("min_height_m 5 is not below max_height_m 5",),
    ),
    (
        {"accuracy.area": {"polygon": [[0, 0], [4, 4], [4, 0], [0, 4]]}},
        "accuracy.area.polygon",
        ("corner 1 to 2", "corner 3 to 4", "cross", "in their order along the outline"),
    ),
    (
        {"accuracy.area": {"polygon": [[0, 0], [1, 1]]}},
        "accuracy.area.polygon",
        ("found 2 values", "a list of 3 to 10000 values", "Write at least 3 values"),
    ),
    (
        {"accuracy.area": {"frame": "map", "min_height_m": 0.15, "max_height_m": 4}},
        "accuracy.area.max_height_m",
        ("found 4, with frame: map and an origin at 300 m", "near 300", "Then write frame: local"),
    ),
    (
        {"accuracy.area": {"min_height_m": 301}},
        "accuracy.area.min_height_m",
        ("found 301, with frame: local", "above campaign.origin", "Then write frame: map"),
    ),
    (
        {"accuracy.area": {"polygon": [[0, 0], [9, 0], [9, 9]], "max_height_m": 304}},
        "accuracy.area.max_height_m",
        ("frame of the polygon, local",),
    ),
    (
        {"reference": {"cell_m": 1.0, "longest_edge_m": 0.1}},
        "reference",
        ("longest_edge_m 0.1 is below 1.5 times cell_m 1", "no triangle"),
    ),
    (
        {"accuracy.sections": {"stations_m": []}},
        "accuracy.sections.stations_m",
        ("found 0 values", "a list of 1 to 12 values", "at least one value"),
    ),
    (
        {"accuracy.sections": {"stations_m": list(range(13))}},
        "accuracy.sections.stations_m",
        ("found 13 values", "at most 12"),
    ),
]


@pytest.mark.parametrize(("changes", "path", "fragments"), TABLE, ids=[str(r[0]) for r in TABLE])
def test_message_names_place_and_cure(changes, path, fragments, write):
    with pytest.raises(CampaignError) as caught:
        load_campaign(write(changes))
    told = [m for m in caught.value.mistakes if m.dotted == path]
    assert told, f"no mistake at {path!r} in:\n{caught.value}"
    for fragment in fragments:
        assert fragment in str(told[0])
    assert told[0].cure


def test_heights_that_fit_either_frame_are_not_doubted(write):
    """An origin at zero, a mountain of 400 m, or ellipsoidal heights in the frame of the map."""
    for origin_m, area in (
        (0, {"frame": "map", "min_height_m": 140, "max_height_m": 144}),
        (300, {"frame": "map", "min_height_m": 300.2, "max_height_m": 304}),
        (300, {"min_height_m": 0.15, "max_height_m": 4}),
        (90, {"frame": "map", "min_height_m": 45}),
    ):
        campaign = load_campaign(write({"campaign.origin.h_ell_m": origin_m, "accuracy.area": area}))
        assert campaign.accuracy.area.min_height_m == area["min_height_m"]


ORIGIN_EAST_NORTH = np.array([377386.9, 5656838.5])
"""About the origin of the campaign of these tests, EPSG:25833."""


def drawn(path: Path, shapes: list[Any], crs: str | None = "EPSG:25833", **columns: list[str]) -> str:
    gpd.GeoDataFrame(columns, geometry=shapes, crs=crs).to_file(path)
    return path.name


SQUARE = shapely.box(0.0, 0.0, 40.0, 30.0)


def test_a_file_of_a_gis_in_place_of_corners(write, tmp_path):
    """Each setting of corners by hand takes a file: in degrees, of several polygons one, on the map."""
    frame = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
    corners = np.array([[0.0, 0.0], [40.0, 0.0], [40.0, 30.0], [0.0, 30.0]])
    on_map = frame.to_map(np.column_stack([corners, np.zeros(4)]), CRS("EPSG:25833"))[:, :2]
    area = shapely.Polygon(on_map)
    away = shapely.transform(area, lambda xy: xy + 200.0)
    drawn(tmp_path / "areas.gpkg", [area, away], name=["bank", "meadow"])
    drawn(tmp_path / "weir.shp", [shapely.Point(on_map[1])])
    gpd.GeoDataFrame(geometry=[area], crs="EPSG:25833").to_crs(4326).to_file(tmp_path / "area.geojson")
    path = write(
        {
            "accuracy.area": {"polygon": "area.geojson"},
            "deformation.area": {"polygon": "areas.gpkg?name=bank", "frame": "map"},
            "fusion.fit": {"stable": "areas.gpkg?name=meadow"},
            "bathymetry.islands": "area.geojson",
            "fusion.weir": "weir.shp",
        }
    )
    campaign = load_campaign(path)

    def same(found, right):
        """The same corners, whichever is first and whichever way round, to the tenth of a millimetre."""
        assert shapely.Polygon(found).symmetric_difference(shapely.Polygon(right)).area < 0.02

    same(campaign.accuracy.area.polygon, corners)
    same(campaign.deformation.area.polygon, on_map)
    assert len(campaign.fusion.fit.stable) == 1
    same(campaign.bathymetry.islands[0], corners)
    np.testing.assert_allclose(campaign.fusion.weir, corners[1], atol=1e-3)


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
    with pytest.raises(CampaignError) as caught:
        load_campaign(write({"accuracy.area": {"polygon": "a.gpkg"}}))
    (told,) = caught.value.mistakes
    assert told.dotted == "accuracy.area.polygon"
    assert answer in str(told)
    assert told.expected or told.cure
