"""An epoch from cloud and trajectory: its groups of errors together are the covariance of each point."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from thalweg.core import (
    CoverageError,
    ErrorChain,
    InputError,
    LazWriter,
    LocalFrame,
    Rigid,
    Trajectory,
    symmetric_roots,
    write_chains,
)
from thalweg.deformation import Epoch, ErrorField, check_order, prepare_epoch
from thalweg.deformation.epochs import _rates
from thalweg.deformation.m3c2 import ColumnIndex
from thalweg.lidar import CORRELATION_DIMENSIONS, CORRELATIONS, SIGMAS, georeference_points
from thalweg.lidar.cloud import EXTRA_DIMENSIONS
from thalweg.navigation.ins_gnss import PoseCorrelation
from thalweg.settings.sections import LidarAccuracy
from thalweg.surface import Area

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
CORRELATION = PoseCorrelation(position_s=10.0, attitude_s=20.0, white_share=0.25, receiver_s=0.1)


def positive(rng: np.random.Generator, sigma: np.ndarray) -> np.ndarray:
    """A full covariance matrix of these standard deviations."""
    root = np.eye(6) + 0.4 * rng.standard_normal((6, 6))
    cov = root @ root.T
    scale = sigma / np.sqrt(np.diag(cov))
    return cov * scale[:, None] * scale


@pytest.fixture
def survey(tmp_path):
    """A cloud of 40 points with the covariances of the georeferencing, and what they come from."""
    rng = np.random.default_rng(2)
    t = 1e9 + np.arange(0.0, 4.05, 0.1)
    pose = positive(rng, np.array([0.02, 0.03, 0.04, 0.002, 0.003, 0.004]))
    trajectory = Trajectory(
        frame=FRAME,
        t_gps_s=t,
        position_wcs_m=np.column_stack([1.5 * (t - t[0]), 0.1 * (t - t[0]), np.full(len(t), 2.0)]),
        quaternion_wcs_ics=Rotation.from_euler(
            "ZYX", np.column_stack([80 + 3 * (t - t[0]), 0 * t + 2.0, 0 * t + 178.0]), degrees=True
        ).as_quat(),
        cov_pose_wcs=np.tile(pose, (len(t), 1, 1)),
        valid=np.ones(len(t), dtype=bool),
    )
    mount = Rigid(
        R=Rotation.from_euler("xyz", [3.0, -88.0, 5.0], degrees=True).as_matrix(),
        shift_m=np.array([-0.35, 0.4, -0.25]),
        cov=positive(rng, np.array([0.002, 0.003, 0.004, 0.001, 0.002, 0.003])),
    )
    xyz = (rng.uniform(-1.0, 1.0, (40, 3)) * [12.0, 12.0, 3.0]).astype(np.float32)
    time = trajectory.t_gps_s[0] + 0.05 + 0.1 * np.arange(40)  # in the middle of the moments
    found = georeference_points(
        xyz,
        time,
        trajectory,
        mount,
        beam=LidarAccuracy(),
        range_m=np.linalg.norm(xyz, axis=1).astype(np.float32),
        reflectivity=np.full(40, 30.0, dtype=np.float32),
    )
    path = tmp_path / "points.laz"
    extra = EXTRA_DIMENSIONS | CORRELATION_DIMENSIONS
    with LazWriter(path, FRAME, scale_m=1e-4, extra_dimensions=extra) as writer:
        columns = dict(zip(SIGMAS, found.sigmas_m().T, strict=True))
        columns |= dict(zip(CORRELATIONS, found.correlations().T, strict=True))
        columns |= {"range": np.linalg.norm(xyz, axis=1), "ring": np.zeros(40, dtype=np.uint8)}
        writer.append(
            found.points_wcs_m,
            t_gps_s=time,
            intensity=np.full(40, 30, dtype=np.uint16),
            return_number=np.ones(40, dtype=np.uint8),
            number_of_returns=np.where(np.arange(40) < 10, 2, 1).astype(np.uint8),
            extra=columns,
        )
    sigma = found.sigmas_m().astype(float)
    full = np.tile(np.eye(3), (40, 1, 1))
    for value, (i, j) in zip(found.correlations().T, ((0, 1), (0, 2), (1, 2)), strict=True):
        full[:, i, j] = full[:, j, i] = value
    return path, trajectory, mount, full * sigma[:, :, None] * sigma[:, None, :]


def prepared(survey, frame: LocalFrame = FRAME, area: Area | None = None, errors=CORRELATION) -> Epoch:
    path, trajectory, mount, _ = survey
    return prepare_epoch(
        "spring", path, trajectory, mount, errors, frame=frame, area=area or Area(),
        moment_s=0.1, water_line_ics_m=0.3, margin_m=1.0,
    )  # fmt: skip


def test_groups_and_own_noise_are_the_covariance_of_each_point(survey):
    """Along many normals: each point as a core point of its own, against the georeferencing."""
    epoch, cov = prepared(survey), survey[3]
    normals = np.random.default_rng(3).standard_normal((40, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    index = ColumnIndex.of(epoch.xyz_m, 1.0)
    field = epoch.field(epoch.xyz_m, normals, index, radius_m=0.005, half_length_m=0.005)
    shared = field.variances()
    e, n, u = normals.T
    weights = np.stack([e * e, 2 * e * n, 2 * e * u, n * n, 2 * n * u, u * u], axis=1)
    own = np.sum(weights * epoch.white_m2, axis=1)
    expected = np.einsum("ki,kij,kj->k", normals, cov, normals)
    assert shared + own == pytest.approx(expected, rel=0.02)
    assert (own < 0.6 * expected).any()  # the shared part is not small
    assert epoch.several_returns.sum() == 10


def test_boat_scanner_and_water_of_each_moment_by_hand(survey):
    """The middle of the moments; 0.3 m along a z axis that rolls by 178 and pitches by 2 degrees."""
    epoch, t = prepared(survey), np.minimum(0.05 + 0.1 * np.arange(41), 4.0)
    assert epoch.t_s == pytest.approx(t)
    assert epoch.boat_m == pytest.approx(np.column_stack([1.5 * t, 0.1 * t, np.full(41, 2.0)]), abs=1e-5)
    down = np.cos(np.deg2rad(178.0)) * np.cos(np.deg2rad(2.0))
    assert epoch.water_m == pytest.approx(np.full(41, 2.0 + 0.3 * down))
    turned = Rotation.from_euler("ZYX", [80 + 3 * t[7], 2.0, 178.0], degrees=True)
    assert epoch.scanner_m[7] - epoch.boat_m[7] == pytest.approx(turned.apply(survey[2].shift_m), abs=1e-4)


def test_the_noise_of_the_receiver_is_a_quarter_and_mounts_last_for_ever(survey):
    groups = {group.name: group for group in prepared(survey).groups}
    assert set(groups) == {"position", "position, white", "attitude", "mount, shift", "mount, rotation"}
    slow, white = (np.sum(groups[name].root ** 2) for name in ("position", "position, white"))
    assert white / (slow + white) == pytest.approx(0.25)
    assert groups["position, white"].correlation_s == 0.05
    assert groups["mount, shift"].correlation_s == np.inf
    assert groups["attitude"].correlation_s == 20.0


def test_an_error_stays_the_same_one_while_the_boat_turns():
    """Roots of neighbouring moments share their components, whatever the eigenvectors of each are."""
    t = np.linspace(0.0, 1.0, 200)
    R = Rotation.from_euler("ZYX", np.column_stack([360 * t, 3 * np.sin(30 * t), 5 * np.cos(20 * t)]), True)
    body = np.diag([4.0, 4.0, 9.0]) * 1e-6  # roll and pitch alike: eigenvectors are any two
    turned = R.as_matrix() @ body @ np.swapaxes(R.as_matrix(), 1, 2)
    root = symmetric_roots(turned, R.as_matrix())
    assert root @ np.swapaxes(root, 1, 2) == pytest.approx(turned, abs=1e-12)
    between = root[:1] @ np.swapaxes(root, 1, 2)  # of the first moment with all others
    assert between == pytest.approx(R.as_matrix()[:1] @ body @ np.swapaxes(R.as_matrix(), 1, 2), abs=1e-12)
    world = symmetric_roots(
        np.broadcast_to(np.diag([1.0, 1.0, 4.0]), (200, 3, 3)), np.broadcast_to(np.eye(3), (200, 3, 3))
    )
    assert world == pytest.approx(np.broadcast_to(np.diag([1.0, 1.0, 2.0]), (200, 3, 3)))


def test_a_mount_moves_points_alike_before_and_after_a_turn(survey):
    """The covariance between two moments is that of one error in the axes of the boat."""
    _, trajectory, mount, _ = survey
    groups = {group.name: group for group in prepared(survey).groups}
    first, last = groups["mount, shift"].root[[0, -2]]
    _, R, _ = trajectory.at(trajectory.t_gps_s[0] + np.array([0.05, 3.95]))
    lever = mount.cov[:3, 3:] @ np.linalg.inv(mount.cov[3:, 3:])
    rest = mount.cov[:3, :3] - lever @ mount.cov[3:, :3]
    assert first @ last.T == pytest.approx(R[0] @ rest @ R[1].T, rel=1e-6, abs=1e-12)


def test_another_origin_turns_points_and_errors_alike(survey):
    """Two frames of 30 km distance: the same normal in both has the same variance."""
    other = LocalFrame(lat_deg=51.25, lon_deg=13.5, h_ell_m=100.0)
    here, there = prepared(survey), prepared(survey, other)
    turn = other.R_ecef_enu.T @ FRAME.R_ecef_enu
    again = FRAME.from_ecef(other.origin_ecef_m + there.xyz_m @ other.R_ecef_enu.T)
    assert again == pytest.approx(here.xyz_m, abs=1e-6)
    normals = np.tile([0.6, 0.0, 0.8], (40, 1))
    variances = [
        epoch.field(epoch.xyz_m, ways, ColumnIndex.of(epoch.xyz_m, 1.0), radius_m=0.005, half_length_m=0.005)
        .variances()
        for epoch, ways in ((here, normals), (there, normals @ turn.T))
    ]  # fmt: skip
    assert variances[1] == pytest.approx(variances[0], rel=1e-6)


def test_an_epoch_is_read_as_it_was_written(survey, tmp_path):
    epoch = prepared(survey)
    epoch.write(tmp_path / "points.npz", tmp_path / "errors.json")
    again = Epoch.read(tmp_path)
    assert again.name == "spring"
    assert (again.xyz_m == epoch.xyz_m).all()
    assert [g.correlation_s for g in again.groups] == [g.correlation_s for g in epoch.groups]
    assert all((a.root == b.root).all() for a, b in zip(again.groups, epoch.groups, strict=True))


def test_a_chain_of_errors_moves_points_as_the_poses_between_its_nodes(survey, tmp_path):
    """Nodes every second with one error of the pose that lasts: the covariance of each point, and of two."""
    trajectory = survey[1]
    t = trajectory.t_gps_s[0] + np.arange(0.0, 5.0)
    root = np.tile(np.linalg.cholesky(trajectory.cov_pose_wcs[0]), (5, 1, 1))
    lasting = ErrorChain(name="smoothed", t_gps_s=t, root=root, link=np.tile(np.eye(6), (5, 1, 1)))
    one, two = prepared(survey, errors=[lasting]), prepared(survey)
    how = {"radius_m": 0.005, "half_length_m": 0.005}
    normals = np.tile([0.6, 0.0, 0.8], (40, 1))
    index = ColumnIndex.of(one.xyz_m, 1.0)
    field = one.field(one.xyz_m, normals, index, **how)
    expected = two.field(one.xyz_m, normals, index, **how).variances()
    assert field.variances() == pytest.approx(expected, rel=1e-6)
    # one error of all poses: the mean of all points moves with the mean of their derivatives
    arm = one.xyz_m - one.boat_m[one.moment]
    row = np.concatenate([normals, np.cross(arm, normals)], axis=1).mean(axis=0)
    by_pose = ErrorField(field.groups[:1], field.rows[:1]).combined(np.full((1, 40), 1 / 40))
    assert by_pose.variances() == pytest.approx([row @ trajectory.cov_pose_wcs[0] @ row], rel=1e-6)
    one.write(tmp_path / "points.npz", tmp_path / "errors.json")
    again = Epoch.read(tmp_path).field(one.xyz_m, normals, index, **how)
    assert again.variances() == pytest.approx(field.variances(), rel=1e-12)


def test_a_late_clock_moves_all_points_along_the_way_of_the_boat(survey):
    """20 ms at 1.5 m/s and 3 degrees/s: variance of each point, and what is left for its own noise."""
    path, trajectory, mount, _ = survey
    how = {
        "frame": FRAME, "area": Area(), "moment_s": 0.1, "water_line_ics_m": 0.3, "margin_m": 1.0,
    }  # fmt: skip
    sure, late = (
        prepare_epoch("spring", path, trajectory, mount, CORRELATION, sigma_time_s=sigma, **how)
        for sigma in (0.0, 0.02)
    )
    normals = np.tile([0.8, 0.6, 0.0], (40, 1))
    index = ColumnIndex.of(sure.xyz_m, 1.0)
    one, two = (
        each.field(sure.xyz_m, normals, index, radius_m=0.005, half_length_m=0.005) for each in (sure, late)
    )
    arm = sure.xyz_m - sure.boat_m[sure.moment]
    turning = np.radians(3.0) * np.cross([0.0, 0.0, 1.0], arm)
    moved = 0.02 * np.sum(normals * (np.array([1.5, 0.1, 0.0]) + turning), axis=1)
    assert two.variances() - one.variances() == pytest.approx(moved**2, rel=0.05, abs=1e-6)
    # all of them at once, not each by itself
    mean = np.full((1, 40), 1 / 40)
    apart = two.combined(mean).variances() - one.combined(mean).variances()
    assert apart == pytest.approx([moved.mean() ** 2], rel=0.05)
    assert (late.white_m2[:, 0] <= sure.white_m2[:, 0] + 1e-9).all()


def test_estimates_of_all_chains_give_correlation_times(tmp_path):
    ins = {
        "estimates": {"position_time_s": {"value": 8.0}, "attitude_time_s": {"value": 15.0}},
        "white_share": 0.3,
    }
    path = tmp_path / "error_model.json"
    path.write_text(json.dumps(ins))
    found = PoseCorrelation.of_survey(path, receiver_s=0.2)
    assert (found.position_s, found.attitude_s, found.white_share, found.receiver_s) == (8.0, 15.0, 0.3, 0.2)
    assert PoseCorrelation.of_survey(path, receiver_s=0.2, position_time_s=4.0).position_s == 4.0
    # a chain that forgets by 1/e in 6 s of the first minute, in 24 s of the second
    t = np.arange(0.0, 120.5, 0.5)
    keep = np.exp(-0.5 / np.where(t <= 60.0, 6.0, 24.0))
    root = np.broadcast_to(0.03 * np.eye(6), (len(t), 6, 6))
    chain = ErrorChain(name="all", t_gps_s=1e9 + t, root=root, link=keep[:, None, None] * np.eye(6))
    write_chains(tmp_path / "errors_fused.npz", [chain])
    found = PoseCorrelation.of_survey(tmp_path / "errors_fused.npz", receiver_s=0.2)
    assert found.white_share == 0.0
    at = 1e9 + np.array([0.0, 20.0, 40.0, 80.0, 100.0, 120.0])
    aged = np.diff(found.even_time_s(at)) / found.position_s
    assert aged[[0, 1, 3, 4]] == pytest.approx([20 / 6, 20 / 6, 20 / 24, 20 / 24], rel=0.12)
    stated = PoseCorrelation.of_survey(tmp_path / "errors_fused.npz", receiver_s=0.2, position_time_s=4.0)
    assert stated.position_s == 4.0
    assert (stated.even_time_s(at) == at).all()


def test_bad_epochs_are_refused(survey, tmp_path):
    epoch = prepared(survey)
    with pytest.raises(InputError, match=r"at the same time as.*copy of the other"):
        check_order([epoch, epoch])
    with pytest.raises(CoverageError, match=r"none of 40 points lies in deformation\.area"):
        prepared(survey, area=Area(lowest_m=500.0))
    bare = tmp_path / "bare.laz"
    with LazWriter(bare, FRAME, scale_m=1e-4) as writer:
        writer.append(np.zeros((3, 3)), t_gps_s=np.full(3, 1e9))
    with pytest.raises(InputError, match=r"no sigma_east, corr_east_up.*georeferencing.correlations"):
        prepared((bare, *survey[1:]))


def test_the_boat_moves_and_turns_as_between_the_poses_around():
    """At a node as in the next step, at the last one as before."""
    rates = np.arange(9.0).reshape(3, 3), -np.arange(9.0).reshape(3, 3)
    trajectory = SimpleNamespace(t_gps_s=np.array([0.0, 1.0, 3.0, 4.0]), rates=lambda: rates)
    found = _rates(trajectory, np.array([0.5, 1.0, 2.9, 3.5, 4.0]))
    np.testing.assert_array_equal(found, np.array(rates)[:, [0, 1, 1, 2, 2]])
