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
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Final, Self

import numpy as np
import pandas as pd

from thalweg.core import DAY_S, NMAD, ArrayF, ArrayI, InputError, gps_from_unix
from thalweg.core.values import NOTHING, unit_of_letter
from thalweg.ingest import (
    DEPTH,
    GNSS_POSITION,
    IntegrityReport,
    explain_shift,
    find_gaps,
    possible_unix,
    repeated_rows,
    say_repeated,
)

# ---------------------------------------------------------------- NMEA 0183 sentences out of a log's
# bytes: framing, checksum, logger prefixes, TAG blocks


_SENTENCE: Final = re.compile(rb"[$!]([A-Z][A-Z0-9]{1,9},[^$!\r\n*]*)(?:\*([^$!\r\n]{0,2}))?")
_TAG: Final = re.compile(rb"\\([^\\*]*)\*([0-9A-Fa-f]{2})\\\s*$")
_TAG_TIME: Final = re.compile(rb"(?:^|,)c:(\d{9,13})(?:,|$)")
_TAG_SOURCE: Final = re.compile(rb"(?:^|,)s:([^,]+)")
_UNIX: Final = re.compile(rb"^\W*(\d{9,10}(?:\.\d+)?|\d{13})(?:\W.*)?$")
_ISO: Final = re.compile(
    rb"^\W*(\d{4})[-/](\d\d)[-/](\d\d)[ T,;]+(\d\d):(\d\d):(\d\d(?:[.,]\d+)?)"
    rb"(?:(Z)|([+-]\d\d):?(\d\d))?(?:\W.*)?$"
)
_BLANK: Final = b"\r\n \t\0"
_CHUNK: Final = 1 << 22
_UNIX_ORDINAL: Final = dt.date(1970, 1, 1).toordinal()


@dataclass(frozen=True, slots=True)
class Sentence:
    """A sentence with a good checksum: talker (with the source of a TAG block), three-letter type, fields,
    line from 1, logger's Unix time or NaN.
    """

    talker: str
    kind: str
    fields: list[str]
    line: int
    t_host_s: float


def scan_sentences(path: Path, wanted: frozenset[bytes], report: IntegrityReport) -> Iterator[Sentence]:
    """Wanted sentences of a log in the order of the file; everything else is counted.

    A sentence without a checksum is used only if the first 4 MB of the file hold no good checksum at all:
    in a log with checksums it is a cut sentence.

    Parameters
    ----------
    path : log of any line ending.
    wanted : three-letter types, such as ``b"GGA"``, of any talker of two letters.
    report : takes the counts.

    Raises
    ------
    InputError : missing or empty file.
    """
    if not path.is_file():
        raise InputError("file not found", expected="an NMEA log", where=path, cure="Check the path")
    line = 0
    demand: bool | None = None
    tail = b""
    with path.open("rb") as stream:
        while True:
            data = stream.read(_CHUNK)
            report.bytes_read += len(data)
            chunk = tail + data
            tail = b""
            if data:
                cut = max(chunk.rfind(b"\n"), chunk.rfind(b"\r")) + 1
                # "\r" at the very end may be half of "\r\n"
                if cut and chunk[cut - 1 : cut] == b"\r" and cut == len(chunk):
                    cut = max(chunk.rfind(b"\n", 0, cut - 1), chunk.rfind(b"\r", 0, cut - 1)) + 1
                if cut or len(chunk) < 2 * _CHUNK:
                    chunk, tail = chunk[:cut], chunk[cut:]
            if chunk:
                found = _frames(chunk)
                if demand is None:
                    demand = bool(np.any(found.good))
                yield from _sentences(chunk, found, line, wanted, demand, report)
                line += found.n_lines
            if not data:
                return


@dataclass(frozen=True, slots=True)
class _Frames:
    matches: list[re.Match[bytes]]
    good: np.ndarray[tuple[int], np.dtype[np.bool_]]
    stated: np.ndarray[tuple[int], np.dtype[np.bool_]]
    line: list[int]
    n_lines: int


def _frames(chunk: bytes) -> _Frames:
    matches = list(_SENTENCE.finditer(chunk))
    raw = np.frombuffer(chunk, dtype=np.uint8)
    feeds = raw == 10
    returns = raw == 13
    returns[:-1] &= ~feeds[1:]
    ends = np.flatnonzero(feeds | returns)
    spans = np.array([m.span(1) for m in matches], dtype=np.int64).reshape(-1, 2)
    stated = np.array([_hex(m[2]) for m in matches], dtype=np.int64)
    # reduceat takes pairs (begin, end); a byte is added so that an end at the end of the chunk is an index
    sums = np.bitwise_xor.reduceat(np.append(raw, np.uint8(0)), spans.ravel())[::2] if matches else stated
    line = np.searchsorted(ends, spans[:, 0]).tolist()
    # 256: no hexadecimal number of two digits, which is a wrong checksum; -1: none stated
    return _Frames(matches, sums == stated, stated >= 0, line, len(ends))


def _hex(text: bytes | None) -> int:
    if text is None:
        return -1
    try:
        return int(text, 16) if len(text) == 2 else 256
    except ValueError:
        return 256


def _sentences(
    chunk: bytes,
    found: _Frames,
    first_line: int,
    wanted: frozenset[bytes],
    demand: bool,
    report: IntegrityReport,
) -> Iterator[Sentence]:
    n_good = int(np.count_nonzero(found.good))
    n_bare = int(np.count_nonzero(~found.stated))
    if n_good:
        report.count("sentences", n_good)
    if n_bad := len(found.matches) - n_good - n_bare:
        report.lose("bad_checksum", n_bad)
    if n_bare and demand:
        report.lose("without_checksum", n_bare)
    elif n_bare:
        report.count("sentences_without_checksum", n_bare)
    use = found.good if demand else found.good | ~found.stated
    kinds: dict[bytes, int] = {}
    end = 0
    for match, usable, line in zip(found.matches, use.tolist(), found.line, strict=True):
        start = match.start()
        t_host_s, source = float("nan"), ""
        if start - end > 2:
            t_host_s, source = _between(chunk[end:start], report, followed=True)
        end = match.end()
        if not usable:
            continue
        body = match[1]
        comma = body.index(b",")
        kind = body[:comma] if body.startswith(b"P") else body[2:comma]
        kinds[kind] = kinds.get(kind, 0) + 1
        if comma == 5 and kind in wanted:
            fields = body.decode("latin-1").split(",")
            yield Sentence(fields[0][:2] + source, fields[0][2:], fields, first_line + line + 1, t_host_s)
    if len(chunk) - end > 2:
        _between(chunk[end:], report, followed=False)
    for kind, n in kinds.items():
        report.count(kind.decode("ascii"), n)


def _between(text: bytes, report: IntegrityReport, *, followed: bool) -> tuple[float, str]:
    """Count what lies between sentences; logger's stamp before the next one, and its source if stated."""
    nothing = float("nan"), ""
    if not text.strip(_BLANK):
        return nothing
    lines = re.split(rb"[\r\n]+", text)
    prefix = lines.pop() if followed else b""
    for line in lines:
        if line.startswith(b"#"):
            report.count("comment_lines")
        elif line.strip(_BLANK):
            report.lose("foreign_bytes", len(line))
    if not prefix.strip(_BLANK):
        return nothing
    found = _prefix(prefix, report)
    if found is None:
        report.lose("foreign_bytes", len(prefix))
        return nothing
    report.count("prefixed_sentences")
    return found


def _prefix(prefix: bytes, report: IntegrityReport) -> tuple[float, str] | None:
    """Unix time and source in a prefix; NaN for a TAG block without a time; None if it is nothing known."""
    if tag := _TAG.search(prefix):
        total = 0
        for byte in tag[1]:
            total ^= byte
        if total != int(tag[2], 16):
            return None
        stamp, source = _TAG_TIME.search(tag[1]), _TAG_SOURCE.search(tag[1])
        name = " of " + source[1].decode("latin-1") if source else ""
        return _seconds(stamp[1]) if stamp else float("nan"), name
    if number := _UNIX.match(prefix):
        return _seconds(number[1]), ""
    if date := _ISO.match(prefix):
        year, month, day, hour, minute = (int(x) for x in date.groups()[:5])
        try:
            days = dt.date(year, month, day).toordinal() - _UNIX_ORDINAL
        except ValueError:
            return None
        if date[8]:
            minute -= (-1 if date[8].startswith(b"-") else 1) * (abs(int(date[8])) * 60 + int(date[9]))
        elif not date[7]:
            report.note("Stamps of the logger state no zone: they are taken as UTC.")
        return days * DAY_S + hour * 3600 + minute * 60 + float(date[6].replace(b",", b".")), ""
    return None


def _seconds(digits: bytes) -> float:
    """Unix time from a number of seconds, or of milliseconds where it has 12 or 13 digits."""
    value = float(digits)
    return value / 1000 if value > 1e11 else value


# ---------------------------------------------------------------- values out of NMEA fields: times, dates,
# coordinates, qualities, depths


_NAN: Final = float("nan")
_NO_DEPTH: Final = frozenset(NOTHING["depth"])
"""Depths by which an instrument says that it has none."""

FIX_OF_QUALITY: Final = {
    "0": "none", "1": "single", "2": "dgnss", "3": "single", "4": "fixed", "5": "float",
    "6": "dead_reckoning", "7": "none", "8": "none", "9": "sbas",
}  # fmt: skip
"""GGA field 6 -> fix; 7 is manual input, 8 a simulator, 9 SBAS in NovAtel receivers."""

FIX_OF_MODE: Final = {
    "R": "fixed", "F": "float", "D": "dgnss", "P": "single", "A": "single", "E": "dead_reckoning",
    "M": "none", "S": "none", "N": "none", "": "single",
}  # fmt: skip
"""Mode indicator of RMC, GLL (NMEA 2.3) and GNS -> fix, best first; older sentences have none."""


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


def length_m(fields: list[str], index: int) -> float:
    """A length in metres from a number and the letter of its unit behind it; no letter: metres.

    Raises
    ------
    ValueError : no finite number, or an unknown letter.
    """
    value, letter = number(fields, index), "".join(fields[index + 1 : index + 2]).strip()
    unit = unit_of_letter(letter or "M")
    if value == value and unit is None:
        raise ValueError(letter)
    return value * unit.metres if unit is not None else value


def below_depth(fields: list[str]) -> tuple[float, str]:
    """Depth in metres of DBT or DBS and the letter of its unit: metres if given, else feet, else fathoms.

    NaN if none is given. Depths in several units must agree to within 2 % and a unit of their last places:
    instruments round, or cut off, and one has fathoms of 1.85 m.

    Raises
    ------
    ValueError : an unknown unit, or depths that contradict each other.
    """
    stated: dict[str, tuple[float, float]] = {}
    for at in (1, 3, 5):
        value = number(fields, at)
        if value == value:
            letter = fields[at + 1].strip()
            unit = unit_of_letter(letter)
            if unit is None or letter in stated:
                raise ValueError(fields)
            depth = 0.0 if value in _NO_DEPTH else value * unit.metres
            stated[letter] = depth, unit.metres * 10.0 ** -len(fields[at].strip().partition(".")[2])
    seen = {letter: pair for letter, pair in stated.items() if pair[0] != 0.0} or stated
    for letter in ("M", "f", "F"):
        if letter in seen:
            depth, step = seen[letter]
            if any(abs(other - depth) > 0.02 * depth + step + more for other, more in seen.values()):
                raise ValueError(fields)
            return depth, letter
    return _NAN, ""


def water_temperature_c(fields: list[str]) -> float:
    """Temperature of the water by MTW, degrees Celsius; NaN if none is stated.

    Raises
    ------
    ValueError : another unit, or a temperature that liquid water does not have.
    """
    value = number(fields, 1)
    if value == value and (fields[2:3] not in (["C"], []) or not -3.0 <= value <= 60.0):
        raise ValueError(fields)
    return value


def pitch_and_roll_deg(fields: list[str]) -> tuple[float, float]:
    """Pitch and roll among the transducers of XDR, groups of type, value, unit, name; NaN where not there.

    Raises
    ------
    ValueError : an angle that is no number or more than a right angle.
    """
    found = {"pitch": float("nan"), "roll": float("nan")}
    for at in range(1, len(fields) - 3, 4):
        name = fields[at + 3].strip().upper()
        key = "pitch" if name.startswith(("PITCH", "PTCH")) else "roll" if name.startswith("ROLL") else ""
        if key and (fields[at].strip(), fields[at + 2].strip()) == ("A", "D"):
            angle = number(fields, at + 1)
            if abs(angle) > 90.0:
                raise ValueError(angle)
            found[key] = angle
    return found["pitch"], found["roll"]


# ---------------------------------------------------------------- sentences into rows


_TIME_FIELD: Final = {"GGA": 1, "GNS": 1, "RMC": 1, "GLL": 5, "GST": 1, "ZDA": 1}
_PLACE_FIELD: Final = {"GGA": 2, "GNS": 2, "RMC": 3, "GLL": 1}
_RANK: Final = {"GGA": 0, "GNS": 0, "RMC": 1, "GLL": 2}
"""Of sentences of the same time the one that says most is taken."""
_WANTED: Final = frozenset(k.encode() for k in (*_TIME_FIELD, "DBT", "DPT", "DBS", "MTW", "XDR", "DTM"))
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


@dataclass(slots=True)
class _Rows:
    """What the sentences say, in the order of the log; ``tick`` is the row of the latest time, -1: none."""

    times: list[tuple[str, float, float, bool, float, int]] = field(default_factory=list)
    fixes: list[tuple[int, str, str, float, float, float, str, int, float, float]] = field(
        default_factory=list
    )
    sigmas: list[tuple[int | str | float, ...]] = field(default_factory=list)
    depths: list[tuple[int, str, str, float, float, float, int, int]] = field(default_factory=list)
    temperatures: list[float] = field(default_factory=list)
    tilts: list[tuple[float, float]] = field(default_factory=list)
    void: dict[str, bool] = field(default_factory=dict)
    """Whether the receiver of a talker says that it has no fix."""
    decimals: int = 0
    """Most decimals of a time of day."""


_TIMES: Final = ["talker", "second", "day", "void", "t_host_s", "file"]
_FIXES: Final = [
    *("tick", "talker", "kind", "lat_deg", "lon_deg", "h_ell_m", "fix", "n_sats", "age_s", "step_m")
]
_DEPTHS: Final = ["tick", "talker", "sentence", "t_host_s", "depth_m", "offset_m", "line", "file"]
_PROPRIETARY: Final = re.compile("P[A-Z][A-Z0-9]{2,}$")
_GPS_EPOCH_DAY: Final = dt.date(1980, 1, 6).toordinal() - _UNIX_ORDINAL
_DATUMS: Final = frozenset(["", "W84", "P90", "999"])
"""Reference systems of DTM that agree with WGS 84, or say nothing."""


def _take(sentence: Sentence, rows: _Rows, file: int, report: IntegrityReport) -> None:
    """Take one sentence; a malformed one changes nothing."""
    kind, talker, f = sentence.kind, sentence.talker, sentence.fields
    if kind in _TIME_FIELD:
        text = "".join(f[_TIME_FIELD[kind] :][:1]).strip()
        second = second_of_day(text) if text else _NAN
        void = _void(kind, f)
        void = rows.void.get(talker, False) if void is None else void
        day = _NAN if void else _date(kind, f)
        fix = _fix(kind, f)
        sigma = tuple(number(f, i) for i in range(3, 9)) if kind == "GST" else ()
        rows.void[talker] = void
        tick = -1
        if second == second:
            tick = len(rows.times)
            rows.times.append((talker, second, day, void, sentence.t_host_s, file))
            rows.decimals = max(rows.decimals, len(text.partition(".")[2]))
        if fix is not None:
            rows.fixes.append((tick, talker, kind, *fix))
        elif kind == "GST":
            rows.sigmas.append((tick, talker, *sigma))
        elif kind != "ZDA":
            report.count("sentences_without_position")
    elif kind == "MTW":
        temperature = water_temperature_c(f)
        if temperature == temperature:
            rows.temperatures.append(temperature)
    elif kind == "XDR":
        rows.tilts.append(pitch_and_roll_deg(f))
    elif kind == "DTM":
        if (name := f[1].strip()) not in _DATUMS:
            report.note(f"The receiver states the datum {name} (DTM); positions are taken as WGS 84.")
    else:
        depth, letter = (number(f, 1), "M") if kind == "DPT" else below_depth(f)
        offset = number(f, 2) if kind == "DPT" else _NAN
        if depth != depth:
            report.count("empty_depths")
            return
        depth = 0.0 if depth in _NO_DEPTH else depth
        if depth < 0:
            raise ValueError(depth)
        if letter != "M":
            words = "feet (0.3048 m)" if letter == "f" else "fathoms (1.8288 m)"
            report.note(f"{kind} states depths in {words} only: they are converted.")
        tick = len(rows.times) - 1
        rows.depths.append((tick, talker, kind, sentence.t_host_s, depth, offset, sentence.line, file))


def _void(kind: str, f: list[str]) -> bool | None:
    """Whether the sentence says that the receiver has no fix; None: it does not tell."""
    if kind == "GGA":
        return f[6:7] in ([], [""], ["0"])
    if kind == "GNS":
        return not "".join(f[6:7]).strip("NM ")
    if kind == "RMC":
        return f[2] == "V"
    return f[6:7] == ["V"] if kind == "GLL" else None


def _date(kind: str, f: list[str]) -> float:
    """Days since 1970; NaN without a date, or with that of a receiver that counts from the GPS epoch."""
    day = _NAN
    if kind == "RMC" and len(f) > 9 and f[9].strip():
        if len(f[9]) != 6:
            raise ValueError(f[9])
        day = days_of_date(int(f[9][:2]), int(f[9][2:4]), int(f[9][4:]))
    if kind == "ZDA" and len(f) > 4 and all(x.strip() for x in f[2:5]):
        day = days_of_date(int(f[2]), int(f[3]), int(f[4]))
    return day if day > _GPS_EPOCH_DAY + 1 else _NAN


def _fix(kind: str, f: list[str]) -> tuple[float, float, float, str, int, float, float] | None:
    """Latitude, longitude, height, fix, satellites, age of corrections, metres of the last decimal."""
    at = _PLACE_FIELD.get(kind)
    if at is None or len(f) < at + 4 or not (f[at].strip() and f[at + 2].strip()):
        return None
    lat, lon = degrees(f[at], f[at + 1]), degrees(f[at + 2], f[at + 3])
    step_m = 1852.0 * 10.0 ** -len(f[at].strip().partition(".")[2])
    height, n_sats, age = _NAN, -1, _NAN
    if kind in ("GGA", "GNS"):
        satellites = number(f, 7)
        n_sats = int(satellites) if satellites == satellites else -1
        if kind == "GGA":
            fix = FIX_OF_QUALITY.get("".join(f[6:7]), "none")
            height, age = length_m(f, 9) + length_m(f, 11), number(f, 13)
        else:
            modes = "".join(f[6:7])  # one a system of satellites: the best tells
            fix = next((name for mode, name in FIX_OF_MODE.items() if mode and mode in modes), "none")
            height, age = number(f, 9) + number(f, 10), number(f, 11)
    else:
        status, mode = f[2:3], f[12:13]
        if kind == "GLL":  # of NMEA 2.0 ends before the status
            status, mode = f[6:7], f[7:8]
        fix = FIX_OF_MODE.get("".join(mode), "none") if "".join(status) in ("A", "D", "") else "none"
    return lat, lon, height, fix, n_sats, age, step_m


# ---------------------------------------------------------------- receivers: whose positions, whose time


_SATELLITES: Final = re.compile("G|BD|QZ")
"""Talkers of satellite systems: a receiver names those in use."""
_GOODNESS: Final = ("none", "dead_reckoning", "single", "dgnss", "sbas", "float", "fixed")
_SAME_PLACE_M: Final = 0.5
"""Sentences of one receiver at one time lie no farther apart, rounding aside."""
_FEW: Final = 0.1
"""A receiver with a smaller share of the positions than this is not chosen, however good."""


def _receivers(fixes: pd.DataFrame, second: ArrayF) -> tuple[pd.DataFrame, ArrayI]:
    """Fixes with their time ``clock_s`` over midnights, and the number of the receiver of each.

    Sentences belong together where they state the same place at the same time, whatever their talkers (GN and
    GP of one receiver). Without a common time, talkers belong together where the track of the one passes the
    places of the other; where they do not meet at all, satellite systems are of one receiver.
    """
    clock = np.full(len(fixes), np.nan)
    timed = np.isfinite(second)
    clock[timed] = np.unwrap(second[timed], period=DAY_S)
    clock = np.round(clock, 3)
    fixes = fixes.assign(clock_s=clock)
    block = np.cumsum(np.append(True, clock[1:] != clock[:-1])[: len(clock)])
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


def _choose(
    fixes: pd.DataFrame, receiver: ArrayI, sigmas: pd.DataFrame, report: IntegrityReport
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Fixes of the best receiver and the standard deviations that its talkers state; the others are named."""
    owners = {int(k): set(fixes["talker"][receiver == k]) for k in np.unique(receiver)}
    horizontal = np.hypot(*sigmas[["sigma_north_m", "sigma_east_m"]].to_numpy(np.float64).T)

    def merit(k: int) -> tuple[bool, float, float, int, int]:
        """What speaks for a receiver, the smaller the better."""
        rows = fixes[receiver == k]
        stated = horizontal[sigmas["talker"].isin(owners[k])]
        goodness = float(np.median([_GOODNESS.index(fix) for fix in rows["fix"]]))
        few = len(rows) < _FEW * len(fixes) / len(owners)
        best = min(_RANK[kind] for kind in rows["kind"].unique())
        return few, -goodness, _median(stated[np.isfinite(stated)], np.inf), best, -len(rows)

    ranked = sorted(owners, key=merit)
    chosen = fixes[receiver == ranked[0]]
    for k in ranked[1:]:
        other = fixes[receiver == k]
        report.count("positions_of_other_receivers", len(other))
        apart = _apart_m(chosen, other)[0]
        far = f", {apart:.1f} m from it" if np.isfinite(apart) else ""
        report.note(f"Positions come from {_named(chosen)}; those of {_named(other)}{far}, are not used.")
    foreign = set().union(*(owners[k] for k in ranked[1:])) - owners[ranked[0]]
    return chosen, sigmas[~sigmas["talker"].isin(foreign)]


def _named(rows: pd.DataFrame) -> str:
    """A receiver in words: talkers, sentences, how many, the usual fix."""
    talkers, kinds = ("/".join(rows[name].unique()) for name in ("talker", "kind"))
    return f"{talkers} ({kinds} {len(rows):,}, {rows['fix'].mode()[0]})"


# ---------------------------------------------------------------- time of the log


_HALF_DAY_S: Final = 43_200
_SHORTEST_HOLE_S: Final = 60.0
_ROLLOVER_DAYS: Final = 7168
"""The week counter of GPS begins anew after 1024 weeks."""
_FIRST_YEARS_DAY: Final = dt.date(2000, 1, 1).toordinal() - _UNIX_ORDINAL
"""Recordings of boats of before are rarer than receivers whose week counter rolled over."""


@dataclass(slots=True, kw_only=True)
class _Timeline:
    """Times of the log, arrays (n,) over its time sentences.

    Attributes
    ----------
    base : the sentence whose time holds then; -1: none.
    clock_s : second over midnights; NaN where the receiver had no time. t_gps_s : NaN without a date.
    second, t_host_s, file : as they are in the log.
    dated : whether any date is known.
    steps_back, files_back : how often the time goes back; files whose begin does.
    """

    base: ArrayI
    clock_s: ArrayF
    t_gps_s: ArrayF
    second: ArrayF
    t_host_s: ArrayF
    file: ArrayI
    dated: bool = False
    steps_back: int = 0
    files_back: set[int] = field(default_factory=set)

    def at(self, tick: ArrayI, file: ArrayI) -> ArrayI:
        """Sentence (k,) whose time holds for what follows the time sentence ``tick`` (k,) in ``file`` (k,).

        What stands ahead of a file's first time has none: the last time of the file before may be older by
        hours, or newer where the files overlap.
        """
        if not len(self.base):
            return np.full(len(tick), -1)
        base = np.where(tick >= 0, self.base[tick], -1)
        return np.where((self.file[base] == file) & np.isfinite(self.clock_s[base]), base, -1)

    def of(self, values: ArrayF, base: ArrayI) -> ArrayF:
        """Values (k,) of the sentences ``base`` (k,), NaN without one."""
        return np.where(base >= 0, values[base], np.nan) if len(values) else np.full(len(base), np.nan)


def _timeline(
    times: pd.DataFrame, talkers: set[str], date: dt.date | None, report: IntegrityReport
) -> _Timeline:
    """Time of the sentences of the receiver of ``talkers`` and of those that agree with it.

    A stretch between holes in which a receiver had no fix counts from when it was switched on: it is no time.
    A date holds for its stretch, before it too, and for stretches behind it that state none.
    """
    second, file = times["second"].to_numpy(np.float64), times["file"].to_numpy(np.int64)
    out = _Timeline(
        base=np.full(len(times), -1),
        clock_s=np.full(len(times), np.nan),
        t_gps_s=np.full(len(times), np.nan),
        second=second,
        t_host_s=times["t_host_s"].to_numpy(np.float64),
        file=file,
    )
    own = np.flatnonzero(times["talker"].isin(_agreeing(times, talkers, report)))
    given = _NAN if date is None else float(days_of_date(date.day, date.month, date.year))
    out.dated = given == given
    if not own.size:
        return out
    out.base[own] = own
    out.base = np.maximum.accumulate(out.base)
    step = _wrapped(np.diff(second[own], prepend=second[own[0]]))
    hole = np.abs(step) > max(_SHORTEST_HOLE_S, 10 * _median(step[step > 0], 0.0))
    run = pd.Series(np.cumsum(hole))
    day = times["day"].to_numpy(np.float64)[own]
    sure = pd.Series(np.isfinite(day) | ~times["void"].to_numpy(np.bool_)[own]).groupby(run).transform("any")
    if sure.any():
        own, run, day = own[sure], run[sure], day[sure]
    s, f = second[own], file[own]
    midnights = _midnights(s, f, out)
    epoch = np.cumsum(np.diff(s, prepend=s[0]) != 0)
    dates = pd.Series(day - midnights, index=run.index).groupby([run.to_numpy(), epoch]).transform("last")
    dates = dates.groupby(run).ffill().groupby(run).bfill()
    zero = dates.to_numpy()
    change = np.diff(zero, prepend=np.nan) * (np.diff(f, prepend=f[0]) == 0)
    if jumps := int(
        np.sum((change != 0) & np.isfinite(change) & ((np.diff(run, prepend=0) == 0) | (change < 0)))
    ):
        report.lose("date_jumps", jumps)
        report.note(
            f"The date jumps {jumps} times without a midnight: two logs in one file, or a receiver whose "
            "week counter rolled over (1024 weeks)."
        )
    zero = dates.ffill().to_numpy()
    if np.isfinite(zero).any():
        out.dated = True
        first = float((zero + midnights)[np.isfinite(zero)][0])
        if given == given and given != first:
            off = round(given - first)
            if off % _ROLLOVER_DAYS == 0:
                # not those behind a jump, of a receiver that found the right week meanwhile
                zero = zero + off * (np.abs(zero - zero[np.isfinite(zero)][0]) < _ROLLOVER_DAYS / 2)
                report.note(f"Dates of the log are {off // 7} weeks off by the given date {date}: put right.")
            else:
                report.note(f"The log states its own date; the given date {date} is not used.")
    else:
        zero = np.full(len(own), given)
    out.clock_s[own] = midnights * DAY_S + s
    out.t_gps_s[own] = _gps(zero + midnights, s)
    report.timing.describe_host(out.t_gps_s, out.t_host_s)
    _say_dates(out.t_gps_s[own], zero + midnights, report)
    return out


def _wrapped(seconds: ArrayF) -> ArrayF:
    """Differences of times of day, to within half a day."""
    return np.asarray((seconds + _HALF_DAY_S) % DAY_S - _HALF_DAY_S)


def _median(values: ArrayF, otherwise: float = _NAN) -> float:
    return float(np.median(values)) if len(values) else otherwise


def _gps(day: ArrayF, second: ArrayF) -> ArrayF:
    """GPS time of seconds of the day; second 60 of a leap second is one after second 59."""
    leap = (second >= DAY_S).astype(np.float64)
    whole = np.floor(second - leap)
    return np.asarray(gps_from_unix(day * DAY_S + whole) + (second - leap - whole) + leap)


def _agreeing(times: pd.DataFrame, talkers: set[str], report: IntegrityReport) -> set[str]:
    """The talkers whose times agree with those of a receiver; the dates of others than it are taken out."""
    present = times["talker"].value_counts()
    own = talkers & set(present.index) or set(present.index[:1])
    at = np.flatnonzero(times["talker"].isin(own))
    second, day = times["second"].to_numpy(), times["day"].to_numpy().copy()
    period = _median(np.diff(np.unique(second[at])))
    agreeing, dated = set(own), np.isfinite(day[at]).any()
    for talker in set(present.index) - own:
        rows = np.flatnonzero(times["talker"] == talker)
        before = np.searchsorted(at, rows) - 1
        off = _median(_wrapped(second[rows] - second[at[before]])[before >= 0], 0.0)
        days = (
            np.nanmedian(day[rows]) - np.nanmedian(day[at]) if dated and np.isfinite(day[rows]).any() else 0
        )
        late = abs(off) > (period if period == period else 1.0) + 0.5
        if not late:
            agreeing.add(talker)
        if late or abs(days) > 1:
            off = off * late + days * DAY_S
            report.note(
                f"The clock of {talker} is {off:+,.1f} s off that of {'/'.join(sorted(own))}; its "
                f"{'times' if late else 'dates'} are not used. {explain_shift(off)}".strip()
            )
        if dated:
            day[rows] = np.nan
    times["day"] = day
    return agreeing


def _midnights(second: ArrayF, file: ArrayI, out: _Timeline) -> ArrayI:
    """Midnights (n,) since the first of the times (n,); counts what goes back in ``out``."""
    step, begins = np.diff(second, prepend=second[0]), np.diff(file, prepend=file[0]) > 0
    turn, count = np.zeros(len(second), dtype=np.int64), 0
    for i in np.flatnonzero((step < 0) | (step > _HALF_DAY_S)).tolist():
        # a sentence of before midnight that came late, or a file that overlaps
        late = count > 0 and (begins[i] or (second[i - 1] < 60 and second[i] > DAY_S - 60))
        if step[i] < -_HALF_DAY_S or (step[i] > 0 and late):
            turn[i] = 1 if step[i] < 0 else -1
            count += turn[i]
        if begins[i] and (-_HALF_DAY_S <= step[i] < 0 or turn[i] < 0):
            out.files_back.add(int(file[i]))
        elif -_HALF_DAY_S <= step[i] < 0:
            out.steps_back += 1
    return np.cumsum(turn)


def _say_dates(t_gps_s: ArrayF, day: ArrayF, report: IntegrityReport) -> None:
    """What stamps of the logger say of the dates, and dates at which hardly anybody surveyed."""
    off = report.timing.clock_offset_s
    known = day[np.isfinite(day)]
    weeks = 0 if off is None else round(off / (_ROLLOVER_DAYS * DAY_S)) * 1024
    if off is not None and weeks > 0 and abs(off - weeks * 7 * DAY_S) < DAY_S:
        true = dt.date.fromordinal(int(known[0]) + _UNIX_ORDINAL + 7 * weeks)
        report.lose("dates_off_by_1024_weeks", len(known))
        report.note(
            f"The dates are {weeks} weeks before the stamps of the logger: the week counter of the "
            f"receiver rolled over. State logs.depth_date: {true}."
        )
    elif off is not None and (words := explain_shift(off)):
        report.note(f"The logger's clock differs from the sentences by {words}.")
    if off is None and known.size and known[0] < _FIRST_YEARS_DAY:
        later = (str(dt.date.fromordinal(int(known[0]) + _UNIX_ORDINAL + k * _ROLLOVER_DAYS)) for k in (1, 2))
        report.note(
            "The dates are before 2000, as of a receiver whose week counter rolled over (1024 weeks). If so, "
            f"state logs.depth_date: {' or '.join(later)}."
        )


# ---------------------------------------------------------------- reader


@dataclass(slots=True, kw_only=True)
class NmeaLog:
    """A log: positions (``gnss_position``), depths (``depth``), and the report.

    The report's details hold the medians ``water_temperature_c`` (MTW), ``pitch_deg`` and ``roll_deg`` of the
    instrument (XDR), and ``sigma_depth_time_s``, the standard deviation of times of depths that were placed
    between two time sentences.
    """

    positions: pd.DataFrame
    depths: pd.DataFrame
    report: IntegrityReport

    def with_depths(self) -> Self:
        """The log itself.

        Raises
        ------
        InputError : no depth above 0 stands in it.
        """
        if not self.report.counts["depths"]:
            seen = {
                "no_bottom": "depths of 0",
                "empty_depths": "empty depths",
                "DBK": "depths below the keel (DBK), which are not read",
            }
            met = [
                f"{self.report.counts[k]:,} {words}" for k, words in seen.items() if k in self.report.counts
            ]
            raise InputError(
                "no depth above 0 in the log" + (": " + ", ".join(met) if met else ""),
                expected="sentences DPT, DBT or DBS of an echo sounder",
                where=", ".join(self.report.files),
                cure="Let the instrument send DPT, or leave out logs.depth",
            )
        return self


def read_nmea(files: Sequence[Path], date: dt.date | None = None) -> NmeaLog:
    """Read one or several NMEA logs.

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
    report = IntegrityReport(stream="nmea", format="NMEA 0183", files=[str(f) for f in files])
    rows = _Rows()
    bad: list[str] = []
    for index, path in enumerate(files):
        for sentence in scan_sentences(path, _WANTED, report):
            try:
                _take(sentence, rows, index, report)
            except (ValueError, IndexError):
                bad.append(f"{path.name} line {sentence.line}")
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
    return _log(rows, date, report)


def _log(rows: _Rows, date: dt.date | None, report: IntegrityReport) -> NmeaLog:
    times = pd.DataFrame(rows.times, columns=_TIMES).astype({"second": np.float64, "day": np.float64})
    fixes = pd.DataFrame(rows.fixes, columns=_FIXES)
    sigmas = pd.DataFrame(rows.sigmas, columns=["tick", "talker", *_SIGMAS])
    if len(fixes):
        report.count("position_sentences", len(fixes))
        tick = fixes["tick"].to_numpy()
        second = times["second"].to_numpy()[tick] if len(times) else np.full(len(fixes), np.nan)
        fixes, receiver = _receivers(fixes, np.where(tick >= 0, second, np.nan))
        fixes, sigmas = _choose(fixes, receiver, sigmas, report)
    else:
        fixes = fixes.assign(clock_s=0.0)
    line = _timeline(times, set(fixes["talker"]), date, report)
    positions, position_file = _positions(fixes, sigmas, line, report)
    depths = _depths(rows, line, report)
    overlapping: set[int] = set()
    positions = _once(positions, position_file, "positions", overlapping, report)
    depths = _once(depths, depths["file"].to_numpy(), "depths", overlapping, report)
    if back := line.steps_back + len(line.files_back - overlapping):
        report.lose("time_steps_back", back)
    if line.dated:
        untimed = depths["t_gps_s"].isna() & (depths["tick"] >= 0)
        for name, n in (("positions", positions["t_gps_s"].isna().sum()), ("depths", untimed.sum())):
            if n:
                report.lose(f"{name}_without_time", n)
                report.note(f"{n:,} {name} come from before the receiver knew time and date: they get none.")
    depths["t_gps_s"] += _since_sentence_s(depths, line, report)
    table = depths[list(DEPTH.names)].astype({"line": np.int64, "sentence": object})
    _summarise(report, positions, table, line, rows)
    return NmeaLog(positions=positions, depths=table, report=report)


_SIGMAS: Final = ("major_m", "minor_m", "axis_deg", "sigma_north_m", "sigma_east_m", "sigma_up_m")


def _positions(
    fixes: pd.DataFrame, sigmas: pd.DataFrame, line: _Timeline, report: IntegrityReport
) -> tuple[pd.DataFrame, ArrayI]:
    """Table of kind ``gnss_position``, one row an epoch, and the number of the file of each row."""
    second = line.of(line.second, fixes["tick"].to_numpy(np.int64))
    epoch = np.cumsum(np.diff(second, prepend=np.nan) != 0)  # NaN differs from everything
    rank = fixes["kind"].map(_RANK).to_numpy(np.int64)
    kept = fixes.iloc[np.lexsort((rank, epoch))]
    kept = kept[~pd.Series(np.sort(epoch), index=kept.index).duplicated()].sort_index()
    tick = kept["tick"].to_numpy(np.int64)
    file = line.file[tick] if len(line.file) else np.zeros(len(kept), dtype=np.int64)
    base = line.at(tick, file)
    own = np.where(base == tick, base, -1)
    stated = sigmas.assign(clock_s=line.of(line.clock_s, sigmas["tick"].to_numpy(np.int64)))
    stated = stated.dropna(subset="clock_s").drop_duplicates("clock_s", keep="last").set_index("clock_s")
    gst = stated[list(_SIGMAS)].reindex(line.of(line.clock_s, own)).to_numpy(np.float64)
    major, minor, angle = gst[:, 0], gst[:, 1], np.deg2rad(gst[:, 2])
    cov_en = (major**2 - minor**2) * np.sin(angle) * np.cos(angle)
    # An ellipse that contradicts the standard deviations by more than the rounding to 1 mm is not used.
    inside = np.abs(cov_en) <= gst[:, 3] * gst[:, 4]
    if lost := int(np.count_nonzero(np.isfinite(cov_en) & ~inside)):
        report.lose("contradicting_error_ellipses", lost)
    table = kept.assign(
        t_gps_s=line.of(line.t_gps_s, own),
        n_sats=kept["n_sats"].astype(np.int32),
        sigma_north_m=gst[:, 3],
        sigma_east_m=gst[:, 4],
        sigma_up_m=gst[:, 5],
        cov_en_m2=np.where(inside, cov_en, np.nan),
        cov_eu_m2=np.nan,
        cov_nu_m2=np.nan,
        ratio=np.nan,
    )
    if bare := int((kept["kind"].isin(["GGA", "GNS"]) & kept["h_ell_m"].isna()).sum()):
        kinds = "/".join(sorted(set(kept["kind"]) & {"GGA", "GNS"}))
        report.note(f"{bare} {kinds} sentences have no geoid separation: no ellipsoidal height can be given.")
    if void := int((kept["fix"] == "none").sum()):
        report.count("positions_without_fix", void)
    table = table[list(GNSS_POSITION.names)].astype({"fix": object}).reset_index(drop=True)
    return table, file


def _depths(rows: _Rows, line: _Timeline, report: IntegrityReport) -> pd.DataFrame:
    """Depths, each with the time of the sentence before it; what a second talker repeats is left out."""
    table = pd.DataFrame(rows.depths, columns=_DEPTHS)
    kept = [_one_talker(part, report) for _, part in table.groupby("sentence", sort=False)]
    table = pd.concat(kept).sort_index() if kept else table
    floats = dict.fromkeys(("t_host_s", "depth_m", "offset_m"), np.float64)
    table = table.astype(floats | {"tick": np.int64, "file": np.int64})
    base = line.at(table["tick"].to_numpy(), table["file"].to_numpy())
    t_day_s, t_gps_s = line.of(line.second, base), line.of(line.t_gps_s, base)
    return table.assign(base=base, t_day_s=t_day_s, t_gps_s=t_gps_s).reset_index(drop=True)


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
        kind = f"{talker}{other['sentence'].iloc[0]}"
        report.count("repeated_depths_of_other_talkers", len(other))
        report.note(
            f"{len(other):,} depths of {kind} stand beside those of {main} (median difference "
            f"{apart:.2f} m): one ping is one sounding, they are left out."
        )
        part = part.drop(other.index)
    return part


def _since_sentence_s(depths: pd.DataFrame, line: _Timeline, report: IntegrityReport) -> ArrayF:
    """Time (n,) from the time sentence before each depth to the depth.

    By the stamps of the logger where both have one. Else, where usually several depths stand between two
    times, they are spread evenly, with an error of up to half a step; a single one gets the time before it.
    """
    since = np.zeros(len(depths))
    timed = np.flatnonzero(depths["base"] >= 0)
    if not timed.size:
        return since
    own = np.flatnonzero(np.isfinite(line.clock_s))
    epoch = np.full(len(line.clock_s), -1)
    epoch[own] = np.cumsum(np.diff(line.clock_s[own], prepend=np.nan) != 0) - 1
    starts = own[np.flatnonzero(np.diff(epoch[own], prepend=-1))]
    lasts = np.append(np.diff(line.clock_s[starts]), np.nan)
    lasts[(np.append(np.diff(line.file[starts]), 1) != 0) | ~(lasts > 0)] = np.nan
    usual_s = _median(lasts[np.isfinite(lasts)])
    ping = depths.iloc[timed]
    base = ping["base"].to_numpy()
    host = ping["t_host_s"] - line.t_host_s[base]
    key = [ping["sentence"], epoch[base]]
    n, k = host.groupby(key).transform("size").to_numpy(), host.groupby(key).cumcount().to_numpy()
    length = lasts[epoch[base]]
    inside = host.between(0.0, np.where(np.isfinite(length), length, 1.5 * usual_s))
    stamped = (inside & ~(host.groupby(key).diff() <= 0)).groupby(key).transform("all").to_numpy()
    jitter = np.diff((line.t_host_s - line.clock_s)[own])
    passed = np.where(stamped, host, 0.0)
    sigma = stamped * NMAD / np.sqrt(2) * _median(np.abs(jitter[np.isfinite(jitter)]), 0.0)
    normal = length <= 1.5 * usual_s
    spread = np.zeros(len(ping), dtype=np.bool_)
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
            spread |= here
    if spread.any():
        report.note(
            f"{spread.sum():,} depths, several between two times, are spread evenly; stamps of the logger "
            "before each sentence would tell more."
        )
    if sigma.any():
        report.details["sigma_depth_time_s"] = round(float(np.sqrt(np.mean(sigma**2))), 4)
    since[timed] = passed
    return since


def _once(
    table: pd.DataFrame, file: ArrayI, what: str, overlapping: set[int], report: IntegrityReport
) -> pd.DataFrame:
    """The table without what an earlier file holds at the same time; such files go into ``overlapping``.

    Rows without GPS time are all kept: a second of an unknown day is no time stamp.
    """
    content = table.drop(columns=["line", "file", "tick", "base"], errors="ignore")
    repeated = repeated_rows(content, file) & np.isfinite(table["t_gps_s"].to_numpy())
    overlapping.update(np.unique(file[repeated]).tolist())
    say_repeated(report, what, int(repeated.sum()))
    return table[~repeated].reset_index(drop=True)


def _summarise(
    report: IntegrityReport, positions: pd.DataFrame, depths: pd.DataFrame, line: _Timeline, rows: _Rows
) -> None:
    n_depths = int(np.count_nonzero(depths["depth_m"] > 0))
    for what, n in (("positions", len(positions)), ("depths", n_depths)):
        report.count(what, n)
    t = np.concatenate([positions["t_gps_s"], depths["t_gps_s"]])
    t = t[np.isfinite(t)]
    report.synchronised = bool(t.size)
    known = line.clock_s[np.isfinite(line.clock_s)]
    report.time_scale = "utc" if known.size else "none"
    if t.size:
        report.t_first_s, report.t_last_s = float(t.min()), float(t.max())
    elif known.size:
        report.t_first_s, report.t_last_s = float(known.min()), float(known.max())
        if not line.dated:
            stamp = line.t_host_s[np.isfinite(line.t_host_s)]
            day = (
                f": {dt.datetime.fromtimestamp(stamp[0], dt.UTC):%Y-%m-%d} by the logger"
                if stamp.size
                else ""
            )
            report.note(
                "The log has times but no date: nothing is synchronised. Give the UTC date of its start "
                f"(logs.depth_date{day})."
            )
    else:
        report.note("The log has no time sentence: nothing is synchronised.")
    regular = positions["t_gps_s"].dropna().drop_duplicates().to_numpy()
    report.gaps = find_gaps(regular)
    report.timing.describe_stamps(regular, 10.0**-rows.decimals if known.size else None)
    if len(regular) > 2 and np.any(np.diff(regular) > 0):
        report.rates_hz["positions"] = 1.0 / float(np.median(np.diff(regular)[np.diff(regular) > 0]))
    _summarise_instrument(report, depths, rows)
    held = {kind: what for kinds, what in _UNREAD.items() for kind in kinds.split()}
    unread = [
        f"{kind} {n:,} ({held.get(kind, 'proprietary')})"
        for kind, n in report.counts.items()
        if kind in held or _PROPRIETARY.match(kind)
    ]
    if unread:
        report.note("Not read: " + ", ".join(unread) + ".")


def _summarise_instrument(report: IntegrityReport, depths: pd.DataFrame, rows: _Rows) -> None:
    """Pings without bottom, and the medians of what the echo sounder says about the water and itself."""
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
    if silent := int(np.count_nonzero(depths["depth_m"] == 0)):
        report.count("no_bottom", silent)
        report.note(f"{silent:,} depths are 0, or a number for none: the instrument saw no bottom.")
    tilts = np.array(rows.tilts, dtype=np.float64).reshape(-1, 2)
    for name, values in (
        ("water_temperature_c", np.array(rows.temperatures)),
        ("pitch_deg", tilts[:, 0]),
        ("roll_deg", tilts[:, 1]),
    ):
        if np.isfinite(values).any():
            report.details[name] = round(float(np.nanmedian(values)), 3)
