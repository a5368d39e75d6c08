"""Words of accuracy, range classes, and a band that knows about correlation."""

import numpy as np
import pytest

from thalweg.accuracy import by_range_class, chi_square_band, consistency_in_words, describe_errors
from thalweg.accuracy.statistics import (
    NORMAL_SHARES,
    _times,
    describe_shape,
    fit_in_words,
    outlier_limits,
    ratio_band,
)


def test_words_on_a_sample_worked_by_hand():
    found = describe_errors(np.array([1.0, 2.0, 3.0, 10.0, np.nan]))
    assert found["n"] == 4
    assert found["bias_m"] == 4.0
    assert found["rmse_m"] == pytest.approx(np.sqrt(114 / 4))
    assert found["median_m"] == 2.5
    assert found["nmad_m"] == pytest.approx(1.4826 * 1.0)
    assert found["rmse_m"] ** 2 == pytest.approx(found["bias_m"] ** 2 + found["std_m"] ** 2)
    assert describe_errors(np.array([np.nan])) == {"n": 0.0}


def test_range_classes_close_at_their_upper_edge():
    """P2 eq. 10: D - 0.5 < d <= D + 0.5."""
    ranges = np.array([4.5, 4.500001, 5.5, 5.500001])
    table = by_range_class(ranges, np.array([1.0, 4.0, 16.0, 9.0]), np.ones(4))
    assert table["range_m"].tolist() == [4, 5, 6]
    assert table["n"].tolist() == [1, 2, 1]
    assert table["rmse_observed_m"].tolist() == [1.0, pytest.approx(np.sqrt(10.0)), 3.0]


def test_shares_of_a_normal_distribution_are_those_of_the_thesis():
    """T 3.1.2: 68, 95 and 99.7 %."""
    assert [round(100 * share, 1) for share in NORMAL_SHARES] == [68.3, 95.4, 99.7]


def test_the_shape_of_known_distributions(rng):
    normal = describe_shape(0.02 + 0.05 * rng.normal(size=200_000))
    # standard errors of 200,000 normal values: skewness 0.005, kurtosis 0.011, shares 0.001
    assert abs(normal["skewness"]) < 0.02
    assert abs(normal["excess_kurtosis"]) < 0.04
    for k, share in enumerate(NORMAL_SHARES, start=1):
        assert normal[f"within_{k}_std"] == pytest.approx(share, abs=0.004)
        assert normal[f"within_{k}_nmad"] == pytest.approx(share, abs=0.006)
    assert "a normal distribution fits" in fit_in_words(normal)
    uneven = describe_shape(rng.exponential(size=200_000))
    assert uneven["skewness"] == pytest.approx(2.0, abs=0.1)
    assert uneven["excess_kurtosis"] == pytest.approx(6.0, abs=0.8)
    assert "more in the middle and far out" in fit_in_words(uneven)
    assert "less in the middle" in fit_in_words(describe_shape(rng.random(200_000)))


def test_the_shape_of_equal_and_of_no_errors():
    same = describe_shape(np.full(9, 0.3))
    assert same["skewness"] == same["excess_kurtosis"] == 0.0
    assert same["within_1_std"] == 1.0
    assert describe_shape(np.array([np.nan])) == {}


def test_the_outlier_rule_is_about_the_median(rng):
    errors = np.concatenate([0.06 + 0.05 * rng.normal(size=10_000), np.full(500, 3.0)])
    low, high = outlier_limits(errors, 5.0)
    assert (low + high) / 2 == pytest.approx(np.median(errors))
    # NMAD of the good ones is 0.05; 5 % of gross errors on one side widen it by some percent
    assert (high - low) / 2 == pytest.approx(0.25, rel=0.12)
    assert outlier_limits(np.zeros(10), 5.0) == (-np.inf, np.inf)


@pytest.mark.parametrize(
    ("ratio", "limits", "words"),
    [
        (1.02, (0.90, 1.12), "sigmas are consistent: predicted over observed is 1.02, inside 0.90 to 1.12"),
        (
            0.50,
            (0.85, 1.19),
            "2.0 times as large as predicted: predicted over observed is 0.50, outside 0.85",
        ),
        (2.00, (0.85, 1.19), "0.5 times as large as predicted: predicted over observed is 2.00, outside"),
        (0.985, (0.99, 1.01), "1.02 times as large"),
        # inside, but the band would have let pass more than 15 %
        (1.02, (0.86, 1.16), "is 1.02, inside 0.86 to 1.16; the test detects sigmas only if more than 14 %"),
        (1.02, (0.60, 2.50), "detects sigmas only if more than 40 % too small or 150 % too large"),
        # a narrow band, but more than 10 % off
        (1.12, (0.88, 1.14), "detects sigmas only if more than 12 % too small or 14 % too large"),
    ],
)
def test_verdicts_in_words(ratio, limits, words):
    assert words in consistency_in_words(ratio, *limits)


def test_the_band_of_the_ratio_is_that_of_the_squares_turned_round():
    low, high = chi_square_band(12.0)
    assert ratio_band(12.0) == (pytest.approx(high**-0.5), pytest.approx(low**-0.5))


def test_p95_is_the_95th_percentile_of_the_absolute_errors():
    """0, -1, 2, -3 .. 100 mm: 95 % are at most 95 mm."""
    errors = np.arange(101.0) * np.where(np.arange(101) % 2, -1e-3, 1e-3)
    assert describe_errors(errors)["p95_m"] == pytest.approx(0.095, abs=1e-12)


def test_the_chi_square_band_is_that_of_the_table():
    """Ten degrees of freedom: 3.247 and 20.483 at 95 %, 2.156 and 25.188 at 99 % (Abramowitz and Stegun)."""
    assert chi_square_band(10) == pytest.approx((0.3247, 2.0483), abs=1e-4)
    assert chi_square_band(10, 0.99) == pytest.approx((0.2156, 2.5188), abs=1e-4)


def test_a_class_has_the_root_of_the_mean_square():
    """Squares 1, 1 and 7 mm^2 against 4 mm^2 predicted: 3 and 4."""
    table = by_range_class(np.full(3, 10.0), 1e-6 * np.array([1.0, 1.0, 7.0]), np.full(3, 4e-6))
    assert table["rmse_observed_m"].tolist() == pytest.approx([1e-3 * np.sqrt(3)])
    assert table["rmse_predicted_m"].tolist() == pytest.approx([2e-3])
    assert table["n"].tolist() == [3]


@pytest.mark.parametrize(
    ("factor", "words"), [(1.6, "1.6"), (1.1, "1.1"), (1.05, "1.05"), (0.97, "0.97"), (1.004, "1.004")]
)
def test_factors_near_one_have_the_digits_that_tell_them_from_it(factor, words):
    assert _times(factor) == f"{words} times as large"
