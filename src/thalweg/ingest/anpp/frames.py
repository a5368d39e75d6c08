"""Framing of the Advanced Navigation Packet Protocol.

A packet is LRC, id, length, CRC (two bytes, low first) and up to 255 bytes of payload. The LRC is the two's
complement of the sum of the other four header bytes; the CRC is CRC16-CCITT-FALSE (polynomial 0x1021, start
0xFFFF) over the payload (Advanced Navigation, Spatial Reference Manual, "Packet Protocol").
"""

from thalweg.core.types import ArrayU8
from thalweg.ingest.framing.stream import PacketBlock, StreamTally, find_in
from thalweg.ingest.framing.walk import crc16, find_anpp

__all__ = ["crc16", "find_anpp", "find_packets"]


def find_packets(buf: ArrayU8, tally: StreamTally | None = None) -> PacketBlock:
    """All intact packets of a buffer.

    Parameters
    ----------
    buf : (n,) bytes; cut packets at either end are left out.
    tally : takes the bytes outside of packets.

    Examples
    --------
    >>> import numpy as np
    >>> found = find_packets(np.frombuffer(bytes.fromhex("00 9b 03 01 ff ff 00"), np.uint8))
    >>> found.kind.tolist(), found.length.tolist(), found.offset.tolist()
    ([], [], [])
    >>> found = find_packets(np.frombuffer(bytes.fromhex("00 ff 03 00 ff ff 00"), np.uint8))
    >>> found.kind.tolist(), found.length.tolist(), found.offset.tolist()
    ([3], [0], [6])
    """
    block, _ = find_in(buf, find_anpp, StreamTally() if tally is None else tally)
    return block
