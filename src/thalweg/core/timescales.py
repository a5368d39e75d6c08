"""GPS time, and how UTC, Unix and week/second-of-week stamps come onto it.

One scale is used everywhere: ``t_gps_s``, LAS "adjusted standard GPS time", that is GPS seconds since
1980-01-06T00:00:00 minus 1e9. In float64 it resolves 60 ns at today's dates. GPS time has no leap
seconds; ``GPS - UTC`` is 18 s since 2017-01-01.
"""

import datetime as dt
import warnings
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core.errors import ClockError
from thalweg.core.types import ArrayF

GPS_EPOCH_UNIX_S: Final = 315_964_800
"""Unix time of 1980-01-06T00:00:00 UTC, the origin of GPS time."""

ADJUSTED_OFFSET_S: Final = 1_000_000_000
"""Subtracted from GPS seconds to give LAS adjusted standard GPS time (LAS 1.4 R15, global encoding bit 0)."""

WEEK_S: Final = 604_800
DAY_S: Final = 86_400

LEAP_TABLE: Final[tuple[tuple[str, int], ...]] = (
    ("1980-01-06", 0), ("1981-07-01", 1), ("1982-07-01", 2), ("1983-07-01", 3), ("1985-07-01", 4),
    ("1988-01-01", 5), ("1990-01-01", 6), ("1991-01-01", 7), ("1992-07-01", 8), ("1993-07-01", 9),
    ("1994-07-01", 10), ("1996-01-01", 11), ("1997-07-01", 12), ("1999-01-01", 13),
    ("2006-01-01", 14), ("2009-01-01", 15), ("2012-07-01", 16), ("2015-07-01", 17),
    ("2017-01-01", 18),
)  # fmt: skip
"""UTC date from which GPS - UTC has the given value in seconds (IERS Bulletin C)."""

LEAP_TABLE_VALID_UNTIL: Final = "2027-06-28"
"""Last day for which the table is known to be complete; later stamps warn (IERS leap-seconds.list)."""


class LeapSecondWarning(UserWarning):
    """A stamp lies behind the expiry of the leap-second table: GPS - UTC may be one second wrong."""


def _unix_of_date(date: str) -> int:
    return int(dt.datetime.fromisoformat(date).replace(tzinfo=dt.UTC).timestamp())


_LEAP_UNIX = np.array([_unix_of_date(date) for date, _ in LEAP_TABLE], dtype=np.float64)
_LEAP_VALUE = np.array([value for _, value in LEAP_TABLE], dtype=np.int64)
_LEAP_GPS = _LEAP_UNIX - GPS_EPOCH_UNIX_S + _LEAP_VALUE
_LEAP_EXPIRY_UNIX = _unix_of_date(LEAP_TABLE_VALID_UNTIL)


def gps_minus_utc(unix_s: ArrayLike) -> ArrayF:
    """GPS - UTC in seconds at the given UTC instants.

    Parameters
    ----------
    unix_s : UTC as Unix time, seconds; any shape.

    Raises
    ------
    ClockError : an instant lies before 1980-01-06.

    Examples
    --------
    >>> float(gps_minus_utc(1494614695.4))  # 2017-05-12
    18.0
    """
    unix = np.asarray(unix_s, dtype=np.float64)
    finite = unix[np.isfinite(unix)] if unix.ndim else np.atleast_1d(unix)
    if finite.size and np.min(finite) < GPS_EPOCH_UNIX_S:
        raise ClockError(
            f"UTC stamp {utc_text_from_unix(float(np.min(finite)))} lies before the GPS epoch",
            expected="a date after 1980-01-06",
            cure="Check the clock of the instrument or drop these records",
        )
    if finite.size and np.max(finite) > _LEAP_EXPIRY_UNIX:
        warnings.warn(
            f"Leap seconds are known until {LEAP_TABLE_VALID_UNTIL}, but the data reach "
            f"{utc_text_from_unix(float(np.max(finite)))}. Extend LEAP_TABLE in "
            "thalweg/core/timescales.py from IERS Bulletin C.",
            LeapSecondWarning,
            stacklevel=2,
        )
    index = np.clip(np.searchsorted(_LEAP_UNIX, unix, side="right") - 1, 0, None)
    return np.where(np.isfinite(unix), _LEAP_VALUE[index], np.nan).astype(np.float64)


def gps_from_unix(unix_s: ArrayLike, microseconds: ArrayLike = 0) -> ArrayF:
    """Adjusted standard GPS time from UTC Unix time.

    Whole seconds and microseconds may be given apart, so that no digit is lost (a Unix time in float64
    resolves 240 ns only).

    Examples
    --------
    >>> float(gps_from_unix(1494614695, 400000))  # 2017-05-12T18:44:55.4 UTC = week 1948, 499513.4 s
    178649913.4
    """
    unix = np.asarray(unix_s, dtype=np.float64)
    return (
        (unix - (GPS_EPOCH_UNIX_S + ADJUSTED_OFFSET_S))
        + gps_minus_utc(unix)
        + np.asarray(microseconds, dtype=np.float64) * 1e-6
    )


def unix_from_gps(t_gps_s: ArrayLike) -> ArrayF:
    """UTC as Unix time from adjusted standard GPS time (the inverse of `gps_from_unix`)."""
    t = np.asarray(t_gps_s, dtype=np.float64)
    gps = t + ADJUSTED_OFFSET_S
    index = np.clip(np.searchsorted(_LEAP_GPS, gps, side="right") - 1, 0, None)
    return t + (ADJUSTED_OFFSET_S + GPS_EPOCH_UNIX_S) - _LEAP_VALUE[index]


def gps_from_week(week: ArrayLike, tow_s: ArrayLike) -> ArrayF:
    """Adjusted standard GPS time from the full (not modulo 1024) GPS week and the second of the week.

    Examples
    --------
    >>> float(gps_from_week(1948, 499513.4))
    178649913.4
    """
    weeks = np.asarray(week, dtype=np.float64) * WEEK_S - ADJUSTED_OFFSET_S
    return np.asarray(weeks + np.asarray(tow_s, dtype=np.float64))


def week_from_gps(t_gps_s: ArrayLike) -> tuple[ArrayF, ArrayF]:
    """GPS week and second of the week from adjusted standard GPS time."""
    t = np.asarray(t_gps_s, dtype=np.float64)
    week = np.floor((t + ADJUSTED_OFFSET_S) / WEEK_S)
    return week, np.asarray(t - (week * WEEK_S - ADJUSTED_OFFSET_S))


def utc_text_from_unix(unix_s: float, digits: int = 3) -> str:
    """ISO 8601 text of a Unix time, for messages and tables; ``"?"`` where it is not a date."""
    try:
        whole = np.floor(unix_s)
        moment = dt.datetime.fromtimestamp(int(whole), dt.UTC)
    except (ValueError, OverflowError, OSError):
        return "?"
    if digits == 0:
        return f"{moment:%Y-%m-%dT%H:%M:%S}Z"
    fraction = f"{unix_s - whole:.{digits}f}"
    if fraction.startswith("1"):
        return utc_text_from_unix(float(whole) + 1.0, digits)
    return f"{moment:%Y-%m-%dT%H:%M:%S}{fraction[1:]}Z"


def utc_text_from_gps(t_gps_s: float, digits: int = 3) -> str:
    """ISO 8601 UTC text of an adjusted standard GPS time."""
    return utc_text_from_unix(float(unix_from_gps(t_gps_s)), digits) if np.isfinite(t_gps_s) else "?"
