"""What tests of several packages are made of."""

import numpy as np
from scipy.spatial.transform import Rotation

from thalweg.core import LocalFrame, Trajectory
from thalweg.images.model import ImagePoses

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)


def trajectory_of(t_gps_s, position_m=0.0, attitude=None, cov=1e-4, *, valid=True, frame=FRAME):
    """A trajectory at these times; what is given once holds for all of them.

    Parameters
    ----------
    position_m : (n, 3) or what makes it by repetition.
    attitude : n rotations of scipy from ics to wcs; absent: level, ics is wcs.
    cov : (n, 6, 6), (6, 6), or a variance of all six.
    """
    n = len(t_gps_s)
    attitude = Rotation.identity(n) if attitude is None else attitude
    cov = cov * np.eye(6) if np.ndim(cov) == 0 else cov
    return Trajectory(
        frame=frame,
        t_gps_s=np.array(t_gps_s, float),
        position_wcs_m=np.broadcast_to(position_m, (n, 3)).astype(float),
        quaternion_wcs_ics=np.broadcast_to(attitude.as_quat(), (n, 4)).copy(),
        cov_pose_wcs=np.broadcast_to(cov, (n, 6, 6)).astype(float),
        valid=np.broadcast_to(valid, n).astype(bool),
    )


def image_poses_of(centre_m, R, t_gps_s=None, cov=1e-6, *, oriented=True, names=None, **more):
    """Poses of images that share no error; what is given once holds for all of them.

    Parameters
    ----------
    centre_m : (n, 3) places of the camera.
    R : (n, 3, 3) or (3, 3), from ccs to wcs.
    cov : (n, 6, 6), or a variance of all six.
    names : of the files; absent: by their numbers.
    """
    n = len(centre_m)
    oriented = np.broadcast_to(oriented, n)
    cov = cov * np.eye(6) if np.ndim(cov) == 0 else cov
    given = {
        "frame": FRAME,
        "images": tuple(names or (f"{k}.jpg" for k in range(n))),
        "t_gps_s": np.full(n, np.nan) if t_gps_s is None else np.array(t_gps_s, float),
        "sigma_t_s": np.full(n, 0.02),
        "oriented": oriented.copy(),
        "reasons": tuple("" if known else "blurred" for known in oriented),
        "centre_wcs_m": np.array(centre_m, float),
        "R_wcs_ccs": np.broadcast_to(R, (n, 3, 3)).copy(),
        "cov_pose_wcs": np.broadcast_to(cov, (n, 6, 6)).astype(float),
        "cov_next": np.zeros((n, 6, 6)),
        "n_marks": np.full(n, 50.0),
        "rms_px": np.full(n, 0.4),
    }
    return ImagePoses(**given | more)
