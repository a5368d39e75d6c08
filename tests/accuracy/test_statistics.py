"""Words of accuracy, range classes, and a band that knows about correlation."""

import numpy as np
import pytest

from thalweg.accuracy.statistics import block_band, by_range_class, describe_errors


def test_words_on_a_sample_worked_by_hand() -> None:
    found = describe_errors(np.array([1.0, 2.0, 3.0, 10.0, np.nan]))
    assert found["n"] == 4
    assert found["bias_m"] == 4.0
    assert found["rmse_m"] == pytest.approx(np.sqrt(114 / 4))
    assert found["median_m"] == 2.5
    assert found["nmad_m"] == pytest.approx(1.4826 * 1.0)
    assert found["rmse_m"] ** 2 == pytest.approx(found["bias_m"] ** 2 + found["std_m"] ** 2)
    assert describe_errors(np.array([np.nan])) == {"n": 0.0}


def test_range_classes_close_at_their_upper_edge() -> None:
    """P2 eq. 10: D - 0.5 < d <= D + 0.5."""
    ranges = np.array([4.5, 4.500001, 5.5, 5.500001])
    table = by_range_class(ranges, np.array([1.0, 4.0, 16.0, 9.0]), np.ones(4))
    assert table["range_m"].tolist() == [4, 5, 6]
    assert table["n"].tolist() == [1, 2, 1]
    assert table["rmse_observed_m"].tolist() == [1.0, pytest.approx(np.sqrt(10.0)), 3.0]


def test_band_of_correlated_errors_covers_the_truth(rng: np.random.Generator) -> None:
    """Squared errors that share a value for 1 s: a naive band would be 10 times too narrow."""
    inside = 0
    trials = 60
    for _ in range(trials):
        t = np.arange(0, 60, 0.01)
        error = np.repeat(rng.normal(size=60), 100)
        _, low, high = block_band(error**2, t, block_s=2.0, rng=rng, draws=200)
        inside += low <= 1.0 <= high
    # a bootstrap of 30 blocks of chi-square values undercovers a little: 95 % nominal, 85 % demanded, and
    # not everything, or the band would say nothing
    assert 0.8 * trials <= inside < trials
