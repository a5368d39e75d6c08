"""First looks: labels, n, what is drawn and what is left out."""

import numpy as np
import pytest

from thalweg.core import InputError
from thalweg.figures import save
from thalweg.figures.firstlook.first_look import (
    MAX_DOTS,
    attitude_first_look,
    depth_first_look,
    lidar_first_look,
    track_first_look,
)


def legend_labels(figure):
    return [t.get_text() for legend in figure.legends for t in legend.get_texts()]


def test_lidar_draws_all_finite_points(rng):
    points = rng.normal(0, 5, (500, 3))
    points[3] = np.nan
    ring = rng.integers(0, 16, 500)
    figure = lidar_first_look(points, rng.integers(0, 255, 500), ring)
    plan, side = figure.axes[:2]
    np.testing.assert_allclose(plan.collections[0].get_offsets(), np.delete(points, 3, axis=0)[:, :2])
    np.testing.assert_array_equal(side.collections[0].get_array(), np.delete(ring, 3))
    assert "n = 499 points" in figure.get_suptitle()
    assert plan.get_xlabel() == "x (right) / m"
    assert side.get_ylabel() == "z (up) / m"


def test_lidar_thins_and_says_so(rng):
    n = MAX_DOTS + 1
    figure = lidar_first_look(rng.normal(0, 5, (n, 3)), np.zeros(n), np.zeros(n))
    assert "1 of 2 drawn" in figure.get_suptitle()
    assert len(figure.axes[0].collections[0].get_offsets()) == -(-n // 2)


def test_track_is_relative_to_the_median(positions):
    figure = track_first_look(positions, twin=True)
    plan, up, sigma = figure.axes
    assert {"fixed, n = 377", "float, n = 20", "single, n = 3"} == set(legend_labels(figure))
    east = np.concatenate([line.get_xdata() for line in plan.lines])
    # The median of latitude and of longitude, in degrees, is that of north and east up to curvature.
    assert np.median(east) == pytest.approx(0.0, abs=1e-3)
    assert plan.get_ylabel() == "north of the median / m"
    assert up.get_ylabel() == "ellipsoidal height / m"
    assert [line.get_label() for line in sigma.lines] == ["east", "north", "up"]
    assert sigma.get_xlabel() == "time since 2017-05-12 18:44:55 UTC / s"


def test_track_without_time_height_or_sigma(tmp_path, positions):
    bare = positions.assign(
        t_gps_s=np.nan, h_ell_m=np.nan, sigma_east_m=np.nan, sigma_north_m=np.nan, sigma_up_m=np.nan
    )
    figure = track_first_look(bare)
    _, up, sigma = figure.axes
    assert up.get_title(loc="left") == "height unknown"
    assert sigma.get_title(loc="left") == "no sigma stated"
    assert sigma.get_xlabel() == "number of the epoch / 1 (no GPS time)"
    save(figure, tmp_path / "bare.png", dpi=60)


def test_attitude_lines_break_at_holes_and_wraps(states):
    figure = attitude_first_look(states)
    tilt, heading, _, fix = figure.axes
    roll = tilt.lines[0].get_ydata()
    assert np.isnan(roll).sum() == 1  # the hole of 50 s
    np.testing.assert_allclose(roll[:200], np.rad2deg(states["roll_rad"])[:200])
    # 14.95 rad in all: two wraps, one of them not in the hole of 50 s, and the hole itself.
    jumps = np.abs(np.diff(np.rad2deg(states["heading_rad"]))) > 180
    assert np.isnan(heading.lines[0].get_ydata()).sum() == (jumps | (np.arange(299) == 199)).sum()
    rows = [t.get_text() for t in fix.get_yticklabels()]
    assert rows == ["fixed, n = 250", "float, n = 50"]
    assert (tilt.get_ylabel(), heading.get_ylabel()) == ("angle / °", "heading / °")


def test_attitude_without_gps_time_says_so(tmp_path, states):
    figure = attitude_first_look(states.assign(t_gps_s=np.nan))
    assert "not GPS time" in figure.axes[-1].get_xlabel()
    save(attitude_first_look(states.iloc[:1]), tmp_path / "one.png", dpi=60)


def test_depth_axis_points_down_and_sentences_are_apart(depths):
    figure = depth_first_look(depths)
    (ax,) = figure.axes
    low, high = ax.get_ylim()
    assert low > high
    assert legend_labels(figure) == ["DBT, n = 30", "DPT, n = 30, offset +0.30 m"]
    np.testing.assert_allclose(ax.lines[0].get_ydata(), depths["depth_m"][1::2])
    assert ax.get_ylabel() == "depth / m (downwards)"


def test_depth_falls_back_to_time_of_day_and_line(depths):
    day = depths.assign(t_gps_s=np.nan, t_day_s=3600.0 * np.arange(60) / 60)
    assert "UTC of the day" in depth_first_look(day).axes[0].get_xlabel()
    line = depths.assign(t_gps_s=np.nan)
    assert depth_first_look(line).axes[0].get_xlabel() == "line of the log / 1 (no time)"


def test_nothing_to_look_at_is_refused(positions, states, depths):
    with pytest.raises(InputError, match="without a finite point"):
        lidar_first_look(np.full((3, 3), np.nan), np.zeros(3), np.zeros(3))
    with pytest.raises(InputError, match="no epoch with a position"):
        track_first_look(positions.iloc[:0])
    with pytest.raises(InputError, match="no INS state"):
        attitude_first_look(states.iloc[:0])
    with pytest.raises(InputError, match="no sounding"):
        depth_first_look(depths.iloc[:0])


def test_all_points_at_one_place(tmp_path):
    save(lidar_first_look(np.zeros((5, 3)), np.zeros(5), np.zeros(5)), tmp_path / "x.png", dpi=60)
    assert (tmp_path / "x.png").read_bytes().startswith(b"\x89PNG")
