"""One estimate of a camera's clock with a fixed choice of images: unknowns, variance of the jitter, tests.

The unknowns follow from least squares with the full covariance of all residuals
(`thalweg.core.adjustment.solve`),
the variance of the jitter from restricted maximum likelihood; both in turns. The slopes of the track are the
derivatives. They come from a wider fit than the track itself, so that their noise is uncorrelated with its
errors; the solution is where the residuals are orthogonal to them, which is not exactly the least sum of
squares.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.linalg import block_diag, solve_triangular
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from thalweg.clocks.camera.offset_observations import OffsetModel, OffsetState, Stacked
from thalweg.clocks.ties.model import QUARTZ_DRIFT
from thalweg.core.adjustment.solve import Linear, Observations, adjust
from thalweg.core.types import ArrayF

# ---------------------------------------------------------------- A variance component by restricted maximum
# likelihood, and the random effects that it belongs to
#
# ``y = A b + Z u + e`` with ``Cov e = V`` known and ``u`` independent with one unknown variance ``s``. The
# restricted likelihood (Patterson and Thompson 1971) does not depend on ``b``. With ``P = V^-1 - V^-1 A (A^T
# V^-1 A)^-1 A^T V^-1`` and the eigenvalues ``l`` of ``Z^T P Z`` it is a sum over them, so that one
# decomposition serves every ``s``.


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


# ---------------------------------------------------------------- offset fit


_TURNS: Final = 30
_SETTLED_S: Final = 1e-5
_FIRST_JITTER_S: Final = 0.02
_UNITS: Final = np.array([1e-3, 1e-6])
"""Offset in ms and drift in ppm have numbers of one size."""
_HELD: Final = 1e-12
"""Sigma of a drift that is held at zero."""
_LEVER_HELD_M: Final = 1e-5
"""Added to an antenna that is stated without a sigma; a matrix of zeros could not be inverted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetOptions:
    """How the offset is estimated.

    Parameters
    ----------
    largest_offset_s : the offset is looked for between minus and plus this.
    sigma_drift : prior standard deviation of the drift; 0 holds it at zero.
    jitter_s : standard deviation of the jitter of an image; None: estimated.
    largest_lever_m : no antenna is farther from the camera.
    largest_sigma_s : an offset that is less certain than this is refused.
    lever_m, cov_lever_m2 : (3,) antenna in ccs and its covariance (3, 3), if known from elsewhere.
    """

    largest_offset_s: float = 30.0
    largest_lever_m: float = 3.0
    sigma_drift: float = QUARTZ_DRIFT
    jitter_s: float | None = None
    largest_sigma_s: float = 0.02
    lever_m: ArrayF | None = None
    cov_lever_m2: ArrayF | None = None


@dataclass(slots=True, kw_only=True)
class OffsetFit:
    """One estimate with a fixed choice of images.

    ``settled`` False if the turns did not come to an end; ``cov`` (u, u) of the unknowns; ``V0`` (m, m) of
    the residuals without jitter; ``effects_s`` (n,) predicted jitter of each image; ``tests`` (n,) statistic
    of an image's own error, chi-squared with 3 or 6.
    """

    model: OffsetModel
    state: OffsetState
    cov: ArrayF
    jitter: Component
    stacked: Stacked
    V0: ArrayF
    effects_s: ArrayF
    sigma0_squared: float
    redundancy: float
    tests: ArrayF
    settled: bool


def fit_offset(model: OffsetModel, state: OffsetState, o: OffsetOptions) -> OffsetFit:
    """Unknowns and the jitter's variance in turns, with a fixed choice of images.

    Raises
    ------
    UnobservableError : an unknown is not determined at all.
    """
    names = model.names
    if model.ins is not None and not (state.oriented and len(state.slow) == len(names) - 8):
        R_ins = model.ins.at(model.times(state))[0]
        between = Rotation.from_matrix(np.swapaxes(R_ins, 1, 2) @ model.poses.R_wcs_ccs)
        R_ics_ccs, slow = between.mean().as_matrix(), np.zeros(len(names) - 8)
        state = replace(state, R_ics_ccs=R_ics_ccs, slow=slow, oriented=True)
    variance = _FIRST_JITTER_S**2 if o.jitter_s is None else o.jitter_s**2
    component = Component(variance=variance, sigma_variance=0.0)
    for _ in range(_TURNS):
        stacked = model.observe(state)
        V0, Z = model.covariance(state, stacked.between), _effects(stacked)
        known = _known(o, state, len(names))
        if o.jitter_s is None:
            component = _jitter(stacked, Z, V0, known)
        root = np.asarray(np.linalg.cholesky(V0 + component.variance * Z @ Z.T))
        white = solve_triangular(root, np.column_stack([stacked.residual, stacked.jacobian]), lower=True)
        camera = Linear(residual=white[:, 0], jacobian=white[:, 1:], cov=np.ones(len(white)))
        groups = [Observations("camera", _linear(camera))]
        groups += [Observations(name, _linear(part)) for name, part in known.items()]
        adjusted = adjust(groups, np.zeros(len(names)), names)
        state = state.moved(adjusted.x)
        settled = abs(component.variance - variance) < 1e-3 * variance + 1e-10
        settled = settled and abs(adjusted.x[0]) < _SETTLED_S
        variance = component.variance
        if settled:
            break
    stacked = model.observe(state)
    tests, effects, P = _tests(stacked, root)
    return OffsetFit(
        model=model,
        state=state,
        cov=_without_noise(adjusted.cov, P, model, stacked),
        jitter=component,
        stacked=stacked,
        V0=V0,
        effects_s=-component.variance * effects,
        sigma0_squared=adjusted.sigma0_squared,
        redundancy=adjusted.redundancy,
        tests=tests,
        settled=settled,
    )


def _linear(part: Linear) -> Callable[[ArrayF], Linear]:
    """A model that stays linear where it was linearised: the turns around it do the rest."""

    def model(dx: ArrayF) -> Linear:
        """Residuals after a small change."""
        return Linear(residual=part.residual + part.jacobian @ dx, jacobian=part.jacobian, cov=part.cov)

    return model


def _known(o: OffsetOptions, state: OffsetState, u: int) -> dict[str, Linear]:
    """Prior knowledge as observations: of the drift, and of the antenna if it is given."""
    one = np.zeros((1, u))
    one[0, 1] = 1.0
    sigma = max(o.sigma_drift, _HELD)
    parts = {"drift": Linear(residual=np.array([state.drift]), jacobian=one, cov=np.array([sigma**2]))}
    if o.lever_m is not None and o.cov_lever_m2 is not None:
        three = np.zeros((3, u))
        three[:, 2:5] = np.eye(3)
        cov = (np.asarray(o.cov_lever_m2, dtype=np.float64) + _LEVER_HELD_M**2 * np.eye(3))[None]
        residual = state.lever_m - np.asarray(o.lever_m, dtype=np.float64)
        parts["antenna"] = Linear(residual=residual, jacobian=three, cov=cov)
    return parts


def _jitter(stacked: Stacked, Z: ArrayF, V0: ArrayF, known: dict[str, Linear]) -> Component:
    """Variance of the jitter; prior knowledge stands below as further rows without jitter."""
    parts = list(known.values())
    y = np.concatenate([stacked.residual, *(part.residual for part in parts)])
    A = np.vstack([stacked.jacobian, *(part.jacobian for part in parts)])
    blocks = [part.cov[0] if part.cov.ndim == 3 else np.diag(part.cov) for part in parts]
    return estimate_component(
        y, A, np.vstack([Z, np.zeros((len(y) - len(Z), Z.shape[1]))]), block_diag(V0, *blocks)
    )


def _effects(stacked: Stacked) -> ArrayF:
    """Derivatives (m, n) of the residuals by the jitter of each image."""
    Z = np.zeros((len(stacked.motion), int(stacked.image.max()) + 1))
    Z[np.arange(len(Z)), stacked.image] = stacked.motion
    return Z


def _tests(stacked: Stacked, root: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Statistic (n,) of each image's own gross error, chi-squared with 3 or 6, ``Z^T P y`` (n,), ``P`` (m,
    m).

    ``root`` is the Cholesky factor of the residuals' covariance.
    """
    inverse = solve_triangular(root, np.eye(len(root)), lower=True, check_finite=False)
    white = inverse @ np.column_stack([stacked.jacobian, stacked.residual])
    Q, _ = np.linalg.qr(white[:, :-1])
    reduced = inverse - Q @ (Q.T @ inverse)
    P = reduced.T @ reduced
    Py = reduced.T @ white[:, -1]
    n = int(stacked.image.max()) + 1
    size = len(root) // n
    rows = np.argsort(stacked.image, kind="stable").reshape(n, size)
    blocks = P[rows[:, :, None], rows[:, None, :]]
    w = Py[rows]
    statistic = np.einsum("ni,ni->n", w, np.linalg.solve(blocks, w[:, :, None])[:, :, 0])
    return statistic, _effects(stacked).T @ Py, P


def _without_noise(cov: ArrayF, P: ArrayF, model: OffsetModel, stacked: Stacked) -> ArrayF:
    """Covariance (u, u) of the unknowns if the slopes of the track had no noise of their own.

    Noise ``n`` of the velocities ``v`` (and of angular velocities) seems to tell of time: ``E (v + n)^T P (v
    + n) = v^T P v + tr(P Cov n)``. With ``N`` the information about offset and drift that was found and
    ``B`` that without noise, errors of the estimate are ``B^-1 N B^-1``. Where nothing but noise is left,
    the variance of the offset is infinite.
    """
    noise = model.track.velocity_covariance(stacked.between)
    if model.ins is not None:
        noise = block_diag(noise, model.ins.rate_covariance(stacked.between.t_gps_s))
    since = (model.poses.t_device_s - model.reference_s)[stacked.image]
    product = P * noise
    told = np.array([
        [product.sum(), (product @ since).sum()],
        [(product @ since).sum(), since @ product @ since],
    ])  # fmt: skip
    found = np.linalg.inv(cov[:2, :2])
    left = found - told
    if np.linalg.eigvalsh(left * np.outer(_UNITS, _UNITS))[0] <= 0:
        out = cov.copy()
        out[0, 0] = np.inf
        return out
    inverse = np.linalg.inv(left)
    true = inverse @ found @ inverse
    to_others = cov[:, :2] @ found
    return np.asarray(cov + to_others @ (true - cov[:2, :2]) @ to_others.T)


def image_times(fit: OffsetFit, scale: float, o: OffsetOptions) -> tuple[ArrayF, ArrayF, float, float]:
    """GPS time of each image with its own jitter (n,), sigma (n,), and mean offset of the run with its sigma.

    Henderson's mixed model equations: the jitters join the unknowns, with their variance as prior knowledge.
    What the noise of the slopes adds to the covariance of offset and drift (see `_without_noise`) goes on
    into all that was estimated with them: an offset that is wrong is made up for by the jitters, so that the
    mean time of the images is less uncertain than offset and jitters apart.
    """
    model, stacked = fit.model, fit.stacked
    Z, u = _effects(stacked), stacked.jacobian.shape[1]
    n, s = Z.shape[1], max(fit.jitter.variance, 1e-14)
    root = np.linalg.cholesky(fit.V0)
    white = solve_triangular(root, np.column_stack([stacked.jacobian, Z, stacked.residual]), lower=True)
    N = white[:, :-1].T @ white[:, :-1]
    for part in _known(o, fit.state, u).values():
        weight = np.linalg.inv(part.cov[0]) if part.cov.ndim == 3 else np.diag(1.0 / part.cov)
        N[:u, :u] += part.jacobian.T @ weight @ part.jacobian
    N[np.arange(u, u + n), np.arange(u, u + n)] += 1.0 / s
    inverse = np.linalg.inv(N)
    since = model.poses.t_device_s - model.reference_s
    best, run = model.times(fit.state) + fit.effects_s, float(fit.state.offset_s + fit.effects_s.mean())
    if not np.isfinite(fit.cov[:2, :2]).all():
        return best, np.full(n, np.inf), run, float("inf")
    added = fit.cov[:2, :2] - inverse[:2, :2]
    with_clock = inverse[:, :2] @ np.linalg.inv(inverse[:2, :2])
    inverse += with_clock @ added @ with_clock.T
    inverse *= scale
    to_time = np.zeros((n, u + n))
    to_time[:, 0], to_time[:, 1] = 1.0, since
    to_time[np.arange(n), u + np.arange(n)] = 1.0
    cov = to_time @ inverse @ to_time.T
    mean = to_time.mean(axis=0)
    return best, np.sqrt(np.diag(cov)), run, float(np.sqrt(mean @ inverse @ mean))
