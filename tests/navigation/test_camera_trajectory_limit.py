"""When is an image left out of the trajectory by images?"""

import numpy as np
import pytest

from thalweg.navigation.camera import CloudSettings, trajectory as module
from thalweg.navigation.camera.trajectory import CONTRADICTS
from thalweg_lab.studies.outage import VoyageSpec, make_survey


def test_the_limit_is_that_of_six_components(monkeypatch):
    """22.458 is exceeded by 0.1 % of chi-squares of six degrees (Abramowitz and Stegun 1964, table 26.8)."""
    recorded = make_survey(1, VoyageSpec(duration_s=14.0))
    tests = {4: 22.4, 8: 22.5}

    def neighbour_tests(images, *_):
        return np.array([tests.get(int(row), 5.348) for row in images.row])

    monkeypatch.setattr(module, "neighbour_tests", neighbour_tests)
    found = module.camera_trajectory(
        recorded.images,
        recorded.T_ccs_ics.inverse(),
        CloudSettings(outlier_probability=0.001, estimate_errors=False),
        states=recorded.states,
        sigma_attitude_rad=np.deg2rad([0.1, 0.1, 0.2]),
        max_attitude_gap_s=0.1,
    )
    assert np.flatnonzero(found.images["reason"] == CONTRADICTS).tolist() == [8]
    # the median of chi-squares of six degrees is 5.348
    assert found.facts["neighbours_differ_by_sigmas"] == pytest.approx(1.0, abs=1e-4)
