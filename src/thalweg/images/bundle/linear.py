"""Residuals and normal equations of an image block at a state."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from thalweg.core.propagation import cross_matrix
from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayI
from thalweg.images.bundle.correlation import Correlation
from thalweg.images.bundle.interior import interior_priors
from thalweg.images.bundle.kernels import add_tracks, solve_points, track_costs
from thalweg.images.bundle.problem import Layout, Problem, State

CHUNK: int = 200_000
"""Marks whose derivatives are held at once: 90 MB."""
NO_IMAGE_PX = 1e4
"""Residual of a point that a trial step has put behind its camera: the step is then taken back."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tracks:
    """Tie marks that take part, sorted by point.

    ``point`` (t,) are the points, ``first`` (t + 1,) where their marks begin, ``mark`` (m,) indices into the
    block's marks, ``image`` (m,), ``xy_px`` (m, 2), ``sigma_px`` (m,) with robust weights put in, ``view``
    (m, 4) as of `thalweg.images.bundle.correlation.views`, and ``along`` (m, 2), the unit vector of the
    parallax in the image.
    """

    point: ArrayI
    first: ArrayI
    mark: ArrayI
    image: ArrayI
    xy_px: ArrayF
    sigma_px: ArrayF
    view: ArrayF
    along: ArrayF

    def chunks(self) -> Iterator[tuple[slice, slice]]:
        """Slices of tracks and of their marks, of limited size."""
        begin = 0
        while begin < len(self.point):
            end = int(np.searchsorted(self.first, self.first[begin] + CHUNK, side="right")) - 1
            end = min(max(end, begin + 1), len(self.point))
            yield slice(begin, end), slice(int(self.first[begin]), int(self.first[end]))
            begin = end


def tracks_of(
    problem: Problem, used: ArrayB, sigma_px: ArrayF, view: ArrayF, along: ArrayF | None = None
) -> Tracks:
    """Tracks of the used marks (m,) of all points that keep at least two of them.

    ``along`` (m, 2) is the parallax of all marks; None: along the rows.
    """
    block = problem.block
    count = np.bincount(block.mark_point[used], minlength=len(block.points_block_m))
    rows = np.flatnonzero(used & (count[block.mark_point] >= 2))
    rows = rows[np.lexsort((rows, block.mark_image[rows], block.mark_point[rows]))]
    point, first = np.unique(block.mark_point[rows], return_index=True)
    return Tracks(
        point=point.astype(np.int64),
        first=np.append(first, len(rows)).astype(np.int64),
        mark=rows,
        image=block.mark_image[rows].astype(np.int64),
        xy_px=block.mark_px[rows],
        sigma_px=sigma_px[rows],
        view=view[rows],
        along=np.tile([1.0, 0.0], (len(rows), 1)) if along is None else along[rows],
    )


@dataclass(slots=True)
class Marks:
    """Linearised marks: residual (m, 2) measured minus computed, derivatives (m, 2, 6 | q | 3)."""

    residual: ArrayF
    by_pose: ArrayF
    by_rest: ArrayF
    by_point: ArrayF


def linearised(problem: Problem, layout: Layout, x: State, image: ArrayI, X: ArrayF, xy_px: ArrayF) -> Marks:
    """Marks of points ``X`` (m, 3) in images, and their derivatives.

    With ``d = X - C`` a small error turns ``R^T d`` into ``R^T (d - dx + d x dtheta + dX)``.
    """
    m, q = len(image), layout.n_interior
    d = X - x.C[image]
    Rt = np.swapaxes(x.R, 1, 2)[image]
    seen = np.einsum("mij,mj->mi", Rt, d)
    xy, by_seen, by_rest = np.empty((m, 2)), np.empty((m, 2, 3)), np.zeros((m, 2, q))
    camera = problem.block.camera[image]
    for k, (lens, at) in enumerate(zip(x.cameras, layout.interior, strict=True)):
        rows: AnyArray = np.flatnonzero(camera == k) if len(x.cameras) > 1 else np.arange(m)
        xy[rows], by_seen[rows], by_parameters = lens.project_with_derivatives(seen[rows])
        for parameter in np.flatnonzero(at >= 0):
            # tied parameters share a column
            by_rest[rows, :, at[parameter] - layout.n_poses] += by_parameters[:, :, parameter]
    by_point = by_seen @ Rt
    by_pose = np.concatenate([-by_point, by_point @ cross_matrix(d)], axis=2)
    residual = xy_px - xy
    lost = ~np.isfinite(residual).all(axis=1)
    if lost.any():
        residual[lost] = NO_IMAGE_PX
        for a in (by_pose, by_rest, by_point):
            a[lost] = 0.0
    return Marks(residual, by_pose, by_rest, by_point)


def along_and_across(part: Marks, along: ArrayF) -> Marks:
    """The same with residuals and derivatives along unit vectors (m, 2) and across them."""
    turn = _turns(along)
    return Marks(
        np.einsum("mij,mj->mi", turn, part.residual), turn @ part.by_pose, turn @ part.by_rest,
        turn @ part.by_point,
    )  # fmt: skip


def _turns(along: ArrayF) -> ArrayF:
    return np.stack([along, np.stack([-along[:, 1], along[:, 0]], axis=1)], axis=1)


@dataclass(slots=True)
class Reduced:
    """Reduced normal equations: matrix (u, u), right side (u,), square sums of the groups."""

    N: ArrayF
    g: ArrayF
    cost: dict[str, float]
    counts: dict[str, int]


def reduced_system(
    problem: Problem,
    layout: Layout,
    x: State,
    tracks: Tracks,
    model: Correlation,
    control_sigma_px: ArrayF,
    damping: float,
) -> Reduced:
    """Normal equations of all observations at a state, tie points eliminated.

    Parameters
    ----------
    control_sigma_px : (n,) standard deviations of the control marks, robust weights put in; infinite ones
        take no part.
    damping : Levenberg's share on the diagonals of the tie points.
    """
    u = len(layout.names)
    N, g = np.zeros((u, u)), np.zeros(u)
    tie = 0.0
    for which, rows in tracks.chunks():
        at = np.repeat(tracks.point[which], np.diff(tracks.first[which.start : which.stop + 1]))
        part = linearised(problem, layout, x, tracks.image[rows], x.X[at], tracks.xy_px[rows])
        part = along_and_across(part, tracks.along[rows])
        tie += add_tracks(
            tracks.first[which.start : which.stop + 1] - tracks.first[which.start],
            tracks.image[rows], part.by_pose, part.by_rest, part.by_point, part.residual,
            tracks.sigma_px[rows], tracks.view[rows], model.model, damping, layout.n_poses, N, g,
        )  # fmt: skip
    # blocks on the diagonal are filled on both sides
    N = np.triu(N)
    N += np.triu(N, 1).T
    out = Reduced(N, g, {"tie": tie}, {"tie": 2 * len(tracks.mark)})
    _add_control(problem, layout, x, control_sigma_px, out)
    _add_antenna(problem, layout, x, out)
    _add_interior(problem, layout, x, out)
    return out


def point_steps(
    problem: Problem,
    layout: Layout,
    x: State,
    tracks: Tracks,
    model: Correlation,
    damping: float,
    d: ArrayF,
) -> ArrayF:
    """(p, 3) changes of the tie points that go with the change ``d`` (u,) of the shared unknowns."""
    step = np.zeros_like(x.X)
    poses = d[: layout.n_poses].reshape(-1, 6)
    rest = d[layout.n_poses : layout.n_poses + layout.n_interior]
    for which, rows in tracks.chunks():
        first = tracks.first[which.start : which.stop + 1]
        at = np.repeat(tracks.point[which], np.diff(first))
        image = tracks.image[rows]
        part = linearised(problem, layout, x, image, x.X[at], tracks.xy_px[rows])
        part = along_and_across(part, tracks.along[rows])
        left = part.residual - np.einsum("maj,mj->ma", part.by_pose, poses[image]) - part.by_rest @ rest
        found = np.empty((which.stop - which.start, 3))
        solve_points(
            first - first[0], part.by_point, left, tracks.sigma_px[rows], tracks.view[rows], model.model,
            damping, found,
        )  # fmt: skip
        step[tracks.point[which]] = found
    return step


def cost_of(
    problem: Problem, layout: Layout, x: State, tracks: Tracks, model: Correlation, control_sigma_px: ArrayF
) -> float:
    """Weighted square sum of all observations at a state."""
    total = 0.0
    for which, rows in tracks.chunks():
        first = tracks.first[which.start : which.stop + 1]
        at = np.repeat(tracks.point[which], np.diff(first))
        xy = projected(problem, x, tracks.image[rows], x.X[at])
        residual = np.nan_to_num(tracks.xy_px[rows] - xy, nan=NO_IMAGE_PX)
        residual = np.einsum("mij,mj->mi", _turns(tracks.along[rows]), residual)
        value = np.empty(which.stop - which.start)
        track_costs(first - first[0], residual, tracks.sigma_px[rows], tracks.view[rows], model.model, value)
        total += float(value.sum())
    empty = Reduced(np.empty((0, 0)), np.empty(0), {}, {})
    _add_control(problem, layout, x, control_sigma_px, empty, derive=False)
    _add_antenna(problem, layout, x, empty, derive=False)
    _add_interior(problem, layout, x, empty, derive=False)
    return total + sum(empty.cost.values())


def projected(problem: Problem, x: State, image: ArrayI, X: ArrayF) -> ArrayF:
    """Pixels (m, 2) of points (m, 3) in images; NaN where a camera cannot see them."""
    seen = np.einsum("mji,mj->mi", x.R[image], X - x.C[image])
    if len(x.cameras) == 1:
        return x.cameras[0].project(seen)
    out = np.empty((len(image), 2))
    camera = problem.block.camera[image]
    for k, lens in enumerate(x.cameras):
        rows = np.flatnonzero(camera == k)
        out[rows] = lens.project(seen[rows])
    return out


def derivatives_by_point(problem: Problem, x: State, image: ArrayI, X: ArrayF) -> ArrayF:
    """(m, 2, 3) derivatives of the pixels of points ``X`` (m, 3) in images; 0 where a camera sees nothing."""
    Rt = np.swapaxes(x.R, 1, 2)[image]
    seen = np.einsum("mij,mj->mi", Rt, X - x.C[image])
    out = np.empty((len(image), 2, 3))
    camera = problem.block.camera[image]
    for k, lens in enumerate(x.cameras):
        rows = np.flatnonzero(camera == k)
        out[rows] = lens.project_with_derivatives(seen[rows])[1]
    return np.asarray(np.nan_to_num(out) @ Rt)


def _add_control(
    problem: Problem, layout: Layout, x: State, sigma_px: ArrayF, out: Reduced, *, derive: bool = True
) -> None:
    """Marks of control and check points, and the coordinates of control points."""
    marks, control = problem.marks, problem.control
    rows = np.flatnonzero(np.isfinite(sigma_px))
    if derive:
        q = layout.n_interior
        part = linearised(problem, layout, x, marks.image[rows], x.G[marks.point[rows]], marks.xy_px[rows])
        residual = part.residual
        J = np.concatenate([part.by_pose, part.by_rest, part.by_point], axis=2)
        for i, row in enumerate(rows):
            pose, point = 6 * int(marks.image[row]), layout.point(int(marks.point[row])).start
            at = np.concatenate(
                [np.arange(pose, pose + 6), layout.n_poses + np.arange(q), np.arange(point, point + 3)]
            )
            weighted = J[i] / sigma_px[row] ** 2
            out.N[np.ix_(at, at)] += weighted.T @ J[i]
            out.g[at] += weighted.T @ residual[i]
    else:
        xy = projected(problem, x, marks.image[rows], x.G[marks.point[rows]])
        residual = np.nan_to_num(marks.xy_px[rows] - xy, nan=NO_IMAGE_PX)
    out.cost["control marks"] = float(np.square(residual / sigma_px[rows, None]).sum())
    out.counts["control marks"] = 2 * len(rows)
    cost = 0.0
    for k in np.flatnonzero(~control.check):
        W = np.linalg.inv(control.cov_wcs_m2[k])
        off = control.points_wcs_m[k] - x.G[k]
        cost += float(off @ W @ off)
        if derive:
            own = layout.point(int(k))
            out.N[own, own] += W
            out.g[own] += W @ off
    out.cost["control points"] = cost
    out.counts["control points"] = 3 * int((~control.check).sum())


def _add_antenna(problem: Problem, layout: Layout, x: State, out: Reduced, *, derive: bool = True) -> None:
    """Antenna positions, and what is known of their lever arm and of the camera's clock."""
    seen = problem.antenna
    if seen is None or len(seen.image) == 0:
        return
    R = x.R[seen.image]
    lever, shift, drift = seen.lever_ccs_m, np.zeros(3), np.zeros(3)
    t = seen.t_s - seen.t_s.mean()
    extra: list[ArrayF] = []
    at = 0
    eye = np.broadcast_to(np.eye(3), (len(t), 3, 3))
    if seen.shift:
        shift, at = x.extras[at : at + 3], at + 3
        extra.append(eye)
    if seen.drift:
        drift, at = x.extras[at : at + 3], at + 3
        extra.append(eye * t[:, None, None])
    known = seen.sigma_lever_m > 0
    if known.any():
        lever = lever + x.extras[at : at + 3]
        extra.append(R)
    arm = R @ lever
    off = seen.position_wcs_m - (x.C[seen.image] + arm + shift + t[:, None] * drift)
    if seen.velocity_wcs_m_s is not None and seen.late:
        off += seen.velocity_wcs_m_s * x.extras[-1]
        extra.append(-seen.velocity_wcs_m_s[:, :, None])
    W = seen.inverse_covariance
    Wr = np.einsum("iajb,jb->ia", W, off)
    out.cost["antenna"] = float((off * Wr).sum())
    out.counts["antenna"] = off.size
    if seen.late:
        out.cost["clock"], out.counts["clock"] = float(x.extras[-1] / seen.sigma_clock_s) ** 2, 1
        if derive:
            out.N[layout.control - 1, layout.control - 1] += 1.0 / seen.sigma_clock_s**2
            out.g[layout.control - 1] -= x.extras[-1] / seen.sigma_clock_s**2
    if known.any():
        change = x.extras[at : at + 3]
        # components that are held get a micrometre
        weight = 1.0 / np.square(np.where(known, seen.sigma_lever_m, 1e-6))
        out.cost["lever arm"] = float((change**2 * weight)[known].sum())
        out.counts["lever arm"] = int(known.sum())
        if derive:
            place = np.arange(layout.extras + at, layout.extras + at + 3)
            out.N[place, place] += weight
            out.g[place] -= weight * change
    if not derive:
        return
    J = np.concatenate([eye, -cross_matrix(arm), *extra], axis=2)
    pose = J[:, :, :6]
    own = (6 * seen.image[:, None] + np.arange(6)).ravel()
    n = len(own)
    # W J as (i, j, a, l)
    moved = np.swapaxes(W, 1, 2) @ pose
    out.N[np.ix_(own, own)] += np.einsum("iak,ijal->ikjl", pose, moved).reshape(n, n)
    out.g[own] += np.einsum("iak,ia->ik", pose, Wr).ravel()
    if J.shape[2] > 6:
        common = J[:, :, 6:]
        place = np.arange(layout.extras, layout.extras + common.shape[2])
        W_common = np.einsum("iajb,jbl->ial", W, common)
        cross = np.einsum("iak,ial->ikl", pose, W_common).reshape(n, -1)
        out.N[np.ix_(own, place)] += cross
        out.N[np.ix_(place, own)] += cross.T
        out.N[np.ix_(place, place)] += np.einsum("iak,ial->kl", common, W_common)
        out.g[place] += np.einsum("iak,ia->k", common, Wr)


def _add_interior(problem: Problem, layout: Layout, x: State, out: Reduced, *, derive: bool = True) -> None:
    """Interior parameters with what is known of them beforehand."""
    for at, W, off in interior_priors(problem, layout, x):
        out.cost["interior"] = out.cost.get("interior", 0.0) + float(off @ W @ off)
        out.counts["interior"] = out.counts.get("interior", 0) + len(at)
        if derive:
            out.N[np.ix_(at, at)] += W
            out.g[at] += W @ off
