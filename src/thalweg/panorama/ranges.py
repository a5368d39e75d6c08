"""How far things are in each direction from a panorama, by the lidar cloud around it.

The cloud lies close in lines and has gaps between them. Each cell holds the range of its nearest point; gaps
up to a width take the nearest range at their border (lower envelope); what is left is infinitely far: the
sky, and the water, whose picture is mostly a mirrored one, as far behind the surface as the mirrored thing
lies before it. Taken at the range of the surface, mirrored clouds came out twice as far off at the seam.
"""

from typing import Final

import numpy as np
from scipy import ndimage

from thalweg.core import AnyArray, ArrayF
from thalweg.panorama.sphere import pixels_of

_NEAREST_M: Final = 0.4


def cloud_ranges(
    xyz_wcs_m: ArrayF, centre_wcs_m: ArrayF, R_wcs_pcs: ArrayF, *, cell_deg: float, reach_m: float
) -> AnyArray:
    """Least range (rows, columns) of points (n, 3) around a place, metres; infinite where there is none.

    Parameters
    ----------
    xyz_wcs_m : the cloud.
    centre_wcs_m, R_wcs_pcs : place (3,) and attitude (3, 3) of the panorama.
    cell_deg : width of a cell.
    reach_m : points farther away do not count.
    """
    columns = 2 * max(2, round(180.0 / cell_deg))
    local = (xyz_wcs_m - centre_wcs_m) @ R_wcs_pcs
    r = np.linalg.norm(local, axis=1)
    near = (r <= reach_m) & (r > _NEAREST_M)
    uv = pixels_of(local[near], columns)
    column = np.clip(uv[:, 0].astype(np.int64), 0, columns - 1)
    row = np.clip(uv[:, 1].astype(np.int64), 0, columns // 2 - 1)
    out = np.full((columns // 2, columns), np.inf)
    np.minimum.at(out, (row, column), r[near])
    return out


def fill_gaps(ranges_m: AnyArray, *, gap_deg: float) -> AnyArray:
    """Ranges (rows, columns) without the gaps of a cloud.

    Parameters
    ----------
    ranges_m : `cloud_ranges`.
    gap_deg : cells so near to a point take its range, the nearest of several (lower envelope).
    """
    cell = 180.0 / len(ranges_m)
    out = ranges_m.copy()
    reach = round(gap_deg / 2 / cell)
    if reach > 0 and np.isfinite(out).any():
        # around the panorama once, so that its left border knows the right one
        wide = np.concatenate([out[:, -reach:], out, out[:, :reach]], axis=1)
        known = np.isfinite(wide)
        distance, index = ndimage.distance_transform_edt(~known, return_indices=True)
        nearest = ndimage.minimum_filter(wide, size=3)[tuple(index)]
        filled = np.where(known | (distance > reach), wide, nearest)
        out = filled[:, reach:-reach]
    return out


def inverse_range(ranges_m: AnyArray, width_px: int) -> AnyArray:
    """Inverse ranges (W / 2, W) at all pixels of a panorama, 1/m: linear between the middles of cells."""
    rows, columns = ranges_m.shape
    with np.errstate(divide="ignore"):
        inverse = np.where(np.isfinite(ranges_m), 1.0 / ranges_m, 0.0)
    u = (np.arange(width_px) + 0.5) / width_px * columns - 0.5
    v = np.clip((np.arange(width_px // 2) + 0.5) / (width_px // 2) * rows - 0.5, 0, rows - 1)
    i, j = np.floor(v).astype(np.int64), np.floor(u).astype(np.int64)
    fv, fu = (v - i).astype(np.float32)[:, None], (u - j).astype(np.float32)
    inverse = inverse.astype(np.float32)
    tall = (1 - fv) * inverse[i] + fv * inverse[np.minimum(i + 1, rows - 1)]
    # around the panorama once: the last column is beside the first
    return (1 - fu) * tall[:, j % columns] + fu * tall[:, (j + 1) % columns]
