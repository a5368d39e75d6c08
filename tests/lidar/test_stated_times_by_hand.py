"""Times that a person states for a lidar, sentences without PPS, and what a log's settings are made of."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.lidar.conftest import block_of
from tests.lidar.test_cloud import settings, still
from thalweg.calibration import resolve_mounts, write_mounts
from thalweg.core import ClockError, CoverageError, InputError, gps_from_unix
from thalweg.ingest import IntegrityReport, LidarClock
from thalweg.ingest.integrity import Gap
from thalweg.lidar import (
    CORRELATIONS,
    SIGMAS,
    LogSettings,
    clock as clock_module,
    cloud as cloud_module,
    with_stated_clock,
)
from thalweg.lidar.clock import LidarOffset, clock_by_hand, clock_from_sentences
from thalweg.lidar.cloud import cloud_covariance, sample_log
from thalweg.lidar.filters import Reason
from thalweg.settings.sections import Filters, LidarAccuracy, LidarClockStated

NOON = "2026-05-12T12:00:00Z"
NOON_GPS_S = float(gps_from_unix(1_778_587_200.0))
READER = SimpleNamespace(
    files=("a.pcap",), points=lambda *_, **__: iter([block_of(np.array([40.0, 41.0]), np.ones((2, 3)))])
)
"""Its first packet is of 40 s on the lidar's own clock."""
PARTLY = LidarClock(first_packet=(0, 5), device_extra_s=(0.0, 0.0), gps_minus_device_s=(np.nan, 1000.0))


def scan_of(clock: LidarClock, *, synchronised: bool, sentences=()) -> SimpleNamespace:
    report = IntegrityReport.of(
        "lidar", "a capture", [], synchronised=synchronised, t_first_s=40.0, t_last_s=90.0
    )
    report.gaps = [Gap(t_start_s=50.0, duration_s=1.0)]
    report.losses = {"unsynchronised_packets": 7, "bytes": 1}
    report.timing.unsynchronised_s = 50.0
    report.notes = ["The lidar is unsynchronised: no PPS", "another note"]
    return SimpleNamespace(report=report, clock=clock, sentences=sentences)


def test_a_first_packet_and_an_offset_that_are_stated():
    """Stretches with a time of their own keep it; an offset moves all."""
    found = clock_by_hand(READER, PARTLY, first_t_gps_s=500.0, offset_s=0.25)
    assert found.gps_minus_device_s == (460.25, 1000.25)
    assert (found.first_packet, found.device_extra_s) == ((0, 5), (0.0, 0.0))
    assert np.isnan(clock_by_hand(READER, PARTLY, offset_s=1.0).gps_minus_device_s[0])
    assert clock_by_hand(READER, PARTLY, offset_s=1.0).gps_minus_device_s[1] == 1001.0
    with pytest.raises(ClockError, match="the lidar never had GPS time"):
        clock_by_hand(READER, LidarClock(), offset_s=1.0)


@pytest.mark.parametrize("synchronised", [False, True])
def test_the_report_tells_what_was_stated(synchronised):
    scan = scan_of(PARTLY if synchronised else LidarClock(), synchronised=synchronised)
    stated = LidarClockStated(first_packet_utc=NOON, offset_s=0.5)
    clock, report = with_stated_clock(READER, scan, stated)
    shift = 0.5 if synchronised else NOON_GPS_S - 40.0 + 0.5
    assert clock.gps_minus_device_s[0] == pytest.approx(NOON_GPS_S - 40.0 + 0.5)
    assert (report.synchronised, report.time_scale) == (True, "utc")
    assert (report.t_first_s, report.t_last_s) == pytest.approx((40.0 + shift, 90.0 + shift))
    assert report.gaps[0].t_start_s == pytest.approx(50.0 + shift)
    assert report.notes[-1] == "All times of the lidar are shifted by +0.5 s (lidar.clock.offset_s)"
    if synchronised:
        assert report.losses == {"unsynchronised_packets": 7, "bytes": 1}
        assert report.notes[0].startswith("The lidar is unsynchronised")
        return
    told = f"No GPS time in the log: its first packet is stated to be of {NOON} (lidar.clock)"
    assert report.notes[:2] == ["another note", told]
    assert report.losses == {"bytes": 1}
    assert (report.timing.unsynchronised_s, report.timing.unsynchronised) == (0.0, [])


def test_what_is_stated_in_vain():
    """No time of a lidar without one, and a source that the log does not need."""
    nothing = scan_of(LidarClock(), synchronised=False)
    for stated in (LidarClockStated(), LidarClockStated(offset_s=0.5)):
        clock, report = with_stated_clock(READER, nothing, stated)
        assert (clock, report.synchronised, len(report.notes)) == (nothing.clock, False, 2)
    known = scan_of(PARTLY, synchronised=True)
    clock, report = with_stated_clock(READER, known, LidarClockStated(source="motion"))
    assert clock is known.clock
    assert report.notes[-1] == "lidar.clock.source: motion is not used: the log has a time of its own"
    bare = scan_of(PARTLY, synchronised=True)
    bare.report.t_first_s = None
    assert with_stated_clock(READER, bare, LidarClockStated(offset_s=0.5))[1].t_last_s == 90.0
    with pytest.raises(ClockError, match="no trajectory for the clock of the lidar"):
        with_stated_clock(READER, nothing, LidarClockStated(source="motion"))


def test_a_time_that_the_motion_tells(monkeypatch):
    """Sought near the stated first packet; what is found is shifted by the stated offset."""
    asked = {}

    def clock_from_motion(reader, clock, *voyage, near_s):
        asked.update(voyage=voyage, near_s=near_s)
        found = replace(clock, gps_minus_device_s=(700.0,), sigma_s=0.0123)
        return LidarOffset(
            clock=found, offset_s=700.0, drift=3e-6, reference_s=0.0, sigma_offset_s=0.01, sigma_drift=2e-6,
            facts={"planes": 5},
        )  # fmt: skip

    monkeypatch.setattr(clock_module, "clock_from_motion", clock_from_motion)
    scan = scan_of(LidarClock(), synchronised=False)
    stated = LidarClockStated(source="motion", first_packet_utc=NOON, offset_s=0.5)
    clock, report = with_stated_clock(READER, scan, stated, ("trajectory", "mount", "filters"))
    assert asked == {"voyage": ("trajectory", "mount", "filters"), "near_s": pytest.approx(NOON_GPS_S - 40.0)}
    assert (clock.gps_minus_device_s, clock.sigma_s) == ((700.5,), 0.0123)
    assert report.t_first_s == 740.5
    words = "No GPS time in the log: the motion of the boat tells it, with a standard deviation of 12 ms"
    assert report.notes[-1] == words
    assert report.details["clock"] == {
        "source": "motion",
        "sigma_s": 0.0123,
        "drift_ppm": pytest.approx(3.0),
        "sigma_drift_ppm": pytest.approx(2.0),
        "planes": 5,
    }
    with_stated_clock(
        READER, scan_of(LidarClock(), synchronised=False), LidarClockStated(source="motion"), (1, 2, 3)
    )
    assert asked["near_s"] is None


def test_the_soonest_sentence_of_each_minute():
    """Leads of 100 s less what each was late; the soonest of the second minute is 0.02 s later."""
    device = np.array([0.0, 20.0, 50.0, 61.0, 100.0, 200.0])
    late = np.array([0.3, 0.1, 0.2, 0.4, 0.12, 0.5])
    scan = scan_of(
        LidarClock(), synchronised=False, sentences=tuple(zip(device, device + 100.0 - late, strict=True))
    )
    stated = LidarClockStated(source="nmea", nmea_delay_s=0.25, sigma_nmea_delay_s=0.15)
    found = clock_from_sentences(READER, scan, stated)
    t, y = np.array([20.0, 100.0, 200.0]), 100.25 - np.array([0.1, 0.12, 0.5])
    # 0.05 s for each, and a quartz of so many ppm
    A = np.column_stack([np.ones(3), t - t.mean()]) / 0.05
    cov = np.linalg.inv(A.T @ A + np.diag([0.0, clock_module.SIGMA_DRIFT**-2]))
    x = cov @ A.T @ (y / 0.05)
    assert (found.offset_s, found.drift, found.reference_s) == pytest.approx((*x, t.mean()))
    assert found.sigma_offset_s == pytest.approx(np.hypot(np.sqrt(cov[0, 0]), 0.15))
    assert found.sigma_drift == pytest.approx(np.sqrt(cov[1, 1]))
    assert found.facts == {"sentences": 6, "latest_sentence_s": pytest.approx(0.4)}
    with pytest.raises(ClockError, match=r"a\.pcap: no NMEA sentence with a valid time"):
        clock_from_sentences(READER, scan_of(LidarClock(), synchronised=False), stated)


# ---------------------------------------------------------------- what a log is georeferenced with


def test_settings_of_a_survey_hold_its_mounts_errors_and_clock(tmp_path):
    place = {"lever_ics_m": [0.1, 0.2, 0.3], "sigma_lever_m": [0.01] * 3}
    turn = {f"{name}_deg": 10.0 for name in ("omega", "phi", "kappa")}
    lidar = place | turn | {f"sigma_{name}": 0.1 for name in turn}
    write_mounts(tmp_path / "m.json", resolve_mounts({"lidar": lidar, "antenna": place}, None))
    estimates = {"component": {"predictive": 2.0}, "footprint": {"predictive": 3.0}}
    (tmp_path / "e.json").write_text(json.dumps({"estimates": estimates}))
    accuracy = LidarAccuracy(sigma_component_m=0.01, sigma_time_s=3e-4)
    found = LogSettings.of_survey(
        tmp_path / "m.json", tmp_path / "e.json", LidarClock(sigma_s=4e-4), accuracy, Filters(),
        {"min_range_m": 1.5, "max_range_m": 60.0},
    )  # fmt: skip
    assert_allclose(found.mount.shift_m, [0.1, 0.2, 0.3])
    assert found.beam.sigma_component_m == pytest.approx(0.02)
    assert found.beam.footprint_share == pytest.approx(3 * accuracy.footprint_share)
    assert found.beam.sigma_time_s == pytest.approx(5e-4)
    assert (found.min_range_m, found.max_range_m, found.filters) == (1.5, 60.0, Filters())


def test_samples_of_spans_hold_what_lies_in_them():
    """Points each 0.1 s, every tenth too near: spans with their start, without their end."""
    t = 100.0 + np.arange(100) / 10
    xyz = np.column_stack([np.where(np.arange(100) % 10 == 0, 0.1, 1.0 + t - 100), 0 * t, 0 * t])
    blocks = [
        block_of(t[k], xyz[k], intensity=np.full(50, 9, np.uint8)) for k in (slice(50), slice(50, None))
    ]
    log = SimpleNamespace(points=lambda *_, max_points: iter(blocks))
    how = settings(max_range_m=50.0, filters={"isolated_neighbours": 0})
    spans = [(102.0, 4.0), (108.95, 0.1), (300.0, 1.0)]
    first, second, none = sample_log(log, None, still(90.0, 120.0), how, spans)
    inside = (t >= 102.0) & (t < 106.0) & (np.arange(100) % 10 > 0)
    assert_allclose(first.t_gps_s, t[inside])
    assert_allclose(first.xyz_wcs_m, xyz[inside], atol=1e-6)
    assert_allclose(first.range_m, xyz[inside, 0], rtol=1e-6)
    assert set(first.reflectivity) == {9.0}
    assert (len(second.t_gps_s), len(none.t_gps_s)) == (0, 0)
    some, *_ = sample_log(log, None, still(90.0, 120.0), how, spans, max_points=10)
    assert len(some.t_gps_s) == 10
    assert (np.diff(some.t_gps_s) > 0).all()
    assert set(some.t_gps_s) < set(first.t_gps_s)


def test_the_covariance_that_a_cloud_carries():
    cloud = dict(zip(SIGMAS, np.array([[0.1, 0.2], [0.2, 0.3], [0.3, 0.4]]), strict=True))
    cloud |= dict(zip(CORRELATIONS, np.array([[0.1, 0.0], [0.2, 0.5], [-0.3, 0.0]]), strict=True))
    found = cloud_covariance(cloud, "a.laz")
    assert_allclose(found[0], [[0.01, 0.002, 0.006], [0.002, 0.04, -0.018], [0.006, -0.018, 0.09]])
    assert_allclose(found[1], [[0.04, 0.0, 0.04], [0.0, 0.09, 0.0], [0.04, 0.0, 0.16]])
    del cloud[CORRELATIONS[1]]
    with pytest.raises(InputError, match=f"the cloud has no {CORRELATIONS[1]}"):
        cloud_covariance(cloud, "a.laz")


@pytest.mark.parametrize(
    ("most", "cure"),
    [
        (Reason.NO_POSE, "Look at streams.csv"),
        (Reason.NO_GPS_TIME, "Look at streams.csv"),
        (Reason.TOO_FAR, "Widen georeferencing.min_range_m"),
        (Reason.ISOLATED, "most points were left out as isolated"),
    ],
)
def test_a_cloud_of_no_points_says_what_took_them(most, cure):
    counts = np.ones(len(Reason), dtype=np.int64)
    counts[Reason.KEPT], counts[most] = 0, 5
    with pytest.raises(
        CoverageError, match=rf"a\.pcap: none of {counts.sum()} lidar points is left: .*{cure}"
    ):
        cloud_module._check_left(counts, ["a.pcap"])


def test_water_where_there_should_be_none_is_told(caplog):
    """More than a quarter of what is kept or wet."""
    counts = np.zeros(len(Reason), dtype=np.int64)
    counts[[Reason.KEPT, Reason.BELOW_WATER, Reason.MIRROR_GHOST, Reason.TOO_FAR]] = 75, 20, 5, 1000
    cloud_module._check_left(counts, [])
    assert not caplog.records
    counts[Reason.MIRROR_GHOST] = 7
    cloud_module._check_left(counts, [])
    assert "26 % of the points lie below the water level" in caplog.text
