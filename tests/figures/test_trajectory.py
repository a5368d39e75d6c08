"""The sheet of the trajectory: what the lines, hatches and numbers stand for."""

import dataclasses

import numpy as np
import pytest
from matplotlib.colors import LogNorm

from tests.figures.conftest import artists as by_gid
from thalweg.core import GeometryError, unix_from_gps
from thalweg.figures import save
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
    (track,) = by_gid(figure, "track")
    valid = broken.valid
    assert len(track.get_segments()) == int(np.sum(valid[1:] & valid[:-1]))
    assert "n = 345 valid poses of 400, 3 gaps of 5.7 s in all" in figure.get_suptitle().replace("\n", " ")
    # The gap at the start has no place in plan, but one in time.
    assert len(by_gid(figure, "gap")) == 2
    np.testing.assert_allclose(by_gid(figure, "gap")[0].get_xydata(), broken.position_wcs_m[[149, 160], :2])
    assert len(by_gid(figure, "twin-mark")) == 1


def test_hatches_lie_where_the_gaps_are(trajectory):
    found = seconds(trajectory_sheet(trajectory), "gap-span")
    assert len(found) == 2  # one in each panel
    begin, end = (float(unix_from_gps(trajectory.t_gps_s[i])) for i in (149, 160))
    # Days since 1970 in float64 resolve 0.3 us.
    np.testing.assert_allclose(found, [(begin, end)] * 2, rtol=0, atol=1e-5)


def test_sigmas_are_those_of_the_trajectory_in_their_units(trajectory):
    n = len(trajectory.t_gps_s)
    cov = np.zeros((n, 6, 6))
    cov[:, range(6), range(6)] = np.square([0.02, 0.03, 0.05, 1e-3, 1e-3, 4e-3])
    figure = trajectory_sheet(dataclasses.replace(trajectory, cov_pose_wcs=cov))
    (up,), (heading,) = by_gid(figure, "sigma-up"), by_gid(figure, "sigma-heading")
    valid = trajectory.valid
    np.testing.assert_allclose(up.get_ydata()[valid], 5.0)
    assert np.isnan(up.get_ydata()[~valid]).all()
    np.testing.assert_allclose(heading.get_ydata()[valid], np.rad2deg(4e-3))
    labels = [ax.get_ylabel() for ax in figure.axes]
    assert "sigma of\nposition / cm" in labels
    assert "sigma of\nattitude / °" in labels
    (track,) = by_gid(figure, "track")
    np.testing.assert_allclose(track.get_array(), 100 * np.hypot(0.02, 0.03))


def test_large_and_varied_sigmas_are_shown_in_metres_on_a_logarithmic_scale(trajectory):
    growth = np.geomspace(1.0, 1e4, len(trajectory.t_gps_s))[:, None, None]
    figure = trajectory_sheet(dataclasses.replace(trajectory, cov_pose_wcs=trajectory.cov_pose_wcs * growth))
    panel = next(ax for ax in figure.axes if ax.get_ylabel() == "sigma of\nposition / m")
    assert panel.get_yscale() == "log"
    assert isinstance(by_gid(figure, "track")[0].norm, LogNorm)


def test_a_constant_sigma_is_not_stretched_into_noise():
    norm = sigma_norm(2.0 + 1e-9 * np.arange(50))
    assert norm.vmax - norm.vmin == pytest.approx(0.4)  # a fifth of its middle
    assert sigma_norm(np.full(4, np.nan)).vmax == 1.0


def test_long_tracks_are_thinned_and_keep_their_gaps(trajectory):
    n = 50_001
    long = dataclasses.replace(
        trajectory,
        t_gps_s=trajectory.t_gps_s[0] + 0.005 * np.arange(n),
        position_wcs_m=np.stack([0.01 * np.arange(n), np.zeros(n), np.zeros(n)], axis=1),
        quaternion_wcs_ics=np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)),
        cov_pose_wcs=np.tile(trajectory.cov_pose_wcs[0], (n, 1, 1)),
        valid=np.arange(n) != 25_000,
    )
    (track,) = by_gid(trajectory_sheet(long), "track")
    segments = np.array(track.get_segments())
    assert 10_000 < len(segments) < 20_000
    assert not np.any((segments[:, 0, 0] < 250.0) & (segments[:, 1, 0] > 250.0))


@pytest.mark.parametrize("index", [0, 7, 399])
def test_one_pose_makes_a_sheet(tmp_path, trajectory, index):
    one = np.zeros(400, dtype=bool)
    one[index] = True
    save(trajectory_sheet(dataclasses.replace(trajectory, valid=one)), tmp_path / "one.png", dpi=50)
    assert (tmp_path / "one.png").stat().st_size > 5_000


def test_no_pose_and_no_sigma_are_refused(trajectory):
    with pytest.raises(GeometryError, match=r"without a valid node.*trajectory\.json"):
        trajectory_sheet(with_valid(trajectory, slice(None)))
    unknown = dataclasses.replace(trajectory, cov_pose_wcs=np.full((400, 6, 6), np.nan))
    with pytest.raises(GeometryError, match="no valid node has a finite sigma"):
        trajectory_sheet(unknown)
