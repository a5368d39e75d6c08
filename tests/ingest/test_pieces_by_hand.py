"""Tracks on maps epoch by epoch, and each kind of block at which a damaged capture goes on."""

import struct

import numpy as np
import pytest

from thalweg.ingest.pcap.capture import FOUND, find_pcapng


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize(
    ("kind", "found"),
    [(0x0A0D0D0A, True), (1, True), (2, True), (3, True), (6, True), (4, False), (5, False), (7, False)],
)
def test_a_capture_goes_on_at_blocks_of_packets_interfaces_and_sections(kind, found, big):
    order = ">" if big else "<"
    block = struct.pack(order + "II", kind, 20) + bytes(8) + struct.pack(order + "I", 20)
    data = np.frombuffer(b"\x99" * 6 + block, dtype=np.uint8)
    status, at = getattr(find_pcapng, "py_func", find_pcapng)(data, len(data), 0, big, True)
    assert (status == FOUND, at == 6) == ((True, True) if found else (False, False))
