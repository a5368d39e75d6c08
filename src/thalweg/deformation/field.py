r"""Errors that the points of one moment share, added up for whatever is computed from points.

The error of a point of a cloud from a moving platform is

    e = J(t) xi(t) + w

with the pose's error xi (position, small rotation), which is correlated in time, and white noise w. xi is a
Gauss-Markov process: the covariance between two moments is L(t) L(t')' exp(-|t - t'| / tau). Each product (a
distance, the mean of a patch, a volume, a parameter of a registration) is a weighted sum of points, so that
its derivative to the errors of the moments is a row of vectors v_k. With u_k = L_k' v_k its variance is

    sum_k |u_k|^2 + 2 sum_k u_k . s_k,    s_k = exp(-(t_k - t_(k-1)) / tau) (s_(k-1) + u_(k-1)),

one pass over the moments. Independent moments (tau -> 0) leave the first sum, a common error (tau ->
infinity) the square of all. Products that share moments have a covariance, by the same recursion in both
directions.

Source: Gelb (1974), Applied Optimal Estimation, 2.2, for the process; the sums are written out here.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.sparse as sp

from thalweg.core import AnyArray, ArrayF, GeometryError, njit, prange
from thalweg.deformation.m3c2 import Weights


class SharedErrors(Protocol):
    """One kind of error at m moments or places: what a field needs to know of it."""

    @property
    def name(self) -> str:
        """What errs."""

    @property
    def root(self) -> ArrayF:
        """Roots (m, 3, 3) of the covariance at each moment or place."""

    def variances(self, rows: sp.csr_matrix) -> ArrayF:
        """Variance (k,) of products with these derivatives (k, 3 m)."""

    def times_covariance(self, columns: ArrayF) -> ArrayF:
        """Covariance matrix of all errors (3 m, 3 m) times columns (3 m, q), without the matrix."""

    def draw(self, rng: np.random.Generator) -> ArrayF:
        """Errors (3 m,), drawn."""


@dataclass(frozen=True, slots=True)
class ErrorGroup:
    """One kind of error of the poses: three components with one correlation time.

    Attributes
    ----------
    name : what errs ("position", "attitude").
    t_s : (m,) times of the moments, ascending.
    root : (m, 3, 3) roots L of the covariance L L' at each moment, in metres (position, world axes) or
        radians (small rotation about east, north, up).
    correlation_s : correlation time tau; 0 for independent moments, infinite for one error of all.
    """

    name: str
    t_s: ArrayF
    root: ArrayF
    correlation_s: float

    def __post_init__(self) -> None:
        if (np.diff(self.t_s) < 0).any() or not self.correlation_s >= 0:
            raise GeometryError(
                f"errors of the {self.name}: times that go back, or correlated over {self.correlation_s} s",
                expected="ascending times and a correlation time of zero or more",
            )

    @classmethod
    def from_sigmas(cls, name: str, t_s: ArrayF, sigma: ArrayF, correlation_s: float) -> "ErrorGroup":
        """Uncorrelated components with standard deviations (3,) or (m, 3)."""
        root = np.zeros((len(t_s), 3, 3))
        root[:, [0, 1, 2], [0, 1, 2]] = sigma
        return cls(name, np.asarray(t_s, float), root, correlation_s)

    @property
    def decay(self) -> ArrayF:
        """Correlation (m,) of each moment with the one before; 0 for the first."""
        with np.errstate(divide="ignore", invalid="ignore"):
            rest = np.exp(-np.diff(self.t_s) / self.correlation_s)
        return np.r_[0.0, np.nan_to_num(rest, nan=1.0)]

    def variances(self, rows: sp.csr_matrix) -> ArrayF:
        """Variance (k,) of products with these derivatives (k, 3 m)."""
        return np.asarray(
            _variances(rows.indptr, rows.indices, rows.data, self.t_s, self.root, self.correlation_s)
        )

    def times_covariance(self, columns: ArrayF) -> ArrayF:
        """Covariance matrix of all moments' errors (3 m, 3 m) times columns (3 m, q), without the matrix."""
        return _times_covariance(self, columns)

    def draw(self, rng: np.random.Generator) -> ArrayF:
        """Errors (3 m,) of all moments, drawn."""
        process = _gauss_markov(rng.standard_normal((len(self.t_s), 3)), self.decay)
        return np.einsum("kij,kj->ki", self.root, process).ravel()


@dataclass(frozen=True, slots=True)
class ErrorField:
    """Errors of one epoch: groups of shared errors, each with the derivatives of products to them.

    Attributes
    ----------
    groups : kinds of errors.
    rows : for each group a sparse matrix (k, 3 m) with the derivatives of k products to the errors of m
        moments,
        component by component of each moment.
    """

    groups: tuple[SharedErrors, ...]
    rows: tuple[sp.csr_matrix, ...]

    @classmethod
    def of_distances(cls, weights: Weights, position: ErrorGroup, attitude: ErrorGroup) -> "ErrorField":
        """The field of mean positions along normals (`thalweg.deformation.m3c2.pose_weights`)."""
        return cls(
            (position, attitude),
            tuple(
                rows_of_weights(weights, values, len(group.t_s))
                for values, group in ((weights.shift, position), (weights.turn_m, attitude))
            ),
        )

    @property
    def of_poses(self) -> tuple[ErrorGroup, ...]:
        """The groups that are errors of poses and mounts, not of places."""
        return tuple(group for group in self.groups if isinstance(group, ErrorGroup))

    def variances(self) -> ArrayF:
        """Variance (k,) of each product."""
        total = np.zeros(self.rows[0].shape[0])
        for group, rows in zip(self.groups, self.rows, strict=True):
            total += group.variances(rows)
        return total

    def combined(self, combination: ArrayF | sp.csr_matrix) -> "ErrorField":
        """Linear combinations (q, k) of the products: means of patches, volumes, registered distances."""
        weights = sp.csr_matrix(combination)
        return ErrorField(self.groups, tuple((weights @ rows).sorted_indices() for rows in self.rows))

    def covariance_with(self, others: "ErrorField") -> ArrayF:
        """Covariance (k, q) of these products with a few others of the same epoch."""
        total = np.zeros((self.rows[0].shape[0], others.rows[0].shape[0]))
        for group, rows, few in zip(self.groups, self.rows, others.rows, strict=True):
            total += rows @ group.times_covariance(few.toarray().T)
        return total

    def draw(self, rng: np.random.Generator) -> ArrayF:
        """Errors (k,) of the products for one draw of the errors of all moments."""
        total = np.zeros(self.rows[0].shape[0])
        for group, rows in zip(self.groups, self.rows, strict=True):
            total += rows @ group.draw(rng)
        return total


def benjamini_hochberg(p_value: ArrayF) -> ArrayF:
    """q-values (k,): the smallest rate of false discoveries at which each test counts; NaN stays NaN.

    Benjamini and Hochberg (1995), J. R. Stat. Soc. B 57; valid under the positive dependence of a shared
    field.
    """
    q = np.full(len(p_value), np.nan)
    known = np.flatnonzero(np.isfinite(p_value))
    order = known[np.argsort(p_value[known])]
    ranks = np.arange(1, len(order) + 1)
    q[order] = np.minimum.accumulate((p_value[order] * len(order) / ranks)[::-1])[::-1]
    return q


def largest_deviation(
    fields: Sequence[ErrorField], sigma: ArrayF, *, draws: int = 200, share: float = 0.95, seed: int = 0
) -> float:
    """The limit that the largest |error| / sigma of all products keeps in a share of draws of the fields.

    Parameters
    ----------
    fields : of the epochs; their errors add up.
    sigma : (k,) standard deviation of each product, white part included, which is drawn beside the fields.
    draws : number of draws; share : of them that stay below the limit.

    Raises
    ------
    GeometryError : no product has a sigma.
    """
    rng = np.random.default_rng(seed)
    shared = np.sqrt(np.sum([field.variances() for field in fields], axis=0))
    known = np.isfinite(sigma) & (sigma > 0)
    if not known.any():
        raise GeometryError(
            "no distance has a standard deviation", expected="core points seen in both epochs"
        )
    white = np.sqrt(np.maximum(sigma[known] ** 2 - shared[known] ** 2, 0.0))
    largest = np.empty(draws)
    for i in range(draws):
        error = np.sum([field.draw(rng) for field in fields], axis=0)[known]
        error += white * rng.standard_normal(len(white))
        largest[i] = np.max(np.abs(error) / sigma[known])
    return float(np.quantile(largest, share))


def rows_of_weights(weights: Weights, values: ArrayF, n_moments: int) -> sp.csr_matrix:
    """Rows of a product as a sparse matrix over components of moments."""
    index = (3 * weights.node.astype(np.int32)[:, None] + np.arange(3, dtype=np.int32)).ravel()
    return sp.csr_matrix(
        (values.ravel(), index, 3 * weights.start), shape=(len(weights.start) - 1, 3 * n_moments)
    )


@njit(cache=True, parallel=True)
def _variances(
    start: AnyArray, index: AnyArray, value: AnyArray, t: AnyArray, root: AnyArray, correlation: float
) -> AnyArray:
    """Variance of each sparse row, whose entries stand in the order of the moments and components."""
    out = np.zeros(len(start) - 1)
    for row in prange(len(out)):
        before, moment = 0.0, -1
        s = np.zeros(3)
        u = np.zeros(3)
        total = 0.0
        for e in range(start[row], start[row + 1] + 1):
            now = index[e] // 3 if e < start[row + 1] else -2
            if now != moment:
                if moment >= 0:
                    total += (
                        u[0] * (u[0] + 2.0 * s[0]) + u[1] * (u[1] + 2.0 * s[1]) + u[2] * (u[2] + 2.0 * s[2])
                    )
                    for axis in range(3):
                        s[axis] += u[axis]
                    before = t[moment]
                if now < 0:
                    break
                if moment >= 0:
                    keep = math.exp(-(t[now] - before) / correlation) if correlation > 0.0 else 0.0
                    for axis in range(3):
                        s[axis] *= keep
                for axis in range(3):
                    u[axis] = 0.0
                moment = now
            component = index[e] - 3 * now
            for axis in range(3):
                u[axis] += root[now, component, axis] * value[e]
        out[row] = total
    return out


@njit(cache=True)
def _gauss_markov(normal: AnyArray, decay: AnyArray) -> AnyArray:
    """A process of unit variance with these correlations of neighbours, from white numbers (m, c)."""
    out = np.empty_like(normal)
    out[0] = normal[0]
    for k in range(1, len(normal)):
        out[k] = decay[k] * out[k - 1] + np.sqrt(max(0.0, 1.0 - decay[k] ** 2)) * normal[k]
    return out


@njit(cache=True)
def _sums_of_neighbours(u: AnyArray, decay: AnyArray) -> AnyArray:
    """Correlation matrix of a Gauss-Markov process times (m, c), by one pass forward and one back."""
    out = u.copy()
    for k in range(1, len(u)):
        out[k] += decay[k] * out[k - 1]
    back = np.zeros(u.shape[1])
    for k in range(len(u) - 2, -1, -1):
        back = decay[k + 1] * (back + u[k + 1])
        out[k] += back
    return out


def _times_covariance(group: ErrorGroup, columns: ArrayF) -> ArrayF:
    """Covariance matrix of all moments' errors (3 m, 3 m) times columns (3 m, q), without the matrix."""
    m = len(group.t_s)
    u = np.einsum("kji,kjq->kiq", group.root, columns.reshape(m, 3, -1))
    summed = _sums_of_neighbours(np.ascontiguousarray(u.reshape(m, -1)), group.decay).reshape(u.shape)
    return np.einsum("kij,kjq->kiq", group.root, summed).reshape(3 * m, -1)
