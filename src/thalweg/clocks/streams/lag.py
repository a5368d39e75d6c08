"""Do two streams tell of the same motion at the same time? Offset between their stamps, with its sigma."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.ndimage import uniform_filter1d

from thalweg.core.errors import GeometryError
from thalweg.core.frames import LocalFrame, rotation_enu_body
from thalweg.core.types import ArrayF, ArrayI

LIMIT_S: Final = 0.005
"""Smaller offsets do no harm: at 7 degrees/s they turn the beam by 0.035 degrees, a fifth of its sigma."""

MAX_LAG_S: Final = 1.0
"""An offset of whole seconds (leap seconds, a wrong hour) shows in the common span and in the positions."""

BAND_HZ: Final = (0.1, 2.0)
"""Frequencies of a boat's swaying."""

_LEAST: Final = 50
_ITERATIONS: Final = 8
_SMOOTH: Final = 9
"""Frequencies over which the spectrum of the residuals is averaged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lag:
    """What b shows at ``t`` happened in a at ``t - offset_s``: positive if the stamps of b are late.

    ``sigma_s`` holds the correlation of the residuals; NaN offsets if the streams do not tell. ``n`` is the
    number of epochs of b that were used.
    """

    offset_s: float
    sigma_s: float
    n: int

    @property
    def significant(self) -> bool:
        """True if the offset is more than three sigmas from zero and large enough to matter."""
        return bool(abs(self.offset_s) > max(3.0 * self.sigma_s, LIMIT_S))


def stream_lag(
    t_a: ArrayLike, v_a: ArrayLike, t_b: ArrayLike, v_b: ArrayLike, max_lag_s: float = MAX_LAG_S
) -> Lag:
    """Time offset between two records of the same quantity, by least squares on its derivative.

    The best offset on a grid is refined by Newton steps on the score ``sum w (v_b(t) - v_a(t - offset) - c)``
    with ``w``, the derivative of a within `BAND_HZ`: slower errors of both streams then play no part, nor has
    the noise of the derivative. The variance is ``sum_f |W(f)|^2 S(f)`` over the square of the score's slope,
    with the spectrum ``W`` and the smoothed spectrum ``S`` of the residuals. Those of differenced positions
    are blue, those of slow errors red, and only what lies at the frequencies of the motion counts. In the
    slope, the term of the second derivative takes off what the noise of a itself adds to ``sum w w``.

    Parameters
    ----------
    t_a, t_b : (n,), (m,) increasing, seconds. b is regular but for missing epochs, a denser than the motion.
    v_a, v_b : (n,) or (n, k), (m,) or (m, k) the same quantity, such as a velocity.
    max_lag_s : the offset is looked for between minus and plus this.

    Returns
    -------
    Offset and sigma are NaN if fewer than 50 epochs overlap, if nothing moves, or if the best offset is at an
    end of what was searched.

    Raises
    ------
    GeometryError : shapes that do not belong together.
    """
    ta, tb = np.asarray(t_a, np.float64), np.asarray(t_b, np.float64)
    va, vb = (np.asarray(v, np.float64).reshape(len(t), -1) for v, t in ((v_a, ta), (v_b, tb)))
    if va.shape[1] != vb.shape[1]:
        raise GeometryError(f"{va.shape=}, {vb.shape=}", expected="the same number of components")
    known = np.isfinite(ta) & np.isfinite(va).all(axis=1)
    ta, va = ta[known], va[known]
    known = np.isfinite(tb) & np.isfinite(vb).all(axis=1)
    if len(ta) >= 4:
        known &= (tb > ta[0] + max_lag_s) & (tb < ta[-1] - max_lag_s)
    tb, vb = tb[known], vb[known]
    nothing = Lag(offset_s=float("nan"), sigma_s=float("nan"), n=len(tb))
    if len(ta) < 4 or len(tb) < _LEAST:
        return nothing
    spline = CubicSpline(ta - ta[0], va)
    t = tb - ta[0]
    offset = _coarse(spline, t, vb, max_lag_s)
    grid = _Grid.of(t)
    for _ in range(_ITERATIONS):
        residual = vb - spline(t - offset)
        residual = residual - residual.mean(axis=0)
        weight, change = grid.instrument(spline, offset)
        score = float((weight * residual).sum())
        power = float((weight * spline(t - offset, 1)).sum() - (change * residual).sum())
        if not power > 0:
            return nothing
        offset = float(np.clip(offset - score / power, -max_lag_s, max_lag_s))
        if abs(score / power) < 1e-6:
            break
    if abs(offset) >= max_lag_s:
        return nothing
    return Lag(offset_s=offset, sigma_s=grid.score_sigma(weight, residual) / power, n=len(tb))


def _coarse(spline: CubicSpline, t: ArrayF, v: ArrayF, max_lag_s: float) -> float:
    """The offset on a grid that leaves least, taken over at most 2000 epochs."""
    few = np.linspace(0, len(t) - 1, min(len(t), 2000)).astype(np.int64)
    step = max(0.2 * float(np.median(np.diff(t))), max_lag_s / 200)
    grid = np.arange(-max_lag_s, max_lag_s + step / 2, step)

    def misfit(offset: float) -> float:
        """Sum of squares that an offset leaves, after a constant difference of both series."""
        rest = v[few] - spline(t[few] - offset)
        return float(np.square(rest - rest.mean(axis=0)).sum())

    return float(grid[int(np.argmin([misfit(float(x)) for x in grid]))])


@dataclass(frozen=True, slots=True)
class _Grid:
    """The regular grid of the epochs of b, with the places that are filled."""

    first_s: float
    step_s: float
    place: ArrayI
    n: int

    @classmethod
    def of(cls, t: ArrayF) -> Self:
        """The regular grid on which times (n,) lie."""
        step = float(np.median(np.diff(t)))
        place = np.rint((t - t[0]) / step).astype(np.int64)
        return cls(float(t[0]), step, place, int(place[-1]) + 1)

    def instrument(self, spline: CubicSpline, offset_s: float) -> tuple[ArrayF, ArrayF]:
        """Derivative of a within the band of a boat's motion, and the change of that, at the epochs."""
        t = self.first_s + np.arange(self.n) * self.step_s - offset_s
        f = np.fft.rfftfreq(self.n, self.step_s)[:, None]
        spectrum = np.fft.rfft(spline(t, 1), axis=0) * ((f >= BAND_HZ[0]) & (f <= BAND_HZ[1]))
        weight = np.fft.irfft(spectrum, self.n, axis=0)
        change = np.fft.irfft(spectrum * 2j * np.pi * f, self.n, axis=0)
        return weight[self.place], change[self.place]

    def score_sigma(self, weight: ArrayF, residual: ArrayF) -> float:
        """Standard deviation of ``sum(weight * residual)`` for stationary residuals; missing epochs are 0."""
        total = 0.0
        for axis in range(weight.shape[1]):
            w, r = np.zeros(self.n), np.zeros(self.n)
            w[self.place], r[self.place] = weight[:, axis], residual[:, axis]
            size = 2 * self.n  # zeros behind it: the ends of the record are no neighbours
            spectrum = np.square(np.abs(np.fft.fft(r, size)))
            smooth = uniform_filter1d(spectrum, 2 * _SMOOTH, mode="wrap") / len(residual)
            total += float(np.sum(np.square(np.abs(np.fft.fft(w, size))) * smooth) / size)
        # the offset was fitted: at the frequencies of the motion what is left is too small by as much
        return float(np.sqrt(total * _SMOOTH / (_SMOOTH - 1.0)))


def ins_position_lag(
    states: pd.DataFrame,
    positions: pd.DataFrame,
    frame: LocalFrame,
    *,
    lever_ics_antenna_m: ArrayLike,
    max_lag_s: float = MAX_LAG_S,
) -> Lag:
    """Offset of the positions' stamps against those of the INS, from the velocity of the antenna.

    The INS gives the velocity of the antenna (its own, and the turning lever arm), averaged over the step of
    the positions; the positions give their differences over that step. Both are then the same quantity.

    Parameters
    ----------
    states : table kind ``ins_state`` with velocities.
    positions : table kind ``gnss_position``, of the antenna.
    frame : the world frame.
    lever_ics_antenna_m : (3,) antenna in the body frame.
    max_lag_s : as in `stream_lag`.

    Returns
    -------
    NaN where there are no velocities, or too few neighbouring epochs of the same fix.
    """
    columns = ["t_gps_s", "v_east_mps", "v_north_mps", "v_down_mps", "roll_rad", "pitch_rad", "heading_rad"]
    ins = states.dropna(subset=columns).sort_values("t_gps_s", kind="stable").drop_duplicates("t_gps_s")
    known = positions.dropna(subset=["t_gps_s", "lat_deg", "lon_deg", "h_ell_m"])
    known = known.sort_values("t_gps_s", kind="stable").drop_duplicates("t_gps_s")
    t = known["t_gps_s"].to_numpy()
    if len(ins) < 4 or len(known) < _LEAST:
        return Lag(offset_s=float("nan"), sigma_s=float("nan"), n=0)
    step = float(np.median(np.diff(t)))
    z = frame.from_geodetic(known["lat_deg"], known["lon_deg"], known["h_ell_m"])
    fix = known["fix"].to_numpy()
    good = (np.abs(np.diff(t) - step) < 0.1 * step) & (fix[1:] == fix[:-1])
    velocity_b = (np.diff(z, axis=0) / np.diff(t)[:, None])[good]
    t_a = ins["t_gps_s"].to_numpy()
    turning = rotation_enu_body(ins["roll_rad"], ins["pitch_rad"], ins["heading_rad"])
    arm = turning @ np.asarray(lever_ics_antenna_m, dtype=np.float64)
    own = np.column_stack([ins["v_east_mps"], ins["v_north_mps"], -ins["v_down_mps"]])
    inside = (t_a > t_a[0] + step) & (t_a < t_a[-1] - step)
    s = t_a - t_a[0]
    way = CubicSpline(s, own).antiderivative()
    swing = CubicSpline(s, arm)
    at = s[inside]
    if len(at) < 4:
        return Lag(offset_s=float("nan"), sigma_s=float("nan"), n=0)
    ahead, behind = at + step / 2, at - step / 2
    velocity_a = (way(ahead) + swing(ahead) - way(behind) - swing(behind)) / step
    middle = ((t[1:] + t[:-1]) / 2)[good]
    return stream_lag(t_a[inside], velocity_a, middle, velocity_b, max_lag_s)
