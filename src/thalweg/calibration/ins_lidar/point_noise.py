"""Noise of single lidar points along and across their beams, estimated from their residuals.

A point at the incidence ``i`` has, along the normal of the surface, the variance ``a^2 cos^2 i + b^2 sin^2
i`` with the noise ``a`` along its beam and ``b`` in each direction across it. Squared residuals of many
points show both (variance components; Koch 1999, sec. 3.6). What is stated of each is prior knowledge with
a factor of `SPREAD`, so that points of one incidence, which cannot tell the two apart, leave their ratio as
stated. Hundreds of points give the size to some per cent: next to the errors of the poses that uncertainty
adds nothing.
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from scipy.optimize import minimize

from thalweg.core.types import ArrayF

SPREAD: Final = 2.0
"""Stated noise may be wrong by this factor, as one sigma of its logarithm."""

MOST: Final = 3.0
"""Noise that differs by more than this factor from what is stated is no noise but moved cones."""

LEAST_SHARE: Final = 0.1
"""Redundancy of an observation below which residuals say nothing of the noise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BeamNoise:
    """Standard deviations of a single point along its beam and in each direction across it, metres."""

    along_m: float = 0.0173
    across_m: float = 0.0173

    def variance_along(self, cosine: ArrayF) -> ArrayF:
        """Variance (n,) of points in a direction that encloses an angle with their beams."""
        return np.asarray(self.along_m**2 * cosine**2 + self.across_m**2 * (1 - cosine**2))

    def change(self, other: Self) -> float:
        """Difference of the variances at 45 degrees, relative to the other's."""
        here, there = (n.along_m**2 + n.across_m**2 for n in (self, other))
        return abs(here / there - 1.0)


def estimate_noise(residual_m: ArrayF, cosine: ArrayF, share: float, stated: BeamNoise) -> BeamNoise:
    """The noise along and across beams that explains residuals best.

    Parameters
    ----------
    residual_m : (n,) of points, along the normals of the surface.
    cosine : (n,) of their incidence.
    share : of the noise's variance that residuals show in the mean: redundancy over number, and what a limit
        for outliers leaves of it. Below `LEAST_SHARE`, where points hardly outnumber unknowns, the noise is
        as stated.
    stated : centre of the prior; noise that is stated as zero stays zero.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> cosine = rng.uniform(0.5, 1.0, 20_000)
    >>> true = BeamNoise(along_m=0.03, across_m=0.01)
    >>> residual = rng.standard_normal(20_000) * np.sqrt(true.variance_along(cosine))
    >>> found = estimate_noise(residual, cosine, 1.0, BeamNoise())
    >>> round(found.along_m, 3), round(found.across_m, 3)
    (0.03, 0.01)
    """
    if share < LEAST_SHARE:
        return stated
    square = np.square(residual_m) / share

    def noise(logs: ArrayF) -> BeamNoise:
        """Stated noise times two factors."""
        along, across = np.exp(logs)
        return BeamNoise(along_m=float(stated.along_m * along), across_m=float(stated.across_m * across))

    def cost(logs: ArrayF) -> float:
        """-2 log L of normal residuals and the prior of the two factors."""
        variance = noise(logs).variance_along(cosine)
        return float(np.sum(np.log(variance) + square / variance) + np.sum((logs / np.log(SPREAD)) ** 2))

    most = float(np.log(MOST))
    found = minimize(cost, np.zeros(2), method="L-BFGS-B", bounds=[(-most, most)] * 2)
    return noise(np.asarray(found.x))
