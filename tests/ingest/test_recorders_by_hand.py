"""Messages of autopilots and sounders as tables: each column against numbers worked out by hand."""

import math
import struct

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from tests.ingest.writers import numbers
from thalweg.core import gps_from_week
from thalweg.ingest import NAVIGATION_INITIALISED, IntegrityReport
from thalweg.ingest.recorders.ardupilot import (
    _dataflash_fixes,
    _depths,
    _filter_sigmas,
    _fixes,
    _joined,
    _nearest,
    _of_dataflash,
    _on_earth,
    _states,
)
from thalweg.ingest.recorders.sounders import _clock, _ensemble, _gga, _on_gnss_time, _slanted

WEEK = 2300


def report() -> IntegrityReport:
    return IntegrityReport(stream="ins", format="log", files=["a.bin"])


# ---------------------------------------------------------------- autopilots


def test_the_nearest_fix_and_the_nearest_row_count():
    place = numbers("t_s fix\n 0.0 fixed\n 1.0 single\n 4.0 float")
    found = _nearest(place, np.array([-9.0, 0.4, 0.6, 2.4, 2.6, 9.0]))
    assert found.tolist() == ["fixed", "fixed", "3d", "3d", "float", "float"]
    assert _nearest(place[:1], np.array([-9.0, 9.0])).tolist() == ["fixed", "fixed"]
    assert _nearest(place[:0], np.array([1.0])).tolist() == ["none"]
    assert _nearest(place[["t_s"]], np.array([1.0])).tolist() == ["none"]
    other = numbers("t_s v fix\n 2.0 7.0 x\n 0.9 8.0 y")
    both = _joined(place, other, other[:0])
    assert both["v"].tolist() == [8.0, 8.0, 7.0]
    assert both["fix"].tolist() == ["fixed", "single", "float"]  # its own stay


def test_places_without_a_fix_and_of_damage_are_none():
    table = numbers("""
        lat_deg lon_deg  there status horizontal_m
         51.0     13.0    True    2   0.5
          0.0      0.0   False    3   1.0
          0.0      5.0    True    4   1.0
          5.0      0.0    True    5   0.0
         90.1     13.0   False    6   1.0
        -90.0    180.0    True    6  -1.0
         51.0    180.1   False    6   1.0
         51.0   -180.0    True    1   1.0
    """)
    assert _on_earth(table).tolist() == table["there"].tolist()
    found = _fixes(pd.DataFrame(index=range(8)), {**table.drop(columns="there")})
    assert found["fix"].tolist() == ["2d", "dgnss", "float", "fixed"]
    expected = [0.5 / math.sqrt(2), 1 / math.sqrt(2), np.nan, np.nan]
    assert_allclose(found["sigma_east_m"], expected)
    assert_allclose(found["sigma_north_m"], expected)
    pings = numbers("t_s depth_m sentence\n 1.0 2.0 DPTH\n 2.0 nan DPTH\n 3.0 3.0 DPTH")
    assert _depths(pings, report())[["depth_m", "line"]].to_numpy().tolist() == [[2.0, 1.0], [3.0, 2.0]]
    assert len(_depths(pings[["t_s"]], report())) == 0


def test_states_have_the_place_and_the_sigmas_of_their_time():
    attitude = numbers("""
        t_s roll_rad yaw_rad
        0.5   0.1     -0.5
        1.0   0.2      7.0
        3.0   0.3      0.0
    """)
    place = numbers("""
        t_s lat_deg lon_deg alt_m sigma_up_m sigma_tilt_rad sigma_heading_rad  fix
        0.0  51.0    13.0   100.0    0.1         0.02             0.1         single
        1.0  51.2    13.4   102.0    0.3         0.04             0.2         fixed
        2.0   nan    13.8   104.0    0.5         0.06             0.3         fixed
    """)
    found = _states(attitude, place, 46.5, 1000.0)
    expected = numbers("""
    t_gps_s t_device_s lat_deg lon_deg h_ell_m roll_rad sigma_up_m sigma_heading_rad v_east_mps system_status
     1000.5        0.5    51.1    13.2   147.5      0.1        0.2              0.15        nan             0
     1001.0        1.0    51.2    13.4   148.5      0.2        0.3               0.2        nan             0
     1003.0        3.0     nan     nan     nan      0.3        nan               nan        nan             0
    """)
    tilt = np.array([0.03, 0.04, np.nan]) / math.sqrt(2)
    expected = expected.assign(
        heading_rad=[2 * np.pi - 0.5, 7.0 - 2 * np.pi, 0.0], sigma_roll_rad=tilt, sigma_pitch_rad=tilt,
        filter_status=NAVIGATION_INITIALISED,
    )  # fmt: skip
    pd.testing.assert_frame_equal(found[[*expected]], expected, check_dtype=False, rtol=1e-6)
    assert found["fix"].tolist() == ["fixed", "fixed", "fixed"]  # of two equally near the later one


def receiver(number: int, status: list[int], lead_s: float = 0.0) -> pd.DataFrame:
    n = len(status)
    t = np.arange(n) * 0.2
    return pd.DataFrame(
        {
            "t_s": t, "I": number, "Status": status, "GWk": WEEK, "GMS": 1e3 * (t + 50.0 + lead_s),
            "NSats": 10 + number, "Lat": 51.0 + number, "Lng": 13.0, "Alt": 100.0 + np.arange(n),
        }
    )  # fmt: skip


def test_of_two_receivers_the_one_with_the_better_fixes_counts():
    log = {
        "GPS": pd.concat([receiver(0, [3, 3, 3]), receiver(1, [6, 6, 3])]),
        "GPA": numbers("t_s I HAcc VAcc Und\n 0.0 0 9.0 9.0 -40\n 0.0 1 0.02 0.03 -46.5"),
        "PARM": pd.DataFrame({"Name": [b"SPEED", b"GPS_DELAY_MS", b"X"], "Value": [7.0, 80.0, 9.0]}),
    }
    told = report()
    fixes, offset_s = _dataflash_fixes(log, told)
    assert fixes["lat_deg"].tolist() == [52.0] * 3
    assert fixes["fix"].tolist() == ["fixed", "fixed", "single"]
    assert fixes["n_sats"].tolist() == [11] * 3
    assert_allclose(fixes["h_ell_m"], [146.5, 147.5, 148.5])
    assert_allclose(fixes["sigma_east_m"], 0.02 / math.sqrt(2))
    assert_allclose(fixes["sigma_up_m"], 0.03)
    assert_allclose(fixes["t_gps_s"], gps_from_week(WEEK, 50.0 + 0.2 * np.arange(3)), atol=1e-6)
    assert offset_s == pytest.approx(gps_from_week(WEEK, 50.0) + 0.08, abs=1e-6)
    assert told.notes[0] == "2 GNSS receivers: fixes of number 1, by status, are taken."
    assert "0.08 s late (stated)" in told.notes[1]
    # an older format has the second receiver as a message of its own; the lag is presumed
    old = {"GPS": receiver(0, [3, 3, 3]).drop(columns="I"), "GPS2": receiver(1, [6, 6, 6])}
    fixes, offset_s = _dataflash_fixes(old, told)
    assert fixes["lat_deg"].tolist() == [52.0] * 3
    assert fixes["h_ell_m"].isna().all()
    assert offset_s == pytest.approx(gps_from_week(WEEK, 50.0) + 0.12, abs=1e-6)
    assert "0.12 s late (presumed)" in told.notes[-1]
    # the shortest delay counts, but not that of a receiver that corrects its leap seconds
    jumps = receiver(0, [3] * 6)
    jumps["GMS"] += [0.0, -30.0, 20.0, 0.0, -18_000.0, 0.0]
    offset_s = _dataflash_fixes({"GPS": jumps}, told)[1]
    assert offset_s == pytest.approx(gps_from_week(WEEK, 50.02) + 0.12, abs=1e-6)
    jumps["GWk"] = 1024  # never knew the time
    assert np.isnan(_dataflash_fixes({"GPS": jumps}, told)[1])
    assert len(_dataflash_fixes({}, told)[0]) == 0


def test_the_filter_tells_sigmas_by_its_covariance():
    """Four times the trace of the quaternion's part is that of all angles."""
    log = {
        "XKV1": numbers("""
            t_s C  V00  V01  V02  V03 V04 V05 V06  V07  V08  V09
            1.0 0 1e-4 1e-4 1e-4 2e-4   0   0   0 0.04 0.09 0.25
            1.0 1    1    1    1    1   1   1   1    1    1    1
        """),
        "XKF4": numbers("t_s C errRP\n 1.1 0 0.04\n 1.1 1 9.0"),
    }
    found = _filter_sigmas(log, 0)
    values = found[["sigma_north_m", "sigma_east_m", "sigma_up_m", "sigma_tilt_rad"]].iloc[0].tolist()
    assert values == pytest.approx([0.2, 0.3, 0.5, 0.04])
    assert found["sigma_heading_rad"].tolist() == pytest.approx([math.sqrt(4 * 5e-4 - 0.04**2)])
    assert _filter_sigmas(log, 1)["sigma_heading_rad"].tolist() == [0.0]
    assert _filter_sigmas({"XKV1": log["XKV1"]}, 0).empty


def dataflash(**more: pd.DataFrame) -> dict[str, pd.DataFrame]:
    return {
        "GPS": receiver(0, [3, 3]),
        "GPA": numbers("t_s I HAcc VAcc\n 0.0 0 1.0 2.0"),
        "ATT": numbers("t_s Roll Pitch Yaw\n 0.0 1.0 3.0 90.0\n 1.0 2.0 4.0 180.0"),
        "POS": numbers("t_s Lat Lng Alt\n 0.0 51.0 13.0 100.0\n 1.0 0.0 0.0 0.0"),
        "XKF1": numbers("t_s C VN VE VD\n 0.0 0 1 2 3\n 1.0 0 1 2 3\n 0.0 1 4 5 6\n 1.0 1 4 5 6"),
        "XKF4": numbers("t_s PI C\n 0.0 1 1\n 1.0 1 1"),
        "MSG": pd.DataFrame({"t_s": [0.0, 1.0], "Message": [b"hello", b"ArduRover V4.2\0"]}),
        **more,
    }


def test_a_dataflash_log_by_hand():
    """Attitude in degrees, places that are some, speeds of the filter in use, sigmas of the receiver."""
    told = report()
    ranges = numbers("t_s Dist Orient Stat\n 0.0 1.0 25 4\n 1.0 2.0 0 4\n 2.0 3.0 25 1")
    attitude, place, fixes, depths, _ = _of_dataflash(dataflash(RFND=ranges), told)
    assert_allclose(attitude["roll_rad"], np.deg2rad([1.0, 2.0]))
    assert_allclose(attitude["pitch_rad"], np.deg2rad([3.0, 4.0]))
    assert_allclose(attitude["yaw_rad"], np.deg2rad([90.0, 180.0]))
    assert place[["lat_deg", "lon_deg", "alt_m"]].to_numpy().tolist() == [[51.0, 13.0, 100.0]]
    assert place[["v_north_mps", "v_east_mps", "v_down_mps"]].to_numpy().tolist() == [[4, 5, 6]]
    assert place["sigma_up_m"].tolist() == [2.0]
    assert "receiver's standard deviations" in told.notes[-1]
    assert len(fixes) == 2
    assert depths[["depth_m", "sentence"]].to_numpy().tolist() == [[1.0, "RFND"], [0.0, "RFND"]]
    assert told.model == "ArduRover V4.2"
    # without orientations all count, and the filter's depths go first
    bare = ranges.drop(columns=["Orient", "Stat"])
    assert _of_dataflash(dataflash(RFND=bare), told)[3]["depth_m"].tolist() == [1.0, 2.0, 3.0]
    found = _of_dataflash(dataflash(RFND=bare, DPTH=numbers("t_s Depth\n 0.0 7.0")), told)[3]
    assert found[["depth_m", "sentence"]].to_numpy().tolist() == [[7.0, "DPTH"]]
    assert len(_of_dataflash({}, report())[3]) == 0
    # firmware before 4.0: both rangefinders in a message, the second one looks down here
    old = numbers("t_s Dist1 Orient1 Dist2 Orient2\n 0.0 30.0 0 1.5 25\n 1.0 31.0 0 1.6 25")
    found = _of_dataflash(dataflash(RFND=old), told)[3]
    assert found[["t_s", "depth_m"]].to_numpy().tolist() == [[0.0, 1.5], [1.0, 1.6]]


# ---------------------------------------------------------------- sounders


def gga(
    time: bytes = b"120030.50", lat: float = 51.0, lon: float = 13.0, quality: int = 4, **other: object
) -> bytes:
    """A GGA as WinRiver stores it; ``south``, ``west`` as letters, ``lag_s`` to the ensemble."""
    head = bytes(6) + struct.pack("<d", other.get("lag_s", 0.0)) + bytes(6) + other.get("mark", b"\0")
    place = time.ljust(10, b"\0")[:10] + struct.pack("<d", lat) + other.get("north", b"N")
    return head + place + struct.pack("<d", lon) + other.get("east", b"E") + bytes([quality, 15]) + bytes(8)


def test_fixes_beside_an_ensemble():
    found = _gga(gga(lag_s=0.25))
    expected = "lat_deg lon_deg quality n_sats day_s lag_s\n 51.0 13.0 4.0 15.0 43230.5 0.25"
    assert found == numbers(expected).iloc[0].to_dict()
    other = _gga(gga(north=b"S", east=b"W"))
    assert (other["lat_deg"], other["lon_deg"]) == (-51.0, -13.0)
    assert _gga(gga(lat=0.0))["lon_deg"] == 13.0
    assert _gga(gga(lat=90.0, lon=180.0))["lat_deg"] == 90.0
    for none in (
        gga(quality=0), gga(lat=0.0, lon=0.0), gga(lat=90.5), gga(lon=180.5), gga(time=b"noon"),
        gga(mark=b"$"), gga()[:57],
    ):  # fmt: skip
        assert math.isnan(_gga(none)["lat_deg"])


def test_an_ensemble_by_hand():
    """Of several fixes the nearest in time; bottoms beyond 655.36 m have a third byte."""
    fixed = bytearray(42)
    fixed[5], fixed[26:30] = 2, struct.pack("<2h", 4500, -150)
    variable = bytearray(24)
    variable[4:11] = bytes([24, 5, 17, 12, 0, 30, 50])
    variable[16:24] = struct.pack("<HHhh", 3, 9050, -120, 250)
    bottom = bytearray(81)
    bottom[16:24], bottom[77:81] = struct.pack("<4H", 1000, 1100, 1200, 1300), bytes([0, 1, 0, 2])
    vertical = bytes(4) + struct.pack("<I", 12_345)
    sounder = bytes(26) + struct.pack("<f", 9.5)
    blocks = {
        0x0000: [bytes(fixed)], 0x0080: [bytes(variable)], 0x0600: [bytes(bottom)], 0x4100: [vertical],
        0x2022 + (6 << 16): [sounder],
        0x2022 + (4 << 16): [gga(lag_s=-0.4, lat=52.0), gga(lag_s=0.1), gga(lag_s=0.0, quality=0)],
    }  # fmt: skip
    row = _ensemble(blocks)
    expected = numbers("""
        beam_angle_deg alignment_deg variation_deg heading_deg pitch_deg roll_deg transducer_m vertical_m
             30.0           45.0          -1.5         90.5      -1.2       2.5        0.3       12.345
    """)
    expected = expected.assign(
        sounder_m=9.5, beam0_m=10.0, beam1_m=666.36, beam2_m=12.0, beam3_m=1323.72, lat_deg=51.0, lag_s=0.1,
        rtc_unix_s=pd.Timestamp("2024-05-17T12:00:30.5Z").timestamp(),
    )  # fmt: skip
    assert {name: row[name] for name in expected} == pytest.approx(expected.iloc[0].to_dict())
    bare = _ensemble({0x0000: [bytes(fixed)]})
    assert math.isnan(bare["lat_deg"])
    assert math.isnan(bare["rtc_unix_s"])
    # beams of another angle, as those of a Sentinel V, have it in a byte of its own
    fixed = fixed.ljust(59, b"\x19")
    fixed[5] = 3
    assert _ensemble({0x0000: [bytes(fixed)]})["beam_angle_deg"] == 25.0
    assert math.isnan(_ensemble({})["beam_angle_deg"])
    assert math.isnan(_clock(bytes(4) + bytes([24, 13, 40, 1, 1, 1, 1])))


@pytest.mark.parametrize(
    ("ahead_s", "words"),
    [
        (12.25, "The instrument's clock is 12.25 s behind GNSS."),
        (-30.0, "The instrument's clock is 30.00 s ahead of GNSS."),
        (7200.0, "The instrument's clock is 7,200.00 s behind GNSS: it may show local time."),
        # New Zealand in summer is UTC + 13 h, American Samoa UTC - 11 h: the same time of another day
        (
            39_600.0,
            "The instrument's clock is 39,600.00 s behind GNSS: it may show local time; if that is UTC+13 h, "
            "dates are a day late.",
        ),
    ],
)
def test_the_instruments_clock_is_set_by_the_time_of_day(ahead_s, words):
    """Also across midnight; the median counts."""
    clock = pd.Timestamp("2024-05-17T23:59:50Z").timestamp() + np.arange(5.0)
    day_s = np.mod(clock + ahead_s + [0, 0, 0, 0, 5.0], 86_400.0)
    day_s[1] = np.nan
    told = report()
    found = _on_gnss_time(pd.DataFrame({"rtc_unix_s": clock, "day_s": day_s}), told)
    assert_allclose(found, clock + ahead_s)
    assert told.notes == [words]


def test_ends_of_slanted_beams_by_hand():
    """45 degrees would be as far aside as deep; at heading 90 forward is east, and port north."""
    table = numbers("""
        beam_angle_deg heading_deg variation_deg pitch_deg roll_deg lat_deg lon_deg
             45.0          80.0        10.0         0.0       0.0     60.0    13.0
    """)
    found = _slanted(table, np.array([[10.0, 10.0, 10.0, 0.0]]), np.array([1.7e9]))
    degree = math.pi / 180 * 6_371_000.0
    assert_allclose((found["latitude"] - 60.0) * degree, [10.0, -10.0, 0.0], atol=1e-5)
    assert_allclose((found["longitude"] - 13.0) * degree / 2, [0.0, 0.0, 10.0], atol=1e-5)
    assert_allclose(found["depth_m"], 10.0)
    assert set(found["time"]) == {"2023-11-14T22:13:20.000Z"}
    # pitched up by 45 degrees about the beam forward: it looks along the surface
    ahead = np.array([[0.0, 0.0, 10.0, 0.0]])
    up = _slanted(table.assign(pitch_deg=45.0), ahead, np.array([1.7e9]))
    assert up["depth_m"].iloc[0] == pytest.approx(0.0, abs=1e-9)
    missing = _slanted(table.assign(variation_deg=np.nan), ahead, np.array([1.7e9]))
    east = (missing["longitude"].iloc[0] - 13.0) * degree / 2
    assert east == pytest.approx(10.0 * math.sin(math.radians(80.0)), abs=1e-5)
