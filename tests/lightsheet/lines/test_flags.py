"""Saturated markers, edges of the albedo, jumps, several lines; counts of what was dropped."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.lightsheet.laser_images import grey_values, mean_line_intensity, one_sided_halo
from thalweg.core import read_table, write_table
from thalweg.lightsheet.lines import (
    LINE_POINTS,
    LineFlag,
    LineSettings,
    detect_lines,
    pooled_shift,
    without_shift,
)
from thalweg.lightsheet.lines.albedo import WidthShift, albedo_edges, width_shift
from thalweg.lightsheet.lines.detect import heights, patch_heights
from thalweg_lab.random_numbers import generator

ROWS = np.arange(1024)
MARKERS = np.where((ROWS // 60) % 3 == 0, 20.0, 1.0)
"""White markers of 60 rows on black, 20 times as bright (0.9 on 0.045)."""


def complete(points):
    """Whether every candidate is a point or counted by a reason."""
    dropped = sum(n for name, n in points.counts.items() if name not in ("candidates", "points"))
    return points.counts["candidates"] == len(points) + dropped


def bimodal_px(points, centre_px):
    """Difference between the medians of the errors on markers and beside them, far from edges."""
    error = points.x_px - np.interp(points.y_px, ROWS + 0.5, centre_px)
    white = MARKERS[points.y_px.astype(int)] > 1
    clean = ~points.has(LineFlag.ALBEDO_EDGE)
    return float(np.median(error[white & clean]) - np.median(error[~white & clean]))


# ---------------------------------------------------------------- albedo


@pytest.mark.parametrize("seed", [1, 2])
def test_a_halo_on_white_markers_shifts_and_is_taken_out(picture, seed):
    """P4 7.2, Fig. 16: over-exposed markers pull the line to one side, the distances become bi-modal."""
    made = picture(
        80 + 0.02 * (ROWS - 512),
        seed=seed,
        width=160,
        half_width_px=4.0,
        peak_dn=40.0,
        brightness=MARKERS,
        change=lambda light: one_sided_halo(light, share=0.1, length_px=6.0),
    )
    raw = detect_lines(made.image, LineSettings(correct_albedo=False))
    corrected = detect_lines(made.image)
    corrected = without_shift(corrected, pooled_shift([corrected.facts]))
    # 0.7 px as it is; the patches' scatter leaves 0.02 px to the difference of the medians
    assert bimodal_px(raw, made.centre_px) < -0.4
    assert abs(bimodal_px(corrected, made.centre_px)) < 0.08
    assert made.errors(corrected)[0].std() < 0.1 < made.errors(raw)[0].std()
    # the halo's length is one of three, in steps of two; it lies on the left
    assert -12.0 < corrected.facts["halo_px"] < -3.0
    assert raw.facts["halo_px"] == 0.0


def test_edges_of_the_albedo_and_saturation_are_flagged_where_they_are(picture):
    """Without a halo none is found, and nothing is taken out; even brightness has no edges."""
    made = picture(width=160, half_width_px=4.0, peak_dn=40.0, brightness=MARKERS)
    points = detect_lines(made.image)
    assert points.facts["halo_px"] == 0.0
    assert not pooled_shift([points.facts]).applied
    assert abs(bimodal_px(points, made.centre_px)) < 0.05
    edges = np.flatnonzero(np.diff(MARKERS)) + 1.0
    away = np.abs(points.y_px[:, None] - edges).min(axis=1)
    flagged = points.has(LineFlag.ALBEDO_EDGE)
    assert flagged[away < 2].all()
    assert not flagged[away > 25].any()  # half of the largest patch, and a row or two for finding the edge
    white = MARKERS[points.y_px.astype(int)] > 1
    saturated = points.has(LineFlag.SATURATED)
    assert saturated[white & (away > 11)].mean() > 0.95
    assert saturated[~white & (away > 11)].mean() < 0.05
    assert points.facts["albedo_edges"] == pytest.approx(edges.size, abs=1)
    assert complete(points)
    assert not detect_lines(picture(seed=4).image).has(LineFlag.ALBEDO_EDGE).any()


def test_a_known_shift_with_the_width_is_removed():
    rng = generator(1, "shift")
    n = 600
    white = (np.arange(n) // 50) % 2 == 1
    width = np.where(white, 8.0, 4.0) + 0.05 * rng.standard_normal(n)
    sigma = np.full(n, 0.1)
    x = 100 + 0.05 * np.arange(n) - 0.2 * (width - 4.0) * white + sigma * rng.standard_normal(n)
    piece = np.zeros(n, np.int64)
    edges = np.arange(50, n, 50)
    shift = width_shift(x, width, sigma, white, piece, edges, np.ones(n, np.int64))
    corrected = x - shift.coefficient * np.where(white, width - shift.usual_width_px, 0.0)
    assert shift.applied
    assert shift.coefficient == pytest.approx(-0.2, abs=4 * shift.sigma)
    assert 0.005 < shift.sigma < 0.03  # 11 edges of 4 px and lines through 6 + 6 rows: 0.02 / sqrt(4)
    straight = corrected - 100 - 0.05 * np.arange(n)
    assert abs(straight[white].mean() - straight[~white].mean()) < 0.1
    # nothing to learn from: too few edges
    few = width_shift(x, width, sigma, white, piece, edges[:2], np.ones(n, np.int64))
    assert (few.coefficient, few.edges, few.applied) == (0.0, 2, False)
    assert np.isnan(few.sigma)
    assert few.usual_width_px == shift.usual_width_px


def test_an_edge_is_no_speckle_and_no_new_piece():
    piece = np.repeat([0, 1], 100)
    peak = np.where(np.arange(200) < 100, 50.0, 150.0) * np.exp(
        0.2 * generator(2, "peaks").standard_normal(200)
    )
    rows = np.full(200, 9)
    near, edges = albedo_edges(piece, peak, rows)
    assert edges.size == 0  # the brightness changes with the piece
    near, edges = albedo_edges(np.zeros(200, np.int64), peak, rows)
    assert edges.size == 1
    assert abs(int(edges[0]) - 100) <= 1
    assert near[98:102].all()
    assert near.sum() < 16


# ---------------------------------------------------------------- jumps and several lines


def test_a_jump_ends_a_piece_and_its_neighbours_are_flagged(picture):
    rows = np.arange(600)
    made = picture(np.where(rows < 300, 40.0, 75.0), width=120)
    points = detect_lines(made.image)
    near = points.has(LineFlag.NEAR_JUMP)
    away = np.abs(points.y_px - 300)
    assert set(points.piece) == {0, 1}
    assert near[away < 3].all()
    assert not near[away > 15].any()
    assert not near[(points.y_px < 10) | (points.y_px > 590)].any()  # the image ends there, not the line
    error = points.x_px - made.centre_px[points.y_px.astype(int)]
    assert np.abs(error[~near]).max() < 0.5
    assert complete(points)


@pytest.mark.parametrize("settings", [LineSettings(lines=5), LineSettings(lines=5, method="lsm")])
def test_several_lines_each_as_good_as_one(settings):
    rng = generator(1, "noise")
    y = np.arange(300)
    centres = [40 + 30 * k + 8 * np.sin(y / 60 + k) for k in range(5)]
    light = sum(mean_line_intensity(c, 220, 3) for c in centres)
    points = detect_lines(grey_values(light, rng), settings)
    assert (points.line == -1).all()  # which is which is another step
    assert np.bincount(points.piece).tolist() == [300] * 5
    assert complete(points)
    nearest = np.array([c[points.y_px.astype(int)] for c in centres])
    error = np.abs(points.x_px - nearest).min(axis=0)
    # at the image's border a patch without shear sees one side only: 3.5 rows of slope 0.13
    assert error[(points.y_px > 8) & (points.y_px < 292)].max() < 0.3
    # asked for one line, each row gives one point
    one = detect_lines(grey_values(light, rng))
    assert np.bincount(one.y_px.astype(int)).max() == 1
    assert one.counts["beside_the_strongest"] > 0
    assert complete(one)


def test_rows_or_columns_by_itself():
    y = np.arange(200)
    light = mean_line_intensity(100 + 0.7 * (y - 100), 200, 4)
    down = grey_values(light, generator(1, "noise"))
    assert (detect_lines(down).angle_rad == 0).all()
    right = detect_lines(down.T.copy())
    assert (right.angle_rad == np.pi / 2).all()
    assert_array_equal(right.y_px, detect_lines(down).x_px)
    forced = detect_lines(down, LineSettings(across="columns", largest_rows=5))
    assert np.abs(forced.y_px - (100.5 + (forced.x_px - 100) / 0.7))[20:-20].max() < 0.4


def test_the_table_is_of_its_kind(picture, tmp_path):
    points = detect_lines(picture(rows=64).image)
    write_table(tmp_path / "points.parquet", points.to_frame(), LINE_POINTS)
    back, _ = read_table(tmp_path / "points.parquet", LINE_POINTS)
    assert_array_equal(back["x_px"], points.x_px)
    some = points.where(points.y_px > 32)
    assert len(some) == 32
    assert some.counts == points.counts


# ---------------------------------------------------------------- height of patches


def test_heights_grow_to_the_largest():
    assert heights(21) == [1, 3, 5, 7, 11, 17, 21]
    assert heights(1) == [1]
    assert heights(9) == [1, 3, 5, 7, 9]


def chosen(row, x, largest):
    """Heights of patches and their bias for rows of one piece with a sigma of 0.2 px."""
    n, white = len(row), np.array([1.0, 0, 0])
    return patch_heights(row, x, np.full(n, 0.2), np.zeros(n, np.int64), white, largest)


@pytest.mark.parametrize(("bend_rows", "least", "most"), [(1e9, 13, 21), (9.0, 3, 11), (4.0, 1, 5)])
def test_the_height_follows_the_surface(bend_rows, least, most):
    """Waves of 1.5 px, rows with 0.2 px; over h rows of a wave of length 2 pi L a line loses ~ h^2 / L^2."""
    row = np.arange(1000)
    x = 50 + 1.5 * np.sin(row / bend_rows) + 0.2 * generator(3, "rows").standard_normal(1000)
    height, bias = chosen(row, x, 21)
    assert least <= np.median(height) <= most
    assert (height % 2 == 1).all()
    assert np.median(bias) < 0.1


def test_rows_without_a_place_do_no_harm():
    row = np.r_[np.arange(100), np.arange(104, 200)]
    x = 50 + 0.1 * row + 0.2 * generator(3, "rows").standard_normal(row.size)
    x[50:60] = np.nan
    height, bias = chosen(row, x, 15)
    assert np.isfinite(bias).all()
    assert np.median(height) >= 7


# ---------------------------------------------------------------- shift of a series, by hand


def test_the_shift_of_a_series_is_a_weighted_mean_with_its_scatter():
    def image(k, sigma, edges):
        return {"width_shift": k, "sigma_width_shift": sigma, "width_shift_edges": edges}

    # weights 100 and 25: mean (10 - 2.5) / 125; chi-square 100 * 0.04^2 + 25 * 0.16^2 = 0.8 below its freedom
    calm = pooled_shift([image(0.10, 0.1, 5), image(-0.10, 0.2, 7), image(9.0, float("nan"), 3), {}])
    assert calm.coefficient == pytest.approx(0.06)
    assert calm.sigma == pytest.approx(1 / np.sqrt(125))
    assert calm.edges == 12
    assert not calm.applied
    # ten times as far apart: chi-square 80 with one degree of freedom
    apart = pooled_shift([image(1.0, 0.1, 5), image(-1.0, 0.2, 7)])
    assert apart.coefficient == pytest.approx(0.6)
    assert apart.sigma == pytest.approx(np.sqrt(80 / 125))
    assert not apart.applied
    # four sigmas are needed
    assert pooled_shift([image(-0.41, 0.1, 5)]).applied
    assert not pooled_shift([image(-0.39, 0.1, 5)]).applied
    none = pooled_shift([])
    assert (none.coefficient, none.edges, none.applied) == (0.0, 0, False)


def test_the_shift_of_a_series_goes_along_the_direction_of_measurement(picture):
    raw = detect_lines(picture(rows=64).image, LineSettings())
    wide = np.full(len(raw), 6.0)
    flags = np.where(np.arange(len(raw)) % 2, int(LineFlag.SATURATED), 0).astype(raw.flags.dtype)
    points = replace(
        raw,
        width_px=wide,
        flags=flags,
        angle_rad=np.full(len(raw), np.deg2rad(30.0)),
        facts=raw.facts | {"width_unsaturated_px": 4.0},
    )
    shift = WidthShift(0.5, 0.1, 9, True)
    out = without_shift(points, shift)
    odd = points.has(LineFlag.SATURATED)
    # 2 px wider than usual, 0.5 px per pixel, along the row: -1 px in x, -tan(30 degrees) in y
    assert_allclose((out.x_px - points.x_px)[odd], -1.0)
    assert_allclose((out.y_px - points.y_px)[odd], -np.tan(np.deg2rad(30.0)))
    assert_allclose(out.sigma_px[odd], np.hypot(points.sigma_px[odd], 0.2))
    same = ["x_px", "y_px", "sigma_px"]
    assert out.to_frame()[~odd][same].equals(points.to_frame()[~odd][same])
    facts = (out.facts["width_shift"], out.facts["sigma_width_shift"], out.facts["width_shift_applied"])
    assert facts == (0.5, 0.1, 1.0)
    assert without_shift(out, shift) is out
    assert without_shift(points, replace(shift, applied=False)) is points
