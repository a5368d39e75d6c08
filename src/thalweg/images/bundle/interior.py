"""What is known of interior orientations beforehand, and what a block may claim to know of them.

Errors that the tracks of a block have in common - one bank, seen from one side, on a way to and fro - leave
no residuals: points and cameras give way to them. Rendered blocks show where: at the true poses, the features
of each of three blocks find the camera constant too long, by 0.014 to 0.031 % or 1.7 to 3.6 sigmas
(`thalweg_lab.studies.image_blocks`). Halves of the tracks agree about the lens, divided by chance or
by place, so neighbours are not to blame. What the images tell of the interior orientation therefore counts
with a larger variance; what a calibration tells does not change. Errors that differ from part to part of a
block add to it (`thalweg.images.bundle.adjustment`).
"""

from collections.abc import Iterator

import numpy as np

from thalweg.core.types import ArrayF, ArrayI
from thalweg.images.bundle.problem import Layout, Problem, State


def interior_priors(problem: Problem, layout: Layout, x: State) -> Iterator[tuple[ArrayI, ArrayF, ArrayF]]:
    """Of each camera with known parameters: their unknowns (k,), weights (k, k), known minus present (k,)."""
    for k, (start, camera) in enumerate(zip(problem.block.cameras, x.cameras, strict=True)):
        at = layout.interior[k]
        sought = np.flatnonzero(at >= 0)
        if problem.weighted[k]:
            known = start.cov[np.ix_(sought, sought)]
        else:
            names = start.parameter_names
            sought = np.array([i for i in sought if names[i] in problem.prior_sigma], np.int64)
            known = np.diag([problem.prior_sigma[names[i]] ** 2 for i in sought])
        if not len(sought):
            continue
        # parameters that were estimated as one are correlated fully
        weights = np.asarray(np.linalg.inv(known + 1e-9 * np.diag(np.diag(known))), np.float64)
        yield at[sought], weights, (start.parameters - camera.parameters)[sought]


def with_shared_errors(problem: Problem, layout: Layout, x: State, cov: ArrayF, factor: float) -> ArrayF:
    """The covariance if what the images tell of the interior orientation had ``factor`` times the variance.

    With the normal matrix of the interior orientation alone, ``C^-1 = P + M`` of what is known and of what
    the images tell, the new covariance is ``C' = (P + M / factor)^-1``. All other unknowns follow it::

        cov' = cov + B (C' - C) B^T,    B = cov[:, interior] C^-1

    Parameters
    ----------
    cov : (u, u) covariance of all unknowns; zero where they are held.
    factor : at least 1.
    """
    begin = layout.n_poses
    own = np.arange(begin, begin + layout.n_interior)
    own = own[layout.free[own]]
    if factor == 1.0 or not len(own):
        return cov
    known = np.zeros((begin + layout.n_interior,) * 2)
    for at, weights, _ in interior_priors(problem, layout, x):
        # pixels that are square: two parameters, one unknown
        np.add.at(known, (at[:, None], at), weights)
    C = cov[np.ix_(own, own)]
    scale = np.sqrt(np.diag(C))
    unit = np.outer(scale, scale)
    P = known[np.ix_(own, own)] * unit
    R = np.linalg.inv(C / unit)
    new = np.linalg.inv(P + (R - P) / factor)
    B = (cov[:, own] / scale) @ R
    return np.asarray(cov + B @ (new - C / unit) @ B.T)
