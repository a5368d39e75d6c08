"""A variance component against the closed form of the balanced case."""

import numpy as np
import pytest

from thalweg.clocks.camera_offset import Component, estimate_component


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_effects_of_single_observations_have_the_variance_that_noise_does_not_explain(scale):
    """``y = b + u + e``: restricted likelihood gives ``s + v = sum (y - mean)^2 / (n - 1)``, good to its

    share ``sqrt(2 / (n - 1))``. Here 8 values of squares 50 about their mean, v = 2: 50 / 7 - 2.
    """
    y = scale * np.array([5.0, -5.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]) + 7.0
    found = estimate_component(y, np.ones((8, 1)), np.eye(8), 2 * scale**2 * np.eye(8))
    # the search for the minimum of the logarithm ends at 1e-5 of it
    assert found.variance == pytest.approx((50 / 7 - 2) * scale**2, rel=1e-4)
    assert found.sigma_variance == pytest.approx(np.sqrt(2 / 7) * 50 / 7 * scale**2, rel=1e-4)
    assert found.sigma == pytest.approx(np.sqrt(found.variance))


def test_effects_shared_by_two_observations():
    """Pairs share an effect: their means vary by ``s + v / 2``, their differences tell nothing of s."""
    pair = np.repeat([4.0, -4.0, 2.0, -2.0, 0.0], 2) + np.tile([0.3, -0.3], 5)
    Z = np.repeat(np.eye(5), 2, axis=0)
    found = estimate_component(pair, np.ones((10, 1)), Z, np.eye(10))
    assert found.variance == pytest.approx(40 / 4 - 0.5, rel=1e-4)
    assert found.sigma_variance == pytest.approx(np.sqrt(2 / 4) * 10, rel=1e-4)


def test_a_component_solves_the_equation_of_restricted_likelihood():
    """``y' P K P y = tr P K`` with ``K = Z Z'``, sigma from the expected information ``tr (P K)^2 / 2``."""
    rng = np.random.default_rng(4)
    Z = np.kron(np.eye(80), np.ones((3, 1))) * rng.uniform(0.5, 2.0, (240, 1))
    A, V = rng.standard_normal((240, 4)), np.diag(rng.uniform(0.1, 0.4, 240))
    y = A @ [3.0, -1.0, 2.0, 0.5] + Z @ (0.7 * rng.standard_normal(80)) + 0.5 * rng.standard_normal(240)
    found, K = estimate_component(y, A, Z, V), Z @ Z.T
    W = np.linalg.inv(V + found.variance * K)
    P = W - W @ A @ np.linalg.solve(A.T @ W @ A, A.T @ W)
    assert y @ P @ K @ P @ y == pytest.approx(np.trace(P @ K), rel=1e-4)
    assert found.sigma_variance == pytest.approx(np.sqrt(2 / np.trace(P @ K @ P @ K)), rel=1e-4)


def test_noise_that_explains_all_leaves_no_effect():
    """``sigma`` of an estimate at zero is the root of that of the variance: an upper end."""
    y = np.array([0.5, -0.5, 0.5, -0.5, 0.0])
    found = estimate_component(y, np.ones((5, 1)), np.eye(5), np.eye(5))
    assert found.variance == 0.0
    assert found.sigma_variance == pytest.approx(np.sqrt(2 / 4))
    assert found.sigma_of_sigma == pytest.approx((2 / 4) ** 0.25)


def test_the_sigma_of_a_sigma():
    """Far from zero ``d sigma = d variance / (2 sigma)``; near it, the way to the upper end."""
    assert Component(variance=4.0, sigma_variance=1.0).sigma_of_sigma == pytest.approx(0.25)
    assert Component(variance=1.0, sigma_variance=3.0).sigma_of_sigma == pytest.approx(1.0)
