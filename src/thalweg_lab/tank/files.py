"""Files of the light-sheet camera: images with stamps of its own clock, and the trigger's pulses."""

import datetime as dt
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import cv2
import numpy as np

from thalweg.core.errors import InputError
from thalweg.core.timescales import unix_from_gps
from thalweg.core.types import ArrayF, ArrayI, ArrayU8
from thalweg_lab.base.random import generator

ImageFormat = Literal["png", "tiff", "jpg"]

JPEG_QUALITY: Final = 92
PNG_LEVEL: Final = 1
"""Noise does not compress: higher levels cost time only."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trigger:
    """Images that pulses on whole parts of the GPS second release.

    ``t_gps_s`` (n,) true middle of the exposure; ``pulse_gps_s`` (m,) all recorded pulses; ``stamp_us`` (n,)
    reading of the camera's own clock at each image, microseconds since 1970.
    """

    t_gps_s: ArrayF
    pulse_gps_s: ArrayF
    stamp_us: ArrayI


def trigger(
    seed: int,
    t_s: ArrayF,
    start_gps_s: float,
    *,
    name: str,
    rate_hz: float = 10.0,
    clock_offset_s: float = 3.417,
    jitter_s: float = 0.002,
    lost: int = 0,
) -> Trigger:
    """Pulses and stamps of a series.

    The planned times are moved to the grid of a divider of the receiver's PPS. After a third of the images
    the series rests for two and a half intervals: with perfectly regular pulses nothing would tell which
    pulse belongs to which image if one is lost at an end.

    Parameters
    ----------
    seed : of the campaign; the streams are ``light sheet <name> clock`` and ``... lost pulses``.
    t_s : (n,) planned times after the start, growing.
    start_gps_s : adjusted standard GPS time of the start.
    name : of the series.
    rate_hz : of the divider.
    clock_offset_s : what the camera's clock is ahead of UTC.
    jitter_s : standard deviation of its stamps.
    lost : number of pulses that were not recorded, never at an end.
    """
    n = len(t_s)
    rest = np.ceil(2.5 * np.median(np.diff(t_s)) * rate_hz) / rate_hz if n > 1 else 0.0
    planned = np.asarray(t_s) + np.where(np.arange(n) >= (n + 2) // 3, rest, 0.0)
    at = np.ceil(start_gps_s) + np.rint(planned * rate_hz) / rate_hz
    noise = generator(seed, f"light sheet {name} clock").standard_normal(n)
    shown = unix_from_gps(at) + clock_offset_s + jitter_s * noise
    kept = np.ones(n, dtype=np.bool_)
    if lost and n > lost + 2:
        rng = generator(seed, f"light sheet {name} lost pulses")
        kept[1 + rng.choice(n - 2, lost, replace=False)] = False
    stamp = np.rint(shown * 1e3).astype(np.int64) * 1000
    return Trigger(t_gps_s=at, pulse_gps_s=at[kept], stamp_us=stamp)


def image_name(stamp_us: int, ending: ImageFormat) -> str:
    """Name of an image by the camera's clock.

    Examples
    --------
    >>> image_name(1620808267_042000, "png")
    'sheet_20210512_083107_042.png'
    """
    whole, micros = divmod(stamp_us, 1_000_000)
    moment = dt.datetime.fromtimestamp(whole, dt.UTC)
    return f"sheet_{moment:%Y%m%d_%H%M%S}_{micros // 1000:03d}.{ending}"


def write_image(path: Path, image: ArrayU8) -> None:
    """Write (h, w) raw or grey, or (h, w, 3) red, green, blue; the ending decides about the format.

    Raises
    ------
    InputError : another ending than png, tif, tiff, jpg, jpeg.
    """
    options = {
        ".png": [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL],
        ".tif": [], ".tiff": [],
        ".jpg": [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY], ".jpeg": [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY],
    }.get(path.suffix.lower())  # fmt: skip
    if options is None:
        raise InputError(f"an image called {path.name}", expected="the ending png, tif, tiff, jpg or jpeg")
    ordered = image if image.ndim == 2 else image[:, :, ::-1]
    done, data = cv2.imencode(path.suffix.lower(), np.ascontiguousarray(ordered), options)
    if not done:
        raise InputError("the image cannot be encoded", where=path, expected="uint8 pixels")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data.tobytes())


def write_pulses(path: Path, pulse_gps_s: ArrayF) -> None:
    """Table of the pulses, CSV with the column ``t_gps_s``, as `thalweg.clocks` reads it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("t_gps_s\n" + "".join(f"{t:.6f}\n" for t in pulse_gps_s))
