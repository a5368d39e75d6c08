"""Framing of the Advanced Navigation Packet Protocol.

A packet is LRC, id, length, CRC (two bytes, low first) and up to 255 bytes of payload. The LRC is the two's
complement of the sum of the other four header bytes; the CRC is CRC16-CCITT-FALSE (polynomial 0x1021, start
0xFFFF) over the payload (Advanced Navigation, Spatial Reference Manual, "Packet Protocol").
"""

import numpy as np
from numba import njit

from thalweg.core.types import AnyArray, ArrayI, ArrayU8
from thalweg.ingest.anpp_sbp_stream import (
    BAD_CRC,
    CUT,
    RUN_START,
    PacketBlock,
    StreamTally,
    find_in,
    skip_byte,
)

__all__ = ["crc16", "find_anpp", "find_packets"]


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
def find_anpp(
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

    A header counts only with its payload's CRC, so a false one never hides what follows: the search goes on
    one byte behind it.
    """
    i, k, n = start, 0, buf.size
    while k < kind.size:
        if i + 5 > n:
            if not final:
                break
            while i < n:
                skip_byte(base + i, tally, holes)
                i += 1
            break
        if (np.int64(buf[i]) + buf[i + 1] + buf[i + 2] + buf[i + 3] + buf[i + 4]) & 0xFF == 0:
            size = int(buf[i + 2])
            end = i + 5 + size
            if end > n:
                if not final:
                    break
                if tally[RUN_START] < 0:
                    tally[CUT] += 1
            elif crc16(buf, i + 5, end, 0xFFFF) == (np.int64(buf[i + 3]) | np.int64(buf[i + 4]) << 8):
                kind[k] = buf[i + 1]
                sender[k] = 0
                offset[k] = i + 5
                length[k] = size
                k += 1
                tally[RUN_START] = -1
                i = end
                continue
            elif tally[RUN_START] < 0:
                tally[BAD_CRC] += 1
        skip_byte(base + i, tally, holes)
        i += 1
    return k, i


def find_packets(buf: ArrayU8, tally: StreamTally | None = None) -> PacketBlock:
    """All intact packets of a buffer.

    Parameters
    ----------
    buf : (n,) bytes; cut packets at either end are left out.
    tally : takes the bytes outside of packets.

    Examples
    --------
    >>> found = find_packets(np.frombuffer(bytes.fromhex("00 9b 03 01 ff ff 00"), np.uint8))
    >>> found.kind.tolist(), found.length.tolist(), found.offset.tolist()
    ([], [], [])
    >>> found = find_packets(np.frombuffer(bytes.fromhex("00 ff 03 00 ff ff 00"), np.uint8))
    >>> found.kind.tolist(), found.length.tolist(), found.offset.tolist()
    ([3], [0], [6])
    """
    block, _ = find_in(buf, find_anpp, StreamTally() if tally is None else tally)
    return block
