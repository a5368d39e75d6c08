"""Sizes of errors in arrays, by hand."""

import numpy as np
import pytest

from thalweg.core.types import NMAD, robust_sigma, root_mean_square


def test_sizes_of_errors():
    assert root_mean_square([3.0, -4.0, 0.0, 0.0]) == 2.5
    assert root_mean_square(np.array([[7.0], [-1.0]])) == 5.0
    assert abs(0.674489750 * NMAD - 1.0) < 1e-4
    # distances from the median 2: 1, 0, 98 have the median 1; from 5: 4, 3, 95
    assert robust_sigma([1.0, 2.0, 100.0]) == pytest.approx(1.4826)
    assert robust_sigma([1.0, 2.0, 100.0], centre=5.0) == pytest.approx(4 * 1.4826)
