"""Noise of single points along and across their beams, in the calibration of a moving boat."""

import numpy as np

from thalweg.calibration.ins_lidar.model import BeamNoise


def test_noise_along_and_across_the_beam_are_two_numbers():
    """Along 20 mm, across 30 mm; at a cosine of 0.6 both: 0.36 x 400 + 0.64 x 900 = 720 mm^2."""
    noise = BeamNoise(along_m=0.02, across_m=0.03)
    np.testing.assert_allclose(noise.variance_along(np.array([1.0, 0.0, 0.6])), [4e-4, 9e-4, 7.2e-4])
