"""Walk through the records of a RINEX file: which are whole, which are damaged or cut.

The walkers know the structure of epochs and ephemerides, no observation values. Columns follow the documents
named in `thalweg.ingest.ppk.rinex`.
"""

import datetime as dt
import re
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from thalweg.core.timescales import ADJUSTED_OFFSET_S, DAY_S, GPS_EPOCH_UNIX_S, gps_from_unix
from thalweg.core.types import ArrayF, ArrayI

_GPS_EPOCH_DAY: Final = dt.date(1980, 1, 6).toordinal()
_BDT_TO_GPS_S: Final = 14.0  # BeiDou time started without leap seconds on 2006-01-01, when GPS - UTC was 14
_NAV_LINES: Final = {"R": 3, "S": 3}  # lines behind the head of a navigation record; all others at least 7
_SATELLITE: Final = re.compile(r"[GREJCIS][ \d]\d[ \d.+-]*\Z")
_EPOCH_2: Final = re.compile(r"( [ \d]\d( [ \d]\d){4}[ \d]{3}\.[ \d]{7}  \d| {28}[2-6])[ \d]{2}\d")
_EPOCH_3: Final = re.compile(r"> (\d{4}( [ \d]\d){4}[ \d]{3}\.\d{7}  [01]|[ \d.]{27}  [2-6])[ \d]{2}\d")
_DATE_3: Final = ((2, 6), (7, 9), (10, 12), (13, 15), (16, 18))
_DATE_2: Final = ((1, 3), (4, 6), (7, 9), (10, 12), (13, 15))
_NAV_2: Final = re.compile(r"([ \d]\d)( [ \d]\d){6}\.\d")
_NAV_3: Final = re.compile(r"([GREJCIS])[ \d]\d \d{4}( [ \d]\d){5}")


@dataclass(slots=True)
class RecordWalk:
    """Collected while walking through the body."""

    days: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    letters: list[str] = field(default_factory=list)
    n_sat: int = 0
    seen: set[str] = field(default_factory=set)
    whole: list[tuple[int, int]] = field(default_factory=list)
    losses: dict[str, int] = field(default_factory=dict)

    def lose(self, what: str, n: int = 1) -> None:
        """Count a loss."""
        self.losses[what] = self.losses.get(what, 0) + n


def _day_second(
    year: int, month: int, day: int, hour: int, minute: int, second: float
) -> tuple[float, float]:
    """Days since the GPS epoch and seconds of the day; raises ValueError where it is no date."""
    if not (0 <= hour < 24 and 0 <= minute < 60 and 0 <= second < 61):
        raise ValueError("no time of day")
    days = dt.date(year, month, day).toordinal() - _GPS_EPOCH_DAY
    if days < 0:
        raise ValueError("before GPS time began")
    return days, hour * 3600.0 + minute * 60.0 + second


def _year(two_digits: int) -> int:
    return two_digits + (1900 if two_digits >= 80 else 2000)  # RINEX 2.11, section 6.5


def gps_times(found: RecordWalk, scale: str) -> ArrayF:
    """Adjusted standard GPS time of what was found; ``scale`` is "" for navigation: it goes by system."""
    days, seconds = np.array(found.days), np.array(found.seconds)
    t = days * DAY_S - ADJUSTED_OFFSET_S + seconds
    letters = np.array(found.letters, dtype="U1")
    utc = letters == "R" if not scale else np.full(t.shape, scale in {"GLO", "UTC"})
    bdt = letters == "C" if not scale else np.full(t.shape, scale == "BDT")
    if t.size == 0:
        return np.zeros(0)
    t = np.where(bdt, t + _BDT_TO_GPS_S, t)
    if np.any(utc):
        unix = days[utc] * DAY_S + GPS_EPOCH_UNIX_S + seconds[utc]
        t[utc] = gps_from_unix(unix)
    return np.asarray(t, dtype=np.float64)


def walk_observation_3(lines: list[str], body: int, offsets: ArrayI, found: RecordWalk) -> None:
    """Epochs of RINEX 3 and 4: ``>``, date, flag, number, then one line a satellite."""
    i, n = body, len(lines)
    while i < n:
        line = lines[i]
        start = i
        i += 1
        if not line.startswith(">"):
            found.lose("lines_unplaced")
            continue
        if not _EPOCH_3.match(line):
            found.lose("epochs_garbled")
            while i < n and not lines[i].startswith(">"):
                i += 1
            continue
        try:
            flag, count = int(line[31]), int(line[32:35])
            moment = None
            if flag <= 1:  # an event may leave its time blank
                year, month, day, hour, minute = (int(line[a:b]) for a, b in _DATE_3)
                moment = _day_second(year, month, day, hour, minute, float(line[18:29]))
        except (ValueError, IndexError):
            found.lose("epochs_garbled")
            while i < n and not lines[i].startswith(">"):
                i += 1
            continue
        records: list[str] = []
        while len(records) < count and i < n and not lines[i].startswith(">"):
            records.append(lines[i])
            i += 1
        if len(records) < count or (moment and records and _cut_in_value(records[-1], 3)):
            found.lose("epochs_cut")
            continue
        if moment is None:
            found.whole.append((int(offsets[start]), int(offsets[i])))
            continue
        if not all(_SATELLITE.match(record.rstrip("\r\n")) for record in records):
            found.lose("epochs_garbled")
            continue
        _keep_epoch(found, moment, [record[0] for record in records], offsets, start, i)


def walk_observation_2(
    lines: list[str], body: int, offsets: ArrayI, letter: str, n_codes: int, found: RecordWalk
) -> None:
    """Epochs of RINEX 2: a satellite list of 12 a line, then ceil(codes / 5) lines a satellite."""
    i, n = body, len(lines)
    per_satellite = max(1, -(-n_codes // 5))
    default = "G" if letter == "M" else letter
    while i < n:
        line = lines[i].rstrip("\r\n")
        start = i
        i += 1
        if not _EPOCH_2.match(line):
            found.lose("lines_unplaced")
            continue
        flag, moment, listing, end = 0, None, 1, n + 1
        try:
            flag, count = int(line[28]), int(line[29:32])
            listing = max(1, -(-count // 12)) if flag in (0, 1, 6) else 1
            end = start + listing + (count * per_satellite if flag in (0, 1, 6) else count)
            if flag <= 1:
                year, month, day, hour, minute = (int(line[a:b]) for a, b in _DATE_2)
                moment = _day_second(_year(year), month, day, hour, minute, float(line[15:26]))
        except ValueError:
            count = -1
        whole = end <= n and not any(_EPOCH_2.match(other) for other in lines[i:end])
        if not whole or count < 0 or (end == n and _cut_in_value(lines[-1], 0)):
            found.lose("epochs_garbled" if count < 0 else "epochs_cut")
            while i < n and not _EPOCH_2.match(lines[i]):
                i += 1
            continue
        names = "".join(lines[k].rstrip("\r\n").ljust(68)[32:68] for k in range(start, start + listing))
        i = end
        if moment is None:
            found.whole.append((int(offsets[start]), int(offsets[end])))
            continue
        satellites = [names[3 * k : 3 * k + 3] for k in range(count)]
        values = "".join(lines[start + listing : end])
        if not all(re.fullmatch(r"[GRES ][ \d]\d", name) for name in satellites) or not re.fullmatch(
            r"[ \d.+\-\r\n]*", values
        ):
            found.lose("epochs_garbled")
            continue
        letters = [default if name[0] == " " else name[0] for name in satellites]
        _keep_epoch(found, moment, letters, offsets, start, end)


def _cut_in_value(line: str, shift: int) -> bool:
    """True if a last line without line feed ends inside an F14.3 value (14 columns and two flags a value)."""
    length = len(line.rstrip("\r")) - shift
    return not line.endswith("\n") and (length < 14 or 0 < length % 16 < 14)


def _keep_epoch(
    found: RecordWalk, moment: tuple[float, float], letters: list[str], offsets: ArrayI, start: int, end: int
) -> None:
    found.days.append(moment[0])
    found.seconds.append(moment[1])
    found.n_sat += len(letters)
    found.seen |= set(letters)
    found.whole.append((int(offsets[start]), int(offsets[end])))


def walk_navigation(
    lines: list[str], body: int, offsets: ArrayI, major: int, letter: str, found: RecordWalk
) -> None:
    """Ephemerides: a head line with satellite and reference time, then lines that begin with blanks."""
    head = _NAV_2 if major < 3 else _NAV_3
    i, n = body, len(lines)
    while i < n:
        line = lines[i]
        start = i
        i += 1
        match = head.match(line)
        if not match:
            if line.startswith(">") and not line.startswith("> EPH"):
                while i < n and not lines[i].startswith(">"):  # RINEX 4: STO, EOP, ION
                    i += 1
                found.whole.append((int(offsets[start]), int(offsets[i])))
            elif not line.startswith("> EPH"):
                found.lose("lines_unplaced")
            continue
        while i < n and lines[i].startswith("   "):
            i += 1
        system = letter if major < 3 else match.group(1)
        shift = 2 if major < 3 else 3
        words = line[shift:].ljust(20)
        try:
            numbers = [int(float(w)) for w in words[:20].split()[:6]]
            year = _year(numbers[0]) if major < 3 else numbers[0]
            day, second = _day_second(year, numbers[1], numbers[2], numbers[3], numbers[4], numbers[5])
        except (ValueError, IndexError):
            found.lose("ephemerides_garbled")
            continue
        needed = _NAV_LINES.get(system, 7)
        if i - start - 1 < needed or (i == n and not lines[-1].endswith("\n") and i - start - 1 == needed):
            found.lose("ephemerides_cut")
            continue
        begin = start - 1 if major >= 4 and lines[start - 1].startswith("> EPH") else start
        found.days.append(day)
        found.seconds.append(second)
        found.letters.append(system)
        found.whole.append((int(offsets[begin]), int(offsets[i])))
