"""Compiled walks over ANPP packets and SBP messages.

All of it stands in one module, for numba's cache follows edits of a kernel's own module only: what a kernel
takes from another module is frozen into its machine code.
"""

from functools import partial
from typing import Any, Final

import numpy as np
from numba import njit

from thalweg.core.types import AnyArray, ArrayI, ArrayU8

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
