"""Angles, times and columns of text formats: each limit from both sides, each form by hand."""

from collections import defaultdict
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from thalweg.core import gps_from_unix
from thalweg.ingest import IntegrityReport
from thalweg.ingest.nmea.reader import (
    _apart_m,
    _gps,
    _midnights,
    _one_receiver,
    _prefix,
    _wrapped,
    days_of_date,
    decimals,
    degrees,
    length_m,
    number,
    pitch_and_roll_deg,
    second_of_day,
    stated_depth,
)
from thalweg.ingest.ppk.rinex import _day_second, _year
from thalweg.ingest.tracks.rtklib_pos import Layout, _degrees, _row, layout_from_header, names_columns

ANGLES = """\
5130.60 N NS 51.51
5130.60 S NS -51.51
01330.00 W EW -13.5
9000.0 N NS 90
18000.0 E EW 180
0059.99 N NS 0.99983333333333
9000.1 N NS none
18000.1 E EW none
5160.0 N NS none
-5130.0 N NS none
5130.0 E NS none
5130.0 N EW none
"""


@pytest.mark.parametrize("row", ANGLES.splitlines())
def test_angles_of_sentences(row):
    text, side, sides, value = row.split()
    if value == "none":
        with pytest.raises(ValueError):
            degrees(text, side, sides)
    else:
        assert degrees(text, side, sides) == pytest.approx(float(value), abs=1e-12)


@pytest.mark.parametrize(("text", "side"), [("5130.0", ""), ("", "N")])
def test_angles_of_empty_fields_are_none(text, side):
    with pytest.raises(ValueError):
        degrees(text, side, "NS")


@pytest.mark.parametrize(
    ("text", "second"), [("000000", 0.0), ("235959.5", 86_399.5), ("235960.9", 86_400.9), ("010203", 3723.0)]
)
def test_seconds_of_the_day(text, second):
    assert second_of_day(text) == pytest.approx(second, abs=1e-9)


@pytest.mark.parametrize("text", ["240000", "236000", "235961", "2359", "+12345", "23a959", "235959x"])
def test_times_that_are_none(text):
    with pytest.raises(ValueError):
        second_of_day(text)


def test_dates_numbers_and_lengths_of_sentences():
    assert [days_of_date(6, 1, 80), days_of_date(6, 1, 1980)] == [3657, 3657]
    assert [days_of_date(1, 3, 24), days_of_date(1, 3, 2024), days_of_date(31, 12, 56)] == [
        19_783,
        19_783,
        31_776,
    ]
    for wrong in ((1, 1, 79), (30, 2, 24), (1, 13, 24), (1, 1, 2070), (1, 1, 1979)):
        with pytest.raises(ValueError):
            days_of_date(*wrong)
    assert (number("-1.5"), decimals("1.250"), decimals("7")) == (-1.5, 3, 0)
    assert np.isnan(number(""))
    assert [length_m("10", letter) for letter in ("", "M", "f", "F")] == pytest.approx(
        [10, 10, 3.048, 18.288]
    )
    assert np.isnan(length_m("", "x"))
    for wrong in (lambda: number("inf"), lambda: number("nan"), lambda: length_m("1", "x")):
        with pytest.raises(ValueError):
            wrong()


@pytest.mark.parametrize(
    ("fields", "depth_m", "letter"),
    [
        ({"depth": "3.2"}, 3.2, "M"),
        (
            {"depth": "10.5", "unit": "f", "depth2": "3.2", "unit2": "M", "depth3": "1.7", "unit3": "F"},
            3.2,
            "M",
        ),
        ({"depth": "100.0", "unit": "f", "depth3": "16.7", "unit3": "F"}, 30.48, "f"),
        ({"depth3": "2.0", "unit3": "F"}, 3.6576, "F"),
        ({"depth": "0.0", "unit": "f", "depth2": "3.2", "unit2": "M"}, 3.2, "M"),
        ({"depth": "0.0", "unit": "f"}, 0.0, "f"),
        ({"depth": "99999", "unit": "M"}, 0.0, "M"),
        # 2 % and a unit of both last places: 0.64 m, 0.1 m and 0.0305 m of 32 m
        ({"depth": "107.5", "unit": "f", "depth2": "32.0", "unit2": "M"}, 32.0, "M"),
        ({"depth": "102.5", "unit": "f", "depth2": "32.0", "unit2": "M"}, 32.0, "M"),
        ({}, None, ""),
    ],
)
def test_depths_in_several_units(fields, depth_m, letter):
    depth, found = stated_depth(defaultdict(str, fields), "M")
    assert found == letter
    assert depth == pytest.approx(np.nan if depth_m is None else depth_m, nan_ok=True)


@pytest.mark.parametrize(
    "fields",
    [
        {"depth": "107.6", "unit": "f", "depth2": "32.0", "unit2": "M"},
        {"depth": "102.4", "unit": "f", "depth2": "32.0", "unit2": "M"},
        {"depth": "-1.5", "unit": "M"},
        {"depth": "1.0", "unit": "x"},
        {"depth": "1.0", "unit": "M", "depth2": "1.0", "unit2": "M"},
    ],
)
def test_depths_that_contradict_each_other(fields):
    with pytest.raises(ValueError):
        stated_depth(defaultdict(str, fields), "M")


def test_pitch_and_roll_among_transducers():
    words = "C,21.0,C,AIR,A,-1.5,D,PITCH,A,0.75,D,ROLL_1,A,90.0,D,PTCH,A,7,M,ROLL,G,8,D,ROLL,A,9,D,YAW"
    assert pitch_and_roll_deg(words.split(",")) == {"pitch_deg": 90.0, "roll_deg": 0.75}
    for angle in ("90.1", "-90.1", "x"):
        with pytest.raises(ValueError):
            pitch_and_roll_deg(f"A,{angle},D,ROLL".split(","))


def told() -> IntegrityReport:
    return IntegrityReport(stream="nmea", format="NMEA 0183", files=["a.log"])


@pytest.mark.parametrize(
    ("prefix", "unix_s"),
    [
        (b"100000000000 ", None),  # neither seconds, of nine digits or ten, nor milliseconds
        (b"999999999 ", 999_999_999.0),
        (b"1534758456125 ", 1_534_758_456.125),
        (b"2018-08-20T11:47:36+02:00 ", 1_534_758_456.0),
        (b"2018-13-20T11:47:36Z ", None),
        (b"\\c:1534758456*57\\", 1_534_758_456.0),
        (b"\\c:1534758456*56\\", None),
        (b"hello ", None),
    ],
)
def test_stamps_before_a_sentence(prefix, unix_s):
    found = _prefix(prefix, told())
    assert found == (None if unix_s is None else (unix_s, ""))


def test_the_day_turns_only_at_midnight():
    """Seconds, numbers of files; midnights since the first, files that begin back in time, steps back."""
    for seconds, files, days, back, steps in (
        ([86_399, 0, 1], [0, 0, 0], [0, 1, 1], set(), 0),
        ([86_399, 0, 86_399.5, 1], [0] * 4, [0, 1, 0, 1], set(), 0),  # late
        ([10, 86_390, 20], [0] * 3, [0, 0, 1], set(), 0),  # a day that was recorded from its begin
        ([100, 90, 110], [0] * 3, [0, 0, 0], set(), 1),
        ([100, 90, 110], [0, 1, 1], [0, 0, 0], {1}, 0),
        ([43_300, 99.0], [0, 0], [0, 1], set(), 0),  # more than half a day
        ([43_300, 100.0], [0, 0], [0, 0], set(), 1),  # half a day
        ([86_000, 500, 85_000], [0, 0, 1], [0, 1, 0], {1}, 0),  # overlaps over midnight
        ([86_000, 59, 86_341], [0] * 3, [0, 1, 0], set(), 0),
        ([86_000, 60, 86_341], [0] * 3, [0, 1, 1], set(), 0),
        ([86_000, 59, 86_340], [0] * 3, [0, 1, 1], set(), 0),
    ):
        report = told()
        found, begins_back = _midnights(np.array(seconds, float), np.array(files), report)
        assert found.tolist() == days, seconds
        assert begins_back == back, seconds
        assert report.losses.get("time_steps_back", 0) == steps, seconds
    assert _wrapped(np.array([43_199.0, 43_200.0, -43_200.0, 86_399.0])).tolist() == [
        43_199,
        -43_200,
        -43_200,
        -1,
    ]


def test_a_leap_second_is_one_behind_the_last():
    """The end of 2016: second 60 of 23:59 is a second behind second 59, and one before the new day."""
    t = _gps(np.array([17_166.0] * 3 + [17_167.0]), np.array([86_399.25, 86_400.0, 86_400.5, 0.0]))
    new_day = float(gps_from_unix(17_167 * 86_400.0))
    assert (t - new_day).tolist() == [-1.75, -1.0, -0.5, 0.0]


def track(clock_s, east_m, *, talker="GP", north_m=0.0, step_m=0.2):
    """Fixes on latitude 60, where a minute of longitude is half of one of latitude."""
    east = np.broadcast_to(np.asarray(east_m, float), len(clock_s))
    place = {"lat_deg": 60.0 + north_m / 111_120.0, "lon_deg": 13.0 + east / 55_560.0}
    return pd.DataFrame({"clock_s": clock_s, **place, "talker": talker, "step_m": step_m})


def test_tracks_that_meet_are_measured_against_each_other():
    t = np.arange(10.0)
    own = track(t, 2.0 * t)
    assert _apart_m(own, track(t, 2.0 * t + 3.0, north_m=4.0)) == (pytest.approx(5.0, rel=1e-4), True)
    between = _apart_m(own, track(t + 0.5, 2.0 * t + 1.0, north_m=0.7))
    assert between == (pytest.approx(0.7, rel=1e-4), False)
    assert np.isnan(_apart_m(own, track(t + 20.0, 0.0))[0])  # behind it
    hole = track(np.array([0.0, 1.0, 2.0, 3.0, 6.0]), 0.0)
    assert np.isnan(_apart_m(hole, track(np.array([4.0, 5.0]), 0.0))[0])  # in a hole of three steps
    short = track(np.array([0.0, 1.0, 2.0, 3.0, 5.4]), 0.0)
    assert _apart_m(short, track(np.array([4.0]), 0.0)) == (0.0, False)
    # half a metre, and the rounding of both
    for apart_m, talker, same in ((0.89, "GN", True), (0.91, "GN", False), (0.91, "GP", False)):
        assert _one_receiver(own, track(t, 2.0 * t, north_m=apart_m, talker=talker)) == same
    later = t + 20.0
    for one, other, same in (
        ("GP", "GP", True),
        ("GP", "BD", True),
        ("GP", "II", False),
        ("II", "GN", False),
    ):
        assert _one_receiver(track(t, 0.0, talker=one), track(later, 50.0, talker=other)) == same
    assert _one_receiver(own, track(t + 0.5, 2.0 * t + 30.0))  # one talker, in turn


# ---------------------------------------------------------------- RINEX


def test_days_and_seconds_of_epochs():
    assert _day_second(1980, 1, 6, 0, 0, 0.0) == (0, 0.0)
    assert _day_second(1981, 1, 6, 23, 59, 60.5) == (366, 86_400.5)
    for wrong in (
        (1980, 1, 5, 0, 0, 0.0), (2024, 2, 30, 0, 0, 0.0), (2024, 1, 1, 24, 0, 0.0), (2024, 1, 1, -1, 0, 0.0),
        (2024, 1, 1, 0, 60, 0.0), (2024, 1, 1, 0, -1, 0.0), (2024, 1, 1, 0, 0, 61.0),
        (2024, 1, 1, 0, 0, -0.1),
    ):  # fmt: skip
        with pytest.raises(ValueError):
            _day_second(*wrong)
    assert [_year(n) for n in (79, 80, 99, 0)] == [2079, 1980, 1999, 2000]


# ---------------------------------------------------------------- RTKLIB

DATE = ["2017/05/12", "18:45:13.400"]
PLAIN = "50.1 13.2 200.0"
TAIL = "1 11 0.003 0.002 0.006 -0.001 0.0015 -0.0025 0.40 12.3"
XYZ = "Q ns sdx sdy sdz sdxy sdyz sdzx age ratio"
ENU = "Q ns sde sdn sdu sden sdnu sdue age ratio"
LLH = "Q ns sdn sde sdu sdne sdeu sdun age ratio"


@pytest.mark.parametrize(
    ("line", "form", "dms", "names"),
    [
        (f"{PLAIN} {TAIL}", "llh", False, LLH),
        (f"{PLAIN} {TAIL} 1 2 3", "llh", False, f"{LLH} field_10 field_11 field_12"),
        (f"{PLAIN} 1 11", "llh", False, "Q ns"),
        (f"3.9e6 9e5 4.9e6 {TAIL}", "xyz", False, XYZ),
        (f"91.0 13.0 2.0 {TAIL}", "enu", False, ENU),
        (f"51.0 361.0 2.0 {TAIL}", "enu", False, ENU),
        (f"50 06 00.0 13 12 00.0 200.0 {TAIL}", "llh", True, LLH),
    ],
)
def test_columns_without_a_header(line, form, dms, names):
    fields = line.split()
    layout = layout_from_header([], [*DATE, *fields])
    assert (layout.form, layout.dms, " ".join(layout.names)) == (form, dms, names)
    assert (layout.calendar, layout.scale, layout.geodetic, len(layout.guesses)) == (True, "gps", False, 2)
    assert (layout.n_position, layout.n_fields) == (7 if dms else 3, 2 + len(fields))
    assert not layout_from_header([], ["1948", "499513.4", *fields]).calendar


def test_a_header_names_its_columns():
    sigmas = "sdn(m) sde(m) sdu(m) sdne(m) sdeu(m) sdue(m)"
    plain = f"  UTC   latitude(deg) longitude(deg) height(m)   Q  ns {sigmas} age(s)"
    layout = layout_from_header(["program : x", "(lat/lon/height=WGS84/geodetic,Q=1:fix)", plain], DATE)
    assert (layout.form, layout.scale, layout.geodetic, layout.guesses) == ("llh", "utc", True, ())
    assert layout.names == tuple(LLH.split())[:9]  # the order of RTKLIB, whatever stands above the column
    assert names_columns(plain)
    short = "  GPST  x-ecef(m) y-ecef(m) z-ecef(m) Q ns sdx(m) sdy(m)"
    layout = layout_from_header([short], DATE)
    assert (layout.form, layout.scale, layout.names) == ("xyz", "gps", ("Q", "ns", "sdx", "sdy"))
    for scale, told in (("JST", "jst"), ("TIME", "gps")):
        layout = layout_from_header([short.replace("GPST", scale)], DATE)
        assert (layout.scale, len(layout.guesses)) == (told, scale == "TIME")
    for none in (short.replace(" Q ", " K "), "  GPST Q ns", "ref pos : 50 13 200"):
        assert not names_columns(none)
        assert layout_from_header([none], [*DATE, *f"{PLAIN} {TAIL}".split()]).names == tuple(LLH.split())


LAYOUT = Layout(form="llh", dms=False, calendar=True, scale="gps", geodetic=False, names=("Q", "ns"))


def row(line: str = "2017/05/12 18:45:13.4 50.1 13.2 200.0 1 11", **layout: object) -> list[float] | None:
    return _row(line.split(), replace(LAYOUT, **layout))


def test_numbers_of_a_line():
    day = 17_298 * 86_400.0  # days from 1970 to 12 May 2017
    assert row() == [day + 18 * 3600 + 45 * 60, 13.4, 0.0, 50.1, 13.2, 200.0, 1.0, 11.0]
    assert row("2016/12/31 23:59:60.25 50.1 13.2 200.0 1 11")[1:3] == [59.25, 1.0]
    assert row("2017-05-12 00:00:00 50.1 13.2 200.0 1 11")[0] == day
    week = row("1948 499513.4 50.1 13.2 200.0 1 11", calendar=False)
    assert week[:3] == [315_964_800.0 + 1948 * 604_800, 499_513.4, 0.0]
    dms = row("2017/05/12 0:0:0 -0 30 36.0 13 12 0 200 1 11", dms=True)
    assert dms[3:] == pytest.approx([-0.51, 13.2, 200.0, 1.0, 11.0])
    assert row("2017/05/12 0:0:0 90.0 -360.0 200 1 11") is not None
    assert row("2017/05/12 0:0:0 90.1 999.0 2 1 11", form="enu") is not None


NONE = """\
2017/05/12 24:00:00 50.1 13.2 200.0 1 11
2017/05/12 -1:00:00 50.1 13.2 200.0 1 11
2017/05/12 00:60:00 50.1 13.2 200.0 1 11
2017/05/12 00:-1:00 50.1 13.2 200.0 1 11
2017/05/12 00:00:61 50.1 13.2 200.0 1 11
2017/05/12 00:00:-1 50.1 13.2 200.0 1 11
2017/05/12 00:00 50.1 13.2 200.0 1 11
1948 -0.1 50.1 13.2 200.0 1 11
1948 604801.0 50.1 13.2 200.0 1 11
2017/05/12 0:0:0 90.1 13.0 200 1 11
2017/05/12 0:0:0 -90.1 13.0 200 1 11
2017/05/12 0:0:0 51.0 360.1 200 1 11
2017/05/12 0:0:0 51.0 -360.1 200 1 11
2017/05/12 0:0:0 nan 13.0 200 1 11
2017/05/12 0:0:0 50 13 200 9 11
2017/05/12 0:0:0 50 13 200 1
1900/05/12 18:45:13.4 50.1 13.2 200.0 1 11
"""


@pytest.mark.parametrize("line", NONE.splitlines())
def test_lines_that_are_no_position(line):
    """Times and places beyond their limits, a quality that there is not (9), a column too few."""
    assert row(line, calendar="/" in line) is None


@pytest.mark.parametrize("angle", ["50 60 0", "50 -1 0", "50 0 60.1", "50 0 -1"])
def test_minutes_and_seconds_beyond_their_limits(angle):
    with pytest.raises(ValueError):
        _degrees(angle.split())
