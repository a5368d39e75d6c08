"""The words of the accuracy chapter, each with one definition."""

from typing import Final

import numpy as np
import pandas as pd

from thalweg.core.types import ArrayF

NMAD_FACTOR: Final = 1.4826
"""Median absolute deviation -> standard deviation of a normal distribution, 1 / Phi^-1(0.75)."""


def describe_errors(errors_m: ArrayF) -> dict[str, float]:
    """n, bias, std, RMSE, median, NMAD and P95 of the absolute value of signed errors in metres.

    ``bias`` is the mean, ``std`` the spread about it, ``rmse**2 = bias**2 + std**2``.
    """
    e = errors_m[np.isfinite(errors_m)]
    if not e.size:
        return {"n": 0.0}
    median = float(np.median(e))
    return {
        "n": float(e.size),
        "bias_m": float(np.mean(e)),
        "std_m": float(np.std(e)),
        "rmse_m": float(np.sqrt(np.mean(e**2))),
        "median_m": median,
        "nmad_m": float(NMAD_FACTOR * np.median(np.abs(e - median))),
        "p95_m": float(np.percentile(np.abs(e), 95)),
    }


def by_range_class(range_m: ArrayF, squared_error_m2: ArrayF, predicted_m2: ArrayF) -> pd.DataFrame:
    """Observed and predicted RMSE in range classes of 1 m, ``D - 0.5 < d <= D + 0.5`` (P2 eq. 10).

    Parameters
    ----------
    range_m : (n,) measured range of each point.
    squared_error_m2 : (n,) squared error.
    predicted_m2 : (n,) predicted variance of the same quantity.

    Returns
    -------
    Columns ``range_m``, ``n``, ``rmse_observed_m``, ``rmse_predicted_m``, one row a class that has points.
    """
    centre = np.ceil(range_m - 0.5).astype(np.int64)
    frame = pd.DataFrame({"range_m": centre, "observed": squared_error_m2, "predicted": predicted_m2})
    groups = frame.groupby("range_m", sort=True)
    table = pd.DataFrame({
        "n": groups.size(),
        "rmse_observed_m": np.sqrt(groups["observed"].mean()),
        "rmse_predicted_m": np.sqrt(groups["predicted"].mean()),
    })  # fmt: skip
    return table.reset_index()


def block_band(
    values: ArrayF, t_s: ArrayF, *, block_s: float, rng: np.random.Generator, draws: int = 500
) -> tuple[float, float, float]:
    """Mean of a time series with its 95 % band by a block bootstrap.

    Errors of neighbouring points share one pose, so points are no independent samples: whole blocks of time
    are drawn with replacement.

    Parameters
    ----------
    values, t_s : (n,) series and times.
    block_s : length of a block; several correlation times of the errors.
    rng : source of randomness.
    draws : number of bootstrap samples.

    Returns
    -------
    mean, lower, upper.
    """
    block = np.floor((t_s - t_s.min()) / block_s).astype(np.int64)
    total = np.bincount(block, weights=values)
    n = np.bincount(block).astype(np.float64)
    keep = n > 0
    total, n = total[keep], n[keep]
    pick = rng.integers(0, len(n), size=(draws, len(n)))
    means = total[pick].sum(axis=1) / n[pick].sum(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return float(total.sum() / n.sum()), float(low), float(high)
