"""The sensor on the boat: mount by the combined field, times of its images, bed points in the world (T 3.2).

    x_wcs = R_wcs_ics(t) (R_ics_lcs x_lcs + lever) + x_wcs_ics(t)

The camera is released by pulses of the GNSS receiver, so an image has the time of its pulse
(`thalweg.clocks.ties`); the camera's own clock only tells which pulse. The mount comes from a field that
boat and sensor see together: the grid object of P3 lies in the field of P2, whose marks give the pose of the
boat, and the sensor's calibration that of the grid object::

    T_ics_lcs = (T_pcs_ics)^-1 T_pcs_grid T_grid_lcs
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa

from thalweg.clocks import triggered_images
from thalweg.core import (
    AnyArray,
    ArrayF,
    ClockError,
    ExtraDimension,
    Rigid,
    Trajectory,
    column,
    frame_of,
    table_kind,
)
from thalweg.core.calibration import Calibration
from thalweg.lidar import CORRELATION_DIMENSIONS, CORRELATIONS, SIGMAS
from thalweg.lightsheet.poses import trajectory_poses
from thalweg.lightsheet.scanning.profile import Profile, ScanCloud, merge

MOUNT: Final = "light_sheet"
"""Name of the block of the sensor's mount in a calibration file."""

LAZ_SCALE_M: Final = 0.0001
"""Bed points have sigmas of centimetres from the boat, but differ by tenths of a millimetre in a line."""

EXTRA_DIMENSIONS: Final[dict[str, ExtraDimension]] = {
    "range": ("f4", "distance from the sensor, m"),
    "line": ("i2", "laser line, -1 unknown"),
    "image": ("u4", "number of the image"),
    **dict.fromkeys(SIGMAS, ("u4", "standard deviation, m", 0.00001)),
    **CORRELATION_DIMENSIONS,
}
"""Extra bytes of a bed cloud."""

_COVS: Final = ("ee", "en", "eu", "nn", "nu", "uu")

BED_POINTS: Final = table_kind(
    "bed_points",
    1,
    [
        column("file", "1", "name of the image", pa.string()),
        column("t_gps_s", "s", "adjusted standard GPS time of the image"),
        *(column(f"{a}_m", "m", f"{a} in wcs") for a in ("east", "north", "up")),
        *(column(f"cov_{ab}_m2", "m^2", f"covariance of the axes {ab} of wcs, all errors") for ab in _COVS),
        column("sigma_line_m", "m", "of the height within its line: by the image measurement alone"),
        column("line", "1", "number of the laser line, -1 if unknown", pa.int32()),
        column("x_px", "px", "column of the line's point in the image"),
        column("y_px", "px", "row of the line's point in the image"),
        column("peak_dn", "1", "height of the line above its background"),
        column("flags", "1", "as in the line points", pa.uint8()),
    ],
)
"""Points of the bed in the world."""


def mount_of(calibration: Calibration) -> Rigid:
    """Mount of the sensor from a calibration file.

    Raises
    ------
    GeometryError : it has none.
    """
    return calibration.pose(MOUNT)


def image_times(
    stamps: pd.DataFrame, t_pulse_s: ArrayF, images: Sequence[str]
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Times of images by the pulses of the trigger, in the order of ``images``.

    Parameters
    ----------
    stamps : table kind ``image_stamps`` of the sensor's camera.
    t_pulse_s : (m,) adjusted GPS times of the pulses, growing.
    images : names of the images, in the order in which they were taken.

    Returns
    -------
    Table kind ``run_image_times`` for these images, and facts: images without pulse (their time is that of
    the camera's own clock, with its sigma), pulses without image.

    Raises
    ------
    ClockError : images and pulses do not match, an image has no stamp, or the images are out of order.
    """
    _, times, facts = triggered_images(stamps, t_pulse_s, delay_s=0.0)
    index = {str(name): k for k, name in enumerate(times["file"])}
    missing = [name for name in images if name not in index]
    if missing:
        raise ClockError(
            f"{len(missing)} of {len(images)} images have no stamp, such as {missing[0]}",
            expected="a stamp for each image",
            where="times of the light sheet's images",
        )
    chosen = times.iloc[[index[name] for name in images]].reset_index(drop=True)
    check_order(images, chosen["t_gps_s"].to_numpy(np.float64))
    return chosen, facts


def check_order(images: Sequence[str], t_gps_s: ArrayF) -> None:
    """Refuse images whose times do not grow.

    Raises
    ------
    ClockError : an image is not later than the one before; names both.
    """
    known = np.flatnonzero(np.isfinite(t_gps_s))
    step = np.diff(t_gps_s[known])
    if (step <= 0).any():
        k = int(np.argmax(step <= 0))
        first, second = known[k], known[k + 1]
        raise ClockError(
            f"{int((step <= 0).sum())} images are out of order: {images[second]} comes after "
            f"{images[first]} but is {abs(step[k]):.3f} s older",
            expected="images in the order in which they were taken",
            where="times of the light sheet's images",
            cure="Sort the images by their stamps; look for renamed or repeated files",
        )


def world_cloud(
    profiles: Sequence[Profile], trajectory: Trajectory, T_ics_lcs: Rigid, times: pd.DataFrame
) -> ScanCloud:
    """Points of the bed in the world with their covariance.

    Parameters
    ----------
    profiles : of the images.
    trajectory : of the boat.
    T_ics_lcs : mount of the sensor, metres, with covariance.
    times : table kind ``run_image_times`` with at least the images of the profiles.

    Raises
    ------
    InputError, CoverageError : see `merge`, `trajectory_poses`.
    """
    poses = trajectory_poses(
        trajectory,
        T_ics_lcs,
        [str(name) for name in times["file"]],
        times["t_gps_s"].to_numpy(np.float64),
        sigma_time_s=np.nan_to_num(times["sigma_s"].to_numpy(np.float64)),
    )
    return merge(profiles, poses)


def bed_points(cloud: ScanCloud) -> pd.DataFrame:
    """Table of kind `BED_POINTS`."""
    C = cloud.cov_m2
    pairs = dict(zip(_COVS, ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)), strict=True))
    names = np.array(cloud.poses.images, dtype=object)
    return frame_of(
        BED_POINTS,
        {
            "file": names[cloud.number],
            "t_gps_s": cloud.t_gps_s,
            **{f"{a}_m": cloud.xyz_m[:, i] for i, a in enumerate(("east", "north", "up"))},
            **{f"cov_{ab}_m2": C[:, i, j] for ab, (i, j) in pairs.items()},
            "sigma_line_m": np.abs(cloud.own_m[:, 2]),
            "line": cloud.line,
            "x_px": cloud.xy_px[:, 0],
            "y_px": cloud.xy_px[:, 1],
            "peak_dn": cloud.peak_dn,
            "flags": cloud.flags,
        },
    )


def laz_columns(cloud: ScanCloud) -> dict[str, AnyArray | dict[str, AnyArray]]:
    """Arguments of `thalweg.core.las.LazWriter.append` for a cloud, with `EXTRA_DIMENSIONS`."""
    C = cloud.cov_m2
    sigma = np.sqrt(np.diagonal(C, axis1=1, axis2=2))
    extra: dict[str, AnyArray] = {
        "range": np.linalg.norm(cloud.xyz_m - cloud.poses.shift_m[cloud.number], axis=1).astype(np.float32),
        "line": cloud.line.astype(np.int16),
        "image": cloud.number.astype(np.uint32),
        **{name: sigma[:, i] for i, name in enumerate(SIGMAS)},
        **{
            name: C[:, i, j] / (sigma[:, i] * sigma[:, j])
            for name, i, j in zip(CORRELATIONS, (0, 0, 1), (1, 2, 2), strict=True)
        },
    }
    out: dict[str, AnyArray | dict[str, AnyArray]] = {
        "xyz_m": cloud.xyz_m,
        "intensity": np.clip(cloud.peak_dn, 0, 255).astype(np.uint8),
        "extra": extra,
    }
    if np.isfinite(cloud.t_gps_s).all():
        out["t_gps_s"] = cloud.t_gps_s
    return out
