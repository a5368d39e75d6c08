"""Angles, times and columns of text formats: each limit from both sides, each form by hand."""

from dataclasses import replace

import pytest

from thalweg.ingest.nmea.reader import degrees
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
