"""Signed distances beside trimesh (small sets, float64) and CloudCompare (same files)."""

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.surface import rough_bank
from thalweg.core.geometry import TriangleMesh
from thalweg.surface import Surface


def ours_and_trimesh(theirs: trimesh.Trimesh, points: np.ndarray):
    mesh = TriangleMesh(
        vertices_m=np.array(theirs.vertices),
        faces=np.array(theirs.faces, dtype=np.int64),
        sigma_m=np.zeros(len(theirs.vertices)),
    )
    return Surface(mesh).distances(points), trimesh.proximity.closest_point(theirs, points)


@pytest.mark.parametrize("shift", [0.0, 5e6], ids=["local", "map"])
@pytest.mark.parametrize("shape", ["sphere", "box"])
def test_closed_bodies_beside_trimesh(rng, shape, shift):
    """Distances, places and signs; trimesh counts inside as positive."""
    body = trimesh.creation.icosphere(3, 2.0) if shape == "sphere" else trimesh.creation.box((1, 2, 3))
    body.apply_translation([shift] * 3)
    points = rng.uniform(-3, 3, (2000, 3)) + shift
    found, (place, distance, _) = ours_and_trimesh(body, points)
    # rounding: one step of a number at 5e6 m is 0.9 nm, at 3 m it is 4e-16 m
    limit = 3e-9 if shift else 1e-14
    np.testing.assert_allclose(np.abs(found.distance_m), distance, rtol=0, atol=limit)
    clear = np.abs(found.distance_m) > 1e-8  # trimesh takes less for the surface itself
    sign = -np.sign(trimesh.proximity.signed_distance(body, points))
    assert np.array_equal(np.sign(found.distance_m[clear]), sign[clear])
    assert not found.at_border.any()
    if not shift:
        # from the middle of a box several places are equally near
        same = np.linalg.norm(found.nearest_m - place, axis=1) < 1e-12
        assert same.mean() > 0.999


# ---------------------------------------------------------------- CloudCompare


def cloud_compare(folder: Path, points: np.ndarray, mesh: TriangleMesh) -> np.ndarray:
    """Signed distances (n,) by CloudCompare, float32.

    The compared cloud is loaded first, the mesh last. Coordinates are local, so that no global shift is
    applied; the result is binary, because text would be rounded.
    """
    program = shutil.which("CloudCompare")
    if program is None:
        pytest.skip("CloudCompare is not installed (Debian package cloudcompare)")
    rough_bank.write_ply(folder / "points.ply", points)
    rough_bank.write_ply(folder / "mesh.ply", mesh.vertices_m, mesh.faces)
    run = subprocess.run(
        [
            *(
                program,
                "-SILENT",
                "-AUTO_SAVE",
                "OFF",
                "-C_EXPORT_FMT",
                "PLY",
                "-PLY_EXPORT_FMT",
                "BINARY_LE",
            ),
            *("-O", "points.ply", "-O", "mesh.ply", "-C2M_DIST", "-SAVE_CLOUDS", "FILE", "out.ply"),
        ],
        cwd=folder,
        env={**os.environ, "QT_QPA_PLATFORM": "offscreen"},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr[-2000:]
    _, body = (folder / "out.ply").read_bytes().split(b"end_header\n", 1)
    table = np.frombuffer(body, dtype="<f4").reshape(len(points), 4).astype(np.float64)
    assert np.array_equal(table[:, :3], points)  # same order, nothing shifted
    return table[:, 3]


@pytest.mark.parametrize(
    ("rough_m", "most_signs"),
    [
        (0.003, 0.0),  # 7 degrees between neighbouring faces in the median, 32 at the 99th percentile
        (0.02, 0.01),  # 27 and 103 degrees
    ],
    ids=["natural", "stones"],
)
def test_cloud_compare_agrees_on_the_same_files(tmp_path, rough_m, most_signs):
    """200,000 faces, 30,000 points: same distances; where signs differ, the height field says who is right.

    CloudCompare takes the side of one nearest face. Where an edge is nearest, and one of its faces turns its
    back on the point, that may be the wrong one.
    """
    bank = rough_bank.RoughBank(500, 201, step_m=0.05, rough_m=rough_m)
    points = bank.points(30_000)
    theirs = cloud_compare(tmp_path, points, bank.mesh)
    found = Surface(bank.mesh).distances(points)
    # 1e-7: its result is float32, of distances below a metre; the median must be below 1e-4
    np.testing.assert_allclose(np.abs(found.distance_m), np.abs(theirs), rtol=0, atol=1e-7)
    other_sign = np.sign(found.distance_m) != np.sign(theirs)
    assert np.median(np.abs(found.distance_m - theirs)) < 1e-7
    inner = other_sign & ~found.at_border
    side = bank.above(points[inner])
    assert (np.sign(found.distance_m[inner]) == side)[side != 0].all()
    assert inner.mean() <= most_signs
