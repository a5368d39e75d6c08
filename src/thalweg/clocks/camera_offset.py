"""Offset of a camera's clock against GPS time, and the antenna's place, from a run of the boat (P2 eq. 4-5).

P2 estimates ``dt, dx, dy, dz`` from independent GNSS positions and exact poses. Here the model also knows
that

- GNSS errors last for seconds, so that 10 Hz are not ten times the information of 1 Hz;
- poses have covariances, and share the error of the field's georeferencing;
- each image has a jitter of its own, whose variance is estimated with the rest (restricted maximum
  likelihood);
- the clock drifts; a prior sigma keeps the drift of a short run sane;
- a few poses are wrong: images whose residuals do not fit are taken out one after the other;
- the attitude of the INS, if given, tells the time from turns: 0.05 degrees at 10 degrees/s are 5 ms an
  image.

Two definitions of the offset differ by the mean jitter of the run's images, ``jitter / sqrt(n)``. That of
the *clock* is what another run will have. That of *this run* holds for its own images. Both come with their
sigma.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.linalg import block_diag, solve_triangular
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation, Slerp
from scipy.stats import chi2

from thalweg.clocks.ties import QUARTZ_DRIFT, ClockModel
from thalweg.clocks.track import Between, Track, gauss_markov
from thalweg.core import (
    NMAD,
    AnyArray,
    ArrayB,
    ArrayF,
    ClockError,
    CoverageError,
    GeometryError,
    Linear,
    Observations,
    UnobservableError,
    adjust,
    attitude_axes,
    cross_matrix,
    exp_rotation,
    global_test,
    utc_text_from_gps,
)
from thalweg.ingest import QUARTER_HOUR_S, explain_shift
from thalweg.settings.sections import CameraClock

_LEAST_IMAGES: Final = 8
_ROUNDS: Final = 40
_REJECT: Final = 1e-3
"""Probability with which one good image of the run is rejected."""
_MOST_REJECTED: Final = 0.3
_TAIL: Final = 0.0005
"""Both tails of the global test."""
_SIGNIFICANT: Final = 4.0
"""Sigmas by which the velocity must change more than its noise."""
_STANDING_MPS: Final = 0.05
_TURNS_DEG: Final = 30.0
"""Less change of the attitude is no turn: a boat on a straight course yaws by some degrees."""
_STEADY: Final = 0.15
"""Speeds that scatter by less than this share of their mean are constant, as far as a helmsman can tell."""

_TURNS: Final = 30
_CONVERGED_S: Final = 1e-5
_FIRST_JITTER_S: Final = 0.02
_UNITS: Final = np.array([1e-3, 1e-6])
"""Offset in ms and drift in ppm have numbers of one size."""
_HELD: Final = 1e-12
"""Sigma of a drift that is held at zero."""
_LEVER_HELD_M: Final = 1e-5
"""Added to an antenna that is stated without a sigma; a matrix of zeros could not be inverted."""
_FLOOR: Final = 1e-12

_AT_ONCE: Final = 50_000
"""Images at offsets that are tried at a time: some 5 MB."""
_STEP_S: Final = 0.1
_ZONES: Final = 14 * 4
_FITS: Final = 3.0
"""A shift of whole hours explains the run if it leaves less than this many times what the sigmas allow."""
_GROSS: Final = 6.0
_GAP: Final = 2.5
"""Steps of the track beyond which nothing is interpolated."""
_CRUDE_M: Final = 2.0
"""Added to the largest lever where the offset is only known to half a second."""

NAMES: Final = ("offset", "drift", "dx", "dy", "dz")
"""Unknowns: of the clock, and the antenna in ccs."""
TURN_NAMES: Final = ("turn_x", "turn_y", "turn_z")
"""Small rotation of R_ics_ccs, in ics."""
_RATE_REACH_S: Final = 0.1
"""Half of the time over which the angular velocity is taken from the attitudes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunMotion:
    """How the boat moved, at the images that were used.

    ``speed_mps`` mean, ``speed_change_mps`` standard deviation of the speed without its noise,
    ``turned_deg`` largest turn between two images, ``turn_rate_degps`` root mean square, ``change_mps`` root
    mean square change of the velocity in the frame of the camera without its noise, ``change_degps`` the
    same of the angular velocity.
    """

    speed_mps: float
    speed_change_mps: float
    turned_deg: float
    turn_rate_degps: float
    change_mps: float
    change_degps: float

    @property
    def missing(self) -> tuple[str, ...]:
        """Motions that were too weak."""
        if self.speed_mps < _STANDING_MPS and self.turned_deg < _TURNS_DEG:
            return ("movement", "turns", "changes of speed")
        out = [] if self.turned_deg >= _TURNS_DEG else ["turns"]
        if self.speed_change_mps < _STEADY * max(self.speed_mps, _STANDING_MPS):
            out.append("changes of speed")
        return tuple(out) if out else ("a longer run", "stronger changes of speed")

    @property
    def words(self) -> str:
        """The motion in a sentence."""
        if self.speed_mps < _STANDING_MPS and self.turned_deg < _TURNS_DEG:
            return f"the boat stands ({self.speed_mps:.2f} m/s)"
        course = (
            f"the course is straight (turns of {self.turned_deg:.0f} degrees)"
            if self.turned_deg < _TURNS_DEG
            else f"it turns by {self.turned_deg:.0f} degrees"
        )
        return (
            f"{course}, the speed is {self.speed_mps:.2f} m/s and changes by {self.speed_change_mps:.2f} m/s,"
            f" and the velocity seen from the boat changes by {self.change_mps:.3f} m/s"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetOptions:
    """How the offset is estimated.

    Parameters
    ----------
    largest_offset_s : the offset is looked for between minus and plus this.
    sigma_drift : prior standard deviation of the drift; 0 holds it at zero.
    jitter_s : standard deviation of the jitter of an image; None: estimated.
    largest_lever_m : no antenna is farther from the camera.
    largest_sigma_s : an offset that is less certain than this is refused.
    lever_m, cov_lever_m2 : (3,) antenna in ccs and its covariance (3, 3), if known from elsewhere.
    """

    largest_offset_s: float = CameraClock().largest_offset_s
    largest_lever_m: float = CameraClock().largest_lever_m
    sigma_drift: float = QUARTZ_DRIFT
    jitter_s: float | None = None
    largest_sigma_s: float = CameraClock().largest_sigma_s
    lever_m: ArrayF | None = None
    cov_lever_m2: ArrayF | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Component:
    """Estimated variance of the effects, and the standard deviation of that estimate."""

    variance: float
    sigma_variance: float

    @property
    def sigma(self) -> float:
        """Standard deviation of the effects."""
        return float(np.sqrt(self.variance))

    @property
    def sigma_of_sigma(self) -> float:
        """Standard deviation of `sigma`; near zero that of the variance is turned into an upper end."""
        if self.variance > self.sigma_variance:
            return self.sigma_variance / (2.0 * self.sigma)
        return float(np.sqrt(self.variance + self.sigma_variance)) - self.sigma


@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetState:
    """Values of the unknowns.

    ``slow`` (k,) are the coefficients of the INS's slow errors, none in a short run; ``oriented`` is False as
    long as ``R_ics_ccs`` says nothing.
    """

    offset_s: float
    drift: float
    lever_m: ArrayF
    R_ics_ccs: ArrayF = field(default_factory=lambda: np.eye(3))
    slow: ArrayF = field(default_factory=lambda: np.zeros(0))
    oriented: bool = False

    def moved(self, dx: ArrayF) -> "OffsetState":
        """The state with a small change: offset, drift, antenna, turn, slow errors."""
        turn = exp_rotation(dx[5:8]) @ self.R_ics_ccs if len(dx) > 5 else self.R_ics_ccs
        return OffsetState(
            offset_s=self.offset_s + float(dx[0]),
            drift=self.drift + float(dx[1]),
            lever_m=self.lever_m + dx[2:5],
            R_ics_ccs=turn,
            slow=self.slow + dx[8:] if len(dx) > 8 else self.slow,
            oriented=self.oriented,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Stacked:
    """All observations at a state.

    ``residual`` (m,) and ``jacobian`` (m, u); ``motion`` (m,) how each residual changes with the time of its
    image, ``image`` (m,) which image it is of; ``between`` the track at the images' times.
    """

    residual: ArrayF
    jacobian: ArrayF
    motion: ArrayF
    image: AnyArray
    between: Between


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraPoses:
    """Images with the pose of the camera.

    ``file`` (n,) names; ``t_device_s`` (n,) increasing stamps; ``R_wcs_ccs`` (n, 3, 3); ``centre_wcs_m`` (n,
    3); ``cov_pose_wcs`` (n, 6, 6) of (shift; small rotation vector), both in wcs.

    Raises
    ------
    GeometryError : shapes that differ.
    """

    file: AnyArray
    t_device_s: ArrayF
    R_wcs_ccs: ArrayF
    centre_wcs_m: ArrayF
    cov_pose_wcs: ArrayF

    def __post_init__(self) -> None:
        n = len(self.t_device_s)
        shapes = [np.shape(a) for a in (self.file, self.R_wcs_ccs, self.centre_wcs_m, self.cov_pose_wcs)]
        if shapes != [(n,), (n, 3, 3), (n, 3), (n, 6, 6)]:
            raise GeometryError(f"{n} stamps with arrays {shapes}", expected="(n,), (n,3,3), (n,3), (n,6,6)")

    def take(self, which: AnyArray) -> "CameraPoses":
        """Some of the images."""
        return CameraPoses(
            file=self.file[which],
            t_device_s=self.t_device_s[which],
            R_wcs_ccs=self.R_wcs_ccs[which],
            centre_wcs_m=self.centre_wcs_m[which],
            cov_pose_wcs=self.cov_pose_wcs[which],
        )


@dataclass(frozen=True, kw_only=True)
class InsAttitude:
    """Attitudes of the INS on GPS time.

    ``t_gps_s`` (m,); ``R_wcs_ics`` (m, 3, 3); ``sigma_rad`` (3,) of roll, pitch, heading;
    ``correlation_time_s`` of their Gauss-Markov errors. Errors slower than ``high_pass_s`` (drift of the
    heading) are free: a series of cosines of longer periods is estimated and thrown away, so that only
    faster turns tell of time.
    """

    t_gps_s: ArrayF
    R_wcs_ics: ArrayF
    sigma_rad: ArrayF
    correlation_time_s: float = 20.0
    high_pass_s: float = CameraClock().high_pass_s

    @cached_property
    def _slerp(self) -> Slerp:
        return Slerp(self.t_gps_s - self.t_gps_s[0], Rotation.from_matrix(self.R_wcs_ics))

    def at(self, t_gps_s: ArrayF) -> tuple[ArrayF, ArrayF, ArrayB]:
        """``R_wcs_ics`` (n, 3, 3), angular velocity in wcs (n, 3), and which times are covered (n,)."""
        t = self.t_gps_s
        inside = (t_gps_s > t[0] + 2 * _RATE_REACH_S) & (t_gps_s < t[-1] - 2 * _RATE_REACH_S)
        right = np.clip(np.searchsorted(t, t_gps_s), 1, len(t) - 1)
        inside &= t[right] - t[right - 1] < 2 * _RATE_REACH_S
        slerp = self._slerp
        at = np.clip(t_gps_s - t[0], _RATE_REACH_S, t[-1] - t[0] - _RATE_REACH_S)
        turned = slerp(at + _RATE_REACH_S) * slerp(at - _RATE_REACH_S).inv()
        return slerp(at).as_matrix(), turned.as_rotvec() / (2 * _RATE_REACH_S), inside

    def covariance(self, t_gps_s: ArrayF) -> ArrayF:
        """Covariance (3 n, 3 n) of the rotation errors, in wcs."""
        return self._spread(t_gps_s, gauss_markov(t_gps_s[:, None] - t_gps_s, self.correlation_time_s))

    def rate_covariance(self, t_gps_s: ArrayF) -> ArrayF:
        """Covariance (3 n, 3 n) of the errors of the angular velocity, which is a difference of attitudes."""
        apart, reach, tau = t_gps_s[:, None] - t_gps_s, 2 * _RATE_REACH_S, self.correlation_time_s
        middle, behind, ahead = (gauss_markov(apart + lag, tau) for lag in (0.0, -reach, reach))
        return self._spread(t_gps_s, (2 * middle - behind - ahead) / reach**2)

    def _spread(self, t_gps_s: ArrayF, kernel: ArrayF) -> ArrayF:
        axes = attitude_axes(self.at(t_gps_s)[0]) * self.sigma_rad
        full = np.einsum("ij,iap,jbp->iajb", kernel, axes, axes, optimize=True)
        return np.asarray(full.reshape(3 * len(kernel), 3 * len(kernel)))


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldError:
    """Error that all camera poses share: of the georeferencing of the calibration field.

    ``cov`` (6, 6) of (shift; small rotation vector) about ``about_wcs_m`` (3,), in wcs.
    """

    cov: ArrayF
    about_wcs_m: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetModel:
    """What is observed, for a fixed choice of images."""

    poses: CameraPoses
    track: Track
    reference_s: float
    ins: InsAttitude | None = None
    field_error: FieldError | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        if self.ins is None:
            return NAMES
        axes = ("roll", "pitch", "heading")
        slow = tuple(f"slow_{axis}_{k + 1}" for k in range(len(self.cosines())) for axis in axes)
        return (*NAMES, *TURN_NAMES, *slow)

    def cosines(self) -> ArrayF:
        """Cosines (k, n) of the images' times with periods above ``high_pass_s``; a constant is the turn."""
        t = self.poses.t_device_s
        span = float(t[-1] - t[0])
        if self.ins is None or self.ins.high_pass_s <= 0 or span <= 0:
            return np.zeros((0, len(t)))
        k = np.arange(1, int(2 * span / self.ins.high_pass_s) + 1)
        return np.asarray(np.cos(np.pi * k[:, None] * (t - t[0])[None, :] / span))

    def times(self, state: OffsetState) -> ArrayF:
        """GPS times (n,) of the images, without their jitter."""
        t = self.poses.t_device_s
        return np.asarray(t + state.offset_s + state.drift * (t - self.reference_s))

    def covered(self, state: OffsetState) -> ArrayB:
        """Which images (n,) lie where the track, and the INS if it is used, have no gap."""
        t = self.times(state)
        inside = self.track.at(t).inside
        return inside if self.ins is None else inside & self.ins.at(t)[2]

    def observe(self, state: OffsetState) -> Stacked:
        """Residuals and derivatives at a state, images one after the other within each group."""
        t = self.times(state)
        n, since = len(t), self.poses.t_device_s - self.reference_s
        between = self.track.at(t)
        R = self.poses.R_wcs_ccs
        r = between.position_m - self.poses.centre_wcs_m - R @ state.lever_m
        v = between.velocity_mps
        J = np.zeros((n, 3, len(self.names)))
        J[:, :, 0], J[:, :, 1], J[:, :, 2:5] = v, v * since[:, None], -R
        image = np.repeat(np.arange(n), 3)
        if self.ins is None:
            return Stacked(
                residual=r.ravel(),
                jacobian=J.reshape(3 * n, -1),
                motion=v.ravel(),
                image=image,
                between=between,
            )
        R_ins, rate, _ = self.ins.at(t)
        axes = attitude_axes(R_ins)
        wave = self.cosines()
        slow = state.slow.reshape(len(wave), 3)
        rho = Rotation.from_matrix(R_ins @ state.R_ics_ccs @ np.swapaxes(R, 1, 2)).as_rotvec()
        rho = rho + np.einsum("nij,kn,kj->ni", axes, wave, slow)
        K = np.zeros_like(J)
        K[:, :, 0], K[:, :, 1], K[:, :, 5:8] = rate, rate * since[:, None], R_ins
        if len(wave):
            K[:, :, 8:] = np.einsum("nij,kn->nikj", axes, wave).reshape(n, 3, -1)
        return Stacked(
            residual=np.concatenate([r.ravel(), rho.ravel()]),
            jacobian=np.concatenate([J.reshape(3 * n, -1), K.reshape(3 * n, -1)]),
            motion=np.concatenate([v.ravel(), rate.ravel()]),
            image=np.concatenate([image, image]),
            between=between,
        )

    def covariance(self, state: OffsetState, between: Between) -> ArrayF:
        """Covariance (m, m) of the residuals without the jitter of the images."""
        n, R = len(self.poses.t_device_s), self.poses.R_wcs_ccs
        arm = R @ state.lever_m
        groups = 1 if self.ins is None else 2
        J = np.zeros((n, groups, 3, 6))
        J[:, 0, :, :3], J[:, 0, :, 3:] = np.eye(3), -cross_matrix(arm)
        if groups == 2:
            J[:, 1, :, 3:] = np.eye(3)
        own = np.einsum("ngap,npq,nhbq->ngahb", J, self.poses.cov_pose_wcs, J)
        full = np.zeros((groups, n, 3, groups, n, 3))
        i = np.arange(n)
        # indexing with arrays on both sides puts the images first
        full[:, i, :, :, i, :] = own
        cov = full.reshape(groups * 3 * n, groups * 3 * n)
        cov[: 3 * n, : 3 * n] += self.track.covariance(between)
        if self.ins is not None:
            cov[3 * n :, 3 * n :] += self.ins.covariance(self.times(state))
        if self.field_error is not None:
            F = np.zeros((groups, n, 3, 6))
            F[0, :, :, :3] = np.eye(3)
            F[0, :, :, 3:] = -cross_matrix(self.poses.centre_wcs_m + arm - self.field_error.about_wcs_m)
            if groups == 2:
                F[1, :, :, 3:] = np.eye(3)
            flat = F.reshape(groups * 3 * n, 6)
            cov += flat @ self.field_error.cov @ flat.T
        return np.asarray(cov)


@dataclass(slots=True, kw_only=True)
class OffsetFit:
    """One estimate with a fixed choice of images.

    ``converged`` False if the turns did not come to an end; ``cov`` (u, u) of the unknowns; ``V0`` (m, m) of
    the residuals without jitter; ``effects_s`` (n,) predicted jitter of each image; ``tests`` (n,) statistic
    of an image's own error, chi-squared with 3 or 6.
    """

    model: OffsetModel
    state: OffsetState
    cov: ArrayF
    jitter: Component
    stacked: Stacked
    V0: ArrayF
    effects_s: ArrayF
    sigma0_squared: float
    redundancy: float
    tests: ArrayF
    converged: bool


# ---------------------------------------------------------------- offset


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraOffset:
    """Result of `camera_offset`.

    Parameters
    ----------
    clock : offset, drift and jitter of the clock, for any image of this camera.
    run_offset_s, sigma_run_offset_s : mean of offset and jitter over the images of this run.
    lever_ccs_antenna_m : (3,) antenna in ccs.
    R_ics_ccs : (3, 3) camera against INS; None without the INS's attitude.
    names, cov : unknowns without the slow errors of the INS, and their covariance (u, u).
    sigma0_squared, sigma0_low, sigma0_high : global test and its band of 99.9 %.
    images : a row an image: stamp, best time with sigma (jitter of that image estimated), residuals, used,
        reason.
    motion : how the boat moved.
    facts : numbers for a report.
    """

    clock: ClockModel
    run_offset_s: float
    sigma_run_offset_s: float
    lever_ccs_antenna_m: ArrayF
    R_ics_ccs: ArrayF | None
    names: tuple[str, ...]
    cov: ArrayF
    sigma0_squared: float
    sigma0_low: float
    sigma0_high: float
    images: pd.DataFrame
    motion: RunMotion
    facts: dict[str, Any]


def camera_offset(
    poses: CameraPoses,
    track: Track,
    *,
    ins: InsAttitude | None = None,
    field_error: FieldError | None = None,
    options: OffsetOptions | None = None,
) -> CameraOffset:
    """Offset, drift and jitter of a camera's clock, and the antenna in the camera's frame.

    Parameters
    ----------
    poses : images with poses in wcs.
    track : positions of the antenna in wcs.
    ins : attitudes on GPS time, an extension of P2: they fix the offset where the boat turns.
    field_error : error that all poses share.
    options : see there.

    Raises
    ------
    ClockError : no overlap, too few images, or an offset at the end of what was searched.
    CoverageError : gaps of the positions leave too few images.
    MissingMotionError : the motion does not determine the offset; names what to do.
    """
    o = options or OffsetOptions()
    order = np.argsort(poses.t_device_s, kind="stable")
    poses = poses.take(order)
    reason = np.full(len(order), "", dtype=object)
    again = np.concatenate([[False], np.diff(poses.t_device_s) <= 0])
    reason[again] = "repeated stamp"
    good = np.isfinite(poses.t_device_s) & np.isfinite(poses.cov_pose_wcs).all(axis=(1, 2))
    reason[~good] = "no pose or time"
    start = find_start(
        poses.take(reason == ""),
        track,
        largest_offset_s=o.largest_offset_s,
        largest_lever_m=o.largest_lever_m,
    )
    kept = np.flatnonzero(reason == "")
    reason[kept[start.gross]] = "gross: far from the rest before the adjustment"
    use = reason == ""
    reference = float(poses.t_device_s[use].mean())
    first = OffsetState(offset_s=start.offset_s, drift=0.0, lever_m=start.lever_m)
    everything = OffsetModel(
        poses=poses, track=track, reference_s=reference, ins=ins, field_error=field_error
    )
    hidden = use & ~everything.covered(first)
    reason[hidden] = "outside the positions or in a gap of them"
    if (reason == "").sum() < _LEAST_IMAGES:
        raise CoverageError(
            f"{int((reason == '').sum())} of {len(reason)} images lie where positions are complete",
            expected=f"at least {_LEAST_IMAGES}",
            cure="Look at the gaps of the positions in the table of streams",
        )
    fit = _until_convergence(poses, track, reason, first, ins=ins, field_error=field_error, options=o)
    motion = _gate(fit, o)
    if at_the_end(start, o.largest_offset_s):
        raise ClockError(
            f"the best offset, {fit.state.offset_s:+.2f} s, is at the end of what was searched",
            expected=f"less than {o.largest_offset_s:g} s",
            cure="Set the camera's clock, or search farther",
        )
    return _result(poses, reason, fit, motion, o, start.misfit_m)


def _until_convergence(
    poses: CameraPoses,
    track: Track,
    reason: Any,
    state: OffsetState,
    *,
    ins: InsAttitude | None,
    field_error: FieldError | None,
    options: OffsetOptions,
) -> OffsetFit:
    """Adjust, test each image, take out the worst ones, until nothing changes; writes into ``reason``."""
    n_first = int((reason == "").sum())
    for _ in range(_ROUNDS):
        use = np.flatnonzero(reason == "")
        some = poses.take(use)
        model = OffsetModel(
            poses=some,
            track=track,
            reference_s=float(some.t_device_s.mean()),
            ins=ins,
            field_error=field_error,
        )
        fit = fit_offset(model, state, options)
        state = fit.state
        size = 3 if ins is None else 6
        # sigmas that are too small for all make no outliers of a third
        scatter = max(float(np.median(fit.tests)) / float(chi2.ppf(0.5, size)), 1.0)
        limit = scatter * float(chi2.ppf(1.0 - _REJECT / len(use), size))
        worst = fit.tests > max(limit, 0.5 * float(fit.tests.max()))
        if not worst.any():
            return fit
        reason[use[worst]] = "rejected: residual does not fit"
        left = int((reason == "").sum())
        if left < max(_LEAST_IMAGES, (1 - _MOST_REJECTED) * n_first):
            away = np.linalg.norm(fit.stacked.residual[: 3 * len(use)].reshape(-1, 3), axis=1)
            raise ClockError(
                f"{n_first - left} of {n_first} images do not fit the positions (median distance "
                f"{float(np.median(away)):.3f} m)",
                expected=f"at most {_MOST_REJECTED:.0%} outliers",
                cure="Check that poses and positions are in one world frame and of one run, and their sigmas",
            )
    return fit


def _gate(fit: OffsetFit, o: OffsetOptions) -> RunMotion:
    """How the boat moved; refuse a motion that does not tell the time."""
    between, model = fit.stacked.between, fit.model
    rate = None
    if model.ins is not None:
        rate = fit.stacked.motion[3 * len(between.t_gps_s) :].reshape(-1, 3)
    noise = np.diag(model.track.velocity_covariance(between)).reshape(-1, 3).sum(axis=1)
    motion = run_motion(between.velocity_mps, model.poses.R_wcs_ccs, noise, rate_wcs_radps=rate)
    sigma = float(np.sqrt(fit.cov[0, 0]))
    if not sigma <= o.largest_sigma_s:
        seen = np.einsum("nji,nj->i", model.poses.R_wcs_ccs, between.velocity_mps)
        axis = "xyz"[int(np.argmax(np.abs(seen)))]
        raise MissingMotionError(motion.missing, ("offset", f"d{axis}"), motion.words, sigma)
    if not fit.converged:
        raise ClockError(
            "the offset does not converge",
            expected="images and positions that agree at one offset",
            cure="Check that both are of one run and in one world frame",
        )
    return motion


def _result(
    poses: CameraPoses, reason: Any, fit: OffsetFit, motion: RunMotion, o: OffsetOptions, misfit_m: float
) -> CameraOffset:
    used = reason == ""
    n, state, model = int(used.sum()), fit.state, fit.model
    test = global_test(float(np.sqrt(fit.sigma0_squared)), fit.redundancy, level=2 * _TAIL)
    low, high, scale = test.low**2, test.high**2, test.factor**2
    notes = []
    if scale > 1.0:
        notes.append(
            f"Residuals are larger than the stated sigmas explain (sigma0^2 = {fit.sigma0_squared:.2f}, at "
            f"most {high:.2f} if they were right): all sigmas are multiplied by {np.sqrt(scale):.2f}."
        )
    words = explain_shift(state.offset_s)
    if words:
        notes.append(f"The offset looks like {words}.")
    best, sigma_best, run, sigma_run = image_times(fit, scale, o)
    cov = fit.cov[: min(8, len(fit.cov)), : min(8, len(fit.cov))] * scale
    t = poses.t_device_s
    clock = ClockModel(
        offset_s=state.offset_s,
        drift=state.drift,
        reference_s=model.reference_s,
        cov=cov[:2, :2],
        jitter_s=fit.jitter.sigma,
        sigma_jitter_s=fit.jitter.sigma_of_sigma if o.jitter_s is None else float("nan"),
        source=f"kinematic run of {n} images" + (" and the INS's attitude" if model.ins else ""),
        t_first_s=float(t[used][0]),
        t_last_s=float(t[used][-1]),
        notes=tuple(notes),
    )
    t_gps, sigma = clock.to_gps(t)
    table = pd.DataFrame(
        {
            "file": poses.file,
            "t_device_s": t,
            "t_gps_s": t_gps,
            "sigma_s": sigma,
            "used": used,
            "reason": reason.astype(str),
        }
    )
    columns = ["t_best_s", "sigma_best_s", "residual_x_m", "residual_y_m", "residual_z_m", "test"]
    table[columns] = np.nan
    seen = fit.stacked.residual[: 3 * n].reshape(n, 3)
    in_camera = np.einsum("nji,nj->ni", model.poses.R_wcs_ccs, seen)
    table.loc[used, columns] = np.column_stack([best, sigma_best, in_camera, fit.tests])
    counts = pd.Series(reason[~used]).value_counts()
    return CameraOffset(
        clock=clock,
        run_offset_s=run,
        sigma_run_offset_s=sigma_run,
        lever_ccs_antenna_m=state.lever_m,
        R_ics_ccs=state.R_ics_ccs if model.ins is not None else None,
        names=model.names[: len(cov)],
        cov=cov,
        sigma0_squared=fit.sigma0_squared,
        sigma0_low=float(low),
        sigma0_high=float(high),
        images=table,
        motion=motion,
        facts={
            "images": len(t),
            "images_used": n,
            "images_left_out": {str(k): int(v) for k, v in counts.items()},
            "misfit_before_m": misfit_m,
            "redundancy": fit.redundancy,
            "sigmas_multiplied_by": float(np.sqrt(scale)),
        },
    )


# ---------------------------------------------------------------- does the motion of a run tell the time?
# Which motion is missing if it does not
#
# A shift in time moves the antenna, seen from the camera, by the velocity in the camera's frame. While that
# velocity is constant, a shift in time is the same as another place of the antenna on the boat: nobody can
# tell them apart. So a boat that stands, drives straight at constant speed, or drives a circle at constant
# speed with its bow ahead, does not determine the offset; one that speeds up, slows down, or swings from side
# to side does. For attitudes the same holds for the angular velocity in the frame of the boat.


class MissingMotionError(UnobservableError):
    """A run does not determine a time offset; ``missing`` names the motion it lacks."""

    def __init__(
        self, missing: tuple[str, ...], parameters: tuple[str, ...], found: str, sigma_s: float
    ) -> None:
        self.missing, self.parameters, self.defects = missing, parameters, 1
        GeometryError.__init__(
            self,
            f"the run does not determine the clock's offset against the antenna's place on the boat: {found}"
            + (f"; its sigma would be {sigma_s * 1e3:.0f} ms" if np.isfinite(sigma_s) else ""),
            expected=" and ".join(missing),
            cure=f"Record again with {' and '.join(missing)}: stop, speed up, reverse, swing from side to "
            "side; or give the antenna's lever arm in the frame of the camera",
        )


def run_motion(
    velocity_wcs_mps: ArrayF, R_wcs_ccs: ArrayF, noise_m2ps2: ArrayF, *, rate_wcs_radps: ArrayF | None = None
) -> RunMotion:
    """Motion of a run as far as it tells the time.

    Parameters
    ----------
    velocity_wcs_mps : (n, 3) of the antenna at the images.
    R_wcs_ccs : (n, 3, 3) attitude of the camera.
    noise_m2ps2 : (n,) variance of the velocity, summed over the axes.
    rate_wcs_radps : (n, 3) angular velocity, if attitudes are compared.
    """
    n = len(velocity_wcs_mps)
    seen = np.einsum("nji,nj->ni", R_wcs_ccs, velocity_wcs_mps)
    square = float(np.square(seen - seen.mean(axis=0)).sum())
    noise = float(noise_m2ps2.sum())
    # the sum of squares of noise in three axes scatters by its root of 2 / (3 n)
    excess = square - noise
    excess = excess if excess > _SIGNIFICANT * noise * np.sqrt(2.0 / (3.0 * n)) else 0.0
    speed = np.linalg.norm(velocity_wcs_mps, axis=1)
    spread = max(float(np.var(speed)) - noise / (3.0 * n), 0.0)
    turned = (Rotation.from_matrix(R_wcs_ccs) * Rotation.from_matrix(R_wcs_ccs[0]).inv()).magnitude()
    rate = change_rate = 0.0
    if rate_wcs_radps is not None:
        body = np.einsum("nji,nj->ni", R_wcs_ccs, rate_wcs_radps)
        rate = float(np.sqrt(np.square(body).sum(axis=1).mean()))
        change_rate = float(np.sqrt(np.square(body - body.mean(axis=0)).sum(axis=1).mean()))
    mean_velocity = float(np.sqrt(max(float((speed**2).mean()) - noise / n, 0.0)))
    return RunMotion(
        speed_mps=mean_velocity if mean_velocity < _STANDING_MPS else float(speed.mean()),
        speed_change_mps=float(np.sqrt(spread)),
        turned_deg=float(np.rad2deg(turned.max())),
        turn_rate_degps=float(np.rad2deg(rate)),
        change_mps=float(np.sqrt(excess / n)),
        change_degps=float(np.rad2deg(change_rate)),
    )


# ---------------------------------------------------------------- one estimate with a fixed choice of images
#
# The unknowns follow from least squares with the full covariance of all residuals
# (`thalweg.core.adjustment`), the variance of the jitter from restricted maximum likelihood; both in
# turns. The slopes of the track are the derivatives. They come from a wider fit than the track itself, so
# that their noise is uncorrelated with its errors; the solution is where the residuals are orthogonal to
# them, which is not exactly the least sum of squares.


def fit_offset(model: OffsetModel, state: OffsetState, o: OffsetOptions) -> OffsetFit:
    """Unknowns and the jitter's variance in turns, with a fixed choice of images.

    Raises
    ------
    UnobservableError : an unknown is not determined at all.
    """
    names = model.names
    if model.ins is not None and not (state.oriented and len(state.slow) == len(names) - 8):
        R_ins = model.ins.at(model.times(state))[0]
        between = Rotation.from_matrix(np.swapaxes(R_ins, 1, 2) @ model.poses.R_wcs_ccs)
        R_ics_ccs, slow = between.mean().as_matrix(), np.zeros(len(names) - 8)
        state = replace(state, R_ics_ccs=R_ics_ccs, slow=slow, oriented=True)
    variance = _FIRST_JITTER_S**2 if o.jitter_s is None else o.jitter_s**2
    component = Component(variance=variance, sigma_variance=0.0)
    for _ in range(_TURNS):
        stacked = model.observe(state)
        V0, Z = model.covariance(state, stacked.between), _effects(stacked)
        known = _known(o, state, len(names))
        if o.jitter_s is None:
            component = _jitter(stacked, Z, V0, known)
        root = np.asarray(np.linalg.cholesky(V0 + component.variance * Z @ Z.T))
        white = solve_triangular(root, np.column_stack([stacked.residual, stacked.jacobian]), lower=True)
        camera = Linear(residual=white[:, 0], jacobian=white[:, 1:], cov=np.ones(len(white)))
        groups = [Observations("camera", _linear(camera))]
        groups += [Observations(name, _linear(part)) for name, part in known.items()]
        adjusted = adjust(groups, np.zeros(len(names)), names)
        state = state.moved(adjusted.x)
        converged = abs(component.variance - variance) < 1e-3 * variance + 1e-10
        converged = converged and abs(adjusted.x[0]) < _CONVERGED_S
        variance = component.variance
        if converged:
            break
    stacked = model.observe(state)
    tests, effects, P = _tests(stacked, root)
    return OffsetFit(
        model=model,
        state=state,
        cov=_without_noise(adjusted.cov, P, model, stacked),
        jitter=component,
        stacked=stacked,
        V0=V0,
        effects_s=-component.variance * effects,
        sigma0_squared=adjusted.sigma0_squared,
        redundancy=adjusted.redundancy,
        tests=tests,
        converged=converged,
    )


def _linear(part: Linear) -> Callable[[ArrayF], Linear]:
    """A model that stays linear where it was linearised: the turns around it do the rest."""

    def model(dx: ArrayF) -> Linear:
        """Residuals after a small change."""
        return Linear(residual=part.residual + part.jacobian @ dx, jacobian=part.jacobian, cov=part.cov)

    return model


def _known(o: OffsetOptions, state: OffsetState, u: int) -> dict[str, Linear]:
    """Prior knowledge as observations: of the drift, and of the antenna if it is given."""
    one = np.zeros((1, u))
    one[0, 1] = 1.0
    sigma = max(o.sigma_drift, _HELD)
    parts = {"drift": Linear(residual=np.array([state.drift]), jacobian=one, cov=np.array([sigma**2]))}
    if o.lever_m is not None and o.cov_lever_m2 is not None:
        three = np.zeros((3, u))
        three[:, 2:5] = np.eye(3)
        cov = (np.asarray(o.cov_lever_m2, dtype=np.float64) + _LEVER_HELD_M**2 * np.eye(3))[None]
        residual = state.lever_m - np.asarray(o.lever_m, dtype=np.float64)
        parts["antenna"] = Linear(residual=residual, jacobian=three, cov=cov)
    return parts


def _jitter(stacked: Stacked, Z: ArrayF, V0: ArrayF, known: dict[str, Linear]) -> Component:
    """Variance of the jitter; prior knowledge stands below as further rows without jitter."""
    parts = list(known.values())
    y = np.concatenate([stacked.residual, *(part.residual for part in parts)])
    A = np.vstack([stacked.jacobian, *(part.jacobian for part in parts)])
    blocks = [part.cov[0] if part.cov.ndim == 3 else np.diag(part.cov) for part in parts]
    return estimate_component(
        y, A, np.vstack([Z, np.zeros((len(y) - len(Z), Z.shape[1]))]), block_diag(V0, *blocks)
    )


def _effects(stacked: Stacked) -> ArrayF:
    """Derivatives (m, n) of the residuals by the jitter of each image."""
    Z = np.zeros((len(stacked.motion), int(stacked.image.max()) + 1))
    Z[np.arange(len(Z)), stacked.image] = stacked.motion
    return Z


def _tests(stacked: Stacked, root: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Statistic (n,) of each image's own gross error, chi-squared with 3 or 6, ``Z^T P y`` (n,), ``P`` (m,
    m).

    ``root`` is the Cholesky factor of the residuals' covariance.
    """
    inverse = solve_triangular(root, np.eye(len(root)), lower=True, check_finite=False)
    white = inverse @ np.column_stack([stacked.jacobian, stacked.residual])
    Q, _ = np.linalg.qr(white[:, :-1])
    reduced = inverse - Q @ (Q.T @ inverse)
    P = reduced.T @ reduced
    Py = reduced.T @ white[:, -1]
    n = int(stacked.image.max()) + 1
    size = len(root) // n
    rows = np.argsort(stacked.image, kind="stable").reshape(n, size)
    blocks = P[rows[:, :, None], rows[:, None, :]]
    w = Py[rows]
    statistic = np.einsum("ni,ni->n", w, np.linalg.solve(blocks, w[:, :, None])[:, :, 0])
    return statistic, _effects(stacked).T @ Py, P


def _without_noise(cov: ArrayF, P: ArrayF, model: OffsetModel, stacked: Stacked) -> ArrayF:
    """Covariance (u, u) of the unknowns if the slopes of the track had no noise of their own.

    Noise ``n`` of the velocities ``v`` (and of angular velocities) seems to tell of time: ``E (v + n)^T P (v
    + n) = v^T P v + tr(P Cov n)``. With ``N`` the information about offset and drift that was found and
    ``B`` that without noise, errors of the estimate are ``B^-1 N B^-1``. Where nothing but noise is left,
    the variance of the offset is infinite.
    """
    noise = model.track.velocity_covariance(stacked.between)
    if model.ins is not None:
        noise = block_diag(noise, model.ins.rate_covariance(stacked.between.t_gps_s))
    since = (model.poses.t_device_s - model.reference_s)[stacked.image]
    product = P * noise
    told = np.array(
        [[product.sum(), (product @ since).sum()], [(product @ since).sum(), since @ product @ since]]
    )
    found = np.linalg.inv(cov[:2, :2])
    left = found - told
    if np.linalg.eigvalsh(left * np.outer(_UNITS, _UNITS))[0] <= 0:
        out = cov.copy()
        out[0, 0] = np.inf
        return out
    inverse = np.linalg.inv(left)
    true = inverse @ found @ inverse
    to_others = cov[:, :2] @ found
    return np.asarray(cov + to_others @ (true - cov[:2, :2]) @ to_others.T)


def image_times(fit: OffsetFit, scale: float, o: OffsetOptions) -> tuple[ArrayF, ArrayF, float, float]:
    """GPS time of each image with its own jitter (n,), sigma (n,), and mean offset of the run with its sigma.

    Henderson's mixed model equations: the jitters join the unknowns, with their variance as prior knowledge.
    What the noise of the slopes adds to the covariance of offset and drift (see `_without_noise`) goes on
    into all that was estimated with them: an offset that is wrong is made up for by the jitters, so that the
    mean time of the images is less uncertain than offset and jitters apart.
    """
    model, stacked = fit.model, fit.stacked
    Z, u = _effects(stacked), stacked.jacobian.shape[1]
    n, s = Z.shape[1], max(fit.jitter.variance, 1e-14)
    root = np.linalg.cholesky(fit.V0)
    white = solve_triangular(root, np.column_stack([stacked.jacobian, Z, stacked.residual]), lower=True)
    N = white[:, :-1].T @ white[:, :-1]
    for part in _known(o, fit.state, u).values():
        weight = np.linalg.inv(part.cov[0]) if part.cov.ndim == 3 else np.diag(1.0 / part.cov)
        N[:u, :u] += part.jacobian.T @ weight @ part.jacobian
    N[np.arange(u, u + n), np.arange(u, u + n)] += 1.0 / s
    inverse = np.linalg.inv(N)
    since = model.poses.t_device_s - model.reference_s
    best, run = model.times(fit.state) + fit.effects_s, float(fit.state.offset_s + fit.effects_s.mean())
    if not np.isfinite(fit.cov[:2, :2]).all():
        return best, np.full(n, np.inf), run, float("inf")
    added = fit.cov[:2, :2] - inverse[:2, :2]
    with_clock = inverse[:, :2] @ np.linalg.inv(inverse[:2, :2])
    inverse += with_clock @ added @ with_clock.T
    inverse *= scale
    to_time = np.zeros((n, u + n))
    to_time[:, 0], to_time[:, 1] = 1.0, since
    to_time[np.arange(n), u + np.arange(n)] = 1.0
    cov = to_time @ inverse @ to_time.T
    mean = to_time.mean(axis=0)
    return best, np.sqrt(np.diag(cov)), run, float(np.sqrt(mean @ inverse @ mean))


# ---------------------------------------------------------------- A variance component by restricted maximum
# likelihood, and the random effects that it belongs to
#
# ``y = A b + Z u + e`` with ``Cov e = V`` known and ``u`` independent with one unknown variance ``s``. The
# restricted likelihood (Patterson and Thompson 1971) does not depend on ``b``. With ``P = V^-1 - V^-1 A (A^T
# V^-1 A)^-1 A^T V^-1`` and the eigenvalues ``l`` of ``Z^T P Z`` it is a sum over them, so that one
# decomposition serves every ``s``.


def estimate_component(y: ArrayF, A: ArrayF, Z: ArrayF, V: ArrayF) -> Component:
    """The variance of ``u``.

    Parameters
    ----------
    y : (m,) observations or residuals at any b.
    A : (m, p) derivatives by the fixed unknowns; prior knowledge enters as further rows of y, A and V.
    Z : (m, n) derivatives by the random effects.
    V : (m, m) covariance of everything else.
    """
    L = np.linalg.cholesky(V)
    white = solve_triangular(L, np.column_stack([A, Z, y]), lower=True, check_finite=False)
    p = A.shape[1]
    Q, _ = np.linalg.qr(white[:, :p])
    free = white[:, p:] - Q @ (Q.T @ white[:, p:])
    values, vectors = np.linalg.eigh(free[:, :-1].T @ free[:, :-1])
    keep = values > _FLOOR * values[-1]
    values = values[keep]
    square = np.square(vectors[:, keep].T @ (free[:, :-1].T @ free[:, -1]))

    def misfit(log_s: float) -> float:
        """Twice the negative restricted log likelihood, but for a constant."""
        s = np.exp(log_s)
        return float(np.sum(np.log1p(s * values) - s * square / (1.0 + s * values)))

    unit = 1.0 / float(np.median(values))  # the variance at which an effect stands out of the noise
    found = minimize_scalar(misfit, bounds=(np.log(1e-6 * unit), np.log(1e6 * unit)), method="bounded")
    s = float(np.exp(found.x))
    if misfit(float(np.log(1e-6 * unit))) <= found.fun + 1e-6:
        s = 0.0
    information = 0.5 * float(np.sum(np.square(values / (1.0 + s * values))))
    return Component(variance=s, sigma_variance=float(1.0 / np.sqrt(information)))


# ---------------------------------------------------------------- first value: a search in time


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """Approximate offset, antenna in ccs (3,), and images (n,) that do not agree with the rest."""

    offset_s: float
    lever_m: ArrayF
    gross: ArrayB
    misfit_m: float
    overlapping: int


def find_start(poses: CameraPoses, track: Track, *, largest_offset_s: float, largest_lever_m: float) -> Start:
    """The offset at which the antenna stands still most, seen from the camera.

    Parameters
    ----------
    poses : images in order of time.
    track : positions of the antenna.
    largest_offset_s : the offset is looked for between minus and plus this.
    largest_lever_m : no antenna is farther from the camera. A boat that speeds up and slows down in a rhythm
        on a straight course fits as well one period later, with an antenna far ahead.

    Raises
    ------
    ClockError : images and positions do not overlap at any offset, or only with a shift by whole hours.
    CoverageError : they do, but too few images lie where positions are complete.
    """
    if len(poses.t_device_s) < _LEAST_IMAGES:
        raise ClockError(
            f"{len(poses.t_device_s)} images with a pose and a time",
            expected=f"at least {_LEAST_IMAGES}; a run of some minutes at one image a second is good",
        )
    grid: ArrayF = np.arange(-largest_offset_s, largest_offset_s + _STEP_S / 2, _STEP_S)
    best = _best(poses, track, grid, largest_lever_m)
    if best is None and _best(poses, track, grid, np.inf) is not None:
        raise ClockError(
            f"at no offset within {largest_offset_s:g} s is the antenna within {largest_lever_m:g} m of the "
            "camera",
            expected="poses and positions of one boat in one world frame",
            cure="Check the georeferencing of the poses, the offset of the camera from UTC, and the run",
        )
    if best is None:
        covered = int(_seen(poses, track, 0.0)[1].sum())
        within = (poses.t_device_s >= track.t_gps_s[0]) & (poses.t_device_s <= track.t_gps_s[-1])
        if within.any():
            raise CoverageError(
                f"{covered} of {len(poses.t_device_s)} images lie where positions are complete",
                expected=f"at least {_least(poses)}",
                cure="Look at the gaps of the positions in the table of streams",
            )
        raise _apart(poses, track, largest_offset_s, largest_lever_m)
    for step in (_STEP_S / 5, _STEP_S / 50):
        finer = _best(poses, track, best + step * np.arange(-10.0, 11.0), largest_lever_m)
        best = best if finer is None else finer
    seen, inside = _seen(poses, track, best)
    lever = np.median(seen[inside], axis=0)
    away = np.linalg.norm(seen - lever, axis=1)
    scale = NMAD * float(np.median(away[inside]))
    return Start(
        offset_s=float(best),
        lever_m=lever,
        gross=inside & (away > _GROSS * max(scale, 1e-3)),
        misfit_m=float(np.median(away[inside])),
        overlapping=int(inside.sum()),
    )


def at_the_end(start: Start, largest_offset_s: float) -> bool:
    """True if the best offset is at an end of what was searched."""
    return abs(start.offset_s) > largest_offset_s - 1.5 * _STEP_S


def _best(poses: CameraPoses, track: Track, offsets: ArrayF, largest_lever_m: float) -> float | None:
    """The offset at which the antenna is nearest to one place in the median; None if there is none."""
    best, found = float("inf"), None
    for some in np.array_split(offsets, 1 + len(offsets) * len(poses.t_device_s) // _AT_ONCE):
        seen, inside = _seen(poses, track, some)
        enough = inside.sum(axis=1) >= _least(poses)
        some, seen, inside = some[enough], seen[enough], inside[enough]
        middle = np.stack([_medians(seen[..., i], inside) for i in range(3)], axis=-1)
        misfit = _medians(np.linalg.norm(seen - middle[:, None], axis=2), inside)
        misfit[np.linalg.norm(middle, axis=1) > largest_lever_m] = np.inf
        if len(some) and misfit.min() < best:
            best, found = float(misfit.min()), float(some[misfit.argmin()])
    return found


def _medians(values: ArrayF, inside: ArrayB) -> ArrayF:
    """Medians (k,) of those of each row (k, n) that are inside."""
    ordered = np.sort(np.where(inside, values, np.inf), axis=1)
    row, n = np.arange(len(values)), inside.sum(axis=1)
    return np.asarray((ordered[row, (n - 1) // 2] + ordered[row, n // 2]) / 2)


def _least(poses: CameraPoses) -> int:
    """Images that must overlap with the track."""
    return max(_LEAST_IMAGES, len(poses.t_device_s) // 5)


def _seen(poses: CameraPoses, track: Track, offset_s: float | ArrayF) -> tuple[ArrayF, ArrayB]:
    """Antenna in ccs (n, 3) at an offset, linearly between epochs, and which images the track covers (n,).

    With a leading axis for several offsets (k,).
    """
    t = poses.t_device_s + np.asarray(offset_s)[..., None]
    right = np.clip(np.searchsorted(track.t_gps_s, t), 1, len(track.t_gps_s) - 1)
    step = track.t_gps_s[right] - track.t_gps_s[right - 1]
    inside = (t >= track.t_gps_s[0]) & (t <= track.t_gps_s[-1]) & (step < _GAP * track.step_s)
    at = np.stack([np.interp(t, track.t_gps_s, track.position_m[:, i]) for i in range(3)], axis=-1)
    return np.einsum("nji,...nj->...ni", poses.R_wcs_ccs, at - poses.centre_wcs_m), inside


def _apart(poses: CameraPoses, track: Track, largest_offset_s: float, largest_lever_m: float) -> ClockError:
    """The error about runs that share no time; a shift by whole hours that would fit is named."""
    spans = [
        f"{utc_text_from_gps(float(t[0]), 0)} .. {utc_text_from_gps(float(t[-1]), 0)}"
        for t in (poses.t_device_s, track.t_gps_s)
    ]
    found = f"the images (camera's clock {spans[0]}) and the positions ({spans[1]}) do not overlap"
    near: ArrayF = np.arange(-largest_offset_s, largest_offset_s + 0.5, 0.5)
    noise = float(np.sqrt(np.trace(track.cov_m2, axis1=1, axis2=2).mean()))
    fitting: list[tuple[float, float]] = []
    days = round(float(track.t_gps_s[0] - poses.t_device_s[0]) / 86_400.0)
    for day in sorted({0, days - 1, days, days + 1}):
        for zone in range(-_ZONES, _ZONES + 1):
            shift = day * 86_400.0 + zone * QUARTER_HOUR_S
            first, last = poses.t_device_s[[0, -1]] + shift
            if not shift or first > track.t_gps_s[-1] or last < track.t_gps_s[0]:
                continue
            offset = _best(poses, track, shift + near, largest_lever_m + _CRUDE_M)
            if offset is None:
                continue
            finer = _best(poses, track, offset + 0.05 * np.arange(-10.0, 11.0), largest_lever_m + _CRUDE_M)
            seen, inside = _seen(poses, track, offset if finer is None else finer)
            misfit = float(np.median(np.linalg.norm(seen[inside] - np.median(seen[inside], axis=0), axis=1)))
            fitting.append((misfit, offset))
    if not fitting:
        return ClockError(
            found,
            expected="images and positions of one run",
            cure="Check that both are of the same run and day, and the camera's offset from UTC",
        )
    misfit, offset = min(fitting)
    words = explain_shift(offset, largest_offset_s + 1.0)
    fits = misfit < _FITS * noise + 0.1
    return ClockError(
        f"{found}; shifted by {offset:+.1f} s ({words}) they would, and the antenna would "
        + (
            f"stand still on the boat within {misfit:.2f} m"
            if fits
            else f"wander by {misfit:.1f} m on the boat"
        ),
        expected="images and positions on one time scale",
        cure="State the camera's offset from UTC, or the right date; nothing is corrected silently"
        if fits
        else "Check that both are of the same run, and the date of the camera",
    )
