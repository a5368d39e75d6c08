"""How wrong is an interpolation between epochs? Leave epochs out, and see how well the others foretell them.

Of every ``k`` epochs one is kept, and the kept ones are interpolated to the epochs in the middle between
them. The mean square of what is missing there, less what the noise of single epochs explains, is the variance
of interpolating over ``k`` steps. Two such spacings, ``2 h`` and ``4 h``, show its order, which carries it
down to the real spacing ``h``: ``I(h) = I(2 h) 2^(-2 p)`` with ``p = log2(I(4 h) / I(2 h)) / 2``, kept
between 0 (motion faster than the epochs) and 4 (smooth motion under a cubic spline). Where the track has
holes that are bridged, holes of such lengths are made and measured as well.

Noise and motion can be told apart only where epochs are dense. Above 2 Hz a survey boat does not move, and
the spectrum there is noise. Epochs too sparse for that get no noise taken off: what is left then counts as
motion, and the variance is too large rather than too small.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from thalweg.core.types import ArrayF, ArrayI

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
