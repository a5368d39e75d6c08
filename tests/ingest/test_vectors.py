"""The same lines and areas in every format of a GIS; what is broken is refused with a sentence."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import shapely
from geopandas import GeoDataFrame
from pyproj import CRS

from thalweg.bathymetry import read_bank_lines, read_banks, read_islands, read_line
from thalweg.core import InputError, LocalFrame
from thalweg.core.values import describe_layers, read_vectors
from thalweg.ingest import read_places
from thalweg.ingest.registry import describe

MAP = CRS.from_epsg(25833)
EAST_M, NORTH_M = 400_000.0, 5_600_000.0
LEFT = np.array([[0.0, 20.0, 101.0], [50.0, 22.0, 101.0], [100.0, 20.0, 101.0]])
RIGHT = LEFT - (0.0, 20.0, 0.5)
ISLAND = np.array([[40.0, 8.0], [60.0, 8.0], [60.0, 12.0], [40.0, 12.0]])
HOLE = np.array([[45.0, 9.0], [46.0, 9.0], [46.0, 10.0]])


def placed(corners: np.ndarray) -> np.ndarray:
    """Corners on the map."""
    return corners + ([EAST_M, NORTH_M, 0.0][: corners.shape[1]])


BANKS = GeoDataFrame(
    {"side": ["left", "right"]},
    geometry=[shapely.LineString(placed(each)) for each in (LEFT, RIGHT)],
    crs=MAP,
)
ISLANDS = GeoDataFrame({"name": ["a"]}, geometry=[shapely.Polygon(placed(ISLAND), [placed(HOLE)])], crs=MAP)
WGS84 = CRS.from_epsg(4326)
# DXF has layers instead of properties; KML knows degrees alone
WRITTEN: dict[str, Callable[[GeoDataFrame, Path], None]] = {
    "old.geojson": lambda table, path: table.to_file(path),
    "new.geojson": lambda table, path: table.to_crs(WGS84).to_file(
        path, RFC7946="YES", COORDINATE_PRECISION=12
    ),
    "a.shp": lambda table, path: table.to_file(path),
    "a.gpkg": lambda table, path: table.to_crs(25832).to_file(path),
    "a.fgb": lambda table, path: table.to_file(path, driver="FlatGeobuf", SPATIAL_INDEX="NO"),
    "a.gml": lambda table, path: table.to_file(path, driver="GML"),
    "a.kml": lambda table, path: table.to_crs(WGS84).to_file(path, driver="LIBKML"),
    "a.dxf": lambda table, path: (
        table.rename(columns={"side": "Layer"}).filter(["Layer", "geometry"]).to_file(path, driver="DXF")
    ),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_the_same_lines_in_every_format(tmp_path, name):
    path, water = tmp_path / name, tmp_path / f"islands_{name}"
    WRITTEN[name](BANKS, path)
    WRITTEN[name](ISLANDS, water)
    files = set(tmp_path.iterdir())
    for side, corners in zip(("left", "right"), (LEFT, RIGHT), strict=True):
        (found,) = [xyz for xyz, of in read_vectors(path).on_map(MAP).lines() if side in of.values()]
        assert found == pytest.approx(placed(corners), abs=1e-6)
    notes: list[str] = []
    banks, _ = read_bank_lines(path, MAP, None, None, (np.empty((0, 2)), np.empty(0)), notes)
    of = banks.table[banks.table["side"] == "left"]
    assert of["north_m"].max() == pytest.approx(NORTH_M + 22.0, abs=1e-2)
    # states no map, states another one, heights that GDAL writes without altitudeMode
    assert len(notes) == (name in {"a.dxf", "a.gpkg", "a.kml"})
    # the left bank lies to the left: downstream is east
    assert banks.line.points_m[-1, 0] > banks.line.points_m[0, 0]
    (outline,) = read_islands(water, MAP)
    shape = shapely.Polygon(outline)
    assert shape.area == pytest.approx(80.0, abs=1e-3)
    assert shapely.Point(outline[0]).distance(shapely.LineString(ISLANDS.geometry[0].exterior)) < 1e-6
    inside = (
        read_vectors(water).on_map(MAP).contain(placed(np.array([[50.0, 10.0], [45.8, 9.3], [0.0, 0.0]])))
    )
    assert inside.tolist() == [True, False, False]
    # nothing is written beside files of others
    assert set(tmp_path.iterdir()) == files


def test_a_closed_line_of_a_drawing_is_an_area(tmp_path):
    ring = ISLANDS.set_geometry(ISLANDS.exterior)[["geometry"]]
    ring.to_file(tmp_path / "a.dxf", driver="DXF")
    assert shapely.Polygon(read_islands(tmp_path / "a.dxf", MAP)[0]).area == pytest.approx(80.0, abs=1e-6)


def test_a_campaign_takes_any_of_them(tmp_path):
    frame = LocalFrame(lat_deg=50.5, lon_deg=13.6, h_ell_m=100.0)
    BANKS.to_file(tmp_path / "old.geojson")
    BANKS.to_crs(WGS84).to_file(tmp_path / "a.kml", driver="LIBKML")
    BANKS.assign(SIDE=["Left ", "Right"], sigma_m=0.2).drop(columns="side").to_file(tmp_path / "a.shp")
    one, *others = (read_banks(tmp_path / name, frame, MAP) for name in ("old.geojson", "a.kml", "a.shp"))
    for other in others:
        assert other[["east_m", "north_m"]].to_numpy() == pytest.approx(
            one[["east_m", "north_m"]].to_numpy(), abs=1e-6
        )
        assert other["side"].tolist() == one["side"].tolist()
    assert one["sigma_across_m"].unique().tolist() == [0.5]
    assert others[1]["sigma_across_m"].unique().tolist() == [0.2]
    BANKS[:1].to_crs(WGS84).to_file(tmp_path / "line.gpkg")
    (tmp_path / "line.csv").write_text("x,y\n" + "\n".join(f"{x},{y}" for x, y, _ in placed(LEFT)))
    lines = [read_line(tmp_path / f"line.{end}", MAP, frame=frame) for end in ("csv", "gpkg")]
    assert lines[1].points_m == pytest.approx(lines[0].points_m, abs=1e-6)
    with pytest.raises(InputError, match="a centre line in WGS 84"):
        read_line(tmp_path / "line.gpkg")


def test_points_are_a_table(tmp_path):
    points = GeoDataFrame({"depth": [1.5, 2.5]}, geometry=shapely.points(placed(LEFT[:2, :2])), crs=MAP)
    for name in ("p.shp", "p.gpkg", "p.fgb"):
        points.to_crs(WGS84).to_file(tmp_path / name)
        for crs in (MAP, None):  # the zone of UTM of the data is the same
            table, found = read_places(tmp_path / name, crs)
            depth = table.numbers(table.column("depth"), "depth")
            order = np.argsort(depth)
            assert depth[order].tolist() == [1.5, 2.5]
            assert found.xy_m[order] == pytest.approx(placed(LEFT[:2, :2]), abs=1e-6 if crs else 2e-4)


def geojson(path: Path, *geometries: object, **members: object) -> Path:
    """A file of these geometries."""
    features = [
        {"type": "Feature", "properties": {"n": k}, "geometry": each} for k, each in enumerate(geometries)
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", **members, "features": features}))
    return path


def line(*corners: tuple[object, ...]) -> dict[str, object]:
    """A line of GeoJSON."""
    return {"type": "LineString", "coordinates": corners}


def test_what_cannot_be_drawn_is_counted(tmp_path):
    two = {"type": "MultiLineString", "coordinates": [[[0, 0], [1, 1]], [[2, 2], [3, 3]]]}
    parts = {"type": "GeometryCollection", "geometries": [two, {"type": "MultiPoint", "coordinates": []}]}
    bow = {"type": "Polygon", "coordinates": [[[0, 0], [4, 4], [4, 0], [0, 4], [0, 0]]]}
    path = geojson(
        tmp_path / "a.geojson", parts, None, line(("x", 1), (2, 2)), line((float("nan"), 1), (2, 2)), bow
    )
    found = read_vectors(path)
    assert [note.partition(" (")[0] for note in found.notes] == [
        "2 without a geometry, left out",
        "1 with coordinates that are no numbers, left out",
        "1 polygons with a wrong outline",
    ]
    # the bow is two triangles of 4 m2
    assert [each.area for each in found.polygons()] == [4.0, 4.0]
    assert len(found.lines()) == 4


def test_what_states_no_system_is_noted(tmp_path):
    BANKS.to_file(tmp_path / "a.shp")
    BANKS.to_crs(WGS84).to_file(tmp_path / "b.shp")
    for name, words in (("a", "taken for places in ETRS89 / UTM zone 33N"), ("b", "taken for degrees")):
        (tmp_path / f"{name}.prj").unlink()
        found = read_vectors(tmp_path / f"{name}.shp")
        assert found.crs is None
        on_map = found.on_map(MAP)
        assert words in on_map.notes[0]
        assert on_map.lines()[0][0] == pytest.approx(placed(LEFT), abs=1e-6)
    # GeoJSON without a member crs is in degrees, unless its numbers cannot be
    assert (
        "taken for places"
        in read_vectors(geojson(tmp_path / "c.geojson", line((EAST_M, NORTH_M), (EAST_M + 1, NORTH_M))))
        .on_map(MAP)
        .notes[0]
    )
    assert not read_vectors(geojson(tmp_path / "d.geojson", line((13.5, 50), (13.6, 50)))).on_map(MAP).notes
    named = {"type": "name", "properties": {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}}
    wrong = geojson(tmp_path / "e.geojson", line((EAST_M, NORTH_M), (EAST_M + 1, NORTH_M)), crs=named)
    with pytest.raises(InputError, match=r"places in .*CRS ?84.* have none in ETRS89"):
        read_vectors(wrong).on_map(MAP)


@pytest.mark.parametrize(
    ("code", "corner", "words"),
    [
        # without the grid file of the land survey PROJ knows this datum to 3 m
        (31468, (4_621_512, 5_659_000), "transformed to ETRS89 / UTM zone 33N, to about 3 m"),
        (4314, (13.7, 51.0), "states DHDN: its places were transformed to .*, to about 3 m"),
        # PROJ took this datum for that of the map: Airy's ellipsoid, some 100 m off
        (4279, (13.7, 51.0), r"places in OS\(SN\)80 have none in ETRS89"),
        # which then lay at 13.7 m east of the false origin
        (25833, (13.7, 51.0), "look like degrees; expected metres"),
    ],
)
def test_another_datum_is_told_or_refused(tmp_path, code, corner, words):
    named = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{code}"}}
    drawn = read_vectors(
        geojson(tmp_path / "a.geojson", line(corner, (corner[0] + 0.01, corner[1])), crs=named)
    )
    try:
        told = drawn.on_map(MAP).notes[-1]
    except InputError as error:
        told = str(error)
    assert re.search(words, told)


def test_a_grid_of_a_site_is_no_place_on_a_map(tmp_path):
    BANKS.to_file(tmp_path / "a.shp")
    (tmp_path / "a.prj").write_text('LOCAL_CS["site",UNIT["metre",1]]')
    assert "taken for places in ETRS89" in read_vectors(tmp_path / "a.shp").on_map(MAP).notes[0]
    # small numbers of a drawing are metres, of other files they may be degrees
    small = BANKS[["geometry"]].translate(-EAST_M, -NORTH_M).to_frame("geometry")
    small.to_file(tmp_path / "a.dxf", driver="DXF")
    on_map = read_vectors(tmp_path / "a.dxf").on_map(MAP)
    assert on_map.lines()[0][0] == pytest.approx(LEFT, abs=1e-9)
    assert "taken for places in ETRS89" in on_map.notes[0]


def test_heights_in_feet_become_metres(tmp_path):
    feet = shapely.transform(BANKS.geometry.to_numpy(), lambda xyz: xyz / (1, 1, 0.3048), include_z=True)
    BANKS.set_geometry(feet).set_crs("EPSG:25833+8228", allow_override=True).to_file(tmp_path / "a.gpkg")
    found = read_vectors(tmp_path / "a.gpkg")
    assert found.on_map(MAP).lines()[0][0] == pytest.approx(placed(LEFT), abs=1e-6)
    assert "heights in foot" in found.notes[0]


def test_points_of_a_map_in_feet_come_into_metres(tmp_path):
    table = GeoDataFrame(
        {"depth": [1.0, 2.0]}, geometry=shapely.points([[984_250, 213_255], [984_350, 213_255]])
    )
    table.set_crs(2263).to_file(tmp_path / "a.gpkg")
    for crs in (None, CRS(2263)):
        found = read_places(tmp_path / "a.gpkg", crs)[1]
        assert np.ptp(found.xy_m[:, 0]) == pytest.approx(100 * 1200 / 3937, abs=1e-6)
        assert found.crs.axis_info[0].unit_name == "metre"
        assert "taken in the unit of NAD83 / New York Long Island (ftUS)" in found.notes[0]


def test_heights_and_units_that_are_not_followed_are_noted(tmp_path):
    point = "<Point><coordinates>13.7,51.0,98.5</coordinates></Point>"
    kml = f'<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark>{point}</Placemark></Document></kml>'
    (tmp_path / "a.kml").write_text(kml)
    assert "altitudeMode clampToGround" in " ".join(read_vectors(tmp_path / "a.kml").notes)
    (tmp_path / "a.kml").write_text(kml.replace("<coord", "<altitudeMode>absolute</altitudeMode><coord"))
    assert "altitudeMode" not in " ".join(read_vectors(tmp_path / "a.kml").notes)
    WRITTEN["a.dxf"](BANKS, tmp_path / "a.dxf")
    text = (tmp_path / "a.dxf").read_text()
    assert "$INSUNITS" not in " ".join(read_vectors(tmp_path / "a.dxf").notes)
    head = "  0\nSECTION\n  2\nHEADER\n  9\n$INSUNITS\n 70\n     2\n  0\nENDSEC\n"
    (tmp_path / "a.dxf").write_text(head + text[text.index("  0\nSECTION\n  2\nTABLES") :])
    assert "its unit as feet ($INSUNITS)" in " ".join(read_vectors(tmp_path / "a.dxf").notes)


def test_a_layer_or_rows_by_name(tmp_path):
    path = tmp_path / "a.gpkg"
    BANKS.assign(day=[7, None]).to_file(path, layer="banks")
    ISLANDS.to_file(path, layer="islands")
    assert [(of["name"], of["n"], of["crs"]) for of in describe_layers(path)] == [
        ("banks", 2, "ETRS89 / UTM zone 33N"),
        ("islands", 1, "ETRS89 / UTM zone 33N"),
    ]
    told = "\n".join(describe(path).lines())
    assert "2 LineString Z" in told
    assert "1 Polygon" in told
    with pytest.raises(InputError, match=r"2 layers.*one of banks, islands.*a.gpkg\?layer=banks"):
        read_vectors(path)
    with pytest.raises(InputError, match="no layer water"):
        read_vectors(path, layer="water")
    assert len(read_vectors(f"{path}?layer=islands").polygons()) == 1
    # a whole number in a column with gaps
    assert len(read_vectors(f"{path}?layer=banks,day=7").lines()) == 1
    with pytest.raises(InputError, match="no column width"):
        read_vectors(f"{path}?layer=banks,width=7")
    with pytest.raises(InputError, match="COLUMN=VALUE"):
        read_vectors(f"{path}?layer")
    with pytest.raises(InputError, match="COLUMN=VALUE"):
        read_vectors(f"{path}?layer=banks,day")


def broken(folder: Path) -> dict[Path, str]:
    """Files that cannot be read, and words of the refusal."""
    (folder / "cut.geojson").write_text('{"type": "FeatureCollection", "features": [{"type": "Feature"')
    (folder / "deep.geojson").write_text("[" * 50_000)
    (folder / "latin.geojson").write_bytes(
        b'{"type": "Feature", "properties": {"a": "l\xe4"}, "geometry": '
        b'{"type": "Point", "coordinates": [1, 2]}}'
    )
    (folder / "wide.geojson").write_bytes('{"type": "Feature"}'.encode("utf-16"))
    (folder / "empty.gpkg").write_bytes(b"")
    (folder / "a.kmz").write_bytes(b"PK\x03\x04" + bytes(30))
    (folder / "half.gpkg").write_bytes(b"SQLite format 3\0" + bytes(52) + b"GPKG" + bytes(500))
    (folder / "plain.dxf").write_text("0\nSECTION\n2\nHEADER\n0\nENDSEC\n0\nEOF\n")
    BANKS.to_file(folder / "alone.shp")
    (folder / "alone.shx").unlink()
    system = {"type": "name", "properties": {"name": "EPSG:1"}}
    point = {"type": "Point", "coordinates": [1, 2]}
    return {
        folder / "cut.geojson": "GeoJSON",
        folder / "deep.geojson": "no GeoJSON that is whole",
        folder / "latin.geojson": "Save its text as UTF-8",
        folder / "wide.geojson": "Save it as UTF-8",
        folder / "empty.gpkg": "the file is empty",
        folder / "a.kmz": "Unpack it",
        folder / "half.gpkg": "GeoPackage",
        folder / "plain.dxf": "error at line 8",
        folder / "alone.shp": r"index \(.shx\) is missing",
        folder / "alone.dbf": "Name alone.shp",
        folder / "nothing.shp": "not found",
        folder: "folder",
        Path("/dev/null"): "device",
        geojson(folder / "text.geojson", {"type": "Point", "coordinates": "abc"}): "1 without a geometry",
        geojson(folder / "none.geojson"): "nothing that is drawn",
        geojson(folder / "crs.geojson", point, crs=system): "EPSG:1 is not known",
    }


def test_what_is_broken_is_refused_with_a_sentence(tmp_path):
    for path, words in broken(tmp_path).items():
        with pytest.raises(InputError, match=words):
            read_vectors(path)


def test_latitude_before_longitude_is_named(tmp_path):
    """GeoJSON has longitude first; (13.7, 51.0) and (51.0, 13.7) are both places on the earth."""
    path = geojson(tmp_path / "a.geojson", line((51.0, 13.74), (51.001, 13.75), (51.002, 13.75)))
    with pytest.raises(InputError, match="latitude and longitude swapped would fit"):
        read_vectors(path).on_map(MAP)
