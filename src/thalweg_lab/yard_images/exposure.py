"""From light to the numbers of a picture: smear, lens blur, sensor noise, tone curve, 8 bits."""

from typing import Final

import cv2
import numpy as np

from thalweg.core.types import ArrayF, ArrayF32, ArrayU8
from thalweg.settings.twin.camera import TwinLens

WHITE: Final = 2.3
"""Light that becomes white, before the exposure: paper in the sun stays below it."""

_STEPS: Final = 4096


def exposed(
    light: ArrayF32,
    lens: TwinLens,
    rng: np.random.Generator,
    *,
    smear_px: tuple[float, float] = (0.0, 0.0),
    exposure: float = 1.0,
) -> ArrayU8:
    """A picture (h, w, 3) of 8 bits, sRGB.

    Parameters
    ----------
    light : (h, w, 3) linear light of each pixel, the mean over its area. Overwritten.
    lens : sharpness and noise.
    rng : of this picture.
    smear_px : way of the image over the sensor during the exposure, to the right and down.
    exposure : brightness, 1 for a sunny yard.

    Notes
    -----
    Blur and smear are even functions, so they move no crossing; the tone curve acts on each pixel and moves
    none either, because a crossing is the same after half a turn.
    """
    if lens.sharpness_px > 0:
        light = cv2.GaussianBlur(light, (0, 0), lens.sharpness_px, borderType=cv2.BORDER_REPLICATE)
    if np.hypot(*smear_px) > 0.05:
        light = cv2.filter2D(light, -1, _streak(smear_px), borderType=cv2.BORDER_REPLICATE)
    np.multiply(light, np.float32(_STEPS * exposure / WHITE), out=light)
    np.clip(light, 0, _STEPS - 1, out=light)
    encoded = _tone_table()[light.astype(np.uint16)]
    if lens.noise > 0:
        grain = rng.standard_normal(encoded.shape, dtype=np.float32)
        np.multiply(grain, np.float32(lens.noise), out=grain)
        encoded += grain
    np.rint(encoded, out=encoded)
    np.clip(encoded, 0, 255, out=encoded)
    return np.asarray(encoded, dtype=np.uint8)


def _tone_table() -> ArrayF32:
    """SRGB (0 to 255) of each step of light, with a soft shoulder above three quarters."""
    x = (np.arange(_STEPS) + 0.5) / _STEPS
    x = 1.25 * x / (1.0 + 0.25 * x**2)
    encoded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(x, 1 / 2.4) - 0.055)
    return np.asarray(255.0 * encoded, dtype=np.float32)


def _streak(smear_px: tuple[float, float]) -> ArrayF:
    """Kernel of a straight smear, the same after half a turn."""
    reach = int(np.ceil(max(abs(s) for s in smear_px) / 2)) + 1
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1))
    for share in (np.arange(64) + 0.5) / 64 - 0.5:
        x, y = reach + share * smear_px[0], reach + share * smear_px[1]
        i, j = int(np.floor(x)), int(np.floor(y))
        a, b = x - i, y - j
        kernel[j : j + 2, i : i + 2] += np.outer([1 - b, b], [1 - a, a])
    return kernel / kernel.sum()
