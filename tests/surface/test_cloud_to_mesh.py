"""Signed distances from meshes: places, sides and borders that are known, and a search over all faces."""

import numba as nb
import numpy as np
import pytest

from tests.surface import rough_bank
from thalweg.core import GeometryError
from thalweg.core.geometry import TriangleMesh
from thalweg.surface import Distances, Surface, cloud_to_mesh
from thalweg.surface.cloud_to_mesh import LEAF

UTM = np.array([400_000.0, 5_655_000.0, 300.0])
SQUARE = [[0.0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]]
TWO_FACES = [[0, 1, 2], [0, 2, 3]]


def mesh_of(vertices, faces, sigma=0.0):
    vertices = np.asarray(vertices, dtype=np.float64)
    sigma = np.broadcast_to(np.asarray(sigma, dtype=np.float64), len(vertices)).copy()
    return TriangleMesh(
        vertices_m=vertices, faces=np.asarray(faces, dtype=np.int64).reshape(-1, 3), sigma_m=sigma
    )


def distances(vertices, faces, points, sigma=0.0) -> Distances:
    return Surface(mesh_of(vertices, faces, sigma)).distances(points)


def over_all_faces(mesh: TriangleMesh, points: np.ndarray) -> np.ndarray:
    """Distance (n,) by trying every face: foot in its plane if inside, else the nearest of three segments."""
    best = np.full(len(points), np.inf)
    for corners in mesh.vertices_m[mesh.faces]:
        a, b, c = corners
        for p0, p1 in ((a, b), (b, c), (c, a)):
            e, q = p1 - p0, points - p0
            t = np.clip(q @ e / max(e @ e, 1e-300), 0, 1)
            best = np.minimum(best, np.linalg.norm(q - t[:, None] * e, axis=1))
        base = np.stack([b - a, c - a], axis=1)
        if np.linalg.matrix_rank(base) == 2:
            uv = (points - a) @ np.linalg.pinv(base).T
            inside = (uv >= 0).all(axis=1) & (uv.sum(axis=1) <= 1)
            foot = np.linalg.norm(points - a - uv @ base.T, axis=1)
            best = np.where(inside, np.minimum(best, foot), best)
    return best


# ---------------------------------------------------------------- one face, known places


@pytest.mark.parametrize(
    ("point", "distance", "nearest", "at_border"),
    [
        ((1, 1, 2), 2.0, (1, 1, 0), False),
        ((1, 1, -2), -2.0, (1, 1, 0), False),
        ((1, -3, 4), 5.0, (1, 0, 0), True),
        ((1, -3, -4), -5.0, (1, 0, 0), True),
        ((-1, 1, 0), 1.0, (0, 1, 0), True),  # in the plane: no side, by definition in front
        ((3, 3, 1), np.sqrt(3), (2, 2, 0), True),
        ((-2, -1, 2), 3.0, (0, 0, 0), True),
        ((6, -1, -2), -3.0, (4, 0, 0), True),
        ((-1, 6, 2), 3.0, (0, 4, 0), True),
        ((1, 0, 3), 3.0, (1, 0, 0), True),  # straight above a border edge
        ((4, 0, -3), -3.0, (4, 0, 0), True),
        ((1, 1e-7, 3), 3.0, (1, 1e-7, 0), False),  # a hair inside of it
        ((1, 1, 0), 0.0, (1, 1, 0), False),
        ((2, 0, 0), 0.0, (2, 0, 0), True),
        ((0, 0, 0), 0.0, (0, 0, 0), True),
    ],
)
def test_places_of_a_triangle(point, distance, nearest, at_border):
    found = distances([[0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 1, 2]], [point])
    # 1e-15: rounding of numbers of this size
    np.testing.assert_allclose(found.distance_m, [distance], rtol=0, atol=1e-15)
    np.testing.assert_allclose(found.nearest_m, [nearest], rtol=0, atol=1e-15)
    assert found.at_border.tolist() == [at_border]
    assert found.normal.tolist() == [[0, 0, 1]]
    assert not np.signbit(found.distance_m[0]) or distance < 0  # on the surface: plus zero


def test_sigma_is_interpolated_where_the_point_is_nearest(rng):
    """Sigmas that are linear in the plane come back exactly at every place: faces, edges, corners."""
    vertices = np.column_stack([rng.uniform(0, 10, (60, 2)), np.zeros(60)])
    faces = rough_bank.RoughBank(6, 10, step_m=1, rough_m=0).mesh.faces
    sigma = 0.01 + 0.002 * vertices[:, 0] + 0.001 * vertices[:, 1]
    found = distances(vertices, faces, rng.uniform(-3, 13, (2000, 3)), sigma)
    expected = 0.01 + found.nearest_m @ [0.002, 0.001, 0]
    np.testing.assert_allclose(found.sigma_m, expected, rtol=0, atol=1e-12)  # rounding over slim triangles


# ---------------------------------------------------------------- the true minimum


@pytest.mark.parametrize("n_faces", [1, LEAF, LEAF + 1, 8 * LEAF, 8 * LEAF + 1, 64 * LEAF + 1])
@pytest.mark.parametrize("shift", [np.zeros(3), UTM], ids=["local", "map"])
def test_no_face_is_nearer_than_the_one_found(rng, n_faces, shift):
    """Loose triangles through each other, slim and without area among them."""
    vertices = rng.uniform(-1, 1, (3 * n_faces, 3)) * [3, 1, 0.3]
    vertices[2::9] = 0.5 * (vertices[0::9] + vertices[1::9]) + rng.choice(
        [0, 1e-9, 1e-3], (len(vertices[2::9]), 1)
    )
    vertices = vertices + shift  # rounded to what map coordinates can hold
    mesh = mesh_of(vertices, np.arange(3 * n_faces))
    points = rng.uniform(-4, 4, (300, 3)) + shift
    found = Surface(mesh).distances(points)
    # 2e-9: one step of a number at 5.6e6 m is 0.9 nm, and the search over all faces works with it
    limit = 2e-9 if shift.any() else 1e-13
    np.testing.assert_allclose(np.abs(found.distance_m), over_all_faces(mesh, points), rtol=0, atol=limit)
    np.testing.assert_allclose(
        np.linalg.norm(found.nearest_m - points, axis=1), np.abs(found.distance_m), rtol=0, atol=limit
    )
    alone = [
        abs(distances(vertices, mesh.faces[[f]], points[[i]]).distance_m[0])
        for i, f in enumerate(found.face[:20])
    ]
    assert alone == np.abs(found.distance_m[:20]).tolist()


def test_rough_ground_to_the_last_digit_and_its_sides(rng):
    bank = rough_bank.RoughBank(40, 30, step_m=0.05, rough_m=0.03)
    points = bank.points(4000, sigma_m=0.1)
    found = Surface(bank.mesh).distances(points)
    np.testing.assert_allclose(
        np.abs(found.distance_m[:500]), over_all_faces(bank.mesh, points[:500]), rtol=0, atol=1e-14
    )
    side = bank.above(points)
    inside = ~found.at_border & (side != 0)
    assert inside.sum() > 3000
    assert np.array_equal(np.sign(found.distance_m[inside]), side[inside])


def test_map_coordinates_cost_nothing(rng):
    """Mesh and points at 5.6e6 m give the distances of the local frame, to a step of such a number."""
    bank = rough_bank.RoughBank(60, 40, step_m=0.05, rough_m=0.02)
    points = bank.points(5000)
    step = np.spacing(UTM.max())  # 0.9 nm
    # both clouds rounded beforehand to steps that map coordinates hold: then nothing is lost at all
    vertices, points = (np.round(x / step) * step for x in (bank.mesh.vertices_m, points))
    local = distances(vertices, bank.mesh.faces, points)
    far = distances(vertices + UTM, bank.mesh.faces, points + UTM)
    assert np.abs(far.distance_m).max() > 0.2
    assert np.array_equal(far.distance_m, local.distance_m)
    assert np.array_equal(far.normal, local.normal)
    assert np.array_equal(far.at_border, local.at_border)


def test_far_points_keep_their_digits():
    found = distances(SQUARE, TWO_FACES, [[1.0, 2, 5e6], [5e6, 2, 0], [1, 2, 0.25]])
    np.testing.assert_allclose(found.distance_m, [5e6, 5e6 - 4, 0.25], rtol=1e-15)


def test_order_chunks_and_threads_change_nothing(rng, monkeypatch):
    bank = rough_bank.RoughBank(50, 40, step_m=0.05, rough_m=0.03)
    points = np.concatenate([bank.points(5000), bank.mesh.vertices_m[:500]])
    whole = Surface(bank.mesh).distances(points)
    turn = rng.permutation(len(points))
    shuffled = Surface(bank.mesh).distances(points[turn])
    monkeypatch.setattr(cloud_to_mesh, "CHUNK", 1001)
    threads = nb.get_num_threads()
    nb.set_num_threads(1)
    try:
        pieces = Surface(bank.mesh).distances(points)
    finally:
        nb.set_num_threads(threads)
    for name in Distances.__slots__:
        assert np.array_equal(getattr(pieces, name), getattr(whole, name)), name
        assert np.array_equal(getattr(shuffled, name), getattr(whole, name)[turn]), name


# ---------------------------------------------------------------- sides


def test_an_acute_ridge_needs_the_normals_of_both_faces():
    """A ridge of 20 degrees: seen from beside its top, the far face shows its back, the sum does not."""
    h = 1 / np.tan(np.radians(10))
    ridge = [[-5, 0, 0], [5, 0, 0], [-5, -1, -h], [5, -1, -h], [-5, 1, -h], [5, 1, -h]]
    faces = [[0, 2, 3], [0, 3, 1], [0, 1, 5], [0, 5, 4]]
    point = np.array([[0.3, 0.5, 0.2], [0.3, -0.5, 0.2], [0.3, 0.01, -2.0]])
    found = distances(ridge, faces, point)
    assert np.sign(found.distance_m).tolist() == [1, 1, -1]
    assert found.at_border.tolist() == [False] * 3
    # to the first two the top edge is nearest; one of its faces turns its back on each of them
    away = point[:2] - found.nearest_m[:2]
    np.testing.assert_allclose(found.normal[:2], [[0, 0, 1]] * 2, rtol=0, atol=1e-15)
    by_face = away @ mesh_of(ridge, faces).face_normals()[[0, 2]].T
    assert (by_face < 0).any(axis=1).tolist() == [True, True]


def test_a_corner_weighs_its_normals_by_their_angles():
    """A spike whose west side is cut into 40 slim faces: with equal weights they would outvote the others."""
    west = np.column_stack([np.full(41, -1.0), np.linspace(1, -1, 41), np.full(41, -5.0)])
    ring = np.vstack([west, [[1, -1, -5], [1, 1, -5]]])
    k = np.arange(len(ring))
    faces = np.column_stack([np.zeros_like(k), k + 1, np.roll(k, -1) + 1])
    mesh = mesh_of(np.vstack([[[0, 0, 0]], ring]), faces)
    points = np.random.default_rng(3).uniform(-2, 2, (20_000, 3))
    found = Surface(mesh).distances(points)
    at_top = (found.nearest_m == 0).all(axis=1)
    assert at_top.sum() > 1000
    # the spike is convex: whatever is nearest to its top is outside
    assert (found.distance_m[at_top] > 0).all()
    assert not found.at_border[at_top].any()
    sign_by_equal_weights = points[at_top] @ mesh.face_normals().sum(axis=0)
    assert (sign_by_equal_weights < 0).mean() > 0.1


# ---------------------------------------------------------------- borders


def test_only_places_on_the_border_are_at_the_border(rng):
    """A plate with a hole: the border is its rim, not every face that touches the rim."""
    bank = rough_bank.RoughBank(9, 9, step_m=1, rough_m=0)
    x, y = np.meshgrid(np.arange(9.0), np.arange(9.0), indexing="ij")
    vertices = np.column_stack([x.ravel(), y.ravel(), np.zeros(81)])
    middle = vertices[bank.mesh.faces].mean(axis=1)
    hole = (np.abs(middle[:, :2] - 4) < 1).all(axis=1)  # 3..5 in both directions
    assert hole.sum() == 8
    points = np.column_stack([rng.uniform(-1, 9, (5000, 2)), rng.uniform(-0.5, 0.5, 5000)])
    points = np.vstack([points, vertices])
    found = distances(vertices, bank.mesh.faces[~hole], points)
    east, north = points[:, 0], points[:, 1]
    beyond = (np.minimum(east, north) <= 0) | (np.maximum(east, north) >= 8)
    in_hole = (np.maximum(np.abs(east - 4), np.abs(north - 4)) <= 1) & (points[:, 2] != 0)
    in_hole |= (np.maximum(np.abs(east - 4), np.abs(north - 4)) == 1) | ((east == 4) & (north == 4))
    assert np.array_equal(found.at_border, beyond | in_hole)
    assert 1000 < found.at_border.sum() < 3000


def test_doubled_vertices_are_a_border_and_sheets_on_each_other_are_decided_by_number():
    seam = [[0, 0, 0], [2, 0, 0], [2, 2, 0], [2, 0, 0], [4, 0, 0], [2, 2, 0]]
    faces = [[0, 1, 2], [3, 4, 5]]
    found = distances(seam, faces, [[2.0, 1, 1], [1.5, 0.5, 1]])
    assert found.at_border.tolist() == [True, False]
    # two sheets on each other, the second upside down: both are equally near, the first one counts
    for first, sign in ((TWO_FACES, 1), ([f[::-1] for f in TWO_FACES], -1)):
        other = [[c + 4 for c in f[::-1]] for f in first]
        found = distances([*SQUARE, *SQUARE], [*first, *other], [[1.0, 2, 0.5], [3, 1, 0.5]])
        assert found.distance_m.tolist() == [0.5 * sign] * 2
        assert found.face.tolist() == [1, 0]


@pytest.mark.parametrize(
    ("faces", "what"),
    [
        ([[0, 1, 2], [0, 3, 2]], "two faces that face opposite ways"),
        ([[0, 1, 2], [0, 4, 2]], "the same over a fold"),
        ([[0, 1, 2], [0, 2, 3], [0, 2, 4]], "three faces at one edge"),
        ([[0, 1, 2], [0, 2, 1]], "a face and its own back"),
    ],
)
def test_places_without_two_sides_are_flagged(faces, what):
    found = distances([*SQUARE, [2, 2, 3]], faces, [[2.1, 1.9, -1.0], [2.0, 2.0, -1.0], [3.0, 1.0, -1.0]])
    assert found.at_border.tolist()[1:] == [True, False], what
    np.testing.assert_allclose(np.linalg.norm(found.normal, axis=1), 1)
    assert found.distance_m[2] == -1  # the lowest of two equally near ones


def test_two_bodies_that_share_an_edge_have_no_sides_there():
    """Two closed tetrahedra hang on one edge: four faces at it, though nothing is open."""
    vertices = [[0, 0, 0], [2, 0, 0], [1, -1, -2], [1, -0.5, -2], [1, 0.5, -2], [1, 1, -2]]
    one = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    other = [[0, 4, 1], [0, 1, 5], [0, 5, 4], [1, 4, 5]]
    points = [[1.0, 0, 1], [-1, 0, 1], [1, -0.75, -3], [1, 2, -1]]
    found = distances(vertices, one + other, points)
    assert found.at_border.tolist() == [True, True, False, False]
    alone = distances(vertices, one, points)
    assert not alone.at_border.any()
    assert (found.distance_m > 0).all()
    assert (alone.distance_m > 0).all()


def test_faces_without_area_take_part_without_a_side():
    """A needle, a face that names a corner twice, and one in a point: places, but no normal of their own."""
    vertices = [*SQUARE, [2, 2, 0]]
    faces = [*TWO_FACES, [0, 4, 2], [1, 1, 2], [3, 3, 3]]
    points = np.array([[2.0, 2.5, 1], [2.5, 2, -1], [2, 2, 1], [5, 2, 1], [-1, 5, 1]])
    found, without = distances(vertices, faces, points), distances(vertices, TWO_FACES, points)
    np.testing.assert_allclose(found.distance_m, without.distance_m, rtol=1e-15)
    np.testing.assert_allclose(found.normal, [[0, 0, 1]] * 5, rtol=0, atol=1e-15)
    assert found.at_border[3:].tolist() == [True, True]
    along = np.array([1 / 3, 0.1, 0.7])  # the last needle has area by rounding only
    vertices += [along, 2.1 * along, 3.3 * along]
    for alone in ([[0, 4, 2]], [[1, 1, 2]], [[3, 3, 3]], [[5, 6, 7]]):
        only = distances(vertices, alone, points)
        np.testing.assert_allclose(only.distance_m, over_all_faces(mesh_of(vertices, alone), points))
        assert only.at_border.all()
        assert not only.normal.any()


# ---------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("points", "found"),
    [
        (np.zeros((3, 2)), "points of shape (3, 2)"),
        (np.zeros(3), "points of shape (3,)"),
        ([[0, 0, 0], [0, np.nan, 1], [np.inf, 0, 0]], "2 of 3 points are not finite, the first is number 1"),
        (UTM + np.zeros((2, 3)), "all 2 points lie at least 5669.1 km from the mesh"),
    ],
)
def test_points_that_cannot_be_compared_are_refused(points, found):
    with pytest.raises(GeometryError) as error:
        distances(SQUARE, TWO_FACES, points)
    assert found in str(error.value)


def test_meshes_that_cannot_be_searched_are_refused():
    with pytest.raises(GeometryError, match=r"4 vertices without a face.*longest edge"):
        distances(SQUARE, [], [[0.0, 0, 0]])
    with pytest.raises(GeometryError, match=r"a mesh 40\.0 km wide; expected at most 20 km"):
        distances(np.array(SQUARE) * 1e4, TWO_FACES, [[0.0, 0, 0]])


def test_no_points_and_loose_vertices_are_no_mistake():
    assert distances(SQUARE, TWO_FACES, np.zeros((0, 3))).distance_m.shape == (0,)
    # a vertex without a face neither widens the mesh nor is a place of it
    found = distances([*SQUARE, [1e9, 0, 0]], TWO_FACES, [[1.0, 2, 0.5], [5000, 2, 0]])
    assert found.distance_m.tolist() == [0.5, 4996.0]
