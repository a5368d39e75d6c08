"""A second start of an adjustment that may have settled in a wrong shape.

A bank is nearly a plane, and a block of it from structure from motion alone may be bent and tilted with small
residuals: another minimum of the square sum, from which no iteration finds out, and from which a few control
points do not pull the tie points. Where the result contradicts the predicted poses or the control points, the
block is put together once more from the predicted poses, whose shape is that of the trajectory, and the
likelier of both results is taken.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from thalweg.core.errors import GeometryError
from thalweg.core.rigid import rotation_vector
from thalweg.core.types import ArrayF, ArrayI
from thalweg.images.bundle.adjustment import Adjusted, adjust_block
from thalweg.images.bundle.correlation import Correlation, views
from thalweg.images.bundle.kernels import restricted_parts
from thalweg.images.bundle.linear import along_and_across, linearised, tracks_of
from thalweg.images.bundle.problem import Problem
from thalweg.images.bundle.result import ControlResult, control_result
from thalweg.images.bundle.weights import Options
from thalweg.images.model.block import ImageBlock
from thalweg.images.model.poses import ImagePoses

_LEAST_IMAGES: Final = 3
_SIGMAS: Final = 3.0
"""Median difference from the predicted poses, in units of their sigmas, beyond which a result is doubted."""
_FLAT: Final = 1e-9
"""Added to the normal equations of a point, so that parallel rays give some point and no fault."""
_MOST: Final = 25.0
"""Square of a normalised residual of a control mark beyond which it is a blunder under either result."""


def adjust_from_either_start(
    problem: Problem,
    options: Options,
    predictions: ImagePoses | None,
    progress: Callable[[str], None] | None = None,
) -> tuple[Problem, Adjusted, ControlResult, list[str]]:
    """Adjust a block, and once more from the predicted poses where the result contradicts them.

    Returns
    -------
    problem : with the block that the better result began from.
    adjusted, result : the better result.
    notes : what happened, for people.
    """
    first = adjust_block(problem, options, progress=progress)
    result = control_result(first)
    if not (bool(result.suspect.any()) or _doubted(first, predictions)):
        return problem, first, result, []
    block = predicted_block(problem.block, predictions)
    if block is None:
        return problem, first, result, []
    again = replace(problem, block=block)
    try:
        second = adjust_block(again, options, progress=progress)
    except GeometryError:
        return problem, first, result, []
    gain = misfit(first, first, second) - misfit(second, first, second)
    if not gain > 0:
        return problem, first, result, []
    shift = np.linalg.norm(first.x.C + first.origin_m - second.x.C - second.origin_m, axis=1)
    turn = np.degrees(_angles(first.x.R, second.x.R))
    note = (
        "Structure from motion had put the block together in a wrong shape, off by a median of "
        f"{np.median(shift):.2f} m and {np.median(turn):.1f} degrees; adjusted again from the predicted "
        "poses, which fits the marks better"
    )
    # a median of millimetres is the same result
    told = [note] if np.median(shift) > 5.0 * np.sqrt(np.median(_variances(second))) else []
    return again, second, control_result(second), told


def _angles(one: ArrayF, two: ArrayF) -> ArrayF:
    return np.asarray(np.linalg.norm(rotation_vector(np.swapaxes(one, 1, 2) @ two), axis=-1))


def _variances(adjusted: Adjusted) -> ArrayF:
    """(i,) mean variances of the projection centres."""
    n = adjusted.layout.n_poses
    return np.asarray(np.diag(adjusted.cov)[:n].reshape(-1, 6)[:, :3].mean(axis=1))


def _doubted(adjusted: Adjusted, predictions: ImagePoses | None) -> bool:
    """Whether half of the images lie or look elsewhere than predicted by more than three sigmas."""
    if predictions is None:
        return False
    row = {name: k for k, name in enumerate(predictions.images) if predictions.oriented[k]}
    at = [k for k, name in enumerate(adjusted.problem.block.images) if name in row]
    if len(at) < _LEAST_IMAGES:
        return False
    where = [row[adjusted.problem.block.images[k]] for k in at]
    cov = predictions.cov_pose_wcs[where]
    sigma = np.sqrt(
        np.stack([np.trace(cov[:, a : a + 3, a : a + 3], axis1=1, axis2=2) for a in (0, 3)], axis=1)
    )
    off = np.linalg.norm(adjusted.x.C[at] + adjusted.origin_m - predictions.centre_wcs_m[where], axis=1)
    turn = _angles(adjusted.x.R[at], predictions.R_wcs_ccs[where])
    with np.errstate(invalid="ignore", divide="ignore"):
        far = np.stack([off, turn], axis=1) / sigma
    return bool((np.nanmedian(far, axis=0) > _SIGMAS).any()) if np.isfinite(far).any() else False


def predicted_block(block: ImageBlock, predictions: ImagePoses | None) -> ImageBlock | None:
    """The block with predicted poses, and its points where their rays then meet; None if too few are known.

    An image without a prediction keeps its pose relative to the nearest one that has one.
    """
    if predictions is None:
        return None
    row = {name: k for k, name in enumerate(predictions.images) if predictions.oriented[k]}
    known = np.array([name in row for name in block.images])
    if known.sum() < _LEAST_IMAGES:
        return None
    centre, R = block.centre_block_m.copy(), block.R_block_ccs.copy()
    where = [row[block.images[k]] for k in np.flatnonzero(known)]
    centre[known], R[known] = predictions.centre_wcs_m[where], predictions.R_wcs_ccs[where]
    at = np.flatnonzero(known)
    for k in np.flatnonzero(~known):
        near = at[np.argmin(np.linalg.norm(block.centre_block_m[at] - block.centre_block_m[k], axis=1))]
        turn = R[near] @ block.R_block_ccs[near].T
        R[k] = turn @ block.R_block_ccs[k]
        centre[k] = centre[near] + turn @ (block.centre_block_m[k] - block.centre_block_m[near])
    rays = np.empty((len(block.mark_image), 3))
    for c, camera in enumerate(block.cameras):
        rows = np.flatnonzero(block.camera[block.mark_image] == c)
        rays[rows] = camera.rays(block.mark_px[rows])
    rays = np.einsum("mij,mj->mi", R[block.mark_image], np.nan_to_num(rays))
    return replace(
        block, centre_block_m=centre, R_block_ccs=R,
        points_block_m=_meeting(rays, centre[block.mark_image], block.mark_point, block.points_block_m),
    )  # fmt: skip


def _meeting(rays: ArrayF, centres: ArrayF, point: ArrayI, like: ArrayF) -> ArrayF:
    """Points (p, 3) nearest to their rays (m, 3)."""
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    side = np.einsum("mij,mj->mi", across, centres)
    n = len(like)
    N = np.stack([np.bincount(point, a, n) for a in across.reshape(-1, 9).T], axis=1).reshape(n, 3, 3)
    g = np.stack([np.bincount(point, a, n) for a in side.T], axis=1)
    return np.asarray(np.linalg.solve(N + _FLAT * np.eye(3), g[:, :, None])[:, :, 0])


def misfit(one: Adjusted, first: Adjusted, second: Adjusted) -> float:
    """-2 ln of the likelihood of a result, but for a constant: marks that both results use, control points.

    The errors are those of the second result, of Student's distribution, for both.
    """
    problem, x, model = one.problem, one.x, second.correlation
    block = problem.block
    view = views(second.x.X[block.mark_point], second.x.C[block.mark_image])
    sigma = block.sigma_px
    tracks = tracks_of(problem, first.used & second.used, sigma, view)
    at = np.repeat(tracks.point, np.diff(tracks.first))
    part = linearised(problem, one.layout, x, tracks.image, x.X[at], tracks.xy_px)
    part = along_and_across(part, tracks.along)
    n = len(tracks.point)
    logarithm, square = np.empty(n), np.empty(n)
    restricted_parts(
        tracks.first, part.by_point, part.residual, tracks.sigma_px, tracks.view, model.model, logarithm,
        square, np.empty(0),
    )  # fmt: skip
    total = float(_surprise(square, 2.0 * np.diff(tracks.first) - 3.0, model).sum())
    off = one.control_residual_px / (problem.marks.sigma_px * second.control_scale)[:, None]
    total += float(np.minimum(np.nan_to_num(np.square(off).sum(axis=1), nan=_MOST), _MOST).sum())
    return total + sum(one.costs.get(name, 0.0) for name in ("control points", "antenna", "clock"))


def _surprise(square: ArrayF, degrees: ArrayF, model: Correlation) -> ArrayF:
    if not np.isfinite(model.freedom):
        return square
    return np.asarray((model.freedom + degrees) * np.log1p(square / model.freedom))
