"""NMEA 0183 logs: positions, depths and headings with the UTC time that the sentences carry.

Sources. A log may hold several receivers: positions come from one of them, and the time from its sentences
and those that agree with them (`_receivers`, `_timeline`). One ping is one row a kind of sentence, whichever
talkers repeat it.

Time. GGA, GNS, RMC, GLL, GST and ZDA carry the second of the UTC day, RMC and ZDA the date too, if the
receiver has a fix. A date holds back to the last hole. A depth has no time of its own: it gets that of the
time sentence before it (``t_day_s``), plus what has passed since by the logger's stamps; several depths
between two times are spread evenly (`_since_sentence_s`). Without any date, and if the caller knows none,
nothing is synchronised: ``t_gps_s`` stays NaN.

Heights are ellipsoidal: above the geoid, plus the geoid above the ellipsoid (GGA fields 9, 11; GNS 9, 10).
The offset of DPT is handed on and never added. A depth of 0, or another value that stands for none, is how
echo sounders say that they saw no bottom: it stays in the table as 0, counts as ``no_bottom`` and not among
the depths. The temperature of the water comes from MTW, the instrument's own pitch and roll from XDR
(transducer type A in degrees). What else could place a depth and is not read is named in a note.

A checksum is the exclusive or of all characters between ``$`` and ``*`` (NMEA 0183, "Sentence
structure"). It is computed for a whole chunk at once; only wanted sentences become Python strings.
"""

import datetime as dt
import math
import re
from array import array
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, reduce
from itertools import combinations
from operator import xor
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

from thalweg.core import (
    DAY_S,
    NMAD,
    ArrayF,
    ArrayI,
    InputError,
    frame_of,
    gps_from_unix,
    unix_from_gps,
    utc_text_from_unix,
)
from thalweg.core.values import NOTHING, unit_of_letter
from thalweg.ingest import (
    DEPTH,
    GNSS_POSITION,
    IntegrityReport,
    PositionLog,
    doubtful_date,
    explain_shift,
    possible_unix,
)

# ---------------------------------------------------------------- sentences out of a log's bytes: framing,
# checksum, prefixes of loggers, TAG blocks


_NAN: Final = float("nan")
_SENTENCE: Final = re.compile(
    rb"[$!]([A-Z][A-Z0-9]{1,9},[^$!\r\n*]*)(\*(?:([0-9A-Fa-f]{2})|[^$!\r\n]{0,2}))?"
)
_TAG: Final = re.compile(rb"\\([^\\*]*)\*([0-9A-Fa-f]{2})\\\s*$")
_TAG_TIME: Final = re.compile(rb"(?:^|,)c:(\d{9,13})(?:,|$)")
_TAG_SOURCE: Final = re.compile(rb"(?:^|,)s:([^,]+)")
_UNIX: Final = re.compile(rb"^\W*(\d{9,10}(?:\.\d+)?|\d{13})(?:\W.*)?$")
_ISO: Final = re.compile(
    rb"^\W*(\d{4})[-/](\d\d)[-/](\d\d)[ T,;]+(\d\d:\d\d:\d\d(?:[.,]\d+)?)(Z|[+-]\d\d:?\d\d)?(?:\W.*)?$"
)
_CHUNK: Final = 1 << 22
_UNIX_DAY: Final = dt.date(1970, 1, 1).toordinal()


class Sentence(NamedTuple):
    """A sentence with a good checksum: talker (with the source of a TAG block), three-letter type, the fields
    behind, line from 1, logger's Unix time or NaN.
    """

    talker: str
    kind: str
    fields: list[str]
    line: int
    t_host_s: float


def scan_sentences(path: Path, report: IntegrityReport) -> Iterator[Sentence]:
    """Sentences of a log that `_FIELDS` knows, in the order of the file; everything else is counted.

    A sentence without a checksum is used only if the first 4 MB of the file hold no good checksum at all:
    in a log with checksums it is a cut sentence.

    Parameters
    ----------
    path : log of any line ending.
    report : takes the counts.

    Raises
    ------
    InputError : missing or empty file.
    """
    if not path.is_file():
        raise InputError("file not found", expected="an NMEA log", where=path, cure="Check the path")
    line, demand = 1, None
    with path.open("rb") as stream:
        while chunk := stream.read(_CHUNK) + stream.readline(_CHUNK):
            report.bytes_read += len(chunk)
            matches = list(_SENTENCE.finditer(chunk))
            spans = np.array([m.span(1) for m in matches], dtype=np.int64).ravel()
            # 256 is no number of two hexadecimal digits: a wrong checksum; -1: none is stated
            stated = np.array([int(m[3] or b"100", 16) if m[2] else -1 for m in matches], dtype=np.int64)
            # reduceat takes pairs (begin, end); a byte is added: an end of the chunk is an index too
            good = np.bitwise_xor.reduceat(np.frombuffer(chunk + b"\0", np.uint8), spans)[::2] == stated
            bare = stated < 0
            if demand is None:
                demand = bool(good.any())
            for tally, what, which in (
                (report.count, "sentences", good),
                (report.lose, "bad_checksum", ~good & ~bare),
                (report.lose, "without_checksum", bare & demand),
                (report.count, "sentences_without_checksum", bare & (not demand)),
            ):
                if which.any():
                    tally(what, int(which.sum()))
            feed = b"\n" if b"\n" in chunk else b"\r"
            end = 0
            for match, usable in zip(matches, (good | bare & (not demand)).tolist(), strict=True):
                between = chunk[end : match.start()]
                end = match.end()
                line += between.count(feed)
                t_host_s, source = _stamp(between, report)
                if usable:
                    head, *fields = match[1].decode("latin-1").split(",")
                    kind = head if head.startswith("P") else head[2:]
                    report.count(kind)
                    if len(head) == 5 and kind in _FIELDS:
                        yield Sentence(head[:2] + source, kind, fields, line, t_host_s)
            line += chunk.count(feed, end)
            _stamp(chunk[end:] + b"\n", report)


def _stamp(between: bytes, report: IntegrityReport) -> tuple[float, str]:
    """Unix time of the logger before a sentence, NaN without one, and its source, if stated.

    What else lies between two sentences is counted.
    """
    if not between.strip(b"\r\n \t\0"):
        return _NAN, ""
    *lines, prefix = re.split(rb"[\r\n]+", between)
    found = _prefix(prefix, report) if prefix.strip() else (_NAN, "")
    for text in lines if found else (*lines, prefix):
        if text.startswith(b"#"):
            report.count("comment_lines")
        elif text.strip(b" \t\0"):
            report.lose("foreign_bytes", len(text))
    if found and prefix.strip():
        report.count("prefixed_sentences")
    return found or (_NAN, "")


def _prefix(prefix: bytes, report: IntegrityReport) -> tuple[float, str] | None:
    """Unix time and source in a prefix; NaN for a TAG block without a time; None if it is nothing known."""
    if tag := _TAG.search(prefix):
        if reduce(xor, tag[1], 0) != int(tag[2], 16):
            return None
        stamp, source = _TAG_TIME.search(tag[1]), _TAG_SOURCE.search(tag[1])
        name = " of " + source[1].decode("latin-1") if source else ""
        return _seconds(stamp[1]) if stamp else _NAN, name
    if number := _UNIX.match(prefix):
        return _seconds(number[1]), ""
    if date := _ISO.match(prefix):
        year, month, day, time, zone = (part.decode() for part in date.groups(b""))
        try:
            moment = dt.datetime.fromisoformat(f"{year}-{month}-{day}T{time}{zone or 'Z'}")
        except ValueError:
            return None
        if not zone:
            report.note("Stamps of the logger state no zone: they are taken as UTC.")
        return moment.timestamp(), ""
    return None


def _seconds(digits: bytes) -> float:
    """Unix time from a number of seconds, or of milliseconds where it has 12 or 13 digits."""
    value = float(digits)
    return value / 1000 if value > 1e11 else value


# ---------------------------------------------------------------- sentences into rows of one table


_SIGMAS: Final = ("major_m", "minor_m", "axis_deg", "sigma_north_m", "sigma_east_m", "sigma_up_m")
_FIELDS: Final = {
    kind: names.split()
    for kind, names in {
        "GGA": "time lat north lon east quality n_sats hdop height height_unit geoid geoid_unit age",
        "GNS": "time lat north lon east modes n_sats hdop height geoid age",
        "RMC": "time status lat north lon east speed course date variation side modes",
        "GLL": "lat north lon east time status modes",
        "GST": f"time rms {' '.join(_SIGMAS)}",
        "ZDA": "time day month year",
        "DPT": "depth offset",
        "DBT": "depth unit depth2 unit2 depth3 unit3",
        "DBS": "depth unit depth2 unit2 depth3 unit3",
        "MTW": "temperature unit",
        "DTM": "datum",
        "XDR": "",
    }.items()
}
"""Sentences that are read, with names for their fields in the order of NMEA 0183."""
_NUMBERS: Final = (
    *("line", "file", "t_host_s", "second", "decimals", "day", "void"),
    *("lat_deg", "lon_deg", "h_ell_m", "n_sats", "age_s", "geoid_m", "step_m", *_SIGMAS),
    *("depth_m", "offset_m", "water_temperature_c", "pitch_deg", "roll_deg"),
)
"""Columns of the table of sentences besides talker, kind and fix."""
_PLACE: Final = {name: k for k, name in enumerate(_NUMBERS)}
_UNKNOWN: Final = array("d", [_NAN] * len(_NUMBERS))
_ALTERNATING, _ALTERNATING_M = 5.0, 0.05
"""How much more depths differ from their neighbour than from the one behind it if two sounders take turns."""
_COARSE_M: Final = 1.0
"""Last digit of a latitude above which a track has the steps of its own log."""
_RANK: Final = {"GGA": 0, "GNS": 0, "RMC": 1, "GLL": 2}
"""Sentences of positions; of the same time the one that says most is taken."""
_UNREAD: Final[Mapping[str, str]] = {
    "HDG HDM": "magnetic heading",
    "HDT THS": "true heading",
    "ROT": "rate of turn",
    "VTG VBW": "course and speed",
    "VHW": "heading, speed through water",
    "PASHR PRDID PHTRO PSXN PFEC PSAT ATT": "attitude",
    "GGK GGQ LLK LLQ PUBX": "position",
    "PTNL": "position or attitude",
    "PGRMZ": "height",
}
"""Sentences with a position, height, attitude or speed that nothing is taken from, and what they hold."""
_PROPRIETARY: Final = re.compile("P[A-Z][A-Z0-9]{2,}$")
_GPS_EPOCH_DAY: Final = dt.date(1980, 1, 6).toordinal() - _UNIX_DAY
_DATUMS: Final = frozenset(["", "W84", "P90", "999"])
"""Reference systems of DTM that agree with WGS 84, or say nothing."""
_NO_DEPTH: Final = frozenset(NOTHING["depth"])
"""Depths by which an instrument says that it has none."""

FIX_OF_QUALITY: Final = {
    "1": "single", "2": "dgnss", "3": "single", "4": "fixed", "5": "float", "6": "dead_reckoning",
    "9": "sbas",
}  # fmt: skip
"""GGA field 6 -> fix, else none; 7 is manual input, 8 a simulator, 9 SBAS in NovAtel receivers."""

FIX_OF_MODE: Final = {
    "R": "fixed", "F": "float", "D": "dgnss", "P": "single", "A": "single", "E": "dead_reckoning",
}  # fmt: skip
"""Mode indicator of RMC, GLL (NMEA 2.3) and GNS (one a system of satellites) -> fix, else none."""
_GOODNESS: Final = ("none", "dead_reckoning", "single", "dgnss", "sbas", "float", "fixed")


def _take(
    sentence: Sentence, f: Mapping[str, str], void: dict[str, bool], report: IntegrityReport
) -> dict[str, Any]:
    """Values of one sentence by column; ``f`` has its fields by name, "" for those that are empty.

    ``void`` is kept: whether the receiver of a talker says that it has no fix.

    Raises
    ------
    ValueError : an impossible field; nothing was taken then.
    """
    talker, kind = sentence.talker, sentence.kind
    if kind == "MTW":
        degc = number(f["temperature"])
        if not f["temperature"] or (f["unit"] in ("C", "") and -3.0 <= degc <= 60.0):
            return {"water_temperature_c": degc}
        raise ValueError(f)
    if kind == "XDR":
        if any("DEPTH" in text.upper() for text in sentence.fields):
            report.note("Depths of a transducer (XDR) are not read.")
        return pitch_and_roll_deg(sentence.fields)
    if kind == "DTM":
        if f["datum"] not in _DATUMS:
            report.note(f"The receiver states the datum {f['datum']} (DTM); positions are taken as WGS 84.")
        return {}
    if kind in ("DPT", "DBT", "DBS"):
        depth, letter = stated_depth(f, "M" if kind == "DPT" else "")
        offset = number(f["offset"])
        if depth != depth:
            report.count("empty_depths")
            return {}
        if letter != "M":
            words = "feet (0.3048 m)" if letter == "f" else "fathoms (1.8288 m)"
            report.note(f"{kind} states depths in {words} only: they are converted.")
        return {"depth_m": depth, "offset_m": offset}
    if kind == "GGA":
        no_fix = f["quality"] in ("", "0")
    elif kind == "GNS":
        no_fix = not f["modes"].strip("NM")
    else:
        no_fix = f["status"] == "V" if kind in _RANK else void.get(talker, False)
    row: dict[str, Any] = {"void": no_fix}
    if f["time"]:
        row |= {"second": second_of_day(f["time"]), "decimals": decimals(f["time"])}
    if len(f["date"]) not in (0, 6):
        raise ValueError(f)
    date = (f["date"][:2], f["date"][2:4], f["date"][4:]) if f["date"] else (f["day"], f["month"], f["year"])
    if all(date) and not no_fix:
        day = days_of_date(*map(int, date))
        if day > _GPS_EPOCH_DAY + 1:  # from which a receiver without the date counts
            row["day"] = day
    if kind == "GST":
        row |= {name: number(f[name]) for name in _SIGMAS}
        if 0.0 in (row["sigma_north_m"], row["sigma_east_m"], row["sigma_up_m"]):
            report.count("accuracies_of_0")  # of a receiver that knows none
            row |= {name: row[name] or _NAN for name in _SIGMAS if name != "axis_deg"}
    elif f["lat"] and f["lon"]:
        if kind == "GGA":
            fix = FIX_OF_QUALITY.get(f["quality"], "none")
        else:  # GLL of NMEA 2.0 ends before the status
            modes = [FIX_OF_MODE.get(mode, "none") for mode in f["modes"]] or ["none" if no_fix else "single"]
            fix = max(modes, key=_GOODNESS.index) if f["status"] in ("A", "D", "") else "none"
        row |= {
            "lat_deg": degrees(f["lat"], f["north"], "NS"),
            "lon_deg": degrees(f["lon"], f["east"], "EW"),
            "h_ell_m": length_m(f["height"], f["height_unit"]) + length_m(f["geoid"], f["geoid_unit"]),
            "fix": fix,
            "n_sats": int(number(f["n_sats"] or "-1")),
            "age_s": number(f["age"]),
            "geoid_m": number(f["geoid"]),
            "step_m": 1852.0 * 10.0 ** -decimals(f["lat"]),
        }
    elif kind in _RANK:
        report.count("sentences_without_position")
    void[talker] = no_fix
    return row


def second_of_day(text: str) -> float:
    """Second of the day from hhmmss[.sss]; 86400 and above inside a leap second.

    Raises
    ------
    ValueError : not such a time.
    """
    if not text[:6].isdecimal():
        raise ValueError(text)
    hour, minute, second = int(text[:2]), int(text[2:4]), float(text[4:])
    if hour > 23 or minute > 59 or second >= 61:
        raise ValueError(text)
    return hour * 3600 + minute * 60 + second


@cache
def days_of_date(day: int, month: int, year: int) -> int:
    """Days since 1970-01-01; a year of two digits is 1980 to 2057.

    Raises
    ------
    ValueError : no date, or one at which no survey can have been made.
    """
    if year < 100:
        year += 1900 if year >= 80 else 2000
    days = dt.date(year, month, day).toordinal() - _UNIX_DAY
    if not possible_unix(days * DAY_S):
        raise ValueError(year)
    return days


def degrees(text: str, side: str, sides: str) -> float:
    """Degrees from (d)ddmm.mmmm and one of the two ``sides``, N and S or E and W.

    A latitude of two digits before the point is in degrees and decimals, as no receiver writes it.

    Raises
    ------
    ValueError : not such an angle, or out of range.
    """
    whole, minutes = divmod(float(text), 100)
    angle = whole + minutes / 60
    if sides == "NS" and len(text.partition(".")[0]) < 3:
        raise ValueError(text)
    if side not in tuple(sides) or not (0 <= angle <= (90 if sides == "NS" else 180) and minutes < 60):
        raise ValueError(text)
    return -angle if side == sides[1] else angle


def number(text: str) -> float:
    """A number; NaN of an empty field.

    Raises
    ------
    ValueError : something else than a finite number.
    """
    value = float(text or "nan")
    if text and not math.isfinite(value):
        raise ValueError(text)
    return value


def decimals(text: str) -> int:
    """Digits behind the point."""
    return len(text.partition(".")[2])


def length_m(text: str, letter: str) -> float:
    """A length in metres from a number and the letter of its unit; no letter: metres.

    Raises
    ------
    ValueError : no finite number, or an unknown letter.
    """
    unit = unit_of_letter(letter or "M")
    if text and unit is None:
        raise ValueError(letter)
    return number(text) * (unit.metres if unit else 1.0)


def stated_depth(f: Mapping[str, str], usual_unit: str) -> tuple[float, str]:
    """Depth in metres and the letter of its unit: metres if given, else feet, else fathoms; NaN if none is.

    Depths in several units must agree to within 2 % and a unit of their last places: instruments round, or
    cut off, and one has fathoms of 1.85 m.

    Raises
    ------
    ValueError : an unknown unit, a negative depth, or depths that contradict each other.
    """
    stated: dict[str, tuple[float, float]] = {}
    for k in ("", "2", "3"):
        if text := f["depth" + k]:
            letter = f["unit" + k] or usual_unit
            unit = unit_of_letter(letter)
            if unit is None or letter in stated:
                raise ValueError(f)
            value = number(text)
            depth = 0.0 if value in _NO_DEPTH else value * unit.metres
            stated[letter] = depth, unit.metres * 10.0 ** -decimals(text)
    seen = {letter: pair for letter, pair in stated.items() if pair[0] != 0.0} or stated
    letter = next((each for each in "MfF" if each in seen), "")
    depth, step = seen.get(letter, (_NAN, 0.0))
    if depth < 0 or any(abs(other - depth) > 0.02 * depth + step + more for other, more in seen.values()):
        raise ValueError(f)
    return depth, letter


def pitch_and_roll_deg(fields: list[str]) -> dict[str, Any]:
    """Pitch and roll among the transducers of XDR, groups of type, value, unit, name.

    Raises
    ------
    ValueError : an angle that is no number or more than a right angle.
    """
    found: dict[str, Any] = {}
    for kind, value, unit, name in zip(*(map(str.strip, fields[k::4]) for k in range(4)), strict=False):
        key = re.match("(P)I?TCH|(R)OLL", name.upper())
        if key and (kind, unit) == ("A", "D"):
            angle = number(value)
            if abs(angle) > 90.0:
                raise ValueError(angle)
            found["pitch_deg" if key[1] else "roll_deg"] = angle
    return found


# ---------------------------------------------------------------- receivers: whose positions, whose time


_SATELLITES: Final = re.compile("G|BD|QZ")
"""Talkers of satellite systems: a receiver names those in use."""
_SAME_PLACE_M: Final = 0.5
"""Sentences of one receiver at one time lie no farther apart, rounding aside."""
_FEW: Final = 0.1
"""A receiver with a smaller share of the positions than this is not chosen, however good."""


def _receivers(fixes: pd.DataFrame) -> tuple[pd.DataFrame, ArrayI]:
    """Fixes with their time ``clock_s`` over midnights, and the number of the receiver of each.

    Sentences belong together where they state the same place at the same time, whatever their talkers (GN and
    GP of one receiver). Without a common time, talkers belong together where the track of the one passes the
    places of the other; where they do not meet at all, satellite systems are of one receiver.
    """
    clock = fixes["second"].to_numpy(copy=True)
    timed = np.isfinite(clock)
    clock[timed] = np.round(np.unwrap(clock[timed], period=DAY_S), 3)
    fixes = fixes.assign(clock_s=clock)
    block = np.cumsum(np.diff(clock, prepend=np.nan) != 0)  # NaN differs from everything
    again = fixes.groupby([block, "talker", "kind"]).cumcount().clip(upper=3)
    node = fixes.groupby(["talker", "kind", again], sort=False).ngroup().to_numpy()
    tracks = [fixes[node == k] for k in range(node.max(initial=-1) + 1)]
    receiver = np.arange(len(tracks))
    for a, b in combinations(range(len(tracks)), 2):
        if receiver[a] != receiver[b] and _one_receiver(tracks[a], tracks[b]):
            receiver[receiver == receiver[b]] = receiver[a]
    return fixes, receiver[node]


def _one_receiver(a: pd.DataFrame, b: pd.DataFrame) -> bool:
    apart, at_once = _apart_m(a, b)
    names = a["talker"].iloc[0], b["talker"].iloc[0]
    if not at_once and (names[0] == names[1] or not np.isfinite(apart)):
        return names[0] == names[1] or all(_SATELLITES.match(name) for name in names)
    return apart <= _SAME_PLACE_M + float(a["step_m"].max() + b["step_m"].max())


def _apart_m(a: pd.DataFrame, b: pd.DataFrame) -> tuple[float, bool]:
    """Median distance of two tracks, NaN where they do not meet, and whether it is of the same times."""
    ta, *place_a = _track(a).T
    known = _track(b)
    tb = known[:, 0]
    meets = np.isin(tb, ta)
    at_once = bool(meets.any())
    if not at_once and len(ta) > 1:
        after = np.clip(np.searchsorted(ta, tb), 1, len(ta) - 1)
        short = ta[after] - ta[after - 1] <= 2.5 * np.median(np.diff(ta))
        meets = (tb > ta[after - 1]) & (tb < ta[after]) & short
    if not meets.any():
        return _NAN, False
    tb, *place_b = known[meets].T
    north, east = (of_b - np.interp(tb, ta, of_a) for of_a, of_b in zip(place_a, place_b, strict=True))
    east = east * np.cos(np.deg2rad(place_b[0]))
    return 60 * 1852.0 * float(np.median(np.hypot(north, east))), at_once


def _track(fixes: pd.DataFrame) -> ArrayF:
    """Time, latitude and longitude (n, 3) in the order of time, each time once."""
    rows = fixes[["clock_s", "lat_deg", "lon_deg"]].to_numpy(np.float64)
    rows = rows[np.isfinite(rows[:, 0])]
    return np.asarray(rows[np.unique(rows[:, 0], return_index=True)[1]])


def _choose(table: pd.DataFrame, report: IntegrityReport) -> pd.DataFrame:
    """The table with positions of the best receiver alone; others are named, their accuracies taken out."""
    fixes = table[table["fix"].notna()]
    if fixes.empty:
        return table
    report.count("position_sentences", len(fixes))
    fixes, receiver = _receivers(fixes)
    owners = {int(k): set(fixes["talker"][receiver == k]) for k in np.unique(receiver)}
    horizontal = pd.Series(np.hypot(table["sigma_north_m"], table["sigma_east_m"])).dropna()

    def merit(k: int) -> tuple[bool, float, float, int, int]:
        """What speaks for a receiver, the smaller the better."""
        rows = fixes[receiver == k]
        stated = horizontal[table["talker"].isin(owners[k])]
        goodness = float(np.median([_GOODNESS.index(fix) for fix in rows["fix"]]))
        few = len(rows) < _FEW * len(fixes) / len(owners)
        return few, -goodness, _median(stated, np.inf), rows["kind"].map(_RANK).min(), -len(rows)

    ranked = sorted(owners, key=merit)
    chosen = fixes[receiver == ranked[0]]
    for k in ranked[1:]:
        other = fixes[receiver == k]
        report.count("positions_of_other_receivers", len(other))
        apart = _apart_m(chosen, other)[0]
        far = f", {apart:.1f} m from it" if np.isfinite(apart) else ""
        report.note(f"Positions come from {_named(chosen)}; those of {_named(other)}{far}, are not used.")
    foreign = set().union(*(owners[k] for k in ranked[1:])) - owners[ranked[0]]
    table.loc[fixes.index[receiver != ranked[0]], "fix"] = None
    table.loc[table["talker"].isin(foreign), "sigma_north_m"] = np.nan
    return table


def _named(rows: pd.DataFrame) -> str:
    """A receiver in words: talkers, sentences, how many, the usual fix."""
    talkers, kinds = ("/".join(rows[name].unique()) for name in ("talker", "kind"))
    return f"{talkers} ({kinds} {len(rows):,}, {rows['fix'].mode()[0]})"


# ---------------------------------------------------------------- time of the log


_HALF_DAY_S: Final = 43_200
_SHORTEST_HOLE_S: Final = 60.0
_ROLLOVER_DAYS: Final = 7168
"""The week counter of GPS begins anew after 1024 weeks."""


def _add_times(table: pd.DataFrame, date: dt.date | None, report: IntegrityReport) -> set[int]:
    """Add the times of the sentences; returns the files whose begin lies before the end of the one before.

    ``clock_s`` is the second over midnights and ``t_gps_s`` GPS time (NaN without a date) of sentences of the
    receiver of the positions and of those that agree with it, NaN at others; ``base`` is the row of that one
    whose time holds at each row, -1 ahead of a file's first: the last time of the file before may be older by
    hours, or newer where the files overlap.

    A stretch between holes in which a receiver had no fix counts from when it was switched on: it is no time.
    A date holds for its stretch, before it too, and for stretches behind it that state none.
    """
    table[["clock_s", "t_gps_s", "base"]] = np.nan, np.nan, -1
    timed = table[table["second"].notna()]
    own = timed.index[timed["talker"].isin(_agreeing(table, report))].to_numpy()
    if not own.size:
        return set()
    last = pd.Series(own, index=own).reindex(table.index).groupby(table["file"]).ffill()
    s, file, day = (table[name].to_numpy()[own] for name in ("second", "file", "day"))
    step = _wrapped(np.diff(s, prepend=s[0]))
    run = np.cumsum(np.abs(step) > max(_SHORTEST_HOLE_S, 10 * _median(step[step > 0], 0.0)))
    fixed = np.isfinite(day) | ~table["void"].to_numpy(np.bool_)[own]
    sure = pd.Series(fixed).groupby(run).transform("any").to_numpy()
    if sure.any():
        own, run, day, s, file = (values[sure] for values in (own, run, day, s, file))
    midnights, files_back = _midnights(s, file, report)
    epoch = np.cumsum(np.diff(s, prepend=s[0]) != 0)
    dates = pd.Series(day - midnights).groupby([run, epoch]).transform("last").groupby(run).ffill()
    dates = dates.groupby(run).bfill()
    change = np.diff(dates, prepend=np.nan) * (np.diff(file, prepend=file[0]) == 0)
    jump = (change != 0) & np.isfinite(change) & ((np.diff(run, prepend=0) == 0) | (change < 0))
    if jumps := int(jump.sum()):
        report.lose("date_jumps", jumps)
        report.note(
            f"The date jumps {jumps} times without a midnight: two logs in one file, or a receiver whose "
            "week counter rolled over (1024 weeks)."
        )
    zero = dates.ffill().to_numpy(np.float64, copy=True)
    given = _NAN if date is None else float(days_of_date(date.day, date.month, date.year))
    known = np.flatnonzero(np.isfinite(zero))
    if not known.size:
        zero[:] = given
    elif date is not None and (off := round(given - (zero + midnights)[known[0]])):
        if off % _ROLLOVER_DAYS == 0:
            # not those behind a jump, of a receiver that found the right week meanwhile
            zero += off * (np.abs(zero - zero[known[0]]) < _ROLLOVER_DAYS / 2)
            report.note(f"Dates of the log are {off // 7} weeks off by the given date {date}: put right.")
        else:
            report.note(f"The log states its own date; the given date {date} is not used.")
    times = {"clock_s": midnights * DAY_S + s, "t_gps_s": _gps(zero + midnights, s)}
    table[["clock_s", "t_gps_s"]] = pd.DataFrame(times, index=own).reindex(table.index)
    # of those without a sure time none holds, nor one from before them
    table["base"] = last.where(last.isin(own), -1).astype(np.int64)
    report.timing.describe_host(table["t_gps_s"].to_numpy(), table["t_host_s"].to_numpy())
    _say_dates(table["t_gps_s"].dropna().to_numpy(), report)
    return files_back


def _wrapped(seconds: ArrayF) -> ArrayF:
    """Differences of times of day, to within half a day."""
    return np.asarray((seconds + _HALF_DAY_S) % DAY_S - _HALF_DAY_S)


def _median(values: Any, otherwise: float = _NAN) -> float:
    return float(np.median(values)) if len(values) else otherwise


def _gps(day: ArrayF, second: ArrayF) -> ArrayF:
    """GPS time of seconds of the day; second 60 of a leap second is one after second 59."""
    leap = (second >= DAY_S).astype(np.float64)
    whole = np.floor(second - leap)
    return np.asarray(gps_from_unix(day * DAY_S + whole) + (second - leap - whole) + leap)


def _agreeing(table: pd.DataFrame, report: IntegrityReport) -> set[str]:
    """Talkers whose times agree with those of the receiver of the positions; dates of others are dropped."""
    times = table[table["second"].notna()]
    present = times["talker"].value_counts()
    own = set(table["talker"][table["fix"].notna()]) & set(present.index) or set(present.index[:1])
    at = times[times["talker"].isin(own)]
    period = _median(np.diff(np.unique(at["second"])), 1.0)
    agreeing, dated = set(own), at["day"].notna().any()
    for talker in set(present.index) - own:
        rows = times[times["talker"] == talker]
        before = np.searchsorted(at.index, rows.index) - 1
        off = _median(_wrapped(rows["second"] - at["second"].to_numpy()[before])[before >= 0], 0.0)
        days = rows["day"].median() - at["day"].median() if dated and rows["day"].notna().any() else 0
        late = abs(off) > period + 0.5
        if not late:
            agreeing.add(talker)
        if late or abs(days) > 1:
            off = off * late + days * DAY_S
            report.note(
                f"The clock of {talker} is {off:+,.1f} s off that of {'/'.join(sorted(own))}; its "
                f"{'times' if late else 'dates'} are not used. {explain_shift(off)}".strip()
            )
        if dated:
            table.loc[rows.index, "day"] = np.nan
    return agreeing


def _midnights(second: ArrayF, file: ArrayI, report: IntegrityReport) -> tuple[ArrayI, set[int]]:
    """Midnights (n,) since the first of the times (n,), files that begin back in time; others are lost."""
    step, begins = np.diff(second, prepend=second[0]), np.diff(file, prepend=file[0]) > 0
    turn, count, files_back = np.zeros(len(second), dtype=np.int64), 0, set()
    for i in np.flatnonzero((step < 0) | (step > _HALF_DAY_S)).tolist():
        # a sentence of before midnight that came late, or a file that overlaps
        late = count > 0 and (begins[i] or (second[i - 1] < 60 and second[i] > DAY_S - 60))
        if step[i] < -_HALF_DAY_S or (step[i] > 0 and late):
            turn[i] = 1 if step[i] < 0 else -1
            count += turn[i]
        back = -_HALF_DAY_S <= step[i] < 0
        if begins[i] and (back or turn[i] < 0):
            files_back.add(int(file[i]))
        elif back:
            report.lose("time_steps_back")
    return np.cumsum(turn), files_back


def _say_dates(t_gps_s: ArrayF, report: IntegrityReport) -> None:
    """What stamps of the logger say of the dates, and dates at which hardly anybody surveyed."""
    off = report.timing.clock_offset_s
    if off is None:
        if doubt := doubtful_date(t_gps_s):
            report.note(f"{doubt} If so, state logs.depth_date.")
    elif round(off / (_ROLLOVER_DAYS * DAY_S)) > 0 and "week counter" in explain_shift(off, DAY_S):
        true = utc_text_from_unix(float(unix_from_gps(t_gps_s[0])) + round(off / DAY_S / 7) * 7 * DAY_S)[:10]
        report.lose("dates_off_by_1024_weeks", len(t_gps_s))
        report.note(
            f"The dates are {round(off / DAY_S / 7)} weeks before the stamps of the logger: the week counter "
            f"of the receiver rolled over. State logs.depth_date: {true}."
        )
    elif words := explain_shift(off):
        report.note(f"The logger's clock differs from the sentences by {words}.")


# ---------------------------------------------------------------- reader


def read_nmea(files: Sequence[Path], date: dt.date | None = None) -> PositionLog:
    """Read one or several NMEA logs.

    The report's details hold the medians ``water_temperature_c`` (MTW), ``pitch_deg`` and ``roll_deg`` of the
    instrument (XDR), and ``sigma_depth_time_s``, the standard deviation of times of depths that were placed
    between two time sentences.

    Parameters
    ----------
    files : in the order of time; what two of them hold at the same GPS time is kept once.
    date : UTC date of the first sentence, for logs that carry none; where a log states its date, that
        one is used, unless it is 1024 weeks, or a multiple, off.

    Returns
    -------
    Positions of GGA, GNS, RMC and GLL of the best receiver (by fix, standard deviation, rate): of sentences
    with the same time the one that says most. Standard deviations come from its GST of the same time.

    Raises
    ------
    InputError : a file is missing, or no file holds a sentence.
    """
    if not files:
        raise InputError("no NMEA log given", expected="at least one file")
    report = IntegrityReport.of("nmea", "NMEA 0183", files)
    texts: list[tuple[str, str, str | None]] = []
    numbers = array("d")
    bad: list[str] = []
    void: dict[str, bool] = {}
    for index, path in enumerate(files):
        for each in scan_sentences(path, report):
            fields = defaultdict(str, zip(_FIELDS[each.kind], map(str.strip, each.fields), strict=False))
            try:
                row = _take(each, fields, void, report)
            except ValueError:
                bad.append(f"{path.name} line {each.line}")
                continue
            texts.append((each.talker, each.kind, row.pop("fix", None)))
            row |= {"line": each.line, "file": index, "t_host_s": each.t_host_s}
            begin = len(numbers)
            numbers.extend(_UNKNOWN)
            for name, value in row.items():
                numbers[begin + _PLACE[name]] = value
    if not report.counts.get("sentences", 0) + report.counts.get("sentences_without_checksum", 0):
        raise InputError(
            f"no NMEA sentence in {report.bytes_read:,} bytes"
            + f" ({report.losses.get('bad_checksum', 0)} with a wrong checksum)",
            expected="lines such as $GPGGA,...*hh",
            where=", ".join(map(str, files)),
            cure="Check that this is a plain text log and not compressed",
        )
    if bad:
        report.lose("malformed_sentences", len(bad))
        report.details["malformed"] = ", ".join(bad[:20]) + (" ..." if len(bad) > 20 else "")
        report.note(f"{len(bad)} sentences have a good frame but impossible fields, the first at {bad[0]}.")
    table = pd.DataFrame(np.frombuffer(numbers).reshape(-1, len(_NUMBERS)), columns=list(_NUMBERS))
    table[["talker", "kind", "fix"]] = pd.DataFrame(texts, columns=["talker", "kind", "fix"], dtype=object)
    table = _choose(table, report)
    files_back = _add_times(table, date, report)
    parts = []
    for name, part in (("positions", _positions(table, report)), ("depths", _depths(table, report))):
        # rows without GPS time are all kept: a second of an unknown day is no time stamp
        timed = part[part["t_gps_s"].notna()]
        once = report.keep_once(
            timed.drop(columns=["line", "file", "base"], errors="ignore"), timed["file"].to_numpy(), name
        )
        files_back -= set(timed["file"][~once])
        parts.append(part.drop(index=timed.index[~once]).reset_index(drop=True))
    positions, depths = parts
    if files_back:
        report.lose("time_steps_back", len(files_back))
    if date is not None or table["t_gps_s"].notna().any():
        untimed = depths["t_gps_s"].isna() & depths["seen"]
        for name, n in (("positions", positions["t_gps_s"].isna().sum()), ("depths", untimed.sum())):
            if n:
                report.lose(f"{name}_without_time", int(n))
                report.note(f"{n:,} {name} come from before the receiver knew time and date: they get none.")
    depths["t_gps_s"] += _since_sentence_s(depths, table, report)
    positions, depths = frame_of(GNSS_POSITION, dict(positions)), frame_of(DEPTH, dict(depths))
    _summarise(report, positions, depths, table)
    return PositionLog(positions=positions, depths=depths, report=report)


def _positions(table: pd.DataFrame, report: IntegrityReport) -> pd.DataFrame:
    """Columns of kind ``gnss_position`` and the number of the file, one row an epoch."""
    fixes = table[table["fix"].notna()]
    epoch = np.cumsum(np.diff(fixes["second"], prepend=np.nan) != 0)  # NaN differs from everything
    kept = fixes.iloc[np.lexsort((fixes["kind"].map(_RANK), epoch))]
    kept = kept[~pd.Series(np.sort(epoch), index=kept.index).duplicated()].sort_index()
    stated = table[table["kind"] == "GST"].dropna(subset=["clock_s", "sigma_north_m"])
    stated = stated.drop_duplicates("clock_s", keep="last").set_index("clock_s")
    gst = stated[list(_SIGMAS)].reindex(kept["clock_s"]).set_axis(kept.index)
    angle = np.deg2rad(gst["axis_deg"])
    cov_en = (gst["major_m"] ** 2 - gst["minor_m"] ** 2) * np.sin(angle) * np.cos(angle)
    # An ellipse that contradicts the standard deviations by more than the rounding to 1 mm is not used.
    inside = np.abs(cov_en) <= gst["sigma_north_m"] * gst["sigma_east_m"]
    report.lose("contradicting_error_ellipses", (cov_en.notna() & ~inside).sum())
    bare = kept["kind"].isin(["GGA", "GNS"]) & kept["h_ell_m"].isna()
    if bare.any():
        kinds = "/".join(sorted(kept["kind"][bare].unique()))
        report.note(
            f"{bare.sum()} {kinds} sentences have no geoid separation: no ellipsoidal height can be given."
        )
    if flat := int((kept["geoid_m"] == 0.0).sum()):
        report.note(
            f"{flat:,} positions have a geoid separation of 0: their heights are taken as ellipsoidal. A "
            "receiver without a geoid model writes 0 beside heights above the sea, in Europe 35 to 50 m less."
        )
    if (step_m := _median(kept["step_m"], 0.0)) > _COARSE_M:
        report.note(f"Positions are written in steps of {step_m:.1f} m (decimals of the minute).")
    report.count_some("positions_without_fix", (kept["fix"] == "none").sum())
    columns = ["t_gps_s", "lat_deg", "lon_deg", "h_ell_m", "fix", "n_sats", "age_s", "file"]
    unknown = dict.fromkeys(("cov_eu_m2", "cov_nu_m2", "ratio"), np.nan)
    return kept[columns].assign(**gst[list(_SIGMAS[3:])], cov_en_m2=cov_en.where(inside), **unknown)


def _depths(table: pd.DataFrame, report: IntegrityReport) -> pd.DataFrame:
    """Depths, each with the time of the sentence before it; what a second talker repeats is left out."""
    depths = table[table["depth_m"].notna()]
    kept = [_one_talker(part, report) for _, part in depths.groupby("kind", sort=False)]
    depths = pd.concat(kept).sort_index() if kept else depths
    for kind, own in depths[depths["depth_m"] > 0].groupby("kind")["depth_m"]:
        step_m = _median(own.diff().abs().dropna())
        if step_m > max(_ALTERNATING_M, _ALTERNATING * _median(own.diff(2).abs().dropna(), np.inf)):
            report.note(
                f"{kind} depths alternate by {step_m:.2f} m: two frequencies or sounders in one sentence? "
                "Both are taken; split the log to take one."
            )
    depths = depths[["talker", "kind", "line", "file", "t_host_s", "depth_m", "offset_m", "base"]]
    of_base = table[["second", "t_gps_s"]].reindex(depths["base"])
    return depths.assign(
        sentence=depths["kind"],
        seen=table["second"].notna().cummax().reindex(depths.index),
        t_day_s=of_base["second"].to_numpy(),
        t_gps_s=of_base["t_gps_s"].to_numpy(),
    )


def _one_talker(part: pd.DataFrame, report: IntegrityReport) -> pd.DataFrame:
    """Depths of one kind of sentence without those of talkers beside the main one: a ping is one sounding."""
    present = part["talker"].value_counts()
    main = next(
        (t for t in present.index if t.startswith("SD") and present[t] >= 0.9 * present.iloc[0]), None
    )
    main = main or present.index[0]
    own = part[part["talker"] == main]
    for talker in present.index.drop(main):
        other = part[part["talker"] == talker]
        if other.index[0] > own.index[-1] or other.index[-1] < own.index[0]:
            continue  # an instrument that was set otherwise, or another log
        near = np.clip(np.searchsorted(own.index, other.index) - [[1], [0]], 0, len(own) - 1)
        apart = float(
            np.median(np.min(np.abs(other["depth_m"].to_numpy() - own["depth_m"].to_numpy()[near]), 0))
        )
        kind = f"{talker}{other['kind'].iloc[0]}"
        report.count("repeated_depths_of_other_talkers", len(other))
        report.note(
            f"{len(other):,} depths of {kind} stand beside those of {main} (median difference "
            f"{apart:.2f} m): one ping is one sounding, they are left out."
        )
        part = part.drop(other.index)
    return part


def _since_sentence_s(depths: pd.DataFrame, table: pd.DataFrame, report: IntegrityReport) -> ArrayF:
    """Time (n,) from the time sentence before each depth to the depth.

    By the stamps of the logger where both have one. Else, where usually several depths stand between two
    times, they are spread evenly, with an error of up to half a step; a single one gets the time before it.
    """
    since = np.zeros(len(depths))
    timed = np.flatnonzero(depths["base"] >= 0)
    if not timed.size:
        return since
    own = table[table["clock_s"].notna()]
    number = np.cumsum(np.diff(own["clock_s"], prepend=np.nan) != 0) - 1
    starts = own[np.diff(number, prepend=-1) > 0]
    lasts = np.append(np.diff(starts["clock_s"]), np.nan)
    lasts[(np.append(np.diff(starts["file"]), 1) != 0) | ~(lasts > 0)] = np.nan
    usual_s = _median(lasts[np.isfinite(lasts)])
    ping = depths.iloc[timed]
    epoch = pd.Series(number, index=own.index).reindex(ping["base"]).to_numpy()
    host = ping["t_host_s"] - table["t_host_s"].reindex(ping["base"]).to_numpy()
    key = [ping["sentence"], epoch]
    n, k = host.groupby(key).transform("size").to_numpy(), host.groupby(key).cumcount().to_numpy()
    length = lasts[epoch]
    inside = host.between(0.0, np.where(np.isfinite(length), length, 1.5 * usual_s))
    stamped = (inside & ~(host.groupby(key).diff() <= 0)).groupby(key).transform("all").to_numpy()
    jitter = np.diff(own["t_host_s"] - own["clock_s"])
    passed = np.where(stamped, host, 0.0)
    sigma = stamped * NMAD / np.sqrt(2) * _median(np.abs(jitter[np.isfinite(jitter)]), 0.0)
    normal = length <= 1.5 * usual_s
    spread = 0
    for kind in ping["sentence"].unique():
        here = (ping["sentence"] == kind).to_numpy() & ~stamped
        first = here & normal & (k == 0)
        if first.any():
            several = _median(n[first]) >= 2
            ping_s = _median(length[first] / n[first])
            step = np.fmin(length / n, np.where(normal, np.inf, ping_s))
            here &= several | ((n > 1) & ~normal)
            passed = np.where(here, (k + 0.5 * several) * step, passed)
            sigma = np.where(here, step / np.sqrt(12), sigma)
            spread += here.sum()
    if spread:
        report.note(
            f"{spread:,} depths, several between two times, are spread evenly; stamps of the logger "
            "before each sentence would tell more."
        )
    if sigma.any():
        report.details["sigma_depth_time_s"] = round(float(np.sqrt(np.mean(sigma**2))), 4)
    since[timed] = passed
    return since


def _summarise(
    report: IntegrityReport, positions: pd.DataFrame, depths: pd.DataFrame, table: pd.DataFrame
) -> None:
    """Counts, time span, what the echo sounder says about the water and itself, and what is not read."""
    report.count("positions", len(positions))
    report.count("depths", int((depths["depth_m"] > 0).sum()))
    known = table["clock_s"].dropna()
    t = positions["t_gps_s"]
    # steps back were counted in all sentences
    t = t[~(t.duplicated() & t.notna())].sort_values()
    report.take_times(t, "positions", 10.0 ** -table["decimals"].max() if len(known) else None)
    t = pd.concat([t, depths["t_gps_s"]]).dropna()
    report.synchronised = bool(len(t))
    report.time_scale = "utc" if len(known) else "none"
    if len(known):
        span = t if len(t) else known
        report.t_first_s, report.t_last_s = float(span.min()), float(span.max())
        if table["t_gps_s"].isna().all():
            stamps = table["t_host_s"].dropna()
            day = f": {utc_text_from_unix(stamps.iloc[0])[:10]} by the logger" if len(stamps) else ""
            report.note(
                "The log has times but no date: nothing is synchronised. Give the UTC date of its start "
                f"(logs.depth_date{day})."
            )
    else:
        report.note("The log has no time sentence: nothing is synchronised.")
    if offsets := sorted(depths["offset_m"].dropna().unique()):
        report.details["DPT offsets"] = ", ".join(f"{x:g} m" for x in offsets)
    kinds = depths["sentence"].value_counts()
    if len(kinds) > 1:
        stated = ", ".join(f"{kind} {n:,}" for kind, n in kinds.items())
        report.note(f"Pings are stated by several sentences ({stated}): a sounding takes one of them.")
    if "DBS" in kinds:
        report.note("DBS depths are below the water line, all others below the transducer.")
    if "DBK" in report.counts:
        report.note("Depths below the keel (DBK) are not read: soundings begin at the transducer (DPT, DBT).")
    if silent := int((depths["depth_m"] == 0).sum()):
        report.count("no_bottom", silent)
        report.note(f"{silent:,} depths are 0, or a number for none: the instrument saw no bottom.")
    for name in ("water_temperature_c", "pitch_deg", "roll_deg"):
        if table[name].notna().any():
            report.details[name] = round(float(table[name].median()), 3)
    held = {kind: what for kinds, what in _UNREAD.items() for kind in kinds.split()}
    unread = [
        f"{kind} {n:,} ({held.get(kind, 'proprietary')})"
        for kind, n in report.counts.items()
        if kind in held or _PROPRIETARY.match(kind)
    ]
    if unread:
        report.note("Not read: " + ", ".join(unread) + ".")
