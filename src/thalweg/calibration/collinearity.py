"""Collinearity: pixels of points in pictures with a pose and a lens, and all their derivatives (P1 eq. 1-3).

``x_ccs = R^T (X - C)``, and the lens of `thalweg.core.camera`. Poses err by a shift of the projection centre
and a small rotation vector, both in the frame of the points: ``R^T d`` becomes
``R^T (d - dC + d x dtheta + dX)`` with ``d = X - C``.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from thalweg.core import ArrayF, ArrayI, Camera, cross_matrix


class Collinear(NamedTuple):
    """Pixels (m, 2), and derivatives by pose (m, 2, 6), point (m, 2, 3) and lens (m, 2, k); NaN without.

    Behind the parameters of a lens that has fewer than another one stand zeros.
    """

    xy_px: ArrayF
    by_pose: ArrayF
    by_point: ArrayF
    by_camera: ArrayF


def collinear(
    cameras: Sequence[Camera], camera: ArrayI, R: ArrayF, C: ArrayF, X: ArrayF, arm: ArrayF | None = None
) -> Collinear:
    """Images of points.

    Parameters
    ----------
    cameras, camera : lenses, and which one (m,) took each image point.
    R, C : (m, 3, 3) rotations from ccs into the frame of the points, (m, 3) projection centres.
    X : (m, 3) points.
    arm : (m, 3) from the place about which a pose turns to the points, of lenses in a rig; None: from ``C``.
    """
    m, k = len(X), max(len(lens.parameters) for lens in cameras)
    away = X - C
    Rt = np.swapaxes(R, 1, 2)
    ccs = np.einsum("mij,mj->mi", Rt, away)
    xy, by_ccs, by_camera = np.empty((m, 2)), np.empty((m, 2, 3)), np.zeros((m, 2, k))
    for number, lens in enumerate(cameras):
        rows = np.flatnonzero(camera == number)
        xy[rows], by_ccs[rows], by_camera[rows, :, : len(lens.parameters)] = lens.project_with_derivatives(
            ccs[rows]
        )
    by_point = by_ccs @ Rt
    by_pose = np.concatenate([-by_point, by_point @ cross_matrix(away if arm is None else arm)], axis=2)
    return Collinear(xy, by_pose, by_point, by_camera)
