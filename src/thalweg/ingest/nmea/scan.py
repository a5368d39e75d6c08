"""NMEA 0183 sentences out of a log's bytes: framing, checksum, logger prefixes, TAG blocks.

A checksum is the exclusive or of all characters between ``$`` and ``*`` (NMEA 0183, "Sentence
structure"). It is computed for a whole chunk at once; only wanted sentences become Python strings.
"""

import datetime as dt
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from thalweg.core.errors import InputError
from thalweg.ingest.integrity import IntegrityReport

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
