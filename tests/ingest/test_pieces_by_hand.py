"""Tracks on maps epoch by epoch, and each kind of block at which a damaged capture goes on."""

import struct

import numpy as np
import pandas as pd
import pytest

from thalweg.ingest.pcap.capture import FOUND, find_pcapng
from thalweg.ingest.ppk.exports import _pieces


def test_each_epoch_of_a_track_is_on_the_map():
    """Four fixed, three float, two single ones: lines that meet, with longitude, latitude, height."""
    table = pd.DataFrame(
        {
            "fix": ["fixed"] * 4 + ["float"] * 3 + ["single"] * 2,
            "lon_deg": 13.0 + np.arange(9) / 100,
            "lat_deg": 51.0 + np.arange(9) / 1000,
            "h_ell_m": 100.0 + np.arange(9),
        }
    )
    places = [[13.0 + k / 100, 51.0 + k / 1000, 100.0 + k] for k in range(9)]
    found = _pieces(table)
    assert [fix for fix, _ in found] == ["fixed", "float", "other"]
    for (_, line), (a, b) in zip(found, ((0, 4), (3, 7), (6, 9)), strict=True):
        np.testing.assert_allclose(line, places[a:b], atol=1e-9)


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
