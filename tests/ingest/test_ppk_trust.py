"""Ambiguity fixes that are trusted, and those that become float; standard deviations of both."""

import numpy as np
import pandas as pd
import pytest

from thalweg.core import LocalFrame
from thalweg.ingest import GNSS_POSITION
from thalweg.ingest.ppk.trust import trust_fixes

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=200.0)
LIMITS = {"trusted_baseline_km": 20.0, "least_fix_s": 5.0}
N = 200
KNOWN = (np.ones(1), np.full(1, 4.0))
"""Residuals say that float positions err twice as much as the engine states."""


def table(errors_m: np.ndarray, fix: str, sigma_m: float) -> pd.DataFrame:
    """Positions of a boat on its way, with those errors (n, 3), east, north, up."""
    n = len(errors_m)
    true = np.column_stack([1.5 * np.arange(n), 0.2 * np.arange(n), np.zeros(n)])
    lat, lon, h = FRAME.to_geodetic(true + errors_m)
    out = GNSS_POSITION.empty_table().to_pandas().reindex(range(n))
    out = out.assign(t_gps_s=1e9 + np.arange(n), lat_deg=lat, lon_deg=lon, h_ell_m=h, fix=fix, n_sats=8)
    sigmas = dict.fromkeys(("sigma_east_m", "sigma_north_m", "sigma_up_m"), sigma_m)
    return out.assign(**sigmas, **dict.fromkeys(("cov_en_m2", "cov_eu_m2", "cov_nu_m2"), 0.0))


def errors_m(found: pd.DataFrame) -> np.ndarray:
    """Errors (n, 3) of positions at whole seconds of the boat's way."""
    k = found["t_gps_s"].to_numpy() - 1e9
    true = np.column_stack([1.5 * k, 0.2 * k, np.zeros(len(k))])
    return FRAME.from_geodetic(found["lat_deg"], found["lon_deg"], found["h_ell_m"]) - true


def solution(wrong: slice, off_m: float, seed: int = 1) -> tuple[pd.DataFrame, pd.DataFrame]:
    """A solution that is fixed to 1 cm but for epochs whose integers are wrong, and its float solution."""
    rng = np.random.default_rng(seed)
    error = 0.01 * rng.standard_normal((N, 3))
    error[wrong, 2] += off_m
    floats = np.cumsum(0.02 * rng.standard_normal((N, 3)), axis=0)
    return table(error, "fixed", 0.01), table(floats, "float", 0.15)


def test_fixes_that_agree_with_the_float_solution_stay():
    fixed, floats = solution(slice(0, 0), 0.0)
    found, trust = trust_fixes(fixed, floats, 1.0, KNOWN, np.full(N, 100.0), np.zeros(N), **LIMITS)
    assert (found["fix"] == "fixed").all()
    assert sum(trust.refused.values()) == 0
    assert trust.notes() == []
    assert found["sigma_up_m"].to_numpy() == pytest.approx(0.01, rel=1e-3)


def test_integers_that_are_metres_off_become_float():
    """Five epochs 2.3 m off with 1 cm stated, among float ones; the truth lies within three sigmas after."""
    fixed, floats = solution(slice(90, 105), -2.3)
    mixed = pd.concat([floats[:90], fixed[90:105], floats[105:]], ignore_index=True)
    found, trust = trust_fixes(mixed, floats, 1.0, KNOWN, np.full(N, 8_000.0), np.zeros(N), **LIMITS)
    assert trust.refused == {"baseline": 0, "duration": 0, "float": 15}
    assert (found["fix"] == "float").all()
    assert len(found) == N
    sigma = found[["sigma_east_m", "sigma_north_m", "sigma_up_m"]].to_numpy()
    assert (np.abs(errors_m(found)) < 3 * sigma).all()


def test_refused_epochs_without_a_float_position_are_counted():
    fixed, floats = solution(slice(0, 0), 0.0)
    found, trust = trust_fixes(fixed, floats[:150], 1.0, KNOWN, np.full(N, 50_000.0), np.zeros(N), **LIMITS)
    assert len(found) == 150
    assert trust.without_float == 50
    assert "50 of them have no float position" in " ".join(trust.notes())
