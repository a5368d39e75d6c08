from .stream import (
    CHUNK_BYTES as CHUNK_BYTES,
    PacketBlock as PacketBlock,
    StreamTally as StreamTally,
    find_anpp as find_anpp,
    find_in as find_in,
    find_sbp as find_sbp,
    read_packets as read_packets,
)
