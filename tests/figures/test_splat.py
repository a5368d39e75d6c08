"""The renderer against a slow, clear one, and against closed forms."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from thalweg.core import GeometryError
from thalweg.figures.cloud import Splat
from thalweg.figures.cloud.views import DEPTH_STEP_M, EDL_CAP, ObliqueView, eye_dome, view_axes


def view_of(width=40, height=30, azimuth=0.4, elevation=0.7):
    return ObliqueView(
        azimuth_rad=azimuth,
        elevation_rad=elevation,
        left_m=-10.0,
        top_m=7.5,
        pixel_m=0.5,
        width_px=width,
        height_px=height,
    )


def slow_buffers(view, points, values, radius):
    """Every point by itself: a square around its pixel, kept where it is the nearest so far."""
    s, c = np.sin(view.azimuth_rad), np.cos(view.azimuth_rad)
    se, ce = np.sin(view.elevation_rad), np.cos(view.elevation_rad)
    depth = np.full((view.height_px, view.width_px), np.inf)
    shown = np.full(depth.shape, np.nan)
    for (e, n, u), value in zip(points, values, strict=True):
        column = int(np.floor((e * c - n * s - view.left_m) / view.pixel_m))
        row = int(np.floor((view.top_m - (e * s * se + n * c * se + u * ce)) / view.pixel_m))
        away = e * s * ce + n * c * ce - u * se
        if not (0 <= column < view.width_px and 0 <= row < view.height_px):
            continue
        for y in range(max(0, row - radius), min(view.height_px, row + radius + 1)):
            for x in range(max(0, column - radius), min(view.width_px, column + radius + 1)):
                if away < depth[y, x]:
                    depth[y, x], shown[y, x] = away, value
    return np.where(np.isinf(depth), np.nan, depth), shown


@pytest.mark.parametrize("radius", [0, 1, 3])
def test_agrees_with_the_slow_renderer(rng, radius):
    view = view_of()
    points = rng.normal(0, 6, (1500, 3))
    values = rng.normal(0, 1, 1500).astype(np.float32)  # stored as float32
    splat = Splat(view)
    splat.add(points, values)
    depth, shown = splat.buffers(radius)
    slow_depth, slow_shown = slow_buffers(view, points, values, radius)
    # Half a step of the z-buffer.
    assert_allclose(depth, slow_depth, atol=0.5 * DEPTH_STEP_M + 1e-9)
    # Points nearer than a step to each other may hide one another either way.
    different = ~np.isclose(shown, slow_shown, rtol=0, atol=0, equal_nan=True)
    assert different.mean() < 0.005
    assert splat.n_added == 1500
    assert 0 < splat.n_drawn < 1500


def test_chunks_and_order_do_not_matter(rng):
    points, values = rng.normal(0, 5, (5000, 3)), rng.normal(0, 1, 5000)
    whole, pieces = Splat(view_of()), Splat(view_of())
    whole.add(points, values)
    order = rng.permutation(5000)
    for part in np.array_split(order, 7):
        pieces.add(points[part], values[part])
    for a, b in zip(whole.buffers(1), pieces.buffers(1), strict=True):
        assert_array_equal(a, b)


@pytest.mark.parametrize("azimuth", [0.0, 1.0, 4.0])
@pytest.mark.parametrize("elevation", [0.0, 0.6, np.pi / 2])
def test_view_axes_are_a_rotation(azimuth, elevation):
    axes = view_axes(azimuth, elevation)
    assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)
    # Right, up and away form a left-handed set, as a picture with depth does.
    assert np.linalg.det(axes) == pytest.approx(-1.0)


def test_fit_holds_the_cloud_and_looks_across_it(rng):
    along = rng.uniform(-50, 50, 4000)
    points = np.stack([along, 0.2 * along + rng.normal(0, 2, 4000), rng.uniform(0, 3, 4000)], axis=1)
    points[0] = [0.0, 5000.0, 0.0]  # one stray must not shrink the rest
    view = ObliqueView.fit(points, width_px=500)
    splat = Splat(view)
    splat.add(points, points[:, 2])
    assert splat.n_drawn > 0.98 * 4000  # keep = 0.998 along each of two axes
    # Axis of the cloud at atan2(1, 0.2) from north; the view is 90 degrees off, towards north.
    assert view.azimuth_rad == pytest.approx(np.arctan2(1, 0.2) - np.pi / 2, abs=0.02)  # 1 / sqrt(n) scatter
    assert 100.0 < view.width_px * view.pixel_m < 112.0


def test_shading_is_zero_on_a_slope_and_dark_behind_an_edge():
    y, x = np.mgrid[0:40, 0:40].astype(np.float64)
    slope = 5.0 + 0.3 * x + 0.9 * y
    assert np.max(np.abs(eye_dome(slope, 0.5)[8:-8, 8:-8])) < 1e-12
    step = np.where(x < 20, 1.0, 9.0)
    shade = eye_dome(step, 0.5)
    # Three of four pairs reach across the edge, at each radius up to the cap.
    assert shade[20, 20] == pytest.approx(0.75 * EDL_CAP)
    assert shade[20, 10] == 0.0
    assert np.all(shade[:, :20] == 0.0)  # the near side stays light


def test_points_with_nan_are_counted_not_drawn():
    splat = Splat(view_of())
    splat.add(np.array([[0.0, np.nan, 0.0], [0.0, 0.0, 0.0]]), np.array([1.0, 1.0]))
    assert (splat.n_added, splat.n_drawn) == (2, 1)


def test_sparse_clouds_get_larger_points(rng):
    radii = []
    for n in (300, 3000, 300_000):
        splat = Splat(view_of(width=200, height=150))
        splat.add(rng.uniform([-20, -20, 0], [80, 80, 0], (n, 3)), np.zeros(n))
        radii.append(splat.radius_px())
    assert radii == sorted(radii, reverse=True)
    assert radii[0] > radii[-1] == 1


def test_a_view_of_nothing_is_refused():
    with pytest.raises(GeometryError, match="without a finite point"):
        ObliqueView.fit(np.full((4, 3), np.nan))
