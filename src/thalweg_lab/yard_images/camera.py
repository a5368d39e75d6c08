"""A camera's image: the ray of each pixel, and from light to grey values."""

from functools import cached_property
from typing import Final

import numpy as np
from scipy.interpolate import make_interp_spline

from thalweg.core import ArrayF, ArrayF32, ArrayU8, Camera, optional
from thalweg_lab.settings import TwinLens

cv2 = optional("cv2")

_NODE_PX: Final = 8

WHITE: Final = 2.3
"""Light that becomes white, before the exposure: paper in the sun stays below it."""
_STEPS: Final = 4096


# ---------------------------------------------------------------- rays


class LensRays:
    """The ray of each pixel of a camera, computed once.

    ``rays_ccs`` (h, w, 3) are unit directions, NaN outside the image circle of a fisheye.
    """

    def __init__(self, camera: Camera, *, field_of_view_deg: float = 360.0) -> None:
        self.camera = camera
        w, h = camera.size_px
        rays = np.empty((h, w, 3), dtype=np.float32)
        if camera.model == "perspective":
            # Distortion is smooth: a spline through every eighth pixel is true to 1e-9.
            x, y = (np.linspace(0.0, n, max(n // _NODE_PX, 6) + 1) for n in (w, h))
            grid = camera.rays(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)).reshape(len(y), len(x), 3)
            plane = grid[..., :2] / grid[..., 2:]
            plane = make_interp_spline(x, plane, k=5, axis=1)(np.arange(w) + 0.5)
            spline = make_interp_spline(y, plane, k=5, axis=0)
            for row in range(0, h, 256):
                ab = spline(np.arange(row, min(row + 256, h)) + 0.5)
                length = np.sqrt(1.0 + np.sum(ab**2, axis=-1))
                rays[row : row + 256, :, :2] = ab / length[..., None]
                rays[row : row + 256, :, 2] = 1.0 / length
        else:
            least = np.cos(min(np.deg2rad(field_of_view_deg) / 2, np.pi))
            for row in range(0, h, 256):
                y, x = np.mgrid[row : min(row + 256, h), 0:w] + 0.5
                some = camera.rays(np.stack([x.ravel(), y.ravel()], axis=1))
                some[some[:, 2] < least] = np.nan
                rays[row : row + 256] = some.reshape(-1, w, 3)
        self.rays_ccs = rays

    @cached_property
    def size_rad(self) -> float:
        """Mean angle of a pixel near the middle."""
        h, w, _ = self.rays_ccs.shape
        a, b = self.rays_ccs[h // 2, w // 2], self.rays_ccs[h // 2, w // 2 - 1]
        return float(np.linalg.norm(a.astype(np.float64) - b))


# ---------------------------------------------------------------- smear, lens blur, sensor noise, tone curve,
# 8 bits


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
