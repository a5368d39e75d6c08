"""Line points of a series, and their places on the sheet with covariance."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from thalweg.core import GeometryError, InputError, read_table, write_table
from thalweg.lightsheet.calibration import read_grid
from thalweg.lightsheet.lines import LineSettings, detect_lines, pooled_shift, without_shift
from thalweg.lightsheet.optics import PARAMETERS, intersect, paper_4, project, sheet_in_water
from thalweg.lightsheet.poses import (
    SERIES_POINTS,
    detect_series,
    read_sheet_image,
    require_levels,
    require_one_image,
)
from thalweg.lightsheet.poses.series import SHEET_POINTS, points_on_sheet
from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import SheetImage
from thalweg_lab.tank import render_sheet_image, scan_plan, sized, stepped_object

SIZE = (512, 512)


def line_table(xy, *, sigma_px=0.1, angle_rad=0.0):
    n = len(xy)
    return pd.DataFrame(
        {
            "file": "a.png",
            "line": np.zeros(n, np.int32),
            "x_px": xy[:, 0],
            "y_px": xy[:, 1],
            "sigma_px": sigma_px,
            "angle_rad": angle_rad,
            "flags": np.arange(n, dtype=np.uint8) % 2,
        }
    )


def on_plane(sensor, n=40):
    """Image points of the sheet 125 mm deep."""
    return project(sensor, sheet_in_water(sensor, [125.0], np.linspace(-0.25, 0.25, n))[0])


# ---------------------------------------------------------------- images


def test_colours_come_red_first_and_a_mosaic_as_it_is(tmp_path):
    colour = np.zeros((20, 30, 3), np.uint8)
    colour[..., 0], colour[..., 1], colour[..., 2] = 10, 20, 30
    cv2.imwrite(str(tmp_path / "a.png"), colour[:, :, ::-1])
    assert_array_equal(read_sheet_image(tmp_path / "a.png"), colour)
    four = np.dstack([colour[:, :, ::-1], np.full((20, 30), 255, np.uint8)])
    cv2.imwrite(str(tmp_path / "b.png"), four)
    assert_array_equal(read_sheet_image(tmp_path / "b.png"), colour)
    deep = np.arange(600, dtype=np.uint16).reshape(20, 30) * 100
    cv2.imwrite(str(tmp_path / "c.tiff"), deep)
    assert_array_equal(read_sheet_image(tmp_path / "c.tiff"), deep)


def test_files_that_are_no_images(tmp_path):
    (tmp_path / "empty.png").touch()
    (tmp_path / "text.png").write_text("no image")
    told = {"empty": "empty or missing", "text": "cannot be read", "none": "empty or missing"}
    for name, words in told.items():
        with pytest.raises(InputError, match=rf"{name}.png: .*{words}.*expected PNG.*camera's disk"):
            read_sheet_image(tmp_path / f"{name}.png")


def test_points_of_all_images_and_counts_of_each(basin):
    points, counts = detect_series(basin.images("panels"), LineSettings(), SIZE, threads=2)
    assert list(points.columns) == list(SERIES_POINTS.names)
    names = [path.name for path in basin.images("panels")]
    assert counts["file"].tolist() == names
    assert points.groupby("file").size().loc[names].tolist() == counts["points"].tolist()
    assert (counts["reason"] == "").all()
    # what was found is what was kept and what was dropped
    dropped = counts.drop(columns=["file", "reason", "points", "candidates"])
    assert (counts["points"] + dropped.sum(axis=1) == counts["candidates"]).all()
    again, _ = detect_series(basin.images("panels"), LineSettings(), SIZE, threads=1)
    pd.testing.assert_frame_equal(points, again)


def test_an_image_without_a_line_is_counted_and_told(basin, tmp_path, caplog):
    dark, bright = tmp_path / "dark.png", tmp_path / "bright.png"
    cv2.imwrite(str(dark), np.full((512, 512), 3, np.uint8))
    cv2.imwrite(str(bright), np.full((512, 512), 255, np.uint8))
    good = basin.images("panels")[0]
    points, counts = detect_series([dark, good, bright], LineSettings(), SIZE)
    assert set(points["file"]) == {good.name}
    assert counts["points"].dtype == np.int64
    assert counts["points"].tolist() == [0, len(points), 0]
    assert (counts.drop(columns=["file", "reason"]).loc[[0, 2]] == 0).all(axis=None)
    assert "no laser line" in counts["reason"][0]
    assert "over-exposed" in counts["reason"][2]
    assert "dark.png gives no points" in caplog.text
    assert "shorter exposure" in caplog.text
    with pytest.raises(InputError, match=r"none of 2 images.*bright.png: .*over-exposed.*shorter exposure"):
        detect_series([bright, dark], LineSettings(), SIZE)


def test_series_that_cannot_be(basin, tmp_path):
    image = basin.images("panels")[0]
    with pytest.raises(InputError, match="no images"):
        detect_series([], LineSettings(), SIZE)
    with pytest.raises(InputError, match=r"512 x 512 pixels; expected 1024 x 1024.*interior orientation"):
        detect_series([image], LineSettings(), (1024, 1024))
    copy = tmp_path / image.name
    copy.write_bytes(image.read_bytes())
    with pytest.raises(InputError, match=f"two images are called {image.name}"):
        detect_series([image, copy], LineSettings(), SIZE)


def test_a_grid_is_calibrated_from_one_image(basin):
    table = line_table(np.zeros((4, 2))).assign(file=["a.png", "a.png", "b.png", "b.png"])
    with pytest.raises(
        InputError, match=r"x: line points of 2 images, such as a.png and b.png.*Name one image"
    ):
        require_one_image(table, where=Path("x"))
    assert len(require_one_image(table[:2], where=Path("x"))) == 2
    grid = read_grid(basin.folder / "calibration" / "grid_1.yaml")
    require_levels(grid, 2, where=Path("x"))
    with pytest.raises(InputError, match=r"2 levels \(grid 1, plate\); expected 3.*levels: 2"):
        require_levels(grid, 3, where=Path("x"))


# ---------------------------------------------------------------- points


def test_points_come_back_to_their_pixels_in_millimetres():
    """Also under a tilted window: depth counts along its normal."""
    sensor = paper_4()
    sensor = replace(sensor, window=replace(sensor.window, tilt_x_rad=0.02, tilt_y_rad=-0.01))
    found, counts = points_on_sheet(sensor, line_table(on_plane(sensor)))
    assert list(found.columns) == list(SHEET_POINTS.names)
    assert counts == {"ok": 40}
    # solver and projection agree to 1e-9 mm
    assert found["depth_mm"].to_numpy() == pytest.approx(125.0, abs=1e-7)
    xyz = found[["x_mm", "y_mm", "z_mm"]].to_numpy()
    depth = -(xyz @ sensor.window.R_lcs_window[:, 2]) - sensor.window.thickness_mm
    assert found["depth_mm"].to_numpy() == pytest.approx(depth, abs=1e-9)
    # a pixel sees 0.1 mm
    assert_allclose(project(sensor, xyz), found[["x_px", "y_px"]], atol=1e-6)
    assert found["flags"].tolist() == [k % 2 for k in range(40)]


def test_the_covariance_is_that_of_a_shift_along_the_direction_of_measurement():
    """A shift by sigma moves the point as far as the difference quotient says: one direction, rank one."""
    sensor = paper_4()
    xy, angle, sigma = on_plane(sensor, 3)[1], 0.3, 0.2
    step = 1e-3 * np.array([np.cos(angle), np.sin(angle)])
    ahead, back = intersect(sensor, [xy + step, xy - step]).xyz_lcs_mm
    moved = sigma * (ahead - back) / 2e-3
    found, _ = points_on_sheet(sensor, line_table(xy[None], sigma_px=sigma, angle_rad=angle))
    cov = found[[f"cov_{a}_mm2" for a in ("xx", "xy", "xz", "yy", "yz", "zz")]].to_numpy()[0]
    # second order of a step of 1e-3 px
    assert_allclose(cov, np.outer(moved, moved)[np.triu_indices(3)], rtol=1e-6)


def test_sigma_of_the_depth_holds_pixel_and_sensor():
    sensor, xy = paper_4(), on_plane(paper_4(), 5)
    cov = np.zeros((26, 26))
    cov[PARAMETERS.index("n_water"), PARAMETERS.index("n_water")] = 1e-3**2
    known = sensor.with_vector(sensor.vector(), cov=np.zeros((26, 26)))
    loose = sensor.with_vector(sensor.vector(), cov=cov)
    (alone, _), (both, _) = (points_on_sheet(s, line_table(xy)) for s in (known, loose))
    assert_allclose(alone["sigma_depth_mm"] ** 2, alone["cov_zz_mm2"], rtol=1e-9)
    other = intersect(sensor.with_water(sensor.window.n_water + 1e-3), xy).depth_mm
    by_water = other - alone["depth_mm"]
    # first order of a step of 1e-3
    assert_allclose(both["sigma_depth_mm"], np.hypot(alone["sigma_depth_mm"], by_water), rtol=0.02)
    # per-point covariance does not hold what all points share
    assert_allclose(both["cov_zz_mm2"], alone["cov_zz_mm2"], rtol=1e-12)


def test_points_off_the_sheet_are_counted_and_never_numbers():
    sensor = paper_4()
    good = on_plane(sensor, 5)
    beside = np.array([[2040.0, 10.0], [np.nan, 5.0]])
    found, counts = points_on_sheet(sensor, line_table(np.concatenate([good, beside])))
    assert len(found) == 5
    assert counts["ok"] == 5
    assert sum(counts.values()) == 7
    assert np.isfinite(found.drop(columns="file").to_numpy(float)).all()
    with pytest.raises(GeometryError, match=r"none of 2 line points lies on the light sheet.*mirrored"):
        points_on_sheet(sensor, line_table(beside))


def test_a_series_removes_the_shift_that_its_images_have_in_common(tmp_path):
    """P4 7.2: what one image cannot tell from nothing, all of them can; the table keeps what was done."""
    sensor, light = sized(paper_4(), SheetImage(), "tiny")
    chip = light.chip.model_copy(update={"peak_dn": 1200.0, "ambient_dn": 0.0})
    light = light.model_copy(update={"halo_share": 0.7, "halo_mm": 2.0, "chip": chip})
    plan = scan_plan(sensor, 3, stepped_object(), lines=3, step_mm=3.0)
    paths = [tmp_path / f"{k}.png" for k in range(3)]
    for k, path in enumerate(paths):
        cv2.imwrite(str(path), render_sheet_image(sensor, plan.scene(k), light, generator(3, f"s{k}")))
    points, _ = detect_series(paths, LineSettings(method="lsm"), sensor.camera.size_px)
    alone = [detect_lines(read_sheet_image(path), LineSettings(method="lsm")) for path in paths]
    shift = pooled_shift([one.facts for one in alone])
    told = points.attrs["width_shift"]
    assert told == {name: getattr(shift, name) for name in ("coefficient", "sigma", "edges", "applied")}
    assert shift.edges >= 6
    expected = np.concatenate([without_shift(one, shift).x_px for one in alone])
    assert_array_equal(points["x_px"].to_numpy(), expected)
    write_table(tmp_path / "points.parquet", points, SERIES_POINTS, dict(points.attrs))
    assert read_table(tmp_path / "points.parquet", SERIES_POINTS)[1]["width_shift"]["edges"] == shift.edges
    # one image has nobody to ask: it removes its own, if that stands out
    single, _ = detect_series(paths[:1], LineSettings(method="lsm"), sensor.camera.size_px)
    own = without_shift(alone[0], pooled_shift([alone[0].facts]))
    assert_array_equal(single["x_px"].to_numpy(), own.x_px)
