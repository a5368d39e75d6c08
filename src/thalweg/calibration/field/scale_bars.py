"""Do the scale bars of a field agree with each other?

A free network knows all distances up to one scale. With two bars or more each gives it, so that a wrong one
shows; with two, nobody can say which of them it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import chi2

from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayB, ArrayF

_LEVEL: Final = 1e-4
"""Probability with which good bars are called contradictory."""


@dataclass(frozen=True, slots=True)
class Scale:
    """Scale of a free network from its bars.

    Parameters
    ----------
    factor : true length over length in the network.
    sigma : of the factor.
    used : (b,) False for a bar that contradicts all others.
    off_m : (b,) stated length minus that of the network scaled by the used bars.
    sigma_off_m : (b,) of that difference, without the bar's own part in the scale.
    """

    factor: float
    sigma: float
    used: ArrayB
    off_m: ArrayF
    sigma_off_m: ArrayF


def scale_of(names: Sequence[str], stated_m: ArrayF, sigma_m: ArrayF, measured: ArrayF, cov: ArrayF) -> Scale:
    """Scale from bars; a single wrong one among three or more is found by leaving out each in turn.

    Parameters
    ----------
    names : of the bars.
    stated_m, sigma_m : (b,) their certificates.
    measured, cov : (b,) lengths in the free network, in its unit, and their covariance.

    Raises
    ------
    GeometryError : no bar; two bars contradict; or more than one of several is wrong.
    """
    b = len(names)
    if b == 0:
        raise GeometryError(
            "no scale bar", expected="at least two scale bars in the field description",
            cure="Put two bars of known length into the field and take the pictures again",
        )  # fmt: skip
    used = np.ones(b, dtype=np.bool_)
    if b > 1 and _contradiction(stated_m, sigma_m, measured, cov, used) < _LEVEL:
        if b == 2:
            factor, _ = _factor(stated_m, sigma_m, measured, cov, np.array([True, False]))
            off = (factor * measured[1] - stated_m[1]) * 1000.0
            raise GeometryError(
                f"the scale bars {names[0]} and {names[1]} contradict each other, one of them is wrong: by "
                f"{names[0]}, {names[1]} is {off:+.2f} mm longer than its {stated_m[1]:.5f} m",
                expected="bars that agree within their sigmas",
                cure="Check lengths and end marks in the field description; a third bar would tell which",
            )
        fits = np.array(
            [_contradiction(stated_m, sigma_m, measured, cov, np.arange(b) != k) for k in range(b)]
        )
        wrong = int(fits.argmax())
        if fits[wrong] < _LEVEL:
            raise GeometryError(
                f"more than one of the scale bars {', '.join(names)} is wrong",
                expected="at most one that contradicts the others",
                cure="Check lengths, sigmas and end marks in the field description",
            )
        used[wrong] = False
    factor, sigma = _factor(stated_m, sigma_m, measured, cov, used)
    off, sigma_off = np.empty(b), np.empty(b)
    for k in range(b):
        others = used.copy()
        others[k] = False
        if not others.any():
            off[k], sigma_off[k] = 0.0, np.nan
            continue
        own, own_sigma = _factor(stated_m, sigma_m, measured, cov, others)
        off[k] = stated_m[k] - own * measured[k]
        sigma_off[k] = np.sqrt(sigma_m[k] ** 2 + own**2 * cov[k, k] + (own_sigma * measured[k]) ** 2)
    return Scale(factor, sigma, used, off, sigma_off)


def _factor(
    stated: ArrayF, sigma: ArrayF, measured: ArrayF, cov: ArrayF, used: ArrayB
) -> tuple[float, float]:
    S, m, s = _system(stated, sigma, measured, cov, used)
    W = np.linalg.inv(S)
    N = float(m @ W @ m)
    return float(m @ W @ s) / N, N**-0.5


def _contradiction(stated: ArrayF, sigma: ArrayF, measured: ArrayF, cov: ArrayF, used: ArrayB) -> float:
    """Probability of a contradiction at least as large if all used bars are right."""
    if used.sum() < 2:
        return 1.0
    factor, _ = _factor(stated, sigma, measured, cov, used)
    S, m, s = _system(stated, sigma, measured, cov, used)
    v = s - factor * m
    return float(chi2.sf(v @ np.linalg.solve(S, v), used.sum() - 1))


def _system(
    stated: ArrayF, sigma: ArrayF, measured: ArrayF, cov: ArrayF, used: ArrayB
) -> tuple[ArrayF, ArrayF, ArrayF]:
    rough = float(np.median(stated[used] / measured[used]))
    S = rough**2 * cov[np.ix_(used, used)] + np.diag(np.square(sigma[used]))
    return S, measured[used], stated[used]
