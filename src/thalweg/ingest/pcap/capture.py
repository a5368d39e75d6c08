"""UDP payloads out of captured network traffic: pcap, pcapng, or bare payloads one after another.

The file is read in pieces, so memory does not grow with the log. Records are walked in compiled code.
Whatever is not wanted (other ports, TCP, ARP, IPv6) is counted, whatever is damaged is counted as lost,
and reading goes on behind a damaged record where the next sound one can be found.

Sources: libpcap file format (draft-ietf-opsawg-pcap), pcapng (draft-ietf-opsawg-pcapng), link types of
tcpdump.org, RFC 791 (IPv4), RFC 768 (UDP).

The compiled walks work on one window of the file (bytes ``buf[:n]``) and stop at what only the caller can
decide: the end of the window, a header that cannot be, a block that changes the interfaces.
"""

import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from io import BufferedReader
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayI, ArrayU8, InputError, UnsupportedError, njit
from thalweg.ingest.framing import gather

# ---------------------------------------------------------------- compiled walks over one window

NEED: Final = 0
"""The record at the returned offset reaches beyond the window."""
BAD: Final = 1
"""The record header at the returned offset is damaged."""
FULL: Final = 2
"""The output arrays are full."""
META: Final = 3
"""A pcapng block that opens a section or describes an interface."""
FOUND: Final = 4
"""A sound record begins at the returned offset."""

N_TALLY: Final = 13
_RECORD, _OTHER_PORT, _OTHER_IP, _IPV6, _NOT_IP, _LINK = 0, 1, 2, 3, 4, 5
_FRAGMENT, _CUT, _SIZE, _MALFORMED = 6, 7, 8, 9
_CUT_TO, _CUT_FROM = 10, 11  # longest of the cut frames, as captured and as sent: no counts
_SECOND: Final = 12  # of the last record of classic pcap
COUNT_NAMES: Final = {
    _RECORD: "capture_records",
    _OTHER_PORT: "udp_other_ports",
    _OTHER_IP: "ip_other_protocols",
    _IPV6: "ipv6_frames",
    _NOT_IP: "non_ip_frames",
    _LINK: "frames_of_other_link_types",
}
LOSS_NAMES: Final = {
    _FRAGMENT: "ip_fragments",
    _CUT: "truncated_packets",
    _SIZE: "packets_of_wrong_size",
    _MALFORMED: "malformed_frames",
}

LINK_TYPES: Final = {0: 0, 108: 0, 1: 1, 113: 113, 276: 276, 12: 101, 14: 101, 101: 101, 228: 101}
"""Link types of tcpdump.org that are understood, and the case of `_network_layer` that reads them:
null and loopback, Ethernet, Linux cooked v1 and v2, raw IP under its four numbers."""

_RAW_IP: Final = 101
_NO_ETHERTYPE: Final = {0: 4, _RAW_IP: 0}
"""Link types whose network packet begins so many bytes into the frame, of a kind that its version tells."""
_ETHERTYPE: Final = {1: (14, 12), 113: (16, 14), 276: (20, 0)}
"""Link type -> length of its header, and where in it the EtherType stands."""

MAX_RECORD: Final = 262_144
"""Longest record that capture programs write (MAXIMUM_SNAPLEN of libpcap), bytes."""
_MAX_BLOCK: Final = 1 << 24
_MAX_FRAME: Final = 70_000
_DAY_S: Final = 86_400


class Sinks(NamedTuple):
    """Arrays that the compiled walks fill: which payloads are wanted, what was counted, and rows found.

    A row of ``out`` is the payload's first byte in the window, its stream, its record, and its sender.
    """

    ports: ArrayI
    sizes: ArrayI
    tally: ArrayI
    foreign: ArrayI
    out: ArrayI
    out_t: ArrayF


@njit(cache=True, nogil=True, inline="always")
def _u16(buf: ArrayU8, o: int, big: bool = True) -> Any:
    a, b = np.int64(buf[o]), np.int64(buf[o + 1])
    return (a << 8) | b if big else (b << 8) | a


@njit(cache=True, nogil=True)
def _u32(buf: ArrayU8, o: int, big: bool) -> Any:
    a, b, c, d = np.int64(buf[o]), np.int64(buf[o + 1]), np.int64(buf[o + 2]), np.int64(buf[o + 3])
    if big:
        return (a << 24) | (b << 16) | (c << 8) | d
    return (d << 24) | (c << 16) | (b << 8) | a


@njit(cache=True, nogil=True)
def walk_pcap(
    buf: ArrayU8, n: int, o: int, big: bool, ticks_per_s: int, check_length: bool, link: int, sinks: Sinks
) -> tuple[int, int, int, int]:
    """Walk classic pcap records from ``o``; returns (status, offset, previous record, frames)."""
    k, last = 0, -1
    while True:
        if k >= sinks.out.shape[0]:
            return FULL, o, last, k
        if o + 16 > n:
            return NEED, o, last, k
        fraction = _u32(buf, o + 4, big)
        length = _u32(buf, o + 8, big)
        original = _u32(buf, o + 12, big)
        # A record of no bytes is none: zeros, or the header of a second capture appended to the first.
        if (
            length == 0
            or fraction >= ticks_per_s
            or length > MAX_RECORD
            or (check_length and length > original)
        ):
            return BAD, o, last, k
        if o + 16 + length > n:
            return NEED, o, last, k
        sinks.tally[_SECOND] = _u32(buf, o, big)
        sinks.out_t[k] = sinks.tally[_SECOND] + fraction / ticks_per_s
        row = sinks.out[k]
        row[0], row[1], row[2] = o + 16, o + 16 + length, link
        k += 1
        last = o
        o += 16 + length


@njit(cache=True, nogil=True)
def _pcap_header(buf: ArrayU8, o: int, big: bool, ticks_per_s: int, second: int) -> int:
    """Length of a record whose header at ``o`` is beyond reasonable doubt, else -1."""
    length = _u32(buf, o + 8, big)
    if length < 14 or length > _MAX_FRAME or length > _u32(buf, o + 12, big):
        return -1
    if _u32(buf, o + 12, big) > _MAX_FRAME or _u32(buf, o + 4, big) >= ticks_per_s:
        return -1
    if second >= 0 and abs(_u32(buf, o, big) - second) > _DAY_S:
        return -1
    return length


@njit(cache=True, nogil=True)
def find_pcap(
    buf: ArrayU8, n: int, o: int, big: bool, ticks_per_s: int, second: int, final: bool
) -> tuple[int, int]:
    """Next offset from ``o`` where sound records follow each other, or one that ends the file.

    Two are enough within a day of the last record, four for another time (an appended second capture).
    """
    while o + 16 <= n:
        length = _pcap_header(buf, o, big, ticks_per_s, -1)
        if length >= 0:
            here = _u32(buf, o, big)
            near = second < 0 or abs(here - second) <= _DAY_S
            left = 1 if near else 3
            after = o + 16 + length
            sound = True
            while sound and left > 0:
                if after + 16 > n:
                    break
                following = _pcap_header(buf, after, big, ticks_per_s, here)
                sound = following >= 0
                after += 16 + following
                left -= 1
            if sound and left == 0:
                return FOUND, o
            if sound and not final:
                return NEED, o
            if sound and near and after == n:
                return FOUND, o
        o += 1
    return NEED, o


@njit(cache=True, nogil=True)
def walk_pcapng(
    buf: ArrayU8, n: int, o: int, big: bool, interfaces: ArrayF, sinks: Sinks
) -> tuple[int, int, int, int]:
    """Walk pcapng blocks from ``o``; returns (status, offset, previous block, frames).

    A row of ``interfaces`` is the link type, ticks per second, offset in seconds, and snap length.
    """
    k, last = 0, -1
    while True:
        if k >= sinks.out.shape[0]:
            return FULL, o, last, k
        if o + 12 > n:
            return NEED, o, last, k
        kind = _u32(buf, o, big)
        if kind == 0x0A0D0D0A:
            return META, o, last, k
        length = _u32(buf, o + 4, big)
        if length < 12 or length % 4 or length > _MAX_BLOCK:
            return BAD, o, last, k
        if o + length > n:
            return NEED, o, last, k
        if _u32(buf, o + length - 4, big) != length:
            return BAD, o, last, k
        if kind == 1:
            return META, o, last, k
        interface, start, captured, t_s = np.int64(-1), np.int64(0), np.int64(0), np.nan
        if (kind == 6 or kind == 2) and length >= 32:
            interface = _u32(buf, o + 8, big) if kind == 6 else _u16(buf, o + 8, big)
            start, captured = np.int64(o + 28), _u32(buf, o + 20, big)
            if captured > length - 32:
                interface = np.int64(1 << 32)
            elif interface < len(interfaces):
                ticks = _u32(buf, o + 12, big) * 4294967296.0 + _u32(buf, o + 16, big)
                t_s = ticks / interfaces[interface, 1] + interfaces[interface, 2]
        elif kind == 3 and length >= 16 and len(interfaces) > 0:
            interface, start = np.int64(0), np.int64(o + 12)
            captured = min(_u32(buf, o + 8, big), length - 16)
            if interfaces[0, 3] > 0:
                captured = min(captured, np.int64(interfaces[0, 3]))
        if interface >= 0:
            row = sinks.out[k]
            row[0], row[1], row[2] = start, start, _RAW_IP  # of an interface that is not described: malformed
            if interface < len(interfaces):
                row[1], row[2] = start + captured, np.int64(interfaces[interface, 0])
            sinks.out_t[k] = t_s
            k += 1
        last = o
        o += length


@njit(cache=True, nogil=True)
def find_pcapng(buf: ArrayU8, n: int, o: int, big: bool, final: bool) -> tuple[int, int]:
    """Next offset from ``o`` of a block whose two length fields agree."""
    while o + 12 <= n:
        kind = _u32(buf, o, big)
        if kind == 6 or kind == 0x0A0D0D0A or kind == 1 or kind == 2 or kind == 3:
            length = _u32(buf, o + 4, big)
            if 12 <= length <= _MAX_FRAME and length % 4 == 0:
                if o + length <= n:
                    if _u32(buf, o + length - 4, big) == length:
                        return FOUND, o
                elif not final:
                    return NEED, o
        o += 1
    return NEED, o


@njit(cache=True, nogil=True)
def _marks_at(buf: ArrayU8, o: int, marks: AnyArray, mark: int) -> int:
    """Number of marks (two bytes, big-endian value) found at their offsets behind ``o``."""
    hits = 0
    for i in range(marks.size):
        hits += _u16(buf, o + marks[i]) == mark
    return hits


@njit(cache=True, nogil=True)
def walk_bare(
    buf: ArrayU8, n: int, o: int, final: bool, marks: ArrayI, mark: int, sinks: Sinks
) -> tuple[int, int, int, int]:
    """Walk payloads of the first stream without any header.

    All marks must be in place; half of them do if all of the next payload's are. Fewer conditions would let
    a stream pass that is shifted by the distance of two marks.
    """
    k, last, size = 0, -1, sinks.sizes[0]
    while True:
        if k >= sinks.out.shape[0]:
            return FULL, o, last, k
        if o + size > n:
            return NEED, o, last, k
        hits = _marks_at(buf, o, marks, mark)
        if hits < marks.size:
            if o + 2 * size > n and not final:
                return NEED, o, last, k
            sound = o + 2 * size > n or _marks_at(buf, o + size, marks, mark) == marks.size
            if 2 * hits < marks.size or not sound:
                return BAD, o, last, k
        row = sinks.out[k]
        row[0], row[1], row[2], row[3] = o, 0, sinks.tally[_RECORD], 0
        sinks.out_t[k] = np.nan
        sinks.tally[_RECORD] += 1
        k += 1
        last = o
        o += size


@njit(cache=True, nogil=True)
def find_bare(buf: ArrayU8, n: int, o: int, size: int, marks: ArrayI, mark: int) -> tuple[int, int]:
    """Next offset from ``o`` where all marks are in place."""
    while o + size <= n:
        if _u16(buf, o + marks[0]) == mark and _marks_at(buf, o, marks, mark) == marks.size:
            return FOUND, o
        o += 1
    return NEED, o


# ---------------------------------------------------------------- payloads of the frames that a walk found,
# all of a window at once: compiled, frame by frame, this ran no faster and took a second to compile


def _u16_at(buf: ArrayU8, o: ArrayI) -> ArrayI:
    """Big-endian words at offsets ``o`` (n,)."""
    return buf[o].astype(np.int64) << 8 | buf[o + 1]


def _is_vlan(ether: ArrayI) -> ArrayB:
    return (ether == 0x8100) | (ether == 0x88A8) | (ether == 0x9100)


def _network_layer(buf: ArrayU8, a: ArrayI, b: ArrayI, link: int) -> tuple[ArrayI, ArrayI]:
    """Offset and EtherType (0 = look at the version nibble, -1 = cut) of the network packets in [a, b)."""
    if link in _NO_ETHERTYPE:
        return a + _NO_ETHERTYPE[link], np.zeros_like(a)
    header, kind = _ETHERTYPE[link]
    o, ether = np.minimum(a + header, b), np.full_like(a, -1)
    rows = np.flatnonzero(a + header <= b)
    ether[rows] = _u16_at(buf, a[rows] + kind)
    while (rows := rows[_is_vlan(ether[rows]) & (o[rows] + 4 <= b[rows])]).size:
        ether[rows] = _u16_at(buf, o[rows] + 2)
        o[rows] += 4
    return o, ether


def _keep_payloads(buf: ArrayU8, n: int, sinks: Sinks) -> int:
    """Put the wanted payloads in the place of the ``n`` frames of ``sinks.out``, count all others; how many.

    A row holds the frame's first byte, its end and its link type before, and what `Sinks` says after.
    """
    tally, rows = sinks.tally, np.arange(n)
    a, b, link = sinks.out[:n, :3].T.copy()

    def without(bad: ArrayB, cell: int, *columns: ArrayI) -> tuple[ArrayI, ...]:
        """The columns (k,) of the frames that are not bad (n,); those are counted in a cell of the tally."""
        if not bad.any():
            return columns
        tally[cell] += np.count_nonzero(bad)
        return tuple(column[~bad] for column in columns)

    def note_cut(cut: ArrayB, end: ArrayI) -> None:
        """Keep the largest captured and sent lengths of cut frames, whose payloads end at ``end`` (n,)."""
        if cut.any():
            tally[_CUT_TO] = max(tally[_CUT_TO], (b - a)[cut].max())
            tally[_CUT_FROM] = max(tally[_CUT_FROM], (end - a)[cut].max())

    rows, a, b, link = without(link < 0, _LINK, rows, a, b, link)
    o, ether = a.copy(), a.copy()
    for each in set(link.tolist()):
        mine = link == each
        o[mine], ether[mine] = _network_layer(buf, a[mine], b[mine], each)
    rows, a, b, o, ether = without((ether < 0) | (o >= b), _MALFORMED, rows, a, b, o, ether)
    first = buf[o].astype(np.int64)
    bad = (ether == 0x86DD) | ((ether == 0) & (first >> 4 == 6))
    rows, a, b, o, ether, first = without(bad, _IPV6, rows, a, b, o, ether, first)
    bad = (ether != 0x0800) & (ether != 0)
    rows, a, b, o, first = without(bad, _NOT_IP, rows, a, b, o, first)
    header = 4 * (first & 15)
    bad = (first >> 4 != 4) | (header < 20) | (o + header > b)
    rows, a, b, o, header = without(bad, _MALFORMED, rows, a, b, o, header)
    whole, bad = o + _u16_at(buf, o + 2), _u16_at(buf, o + 6) & 0x3FFF != 0
    note_cut(bad & (whole > b), whole)
    rows, a, b, o, header = without(bad, _FRAGMENT, rows, a, b, o, header)
    rows, a, b, o, header = without(buf[o + 9] != 17, _OTHER_IP, rows, a, b, o, header)
    u = o + header
    rows, a, b, o, u = without(u + 8 > b, _MALFORMED, rows, a, b, o, u)
    port, size = _u16_at(buf, u + 2), _u16_at(buf, u + 4) - 8
    stream = np.full_like(rows, -1)
    other = np.ones(rows.size, dtype=np.bool_)
    for i, of_stream in enumerate(zip(sinks.ports.tolist(), sinks.sizes.tolist(), strict=True)):
        other &= port != of_stream[0]
        stream[(port == of_stream[0]) & (size == of_stream[1])] = i
    if other.any():
        np.add.at(sinks.foreign, port[other & (size == sinks.sizes[0])], 1)
    rows, a, b, o, u, stream, size = without(other, _OTHER_PORT, rows, a, b, o, u, stream, size)
    rows, a, b, o, u, stream, size = without(stream < 0, _SIZE, rows, a, b, o, u, stream, size)
    end = u + 8 + size
    note_cut(end > b, end)
    rows, o, u, stream = without(end > b, _CUT, rows, o, u, stream)
    k = rows.size
    sender = _u16_at(buf, o + 12) << 16 | _u16_at(buf, o + 14)
    for i, column in enumerate((u + 8, stream, tally[_RECORD] + rows, sender)):
        sinks.out[:k, i] = column
    sinks.out_t[:k] = sinks.out_t[rows]
    tally[_RECORD] += n
    return k


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


class Pcap:
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
        if link not in LINK_TYPES:
            raise UnsupportedError(
                f"link type {link}",
                expected="Ethernet (1), Linux cooked (113, 276), raw IP (101, 228) or loopback (0, 108)",
                where=where,
                cure="Capture on the Ethernet interface of the lidar",
            )
        self.link = LINK_TYPES[link]
        # Some writers put a wrong original length everywhere; then it says nothing about damage.
        lengths = struct.unpack((">" if self.big else "<") + "2I", head[32:40]) if len(head) >= 40 else (0, 0)
        self.check_length = lengths[0] <= lengths[1]
        unit = "microseconds" if self.ticks == 1_000_000 else "nanoseconds"
        self.name = f"pcap, {unit}, {'big' if self.big else 'little'} endian"

    def walk(self, w: Window, o: int, sinks: Sinks) -> tuple[int, int, int, int]:
        """Take in records from ``o`` on; returns (status, offset, previous record, rows)."""
        status, o, last, n = walk_pcap(
            w.buf, w.n, o, self.big, self.ticks, self.check_length, self.link, sinks
        )
        return status, o, last, _keep_payloads(w.buf, n, sinks)

    def find(self, w: Window, o: int, sinks: Sinks) -> tuple[int, int]:
        """Look for a sound record from ``o`` on; returns (status, offset)."""
        return find_pcap(w.buf, w.n, o, self.big, self.ticks, sinks.tally[_SECOND], w.final)


class Pcapng:
    """pcapng: sections of either byte order, interfaces with their own link type and clock."""

    name = "pcapng"
    start = 0

    def __init__(self) -> None:
        self.big = False
        self.interfaces: list[tuple[float, float, float, float]] = []

    def walk(self, w: Window, o: int, sinks: Sinks) -> tuple[int, int, int, int]:
        """Take in records, see `Pcap.walk`."""
        interfaces = np.array(self.interfaces, dtype=np.float64).reshape(-1, 4)
        status, o, last, n = walk_pcapng(w.buf, w.n, o, self.big, interfaces, sinks)
        return status, o, last, _keep_payloads(w.buf, n, sinks)

    def find(self, w: Window, o: int, sinks: Sinks) -> tuple[int, int]:
        """Look for a sound record, see `Pcap.find`."""
        return find_pcapng(w.buf, w.n, o, self.big, w.final)

    def meta(self, w: Window, o: int) -> tuple[int, int]:
        """Take in a section header or an interface description; returns (status, offset behind it)."""
        head = w.buf[o : min(o + 28, w.n)].tobytes()
        if head[:4] == PCAPNG_MAGIC:
            if head[8:12] not in (b"\x1a\x2b\x3c\x4d", b"\x4d\x3c\x2b\x1a"):
                return BAD, o
            big = head[8:12] == b"\x1a\x2b\x3c\x4d"
            (length,) = struct.unpack(">I" if big else "<I", head[4:8])
            if length < 28 or length % 4 or length > MAX_RECORD:
                return BAD, o
            if o + length > w.n:
                return NEED, o
            self.big, self.interfaces = big, []
            return FOUND, o + length
        order = ">" if self.big else "<"
        (length,) = struct.unpack(order + "I", head[4:8])
        if length < 20:
            return BAD, o
        link, _, snap = struct.unpack(order + "HHI", head[8:16])
        ticks, offset_s = _interface_clock(w.buf[o + 16 : o + length - 4].tobytes(), order)
        self.interfaces.append((LINK_TYPES.get(link, -1), ticks, offset_s, snap))
        return FOUND, o + length


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


class BareFormat:
    """Payloads of the main stream, one after another."""

    start = 0

    def __init__(self, size: int, bare: BarePayloads) -> None:
        self.size, self.mark = size, bare.mark
        self.marks = np.array(bare.marks, dtype=np.int64)
        self.name = f"bare {size}-byte payloads"

    def walk(self, w: Window, o: int, sinks: Sinks) -> tuple[int, int, int, int]:
        """Take in records, see `Pcap.walk`."""
        return walk_bare(w.buf, w.n, o, w.final, self.marks, self.mark, sinks)

    def find(self, w: Window, o: int, sinks: Sinks) -> tuple[int, int]:
        """Look for a sound record, see `Pcap.find`."""
        return find_bare(w.buf, w.n, o, self.size, self.marks, self.mark)


RecordFormat = Pcap | Pcapng | BareFormat
"""State of one file format: how to walk on, how to find the next sound record."""

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
    counts: Counter[str] = field(default_factory=Counter)
    losses: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)
    foreign_ports: Counter[int] = field(default_factory=Counter)
    """Payloads of the first stream's size that went to other ports: a hint at a wrong port setting."""
    cut_to_b: int = 0
    """Longest frame that the capture cut, and in ``cut_from_b`` how long it was; 0 without any."""
    cut_from_b: int = 0

    def cut_in_words(self) -> str:
        """That the capture cut packets; empty if it did not."""
        if not self.cut_to_b:
            return ""
        n = self.losses[LOSS_NAMES[_CUT]]
        each = "1 packet is" if n == 1 else f"{n} packets are" if n else "parts of packets are"
        return f"captured with a snap length of {self.cut_to_b} of {self.cut_from_b} bytes: {each} cut"


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
        if find_bare(w.buf, w.n, 0, form.size, form.marks, form.mark)[0] == FOUND:
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
        rows = w.buf.size // (min(s.size for s in streams) + 16) + 2
        sinks = Sinks(
            ports=np.array([s.port for s in streams], dtype=np.int64),
            sizes=np.array([s.size for s in streams], dtype=np.int64),
            tally=np.zeros(N_TALLY, dtype=np.int64),
            foreign=np.zeros(65536, dtype=np.int64),
            out=np.empty((rows, 4), dtype=np.int64),
            out_t=np.empty(rows, dtype=np.float64),
        )
        sinks.tally[_SECOND] = -1
        yield from _read(w, form, sinks, path, found)
    found.bytes_read += w.base + w.n
    _add_tally(sinks, found)


def _read(
    w: Window, form: RecordFormat, sinks: Sinks, path: Path, found: CaptureTally
) -> Iterator[list[PayloadBlock]]:
    """Walk all records; at a damaged one look for the next sound one and count the bytes between."""
    o, previous, floor = form.start, -1, -1
    while True:
        status, o, last, rows = form.walk(w, o, sinks)
        if rows:
            yield _blocks(w, sinks, rows)
        previous = w.base + last if last >= 0 else previous
        if status == META and isinstance(form, Pcapng):
            status, o = form.meta(w, o)
        if status == NEED and not w.final:
            w.refill(o)
            o = 0
            continue
        if status == NEED and o >= w.n:
            return
        if status in (BAD, NEED):
            cut, bad = status == NEED, w.base + o
            # The length of the record before may be what is wrong, so the search begins inside it; never
            # before the last resumption, so that each search ends further on.
            inside = previous + 17 if previous >= w.base and not cut else bad + 1
            o = _resume(w, form, sinks, max(min(inside, bad + 1), floor + 1) - w.base)
            floor = w.base + o
            _report_damage(found, path, bad, floor, cut and o >= w.n)
            if o >= w.n:
                return


def _resume(w: Window, form: RecordFormat, sinks: Sinks, o: int) -> int:
    """Offset in the (moved on) window of the next sound record, or its end if there is none."""
    while True:
        status, o = form.find(w, o, sinks)
        if status == FOUND:
            return o
        if w.final:
            return w.n
        w.refill(o)
        o = 0


def _report_damage(found: CaptureTally, path: Path, bad: int, resumed: int, cut: bool) -> None:
    skipped = max(0, resumed - bad)
    found.losses["bytes_skipped"] += skipped
    if cut:
        found.losses["cut_records"] += 1
        found.notes.append(f"{path.name} ends inside a packet: the last {skipped} bytes are unusable.")
        return
    found.losses["damaged_records"] += 1
    if found.losses["damaged_records"] <= _NAMED_DAMAGES:
        found.notes.append(f"{path.name}: damaged at byte {bad}, reading goes on at byte {resumed}.")


def _blocks(w: Window, sinks: Sinks, rows: int) -> list[PayloadBlock]:
    """Copy the payloads that were found out of the window, one block a stream."""
    blocks = []
    for i, size in enumerate(sinks.sizes):
        mine = np.flatnonzero(sinks.out[:rows, 1] == i)
        start = sinks.out[mine, 0]
        payload = np.empty((mine.size, int(size)), dtype=np.uint8)
        gather(w.buf, start, payload)
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
    for names, target in ((COUNT_NAMES, found.counts), (LOSS_NAMES, found.losses)):
        for index, name in names.items():
            if sinks.tally[index]:
                target[name] += int(sinks.tally[index])
    found.cut_to_b = max(found.cut_to_b, int(sinks.tally[_CUT_TO]))
    found.cut_from_b = max(found.cut_from_b, int(sinks.tally[_CUT_FROM]))
    for port in np.flatnonzero(sinks.foreign):
        found.foreign_ports[int(port)] += int(sinks.foreign[port])
