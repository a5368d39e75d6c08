"""Where the camera was and looked when each image was taken, as far as the other sensors know.

The clock of the camera gives the time of an image, the trajectory of the INS the pose of the boat, the mount
that of the camera: ``T_wcs_ccs = T_wcs_ics(t) T_ics_ccs``. Good to some decimetres and tenths of a degree at
best, and much worse where the clock is known by hand only; that is enough to choose pairs of images, to look
for control points and to draw the water's edge, and its covariance says so.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
import pandas as pd

from thalweg.clocks import ClockModel
from thalweg.core import ArrayF, CoverageError, Rigid, Trajectory, rotation_vector, utc_text_from_gps
from thalweg.images.model import ImagePoses, in_folders
from thalweg.settings.sections import StatedClock

_BEYOND_S: Final = 0.2
"""The trajectory's rate just beside its ends is taken from this far inside."""

NO_STAMP: Final = "the image has no time stamp"
OFF_BOAT: Final = "its camera is not at its place on the boat (images.off_boat)"
OUTSIDE: Final = "the trajectory does not reach the time of the image"


def stated_clock(stamps: pd.DataFrame, stated: StatedClock, source: str) -> ClockModel:
    """The clock of a camera as a campaign file states it; stamps in coarse steps are uncertain by these, too.

    Parameters
    ----------
    stamps : table kind ``image_stamps``.
    stated : the section.
    source : its name.
    """
    known = stamps.dropna(subset=["t_device_s"])
    step_s = float(known["resolution_s"].max()) if len(known) else 0.0
    return ClockModel(
        offset_s=stated.offset_s,
        reference_s=float(known["t_device_s"].median()) if len(known) else 0.0,
        cov=np.diag([stated.sigma_offset_s**2, 0.0]),
        jitter_s=float(np.hypot(stated.jitter_s, step_s / np.sqrt(12))),
        source=source,
    )


def predict_image_poses(
    stamps: pd.DataFrame,
    clock: ClockModel,
    trajectory: Trajectory,
    T_ics_ccs: Rigid,
    *,
    off_boat: Sequence[str] = (),
) -> ImagePoses:
    """Poses of images from the trajectory of the boat.

    Parameters
    ----------
    stamps : table kind ``image_stamps``.
    clock : of the camera against GPS time.
    trajectory : ``T_wcs_ics`` over time.
    T_ics_ccs : mount of the camera, with covariance.
    off_boat : folders of images whose camera has another place: they get neither pose nor time.

    Returns
    -------
    poses : of all images, in the order of the table; those without stamp or outside the trajectory have no
        pose and say why. Errors of neighbours are not told apart: ``cov_next`` is zero.

    Raises
    ------
    CoverageError : no image lies inside the trajectory.
    """
    device_s = stamps["t_device_s"].to_numpy(np.float64)
    elsewhere = in_folders(stamps["file"], off_boat)
    stamped = np.isfinite(device_s) & ~elsewhere
    t, sigma_t = np.full(len(stamps), np.nan), np.full(len(stamps), np.nan)
    if stamped.any():
        t[stamped], sigma_t[stamped] = clock.to_gps(device_s[stamped])
    n = len(stamps)
    centre, R = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    cov = np.full((n, 6, 6), np.nan)
    position, attitude, inside = trajectory.at(np.where(stamped, t, trajectory.t_gps_s[0] - 1.0))
    inside &= stamped
    if not inside.any():
        raise CoverageError(_missed(t[stamped], trajectory, n), **_CURE)
    rates = _rates(trajectory, t[inside])
    cov_ics = trajectory.cov_at(t[inside])
    for k, row in enumerate(np.flatnonzero(inside)):
        moved = cov_ics[k] + np.outer(rates[k], rates[k]) * sigma_t[row] ** 2
        pose = Rigid(R=attitude[row], shift_m=position[row], cov=(moved + moved.T) / 2) @ T_ics_ccs
        centre[row], R[row], cov[row] = pose.shift_m, pose.R, pose.cov
    reasons = np.where(inside, "", np.where(stamped, OUTSIDE, np.where(elsewhere, OFF_BOAT, NO_STAMP)))
    return ImagePoses(
        frame=trajectory.frame,
        images=tuple(stamps["file"].astype(str)),
        t_gps_s=t,
        sigma_t_s=sigma_t,
        oriented=inside,
        reasons=tuple(reasons.tolist()),
        centre_wcs_m=centre,
        R_wcs_ccs=R,
        cov_pose_wcs=cov,
        cov_next=np.zeros((n, 6, 6)),
        n_marks=np.zeros(n),
        rms_px=np.full(n, np.nan),
        facts={
            "source": "trajectory of the INS",
            "clock": clock.source,
            # of the offset, which all images share; the rest of the sigmas is jitter
            "sigma_common_s": float(np.median(clock.to_gps(device_s[inside], jitter=False)[1])),
        },
    )


_CURE: Final = {
    "expected": "images of the same survey",
    "cure": "Check the clock of the camera (images.clock, rig.clock or the calibration's), its zone, and the "
    "dates of the logs",
}


def _missed(t: ArrayF, trajectory: Trajectory, n: int) -> str:
    begin, end = trajectory.span()
    survey = f"the trajectory covers {utc_text_from_gps(begin)} .. {utc_text_from_gps(end)}"
    if len(t) == 0:
        return f"none of {n} images has a time stamp; {survey}"
    return (
        f"{len(t)} images were taken from {utc_text_from_gps(t.min())} to {utc_text_from_gps(t.max())} by "
        f"the model of the camera's clock, none inside a valid part of the trajectory; {survey}"
    )


def _rates(trajectory: Trajectory, t: ArrayF) -> ArrayF:
    """Linear and angular speed (n, 6) of the boat, m/s and rad/s in wcs, about times inside."""
    first, last = trajectory.t_gps_s[0], trajectory.t_gps_s[-1]
    before, after = np.clip(t - _BEYOND_S, first, last), np.clip(t + _BEYOND_S, first, last)
    x0, R0, _ = trajectory.at(before)
    x1, R1, _ = trajectory.at(after)
    step = np.maximum(after - before, 1e-9)[:, None]
    turn = rotation_vector(R1 @ np.swapaxes(R0, 1, 2))
    return np.hstack([(x1 - x0) / step, turn / step])
