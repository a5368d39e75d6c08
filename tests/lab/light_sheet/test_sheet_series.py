"""The recordings of a basin: what the design knows of the true sensor, and what the files hold."""

import json

import cv2
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from thalweg.calibration.field import read_points
from thalweg.core import LocalFrame, read_table
from thalweg.lightsheet.calibration import read_grid
from thalweg.lightsheet.optics import LASER, LENS, PARAMETERS, intersect, paper_4, read_sensor
from thalweg.lightsheet.poses.panels import read_panels
from thalweg_lab.settings import TwinConfig
from thalweg_lab.tank import WINDOW_MARKERS, Basin, record_camera_station, record_series
from thalweg_lab.tank.record import LINE_TRUTH

FRAME = LocalFrame(lat_deg=51.0, lon_deg=13.7, h_ell_m=160.0)
TINY = TwinConfig.of_size("basin_tiny")


def station(folder, seed=7):
    paths = (folder / "sensor.yaml", folder / "camera_marks.csv", folder / "mark_points.csv")
    record_camera_station(TINY, seed, out_sensor=paths[0], out_marks=paths[1], out_points=paths[2])
    return paths


# ---------------------------------------------------------------- design and truth


def test_the_design_is_off_by_what_its_sigmas_say():
    """Lens, glass and media: errors over seeds against the design's own sigmas."""
    known = [PARAMETERS.index(name) for name in ("fx", "cx", "cy", "glass_mm", "n_glass", "n_water")]
    z = []
    for seed in range(60):
        basin = Basin.of(TINY, seed)
        sigma = np.sqrt(np.diag(basin.design.cov))
        z.append(((basin.design.vector() - basin.true.vector()) / np.where(sigma > 0, sigma, 1.0))[known])
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    # 60 draws each: 9 % of a standard deviation, band of four of them
    assert ((rms > 0.64) & (rms < 1.36)).all(), dict(zip(known, rms, strict=True))
    # independent of each other: 13 % for a correlation, 15 of them
    assert np.abs(np.corrcoef(np.transpose(z)) - np.eye(len(known))).max() < 0.55


def test_the_laser_is_approximate_and_all_pixels_are_square():
    basin = Basin.of(TINY, 7)
    assert_array_equal(basin.design.vector()[LASER], paper_4().vector()[LASER])
    off = (basin.true.vector() - basin.design.vector())[LASER]
    assert (np.abs(off[:3]) < 4 * 3.0).all()
    assert (np.abs(off[3:]) < np.deg2rad(4 * 0.8)).all()
    assert (off != 0).all()
    fx, fy = basin.design.vector()[LENS][:2] - basin.true.vector()[LENS][:2]
    assert fx == pytest.approx(fy)
    sigma = np.sqrt(np.diag(basin.design.cov))
    # 0.004 mm of pixels of 5.5 um at 2048 pixels a side, at a quarter of them
    assert sigma[LENS.start] == pytest.approx(0.004 / 0.0055 / 4)


# ---------------------------------------------------------------- files


def test_the_camera_station_is_in_metres_in_a_frame_of_its_own(tmp_path):
    sensor, marks, points = station(tmp_path)
    basin = Basin.of(TINY, 7)
    read = read_sensor(sensor)
    assert_allclose(read.vector(), basin.design.vector(), rtol=1e-12, atol=1e-12)
    assert_allclose(read.cov, basin.design.cov, rtol=1e-6, atol=1e-15)
    found = read_points(points)
    window = np.array([marker in WINDOW_MARKERS for marker, _ in found.points])
    assert window.sum() == 16
    # a square of 10 mm a side
    side = np.linalg.norm(np.diff(found.points_pcs[window][:4], axis=0), axis=1)
    assert side == pytest.approx(0.01, abs=2e-4)
    # marks of the window are flat, 0.03 mm each; those of the object lie on two levels 60 and 150 mm below
    p = found.points_pcs[window]
    normal = np.linalg.svd(p - p.mean(axis=0))[2][2]
    assert np.abs((p - p.mean(axis=0)) @ normal).max() < 4 * 0.03e-3
    depth = np.sort(np.abs((found.points_pcs[~window] - p.mean(axis=0)) @ normal))
    assert depth[0] == pytest.approx(0.060, abs=2e-4)
    assert depth[-1] == pytest.approx(0.150, abs=2e-4)
    table = pd.read_csv(marks)
    assert set(table["marker"]) <= {marker for marker, _ in found.points}
    assert not set(table["marker"]) & set(WINDOW_MARKERS)
    assert len(table) > 30
    assert table[["x_px", "y_px"]].to_numpy().min() > -1
    assert table[["x_px", "y_px"]].to_numpy().max() < 513


def test_the_grid_and_its_depths(tmp_path):
    record_series(TINY, 7, "calibration", FRAME, tmp_path, tmp_path / "truth")
    (image,) = (tmp_path / "images").iterdir()
    assert cv2.imread(str(image), cv2.IMREAD_UNCHANGED).shape == (512, 512)
    grid = read_grid(tmp_path / "grid_1.yaml")
    # a calliper of 0.05 mm
    assert grid.depths_mm == pytest.approx([60.0, 150.0], abs=0.25)
    truth, _ = read_table(tmp_path / "truth" / "lines.parquet", LINE_TRUTH)
    seen = truth[truth["visible"]]
    sensor = read_sensor(tmp_path / "truth" / "sensor.yaml")
    depth = intersect(sensor, seen[["x_px", "y_px"]].to_numpy()).depth_mm
    # the true line lies on the levels of the object
    near = np.minimum(np.abs(depth - 60.0), np.abs(depth - 150.0))
    assert np.nanquantile(near, 0.95) < 0.01
    assert_allclose(sensor.vector(), Basin.of(TINY, 7).true.vector(), rtol=1e-12, atol=1e-12)


def test_panels_and_the_calliper(tmp_path):
    twin = TwinConfig.of_size("basin_tiny", light_sheet={"panels_mm": [120.0, 80.0]})
    record_series(twin, 7, "panels", FRAME, tmp_path, tmp_path / "truth")
    table = read_panels(tmp_path / "images.csv")
    assert table["depth_mm"].tolist() == pytest.approx([120.0, 80.0], abs=0.1)
    assert (table["sigma_mm"] == 0.02).all()
    assert table["file"].tolist() == sorted(path.name for path in (tmp_path / "images").iterdir())
    assert json.loads((tmp_path / "truth" / "plan.json").read_text())["depths_mm"] == [120.0, 80.0]
