"""Logs of ArduPilot: made here message by message, and real ones beside pymavlink's own counts."""

import struct
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from tests.ingest.writers import new_campaign, noted, read_or_refused, sounded
from thalweg.cli import main
from thalweg.core import InputError, gps_from_unix, gps_from_week
from thalweg.ingest import PoseLog, TrackOptions
from thalweg.ingest.photos import read_image_stamps
from thalweg.ingest.recorders import USUAL_LAG_S, read_ardupilot
from thalweg.ingest.registry import describe, read_depths, recognise, stream_of

SIZES = {"c": "h", "C": "H", "L": "i", "E": "I", "N": "16s", "Z": "64s"}
"""Of formats that `struct` writes with another letter."""
SCALES = {"c": 0.01, "C": 0.01, "L": 1e-7, "E": 0.01}
FORMATS = """\
GPS QBBIHBCLLf TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt
GPA QBCCCf TimeUS,I,VDop,HAcc,VAcc,Und
ATT Qccc TimeUS,Roll,Pitch,Yaw
POS QLLf TimeUS,Lat,Lng,Alt
XKF4 QBfB TimeUS,C,errRP,PI
XKV1 QBffffffffff TimeUS,C,V00,V01,V02,V03,V04,V05,V06,V07,V08,V09
DPTH QLLf TimeUS,Lat,Lng,Depth
RFND QBfBB TimeUS,Instance,Dist,Stat,Orient
PARM QNf TimeUS,Name,Value
MSG QZ TimeUS,Message
CAM QBH TimeUS,I,Img
"""
MESSAGES = {row.split()[0]: (kind, *row.split()[1:]) for kind, row in enumerate(FORMATS.splitlines(), 130)}
WEEK, LAG_S = 2300, 0.2


def layout(form: str) -> str:
    return "<" + "".join(SIZES.get(c, c) for c in form)


def packed(name: str, *values: object) -> bytes:
    kind, form, _ = MESSAGES[name]
    raw = [
        v.encode() if isinstance(v, str) else round(v / SCALES[c]) if c in SCALES else v
        for c, v in zip(form, values, strict=True)
    ]
    return bytes([0xA3, 0x95, kind]) + struct.pack(layout(form), *raw)


def heads() -> bytes:
    out = b""
    all_kinds = {"FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns"), **MESSAGES}
    for name, (kind, form, columns) in all_kinds.items():
        length = 89 if name == "FMT" else 3 + struct.calcsize(layout(form))
        words = (each.encode() for each in (name, form, columns))
        out += struct.pack("<BBBBB4s16s64s", 0xA3, 0x95, 128, kind, length, *words)
    return out


def boat_log(*, und_m: float = -46.5, delay_ms: float = 0.0, depth: str = "DPTH", gps: bool = True) -> bytes:
    """Two crossings of a river in 60 s at 10 Hz, 4 m deep; a receiver whose fixes come `LAG_S` late."""
    out = [
        heads(),
        packed("PARM", 1_000, "GPS1_DELAY_MS", delay_ms),
        packed("MSG", 1_000, "ArduRover V4.5.1 (ab)"),
    ]
    for k in range(600):
        us = 50_000_000 + 100_000 * k
        lat, lng = 51.0 + 2e-5 * abs(k - 300) / 10, 13.0 + 3e-6 * k / 10
        out.append(packed("ATT", us, 1.5, -0.5, 10.0))
        out.append(packed("POS", us + 700, lat, lng, 100.0))
        if k % 2 == 0 and gps:  # the epoch before its arrival
            ms = 100_000_000 + 100 * k - round(1e3 * LAG_S)
            out.append(packed("GPS", us, 0, 6, ms, WEEK, 20, 0.6, lat, lng, 100.0))
            out.append(packed("GPA", us, 0, 1.0, 0.02, 0.03, und_m))
        if k % 5 == 0:
            for core, scale in ((0, 9.0), (1, 1.0)):
                out.append(packed("XKF4", us, core, 0.006 * scale**0.5, 1))
                v = [2.1447e-4, 4.466e-6, 4.474e-6, 1.9831e-5, 1.0, 1.0, 1.0, 0.0004, 0.0009, 0.0016]
                out.append(packed("XKV1", us, core, *(scale * x for x in v)))
        if depth == "DPTH":
            out.append(packed("DPTH", us + 20_000, lat, lng, 4.0 + 0.1 * (k % 3)))
        else:
            out.append(packed("RFND", us + 20_000, 0, 4.0, 4 if k % 10 else 2, 25))
            out.append(packed("RFND", us + 20_000, 1, 30.0, 4, 0))  # looks ahead
    return b"".join(out)


def read(path: Path) -> PoseLog:
    return read_ardupilot([path], TrackOptions())


@pytest.fixture
def boat(saved):
    return saved("00000042.BIN", boat_log())


def test_a_boat_has_attitude_place_depth_and_their_sigmas_on_gps_time(boat):
    log = read(boat)
    assert log.report.model == "ArduRover V4.5.1 (ab)"
    assert (len(log.states), len(log.positions), len(log.depths)) == (600, 300, 600)
    # boot second 50 is when the fix of the epoch LAG_S before it came: the usual lag is presumed
    at_boot_50 = float(gps_from_week(WEEK, 100_000.0)) - LAG_S + USUAL_LAG_S
    assert log.states["t_gps_s"].iloc[0] == pytest.approx(at_boot_50, abs=1e-4)
    assert log.depths["t_gps_s"].iloc[0] == pytest.approx(at_boot_50 + 0.02, abs=1e-4)
    assert log.positions["t_gps_s"].iloc[0] == pytest.approx(
        float(gps_from_week(WEEK, 100_000.0)) - LAG_S, abs=1e-6
    )
    row = log.states.iloc[300]
    assert np.rad2deg([row.roll_rad, row.pitch_rad, row.heading_rad]) == pytest.approx(
        [1.5, -0.5, 10.0], abs=1e-3
    )
    assert row.h_ell_m == pytest.approx(146.5, abs=1e-3)
    assert set(log.states["fix"]) == {"fixed"}
    assert (row.sigma_north_m, row.sigma_east_m, row.sigma_up_m) == pytest.approx(
        (0.02, 0.03, 0.04), rel=1e-5
    )
    assert row.sigma_roll_rad == pytest.approx(0.006 / np.sqrt(2), rel=1e-5)
    # a turn by 1.754 deg about the vertical at heading 214 gives these quaternions, by hand
    assert np.rad2deg(row.sigma_heading_rad) == pytest.approx(1.754, abs=0.005)
    fix = log.positions.iloc[0]
    assert (fix.fix, fix.n_sats, fix.h_ell_m) == ("fixed", 20, pytest.approx(146.5))
    assert fix.sigma_east_m == pytest.approx(0.02 / np.sqrt(2))
    assert fix.sigma_up_m == pytest.approx(0.03)


def test_camera_triggers_are_times_of_photographs(boat, tmp_path):
    """Three shots 2.5 s apart from second 60 of the boot; photographs go by their numbers."""
    boat.write_bytes(
        boat.read_bytes() + b"".join(packed("CAM", 60_000_000 + 2_500_000 * k, 0, k) for k in range(3))
    )
    photos = tmp_path / "photos"
    photos.mkdir()
    for name in ("DSC_9.jpg", "DSC_10.jpg", "DSC_11.jpg"):
        Image.new("RGB", (8, 8)).save(photos / name)
    found = read_image_stamps(photos, times=boat)
    assert found.table["file"].tolist() == ["DSC_9.jpg", "DSC_10.jpg", "DSC_11.jpg"]
    first = float(gps_from_week(WEEK, 100_010.0)) - LAG_S + USUAL_LAG_S
    assert found.table["t_device_s"].to_numpy() == pytest.approx(first + 2.5 * np.arange(3), abs=1e-4)
    assert noted(found, "arrive 0.12 s late (presumed)")
    assert noted(describe(boat), "3 camera triggers: named in logs.time_lapse.times")
    (photos / "DSC_12.jpg").write_bytes((photos / "DSC_9.jpg").read_bytes())
    with pytest.raises(InputError, match="3 camera triggers beside 4 photographs"):
        read_image_stamps(photos, times=boat)


def test_the_driver_of_novatel_counts_undulations_upwards(saved):
    path = saved(
        "flight.tlog", boat_log(und_m=46.5).replace(b"ArduRover V4.5.1 (ab)", b"GPS 1: detected NOVA ")
    )
    assert read(path).positions["h_ell_m"].iloc[0] == pytest.approx(146.5)


@pytest.mark.parametrize("und_m", [float("nan"), 0.0])
def test_without_undulation_there_is_no_ellipsoidal_height(saved, und_m):
    path = saved("flight.tlog", boat_log(und_m=und_m))
    log = read(path)
    assert log.states["h_ell_m"].isna().all()
    assert noted(log, "above mean sea level")


def test_damage_is_counted(boat):
    data = boat.read_bytes()
    boat.write_bytes(data[:40_000] + b"\0" * 100 + data[40_000:-7])
    log = read(boat)
    assert log.report.losses["bytes_outside_messages"] >= 100
    assert len(log.states) >= 598


def test_a_log_without_gps_stays_on_the_clock_of_the_device(saved):
    path = saved("flight.tlog", boat_log(gps=False))
    report = describe(path)
    assert not report.synchronised
    assert noted(report, "No GPS time")


def test_soundings_of_a_log_make_a_bed(boat):
    assert (recognise(boat), stream_of("dataflash", boat)) == ("dataflash", "ins")
    soundings = sounded(boat, None)
    assert soundings.depth
    assert soundings.crs.to_epsg() == 32633
    assert -soundings.height_m.mean() == pytest.approx(4.1, abs=0.01)
    assert noted(soundings, "without a position at their time")


def telemetry(
    *, unix_s: float = 1.7e9, component: int = 1, system: int = 1, n: int = 100, ranges_cm: Any = (),
    signed: bool = False, said: Sequence[str] = (), raw_from_us: int = 0,
) -> bytes:  # fmt: skip
    """Five a second; of the eighth a receiver without heights and sigmas, of the ninth no place."""
    vehicle = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
    if signed:  # 13 bytes more behind each
        vehicle.signing.secret_key, vehicle.signing.sign_outgoing = bytes(32), True
    out = []

    def say(message: mavlink.MAVLink_message, t_s: float) -> None:
        out.append(struct.pack(">Q", round(1e6 * (1.65e9 + t_s))) + message.pack(vehicle))

    for text in said:
        say(mavlink.MAVLink_statustext_message(6, text), 0.0)
    for k in range(n):
        boot_ms, t_s = 20_000 + 200 * k, 0.2 * k
        place = (round(1e7 * (51 + 2e-6 * k)), round(1e7 * (13 + 1e-6 * k)))
        say(mavlink.MAVLink_system_time_message(round(1e6 * (unix_s + t_s)) if unix_s else 0, boot_ms), t_s)
        say(mavlink.MAVLink_attitude_message(boot_ms, 0.01, -0.02, -1.0, 0.1, 0.2, 0.3), t_s)
        there = (*((0, 0) if k == 8 else place), 101_000, 1_000, 100, 50, -20, 30_000)
        say(mavlink.MAVLink_global_position_int_message(boot_ms, *there), t_s)
        fix, n_sats, *more = (3, 255, 0, 0, 0) if k == 7 else (6, 15, 147_500, 28, 40)
        raw = (raw_from_us + 1000 * boot_ms, fix, *place, 101_000, 80, 90, 100, 0, n_sats)
        say(mavlink.MAVLink_gps_raw_int_message(*raw, *more), t_s)
        for number, cm in enumerate(ranges_cm[k] if ranges_cm else ()):
            say(mavlink.MAVLink_distance_sensor_message(boot_ms, 30, 5000, cm, 1, number, 25, 0), t_s)
            say(mavlink.MAVLink_distance_sensor_message(boot_ms, 30, 5000, 900, 1, number, 0, 0), t_s)
        if not ranges_cm:
            depth = (boot_ms, 0, k != 3, *place, 101.0, 0.0, 0.0, 0.0, 2.5, 12.0)
            say(mavlink.MAVLink_water_depth_message(*depth), t_s)
    for time_s in (24.0, unix_s + 4.0) if unix_s else ():  # feedback of an old and of a new autopilot
        place = (510_000_000, 130_000_000, 101.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0)
        say(mavlink.MAVLink_camera_feedback_message(round(1e6 * time_s), 1, 0, 7, *place), 4.0)
    return b"".join(out)


def test_telemetry_gives_the_same_tables(saved):
    path = saved("flight.tlog", telemetry(said=(b"hello", b"ArduRover V4")))
    assert recognise(path) == "mavlink"
    log = read(path)
    state = log.states.iloc[50]
    assert state.t_gps_s == pytest.approx(float(gps_from_unix(1.7e9 + 10.0)), abs=1e-3)
    assert (state.roll_rad, state.pitch_rad) == pytest.approx((0.01, -0.02))
    assert state.heading_rad == pytest.approx(2 * np.pi - 1.0)
    assert (state.v_north_mps, state.v_east_mps, state.v_down_mps) == pytest.approx((1.0, 0.5, -0.2))
    rates = (state.rate_x_radps, state.rate_y_radps, state.rate_z_radps)
    assert rates == pytest.approx((0.1, 0.2, 0.3))
    assert state.h_ell_m == pytest.approx(147.5)
    for row in (state, log.positions.iloc[50]):
        assert (row.lat_deg, row.lon_deg) == pytest.approx((51.0001, 13.00005), abs=1e-9)
    assert log.states["lat_deg"].iloc[8] == pytest.approx(51.000016, abs=2e-7)  # between its neighbours
    assert log.report.model == "ArduRover V4"
    fixes = log.positions[["fix", "n_sats", "h_ell_m", "sigma_east_m", "sigma_up_m"]].iloc[6:8]
    expected = [["fixed", 15, 147.5, 0.028 / np.sqrt(2), 0.04], ["single", -1, None, None, None]]
    assert fixes.replace({np.nan: None}).to_numpy().tolist() == expected
    assert (state.sigma_north_m, state.sigma_up_m) == pytest.approx((0.028 / np.sqrt(2), 0.040))
    assert log.depths["depth_m"].value_counts().to_dict() == {2.5: 99, 0.0: 1}
    assert log.triggers_gps_s == pytest.approx([float(gps_from_unix(1.7e9 + 4.0))] * 2, abs=1e-3)


def test_signed_telemetry_is_recognised(saved):
    path = saved("flight.tlog", telemetry(signed=True))
    assert len(path.read_bytes()) == len(telemetry()) + 13 * (5 * 100 + 2)
    assert recognise(path) == "mavlink"
    assert len(read(path).states) == 100


@pytest.mark.parametrize("unix_s", [1.7e9, 0.0])
def test_fixes_may_be_stamped_since_1970(saved, unix_s):
    """MAVLink leaves it open; without SYSTEM_TIME nothing ties them to the clock of all others."""
    path = saved("flight.tlog", telemetry(unix_s=unix_s, raw_from_us=1_699_999_980_000_000))
    log = read(path)
    t = log.positions["t_gps_s"].to_numpy()
    np.testing.assert_allclose(t, log.states["t_gps_s"] if unix_s else [], atol=1e-3)
    assert log.report.losses.get("fixes_on_another_clock", 0) == (0 if unix_s else 100)


def test_telemetry_without_a_clock_has_no_gps_time(saved):
    path = saved("flight.tlog", telemetry(unix_s=0.0))
    report = describe(path)
    assert not report.synchronised
    assert noted(report, "ground station received it 2022-04-15")


def test_what_a_ground_station_says_is_not_the_vehicles(saved):
    path = saved("flight.tlog", telemetry(component=190))
    with pytest.raises(InputError, match="neither attitudes, positions nor depths"):
        describe(path)


@pytest.mark.parametrize("other", [{"system": 2}, {"unix_s": 1.8e9}])
def test_of_two_vehicles_or_two_starts_one_is_taken(saved, other):
    path = saved("flight.tlog", telemetry(n=60, **other) + telemetry())
    log = read(path)
    assert len(log.states) == 100
    assert log.report.counts["messages_of_other_vehicles_or_starts"] == 302
    assert log.states["t_gps_s"].iloc[50] == pytest.approx(float(gps_from_unix(1.7e9 + 10.0)), abs=1e-3)
    assert noted(log, "start with most messages is taken")


def test_of_two_sounders_one_is_taken_and_what_lies_outside_its_reach_is_no_bottom(saved):
    path = saved("flight.tlog", telemetry(n=20, ranges_cm=[(410, 5000 if k % 2 else 0) for k in range(20)]))
    log = read(path)
    assert set(log.depths["depth_m"]) == {4.1}
    assert log.report.counts["pings_of_other_sounders"] == 20
    path.write_bytes(
        telemetry(n=20, ranges_cm=[(5001 if k % 3 else 5000 if k % 4 else 410,) for k in range(20)])
    )
    assert read(path).depths["depth_m"].value_counts().to_dict() == {0: 18, 4.1: 2}


@pytest.mark.real
def test_real_logs_are_as_pymavlink_counts_them(data_dir):
    today = data_dir / "today"
    plane = read(today / "ardupilot_pymavlink/test.BIN")
    assert (len(plane.positions), len(plane.states)) == (5, 24)
    assert plane.positions["t_gps_s"].iloc[0] == pytest.approx(float(gps_from_week(1973, 6448.0)))
    first = plane.positions.iloc[0]
    assert (first.lat_deg, first.lon_deg) == pytest.approx((-35.3626277, 149.1653034), abs=1e-9)
    sub = describe(today / "mavlink_ardusub/small.BIN")
    assert sub.counts["states"] == 237
    assert not sub.synchronised
    far = read(today / "mavlink_ardusub/small.tlog")
    assert far.report.losses == {"bad_messages": 4}
    assert (far.report.details["messages"]["ATTITUDE"], len(far.states)) == (5245, 5245)
    assert not far.report.synchronised


def test_one_file_stands_in_each_stream_that_it_holds(boat, tmp_path, capsys):
    path = new_campaign(boat.parent, tmp_path / "campaigns")
    assert main(["check-config", str(path)]) == 0
    assert "files: 1 ins, 1 depth" in capsys.readouterr().out


def test_damaged_logs_are_read_or_refused(tmp_path, fuzz):
    read, logs = partial(read_ardupilot, options=TrackOptions()), (boat_log()[:20_000], telemetry()[:9_000])
    for data, log in read_or_refused(fuzz, tmp_path / "fuzz.bin", read, *logs):
        assert len(log.states) + len(log.positions) <= len(data) / 12
        for table in (log.states, log.positions):
            assert table["lat_deg"].dropna().abs().le(90).all()
            assert table["lon_deg"].dropna().abs().le(180).all()
    fuzz.check(read=0.7, troubled=0.2)


def test_a_stated_lag_counts(tmp_path):
    path = tmp_path / "log.bin"
    path.write_bytes(boat_log(delay_ms=1e3 * LAG_S))
    log = read_ardupilot([path], TrackOptions())
    assert log.states["t_gps_s"].iloc[0] == pytest.approx(float(gps_from_week(WEEK, 100_000.0)), abs=1e-4)
    assert any("0.20 s late (stated)" in note for note in log.report.notes)


def test_rangefinders_count_where_they_look_down_and_see_the_bottom(tmp_path):
    path = tmp_path / "log.bin"
    path.write_bytes(boat_log(depth="RFND"))
    depths = read_depths([path]).depths
    assert depths["depth_m"].value_counts().to_dict() == {4.0: 540, 0.0: 60}
