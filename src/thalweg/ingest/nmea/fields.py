"""Values out of NMEA fields: times, dates, coordinates, qualities, depths."""

import datetime as dt
from typing import Final

from thalweg.core.timescales import DAY_S
from thalweg.ingest.stamps import possible_unix

FOOT_M: Final = 0.3048
FATHOM_M: Final = 1.8288

FIX_OF_QUALITY: Final = {
    "0": "none", "1": "single", "2": "dgnss", "3": "single", "4": "fixed", "5": "float",
    "6": "dead_reckoning", "7": "none", "8": "none", "9": "sbas",
}  # fmt: skip
"""GGA field 6 -> fix; 7 is manual input, 8 a simulator, 9 SBAS in NovAtel receivers."""

FIX_OF_MODE: Final = {
    "A": "single", "D": "dgnss", "R": "fixed", "F": "float", "P": "single", "E": "dead_reckoning",
    "M": "none", "S": "none", "N": "none", "": "single",
}  # fmt: skip
"""Mode indicator of RMC and GLL (NMEA 2.3) -> fix; older sentences have none."""

_UNIX_ORDINAL: Final = dt.date(1970, 1, 1).toordinal()


def second_of_day(text: str) -> float:
    """Second of the day from hhmmss[.sss]; 86400 and above inside a leap second.

    Raises
    ------
    ValueError : not such a time.
    """
    if len(text) < 6 or not text[:6].isdecimal():
        raise ValueError(text)
    hour, minute, second = int(text[:2]), int(text[2:4]), float(text[4:])
    if hour > 23 or minute > 59 or second >= 61:
        raise ValueError(text)
    return hour * 3600 + minute * 60 + second


def days_of_date(day: int, month: int, year: int) -> int:
    """Days since 1970-01-01; a year of two digits is 1980 to 2057.

    Raises
    ------
    ValueError : no date, or one at which no survey can have been made.
    """
    if year < 100:
        year += 1900 if year >= 80 else 2000
    days = dt.date(year, month, day).toordinal() - _UNIX_ORDINAL
    if not possible_unix(days * DAY_S):
        raise ValueError(year)
    return days


def degrees(text: str, side: str) -> float:
    """Degrees from (d)ddmm.mmmm and N, S, E or W.

    Raises
    ------
    ValueError : not such an angle, or out of range.
    """
    value = float(text)
    whole = int(value / 100)
    angle = whole + (value - 100 * whole) / 60
    limit = {"N": 90, "S": 90, "E": 180, "W": 180}.get(side, -1)
    if not (0 <= angle <= limit and value - 100 * whole < 60):
        raise ValueError(text)
    return -angle if side in "SW" else angle


def number(fields: list[str], index: int) -> float:
    """A number; NaN where the field is empty or not there.

    Raises
    ------
    ValueError : something else than a finite number.
    """
    if index >= len(fields) or not fields[index].strip():
        return float("nan")
    value = float(fields[index])
    if value - value != 0:
        raise ValueError(fields[index])
    return value


def below_depth(fields: list[str]) -> float:
    """Depth in metres of DBT or DBS: the metres if given, else feet, else fathoms; NaN if none.

    Raises
    ------
    ValueError : a unit letter is not the one of its field.
    """
    for at, letter, unit_m in ((3, "M", 1.0), (1, "f", FOOT_M), (5, "F", FATHOM_M)):
        value = number(fields, at)
        if value == value:
            if fields[at + 1 : at + 2] != [letter]:
                raise ValueError(fields)
            return value * unit_m
    return float("nan")
