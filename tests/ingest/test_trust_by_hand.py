"""Which fixes are trusted, and what sigmas positions get, by numbers that can be done on paper."""

import numpy as np
import pandas as pd
import pytest

from thalweg.core import LocalFrame
from thalweg.ingest import GNSS_POSITION
from thalweg.ingest.ppk.trust import _float_factor, trust_fixes

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


def judged(table: pd.DataFrame, floats: pd.DataFrame, baseline_m: float, **how: float):
    given = {"trusted_baseline_km": 20.0, "least_fix_s": 10.0} | how
    return trust_fixes(table, floats, None, np.full(len(table), baseline_m), **given)


def test_sigmas_grow_by_a_millimetre_a_kilometre_and_twice_that_in_height() -> None:
    """10 km: 10, 10, 20 mm beside 10 mm of a fix; 50, 50, 100 mm beside twice 200 mm of a float position."""
    table = positions(60, "fixed", 0.01)
    table.loc[30:, "fix"] = "float"
    table.loc[30:, ["sigma_east_m", "sigma_north_m", "sigma_up_m"]] = 0.2
    out, trust = judged(table, positions(60, "float", 0.2), 10_000.0)
    assert trust.refused == {"baseline": 0, "duration": 0, "float": 0}
    assert trust.float_factor == 2.0
    sigmas = out[["sigma_east_m", "sigma_north_m", "sigma_up_m"]].to_numpy()
    assert sigmas[0] == pytest.approx([np.hypot(0.01, 0.01)] * 2 + [np.hypot(0.01, 0.02)])
    assert sigmas[59] == pytest.approx([np.hypot(0.4, 0.05)] * 2 + [np.hypot(0.4, 0.1)])


@pytest.mark.parametrize(("east_m", "refused"), [(0.75, 0), (-0.75, 0), (0.80, 60), (-0.80, 60)])
def test_a_fix_is_refused_beyond_three_sigmas_of_three_coordinates(east_m: float, refused: int) -> None:
    """Twice 0.1 m and a floor of 0.05 m: 0.776 m is where chi-square of 3 has 99.73 %, 14.16."""
    out, trust = judged(positions(60, "fixed", 0.01, east_m), positions(60, "float", 0.1), 0.0)
    assert trust.refused["float"] == refused
    assert (out["fix"] == "float").sum() == refused
    expected = LON if refused else LON + east_m * DEG_OF_EAST
    assert out["lon_deg"].to_numpy() == pytest.approx(expected, abs=1e-12)


def test_runs_that_are_short_and_baselines_that_are_long_are_refused() -> None:
    """Nine epochs of a second are 9 s."""
    table = positions(60, "float", 0.1)
    table.loc[5:13, "fix"] = "fixed"
    floats = positions(60, "float", 0.1)
    assert judged(table, floats, 0.0)[1].refused["duration"] == 9
    assert judged(table, floats, 0.0, least_fix_s=9.0)[1].refused["duration"] == 0
    assert judged(positions(60, "fixed", 0.01), floats, 20_001.0)[1].refused["baseline"] == 60
    assert judged(positions(60, "fixed", 0.01), floats, 19_999.0)[1].refused["baseline"] == 0


@pytest.mark.parametrize("factor", [1.0, 3.0, 30.0])
def test_the_factor_of_float_sigmas_is_that_of_two_directions(factor: float) -> None:
    """Both err by so many of their sigmas; at least 2, at most 10."""
    rng = np.random.default_rng(9)
    one, two = (positions(6000, "float", 0.1, factor * 0.1 * rng.standard_normal(6000)) for _ in range(2))
    for table in (one, two):
        table["lat_deg"] += factor * 0.1 * rng.standard_normal(6000) / 111_200.0
        table["h_ell_m"] += factor * 0.1 * rng.standard_normal(6000)
    # the median of 6000 squares of each axis is known to 2 %
    assert _float_factor(one, two) == pytest.approx(float(np.clip(factor, 2.0, 10.0)), rel=0.03)
