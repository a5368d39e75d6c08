"""Figures of the light-sheet sensor: geometry, line, calibration, volume, budget, panels, models."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from thalweg.core import CoverageError, InputError
from thalweg.lightsheet.budget import TOTAL_CORRELATED, budget_on_lines
from thalweg.lightsheet.figures import departures_px, first_image, measured
from thalweg.lightsheet.figures.budget import depth_budget
from thalweg.lightsheet.figures.grid_calibration import grid_calibration
from thalweg.lightsheet.figures.lines import line_measurement, sheet_image, shown_flag
from thalweg.lightsheet.figures.panel_distances import first_with_points, panel_distances, signed
from thalweg.lightsheet.figures.sensor import (
    TILTS_DEG,
    measurement_volume_view,
    sheet_deformation,
    sheet_paths,
    tilted_sheet,
)
from thalweg.lightsheet.figures.views import along_and_off, beam_paths, find_image
from thalweg.lightsheet.lines import LineFlag
from thalweg.lightsheet.optics import depth_lines, intersect, measurement_volume, paper_4


@pytest.fixture(scope="module")
def sensor():
    """The prototype of P4 with an image of 512 x 512 pixels."""
    full = paper_4()
    factor = np.ones(26)
    factor[6:10] = 0.25
    return replace(full, camera=full.camera.scaled((512, 512)), cov=full.cov * np.outer(factor, factor))


def image_of_line(x_px, shape=(512, 512), *, sigma_px=1.6, peak=150.0):
    """A monochrome image of a line at a place in each row."""
    columns = np.arange(shape[1]) + 0.5
    light = peak * np.exp(-0.5 * ((columns - np.asarray(x_px)[:, None]) / sigma_px) ** 2)
    return np.rint(light + 4.0).astype(np.uint8)


def line_table(x_px, y_px, *, flags=0, angle_rad=0.0):
    n = len(x_px)
    return pd.DataFrame(
        {
            "file": "a.png",
            "x_px": x_px,
            "y_px": y_px,
            "sigma_px": 0.1,
            "angle_rad": angle_rad,
            "peak_dn": 150.0,
            "width_px": 3.2,
            "background_dn": 4.0,
            "flags": np.broadcast_to(flags, n).astype(np.uint8),
        }
    )


def line_at(sensor, depth_mm):
    """Place of the line of a depth in each row of the image that has one: columns (n,), rows (n,)."""
    (line,) = depth_lines(sensor, [depth_mm], 2001)
    order = np.argsort(line.xy_px[:, 1])
    rows = np.arange(int(line.xy_px[:, 1].min()) + 1, int(line.xy_px[:, 1].max())) + 0.5
    return np.interp(rows, line.xy_px[order, 1], line.xy_px[order, 0]), rows


# ---------------------------------------------------------------- what figures share


def test_paths_of_light_obey_snell_and_end_in_the_depth(sensor):
    sheet, window = sensor.sheet, sensor.window
    beams = sheet.beams([-0.3, 0.0, 0.4])
    paths = beam_paths(sheet.origin_lcs_mm, beams, window, 80.0)
    assert_allclose(paths[:, 0], np.broadcast_to(sheet.origin_lcs_mm, (3, 3)))
    # rounding of numbers of some hundred millimetres
    assert_allclose(paths[:, 1, 2], 0.0, atol=1e-9)
    assert_allclose(window.depth_mm(paths[:, 2]), 0.0, atol=1e-9)
    assert_allclose(window.depth_mm(paths[:, 3]), 80.0, atol=1e-9)
    parts = np.diff(paths, axis=1)
    sines = np.linalg.norm(parts[..., :2], axis=2) / np.linalg.norm(parts, axis=2)
    indices = np.array([window.n_air, window.n_glass, window.n_water])
    assert_allclose(sines * indices, (sines * indices)[:, :1].repeat(3, 1), rtol=1e-9)


def test_images_are_found_by_name(tmp_path):
    Image.fromarray(np.full((20, 30), 7, np.uint8)).save(tmp_path / "a.png")
    assert find_image([tmp_path], "a.png").shape == (20, 30)
    with pytest.raises(InputError, match=r"no image b\.png"):
        find_image([tmp_path], "b.png")
    both = pd.concat([line_table([1.0], [2.0]), line_table([1.0], [2.0]).assign(file="b.png")])
    both.to_parquet(tmp_path / "points.parquet")
    image, points = first_image([tmp_path], tmp_path / "points.parquet")
    assert image[0, 0] == 7
    assert points["file"].tolist() == ["a.png"]


# ---------------------------------------------------------------- geometry


def test_one_tilt_bends_the_line_to_one_side_two_to_both(look):
    figure = sheet_deformation()
    bends = []
    for ax, (first, second) in zip(figure.axes[2:], TILTS_DEG, strict=True):
        (line,) = [artist for artist in ax.lines if artist.get_gid() == "line"]
        turns = np.sign(np.diff(line.get_ydata(), 2))[3:-3]
        bends.append(int(np.sum(np.diff(turns) != 0)))
        points = sheet_paths(tilted_sheet(first, second))[:, 3]
        along, off = along_and_off(points[:, 0], points[:, 1])
        assert_allclose(line.get_xdata(), along)
        assert_allclose(line.get_ydata(), off)
    # P4 Fig. 2: a bow, and an S with one turning point
    assert bends == [0, 1]


def test_the_volume_shows_what_the_sensor_sees(sensor, look):
    figure = measurement_volume_view(sensor, (0.0, 50.0, 125.0, 900.0), step_px=16, title="P4", twin=True)
    words = look.texts(figure)
    volume = measurement_volume(sensor, 16)
    assert f"P4: {volume.depth_mm[1]:.0f} mm deep" in words
    assert figure.axes[3].get_xlabel() == "x / mm\nnot in the image: 900 mm"


# ---------------------------------------------------------------- line


def test_departures_are_those_from_a_smooth_line():
    y = np.arange(200) + 0.5
    x = 100.0 + 1e-3 * (y - 100.0) ** 2
    smooth = line_table(np.where(np.arange(200) == 50, x + 9.0, x), y)
    off = departures_px(line_table(x + 0.25, y), smooth)
    # the outlier of nine pixels among the 200 is left out of the curve
    assert_allclose(off, 0.25, atol=1e-6)


def test_methods_are_compared_on_one_line(rng, look):
    rows = np.arange(256) + 0.5
    image = image_of_line(128.0 + 15.0 * (rows / 256) ** 2, (256, 256))
    noisy = (image * rng.gamma(4.0, 0.25, image.shape)).clip(0, 255).astype(np.uint8)
    points = measured(noisy, ("row_gauss", "speckle_patch"))
    figure = line_measurement(noisy, points, title="Basin", twin=True)
    best = points["speckle_patch"]
    assert "Basin: one laser line measured by 2 methods" in look.texts(figure)
    std = np.std(departures_px(best, best))
    assert f"speckle-weighted patch: {std:.2f} px" in look.texts(figure)


def test_flags_are_shown_by_their_last_bit(look):
    flags = np.array([0, LineFlag.WEAK, LineFlag.SATURATED | LineFlag.NEAR_JUMP, LineFlag.NEAR_JUMP])
    assert shown_flag(flags.astype(np.uint8)).tolist() == [0, 2, 1, 4]
    rows = np.arange(96) + 0.5
    image = image_of_line(np.full(96, 48.0), (96, 96))
    table = line_table(np.full(96, 48.0), rows, flags=np.where((rows > 40) & (rows < 50), 1, 0))
    table["piece"] = 0
    figure = sheet_image(image, table, title="Steps", twin=True)
    words = look.texts(figure)
    assert "Steps: line in 1 piece, median sigma 0.10 px, 10 flagged, n = 96 points" in words
    assert "saturated: 10" in [text.get_text() for text in figure.legends[0].get_texts()]
    with pytest.raises(InputError, match="columns missing: flags"):
        sheet_image(image, table.drop(columns="flags"))


# ---------------------------------------------------------------- calibration


@pytest.fixture
def observations(sensor):
    """Image, residuals and pairs of two levels as the adjustment writes them."""
    (x1, y1), (x2, y2) = line_at(sensor, 60.0), line_at(sensor, 150.0)
    residuals = pd.DataFrame(
        {
            "level": ["grid"] * len(x1) + ["plate"] * len(x2),
            "x_px": np.concatenate([x1, x2]),
            "y_px": np.concatenate([y1, y2]),
            "residual_px": 0.05,
            "standardised": 0.5,
            "used": True,
        }
    )
    upper, lower = depth_lines(sensor, [60.0, 150.0], 401)
    shared = np.intersect1d(upper.fan_angle_rad, lower.fan_angle_rad)[::40]
    ends = [line.xy_px[np.searchsorted(line.fan_angle_rad, shared)] for line in (upper, lower)]
    pairs = pd.DataFrame(
        {
            "upper_x_px": ends[0][:, 0],
            "upper_y_px": ends[0][:, 1],
            "lower_x_px": ends[1][:, 0],
            "lower_y_px": ends[1][:, 1],
            "side": 1,
            "apart_deg": 0.01,
            "standardised": 0.3,
            "used": True,
        }
    )
    return image_of_line(np.full(512, 250.0)), residuals, pairs


def test_the_calibration_shows_what_was_used(sensor, observations, look):
    image, residuals, pairs = observations
    residuals.loc[3:5, "used"] = False
    pairs.loc[1, "used"] = False
    figure = grid_calibration(sensor, image, residuals, pairs, title="Basin", twin=True)
    n, m = int(residuals["used"].sum()), int(pairs["used"].sum())
    assert f"Basin: n = {n} line points and {m} pairs of ends, 4 observations rejected" in look.texts(figure)
    with pytest.raises(CoverageError, match="0 points"):
        grid_calibration(sensor, image, residuals.assign(used=False), pairs)
    with pytest.raises(InputError, match="an empty table"):
        grid_calibration(sensor, image, residuals, pairs[:0])


# ---------------------------------------------------------------- budget


def test_each_cause_has_its_panel(look):
    lines = budget_on_lines(paper_4(), n=15)
    figure = depth_budget(lines, title="P4")
    most = lines.groupby("cause")["sigma_depth_mm"].max()
    assert sum(ax.axison for ax in figure.axes) == int((most.drop(TOTAL_CORRELATED) > 0.0).sum())


# ---------------------------------------------------------------- panels and models


@pytest.fixture
def on_panels(sensor):
    parts, rows = [], []
    for k, depth in enumerate((128.9, 83.1)):
        x, y = line_at(sensor, depth)
        points = intersect(sensor, np.stack([x, y], axis=1))
        off = 0.1 * (k + 1)
        parts.append(
            pd.DataFrame(
                {
                    "file": f"{k}.png",
                    "x_mm": points.xyz_lcs_mm[:, 0],
                    "y_mm": points.xyz_lcs_mm[:, 1],
                    "depth_mm": points.depth_mm + off,
                    "sigma_depth_mm": 0.07,
                    "expected_depth_mm": depth,
                    "x_px": x,
                    "y_px": y,
                }
            )
        )
        rows.append((f"{k}.png", depth, len(x), off, 0.01, 0.07, 0.03, 0.21))
    names = (
        "file",
        "depth_mm",
        "n",
        "mean_mm",
        "std_mm",
        "predicted_mm",
        "published_mean_mm",
        "published_std_mm",
    )
    return pd.concat(parts, ignore_index=True), pd.DataFrame(rows, columns=names)


def test_panels_stand_beside_published_values(sensor, on_panels, look):
    points, panels = on_panels
    image = image_of_line(np.full(512, 250.0))
    figure = panel_distances(sensor, image, points, panels, title="Basin", twin=True)
    words = look.texts(figure)
    assert f"128.9 mm: +0.100 ± 0.010 mm, n = {panels['n'][0]}" in words
    assert signed(-4e-4) == "0.000"
    # an image without a line: its panel stays, empty, and the picture is of the next one
    bare = panels.assign(n=[0, panels["n"][1]], mean_mm=[np.nan, 0.2], std_mm=[np.nan, 0.01])
    assert first_with_points(bare)["file"] == "1.png"
    figure = panel_distances(sensor, image, points[points["file"] == "1.png"], bare)
    assert "128.9 mm: no points" in look.texts(figure)
    assert "a: detail at 83.1 mm" in look.texts(figure)
    with pytest.raises(CoverageError, match="no point on any panel"):
        first_with_points(panels.assign(n=0))
    with pytest.raises(InputError, match="columns missing: expected_depth_mm"):
        panel_distances(sensor, image, points.drop(columns="expected_depth_mm"), panels)
