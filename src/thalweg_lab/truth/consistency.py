"""Do sigmas tell the truth? Observed and predicted errors of many surveys, each one independent trial.

Points of one survey share the errors of its poses and of its mount: 20,000 of them may be worth a handful of
independent ones. Surveys that err independently, such as seeds of the digital twin, are units that can be
counted. With the sums ``o_k`` of squared errors and ``p_k`` of predicted variances of survey ``k``,

    q = sum o_k / sum p_k,    s^2 = m / (m - 1) sum (o_k - q p_k)^2 / (sum p_k)^2

estimate the ratio of observed to predicted variance and the variance of that estimate (ratio estimator;
Cochran 1977, 6.3). ``log q`` is nearly normal for chi-square sums of a dozen and more values. Sigmas that are
consistent leave it within ``t s / q`` of 0, with Student's quantile for ``m - 1`` degrees of freedom. The
number of surveys ``m`` is the effective one, ``(sum p_k)^2 / sum p_k^2`` (Kish 1965), as not all surveys have
equally many points of a class. Statements about several classes share the level after Bonferroni: with the
stated probability none of them is outside its band if all are consistent.

The ratio that is printed is that of the thesis: predicted over observed RMSE, ``1 / sqrt(q)``.
"""

from typing import Final

import numpy as np
import pandas as pd
from scipy.stats import t as student

from thalweg.accuracy import range_class
from thalweg.core import ArrayF, ArrayI, CoverageError

LEAST_SURVEYS: Final = 12.0
"""Effective number of surveys below which a class is joined with the next one."""

COLUMNS: Final = (
    "range_from_m",
    "range_to_m",
    "n",
    "surveys",
    "rmse_observed_m",
    "rmse_predicted_m",
    "ratio",
    "ratio_low",
    "ratio_high",
    "inside",
)
"""Columns of `consistency_by_range`."""


def ratio_of_surveys(
    observed: ArrayF, predicted: ArrayF, *, level: float = 0.95
) -> tuple[float, float, float, float]:
    """Ratio of predicted to observed RMSE over surveys, and the band in which consistent sigmas leave it.

    Parameters
    ----------
    observed, predicted : (m,) sums over the points of each survey: of squared errors, of predicted variances.
    level : probability that the band holds the ratio of consistent sigmas.

    Returns
    -------
    ratio, low, high, surveys : the last is the effective number of surveys.

    Raises
    ------
    CoverageError : fewer than two surveys hold any points, or one with errors has no predicted variance.
    """
    there = predicted > 0
    if observed[~there].any():
        raise CoverageError(
            f"{np.count_nonzero(observed[~there])} surveys with errors but without a predicted variance",
            expected="a variance above zero for each point",
            cure="Look for points whose covariance was not filled in",
        )
    o, p = observed[there], predicted[there]
    if len(p) < 2:
        raise CoverageError(
            f"{len(p)} surveys with points", expected="at least two", cure="Compare more surveys"
        )
    total = p.sum()
    m = float(total**2 / np.sum(p**2))
    q = o.sum() / total
    count = len(p) / (len(p) - 1)
    spread = float(np.sqrt(count * np.sum((o - q * p) ** 2)) / o.sum())
    reach = float(student.ppf((1 + level) / 2, max(m - 1, 1.0))) * spread
    return float(q**-0.5), float(np.exp(-reach / 2)), float(np.exp(reach / 2)), m


def consistency_by_range(
    survey: ArrayI,
    range_m: ArrayF,
    squared: ArrayF,
    predicted: ArrayF,
    *,
    level: float = 0.95,
    least_surveys: float = LEAST_SURVEYS,
) -> pd.DataFrame:
    """Predicted against observed RMSE in range classes of P2 eq. 10, each with its band.

    Classes are 1 m wide, ``D - 0.5 < d <= D + 0.5``. A class that too few surveys have seen is joined with
    the next farther ones until they are enough; what is left at the far end is joined with the last.

    Parameters
    ----------
    survey : (n,) number of the survey that a point belongs to.
    range_m : (n,) measured range.
    squared, predicted : (n,) squared error and predicted variance of the same quantity.
    level : probability that all classes together lie inside their bands if the sigmas are consistent.
    least_surveys : least effective number of surveys in a class.

    Returns
    -------
    One row a class with `COLUMNS`; ranges are the limits of the class. The bands belong to the ratio of
    predicted to observed.

    Raises
    ------
    CoverageError : no points, points without a predicted variance, or fewer than two surveys with points.
    """
    without = np.count_nonzero(~(predicted > 0))
    if not len(survey) or without:
        raise CoverageError(
            f"{len(survey)} points, {without} of them without a predicted variance",
            expected="points of at least two surveys, each with a variance above zero",
            cure="Look for surveys without points, and for points whose covariance was not filled in",
        )
    number = np.unique(survey, return_inverse=True)[1]
    centre = range_class(range_m)
    first = int(centre.min())
    shape = (int(number.max()) + 1, int(centre.max()) - first + 1)
    cell = np.ravel_multi_index((number, centre - first), shape)
    sums = [
        np.bincount(cell, weights=w, minlength=shape[0] * shape[1]).astype(np.float64).reshape(shape)
        for w in (np.ones(len(cell)), squared, predicted)
    ]
    groups = _joined(sums[2], least_surveys)
    each = 1 - (1 - level) / len(groups)
    rows = []
    for low, high in groups:
        n, observed, expected = (s[:, low:high].sum(axis=1) for s in sums)
        ratio, band_low, band_high, surveys = ratio_of_surveys(observed, expected, level=each)
        rows.append(
            (
                low + first - 0.5,
                high + first - 0.5,
                int(n.sum()),
                surveys,
                np.sqrt(observed.sum() / n.sum()),
                np.sqrt(expected.sum() / n.sum()),
                ratio,
                band_low,
                band_high,
                band_low < ratio < band_high,
            )
        )
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _joined(predicted: ArrayF, least: float) -> list[tuple[int, int]]:
    """Runs of columns (first, one past the last) that enough rows of a (surveys, classes) table have seen."""
    found: list[tuple[int, int]] = []
    low, n = 0, predicted.shape[1]
    for high in range(1, n + 1):
        p = predicted[:, low:high].sum(axis=1)
        if p.sum() > 0 and p.sum() ** 2 / np.sum(p**2) >= least:
            found.append((low, high))
            low = high
    if low < n:
        found = [*found[:-1], (found[-1][0] if found else 0, n)]
    return found
