"""Lidar points into the world frame, each with the pose of its own moment (P1 eq. 7-8, T 3.1.1).

``x_ics = R_ics_scs @ x_scs + lever_ics_scs`` and ``x_wcs = R_wcs_ics(t) @ x_ics + x_wcs_ics(t)``.

The kernel makes one pass over the points: they come nearly in time order, so the node interval is carried
along instead of searched; attitudes are interpolated along the chord and normalised, which differs from
slerp by less than ``a**3 / 124`` for an angle ``a`` between nodes (1e-9 rad at 50 Hz and 7 deg/s).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numba as nb
import numpy as np
from numpy.typing import ArrayLike

from thalweg.core.errors import GeometryError
from thalweg.core.frames import rotation_opk
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayB, ArrayF, ArrayF32

# Open3D brings an old TBB into the process, which numba would try first and complain about.
nb.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Mount:
    """A sensor on the boat: ``x_ics = R_ics_sensor @ x_sensor + lever_ics_m``.

    Parameters
    ----------
    R_ics_sensor : (3, 3) rotation.
    lever_ics_m : (3,) sensor origin in the body frame.

    Raises
    ------
    GeometryError : the matrix is no rotation.
    """

    R_ics_sensor: ArrayF
    lever_ics_m: ArrayF

    def __post_init__(self) -> None:
        R = np.asarray(self.R_ics_sensor)
        # 1e-9: a product of three rotations in float64 is orthogonal to a few 1e-16.
        if R.shape != (3, 3) or not np.allclose(R @ R.T, np.eye(3), atol=1e-9) or np.linalg.det(R) < 0:
            raise GeometryError("R_ics_sensor is no rotation matrix", expected="orthogonal, determinant +1")

    @classmethod
    def from_section(cls, section: Mapping[str, Any]) -> Self:
        """The mount that a campaign file describes: omega, phi, kappa in degrees, ``lever_ics_m``."""
        angles = np.deg2rad([section["omega_deg"], section["phi_deg"], section["kappa_deg"]])
        return cls(
            R_ics_sensor=rotation_opk(*angles),
            lever_ics_m=np.asarray(section["lever_ics_m"], dtype=np.float64),
        )


def georeference_points(
    xyz_scs_m: ArrayLike, t_gps_s: ArrayLike, trajectory: Trajectory, mount: Mount
) -> tuple[ArrayF, ArrayB]:
    """Transform points of a moving scanner into the world frame.

    Parameters
    ----------
    xyz_scs_m : (n, 3) float32 or float64, scanner frame.
    t_gps_s : (n,) time of each point; NaN gives no pose.
    trajectory : poses of the boat.
    mount : pose of the scanner on the boat.

    Returns
    -------
    points_wcs_m : (n, 3) float64; NaN where there is no valid pose.
    has_pose : (n,) false outside the trajectory, in its gaps, and for points without GPS time.
    """
    xyz = np.ascontiguousarray(xyz_scs_m, dtype=np.float32)
    t = np.ascontiguousarray(t_gps_s, dtype=np.float64)
    if xyz.ndim != 2 or xyz.shape[1] != 3 or t.shape != (len(xyz),):
        raise GeometryError(f"{xyz.shape=}, {t.shape=}", expected="(n, 3) points and (n,) times")
    points = np.empty((len(xyz), 3))
    has_pose = np.zeros(len(xyz), dtype=np.bool_)
    _georeference(
        xyz,
        t,
        trajectory.t_gps_s,
        trajectory.position_wcs_m,
        trajectory.quaternion_wcs_ics,
        trajectory.valid,
        np.ascontiguousarray(mount.R_ics_sensor, dtype=np.float64),
        np.ascontiguousarray(mount.lever_ics_m, dtype=np.float64),
        points,
        has_pose,
    )
    return points, has_pose


@nb.njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def _georeference(
    xyz: ArrayF32,
    t: ArrayF,
    node_t: ArrayF,
    node_x: ArrayF,
    node_q: ArrayF,
    node_valid: ArrayB,
    R: ArrayF,
    lever: ArrayF,
    out: ArrayF,
    has_pose: ArrayB,
) -> None:
    n, m = len(t), len(node_t)
    block = 16384  # large enough to amortise one binary search, small enough to balance two cores
    for b in nb.prange((n + block - 1) // block):
        start, stop = b * block, min((b + 1) * block, n)
        j = min(max(np.searchsorted(node_t, t[start], side="right") - 1, 0), m - 2)
        for i in range(start, stop):
            ti = t[i]
            if not (ti >= node_t[0] and ti <= node_t[m - 1]):
                out[i, 0] = out[i, 1] = out[i, 2] = np.nan
                continue
            while j < m - 2 and ti >= node_t[j + 1]:
                j += 1
            while j > 0 and ti < node_t[j]:
                j -= 1
            if not (node_valid[j] and node_valid[j + 1]):
                out[i, 0] = out[i, 1] = out[i, 2] = np.nan
                continue
            u = (ti - node_t[j]) / (node_t[j + 1] - node_t[j])
            v = 1.0 - u
            x, y, z = xyz[i, 0], xyz[i, 1], xyz[i, 2]
            bx = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + lever[0]
            by = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + lever[1]
            bz = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + lever[2]
            q0 = v * node_q[j, 0] + u * node_q[j + 1, 0]
            q1 = v * node_q[j, 1] + u * node_q[j + 1, 1]
            q2 = v * node_q[j, 2] + u * node_q[j + 1, 2]
            q3 = v * node_q[j, 3] + u * node_q[j + 1, 3]
            # x' = x + 2/|q|^2 q_v x (q_v x x + q_w x): rotation by an unnormalised quaternion
            g = 2.0 / (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
            cx = q1 * bz - q2 * by + q3 * bx
            cy = q2 * bx - q0 * bz + q3 * by
            cz = q0 * by - q1 * bx + q3 * bz
            out[i, 0] = bx + g * (q1 * cz - q2 * cy) + v * node_x[j, 0] + u * node_x[j + 1, 0]
            out[i, 1] = by + g * (q2 * cx - q0 * cz) + v * node_x[j, 1] + u * node_x[j + 1, 1]
            out[i, 2] = bz + g * (q0 * cy - q1 * cx) + v * node_x[j, 2] + u * node_x[j + 1, 2]
            has_pose[i] = True
