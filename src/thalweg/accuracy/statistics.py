"""The words of the accuracy chapter, each with one definition."""

from typing import Final

import numpy as np
import pandas as pd
from scipy.stats import chi2, norm

from thalweg.core import NMAD, ArrayF, ArrayI, root_mean_square

NORMAL_SHARES: Final = tuple(float(norm.cdf(k) - norm.cdf(-k)) for k in (1, 2, 3))
"""Shares of a normal distribution within 1, 2 and 3 standard deviations of its mean."""
CONSISTENT_WITHIN: Final = 0.1
"""Sigmas whose predicted and observed error differ by less are called consistent in tests on the twin."""
NARROW_BAND: Final = 0.15
"""And if the band is narrower than this on both sides: a wider one would let other errors pass."""
WIDE_BAND: Final = 2.0
"""A band whose limits differ by more than this factor says little: sigmas 30 % too small may fit."""
FITTING_SHARE: Final = 0.02
"""A normal distribution fits in words if the shares within 1, 2 and 3 sigma are met to this."""


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
        "rmse_m": root_mean_square(e),
        "median_m": median,
        "nmad_m": float(NMAD * np.median(np.abs(e - median))),
        "p95_m": float(np.percentile(np.abs(e), 95)),
    }


def describe_shape(errors_m: ArrayF) -> dict[str, float]:
    """How signed errors are spread about two normal distributions: of largest likelihood, and robust.

    The first has the mean (bias) and the standard deviation, the second the median and the NMAD. Returned are
    ``skewness``, ``excess_kurtosis`` (both 0 for a normal), and the shares of the errors within 1, 2, 3
    standard deviations of both, ``within_k_std`` and ``within_k_nmad``.

    Examples
    --------
    >>> describe_shape(np.array([-1.0, -1.0, 1.0, 1.0]))["excess_kurtosis"]
    -2.0
    """
    e = errors_m[np.isfinite(errors_m)]
    known = describe_errors(e)
    if not e.size:
        return {}
    std = known["std_m"]
    standard = (e - known["bias_m"]) / std if std > 0 else np.zeros_like(e)
    out = {
        "skewness": float(np.mean(standard**3)),
        "excess_kurtosis": float(np.mean(standard**4)) - 3.0 if std > 0 else 0.0,
    }
    for name, middle, sigma in (("std", known["bias_m"], std), ("nmad", known["median_m"], known["nmad_m"])):
        distance = np.abs(e - middle)
        out |= {f"within_{k}_{name}": float(np.mean(distance <= k * sigma)) for k in (1, 2, 3)}
    return out


def fit_in_words(shape: dict[str, float]) -> str:
    """How well a normal distribution fits, from `describe_shape`."""
    found = [shape[f"within_{k}_std"] for k in (1, 2, 3)]
    shares = " / ".join(f"{100 * share:.1f}" for share in found)
    normal = " / ".join(f"{100 * share:.1f}" for share in NORMAL_SHARES)
    fits = max(abs(a - b) for a, b in zip(found, NORMAL_SHARES, strict=True)) < FITTING_SHARE
    if fits:
        words = "a normal distribution fits"
    elif shape["excess_kurtosis"] > 0:
        words = "more in the middle and far out than a normal distribution has"
    else:
        words = "less in the middle and far out than a normal distribution has"
    return f"{shares} % lie within 1, 2, 3 sigma (normal: {normal} %): {words}"


def outlier_limits(errors: ArrayF, nmads: float) -> tuple[float, float]:
    """Lowest and highest error that the outlier rule ``|e - median| <= nmads * NMAD`` keeps.

    Errors whose sigmas differ are to be given over their sigmas: one limit in metres for all of them takes
    good values where sigmas are large, and keeps wild ones where they are small. Errors of which more than
    half are equal have no NMAD; then nothing is an outlier.
    """
    known = describe_errors(errors)
    reach = nmads * known.get("nmad_m", 0.0)
    if reach <= 0:
        return -np.inf, np.inf
    return known["median_m"] - reach, known["median_m"] + reach


def range_class(range_m: ArrayF) -> ArrayI:
    """The class (n,) of each range, in whole metres: ``D - 0.5 < d <= D + 0.5`` (P2 eq. 10)."""
    return np.ceil(range_m - 0.5).astype(np.int64)


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
    frame = pd.DataFrame(
        {"range_m": range_class(range_m), "observed": squared_error_m2, "predicted": predicted_m2}
    )
    groups = frame.groupby("range_m", sort=True)
    table = pd.DataFrame(
        {
            "n": groups.size(),
            "rmse_observed_m": np.sqrt(groups["observed"].mean()),
            "rmse_predicted_m": np.sqrt(groups["predicted"].mean()),
        }
    )
    return table.reset_index()


def chi_square_band(n_independent: float, level: float = 0.95) -> tuple[float, float]:
    """Where the mean of ``n_independent`` normalised squared errors lies with a probability of ``level``."""
    low = float(chi2.ppf((1 - level) / 2, n_independent))
    high = float(chi2.ppf((1 + level) / 2, n_independent))
    return low / n_independent, high / n_independent


def ratio_band(n_independent: float) -> tuple[float, float]:
    """Where consistent sigmas leave the ratio of predicted to observed RMSE with a probability of 95 %.

    Examples
    --------
    >>> [round(limit, 2) for limit in ratio_band(50)]
    [0.84, 1.24]
    """
    low, high = chi_square_band(n_independent)
    return high**-0.5, low**-0.5


VERDICTS: Final = ("consistent", "too optimistic", "too pessimistic", "too few data")
"""What can be said of standard deviations; they are too optimistic where errors are larger."""
_WIDEST_BAND: Final = 3.0
"""Where the band of the ratio spans more than this factor in sigma, a ratio inside it says nothing."""


def verdict_of(normalised: float, n_independent: float) -> str:
    """Whether squared errors over predicted variances say that standard deviations are right.

    Parameters
    ----------
    normalised : mean of the squares of errors over their standard deviations; 1 is expected.
    n_independent : number of independent values in it.

    Returns
    -------
    One of `VERDICTS`: outside the chi-square band of 95 % too optimistic or too pessimistic; inside
    consistent, unless the band is so wide that sigmas wrong by a factor of three would lie in it, too.

    Examples
    --------
    >>> verdict_of(1.1, 40), verdict_of(2.5, 40), verdict_of(0.3, 40), verdict_of(1.0, 3)
    ('consistent', 'too optimistic', 'too pessimistic', 'too few data')
    """
    if not (np.isfinite(normalised) and n_independent >= 1):
        return "too few data"
    low, high = chi_square_band(n_independent)
    return verdict_of_ratio(normalised**-0.5, high**-0.5, low**-0.5)


def verdict_of_ratio(ratio: float, low: float, high: float) -> str:
    """The same from the ratio of predicted to observed RMSE and the band that right sigmas leave it.

    Examples
    --------
    >>> verdict_of_ratio(1.02, 0.9, 1.1), verdict_of_ratio(0.6, 0.9, 1.1), verdict_of_ratio(1.0, 0.4, 2.0)
    ('consistent', 'too optimistic', 'too few data')
    """
    if not np.isfinite([ratio, low, high]).all():
        return "too few data"
    if ratio < low:
        return "too optimistic"
    if ratio > high:
        return "too pessimistic"
    return "consistent" if high / low <= _WIDEST_BAND else "too few data"


def consistency_in_words(ratio: float, low: float, high: float) -> str:
    """Verdict on sigmas from the ratio of predicted to observed RMSE of distances and its band.

    A ratio inside a wide band shows no more than that nothing speaks against the sigmas. Sigmas that are
    wrong by a factor change the ratio by the same factor, so the band itself says what would have passed.

    Examples
    --------
    >>> consistency_in_words(1.02, 0.90, 1.12)
    'sigmas are consistent: predicted over observed is 1.02, inside 0.90 to 1.12'
    >>> consistency_in_words(1.01, 0.78, 1.38)  # doctest: +NORMALIZE_WHITESPACE
    'sigmas and distances agree: predicted over observed is 1.01, inside 0.78 to 1.38; the test detects
    sigmas only if more than 22 % too small or 38 % too large'
    >>> consistency_in_words(0.62, 0.85, 1.19)
    'distances are 1.6 times as large as predicted: predicted over observed is 0.62, outside 0.85 to 1.19'
    """
    number = f"predicted over observed is {ratio:.2f}"
    band = f"{low:.2f} to {high:.2f}"
    if not low <= ratio <= high:
        return f"distances are {_times(1 / ratio)} as predicted: {number}, outside {band}"
    narrow = low > 1 - NARROW_BAND and high < 1 + NARROW_BAND
    if narrow and abs(ratio - 1) <= CONSISTENT_WITHIN:
        return f"sigmas are consistent: {number}, inside {band}"
    return (
        f"sigmas and distances agree: {number}, inside {band}; the test detects sigmas only if more "
        f"than {100 * (1 - low):.0f} % too small or {100 * (high - 1):.0f} % too large"
    )


def _times(factor: float) -> str:
    """``1.6 times as large``; factors near 1 with as many digits as it takes to differ from it."""
    digits = 1 if abs(factor - 1) >= 0.1 else 2 if abs(factor - 1) >= 0.01 else 3
    return f"{factor:.{digits}f} times as large"
