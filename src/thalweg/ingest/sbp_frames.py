"""Framing of the Swift Binary Protocol.

A frame is 0x55, type u16, sender u16, length u8, payload and CRC16-CCITT (polynomial 0x1021, start 0) over
type to payload, all little endian (Swift Navigation, SBP specification, "Message framing").
"""

import numpy as np
from numba import njit

from thalweg.core.types import AnyArray, ArrayI, ArrayU8
from thalweg.ingest.anpp_frames import crc16
from thalweg.ingest.anpp_sbp_stream import (
    BAD_CRC,
    CUT,
    RUN_START,
    PacketBlock,
    StreamTally,
    find_in,
    skip_byte,
)

__all__ = ["find_messages", "find_sbp"]


@njit(cache=True, nogil=True)
def find_sbp(
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

    After a frame with a wrong CRC the search goes on one byte behind its preamble. The library ``sbp`` goes
    on behind the whole frame instead, and so loses the sound frames that a false preamble covers.
    """
    i, k, n = start, 0, buf.size
    while k < kind.size and i < n:
        if buf[i] == 0x55:
            size = int(buf[i + 5]) if i + 6 <= n else 0
            end = i + 8 + size
            if end > n:
                if not final:
                    break
                if tally[RUN_START] < 0:
                    tally[CUT] += 1
            elif crc16(buf, i + 1, end - 2, 0) == (np.int64(buf[end - 2]) | np.int64(buf[end - 1]) << 8):
                kind[k] = np.int64(buf[i + 1]) | np.int64(buf[i + 2]) << 8
                sender[k] = np.int64(buf[i + 3]) | np.int64(buf[i + 4]) << 8
                offset[k] = i + 6
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


def find_messages(buf: ArrayU8, tally: StreamTally | None = None) -> PacketBlock:
    """All intact messages of a buffer.

    Parameters
    ----------
    buf : (n,) bytes; cut messages at either end are left out.
    tally : takes the bytes outside of messages.

    Examples
    --------
    >>> raw = bytes.fromhex("55 0b 01 d3 88 07 28 f4 7a 13 03 00 01")  # a frame cut in its payload
    >>> find_messages(np.frombuffer(raw, np.uint8)).kind.size
    0
    """
    block, _ = find_in(buf, find_sbp, StreamTally() if tally is None else tally)
    return block
