"""Independent values among correlated ones: against sums over all pairs, and the coverage of their bands."""

import numpy as np
import pytest

from thalweg.accuracy import chi_square_band, independent_squares
from thalweg.accuracy.comparison_tables import correlated_sum, observed_correlation_s
from thalweg_lab.random_numbers import gauss_markov
from thalweg_lab.truth import PointErrors

TAU_S = 20.0


def visits(rng: np.random.Generator, n: int) -> np.ndarray:
    """Times of a range class: a place seen twice, with points at uneven rates, in no order."""
    first = 1000.0 + 90.0 * rng.beta(2.0, 5.0, n // 2)
    second = 1150.0 + 25.0 * rng.random(n - n // 2)
    return rng.permutation(np.concatenate([first, second]))


def test_the_sum_equals_that_over_all_pairs(rng):
    t, weight = np.sort(visits(rng, 400)), rng.uniform(0.5, 2.0, 400)
    pairs = weight[:, None] * weight[None] * np.exp(-np.abs(t[:, None] - t[None]) / TAU_S)
    assert correlated_sum(t, weight, TAU_S) == pytest.approx(pairs.sum(), rel=1e-12)


def test_numbers_equal_their_definitions(rng):
    t, a, b = visits(rng, 300), rng.uniform(0.5, 2.0, 300), rng.uniform(0.0, 0.5, 300)
    rho = np.exp(-np.abs(t[:, None] - t[None]) / TAU_S)
    C = np.sqrt(a[:, None] * a[None]) * rho + np.sqrt(b[:, None] * b[None])
    found = independent_squares(t, a, TAU_S, constant_m2=b)
    assert found == pytest.approx(np.trace(C) ** 2 / np.sum(C**2), rel=1e-10)


def test_limits():
    t = np.arange(50.0) * 1e6
    assert independent_squares(t, np.ones(50), TAU_S) == pytest.approx(50.0)
    assert independent_squares(np.zeros(50), np.ones(50), TAU_S) == pytest.approx(1.0)
    assert independent_squares(t, np.full(50, 1e-12), TAU_S, constant_m2=1.0) == pytest.approx(1.0, rel=1e-6)
    assert independent_squares(t, np.zeros(50), TAU_S) == 50.0
    assert independent_squares(np.zeros(0), np.zeros(0), TAU_S) == 0.0


def outside(t: np.ndarray, sigma: np.ndarray, constant: float, white: float, rng, trials: int):
    """Shares of surveys whose observed over predicted variance is below and above the band."""
    n = len(t)
    pose = np.exp(-np.abs(t[:, None] - t[None]) / TAU_S) * np.outer(sigma, sigma)
    root = np.linalg.cholesky(pose + 1e-12 * np.eye(n))
    errors = root @ rng.normal(size=(n, trials)) + constant * rng.normal(size=trials)
    errors += white * rng.normal(size=(n, trials))
    predicted = sigma**2 + constant**2 + white**2
    values = independent_squares(t, sigma**2 + white**2, TAU_S, constant_m2=constant**2)
    low, high = chi_square_band(values)
    q = np.sum(errors**2, axis=0) / predicted.sum()
    return float(np.mean(q < low)), float(np.mean(q > high))


@pytest.mark.parametrize("constant", [0.0, 0.03], ids=["poses", "poses and reference"])
def test_bands_of_a_class_cover_as_they_say(rng, constant):
    """Gauss-Markov errors of uneven size at the times of a class: 95 %, and not for want of large ones."""
    t = visits(rng, 300)
    sigma = rng.uniform(0.04, 0.12, 300)
    below, above = outside(t, sigma, constant, 0.0, rng, 4000)
    # the sum of correlated squares is not exactly chi-square, and 4000 trials know a share to 0.35 %
    assert 0.925 < 1 - below - above < 0.975
    assert above > 0.01


@pytest.mark.parametrize("tau_s", [5.0, 20.0, 60.0])
def test_the_correlation_time_of_errors_is_seen_in_them(rng, tau_s):
    """Also under white noise twice as large, with gaps in time, and if another time was assumed."""
    t = np.arange(0.0, 20_000.0, 0.5)
    error = gauss_markov(rng, len(t), 0.5, 1.0, tau_s) + 2.0 * rng.normal(size=len(t)) + 0.7
    there = np.sin(t / 300.0) > -0.6
    order = rng.permutation(np.flatnonzero(there))
    found = observed_correlation_s(t[order], error[order], 20.0)
    # 230 correlation times of the slowest error: its autocorrelation at one tau is known to about 8 % of the
    # variance, which moves the lag of 1/e by 20 %
    assert found == pytest.approx(tau_s, rel=0.4)


def test_a_correlation_time_that_cannot_be_seen_is_not_made_up(rng):
    t = np.arange(0.0, 100.0, 0.1)
    assert np.isnan(observed_correlation_s(t, np.tile([1.0, -1.0], 500), 20.0))
    assert np.isnan(observed_correlation_s(t[:1], np.ones(1), 20.0))
    assert np.isnan(observed_correlation_s(t, np.full(1000, 0.3), 20.0))


def test_an_error_is_gross_at_six_sigmas():
    """Five sigmas are a normal error in two million; the outlier rule of the truth must leave it in."""
    errors = PointErrors(
        t_gps_s=np.arange(4.0),
        range_m=np.full(4, 10.0),
        error_m=0.01 * np.array([3.1, -5.9, 6.1, -7.0]),
        sigma_m=np.full(4, 0.01),
        on_ground=np.array([True, True, True, False]),
    )
    assert errors.gross.tolist() == [False, False, True, True]
    assert errors.bare_ground.tolist() == [True, True, False, False]
