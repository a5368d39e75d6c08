"""Which marks, points, markers and pictures of a bundle are wrong: found in turn, each with its reason."""

from dataclasses import replace
from typing import Final

import numpy as np
from scipy.stats import chi2

from thalweg.calibration.field.bundle import (
    MARKS,
    Layout,
    Problem,
    State,
    mark_lengths,
    mark_tests,
    reduced,
    settle,
    solve,
)  # fmt: skip
from thalweg.calibration.markers.mark_block import Block
from thalweg.calibration.markers.ray_resection import pose_from_rays
from thalweg.calibration.markers.sheets import mark_name, parse_mark
from thalweg.core.adjustment.solve import Adjusted, UnobservableError
from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayB, ArrayF

Rejected = tuple[str, str, str]
"""What (image, marker, point, scale bar), its name, the reason."""

LEAST_RAYS: Final = 3
"""Pictures of a point: with two, a wrong mark moves the point and nothing shows it."""
LEAST_MARKS: Final = 8
"""Used marks of a picture: two markers."""
LEAST_KNOWN_MARKS: Final = 6
"""Used marks of a picture if its points are known: six observations more than the pose has unknowns."""
REJECT_SIGMAS: Final = 4.5
"""Two of 20,000 good marks of two coordinates are lost."""
_DOUBT_SIGMAS: Final = 3.3
_CONTRADICT: Final = "three pictures that contradict each other"
_BAD_SHARE: Final = 0.4
_WRONG_CORNERS: Final = 3
_ROUNDS: Final = 40
_READMITTING: Final = 8
_WELL: Final = 0.6
"""Share of near marks below which the pose of a picture is doubted."""
_NEAR_RAD: Final = 0.005
_AGAIN: Final = 3
_GROSS: Final = 8.0
"""Standardised residual beyond which a mark does not take part at first."""


def clean(
    problem: Problem, x: State, few: set[int] | None = None
) -> tuple[Problem, Adjusted[State], Layout, list[Rejected]]:
    """Scale the sigmas of marks to what they are, and find what does not fit, until all the rest does.

    Parameters
    ----------
    problem, x : the bundle and approximate values.
    few : markers for which two pictures are enough: that of the antenna, which is seen from above only.

    Returns
    -------
    The problem without wrong pictures and markers, with ``used`` marks, the last adjustment and its layout,
    and what was rejected as (what, name, reason).
    """
    rejected: list[Rejected] = []
    x = settle(problem, x)
    again = _reposed(problem, x)
    if again is not None:
        x = settle(problem, again)
    problem = _rescaled(problem, _robust_factor(problem, x))
    problem = replace(problem, used=mark_lengths(problem, x) < _GROSS)
    limit = float(chi2.isf(chi2.sf(REJECT_SIGMAS**2, 1), 2))
    stable, weak = False, np.zeros(len(problem.block.points), bool)
    for turn in range(_ROUNDS):
        # whole pictures and markers are judged only when single marks have settled
        images, points, reasons = _culprits(problem.block, problem.used, judge=stable)
        if stable:
            points &= ~weak
            reasons += [
                ("point", mark_name(*problem.block.points[p]), _CONTRADICT) for p in np.flatnonzero(weak)
            ]
        rejected += reasons
        before = problem
        problem, x, lost = thinned(problem, x, images, points, few or set(), doubt=stable)
        rejected += _told(before, lost)
        adjusted, layout = _solved(problem, x)
        x = adjusted.x
        if stable and not reasons and not lost:
            break
        tests = mark_tests(problem, layout, adjusted)
        used = problem.used & ~_worst_of_point(problem, tests, limit)
        if turn < _READMITTING:
            # a mark that was rejected in bad company may come back, but not to and fro for ever
            used |= ~problem.used & (tests < limit)
        stable = bool((used == problem.used).all())
        problem = replace(problem, used=used)
        if stable:
            weak = _contradicting(problem, tests)
    factor = {k: np.sqrt(s) for k, s in _sigma0_squared(problem, adjusted).items()}
    return _rescaled(problem, factor), adjusted, layout, rejected


def _solved(problem: Problem, x: State) -> tuple[Adjusted[State], Layout]:
    """`solve`; pictures that few marks tie to the rest need the long steps of `settle` before."""
    for _ in range(_AGAIN):
        try:
            return solve(problem, x)
        except UnobservableError:
            raise
        except GeometryError:
            x = settle(problem, x, steps=20)
    return solve(problem, x)


def _reposed(problem: Problem, x: State) -> State | None:
    """The state with pictures resected anew that fit badly when the others have settled, or None."""
    block = problem.block
    lengths = mark_lengths(problem, x)
    near = lengths < _GROSS * max(1.0, float(np.median(lengths)))
    n = len(block.images)
    share = np.bincount(block.image[near], minlength=n) / np.maximum(np.bincount(block.image, minlength=n), 1)
    good = near & (share[block.image] >= _WELL)
    known = np.bincount(block.point[good], minlength=len(block.points)) >= 2
    if problem.control is not None:
        known[problem.control.at] = True
    R, C, changed = x.R.copy(), x.C.copy(), False
    for i in np.flatnonzero(share < _WELL):
        mine = np.flatnonzero((block.image == i) & known[block.point])
        rays = x.cameras[problem.camera[i]].rays(block.xy_px[mine])
        mine, rays = mine[np.isfinite(rays).all(axis=1)], rays[np.isfinite(rays).all(axis=1)]
        if len(mine) < LEAST_MARKS or len(set(block.marker[mine])) < 2:
            continue
        try:
            there, markers = x.X[block.point[mine]], block.marker[mine]
            pose, angles = pose_from_rays(there, rays, markers, cap_rad=_NEAR_RAD)
        except GeometryError:
            continue
        if (angles < _NEAR_RAD).mean() > max(_WELL, share[i]):
            R[i], C[i], changed = pose.R, pose.shift_m, True
    return State(x.cameras, R, C, x.X) if changed else None


def _contradicting(problem: Problem, tests: ArrayF) -> ArrayB:
    """Points of three pictures that hardly agree: if one of them is wrong, nothing tells which."""
    block, n = problem.block, len(problem.block.points)
    rays = np.bincount(block.point[problem.used], minlength=n)
    doubtful = problem.used & (tests > float(chi2.isf(chi2.sf(_DOUBT_SIGMAS**2, 1), 2)))
    weak = (np.bincount(block.point[doubtful], minlength=n) > 0) & (rays <= LEAST_RAYS)
    if problem.control is not None:
        weak[problem.control.at] = False
    return weak


def _told(problem: Problem, lost: list[Rejected]) -> list[Rejected]:
    """What was lost, with one reason for a marker that was lost because it is off as a whole."""
    markers = {parse_mark(name)[0] for what, name, _ in lost if what == "point"}
    whole: dict[int, str] = {}
    for marker in sorted(markers):
        wrong = _whole_off(problem.block, problem.used, marker)
        if wrong.sum() >= 2:
            whole[marker] = _moved_words(problem.block, wrong)
    rest = [r for r in lost if r[0] != "point" or parse_mark(r[1])[0] not in whole]
    return [*rest, *(("marker", str(marker), reason) for marker, reason in whole.items())]


def _whole_off(block: Block, used: ArrayB, marker: int) -> ArrayB:
    """(i,) pictures in which most corners of a marker do not fit.

    Single wrong marks fall on any corner; a sheet that stands elsewhere is wrong as a whole.
    """
    mine = block.marker == marker
    return np.bincount(block.image[mine & ~used], minlength=len(block.images)) >= _WRONG_CORNERS


def _moved_words(block: Block, wrong: ArrayB) -> str:
    where = f"as a whole off in {wrong.sum()} pictures, so in {_few(block.images, wrong)}"
    return f"{where}: it was moved, or its id exists twice"


def _few(names: tuple[str, ...], chosen: ArrayB) -> str:
    some = [name for name, k in zip(names, chosen, strict=True) if k]
    return ", ".join(some[:3]) + (" ..." if len(some) > 3 else "")


def _worst_of_point(problem: Problem, tests: ArrayF, limit: float) -> ArrayB:
    """Used marks beyond the limit, of each point only the worst: a wrong mark makes others look wrong."""
    beyond = np.flatnonzero(problem.used & (tests > limit))
    order = beyond[np.lexsort((-tests[beyond], problem.block.point[beyond]))]
    first = np.unique(problem.block.point[order], return_index=True)[1]
    worst = np.zeros(len(tests), bool)
    worst[order[first]] = True
    return worst


def thinned(
    problem: Problem, x: State, images: ArrayB, points: ArrayB, few: set[int], *, doubt: bool
) -> tuple[Problem, State, list[Rejected]]:
    """Without points of too few pictures and pictures of too few marks, until all have enough.

    With ``doubt`` a point that has lost a mark needs one picture more: of four rays with a wrong one, any
    other three fit as well as the right three.
    """
    block = problem.block
    keep_points = points & np.isfinite(x.X).all(axis=1)
    keep_images = images.copy()
    known = np.zeros(len(block.points), bool)
    if problem.control is not None:
        known[problem.control.at] = True
    least = np.array([2 if p[0] in few else LEAST_RAYS for p in block.points])
    least_marks = LEAST_MARKS if problem.control is None else LEAST_KNOWN_MARKS
    markers = np.array([p[0] for p in block.points], np.int64)
    lost_marks = ~problem.used & ~np.isin(markers[block.point], list(few)) if doubt else problem.used & False
    while True:
        alive = problem.used & keep_points[block.point] & keep_images[block.image]
        rays = np.bincount(block.point[alive], minlength=len(block.points))
        seen = np.bincount(block.image[alive], minlength=len(block.images))
        doubted = (
            np.bincount(block.point[lost_marks & keep_images[block.image]], minlength=len(block.points)) > 0
        )
        next_points = keep_points & (known | (rays >= least + doubted))
        pairs = np.unique(np.stack([block.image[alive], markers[block.point[alive]]]), axis=1)
        sheets = np.bincount(pairs[0], minlength=len(block.images))
        next_images = keep_images & (seen >= least_marks) & (sheets >= 2)
        if (next_points == keep_points).all() and (next_images == keep_images).all():
            break
        keep_points, keep_images = next_points, next_images
    lost = [
        ("point", mark_name(*block.points[p]), f"fewer than {least[p] + doubted[p]} good pictures")
        for p in np.flatnonzero(~keep_points & points)
    ]
    lost += [
        ("image", block.images[i], f"fewer than {least_marks} good marks on two markers")
        for i in np.flatnonzero(images & ~keep_images)
    ]
    if keep_images.sum() < (1 if problem.control is not None else LEAST_RAYS):
        raise GeometryError(
            f"{int(keep_images.sum())} usable pictures of the field, of {len(keep_images)}",
            expected=f"at least {LEAST_RAYS}, better 20, from all sides",
            cure="Take more pictures; each needs two markers or more that two others show, too",
        )
    smaller, x = reduced(problem, x, keep_points, keep_images)
    return smaller, x, lost


def _culprits(block: Block, used: ArrayB, *, judge: bool) -> tuple[ArrayB, ArrayB, list[Rejected]]:
    """Pictures and markers of which so many marks do not fit that they as a whole are wrong."""
    reasons: list[Rejected] = []
    images = np.ones(len(block.images), bool)
    points = np.ones(len(block.points), bool)
    if not judge:
        return images, points, reasons
    markers = np.array([p[0] for p in block.points], np.int64)
    for i, name in enumerate(block.images):
        mine = used[block.image == i]
        if len(mine) and (~mine).mean() > _BAD_SHARE:
            images[i] = False
            reason = f"{(~mine).sum()} of {len(mine)} marks do not fit: blurred, or of another field"
            reasons.append(("image", name, reason))
    alive = images[block.image]
    for marker in np.unique(markers):
        wrong = _whole_off(block, used, int(marker)) & images
        seen = len(set(block.image[alive & (block.marker == marker)]))
        if wrong.sum() >= 2 and wrong.sum() > _BAD_SHARE / 2 * seen:
            points[markers == marker] = False
            reasons.append(("marker", str(marker), _moved_words(block, wrong)))
    return images, points, reasons


def _robust_factor(problem: Problem, x: State) -> dict[int, float]:
    """By camera, what the sigmas of marks must be multiplied with, from the median of the residuals."""
    block = problem.block
    lengths = mark_lengths(problem, x)
    camera = problem.camera[block.image]
    # the median residual is short by what the unknowns take
    unknowns = 6 * len(block.images) + 3 * len(block.points)
    spare = np.sqrt(max(0.1, 1.0 - unknowns / (2 * len(lengths))))
    return {
        k: max(0.05, float(np.median(lengths[camera == k])) / np.sqrt(chi2.median(2)) / spare)
        for k in np.unique(camera).tolist()
    }


def _rescaled(problem: Problem, factor: dict[int, float]) -> Problem:
    camera = problem.camera[problem.block.image]
    scale = np.array([factor[k] for k in range(max(factor) + 1) if k in factor])
    place = {k: i for i, k in enumerate(sorted(factor))}
    sigma = problem.block.sigma_px * scale[[place[k] for k in camera.tolist()]]
    return replace(problem, block=replace(problem.block, sigma_px=sigma))


def _sigma0_squared(problem: Problem, adjusted: Adjusted[State]) -> dict[int, float]:
    """By camera, sum of squared standardised residuals of used marks over their share of the redundancy."""
    squares = np.square(adjusted.standardised[MARKS])
    camera = problem.camera[problem.block.image[problem.used]]
    share = adjusted.group_redundancy[MARKS] / (2 * len(squares))
    return {
        k: float(squares[camera == k].sum() / (2 * (camera == k).sum() * share))
        for k in np.unique(camera).tolist()
    }
