"""Sigmas of line points and ends by their residuals: up, down, and what few residuals leave open."""

import numpy as np
import pytest
from scipy.integrate import quad

from thalweg.lightsheet.calibration.model import _filled
from thalweg.lightsheet.calibration.sheet_calibration import SPREAD, estimated_factor


@pytest.mark.parametrize("factor", [0.5, 1.0, 3.0])
def test_many_residuals_give_the_factor_up_and_down(factor):
    found = estimated_factor(factor**2, 2000.0)
    # a standard deviation from 2000 squares: 1.6 %, and the prior draws by as little
    assert found.of_scatter == pytest.approx(factor, rel=0.01)
    assert found.width == pytest.approx(1 / np.sqrt(2 * 2000.0), rel=0.05)


def test_few_residuals_leave_it_open_and_that_enlarges_it():
    found = estimated_factor(1.0, 8.0)

    def density(log, power):
        f = np.exp(log)
        return f**power * f**-8.0 * np.exp(-8.0 / (2 * f**2) - 0.5 * (log / np.log(SPREAD)) ** 2)

    whole, square = (quad(density, -3.0, 3.0, args=(power,))[0] for power in (0, 2))
    assert found.of_scatter == pytest.approx(np.sqrt(square / whole), rel=1e-3)
    assert found.of_scatter > 1.05


def test_without_residuals_the_width_of_the_prior_counts():
    found = estimated_factor(1.0, 0.0)
    # E f^2 of a logarithm with the standard deviation ln 2
    assert found.of_scatter == pytest.approx(np.exp(np.log(2.0) ** 2), rel=1e-3)
    assert found.width == pytest.approx(np.log(2.0), rel=1e-3)


def test_shared_errors_multiply_the_variance():
    assert estimated_factor(1.0, 1e5, 9.0).value == pytest.approx(3.0, rel=1e-3)


def test_variances_that_are_none_are_the_median_of_the_others():
    given = np.array([4.0, np.nan, 1.0, 0.0, 9.0, np.inf, -2.0])
    assert _filled(given).tolist() == [4.0, 4.0, 1.0, 4.0, 9.0, 4.0, 4.0]
    assert _filled(np.array([np.nan, 0.0])).tolist() == [1.0, 1.0]
