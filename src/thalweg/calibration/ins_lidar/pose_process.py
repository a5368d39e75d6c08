"""How large the errors of the poses were in a run: variance components, correlation times, white share.

The points on the cones show the errors of the poses but for a constant. Their likelihood with all unknowns
integrated out (restricted maximum likelihood, Patterson and Thompson 1971; Koch 1999, sec. 3.6)::

    -2 log L(z) = log|N + Q| + log|S| - log|Q| + Omega

with the normal matrix ``N`` of the errors, their inverse prior covariance ``Q(z)``, the reduced normal
matrix ``S`` of the border and the weighted squares ``Omega`` of all residuals. What is stated is prior
knowledge with a width, and ``z`` counts its widths: sizes by a factor of `SIZE_SPREAD`, correlation times by
`TIME_SPREAD`, the white share by `WHITE_SPREAD` on its logit. The posterior has the density
``p(z) ~ exp(-c(z) / 2)`` with ``c = -2 log L + z^T z``.

**What the run leaves open enlarges the covariance.** With the mount ``x(z)`` and its covariance ``C(z)`` for
given processes, the law of total covariance about the estimate ``x(z0)`` at the minimum ``z0`` of ``c`` is::

    Cov(x) = sum w_i (C(z_i) + d_i d_i^T),    d_i = x(z_i) - x(z0),    w_i ~ p(z_i) / q(z_i),    sum w_i = 1

The ``z_i`` come from a normal proposal ``q`` about ``z0`` whose covariance is that of Laplace's
approximation, ``2 (d^2c / dz^2)^-1``, times `_WIDER`: a fixed quasi-random sequence (Owen 1998), so that
equal runs give equal results. Where a run cannot tell a parameter its posterior is the prior, and the prior's
width counts.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, TypeAlias

import numpy as np
from scipy.optimize import minimize
from scipy.stats import qmc

from thalweg.calibration.ins_lidar.model import MOUNT, Step
from thalweg.calibration.ins_lidar.pose_errors import SLOW, BorderedNormals, Knots, PoseErrors
from thalweg.core.types import ArrayF

GroupSigmas: TypeAlias = dict[str, float]
"""By group of observations: root of the weighted squares of its residuals over its redundancy; expected 1."""

SIZE_SPREAD: Final = 2.0
"""Stated sizes may be wrong by this factor, as one sigma of the logarithm."""

TIME_SPREAD: Final = 3.0
"""Stated correlation times may be wrong by this factor, as one sigma of the logarithm."""

WHITE_SPREAD: Final = 5.0
"""The white share ``w``: its ``w / (1 - w)`` may be wrong by this factor, as one sigma of the logarithm."""

NAMES: Final = (
    "position_size", "tilt_size", "heading_size", "position_time", "tilt_time", "heading_time", "white_share",
)  # fmt: skip
"""Parameters of the processes; tilt is roll and pitch. Without a white part the last one is left out."""

DETERMINED: Final = 0.5
"""A parameter whose posterior is narrower than this share of its prior counts as determined by the run."""

_KINDS: Final = {
    "size": ("size", SIZE_SPREAD), "time": ("time", TIME_SPREAD), "share": ("share", WHITE_SPREAD)
}  # fmt: skip
_WIDER: Final = 1.5
_NOTHING: Final = 1e-4
_DRAWS: Final = 64
_STEP: Final = 0.25
_FARTHEST: Final = 4.0
_GROUPS: Final = {"position": slice(0, 3), "attitude": slice(3, 6)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Processes:
    """What a run says of the errors of its poses.

    Parameters
    ----------
    stated, errors : as stated, and at the maximum of the posterior.
    z : (h,) that maximum, in widths of the prior.
    draws : (d, h) of the posterior with their weights (d,), sum 1.
    """

    stated: PoseErrors
    errors: PoseErrors
    z: ArrayF
    draws: ArrayF
    weights: ArrayF

    @property
    def names(self) -> tuple[str, ...]:
        """Names (h,) of the parameters."""
        return NAMES[: len(self.z)]

    @property
    def width(self) -> ArrayF:
        """Standard deviations (h,) of the posterior in widths of the prior: 1 where the run says nothing."""
        mean = self.weights @ self.draws
        return np.asarray(np.sqrt(self.weights @ np.square(self.draws - mean)))

    @property
    def effective(self) -> float:
        """Number of draws that their weights leave, ``1 / sum w^2``."""
        return float(1.0 / np.square(self.weights).sum())

    def undetermined(self) -> tuple[str, ...]:
        """Parameters for which the width of the prior counts, see `DETERMINED`."""
        return tuple(name for name, width in zip(self.names, self.width, strict=True) if width > DETERMINED)

    def facts(self) -> dict[str, dict[str, Any]]:
        """By name: stated value, its factor, estimate, range of 95 %, and whether the run told it.

        Sizes in metres and degrees (of the axis that errs most), times in seconds.
        """
        stated, found = _values(self.stated), _values(self.errors)
        out = {}
        for i, (name, width) in enumerate(zip(self.names, self.width, strict=True)):
            away = 1.96 * width * np.eye(len(self.z))[i]
            low, high = (_values(changed(self.stated, self.z + side * away))[name] for side in (-1, 1))
            kind, spread = _KINDS[name.rpartition("_")[2]]
            out[name] = {
                "kind": kind, "stated": stated[name], "stated_within_factor": spread,
                "estimated": found[name], "low": low, "high": high,
                "told_by_survey": bool(width <= DETERMINED),
            }  # fmt: skip
        return out


def changed(stated: PoseErrors, z: ArrayF) -> PoseErrors:
    """Processes whose parameters lie ``z`` (h,) widths of the prior from what is stated.

    Examples
    --------
    >>> stated = PoseErrors(sigma_position_m=np.full(3, 0.02), sigma_attitude_rad=np.full(3, 1e-3))
    >>> other = changed(stated, np.array([1.0, 0, 0, -1.0, 0, 0, 0]))
    >>> float(other.sigma_position_m[0]), round(other.position_time_s, 3)
    (0.04, 3.333)
    """
    position, tilt, heading = SIZE_SPREAD ** z[:3]
    times = stated.times_s[[0, 3, 5]] * TIME_SPREAD ** z[3:6]
    share = stated.white_share
    if share > 0:
        share = 1.0 / (1.0 + (1.0 / share - 1.0) * WHITE_SPREAD ** -z[6])
    return replace(
        stated,
        sigma_position_m=stated.sigma_position_m * position,
        sigma_attitude_rad=stated.sigma_attitude_rad * np.array([tilt, tilt, heading]),
        position_time_s=float(times[0]),
        attitude_time_s=float(times[1]),
        heading_time_s=float(times[2]),
        white_share=float(share),
    )


def estimate_processes(step: Step, knots: Knots, stated: PoseErrors) -> Processes:
    """The errors of the poses that a run and what is stated leave possible.

    Parameters
    ----------
    step : normal equations and prior knowledge of the border.
    knots : where the errors are unknowns.
    stated : centre of the prior; a white share of 0 says that there is none and is kept.
    """

    def cost(z: ArrayF) -> float:
        """``-2 log L`` and the prior."""
        band, logdet = knots.prior(changed(stated, z))
        found = step.normals.solve(band, step.prior_border)
        return float(found.logdet - logdet + found.omega + z @ z)

    h = len(NAMES) if stated.white_share > 0 else len(NAMES) - 1
    found = minimize(
        cost, np.zeros(h), method="L-BFGS-B", bounds=[(-_FARTHEST, _FARTHEST)] * h,
        options={"eps": 1e-3, "ftol": 1e-7, "gtol": 1e-2},
    )  # fmt: skip
    z0 = np.asarray(found.x)
    root = _root_of_laplace(cost, z0, float(found.fun)) * np.sqrt(_WIDER)
    normal = qmc.MultivariateNormalQMC(np.zeros(h), rng=np.random.default_rng(h)).random(_DRAWS)
    draws = z0 + normal @ root.T
    logs = np.array([-0.5 * cost(z) for z in draws]) + 0.5 * np.sum(normal**2, axis=1)
    weights = np.exp(logs - logs.max())
    return Processes(
        stated=stated, errors=changed(stated, z0), z=z0, draws=draws, weights=weights / weights.sum()
    )


def _root_of_laplace(cost: Callable[[ArrayF], float], z: ArrayF, here: float) -> ArrayF:
    """Matrix ``L`` (h, h) with ``L L^T = 2 (d^2c / dz^2)^-1``, no wider than the prior.

    Differences over a quarter of a prior's width see the shape of the minimum, not its roughness.
    """
    h = len(z)
    unit = _STEP * np.eye(h)
    more, less = ([cost(z + sign * e) for e in unit] for sign in (1, -1))
    H = np.diag(np.array(more) + np.array(less) - 2 * here)
    for i in range(h):
        for j in range(i):
            both = cost(z + unit[i] + unit[j]) + cost(z - unit[i] - unit[j])
            H[i, j] = H[j, i] = 0.5 * (both - more[i] - more[j] - less[i] - less[j] + 2 * here)
    values, vectors = np.linalg.eigh(H / (2 * _STEP**2))
    return np.asarray(vectors / np.sqrt(np.maximum(values, 1.0)))


def total_covariance(
    normals: BorderedNormals, prior_border: ArrayF, knots: Knots, processes: Processes
) -> ArrayF:
    """Covariance (6, 6) of the mount over all processes that a run leaves possible.

    Parameters
    ----------
    normals, prior_border : of a `Step`.
    knots : where the errors are unknowns.
    processes : from `estimate_processes`.
    """

    def mount(errors: PoseErrors) -> tuple[ArrayF, ArrayF]:
        """Step (6,) of the mount and its covariance."""
        found = normals.solve(knots.prior(errors)[0], prior_border)
        return found.border[MOUNT], found.cov_border[MOUNT, MOUNT]

    at_best, _ = mount(processes.errors)
    total = np.zeros((6, 6))
    for weight, z in zip(processes.weights, processes.draws, strict=True):
        if weight < _NOTHING:
            continue
        x, cov = mount(changed(processes.stated, z))
        total += weight * (cov + np.outer(x - at_best, x - at_best))
    return total


def _values(errors: PoseErrors) -> dict[str, float]:
    """Parameters by name, in metres, degrees, seconds."""
    attitude = np.rad2deg(errors.sigma_attitude_rad)
    values: Sequence[float] = (
        errors.sigma_position_m.max(), attitude[:2].max(), attitude[2], *errors.times_s[[0, 3, 5]],
        errors.white_share,
    )  # fmt: skip
    return {name: float(value) for name, value in zip(NAMES, values, strict=True)}


def group_sigmas(step: Step, knots: Knots, errors: PoseErrors) -> GroupSigmas:
    """Sizes of the residuals of points, positions and attitudes, and of all, in units of what is stated.

    The redundancy of a group is its number minus ``tr(P_group Q_xx)``, and that trace is the derivative of
    the log determinant of the normal equations by the group's weight.
    """
    band, _ = knots.prior(errors)
    normals, solution = step.normals, step.solution
    e = solution.errors
    out: GroupSigmas = {}
    taken, squares = 0.0, 0.0
    parts = _prior_parts(knots, band)
    h = 1e-3
    for name, part in parts.items():
        n = int(np.count_nonzero(part[0]))
        square = _banded_square(part, e)
        more = normals.solve(band + h * part, step.prior_border).logdet
        less = normals.solve(band - h * part, step.prior_border).logdet
        trace = (more - less) / (2 * h)
        out[name] = float(np.sqrt(square / max(n - trace, 1e-9)))
        taken, squares = taken + trace, squares + square
    z = solution.border[6:]
    border = np.diag(solution.cov_border)[6:].sum()
    unknowns = knots.n + len(solution.border)
    of_points = unknowns - taken - border
    left = solution.omega - squares - float(z @ z)
    out["points"] = float(np.sqrt(left / (normals.n - of_points)))
    out["all"] = float(np.sqrt(solution.omega / (normals.n - 6)))
    return out


def _prior_parts(knots: Knots, band: ArrayF) -> dict[str, ArrayF]:
    """Prior weights of positions (slow), attitudes, and epochs (fast)."""
    place = np.arange(knots.n) % knots.stride
    masks = {name: (place >= s.start) & (place < s.stop) for name, s in _GROUPS.items()}
    if knots.fast:
        masks["epochs"] = place >= SLOW
    return {name: np.where(mask, band, 0.0) for name, mask in masks.items()}


def _banded_square(band: ArrayF, x: ArrayF) -> float:
    """``x^T A x`` of a symmetric matrix in lower banded form."""
    total = float(np.sum(band[0] * x**2))
    for k in np.flatnonzero(np.any(band[1:] != 0, axis=1)) + 1:
        total += 2 * float(np.sum(band[k, : len(x) - k] * x[: len(x) - k] * x[k:]))
    return total
