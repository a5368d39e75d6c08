"""Which marks of an image block take part in its adjustment, and how far.

Blunders get smaller weights by a robust loss, and are left out beyond a limit. Tracks that err more than
others count less, by themselves and by their neighbours: leaves in the wind and edges of the water move
together, which no model of single tracks knows of.
"""

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from scipy.spatial import cKDTree

from thalweg.core.types import ArrayB, ArrayF
from thalweg.images.bundle.correlation import Correlation, estimate, parallax, views
from thalweg.images.bundle.kernels import restricted_parts
from thalweg.images.bundle.linear import (
    Tracks,
    along_and_across,
    derivatives_by_point,
    linearised,
    projected,
    tracks_of,
)
from thalweg.images.bundle.problem import Layout, Problem, State
from thalweg.images.model.start import triangulated

_RAYLEIGH_MEDIAN: Final = 1.1774
"""Median length of a residual of two coordinates in units of the sigma of one."""
_NEIGHBOURS: Final = 20
"""Points around a point that tell how restless the place is."""
_LEAST_REGION: Final = 0.3
"""Least variance of a calm region, as a share of the usual one."""
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """How a block is adjusted.

    Parameters
    ----------
    loss, loss_limit : None, ``huber`` or ``cauchy`` weights of residuals in units of their sigma, and where
        they begin to fall.
    reject_limit : residual in units of its sigma beyond which a mark is left out; infinite: none is.
    correlated : the errors of a track are modelled by `thalweg.images.bundle.correlation`, and marks of
        control points get a scale of their own; without it all sigmas count as they are stated.
    scale_by_sigma0 : the covariance is multiplied by sigma0 squared.
    restless_limit : variance of the errors of a point's neighbours over the usual one beyond which a point is
        left out; with ``correlated`` only.
    least_angle_deg : points whose rays differ less are left out.
    max_iterations : of the last round.
    interior_variance : least variance of what the images tell of the interior orientation over that by the
        model of their errors: see `thalweg.images.bundle.interior`. 1 where the errors follow the model.
    """

    loss: Literal["huber", "cauchy"] | None = "huber"
    loss_limit: float = 3.0
    reject_limit: float = 5.0
    correlated: bool = True
    scale_by_sigma0: bool = True
    restless_limit: float = 4.0
    least_angle_deg: float = 1.0
    max_iterations: int = 50
    interior_variance: float = 1.0


class Weights:
    """Which marks take part and how far: the state of the rounds."""

    def __init__(self, problem: Problem, options: Options, x: State) -> None:
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
        self.calm = np.ones(len(block.points_block_m), np.bool_)
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
        return self.usable & self.fits & self.calm[self.mark_point] & ~self.lost_images[self.mark_image]

    def tracks(self, problem: Problem, *, final: bool = False) -> Tracks:
        """Tracks with all weights put into their sigmas; the last time with what they tell, too."""
        own = self.track / self.region * (self.information if final else 1.0)
        weight = self.mark * own[self.mark_point]
        sigma = problem.block.sigma_px / np.sqrt(np.maximum(weight, _LEAST_WEIGHT))
        return tracks_of(problem, self.used, sigma, self.view, self.along)

    def hold_unseen(self, problem: Problem, layout: Layout) -> None:
        """Hold images and check points that too few marks fix; their marks take no part."""
        marks, control = problem.marks, problem.control
        while True:
            count = np.bincount(problem.block.mark_point[self.used], minlength=len(self.track))
            tie = self.used & (count[self.mark_point] >= 2)
            n = np.bincount(self.mark_image[tie], minlength=len(self.lost_images))
            seen = self.control > 0
            n += np.bincount(marks.image[seen & ~control.check[marks.point]], minlength=len(n))
            lost = (n < LEAST_IMAGE_MARKS) & layout.free[: layout.n_poses].reshape(-1, 6).all(axis=1)
            if not (lost & ~self.lost_images).any():
                break
            self.lost_images |= lost
            self.control[self.lost_images[marks.image]] = 0.0
        layout.free[: layout.n_poses].reshape(-1, 6)[self.lost_images] = False
        n_point = np.bincount(marks.point[self.control > 0], minlength=len(control.names))
        single = control.check & (n_point < 2)
        self.control[single[marks.point]] = 0.0
        layout.free[layout.control :] = ~np.repeat(single, 3)

    def control_sigma(self, problem: Problem) -> ArrayF:
        """(n,) of control marks; infinite for those that are left out."""
        with np.errstate(divide="ignore"):
            return problem.marks.sigma_px * self.control_scale / np.sqrt(self.control)


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
        weights.correlation = estimate(
            chosen.first, *_geometry(problem, layout, x, chosen), chosen.sigma_px, chosen.view, known
        )
    n = len(every.point)
    logarithm, square, fit = np.empty(n), np.empty(n), np.empty(len(every.mark))
    restricted_parts(
        every.first, *_geometry(problem, layout, x, every), every.sigma_px, every.view,
        weights.correlation.model, logarithm, square, fit,
    )  # fmt: skip
    degrees = np.maximum(2.0 * np.add.reduceat(kept[every.mark], every.first[:-1]) - 3.0, 1.0)
    region = weights.region[every.point]
    calm = np.ones(n, np.bool_)
    if options.correlated:
        noise = neighbours_noise(x.X[every.point], square * region, degrees)
        calm = noise < options.restless_limit
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
    weights.calm[every.point] = calm


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
    # one blunder among calm neighbours makes no region
    capped = np.minimum(square, 10.0 * usual * degrees)
    noise = capped[near[:, 1:]].sum(axis=1) / degrees[near[:, 1:]].sum(axis=1)
    return np.asarray(noise / np.median(noise))


def _geometry(problem: Problem, layout: Layout, x: State, tracks: Tracks) -> tuple[ArrayF, ArrayF]:
    """Derivatives (m, 2, 3) of marks by their points, and residuals (m, 2), along and across."""
    at = np.repeat(tracks.point, np.diff(tracks.first))
    part = linearised(problem, layout, x, tracks.image, x.X[at], tracks.xy_px)
    part = along_and_across(part, tracks.along)
    return part.by_point, part.residual


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


def _loss(t: ArrayF, options: Options) -> ArrayF:
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
