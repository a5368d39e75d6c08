"""Covariance of a calibration with what it held fixed, and what its correlations mean for measured depths.

Parameters that were known beforehand and held fixed have errors ``o``; those of the estimates follow them
("consider" covariance, Schmidt 1966)::

    dx = N^-1 (J^T W e + P^T S_k^-1 k - J^T W J_o o),     B = -N^-1 J^T W J_o,   K = N^-1 P^T S_k^-1
    Cov(x) = N^-1 + K S_ko B^T + B S_ok K^T + B S_o B^T,  Cov(x, o) = K S_ko + B S_o

with the errors e of the image and k of what was known beforehand and estimated jointly. Fixed and estimated
parameters are then correlated, which shrinks the sigma of a measured depth five to ten times: a calibration
absorbs errors of its fixed parameters, and must keep the memory of it.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from thalweg.core.adjustment.normal_equations import scaled_rows, whitened
from thalweg.core.adjustment.solve import Adjusted
from thalweg.core.types import ArrayF
from thalweg.lightsheet.calibration.model import KNOWN, Problem
from thalweg.lightsheet.optics.derivatives import sheet_derivatives
from thalweg.lightsheet.optics.light_path import fan_angles, sheet_in_water
from thalweg.lightsheet.optics.projection import project
from thalweg.lightsheet.optics.sensor import Sensor


def considered_covariance(
    problem: Problem, adjusted: Adjusted[ArrayF], fixed: Sequence[str], cov_beforehand: ArrayF
) -> ArrayF:
    """Joint covariance of unknowns and fixed parameters.

    Parameters
    ----------
    problem, adjusted : a finished adjustment.
    fixed : (o,) names of the parameters that were held fixed and have a sigma.
    cov_beforehand : covariance of all parameters of ``problem.names`` as known beforehand.

    Returns
    -------
    (u + o, u + o), unknowns first.
    """
    u, x = len(problem.free), adjusted.x
    at = [problem.names.index(name) for name in fixed]
    S_o = cov_beforehand[np.ix_(at, at)]
    wide = problem.with_free((*problem.free, *fixed))
    N_o = np.zeros((u, len(fixed)))
    for group in wide.observations():
        _, J, k = whitened(group.model(x), group.name)
        used = np.repeat(adjusted.used[group.name], k)
        J = np.asarray(scaled_rows(J, used.astype(np.float64)))
        N_o += J[:, :u].T @ J[:, u:]
    B = -adjusted.cov @ N_o
    cross = B @ S_o
    cov = adjusted.cov + B @ S_o @ B.T
    if problem.known:
        group = next(g for g in problem.observations() if g.name == KNOWN)
        P = np.asarray(group.model(x).jacobian)
        K = adjusted.cov @ np.linalg.solve(problem.cov_known, P).T
        S_ko = cov_beforehand[np.ix_([problem.names.index(name) for name in problem.known], at)]
        mixed = K @ S_ko
        cross = cross + mixed
        cov = cov + mixed @ B.T + B @ mixed.T
    joint = np.block([[cov, cross], [cross.T, S_o]])
    return np.asarray((joint + joint.T) / 2)


def depth_sigmas(sensor: Sensor, depths_mm: Sequence[float], *, n: int = 41) -> pd.DataFrame:
    """Sigma of a measured depth that the sensor's covariance leaves, without the noise of the line.

    Parameters
    ----------
    sensor : with its covariance.
    depths_mm : below the outer face.
    n : sub-beams that are tried at each depth; those inside the picture count.

    Returns
    -------
    depth_mm, least_mm, median_mm, most_mm with all correlations, and the same without them (P4 6.6 drops
    them).
    """
    rows = []
    fans = fan_angles(sensor, n)
    for depth, points in zip(depths_mm, sheet_in_water(sensor, list(depths_mm), fans), strict=True):
        xy = project(sensor, points)
        xy = xy[sensor.camera.inside(np.nan_to_num(xy, nan=-1.0))]
        found = sheet_derivatives(sensor, xy)
        J = found.depth_by_parameters[found.points.ok]
        full = np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", J, sensor.cov, J), 0.0))
        alone = np.sqrt(np.einsum("ni,i,ni->n", J, np.diag(sensor.cov), J))
        entry: dict[str, float] = {"depth_mm": float(depth)}
        for name, sigma in (("", full), ("_uncorrelated", alone)):
            seen = sigma if len(sigma) else np.array([np.nan])
            entry |= {
                f"least{name}_mm": float(seen.min()),
                f"median{name}_mm": float(np.median(seen)),
                f"most{name}_mm": float(seen.max()),
            }
        rows.append(entry)
    return pd.DataFrame(rows)
