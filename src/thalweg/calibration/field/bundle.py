"""Self-calibrating bundle adjustment of marker pictures: points, poses and interior orientations at once.

Collinearity in the form of P1 eq. 1, ``x_ccs = R_pcs_ccs^T (x_pcs - x_pcs_ccs)``, and a lens model of
`thalweg.core.camera.model`. Unknowns are the chosen parameters of each camera, six of each picture (shift and
rotation vector of ``T_pcs_ccs`` in pcs) and three of each point. The datum comes from inner constraints on
the points (free network: three shifts, three rotations, and the scale where no scale bar gives it), or from
control points with their joint covariance.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from scipy import sparse

from thalweg.calibration.markers.mark_block import Block
from thalweg.core.adjustment.solve import Adjusted, Linear, Observations, adjust
from thalweg.core.camera.model import Camera
from thalweg.core.errors import GeometryError
from thalweg.core.propagation import cross_matrix
from thalweg.core.rigid import Rigid, exp_rotation
from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayI

MARKS: Final = "marks"
BARS: Final = "scale bars"
CONTROL: Final = "control points"
INTERIOR: Final = "interior orientation"
_NO_IMAGE_PX: Final = 1e4
"""Residual of a point that a trial step has put behind its camera: the step is then taken back."""
_DAMPING: Final = 1e-6
POSE_NAMES: Final = ("x", "y", "z", "rx", "ry", "rz")


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


@dataclass(frozen=True, slots=True)
class Problem:
    """One bundle: marks of pictures and points that take part, and what fixes scale and datum.

    ``free`` names, for each camera, the parameters to estimate; others keep their values. With ``weighted`` a
    camera's own covariance enters as an observation of its parameters.
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


class Layout:
    """Places of the unknowns in the vector: cameras, pictures, points."""

    def __init__(self, problem: Problem, cameras: Sequence[Camera]) -> None:
        self.at_camera: list[dict[int, int]] = []
        names: list[str] = []
        for camera, free in zip(cameras, problem.free, strict=True):
            places = [camera.parameter_names.index(name) for name in free]
            self.at_camera.append({p: len(names) + k for k, p in enumerate(places)})
            names += [f"{camera.name} {name}" for name in free]
        self.poses = len(names)
        names += [f"{image} {part}" for image in problem.block.images for part in POSE_NAMES]
        self.points = len(names)
        names += [f"{m}/{c} {axis}" for m, c in problem.block.points for axis in "xyz"]
        self.names = tuple(names)

    def camera_columns(self, k: int, n: int) -> tuple[ArrayI, ArrayF]:
        """Column of each of n parameters of camera k, and 1 for estimated, 0 for fixed ones."""
        at = self.at_camera[k]
        columns = np.array([at.get(p, 0) for p in range(n)], np.int64)
        return columns, np.array([float(p in at) for p in range(n)])

    def pose(self, image: int) -> slice:
        """Unknowns of a picture."""
        return slice(self.poses + 6 * image, self.poses + 6 * image + 6)

    def point(self, point: int) -> slice:
        """Unknowns of a point."""
        return slice(self.points + 3 * point, self.points + 3 * point + 3)


def solve(problem: Problem, start: State, *, max_iterations: int = 60) -> tuple[Adjusted[State], Layout]:
    """Adjust one bundle from approximate values among which `settle` has found the way.

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
        inner_constraints=inner if problem.control is None else None,
        max_iterations=max_iterations,
        cure="Take more pictures of the field: from all sides, at two heights, and some with the camera "
        "turned by 90 degrees about its view",
    )
    return adjusted, layout


def settle(problem: Problem, x: State, steps: int = 40) -> State:
    """Come near the solution in spite of many wrong marks.

    Gauss-Newton steps with weights that fall to zero (Geman and McClure 1985), whose width follows the
    median of the residuals down to the stated sigmas. Huber's weights never let go of a blunder and need
    hundreds of steps.
    """
    layout = Layout(problem, x.cameras)
    nominal = x.cameras
    width = np.inf
    for _ in range(steps):
        part = marks_model(problem, layout, x)
        sigma = problem.block.sigma_px[problem.used]
        length = np.linalg.norm(part.residual.reshape(-1, 2), axis=1) / sigma
        # slowly: a part of the block that still hangs askew must not be taken for wrong marks
        width = max(
            4.0, 4.0 * float(np.median(length)), 0.5 * min(width, 2.0 * float(np.quantile(length, 0.9)))
        )
        weight = 1.0 / (1.0 + np.square(length / width)) / sigma
        rows = sparse.diags_array(np.repeat(weight, 2)) @ part.jacobian
        N = np.asarray((rows.T @ rows).todense())
        n = rows.T @ (part.residual * np.repeat(weight, 2))
        for group in _groups(problem, layout, nominal)[1:]:
            other = group.model(x)
            W = np.diag(1.0 / other.cov) if other.cov.ndim == 1 else np.linalg.inv(other.cov[0])
            J = np.asarray(other.jacobian)
            N += J.T @ (W @ J)
            n += J.T @ (W @ other.residual)
        scale = np.sqrt(np.maximum(np.diag(N), 1e-30))
        Ns = N / np.outer(scale, scale) + _DAMPING * np.eye(len(N))
        if problem.control is None:
            G = inner_constraints(x.X, layout, scale=not problem.bars) / scale
            Q = np.linalg.qr(G.T)[0]
            Ns += Q @ Q.T
        dx = -np.linalg.solve(Ns, n / scale) / scale
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
        groups.append(Observations(BARS, lambda x: _bars(problem.bars, layout, x)))
    if problem.control is not None:
        control = problem.control
        groups.append(Observations(CONTROL, lambda x: _control(control, layout, x)))
    if problem.weighted:
        groups.append(Observations(INTERIOR, lambda x: _interior(problem, layout, nominal, x)))
    return groups


def moved(x: State, dx: ArrayF, layout: Layout) -> State:
    """The state with a small change of the unknowns put on."""
    cameras = []
    for camera, places in zip(x.cameras, layout.at_camera, strict=True):
        p = camera.parameters.copy()
        for parameter, column in places.items():
            p[parameter] += dx[column]
        # a wild trial step may not turn a focal length round
        p[:2] = np.maximum(p[:2], 0.05 * camera.parameters[:2])
        cameras.append(camera.with_parameters(p))
    poses = dx[layout.poses : layout.points].reshape(-1, 6)
    return State(
        tuple(cameras),
        exp_rotation(poses[:, 3:]) @ x.R,
        x.C + poses[:, :3],
        x.X + dx[layout.points :].reshape(-1, 3),
    )


def marks_model(problem: Problem, layout: Layout, x: State, rows: ArrayB | None = None) -> Linear:
    """Residuals (computed minus observed) of marks: of those used, or of ``rows`` (m,)."""
    block = problem.block
    chosen = problem.used if rows is None else rows
    return _projected(problem, layout, x, block.image[chosen], block.point[chosen], chosen)


def _projected(
    problem: Problem, layout: Layout, x: State, image: ArrayI, point: ArrayI, chosen: ArrayB
) -> Linear:
    block = problem.block
    m = len(image)
    xy_px, sigma_px = block.xy_px[chosen], block.sigma_px[chosen]
    away = x.X[point] - x.C[image]
    Rt = np.swapaxes(x.R, 1, 2)[image]
    local = np.einsum("mij,mj->mi", Rt, away)
    k = max(len(c.parameters) for c in x.cameras)
    residual = np.empty((m, 2))
    values = np.zeros((m, 2, k + 9))
    columns = np.zeros((m, k + 9), np.int64)
    by_point = np.empty((m, 2, 3))
    for number, camera in enumerate(x.cameras):
        rows = problem.camera[image] == number
        xy, by_point[rows], by_parameters = camera.project_with_derivatives(local[rows])
        residual[rows] = xy - xy_px[rows]
        n = len(camera.parameters)
        at, estimated = layout.camera_columns(number, n)
        columns[rows, :n] = at
        values[rows, :, :n] = by_parameters * estimated
    by_pcs = by_point @ Rt
    values[:, :, k : k + 3] = -by_pcs
    values[:, :, k + 3 : k + 6] = by_pcs @ cross_matrix(away)
    values[:, :, k + 6 :] = by_pcs
    columns[:, k : k + 6] = layout.poses + 6 * image[:, None] + np.arange(6)
    columns[:, k + 6 :] = layout.points + 3 * point[:, None] + np.arange(3)
    lost = ~np.isfinite(residual).all(axis=1) | ~np.isfinite(values).all(axis=(1, 2))
    residual[lost], values[lost] = _NO_IMAGE_PX, 0.0
    entries = values.reshape(2 * m, -1).ravel(), np.repeat(columns, 2, axis=0).ravel()
    J = sparse.csr_array((*entries, np.arange(2 * m + 1) * (k + 9)), shape=(2 * m, len(layout.names)))
    cov = np.square(sigma_px)[:, None, None] * np.eye(2)
    return Linear(residual=residual.ravel(), jacobian=J, cov=cov)


def _bars(bars: tuple[Bar, ...], layout: Layout, x: State) -> Linear:
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
    return Linear(residual=control.whitening @ off, jacobian=J, cov=np.ones(len(columns)))


def _interior(problem: Problem, layout: Layout, nominal: Sequence[Camera], x: State) -> Linear:
    rows = [(k, p, c) for k, at in enumerate(layout.at_camera) for p, c in at.items()]
    J = np.zeros((len(rows), len(layout.names)))
    J[np.arange(len(rows)), [c for _, _, c in rows]] = 1.0
    residual = np.array([x.cameras[k].parameters[p] - nominal[k].parameters[p] for k, p, _ in rows])
    cov = np.zeros((len(rows), len(rows)))
    for a, (k, p, _) in enumerate(rows):
        for b, (j, q, _) in enumerate(rows):
            cov[a, b] = nominal[k].cov[p, q] if k == j else 0.0
    return Linear(residual=residual, jacobian=J, cov=cov[None])


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
    block = Block(
        images=tuple(n for n, k in zip(b.images, images, strict=True) if k),
        camera_of=tuple(n for n, k in zip(b.camera_of, images, strict=True) if k),
        points=tuple(p for p, k in zip(b.points, points, strict=True) if k),
        image=new_image[b.image[keep]],
        point=new_point[b.point[keep]],
        xy_px=b.xy_px[keep],
        sigma_px=b.sigma_px[keep],
        rays=b.rays[keep],
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
