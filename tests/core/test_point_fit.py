"""Fit of points in two frames: exact, mirrored, on a line, at one place, many sets at once."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from thalweg.core.geometry import fit_points, nearest_rotation

R = Rotation.from_rotvec([0.1, 0.2, -2.5]).as_matrix()
SHIFT_M = np.array([4e5, 5.6e6, 100.0])


@pytest.mark.parametrize(("scaled", "scale"), [(True, 2.5), (False, 1.0)])
def test_exact_points_give_back_the_motion(rng, scaled, scale):
    source = rng.normal(0, 5, (6, 3))
    found, shift, factor = fit_points(source, scale * source @ R.T + SHIFT_M, scaled=scaled)
    assert_allclose(found, R, atol=1e-9)
    assert_allclose(shift, SHIFT_M, atol=1e-6)
    assert float(factor) == pytest.approx(scale, abs=1e-9)


def test_the_fit_is_that_of_least_squares(rng):
    source = rng.normal(0, 5, (20, 3))
    target = 1.3 * source @ R.T + rng.normal(0, 0.3, (20, 3))
    found, shift, scale = fit_points(source, target, scaled=True)
    peer, _ = Rotation.align_vectors(target - target.mean(axis=0), source - source.mean(axis=0))
    assert_allclose(found, peer.as_matrix(), atol=1e-7)  # scipy stops at this precision
    least = np.square(scale * source @ found.T + shift - target).sum()
    for other in (0.999 * scale, 1.001 * scale):
        assert (
            np.square(other * (source - source.mean(axis=0)) @ found.T + target.mean(axis=0) - target).sum()
            > least
        )


@pytest.mark.parametrize("extent", [[5.0, 4.0, 3.0], [5.0, 4.0, 0.0]])
def test_mirrored_points_get_a_proper_rotation(rng, extent):
    source = rng.normal(0, 1, (8, 3)) * extent
    found, _, scale = fit_points(source, source * [1, 1, -1], scaled=True)
    assert np.linalg.det(found) == pytest.approx(1)
    assert scale > 0
    if extent[2] == 0:  # a plane is its own mirror image
        assert_allclose(source @ found.T, source, atol=1e-12)


def test_points_on_a_line_get_one_of_the_rotations_that_fit():
    source = np.outer(np.arange(5.0), [1.0, 2.0, 2.0])
    target = source @ R.T + SHIFT_M
    found, shift, scale = fit_points(source, target, scaled=True)
    assert np.linalg.det(found) == pytest.approx(1)
    assert_allclose(scale * source @ found.T + shift, target, atol=1e-6)


def test_points_at_one_place_have_a_rotation_but_no_scale():
    source = np.ones((4, 3))
    found, shift, scale = fit_points(source, source + SHIFT_M)
    assert (np.linalg.det(found), float(scale)) == (pytest.approx(1), 1.0)
    assert_allclose(source @ found.T + shift, source + SHIFT_M, atol=1e-6)
    assert np.isnan(fit_points(source, source, scaled=True)[2])


def test_many_sets_at_once_are_each_alone(rng):
    source, target = rng.normal(0, 1, (2, 30, 3, 3))
    together = fit_points(source, target, scaled=True)
    for k in range(30):
        for several, one in zip(together, fit_points(source[k], target[k], scaled=True), strict=True):
            assert_allclose(several[k], one, atol=1e-12)


def test_nearest_rotation_of_a_rotation_is_itself_and_never_a_mirror():
    assert_allclose(nearest_rotation(3.0 * R), R, atol=1e-14)
    assert_allclose(nearest_rotation(np.diag([3.0, 2.0, -1.0])), np.eye(3), atol=1e-14)
