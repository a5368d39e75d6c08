"""The trajectory: covariances between nodes, sigmas of the angles, rates, what it refuses."""

import re
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from tests.core.conftest import trajectory_of
from thalweg.core import CoverageError, GeometryError, Trajectory, attitude_axes, rotation_enu_body


def turning(n=50, rate_hz=10.0):
    """Straight on at 0.4 m/s, turning by 7 degrees a second."""
    s = np.arange(n) / rate_hz
    R = rotation_enu_body(np.full(n, 0.02), np.full(n, -0.01), np.deg2rad(7.0) * s)
    cov = np.diag([4e-4, 4e-4, 9e-4, 3e-6, 3e-6, 12e-6])
    return trajectory_of(3.0e8 + s, np.outer(s, [0.4, 0.0, 0.0]), Rotation.from_matrix(R), cov)


@pytest.mark.parametrize("correlation", [0.0, 0.9, 1.0])
def test_the_covariance_between_nodes_is_an_upper_bound(correlation):
    """``(1-u) C1 + u C2`` exceeds the covariance of the interpolated error by ``u (1-u) Cov(e1 - e2)``."""
    rng = np.random.default_rng(4)
    a = rng.normal(size=(2, 6, 6))
    C1, C2 = a @ np.swapaxes(a, 1, 2)
    first, second = np.linalg.cholesky(C1), np.linalg.cholesky(C2)
    between = correlation * first @ second.T
    trajectory = replace(turning(2), cov_pose_wcs=np.stack([C1, C2]))
    for u in (0.0, 0.3, 0.5, 1.0):
        t = trajectory.t_gps_s[0] + u * 0.1
        stated = trajectory.cov_at(np.array([t]))[0]
        true = (1 - u) ** 2 * C1 + u**2 * C2 + u * (1 - u) * (between + between.T)
        slack = np.linalg.eigvalsh(stated - true)
        # 3e8 s in float64 steps by 6e-8 s: u is known to 6e-7
        assert slack[0] > -1e-5 * np.trace(stated)
        if u in (0.0, 1.0):
            assert_allclose(stated, true, rtol=1e-5, atol=1e-5)


def test_sigmas_of_roll_pitch_and_heading_come_back(rng):
    n = 30
    R = rotation_enu_body(rng.uniform(-0.3, 0.3, n), rng.uniform(-0.3, 0.3, n), rng.uniform(0, 6, n))
    sigma = rng.uniform(0.001, 0.004, (n, 3))
    axes = np.swapaxes(attitude_axes(R), 1, 2) * sigma[:, None, :]
    cov = np.zeros((n, 6, 6))
    cov[:, 3:, 3:] = axes @ np.swapaxes(axes, 1, 2)
    trajectory = replace(turning(n), quaternion_wcs_ics=Rotation.from_matrix(R).as_quat(), cov_pose_wcs=cov)
    assert_allclose(trajectory.sigma_roll_pitch_heading_rad(), sigma, rtol=1e-9)


def test_rates_are_those_of_the_motion():
    velocity, rate = turning().rates()
    assert_allclose(velocity, np.tile([0.4, 0, 0], (49, 1)), atol=1e-6)
    # clockwise from above: about down; stamps of 3e8 s resolve 6e-8 s of 0.1 s
    assert_allclose(rate, np.tile([0, 0, -np.deg2rad(7.0)], (49, 1)), atol=1e-6)


def test_everything_survives_the_file(tmp_path, rng):
    a = rng.normal(size=(50, 6, 6)) * [0.02, 0.02, 0.03, 2e-3, 2e-3, 4e-3]
    trajectory = replace(turning(), cov_pose_wcs=np.swapaxes(a, 1, 2) @ a)
    trajectory.write(tmp_path / "t.parquet")
    again = Trajectory.read(tmp_path / "t.parquet")
    scale = np.sqrt(np.einsum("nii->ni", trajectory.cov_pose_wcs))
    error = (again.cov_pose_wcs - trajectory.cov_pose_wcs) / scale[:, :, None] / scale[:, None, :]
    assert np.abs(error).max() < 1e-14
    still = replace(trajectory, cov_pose_wcs=np.zeros((50, 6, 6)))  # no error at all has no correlation
    still.write(tmp_path / "zero.parquet")
    assert_array_equal(Trajectory.read(tmp_path / "zero.parquet").cov_pose_wcs, 0.0)


def test_what_is_refused():
    good = turning()
    with pytest.raises(GeometryError, match=r"cov_pose_wcs.shape=\(50, 3, 3\)"):
        replace(good, cov_pose_wcs=np.zeros((50, 3, 3)))
    with pytest.raises(GeometryError, match="strictly increasing"):
        replace(good, t_gps_s=good.t_gps_s[::-1].copy())
    for k in (1, 7, 49):  # one step back among many forwards
        back = good.t_gps_s.copy()
        back[k] -= 0.25
        with pytest.raises(GeometryError, match=rf"step by -0.150000 s at node {k - 1}"):
            replace(good, t_gps_s=back)
    with pytest.raises(CoverageError, match="no valid node"):
        replace(good, valid=np.zeros(50, dtype=bool)).span()


def test_every_column_of_the_file_by_hand(tmp_path):
    """Read back with pyarrow alone: `write` and `read` share their names, so both may err alike."""
    sigma = np.array([0.01, 0.02, 0.03, 0.001, 0.002, 0.003])
    correlation = np.eye(6)
    correlation[np.triu_indices(6, 1)] = 0.01 * np.arange(1, 16)
    correlation = np.maximum(correlation, correlation.T)
    attitude, cov = Rotation.from_quat([0.1, 0.5, -0.7, 0.5]), correlation * np.outer(sigma, sigma)
    whole = trajectory_of([4.0e8, 4.0e8 + 1], [1.0, 2.0, 3.0], attitude, cov, valid=[True, False])
    whole.write(tmp_path / "trajectory.parquet")
    table = pq.read_table(tmp_path / "trajectory.parquet")
    expected = {
        "t_gps_s": 4.0e8,
        "east_m": 1.0,
        "north_m": 2.0,
        "up_m": 3.0,
        "qx": 0.1,
        "qy": 0.5,
        "qz": -0.7,
        "qw": 0.5,
        "sigma_east_m": 0.01,
        "sigma_north_m": 0.02,
        "sigma_up_m": 0.03,
        "sigma_rotation_east_rad": 0.001,
        "sigma_rotation_north_rad": 0.002,
        "sigma_rotation_up_rad": 0.003,
        "correlation_east_north": 0.01,
        "correlation_east_up": 0.02,
        "correlation_east_rotation_east": 0.03,
        "correlation_east_rotation_north": 0.04,
        "correlation_east_rotation_up": 0.05,
        "correlation_north_up": 0.06,
        "correlation_north_rotation_east": 0.07,
        "correlation_north_rotation_north": 0.08,
        "correlation_north_rotation_up": 0.09,
        "correlation_up_rotation_east": 0.10,
        "correlation_up_rotation_north": 0.11,
        "correlation_up_rotation_up": 0.12,
        "correlation_rotation_east_rotation_north": 0.13,
        "correlation_rotation_east_rotation_up": 0.14,
        "correlation_rotation_north_rotation_up": 0.15,
        "valid": 1.0,
    }
    assert table.slice(0, 1).to_pylist()[0] == pytest.approx(expected)
    units = {field.name: field.metadata[b"unit"].decode() for field in table.schema}
    own = {"m": r".*_m", "rad": r".*_rad", "s": "t_gps_s"}
    told = {name: [unit for unit, form in own.items() if re.fullmatch(form, name)] for name in expected}
    assert units == {name: unit[0] if unit else "1" for name, unit in told.items()}
    assert table.column("valid").to_pylist() == [True, False]


def test_poses_between_nodes_by_hand():
    """Nodes at 0, 1, 2 s; more times than nodes, before, on, between and behind them."""
    some = replace(turning(3, 1.0), t_gps_s=np.array([0.0, 1.0, 2.0]))
    t = np.array([-0.5, 0.0, 0.25, 1.0, 1.75, 2.0, 2.5])
    position, R, inside = some.at(t)
    assert inside.tolist() == [False, True, True, True, True, True, False]
    assert_allclose(position[1:6, 0], [0.0, 0.1, 0.4, 0.7, 0.8], atol=1e-15)
    heading = np.arctan2(R[1:6, 0, 0], R[1:6, 1, 0])
    # roll and pitch of a hundredth change the direction of the arc by as much squared
    assert_allclose(np.rad2deg(heading), [0.0, 1.75, 7.0, 12.25, 14.0], atol=0.01)


def test_quaternions_of_neighbours_are_on_the_same_side():
    """Minus a quaternion is the same rotation; the kernels blend neighbours and need them of one sign."""
    whole = turning(6, 1.0)
    q = whole.quaternion_wcs_ics
    mixed = replace(whole, quaternion_wcs_ics=q * np.array([1, -1, -1, 1, -1, 1])[:, None])
    assert_allclose(mixed.quaternion_wcs_ics, q)


def test_sigmas_of_each_node_are_the_roots_of_its_variances():
    sigma = np.array([[2.0, 3.0, 4.0, 0.1, 0.2, 0.3], [5.0, 6.0, 7.0, 0.4, 0.5, 0.6]])
    trajectory = trajectory_of([0.0, 1.0], cov=sigma[:, :, None] ** 2 * np.eye(6))
    assert_allclose(trajectory.sigma_position_m, sigma[:, :3])


def test_between_an_invalid_node_and_a_valid_one_there_is_no_pose():
    t, valid = np.arange(6.0), np.array([True, True, False, True, True, False])
    trajectory = trajectory_of(t, valid=valid)
    at = np.arange(-1, 6) + 0.4
    assert trajectory.at(at)[2].tolist() == [False, True, False, False, True, False, False]
    assert trajectory.span() == (0.0, 4.0)
    assert trajectory_of(t, valid=valid[::-1]).span() == (1.0, 5.0)
