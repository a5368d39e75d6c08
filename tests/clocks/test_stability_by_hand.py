"""Every number of a test of a camera's clock from sums and from Bartlett's formula for any process."""

from itertools import pairwise

import numpy as np
import pytest

from thalweg.clocks import clock_stability
from thalweg.core import ClockError

Q2 = 0.03**2 / 12


def series(stamp_s: float, wander_s: float, n: int = 300) -> np.ndarray:
    """Each 2 s, one reading missing, one photograph not taken, one interval a third too long."""
    rng = np.random.default_rng(21)
    t = 50.0 + np.cumsum(2.0 + wander_s * rng.standard_normal(n)) + stamp_s * rng.standard_normal(n)
    t[120:] += 2.0
    t[200:] += 0.7
    t[60] = np.nan
    return t


def bartlett(c0: float, rho: float, h: int, k: int) -> float:
    """Covariance of the estimated autocovariances of lags h and k of a moving average, times their number."""
    c = {0: c0, 1: rho * c0, -1: rho * c0}
    return sum(c.get(j, 0) * c.get(j + k - h, 0) + c.get(j + k, 0) * c.get(j - h, 0) for j in range(-4, 5))


def described(t: np.ndarray) -> dict[str, float]:
    """Autocovariances of single intervals, their variances, and what follows whatever the kind."""
    steps = [b - a if abs(b - a - 2) < 0.5 else None for a, b in pairwise(t)]
    single = np.array([s for s in steps if s is not None])
    c0 = np.var(single, ddof=1)
    products = [
        (a - single.mean()) * (b - single.mean())
        for a, b in pairwise(steps)
        if a is not None and b is not None
    ]
    c1, n, m = np.mean(products), len(single), len(products)
    rho = np.clip(c1 / c0, -0.5, 0.5)
    var_0, var_1 = bartlett(c0, rho, 0, 0) / n, bartlett(c0, rho, 1, 1) / m
    # twice the covariance of c0 and of 2 c1
    var_wander = var_0 + 4 * var_1 + 4 * bartlett(c0, rho, 0, 1) / n
    blocks = np.array_split([k for k, s in enumerate(steps) if s is not None], 10)
    return {
        "c0": c0, "c1": c1, "n": n, "m": m, "std": np.sqrt(c0 - 2 * Q2), "sigma_std": np.sqrt(var_0),
        "stamp2": -c1 - Q2, "sigma_stamp2": np.sqrt(var_1),
        "wander2": c0 + 2 * c1, "sigma_wander2": np.sqrt(max(var_wander, 0.0)),
        "rho": rho, "single": single, "blocks": blocks, "steps": steps,
    }  # fmt: skip


def sigma_of_root(variance: float, sigma: float) -> float:
    if variance > sigma:
        return sigma / (2 * np.sqrt(variance))
    return np.sqrt(max(variance, 0.0) + sigma) - np.sqrt(max(variance, 0.0))


@pytest.mark.parametrize(
    ("stamp_s", "wander_s", "kind"),
    [
        (0.05, 0.0, "white stamps"),
        (0.0, 0.05, "wandering intervals"),
        (0.04, 0.05, "both"),
        (0.011, 0.0, "white stamps"),
    ],
)
def test_each_number_of_a_series(stamp_s, wander_s, kind):
    t = series(stamp_s, wander_s)
    found, e = clock_stability(t, step_s=0.03), described(t)
    assert (found.kind, found.photographs, found.read, found.lost) == (kind, 300, 299, 1)
    assert (found.pairs, found.step_s) == (e["n"], 0.03)
    assert (found.shortest_s, found.longest_s) == (min(e["single"]), max(e["single"]))
    assert found.raw_std_s == pytest.approx(np.sqrt(e["c0"]))
    assert found.std_s == pytest.approx(e["std"])
    assert found.sigma_std_s == pytest.approx(e["sigma_std"] / (2 * e["std"]))
    assert found.lag_one == pytest.approx((e["c1"] + Q2) / e["std"] ** 2)
    rho = e["rho"]
    assert found.sigma_lag_one == pytest.approx(np.sqrt((1 - 3 * rho**2 + 4 * rho**4) / e["m"]))
    stamp2, wander2 = {
        "white stamps": (e["std"] ** 2 / 2, 0.0),
        "wandering intervals": (0.0, e["std"] ** 2),
        "both": (e["stamp2"], e["wander2"]),
    }[kind]
    assert found.stamp_jitter_s == pytest.approx(np.sqrt(stamp2))
    assert found.wander_s == pytest.approx(np.sqrt(wander2))
    assert found.sigma_stamp_jitter_s == pytest.approx(sigma_of_root(stamp2, e["sigma_stamp2"]))
    assert found.sigma_wander_s == pytest.approx(sigma_of_root(wander2, e["sigma_wander2"]))
    image = np.sqrt(stamp2) if kind == "white stamps" else np.hypot(*np.sqrt([stamp2, wander2]))
    assert found.image_error_s == pytest.approx(image)
    # 300 periods from the first to the last photograph; wander that is not excluded grows with them
    bound2 = max(e["wander2"], 0.0) + e["sigma_wander2"]
    assert found.mean_s == pytest.approx((t[-1] - t[0]) / 300)
    assert found.sigma_mean_s == pytest.approx(np.sqrt(300 * bound2 + 2 * (stamp2 + Q2)) / 300)
    assert found.count_error_s == pytest.approx(np.sqrt(stamp2 + 3600 / found.mean_s * bound2))
    # a line through the means of ten blocks; errors of stamps stay at their free ends
    at = [np.mean(t[b]) for b in e["blocks"]]
    mean = [np.mean([e["steps"][k] for k in b]) for b in e["blocks"]]
    ends = [1 + np.count_nonzero(np.diff(b) > 1) for b in e["blocks"]]
    sigma = [
        np.sqrt(wander2 / len(b) + 2 * (stamp2 + Q2) * k / len(b) ** 2)
        for b, k in zip(e["blocks"], ends, strict=True)
    ]
    (slope, _), cov = np.polyfit(at, mean, 1, w=1 / np.array(sigma), cov="unscaled")
    per_hour = 3600e6 / e["single"].mean()
    assert found.drift_ppm_per_h == pytest.approx(slope * per_hour, rel=1e-6)
    assert found.sigma_drift_ppm_per_h == pytest.approx(np.sqrt(cov[0, 0]) * per_hour, rel=1e-6)
    words = {
        "white stamps": f"by {1e3 * np.sqrt(stamp2):.1f} ms, not by the {1e3 * e['std']:.1f} ms of an",
        "wandering intervals": f"off by {np.sqrt(wander2 * 3600 / found.mean_s):.2f} s after an hour",
        "both": f"{1e3 * np.sqrt(stamp2):.1f} ms about a grid that wanders by {1e3 * np.sqrt(wander2):.1f}",
    }
    assert words[kind] in found.notes[0]
    # 9.9 ms are a third of the display's steps, wandering intervals say nothing of it
    assert any("use a faster display" in note for note in found.notes) == (0 < np.sqrt(stamp2) < 0.01)
    assert "1 photographs are missing: intervals of several periods." in found.notes
    assert found.facts() == found.facts() | {"notes": list(found.notes), "kind": kind, "lost": 1}


def test_pairs_that_are_too_few_tell_no_kind():
    """Each third reading is missing: neighbours, but no two intervals in a row."""
    t = series(0.05, 0.0)
    t[::3] = np.nan
    found = clock_stability(t, step_s=0.03)
    assert found.kind == "not told"
    assert found.notes[0].startswith("Too few neighbours in a row")
    told = [found.lag_one, found.sigma_mean_s, found.count_error_s]
    assert np.isnan(told).all()
    assert found.sigma_lag_one == 1.0
    assert found.std_s / found.sigma_std_s == pytest.approx(
        2 * found.std_s**2 / (found.raw_std_s**2 * np.sqrt(2 / found.pairs))
    )


def test_twenty_pairs_are_needed_and_even_intervals():
    t = 2.0 * np.arange(21)
    found = clock_stability(t, step_s=0.01)
    assert (found.pairs, found.std_s, found.wander_s, found.lag_one) == (
        20,
        0.0,
        0.0,
        pytest.approx(np.nan, nan_ok=True),
    )
    with pytest.raises(ClockError, match="20 of 20 photographs were read, 19 of them beside one another"):
        clock_stability(t[:20])
    for off, single in ((0.49, 20), (0.51, 19)):  # a quarter of the interval
        t[20] = 40.0 + off
        if single == 20:
            assert clock_stability(t).longest_s == pytest.approx(2.49)
        else:
            with pytest.raises(ClockError, match=r"19 of 20 intervals are near the usual 2\.000 s"):
                clock_stability(t)
