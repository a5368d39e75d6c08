"""Whether residuals are what the sigmas say: scatter, and errors that neighbouring line points share."""

from dataclasses import replace
from typing import Final

import numpy as np
from scipy.stats import chi2

from thalweg.core.adjustment import Adjusted
from thalweg.core.types import ArrayF
from thalweg.triangulation.calibrate.correspondence import Correspondence
from thalweg.triangulation.calibrate.model import LINE, PAIRS, Problem

_LEVEL: Final = 0.01
"""Probability with which good sigmas are enlarged."""
_LAGS: Final = 40
_CLEAR: Final = 3.0
"""Correlations below that many times their own scatter count as none."""


def shared_errors(problem: Problem, adjusted: Adjusted[ArrayF], found: Correspondence) -> float:
    """Number of neighbouring line points that share one error; 1 if all are independent.

    That is ``1 + 2 sum rho(k)`` with the autocorrelation of the residuals along the pieces of line, summed as
    long as it is clearly positive. Matching with a patch of many rows measures each row many times over.
    """
    used = adjusted.used[LINE]
    r = problem.residuals_px(adjusted.x) / problem.line.sigma_px
    r = np.where(used, r, np.nan)
    r = r - np.nanmean(r)
    power = float(np.nanmean(np.square(r)))
    if not power > 0:
        return 1.0
    total = 1.0
    for lag in range(1, _LAGS + 1):
        same = found.segment[lag:] == found.segment[:-lag]
        products = (r[lag:] * r[:-lag])[same]
        products = products[np.isfinite(products)]
        if len(products) < 30:
            break
        rho = float(products.mean()) / power
        if rho < _CLEAR / np.sqrt(len(products)):
            break
        total += 2.0 * rho
    return total


def rescaled(problem: Problem, adjusted: Adjusted[ArrayF], shared: float) -> tuple[Problem, dict[str, float]]:
    """The problem with sigmas enlarged to what the residuals show, and the factors.

    Scatter below the stated sigmas makes up for shared errors, but no sigma becomes smaller than stated.
    """
    factor = {}
    for name, together in ((LINE, shared), (PAIRS, 1.0)):
        spare = max(adjusted.group_redundancy[name] / together, 1e-9)
        square = adjusted.group_sigma0[name] ** 2
        expected = chi2.ppf(_LEVEL, spare) / spare <= square <= chi2.ppf(1 - _LEVEL, spare) / spare
        scatter = 1.0 if expected or spare < 1 else square
        factor[name] = float(np.sqrt(max(1.0, together * scatter)))
    line = replace(problem.line, sigma_px=problem.line.sigma_px * factor[LINE])
    pairs = replace(problem.pairs, sigma_px=problem.pairs.sigma_px * factor[PAIRS])
    return replace(problem, line=line, pairs=pairs), factor
