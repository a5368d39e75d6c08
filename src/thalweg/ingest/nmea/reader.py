"""NMEA 0183 logs: positions, depths and headings with the UTC time that the sentences carry.

Time. GGA, RMC, GLL, GST and ZDA carry the second of the UTC day, RMC and ZDA the date too. A depth has no
time of its own: it gets the time of the latest time sentence before it (``t_day_s``), so it may be late
by up to the interval of these sentences plus the latency of the instrument. No time is interpolated
here; that is the task of ``timing``. Without any date, and if the caller knows none, nothing is
synchronised: ``t_gps_s`` stays NaN.

Heights are ellipsoidal: GGA field 9 (above the geoid) plus field 11 (geoid above ellipsoid).
The offset of DPT is handed on and never added.
"""

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core.errors import InputError
from thalweg.core.timescales import DAY_S, gps_from_unix
from thalweg.core.types import ArrayF, ArrayI
from thalweg.ingest.integrity import IntegrityReport, find_gaps
from thalweg.ingest.nmea.positions import Fix, position_table
from thalweg.ingest.nmea.scan import Sentence, scan_sentences
from thalweg.ingest.schemas import DEPTH
from thalweg.ingest.stamps import possible_unix
from thalweg.ingest.tracks.overlap import repeated_rows, say_repeated

# ---------------------------------------------------------------- values out of NMEA fields: times, dates,
# coordinates, qualities, depths


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


# ---------------------------------------------------------------- reader


_TIME_FIELD: Final = {"GGA": 1, "RMC": 1, "GLL": 5, "GST": 1, "ZDA": 1}
_WANTED: Final = frozenset(k.encode() for k in (*_TIME_FIELD, "HDT", "DBT", "DPT", "DBS"))
_HALF_DAY_S: Final = 43_200
_NAN: Final = float("nan")
_DEPTH_FLOATS: Final = ("t_day_s", "midnights", "day_zero", "t_host_s", "depth_m", "offset_m")


@dataclass(slots=True, kw_only=True)
class NmeaLog:
    """A log: positions (``gnss_position``), depths (``depth``), headings, and the report.

    ``headings`` has ``t_gps_s`` and ``t_day_s`` (as of a depth), ``heading_deg`` (clockwise from true
    north, HDT) and ``line``.
    """

    positions: pd.DataFrame
    depths: pd.DataFrame
    headings: pd.DataFrame
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
    else:
        depth = number(f, 1) if kind == "DPT" else below_depth(f)
        if depth != depth:
            report.count("empty_depths")
            return
        offset = number(f, 2) if kind == "DPT" else _NAN
        if depth < 0:
            raise ValueError(depth)
        rows.depths.append(
            (
                *_now(clock),
                sentence.t_host_s,
                depth,
                offset,
                kind,
                sentence.line,
                clock.file,
            )
        )


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
    depth = pd.DataFrame(
        rows.depths,
        columns=[*_DEPTH_FLOATS, "sentence", "line", "file"],
    ).astype(dict.fromkeys(_DEPTH_FLOATS, np.float64))
    heading = pd.DataFrame(
        rows.headings,
        columns=["t_day_s", "midnights", "day_zero", "heading_deg", "line", "file"],
        dtype=np.float64,
    ).astype({"line": np.int64, "file": np.int64})
    for table in (depth, heading):
        table["t_gps_s"] = seconds(*(table[n].to_numpy() for n in ("t_day_s", "midnights", "day_zero")))
    overlapping: set[int] = set()
    positions = _once(positions, position_file, "positions", overlapping, report)
    depth = _once(depth, depth["file"].to_numpy(), "depths", overlapping, report)
    heading = _once(heading, heading["file"].to_numpy(), "headings", overlapping, report)
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
    return NmeaLog(positions=positions, depths=depths, headings=headings, report=report)


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
    for what, n in (("positions", len(positions)), ("depths", len(depths)), ("headings", n_headings)):
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
                "The log has times but no date: nothing is synchronised. Give the UTC date of its start."
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
