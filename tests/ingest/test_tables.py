"""Tables as people and programs write them: what is read, what is asked, what is counted."""

from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pyproj import CRS

from tests.conftest import check_whole, time_limit
from thalweg.core import InputError
from thalweg.core.values import FOOT, US_SURVEY_FOOT, is_nothing
from thalweg.ingest import column_of, read_text_table
from thalweg.ingest.text_tables import _refuse_decimal_commas

UTM = CRS("EPSG:32633")
PLACES = np.array([[412000.0, 5650000.0], [412100.0, 5650100.0], [412030.0, 5650200.0]])


def write(folder: Path, text: str, encoding: str = "utf-8") -> Path:
    path = folder / "table.csv"
    path.write_bytes(text.encode(encoding))
    return path


@pytest.fixture
def read(tmp_path):
    """Reads a table from its text."""
    return lambda text, encoding="utf-8": read_text_table(write(tmp_path, text, encoding))


# ---------------------------------------------------------------- units and values that stand for none


def test_names_of_columns_tell_quantity_and_unit():
    told = {
        ("depth", FOOT.metres): ("WaterDepthFt", "Depth_in_Feet", "DEPTH[Feet]"),
        ("depth", US_SURVEY_FOOT.metres): ("depth_ft_us",),
        ("depth", 1.0): ("Depth (m)",),
        ("depth", 0.01): ("depth_cm",),
        ("northing", None): ("Northing",),
        ("z", None): ("POINT_Z",),
        ("x", None): (" x ",),
        ("easting", 1.0): ("UTM Easting (m)",),
        ("elevation", None): ("Bed elevation",),
    }
    for expected, names in told.items():
        found = [column_of(name) for name in names]
        assert [(each.words, each.unit and each.unit.metres) for each in found] == [expected] * len(names)
    assert column_of("depth_dbar").foreign == "dbar"


def test_units_behind_numbers_count_before_that_of_the_column(read):
    rows = "0,0,10 ft\n1,0,15.5D+01\n2,0,20 cm\n3,0,25\n4,0,0.3 fathom\n5,0,2 m\n6,0,3 m\n"
    table = read(f"x,y,depth (cm)\n{rows}")
    assert table.numbers(table.find("depth")) == pytest.approx([3.048, 1.55, 0.2, 0.25, 0.54864, 2.0, 3.0])
    assert table.notes == [
        f"{n} of 7 cells of column depth (cm) state {unit}, and are read so"
        for n, unit in ((1, "feet"), (1, "fathoms"), (2, "metres"))
    ]


def test_nothing_is_met_exactly():
    depths = [0.0, -9999.0, 999.0, 998.9, 3.4028235e38, np.nan, 2.5, -32768.0]
    assert is_nothing(depths, "depth").tolist() == [True, True, True, False, True, True, False, True]
    assert not is_nothing([0.0, 12.0, -3.0], "height").any()
    assert is_nothing([77.0], "depth", extra=[77.0]).all()
    assert not is_nothing([0.0], "depth", keep=[0.0]).any()


# ---------------------------------------------------------------- rows


def test_rows_that_are_not_taken_are_counted_with_their_first_line(read):
    rows = [f"{412000 + k},5650000,{1 + k / 50:.2f}" for k in range(50)]
    rows[3] = "412003,5650000,-9999"
    rows[7] = "412007,5650000,--"
    rows[9] = "412009,5650000,mud"
    rows[11] = "412011,5650000,-9999"
    rows[13] = "x,y,depth"
    rows[15] = "0,0,1.0"
    table = read("# a logger\n\nx,y,depth\n" + "\n".join(rows))
    assert len(table) == 49
    depth = table.numbers(table.find("depth"), "depth")
    xy = table.places(UTM).xy_m
    assert np.isnan(depth).sum() == 4
    assert np.isnan(xy).any(axis=1).sum() == 1
    told = " ".join(table.loss_notes())
    assert (
        "2 rows with -9999, which stands for no value, in column depth, left out, the first in line 7" in told
    )
    assert "1 row without a value in column depth, left out, the first in line 11" in told
    assert "'mud' for a number in column depth, left out, the first in line 13" in told
    assert "1 row with the names of the columns again, left out, the first in line 17" in told
    assert "1 row with 0, 0, which is no place, in column east, north, left out, the first in line 19" in told


def test_a_large_file_of_numbers_is_the_same_as_a_small_one(tmp_path, read, monkeypatch):
    text = "y x z\n" + "\n".join(f"{5650000 + k} {412000 + 2 * k} {k / 8}" for k in range(60))
    slow = read(text)
    monkeypatch.setattr("thalweg.ingest.text_tables._LARGE", 10)
    fast = read_text_table(tmp_path / "table.csv")
    assert fast.cells[0].dtype.kind == "f"
    assert slow.cells[0].dtype.kind != "f"
    assert_array_equal(fast.places(UTM).xy_m, slow.places(UTM).xy_m)
    assert_array_equal(fast.numbers(2), slow.numbers(2))
    assert fast.text(0) == slow.text(0)
    assert fast.line.tolist() == slow.line.tolist()


REFUSED = {
    "two depths": ("x,y,depth_raw,depth,depth\n1,2,3,4,5\n", "several columns of depth: depth, depth"),
    "text": ("x,y,depth\n" + "412000,5650000,1 m or so\n" * 3, "2 more of 3 rows without a number"),
    "minutes": (
        "lat,lon,depth\n" + "5103.000,01345.000,2\n" * 3,
        "degrees and minutes in one number (ddmm.mmmm)",
    ),
    "integers": ("lat,lon,depth\n" + "510000000,137500000,2\n" * 3, "degrees times 1e7"),
    "no names": ("412000,5650000,1.5,7\n" * 3, "--columns x,y,z"),
    "two units": (
        "x,y,depth (ft)\nm,m,m\n" + "412000,5650000,1.5\n" * 3,
        "'m' as its unit in the line below",
    ),
    "shares": ("x,y,depth (%)\n" + "412000,5650000,1.5\n" * 3, "in %"),
    "a quotation mark": ('x,y,z\n1,2,"3\n4,5,6\n', "quotation mark"),
    "a grid": ("ncols 4\nnrows 2\n1 2 3 4\n", "gdal_translate"),
}


def places_and_depths(path: Path) -> None:
    table = read_text_table(path, bare=("x", "y", "z"))
    table.places(UTM)
    table.numbers(table.find("depth"), "depth")


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_told_is_asked(case, tmp_path):
    text, words = REFUSED[case]
    path = write(tmp_path, text)
    with pytest.raises(InputError) as caught:
        places_and_depths(path)
    assert words in str(caught.value)
    check_whole(caught.value)


@pytest.mark.parametrize(
    ("rows", "refused"),
    [
        (["1,05,2,07", "3,00,4,10"], True),
        (["1,05,2,07", "3,00,4"], False),  # of uneven rows nobody knows
        (["1,5,2,7", "3,6,4,8"], False),  # four numbers without a zero in front
        (["1,05", "3,00"], False),
        (["x,y", "1,5,2,7", "1,5,2,8"], True),  # twice as many as names
        (["x,y", "1,5", "1,5,2,8", "1,2"], False),  # one row is not most of them
        (["a,b,c,d", *["1,05,2,07"] * 4], True),
        (["a,b,c,d", "w,x,y,z", *["1,05,2,07"] * 4], False),  # less than four fifths are numbers
    ],
)
def test_decimal_commas_between_commas(rows, refused):
    with pytest.raises(InputError, match="decimal commas") if refused else nullcontext():
        _refuse_decimal_commas(rows, Path("a.csv"))


def test_decimal_commas_beside_whole_numbers(read):
    """A spreadsheet writes 1 for 1,0."""
    table = read("x;y;depth\n411980;5650000;0,5\n411982;5650000;1\n411984;5650000;1,5\n")
    assert table.numbers(2).tolist() == [0.5, 1.0, 1.5]


@pytest.mark.parametrize("between", ["  ", "\t", ", "])
def test_decimal_commas_between_blanks(read, between):
    rows = ("x y depth", "411980,5 5650000,2 0,5", "411982,5 5650000,4 1,0", "411984,5 5650000,6 1,5")
    table = read("".join(f" {row.replace(' ', between)} \n" for row in rows))
    assert table.numbers(0).tolist() == [411980.5, 411982.5, 411984.5]
    assert table.numbers(2).tolist() == [0.5, 1.0, 1.5]


def test_latin_1_is_read_and_said(read):
    table = read("x;y;z;Gewässer\n1;2;3;Weiße Elster\n", "latin-1")
    assert table.notes == ["The text is no UTF-8 and is read as Windows-1252 (Latin-1)."]
    assert table.text(3) == ["Weiße Elster"]


def test_names_of_rows_that_r_leaves_without_a_name(read):
    table = read('"x" "y" "z"\n"1" 10 20 30\n"2" 11 21 31\n')
    assert [c.name for c in table.columns] == ["row", "x", "y", "z"]
    assert table.numbers(table.find("east")).tolist() == [10.0, 11.0]


def test_lines_above_the_names_may_hold_values(read):
    text = "Boat export\nSite: Elbe\nDate: 2024-06-18\n\nEasting Northing Depth\n" + "1 2 3.5\n2 3 3.6\n" * 4
    table = read(text)
    assert table.listed() == "Easting, Northing, Depth"
    assert table.numbers(2).tolist() == [3.5, 3.6] * 4
    assert table.line.tolist() == list(range(6, 14))


def test_parts_of_angles_are_no_angles(tmp_path):
    """Degrees, minutes and seconds in three columns: the minutes are no latitude."""
    table = read_text_table(
        write(tmp_path, "lat_d,lat_m,lat_s,lon_d,lon_m,lon_s,depth (in)\n51,3,5,13,15,0,60\n")
    )
    with pytest.raises(InputError, match="expected coordinates"):
        table.places(UTM)
    assert table.numbers(6, "depth").tolist() == [1.524]


def test_nines_beyond_all_other_depths_stand_for_none(read):
    """99.9 m in a pond of 2 m; in a lake of 60 m it is a depth, and where a user says so."""
    pond, lake = "depth\n1.5\n99.9\n2.0\n", "depth\n60\n99.9\n50\n"
    assert np.isnan(read(pond).numbers(0, "depth")).tolist() == [0, 1, 0]
    assert np.isfinite(read(pond).numbers(0, "depth", keep=[99.9])).all()
    assert np.isfinite(read(lake).numbers(0, "depth")).all()


def test_a_single_zero_far_from_all_heights_stands_for_none(read):
    heights = read("z\n97.1\n97.2\n0\n97.0\n97.4\n97.3\n")
    assert np.isnan(heights.numbers(0, "height")).tolist() == [0, 0, 1, 0, 0, 0]
    assert np.isfinite(heights.numbers(0, "height", keep=[0.0])).all()
    assert np.isfinite(read("z\n1.1\n0.7\n0\n0.5\n1.9\n1.2\n").numbers(0, "height")).all()


def test_rows_of_heights_and_their_sigmas(read):
    """Which of two heights, 95 % and a datum are said; two columns of one name are refused."""
    names = {"z": ("z", "height", "elevation"), "sigma_up_m": ("sigma_z",)}
    table = read("x,height (m NHN),elevation,sigma_z_95\n1,151,106,0.0392\n2,152,107,0.0196\n")
    found = table.rows(names)
    assert [row["z"] for row in found] == ["151", "152"]
    assert [float(row["sigma_up_m"]) for row in found] == pytest.approx([0.02, 0.01])
    told = " ".join(table.notes)
    for words in ("datum is not read", "taken as the height, not elevation", "divided by 1.96"):
        assert words in told
    with pytest.raises(InputError, match="several columns of z: z, z"):
        read("x,z,z\n1,151,106\n2,152,107\n").rows(names)
    assert len(read("x,z,z\n1,151,151\n2,152,152\n").rows(names)) == 2


def test_names_in_other_languages_are_quantities(read):
    for head in ("Est;Nord;Profondità", "Este;Norte;Profundidad (m)", "X/Ost;Y/Nord;Wassertiefe [m]"):
        table = read(f"{head}\n1;2;3\n2;3;4\n")
        assert [table.find(q) for q in ("east", "north", "depth")] == [0, 1, 2], head


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("110001+00000001 81..10+00377300 82..10+05656850\n", "Leica GSI"),
        ("<html><table><tr><td>lat</td></tr></table></html>", "a page or a workbook in XML"),
        (
            "2\n1\n10 20 3\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n10 20 3 1\n1.5 2.5 0.1 0.5\n",
            "a laser scan in PTX",
        ),
    ],
)
def test_files_of_another_form_are_named(read, text, words):
    with pytest.raises(InputError, match=words) as caught:
        read(text)
    check_whole(caught.value)


def test_a_line_of_dashes_below_the_names(tmp_path):
    table = read_text_table(
        write(tmp_path, "  East  North  Depth\n  ----  -----  -----\n" + "  10.0  20.0  1.5\n" * 3)
    )
    assert table.listed() == "East, North, Depth"
    assert table.numbers(2).tolist() == [1.5] * 3


# ---------------------------------------------------------------- angles and times


def test_longitudes_counted_all_around(read):
    table = read("lat,lon\n44.5,286.75\n44.5,286.76\n")
    assert_allclose(table.angles("lon"), [-73.25, -73.24], atol=1e-12)


def test_angles_as_people_write_them(read):
    rows = [
        "51.0515;13.25",
        "51 3 5.4;13 15 0",
        "51°03'05.4\"N;13°15'00\"E",
        "N51.0515;E13.25",
        "51 3.09 N;13 15 E",
    ]
    table = read("lat;lon\n" + "\n".join(rows) + "\n")
    assert_allclose(table.angles("lat"), 51.0515, atol=1e-12)
    assert_allclose(table.angles("lon"), 13.25, atol=1e-12)


TIMES = """\
time | 2024-06-12T10:00:00Z ; 2024-06-12T10:00:01.5Z | 2024-06-12T10:00:00 |
time | 2024-06-12T12:00:00+02:00 ; 2024-06-12 12:00:01+02:00 | 2024-06-12T10:00:00 |
Timestamp | 2024-06-12 10:00:00 ; 2024-06-12 10:00:01 | 2024-06-12T10:00:00 | no zone
date,time | 12.06.2024,10:00:00 ; 12.06.2024,10:00:01 | 2024-06-12T10:00:00 | no zone
date,time | 06/12/2024,10:00:00 ; 06/13/2024,10:00:01 | 2024-06-12T10:00:00 | no zone
epoch | 1718186400 ; 1718186401 | 2024-06-12T10:00:00 | seconds since 1970
time | 1718186400000 ; 1718186401000 | 2024-06-12T10:00:00 | milliseconds since 1970
gps_time | 1402221618 ; 1402221619 | 2024-06-12T10:00:00 | 2014-06-08 in
unix | 1402221618 ; 1402221619 | 2014-06-08T10:00:18 | 2024-06-12 in
time | 402221618 ; 402221619 | 2024-06-12T10:00:00 | less 1e9
Datum,Uhrzeit | 12.06.2024,10:00:00 ; 12.06.2024,10:00:01 | 2024-06-12T10:00:00 | no zone
date,clock | 13/06/2024,10:00:00 ; 13/06/2024,10:00:01 | 2024-06-13T10:00:00 | no zone
date | 2024-06-12 ; 2024-06-12 | 2024-06-12T00:00:00 | days without a time
Date,Time | 20240612,100000 ; 20240612,100001 | 2024-06-12T10:00:00 | no zone
Time | 12-Jun-2024 10:00:00 ; 12-Jun-2024 10:00:01 | 2024-06-12T10:00:00 | no zone
time,week,tow | 2024-06-12T10:00:00Z,2318,1 ; 2024-06-12T10:00:01Z,2318,2 | 2024-06-12T10:00:00 |
time,gps_time,stamp | 10:00:00,1402221618,a ; 10:00:01,1402221619,a | 2024-06-12T10:00:00 | not of time
week,tow | 2318,295218.0 ; 2318,295219.0 | 2024-06-12T10:00:00 | GPS weeks and seconds
Date/Time | 6/13/2024 1:30:00 PM ; 6/13/2024 1:30:01 PM | 2024-06-13T13:30:00 | no zone
"""
"""Names of columns, two rows, the first time in UTC, and what is noted."""


@pytest.mark.parametrize("case", TIMES.splitlines())
def test_times(read, case):
    head, rows, first, note = (part.strip() for part in case.split("|"))
    table = read(f"{head},x\n" + "".join(f"{row.strip()},1\n" for row in rows.split(";")))
    unix, notes = table.times()
    assert unix[0] == pytest.approx(pd.Timestamp(first, tz="UTC").timestamp(), abs=1e-6)
    assert (note in " ".join(notes)) if note else not notes


def test_times_that_are_not_understood_are_said(read):
    """Day numbers of a spreadsheet, and seconds of a day: no time is made up, and the column is named."""
    for value in ("45461.39583", "12 o'clock"):
        unix, notes = read(f"time,x\n{value},1\n{value},2\n").times()
        assert np.isnan(unix).all()
        assert notes == [f"column time is not read: '{value}' is no time with a date"]


def test_days_and_months_that_may_be_exchanged_are_asked_about(read):
    table = read("date,x\n03/04/2024,1\n03/05/2024,1\n")
    with pytest.raises(InputError, match="dates such as 03/04/2024") as caught:
        table.times()
    check_whole(caught.value)


# ---------------------------------------------------------------- places


def test_a_map_in_feet_comes_into_metres(read):
    """New York in feet of the US survey: by the CRS, by the names of the columns, by degrees."""
    feet, metres = CRS("EPSG:2263"), np.array([[300_000.0, 65_000.0], [300_100.0, 65_020.0]])
    foot = 1200 / 3937
    rows = "".join(f"{e!r},{n!r}\n" for e, n in (metres / foot).tolist())
    own = read("x,y\n" + rows).places(feet)
    assert own.xy_m == pytest.approx(metres, abs=1e-6)
    assert own.crs.axis_info[0].unit_name == "metre"
    assert "taken in the unit of NAD83 / New York Long Island (ftUS)" in own.notes[0]
    rows = "".join(f"{e},{n}\n" for e, n in metres.tolist())
    named = read("x_m,y_m\n" + rows).places(feet)
    assert named.xy_m == pytest.approx(metres, abs=1e-6)
    table = read("x,y\n" + rows)
    with pytest.raises(InputError, match="used from"):
        table.places(feet)


def test_a_line_of_a_megabyte_is_no_name_for_long():
    """Each of its brackets was looked for to its end: minutes."""
    with time_limit(5.0, "a line of brackets"):
        assert column_of("[" * 1_000_000).unit is None
