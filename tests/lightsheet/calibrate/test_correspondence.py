"""Levels, pieces and pairs from line points, with approximate values that are off."""

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_array_equal

from tests.lightsheet.calibrate import lines
from thalweg.core import GeometryError, InputError
from thalweg.lightsheet.calibration import CalibrationSettings, fit_sheet, parse_grid
from thalweg.lightsheet.calibration.correspondence import (
    END,
    FLAGGED,
    LONELY,
    NO_NUMBER,
    OFF,
    SHORT,
    THICK,
    Segment,
    _fan_of_pieces,
    _require_levels,
    correspond,
    levels_of_points,
)
from thalweg.lightsheet.optics import paper_4

SETTINGS = CalibrationSettings(least_gap_px=6.0)
SENSOR, KNOWN, GRID = paper_4(), lines.without_sigmas(paper_4()), lines.grid_object()


@pytest.mark.parametrize("seed", range(12))
def test_every_point_gets_its_level_from_a_start_that_is_off(seed):
    points = lines.line_points(SENSOR, GRID, seed, every=4)
    found = correspond(lines.off_start(SENSOR, seed), points, GRID, SETTINGS, first=True)
    labelled = found.level >= 0
    assert_array_equal(found.level[labelled], points["level"][labelled])
    # an approximate fan turned by 4 of its 90 degrees, its laser 10 mm aside, leaves points at its ends
    # without a beam
    assert labelled.mean() > 0.85


def test_levels_are_found_through_shift_slope_and_scale():
    rng = np.random.default_rng(3)
    fan = rng.uniform(-0.7, 0.7, 600)
    level = rng.integers(0, 3, 600)
    depths = np.array([60.0, 105.0, 150.0])
    # 25 mm too deep, 30 mm a radian oblique, bent, spread by a tenth
    seen = 105.0 + 1.1 * (depths[level] - 105.0) + 25.0 + 30.0 * fan + 8.0 * fan**2
    found = levels_of_points(seen + 0.02 * rng.standard_normal(600), fan, depths)
    assert_array_equal(found, level)


def test_pairs_lie_on_one_sub_beam():
    found = correspond(SENSOR, lines.line_points(SENSOR, GRID, sigma_px=0.0), GRID, SETTINGS)
    pairs = found.pairs
    # ten and eight pieces
    assert found.gaps == (9, 7)
    # seven gaps whose both ends are in the picture on both levels
    assert len(pairs.side) == 14
    assert sorted(pairs.side.tolist()) == [-1] * 7 + [1] * 7
    # half a row on either level: 0.6 mrad a pixel at most
    assert np.abs(found.matched.apart_rad).max() < 0.0013


def test_all_that_is_dropped_is_counted():
    points = lines.line_points(SENSOR, GRID, every=2)
    stray = points.sample(40, random_state=1).assign(
        x_px=np.random.default_rng(1).uniform(300, 2040, 40), level=-1
    )
    missing = points.sample(5, random_state=2).assign(x_px=np.nan)
    flagged = points.sample(7, random_state=3).assign(flags=2)
    every = pd.concat([points, stray, missing, flagged], ignore_index=True)
    found = correspond(SENSOR, every, GRID, replace(SETTINGS, drop_flags=2))
    counts = found.counts
    assert counts[NO_NUMBER] == 5
    # one that is on a level but not at an end of a piece counts as flagged
    assert 4 <= counts[FLAGGED] <= 7
    assert counts[END] == 2 * (10 + 8)
    # every row is in the adjustment or in a count; ends and pairs are not rows
    lost = sum(n for what, n in counts.items() if what not in (LONELY, THICK))
    assert lost + len(found.rows) == len(every)
    on_level = int((found.level[len(points) : len(points) + 40] >= 0).sum())
    assert counts[OFF] + counts.get(SHORT, 0) + sum(n for k, n in counts.items() if k.startswith("ray")) == (
        40 - on_level
    )
    # a stray point within half a millimetre of a level may stay: 2 levels, 1 mm of some 250 mm each
    assert on_level <= 3


@pytest.mark.parametrize(
    ("seen", "wet", "words"),
    [
        ((39, 1), 66, ""),  # a single point of few
        ((98, 2), 100, ""),
        ((99, 1), 100, r"seen on 1 of 2 levels: 99 on grid .* none on floor"),
        ((40, 0), 40, r"seen on 1 of 2 levels: 40 on grid .* none on floor"),
        ((39, 1), 67, r"only 40 of 67 line points"),
    ],
)
def test_each_level_has_two_percent_of_the_points_and_one_at_least(seen, wet, words):
    level = np.repeat([0, 1, -1], [*seen, 5])
    names = [SimpleNamespace(name=name, depth_mm=9.0) for name in ("grid", "floor")]
    with pytest.raises(GeometryError, match=words) if words else nullcontext():
        _require_levels(level, [], wet, SimpleNamespace(name="g", levels=names))


def test_the_fan_angle_of_an_end_is_that_of_the_last_point_before_it():
    segments = [Segment(level=0, rows=np.array([4, 0, 1])), Segment(level=1, rows=np.array([2, 3]))]
    ends = SimpleNamespace(segment=np.array([1, 0, 0, 1]), side=np.array([1, -1, 1, -1]))
    assert _fan_of_pieces(np.arange(5.0) / 10, segments, ends).tolist() == [0.3, 0.4, 0.1, 0.2]


def test_a_thick_bar_drops_the_ends_that_its_lower_rim_shades():
    points = lines.line_points(SENSOR, GRID, every=2)
    thick = replace(GRID, thickness_mm=3.0)
    found = correspond(SENSOR, points, thick, SETTINGS)
    assert (
        found.counts[THICK] == 6
    )  # one end of each gap but that under the laser, where light falls straight
    assert len(found.pairs.side) == 14 - 6


def test_three_levels():
    grid = parse_grid(lines.THREE)
    points = lines.line_points(KNOWN, grid, every=2)
    found = fit_sheet(lines.off_start(KNOWN, 2), points, grid, SETTINGS)
    rows = found.correspondence.rows
    assert_array_equal(found.correspondence.level[rows], points["level"].to_numpy()[rows])
    assert set(found.problem.line.level.tolist()) == {0, 1, 2}
    assert found.misfit_px < 0.16  # the noise of 0.15 px
    assert np.abs(lines.place_in_sigmas(found, KNOWN)).max() < 4.0


def test_hidden_pieces_are_told_and_do_no_harm():
    points = lines.line_points(KNOWN, GRID, every=2)
    hidden = points[(points["level"] == 0) | (points["y_px"] < 1000.0)]
    found = fit_sheet(KNOWN, hidden, GRID, SETTINGS)
    assert any("hidden" in told for told in found.warnings)
    assert np.abs(lines.place_in_sigmas(found, KNOWN)).max() < 4.0


def test_points_without_columns_or_numbers_are_refused():
    points = lines.line_points(SENSOR, GRID, every=4)
    with pytest.raises(InputError, match="columns missing: sigma_px"):
        correspond(SENSOR, points.drop(columns="sigma_px"), GRID, SETTINGS)
    with pytest.raises(InputError, match=r"0 usable line points of 0.*Look at the picture"):
        correspond(SENSOR, points[:0], GRID, SETTINGS)
    with pytest.raises(InputError, match="flagged"):
        correspond(SENSOR, points.assign(flags=1), GRID, replace(SETTINGS, drop_flags=1))


def test_points_all_over_the_picture_are_no_line():
    points = lines.line_points(SENSOR, GRID, every=3)
    noise = points.assign(x_px=np.random.default_rng(1).uniform(0, 2048, len(points)))
    with pytest.raises(GeometryError, match="lie in pieces of line on the levels"):
        correspond(SENSOR, noise, GRID, SETTINGS, first=True)
