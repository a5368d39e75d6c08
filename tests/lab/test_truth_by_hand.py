"""Comparisons with the truth on a few values whose answers can be said beforehand."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from pyproj import CRS

from tests.lab.conftest import FRAME
from tests.lab.sheets import scene_of, sheet
from thalweg.accuracy import chi_square_band, independent_squares
from thalweg.bathymetry import Banks, FlowLine, WaterLevel
from thalweg.bathymetry.bed import BANDS
from thalweg.clocks import ClockModel
from thalweg.core import Camera, CoverageError, Grid, LazWriter, Rigid, rotation_z, write_raster, write_table
from thalweg.core.geometry import TriangleMesh, write_mesh
from thalweg.fusion import SOURCE_WORDS, Dtm, Source
from thalweg.images.model import ImagePoses
from thalweg.lidar import GAMMA
from thalweg.lightsheet.scanning.world import BED_POINTS
from thalweg.panorama import sphere_rays
from thalweg_lab.river import Material
from thalweg_lab.truth import rig as rig_truth
from thalweg_lab.truth.calibration import compare_clock, compare_interior
from thalweg_lab.truth.points import (
    PointErrors,
    TrueReturns,
    error_tables,
    filter_scores,
    judge_bed_strip,
    sample_of_known_points,
)
from thalweg_lab.truth.riverbed import compare_riverbed, judge_dtm

MAP = CRS.from_epsg(25833)

# ---------------------------------------------------------------- lens and clock


def test_errors_of_a_lens_and_of_a_clock_have_their_signs_and_units():
    camera = Camera(
        model="fisheye",
        size_px=(800, 600),
        parameters=np.array([702.0, 700.0, 401.0, 300.0, 0.011, 0.0, 0.0, 0.0]),
        cov=np.diag([4.0, 1.0, 4.0, 1.0, 1e-6, 0.0, 0.0, 0.0]),
    )
    truth = dict(zip(camera.parameter_names, [700.0, 700.0, 400.0, 300.5, 0.010, 0, 0, 0], strict=True))
    table = compare_interior(camera, truth)
    assert set(table["block"]) == {"camera interior"}
    assert table["quantity"].tolist() == list(camera.parameter_names)
    assert table["estimated_minus_true"].tolist() == pytest.approx([2.0, 0.0, 1.0, -0.5, 1e-3, 0, 0, 0])
    assert table["sigma"].tolist() == pytest.approx([2.0, 1.0, 2.0, 1.0, 1e-3, 0, 0, 0])
    assert table["unit"].tolist() == ["px"] * 4 + ["1"] * 4
    expected = [1.0, 0.0, 0.5, -0.5, 1.0, np.nan, np.nan, np.nan]
    assert table["normalised"].tolist() == pytest.approx(expected, nan_ok=True)

    # 2 s ahead at 1,000 s, gaining 50 ppm; 400 s later, at the stamp of 1,402 s, it is 2.02 s ahead
    clock = ClockModel(offset_s=-2.01, drift=-40e-6, reference_s=1402.0, cov=np.diag([0.02**2, 5e-6**2]))
    found = compare_clock(clock, start_gps_s=1000.0, ahead_s=2.0, drift_ppm=50.0)
    assert found["block"].tolist() == ["camera clock"] * 2
    assert found["quantity"].tolist() == ["offset_s", "drift_ppm"]
    assert found["unit"].tolist() == ["s", "ppm"]
    assert found["estimated_minus_true"].tolist() == pytest.approx([0.01, 10.0])
    assert found["sigma"].tolist() == pytest.approx([0.02, 5.0])
    assert found["normalised"].tolist() == pytest.approx([0.5, 2.0])


# ---------------------------------------------------------------- points


def nmad(e):
    return 1.4826 * np.median(np.abs(e - np.median(e)))


def test_every_row_of_the_errors_of_points():
    """Six points: one beside the ground, one gross, four on bare ground at two ranges."""
    error = np.array([0.01, -0.02, 0.03, 0.0, 0.5, 9.0])
    sigma = np.array([0.01, 0.02, 0.01, 0.02, 0.05, 1.0])
    errors = PointErrors(
        t_gps_s=np.array([0.0, 1.0, 50.0, 51.0, 52.0, 53.0]),
        range_m=np.array([9.6, 10.5, 20.0, 20.4, 20.0, 20.0]),
        error_m=error,
        sigma_m=sigma,
        on_ground=np.array([True] * 5 + [False]),
    )
    assert errors.gross.tolist() == [False] * 4 + [True, True]
    statistics, by_range = error_tables(errors, correlation_s=4.0)
    value = statistics.set_index(["points", "quantity"])
    sets = {"all": slice(0, 6), "bare ground with gross errors": slice(0, 5), "bare ground": slice(0, 4)}
    for points, of in sets.items():
        e, z, of_set = error[of], error[of] / sigma[of], value.loc[points]
        expected = {
            "bias": e.mean(),
            "std": e.std(),
            "rmse": np.sqrt(np.mean(e**2)),
            "median": np.median(e),
            "nmad": nmad(e),
            "p95": np.percentile(np.abs(e), 95),
            "predicted_rmse": np.sqrt(np.mean(sigma[of] ** 2)),
        }
        plain = {"n": len(e), "normalised_squared_error": np.mean(z**2), "normalised_nmad": nmad(z)}
        assert of_set["value"][[*expected]].to_dict() == pytest.approx(expected, rel=1e-4), points
        assert of_set["value"][[*plain]].to_dict() == pytest.approx(plain, rel=1e-4), points
        assert set(of_set["unit"][[*expected]]) == {"m"}
        assert set(of_set["unit"][[*plain]]) == {"1"}
    n = independent_squares(errors.t_gps_s[:4], np.ones(4), 4.0)
    low, high = chi_square_band(n)
    bare = value.loc["bare ground"]["value"]
    assert bare["independent_values"] == pytest.approx(n)
    assert (bare["consistent_low95"], bare["consistent_high95"]) == pytest.approx((low, high))
    assert bare["share_of_points"] == pytest.approx(4 / 6)
    assert value.loc[("bare ground with gross errors", "gross_errors"), "value"] == 1
    assert by_range["range_m"].tolist() == [10, 20]
    assert by_range["n"].tolist() == [2, 2]
    assert by_range["rmse_observed_m"].tolist() == pytest.approx([np.sqrt(2.5e-4), np.sqrt(4.5e-4)])
    assert by_range["rmse_predicted_m"].tolist() == pytest.approx([np.sqrt(2.5e-4)] * 2)
    band = np.sqrt(chi_square_band(independent_squares(errors.t_gps_s[:4], sigma[:4] ** 2, 4.0)))
    assert by_range[["ratio_low95", "ratio_high95"]].to_numpy() == pytest.approx(np.tile(band, (2, 1)))
    with pytest.raises(CoverageError, match="none of 6 points"):
        error_tables(replace(errors, on_ground=np.zeros(6, bool)), correlation_s=4.0)


RETURNS = TrueReturns(
    t_gps_s=np.array([10.0, 10.0, 10.0 + 2.3e-6, 11.0, 12.0]),
    return_number=np.array([1, 2, 1, 1, 1]),
    kind=np.array([0, 1, 0, 1, 0]),
    material=np.zeros(5, int),
    point_wcs_m=np.zeros((5, 3)),
    kinds={0: "surface", 1: "mixed", 2: "ghost"},
)


def test_points_are_found_by_their_shot_and_return():
    t = np.array([10.0 + 1e-6, 10.0 - 1e-6, 10.0 + 2.4e-6, 11.0, 12.0 + 2e-6, 9.0, 13.0])
    assert RETURNS.index(t, np.array([2, 1, 1, 1, 1, 1, 1])).tolist() == [1, 0, 2, 3, -1, -1, -1]
    assert RETURNS.index(np.array([11.0]), np.array([2])).tolist() == [-1]


def test_what_filters_kept_of_each_kind(tmp_path):
    path = tmp_path / "c.laz"
    with LazWriter(path, FRAME) as writer:
        writer.append(
            np.arange(12.0).reshape(4, 3),
            t_gps_s=[10.0, 10.0, 12.0, 99.0],
            return_number=[1, 2, 1, 1],
            number_of_returns=[2, 2, 1, 1],
        )
    table = filter_scores(path, RETURNS, np.array([True, True, True, False, True]))
    assert table["kind"].tolist() == ["surface", "mixed", "ghost"]
    assert table["n"].tolist() == [3, 1, 0]
    assert table["kept"].tolist() == [2, 1, 0]
    assert table["share_kept"].tolist() == pytest.approx([2 / 3, 1.0, np.nan], nan_ok=True)
    known = sample_of_known_points(path, RETURNS, 2)
    assert known["true_row"].tolist() == [0, 4]  # every other one of three
    assert known["xyz_m"][:, 0].tolist() == [0.0, 6.0]
    assert sample_of_known_points(path, RETURNS, 3)["true_row"].tolist() == [0, 1, 4]


def test_a_strip_of_the_bed_is_judged_from_files(tmp_path):
    corners = np.array([[-9.0, -9.0, -2.0], [9.0, -9.0, -2.0], [9.0, 9.0, -2.0], [-9.0, 9.0, -2.0]])
    mesh = TriangleMesh(vertices_m=corners, faces=np.array([[0, 1, 2], [0, 2, 3]]), sigma_m=np.zeros(4))
    write_mesh(tmp_path / "bed.ply", mesh, FRAME, {})
    points = pd.DataFrame({name: [0, 0, 0] for name in BED_POINTS.names})
    points = points.assign(file=["a", "a", "b"], north_m=1.0, up_m=[-1.99, -1.97, -2.01], cov_uu_m2=4e-4)
    write_table(tmp_path / "points.parquet", points, BED_POINTS)
    judge_bed_strip(
        points=tmp_path / "points.parquet",
        truth=tmp_path,
        statistics=tmp_path / "s.csv",
        lines=tmp_path / "l.csv",
    )
    assert pd.read_csv(tmp_path / "s.csv")["mean_m"].tolist() == pytest.approx([0.01], abs=1e-6)
    lines = pd.read_csv(tmp_path / "l.csv")
    assert lines["file"].tolist() == ["a", "b"]
    assert lines["n"].tolist() == [2, 1]
    assert lines["mean_m"].tolist() == pytest.approx([0.02, -0.01], abs=1e-6)


# ---------------------------------------------------------------- bed, banks, terrain model


@pytest.fixture
def valley(tmp_path):
    """Bed at -2 m between y = -5 and 5; beyond it soil that rises from -0.5 m by 1 in 10; a stone."""
    strips = [(-10, 5, 0, -0.5, Material.SOIL), (10, 5, 0, 0.5, Material.SOIL)]
    strips += [(0, 5, -2, 0, Material.BED), (0, 1, -1.5, 0, Material.STONE)]
    parts = [(sheet([0, y, z], [30, 0, 0], [0, half, rise]), what) for y, half, z, rise, what in strips]
    scene_of(*parts, level_m=0.0).write(tmp_path / "scene.npz")
    return tmp_path / "scene.npz"


def places_at(centres_m):
    """Places (n, 2) in the frame of points on the map."""
    return FRAME.from_map(np.column_stack([centres_m, np.full(len(centres_m), FRAME.h_ell_m)]), MAP)[:, :2]


def map_height_m(places, up_m):
    return FRAME.to_map(np.column_stack([places, np.broadcast_to(up_m, len(places))]), MAP)[:, 2]


def figures(e, s, outside):
    """What `of` shows of errors and their sigmas."""
    return [e.mean(), np.sqrt(np.mean(e**2)), np.sqrt(np.mean(s**2)), np.mean((e / s) ** 2), outside]


def of(table, name):
    rows = table[table["measure"].str.startswith(f"{name}: ")]
    assert [row.partition(": ")[2] for row in rows["measure"]] == [
        "mean error, m",
        "root mean square error, m",
        "root mean predicted variance, m",
        "mean of squared error over variance",
        "share outside 95 %",
    ]
    return rows["value"].tolist(), set(rows["n"])


def test_soundings_bed_and_banks_beside_the_true_ground(valley, tmp_path):
    soundings = pd.DataFrame(
        {
            "east_m": [0.0, 3.0, 9.0, 0.0, 200.0],
            "north_m": [0.0, 3.0, -3.0, 2.0, 0.0],
            "up_m": [-1.9, -2.1, -1.5, -9.0, -2.0],
            "sigma_white_m": 0.03,
            "sigma_slow_m": 0.04,
            "sigma_common_m": 0.12,
            "used": [True, True, True, False, True],
        }
    )
    # four cells of the bed, 10, -10, 20 and 30 cm too high, at 0.2, 0.7, 3.9 and 4.1 m to data
    corner = FRAME.to_map(np.array([[0.0, 0.0, 0.0]]), MAP)[0]
    west_m, north_m = np.floor(corner[:2]).tolist()
    grid = Grid(west_m=west_m, north_m=north_m, cell_m=1.0, rows=2, columns=2, crs=MAP)
    true = map_height_m(places_at(grid.centres_m()), -2.0)
    values = {
        "height_m": true + np.array([0.1, -0.1, 0.2, 0.3]),
        "sigma_m": np.array([0.03, 0.03, 0.06, 0.06]),
        "sigma_common_m": np.array([0.04, 0.04, 0.08, 0.08]),
        "distance_m": np.array([0.2, 0.7, 3.9, 4.1]),
    }
    write_raster(tmp_path / "bed.tif", grid, {name: values[name].reshape(2, 2) for name in BANDS})
    line = FlowLine.through(np.column_stack([np.linspace(-25.0, 25.0, 26), np.zeros(26)]))
    # the water at 0.1 m meets the ground 11 m north and 11 m south of the line
    banks = pd.DataFrame(
        {
            "side": ["left", "left", "right", "left", "right"],
            "s_m": [20.0, 25.0, 20.0, 30.0, 30.0],
            "n_m": [11.3, 10.9, -10.8, 11.5, -16.0],
            "sigma_across_m": 0.2,
            "seen": [True, True, True, False, True],
        }
    )
    level = WaterLevel(level_m=0.1, cov=np.zeros((3, 3)))
    table = compare_riverbed(
        soundings, tmp_path / "bed.tif", Banks(table=banks, line=line), level, valley, FRAME
    )
    found, n = of(table, "soundings")
    # 3, 4 and 12 cm
    expected = figures(np.array([0.1, -0.1, 0.5]), np.full(3, 0.13), 1 / 3)
    assert found == pytest.approx(expected, abs=1e-3)
    assert n == {3}
    found, n = of(table, "bed")
    expected = figures(np.array([0.1, -0.1, 0.2, 0.3]), np.array([0.05, 0.05, 0.1, 0.1]), 1.0)
    assert found == pytest.approx(expected, rel=0.01)
    assert n == {4}
    classes = {"0 to 0.5 m to data": 0.1, "0.5 to 1 m to data": -0.1, "2 to 4 m to data": 0.2}
    for words, mean in (classes | {"4 m to data and more": 0.3}).items():
        assert of(table, f"bed, {words}")[0][0] == pytest.approx(mean, abs=2e-3)
    assert not table["measure"].str.startswith("bed, 1 to 2 m").any()
    found, n = of(table, "banks")
    # landward is positive on both sides; the last has no shore within 3 m
    assert found[0] == pytest.approx((0.3 - 0.1 - 0.2) / 3, abs=0.011)
    assert found[1] == pytest.approx(np.sqrt((0.09 + 0.01 + 0.04) / 3), abs=0.011)
    assert n == {3}


def test_a_terrain_model_is_judged_by_its_sources(valley, tmp_path):
    """Cells of 1 m along the valley's bed and its northern bank: 10 cm too high, the far bank 30 cm."""
    corner = np.floor(FRAME.to_map(np.array([[0.0, 12.0, 0.0]]), MAP)[0, :2]) + np.array([0.0, 1.0])
    centres = np.stack(
        np.meshgrid(corner[0] + np.arange(4) + 0.5, corner[1] - np.arange(16) - 0.5), -1
    ).reshape(-1, 2)
    places = places_at(centres)
    y = places[:, 1]
    bed = y < 5.0
    ground = np.where(bed, -2.0, -0.5 + 0.1 * (y - 5.0))
    true = map_height_m(places, ground)
    row = np.repeat(np.arange(16), 4)
    first = row[bed].min()
    far = row < first - 5
    source = np.where(bed, int(Source.BED), int(Source.LIDAR)).astype(np.uint8)
    model = Dtm(
        height_m=(true + np.where(far, 0.3, 0.1) - 42.0).reshape(16, 4),
        sigma_m=np.where(far, 0.1, 0.05).reshape(16, 4),
        source=source.reshape(16, 4),
        distance_m=np.zeros((16, 4)),
        sigma_common_m=np.zeros((16, 4)),
        corner_m=corner,
        cell_m=1.0,
        crs=MAP,
        vertical="a height system",
        separation=(42.0, 0.0, 0.0),
    )
    model.write(tmp_path / "dtm.tif")
    origin = {"lat_deg": FRAME.lat_deg, "lon_deg": FRAME.lon_deg, "h_ell_m": FRAME.h_ell_m}
    judge_dtm(dtm=tmp_path / "dtm.tif", scene=valley, table=tmp_path / "t.csv", campaign={"origin": origin})
    table = pd.read_csv(tmp_path / "t.csv")
    lidar = SOURCE_WORDS[Source.LIDAR]
    for name, expected, count in (
        (SOURCE_WORDS[Source.BED], [0.1, 0.1, 0.05, 4.0, 1.0], bed.sum()),
        (f"{lidar}, within 5 m of the bed", [0.1, 0.1, 0.05, 4.0, 1.0], 20),
        (f"{lidar}, farther away", [0.3, 0.3, 0.1, 9.0, 1.0], far.sum()),
    ):
        found, n = of(table, name)
        assert found == pytest.approx(expected, abs=5e-3), name
        assert n == {count}
    # the model's step at the seam is the true one
    assert of(table, "steps at seams")[0][0] == pytest.approx(0.0, abs=2e-3)


# ---------------------------------------------------------------- rig


def test_poses_of_a_rig_are_judged_by_their_images():
    cov = np.diag([0.01**2] * 3 + [1e-3**2] * 3)

    def poses(names, centres, turns, oriented):
        n = len(names)
        none = np.zeros(n)
        return ImagePoses(
            frame=FRAME,
            images=tuple(names),
            t_gps_s=np.arange(n, dtype=float),
            sigma_t_s=none,
            oriented=np.array(oriented),
            reasons=tuple("" if each else "no pose" for each in oriented),
            centre_wcs_m=np.array(centres),
            R_wcs_ccs=np.array([rotation_z(turn) for turn in turns]),
            cov_pose_wcs=np.tile(cov, (n, 1, 1)),
            cov_next=np.zeros((n, 6, 6)),
            n_marks=none,
            rms_px=none,
        )

    true = poses(["b", "a", "c"], [[1.0, 0, 0], [0.0, 0, 0], [2.0, 0, 0]], [0.1, 0.2, 0.3], [True] * 3)
    off = [[0.03, 0.04, 0.0], [9.0, 9.0, 9.0], [2.0, 0.0, 0.01]]
    found = poses(["a", "b", "c"], off, [0.2, 0.1, 0.302], [True, False, True])
    rows = rig_truth._poses(found, true)
    assert [row[0] for row in rows] == [
        "poses: mean of squared error over variance",
        "poses: largest error of the place, m",
        "poses: largest rotation, deg",
    ]
    # 5 cm of 1 cm, and 1 cm of 1 cm with 2 mrad of 1 mrad
    assert [row[1] for row in rows] == pytest.approx([(25 / 6 + 5 / 6) / 2, 0.05, np.rad2deg(2e-3)])
    assert [row[2] for row in rows] == [12, 2, 2]


def test_colours_of_points_against_what_is_seen_of_them(tmp_path):
    """A sphere of 10 m; the cloud is half as bright as the truth, one colour of its points off by a tenth."""
    width = 64
    rays = sphere_rays(width)
    rng = np.random.default_rng(1)
    light = np.ones((width // 2, width, 3)) * [0.4, 0.5, 0.6]
    sunlit = np.zeros((width // 2, width), np.uint8)
    sunlit[:, :16] = 1
    pose = Rigid(R=rotation_z(0.3), shift_m=np.array([5.0, -2.0, 1.0]))
    np.savez(
        tmp_path / "truth.npz",
        light=light.astype(np.float32),
        range_m=np.full((width // 2, width), 10.0),
        T_wcs_pano=pose.matrix,
        sunlit=sunlit,
    )
    directions = rays[4:28].reshape(-1, 3)
    directions = np.repeat(directions, 4, axis=0) + 1e-4 * rng.standard_normal((4 * 24 * width, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    n = len(directions)
    distance = np.full(n, 10.0)
    distance[::8] = 10.15
    distance[4::32] = 10.25  # behind what is seen
    distance[12::32] = 9.75  # in front of it
    given = 0.5 * np.tile([0.4, 0.5, 0.6], (n, 1))
    shade = np.tile(np.repeat(np.arange(width) >= 16, 4), 24)
    given[shade & (np.arange(n) % 4 != 3)] *= 1.1
    views = np.where(np.arange(n) % 16 == 1, 0, 2)
    with LazWriter(tmp_path / "c.laz", FRAME, extra_dimensions={"n_views": ("uint8", "1")}) as writer:
        writer.append(
            directions * distance[:, None] @ pose.R.T + pose.shift_m,
            rgb=np.round(65535 * given ** (1 / GAMMA)).astype(np.uint16),
            extra={"n_views": views.astype(np.uint8)},
        )
    rows = {
        row[0].removeprefix("colours: "): row[1:]
        for row in rig_truth.judge_colours(tmp_path / "c.laz", tmp_path / "truth.npz")
    }
    share, visible = rows["share of visible points that have one"]
    assert visible == n - len(distance[4::32]) - len(distance[12::32])
    assert share == pytest.approx(1 - np.sum(np.arange(n) % 16 == 1) / visible)
    # in three of four columns 2.5 of 3.5 points with a colour are brighter by a tenth: 54 % of all
    tones = [
        255 * (f * np.array([0.4, 0.5, 0.6])) ** (1 / GAMMA) for f in (0.5, 0.5 * (1 + 0.25 / 3.5), 0.55)
    ]
    in_sun, in_patch = tones[2] - tones[0], tones[2] - tones[1]
    error, n_sunny = rows["median error of a point free of shade, of 255"]
    assert error == pytest.approx(in_sun[1], abs=0.01)
    assert n_sunny == 24 * 52  # the last column has a neighbour in the shade
    assert rows["median error of a point, of 255"] == (pytest.approx(0.0, abs=0.01), round(visible * share))
    error, patches = rows["median error of a patch, of 255"]
    assert error == pytest.approx((in_patch[1] + in_patch[2]) / 2, abs=0.01)
    assert patches == 4 * 8
