"""Noise of lidar points from their residuals: along and across beams, and where residuals cannot tell."""

import numpy as np
import pytest

from thalweg.calibration.ins_lidar.model import LEAST_SHARE, MOST, BeamNoise, estimate_noise

STATED = BeamNoise(along_m=0.0173, across_m=0.0173)


def test_noise_along_and_across_the_beam_are_two_numbers():
    """Along 20 mm, across 30 mm; at a cosine of 0.6 both: 0.36 x 400 + 0.64 x 900 = 720 mm^2."""
    noise = BeamNoise(along_m=0.02, across_m=0.03)
    np.testing.assert_allclose(noise.variance_along(np.array([1.0, 0.0, 0.6])), [4e-4, 9e-4, 7.2e-4])


@pytest.mark.parametrize(("along", "across"), [(0.010, 0.030), (0.030, 0.010), (0.026, 0.026)])
def test_noise_along_and_across_are_told_apart(rng, along, across):
    cosine = rng.uniform(0.5, 1.0, 20_000)
    sigma = np.sqrt(BeamNoise(along_m=along, across_m=across).variance_along(cosine))
    found = estimate_noise(0.8 * sigma * rng.standard_normal(20_000), cosine, 0.64, STATED)
    # 20 000 squares: a half per cent for one sigma, four per cent where two share them
    assert found.along_m == pytest.approx(along, rel=0.06)
    assert found.across_m == pytest.approx(across, rel=0.12)


def test_one_incidence_leaves_the_ratio_as_stated(rng):
    stated = BeamNoise(along_m=0.02, across_m=0.01)
    cosine = np.full(5000, np.sqrt(0.5))
    found = estimate_noise(0.0316 * rng.standard_normal(5000), cosine, 1.0, stated)
    assert found.variance_along(cosine)[0] == pytest.approx(0.001, rel=0.06)
    assert found.along_m > found.across_m


def test_points_that_hardly_outnumber_the_unknowns_leave_the_noise_as_stated():
    found = estimate_noise(np.full(10, 0.5), np.ones(10), 0.9 * LEAST_SHARE, STATED)
    assert found is STATED


def test_noise_does_not_swallow_moved_cones(rng):
    found = estimate_noise(0.3 * rng.standard_normal(500), rng.uniform(0.5, 1.0, 500), 1.0, STATED)
    assert found.along_m <= MOST * STATED.along_m * (1 + 1e-9)
    assert found.across_m <= MOST * STATED.across_m * (1 + 1e-9)
