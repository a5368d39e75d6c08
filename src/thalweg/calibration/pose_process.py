"""How large the errors of the poses were in a run: variance components and correlation times.

The points on the cones show the errors of the poses but for a constant. Their likelihood with all unknowns
integrated out (restricted maximum likelihood, Patterson and Thompson 1971; Koch 1999, sec. 3.6)::

    -2 log L = log|N + Q| + log|S| - log|Q| + Omega

with the normal matrix ``N`` of the errors, their inverse prior covariance ``Q``, the reduced normal matrix
``S`` of the border and the weighted squares ``Omega`` of all residuals. A run holds few correlation times, so
what is stated stays as prior knowledge with a factor of `SPREAD`.
"""

from typing import Final, TypeAlias

import numpy as np
from scipy.optimize import minimize

from thalweg.calibration.ins_lidar_model import Step
from thalweg.calibration.pose_errors import SLOW, Knots, PoseErrors
from thalweg.core.types import ArrayF

GroupSigmas: TypeAlias = dict[str, float]
"""By group of observations: root of the weighted squares of its residuals over its redundancy; expected 1."""

SPREAD: Final = 2.0
"""Stated sizes and correlation times may be wrong by this factor, as one sigma of its logarithm."""

_GROUPS: Final = {"position": slice(0, 3), "attitude": slice(3, 6)}


def estimate_processes(step: Step, knots: Knots, errors: PoseErrors) -> PoseErrors:
    """The errors of the poses whose sizes and correlation times explain a run best.

    Parameters
    ----------
    step : normal equations and prior knowledge of the border.
    knots : where the errors are unknowns.
    errors : what is stated.
    """

    def scaled(x: ArrayF) -> PoseErrors:
        """Errors for the logarithms of four factors: two sizes, two times."""
        f = np.exp(x)
        return PoseErrors(
            sigma_position_m=errors.sigma_position_m * f[0],
            sigma_attitude_rad=errors.sigma_attitude_rad * f[1],
            position_time_s=errors.position_time_s * f[2],
            attitude_time_s=errors.attitude_time_s * f[3],
            white_share=errors.white_share,
            epoch_s=errors.epoch_s,
            knot_s=errors.knot_s,
        )

    def cost(x: ArrayF) -> float:
        """-2 log L and the prior of the factors."""
        band, logdet = knots.prior(scaled(x))
        found = step.normals.solve(band, step.prior_border)
        return float(found.logdet - logdet + found.omega + np.sum((x / np.log(SPREAD)) ** 2))

    found = minimize(
        cost, np.zeros(4), method="Nelder-Mead",
        options={"initial_simplex": 0.4 * np.vstack([np.zeros(4), np.eye(4)]), "xatol": 0.02, "fatol": 0.02},
    )  # fmt: skip
    return scaled(found.x)


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
