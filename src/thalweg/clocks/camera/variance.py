"""A variance component by restricted maximum likelihood, and the random effects that it belongs to.

``y = A b + Z u + e`` with ``Cov e = V`` known and ``u`` independent with one unknown variance ``s``. The
restricted likelihood (Patterson and Thompson 1971) does not depend on ``b``. With ``P = V^-1 - V^-1 A (A^T
V^-1 A)^-1 A^T V^-1`` and the eigenvalues ``l`` of ``Z^T P Z`` it is a sum over them, so that one
decomposition serves every ``s``.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize_scalar

from thalweg.core.types import ArrayF

_FLOOR: Final = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True)
class Component:
    """Estimated variance of the effects, and the standard deviation of that estimate."""

    variance: float
    sigma_variance: float

    @property
    def sigma(self) -> float:
        """Standard deviation of the effects."""
        return float(np.sqrt(self.variance))

    @property
    def sigma_of_sigma(self) -> float:
        """Standard deviation of `sigma`; near zero that of the variance is turned into an upper end."""
        if self.variance > self.sigma_variance:
            return self.sigma_variance / (2.0 * self.sigma)
        return float(np.sqrt(self.variance + self.sigma_variance)) - self.sigma


def estimate_component(y: ArrayF, A: ArrayF, Z: ArrayF, V: ArrayF) -> Component:
    """The variance of ``u``.

    Parameters
    ----------
    y : (m,) observations or residuals at any b.
    A : (m, p) derivatives by the fixed unknowns; prior knowledge enters as further rows of y, A and V.
    Z : (m, n) derivatives by the random effects.
    V : (m, m) covariance of everything else.
    """
    L = np.linalg.cholesky(V)
    white = solve_triangular(L, np.column_stack([A, Z, y]), lower=True, check_finite=False)
    p = A.shape[1]
    Q, _ = np.linalg.qr(white[:, :p])
    free = white[:, p:] - Q @ (Q.T @ white[:, p:])
    values, vectors = np.linalg.eigh(free[:, :-1].T @ free[:, :-1])
    keep = values > _FLOOR * values[-1]
    values = values[keep]
    square = np.square(vectors[:, keep].T @ (free[:, :-1].T @ free[:, -1]))

    def misfit(log_s: float) -> float:
        """Twice the negative restricted log likelihood, but for a constant."""
        s = np.exp(log_s)
        return float(np.sum(np.log1p(s * values) - s * square / (1.0 + s * values)))

    unit = 1.0 / float(np.median(values))  # the variance at which an effect stands out of the noise
    found = minimize_scalar(misfit, bounds=(np.log(1e-6 * unit), np.log(1e6 * unit)), method="bounded")
    s = float(np.exp(found.x))
    if misfit(float(np.log(1e-6 * unit))) <= found.fun + 1e-6:
        s = 0.0
    information = 0.5 * float(np.sum(np.square(values / (1.0 + s * values))))
    return Component(variance=s, sigma_variance=float(1.0 / np.sqrt(information)))
