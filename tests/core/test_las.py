"""LAZ clouds: round trips, the header's statements, what is refused, damaged files."""

import io
import struct

import laspy
import lazrs
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
from thalweg.core.las import laz_layout, read_laz, whole_chunks

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
    assert header.notes == ()
    low, high = given("xyz_m")[:1000].min(axis=0), given("xyz_m")[:1000].max(axis=0)
    assert header.offsets_m == tuple(np.round((low + high) / 2))  # the middle of the first points
    low, high = given("xyz_m").min(axis=0), given("xyz_m").max(axis=0)
    assert_allclose(header.box_m, [low, high], rtol=0, atol=scale_m / 2 + 1e-9)
    assert not list(path.parent.glob(".*"))


def test_limits_of_what_is_written(tmp_path):
    """The coarsest scale, the longest name, the most returns, a time of 0, and the last number of 32 bits."""
    extra = {"n" * 32: ("u1", "d" * 32)}
    far = np.array([[-21_474_836.47, 0, 0], [21_474_836.47, 0, 0], [0, -21_474_836.48, 0]])
    given = {"xyz_m": far + 3.0, "t_gps_s": [0.0, 1.0, 2.0], "extra": {"n" * 32: [0, 255, 7]}}
    given |= {"return_number": [1, 15, 3], "number_of_returns": [15, 15, 3]}
    path = written(tmp_path, given, extra_dimensions=extra, scale_m=0.01, offset_m=[3.0, 3.0, 3.0])
    found, header = read_laz(path)
    assert header.offsets_m == (3.0, 3.0, 3.0)
    assert_allclose(found["xyz_m"], far + 3.0, rtol=0, atol=1e-8)
    for name, values in (given | given["extra"]).items():
        if name not in ("xyz_m", "extra"):
            assert_array_equal(found[name], values)
    for axis, sign in ((0, 1), (1, -1)):
        beyond = np.zeros((2, 3))
        beyond[1, axis] = sign * 21_474_836.49
        with pytest.raises(
            GeometryError, match=rf"{'xy'[axis]} = {beyond[1, axis]:.3f} m .* within 21474836"
        ):
            written(tmp_path, {"xyz_m": beyond}, extra_dimensions={}, scale_m=0.01, offset_m=np.zeros(3))
    with pytest.raises(GeometryError, match=r"at most 0\.01 m"):
        LazWriter(tmp_path / "b.laz", FRAME, scale_m=0.015)


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


def of_others(path, *, version="1.4", kind=6, n=20, bytes_more=0):
    """A cloud by laspy with another scale along each axis."""
    header = laspy.LasHeader(point_format=kind, version=version)
    header.scales, header.offsets = np.array([0.001, 0.002, 0.005]), np.array([10.0, 20.0, 30.0])
    header.add_extra_dims([laspy.ExtraBytesParams(f"more_{k}", "u1") for k in range(bytes_more)])
    las = laspy.LasData(header)
    las.xyz = np.arange(3.0 * n).reshape(n, 3)
    las.write(str(path))
    return path


VERSIONS = [("1.0", 0), ("1.1", 1), ("1.2", 2), ("1.2", 3), ("1.3", 4), ("1.3", 5)]


@pytest.mark.parametrize(("version", "kind"), [*VERSIONS, *(("1.4", kind) for kind in range(6, 11))])
def test_any_version_and_point_format_without_a_byte_to_spare(tmp_path, version, kind):
    path = of_others(tmp_path / "a.las", version="1.1" if version == "1.0" else version, kind=kind)
    raw = bytearray(path.read_bytes())
    raw[25] = int(version[-1])
    path.write_bytes(raw)
    found, header = read_laz(path)
    assert (header.point_format, header.n_points) == (kind, 20)
    assert_allclose(found["xyz_m"], np.arange(60.0).reshape(20, 3), atol=1e-9)
    assert (header.scales_m, header.offsets_m) == ((0.001, 0.002, 0.005), (10.0, 20.0, 30.0))
    # one point more than there can be
    room = len(raw) - struct.unpack_from("<I", raw, 96)[0]
    struct.pack_into(*(("<Q", raw, 247) if version == "1.4" else ("<I", raw, 107)), 1000 * room + 1001)
    path.write_bytes(raw)
    words = f"points: {1000 * room + 1001:,} in a file of {len(raw):,} bytes; expected 0 to "
    with pytest.raises(InputError, match=f"{words}{1000 * room + 1000:,}"):
        laz_header(path)


def test_sizes_that_contradict_the_file(tmp_path):
    path = written(tmp_path, {"xyz_m": np.ones((10, 3))}, name="a.las", extra_dimensions={})
    good = path.read_bytes()
    size, start = len(good), struct.unpack_from("<I", good, 96)[0]
    n_vlrs = struct.unpack_from("<I", good, 100)[0]
    whole = f"in a file of {size:,} bytes; expected"
    for numbers, words in (
        ({94: ("<H", 374)}, f"header size: 374 {whole} 375 to {size:,}"),
        ({94: ("<H", size + 1)}, f"header size: {size + 1:,} {whole} 375 to {size:,}"),
        ({100: ("<I", 1000)}, f"first byte of the points: {start:,} {whole} 54,375 to {size:,}"),
        (
            {96: ("<I", 375 + 54 * n_vlrs - 1)},
            f"points: {375 + 54 * n_vlrs - 1:,} {whole} {375 + 54 * n_vlrs:,}",
        ),
        ({96: ("<I", size + 1)}, f"first byte of the points: {size + 1:,} {whole}"),
        (
            {235: ("<QI", size - 119, 2)},
            f"end of the extended VLRs: {size + 1:,} {whole} {start:,} to {size:,}",
        ),
        ({235: ("<QI", start - 121, 2)}, f"end of the extended VLRs: {start - 1:,} {whole} {start:,}"),
        ({104: ("<B", 11)}, f"point format: 11 {whole} 0 to 10"),
        ({105: ("<H", 29)}, f"point record length: 29 {whole} 30 to 1,024"),
        ({105: ("<H", 1025)}, f"point record length: 1,025 {whole} 30 to 1,024"),
        ({25: ("<B", 9)}, r"LAS version 1\.9; expected 1\.0 to 1\.4"),
        ({24: ("<B", 2)}, r"LAS version 2\.4"),
        ({131: ("<d", 1e4)}, "scales 10000, 0.001, 0.001"),
        ({155: ("<d", 1e11)}, r"offsets 1e\+11, 1, 1; expected .*, offsets within 1e\+11 of 0"),
        ({155: ("<d", -1e11)}, r"offsets -1e\+11"),
        ({155: ("<d", 1.01e9)}, r"coordinates in steps of .* from \[1010000000\.0, 1\.0, 1\.0\]"),
        ({155: ("<d", -1.01e9)}, "coordinates in steps of"),
        ({247: ("<Q", 11)}, "the file ends after 10 points; expected 11 points"),
    ):
        raw = bytearray(good)
        for at, (form, *values) in numbers.items():
            struct.pack_into(form, raw, at, *values)
        path.write_bytes(raw)
        with pytest.raises(InputError, match=words):
            read_laz(path)
    for n, words in (
        (3, "begins with 4c 41 53; expected 4c 41 53 46"),
        (226, "cut inside the header: 226 bytes; expected at least 227"),
        (374, "cut inside the header: 374 bytes; expected at least 375"),
        (375, "header size|first byte of the points"),
    ):
        path.write_bytes(good[:n])
        with pytest.raises(InputError, match=words):
            laz_header(path)
    for number in (0.99e9, -0.99e9):
        raw = bytearray(good)
        struct.pack_into("<d", raw, 155, number)
        path.write_bytes(raw)
        assert laz_header(path).offsets_m[0] == number


@pytest.mark.parametrize(
    ("version", "kind", "bytes_more", "layers"),
    [("1.2", 3, 0, 0), ("1.4", 6, 0, 9), ("1.4", 6, 2, 11), ("1.4", 7, 0, 10), ("1.4", 8, 0, 11)],
)
def test_layout_of_compressed_points(tmp_path, version, kind, bytes_more, layers):
    """Nine layers of a point, one of colours, one more of infrared, and one of each byte more."""
    path = of_others(tmp_path / "a.laz", version=version, kind=kind, bytes_more=bytes_more)
    layout = laz_layout(path)
    assert (layout.record, layout.layers) == ({3: 34, 6: 30, 7: 36, 8: 38}[kind] + bytes_more, layers)
    assert layout.start == struct.unpack_from("<I", path.read_bytes(), 96)[0]
    assert bool(whole_chunks(path, layout)[0]) == bool(layers)
    assert laz_layout(of_others(tmp_path / "a.las")) is None


def test_chunks_that_contradict_the_file(tmp_path):
    """The table behind the points, written as a library writes it, with sizes that are a byte off."""
    path = written(tmp_path, columns(60_000))
    good, layout = path.read_bytes(), laz_layout(path)
    record, first = lazrs.LazVlr(layout.laszip), layout.start + 8
    table_at = struct.unpack_from("<q", good, layout.start)[0]
    with path.open("rb") as stream:
        stream.seek(layout.start)
        (_, a), (_, b) = lazrs.read_chunk_table(stream, record)
    table = [(50_000, a), (10_000, b)]
    assert whole_chunks(path, layout) == (table, table_at)

    def patched(table=None, at=None, n=None, points=60_000):
        raw = bytearray(good)
        struct.pack_into("<Q", raw, 247, points)
        if table is not None:
            out = io.BytesIO()
            lazrs.write_chunk_table(out, table, record)
            raw[table_at:] = out.getvalue()
        if at is not None:
            struct.pack_into("<q", raw, layout.start, at)
        if n is not None:
            struct.pack_into("<I", raw, table_at + 4, n)
        return bytes(raw)

    most = (table_at - first) // layout.record
    for raw, words in (
        (
            patched([(50_000, a - 1), (10_000, b + 1)]),
            f"the layers of chunk 1 of 2 exceed its {a - 1:,} bytes",
        ),
        (patched([(50_000, a + 1), (10_000, b)]), f"chunk 2 of 2 claims {b:,} bytes"),
        (patched(at=len(good) - 7), f"the chunk table should be at byte {len(good) - 7:,} of {len(good):,}"),
        (patched(at=first - 1), f"the chunk table should be at byte {first - 1:,}"),
        (patched(n=most + 1), f"{most + 1:,} chunks in {table_at - first:,} bytes"),
        (patched(points=100)[: layout.start + 7], "the file ends before the points"),
    ):
        path.write_bytes(raw)
        with pytest.raises(InputError, match=f"{words}.*; expected a chunk table that fits"):
            read_laz(path)
    # a writer that cannot go back leaves -1, and the place of the table at the end
    path.write_bytes(patched(at=-1) + struct.pack("<q", table_at))
    assert len(read_laz(path)[0]["xyz_m"]) == 60_000
    assert whole_chunks(path, layout) == (table, table_at)
    for end, left in ((table_at - 1, 1), (first + a, 1), (first + a - 1, 0), (first + 20, 0)):
        path.write_bytes(good[:end])
        assert whole_chunks(path, layout) == (table[:left], first + left * a)
    at = good.index(b"laszip encoded") + 52
    for place, form, value in ((0, "<H", 4), (12, "<I", 0), (12, "<I", (1 << 26) + 1), (36, "<H", 31)):
        raw = bytearray(good)
        struct.pack_into(form, raw, at + place, value)
        path.write_bytes(raw)
        with pytest.raises(InputError, match=r"the LASzip record .* contradicts 37-byte points"):
            laz_layout(path)
    raw = bytearray(good)
    struct.pack_into("<I", raw, at + 12, 0xFFFFFFFF)  # chunks of any length
    path.write_bytes(raw)
    assert laz_layout(path).layers == layout.layers == 9 + 7


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
    assert header.offsets_m == (0.0, 0.0, 0.0)


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
