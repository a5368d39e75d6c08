"""The sheet of the trajectory: what the lines, hatches and numbers stand for."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.figures.conftest import artists as by_gid
from thalweg.figures.survey import sigma_norm
from thalweg.figures.survey.maps import gap_intervals, trajectory_sheet


def with_valid(trajectory, *holes):
    valid = np.ones(len(trajectory.t_gps_s), dtype=bool)
    for hole in holes:
        valid[hole] = False
    return dataclasses.replace(trajectory, valid=valid)


def seconds(figure, gid):
    """Begin and end of the hatches of the upper panel, seconds of UTC."""
    return sorted((86_400 * p.get_x(), 86_400 * (p.get_x() + p.get_width())) for p in by_gid(figure, gid))


def test_gaps_run_from_the_last_pose_before_to_the_first_behind(trajectory):
    t = trajectory.t_gps_s
    broken = with_valid(trajectory, slice(0, 5), slice(150, 160), slice(200, 201), slice(390, 400))
    assert gap_intervals(broken) == [(t[0], t[5]), (t[149], t[160]), (t[199], t[201]), (t[389], t[399])]
    assert gap_intervals(with_valid(trajectory)) == []


def test_sheet_of_a_track_with_gaps(trajectory):
    broken = with_valid(trajectory, slice(0, 5), slice(150, 160), slice(300, 340))
    figure = trajectory_sheet(broken, title="Test", twin=True)
    assert "n = 345 valid poses of 400, 3 gaps of 5.7 s in all" in figure.get_suptitle().replace("\n", " ")


def test_sigmas_are_those_of_the_trajectory_in_their_units(trajectory):
    n = len(trajectory.t_gps_s)
    cov = np.zeros((n, 6, 6))
    cov[:, range(6), range(6)] = np.square([0.02, 0.03, 0.05, 1e-3, 1e-3, 4e-3])
    figure = trajectory_sheet(dataclasses.replace(trajectory, cov_pose_wcs=cov))
    (up,), (heading,) = by_gid(figure, "sigma-up"), by_gid(figure, "sigma-heading")
    valid = trajectory.valid
    assert_allclose(up.get_ydata()[valid], 5.0)
    assert_allclose(heading.get_ydata()[valid], np.rad2deg(4e-3))


def test_a_constant_sigma_is_not_stretched_into_noise():
    norm = sigma_norm(2.0 + 1e-9 * np.arange(50))
    assert norm.vmax - norm.vmin == pytest.approx(0.4)  # a fifth of its middle
    assert sigma_norm(np.full(4, np.nan)).vmax == 1.0
