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
from thalweg.ingest.velodyne.clock import ClockBuilder, clocks_apart, parse_rmc
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


# ---------------------------------------------------------------- limits of the clock, by hand


def block(t_s, *positions, first=0, marked=None):
    """Packets at these seconds; ``marked`` holds the step over a hole (event 5), or back (6), before one."""
    jump_us, event = np.zeros(len(t_s), np.int64), np.zeros(len(t_s), np.uint8)
    for k, jump_s in (marked or {}).items():
        jump_us[k - first], event[k - first] = round(jump_s * 1e6), 5 if jump_s > 0 else 6
    t_us = np.rint(np.array(t_s) * 1e6).astype(np.int64)
    return SimpleNamespace(first_packet=first, t_us=t_us, event=event, jump_us=jump_us, positions=positions)


def position(after, toh_s, rmc_s=None, pps=2, sentence=None):
    """A position packet at this second of the hour, whose sentence is of another one."""
    sentence = sentence if rmc_s is None else log.rmc(HOUR + rmc_s)
    return SimpleNamespace(after_packet=after, toh_us=round(toh_s * 1e6), pps=pps, sentence=sentence or b"")


def built(*blocks):
    builder = ClockBuilder()
    for each in blocks:
        builder.feed(each)
    return builder


@pytest.mark.parametrize(
    ("toh_s", "rmc_s", "lag_s"),
    [
        (100.4, 98, 2.4),
        (100.6, 98, None),
        (100.6, 103, 0.0),  # ahead of it
        (100.4, 103, None),
        (1.4, 3599, 2.4),  # over the hour
        (3599.0, 3601, 0.0),
    ],
)
def test_a_sentence_is_at_most_two_and_a_half_seconds_off(toh_s, rmc_s, lag_s):
    builder = built(block(toh_s - np.array([0.3, 0.2, 0.1]), position(3, toh_s, rmc_s)))
    clock = builder.finish()
    over = 3600 * (rmc_s >= 3599 and toh_s < 2)  # the hour that has begun
    if lag_s is None:
        assert np.isnan(clock.gps_minus_device_s).all()
        assert builder.counts["rmc_not_of_this_second"] == 1
    else:
        assert clock.first_packet == (0,)
        assert clock.gps_minus_device_s == (GPS_HOUR + over,)
        assert builder.worst_lag_s == pytest.approx(lag_s)
        assert "rmc_not_of_this_second" not in builder.counts


LOCKED_AT_10 = block([10.0, 10.1, 10.2], position(3, 10.25, 10))


@pytest.mark.parametrize(
    ("hole_s", "kept"), [(9.9, True), (10.1, False), (-0.5, False), (-0.001, False), (0.5, True)]
)
def test_a_hole_of_ten_seconds_and_a_step_back_leave_the_lock_open(hole_s, kept):
    behind = block(10.2 + hole_s + np.array([0.0, 0.1]), first=3, marked={3: hole_s})
    builder = built(LOCKED_AT_10, behind)
    clock = builder.finish()
    assert clock.gps_minus_device_s[0] == GPS_HOUR
    assert len(clock.first_packet) == (1 if kept else 2)
    if not kept:
        last = builder.stretches[-1]
        assert (last.first, last.why) == (3, "PPS state unknown after a hole")
        assert (last.before_us, last.t_us) == (10_200_000, 10_200_000 + round(hole_s * 1e6))
        assert np.isnan(clock.gps_minus_device_s[1])
        # a report within five seconds holds for what came before it, a later one for five seconds
        for late_s, first in ((0.15, 3), (4.95, 3)):
            at = 10.2 + hole_s + late_s
            more = block([at], position(6, at + 0.01, int(at)), first=5)
            again = built(LOCKED_AT_10, behind, more).finish()
            assert (again.first_packet, again.gps_minus_device_s) == ((0, first), (GPS_HOUR, GPS_HOUR))


@pytest.mark.parametrize(
    ("jump_s", "later_s", "is_set"),
    [(1.1, 1.0, True), (0.9, 1.0, False), (-0.3, 1.0, True), (1.1, 4.9, True), (1.1, 5.1, False)],
)
def test_a_jump_of_a_free_clock_before_the_lock_is_its_setting(jump_s, later_s, is_set):
    """By more than a second, or back, and within five seconds before the report of the lock."""
    free = block([1.0, 1.1, 1.2], position(3, 1.21, pps=1))
    t_s = 1.2 + jump_s + np.array([0.0, later_s])
    jumped = block(t_s, position(5, t_s[1] + 0.01, int(t_s[1])), first=3, marked={3: jump_s})
    builder = built(free, jumped)
    assert builder.clock_set == ({3} if is_set else set())
    assert builder.finish().gps_minus_device_s[-1] == GPS_HOUR


@pytest.mark.parametrize(("ahead_s", "first"), [(0.9, 4), (1.1, 6)])
def test_a_report_that_is_more_than_a_second_ahead_waits_for_its_packets(ahead_s, first):
    """These fired before the clock was set, and come later; so the new time begins with the jump."""
    free = block([1.0, 1.1, 1.2], position(3, 1.21, pps=0))
    more = block([1.3, 1.4, 1.5], position(4, 1.3 + ahead_s, int(1.3 + ahead_s)), first=3)
    jumped = block([1.5 + ahead_s], first=6, marked={6: 1.05})
    clock = built(free, more, jumped).finish()
    assert clock.first_packet == (0, first)
    assert clock.gps_minus_device_s[1] == GPS_HOUR


def test_reports_are_counted_by_state_and_what_is_wrong_with_them():
    stale, damaged = log.rmc(HOUR + 10), log.rmc(HOUR + 20).replace(b"5112", b"5113")
    builder = built(
        LOCKED_AT_10,
        block([20.5, 20.6], position(5, 20.65, sentence=stale), first=3),  # nothing new
        block(
            [20.7, 20.8, 20.9],
            position(6, 20.71, pps=4),
            position(6, 3600.0),
            position(6, 20.75, sentence=b""),
            position(7, 20.85, sentence=damaged),
            first=5,
        ),
    )
    assert builder.finish().gps_minus_device_s == (GPS_HOUR,)
    assert builder.counts == {
        "position_packets": 6, "position_packets_damaged": 2, "pps_locked": 4, "rmc_empty": 1,
        "rmc_bad_checksum": 1, "rmc_not_of_this_second": 1,
    }  # fmt: skip
    builder.feed(block([21.0, 21.1], position(10, 21.15, 620), first=8))
    assert builder.stretches[-1].why == "RMC and packet stamps disagree by 599 s"
    assert builder.finish().first_packet == (0, 10)
    builder.feed(block([21.2], position(11, 21.25, 620), first=10))
    assert builder.finish().first_packet == (0, 10)  # the same once more


def test_sentences_without_a_pps_are_kept_once():
    one, two = log.rmc(HOUR + 5), log.rmc(HOUR + 6)
    builder = built(
        block(
            [700.0, 701.0, 702.0, 703.0],
            *(
                position(k + 1, 700.25 + k, sentence=sentence, pps=0)
                for k, sentence in enumerate((one, one, two, log.rmc(HOUR, status="V")))
            ),
        )
    )
    assert builder.sentences == [(700.25, GPS_HOUR + 5), (702.25, GPS_HOUR + 6)]
    assert builder.stretches[-1].why == "PPS absent"


def test_the_longest_silence_counts_up_to_now():
    """Reports at 1 s and at 31 s, with a hole of 20 s between them; then none up to 50 s."""
    builder = built(
        block([1.0, 2.0], position(1, 1.0, 1)),
        block([25.0, 31.0], position(4, 31.1, 31), first=2, marked={2: 20.0}),
    )
    assert builder.silence_s(31_000_000) == pytest.approx(10.0)
    assert builder.silence_s(50_000_000) == pytest.approx(19.0)
    assert ClockBuilder().silence_s(50_000_000) == 0.0


def test_clocks_within_ten_seconds_are_no_matter():
    t = float(gps_from_unix(HOUR))
    assert clocks_apart(1.0, t) == clocks_apart(9.0, t) == ""
    assert clocks_apart(7200.0, t) == (
        "NMEA says 2023-11-14T22:00:00Z, the clock of the capture 2023-11-15T00:00:00Z: +2:00 h: a time zone"
        ". Times follow NMEA."
    )
