"""Marks measured anew as a perspective camera would see them, once a fisheye is roughly known.

The edges of a sheet are bent in a fisheye, and a fit of straight edges then puts a crossing towards the
inside of the bend: in the pictures of the digital twin by up to 0.07 px at 95 degrees and 50 px of a sheet,
which moved the base of a rig by 0.4 mm. Each crossing is therefore resampled onto the plane across its own
ray, where straight edges are straight, measured there, and taken back (after Datta, Kim and Kanade 2009,
Accurate camera calibration using iterative refinement of control points, ICCV workshops).
"""

from typing import Final

import cv2
import numpy as np
import pandas as pd

from thalweg.calibration.marker_sheets import SADDLES_MODULES
from thalweg.calibration.markers import SADDLE_SIGNS, fit_saddles
from thalweg.core import ArrayF, ArrayU8, Camera

_HALF_PX: Final = 28
"""Half a side of a patch: the largest window of a fit, and what the coarse search needs around it."""
_LARGEST_MOVE_PX: Final = 1.0
"""A crossing that moves farther was another one."""


def remeasured(image: ArrayU8, marks: pd.DataFrame, camera: Camera) -> pd.DataFrame:
    """The marks of one view, each measured on the plane across its ray.

    Parameters
    ----------
    image : (h, w) grey values of the view.
    marks : marker, corner, x_px, y_px, sigma_px, size_px of this view.
    camera : its interior orientation; some pixels of error do no harm.

    Returns
    -------
    The rows of markers with all four crossings that could be measured again, other columns as before.
    """
    whole = marks.groupby("marker")["corner"].transform("size") == len(SADDLES_MODULES)
    table = marks[whole].sort_values(["marker", "corner"], kind="stable").reset_index(drop=True)
    n = len(table)
    if n == 0:
        return table
    rays = camera.rays(table[["x_px", "y_px"]].to_numpy(np.float64))
    known = np.isfinite(rays).all(axis=1).reshape(-1, 4).all(axis=1).repeat(4)
    table, rays = table[known].reset_index(drop=True), rays[known]
    n = len(table)
    side = 2 * _HALF_PX
    columns = max(1, int(np.ceil(np.sqrt(n))))
    atlas = np.full((-(-n // columns) * side, columns * side), 128, dtype=np.uint8)
    grid = (np.mgrid[0:side, 0:side][::-1].reshape(2, -1).T + 0.5 - _HALF_PX).astype(np.float64)
    corner = np.empty((n, 2))
    steps, start = np.empty((n, 2, 2)), np.empty((n, 2))
    axes, scale = np.empty((n, 3, 3)), np.empty(n)
    good = np.ones(n, dtype=np.bool_)
    for i in range(n):
        e = _across(rays[i])
        by_point = camera.project_with_derivatives(rays[i][None])[1][0]
        s = float(np.sqrt(abs(np.linalg.det(by_point @ e[:, :2]))))
        first = i - i % 4
        local = rays[first : first + 4] @ e
        corner[i] = (i % columns) * side, (i // columns) * side
        axes[i], scale[i] = e, s
        start[i] = corner[i] + _HALF_PX
        steps[i] = np.eye(2)
        if (local[:, 2] < 0.2).any() or not s > 0:
            good[i] = False
            continue
        flat = local[:, :2] / local[:, 2:]
        H = cv2.getPerspectiveTransform(SADDLES_MODULES.astype(np.float32), flat.astype(np.float32))
        h = H @ np.append(SADDLES_MODULES[i % 4], 1.0)
        steps[i] = s * (H[:2, :2] - np.outer(h[:2] / h[2], H[2, :2])) / h[2]
        xy = camera.project(np.column_stack([grid / s, np.ones(len(grid))]) @ e.T)
        flat_xy = np.nan_to_num(xy, nan=-10.0).astype(np.float32).reshape(side, side, 2) - np.float32(0.5)
        patch = cv2.remap(
            image, flat_xy[..., 0], flat_xy[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
        )
        x, y = corner[i].astype(int)
        atlas[y : y + side, x : x + side] = patch
    fit = fit_saddles(atlas, start, steps, np.tile(SADDLE_SIGNS, n // 4))
    good &= fit.good
    off = np.where(good[:, None], fit.xy_px - start, 0.0)
    moved = np.column_stack([off / scale[:, None], np.ones(n)])
    xy = camera.project(np.einsum("nij,nj->ni", axes, moved))
    before = table[["x_px", "y_px"]].to_numpy(np.float64)
    good &= np.linalg.norm(xy - before, axis=1) < _LARGEST_MOVE_PX
    out = table.assign(x_px=xy[:, 0], y_px=xy[:, 1], sigma_px=fit.sigma_px)
    return out[good].reset_index(drop=True)


def _across(ray: ArrayF) -> ArrayF:
    """Axes (3, 3) as columns: two across a ray, and the ray."""
    other = np.array([1.0, 0.0, 0.0]) if abs(ray[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    e2 = np.cross(ray, other)
    e2 /= np.linalg.norm(e2)
    return np.stack([np.cross(e2, ray), e2, ray], axis=1)
