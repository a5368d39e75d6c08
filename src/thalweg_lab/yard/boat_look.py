"""The boat on its trolley as a camera sees it, with the antenna's disc that carries its marker."""

from typing import Final

import numpy as np

from thalweg.core.types import ArrayF, ArrayI
from thalweg_lab.river.hull import LENGTH_M, WIDTH_M, hull_mesh
from thalweg_lab.river.mesh import BOX_FACES, boxes, tube_faces, tubes

_ABOVE_DECK_M: Final = 0.12
"""Floats, deck and battery box reach this high above the deck; mast and bracket of the hull are left out."""
_FREEBOARD_M: Final = 0.12
_DISC_M: Final = (0.140, 0.030)
"""Radius and thickness of the antenna's disc."""
_WHEEL_M: Final = 0.11
_MAST_M: Final = 0.014


def boat_mesh(
    lever_ics_antenna_m: ArrayF, *, disc_below_m: float, waterline_m: float
) -> tuple[ArrayF, ArrayI]:
    """Hull and antenna's disc in the body frame.

    Parameters
    ----------
    lever_ics_antenna_m : (3,) phase centre.
    disc_below_m : top of the antenna's disc below it.
    waterline_m : z of the water line of the hull.

    Returns
    -------
    vertices_ics_m : (n, 3).
    triangles : (m, 3).
    """
    hull, faces = hull_mesh(height_m=waterline_m)
    deck = waterline_m - _FREEBOARD_M
    low = hull[faces][:, :, 2].min(axis=1) >= deck - _ABOVE_DECK_M
    top = np.asarray(lever_ics_antenna_m) + np.array([0.0, 0.0, disc_below_m])
    bottom = top + np.array([0.0, 0.0, _DISC_M[1]])
    return _joined([(hull, faces[low]), _tube(bottom, top, _DISC_M[0], 48)])


def sensor_mesh(
    lever_ics_antenna_m: ArrayF,
    lever_ics_lidar_m: ArrayF,
    lever_ics_camera_m: ArrayF | None,
    *,
    waterline_m: float,
) -> tuple[ArrayF, ArrayI]:
    """Masts, scanner and camera in the body frame; None where it is the camera that looks."""
    deck = waterline_m - _FREEBOARD_M
    antenna, lidar = np.asarray(lever_ics_antenna_m), np.asarray(lever_ics_lidar_m)
    parts = [_mast(antenna + np.array([0.0, 0.0, 2 * _DISC_M[1]]), deck)]
    # The scanner's drum lies along x, the camera is a box behind its projection centre.
    half = np.array([0.036, 0.0, 0.0])
    parts += [_tube(lidar - half, lidar + half, 0.052, 32), _mast(lidar, deck)]
    if lever_ics_camera_m is not None:
        behind = np.asarray(lever_ics_camera_m) + np.array([0.0, 0.045, 0.0])
        parts += [_box(behind, (0.11, 0.06, 0.07)), _mast(behind, deck)]
    return _joined(parts)


def trolley_mesh(*, waterline_m: float, ground_m: float) -> tuple[ArrayF, ArrayI]:
    """The trolley under the boat in the body frame: two beams, two axles, four wheels on the ground."""
    beam_z, wheel_z = waterline_m + 0.13, ground_m - _WHEEL_M
    side = WIDTH_M / 2 - 0.08
    parts = [_box(np.array([0.0, y, beam_z]), (0.95 * LENGTH_M, 0.04, 0.05)) for y in (-side, side)]
    height = abs(wheel_z - beam_z)
    for x in (-0.36, 0.36):
        parts.append(_tube(np.array([x, -side - 0.1, wheel_z]), np.array([x, side + 0.1, wheel_z]), 0.014, 8))
        parts += [_box(np.array([x, y, (beam_z + wheel_z) / 2]), (0.04, 0.04, height)) for y in (-side, side)]
        for y in (-side - 0.08, side + 0.08):
            hub = np.array([x, y, wheel_z])
            half = np.array([0.0, 0.02, 0.0])
            parts.append(_tube(hub - half, hub + half, _WHEEL_M, 24))
    return _joined(parts)


def _mast(top: ArrayF, deck_m: float) -> tuple[ArrayF, ArrayI]:
    return _tube(np.array([top[0], top[1], deck_m]), top, _MAST_M, 12)


def _box(middle: ArrayF, size: tuple[float, float, float]) -> tuple[ArrayF, ArrayI]:
    foot = np.asarray(middle) - np.array([0.0, 0.0, size[2] / 2])
    return boxes(foot[None], np.array([size]), np.zeros(1))[0], BOX_FACES.astype(np.int64)


def _tube(begin: ArrayF, end: ArrayF, radius_m: float, sides: int) -> tuple[ArrayF, ArrayI]:
    """A cylinder, closed at both ends."""
    points = tubes(np.stack([begin, end])[None], np.full((1, 2), radius_m), sides)[0]
    faces = tube_faces(sides, 2)
    i = np.arange(sides)
    lid = np.stack([np.full(sides, len(points)), (i + 1) % sides, i], axis=1)
    return np.concatenate([points, np.asarray(begin)[None]]), np.concatenate([faces, lid]).astype(np.int64)


def _joined(parts: list[tuple[ArrayF, ArrayI]]) -> tuple[ArrayF, ArrayI]:
    counts = np.cumsum([0] + [len(v) for v, _ in parts])
    return (
        np.concatenate([v for v, _ in parts]),
        np.concatenate([t + first for (_, t), first in zip(parts, counts[:-1], strict=True)]),
    )
