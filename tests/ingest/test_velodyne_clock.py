"""GPS time of lidar packets: lock, hour, rollover, holes, and what is not synchronised."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.ingest import test_velodyne_log as log
from tests.ingest.writers import nmea
from thalweg.core import gps_from_unix
from thalweg.ingest import LidarClock
from thalweg.ingest.velodyne.clock import ClockBuilder, parse_rmc
from thalweg.ingest.velodyne.reader import iter_points, scan_lidar

HOUR = 1_700_000_000 // 3600 * 3600
GPS_HOUR = float(gps_from_unix(HOUR))


def packet_times(files):
    """GPS and device time of each packet's first firing; NaN where the packet gave no point."""
    scan = scan_lidar(files)
    n = scan.report.counts["data_packets"]
    gps, device = np.full(n, np.nan), np.full(n, np.nan)
    for b in iter_points(files, clock=scan.clock):
        first = np.unique(b.packet, return_index=True)[1]
        # the first point of a packet is some lasers after its stamp: 2.304 us each
        delay_s = b.laser[first] * 2.304e-6
        gps[b.packet[first]] = b.t_gps_s[first] - delay_s
        device[b.packet[first]] = b.t_device_s[first] - delay_s
    return gps, device, scan


@pytest.fixture
def times_of(tmp_path):
    """`packet_times` of one file of these frames."""
    return lambda frames: packet_times([log.save(tmp_path / "a", frames)])


def assert_gps(gps, stamps_us):
    """Equal to UTC of the stamps; 0.5 us is the rounding of the packet stamp, 0.12 us float64 there."""
    assert_allclose(gps - GPS_HOUR, np.asarray(stamps_us) * 1e-6, rtol=0, atol=0.7e-6)


@pytest.mark.parametrize(
    ("lag_s", "t0_us"),
    [
        (0.4, 5e6),
        (0.0, 1_800_000_000.0),
        (-0.2, 3_599_960_000.0),
        (1.2, 3_599_960_000.0),
        (0.4, 3_599_100_000.0),
        (-0.2, 3_600_000_100.0),
        (1.2, 3_600_000_100.0),
    ],
)
def test_hour_from_rmc_at_any_place_of_the_hour(times_of, lag_s, t0_us):
    stamps = log.times(100, t0_us)
    gps, device, scan = times_of(log.recording(stamps, hour_unix=HOUR, lag_s=lag_s))
    assert_gps(gps, stamps)
    assert (np.diff(device) > 0).all()
    assert scan.report.synchronised
    assert scan.report.time_scale == "utc"
    assert scan.report.clean
    assert scan.report.t_first_s == pytest.approx(GPS_HOUR + t0_us * 1e-6, abs=1e-6)
    assert scan.report.t_last_s == pytest.approx(GPS_HOUR + stamps[-1] * 1e-6, abs=1e-6)


def test_device_time_runs_on_over_the_hour(times_of):
    stamps = log.times(200, 3_599_900_000.0)
    gps, device, scan = times_of(log.recording(stamps, every=0))
    assert_allclose(device, np.rint(stamps) * 1e-6, rtol=0, atol=1e-9)
    assert np.isnan(gps).all()
    assert scan.report.notes == [
        "The lidar is unsynchronised: there are no position packets on UDP port 8308. Its points have no GPS "
        "time, t_device_s is the sensor's free-running clock."
    ]
    assert not scan.report.synchronised
    assert scan.report.time_scale == "device"
    assert scan.report.t_last_s == pytest.approx(stamps[-1] * 1e-6, abs=1e-6)


@pytest.mark.parametrize(
    ("state", "words"), [(0, "absent in 10"), (1, "synchronising in 10"), (3, "error in 10")]
)
def test_pps_that_is_never_locked(times_of, state, words):
    gps, _, scan = times_of(log.recording(log.times(100), hour_unix=HOUR, pps=lambda k: state))
    assert np.isnan(gps).all()
    assert not scan.report.synchronised
    assert (
        f"unsynchronised: the PPS was never locked ({words} of 10 position packets)" in scan.report.notes[0]
    )


@pytest.mark.parametrize(
    ("every", "start_us"), [(1, 2_000_000_000.0), (4, 3_598_500_000.0), (10, 12_345_678.0)]
)
def test_pps_acquired_late(times_of, every, start_us):
    utc = log.times(300, 1_234_567_890.0)
    toh = np.where(np.arange(300) < 150, start_us + utc - utc[0], utc)
    frames = log.recording(
        utc, hour_unix=HOUR, every=every, toh=toh, pps=lambda k: 2 if k >= 155 else 1 if k > 50 else 0
    )
    gps, _, scan = times_of(frames)
    first = next(k for k in range(155, 300) if k % every == every - 1) + 1
    assert np.isnan(gps[:first]).all()
    assert_gps(gps[first:], utc[first:])
    report = scan.report
    assert report.synchronised
    assert report.losses == {"unsynchronised_packets": first}
    assert not report.gaps  # the jump of the stamps is the setting of the clock
    assert sum("The sensor set its clock by" in n and "before packet 150," in n for n in report.notes) == 1
    assert any(n.startswith("Unsynchronised for ") and "PPS absent" in n for n in report.notes)
    assert any(f"to {first - 1}; PPS synchronising" in n for n in report.notes)
    assert report.t_first_s == pytest.approx(GPS_HOUR + utc[first] * 1e-6, abs=2e-3)


@pytest.mark.parametrize(
    ("ahead", "free_us"),
    [(0, 1_300_000_000.0), (1, 3_000_000_000.0), (3, 140_550_000.0), (3, 3_000_000_000.0)],
)
def test_locked_position_packet_before_the_first_data_packet_of_the_new_time(times_of, ahead, free_us):
    utc = log.times(100, 1_234_567_890.0)
    toh = np.where(np.arange(100) < 50, free_us + utc - utc[0], utc)
    frames = [log.ethernet(log.udp(row, 2368)) for row in log.data_packets(toh)]
    early = log.position_packet(toh[9] + 100, 1, log.rmc(HOUR + 1234))
    for k in (90, 70):
        state = log.position_packet(toh[k] + 100, 2, log.rmc(HOUR + 1234))
        frames.insert(k, log.ethernet(log.udp(state, 8308)))
    frames.insert(
        50 - ahead, log.ethernet(log.udp(log.position_packet(toh[50] - 50, 2, log.rmc(HOUR + 1234)), 8308))
    )
    frames.insert(10, log.ethernet(log.udp(early, 8308)))
    gps, _, scan = times_of(frames)
    assert np.isnan(gps[:50]).all()
    assert_gps(gps[50:], utc[50:])
    assert not scan.report.gaps
    assert scan.report.losses == {"unsynchronised_packets": 50}
    ends = np.rint(toh[[0, 49]]) * 1e-6
    assert any(f"from {ends[0]:.6f} to {ends[1]:.6f} s of device time" in n for n in scan.report.notes)
    assert scan.report.t_first_s == pytest.approx(GPS_HOUR + utc[50] * 1e-6, abs=2e-6)
    assert not any("No position packets" in n for n in scan.report.notes)
    assert scan.report.rates_hz["packets"] == pytest.approx(1e6 / 1327.104, rel=1e-4)


def test_hole_before_the_lock_is_a_hole(times_of):
    stamps = np.delete(log.times(300), np.arange(80, 85))
    frames = log.recording(stamps, hour_unix=HOUR, every=10, pps=lambda k: 2 if k >= 150 else 1)
    _, _, scan = times_of(frames)
    assert [g.lost for g in scan.report.gaps] == [5]
    assert not any("set its clock" in n for n in scan.report.notes)


def test_lock_lost_in_the_middle(times_of):
    stamps = log.times(300)
    frames = log.recording(stamps, hour_unix=HOUR, every=10, pps=lambda k: 3 if 100 <= k < 200 else 2)
    gps, _, scan = times_of(frames)
    good = np.r_[0:110, 210:300]
    assert_gps(gps[good], stamps[good])
    assert np.isnan(gps[110:210]).all()
    assert any("packets 110 to 209; PPS error" in n for n in scan.report.notes)
    assert any("Unsynchronised for 0.131 s, from 1.145" in n for n in scan.report.notes)


@pytest.mark.parametrize("pps", [0, 2])
@pytest.mark.parametrize("other_pps", [0, 2])
def test_position_packets_of_another_lidar_tell_nothing(times_of, pps, other_pps):
    """Two lidars of a boat send data to a port each, and both their position packets to the same one."""
    stamps = log.times(100)
    ahead = log.position_packet(stamps[0] + 5e5, other_pps, log.rmc(HOUR + 1.1))
    frames = []
    for frame in log.recording(stamps, hour_unix=HOUR, every=10, pps=lambda k: pps):
        other = log.udp(log.data_packets(stamps[:1])[0], 2369, sender=(192, 168, 1, 202))
        frames += [frame, log.ethernet(other)]
        frames.append(log.ethernet(log.udp(ahead, 8308, sender=(192, 168, 1, 202))))
    gps, _, scan = times_of(frames)
    assert_gps(gps, stamps if pps else np.full(100, np.nan))
    assert scan.report.counts["position_packets"] == 10
    assert scan.report.counts["position_packets_of_other_senders"] == 110
    assert any("110 payloads of the same size went to UDP port 2369" in n for n in scan.report.notes)


def test_first_position_packet_comes_late(times_of):
    stamps = log.times(6000)
    frames = log.recording(stamps, hour_unix=HOUR, every=5900)
    gps, _, scan = times_of(frames)
    # Its state holds for the 5 s before it; what lies further back is not known.
    known = stamps >= stamps[5899] - 5e6
    assert_gps(gps[known], stamps[known])
    assert np.isnan(gps[~known]).all()
    assert any("no position packet yet" in n for n in scan.report.notes)


def test_position_packets_before_the_first_data_packet(times_of):
    stamps = log.times(50, 3_600_000_050.0)
    early = [
        log.ethernet(log.udp(log.position_packet(3_599_999_000 + 300 * k, 2, log.rmc(HOUR + 3599.2)), 8308))
        for k in range(4)
    ]
    frames = early + log.recording(stamps, every=0)
    gps, _, _ = times_of(frames)
    assert_gps(gps, stamps)


@pytest.mark.parametrize(
    ("hours", "hole_us"), [(1, 0.0), (1, 3_500_000_000.0), (2, 700_000_000.0), (5, 3_500_000_000.0)]
)
def test_hole_longer_than_an_hour(tmp_path, hours, hole_us):
    a = log.times(100)
    b = log.times(100, a[-1] + 1327.104 + hole_us + hours * 3.6e9)
    files = [
        log.save(tmp_path / "a", log.recording(a, hour_unix=HOUR)),
        log.save(tmp_path / "b", log.recording(b, hour_unix=HOUR, seed=2)),
    ]
    gps, device, scan = packet_times(files)
    assert_gps(gps, np.concatenate([a, b]))
    assert_allclose(device, np.rint(np.r_[a, b]) * 1e-6, rtol=0, atol=1e-5)
    assert len(scan.report.gaps) == 1
    assert scan.report.gaps[0].duration_s == pytest.approx((b[0] - a[-1]) * 1e-6, abs=2e-3)
    assert not scan.report.losses.get("clock_set_back")
    assert scan.report.gaps[0].t_start_s == pytest.approx(GPS_HOUR + a[-1] * 1e-6, abs=2e-6)
    assert any("longer than the packet stamps can tell" in n for n in scan.report.notes)
    assert scan.report.t_last_s == pytest.approx(GPS_HOUR + b[-1] * 1e-6, abs=2e-6)
    if hole_us:  # in one file the stamps must tell where the hole is
        one = scan_lidar([log.save(tmp_path / "one", log.recording(np.r_[a, b], hour_unix=HOUR))]).report
        assert (one.t_first_s, one.t_last_s, one.gaps) == (
            scan.report.t_first_s, scan.report.t_last_s, scan.report.gaps
        )  # fmt: skip
    # a file out of order that lies in the hole shortens it
    early = log.times(50, b[0] - 80 * 1327.104)
    between = log.save(tmp_path / "between", log.recording(early, hour_unix=HOUR, seed=4))
    report = scan_lidar([*files, between]).report
    assert report.losses["files_out_of_order"] == 1
    assert [gap.lost for gap in report.gaps] == [scan.report.gaps[0].lost - 80, 30]
    # files before it in the wrong order, long or right before it, change nothing of it
    early = log.times(200, a[0] - 200 * 1327.104)
    for t, rest in ((early, files), (a, files[1:])):
        swapped = [
            log.save(tmp_path / f"half_{k}", log.recording(half, hour_unix=HOUR, seed=3))
            for k, half in enumerate(np.split(t, 2))
        ]
        report = scan_lidar([*swapped[::-1], *rest]).report
        assert report.losses["files_out_of_order"] == 1
        assert report.gaps == scan.report.gaps


@pytest.mark.parametrize(("hole_s", "known"), [(2, True), (20, False)])
def test_lock_is_not_taken_for_granted_over_a_long_hole(tmp_path, hole_s, known):
    a = log.times(100)
    b = log.times(100, a[-1] + hole_s * 1e6)
    files = [
        log.save(tmp_path / "a", log.recording(a, hour_unix=HOUR)),
        log.save(tmp_path / "b", log.recording(b, hour_unix=HOUR, pps=lambda k: 1)),
    ]
    gps, _, scan = packet_times(files)
    assert_gps(gps[:100], a)
    assert np.isfinite(gps[100:110]).all() == known
    assert np.isnan(gps[110:]).all()
    assert scan.report.losses["unsynchronised_packets"] == (90 if known else 100)


def test_holes_in_the_data_are_no_silence(monkeypatch):
    """A hole of 20 s and a jump of the clock on locking, 30 s after the last report: 4 s without one."""
    monkeypatch.setattr(ClockBuilder, "_lock", lambda *_: None)
    builder = ClockBuilder(last_report_t_us=1_000_000, unconfirmed_from=-1)
    builder._push(SimpleNamespace(first_packet=0, t_us=np.zeros(9, np.int64)), 0, math.nan, "")
    block = SimpleNamespace(first_packet=0, t_us=np.arange(9) * 1_000_000)
    builder._hole(block, 3, 20.0)
    builder.pending_s = 5.0
    builder._hole(block, 6, 6.0)
    assert builder.silence_s(31_000_000) == pytest.approx(4.0)
    assert (builder.clock_set, builder.jumps) == ({6}, [(3, 20.0)])


def test_sentence_that_is_damaged_stale_or_without_fix(times_of):
    stamps = log.times(200)
    frames = log.recording(stamps, hour_unix=HOUR, every=10)
    position = [k for k, f in enumerate(frames) if len(f) == 554]
    frames[position[3]] = frames[position[3]].replace(b"$GPRMC,22", b"$GPRMC,23")
    frames[position[5]] = log.ethernet(log.udp(log.position_packet(stamps[59], 2, b"$GPRMC,,V,,,,,,,"), 8308))
    gps, _, scan = times_of(frames)
    assert_gps(gps, stamps)  # the lock holds, the hour is known
    assert scan.report.losses["rmc_with_bad_checksum"] == 2
    assert scan.report.synchronised


@pytest.mark.parametrize(
    ("sentence", "why"),
    [
        (b"", "empty"),
        (log.rmc(HOUR, status="V"), "no fix"),
        (log.rmc(HOUR).replace(b"*", b"1*"), "bad checksum"),
        (log.rmc(HOUR + 600), "disagree by 599 s"),
    ],
)
def test_locked_pps_without_a_usable_hour(times_of, sentence, why):
    frames = log.recording(log.times(40), every=0)
    for k in (35, 25, 15, 5):
        stamp = 1_000_000 + 1327 * k
        frames.insert(k, log.ethernet(log.udp(log.position_packet(stamp, 2, sentence), 8308)))
    gps, _, scan = times_of(frames)
    assert np.isnan(gps).all()
    assert "unsynchronised: the PPS was locked, but no sentence named the hour" in scan.report.notes[0]
    assert why in scan.report.notes[0]
    assert scan.report.counts.get("rmc_not_of_this_second", 0) == (4 if "disagree" in why else 0)


def test_the_host_clock_plays_no_part(tmp_path):
    frames = log.recording(log.times(50), hour_unix=HOUR)
    (tmp_path / "a").write_bytes(log.pcap(frames))
    (tmp_path / "b").write_bytes(log.pcap(frames, t0=1_000_000_000.0))
    a, b = (np.concatenate([x.t_gps_s for x in iter_points([tmp_path / n])]) for n in "ab")
    assert np.array_equal(a, b)
    offset = scan_lidar([tmp_path / "b"]).report.details["host_minus_sensor_s"]
    assert offset == pytest.approx(1_000_000_000 - HOUR - 1.0, abs=1e-5)


@pytest.mark.parametrize(
    ("shift_s", "said"),
    [
        (1024 * 7 * 86400 + 0.4, "1024 weeks: the week counter of a receiver rolled over"),
        (7200.4, "+2:00 h: a time zone"),
        (1.4, ""),
    ],
)
def test_clocks_apart_by_no_clock_error_are_named(tmp_path, shift_s, said):
    """The clock of the capture is that far ahead of what RMC says, an hour of March 2004."""
    hour = HOUR - 1024 * 7 * 86400
    frames = log.recording(log.times(50), hour_unix=hour)
    (tmp_path / "a").write_bytes(log.pcap(frames, t0=hour + 1.0 + shift_s))
    notes = [n for n in scan_lidar([tmp_path / "a"]).report.notes if n.startswith("NMEA says ")]
    assert len(notes) == bool(said)
    assert not said or said in notes[0]
    if "1024" in said:
        assert "NMEA says 2004-03-30T" in notes[0]
        assert "true date is probably 2023-11-14: " in notes[0]  # HOUR; GPS - UTC was 13 s, then 18 s
        assert "set lidar.clock.offset_s to 619315205 " in notes[0]


def test_clock_survives_json():
    clock = LidarClock(first_packet=(0, 7), device_extra_s=(0.0, 3600.0), gps_minus_device_s=(math.nan, 5.0))
    again = LidarClock.from_dict(json.loads(json.dumps(clock.to_dict(), allow_nan=False)))
    packet = np.array([0, 6, 7, 9])
    assert np.array_equal(again.gps_time(packet, np.ones(4)), [np.nan, np.nan, 6.0, 6.0], equal_nan=True)
    assert np.array_equal(again.extra_s(packet), [0, 0, 3600, 3600])


def checked(body):
    return nmea(body.decode()).strip().encode()


@pytest.mark.parametrize(
    ("sentence", "unix_s", "why"),
    [
        (checked(b"GPRMC,081802.00,A,,,,,,,210116,,,A"), 1_453_364_282.0, ""),
        (checked(b"GNRMC,081802.25,A,,,,,,,210116,,,A"), 1_453_364_282.25, ""),
        (checked(b"GPRMC,081802,A,,,,,,,210116"), 1_453_364_282.0, ""),
        (checked(b"GPRMC,000000,A,,,,,,,290224"), 1_709_164_800.0, ""),
        (b"", math.nan, "empty"),
        (checked(b"GPGGA,081802,A,,,,,,,210116"), math.nan, "not RMC"),
        (checked(b"GPRMC,081802,V,,,,,,,210116"), math.nan, "no fix"),
        (checked(b"GPRMC,081802,A,,,,,,,"), math.nan, "no date"),
        (checked(b"GPRMC,,A,,,,,,,210116"), math.nan, "no date"),
        (checked(b"GPRMC,081802,A,,,,,,,310216"), math.nan, "no date"),
        (checked(b"GPRMC,081802,A,,,,,,,050180"), math.nan, "no date"),
        (checked(b"GPRMC,081802.x,A,,,,,,,210116"), math.nan, "no date"),
        (b"$GPRMC,081802,A,,,,,,,210116", math.nan, "bad checksum"),
        (b"\xff\xfe\x00*", math.nan, "bad checksum"),
        (checked(b",,,,,,,,,,,"), math.nan, "not RMC"),
        (b"," + checked(b"GPRMC,,,,,,,,,,,")[1:], math.nan, "not RMC"),
    ],
)
def test_rmc(sentence, unix_s, why):
    found, reason = parse_rmc(sentence)
    assert reason == why
    assert found == pytest.approx(unix_s, abs=0, nan_ok=True)
