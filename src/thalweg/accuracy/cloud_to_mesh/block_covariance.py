"""Covariance of a robust fit to points that share the errors of their poses: a jackknife over time blocks.

Points of one moment err together, those of another by themselves; how errors are alike within a moment, by
the place, the range or a tilt, need not be known. The survey is cut into ``B`` blocks of time. With the
residuals ``e``, their rates ``D`` of change with the parameters and a robust weight ``w(e)``, each block has
a score and a curvature,

    g_b = sum w e D^T,    H_b = sum psi'(e) D^T D,    psi(e) = w(e) e

and the fit without block ``b`` differs from that with all by ``(H - H_b)^-1 g_b``, ``H = sum H_b``. Then

    cov = c (B - 1) / B sum_b d_b d_b^T,    d_b = (H - H_b)^-1 g_b       (CV3: MacKinnon, Nielsen, Webb 2023)

Three things matter, and each alone makes sigmas too small. Residuals are smaller than errors where a block
rules the fit: leaving it out shows that. A robust fit holds on to its points by the slope of ``psi``, not by
the weights, which are larger (Huber 1981, 7.6). Neighbouring blocks are not independent: with errors of
correlation time ``tau`` the sums over blocks of length ``L`` hold a share of the variance, and ``c`` is
its inverse,

    1 / c = 1 - (tau / L) (1 - exp(-L / tau))

For ``L = 2 tau`` this is 0.57. Errors that are white in time would need no ``c``: for them sigmas are up to a
third too large. Therefore blocks are longer where the survey is long enough for many of them.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.types import ArrayF, ArrayI

SHORTEST: Final = 2.0
"""Blocks last at least so many correlation times; sums over shorter ones hold too little of the variance."""

LONGEST: Final = 10.0
"""Longer blocks than so many correlation times hold no more than 90 % of the variance, and are fewer."""

ENOUGH_BLOCKS: Final = 20
"""Blocks are only made longer than the shortest as long as so many are left."""

SPARE_BLOCKS: Final = 3
"""So many more blocks than parameters are needed; the spread of fewer says nothing."""

_LEAST_LEFT: Final = 0.01
"""A parameter that keeps less than this share of its curvature without one block rests on that block."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BlockCovariance:
    """Result of `block_covariance`.

    ``cov`` (p, p), or None if there are too few blocks or a parameter rests on one of them. ``blocks`` is the
    effective number of blocks, ``(sum n)^2 / sum n^2`` (Kish 1965), each ``block_s`` long; ``needed`` so many
    are asked for.
    """

    cov: ArrayF | None
    blocks: float
    block_s: float
    needed: int


def time_blocks(t_gps_s: ArrayF, correlation_s: float) -> tuple[ArrayI, float]:
    """The block (n,) of each point, from 0 without gaps, and the length of the blocks in seconds.

    Times without points count for nothing, so a survey in several passes has as many blocks as it measured.
    """
    since = t_gps_s - t_gps_s.min()
    shortest = SHORTEST * correlation_s
    measured_s = shortest * len(np.unique(np.floor(since / shortest)))
    length = float(np.clip(measured_s / ENOUGH_BLOCKS, shortest, LONGEST * correlation_s))
    number = np.unique(np.floor(since / length), return_inverse=True)[1]
    return np.asarray(number, dtype=np.int64), length


def share_within_blocks(block_s: float, correlation_s: float) -> float:
    """Share of the variance of a sum of Gauss-Markov errors that sums over blocks hold.

    Examples
    --------
    >>> [round(share_within_blocks(k, 1.0), 2) for k in (2.0, 4.0, 10.0)]
    [0.57, 0.75, 0.9]
    """
    ratio = correlation_s / block_s
    return float(1 + ratio * np.expm1(-1 / ratio))


def block_covariance(
    design: ArrayF, psi_m: ArrayF, slope: ArrayF, *, t_gps_s: ArrayF, correlation_s: float
) -> BlockCovariance:
    """Covariance of the parameters of a converged robust fit.

    Parameters
    ----------
    design : (n, p) change of each residual with the parameters.
    psi_m : (n,) weight times residual.
    slope : (n,) derivative of that with respect to the residual.
    t_gps_s : (n,) time of each point.
    correlation_s : correlation time of the slowest error that changes.
    """
    number, length = time_blocks(t_gps_s, correlation_s)
    n_points = np.bincount(number).astype(np.float64)
    n_blocks, p = len(n_points), design.shape[1]
    effective = float(n_points.sum() ** 2 / np.sum(n_points**2))
    score: ArrayF = np.stack([np.bincount(number, weights=psi_m * d) for d in design.T], axis=1)
    curvature = np.empty((n_blocks, p, p))
    for i in range(p):
        for j in range(i + 1):
            sums = np.bincount(number, weights=slope * design[:, i] * design[:, j])
            curvature[:, i, j] = curvature[:, j, i] = sums
    cov = None
    if effective >= p + SPARE_BLOCKS:
        cov = _jackknife(score, curvature)
    if cov is not None:
        cov = cov / share_within_blocks(length, correlation_s)
    return BlockCovariance(cov=cov, blocks=effective, block_s=length, needed=p + SPARE_BLOCKS)


def _jackknife(score: ArrayF, curvature: ArrayF) -> ArrayF | None:
    whole = curvature.sum(axis=0)
    power, axes = np.linalg.eigh(whole)
    if power[0] <= 0:
        return None
    # in parameters in which the curvature of all is the unit matrix
    scale = axes / np.sqrt(power)
    rest = np.eye(len(power)) - scale.T @ curvature @ scale
    if np.linalg.eigvalsh(rest).min() < _LEAST_LEFT:
        return None
    changes = np.linalg.solve(rest, (score @ scale)[:, :, None])[:, :, 0] @ scale.T
    n_blocks = len(score)
    return np.asarray((n_blocks - 1) / n_blocks * changes.T @ changes)
