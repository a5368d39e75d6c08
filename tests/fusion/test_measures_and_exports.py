"""Sections, volumes and files for hydraulic programs, against formulas and other readers."""

import re
import time
from types import SimpleNamespace

import geopandas
import numpy as np
import pandas as pd
import pytest
import rasterio
import shapely
from scipy.spatial.distance import cdist

from tests.fusion.conftest import DEPTH_M, FRAME, GRID, HALF_WIDTH_M, LEVEL_UP_M, bed_up_m
from thalweg.bathymetry import REASONS, FlowLine
from thalweg.core import CoverageError, Grid, Trajectory, utc_text_from_gps
from thalweg.core.values import describe_layers, read_vectors
from thalweg.fusion import Dtm, River, map_of_campaign
from thalweg.fusion.exports import contour_lines, export_river, write_bag, write_csv, write_hecras, write_swmm
from thalweg.fusion.maps import _CONTOURS, _contours, _track, map_of_bed
from thalweg.fusion.measures import (
    correlated_sigma,
    cut_sections,
    depths_along,
    hydraulic_table,
    long_profile,
    volume_below,
)
from thalweg.settings.sections import Fusion

SETTINGS = Fusion(contour_m=0.5)
ORIGIN = {"lat_deg": FRAME.lat_deg, "lon_deg": FRAME.lon_deg, "h_ell_m": FRAME.h_ell_m}
MAP = {"origin": ORIGIN, "crs": "EPSG:25833"}


@pytest.fixture
def river(arc, banks):
    return River(flow=arc, banks=banks, frame=FRAME, crs=GRID)


@pytest.fixture
def model(river):
    outline = river.outline_m()
    corner = np.array([np.floor(outline[:, 0].min()) - 8, np.ceil(outline[:, 1].max()) + 8])
    shape = (
        int((corner[1] - outline[:, 1].min() + 8) / 0.25),
        int((outline[:, 0].max() + 8 - corner[0]) / 0.25),
    )
    zero = np.zeros(shape)
    empty = Dtm(
        height_m=zero, sigma_m=zero + 0.05, source=(zero + 1).astype(np.uint8), distance_m=zero,
        sigma_common_m=zero + 0.02, corner_m=corner, cell_m=0.25, crs=GRID,
    )  # fmt: skip
    places = empty.centres_m().reshape(-1, 2)
    s, n, _ = river.to_flow(places)
    height = FRAME.to_map(np.column_stack([river.flow.to_map(s, n), bed_up_m(s, n)]), GRID)[:, 2]
    height = np.where((s >= 0) & (s <= river.flow.length_m), height, np.nan).reshape(shape)
    return Dtm(
        height_m=height, sigma_m=empty.sigma_m, source=empty.source, distance_m=zero,
        sigma_common_m=empty.sigma_common_m, corner_m=corner, cell_m=0.25, crs=GRID,
    )  # fmt: skip


@pytest.fixture
def sections(model, river):
    return cut_sections(model, river, SETTINGS)


def test_sections_have_area_and_perimeter_of_the_parabola(sections):
    section = sections[len(sections) // 2]
    table = hydraulic_table(section, SETTINGS)
    at = np.interp(section.level_m, table["level_m"], table["area_m2"])
    assert at == pytest.approx(4 / 3 * HALF_WIDTH_M * DEPTH_M, rel=0.01)
    n = np.linspace(-HALF_WIDTH_M, HALF_WIDTH_M, 20_001)
    length = np.hypot(np.diff(n), np.diff(bed_up_m(0, n))).sum()
    assert np.interp(section.level_m, table["level_m"], table["perimeter_m"]) == pytest.approx(
        length, rel=0.01
    )
    radius = (table["area_m2"] / table["perimeter_m"]).to_numpy()
    assert table["radius_m"].to_numpy() == pytest.approx(radius)
    assert (np.diff(table["area_m2"]) > 0).all()
    assert ((table["low_area_m2"] < table["area_m2"]) & (table["area_m2"] < table["high_area_m2"])).all()


def test_the_band_of_a_section_is_that_of_correlated_draws(rng):
    n = np.linspace(-6, 6, 49)
    sigma, common = np.full(49, 0.05), np.full(49, 0.03)
    weights = np.full(49, 0.25)
    rho = np.exp(-np.abs(n[:, None] - n) / 3.0) * 0.04**2
    draws = rng.multivariate_normal(np.zeros(49), rho, 4000) + rng.normal(0, 0.03, (4000, 1))
    told = correlated_sigma(weights, sigma, common, n, 3.0)
    assert np.std(draws @ weights) == pytest.approx(told, rel=0.05)
    assert told > 2 * 0.05 * 0.25 * np.sqrt(49)


def test_the_long_profile_finds_the_thalweg(sections):
    table = long_profile(sections)
    assert np.abs(table["thalweg_n_m"]).max() < 0.4
    assert (table["level_m"] - table["thalweg_m"]).to_numpy() == pytest.approx(DEPTH_M, abs=0.02)
    assert (table["level_m"] - table["mean_bed_m"]).to_numpy() == pytest.approx(2 / 3 * DEPTH_M, abs=0.03)


def profile_of(depth_m: np.ndarray, width_m: np.ndarray, spacing_m: float = 10.0) -> pd.DataFrame:
    s = spacing_m * np.arange(len(depth_m))
    return pd.DataFrame({"s_m": s, "level_m": 2.0, "mean_bed_m": 2.0 - depth_m, "width_m": width_m})


def test_the_exponent_of_depth_over_width_and_its_sigma():
    """150 rivers of 60 sections whose deviations last for some sections: both answers and their sigmas."""
    rng = np.random.default_rng(4)
    squares, ratios, said = [], [], []
    for _ in range(150):
        width = 20 * np.exp(0.15 * np.sin(np.arange(60) / 4.0 + rng.uniform(0, 6)))
        last = np.zeros(60)
        for k in range(60):
            last[k] = 0.6 * last[k - 1] * (k > 0) + 0.05 * rng.standard_normal() * (1.0 if k else 1.25)
        rise = np.maximum(1 - (595.0 - 10.0 * np.arange(60)) / 200.0, 0.0)
        depth = 1.2 * (width / 20) ** -0.7 * np.exp(0.3 * rise + last)
        found = depths_along(profile_of(depth, width), weir_s_m=595.0, backwater_m=200.0)
        squares.append(((found["exponent"] + 0.7) / found["sigma_exponent"]) ** 2)
        ratios.append(((found["ratio_at_weir"] - np.exp(0.3)) / found["sigma_ratio_at_weir"]) ** 2)
        said.append([found["deeper_where_narrower"], found["deeper_before_weir"]])
    assert np.mean(squares) == pytest.approx(1.0, abs=0.35)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.35)
    assert np.mean(said, axis=0) == pytest.approx([1.0, 0.97], abs=0.05)


def test_a_river_whose_depth_knows_nothing_of_its_width():
    """Said in at most a few of a hundred rivers that it is deeper where narrower, and never for one width."""
    rng = np.random.default_rng(6)
    said = []
    for _ in range(100):
        width = 20 * np.exp(0.15 * np.sin(np.arange(60) / 4.0))
        depth = np.exp(0.08 * np.convolve(rng.standard_normal(64), np.ones(5) / 2, "valid"))
        said.append(depths_along(profile_of(depth, width))["deeper_where_narrower"])
    assert np.mean(said) < 0.12
    with pytest.raises(CoverageError, match=r"60 sections with water, width 0\.00 m"):
        depths_along(profile_of(depth, np.full(60, 20.0)))
    with pytest.raises(CoverageError, match="0 of them before the weir"):
        depths_along(profile_of(depth, width), weir_s_m=-5.0)
    with pytest.raises(CoverageError, match="3 sections"):
        depths_along(profile_of(depth[:3], width[:3]))


def test_a_volume_and_its_sigma_are_those_of_formula_and_double_sum(model, river):
    from thalweg.fusion.dtm import cells_inside

    inside = cells_inside(river.outline_m(), model.corner_m, model.cell_m, model.height_m.shape)
    level = float(river.level_m(40.0))
    volume, sigma, area = volume_below(model, level, inside, 5.0)
    assert volume == pytest.approx(4 / 3 * HALF_WIDTH_M * DEPTH_M * river.flow.length_m, rel=0.01)
    assert area == pytest.approx(2 * HALF_WIDTH_M * river.flow.length_m, rel=0.01)
    small = np.zeros_like(inside)
    small[100:118, 60:75] = True
    _, of_small, _ = volume_below(model, level + 10, small, 5.0)
    places = model.centres_m()[small]
    apart = np.linalg.norm(places[:, None] - places, axis=-1)
    own = 0.05**2 - 0.02**2
    double = own * np.exp(-apart / 5.0).sum() + (0.02 * len(places)) ** 2
    assert of_small == pytest.approx(np.sqrt(double) * 0.25**2, rel=1e-6)
    assert sigma > 0.02 * area


def test_ras_import_holds_every_section(sections, river, tmp_path):
    write_hecras(tmp_path / "RASImport.sdf", sections, river)
    text = (tmp_path / "RASImport.sdf").read_text()
    assert re.search(r"NUMBER OF CROSS-SECTIONS: (\d+)", text)[1] == str(len(sections))
    blocks = text.split("CROSS-SECTION:\n")[1:]
    stations = [float(re.search(r"STATION: ([\d.]+)", b)[1]) for b in blocks]
    assert stations == sorted(stations, reverse=True)
    for block, section in zip(blocks, sections, strict=True):
        lines = block.split("SURFACE LINE:\n")[1].split("END:")[0].split("\n")
        points = np.array([[float(v) for v in line.split(",")] for line in lines if line.strip()])
        assert points[::-1, 2] == pytest.approx(section.height_m[np.isfinite(section.height_m)], abs=6e-4)
        bank = [float(v) for v in re.search(r"BANK POSITIONS: (.*)", block)[1].split(",")]
        assert 0 < bank[0] < bank[1] < 1
        # the line begins at the left bank
        assert river.to_flow(points[:1, :2])[1][0] > HALF_WIDTH_M


def test_transects_of_swmm_are_read_back(sections, tmp_path):
    write_swmm(tmp_path / "transects.inp", sections, SETTINGS)
    counts, stations = [], []
    for line in (tmp_path / "transects.inp").read_text().split("\n"):
        words = line.split()
        if words[:1] == ["X1"]:
            counts.append(int(words[2]))
            stations.append([])
            assert float(words[3]) < float(words[4])
        if words[:1] == ["GR"]:
            stations[-1] += [(float(h), float(x)) for h, x in zip(words[1::2], words[2::2], strict=True)]
    assert counts == [len(s) for s in stations]
    for read, section in zip(stations, sections, strict=True):
        x = np.array(read)[:, 1]
        assert x[0] == 0
        assert (np.diff(x) > 0).all()
        assert min(read)[0] == pytest.approx(np.nanmin(section.height_m), abs=6e-4)


def test_csv_holds_sections_and_contours_their_height(model, sections, tmp_path):
    write_csv(tmp_path / "sections.csv", sections)
    table = pd.read_csv(tmp_path / "sections.csv")
    assert table["s_m"].nunique() == len(sections)
    for level, line in contour_lines(model.height_m, model.centres_m(), 0.5)[:20]:
        here = model.at(line)[0]
        assert np.nanmedian(np.abs(here - level)) < 0.02
    assert LEVEL_UP_M < 0


def test_a_survey_is_one_file_for_a_gis(model, arc, banks, tmp_path):
    """Layers lie on the map, and two runs have the same bytes although a clock passes between them."""
    n = 50
    place = np.column_stack([arc.to_map(np.linspace(1, 79, n), np.zeros(n)), np.full(n, LEVEL_UP_M)])
    valid = np.arange(n) % 25 != 0  # two runs
    turn, cov = np.tile([0.0, 0, 0, 1], (n, 1)), np.tile(np.eye(6) * 1e-4, (n, 1, 1))
    Trajectory(
        frame=FRAME,
        t_gps_s=3.0e8 + np.arange(n),
        position_wcs_m=place,
        quaternion_wcs_ics=turn,
        cov_pose_wcs=cov,
        valid=valid,
    ).write(tmp_path / "t.parquet")
    on_map = FRAME.to_map(place, GRID)
    pd.DataFrame(on_map, columns=["east", "north", "height"]).assign(order="1a").to_csv(
        tmp_path / "s.csv", index=False
    )
    model.write(tmp_path / "dtm.tif")
    banks.to_csv(tmp_path / "banks.csv", index=False)
    s = np.linspace(0, arc.length_m, 60)
    FlowLine.through(arc.to_map(s, np.zeros(60))).write(tmp_path / "line.csv")
    pings = pd.DataFrame(place, columns=["east_m", "north_m", "up_m"]).assign(
        depth_m=1.0, t_gps_s=3.0e8, line=0
    )
    pings.loc[0, ["east_m", "north_m", "up_m"]] = np.nan  # no pose, no place
    reasons = ["no pose", "weeds", *[""] * (n - 2)]
    pings.assign(reason=reasons, used=[not why for why in reasons]).to_parquet(tmp_path / "p.parquet")
    names = ("s.csv", "p.parquet", "dtm.tif", "banks.csv", "line.csv")
    for out in ("a.gpkg", "b.gpkg"):
        given = [[tmp_path / name] for name in names]
        map_of_campaign(tmp_path / out, [tmp_path / "t.parquet"], *given, [], MAP, SETTINGS)
        time.sleep(1.1)
    assert (tmp_path / "a.gpkg").read_bytes() == (tmp_path / "b.gpkg").read_bytes()
    found = {of["name"]: of["n"] for of in describe_layers(tmp_path / "a.gpkg")}
    of_river = {"banks", "centre_line", "contours", "sections", "thalweg"}
    assert set(found) == of_river | {"track", "soundings", "soundings_left_out"}
    table, at = read_vectors(f"{tmp_path}/a.gpkg?layer=soundings_left_out").points()
    assert table["reason"].tolist() == [REASONS["weeds"]]
    assert at == pytest.approx(on_map[1:2], abs=1e-6)
    assert (found["track"], found["soundings"], found["banks"]) == (2, n, 2)
    track = read_vectors(f"{tmp_path}/a.gpkg?layer=track")
    assert track.crs == GRID
    for corners, of in track.lines():
        assert cdist(corners, on_map).min(axis=1) == pytest.approx(0.0, abs=1e-6)
        assert of["from_utc"].startswith("2021-03-17T")
    for line, of in read_vectors(f"{tmp_path}/a.gpkg?layer=banks").lines():
        rows = banks[banks["side"] == of["side"]].sort_values("s_m")
        assert line[:, :2] == pytest.approx(
            FRAME.to_map(rows[["east_m", "north_m", "up_m"]], GRID)[:, :2], abs=1e-6
        )
    for line, of in read_vectors(f"{tmp_path}/a.gpkg?layer=contours").lines():
        assert np.nanmedian(np.abs(model.at(line)[0] - of["height_m"])) < 0.02
    # alone, a trajectory is a map too
    map_of_campaign(tmp_path / "c.gpkg", [tmp_path / "t.parquet"], [], [], [], [], [], [], MAP, SETTINGS)
    assert [of["name"] for of in describe_layers(tmp_path / "c.gpkg")] == ["track"]


def test_patches_of_change_are_points(tmp_path):
    place = np.array([[10.0, 20.0, 1.0]])
    table = pd.DataFrame(place, columns=["east_m", "north_m", "up_m"]).assign(what="erosion", volume_m3=-3.5)
    table.to_csv(tmp_path / "patches_a_b.csv", index=False)
    table[:0].to_csv(tmp_path / "patches_b_c.csv", index=False)
    files = [tmp_path / f"patches_{pair}.csv" for pair in ("a_b", "b_c")]
    map_of_campaign(tmp_path / "map.gpkg", [], [], [], [], [], [], files, MAP, SETTINGS)
    found, at = read_vectors(f"{tmp_path}/map.gpkg?layer=changes_a_b").points()
    assert found.to_dict("records") == [{"what": "erosion", "volume_m3": -3.5}]
    assert at == pytest.approx(FRAME.to_map(place, GRID), abs=1e-6)
    # nothing has changed: a file without a row all the same
    map_of_campaign(tmp_path / "none.gpkg", [], [], [], [], [], [], files[1:], MAP, SETTINGS)
    assert [(of["name"], of["n"]) for of in describe_layers(tmp_path / "none.gpkg")] == [("changes_b_c", 0)]


def test_without_sections_their_files_are_not_written(river, tmp_path):
    facts = export_river(tmp_path, None, river, [], Fusion(exports=["hecras", "swmm"]))
    assert facts == {"not_written": dict.fromkeys(["hecras", "swmm"], "no cross section"), "written": []}


def test_a_map_of_a_bed_has_its_soundings_and_banks_by_side(tmp_path):
    grid = Grid(west_m=0.0, north_m=40.0, cell_m=4.0, rows=10, columns=12, crs=GRID)
    banks = pd.DataFrame({"side": ["left", "right"] * 3, "s_m": [20, 20, 0, 0, 10, 10]})
    banks = banks.assign(east_m=banks["s_m"], north_m=[30, 5] * 3)
    line = FlowLine.through([[0.0, 17.0], [20.0, 18.0], [40.0, 17.0]])
    area = shapely.box(0.0, 5.0, 40.0, 30.0).difference(shapely.box(10.0, 10.0, 14.0, 14.0))
    water = SimpleNamespace(line=line, area=area, banks=SimpleNamespace(table=banks))
    soundings = SimpleNamespace(
        places_m=[[3.0, 7.0], [9.0, 11.0]], height_m=[91.0, 92.0], sigma_m=0.1, line=[3, 4]
    )
    height = np.tile(2.0013 + 4.0 * np.arange(12.0), 10)  # as many metres as it is east
    found = SimpleNamespace(bed=SimpleNamespace(grid=grid, up_m=height), water=water)
    map_of_bed(tmp_path / "bed.gpkg", found, soundings)
    contours, centre, shores = (
        geopandas.read_file(tmp_path / "bed.gpkg", layer=of) for of in ("contours", "centre_line", "shores")
    )
    assert len(contours) > 5
    for corners, level in zip(contours.geometry, contours["height_m"], strict=True):
        assert np.array(corners.coords)[:, 0] == pytest.approx(level - 0.0013, abs=1e-6)
    assert np.array(centre.geometry[0].coords) == pytest.approx(line.points_m)
    assert sorted(ring.length for ring in shores.geometry) == [16.0, 130.0]
    points, sides = (geopandas.read_file(tmp_path / "bed.gpkg", layer=of) for of in ("soundings", "banks"))
    assert [p.coords[0] for p in points.geometry] == [(3.0, 7.0, 91.0), (9.0, 11.0, 92.0)]
    assert points[["sigma", "line"]].to_numpy().tolist() == [[0.1, 3], [0.1, 4]]
    assert sides["side"].tolist() == ["left", "right"]
    for line, n in zip(sides.geometry, (30.0, 5.0), strict=True):
        assert list(line.coords) == [(0.0, n), (10.0, n), (20.0, n)]


def test_a_bag_is_read_by_gdal(model, tmp_path):
    write_bag(tmp_path / "model.bag", model)
    with rasterio.open(tmp_path / "model.bag") as file:
        assert file.driver == "BAG"
        read = file.read(masked=True).astype(float).filled(np.nan)
    np.testing.assert_allclose(read[0], model.height_m, rtol=0, atol=1e-4)
    assert np.nanmax(np.abs(read[1] - 0.05)) < 1e-6


def test_contours_of_a_bed_have_an_even_interval_by_its_relief():
    """A plane that rises from west to east; of its height at most so many intervals, 1, 2 or 5 times ten."""
    x = np.arange(21.0)
    centres = np.stack(np.meshgrid(x, x[::-1]), axis=-1)
    for relief, interval in (
        (_CONTOURS * 0.5, 0.5),
        (_CONTOURS * 0.501, 1.0),
        (_CONTOURS * 0.11, 0.2),
        (0.05, 0.01),
    ):
        height = np.tile(relief * x / 20.0, (21, 1)) + 0.0013
        found = _contours(height, centres, None, GRID)
        levels = np.unique(found["height_m"])
        assert np.diff(levels) == pytest.approx(np.full(len(levels) - 1, interval), abs=1e-6)
        assert levels[0] == pytest.approx(interval)
        for line, level in zip(found.geometry, found["height_m"], strict=True):
            assert np.array(line.coords)[:, 0] == pytest.approx((level - 0.0013) * 20.0 / relief, abs=1e-6)
    assert np.unique(_contours(height, centres, 0.03, GRID)["height_m"]) == pytest.approx([0.03])


def test_a_track_is_a_line_for_each_run_of_poses():
    n = 9
    valid = np.array([True, True, True, False, True, False, True, True, True])
    path = Trajectory(
        frame=FRAME,
        t_gps_s=1.3e9 + np.arange(n),
        position_wcs_m=np.column_stack([10.0 * np.arange(n) ** 1.5, np.zeros(n), np.zeros(n)]),
        quaternion_wcs_ics=np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)),
        cov_pose_wcs=np.zeros((n, 6, 6)),
        valid=valid,
    )
    found = _track(path, GRID)
    # the single pose between two gaps is no line
    assert len(found) == 2
    for row, ends in zip(found.itertuples(), ((0, 2), (6, 8)), strict=True):
        corners = np.array(row.geometry.coords)
        assert corners[[0, -1]] == pytest.approx(
            FRAME.to_map(path.position_wcs_m[list(ends)], GRID), abs=1e-6
        )
        assert (row.from_utc, row.to_utc) == tuple(utc_text_from_gps(float(path.t_gps_s[k])) for k in ends)
