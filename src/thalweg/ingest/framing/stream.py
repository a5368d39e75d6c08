"""Packets out of byte streams that carry a check sum: the walk shared by the ANPP and the SBP reader.

Files are read in pieces and joined: a packet that a logger split between two files is whole again, and
memory does not grow with the log. Bytes that belong to no packet are counted and located.
"""

from binascii import crc_hqx
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.core import AnyArray, ArrayB, ArrayI, ArrayU8, InputError, njit
from thalweg.ingest import IntegrityReport

# ---------------------------------------------------------------- Compiled walks over ANPP packets and SBP
# messages


N_CELLS: Final = 6
SKIPPED, BAD_CRC, CUT, HOLES, RUN_START, RUN_END = range(N_CELLS)
"""Cells of the tally: bytes outside of packets, check sum errors where a packet was due, packets cut by
the end of the log, stretches of skipped bytes, first byte and end of the stretch at hand (-1: none)."""

_NOTHING: Final = 0
_INCOMPLETE: Final = -1


def _crc_tables() -> ArrayI:
    """Tables (4, 256) for four bytes a step: row k is the CRC of a byte followed by k zero bytes."""
    tables = np.zeros((4, 256), dtype=np.int64)
    for value in range(256):
        crc = value << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
        tables[0, value] = crc
    for k in range(1, 4):
        tables[k] = [(int(c) << 8 & 0xFFFF) ^ int(tables[0, int(c) >> 8]) for c in tables[k - 1]]
    return tables


_T = _crc_tables()


@njit(cache=True, nogil=True)
def crc16(buf: ArrayU8, start: int, stop: int, crc: int) -> int:
    """CRC with polynomial 0x1021, not reflected, of bytes ``start`` to ``stop``, continued from ``crc``.

    Examples
    --------
    >>> hex(crc16(np.frombuffer(b"123456789", np.uint8), 0, 9, 0xFFFF))  # check value of CRC-16/CCITT-FALSE
    '0x29b1'
    """
    i = start
    while i + 4 <= stop:
        crc = (
            _T[3, (crc >> 8) ^ np.int64(buf[i])]
            ^ _T[2, (crc & 0xFF) ^ np.int64(buf[i + 1])]
            ^ _T[1, np.int64(buf[i + 2])]
            ^ _T[0, np.int64(buf[i + 3])]
        )
        i += 4
    while i < stop:
        crc = ((crc << 8) & 0xFFFF) ^ _T[0, (crc >> 8) ^ np.int64(buf[i])]
        i += 1
    return crc


@njit(cache=True, nogil=True)
def _skip_byte(i: int, tally: ArrayI, holes: ArrayI) -> None:
    """Count byte ``i`` of the stream as outside of any packet."""
    if tally[RUN_START] < 0:
        tally[RUN_START] = i
        tally[HOLES] += 1
    tally[RUN_END] = i + 1
    tally[SKIPPED] += 1
    k = tally[HOLES] - 1
    if k < holes.shape[0]:
        holes[k, 0] = tally[RUN_START]
        holes[k, 1] = i + 1 - tally[RUN_START]


@njit(cache=True, nogil=True)
def gather(buf: ArrayU8, start: ArrayI, out: ArrayU8) -> None:
    """Fill (n, size) ``out`` with the bytes from each ``start`` on."""
    for i in range(start.size):
        for j in range(out.shape[1]):
            out[i, j] = buf[start[i] + j]


@njit(cache=True, nogil=True)
def _end_anpp(buf: ArrayU8, i: int) -> Any:
    """End of the packet whose header stands at ``i``; `_NOTHING`, or `_INCOMPLETE` if the header is cut."""
    if i + 5 > buf.size:
        return _INCOMPLETE
    if (np.int64(buf[i]) + buf[i + 1] + buf[i + 2] + buf[i + 3] + buf[i + 4]) & 0xFF != 0:
        return _NOTHING
    return i + 5 + np.int64(buf[i + 2])


@njit(cache=True, nogil=True)
def _end_sbp(buf: ArrayU8, i: int) -> Any:
    """End of the message whose preamble stands at ``i``, or `_NOTHING`; beyond the buffer if it is cut."""
    if buf[i] != 0x55:
        return _NOTHING
    if i + 6 > buf.size:
        return i + 8
    # 0x55 before a run of zeros passes the CRC; no message has type 0
    if buf[i + 1] == 0 and buf[i + 2] == 0:
        return _NOTHING
    return i + 8 + np.int64(buf[i + 5])


@njit(cache=True, nogil=True)
def _find(
    sbp: bool,
    buf: ArrayU8,
    start: int,
    base: int,
    final: bool,
    kind: AnyArray,
    sender: AnyArray,
    offset: ArrayI,
    length: AnyArray,
    tally: ArrayI,
    holes: ArrayI,
) -> tuple[int, int]:
    """Walk from ``start`` until the end or until the output is full; see `anpp_sbp_stream.Finder`.

    A header counts only with its check sum, so a false one never hides what follows: the search goes on one
    byte behind it. The library ``sbp`` goes on behind the whole frame instead, and so loses the sound frames
    that a false preamble covers.
    """
    i, k, n = start, 0, buf.size
    while k < kind.size and i < n:
        end = _end_sbp(buf, i) if sbp else _end_anpp(buf, i)
        if end == _INCOMPLETE:
            if not final:
                break
        elif end > n:
            if not final:
                break
            if tally[RUN_START] < 0:
                tally[CUT] += 1
        elif end != _NOTHING:
            if sbp:
                first, size = i + 6, end - i - 8
                crc, stated = crc16(buf, i + 1, end - 2, 0), end - 2
            else:
                first, size = i + 5, end - i - 5
                crc, stated = crc16(buf, first, end, 0xFFFF), i + 3
            if crc == (np.int64(buf[stated]) | np.int64(buf[stated + 1]) << 8):
                if sbp:
                    kind[k] = np.int64(buf[i + 1]) | np.int64(buf[i + 2]) << 8
                    sender[k] = np.int64(buf[i + 3]) | np.int64(buf[i + 4]) << 8
                else:
                    kind[k] = buf[i + 1]
                    sender[k] = 0
                offset[k] = first
                length[k] = size
                k += 1
                tally[RUN_START] = -1
                i = end
                continue
            if tally[RUN_START] < 0:
                tally[BAD_CRC] += 1
        _skip_byte(base + i, tally, holes)
        i += 1
    return k, i


find_anpp = partial(_find, False)
"""Packets: LRC over the header, CRC with start 0xFFFF over the payload."""

find_sbp = partial(_find, True)
"""Messages: preamble 0x55, CRC with start 0 over type to payload, a type that is not 0."""


def intact_bytes(head: bytes, *, sbp: bool) -> int:
    """Bytes inside the intact packets of the head of a file, of ANPP or SBP.

    As `_find` counts them, but nothing is compiled for it: the head of each unknown file is tried.

    Examples
    --------
    >>> intact_bytes(bytes.fromhex("00 ff 03 00 ff ff 00"), sbp=False)
    5
    """
    buf = np.frombuffer(head, dtype=np.uint8)
    at = buf == 0x55 if sbp else buf[:-4] + buf[1:-3] + buf[2:-2] + buf[3:-1] + buf[4:] == 0
    inside = done = 0
    for i in np.flatnonzero(at).tolist():
        if i < done or i + 6 > len(head) + (not sbp) or (sbp and head[i + 1 : i + 3] == b"\0\0"):
            continue
        if sbp:
            end = i + 8 + head[i + 5]
            crc, stated = crc_hqx(head[i + 1 : end - 2], 0), head[end - 2 : end]
        else:
            end = i + 5 + head[i + 2]
            crc, stated = crc_hqx(head[i + 5 : end], 0xFFFF), head[i + 3 : i + 5]
        if end <= len(head) and crc == int.from_bytes(stated, "little"):
            inside += end - i
            done = end
    return inside


CHUNK_BYTES: Final = 8 << 20
"""Bytes read at a time."""

MAX_HOLES: Final = 20
"""Damaged stretches that are located; the rest is only counted."""

Finder = Callable[..., tuple[int, int]]
"""``find(buf, start, base, final, kind, sender, offset, length, tally, holes) -> (packets, next byte)``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PacketBlock:
    """Packets found in one piece of the stream.

    Attributes
    ----------
    first : number of the first packet in the log, from 0.
    buf : bytes of the piece.
    kind, sender : (n,) packet id or message type; sender of SBP, 0 in ANPP.
    offset, length : (n,) payloads in ``buf``.
    position : (n,) byte of the stream (all files joined) at which the packet begins.
    """

    first: int
    buf: ArrayU8
    kind: AnyArray
    sender: AnyArray
    offset: ArrayI
    length: AnyArray
    position: ArrayI

    def payloads(self, rows: ArrayI, size: int) -> ArrayU8:
        """Payloads of some packets as (n, size) bytes; ``size`` must not exceed their lengths."""
        out = np.empty((rows.size, size), dtype=np.uint8)
        gather(self.buf, self.offset[rows], out)
        return out


@dataclass(slots=True, kw_only=True)
class StreamTally:
    """What the walk found besides the packets; complete when the iterator is exhausted."""

    files: list[Path] = field(default_factory=list)
    starts: list[int] = field(default_factory=list)
    """Byte of the stream at which each file begins."""
    sizes: list[int] = field(default_factory=list)
    packets: list[int] = field(default_factory=list)
    """Packets that begin in each file."""
    cells: ArrayI = field(default_factory=lambda: new_tally()[0])
    holes: ArrayI = field(default_factory=lambda: new_tally()[1])

    def place(self, position: int) -> str:
        """File and byte of a position in the stream, for messages."""
        index = max(0, int(np.searchsorted(self.starts, position, side="right")) - 1)
        return f"{self.files[index].name} byte {position - self.starts[index]:,}"

    def file_of(self, position: AnyArray) -> ArrayI:
        """Number of the file in which each position of the stream lies."""
        # of files that begin at the same byte all but the last are empty
        return np.searchsorted(self.starts, position, side="right").astype(np.int64) - 1

    def write(self, report: IntegrityReport, packet: str) -> None:
        """Put bytes, losses and their places into a report; ``packet`` is the format's word for one."""
        report.files = [str(f) for f in self.files]
        report.bytes_read = sum(self.sizes)
        report.count(f"{packet}s", sum(self.packets))
        for cell, name in (
            (SKIPPED, f"bytes_outside_{packet}s"),
            (BAD_CRC, f"{packet}s_with_wrong_checksum"),
            (CUT, f"{packet}s_cut_at_end"),
        ):
            report.lose(name, self.cells[cell])
        n = int(self.cells[HOLES])
        if n:
            named = ", ".join(
                f"{size:,} at {self.place(int(start))}" for start, size in self.holes[: min(n, 3)]
            )
            report.note(
                f"{int(self.cells[SKIPPED]):,} bytes in {n} stretch{'es' if n > 1 else ''} belong to no "
                f"intact {packet} ({named}{', ...' if n > 3 else ''}): damage or a cut; all around is kept."
            )
        for path, size in zip(self.files, self.sizes, strict=True):
            if size == 0:
                report.lose("empty_files")
                report.note(f"{path.name} is empty.")


@dataclass(frozen=True, slots=True, kw_only=True)
class Records:
    """Decoded packets of one kind.

    Attributes
    ----------
    fields : (n,) structured array.
    number : (n,) number of the packet in the log, from 0.
    sender : (n,) who sent it; 0 relays the base in SBP, and is everybody in ANPP.
    size : (n,) bytes of the payload.
    """

    fields: AnyArray
    number: ArrayI
    sender: ArrayI
    size: ArrayI

    def take(self, keep: ArrayB) -> "Records":
        """Some of the packets."""
        return Records(**{each.name: getattr(self, each.name)[keep] for each in fields(self)})


@dataclass(slots=True, kw_only=True)
class LogRecords:
    """All decoded packets of a log, and how many of which kind and sender there were.

    Parameters
    ----------
    layouts : of the payloads that are decoded, by kind.
    tails : kind -> bytes, of which any number of multiples may follow its layout.
    """

    layouts: Mapping[int, np.dtype[Any]]
    tails: Mapping[int, int]
    tally: StreamTally = field(default_factory=StreamTally)
    counts: Counter[tuple[int, int]] = field(default_factory=Counter)
    wrong_size: Counter[int] = field(default_factory=Counter)
    parts: dict[int, list[Records]] = field(default_factory=dict)

    def feed(self, block: PacketBlock) -> None:
        """Take in the packets of the next piece."""
        both = block.kind.astype(np.int64) << 16 | block.sender
        for value, n in zip(*np.unique(both, return_counts=True), strict=True):
            self.counts[int(value) >> 16, int(value) & 0xFFFF] += int(n)
        for kind in np.intersect1d(block.kind, list(self.layouts)).tolist():
            layout, rows = self.layouts[kind], np.flatnonzero(block.kind == kind)
            beyond, step = block.length[rows] - layout.itemsize, self.tails.get(kind)
            good = beyond == 0 if step is None else (beyond >= 0) & (beyond % step == 0)
            if not good.all():
                self.wrong_size[kind] += int((~good).sum())
            rows = rows[good]
            part = Records(
                fields=block.payloads(rows, layout.itemsize).view(layout)[:, 0],
                number=block.first + rows,
                sender=block.sender[rows].astype(np.int64),
                size=block.length[rows],
            )
            self.parts.setdefault(kind, []).append(part)

    def of(self, kind: int, sender: int | None = None) -> Records:
        """Packets of a kind (of one sender), maybe none."""
        parts = self.parts.get(kind, [])
        if len(parts) != 1:
            none = np.empty(0, dtype=np.int64)
            empty = Records(fields=np.empty(0, self.layouts[kind]), number=none, sender=none, size=none)
            parts = [*parts, empty]
            columns = {f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Records)}
            parts = self.parts[kind] = [Records(**columns)]
        return parts[0] if sender is None else parts[0].take(parts[0].sender == sender)


def new_tally() -> tuple[ArrayI, ArrayI]:
    """Cells and hole list for one walk."""
    cells = np.zeros(N_CELLS, dtype=np.int64)
    cells[RUN_START] = cells[RUN_END] = -1
    return cells, np.zeros((MAX_HOLES, 2), dtype=np.int64)


def find_in(
    buf: ArrayU8, find: Finder, tally: StreamTally, *, base: int = 0, final: bool = True, first: int = 0
) -> tuple[PacketBlock, int]:
    """Packets of one buffer and the number of bytes that are done with.

    Parameters
    ----------
    buf : (n,) bytes.
    find : compiled walk of the format.
    tally : takes what is outside of packets.
    base : position of ``buf[0]`` in the stream.
    final : nothing follows: an incomplete packet at the end is cut. Else it is left for the next call.
    first : number of the first packet.
    """
    if not (buf.flags.writeable and buf.flags.c_contiguous):
        buf = np.array(buf)  # compiled code knows one kind of array
    parts: list[tuple[AnyArray, ...]] = []
    room = min(1 << 17, buf.size // 5 + 1)
    done = 0
    while True:
        kind, sender = np.empty(room, np.uint16), np.empty(room, np.uint16)
        offset, length = np.empty(room, np.int64), np.empty(room, np.int64)
        k, done = find(buf, done, base, final, kind, sender, offset, length, tally.cells, tally.holes)
        parts.append((kind[:k], sender[:k], offset[:k], length[:k]))
        if k < room:
            break
    kind, sender, offset, length = (np.concatenate(column) for column in zip(*parts, strict=True))
    block = PacketBlock(
        first=first, buf=buf, kind=kind, sender=sender, offset=offset, length=length, position=offset + base
    )
    return block, done


def read_packets(
    files: Sequence[Path],
    find: Finder,
    tally: StreamTally,
    *,
    what: str,
    cure: str,
    chunk_bytes: int = CHUNK_BYTES,
) -> Iterator[PacketBlock]:
    """Walk through the files as one stream, piece by piece.

    Parameters
    ----------
    files : parts of one recording, in the order of recording.
    find : compiled walk of the format.
    tally : takes what is outside of packets.
    what : "ANPP packet" or "SBP message", for messages.
    cure : what to do about a wrong file.
    chunk_bytes : size of a piece.

    Raises
    ------
    InputError : no files, a file that cannot be read or holds no packet at all, or all files empty.
    """
    if not files:
        raise InputError(f"no files with {what}s", expected="at least one log", cure=cure)
    carry = np.empty(0, dtype=np.uint8)
    base = first = 0
    for number, path in enumerate(files):
        tally.files.append(path)
        tally.starts.append(base + carry.size)
        tally.sizes.append(0)
        tally.packets.append(0)
        head = b""
        for chunk, last in _chunks(path, chunk_bytes, cure):
            head = head or chunk[:8].tobytes()
            tally.sizes[-1] += chunk.size
            buf = np.concatenate([carry, chunk]) if carry.size else chunk
            final = last and number == len(files) - 1
            block, done = find_in(buf, find, tally, base=base, final=final, first=first)
            carry, base, first = buf[done:].copy(), base + done, first + block.kind.size
            for index, n in zip(*np.unique(tally.file_of(block.position), return_counts=True), strict=True):
                tally.packets[int(index)] += int(n)
            yield block
        if tally.sizes[-1] and not tally.packets[-1] and not _may_be_tail(tally, carry.size):
            raise InputError(
                f"not one intact {what} in {tally.sizes[-1]:,} bytes (the file begins with {head.hex(' ')})",
                expected=f"{what}s",
                where=path,
                cure=cure,
            )
    if not sum(tally.sizes):
        raise InputError("the file is empty", expected=f"{what}s", where=files[0], cure=cure)


def _may_be_tail(tally: StreamTally, carried: int) -> bool:
    """A last small file behind files with packets: the rest of a packet that was being written."""
    return len(tally.files) > 1 and sum(tally.packets) > 0 and tally.sizes[-1] <= 300 + carried


def _chunks(path: Path, size: int, cure: str) -> Iterator[tuple[ArrayU8, bool]]:
    """Pieces of a file, and whether each is the last; an empty file gives one empty piece."""
    try:
        with path.open("rb") as stream:
            chunk = np.fromfile(stream, np.uint8, size)
            while True:
                following = np.fromfile(stream, np.uint8, size if chunk.size == size else 0)
                yield chunk, not following.size
                if not following.size:
                    return
                chunk = following
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", where=path, cure=cure) from error
