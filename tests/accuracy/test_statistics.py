"""Words of accuracy, range classes, and a band that knows about correlation."""

import numpy as np
import pytest

from thalweg.accuracy.statistics import (
    by_range_class,
    chi_square_band,
    describe_errors,
    independent_values,
)


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


@pytest.mark.parametrize(("duration_s", "tau_s"), [(180.0, 20.0), (60.0, 10.0), (1000.0, 20.0), (10.0, 20.0)])
def test_the_band_holds_for_correlated_errors(
    rng: np.random.Generator, duration_s: float, tau_s: float
) -> None:
    """Gauss-Markov errors, stationary from the start: the band of the normalised square covers as it says."""
    step_s, trials = 0.5, 2000
    n = int(duration_s / step_s)
    keep = np.exp(-step_s / tau_s)
    x = rng.normal(size=trials)
    total = np.zeros(trials)
    for _ in range(n):
        x = keep * x + np.sqrt(1 - keep**2) * rng.normal(size=trials)
        total += x**2
    low, high = chi_square_band(independent_values(duration_s, tau_s))
    share = np.mean((total / n > low) & (total / n < high))
    # The mean of correlated squares is not exactly chi-square, and 2000 trials know a share to 0.5 %: 95 % is
    # met within 3 %, on both sides.
    assert 0.92 < share < 0.985


def test_uncorrelated_errors_are_all_independent() -> None:
    assert independent_values(1000.0, 1.0) == pytest.approx(1000.0, rel=0.001)
    assert independent_values(1.0, 1000.0) == pytest.approx(1.0, abs=0.001)
