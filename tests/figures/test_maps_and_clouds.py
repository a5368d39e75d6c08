"""Survey map, cloud overview and detail: the data behind the artists."""

import numpy as np
import pytest

from tests.figures.conftest import artists as by_gid
from thalweg.core import GeometryError
from thalweg.figures.cloud import Splat, choose_segment, cloud_overview
from thalweg.figures.cloud.overview import cloud_detail
from thalweg.figures.cloud.views import BankSegment, ObliqueView, bankward_azimuth
from thalweg.figures.survey import track_gaps
from thalweg.figures.survey.maps import survey_map


def legend_labels(figure):
    return [t.get_text() for legend in figure.legends for t in legend.get_texts()]


def test_gaps_stay_blank_and_are_counted(trajectory):
    assert track_gaps(trajectory) == [
        (pytest.approx(trajectory.t_gps_s[149]), pytest.approx(1.1, abs=1e-6))  # nodes 149 and 160 at 10 Hz
    ]
    assert "ends of 1 gap, 1.1 s without a pose" in legend_labels(survey_map(trajectory))


def test_fixes_are_marked_where_the_antenna_was(trajectory, positions):
    figure = survey_map(trajectory, positions)
    labels = legend_labels(figure)
    assert {"fixed, n = 377 epochs", "float, n = 20 epochs", "single, n = 3 epochs"} <= set(labels)


def test_positions_of_another_day_are_left_out(trajectory, positions):
    positions["t_gps_s"] += 86_400.0
    assert not any("epochs" in label for label in legend_labels(survey_map(trajectory, positions)))


def test_scale_bar_has_the_length_it_says(trajectory):
    figure = survey_map(trajectory)
    ax = figure.axes[0]
    (bar,), (text,) = by_gid(figure, "scale-bar"), by_gid(figure, "scale-text")
    width = np.ptp(ax.get_xlim()) * np.ptp(bar.get_xdata())
    assert f"{width:g} m" == text.get_text()


def test_overview_states_what_it_shows(trajectory, bank):
    splat = Splat(ObliqueView.fit(bank.points))
    splat.add(bank.points, bank.points[:, 2])
    splat.add(np.full((10, 3), 1e5), np.zeros(10))  # beyond the picture
    figure = cloud_overview(splat, trajectory)
    assert f"n = {splat.n_drawn:,}".replace(",", "\N{NO-BREAK SPACE}") in figure.get_suptitle()
    assert "of 40\N{NO-BREAK SPACE}010 points" in figure.get_suptitle()


def test_segment_is_the_densest_and_is_seen_from_the_water(trajectory, bank):
    segment = choose_segment(bank.points, trajectory)
    s, c = np.sin(np.deg2rad(70.0)), np.cos(np.deg2rad(70.0))
    along, across = segment.centre_en_m @ [s, c], segment.centre_en_m @ [-c, s]
    assert along == pytest.approx(bank.middle_along_m, abs=2.0)  # cells of 1 m, window of 14 m
    assert 9.0 < across < 15.0
    turned = (segment.azimuth_rad - bank.azimuth_rad + np.pi) % (2 * np.pi) - np.pi
    # The zigzag of +-6 m over a stretch of about 56 m does not average out exactly.
    assert abs(turned) < np.deg2rad(12.0)
    inside = segment.contains(bank.points)
    assert inside[:20_000].mean() > 0.75
    assert inside[20_000:].mean() < 0.2


def test_the_side_with_the_taller_things_stands_behind(trajectory, bank):
    """Seen from their side, trees would hide the slope below them."""
    s, c = np.sin(np.deg2rad(70.0)), np.cos(np.deg2rad(70.0))
    left, right = np.array([-c, s]), np.array([c, -s])  # seen along the track
    for tall, flat in ((left, right), (right, left)):
        along = np.linspace(0, 100, 4000)[:, None] * np.array([s, c])
        trees = np.column_stack([along + 20.0 * tall, np.tile([2.0, 18.0], 2000)])
        # More points on the flat side: they alone would turn the view.
        low = np.tile(np.column_stack([along + 12.0 * flat, np.full(4000, 0.5)]), (3, 1))
        azimuth = bankward_azimuth(np.concatenate([trees, low]), trajectory)
        assert np.array([np.sin(azimuth), np.cos(azimuth)]) @ tall > 0.9


@pytest.mark.parametrize("away_m", [1.2, 60.0])
def test_a_room_and_a_wide_river_have_a_view_too(trajectory, away_m):
    """Nothing lies 2 to 25 m beside the track."""
    track = trajectory.position_wcs_m[trajectory.valid]
    heading = track[-1, :2] - track[0, :2]
    left = np.array([-heading[1], heading[0]]) / np.linalg.norm(heading)
    steps = np.array([[*(away_m * left), z] for z in np.arange(-0.5, 2.5, 0.25)])
    wall = (track[:, None] + steps).reshape(-1, 3)
    segment = choose_segment(wall, trajectory)
    view = np.array([np.sin(segment.azimuth_rad), np.cos(segment.azimuth_rad)])
    assert view @ left > 0.9
    nearest = np.linalg.norm(track[:, :2] - segment.centre_en_m, axis=1).min()
    assert nearest == pytest.approx(away_m, abs=4.0)  # the track swings by 6 m


def test_no_bank_in_reach_is_refused(trajectory):
    with pytest.raises(GeometryError, match=r"no point lies within 400 m of the track.*mount"):
        choose_segment(np.tile([5000.0, 0.0, 500.0], (5, 1)), trajectory)


def test_detail_by_intensity_names_its_percentiles(bank):
    segment = BankSegment(
        centre_en_m=bank.points[:20_000, :2].mean(axis=0), azimuth_rad=bank.azimuth_rad, length_m=14.0
    )
    figure = cloud_detail(bank.points, bank.intensity, segment=segment, percentiles=(5.0, 95.0), width_px=300)
    assert figure.axes[1].get_ylabel() == "intensity   (5 to 95 %)"
    low, high = np.percentile(bank.intensity[segment.contains(bank.points)], [5, 95])
    assert figure.axes[1].get_ylim() == (pytest.approx(low), pytest.approx(high))


def test_detail_in_colour_above_and_by_intensity_below(bank):
    segment = BankSegment(
        centre_en_m=bank.points[:20_000, :2].mean(axis=0), azimuth_rad=bank.azimuth_rad, length_m=14.0
    )
    rgb = np.tile(np.array([[10, 200, 33]], np.uint8), (len(bank.points), 1))
    figure = cloud_detail(bank.points, bank.intensity, segment=segment, rgb=rgb, width_px=300)
    above, below = figure.axes[:2]
    shown = np.asarray(above.images[0].get_array()).reshape(-1, 3)
    drawn = shown[(shown != 255).any(axis=1)].astype(float)
    # shaded at edges, never another hue
    assert len(drawn) > 1000
    assert np.abs(drawn / drawn[:, 1:2] - np.array([10, 200, 33]) / 200).max() < 0.02
    assert np.ptp(np.asarray(below.images[0].get_array()).reshape(-1, 3).astype(int), axis=0).max() > 100
