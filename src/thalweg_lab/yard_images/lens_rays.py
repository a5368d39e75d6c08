"""The ray of each pixel of a camera."""

from functools import cached_property
from typing import Final

import numpy as np
from scipy.interpolate import make_interp_spline

from thalweg.core.camera.model import Camera

_NODE_PX: Final = 8


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
