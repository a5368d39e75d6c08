"""The predicted covariance: derivatives by differences, Monte Carlo, fast kernel against the slow form."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from tests.core.conftest import trajectory_of
from tests.lidar.exact_covariance import INPUTS, point_covariance, point_jacobian
from thalweg.core import GeometryError, Rigid, rotation_enu_body, rotation_opk
from thalweg.lidar import georeference_points
from thalweg.settings.sections import LidarAccuracy

POSE_SIGMAS = np.array([0.02, 0.02, 0.03, 2e-3, 2e-3, 4e-3])
MOUNT_SIGMAS = np.array([5e-4, 2e-4, 1e-4, 3e-4, 2e-4, 1e-4])
BEAM = LidarAccuracy(
    sigma_component_m=0.0173, divergence_mrad=3.0, footprint_share=0.177, sigma_weak_m=0.03, sigma_time_s=0.02
)


def random_covariance(rng, n, sigmas):
    """Full matrices with strong correlations."""
    a = rng.normal(size=(n, len(sigmas), len(sigmas)))
    cov = a @ np.swapaxes(a, 1, 2)
    scale = sigmas / np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
    return cov * scale[:, :, None] * scale[:, None, :]


@pytest.fixture
def trajectory(rng):
    s = np.arange(200) * 0.02
    R = rotation_enu_body(0.05 * np.sin(1.9 * s), 0.03 * np.sin(1.4 * s), 1.0 + 0.12 * s)
    position = np.column_stack([0.4 * s, np.sin(0.2 * s), 0.02 * np.sin(2 * s)])
    cov = random_covariance(rng, 200, POSE_SIGMAS)
    return trajectory_of(4.0e8 + s, position, Rotation.from_matrix(R), cov)


@pytest.fixture
def mount(rng):
    return Rigid(
        R=rotation_opk(0.01, -np.pi / 2 + 0.02, 0.03),
        shift_m=np.array([-0.4, 0.1, -0.5]),
        cov=random_covariance(rng, 1, MOUNT_SIGMAS)[0],
    )


def shots(rng, trajectory, n):
    xyz = rng.normal(scale=[15.0, 15.0, 4.0], size=(n, 3)).astype(np.float32)
    t = np.sort(rng.uniform(trajectory.t_gps_s[0], trajectory.t_gps_s[-1], n))
    return xyz, t, np.linalg.norm(xyz, axis=1), rng.integers(0, 101, n).astype(np.uint8)


def jacobian(xyz, t, trajectory, mount):
    _, R, _ = trajectory.at(t)
    velocity, rate = trajectory.rates()
    j = np.clip(np.searchsorted(trajectory.t_gps_s, t, side="right") - 1, 0, len(velocity) - 1)
    return point_jacobian(xyz, R, mount.R, mount.shift_m, velocity[j], rate[j])


def test_the_kernel_agrees_with_the_slow_form(rng, trajectory, mount):
    xyz, t, range_m, reflectivity = shots(rng, trajectory, 5000)
    found = georeference_points(
        xyz, t, trajectory, mount, beam=BEAM, range_m=range_m, reflectivity=reflectivity
    )
    slow = point_covariance(
        jacobian(xyz, t, trajectory, mount),
        trajectory.cov_at(t),
        mount.cov,
        BEAM.variances(range_m, reflectivity),
        BEAM.sigma_time_s,
    )
    upper = slow[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    sigma = np.sqrt(np.einsum("nii->ni", slow))
    scale = sigma[:, [0, 0, 0, 1, 1, 2]] * sigma[:, [0, 1, 2, 1, 2, 2]]
    # float32 of the result: 6e-8
    assert np.abs((found.cov_m2 - upper) / scale).max() < 2e-7
    plain = georeference_points(xyz, t, trajectory, mount)
    assert_allclose(found.points_wcs_m, plain.points_wcs_m, atol=1e-12)
    assert_allclose(found.sigmas_m(), np.sqrt(np.diagonal(slow, axis1=1, axis2=2)), rtol=1e-6)


def test_published_totals_of_the_thesis():
    """T Table 3.1: 54, 62, 101, 183 mm at 5, 10, 25, 50 m with its fifteen inputs.

    Single influences add in quadrature: attitude 0.1, 0.1, 0.2 deg, positions 20, 20, 30 mm, lidar 17 mm
    a component, mount 0.018, 0.009, 0.004 deg and 0.5, 0.2, 0.1 mm. The table's lever of each angle is 0.8
    times the range, as for a point at equal distance along all body axes: sqrt(2/3).
    """
    sigma = np.array([0.0005, 0.0002, 0.0001, *np.deg2rad([0.018, 0.009, 0.004])])
    mount = Rigid(R=np.eye(3), shift_m=np.zeros(3), cov=np.diag(sigma**2))
    pose = np.diag(np.square([0.02, 0.02, 0.03, *np.deg2rad([0.1, 0.1, 0.2])]))
    for range_m, total_m in ((5, 0.054), (10, 0.062), (25, 0.101), (50, 0.183)):
        xyz = np.full((1, 3), range_m / np.sqrt(3))
        J = point_jacobian(xyz, np.eye(3)[None], mount.R, mount.shift_m, np.zeros((1, 3)), np.zeros((1, 3)))
        beam = LidarAccuracy(sigma_component_m=0.017, divergence_mrad=0.0, sigma_weak_m=0.0, sigma_time_s=0.0)
        cov = point_covariance(J, pose[None], mount.cov, beam.variances(np.ones(1), np.ones(1)))[0]
        # the table rounds inputs and influences to mm, its levers are not quite sqrt(2/3): within 8 %
        assert abs(np.sqrt(np.trace(cov)) / total_m - 1) < 0.08, range_m


def test_covariances_need_ranges_and_reflectivities(trajectory, mount):
    t = trajectory.t_gps_s[[10, 11]]
    with pytest.raises(GeometryError, match="one range and one reflectivity for each point"):
        georeference_points(np.ones((2, 3)), t, trajectory, mount, beam=BEAM)
    with pytest.raises(GeometryError, match="points without covariances"):
        georeference_points(np.ones((2, 3)), t, trajectory, mount).sigmas_m()


@pytest.mark.parametrize(
    ("change", "message"),
    [({"sigma_component_m": -0.1}, "sigma_component_m"), ({"divergence_mrad": np.nan}, "divergence_mrad")],
)
def test_impossible_accuracies_are_refused(change, message):
    with pytest.raises(ValidationError, match=message):
        LidarAccuracy(**({"sigma_component_m": 0.01} | change))


LIDAR_ACCURACY = {
    "sigma_component_m": 0.017,
    "divergence_mrad": 3.0,
    "footprint_share": 0.25,
    "sigma_weak_m": 0.03,
    "sigma_time_s": 0.001,
}
"""Section of a campaign file, by hand."""


def test_the_footprint_is_that_of_the_full_divergence_in_milliradians():
    """3 mrad at 50 m are a footprint of 150 mm, a quarter of it 37.5 mm; 17 mm of the sensor beside it."""
    beam = LidarAccuracy(**LIDAR_ACCURACY)
    along, across = beam.variances(np.array([50.0]), np.array([100.0]))
    assert np.sqrt(across[0]) == pytest.approx(np.sqrt(0.0375**2 + 0.017**2), rel=1e-12)
    # at 50 m a white target returns 40 times the light of a 10 % target at 100 m
    assert np.sqrt(along[0]) == pytest.approx(np.sqrt((0.03 / 40) ** 2 + 0.017**2), rel=1e-12)


def test_a_halved_divergence_is_seen_far_away_at_an_angle_with_good_poses(rng):
    """Drawn echoes 40 m away, met at 70 degrees, poses good to 2 mm and 0.006 degrees: there the beam rules.

    The errors are drawn as the sensor makes them, in the footprint of its 3 mrad; the prediction goes the way
    of a campaign, from the section of its file through the kernel.
    """
    n = 20_000
    pose = np.diag(np.square([0.002, 0.002, 0.002, 1e-4, 1e-4, 1e-4]))
    trajectory = trajectory_of([0.0, 1.0], cov=pose)
    mount = Rigid(R=np.eye(3), shift_m=np.zeros(3))
    xyz = np.tile(np.array([40.0, 0.0, 0.0], dtype=np.float32), (n, 1))
    turned = np.cross(rng.normal(size=(n, 3)) * 1e-4, xyz)
    # uniform in the disc of the footprint, 120 mm wide: sigma is a quarter of its diameter in each direction
    radius, angle = 0.06 * np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
    echo = np.column_stack([np.zeros(n), radius * np.cos(angle), radius * np.sin(angle)])
    error = rng.normal(size=(n, 3)) * 0.017 + echo + turned + rng.normal(size=(n, 3)) * 0.002
    normal = np.array([-np.cos(np.deg2rad(70)), np.sin(np.deg2rad(70)), 0.0])
    ratio = {}
    for divergence_mrad in (3.0, 1.5):
        section = {"divergence_mrad": divergence_mrad, "sigma_weak_m": 0.0, "sigma_time_s": 0.0}
        measured = {"range_m": np.full(n, 40.0), "reflectivity": np.full(n, 50.0)}
        beam = LidarAccuracy(**LIDAR_ACCURACY | section)
        found = georeference_points(xyz, np.full(n, 0.5), trajectory, mount, beam=beam, **measured)
        C = found.cov_m2[0].astype(float)[[[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
        ratio[divergence_mrad] = float(np.mean((error @ normal) ** 2) / (normal @ C @ normal))
    # the mean of n squared normal errors has a relative sigma of sqrt(2 / n) = 1 %; four of them
    assert ratio[3.0] == pytest.approx(1.0, abs=0.04)
    assert ratio[1.5] > 1.7


def test_factors_widen_range_and_directions_and_the_place_in_the_footprint():
    beam = LidarAccuracy(sigma_component_m=0.01, divergence_mrad=3.0, footprint_share=0.25, sigma_weak_m=0.03)
    wide = beam.scaled(component=2.0, footprint=1.5)
    assert (wide.sigma_component_m, wide.sigma_weak_m) == pytest.approx((0.02, 0.06))
    assert (wide.footprint_share, wide.divergence_rad) == pytest.approx((0.375, 0.003))


def test_beside_an_invalid_node_there_is_no_covariance(trajectory, mount):
    """Nodes every 0.02 s, the eleventh of them invalid: nothing from 0.18 to 0.22 s."""
    valid = np.ones(200, dtype=bool)
    valid[10] = False
    t = trajectory.t_gps_s[0] + np.array([0.17, 0.19, 0.21, 0.23])
    holed, ones = replace(trajectory, valid=valid), np.ones(4)
    measured = {"beam": BEAM, "range_m": ones, "reflectivity": ones}
    found = georeference_points(np.ones((4, 3)), t, holed, mount, **measured)
    assert found.has_pose.tolist() == [True, False, False, True]
    assert np.isnan(found.cov_m2).all(axis=1).tolist() == [False, True, True, False]


def moved(xyz, t_s, trajectory, mount, inputs):
    """The chain written down once more, with an error of every input: point (3,) in wcs."""
    position, R, _ = trajectory.at(np.array([t_s + inputs[15]]))
    beam = mount.R @ xyz
    unit = beam / np.linalg.norm(beam)
    first = np.cross(unit, np.eye(3)[np.argmin(np.abs(unit))])
    first /= np.linalg.norm(first)
    beam = beam + inputs[12] * unit + inputs[13] * first + inputs[14] * np.cross(unit, first)
    body = Rotation.from_rotvec(inputs[9:12]).as_matrix() @ beam + mount.shift_m + inputs[6:9]
    turned = Rotation.from_rotvec(inputs[3:6]).as_matrix() @ R[0] @ body
    return turned + position[0] + inputs[:3]


@pytest.mark.parametrize("name", INPUTS)
def test_each_derivative_by_differences(rng, trajectory, mount, name):
    if name == "time":  # near zero, where float64 resolves a step of 10 us
        trajectory = replace(trajectory, t_gps_s=trajectory.t_gps_s - trajectory.t_gps_s[0])
    xyz, t, _, _ = shots(rng, trajectory, 20)
    # in the middle of an interval: the pose is piecewise linear in time
    node = np.searchsorted(trajectory.t_gps_s, t).clip(1)
    t = (trajectory.t_gps_s[node - 1] + trajectory.t_gps_s[node]) / 2
    analytic = jacobian(xyz, t, trajectory, mount)
    k, step = INPUTS.index(name), 1e-5
    for i in range(len(t)):
        e = np.zeros(16)
        e[k] = step
        x = xyz[i].astype(np.float64)
        plus, minus = (moved(x, t[i], trajectory, mount, s * e) for s in (1.0, -1.0))
        numeric = (plus - minus) / (2 * step)
        if name.startswith("across"):
            # the two directions across a beam are free: only the plane they span counts
            along = analytic[i, :, 12]
            assert abs(numeric @ along) < 1e-6
            assert np.linalg.norm(numeric) == pytest.approx(1.0, abs=1e-6)
            assert np.linalg.norm(analytic[i, :, k]) == pytest.approx(1.0, abs=1e-12)
            continue
        # step^2 / 6 * 50 m = 1e-9, rounding 1e-14 / step
        assert_allclose(numeric, analytic[i, :, k], atol=1e-6)
