"""The lidar placed on the boat through the camera."""

import numpy as np
import pytest

from thalweg.calibration import read_mounts, resolve_mounts, write_mounts
from thalweg.core import ConfigError, Rigid, exp_rotation
from thalweg.core.calibration import Calibration, Source, lever_block, pose_block
from thalweg.navigation.camera import lidar_mount_by_camera

LIDAR = Rigid.from_opk(np.deg2rad([0.4, -89.5, -0.3]), [-0.36, -0.01, -0.25])
RELATIVE = Rigid.from_opk(np.deg2rad([-0.5, -1.0, 88.0]), [0.02, -0.06, 0.11])
"""``T_ccs_scs``."""
SOURCE = Source(run="yard", method="cones")


def spread(seed, shift_m, turn_rad):
    """A full covariance (6, 6)."""
    root = np.random.default_rng(seed).standard_normal((6, 6)) * np.repeat([shift_m, turn_rad], 3)[:, None]
    return root @ root.T


def boat():
    """As `thalweg.calibration.boat`: the camera comes from lidar and relative orientation."""
    lidar, relative = LIDAR.with_cov(spread(1, 1e-3, 1e-3)), RELATIVE.with_cov(spread(2, 3e-4, 1e-4))
    inverse = relative.inverse()
    camera = lidar @ inverse
    by_lidar, by_inverse = lidar.by_product(inverse)
    J = np.zeros((12, 12))
    J[:6, :6] = np.eye(6)
    J[6:, :6], J[6:, 6:] = by_lidar, by_inverse @ relative.by_inverse()
    apart = np.zeros((12, 12))
    apart[:6, :6], apart[6:, 6:] = lidar.cov, relative.cov
    joint = J @ apart @ J.T
    blocks, units = [], []
    for name, pose in (("lidar", lidar), ("camera", camera)):
        blocks.append(pose_block(name, pose)[0])
        units += [3, 4, 5, 0, 1, 2]
    order = np.array(units) + np.repeat([0, 6], 6)
    unit = np.tile(np.repeat([180 / np.pi, 1.0], 3), 2)
    cov = np.zeros((15, 15))
    cov[:12, :12] = joint[np.ix_(order, order)] * np.outer(unit, unit)
    return Calibration(
        title="Boat", blocks=(*blocks, lever_block("antenna", [0.1, 0.0, -0.4])), cov=cov, source=SOURCE
    )


def test_the_covariance_is_that_of_the_relative_orientation(tmp_path):
    calibration = boat()
    mounts = resolve_mounts({}, calibration)
    placed, T_ics_ccs, facts = lidar_mount_by_camera(mounts, calibration)
    write_mounts(tmp_path / "mounts_camera.json", placed)
    mount = Rigid.from_mount(read_mounts(tmp_path / "mounts_camera.json")["lidar"])
    # twelve digits stand in a calibration, sixteen in a mount
    assert np.allclose(mount.R, LIDAR.R, atol=1e-12)
    assert np.allclose(mount.shift_m, LIDAR.shift_m, atol=1e-12)
    turn = np.kron(np.eye(2), T_ics_ccs.R)
    expected = turn @ spread(2, 3e-4, 1e-4) @ turn.T
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    # the relative orientation is a difference of two places whose errors are ten times larger: 1e-16 of those
    assert np.abs((mount.cov - expected) / scale).max() < 1e-9
    assert placed["antenna"] == mounts["antenna"]
    assert facts["notes"] == []
    assert "yard" in facts["relative_orientation"]


def test_without_the_joint_covariance_both_mounts_count_in_full():
    calibration = boat()
    placed, _, facts = lidar_mount_by_camera(resolve_mounts({}, calibration), None)
    own = Rigid.from_mount(resolve_mounts({}, calibration)["lidar"])
    mount = Rigid.from_mount(placed["lidar"])
    assert np.all(mount.sigma_rotation_rad > own.sigma_rotation_rad)
    assert "not known" in facts["relative_orientation"]


def test_a_calibration_of_camera_and_lidar_alone_is_used_and_compared():
    calibration = boat()
    mounts = resolve_mounts({}, calibration)
    block, cov = pose_block("camera_lidar", RELATIVE.with_cov(spread(2, 3e-4, 1e-4)))
    relative = Calibration(title="Relative", blocks=(block,), cov=cov, source=SOURCE)
    placed, _, facts = lidar_mount_by_camera(mounts, relative)
    assert facts["notes"] == []
    assert np.allclose(Rigid.from_mount(placed["lidar"]).R, LIDAR.R, atol=1e-9)
    turned = Rigid(R=exp_rotation([0, 0, 0.05]) @ RELATIVE.R, shift_m=RELATIVE.shift_m, cov=RELATIVE.cov)
    block, cov = pose_block("camera_lidar", turned.with_cov(spread(2, 3e-4, 1e-4)))
    wrong = Calibration(title="Relative", blocks=(block,), cov=cov, source=SOURCE)
    (note,) = lidar_mount_by_camera(mounts, wrong)[2]["notes"]
    assert "2.86 degrees from its own mount" in note


def test_a_boat_without_a_camera_is_refused():
    with pytest.raises(ConfigError, match="no camera"):
        lidar_mount_by_camera({"lidar": {}}, None)
