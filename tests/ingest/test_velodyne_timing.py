"""The clock of a lidar recording in numbers: PPS, jitter, capture host, free-running drift."""

import numpy as np
import pytest

from tests.ingest import test_velodyne_log as log
from thalweg.core import gps_from_unix
from thalweg.ingest.velodyne.reader import scan_lidar

HOUR = 1_700_000_000 // 3600 * 3600
GPS_HOUR = float(gps_from_unix(HOUR))
STEP_S = 1327.104e-6


def timing_of(path, frames, **more):
    path.write_bytes(log.pcap(frames, **more))
    return scan_lidar([path]).report.timing


def test_a_locked_recording(tmp_path):
    # the capture begins 1.25 s late and its clock is 200 ppm slow
    frames = log.recording(log.times(3000), hour_unix=HOUR, every=100)
    step_s = STEP_S * 3000 / len(frames) * (1 - 200e-6)
    timing = timing_of(tmp_path / "a", frames, t0=HOUR + 2.25, step_s=step_s)
    assert timing.period_s == pytest.approx(STEP_S, abs=1e-8)
    # stamps in whole microseconds: 1327 or 1328
    assert timing.jitter_s < 1e-6
    assert timing.jitter_max_s < 1e-6
    assert timing.resolution_s == 1e-6
    assert (timing.pps_locked_share, timing.pps_unlocked_start_s, timing.pps_losses) == (1.0, 0.0, 0)
    assert (timing.unsynchronised_s, timing.unsynchronised) == (0.0, [])
    assert timing.clock == "host"
    # half of 4 s at 200 ppm; position packets take a slot of the capture each: 1 % of 1.3 ms times 100
    assert timing.clock_offset_s == pytest.approx(1.25 - 0.0004, abs=1e-3)
    assert timing.clock_drift_ppm == pytest.approx(-200.0, abs=5 * timing.sigma_clock_drift_ppm)
    assert timing.sigma_clock_drift_ppm < 100


@pytest.mark.parametrize("start_us", [12_345_678.0, 2_000_000_000.0])
def test_a_late_pps_leaves_a_known_hole_at_the_beginning(tmp_path, start_us):
    """The clock is set at packet 150, and the first report of the lock comes later: no jump is counted."""
    utc = log.times(300, 1_234_567_890.0)
    toh = np.where(np.arange(300) < 150, start_us + utc - utc[0], utc)
    frames = log.recording(utc, hour_unix=HOUR, every=10, toh=toh, pps=lambda k: 2 if k >= 155 else 1)
    timing = timing_of(tmp_path / "a", frames)
    free_s = 160 * STEP_S
    assert timing.unsynchronised_s == pytest.approx(free_s, abs=2 * STEP_S)
    ((begin, end),) = timing.unsynchronised
    assert end == pytest.approx(GPS_HOUR + utc[160] * 1e-6, abs=1e-5)
    assert end - begin == pytest.approx(free_s, abs=2 * STEP_S)
    assert timing.pps_unlocked_start_s == pytest.approx(free_s, abs=2 * STEP_S)
    assert timing.pps_locked_share == pytest.approx(140 / 300, abs=0.01)
    assert timing.pps_losses == 0


def test_a_pps_that_is_lost_and_comes_back(tmp_path):
    utc = log.times(400, 1_234_567_890.0)
    frames = log.recording(utc, hour_unix=HOUR, pps=lambda k: 3 if 100 <= k < 250 else 2)
    timing = timing_of(tmp_path / "a", frames)
    assert timing.pps_losses == 1
    assert timing.pps_unlocked_start_s == 0.0
    ((begin, end),) = timing.unsynchronised
    # reports come every ten packets, behind packets 109 and 259
    assert begin == pytest.approx(GPS_HOUR + utc[109] * 1e-6, abs=2e-3)
    assert end == pytest.approx(GPS_HOUR + utc[260] * 1e-6, abs=2e-3)


def test_without_position_packets_nothing_is_known_of_the_pps(tmp_path):
    timing = timing_of(tmp_path / "a", log.recording(log.times(100), every=0))
    assert timing.pps_locked_share is None
    assert timing.unsynchronised_s == pytest.approx(99 * STEP_S, abs=1e-5)
    assert timing.unsynchronised == []


def test_the_drift_of_a_free_running_sensor_against_the_host(tmp_path):
    n = 4000
    toh = log.times(n) * (1 + 50e-6)
    frames = log.recording(log.times(n), every=0, toh=toh)
    (tmp_path / "a").write_bytes(log.pcap(frames, t0=HOUR + 1.0, step_s=STEP_S))
    details = scan_lidar([tmp_path / "a"]).report.details
    # 5 s of stamps in microseconds: 0.1 ppm
    assert details["free_running_drift_ppm"] == pytest.approx(50.0, abs=1.0)
    assert details["free_running_drift_sigma_ppm"] < 1.0
