"""NMEA 0183 logs: positions, depths and headings with the UTC time that the sentences carry.

Time. GGA, RMC, GLL, GST and ZDA carry the second of the UTC day, RMC and ZDA the date too. A depth has no
time of its own: it gets the time of the latest time sentence before it (``t_day_s``), so it may be late
by up to the interval of these sentences plus the latency of the instrument. No time is interpolated
here; that is the task of ``timing``. Without any date, and if the caller knows none, nothing is
synchronised: ``t_gps_s`` stays NaN.

Heights are ellipsoidal: GGA field 9 (above the geoid) plus field 11 (geoid above ellipsoid).
The offset of DPT is handed on and never added. A depth of 0 is how echo sounders say that they
saw no bottom: it stays in the table, counts as ``no_bottom`` and not among the depths. The temperature of the
water comes from MTW, the instrument's own pitch and roll from XDR (NMEA 0183, transducer type A in degrees).

A checksum is the exclusive or of all characters between ``$`` and ``*`` (NMEA 0183, "Sentence
structure"). It is computed for a whole chunk at once; only wanted sentences become Python strings.
"""

import datetime as dt
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core import DAY_S, ArrayF, ArrayI, InputError, gps_from_unix
from thalweg.ingest import (
    DEPTH,
    GNSS_POSITION,
    IntegrityReport,
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
_UNIX: Final = re.compile(rb"^\W*(\d{9,10}(?:\.\d+)?|\d{13})\W*$")
_ISO: Final = re.compile(
    rb"^\W*(\d{4})[-/](\d\d)[-/](\d\d)[ T,;]+(\d\d):(\d\d):(\d\d(?:\.\d+)?)(?:Z|[+-]00:?00)?\W*$"
)
_BLANK: Final = b"\r\n \t\0"
_CHUNK: Final = 1 << 22
_UNIX_ORDINAL: Final = dt.date(1970, 1, 1).toordinal()


@dataclass(frozen=True, slots=True)
class Sentence:
    """A sentence with a good checksum: three-letter type, fields, line from 1, logger's Unix time or NaN."""

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
        t_host_s = float("nan")
        if start - end > 2:
            t_host_s = _between(chunk[end:start], report, followed=True)
        end = match.end()
        if not usable:
            continue
        body = match[1]
        comma = body.index(b",")
        kind = body[2:comma]
        kinds[kind] = kinds.get(kind, 0) + 1
        if comma == 5 and kind in wanted:
            fields = body.decode("latin-1").split(",")
            yield Sentence(fields[0][2:], fields, first_line + line + 1, t_host_s)
    if len(chunk) - end > 2:
        _between(chunk[end:], report, followed=False)
    for kind, n in kinds.items():
        report.count(kind.decode("ascii"), n)


def _between(text: bytes, report: IntegrityReport, *, followed: bool) -> float:
    """Count what lies between sentences; returns the logger's time stamp in front of the next one."""
    if not text.strip(_BLANK):
        return float("nan")
    lines = re.split(rb"[\r\n]+", text)
    prefix = lines.pop() if followed else b""
    for line in lines:
        if line.startswith(b"#"):
            report.count("comment_lines")
        elif line.strip(_BLANK):
            report.lose("foreign_bytes", len(line))
    if not prefix.strip(_BLANK):
        return float("nan")
    stamp = _host_time(prefix)
    if stamp is None:
        report.lose("foreign_bytes", len(prefix))
        return float("nan")
    report.count("prefixed_sentences")
    return stamp


def _host_time(prefix: bytes) -> float | None:
    """Unix time in a prefix; NaN for a TAG block without one; None if the prefix is nothing known."""
    if tag := _TAG.search(prefix):
        total = 0
        for byte in tag[1]:
            total ^= byte
        stamp = _TAG_TIME.search(tag[1])
        if total != int(tag[2], 16):
            return None
        return _seconds(stamp[1]) if stamp else float("nan")
    if number := _UNIX.match(prefix):
        return _seconds(number[1])
    if date := _ISO.match(prefix):
        year, month, day, hour, minute = (int(x) for x in date.groups()[:5])
        try:
            days = dt.date(year, month, day).toordinal() - _UNIX_ORDINAL
        except ValueError:
            return None
        return days * 86400.0 + hour * 3600 + minute * 60 + float(date[6])
    return None


def _seconds(digits: bytes) -> float:
    """Unix time from a number of seconds, or of milliseconds where it has 12 or 13 digits."""
    value = float(digits)
    return value / 1000 if value > 1e11 else value


# ---------------------------------------------------------------- Positions of NMEA epochs: one a time,
# with the standard deviations of GST


_NAN: Final = float("nan")
_RANK: Final = {"GGA": 0, "RMC": 1, "GLL": 2}

Seconds = Callable[[ArrayF, ArrayF, ArrayF], ArrayF]
"""Second of the day, midnights since the start, day of midnight 0 -> ``t_gps_s``."""


@dataclass(slots=True)
class Fix:
    """Position of one sentence."""

    kind: str
    lat_deg: float
    lon_deg: float
    h_ell_m: float = _NAN
    fix: str = "none"
    n_sats: int = -1
    age_s: float = _NAN
    second: float = _NAN
    midnights: int = 0
    day_zero: float = _NAN
    file: int = 0
    """Number of the file that holds the sentence."""


def position_table(
    fixes: list[Fix], sigmas: list[tuple[float, ...]], seconds: Seconds, report: IntegrityReport
) -> tuple[pd.DataFrame, ArrayI]:
    """Table of kind ``gnss_position``, one row an epoch, and the number of the file of each row.

    Parameters
    ----------
    fixes : positions in the order of the log.
    sigmas : of GST: second of the day, midnights, semi-major and semi-minor standard deviation (m), its
        orientation (degrees from true north), standard deviations of latitude, longitude, height (m).
    seconds : time onto the GPS axis.
    report : takes the counts.
    """
    kept: list[Fix] = []
    for fix in fixes:
        last = kept[-1] if kept else None
        if (
            last is None
            or fix.second != fix.second
            or (fix.second, fix.midnights) != (last.second, last.midnights)
        ):
            kept.append(fix)
        elif _RANK[fix.kind] < _RANK[last.kind]:
            kept[-1] = fix
    if fixes:
        report.count("position_sentences", len(fixes))
    n = len(kept)
    by_time = {(s[0], int(s[1])): s[2:] for s in sigmas if s[0] == s[0]}
    none = (_NAN,) * 6
    gst = np.array([by_time.get((f.second, f.midnights), none) for f in kept], dtype=np.float64).reshape(
        -1, 6
    )
    major, minor, angle = gst[:, 0], gst[:, 1], np.deg2rad(gst[:, 2])
    sigma_north, sigma_east = gst[:, 3], gst[:, 4]
    cov_en = (major**2 - minor**2) * np.sin(angle) * np.cos(angle)
    # An ellipse that contradicts the standard deviations by more than the rounding to 1 mm is not used.
    bound = sigma_north * sigma_east
    inside = np.abs(cov_en) <= bound
    lost = int(np.count_nonzero(np.isfinite(cov_en) & ~inside))
    if lost:
        report.lose("contradicting_error_ellipses", lost)
    columns = {name: np.array([getattr(f, name) for f in kept], dtype=np.float64) for name in _FLOATS}
    unknown = np.full(n, np.nan)
    table = pd.DataFrame(
        {
            "t_gps_s": seconds(columns["second"], columns["midnights"], columns["day_zero"]),
            "lat_deg": columns["lat_deg"],
            "lon_deg": columns["lon_deg"],
            "h_ell_m": columns["h_ell_m"],
            "fix": pd.Series([f.fix for f in kept], dtype=object),
            "n_sats": np.array([f.n_sats for f in kept], dtype=np.int32),
            "sigma_east_m": sigma_east,
            "sigma_north_m": sigma_north,
            "sigma_up_m": gst[:, 5],
            "cov_en_m2": np.where(inside, cov_en, np.nan),
            "cov_eu_m2": unknown,
            "cov_nu_m2": unknown,
            "age_s": columns["age_s"],
            "ratio": unknown,
        }
    )
    bare = sum(f.kind == "GGA" and f.h_ell_m != f.h_ell_m for f in kept)
    if bare:
        report.note(f"{bare} GGA sentences have no geoid separation: no ellipsoidal height can be given.")
    return table[list(GNSS_POSITION.names)], np.array([f.file for f in kept], dtype=np.int64)


_FLOATS: Final = ("second", "midnights", "day_zero", "lat_deg", "lon_deg", "h_ell_m", "age_s")


# ---------------------------------------------------------------- values out of NMEA fields: times, dates,
# coordinates, qualities, depths


FOOT_M: Final = 0.3048
FATHOM_M: Final = 1.8288

FIX_OF_QUALITY: Final = {
    "0": "none",
    "1": "single",
    "2": "dgnss",
    "3": "single",
    "4": "fixed",
    "5": "float",
    "6": "dead_reckoning",
    "7": "none",
    "8": "none",
    "9": "sbas",
}
"""GGA field 6 -> fix; 7 is manual input, 8 a simulator, 9 SBAS in NovAtel receivers."""

FIX_OF_MODE: Final = {
    "A": "single",
    "D": "dgnss",
    "R": "fixed",
    "F": "float",
    "P": "single",
    "E": "dead_reckoning",
    "M": "none",
    "S": "none",
    "N": "none",
    "": "single",
}
"""Mode indicator of RMC and GLL (NMEA 2.3) -> fix; older sentences have none."""


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


# ---------------------------------------------------------------- reader


_TIME_FIELD: Final = {"GGA": 1, "RMC": 1, "GLL": 5, "GST": 1, "ZDA": 1}
_WANTED: Final = frozenset(k.encode() for k in (*_TIME_FIELD, "HDT", "DBT", "DPT", "DBS", "MTW", "XDR"))
_HALF_DAY_S: Final = 43_200
_DEPTH_FLOATS: Final = ("t_day_s", "midnights", "day_zero", "t_host_s", "depth_m", "offset_m")


@dataclass(slots=True, kw_only=True)
class NmeaLog:
    """A log: positions (``gnss_position``), depths (``depth``), headings, and the report.

    ``headings`` has ``t_gps_s`` and ``t_day_s`` (as of a depth), ``heading_deg`` (clockwise from true
    north, HDT) and ``line``. ``temperatures`` of the water (MTW) and ``tilts`` of the instrument (XDR) are
    such tables with ``temperature_c``, and with ``pitch_deg`` and ``roll_deg``, NaN where only one is stated.
    """

    positions: pd.DataFrame
    depths: pd.DataFrame
    headings: pd.DataFrame
    temperatures: pd.DataFrame
    tilts: pd.DataFrame
    report: IntegrityReport


@dataclass(slots=True)
class _Clock:
    """UTC of the log: the second of the day, midnights since the start, and the date as far as known."""

    second: float = _NAN
    midnights: int = 0
    day_zero: float = _NAN
    """Days since 1970 of midnight count 0, by the latest date sentence."""
    steps_back: int = 0
    date_jumps: int = 0
    """Changes of the date that no midnight explains."""
    file: int = 0
    begins: bool = False
    """No time sentence of this file was met, though there were others before it."""
    files_back: list[int] = field(default_factory=list)
    """Files that begin before the end of the one before."""

    def next_file(self) -> None:
        """Go on to the next file: its first time may lie before the end of the one before."""
        self.file += 1
        self.begins = True

    def to(self, second: float) -> None:
        """Go on to the time of a sentence."""
        step = second - self.second
        if step < -_HALF_DAY_S:
            self.midnights += 1
        elif (
            step > _HALF_DAY_S
            and self.midnights
            and (self.begins or (self.second < 60 and second > DAY_S - 60))
        ):
            self.midnights -= 1  # a sentence of before midnight that came late, or a file that overlaps
            if self.begins:
                self.files_back.append(self.file)
        elif step < 0 and self.begins:
            self.files_back.append(self.file)
        elif step < 0:
            self.steps_back += 1
        self.second = second
        self.begins = False


@dataclass(slots=True)
class _Rows:
    clock: _Clock = field(default_factory=_Clock)
    fixes: list[Fix] = field(default_factory=list)
    sigmas: list[tuple[float, ...]] = field(default_factory=list)
    depths: list[tuple[float, float, float, float, float, float, str, int, int]] = field(default_factory=list)
    headings: list[tuple[float, float, float, float, int, int]] = field(default_factory=list)
    temperatures: list[tuple[float, float, float, float, int, int]] = field(default_factory=list)
    tilts: list[tuple[float, float, float, float, float, int, int]] = field(default_factory=list)
    host: list[tuple[float, float, float, float]] = field(default_factory=list)
    """Second, midnights and day zero of time sentences that stand behind a stamp of the logger, and it."""
    decimals: int = 0
    """Most decimals of a time of day."""


def read_nmea(files: Sequence[Path], date: dt.date | None = None) -> NmeaLog:
    """Read one or several NMEA logs.

    Parameters
    ----------
    files : in the order of time; what two of them hold at the same GPS time is kept once.
    date : UTC date of the first sentence, for logs that carry none; where a log states its date, that
        one is used.

    Returns
    -------
    Positions of GGA, RMC and GLL: of sentences with the same time the one that says most (GGA, then RMC,
    then GLL). Standard deviations come from GST of the same time.

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
        if index:
            rows.clock.next_file()
        for sentence in scan_sentences(path, _WANTED, report):
            try:
                _take(sentence, rows, report)
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


def _take(sentence: Sentence, rows: _Rows, report: IntegrityReport) -> None:
    kind, f = sentence.kind, sentence.fields
    clock = rows.clock
    if kind in _TIME_FIELD:
        text = f[_TIME_FIELD[kind]] if len(f) > _TIME_FIELD[kind] else ""
        second = second_of_day(text) if text.strip() else _NAN
        day = _date(kind, f)
        fix = _fix(kind, f)  # before the clock moves: a malformed sentence must not set the time
        if second == second:
            clock.to(second)
            if day is not None:
                _set_date(day, rows)
            rows.decimals = max(rows.decimals, len(text.partition(".")[2].strip()))
            if sentence.t_host_s == sentence.t_host_s:
                rows.host.append((second, float(clock.midnights), clock.day_zero, sentence.t_host_s))
        if kind == "GST":
            values = [number(f, i) for i in range(3, 9)]
            rows.sigmas.append((second, float(clock.midnights), *values))
        elif fix is not None:
            fix.second, fix.midnights, fix.day_zero = second, clock.midnights, clock.day_zero
            fix.file = clock.file
            rows.fixes.append(fix)
        elif kind != "ZDA":
            report.count("sentences_without_position")
    elif kind == "HDT":
        heading = number(f, 1)
        if heading == heading:
            if not 0 <= heading <= 360:
                raise ValueError(heading)
            rows.headings.append((*_now(clock), heading, sentence.line, clock.file))
    elif kind == "MTW":
        temperature = water_temperature_c(f)
        if temperature == temperature:
            rows.temperatures.append((*_now(clock), temperature, sentence.line, clock.file))
    elif kind == "XDR":
        pitch, roll = pitch_and_roll_deg(f)
        if pitch == pitch or roll == roll:
            rows.tilts.append((*_now(clock), pitch, roll, sentence.line, clock.file))
    else:
        depth = number(f, 1) if kind == "DPT" else below_depth(f)
        if depth != depth:
            report.count("empty_depths")
            return
        offset = number(f, 2) if kind == "DPT" else _NAN
        if depth < 0:
            raise ValueError(depth)
        rows.depths.append((*_now(clock), sentence.t_host_s, depth, offset, kind, sentence.line, clock.file))


def _now(clock: _Clock) -> tuple[float, float, float]:
    """Second of the day, midnights and day of midnight 0 for a sentence without a time of its own.

    What stands ahead of a file's first time sentence has none: the last time of the file before may be older
    by hours, or newer where the files overlap.
    """
    second = _NAN if clock.begins else clock.second
    return second, float(clock.midnights), clock.day_zero


def _date(kind: str, f: list[str]) -> int | None:
    if kind == "RMC" and len(f) > 9 and f[9].strip():
        if len(f[9]) != 6:
            raise ValueError(f[9])
        return days_of_date(int(f[9][:2]), int(f[9][2:4]), int(f[9][4:]))
    if kind == "ZDA" and len(f) > 4 and all(x.strip() for x in f[2:5]):
        return days_of_date(int(f[2]), int(f[3]), int(f[4]))
    return None


def _set_date(day: int, rows: _Rows) -> None:
    """Take the date of a sentence; sentences of the same second that came before it belong to it too."""
    clock = rows.clock
    day_zero = float(day - clock.midnights)
    if day_zero == clock.day_zero:
        return
    if clock.day_zero == clock.day_zero and not clock.begins:
        clock.date_jumps += 1
    clock.day_zero = day_zero
    for fix in reversed(rows.fixes):
        if (fix.second, fix.midnights) != (clock.second, clock.midnights):
            break
        fix.day_zero = day_zero


def _fix(kind: str, f: list[str]) -> Fix | None:
    at = {"GGA": 2, "RMC": 3, "GLL": 1}.get(kind)
    if at is None or len(f) < at + 4 or not (f[at].strip() and f[at + 2].strip()):
        return None
    fix = Fix(kind=kind, lat_deg=degrees(f[at], f[at + 1]), lon_deg=degrees(f[at + 2], f[at + 3]))
    if kind == "GGA":
        fix.fix = FIX_OF_QUALITY.get(f[6] if len(f) > 6 else "", "none")
        satellites = number(f, 7)
        fix.n_sats = int(satellites) if satellites == satellites else -1
        fix.h_ell_m = number(f, 9) + number(f, 11)
        fix.age_s = number(f, 13)
    else:
        status, mode = (f[2], f[12:13]) if kind == "RMC" else ("".join(f[6:7]), f[7:8])
        # NMEA 2.0 GLL ends before the status
        fix.fix = FIX_OF_MODE.get("".join(mode), "none") if status in ("A", "D", "") else "none"
    return fix


def _log(rows: _Rows, date: dt.date | None, report: IntegrityReport) -> NmeaLog:
    given = _NAN if date is None else float(days_of_date(date.day, date.month, date.year))
    dated = [x for x in [fix.day_zero for fix in rows.fixes] + [d[2] for d in rows.depths] if x == x]
    first = dated[0] if dated else rows.clock.day_zero
    if first == first:
        if given == given and given != first:
            report.note(f"The log states its own date; the given date {date} is not used.")
    else:
        first = given

    def seconds(second: ArrayF, midnights: ArrayF, day_zero: ArrayF) -> ArrayF:
        """GPS time of seconds of the day; second 60 of a leap second is one after second 59."""
        day = np.where(np.isfinite(day_zero), day_zero, first) + midnights
        leap = (second >= DAY_S).astype(np.float64)
        whole = np.floor(second - leap)
        return gps_from_unix(day * DAY_S + whole) + (second - leap - whole) + leap

    positions, position_file = position_table(rows.fixes, rows.sigmas, seconds, report)
    depth = pd.DataFrame(rows.depths, columns=[*_DEPTH_FLOATS, "sentence", "line", "file"]).astype(
        dict.fromkeys(_DEPTH_FLOATS, np.float64)
    )
    heading = _undated(rows.headings, "heading_deg")
    temperature = _undated(rows.temperatures, "temperature_c")
    tilt = _undated(rows.tilts, "pitch_deg", "roll_deg")
    for table in (depth, heading, temperature, tilt):
        table["t_gps_s"] = seconds(*(table[n].to_numpy() for n in ("t_day_s", "midnights", "day_zero")))
    overlapping: set[int] = set()
    positions = _once(positions, position_file, "positions", overlapping, report)
    depth = _once(depth, depth["file"].to_numpy(), "depths", overlapping, report)
    heading = _once(heading, heading["file"].to_numpy(), "headings", overlapping, report)
    temperature = _once(temperature, temperature["file"].to_numpy(), "temperatures", overlapping, report)
    tilt = _once(tilt, tilt["file"].to_numpy(), "tilts", overlapping, report)
    back = rows.clock.steps_back + len(set(rows.clock.files_back) - overlapping)
    if back:
        report.lose("time_steps_back", back)
    if rows.clock.date_jumps:
        report.lose("date_jumps", rows.clock.date_jumps)
        report.note(
            f"The date jumps {rows.clock.date_jumps} times without a midnight: two logs in one file, or a "
            "receiver whose week counter rolled over (1024 weeks)."
        )
    depths = depth[list(DEPTH.names)].astype({"line": np.int64, "sentence": object})
    headings = heading[["t_gps_s", "t_day_s", "heading_deg", "line"]]
    host = np.array(rows.host, dtype=np.float64).reshape(-1, 4)
    report.timing.describe_host(seconds(*host[:, :3].T), host[:, 3])
    _summarise(report, positions, depths, len(headings), rows, have_date=first == first)
    _summarise_instrument(report, depths, temperature, tilt)
    return NmeaLog(
        positions=positions,
        depths=depths,
        headings=headings,
        temperatures=temperature[["t_gps_s", "t_day_s", "temperature_c", "line"]],
        tilts=tilt[["t_gps_s", "t_day_s", "pitch_deg", "roll_deg", "line"]],
        report=report,
    )


def _undated(rows: Sequence[tuple[float, ...]], *values: str) -> pd.DataFrame:
    """Rows of sentences without a time of their own, with ``values`` between their time and their line."""
    columns = ["t_day_s", "midnights", "day_zero", *values, "line", "file"]
    table = pd.DataFrame(rows, columns=columns, dtype=np.float64)
    return table.astype({"line": np.int64, "file": np.int64})


def _once(
    table: pd.DataFrame, file: ArrayI, what: str, overlapping: set[int], report: IntegrityReport
) -> pd.DataFrame:
    """The table without what an earlier file holds at the same time; such files go into ``overlapping``.

    Rows without GPS time are all kept: a second of an unknown day is no time stamp.
    """
    content = table.drop(columns=["line", "file", "midnights", "day_zero"], errors="ignore")
    repeated = repeated_rows(content, file) & np.isfinite(table["t_gps_s"].to_numpy())
    overlapping.update(np.unique(file[repeated]).tolist())
    say_repeated(report, what, int(repeated.sum()))
    return table[~repeated].reset_index(drop=True)


def _summarise(
    report: IntegrityReport,
    positions: pd.DataFrame,
    depths: pd.DataFrame,
    n_headings: int,
    rows: _Rows,
    *,
    have_date: bool,
) -> None:
    n_depths = int(np.count_nonzero(depths["depth_m"] > 0))
    for what, n in (("positions", len(positions)), ("depths", n_depths), ("headings", n_headings)):
        report.count(what, n)
    t = np.concatenate([positions["t_gps_s"], depths["t_gps_s"]])
    t = t[np.isfinite(t)]
    report.synchronised = bool(t.size)
    has_time = rows.clock.second == rows.clock.second
    report.time_scale = "utc" if has_time else "none"
    if t.size:
        report.t_first_s, report.t_last_s = float(t.min()), float(t.max())
    elif has_time:
        days = [(x.midnights * DAY_S + x.second) for x in rows.fixes] + [
            x[1] * DAY_S + x[0] for x in rows.depths
        ]
        known = [x for x in days if x == x]
        if known:
            report.t_first_s, report.t_last_s = min(known), max(known)
        if not have_date:
            report.note(
                "The log has times but no date: nothing is synchronised. Give the UTC date of its start "
                "(logs.depth_date)."
            )
    else:
        report.note("The log has no time sentence: nothing is synchronised.")
    regular = positions["t_gps_s"].dropna().drop_duplicates().to_numpy()
    report.gaps = find_gaps(regular)
    report.timing.describe_stamps(regular, 10.0**-rows.decimals if has_time else None)
    if len(regular) > 2 and np.any(np.diff(regular) > 0):
        report.rates_hz["positions"] = 1.0 / float(np.median(np.diff(regular)[np.diff(regular) > 0]))
    offsets = sorted(depths["offset_m"].dropna().unique())
    if offsets:
        report.details["DPT offsets"] = ", ".join(f"{x:g} m" for x in offsets)
    if (depths["sentence"] == "DBS").any():
        report.note("DBS depths are below the water line, all others below the transducer.")
    if depths["t_host_s"].notna().any():
        report.note("Stamps of the logger stand beside the depths (t_host_s); they are taken as UTC.")


def _summarise_instrument(
    report: IntegrityReport, depths: pd.DataFrame, temperatures: pd.DataFrame, tilts: pd.DataFrame
) -> None:
    """Pings without bottom, and the medians of what the echo sounder says about the water and itself."""
    silent = int(np.count_nonzero(depths["depth_m"] == 0))
    if silent:
        report.count("no_bottom", silent)
        report.note(f"{silent:,} depths are 0: the instrument saw no bottom; they are no depths.")
    for name, values in (
        ("water_temperature_c", temperatures["temperature_c"]),
        ("pitch_deg", tilts["pitch_deg"]),
        ("roll_deg", tilts["roll_deg"]),
    ):
        if values.notna().any():
            report.details[name] = round(float(values.median()), 3)
