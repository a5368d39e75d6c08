"""Least-squares adjustment with names: estimates, full covariance, tests, refusal of what is undetermined.

Every adjustment of the project goes through `adjust`. An observation group is a function of the state that
gives residuals ``r`` with covariance ``S`` and their derivatives ``J`` by a small change ``dx`` of the
unknowns::

    r(x + dx) = r(x) + J dx,     E r = 0,  Cov r = S

That is a Gauss-Markov model with ``r = f(x) - l``. Conditions ``g(x, l) = 0`` between unknowns and
observations (Gauss-Helmert) come to the same with ``r = g + B (l - l_adjusted)`` and ``S = B Cov(l) B^T``,
linearised at the adjusted observations (Helmert 1872; Koch 1999, sec. 3.5): see `condition`. Unknowns live
wherever ``update`` puts them, so that rotations are changed by small rotation vectors.

The unknowns are solved by Gauss-Newton steps, damped (Levenberg 1944) where a step does not help. Robust
weights (Huber 1964) find the way among blunders; blunders are then removed and the rest is adjusted without
weights, because only so does the covariance mean what it says.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, Generic, TypeVar

import numpy as np
from scipy import linalg, sparse
from scipy.stats import chi2

from thalweg.core.errors import GeometryError
from thalweg.core.types import AnyArray, ArrayB, ArrayF

__all__ = [
    "RANK_TOLERANCE",
    "REJECT_SIGMAS",
    "Adjusted",
    "GlobalTest",
    "Linear",
    "Observations",
    "UnobservableError",
    "adjust",
    "condition",
    "global_test",
    "prior",
]
State = TypeVar("State")
REJECT_SIGMAS: Final = 5.0
"""Where a loss is asked for and no limit is given."""
_ROUNDS: Final = 10
_CONVERGED: Final = 1e-8
"""Squared step in units of the covariance: a step of a ten-thousandth of a sigma."""

RANK_TOLERANCE: Final = 1e-10
"""Smallest eigenvalue of the normal matrix, scaled to a unit diagonal, that counts: float64 leaves 1e-13 of
one that is zero, and two unknowns correlated by 0.99999 have 1e-5."""
HUBER_LIMIT: Final = 1.5
"""Standardised residual at which Huber's weights begin to fall: 95 % efficient on normal errors."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Linear:
    """Residuals of a group at a state.

    Parameters
    ----------
    residual : (m,).
    jacobian : (m, u), dense or a sparse matrix.
    cov : (m,) variances, or (b, k, k) covariances of consecutive blocks of k residuals with ``m = b k``.
    normal : (u, u) ``J^T cov^-1 J`` where it is known, as of derivatives that never change, or None.
    """

    residual: ArrayF
    jacobian: Any
    cov: ArrayF
    normal: ArrayF | None = None


@dataclass(frozen=True, slots=True)
class Observations(Generic[State]):
    """A named group of observations: a function from the state to `Linear`."""

    name: str
    model: Callable[[State], Linear]


# ---------------------------------------------------------------- adjustment


@dataclass(frozen=True, slots=True, kw_only=True)
class Adjusted(Generic[State]):
    """Result of `adjust`.

    Parameters
    ----------
    x : state.
    cov : (u, u) covariance of the small change of the unknowns, from the stated sigmas (not scaled by
    sigma0).
    names : (u,) names of the unknowns.
    sigma0_squared : sum of the squared standardised residuals over the redundancy; expectation 1.
    redundancy : observations (with constraints) minus unknowns.
    residuals : by group, (m,).
    standardised : by group, (b,) lengths of the residuals of a block in units of their covariance.
    used : by group, (b,) False where a block was rejected.
    group_sigma0, group_redundancy : by group, root of the share of sigma0_squared, and redundancy.
    n_iterations : steps in all.
    """

    x: State
    cov: ArrayF
    names: tuple[str, ...]
    sigma0_squared: float
    redundancy: float
    residuals: Mapping[str, ArrayF]
    standardised: Mapping[str, ArrayF]
    used: Mapping[str, ArrayB]
    group_sigma0: Mapping[str, float]
    group_redundancy: Mapping[str, float]
    n_iterations: int

    @property
    def sigmas(self) -> ArrayF:
        """(u,) standard deviations of the unknowns."""
        return np.sqrt(np.maximum(np.diag(self.cov), 0.0))

    def sigma(self, name: str) -> float:
        """Standard deviation of one unknown."""
        return float(self.sigmas[self.names.index(name)])

    def correlation(self) -> ArrayF:
        """(u, u) correlation matrix."""
        s = np.where(self.sigmas > 0, self.sigmas, 1.0)
        return np.asarray(self.cov / np.outer(s, s))

    def block(self, names: Sequence[str]) -> ArrayF:
        """Covariance of some unknowns, in the order of ``names``."""
        at = [self.names.index(name) for name in names]
        return self.cov[np.ix_(at, at)]

    def global_test(self, level: float = 0.05) -> "GlobalTest":
        """Whether the residuals are as large as the stated sigmas let expect."""
        return global_test(float(np.sqrt(self.sigma0_squared)), self.redundancy, level)


@dataclass(frozen=True, slots=True, kw_only=True)
class GlobalTest:
    """Global test of an adjustment: sigma0 beside the band that holds it if all stated sigmas are right.

    Parameters
    ----------
    sigma0 : root of the squared standardised residuals over the redundancy.
    low, high : two-sided band of sigma0, by the chi-square distribution of its redundancy.
    """

    sigma0: float
    low: float
    high: float

    @property
    def factor(self) -> float:
        """What standard deviations are to be multiplied with: sigma0 above its band, else 1.

        Residuals below the band do not make them smaller: what errs alike in all observations leaves none.
        """
        return self.sigma0 if self.sigma0 > self.high else 1.0

    def note(self, what: str) -> str:
        """A sentence where the test fails, else "".

        Parameters
        ----------
        what : what the sigmas are stated of, in the plural: "image and control points".
        """
        if self.low <= self.sigma0 <= self.high:
            return ""
        band = f"sigma0 {self.sigma0:.2f}, {self.low:.2f} to {self.high:.2f} expected"
        if self.sigma0 > self.high:
            return (
                f"Global test failed ({band}): {what} err more than stated; standard deviations are "
                f"multiplied by {self.sigma0:.2f}"
            )
        return (
            f"Global test failed ({band}): {what} err less than stated, and standard deviations of the "
            "results are too large by up to that factor"
        )


def global_test(sigma0: float, redundancy: float, level: float = 0.05) -> GlobalTest:
    """Two-sided chi-square test of sigma0 at its redundancy (Koch 1999, sec. 4.2); it passes without any.

    Parameters
    ----------
    sigma0 : root of the squared standardised residuals over the redundancy.
    redundancy : above zero, or there is nothing to test.
    level : probability by which right sigmas fail.
    """
    if not redundancy > 0:
        return GlobalTest(sigma0=sigma0, low=0.0, high=np.inf)
    low, high = (float(np.sqrt(chi2.ppf(p, redundancy) / redundancy)) for p in (level / 2, 1 - level / 2))
    return GlobalTest(sigma0=sigma0, low=low, high=high)


def adjust(
    groups: Sequence[Observations[State]],
    start: State,
    names: Sequence[str],
    *,
    update: Callable[[State, ArrayF], State] | None = None,
    loss: str | None = None,
    reject_sigmas: float | None = None,
    inner_constraints: Callable[[State], ArrayF] | None = None,
    max_iterations: int = 50,
    cure: str = "",
) -> Adjusted[State]:
    """Adjust unknowns to all groups of observations.

    Parameters
    ----------
    groups : observations; the names must differ.
    start : approximate state; a vector (u,) if no ``update`` is given.
    names : (u,) names of the unknowns, for messages and the result.
    update : ``update(x, dx)`` puts a small change (u,) on the state.
    loss : ``huber`` for robust weights on the way; None for none. The last adjustment has no weights, so what
        was robust must be rejected: with a loss, ``reject_sigmas`` is `REJECT_SIGMAS` if it is not given.
    reject_sigmas : blocks whose standardised residual is less likely than this many sigmas of a normal error
        (in units of the group's robust scatter where that is larger than stated) are removed, and the rest is
        adjusted again without weights, until nothing changes.
    inner_constraints : (c, u) matrix ``G`` of a state: the change of the unknowns is kept at ``G dx = 0``,
        which fixes the datum of a free network.
    max_iterations : steps allowed for each adjustment.
    cure : what the user can do if the unknowns are undetermined.

    Raises
    ------
    UnobservableError : the unknowns are not determined; names them.
    GeometryError : fewer observations than unknowns, numbers that are not finite, or no convergence.
    """
    kinds = [group.name for group in groups]
    if len(set(kinds)) < len(kinds):
        raise GeometryError(f"groups of observations {kinds}", expected="different names")
    moved = update if update is not None else _plus
    unknowns = tuple(names)
    if loss is not None and reject_sigmas is None:
        reject_sigmas = REJECT_SIGMAS
    masks: list[ArrayB | None] = [None] * len(groups)
    x, steps = _solve(groups, start, unknowns, moved, masks, loss, inner_constraints, max_iterations, cure)
    if reject_sigmas is not None:
        for _ in range(_ROUNDS):
            found = _outliers(groups, x, masks, reject_sigmas)
            unchanged = all(_same(a, b) for a, b in zip(found, masks, strict=True))
            if unchanged and loss is None:
                break
            masks, loss = found, None
            x, more = _solve(groups, x, unknowns, moved, masks, None, inner_constraints, max_iterations, cure)
            steps += more
    return _result(groups, x, unknowns, masks, inner_constraints, steps, cure)


def condition(
    function: Callable[[State, ArrayF], tuple[ArrayF, ArrayF, ArrayF]],
    observed: ArrayF,
    cov_observed: ArrayF,
    *,
    iterations: int = 3,
) -> Callable[[State], Linear]:
    """A model for `Observations` from conditions between unknowns and observations (Gauss-Helmert).

    Parameters
    ----------
    function : ``function(x, l)`` of the state and observations (b, p) gives the contradictions ``g`` (b, k),
        ``A`` (b, k, u), their derivatives by the unknowns, and ``B`` (b, k, p), those by the observations.
    observed : (b, p).
    cov_observed : (b, p, p), or (p, p) for all.
    iterations : how often the observations are adjusted at a state; one is the linearisation at ``observed``.
    """
    cov = np.broadcast_to(cov_observed, (*observed.shape, observed.shape[1]))

    def model(x: State) -> Linear:
        """Residuals linearised at the adjusted observations."""
        v = np.zeros_like(observed)
        for _ in range(iterations):
            g, A, B = function(x, observed + v)
            w = g - np.einsum("bkp,bp->bk", B, v)
            S = B @ cov @ np.swapaxes(B, 1, 2)
            v = -np.einsum("bpq,bkq,bk->bp", cov, B, np.linalg.solve(S, w[:, :, None])[:, :, 0])
        return Linear(residual=w.ravel(), jacobian=A.reshape(w.size, -1), cov=S)

    return model


def prior(mean: ArrayF, cov: ArrayF, at: Sequence[int], unknowns: int) -> Callable[[ArrayF], Linear]:
    """A model that observes some unknowns of a plain vector directly.

    Parameters
    ----------
    mean, cov : (k,) and (k, k).
    at : (k,) places of these unknowns among all (u,).
    unknowns : u.
    """
    J = np.zeros((len(mean), unknowns))
    J[np.arange(len(mean)), np.asarray(at)] = 1.0

    def model(x: ArrayF) -> Linear:
        """Difference from the mean."""
        return Linear(residual=x[np.asarray(at)] - mean, jacobian=J, cov=np.asarray(cov)[None])

    return model


def _plus(x: Any, dx: ArrayF) -> Any:
    return x + dx


def _same(a: ArrayB | None, b: ArrayB | None) -> bool:
    if a is None or b is None:
        other = a if b is None else b
        return other is None or bool(other.all())
    return bool(np.array_equal(a, b))


def _solve(
    groups: Sequence[Observations[State]],
    x: State,
    names: tuple[str, ...],
    update: Callable[[State, ArrayF], State],
    masks: list[ArrayB | None],
    loss: str | None,
    inner: Callable[[State], ArrayF] | None,
    max_iterations: int,
    cure: str,
) -> tuple[State, int]:
    here = normal_equations(groups, x, len(names), masks, loss)
    damping = 0.0
    for count in range(1, max_iterations + 1):
        dx = damped_step(here, names, inner(x) if inner else None, damping, cure)
        gain = float(dx @ here.n)
        tried = update(x, -dx)
        there = normal_equations(groups, tried, len(names), masks, loss)
        # The covariance of conditions depends on the state a little: 1e-6 of the cost is no growth.
        better = np.isfinite(there.cost) and there.cost <= here.cost * (1 + 1e-6) + 1e-9
        if better:
            x, here, damping = tried, there, damping / 10 if damping > 1e-6 else 0.0
            if gain < _CONVERGED * max(1.0, here.cost / max(len(names), 1)) and damping < 1e-3:
                return x, count
        elif gain < _CONVERGED * max(1.0, here.cost):
            return x, count
        else:
            damping = max(1e-4, 10 * damping)
            if damping > 1e12:
                break
    raise GeometryError(
        f"the adjustment of {len(names)} unknowns did not converge in {max_iterations} steps",
        expected="approximate values near enough, and observations that fit the model",
        cure=cure or "Check the approximate values and look for gross errors in the observations",
    )


def _outliers(
    groups: Sequence[Observations[State]], x: State, masks: list[ArrayB | None], reject_sigmas: float
) -> list[ArrayB | None]:
    found: list[ArrayB | None] = []
    for group, mask in zip(groups, masks, strict=True):
        r, _, k = whitened(group.model(x), group.name)
        length = np.sqrt(np.square(r).reshape(-1, k).sum(axis=1))
        kept = length if mask is None or not mask.any() else length[mask]
        middle, limit = _usual_lengths(k, reject_sigmas)
        scatter = max(1.0, float(np.median(kept) / middle)) if len(kept) else 1.0
        found.append(length <= scatter * limit)
    return found


@cache
def _usual_lengths(k: int, sigmas: float) -> tuple[float, float]:
    """Median of the lengths of k normal errors, and the one that is as unlikely as so many sigmas of one."""
    return float(np.sqrt(chi2.median(k))), float(np.sqrt(chi2.isf(chi2.sf(sigmas**2, 1), k)))


@cache
def _huber_limit(k: int) -> float:
    """Length of k normal errors beyond which weights fall: as unlikely as the limit is for one."""
    return HUBER_LIMIT if k == 1 else float(np.sqrt(chi2.ppf(chi2.cdf(HUBER_LIMIT**2, 1), k)))


def _result(
    groups: Sequence[Observations[State]],
    x: State,
    names: tuple[str, ...],
    masks: list[ArrayB | None],
    inner: Callable[[State], ArrayF] | None,
    steps: int,
    cure: str,
) -> Adjusted[State]:
    u = len(names)
    here = normal_equations(groups, x, u, masks, None)
    G = inner(x) if inner else None
    cov = _covariance(here.N, names, G, cure)
    residuals, lengths, used = {}, {}, {}
    sigma0: dict[str, float] = {}
    spare: dict[str, float] = {}
    total, m = 0.0, 0
    for i, (group, mask) in enumerate(zip(groups, masks, strict=True)):
        r, J, k = whitened(here.parts[i], group.name)
        keep: AnyArray = np.ones(len(here.lengths[i]), dtype=np.bool_) if mask is None else mask
        rows = np.repeat(keep, k)
        known = here.parts[i].normal if mask is None else None
        if known is not None:
            taken = float(np.sum(known * cov))
        else:
            Jk = J[rows]
            product = Jk @ cov
            taken = float(Jk.multiply(product).sum() if is_sparse(Jk) else np.sum(product * Jk))
        squares = float(np.square(r[rows]).sum())
        spare[group.name] = float(rows.sum()) - taken
        sigma0[group.name] = float(np.sqrt(squares / spare[group.name])) if spare[group.name] > 1e-9 else 0.0
        residuals[group.name] = here.parts[i].residual
        lengths[group.name] = here.lengths[i]
        used[group.name] = keep
        total += squares
        m += int(rows.sum())
    redundancy = m - u + (0 if G is None else len(G))
    if redundancy < 0:
        raise GeometryError(
            f"{m} observations for {u} unknowns", expected="more observations than unknowns", cure=cure
        )
    return Adjusted(
        x=x,
        cov=cov,
        names=names,
        sigma0_squared=total / redundancy if redundancy > 0 else 0.0,
        redundancy=float(redundancy),
        residuals=residuals,
        standardised=lengths,
        used=used,
        group_sigma0=sigma0,
        group_redundancy=spare,
        n_iterations=steps,
    )


def _covariance(N: ArrayF, names: tuple[str, ...], G: ArrayF | None, cure: str) -> ArrayF:
    """Covariance (u, u) from the normal matrix, in the datum of the constraints ``G`` if there are some.

    Raises
    ------
    UnobservableError : the unknowns are not determined.
    """
    scale = _scale(N, names, G, cure)
    Ns = N / np.outer(scale, scale)
    Gs = None if G is None else orthonormal(G / scale)
    try:
        factor, _ = linalg.cho_factor(Ns if Gs is None else Ns + Gs.T @ Gs, lower=True)
    except np.linalg.LinAlgError:
        check_rank(N, names, G, cure)
        raise
    inverse, _ = linalg.lapack.dpotri(factor, lower=1)
    inverse = np.tril(inverse) + np.tril(inverse, -1).T
    # The norm of the inverse bounds the smallest eigenvalue from below: beyond doubt none is zero.
    if not np.linalg.norm(inverse) * RANK_TOLERANCE < 1.0:
        check_rank(N, names, G, cure)
    cov = inverse / np.outer(scale, scale)
    if G is not None and Gs is not None:
        # Any generalised inverse, brought to the datum of the constraints: S cov S^T, S = 1 - E (G E)^-1 G
        # (S-transformation, Baarda 1973). The columns of E are the directions that the observations leave
        # free: from N E = 0 follows (N + G^T G) E = G^T (G E).
        E = linalg.cho_solve((factor, True), Gs.T) / scale[:, None]
        to_datum = np.linalg.solve((G @ E).T, E.T)
        cov = cov - to_datum.T @ (G @ cov)
        cov = cov - (cov @ G.T) @ to_datum
    return np.asarray((cov + cov.T) / 2)


# ---------------------------------------------------------------- normal equations: weights, steps, and what
# they determine


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


@dataclass(slots=True)
class Normal:
    """Normal equations at a state: matrix, right side, cost; by group, lengths of blocks, and parts."""

    N: ArrayF
    n: ArrayF
    cost: float
    lengths: list[ArrayF]
    parts: list[Linear]


def normal_equations(
    groups: Sequence[Observations[State]], x: State, u: int, masks: Sequence[ArrayB | None], loss: str | None
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
            limit = _huber_limit(k)
            far = length > limit
            inside = np.where(far, 2 * limit * length - limit**2, inside)
            root = root * np.sqrt(np.where(far, limit / np.maximum(length, limit), 1.0))
        cost += float(inside[root > 0].sum())
        w = np.repeat(root, k)
        Jw = scaled_rows(J, w)
        if part.normal is not None and mask is None and loss is None:
            N += part.normal
        else:
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
