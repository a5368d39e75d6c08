"""Offset and drift of a clock from comparisons with GPS time before and after a run (T 2.3).

The camera is connected to a computer on GPS time at the quay, and both clocks are read; again when the boat
is back. A straight line through the ties is the clock in between; outside, its sigma grows with that of the
drift.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from thalweg.clocks.ties.hand_tables import read_number_columns
from thalweg.clocks.ties.model import QUARTZ_DRIFT, ClockModel
from thalweg.core.errors import ClockError
from thalweg.core.types import ArrayF
from thalweg.ingest.clock_shift import explain_shift

_LEAST_SPAN_S: Final = 1.0
_PROBABILITY: Final = 0.999
_WILD_DRIFT: Final = 1e-3
"""No quartz runs 1000 ppm wrong: a tie was misread, or the clock was set in between."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ties:
    """Simultaneous readings: ``t_device_s`` (n,), ``t_gps_s`` (n,), ``sigma_s`` (n,) of their difference."""

    t_device_s: ArrayF
    t_gps_s: ArrayF
    sigma_s: ArrayF


def read_ties(path: Path) -> Ties:
    """Ties from a CSV table with the columns ``t_device_s``, ``t_gps_s`` and ``sigma_s``.

    Raises
    ------
    InputError : the table is missing, lacks a column, or holds what is no number.
    """
    t_device_s, t_gps_s, sigma_s = read_number_columns(path, ("t_device_s", "t_gps_s", "sigma_s"))
    return Ties(t_device_s=t_device_s, t_gps_s=t_gps_s, sigma_s=sigma_s)


def clock_from_ties(
    t_device_s: ArrayLike,
    t_gps_s: ArrayLike,
    sigma_s: ArrayLike,
    *,
    sigma_drift: float = QUARTZ_DRIFT,
    jitter_s: float = 0.0,
) -> ClockModel:
    """Offset and drift from ties by weighted least squares, with their covariance.

    One tie, or several at one moment, give the offset only: the drift is then 0 with ``sigma_drift``, and
    the sigma of a time grows with its distance from the tie. With more than two ties the straight line is
    tested.

    Parameters
    ----------
    t_device_s, t_gps_s : (n,) what both clocks showed at the same moments.
    sigma_s : scalar or (n,) sigma of the difference of a pair.
    sigma_drift : sigma of the drift where the ties do not tell.
    jitter_s : standard deviation of a single stamp of the camera, from elsewhere: ties do not tell it, see
        `thalweg.clocks.ties.run_image_times.jitter_of_ties`.

    Raises
    ------
    ClockError : no tie, sigmas that are not above zero, a clock that was set between two ties, or ties that
        do not lie on a straight line.
    """
    t, gps = np.asarray(t_device_s, np.float64).ravel(), np.asarray(t_gps_s, np.float64).ravel()
    sigma = np.broadcast_to(np.asarray(sigma_s, np.float64), t.shape)
    if not t.size or t.shape != gps.shape or not np.isfinite([t, gps, sigma]).all() or not (sigma > 0).all():
        raise ClockError(
            f"{t.size} stamps, {gps.size} GPS times, sigmas {np.unique(sigma).tolist()}",
            expected="at least one tie of finite times with a sigma above 0",
            cure="Compare the camera's clock with GPS time before and after the run",
        )
    order = np.argsort(t, kind="stable")
    t, d, weight = t[order], (gps - t)[order], 1.0 / sigma[order] ** 2
    notes = []
    reference = float(np.average(t, weights=weight))
    # near zero: sums of clocks that are hours apart would lose digits
    d0 = float(d[0])
    y, x = d - d0, t - reference
    middle = float(np.average(y, weights=weight))
    variance = 1.0 / float(weight.sum())
    words = explain_shift(d0 + middle)
    if words:
        notes.append(f"The offset is {d0 + middle:+.3f} s, which looks like {words}.")
    if t[-1] - t[0] < _LEAST_SPAN_S:
        notes.append(
            f"Ties at one moment only: the drift is not determined and taken as 0 with a sigma of "
            f"{sigma_drift * 1e6:g} ppm. An hour away the time is uncertain by {sigma_drift * 3.6e6:.0f} ms. "
            "A tie after the run would settle it."
        )
        drift, cov = 0.0, np.diag([variance, sigma_drift**2])
    else:
        spread = float((weight * x * x).sum())
        drift, cov = float((weight * x * y).sum()) / spread, np.diag([variance, 1.0 / spread])
        _check_line(t, y - middle - drift * x, weight, drift)
        if t.size > 2:
            notes.append(f"{t.size} ties fit a straight line.")
        else:
            notes.append("Two ties: a straight line always fits them; a third one would check it.")
    return ClockModel(
        offset_s=d0 + middle,
        drift=drift,
        reference_s=reference,
        cov=cov,
        jitter_s=jitter_s,
        source=f"{t.size} tie{'s' if t.size > 1 else ''} to GPS time",
        t_first_s=float(t[0]),
        t_last_s=float(t[-1]),
        notes=tuple(notes),
    )


def _check_line(t: ArrayF, residual: ArrayF, weight: ArrayF, drift: float) -> None:
    """Refuse a clock that was set in between, and ties that no straight line meets."""
    if abs(drift) > _WILD_DRIFT:
        step = drift * (t[-1] - t[0])
        words = explain_shift(step)
        raise ClockError(
            f"between the first and the last tie the offset changes by {step:+.3f} s ({drift * 1e6:+.0f} ppm"
            + (f"; {words})" if words else ")"),
            expected=f"less than {_WILD_DRIFT * 1e6:.0f} ppm: no quartz is so far off",
            cure="A tie was misread, or the clock was set in between; use the stretches of the run apart",
        )
    excess = float((weight * residual**2).sum())
    free = t.size - 2
    if free and excess > chi2.ppf(_PROBABILITY, free):
        worst = int(np.argmax(weight * residual**2))
        raise ClockError(
            f"{t.size} ties are not on a straight line: tie {worst + 1} is off by "
            f"{residual[worst] * 1e3:+.1f} ms, sigma {weight[worst] ** -0.5 * 1e3:.1f} ms",
            expected=f"a sum of squared standardised residuals below {chi2.ppf(_PROBABILITY, free):.1f}, "
            f"not {excess:.1f}",
            cure="Drop the tie if it was misread; state larger sigmas if the clock wanders",
        )
