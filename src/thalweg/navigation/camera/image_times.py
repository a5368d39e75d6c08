"""When the images of a survey were taken: the camera's clock, and what positions and INS say of each image.

The poses of the images against antenna positions and attitudes of the INS tell the offset of the clock and,
image by image, its jitter (P2 eq. 5, `thalweg.clocks.camera_offset`). The clock of a calibration is an
observation of the same offset: both are compared, and joined if they agree.

Two kinds of times follow. By the ``clock`` an image keeps its jitter, in its sigma; INS and positions of the
survey enter as one offset for all images, if at all. ``estimated`` times take the jitter out, but then each
image has been moved to where the INS agrees: its trajectory is no second opinion about the INS any more, and
whoever joins both must not count it as one.
"""

import logging
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from thalweg.clocks import (
    IMAGE_TIMES,
    CameraOffset,
    CameraPoses,
    ClockModel,
    InsAttitude,
    OffsetOptions,
    Track,
    camera_offset,
)
from thalweg.core import ArrayF, ClockError, Rigid, ThalwegError, frame_of
from thalweg.images.model import ImagePoses
from thalweg.ingest import explain_shift
from thalweg.ingest.photos import by_any_name
from thalweg.settings.sections import CameraCloud

CONTRADICTION: Final = 4.0
"""Sigmas by which the clock of the calibration may differ from that of the survey."""
_NO_STAMP: Final = "no stamp"
_NO_POSE: Final = "no pose"
_SPREAD_S: Final = 0.1
"""A clock that is less certain than this at the survey is worth a note: 0.7 degrees at 7 degrees/s."""
_LOG = logging.getLogger("thalweg")


@dataclass(frozen=True, slots=True, kw_only=True)
class RunClock:
    """``clock`` of the survey; ``sigma_run_offset_s`` of the mean time of its images; ``images``, a row an
    image as of `thalweg.clocks.camera_offset.CameraOffset`; ``facts`` for a report.
    """

    clock: ClockModel
    sigma_run_offset_s: float
    images: pd.DataFrame
    facts: dict[str, Any]


# ---------------------------------------------------------------- times of images


@dataclass(frozen=True, slots=True, kw_only=True)
class TimedImages:
    """Result of `time_images`.

    ``poses`` with times; ``table`` kind ``image_times``: by the clock and, where estimated, with the image's
    own jitter; ``clock`` of the camera as it was used; ``facts`` for a report.
    """

    poses: ImagePoses
    table: pd.DataFrame
    clock: ClockModel
    facts: dict[str, Any]


def time_images(
    poses: ImagePoses,
    stamps: pd.DataFrame,
    *,
    track: Track | None,
    ins: InsAttitude | None,
    clock: ClockModel | None,
    options: OffsetOptions,
    use: Literal["clock", "estimated"] = "clock",
    clock_from: Literal["both", "calibration", "run"] = "both",
    images_together: int = CameraCloud().images_together,
) -> TimedImages:
    """Times of the images of a survey.

    Parameters
    ----------
    poses : in the world frame; their times, if any, are replaced.
    stamps : table kind ``image_stamps``.
    track : antenna positions, or None.
    ins : attitudes of the INS, or None.
    clock : of the camera by a calibration, or None.
    options : of the estimate; with the antenna's place in the camera, if known.
    use : which times the poses get.
    clock_from : which knowledge of the clock is used.
    images_together : images that are estimated in one step.

    Raises
    ------
    ClockError : no image has both a pose and a stamp; or there is no clock at all, because none is given and
        the survey does not tell it.
    """
    device = _stamps_of(stamps)
    meant = by_any_name(list(device))
    names = [meant.get(name, meant.get(_base(name), name)) for name in poses.images]
    t_device = np.array([device.get(name, np.nan) for name in names], dtype=np.float64)
    stamped = np.isfinite(t_device)
    both = poses.oriented & stamped
    if not both.any():
        raise ClockError(
            f"none of {int(poses.oriented.sum())} images with a pose is among {len(device)} images with a "
            "stamp",
            expected="the names of the same files",
            cure="Read the stamps of the folder whose images were oriented",
        )
    notes: list[str] = []
    run = (
        None
        if clock_from == "calibration" and clock is not None
        else _run(
            poses, names, t_device, both, track, ins, options, images_together, notes, needed=clock is None
        )
    )
    given = None if clock_from == "run" and run is not None else clock
    used, source = _joined(given, run, notes, compared=clock)
    t_clock, sigma_clock = used.to_gps(t_device)
    _, sigma_common = used.to_gps(t_device[both], jitter=False)
    best, sigma_best = _best(names, run)
    estimated = (use == "estimated") & np.isfinite(best)
    if use == "estimated" and not estimated.any():
        notes.append("No time of a single image could be estimated: all are by the clock")
    t = np.where(estimated, best, t_clock)
    sigma = np.where(estimated, sigma_best, sigma_clock)
    common_s = float(np.median(sigma_common))
    if estimated.any() and run is not None:
        common_s = run.sigma_run_offset_s
    if common_s > _SPREAD_S:
        notes.append(f"The clock is known to {common_s:.2f} s only at the time of the survey")
    facts = {
        "used": "estimated" if estimated.any() else "clock",
        "clock": source,
        "jitter_s": used.jitter_s,
        "sigma_common_s": common_s,
        "offset_s": used.offset_s,
        "sigma_offset_s": used.sigma_offset_s,
        "images": len(names),
        "images_timed": int(np.isfinite(t).sum()),
        "images_estimated": int(estimated.sum()),
        "images_without_stamp": int((~stamped).sum()),
        "stamps_without_image": len(set(device) - set(names)),
        "median_sigma_s": float(np.median(sigma[both])),
        "uses_ins": bool(estimated.any()) or (run is not None and source != "calibration"),
        "independent_of_ins": not estimated.any(),
        "notes": notes,
    }
    for note in notes:
        _LOG.warning("%s", note)
    timed = replace(poses.with_times(t, sigma), facts={**poses.facts, "image_times": facts})
    table = _table(names, t_device, t_clock, sigma_clock, best, sigma_best, poses, run)
    more = {} if run is None else {"run": run.facts}
    return TimedImages(poses=timed, table=table, clock=used, facts={**facts, **more})


def _run(
    poses: ImagePoses,
    names: list[str],
    t_device: ArrayF,
    both: Any,
    track: Track | None,
    ins: InsAttitude | None,
    options: OffsetOptions,
    images_together: int,
    notes: list[str],
    *,
    needed: bool,
) -> RunClock | None:
    """The clock by the survey's own images, or None with a note why not."""
    if track is None:
        if needed:
            raise ClockError(
                "no positions, and no clock of a calibration",
                expected="antenna positions, or a calibration with the camera's clock",
                cure="Name a calibration with a run of the camera in mounts.calibration",
            )
        notes.append("Without positions the clock is that of the calibration")
        return None
    at = np.flatnonzero(both)
    at = at[np.argsort(t_device[at], kind="stable")]
    images = CameraPoses(
        file=np.array([names[k] for k in at], dtype=object),
        t_device_s=t_device[at],
        R_wcs_ccs=poses.R_wcs_ccs[at],
        centre_wcs_m=poses.centre_wcs_m[at],
        cov_pose_wcs=poses.cov_pose_wcs[at],
    )
    try:
        return run_clock(images, track, ins=ins, options=options, images_together=images_together)
    except ThalwegError as error:
        if needed:
            raise ClockError(
                f"the survey does not tell the clock of the camera ({error.found}), and no calibration "
                "states it",
                expected=error.expected or "turns and changes of speed",
                cure="Name a calibration with the camera's clock in mounts.calibration. " + error.cure,
            ) from error
        notes.append(f"The clock is that of the calibration: the survey does not tell it ({error.found})")
        return None


def _joined(
    clock: ClockModel | None, run: RunClock | None, notes: list[str], *, compared: ClockModel | None
) -> tuple[ClockModel, str]:
    """The clock that is used, and where it is from; contradictions in words."""
    if run is None:
        assert clock is not None
        return clock, "calibration"
    if compared is not None:
        t = run.clock.reference_s
        expected_s, sigma_s = (float(value[0]) for value in compared.to_gps([t], jitter=False))
        off_s = t + run.clock.offset_s - expected_s
        sigma = float(np.hypot(sigma_s, run.clock.sigma_offset_s))
        if abs(off_s) > CONTRADICTION * sigma:
            cause = explain_shift(off_s)
            notes.append(
                f"The clock of the calibration is {off_s:+.3f} s off from what the survey's own images and "
                f"positions say, {abs(off_s) / sigma:.0f} times its sigma of {sigma * 1e3:.1f} ms"
                + (f"; it looks like {cause}" if cause else ": was the camera's clock set in between?")
                + ". That of the survey is used"
            )
            return run.clock, "run, the calibration contradicts it"
    if clock is None:
        return run.clock, "run"
    return _weighted(clock, run.clock), "calibration and run"


def _weighted(one: ClockModel, own: ClockModel) -> ClockModel:
    """Both clocks by their covariances, at the reference of the second; jitter of the second."""
    since = own.reference_s - one.reference_s
    J = np.array([[1.0, since], [0.0, 1.0]])
    first = np.array([one.offset_s + one.drift * since, one.drift])
    second = np.array([own.offset_s, own.drift])
    C1, C2 = J @ one.cov @ J.T, own.cov
    gain = C1 @ np.linalg.pinv(C1 + C2, hermitian=True, rcond=1e-24)
    value = first + gain @ (second - first)
    rest = np.eye(2) - gain
    cov = rest @ C1 @ rest.T + gain @ C2 @ gain.T
    return ClockModel(
        offset_s=float(value[0]),
        drift=float(value[1]),
        reference_s=own.reference_s,
        cov=(cov + cov.T) / 2,
        jitter_s=own.jitter_s,
        sigma_jitter_s=own.sigma_jitter_s,
        source=f"{one.source}; {own.source}",
        t_first_s=own.t_first_s,
        t_last_s=own.t_last_s,
        notes=own.notes,
    )


def _best(names: list[str], run: RunClock | None) -> tuple[ArrayF, ArrayF]:
    if run is None:
        return np.full(len(names), np.nan), np.full(len(names), np.nan)
    found = _by_name(run, names)
    return found["t_best_s"].to_numpy(np.float64), found["sigma_best_s"].to_numpy(np.float64)


def _by_name(run: RunClock, names: list[str]) -> pd.DataFrame:
    """Rows of the estimate for images, empty where it has none."""
    return run.images.drop_duplicates("file").set_index("file").reindex(names)


def _table(
    names: list[str],
    t_device: ArrayF,
    t_gps_s: ArrayF,
    sigma_s: ArrayF,
    best: ArrayF,
    sigma_best: ArrayF,
    poses: ImagePoses,
    run: RunClock | None,
) -> pd.DataFrame:
    """Table kind ``image_times`` of all images of the poses."""
    lacking = np.where(np.isfinite(t_device), np.where(poses.oriented, "", _NO_POSE), _NO_STAMP)
    columns: dict[str, Any] = {
        "file": names,
        "t_device_s": t_device,
        "t_gps_s": t_gps_s,
        "sigma_s": sigma_s,
        "used": np.zeros(len(names), dtype=np.bool_),
        "reason": lacking.astype(object),
        "t_best_s": best,
        "sigma_best_s": sigma_best,
    }
    rest = [f"residual_{a}_m" for a in "xyz"] + ["test"]
    columns |= {name: np.full(len(names), np.nan) for name in rest}
    if run is None:
        columns["reason"][lacking == ""] = "the clock of the calibration"
    else:
        found = _by_name(run, names)
        columns["used"] = found["used"].eq(True).to_numpy()
        known = found["reason"].notna().to_numpy() & (lacking == "")
        columns["reason"][known] = found["reason"].to_numpy()[known]
        columns |= {name: found[name].to_numpy(np.float64) for name in rest}
    columns["reason"] = [str(word) for word in columns["reason"]]
    return frame_of(IMAGE_TIMES, columns)


def _stamps_of(stamps: pd.DataFrame) -> dict[str, float]:
    t = stamps["t_device_s"].to_numpy(np.float64)
    known = np.isfinite(t)
    return dict(zip(stamps["file"].astype(str)[known], t[known].tolist(), strict=True))


def _base(name: str) -> str:
    return name.replace("\\", "/").rsplit("/", 1)[-1]


# ---------------------------------------------------------------- the clock by some hundred images at a time
#
# The estimate holds the covariance of all images' residuals at once and costs the cube of their number, so
# long surveys are cut into parts in order of time, each with an offset of its own; one line through these
# is the clock.


def run_clock(
    poses: CameraPoses, track: Track, *, ins: InsAttitude | None, options: OffsetOptions, images_together: int
) -> RunClock:
    """Clock of a camera by a survey.

    Errors that neighbouring images share count in each pose as if they were its own: at some millimetres and
    hundredths of a degree they are far below those of positions and INS.

    Parameters
    ----------
    poses : images in order of their stamps.
    track : antenna positions.
    ins : attitudes, or None.
    options : of the estimate.
    images_together : images of a part at most.

    Raises
    ------
    ThalwegError : no part tells the clock; the error of the first one.
    """
    n = len(poses.t_device_s)
    parts = np.array_split(np.arange(n), max(1, -(-n // images_together)))
    found: list[CameraOffset] = []
    tables: list[pd.DataFrame] = []
    refused: list[ThalwegError] = []
    for part in parts:
        try:
            done = camera_offset(poses.take(part), track, ins=ins, options=options)
        except ThalwegError as error:
            refused.append(error)
            continue
        found.append(done)
        tables.append(done.images)
    if not found:
        raise refused[0]
    clock = found[0].clock if len(found) == 1 else _line(found, options)
    sigma_run = np.array([done.sigma_run_offset_s for done in found])
    facts = {
        "parts": len(parts),
        "parts_refused": [error.found for error in refused],
        "images_in_refused_parts": n - sum(len(table) for table in tables),
        "images_used": int(sum(table["used"].sum() for table in tables)),
        "offset_s": clock.offset_s,
        "sigma_offset_s": clock.sigma_offset_s,
        "drift_ppm": clock.drift * 1e6,
        "sigma_drift_ppm": clock.sigma_drift * 1e6,
        "jitter_s": clock.jitter_s,
        "sigma_jitter_s": clock.sigma_jitter_s,
        "sigma0_squared": [done.sigma0_squared for done in found],
        "sigma0_squared_bands": [[done.sigma0_low, done.sigma0_high] for done in found],
        "with_attitude": ins is not None,
        "notes": list(dict.fromkeys(note for done in found for note in done.clock.notes)),
    }
    return RunClock(
        clock=clock,
        sigma_run_offset_s=float(np.median(sigma_run)),
        images=pd.concat(tables, ignore_index=True),
        facts=facts,
    )


def antenna_in_camera(
    T_ics_ccs: Rigid, lever_ics_antenna_m: ArrayLike, sigma_lever_m: ArrayLike
) -> tuple[ArrayF, ArrayF]:
    """The antenna in the frame of the camera (3,) and its covariance (3, 3), by the mounts of both.

    Known places of both let a straight course tell the time, too: along it a shift of time is no longer the
    same as another place of the antenna.

    Parameters
    ----------
    T_ics_ccs : mount of the camera with covariance.
    lever_ics_antenna_m, sigma_lever_m : (3,) place of the antenna and its standard deviations.
    """
    T_ccs_ics = T_ics_ccs.inverse()
    lever = np.asarray(lever_ics_antenna_m, dtype=np.float64)[None]
    J = T_ccs_ics.by_error(lever)[0]
    own = T_ccs_ics.R * np.asarray(sigma_lever_m, dtype=np.float64)
    return T_ccs_ics.apply(lever)[0], np.asarray(J @ T_ccs_ics.cov @ J.T + own @ own.T)


def _line(found: list[CameraOffset], options: OffsetOptions) -> ClockModel:
    """One clock from those of parts: their information adds, prior knowledge of the drift counts once."""
    clocks = [done.clock for done in found]
    reference = float(np.mean([clock.reference_s for clock in clocks]))
    N, y = np.zeros((2, 2)), np.zeros(2)
    start = clocks[0].offset_s
    for clock in clocks:
        # offset and drift at the part's own reference
        J = np.array([[1.0, clock.reference_s - reference], [0.0, 1.0]])
        weight = np.linalg.inv(clock.cov)
        N += J.T @ weight @ J
        y += J.T @ weight @ np.array([clock.offset_s - start, clock.drift])
    if options.sigma_drift > 0:
        N[1, 1] -= (len(clocks) - 1) / options.sigma_drift**2
    cov = np.linalg.inv(N)
    value = cov @ y
    used = np.array([int(done.images["used"].sum()) for done in found], dtype=np.float64)
    jitter = np.sqrt(np.average([clock.jitter_s**2 for clock in clocks], weights=used))
    of_jitter = np.array([clock.sigma_jitter_s for clock in clocks])
    return ClockModel(
        offset_s=start + float(value[0]),
        drift=float(value[1]),
        reference_s=reference,
        cov=(cov + cov.T) / 2,
        jitter_s=float(jitter),
        sigma_jitter_s=float(np.sqrt(np.sum(np.square(used * of_jitter))) / used.sum()),
        source=f"survey, {int(used.sum())} images in {len(clocks)} parts",
        t_first_s=min(clock.t_first_s for clock in clocks),
        t_last_s=max(clock.t_last_s for clock in clocks),
        notes=tuple(dict.fromkeys(note for clock in clocks for note in clock.notes)),
    )
