"""Clocks that differ by whole hours, days or leap seconds: such a shift is set by hand, not by physics."""

from typing import Final

from thalweg.core.timescales import LEAP_TABLE

QUARTER_HOUR_S: Final = 900.0
"""Time zones are apart by multiples of it."""

_LEAP_S: Final = float(LEAP_TABLE[-1][1])
_DAY_S: Final = 86_400.0
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
    >>> explain_shift(1.7)
    ''
    """
    if abs(abs(shift_s) - _LEAP_S) <= min(1.0, tolerance_s):
        return f"{shift_s:+.0f} s: the leap seconds between GPS time and UTC"
    quarters = round(shift_s / QUARTER_HOUR_S)
    if quarters == 0 or abs(shift_s - quarters * QUARTER_HOUR_S) > tolerance_s:
        return ""
    if abs(shift_s) <= _LARGEST_ZONE_S + tolerance_s:
        return f"{hours_text(quarters * QUARTER_HOUR_S)} h: a time zone"
    days = round(shift_s / _DAY_S)
    if days and abs(shift_s - days * _DAY_S) <= _LARGEST_ZONE_S + tolerance_s:
        rest = quarters * QUARTER_HOUR_S - days * _DAY_S
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
