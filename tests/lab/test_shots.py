"""The truth of shots: whole packets, drawn at random where a recording is long."""

import numpy as np
import pytest

from thalweg.core import read_table
from thalweg_lab.instruments import LIDAR_SHOTS
from thalweg_lab.instruments.footprint import drawn_packets
from thalweg_lab.voyage import start_gps_s


@pytest.mark.parametrize("mode", ["strongest", "dual"])
def test_the_truth_of_long_recordings_is_that_of_whole_packets(record, monkeypatch, mode):
    every, _, config = record("every", lidar={"returns": mode, "divergence_mrad": 0.0}, duration_s=0.6)
    full, facts = read_table(every.with_suffix(".parquet"), LIDAR_SHOTS)
    assert facts["share"] == 1.0
    assert facts["packets_drawn"] == facts["packets_fired"]
    per = 12 if mode == "dual" else 24
    monkeypatch.setattr(
        "thalweg_lab.instruments.footprint.MANY_SHOTS", 0.3 * facts["packets_fired"] * per * 16
    )
    # Pieces end inside of what is drawn.
    monkeypatch.setattr("thalweg_lab.instruments.lidar._CHUNK", 100)
    some, _, _ = record("some", lidar={"returns": mode, "divergence_mrad": 0.0}, duration_s=0.6)
    part, facts = read_table(some.with_suffix(".parquet"), LIDAR_SHOTS)
    assert facts["share"] == pytest.approx(0.3)
    assert every.read_bytes() == some.read_bytes(), "the log knows nothing of the truth that is kept"
    # GPS times step by 0.12 us; the last shot of a packet ends 21 us before the next packet.
    packet = np.floor((full["t_gps_s"] - start_gps_s(config) + 1e-6) / (per * 55.296e-6)).astype(int)
    drawn, _ = drawn_packets(5, facts["packets_fired"], per * 16)
    assert facts["packets_drawn"] == drawn.sum()
    # Numbers of the same packets in the same order, and nothing of others.
    expected = full[drawn[packet]].reset_index(drop=True)
    assert 0.2 * len(full) < len(part) < 0.4 * len(full)
    assert part.equals(expected)
