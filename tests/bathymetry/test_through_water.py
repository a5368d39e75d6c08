"""Refraction at the water's surface: against Fermat's principle, and on a drone's real points."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize_scalar

from thalweg.bathymetry import correct_refraction, read_columns
from thalweg.cli import main
from thalweg.core import GeometryError, InputError

CAMERAS = np.array([[-6.0, 0.0, 20.0], [6.0, 0.0, 20.0]])


def apparent_height(depth_m: float, camera: np.ndarray, index: float) -> float:
    """Where the straight ray of a camera meets the vertical through the place of the bed (x = 0).

    The path of least time crosses the surface (height 0) at x (Fermat), found by search.
    """
    away = abs(camera[0])
    time = minimize_scalar(
        lambda x: np.hypot(away - x, camera[2]) + index * np.hypot(x, depth_m),
        bounds=(0.0, away),
        method="bounded",
        options={"xatol": 1e-12},
    )
    return float(-camera[2] * time.x / (away - time.x))


@pytest.mark.parametrize("depth_m", [0.3, 1.2, 4.0])
def test_two_cameras_give_the_depth_that_least_time_gives(depth_m):
    seen = apparent_height(depth_m, CAMERAS[1], 1.34)
    assert -seen < depth_m / 1.33
    row = correct_refraction([[0.0, 0.0, seen]], 0.0, CAMERAS, index=1.34).iloc[0]
    assert row.height_m == pytest.approx(-depth_m, abs=2e-5 * depth_m)
    assert (row.n_cameras, row.state) == (2, "corrected")


def test_sigmas_are_those_of_many_draws():
    """Errors of point, level and index are drawn; one camera, so that the factor has no scatter."""
    rng = np.random.default_rng(5)
    sigma = {"sigma_point_m": 0.03, "sigma_water_m": 0.05, "sigma_index": 0.02}
    heights = []
    for index in rng.normal(1.333, sigma["sigma_index"], 1000):
        points = np.column_stack([np.zeros((4, 2)), rng.normal(-1.5, sigma["sigma_point_m"], 4)])
        level = rng.normal(0.0, sigma["sigma_water_m"], 4)
        heights += correct_refraction(points, level, CAMERAS[:1], index=index).height_m.tolist()
    stated = correct_refraction([[0.0, 0.0, -1.5]], 0.0, CAMERAS[:1], index=1.333, **sigma)
    assert np.std(heights) / stated.sigma_height_m.iloc[0] == pytest.approx(1.0, abs=0.05)


def test_cameras_that_disagree_enlarge_the_sigma():
    low = np.array([[0.0, 0.0, 20.0], [12.0, 0.0, 20.0]])
    one, two = (correct_refraction([[0.0, 0.0, -2.0]], 0.0, c).iloc[0] for c in (low[:1], low))
    assert two.sigma_height_m > 20 * one.sigma_height_m > 0


def test_dry_points_stay_and_lost_ones_say_why():
    points = [[0.0, 0.0, 0.4], [0.0, 0.0, -0.4], [0.0, 0.0, -0.4], [90.0, 0.0, -0.4]]
    table = correct_refraction(points, [0.0, 0.0, np.nan, 0.0], CAMERAS)
    assert table.state.tolist() == [
        "above the water",
        "corrected",
        "no water level",
        "no camera looks steeply enough",
    ]
    assert table.height_m.iloc[0] == 0.4
    assert table.height_m.isna().tolist() == [False, False, True, True]
    assert table.sigma_height_m.isna().tolist() == [False, False, True, True]


def test_bad_input_is_named():
    with pytest.raises(GeometryError, match="2 of 2 cameras stand at or below the water"):
        correct_refraction([[0.0, 0.0, 40.0]], 50.0, CAMERAS)
    with pytest.raises(InputError, match=r"index 0\.75"):
        correct_refraction([[0.0, 0.0, -1.0]], 0.0, CAMERAS, index=0.75)
    with pytest.raises(InputError, match="no cameras"):
        correct_refraction([[0.0, 0.0, -1.0]], 0.0, np.zeros((0, 3)))


def real_points(folder: Path) -> pd.DataFrame:
    """The 64,920 points of a CloudCompare file: places as float32 about a corner, and two scalar fields."""
    data, n = (folder / "BathySfM_SampleData.bin").read_bytes(), 64_920
    xyz = np.frombuffer(data, "<f4", 3 * n, 2577).reshape(n, 3).astype(np.float64)
    bed, water = (np.frombuffer(data, "<f4", n, start) for start in (976_765, 1_236_925))
    return pd.DataFrame(
        {"x": xyz[:, 0] + 338_000, "y": xyz[:, 1] + 272_000, "sfm_z": bed, "w_surf": water}, dtype=np.float64
    )


def test_points_of_a_drone_become_deeper_by_the_published_factor(data_dir, tmp_path, capsys, record_property):
    """Every 20th point: the mean factor over all cameras within 35 degrees is 1.389 (n 3246)."""
    folder = data_dir / "pybathysfm" / "sample_data"
    points = real_points(folder)
    assert points.x.agg(["min", "max"]).round(3).tolist() == [338417.839, 338438.739]
    assert (points.w_surf - points.sfm_z).mean() == pytest.approx(0.2305, abs=5e-5)
    points[::20].to_csv(tmp_path / "points.csv", index=False)
    words = ["refract", str(tmp_path / "points.csv"), "--water", "w_surf", "--index", "1.34"]
    cameras = ["--cameras", str(folder / "BathySfM_SampleCameras.csv"), "-o", str(tmp_path / "bed.csv")]
    assert main([*words, *cameras]) == 0
    assert "3,246 corrected" in capsys.readouterr().out
    found = pd.read_csv(tmp_path / "bed.csv")
    record_property("factor", found.factor.mean())
    assert found.factor.mean() == pytest.approx(1.389, abs=0.002)
    assert found.depth_m.mean() == pytest.approx(1.389 * 0.2305, abs=0.002)


def test_tables_are_read_by_their_header(tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("Label,East,North,Z,level\na,1,2,3,4\nb,5,6,7,\n")
    places, water = read_columns(path, water="level")
    assert places.tolist() == [[1, 2, 3], [5, 6, 7]]
    assert water[0] == 4
    assert np.isnan(water[1])
    with pytest.raises(InputError, match="no column depth"):
        read_columns(path, height="depth")
    path.write_text("x,y,z\n1,2,\n")
    with pytest.raises(InputError, match=r"csv:2: 1 of 1 rows without coordinates"):
        read_columns(path)
    path.write_text("x,y,z\n1,2,deep\n")
    with pytest.raises(InputError, match=r"csv:2: 'deep' in column z.*expected numbers"):
        read_columns(path)


def test_two_cameras_by_hand():
    """30 and 0 degrees from the vertical: sqrt((n^2 - 1/4) / (3/4)) and n, mean and half difference."""
    n, depth = 1.333, 2.0
    cameras = [[22.0 * np.tan(np.deg2rad(30.0)), 0.0, 20.0], [0.0, 0.0, 20.0], [22.0, 0.0, 20.0]]
    sigmas = {"sigma_index": 0.01, "sigma_point_m": 0.05, "sigma_water_m": 0.03}
    row = correct_refraction([[0.0, 0.0, -depth]], 0.0, cameras, index=n, **sigmas).iloc[0]
    slant = np.sqrt((n**2 - 0.25) / 0.75)
    factor = (slant + n) / 2
    assert row.n_cameras == 2  # the third looks at 45 degrees
    assert (row.factor, row.depth_m) == pytest.approx((factor, depth * factor))
    assert (row.height_m, row.apparent_depth_m) == pytest.approx((-depth * factor, depth))
    by_index = (n / (0.75 * slant) + 1.0) / 2
    variance = (factor * 0.05) ** 2 + ((factor - 1) * 0.03) ** 2
    variance += depth**2 * ((by_index * 0.01) ** 2 + ((slant - n) / 2) ** 2)
    assert row.sigma_height_m == pytest.approx(np.sqrt(variance))
    dry = correct_refraction([[0.0, 0.0, 0.5]], 0.0, cameras, **sigmas).iloc[0]
    assert (dry.height_m, dry.sigma_height_m) == pytest.approx((0.5, 0.05))
    assert np.isnan([dry.depth_m, dry.apparent_depth_m]).all()
