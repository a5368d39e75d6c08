from .capture import (
    CHUNK_BYTES as CHUNK_BYTES,
    BarePayloads as BarePayloads,
    CaptureTally as CaptureTally,
    PayloadBlock as PayloadBlock,
    Stream as Stream,
    read_payloads as read_payloads,
)
