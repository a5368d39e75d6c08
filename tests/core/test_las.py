"""LAZ clouds: round trips, the header's statements, what is refused, damaged files."""

import laspy
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pyproj import CRS

from tests.las_files import write_laz
from thalweg.core import (
    GeometryError,
    InputError,
    LazWriter,
    LocalFrame,
    ThalwegError,
    iter_laz,
    laz_header,
    local_crs,
)
from thalweg.core.las import read_laz

FRAME = LocalFrame(lat_deg=51.0501234567890123, lon_deg=13.25, h_ell_m=300.1)
EXTRA = {
    "range": ("f4", "measured range, m"),
    "ring": ("u1", "beam, 0 lowest"),
    "sigma_up": ("u2", "std up, m", 1e-4),
}


def written(folder, *chunks, name="a.laz", **more):
    """The path of a cloud in the local frame, with the extra dimensions."""
    write_laz(folder / name, chunks, FRAME, **{"extra_dimensions": EXTRA, **more})
    return folder / name


def columns(n, seed=0):
    rng = np.random.default_rng(seed)
    n_returns = rng.integers(1, 3, n).astype(np.uint8)
    return {
        "xyz_m": rng.uniform(-200, 200, (n, 3)),
        "t_gps_s": 178649913.4 + np.arange(n) * 1e-5,
        "intensity": rng.integers(0, 256, n).astype(np.uint8),
        "return_number": rng.integers(1, n_returns + 1).astype(np.uint8),
        "number_of_returns": n_returns,
        "classification": rng.integers(0, 200, n).astype(np.uint8),
        "extra": {"range": rng.random(n), "ring": np.arange(n) % 16, "sigma_up": rng.uniform(0, 6, n)},
    }


@pytest.mark.parametrize("scale_m", [0.001, 0.0001])
@pytest.mark.parametrize("suffix", ["laz", "las"])
def test_round_trip(tmp_path, scale_m, suffix):
    path = tmp_path / "deep" / f"a.{suffix}"
    chunks = [columns(n, seed) for seed, n in enumerate((1000, 0, 70_000, 1))]
    assert write_laz(path, chunks, FRAME, scale_m=scale_m, extra_dimensions=EXTRA) == 71_001
    found, header = read_laz(path)

    def given(name):
        return np.concatenate([c.get(name, c["extra"].get(name)) for c in chunks])

    # half a step, and float64 at 200 m
    assert_allclose(found["xyz_m"], given("xyz_m"), rtol=0, atol=scale_m / 2 + 1e-12)
    for name in ("t_gps_s", "return_number", "number_of_returns", "classification", "ring"):
        assert_array_equal(found[name], given(name))
    assert_array_equal(found["intensity"], given("intensity").astype(int) * 256)
    assert_array_equal(found["range"], given("range").astype(np.float32))
    assert_allclose(found["sigma_up"], given("sigma_up"), rtol=0, atol=0.5e-4 + 1e-12)
    assert header.frame == FRAME  # every digit of the origin
    assert (header.n_points, header.scale_m, header.format_version) == (71_001, scale_m, 1)
    assert header.extra_dimensions["range"] == ("<f4", "measured range, m")
    assert not list(path.parent.glob(".*"))


@pytest.mark.parametrize(
    ("at", "value"), [(131, 0.0), (139, -0.001), (147, np.nan), (155, 1e300), (163, -np.inf), (171, np.nan)]
)
def test_scales_and_offsets_that_no_cloud_has(tmp_path, at, value):
    """All points would lie in one place, or none anywhere."""
    path = written(tmp_path, {"xyz_m": np.ones((10, 3))}, name="a.las", extra_dimensions={})
    data = bytearray(path.read_bytes())
    data[at : at + 8] = np.float64(value).tobytes()
    path.write_bytes(data)
    for read in (laz_header, read_laz):
        with pytest.raises(InputError, match=r"scales .*, offsets .*; expected scales between 0 and 10000"):
            read(path)


def test_header_statements_as_laspy_reads_them(tmp_path):
    given = columns(5000)
    path = written(tmp_path, given)
    with laspy.open(path) as reader:
        header = reader.header
        las = reader.read()
    assert (str(header.version), header.point_format.id) == ("1.4", 6)
    assert header.global_encoding.wkt
    assert header.global_encoding.gps_time_type == laspy.header.GpsTimeType.STANDARD
    assert_allclose(header.mins, given["xyz_m"].min(axis=0), atol=5.1e-4)
    assert_allclose(header.maxs, given["xyz_m"].max(axis=0), atol=5.1e-4)
    counts = np.bincount(given["return_number"], minlength=16)[1:16]
    assert_array_equal(header.number_of_points_by_return, counts)
    assert_array_equal(header.scales, [0.001] * 3)
    assert_array_equal(las.gps_time, given["t_gps_s"])
    # an extreme that is stated wrong is worse than none
    stated = header.vlrs.get("ExtraBytesVlr")[0].extra_bytes_structs
    assert [(each.min, each.max) for each in stated] == [(None, None)] * len(EXTRA)
    # the day of the data: 2017-05-12, not of the run
    assert str(header.creation_date) == "2017-05-12"
    crs = header.parse_crs()
    assert crs.is_engineering
    assert "51.05012345678901" in crs.datum.name


def test_same_input_gives_the_same_bytes(tmp_path):
    one, two = (written(tmp_path, columns(60_000), name=name) for name in ("a.laz", "b.laz"))
    assert one.read_bytes() == two.read_bytes()


@pytest.mark.parametrize("code", [25833, 32633, 9518])
def test_map_coordinates(tmp_path, code):
    path, crs = tmp_path / "a.laz", CRS(code)
    xyz = np.array([[410_000.1234, 5_656_789.9876, 112.5], [410_050.0, 5_656_700.0, 99.9999]])
    if not crs.is_projected:
        with pytest.raises(GeometryError, match="expected a local frame or a projected CRS"):
            LazWriter(path, crs)
        return
    write_laz(path, [{"xyz_m": xyz}], crs)
    found, header = read_laz(path)
    assert header.frame == crs
    assert_allclose(found["xyz_m"], xyz, rtol=0, atol=0.5e-3 + 1e-9)
    assert np.isnan(found["t_gps_s"]).all()
    with laspy.open(path) as reader:
        wkt = next(v for v in reader.header.vlrs if v.user_id == "LASF_Projection").string
    # LAS 1.4 asks for WKT 1
    assert wkt.startswith("PROJCS")
    assert CRS.from_wkt(wkt).to_epsg() == code


def test_colours_make_format_7(tmp_path):
    rgb = np.array([[0, 128, 255], [1, 2, 3]], dtype=np.uint8)
    path = written(tmp_path, {"xyz_m": np.zeros((2, 3)), "rgb": rgb}, extra_dimensions={})
    found, header = read_laz(path)
    assert header.point_format == 7
    assert_array_equal(found["rgb"], rgb.astype(int) * 256)


def test_engineering_crs_says_the_origin():
    crs = local_crs(FRAME)
    assert [a.direction for a in crs.axis_info] == ["east", "north", "up"]
    assert CRS.from_wkt(crs.to_wkt("WKT2_2019")) == crs


def test_empty_cloud_is_a_valid_file(tmp_path):
    assert write_laz(tmp_path / "a.laz", [], FRAME, extra_dimensions=EXTRA) == 0
    found, header = read_laz(tmp_path / "a.laz")
    assert found["xyz_m"].shape == (0, 3)
    assert "range" in found
    assert header.frame == FRAME


def test_an_error_leaves_the_old_file(tmp_path):
    path = written(tmp_path, columns(10))
    before = path.read_bytes()
    chunks = [{"xyz_m": np.zeros((5, 3))}, {"xyz_m": np.full((5, 3), np.nan)}]
    with pytest.raises(GeometryError):
        written(tmp_path, *chunks, extra_dimensions={})
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.laz"]


XYZ = np.zeros((3, 3))


@pytest.mark.parametrize(
    ("calls", "fragment"),
    [
        ([{"xyz_m": np.zeros((3, 2))}], r"points of shape \(3, 2\)"),
        ([{"xyz_m": np.full((3, 3), np.inf)}], "9 values of 'xyz_m' are not finite"),
        ([{"xyz_m": XYZ, "t_gps_s": [1.0, np.nan, 2.0]}], "1 values of 't_gps_s' are not finite"),
        ([{"xyz_m": XYZ, "t_gps_s": [1.0]}], r"column 't_gps_s' of shape \(1,\)"),
        ([{"xyz_m": XYZ, "intensity": np.zeros(3)}], "'intensity' of type float64; expected uint8 or uint16"),
        ([{"xyz_m": XYZ, "return_number": [0, 1, 1]}], "expected 1 <= return_number"),
        ([{"xyz_m": XYZ, "return_number": [2, 1, 1]}], "expected 1 <= return_number"),
        ([{"xyz_m": XYZ, "number_of_returns": [16, 1, 1]}], "number_of_returns <= 15"),
        ([{"xyz_m": XYZ, "classification": [256, 1, 1]}], "'classification' do not fit uint8"),
        ([{"xyz_m": XYZ, "extra": {"no": [1, 2, 3]}}], "extra dimensions"),
        ([{"xyz_m": XYZ}, {"xyz_m": XYZ, "t_gps_s": [1, 2, 3]}], "as before"),
        ([{"xyz_m": XYZ}, {"xyz_m": XYZ + 2.2e6}], "x = 2200000.000 m cannot be stored"),
        ([{"xyz_m": XYZ}, {"xyz_m": XYZ - [0, 0, 2.2e6]}], "z = -2200000.000 m cannot be stored"),
    ],
)
def test_refused_points(tmp_path, calls, fragment):
    with pytest.raises(GeometryError, match=fragment) as caught:
        written(tmp_path, *calls, extra_dimensions={})
    assert "a.laz" in str(caught.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("extra", "values", "fragment"),
    [
        ({"ring": ("u1", "beam")}, [300, 0, 0], "'ring' do not fit uint8"),
        ({"s": ("u2", "std, m", 1e-4)}, [np.nan, 0, 0], "'s' do not fit uint16"),
        ({"s": ("u2", "x" * 33)}, [0, 0, 0], "33 bytes; expected at most 32"),
    ],
)
def test_refused_extra_dimensions(tmp_path, extra, values, fragment):
    with pytest.raises(GeometryError, match=fragment):
        written(tmp_path, {"xyz_m": XYZ, "extra": dict.fromkeys(extra, values)}, extra_dimensions=extra)


@pytest.mark.parametrize("scale_m", [0.0, -0.001, 0.1, float("nan")])
def test_refused_scale(tmp_path, scale_m):
    with pytest.raises(GeometryError, match="scale_m="):
        LazWriter(tmp_path / "a.laz", FRAME, scale_m=scale_m)


@pytest.mark.parametrize("suffix", ["laz", "las"])
def test_cut_file_is_no_whole_result(tmp_path, suffix):
    path = written(tmp_path, columns(1000), name=f"a.{suffix}")
    path.write_bytes(path.read_bytes()[:-4000])
    assert laz_header(path).n_points == 1000
    found = 0
    with pytest.raises(InputError, match=r"a\.la"):  # noqa: PT012
        for chunk in iter_laz(path, 10):
            found += len(chunk["xyz_m"])
    # a point of format 6 and its three extra dimensions have 37 bytes
    assert suffix == "laz" or found == 1000 - -(-4000 // 37)


@pytest.mark.parametrize(
    ("old", "new", "fragment"),
    [
        (b'"format_version": 1', b'"format_version": 9', "newer version"),
        (b'"lat_deg"', b'"let_deg"', "VLR is damaged"),
        (b'{"format_version"', b'\x00"format_version"', "no JSON .* the thalweg VLR"),
    ],
)
def test_damaged_facts(tmp_path, old, new, fragment):
    path = written(tmp_path, columns(10))
    raw = path.read_bytes()
    assert raw.count(old) == 1
    path.write_bytes(raw.replace(old, new))
    with pytest.raises(InputError, match=fragment):
        laz_header(path)


def test_week_time_of_others_is_not_taken_for_gps_time(tmp_path):
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.xyz = np.ones((2, 3))
    las.gps_time = np.array([5.0, 6.0])
    las.write(str(tmp_path / "a.laz"))
    found, header = read_laz(tmp_path / "a.laz")
    assert not header.standard_time
    assert np.isnan(found["t_gps_s"]).all()
    assert_array_equal(found["t_week_s"], [5.0, 6.0])


def test_fuzz_laz(tmp_path, fuzz, capfd):
    source, path = written(tmp_path, columns(300)), tmp_path / "fuzz.laz"
    for data in fuzz.inputs(source.read_bytes(), most=1, longest=10, head=2200):
        path.write_bytes(data)
        try:
            found, header = read_laz(path)
        except ThalwegError:
            continue
        fuzz.was_read()
        assert len(found["xyz_m"]) == header.n_points
    capfd.readouterr()  # the Rust library prints its panics
    fuzz.check(read=0.15, troubled=0.3)
