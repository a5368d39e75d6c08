"""First-order prediction of a georeferenced point's covariance from pose and lidar sigmas.

``x_wcs = x_wcs_ics + R_wcs_ics (R_ics_scs x_scs + l)``; with small angle errors about the axes of the
heading-pitch-roll sequence and an isotropic lidar error (T Table 3.1, P2 eq. 7)::

    C = C_position + A diag(sigma_roll^2, sigma_pitch^2, sigma_heading^2) A^T + sigma_component^2 I

where the columns of ``A`` are ``a_k x (x_wcs - x_wcs_pivot)`` and the pivot is the point of the boat whose
position was measured.
"""

import numpy as np

from thalweg.core.frames import R_ENU_NED, roll_pitch_heading
from thalweg.core.types import ArrayF


def attitude_axes(R_wcs_ics: ArrayF) -> ArrayF:
    """Axes in wcs about which roll, pitch and heading turn, shape (n, 3 angles, 3).

    Roll turns about body x, pitch about the horizontal axis to the right of the heading, heading about the
    vertical (clockwise, that is about down).
    """
    _, _, heading = roll_pitch_heading(R_wcs_ics)
    right_ned = np.stack([-np.sin(heading), np.cos(heading), np.zeros_like(heading)], axis=-1)
    down = np.broadcast_to(np.array([0.0, 0.0, -1.0]), right_ned.shape)
    return np.stack([R_wcs_ics[..., :, 0], right_ned @ R_ENU_NED.T, down], axis=-2)


def point_covariance(
    points_wcs_m: ArrayF,
    pivot_wcs_m: ArrayF,
    R_wcs_ics: ArrayF,
    cov_position_m2: ArrayF,
    sigma_attitude_rad: ArrayF,
    sigma_component_m: float,
) -> ArrayF:
    """Covariance (n, 3, 3) of points in wcs.

    Parameters
    ----------
    points_wcs_m : (n, 3).
    pivot_wcs_m : (n, 3) the measured point of the boat (the antenna) at the time of each point.
    R_wcs_ics : (n, 3, 3).
    cov_position_m2 : (n, 3, 3).
    sigma_attitude_rad : (n, 3) roll, pitch, heading.
    sigma_component_m : standard deviation of the lidar in each component.
    """
    arm = (points_wcs_m - pivot_wcs_m)[:, None, :]
    A = np.swapaxes(np.cross(attitude_axes(R_wcs_ics), arm), 1, 2) * sigma_attitude_rad[:, None, :]
    return cov_position_m2 + A @ np.swapaxes(A, 1, 2) + sigma_component_m**2 * np.eye(3)
