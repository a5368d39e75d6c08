"""Soundings of tables, lines, banks and references against values written by hand: straight rivers."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import shapely
from pyproj import CRS

from thalweg.bathymetry import (
    FlowLine,
    TableOfSoundings,
    against_reference,
    bed_of_table,
    read_other_soundings,
    read_soundings,
    water_of,
)
from thalweg.bathymetry.tables import (
    _agreed,
    _chain,
    _lines_by_place,
    _refuse_other_heights,
    centre_of_lines,
    hull_of_lines,
    map_crs,
    read_bank_lines,
    read_islands,
    read_line,
    usual_cell_m,
)
from thalweg.core import GeometryError, Grid, InputError, LazWriter, LocalFrame, write_raster
from thalweg.settings.sections import Bathymetry

UTM = CRS("EPSG:32633")
ORIGIN = np.array([500_000.0, 5_400_000.0])
AXIS = FlowLine.through(ORIGIN + np.array([[-13.1, 0.0], [50.0, 0.0], [150.0, 0.0]]))
"""Eastward, so that the left bank is the northern one; it begins 13.1 m before the origin."""


def write_shapes(path: Path, *shapes: tuple[dict, shapely.Geometry]) -> Path:
    features = [
        {"type": "Feature", "properties": of, "geometry": json.loads(shapely.to_geojson(shape))}
        for of, shape in shapes
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


def line_string(*places: tuple[float, ...]) -> shapely.LineString:
    """Relative to the origin of the map, with heights if there are any."""
    return shapely.LineString([(*(ORIGIN + place[:2]), *place[2:]) for place in places])


def soundings_at(xy: np.ndarray, height_m: np.ndarray, line: np.ndarray) -> TableOfSoundings:
    return TableOfSoundings(
        places_m=ORIGIN + xy,
        height_m=height_m,
        sigma_m=np.full(len(xy), 0.02),
        line=line,
        crs=UTM,
        column="h",
        depth=False,
    )


def sections(rise: float = -0.01, *, long_m: float = 100.0) -> TableOfSoundings:
    """Every 10 m from 8 m to the right to 6 m to the left of the axis."""
    x, y = np.meshgrid(np.arange(5.0, long_m, 10.0), np.arange(-8.0, 6.1, 2.0), indexing="ij")
    number = np.repeat(np.arange(len(x)), x.shape[1])
    return soundings_at(np.column_stack([x.ravel(), y.ravel()]), rise * x.ravel() - 2.0, number)


# ---------------------------------------------------------------- the table

ROWS = """x,y,depth,sigma,draft,time,track
500000,5400000,1.0,0.1,0.3,2024-05-01T12:00:00Z,a
500000,5400000,1.9,0.2,0.3,2024-05-01T12:00:02Z,a
500010,5400000,2.0,0.1,0.3,2024-05-01T12:00:04Z,a
500010,5400000,2.4,0.1,0.3,2024-05-01T12:00:06Z,a
500020,5400005,3.0,0.1,0.3,2024-05-01T12:00:08Z,b
500020,5400005,3.0,0.1,0.3,2024-05-01T12:00:08Z,b
500030,5400005,-0.5,0.1,0.3,2024-05-01T12:00:10Z,b
500040,5400005,3.0,0,0.3,2024-05-01T12:00:12Z,b
500050,5400005,3.0,,0.3,2024-05-01T12:00:14Z,b
500010,5400000,2.2,0.1,0.3,2024-05-02T12:00:00Z,a
"""


def test_each_column_of_soundings_by_hand(tmp_path):
    """Two rows of one place: their mean, and half of what they differ by where it is more than the noise."""
    (tmp_path / "t.csv").write_text(ROWS)
    known = {"column": None, "depth": None, "sigma_m": 0.5}
    found = read_soundings(tmp_path / "t.csv", UTM, level_m=10.0, line_column="track", **known)
    east, north = (found.places_m - ORIGIN).T
    assert (east.tolist(), north.tolist()) == ([0.0, 10.0, 20.0, 30.0, 10.0], [0.0, 0.0, 5.0, 5.0, 0.0])
    assert found.height_m == pytest.approx([8.55, 7.8, 7.0, 10.5, 7.8])
    assert found.sigma_m == pytest.approx([0.45, 0.2, 0.1, 0.1, 0.1])
    assert found.line.tolist() == [0, 0, 1, 1, 0]
    assert (found.column, found.depth, found.crs) == ("depth", True, UTM)
    assert found.day.tolist() == [0, 0, 0, 0, 1]
    assert found.days == ("2024-05-01", "2024-05-02")
    noon = pd.Timestamp("2024-05-01T12:00Z").timestamp()
    assert (found.t_s - noon).tolist() == [0.0, 4.0, 8.0, 10.0, 86_400.0]
    assert found.run.tolist() == [0, 0, 1, 1, 2]
    assert found.runs == ("a of 2024-05-01", "b of 2024-05-01", "a of 2024-05-02")
    said = " | ".join(found.notes)
    for words in (
        "column sigma taken as standard deviations of the depth",
        "column draft is not added: depths are taken from the water",
        "1 depths in depth are negative: above the level",
        "1 rows stand in the table before",
        # 0.9 m is more than three times 0.28 m, 0.4 m is less than three times 0.14 m
        "2 soundings lie at the place of another one of the same day: their mean is taken; at 1 places they "
        "differ by more than 3 sigmas",
    ):
        assert words in said
    plain = read_soundings(tmp_path / "t.csv", UTM, level_m=None, line_column=None, **known)
    assert plain.height_m == pytest.approx(found.height_m - 10.0)
    # without sigmas and times: the stated one, one day without a name
    bare = pd.read_csv(tmp_path / "t.csv").drop(columns=["sigma", "time"]).rename(columns={"depth": "h"})
    bare.iloc[[0, 2, 4, 6, 7]].to_csv(tmp_path / "b.csv", index=False)
    bare = read_soundings(
        tmp_path / "b.csv", UTM, column="h", depth=False, level_m=3.0, line_column=None, sigma_m=0.5
    )
    assert bare.height_m.tolist() == [1.0, 2.0, 3.0, -0.5, 3.0]  # three of five above the level refuse
    assert (bare.sigma_m == 0.5).all()
    assert (bare.day, bare.days, bare.t_s, bare.run, bare.runs) == (None, (), None, None, ())
    assert any("column h taken as heights" in note for note in bare.notes)
    assert not any("draft" in note for note in bare.notes)


@pytest.mark.parametrize(
    ("values", "how", "words"),
    [
        ("-0.7 -0.8 0.9 1.1", {"column": "v", "depth": True}, None),
        ("-0.7 -0.8 -0.9 1.1", {"column": "v", "depth": True}, r"75% of the depths in v are negative"),
        ("0.7 0.8 -0.9 -1.1", {"column": "v", "level_m": 0.0}, None),
        (
            "0.7 0.8 0.9 -1.1",
            {"column": "v", "level_m": 0.0},
            r"75% of the heights in v are above the level of 0 m",
        ),
        ("0.7 0.8 0.9 1.1", {}, "one column of depths or of heights by its name"),
        (
            "0.7 0.8 0.9 1.1",
            {"column": "bed_height", "depth": True},
            r"holds heights by its name.*--height bed_height",
        ),
        ("0.7 0.8 0.9 1.1", {"column": "depth", "depth": False}, r"holds depths by its name.*--depth depth"),
    ],
)
def test_values_that_are_of_the_other_kind(values, how, words, tmp_path):
    table = pd.DataFrame({"x": ORIGIN[0] + np.array([0.0, 5, 10, 15]), "y": ORIGIN[1] + [0.0, 5, 0, 5]})
    table = table.assign(v=values.split(), depth=2.0, bed_height=3.0)
    table.to_csv(tmp_path / "t.csv", index=False)
    how = {"column": None, "depth": None, "level_m": None, "line_column": None, "sigma_m": 0.1} | how
    if words is None:
        expected = [float(v) * (-1 if how["depth"] else 1) for v in values.split()]
        assert read_soundings(tmp_path / "t.csv", UTM, **how).height_m.tolist() == expected
        return
    with pytest.raises(InputError, match=f"(?s){words}"):
        read_soundings(tmp_path / "t.csv", UTM, **how)


@pytest.mark.parametrize("off_m", [0.045, 0.055])
def test_one_straight_line_is_one_within_five_centimetres(off_m, tmp_path):
    x = np.arange(8.0)
    table = pd.DataFrame(
        {"x": ORIGIN[0] + x, "y": ORIGIN[1] + off_m * np.array([1, -1, -1, 1] * 2), "z": 1.0}
    )
    table.to_csv(tmp_path / "t.csv", index=False)
    how = {"column": "z", "depth": True, "level_m": None, "line_column": None, "sigma_m": 0.1}
    if off_m > 0.05:
        assert len(read_soundings(tmp_path / "t.csv", UTM, **how).line) == 8
        return
    with pytest.raises(InputError, match=r"within 0\.0[45] m of one straight line"):
        read_soundings(tmp_path / "t.csv", UTM, **how)


def test_soundings_of_others_for_a_survey(tmp_path):
    """Places and heights in the local frame, lines of the second table after those of the first."""
    frame = LocalFrame(lat_deg=48.75, lon_deg=15.0, h_ell_m=300.0)
    x, y = np.tile([0.0, 5.0, 10.0], 3), np.repeat([0.0, 5.0, 10.0], 3)
    xy = frame.to_map(np.column_stack([x, y, np.zeros(9)]), UTM)[:, :2]
    for name, z in (("a", 324.9), ("b", 275.1), ("far", 326.0), ("deep", 2.0)):
        table = pd.DataFrame({"x": xy[:, 0], "y": xy[:, 1], "z": z, "leg": np.repeat([4, 7, 9], 3)})
        table.to_csv(tmp_path / f"{name}.csv", index=False, float_format="%.6f")
    of = {"line_column": "leg", "sigma_m": 0.07, "sigma_common_m": 0.03}
    found = read_other_soundings([tmp_path / "a.csv", tmp_path / "b.csv"], frame, UTM, Bathymetry(table=of))
    assert found["east_m"].to_numpy() == pytest.approx(np.tile(x, 2), abs=2e-3)
    assert found["north_m"].to_numpy() == pytest.approx(np.tile(y, 2), abs=2e-3)
    assert found["up_m"].to_numpy() == pytest.approx(np.repeat([24.9, -24.9], 9), abs=1e-3)
    assert found["depth_m"].isna().all()
    assert found["line"].tolist() == np.repeat(np.arange(6), 3).tolist()
    assert set(found["sigma_white_m"]) == {0.07}
    assert set(found["sigma_common_m"]) == {0.03}
    with pytest.raises(InputError, match=r"heights about 326\.0 m, the survey's are about 300\.0 m"):
        read_other_soundings([tmp_path / "far.csv"], frame, UTM, Bathymetry())
    deep = read_other_soundings([tmp_path / "deep.csv"], frame, UTM, Bathymetry(table={"depth": True}))
    assert deep["up_m"].isna().all()
    assert (deep["depth_m"] == 2.0).all()
    assert deep["east_m"].to_numpy() == pytest.approx(x, abs=2e-3)


def test_cells_as_wide_as_soundings_lie_apart():
    square = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    for apart, cell in (
        (1.0, 1.0),
        (1.9, 2.0),
        (2.1, 5.0),
        (5.04, 5.0),
        (0.102, 0.2),
        (0.02, 0.1),
        (60, 100),
    ):
        assert usual_cell_m(apart * square) == pytest.approx(cell)
    # a pair 0.1 m apart at each end of 1 km by 2 km: half a million cells of 2 m
    pairs = np.array([[0.0, 0.0], [0.1, 0.0], [1000.0, 2000.0], [1000.0, 1999.9]])
    assert usual_cell_m(pairs) == 2.0
    assert usual_cell_m(2 * pairs) == 5.0


# ---------------------------------------------------------------- lines of soundings


def walk(*steps: tuple[int, float, float]) -> np.ndarray:
    """Places of steps (number, length, heading from east in degrees), from the origin."""
    each = np.concatenate([np.tile([long, np.deg2rad(way)], (n, 1)) for n, long, way in steps])
    step = each[:, :1] * np.column_stack([np.cos(each[:, 1]), np.sin(each[:, 1])])
    return np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)])


def test_lines_end_at_turns_and_holes():
    assert _lines_by_place(walk((10, 1, 0), (9, 1, 90))).tolist() == [0] * 11 + [1] * 9
    assert not _lines_by_place(walk((10, 1, 0), (10, 1, 44))).any()
    assert not _lines_by_place(walk((10, 1, 170), (10, 1, -150))).any()  # through north by west: 40 degrees
    for hole, lines in ((7.9, 1), (8.1, 2)):
        assert _lines_by_place(walk((10, 1, 0), (1, hole, 0), (9, 1, 0))).max() == lines - 1
    assert _lines_by_place(walk((10, 1, 0), (1, 20, 0), (9, 1, 0))).tolist() == [0] * 11 + [1] * 10
    # a bend: the course that is kept follows by a fifth of each turn, five turns behind it
    assert not _lines_by_place(walk(*((1, 1, 8 * k) for k in range(30)))).any()
    assert _lines_by_place(walk(*((1, 1, 10 * k) for k in range(30)))).any()
    # steps of a boat that drifts on the spot have no course
    assert not _lines_by_place(walk((10, 1, 0), (1, 0.29, 90), (10, 1, 0))).any()
    assert _lines_by_place(walk((10, 1, 0), (1, 0.31, 90), (10, 1, 0))).any()
    # two places of a turn go to the line before them
    found = _lines_by_place(walk((10, 1, 0), (2, 1, 90), (10, 1, 180)))
    assert found.tolist() == [0] * 13 + [1] * 10
    assert _lines_by_place(walk((2, 1, 0))).tolist() == [0, 0, 0]


def test_lines_of_a_shuffled_file_are_clusters():
    order = np.random.default_rng(3).permutation(60)
    for apart, lines in ((7.9, 1), (8.1, 3)):
        xy = np.column_stack([np.tile(np.arange(20.0), 3), np.repeat(apart * np.arange(3), 20)])
        found = _lines_by_place(xy[order])
        assert len(set(found)) == lines
        if lines > 1:
            assert len(set(zip(found, order // 20, strict=True))) == 3
    # a new course at each third place tells no lines
    for each, lines in ((3, 1), (4, 3)):
        way = [0.0, 90.0, 180.0]
        xy = walk((each - 1, 1, way[0]), (each, 1, way[1]), (each, 1, way[2]))
        assert len(set(_lines_by_place(xy))) == lines


def test_the_way_through_middles_takes_the_longest_branch():
    places = np.array([[30.0, 0.0], [0.0, 0.0], [20.0, 0.0], [10.0, 0.0], [10.0, 8.0], [40.0, 1.0]])
    assert _chain(places).tolist() in ([1, 3, 2, 0, 5], [5, 0, 2, 3, 1])
    assert _chain(places[:1]).tolist() == [0]
    assert _chain(places[:2]).tolist() in ([0, 1], [1, 0])


@pytest.mark.parametrize("rise", [-0.01, 0.01])
def test_a_centre_line_through_the_middles_of_sections_flows_downwards(rise):
    """Middles 1 m to the right of the axis; the line goes on by two widths of 14 m at its ends."""
    of = sections(rise)
    line = centre_of_lines(of.places_m, of.height_m, of.line)
    east = np.array([5.0 - 28.0, 95.0 + 28.0])[:: 1 if rise < 0 else -1]
    assert line.to_map([0.0, line.length_m], 0.0) - ORIGIN == pytest.approx(
        np.column_stack([east, [-1.0, -1.0]])
    )


def test_a_centre_line_along_lines_down_the_river():
    """Three lines along, the first one longer, with a hole: no way through their middles is long enough."""
    x = np.arange(0.0, 80.5, 0.5)
    y = [4.0, 0.0, -1.0]
    xy = np.concatenate([np.column_stack([x, np.full(len(x), k)]) for k in y])
    line = centre_of_lines(ORIGIN + xy, -xy[:, 0], np.repeat([0, 1, 2], len(x)))
    found = line.points_m - ORIGIN
    inner = found[(found[:, 0] > 0) & (found[:, 0] < 80)]
    # half way between 4 m and -1 m, in the middles of eight stretches
    assert inner[:, 0] == pytest.approx(np.arange(5.0, 80.0, 10.0))
    assert inner[:, 1] == pytest.approx(1.5)
    assert (found[0, 0], found[-1, 0]) == pytest.approx((5.0 - 160.0, 75.0 + 160.0))
    # as many metres through four middles as twice the usual line is not long enough
    one = soundings_at(xy[: len(x)] + np.array([0.0, 1.0]), -x, np.zeros(len(x), dtype=np.int64))
    line = centre_of_lines(one.places_m, one.height_m, one.line)
    assert line.to_flow(one.places_m)[1] == pytest.approx(0.0, abs=1e-9)


def test_half_widths_are_those_of_the_lines_nearby():
    """Lines at 0, 10 and 30 m: each counts as far as the widest gap, 20 m."""
    n = np.array([[-1.0, 2.0], [-3.0, 1.0], [-0.2, 5.0]])
    widths = hull_of_lines(np.repeat([0.0, 10.0, 30.0], 2), n.ravel(), np.repeat([7, 3, 5], 2))
    left, right = widths([0.0, 9.0, 11.0, 30.0, -0.1, 30.1])
    assert left == pytest.approx([2.0, 2.0, 5.0, 5.0, np.nan, np.nan], nan_ok=True)
    assert right == pytest.approx([3.0, 3.0, 3.0, 3.0, np.nan, np.nan], nan_ok=True)
    # one line along: a fiftieth of it, a metre at least; to the sides of it half a metre at least
    s = np.linspace(0.0, 200.0, 201)
    left, right = hull_of_lines(s, np.where(np.abs(s - 100) < 0.1, 6.0, 0.1), np.zeros(201, dtype=int))(
        [100.0, 102.0, 105.1, 94.9]
    )
    assert left.tolist() == [6.0, 6.0, 0.5, 0.5]
    assert set(right) == {0.5}


# ---------------------------------------------------------------- banks and outlines


def test_bank_lines_are_data_at_even_places(tmp_path):
    """Banks 20 m apart: a datum each metre, one number for each 20 m of a side."""
    banks = write_shapes(
        tmp_path / "b.geojson",
        ({"side": "left"}, line_string((0, 10, 5.0), (100, 10, 5.0))),
        ({"side": "right"}, line_string((0, -10, 5.2), (100, -10, 5.2))),
    )
    of = sections()
    found = water_of(of, UTM, Bathymetry(), line=AXIS, banks=banks)
    assert found.notes == (
        "b.geojson states no coordinate system: taken for places in WGS 84 / UTM zone 33N",
    )
    assert (found.width_m, found.edge, found.area, found.basin) == (pytest.approx(20.0), "banks", None, None)
    assert found.reason == "along the centre line that is given"
    shore = found.shore
    for side, sign in (("left", 1), ("right", -1)):
        mine = shore[np.sign(shore["n_m"]) == sign]
        s = mine["s_m"].to_numpy()
        assert s == pytest.approx(13.1 + np.arange(101.0))
        assert mine["east_m"].to_numpy() - ORIGIN[0] == pytest.approx(s - 13.1, abs=1e-6)
        assert mine["north_m"].to_numpy() - ORIGIN[1] == pytest.approx(sign * 10.0)
        assert mine["n_m"].to_numpy() == pytest.approx(sign * 10.0)
        assert mine["line"].tolist() == (-2 - 2 * (s // 20).astype(int) - (side == "left")).tolist()
        assert (mine["up_m"] == (5.0 if side == "left" else 5.2)).all()
    assert shore["sigma_white_m"].to_numpy() == pytest.approx(0.15)  # half a metre across, a rise of 0.3
    assert not shore[["sigma_slow_m", "sigma_common_m"]].to_numpy().any()
    assert set(shore["source"]) == {"bank"}
    # coarse cells: one datum a cell; a level is that of the shores; no data if none are wanted
    coarse = water_of(of, UTM, Bathymetry(cell_m=5.0), line=AXIS, banks=banks, level_m=5.3)
    assert len(coarse.shore) == 2 * 21
    assert set(coarse.shore["up_m"]) == {5.3}
    assert not len(water_of(of, UTM, Bathymetry(bank_as_data=False), line=AXIS, banks=banks).shore)
    # the level may be 0.5 m above the heights of the banks, whose median is 5.1 m
    assert len(water_of(of, UTM, Bathymetry(), line=AXIS, banks=banks, level_m=5.55).shore)
    with pytest.raises(
        InputError, match=r"the level of 5\.65 m lies 0\.5 m above the bank lines|0\.6 m above"
    ):
        water_of(of, UTM, Bathymetry(), line=AXIS, banks=banks, level_m=5.65)
    # zeros are no heights, and a plain line has none
    for z in ((0.0,), ()):
        shapes = [({}, line_string((0, n, *z), (100, n, *z))) for n in (10, -10)]
        flat = write_shapes(tmp_path / "flat.geojson", *shapes)
        assert not len(water_of(of, UTM, Bathymetry(), line=AXIS, banks=flat).shore)
        assert len(water_of(of, UTM, Bathymetry(), line=AXIS, banks=flat, level_m=0.0).shore) == len(shore)
    lone = write_shapes(tmp_path / "lone.geojson", ({}, line_string((0, 10), (100, 10))))
    with pytest.raises(InputError, match="no right bank beside the centre line"):
        water_of(of, UTM, Bathymetry(), line=AXIS, banks=lone)


@pytest.mark.parametrize("turned", [False, True])
def test_the_line_between_two_banks_flows_downwards_or_as_they_say(turned, tmp_path):
    """Banks 20 m apart in any order; the line goes on by about their distance at its ends."""
    ways = [line_string((0, 10), (100, 10)), line_string((100, -10), (0, -10))]
    of = sections(0.01 if turned else -0.01)
    bare = write_shapes(tmp_path / "b.geojson", *(({}, way) for way in ways[:: -1 if turned else 1]))
    sides = ("right", "left") if turned else ("left", "right")
    told = write_shapes(tmp_path / "s.geojson", *(({"side": s}, w) for s, w in zip(sides, ways, strict=True)))
    ring = line_string((0, 10), (100, 10), (100, -10), (0, -10), (0, 10))
    outline = write_shapes(tmp_path / "o.geojson", ({}, ring))
    halves = [line_string((0, 10), (50, 10)), line_string((50, 10), (100, 10)), ways[1]]
    several = write_shapes(
        tmp_path / "h.geojson", *(({"side": s}, w) for s, w in zip((sides[0], *sides), halves, strict=True))
    )
    ends = np.array([[-20.0, 0.0], [120.0, 0.0]])[:: -1 if turned else 1]
    for path, heights in ((bare, of.height_m), (told, -of.height_m), (several, -of.height_m)):
        banks, _ = read_bank_lines(path, UTM, None, None, (of.places_m, heights))
        found = banks.line.to_map([0.0, banks.line.length_m], 0.0) - ORIGIN
        # the last of the even places is left out: a twentieth of the length at most
        assert found == pytest.approx(ends, abs=6.0)
        assert np.stack(banks.half_widths_m([40.0, 90.0])) == pytest.approx(10.0)
        assert len(banks.table) == 800
        assert set(np.sign(banks.table["n_m"]) * banks.table["side"].map({"left": 1, "right": -1})) == {1.0}
    # an outline is cut where it is longest, and its ends are no banks
    banks, _ = read_bank_lines(outline, UTM, None, None, (of.places_m, of.height_m))
    middle = banks.line.to_map(np.linspace(50, banks.line.length_m - 50, 5), 0.0) - ORIGIN
    assert np.abs(middle[:, 1]).max() < 3.0
    assert (middle[-1, 0] > middle[0, 0]) != turned
    for shapes, words in (
        ([({}, ways[0])] * 3, r"3 lines with sides \['None'\]"),
        ([({}, ring), ({}, ring)], "2 lines with sides"),
        ([({"side": "left"}, ways[0])], r"1 lines with sides \['left'\]"),
    ):
        with pytest.raises(InputError, match=words):
            read_bank_lines(
                write_shapes(tmp_path / "x.geojson", *shapes), UTM, None, None, (ORIGIN[:0], ORIGIN[:0])
            )


def test_soundings_outside_of_banks_and_outlines_are_counted(tmp_path):
    """Half of them may lie there; a place within half a metre of an outline is inside."""
    banks = write_shapes(tmp_path / "b.geojson", *(({}, line_string((0, n), (100, n))) for n in (5, -5)))
    ring = shapely.Polygon(line_string((0, 5.6), (100, 5.6), (100, -5.6), (0, -5.6)).coords)
    outline = write_shapes(tmp_path / "o.geojson", ({}, ring))
    of = sections()  # of eight places of a section -8, -6 and 6 m are behind the banks
    found = water_of(of, UTM, Bathymetry(), line=AXIS, banks=banks)
    assert found.notes[1:] == ("30 soundings outside the banks, used",)
    assert found.width_m == pytest.approx(10.0)
    for coordinates, edge in (("flow", "shore"), ("map", "shore")):
        found = water_of(of, UTM, Bathymetry(), line=AXIS, banks=outline, coordinates=coordinates)
        words = "banks" if coordinates == "flow" else "shores"
        assert f"10 soundings outside the {words}, used" in found.notes
        assert (found.edge, found.reason) == (edge, "as stated")
        assert found.area.equals(shapely.Polygon(ring))
    far = soundings_at(of.places_m - ORIGIN + [0.0, 8.5], of.height_m, of.line)  # five of eight
    with pytest.raises(InputError, match="62% of the soundings lie outside the banks"):
        water_of(far, UTM, Bathymetry(), line=AXIS, banks=banks)
    near = soundings_at(of.places_m - ORIGIN + [0.0, 6.5], of.height_m, of.line)  # four of eight
    assert water_of(near, UTM, Bathymetry(), line=AXIS, banks=banks).notes[-1].startswith("40 soundings")
    short = FlowLine.through(ORIGIN + np.array([[41.0, 0.0], [60.0, 0.0], [150.0, 0.0]]))
    assert water_of(of, UTM, Bathymetry(), line=short).line is short  # four of ten sections before its start
    short = FlowLine.through(ORIGIN + np.array([[61.0, 0.0], [80.0, 0.0], [150.0, 0.0]]))
    with pytest.raises(InputError, match="60% of the soundings lie beyond the ends of the centre line"):
        water_of(of, UTM, Bathymetry(), line=short)


def test_heights_of_the_shore_of_a_lake(tmp_path):
    """A stated level before the outline's own height before zero below which depths count."""
    ring = [(-2, -12), (102, -12), (102, 10), (-2, 10)]
    high = write_shapes(
        tmp_path / "h.geojson", ({}, shapely.Polygon(line_string(*((*p, 7.0) for p in ring)).coords))
    )
    flat = write_shapes(tmp_path / "f.geojson", ({}, shapely.Polygon(line_string(*ring).coords)))
    of = sections()
    for banks, how, up in (
        (high, {}, 7.0),
        (high, {"depths": True}, 7.0),
        (high, {"level_m": 7.3}, 7.3),
        (flat, {"depths": True}, 0.0),
        (flat, {"level_m": 7.3}, 7.3),
    ):
        shore = water_of(of, UTM, Bathymetry(), banks=banks, coordinates="map", **how).shore
        assert set(shore["up_m"]) == {up}
        assert shore["sigma_white_m"].to_numpy() == pytest.approx(0.15)
        # 800 places of one ring, one number for twenty of them; none as far away as half the soundings reach
        xy = shore[["east_m", "north_m"]].to_numpy()
        assert shapely.distance(shapely.polygons(ORIGIN + ring).exterior, shapely.points(xy)).max() < 1e-6
        assert len(shore) == 252 // 0.5  # places at least a cell apart
        assert sorted(set(shore["line"]), reverse=True) == list(range(-2, -2 - 26, -1))
        assert np.bincount(-shore["line"])[2:-1].tolist() == [20] * 25
        water = water_of(of, UTM, Bathymetry(), banks=banks, coordinates="map", **how)
        turned = water.line.to_flow(xy)
        assert shore["s_m"].to_numpy() == pytest.approx(turned[0])
        assert shore["n_m"].to_numpy() == pytest.approx(turned[1])
        assert water.width_m == pytest.approx(22.0, rel=0.02)
        assert water.basin.radius_m == pytest.approx(11.0, rel=0.02)
    plain = Bathymetry(bank_as_data=False)
    assert not len(water_of(of, UTM, plain, banks=high, coordinates="map").shore)
    for level, words in ((7.4, None), (7.6, "0.6 m above"), (6.6, None), (6.4, "0.6 m below")):
        notes = water_of(of, UTM, Bathymetry(), banks=high, coordinates="map", level_m=level).notes
        told = [note for note in notes if "of the outline" in note]
        assert bool(told) == (words is not None)
        assert words is None or f"the level of {level:g} m lies {words} the outline" in told[0]
    # what was sounded, a cell wider, is no shore
    bare = water_of(of, UTM, Bathymetry(cell_m=2.0), coordinates="map", level_m=7.0)
    assert (len(bare.shore), bare.edge) == (0, "edge of the soundings")
    assert bare.basin.wkt == ""
    assert bare.area.bounds == pytest.approx((*np.add(ORIGIN, [3.0, -10.0]), *np.add(ORIGIN, [97.0, 8.0])))
    # another part of the water: a bay 200 m off the soundings
    arm = shapely.box(*np.add(ORIGIN, [0.0, -12.0]), *np.add(ORIGIN, [400.0, 10.0]))
    long = write_shapes(tmp_path / "l.geojson", ({}, arm))
    shore = water_of(of, UTM, Bathymetry(), banks=long, coordinates="map", level_m=0.0).shore
    half = np.hypot(90.0, 14.0) / 2
    assert shore["east_m"].max() - ORIGIN[0] == pytest.approx(95.0 + half, abs=1.5)


def test_lines_islands_and_maps_are_read(tmp_path):
    line = line_string((0, 0), (50, 1), (100, 0))
    drawn = write_shapes(tmp_path / "l.geojson", ({}, line))
    places = np.array(line.coords)
    pd.DataFrame(places, columns=["x", "y"]).to_csv(tmp_path / "l.csv", index=False)
    frame = LocalFrame(lat_deg=48.7, lon_deg=15.1, h_ell_m=300.0)
    local = frame.from_map(np.column_stack([places, np.full(3, 300.0)]), UTM)[:, :2]
    for path in (drawn, tmp_path / "l.csv"):
        notes: list[str] = []
        assert read_line(path, UTM, notes).points_m == pytest.approx(places)
        assert read_line(path).points_m == pytest.approx(places)
        assert read_line(path, UTM, frame=frame).points_m == pytest.approx(local)
    with pytest.raises(InputError, match="2 lines"):
        read_line(write_shapes(tmp_path / "2.geojson", ({}, line), ({}, line)), UTM)
    degrees = {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}
    of = json.loads(drawn.read_text())
    of["features"][0]["geometry"]["coordinates"] = [[15.0, 48.0], [15.001, 48.001], [15.002, 48.0]]
    (tmp_path / "d.geojson").write_text(json.dumps(of | {"crs": {"type": "name", "properties": degrees}}))
    with pytest.raises(InputError, match="a centre line in WGS 84"):
        read_line(tmp_path / "d.geojson")
    assert read_line(tmp_path / "d.geojson", UTM).points_m[0, 0] == pytest.approx(500_000.0)
    ring = shapely.box(*ORIGIN, *np.add(ORIGIN, [4.0, 2.0]))
    (island,) = read_islands(write_shapes(tmp_path / "i.geojson", ({}, ring)), UTM)
    assert sorted(set(island)) == sorted(
        (ORIGIN[0] + x, ORIGIN[1] + y) for x in (0.0, 4.0) for y in (0.0, 2.0)
    )
    assert map_crs("EPSG:32633") == UTM
    assert map_crs("EPSG:2263", feet=True).is_projected
    for text, feet, words in (
        ("EPSG:2263", False, "is in US survey foot$|is in US survey foot[^s]"),
        ("EPSG:4326", True, "is in degrees"),
        ("EPSG:99999", False, "--crs EPSG:99999"),
    ):
        with pytest.raises(InputError, match=words):
            map_crs(text, feet=feet)


@pytest.mark.parametrize(
    ("changed", "river", "why"),
    [
        ({}, True, "the soundings reach 5.0 times as far along their middles as across"),
        ({"lost": 9}, True, "the soundings reach"),
        ({"lost": 11}, False, "11% of the soundings have no place along a line through their middles"),
        ({"long_m": 61.0}, True, "the soundings reach 3.0 times"),
        ({"long_m": 58.0}, False, "the soundings reach 2.9 times as far along their middles as across"),
        # half of an even spread lies within half of it: 4.1 and 3.9 m, a fifth of the width is 4 m
        ({"wide_m": 8.2}, True, "the soundings reach"),
        ({"wide_m": 7.8}, False, "the soundings follow one course, half of them within 3.9 m across it"),
    ],
)
def test_what_tells_a_river_by_soundings_alone(changed, river, why, monkeypatch):
    of = {"lost": 0, "long_m": 100.0, "wide_m": 15.0} | changed
    soundings = sections(long_m=130.0)
    n = len(soundings.line)
    s, across, fold = np.linspace(0, of["long_m"], n), np.linspace(0, of["wide_m"], n), np.zeros(n, bool)
    fold[: round(of["lost"] / 100 * n)] = True
    s[fold], across[fold] = -1e4, 1e4
    bare = water_of(soundings, UTM, Bathymetry(), coordinates="flow")
    line = SimpleNamespace(to_flow=lambda _: (s, across, fold))
    found = replace(bare, line=line, width_m=20.0)
    monkeypatch.setattr("thalweg.bathymetry.tables._river", lambda *_: found)
    told = water_of(soundings, UTM, Bathymetry())
    assert told.reason.startswith(why)
    assert (told.line is line) == river


def test_soundings_and_cells_beyond_the_centre_line_are_left_out_and_told(tmp_path, monkeypatch):
    """A line that begins at 41 m: four of ten sections, and cells of the outline before it."""
    monkeypatch.setattr("thalweg.bathymetry.variogram._STEPS", 12)
    settings = Bathymetry(cell_m=4.0, model="matern32", drift="none", reach=20.0)
    short = FlowLine.through(ORIGIN + np.array([[41.0, 0.0], [60.0, 0.0], [150.0, 0.0]]))
    ring = shapely.box(*np.add(ORIGIN, [0.0, -10.0]), *np.add(ORIGIN, [100.0, 10.0]))
    banks = write_shapes(tmp_path / "o.geojson", ({}, ring))
    of = sections()
    rough = 0.2 * np.sin(np.arange(len(of.line)) ** 2)
    of = replace(of, height_m=of.height_m + rough)
    water = water_of(of, UTM, settings, line=short, banks=banks)
    found = bed_of_table(of, UTM, settings, water)
    facts = found.bed.facts
    assert (facts["soundings"], facts["folded"]) == (48, 32)
    assert "32 soundings without flow coordinates left out" in found.notes
    assert found.validation["coordinates"] == {
        "kind": "flow",
        "reason": "along the centre line that is given",
    }
    x, y = (found.bed.grid.centres_m() - ORIGIN).T
    inside = (x > 0) & (x < 100) & (np.abs(y) < 10)
    lost = int((inside & (x < 41.0)).sum())
    assert any(
        note.startswith(f"{lost} cells of the outline are no bed: beyond the ends") for note in found.notes
    )
    # a cell that holds a sounding is bed although its middle lies on the shore
    sounded = (np.abs(y + 10.0) < 1e-6) & np.isin(np.round(x), [46, 54, 66, 74, 86, 94])
    assert np.isfinite(found.bed.up_m).tolist() == ((inside & (x > 41.0)) | sounded).tolist()
    again = bed_of_table(of, UTM, settings, water_of(of, UTM, settings, line=short))
    assert not any("of the outline" in note for note in again.notes)


# ---------------------------------------------------------------- steps of runs, references


def test_what_is_left_of_steps_is_shared_by_lines_of_a_run(monkeypatch):
    """Errors that decay in a second of this time: neighbouring lines of a run share the run's variance."""
    sigma = np.array([0.3, 0.0, 0.1])
    stub = SimpleNamespace(
        shift_m=np.array([0.5, -0.2, 0.0]),
        sigma_m=sigma,
        sigma_common_m=np.array([0.01, 0.02, 0.03]),
        sigma_line_m=0.4,
        told=lambda names: (names, ["a note"]),
    )
    asked = []
    monkeypatch.setattr("thalweg.bathymetry.tables.agreement", lambda *words: asked.append(words) or stub)
    run, line = np.array([0, 0, 0, 1, 1, 2, 2]), np.array([0, 1, 1, 2, 3, 4, 4])
    of = soundings_at(np.zeros((7, 2)), np.arange(7.0), line)
    of = TableOfSoundings(**{k: getattr(of, k) for k in of.__slots__} | {"run": run, "runs": ("p", "q", "r")})
    found, left, names, notes = _agreed(of)
    assert found.height_m == pytest.approx(np.arange(7.0) - [0.5, 0.5, 0.5, -0.2, -0.2, 0.0, 0.0])
    assert left["sigma_common_m"].tolist() == [0.01, 0.01, 0.01, 0.02, 0.02, 0.03, 0.03]
    whole = np.hypot(sigma[run], 0.4)
    assert left["sigma_slow_m"].to_numpy() == pytest.approx(whole)
    t = left["t_even_s"].to_numpy()
    shared = np.outer(whole, whole) * np.exp(-np.abs(t[:, None] - t))
    own = sigma[run] ** 2 * (run[:, None] == run) + 0.16 * (line[:, None] == line)
    assert shared == pytest.approx(own, abs=1e-12)
    assert names["run"] == ("p", "q", "r")
    assert names["line"] == ("line 0", "line 1", "line 2", "line 3", "line 4")
    assert notes == ["a note"]
    assert asked[0][4].tolist() == run.tolist()
    # days are runs where none are told, and all is one run without days
    for day, runs in ((run, run.tolist()), (None, [0] * 7)):
        days = () if day is None else ("u", "v", "w")
        changed = {"run": None, "runs": (), "day": day, "days": days}
        names = _agreed(TableOfSoundings(**{k: getattr(of, k) for k in of.__slots__} | changed))[2]
        assert asked[-1][4].tolist() == runs
        assert names["run"] == (days or ("",))


def test_a_bed_beside_references_by_hand(tmp_path):
    """Four cells of 2 m: two heights in the first, one without a sigma in the second, none in the others."""
    frame = LocalFrame(lat_deg=48.75, lon_deg=15.0, h_ell_m=0.0)
    grid = Grid(west_m=500_000.0, north_m=5_400_004.0, cell_m=2.0, rows=2, columns=2, crs=UTM)
    bands = {
        "height_m": np.array([10.0, 12.0, 5.0, np.nan]),
        "sigma_m": np.array([0.3, 0.4, 0.1, np.nan]),
        "sigma_common_m": np.array([0.4, 0.3, 0.1, np.nan]),
        "distance_m": np.array([0.5, 3.0, 1.0, np.nan]),
    }
    write_raster(tmp_path / "bed.tif", grid, bands, tags={})
    text = "x,y,h_ell_m,sigma\n500001,5400003,10.4,0.2\n500000.5,5400002.5,10.8,0.4\n"
    (tmp_path / "r.csv").write_text(
        f"{text}500003,5400003,11.0,\n500003,5400001,7.0,0.1\n500009,5400001,7.0,0.1\n500003,5400003,,0.1\n"
    )
    settings = Bathymetry(table={"sigma_m": 0.6, "sigma_common_m": 0.5})
    found = against_reference(tmp_path / "bed.tif", [tmp_path / "r.csv"], UTM, settings)["r.csv"]
    # bed less reference: -0.6 with 0.5^2 + (0.2^2 + 0.4^2) / 4 + 0.5^2; 1.0 with 0.5^2 + 0.6^2 + 0.5^2
    squares = 0.36 / 0.55, 1.0 / 0.86
    assert (found["n"], found["not_foretold"], found["classes"]) == (2, 0, {})
    assert found["bias_m"] == pytest.approx(0.2, abs=1e-6)
    assert found["rmse_m"] == pytest.approx(np.sqrt(1.36 / 2), abs=1e-6)
    assert found["normalised_square"] == pytest.approx(np.mean(squares), rel=1e-5)
    # rasters and clouds carry no sigmas: the stated one counts
    write_raster(tmp_path / "r.tif", grid, {"h": np.array([9.0, np.nan, np.nan, np.nan])}, tags={})
    with LazWriter(tmp_path / "r.laz", UTM) as writer:
        writer.append(np.array([[500_001.0, 5_400_003.0, 9.0]]))
    for name in ("r.tif", "r.laz"):
        facts = against_reference(tmp_path / "bed.tif", [tmp_path / name], UTM, settings)[name]
        assert (facts["n"], facts["bias_m"]) == (1, pytest.approx(1.0, abs=1e-6))
        assert facts["normalised_square"] == pytest.approx(1 / 0.86, rel=1e-5)
    (tmp_path / "off.csv").write_text("x,y,h_ell_m\n500003,5400001,7.0\n500009,5400001,7.0\n")
    with pytest.raises(InputError, match="none of 2 heights lies on a cell of the bed"):
        against_reference(tmp_path / "bed.tif", [tmp_path / "off.csv"], UTM, settings)
    with pytest.raises(GeometryError, match="at least three"):
        FlowLine.through(frame.to_map(np.zeros((2, 3)), UTM)[:, :2])


@pytest.mark.parametrize(
    ("below_m", "words"),
    [(-0.1, "0.1 m above the banks"), (0.1, None), (19.9, None), (20.1, "20.1 m below the banks")],
)
def test_soundings_lie_below_the_banks_and_not_deeper_than_the_water_is_wide(below_m, words):
    table = pd.DataFrame(
        {"source": ["bank"] * 3 + ["sounding"] * 3, "up_m": [5.0, 0, 50, 5.0 - below_m, 9, -90]}
    )
    if words is None:
        _refuse_other_heights(table, 20.0)
    else:
        with pytest.raises(
            InputError, match=f"the soundings lie {words} in the median, the water is 20 m wide"
        ):
            _refuse_other_heights(table, 20.0)
    _refuse_other_heights(table[3:], 20.0)  # without banks nothing is known
