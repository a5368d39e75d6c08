"""The SBP reader on synthetic logs: weeks, positions, what is counted."""

import struct
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.ingest.writers import ROVER, files_of, noted, sbp
from thalweg.core import ecef_of, gps_from_week, rotation_ecef_enu, write_table
from thalweg.ingest import GNSS_POSITION, PositionLog
from thalweg.ingest.sbp import base_positions, collect, messages as sm, read_sbp

WEEK = 1948
TOW = 499_513_400


def gps(tow: int, week: int = WEEK, flags: int = 1, ns: int = 0, kind: int = sm.GPS_TIME) -> bytes:
    return sbp(kind, struct.pack("<HIiB", week, tow, ns, flags))


def utc(tow: int, second: int, flags: int = 1, ns: int = 400_000_000) -> bytes:
    return sbp(sm.UTC_TIME, struct.pack("<BIHBBBBBI", flags, tow, 2017, 5, 12, 18, 44, second, ns))


def llh(
    tow: int, flags: int = 4, lat: float = 51.0, kind: int = sm.POS_LLH, sender: int = ROVER, acc: int = 13
) -> bytes:
    return sbp(kind, struct.pack("<I3dHHBB", tow, lat, 13.5, 150.25, acc, 2 * acc, 9, flags), sender)


def cov(tow: int, flags: int = 4) -> bytes:
    return sbp(
        sm.POS_LLH_COV, struct.pack("<I3d6fBB", tow, 51.0, 13.5, 150.25, 4, 1, 0.5, 9, -0.25, 16, 9, flags)
    )


def obs(tow: int, week: int = WEEK, sender: int = ROVER, signals: int = 2) -> bytes:
    body = b"".join(struct.pack("<IiBhBBBBBB", 1, 2, 3, 4, 5, 6, 7, 15, s + 1, 0) for s in range(signals))
    return sbp(sm.OBS, struct.pack("<IiHB", tow, 0, week, 0x10) + body, sender)


def event(tow: int, flags: int, week: int = WEEK, pin: int = 3, ns: int = 250_000) -> bytes:
    return sbp(sm.EVENT, struct.pack("<HIiBB", week, tow, ns, flags, pin))


def base(*xyz: float) -> bytes:
    return sbp(sm.BASE_ECEF, struct.pack("<3d", *xyz), 0)


@pytest.fixture
def read(tmp_path):
    """Reads a log of these contents."""

    def made(*logs: bytes) -> PositionLog:
        return read_sbp(files_of(tmp_path, *logs))

    return made


def base_of(tmp_path: Path) -> np.ndarray:
    """Base positions that the log read last states."""
    return base_positions(collect([tmp_path / "log0"]))


def t_of(tow: int, week: int = WEEK) -> float:
    return float(gps_from_week(week, tow * 1e-3))


def test_crc_failure_costs_one_message(read):
    parts = [gps(TOW), *(llh(TOW + 100 * k) for k in range(4))]
    parts[2] = parts[2][:20] + bytes([parts[2][20] ^ 4]) + parts[2][21:]
    log = read(b"".join(parts))
    assert_allclose(log.positions["t_gps_s"], [t_of(TOW + 100 * k) for k in (0, 2, 3)])
    assert log.report.losses == {"bytes_outside_messages": 42, "messages_with_wrong_checksum": 1}
    assert noted(log, "42 at log0 byte 61")


@pytest.mark.parametrize(
    ("flags", "word"),
    [(1, "single"), (2, "dgnss"), (3, "float"), (4, "fixed"), (5, "dead_reckoning"), (6, "sbas")],
)
def test_fix_words(flags, word, read):
    # bits 3 and 4 are the state of the inertial filter
    assert read(gps(TOW) + llh(TOW, flags=flags | 0x18)).positions["fix"].tolist() == [word]


def test_power_up_epochs_are_dropped_and_counted(read):
    data = b"".join(gps(k * 100, week=0, flags=0) + llh(k * 100, flags=0, lat=0.0) for k in range(5))
    log = read(data + gps(TOW) + llh(TOW) + gps(TOW + 100, flags=0) + llh(TOW + 100, flags=0))
    assert log.positions["t_gps_s"].tolist() == [t_of(TOW)]
    assert log.report.counts["positions_without_fix_dropped"] == 6


@pytest.mark.parametrize(
    ("data", "source"),
    [
        (llh(TOW) + llh(TOW + 100) + gps(TOW + 200) + llh(TOW + 200), "MsgGPSTime"),
        (gps(TOW, kind=sm.GPS_TIME_GNSS) + llh(TOW), "MsgGPSTime"),
        (gps(TOW, kind=sm.GPS_TIME_DEP_A) + llh(TOW), "MsgGPSTime"),
        (obs(TOW - 400) + llh(TOW), "MsgObs"),  # if nothing else does
    ],
    ids=["positions before it", "of another receiver", "an old one", "observations"],
)
def test_messages_that_give_the_week(read, data, source):
    log = read(data)
    t_s = log.positions["t_gps_s"].to_numpy()
    assert_allclose(t_s, t_of(TOW) + 0.1 * np.arange(len(t_s)))
    assert log.report.details["GPS week from"].startswith(source)


@pytest.mark.parametrize("late", [False, True])
def test_week_rollover_in_mid_log(late, read):
    """``late``: a position of the new week comes before its MsgGPSTime, one of the old week after."""
    last = 604_800_000 - 100
    if late:
        data = gps(last) + llh(last - 100) + llh(0) + gps(0, WEEK + 1) + llh(last) + llh(100)
        want = [t_of(last - 100), t_of(0, WEEK + 1), t_of(last), t_of(100, WEEK + 1)]
    else:
        data = gps(last) + llh(last) + gps(0, WEEK + 1) + llh(0) + gps(100, WEEK + 1) + llh(100)
        want = [t_of(last), t_of(0, WEEK + 1), t_of(100, WEEK + 1)]
    log = read(data)
    assert_allclose(log.positions["t_gps_s"], want, atol=6e-8)  # resolution of float64
    assert log.report.losses == ({"time_steps_back": 1} if late else {})


def test_residual_of_gps_time_belongs_to_its_epoch(read):
    log = read(gps(TOW, ns=-300_000) + llh(TOW) + llh(TOW + 100))
    got = log.positions["t_gps_s"] - [t_of(TOW), t_of(TOW + 100)]
    assert_allclose(got, [-3e-4, 0], atol=1.2e-7)  # resolution of float64


def test_without_any_week_nothing_is_timed(read):
    log = read(cov(TOW) + llh(TOW) + utc(TOW, 55) + llh(TOW + 100))
    assert log.positions["t_gps_s"].isna().tolist() == [True]  # the better of the two message types
    assert not log.report.synchronised
    assert log.report.t_first_s is None
    assert noted(log, "No message states a valid GPS week")
    assert "GPS - UTC" not in log.report.details


def test_covariances_join_their_epoch(read):
    data = b"".join(gps(TOW + k) + llh(TOW + k, acc=500) for k in (0, 100, 200))
    log = read(data.replace(llh(TOW + 100, acc=500), llh(TOW + 100, acc=500) + cov(TOW + 100)))
    assert len(log.positions) == 3
    assert log.positions["sigma_east_m"].tolist() == [0.5, 3.0, 0.5]
    # north-east-down (1, 0.5, -0.25) in the message
    names = ["sigma_north_m", "sigma_up_m", "cov_en_m2", "cov_nu_m2", "cov_eu_m2"]
    assert log.positions[names].iloc[1].tolist() == [2.0, 4.0, 1.0, -0.5, 0.25]
    assert log.positions["cov_en_m2"].isna().tolist() == [True, False, True]
    assert log.report.details["positions from"] == "MsgPosLLHCov + MsgPosLLH"


def test_earth_centred_positions_and_their_covariance(read):
    """Half a metre east, 2 m north and 3 m up, in the axes of the earth; other messages are counted."""
    lat, lon = 51.0, 13.5
    R = rotation_ecef_enu(lat, lon)
    C = np.array([[0.25, 0.1, 0.2], [0.1, 4.0, -0.3], [0.2, -0.3, 9.0]])
    turned = R @ C @ R.T
    six = [turned[i, j] for i in range(3) for j in range(i, 3)]
    body = struct.pack("<I3d6fBB", TOW, *ecef_of(lat, lon, 150.25), *six, 9, 4)
    more = [sbp(sm.IMU_RAW, bytes(17))] * 2 + [sbp(sm.MAG_RAW, bytes(11))] * 3
    log = read(gps(TOW) + sbp(sm.POS_ECEF_COV, body) + b"".join(more))
    row = log.positions.iloc[0]
    assert (row.lat_deg, row.lon_deg, row.h_ell_m) == pytest.approx((lat, lon, 150.25), abs=1e-6)
    sigmas = (row.sigma_east_m, row.sigma_north_m, row.sigma_up_m)
    assert sigmas == pytest.approx((0.5, 2.0, 3.0), rel=1e-5)
    assert (row.cov_en_m2, row.cov_eu_m2, row.cov_nu_m2) == pytest.approx((0.1, 0.2, -0.3), rel=1e-4)
    assert [log.report.counts[name] for name in ("imu_raw", "mag_raw")] == [2, 3]


@pytest.mark.parametrize("acc", [0, 0xFFFF // 2 + 1])
def test_unknown_accuracy_is_nan(acc, read):
    payload = struct.pack("<I3dHHBB", TOW, 51.0, 13.5, 150.0, acc, 0xFFFF, 9, 4)
    row = read(gps(TOW) + sbp(sm.POS_LLH, payload)).positions.iloc[0]
    assert np.isnan(row["sigma_up_m"])
    assert np.isnan(row["sigma_east_m"]) == (acc == 0)


def test_old_position_messages(read):
    data = gps(TOW, kind=sm.GPS_TIME_DEP_A, flags=0)
    data += b"".join(llh(TOW + k, flags=k, kind=sm.POS_LLH_DEP_A, acc=0) for k in range(3))
    log = read(data)
    assert log.positions["fix"].tolist() == ["single", "fixed", "float"]


def test_age_of_the_corrections(read):
    age = sbp(sm.AGE, struct.pack("<IH", TOW, 9))
    data = gps(TOW) + llh(TOW) + age + gps(TOW + 100) + llh(TOW + 100)
    log = read(data + sbp(sm.AGE, struct.pack("<IH", TOW + 100, 0xFFFF)))
    assert log.positions["age_s"][0] == pytest.approx(0.9)
    assert np.isnan(log.positions["age_s"][1])


def test_events_are_named(read):
    log = read(gps(TOW) + event(TOW, 3) + event(TOW + 50, 2))
    assert noted(log, "2 times of events")


def test_utc_offset_is_measured_and_compared(read):
    right = gps(TOW) + utc(TOW, 55) + llh(TOW)
    log = read(right + utc(TOW, 55, flags=0) + utc(TOW + 100, 55))
    assert log.report.details["GPS - UTC"] == {"18.000 s": 1}
    assert not noted(log, "leap")
    wrong = read(gps(TOW) + utc(TOW, 57) + llh(TOW))
    assert noted(wrong, "GPS - UTC = 16.000 s", "18 s")
    assert "GPS - UTC" not in read(llh(TOW)).report.details


def test_base_and_observations_by_sender(tmp_path, read):
    xyz = (-2706105.2, -4261210.8, 3885598.6)
    data = gps(TOW) + llh(TOW) + base(*xyz) + base(0, 0, 0)
    data += obs(TOW, sender=0) + obs(TOW, sender=0, signals=3) + obs(TOW + 1000, sender=0) + obs(TOW, week=0)
    log = read(data + obs(TOW + 600))
    assert base_of(tmp_path).tolist() == [list(xyz)]
    counts = log.report.counts
    assert (counts["observation_epochs_base"], counts[f"observation_epochs_{ROVER}"]) == (2, 1)
    assert log.report.details["signals by code, sender 0"] == {"0": 7}
    assert noted(read(data + base(xyz[0] + 0.5, *xyz[1:])), "differ by up to 0.500 m")


def test_the_report_of_a_log_by_hand(read):
    """Each count and detail of positions of one receiver beside another, a base and observations of both."""
    there, here = ecef_of(51.01, 13.5, 150.25), ecef_of(51.0, 13.5, 150.25)
    epochs = [gps(TOW + k) + llh(TOW + k, flags=4 if k else 3) + obs(TOW + k) for k in (0, 100, 200)]
    data = b"".join(epochs) + cov(TOW + 200) + base(*there) * 2 + obs(TOW, sender=0, signals=3)
    data += llh(TOW, sender=7) + sbp(0x0081, b"") + sbp(0x008A, b"") + sbp(0xFFF0, b"abc") * 2
    report = read(data + utc(TOW + 200, 55, ns=600_000_000)).report
    assert report.counts == {
        "messages": 19, "messages_of_unknown_type": 2, "ephemerides": 2, "positions": 3, "base_positions": 2,
        "observation_epochs_base": 1, f"observation_epochs_{ROVER}": 3,
    }  # fmt: skip
    km = np.linalg.norm(np.subtract(there, here)) / 1000
    assert report.details.pop("messages by type and sender") == {
        f"MsgGPSTime {ROVER}": 3, f"MsgPosLLH {ROVER}": 3, f"MsgObs {ROVER}": 3, "MsgBasePosECEF 0": 2,
        f"0xFFF0 {ROVER}": 2, f"MsgPosLLHCov {ROVER}": 1, "MsgObs 0": 1, "MsgPosLLH 7": 1,
        f"MsgUtcTime {ROVER}": 1, f"MsgEphemerisGPSDepE {ROVER}": 1, f"MsgEphemerisGPS {ROVER}": 1,
    }  # fmt: skip
    expected = {
        "GPS week from": "MsgGPSTime", "GPS - UTC": {"18.000 s": 1}, "fixes": {"fixed": 2, "float": 1},
        "positions from": "MsgPosLLHCov + MsgPosLLH", "distance of the base": f"{km:.3f} km, median",
        "signals by code, sender 0": {"0": 3}, f"signals by code, sender {ROVER}": {"0": 6},
    }  # fmt: skip
    assert expected.items() <= report.details.items()
    assert report.notes == [
        "Message types that the SBP specification does not name: 0xFFF0 (2).",
        f"Positions of sender {ROVER} are used; those of 7 (1 messages) are not.",
    ]
    assert (report.synchronised, report.time_scale, report.timing.resolution_s) == (True, "gps", 1e-3)
    fine = read(gps(TOW, ns=5) + llh(TOW)).report
    assert fine.timing.resolution_s == 1e-9


@pytest.mark.parametrize(("ns", "told"), [(401_000_000, False), (402_000_000, True), (398_000_000, True)])
def test_an_offset_of_utc_is_compared_to_a_millisecond(read, ns, told):
    log = read(gps(TOW) + utc(TOW, 55, ns=ns) + llh(TOW))
    assert noted(log, "The receiver states GPS - UTC", "1 of 1 stamps differ") == told


@pytest.mark.parametrize(("moved_m", "told"), [(0.0009, False), (0.0011, True)])
def test_a_base_that_moves_by_a_millimetre_is_told(tmp_path, read, moved_m, told):
    log = read(gps(TOW) + llh(TOW) + base(3.9e6, 9e5, 4.9e6) + base(3.9e6, 9e5, 4.9e6 + moved_m))
    assert noted(log, "differ by up to 0.001 m") == told
    read(gps(TOW) + base(6.1e6, 0, 0) + base(5.9e6, 0, 0) + base(np.nan, 6.1e6, 0))
    assert base_of(tmp_path).tolist() == [[6.1e6, 0, 0]]
    places = [(90.0, 1.0, 5.0), (-90.1, 1.0, 5.0), (0.0, 1.0, 5.0), (1.0, np.nan, 5.0), (1.0, 2.0, np.inf)]
    read(gps(TOW) + b"".join(sbp(sm.BASE_LLH, struct.pack("<3d", *place), 0) for place in places))
    assert base_of(tmp_path) == pytest.approx(ecef_of([90.0], [1.0], [5.0]))


def test_base_from_latitude_and_longitude(tmp_path, read):
    read(gps(TOW) + sbp(sm.BASE_LLH, struct.pack("<3d", 0.5, 0.0, 100.0), 0))
    assert base_of(tmp_path)[0] == pytest.approx(ecef_of(0.5, 0.0, 100.0), abs=1e-6)


def test_positions_of_one_receiver_only(read):
    data = gps(TOW) + llh(TOW) + llh(TOW + 100) + llh(TOW, lat=52.0, sender=99) + llh(TOW, lat=53.0, sender=0)
    log = read(data)
    assert log.positions["lat_deg"].tolist() == [51.0, 51.0]
    assert noted(log, "sender 12027 are used; those of 99 (1 messages)")


def test_repeated_and_impossible_positions(read):
    data = gps(TOW) + llh(TOW) + llh(TOW) + llh(4_000_000_000) + llh(TOW + 100, lat=float("nan"))
    log = read(data + llh(TOW + 200, lat=1e9))
    assert log.positions["t_gps_s"].tolist() == [t_of(TOW)]
    assert log.report.counts["positions_repeated_dropped"] == 1
    assert log.report.losses == {"positions_impossible": 3}


def test_files_that_overlap_or_split_a_message(tmp_path, read):
    epochs = [gps(TOW + k) + llh(TOW + k) + event(TOW + k, 3) for k in range(0, 2000, 100)]
    whole = read(b"".join(epochs))
    overlap = read(b"".join(epochs[:12]), b"".join(epochs[8:]))
    data = b"".join(epochs)
    split = read(data[:333], data[333:])
    for log in (overlap, split):
        assert_array_equal(log.positions["t_gps_s"], whole.positions["t_gps_s"])
        assert log.report.clean
    assert overlap.report.counts["positions_repeated_dropped"] == 4
    pieces = read_sbp([tmp_path / "log0", tmp_path / "log1"], chunk_bytes=17).report
    assert pieces.clean
    assert pieces.details == split.report.details


def test_gaps_and_unknown_types(read):
    data = b"".join(gps(TOW + k) + llh(TOW + k) for k in (0, 100, 200, 900, 1000))
    data += sbp(0xFFF0, b"abc") + sbp(sm.POS_LLH, b"abc") + sbp(sm.OBS, b"abc")
    log = read(data + sbp(sm.OBS, obs(TOW)[6:-2] + b"more"))  # no whole number of signals
    assert [g.lost for g in log.report.gaps] == [6]
    assert log.report.counts["messages_of_unknown_type"] == 1
    assert log.report.losses == {"messages_of_wrong_size": 3}
    assert noted(log, "0xFFF0 (1)")
    assert not any("signals" in what for what in log.report.details)


def test_tables_fit_their_kinds(tmp_path, read):
    full = gps(TOW) + llh(TOW)
    for data in (full, sbp(0xFFF0, b"")):
        log = read(data)
        assert len(log.positions) == (1 if data is full else 0)
        write_table(tmp_path / "t.parquet", log.positions, GNSS_POSITION)
        log.report.to_json()
    assert noted(log, "no position with a fix")


def small_log() -> bytes:
    data = base(-2706105.2, -4261210.8, 3885598.6)
    for k in range(0, 1200, 100):
        data += gps(TOW + k) + utc(TOW + k, 55) + llh(TOW + k) + cov(TOW + k)
        data += sbp(sm.POS_ECEF, struct.pack("<I3dHBB", TOW + k, 3.9e6, 9e5, 4.9e6, 20, 9, 4))
        data += obs(TOW + k) + event(TOW + k, 3) + sbp(sm.AGE, struct.pack("<IH", TOW + k, 5))
    return data
