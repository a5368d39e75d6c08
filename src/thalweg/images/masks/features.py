"""What is measured at each pixel of a reduced image to tell water, sky and land: colour and texture.

All values are logarithms of ratios or relative to the image itself, so that exposure and white balance change
them little.
"""

from pathlib import Path
from typing import Final

import cv2
import numpy as np

from thalweg.core.errors import InputError
from thalweg.core.types import AnyArray, ArrayF32, ArrayU8

COARSE: Final = (
    "brightness", "blue", "red", "fine_texture", "texture", "lying", "mean_blue", "mean_red",
    "mean_brightness",
)  # fmt: skip
"""Features for the water line. `lying`: how much more a pattern changes downwards than sideways."""

FINE: Final = ("brightness", "blue", "red", "spread", "mean_blue", "mean_brightness", "mean_spread")
"""Features that tell sky from land. The first three are the pixel's own colour."""

_DARK: Final = 6.0
"""Added to grey values of 8 bits before the logarithm: noise of dark pixels would make colours of its own."""

_LEAST_GRADIENT: Final = 1e-4
_LEAST_STEP: Final = 1e-3
_MOST_STEP: Final = 3.0
_STEP_SHARE: Final = 0.02
_FINE_SHARE: Final = 0.012
_COARSE_SHARE: Final = 0.035
"""Sides of the windows, as shares of the image's height."""


def read_reduced(path: Path, longest_px: int) -> tuple[ArrayU8, tuple[int, int]]:
    """An image with its longest side reduced to ``longest_px``, and its true width and height.

    Pixels stay as they are stored: a rotation noted in EXIF is not applied.

    Parameters
    ----------
    path : JPEG, PNG or TIFF.
    longest_px : a smaller image is not enlarged.

    Returns
    -------
    image : (h, w, 3) blue, green, red.
    size_px : width and height of the file's image.

    Raises
    ------
    InputError : the file is missing or no picture.
    """
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        data = np.fromfile(path, dtype=np.uint8)
    except OSError as error:
        raise InputError(f"the image cannot be read ({error.strerror})", where=path) from error
    image = cv2.imdecode(data, flags) if data.size else None
    if image is None:
        raise InputError("no picture", expected="JPEG, PNG or TIFF", where=path, cure="Copy the file again")
    h, w = image.shape[:2]
    return scaled_to(image, longest_px), (w, h)


def scaled_to(image: ArrayU8, longest_px: int) -> ArrayU8:
    """An image (h, w[, 3]) with its longest side reduced to so many pixels; smaller ones stay."""
    h, w = image.shape[:2]
    scale = longest_px / max(h, w)
    if scale >= 1:
        return image
    size = max(round(w * scale), 8), max(round(h * scale), 8)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _logarithms(image: ArrayU8) -> tuple[ArrayF32, ArrayF32, ArrayF32]:
    """Brightness relative to the image's median, blue and red against green; each (h, w)."""
    light = np.log(np.arange(256, dtype=np.float32) + np.float32(_DARK))[image]
    bright = cv2.transform(light, np.full((1, 3), 1 / 3, dtype=np.float32))
    green = light[..., 1]
    return bright - np.median(bright[::3, ::3]), light[..., 0] - green, light[..., 2] - green


def _mean(values: AnyArray, size: tuple[int, int]) -> ArrayF32:
    return np.asarray(cv2.blur(values, size, borderType=cv2.BORDER_REFLECT_101))


def coarse_features(image: ArrayU8) -> ArrayF32:
    """Features (h, w, `COARSE`) of an image (h, w, 3)."""
    bright, blue, red = _logarithms(image)
    h = image.shape[0]
    fine, coarse = max(3, int(h * _FINE_SHARE) | 1), max(5, int(h * _COARSE_SHARE) | 1)
    across = (cv2.Sobel(bright, cv2.CV_32F, 1, 0, ksize=3) / 8) ** 2
    down = (cv2.Sobel(bright, cv2.CV_32F, 0, 1, ksize=3) / 8) ** 2
    # Water lies: windows are wide rather than high, so that they see little beyond its line.
    wide = (2 * coarse + 1, coarse)
    mean_across, mean_down = _mean(across, wide), _mean(down, wide)
    square = (coarse, coarse)
    return np.stack([
        bright, blue, red,
        np.log(_mean(across + down, (fine, fine)) + _LEAST_GRADIENT),
        np.log(mean_across + mean_down + _LEAST_GRADIENT),
        np.log((mean_down + _LEAST_GRADIENT) / (mean_across + _LEAST_GRADIENT)),
        _mean(blue, square), _mean(red, square), _mean(bright, square),
    ], axis=-1)  # fmt: skip


def fine_features(image: ArrayU8) -> ArrayF32:
    """Features (h, w, `FINE`) of an image (h, w, 3)."""
    bright, blue, red = _logarithms(image)
    wide = max(5, int(image.shape[0] * _FINE_SHARE) | 1)
    near = _mean(bright, (3, 3))
    spread = np.maximum(_mean(bright * bright, (3, 3)) - near * near, 0)
    return np.stack([
        bright, blue, red,
        np.log(spread + _LEAST_GRADIENT),
        _mean(blue, (wide, wide)), _mean(bright, (wide, wide)),
        np.log(_mean(spread, (wide, wide)) + _LEAST_GRADIENT),
    ], axis=-1)  # fmt: skip


def shore_edges(image: ArrayU8) -> ArrayF32:
    """How much a line above each row (h, w) looks like the edge of water, between -1 and 3 or so.

    What is reflected has less fine contrast than what stands above it, and the edge itself, a long level
    line, lies above the line and not below.
    """
    bright, _, _ = _logarithms(image)
    rows = max(2, round(_STEP_SHARE * image.shape[0]))
    across = cv2.blur((cv2.Sobel(bright, cv2.CV_32F, 1, 0, ksize=3)) ** 2, (15, 1))
    down = cv2.blur((cv2.Sobel(bright, cv2.CV_32F, 0, 1, ksize=3)) ** 2, (15, 1))
    across, down = np.log(across + _LEAST_STEP), np.log(down + _LEAST_STEP)
    texture = 0.5 * _step(across + down, rows)
    lying = _step(down - across, rows)
    return np.clip(texture + lying, -_MOST_STEP, _MOST_STEP)


def _step(values: ArrayF32, rows: int) -> ArrayF32:
    """Mean of the rows above a row minus that of the rows from it on."""
    h = values.shape[0]
    total = np.zeros((h + 1, values.shape[1]), dtype=np.float32)
    np.cumsum(values, axis=0, out=total[1:])
    y = np.arange(h)
    top, bottom = np.maximum(y - rows, 0), np.minimum(y + rows, h)
    above = (total[y] - total[top]) / np.maximum(y - top, 1)[:, None]
    below = (total[bottom] - total[y]) / (bottom - y)[:, None]
    out = above - below
    out[0] = 0.0
    return np.asarray(out, dtype=np.float32)
