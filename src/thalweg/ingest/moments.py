"""Times as people and programs write them in tables: texts and bare numbers to Unix time.

What a text states of its date and zone decides. Without a zone it counts as UTC, which is noted; days and
months that may be exchanged are refused.
"""

import contextlib
import datetime as dt
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np
import pandas as pd

from thalweg.core import DAY_S, LEAP_TABLE_VALID_UNTIL, ArrayF, InputError, unix_from_gps
from thalweg.ingest.stamps import (
    TIME_SCALES,
    gps_from_scale,
    possible_unix,
    tell_time_scale,
    time_scale_words,
)

CLOCK: Final = r"\d{1,2}:\d\d(?::\d\d(?:[.,]\d*)?)?(?: ?[aApP]\.?[mM]\.?)?"
"""A time of the day."""
_DAY: Final = r"^(\d{1,2})([./-])(\d{1,2})[./-](\d{4}|\d\d)(.*)$"
"""A day before its month, or the other way round, and what stands behind."""
_WORDED: Final = re.compile(
    r"(?i)\d ?[ap]\.?m\.?$|[-/ ](?:jan|feb|mar|apr|may|jun|jul|aug|sep|oct|nov|dec)[a-z]*[-/ ]"
)
"""Clocks of twelve hours, and months by name."""
_WITH_YEAR: Final = re.compile(r"(?i)\b(?:19|20)\d\d\b|\d[-/ ][a-z]{3,}[-/ ]\d\d(?![:\d])")
"""Without it the day of the reading would be taken."""
_LAST_YEAR: Final = int(LEAP_TABLE_VALID_UNTIL[2:4])
"""Of two digits, that a date of a survey may have."""
_HOURS: Final = (
    "0 UTC GMT Z|1 CET MEZ|2 CEST MESZ EET|3 EEST|9 JST|10 AEST|11 AEDT|12 NZST|13 NZDT|-4 EDT|-5 EST CDT|"
    "-6 MDT|-7 MST PDT|-8 PST"
)
_ZONES: Final = {name: float(first) for first, *names in map(str.split, _HOURS.split("|")) for name in names}
"""Names of zones of time that mean one of them -> hours before UTC."""
_OFFSET: Final = re.compile(
    r"(?:\b(?:UTC|GMT)\s?|^)([+-])\s?(1[0-4]|0?\d)(?::?([0-5]\d)|\.(\d+))?\s?(?:h|hours?)?(?!\w)"
)
_ZONE_BEHIND: Final = re.compile(r" ?(?<![A-Za-z])([A-Z]{1,5})(?: ?([+-])(\d\d?)(?::?(\d\d))?)?$")
"""A zone behind a time: CEST, Z, and GMT+0200, whose sign other readers turn round."""
_OTHER_CLOCK: Final = re.compile(
    r"(?i:gps|local|lokal|ortszeit|sommer|winter|summer|standard|daylight|pacific|eastern|mountain|central|\btai\b|"
    r"(?<=\()(?!u|z)(?:[a-z]{1,3}t|msk)(?=\)))|(?i:zone|zeitzone)\W+(?!UTC|GMT)[A-Z]{2,4}\b|\bMES?Z\b|\bCES?T\b"
)
"""Words beside times that mean another clock than UTC, which nobody can tell from them."""
_OF_CLOCKS: Final = re.compile(r"(?i)time|zone|uhr|zeit|heure|hora\b")
"""Remarks that may say which clock times are of."""
_DAY_COUNTS: Final = {
    "days since 1899-12-30 (Excel)": 25_569.0,
    "modified Julian days": 40_587.0,
    "days since the year 0 (MATLAB)": 719_529.0,
    "Julian days": 2_440_587.5,
}
"""Counts of days -> their number on 1970-01-01."""
_FEWEST_STEP: Final = 0.005
"""No sounder and no receiver writes rows of a table so fast, in seconds: smaller steps are days."""

Texts: TypeAlias = "pd.Series[str]"
"""Texts (n,), one a row."""


def unix_of_texts(
    texts: Texts, name: str, *, remarks: Sequence[str], zones: tuple[str, Texts] | None, where: Path
) -> tuple[ArrayF, list[str]]:
    """Unix time (n,) of times with a date, NaN where there is none, and what was assumed.

    Parameters
    ----------
    texts : each with date and time, or numbers on a scale of `TIME_SCALES` or that count days.
    name : of their column.
    remarks : of the file, which may state a zone.
    zones : name of the column with the zone of each row, and its texts.
    where : file, for messages.

    Raises
    ------
    InputError : days and months that may be exchanged, or a zone that is not known.
    """
    number = pd.to_numeric(texts, errors="coerce").to_numpy(np.float64)
    unread = f"column {name} is not read: '{texts.iloc[0] if len(texts) else ''}' is no time with a date"
    if np.isfinite(number).mean() > 0.5:
        return _unix_of_numbers(number, name) or (np.full(len(texts), np.nan), [unread])
    text = texts.str.replace(r" (?:\([\w ]+\)|[A-Z][a-z]+/\w+)$", "", regex=True)
    text = text.str.replace(_ZONE_BEHIND, _offset_of, regex=True)
    notes = []
    found = text.str.extract(_DAY)
    if found[0].notna().mean() > 0.5:
        text = _iso(text, found, where)
        if found[3].str.len().eq(2).any():
            notes.append(f"dates such as {texts.iloc[0]} taken as {text.iloc[0][:10]}")
    if text.str.contains(_WORDED).all() and text.str.contains(_WITH_YEAR).all():
        with_offset = bool(text.str.contains(r"[+-]\d\d:?\d\d$").any())
        text = pd.to_datetime(text, format="mixed", errors="coerce", utc=with_offset).astype(str)
    moment = pd.to_datetime(text.str.replace(" ", "T", n=1), format="ISO8601", utc=True, errors="coerce")
    if not moment.notna().any():
        return np.full(len(texts), np.nan), [unread]
    if not text.str.contains(r"(?:Z|:\d\d[.\d]* ?[+-]\d\d(?::?\d\d)?)$", regex=True).any():
        said = [name, *filter(_OF_CLOCKS.search, remarks)]
        zone = stated_zone(str(texts.iloc[0]), *said)
        if zones is not None:
            moment = _in_zones(moment, *zones, where)
            notes.append(f"times are in the zones of column {zones[0]}")
        elif zone is not None:
            moment = _to_utc(moment, zone)
            notes.append(f"times are in the zone {zone}, as the table says")
        elif not re.search(r"\b(?:UTC|GMT)\b", name):
            notes.append("times state no zone: taken as UTC")
            if other := next((words for words in said if _OTHER_CLOCK.search(words)), ""):
                ahead = ": GPS time is 18 s ahead of UTC" if "gps" in other.lower() else " or zone"
                notes.append(f"'{other[:60]}' may mean another clock{ahead}")
    unix = moment.dt.tz_localize(None).to_numpy("datetime64[ns]").astype(np.int64) / 1e9
    unix[moment.isna()] = np.nan
    if lost := int(moment.isna().sum()):
        first = int(np.argmax(moment.isna()))
        notes.append(f"{lost:,} times of column {name} are not read, the first '{texts.iloc[first]}'")
    if lost < len(unix) and (unix[moment.notna()] % DAY_S == 0.0).all():
        notes = [f"column {name} holds days without a time: midnight of UTC is taken"]
    return np.where(moment.notna() & possible_unix(unix), unix, np.nan), notes


def _unix_of_numbers(number: ArrayF, name: str) -> tuple[ArrayF, list[str]] | None:
    """Unix time (n,) of numbers that count days, or on a scale of `TIME_SCALES`; None for any others.

    Parameters
    ----------
    number : (n,) with NaN.
    name : of their column, which tells one scale from another.
    """
    step = np.diff(np.unique(number[np.isfinite(number)]))
    since = number if step.size and np.median(step) < _FEWEST_STEP else np.full(len(number), np.nan)
    for words, first in _DAY_COUNTS.items():
        years = (since - first) / 365.25 + 1970
        known = years[np.isfinite(years)]
        if len(known) and known.min() >= 2000 and known.max() < 2001 + _LAST_YEAR:
            return (since - first) * DAY_S, [f"times taken as {words}, in UTC"]
    told = [each for each in tell_time_scale(number) if each not in ("week_s", "day_s")]
    if not told:
        return None
    scale = next((x for x in told if ("gps" in name.lower()) != x.startswith("unix")), told[0])
    note = f"times taken as {TIME_SCALES[scale]}"
    if len(told) > 1:
        note += f"; {time_scale_words(number, told)}"
    return unix_from_gps(gps_from_scale(number, scale)), [note]


def past_midnight(unix_s: ArrayF) -> ArrayF:
    """Times (n,) of one date beside clocks that pass midnight; as they are where nothing else steps back."""
    back = np.diff(unix_s)
    if (back < 0).any() and (back[back < 0] < -0.9 * DAY_S).all():
        return unix_s + DAY_S * np.cumsum(np.append(False, back < 0))
    return unix_s


def stated_zone(*texts: str) -> dt.tzinfo | None:
    """The first zone of time that words name: ``UTC+2``, ``(CEST)``, ``Europe/Berlin``; None: none, or UTC.

    Examples
    --------
    >>> stated_zone("time", "# Zeit in MEZ"), stated_zone("time (UTC)")
    (datetime.timezone(datetime.timedelta(seconds=3600)), None)
    """
    return next((zone for zone in map(_zone, texts) if zone is not None), None)


def _offset_of(found: re.Match[str]) -> str:
    """The offset from UTC in the place of a `_ZONE_BEHIND` that names one; other words as they are."""
    word, sign, hours, minutes = found.groups()
    if word not in _ZONES or (sign and _ZONES[word]):
        return found[0]
    return f"{sign}{hours:0>2}:{minutes or '00'}" if sign else f"{_ZONES[word]:+03.0f}:00"


def _zone(text: str) -> dt.tzinfo | None:
    if found := re.search(r"\b[A-Z][a-z]+/[A-Z]\w+", text):
        with contextlib.suppress(ZoneInfoNotFoundError, OSError, ValueError):
            return ZoneInfo(found[0])
    if found := _OFFSET.search(text):
        minutes = 60 * int(found[2]) + int(found[3] or 0) + round(60 * float(f"0.{found[4] or 0}"))
        return dt.timezone(dt.timedelta(minutes=-minutes if found[1] == "-" else minutes))
    hours = {_ZONES[word] for word in re.findall(r"(?<![A-Za-z])[A-Z]+(?![A-Za-z])", text) if word in _ZONES}
    return dt.timezone(dt.timedelta(hours=hours.pop())) if len(hours) == 1 and any(hours) else None


def _to_utc(moment: "pd.Series[Any]", zone: dt.tzinfo) -> "pd.Series[Any]":
    """Times of a zone, whatever zone they are said to be in; none where clocks are set back or forward."""
    local = moment.dt.tz_localize(None).dt.tz_localize(zone, ambiguous="NaT", nonexistent="NaT")
    return local.dt.tz_convert("UTC")


def _in_zones(moment: "pd.Series[Any]", name: str, zones: Texts, where: Path) -> "pd.Series[Any]":
    """Times in UTC of times by the clock, in the zone that a column has for each row."""
    out = moment.copy()
    for text in zones.unique():
        zone = _zone(text)
        if re.fullmatch(r"[-+]?\d+(?:\.\d*)?", text) and not re.fullmatch(r"[+-]\d{4}", text):
            size = float(text)  # hours, minutes or seconds
            per_hour = next(u for u, most in ((1, 14), (60, 840), (3600, np.inf)) if abs(size) <= most)
            quarters = 4 * size / per_hour
            whole = quarters % 1 == 0 and abs(quarters) <= 56
            zone = dt.timezone(dt.timedelta(hours=quarters / 4)) if whole else None
        elif not text or {*re.findall("[A-Z]+", text)} & {"UTC", "GMT", "Z"}:
            zone = zone or dt.UTC
        if zone is None:
            raise InputError(
                f"'{text}' in column {name}",
                where=where,
                expected="a zone of time, such as UTC+2, CEST or Europe/Berlin",
                cure="Write it so, or the times in UTC",
            )
        rows = (zones == text).to_numpy()
        out[rows] = _to_utc(moment[rows], zone)
    return out


def _iso(text: Texts, found: pd.DataFrame, where: Path) -> Texts:
    """Times with year, month and day in the order of ISO 8601."""
    a, b, year = (pd.to_numeric(found[k], errors="coerce") for k in (0, 2, 3))
    point = (found[1] == ".").any()
    last = year.nunique() > 1
    if (
        (last or not point)
        and b.max() <= 12
        and year.max() <= 31
        and a.nunique() == 1
        and a.max() <= _LAST_YEAR
    ):
        if last == point and a.max() != year.max():
            raise InputError(
                f"dates such as {text.iloc[0]}, in which the first or the last number may be the year",
                where=where,
                expected="years of four digits",
                cure="Write the dates as 2024-06-12, or leave the column out",
            )
        day, month, year = year, b, a
    elif not point and a.max() <= 12 and b.max() <= 12 and not (a == b).all():
        raise InputError(
            f"dates such as {text.iloc[0]}",
            where=where,
            expected="a day that tells it from the month, or year-month-day",
            cure="Write the dates as 2024-06-12, or leave the column out",
        )
    else:
        day, month = (a, b) if point or a.max() > 12 else (b, a)
    year = year.where(year > 99, year + 2000)
    iso = [f"{y:04.0f}-{m:02.0f}-{d:02.0f}" for y, m, d in zip(year, month, day, strict=True)]
    return pd.Series(iso).str.cat(found[4].fillna("").str.strip(" ,T"), sep=" ").str.strip()
