"""Tables of control points and marks in all forms, and what is said of wrong ones."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pytest
import shapely
from pyproj import CRS

from thalweg.core import GeometryError, InputError, LocalFrame
from thalweg.images import matched_marks, read_all_control_points, read_control_points, read_marks
from thalweg.images.control import map_grid
from thalweg.images.model import ControlMarks, ControlPoints

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=150.0)
LOCAL = np.array([[10.0, 20.0, 1.5], [-35.0, 40.0, 3.25], [60.0, 5.0, 0.5]])
UTM = FRAME.to_map(LOCAL, CRS("EPSG:25833"))
GEODETIC = np.stack(FRAME.to_geodetic(LOCAL), axis=1)
SIGMA = (0.01, 0.01, 0.02)
SIZE = (4000, 3000)
IMAGES = ("IMG_1.JPG", "IMG_2.JPG", "IMG_3.JPG")


def write(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def rows(values: Any, form: str = "{},{:.4f},{:.4f},{:.4f}") -> str:
    """Lines of the points A, B, C with their coordinates; four digits of a metre, ten of a degree."""
    return "".join(form.format(name, *xyz) + "\n" for name, xyz in zip("ABC", values, strict=True))


def points(
    path: Path, crs: str | None = "EPSG:25833", frame: LocalFrame = FRAME, **more: float
) -> ControlPoints:
    return read_control_points(path, frame, crs=crs, sigma_m=SIGMA, **more)


def sigmas(found: ControlPoints, k: int = 0) -> np.ndarray:
    return np.sqrt(found.cov_wcs_m2[k].diagonal())


def control() -> ControlPoints:
    return ControlPoints(
        names=("A", "B", "C"),
        points_wcs_m=LOCAL,
        cov_wcs_m2=np.tile(1e-4 * np.eye(3), (3, 1, 1)),
        check=np.zeros(3, bool),
    )


def match(path: Path, **changes) -> tuple[ControlMarks, dict[str, int]]:
    options = {"images": IMAGES[:2], "all_images": IMAGES} | changes
    images = options["images"]
    return matched_marks(
        read_marks(path),
        control(),
        images,
        [SIZE] * len(images),
        options["all_images"],
        sigma_px=0.5,
        where=path,
    )


def test_the_table_of_the_house(tmp_path):
    text = "id,east_m,north_m,up_m,sigma_east_m,sigma_north_m,sigma_up_m,role\n"
    text += "A,10,20,1.5,0.004,0.005,0.009,control\nB,-35,40,3.25,,,,check\n"
    found = points(write(tmp_path, "control_points.csv", text))
    assert found.names == ("A", "B")
    assert found.check.tolist() == [False, True]
    np.testing.assert_allclose(found.points_wcs_m, LOCAL[:2])
    np.testing.assert_allclose(sigmas(found), [0.004, 0.005, 0.009])
    np.testing.assert_allclose(sigmas(found, 1), SIGMA)


def test_degrees_with_minutes_and_letters(tmp_path):
    text = "id;lat;lon;h\nA;51 3 0.0 N;13 15 0.0 E;150\nB;51.05;13.25;151\n"
    found = points(write(tmp_path, "points.csv", text)).points_wcs_m
    np.testing.assert_allclose(found, [[0, 0, 0], [0, 0, 1]], atol=1e-6)


METASHAPE_LIST = "#Label\tX/Ost\tY/Nord\tZ/Höhe\tAccuracy\n{}# Total Error\n\t\t\t\t0,012\n"
METASHAPE_PANE = "#CoordinateSystem: ...\n#Label,X/East,Y/North,Z/Altitude,Accuracy_(m),Error_(m),X_error\n"


@pytest.mark.parametrize(
    ("text", "sigma_m"),
    [
        pytest.param(
            "id;lat_deg;lon_deg;h_ell_m\n" + rows(GEODETIC, "{};{:.10f};{:.10f};{:.4f}"), SIGMA, id="degrees"
        ),
        pytest.param("id,x,y,z\n" + rows(UTM), SIGMA, id="map"),
        # receivers write the height above the geoid and above the ellipsoid beside each other, 43 m apart
        pytest.param(
            "Name,Elevation,Longitude,Latitude,Ellipsoidal height\n"
            + rows(
                np.column_stack([GEODETIC[:, 2] - 43, GEODETIC[:, [1, 0, 2]]]),
                "{},{:.4f},{:.10f},{:.10f},{:.4f}",
            ),
            SIGMA,
            id="height of the ellipsoid",
        ),
        pytest.param(
            METASHAPE_LIST.format(rows(UTM, "{}\t{:.4f}\t{:.4f}\t{:.4f}\t0,005").replace(".", ",")),
            0.005,
            id="Metashape ends with a row of errors",
        ),
        pytest.param(
            METASHAPE_PANE + rows(UTM, '"{}",{:.4f},{:.4f},{:.4f},0.02,0,0'), 0.02, id="Metashape's pane"
        ),
    ],
)
def test_points_in_the_forms_of_others(tmp_path, text, sigma_m):
    found = points(write(tmp_path, "p.txt", text))
    assert found.names == ("A", "B", "C")
    # ten digits of a degree are 0.01 mm, four of a metre 0.1 mm
    np.testing.assert_allclose(found.points_wcs_m, LOCAL, atol=2e-4)
    np.testing.assert_allclose(sigmas(found, 1), sigma_m)


def test_a_map_without_a_crs_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"without a CRS.*campaign\.crs"):
        points(write(tmp_path, "m.csv", "id,x,y,z\n" + rows(UTM)), crs=None)


def test_points_of_a_gis_are_control_points(tmp_path):
    """On the map, in degrees, with heights in the geometry or beside it; not by attributes."""
    layer = gpd.GeoDataFrame(
        {"name": list("ABC"), "role": ["check", "control", "control"], "accuracy": 0.004, "east": 1.0},
        geometry=shapely.points(UTM),
        crs="EPSG:25833",
    )
    layer.to_file(tmp_path / "p.gpkg")
    flat = layer.assign(elevation=UTM[:, 2], geometry=shapely.points(UTM[:, :2])).set_crs("EPSG:25833")
    flat.to_file(tmp_path / "p.shp")
    layer.to_crs("EPSG:4258").to_file(tmp_path / "p.geojson")
    for name, crs in (("p.gpkg", None), ("p.shp", "EPSG:3857"), ("p.geojson", None)):
        found = points(tmp_path / name, crs)
        assert found.names == ("A", "B", "C"), name
        # GeoJSON has seven digits of a degree
        np.testing.assert_allclose(found.points_wcs_m, LOCAL, atol=1e-2 if "json" in name else 1e-4)
        assert found.check.tolist() == [True, False, False]
        np.testing.assert_allclose(sigmas(found), 0.004)


METASHAPE = """<?xml version="1.0" encoding="UTF-8"?>
<document version="1.5.0"><chunk>
  <cameras next_id="3"><camera id="0" sensor_id="0" label="IMG_1"/>
    <camera id="2" sensor_id="0" label="IMG_3"/><camera id="1" sensor_id="0" label="IMG_2"/></cameras>
  <markers next_id="2"><marker id="0" label="A">
    <reference x="{0}" y="{1}" z="{2}" sxyz="0.008" enabled="true"/></marker>
    <marker id="1" label="B"><reference x="{3}" y="{4}" z="{5}" sx="0.01" sy="0.02" sz="0.03"
    enabled="false"/></marker></markers>
  <frames next_id="1"><frame id="0"><markers>
    <marker marker_id="0"><location camera_id="0" pinned="true" x="1200.25" y="800.5"/>
      <location camera_id="1" pinned="true" x="1300" y="810"/>
      <location camera_id="2" pinned="false" x="1400" y="820"/></marker>
    <marker marker_id="1"><location camera_id="1" pinned="true" x="10.5" y="20.5"/>
      <location camera_id="2" pinned="true" x="99" y="20.5"/></marker>
  </markers></frame></frames>
  <reference>EPSG:25833</reference>
</chunk></document>
"""


def test_metashape_markers(tmp_path):
    text = METASHAPE.format(*UTM[:2].ravel())
    path = write(tmp_path, "markers.xml", text)
    found = points(path, crs=None)
    np.testing.assert_allclose(found.points_wcs_m, LOCAL[:2], atol=2e-4)
    assert found.check.tolist() == [False, True]
    np.testing.assert_allclose(sigmas(found, 1), [0.01, 0.02, 0.03])
    marks, dropped = match(path)
    assert marks.image.tolist() == [0, 1, 1]
    assert marks.point.tolist() == [0, 0, 1]
    np.testing.assert_allclose(marks.xy_px[0], [1200.25, 800.5])
    assert dropped == {"placed by the program, not by a person": 1, "in images without a pose": 1}
    for known, other in (('marker marker_id="1"', 'marker marker_id="7"'), ('"1" pinned', '"7" pinned')):
        path = write(tmp_path, "other.xml", text.replace(known, other))
        with pytest.raises(InputError, match=r"a mark of camera \d and marker \d; expected both in the file"):
            match(path)


def test_markers_without_an_accuracy_have_that_of_their_chunk(tmp_path, caplog):
    settings = '<settings><property name="accuracy_markers" value="0.25"/></settings></chunk>'
    text = METASHAPE.format(*UTM[:2].ravel())
    text = text.replace('sxyz="0.008" ', "").replace("</chunk>", settings)
    found = points(write(tmp_path, "markers.xml", text), crs=None)
    np.testing.assert_allclose(sigmas(found), 0.25)
    np.testing.assert_allclose(sigmas(found, 1), [0.01, 0.02, 0.03])
    assert "that of the chunk (accuracy_markers), 0.25 m" in caplog.text


def test_markers_of_several_chunks_are_refused(tmp_path):
    """Each chunk numbers its cameras and markers from 0."""
    head, body = METASHAPE.format(*LOCAL[:2].ravel()).split('<document version="1.5.0">')
    twice = f"{head}<document>{body.replace('</document>', '')}{body}"
    with pytest.raises(InputError, match=r"2 chunks with markers; expected one"):
        read_marks(write(tmp_path, "markers.xml", twice))


@pytest.mark.parametrize(
    ("unit", "answer"), [("metre", None), ("foot", r"'Local Coordinates'; expected metres")]
)
def test_local_coordinates_of_metashape(tmp_path, unit, answer):
    size = {"metre": "1", "foot": "0.3048"}[unit]
    stated = f'LOCAL_CS["Local Coordinates",LOCAL_DATUM["Local Datum",0],UNIT["{unit}",{size}]]'
    text = METASHAPE.format(*LOCAL[:2].ravel()).replace("EPSG:25833", stated)
    path = write(tmp_path, "markers.xml", text)
    if answer:
        with pytest.raises(InputError, match=answer):
            points(path, crs="local")
    else:
        np.testing.assert_allclose(points(path, crs="local").points_wcs_m, LOCAL[:2])


@pytest.mark.parametrize(
    ("names", "values", "sigma_m"),
    [
        ("sigma_e,sigma_n,sigma_h", "0.2,0.3,0.4", (0.2, 0.3, 0.4)),
        ("sE,sN,sH", "0.2,0.3,0.4", (0.2, 0.3, 0.4)),
        ("StdDev X (mm),StdDev Y (mm),StdDev Z (mm)", "5,6,8", (0.005, 0.006, 0.008)),
        ("HRMS,VRMS", "0.2,0.4", (0.2, 0.2, 0.4)),
        ("sigma_mm", "5", (0.005, 0.005, 0.005)),
        ("sz,precision_horizontal", "0.4,0.2", (0.01, 0.01, 0.4)),
    ],
)
def test_standard_deviations_by_their_usual_names(tmp_path, caplog, names, values, sigma_m):
    path = write(tmp_path, "p.csv", f"id,east_m,north_m,up_m,{names}\nA,10,20,1.5,{values}\n")
    np.testing.assert_allclose(sigmas(points(path)), sigma_m)
    assert ("not of the columns precision_horizontal" in caplog.text) == ("precision" in names)


@pytest.mark.parametrize(
    ("name", "cells"),
    [
        ("used", ("true", "false")),
        ("Enable", "10"),
        ("check", "01"),
        ("control", "yn"),
        ("is_check", ("", "x")),
    ],
)
def test_columns_that_say_which_points_are_check_points(tmp_path, name, cells):
    text = f"id,east_m,north_m,up_m,{name}\nA,10,20,1.5,{cells[0]}\nB,-35,40,3.25,{cells[1]}\n"
    assert points(write(tmp_path, "p.csv", text)).check.tolist() == [False, True]


@pytest.mark.parametrize(
    ("remark", "more"), [("# CoordinateSystem: {}\n", ""), ("# CRS: EPSG:25832\n", ""), ("", "25832")]
)
def test_the_coordinate_system_that_a_table_states_counts(tmp_path, remark, more):
    grid = FRAME.to_map(LOCAL, CRS("EPSG:25832"))
    head = remark.format(CRS("EPSG:25832").to_wkt("WKT1_GDAL")) + f"id,x,y,z{',epsg' if more else ''}\n"
    path = write(tmp_path, "p.csv", head + rows(grid).replace("\n", f",{more}\n" if more else "\n"))
    np.testing.assert_allclose(points(path).points_wcs_m, LOCAL, atol=2e-4)
    np.testing.assert_allclose(points(path, crs="local").points_wcs_m, grid, atol=1e-4)


def test_heights_in_the_feet_that_their_system_states(tmp_path, caplog):
    frame = LocalFrame(lat_deg=38.6, lon_deg=-121.5, h_ell_m=0.0)
    flat = frame.to_map(LOCAL, CRS("EPSG:26942"))  # the same map in metres
    path = write(tmp_path, "p.csv", "id,x,y,z\n" + rows(flat * 3937 / 1200))
    for crs in ("EPSG:2226+6360", "EPSG:2226"):
        found = points(path, crs, frame)
        up = LOCAL[:, 2] * (1.0 if "+" in crs else 3937 / 1200)
        np.testing.assert_allclose(found.points_wcs_m, np.c_[LOCAL[:, :2], up], atol=1e-3)
    assert "no unit of heights: metres although east and north are not" in caplog.text


@pytest.mark.parametrize("crs", ["EPSG:2226", "EPSG:4326"])
def test_results_are_wanted_in_a_grid_in_metres(tmp_path, crs):
    path = write(tmp_path, "p.csv", "id,x,y,z\nA,1,2,3\n")
    with pytest.raises(InputError, match=r"expected a projected one in metres, or local"):
        map_grid(crs, path)
    assert map_grid("EPSG:25833", path).to_epsg() == 25833


def test_hemispheres_in_columns_of_their_own(tmp_path):
    frame = LocalFrame(lat_deg=-33.4, lon_deg=-70.6, h_ell_m=500.0)
    geodetic = np.stack(frame.to_geodetic(LOCAL), axis=1) * [-1, -1, 1]
    text = "id,lat,NS,lon,EW,h\n" + rows(geodetic, "{},{:.10f},S,{:.10f},W,{:.4f}")
    found = points(write(tmp_path, "p.csv", text), None, frame)
    np.testing.assert_allclose(found.points_wcs_m, LOCAL, atol=2e-4)


def test_names_stay_as_they_are_written(tmp_path):
    """Also where they look like numbers with a unit or with groups of digits."""
    text = "id;x;y;z\n001;377.349,68;5.656.861,86;151,5\n5cm;377.305,18;5.656.882,92;153,25\n"
    assert points(write(tmp_path, "p.csv", text)).names == ("001", "5cm")
    text = "image;point;x;y\n001;12M;1.512,50;2.201,25\n002;2,5;2.400,00;1.200,00\n"
    found = read_marks(write(tmp_path, "m.csv", text))
    assert (found.image, found.point) == (("001", "002"), ("12M", "2,5"))
    np.testing.assert_allclose(found.xy_px, [[1512.5, 2201.25], [2400, 1200]])


def test_opendronemap_counts_from_the_centre_of_the_first_pixel(tmp_path):
    grid = FRAME.to_map(LOCAL[:2], CRS("EPSG:32633"))
    a, b = ("\t".join(f"{v:.4f}" for v in row) for row in grid)
    text = f"WGS84 UTM 33N\n{a}\t100\t200\tIMG_1.JPG\tA\n{a}\t300.5\t400\tIMG_2.JPG\tA\n{b} 5 6 IMG_2.JPG B\n"
    path = write(tmp_path, "gcp_list.txt", text)
    found = points(path, crs=None)
    assert found.names == ("A", "B")
    np.testing.assert_allclose(found.points_wcs_m, LOCAL[:2], atol=2e-4)
    marks, _ = match(path)
    np.testing.assert_allclose(marks.xy_px, [[100.5, 200.5], [301.0, 400.5], [5.5, 6.5]])
    unnamed = (
        f"+proj=utm +zone=33 +datum=WGS84 +units=m\n{a} 5 6 I.JPG\n# {a}\n{a} 7 8 J.JPG\n{b} 1 2 J.JPG\n"
    )
    found = points(write(tmp_path, "unnamed.txt", unnamed), crs=None)
    assert found.names == ("gcp1", "gcp2")
    assert read_marks(tmp_path / "unnamed.txt").point == ("gcp1", "gcp1", "gcp2")
    with pytest.raises(InputError, match="two places of A"):
        points(write(tmp_path, "gcp2.txt", text + f"{b}\t1\t2\tIMG_1.JPG\tA\n"), crs=None)


def test_marks_with_and_without_sigma(tmp_path):
    text = "image,point,x_px,y_px,sigma_px,score,used,reason\nIMG_1.JPG,A,5,6,0.2,0.9,True,\n"
    text += "IMG_2.JPG,A,7,8,,0.9,True,\nIMG_2.JPG,B,7,8,,0.5,False,ambiguous\n"
    marks, dropped = match(write(tmp_path, "marks.csv", text))
    assert marks.sigma_px.tolist() == [0.2, 0.5]
    with pytest.raises(GeometryError, match="a standard deviation of 0 px"):
        replace(marks, sigma_px=np.array([0.2, 0.0]))
    assert dropped == {"not to be used": 1}
    text = "image,point,x,y,sigma,enabled\nIMG_1.JPG,A,5,6,0.2,y\nIMG_2.JPG,B,7,8,0.3,0\n"
    marks, dropped = match(write(tmp_path, "m.csv", text))
    assert marks.sigma_px.tolist() == [0.2]
    assert dropped == {"not to be used": 1}


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        ("image,point,x_px,y_px\nIMG_9.JPG,A,5,6\n", r"images that do not occur: IMG_9\.JPG; .*IMG_1"),
        ("image,point,x_px,y_px\nIMG_1.JPG,D,5,6\n", r"points that do not occur: D; expected .*A, B, C"),
        ("image,point,x_px,y_px\nIMG_1.JPG,A,4000.5,6\n", r"A at \(4000\.5, 6\) in IMG_1.*4000 x 3000"),
        ("image,point,x_px,y_px\nIMG_1.JPG,A,-1,6\n", r"A at \(-1, 6\)"),
        ("image,point,x_px,y_px\nIMG_1.JPG,A,5,6\nIMG_1.JPG,A,7,6\n", r"A is marked twice in IMG_1"),
        ("image,point,x_px,y_px\nIMG_1.JPG,A,five,6\n", r"x_px 'five'; expected a number"),
        ("image,point,x_px,y_px\nIMG_1.JPG,A,nan,6\n", r"x_px 'nan'"),
        ("image,point,x_px\nIMG_1.JPG,A,5\n", r"no y_px; expected a column y_px or v"),
        ("image,point,x_px,y_px\nIMG_1.JPG,A\n", r"marks\.csv:2: no x_px; expected a column x_px"),
        ("", r"the file is empty; expected a table"),
        ("EPSG:32633\n1 2 3 4\n", r"marks\.csv:2: 4 columns; expected x y z im_x im_y image"),
        ("EPSG:32633\n1 2 3 4 five a\n", r"marks\.csv:2: y_px 'five'; expected a number"),
    ],
)
def test_wrong_marks_are_told(tmp_path, text, answer):
    with pytest.raises(InputError, match=answer):
        match(write(tmp_path, "marks.csv", text))


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        ("id,east_m,north_m,up_m\nA,1,2,3\nA,4,5,6\n", r"control point A more than once"),
        ("id,east_m,north_m,up_m,sigma_up_m\nA,1,2,3,0\n", r"a standard deviation of 0 m of A"),
        ("id,east_m,north_m,up_m,role\nA,1,2,3,tie\n", r"role 'tie' of A; expected control or check"),
        ("id,a,b,c\nA,1,2,3\n", r"columns id, point; expected east_m, north_m, up_m"),
        ("id,east_m,north_m,up_m\n", r"no control points"),
        ("id,x,y,z\nA,1,2,3\n", r"outside"),
        (
            "id,east_m,north_m,up_m,sigma_up_m\nA,1,2,3,-0.01\n",
            r"csv:2: a standard deviation of -0\.01 m of A",
        ),
        (
            "id,east_m,north_m,up_m,role\nA,1,2,3,CP\n",
            r"csv:2: the role 'CP' of A.*control and for check points alike",
        ),
        ("A,1,2,3\nB,4,5,6\n", r"no names of columns: the first line is 'A,1,2,3'"),
        ("id,east_m,north_m,up_m\nA,1,2,3\nB,4,5,\n", r"csv:3: no up_m"),
        ("id,east_m,north_m,up_m\nA,1,2,3\nB,4,5,-9999\n", r"csv:3: up_m -9999, which stands for no value"),
        ("id,x,y,Z (positive down)\nA,1,2,3\n", r"\(positive down\), and its name; expected heights, pos"),
        ("id,x,y,z,zone\nA,377370,5656850,151,32U\n", "in zone 32 by the file"),
        ("# EPSG:25832\nid,x,y,z\nA,377370,5656850,151\n", "coordinates in 'ETRS89 / UTM zone 32N'"),
        ("id,lat,Longitude (W),h\nA,51.05,13.25,151\n", "-13.25"),
    ],
)
def test_wrong_control_points_are_told(tmp_path, text, answer):
    with pytest.raises((InputError, GeometryError), match=answer):
        points(write(tmp_path, "points.csv", text))


def test_files_that_are_none(tmp_path):
    with pytest.raises(InputError, match="file not found"):
        read_marks(tmp_path / "no.csv")
    with pytest.raises(InputError, match="no XML"):
        read_marks(write(tmp_path, "a.xml", "<document"))
    with pytest.raises(InputError, match="no markers"):
        read_marks(write(tmp_path, "b.xml", "<document/>"))
    (tmp_path / "c.csv").write_bytes(b"image,point\0")
    with pytest.raises(InputError, match="zero bytes"):
        read_marks(tmp_path / "c.csv")
    with pytest.raises(InputError, match="CRS 'EPSG:99' is not known"):
        points(write(tmp_path, "g.txt", "EPSG:99\n1 2 3 4 5 IMG_1.JPG A\n"), crs=None)


@pytest.mark.parametrize(
    ("head", "values", "answer"),
    [
        (
            "x,y,z",
            FRAME.to_map(LOCAL, CRS("EPSG:25832")),
            r"zone 32N would fit.*images\.control\.crs: EPSG:25832",
        ),
        ("x,y,z", UTM[:, [1, 0, 2]], r"east and north swapped would fit"),
        ("x,y,z", UTM + np.array([33e6, 0, 0]), r"the zone before the easting would fit"),
        ("x,y,z", UTM * 1000, r"millimetres would fit"),
        ("x,y,z", UTM / 0.3048, r"feet would fit"),
        ("x,y,z", LOCAL, r"coordinates of the world frame would fit.*east_m"),
        ("x,y,z", GEODETIC, r"latitude and longitude would fit.*lat_deg"),
        ("lat_deg,lon_deg,h_ell_m", GEODETIC[:, [1, 0, 2]], r"latitude and longitude swapped would fit"),
        ("east_m,north_m,up_m", UTM, r"zone 33N would fit.*Name the columns x, y, z"),
        ("east_m,north_m,up_m", LOCAL * 1000 + 4e6, r"millimetres would fit"),
    ],
)
def test_coordinates_far_from_the_survey_are_told_apart(tmp_path, head, values, answer):
    text = f"id,{head}\n" + rows(values, "{},{:.8f},{:.8f},{:.4f}")
    with pytest.raises(GeometryError, match=answer):
        points(write(tmp_path, "p.csv", text))


def test_heights_above_the_geoid_get_an_offset(tmp_path):
    path = write(tmp_path, "p.csv", "id,x,y,z\n" + rows(UTM - [0, 0, 45.0]))
    found = points(path, "EPSG::25833", height_offset_m=45.0)
    np.testing.assert_allclose(found.points_wcs_m, LOCAL, atol=2e-4)


def test_several_files_are_one_survey(tmp_path):
    head = "id,east_m,north_m,up_m\n"
    a, b = write(tmp_path, "a.csv", f"{head}A,1,2,3\n"), write(tmp_path, "b.csv", f"{head}B,1,2,3\n")
    options = {"crs": None, "sigma_m": SIGMA}
    assert read_all_control_points([a, b], FRAME, **options).names == ("A", "B")
    assert read_all_control_points([], FRAME, **options).names == ()
    with pytest.raises(InputError, match=r"a\.csv: A stands in a\.csv, too"):
        read_all_control_points([a, a], FRAME, **options)


def test_points_whose_names_differ_in_case_only_are_refused(tmp_path):
    path = write(tmp_path, "m.csv", "image,point,x_px,y_px\nIMG_1.JPG,A,5,6\n")
    alike = ControlPoints.joined([control(), replace(control(), names=("D", "b", "F"))])
    with pytest.raises(InputError, match="control points called B in another case, too"):
        matched_marks(read_marks(path), alike, IMAGES[:2], [SIZE] * 2, IMAGES, sigma_px=0.5)


def test_a_row_with_a_cell_too_many_is_refused(tmp_path):
    good = "".join(f"P{k},{k},2,3\n" for k in range(30))
    path = write(tmp_path, "p.csv", f"id,east_m,north_m,up_m\n{good}Q,1,2,3,4\n")
    with pytest.raises(InputError, match=r"1 row of more than 4 cells, left out, the first in line 32"):
        points(path)


def test_names_with_folders_and_in_another_case(tmp_path):
    text = "image,point,x_px,y_px\nC:\\data\\img_1.jpg,a,5,6\n/home/x/IMG_2.JPG, B,7,8\nIMG_3,C,7,8\n"
    marks, dropped = match(write(tmp_path, "m.csv", text))
    assert marks.image.tolist() == [0, 1]
    assert marks.point.tolist() == [0, 1]
    assert dropped == {"in images without a pose": 1}


@pytest.mark.parametrize(("name", "read"), [("used", True), ("Enabled", True), ("valid", False)])
def test_marks_that_do_not_count_are_read_or_told(tmp_path, caplog, name, read):
    """`used` and its like say which marks count; another column that may is told to be unread."""
    text = f"image,point,x_px,y_px,{name}\na.jpg,p,110.5,220.5,1\nb.jpg,p,130.5,240.5,0\n"
    found = read_marks(write(tmp_path, "m.csv", text))
    assert found.used.tolist() == [True, not read]
    assert ("it is not read" in caplog.text) != read
