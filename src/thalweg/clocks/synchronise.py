"""A camera's clock from the tables of a calibration run, in three variants that show what each assumption is
worth.

``p2``: as published, independent positions, exact stamps, no drift. ``positions``: the same observations
with what is known of their errors. ``positions and attitude``: the INS's attitude as well. The last one that
the run allows is used.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa

from thalweg.clocks.camera_offset import (
    CameraOffset,
    CameraPoses,
    FieldError,
    InsAttitude,
    OffsetOptions,
    camera_offset,
)
from thalweg.clocks.track import Track
from thalweg.core import (
    ArrayF,
    ClockError,
    CoverageError,
    InputError,
    LocalFrame,
    Rigid,
    ThalwegError,
    column,
    frame_of,
    rotation_enu_body,
    table_kind,
)

IMAGE_TIMES = table_kind(
    "image_times",
    1,
    [
        column("file", "1", "name of the image", pa.string()),
        column("t_device_s", "s", "stamp, adjusted GPS time if the camera's clock were right"),
        column("t_gps_s", "s", "adjusted GPS time by the model of the clock"),
        column("sigma_s", "s", "its standard deviation, jitter of the image included"),
        column("used", "1", "whether the image took part", pa.bool_()),
        column("reason", "1", "why not", pa.string()),
        column("t_best_s", "s", "adjusted GPS time with the image's own jitter estimated; NaN if not used"),
        column("sigma_best_s", "s", "its standard deviation"),
        *(column(f"residual_{a}_m", "m", f"antenna minus its place, {a} of ccs") for a in "xyz"),
        column("test", "1", "statistic of the image's own error, chi-squared with 3 or 6"),
    ],
)
VARIANTS: Final = ("p2", "positions", "positions and attitude")
_ATTITUDE_DEG: Final = (0.1, 0.1, 0.2)
"""Roll, pitch, heading of an INS that does not state them (T 2.2.1)."""

_LEAST_SPEED_MPS: Final = 0.02
"""Slower, and the direction of the motion is that of the noise."""
IMAGE_FIXES = table_kind(
    "image_fixes",
    1,
    [
        column("file", "1", "name of the image", pa.string()),
        column("t_gps_s", "s", "adjusted GPS time by the model of the clock"),
        column("east_m", "m", "antenna by the pose of the image, wcs"),
        column("north_m", "m", "antenna by the pose of the image, wcs"),
        column("up_m", "m", "antenna by the pose of the image, wcs"),
        column("speed_mps", "m/s", "horizontal speed of the track"),
        column("residual_along_m", "m", "track minus image along the horizontal motion; NaN if it stands"),
        column("residual_across_m", "m", "track minus image to the left of the motion; NaN if it stands"),
        column("residual_up_m", "m", "track minus image, upward"),
        column("used", "1", "whether the image took part", pa.bool_()),
    ],
)
ANTENNA_TRACK = table_kind(
    "antenna_track",
    1,
    [
        column("t_gps_s", "s", "adjusted GPS time"),
        column("east_m", "m", "antenna, wcs"),
        column("north_m", "m", "antenna, wcs"),
        column("up_m", "m", "antenna, wcs"),
    ],
)


# ---------------------------------------------------------------- synchronisation


@dataclass(frozen=True, slots=True, kw_only=True)
class Synchronised:
    """Result that is used, its variant, and a table of all variants."""

    result: CameraOffset
    variant: str
    variants: pd.DataFrame


def run_poses(
    names: list[str], poses: Mapping[str, Rigid], T_wcs_pcs: Rigid, stamps: pd.DataFrame
) -> tuple[CameraPoses, FieldError, dict[str, int]]:
    """Poses of the images that have a stamp, in wcs, and the error of the field that they share.

    Errors of the interior orientation and of the field's points count in each pose as if they were its own,
    though all images share them. On the calibration run of the twin (148 images; 0.1 mm a pose by its own
    marks, 0.3 mm with what is shared) the true sigma of the offset differs from the stated one by less than
    0.1 %, those of the antenna's place by 0.1 %; with three times these shared errors by 0.3 % and 1.2 %:
    GNSS and the jitter of the images rule both.

    Parameters
    ----------
    names : images with a pose.
    poses : ``T_pcs_ccs`` by image.
    T_wcs_pcs : place of the field in the world, with covariance.
    stamps : table kind ``image_stamps``.

    Raises
    ------
    ClockError : no image has both.
    """
    known = stamps[np.isfinite(stamps["t_device_s"].to_numpy(np.float64))]
    times = dict(zip(known["file"], known["t_device_s"], strict=True))
    both = [name for name in names if _base(name) in times]
    if not both:
        raise ClockError(
            f"none of {len(names)} images with a pose is among {len(times)} images with a time",
            expected="the names of the same files",
            cure="Read the stamps of the folder whose images were oriented",
        )
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = T_wcs_pcs.R
    found = [poses[name] for name in both]
    t = np.array([times[_base(name)] for name in both], dtype=np.float64)
    order = np.argsort(t, kind="stable")
    out = CameraPoses(
        file=np.array([_base(name) for name in both], dtype=object),
        t_device_s=t,
        R_wcs_ccs=np.array([T_wcs_pcs.R @ pose.R for pose in found]),
        centre_wcs_m=T_wcs_pcs.apply([pose.shift_m for pose in found]),
        cov_pose_wcs=np.array([turn @ pose.cov @ turn.T for pose in found]),
    ).take(order)
    counts = {
        "images_with_pose_and_time": len(both),
        "poses_without_time": len(names) - len(both),
        "times_without_pose": len(times) - len({_base(name) for name in both}),
    }
    return out, FieldError(cov=T_wcs_pcs.cov, about_wcs_m=T_wcs_pcs.shift_m), counts


def run_attitude(states: pd.DataFrame, frame: LocalFrame, options: Mapping[str, Any]) -> InsAttitude | None:
    """Attitudes of table kind ``ins_state`` in wcs; None if the options do not want them.

    Raises
    ------
    CoverageError : fewer than two states have a time and an attitude.
    """
    if not options["use_attitude"]:
        return None
    columns = ["t_gps_s", "roll_rad", "pitch_rad", "heading_rad", "lat_deg", "lon_deg"]
    known = states.dropna(subset=columns).sort_values("t_gps_s", kind="stable").drop_duplicates("t_gps_s")
    if len(known) < 2:
        raise CoverageError(f"{len(known)} INS states with time and attitude", expected="at least 2")
    sigma = np.deg2rad(_ATTITUDE_DEG)
    for k, name in enumerate(("sigma_roll_rad", "sigma_pitch_rad", "sigma_heading_rad")):
        stated = float(known[name].median()) if name in known else np.nan
        sigma[k] = stated if stated > 0 else sigma[k]
    t, roll, pitch, heading, lat, lon = (known[name].to_numpy(np.float64) for name in columns)
    return InsAttitude(
        t_gps_s=t,
        R_wcs_ics=frame.R_wcs_enu(lat, lon) @ rotation_enu_body(roll, pitch, heading),
        sigma_rad=sigma,
        correlation_time_s=options["attitude_time_s"],
        high_pass_s=options["high_pass_s"],
    )


def offset_options(options: Mapping[str, Any]) -> OffsetOptions:
    """Options of the estimate from those of a campaign file, where the drift is in ppm."""
    return OffsetOptions(
        largest_offset_s=options["largest_offset_s"],
        largest_lever_m=options["largest_lever_m"],
        sigma_drift=options["sigma_drift_ppm"] * 1e-6,
        jitter_s=options["jitter_s"],
        largest_sigma_s=options["largest_sigma_s"],
    )


def synchronise_run(
    poses: CameraPoses,
    track: Track,
    *,
    ins: InsAttitude | None,
    field_error: FieldError | None,
    options: OffsetOptions,
) -> Synchronised:
    """All variants that the run allows.

    Raises
    ------
    ThalwegError : the best variant is refused; with its message.
    """
    plain = replace(track, white_share=1.0)
    exact = replace(options, jitter_s=0.0, sigma_drift=0.0, largest_sigma_s=np.inf)
    wanted: list[tuple[str, Track, InsAttitude | None, FieldError | None, OffsetOptions]] = [
        ("p2", plain, None, None, exact),
        ("positions", track, None, field_error, options),
    ]
    if ins is not None:
        wanted.append(("positions and attitude", track, ins, field_error, options))
    rows: list[dict[str, Any]] = []
    last: CameraOffset | None = None
    for name, positions, attitude, shared, o in wanted:
        try:
            found = camera_offset(poses, positions, ins=attitude, field_error=shared, options=o)
        except ThalwegError as error:
            if name == wanted[-1][0]:
                raise
            rows.append({"variant": name, "refused": str(error)})
            continue
        rows.append({"variant": name, "refused": "", **_numbers(found)})
        last = found
    assert last is not None
    return Synchronised(result=last, variant=str(rows[-1]["variant"]), variants=pd.DataFrame(rows))


def _numbers(found: CameraOffset) -> dict[str, Any]:
    sigma_lever = np.sqrt(np.diag(found.cov)[2:5])
    return {
        "offset_s": found.clock.offset_s,
        "sigma_offset_s": found.clock.sigma_offset_s,
        "run_offset_s": found.run_offset_s,
        "sigma_run_offset_s": found.sigma_run_offset_s,
        "drift_ppm": found.clock.drift * 1e6,
        "sigma_drift_ppm": found.clock.sigma_drift * 1e6,
        "jitter_s": found.clock.jitter_s,
        "sigma_jitter_s": found.clock.sigma_jitter_s,
        **{f"d{a}_m": float(v) for a, v in zip("xyz", found.lever_ccs_antenna_m, strict=True)},
        **{f"sigma_d{a}_m": float(v) for a, v in zip("xyz", sigma_lever, strict=True)},
        "sigma0_squared": found.sigma0_squared,
        "images_used": int(found.images["used"].sum()),
    }


def run_facts(done: Synchronised) -> dict[str, Any]:
    """What a report says about the result."""
    found = done.result
    return {
        "variant": done.variant,
        "definitions": {
            "offset_s": "of the clock: what another run of this camera will have",
            "run_offset_s": "mean over the images of this run, their jitter included",
        },
        **_numbers(found),
        "sigma0_squared_band": [found.sigma0_low, found.sigma0_high],
        "names": list(found.names),
        "cov": found.cov.tolist(),
        "R_ics_ccs": None if found.R_ics_ccs is None else found.R_ics_ccs.tolist(),
        "motion": {
            "speed_mps": found.motion.speed_mps,
            "speed_change_mps": found.motion.speed_change_mps,
            "turned_deg": found.motion.turned_deg,
            "turn_rate_degps": found.motion.turn_rate_degps,
        },
        **found.facts,
        "notes": list(found.clock.notes),
    }


def _base(name: str) -> str:
    return name.replace("\\", "/").rsplit("/", 1)[-1]


# ---------------------------------------------------------------- the two tracks of the antenna: by images,
# by positions


def image_fixes(found: CameraOffset, poses: CameraPoses, track: Track) -> pd.DataFrame:
    """Antenna by each image, and what the track has there at the image's time by the model of the clock.

    Jitter of single images is not taken out: it is what is seen along the motion.

    Parameters
    ----------
    found : result that says when the images were taken, and where the antenna is in the camera's frame.
    poses : poses of the same images in wcs.
    track : positions of the antenna in wcs.

    Returns
    -------
    pandas.DataFrame
        Table kind ``image_fixes``, a row an image; residuals are NaN where the track has a gap.

    Raises
    ------
    InputError : result and poses are of different images.
    """
    order = _rows(list(poses.file), list(found.images["file"]))
    t_gps_s = found.images["t_gps_s"].to_numpy(np.float64)
    antenna_m = poses.centre_wcs_m[order] + poses.R_wcs_ccs[order] @ found.lever_ccs_antenna_m
    between = track.at(t_gps_s)
    along, across, up = in_motion(between.position_m - antenna_m, between.velocity_mps)
    gap = ~between.inside
    return frame_of(
        IMAGE_FIXES,
        {
            "file": found.images["file"],
            "t_gps_s": t_gps_s,
            **dict(zip(("east_m", "north_m", "up_m"), antenna_m.T, strict=True)),
            "speed_mps": np.where(gap, np.nan, np.hypot(*between.velocity_mps[:, :2].T)),
            "residual_along_m": np.where(gap, np.nan, along),
            "residual_across_m": np.where(gap, np.nan, across),
            "residual_up_m": np.where(gap, np.nan, up),
            "used": found.images["used"],
        },
    )


def antenna_track(track: Track) -> pd.DataFrame:
    """Table kind ``antenna_track`` of a track."""
    east_m, north_m, up_m = track.position_m.T
    return frame_of(
        ANTENNA_TRACK, {"t_gps_s": track.t_gps_s, "east_m": east_m, "north_m": north_m, "up_m": up_m}
    )


def in_motion(vector_m: ArrayF, velocity_mps: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Parts (n,) of vectors (n, 3) along the horizontal motion, across it to the left, and up.

    Examples
    --------
    >>> parts = in_motion(np.array([[1.0, 2.0, 3.0]]), np.array([[0.0, 0.5, 0.1]]))
    >>> [float(part[0]) for part in parts]
    [2.0, -1.0, 3.0]
    """
    speed = np.hypot(velocity_mps[:, 0], velocity_mps[:, 1])
    moves = speed >= _LEAST_SPEED_MPS
    ahead = velocity_mps[:, :2] / np.where(moves, speed, np.nan)[:, None]
    along = np.einsum("ni,ni->n", vector_m[:, :2], ahead)
    across = vector_m[:, 1] * ahead[:, 0] - vector_m[:, 0] * ahead[:, 1]
    return along, across, vector_m[:, 2].copy()


def _rows(have: Sequence[str], wanted: Sequence[str]) -> list[int]:
    place = {name: k for k, name in enumerate(have)}
    missing = [name for name in wanted if name not in place]
    if missing:
        raise InputError(
            f"{len(missing)} images without a pose, first {missing[0]}", expected="poses of the same images"
        )
    return [place[name] for name in wanted]
