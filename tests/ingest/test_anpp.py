"""The ANPP reader on synthetic logs: clock, tables, files that overlap."""

import datetime as dt
import struct
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.ingest.writers import anpp, files_of, noted
from thalweg.core import gps_from_unix, read_table, write_table
from thalweg.ingest import DEPTH, GNSS_POSITION, INS_STATE, PoseLog
from thalweg.ingest.anpp import read_anpp

T0 = 1_494_614_695  # 2017-05-12T18:44:55 UTC
UTC_FIXED = 0x8 | 7 << 4 | 0x7
NO_UTC = 0x1


def state(
    t_us: int, *, filter_status: int = UTC_FIXED, system: int = 0, rpy: Sequence[float] = (0.1, -0.2, 0.3)
) -> bytes:
    t = T0 * 1_000_000 + t_us
    numbers = [0.5, -0.25, 0.125, 1, 2, 3, 9.5, *rpy, 0.01, 0.02, 0.03, 0.02, 0.03, 0.05]
    head = struct.pack("<HHII3d", system, filter_status, t // 10**6, t % 10**6, 0.9, 0.23, 150.25)
    return anpp(20, head + struct.pack("<16f", *numbers))


def depth(value: float = 1.0) -> bytes:
    return anpp(53, struct.pack("<2f", value, 0.1))


def gnss(t_us: int, flags: int = 7 | 1 << 4) -> bytes:
    t = T0 * 1_000_000 + t_us
    head = struct.pack("<II3d", t // 10**6, t % 10**6, 0.9, 0.23, 151.0)
    return anpp(29, head + struct.pack("<10fH", 1, 2, 3, 0.02, 0.01, 0.04, 0, 0, 0, 0, flags))


@pytest.fixture
def read(tmp_path):
    """Reads a log of these contents."""

    def made(*logs: bytes) -> PoseLog:
        return read_anpp(files_of(tmp_path, *logs))

    return made


def test_state_with_utc_is_on_the_gps_axis(read):
    log = read(b"".join(state(k * 100_000) for k in range(5)))
    t = log.states["t_gps_s"].to_numpy()
    # 60 ns is the resolution of adjusted GPS time in float64
    assert_allclose(t, 178_649_913.0 + np.arange(5) * 0.1, atol=6e-8)
    expected = np.float32([0.125, 0.3, 0.02, 0.03, np.nan])
    names = ["v_down_mps", "heading_rad", "sigma_north_m", "sigma_east_m", "sigma_roll_rad"]
    assert_array_equal(log.states[names].iloc[0], expected.astype(float))
    assert log.states[["lat_deg", "fix"]].iloc[0].tolist() == [np.rad2deg(0.9), "fixed"]
    assert (log.report.synchronised, log.report.time_scale, log.report.clean) == (True, "utc", True)


def test_tables_fit_their_kinds(tmp_path, read):
    log = read(state(0) + gnss(0) + depth())
    empty = read(anpp(49, bytes(8)))
    for n, found in ((1, log), (0, empty)):
        kinds = {INS_STATE: found.states, GNSS_POSITION: found.positions, DEPTH: found.depths}
        for kind, table in kinds.items():
            write_table(tmp_path / "t.parquet", table, kind)
            assert len(read_table(tmp_path / "t.parquet", kind)[0]) == n
    assert noted(empty, "no packet with a time")
    assert '"packets": 1' in empty.report.to_json()


@pytest.mark.parametrize(
    ("heading", "expected"), [(-0.5, 2 * np.pi - 0.5), (7.0, 7.0 - 2 * np.pi), (-1e-30, 0.0), (0.0, 0.0)]
)
def test_heading_is_in_one_turn(heading, expected, read):
    log = read(state(0, rpy=(0, 0, heading)))
    # float32 in the packet
    assert log.states["heading_rad"][0] == pytest.approx(expected, abs=5e-7)
    assert 0 <= log.states["heading_rad"][0] < 2 * np.pi


FIXES = "none 2d 3d sbas dgnss omnistar float fixed"


@pytest.mark.parametrize(("bits", "word"), [*enumerate(FIXES.split())])
def test_fix_words(bits, word, read):
    assert read(state(0, filter_status=8 | bits << 4)).states["fix"][0] == word


def test_before_utc_there_is_no_gps_time(read):
    boot = -T0 * 1_000_000  # the device counts from 1970 until it knows better
    data = b"".join(state(boot + k * 100_000, filter_status=NO_UTC) + depth() for k in range(3))
    never = read(data).report
    assert (never.synchronised, never.time_scale) == (False, "device")
    assert noted(never, "UTC was never initialised: all 3 states")
    data += b"".join(state(k * 100_000) + depth() for k in range(4))
    log = read(data)
    assert log.states["t_gps_s"].isna().tolist() == [True] * 3 + [False] * 4
    assert log.depths["t_gps_s"].isna().tolist() == [True] * 3 + [False] * 4
    assert_allclose(log.states["t_device_s"][:3], [0.0, 0.1, 0.2], atol=1e-15)  # last bit
    assert log.report.synchronised
    assert not log.report.gaps  # setting the clock is no gap
    assert noted(log, "3 of 7 states carry no valid UTC")


def test_utc_bit_with_an_impossible_date_is_not_believed(read):
    log = read(state(0) + state(-T0 * 1_000_000) + state(200_000))
    assert log.states["t_gps_s"].isna().tolist() == [False, True, False]
    assert log.report.losses["impossible_times"] == 1


def test_a_packet_takes_the_time_of_the_state_before_it(read):
    data = depth(0) + b"".join(state(k * 50_000) + depth(k + 1) for k in range(4))
    log = read(data)
    assert np.isnan(log.depths["t_gps_s"][0])
    assert_array_equal(log.depths["t_gps_s"][1:], log.states["t_gps_s"])
    assert log.depths["depth_m"].tolist() == [0, 1, 2, 3, 4]


def test_orientation_sigmas_come_from_the_nearest_packet_26(read):
    data = b""
    for k in range(10):
        data += state(k * 100_000)
        if k in (0, 4):
            data += anpp(26, struct.pack("<3f", 0.01 + k, 0.02 + k, 0.03 + k))
    log = read(data + state(60_000_000))
    got = log.states["sigma_heading_rad"].to_numpy()
    assert_array_equal(got[:3], np.float64(np.float32(0.03)))
    assert_array_equal(got[3:10], np.float64(np.float32(4.03)))
    assert np.isnan(got[10])  # a minute later that packet says nothing any more


def test_gnss_positions_have_their_own_time_and_sigmas(read):
    satellites = anpp(30, struct.pack("<2f5B", 1, 1, 8, 4, 2, 3, 1))
    data = state(0) + gnss(-20_000) + satellites + state(50_000) + gnss(30_000, flags=2) + gnss(0, flags=0)
    log = read(data)
    assert log.positions["fix"].tolist() == ["fixed", "single"]
    assert log.positions["t_gps_s"][0] == pytest.approx(178_649_912.98, abs=6e-8)
    assert np.isnan(log.positions["t_gps_s"][1])  # its own bit says that the time is not valid
    assert log.positions["n_sats"].tolist() == [18, -1]
    row = log.positions.iloc[0]
    assert (row["sigma_north_m"], row["sigma_east_m"]) == (np.float32(0.02), np.float32(0.01))
    assert log.report.counts["gnss_positions_without_fix"] == 1


def test_packet_92_stands_in_for_29(read):
    head = struct.pack("<BBHII3d", 0, 0, 6 | 1 << 10, T0, 0, 0.9, 0.23, 151.0)
    pvt = anpp(92, head + struct.pack("<9fI", 0.02, 0.01, 0.04, 1, 2, 3, 0, 0, 0, 55))
    log = read(state(0) + pvt)
    assert log.positions[["fix", "sigma_up_m"]].iloc[0].tolist() == ["float", np.float32(0.04)]
    assert log.positions["t_gps_s"][0] == float(gps_from_unix(T0))


def test_depths(read):
    packets = [depth(value) for value in (2.5, float("nan"), 3.5)]
    log = read(state(0) + packets[0] + state(1_000_000) + packets[1] + packets[2])
    assert log.depths["depth_m"].tolist() == [2.5, 3.5]
    assert_array_equal(log.depths["t_gps_s"], log.states["t_gps_s"])
    assert log.depths["line"].tolist() == [2, 5]
    assert log.depths["sentence"].tolist() == ["ANPP53", "ANPP53"]
    assert log.report.losses == {"depths_not_a_number": 1}


def test_packets_that_nothing_is_taken_from_are_named(read):
    log = read(state(0) + anpp(10, b"\x01$SDDPT,2.6,0.3*5A") + anpp(28, bytes(48)) * 3 + depth())
    assert any(
        note.startswith("Not read: packets 10 ") and "28 raw sensors 3" in note for note in log.report.notes
    )
    assert log.report.clean


def test_calendar_packet_gives_time_too(read):
    moment = dt.datetime(2016, 2, 29, 23, 59, 58, tzinfo=dt.UTC)
    calendar = struct.pack("<IHHBBBBBB", 250_000, 2016, 59, 1, 29, 1, 23, 59, 58)
    status = anpp(23, struct.pack("<HH", 0, 8))
    log = read(status + anpp(22, calendar) + depth() + anpp(22, b"\xff" * 14) + depth())
    assert log.depths["t_gps_s"][0] == float(gps_from_unix(moment.timestamp(), 250_000))
    assert log.report.losses == {"impossible_times": 1}


def test_gap_backward_step_and_repeated_time_are_counted(read):
    steps = [0, 1, 2, 3, 9, 10, 8, 9, 9, 10]
    log = read(b"".join(state(k * 100_000, rpy=(i, 0, 0)) for i, k in enumerate(steps)))
    assert log.report.losses == {"time_steps_back": 1, "repeated_times": 1}
    assert [g.lost for g in log.report.gaps] == [5]
    assert len(log.states) == 10


def test_files_that_overlap_are_joined_once(read):
    epochs = [state(k * 100_000) + gnss(k * 100_000) + depth(2.0) for k in range(30)]
    one, two = b"".join(epochs[:20]), b"".join(epochs[15:])
    log = read(one, two)
    whole = read(one + b"".join(epochs[20:]))
    for name in ("states", "positions", "depths"):
        got, want = getattr(log, name), getattr(whole, name)
        assert_array_equal(got["t_gps_s"], want["t_gps_s"])
    assert log.report.counts["repeated_packets_dropped"] == 15
    assert not log.report.losses
    assert log.report.details["packets by id"]["20 system state"] == 35


def test_an_overlap_that_begins_between_state_and_depth(read):
    epochs = [state(k * 100_000) + depth(k) for k in range(30)]
    log = read(b"".join(epochs[:20]), depth(14) + b"".join(epochs[15:]))
    assert log.depths["depth_m"].tolist() == list(range(30))
    assert_array_equal(log.depths["t_gps_s"], log.states["t_gps_s"])
    # without overlap the same packet belongs to the last state of the file before
    log = read(b"".join(epochs[:20])[: -len(depth())], depth(19) + b"".join(epochs[20:]))
    assert_array_equal(log.depths["t_gps_s"], log.states["t_gps_s"])
    assert log.report.clean


def test_positions_that_cannot_be_are_blanked(read):
    wild = struct.pack("<HHII3d16f", 0, UTC_FIXED, T0, 100_000, 2.0, 1e308, np.inf, *[0.0] * 16)
    log = read(state(0) + anpp(20, wild) + gnss(0))
    assert log.states["lat_deg"].isna().tolist() == [False, True]
    assert log.states["t_gps_s"].notna().all()
    assert log.report.losses == {"states_with_impossible_position": 1}


def test_unknown_ids_and_odd_sizes_are_counted(read):
    log = read(state(0) + anpp(222, b"abc") * 3 + anpp(53, bytes(13)) + anpp(20, bytes(99)))
    counts = {"20 system state": 2, "53 external depth": 1, "222 unknown": 3}
    assert log.report.details["packets by id"] == counts
    assert log.report.losses == {"packets_of_wrong_size": 2}
    assert noted(log, "are not of the documented size of 8")


def test_device_and_alarms(read):
    data = anpp(3, struct.pack("<6I", 1234, 5, 100, 1, 2, 3)) + state(0, system=1 << 12)
    log = read(data + anpp(3, struct.pack("<6I", 1234, 9999, 100, 1, 2, 3)))
    assert log.report.model == "Spatial Dual, device id 9999"
    assert noted(log, "low voltage alarm in 1 of 1")
    assert noted(log, "2 different devices")


def small_log() -> bytes:
    data = anpp(3, struct.pack("<6I", 1, 5, 1, 1, 2, 3))
    for k in range(12):
        data += state(k * 100_000) + depth(k) + anpp(26, struct.pack("<3f", 0.1, 0.1, 0.1))
        data += gnss(k * 100_000) + anpp(22, struct.pack("<IHH6B", 1, 2017, 0, 4, 12, 0, 1, 1, k))
    return data
