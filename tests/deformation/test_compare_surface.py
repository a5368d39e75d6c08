"""``thalweg compare``: distances from meshes and clouds of anybody's, where they are known."""

import json
from pathlib import Path
from types import SimpleNamespace

import laspy
import numpy as np
import pandas as pd
import pytest
from plyfile import PlyData, PlyElement

from thalweg.cli import main
from thalweg.core import LazWriter, LocalFrame
from thalweg.core.geometry import TriangleMesh, write_mesh as write_own_mesh

MAP_M = np.array([412_000.0, 5_651_000.0, 150.0])


@pytest.fixture
def no_page(monkeypatch):
    """The page of pictures takes longer than the distances: one test makes it."""
    page = SimpleNamespace(write=lambda _: None)
    monkeypatch.setattr("thalweg.figures.accuracy.cloud_page", lambda *_, **__: page)


def write_mesh(path: Path, corners: np.ndarray, faces: list[tuple[int, int, int]]) -> Path:
    """An ASCII PLY of another program: no word on its frame."""
    head = ["ply", "format ascii 1.0", f"element vertex {len(corners)}"]
    head += [f"property double {axis}" for axis in "xyz"]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    body = [" ".join(f"{value:.6f}" for value in corner) for corner in corners]
    path.write_text("\n".join([*head, *body, *(f"3 {a} {b} {c}" for a, b, c in faces)]) + "\n")
    return path


def points_text(path: Path, points: np.ndarray) -> Path:
    """A table of x y z."""
    np.savetxt(path, points, fmt="%.6f")
    return path


def test_a_mesh_gives_signed_distances_in_map_coordinates(tmp_path, capsys):
    rng = np.random.default_rng(3)
    corners = MAP_M + 10.0 * np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    mesh = write_mesh(tmp_path / "mesh.ply", corners, [(0, 1, 2), (0, 2, 3)])
    height = rng.normal(0.05, 0.01, 500)
    inside = np.column_stack([rng.uniform(1, 9, (500, 2)), height])
    beside, above = [[-3.0, 5, 0.1]], [[5.0, 5, 4.0]]
    cloud = points_text(tmp_path / "cloud.xyz", MAP_M + np.vstack([inside, beside, above]))
    assert main(["compare", str(cloud), str(mesh), "-o", str(tmp_path / "d.csv")]) == 0
    table = pd.read_csv(tmp_path / "d.csv")
    np.testing.assert_allclose(table.distance_m[:500], height, rtol=0, atol=2e-6)
    assert table.used.tolist() == [True] * 500 + [False] * 2
    facts = json.loads((tmp_path / "d.json").read_text())
    counts = facts["counts"]
    assert (counts["points"], counts["compared"], counts["too_far"]) == (502, 500, 2)
    assert facts["all"]["bias_m"] == pytest.approx(height.mean(), abs=1e-6)
    assert facts["all"]["rmse_m"] == pytest.approx(np.sqrt(np.mean(height**2)), abs=1e-6)
    assert "500 compared" in capsys.readouterr().out
    assert "<img" in (tmp_path / "d.html").read_text()


def test_what_the_file_of_a_mesh_states(tmp_path, capsys, no_page):
    """Feet, single precision, and the frame of a mesh of this program count as they do in a cloud."""
    corners = MAP_M + 10.0 * np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    path, faces = tmp_path / "mesh.ply", [(0, 1, 2), (0, 2, 3)]
    places = np.array([[2.0, 3, 0.1], [4, 5, 0.1], [7, 6, 0.1]])
    cloud = points_text(tmp_path / "cloud.xyz", MAP_M + places)
    command = ["compare", str(cloud), str(path), "-o", str(tmp_path / "d.csv"), "--force"]
    text = write_mesh(path, corners, faces).read_text()
    path.write_text(text.replace("ascii 1.0", "ascii 1.0\ncomment units: feet"))
    assert main(command) == 2
    assert "units: feet" in capsys.readouterr().err
    vertex = np.rec.fromarrays(corners.T.astype("f4"), names="x,y,z")
    face = np.array([(each,) for each in faces], dtype=[("vertex_indices", "i4", (3,))])
    parts = [PlyElement.describe(vertex, "vertex"), PlyElement.describe(face, "face")]
    PlyData(parts, byte_order="<").write(str(path))
    assert main(command) == 0
    printed = capsys.readouterr()
    assert "mesh.ply: Coordinates up to 5651010 m resolve 500 mm only" in printed.out + printed.err
    here, there = (LocalFrame(lat_deg=51.0, lon_deg=13.0, h_ell_m=h) for h in (150.0, 151.0))
    mesh = TriangleMesh(vertices_m=corners - MAP_M, faces=np.array(faces), sigma_m=np.zeros(4))
    write_own_mesh(path, mesh, here, {})
    for frame, code in ((here, 0), (there, 2)):
        with LazWriter(tmp_path / "own.laz", frame) as writer:
            writer.append(places)
        assert main(["compare", str(tmp_path / "own.laz"), *command[2:]]) == code
    assert "states a local frame" in capsys.readouterr().err


def wall(rng: np.random.Generator, away_m: float, n: int, noise_m: float) -> np.ndarray:
    """Points of a wall that faces south; positive ``away_m`` lies south of it."""
    east, up = rng.uniform(0, 8, n), rng.uniform(0, 4, n)
    return np.column_stack([east, rng.normal(-away_m, noise_m, n), up])


@pytest.mark.usefixtures("no_page")
def test_a_cloud_is_meshed_and_its_front_is_where_it_was_seen_from(tmp_path):
    rng = np.random.default_rng(4)
    reference = points_text(tmp_path / "tls.xyz", MAP_M + wall(rng, 0.0, 15_000, 0.003))
    cloud = points_text(tmp_path / "boat.txt", MAP_M + wall(rng, 0.04, 4_000, 0.01))
    east, north, up = MAP_M + np.array([4, -30, 2])
    for place, sign in ((f"{east},{north},{up}", 1), (f"{east},{north + 60},{up}", -1)):
        words = ["compare", str(cloud), str(reference), "--seen-from", place, "--cell", "0.1"]
        assert main([*words, "--force", "-o", str(tmp_path / "d.laz")]) == 0
        facts = json.loads((tmp_path / "d.json").read_text())
        one = facts["without_outliers"]
        # 4,000 points of 1 cm about a mesh of 3 mm: the mean is known to 0.2 mm and the mesh's own bias
        assert one["median_m"] == pytest.approx(sign * 0.04, abs=0.001)
        assert one["std_m"] == pytest.approx(0.01, abs=0.001)
    cloud_out = laspy.read(tmp_path / "d.laz")
    assert len(cloud_out.points) == 4_000
    assert set(cloud_out["used"]) <= {0, 1}


def test_files_of_two_places_are_refused(tmp_path, capsys):
    corners = 10.0 * np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    mesh = write_mesh(tmp_path / "mesh.ply", corners, [(0, 1, 2), (0, 2, 3)])
    high = points_text(tmp_path / "high.xyz", np.array([[5.0, 5, 43], [4, 4, 43]]))
    assert main(["compare", str(high), str(mesh), "-o", str(tmp_path / "d.csv")]) == 2
    assert "nearest 43.00 m" in capsys.readouterr().err
    far = points_text(tmp_path / "far.xyz", MAP_M + np.eye(3))
    assert main(["compare", str(far), str(mesh), "-o", str(tmp_path / "d.csv")]) == 2
    assert "km from the mesh" in capsys.readouterr().err
    assert not (tmp_path / "d.csv").exists()
