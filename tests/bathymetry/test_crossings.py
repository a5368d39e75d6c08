"""Crossings of lines of soundings: where they are, how large the slow errors are, days that disagree."""

import numpy as np
import pandas as pd
import pytest

from tests.bands import band
from thalweg.bathymetry import estimate_slow_errors, find_crossings

SPEED_MPS, STEP_S = 1.2, 0.2


def survey(
    seed: int,
    *,
    slow_m: float = 0.03,
    time_s: float = 10.0,
    white_m: float = 0.01,
    stated_m: float = 0.03,
    legs: int = 8,
    later_m: float | None = None,
    pause_s: float = 86_400.0,
) -> pd.DataFrame:
    """A zigzag down a channel of 20 m and lines along it on the way back, over a bed that slopes."""
    rng = np.random.default_rng(seed)
    down = [(8.0 * k, 9.0 if k % 2 else -9.0) for k in range(legs + 1)]
    back = [
        (8.0 * legs + 3, n) if i % 2 == k % 2 else (-3.0, n) for k, n in enumerate((-5, 0, 5)) for i in (0, 1)
    ]
    corners = np.array(down + back)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    t = np.arange(0.0, way[-1] / SPEED_MPS, STEP_S)
    s, n = (np.interp(t * SPEED_MPS, way, c) for c in corners.T)
    line = np.searchsorted(way[1:-1], t * SPEED_MPS)
    slow = np.zeros(len(t))
    keep = np.exp(-STEP_S / time_s)
    slow[0] = slow_m * rng.standard_normal()
    for k in range(1, len(t)):
        slow[k] = keep * slow[k - 1] + slow_m * np.sqrt(1 - keep**2) * rng.standard_normal()
    up = -2.0 + 0.01 * n**2 - 0.002 * s + slow + white_m * rng.standard_normal(len(t))
    t_gps = 1e9 + t
    if later_m is not None:
        later = line >= legs
        t_gps, up = t_gps + pause_s * later, up + later_m * later
    return pd.DataFrame(
        {
            "t_gps_s": t_gps,
            "east_m": s,
            "north_m": n,
            "up_m": up,
            "transducer_up_m": up + 2.0,
            "sigma_white_m": white_m,
            "sigma_slow_m": stated_m,
            "sigma_common_m": 0.02,
            "sigma_horizontal_m": 0.02,
            "cov_uu_m2": white_m**2 + stated_m**2 + 0.02**2,
            "line": line,
            "used": True,
        }
    ).assign(t_even_s=lambda of: of["t_gps_s"])


def test_a_line_that_does_not_count_crosses_nothing():
    table = survey(1)
    table.loc[table["line"] == 9, "used"] = False  # one of the lines along the river
    assert len(find_crossings(table)) == 16


@pytest.mark.parametrize(
    ("stated_m", "stated_s"), [(0.03, 10.0), (0.06, 10.0), (0.015, 10.0), (0.03, 2.0), (0.03, 50.0)]
)
def test_slow_errors_are_found_whatever_is_stated(stated_m, stated_s):
    """Two-sided over surveys: neither a stated size nor a stated time that is wrong fools the estimate."""
    sizes, times, squares, after = [], [], [], []
    for seed in range(12):
        table = survey(seed, stated_m=stated_m)
        found, time_s, facts = estimate_slow_errors(table, stated_s)
        sizes.append(facts["slow_factor"] * stated_m)
        assert found["sigma_slow_m"].iloc[0] == pytest.approx(stated_m * facts["slow_factor_predictive"])
        assert facts["estimated"]
        assert facts["left_out"] <= 1
        squares.append(facts["normalised_square"])
        after.append(facts["normalised_square_after"])
        assert time_s == facts["time_s"]
        times.append(time_s)
    low, high = band(20 * len(sizes))  # differences of errors that last 10 s
    assert low < np.mean(np.square(sizes)) / 0.03**2 < high
    assert low < np.mean(after) < high
    if stated_s != 10.0:  # towards the true one
        assert 0.0 < np.mean(np.log(np.divide(times, stated_s))) / np.log(10.0 / stated_s) < 1.3
    if stated_m == 0.015:
        assert np.mean(squares) > 2.0  # as stated it would not have been believed
    if stated_m == 0.06:
        assert np.mean(squares) < 0.5


def test_few_crossings_change_nothing():
    table = survey(3, legs=2)
    assert len(find_crossings(table)) == 6
    found, time_s, facts = estimate_slow_errors(table, 10.0)
    assert not facts["estimated"]
    assert time_s == 10.0
    pd.testing.assert_frame_equal(found, table)


def test_a_boat_that_stands_shows_no_slope():
    """Pings at one place: noise over no distance is no slope that horizontal errors act on."""
    table = survey(6)
    moored = table["line"] == 3
    table.loc[moored, ["east_m", "north_m"]] = table.loc[moored, ["east_m", "north_m"]].round(0).to_numpy()
    found = find_crossings(table)
    assert len(found) > 20
    assert np.sqrt(found.white_m2.max()) < 0.1


def test_gross_errors_are_left_out_and_counted():
    table = survey(4)
    table.loc[(table["line"] == 3) & (table["north_m"].abs() < 1.5), "up_m"] += 1.0
    _, _, facts = estimate_slow_errors(table, 10.0)
    assert facts["left_out"] == 1
    assert facts["slow_factor"] < 2.0


@pytest.mark.parametrize(("pause_s", "part"), [(86_400.0, "days"), (1_200.0, "runs")])
def test_days_and_runs_that_disagree_are_named_adjusted_and_in_the_sigmas(pause_s, part):
    table = survey(5, later_m=0.3, pause_s=pause_s)
    found, time_s, facts = estimate_slow_errors(table, 10.0)
    (pair,) = facts["agreement"][f"pairs of {part}"]
    assert pair["contradicts"]
    assert pair["n"] == 24
    assert abs(pair["difference_m"] - 0.3) < 3 * pair["sigma_m"]
    assert 0.005 < pair["sigma_m"] < 0.025  # 24 differences of slow errors that last for a few of them
    assert any("above" in note and pair["a"] in note and pair["b"] in note for note in facts["notes"])
    later = table["line"] >= 8
    step = (found["up_m"] - table["up_m"]).to_numpy()
    assert np.unique(step[later]) == pytest.approx([-0.15], abs=0.02)
    assert np.unique(step[~later]) == pytest.approx([0.15], abs=0.02)
    np.testing.assert_allclose(found["transducer_up_m"] - table["transducer_up_m"], step)
    # half the difference, of one degree of freedom: Student's 84 % is 1.84
    extra = (found["sigma_common_m"] ** 2 - table["sigma_common_m"] ** 2).to_numpy()
    assert np.sqrt(extra) == pytest.approx(1.84 * 0.15, rel=0.2)
    np.testing.assert_allclose(found["cov_uu_m2"] - table["cov_uu_m2"], extra)
    # no line crosses one of its own run: what is stated of the slow errors stays
    assert not facts["estimated"]
    assert (found["sigma_slow_m"] == 0.03).all()
    assert time_s == 10.0


@pytest.mark.parametrize(("stated_m", "stated_s"), [(0.03, 10.0), (0.015, 10.0), (0.03, 2.0)])
def test_runs_that_agree_keep_their_heights_and_the_slow_errors_of_all_crossings(stated_m, stated_s):
    """Slow errors that are larger or last longer than stated are no steps."""
    kept = 0
    for seed in range(40, 52):
        table = survey(seed, stated_m=stated_m, later_m=0.0, pause_s=1_200.0)
        found, _, facts = estimate_slow_errors(table, stated_s)
        if "steps" in facts["agreement"]:
            continue
        kept += 1
        pd.testing.assert_series_equal(found["up_m"], table["up_m"])
        pd.testing.assert_series_equal(found["sigma_common_m"], table["sigma_common_m"])
        assert facts["estimated"]
        assert facts["n"] == 24
    assert kept >= 11
