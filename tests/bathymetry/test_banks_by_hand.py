"""Shorelines traced from a few points, station by station, against least squares written out here."""

import numpy as np
import pandas as pd
import pytest

from thalweg.bathymetry import Banks, FlowLine, WaterLevel
from thalweg.bathymetry.banks import bank_observations, trace_banks
from thalweg.settings.sections import Bathymetry

AXIS = FlowLine.through([[0.0, 0.0], [100.0, 0.0], [200.0, 0.0]])
LEVEL = WaterLevel(level_m=0.5, cov=np.diag([0.04**2, 0.0, 0.0]))
LOW = np.array([0.08, 0.16, 0.25, 0.36])
"""One height above the water in each of the lowest slices."""


def ground(s: float, n_m: np.ndarray, heights: np.ndarray = LOW, *, apart: tuple = (0.0,) * 4) -> np.ndarray:
    """Points of a station: some of each height, beside their distance from the axis."""
    k = len(apart)
    x = np.tile(s + np.linspace(-0.9, 0.9, k), len(heights))
    y = np.repeat(n_m, k) + np.sign(n_m[0]) * np.tile(apart, len(heights))
    return np.column_stack([x, y, 0.5 + np.repeat(heights, k)])


def shore(h: np.ndarray, n: np.ndarray, e: float) -> tuple[float, float, float]:
    """Distance, metres across a metre up, and standard deviation; more than 100 m a metre are unlikely."""
    A = np.concatenate([np.column_stack([np.ones(len(h)), h]) / e, [[0.0, 0.01]]])
    value = np.linalg.lstsq(A, np.append(n / e, 0.0), rcond=None)[0]
    rest = (n - value[0] - value[1] * h) / e
    size = max(np.sum(rest**2) / max(len(h) - 2, 1), 1.0)
    return value[0], value[1], np.sqrt(np.linalg.inv(A.T @ A)[0, 0] * size)


def sigma_of(rate: float, scatter: float) -> float:
    """Of the height, its own 3 cm and 4 cm of the level; 2 cm across; the fit; a floor of 2 cm."""
    return float(np.sqrt((np.hypot(0.03, 0.04) * rate) ** 2 + 0.02**2 + scatter**2 + 0.02**2))


SPREAD = (-0.1, -0.05, 0.05, 0.1)
STATIONS = {
    "plain": (30.0, ground(30.0, -(10.0 + 2.0 * LOW)), shore(LOW, 10 + 2 * LOW, 0.01)),
    # the median of distances from a median: 7.5 cm
    "rough": (
        32.0,
        ground(32.0, -(10.0 + 2.0 * LOW), apart=SPREAD),
        shore(LOW, 10 + 2 * LOW, 1.4826 * 0.075 / 2 + 0.01),
    ),
    "bent": (
        34.0,
        ground(34.0, -(10.0 + np.array([0.0, 0.3, 0.1, 0.5]))),
        shore(LOW, 10.0 + np.array([0.0, 0.3, 0.1, 0.5]), 0.01),
    ),
    # plants that hang over: the mean, and no slope
    "over": (
        36.0,
        ground(36.0, -(10.0 - LOW)),
        (float(np.mean(10.0 - LOW)), 0.0, shore(LOW, 10 - LOW, 0.01)[2]),
    ),
    # of six slices the four lowest
    "high": (
        38.0,
        ground(38.0, -np.array([*(10.0 + 2.0 * LOW), 30.0, 40.0]), np.array([*LOW, 0.48, 0.65])),
        shore(LOW, 10 + 2 * LOW, 0.01),
    ),
    "two": (
        40.0,
        ground(40.0, -np.array([10.5, 11.0]), np.array([0.36, 0.6])),
        shore(np.array([0.36, 0.6]), np.array([10.5, 11.0]), 0.01),
    ),
    "flat": (
        42.0,
        ground(42.0, -(10.0 + 60.0 * LOW)),
        (*shore(LOW, 10 + 60 * LOW, 0.01)[:1], 50.0, shore(LOW, 10 + 60 * LOW, 0.01)[2]),
    ),
}
UNSEEN = {
    "only high ground": ground(50.0, -np.array([10.0, 11.0]), np.array([0.45, 0.6])),
    "one slice": ground(52.0, -np.array([10.0]), np.array([0.08])),
    "three points a slice": ground(54.0, -(10.0 + 2.0 * LOW), apart=(0.0,) * 3),
    "beyond 250 m": ground(56.0, -(251.0 + 2.0 * LOW)),
    "in the water": ground(58.0, -(10.0 + 2.0 * LOW), np.array([0.01, 0.03, -0.2, 0.039])),
}


def traced(points: list[np.ndarray], **settings: float) -> pd.DataFrame:
    cloud = np.concatenate(points)
    up, across = np.full(len(cloud), 0.03), np.full(len(cloud), 0.02)
    up[::16], across[::16] = 2.0, 3.0  # medians of a station do not see one of sixteen
    return trace_banks(cloud, up, across, AXIS, LEVEL, (20.0, 60.0), Bathymetry(**settings))


def test_shorelines_of_single_stations():
    table = traced([points for _, points, _ in STATIONS.values()] + list(UNSEEN.values()), bank_gap_m=0.0)
    assert set(table["side"]) == {"right"}
    assert table["seen"].all()
    assert table["s_m"].tolist() == [s for s, _, _ in STATIONS.values()]
    for name, row in zip(STATIONS, table.to_dict("records"), strict=True):
        n0, rate, scatter = STATIONS[name][2]
        assert row["n_m"] == pytest.approx(-n0, abs=1e-9), name
        assert row["sigma_across_m"] == pytest.approx(sigma_of(rate, scatter), rel=1e-6), name
    assert table["east_m"].to_numpy() == pytest.approx(table["s_m"].to_numpy())
    assert table["north_m"].to_numpy() == pytest.approx(table["n_m"].to_numpy())
    assert (table["up_m"] == 0.5).all()


@pytest.mark.parametrize("gap_m", [8.0, 7.9])
def test_gaps_are_bridged_as_far_as_stated(gap_m):
    """Seen 10 m to the left until 24 m, 12 m from 32 m on: between them 0.15 m worse for each metre."""
    seen = {s: 10.0 if s < 30 else 12.0 for s in (20.0, 22.0, 24.0, 32.0, 34.0, 36.0)}
    table = traced([ground(s, n + 0.5 * LOW) for s, n in seen.items()], bank_gap_m=gap_m)
    bridged = [26.0, 28.0, 30.0] if gap_m == 8.0 else []
    assert table["s_m"].tolist() == sorted([*seen, *bridged])
    assert table.loc[~table["seen"], "s_m"].tolist() == bridged
    own = sigma_of(*shore(LOW, 10 + 0.5 * LOW, 0.01)[1:])
    for row in table.itertuples():
        n, away = (
            (seen[row.s_m], 0.0) if row.seen else (10.0 + (row.s_m - 24) / 4, min(row.s_m - 24, 32 - row.s_m))
        )
        assert row.n_m == pytest.approx(n, abs=1e-3)
        assert row.sigma_across_m == pytest.approx(np.hypot(own, 0.15 * away), rel=1e-3)
    assert set(table["side"]) == {"left"}


def test_half_widths_end_with_the_banks_and_at_holes():
    """Stations each 2 m with one hole of 6 m; what is one side alone has no other."""
    s = np.array([0.0, 2.0, 4.0, 10.0, 12.0])
    of = pd.DataFrame({"side": "left", "s_m": s, "n_m": 10.0 + s})
    right = pd.DataFrame({"side": "right", "s_m": s[:1], "n_m": -5.0})
    banks = Banks(table=pd.concat([of, right]), line=AXIS)
    left, other = banks.half_widths_m([-0.1, 0.0, 3.0, 7.0, 11.0, 12.0, 12.1])
    assert left == pytest.approx([np.nan, 10.0, 13.0, np.nan, 21.0, 22.0, np.nan], nan_ok=True)
    assert np.isnan(other).all()
    outside = banks.outside(np.array([3.0, 3.0, 7.0, 3.0]), np.array([12.9, 13.1, 99.0, -99.0]))
    assert outside.tolist() == [False, True, False, False]
    both = Banks(table=pd.concat([of, of.assign(side="right", n_m=-3.0)]), line=AXIS)
    assert both.outside(np.array([3.0, 3.0]), np.array([-2.9, -3.1])).tolist() == [False, True]


def test_shores_as_data_of_the_bed():
    """The level with its sigma, 0.3 m a metre across, 1 cm at least; one number for 20 m of a side."""
    table = pd.DataFrame(
        {
            "side": ["left", "left", "right", "right"],
            "s_m": [25.0, 61.0, 39.9, 40.1],
            "n_m": [10.0, 11.0, -9.0, -8.0],
            "sigma_across_m": [0.5, 0.01, 0.1, 0.2],
        }
    )
    level = WaterLevel(level_m=1.0, slope=-0.01, cov=np.diag([0.03**2, 1e-6, 0.0]), s0_m=30.0)
    found = bank_observations(Banks(table=table, line=AXIS), level)
    s = table["s_m"].to_numpy()
    assert found["s_m"].tolist() == s.tolist()
    assert found["n_m"].tolist() == [10.0, 11.0, -9.0, -8.0]
    assert found["height_m"] == pytest.approx(1.0 - 0.01 * (s - 30.0))
    assert found["sigma_slow_m"] == pytest.approx(np.sqrt(0.03**2 + 1e-6 * (s - 30.0) ** 2))
    assert found["sigma_white_m"] == pytest.approx([0.15, 0.01, 0.03, 0.06])
    # stretches 1, 3, 1, 2 from the first; even numbers to the right, odd ones to the left
    assert found["line"].tolist() == [-3, -7, -2, -4]
