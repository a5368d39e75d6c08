"""Ray casting against closed forms, and the float32 trap at map coordinates."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from thalweg.core import GeometryError
from thalweg.core.geometry import RayCaster

SQUARE = np.array([[0.0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])
UTM = np.array([400_000.0, 5_655_000.0, 300.0])


@pytest.mark.parametrize("shift", [np.zeros(3), UTM], ids=["local", "map"])
def test_slanting_rays_meet_a_plane_where_they_must(rng, shift):
    caster = RayCaster(SQUARE + shift, FACES)
    target = np.column_stack([rng.uniform(0.1, 3.9, (500, 2)), np.zeros(500)])
    origin = np.array([1.0, 2.0, 3.0])
    way = target - origin
    length = np.linalg.norm(way, axis=1)
    hits = caster.cast(origin + shift, way / length[:, None])
    # float32 resolves 0.5 um at 5 m; without the local origin the error at 5.6e6 m is 0.5 m.
    assert_allclose(hits.t_hit_m, length, atol=5e-6)
    assert_allclose(np.abs(hits.normal), [[0, 0, 1]] * 500, atol=1e-6)
    corners = SQUARE[FACES[hits.primitive]]
    u, v = hits.uv.T[:, :, None]
    at = corners[:, 0] * (1 - u - v) + corners[:, 1] * u + corners[:, 2] * v
    assert_allclose(at, target, atol=1e-5)


def test_a_quarter_metre_survives_at_map_coordinates():
    """At 5.6e6 m Open3D alone said 0.0 m for this distance."""
    caster = RayCaster(SQUARE + UTM, FACES)
    nearest = caster.closest_points(UTM + np.array([[1.0, 2.0, 0.25], [-3.0, 2.0, -4.0]]))
    # 1e-6: float32 at 4 m.
    assert_allclose(nearest.distance_m, [0.25, 5.0], atol=1e-6)
    assert_allclose(nearest.point_m - UTM, [[1, 2, 0], [0, 2, 0]], atol=1e-5)


def test_misses_and_broken_rays_say_so():
    caster = RayCaster(SQUARE, FACES)
    origins = np.array([[1.0, 2, 3], [1, 2, 3], [9, 9, 3], [1, 2, np.nan]])
    directions = np.array([[0.0, 0, -1], [0, 0, 1], [0, 0, -1], [0, 0, -1]])
    hits = caster.cast(origins, directions)
    assert np.isfinite(hits.t_hit_m).tolist() == [True, False, False, False]
    assert (hits.primitive >= 0).tolist() == [True, False, False, False]


@pytest.mark.parametrize(
    ("vertices", "triangles", "found"),
    [
        (SQUARE, np.zeros((0, 3), dtype=int), "triangles of shape (0, 3)"),
        (SQUARE[:, :2], FACES, "vertices of shape (4, 2)"),
        (SQUARE, [[0, 1, 4]], "corners from 0 to 4"),
        (SQUARE, [[0, 1, -1]], "corners from -1 to 1"),
        (SQUARE, [[0.0, 1.0, 2.0]], "corners from 0.0"),
        (SQUARE * np.nan, FACES, "a mesh from [nan nan nan]"),
        (SQUARE * 1e5, FACES, "a mesh from [0. 0. 0.]"),
    ],
)
def test_a_mesh_that_cannot_be_cast_is_refused(vertices, triangles, found):
    with pytest.raises(GeometryError) as error:
        RayCaster(vertices, triangles)
    assert found in str(error.value)


def test_nearest_points_of_nowhere_are_refused():
    with pytest.raises(GeometryError, match="not finite"):
        RayCaster(SQUARE, FACES).closest_points([[np.inf, 0.0, 0.0]])


def test_free_rays_are_those_that_meet_nothing(rng):
    caster = RayCaster(SQUARE + UTM, FACES)
    origins = UTM + rng.uniform([-1, -1, -2], [5, 5, 2], (400, 3))
    directions = rng.standard_normal((400, 3))
    directions[7] = np.nan
    free = caster.free(origins, directions)
    assert_array_equal(free, np.isinf(caster.cast(origins, directions).t_hit_m))
    assert free[7]
    assert 0.1 < free.mean() < 0.95
