"""Light scanner of RINEX 2, 3 and 4 observation and navigation files: what is inside, what is damaged.

It reads headers and epoch records only, no observation values. Columns follow the IGS documents "RINEX:
The Receiver Independent Exchange Format", versions 2.11, 3.05 and 4.01 (tables A1 to A9).
"""

import datetime as dt
import re
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
    utc_text_from_gps,
)
from thalweg.ingest import IntegrityReport, find_gaps

# ---------------------------------------------------------------- walk through the records of a RINEX file:
# which are whole, which are damaged or cut
#
# The walkers know the structure of epochs and ephemerides, no observation values. Columns follow the
# documents named above.


_GPS_EPOCH_DAY: Final = dt.date(1980, 1, 6).toordinal()
_BDT_TO_GPS_S: Final = 14.0  # BeiDou time started without leap seconds on 2006-01-01, when GPS - UTC was 14
_NAV_LINES: Final = {"R": 3, "S": 3}  # lines behind the head of a navigation record; all others at least 7
_SATELLITE: Final = re.compile(r"[GREJCIS][ \d]\d[ \d.+-]*\Z")
_DATE: Final = re.compile(r"\s*(\d{1,4})" + r"\s+(\d{1,2})" * 4 + r"\s+(\d{1,2}(?:\.\d*)?)\s*")
_FLAG_2: Final = re.compile(r"  ([0-6 ])([ \d]{2}\d)")
_FLAG_3: Final = re.compile(r"(?:  ([0-6 ])| ([0-6]) )([ \d]{0,3})")
"""Flag and number behind the date; RTKCONV 2.4.3 b29 writes one blank before the flag, others no flag."""
_EVENTS: Final = {
    2: "starts_of_motion", 3: "new_sites", 4: "header_records", 5: "external_events", 6: "cycle_slip_records",
}  # fmt: skip
"""Flags of records that are no epochs."""
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
    events: dict[str, int] = field(default_factory=dict)

    def event(self, flag: int, begin: int, end: int) -> None:
        """Count a record that is no epoch.

        RTKLIB takes marks of events and cycle slips for observations: they stay out of what is whole.
        """
        self.events[_EVENTS[flag]] = self.events.get(_EVENTS[flag], 0) + 1
        if flag <= 4:
            self.whole.append((begin, end))

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


def _moment(text: str) -> tuple[float, float]:
    """Days and seconds of the date of an epoch; raises ValueError where it is none."""
    found = _DATE.fullmatch(text)
    if found is None:
        raise ValueError("no date")
    year, month, day, hour, minute = (int(word) for word in found.groups()[:5])
    return _day_second(_year(year), month, day, hour, minute, float(found[6]))


def _year(year: int) -> int:
    if year >= 100:
        return year
    return year + (1900 if year >= 80 else 2000)  # RINEX 2.11, section 6.5


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
        place = _FLAG_3.match(line, 29)
        flag = int((place[1] or place[2] or "").strip() or 0) if place else -1
        moment = None
        records: list[str] = []
        try:
            count = int(place[3]) if place else -1
        except ValueError:
            count = 0 if flag >= 2 else -1
        try:
            if 0 <= flag <= 2 and count > 0:  # RTKLIB reads observations behind flag 2, which has none
                moment = _moment(line[1:29])
        except ValueError:
            count = count if flag == 2 else -1
        behind = i
        while behind < n and not lines[behind].startswith(">"):
            behind += 1
        if count < 0:
            found.lose("epochs_garbled")
            i = behind
            continue
        if flag == 2 and moment and not all(map(_SATELLITE.match, lines[i : min(i + count, behind)])):
            moment = None
        stop = min(i + count, behind) if count or flag < 2 else behind
        records = lines[i:stop]
        i = stop
        if len(records) < count or (moment and records and _cut_in_value(records[-1], 3)):
            found.lose("epochs_cut")
            continue
        if moment is None:
            if flag >= 2:
                found.event(flag, int(offsets[start]), int(offsets[i]))
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
        if not _opens_epoch_2(line):
            found.lose("lines_unplaced")
            continue
        flag, moment, listing, end = 0, None, 1, n + 1
        try:
            flag, count = int(line[28].strip() or 0), int(line[29:32])
            listing = max(1, -(-count // 12)) if flag in (0, 1, 6) else 1
            end = start + listing + (count * per_satellite if flag in (0, 1, 6) else count)
            if flag <= 1:
                moment = _moment(line[:26])
        except ValueError:
            count = -1
        whole = end <= n and not any(map(_opens_epoch_2, lines[i:end]))
        if not whole or count < 0 or (end == n and _cut_in_value(lines[-1], 0)):
            found.lose("epochs_garbled" if count < 0 else "epochs_cut")
            while i < n and not _opens_epoch_2(lines[i]):
                i += 1
            continue
        names = "".join(lines[k].rstrip("\r\n").ljust(68)[32:68] for k in range(start, start + listing))
        i = end
        if moment is None:
            found.event(flag, int(offsets[start]), int(offsets[end]))
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


def _opens_epoch_2(line: str) -> bool:
    """Whether a line of RINEX 2 begins an epoch or an event, which may leave its date blank."""
    place = _FLAG_2.match(line, 26)
    if place is None:
        return False
    return (place[1] in "23456" and not line[:26].strip()) or _DATE.fullmatch(line[:26]) is not None


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


# ---------------------------------------------------------------- rinex


SYSTEM_OF_LETTER: Final = {"G": "GPS", "R": "GLO", "E": "GAL", "J": "QZS", "C": "BDS", "I": "IRN", "S": "SBS"}
"""Satellite systems by their RINEX letter."""

_FOREIGN: Final = (
    (b"\x1f\x8b", "gzip", "gunzip"),
    (b"\x1f\x9d", "compress (.Z)", "uncompress"),
    (b"PK\x03\x04", "zip", "unzip"),
    (b"BZh", "bzip2", "bunzip2"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class RinexScan:
    """What a RINEX file holds.

    ``t_gps_s`` are the epochs (observation) or reference times of the ephemerides (navigation), shape (n,),
    ``nav_t_gps_s`` the latter by system. ``whole`` are the byte ranges of the header and of each undamaged
    record, ``losses`` counts what is damaged or missing, ``events`` the records that are no epochs by their
    flag.
    """

    path: Path
    version: str
    kind: Literal["observation", "navigation"]
    time_system: str
    header: dict[str, list[str]]
    systems: tuple[str, ...]
    t_gps_s: ArrayF
    approx_ecef_m: ArrayF | None
    antenna_delta_hen_m: tuple[float, float, float]
    interval_s: float | None
    codes: dict[str, list[str]]
    n_satellite_records: int
    nav_t_gps_s: dict[str, ArrayF]
    whole: list[tuple[int, int]]
    losses: dict[str, int]
    events: dict[str, int]
    bytes_read: int

    def text(self, label: str, start: int = 0, stop: int = 60) -> str:
        """Columns ``start:stop`` of the first header line with this label, stripped; "" if absent."""
        lines = self.header.get(label, [""])
        return lines[0][start:stop].strip()


def scan_rinex(path: Path) -> RinexScan:
    """Scan a RINEX observation or navigation file.

    Damaged and cut records are counted in ``losses``; the whole records before and after them are kept.

    Raises
    ------
    InputError : the file is missing, empty, no RINEX, or its header is cut.
    UnsupportedError : it is compressed (gzip, compress, Hatanaka), or neither observation nor navigation.
    """
    if not path.is_file():
        raise InputError("file not found", expected="a RINEX file", where=path)
    data = path.read_bytes()
    _check_container(path, data)
    text = data.decode("latin-1")
    lines = re.findall(r"[^\n]*\n|[^\n]+\Z", text)  # splitlines would also cut at form feeds and 0x85
    version, kind, letter = _first_line(path, lines[0].rstrip("\r\n"))
    header: dict[str, list[str]] = {}
    body = 0
    for number, line in enumerate(lines):
        label = line[60:].strip()
        header.setdefault(label, []).append(line[:60])
        if label == "END OF HEADER":
            body = number + 1
            break
    if not body:
        raise InputError(
            f"the header does not end within {len(lines)} lines",
            expected="a line END OF HEADER",
            where=path,
            cure="The file is cut or damaged; copy or export it again",
        )
    offsets = np.concatenate([[0], np.cumsum([len(line) for line in lines])]).astype(np.int64)
    found = RecordWalk(whole=[(0, int(offsets[body]))])
    codes = _codes(header, letter, int(version[0]))
    if kind == "navigation":
        walk_navigation(lines, body, offsets, int(version[0]), letter, found)
        scale = ""
    else:
        scale = _text(header, "TIME OF FIRST OBS", 48, 51) or {"R": "GLO", "E": "GAL", "C": "BDT"}.get(
            letter, "GPS"
        )
        n_codes = len(next(iter(codes.values()), []))
        if int(version[0]) >= 3:
            walk_observation_3(lines, body, offsets, found)
        else:
            walk_observation_2(lines, body, offsets, letter, n_codes, found)
    t = gps_times(found, scale)
    letters = np.array(found.letters, dtype="U1")
    systems = found.seen | set(found.letters)
    step = np.diff(t)
    interval = _floats(header, "INTERVAL", 1)
    return RinexScan(
        path=path,
        version=version,
        kind=kind,
        time_system=scale or "GPS",
        header=header,
        systems=tuple(name for key, name in SYSTEM_OF_LETTER.items() if key in systems),
        t_gps_s=t,
        approx_ecef_m=_approx(header),
        antenna_delta_hen_m=_delta(header),
        interval_s=interval[0] if interval else float(np.median(step)) if step.size else None,
        codes={SYSTEM_OF_LETTER.get(key, key): value for key, value in codes.items()},
        n_satellite_records=found.n_sat,
        nav_t_gps_s={SYSTEM_OF_LETTER[key]: t[letters == key] for key in sorted(set(found.letters))},
        whole=found.whole,
        losses=found.losses,
        events=found.events,
        bytes_read=len(data),
    )


def rinex_kind(path: Path, head: bytes) -> Literal["observation", "navigation"]:
    """Kind of a RINEX file by its first bytes; ``path`` is for messages. Raises as `scan_rinex` does."""
    _check_container(path, head)
    return _first_line(path, head[:120].decode("latin-1").partition("\n")[0].rstrip("\r"))[1]


def describe_rinex(path: Path) -> IntegrityReport:
    """Integrity report of a RINEX observation or navigation file; raises as `scan_rinex` does."""
    scan = scan_rinex(path)
    observation = scan.kind == "observation"
    report = IntegrityReport(
        stream="raw GNSS" if observation else "GNSS ephemerides",
        format=f"RINEX {scan.version} {scan.kind}",
        files=[str(path)],
        model=scan.text("REC # / TYPE / VERS", 20, 40),
        time_scale="utc" if scan.time_system == "GLO" else "gps",
        synchronised=scan.t_gps_s.size > 0,
        bytes_read=scan.bytes_read,
        losses=dict(scan.losses),
    )
    if scan.t_gps_s.size:
        report.t_first_s, report.t_last_s = float(np.min(scan.t_gps_s)), float(np.max(scan.t_gps_s))
    details: dict[str, object] = {
        "systems": ", ".join(scan.systems),
        "program": scan.text("PGM / RUN BY / DATE"),
    }
    if observation:
        report.count("epochs", scan.t_gps_s.size)
        report.count("satellite records", scan.n_satellite_records)
        for what, n in scan.events.items():
            report.count(what, n)
        report.gaps = find_gaps(scan.t_gps_s)
        if scan.interval_s:
            report.rates_hz["epochs"] = 1.0 / scan.interval_s
        details |= {
            "marker": scan.text("MARKER NAME"),
            "antenna": scan.text("ANT # / TYPE", 20, 40),
            "approx_ecef_m": None if scan.approx_ecef_m is None else scan.approx_ecef_m.tolist(),
            "antenna_delta_hen_m": list(scan.antenna_delta_hen_m),
            "interval_s": scan.interval_s,
            "time_system": scan.time_system,
            "codes": {key: " ".join(value) for key, value in scan.codes.items()},
        }
        if np.any(np.diff(scan.t_gps_s) <= 0):
            report.note("The epochs are not in order of time.")
        if scan.approx_ecef_m is None or not np.any(scan.approx_ecef_m):
            report.note("The header holds no approximate position (it is absent or zero).")
    else:
        report.count("ephemerides", scan.t_gps_s.size)
        for name, t in scan.nav_t_gps_s.items():
            span = f"{utc_text_from_gps(float(t.min()), 0)} .. {utc_text_from_gps(float(t.max()), 0)}"
            details[name] = f"{t.size} ephemerides, reference times {span}"
    report.details = {key: value for key, value in details.items() if value not in ("", None, {})}
    if not scan.t_gps_s.size and not any(scan.losses.values()):
        report.note("The file holds a header only.")
    if any(scan.losses.values()):
        report.note(
            "Records are damaged or cut: " + ", ".join(f"{k} {v}" for k, v in scan.losses.items()) + "."
        )
    return report


def whole_records(scan: RinexScan, data: bytes) -> bytes:
    """The header and the undamaged records of a scanned file, each ending with a line feed."""
    parts = [data[a:b] for a, b in scan.whole]
    return b"".join(part if part.endswith(b"\n") else part + b"\n" for part in parts)


def _check_container(path: Path, data: bytes) -> None:
    if not data:
        raise InputError("the file is empty", expected="a RINEX file", where=path)
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


def _text(header: dict[str, list[str]], label: str, start: int, stop: int) -> str:
    return header.get(label, [""])[0][start:stop].strip()


def _floats(header: dict[str, list[str]], label: str, n: int) -> list[float] | None:
    try:
        values = [float(word) for word in header[label][0].split()[:n]]
    except (KeyError, ValueError):
        return None
    return values if len(values) == n and all(np.isfinite(values)) else None


def _approx(header: dict[str, list[str]]) -> ArrayF | None:
    xyz = _floats(header, "APPROX POSITION XYZ", 3)
    return None if xyz is None else np.array(xyz)


def _delta(header: dict[str, list[str]]) -> tuple[float, float, float]:
    hen = _floats(header, "ANTENNA: DELTA H/E/N", 3) or [0.0, 0.0, 0.0]
    return hen[0], hen[1], hen[2]


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
