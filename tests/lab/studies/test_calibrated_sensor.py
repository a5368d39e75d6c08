"""The sensor of the studies without images: known as well as its covariance says."""

import numpy as np

from tests.bands import band
from thalweg.lightsheet.optics import LASER, LENS, PARAMETERS, WINDOW
from thalweg_lab.studies.sensors.laser_lines import calibrated_sensor


def test_errors_of_the_calibration_are_as_large_as_their_sigmas() -> None:
    heights, others, tilts = [], [], []
    for seed in range(1, 13):
        pair = calibrated_sensor(seed)
        sigma = np.sqrt(np.diag(pair.known.cov))
        off = pair.known.vector() - pair.true.vector()
        heights.append(off[2] / sigma[2])
        free = [i for i in range(*LENS.indices(26)) if sigma[i] > 0]
        free += [PARAMETERS.index(name) for name in ("n_water", "n_glass", "glass_mm")]
        others.append(off[free] / sigma[free])
        # the turn about the normal is a definition, what remains is an error of the calibration
        M = pair.R_true_known.T @ pair.true.R_lcs_ccs @ pair.known.R_lcs_ccs.T
        tilts.append([M[2, 0], M[2, 1], np.sqrt(np.trace(pair.known.cov[3:6, 3:6]))])
        np.testing.assert_allclose(pair.known.vector()[:2], pair.true.vector()[:2], atol=1e-9)
    for normalised in (heights, others):
        low, high = band(np.size(normalised))
        assert low < np.mean(np.square(normalised)) < high
    tilts = np.array(tilts)
    assert np.sqrt(np.square(tilts[:, :2]).sum(axis=1).mean()) < 1.6 * tilts[:, 2].mean()
    assert np.abs(tilts[:, :2]).max() > 1e-5


def test_the_processing_does_not_have_the_true_sensor() -> None:
    pair = calibrated_sensor(1)
    x, y = pair.known.vector(), pair.true.vector()
    for part in (
        slice(2, 6),
        slice(LENS.start, LENS.start + 4),
        LASER,
        slice(WINDOW.start, WINDOW.start + 3),
    ):
        assert (x[part] != y[part]).all()
    again = calibrated_sensor(1)
    np.testing.assert_array_equal(again.known.vector(), x)
    np.testing.assert_array_equal(again.known.cov, pair.known.cov)
    small = calibrated_sensor(1, size="tiny")
    assert small.known.camera.size_px == small.true.camera.size_px == (512, 512)
