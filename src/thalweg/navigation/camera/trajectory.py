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
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Protocol, Self

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from pydantic import Field
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from thalweg.core import (
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayI,
    ClockError,
    CoverageError,
    ErrorChain,
    InputError,
    LocalFrame,
    Rigid,
    Trajectory,
    attitude_axes,
    cross_matrix,
    rotation_vector,
    utc_text_from_gps,
    with_rest,
)
from thalweg.images.model import ImagePoses
from thalweg.navigation.fusion import (
    SPREAD,
    FusionErrors,
    FusionSettings,
    Layout,
    Observed,
    Prior,
    Reference,
    camera_of,
    jumped_images,
    make_reference,
    place_nodes,
    solve,
    stated,
    with_errors,
)
from thalweg.navigation.ins_gnss import ATTITUDE_INITIALISED, TrajectorySummary, usable_states
from thalweg.settings.sections import CameraCloud, Positive

_ROUNDS: Final = 50
_MOST_REJECTED: Final = 0.3
_STRANGE: Final = 1.5
"""Neighbours that differ by more than this many times what their sigmas explain are worth a note."""
_IMPOSSIBLE: Final = 10.0
"""And by this many times: images and INS are not of the same motion."""
_LOG = logging.getLogger("thalweg")
_CURE: Final = {
    "expected": "oriented images of the same survey, with times",
    "cure": "Look at the reasons in images_report.csv, at the camera's clock and at the dates of the logs",
}
_REST_STEP_S: Final = 0.02
"""Least interval of the nodes of what the INS adds between images, whose frames last a tenth of a second."""
LEAST_IMAGES = 3
"""With fewer, what is stated counts alone."""
OF_POSITIONS = ("position_time_s", "position_white_share")
"""What images and INS do not show: errors of the trajectory of INS and positions."""
_SAME_S: Final = 1e-6
"""Nodes that are nearer are one: lidar points lie microseconds apart."""

SAME_TIME_S: Final = 1e-6
"""Images whose times differ by less are the same one twice."""
NO_POSE: Final = "no pose"
NO_TIME: Final = "no time"
NO_COVARIANCE: Final = "no covariance"
TWICE: Final = "same time as another image"
NO_INS: Final = "the INS does not cover its time"
CONTRADICTS: Final = "contradicts its neighbours and the INS"
_LONGEST_LINK: Final = 64
"""Images between two for which their common error is followed; farther ones are taken as unlike."""
_MOST_ALIKE: Final = 0.9999
"""Greatest correlation of two images' errors."""

_RATE_SPAN_S: Final = 0.05
"""Speeds of a trajectory are differences over this time to both sides."""
_EPOCH_S: Final = 0.1
"""Time within which the white part of the positions' errors is the same: a spline joins their epochs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Between:
    """Times between images: ``left``, ``right`` (n,) images, equal where only one counts; ``share`` (n,) of
    the right one.
    """

    left: ArrayI
    right: ArrayI
    share: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class Spans:
    """``begin_s``, ``end_s`` (n,) of the frame of each image; ``whole_s`` (k, 2) the spans with poses, in
    order and apart.
    """

    begin_s: ArrayF
    end_s: ArrayF
    whole_s: ArrayF

    def inside(self, t_gps_s: ArrayF) -> ArrayB:
        """Whether times (n,) have a pose."""
        k = np.searchsorted(self.whole_s[:, 0], t_gps_s, side="right") - 1
        return np.asarray((k >= 0) & (t_gps_s <= self.whole_s[np.maximum(k, 0), 1]))

    def between(self, t_gps_s: ArrayF, t_images_s: ArrayF, joined: ArrayB) -> Between:
        """Images that count at times within the spans, and how much."""
        n = len(t_images_s)
        after = np.searchsorted(t_images_s, t_gps_s, side="right")
        left, right = np.maximum(after - 1, 0), np.minimum(after, n - 1)
        both = (left < right) & np.append(joined, False)[left]
        gap = np.where(both, t_images_s[right] - t_images_s[left], 1.0)
        share = np.where(both, (t_gps_s - t_images_s[left]) / gap, 0.0)
        # between images that nothing joins: the one in whose frame it is, of both the nearer
        in_left, in_right = t_gps_s <= self.end_s[left], t_gps_s >= self.begin_s[right]
        nearer = np.abs(t_gps_s - t_images_s[left]) <= np.abs(t_images_s[right] - t_gps_s)
        one = np.where(in_left & (nearer | ~in_right), left, right)
        return Between(left=np.where(both, left, one), right=np.where(both, right, one), share=share)


@dataclass(frozen=True, slots=True, kw_only=True)
class Moments:
    """The carrier at n times: ``way_m`` (n, 3), ``R_wcs_ics`` (n, 3, 3), ``sigma_rad`` (n, 3) of roll, pitch,
    heading, ``rates`` (n, 6) velocity in m/s and angular velocity in rad/s, in wcs.
    """

    way_m: ArrayF
    R_wcs_ics: ArrayF
    sigma_rad: ArrayF
    rates: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class BoatImages:
    """Images of a table of poses, in order of time, as poses of the boat.

    ``row`` (n,) rows of the table; ``t_gps_s``, ``sigma_t_s`` (n,); ``position_wcs_m`` (n, 3) and
    ``R_wcs_ics`` (n, 3, 3); ``cov`` (n, 6, 6) of the ics pose without mount and time; ``moments`` the carrier
    at their times; ``stretch`` (n,) the unbroken stretch of the carrier that each lies in; ``root`` (n, 6, 6)
    with ``root root^T = cov``; ``rank`` (n,) place among the oriented images of the table; ``alike`` (m - 1,
    6, 6) correlation of each oriented image with the next one, in units of the roots.
    """

    row: ArrayI
    t_gps_s: ArrayF
    sigma_t_s: ArrayF
    position_wcs_m: ArrayF
    R_wcs_ics: ArrayF
    cov: ArrayF
    moments: Moments
    stretch: ArrayI
    root: ArrayF
    rank: ArrayI
    alike: ArrayF

    def take(self, which: AnyArray) -> "BoatImages":
        """Some of the images."""
        m = self.moments
        return BoatImages(
            row=self.row[which],
            t_gps_s=self.t_gps_s[which],
            sigma_t_s=self.sigma_t_s[which],
            position_wcs_m=self.position_wcs_m[which],
            R_wcs_ics=self.R_wcs_ics[which],
            cov=self.cov[which],
            moments=Moments(
                way_m=m.way_m[which],
                R_wcs_ics=m.R_wcs_ics[which],
                sigma_rad=m.sigma_rad[which],
                rates=m.rates[which],
            ),
            stretch=self.stretch[which],
            root=self.root[which],
            rank=self.rank[which],
            alike=self.alike,
        )

    def corrections(self) -> tuple[ArrayF, ArrayF]:
        """Images minus carrier: shift (n, 3) of the way and rotation (n, 3, 3), both in wcs."""
        turn = self.R_wcs_ics @ np.swapaxes(self.moments.R_wcs_ics, 1, 2)
        return self.position_wcs_m - self.moments.way_m, turn

    def common(self, first: ArrayI, second: ArrayI) -> ArrayF:
        """Covariance (k, 6, 6) of the errors of images ``first`` with those of images ``second``."""
        out = np.zeros((len(first), 6, 6))
        for k, (a, b) in enumerate(zip(first.tolist(), second.tolist(), strict=True)):
            link = self.link(int(self.rank[a]), int(self.rank[b]))
            out[k] = self.root[a] @ link @ self.root[b].T
        return out

    def link(self, a: int, b: int) -> ArrayF:
        """Correlation (6, 6) of two images by their ranks, in units of their roots."""
        if b < a:
            return self.link(b, a).T
        if b - a > _LONGEST_LINK:
            return np.zeros((6, 6))
        link = np.eye(6)
        for k in range(a, b):
            link = link @ self.alike[k]
        return link


@dataclass(frozen=True, slots=True, kw_only=True)
class CarriedErrors:
    """One way in which INS and images may err: factors of their sigmas, and times.

    ``velocity``, ``roll_pitch``, ``heading``, ``camera`` (pose of an image) and ``jitter`` (its time) are
    factors; the times and the share are as in the settings.
    """

    velocity_time_s: float
    attitude_time_s: float
    position_time_s: float
    position_white_share: float
    velocity: float = 1.0
    roll_pitch: float = 1.0
    heading: float = 1.0
    camera: float = 1.0
    jitter: float = 1.0


class CloudSettings(CameraCloud):
    """Section ``images.cloud`` with numbers where a file says ``auto``: the centres of the prior knowledge.

    ``spread`` is as in `thalweg.navigation.fusion.model.FusionSettings`.
    """

    velocity_time_s: Positive = 10.0
    attitude_time_s: Positive = 20.0
    position_time_s: Positive = 10.0
    position_white_share: float = 0.25
    spread: Mapping[str, float] = Field(default_factory=lambda: dict(SPREAD))
    draws: tuple[CarriedErrors, ...] = ()
    """What the errors may be, all equally likely; empty: as stated."""

    @classmethod
    def of(cls, section: CameraCloud) -> Self:
        """With what the section states."""
        return cls(**stated(section))

    @property
    def errors(self) -> tuple[CarriedErrors, ...]:
        """What the errors may be; covariances are the mean over it."""
        stated = CarriedErrors(
            velocity_time_s=self.velocity_time_s,
            attitude_time_s=self.attitude_time_s,
            position_time_s=self.position_time_s,
            position_white_share=self.position_white_share,
        )
        return self.draws or (stated,)


class Carrier(Protocol):
    """What `thalweg.navigation.camera.trajectory` needs of the INS.

    ``t_gps_s`` (m,) its nodes; ``broken`` (m - 1,) intervals that nothing may be carried across; ``notes``
    what was left out, for people.
    """

    t_gps_s: ArrayF
    broken: ArrayB
    notes: list[str]

    def at(self, t_gps_s: ArrayF) -> Moments:
        """The carrier at times within its span."""

    def way_variance_m2(self, dt_s: ArrayF, share: ArrayF, gap_s: ArrayF, settings: CloudSettings) -> ArrayF:
        """Variance (n,) of the way in each component, see `bridged`; ``settings`` say how the INS errs."""


# ---------------------------------------------------------------- trajectory


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraTrajectory:
    """Result of `camera_trajectory`.

    ``trajectory``; ``images``, a row an image: whether it is used, its frame and why not; ``facts`` numbers
    and notes for a report; ``by_images`` what of its errors comes from the images,
    ``used_gps_s`` (k,) the times of those that are used.
    """

    trajectory: Trajectory
    images: pd.DataFrame
    facts: dict[str, Any]
    by_images: list[ErrorChain]
    used_gps_s: ArrayF

    def error_chains(self) -> list[ErrorChain]:
        """How the errors of the poses hang together over time: images, their times, and the INS between."""
        return with_rest(self.trajectory, self.by_images, self.used_gps_s, step_s=_REST_STEP_S)


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
        trajectory=found,
        images=image_table(poses, images, reasons, joined, spans),
        facts=facts,
        by_images=image_chains(images, joined, spans, common_s),
        used_gps_s=images.t_gps_s,
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
        states,
        poses.frame,
        sigma_attitude_rad=sigma_attitude_rad,
        max_attitude_gap_s=max_attitude_gap_s,
        near_t_s=poses.t_gps_s[order],
        near_wcs_m=poses.centre_wcs_m[order],
    )


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


# ---------------------------------------------------------------- how INS and images err between images,
# estimated from both
#
# Images and INS alone, without any position, go through the smoother of the fused trajectory
# (`thalweg.navigation.fusion.errors`): the innovations of its filter tell the sizes of the errors of
# velocity, attitude, image poses and image times, and how long those of the INS last. The covariances of the
# camera's trajectory are linear in the variances, so their mean over what the errors may be is that of the
# variances.


def carried_errors(
    poses: ImagePoses,
    T_ics_ccs: Rigid,
    settings: CloudSettings,
    states: pd.DataFrame,
    *,
    sigma_attitude_rad: ArrayLike,
    max_attitude_gap_s: float,
    common_time_s: float,
) -> tuple[CloudSettings, FusionErrors]:
    """Settings with what the errors may be (``draws``), and how well they are known.

    Parameters
    ----------
    poses : of the images, with sigmas of their times.
    T_ics_ccs : mount of the camera with its covariance.
    settings : what is stated.
    states : table kind ``ins_state``.
    sigma_attitude_rad, max_attitude_gap_s : as for `thalweg.navigation.camera.trajectory.camera_trajectory`.
    common_time_s : sigma of the part of the times' errors that all images share.
    """
    known = poses.oriented & np.isfinite(poses.t_gps_s) & np.isfinite(poses.cov_pose_wcs).all(axis=(1, 2))
    ins = usable_states(states, TrajectorySummary(), max_attitude_gap_s, ATTITUDE_INITIALISED)
    order = np.flatnonzero(known)[np.argsort(poses.t_gps_s[known], kind="stable")]
    reference = make_reference(
        ins,
        poses.frame,
        sigma_attitude_rad=sigma_attitude_rad,
        max_attitude_gap_s=max_attitude_gap_s,
        use_velocity=True,
        near_t_s=poses.t_gps_s[order],
        near_wcs_m=poses.centre_wcs_m[order],
    )
    model = _estimated(
        poses, known & reference.inside(poses.t_gps_s), T_ics_ccs, settings, reference, common_time_s
    )
    if settings.motion == "trajectory" and settings.estimate_errors:
        model = _with_positions(model, settings)
    draws = tuple(_draw(model.values(h), settings) for h in model.points())
    return settings.model_copy(update={"draws": draws}), model


def errors_facts(model: FusionErrors) -> dict[str, Any]:
    """Estimates by name, see `FusionErrors.facts`, without what does not enter the camera's trajectory."""
    return {name: fact for name, fact in model.facts().items() if name != "acceleration"}


def scaled(poses: ImagePoses, settings: CloudSettings, common_time_s: float) -> ImagePoses:
    """Poses with covariances, and sigmas of times, that are the mean over what the errors may be.

    The part of the times' errors that all images share stays as it is.
    """
    camera = float(np.mean([e.camera**2 for e in settings.errors]))
    jitter = float(np.mean([e.jitter**2 for e in settings.errors]))
    shared = np.minimum(poses.sigma_t_s**2, common_time_s**2)
    sigma_t = np.sqrt(shared + jitter * (poses.sigma_t_s**2 - shared))
    changed = replace(poses, cov_pose_wcs=camera * poses.cov_pose_wcs, cov_next=camera * poses.cov_next)
    return changed.with_times(poses.t_gps_s, sigma_t)


def _estimated(
    poses: ImagePoses,
    use: ArrayB,
    T_ics_ccs: Rigid,
    settings: CloudSettings,
    reference: Reference,
    common_time_s: float,
) -> FusionErrors:
    """The errors of INS and images; the prior alone where there are too few images."""
    # without the limits of a file: what is known of a clock may be minutes
    fusion = FusionSettings().model_copy(
        update={
            "sigma_velocity_mps": settings.sigma_velocity_mps,
            "velocity_time_s": settings.velocity_time_s,
            "attitude_time_s": settings.attitude_time_s,
            "heading_disturbance_deg": 0.0,
            "sigma_clock_offset_s": common_time_s,
            "sigma_jitter_s": settings.sigma_time_s,
            "estimate_errors": settings.estimate_errors,
            "fixed": settings.fixed,
            "spread": settings.spread,
        }
    )
    layout = Layout.of(gnss=False, camera=True)
    nothing = np.zeros(0)
    none = np.zeros(0, dtype=np.bool_)
    if not settings.estimate_errors or use.sum() < LEAST_IMAGES:
        nodes = place_nodes(reference, fusion, nothing, poses.t_gps_s[use])[0]
        return FusionErrors.stated(fusion, layout, nodes)
    single = np.sqrt(np.clip(poses.sigma_t_s**2 - common_time_s**2, 0.0, None))
    camera = camera_of(
        poses.with_times(poses.t_gps_s, single), use, T_ics_ccs.inverse(), settings.sigma_time_s
    )
    nodes, _, of_camera = place_nodes(reference, fusion, nothing, camera.t_gps_s)
    camera = replace(camera, node=of_camera)
    observed = Observed.of(None, camera, none, jumped_images(camera, reference, fusion))
    first = solve(reference, nodes, observed, layout, fusion)
    # the errors alone are asked for, no pose
    task = (reference, nodes, observed, first, layout, fusion)
    return with_errors(*task, clock_start_s=0.0, spread=False)[-1]


def _with_positions(model: FusionErrors, settings: CloudSettings) -> FusionErrors:
    """The errors with those of the trajectory's positions, of which only what is stated is known."""
    spread = settings.spread
    stated = {name: getattr(settings, name) for name in OF_POSITIONS if name not in settings.fixed}
    # a share of 0 or 1 is no prior: it is meant
    kinds = {name: "time" if name == "position_time_s" else "share" for name in stated}
    more = {
        name: Prior(kind=kinds[name], centre=value, width=spread.get(name, spread[kinds[name]]))
        for name, value in stated.items()
        if kinds[name] == "time" or 0 < value < 1
    }
    n, k = len(model.h), len(more)
    cov = np.zeros((n + k, n + k))
    cov[:n, :n] = model.cov
    cov[n:, n:] = np.diag([np.log(p.width) ** 2 for p in more.values()])
    at = np.append(model.h, [p.at for p in more.values()])
    return replace(model, priors={**model.priors, **more}, h=at, cov=cov)


def _draw(values: dict[str, float], settings: CloudSettings) -> CarriedErrors:
    """What is not estimated is as stated."""
    names = CarriedErrors.__dataclass_fields__
    stated = {name: getattr(settings, name) for name in ("velocity_time_s", "attitude_time_s", *OF_POSITIONS)}
    return CarriedErrors(**{**stated, **{name: v for name, v in values.items() if name in names}})


# ---------------------------------------------------------------- when the camera gives a pose: frames about
# images, and what is bridged between them


def pose_spans(images: BoatImages, joined: ArrayB, carrier: Carrier, settings: CloudSettings) -> Spans:
    """Frames about the images, and with ``bridge`` also the time between images that are joined.

    A frame ends where the INS has a hole: nothing is extrapolated.
    """
    first, last = stretches(carrier)
    begin = np.maximum(images.t_gps_s - settings.half_rotation_s, first[images.stretch])
    end = np.minimum(images.t_gps_s + settings.half_rotation_s, last[images.stretch])
    low, high = [begin], [end]
    if settings.frames == "bridge":
        low.append(images.t_gps_s[:-1][joined])
        high.append(images.t_gps_s[1:][joined])
    return Spans(begin_s=begin, end_s=end, whole_s=_merged(np.concatenate(low), np.concatenate(high)))


def node_times(spans: Spans, carrier: Carrier, t_images_s: ArrayF) -> tuple[ArrayF, ArrayB]:
    """Times of the nodes and whether they are valid.

    Nodes at the rate of the INS, at the images and at the borders of the spans; an invalid one between two
    spans, so that nothing is interpolated across.
    """
    exact = np.concatenate([spans.whole_s.ravel(), t_images_s])
    exact = np.unique(exact[spans.inside(exact)])
    exact = exact[np.append(True, np.diff(exact) > _SAME_S)]
    own = carrier.t_gps_s[spans.inside(carrier.t_gps_s)]
    right = np.clip(np.searchsorted(exact, own), 1, max(len(exact) - 1, 1))
    near = np.minimum(np.abs(own - exact[right - 1]), np.abs(exact[np.minimum(right, len(exact) - 1)] - own))
    middle = (spans.whole_s[1:, 0] + spans.whole_s[:-1, 1]) / 2
    t = np.concatenate([exact, own[near > _SAME_S], middle])
    valid = np.append(np.ones(len(t) - len(middle), dtype=np.bool_), np.zeros(len(middle), dtype=np.bool_))
    order = np.argsort(t, kind="stable")
    return t[order], valid[order]


def _merged(begin: ArrayF, end: ArrayF) -> ArrayF:
    """Spans (k, 2) that do not meet, from some that do."""
    order = np.argsort(begin, kind="stable")
    begin, reach = begin[order], np.maximum.accumulate(end[order])
    fresh = np.append(True, begin[1:] > reach[:-1] + 2 * _SAME_S)
    return np.stack([begin[fresh], reach[np.append(np.flatnonzero(fresh)[1:] - 1, len(begin) - 1)]], axis=1)


# ---------------------------------------------------------------- what became of the images and of the time
# on the way to the camera's trajectory


def image_table(
    poses: ImagePoses, images: BoatImages, reasons: list[str], joined: ArrayB, spans: Spans
) -> pd.DataFrame:
    """A row an image, in the order of the poses.

    Columns ``image, t_gps_s, sigma_t_s, used, reason``; ``frame_begin_s, frame_end_s`` of its lidar frame,
    GPS time; ``joined_with_next`` whether the INS joins it with the next image in time; ``speed_mps`` and
    ``turn_rate_degps`` of the boat, and what one sigma of the time does with them: ``by_time_m``,
    ``by_time_deg``.
    """
    table = pd.DataFrame(
        {
            "image": list(poses.images),
            "t_gps_s": poses.t_gps_s,
            "sigma_t_s": poses.sigma_t_s,
            "used": [not reason for reason in reasons],
            "reason": reasons,
        }
    )
    speed = np.linalg.norm(images.moments.rates[:, :3], axis=1)
    rate = np.rad2deg(np.linalg.norm(images.moments.rates[:, 3:], axis=1))
    columns: dict[str, Any] = {
        "frame_begin_s": spans.begin_s,
        "frame_end_s": spans.end_s,
        "speed_mps": speed,
        "turn_rate_degps": rate,
        "by_time_m": speed * images.sigma_t_s,
        "by_time_deg": rate * images.sigma_t_s,
    }
    for name, values in columns.items():
        column = np.full(len(table), np.nan)
        column[images.row] = values
        table[name] = column
    to_next = np.zeros(len(table), dtype=np.bool_)
    to_next[images.row] = np.append(joined, False)
    table["joined_with_next"] = to_next
    return table


def time_facts(
    images: BoatImages, joined: ArrayB, spans: Spans, carrier: Carrier, settings: CloudSettings
) -> dict[str, Any]:
    """How much of the time of the INS has a pose of the camera, and why the rest has none.

    Returns
    -------
    ``frames_made`` (one an image), ``spans``, ``time_s`` of the whole INS, ``time_with_pose_s``, and
    ``time_lost_s`` by reason; they add up.
    """
    t = images.t_gps_s
    first, last = float(carrier.t_gps_s[0]), float(carrier.t_gps_s[-1])
    covered = float(np.sum(np.diff(spans.whole_s, axis=1)))
    begin, end = stretches(carrier)
    holes = np.stack([np.append(first, end), np.append(begin, last)], axis=1)
    gaps = np.stack([spans.whole_s[:-1, 1], spans.whole_s[1:, 0]], axis=1)
    # between which images each gap lies
    left = np.clip(np.searchsorted(t, gaps[:, 0], side="right") - 1, 0, max(len(t) - 2, 0))
    far = np.diff(t)[left] > settings.max_gap_s if len(t) > 1 else np.zeros(len(gaps), dtype=np.bool_)
    in_hole = np.array([_overlap(gap, holes) for gap in gaps])
    rest = np.diff(gaps, axis=1)[:, 0] - in_hole
    outside = np.array([[first, spans.whole_s[0, 0]], [spans.whole_s[-1, 1], last]])
    outside_hole = sum(_overlap(span, holes) for span in outside)
    lost = {
        "before the first and behind the last image": float(np.diff(outside, axis=1).sum()) - outside_hole,
        "images farther apart than max_gap_s": float(rest[far].sum()),
        "between the frames of images": float(rest[~far].sum()),
        "hole of the INS": float(in_hole.sum()) + outside_hole,
    }
    return {
        "frames_made": len(t),
        "spans": len(spans.whole_s),
        "neighbours_joined": int(joined.sum()),
        "neighbours_not_joined": int((~joined).sum()),
        "longest_interval_s": float(np.diff(t).max()) if len(t) > 1 else None,
        "time_s": last - first,
        "time_with_pose_s": covered,
        "time_lost_s": {reason: max(value, 0.0) for reason, value in lost.items()},
    }


def _overlap(span: ArrayF, holes: ArrayF) -> float:
    """Length that a span shares with holes, seconds."""
    shared = np.minimum(span[1], holes[:, 1]) - np.maximum(span[0], holes[:, 0])
    return float(np.maximum(shared, 0.0).sum())


# ---------------------------------------------------------------- does an image agree with its neighbours,
# carried by the INS?


def neighbour_tests(
    images: BoatImages, joined: ArrayB, carrier: Carrier, settings: CloudSettings, common_time_s: float
) -> ArrayF:
    """Statistic (n,) of each image against the pose by both its neighbours, chi-squared with 6.

    NaN for images that are not joined with both.
    """
    out = np.full(len(images.row), np.nan)
    at = np.flatnonzero(joined[1:] & joined[:-1]) + 1 if len(joined) > 1 else np.zeros(0, dtype=np.int64)
    if not len(at):
        return out
    t = images.t_gps_s
    dt, gap = t[at] - t[at - 1], t[at + 1] - t[at - 1]
    between = Between(left=at - 1, right=at + 1, share=dt / gap)
    mine = images.take(at)
    position, R = corrected(images, mine.moments, between)
    d = np.hstack([mine.position_wcs_m - position, rotation_vector(mine.R_wcs_ics @ np.swapaxes(R, 1, 2))])
    own = Between(left=at, right=at, share=np.zeros(len(at)))
    cov = interpolated_covariance(images, between, common_time_s)
    cov = cov + interpolated_covariance(images, own, common_time_s)
    # what the image has in common with both neighbours cancels
    r, shared = images.moments.rates, np.minimum(np.square(images.sigma_t_s), common_time_s**2)
    for other, share in ((at - 1, 1 - between.share), (at + 1, between.share)):
        X = images.common(at, other)
        X += np.sqrt(shared[at] * shared[other])[:, None, None] * (r[at][:, :, None] * r[other][:, None, :])
        cov -= share[:, None, None] * (X + np.swapaxes(X, 1, 2))
    cov[:, :3, :3] += carrier.way_variance_m2(dt, between.share, gap, settings)[:, None, None] * np.eye(3)
    cov[:, 3:, 3:] += attitude_growth(mine.moments, dt, between.share, gap, settings)
    scale = np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
    scale = np.where(scale > 0, scale, 1.0)
    white = d / scale
    C = cov / scale[:, :, None] / scale[:, None, :] + 1e-12 * np.eye(6)
    out[at] = np.einsum("ni,ni->n", white, np.linalg.solve(C, white[:, :, None])[:, :, 0])
    return out


# ---------------------------------------------------------------- images as poses of the boat, and how errors
# of neighbours are related
#
# ``T_wcs_ics = T_wcs_ccs T_ccs_ics``. The mount of the camera is taken as it is: the lidar is placed on the
# boat through the same mount (`thalweg.navigation.camera.mounts`), so that its error drops out of
# the cloud.


def boat_images(
    poses: ImagePoses, T_ics_ccs: Rigid, carrier: Carrier, *, sigma_time_s: float
) -> tuple[BoatImages, list[str]]:
    """Images that can carry the boat, and for each image of the table why it cannot ("" if it can).

    The order of the table is that of its neighbours' covariances; times may be in any order. Where two
    images are no neighbours in the table, their common error follows from those between them as in a Markov
    chain.

    Parameters
    ----------
    poses : of all images.
    T_ics_ccs : mount of the camera.
    carrier : the INS.
    sigma_time_s : stands in where the table states no sigma of a time.
    """
    oriented = np.flatnonzero(poses.oriented)
    has_cov = np.isfinite(poses.cov_pose_wcs).all(axis=(1, 2))
    reason = np.full(len(poses.images), "", dtype=object)
    reason[~has_cov] = NO_COVARIANCE
    reason[~np.isfinite(poses.t_gps_s)] = NO_TIME
    for row in np.flatnonzero(~poses.oriented):
        reason[row] = f"{NO_POSE}: {poses.reasons[row]}" if poses.reasons[row] else NO_POSE
    rows = np.flatnonzero(reason == "")
    reason[rows[stretch_of(carrier, poses.t_gps_s[rows]) < 0]] = NO_INS
    rows = np.flatnonzero(reason == "")
    rows = rows[np.argsort(poses.t_gps_s[rows], kind="stable")]
    again = np.append(False, np.diff(poses.t_gps_s[rows]) <= SAME_TIME_S)[: len(rows)]
    reason[rows[again]] = TWICE
    rows = rows[~again]
    T_ccs_ics = T_ics_ccs.inverse()
    R = poses.R_wcs_ccs[oriented]
    arm = R @ T_ccs_ics.shift_m
    J = np.tile(np.eye(6), (len(oriented), 1, 1))
    J[:, :3, 3:] = -cross_matrix(arm)
    root, alike = _chain(poses.cov_pose_wcs[oriented], poses.cov_next[oriented])
    rank = np.searchsorted(oriented, rows)
    sigma = poses.sigma_t_s[rows]
    own = (J @ root)[rank]
    images = BoatImages(
        row=rows,
        t_gps_s=poses.t_gps_s[rows],
        sigma_t_s=np.where(np.isfinite(sigma), sigma, sigma_time_s),
        position_wcs_m=(poses.centre_wcs_m[oriented] + arm)[rank],
        R_wcs_ics=(R @ T_ccs_ics.R)[rank],
        cov=own @ np.swapaxes(own, 1, 2),
        moments=carrier.at(poses.t_gps_s[rows]),
        stretch=stretch_of(carrier, poses.t_gps_s[rows]),
        root=own,
        rank=rank,
        alike=alike,
    )
    return images, reason.astype(str).tolist()


def corrected(images: BoatImages, at: Moments, between: Between) -> tuple[ArrayF, ArrayF]:
    """Position (n, 3) and ``R_wcs_ics`` (n, 3, 3): the carrier with the correction of the images.

    Shifts are interpolated linearly, rotations along the shortest arc.
    """
    shift, turn = images.corrections()
    a, b, u = between.left, between.right, between.share[:, None]
    arc = rotation_vector(turn[b] @ np.swapaxes(turn[a], 1, 2)) if len(a) else np.zeros((0, 3))
    D = Rotation.from_rotvec(arc * u).as_matrix() @ turn[a]
    return at.way_m + (1 - u) * shift[a] + u * shift[b], D @ at.R_wcs_ics


def interpolated_covariance(images: BoatImages, between: Between, common_time_s: float) -> ArrayF:
    """Covariance (n, 6, 6) of interpolated corrections: of the images' poses and of their times (P2 eq. 6).

    An error of time moves an image by the speed of the boat, linear and angular, at that moment.

    Parameters
    ----------
    images, between : which images count how much.
    common_time_s : sigma of the part of the times' errors that all images share.
    """
    a, b = between.left, between.right
    pairs, place = np.unique(np.stack([a, b]), axis=1, return_inverse=True)
    X = images.common(pairs[0], pairs[1])[place.ravel()]
    variance = np.square(images.sigma_t_s)
    shared = np.minimum(variance, common_time_s**2)
    r = images.moments.rates
    own = images.cov + variance[:, None, None] * (r[:, :, None] * r[:, None, :])
    X = X + np.sqrt(shared[a] * shared[b])[:, None, None] * (r[a][:, :, None] * r[b][:, None, :])
    u = between.share[:, None, None]
    mixed = (1 - u) ** 2 * own[a] + u**2 * own[b] + u * (1 - u) * (X + np.swapaxes(X, 1, 2))
    return np.asarray(np.where((a == b)[:, None, None], own[a], mixed))


def image_chains(images: BoatImages, joined: ArrayB, spans: Spans, common_time_s: float) -> list[ErrorChain]:
    """Errors of the images' poses, of their times and of their clock, as they enter the poses of the boat.

    Where nothing joins two images, each has its own error to the end of its frame.
    """
    n = len(images.row)
    # the frame of an image may reach beyond it to both sides: two more nodes with the same error
    before, after = np.append(True, ~joined), np.append(~joined, True)
    image = np.repeat(np.arange(n), 1 + before + after)
    t = np.concatenate(
        [
            [*([b] if first else []), own, *([e] if last else [])]
            for b, own, e, first, last in zip(
                np.minimum(spans.begin_s, images.t_gps_s), images.t_gps_s,
                np.maximum(spans.end_s, images.t_gps_s), before, after, strict=True,
            )
        ]
    )  # fmt: skip
    t = np.maximum.accumulate(t)
    same = np.append(False, image[1:] == image[:-1])[:, None, None]
    links = np.zeros((n, 6, 6))
    for k in range(1, n):
        a, b = int(images.rank[k - 1]), int(images.rank[k])
        links[k] = images.link(a, b).T
    shared = np.minimum(np.square(images.sigma_t_s), common_time_s**2)
    single = np.sqrt(np.square(images.sigma_t_s) - shared)
    by_time = images.moments.rates[:, :, None]
    one = np.ones((len(t), 1, 1))
    return [
        ErrorChain(
            name="images", t_gps_s=t, root=images.root[image], link=np.where(same, np.eye(6), links[image])
        ),
        ErrorChain(
            name="times of images",
            t_gps_s=t,
            root=(by_time * single[:, None, None])[image],
            link=np.where(same, one, 0.0),
        ),
        ErrorChain(
            name="clock of the camera",
            t_gps_s=t,
            root=(by_time * np.sqrt(shared)[:, None, None])[image],
            link=one,
        ),
    ]


def linked(images: BoatImages, max_gap_s: float) -> ArrayB:
    """Whether the carrier joins each image (n - 1,) with the next one."""
    near = np.diff(images.t_gps_s) <= max_gap_s + SAME_TIME_S
    return np.asarray(near & (np.diff(images.stretch) == 0))


def _chain(cov: ArrayF, following: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Roots (m, 6, 6) of covariances and the correlation (m - 1, 6, 6) of neighbours in their units.

    Singular values of a correlation are at most 1; more, and an interpolation would be free of error.
    """
    sigma = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2), 0.0))
    scale = np.nan_to_num(np.where(sigma > 0, sigma, 1.0), nan=1.0)
    value, vector = np.linalg.eigh(np.nan_to_num(cov) / scale[:, :, None] / scale[:, None, :])
    size = np.sqrt(np.maximum(value, 0.0))
    root = scale[:, :, None] * vector * size[:, None, :]
    safe = np.where(size > 1e-6, size, np.inf)
    inverse = np.swapaxes(vector, 1, 2) / safe[:, :, None] / scale[:, None, :]
    if len(cov) < 2:
        return root, np.zeros((0, 6, 6))
    raw = inverse[:-1] @ np.nan_to_num(following[:-1]) @ np.swapaxes(inverse[1:], 1, 2)
    left, s, right = np.linalg.svd(raw)
    return root, np.asarray(left * np.minimum(s, _MOST_ALIKE)[:, None, :] @ right)


# ---------------------------------------------------------------- motion between images by the INS
#
# The carrier is a chain of poses of its own: attitudes of the INS, and a way that is the integral of its
# velocity or the path of the INS/GNSS trajectory. Only its *changes* between images count: a constant error
# goes into the correction that each image gives.


def states_with_velocity(states: pd.DataFrame) -> int:
    """How many states have a velocity, which carries the boat from image to image.

    Raises
    ------
    InputError : fewer than two.
    """
    known = int(states[["v_north_mps", "v_east_mps", "v_down_mps"]].notna().all(axis=1).sum())
    if known < 2:
        raise InputError(
            f"{known} of {len(states)} INS states have a velocity",
            expected="a velocity in each state: it carries the boat from image to image",
            cure="Set images.cloud.motion to trajectory",
        )
    return known


class VelocityCarrier:
    """Attitudes and the integral of the velocity of the INS.

    Parameters
    ----------
    states : table kind ``ins_state``.
    frame : the world frame.
    sigma_attitude_rad : (3,) roll, pitch, heading; stands in where the log states none.
    max_attitude_gap_s : longest hole between states that is interpolated.
    near_t_s, near_wcs_m : (k,), (k, 3) where the boat is to a few metres.

    Raises
    ------
    InputError : no usable states, or none with a velocity.
    """

    def __init__(
        self,
        states: pd.DataFrame,
        frame: LocalFrame,
        *,
        sigma_attitude_rad: ArrayLike,
        max_attitude_gap_s: float,
        near_t_s: ArrayF,
        near_wcs_m: ArrayF,
    ) -> None:
        summary = TrajectorySummary(n_states=len(states))
        usable = usable_states(states, summary, max_attitude_gap_s, ATTITUDE_INITIALISED)
        known = states_with_velocity(usable)
        if known < len(usable):
            summary.notes.append(f"{len(usable) - known} INS states without a velocity carry nothing")
        self.reference: Reference = make_reference(
            usable,
            frame,
            sigma_attitude_rad=sigma_attitude_rad,
            max_attitude_gap_s=max_attitude_gap_s,
            use_velocity=True,
            near_t_s=near_t_s,
            near_wcs_m=near_wcs_m,
        )
        self.t_gps_s = self.reference.t_gps_s
        self.broken = np.asarray(self.reference.hole | self.reference.blind)
        self.notes = summary.notes

    def at(self, t_gps_s: ArrayF) -> Moments:
        """The carrier at times within its span."""
        found = self.reference.at(t_gps_s)
        return Moments(
            way_m=found.way_m,
            R_wcs_ics=found.R_wcs_ics,
            sigma_rad=found.sigma_rad,
            rates=np.hstack([found.velocity_mps, found.rate_radps]),
        )

    def way_variance_m2(self, dt_s: ArrayF, share: ArrayF, gap_s: ArrayF, settings: CloudSettings) -> ArrayF:
        """Variance (n,) of the integral of a Gauss-Markov velocity error, see `bridged`."""
        each = [
            e.velocity**2 * bridged_integral(dt_s, share, gap_s, e.velocity_time_s) for e in settings.errors
        ]
        return np.asarray(settings.sigma_velocity_mps**2 * np.mean(each, axis=0))


class TrajectoryCarrier:
    """The trajectory of INS and positions.

    Parameters
    ----------
    trajectory : with covariance.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self._trajectory = trajectory
        self.t_gps_s = trajectory.t_gps_s
        self.broken = np.asarray(~(trajectory.valid[1:] & trajectory.valid[:-1]))
        self.notes: list[str] = []
        self._sigma = trajectory.sigma_roll_pitch_heading_rad()
        sigma = trajectory.sigma_position_m[trajectory.valid]
        self._sigma_position_m = float(np.sqrt(np.median(np.square(sigma).mean(axis=1))))

    def at(self, t_gps_s: ArrayF) -> Moments:
        """The carrier at times within its span."""
        first, last = float(self.t_gps_s[0]), float(self.t_gps_s[-1])
        t = np.clip(t_gps_s, first, last)
        position, R, _ = self._trajectory.at(t)
        before, after = np.maximum(t - _RATE_SPAN_S, first), np.minimum(t + _RATE_SPAN_S, last)
        x0, R0, _ = self._trajectory.at(before)
        x1, R1, _ = self._trajectory.at(after)
        turn = Rotation.from_matrix(R1 @ np.swapaxes(R0, 1, 2)).as_rotvec()
        return Moments(
            way_m=position,
            R_wcs_ics=R,
            sigma_rad=np.stack([np.interp(t, self.t_gps_s, s) for s in self._sigma.T], axis=1),
            rates=np.hstack([x1 - x0, turn]) / (after - before)[:, None],
        )

    def way_variance_m2(self, dt_s: ArrayF, share: ArrayF, gap_s: ArrayF, settings: CloudSettings) -> ArrayF:
        """Variance (n,) of the positions' slow and white errors, see `bridged`."""
        white = bridged(dt_s, share, gap_s, _EPOCH_S)
        each = [
            (1.0 - e.position_white_share) * bridged(dt_s, share, gap_s, e.position_time_s)
            + e.position_white_share * white
            for e in settings.errors
        ]
        return np.asarray(self._sigma_position_m**2 * np.mean(each, axis=0))


def bridged(dt_s: ArrayF, share: ArrayF, gap_s: ArrayF, time_s: float) -> ArrayF:
    """Variance of what is left of a Gauss-Markov error of unit variance when images correct it.

    Between two images ``e(t) - (1 - u) e(0) - u e(T)``; ``u`` = 0 with one image only: ``e(t) - e(0)``.

    Parameters
    ----------
    dt_s : (n,) time since the image, of either sign.
    share : (n,) u, share of the next image; `gap_s` times it is ``dt_s``, or it is 0.
    gap_s : (n,) time T to the next image.
    time_s : correlation time.

    Examples
    --------
    >>> bridged(np.array([0.5, 0.5]), np.array([0.5, 0.0]), np.array([1.0, 1.0]), 20.0).round(4)
    array([0.025 , 0.0494])
    """
    u = np.asarray(share, dtype=np.float64)
    near, far = np.abs(dt_s) / time_s, np.abs(gap_s - dt_s) / time_s
    whole = gap_s / time_s
    # 1 - exp keeps its digits where the times are short
    out = 2 * (1 - u) * -np.expm1(-near) + 2 * u * -np.expm1(-far) - 2 * u * (1 - u) * -np.expm1(-whole)
    return np.asarray(np.maximum(out, 0.0))


def bridged_integral(dt_s: ArrayF, share: ArrayF, gap_s: ArrayF, time_s: float) -> ArrayF:
    """The same for the integral of such an error, in s^2: ``w(t) - u w(T)`` with ``w(0) = 0``.

    ``Cov(w(x), w(y)) = tau 2 min(x, y) - tau^2 (1 - exp(-x/tau) - exp(-y/tau) + exp(-|x - y|/tau))``.

    Examples
    --------
    >>> bridged_integral(np.array([0.5, 0.05]), np.array([0.5, 0.0]), np.array([1.0, 1.0]), 10.0).round(6)
    array([0.004014, 0.002496])
    """
    u = np.asarray(share, dtype=np.float64)
    x, y = np.abs(dt_s) / time_s, gap_s / time_s

    def spread(a: ArrayF, b: ArrayF) -> ArrayF:
        """Covariance of the integral at two times, in units of the correlation time."""
        return np.asarray(2 * np.minimum(a, b) + np.expm1(-a) + np.expm1(-b) - np.expm1(-np.abs(a - b)))

    out = spread(x, x) - 2 * u * spread(x, y) + u**2 * spread(y, y)
    return np.asarray(np.maximum(time_s**2 * out, 0.0))


def attitude_growth(
    moments: Moments, dt_s: ArrayF, share: ArrayF, gap_s: ArrayF, settings: CloudSettings
) -> ArrayF:
    """Covariance (n, 3, 3) in wcs of the attitude errors that images leave, see `bridged`."""
    each = [
        bridged(dt_s, share, gap_s, e.attitude_time_s)[:, None]
        * np.square([e.roll_pitch, e.roll_pitch, e.heading])
        for e in settings.errors
    ]
    sigma = moments.sigma_rad * np.sqrt(np.mean(each, axis=0))
    axes = np.swapaxes(attitude_axes(moments.R_wcs_ics), 1, 2) * sigma[:, None, :]
    return np.asarray(axes @ np.swapaxes(axes, 1, 2))


def stretches(carrier: Carrier) -> tuple[ArrayF, ArrayF]:
    """Begin (k,) and end (k,) of the unbroken stretches of a carrier."""
    t, broken = carrier.t_gps_s, carrier.broken
    edge = np.diff(np.concatenate([[0], (~broken).astype(np.int64), [0]]))
    return t[:-1][edge[:-1] == 1], t[1:][edge[1:] == -1]


def stretch_of(carrier: Carrier, t_gps_s: ArrayF) -> ArrayI:
    """Number (n,) of the unbroken stretch that holds a time; -1 where none does."""
    begin, end = stretches(carrier)
    if not len(begin):
        return np.full(len(t_gps_s), -1)
    k = np.searchsorted(begin, t_gps_s, side="right") - 1
    inside = (k >= 0) & (t_gps_s <= end[np.maximum(k, 0)])
    return np.where(inside, k, -1)
