"""Where a scanner that stands still has anything to look at: rays into the sky or onto water are spared."""

from typing import Final

import numba as nb
import numpy as np

from thalweg.core.types import ArrayB, ArrayF
from thalweg_lab.river.materials import Material
from thalweg_lab.river.scene import Scene

_STEP_RAD: Final = (np.pi / 180, np.pi / 360)
"""Size of a cell, azimuth and elevation; a full turn is a whole number of columns."""

_WIDEST: Final = 0.03
"""Triangles whose radius is a larger share of their distance are cut into four."""

_DEPTH: Final = 12
"""So often at most: a triangle of 40 m then has pieces of 1 cm."""

_MARGIN_RAD: Final = 1e-3
"""Added to the angular radius of each triangle: half a beam's divergence, rounding of the ray caster."""


def outlook(scene: Scene, centre_wcs_m: ArrayF, azimuth_rad: ArrayF, elevation_rad: ArrayF) -> ArrayB:
    """Which rays of a regular grid of directions may meet something other than water.

    Parameters
    ----------
    scene : the river reach.
    centre_wcs_m : (3,) the scanner.
    azimuth_rad : (a,) from east, counter-clockwise, rising in even steps over less than one turn.
    elevation_rad : (e,) rising in even steps.

    Returns
    -------
    wanted : (a, e). False means that the ray meets water or nothing. Each triangle that is not of water and
        not wholly below it stands for the cone about its bounding sphere; a ray is wanted if its cell of the
        grid of 1 degree by half a degree meets one of the cones.
    """
    column = np.floor((azimuth_rad - azimuth_rad[0]) / _STEP_RAD[0]).astype(np.int64)
    row = np.floor((elevation_rad - elevation_rad[0]) / _STEP_RAD[1]).astype(np.int64)
    cells = np.zeros((column[-1] + 1, row[-1] + 1), dtype=np.bool_)
    _mark(
        scene.vertices_wcs_m,
        scene.triangles,
        scene.material == Material.WATER,
        scene.water_level_m - 0.01,
        np.asarray(centre_wcs_m, dtype=np.float64),
        (float(azimuth_rad[0]), float(elevation_rad[0])),
        _STEP_RAD,
        _MARGIN_RAD,
        cells,
    )
    return np.asarray(cells[column[:, None], row[None, :]])


@nb.njit(cache=True, error_model="numpy")
def _mark(  # type: ignore[no-untyped-def]
    vertices, triangles, water, level, centre, begin, step, margin, cells
):
    stack = np.empty((4 * _DEPTH + 4, 3, 3))
    depth = np.empty(4 * _DEPTH + 4, dtype=np.int64)
    for i in range(len(triangles)):
        if water[i]:
            continue
        for k in range(3):
            stack[0, k] = vertices[triangles[i, k]]
        if max(stack[0, 0, 2], stack[0, 1, 2], stack[0, 2, 2]) < level:
            continue
        for k in range(3):
            stack[0, k] -= centre
        depth[0], height = 0, 1
        while height > 0:
            height -= 1
            if _mark_piece(stack[height], begin, step, margin, depth[height] >= _DEPTH, cells):
                continue
            # Too wide for a cone: its four quarters instead.
            corners, below = stack[height].copy(), depth[height] + 1
            middle = (corners + np.stack((corners[1], corners[2], corners[0]))) / 2.0
            for k in range(3):
                stack[height, 0], stack[height, 1], stack[height, 2] = corners[k], middle[k], middle[k - 1]
                depth[height] = below
                height += 1
            stack[height], depth[height] = middle, below
            height += 1


@nb.njit(cache=True, error_model="numpy")
def _mark_piece(corners, begin, step, margin, last, cells):  # type: ignore[no-untyped-def]
    """Mark the cells that the cone about a triangle meets; false if it is too wide and not the last piece."""
    columns, rows = cells.shape
    whole = int(np.rint(2.0 * np.pi / step[0]))
    x = (corners[0, 0] + corners[1, 0] + corners[2, 0]) / 3.0
    y = (corners[0, 1] + corners[1, 1] + corners[2, 1]) / 3.0
    z = (corners[0, 2] + corners[1, 2] + corners[2, 2]) / 3.0
    radius = 0.0
    for k in range(3):
        away = (corners[k, 0] - x) ** 2 + (corners[k, 1] - y) ** 2 + (corners[k, 2] - z) ** 2
        radius = max(radius, np.sqrt(away))
    flat = np.sqrt(x * x + y * y)
    distance = np.sqrt(flat * flat + z * z)
    if radius > _WIDEST * distance and not last:
        return False
    if distance <= radius * 1.001:
        cells[:] = True
        return True
    angle = np.arcsin(radius / distance) + margin
    elevation = np.arctan2(z, flat)
    first_row = max(int(np.floor((elevation - angle - begin[1]) / step[1])), 0)
    last_row = min(int(np.floor((elevation + angle - begin[1]) / step[1])), rows - 1)
    if first_row > last_row:
        return True
    # A cone about the zenith or the nadir is seen in all azimuths.
    side = np.sin(angle) / np.cos(elevation)
    if abs(elevation) + angle >= 0.5 * np.pi or side >= 1.0:
        cells[:, first_row : last_row + 1] = True
        return True
    width = np.arcsin(side)
    start = np.arctan2(y, x) - width - begin[0]
    for column in range(int(np.floor(start / step[0])), int(np.floor((start + 2.0 * width) / step[0])) + 1):
        # Columns count whole degrees, so the full turn has no seam.
        place = column % whole
        if place < columns:
            cells[place, first_row : last_row + 1] = True
    return True
