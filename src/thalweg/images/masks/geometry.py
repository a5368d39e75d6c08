"""Where the horizon is in an image: from an approximate attitude, or a guess without one."""

from typing import Final

import cv2
import numpy as np

from thalweg.core.camera.model import Camera
from thalweg.core.types import ArrayF, ArrayF32

_GRID: Final = 25
"""Nodes along each side for which rays are computed; between them the angle is linear to 0.05 degrees."""


def depression(camera: Camera, R_wcs_ccs: ArrayF, size_px: tuple[int, int]) -> ArrayF32:
    """Angle below the horizon (h, w) in degrees at the pixels of an image reduced to ``size_px``.

    Parameters
    ----------
    camera : of the full image.
    R_wcs_ccs : (3, 3) attitude of the camera; z of wcs is up.
    size_px : width and height.

    Notes
    -----
    Places without a ray (outside the circle of a fisheye) count as on the horizon: they tell nothing.
    """
    w, h = camera.size_px
    x, y = np.meshgrid((np.arange(_GRID) + 0.5) / _GRID * w, (np.arange(_GRID) + 0.5) / _GRID * h)
    rays = camera.rays(np.stack([x.ravel(), y.ravel()], axis=1))
    up = np.clip(rays @ R_wcs_ccs[2], -1.0, 1.0)
    angle = np.nan_to_num(-np.rad2deg(np.arcsin(up))).reshape(_GRID, _GRID).astype(np.float32)
    return _stretched(angle, size_px)


def _stretched(grid: ArrayF32, size_px: tuple[int, int]) -> ArrayF32:
    """Values at the middles of cells, linear between them and beyond the outermost middles."""
    padded = np.pad(grid, 1, mode="reflect", reflect_type="odd")
    w, h = size_px
    n = np.float32(len(grid))
    x = (np.arange(w, dtype=np.float32) + np.float32(0.5)) / w * n + np.float32(0.5)
    y = (np.arange(h, dtype=np.float32) + np.float32(0.5)) / h * n + np.float32(0.5)
    return np.asarray(cv2.remap(padded, *np.meshgrid(x, y), cv2.INTER_LINEAR))


def nominal_depression(size_px: tuple[int, int]) -> ArrayF32:
    """The same for a level camera of a usual lens (53 degrees along the longest side) without a pose."""
    w, h = size_px
    rows = (np.arange(h, dtype=np.float32) + 0.5 - h / 2) / max(w, h)
    return np.broadcast_to(np.rad2deg(np.arctan(rows))[:, None], (h, w)).astype(np.float32)
