"""A lidar without PPS: the time that the campaign file states."""

import numpy as np
import pytest

from thalweg.core import gps_from_unix
from thalweg.ingest import LidarOptions
from thalweg.ingest.registry import lidar_reader
from thalweg.lidar import with_stated_clock
from thalweg.settings.sections import LidarClockStated

pytestmark = pytest.mark.real
NOON = 1_778_587_200.0
"""Unix time of 2026-05-12T12:00:00Z, by `date -u -d`."""


def test_a_capture_without_gps_gets_the_stated_time(data_dir):
    log = next((data_dir / "vlp16_veloview").glob("*.pcap"))
    reader = lidar_reader([log], LidarOptions(model="VLP-16"))
    scan = reader.scan()
    assert not scan.report.synchronised
    span = scan.report.t_last_s - scan.report.t_first_s
    clock, report = with_stated_clock(
        reader, scan, LidarClockStated(first_packet_utc="2026-05-12T12:00:00Z", offset_s=0.25)
    )
    assert report.synchronised
    assert report.t_first_s == pytest.approx(float(gps_from_unix(NOON)) + 0.25, abs=1e-6)
    assert report.t_last_s - report.t_first_s == pytest.approx(span, abs=1e-6)
    assert any("stated to be of 2026-05-12T12:00:00Z" in note for note in report.notes)
    first = next(iter(reader.points(clock, max_points=1000)))
    assert first.t_gps_s[0] == pytest.approx(float(gps_from_unix(NOON)) + 0.25, abs=2e-3)
    assert np.isfinite(first.t_gps_s).all()


def test_an_offset_moves_a_capture_with_gps(data_dir):
    log = next((data_dir / "vlp16_mrpt_gps").glob("*.pcap"))
    reader = lidar_reader([log], LidarOptions())
    scan = reader.scan()
    before = scan.clock
    begin = scan.report.t_first_s
    clock, report = with_stated_clock(reader, scan, LidarClockStated(offset_s=-1.0))
    assert report.t_first_s == pytest.approx(begin - 1.0, abs=1e-9)
    np.testing.assert_allclose(clock.gps_minus_device_s, np.array(before.gps_minus_device_s) - 1.0, atol=1e-9)


def test_nothing_stated_changes_nothing(data_dir):
    log = next((data_dir / "vlp16_mrpt_gps").glob("*.pcap"))
    reader = lidar_reader([log], LidarOptions())
    scan = reader.scan()
    assert with_stated_clock(reader, scan, LidarClockStated()) == (scan.clock, scan.report)


def test_a_source_of_time_that_is_not_needed_is_named(data_dir):
    log = next((data_dir / "vlp16_mrpt_gps").glob("*.pcap"))
    reader = lidar_reader([log], LidarOptions())
    scan = reader.scan()
    clock, report = with_stated_clock(reader, scan, LidarClockStated(source="motion"))
    assert clock == scan.clock
    assert "lidar.clock.source: motion is not used: the log has a time of its own" in report.notes


def test_a_time_without_zone_is_refused():
    with pytest.raises(ValueError, match="names no zone"):
        LidarClockStated(first_packet_utc="2026-05-12T12:00:00")
