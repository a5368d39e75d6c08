"""Scale of a free network from its bars, by hand."""

from contextlib import nullcontext

import numpy as np
import pytest
from scipy.stats import chi2

from thalweg.calibration.field.network import Scale, scale_of
from thalweg.core import GeometryError


def scale(length_m: list[float], sigma_m: list[float], units: list[float], network: list[float]) -> Scale:
    """By bars A, B ... of lengths with sigmas, and lengths in the network with sigmas."""
    given = (np.array(values, float) for values in (length_m, sigma_m, units))
    return scale_of(tuple("ABC"[: len(units)]), *given, np.diag(np.square(np.array(network, float))))


def test_two_equal_bars_are_their_mean():
    """2.000 and 2.002 m by certificates of 1 mm, both 1 unit long: 2.001 with 1 mm / sqrt 2."""
    found = scale([2.0, 2.002], [1e-3] * 2, [1, 1], [0, 0])
    assert found.factor == pytest.approx(2.001, abs=1e-12)
    assert found.sigma == pytest.approx(1e-3 / np.sqrt(2), rel=1e-9)
    assert found.used.all()
    # each against the other alone: 2 mm, with both certificates
    np.testing.assert_allclose(found.off_m, [-0.002, 0.002], atol=1e-12)
    np.testing.assert_allclose(found.sigma_off_m, np.sqrt(2) * 1e-3)


def test_the_network_has_its_part_in_the_sigma():
    """A bar of 3 m is 1.5 units long: 2 m a unit. Certificate 3 mm, network 0.002 units = 4 mm: 5 mm."""
    found = scale([3.0], [0.003], [1.5], [0.002])
    assert found.factor == pytest.approx(2.0)
    assert found.sigma == pytest.approx(0.005 / 1.5, rel=1e-9)
    assert (found.off_m[0], np.isnan(found.sigma_off_m[0])) == (0.0, True)


def test_a_longer_bar_counts_more():
    """Weights by length over sigma, squared: 1 and 9, so (1.01 + 9 x 1.00) / 10."""
    found = scale([1.01, 3.0], [0.01] * 2, [1, 3], [0, 0])
    assert found.factor == pytest.approx(1.001, abs=1e-12)
    assert found.sigma == pytest.approx(0.01 / np.sqrt(10), rel=1e-9)


@pytest.mark.parametrize(("share", "fits"), [(0.99, True), (1.01, False)])
def test_two_bars_contradict_beyond_one_degree_of_freedom(share, fits):
    """15.137 is exceeded by 0.01 % of chi-squares of one degree (Abramowitz and Stegun 1964, table 26.8)."""
    assert chi2.isf(1e-4, 1) == pytest.approx(15.137, abs=1e-3)
    off = 1e-3 * np.sqrt(2 * 15.137 * share)
    told = pytest.raises(GeometryError, match=r"A and B contradict .* B is -\d\.\d\d mm longer")
    with nullcontext() if fits else told:
        scale([2.0, 2.0 + off], [1e-3] * 2, [1, 1], [0, 0])


def test_of_three_bars_the_wrong_one_is_left_out():
    alike = [1e-3] * 3, [1] * 3, [0] * 3
    found = scale([2.0, 2.02, 2.001], *alike)
    assert found.used.tolist() == [True, False, True]
    assert found.factor == pytest.approx(2.0005, abs=1e-12)
    assert found.off_m[1] == pytest.approx(0.0195, abs=1e-12)
    assert found.sigma_off_m[1] == pytest.approx(1e-3 * np.sqrt(1.5))
    with pytest.raises(GeometryError, match="more than one of the scale bars A, B, C is wrong"):
        scale([2.0, 2.02, 2.04], *alike)
    with pytest.raises(GeometryError, match="no scale bar"):
        scale([], [], [], [])


def test_two_bars_that_contradict_are_told_with_the_difference():
    """Bars of 2 m, 1.00 and 1.01 units long: by the first one a unit is 2 m, and the second bar 2.02 m."""
    with pytest.raises(GeometryError, match=r"by A, B is \+20\.00 mm longer than its 2\.00000 m"):
        scale([2.0, 2.0], [1e-3] * 2, [1, 1.01], [0, 0])


def test_how_far_a_bar_is_off_by_another_one():
    """Bars of 2.01 and 3 m, 4 and 6 units long: by the second a unit is 0.5 m, and the first 10 mm too short.

    Its sigma: certificate 20 mm, network 0.01 units, and the scale by the second (30 mm, 0.02 units) times 4.
    """
    found = scale([2.01, 3.0], [0.02, 0.03], [4, 6], [0.01, 0.02])
    by_second = np.hypot(0.03, 0.5 * 0.02) / 6
    by_first = np.hypot(0.02, 0.5025 * 0.01) / 4
    np.testing.assert_allclose(found.off_m, [0.01, 3.0 - 0.5025 * 6], atol=1e-12)
    np.testing.assert_allclose(
        found.sigma_off_m,
        [
            np.sqrt(0.02**2 + (0.5 * 0.01) ** 2 + (4 * by_second) ** 2),
            np.sqrt(0.03**2 + (0.5025 * 0.02) ** 2 + (6 * by_first) ** 2),
        ],
    )
