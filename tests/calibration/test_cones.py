"""Geometry of cones against other derivations of it, and what noisy beams do on a curved surface."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from tests.calibration.cone_yard import YardCone
from thalweg.calibration import Cone
from thalweg.calibration.cones import beam_spread
from thalweg.core import ArrayF, Rigid

HALF = np.deg2rad(25.0)


def some_cone(axis: tuple[float, float, float] = (0.5, -0.8, 0.2), half: float = HALF) -> Cone:
    return Cone(apex_m=np.array([1.0, 2.0, 0.5]), axis=np.array(axis), half_angle_rad=half)


def upright(half: float) -> Cone:
    """With its apex in the origin, open upwards."""
    return Cone(apex_m=np.zeros(3), axis=np.array([0.0, 0.0, 1.0]), half_angle_rad=half)


def beams_at(cone: Cone, origin: ArrayF, n: int, rng: np.random.Generator, wide: float = 0.25) -> ArrayF:
    target = cone.apex_m + np.outer(rng.uniform(0.1, 0.7, n), cone.axis) + wide * rng.standard_normal((n, 3))
    d = target - origin
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))


# ---------------------------------------------------------------- distances


def test_distance_is_that_to_the_nearest_straight_line(rng):
    cone = some_cone()
    points = cone.apex_m + np.outer(np.linspace(0.3, 0.7, 20), cone.axis) + 0.1 * rng.standard_normal((20, 3))
    seen = cone.see(points)
    turn = np.linspace(0, 2 * np.pi, 20001)
    b1, b2 = cone.tangents
    line = np.cos(HALF) * cone.axis + np.sin(HALF) * (np.cos(turn)[:, None] * b1 + np.sin(turn)[:, None] * b2)
    for p, s, slant in zip(points, seen.distance_m, seen.slant_m, strict=True):
        along = (p - cone.apex_m) @ line.T
        off = np.linalg.norm(p - cone.apex_m - along[:, None] * line, axis=1)
        # 20,001 lines are 0.1 mm apart; to second order that is nothing
        assert abs(s) == pytest.approx(off.min(), abs=1e-7)
        assert slant == pytest.approx(along[off.argmin()], abs=1e-4)
    inside = np.linalg.norm(np.cross(points - cone.apex_m, cone.axis), axis=1) < (
        (points - cone.apex_m) @ cone.axis
    ) * np.tan(HALF)
    np.testing.assert_array_equal(seen.distance_m < 0, inside)


@pytest.mark.parametrize("axis", [(0.5, -0.8, 0.2), (0, 0, 1), (0, 0, -1), (1e-9, 0, 1), (1, 0, 0)])
def test_derivatives_of_all_parameters(rng, axis):
    """Upright cones too, where lambda of the paper has no meaning."""
    cone = some_cone(axis)
    points = cone.apex_m + rng.standard_normal((50, 3))
    h = 1e-6
    step = h * np.eye(6)
    by = [
        (cone.moved(d).see(points).distance_m - cone.moved(-d).see(points).distance_m) / (2 * h) for d in step
    ]
    # central differences: h^2 and 1e-16 / h
    np.testing.assert_allclose(cone.see(points).by_parameters, np.transpose(by), atol=1e-8)
    by_point = [
        (cone.see(points + d).distance_m - cone.see(points - d).distance_m) / (2 * h) for d in h * np.eye(3)
    ]
    np.testing.assert_allclose(cone.see(points).normal, np.transpose(by_point), atol=1e-8)
    np.testing.assert_allclose(cone.tangents @ cone.axis, 0.0, atol=1e-15)


def test_angles_of_the_paper():
    cone = some_cone((0.5, -0.8, 0.2))
    lam, theta = cone.angles_rad
    again = [np.sin(theta) * np.cos(lam), np.sin(theta) * np.sin(lam), np.cos(theta)]
    np.testing.assert_allclose(again, cone.axis, atol=1e-15)
    assert some_cone((0, 0, -1)).angles_rad == (0.0, np.pi)


def test_a_cone_in_another_frame_keeps_its_distances_and_covariance(rng):
    root = rng.standard_normal((6, 6))
    cone = Cone(apex_m=np.ones(3), axis=np.array([1.0, 2.0, 0.3]), half_angle_rad=HALF, cov=root @ root.T)
    T = Rigid(R=Rotation.random(rng=rng).as_matrix(), shift_m=rng.standard_normal(3))
    moved = cone.in_frame(T)
    points = rng.standard_normal((30, 3))
    np.testing.assert_allclose(moved.see(T.apply(points)).distance_m, cone.see(points).distance_m, atol=1e-14)
    there, here = moved.see(T.apply(points)).by_parameters, cone.see(points).by_parameters
    np.testing.assert_allclose(there @ moved.cov @ there.T, here @ cone.cov @ here.T, atol=1e-10)


# ---------------------------------------------------------------- beams


@pytest.mark.parametrize("axis", [(0.5, -0.8, 0.2), (0.0, 0.0, 1.0), (-0.7, 0.7, 0.1)])
def test_beams_meet_where_another_derivation_says(rng, axis):
    cone, origin = some_cone(axis), np.array([-3.0, -1.0, 1.0])
    d = beams_at(cone, origin, 400, rng)
    met = cone.meet(origin, d)
    other = YardCone("C", cone.apex_m, cone.axis, HALF, length=50.0).hits(np.tile(origin, (400, 1)), d)
    # the other derivation leaves out the tip
    beyond = met.hit & (met.slant_m * np.cos(HALF) > 0.05)
    assert beyond.sum() > 100
    np.testing.assert_allclose(met.range_m[beyond], other[beyond], rtol=1e-10)
    on = origin + met.range_m[met.hit, None] * d[met.hit]
    np.testing.assert_allclose(cone.see(on).distance_m, 0.0, atol=1e-11)
    assert (met.cosine[met.hit] > 0).all()
    assert np.isnan(met.range_m[~met.hit]).all()


def test_depth_is_the_least_distance_along_the_beam(rng):
    cone, origin = some_cone(), np.array([-3.0, -1.0, 1.0])
    for d in beams_at(cone, origin, 30, rng):

        def away(t: float, d: ArrayF = d) -> float:
            return float(cone.see(origin + t * d).distance_m[0])

        best = minimize_scalar(away, bounds=(0, 20), method="bounded", options={"xatol": 1e-9})
        # the minimum is flat: 1e-9 in t is nothing in the distance
        assert cone.meet(origin, d[None]).depth_m[0] == pytest.approx(-best.fun, abs=1e-7)


def test_the_excess_is_the_closed_form_for_small_noise(rng):
    cone, origin = some_cone(), np.array([-3.0, -1.0, 1.0])
    d = beams_at(cone, origin, 100, rng, wide=0.05)
    met = cone.meet(origin, d)
    good = met.hit & (met.depth_m > 0.05) & (met.cosine > 0.5)
    d = d[good]
    sigma = 0.001
    mean, _ = beam_spread(cone, origin, d, np.full(len(d), sigma))
    seen = cone.see(origin + met.range_m[good, None] * d)
    slope = np.einsum("ij,ij->i", seen.normal, d)
    across = np.einsum("ij,ij->i", seen.around, d)
    curvature = np.cos(HALF) / (met.slant_m[good] * np.sin(HALF))
    # the next term is smaller by (sigma over the radius)^2, here 1e-4 of it
    np.testing.assert_allclose(
        mean, 0.5 * curvature * sigma**2 * (1 + across**2 / slope**2) / np.abs(slope), rtol=5e-3
    )


NORMAL = np.array([np.sqrt(0.75), 0.0, -0.5])


@pytest.mark.parametrize(
    ("half", "origin", "beam", "expected"),
    [
        # met at (2, 0, 2), all angles there 45 degrees
        pytest.param(
            np.pi / 4, [5.0, 0.0, 2.0], [-1.0, 0.0, 0.0], (3, 2**1.5, 0.5**0.5, 0.5**0.5), id="level"
        ),
        # 2 m along the surface, at (1, 0, sqrt 3)
        pytest.param(
            np.pi / 6, [1, 0, np.sqrt(3)] + 5 * NORMAL, -NORMAL, (5, 2, 1, 1), id="along the normal"
        ),
    ],
)
def test_where_and_how_a_beam_meets_an_upright_cone_by_hand(half, origin, beam, expected):
    met = upright(half).meet(np.array([origin]), np.array([beam]))
    assert met.hit.tolist() == [True]
    found = met.range_m[0], met.slant_m[0], met.cosine[0], met.sine_ruling[0]
    assert found == pytest.approx(expected)


def test_tangents_of_an_axis_that_is_nearly_upright_are_unit_vectors():
    """Half a millimetre off plumb on a metre: x is then taken across, and lies 5e-4 off the level."""
    cone = Cone(apex_m=np.zeros(3), axis=np.array([5e-4, 0.0, 1.0]), half_angle_rad=0.2)
    np.testing.assert_allclose(cone.tangents @ cone.tangents.T, np.eye(2), atol=1e-15)
    np.testing.assert_allclose(cone.tangents, [[1.0, 0.0, -5e-4], [0.0, 1.0, 0.0]], atol=2e-7)


@pytest.mark.parametrize(
    ("beam", "depth"),
    [
        # along the axis, and steeper than the surface: the beam ends up inside, or comes from there
        ((0.0, 0.0, 1.0), np.inf),
        ((0.0, 0.0, -1.0), -np.inf),
        ((0.3, 0.0, 0.95), np.inf),
        ((0.3, 0.0, -0.95), -np.inf),
        ((0.6, 0.0, 0.8), np.inf),
        ((0.0, -0.6, -0.8), -np.inf),
        # level beams at height 2, past the axis at 0.5 and at 3: (2 - 0.5) and (2 - 3) over the root of 2
        ((1.0, 0.0, 0.0), 1.5 * np.sqrt(0.5)),
        ((0.0, 1.0, 0.0), -np.sqrt(0.5)),
    ],
)
def test_how_deep_beams_go_by_hand(beam, depth):
    """A right-angled cone upright, beams from (3, 0.5, 2)."""
    direction = np.array([beam]) / np.linalg.norm(beam)
    found = upright(np.pi / 4).meet(np.array([3.0, 0.5, 2.0]), direction).depth_m[0]
    assert found == pytest.approx(depth, rel=1e-12)


@pytest.mark.parametrize(
    ("axis", "first", "second"),
    [
        ((0, -2, 0), (1, 0, 0), (0, 0, 1)),
        ((0, 0, 1), (1, 0, 0), (0, 1, 0)),
        ((0, 0, -1), (1, 0, 0), (0, -1, 0)),
        ((3, 4, 0), (-0.8, 0.6, 0), (0, 0, 1)),
    ],
)
def test_one_tangent_is_level_by_hand(axis, first, second):
    """A quarter to the left of the axis, seen from above; the other one is up, or on from there."""
    np.testing.assert_allclose(some_cone(axis).tangents, [first, second], atol=1e-15)


def test_on_the_axis_the_first_tangent_is_across():
    """2 m up the axis of a cone of 30 degrees: 1 m inside; the normal leans away from the body."""
    seen = upright(np.pi / 6).see([[0.0, 0.0, 2.0]])
    np.testing.assert_allclose(seen.distance_m, [-1.0])
    np.testing.assert_allclose(seen.slant_m, [np.sqrt(3.0)])
    np.testing.assert_allclose(seen.normal, [[np.sqrt(0.75), 0.0, -0.5]])
    np.testing.assert_allclose(
        seen.by_parameters, [[-np.sqrt(0.75), 0.0, 0.5, -np.sqrt(3.0), 0.0, -np.sqrt(3.0)]], atol=1e-15
    )
