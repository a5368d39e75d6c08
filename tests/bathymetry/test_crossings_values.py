"""Crossings of a few segments, worked out by hand."""

import numpy as np
import pandas as pd
import pytest

from thalweg.bathymetry import find_crossings
from thalweg.bathymetry.crossings import (
    DAY_GAP_S,
    TIME_SPREAD,
    Crossings,
    _curvature,
    _intersections,
    _pairs,
    _relief_m2,
    estimate_slow_errors,
    runs_by_pauses,
    since_pauses,
)
from thalweg.core import NMAD


def soundings(**changes: object) -> pd.DataFrame:
    """Line 0 to the east from t = 0, line 1 to the north from t = 20, a ping a second, meet at (1.25, 0).

    Heights fall by 0.2 m a metre between the pings of line 0 about the place, by 0.1 on line 1.
    """
    return pd.DataFrame(
        {
            "t_gps_s": [0.0, 1.0, 2.0, 20.0, 21.0, 22.0],
            "east_m": [0.0, 1.0, 2.0, 1.25, 1.25, 1.25],
            "north_m": [0.0, 0.0, 0.0, -0.5, 0.5, 1.5],
            "up_m": [-1.0, -1.1, -1.3, -1.0, -1.1, -1.2],
            "sigma_white_m": [0.1, 0.1, 0.2, 0.3, 0.1, 0.1],
            "sigma_slow_m": [0.01, 0.02, 0.06, 0.04, 0.08, 0.08],
            "sigma_common_m": 0.02,
            "sigma_horizontal_m": [0.5, 0.1, 0.5, 0.2, 0.5, 0.5],
            "cov_uu_m2": 0.01,
            "line": [0, 0, 0, 1, 1, 1],
            "used": True,
        }
        | changes
    ).assign(t_even_s=lambda of: of["t_gps_s"])


def test_a_crossing_by_hand():
    found = find_crossings(soundings())
    assert len(found) == 1
    assert (found.a_s[0], found.b_s[0]) == pytest.approx((1.25, 20.5))
    assert (found.east_m[0], found.north_m[0]) == pytest.approx((1.25, 0.0))
    assert found.difference_m[0] == pytest.approx(-1.05 - -1.15)
    first = 0.75**2 * 0.01 + 0.25**2 * 0.04 + 0.2**2 * 0.1**2
    second = 0.5**2 * 0.09 + 0.5**2 * 0.01 + 0.1**2 * 0.2**2
    assert found.white_m2[0] == pytest.approx(first + second)  # the noise explains all relief
    assert (found.slow_a_m[0], found.slow_b_m[0]) == pytest.approx((0.03, 0.06))
    assert (found.at_a[0], found.at_b[0]) == (1, 3)


def test_pings_that_are_not_of_one_line_or_far_apart_are_no_segment():
    assert len(find_crossings(soundings(line=[0, 0, 1, 1, 1, 1]))) == 0
    assert len(find_crossings(soundings(line=[0, 0, 0, -1, -1, -1]))) == 0
    # a pause of four seconds where they meet, where pings come each second
    assert len(find_crossings(soundings(t_gps_s=[0.0, 1.0, 2.0, 20.0, 24.0, 25.0]))) == 0
    assert len(find_crossings(soundings(t_gps_s=[0.0, 1.0, 2.0, 20.0, 22.5, 23.5]))) == 1
    assert len(find_crossings(soundings().iloc[:1])) == 0


def test_lines_that_do_not_meet_cross_nowhere():
    assert len(find_crossings(soundings(north_m=[0.0, 0.0, 0.0, 90.0, 91.0, 92.0]))) == 0
    assert len(find_crossings(soundings(north_m=[0.0, 0.0, 0.0, 0.1, 1.1, 2.1]))) == 0
    beside = soundings(east_m=[0.0, 1.0, 2.0, 2.1, 2.1, 2.1])
    assert len(find_crossings(beside)) == 0


def test_four_hours_make_another_day_and_a_minute_another_run():
    t = np.array([0.0, 1.0, 2.0, 14_500.0, 14_501.0, np.nan])
    np.testing.assert_array_equal(since_pauses(t, DAY_GAP_S), [0, 0, 0, 1, 1, np.nan])
    assert since_pauses(np.array([0.0, 14_300.0]), DAY_GAP_S).tolist() == [0, 0]
    assert runs_by_pauses(np.array([0.0, 1.0, 2.0, 62.0, 63.0, 124.0])).tolist() == [0, 0, 0, 0, 0, 1]
    # pings every ten seconds: twenty of them
    assert runs_by_pauses(np.array([0.0, 10.0, 20.0, 30.0, 229.0, 430.0])).tolist() == [0] * 5 + [1]


def test_segments_meet_from_their_start_to_before_their_end():
    start = np.array([[0.0, 0.0], [1.0, -1.0], [2.0, -1.0], [30.0, 0.0]])
    stop = np.array([[2.0, 0.0], [1.0, 3.0], [2.0, 1.0], [30.0, 9.0]])
    i, j, u, v = _intersections(start, stop)  # the third is met at the end of the first
    assert (i.tolist(), j.tolist()) == ([0], [1])
    assert (u[0], v[0]) == pytest.approx((0.5, 0.25))
    i, j, _, _ = _intersections(start[:1], stop[:1])
    assert len(i) == len(j) == 0
    apart = _intersections(np.array([[0.0, 0.0], [99.0, 0.0]]), np.array([[1.0, 0.0], [100.0, 0.0]]))
    assert [len(each) for each in apart] == [0, 0, 0, 0]
    # long segments whose middles are 6 m apart
    i, j, u, v = _intersections(np.array([[0.0, 0.0], [9.0, -5.0]]), np.array([[10.0, 0.0], [9.0, 5.0]]))
    assert (u[0], v[0]) == pytest.approx((0.9, 0.5))


def test_relief_is_half_of_what_noise_does_not_explain():
    h, line = np.array([0.0, 0.4, 0.0, 0.4, 0.0]), np.zeros(5, dtype=np.int64)
    white = np.full(5, 0.04)
    assert _relief_m2(h, white, line) == pytest.approx(((NMAD * 0.4) ** 2 - 0.04 * 1.5) / 2)
    assert _relief_m2(h, white * 100, line) == 0.0
    assert _relief_m2(h, white, np.arange(5)) == 0.0


def crossings(k: int = 2, **changes: object) -> Crossings:
    given = {
        "a_s": np.array([0.0, 5.0]),
        "b_s": np.array([10.0, 25.0]),
        "east_m": np.zeros(2),
        "north_m": np.zeros(2),
        "difference_m": np.array([0.5, 0.5]),
        "white_m2": np.array([0.01, 0.01]),
        "slow_a_m": np.array([0.1, 0.2]),
        "slow_b_m": np.array([0.3, 0.4]),
        "at_a": np.zeros(2, dtype=np.int64),
        "at_b": np.ones(2, dtype=np.int64),
    }
    return Crossings(**given | changes)


def test_the_covariance_of_differences_by_hand():
    """Sigmas 0.1, 0.3 and 0.2, 0.4 at times 0, 10 and 5, 25; errors last 10 s."""
    found = crossings().slow_covariance_m2(10.0)
    assert found[0, 0] == pytest.approx(0.01 + 0.09 - 2 * 0.03 * np.exp(-1))
    assert found[1, 1] == pytest.approx(0.04 + 0.16 - 2 * 0.08 * np.exp(-2))
    across = 0.02 * np.exp(-0.5) - 0.04 * np.exp(-2.5) - 0.06 * np.exp(-0.5) + 0.12 * np.exp(-1.5)
    assert found[0, 1] == pytest.approx(across)
    assert found[1, 0] == pytest.approx(across)


def test_days_that_disagree_enlarge_the_common_sigma():
    later = soundings(t_gps_s=np.array([0.0, 1.0, 2.0, 14_500.0, 14_501.0, 14_502.0]))
    later.loc[3:, "up_m"] += 2.9
    later["transducer_up_m"] = 0.0
    out, time_s, facts = estimate_slow_errors(later, 10.0)
    assert facts["rms_m"] == pytest.approx(3.0)
    found = find_crossings(later)
    stated = found.white_m2[0] + 0.03**2 + 0.06**2
    assert facts["predicted_m"] == pytest.approx(np.sqrt(stated))
    assert facts["normalised_square"] == pytest.approx(9.0 / stated)
    # half the difference, of one degree of freedom: 84 % of Student's distribution
    more = out["sigma_common_m"].to_numpy() ** 2 - 0.02**2
    assert np.sqrt(more) == pytest.approx(1.837 * 1.5, rel=0.02)
    assert out["cov_uu_m2"].to_numpy() == pytest.approx(0.01 + more)
    assert out["up_m"].to_numpy() - later["up_m"].to_numpy() == pytest.approx(
        [1.5] * 3 + [-1.5] * 3, rel=0.02
    )
    assert (time_s, facts["n"], facts["estimated"]) == (10.0, 1, False)


def test_the_curvature_is_that_of_a_paraboloid_and_at_least_that_of_the_prior():
    H = np.array([[6.0, 1.0], [1.0, 4.0]])

    def bowl(x: np.ndarray) -> float:
        """A paraboloid whose second derivatives are H."""
        return float(x @ H @ x / 2)

    assert _curvature(bowl, np.array([0.3, -0.2])) == pytest.approx(H, abs=1e-9)
    flat = _curvature(lambda x: float(x[0] ** 2 * 5), np.zeros(2))
    assert flat == pytest.approx(np.diag([10.0, 2 / np.log(TIME_SPREAD) ** 2]), abs=1e-9)


@pytest.mark.parametrize("slow", [("slow_a_m",), ("slow_b_m",), ("slow_a_m", "slow_b_m")])
def test_a_pair_of_days_by_two_crossings_with_slow_errors_of_either(slow):
    """What both crossings share stays in their mean; the day of the smaller number is the first."""
    none = {name: np.zeros(2) for name in ("slow_a_m", "slow_b_m") if name not in slow}
    found = crossings(**none)
    variance = 0.01 + found.slow_covariance_m2(10.0).sum() / 2
    for part, sign in (([0, 1], 1.0), ([1, 0], -1.0)):
        (row,) = _pairs(found, np.array(part), 10.0).to_dict("records")
        assert (row["a"], row["b"], row["n"]) == (0, 1, 2)
        assert row["difference_m"] == pytest.approx(sign * 0.5)
        assert row["sigma_m"] == pytest.approx(1.2533 * np.sqrt(variance / 2))
        assert not row["contradicts"]  # two crossings tell nothing
    assert not len(_pairs(found, np.array([3, 3]), 10.0))


@pytest.mark.parametrize(
    ("d", "scatter", "contradicts"),
    [
        ([0.14] * 3, 0.0, False),
        ([0.145] * 3, 0.0, True),
        ([0.3, 0.5, 0.9], 1.4826 * 0.2 / np.sqrt(2 / 3), False),
        ([0.3, 0.405, 0.7], 1.4826 * 0.105 / np.sqrt(2 / 3), True),
        ([-0.3, 0.1, 0.7], 1.4826 * 0.4 / np.sqrt(2 / 3), False),
    ],
)
def test_a_pair_contradicts_beyond_95_percent_of_its_median(d, scatter, contradicts):
    """0.1 m of white noise each, or the scatter about the median where that is more."""
    zero = np.zeros(3)
    found = crossings(
        a_s=zero, b_s=zero, difference_m=np.array(d), white_m2=zero + 0.01, slow_a_m=zero, slow_b_m=zero,
        at_a=zero.astype(int), at_b=zero.astype(int) + 1,
    )  # fmt: skip
    (row,) = _pairs(found, np.array([0, 1]), 10.0).to_dict("records")
    assert row["difference_m"] == pytest.approx(np.median(d))
    assert row["sigma_m"] == pytest.approx(1.2533 * max(0.1, scatter) / np.sqrt(3), rel=1e-4)
    assert row["contradicts"] == contradicts
