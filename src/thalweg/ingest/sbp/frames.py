"""Framing of the Swift Binary Protocol.

A frame is 0x55, type u16, sender u16, length u8, payload and CRC16-CCITT (polynomial 0x1021, start 0) over
type to payload, all little endian (Swift Navigation, SBP specification, "Message framing"). No message has
type 0.
"""

from thalweg.core.types import ArrayU8
from thalweg.ingest.framing.stream import PacketBlock, StreamTally, find_in
from thalweg.ingest.framing.walk import find_sbp

__all__ = ["find_messages", "find_sbp"]


def find_messages(buf: ArrayU8, tally: StreamTally | None = None) -> PacketBlock:
    """All intact messages of a buffer.

    Parameters
    ----------
    buf : (n,) bytes; cut messages at either end are left out.
    tally : takes the bytes outside of messages.

    Examples
    --------
    >>> import numpy as np
    >>> raw = bytes.fromhex("55 0b 01 d3 88 07 28 f4 7a 13 03 00 01")  # a frame cut in its payload
    >>> find_messages(np.frombuffer(raw, np.uint8)).kind.size
    0
    """
    block, _ = find_in(buf, find_sbp, StreamTally() if tally is None else tally)
    return block
