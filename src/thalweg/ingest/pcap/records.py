"""The record layers of capture files: classic pcap, pcapng, and payloads without any header."""

import struct
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Final

import numpy as np

from thalweg.core.errors import InputError, UnsupportedError
from thalweg.core.types import ArrayF, ArrayI
from thalweg.ingest.pcap import kernels as frames

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
