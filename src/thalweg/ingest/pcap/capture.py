"""UDP payloads out of captured network traffic: pcap, pcapng, or bare payloads one after another.

The file is read in pieces, so memory does not grow with the log. Records are walked in compiled code.
Whatever is not wanted (other ports, TCP, ARP, IPv6) is counted, whatever is damaged is counted as lost,
and reading goes on behind a damaged record where the next sound one can be found.

Sources: libpcap file format (draft-ietf-opsawg-pcap), pcapng (draft-ietf-opsawg-pcapng), link types of
tcpdump.org, RFC 791 (IPv4), RFC 768 (UDP).
"""

import struct
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from io import BufferedReader
from pathlib import Path
from typing import Final

import numpy as np

from thalweg.core import ArrayF, ArrayI, ArrayU8, InputError, UnsupportedError
from thalweg.ingest.pcap import kernels as frames

# ---------------------------------------------------------------- the record layers of capture files: classic
# pcap, pcapng, and payloads without any header


PCAP_MAGIC: Final = {
    b"\xd4\xc3\xb2\xa1": (False, 1_000_000),
    b"\xa1\xb2\xc3\xd4": (True, 1_000_000),
    b"\x4d\x3c\xb2\xa1": (False, 1_000_000_000),
    b"\xa1\xb2\x3c\x4d": (True, 1_000_000_000),
}
PCAPNG_MAGIC: Final = b"\x0a\x0d\x0d\x0a"
CURE: Final = "Give the log as tcpdump, Wireshark or VeloView wrote it"


@dataclass(frozen=True, slots=True, kw_only=True)
class Stream:
    """Payloads that are wanted: UDP destination port and exact size in bytes."""

    port: int
    size: int


@dataclass(frozen=True, slots=True, kw_only=True)
class BarePayloads:
    """How a payload of the first stream is recognised in a file without any capture header.

    ``marks`` are offsets in the payload at which the two bytes ``mark`` (big-endian value) stand.
    """

    marks: tuple[int, ...]
    mark: int


class Window:
    """A moving piece of the file: ``buf[:n]`` are the bytes from ``base`` on."""

    def __init__(self, file: BufferedReader, chunk_bytes: int) -> None:
        self.file = file
        self.buf = np.empty(chunk_bytes, dtype=np.uint8)
        self.base = 0
        self.n = 0
        self.final = False

    def refill(self, keep: int) -> None:
        """Drop ``buf[:keep]`` and read on; the window grows if nothing can be dropped."""
        left = self.n - keep
        buf = self.buf if keep > 0 else np.empty(2 * self.buf.size, dtype=np.uint8)
        buf[:left] = self.buf[keep : self.n].copy()
        self.buf, self.base, self.n = buf, self.base + keep, left
        self.fill()

    def fill(self) -> None:
        """Read as many bytes as the window has room for."""
        room = self.buf[self.n :].data
        got = self.file.readinto(room)
        self.n += got
        self.final = got < len(room)


class RecordFormat(ABC):
    """State of one file format: how to walk on, how to find the next sound record."""

    name = ""
    start = 0

    @abstractmethod
    def walk(self, w: Window, o: int, sinks: "Sinks") -> tuple[int, int, int, int, int]:
        """Take in records from ``o`` on; returns (status, offset, previous record, rows, last second)."""

    @abstractmethod
    def find(self, w: Window, o: int) -> tuple[int, int]:
        """Look for a sound record from ``o`` on; returns (status, offset)."""

    def meta(self, w: Window, o: int) -> tuple[int, int]:
        """Take in a block that describes others; returns (status, offset behind it)."""
        return frames.BAD, o


class Sinks:
    """Arrays that the compiled walks fill."""

    def __init__(self, streams: Sequence[Stream], rows: int) -> None:
        self.ports = np.array([s.port for s in streams], dtype=np.int64)
        self.sizes = np.array([s.size for s in streams], dtype=np.int64)
        self.tally = np.zeros(frames.N_TALLY, dtype=np.int64)
        self.foreign = np.zeros(65536, dtype=np.int64)
        self.out = np.empty((rows, 4), dtype=np.int64)
        self.out_t = np.empty(rows, dtype=np.float64)

    @property
    def all(self) -> tuple[ArrayI, ArrayI, ArrayI, ArrayI, ArrayI, ArrayF]:
        """The arrays in the order in which the walks take them."""
        return self.ports, self.sizes, self.tally, self.foreign, self.out, self.out_t


class Pcap(RecordFormat):
    """Classic pcap: one link type, stamps in micro- or nanoseconds."""

    start = 24

    def __init__(self, head: bytes, where: Path) -> None:
        self.big, self.ticks = PCAP_MAGIC[head[:4]]
        if len(head) < 24:
            raise InputError(
                f"file ends after {len(head)} bytes, inside the pcap header", where=where, cure=CURE
            )
        (link,) = struct.unpack(">I" if self.big else "<I", head[20:24])
        link &= 0xFFFF
        if link not in frames.LINK_TYPES:
            raise UnsupportedError(
                f"link type {link}",
                expected="Ethernet (1), Linux cooked (113, 276), raw IP (101, 228) or loopback (0, 108)",
                where=where,
                cure="Capture on the Ethernet interface of the lidar",
            )
        self.link = frames.LINK_TYPES[link]
        self.second = -1
        # Some writers put a wrong original length everywhere; then it says nothing about damage.
        lengths = struct.unpack((">" if self.big else "<") + "2I", head[32:40]) if len(head) >= 40 else (0, 0)
        self.check_length = lengths[0] <= lengths[1]
        unit = "microseconds" if self.ticks == 1_000_000 else "nanoseconds"
        self.name = f"pcap, {unit}, {'big' if self.big else 'little'} endian"

    def walk(self, w: Window, o: int, sinks: Sinks) -> tuple[int, int, int, int, int]:
        """Take in records, see `RecordFormat.walk`."""
        result = frames.walk_pcap(
            w.buf, w.n, o, self.big, self.ticks, self.check_length, self.link, *sinks.all
        )
        self.second = result[4] if result[4] >= 0 else self.second
        return result

    def find(self, w: Window, o: int) -> tuple[int, int]:
        """Look for a sound record, see `RecordFormat.find`."""
        return frames.find_pcap(w.buf, w.n, o, self.big, self.ticks, self.second, w.final)


class Pcapng(RecordFormat):
    """pcapng: sections of either byte order, interfaces with their own link type and clock."""

    name = "pcapng"

    def __init__(self) -> None:
        self.big = False
        self.interfaces: list[tuple[int, float, float, int]] = []

    def walk(self, w: Window, o: int, sinks: Sinks) -> tuple[int, int, int, int, int]:
        """Take in records, see `RecordFormat.walk`."""
        links = np.array([i[0] for i in self.interfaces], dtype=np.int64)
        ticks = np.array([i[1] for i in self.interfaces], dtype=np.float64)
        offsets = np.array([i[2] for i in self.interfaces], dtype=np.float64)
        snaps = np.array([i[3] for i in self.interfaces], dtype=np.int64)
        return frames.walk_pcapng(w.buf, w.n, o, self.big, links, ticks, offsets, snaps, *sinks.all)

    def find(self, w: Window, o: int) -> tuple[int, int]:
        """Look for a sound record, see `RecordFormat.find`."""
        return frames.find_pcapng(w.buf, w.n, o, self.big, w.final)

    def meta(self, w: Window, o: int) -> tuple[int, int]:
        """Take in a section header or an interface description."""
        head = w.buf[o : min(o + 28, w.n)].tobytes()
        if head[:4] == PCAPNG_MAGIC:
            if head[8:12] not in (b"\x1a\x2b\x3c\x4d", b"\x4d\x3c\x2b\x1a"):
                return frames.BAD, o
            big = head[8:12] == b"\x1a\x2b\x3c\x4d"
            (length,) = struct.unpack(">I" if big else "<I", head[4:8])
            if length < 28 or length % 4 or length > frames.MAX_RECORD:
                return frames.BAD, o
            if o + length > w.n:
                return frames.NEED, o
            self.big, self.interfaces = big, []
            return frames.FOUND, o + length
        order = ">" if self.big else "<"
        (length,) = struct.unpack(order + "I", head[4:8])
        if length < 20:
            return frames.BAD, o
        link, _, snap = struct.unpack(order + "HHI", head[8:16])
        ticks, offset_s = _interface_clock(w.buf[o + 16 : o + length - 4].tobytes(), order)
        self.interfaces.append((frames.LINK_TYPES.get(link, -1), ticks, offset_s, snap))
        return frames.FOUND, o + length


def _interface_clock(options: bytes, order: str) -> tuple[float, float]:
    """Ticks per second and offset in seconds from the options of an interface block."""
    ticks, offset_s, i = 1e6, 0.0, 0
    while i + 4 <= len(options):
        code, length = struct.unpack_from(order + "HH", options, i)
        value = options[i + 4 : i + 4 + length]
        if code == 0:
            break
        if code == 9 and len(value) == 1:
            ticks = float(2 ** (value[0] & 0x7F)) if value[0] & 0x80 else float(10 ** value[0])
        if code == 14 and len(value) == 8:
            (offset_s,) = struct.unpack(order + "q", value)
        i += 4 + length + (-length) % 4
    return ticks, float(offset_s)


class BareFormat(RecordFormat):
    """Payloads of the main stream, one after another."""

    def __init__(self, size: int, bare: BarePayloads) -> None:
        self.size, self.mark = size, bare.mark
        self.marks = np.array(bare.marks, dtype=np.int64)
        self.name = f"bare {size}-byte payloads"

    def walk(self, w: Window, o: int, sinks: Sinks) -> tuple[int, int, int, int, int]:
        """Take in records, see `RecordFormat.walk`."""
        return frames.walk_bare(
            w.buf, w.n, o, w.final, self.size, self.marks, self.mark, sinks.tally, sinks.out, sinks.out_t
        )

    def find(self, w: Window, o: int) -> tuple[int, int]:
        """Look for a sound record, see `RecordFormat.find`."""
        return frames.find_bare(w.buf, w.n, o, self.size, self.marks, self.mark)


# ---------------------------------------------------------------- capture


__all__ = ["CHUNK_BYTES", "BarePayloads", "CaptureTally", "PayloadBlock", "Stream", "read_payloads"]

CHUNK_BYTES: Final = 8 << 20
"""Bytes read at a time."""

_NAMED_DAMAGES: Final = 20
"""Damages that are named one by one; the rest is only counted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PayloadBlock:
    """Payloads of one stream out of one piece of the file.

    Attributes
    ----------
    payload : (n, size) bytes.
    record : (n,) number of the record in the file, from 0; it orders the streams among each other.
    offset_b : (n,) byte of the file at which the payload begins.
    sender : (n,) IPv4 address of the sender as a number; 0 in bare files.
    t_host_s : (n,) stamp of the capturing computer (Unix time), NaN if the file has none. For findings
        about that clock only: no measurement is ever timed by it.
    """

    payload: ArrayU8
    record: ArrayI
    offset_b: ArrayI
    sender: ArrayI
    t_host_s: ArrayF


@dataclass(slots=True, kw_only=True)
class CaptureTally:
    """What a capture file held besides the payloads; one may be used for several files."""

    format: str = ""
    bytes_read: int = 0
    counts: dict[str, int] = field(default_factory=dict)
    losses: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    foreign_ports: dict[int, int] = field(default_factory=dict)
    """Payloads of the first stream's size that went to other ports: a hint at a wrong port setting."""


def _format_of(w: Window, path: Path, streams: Sequence[Stream], bare: BarePayloads | None) -> RecordFormat:
    head = w.buf[: min(w.n, 64)].tobytes()
    if not head:
        raise InputError("file is empty", expected="pcap or pcapng", where=path, cure=CURE)
    if head[:4] in PCAP_MAGIC:
        return Pcap(head, path)
    if head[:4] == PCAPNG_MAGIC:
        return Pcapng()
    if bare is not None:
        form = BareFormat(streams[0].size, bare)
        status, _ = form.find(w, 0)
        if status == frames.FOUND:
            return form
    packed = {b"\x1f\x8b": "gzip", b"BZh": "bzip2", b"\xfd7zXZ": "xz", b"\x28\xb5\x2f\xfd": "zstd"}
    kind = next((name for magic, name in packed.items() if head.startswith(magic)), "")
    raise InputError(
        f"a {kind} archive" if kind else f"not a capture: the file begins with {head[:4].hex(' ')}",
        expected="pcap, pcapng" + (" or bare payloads" if bare else ""),
        where=path,
        cure="Unpack it first" if kind else CURE,
    )


def read_payloads(
    path: Path,
    streams: Sequence[Stream],
    *,
    bare: BarePayloads | None = None,
    tally: CaptureTally | None = None,
    chunk_bytes: int = CHUNK_BYTES,
) -> Iterator[list[PayloadBlock]]:
    """Read the payloads of some UDP streams, piece by piece.

    Parameters
    ----------
    path : pcap (micro- or nanoseconds), pcapng, or payloads of the first stream without any header.
    streams : what is wanted; the first one is the main stream.
    bare : how to recognise bare payloads; None refuses such files.
    tally : takes counts, losses and notes; complete when the iterator is exhausted.
    chunk_bytes : size of a piece.

    Yields
    ------
    One `PayloadBlock` a stream for each piece (some may be empty).

    Raises
    ------
    InputError : no such file, empty, or not a capture.
    UnsupportedError : a link type that is not implemented.
    """
    found = CaptureTally() if tally is None else tally
    try:
        file = path.open("rb")
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror})", where=path, cure="Check the path of the lidar log"
        ) from error
    with file:
        w = Window(file, max(int(chunk_bytes), 4096))
        w.fill()
        form = _format_of(w, path, streams, bare)
        found.format = form.name
        sinks = Sinks(streams, w.buf.size // (min(s.size for s in streams) + 16) + 2)
        yield from _read(w, form, sinks, path, found)
    found.bytes_read += w.base + w.n
    _add_tally(sinks, found)


def _read(
    w: Window, form: RecordFormat, sinks: Sinks, path: Path, found: CaptureTally
) -> Iterator[list[PayloadBlock]]:
    """Walk all records; at a damaged one look for the next sound one and count the bytes between."""
    o, previous, floor = form.start, -1, -1
    while True:
        status, o, last, rows, _ = form.walk(w, o, sinks)
        if rows:
            yield _blocks(w, sinks, rows)
        previous = w.base + last if last >= 0 else previous
        if status == frames.META:
            status, o = form.meta(w, o)
        if status == frames.NEED and not w.final:
            w.refill(o)
            o = 0
            continue
        if status == frames.NEED and o >= w.n:
            return
        if status in (frames.BAD, frames.NEED):
            cut, bad = status == frames.NEED, w.base + o
            # The length of the record before may be what is wrong, so the search begins inside it; never
            # before the last resumption, so that each search ends further on.
            inside = previous + 17 if previous >= w.base and not cut else bad + 1
            o = _resume(w, form, max(min(inside, bad + 1), floor + 1) - w.base)
            floor = w.base + o
            _report_damage(found, path, bad, floor, cut and o >= w.n)
            if o >= w.n:
                return


def _resume(w: Window, form: RecordFormat, o: int) -> int:
    """Offset in the (moved on) window of the next sound record, or its end if there is none."""
    while True:
        status, o = form.find(w, o)
        if status == frames.FOUND:
            return o
        if w.final:
            return w.n
        w.refill(o)
        o = 0


def _report_damage(found: CaptureTally, path: Path, bad: int, resumed: int, cut: bool) -> None:
    skipped = max(0, resumed - bad)
    found.losses["bytes_skipped"] = found.losses.get("bytes_skipped", 0) + skipped
    if cut:
        found.losses["cut_records"] = found.losses.get("cut_records", 0) + 1
        found.notes.append(f"{path.name} ends inside a packet: the last {skipped} bytes are unusable.")
        return
    n = found.losses.get("damaged_records", 0) + 1
    found.losses["damaged_records"] = n
    if n <= _NAMED_DAMAGES:
        found.notes.append(f"{path.name}: damaged at byte {bad}, reading goes on at byte {resumed}.")


def _blocks(w: Window, sinks: Sinks, rows: int) -> list[PayloadBlock]:
    """Copy the payloads that were found out of the window, one block a stream."""
    blocks = []
    for i, size in enumerate(sinks.sizes):
        mine = np.flatnonzero(sinks.out[:rows, 1] == i)
        start = sinks.out[mine, 0]
        payload = np.empty((mine.size, int(size)), dtype=np.uint8)
        frames.gather(w.buf, start, payload)
        blocks.append(
            PayloadBlock(
                payload=payload,
                record=sinks.out[mine, 2],
                offset_b=start + w.base,
                sender=sinks.out[mine, 3],
                t_host_s=sinks.out_t[mine],
            )
        )
    return blocks


def _add_tally(sinks: Sinks, found: CaptureTally) -> None:
    for names, target in ((frames.COUNT_NAMES, found.counts), (frames.LOSS_NAMES, found.losses)):
        for index, name in names.items():
            if sinks.tally[index]:
                target[name] = target.get(name, 0) + int(sinks.tally[index])
    for port in np.flatnonzero(sinks.foreign):
        found.foreign_ports[int(port)] = found.foreign_ports.get(int(port), 0) + int(sinks.foreign[port])
