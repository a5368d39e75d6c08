"""Poses of images drawn about the true motion with errors of stated sigmas, as a block of images gives them.

Rendering and orienting images costs seconds an image. What the trajectories take from them is a pose, its
covariance and a time; here these are drawn, with the published sigmas if nothing is said (P2 Table 1).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.frames import LocalFrame, opk_axes
from thalweg.core.rigid import Rigid, exp_rotation
from thalweg.core.types import ArrayF
from thalweg.images.model.poses import ImagePoses
from thalweg_lab.base.random import generator
from thalweg_lab.voyage.motion import Motion

MARKS: Final = 300.0
RESIDUAL_PX: Final = 0.5
"""What the table of poses says of the marks of an image; no trajectory uses it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageErrors:
    """How poses and times of images err.

    Parameters
    ----------
    sigma_m : (3,) of the projection centre, east, north, up.
    sigma_opk_deg : (3,) of omega, phi, kappa of ``R_wcs_ccs``.
    time_s : correlation time of both along the series; the papers do not state one.
    jitter_s : scatter of the single times.
    sigma_clock_s : of an offset that all times share (P2: 4 ms).
    interval_s : between images.
    """

    sigma_m: tuple[float, float, float] = (0.0051, 0.0054, 0.0051)
    sigma_opk_deg: tuple[float, float, float] = (0.078, 0.004, 0.078)
    time_s: float = 4.0
    jitter_s: float = 0.023
    sigma_clock_s: float = 0.004
    interval_s: float = 1.0


def draw_images(
    seed: int, motion: Motion, frame: LocalFrame, true_T_ics_ccs: Rigid, errors: ImageErrors
) -> ImagePoses:
    """Poses of images of a voyage with the errors of a block and of the camera's clock.

    Parameters
    ----------
    seed : of the survey; poses, jitter and offset have random numbers of their own.
    motion : the true one.
    frame : the world frame.
    true_T_ics_ccs : where the camera really sits.
    errors : their sizes.
    """
    stamp = motion.start_gps_s + np.arange(0.5, motion.config.duration_s - 0.5, errors.interval_s)
    n = len(stamp)
    clock_s = errors.sigma_clock_s * float(generator(seed, "drawn images clock").standard_normal())
    jitter = errors.jitter_s * generator(seed, "drawn images jitter").standard_normal(n)
    exposed = stamp + clock_s + jitter
    R_wcs_ics = motion.R_wcs_ics(exposed)
    R = R_wcs_ics @ true_T_ics_ccs.R
    root = _roots(R, errors)
    keep = float(np.exp(-errors.interval_s / errors.time_s))
    unit = generator(seed, "drawn images poses").standard_normal((n, 6))
    for k in range(1, n):
        unit[k] = keep * unit[k - 1] + np.sqrt(1 - keep**2) * unit[k]
    # an error moves the estimate to the truth
    error = np.einsum("nij,nj->ni", root, unit)
    following = np.zeros((n, 6, 6))
    following[:-1] = keep * root[:-1] @ np.swapaxes(root[1:], 1, 2)
    return ImagePoses(
        frame=frame,
        images=tuple(f"{k:05d}.jpg" for k in range(n)),
        t_gps_s=stamp,
        sigma_t_s=np.full(n, np.hypot(errors.jitter_s, errors.sigma_clock_s)),
        oriented=np.ones(n, dtype=np.bool_),
        reasons=("",) * n,
        centre_wcs_m=motion.position_wcs_m(exposed) + R_wcs_ics @ true_T_ics_ccs.shift_m - error[:, :3],
        R_wcs_ccs=exp_rotation(-error[:, 3:]) @ R,
        cov_pose_wcs=root @ np.swapaxes(root, 1, 2),
        cov_next=following,
        n_marks=np.full(n, MARKS),
        rms_px=np.full(n, RESIDUAL_PX),
        facts={"image_times": {"sigma_common_s": errors.sigma_clock_s, "independent_of_ins": True}},
    )


def _roots(R_wcs_ccs: ArrayF, errors: ImageErrors) -> ArrayF:
    """Roots (n, 6, 6) of the covariances in wcs; the sigmas of angles act about the axes of the angles."""
    phi = np.arcsin(np.clip(R_wcs_ccs[:, 0, 2], -1.0, 1.0))
    omega = np.arctan2(-R_wcs_ccs[:, 1, 2], R_wcs_ccs[:, 2, 2])
    root = np.zeros((len(R_wcs_ccs), 6, 6))
    root[:, :3, :3] = np.diag(errors.sigma_m)
    root[:, 3:, 3:] = opk_axes(omega, phi) * np.deg2rad(errors.sigma_opk_deg)
    return root
