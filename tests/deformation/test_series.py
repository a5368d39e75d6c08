"""Series of epochs: generalised least squares against full matrices, steps, jumps, closure."""

import numpy as np
import pytest
from scipy.stats import chi2

from thalweg.core import ArrayF, GeometryError, InputError
from thalweg.deformation.series import closure, find_jumps, fit_series

T = np.array([0.0, 0.3, 0.5, 1.1, 1.9, 2.2, 3.0])


def errors(rng: np.random.Generator) -> tuple[ArrayF, ArrayF]:
    root = np.tril(rng.normal(0.0, 0.02, (7, 7)))
    return rng.uniform(0.01, 0.05, 7), root @ root.T


def test_trend_and_step_are_those_of_the_full_matrices():
    """Places with gaps; the other side is solved with inverse covariances, one place at a time."""
    rng = np.random.default_rng(1)
    sigma, common = errors(rng)
    height = rng.normal(0.0, 0.1, (7, 30))
    height[2, :10] = height[4, 5:15] = np.nan
    height[:5, 0] = np.nan
    table = fit_series(T, height, sigma, common)
    each = fit_series(T, height, np.tile(sigma[:, None], 30), common)
    np.testing.assert_allclose(table.to_numpy(float), each.to_numpy(float), rtol=1e-9)
    assert table["n_epochs"].tolist() == np.isfinite(height).sum(axis=0).tolist()
    assert np.isnan(table.loc[0, "trend_m_a"])
    for place in range(1, 30):
        at = np.flatnonzero(np.isfinite(height[:, place]))
        P = np.linalg.inv(np.diag(sigma**2)[np.ix_(at, at)] + common[np.ix_(at, at)])
        A = np.column_stack([np.ones(len(at)), T[at] - T[at].mean()])
        Q = np.linalg.inv(A.T @ P @ A)
        gain = Q @ A.T @ P
        row = table.loc[place]
        assert row.trend_m_a == pytest.approx((gain @ height[at, place])[1], rel=1e-9)
        assert row.sigma_trend_m_a == pytest.approx(np.sqrt(Q[1, 1]), rel=1e-9)
        shared = gain[1] @ common[np.ix_(at, at)] @ gain[1]
        assert row.sigma_trend_common_m_a == pytest.approx(np.sqrt(shared), rel=1e-9)
        best = (0.0, 0.0, 0.0, -1)
        for e in range(1, len(at) - 2):
            B = np.column_stack([A, np.arange(len(at)) > e])
            Q = np.linalg.inv(B.T @ P @ B)
            step, spread = (Q @ B.T @ P @ height[at, place])[2], np.sqrt(Q[2, 2])
            best = max(best, (abs(step) / spread, step, spread, int(at[e])))
        assert (row.step_m, row.sigma_step_m) == pytest.approx(best[1:3], rel=1e-8)
        assert row.step_after_epoch == best[3]


def test_distances_from_the_first_epoch_give_the_same_trend_as_their_full_covariance():
    rng = np.random.default_rng(2)
    sigma, _ = errors(rng)
    height = rng.normal(0.0, 0.1, (7, 5))
    distance = height - height[0]
    table = fit_series(T, distance, sigma)
    C = np.diag(sigma[1:] ** 2) + sigma[0] ** 2  # each distance holds the error of the first epoch
    P, A = np.linalg.inv(C), (T[1:] - T[0])[:, None]
    variance = 1.0 / (A.T @ P @ A)[0, 0]
    assert table["trend_m_a"].to_numpy() == pytest.approx(variance * (A.T @ P @ distance[1:])[0], rel=1e-9)
    assert table["sigma_trend_m_a"].to_numpy() == pytest.approx(np.sqrt(variance), rel=1e-9)


def test_trends_err_as_their_sigmas_say_and_common_errors_stay_in_the_mean():
    rng = np.random.default_rng(3)
    common, k, draws = np.diag([0.03, 0.01, 0.04, 0.02, 0.03, 0.01, 0.05]) ** 2, 200, 300
    sigma = np.full(7, 0.02)
    means, squares = [], []
    for _ in range(draws):
        epoch = np.sqrt(np.diag(common)) * rng.standard_normal(7)
        height = 0.1 * T[:, None] + epoch[:, None] + sigma[:, None] * rng.standard_normal((7, k))
        table = fit_series(T, height, sigma, common)
        means.append(table["trend_m_a"].mean() - 0.1)
        squares.append((table.loc[0, "trend_m_a"] - 0.1) ** 2 / table.loc[0, "sigma_trend_m_a"] ** 2)
    low, high = chi2.ppf([0.0005, 0.9995], draws)
    assert low < sum(squares) < high
    own = table["sigma_trend_m_a"][0] ** 2 - table["sigma_trend_common_m_a"][0] ** 2
    variance = table["sigma_trend_common_m_a"][0] ** 2 + own / k
    assert low < np.sum(np.square(means)) / variance < high


def test_a_step_is_found_where_it_is_and_seldom_elsewhere():
    rng = np.random.default_rng(4)
    height = 0.05 * T[:, None] + 0.02 * rng.standard_normal((7, 2000))
    height[4:, :1000] += 0.3
    table = fit_series(T, height, np.full(7, 0.02))
    stepped, still = table[:1000], table[1000:]
    assert (stepped["step_after_epoch"] == 3).mean() > 0.95
    right = stepped[stepped["step_after_epoch"] == 3]
    assert right["step_m"].mean() == pytest.approx(0.3, abs=0.005)
    assert (stepped["p_step"] < 0.001).mean() > 0.99
    # Bonferroni's bound over four places in time, that hang together
    assert 0.02 < (still["p_step"] < 0.05).mean() < 0.06


def test_what_cannot_be_fitted_is_refused():
    with pytest.raises(InputError, match="three or more ascending times"):
        fit_series(T[::-1], np.zeros((7, 2)), np.ones(7))
    with pytest.raises(InputError, match=r"sigmas \(6,\)"):
        fit_series(T, np.zeros((7, 2)), np.ones(6))
    with pytest.raises(InputError, match="without a standard deviation"):
        fit_series(T, np.zeros((7, 2)), np.zeros(7))


def test_an_epoch_that_jumps_and_returns_is_flagged_and_a_wandering_bar_is_not():
    rng = np.random.default_rng(5)
    height = 0.02 * rng.standard_normal((5, 400))
    height[2] += 0.1
    assert [jump.epoch for jump in find_jumps(height, np.full(4, 0.05)) if jump.flagged] == [2]
    # within the sigma of one of the two steps
    assert not any(jump.flagged for jump in find_jumps(height, np.array([0.05, 0.05, 0.2, 0.05])))
    # a third of the area goes up and comes back: not most of it
    bar = 0.02 * rng.standard_normal((5, 400))
    bar[2, :130] += 1.0
    assert not any(jump.flagged for jump in find_jumps(bar, np.full(4, 0.001)))
    # a step stays
    step = 0.02 * rng.standard_normal((5, 400)) + np.array([0, 0, 0.1, 0.1, 0.1])[:, None]
    assert not any(jump.flagged for jump in find_jumps(step, np.full(4, 0.02)))
    with pytest.raises(InputError, match="5 epochs and 3 sigmas"):
        find_jumps(height, np.ones(3))
    height[2] = np.nan
    with pytest.raises(GeometryError, match="epochs 1 and 2"):
        find_jumps(height, np.ones(4))


def test_closure_counts_what_is_left():
    steps = np.array([[0.1, 0.2, np.nan], [0.3, -0.1, 0.0]])
    found = closure(steps, np.array([0.4, 0.4, 0.0]))
    assert found.n == 2
    assert (found.mean_m, found.rms_m, found.largest_m) == pytest.approx((-0.15, 0.3 / np.sqrt(2.0), 0.3))
    with pytest.raises(GeometryError, match="no place"):
        closure(steps[:, 2:], np.zeros(1))
