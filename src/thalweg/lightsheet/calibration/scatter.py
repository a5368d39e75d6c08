"""Whether residuals are what the sigmas say: scatter, and errors that neighbouring line points share.

The stated sigmas of line points and of ends are prior knowledge: each kind may be wrong by a common factor
``f``, by `SPREAD` as one sigma of its logarithm. Residuals with the mean square ``s^2`` of their standardised
values and ``r`` degrees of freedom make of it the posterior::

    p(f | s) ~ f^-r exp(-r s^2 / (2 f^2)) exp(-(ln f)^2 / (2 ln^2 SPREAD))

and sigmas are multiplied with the root of ``E[f^2]``: up or down, and more than with ``s`` where few
residuals leave ``f`` open (as Student's distribution is wider than the normal one). Without residuals the
prior's width counts alone.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from thalweg.core.adjustment.solve import Adjusted
from thalweg.core.types import ArrayF
from thalweg.lightsheet.calibration.correspondence import Correspondence
from thalweg.lightsheet.calibration.model import LINE, PAIRS, Problem

SPREAD: Final = 2.0
"""Stated sigmas may be wrong by this factor, as one sigma of its logarithm."""

_LAGS: Final = 40
_CLEAR: Final = 3.0
"""Correlations below that many times their own scatter count as none."""

_LOGS: Final = np.linspace(-6.0, 6.0, 2401) * np.log(SPREAD)


@dataclass(frozen=True, slots=True)
class Factor:
    """What the sigmas of a kind of observations are multiplied with, and how well residuals show it.

    ``of_scatter`` without what neighbours share; ``width``: standard deviation of its logarithm, ln 2 of the
    prior; ``shared``: number of observations with one error.
    """

    of_scatter: float = 1.0
    width: float = 0.0
    shared: float = 1.0

    @property
    def value(self) -> float:
        """The factor."""
        return float(np.sqrt(self.shared)) * self.of_scatter


def estimated_factor(square: float, spare: float, shared: float = 1.0) -> Factor:
    """Factor of the sigmas by the residuals.

    Parameters
    ----------
    square : mean square of standardised residuals, over their redundancy.
    spare : number of independent ones, after the unknowns.
    shared : observations that share an error.

    Examples
    --------
    >>> many, few = (estimated_factor(4.0, spare) for spare in (1000.0, 6.0))
    >>> round(many.of_scatter, 2), round(few.of_scatter, 2), round(few.width, 2)
    (2.0, 2.06, 0.26)
    """
    r = max(spare, 0.0)
    log_p = -r * _LOGS - 0.5 * r * square * np.exp(-2 * _LOGS) - 0.5 * np.square(_LOGS / np.log(SPREAD))
    p = np.exp(log_p - log_p.max())
    p /= p.sum()
    mean = float(p @ _LOGS)
    return Factor(
        of_scatter=float(np.sqrt(p @ np.exp(2 * _LOGS))),
        width=float(np.sqrt(p @ np.square(_LOGS - mean))),
        shared=shared,
    )


def shared_errors(problem: Problem, adjusted: Adjusted[ArrayF], found: Correspondence) -> float:
    """Number of neighbouring line points that share one error; 1 if all are independent.

    That is ``1 + 2 sum rho(k)`` with the autocorrelation of the residuals along the pieces of line, summed as
    long as it is clearly positive, and by ``1 + 2 (2 m + 1) / n`` more for the uncertainty of that sum of m
    terms from n points (Priestley 1981, 5.3). Matching with a patch of many rows measures each row many
    times.
    """
    used = adjusted.used[LINE]
    r = problem.residuals_px(adjusted.x) / problem.line.sigma_px
    r = np.where(used, r, np.nan)
    r = r - np.nanmean(r)
    power = float(np.nanmean(np.square(r)))
    if not power > 0:
        return 1.0
    total, terms = 1.0, 0
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
        terms = lag
    return total * (1.0 + 2.0 * (2 * terms + 1) / len(r)) if terms else 1.0


def scale(adjusted: Adjusted[ArrayF], before: dict[str, Factor], shared: float) -> dict[str, Factor]:
    """Factors of the stated sigmas of line points and pairs by the residuals of an adjustment.

    Residuals of points that share errors are smaller than the errors: of n points in groups of ``shared`` the
    u unknowns take as many errors as of n / shared points.

    Parameters
    ----------
    adjusted : with sigmas that were multiplied with ``before``.
    before : factors by kind of observation.
    shared : line points that share an error.
    """
    factors = {}
    for name, together in ((LINE, shared), (PAIRS, 1.0)):
        n = float(adjusted.used[name].sum())
        left = adjusted.group_redundancy[name]
        spare = n / together - (n - left)
        if spare < 1.0:
            factors[name] = estimated_factor(1.0, 0.0, together)
            continue
        square = adjusted.group_sigma0[name] ** 2 * before[name].value ** 2
        factors[name] = estimated_factor(square * left / (together * spare), spare, together)
    return factors


def rescaled(problem: Problem, factors: dict[str, Factor]) -> Problem:
    """A problem whose sigmas of line points and pairs are multiplied with factors."""
    line = replace(problem.line, sigma_px=problem.line.sigma_px * factors[LINE].value)
    pairs = replace(problem.pairs, sigma_px=problem.pairs.sigma_px * factors[PAIRS].value)
    return replace(problem, line=line, pairs=pairs)
