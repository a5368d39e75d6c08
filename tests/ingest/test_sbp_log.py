"""The SBP reader on synthetic logs: framing, weeks, positions, bad input, fuzz."""

import binascii
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from thalweg.core import InputError, ThalwegError, ecef_of, gps_from_week, rotation_ecef_enu, write_table
from thalweg.core.timescales import LeapSecondWarning
from thalweg.ingest import GNSS_POSITION
from thalweg.ingest.framing import StreamTally
from thalweg.ingest.framing.stream import BAD_CRC, CUT, SKIPPED
from thalweg.ingest.ppk.solution import looks_like_sbp, walk_sbp
from thalweg.ingest.registry import recognise
from thalweg.ingest.sbp import find_messages, messages as sm, read_sbp
from thalweg.ingest.sbp.reader import SbpLog

WEEK = 1948
TOW = 499_513_400
ROVER = 12027


def frame(kind: int, payload: bytes, sender: int = ROVER) -> bytes:
    body = struct.pack("<HHB", kind, sender, len(payload)) + payload
    return b"\x55" + body + struct.pack("<H", binascii.crc_hqx(body, 0))


def gps(tow: int, week: int = WEEK, flags: int = 1, ns: int = 0, kind: int = sm.GPS_TIME) -> bytes:
    return frame(kind, struct.pack("<HIiB", week, tow, ns, flags))


def utc(tow: int, second: int, flags: int = 1, ns: int = 400_000_000) -> bytes:
    return frame(sm.UTC_TIME, struct.pack("<BIHBBBBBI", flags, tow, 2017, 5, 12, 18, 44, second, ns))


def llh(
    tow: int, flags: int = 4, lat: float = 51.0, kind: int = sm.POS_LLH, sender: int = ROVER, acc: int = 13
) -> bytes:
    return frame(kind, struct.pack("<I3dHHBB", tow, lat, 13.5, 150.25, acc, 2 * acc, 9, flags), sender)


def cov(tow: int, flags: int = 4) -> bytes:
    return frame(
        sm.POS_LLH_COV, struct.pack("<I3d6fBB", tow, 51.0, 13.5, 150.25, 4, 1, 0.5, 9, -0.25, 16, 9, flags)
    )


def obs(tow: int, week: int = WEEK, sender: int = ROVER, signals: int = 2) -> bytes:
    body = b"".join(struct.pack("<IiBhBBBBBB", 1, 2, 3, 4, 5, 6, 7, 15, s + 1, 0) for s in range(signals))
    return frame(sm.OBS, struct.pack("<IiHB", tow, 0, week, 0x10) + body, sender)


def event(tow: int, flags: int, week: int = WEEK, pin: int = 3, ns: int = 250_000) -> bytes:
    return frame(sm.EVENT, struct.pack("<HIiBB", week, tow, ns, flags, pin))


def read(tmp_path: Path, *logs: bytes) -> SbpLog:
    files = []
    for k, data in enumerate(logs):
        files.append(tmp_path / f"{k}.sbp")
        files[-1].write_bytes(data)
    return read_sbp(files)


def t_of(tow: int, week: int = WEEK) -> float:
    return float(gps_from_week(week, tow * 1e-3))


def reference(data: bytes) -> Iterator[tuple[int, int, int, int]]:
    """Type, sender, offset of the payload and length of each frame: the specification, word for word."""
    i = 0
    while i + 8 <= len(data):
        _, kind, sender, length = struct.unpack_from("<BHHB", data, i)
        end = i + 6 + length
        if (
            data[i] == 0x55
            and kind != 0
            and end + 2 <= len(data)
            and struct.unpack_from("<H", data, end)[0] == binascii.crc_hqx(data[i + 1 : end], 0)
        ):
            yield kind, sender, i + 6, length
            i = end + 2
        else:
            i += 1


def test_framing_equals_the_reference_on_damaged_logs(rng: np.random.Generator) -> None:
    for _ in range(60):
        parts = [frame(int(rng.integers(65536)), rng.bytes(int(rng.integers(256)))) for _ in range(10)]
        data = bytearray(b"".join(parts))
        for _ in range(int(rng.integers(0, 10))):
            at = int(rng.integers(len(data)))
            if rng.integers(2):
                data[at] = int(rng.choice([0x55, int(rng.integers(256))]))
            else:
                del data[at : at + int(rng.integers(1, 40))]
        tally = StreamTally()
        b = find_messages(np.frombuffer(bytes(data), np.uint8), tally)
        got = list(zip(b.kind.tolist(), b.sender.tolist(), b.offset.tolist(), b.length.tolist(), strict=True))
        assert got == list(reference(bytes(data)))
        assert tally.cells[SKIPPED] == len(data) - sum(8 + n for *_, n in got)


def test_a_run_of_zeros_is_no_message(tmp_path: Path) -> None:
    """The CRC of 55 and seven zeros is right, but no message has type 0."""
    data, tally = gps(TOW) + b"\x55" + bytes(7) + llh(TOW) + b"\x55" + bytes(40), StreamTally()
    found = find_messages(np.frombuffer(data, np.uint8), tally)
    assert found.kind.tolist() == [sm.GPS_TIME, sm.POS_LLH]
    assert (tally.cells[SKIPPED], tally.cells[BAD_CRC], tally.cells[CUT]) == (49, 0, 0)
    path = tmp_path / "zeros.bin"
    path.write_bytes((b"\x55" + bytes(7)) * 500)
    with pytest.raises(InputError, match="unrecognised file"):
        recognise(path)
    assert walk_sbp(path.read_bytes()).bytes_lost == 4000
    assert not looks_like_sbp(path.read_bytes())


def test_a_false_preamble_hides_nothing() -> None:
    tally = StreamTally()
    data = b"\x55\x01\x02\x03\x04\xff" + llh(TOW) + llh(TOW + 100) + llh(TOW)[:-1]
    found = find_messages(np.frombuffer(data, np.uint8), tally)
    assert found.kind.tolist() == [sm.POS_LLH] * 2
    assert (tally.cells[BAD_CRC], tally.cells[CUT]) == (0, 2)  # both frames reach beyond the end


def test_crc_failure_costs_one_message(tmp_path: Path) -> None:
    parts = [gps(TOW), *(llh(TOW + 100 * k) for k in range(4))]
    parts[2] = parts[2][:20] + bytes([parts[2][20] ^ 4]) + parts[2][21:]
    log = read(tmp_path, b"".join(parts))
    np.testing.assert_allclose(log.positions["t_gps_s"], [t_of(TOW + 100 * k) for k in (0, 2, 3)])
    assert log.report.losses == {"bytes_outside_messages": 42, "messages_with_wrong_checksum": 1}
    assert any("42 at 0.sbp byte 61" in note for note in log.report.notes)


@pytest.mark.parametrize(
    ("flags", "word"),
    [(1, "single"), (2, "dgnss"), (3, "float"), (4, "fixed"), (5, "dead_reckoning"), (6, "sbas")],
)
def test_fix_words(flags: int, word: str, tmp_path: Path) -> None:
    # bits 3 and 4 are the state of the inertial filter
    assert read(tmp_path, gps(TOW) + llh(TOW, flags=flags | 0x18)).positions["fix"].tolist() == [word]


def test_power_up_epochs_are_dropped_and_counted(tmp_path: Path) -> None:
    data = b"".join(gps(k * 100, week=0, flags=0) + llh(k * 100, flags=0, lat=0.0) for k in range(5))
    log = read(tmp_path, data + gps(TOW) + llh(TOW) + gps(TOW + 100, flags=0) + llh(TOW + 100, flags=0))
    assert log.positions["t_gps_s"].tolist() == [t_of(TOW)]
    assert log.report.counts["positions_without_fix_dropped"] == 6


def test_positions_before_the_first_gps_time_get_its_week(tmp_path: Path) -> None:
    log = read(tmp_path, llh(TOW) + llh(TOW + 100) + gps(TOW + 200) + llh(TOW + 200))
    np.testing.assert_allclose(log.positions["t_gps_s"], [t_of(TOW + 100 * k) for k in range(3)])


@pytest.mark.parametrize("late", [False, True])
def test_week_rollover_in_mid_log(late: bool, tmp_path: Path) -> None:
    """``late``: a position of the new week comes before its MsgGPSTime, one of the old week after."""
    last = 604_800_000 - 100
    if late:
        data = gps(last) + llh(last - 100) + llh(0) + gps(0, WEEK + 1) + llh(last) + llh(100)
        want = [t_of(last - 100), t_of(0, WEEK + 1), t_of(last), t_of(100, WEEK + 1)]
    else:
        data = gps(last) + llh(last) + gps(0, WEEK + 1) + llh(0) + gps(100, WEEK + 1) + llh(100)
        want = [t_of(last), t_of(0, WEEK + 1), t_of(100, WEEK + 1)]
    log = read(tmp_path, data)
    np.testing.assert_allclose(log.positions["t_gps_s"], want, atol=6e-8)  # resolution of float64
    assert log.report.losses == ({"time_steps_back": 1} if late else {})


def test_residual_of_gps_time_belongs_to_its_epoch(tmp_path: Path) -> None:
    log = read(tmp_path, gps(TOW, ns=-300_000) + llh(TOW) + llh(TOW + 100))
    got = log.positions["t_gps_s"] - [t_of(TOW), t_of(TOW + 100)]
    np.testing.assert_allclose(got, [-3e-4, 0], atol=1.2e-7)  # resolution of float64


@pytest.mark.parametrize("kind", [sm.GPS_TIME_GNSS, sm.GPS_TIME_DEP_A])
def test_other_sources_of_the_week(kind: int, tmp_path: Path) -> None:
    log = read(tmp_path, gps(TOW, flags=1, kind=kind) + llh(TOW))
    assert log.positions["t_gps_s"].tolist() == [t_of(TOW)]


def test_observations_give_the_week_if_nothing_else_does(tmp_path: Path) -> None:
    log = read(tmp_path, obs(TOW - 400) + llh(TOW))
    assert log.positions["t_gps_s"].tolist() == [t_of(TOW)]
    assert log.report.details["GPS week from"] == "MsgObs"


def test_without_any_week_nothing_is_timed(tmp_path: Path) -> None:
    log = read(tmp_path, cov(TOW) + llh(TOW) + llh(TOW + 100))
    assert log.positions["t_gps_s"].isna().tolist() == [True]  # the better of the two message types
    assert not log.report.synchronised
    assert log.report.t_first_s is None
    assert any("No message states a valid GPS week" in note for note in log.report.notes)


def test_covariances_join_their_epoch(tmp_path: Path) -> None:
    data = b"".join(gps(TOW + k) + llh(TOW + k, acc=500) for k in (0, 100, 200))
    log = read(tmp_path, data.replace(llh(TOW + 100, acc=500), llh(TOW + 100, acc=500) + cov(TOW + 100)))
    assert len(log.positions) == 3
    assert log.positions["sigma_east_m"].tolist() == [0.5, 3.0, 0.5]
    row = log.positions.iloc[1]
    assert row["sigma_north_m"] == 2.0
    assert row["sigma_up_m"] == 4.0
    # north-east-down (1, 0.5, -0.25) in the message
    assert (row["cov_en_m2"], row["cov_nu_m2"], row["cov_eu_m2"]) == (1.0, -0.5, 0.25)
    assert log.positions["cov_en_m2"].isna().tolist() == [True, False, True]
    assert log.report.details["positions from"] == "MsgPosLLHCov + MsgPosLLH"


def test_earth_centred_positions_and_their_covariance(tmp_path: Path) -> None:
    """Half a metre east, 2 m north and 3 m up, in the axes of the earth; other messages are counted."""
    lat, lon = 51.0, 13.5
    R = rotation_ecef_enu(lat, lon)
    C = np.array([[0.25, 0.1, 0.2], [0.1, 4.0, -0.3], [0.2, -0.3, 9.0]])
    turned = R @ C @ R.T
    six = [turned[i, j] for i in range(3) for j in range(i, 3)]
    body = struct.pack("<I3d6fBB", TOW, *ecef_of(lat, lon, 150.25), *six, 9, 4)
    more = [frame(sm.IMU_RAW, bytes(17))] * 2 + [frame(sm.MAG_RAW, bytes(11))] * 3
    log = read(tmp_path, gps(TOW) + frame(sm.POS_ECEF_COV, body) + b"".join(more))
    row = log.positions.iloc[0]
    assert (row.lat_deg, row.lon_deg, row.h_ell_m) == pytest.approx((lat, lon, 150.25), abs=1e-6)
    sigmas = (row.sigma_east_m, row.sigma_north_m, row.sigma_up_m)
    assert sigmas == pytest.approx((0.5, 2.0, 3.0), rel=1e-5)
    assert (row.cov_en_m2, row.cov_eu_m2, row.cov_nu_m2) == pytest.approx((0.1, 0.2, -0.3), rel=1e-4)
    assert [log.report.counts[name] for name in ("imu_raw", "mag_raw")] == [2, 3]


@pytest.mark.parametrize("acc", [0, 0xFFFF // 2 + 1])
def test_unknown_accuracy_is_nan(acc: int, tmp_path: Path) -> None:
    payload = struct.pack("<I3dHHBB", TOW, 51.0, 13.5, 150.0, acc, 0xFFFF, 9, 4)
    row = read(tmp_path, gps(TOW) + frame(sm.POS_LLH, payload)).positions.iloc[0]
    assert np.isnan(row["sigma_up_m"])
    assert np.isnan(row["sigma_east_m"]) == (acc == 0)


def test_old_position_messages(tmp_path: Path) -> None:
    data = gps(TOW, kind=sm.GPS_TIME_DEP_A, flags=0)
    data += b"".join(llh(TOW + k, flags=k, kind=sm.POS_LLH_DEP_A, acc=0) for k in range(3))
    log = read(tmp_path, data)
    assert log.positions["fix"].tolist() == ["single", "fixed", "float"]


def test_age_of_the_corrections(tmp_path: Path) -> None:
    age = frame(sm.AGE, struct.pack("<IH", TOW, 9))
    data = gps(TOW) + llh(TOW) + age + gps(TOW + 100) + llh(TOW + 100)
    log = read(tmp_path, data + frame(sm.AGE, struct.pack("<IH", TOW + 100, 0xFFFF)))
    assert log.positions["age_s"][0] == pytest.approx(0.9)
    assert np.isnan(log.positions["age_s"][1])


def test_events_are_named(tmp_path: Path) -> None:
    log = read(tmp_path, gps(TOW) + event(TOW, 3) + event(TOW + 50, 2))
    assert any("2 times of events" in note for note in log.report.notes)


def test_utc_offset_is_measured_and_compared(tmp_path: Path) -> None:
    right = gps(TOW) + utc(TOW, 55) + llh(TOW)
    log = read(tmp_path, right + utc(TOW, 55, flags=0) + utc(TOW + 100, 55))
    assert log.report.details["GPS - UTC"] == {"18.000 s": 1}
    assert not any("leap" in note for note in log.report.notes)
    wrong = read(tmp_path, gps(TOW) + utc(TOW, 57) + llh(TOW))
    assert any("GPS - UTC = 16.000 s" in note and "18 s" in note for note in wrong.report.notes)
    assert "GPS - UTC" not in read(tmp_path, llh(TOW)).report.details


def test_base_and_observations_by_sender(tmp_path: Path) -> None:
    xyz = (-2706105.2, -4261210.8, 3885598.6)
    base = [
        frame(sm.BASE_ECEF, struct.pack("<3d", *xyz), 0),
        frame(sm.BASE_ECEF, struct.pack("<3d", 0, 0, 0), 0),
    ]
    data = gps(TOW) + llh(TOW) + base[0] + base[1]
    data += obs(TOW, sender=0) + obs(TOW, sender=0, signals=3) + obs(TOW + 1000, sender=0) + obs(TOW, week=0)
    log = read(tmp_path, data + obs(TOW + 600))
    assert log.base_ecef_m is not None
    assert log.base_ecef_m.tolist() == list(xyz)
    counts = log.report.counts
    assert (counts["observation_epochs_base"], counts[f"observation_epochs_{ROVER}"]) == (2, 1)
    assert log.report.details["signals by code, sender 0"] == {"0": 7}
    moved = frame(sm.BASE_ECEF, struct.pack("<3d", xyz[0] + 0.5, *xyz[1:]), 0)
    assert any("differ by up to 0.500 m" in n for n in read(tmp_path, data + moved).report.notes)


def test_base_from_latitude_and_longitude(tmp_path: Path) -> None:
    log = read(tmp_path, gps(TOW) + frame(sm.BASE_LLH, struct.pack("<3d", 0.5, 0.0, 100.0), 0))
    assert log.base_ecef_m is not None
    radius = np.linalg.norm(log.base_ecef_m)
    assert radius == pytest.approx(6378137.0 + 100, abs=2.0)  # 0.5 deg north of the equator: 1.6 m less
    assert log.base_ecef_m[1] == pytest.approx(0.0, abs=1e-6)


def test_positions_of_one_receiver_only(tmp_path: Path) -> None:
    data = gps(TOW) + llh(TOW) + llh(TOW + 100) + llh(TOW, lat=52.0, sender=99) + llh(TOW, lat=53.0, sender=0)
    log = read(tmp_path, data)
    assert log.positions["lat_deg"].tolist() == [51.0, 51.0]
    assert any("sender 12027 are used; those of 99 (1 messages)" in n for n in log.report.notes)


def test_repeated_and_impossible_positions(tmp_path: Path) -> None:
    data = gps(TOW) + llh(TOW) + llh(TOW) + llh(4_000_000_000) + llh(TOW + 100, lat=float("nan"))
    log = read(tmp_path, data + llh(TOW + 200, lat=1e9))
    assert log.positions["t_gps_s"].tolist() == [t_of(TOW)]
    assert log.report.counts["positions_repeated_dropped"] == 1
    assert log.report.losses == {"positions_impossible": 3}


def test_files_that_overlap_or_split_a_message(tmp_path: Path) -> None:
    epochs = [gps(TOW + k) + llh(TOW + k) + event(TOW + k, 3) for k in range(0, 2000, 100)]
    whole = read(tmp_path, b"".join(epochs))
    overlap = read(tmp_path, b"".join(epochs[:12]), b"".join(epochs[8:]))
    data = b"".join(epochs)
    split = read(tmp_path, data[:333], data[333:])
    for log in (overlap, split):
        np.testing.assert_array_equal(log.positions["t_gps_s"], whole.positions["t_gps_s"])
        assert log.report.clean
    assert overlap.report.counts["positions_repeated_dropped"] == 4
    assert read_sbp([tmp_path / "0.sbp", tmp_path / "1.sbp"], chunk_bytes=17).report.clean


def test_gaps_and_unknown_types(tmp_path: Path) -> None:
    data = b"".join(gps(TOW + k) + llh(TOW + k) for k in (0, 100, 200, 900, 1000))
    log = read(tmp_path, data + frame(0xFFF0, b"abc") + frame(sm.POS_LLH, b"abc") + frame(sm.OBS, b"abc"))
    assert [g.lost for g in log.report.gaps] == [6]
    assert log.report.counts["messages_of_unknown_type"] == 1
    assert log.report.losses == {"messages_of_wrong_size": 2}
    assert any("0xFFF0 (1)" in note for note in log.report.notes)


def test_tables_fit_their_kinds(tmp_path: Path) -> None:
    full = gps(TOW) + llh(TOW)
    for data in (full, frame(0xFFF0, b"")):
        log = read(tmp_path, data)
        assert len(log.positions) == (1 if data is full else 0)
        write_table(tmp_path / "t.parquet", log.positions, GNSS_POSITION)
        log.report.to_json()
    assert any("no position with a fix" in note for note in log.report.notes)


BAD = [
    (None, "No such file"),
    (b"", "the file is empty"),
    (b"\x55" * 4000, "not one intact SBP message in 4,000 bytes"),
    (b"> 2017 05 12 18 45 14\n" * 50, "the file begins with 3e 20 32 30"),
    (llh(TOW)[:-1], "not one intact SBP message in 41 bytes"),
    (b"\x00" * 70_000, "Give files as the receiver logs them"),
]


@pytest.mark.parametrize(("data", "message"), BAD)
def test_bad_input_is_refused_with_a_reason(data: bytes | None, message: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.sbp"
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(InputError, match=message) as caught:
        read_sbp([path])
    assert str(path) in str(caught.value)


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no files with SBP messages"):
        read_sbp([])


def test_stamps_behind_the_leap_table_warn(tmp_path: Path) -> None:
    date = struct.pack("<BIHBBBBBI", 1, TOW, 2032, 1, 1, 0, 0, 0, 0)
    with pytest.warns(LeapSecondWarning):
        read(tmp_path, gps(TOW, week=2712) + frame(sm.UTC_TIME, date) + llh(TOW))


def small_log() -> bytes:
    data = frame(sm.BASE_ECEF, struct.pack("<3d", -2706105.2, -4261210.8, 3885598.6), 0)
    for k in range(0, 1200, 100):
        data += gps(TOW + k) + utc(TOW + k, 55) + llh(TOW + k) + cov(TOW + k)
        data += frame(sm.POS_ECEF, struct.pack("<I3dHBB", TOW + k, 3.9e6, 9e5, 4.9e6, 20, 9, 4))
        data += obs(TOW + k) + event(TOW + k, 3) + frame(sm.AGE, struct.pack("<IH", TOW + k, 5))
    return data


def mutate_inside(data: bytes, rng: np.random.Generator) -> bytes:
    """Damage payloads and lengths but keep all checksums right: values that no receiver sends."""
    out = b""
    for kind, sender, start, size in reference(data):
        payload = bytearray(data[start : start + size])
        if rng.random() < 0.3:
            at = int(rng.integers(size))
            payload[at : at + 8] = rng.bytes(min(8, size - at))
        if rng.random() < 0.1:
            payload = bytearray(rng.bytes(size if rng.random() < 0.7 else int(rng.integers(256))))
        out += frame(kind, bytes(payload), sender if rng.random() < 0.95 else int(rng.integers(65536)))
    return out


@pytest.mark.filterwarnings("ignore::thalweg.core.timescales.LeapSecondWarning")
@pytest.mark.parametrize("inside", [False, True])
def test_fuzz_sbp(inside: bool, fuzz: Any, tmp_path: Path) -> None:
    path = tmp_path / "fuzz.sbp"
    for data in fuzz.inputs(small_log(), by=mutate_inside if inside else None):
        path.write_bytes(data)
        try:
            log = read_sbp([path])
        except ThalwegError:
            continue
        fuzz.was_read(reported=not log.report.clean)
        outside = log.report.losses.get("bytes_outside_messages", 0)
        assert log.report.bytes_read == len(data)
        assert 0 <= outside < len(data)
        assert outside == 0 or not inside
        assert log.positions["lat_deg"].abs().max() <= 90 or log.positions.empty
        log.report.to_json()
    fuzz.check(read=0.8, troubled=0.5)
