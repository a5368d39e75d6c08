"""What each filter left out: the data behind the panels."""

import numpy as np
import pandas as pd
import pytest

from thalweg.figures.cloud.removed import Across, removed_points
from thalweg.lidar import REMOVED, REMOVED_POINTS, WORDS, Reason
from thalweg.lidar.filters import reason_table
from thalweg.settings.sections import Filters

FILTERS = Filters().model_dump()
AZIMUTH_RAD = np.deg2rad(70.0)  # of the track in conftest


def world(along, left, up):
    """Points at metres along the straight axis of the track of conftest and left of it."""
    s, c = np.sin(AZIMUTH_RAD), np.cos(AZIMUTH_RAD)
    return np.stack(np.broadcast_arrays(along * s - left * c, along * c + left * s, up), axis=1)


def sample(rng, trajectory, n=200):
    """``n`` removed points of each reason, and the counts: ten times as many mirror ghosts were removed."""
    frames = []
    for reason in REMOVED:
        xyz = world(rng.uniform(10, 90, n), rng.choice([-1, 1], n) * rng.uniform(15, 40, n), 4.0)
        if reason in (Reason.BELOW_WATER, Reason.MIRROR_GHOST):
            xyz[:, 2] = rng.uniform(-4, 0.9, n)
        if reason in (Reason.NO_GPS_TIME, Reason.NO_POSE):
            xyz[:] = np.nan
        values = dict(zip(("east_m", "north_m", "up_m"), xyz.T, strict=True))
        body = rng.uniform([-0.5, -0.3, -0.1], [0.5, 0.3, 0.2], (n, 3))
        values |= dict(zip(("x_ics_m", "y_ics_m", "z_ics_m"), body.T, strict=True))
        t = np.full(n, np.nan) if reason == Reason.NO_GPS_TIME else trajectory.t_gps_s[155]
        frames.append(pd.DataFrame({"reason": reason.name.lower(), "t_gps_s": t, **values, "range_m": 1.0}))
    counts = np.full(len(Reason), n)
    counts[Reason.KEPT], counts[Reason.MIRROR_GHOST] = 100_000, 10 * n
    return pd.concat(frames)[list(REMOVED_POINTS.names)], reason_table(counts)


def panel(figure, name):
    (ax,) = [a for a in figure.axes if a.get_title("left").startswith(f"{name}: ")]
    return ax


def test_one_panel_for_each_reason_with_its_numbers(rng, trajectory, bank):
    removed, counts = sample(rng, trajectory)
    figure = removed_points(removed, counts, bank.points, trajectory, filters=FILTERS)
    titles = [ax.get_title("left") for ax in figure.axes if ax.get_title("left")]
    assert [t.split("\n")[1] for t in titles] == [WORDS[r] for r in REMOVED]
    # 200 of 103,600 points
    assert titles[0].startswith("no GPS time: n = 200, 0.19 %")
    ghosts = panel(figure, "mirror ghost")
    assert ghosts.get_title("left").startswith("mirror ghost: n = 2\N{NO-BREAK SPACE}000, 1.9 %")
    head = figure.get_suptitle().replace("\n", " ")
    assert "n = 3\N{NO-BREAK SPACE}600 of 103\N{NO-BREAK SPACE}600 points (3.5 %)" in head


def test_reasons_that_took_nothing_are_named_and_have_no_panel(rng, trajectory, bank):
    removed, counts = sample(rng, trajectory)
    few = counts[counts["reason"].isin(["kept", "isolated", "too_far", "below_water"])]
    figure = removed_points(removed, few, bank.points, trajectory)
    assert len([ax for ax in figure.axes if ax.axison]) == 3
    (legend,) = figure.legends
    assert legend.get_title().get_text() == (
        "Left out nothing: no GPS time, no pose, too near, own hull, uncertain, mirror ghost"
    )


def test_nothing_left_out_says_so(trajectory, bank):
    counts = reason_table(np.eye(len(Reason), dtype=int)[0] * 7)
    empty = pd.DataFrame({name: [] for name in REMOVED_POINTS.names})
    figure = removed_points(empty, counts, bank.points, trajectory)
    assert "n = 0 of 7 points" in figure.get_suptitle()
    assert figure.axes[0].texts[0].get_text() == "No filter left out a point."


def test_distance_and_height_across_the_river(trajectory):
    across = Across(trajectory, 0.2)
    points = world(np.array([70.7, 70.7]), np.array([30.0, -30.0]), np.array([1.3, 5.3]))
    left, right = across(points)
    track = trajectory.position_wcs_m[trajectory.valid, :2]
    nearest = np.linalg.norm(points[:, None, :2] - track, axis=2).min(axis=1)
    # a point each 0.5 m on a crest with a radius of 4 m: 0.25^2 (1/4 + 1/24) / 2 = 9 mm more at most
    assert left[0] == pytest.approx(-nearest[0], abs=0.01)
    assert right[0] == pytest.approx(nearest[1], abs=0.01)
    # the ics origin is at 1.5 m, the water line 0.2 m below it; heights are interpolated between equal ones
    assert left[1] == pytest.approx(0.0, abs=1e-12)
    assert right[1] == pytest.approx(4.0, abs=1e-12)
