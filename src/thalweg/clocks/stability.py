"""How evenly a camera takes its pictures, from photographs of a running clock (P2 6.1.2, Fig. 13).

P2 found 0.999 s between images with a standard deviation of 0.023 s, and took that as the error of every
image's time. Two clocks with the same 0.023 s are very different:

- *White stamps*: every exposure is off an even grid by its own error. Neighbouring intervals share one
  exposure and are correlated by -1/2. An image is off by ``std / sqrt 2`` (0.016 s), after an hour as after
  a second.
- *Wandering intervals*: every interval has its own error, which all later images keep. Intervals are
  independent, and after ``n`` images the count is off by ``std sqrt n`` (0.7 s after 1000).

The covariance of neighbouring intervals tells them apart: ``c0 = w^2 + 2 (s^2 + q^2)``, ``c1 = -(s^2 +
q^2)``, with the stamps' error ``s``, the intervals' ``w``, and the display's steps, ``q^2 = step^2 / 12`` a
reading.
"""

from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from thalweg.core import ArrayF, ClockError
from thalweg.ingest import weighted_median
from thalweg.settings.sections import DisplayTest

_LEAST_PAIRS: Final = 20
_FAR: Final = 0.25
"""Share of an interval by which it may differ from a multiple of the usual one and still be one."""
_BLOCKS: Final = 10
_DETERMINED: Final = 3.0
"""Sigmas by which a part must differ from zero to be told."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stability:
    """What a series of readings says about the camera's clock.

    Attributes
    ----------
    photographs, read, pairs : in all, read, and neighbours of which both were read.
    lost : photographs that the camera did not take, or that are missing, from intervals of several periods.
    mean_s, sigma_mean_s : mean interval and its sigma, with the wander that the test cannot exclude.
    std_s, sigma_std_s : standard deviation of single intervals, without the steps of the display, and its
        sigma.
    raw_std_s : the same with them; step_s : steps of the display.
    longest_s, shortest_s : of single intervals.
    lag_one, sigma_lag_one : correlation of neighbouring intervals without the steps of the display.
    stamp_jitter_s, sigma_stamp_jitter_s : error of an exposure about an even grid.
    wander_s, sigma_wander_s : error of an interval that all later exposures keep.
    kind : "white stamps", "wandering intervals", "both", or "not told" where pairs are too few.
    drift_ppm_per_h, sigma_drift_ppm_per_h : change of the mean interval over the test.
    image_error_s : error of an image's time if it has a stamp of an even grid.
    count_error_s : error after an hour if images are only counted from a first one, as far as the test can
        tell: wander that is too small to be told adds up.
    notes : sentences for people.
    """

    photographs: int
    read: int
    pairs: int
    lost: int
    mean_s: float
    sigma_mean_s: float
    std_s: float
    sigma_std_s: float
    raw_std_s: float
    step_s: float
    longest_s: float
    shortest_s: float
    lag_one: float
    sigma_lag_one: float
    stamp_jitter_s: float
    sigma_stamp_jitter_s: float
    wander_s: float
    sigma_wander_s: float
    kind: str
    drift_ppm_per_h: float
    sigma_drift_ppm_per_h: float
    image_error_s: float
    count_error_s: float
    notes: tuple[str, ...] = ()

    def facts(self) -> dict[str, Any]:
        """For a JSON file."""
        return asdict(self) | {"notes": list(self.notes)}


def clock_stability(t_s: ArrayF, *, step_s: float = DisplayTest().step_s) -> Stability:
    """Mean and standard deviation of the intervals, their sigmas, and what kind of error they have.

    Parameters
    ----------
    t_s : (n,) readings in the order of the photographs, NaN where there is none.
    step_s : step of the display; readings are its last step, so that each has an error of ``step / sqrt 12``.
        Neighbouring ones are independent if exposures scatter by a third of a step or more.

    Raises
    ------
    ClockError : too few neighbours were read.
    """
    t = np.asarray(t_s, dtype=np.float64)
    known = np.flatnonzero(np.isfinite(t))
    pair = np.isfinite(t[1:]) & np.isfinite(t[:-1])
    if pair.sum() < _LEAST_PAIRS:
        raise ClockError(
            f"{known.size} of {t.size} photographs were read, {int(pair.sum())} of them beside one another",
            expected=f"at least {_LEAST_PAIRS} neighbours",
            cure="Photograph the display without reflexes and with a short exposure, for some minutes",
        )
    interval = t[1:] - t[:-1]
    usual = weighted_median(interval[pair], np.ones(int(pair.sum())))
    if not usual > 0:
        raise ClockError(f"the display advances by {usual:.3f} s a photograph", expected="time that advances")
    times = np.rint(interval / usual)
    single = pair & (times == 1) & (np.abs(interval - usual) < _FAR * usual)
    if single.sum() < _LEAST_PAIRS:
        raise ClockError(
            f"{int(single.sum())} of {int(pair.sum())} intervals are near the usual {usual:.3f} s",
            expected="photographs at even intervals",
        )
    steps = np.rint(np.diff(t[known]) / usual)
    lost = int(np.maximum(steps - np.diff(known), 0).sum())
    return _described(t, known, interval, single, step_s, lost, float(steps.sum()))


def _described(
    t: ArrayF, known: Any, interval: ArrayF, single: Any, step_s: float, lost: int, count: float
) -> Stability:
    q2 = step_s**2 / 12.0
    values = interval[single]
    n = values.size
    centre = float(values.mean())
    off = np.where(single, interval - centre, np.nan)
    c0 = float(np.square(values - centre).sum() / (n - 1))
    together = single[1:] & single[:-1]
    m = int(together.sum())
    c1 = float((off[1:][together] * off[:-1][together]).mean()) if m else float("nan")
    told = m >= _LEAST_PAIRS
    rho = float(np.clip(c1 / c0, -0.5, 0.5)) if told and c0 > 0 else 0.0
    # Bartlett: variances of estimated covariances of a moving average of order one
    var_c0 = 2.0 * c0**2 * (1 + 2 * rho**2) / n
    var_c1 = c0**2 * (1 + 3 * rho**2) / max(m, 1)
    cov_01 = 4.0 * c0**2 * rho / n
    variance = max(c0 - 2 * q2, 0.0)
    std = float(np.sqrt(variance))
    stamp2, wander2 = -c1 - q2, c0 + 2 * c1
    sigma_stamp2, sigma_wander2 = np.sqrt(var_c1), np.sqrt(max(var_c0 + 4 * var_c1 + 4 * cov_01, 0.0))
    # a wander that is too small to be told still adds up over thousands of images
    bound2 = max(wander2, 0.0) + float(sigma_wander2)
    # Bartlett again: the correlation of neighbours scatters by 0.71 / sqrt m about -1/2, by 1 / sqrt m about
    # 0
    neighbours = (c1 + q2) / variance if told and variance > 0 else 0.0
    white = told and neighbours + 0.5 < _DETERMINED * np.sqrt(0.5 / m)
    drifting = told and -neighbours < _DETERMINED * np.sqrt(1.0 / m)
    kind = {(True, False): "white stamps", (False, True): "wandering intervals", (False, False): "both"}.get(
        (bool(white), bool(drifting)), "not told"
    )
    kind = kind if told else "not told"
    if white and not drifting:
        stamp2, wander2 = variance / 2, 0.0
    elif drifting and not white:
        stamp2, wander2 = 0.0, variance
    stamp, wander = float(np.sqrt(max(stamp2, 0.0))), float(np.sqrt(max(wander2, 0.0)))
    sigma_std = float(np.sqrt(var_c0)) / (2 * std) if std > 0 else float("nan")
    # over all periods from the first to the last photograph that was read
    mean = float((t[known[-1]] - t[known[0]]) / count)
    sigma_mean = (
        float(np.sqrt(bound2 * count + 2 * (max(stamp2, 0.0) + q2)) / count) if told else float("nan")
    )
    drift, sigma_drift = _drift(t, interval, single, centre, wander, stamp, q2)
    per_hour = 3600.0 / mean
    return Stability(
        photographs=int(t.size),
        read=int(known.size),
        pairs=n,
        lost=lost,
        mean_s=mean,
        sigma_mean_s=sigma_mean,
        std_s=std,
        sigma_std_s=sigma_std,
        raw_std_s=float(np.sqrt(c0)),
        step_s=step_s,
        longest_s=float(values.max()),
        shortest_s=float(values.min()),
        lag_one=float(neighbours) if told else float("nan"),
        sigma_lag_one=float(np.sqrt(max(1 - 3 * rho**2 + 4 * rho**4, 0.0) / max(m, 1))),
        stamp_jitter_s=stamp,
        sigma_stamp_jitter_s=_sigma_of_root(stamp2, float(sigma_stamp2)),
        wander_s=wander,
        sigma_wander_s=_sigma_of_root(wander2, float(sigma_wander2)),
        kind=kind,
        drift_ppm_per_h=drift,
        sigma_drift_ppm_per_h=sigma_drift,
        image_error_s=stamp if kind == "white stamps" else float(np.hypot(stamp, wander)),
        count_error_s=float(np.sqrt(max(stamp2, 0.0) + bound2 * per_hour)) if told else float("nan"),
        notes=_notes(kind, std, stamp, wander, per_hour, lost, drift, sigma_drift, step_s),
    )


def _drift(
    t: ArrayF, interval: ArrayF, single: Any, centre: float, wander: float, stamp: float, q2: float
) -> tuple[float, float]:
    """Change of the mean interval, ppm an hour, from the means of blocks, with its sigma."""
    at = np.flatnonzero(single)
    blocks = [block for block in np.array_split(at, _BLOCKS) if block.size >= 2]
    if len(blocks) < 3:
        return float("nan"), float("nan")
    x = np.array([t[block].mean() for block in blocks])
    y = np.array([interval[block].mean() for block in blocks])
    size = np.array([float(block.size) for block in blocks])
    # where all neighbours were read the sum telescopes; gaps leave two free ends each
    ends = np.array([float(1 + (np.diff(block) > 1).sum()) for block in blocks])
    variance = wander**2 / size + 2 * (stamp**2 + q2) * ends / size**2
    w = 1.0 / variance
    x = x - np.average(x, weights=w)
    spread = float((w * x * x).sum())
    slope = float((w * x * y).sum()) / spread
    return slope / centre * 1e6 * 3600.0, spread**-0.5 / centre * 1e6 * 3600.0


def _sigma_of_root(variance: float, sigma: float) -> float:
    """Standard deviation of a root; near zero what the root of the upper end is."""
    if variance > sigma:
        return float(sigma / (2 * np.sqrt(variance)))
    return float(np.sqrt(max(variance, 0.0) + sigma) - np.sqrt(max(variance, 0.0)))


def _notes(
    kind: str,
    std: float,
    stamp: float,
    wander: float,
    per_hour: float,
    lost: int,
    drift: float,
    sigma: float,
    step_s: float,
) -> tuple[str, ...]:
    out = []
    if kind == "white stamps":
        out.append(
            f"Neighbouring intervals share an exposure: the time of an image is off by {stamp * 1e3:.1f} ms, "
            f"not by the {std * 1e3:.1f} ms of an interval, and this does not grow."
        )
    elif kind == "wandering intervals":
        out.append(
            "Intervals are independent: images that are only counted are off by "
            f"{wander * per_hour**0.5:.2f} s after an hour. Each image needs a time stamp of its own."
        )
    elif kind == "both":
        out.append(
            f"Exposures scatter by {stamp * 1e3:.1f} ms about a grid that wanders by {wander * 1e3:.1f} ms "
            "an image."
        )
    else:
        out.append("Too few neighbours in a row to tell white stamps from wandering intervals.")
    if 0 < stamp < step_s / 3:
        out.append(
            f"The display's steps of {step_s * 1e3:.0f} ms are more than three times the scatter of the "
            "exposures: use a faster display."
        )
    if lost:
        out.append(f"{lost} photographs are missing: intervals of several periods.")
    if np.isfinite(drift) and abs(drift) > 3 * sigma:
        out.append(f"The mean interval changes by {drift:+.0f} ppm an hour (sigma {sigma:.0f}).")
    return tuple(out)
