"""Positions between their epochs, smoothly and with a consistent covariance.

Two ways. `interpolate_positions` lays a cubic spline through each unbroken run of epochs.
`bridge_with_velocity` follows the velocity of the INS from epoch to epoch and spreads linearly what it
misses: it keeps motion that is faster than the epochs.

The covariance of an interpolated position is the sum of two parts. The first is the covariance of the
epochs, interpolated linearly. It is an upper bound: with weights that sum to one, averaging can only lower
it, and it does not for errors that neighbours share. The second is the variance of the interpolation
itself, taken from the data: epochs are left out and predicted by the others (cross-validation). It is zero
at the epochs and largest between them, with the shape ``16 u^2 (1 - u)^2``. For smooth motion that is the
shape of a cubic spline's error itself (a fourth derivative times ``u^2 (1 - u)^2``), and its variance is
the square of it; motion near the limit of the epochs fills the interval more evenly. The broader shape of
both is taken.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from thalweg.core import ArrayB, ArrayF, ArrayI, CoverageError, GeometryError

# ---------------------------------------------------------------- how wrong is an interpolation between
# epochs? Leave epochs out, and see how well the others foretell them
#
# Of every ``k`` epochs one is kept, and the kept ones are interpolated to the epochs in the middle between
# them. The mean square of what is missing there, less what the noise of single epochs explains, is the
# variance of interpolating over ``k`` steps. Two such spacings, ``2 h`` and ``4 h``, show its order, which
# carries it down to the real spacing ``h``: ``I(h) = I(2 h) 2^(-2 p)`` with ``p = log2(I(4 h) / I(2 h)) /
# 2``, kept between 0 (motion faster than the epochs) and 4 (smooth motion under a cubic spline). Where the
# track has holes that are bridged, holes of such lengths are made and measured as well.
#
# Noise and motion can be told apart only where epochs are dense. Above 2 Hz a survey boat does not move, and
# the spectrum there is noise. Epochs too sparse for that get no noise taken off: what is left then counts as
# motion, and the variance is too large rather than too small.


MIN_CUBIC: Final = 4
"""Fewest epochs of a run through which a cubic spline is laid."""

MOTION_HZ: Final = 2.0
"""Highest frequency at which a boat moves noticeably."""

_MAX_ORDER: Final = 4.0
_HOLES: Final = (2, 4, 8, 16, 32, 64)
_KEPT: Final = 6
"""Epochs between made holes: a knot's weight falls by 0.27 from knot to knot, so six are a dense track."""
_PHASES: Final = 2
_FEWEST: Final = 8
"""Residuals without which a spacing says nothing."""
_EDGE: Final = 2
"""Intervals at either end of a run that are left out where there are enough: the spline is worse there."""
_REGULAR: Final = 1.1
_LONGEST_SPECTRUM: Final = 4096
_FEWEST_BINS: Final = 8


@dataclass(frozen=True, slots=True)
class Method:
    """A way to interpolate: function of knots, values and times; noise gain in the middle; fewest knots."""

    predict: Callable[[ArrayF, ArrayF, ArrayF], ArrayF]
    noise_gain: float
    fewest: int
    max_order: float


def _cubic(knots: ArrayF, values: ArrayF, at: ArrayF) -> ArrayF:
    return np.asarray(CubicSpline(knots, values)(at))


def _linear(knots: ArrayF, values: ArrayF, at: ArrayF) -> ArrayF:
    return np.column_stack([np.interp(at, knots, values[:, axis]) for axis in range(values.shape[1])])


CUBIC: Final = Method(_cubic, 0.7561, MIN_CUBIC, _MAX_ORDER)
"""Squares of the weights of a cubic spline in the middle of two knots sum to 0.7561."""

LINEAR: Final = Method(_linear, 0.5, 2, 2.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class InterpolationError:
    """Variance of an interpolation in the middle between two epochs.

    Attributes
    ----------
    spacings_s : (k,) lengths of intervals, the nominal step of the epochs first.
    variances_m2 : (k, 3) in their middle, beyond the covariance of the epochs; not decreasing.
    order : (3,) the error at the nominal step grows with the step to this power.
    noise_m2 : (3,) variance that is new in each epoch; 0 where it cannot be told from motion.
    n_residuals : (k,) epochs that were left out and foretold.
    """

    spacings_s: ArrayF
    variances_m2: ArrayF
    order: ArrayF
    noise_m2: ArrayF
    n_residuals: ArrayI

    def variance_m2(self, spacing_s: ArrayLike) -> ArrayF:
        """Variance (n, 3) in the middle of intervals of the given lengths (n,).

        Logarithms are interpolated; below the shortest and above the longest spacing the variance follows the
        order, above it at least a proportional error.
        """
        spacing = np.asarray(spacing_s, dtype=np.float64)
        low = np.minimum(spacing / self.spacings_s[0], 1.0)
        high = np.maximum(spacing / self.spacings_s[-1], 1.0)
        scale = np.power(low[:, None], 2 * self.order) * np.power(
            high[:, None], 2 * np.maximum(self.order, 1)
        )
        # 1e-12 m2, a micrometre squared, keeps the logarithm of a vanishing variance finite
        logs = np.log(np.maximum(self.variances_m2, 1e-12))
        inside = np.column_stack(
            [np.interp(np.log(spacing), np.log(self.spacings_s), logs[:, axis]) for axis in range(3)]
        )
        return np.asarray(np.exp(inside) * scale)


def estimate_error(epochs_s: ArrayF, values: ArrayF, runs: list[slice], method: Method) -> InterpolationError:
    """Variance of interpolating (m, 3) values between their epochs, from the values themselves.

    Parameters
    ----------
    epochs_s : (m,) increasing.
    values : (m, 3) positions, or what is left of them when a predicted way is taken off.
    runs : unbroken runs of epochs.
    method : `CUBIC` or `LINEAR`.

    Returns
    -------
    Where too few epochs can be left out, the mean square of second differences over 64 stands in: the square
    of the sagitta of a parabola over one step. NaN if there is not even one second difference.
    """
    steps = np.concatenate([np.diff(epochs_s[run]) for run in runs])
    step = float(np.median(steps))
    noise = white_noise_m2(epochs_s, values, runs, step)
    explained = (1.0 + method.noise_gain) * noise

    def beyond_noise(k: int, kept: int) -> tuple[ArrayF, int]:
        """Mean square of what left-out epochs miss beyond their noise, and how many there were."""
        squares, n = _left_out(epochs_s, values, runs, k, kept, step, method)
        return np.maximum(squares - explained, 0.0), n

    twice, n_twice = beyond_noise(2, 1)
    if n_twice < _FEWEST:
        return _from_second_differences(values, runs, step)
    four, n_four = beyond_noise(4, 1)
    order = np.zeros(3)
    if n_four >= _FEWEST:
        with np.errstate(divide="ignore", invalid="ignore"):
            # nothing left at 2 h: smooth if there is something at 4 h, without meaning if there is not
            order = np.nan_to_num(0.5 * np.log2(four / twice), nan=0.0, posinf=method.max_order)
        order = np.clip(order, 0.0, method.max_order)
        twice = np.maximum(twice, four * 2.0 ** (-2 * method.max_order))
    found = [(step, twice * 2.0 ** (-2 * order), n_twice)]
    for k in _HOLES:
        if k / 2 >= float(steps.max()) / step:
            break
        squares, n = beyond_noise(k, _KEPT)
        if n < _FEWEST:
            break
        found.append((k * step, squares, n))
    if len(found) == 1:
        found.append((2 * step, twice, n_twice))
    return InterpolationError(
        spacings_s=np.array([s for s, _, _ in found]),
        variances_m2=np.maximum.accumulate(np.array([v for _, v, _ in found]), axis=0),
        order=order,
        noise_m2=noise,
        n_residuals=np.array([n for _, _, n in found], dtype=np.int64),
    )


def _left_out(
    epochs: ArrayF, values: ArrayF, runs: list[slice], k: int, kept: int, step: float, method: Method
) -> tuple[ArrayF, int]:
    """Mean square (3,) of residuals in the middle of made holes, and their number.

    ``kept`` epochs stand between holes of ``k`` steps: one makes a sparser track, several make holes in a
    dense one. There a spline takes its slope from noisy neighbours, and its error grows with the hole even
    if the boat lies still.
    """
    total, n, edge = np.zeros(3), 0, kept + _EDGE
    period = k + kept - 1
    phases = range(0, period, 1 if kept == 1 else max(period // _PHASES, 1))
    for run in runs:
        t, x = epochs[run], values[run]
        for phase in phases:
            place = (np.arange(len(t)) - phase) % period
            knots = np.flatnonzero(place < kept)
            if len(knots) < max(method.fewest, 2):
                break
            left = np.flatnonzero(np.diff(knots) == k)
            if method is CUBIC and len(knots) > 2 * edge + 2:
                left = left[(left >= edge) & (left < len(knots) - 1 - edge)]
            begin = knots[left]
            # an epoch that is missing in truth makes the hole wider
            begin = begin[t[begin + k] - t[begin] < _REGULAR * k * step]
            if not len(begin):
                continue
            middle = begin + k // 2
            residual = method.predict(t[knots], x[knots], t[middle]) - x[middle]
            total += np.square(residual).sum(axis=0)
            n += len(residual)
    return total / max(n, 1), n


def _from_second_differences(values: ArrayF, runs: list[slice], step: float) -> InterpolationError:
    second = np.concatenate([np.diff(values[run], n=2, axis=0) for run in runs])
    variance = np.square(second).mean(axis=0) / 64.0 if len(second) else np.full(3, np.nan)
    return InterpolationError(
        spacings_s=np.array([step]),
        variances_m2=variance[None],
        order=np.full(3, 2.0),
        noise_m2=np.zeros(3),
        n_residuals=np.array([len(second)], dtype=np.int64),
    )


def white_noise_m2(epochs_s: ArrayF, values: ArrayF, runs: list[slice], step_s: float) -> ArrayF:
    """Variance (3,) of what is new in each epoch: the level of the spectrum above `MOTION_HZ`.

    The spectrum is that of second differences, whose gain ``(2 sin(pi f h))^4`` is divided out: they take off
    the slow motion that would leak through the window.

    Returns
    -------
    Zero where the epochs are too sparse, too few or too irregular to see anything above that frequency.
    """
    if 0.5 / step_s <= MOTION_HZ:
        return np.zeros(3)
    power, n = np.zeros(3), 0
    for piece in _regular_pieces(epochs_s, runs, step_s):
        if piece.stop - piece.start < 2 * _FEWEST_BINS:
            continue
        second = np.diff(values[piece], n=2, axis=0)
        window = np.hanning(len(second) + 2)[1:-1]
        f = np.fft.rfftfreq(len(second), step_s)
        use = f > MOTION_HZ
        if use.sum() < _FEWEST_BINS:
            continue
        spectrum = np.square(np.abs(np.fft.rfft(second * window[:, None], axis=0)[use]))
        gain = np.power(2 * np.sin(np.pi * f[use] * step_s), 4)
        power += (spectrum / (np.square(window).sum() * gain[:, None])).sum(axis=0)
        n += int(use.sum())
    return power / n if n else power


def _regular_pieces(epochs: ArrayF, runs: list[slice], step: float) -> list[slice]:
    """Stretches without a missing epoch, cut to a length that a transform takes quickly."""
    pieces = []
    for run in runs:
        odd = np.flatnonzero(np.abs(np.diff(epochs[run]) - step) > 0.1 * step) + 1
        bounds = [run.start, *(run.start + odd).tolist(), run.stop]
        for a, b in itertools.pairwise(bounds):
            pieces += [slice(i, min(i + _LONGEST_SPECTRUM, b)) for i in range(a, b, _LONGEST_SPECTRUM)]
    return pieces


# ---------------------------------------------------------------- interpolation


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
    epochs_s: ArrayLike, position_m: ArrayLike, cov_m2: ArrayLike, at_s: ArrayLike, *, max_gap_s: float
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
