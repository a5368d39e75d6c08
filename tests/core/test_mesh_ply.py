"""Mesh files: written and read back, opened by other programs, those of others and damaged ones refused."""

import json
import os
import shutil
import subprocess

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal
from plyfile import PlyData

from thalweg.core import InputError, LocalFrame
from thalweg.core.geometry import TriangleMesh, _open3d, read_mesh, write_mesh

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
# longer than a line of rply may be, and with what JSON must escape
FACTS = {"notes": ["Ufer am „Mühlgraben“ " * 80], "counts": {"given": 7}}


@pytest.fixture
def mesh(rng):
    """A rough patch of 9 x 12 vertices at places that float32 cannot hold."""
    i, j = np.meshgrid(np.arange(9), np.arange(12), indexing="ij")
    v = np.stack([i * 0.1 + 812.3, j * 0.1 - 95.7, rng.normal(0, 0.02, i.shape)], axis=-1).reshape(-1, 3)
    a = (i[:-1, :-1] * 12 + j[:-1, :-1]).ravel()
    faces = np.concatenate([np.stack([a, a + 12, a + 13], axis=1), np.stack([a, a + 13, a + 1], axis=1)])
    return TriangleMesh(vertices_m=v, faces=faces, sigma_m=rng.uniform(0.001, 0.02, len(v)))


@pytest.fixture
def path(mesh, tmp_path):
    write_mesh(tmp_path / "mesh.ply", mesh, FRAME, FACTS)
    return tmp_path / "mesh.ply"


def test_a_mesh_comes_back(mesh, path):
    back, frame, facts = read_mesh(path)
    assert_array_equal(back.vertices_m, mesh.vertices_m)
    assert_array_equal(back.faces, mesh.faces)
    assert_array_equal(back.sigma_m, mesh.sigma_m.astype(np.float32))
    assert (frame, facts) == (FRAME, FACTS)
    assert not list(path.parent.glob(".*"))


def test_the_same_mesh_gives_the_same_bytes(mesh, path):
    write_mesh(path.with_name("again.ply"), mesh, FRAME, FACTS)
    assert path.with_name("again.ply").read_bytes() == path.read_bytes()


def test_plyfile_and_trimesh_and_open3d_open_it(mesh, path):
    data = PlyData.read(str(path))
    assert_array_equal(data["face"]["border"].astype(bool), mesh.border_faces())
    assert 0 < mesh.border_faces().sum() < len(mesh.faces)
    other = trimesh.load_mesh(path, process=False)
    assert_array_equal(other.faces, mesh.faces)
    assert_array_equal(other.vertices, mesh.vertices_m)
    third = _open3d().io.read_triangle_mesh(str(path))
    assert_array_equal(np.asarray(third.triangles), mesh.faces)
    assert_array_equal(np.asarray(third.vertices), mesh.vertices_m)


def test_cloudcompare_opens_it(mesh, path):
    program = shutil.which("CloudCompare")
    if program is None:
        pytest.skip("CloudCompare is not installed")
    run = subprocess.run(
        [
            program,
            "-SILENT",
            "-AUTO_SAVE",
            "OFF",
            "-O",
            path.name,
            "-M_EXPORT_FMT",
            "PLY",
            "-PLY_EXPORT_FMT",
            "BINARY_LE",
            "-SAVE_MESHES",
            "FILE",
            "out.ply",
        ],
        cwd=path.parent,
        env={**os.environ, "QT_QPA_PLATFORM": "offscreen"},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert (path.parent / "out.ply").is_file(), run.stdout[-2000:]
    back = PlyData.read(str(path.parent / "out.ply"))
    assert_array_equal(np.stack(back["face"]["vertex_indices"]), mesh.faces)
    # CloudCompare 2.11 keeps float32: 800 m x 2^-24
    for axis, name in enumerate("xyz"):
        assert_allclose(back["vertex"][name], mesh.vertices_m[:, axis], atol=5e-5)
    with pytest.raises(InputError, match="another program"):
        read_mesh(path.parent / "out.ply")


# ---------------------------------------------------------------- damage


@pytest.mark.parametrize(
    ("change", "answer"),
    [
        (lambda b: b[:-100], "168 of 176 faces are there"),
        (lambda b: b[: b.index(b"end_header") + 500], "vertices are there"),
        (lambda b: b[:200], "the header has no end"),
        (lambda b: b"", "no PLY header"),
        (lambda b: b.replace(b'"format":1', b'"format":7'), "version 7"),
        (lambda b: b.replace(b'"lat_deg":', b'"lat":'), "comment 'thalweg' is damaged"),
        (lambda b: b.replace(b"element face", b"element fact"), "a mesh, not a cloud"),
        (lambda b: b.replace(b"property double y", b"property double q"), "expected x, y, z"),
        (lambda b: b.replace(b"format binary", b"form binary"), "line 2 of the header"),
        (lambda b: b.replace(b"comment thalweg", b"comment another"), "another program"),
        (lambda b: b.replace(b"property float sigma_m", b"property float other_m"), "with sigma_m"),
        (lambda b: b.replace(b"binary_little_endian", b"binary_big_endian"), "binary_little_endian, vert"),
        (lambda b: b[:-14] + b"\x04" + b[-13:], "no triangles"),
    ],
)
def test_damaged_files_are_told(path, change, answer):
    data = path.read_bytes()
    assert change(data) != data
    path.write_bytes(change(data))
    with pytest.raises(InputError, match=answer) as error:
        read_mesh(path)
    assert str(path) in str(error.value)


def test_corners_that_do_not_exist_are_told(mesh, path):
    data = bytearray(path.read_bytes())
    data[-5:-1] = np.int32(100_000).tobytes()
    path.write_bytes(data)
    with pytest.raises(InputError, match="corners from 0 to 100000"):
        read_mesh(path)


def test_no_file_is_told(tmp_path):
    with pytest.raises(InputError, match="file not found"):
        read_mesh(tmp_path / "none.ply")


def test_fuzz(path, fuzz):
    data, intact = path.read_bytes(), read_mesh(path)[0]
    head = data.index(b"end_header")
    for damaged in fuzz.inputs(data, head=head, longest=40):
        path.write_bytes(damaged)
        try:
            read_mesh(path)
        except InputError:
            continue
        fuzz.was_read()
    # bytes of coordinates may change unseen; damage of the header must be told
    fuzz.check(read=0.02, troubled=0.3)
    path.write_bytes(data)
    assert np.array_equal(read_mesh(path)[0].vertices_m, intact.vertices_m)


def test_facts_are_plain_json(path):
    text = path.read_bytes().split(b"end_header")[0].decode("ascii")
    lines = [line for line in text.splitlines() if line.startswith("comment thalweg ")]
    assert max(map(len, text.splitlines())) < 256  # rply's longest word
    told = json.loads("".join(line.removeprefix("comment thalweg ") for line in lines))
    assert told["origin"] == {"lat_deg": 51.05, "lon_deg": 13.25, "h_ell_m": 300.0}
