"""Positions between their epochs, smoothly and with an honest covariance.

Two ways. `interpolate_positions` lays a cubic spline through each unbroken run of epochs.
`bridge_with_velocity` follows the velocity of the INS from epoch to epoch and spreads linearly what it
misses: it keeps motion that is faster than the epochs.

The covariance of an interpolated position is the sum of two parts. The first is the covariance of the epochs,
interpolated linearly. It is an upper bound: with weights that sum to one, averaging can only lower it, and it
does not for errors that neighbours share. The second is the variance of the interpolation itself, taken from
the data: `thalweg.navigation.ins_gnss.left_out` leaves epochs out and looks how well the others foretell
them. It is
zero at the epochs and largest between them, with the shape ``16 u^2 (1 - u)^2``. For smooth motion that is
the shape of a cubic spline's error itself (a fourth derivative times ``u^2 (1 - u)^2``), and its variance is
the square of it; motion near the limit of the epochs fills the interval more evenly. The broader shape of
both is taken.
"""

import itertools
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from thalweg.core.errors import CoverageError, GeometryError
from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.navigation.ins_gnss.left_out import (
    CUBIC,
    LINEAR,
    MIN_CUBIC,
    InterpolationError,
    estimate_error,
)

JITTER_S: Final = 1e-3
"""Stamps of a regular stream scatter by microseconds; a step of just the limit is no gap for that."""

_END_GAIN: Final = 15.0
"""Error in the first and last interval of a cubic spline over that inside, for smooth motion.

There the polynomial of four points has the error ``u (1 - u) (2 - u) (3 - u) f'''' h^4 / 24``, 15 times
``f'''' h^4 / 384`` at ``u = 1/2``.
"""

_WORST_BRIDGE: Final = 0.0477
"""Greatest variance in the middle of a bridge, in units of ``(sigma_v T)^2``, over all correlation times."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Interpolated:
    """Positions at the times asked for; NaN where they are not covered.

    Attributes
    ----------
    position_m, velocity_mps : (n, 3).
    cov_m2 : (n, 3, 3), of the epochs and of the interpolation together.
    covered : (n,) false outside the epochs, in holes, and beside epochs that are too few.
    gaps : start and length of holes that were not bridged, seconds.
    short_segments : start and number of epochs of runs that are too short to be interpolated.
    sigma_interpolation_m : (n, 3) the part of the interpolation alone.
    error : how that part depends on the spacing; None if a stated sigma of the velocity was used.
    """

    position_m: ArrayF
    velocity_mps: ArrayF
    cov_m2: ArrayF
    covered: ArrayB
    gaps: list[tuple[float, float]]
    short_segments: list[tuple[float, int]]
    sigma_interpolation_m: ArrayF
    error: InterpolationError | None = None


def interpolate_positions(
    epochs_s: ArrayLike,
    position_m: ArrayLike,
    cov_m2: ArrayLike,
    at_s: ArrayLike,
    *,
    max_gap_s: float,
) -> Interpolated:
    """Cubic spline through each unbroken run of epochs; nothing across holes, nothing outside.

    Parameters
    ----------
    epochs_s : (m,) strictly increasing, seconds.
    position_m : (m, 3) in a Cartesian frame.
    cov_m2 : (m, 3, 3) in the same frame.
    at_s : (n,) times in any order; NaN is not covered.
    max_gap_s : longest hole that is interpolated.

    Returns
    -------
    Runs of fewer than four epochs hold no cubic spline: they are not covered, and named in
    ``short_segments``.

    Raises
    ------
    GeometryError : shapes that differ, values that are not finite, or epochs that do not increase.
    """
    epochs, position, cov, at = _checked(epochs_s, position_m, cov_m2, at_s)
    runs, gaps = _runs(epochs, max_gap_s, np.zeros(max(len(epochs) - 1, 0), dtype=np.bool_))
    whole = [run for run in runs if run.stop - run.start >= MIN_CUBIC]
    short = [(float(epochs[r.start]), r.stop - r.start) for r in runs if r.stop - r.start < MIN_CUBIC]
    if not whole:
        return _nothing(len(at), gaps, short)
    coefficients = np.zeros((4, len(epochs) - 1, 3))
    end = np.zeros(len(epochs) - 1, dtype=np.bool_)
    for run in whole:
        coefficients[:, run.start : run.stop - 1] = CubicSpline(epochs[run], position[run]).c
        end[[run.start, run.stop - 2]] = True
    left, u, covered = _place(epochs, whole, at)
    error = estimate_error(epochs, position, whole, CUBIC)
    step = epochs[left + 1] - epochs[left]
    s = (u * step)[:, None]
    a, b, c, d = (coefficients[k][left] for k in range(4))
    variance = error.variance_m2(np.diff(epochs))
    variance[end] *= _END_GAIN ** (error.order / 2.0)
    return _assembled(
        ((a * s + b) * s + c) * s + d,
        (3 * a * s + 2 * b) * s + c,
        _between(cov, left, u),
        variance[left] * (16.0 * np.square(u * (1 - u)))[:, None],
        covered,
        gaps,
        short,
        error,
    )


def bridge_with_velocity(
    epochs_s: ArrayLike,
    position_m: ArrayLike,
    cov_m2: ArrayLike,
    at_s: ArrayLike,
    *,
    max_gap_s: float,
    velocity_t_s: ArrayLike,
    velocity_mps: ArrayLike,
    sigma_velocity_mps: ArrayLike | None,
    velocity_time_s: float | None = None,
    offset_m: ArrayLike | None = None,
    max_velocity_gap_s: float = 0.1,
) -> Interpolated:
    """Positions between epochs along the INS's velocity; what it misses is spread linearly.

    With the way ``p(t)``, the integral of the velocity plus the turning lever arm, the position between two
    epochs is ``z_i + p(t) - p(t_i) + u (z_j - z_i - p(t_j) + p(t_i))``: ``z - p`` is interpolated linearly.

    Parameters
    ----------
    epochs_s, position_m, cov_m2, at_s, max_gap_s : as in `interpolate_positions`.
    velocity_t_s : (k,) strictly increasing, seconds.
    velocity_mps : (k, 3) velocity of the ics origin in the frame of the positions.
    sigma_velocity_mps : standard deviation, one number or (3,). A constant error does no harm, and one that
        changes fast averages out; without ``velocity_time_s`` the variance is that of the worst correlation
        time. None: the variance comes from epochs left out, as for the spline.
    velocity_time_s : correlation time of the velocity's error (Gauss-Markov).
    offset_m : (k, 3) from the ics origin to the point whose positions are given, in the same frame
        (``R_wcs_ics @ lever``); zero if None.
    max_velocity_gap_s : intervals with a longer hole in the velocities are gaps.

    Returns
    -------
    Single epochs between holes are not covered, and named in ``short_segments``.

    Raises
    ------
    GeometryError : as `interpolate_positions`.
    CoverageError : no sigma is given, and the epochs are too few to find it.
    """
    epochs, position, cov, at = _checked(epochs_s, position_m, cov_m2, at_s)
    t = np.asarray(velocity_t_s, dtype=np.float64)
    v = np.asarray(velocity_mps, dtype=np.float64)
    lever = np.zeros_like(v) if offset_m is None else np.asarray(offset_m, dtype=np.float64)
    _check(t, v, "velocity")
    _check(t, lever, "offset")
    blind = _without_velocity(epochs, t, max_velocity_gap_s)
    runs, gaps = _runs(epochs, max_gap_s, blind)
    whole = [run for run in runs if run.stop - run.start >= 2]
    short = [(float(epochs[r.start]), 1) for r in runs if r.stop - r.start < 2]
    if not whole or len(t) < MIN_CUBIC:
        return _nothing(len(at), gaps, short)
    speed, turning = CubicSpline(t, v), CubicSpline(t, lever)
    way = speed.antiderivative()

    def along(when: ArrayF) -> ArrayF:
        """The way of the antenna until each time: of the ics origin, and of the turning lever arm."""
        inside = np.clip(when, t[0], t[-1])
        return np.asarray(way(inside) + turning(inside))

    rest = position - along(epochs)
    left, u, covered = _place(epochs, whole, at)
    step = np.diff(epochs)
    error = None
    if sigma_velocity_mps is None:
        error = estimate_error(epochs, rest, whole, LINEAR)
        if not np.isfinite(error.variances_m2).all():
            raise CoverageError(
                f"{len(epochs)} epochs in {len(whole)} runs are too few to tell how good the velocity is",
                expected="a run of at least three epochs",
                cure="Give sigma_velocity_mps",
            )
        variance = error.variance_m2(step)
    else:
        sigma = np.broadcast_to(np.asarray(sigma_velocity_mps, dtype=np.float64), (3,))
        variance = bridge_factor(step, velocity_time_s)[:, None] * np.square(step[:, None] * sigma)
    when = np.where(covered, at, epochs[0])
    slope = np.diff(rest, axis=0) / step[:, None]
    w = u[:, None]
    return _assembled(
        along(when) + rest[left] * (1 - w) + rest[left + 1] * w,
        speed(np.clip(when, t[0], t[-1])) + turning(np.clip(when, t[0], t[-1]), 1) + slope[left],
        _between(cov, left, u),
        variance[left] * (4.0 * u * (1 - u))[:, None],
        covered,
        gaps,
        short,
        error,
    )


def bridge_factor(interval_s: ArrayLike, velocity_time_s: float | None) -> ArrayF:
    """Variance in the middle of a bridge over ``(sigma_v T)^2``, for Gauss-Markov errors of the velocity.

    With ``a = T / (2 tau)`` it is ``(2 a - 3 + 4 exp(-a) - exp(-2 a)) / (8 a^2)``: half the difference of the
    ways of the two halves. It vanishes for constant errors and for white ones; 0.0477 at a = 1.9 is the most.

    Examples
    --------
    >>> [round(float(x), 4) for x in bridge_factor([0.1, 1.0, 10.0], 0.263)]
    [0.0138, 0.0476, 0.0121]
    """
    interval = np.asarray(interval_s, dtype=np.float64)
    if velocity_time_s is None:
        return np.full(interval.shape, _WORST_BRIDGE)
    a = interval / (2.0 * velocity_time_s)
    safe = np.maximum(a, 1e-3)
    exact = (2 * safe - 3 + 4 * np.exp(-safe) - np.exp(-2 * safe)) / (8 * np.square(safe))
    # below 0.01 the four terms cancel to their third order, 2/3 a^3
    return np.asarray(np.where(a < 0.01, a / 12.0, exact))


def _checked(
    epochs_s: ArrayLike, position_m: ArrayLike, cov_m2: ArrayLike, at_s: ArrayLike
) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF]:
    epochs = np.asarray(epochs_s, dtype=np.float64)
    position = np.asarray(position_m, dtype=np.float64)
    cov = np.asarray(cov_m2, dtype=np.float64)
    at = np.asarray(at_s, dtype=np.float64)
    _check(epochs, position, "position")
    if cov.shape != (len(epochs), 3, 3) or not np.isfinite(cov).all():
        raise GeometryError(
            f"covariances of shape {cov.shape}, {int((~np.isfinite(cov)).sum())} values not finite",
            expected=f"({len(epochs)}, 3, 3) finite values",
        )
    if at.ndim != 1:
        raise GeometryError(f"{at.shape=}", expected="(n,) times")
    return epochs, position, cov, at


def _check(t: ArrayF, values: ArrayF, what: str) -> None:
    if t.ndim != 1 or values.shape != (len(t), 3):
        raise GeometryError(f"{what}: times {t.shape}, values {values.shape}", expected="(m,) and (m, 3)")
    if not (np.isfinite(t).all() and np.isfinite(values).all()):
        raise GeometryError(f"{what}: values that are not finite", expected="finite times and values")
    if np.any(np.diff(t) <= 0):
        raise GeometryError(
            f"{what}: {int(np.sum(np.diff(t) <= 0))} times that do not increase",
            expected="strictly increasing times",
            cure="Sort by time and drop repeated times",
        )


def _runs(epochs: ArrayF, max_gap_s: float, blind: ArrayB) -> tuple[list[slice], list[tuple[float, float]]]:
    """Unbroken runs of epochs, and the holes between them."""
    step = np.diff(epochs)
    holes = np.flatnonzero((step > max_gap_s + JITTER_S) | blind)
    bounds = [0, *(holes + 1).tolist(), len(epochs)]
    runs = [slice(a, b) for a, b in itertools.pairwise(bounds) if b > a]
    return runs, [(float(epochs[i]), float(step[i])) for i in holes]


def _without_velocity(epochs: ArrayF, t: ArrayF, max_gap_s: float) -> ArrayB:
    """Intervals between epochs (m - 1,) that the velocities do not span without a hole."""
    holes = np.flatnonzero(np.diff(t) > max_gap_s + JITTER_S)
    first, last = epochs[:-1], epochs[1:]
    blind = (first < t[0] - JITTER_S) | (last > t[-1] + JITTER_S) if len(t) else np.ones(len(first), np.bool_)
    # a hole (t[h], t[h + 1]) meets an interval if it begins before its end and ends behind its begin
    begun = np.searchsorted(t[holes], last, side="left")
    ended = np.searchsorted(t[holes + 1], first, side="right")
    return np.asarray(blind | (begun > ended))


def _place(epochs: ArrayF, runs: list[slice], at: ArrayF) -> tuple[ArrayI, ArrayF, ArrayB]:
    """Interval, place in it between 0 and 1, and whether it may be used; an epoch itself always may."""
    usable = np.zeros(len(epochs) - 1, dtype=np.bool_)
    for run in runs:
        usable[run.start : run.stop - 1] = True
    left = np.clip(np.searchsorted(epochs, at, side="right") - 1, 0, len(epochs) - 2)
    # the last epoch of a run belongs to the interval before it
    left -= (at == epochs[left]) & ~usable[left] & (left > 0)
    u = (at - epochs[left]) / (epochs[left + 1] - epochs[left])
    covered = usable[left] & (u >= 0) & (u <= 1)
    return left, np.where(covered, u, 0.0), covered


def _between(cov: ArrayF, left: ArrayI, u: ArrayF) -> ArrayF:
    flat = cov.reshape(-1, 9)
    out = flat[left]
    out += (np.diff(flat, axis=0))[left] * u[:, None]
    return out.reshape(-1, 3, 3)


def _assembled(
    position: ArrayF,
    velocity: ArrayF,
    cov: ArrayF,
    variance: ArrayF,
    covered: ArrayB,
    gaps: list[tuple[float, float]],
    short: list[tuple[float, int]],
    error: InterpolationError | None,
) -> Interpolated:
    for axis in range(3):
        cov[:, axis, axis] += variance[:, axis]
    sigma = np.sqrt(variance)
    for values in (position, velocity, cov, sigma):
        values[~covered] = np.nan
    return Interpolated(
        position_m=position,
        velocity_mps=velocity,
        cov_m2=cov,
        covered=covered,
        gaps=gaps,
        short_segments=short,
        sigma_interpolation_m=sigma,
        error=error,
    )


def _nothing(n: int, gaps: list[tuple[float, float]], short: list[tuple[float, int]]) -> Interpolated:
    return Interpolated(
        position_m=np.full((n, 3), np.nan),
        velocity_mps=np.full((n, 3), np.nan),
        cov_m2=np.full((n, 3, 3), np.nan),
        covered=np.zeros(n, dtype=np.bool_),
        gaps=gaps,
        short_segments=short,
        sigma_interpolation_m=np.full((n, 3), np.nan),
    )
