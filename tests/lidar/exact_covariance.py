"""Covariance of lidar points as ``J S J^T`` with the derivatives of the chain of frames: slow and clear."""

from typing import Final

import numpy as np

from thalweg.core import ArrayF, Link, beam_axes, chain_derivatives, propagated

INPUTS: Final = (
    "east",
    "north",
    "up",
    "rotation_east",
    "rotation_north",
    "rotation_up",
    "lever_x",
    "lever_y",
    "lever_z",
    "mount_rotation_x",
    "mount_rotation_y",
    "mount_rotation_z",
    "range",
    "across_right",
    "across_up",
    "time",
)
"""Columns of `point_jacobian`."""


def point_jacobian(
    xyz_scs_m: ArrayF,
    R_wcs_ics: ArrayF,
    R_ics_scs: ArrayF,
    lever_ics_m: ArrayF,
    velocity_mps: ArrayF,
    rate_wcs_radps: ArrayF,
) -> ArrayF:
    """Derivatives of points in wcs by their inputs, see `INPUTS`, shape (n, 3, 16).

    Parameters
    ----------
    xyz_scs_m : (n, 3) points in the scanner frame.
    R_wcs_ics : (n, 3, 3) attitude at the time of each point.
    R_ics_scs, lever_ics_m : (3, 3), (3,) mount of the scanner.
    velocity_mps, rate_wcs_radps : (n, 3) velocity of the ics origin and angular velocity, both in wcs.
    """
    xyz = np.asarray(xyz_scs_m, dtype=np.float64)
    chain = chain_derivatives(
        [Link(rotation=R_wcs_ics, shift_m=np.zeros(3)), Link(rotation=R_ics_scs, shift_m=lever_ics_m)], xyz
    )
    platform, mount = chain.by_link
    moved = np.concatenate([velocity_mps, rate_wcs_radps], axis=1)
    out = np.empty((len(xyz), 3, 16))
    out[:, :, 0:6] = platform
    out[:, :, 6:12] = mount
    out[:, :, 12:15] = beam_axes(np.einsum("nij,nj->ni", chain.by_point, xyz))
    out[:, :, 15] = np.einsum("nij,nj->ni", platform, moved)
    return out


def point_covariance(
    jacobian: ArrayF,
    cov_pose_wcs: ArrayF,
    cov_mount_ics: ArrayF,
    variances: tuple[ArrayF, ArrayF],
    sigma_time_s: float = 0.0,
) -> ArrayF:
    """Covariance (n, 3, 3) of points in wcs: ``J S J^T``, the slow and clear form of the kernel.

    Parameters
    ----------
    jacobian : (n, 3, 16) from `point_jacobian`.
    cov_pose_wcs : (n, 6, 6) of the poses, see `thalweg.core.trajectory`.
    cov_mount_ics : (6, 6) of the mount: lever arm, rotation vector in ics.
    variances : (n,) along and (n,) across the beam, from `LidarAccuracy.variances`.
    sigma_time_s : standard deviation of the stamps.
    """
    along, across = variances
    S = np.zeros((len(jacobian), 16, 16))
    S[:, :6, :6] = cov_pose_wcs
    S[:, 6:12, 6:12] = cov_mount_ics
    S[:, 12, 12], S[:, 13, 13], S[:, 14, 14] = along, across, across
    S[:, 15, 15] = sigma_time_s**2
    return propagated(jacobian, S)
