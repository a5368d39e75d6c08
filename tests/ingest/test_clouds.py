"""Clouds of other makers: against plyfile, laspy and pye57, cut and damaged files."""

from pathlib import Path

import laspy
import numpy as np
import pye57
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from plyfile import PlyData, PlyElement
from pyproj import CRS

from thalweg.core import ArrayF, InputError, LazWriter, LocalFrame, ThalwegError, UnsupportedError
from thalweg.ingest import IntegrityReport
from thalweg.ingest.clouds import read_cloud
from thalweg.ingest.clouds.reader import _without_height, eight_bit, single_step_m

N = 1000
FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)


def points(n: int = N, seed: int = 1) -> ArrayF:
    return np.random.default_rng(seed).uniform(-50, 50, (n, 3)).round(3)


def write_ply(
    path: Path, *, text: bool = False, order: str = "<", single: bool = False, faces: bool = True
) -> None:
    xyz = points()
    kind = "f4" if single else "f8"
    fields = [("x", kind), ("y", kind), ("z", kind), ("nx", "f4"), ("ny", "f4"), ("nz", "f4")]
    fields += [("red", "u1"), ("green", "u1"), ("blue", "u1"), ("intensity", "f4")]
    vertex = np.zeros(N, fields)
    for axis, name in enumerate("xyz"):
        vertex[name] = xyz[:, axis]
    vertex["nz"], vertex["red"], vertex["blue"], vertex["intensity"] = (
        1.0,
        np.arange(N) % 256,
        7,
        np.arange(N) / 8,
    )
    elements = [PlyElement.describe(vertex, "vertex", comments=["from a scanner"])]
    if faces:
        face = np.array([([0, 1, 2],), ([1, 2, 3],)], dtype=[("vertex_indices", "i4", (3,))])
        elements.append(PlyElement.describe(face, "face"))
    PlyData(elements, text=text, byte_order=order).write(str(path))


def write_las(path: Path, version: str = "1.2", point_format: int = 3) -> None:
    header = laspy.LasHeader(point_format=point_format, version=version)
    header.scales, header.offsets = np.full(3, 0.001), np.zeros(3)
    header.add_crs(CRS(25833))
    las = laspy.LasData(header)
    las.xyz = points()
    las.intensity = np.arange(N)
    las.red = las.green = las.blue = np.arange(N) * 60
    las.gps_time = np.arange(N)
    las.write(str(path))


def write_e57(path: Path, scans: int = 2) -> None:
    file = pye57.E57(str(path), mode="w")
    for index in range(scans):
        xyz = points(seed=index)
        data = {f"cartesian{axis}": np.ascontiguousarray(xyz[:, i]) for i, axis in enumerate("XYZ")}
        data["intensity"] = np.linspace(0, 1, N).astype(np.float32)
        for name in ("Red", "Green", "Blue"):
            data[f"color{name}"] = (np.arange(N) % 256).astype(np.uint8)
        half = np.sqrt(0.5)  # 90 degrees about z
        rotation = np.array([half, 0.0, 0.0, half]) if index else np.array([1.0, 0.0, 0.0, 0.0])
        file.write_scan_raw(data, rotation=rotation, translation=np.array([100.0 * index, 0.0, 5.0 * index]))
    file.close()


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("text", [True, False])
@pytest.mark.parametrize("single", [True, False])
def test_ply_as_plyfile_reads_it(tmp_path, order, text, single):
    path = tmp_path / "a.ply"
    write_ply(path, text=text, order=order, single=single)
    theirs = PlyData.read(str(path))["vertex"]
    cloud = read_cloud(path)
    for axis, name in enumerate("xyz"):
        if text and single:
            # ours takes the digits as doubles, plyfile rounds them to float32: 50 m x 2^-24
            assert_allclose(cloud.points[:, axis], theirs[name], atol=4e-6)
        else:
            assert_array_equal(cloud.points[:, axis], theirs[name])
    assert_array_equal(cloud.rgb[:, 0], theirs["red"])
    assert_array_equal(cloud.intensity, theirs["intensity"])
    assert cloud.crs is None
    assert cloud.report.losses == {}
    assert any("2 elements 'face'" in note for note in cloud.report.notes)


@pytest.mark.parametrize("word", ["comment", "obj_info"])
def test_ply_remarks_that_matter(tmp_path, word):
    """MeshLab and scanners write obj_info where others write comment."""
    head = f"ply\nformat ascii 1.0\n{word} {{}}\nelement vertex 1\n"
    head += "property double x\nproperty double y\nproperty double z\nend_header\n1 2 3\n"
    path = tmp_path / "a.ply"
    path.write_text(head.format("offset 412000 5650000 0"))
    assert any("'offset 412000 5650000 0': coordinates are taken" in n for n in read_cloud(path).report.notes)
    path.write_text(head.format("units: feet"))
    with pytest.raises(InputError, match="units: feet"):
        read_cloud(path)


def test_ply_float_colours(tmp_path):
    head = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n"
    head += "property float red\nproperty float green\nproperty float blue\nend_header\n"
    (tmp_path / "a.ply").write_text(head + "1 2 3 0 0.5 1\n4 5 6 1 1 1\n")
    rgb = read_cloud(tmp_path / "a.ply").rgb
    assert_array_equal(rgb, [[0, 128, 255], [255, 255, 255]])


@pytest.mark.parametrize(
    ("values", "kind", "expected", "note"),
    [
        ([0, 7, 255], "u1", [0, 7, 255], False),
        ([0.0, 0.5, 1.0], "f4", [0, 128, 255], False),
        ([0.0, 1.6, 300.0], "f4", [0, 2, 255], False),
        ([np.nan, np.inf, 1.0], "f8", [0, 0, 255], False),
        ([-1, 7, 255], "i2", [0, 7, 255], False),
        ([0, 255, 256], "u2", [0, 0, 1], True),
        ([-300, 512, 65_535], "i4", [0, 2, 255], True),
    ],
)
def test_colours_become_eight_bits(values, kind, expected, note):
    report = IntegrityReport(stream="cloud", format="", files=[])
    found = eight_bit(np.array(values, kind), report)
    assert (found.dtype, found.tolist()) == (np.uint8, expected)
    assert report.notes == ["Colours of 16 bit are brought to 8 bit."] * note
    assert eight_bit(np.zeros((0, 3), kind), report).shape == (0, 3)


def test_steps_of_single_precision():
    """2^-23 of the power of two below: of 50 it is 32, of 1024 itself."""
    assert single_step_m(np.array([1.0, -50.0, np.nan, np.inf])) == 32 * 2.0**-23
    assert single_step_m(np.array([1024.0])) == 1024 * 2.0**-23
    assert single_step_m(np.array([np.nan])) == single_step_m(np.array([])) == 2.0**-149
    assert np.isfinite(single_step_m(np.array([1e300])))


def test_heights_that_stand_for_none_are_found_one_behind_another():
    z = np.array([*np.linspace(100, 101, 30), -9999.0, 9999.0, -32768.0, -9999.0, np.nan])
    good = np.isfinite(z)
    good[31] = False  # that was left out before
    assert np.flatnonzero(_without_height(z, good)).tolist() == [30, 32, 33]
    assert not _without_height(z[:1], good[:1]).any()
    assert not _without_height(z[:0], good[:0]).any()


def test_ply_map_coordinates_in_single_precision_are_said(tmp_path):
    vertex = np.zeros(5, [("x", "f4"), ("y", "f4"), ("z", "f4")])
    vertex["y"] = 5_656_789.123
    PlyData([PlyElement.describe(vertex, "vertex")], byte_order="<").write(str(tmp_path / "a.ply"))
    # float32 at 5.6e6 resolves 0.5 m
    assert any("resolve 500 mm only" in note for note in read_cloud(tmp_path / "a.ply").report.notes)


@pytest.mark.parametrize("shift", ["in the pose", "in the numbers"])
def test_e57_in_single_precision_is_said_unless_the_pose_holds_the_shift(tmp_path, shift):
    place = np.array([377_000.0, 5_656_000.0, 300.0])
    xyz = points() + (0.0 if shift == "in the pose" else place)
    file = pye57.E57(str(tmp_path / "a.e57"), mode="w")  # pye57 writes single precision
    data = {f"cartesian{axis}": np.ascontiguousarray(xyz[:, i]) for i, axis in enumerate("XYZ")}
    where = {"rotation": np.array([1.0, 0, 0, 0]), "translation": place} if shift == "in the pose" else {}
    file.write_scan_raw(data, **where)
    file.close()
    cloud = read_cloud(tmp_path / "a.e57")
    told = [note for note in cloud.report.notes if "resolve 500 mm only" in note]
    if shift == "in the pose":
        assert not told
        assert cloud.step_m == np.spacing(np.float32(49.9))
    else:
        assert told
        assert cloud.step_m == 0.5  # float32 at 5.6e6


def test_las_with_a_coarse_scale_is_said(tmp_path):
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales, header.offsets = np.full(3, 0.25), np.zeros(3)
    las = laspy.LasData(header)
    las.xyz = points()
    las.write(str(tmp_path / "a.las"))
    cloud = read_cloud(tmp_path / "a.las")
    assert cloud.step_m == 0.25
    assert any("resolve 250 mm only" in note for note in cloud.report.notes)


def test_points_not_finite_are_dropped_and_counted(tmp_path):
    vertex = np.zeros(10, [("x", "f8"), ("y", "f8"), ("z", "f8"), ("intensity", "f4")])
    vertex["x"][3], vertex["z"][7] = np.nan, np.inf
    vertex["intensity"] = np.arange(10)
    PlyData([PlyElement.describe(vertex, "vertex")], byte_order="<").write(str(tmp_path / "a.ply"))
    cloud = read_cloud(tmp_path / "a.ply")
    assert cloud.report.losses == {"points_not_finite": 2}
    assert_array_equal(cloud.intensity, [0, 1, 2, 4, 5, 6, 8, 9])


@pytest.mark.parametrize("text", [True, False])
def test_cut_ply_keeps_whole_vertices(tmp_path, text):
    path = tmp_path / "a.ply"
    write_ply(path, text=text, faces=False)
    raw = path.read_bytes()
    path.write_bytes(raw[: len(raw) // 2])
    cloud = read_cloud(path)
    lost = sum(cloud.report.losses.values())
    assert 400 < lost < 600
    assert len(cloud.points) + lost == N
    assert_array_equal(cloud.points, points()[: len(cloud.points)])


@pytest.mark.parametrize(("version", "point_format"), [("1.2", 3), ("1.4", 7)])
@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_las_of_others(tmp_path, version, point_format, suffix):
    path = tmp_path / f"a.{suffix}"
    write_las(path, version, point_format)
    cloud = read_cloud(path)
    assert_allclose(cloud.points, points(), atol=1e-9)  # whole millimetres
    assert_array_equal(cloud.rgb[:, 1], np.arange(N) * 60 // 256)
    assert cloud.crs.to_epsg() == 25833
    # laspy writes week time unless told otherwise
    assert cloud.t_gps_s is None
    assert any("unstated GPS week" in note for note in cloud.report.notes)


def test_own_laz_returns_its_frame_and_time(tmp_path):
    with LazWriter(tmp_path / "a.laz", FRAME) as writer:
        writer.append(points(), t_gps_s=np.arange(N) + 1.8e8)
    cloud = read_cloud(tmp_path / "a.laz")
    assert cloud.frame == FRAME
    assert cloud.crs.is_engineering
    assert_array_equal(cloud.t_gps_s, np.arange(N) + 1.8e8)
    assert cloud.report.synchronised


def test_cut_laz_keeps_its_whole_chunks(tmp_path):
    path, n = tmp_path / "a.laz", 120_000  # chunks of 50,000 points
    xyz = points(n)
    with LazWriter(path, FRAME, extra_dimensions={"range": ("f4", "m")}) as writer:
        writer.append(xyz, extra={"range": np.ones(n)})
    raw = path.read_bytes()
    path.write_bytes(raw[: int(0.9 * len(raw))])
    cloud = read_cloud(path)
    assert len(cloud.points) == 100_000
    assert_allclose(cloud.points, xyz[:100_000], atol=1e-9)
    assert cloud.report.losses == {"points_missing": 20_000}
    path.write_bytes(raw[: int(0.2 * len(raw))])
    with pytest.raises(InputError, match="chunk table should be at byte"):
        read_cloud(path)


def test_cut_las_keeps_its_whole_records(tmp_path):
    path = tmp_path / "a.las"
    write_las(path)
    raw = path.read_bytes()
    path.write_bytes(raw[: len(raw) - 34 * 100 - 5])  # records of 34 bytes
    cloud = read_cloud(path)
    assert len(cloud.points) == N - 101
    assert cloud.report.losses == {"points_missing": 101}


def test_e57_scans_are_moved_by_their_poses(tmp_path):
    path = tmp_path / "a.e57"
    write_e57(path)
    cloud = read_cloud(path)
    second = points(seed=1)
    expected = np.stack([-second[:, 1] + 100, second[:, 0], second[:, 2] + 5], axis=-1)
    # pye57 writes coordinates in single precision: 50 m x 2^-24
    assert_allclose(cloud.points, np.concatenate([points(seed=0), expected]), rtol=0, atol=4e-6)
    theirs = pye57.E57(str(path)).read_scan(1, intensity=True, colors=True, ignore_missing_fields=True)
    assert_allclose(cloud.points[N:, 0], theirs["cartesianX"], atol=1e-12)
    assert_array_equal(cloud.rgb[N:, 2], theirs["colorBlue"])
    assert_array_equal(cloud.intensity[N:], theirs["intensity"])
    assert cloud.report.counts["scans"] == 2


def test_damaged_e57_keeps_the_points_before_the_defect(tmp_path):
    path = tmp_path / "a.e57"
    write_e57(path, scans=2)
    raw = bytearray(path.read_bytes())
    raw[20_000] ^= 0xFF  # inside the first scan: its page checksum fails
    path.write_bytes(bytes(raw))
    cloud = read_cloud(path)
    assert cloud.report.losses["points_missing"] >= 1
    assert len(cloud.points) + cloud.report.losses["points_missing"] == 2 * N


@pytest.mark.parametrize(
    ("content", "fragment"),
    [
        (b"", "the file is empty"),
        (b"# .PCD v.7\n", "no PCD head"),
        (b"hello, world\n", "begins with"),
        (b"ply\nformat ascii 1.0\n", "the header has no end"),
        (b"ply\nformat ascii 1.0\nelement vertex x\nend_header\n", "line 3 of the header"),
        (b"ply\nformat ascii 9.0\nend_header\n", "line 2 of the header"),
        (
            b"ply\nformat ascii 1.0\nelement face 1\nproperty list uchar int v\nend_header\n3 1 2 3\n",
            "no element",
        ),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n", "expected x, y, z"),
        (
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
            b"end_header\nnan 1 2\n",
            "none of 1 points is finite",
        ),
        (b"LASF" + bytes(100), "cut inside the header"),
        (b"LASF" + bytes(400), "LAS version 0.0"),
        (b"ASTM-E57" + bytes(10), "cannot open the E57 file"),
        (b"ASTM-E57" + bytes(2000), "cannot open the E57 file"),
    ],
)
def test_bad_input_has_a_message(tmp_path, content, fragment):
    path = tmp_path / "bad.bin"
    path.write_bytes(content)
    with pytest.raises(InputError, match=fragment) as caught:
        read_cloud(path)
    assert "bad.bin" in str(caught.value)


def test_lists_in_vertices_are_refused(tmp_path):
    head = "ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int a\nend_header\n1 2\n"
    (tmp_path / "a.ply").write_text(head)
    with pytest.raises(UnsupportedError, match="list properties"):
        read_cloud(tmp_path / "a.ply")


def test_missing_file():
    with pytest.raises(InputError, match="file not found"):
        read_cloud(Path("nowhere.laz"))


@pytest.mark.parametrize("kind", ["ply", "las", "laz", "e57"])
def test_fuzz_clouds(tmp_path, kind, fuzz, capfd):
    source, path = tmp_path / f"a.{kind}", tmp_path / f"fuzz.{kind}"
    {"ply": write_ply, "las": write_las, "laz": write_las, "e57": write_e57}[kind](source)
    for data in fuzz.inputs(source.read_bytes(), most=1, longest=20, head=600):
        path.write_bytes(data)
        try:
            cloud = read_cloud(path)
        except ThalwegError:
            continue
        fuzz.was_read()
        assert np.isfinite(cloud.points).all()
    capfd.readouterr()  # the Rust library prints its panics
    # E57 pages carry check sums and LAZ is compressed: most damage is fatal there
    fuzz.check(read={"ply": 0.4, "las": 0.5, "laz": 0.1, "e57": 0.05}[kind], troubled=0.1)
