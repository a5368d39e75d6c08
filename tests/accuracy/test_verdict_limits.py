"""Verdicts just inside and just outside their limits."""

import numpy as np
import pytest

from thalweg.accuracy.statistics import consistency_in_words, ratio_band, verdict_of, verdict_of_ratio


@pytest.mark.parametrize(
    ("normalised", "n", "verdict"),
    [
        # chi-square of 40: 24.433 and 59.342 at 2.5 and 97.5 % (any table)
        (0.60, 40, "too pessimistic"),
        (0.62, 40, "consistent"),
        (1.48, 40, "consistent"),
        (1.49, 40, "too optimistic"),
        (1.0, 5, "too few data"),  # 0.831 and 12.833: a band of a factor of 3.93 in sigma
        (np.nan, 40, "too few data"),
        (1.0, 0.9, "too few data"),
    ],
)
def test_verdicts_of_squares(normalised, n, verdict):
    assert verdict_of(normalised, n) == verdict


@pytest.mark.parametrize(
    ("ratio", "verdict"),
    [(0.89, "too optimistic"), (0.91, "consistent"), (1.24, "consistent"), (1.26, "too pessimistic")],
)
def test_verdicts_of_ratios(ratio, verdict):
    """Predicted over observed: below the band sigmas are too small."""
    assert verdict_of_ratio(ratio, 0.9, 1.25) == verdict
    words = consistency_in_words(ratio, 0.9, 1.25)
    if verdict == "consistent":
        assert "more than 10 % too small or 25 % too large" in words
    else:
        assert f"{1 / ratio:.{2 if abs(1 / ratio - 1) < 0.1 else 1}f} times as large as predicted" in words
        assert "outside 0.90 to 1.25" in words


def test_a_band_as_wide_as_a_factor_of_three_tells_nothing():
    assert verdict_of_ratio(1.0, 0.6, 1.79) == "consistent"
    assert verdict_of_ratio(1.0, 0.6, 1.81) == "too few data"


def test_the_band_of_ratios_is_one_over_the_roots_of_that_of_squares():
    assert ratio_band(40) == pytest.approx(((59.342 / 40) ** -0.5, (24.433 / 40) ** -0.5), abs=1e-4)
