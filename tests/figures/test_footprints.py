"""Footprints of the lidar: their true size and shape, and where the detail lies."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from thalweg.figures.cloud.footprints import best_moment, choose_patch, footprint_ellipses, footprints


@pytest.fixture
def frame():
    """A wall 30 m north of the scanner, 40 m wide, and one 12 m south of it with twice as many points."""
    east, up = (a.ravel() for a in np.meshgrid(np.linspace(-20, 20, 81), np.linspace(0, 4, 21)))
    wall = np.stack([east, np.full(east.size, 30.0), up], axis=1)
    near = np.tile(wall * [1, 0, 1] + [0, -12.0, 0], (2, 1))
    points = np.concatenate([near, wall])
    return points, np.tile([0.0, 0.0, 1.0], (len(points), 1))


def test_the_patch_lies_at_the_distance_asked_for(frame):
    patch = choose_patch(*frame, distance_m=30.0)
    assert patch.centre_wcs_m[1] == pytest.approx(30.0)
    assert patch.range_m == pytest.approx(30.0, abs=2.0)  # one class of distances
    assert choose_patch(*frame, distance_m=12.0).centre_wcs_m[1] == pytest.approx(-12.0)
    # Nothing lies at 200 m: the farthest there is stands in.
    assert choose_patch(*frame, distance_m=200.0).range_m > 30.0


def test_the_patch_is_seen_along_its_beams(frame):
    patch = choose_patch(*frame)
    axes = np.stack([patch.right, patch.up, patch.away])
    assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert patch.right[2] == 0.0
    assert patch.right[0] > 0.9  # looking north, east is to the right
    assert patch.up[2] > 0.9
    place = patch.project(frame[0][patch.inside])
    assert np.abs(place).max() <= 1.5
    # The grid of 0.5 x 0.2 m: 6 to 7 columns and 15 to 16 rows on 3 x 3 m.
    assert 80 <= patch.inside.sum() <= 120
    assert not patch.inside[: 2 * 81 * 21].any()


def test_an_ellipse_is_the_shadow_of_the_circle_across_its_beam(frame, rng):
    """A circle across an oblique beam, cast point by point onto the plane of the patch."""
    patch = choose_patch(*frame)
    beam = 25.0 * (patch.away + 0.5 * patch.right + 0.3 * patch.up) / np.linalg.norm([1.0, 0.5, 0.3])
    a, b = np.linalg.svd(beam[None] / 25.0)[2][1:]
    turn = np.linspace(0, 2 * np.pi, 200)[:, None]
    circle = 0.5 * 0.003 * 25.0 * (np.cos(turn) * a + np.sin(turn) * b)
    u, v = circle @ patch.right, circle @ patch.up
    (width,), (height,), (angle,) = footprint_ellipses(beam[None], patch, divergence_mrad=3.0)
    c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    on = ((u * c + v * s) / (0.5 * width)) ** 2 + ((-u * s + v * c) / (0.5 * height)) ** 2
    assert_allclose(on, 1.0, atol=1e-9)


def test_figure_draws_every_footprint_to_scale(frame, tmp_path):
    figure = footprints(*frame, divergence_mrad=3.0, title="Test", twin=True)
    patch = choose_patch(*frame)
    assert "3 mrad · 30.0 m = 9.0 cm; TLS spot 0.9 cm" in figure.axes[1].get_title(loc="left")
    assert f"n = {patch.inside.sum()}" in figure.axes[1].get_title(loc="left")


def test_the_moment_is_that_with_most_points_near_the_distance():
    t = 100.0 + np.array([0.05, 0.06, 0.31, 0.32, 0.33, 0.55, 0.56, 0.57, 0.58])
    r = np.array([30.0, 30.0, 29.0, 31.0, 30.0, 5.0, 5.0, 5.0, 5.0])
    # Revolutions are counted from the first point, at 100.05.
    assert best_moment(t, r) == pytest.approx(100.25)
    # Without a point near 30 m the nearest there is.
    assert best_moment(t[5:], r[5:]) == pytest.approx(100.55)
