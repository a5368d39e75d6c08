"""Light scanner of RINEX 2, 3 and 4 observation and navigation files: what is inside, what is damaged.

It reads headers and epoch records only, no observation values. Columns follow the IGS documents "RINEX:
The Receiver Independent Exchange Format", versions 2.11, 3.05 and 4.01 (tables A1 to A9).
"""

import datetime as dt
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal

import numpy as np

from thalweg.core import (
    ADJUSTED_OFFSET_S,
    DAY_S,
    GPS_EPOCH_UNIX_S,
    ArrayF,
    ArrayI,
    InputError,
    UnsupportedError,
    gps_from_unix,
    require_file,
    utc_text_from_gps,
)
from thalweg.ingest import IntegrityReport

# ---------------------------------------------------------------- walk through the records of a RINEX file:
# which are whole, which are damaged or cut
#
# The walkers know the structure of epochs and ephemerides, no observation values. Columns follow the
# documents named above.


_GPS_EPOCH_DAY: Final = dt.date(1980, 1, 6).toordinal()
_BDT_TO_GPS_S: Final = 14.0  # BeiDou time started without leap seconds on 2006-01-01, when GPS - UTC was 14
_NAV_LINES: Final = {"R": 3, "S": 3}  # lines behind the head of a navigation record; all others at least 7
_SATELLITE: Final = re.compile(r"[A-Z ][ \d]\d[ \d.+-]*\Z")
_REGULAR_2: Final = re.compile(r"( [ \d]\d( [ \d]\d){4}[ \d]{3}\.[ \d]{7}  \d| {28}[2-6])[ \d]{2}\d")
_REGULAR_3: Final = re.compile(r"> (\d{4}( [ \d]\d){4}[ \d]{3}\.\d{7}  [01]|[ \d.]{27}  [2-6])[ \d]{2}\d")
_DATE: Final = r"(\d{4}|\d\d?)\s+(\d\d?)\s+(\d\d?)\s+(\d\d?)\s+(\d\d?)\s+(\d\d?(?:[.,]\d*)?)"
_THREE: Final = r"(?:  \d| \d\d|\d{3})"
"""A number right-aligned in three columns."""
_FLAG_NUMBER: Final = rf"\s+([0-6 ])({_THREE}|\s+\d{{1,3}})(?!\d)"
"""Flag (none is 0) and number of records, in their columns or apart by any blanks."""
_EPOCH_2: Final = re.compile(rf"\s*{_DATE}{_FLAG_NUMBER}|\s{{26,29}}([2-6])({_THREE})\s*\Z")
_EPOCH_3: Final = re.compile(rf">\s*{_DATE}{_FLAG_NUMBER}|>\s+([2-6])({_THREE}|\s+\d{{1,3}})\s*\Z")
_NAV_2: Final = re.compile(r"([ \d]\d)( [ \d]\d){6}\.\d")
_NAV_3: Final = re.compile(r"([GREJCIS])[ \d]\d \d{4}( [ \d]\d){5}")


SYSTEM_OF_LETTER: Final = {"G": "GPS", "R": "GLO", "E": "GAL", "J": "QZS", "C": "BDS", "I": "IRN", "S": "SBS"}
"""Satellite systems by their RINEX letter."""


@dataclass(slots=True, kw_only=True)
class RinexScan:
    """What a RINEX file holds.

    Attributes
    ----------
    header : lines by their label.
    codes : observation codes by the letter of the system, as the header states them.
    time_system : of the epochs; empty in navigation files, where it goes by system.
    t_gps_s : (n,) epochs, or reference times of ephemerides.
    letters : system of each ephemeris; seen : systems of the observations.
    n_satellite_records : lines of satellites.
    whole : byte ranges of the header and of each undamaged record.
    losses, first_loss : what is damaged or missing, and number and begin of the first such line.
    events : records that are no observations, by their flag.
    regular : first byte -> end of an epoch line that does not keep to the columns, and how it should read.
    """

    path: Path
    version: str
    kind: Literal["observation", "navigation"]
    offsets: ArrayI
    header: dict[str, list[str]]
    codes: dict[str, list[str]]
    time_system: str
    bytes_read: int
    days: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    letters: list[str] = field(default_factory=list)
    seen: set[str] = field(default_factory=set)
    n_satellite_records: int = 0
    whole: list[tuple[int, int]] = field(default_factory=list)
    losses: Counter[str] = field(default_factory=Counter)
    first_loss: str = ""
    events: Counter[int] = field(default_factory=Counter)
    regular: dict[int, tuple[int, str]] = field(default_factory=dict)

    def keep(self, start: int, end: int) -> None:
        """Lines ``start`` to ``end`` (exclusive) are a whole record."""
        self.whole.append((int(self.offsets[start]), int(self.offsets[end])))

    def put_right(self, start: int, end: int, text: str) -> None:
        """Lines ``start`` to ``end`` (exclusive), odd in form, should read ``text``."""
        self.regular[int(self.offsets[start])] = int(self.offsets[end]), text

    def lose(self, what: str, number: int, line: str) -> None:
        """Count a loss that begins with line ``number`` (from 0)."""
        self.losses[what] += 1
        self.first_loss = self.first_loss or f"line {number + 1}, {line.rstrip()[:60]!r}"

    def text(self, label: str, start: int = 0, stop: int = 60) -> str:
        """Columns ``start:stop`` of the first header line with this label, stripped; "" if absent."""
        return self.header.get(label, [""])[0][start:stop].strip()

    def _three(self, label: str) -> ArrayF | None:
        """Three numbers of a header line, None without them."""
        try:
            values = np.array(self.text(label).split()[:3], dtype=np.float64)
        except ValueError:
            return None
        return values if values.size == 3 and np.isfinite(values).all() else None

    @property
    def approx_ecef_m(self) -> ArrayF | None:
        """Approximate position (3,), None without one."""
        return self._three("APPROX POSITION XYZ")

    @property
    def antenna_delta_hen_m(self) -> tuple[float, float, float]:
        """Height, east and north of the antenna's reference point above the marker."""
        hen = self._three("ANTENNA: DELTA H/E/N")
        return (0.0, 0.0, 0.0) if hen is None else (float(hen[0]), float(hen[1]), float(hen[2]))

    @property
    def systems(self) -> tuple[str, ...]:
        """Names of the systems that it holds."""
        return tuple(name for key, name in SYSTEM_OF_LETTER.items() if key in self.seen.union(self.letters))

    @property
    def t_gps_s(self) -> ArrayF:
        """Adjusted standard GPS time of the epochs, or of the reference times of the ephemerides."""
        days, seconds = np.array(self.days, np.float64), np.array(self.seconds, np.float64)
        letters = np.array(self.letters, dtype="U1")
        navigation = self.kind == "navigation"
        utc = letters == "R" if navigation else np.full(days.shape, self.time_system in {"GLO", "UTC"})
        bdt = letters == "C" if navigation else np.full(days.shape, self.time_system in {"BDT", "BDS"})
        t = days * DAY_S - ADJUSTED_OFFSET_S + seconds + bdt * _BDT_TO_GPS_S
        t[utc] = gps_from_unix(days[utc] * DAY_S + GPS_EPOCH_UNIX_S + seconds[utc])
        return t

    @property
    def nav_t_gps_s(self) -> dict[str, ArrayF]:
        """Reference times of the ephemerides by system."""
        t, letters = self.t_gps_s, np.array(self.letters, dtype="U1")
        return {SYSTEM_OF_LETTER[key]: t[letters == key] for key in sorted(set(self.letters))}


@dataclass(frozen=True, slots=True)
class _Epoch:
    """An epoch line: date and time (None where it states none), flag, number of records, and what follows."""

    moment: tuple[int, int, int, int, int, float] | None
    flag: int
    count: int
    tail: str

    def line(self, major: int, names: Sequence[str] = ()) -> str:
        """The line in the columns of the format; in RINEX 2 with its satellites, 12 a line."""
        if self.moment is None:
            date = " " * (27 if major < 3 else 29)
        else:
            year, *rest, second = self.moment
            date = f" {year % 100:02d}" if major < 3 else f" {year}"
            date += "".join(f" {value:02d}" for value in rest) + f"{second:11.7f} "
        rows = ["".join(names[k : k + 12]) for k in range(0, len(names), 12)] or [""]
        listing = ("\n" + " " * 32).join(rows)
        return f"{'>' if major >= 3 else ''}{date} {self.flag}{self.count:3d}{listing}\n"


def _read_epoch(line: str, form: re.Pattern[str]) -> _Epoch | None:
    """The words of an epoch line, whatever blanks lie between them: RTKLIB reads dates so, too."""
    match = form.match(line)
    if match is None:
        return None
    year, month, day, hour, minute, second, flag, count, event, event_count = match.groups()
    tail = line[match.end() :].rstrip()
    if event is not None:
        return _Epoch(None, int(event), int(event_count), tail)
    moment = (
        int(year) if len(year) == 4 else _year(int(year)),
        int(month),
        int(day),
        int(hour),
        int(minute),
        float(second.replace(",", ".")),
    )
    return _Epoch(moment, int(flag.strip() or 0), int(count), tail)


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


def walk_observation_3(lines: list[str], body: int, found: RinexScan) -> None:
    """Epochs of RINEX 3 and 4: ``>``, date, flag, number, then one line a satellite."""
    i, n, codes = body, len(lines), found.codes

    def satellites(records: list[str]) -> bool:
        """Whether each line holds a satellite and numbers, as far as the header tells of columns."""
        widths = {letter: 3 + 16 * len(names) for letter, names in codes.items()}
        return all(_SATELLITE.match(record.rstrip()[: widths.get(record[:1])]) for record in records)

    while i < n:
        line, start = lines[i], i
        i += 1
        if not line.startswith(">"):
            if line.strip():
                found.lose("lines_unplaced", start, line)
            continue
        epoch = _read_epoch(line, _EPOCH_3)
        if epoch is None:
            found.lose("epochs_garbled", start, line)
            while i < n and not lines[i].startswith(">"):
                i += 1
            continue
        records: list[str] = []
        while len(records) < epoch.count and i < n and not lines[i].startswith(">"):
            records.append(lines[i])
            i += 1
        observed = epoch.flag <= 1 or (epoch.flag == 2 and records and satellites(records))
        if len(records) < epoch.count or (observed and records and _cut_in_value(records[-1], 3)):
            found.lose("epochs_cut", start, line)
        elif not observed:
            codes = _event(epoch.flag, records, codes, "", 3, found, start, i)
        elif not satellites(records):
            found.lose("epochs_garbled", start, line)
        else:
            letters = [record[0] for record in records]
            if _keep_epoch(found, epoch, letters, start, i, line) and not _REGULAR_3.match(line):
                found.put_right(start, start + 1, epoch.line(3))


def walk_observation_2(lines: list[str], body: int, letter: str, found: RinexScan) -> None:
    """Epochs of RINEX 2: a satellite list of 12 a line, then ceil(codes / 5) lines a satellite."""
    i, n, codes = body, len(lines), found.codes
    default = "G" if letter == "M" else letter
    while i < n:
        line, start = lines[i], i
        i += 1
        epoch = _read_epoch(line, _EPOCH_2)
        if epoch is None:
            if line.strip():
                found.lose("lines_unplaced", start, line)
            continue
        per_satellite = max(1, -(-len(next(iter(codes.values()), [])) // 5))
        satellites = epoch.flag in (0, 1, 6) or (epoch.flag == 2 and epoch.tail != "")
        listing = max(1, -(-epoch.count // 12)) if satellites else 1
        end = start + listing + (epoch.count * per_satellite if satellites else epoch.count)
        whole = end <= n and not any(_EPOCH_2.match(other) for other in lines[i:end])
        if not whole or (end == n and _cut_in_value(lines[-1], 0)):
            found.lose("epochs_cut", start, line)
            while i < n and not _EPOCH_2.match(lines[i]):
                i += 1
            continue
        i = end
        if not satellites or epoch.flag == 6:
            codes = _event(epoch.flag, lines[start + 1 : end], codes, letter, 2, found, start, end)
            continue
        lists = [epoch.tail, *(more.rstrip()[32:] for more in lines[start + 1 : start + listing])]
        # up to 12 satellites a line; blanks before the first letter are none of it
        parts = [(x.lstrip() if x.lstrip()[:1].isalpha() else x)[:36].rstrip() for x in lists]
        names = [part[k : k + 3] for part in parts for k in range(0, len(part), 3)][: epoch.count]
        values = "".join(row.rstrip()[:80] for row in lines[start + listing : end])
        if (
            len(names) < epoch.count
            or not all(re.fullmatch(r"[A-Z ][ \d]\d", name) for name in names)
            or not re.fullmatch(r"[ \d.+\-]*", values)
        ):
            found.lose("epochs_garbled", start, line)
            continue
        letters = [default if name[0] == " " else name[0] for name in names]
        odd = not _REGULAR_2.match(line) or any(
            lines[start + k][32:68].rstrip() != p for k, p in enumerate(parts)
        )
        if _keep_epoch(found, epoch, letters, start, end, line) and odd:
            found.put_right(start, start + listing, epoch.line(2, names))


def _event(
    flag: int,
    records: list[str],
    codes: dict[str, list[str]],
    letter: str,
    major: int,
    found: RinexScan,
    start: int,
    end: int,
) -> dict[str, list[str]]:
    """Take a record that is no epoch; the observation codes that hold from there on.

    RTKLIB gets what it reads rightly: a new site (3) and header lines (4). It would take repaired cycle slips
    (6) and the lines behind a start of motion (2) for observations, and may drop the epoch behind a mark (5).
    """
    found.events[flag] += 1
    if flag not in (3, 4):
        return codes
    found.keep(start, end)
    header: dict[str, list[str]] = {}
    for record in records:
        header.setdefault(record[60:].strip(), []).append(record[:60])
    return codes | _codes(header, letter, major)


def _cut_in_value(line: str, shift: int) -> bool:
    """True if a last line without line feed ends inside an F14.3 value (14 columns and two flags a value)."""
    length = len(line.rstrip("\r")) - shift
    return not line.endswith("\n") and (length < 14 or 0 < length % 16 < 14)


def _keep_epoch(found: RinexScan, epoch: _Epoch, letters: list[str], start: int, end: int, line: str) -> bool:
    """Take an epoch; False, and a loss, if its date is none."""
    try:
        day, second = _day_second(*(epoch.moment or (0, 0, 0, 0, 0, 0.0)))  # without a date: none that is
    except ValueError:
        found.lose("epochs_garbled", start, line)
        return False
    found.days.append(day)
    found.seconds.append(second)
    found.n_satellite_records += len(letters)
    found.seen |= {"G" if letter == " " else letter for letter in letters}
    found.keep(start, end)
    return True


def walk_navigation(lines: list[str], body: int, major: int, letter: str, found: RinexScan) -> None:
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
                found.keep(start, i)
            elif not line.startswith("> EPH"):
                found.lose("lines_unplaced", start, line)
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
            found.lose("ephemerides_garbled", start, line)
            continue
        needed = _NAV_LINES.get(system, 7)
        if i - start - 1 < needed or (i == n and not lines[-1].endswith("\n") and i - start - 1 == needed):
            found.lose("ephemerides_cut", start, line)
            continue
        begin = start - 1 if major >= 4 and lines[start - 1].startswith("> EPH") else start
        found.days.append(day)
        found.seconds.append(second)
        found.letters.append(system)
        found.keep(begin, i)


# ---------------------------------------------------------------- rinex


_FOREIGN: Final = (
    (b"\x1f\x8b", "gzip", "gunzip"),
    (b"\x1f\x9d", "compress (.Z)", "uncompress"),
    (b"PK\x03\x04", "zip", "unzip"),
    (b"BZh", "bzip2", "bunzip2"),
)


def scan_rinex(path: Path) -> RinexScan:
    """Scan a RINEX observation or navigation file.

    Damaged and cut records are counted in ``losses``; the whole records before and after them are kept.

    Raises
    ------
    InputError : the file is missing, empty, no RINEX, or its header is cut.
    UnsupportedError : it is compressed (gzip, compress, Hatanaka), or neither observation nor navigation.
    """
    require_file(path, "a RINEX file")
    data = path.read_bytes()
    _check_container(path, data)
    text = data.decode("latin-1")
    lines = re.findall(r"[^\n]*\n|[^\n]+\Z", text)  # splitlines would also cut at form feeds and 0x85
    version, kind, letter = _first_line(path, lines[0].rstrip("\r\n"))
    major = int(version[0])
    body = next((k for k, line in enumerate(lines, start=1) if line[60:].strip() == "END OF HEADER"), 0)
    if not body:
        raise InputError(
            f"the header does not end within {len(lines)} lines",
            expected="a line END OF HEADER",
            where=path,
            cure="The file is cut or damaged; copy or export it again",
        )
    header: dict[str, list[str]] = {}
    for line in lines[:body]:
        header.setdefault(line[60:].strip(), []).append(line[:60])
    found = RinexScan(
        path=path,
        version=version,
        kind=kind,
        offsets=np.cumsum([0, *map(len, lines)]),
        header=header,
        codes=_codes(header, letter, major),
        time_system="",
        bytes_read=len(data),
    )
    found.keep(0, body)
    if kind == "navigation":
        walk_navigation(lines, body, major, letter, found)
        return found
    usual = {"R": "GLO", "E": "GAL", "C": "BDT"}.get(letter, "GPS")
    found.time_system = found.text("TIME OF FIRST OBS", 48, 51) or usual
    if major >= 3:
        walk_observation_3(lines, body, found)
    else:
        walk_observation_2(lines, body, letter, found)
    return found


def rinex_kind(path: Path, head: bytes) -> Literal["observation", "navigation"]:
    """Kind of a RINEX file by its first bytes; ``path`` is for messages. Raises as `scan_rinex` does."""
    _check_container(path, head)
    return _first_line(path, head[:120].decode("latin-1").partition("\n")[0].rstrip("\r"))[1]


def describe_rinex(path: Path) -> IntegrityReport:
    """Integrity report of a RINEX observation or navigation file; raises as `scan_rinex` does."""
    scan = scan_rinex(path)
    t, observation = scan.t_gps_s, scan.kind == "observation"
    report = IntegrityReport.of(
        "raw GNSS" if observation else "GNSS ephemerides",
        f"RINEX {scan.version} {scan.kind}",
        [path],
        model=scan.text("REC # / TYPE / VERS", 20, 40),
        time_scale="utc" if scan.time_system == "GLO" else "gps",
        synchronised=t.size > 0,
        bytes_read=scan.bytes_read,
        losses=dict(scan.losses),
    )
    details: dict[str, object] = {
        "systems": ", ".join(scan.systems),
        "program": scan.text("PGM / RUN BY / DATE"),
    }
    if observation:
        report.count("epochs", t.size)
        report.count("satellite records", scan.n_satellite_records)
        report.take_times(t, "epochs")
        details |= {
            "marker": scan.text("MARKER NAME"),
            "antenna": scan.text("ANT # / TYPE", 20, 40),
            "approx_ecef_m": None if scan.approx_ecef_m is None else scan.approx_ecef_m.tolist(),
            "antenna_delta_hen_m": list(scan.antenna_delta_hen_m),
            "time_system": scan.time_system,
            "codes": {SYSTEM_OF_LETTER.get(key, key): " ".join(value) for key, value in scan.codes.items()},
        }
        if np.any(np.diff(t) <= 0):
            report.note("The epochs are not in order of time.")
        if scan.approx_ecef_m is None or not np.any(scan.approx_ecef_m):
            report.note("The header holds no approximate position (it is absent or zero).")
    else:
        report.count("ephemerides", t.size)
        if t.size:
            report.t_first_s, report.t_last_s = float(t.min()), float(t.max())
        for name, times in scan.nav_t_gps_s.items():
            span = f"{utc_text_from_gps(float(times.min()), 0)} .. {utc_text_from_gps(float(times.max()), 0)}"
            details[name] = f"{times.size} ephemerides, reference times {span}"
    report.details = {key: value for key, value in details.items() if value not in ("", None, {})}
    for flag, n in sorted(scan.events.items()):
        report.count(f"{_EVENTS[flag]} (flag {flag})", n)
    if scan.events[3]:
        report.note("The antenna was set up anew within the file (flag 3).")
    if scan.events[6]:
        report.note("Records of repaired cycle slips (flag 6) are no observations and are left out.")
    if scan.regular:
        report.note(
            f"{len(scan.regular)} epoch lines do not keep to the columns of RINEX: read by their words."
        )
    if any(scan.losses.values()):
        report.note(f"Records are damaged or cut: {losses_in_words(scan)}.")
    elif not t.size:
        report.note("The file holds a header only.")
    return report


_EVENTS: Final = {
    2: "starts of motion",
    3: "new sites",
    4: "header records",
    5: "external events",
    6: "repaired cycle slips",
}


def losses_in_words(scan: RinexScan) -> str:
    """What is damaged, how often, and the first line of it."""
    return ", ".join(f"{what} {n}" for what, n in scan.losses.items()) + f" (first: {scan.first_loss})"


def whole_records(scan: RinexScan, data: bytes) -> bytes:
    """Header and undamaged records of a scanned file, epoch lines in their columns, each with a line feed."""
    parts = []
    for a, b in scan.whole:
        part = data[a:b]
        if a in scan.regular:
            end, line = scan.regular[a]
            part = line.encode() + data[end:b]
        parts.append(part if part.endswith(b"\n") else part + b"\n")
    return b"".join(parts)


def _check_container(path: Path, data: bytes) -> None:
    for magic, name, command in _FOREIGN:
        if data.startswith(magic):
            raise UnsupportedError(
                f"a {name} archive",
                expected="plain RINEX",
                where=path,
                cure=f"Unpack it: {command} {path.name}",
            )
    if b"COMPACT RINEX FORMAT" in data[:200] or b"CRINEX VERS" in data[:200]:
        raise UnsupportedError(
            "Hatanaka-compressed RINEX",
            expected="plain RINEX",
            where=path,
            cure=f"Unpack it with RNXCMP: crx2rnx {path.name}",
        )


def _first_line(path: Path, line: str) -> tuple[str, Literal["observation", "navigation"], str]:
    """Version, kind and system letter of the first header line."""
    version = line[:20].strip()
    if line[60:].strip() != "RINEX VERSION / TYPE" or not re.fullmatch(r"\d(\.\d+)?", version):
        raise InputError(
            f"the first line is {line[:40]!r}",
            expected="a RINEX header (label 'RINEX VERSION / TYPE' in columns 61-80)",
            where=f"{path}, line 1",
            cure="Give the observation or navigation file that the receiver software exports as RINEX",
        )
    if version[0] not in "234":
        raise UnsupportedError(f"RINEX version {version}", expected="version 2, 3 or 4", where=path)
    kind, letter = line[20:21].upper(), line[40:41].upper().replace(" ", "G")
    if kind == "O":
        return version, "observation", letter
    if kind == "N":
        return version, "navigation", letter
    if kind in "GH" and version[0] == "2":
        return version, "navigation", {"G": "R", "H": "S"}[kind]
    raise UnsupportedError(
        f"RINEX file type {line[20:40].strip()!r}",
        expected="observation (O) or navigation (N) data",
        where=path,
    )


def _codes(header: dict[str, list[str]], letter: str, major: int) -> dict[str, list[str]]:
    """Observation codes by system letter."""
    if major < 3:
        words = " ".join(line[6:60] for line in header.get("# / TYPES OF OBSERV", [])).split()
        return {letter: words} if words else {}
    codes: dict[str, list[str]] = {}
    system = ""
    for line in header.get("SYS / # / OBS TYPES", []):
        system = line[0] if line[:1].strip() else system
        codes.setdefault(system, []).extend(line[7:60].split())
    return codes
