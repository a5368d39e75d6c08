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
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from thalweg.core.errors import ClockError, CoverageError
from thalweg.core.rigid import Rigid, rotation_vector
from thalweg.core.timescales import utc_text_from_gps
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayB, ArrayF
from thalweg.images.model.poses import ImagePoses
from thalweg.navigation.camera.carrier import (
    Carrier,
    TrajectoryCarrier,
    VelocityCarrier,
    attitude_growth,
    stretches,
)
from thalweg.navigation.camera.images import (
    CONTRADICTS,
    Between,
    BoatImages,
    boat_images,
    corrected,
    interpolated_covariance,
    linked,
)
from thalweg.navigation.camera.settings import CarriedErrors, CloudSettings
from thalweg.navigation.fusion.errors import ErrorModel, Prior, with_errors
from thalweg.navigation.fusion.inputs import camera_of, place_nodes
from thalweg.navigation.fusion.screen import jumped_images
from thalweg.navigation.fusion.settings import FusionSettings, Layout
from thalweg.navigation.fusion.solver import Observed, solve
from thalweg.navigation.ins_gnss.reference import Reference, make_reference
from thalweg.navigation.ins_gnss.selection import ATTITUDE_INITIALISED, TrajectorySummary, usable_states

# ---------------------------------------------------------------- how INS and images err between images,
# estimated from both
#
# Images and INS alone, without any position, go through the smoother of the fused trajectory
# (`thalweg.navigation.fusion.errors`): the innovations of its filter tell the sizes of the errors of
# velocity, attitude, image poses and image times, and how long those of the INS last. The covariances of the
# camera's trajectory are linear in the variances, so their mean over what the errors may be is that of the
# variances.


LEAST_IMAGES = 3
"""With fewer, what is stated counts alone."""

OF_POSITIONS = ("position_time_s", "position_white_share")
"""What images and INS do not show: errors of the trajectory of INS and positions."""


def carried_errors(
    poses: ImagePoses,
    T_ics_ccs: Rigid,
    settings: CloudSettings,
    states: pd.DataFrame,
    *,
    sigma_attitude_rad: ArrayLike,
    max_attitude_gap_s: float,
    common_time_s: float,
) -> tuple[CloudSettings, ErrorModel]:
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
        ins, poses.frame, sigma_attitude_rad=sigma_attitude_rad, max_attitude_gap_s=max_attitude_gap_s,
        use_velocity=True, near_t_s=poses.t_gps_s[order], near_wcs_m=poses.centre_wcs_m[order],
    )  # fmt: skip
    model = _estimated(
        poses, known & reference.inside(poses.t_gps_s), T_ics_ccs, settings, reference, common_time_s
    )
    if settings.motion == "trajectory" and settings.estimate_errors:
        model = _with_positions(model, settings)
    draws = tuple(_draw(model.values(h), settings) for h in model.points())
    return replace(settings, draws=draws), model


def errors_facts(model: ErrorModel) -> dict[str, Any]:
    """Estimates by name, see `ErrorModel.facts`, without what does not enter the camera's trajectory."""
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
) -> ErrorModel:
    """The errors of INS and images; the prior alone where there are too few images."""
    fusion = FusionSettings(
        sigma_velocity_mps=settings.sigma_velocity_mps, velocity_time_s=settings.velocity_time_s,
        attitude_time_s=settings.attitude_time_s, heading_disturbance_deg=0.0,
        sigma_clock_offset_s=common_time_s, sigma_jitter_s=settings.sigma_time_s,
        estimate_errors=settings.estimate_errors, fixed=settings.fixed, spread=settings.spread,
    )  # fmt: skip
    layout = Layout.of(gnss=False, camera=True)
    nothing = np.zeros(0)
    none = np.zeros(0, dtype=np.bool_)
    if not settings.estimate_errors or use.sum() < LEAST_IMAGES:
        nodes = place_nodes(reference, fusion, nothing, poses.t_gps_s[use])[0]
        return ErrorModel.stated(fusion, layout, nodes)
    single = np.sqrt(np.clip(poses.sigma_t_s**2 - common_time_s**2, 0.0, None))
    camera = camera_of(
        poses.with_times(poses.t_gps_s, single), use, T_ics_ccs.inverse(), settings.sigma_time_s
    )
    nodes, _, of_camera = place_nodes(reference, fusion, nothing, camera.t_gps_s)
    camera = replace(camera, node=of_camera)
    observed = Observed.of(None, camera, none, jumped_images(camera, reference, fusion))
    first = solve(reference, nodes, observed, layout, fusion)
    return with_errors(reference, nodes, observed, first, layout, fusion, clock_start_s=0.0)[-1]


def _with_positions(model: ErrorModel, settings: CloudSettings) -> ErrorModel:
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


_SAME_S: Final = 1e-6
"""Nodes that are nearer are one: lidar points lie microseconds apart."""


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
    table = pd.DataFrame({
        "image": list(poses.images),
        "t_gps_s": poses.t_gps_s,
        "sigma_t_s": poses.sigma_t_s,
        "used": [not reason for reason in reasons],
        "reason": reasons,
    })  # fmt: skip
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
    d = np.hstack([
        mine.position_wcs_m - position,
        rotation_vector(mine.R_wcs_ics @ np.swapaxes(R, 1, 2)),
    ])  # fmt: skip
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


# ---------------------------------------------------------------- trajectory


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
