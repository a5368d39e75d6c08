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

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from thalweg.clocks.camera.offset_fit import OffsetFit, OffsetOptions, fit_offset, image_times
from thalweg.clocks.camera.offset_observations import (
    CameraPoses,
    FieldError,
    InsAttitude,
    OffsetModel,
    OffsetState,
)
from thalweg.clocks.camera.offset_start import at_the_end, find_start
from thalweg.clocks.camera.track import Track
from thalweg.clocks.ties.model import ClockModel
from thalweg.core.adjustment.solve import UnobservableError
from thalweg.core.errors import ClockError, CoverageError, GeometryError
from thalweg.core.types import ArrayF
from thalweg.ingest.clock_shift import explain_shift

# ---------------------------------------------------------------- does the motion of a run tell the time?
# Which motion is missing if it does not
#
# A shift in time moves the antenna, seen from the camera, by the velocity in the camera's frame. While that
# velocity is constant, a shift in time is the same as another place of the antenna on the boat: nobody can
# tell them apart. So a boat that stands, drives straight at constant speed, or drives a circle at constant
# speed with its bow ahead, does not determine the offset; one that speeds up, slows down, or swings from side
# to side does. For attitudes the same holds for the angular velocity in the frame of the boat.


_SIGNIFICANT: Final = 4.0
"""Sigmas by which the velocity must change more than its noise."""
_STANDING_MPS: Final = 0.05
_TURNS_DEG: Final = 30.0
"""Less change of the attitude is no turn: a boat on a straight course yaws by some degrees."""
_STEADY: Final = 0.15
"""Speeds that scatter by less than this share of their mean are constant, as far as a helmsman can tell."""


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


def run_motion(
    velocity_wcs_mps: ArrayF,
    R_wcs_ccs: ArrayF,
    noise_m2ps2: ArrayF,
    *,
    rate_wcs_radps: ArrayF | None = None,
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


# ---------------------------------------------------------------- offset


_LEAST_IMAGES: Final = 8
_ROUNDS: Final = 40
_REJECT: Final = 1e-3
"""Probability with which one good image of the run is rejected."""
_MOST_REJECTED: Final = 0.3
_TAIL: Final = 0.0005
"""Both tails of the global test."""


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
    fit = _settled(poses, track, reason, first, ins=ins, field_error=field_error, options=o)
    motion = _gate(fit, o)
    if at_the_end(start, o.largest_offset_s):
        raise ClockError(
            f"the best offset, {fit.state.offset_s:+.2f} s, is at the end of what was searched",
            expected=f"less than {o.largest_offset_s:g} s",
            cure="Set the camera's clock, or search farther",
        )
    return _result(poses, reason, fit, motion, o, start.misfit_m)


def _settled(
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
    if not fit.settled:
        raise ClockError(
            "the offset does not settle",
            expected="images and positions that agree at one offset",
            cure="Check that both are of one run and in one world frame",
        )
    return motion


def _result(
    poses: CameraPoses, reason: Any, fit: OffsetFit, motion: RunMotion, o: OffsetOptions, misfit_m: float
) -> CameraOffset:
    used = reason == ""
    n, state, model = int(used.sum()), fit.state, fit.model
    low, high = (float(chi2.ppf(p, fit.redundancy)) / fit.redundancy for p in (_TAIL, 1 - _TAIL))
    scale = fit.sigma0_squared if fit.sigma0_squared > high else 1.0
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
    table = pd.DataFrame({
        "file": poses.file,
        "t_device_s": t,
        "t_gps_s": t_gps,
        "sigma_s": sigma,
        "used": used,
        "reason": reason.astype(str),
    })  # fmt: skip
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
