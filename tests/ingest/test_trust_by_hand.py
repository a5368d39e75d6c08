"""Which fixes are trusted, and what sigmas positions get, by numbers that can be done on paper."""

import numpy as np
import pandas as pd
import pytest

from thalweg.core import LocalFrame
from thalweg.ingest import GNSS_POSITION
from thalweg.ingest.ppk.trust import trust_fixes

LAT, LON, H = 51.05, 13.25, 150.0
DEG_OF_EAST = 1e-5 / float(
    LocalFrame(lat_deg=LAT, lon_deg=LON, h_ell_m=H).from_geodetic(
        np.array([LAT]), np.array([LON + 1e-5]), np.array([H])
    )[0, 0]
)


def positions(n: int, fix: str, sigma_m: float, east_m: object = 0.0) -> pd.DataFrame:
    """Epochs of a second at one place, shifted to the east."""
    table = pd.DataFrame({name: np.zeros(n) for name in GNSS_POSITION.names})
    return table.assign(
        t_gps_s=1e9 + np.arange(n), lat_deg=LAT, lon_deg=LON + np.asarray(east_m) * DEG_OF_EAST, h_ell_m=H,
        fix=fix, sigma_east_m=sigma_m, sigma_north_m=sigma_m, sigma_up_m=sigma_m,
    )  # fmt: skip


def judged(table: pd.DataFrame, floats: pd.DataFrame, baseline_m: float, rise_m: float = 0.0, **how: float):
    given = {"trusted_baseline_km": 20.0, "least_fix_s": 10.0} | how
    n = len(table)
    return trust_fixes(table, floats, 1.0, None, np.full(n, baseline_m), np.full(n, rise_m), **given)


def test_sigmas_grow_by_two_millimetres_a_kilometre_and_three_in_height():
    """10 km: 20, 20, 30 mm beside 10 mm of a fix; 50, 50, 100 mm beside twice 200 mm of a float position.

    100 m of rise add 15 mm in height.
    """
    table = positions(60, "fixed", 0.01)
    table.loc[30:, "fix"] = "float"
    table.loc[30:, ["sigma_east_m", "sigma_north_m", "sigma_up_m"]] = 0.2
    out, trust = judged(table, positions(60, "float", 0.2), 10_000.0, 100.0)
    assert trust.refused == {"baseline": 0, "duration": 0, "float": 0}
    assert trust.float_factors == (2.0, 2.0)
    assert not trust.known
    sigmas = out[["sigma_east_m", "sigma_north_m", "sigma_up_m"]].to_numpy()
    up = np.sqrt(0.01**2 + 0.03**2 + 0.015**2)
    assert sigmas[0] == pytest.approx([np.hypot(0.01, 0.02)] * 2 + [up])
    assert sigmas[59] == pytest.approx([np.hypot(0.4, 0.05)] * 2 + [np.sqrt(0.4**2 + 0.1**2 + 0.015**2)])


@pytest.mark.parametrize(("east_m", "refused"), [(0.75, 0), (-0.75, 0), (0.80, 60), (-0.80, 60)])
def test_a_fix_is_refused_beyond_three_sigmas_of_three_coordinates(east_m, refused):
    """Twice 0.1 m and a floor of 0.05 m: 0.776 m is where chi-square of 3 has 99.73 %, 14.16."""
    out, trust = judged(positions(60, "fixed", 0.01, east_m), positions(60, "float", 0.1), 0.0)
    assert trust.refused["float"] == refused
    assert (out["fix"] == "float").sum() == refused
    # where one epoch has no float position, the others tell
    less = judged(positions(60, "fixed", 0.01, east_m), positions(60, "float", 0.1).drop(index=30), 0.0)[1]
    assert less.refused["float"] == refused
    expected = LON if refused else LON + east_m * DEG_OF_EAST
    assert out["lon_deg"].to_numpy() == pytest.approx(expected, abs=1e-12)


def test_a_run_of_wrong_integers_among_float_positions_becomes_float():
    """15 epochs 2.3 m aside with 1 cm stated: they get the place and the sigmas of the float solution."""
    floats = positions(60, "float", 0.1)
    mixed = positions(60, "float", 0.1)
    wrong = positions(60, "fixed", 0.01, -2.3)
    mixed.loc[20:34] = wrong.loc[20:34]
    out, trust = judged(mixed, floats, 8_000.0)
    assert trust.refused == {"baseline": 0, "duration": 0, "float": 15}
    assert (out["fix"] == "float").all()
    assert out["lon_deg"].to_numpy() == pytest.approx(LON, abs=1e-12)
    assert out["sigma_up_m"].to_numpy() == pytest.approx(np.hypot(0.2, 0.08))


def test_refused_epochs_without_a_float_position_are_counted():
    out, trust = judged(positions(200, "fixed", 0.01), positions(150, "float", 0.1), 50_000.0)
    assert (len(out), trust.without_float) == (150, 50)
    assert "50 of them have no float position" in " ".join(trust.notes())


def test_runs_that_are_short_and_baselines_that_are_long_are_refused():
    """Nine epochs of a second are 9 s."""
    table = positions(60, "float", 0.1)
    table.loc[5:13, "fix"] = "fixed"
    floats = positions(60, "float", 0.1)
    assert judged(table, floats, 0.0)[1].refused["duration"] == 9
    assert judged(table, floats, 0.0, least_fix_s=9.0)[1].refused["duration"] == 0
    assert judged(positions(60, "fixed", 0.01), floats, 20_001.0)[1].refused["baseline"] == 60
    assert judged(positions(60, "fixed", 0.01), floats, 19_999.0)[1].refused["baseline"] == 0


@pytest.mark.parametrize(
    ("direction", "first", "last"), [("forward", 0.5, 4.0), ("backward", 4.0, 0.5), ("combined", 4.0, 4.0)]
)
def test_float_sigmas_follow_what_means_of_so_many_epochs_show(direction, first, last):
    """A variance of 0.25 of single epochs, 16 of means of 64, a straight line in logarithms between."""
    n = 64
    table = positions(n, "float", 0.1)
    table.loc[7, "fix"] = "single"
    known = (np.array([1.0, 64.0]), np.array([0.25, 16.0]))
    limits = {"trusted_baseline_km": 20.0, "least_fix_s": 10.0, "direction": direction}
    out, trust = trust_fixes(table, table, 9.0, known, np.zeros(n), np.zeros(n), **limits)
    sigma = out["sigma_up_m"].to_numpy()
    assert sigma[[0, -1]] == pytest.approx([0.1 * first, 0.1 * last])
    assert sigma[7] == pytest.approx(0.1)  # no float position
    if direction == "forward":
        assert sigma[8] == pytest.approx(0.1 * 0.5 * 8.0 ** (np.log(9.0) / np.log(64.0)))
    assert trust.fixed_factor == 3.0
    assert trust.known
    assert trust.notes() == []


def test_sigmas_of_fixed_positions_are_the_engines_times_what_the_residuals_show():
    table = positions(60, "fixed", 0.01)
    floats = positions(60, "float", 0.2)
    limits = {"trusted_baseline_km": 20.0, "least_fix_s": 10.0}
    out, _ = trust_fixes(table, floats, 0.0625, None, np.zeros(60), np.zeros(60), **limits)
    assert out["sigma_east_m"].to_numpy() == pytest.approx(0.0025)
