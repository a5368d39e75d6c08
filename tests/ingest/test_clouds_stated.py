"""What LAS and E57 state of their points: units, flags, times, turns; against points that are known."""

import struct
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pye57
import pytest
from laspy.header import GpsTimeType
from laspy.vlrs.known import GeoKeyDirectoryVlr
from pyproj import CRS, Transformer

from thalweg.cli import main
from thalweg.core import ArrayF, InputError, gps_from_unix, iter_laz, laz_header
from thalweg.core.values import check_stated
from thalweg.deformation.foreign.clouds import read_points
from thalweg.deformation.foreign.surfaces import one_frame
from thalweg.ingest.clouds import read_cloud

N = 200
PLACE = np.array([412_000.0, 5_650_000.0, 150.0])
US_FOOT_M = 1200 / 3937
DATUM = 'AUTHORITY["EPSG","7019"]]'
TOWGS84 = CRS("EPSG:2225+6360").to_wkt("WKT1_GDAL").replace(DATUM, f"{DATUM},TOWGS84[0,0,0,0,0,0,0]")
"""Feet of a map, and a way to WGS 84 that old programs tie to it."""


def points() -> ArrayF:
    """Points of 20 m about a place in UTM, whole millimetres."""
    return PLACE + np.random.default_rng(4).uniform(-10, 10, (N, 3)).round(3)


def a_las(
    path: Path,
    xyz: ArrayF,
    *,
    crs: str = "",
    keys: tuple[int, ...] = (),
    standard: bool = False,
    scale: float = 0.001,
    version: str = "1.4",
    **columns: Any,
) -> Path:
    """A cloud by laspy, with WKT, GeoKeys (key, value, ...) or both."""
    header = laspy.LasHeader(point_format=6 if version == "1.4" else 1, version=version)
    header.scales, header.offsets = np.full(3, scale), np.floor(xyz.min(axis=0))
    header.global_encoding.gps_time_type = GpsTimeType.STANDARD if standard else GpsTimeType.WEEK_TIME
    if crs:
        header.add_crs(CRS(crs))
    if keys:
        record = GeoKeyDirectoryVlr()
        rows = [(1, 1, 0, len(keys) // 2), *((keys[k], 0, 1, keys[k + 1]) for k in range(0, len(keys), 2))]
        record.parse_record_data(np.array(rows, "<u2").tobytes())
        header.vlrs.append(record)
    las = laspy.LasData(header)
    las.xyz = xyz
    for name, values in columns.items():
        las[name] = values
    las.write(str(path))
    return path


# ---------------------------------------------------------------- units


@pytest.mark.parametrize(
    ("factors", "told", "note"),
    [
        ((1, 1, US_FOOT_M), {"keys": (1024, 1, 3072, 25833, 4099, 9003), "version": "1.2"}, "US survey feet"),
        ((1, 1, 0.3048), {"keys": (1024, 1, 3072, 25833, 4099, 9002), "version": "1.2"}, "in feet"),
        ((1, 1, US_FOOT_M), {"crs": "EPSG:25833+6360"}, "Heights are stated in US survey feet"),
        # the WKT has the map alone, the keys the heights
        ((1, 1, US_FOOT_M), {"crs": "EPSG:25833", "keys": (4096, 5703, 4099, 9003)}, "US survey feet"),
        ((US_FOOT_M, US_FOOT_M, US_FOOT_M), {"crs": "EPSG:2225+6360"}, "East and north are stated in US"),
        ((US_FOOT_M, US_FOOT_M, US_FOOT_M), {"crs": TOWGS84}, "East and north are stated in US"),
        ((1, 1, 1), {"crs": "EPSG:25833"}, "The file states no unit of heights: metres."),
        ((1, 1, 1), {"crs": "EPSG:25833+7837"}, ""),
    ],
)
def test_lengths_become_metres(tmp_path, factors, told, note):
    path = a_las(tmp_path / "a.laz", points() / np.array(factors), scale=0.0001, **told)
    cloud = read_cloud(path)
    assert cloud.points == pytest.approx(points(), abs=1e-4)
    told_of_units = [text for text in cloud.report.notes if "unit" in text or "converted" in text]
    assert note in " ".join(told_of_units)
    assert bool(told_of_units) == bool(note)
    # whoever reads it in pieces has metres, too
    assert np.concatenate([c["xyz_m"] for c in iter_laz(path)]) == pytest.approx(points(), abs=1e-4)
    frame = laz_header(path).frame
    assert isinstance(frame, CRS)
    assert {axis.unit_name for axis in frame.axis_info} == {"metre"}


def test_other_systems_of_heights_are_refused(tmp_path, capsys):
    files = [a_las(tmp_path / f"{k}.laz", points(), crs=f"EPSG:25833+{k}") for k in (7837, 5783)]
    assert main(["compare-clouds", *map(str, files), "-o", str(tmp_path / "c.csv")]) == 2
    assert "heights of DHHN2016 height" in capsys.readouterr().err


def test_degrees_become_utm(tmp_path):
    degrees = Transformer.from_crs(25833, 4258, always_xy=True).transform(*points()[:, :2].T)
    xyz = np.column_stack([*degrees, points()[:, 2]])
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.array([1e-9, 1e-9, 1e-3]), np.floor(xyz.min(axis=0))
    header.add_crs(CRS("EPSG:4258"))
    las = laspy.LasData(header)
    las.xyz = xyz
    las.write(str(tmp_path / "a.laz"))
    cloud = read_cloud(tmp_path / "a.laz")
    assert cloud.points == pytest.approx(points(), abs=1e-3)
    assert cloud.crs.to_epsg() == 25833
    assert "Coordinates in ETRS89 are transformed to ETRS89 / UTM zone 33N." in cloud.report.notes
    assert cloud.step_m == pytest.approx(1e-3)
    bare = a_las(tmp_path / "b.laz", xyz, scale=1e-8)
    with pytest.raises(InputError, match="look like degrees"):
        read_points(bare)


@pytest.mark.parametrize(("code", "epsg"), [(4258, 25833), (9755, None)])
def test_degrees_of_any_datum_come_onto_a_map_that_compares(tmp_path, code, epsg):
    """Latitude before longitude lies elsewhere, which is told; not every datum has codes of UTM."""
    degrees = Transformer.from_crs(25833, 4258, always_xy=True).transform(*points()[:, :2].T)
    xyz = np.column_stack([*degrees, points()[:, 2]])
    path = a_las(tmp_path / "a.laz", xyz, crs=f"EPSG:{code}", scale=1e-7)
    cloud = read_points(path)
    assert one_frame([cloud, cloud])[0].to_epsg() == epsg
    assert not any("contradict" in text for text in cloud.notes)
    swapped = read_cloud(a_las(tmp_path / "b.laz", xyz[:, [1, 0, 2]], crs=f"EPSG:{code}", scale=1e-7))
    told = any("latitude and longitude swapped would fit" in text for text in swapped.report.notes)
    assert told == (code == 4258)  # the other is used all over the world


def test_maps_that_contradict(tmp_path):
    """The keys of another zone beside the WKT; places outside of a map that WKT 1 names by its code alone."""
    keys = (1024, 1, 3072, 25832)
    cloud = read_cloud(a_las(tmp_path / "a.laz", points(), crs="EPSG:25833", keys=keys))
    assert cloud.crs.to_epsg() == 25833
    said = "The WKT states ETRS89 / UTM zone 33N, the GeoKeys ETRS89 / UTM zone 32N: the WKT counts."
    assert said in cloud.report.notes
    same = read_cloud(a_las(tmp_path / "b.laz", points(), crs="EPSG:25833", keys=(1024, 1, 3072, 25833)))
    assert not any("GeoKeys" in text for text in same.report.notes)
    other = CRS.from_wkt(CRS(31468).to_wkt("WKT1_GDAL"))
    assert other.area_of_use is None
    with pytest.raises(InputError, match=r"east 41\d,\d+.*Gauss-Kruger zone 4, used from 47.39"):
        check_stated(points(), other, where="a.laz")


# ---------------------------------------------------------------- points that are none


def test_points_on_water_are_told(tmp_path):
    classes = np.where(np.arange(N) < 30, 9, 2).astype(np.uint8)
    notes = read_cloud(a_las(tmp_path / "a.laz", points(), classification=classes)).report.notes
    assert "30 points of class 9 (water) are kept: leave them out where ground counts." in notes


def test_marked_points_are_left_out_and_counted(tmp_path):
    flags = np.zeros((2, N), bool)
    flags[0, :20] = flags[1, 15:40] = True
    classes = np.full(N, 2, np.uint8)
    classes[:50], classes[50:60] = 7, 18
    path = a_las(tmp_path / "a.laz", points(), withheld=flags[0], synthetic=flags[1], classification=classes)
    cloud = read_cloud(path)
    assert cloud.points == pytest.approx(points()[60:], abs=1e-6)
    assert cloud.report.losses == {
        "points_withheld": 20,
        "points_synthetic": 20,
        "points_of_class_7_noise": 10,
        "points_of_class_18_noise": 10,
    }
    with pytest.raises(InputError, match="no points but 200 points withheld"):
        read_cloud(a_las(tmp_path / "b.laz", points(), withheld=np.ones(N, bool)))


def test_coordinates_that_ran_out_of_integers_are_none(tmp_path):
    """As by a writer that forgot the offset: its numbers end at 2,147,483,647 steps."""
    path = a_las(tmp_path / "a.las", points())
    las = laspy.read(path)
    las.Y[:7], las.X[7:9], las.Z[8:10] = -(2**31), 2**31 - 1, 2**31 - 2
    las.write(path)
    cloud = read_cloud(path)
    assert cloud.points[1:] == pytest.approx(points()[10:], abs=1e-6)
    assert cloud.report.losses == {"points_beyond_the_range_of_the_numbers_in_the_file": 9}
    las.Y[:] = -(2**31)
    las.write(path)
    with pytest.raises(InputError, match=r"no points but 200 points beyond the range .* offset near them"):
        read_cloud(path)


def test_readers_in_pieces_tell_the_log(tmp_path, caplog):
    path = a_las(tmp_path / "a.laz", points(), withheld=np.arange(N) < 30)
    assert sum(len(chunk["xyz_m"]) for chunk in iter_laz(path, 64)) == N - 30
    assert "a.laz: 30 points withheld left out." in caplog.text


def test_points_at_zero_of_a_map_are_none(tmp_path):
    xyz = points()
    xyz[:3] = 0.0
    cloud = read_cloud(a_las(tmp_path / "a.laz", xyz, scale=0.01))
    assert len(cloud.points) == N - 3
    assert cloud.report.losses == {"points_at_zero": 3}


# ---------------------------------------------------------------- times

IN_2021 = np.linspace(3.0e8, 3.0e8 + 50, N)
UNIX_2021 = np.linspace(1.69e9, 1.69e9 + 50, N)
IN_A_WEEK = 345_600.0 + np.arange(N)


@pytest.mark.parametrize(
    ("standard", "stored", "expected", "note"),
    [
        (True, np.zeros(N), None, "All times are 0"),
        (False, np.zeros(N), None, "All times are 0"),
        (True, IN_A_WEEK, None, "unstated GPS week"),
        (False, IN_A_WEEK, None, "unstated GPS week"),
        (True, IN_2021, IN_2021, ""),
        (False, IN_2021, IN_2021, "The header states seconds of an unstated GPS week, but"),
        (True, IN_2021 + 1e9, None, "is 2011-03-13 in seconds since 1970 (Unix time), 2021-03-17 in GPS"),
        (True, UNIX_2021, gps_from_unix(UNIX_2021), "Unix time"),
        (True, UNIX_2021 * 1000, gps_from_unix(UNIX_2021), "milliseconds since 1970"),
        (True, -IN_2021 * 1000, None, "Times are left empty"),
    ],
)
def test_times_are_what_their_size_says(tmp_path, standard, stored, expected, note):
    cloud = read_cloud(a_las(tmp_path / "a.laz", points(), standard=standard, gps_time=stored))
    if expected is None:
        assert cloud.t_gps_s is None
    else:
        assert cloud.t_gps_s == pytest.approx(expected, abs=1e-5)
    assert any(note in text for text in cloud.report.notes)


def test_single_times_of_zero_are_none(tmp_path):
    cloud = read_cloud(
        a_las(tmp_path / "a.laz", points(), standard=True, gps_time=np.where(np.arange(N) < 5, 0.0, IN_2021))
    )
    assert np.isnan(cloud.t_gps_s[:5]).all()
    assert cloud.report.losses == {"times_that_are_zero": 5}


# ---------------------------------------------------------------- damage


def test_headers_that_contradict_their_points(tmp_path):
    path = a_las(tmp_path / "a.las", points())
    raw = bytearray(path.read_bytes())
    struct.pack_into("<d", raw, 179, 412_000.0)  # largest x
    path.write_bytes(raw)
    n = int((points()[:, 0] > 412_000.0015).sum())
    assert f"{n} points lie outside of the box" in " ".join(read_cloud(path).report.notes)
    short = raw.copy()
    struct.pack_into(
        "<Q", short, 247, N - 50
    )  # of a recording that ended before its header was written again
    path.write_bytes(short)
    cloud = read_cloud(path)
    assert len(cloud.points) == N - 50
    assert "is room for 50 more: not read" in " ".join(cloud.report.notes)
    for at, value in ((131, 0.0), (155, 1e300), (139, np.nan)):
        bad = raw.copy()
        struct.pack_into("<d", bad, at, value)
        path.write_bytes(bad)
        with pytest.raises(InputError, match=r"coordinates in steps of|expected scales between"):
            read_cloud(path)


# ---------------------------------------------------------------- E57


@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0, 0.0), (0.3, 0.0, 0.0, 0.0), (0.9995, 0.0, 0.0, 0.0)])
def test_a_quaternion_that_is_no_rotation_turns_nothing(tmp_path, monkeypatch, rotation):
    # pye57 leaves the text on coordinates empty
    node, wkt = pye57.libe57.StringNode, CRS(2263).to_wkt()
    monkeypatch.setattr(pye57.libe57, "StringNode", lambda file, text: node(file, text or wkt))
    path = tmp_path / "a.e57"
    local = points() - PLACE
    local[:4] = 0.0  # no return
    file = pye57.E57(str(path), mode="w")
    data = {f"cartesian{axis}": np.ascontiguousarray(local[:, i]) for i, axis in enumerate("XYZ")}
    file.write_scan_raw(data, rotation=np.array(rotation), translation=PLACE)
    file.close()
    cloud = read_cloud(path)
    # a map in feet, whose coordinates are metres by the standard
    assert {axis.unit_name for axis in cloud.frame.axis_info} == {"metre"}
    assert "Long Island" in cloud.frame.name
    assert cloud.points == pytest.approx(points()[4:], abs=1e-5)
    assert cloud.report.losses == {"points_at_the_scanner_itself": 4}
    assert any("no rotation" in text for text in cloud.report.notes) == (rotation[0] < 0.9)


# ---------------------------------------------------------------- files of others
