"""The predicted covariance against Monte Carlo and finite differences."""

import numpy as np
from scipy.spatial.transform import Rotation

from thalweg.core.frames import rotation_enu_body
from thalweg.lidar.covariance import attitude_axes, point_covariance

SIGMA_ATTITUDE = np.deg2rad([0.1, 0.15, 0.2])
SIGMA_POSITION = np.array([0.02, 0.025, 0.03])
SIGMA_LIDAR = 0.0173


def test_axes_are_the_derivatives_of_the_rotation() -> None:
    angles = np.array([0.1, -0.2, 2.1])
    axes = attitude_axes(rotation_enu_body(*angles)[None])[0]
    body = np.array([3.0, -7.0, 2.0])
    step = 1e-6
    for k in range(3):
        plus, minus = angles.copy(), angles.copy()
        plus[k] += step
        minus[k] -= step
        numeric = (rotation_enu_body(*plus) - rotation_enu_body(*minus)) @ body / (2 * step)
        analytic = np.cross(axes[k], rotation_enu_body(*angles) @ body)
        # central difference: step^2 / 6 * |x| = 1e-12, rounding 1e-16 / step * |x| = 1e-9
        np.testing.assert_allclose(analytic, numeric, atol=1e-8)


def test_covariance_agrees_with_monte_carlo(rng: np.random.Generator) -> None:
    angles = np.array([0.05, -0.04, 1.2])
    mount = Rotation.from_euler("y", -90, degrees=True).as_matrix()
    scs = np.array([14.0, 6.0, 2.0])
    n = 200_000
    noisy = angles + rng.normal(size=(n, 3)) * SIGMA_ATTITUDE
    R = rotation_enu_body(noisy[:, 0], noisy[:, 1], noisy[:, 2])
    body = (scs + rng.normal(size=(n, 3)) * SIGMA_LIDAR) @ mount.T
    points = np.einsum("nij,nj->ni", R, body) + rng.normal(size=(n, 3)) * SIGMA_POSITION
    R0 = rotation_enu_body(*angles)
    predicted = point_covariance(
        (R0 @ mount @ scs)[None],
        np.zeros((1, 3)),
        R0[None],
        np.diag(SIGMA_POSITION**2)[None],
        SIGMA_ATTITUDE[None],
        SIGMA_LIDAR,
    )[0]
    scale = np.sqrt(np.outer(np.diag(predicted), np.diag(predicted)))
    # a covariance from n samples has a relative standard error of sqrt(2 / n) = 0.3 %; five of them
    np.testing.assert_allclose(np.cov(points.T) / scale, predicted / scale, atol=0.016)


def test_an_error_of_the_attitude_turns_the_boat_about_its_antenna(rng: np.random.Generator) -> None:
    """Positions are of the antenna: on a high mast the lever arm must be part of the arm that turns."""
    lever = np.array([0.0, 0.0, -3.0])  # a mast of 3 m
    scs_point = np.array([0.0, 10.0, 0.0])
    n = 100_000
    noisy = rng.normal(size=(n, 3)) * SIGMA_ATTITUDE
    R = rotation_enu_body(noisy[:, 0], noisy[:, 1], noisy[:, 2])
    antenna = np.zeros(3)
    points = antenna + R @ (scs_point - lever)
    R0 = rotation_enu_body(0.0, 0.0, 0.0)
    predicted = point_covariance(
        (R0 @ (scs_point - lever))[None],
        antenna[None],
        R0[None],
        np.zeros((1, 3, 3)),
        SIGMA_ATTITUDE[None],
        0.0,
    )[0]
    # 0.5 % from the sample size, second-order terms of 0.2 deg on 10 m: 0.06 mm of 30 mm
    np.testing.assert_allclose(
        np.sqrt(np.diag(np.cov(points.T))), np.sqrt(np.diag(predicted)), rtol=0.015, atol=1e-4
    )


def test_published_totals_of_the_thesis() -> None:
    """T Table 3.1: 54, 62, 101, 183 mm at 5, 10, 25, 50 m for the table's pose-independent sum.

    The table adds the single influences in quadrature: attitude 0.1, 0.1, 0.2 deg with each lever of about
    0.8 times the range, positions 20, 20, 30 mm, lidar 17 mm a component. A point at equal distance along
    all body axes sees every angle with sqrt(2/3) of its range.
    """
    attitude = np.deg2rad([0.1, 0.1, 0.2])
    for range_m, total_m in ((5, 0.054), (10, 0.062), (25, 0.101), (50, 0.183)):
        point = np.full(3, range_m / np.sqrt(3))
        cov = point_covariance(
            point[None],
            np.zeros((1, 3)),
            np.eye(3)[None],
            np.diag([4e-4, 4e-4, 9e-4])[None],
            attitude[None],
            0.0173,
        )[0]
        # the table rounds inputs to mm and carries the small calibration terms too: within 8 %
        assert abs(np.sqrt(np.trace(cov)) / total_m - 1) < 0.08, range_m
