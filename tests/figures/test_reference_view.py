"""The terrestrial scan in equal angles: geometry of the view, choice of the viewpoint, what is drawn."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from thalweg.figures.accuracy.reference_view import EYE_M, PanoramaView, reference_view, viewpoint_on_track
from thalweg.figures.cloud import Splat


def view_at(viewpoint=(0.0, 0.0, 0.0), left_deg=350.0, top_deg=10.0, pixel_deg=1.0, width=40, height=20):
    return PanoramaView(
        viewpoint_wcs_m=np.array(viewpoint),
        left_rad=np.deg2rad(left_deg),
        top_rad=np.deg2rad(top_deg),
        pixel_rad=np.deg2rad(pixel_deg),
        width_px=width,
        height_px=height,
        distance_m=20.0,
    )


def test_columns_run_on_across_north():
    """Azimuths 355, 5 and 15 degrees in a view that begins at 350."""
    a = np.deg2rad([355.0, 5.0, 15.0])
    points = 10.0 * np.stack([np.sin(a), np.cos(a), np.zeros(3)], axis=1)
    column, row, depth = view_at().project(points).T
    assert_allclose(column, [5.0, 15.0, 25.0])
    assert_allclose(row, 10.0)
    assert_allclose(depth, 10.0)
    assert view_at().extent_deg == pytest.approx((350.0, 390.0, -10.0, 10.0))


def test_fit_holds_a_wall_and_is_centred_on_it(rng):
    wall = np.stack([rng.uniform(-12, 12, 5000), np.full(5000, 20.0), rng.uniform(-2, 9, 5000)], axis=1)
    view = PanoramaView.fit(wall, np.zeros(3), width_px=400)
    column, row, _ = view.project(wall).T
    inside = (column >= 0) & (column < 400) & (row >= 0) & (row < view.height_px)
    assert inside.mean() > 0.95  # keep = 0.97 across, 0.996 in height
    left, right, low, high = view.extent_deg
    half = np.rad2deg(np.arctan2(12, 20))
    assert left - 360 == pytest.approx(-half, abs=1.5)
    assert right - 360 == pytest.approx(half, abs=1.5)
    assert (high - low) / (right - left) == pytest.approx(view.height_px / 400)


def test_a_long_low_bank_is_cut_to_a_shape_that_can_be_read(rng):
    bank = np.stack(
        [rng.uniform(-300, 300, 20_000), np.full(20_000, 20.0), rng.uniform(0, 4, 20_000)], axis=1
    )
    eye = np.array([0.0, 0.0, 2.0])
    view = PanoramaView.fit(bank, eye, azimuth_rad=np.deg2rad(5.0), width_px=1000)
    left, right, low, high = view.extent_deg
    assert right - left == pytest.approx(40.0, abs=25.0)
    assert (high - low) / (right - left) > 0.13
    assert (left + right) / 2 - 360 == pytest.approx(5.0)
    # Without a direction: where most of the points are, which is somewhere along the bank.
    assert PanoramaView.fit(bank, eye, width_px=1000).height_px > 130


def test_the_viewpoint_is_on_the_track_opposite_the_densest_bank(trajectory, bank):
    eye, azimuth_rad = viewpoint_on_track(bank.points, trajectory)
    track = trajectory.position_wcs_m[trajectory.valid]
    assert np.min(np.linalg.norm(track + np.array([0, 0, EYE_M]) - eye, axis=1)) < 1e-9
    s, c = np.sin(np.deg2rad(70.0)), np.cos(np.deg2rad(70.0))
    along, across = eye[:2] @ [s, c], eye[:2] @ [-c, s]
    # Stretch of 30 m; the bank lies at +9 to +15 m, the track swings between -6 and +6 m.
    assert along == pytest.approx(bank.middle_along_m, abs=16.0)
    assert across < -3.0
    # The zigzag over a stretch of about 90 m does not average out exactly.
    turned = (azimuth_rad - bank.azimuth_rad + np.pi) % (2 * np.pi) - np.pi
    assert abs(turned) < np.deg2rad(12.0)


@pytest.fixture
def scanned(trajectory, bank):
    source = 1 + (np.arange(len(bank.points)) % 3)
    view = PanoramaView.fit(bank.points, viewpoint_on_track(bank.points, trajectory)[0], width_px=300)
    splat = Splat(view)
    splat.add(bank.points[source == 2], bank.intensity[source == 2])
    return splat, source


def test_figure_names_the_scan_and_counts_its_points(trajectory, bank, scanned):
    splat, source = scanned
    figure = reference_view(
        splat,
        bank.points,
        source,
        trajectory,
        shown=2,
        names={1: "a", 2: "tls_2", 3: "c"},
        counts={1: 10, 2: 20, 3: 30},
        title="Test",
        twin=True,
    )
    n = f"{splat.n_drawn:,}".replace(",", "\N{NO-BREAK SPACE}")
    title = figure.get_suptitle().replace("\n", " ")
    assert f"scan tls_2, n = {n} of 13\N{NO-BREAK SPACE}333 points" in title
    labels = [t.get_text() for legend in figure.legends for t in legend.get_texts()]
    assert {"scan a, n = 10", "scan tls_2, n = 20", "scan c, n = 30", "track of the boat"} <= set(labels)
