"""Do the parts of a block agree on the lens? What they differ by shows in no residual of the whole.

The images are divided in their order, each part finds the interior orientation for itself, and the results
are compared with their covariances. Errors that neighbouring tracks share over much of an image - a lens that
moves between exposures (stabiliser, focus), distortion that its model does not have - differ from part to
part. What all parts err by alike cannot show here; `thalweg.images.bundle.interior` has a factor for it.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.stats import chi2

from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.images.bundle.correlation import Correlation
from thalweg.images.bundle.linear import Tracks, reduced_system
from thalweg.images.bundle.problem import Layout, Problem, State
from thalweg.images.model.control_points import ControlMarks, ControlPoints

_MOST_PARTS: Final = 4
_LEAST_IMAGES: Final = 8
"""Images of a part: fewer leave the distortion of most lenses unknown."""
_LEAST_MARKS: Final = 6
"""Marks of an image within its part."""
_UNKNOWN: Final = 1e-9
"""Share of the information of all parts below which one knows nothing of a combination of parameters."""
_CERTAIN: Final = 0.99
"""Probability of chi-square beyond which parts contradict each other."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """Square sum of what the lenses of the parts differ by, in units of their covariances, and its degrees.

    ``square`` is to be divided by the variance factor by which the covariances are multiplied.
    """

    square: float
    degrees: int
    parts: int

    def interior_variance(self, least: float, cov_scale: float) -> float:
        """Variance of what the images tell of the lens over that by the model of their errors.

        Parameters
        ----------
        least : what the parts have in common is part of it: factor of a block whose parts agree, at least 1.
        cov_scale : variance factor of the covariances.

        Returns
        -------
        factor : ``least`` where the parts agree; else common and different errors together.
        """
        if self.degrees == 0:
            return least
        square = self.square / cov_scale
        if square <= chi2.ppf(_CERTAIN, self.degrees):
            return least
        return float(least - 1.0 + square / self.degrees)


def parts_agreement(problem: Problem, x: State, tracks: Tracks, model: Correlation) -> Agreement:
    """Compare the interior orientations that the parts of an adjusted block find by their tie marks alone.

    One step of Gauss and Newton from the common solution ``x`` is enough: with the normal equations
    ``S_k d_k = s_k`` of part k, its poses and points eliminated, the square sum is
    ``sum s_k^T S_k^+ s_k - s^T S^+ s`` with the sums ``S`` and ``s`` of all parts.

    Parameters
    ----------
    tracks : of the whole block, with all weights in their sigmas.
    model : how the errors of a track are related.

    Returns
    -------
    agreement : of no degrees of freedom if no lens is sought or the images are too few.
    """
    bare = replace(
        problem, control=ControlPoints.none(), marks=ControlMarks.none(), antenna=None, prior_sigma={},
        weighted=tuple(False for _ in problem.weighted),
    )  # fmt: skip
    layout = Layout(bare)
    state = replace(x, G=np.zeros((0, 3)), extras=np.zeros(0))
    part, parts = _parts(problem, tracks)
    if parts < 2 or not layout.n_interior:
        return Agreement(square=0.0, degrees=0, parts=parts)
    found = [_lens_alone(bare, layout, state, _only(tracks, part == k), model) for k in range(parts)]
    whole, right = sum(S for S, _ in found), sum(s for _, s in found)
    scale = np.sqrt(np.maximum(np.diag(np.asarray(whole)), 1e-300))
    total, rank = _square(np.asarray(whole), np.asarray(right), scale)
    each = [_square(S, s, scale) for S, s in found]
    return Agreement(
        square=max(sum(square for square, _ in each) - total, 0.0),
        degrees=sum(own for _, own in each) - rank,
        parts=parts,
    )


def _parts(problem: Problem, tracks: Tracks) -> tuple[ArrayI, int]:
    """(i,) part of each image, those of each camera divided in their order; -1 for images without marks."""
    images = len(problem.block.images)
    seen = np.bincount(tracks.image, minlength=images) >= _LEAST_MARKS
    part = np.full(images, -1, np.int64)
    own = [np.flatnonzero(seen & (problem.block.camera == k)) for k in range(len(problem.block.cameras))]
    parts = min(_MOST_PARTS, min(len(rows) for rows in own) // _LEAST_IMAGES)
    for rows in own:
        part[rows] = np.arange(len(rows)) * parts // max(len(rows), 1)
    return part, parts


def _only(tracks: Tracks, images: ArrayB) -> Tracks:
    """The marks in some images (i,), of points that keep two of them."""
    point = np.repeat(np.arange(len(tracks.point)), np.diff(tracks.first))
    rows = np.flatnonzero(images[tracks.image])
    count = np.bincount(point[rows], minlength=len(tracks.point))
    rows = rows[count[point[rows]] >= 2]
    kept, first = np.unique(point[rows], return_index=True)
    return Tracks(
        point=tracks.point[kept], first=np.append(first, len(rows)).astype(np.int64), mark=tracks.mark[rows],
        image=tracks.image[rows], xy_px=tracks.xy_px[rows], sigma_px=tracks.sigma_px[rows],
        view=tracks.view[rows], along=tracks.along[rows],
    )  # fmt: skip


def _lens_alone(
    problem: Problem, layout: Layout, x: State, tracks: Tracks, model: Correlation
) -> tuple[ArrayF, ArrayF]:
    """Normal equations (q, q), (q,) of the interior orientation by some tracks, poses eliminated."""
    q = slice(layout.n_poses, layout.n_poses + layout.n_interior)
    images = np.flatnonzero(np.bincount(tracks.image, minlength=len(x.C)) >= _LEAST_MARKS)
    if len(images) < 2:
        return np.zeros((layout.n_interior,) * 2), np.zeros(layout.n_interior)
    system = reduced_system(problem, layout, x, tracks, model, np.zeros(0), 0.0)
    # the datum, of which the lens is free: one image, and one coordinate of that farthest from it
    away = np.abs(x.C[images] - x.C[images[0]])
    far = int(np.argmax(np.linalg.norm(away, axis=1)))
    poses = (6 * images[1:, None] + np.arange(6)).ravel()
    poses = poses[poses != 6 * images[far] + int(np.argmax(away[far]))]
    poses = poses[np.diag(system.N)[poses] > 0]
    scale = np.sqrt(np.diag(system.N)[poses])
    A = system.N[np.ix_(poses, poses)] / np.outer(scale, scale)
    B = system.N[poses, q] / scale[:, None]
    solved = np.linalg.lstsq(A, np.column_stack([B, system.g[poses] / scale]), rcond=1e-13)[0]
    return system.N[q, q] - B.T @ solved[:, :-1], system.g[q] - B.T @ solved[:, -1]


def _square(S: ArrayF, s: ArrayF, scale: ArrayF) -> tuple[float, int]:
    """``s^T S^+ s``, and the rank of ``S``; combinations of which next to nothing is known left out."""
    values, vectors = np.linalg.eigh(S / np.outer(scale, scale))
    known = values > _UNKNOWN
    along = vectors.T @ (s / scale)
    return float((along[known] ** 2 / values[known]).sum()), int(known.sum())
