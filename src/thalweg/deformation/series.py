"""More than two epochs: step and trend at each place, epochs that jump and return, closure.

At each place (core point or cell) the heights of the epochs are fitted by

    h(t) = level + trend * (t - mean t)            and by
    h(t) = level + trend * (t - mean t) + step * (t after an epoch),

by generalised least squares with C = diag(own variances) + common covariance of the epochs. An error that an
epoch has in common for the whole area does not average over the area: `sigma_trend_common_m_a` is what
remains of a mean over any number of places.

Distances from the first epoch, d_i = h_i - h_0, all hold the error of the first one. They need no model of
their own: with a level in it the fit of (0, d_1, d_2, ...) with the sigmas of the single epochs is that of
the distances with their full covariance without a level.

Source of the equations: Aitken (1935), Proc. R. Soc. Edinburgh 55; the bound for the place of the step is
Bonferroni's.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy.stats import norm

from thalweg.core import (
    ArrayB,
    ArrayF,
    GeometryError,
    InputError,
    column,
    frame_of,
    root_mean_square,
    table_kind,
)

SERIES = table_kind(
    "series",
    1,
    [
        column("place", "1", "number of the core point or cell", pa.int64()),
        column("n_epochs", "1", "epochs in which it was seen", pa.int64()),
        column("trend_m_a", "m/a", "linear trend, no step"),
        column("sigma_trend_m_a", "m/a", "standard deviation of the trend"),
        column("sigma_trend_common_m_a", "m/a", "its part that all places share"),
        column("chi2_trend", "1", "sum of squared normalised residuals of the trend"),
        column("step_after_epoch", "1", "step between this epoch and the next, from 0; -1: none", pa.int64()),
        column("step_m", "m", "largest step in its standard deviation, beside a trend"),
        column("sigma_step_m", "m", "standard deviation of the step at this place in time"),
        column("p_step", "1", "probability of such a step at any time without one (bound)"),
    ],
)
"""One row for each place."""
HEIGHTS = table_kind(
    "heights",
    1,
    [
        column("place", "1", "number of the core point or cell", pa.int64()),
        column("epoch", "1", "number of the epoch, from 1", pa.int64()),
        column("t_a", "a", "time since the first epoch, Julian years"),
        column("distance_m", "m", "registered distance from the first epoch"),
        column("sigma_m", "m", "standard deviation of this epoch's own mean"),
    ],
)
"""One row for each place and epoch that saw it."""


def fit_series(
    t_a: ArrayF, height_m: ArrayF, sigma_m: ArrayF, common_m2: ArrayF | None = None
) -> pd.DataFrame:
    """Table `SERIES`: trend and step of each place with standard deviations.

    Parameters
    ----------
    t_a : (n,) times of the epochs in years, ascending.
    height_m : (n, k) heights, or distances from the first epoch (whose row is zero); NaN where not seen.
    sigma_m : (n,) or (n, k) standard deviations of single heights.
    common_m2 : (n, n) covariance of the errors that an epoch has everywhere; for independent epochs the
        diagonal holds their variances.

    Raises
    ------
    InputError : shapes or times that do not fit, or heights without any error.
    """
    n, k = height_m.shape
    common = np.zeros((n, n)) if common_m2 is None else np.asarray(common_m2, float)
    fits = t_a.shape == (n,) and common.shape == (n, n) and np.shape(sigma_m) in ((n,), (n, k))
    if not fits or n < 3 or not (np.diff(t_a) > 0).all():
        raise InputError(
            f"{n} epochs with times {t_a.shape}, sigmas {np.shape(sigma_m)} and a covariance {common.shape}",
            expected="three or more ascending times, n or n x k sigmas, an n x n covariance",
        )
    own = np.asarray(sigma_m, float).reshape(n, -1)
    sigma = np.broadcast_to(own, (n, k))
    seen = np.isfinite(height_m)
    if not (sigma[seen] > 0).all():
        raise InputError(
            f"{int((~(sigma[seen] > 0)).sum())} heights without a standard deviation", expected="above zero"
        )
    trend = np.full((k, 4), np.nan)
    step = np.full((k, 3), np.nan)
    after = np.full(k, -1)
    patterns, which = np.unique(seen.T, axis=0, return_inverse=True)
    for number, pattern in enumerate(patterns):
        places = np.flatnonzero(which == number)
        if pattern.sum() < 3:
            continue
        at = np.flatnonzero(pattern)
        variance = own[at] ** 2 if own.shape[1] == 1 else own[np.ix_(at, places)] ** 2
        C = common[np.ix_(at, at)] + np.einsum("ik,ij->kij", variance, np.eye(len(at)))
        root = np.linalg.cholesky(C)
        t = t_a[at] - t_a[at].mean()
        y = height_m[np.ix_(at, places)].T
        parameters, Q, weights, chi2 = _least_squares(root, np.column_stack([np.ones_like(t), t]), y)
        shared = np.einsum("ki,ij,kj->k", weights[:, 1], common[np.ix_(at, at)], weights[:, 1])
        for i, value in enumerate((parameters[:, 1], np.sqrt(Q[:, 1, 1]), np.sqrt(shared), chi2)):
            trend[places, i] = value
        if len(at) < 5:  # a step behind the first and before the last epoch, and one height to spare
            continue
        best = np.zeros(len(places))
        for e in range(1, len(at) - 2):
            design = np.column_stack([np.ones_like(t), t, np.arange(len(at)) > e])
            parameters, Q, _, _ = _least_squares(root, design, y)
            size, spread = parameters[:, 2], np.broadcast_to(np.sqrt(Q[:, 2, 2]), len(places))
            better = np.abs(size) / spread > best
            best[better] = (np.abs(size) / spread)[better]
            p = np.minimum(1.0, (len(at) - 3) * 2.0 * norm.sf(np.abs(size) / spread))
            step[places[better]] = np.column_stack([size, spread, p])[better]
            after[places[better]] = at[e]
    return frame_of(
        SERIES,
        {
            "place": np.arange(k),
            "n_epochs": seen.sum(axis=0),
            **dict(zip(_TREND, trend.T, strict=True)),
            "step_after_epoch": after,
            **dict(zip(_STEP, step.T, strict=True)),
        },
    )


def heights_table(t_a: ArrayF, height_m: ArrayF, sigma_m: ArrayF) -> pd.DataFrame:
    """Table `HEIGHTS` of times (n,), distances (n, k) and standard deviations (n, k); NaN is left out."""
    epoch, place = np.nonzero(np.isfinite(height_m))
    return frame_of(
        HEIGHTS,
        {
            "place": place,
            "epoch": epoch + 1,
            "t_a": (t_a - t_a[0])[epoch],
            "distance_m": height_m[epoch, place],
            "sigma_m": sigma_m[epoch, place],
        },
    )


_TREND = ("trend_m_a", "sigma_trend_m_a", "sigma_trend_common_m_a", "chi2_trend")
_STEP = ("step_m", "sigma_step_m", "p_step")


def _least_squares(root: ArrayF, design: ArrayF, y: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF]:
    """Parameters (k, u), their covariance, weights of the observations, sum of squares (k,).

    ``root`` (1, n, n) is that of all places, or (k, n, n) has one for each; covariance (., u, u) and weights
    (., u, n) have as many.
    """
    whitening: ArrayF = np.asarray(np.linalg.inv(root), np.float64)
    A = whitening @ design
    Q: ArrayF = np.asarray(np.linalg.inv(np.swapaxes(A, 1, 2) @ A), np.float64)
    weights: ArrayF = Q @ np.swapaxes(A, 1, 2) @ whitening
    parameters = (weights @ y[..., None])[..., 0]
    residual = (whitening @ (y - parameters @ design.T)[..., None])[..., 0]
    return parameters, Q, weights, (residual**2).sum(axis=1)


_RETURN: Final = 0.6
"""Share of the places that must go and come back; noise alone takes a third of them there and back."""


@dataclass(frozen=True, slots=True)
class Jump:
    """What an epoch does against its neighbours.

    Attributes
    ----------
    epoch : its number, from 0.
    n : places that were seen in it and both neighbours.
    before_m, after_m : median of (epoch - previous) and (next - epoch), each over all places seen in both.
    share : of the n places, those that go and come back in the sense of the medians.
    flagged : both medians exceed their limits in opposite senses, over most of the area.
    """

    epoch: int
    n: int
    before_m: float
    after_m: float
    share: float
    flagged: bool


def find_jumps(height_m: ArrayF, sigma_step_m: ArrayF, *, limit: float = 1.0) -> list[Jump]:
    """Epochs that jump and return over most of the area: an error of the epoch rather than of the ground.

    Parameters
    ----------
    height_m : (n, k) heights; NaN where not seen.
    sigma_step_m : (n - 1,) standard deviation of the offset between consecutive epochs.
    limit : in standard deviations, which both medians must exceed.

    Raises
    ------
    InputError : fewer than three epochs, or another number of sigmas.
    GeometryError : consecutive epochs that no place was seen in.
    """
    n = len(height_m)
    if n < 3 or len(sigma_step_m) != n - 1:
        raise InputError(
            f"{n} epochs and {len(sigma_step_m)} sigmas of steps",
            expected="three or more, and one less sigmas",
        )
    steps = np.diff(height_m, axis=0)
    for i, step in enumerate(steps):
        if not np.isfinite(step).any():
            raise GeometryError(f"no place was seen in both epochs {i} and {i + 1}", expected="common places")
    medians = np.nanmedian(steps, axis=1)
    found = []
    for i, (first, second) in enumerate(pairwise(steps)):
        both: ArrayB = np.isfinite(first) & np.isfinite(second)
        come, go = medians[i], medians[i + 1]
        returns = (np.sign(first) == np.sign(come)) & (np.sign(second) == np.sign(go)) & both
        share = float(returns.sum() / max(both.sum(), 1))
        large = abs(come) > limit * sigma_step_m[i] and abs(go) > limit * sigma_step_m[i + 1]
        flagged = bool(come * go < 0 and large and share > _RETURN)
        found.append(Jump(i + 1, int(both.sum()), float(come), float(go), share, flagged))
    return found


@dataclass(frozen=True, slots=True)
class Closure:
    """Sum of consecutive changes minus the change from first to last epoch, over places with all of them.

    Attributes
    ----------
    n : places.
    mean_m, rms_m, largest_m : of the misclosures; zero for heights, not for distances along normals that
        each pair of epochs has of its own.
    """

    n: int
    mean_m: float
    rms_m: float
    largest_m: float


def closure(steps_m: ArrayF, first_to_last_m: ArrayF) -> Closure:
    """Misclosure of changes (n - 1, k) between consecutive epochs against those (k,) from first to last.

    Raises
    ------
    GeometryError : no place has all changes.
    """
    miss = np.sum(steps_m, axis=0) - first_to_last_m
    miss = miss[np.isfinite(miss)]
    if not len(miss):
        raise GeometryError("no place was seen in all epochs", expected="places with all changes")
    return Closure(len(miss), float(miss.mean()), root_mean_square(miss), float(np.abs(miss).max()))
