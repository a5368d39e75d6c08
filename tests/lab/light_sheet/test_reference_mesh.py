"""The reference scan: fine, noisy, with holes, and still one surface (P4 7.1)."""

import numpy as np
import pytest

from tests.lab.conftest import FRAME
from thalweg.core.geometry import read_mesh
from thalweg.surface import Surface
from thalweg_lab.tank import stepped_object
from thalweg_lab.tank.series import divided, reference_mesh, write_reference


def edges_mm(vertices, faces):
    corners = vertices[faces]
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)


def test_divided_faces_stay_joined_and_keep_their_side(rng):
    body = stepped_object()
    vertices, faces = divided(body.vertices_mm, body.faces, 12.0)
    assert edges_mm(vertices, faces).max() <= 12.0
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    a, b, c = (body.vertices_mm[body.faces[:, k]] for k in range(3))
    assert area == pytest.approx(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2, rel=1e-12)
    # boxes are closed: no edge has one face alone but those of the ground's border
    whole = reference_mesh(body, 1, resolution_mm=6.0, sigma_mm=0.0, holes=0, without=(1,))
    assert not whole.border_faces().any()
    # outward faces stay outward: points above a level are in front
    above = np.array([[-0.1, 0.0, 0.001], [0.0, 0.0, 0.0212], [0.1, 0.0, 0.0411]])
    assert Surface(whole).distances(above).distance_m == pytest.approx(
        [0.000994, 0.001005, 0.000965], abs=1e-9
    )


def test_noise_and_holes_are_as_stated(tmp_path):
    body = stepped_object()
    exact = Surface(reference_mesh(body, 1, resolution_mm=4.0, sigma_mm=0.0, holes=0, without=(1,)))
    how = {"resolution_mm": 2.5, "sigma_mm": 0.02, "hole_radius_mm": 3.0, "without": (1,)}
    mesh, again, other = (reference_mesh(body, seed, holes=6, **how) for seed in (1, 1, 2))
    off = exact.distances(mesh.vertices_m).distance_m * 1e3
    assert off.std() == pytest.approx(0.02, rel=0.1)  # waves of 5 to 30 mm average a little
    assert abs(off.mean()) < 0.002
    whole = reference_mesh(body, 1, holes=0, **how)
    gone = whole.areas_m2().sum() - mesh.areas_m2().sum()
    assert 3e-5 < gone < 6 * np.pi * 0.003**2 * 1.6  # holes may overlap, or lie at an edge
    assert mesh.border_faces().any()
    assert np.array_equal(again.vertices_m, mesh.vertices_m)
    assert not np.array_equal(other.vertices_m[:50], mesh.vertices_m[:50])
    write_reference(tmp_path / "reference.ply", mesh, body, FRAME)
    stored, _, facts = read_mesh(tmp_path / "reference.ply")
    assert stored.vertices_m == pytest.approx(mesh.vertices_m, abs=1e-9)
    assert facts["object"] == "stepped_object"
