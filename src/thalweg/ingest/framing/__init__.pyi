from .stream import (
    CHUNK_BYTES as CHUNK_BYTES,
    SKIPPED as SKIPPED,
    LogRecords as LogRecords,
    PacketBlock as PacketBlock,
    Records as Records,
    StreamTally as StreamTally,
    find_anpp as find_anpp,
    find_in as find_in,
    find_sbp as find_sbp,
    gather as gather,
    intact_bytes as intact_bytes,
    read_packets as read_packets,
)
