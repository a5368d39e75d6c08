"""Bad input of the calibration: what was found, what was expected, what to do."""

import pandas as pd
import pytest

from tests.lightsheet.calibrate import lines
from thalweg.core import GeometryError
from thalweg.lightsheet.calibration import CalibrationSettings, calibrate_sheet, parse_grid
from thalweg.lightsheet.optics import paper_4

SETTINGS = CalibrationSettings(least_gap_px=6.0)
FLAGS = CalibrationSettings(least_gap_px=6.0, drop_flags=4)
SENSOR, GRID = paper_4(), lines.grid_object()
SOLID = parse_grid(lines.OBJECT.replace("gap_mm: 5.0", "gap_mm: 0.02"))
"""The grid with its gaps closed."""


@pytest.fixture(scope="module")
def points():
    return lines.line_points(SENSOR, GRID, every=3)


def flipped(points, *columns):
    return points.assign(**{name: 2048 - points[name] for name in columns})


def of_level(points, level):
    return points[points["level"] == level]


def one_gap(points):
    """The line above, and a single piece of the line below."""
    plate = of_level(points, 1).sort_values("y_px")
    piece = plate["y_px"].diff().gt(6.0).cumsum()
    return pd.concat([of_level(points, 0), plate[piece == 4]])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        pytest.param(
            lambda p: {"sensor": SENSOR.with_water(1.0)},
            ["no line point meets the light sheet", "index of the water"],
            id="the index of air instead of water",
        ),
        pytest.param(
            lambda p: {"points": lines.line_points(SENSOR.with_water(1.0), GRID, every=3)},
            ["51% of the line below is lit", "whether the housing was dry"],
            id="a dry housing",
        ),
        pytest.param(
            lambda p: {"points": flipped(p, "x_px", "y_px")},
            ["swapped", "mounted upside down"],
            id="a camera mounted upside down",
        ),
        pytest.param(
            lambda p: {"points": flipped(p, "x_px")},
            ["mirrored", "levels are swapped"],
            id="mirrored left to right",
        ),
        pytest.param(
            lambda p: {"points": flipped(p, "y_px")}, ["mirrored top to bottom"], id="mirrored top to bottom"
        ),
        pytest.param(  # fragments near the window, the interrupted line below; bars of 9 mm, gaps of 5 mm
            lambda p: {
                "points": lines.line_points(SENSOR, GRID, every=3, depths_mm=GRID.depths_mm[::-1].copy())
            },
            ["swapped", "1.80 to 1"],
            id="the object the wrong way round",
        ),
        pytest.param(
            lambda p: {"points": lines.line_points(SENSOR, SOLID, every=3)},
            ["1 piece of line on grid", "Check that gaps lie under the line"],
            id="a grid without gaps",
        ),
        pytest.param(  # the detector has smoothed along the line: no gap on top, though pieces lie below
            lambda p: {"points": pd.concat([lines.line_points(SENSOR, SOLID, every=3), of_level(p, 1)])},
            ["has no gap"],
            id="a line that bridges its gaps",
        ),
        pytest.param(
            lambda p: {"points": of_level(p, 0)},
            ["seen on 1 of 2 levels", "none on plate"],
            id="the grid alone",
        ),
        pytest.param(
            lambda p: {"points": of_level(p, 1)},
            ["seen on 1 of 2 levels", "none on grid"],
            id="the plate alone",
        ),
        pytest.param(lambda p: {"points": one_gap(p)}, ["pairs of ends", "Let more gaps"], id="too few gaps"),
        pytest.param(
            lambda p: {"grid": lines.grid_object(80.0, 150.0)}, ["epths"], id="depths that cannot be"
        ),
        pytest.param(
            lambda p: {"points": p.assign(flags=4 * (p["level"] == 1)), "settings": FLAGS},
            ["line points are left on 1 of 2 levels", "on plate", "more pixels"],
            id="one of two levels loses its points",
        ),
    ],
)
def test_each_mistake_is_told(points, given, words):
    usual = {"sensor": SENSOR, "points": points, "grid": GRID, "settings": SETTINGS}
    with pytest.raises(GeometryError) as error:
        calibrate_sheet(*(usual | given(points)).values())
    for part in ("found", "expected", "cure"):
        assert getattr(error.value, part), part
    for word in words:
        assert word in str(error.value)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"jointly": ("windw",)}, r"'windw' among what is estimated jointly.*window"),
        ({"estimate": ("laser_w",)}, "laser_w among the unknowns"),
    ],
)
def test_a_word_that_is_no_group(points, settings, words):
    with pytest.raises(GeometryError, match=words):
        calibrate_sheet(SENSOR, points, GRID, CalibrationSettings(**settings))


def test_a_level_that_loses_its_points_is_told():
    """Three levels in a small picture: every piece on the middle one is near a jump all along."""
    grid = parse_grid(lines.THREE)
    points = lines.line_points(SENSOR, grid, every=3)
    near = points["level"] == 1
    settings = CalibrationSettings(least_gap_px=6.0, drop_flags=4, jointly=("levels",))
    whole = calibrate_sheet(SENSOR, points, grid, settings)
    found = calibrate_sheet(SENSOR, points.assign(flags=4 * near), grid, settings)
    assert whole.correspondence.lost == ()
    assert found.correspondence.lost == ("middle",)
    # inner points are counted as flagged, the ends of pieces apart
    assert 0.7 * near.sum() < found.correspondence.counts["flagged by the detector"] <= near.sum()
    told = "hardly a line point is left on middle"
    assert [told in text for text in found.warnings].count(True) == 1
    assert not [text for text in whole.warnings if "hardly" in text]
    # its depth comes from the ends of pieces and from what was stated
    assert found.sigma("depth_middle_mm") > whole.sigma("depth_middle_mm")
