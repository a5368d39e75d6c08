"""What the stamps of a stream say about its clock: period, jitter, offset, drift, and times without GPS."""

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import (
    ADJUSTED_OFFSET_S,
    DAY_S,
    GPS_EPOCH_UNIX_S,
    LEAP_TABLE,
    LEAP_TABLE_VALID_UNTIL,
    NMAD,
    WEEK_S,
    ArrayB,
    ArrayF,
    InputError,
    gps_from_unix,
    gps_from_week,
    unix_from_gps,
    utc_text_from_unix,
)

FIRST_UNIX_S: Final = GPS_EPOCH_UNIX_S
LAST_UNIX_S: Final = (
    dt.datetime.fromisoformat(LEAP_TABLE_VALID_UNTIL).replace(tzinfo=dt.UTC).timestamp() + 30 * 31_557_600
)
"""No survey was made before GPS time began, nor 30 years behind the last known leap second."""

_LEAST_FIT: Final = 4
"""Pairs of stamps without which no drift is fitted."""
_FIT_BLOCKS: Final = 20
_LONGEST_STEP: Final = 10.5
"""Steps of more periods are holes and say nothing of jitter."""


@dataclass(slots=True, kw_only=True)
class StreamTiming:
    """The clock of one stream; None where the log does not tell.

    Attributes
    ----------
    period_s : nominal step from stamp to stamp.
    jitter_s, jitter_max_s : robust standard deviation (NMAD) and largest of the steps' deviations from whole
        periods, as far as the stamps resolve them.
    resolution_s : unit of the stamps.
    clock : which other clock the log also shows: ``host`` (the logger's) or ``device`` (free-running).
    clock_offset_s, sigma_clock_offset_s : that clock minus UTC, in the middle of the log, and its sigma.
    clock_drift_ppm, sigma_clock_drift_ppm : how much faster that clock runs than GPS, and its sigma.
    clock_set_s : how far the stream's own clock jumped when it got GPS time.
    pps_locked_share : share of the recorded time with a locked PPS.
    pps_unlocked_start_s : time without it before it locked first.
    pps_losses : how often it was lost afterwards.
    unsynchronised_s : recorded time that has no GPS time.
    unsynchronised : from and to of these times, placed on GPS time against their neighbours.
    """

    period_s: float | None = None
    jitter_s: float | None = None
    jitter_max_s: float | None = None
    resolution_s: float | None = None
    clock: str = ""
    clock_offset_s: float | None = None
    sigma_clock_offset_s: float | None = None
    clock_drift_ppm: float | None = None
    sigma_clock_drift_ppm: float | None = None
    clock_set_s: float | None = None
    pps_locked_share: float | None = None
    pps_unlocked_start_s: float | None = None
    pps_losses: int | None = None
    unsynchronised_s: float | None = None
    unsynchronised: list[tuple[float, float]] = field(default_factory=list)

    def describe_stamps(self, t_s: ArrayLike, resolution_s: float | None = None) -> None:
        """Take period and jitter from stamps (n,); NaN, repeated stamps and steps back are left out.

        Parameters
        ----------
        t_s : (n,) in the order of the log.
        resolution_s : unit of the stamps, if the format tells.
        """
        t = np.asarray(t_s, dtype=np.float64)
        step = np.diff(t[np.isfinite(t)])
        step = step[step > 0]
        if resolution_s is not None:
            self.resolution_s = resolution_s
        if step.size < 2:
            return
        self.describe_steps(step, np.ones(step.size))

    def describe_steps(self, step_s: ArrayF, n: ArrayF) -> None:
        """The same from positive steps (k,) and how often each occurred (k,)."""
        middle = weighted_median(step_s, n)
        period = regular_period(step_s, n, middle)
        # over a long hole the rounding of the period itself would count
        short = step_s < _LONGEST_STEP * period
        step_s, n = step_s[short], n[short]
        off = np.abs(step_s - np.rint(step_s / period) * period)
        self.period_s = period
        self.jitter_s = NMAD * weighted_median(off, n)
        self.jitter_max_s = float(off.max())

    def describe_host(self, t_gps_s: ArrayF, t_host_s: ArrayF) -> None:
        """Take offset and drift of the logger's clock (n,), in Unix time, against GPS times (n,)."""
        known = np.isfinite(t_gps_s) & np.isfinite(t_host_s)
        fit = fit_clock(unix_from_gps(t_gps_s[known]), t_host_s[known])
        if fit is None:
            return
        self.clock = "host"
        self.clock_offset_s, self.sigma_clock_offset_s = fit.offset_s, _number(fit.sigma_offset_s)
        self.clock_drift_ppm, self.sigma_clock_drift_ppm = (
            _number(fit.drift_ppm),
            _number(fit.sigma_drift_ppm),
        )

    def place_unsynchronised(self, t_device_s: ArrayLike, t_gps_s: ArrayLike) -> None:
        """Stretches of stamps without GPS time: their length by the device, their place by the neighbours.

        Parameters
        ----------
        t_device_s : (n,) the device's clock, in the order of the log.
        t_gps_s : (n,) NaN where there is no GPS time.
        """
        device, gps = np.asarray(t_device_s, np.float64), np.asarray(t_gps_s, np.float64)
        self.unsynchronised, self.unsynchronised_s = [], 0.0
        for first, stop in _stretches(~np.isfinite(gps)):
            length = max(float(device[stop - 1] - device[first]), 0.0) + (self.period_s or 0.0)
            self.unsynchronised_s += length
            if first > 0:
                begin = float(gps[first - 1])
                end = float(gps[stop]) if stop < len(gps) else begin + length
            elif stop < len(gps):
                end = float(gps[stop])
                begin = end - length
            else:
                continue
            self.unsynchronised.append((begin, max(end, begin)))


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockFit:
    """A clock against another: ``clock - reference = offset + drift (t - middle)``.

    ``sigma_*`` are NaN where a straight line explains everything for want of pairs.
    """

    offset_s: float
    sigma_offset_s: float
    drift_ppm: float
    sigma_drift_ppm: float
    n: int


def fit_clock(reference_s: ArrayLike, clock_s: ArrayLike) -> ClockFit | None:
    """Offset and drift of a clock from pairs of simultaneous stamps, with sigmas.

    Stamps are late by transport, in bursts: residuals are correlated. The sigmas are those of a straight line
    through medians of up to 20 blocks of pairs, whose scatter holds what neighbouring pairs share.

    Parameters
    ----------
    reference_s, clock_s : (n,) pairs; NaN are left out.

    Returns
    -------
    None with fewer than one pair; offset only (drift NaN) with fewer than four.
    """
    t, c = np.asarray(reference_s, np.float64), np.asarray(clock_s, np.float64)
    known = np.isfinite(t) & np.isfinite(c)
    t, d = t[known], (c - t)[known]
    order = np.argsort(t, kind="stable")
    t, d = t[order], d[order]
    nan = float("nan")
    if not t.size:
        return None
    if t.size < _LEAST_FIT or t[-1] <= t[0]:
        return ClockFit(
            offset_s=float(np.median(d)), sigma_offset_s=nan, drift_ppm=nan, sigma_drift_ppm=nan, n=t.size
        )
    blocks = np.array_split(np.arange(t.size), min(_FIT_BLOCKS, t.size))
    # near zero: clocks that are years apart, multiplied by rounded times, would make a drift of their own
    t0, d0 = t[0], float(np.median(d))
    x = np.array([(t[b] - t0).mean() for b in blocks])
    y = np.array([np.median(d[b] - d0) for b in blocks])
    centre, x = float(x.mean()), x - x.mean()
    middle, spread = float(y.mean()), float(np.square(x).sum())
    slope = float((x * y).sum() / spread)
    scatter = float(np.square(y - middle - slope * x).sum() / (len(y) - 2))
    return ClockFit(
        offset_s=d0 + middle + slope * (float((t - t0).mean()) - centre),
        sigma_offset_s=float(np.sqrt(scatter / len(y))),
        drift_ppm=slope * 1e6,
        sigma_drift_ppm=float(np.sqrt(scatter / spread)) * 1e6,
        n=t.size,
    )


def possible_unix(unix_s: ArrayLike) -> ArrayB:
    """False for UTC stamps at which no survey can have been made: before 1980, or after 2057."""
    unix = np.asarray(unix_s, dtype=np.float64)
    return np.asarray((unix >= FIRST_UNIX_S) & (unix <= LAST_UNIX_S))


def weighted_median(values: ArrayF, n: ArrayF) -> float:
    """Median of values (k,) that occurred n (k,) times each."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(n[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])


def regular_period(step_s: ArrayF, n: ArrayF, middle_s: float) -> float:
    """Period of a regular stream: mean of the steps near the median, whose rounding averages out."""
    near = np.abs(step_s - middle_s) < 0.25 * middle_s
    return float(np.average(step_s[near], weights=n[near]))


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _stretches(mark: ArrayB) -> list[tuple[int, int]]:
    """Begin and end (exclusive) of the runs of true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mark, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


# ---------------------------------------------------------------- Clocks that differ by whole hours, days
# or leap seconds: such a shift is set by hand, not by physics


QUARTER_HOUR_S: Final = 900.0
"""Time zones are apart by multiples of it."""

_LEAP_S: Final = float(LEAP_TABLE[-1][1])
_OLD_LEAP_TOLERANCE_S: Final = 0.02
"""An ordinary offset is this near to a whole second by chance in 4 of 100 clocks."""
_ROLLOVER_S: Final = 1024.0 * WEEK_S
_LARGEST_ZONE_S: Final = 14 * 3600.0
_TOLERANCE_S: Final = 30.0


def explain_shift(shift_s: float, tolerance_s: float = _TOLERANCE_S) -> str:
    """What a shift between two clocks probably is, in words; empty if it looks like an ordinary offset.

    Parameters
    ----------
    shift_s : one clock minus the other, seconds.
    tolerance_s : how far a shift may be from whole quarters of an hour.

    Examples
    --------
    >>> explain_shift(7200.4)
    '+2:00 h: a time zone'
    >>> explain_shift(-18.0)
    '-18 s: the leap seconds between GPS time and UTC'
    >>> explain_shift(-3.0)
    '-3 s: leap seconds that one of the clocks does not know'
    >>> explain_shift(619_315_200.2)
    '+1024 weeks: the week counter of a receiver rolled over'
    >>> explain_shift(1.7)
    ''
    """
    turns = round(shift_s / _ROLLOVER_S)
    rest_s = shift_s - turns * _ROLLOVER_S
    if turns and abs(rest_s) <= _LARGEST_ZONE_S + tolerance_s:
        more = explain_shift(rest_s, tolerance_s)
        if more or abs(rest_s) <= tolerance_s:
            weeks = f"{1024 * turns:+d} weeks: the week counter of a receiver rolled over"
            return f"{weeks}; {more}" if more else weeks
    seconds = round(abs(shift_s))
    if abs(abs(shift_s) - _LEAP_S) <= min(1.0, tolerance_s):
        return f"{shift_s:+.0f} s: the leap seconds between GPS time and UTC"
    if 1 <= seconds < _LEAP_S and abs(abs(shift_s) - seconds) <= min(_OLD_LEAP_TOLERANCE_S, tolerance_s):
        return f"{shift_s:+.0f} s: leap seconds that one of the clocks does not know"
    quarters = round(shift_s / QUARTER_HOUR_S)
    if quarters == 0 or abs(shift_s - quarters * QUARTER_HOUR_S) > tolerance_s:
        return ""
    if abs(shift_s) <= _LARGEST_ZONE_S + tolerance_s:
        return f"{hours_text(quarters * QUARTER_HOUR_S)} h: a time zone"
    days = round(shift_s / DAY_S)
    if days and abs(shift_s - days * DAY_S) <= _LARGEST_ZONE_S + tolerance_s:
        rest = quarters * QUARTER_HOUR_S - days * DAY_S
        more = f" and {hours_text(rest)} h" if rest else ""
        return f"{days:+d} day(s){more}: the date of a clock is wrong"
    return ""


def hours_text(seconds: float) -> str:
    """Signed hours and minutes.

    Examples
    --------
    >>> hours_text(-5400.0)
    '-1:30'
    """
    minutes = round(abs(seconds) / 60.0)
    return f"{'-' if seconds < 0 else '+'}{minutes // 60}:{minutes % 60:02d}"


# ---------------------------------------------------------------- Bare numbers: which unit and scale of time


_FIRST_TOLD_S: Final = dt.datetime(2000, 1, 1, tzinfo=dt.UTC).timestamp()
_LAST_TOLD_S: Final = dt.datetime.fromisoformat(LEAP_TABLE_VALID_UNTIL).replace(tzinfo=dt.UTC).timestamp()
"""Dates by which a scale is told first: few digital surveys before 2000, none after this version."""
_MOST: Final = (0.005, 0.995)
"""A damaged stamp or two of a long log do not hide the scale of the others."""

TIME_SCALES: Final = {
    "unix_s": "seconds since 1970 (Unix time)",
    "unix_ms": "milliseconds since 1970",
    "unix_us": "microseconds since 1970",
    "unix_ns": "nanoseconds since 1970",
    "gps_s": "GPS seconds since 1980",
    "adjusted_s": "adjusted standard GPS time (GPS seconds since 1980 less 1e9)",
    "week_s": "seconds of an unstated GPS week",
    "day_s": "seconds of an unstated day",
}
"""Scales on which a file may count its times -> words."""
UNITS_A_SECOND: Final = {"unix_ms": 1e3, "unix_us": 1e6, "unix_ns": 1e9}
"""Scales of `TIME_SCALES` that do not count seconds -> how many of them make one."""
_ZERO_UNIX_S: Final = {
    **dict.fromkeys(("unix_s", "unix_ms", "unix_us", "unix_ns"), 0.0),
    "gps_s": float(GPS_EPOCH_UNIX_S),
    "adjusted_s": float(GPS_EPOCH_UNIX_S + ADJUSTED_OFFSET_S),
}
"""Scales that tell the date -> Unix time of their zero, but for leap seconds."""


def gps_from_scale(values: ArrayLike, scale: str) -> ArrayF:
    """Adjusted standard GPS time of bare numbers on a scale of `TIME_SCALES` that tells the date.

    NaN where no survey can have been made at that time, as at a zero that stands for no time.

    Raises
    ------
    InputError : the scale holds seconds of a week or a day that nobody states.

    Examples
    --------
    >>> gps_from_scale([1718186400000], "unix_ms").tolist()  # 2024-06-12T10:00:00Z
    [402221618.0]
    """
    if scale not in _ZERO_UNIX_S:
        raise InputError(
            f"the times are {TIME_SCALES[scale]}", expected="times with their date", cure="State the date"
        )
    t = np.asarray(values, dtype=np.float64) / UNITS_A_SECOND.get(scale, 1.0)
    t = np.where((t != 0) & possible_unix(t + _ZERO_UNIX_S[scale]), t, np.nan)
    if scale.startswith("unix"):
        return gps_from_unix(t)
    return t if scale == "adjusted_s" else gps_from_week(0, t)


def tell_time_scale(values: ArrayLike) -> tuple[str, ...]:
    """Scales of `TIME_SCALES` on which bare numbers are times of surveys, by their size.

    One scale: told. Several: ambiguous, ask (`time_scale_words` says what each would mean). None: no times.
    Zeros beside other values stand for none.

    Examples
    --------
    >>> tell_time_scale([1718186400, 1718186401])
    ('unix_s',)
    >>> tell_time_scale([1718186400_000])
    ('unix_ms',)
    >>> tell_time_scale([402221618.0])
    ('adjusted_s',)
    >>> tell_time_scale([1.4e9])  # 2014 or 2024
    ('unix_s', 'gps_s')
    >>> tell_time_scale([295218.0])
    ('week_s',)
    >>> tell_time_scale([36000.0])
    ('week_s', 'day_s')
    >>> tell_time_scale([0.0, 0.0])
    ()
    """
    span = _span(values)
    if span is None:
        return ()
    low, high = span
    if low >= 0 and high <= WEEK_S:  # also adjusted times of one week of 2011
        return ("week_s", "day_s") if high <= DAY_S else ("week_s",)
    told: tuple[str, ...] = ()
    for first, last in ((_FIRST_TOLD_S, _LAST_TOLD_S), (FIRST_UNIX_S, LAST_UNIX_S)):
        told = told or tuple(
            scale
            for scale in _ZERO_UNIX_S
            if _rough_unix_s(low, scale) >= first and _rough_unix_s(high, scale) <= last
        )
    return told


def time_scale_words(values: ArrayLike, scales: Sequence[str]) -> str:
    """What each of several scales would make of the first of some bare numbers.

    Examples
    --------
    >>> time_scale_words([1.4e9], ("unix_s", "gps_s"))
    '1400000000 is 2014-05-13 in seconds since 1970 (Unix time), 2024-05-17 in GPS seconds since 1980'
    """
    t = np.asarray(values, dtype=np.float64).ravel()
    t = t[np.isfinite(t) & (t != 0)]
    if not t.size:
        return "no time is written"
    each = []
    for scale in scales:
        date = f"{utc_text_from_unix(_rough_unix_s(t[0], scale))[:10]} " if scale in _ZERO_UNIX_S else ""
        each.append(f"{date}in {TIME_SCALES[scale]}")
    return f"{t[0]:.15g} is {', '.join(each) or 'a time of a survey on no known scale'}"


def time_contradiction(values: ArrayLike, stated: str) -> str:
    """How bare numbers contradict the scale that their file states; empty if they suit it.

    Parameters
    ----------
    values : as they stand in the file.
    stated : scale of `TIME_SCALES`.

    Examples
    --------
    >>> time_contradiction([402221618.0], "adjusted_s")
    ''
    >>> time_contradiction([295218.0, 295219.0], "adjusted_s")
    '295218 .. 295219 are seconds of an unstated GPS week'
    >>> time_contradiction([402221618.0], "week_s")
    '402221618 .. 402221618 are adjusted standard GPS time (GPS seconds since 1980 less 1e9)'
    >>> time_contradiction([0.0, 0.0], "adjusted_s")
    'all times are 0: none was recorded'
    """
    span = _span(values)
    if span is None:
        return "all times are 0: none was recorded" if np.size(values) else "there is no time"
    low, high = span
    told = tell_time_scale(values)
    if stated in told:
        return ""
    if stated in ("week_s", "day_s"):  # files run on behind the end of a week or a day
        suits = low >= 0 and high <= 2 * (WEEK_S if stated == "week_s" else DAY_S)
    else:
        dates = [_rough_unix_s(value, stated) for value in (low, high)]
        suits = not told and bool(possible_unix(dates).all())
    if suits:
        return ""
    found = " or ".join(TIME_SCALES[scale] for scale in told) or "no times of a survey on any known scale"
    return f"{low:.15g} .. {high:.15g} are {found}"


def _rough_unix_s(value: float, scale: str) -> float:
    """UTC but for leap seconds of a number on a scale that tells the date."""
    return value / UNITS_A_SECOND.get(scale, 1.0) + _ZERO_UNIX_S[scale]


def doubtful_date(t_gps_s: ArrayLike) -> str:
    """What is wrong with the dates of a stream before 2000 or years ahead; empty if they are of a survey.

    Examples
    --------
    >>> doubtful_date(gps_from_week(2318 - 2048, 295218.0))  # doctest: +NORMALIZE_WHITESPACE
    'The first time is 1985-03-13. A week counter that rolled over? 1024 weeks later is 2004-10-27,
    2048 weeks later 2024-06-12.'
    >>> doubtful_date(gps_from_week(2318, 295218.0))
    ''
    """
    t = np.asarray(t_gps_s, dtype=np.float64).ravel()
    t = t[np.isfinite(t)]
    if not t.size:
        return ""
    first = float(unix_from_gps(t.min()))
    if _FIRST_TOLD_S <= first <= _LAST_TOLD_S:
        return ""
    date, *later = (utc_text_from_unix(first + turns * _ROLLOVER_S)[:10] for turns in range(3))
    if first > _LAST_TOLD_S:
        return f"The first time is {date}, in the future."
    return (
        f"The first time is {date}. A week counter that rolled over? 1024 weeks later is {later[0]}, "
        f"2048 weeks later {later[1]}."
    )


def _span(values: ArrayLike) -> tuple[float, float] | None:
    """Smallest and largest of nearly all values; None if there are none but 0 and NaN."""
    t = np.asarray(values, dtype=np.float64).ravel()
    t = t[np.isfinite(t) & (t != 0)]
    if not t.size:
        return None
    low, high = np.quantile(t, _MOST, method="nearest")
    return float(low), float(high)
