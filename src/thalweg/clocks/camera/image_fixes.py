"""Where images and positions have the antenna: the two tracks that a clock of a camera is judged by."""

from collections.abc import Sequence
from typing import Final

import numpy as np
import pandas as pd
import pyarrow as pa

from thalweg.clocks.camera.offset import CameraOffset
from thalweg.clocks.camera.offset_observations import CameraPoses
from thalweg.clocks.camera.track import Track
from thalweg.core.errors import InputError
from thalweg.core.tables import column, frame_of, table_kind
from thalweg.core.types import ArrayF

_F = pa.float64()
_LEAST_SPEED_MPS: Final = 0.02
"""Slower, and the direction of the motion is that of the noise."""

IMAGE_FIXES = table_kind(
    "image_fixes",
    1,
    [
        column("file", pa.string(), "1", "name of the image"),
        column("t_gps_s", _F, "s", "adjusted GPS time by the model of the clock"),
        column("east_m", _F, "m", "antenna by the pose of the image, wcs"),
        column("north_m", _F, "m", "antenna by the pose of the image, wcs"),
        column("up_m", _F, "m", "antenna by the pose of the image, wcs"),
        column("speed_mps", _F, "m/s", "horizontal speed of the track"),
        column(
            "residual_along_m", _F, "m", "track minus image along the horizontal motion; NaN if it stands"
        ),
        column("residual_across_m", _F, "m", "track minus image to the left of the motion; NaN if it stands"),
        column("residual_up_m", _F, "m", "track minus image, upward"),
        column("used", pa.bool_(), "1", "whether the image took part"),
    ],
)

ANTENNA_TRACK = table_kind(
    "antenna_track",
    1,
    [
        column("t_gps_s", _F, "s", "adjusted GPS time"),
        column("east_m", _F, "m", "antenna, wcs"),
        column("north_m", _F, "m", "antenna, wcs"),
        column("up_m", _F, "m", "antenna, wcs"),
    ],
)


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
