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

Errors of a smoothed trajectory, or of poses between photographs, are no such process, but they are a Markov
chain of more components, ``xi_k = L_k z_k`` with ``z_k = M_k z_(k-1) + noise`` (`thalweg.core.ErrorChain`).
The sums are the same with the matrix M_k in place of the exponential.

Source: Gelb (1974), Applied Optimal Estimation, 2.2, for the process; the sums are written out here.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import scipy.sparse as sp

from thalweg.core import AnyArray, ArrayF, ArrayI, ErrorChain, GeometryError, njit, prange, symmetric_roots
from thalweg.deformation.m3c2 import Weights

TURNS: Final = ("attitude", "mount, rotation")
"""Groups whose error is a small rotation; all others shift."""
COMMON: Final = "stated, common to all"
"""Group of an error that all heights of an epoch share; a motion that is taken off holds it."""


class SharedErrors(ABC):
    """One kind of error at m moments or places: c components from d ones of unit variance.

    Attributes
    ----------
    name : what errs.
    root : (m, c, d) roots of the covariance of the c components at each moment or place.
    """

    __slots__ = ()
    name: str
    root: ArrayF

    @abstractmethod
    def variances(self, rows: sp.csr_matrix) -> ArrayF:
        """Variance (k,) of products with these derivatives (k, c m)."""

    @abstractmethod
    def correlated(self, u: ArrayF) -> ArrayF:
        """Correlation matrix of the d components of all moments or places, times (m, d, q)."""

    @abstractmethod
    def unit_draw(self, rng: np.random.Generator) -> ArrayF:
        """The d components (m, d), drawn."""

    @abstractmethod
    def facts(self) -> dict[str, Any]:
        """How long or how far it lasts, and its unit."""

    @abstractmethod
    def stored(self) -> Mapping[str, AnyArray]:
        """Arrays from which, with its facts, it is made again."""

    def times_covariance(self, columns: ArrayF) -> ArrayF:
        """Covariance matrix of all errors (c m, c m) times columns (c m, q), without the matrix."""
        m, c, _ = self.root.shape
        u = np.einsum("kji,kjq->kiq", self.root, columns.reshape(m, c, -1))
        return np.einsum("kij,kjq->kiq", self.root, self.correlated(u)).reshape(c * m, -1)

    def draw(self, rng: np.random.Generator) -> ArrayF:
        """Errors (c m,), drawn."""
        return np.einsum("kij,kj->ki", self.root, self.unit_draw(rng)).ravel()


@dataclass(frozen=True, slots=True)
class ErrorGroup(SharedErrors):
    """One kind of error of the poses: c components of a process with d ones of its own.

    Attributes
    ----------
    name : what errs ("position", "attitude").
    t_s : (m,) times of the moments, ascending.
    root : (m, c, d) roots L of the covariance L L' at each moment, in metres (position, world axes) or
        radians (small rotation about east, north, up); both where c is 6.
    correlation_s : correlation time tau; 0 for independent moments, infinite for one error of all.
    link : (m, d, d) covariance of the d components of each moment with those of the one before, of unit
        variance; in place of the correlation time, which is NaN.
    """

    name: str
    t_s: ArrayF
    root: ArrayF
    correlation_s: float
    link: ArrayF | None = None

    def __post_init__(self) -> None:
        if self.link is not None:
            return
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

    @classmethod
    def of_chain(cls, chain: ErrorChain, start_gps_s: float, turn: ArrayF) -> "ErrorGroup":
        """A chain of errors on times from a start, in axes turned by ``turn`` (3, 3)."""
        root = np.concatenate([turn @ chain.root[:, :3], turn @ chain.root[:, 3:]], axis=1)
        return cls(chain.name, chain.t_gps_s - start_gps_s, root, np.nan, chain.link)

    def alike(self) -> "ErrorGroup":
        """The same variances with one error of all moments."""
        m, c, _ = self.root.shape
        cov = self.root @ np.swapaxes(self.root, 1, 2)
        root = symmetric_roots(cov, np.broadcast_to(np.eye(c), (m, c, c)))
        return ErrorGroup(self.name, self.t_s, root, np.inf)

    @property
    def links(self) -> ArrayF:
        """Matrices (m, d, d) that lead from the d components of a moment to those of the next."""
        if self.link is not None:
            return self.link
        decay = np.zeros(len(self.t_s))
        if self.correlation_s > 0:
            decay[1:] = np.exp(-np.diff(self.t_s) / self.correlation_s)
        return decay[:, None, None] * np.eye(self.root.shape[2])

    def variances(self, rows: sp.csr_matrix) -> ArrayF:
        """Variance (k,) of products with these derivatives (k, c m)."""
        spans, begins = _spans_of_links(self.links)
        return np.asarray(_variances(rows.indptr, rows.indices, rows.data, self.root, spans, begins))

    def correlated(self, u: ArrayF) -> ArrayF:
        """Correlation matrix of the components of all moments, times (m, d, q)."""
        return np.asarray(_times_correlation(np.ascontiguousarray(u), np.ascontiguousarray(self.links)))

    def unit_draw(self, rng: np.random.Generator) -> ArrayF:
        """The components (m, d) of all moments, drawn."""
        return _drawn(rng.standard_normal((len(self.t_s), self.root.shape[2])), self.links)

    def facts(self) -> dict[str, Any]:
        """Its correlation time, in seconds and in words, and its unit."""
        lasts = "everywhere" if self.name == COMMON else "all the time"
        if self.link is not None:
            lasts = "from node to node as the trajectory says"
        elif not np.isinf(self.correlation_s):
            lasts = f"{self.correlation_s:g} s"
        return {
            "correlation_s": self.correlation_s if np.isfinite(self.correlation_s) else None,
            "lasts": lasts,
            "unit": "m, rad" if self.link is not None else "rad" if self.name in TURNS else "m",
        }

    def stored(self) -> Mapping[str, AnyArray]:
        """Arrays from which, with its facts, it is made again."""
        return {"root": self.root} | ({} if self.link is None else {"link": self.link, "nodes": self.t_s})


@dataclass(frozen=True, slots=True)
class ErrorField:
    """Errors of one epoch: groups of shared errors, each with the derivatives of products to them.

    Attributes
    ----------
    groups : kinds of errors.
    rows : for each group a sparse matrix (k, c m) with the derivatives of k products to the errors of m
        moments, component by component of each moment.
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

    def __add__(self, other: "ErrorField") -> "ErrorField":
        """Sums of the products of two fields on the same groups (`joint_fields`)."""
        return ErrorField(
            self.groups, tuple((a + b).sorted_indices() for a, b in zip(self.rows, other.rows, strict=True))
        )

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


def joint_fields(fields: Sequence[ErrorField], *, common: str | None = None) -> list[ErrorField]:
    """Fields of several epochs on the groups of all, so that their products can be added.

    Parameters
    ----------
    fields : each with the errors of its own epoch.
    common : groups whose names begin so are the same error in all epochs that have them.
    """
    groups: list[SharedErrors] = []
    members: list[dict[int, int]] = []  # group of each epoch that is part of it
    place: dict[str, int] = {}
    for e, field in enumerate(fields):
        for g, group in enumerate(field.groups):
            shared = common is not None and group.name.startswith(common)
            if shared and isinstance(group, ErrorGroup) and group.link is None:
                i = place.setdefault(group.name, len(groups))
                if i < len(groups):
                    before = groups[i]
                    assert isinstance(before, ErrorGroup)
                    t = np.concatenate([before.t_s, before.t_s[-1] + group.t_s])
                    groups[i] = ErrorGroup(group.name, t, np.concatenate([before.root, group.root]), np.inf)
                    members[i][e] = g
                    continue
            groups.append(group)
            members.append({e: g})
    out = []
    for e, field in enumerate(fields):
        k = field.rows[0].shape[0]
        rows = []
        for group, part in zip(groups, members, strict=True):
            blocks = [
                field.rows[g] if other == e else sp.csr_matrix((k, fields[other].rows[g].shape[1]))
                for other, g in part.items()
            ]
            joined = blocks[0] if len(blocks) == 1 else sp.csr_matrix(sp.hstack(blocks).tocsr())
            assert joined.shape[1] == group.root.shape[0] * group.root.shape[1]
            rows.append(joined)
        out.append(ErrorField(tuple(groups), tuple(rows)))
    return out


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


def rows_of_weights(weights: Weights, values: ArrayF, n_moments: int) -> sp.csr_matrix:
    """Rows of a product as a sparse matrix over the c components of moments; ``values`` (e, c)."""
    c = values.shape[1]
    index = (c * weights.node.astype(np.int32)[:, None] + np.arange(c, dtype=np.int32)).ravel()
    return sp.csr_matrix(
        (values.ravel(), index, c * weights.start), shape=(len(weights.start) - 1, c * n_moments)
    )


def _spans_of_links(link: ArrayF) -> tuple[ArrayF, ArrayI]:
    """Links over 1, 2, 4, ... steps, one after the other, and where each length begins.

    Entry j of length n leads over the steps into the moments ``j n`` to ``(j + 1) n - 1``: rows pass over the
    moments that they do not touch in few products.
    """
    levels = [link]
    while len(levels[-1]) > 1:
        whole = levels[-1][: len(levels[-1]) // 2 * 2]
        levels.append(whole[1::2] @ whole[::2])
    begins = np.cumsum([0, *(len(level) for level in levels)])
    return np.concatenate(levels), begins.astype(np.int64)


@njit(cache=True, parallel=True)
def _variances(
    start: AnyArray, index: AnyArray, value: AnyArray, root: AnyArray, spans: AnyArray, begins: AnyArray
) -> AnyArray:
    """Variance of each sparse row over a Markov chain, whose entries stand in the order of the moments."""
    out = np.zeros(len(start) - 1)
    c, d = root.shape[1], root.shape[2]
    for row in prange(len(out)):
        moment = -1
        s = np.zeros(d)
        u = np.zeros(d)
        passed = np.zeros(d)
        total = 0.0
        for e in range(start[row], start[row + 1] + 1):
            now = index[e] // c if e < start[row + 1] else -2
            if now != moment:
                if moment >= 0:
                    for i in range(d):
                        total += u[i] * (u[i] + 2.0 * s[i])
                        s[i] += u[i]
                if now < 0:
                    break
                at = moment + 1
                while moment >= 0 and at <= now:
                    level, length = 0, 1
                    while at % (2 * length) == 0 and at + 2 * length - 1 <= now:
                        level, length = level + 1, 2 * length
                    M = spans[begins[level] + at // length]
                    for i in range(d):
                        passed[i] = 0.0
                        for j in range(d):
                            passed[i] += M[i, j] * s[j]
                    for i in range(d):
                        s[i] = passed[i]
                    at += length
                for i in range(d):
                    u[i] = 0.0
                moment = now
            component = index[e] - c * now
            for i in range(d):
                u[i] += root[now, component, i] * value[e]
        out[row] = total
    return out


@njit(cache=True)
def _times_correlation(u: AnyArray, link: AnyArray) -> AnyArray:
    """Correlation matrix of a Markov chain times (m, d, q), by one pass forward and one back."""
    out = u.copy()
    m, d, q = u.shape
    s = np.zeros((d, q))
    for k in range(1, m):
        for i in range(d):
            for c in range(q):
                s[i, c] += u[k - 1, i, c]
        s = np.dot(link[k], s)
        out[k] += s
    s = np.zeros((d, q))
    for k in range(m - 2, -1, -1):
        for i in range(d):
            for c in range(q):
                s[i, c] += u[k + 1, i, c]
        s = np.dot(link[k + 1].T, s)
        out[k] += s
    return out


def _drawn(normal: ArrayF, link: ArrayF) -> ArrayF:
    """A Markov chain of unit variance with these links, from white numbers (m, d)."""
    value, vector = np.linalg.eigh(np.eye(link.shape[1]) - link @ np.swapaxes(link, 1, 2))
    noise = np.einsum("kij,kj->ki", vector, np.sqrt(np.maximum(value, 0.0)) * normal)
    out = np.empty_like(normal)
    out[0] = normal[0]
    for k in range(1, len(normal)):
        out[k] = link[k] @ out[k - 1] + noise[k]
    return out
