"""Where the lidar sits on the boat if the camera says where the boat is.

``T_ics_scs = T_ics_ccs T_ccs_scs`` and ``T_wcs_scs = T_wcs_ccs T_ccs_ics T_ics_scs = T_wcs_ccs T_ccs_scs``:
the mount of the camera drops out, and with it the INS. So the place of the lidar carries the covariance of
the relative orientation of camera and lidar only (P2 eq. 3), not that of the INS-lidar calibration.
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from thalweg.core import ConfigError, Rigid
from thalweg.core.calibration import Calibration, Source, pose_block

_CONTRADICTION: Final = 4.0
"""Sigmas by which the place through the camera may differ from the lidar's own."""

_HALVES: Final = np.r_[3:6, 0:3]
"""A mount counts the rotation first, a transform the shift."""


def lidar_mount_by_camera(
    mounts: Mapping[str, Any], calibration: Calibration | None
) -> tuple[dict[str, Any], Rigid, dict[str, Any]]:
    """Mounts of a boat whose pose comes from the camera.

    Parameters
    ----------
    mounts : by sensor, as `thalweg.calibration.boat.read_mounts` gives them.
    calibration : of the boat with its joint covariance (boat.yaml), or None.

    Returns
    -------
    mounts, T_ics_ccs, facts : the same mounts with the lidar placed through the camera; the camera's mount
        that belongs to it; where the relative orientation is from, its sigmas, and a note if it contradicts
        the lidar's own mount.

    Raises
    ------
    ConfigError : there is no camera or no lidar among the mounts.
    """
    absent = [name for name in ("camera", "lidar") if name not in mounts]
    if absent:
        raise ConfigError(
            f"the mounts hold no {' and no '.join(absent)}",
            expected="the places of camera and lidar on the boat",
            cure="Name a calibration with both in mounts.calibration",
        )
    T_ics_ccs, own = Rigid.from_mount(mounts["camera"]), Rigid.from_mount(mounts["lidar"])
    T_ccs_scs, source = _relative(T_ics_ccs, own, calibration)
    if calibration is not None and "camera" in calibration:
        T_ics_ccs = calibration.pose("camera")
    exact = T_ics_ccs.with_cov(np.zeros((6, 6)))
    T_ics_scs = exact @ T_ccs_scs
    block, cov = pose_block("lidar", T_ics_scs)
    placed = Calibration(
        title="lidar by camera", blocks=(block,), cov=cov, source=Source(run="", method=source)
    ).to_mounts()["lidar"]
    facts: dict[str, Any] = {
        "relative_orientation": source,
        "sigma_shift_ccs_m": T_ccs_scs.sigma_shift_m.tolist(),
        "sigma_rotation_ccs_deg": np.rad2deg(T_ccs_scs.sigma_rotation_rad).tolist(),
        "notes": _contradictions(T_ics_scs, own, T_ics_ccs, joint="correlation" in source),
    }
    return {**mounts, "lidar": {**placed, "source": source}}, T_ics_ccs, facts


def _relative(T_ics_ccs: Rigid, T_ics_scs: Rigid, calibration: Calibration | None) -> tuple[Rigid, str]:
    """``T_ccs_scs`` with covariance, and where it is from."""
    if calibration is not None and "camera_lidar" in calibration:
        return calibration.pose("camera_lidar"), f"camera and lidar of calibration {calibration.source.run}"
    if calibration is not None and "camera" in calibration and "lidar" in calibration:
        camera, lidar = calibration.pose("camera"), calibration.pose("lidar")
        _, joint = calibration.joint(["camera", "lidar"])
        # a calibration counts degrees of rotation first, a transform metres of shift
        order = np.concatenate([_HALVES, 6 + _HALVES])
        unit = np.tile(np.repeat([1.0, np.pi / 180.0], 3), 2)
        cov = joint[np.ix_(order, order)] * np.outer(unit, unit)
        inverse = camera.inverse()
        first, second = inverse.by_product(lidar)
        J = np.hstack([first @ camera.by_inverse(), second])
        product = (inverse.with_cov(np.zeros((6, 6))) @ lidar).with_cov(J @ cov @ J.T)
        return (
            product,
            f"mounts of camera and lidar with their correlation, calibration {calibration.source.run}",
        )
    return (
        T_ics_ccs.inverse() @ T_ics_scs,
        "mounts of camera and lidar as if independent: how their errors hang together is not known",
    )


def _contradictions(found: Rigid, own: Rigid, camera: Rigid, *, joint: bool) -> list[str]:
    """A note if the lidar through the camera is elsewhere than its own mount says."""
    if joint:
        return []
    error = found.error_from(own)
    sigma = np.sqrt(np.diag(found.cov) + np.diag(own.cov) + np.diag(camera.cov))
    over = np.abs(error) / np.where(sigma > 0, sigma, np.inf)
    if over.max() <= _CONTRADICTION:
        return []
    return [
        f"The lidar placed through the camera is {1e3 * float(np.linalg.norm(error[:3])):.0f} mm and "
        f"{np.rad2deg(float(np.linalg.norm(error[3:]))):.2f} degrees from its own mount, {over.max():.0f} "
        "times what the sigmas explain"
    ]
