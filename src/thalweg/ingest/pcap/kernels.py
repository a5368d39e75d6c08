"""Compiled walks over the records of a capture file, down to the UDP payload.

All functions work on one window of the file (bytes ``buf[:n]``) and stop at what only the caller can
decide: the end of the window, a header that cannot be, a block that changes the interfaces.
"""

from typing import Any, Final

import numpy as np

from thalweg.core import AnyArray, ArrayF, ArrayI, ArrayU8, njit

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

N_TALLY: Final = 10
_RECORD, _OTHER_PORT, _OTHER_IP, _IPV6, _NOT_IP, _LINK = 0, 1, 2, 3, 4, 5
_FRAGMENT, _CUT, _SIZE, _MALFORMED = 6, 7, 8, 9
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

MAX_RECORD: Final = 262_144
"""Longest record that capture programs write (MAXIMUM_SNAPLEN of libpcap), bytes."""
_MAX_BLOCK: Final = 1 << 24
_MAX_FRAME: Final = 70_000
_DAY_S: Final = 86_400


@njit(cache=True, nogil=True, inline="always")
def _u16(buf: ArrayU8, o: int) -> Any:
    return (np.int64(buf[o]) << 8) | np.int64(buf[o + 1])


@njit(cache=True, nogil=True)
def _u32(buf: ArrayU8, o: int, big: bool) -> Any:
    a, b, c, d = np.int64(buf[o]), np.int64(buf[o + 1]), np.int64(buf[o + 2]), np.int64(buf[o + 3])
    if big:
        return (a << 24) | (b << 16) | (c << 8) | d
    return (d << 24) | (c << 16) | (b << 8) | a


@njit(cache=True, nogil=True)
def _network_layer(buf: ArrayU8, a: int, b: int, link: int) -> tuple[int, int]:
    """Offset and EtherType (0 = look at the version nibble) of the network packet in frame [a, b)."""
    if link == 101:
        return a, 0
    if link == 0:
        return a + 4, 0
    if link == 113:
        o, kind = a + 16, a + 14
    elif link == 276:
        o, kind = a + 20, a
    else:
        o, kind = a + 14, a + 12
    if o > b:
        return b, -1
    ether = _u16(buf, kind)
    while (ether == 0x8100 or ether == 0x88A8 or ether == 0x9100) and o + 4 <= b:
        ether = _u16(buf, o + 2)
        o += 4
    return o, ether


@njit(cache=True, nogil=True)
def _take(
    buf: ArrayU8,
    a: int,
    b: int,
    link: int,
    t_s: float,
    ports: ArrayI,
    sizes: ArrayI,
    tally: ArrayI,
    foreign: ArrayI,
    out: ArrayI,
    out_t: ArrayF,
    k: int,
) -> int:
    """Find the payload in frame [a, b), count what it is, store it as row ``k`` if wanted; next ``k``."""
    tally[_RECORD] += 1
    if link < 0:
        tally[_LINK] += 1
        return k
    o, ether = _network_layer(buf, a, b, link)
    if ether < 0 or o >= b:
        tally[_MALFORMED] += 1
        return k
    version = buf[o] >> 4
    if ether == 0x86DD or (ether == 0 and version == 6):
        tally[_IPV6] += 1
        return k
    if ether != 0x0800 and ether != 0:
        tally[_NOT_IP] += 1
        return k
    header = 4 * np.int64(buf[o] & 15)
    if version != 4 or header < 20 or o + header > b:
        tally[_MALFORMED] += 1
        return k
    if _u16(buf, o + 6) & 0x3FFF:
        tally[_FRAGMENT] += 1
        return k
    if buf[o + 9] != 17:
        tally[_OTHER_IP] += 1
        return k
    u = o + header
    if u + 8 > b:
        tally[_MALFORMED] += 1
        return k
    port = _u16(buf, u + 2)
    size = _u16(buf, u + 4) - 8
    wanted = -1
    ours = False
    for i in range(ports.size):
        if ports[i] == port:
            ours = True
            if sizes[i] == size:
                wanted = i
    if not ours:
        tally[_OTHER_PORT] += 1
        if size == sizes[0]:
            foreign[port] += 1
        return k
    if wanted < 0:
        tally[_SIZE] += 1
        return k
    if u + 8 + size > b:
        tally[_CUT] += 1
        return k
    out[k, 0] = u + 8
    out[k, 1] = wanted
    out[k, 2] = tally[_RECORD] - 1
    out[k, 3] = _u32(buf, o + 12, True)
    out_t[k] = t_s
    return k + 1


@njit(cache=True, nogil=True)
def walk_pcap(
    buf: ArrayU8,
    n: int,
    o: int,
    big: bool,
    ticks_per_s: int,
    check_length: bool,
    link: int,
    ports: ArrayI,
    sizes: ArrayI,
    tally: ArrayI,
    foreign: ArrayI,
    out: ArrayI,
    out_t: ArrayF,
) -> tuple[int, int, int, int, int]:
    """Walk classic pcap records from ``o``; returns (status, offset, previous record, rows, last second)."""
    k, last, second = 0, -1, -1
    while True:
        if k >= out.shape[0]:
            return FULL, o, last, k, second
        if o + 16 > n:
            return NEED, o, last, k, second
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
            return BAD, o, last, k, second
        if o + 16 + length > n:
            return NEED, o, last, k, second
        second = _u32(buf, o, big)
        t_s = second + fraction / ticks_per_s
        k = _take(buf, o + 16, o + 16 + length, link, t_s, ports, sizes, tally, foreign, out, out_t, k)
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
    buf: ArrayU8,
    n: int,
    o: int,
    big: bool,
    links: ArrayI,
    ticks_per_s: ArrayF,
    offset_s: ArrayF,
    snap: ArrayI,
    ports: ArrayI,
    sizes: ArrayI,
    tally: ArrayI,
    foreign: ArrayI,
    out: ArrayI,
    out_t: ArrayF,
) -> tuple[int, int, int, int, int]:
    """Walk pcapng blocks from ``o``; returns (status, offset, previous block, rows, -1)."""
    k, last = 0, -1
    while True:
        if k >= out.shape[0]:
            return FULL, o, last, k, -1
        if o + 12 > n:
            return NEED, o, last, k, -1
        kind = _u32(buf, o, big)
        if kind == 0x0A0D0D0A:
            return META, o, last, k, -1
        length = _u32(buf, o + 4, big)
        if length < 12 or length % 4 or length > _MAX_BLOCK:
            return BAD, o, last, k, -1
        if o + length > n:
            return NEED, o, last, k, -1
        if _u32(buf, o + length - 4, big) != length:
            return BAD, o, last, k, -1
        if kind == 1:
            return META, o, last, k, -1
        interface, start, captured, t_s = np.int64(-1), np.int64(0), np.int64(0), np.nan
        if (kind == 6 or kind == 2) and length >= 32:
            if kind == 6:
                interface = _u32(buf, o + 8, big)
            elif big:
                interface = _u16(buf, o + 8)
            else:
                interface = np.int64(buf[o + 8]) | (np.int64(buf[o + 9]) << 8)
            start, captured = np.int64(o + 28), _u32(buf, o + 20, big)
            if captured > length - 32:
                interface = np.int64(1 << 32)
            elif interface < links.size:
                ticks = _u32(buf, o + 12, big) * 4294967296.0 + _u32(buf, o + 16, big)
                t_s = ticks / ticks_per_s[interface] + offset_s[interface]
        elif kind == 3 and length >= 16 and links.size > 0:
            interface, start = np.int64(0), np.int64(o + 12)
            captured = min(_u32(buf, o + 8, big), length - 16)
            if snap[0] > 0:
                captured = min(captured, snap[0])
        if interface >= links.size:
            tally[_RECORD] += 1
            tally[_MALFORMED] += 1
        elif interface >= 0:
            k = _take(
                buf,
                start,
                start + captured,
                links[interface],
                t_s,
                ports,
                sizes,
                tally,
                foreign,
                out,
                out_t,
                k,
            )
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
    buf: ArrayU8,
    n: int,
    o: int,
    final: bool,
    size: int,
    marks: ArrayI,
    mark: int,
    tally: ArrayI,
    out: ArrayI,
    out_t: ArrayF,
) -> tuple[int, int, int, int, int]:
    """Walk payloads of ``size`` bytes without any header.

    All marks must be in place; half of them do if all of the next payload's are. Fewer conditions would let
    a stream pass that is shifted by the distance of two marks.
    """
    k, last = 0, -1
    while True:
        if k >= out.shape[0]:
            return FULL, o, last, k, -1
        if o + size > n:
            return NEED, o, last, k, -1
        hits = _marks_at(buf, o, marks, mark)
        if hits < marks.size:
            if o + 2 * size > n and not final:
                return NEED, o, last, k, -1
            sound = o + 2 * size > n or _marks_at(buf, o + size, marks, mark) == marks.size
            if 2 * hits < marks.size or not sound:
                return BAD, o, last, k, -1
        out[k, 0] = o
        out[k, 1] = 0
        out[k, 2] = tally[_RECORD]
        out[k, 3] = 0
        out_t[k] = np.nan
        tally[_RECORD] += 1
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


@njit(cache=True, nogil=True)
def gather(buf: ArrayU8, start: ArrayI, payload: ArrayU8) -> None:
    """Copy the bytes from each ``start`` into the rows of ``payload``."""
    for i in range(start.size):
        payload[i, :] = buf[start[i] : start[i] + payload.shape[1]]
