"""Self-calibrating bundle adjustment of marker pictures: points, poses and interior orientations at once.

Collinearity in the form of P1 eq. 1, ``x_ccs = R_pcs_ccs^T (x_pcs - x_pcs_ccs)``, and a lens model of
`thalweg.core.camera`. Unknowns are the chosen parameters of each camera, six of each picture (shift and
rotation vector of ``T_pcs_ccs`` in pcs) and three of each point. The datum comes from inner constraints on
the points (free network: three shifts, three rotations, and the scale where no scale bar gives it), or from
control points with their joint covariance.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np
from scipy import linalg, sparse
from scipy.stats import chi2

from thalweg.calibration import Block, collinear, mark_name, parse_mark
from thalweg.calibration.field.rays import pose_from_rays
from thalweg.core import (
    Adjusted,
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayI,
    Camera,
    GeometryError,
    Linear,
    Observations,
    Rigid,
    UnobservableError,
    adjust,
    cross_matrix,
    exp_rotation,
    normal_equations,
)

MARKS: Final = "marks"
BARS: Final = "scale bars"
CONTROL: Final = "control points"
INTERIOR: Final = "interior orientation"
_NO_IMAGE_PX: Final = 1e4
"""Residual of a point that a trial step has put behind its camera: the step is then taken back."""
_DAMPING: Final = 1e-6
POSE_NAMES: Final = ("x", "y", "z", "rx", "ry", "rz")

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
_CURE: Final = (
    "Take more pictures of the field: from all sides, at two heights, and some with the camera turned by 90 "
    "degrees about its view"
)


# ---------------------------------------------------------------- adjustment


@dataclass(frozen=True, slots=True)
class State:
    """Cameras, rotations (i, 3, 3) and projection centres (i, 3) of ``T_pcs_ccs``, points (p, 3) in pcs."""

    cameras: tuple[Camera, ...]
    R: ArrayF
    C: ArrayF
    X: ArrayF


@dataclass(frozen=True, slots=True)
class Bar:
    """A known distance between two points, by their indices."""

    name: str
    start: int
    end: int
    length_m: float
    sigma_m: float


@dataclass(frozen=True)
class Control:
    """Points with known coordinates: indices (n,), (n, 3) in pcs, joint covariance (3n, 3n)."""

    at: ArrayI
    points_pcs: ArrayF
    cov: ArrayF

    @cached_property
    def whitening(self) -> ArrayF:
        """(3n, 3n) ``W`` with ``W cov W^T = 1``."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.cov)))

    @cached_property
    def information(self) -> ArrayF:
        """(3n, 3n) inverse of the covariance."""
        return np.asarray(self.whitening.T @ self.whitening)


@dataclass(frozen=True, slots=True)
class Problem:
    """One bundle: marks of pictures and points that take part, and what fixes scale and datum.

    ``free`` names, for each camera, the parameters to estimate; others keep their values. With ``weighted`` a
    camera's own covariance enters as an observation of those parameters of which it knows something.
    """

    block: Block
    camera: ArrayI
    """(i,) index of the camera of each picture."""
    used: ArrayB
    """(m,) marks that take part."""
    free: tuple[tuple[str, ...], ...]
    bars: tuple[Bar, ...] = ()
    control: Control | None = None
    weighted: bool = False
    tied: Mapping[str, ArrayF] = field(default_factory=dict)
    """Unknowns in ``free`` that move several parameters of a lens: (k,) change of these by each."""
    cov_known: ArrayF | None = None
    """(p, 3, 3) covariances of points that are no unknowns: they count in those of the marks."""

    @property
    def known(self) -> ArrayB:
        """(p,) control points."""
        at = () if self.control is None else self.control.at
        return np.isin(np.arange(len(self.block.points)), at)


class Layout:
    """Places of the unknowns in the vector: cameras, pictures, points."""

    def __init__(self, problem: Problem, cameras: Sequence[Camera]) -> None:
        self.change: list[ArrayF] = []
        """For each camera (k, f) how its parameters follow its unknowns, which stand at ``lens``."""
        self.lens: list[slice] = []
        self.at_camera: list[dict[int, int]] = []
        """For each camera the unknown of each of its parameters that has one of its own."""
        names: list[str] = []
        for camera, free in zip(cameras, problem.free, strict=True):
            own = dict(zip(camera.parameter_names, np.eye(len(camera.parameters)), strict=True))
            change = [problem.tied[name] if name in problem.tied else own[name] for name in free]
            self.change.append(np.array(change).reshape(-1, len(camera.parameters)).T)
            self.lens.append(slice(len(names), len(names) + len(free)))
            order = {name: p for p, name in enumerate(camera.parameter_names)}
            self.at_camera.append({order[n]: len(names) + k for k, n in enumerate(free) if n in order})
            names += [f"{camera.name} {name}" for name in free]
        self.poses = len(names)
        names += [f"{image} {part}".strip() for image in problem.block.images for part in POSE_NAMES]
        self.points = len(names)
        if problem.cov_known is None:
            names += [f"{m}/{c} {axis}" for m, c in problem.block.points for axis in "xyz"]
        self.names = tuple(names)

    def pose(self, image: int) -> slice:
        """Unknowns of a picture."""
        return slice(self.poses + 6 * image, self.poses + 6 * image + 6)

    def point(self, point: int) -> slice:
        """Unknowns of a point."""
        return slice(self.points + 3 * point, self.points + 3 * point + 3)


def solve(
    problem: Problem, start: State, *, robust_sigmas: float | None = None, cure: str = _CURE
) -> tuple[Adjusted[State], Layout]:
    """Adjust one bundle.

    Parameters
    ----------
    problem : the bundle.
    start : approximate values, among which `robust_start` has found the way.
    robust_sigmas : begin with Huber's weights, and leave out marks that are off by so many sigmas; None: no.
    cure : what the user can do if unknowns are undetermined.

    Raises
    ------
    UnobservableError : the pictures do not determine an unknown, which is named.
    GeometryError : too few marks, or no convergence.
    """
    layout = Layout(problem, start.cameras)

    def inner(x: State) -> ArrayF:
        """Constraints of a free network at a state."""
        return inner_constraints(x.X, layout, scale=not problem.bars)

    adjusted = adjust(
        _groups(problem, layout, start.cameras),
        start,
        layout.names,
        update=lambda x, dx: moved(x, dx, layout),
        loss=None if robust_sigmas is None else "huber",
        reject_sigmas=robust_sigmas,
        inner_constraints=inner if problem.control is None and problem.cov_known is None else None,
        max_iterations=60 if robust_sigmas is None else 200,
        cure=cure,
    )
    return adjusted, layout


def robust_start(problem: Problem, x: State, steps: int = 40) -> State:
    """Come near the solution in spite of many wrong marks.

    Gauss-Newton steps with weights that fall to zero (Geman and McClure 1985), whose width follows the
    median of the residuals down to the stated sigmas. Huber's weights never let go of a blunder and need
    hundreds of steps.
    """
    layout = Layout(problem, x.cameras)
    nominal = x.cameras
    width = np.inf
    for _ in range(steps):
        marks, *others = _groups(problem, layout, nominal)
        part = marks.model(x)
        sigma = problem.block.sigma_px[problem.used]
        length = np.linalg.norm(part.residual.reshape(-1, 2), axis=1) / sigma
        # slowly: a part of the block that still hangs askew must not be taken for wrong marks
        width = max(
            4.0, 4.0 * float(np.median(length)), 0.5 * min(width, 2.0 * float(np.quantile(length, 0.9)))
        )
        weight = 1.0 / (1.0 + np.square(length / width)) / sigma
        rows = sparse.diags_array(np.repeat(weight, 2)) @ part.jacobian
        all_but_marks = normal_equations(others, x, len(layout.names), [None] * len(others), None)
        N = all_but_marks.N + (rows.T @ rows).toarray()
        n = all_but_marks.n + rows.T @ (part.residual * np.repeat(weight, 2))
        scale = np.sqrt(np.maximum(np.diag(N), 1e-30))
        Ns = N / np.outer(scale, scale) + _DAMPING * np.eye(len(N))
        if problem.control is None:
            G = inner_constraints(x.X, layout, scale=not problem.bars) / scale
            Q = np.linalg.qr(G.T)[0]
            Ns += Q @ Q.T
        dx = -linalg.cho_solve(linalg.cho_factor(Ns, overwrite_a=True), n / scale) / scale
        x = moved(x, dx, layout)
        if float(np.abs(dx * scale).max()) < 0.1 and width <= 8.0:
            break
    return x


def mark_lengths(problem: Problem, x: State) -> ArrayF:
    """(m,) lengths of the residuals of all marks in units of their sigma."""
    part = marks_model(problem, Layout(problem, x.cameras), x, np.ones_like(problem.used))
    return np.asarray(np.linalg.norm(part.residual.reshape(-1, 2), axis=1) / problem.block.sigma_px)


def mark_tests(problem: Problem, layout: Layout, adjusted: Adjusted[State]) -> ArrayF:
    """(m,) squared residuals of all marks in units of their own covariance: chi-square, 2 degrees of freedom.

    A used mark has pulled the solution to itself, its residual has the covariance ``S - J C J^T``; that of
    one left out has ``S + J C J^T``.
    """
    part = marks_model(problem, layout, adjusted.x, np.ones_like(problem.used))
    rows = part.jacobian
    product = np.asarray(rows @ adjusted.cov)
    m = len(problem.used)
    blocks = np.empty((m, 2, 2))
    for a in range(2):
        for b in range(2):
            blocks[:, a, b] = np.asarray(rows[b::2].multiply(product[a::2]).sum(axis=1)).ravel()
    Q = part.cov + np.where(problem.used, -1.0, 1.0)[:, None, None] * blocks
    # a mark that hardly anything checks has next to no residual and no test
    low = 0.02 * np.square(problem.block.sigma_px)
    Q += np.maximum(low - np.linalg.eigvalsh(Q)[:, 0], 0.0)[:, None, None] * np.eye(2)
    v = part.residual.reshape(-1, 2, 1)
    return np.asarray((v * np.linalg.solve(Q, v)).sum(axis=(1, 2)))


def _groups(problem: Problem, layout: Layout, nominal: Sequence[Camera]) -> list[Observations[State]]:
    groups: list[Observations[State]] = [Observations(MARKS, lambda x: marks_model(problem, layout, x))]
    if problem.bars:
        groups.append(Observations(BARS, lambda x: bars_model(problem.bars, layout, x)))
    if problem.control is not None:
        control = problem.control
        groups.append(Observations(CONTROL, lambda x: _control(control, layout, x)))
    if problem.weighted:
        groups.append(Observations(INTERIOR, lambda x: _interior(problem, layout, nominal, x)))
    return groups


def moved(x: State, dx: ArrayF, layout: Layout) -> State:
    """The state with a small change of the unknowns put on."""
    cameras = []
    for camera, change, lens in zip(x.cameras, layout.change, layout.lens, strict=True):
        p = camera.parameters + change @ dx[lens]
        # a wild trial step may not turn a focal length round
        p[:2] = np.maximum(p[:2], 0.05 * camera.parameters[:2])
        cameras.append(camera.with_parameters(p))
    poses = dx[layout.poses : layout.points].reshape(-1, 6)
    return State(
        tuple(cameras),
        exp_rotation(poses[:, 3:]) @ x.R,
        x.C + poses[:, :3],
        x.X + dx[layout.points :].reshape(-1, 3) if layout.points < len(layout.names) else x.X,
    )


def marks_model(problem: Problem, layout: Layout, x: State, rows: ArrayB | None = None) -> Linear:
    """Residuals (computed minus observed) of marks: of those used, or of ``rows`` (m,)."""
    block = problem.block
    chosen = problem.used if rows is None else rows
    image, point = block.image[chosen], block.point[chosen]
    camera = problem.camera[image]
    seen = collinear(x.cameras, camera, x.R[image], x.C[image], x.X[point])
    residual = seen.xy_px - block.xy_px[chosen]
    m, f = len(image), max(change.shape[1] for change in layout.change)
    by_lens, columns = np.zeros((m, 2, f)), np.zeros((m, f), np.int64)
    for number, change in enumerate(layout.change):
        own, (k, n) = camera == number, change.shape
        by_lens[own, :, :n] = seen.by_camera[own, :, :k] @ change
        columns[own, :n] = layout.lens[number].start + np.arange(n)
    parts = [by_lens, seen.by_pose]
    at = [columns, layout.poses + 6 * image[:, None] + np.arange(6)]
    if problem.cov_known is None:
        parts.append(seen.by_point)
        at.append(layout.points + 3 * point[:, None] + np.arange(3))
    values, columns = np.concatenate(parts, axis=2), np.concatenate(at, axis=1)
    lost = ~np.isfinite(residual).all(axis=1) | ~np.isfinite(values).all(axis=(1, 2))
    residual[lost], values[lost] = _NO_IMAGE_PX, 0.0
    n = values.shape[2]
    entries = values.reshape(2 * m, -1).ravel(), np.repeat(columns, 2, axis=0).ravel()
    J = sparse.csr_array((*entries, np.arange(2 * m + 1) * n), shape=(2 * m, len(layout.names)))
    cov = np.square(block.sigma_px[chosen])[:, None, None] * np.eye(2)
    if problem.cov_known is None:
        return Linear(residual=residual.ravel(), jacobian=J, cov=cov)
    seen.by_point[lost] = 0.0
    cov = seen.by_point @ problem.cov_known[point] @ np.swapaxes(seen.by_point, 1, 2) + cov
    # one picture alone has few unknowns, for which a plain matrix is faster
    return Linear(residual=residual.ravel(), jacobian=J.toarray() if len(block.images) == 1 else J, cov=cov)


def bars_model(bars: tuple[Bar, ...], layout: Layout, x: State) -> Linear:
    """Lengths between the ends of scale bars less those of their certificates."""
    J = np.zeros((len(bars), len(layout.names)))
    residual = np.empty(len(bars))
    for k, bar in enumerate(bars):
        d = x.X[bar.end] - x.X[bar.start]
        length = float(np.linalg.norm(d))
        residual[k] = length - bar.length_m
        J[k, layout.point(bar.end)], J[k, layout.point(bar.start)] = d / length, -d / length
    return Linear(residual=residual, jacobian=J, cov=np.square([bar.sigma_m for bar in bars]))


def _control(control: Control, layout: Layout, x: State) -> Linear:
    """Control points in units of their joint covariance; dense, because that couples all of them."""
    columns = (layout.points + 3 * control.at[:, None] + np.arange(3)).ravel()
    J = np.zeros((len(columns), len(layout.names)))
    J[:, columns] = control.whitening
    off = (x.X[control.at] - control.points_pcs).ravel()
    normal = np.zeros((len(layout.names),) * 2)
    normal[np.ix_(columns, columns)] = control.information
    return Linear(residual=control.whitening @ off, jacobian=J, cov=np.ones(len(columns)), normal=normal)


def _interior(problem: Problem, layout: Layout, nominal: Sequence[Camera], x: State) -> Linear:
    """The interior orientation of each camera as an observation, as far as it is known and sought."""
    parts, rows, covs = [], [], []
    for camera, known, change, lens in zip(x.cameras, nominal, layout.change, layout.lens, strict=True):
        at = np.flatnonzero((np.diag(known.cov) > 0) & change.any(axis=1))
        J = np.zeros((len(at), len(layout.names)))
        J[:, lens] = change[at]
        rows.append(J)
        parts.append((camera.parameters - known.parameters)[at])
        covs.append(known.cov[np.ix_(at, at)])
    return Linear(
        residual=np.concatenate(parts), jacobian=np.concatenate(rows), cov=linalg.block_diag(*covs)[None]
    )


def inner_constraints(points: ArrayF, layout: Layout, *, scale: bool) -> ArrayF:
    """(6 or 7, u) constraints on the points: no shift, rotation (and scale) of their change on average."""
    n = len(points)
    away = points - points.mean(axis=0)
    away = away / np.sqrt((away**2).sum() / n)
    G = np.zeros((7 if scale else 6, len(layout.names)))
    part: AnyArray = np.zeros((n, 3, len(G)))
    part[:, :, :3] = np.eye(3)
    part[:, :, 3:6] = cross_matrix(away)
    if scale:
        part[:, :, 6] = away
    G[:, layout.points :] = part.reshape(3 * n, -1).T
    return G


def start_state(
    problem_images: Sequence[str], cameras: Sequence[Camera], poses: Mapping[int, Rigid], X: ArrayF
) -> State:
    """State from approximate poses by index of the picture, and points."""
    T = [poses[i] for i in range(len(problem_images))]
    return State(tuple(cameras), np.stack([t.R for t in T]), np.stack([t.shift_m for t in T]), X)


def transformed(x: State, scale: float, T: Rigid) -> State:
    """The state in another frame: ``x_new = R (scale x) + shift``."""
    return State(x.cameras, T.R @ x.R, T.apply(scale * x.C), T.apply(scale * x.X))


def reduced(problem: Problem, x: State, points: ArrayB, images: ArrayB) -> tuple[Problem, State]:
    """The problem with some points (p,) and images (i,) kept, indices closed up.

    Raises
    ------
    GeometryError : a scale bar or control point has lost its points.
    """
    b = problem.block
    keep = points[b.point] & images[b.image]
    new_point, new_image = np.cumsum(points) - 1, np.cumsum(images) - 1
    block = b.taken(keep)
    block = replace(
        block,
        images=tuple(n for n, k in zip(b.images, images, strict=True) if k),
        camera_of=tuple(n for n, k in zip(b.camera_of, images, strict=True) if k),
        points=tuple(p for p, k in zip(b.points, points, strict=True) if k),
        image=new_image[block.image],
        point=new_point[block.point],
    )
    for bar in problem.bars:
        for end in (bar.start, bar.end):
            if not points[end]:
                marker, corner = b.points[end]
                raise GeometryError(
                    f"the end {marker}/{corner} of the scale bar {bar.name} has too few pictures",
                    expected="both ends in at least three good pictures",
                    cure="Take more pictures of the bar, or leave it out of the field description",
                )
    bars = tuple(
        replace(bar, start=int(new_point[bar.start]), end=int(new_point[bar.end])) for bar in problem.bars
    )
    control = problem.control
    if control is not None:
        stay = points[control.at]
        rows = np.repeat(stay, 3)
        control = Control(
            new_point[control.at[stay]], control.points_pcs[stay], control.cov[np.ix_(rows, rows)]
        )
    smaller = replace(
        problem,
        block=block,
        camera=problem.camera[images],
        used=problem.used[keep],
        bars=bars,
        control=control,
    )
    return smaller, State(x.cameras, x.R[images], x.C[images], x.X[points])


# ---------------------------------------------------------------- wrong image points, points, markers and
# images, each with its reason


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
    x = robust_start(problem, x)
    again = _reposed(problem, x)
    if again is not None:
        x = robust_start(problem, again)
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
        rejected += _losses_in_words(before, lost)
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
    return _rescaled(problem, _sigma0(problem, adjusted)), adjusted, layout, rejected


def _solved(problem: Problem, x: State) -> tuple[Adjusted[State], Layout]:
    """`solve`; pictures that few marks tie to the rest need the long steps of `robust_start` before."""
    for _ in range(_AGAIN):
        try:
            return solve(problem, x)
        except UnobservableError:
            raise
        except GeometryError:
            x = robust_start(problem, x, steps=20)
    return solve(problem, x)


def _reposed(problem: Problem, x: State) -> State | None:
    """The state with pictures resected anew that fit badly when the others have settled, or None."""
    block = problem.block
    lengths = mark_lengths(problem, x)
    near = lengths < _GROSS * max(1.0, float(np.median(lengths)))
    n = len(block.images)
    share = np.bincount(block.image[near], minlength=n) / np.maximum(np.bincount(block.image, minlength=n), 1)
    good = near & (share[block.image] >= _WELL)
    known = problem.known | (np.bincount(block.point[good], minlength=len(block.points)) >= 2)
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
    return (np.bincount(block.point[doubtful], minlength=n) > 0) & (rays <= LEAST_RAYS) & ~problem.known


def _losses_in_words(problem: Problem, lost: list[Rejected]) -> list[Rejected]:
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
    known = problem.known
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
    scale = np.array([factor.get(k, 1.0) for k in range(max(factor) + 1)])
    sigma = problem.block.sigma_px * scale[problem.camera[problem.block.image]]
    return replace(problem, block=replace(problem.block, sigma_px=sigma))


def _sigma0(problem: Problem, adjusted: Adjusted[State]) -> dict[int, float]:
    """By camera, sum of squared standardised residuals of used marks over their share of the redundancy."""
    squares = np.square(adjusted.standardised[MARKS])
    camera = problem.camera[problem.block.image[problem.used]]
    share = adjusted.group_redundancy[MARKS] / (2 * len(squares))
    return {
        k: float(np.sqrt(squares[camera == k].sum() / (2 * (camera == k).sum() * share)))
        for k in np.unique(camera).tolist()
    }
