"""The words of the accuracy chapter, each with one definition."""

from typing import Final

import numpy as np
import pandas as pd
from scipy.stats import chi2

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


def independent_values(duration_s: float, correlation_s: float) -> float:
    """How many independent squared errors a series of a Gauss-Markov error holds.

    The mean of ``x**2`` over a time ``T`` has the variance ``2 sigma^4 / N`` with
    ``N = T / (2 t (1 - t/T (1 - exp(-T/t))))`` and ``t = tau / 2``: squares of an error of correlation time
    ``tau`` are correlated over half of it. For ``T`` far above ``tau`` this is ``T / tau``; it is never
    below 1.

    Examples
    --------
    >>> round(independent_values(180.0, 20.0), 1)
    9.5
    """
    t = correlation_s / 2
    ratio = t / duration_s
    return max(1.0, float(1.0 / (2 * ratio * (1 - ratio * -np.expm1(-1.0 / ratio)))))


def chi_square_band(n_independent: float, level: float = 0.95) -> tuple[float, float]:
    """Where the mean of ``n_independent`` normalised squared errors lies with a probability of ``level``."""
    low = float(chi2.ppf((1 - level) / 2, n_independent))
    high = float(chi2.ppf((1 + level) / 2, n_independent))
    return low / n_independent, high / n_independent
