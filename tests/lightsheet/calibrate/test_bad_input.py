"""Bad input of the calibration: what was found, what was expected, what to do."""

import pandas as pd
import pytest

from thalweg.core import GeometryError
from thalweg.lightsheet.calibration import CalibrationSettings, calibrate_sheet, parse_grid
from thalweg.lightsheet.optics import paper_4

SETTINGS = CalibrationSettings(least_gap_px=6.0)


def told(sensor, points, grid, settings=SETTINGS):
    with pytest.raises(GeometryError) as error:
        calibrate_sheet(sensor, points, grid, settings)
    assert error.value.found
    assert error.value.expected
    assert error.value.cure
    return str(error.value)


@pytest.fixture
def setup(lines):
    sensor, grid = paper_4(), lines.grid_object()
    return sensor, grid, lines.line_points(sensor, grid, every=3)


def test_the_index_of_air_instead_of_water(setup):
    sensor, grid, points = setup
    text = told(sensor.with_water(1.0), points, grid)
    assert "no line point meets the light sheet" in text
    assert "index of the water" in text


def test_a_dry_housing(lines, setup):
    sensor, grid, _ = setup
    text = told(sensor, lines.line_points(sensor.with_water(1.0), grid, every=3), grid)
    assert "51% of the line below is lit" in text
    assert "whether the housing was dry" in text


def test_a_camera_mounted_upside_down(setup):
    sensor, grid, points = setup
    turned = points.assign(x_px=2048 - points["x_px"], y_px=2048 - points["y_px"])
    text = told(sensor, turned, grid)
    assert "swapped" in text
    assert "mounted upside down" in text


@pytest.mark.parametrize(
    ("column", "word"), [("x_px", "levels are swapped"), ("y_px", "mirrored top to bottom")]
)
def test_a_mirrored_picture(setup, column, word):
    sensor, grid, points = setup
    text = told(sensor, points.assign(**{column: 2048 - points[column]}), grid)
    assert "mirrored" in text
    assert word in text


def test_swapped_levels(lines, setup):
    """The object lies the wrong way round: fragments near the window, the interrupted line below."""
    sensor, grid, _ = setup
    other = lines.line_points(sensor, grid, every=3, depths_mm=grid.depths_mm[::-1].copy())
    text = told(sensor, other, grid)
    assert "swapped" in text
    assert "1.80 to 1" in text  # bars of 9 mm, gaps of 5 mm


def test_a_grid_without_gaps(lines, setup):
    sensor, grid, _ = setup
    solid = parse_grid(lines.OBJECT.replace("gap_mm: 5.0", "gap_mm: 0.02"))
    text = told(sensor, lines.line_points(sensor, solid, every=3), grid)
    assert "1 piece of line on grid" in text
    assert "Check that gaps lie under the line" in text


def test_a_line_that_bridges_its_gaps(lines, setup):
    """The detector has smoothed along the line: no gap on top, though pieces lie below."""
    sensor, grid, points = setup
    solid = parse_grid(lines.OBJECT.replace("gap_mm: 5.0", "gap_mm: 0.02"))
    whole = lines.line_points(sensor, solid, every=3)
    text = told(sensor, pd.concat([whole, points[points["level"] == 1]], ignore_index=True), grid)
    assert "has no gap" in text


@pytest.mark.parametrize("level", [0, 1])
def test_one_level_only(setup, level):
    sensor, grid, points = setup
    text = told(sensor, points[points["level"] == level], grid)
    assert "seen on 1 of 2 levels" in text
    assert ("none on plate" if level == 0 else "none on grid") in text


def test_too_few_gaps(setup):
    sensor, grid, points = setup
    plate = points[points["level"] == 1].sort_values("y_px")
    piece = plate["y_px"].diff().gt(6.0).cumsum()
    few = pd.concat([points[points["level"] == 0], plate[piece == 4]])
    text = told(sensor, few, grid)
    assert "pairs of ends" in text
    assert "Let more gaps" in text


def test_depths_that_cannot_be(lines, setup):
    sensor, _, points = setup
    text = told(sensor, points, lines.grid_object(80.0, 150.0))
    assert "stated depths" in text or "Depths" in text or "depths of the levels" in text


def test_a_word_that_is_no_group(setup):
    sensor, grid, points = setup
    with pytest.raises(GeometryError, match=r"'windw' among what is estimated jointly.*window"):
        calibrate_sheet(sensor, points, grid, CalibrationSettings(jointly=("windw",)))
    with pytest.raises(GeometryError, match="laser_w among the unknowns"):
        calibrate_sheet(sensor, points, grid, CalibrationSettings(estimate=("laser_w",)))


def test_a_level_that_loses_its_points_is_told(lines):
    """Three levels in a small picture: every piece on the middle one is near a jump all along."""
    sensor, grid = paper_4(), parse_grid(lines.THREE)
    points = lines.line_points(sensor, grid, every=3)
    near = points["level"] == 1
    settings = CalibrationSettings(least_gap_px=6.0, drop_flags=4, jointly=("levels",))
    whole = calibrate_sheet(sensor, points, grid, settings)
    found = calibrate_sheet(sensor, points.assign(flags=4 * near), grid, settings)
    assert whole.correspondence.lost == ()
    assert found.correspondence.lost == ("middle",)
    # inner points are counted as flagged, the ends of pieces apart
    counts = found.correspondence.counts
    assert 0.7 * near.sum() < counts["flagged by the detector"] <= near.sum()
    told_of = [text for text in found.warnings if "hardly a line point is left on middle" in text]
    assert len(told_of) == 1
    assert not [text for text in whole.warnings if "hardly" in text]
    # its depth comes from the ends of pieces and from what was stated
    assert found.sigma("depth_middle_mm") > whole.sigma("depth_middle_mm")


def test_one_of_two_levels_loses_its_points(setup):
    sensor, grid, points = setup
    settings = CalibrationSettings(least_gap_px=6.0, drop_flags=4)
    text = told(sensor, points.assign(flags=4 * (points["level"] == 1)), grid, settings)
    assert "line points are left on 1 of 2 levels" in text
    assert "on plate" in text
    assert "more pixels" in text
