"""Beds of lakes: coordinates of the map, shores and islands, days that contradict each other, levels."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import shapely
import shapely.affinity
from pyproj import CRS

from tests.bands import band
from tests.conftest import check_whole
from thalweg.bathymetry import (
    BedModel,
    BedOfTable,
    FlowLine,
    Levels,
    Observations,
    Plane,
    TableOfSoundings,
    agreement,
    bed_of_table,
    methods,
    read_soundings,
    water_of,
)
from thalweg.bathymetry.bed import gridded
from thalweg.bathymetry.lake import elongation, farthest_told_m, lines_or_patches
from thalweg.bathymetry.tables import _agreed
from thalweg.bathymetry.variogram import Basin
from thalweg.cli import main
from thalweg.core import CoverageError, GeometryError, Grid, InputError, read_raster
from thalweg.settings.sections import Bathymetry

UTM = CRS("EPSG:32633")
ORIGIN = np.array([500_000.0, 5_400_000.0])
DAYS = ("2024-05-01", "2024-05-02", "2024-05-03")
OFFSETS = np.array([0.0, 1.0, -0.4])
"""How much too deep each day sounded."""
QUICK = Bathymetry(cell_m=4.0, model="matern32", drift="section")


def lake_shore() -> shapely.Polygon:
    """Three bays, 120 m across."""
    a = np.deg2rad(np.arange(0.0, 360.0, 3.0))
    r = 50.0 * (1 + 0.25 * np.cos(3 * a))
    return shapely.Polygon(ORIGIN + np.column_stack([1.2 * r * np.cos(a), r * np.sin(a)]))


SHORE = lake_shore()
ISLAND = shapely.Point(ORIGIN + np.array([8.0, -6.0])).buffer(7.0)
WATER = SHORE.difference(ISLAND)


def depth_of(xy: np.ndarray) -> np.ndarray:
    """Deeper away from the shore, with pools."""
    far = shapely.distance(WATER.boundary, shapely.points(xy))
    x, y = (xy - ORIGIN).T
    return 5.0 * (1 - np.exp(-far / 12.0)) * (1 + 0.25 * np.sin(x / 14.0) * np.cos(y / 11.0))


def tracks(spacing_m: float, *, along_east: bool) -> list[np.ndarray]:
    """Straight tracks over the lake, 3 m off the shores, soundings every 3 m."""
    inner = WATER.buffer(-3.0)
    west, south, east, north = inner.bounds
    out = []
    low, high = (south, north) if along_east else (west, east)
    for at in np.arange(low + spacing_m / 2, high, spacing_m):
        ends = [(west, at), (east, at)] if along_east else [(at, south), (at, north)]
        for part in shapely.get_parts(inner.intersection(shapely.LineString(ends))):
            if part.length > 8.0:
                places = shapely.line_interpolate_point(part, np.arange(0.0, part.length, 3.0))
                out.append(shapely.get_coordinates(places))
    return out


def soundings_of(places: list[np.ndarray], day: list[int], *, seed: int = 3) -> TableOfSoundings:
    xy = np.concatenate(places)
    number = np.repeat(np.arange(len(places)), [len(p) for p in places])
    days = np.array(day)[number]
    noise = 0.03 * np.random.default_rng(seed).standard_normal(len(xy))
    return TableOfSoundings(
        places_m=xy,
        height_m=-depth_of(xy) - OFFSETS[days] + noise,
        sigma_m=np.full(len(xy), 0.03),
        line=number,
        crs=UTM,
        column="depth",
        depth=True,
        day=days,
        days=DAYS,
    )


def of_three_days() -> TableOfSoundings:
    """Two days along, one across."""
    along, across = tracks(12.0, along_east=True), tracks(24.0, along_east=False)
    half = len(along) // 2
    return soundings_of(along + across, [0] * half + [1] * (len(along) - half) + [2] * len(across))


def write_outline(path: Path, *shapes: shapely.Geometry) -> Path:
    features = [
        {"type": "Feature", "properties": {}, "geometry": json.loads(shapely.to_geojson(g))} for g in shapes
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


def errors(found: BedOfTable) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cells (n, 2) with a height, their errors and whole sigmas."""
    of = found.bed
    known = np.isfinite(of.up_m)
    cells = of.grid.centres_m()[known]
    sigma = np.hypot(of.sigma_m, of.sigma_common_m)[known]
    return cells, of.up_m[known] + depth_of(cells), sigma


@pytest.fixture(scope="module")
def lake(tmp_path_factory):
    """Within an outline whose hole is the island."""
    path = write_outline(tmp_path_factory.mktemp("lake") / "water.geojson", WATER)
    soundings = of_three_days()
    water = water_of(soundings, UTM, QUICK, banks=path, depths=True)
    return water, bed_of_table(soundings, UTM, QUICK, water)


def test_a_lake_has_its_bays_and_no_bed_on_its_island(lake):
    water, found = lake
    assert isinstance(water.line, Plane)
    cells, error, sigma = errors(found)
    assert shapely.contains_xy(WATER, cells).all()
    assert found.bed.facts["area_m2"] == pytest.approx(WATER.area, rel=0.02)
    assert np.std(error) < 0.25
    # One observation: the mean of three days is one draw. Sigmas of the rest are twice the errors here,
    # between the tracks (0.62) they are 1.3 of them. The guard is `bed_study`, of 40 rivers.
    assert abs(np.mean(error)) < 2 * np.sqrt(np.mean(sigma**2))
    assert 0.5 < np.sqrt(np.nanmean(found.bed.sigma_m**2)) / np.std(error) < 2.5
    assert 0.4 < found.validation["normalised_square"] < 2.0
    assert found.validation["coordinates"]["kind"] == "map"
    assert "times as long as it is wide, which is no river" in found.notes[0]


def test_days_that_contradict_each_other_are_named_and_enlarge_the_sigma(lake):
    facts = lake[1].validation["agreement"]
    pairs = {(of["a"], of["b"]): of for of in facts["pairs of days"]}
    for (a, b), of in pairs.items():
        true = OFFSETS[DAYS.index(a)] - OFFSETS[DAYS.index(b)]
        assert of["contradicts"]
        assert of["difference_m"] == pytest.approx(true, abs=3 * of["sigma_m"] + 0.01)
    expected = OFFSETS - OFFSETS.mean()
    # the soundings hold depths
    steps = {of["run"]: of["step_m"] for of in facts["steps"]}
    assert list(steps.values()) == pytest.approx(-expected, abs=0.08)
    # the mean of three days with this scatter: 68 % of Student's distribution of two degrees of freedom
    expected = 1.32 * np.std(OFFSETS, ddof=1) / np.sqrt(3)
    assert facts["steps"][0]["sigma_common_m"] == pytest.approx(expected, rel=0.15)
    assert any("2024-05-03 lies" in note and "crossings" in note for note in lake[1].notes)
    assert any("brought to their mean" in note for note in lake[1].notes)


def test_the_bed_of_a_lake_in_all_its_files(lake, tmp_path):
    water, found = lake
    of, out = found.bed, tmp_path / "o"
    out.mkdir()
    (out / "centre_line.csv").write_text("of a former run")
    found.write(out, {"campaign": "lake"})
    grid, bands, tags = read_raster(out / "bed.tif")
    assert grid == of.grid
    values = {"height_m": of.up_m, "sigma_m": of.sigma_m, "sigma_common_m": of.sigma_common_m}
    values["distance_m"] = of.distance_m
    assert list(bands) == list(values)
    for name, value in values.items():
        np.testing.assert_array_equal(bands[name].ravel(), value.astype(np.float32))
    assert tags["campaign"] == "lake"
    for name in ("predicted", "methods"):
        table = getattr(found, name)
        pd.testing.assert_frame_equal(
            pd.read_csv(out / f"{name}.csv"), table, check_exact=False, rtol=0, atol=6e-5
        )
    told = json.loads((out / "validation.json").read_text())
    assert told.keys() == {*found.validation, "notes", "bed"}
    assert told["notes"] == list(found.notes)
    assert told["bed"] == of.facts
    assert json.loads((out / "variogram.json").read_text()) == json.loads(json.dumps(of.model.report()))
    assert not (out / "centre_line.csv").exists()
    line = FlowLine.through(ORIGIN + np.array([[0.0, 0.0], [5.0, 1.0], [10.0, 0.0]]))
    replace(found, water=replace(water, line=line)).write(out, {})
    np.testing.assert_allclose(FlowLine.read(out / "centre_line.csv").points_m, line.points_m, atol=1e-8)


def test_counts_and_cells_of_a_lake(lake):
    """Cells from the outline, as far as two ranges about the data; two of them about all."""
    water, found = lake
    of = found.bed
    soundings = of_three_days()
    assert found.notes[0] == f"map coordinates: {water.reason}"
    assert found.validation["coordinates"] == {
        "kind": "map",
        "reason": water.reason,
        "azimuth_deg": water.line.azimuth_deg,
    }
    assert found.validation["left_out"] == "lines"
    counts = {"soundings": len(soundings.line), "folded": 0, "bank places": len(water.shore)}
    assert of.facts == of.facts | counts
    places = np.concatenate([soundings.places_m, water.shore[["east_m", "north_m"]]])
    far = 2.0 * max(of.model.covariance.range_s_m, of.model.covariance.range_n_m)
    west, south, east, north = WATER.bounds
    low = np.clip([west, south], places.min(axis=0) - far, places.max(axis=0) + far) - 8.0
    high = np.clip([east, north], places.min(axis=0) - far, places.max(axis=0) + far) + 8.0
    first, last = np.floor(low / 4.0), np.ceil(high / 4.0)
    assert (of.grid.west_m, of.grid.north_m) == (4.0 * first[0], 4.0 * last[1])
    assert [of.grid.columns, of.grid.rows] == (last - first).tolist()


def test_the_model_of_a_lake_is_read_again(lake):
    model = lake[1].bed.model
    again = BedModel.of_report(json.loads(json.dumps(model.report())))
    places = np.array([[0.0, 0.0], [20.0, -10.0]])
    np.testing.assert_array_equal(again.drift.at(places), model.drift.at(places))


def test_days_that_agree_change_nothing():
    east, north = np.meshgrid(np.arange(0.0, 41.0), np.arange(0.0, 41.0, 10.0))
    along = np.column_stack([east.ravel(), north.ravel() + 0.5])
    xy = np.concatenate([along, along[:, ::-1]])
    day = np.repeat([0, 1], len(along))
    line = np.concatenate([north.ravel() // 10, 5 + north.ravel() // 10]).astype(np.int64)
    noise = 0.02 * np.random.default_rng(1).standard_normal(len(xy))
    same = agreement(xy, noise, np.full(len(xy), 0.02), line, day)
    assert same.pairs["run"]["n"].tolist() == [16]
    assert not same.pairs["run"]["contradicts"].any()
    nothing = [same.shift_m, same.sigma_m, same.sigma_common_m, [same.sigma_line_m]]
    assert not np.concatenate(nothing).any()
    # a third day beside them crosses none: a step of the others is its own too
    away = np.concatenate([xy, along + 500.0])
    step = np.concatenate([noise + 0.3 * day, noise[: len(along)]])
    three = np.concatenate([day, np.full(len(along), 2)])
    found = agreement(
        away, step, np.full(len(away), 0.02), np.concatenate([line, line[: len(along)] + 20]), three
    )
    assert found.pairs["run"]["difference_m"].tolist() == pytest.approx([0.3], abs=0.02)
    assert found.shift_m == pytest.approx([-0.15, 0.15, 0.0], abs=0.01)
    spread = 1.84 * np.std([0.0, 0.3], ddof=1)  # of two days: one degree of freedom
    assert found.sigma_common_m == pytest.approx([spread / np.sqrt(2)] * 2 + [spread], rel=0.1)


def test_the_mean_of_days_is_within_its_sigma_as_often_as_one_sigma_says():
    """Steps of two days, 100 times: a line each, which cross; the truth is zero. Of three days: above."""
    rng = np.random.default_rng(905)
    at = np.linspace(-20.0, 20.0, 11)
    lines = [at[:, None] * way + 0.3 * k for k, way in enumerate(np.eye(2))]
    day = np.repeat([0, 1], len(at))
    inside = 0
    for _ in range(100):
        height = rng.normal(0.0, 0.5, 2)[day] + rng.normal(0.0, 0.01, len(day))
        found = agreement(np.concatenate(lines), height, np.full(len(day), 0.01), day, day)
        inside += abs(np.mean(height - found.shift_m[day])) < found.sigma_common_m[0]
    # 68 of 100 expected; by the scatter alone 50
    assert inside == pytest.approx(68, abs=12)


# ---------------------------------------------------------------- which coordinates


def strip(long_m: float, wide_m: float) -> shapely.Polygon:
    return shapely.box(*ORIGIN, *(ORIGIN + np.array([long_m, wide_m])))


def grid_of(long_m: float, wide_m: float) -> TableOfSoundings:
    """Sections every 10 m."""
    at = np.arange(5.0, long_m, 10.0)
    across = np.arange(2.0, wide_m - 1, 2.0)
    return soundings_of(
        [ORIGIN + np.column_stack([np.full(len(across), x), across]) for x in at], [0] * len(at)
    )


ARM = shapely.union_all([strip(400.0, 30.0), shapely.affinity.translate(strip(30.0, 250.0), 180.0)])


@pytest.mark.parametrize(
    ("long_m", "wide_m", "outline", "river", "why"),
    [
        (200.0, 30.0, None, True, "times as far along"),
        (60.0, 40.0, None, False, "as far along their middles as across"),
        (200.0, 30.0, strip(200.0, 30.0), True, "6.7 times as long"),
        (60.0, 40.0, strip(60.0, 40.0), False, "which is no river"),
        # a reservoir with an arm as long as itself is no river, however thin it is
        (400.0, 30.0, ARM, False, "bays would be cut off"),
    ],
)
def test_what_shows_a_river(long_m, wide_m, outline, river, why, tmp_path):
    path = None if outline is None else write_outline(tmp_path / "w.geojson", outline)
    found = water_of(grid_of(long_m, wide_m), UTM, QUICK, banks=path)
    assert isinstance(found.line, FlowLine) == river
    assert why in found.reason
    stated = {"map": Plane, "flow": FlowLine}
    for coordinates, kind in stated.items():
        again = water_of(grid_of(long_m, wide_m), UTM, QUICK, banks=path, coordinates=coordinates)
        assert isinstance(again.line, kind)
        assert again.reason == "as stated"


def test_the_way_of_a_ship_is_no_river():
    """A passage of 6 km with some drift of 60 m at its end, and the same with lines across."""
    rng = np.random.default_rng(8)
    x = np.arange(0.0, 6000.0, 20.0)
    passage = np.column_stack([x, 400 * np.sin(x / 2000) + rng.normal(0, 2, len(x))])
    drift = passage[-1] + np.column_stack([np.linspace(0, 20, 30), np.linspace(-30, 30, 30)])
    ship = water_of(soundings_of([ORIGIN + passage, ORIGIN + drift], [0, 0]), UTM, QUICK)
    assert isinstance(ship.line, Plane)
    assert "one course" in ship.reason
    lines = [ORIGIN + p + np.column_stack([np.zeros(13), np.arange(-30.0, 31.0, 5.0)]) for p in passage[::10]]
    assert isinstance(water_of(soundings_of(lines, [0] * len(lines)), UTM, QUICK).line, FlowLine)


def test_outlines_as_closed_lines_with_islands_are_polygons(tmp_path):
    path = write_outline(tmp_path / "w.geojson", SHORE.exterior, ISLAND.exterior)
    found = water_of(of_three_days(), UTM, QUICK, banks=path, depths=True)
    assert (
        found.area.equals_exact(WATER, 0.01, normalize=True)
        or found.area.symmetric_difference(WATER).area < 1
    )
    assert (found.shore["up_m"] == 0).all()
    assert shapely.distance(WATER.boundary, shapely.points(found.shore[["east_m", "north_m"]])).max() < 1e-6
    # heights above a datum have no zero at the shore: it is no datum, which is said
    no_level = water_of(of_three_days(), UTM, QUICK, banks=path)
    assert not len(no_level.shore)
    assert any("--level" in note for note in no_level.notes)


def test_the_first_axis_is_the_one_along_which_heights_change_least():
    rng = np.random.default_rng(5)
    xy = ORIGIN + rng.uniform(-100, 100, (900, 2))
    for azimuth in (20.0, 65.0, 150.0):
        a = np.deg2rad(azimuth)
        across = (xy - ORIGIN) @ [np.cos(a), -np.sin(a)]
        along = (xy - ORIGIN) @ [np.sin(a), np.cos(a)]
        plane = Plane.of(xy, np.sin(across / 15.0) + np.sin(along / 60.0))
        assert abs((plane.azimuth_deg - azimuth + 90) % 180 - 90) < 8
        s, n, fold = plane.to_flow(xy)
        assert not fold.any()
        np.testing.assert_allclose(np.hypot(s, n), np.linalg.norm(xy - xy.mean(axis=0), axis=1))


def test_places_between_shore_and_middle():
    disc = shapely.Point(0.0, 0.0).buffer(100.0, quad_segs=90)
    assert elongation(disc) == pytest.approx(np.pi / 4, rel=0.01)
    assert elongation(strip(300.0, 30.0)) == pytest.approx(10.0, rel=0.01)
    basin = Basin(wkt=disc.wkt, radius_m=100.0)
    places = np.array([[0.0, 0.0], [50.0, 0.0], [0.0, -99.9], [0.0, 120.0]])
    assert basin.at(places) == pytest.approx([0.0, 0.5, 0.999, 1.0], abs=0.01)
    assert basin.margin(places).tolist() == [0.0, 0.0, 1.0, 1.0]
    assert not Basin().at(places).any()


# ---------------------------------------------------------------- single tracks


def test_a_single_track_over_a_pond_is_mapped_as_far_as_it_tells():
    """A spiral: its turns are 12 m apart, no patch of it is farther from the rest."""
    a = np.linspace(2 * np.pi, 8 * np.pi, 420)
    xy = ORIGIN + (12.0 / (2 * np.pi) * a * [np.cos(a), np.sin(a)]).T
    x, y = (xy - ORIGIN).T
    bed = TableOfSoundings(
        places_m=xy,
        height_m=-3 + 0.3 * np.sin(x / 15) * np.cos(y / 15),
        sigma_m=np.full(len(xy), 0.02),
        line=np.zeros(len(xy), dtype=np.int64),
        crs=UTM,
        column="z",
        depth=False,
    )
    settings = Bathymetry(cell_m=3.0, model="matern32", drift="none")
    water = water_of(bed, UTM, settings)
    found = bed_of_table(bed, UTM, settings, water)
    assert any("patches" in note for note in found.notes)
    known = np.isfinite(found.bed.up_m)
    x, y = (found.bed.grid.centres_m()[known] - ORIGIN).T
    assert np.hypot(x, y).max() < 12.0 * 4 + 5
    assert np.std(found.bed.up_m[known] - 0.3 * np.sin(x / 15) * np.cos(y / 15)) < 0.03
    assert found.bed.distance_m[known].max() <= farthest_told_m(xy, lines_or_patches(xy, bed.line, 1)[0])


def test_lines_that_are_scraps_become_patches():
    rng = np.random.default_rng(2)
    xy = rng.uniform(0, 100, (300, 2))
    number, patches = lines_or_patches(xy, np.arange(300) // 3, 1)
    assert not patches or len(np.unique(number)) == 24
    ordered = np.column_stack([np.tile(np.arange(50.0), 6), np.repeat(np.arange(6) * 10.0, 50)])
    lines = np.repeat(np.arange(6), 50)
    assert lines_or_patches(ordered, lines, 1) == (pytest.approx(lines), False)
    number, patches = lines_or_patches(ordered, lines * 10 + np.tile(np.arange(50) // 5, 6), 1)
    assert patches
    assert len(np.unique(number)) == 24
    with pytest.raises(GeometryError, match="5 soundings on 1 lines") as told:
        lines_or_patches(ordered[:5], lines[:5], 1)
    check_whole(told.value)


def test_thin_plates_among_soundings_of_one_straight_track_are_none(lake):
    """The 48 nearest soundings lie on one line: no plane goes through them."""
    at = np.arange(200.0)
    east, north = np.tile(at, 2), np.repeat([0.0, 1000.0], 200)
    nothing = np.zeros(400)
    data = Observations(
        s_m=east,
        n_m=north,
        height_m=np.sin(east),
        sigma_white_m=nothing + 0.1,
        sigma_slow_m=nothing,
        t_s=nothing,
        line=np.repeat([0, 1], 200),
    )
    height, sigma = methods(lake[1].bed.model, QUICK)["thin plates"](data, np.array([[100.0, 10.0]]))
    assert np.isnan(height).all()
    assert sigma is None


# ---------------------------------------------------------------- what cannot be


def test_soundings_of_several_waters_are_refused():
    far = grid_of(60.0, 40.0)
    far.places_m[-1] += 2e6
    with pytest.raises(InputError, match="2,000 km apart") as told:
        water_of(far, UTM, QUICK)
    check_whole(told.value)


def test_a_bed_that_leaves_its_data_behind_is_refused(lake):
    """Two values that stand for none among 400: left-out lines find nothing wrong."""
    of = lake[1].bed
    grid = Grid.around(ORIGIN + np.array([[0.0, 0.0], [9.0, 9.0]]), 3.0, UTM)
    flow = lake[0].line.to_flow(grid.centres_m())
    cells, inside = np.column_stack(flow[:2]), np.ones(len(flow[0]), dtype=np.bool_)
    wild = of.data.copy()
    covariance = of.model.covariance
    unsure = type(covariance)(kind="matern32", sill_m2=1e4, range_s_m=1.0, range_n_m=1.0)
    model = BedModel(drift=of.model.drift, covariance=unsure, compared={}, reason="")
    with pytest.raises(CoverageError, match="a median sigma of ") as told:
        gridded(wild, model, grid, cells, inside, Bathymetry(cell_m=3.0, reach=50), {})
    check_whole(told.value)


# ---------------------------------------------------------------- levels of the water

NOON = 1_714_564_800.0  # 2024-05-01 12:00 UTC


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("date,level_m\n2024-05-02,312.8\n2024-05-01,312.5\n", [312.5, 312.5, 312.8]),
        # in feet
        ("date;level_ft\n2024-05-01;10\n2024-05-02;20\n", [3.048, 3.048, 6.096]),
        ("2024-05-01T11:00,1.0\n2024-05-01T13:00Z,2.0\n2024-05-02T13:00,2.0\n", [1.5, 1.75, 2.0]),
        ("2024-05-01;11:00;1.0\n2024-05-01;13:00;2.0\n2024-05-02;13:00;2.0\n", [1.5, 1.75, 2.0]),
        # a name that says nothing: the last column
        ("date,q,zz\n2024-05-02,7,312.8\n2024-05-01,7,312.5\n", [312.5, 312.5, 312.8]),
    ],
)
def test_levels_by_day_and_by_time(text, expected, tmp_path):
    (tmp_path / "l.csv").write_text(text)
    levels = Levels.read(tmp_path / "l.csv")
    assert levels.at(NOON + np.array([0.0, 1800.0, 86_400.0])) == pytest.approx(expected)


def test_levels_of_a_gauge_without_dates(tmp_path):
    """Minutes of a day in quotes, as gauges write them."""
    (tmp_path / "g.csv").write_text('"00:00","4.00"\n"12:00:00","4.60"\n"12:30","4.90"\n')
    levels = Levels.read(tmp_path / "g.csv")
    assert levels.at(np.array([NOON, NOON + 600.0])) == pytest.approx([4.6, 4.7])
    bed = grid_of(60.0, 40.0)
    timed = TableOfSoundings(
        **{k: getattr(bed, k) for k in bed.__slots__ if k != "t_s"}, t_s=np.full(len(bed.line), NOON)
    )
    assert timed.above(levels).height_m == pytest.approx(bed.height_m + 4.6)
    for times, words in (
        ([NOON, NOON + 86_400.0], "soundings of 2 days"),
        ([NOON, NOON + 7200.0], "no level for 1 of 2"),
    ):
        with pytest.raises(InputError, match=words) as told:
            levels.at(np.array(times))
        check_whole(told.value)
    with pytest.raises(InputError, match="without times") as told:
        bed.above(levels)
    check_whole(told.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty"),
        ("date,level\n", "no level"),
        ("01/02/2024,3.0\n02/02/2024,3.1\n", "dates such as"),
        ("2024-05-01,a\nb,c\n", "without a number"),
        ("time,depth to water (m)\n2024-05-01T12:00,3.0\n2024-05-01T13:00,3.1\n", "positive upwards"),
        ("time (CEST),level\n12:00,3.0\n13:00,3.1\n", "times of day in the zone UTC.02:00"),
        ("time,level\n1:00 PM,3.0\n2:00 PM,3.1\n", "no time and level: 1:00 PM"),  # not of today
        ("time,level\n2024-10-27 02:30,3.0\n2024-10-27 02:30,3.4\n", "two levels of one time"),
    ],
)
def test_levels_that_are_none(text, words, tmp_path):
    (tmp_path / "l.csv").write_text(text)
    with pytest.raises(InputError, match=words) as told:
        Levels.read(tmp_path / "l.csv")
    check_whole(told.value)


# ---------------------------------------------------------------- the command


def test_the_command_maps_a_lake(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("thalweg.figures.save", lambda *_: None)
    of = grid_of(60.0, 40.0)
    table = pd.DataFrame(of.places_m, columns=["x", "y"]).assign(depth=-of.height_m)
    table.to_csv(tmp_path / "t.csv", index=False)
    words = ["bed", str(tmp_path / "t.csv"), "--crs", "EPSG:32633", "--depth", "depth", "--cell", "6"]
    words += ["--model", "matern32", "--drift", "none", "--force", "--out", str(tmp_path / "o")]
    (tmp_path / "o").mkdir()
    (tmp_path / "o/centre_line.csv").write_text("of a former run\n")
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "note: map coordinates: " in said
    assert "centre_line" not in said
    assert not (tmp_path / "o/centre_line.csv").exists()
    (tmp_path / "l.csv").write_text("2024-05-01,3.0\n")
    assert main([*words, "--levels", str(tmp_path / "l.csv")]) == 2
    assert "without times" in capsys.readouterr().err


# ---------------------------------------------------------------- runs of one day, and the outline as the map


def test_runs_are_pieces_between_pauses_or_names_of_a_column(tmp_path):
    """Two days; on the first one a pause of five minutes; the second day sails line a again."""
    east, north = np.meshgrid(np.arange(8.0) * 3, np.arange(4.0) * 10)
    t = np.arange(32) * 2.0
    t[16:] += 300.0
    t[24:] += 86_400.0
    name = np.repeat(["a", "b", "c", "a"], 8)
    table = tmp_path / "t.csv"
    rows = zip(500_000 + east.ravel(), 5_400_000 + north.ravel(), NOON + t, name, strict=True)
    lines = [f"{x},{y},{1 + 0.1 * k},{pd.Timestamp(s, unit='s')}Z,{n}" for k, (x, y, s, n) in enumerate(rows)]
    table.write_text("\n".join(["x,y,depth,time,track", *lines]))
    known = {"column": "depth", "depth": True, "level_m": None, "sigma_m": 0.02}
    by_pause = read_soundings(table, UTM, line_column=None, **known)
    assert by_pause.run is not None
    assert by_pause.run.tolist() == [0] * 16 + [1] * 8 + [2] * 8
    begins = ["2024-05-01 12:00", "2024-05-01 12:05", "2024-05-02 12:05"]
    assert by_pause.runs == tuple(f"the run of {time}" for time in begins)
    named = read_soundings(table, UTM, line_column="track", **known)
    assert named.run is not None
    assert np.unique(named.run).tolist() == [0, 1, 2, 3]
    assert len(set(named.run[[0, 8, 16, 24]].tolist())) == 4
    assert [name.split(" of ")[0] for name in named.runs] == ["a", "b", "c", "a"]


@pytest.mark.parametrize("scatter_m", [0.0, 0.15])
def test_steps_of_runs_are_adjusted_and_nothing_else_is(scatter_m):
    """Six runs of three lines; steps drawn anew, or none; of each draw the mean is not told."""
    rng = np.random.default_rng(5521)
    along, across = tracks(12.0, along_east=True), tracks(24.0, along_east=False)
    places = along + across
    run_of = np.arange(len(places)) // 3
    number = np.repeat(np.arange(len(places)), [len(p) for p in places])
    xy, run = np.concatenate(places), run_of[number]
    normalised = []
    for _ in range(12 if scatter_m else 1):
        step = rng.normal(0.0, scatter_m, run_of.max() + 1)
        height = -depth_of(xy) + step[run] + 0.03 * rng.standard_normal(len(xy))
        found = agreement(xy, height, np.full(len(xy), 0.03), number, run)
        if scatter_m == 0:
            assert not np.concatenate([found.shift_m, found.sigma_m, [found.sigma_line_m]]).any()
            continue
        error = found.shift_m - step
        assert found.sigma_run_m == pytest.approx(np.std(step, ddof=1), rel=0.5)
        normalised.append(np.sum(((error - error.mean()) / found.sigma_m) ** 2) / (len(step) - 1))
        assert np.std(error) < 0.3 * scatter_m
    if normalised:
        low, high = band(5 * len(normalised))
        assert low < np.mean(normalised) < high


def test_the_line_that_contradicts_others_is_named():
    """Of one run: tracks along are one line, each across is its own; the last one 0.5 m too high."""
    along, across = tracks(12.0, along_east=True), tracks(24.0, along_east=False)
    soundings = soundings_of(along + across, [0] * len(along + across))
    line = np.maximum(soundings.line - len(along) + 1, 0)
    last = line == len(across)
    lifted = replace(soundings, day=None, days=(), line=line, height_m=soundings.height_m + 0.5 * last)
    same, left, facts, notes = _agreed(lifted)
    assert same.height_m.tolist() == lifted.height_m.tolist()
    (told,) = facts["pairs of lines"]
    assert (told["a"], told["b"]) == ("line 0", f"line {len(across)}")
    assert told["difference_m"] == pytest.approx(0.5, abs=0.05)
    beside = f"(median of {told['n']} crossings, sigma {told['sigma_m']:.3f} m)"
    assert notes[0] == f"line {len(across)} lies {told['difference_m']:.3f} m above line 0 {beside}"
    assert len(left) == len(last)


def test_an_outline_is_the_map_in_flow_coordinates_too(tmp_path):
    """A bay that folds back behind a spit lies beyond the half widths, which are one number a side."""
    spit = shapely.affinity.translate(strip(60.0, 8.0), 150.0, 38.0)
    bay = shapely.affinity.translate(strip(70.0, 20.0), 150.0, 46.0)
    mouth = shapely.affinity.translate(strip(10.0, 10.0), 210.0, 38.0)
    water = shapely.union_all([strip(400.0, 40.0), bay, mouth]).difference(spit.buffer(-0.1))
    path = write_outline(tmp_path / "w.geojson", water)
    x, y = np.meshgrid(np.arange(5.0, 400.0, 20.0), np.arange(2.0, 66.0, 6.0))
    plain = Bathymetry(cell_m=8.0, model="matern32", drift="none", reach=8.0)
    places = ORIGIN + np.column_stack([x.ravel("F"), y.ravel("F")])
    soundings = soundings_of([places[shapely.contains_xy(water, places)]], [0])
    soundings = replace(soundings, line=pd.factorize(soundings.places_m[:, 0])[0])
    found = water_of(soundings, UTM, plain, banks=path, depths=True, coordinates="flow")
    assert isinstance(found.line, FlowLine)
    bed = bed_of_table(soundings, UTM, plain, found).bed
    row, column = bed.grid.at(soundings.places_m)
    on = np.isfinite(bed.up_m)[row * bed.grid.columns + column]
    assert on.all()
    assert bed.facts["area_m2"] == pytest.approx(water.area, rel=0.05)
