"""A lidar without PPS: the time that the campaign file states."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from thalweg.core import gps_from_unix
from thalweg.ingest import LidarOptions
from thalweg.ingest.registry import lidar_reader
from thalweg.lidar import with_stated_clock
from thalweg.settings.sections import LidarClockStated

pytestmark = pytest.mark.real
NOON = 1_778_587_200.0
"""Unix time of 2026-05-12T12:00:00Z, by `date -u -d`."""


def recorded(folder, **options):
    """A reader of the capture in a folder, and what it scanned."""
    reader = lidar_reader([next(folder.glob("*.pcap"))], LidarOptions(**options))
    return reader, reader.scan()


def test_a_capture_without_gps_gets_the_stated_time(data_dir):
    reader, scan = recorded(data_dir / "vlp16_veloview", model="VLP-16")
    assert not scan.report.synchronised
    span = scan.report.t_last_s - scan.report.t_first_s
    stated = LidarClockStated(first_packet_utc="2026-05-12T12:00:00Z", offset_s=0.25)
    clock, report = with_stated_clock(reader, scan, stated)
    expected = float(gps_from_unix(NOON)) + 0.25
    assert report.synchronised
    assert report.t_first_s == pytest.approx(expected, abs=1e-6)
    assert report.t_last_s - report.t_first_s == pytest.approx(span, abs=1e-6)
    assert any("stated to be of 2026-05-12T12:00:00Z" in note for note in report.notes)
    first = next(iter(reader.points(clock, max_points=1000)))
    assert first.t_gps_s[0] == pytest.approx(expected, abs=2e-3)
    assert np.isfinite(first.t_gps_s).all()


@pytest.fixture
def timed(data_dir):
    """A capture with a time of its own."""
    return recorded(data_dir / "vlp16_mrpt_gps")


def test_an_offset_moves_a_capture_with_gps(timed):
    reader, scan = timed
    begin = scan.report.t_first_s
    clock, report = with_stated_clock(reader, scan, LidarClockStated(offset_s=-1.0))
    assert report.t_first_s == pytest.approx(begin - 1.0, abs=1e-9)
    assert_allclose(np.subtract(clock.gps_minus_device_s, scan.clock.gps_minus_device_s), -1.0, atol=1e-6)


def test_nothing_stated_changes_nothing(timed):
    reader, scan = timed
    assert with_stated_clock(reader, scan, LidarClockStated()) == (scan.clock, scan.report)


def test_a_source_of_time_that_is_not_needed_is_named(timed):
    reader, scan = timed
    clock, report = with_stated_clock(reader, scan, LidarClockStated(source="motion"))
    assert clock == scan.clock
    assert "lidar.clock.source: motion is not used: the log has a time of its own" in report.notes


def test_a_time_without_zone_is_refused():
    with pytest.raises(ValueError, match="names no zone"):
        LidarClockStated(first_packet_utc="2026-05-12T12:00:00")
