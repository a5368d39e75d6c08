"""Normal equations of groups of observations: weights, steps, and whether they determine the unknowns."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Generic, TypeVar

import numpy as np
from scipy import linalg, sparse
from scipy.stats import chi2

from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayB, ArrayF

State = TypeVar("State")

RANK_TOLERANCE: Final = 1e-10
"""Smallest eigenvalue of the normal matrix, scaled to a unit diagonal, that counts: float64 leaves 1e-13 of
one that is zero, and two unknowns correlated by 0.99999 have 1e-5."""

HUBER_LIMIT: Final = 1.5
"""Standardised residual at which Huber's weights begin to fall: 95 % efficient on normal errors."""


class UnobservableError(GeometryError):
    """The observations leave unknowns undetermined.

    Parameters
    ----------
    parameters : names of the unknowns that take part in the undetermined combination, the strongest first.
    """

    def __init__(self, parameters: Sequence[str], *, defects: int, cure: str = "") -> None:
        self.parameters = tuple(parameters)
        self.defects = defects
        super().__init__(
            f"the observations do not determine {', '.join(self.parameters)}"
            + (f" ({defects} combinations of unknowns are free)" if defects > 1 else ""),
            expected="a geometry that fixes every unknown",
            cure=cure or "Add observations that see these unknowns from another side, or hold them fixed",
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Linear:
    """Residuals of a group at a state.

    Parameters
    ----------
    residual : (m,).
    jacobian : (m, u), dense or a sparse matrix.
    cov : (m,) variances, or (b, k, k) covariances of consecutive blocks of k residuals with ``m = b k``.
    """

    residual: ArrayF
    jacobian: Any
    cov: ArrayF


@dataclass(frozen=True, slots=True)
class Observations(Generic[State]):
    """A named group of observations: a function from the state to `Linear`."""

    name: str
    model: Callable[[State], Linear]


@dataclass(slots=True)
class Normal:
    """Normal equations at a state: matrix, right side, cost; by group, lengths of blocks, and parts."""

    N: ArrayF
    n: ArrayF
    cost: float
    lengths: list[ArrayF]
    parts: list[Linear]


def normal_equations(
    groups: Sequence[Observations[State]],
    x: State,
    u: int,
    masks: Sequence[ArrayB | None],
    loss: str | None,
) -> Normal:
    """Normal equations of all groups at a state.

    Parameters
    ----------
    groups, x, u : observations, state, number of unknowns.
    masks : for each group the blocks (b,) that count; None: all.
    loss : ``huber`` for robust weights, or None.
    """
    N, n, cost = np.zeros((u, u)), np.zeros(u), 0.0
    lengths: list[ArrayF] = []
    parts: list[Linear] = []
    for group, mask in zip(groups, masks, strict=True):
        part = group.model(x)
        r, J, k = whitened(part, group.name)
        length = np.sqrt(np.square(r).reshape(-1, k).sum(axis=1))
        parts.append(part)
        lengths.append(length)
        root = np.ones(len(length)) if mask is None else mask.astype(np.float64)
        inside = np.square(length)
        if loss is not None:
            limit = HUBER_LIMIT if k == 1 else float(np.sqrt(chi2.ppf(chi2.cdf(HUBER_LIMIT**2, 1), k)))
            far = length > limit
            inside = np.where(far, 2 * limit * length - limit**2, inside)
            root = root * np.sqrt(np.where(far, limit / np.maximum(length, limit), 1.0))
        cost += float(inside[root > 0].sum())
        w = np.repeat(root, k)
        Jw = scaled_rows(J, w)
        product = Jw.T @ Jw
        N += product.toarray() if is_sparse(product) else product
        n += Jw.T @ (r * w)
    return Normal(N, n, cost, lengths, parts)


def is_sparse(J: Any) -> bool:
    """Whether derivatives are a sparse matrix; a plain bool, which type checkers do not take apart."""
    return bool(sparse.issparse(J))


def scaled_rows(J: Any, factor: ArrayF) -> Any:
    """Derivatives, dense or sparse, with each row times a factor (m,)."""
    return sparse.diags_array(factor) @ J if is_sparse(J) else J * factor[:, None]


def whitened(part: Linear, name: str) -> tuple[ArrayF, Any, int]:
    """Residuals and derivatives in units of their covariance, and the size of a block.

    Raises
    ------
    GeometryError : numbers that are not finite, or a covariance that is none; names the group.
    """
    r, S = part.residual, np.asarray(part.cov)
    J: Any = part.jacobian
    values = J.data if is_sparse(J) else J
    if not (np.isfinite(r).all() and np.isfinite(values).all() and np.isfinite(S).all()):
        raise GeometryError(
            f"the observations {name!r} give numbers that are not finite",
            expected="points in front of the camera, and covariances",
            cure="Check the approximate values",
        )
    if S.ndim == 1:
        if not (S > 0).all():
            raise GeometryError(f"a variance of {S.min()} among {name!r}", expected="positive variances")
        inverse = 1.0 / np.sqrt(S)
        return r * inverse, scaled_rows(J, inverse), 1
    b, k = S.shape[:2]
    try:
        root = np.linalg.inv(np.linalg.cholesky(S))
    except np.linalg.LinAlgError as error:
        raise GeometryError(
            f"a covariance among {name!r} is not positive", expected="positive definite covariances"
        ) from error
    if is_sparse(J):
        W: Any = sparse.bsr_array((root, np.arange(b), np.arange(b + 1)), shape=(b * k, b * k))
        return W @ r, (W @ J).tocsr(), k
    return (
        (root @ r.reshape(b, k, 1)).ravel(),
        (root @ np.asarray(J).reshape(b, k, -1)).reshape(b * k, -1),
        k,
    )


def damped_step(here: Normal, names: tuple[str, ...], G: ArrayF | None, damping: float, cure: str) -> ArrayF:
    """Damped step (u,) of the unknowns, to be subtracted; with constraints ``G`` it stays off their datum.

    Raises
    ------
    UnobservableError : the unknowns are not determined.
    """
    scale = _scale(here.N, names, G, cure)
    Ns = here.N / np.outer(scale, scale)
    Ns[np.diag_indices_from(Ns)] += damping
    if G is not None:
        Gs = orthonormal(G / scale)
        Ns = Ns + Gs.T @ Gs
    try:
        factor = linalg.cho_factor(Ns, lower=True)
    except np.linalg.LinAlgError:
        check_rank(here.N, names, G, cure)
        raise
    solved = linalg.cho_solve(factor, here.n / scale)
    if G is not None:
        # The constrained step: without its part along the datum.
        solved = solved - Gs.T @ (Gs @ solved)
    return np.asarray(solved / scale)


def _scale(N: ArrayF, names: tuple[str, ...], G: ArrayF | None, cure: str) -> ArrayF:
    diagonal = np.diag(N)
    blind = np.flatnonzero(~(diagonal > 0))
    if len(blind):
        raise UnobservableError([names[i] for i in blind[:6]], defects=len(blind), cure=cure)
    return np.sqrt(diagonal)


def orthonormal(G: ArrayF) -> ArrayF:
    """Rows with the same span, orthonormal."""
    return np.linalg.qr(G.T)[0].T


def check_rank(N: ArrayF, names: tuple[str, ...], G: ArrayF | None, cure: str) -> None:
    """Raise if the scaled normal matrix has eigenvalues that are zero; names who takes part in them."""
    scale = _scale(N, names, G, cure)
    Ns = N / np.outer(scale, scale)
    if G is not None:
        Gs = orthonormal(G / scale)
        Ns = Ns + Gs.T @ Gs
    # Pivoted Cholesky first: its last pivot bounds the smallest eigenvalue from above and costs little.
    _, _, rank, _ = linalg.lapack.dpstrf(Ns, tol=RANK_TOLERANCE, lower=1)
    if rank == len(Ns) and len(Ns) > 500:
        return
    values, vectors = np.linalg.eigh(Ns)
    free = values < RANK_TOLERANCE
    if not free.any():
        return
    part = np.sqrt(np.square(vectors[:, free]).sum(axis=1))
    order = np.argsort(-part)
    strong = [names[i] for i in order[:6] if part[i] > 0.2 * part[order[0]]]
    raise UnobservableError(strong, defects=int(free.sum()), cure=cure)


def null_space(N: ArrayF, scale: ArrayF, defects: int) -> ArrayF:
    """Directions (u, c) in which the observations leave the unknowns free."""
    _, vectors = linalg.eigh(N / np.outer(scale, scale), subset_by_index=[0, defects - 1])
    return np.asarray(vectors / scale[:, None])
