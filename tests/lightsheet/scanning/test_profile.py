"""Points of a profile: their covariance is that of many simulated measurements; bad input is named."""

import numpy as np
import pandas as pd
import pytest

from thalweg.core import InputError
from thalweg.lightsheet.optics import paper_4, project, sheet_in_water
from thalweg.lightsheet.poses import factor
from thalweg.lightsheet.poses.poses import compressed
from thalweg.lightsheet.scanning import joined_counts, profile, profiles
from thalweg.lightsheet.scanning.profile import independent_share


def places(sensor):
    """Pixels (5, 2) of points at 60 to 190 mm."""
    k = np.arange(5)
    return project(sensor, sheet_in_water(sensor, np.linspace(60, 190, 5), np.linspace(-0.25, 0.25, 5))[k, k])


def test_covariance_is_that_of_repeated_measurements(points_at, rng):
    sensor = paper_4()
    xy = places(sensor)
    one = profile(sensor, points_at(xy, 0.3, angle_rad=0.4))
    along = np.array([np.cos(0.4), np.sin(0.4)])
    root = factor(sensor.cov)
    n = 400
    drawn = np.empty((n, len(xy), 3))
    for k in range(n):
        wrong = sensor.with_vector(sensor.vector() + root @ rng.standard_normal(root.shape[1]))
        moved = xy + 0.3 * rng.standard_normal((len(xy), 1)) * along
        drawn[k] = profile(wrong, points_at(moved, 0.3)).xyz_lcs_mm
    for j in range(len(xy)):
        predicted = np.sqrt(np.diag(one.cov_mm2[j]))
        # 400 draws give a standard deviation to 3.5 %, four of that; second order adds a percent
        assert drawn[:, j].std(axis=0) == pytest.approx(predicted, rel=0.14)
    # points of one sensor err together: the correlation of both depths comes from the shared part alone
    together = np.cov(drawn[:, 0, 2], drawn[:, 4, 2])
    shared = float(one.shared_mm[0, 2] @ one.shared_mm[4, 2])
    assert together[0, 1] == pytest.approx(shared, abs=0.18 * np.sqrt(together[0, 0] * together[1, 1]))


def test_pixels_off_the_sheet_are_counted_not_measured(points_at, exact):
    xy = np.vstack([places(exact), [[1900.0, 1000.0], [5.0, 2040.0]]])
    one = profile(exact, points_at(xy))
    assert len(one) == one.counts["points"] < one.counts["line_points"] == 7
    assert sum(n for name, n in one.counts.items() if name.startswith("status_")) == 7 - len(one)
    with pytest.raises(InputError, match="none of 2 line points lies on the light sheet"):
        profile(exact, points_at(np.full((2, 2), 2047.0) - [[0, 0], [0, 3]]))
    assert joined_counts([one, one])["line_points"] == 14


def test_profiles_of_a_table_stand_in_its_order(points_at, exact):
    xy = places(exact)
    table = pd.concat(
        [
            points_at(xy).to_frame().assign(file="b.png"),
            points_at(np.full((1, 2), 2047.0)).to_frame().assign(file="c.png"),
            points_at(xy[:3]).to_frame().assign(file="a.png"),
        ]
    )
    found, empty = profiles(exact, table)
    assert [one.image for one in found] == ["b.png", "a.png"]
    assert [len(one) for one in found] == [5, 3]
    assert list(empty) == ["c.png"]
    assert found[0].xyz_lcs_mm == pytest.approx(profile(exact, points_at(xy)).xyz_lcs_mm, abs=1e-12)
    with pytest.raises(InputError, match="do not stand together"):
        profiles(exact, pd.concat([table, table[table["file"] == "b.png"]]))
    with pytest.raises(InputError, match="columns missing: sigma_px"):
        profiles(exact, table.drop(columns="sigma_px"))


def test_neighbours_that_share_rows_count_less(rng):
    rows = 7
    white = rng.standard_normal((4000, 400 + rows - 1))
    means = np.stack([white[:, k : k + rows].mean(axis=1) for k in range(400)], axis=1)
    share = independent_share(np.full(400, rows), np.zeros(400, dtype=np.int64))
    # variance of the mean of 400 moving means against that of independent ones; 4000 draws: 2 %, five of it
    assert means.mean(axis=1).var() == pytest.approx(means.var() / (400 * share), rel=0.12)
    assert independent_share(np.array([15, 15]), np.array([3, 9])) == 1.0


def test_factors_give_the_covariance_back(rng):
    A = rng.standard_normal((6, 4)) * np.array([1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0])[:, None]
    root = factor(A @ A.T)
    assert root.shape == (6, 4)
    assert root @ root.T == pytest.approx(A @ A.T, rel=1e-9, abs=1e-15)
    many = rng.standard_normal((5, 6, 2)) @ rng.standard_normal((2, 40))
    few = compressed(many)
    assert few.shape == (5, 6, 2)
    assert few @ np.swapaxes(few, 1, 2) == pytest.approx(many @ np.swapaxes(many, 1, 2), rel=1e-9, abs=1e-9)
