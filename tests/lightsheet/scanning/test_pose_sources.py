"""Poses by trajectory and rail: their covariance is that of simulated errors; gaps are named (P4 4.2.1)."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from thalweg.core import CoverageError, LocalFrame, Rigid, Trajectory, rotation_opk
from thalweg.lightsheet.poses import factor, trajectory_poses

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)


def boat(rng):
    """Two seconds at 50 Hz, rolling, with a gap from 1 to 1.5 s; turns count as much as shifts."""
    t = np.arange(101) / 50.0
    q = Rotation.from_euler("xyz", np.stack([0.1 * np.sin(3 * t), 0.05 * t, 0.4 + 0.2 * t], axis=1)).as_quat()
    A = rng.standard_normal((6, 6)) * np.array([4e-4, 4e-4, 6e-4, 0.003, 0.003, 0.003])[:, None]
    return Trajectory(
        frame=FRAME,
        t_gps_s=3e8 + t,
        position_wcs_m=np.stack([0.5 * t, 0.1 * t, 0.02 * np.sin(t)], axis=1),
        quaternion_wcs_ics=q,
        cov_pose_wcs=np.tile(A @ A.T, (len(t), 1, 1)),
        valid=(t < 1.0) | (t > 1.5),
    )


def mount(rng):
    A = rng.standard_normal((6, 6)) * np.array([4e-4, 4e-4, 4e-4, 0.003, 0.003, 0.003])[:, None]
    return Rigid(R=rotation_opk(np.pi, 0.05, 0.2), shift_m=np.array([-0.3, 0.1, 0.25]), cov=A @ A.T)


def test_covariance_is_that_of_simulated_errors(rng):
    trajectory, fixed = boat(rng), mount(rng)
    t = np.array([3e8 + 0.411])
    sigma_t = 0.002
    found = trajectory_poses(trajectory, fixed, ["a"], t, sigma_time_s=sigma_t)
    right = found.pose(0)
    place, R, _ = trajectory.at(t)
    ics = Rigid(R=R[0], shift_m=place[0])
    own, common = factor(trajectory.cov_pose_wcs[0]), factor(fixed.cov)
    errors = []
    for _ in range(1000):
        later = t + sigma_t * rng.standard_normal()
        p, R, _ = trajectory.at(later)
        moved = Rigid(R=R[0], shift_m=p[0]).moved(own @ rng.standard_normal(6))
        errors.append((moved @ fixed.moved(common @ rng.standard_normal(6))).error_from(right))
    assert (ics @ fixed).shift_m == pytest.approx(right.shift_m, abs=1e-12)
    seen = np.cov(np.array(errors).T)
    sigma = np.sqrt(np.diag(right.cov))
    # 1000 draws: 2.2 % of a sigma, 0.03 of a correlation; five of that
    assert np.sqrt(np.diag(seen)) == pytest.approx(sigma, rel=0.12)
    assert seen / np.outer(sigma, sigma) == pytest.approx(right.cov / np.outer(sigma, sigma), abs=0.2)
    without = trajectory_poses(trajectory, fixed, ["a"], t).pose(0)
    assert without.cov[0, 0] < right.cov[0, 0]


def test_images_beside_the_trajectory_are_named(rng):
    t = 3e8 + np.array([0.5, 1.2, 9.0, np.nan])
    found = trajectory_poses(boat(rng), mount(rng), list("abcd"), t)
    assert found.reasons == ("", "in a gap of the trajectory", "before or after the trajectory", "no time")
    assert found.usable.tolist() == [True, False, False, False]
    with pytest.raises(CoverageError, match=r"no image from 300000100\.0"):
        trajectory_poses(boat(rng), mount(rng), ["a"], np.array([3e8 + 100.0]))
    with pytest.raises(CoverageError, match="none of 2 images has a time"):
        trajectory_poses(boat(rng), mount(rng), ["a", "b"], np.full(2, np.nan))
