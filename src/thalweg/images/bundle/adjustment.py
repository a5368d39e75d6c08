"""Adjustment of an image block with control points inside: poses, interior orientation, points, covariances.

Gauss-Newton with Levenberg's damping on the system that is left when the tie points are eliminated (Brown
1958; Triggs et al. 2000). Robust weights and the correlation of a track's errors are re-estimated between
rounds; then marks that no longer fit are left out, and counted. The last round goes on until the solution
stands still.

All is computed about a centre inside the block, so coordinates of a map grid lose no digits.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from scipy import linalg
from scipy.linalg import lapack
from scipy.spatial import cKDTree
from scipy.stats import chi2

from thalweg.core import (
    ArrayB,
    ArrayF,
    ArrayI,
    Camera,
    GeometryError,
    LocalFrame,
    UnobservableError,
    check_rank,
)
from thalweg.images.bundle.normals import (
    Correlation,
    Tracks,
    cost_of,
    derivatives_by_point,
    estimate,
    linearised,
    linearised_tracks,
    parallax,
    point_steps,
    projected,
    reduced_system,
    restricted_parts,
    tracks_of,
    views,
)
from thalweg.images.bundle.problem import Layout, Problem, State, moved, start_state, with_shared_errors
from thalweg.images.model import ControlMarks, ControlPoints, ImagePoses, triangulated
from thalweg.settings.sections import BlockAdjustment

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
_MOST_PARTS: Final = 4
_LEAST_IMAGES: Final = 8
"""Images of a part: fewer leave the distortion of most lenses unknown."""
_LEAST_MARKS: Final = 6
"""Marks of an image within its part."""
_UNKNOWN: Final = 1e-9
"""Share of the information of all parts below which one knows nothing of a combination of parameters."""
_CERTAIN: Final = 0.99
"""Probability of chi-square beyond which parts contradict each other."""

_RAYLEIGH_MEDIAN: Final = 1.1774
"""Median length of a residual of two coordinates in units of the sigma of one."""
_NEIGHBOURS: Final = 20
"""Points around a point that tell how restless the place is."""
_LEAST_REGION: Final = 0.3
"""Least variance of an undisturbed region, as a share of the usual one."""
_SAME_PIXEL_PX: Final = 0.02
"""Distance at which two marks are one measurement: features are found to a hundredth of a pixel at best."""
_LEAST_WEIGHT: Final = 1e-4
"""Weight that stands for none."""
_SAME_CORRELATION: Final = 0.03
_SAME_MARKS: Final = 1e-3
_LEAST_RAYS: Final = 3
"""Marks of a control point that can contradict each other."""
LEAST_IMAGE_MARKS: Final = 6
"""Marks that an image needs: three fix its six unknowns, without any check."""
_LEAST_CONTROL_REDUNDANCY: Final = 20
"""Redundancy from which the marks of control points tell their own accuracy: to 16 %."""

_LEAST_SHARE: Final = 0.05
"""Share of a coordinate's variance that must be left to its residual for a test."""
FEW_MARKS: Final = f"fewer than {LEAST_IMAGE_MARKS} marks fit the rest of the block"
_RISK: Final = 1e-4
"""Share of good points that the test accuses."""


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


class Weights:
    """Which marks take part and how far: the state of the rounds."""

    def __init__(self, problem: Problem, options: BlockAdjustment, x: State) -> None:
        block = problem.block
        self.options = options
        self.mark = np.ones(len(block.mark_image))
        self.track = np.ones(len(block.points_block_m))
        self.information = np.ones(len(block.points_block_m))
        self.control = np.ones(len(problem.marks.image))
        self.correlation, self.control_scale = Correlation(), 1.0
        self.see(problem, x)
        behind = ~np.isfinite(projected(problem, x, block.mark_image, x.X[block.mark_point])).all(axis=1)
        flat = _flat(problem, x, options.least_angle_deg)
        twice = repeated(problem)
        self.usable = ~behind & ~flat[block.mark_point] & ~twice
        self.fits = self.usable.copy()
        self.region = np.ones(len(block.points_block_m))
        self.undisturbed = np.ones(len(block.points_block_m), np.bool_)
        self.mark_point, self.mark_image = block.mark_point, block.mark_image
        self.lost_images = np.zeros(len(block.images), np.bool_)
        self.left_out = {
            "marks behind the camera": int(behind.sum()),
            "marks that repeat the pixel of another": int(twice.sum()),
            f"points under less than {options.least_angle_deg:g} degrees": int(flat.sum()),
        }

    def see(self, problem: Problem, x: State) -> None:
        """Places of view and directions of parallax of all marks at a state."""
        block = problem.block
        centres, points = x.C[block.mark_image], x.X[block.mark_point]
        self.view = views(points, centres)
        by_point = derivatives_by_point(problem, x, block.mark_image, points)
        self.along = parallax(by_point, block.mark_point, centres, len(x.X))

    @property
    def used(self) -> ArrayB:
        """(m,) marks that take part, but for those whose point loses all others."""
        seen = self.usable & self.fits & ~self.lost_images[self.mark_image]
        return seen & self.undisturbed[self.mark_point]

    def tracks(self, problem: Problem, *, final: bool = False) -> Tracks:
        """Tracks with all weights put into their sigmas; the last time with what they tell, too."""
        own = self.track / self.region * (self.information if final else 1.0)
        weight = self.mark * own[self.mark_point]
        sigma = problem.block.sigma_px / np.sqrt(np.maximum(weight, _LEAST_WEIGHT))
        return tracks_of(problem, self.used, sigma, self.view, self.along)

    def hold_unseen(self, problem: Problem, layout: Layout) -> None:
        """Hold exposures and check points that too few marks fix; their marks take no part."""
        marks, control = problem.marks, problem.control
        while True:
            count = np.bincount(problem.block.mark_point[self.used], minlength=len(self.track))
            tie = self.used & (count[self.mark_point] >= 2)
            exposure = layout.exposure
            n = np.bincount(exposure[self.mark_image[tie]], minlength=len(layout.exposures))
            seen = self.control > 0
            n += np.bincount(exposure[marks.image[seen & ~control.check[marks.point]]], minlength=len(n))
            lost = (n < LEAST_IMAGE_MARKS) & layout.free[: layout.n_poses].reshape(-1, 6).all(axis=1)
            lost = lost[exposure]
            if not (lost & ~self.lost_images).any():
                break
            self.lost_images |= lost
            self.control[self.lost_images[marks.image]] = 0.0
        layout.free[: layout.n_poses].reshape(-1, 6)[self.lost_images[layout.image]] = False
        n_point = np.bincount(marks.point[self.control > 0], minlength=len(control.names))
        single = control.check & (n_point < 2)
        self.control[single[marks.point]] = 0.0
        layout.free[layout.control :] = ~np.repeat(single, 3)

    def control_sigma(self, problem: Problem) -> ArrayF:
        """(n,) of control marks; infinite for those that are left out."""
        with np.errstate(divide="ignore"):
            return problem.marks.sigma_px * self.control_scale / np.sqrt(self.control)


# ---------------------------------------------------------------- adjustment


@dataclass(slots=True, kw_only=True)
class AdjustedBlock:
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
    problem: Problem,
    options: BlockAdjustment | None = None,
    *,
    scale_by_sigma0: bool = True,
    progress: Callable[[str], None] | None = None,
) -> AdjustedBlock:
    """Adjust a block from approximate values in the world frame.

    Parameters
    ----------
    problem : observations and approximate values.
    options : section ``images.adjustment``; None: its defaults. With ``correlated`` the errors of a track are
        modelled by `thalweg.images.bundle.normals`, and marks of control points get a scale of their own;
        without it all sigmas count as they are stated.
    scale_by_sigma0 : the covariance is multiplied by sigma0 squared.
    progress : called with a line of text a round.

    Raises
    ------
    UnobservableError : the observations leave unknowns free; names them.
    GeometryError : no marks are left, or no convergence.
    """
    options = options or BlockAdjustment()
    say = progress or (lambda text: None)
    origin = np.round(problem.block.centre_block_m.mean(axis=0))
    problem = problem.shifted(-origin)
    layout = Layout(problem)
    x = start_state(problem, layout)
    # check points begin where their rays meet, not where they were surveyed
    found = triangulated(problem.block, problem.marks, len(x.G))
    known = problem.control.check & np.isfinite(found[:, 0])
    x = replace(x, G=np.where(known[:, None], found, x.G))
    weights = Weights(problem, options, x)
    iterations = 0
    notes: list[str] = []
    rounds = _ROUNDS if options.loss != "none" or options.correlated else 1
    last = False
    for turn in range(rounds):
        last |= turn == rounds - 1
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
        last = not reweight(problem, layout, x, weights, turn)
        say(f"round {turn + 1}: {len(tracks.mark)} marks, {weights.correlation.facts()}")
    return _finished(problem, layout, x, tracks, weights, origin, iterations, notes, scale_by_sigma0)


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


def _finished(
    problem: Problem,
    layout: Layout,
    x: State,
    tracks: Tracks,
    weights: Weights,
    origin: ArrayF,
    iterations: int,
    notes: list[str],
    scale_by_sigma0: bool,
) -> AdjustedBlock:
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
    cov_scale = sigma0**2 if scale_by_sigma0 else 1.0
    variance = options.interior_variance
    if options.correlated:
        parts = parts_agreement(problem, x, telling, weights.correlation)
        variance = parts.interior_variance(options.interior_variance, cov_scale)
        if variance > options.interior_variance:
            note = (
                f"The {parts.parts} parts of the block, taken one by one, disagree about the lens: what the "
                f"images tell of it counts with {variance:.1f} times its variance. A lens that moves between "
                "exposures (stabiliser, focus, zoom) does this, or distortion that the model does not have"
            )
            notes = [*notes, note]
    cov = with_shared_errors(problem, layout, x, cov, variance)
    cov *= cov_scale
    used = np.zeros(len(block.mark_image), np.bool_)
    used[tracks.mark] = True
    undisturbed = weights.undisturbed[block.mark_point]
    return AdjustedBlock(
        problem=problem,
        layout=layout,
        x=x,
        origin_m=origin,
        cov=cov,
        cov_scale=cov_scale,
        control_cov_m2=cov_scale * control_cov,
        tracks=tracks,
        correlation=weights.correlation,
        control_scale=weights.control_scale,
        used=used,
        weight=np.where(used, weights.mark * (weights.track / weights.region)[block.mark_point], 0.0),
        residual_px=block.mark_px - projected(problem, x, block.mark_image, x.X[block.mark_point]),
        control_used=np.isfinite(sigma),
        control_residual_px=marks.xy_px - projected(problem, x, marks.image, x.G[marks.point]),
        sigma0=sigma0,
        redundancy=redundancy,
        n_observations=observations,
        n_unknowns=unknowns,
        iterations=iterations,
        costs=costs,
        left_out={
            **weights.left_out,
            "points in disturbed regions": int((~weights.undisturbed).sum()),
            "marks that do not fit": int((weights.usable & undisturbed & ~weights.fits).sum()),
            "marks of points that kept only one": int((weights.used & ~used).sum()),
            "images that kept too few marks": int(weights.lost_images.sum()),
            "marks of control points that do not fit": int((~np.isfinite(sigma)).sum()),
        },
        lost_images=weights.lost_images,
        interior_variance=variance,
        notes=notes,
    )


# ---------------------------------------------------------------- do the parts of a block agree on the lens?
# What they differ by shows in no residual of the whole
#
# The images are divided in their order, each part finds the interior orientation for itself, and the results
# are compared with their covariances. Errors that neighbouring tracks share over much of an image - a lens
# that moves between exposures (stabiliser, focus), distortion that its model does not have - differ from part
# to part. What all parts err by alike cannot show here; `thalweg.images.bundle.problem` has a factor for it.


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
        problem,
        control=ControlPoints.none(),
        marks=ControlMarks.none(),
        antenna=None,
        prior_sigma={},
        weighted=tuple(False for _ in problem.weighted),
        rig=None if problem.rig is None else replace(problem.rig, places="fixed"),
    )
    layout = Layout(bare)
    state = replace(x, G=np.zeros((0, 3)), extras=np.zeros(0))
    part, parts = _parts(problem, tracks)
    if parts < 2 or not layout.n_interior:
        return Agreement(square=0.0, degrees=0, parts=parts)
    found = [
        _lens_alone(bare, layout, state, tracks.chosen((part == k)[tracks.image]), model)
        for k in range(parts)
    ]
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
    """(i,) part of each image, those of each camera divided in their order; -1 for images without marks.

    Images of one exposure are in one part.
    """
    layout, cameras = Layout(problem), len(problem.block.cameras)
    n = len(layout.exposures)
    seen = np.bincount(layout.exposure[tracks.image], minlength=n) >= _LEAST_MARKS
    part = np.full(n, -1, np.int64)
    alone = problem.rig is None
    own = [np.flatnonzero(seen & (problem.block.camera == k)) for k in range(cameras)] if alone else []
    own = own or [np.flatnonzero(seen)]
    parts = min(_MOST_PARTS, min(len(rows) for rows in own) // _LEAST_IMAGES)
    for rows in own:
        part[rows] = np.arange(len(rows)) * parts // max(len(rows), 1)
    return part[layout.exposure], parts


def _lens_alone(
    problem: Problem, layout: Layout, x: State, tracks: Tracks, model: Correlation
) -> tuple[ArrayF, ArrayF]:
    """Normal equations (q, q), (q,) of the interior orientation by some tracks, poses eliminated."""
    q = slice(layout.n_poses, layout.n_poses + layout.n_interior)
    C = layout.poses(x)[1]
    images = np.flatnonzero(np.bincount(layout.exposure[tracks.image], minlength=len(C)) >= _LEAST_MARKS)
    if len(images) < 2:
        return np.zeros((layout.n_interior,) * 2), np.zeros(layout.n_interior)
    system = reduced_system(problem, layout, x, tracks, model, np.zeros(0), 0.0)
    # the datum, of which the lens is free: one image, and one coordinate of that farthest from it
    away = np.abs(C[images] - C[images[0]])
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


# ---------------------------------------------------------------- weights: which image points take part, and
# how far
#
# Blunders get smaller weights by a robust loss, and are left out beyond a limit. Tracks that err more than
# others count less, by themselves and by their neighbours: leaves in the wind and edges of the water move
# together, which no model of single tracks knows of.


def repeated(problem: Problem) -> ArrayB:
    """(m,) marks at the very pixel of another mark of their image, that of the longer track left out.

    A feature with two orientations gives two tracks with one and the same error.
    """
    block = problem.block
    length = np.bincount(block.mark_point, minlength=len(block.points_block_m))[block.mark_point]
    grid = np.round(block.mark_px / _SAME_PIXEL_PX).astype(np.int64)
    order = np.lexsort((block.mark_point, -length, grid[:, 1], grid[:, 0], block.mark_image))
    key = np.column_stack([block.mark_image, grid])[order]
    out = np.zeros(len(length), np.bool_)
    out[order[1:]] = (key[1:] == key[:-1]).all(axis=1)
    return out


def reweight(problem: Problem, layout: Layout, x: State, weights: Weights, turn: int) -> bool:
    """New robust weights, rejections and correlation; whether anything changed that matters."""
    before, used = weights.correlation, weights.used
    weights.see(problem, x)
    if weights.usable.any():
        if turn == 0:
            _first_weights(problem, x, weights)
        else:
            _track_weights(problem, layout, x, weights)
    if len(problem.marks.image):
        _weigh_control(problem, layout, x, weights)
    moved_marks = float(np.mean(used != weights.used)) if len(used) else 0.0
    fresh = weights.options.correlated and turn == 0
    return fresh or moved_marks > _SAME_MARKS or weights.correlation.differs(before, _SAME_CORRELATION)


def _first_weights(problem: Problem, x: State, weights: Weights) -> None:
    """Weights by the plain residuals, which only keep blunders from pulling at the first solution."""
    block = problem.block
    residual = block.mark_px - projected(problem, x, block.mark_image, x.X[block.mark_point])
    length = np.linalg.norm(residual, axis=1) / block.sigma_px
    scale = max(float(np.nanmedian(length[weights.usable])) / _RAYLEIGH_MEDIAN, 1e-9)
    weights.mark = _loss(length / scale, weights.options)
    weights.correlation = Correlation(white=scale) if weights.options.correlated else Correlation()


def _track_weights(problem: Problem, layout: Layout, x: State, weights: Weights) -> None:
    """Correlation of the errors of a track, weights of tracks and of marks, and marks that do not fit.

    Marks that were left out stay in the tracks with next to no weight: what the others say of them decides
    whether they come back.
    """
    options, block = weights.options, problem.block
    kept = weights.fits
    mark = np.where(kept, np.maximum(weights.mark, _LEAST_WEIGHT), _LEAST_WEIGHT)
    sigma = block.sigma_px * np.sqrt(weights.region[block.mark_point] / mark)
    every = tracks_of(problem, weights.usable, sigma, weights.view, weights.along)
    if options.correlated:
        chosen = tracks_of(problem, weights.used, sigma, weights.view, weights.along)
        known = weights.correlation if weights.correlation.slow > 0 else None
        part = linearised_tracks(problem, layout, x, chosen)
        weights.correlation = estimate(
            chosen.first, part.by_point, part.residual, chosen.sigma_px, chosen.view, known
        )
    n = len(every.point)
    part = linearised_tracks(problem, layout, x, every)
    model = weights.correlation.model
    _, square, fit = restricted_parts(
        every.first, part.by_point, part.residual, every.sigma_px, every.view, model, True
    )
    degrees = np.maximum(2.0 * np.add.reduceat(kept[every.mark], every.first[:-1]) - 3.0, 1.0)
    region = weights.region[every.point]
    undisturbed = np.ones(n, np.bool_)
    if options.correlated:
        noise = neighbours_noise(x.X[every.point], square * region, degrees)
        undisturbed = noise < options.disturbed_limit
        weights.region[every.point] = np.maximum(noise, _LEAST_REGION)
    track = weights.correlation.weights(square, degrees)
    far = fit / np.sqrt(mark[every.mark]) * np.repeat(np.sqrt(track), np.diff(every.first))
    if not options.correlated:
        far /= max(float(np.median(far[kept[every.mark]])) / _RAYLEIGH_MEDIAN, 1e-9)
    weights.track[every.point] = track
    weights.information[every.point] = weights.correlation.information(degrees)
    weights.mark[every.mark] = _loss(far, options)
    weights.fits = np.zeros_like(weights.usable)
    weights.fits[every.mark] = far < options.reject_limit
    weights.undisturbed[every.point] = undisturbed


def neighbours_noise(points_m: ArrayF, square: ArrayF, degrees: ArrayF) -> ArrayF:
    """(t,) how restless the surroundings of each point are: variance of neighbours' errors by the usual.

    Leaves in the wind and edges of the water move together. Their tracks err alike in each image, which no
    model of single tracks knows of; but they err more than others, and they are neighbours.
    """
    n = len(points_m)
    if n <= 2 * _NEIGHBOURS:
        return np.ones(n)
    near = np.asarray(cKDTree(points_m).query(points_m, k=_NEIGHBOURS + 1)[1])
    usual = float(np.median(square / degrees))
    # one blunder among undisturbed neighbours makes no region
    capped = np.minimum(square, 10.0 * usual * degrees)
    noise = capped[near[:, 1:]].sum(axis=1) / degrees[near[:, 1:]].sum(axis=1)
    return np.asarray(noise / np.median(noise))


def _weigh_control(problem: Problem, layout: Layout, x: State, weights: Weights) -> None:
    """Weights of the marks of control points, which of them do not fit, and how good they are.

    The marks of a point are compared with where they themselves put it: wrong coordinates are no reason to
    drop its marks, and must show.
    """
    options, marks = weights.options, problem.marks
    own = np.bincount(marks.point, minlength=len(x.G)) >= _LEAST_RAYS
    now = replace(problem.block, cameras=x.cameras, R_block_ccs=x.R, centre_block_m=x.C)
    meeting = triangulated(now, marks, len(x.G))
    place = np.where((own & np.isfinite(meeting[:, 0]))[:, None], meeting, x.G)
    off = marks.xy_px - projected(problem, x, marks.image, place[marks.point])
    far = np.nan_to_num(np.linalg.norm(off, axis=1) / marks.sigma_px, nan=np.inf)
    far = far / max(float(np.median(far)) / _RAYLEIGH_MEDIAN, 1.0)
    weights.control = np.where(far < options.reject_limit, _loss(far, options), 0.0)
    enough = 2 * len(far) - 3 * len(np.unique(marks.point)) >= _LEAST_CONTROL_REDUNDANCY
    if options.correlated and enough:
        weights.control_scale = _control_scale(problem, layout, x, weights)


def _control_scale(problem: Problem, layout: Layout, x: State, weights: Weights) -> float:
    """Errors of marks of control points in units of their stated sigma, each point's place left out."""
    marks = problem.marks
    rows = np.flatnonzero(weights.control > 0)
    part = linearised(problem, layout, x, marks.image[rows], x.G[marks.point[rows]], marks.xy_px[rows])
    sigma = marks.sigma_px[rows] / np.sqrt(weights.control[rows])
    square, degrees = 0.0, 0
    for k in np.unique(marks.point[rows]):
        own = marks.point[rows] == k
        if own.sum() < 2:
            continue
        A = (part.by_point[own] / sigma[own, None, None]).reshape(-1, 3)
        r = (part.residual[own] / sigma[own, None]).ravel()
        left = r - A @ np.linalg.lstsq(A, r, rcond=None)[0]
        square += float(left @ left)
        degrees += len(r) - 3
    return float(np.sqrt(square / degrees)) if degrees else 1.0


def _loss(t: ArrayF, options: BlockAdjustment) -> ArrayF:
    """Weights (m,) of residuals in units of their scale: Huber (1964), or Cauchy."""
    limit = options.loss_limit
    t = np.nan_to_num(t, nan=np.inf)
    if options.loss == "huber":
        return np.where(t > limit, limit / np.maximum(t, limit), 1.0)
    if options.loss == "cauchy":
        return 1.0 / (1.0 + np.square(t / limit))
    return np.ones_like(t)


def _flat(problem: Problem, x: State, least_deg: float) -> ArrayB:
    """(p,) points whose rays all lie within an angle: their distance is next to unknown."""
    block = problem.block
    ray = views(x.X[block.mark_point], x.C[block.mark_image])[:, :3]
    n = len(block.points_block_m)
    count = np.maximum(np.bincount(block.mark_point, minlength=n), 1)
    mean = np.stack([np.bincount(block.mark_point, ray[:, a], n) for a in range(3)], axis=1) / count[:, None]
    away = np.linalg.norm(ray - mean[block.mark_point], axis=1)
    widest = np.zeros(n)
    np.maximum.at(widest, block.mark_point, away)
    # the farthest ray from the mean is at least half the widest angle away from it
    return np.asarray(widest < np.radians(least_deg) / 2)


# ---------------------------------------------------------------- results: poses with covariances, cameras,
# points, control points with tests


def pose_covariance(adjusted: AdjustedBlock) -> ArrayF:
    """(6 f, 6 f) joint covariance of all poses: shift and rotation vector of each exposure, in wcs."""
    n = adjusted.layout.n_poses
    return adjusted.cov[:n, :n]


def adjusted_cameras(adjusted: AdjustedBlock) -> tuple[Camera, ...]:
    """Cameras with the covariance of their parameters; held ones keep what was known of them."""
    out = []
    for camera, at in zip(adjusted.x.cameras, adjusted.layout.interior, strict=True):
        sought = np.flatnonzero(at >= 0)
        cov = camera.cov.copy()
        if len(sought):
            # parameters that are held are taken as known: no correlation with those that are sought
            cov[sought] = 0.0
            cov[:, sought] = 0.0
            cov[np.ix_(sought, sought)] = adjusted.cov[np.ix_(at[sought], at[sought])]
        out.append(camera.with_parameters(camera.parameters, (cov + cov.T) / 2))
    return tuple(out)


def image_poses(
    adjusted: AdjustedBlock,
    frame: LocalFrame,
    images: Sequence[str],
    reasons: dict[str, str],
    times: dict[str, tuple[float, float]],
    facts: dict[str, Any] | None = None,
) -> ImagePoses:
    """Poses of all exposures of a run, in the order given; those without a pose keep their reason.

    Parameters
    ----------
    images : all names, of a rig those of its exposures.
    reasons : why an image has no pose.
    times : GPS time and its standard deviation by name.
    """
    layout = adjusted.layout
    at = {name: k for k, name in enumerate(layout.exposures)}
    n, Q = len(images), pose_covariance(adjusted)
    index = np.array([at.get(name, -1) for name in images], np.int64)
    lost = (index >= 0) & adjusted.lost_images[layout.image][index]
    reasons = {**reasons, **{images[k]: FEW_MARKS for k in np.flatnonzero(lost).tolist()}}
    known = (index >= 0) & ~lost
    centre, R = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    cov, following = np.full((n, 6, 6), np.nan), np.zeros((n, 6, 6))
    turns, centres = layout.poses(adjusted.x)
    centre[known], R[known] = centres[index[known]] + adjusted.origin_m, turns[index[known]]
    rows = np.flatnonzero(known)
    for a, row in enumerate(rows):
        own = slice(6 * index[row], 6 * index[row] + 6)
        cov[row] = (Q[own, own] + Q[own, own].T) / 2
        if a + 1 < len(rows):
            other = index[rows[a + 1]]
            following[row] = Q[own, 6 * other : 6 * other + 6]
    following[~known] = np.nan
    count, rms = exposure_statistics(adjusted)
    t = np.array([times.get(name, (np.nan, np.nan)) for name in images], np.float64).reshape(n, 2)
    return ImagePoses(
        frame=frame,
        images=tuple(images),
        t_gps_s=t[:, 0],
        sigma_t_s=t[:, 1],
        oriented=known,
        reasons=tuple(
            "" if k else reasons.get(name, "not in the block") for name, k in zip(images, known, strict=True)
        ),
        centre_wcs_m=centre,
        R_wcs_ccs=R,
        cov_pose_wcs=cov,
        cov_next=following,
        n_marks=np.where(known, count[index], 0.0).astype(np.float64),
        rms_px=np.where(known, rms[index], np.nan),
        facts=facts or {},
    )


def exposure_statistics(adjusted: AdjustedBlock) -> tuple[ArrayF, ArrayF]:
    """(f,) used marks of each exposure, and the rms of their residuals, both coordinates together, pixels."""
    block, marks, layout = adjusted.problem.block, adjusted.problem.marks, adjusted.layout
    n = len(layout.exposures)
    tie, control = adjusted.used, adjusted.control_used
    image = layout.exposure[np.concatenate([block.mark_image[tie], marks.image[control]])]
    off = np.concatenate([adjusted.residual_px[tie], adjusted.control_residual_px[control]])
    count = np.bincount(image, minlength=n).astype(np.float64)
    square = np.bincount(image, np.square(off).sum(axis=1) / 2, minlength=n)
    with np.errstate(invalid="ignore", divide="ignore"):
        return count, np.sqrt(square / count)


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlResult:
    """How control and check points came out.

    ``off_m`` (k, 3) adjusted minus surveyed; ``cov_m2`` (k, 3, 3) predicted covariance of it; ``without_m``
    (k, 3) the same if the point's own coordinates had taken no part, with ``cov_without_m2``; ``test`` (k,)
    chi-square of three degrees of freedom of either; ``n_marks``, ``rms_px`` (k,) of used marks;
    ``suspect`` (k,) points that do not fit the others; ``notes`` for people.
    """

    off_m: ArrayF
    cov_m2: ArrayF
    without_m: ArrayF
    cov_without_m2: ArrayF
    test: ArrayF
    n_marks: ArrayF
    rms_px: ArrayF
    suspect: ArrayB
    notes: list[str]


def _against_others(off: ArrayF, cov: ArrayF, C: ArrayF) -> tuple[float, ArrayF, ArrayF]:
    """Test of a control point's residual (3,), difference without its own coordinates, covariance of it.

    In directions that nothing else fixes a residual is what iterations and robust weights left: it is not
    tested there, and stays as it is with the covariance of the coordinates.
    """
    L = np.linalg.cholesky(C)
    share, axes = np.linalg.eigh(np.linalg.solve(L, np.linalg.solve(L, cov).T))
    told = share > _LEAST_SHARE
    r = axes.T @ np.linalg.solve(L, off)
    factor = np.where(told, 1.0 / np.where(told, share, 1.0), 1.0)
    turn = L @ axes
    return float((np.square(r) * factor)[told].sum()), turn @ (r * factor), (turn * factor) @ turn.T


def control_result(adjusted: AdjustedBlock) -> ControlResult:
    """Differences of control and check points, each tested against all others.

    A check point's difference has the covariance ``C + Q`` of survey and block, a control point's ``C - Q``,
    because it has pulled the block to itself. Without its own coordinates a control point would be at
    ``C (C - Q)^-1 (adjusted - surveyed)``, with the covariance ``C (C - Q)^-1 C`` of that difference.
    """
    control, marks, layout = adjusted.problem.control, adjusted.problem.marks, adjusted.layout
    k = len(control.names)
    off = adjusted.x.G - control.points_wcs_m
    # what was stated counts with the same factor as what came out
    C = adjusted.cov_scale * control.cov_wcs_m2
    Q = np.array([adjusted.cov[layout.point(i), layout.point(i)] for i in range(k)]).reshape(k, 3, 3)
    check = control.check[:, None, None]
    cov = np.where(check, C + Q, C - adjusted.control_cov_m2)
    # a check point that lost its marks has no place
    lost = control.check & ~adjusted.layout.free[layout.control :: 3]
    off[lost], cov[lost] = np.nan, np.nan
    test, without, cov_without = np.empty(k), off.copy(), cov.copy()
    for p in range(k):
        if control.check[p]:
            test[p] = off[p] @ np.linalg.solve(cov[p], off[p]) if np.isfinite(off[p]).all() else np.nan
        else:
            test[p], without[p], cov_without[p] = _against_others(off[p], cov[p], C[p])
    used = adjusted.control_used
    count = np.bincount(marks.point[used], minlength=k).astype(np.float64)
    square = np.bincount(
        marks.point[used], np.square(adjusted.control_residual_px[used]).sum(axis=1) / 2, minlength=k
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        rms = np.sqrt(square / count)
    with np.errstate(invalid="ignore"):
        suspect = test > chi2.isf(_RISK, 3)
    notes = [
        f"{'Check' if control.check[i] else 'Control'} point {control.names[i]} lies "
        f"{np.linalg.norm(without[i]):.3f} m from where all others put it, {np.sqrt(test[i] / 3):.1f} times "
        "what its sigma allows"
        for i in np.flatnonzero(suspect)
    ]
    strange = np.flatnonzero((count == 0) & (marks.counts(k) > 0))
    notes += [
        f"None of the {int(marks.counts(k)[i])} marks of {control.names[i]} fits: is it another point?"
        for i in strange
    ]
    return ControlResult(
        off_m=off,
        cov_m2=cov,
        without_m=without,
        cov_without_m2=cov_without,
        test=test,
        n_marks=count,
        rms_px=rms,
        suspect=suspect,
        notes=notes,
    )
