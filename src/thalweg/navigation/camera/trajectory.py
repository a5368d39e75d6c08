"""The trajectory of the boat by its camera (P2 section 4).

Images give the pose of the boat at their times, the INS carries it to the times between::

    D_i = T_wcs_ics(image i) - carrier(t_i)          shift and rotation, in wcs
    T_wcs_ics(t) = carrier(t) + (1 - u) D_i + u D_i+1,      u = (t - t_i) / (t_i+1 - t_i)

so that motion faster than the images comes from the INS and everything slower from the images. Published is
one lidar frame an image: half a rotation before and behind it. Poses may also be bridged from image to image,
up to a longest gap. At an image without a neighbour the correction stays that of the image.

The covariance of a pose is that of the images (with what neighbours have in common), of their times by the
boat's actual linear and angular speed (P2 eq. 6), and of the INS's errors since the image. It does not hold
the mount of the camera: that error is the same in the lidar's place on the boat, if that is taken through the
camera, and drops out of the cloud.
"""

import logging
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from thalweg.core.errors import ClockError, CoverageError
from thalweg.core.rigid import Rigid
from thalweg.core.timescales import utc_text_from_gps
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayB, ArrayF
from thalweg.images.model.poses import ImagePoses
from thalweg.navigation.camera.carrier import (
    Carrier,
    TrajectoryCarrier,
    VelocityCarrier,
    attitude_growth,
)
from thalweg.navigation.camera.errors import carried_errors, errors_facts, scaled
from thalweg.navigation.camera.images import (
    CONTRADICTS,
    BoatImages,
    boat_images,
    corrected,
    interpolated_covariance,
    linked,
)
from thalweg.navigation.camera.report import image_table, time_facts
from thalweg.navigation.camera.screen import neighbour_tests
from thalweg.navigation.camera.settings import CloudSettings
from thalweg.navigation.camera.spans import Spans, node_times, pose_spans

_ROUNDS: Final = 50
_MOST_REJECTED: Final = 0.3
_STRANGE: Final = 1.5
"""Neighbours that differ by more than this many times what their sigmas explain are worth a note."""
_IMPOSSIBLE: Final = 10.0
"""And by this many times: images and INS are not of the same motion."""

_LOG = logging.getLogger("thalweg")


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraTrajectory:
    """Result of `camera_trajectory`.

    ``trajectory``; ``images``, a row an image: whether it is used, its frame and why not; ``facts`` numbers
    and notes for a report.
    """

    trajectory: Trajectory
    images: pd.DataFrame
    facts: dict[str, Any]


def camera_trajectory(
    poses: ImagePoses,
    T_ics_ccs: Rigid,
    settings: CloudSettings,
    *,
    states: pd.DataFrame,
    sigma_attitude_rad: ArrayLike,
    max_attitude_gap_s: float,
    trajectory: Trajectory | None = None,
) -> CameraTrajectory:
    """Poses of the boat by images, carried by the INS.

    Parameters
    ----------
    poses : of the images, with times; ``facts["image_times"]["sigma_common_s"]``, if there, is the part of
        the times' errors that all images share.
    T_ics_ccs : mount of the camera.
    settings : see there.
    states : table kind ``ins_state``.
    sigma_attitude_rad : (3,) roll, pitch, heading; stands in where the log states none.
    max_attitude_gap_s : longest hole between INS states that is interpolated.
    trajectory : of INS and positions; needed if ``settings.motion`` is ``trajectory``.

    Raises
    ------
    CoverageError : no image can be used.
    ClockError : images and INS are of different motions, or a third of the images contradict the others.
    """
    ins: dict[str, Any] = {"sigma_attitude_rad": sigma_attitude_rad, "max_attitude_gap_s": max_attitude_gap_s}
    carrier = _carrier(poses, settings, states, trajectory, **ins)
    as_stated, reasons = boat_images(poses, T_ics_ccs, carrier, sigma_time_s=settings.sigma_time_s)
    if not len(as_stated.row):
        raise CoverageError(_nothing(poses, carrier, reasons), **_CURE)
    common_s = float(poses.facts.get("image_times", {}).get("sigma_common_s") or 0.0)
    notes = list(carrier.notes)
    scatter = _scatter(as_stated, carrier, settings, common_s, notes)
    sigma_t = np.where(np.isfinite(poses.sigma_t_s), poses.sigma_t_s, settings.sigma_time_s)
    poses = poses.with_times(poses.t_gps_s, sigma_t)
    settings, errors = carried_errors(poses, T_ics_ccs, settings, states, common_time_s=common_s, **ins)
    all_images, _ = boat_images(
        scaled(poses, settings, common_s), T_ics_ccs, carrier, sigma_time_s=settings.sigma_time_s
    )
    images = _screened(all_images, carrier, settings, common_s, reasons)
    joined = linked(images, settings.max_gap_s)
    spans = pose_spans(images, joined, carrier, settings)
    t, valid = node_times(spans, carrier, images.t_gps_s)
    position, R, cov = poses_at(t[valid], images, joined, spans, carrier, settings, common_s)
    found = _filled(poses, t, valid, position, R, cov)
    facts = {
        "frames": settings.frames,
        "motion": settings.motion,
        "images": len(poses.images),
        "images_used": len(images.row),
        "images_left_out": _counts(reasons),
        "sigma_common_time_s": common_s,
        "mount_of_camera": "not in the covariance: its error drops out with the lidar placed by the camera",
        "median_sigma_position_m": np.median(found.sigma_position_m[valid], axis=0).tolist(),
        "median_sigma_rotation_deg": np.rad2deg(np.median(_sigma_rotation(found)[valid], axis=0)).tolist(),
        "neighbours_differ_by_sigmas": scatter,
        "errors": errors_facts(errors),
        **time_facts(images, joined, spans, carrier, settings),
        "notes": [*notes, *errors.notes()],
    }
    for note in notes:
        _LOG.warning("%s", note)
    return CameraTrajectory(
        trajectory=found, images=image_table(poses, images, reasons, joined, spans), facts=facts
    )


def poses_at(
    t_gps_s: ArrayF,
    images: BoatImages,
    joined: ArrayB,
    spans: Spans,
    carrier: Carrier,
    settings: CloudSettings,
    common_time_s: float,
) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Position (n, 3), ``R_wcs_ics`` (n, 3, 3) and covariance (n, 6, 6) at times within the spans."""
    between = spans.between(t_gps_s, images.t_gps_s, joined)
    at = carrier.at(t_gps_s)
    position, R = corrected(images, at, between)
    cov = interpolated_covariance(images, between, common_time_s)
    dt = t_gps_s - images.t_gps_s[between.left]
    gap = images.t_gps_s[between.right] - images.t_gps_s[between.left]
    cov[:, :3, :3] += carrier.way_variance_m2(dt, between.share, gap, settings)[:, None, None] * np.eye(3)
    cov[:, 3:, 3:] += attitude_growth(at, dt, between.share, gap, settings)
    return position, R, (cov + np.swapaxes(cov, 1, 2)) / 2


def _carrier(
    poses: ImagePoses,
    settings: CloudSettings,
    states: pd.DataFrame,
    trajectory: Trajectory | None,
    *,
    sigma_attitude_rad: ArrayLike,
    max_attitude_gap_s: float,
) -> Carrier:
    if settings.motion == "trajectory":
        if trajectory is None:
            raise CoverageError(
                "no trajectory of INS and positions is given",
                expected="one, as images.cloud.motion asks for it",
            )
        return TrajectoryCarrier(trajectory)
    known = poses.oriented & np.isfinite(poses.t_gps_s)
    if not known.any():
        raise CoverageError(_empty(poses), **_CURE)
    order = np.flatnonzero(known)[np.argsort(poses.t_gps_s[known], kind="stable")]
    return VelocityCarrier(
        states, poses.frame,
        sigma_attitude_rad=sigma_attitude_rad, max_attitude_gap_s=max_attitude_gap_s,
        near_t_s=poses.t_gps_s[order], near_wcs_m=poses.centre_wcs_m[order],
    )  # fmt: skip


def _scatter(
    images: BoatImages, carrier: Carrier, settings: CloudSettings, common_s: float, notes: list[str]
) -> float | None:
    """By how many of their stated sigmas neighbours differ; writes into ``notes``."""
    test = neighbour_tests(images, linked(images, settings.max_gap_s), carrier, settings, common_s)
    known = np.isfinite(test)
    if not known.any():
        return None
    scatter = float(np.sqrt(np.median(test[known]) / chi2.ppf(0.5, 6)))
    _judge(scatter, notes)
    return scatter


def _screened(
    images: BoatImages, carrier: Carrier, settings: CloudSettings, common_s: float, reasons: list[str]
) -> BoatImages:
    """Images without those that contradict their neighbours; writes into ``reasons``."""
    n_first = len(images.row)
    middle = float(chi2.ppf(0.5, 6))
    for _ in range(_ROUNDS):
        test = neighbour_tests(images, linked(images, settings.max_gap_s), carrier, settings, common_s)
        known = np.isfinite(test)
        if not known.any() or settings.outlier_probability == 0:
            break
        ratio = float(np.median(test[known])) / middle
        limit = max(ratio, 1.0) * float(chi2.ppf(1.0 - settings.outlier_probability, 6))
        # a bad image spoils the tests of its neighbours: of three only the worst goes
        padded = np.concatenate([[-1.0], np.nan_to_num(test, nan=-1.0), [-1.0]])
        worst = (test > limit) & (padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:])
        if not worst.any():
            break
        for row in images.row[worst].tolist():
            reasons[row] = CONTRADICTS
        images = images.take(~worst)
    lost = n_first - len(images.row)
    if lost > _MOST_REJECTED * n_first:
        raise ClockError(
            f"{lost} of {n_first} images contradict their neighbours and the motion of the INS",
            expected=f"at most {_MOST_REJECTED:.0%}",
            cure="Check the block adjustment of the images and their times",
        )
    return images


def _judge(scatter: float, notes: list[str]) -> None:
    """Say how well images and INS agree on the motion; refuse what cannot be of the same one."""
    if scatter > _IMPOSSIBLE:
        raise ClockError(
            f"between images the boat moves otherwise than the INS says: neighbours differ by {scatter:.0f} "
            "times what their sigmas explain",
            expected="images and INS of the same motion",
            cure="Check the times of the images (clock of the camera, its offset), the mount of the camera "
            "and the world frame of the block",
        )
    if scatter > _STRANGE:
        notes.append(
            f"Neighbouring images differ by {scatter:.1f} times what their sigmas, times and the INS "
            "explain: the sigmas of the block or of the times are too small, or the INS changes faster than "
            "images.cloud.attitude_time_s says"
        )


def _filled(
    poses: ImagePoses, t: ArrayF, valid: ArrayB, position: ArrayF, R: ArrayF, cov: ArrayF
) -> Trajectory:
    """All nodes; those between frames repeat the pose before them and are invalid."""
    last = np.maximum(np.cumsum(valid) - 1, 0)
    return Trajectory(
        frame=poses.frame,
        t_gps_s=t,
        position_wcs_m=position[last],
        quaternion_wcs_ics=Rotation.from_matrix(R).as_quat()[last],
        cov_pose_wcs=cov[last],
        valid=valid,
    )


def _sigma_rotation(trajectory: Trajectory) -> ArrayF:
    return np.asarray(np.sqrt(np.diagonal(trajectory.cov_pose_wcs, axis1=1, axis2=2)[:, 3:]))


def _counts(reasons: list[str]) -> dict[str, int]:
    left = pd.Series([reason.partition(":")[0] for reason in reasons if reason], dtype=object)
    return {str(reason): int(n) for reason, n in left.value_counts().sort_index().items()}


_CURE: Final = {
    "expected": "oriented images of the same survey, with times",
    "cure": "Look at the reasons in images_report.csv, at the camera's clock and at the dates of the logs",
}


def _empty(poses: ImagePoses) -> str:
    return (
        f"none of {len(poses.images)} images has both a pose ({int(poses.oriented.sum())} have) and a time "
        f"({int(np.isfinite(poses.t_gps_s).sum())} have)"
    )


def _nothing(poses: ImagePoses, carrier: Carrier, reasons: list[str]) -> str:
    known = poses.t_gps_s[poses.oriented & np.isfinite(poses.t_gps_s)]
    if not len(known):
        return _empty(poses)
    found = ", ".join(f"{n} {reason}" for reason, n in _counts(reasons).items())
    first, last = carrier.t_gps_s[[0, -1]]
    return (
        f"none of {len(poses.images)} images can be used ({found}): they are of "
        f"{utc_text_from_gps(known.min())} .. {utc_text_from_gps(known.max())}, the INS of "
        f"{utc_text_from_gps(first)} .. {utc_text_from_gps(last)}"
    )
