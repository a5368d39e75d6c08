"""What a file states in words, units, signs and places decides; what contradicts it is refused."""

import json
from pathlib import Path

import laspy
import numpy as np
import pandas as pd
import pytest
from pyproj import CRS, Transformer

from thalweg.bathymetry import Levels, read_soundings
from thalweg.core import GPS_EPOCH_UNIX_S, InputError, ThalwegError, read_opencv
from thalweg.core.values import far_repeated, is_nothing
from thalweg.deformation.foreign.clouds import read_points
from thalweg.images import read_marks
from thalweg.ingest import GNSS_POSITION, IntegrityReport, PositionLog, read_places, read_text_table
from thalweg.ingest.clouds import read_cloud
from thalweg.ingest.moments import _unix_of_numbers, past_midnight, stated_zone
from thalweg.ingest.registry.poses import doubtful_heading
from thalweg.ingest.tracks import read_sbet, read_text_poses

N = 60
EAST, NORTH = 412_000 + 5.0 * (np.arange(N) % 12), 5_650_000 + 9.0 * (np.arange(N) // 12)
DEPTH = np.round(1.9 + 0.9 * np.sin(np.arange(N) / 5.0), 3)
UTM = CRS(25833)
TEN = 1_718_186_400.0
"""2024-06-12T10:00:00Z."""


def rows(path: Path, head: str, *columns: object, above: str = "", below: str = "") -> Path:
    """A table with commas."""
    table = pd.DataFrame(dict(enumerate(columns)))
    path.write_text(f"{above}{head}\n{table.to_csv(index=False, header=False)}{below}")
    return path


def soundings(path: Path, crs: CRS | None = UTM) -> np.ndarray:
    """Heights of the bed in the order of the file."""
    found = read_soundings(path, crs, column=None, depth=None, level_m=None, line_column=None, sigma_m=0.02)
    return found.height_m


@pytest.mark.parametrize(
    ("name", "unit_m"),
    [
        ("DEPTHFT", 0.3048),
        ("depth_ft_avg", 0.3048),
        ("ft_depth", 0.3048),
        ("depth (')", 0.3048),
        ("depthm", 1.0),
        ('"Depth (ft, MLLW)"', 0.3048),
        ("Depth (in feet below surface)", 0.3048),
        ("Depth (U.S. survey ft)", 1200 / 3937),
        ("Profundidad (pies)", 0.3048),
        ("depth (m NHN)", 1.0),
        ("depth (200 kHz)", 1.0),
    ],
)
def test_units_anywhere_in_a_name(tmp_path, name, unit_m):
    path = rows(tmp_path / "t.csv", f"x,y,{name}", EAST, NORTH, DEPTH / unit_m)
    assert soundings(path) == pytest.approx(-DEPTH, abs=1e-6)


@pytest.mark.parametrize(
    "name", ["depth (ft/10)", "depth (0.1 m)", "depth (fathoms & feet)", "depth (cm x 10)"]
)
def test_units_that_are_no_single_one(tmp_path, name):
    with pytest.raises(InputError, match="expected a unit of length"):
        soundings(rows(tmp_path / "t.csv", f"x,y,{name}", EAST, NORTH, DEPTH))


def test_units_between_blanks(tmp_path):
    """Where blanks separate the columns, a unit in brackets is no name of its own."""
    table = pd.DataFrame({"x": EAST, "y": NORTH, "d": DEPTH / 0.3048})
    (tmp_path / "t.txt").write_text(
        f"East (m) North (m) Depth (ft)\n{table.to_string(index=False, header=False)}"
    )
    assert soundings(tmp_path / "t.txt") == pytest.approx(-DEPTH, abs=1e-5)


@pytest.mark.parametrize(
    "head",
    [
        "x,y,depth\nm,m,ft MLLW",
        "m,m,ft\nx,y,depth",
        "latitude,longitude,depth\ndegrees_north,degrees_east,ft",
        "Date,Time,x,y,depth\nyyyy-mm-dd,hh:mm:ss,m,m,ft",
    ],
)
def test_units_below_the_names(tmp_path, head):
    day = [["2024-06-12"] * N, [f"10:00:{k:02d}" for k in range(N)]] if head.startswith("Date") else []
    lon, lat = Transformer.from_crs(UTM, 4326, always_xy=True).transform(EAST, NORTH)
    places = [lat, lon] if head.startswith("lat") else [EAST, NORTH]
    path = rows(tmp_path / "t.csv", head, *day, *places, DEPTH / 0.3048)
    assert soundings(path) == pytest.approx(-DEPTH, abs=1e-6)


@pytest.mark.parametrize(
    ("above", "below", "head", "words"),
    [
        ("# depths in feet\n", "", "x_m,y_m,depth", "depths in feet"),
        ("# DepthUnits=ft\n", "", "x,y,depth", "DepthUnits=ft"),
        ("VERTICAL_UNITS;Feet\n", "", "x,y,depth", "VERTICAL_UNITS;Feet"),
        ('# {"depth_unit": "ft"}\n', "", "x,y,depth", "depth_unit"),
        ("# Einheit Tiefe: cm\n", "", "x,y,Tiefe", "Einheit Tiefe"),
        ("# depths are given in ft\n", "", "x,y,depth", "depths are given in ft"),
        ("# Depth [ft], position [m]\n", "", "x,y,depth", "name no unit"),
        ("", "# units: feet\n", "x,y,depth", "units: feet"),
        ("", "Note: depth values are in feet\n", "x,y,depth", "values are in feet"),
        ("# z positive down\n", "", "x,y,z", "heights in column z"),
        ("", "", "x,y,z (positive down)", "heights in column z"),
        ("# EPSG:25832\n", "", "x,y,depth", "EPSG:25832.*as stated"),
    ],
)
def test_remarks_that_contradict(tmp_path, above, below, head, words):
    path = rows(tmp_path / "t.csv", head, EAST, NORTH, DEPTH, above=above, below=below)
    with pytest.raises(InputError, match=words) as told:
        soundings(path)
    assert told.value.cure


@pytest.mark.parametrize("name", ["Z (down)", "Z (+down)", "Elevation (m below datum)"])
def test_heights_whose_name_counts_downwards(tmp_path, name):
    with pytest.raises(InputError, match="and its name"):
        soundings(rows(tmp_path / "t.csv", f"x,y,{name}", EAST, NORTH, DEPTH))


@pytest.mark.parametrize(
    ("head", "cells", "above", "words"),
    [
        ("x,y,depth,Zone", "32U", "", "in zone 32 by the file"),
        ("x,y,depth,UTM Zone", [32, 33] * (N // 2), "", "in zone 32, 33 by the file"),
        ("x,y,depth,id", 1, "# UTM zone 32N\n", "in zone 32 by the file"),
        ("x,y,depth,CS name", "ETRS89 / UTM zone 32N", "", "EPSG:25832.*as stated"),
        ("UTM32_E,UTM32_N,depth,id", 1, "", "in zone 32 by the file"),
        ("x (EPSG:25832),y (EPSG:25832),depth,id", 1, "", "EPSG:25832.*as stated"),
        ("x,y,depth,Zone", [1, 2] * (N // 2), "# transformed from UTM 32 to UTM 33\n", ""),
    ],
)
def test_zones_and_systems_that_contradict(tmp_path, head, cells, above, words):
    path = rows(tmp_path / "t.csv", head, EAST, NORTH, DEPTH, cells, above=above)
    if not words:
        assert len(soundings(path)) == N
        return
    with pytest.raises(InputError, match=words):
        soundings(path)


def test_heights_in_the_unit_of_their_system(tmp_path):
    """Feet of the US survey, by the name of the system beside each row, and by the one that is stated."""
    foot = 1200 / 3937
    east, north = (300_000 + EAST - EAST[0]) / foot, (65_000 + NORTH - NORTH[0]) / foot
    name = "NAD83 / New York Long Island (ftUS) + NAVD88 height (ftUS)"
    path = rows(tmp_path / "t.csv", "x,y,z,CS name", east, north, (100 - DEPTH) / foot, [name] * N)
    for crs in (None, CRS(2263)):
        assert soundings(path, crs) == pytest.approx(100 - DEPTH, abs=1e-6)
    path = rows(tmp_path / "t.csv", "x,y,z", east, north, (100 - DEPTH) / foot)
    assert soundings(path, CRS("EPSG:2263+6360")) == pytest.approx(100 - DEPTH, abs=1e-6)


@pytest.mark.parametrize(
    ("head", "above"), [("Latitude (NAD27),Longitude (NAD27)", ""), ("lat,lon", "# EPSG:4267\n")]
)
def test_degrees_of_another_datum(tmp_path, head, above):
    """In Texas NAD27 lies 40 m from WGS 84; where no way is known the file is refused."""
    path = rows(tmp_path / "t.csv", head, [30.2] * 4, [-98.5] * 4, above=above)
    wgs84 = Transformer.from_crs(4326, 26914, always_xy=True).transform(-98.5, 30.2)
    shift = np.linalg.norm(read_text_table(path).places(CRS(26914)).xy_m[0] - wgs84)
    assert 30 < shift < 50
    path = rows(tmp_path / "t.csv", head, [51.0] * 4, [13.7] * 4, above=above)
    with pytest.raises(InputError, match="in NAD27, by the file"):
        read_text_table(path).places(UTM)


def test_x_that_a_system_counts_northwards(tmp_path):
    path = rows(tmp_path / "t.csv", "x,y", [536_324.0] * 4, [438_711.0] * 4)
    assert "in ETRF2000-PL / CS92 x is the northing" in read_text_table(path).places(CRS(2180)).notes[0]
    path = rows(tmp_path / "t.csv", "east,north", [536_324.0] * 4, [438_711.0] * 4)
    assert not read_text_table(path).places(CRS(2180)).notes


def test_uncertainties_with_95_percent_or_none(tmp_path):
    path = rows(
        tmp_path / "t.csv", "x,y,depth,uncertainty (95%)", EAST, NORTH, DEPTH, [0.0] * 9 + [0.196] * 51
    )
    found = read_soundings(path, UTM, column=None, depth=None, level_m=None, line_column=None, sigma_m=0.02)
    assert found.sigma_m == pytest.approx(0.1)
    assert "9 rows with 0, which stands for no value, in column uncertainty" in " ".join(found.notes)
    assert "divided by 1.96" in " ".join(found.notes)


@pytest.mark.parametrize("name", ["tide (m)", "water_level", "heave", "draught"])
def test_columns_that_may_be_in_the_depths(tmp_path, name):
    path = rows(tmp_path / "t.csv", f"x,y,depth,{name}", EAST, NORTH, DEPTH, DEPTH)
    found = read_soundings(
        path, UTM, column="depth", depth=None, level_m=None, line_column=None, sigma_m=0.02
    )
    assert f"column {name} is not added: depths are taken from the water" in found.notes


def test_remarks_that_are_used_or_quoted(tmp_path):
    """A map that the file states needs no statement; a draught that nobody adds is quoted."""
    above = "# EPSG:25833\n# draft 0.4 m not applied\n# cell size 1 m\n"
    path = rows(tmp_path / "t.csv", "x,y,depth,valid", EAST, NORTH, DEPTH, np.arange(N) % 2, above=above)
    table, places = read_places(path, None)
    assert places.crs == UTM
    assert table.notes == [
        "line 1 says '# EPSG:25833'",
        "line 2 says '# draft 0.4 m not applied'",
        "column valid may mark rows that do not count: it is not read",
    ]


def test_a_column_of_units_beside_points_of_a_gis(tmp_path):
    features = [
        {
            "type": "Feature",
            "properties": {"depth": 7.0, "unit": "ft"},
            "geometry": {"type": "Point", "coordinates": [13.7 + k / 1e4, 51.0]},
        }
        for k in range(4)
    ]
    (tmp_path / "a.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    with pytest.raises(InputError, match="unit: ft"):
        read_places(tmp_path / "a.geojson", UTM)


@pytest.mark.parametrize("name", ["depth units", "Units of depth", "Linear Unit"])
def test_columns_of_units(tmp_path, name):
    with pytest.raises(InputError, match="ft' beside columns that name no unit"):
        soundings(rows(tmp_path / "t.csv", f"x,y,depth,{name}", EAST, NORTH, DEPTH, ["ft"] * N))
    found = soundings(
        rows(tmp_path / "t.csv", "x,y,depth,Antenna height unit", EAST, NORTH, DEPTH, ["ft"] * N)
    )
    assert found == pytest.approx(-DEPTH)


@pytest.mark.parametrize(
    ("head", "second"), [("x,y,depth_m", "x,y,depth_ft"), ("id,x,y,depth,sigma", "no,x,y,sigma,depth")]
)
def test_a_second_header_that_means_others(tmp_path, head, second):
    columns = dict(zip(("x", "y", "depth"), (EAST, NORTH, DEPTH), strict=True))
    values = [columns.get(name.split("_")[0], np.full(N, 0.5)) for name in head.split(",")]
    below = second + "\n" + pd.DataFrame(dict(enumerate(values))).to_csv(index=False, header=False)
    with pytest.raises(InputError, match="a second header with other columns"):
        soundings(rows(tmp_path / "t.csv", head, *values, below=below))


@pytest.mark.parametrize(
    ("head", "more", "side"),
    [
        ("lat,Longitude (W)", [], (1, -1)),
        ("lat,lon (+W)", [], (1, -1)),
        ("Latitude (South),lon", [], (-1, 1)),
        ("lat,lon (E/W)", [], (1, 1)),
        ("lat,lon (W negative)", [], (1, 1)),
        ("lat,lon,NS,EW", ["S", "W"], (-1, -1)),
        ("lat,lon,remark,lat_ref,lon_ref", ["", "S", "W"], (-1, -1)),
        ("lat,lon,remark,bank", ["", "W"], (1, 1)),
    ],
)
def test_hemispheres_by_names_and_letters(tmp_path, head, more, side):
    path = rows(tmp_path / "t.csv", head, [33.5] * 4, [70.25] * 4, *([each] * 4 for each in more))
    table = read_text_table(path)
    assert (table.angles("lat")[0], table.angles("lon")[0]) == (33.5 * side[0], 70.25 * side[1])


@pytest.mark.parametrize("form", ["(ddmm.mmmm)", "(dd.mmss)", "(DMS)"])
def test_degrees_and_minutes_in_one_number(tmp_path, form):
    path = rows(tmp_path / "t.csv", f"Latitude {form},Longitude {form}", [15.0045] * 4, [45.2545] * 4)
    with pytest.raises(InputError, match="numbers such as"):
        read_text_table(path).angles("lat")
    path = rows(tmp_path / "t.csv", f"Latitude {form};Longitude {form}", ["15 0.27;45 15.27"] * 4)
    assert read_text_table(path).angles("lat")[0] == pytest.approx(15.0045)


@pytest.mark.parametrize("name", ["Depth QC", "is_valid", "status", "deleted", "Solution status"])
def test_columns_that_may_mark_rows(tmp_path, name):
    path = rows(tmp_path / "t.csv", f"x,y,depth,{name}", EAST, NORTH, DEPTH, np.arange(N) % 2)
    assert f"column {name} may mark rows that do not count: it is not read" in read_text_table(path).notes


@pytest.mark.parametrize("word", ["AVG", "Mittelwert", "Maximum:", "Mean depth", "Min of y"])
def test_rows_of_totals(tmp_path, word):
    below = f"{word},412027,5650018,2.5\n"
    path = rows(tmp_path / "t.csv", "id,x,y,depth", range(N), EAST, NORTH, DEPTH, below=below)
    assert len(soundings(path)) == N


def test_names_above_a_remark_and_a_row_of_means(tmp_path):
    """A line between names and numbers hides no names; the mean at the end is no sounding."""
    path = rows(
        tmp_path / "t.csv",
        "id,x,y,depth\nline 2",
        range(N),
        EAST,
        NORTH,
        DEPTH,
        below="Mean,412027,5650018,1.9\n",
    )
    assert soundings(path) == pytest.approx(-DEPTH)


@pytest.mark.parametrize("value", [-99.99, 65.535, 255.0, -777.0, -1e5, 327.67])
def test_numbers_that_repeat_far_from_all_others(tmp_path, value):
    depth = np.where(np.arange(N) % 12 == 5, value, DEPTH)
    path = rows(tmp_path / "t.csv", "x,y,depth", EAST, NORTH, depth)
    assert soundings(path) == pytest.approx(-DEPTH[depth != value])


@pytest.mark.parametrize("remark", ["nodata = 2.3451", "NODATA_VALUE 2.3451", "missing value: 2.3451"])
def test_a_number_that_a_remark_states_as_none(tmp_path, remark):
    depth = np.where(np.arange(N) == 5, 2.3451, DEPTH)
    path = rows(tmp_path / "t.csv", "x,y,depth", EAST, NORTH, depth, above=f"# {remark}\n")
    assert soundings(path) == pytest.approx(-np.delete(DEPTH, 5))


def test_a_deep_place_and_coarse_numbers_are_no_stand_ins():
    assert far_repeated([*DEPTH, 9.0, 9.0]) == ()
    assert far_repeated([1.0] * 40 + [2.0] * 5 + [30.0] * 5) == ()
    assert far_repeated([*DEPTH, 4.0, 4.0, 4.0]) == ()


def three(value):
    return [value] * 3


HUNDREDS, ONES, BELOW = np.linspace(100, 101, 20), np.linspace(1, 2, 20), np.linspace(-1.05, -1, 20)
FIVE, FOUR = np.repeat([1.0, 1.1, 1.2, 1.3, 1.4], 5), np.repeat([1.0, 1.1, 1.2, 1.3], 6)


@pytest.mark.parametrize(
    ("values", "ends"),
    [
        # zero, or below it, beside heights above; twice as far as any other; eleven spans away
        ([*HUNDREDS, *three(0.0)], (0.0,)), ([*HUNDREDS, *three(-5.0)], (-5.0,)),
        ([*HUNDREDS, *three(80.0)], ()), ([*HUNDREDS, *three(203.0)], (203.0,)),
        ([*HUNDREDS, *three(201.0)], ()),
        ([*ONES, *three(12.1)], (12.1,)), ([*ONES, *three(11.9)], ()),
        ([*BELOW, *three(0.0)], (0.0,)), ([*BELOW, *three(-2.2)], (-2.2,)), ([*BELOW, *three(-2.0)], ()),
        # both ends, neither far from the other ones alone
        ([*HUNDREDS, *three(0.0), *three(203.0)], (0.0, 203.0)),
        # three times, beside twenty others, of which five differ
        ([*HUNDREDS, 0.0, 0.0], ()), ([*HUNDREDS[1:], *three(0.0)], ()),
        ([*FIVE, *three(99.0)], (99.0,)), ([*FOUR, *three(99.0)], ()),
        ([*HUNDREDS, *three(0.0), np.nan, np.inf], (0.0,)), ([], ()),
    ],
)  # fmt: skip
def test_numbers_far_from_all_others_by_hand(values, ends):
    assert far_repeated(values) == ends


NONE_OF_ALL = "-9999 -99999 -999999 -32768 -32767 -9999.99 -9999.9 -777"
NONE_OF = {
    "depth": "0 999 999.9 999.99 9999 9999.9 99999 -999 -99 -1 32767 65535",
    "height": "9999 9999.9 99999 -999 -999.9 -10000 32767",
    "position": "99999 999999 9999999",
    "sigma": "-1 999 9999 99999",
    "time": "0 -1",
    "other": "",
}


@pytest.mark.parametrize("quantity", NONE_OF)
def test_numbers_that_stand_for_none_of_each_quantity(quantity):
    every = sorted({float(x) for x in " ".join([NONE_OF_ALL, *NONE_OF.values()]).split()})
    none = {float(x) for x in f"{NONE_OF_ALL} {NONE_OF[quantity]}".split()}
    for numbers in (np.array(every), np.array(every, np.float32)):
        assert np.array(every)[is_nothing(numbers, quantity)].tolist() == sorted(none)
    beside = np.array([0.01 if x == 0.0 else x * (1 + 3e-7) for x in [*every, 5.0]])
    assert not is_nothing(beside, quantity).any()
    assert is_nothing([1.0e9, -1.0e9, np.nan, np.inf, 1e38], quantity).all()
    assert not is_nothing([0.99e9, -0.99e9], quantity).any()


ZONES = {
    0: "time (UTC)|GMT|Z|time|EST or EDT|UTC+15|utc+2x|Mars/Phobos",
    1: "CET|Zeit in MEZ", 2: "CEST|MESZ|EET|UTC+2|GMT +02:00|+0200|UTC+2 h", 3: "EEST", 9: "JST", 10: "AEST",
    11: "AEDT", 12: "NZST", 13: "NZDT", 14: "UTC+14", -4: "EDT", -5: "EST|CDT|UTC-5|-05:00", -6: "MDT",
    -7: "MST|PDT", -8: "PST", 5.5: "UTC+5:30|GMT+5.5", -3.5: "UTC-3:30",
}  # fmt: skip


@pytest.mark.parametrize("hours", ZONES)
def test_zones_in_words(hours):
    for text in ZONES[hours].split("|"):
        zone = stated_zone("no zone", text)
        assert (0 if zone is None else zone.utcoffset(None).total_seconds() / 3600) == hours, text


def test_zones_of_places_and_the_first_of_several():
    assert str(stated_zone("Europe/Berlin", "PST")) == "Europe/Berlin"
    assert stated_zone("time in PST", "CEST").utcoffset(None).total_seconds() == -8 * 3600.0
    assert stated_zone() is None


@pytest.mark.parametrize(
    ("clock_s", "later"),
    [
        ([86_390, 86_399, 5, 9], [0, 0, 1, 1]), ([86_399, 1, 86_398, 2], [0, 1, 1, 2]),
        ([77_800, 39, 50], [0, 1, 1]), ([77_700, 61, 70], [0, 0, 0]),
        ([86_399, 5, 4, 9], [0, 0, 0, 0]), ([5, 6, 7], [0, 0, 0]),
    ],
)  # fmt: skip
def test_clocks_that_pass_midnight(clock_s, later):
    """By nine tenths of a day; where another step goes back nothing is put right."""
    found = past_midnight(np.array(clock_s, float))
    assert found.tolist() == (np.array(clock_s) + 86_400 * np.array(later)).tolist()


@pytest.mark.parametrize(
    ("first", "words"),
    [(25_569.0, "Excel"), (40_587.0, "modified"), (719_529.0, "MATLAB"), (2_440_587.5, "days")],
)
def test_counts_of_days_are_told_by_their_size(first, words):
    at = first + TEN / 86_400 + np.arange(30) / 86_400
    unix_s, (note,) = _unix_of_numbers(np.append(at, np.nan), "t")
    # days of today in float64 resolve 40 us
    assert unix_s[:-1] == pytest.approx(TEN + np.arange(30), abs=1e-4)
    assert words in note
    # a row every ten minutes is slower than 0.005 of a day, one every five is not
    slow, fast = (first + TEN / 86_400 + np.arange(30) * minutes / 1440 for minutes in (10, 5))
    assert _unix_of_numbers(slow, "t") is None or "days" not in _unix_of_numbers(slow, "t")[1][0]
    assert words in _unix_of_numbers(fast, "t")[1][0]
    for year in (1999, 2029):
        other = first + (year - 1970) * 365.25 + np.arange(30) / 86_400
        found = _unix_of_numbers(other, "t")
        assert found is None or words not in found[1][0]


def test_a_number_of_two_scales_is_told_by_the_name_of_its_column():
    number = 1_402_221_618.0 + np.arange(3.0)  # 2014 in Unix time, 2024 in GPS time
    for name, unix_s, words in (
        ("time", 1_402_221_618.0, "seconds since 1970"), ("GPS time", TEN, "taken as GPS seconds since 1980"),
    ):  # fmt: skip
        found, (note,) = _unix_of_numbers(number, name)
        assert found.tolist() == (unix_s + np.arange(3.0)).tolist()
        assert words in note
        assert "1402221618 is 2014-06-08" in note


@pytest.mark.parametrize(
    ("head", "cells", "unix_s"),
    [
        ("time (CEST)", "2024-06-12 12:00:{:02d}", TEN),
        ("time (UTC+2)", "2024-06-12 12:00:{:02d}", TEN),
        ("time", "2024-06-12 12:00:{:02d} CEST", TEN),
        ("time", "2024-06-12 10:00:{:02d} UTC", TEN),
        ("time", "2024-06-12 12:00:{:02d}+02", TEN),
        ("time,timezone", "2024-06-12 12:00:{:02d},Europe/Berlin", TEN),
        ("time,utc_offset", "2024-06-12 15:30:{:02d},+5.5", TEN),
        ("time,utc_offset", "2024-06-12 12:00:{:02d},2", TEN),
        ("time,utc_offset", "2024-06-12 07:00:{:02d},-180", TEN),
        ("time,tz", "2024-06-12 12:00:{:02d},+0200", TEN),
        ("time (UTC + 2)", "2024-06-12 12:00:{:02d}", TEN),
        ("time (GMT+2h)", "2024-06-12 12:00:{:02d}", TEN),
        ("time,time_utc", "2024-06-12 12:00:{:02d},2024-06-12T10:00:00Z", TEN),
        ("week,tow", "2318,2952180{:02d}", TEN + 0.0),
        ("gps_week,tow (ms)", "2318,2952180{:02d}", TEN),
        ("gps_week,tow (s)", "2318,295218.{:02d}", TEN),
        ("time", "2024-06-12 12:00:{:02d} +0200", TEN),
        ("time", "2024-06-12 12:00:{:02d} UTC+2", TEN),
        ("time", "2024-06-12 12:00:{:02d} Europe/Berlin", TEN),
        ("time", "Wed Jun 12 2024 12:00:{:02d} GMT+0200 (Central European Summer Time)", TEN),
        ("# Zeit in MEZ\ntime", "2024-06-12 11:00:{:02d}", TEN),
        ("time,tz_cd", "2024-06-12 06:00:{:02d},EDT", TEN),
    ],
)
def test_zones_that_a_table_states(tmp_path, head, cells, unix_s):
    path = tmp_path / "t.csv"
    path.write_text(f"{head},x\n" + "".join(f"{cells.format(k)},1\n" for k in range(9)))
    told = read_text_table(path).times()
    assert told[0][0] == pytest.approx(unix_s, abs=1e-6)
    assert "state no zone" not in " ".join(told[1])


def test_zones_that_change_with_the_rows(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("time,tz,x\n2024-10-27 02:59:58,CEST,1\n2024-10-27 02:00:02,CET,1\n")
    assert np.diff(read_text_table(path).times()[0]) == pytest.approx(4.0)
    path.write_text("time,x\n2024-10-27 02:59:58 CEST,1\n2024-10-27 02:00:02 CET,1\n")
    assert np.diff(read_text_table(path).times()[0]) == pytest.approx(4.0)
    path.write_text("time,tz,x\n2024-06-12 11:00:00,BST,1\n2024-06-12 11:00:01,BST,1\n")
    with pytest.raises(InputError, match="'BST' in column tz"):
        read_text_table(path).times()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time (BST),x\n2024-06-12 11:00:00,1\n", "'time (BST)' may mean another clock or zone"),
        ("# Zeitzone: MESZ/MEZ\ntime,x\n2024-06-12 11:00:00,1\n", "may mean another clock or zone"),
        (
            "time,x\n06/13/2024 10:00,1\n06/13/2024 10:01,2\n2024-06-13 10:02,3\n",
            "1 times of column time are not",
        ),
        ("time,x\n24.06.12 10:00:00,1\n25.06.12 10:00:00,1\n", "24.06.12 10:00:00 taken as 2012-06-24"),
        ("Local time,x\n2024-06-12 11:00:00,1\n", "'Local time' may mean another clock or zone"),
        ("time,x\n1:00:00 PM,1\n", "no time with a date"),  # and none of today
        ("time (Europe/Berlin),x\n2024-10-27 02:30:00,1\n", "1 times of column time (Europe/Berlin) are not"),
    ],
)
def test_times_that_may_be_others_or_none_are_noted(tmp_path, text, words):
    (tmp_path / "t.csv").write_text(text)
    assert words in " ".join(read_text_table(tmp_path / "t.csv").times()[1])


@pytest.mark.parametrize("first", [25_569.0, 719_529.0, 2_440_587.5, 40_587.0])
def test_days_that_count(tmp_path, first):
    path = tmp_path / "t.csv"
    path.write_text("time,x\n" + "".join(f"{(TEN + 2 * k) / 86400 + first:.8f},1\n" for k in range(9)))
    told = read_text_table(path).times()
    assert told[0] == pytest.approx(TEN + 2 * np.arange(9), abs=0.1)


def test_midnight_beside_one_date(tmp_path):
    clocks = [
        f"2024-06-12,{clock},1" for clock in ("23:59:50", "23:59:54", "23:59:58", "00:00:02", "00:00:06")
    ]
    path = tmp_path / "t.csv"
    path.write_text("date,time,x\n" + "\n".join(clocks))
    told = read_text_table(path).times()
    assert np.diff(told[0]) == pytest.approx(4.0)
    assert "pass midnight" in " ".join(told[1])


def test_two_digits_that_may_be_the_year(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("time,x\n" + "".join(f"24-06-12 10:00:{k:02d},1\n" for k in range(9)))
    with pytest.raises(InputError, match="may be the year"):
        read_text_table(path).times()
    path.write_text("time,x\n24.06.12 10:00:00,1\n24.06.13 10:00:00,1\n")
    with pytest.raises(InputError, match="may be the year"):
        read_text_table(path).times()
    path.write_text("time,x\n" + "".join(f"24-06-{k:02d} 10:00:00,1\n" for k in range(11, 20)))
    told = read_text_table(path).times()
    assert told[0][1] == pytest.approx(TEN)


@pytest.mark.parametrize(
    "text",
    [
        "level,time\n100.0,2024-06-12T09:00\n102.0,2024-06-12T11:00\n",
        "time,level,station\n2024-06-12T09:00,100.0,501060\n2024-06-12T11:00,102.0,501060\n",
        "Datum;Uhrzeit;Pegel\n12.06.2024;09:00;100,0\n12.06.2024;11:00;102,0\n",
        "time (MESZ),level\n2024-06-12T11:00,100.0\n2024-06-12T13:00,102.0\n",
        "2024-06-12T09:00,100.0\n2024-06-12T11:00,102.0\n",
        "dateTime,value,quality\n2024-06-12T09:00,100.0,40\n2024-06-12T11:00,102.0,40\n",
        "Zeit;Wert;Status\n2024-06-12T09:00;100,0;1\n2024-06-12T11:00;102,0;1\n",
        "time,W,Q\n2024-06-12T09:00,100.0,7.5\n2024-06-12T11:00,102.0,7.6\n",
    ],
)
def test_levels_by_their_names(tmp_path, text):
    path = tmp_path / "levels.csv"
    path.write_text(text)
    assert Levels.read(path).at(np.array([TEN])) == pytest.approx(101.0)


# ---------------------------------------------------------------- clouds


def las(path: Path, xyz: np.ndarray, crs: object = None) -> Path:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.floor(xyz.min(axis=0))
    if crs is not None:
        header.add_crs(CRS.from_user_input(crs))
    file = laspy.LasData(header)
    file.x, file.y, file.z = xyz.T
    file.write(path)
    return path


POINTS = np.column_stack([EAST, NORTH, 100.0 - DEPTH])


@pytest.mark.parametrize(
    ("xyz", "crs", "words"),
    [
        (POINTS[:, [1, 0, 2]], 25833, "swapped would fit"),
        (POINTS / 0.3048, 25833, "feet would fit"),
        (POINTS * (1, 1, -1), "EPSG:25833+5831", "depths, positive downwards"),
    ],
)
def test_clouds_that_contradict_their_system(tmp_path, xyz, crs, words):
    with pytest.raises(ThalwegError, match=words):
        read_points(las(tmp_path / "a.las", xyz, crs))


@pytest.mark.parametrize("value", [-9999.0, 0.0, -99.0])
def test_heights_of_a_cloud_that_stand_for_none(tmp_path, value):
    xyz = POINTS.copy()
    xyz[::12, 2] = value
    cloud = read_cloud(las(tmp_path / "a.las", xyz))
    assert len(cloud.points) == N - 5
    assert cloud.report.losses == {"points_with_a_height_that_stands_for_none": 5}


@pytest.mark.parametrize(("comment", "refused"), [("units: feet", True), ("offset 412000 5650000 0", False)])
def test_comments_of_ply(tmp_path, comment, refused):
    names = "".join(f"property double {axis}\n" for axis in "xyz")
    text = f"ply\nformat ascii 1.0\ncomment {comment}\nelement vertex 1\n{names}end_header\n1 2 3\n"
    (tmp_path / "a.ply").write_text(text)
    if refused:
        with pytest.raises(InputError, match="feet"):
            read_cloud(tmp_path / "a.ply")
    else:
        assert f"A comment says '{comment}'" in " ".join(read_cloud(tmp_path / "a.ply").report.notes)


# ---------------------------------------------------------------- tracks, lenses, marks


def test_positions_at_no_place():
    frame = GNSS_POSITION.empty_table().to_pandas()
    frame = frame.reindex(range(3)).assign(lat_deg=[0.0, 51.0, 95.0], lon_deg=[0.0, 13.0, 13.0])
    log = PositionLog(report=IntegrityReport(stream="gnss", format="", files=[]), positions=frame)
    assert log.positions["lat_deg"].tolist() == [51.0]
    assert log.report.losses == {"positions_at_no_place": 2}


@pytest.mark.parametrize(
    ("of_course", "words"),
    [
        (lambda c: c + 0.3, ""),
        (lambda c: np.pi / 2 - c, "turns against"),
        (lambda c: c + np.pi / 2, r"\+9\d deg"),
        (np.deg2rad, "hardly turns"),
    ],
)
def test_headings_against_the_course(of_course, words):
    course = np.deg2rad(40.0 + 2.0 * np.arange(120))
    step_deg = 2.0 / 111_195.0
    states = pd.DataFrame(
        {
            "t_gps_s": 4e8 + np.arange(120.0),
            "lat_deg": 51 + step_deg * np.cumsum(np.cos(course)),
            "lon_deg": 13 + step_deg * np.cumsum(np.sin(course)) / np.cos(np.deg2rad(51)),
            "heading_rad": of_course(np.append(course[1:], course[-1])),
        }
    )
    found = doubtful_heading(states)
    assert (not found) if not words else pd.Series([found]).str.contains(words).all()


def test_sbet_whose_times_contradict_the_week(tmp_path):
    record = np.zeros((40, 17))
    record[:, 0] = ((TEN + 18 - GPS_EPOCH_UNIX_S) % 604_800 + np.arange(40)) * 1000.0
    record[:, 1:3] = np.deg2rad([51.0, 13.0])
    (tmp_path / "a.out").write_bytes(record.tobytes())
    with pytest.raises(InputError, match="and GPS week 2318"):
        read_sbet([tmp_path / "a.out"], 2318)


def test_remarks_of_poses_are_quoted(tmp_path):
    (tmp_path / "a.txt").write_text(f"# world to body\n{TEN} 0 0 0 0 0 0 1\n")
    assert "world to body" in " ".join(read_text_poses("tum", [tmp_path / "a.txt"]).report.notes)


@pytest.mark.parametrize(
    "matrix", ["5.0,0,3.2,0,5.0,1.8,0,0,1", ".8,0,.5,0,1.4,.5,0,0,1", "2000,0,1280,0,2000,720,0,0,1"]
)
def test_lenses_of_other_units_or_sizes(tmp_path, matrix):
    head = "image_width: 1280\nimage_height: 720\ndistortion_model: plumb_bob\n"
    (tmp_path / "a.yaml").write_text(
        f"{head}camera_matrix: [{matrix}]\ndistortion_coefficients: [0,0,0,0,0]\n"
    )
    with pytest.raises(InputError, match="principal point"):
        read_opencv(tmp_path / "a.yaml")


def test_marks_that_are_no_pixels(tmp_path):
    path = rows(
        tmp_path / "m.csv",
        "image,point,x (mm),y (mm)",
        ["a.jpg"] * 3,
        "PQR",
        [1.0, 2.0, 3.0],
        [1.0, 2.0, 3.0],
    )
    with pytest.raises(InputError, match="expected pixels"):
        read_marks(path)


def test_clouds_without_names_whose_first_columns_count(tmp_path):
    """FARO writes row and column of the scan first; whole coordinates of a grid are none of that."""
    number, east, north = np.arange(N), EAST + 0.25, NORTH + 0.125
    for *counts, words in ((number, "first counts"), (number % 7, number // 7, "first two count")):
        path = rows(tmp_path / "a.xyz", "", *counts, east, north, DEPTH)
        with pytest.raises(InputError, match=words):
            read_points(path)
    path = rows(tmp_path / "a.xyz", "", EAST.astype(int), NORTH.astype(int), DEPTH, DEPTH / 100, DEPTH / 50)
    assert read_points(path).xyz_m[:, 2] == pytest.approx(DEPTH)
