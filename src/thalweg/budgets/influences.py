"""What each input of a budget does to a point, in millimetres, and how often an error stays below."""

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.stats import chi2

from thalweg.budgets.budget import Budget, covariance, jacobian
from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayF

TOTAL = "total"
CORRELATIONS = "correlations"


def influences(
    budget: Budget, distances_m: ArrayLike | None = None, *, normal: ArrayLike | None = None
) -> pd.DataFrame:
    """Influence of each input on the 3D standard deviation of a point (P2 eq. 8-9).

    Parameters
    ----------
    distances_m : (n,); the budget's own if None.
    normal : (3,) in the world; with it, the influences on the component along this direction, which is what a
        comparison with a surface sees.

    Returns
    -------
    DataFrame
        Columns ``input, group, sigma, unit, provenance, distance_m, influence_mm``: a row for each input and
        distance, then the sum of the covariance terms where there are correlations (the root of its size with
        its sign, for it may reduce the total), then the total.

    Raises
    ------
    GeometryError : a distance is not positive, or a normal has no length.
    """
    d = np.atleast_1d(np.asarray(budget.distances_m if distances_m is None else distances_m, dtype=float))
    if d.ndim != 1 or not d.size or not (np.isfinite(d) & (d > 0)).all():
        raise GeometryError(f"distances {d.tolist()}", expected="at least one, above 0 m")
    along = None if normal is None else _unit(normal)
    rows = []
    alone = np.zeros(len(d))
    for item, J in zip(budget.inputs, jacobian(budget, d), strict=True):
        variance = np.sum((J if along is None else along @ J) ** 2, axis=(1, 2) if along is None else 1)
        alone += variance
        facts = (item.key, budget.group(item), item.sigma, item.unit, item.provenance)
        rows += [(*facts, at, 1e3 * v**0.5) for at, v in zip(d, variance, strict=True)]
    cov = covariance(budget, d)
    total = np.einsum("nii->n", cov) if along is None else np.einsum("i,nij,j->n", along, cov, along)
    none = (np.nan, "", "")
    if budget.correlations:
        shared = total - alone
        rows += [
            (CORRELATIONS, CORRELATIONS, *none, at, 1e3 * float(np.sign(v) * abs(v) ** 0.5))
            for at, v in zip(d, shared, strict=True)
        ]
    rows += [(TOTAL, TOTAL, *none, at, 1e3 * v**0.5) for at, v in zip(d, total, strict=True)]
    names = ["input", "group", "sigma", "unit", "provenance", "distance_m", "influence_mm"]
    return pd.DataFrame(rows, columns=names)


def totals_mm(budget: Budget, distances_m: ArrayLike) -> ArrayF:
    """3D standard deviation (n,) in millimetres."""
    return np.asarray(1e3 * np.sqrt(np.einsum("nii->n", covariance(budget, distances_m))))


def rmse_mm(budget: Budget) -> float:
    """RMSE over the distances of the budget's survey.

    Raises
    ------
    GeometryError : the budget has no survey.
    """
    if budget.survey is None:
        raise GeometryError(
            "a budget without a survey", where=budget.name, expected="`survey` with `from_m` and `to_m`"
        )
    return float(np.sqrt(np.mean(totals_mm(budget, budget.survey.distances_m()) ** 2)))


def ball_coverage(cov: ArrayF, radius: ArrayLike) -> ArrayF:
    """Probability (n,) that a normal error of covariance ``cov`` (n, 3, 3) is within ``radius`` (n,).

    In direction ``u`` of standardised errors the squared length is chi-square with three degrees of freedom
    times ``u^T L u``, L the eigenvalues; the mean over all directions is taken by Gauss-Legendre nodes in the
    height and equal steps around, to about 1e-6.
    """
    values = np.clip(np.linalg.eigvalsh(cov), 0.0, None)
    height, weight = np.polynomial.legendre.leggauss(96)
    around = (np.arange(96) + 0.5) * (2 * np.pi / 96)
    ring = np.sqrt(1 - height**2)
    squares = np.stack([
        (ring[:, None] * np.cos(around)) ** 2,
        (ring[:, None] * np.sin(around)) ** 2,
        np.broadcast_to(height[:, None] ** 2, (96, 96)),
    ])  # fmt: skip
    spread = np.einsum("nk,kij->nij", values, squares)
    inside = chi2.cdf(np.square(radius).reshape(-1, 1, 1) / np.maximum(spread, 1e-300), 3)
    return np.asarray(np.einsum("nij,i->n", inside, weight / 2) / 96)


def coverages(budget: Budget, distances_m: ArrayLike) -> pd.DataFrame:
    """Shares of errors within k = 1, 2, 3 standard deviations (T 3.1.2 says 68, 95, 99.7 %).

    Columns ``distance_m, k, one_component, ball_of_total``. The remark holds for each component. The 3D total
    of P2 eq. 9 is the root of the summed variances: a ball of that radius holds another share, which depends
    on the shape of the error: for k = 1 61 % if all directions are alike, 68 % if all lies along one line.
    """
    d = np.asarray(distances_m, dtype=np.float64)
    cov = covariance(budget, d)
    total = np.sqrt(np.einsum("nii->n", cov))
    rows = []
    for k in (1, 2, 3):
        one = float(chi2.cdf(k**2, 1))
        rows += [(at, k, one, float(p)) for at, p in zip(d, ball_coverage(cov, k * total), strict=True)]
    return pd.DataFrame(rows, columns=["distance_m", "k", "one_component", "ball_of_total"])


def _unit(normal: ArrayLike) -> ArrayF:
    n = np.asarray(normal, dtype=np.float64)
    length = float(np.linalg.norm(n)) if n.shape == (3,) else 0.0
    if not 0 < length < np.inf:
        raise GeometryError(f"normal {n.tolist()}", expected="three numbers with a length above 0")
    return np.asarray(n / length)
