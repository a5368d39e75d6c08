"""Bands over surveys: do they hold consistent sigmas as often as they promise, and no others?"""

import numpy as np
import pytest

from thalweg.core import CoverageError
from thalweg_lab.truth import consistency_by_range, ratio_of_surveys


def surveys(rng: np.random.Generator, m: int, independent: int) -> tuple[np.ndarray, np.ndarray]:
    """Sums of squared errors and of variances of surveys whose many points are worth a few values each."""
    predicted = rng.uniform(200.0, 2000.0, m)
    return predicted * rng.chisquare(independent, m) / independent, predicted


def test_the_band_keeps_what_it_promises(rng):
    outside = 0
    for _ in range(2000):
        ratio, low, high, _ = ratio_of_surveys(*surveys(rng, 36, 4), level=0.95)
        outside += not low < ratio < high
    # 0.05 promised; the logarithm of a chi-square sum is not quite normal. Binomial sigma: 0.005.
    assert 0.035 < outside / 2000 < 0.08


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_wrong_sigmas_leave_the_band(rng, factor):
    seen = 0
    for _ in range(200):
        observed, predicted = surveys(rng, 36, 4)
        ratio, low, high, _ = ratio_of_surveys(observed, factor**2 * predicted)
        seen += not low < ratio < high
    # log 1.56 = 0.45 is 3.2 sigmas of the logarithm: the weights leave 29 surveys of 4 values, sqrt(2 / 116)
    # = 0.13, and the spread estimated from them adds a little; a normal variable passes 2 of 3.2 in 88 %
    assert seen > 165


def test_the_ratio_is_predicted_over_observed():
    ratio, low, high, m = ratio_of_surveys(np.array([4.0, 4.0, 4.0]), np.array([1.0, 1.0, 1.0]))
    assert (ratio, low, high) == pytest.approx((0.5, 1.0, 1.0))
    assert m == pytest.approx(3.0)
    # two surveys of three hardly have a point: worth one survey, not three
    assert ratio_of_surveys(np.ones(3), np.array([1.0, 1e-3, 1e-3]))[3] == pytest.approx(1.0, abs=0.01)


def test_one_survey_tells_no_spread():
    with pytest.raises(CoverageError, match="1 surveys with points"):
        ratio_of_surveys(np.array([1.0, 0.0]), np.array([1.0, 0.0]))
    with pytest.raises(CoverageError, match="1 surveys with points"):
        consistency_by_range(np.zeros(5, dtype=int), *(np.ones(5) for _ in range(3)))


def test_two_surveys_by_hand():
    """Sums 1 and 3 of squares, 1 predicted: q = 2, s / q = sqrt(2 (1 + 1)) / 4 = 0.5; m / (m - 1) is 2.

    Student's 97.5 % for one degree of freedom is 12.706 (any table): log q within 6.353, its root half of it.
    """
    ratio, low, high, surveys = ratio_of_surveys(np.array([1.0, 3.0]), np.array([1.0, 1.0]))
    assert (ratio, surveys) == pytest.approx((2**-0.5, 2.0))
    assert (low, high) == pytest.approx((np.exp(-6.353 / 2), np.exp(6.353 / 2)), rel=1e-3)


def test_points_without_a_predicted_variance_are_refused():
    """A sigma of zero, or none, is a mistake: left out, it would make the others look consistent."""
    number, range_m, ones = np.repeat(np.arange(20), 2), np.tile([10.0, 30.0], 20), np.ones(40)
    for wrong in (0.0, -1.0, np.nan):
        for where in (range_m == 30.0, np.arange(40) == 7):
            with pytest.raises(CoverageError, match=rf"40 points, {where.sum()} of them without a predicted"):
                consistency_by_range(number, range_m, ones, np.where(where, wrong, ones))
    with pytest.raises(CoverageError, match="0 points"):
        consistency_by_range(np.empty(0, dtype=int), *(np.empty(0) for _ in range(3)))
    with pytest.raises(CoverageError, match="1 surveys with errors but without a predicted variance"):
        ratio_of_surveys(np.array([1.0, 2.0, 3.0, 0.0]), np.array([1.0, 2.0, 0.0, 0.0]))


def test_a_table_of_two_classes_by_hand():
    """Survey A has errors of 1, 3, 6 at 10, 10, 12 m; B of 2, 2, 8: predicted 4, 1, 9 for both.

    Class 10: squares 10 and 8 against 5 and 5; class 11 is empty; class 12: 36 and 64 against 9 and 9. Two
    equal surveys count two. Level 0.9 for both classes is 0.95 for each: 12.706 spreads by Student.
    """
    table = consistency_by_range(
        np.array([7, 7, 7, 3, 3, 3]),
        np.array([9.6, 10.5, 12.0, 10.0, 10.2, 12.4]),
        np.square([1.0, 3.0, 6.0, 2.0, 2.0, 8.0]),
        np.array([4.0, 1.0, 9.0, 4.0, 1.0, 9.0]),
        level=0.9,
        least_surveys=1.9,
    )
    # the spread of q over q: both halves of the difference, times the root of m / (m - 1) = 2
    reach = [12.706 * np.sqrt(2 * 2) / 18, 12.706 * np.sqrt(2 * 2 * 14**2) / 100]
    expected = {
        "range_from_m": [9.5, 10.5],
        "range_to_m": [10.5, 12.5],
        "n": [4, 2],
        "surveys": [2.0, 2.0],
        "rmse_observed_m": np.sqrt([18 / 4, 100 / 2]),
        "rmse_predicted_m": np.sqrt([10 / 4, 18 / 2]),
        "ratio": np.sqrt([10 / 18, 18 / 100]),
        "ratio_low": np.exp(np.divide(reach, -2)),
        "ratio_high": np.exp(np.divide(reach, 2)),
        "inside": [True, True],
    }
    assert list(table.columns) == list(expected)
    for name, values in expected.items():
        np.testing.assert_allclose(table[name].to_numpy(dtype=float), values, rtol=1e-4, err_msg=name)


def test_what_is_left_at_the_far_end_is_joined_with_the_last_class():
    """Both surveys see 10 and 12 m, one alone 13 and 14 m."""
    number, range_m = np.array([0, 0, 0, 0, 1, 1]), np.array([10.0, 12.0, 13.0, 14.0, 10.0, 12.0])
    table = consistency_by_range(number, range_m, np.ones(6), np.ones(6), least_surveys=1.5)
    assert table["range_from_m"].tolist() == [9.5, 10.5]
    assert table["range_to_m"].tolist() == [10.5, 14.5]
    assert table["n"].tolist() == [2, 4]
    # 3 points and 1: 4^2 / (3^2 + 1^2)
    assert table["surveys"].tolist() == pytest.approx([2.0, 1.6])
    # where no class has enough surveys, one holds all
    alone = consistency_by_range(number, range_m, np.ones(6), np.ones(6), least_surveys=3.0)
    assert alone[["range_from_m", "range_to_m", "n"]].to_numpy().tolist() == [[9.5, 14.5, 6]]
