"""The jackknife over time blocks is what leaving blocks out gives; blocks are as long as a survey allows."""

import numpy as np
import pytest

from thalweg.accuracy.registration import block_covariance, share_within_blocks, time_blocks
from thalweg_lab.random_numbers import gauss_markov


def test_it_is_the_spread_of_fits_without_one_block(rng):
    """Least squares are linear: the fits without a block can be made, one by one."""
    n, tau = 4000, 1.0
    t = np.sort(rng.uniform(0.0, 30.0, n))
    design = np.column_stack([np.ones(n), t - 15.0, rng.normal(size=n)])
    errors = rng.normal(size=n) + np.repeat(rng.normal(size=20), 200)
    whole = np.linalg.lstsq(design, errors, rcond=None)[0]
    rest = errors - design @ whole
    found = block_covariance(design, rest, np.ones(n), t_gps_s=t, correlation_s=tau)
    number, length = time_blocks(t, tau)
    assert length == 2.0
    changes = np.array(
        [
            np.linalg.lstsq(design[number != k], errors[number != k], rcond=None)[0] - whole
            for k in range(number.max() + 1)
        ]
    )
    wanted = (len(changes) - 1) / len(changes) * changes.T @ changes / share_within_blocks(2.0, 1.0)
    np.testing.assert_allclose(found.cov, wanted, rtol=1e-9)


@pytest.mark.parametrize("block_s", [2.0, 5.0])
def test_the_share_within_blocks_is_that_of_sums(rng, block_s):
    x = gauss_markov(rng, 400_000, 0.05, 1.0, 1.0)
    sums = x.reshape(-1, round(block_s / 0.05)).sum(axis=1)
    # 20,000 s are worth 10,000 values of the whole: its variance 2 tau sigma^2 / step^2 an s is known exactly
    whole = 2.0 * 400_000 * 0.05 / 0.05**2
    assert np.sum(sums**2) / whole == pytest.approx(share_within_blocks(block_s, 1.0), rel=0.06)


def test_blocks_are_longer_where_there_are_many_and_pauses_count_for_nothing():
    def length(duration_s: float) -> float:
        return time_blocks(np.arange(0.0, duration_s, 0.1), 1.0)[1]

    assert length(30.0) == 2.0
    assert length(100.0) == pytest.approx(5.0)
    assert length(5000.0) == 10.0
    passes = np.concatenate([np.arange(0.0, 10.0, 0.1), np.arange(1000.0, 1010.0, 0.1)])
    number, size = time_blocks(passes, 1.0)
    assert (number.max() + 1, size) == (10, 2.0)


def test_few_blocks_or_one_that_rules_give_no_covariance(rng):
    t = np.arange(0.0, 20.0, 0.01)
    ones = np.ones(len(t))
    residual = rng.normal(size=len(t))

    def found(design: np.ndarray, duration_s: float):
        use = t < duration_s
        return block_covariance(design[use], residual[use], ones[use], t_gps_s=t[use], correlation_s=1.0)

    assert found(ones[:, None], 20.0).cov is not None
    short = found(ones[:, None], 6.0)
    assert (short.cov, round(short.blocks, 6), short.needed) == (None, 3.0, 4)
    # the second parameter is seen in one block only: leaving it out leaves nothing
    one = np.column_stack([ones, (t < 1.9).astype(float)])
    assert found(one, 20.0).cov is None
    # a block with few points is worth little
    few = (t < 8.0) | ((t > 8.0) & (np.arange(len(t)) % 50 == 0))
    thin = block_covariance(ones[few, None], residual[few], ones[few], t_gps_s=t[few], correlation_s=1.0)
    assert thin.blocks == pytest.approx(4.3, abs=0.2)
