"""The equirectangular projection: longitude to the right, latitude upwards, both even in pixels.

Frame of a panorama pcs: x right, y down, z to its middle, as of a camera. A pixel ``(u, v)``, counted from
the upper left corner of a picture of W x W/2, shows the direction of longitude ``(u / W - 1/2) 2 pi`` and
latitude ``(1/2 - 2 v / W) pi``::

    d = (cos(lat) sin(lon), -sin(lat), cos(lat) cos(lon))

as COLMAP's EQUIRECTANGULAR has it.
"""

from typing import Final

import numpy as np

from thalweg.core import ArrayF, Camera, GeometryError

_STEP: Final = 16


def sphere_rays(width_px: int) -> ArrayF:
    """Directions (W / 2, W, 3) in pcs of the centres of all pixels."""
    u, v = np.arange(width_px) + 0.5, np.arange(width_px // 2) + 0.5
    lon, lat = (u / width_px - 0.5) * 2 * np.pi, (0.5 - 2 * v / width_px) * np.pi
    rays = np.empty((len(v), len(u), 3))
    rays[..., 0] = np.cos(lat)[:, None] * np.sin(lon)
    rays[..., 1] = -np.sin(lat)[:, None]
    rays[..., 2] = np.cos(lat)[:, None] * np.cos(lon)
    return rays


def pixels_of(directions: ArrayF, width_px: int) -> ArrayF:
    """Pixels (n, 2) of directions (n, 3) in pcs of any length; NaN for a length of zero."""
    x, y, z = np.asarray(directions, dtype=np.float64).T
    length = np.sqrt(x * x + y * y + z * z)
    with np.errstate(divide="ignore", invalid="ignore"):
        lat = np.arcsin(np.clip(-y / length, -1.0, 1.0))
    u = (np.arctan2(x, z) / (2 * np.pi) + 0.5) * width_px
    return np.column_stack([u, (0.5 - lat / np.pi) * width_px / 2])


def default_width_px(camera: Camera) -> int:
    """Width of a panorama whose pixels are as wide as those of a lens at its axis; a multiple of 16."""
    return max(_STEP, round(2 * np.pi * float(np.mean(camera.parameters[:2])) / _STEP) * _STEP)


def level_attitude(R_wcs_front: ArrayF) -> ArrayF:
    """``R_wcs_pcs`` of a level panorama whose middle lies in the heading of the front lens.

    Raises
    ------
    GeometryError : the lens looks straight up or down, so that it has no heading.
    """
    view = R_wcs_front[:, 2].copy()
    view[2] = 0.0
    length = float(np.linalg.norm(view))
    if length < 1e-3:
        raise GeometryError("a front lens that looks straight up or down", expected="one with a heading")
    view /= length
    down = np.array([0.0, 0.0, -1.0])
    return np.stack([np.cross(down, view), down, view], axis=1)
