"""Adjustment of an image block with control points inside: poses, interior orientation, points, covariances.

Gauss-Newton with Levenberg's damping on the system that is left when the tie points are eliminated (Brown
1958; Triggs et al. 2000). Robust weights and the correlation of a track's errors are re-estimated between
rounds; then marks that no longer fit are left out, and counted. The last round goes on until the solution
stands still.

All is computed about a centre inside the block, so coordinates of a map grid lose no digits.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from scipy import linalg
from scipy.linalg import lapack
from scipy.stats import chi2

from thalweg.core.adjustment.normal_equations import UnobservableError, check_rank
from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.images.bundle.correlation import Correlation
from thalweg.images.bundle.interior import with_shared_errors
from thalweg.images.bundle.linear import Tracks, cost_of, point_steps, projected, reduced_system
from thalweg.images.bundle.problem import Layout, Problem, State, moved, start_state
from thalweg.images.bundle.weights import Options, Weights, reweight
from thalweg.images.model.control_points import ControlMarks, ControlPoints
from thalweg.images.model.start import triangulated

# ---------------------------------------------------------------- do the parts of a block agree on the lens?
# What they differ by shows in no residual of the whole
#
# The images are divided in their order, each part finds the interior orientation for itself, and the results
# are compared with their covariances. Errors that neighbouring tracks share over much of an image - a lens
# that moves between exposures (stabiliser, focus), distortion that its model does not have - differ from part
# to part. What all parts err by alike cannot show here; `thalweg.images.bundle.interior` has a factor for it.


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


# ---------------------------------------------------------------- adjustment


_SMALL_PIVOT: Final = 1e-6
"""Pivot of the scaled normal matrix below which its rank is looked at."""
_ROUNDS: Final = 7
_STEPS_A_ROUND: Final = 3
_STILL: Final = 1e-7
"""Mean square change of the unknowns, in units of their sigmas, at which the solution stands still."""
CURE: Final = (
    "Add control points or antenna positions that are not on one line, hold interior parameters that the "
    "block cannot show, or leave out images that hang on few points"
)


@dataclass(slots=True, kw_only=True)
class Adjusted:
    """An adjusted block.

    ``problem`` and ``x`` are about a local centre: ``wcs = local + origin_m``. ``cov`` (u, u) belongs to the
    unknowns of ``layout``, and ``cov_scale`` is a factor in it; ``control_cov_m2`` (k, 3, 3) are the blocks
    of the control points by the model of the errors alone, which their residuals follow. ``used`` (m,) and
    ``weight`` (m,) tell of tie marks, ``lost_images`` (i,) of images that kept too few of them,
    ``control_used`` (n,) and ``control_residual_px`` (n, 2) of marks of control points, and ``residual_px``
    (m, 2) of tie marks. ``interior_variance`` is the factor by which ``cov`` has what the images tell of the
    interior orientation.
    """

    problem: Problem
    layout: Layout
    x: State
    origin_m: ArrayF
    cov: ArrayF
    cov_scale: float
    control_cov_m2: ArrayF
    tracks: Tracks
    correlation: Correlation
    control_scale: float
    used: ArrayB
    weight: ArrayF
    residual_px: ArrayF
    control_used: ArrayB
    control_residual_px: ArrayF
    sigma0: float
    redundancy: int
    n_observations: int
    n_unknowns: int
    iterations: int
    costs: dict[str, float]
    left_out: dict[str, int]
    lost_images: ArrayB
    interior_variance: float
    notes: list[str] = field(default_factory=list)


def adjust_block(
    problem: Problem, options: Options | None = None, *, progress: Callable[[str], None] | None = None
) -> Adjusted:
    """Adjust a block from approximate values in the world frame.

    Raises
    ------
    UnobservableError : the observations leave unknowns free; names them.
    GeometryError : no marks are left, or no convergence.
    """
    options = options or Options()
    say = progress or (lambda text: None)
    origin = np.round(problem.block.centre_block_m.mean(axis=0))
    problem = problem.shifted(-origin)
    layout = Layout(problem)
    x = start_state(problem, layout)
    x = _with_intersected_checks(problem, x)
    weights = Weights(problem, options, x)
    iterations = 0
    notes: list[str] = []
    rounds = _ROUNDS if options.loss or options.correlated else 1
    for turn in range(rounds):
        last = turn == rounds - 1
        weights.hold_unseen(problem, layout)
        tracks = weights.tracks(problem)
        if len(tracks.mark) == 0 and len(problem.marks.image) == 0:
            raise GeometryError("no marks are left in the block", expected="points seen in several images")
        x, n = _converged(
            problem, layout, x, tracks, weights, options.max_iterations if last else _STEPS_A_ROUND
        )
        iterations += n
        if last:
            break
        changed = reweight(problem, layout, x, weights, turn)
        say(f"round {turn + 1}: {len(tracks.mark)} marks, {weights.correlation.facts()}")
        if not changed:
            weights.hold_unseen(problem, layout)
            tracks = weights.tracks(problem)
            x, n = _converged(problem, layout, x, tracks, weights, options.max_iterations)
            iterations += n
            break
    return _finished(problem, layout, x, tracks, weights, origin, iterations, notes)


def _converged(
    problem: Problem, layout: Layout, x: State, tracks: Tracks, weights: Weights, most: int
) -> tuple[State, int]:
    """Damped Gauss-Newton steps with fixed weights."""
    sigma, model = weights.control_sigma(problem), weights.correlation
    damping, cost = 0.0, None
    free = layout.free
    for step in range(most):
        system = reduced_system(problem, layout, x, tracks, model, sigma, damping)
        cost = sum(system.cost.values())
        while True:
            d = np.zeros(len(free))
            d[free] = _solved(system.N, system.g, layout, damping)
            decrement = float(d @ system.g)
            dX = point_steps(problem, layout, x, tracks, model, damping, d)
            trial = moved(x, d, dX, layout)
            after = cost_of(problem, layout, trial, tracks, model, sigma)
            if after <= cost * (1 + 1e-9) or decrement < _STILL * free.sum():
                break
            damping = max(1e-4, 10 * damping)
            if damping > 1e6:
                raise GeometryError(
                    "the adjustment of the images does not converge",
                    expected="approximate poses from which the square sum falls",
                    cure="Check the control points and the images that hang on few points",
                )
            system = reduced_system(problem, layout, x, tracks, model, sigma, damping)
        x = trial
        damping = 0.0 if damping <= 1e-4 else damping / 100
        if decrement < _STILL * free.sum() and damping == 0.0:
            return x, step + 1
    return x, most


def _solved(N: ArrayF, g: ArrayF, layout: Layout, damping: float) -> ArrayF:
    free = layout.free
    A = N[np.ix_(free, free)]
    factor, scale = _factor(A, layout, damping)
    return np.asarray(linalg.cho_solve((factor, True), g[free] / scale) / scale)


def _factor(A: ArrayF, layout: Layout, damping: float) -> tuple[ArrayF, ArrayF]:
    """Lower Cholesky factor of the matrix scaled to a unit diagonal, and the scale."""
    names = tuple(n for n, f in zip(layout.names, layout.free, strict=True) if f)
    diagonal = np.diag(A)
    blind = np.flatnonzero(~(diagonal > 0))
    if len(blind):
        raise UnobservableError([names[i] for i in blind[:6]], defects=len(blind), cure=CURE)
    scale = np.sqrt(diagonal)
    scaled = A / scale
    scaled /= scale[:, None]
    scaled[np.diag_indices_from(scaled)] += damping
    try:
        factor = linalg.cholesky(scaled, lower=True, check_finite=False)
    except np.linalg.LinAlgError:
        check_rank(A, names, None, CURE)
        raise GeometryError(
            "the normal equations of the block are not positive", expected="a determined block", cure=CURE
        ) from None
    if damping == 0.0 and np.diag(factor).min() < _SMALL_PIVOT:
        check_rank(A, names, None, CURE)
    return factor, scale


def _with_intersected_checks(problem: Problem, x: State) -> State:
    """Check points begin where their rays meet, not where they were surveyed."""
    found = triangulated(problem.block, problem.marks, len(x.G))
    known = problem.control.check & np.isfinite(found[:, 0])
    return replace(x, G=np.where(known[:, None], found, x.G))


def _finished(
    problem: Problem,
    layout: Layout,
    x: State,
    tracks: Tracks,
    weights: Weights,
    origin: ArrayF,
    iterations: int,
    notes: list[str],
) -> Adjusted:
    """Covariance, residuals and counts at the solution."""
    block, marks, options = problem.block, problem.marks, weights.options
    sigma = weights.control_sigma(problem)
    free = layout.free
    system = reduced_system(problem, layout, x, tracks, weights.correlation, sigma, 0.0)
    costs = system.cost
    telling = tracks
    if np.isfinite(weights.correlation.freedom):
        telling = weights.tracks(problem, final=True)
        system = reduced_system(problem, layout, x, telling, weights.correlation, sigma, 0.0)
    factor, scale = _factor(system.N[np.ix_(free, free)], layout, 0.0)
    inverse, fault = lapack.dpotri(factor, lower=1)
    if fault:
        raise GeometryError(
            "the normal equations of the block have no inverse", expected="a determined block"
        )
    inverse = np.tril(inverse) + np.tril(inverse, -1).T
    cov = np.zeros_like(system.N)
    cov[np.ix_(free, free)] = inverse / np.outer(scale, scale)
    control_cov = np.array([cov[layout.point(i), layout.point(i)] for i in range(len(x.G))]).reshape(-1, 3, 3)
    observations = sum(system.counts.values())
    unknowns = int(free.sum()) + 3 * len(tracks.point)
    redundancy = observations - unknowns
    if redundancy < 1:
        raise GeometryError(
            f"{observations} observations for {unknowns} unknowns", expected="more observations than unknowns"
        )
    sigma0 = float(np.sqrt(sum(costs.values()) / redundancy))
    cov_scale = sigma0**2 if options.scale_by_sigma0 else 1.0
    variance = options.interior_variance
    if options.correlated:
        parts = parts_agreement(problem, x, telling, weights.correlation)
        variance = parts.interior_variance(options.interior_variance, cov_scale)
        if variance > options.interior_variance:
            notes = [*notes, _lens_note(parts, variance)]
    cov = with_shared_errors(problem, layout, x, cov, variance)
    cov *= cov_scale
    used = np.zeros(len(block.mark_image), np.bool_)
    used[tracks.mark] = True
    calm = weights.calm[block.mark_point]
    return Adjusted(
        problem=problem, layout=layout, x=x, origin_m=origin, cov=cov, cov_scale=cov_scale,
        control_cov_m2=cov_scale * control_cov, tracks=tracks,
        correlation=weights.correlation, control_scale=weights.control_scale, used=used,
        weight=np.where(used, weights.mark * (weights.track / weights.region)[block.mark_point], 0.0),
        residual_px=block.mark_px - projected(problem, x, block.mark_image, x.X[block.mark_point]),
        control_used=np.isfinite(sigma),
        control_residual_px=marks.xy_px - projected(problem, x, marks.image, x.G[marks.point]),
        sigma0=sigma0, redundancy=redundancy, n_observations=observations, n_unknowns=unknowns,
        iterations=iterations, costs=costs,
        left_out={
            **weights.left_out,
            "points in restless places": int((~weights.calm).sum()),
            "marks that do not fit": int((weights.usable & calm & ~weights.fits).sum()),
            "marks of points that kept only one": int((weights.used & ~used).sum()),
            "images that kept too few marks": int(weights.lost_images.sum()),
            "marks of control points that do not fit": int((~np.isfinite(sigma)).sum()),
        },
        lost_images=weights.lost_images,
        interior_variance=variance,
        notes=notes,
    )  # fmt: skip


def _lens_note(parts: Agreement, variance: float) -> str:
    return (
        f"The {parts.parts} parts of the block, taken one by one, disagree about the lens: what the images "
        f"tell of it counts with {variance:.1f} times its variance. A lens that moves between exposures "
        "(stabiliser, focus, zoom) does this, or distortion that the model does not have"
    )
