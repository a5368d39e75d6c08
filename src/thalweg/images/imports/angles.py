"""Angles of other programs as rotations: orders, directions, image axes and units.

In aerial photogrammetry, in Metashape, Pix4D and DBAT (``omega_phi_kappa``, ``image_to_world``,
``right_up_back``) the image axes are x to the right, y up, z backwards, against the view, and::

    R_world_image = R_x(omega) R_y(phi) R_z(kappa)
    R_world_ccs = R_world_image diag(1, -1, -1)

``phi_omega_kappa`` is ``R_y(phi) R_x(omega) R_z(kappa)``, ``kappa_phi_omega`` is
``R_z(kappa) R_y(phi) R_x(omega)``; with ``world_to_image`` the product is the transposed matrix.
"""

import math
from collections.abc import Iterator, Mapping
from itertools import product
from typing import Final

import numpy as np

from thalweg.core.types import ArrayF
from thalweg.images.imports.source import Angles

UNITS: Final[Mapping[str, float]] = {"deg": math.pi / 180, "gon": math.pi / 200, "rad": 1.0}
"""Radians of one unit."""

ORDERS: Final[Mapping[str, str]] = {
    "omega_phi_kappa": "xyz",
    "phi_omega_kappa": "yxz",
    "kappa_phi_omega": "zyx",
}
DIRECTIONS: Final = ("image_to_world", "world_to_image")
AXES: Final[Mapping[str, tuple[tuple[int, int, int], ...]]] = {
    "right_up_back": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "right_down_forward": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "up_left_back": ((0, -1, 0), (-1, 0, 0), (0, 0, -1)),
    "left_down_back": ((-1, 0, 0), (0, 1, 0), (0, 0, -1)),
    "down_right_back": ((0, 1, 0), (1, 0, 0), (0, 0, -1)),
}
"""Directions of the image axes x, y, z in ccs: the columns of ``R_ccs_image``."""

_PLACE: Final = {"x": 0, "y": 1, "z": 2}


def turns(axis: str, angle_rad: ArrayF) -> ArrayF:
    """Rotations (n, 3, 3) about one axis, as `thalweg.core.frames.rotation_x` and its sisters."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    k = _PLACE[axis]
    i, j = (k + 1) % 3, (k + 2) % 3
    R = np.zeros((len(angle_rad), 3, 3))
    R[:, k, k] = 1.0
    R[:, i, i] = R[:, j, j] = c
    R[:, i, j], R[:, j, i] = -s, s
    return R


def image_rotations(angles: Angles) -> ArrayF:
    """``R_place_image`` (n, 3, 3) of the angles, in the file's own image axes."""
    order = ORDERS[angles.rotation]
    rad = angles.values * UNITS[angles.unit]
    first, second, third = (turns(a, rad[:, _PLACE[a]]) for a in order)
    R = first @ second @ third
    return np.asarray(np.swapaxes(R, 1, 2) if angles.direction == "world_to_image" else R)


def ccs_rotations(angles: Angles) -> ArrayF:
    """``R_place_ccs`` (n, 3, 3) of the angles."""
    R_ccs_image = np.array(AXES[angles.axes], np.float64).T
    return np.asarray(image_rotations(angles) @ R_ccs_image.T)


def angle_covariance(angles: Angles, sigma: ArrayF) -> ArrayF:
    """Covariance (n, 3, 3) of the rotation vector in the file's frame, of sigmas (n, 3) of the angles."""
    order = ORDERS[angles.rotation]
    rad = angles.values * UNITS[angles.unit]
    before = np.tile(np.eye(3), (len(rad), 1, 1))
    axes = np.zeros((len(rad), 3, 3))
    for name in order:
        k = _PLACE[name]
        axes[:, :, k] = before[:, :, k]
        before = before @ turns(name, rad[:, k])
    if angles.direction == "world_to_image":
        # d(M^T) = -[M^T v]x M^T
        axes = -np.swapaxes(before, 1, 2) @ axes
    J = axes * (sigma * UNITS[angles.unit])[:, None, :]
    return np.asarray(J @ np.swapaxes(J, 1, 2))


def conventions(angles: Angles) -> Iterator[Angles]:
    """All usual readings of the same numbers, those first that differ least from the one at hand."""
    found = [
        Angles(values=angles.values, unit=unit, rotation=rotation, direction=direction, axes=axes)
        for unit, rotation, direction, axes in product(UNITS, ORDERS, DIRECTIONS, AXES)
    ]
    yield from sorted(found, key=lambda other: len(changes(angles, other)))


def changes(one: Angles, other: Angles) -> list[str]:
    """Settings by which two readings differ, as they stand in the campaign file."""
    names = {"unit": "angle_unit", "rotation": "rotation", "direction": "direction", "axes": "axes"}
    return [
        f"{setting}: {getattr(other, name)}"
        for name, setting in names.items()
        if getattr(one, name) != getattr(other, name)
    ]
