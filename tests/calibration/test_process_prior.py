"""What is stated of the errors of poses holds where a run says little."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from thalweg.calibration.ins_lidar import PoseErrors
from thalweg.calibration.ins_lidar.adjustment import NAMES, estimate_processes


def test_the_prior_holds_a_size_that_the_run_would_let_go():
    """A likelihood that gains the same with each doubling of one size, and is blind to all else.

    With ``z`` doublings ``-2 log L = -2 z``; the prior adds ``z^2``, so the size doubles once and the rest
    stays. Without a prior it would grow without end.
    """
    stated = PoseErrors(sigma_position_m=np.full(3, 0.02), sigma_attitude_rad=np.full(3, 1e-3))
    solved = SimpleNamespace(logdet=0.0, omega=0.0)
    step = SimpleNamespace(prior_border=None, normals=SimpleNamespace(solve=lambda *_: solved))
    knots = SimpleNamespace(prior=lambda errors: (None, 2 * np.log2(errors.sigma_position_m[0] / 0.02)))
    found = estimate_processes(step, knots, stated)
    # the search ends at a gradient of 0.01 of a cost with the curvature 2
    np.testing.assert_allclose(found.errors.sigma_position_m, 0.04, rtol=0.02)
    np.testing.assert_allclose(found.errors.sigma_attitude_rad, 1e-3, rtol=0.02)
    assert found.errors.position_time_s == pytest.approx(stated.position_time_s, rel=0.02)
    # 64 draws: a sigma to 9 %, two of these; each parameter is as wide as its prior
    np.testing.assert_allclose(found.width, 1.0, atol=0.18)
    assert found.undetermined() == found.names == NAMES
    without = estimate_processes(step, knots, replace(stated, white_share=0.0))
    assert without.names == NAMES[:-1]
    assert without.draws.shape[1] == len(without.z) == 6
