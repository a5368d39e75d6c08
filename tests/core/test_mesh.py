"""Triangle meshes: neighbours, borders, edges of more than two faces, parts and pieces."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from thalweg.core import GeometryError
from thalweg.core.geometry import TriangleMesh
from thalweg.core.geometry.mesh import NO_FACE


def mesh_of(vertices, faces):
    v = np.array(vertices, dtype=np.float64)
    return TriangleMesh(
        vertices_m=v, faces=np.array(faces, dtype=np.int64).reshape(-1, 3), sigma_m=np.zeros(len(v))
    )


SQUARE = [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]]


def test_two_triangles_are_neighbours_across_their_diagonal():
    mesh = mesh_of(SQUARE, [[0, 1, 2], [0, 2, 3]])
    assert mesh.neighbours().tolist() == [[NO_FACE, NO_FACE, 1], [0, NO_FACE, NO_FACE]]
    assert mesh.border_faces().all()
    assert_allclose(mesh.areas_m2(), [2.0, 2.0])
    assert_allclose(mesh.face_normals(), [[0, 0, 1]] * 2)


def test_a_closed_body_has_no_border():
    mesh = mesh_of([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    assert not mesh.border_faces().any()
    assert {tuple(sorted(row)) for row in mesh.neighbours().tolist()} == {
        (1, 2, 3),
        (0, 2, 3),
        (0, 1, 3),
        (0, 1, 2),
    }


def test_neighbours_are_those_of_a_dictionary_of_edges(rng):
    """Random faces with many edges of one, two and more faces; vertex 0 is the hub of most."""
    faces = rng.integers(0, 30, (400, 3))
    faces[:200, 0] = 0
    faces = faces[[len(set(f)) == 3 for f in faces.tolist()]]
    edges = {}
    for f, corners in enumerate(faces.tolist()):
        for k in range(3):
            edge = tuple(sorted((corners[k], corners[(k + 1) % 3])))
            edges.setdefault(edge, []).append((f, k))
    expected = np.full(faces.shape, NO_FACE)
    for users in edges.values():
        if len(users) == 2:
            (f, i), (g, j) = users
            expected[f, i], expected[g, j] = g, f
    mesh = mesh_of(rng.normal(size=(30, 3)).tolist(), faces.tolist())
    assert (expected != NO_FACE).any()
    assert_array_equal(mesh.neighbours(), expected)


def test_parts_and_pieces():
    mesh = mesh_of([*SQUARE, [9, 9, 9], [8, 9, 9], [9, 8, 9]], [[0, 1, 2], [4, 5, 6], [0, 2, 3]])
    piece = mesh.pieces()
    assert piece[0] == piece[2] != piece[1]
    part = mesh.part(piece == piece[0])
    assert part.vertices_m.tolist() == SQUARE
    assert part.faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_a_mesh_without_faces_has_no_neighbours():
    mesh = mesh_of(SQUARE, [])
    assert mesh.neighbours().shape == (0, 3)
    assert mesh.pieces().shape == (0,)
    assert mesh.part(np.zeros(0, dtype=np.bool_)).vertices_m.shape == (0, 3)


@pytest.mark.parametrize(
    ("vertices", "faces", "answer"),
    [
        ([[0, 0, 0], [1, 0, 0], [np.nan, 0, 0]], [[0, 1, 2]], "not finite"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 3]], "corners from 0 to 3"),
        ([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]], "expected"),
    ],
)
def test_broken_meshes_are_refused(vertices, faces, answer):
    with pytest.raises(GeometryError, match=answer):
        mesh_of(vertices, faces)


def test_areas_and_normals_far_from_the_origin():
    corners = np.array([[7.0, 5.0, 3.0], [10.0, 5.0, 3.0], [7.0, 9.0, 3.0], [7.0, 5.0, 6.0]])
    mesh = mesh_of(corners.tolist(), [[0, 1, 2], [0, 1, 3], [1, 2, 3]])
    # the slanted face: half the cross product of (-3, 4, 0) and (-3, 0, 3)
    assert_allclose(mesh.areas_m2(), [6.0, 4.5, 0.5 * np.linalg.norm([12.0, 9.0, 12.0])])
    assert_allclose(mesh.face_normals()[:2], [[0, 0, 1], [0, -1, 0]], atol=1e-15)
