"""Residuals and normal equations of an image block at a state, with correlated image points."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from scipy import optimize, sparse
from scipy.special import gammaln

from thalweg.calibration import collinear
from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayI, cross_matrix, njit
from thalweg.images.bundle.problem import Antenna, Layout, Problem, State, interior_priors

CHUNK: int = 200_000
"""Marks whose derivatives are held at once: 90 MB."""
NO_IMAGE_PX = 1e4
"""Residual of a point that a trial step has put behind its camera: the step is then taken back."""

HELD: Final = "held"
"""Group of what is no observation, but keeps unknowns where they are."""
MOST_TRACKS: Final = 2000
"""Tracks that are looked at: the numbers are then known to a few percent."""
_LEAST_MARKS: Final = 3
"""Marks of a track that tells anything of its correlation."""
_REACHES: Final = (0.003, 3.0)
"""Bounds of the reach, radians: from a sixth of a degree to errors that wander over all views."""
_POWERS: Final = (0.5, 1.9)
"""Bounds of the power: with 2 the matrices of long tracks lose their digits."""
_STARTS: Final = (
    (0.3, 0.02, 1.0),
    (0.3, 0.1, 1.0),
    (0.8, 0.1, 1.0),
    (0.8, 0.5, 1.0),
    (0.97, 3.0, 1.0),
    (0.9, 0.5, 1.6),
)
"""Share of the slow part in the variance, reach and power, from where the search begins."""
_APART_RAD: Final = 0.1
"""Distance of views at which the search looks at the slow part."""
_FIRST_STEPS: Final = (0.8, -0.3, -0.3, -0.6, 0.8)
"""Of the numbers of the search."""
_LATER_STEPS: Final = 0.3
_MORE: Final = 10.0
"""Twice the gain in likelihood that five more numbers must bring (Akaike 1974)."""
_ACROSS: Final = (0.1, 10.0)
"""Bounds of errors across over those along."""
_NUMBERS: Final = np.column_stack([(-20.0, 20.0), *np.log([_ACROSS, _ACROSS, _REACHES]), (-12.0, 12.0)])
"""Bounds of the numbers of `_shape`, (2, 5)."""
_FREEDOMS: Final = (1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0, 30.0, 100.0, np.inf)
_LEAST_SHARE: Final = 1e-3
"""Least white part of the variance, so that two views from the same place are no contradiction."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Correlation:
    """Errors of tie marks in units of their stated sigma.

    Parameters
    ----------
    white, slow : parts of the errors along the parallax.
    reach_rad, power : how fast the slow part changes with the view.
    white_across, slow_across : factors for the errors across the parallax.
    freedom : degrees of freedom of Student's distribution of a track; infinite: normal.
    """

    white: float = 1.0
    slow: float = 0.0
    reach_rad: float = 1.0
    power: float = 1.0
    white_across: float = 1.0
    slow_across: float = 1.0
    freedom: float = float("inf")

    @property
    def model(self) -> ArrayF:
        """(6,) as the compiled loops take it."""
        white, slow = self.white, self.slow
        across = (self.white_across * white, self.slow_across * slow)
        return np.array([white, across[0], slow, across[1], self.reach_rad, self.power])

    def change(self, apart_rad: float) -> ArrayF:
        """(2,) sigma of half the difference of two marks with views so far apart, times the root of two."""
        m = self.model
        new = -np.expm1(-((apart_rad / self.reach_rad) ** self.power))
        return np.asarray(np.sqrt(np.square(m[:2]) + np.square(m[2:4]) * new))

    def covariances(self, view: ArrayF, sigma_px: ArrayF) -> ArrayF:
        """(2, n, n) covariance of the marks of a track in each coordinate; as the compiled loops build it."""
        m = self.model
        apart = np.linalg.norm(view[:, None] - view, axis=2)
        alike = np.exp(-((apart / self.reach_rad) ** self.power))
        unit = m[:2, None, None] ** 2 * np.eye(len(view)) + m[2:4, None, None] ** 2 * alike
        return np.asarray(unit * np.outer(sigma_px, sigma_px))

    def differs(self, other: "Correlation", share: float) -> bool:
        """Whether the errors of two views a degree, or 10 degrees, apart differ by more than a share."""
        return any(
            bool((np.abs(self.change(apart) / other.change(apart) - 1.0) > share).any())
            for apart in np.radians([1.0, 10.0])
        )

    def weights(self, square: ArrayF, degrees: ArrayF) -> ArrayF:
        """Weight (t,) of tracks with these square sums and degrees of freedom."""
        if not np.isfinite(self.freedom):
            return np.ones_like(square)
        return np.asarray((self.freedom + degrees) / (self.freedom + square))

    def information(self, degrees: ArrayF) -> ArrayF:
        """(t,) what a track of Student's errors tells, as a share of its weighted normal equations.

        The expected curvature of the likelihood is smaller than the weight (Lange et al. 1989, eq. 6).
        """
        if not np.isfinite(self.freedom):
            return np.ones_like(degrees)
        return np.asarray((self.freedom + degrees) / (self.freedom + degrees + 2.0))

    def facts(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "white": self.white,
            "slow": self.slow,
            "white_across": self.white * self.white_across,
            "slow_across": self.slow * self.slow_across,
            "reach_deg": float(np.degrees(self.reach_rad)),
            "power": self.power,
            "freedom": self.freedom if np.isfinite(self.freedom) else None,
            "unit": "stated sigma of a mark",
        }


# ---------------------------------------------------------------- normal equations


@dataclass(frozen=True, slots=True, kw_only=True)
class Tracks:
    """Tie marks that take part, sorted by point.

    ``point`` (t,) are the points, ``first`` (t + 1,) where their marks begin, ``mark`` (m,) indices into the
    block's marks, ``image`` (m,), ``xy_px`` (m, 2), ``sigma_px`` (m,) with robust weights put in, ``view``
    (m, 4) as of `thalweg.images.bundle.normals.views`, and ``along`` (m, 2), the unit vector of the
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

    def chosen(self, marks: ArrayB) -> "Tracks":
        """Some of the marks (m,), of points that keep at least two of them."""
        point = np.repeat(np.arange(len(self.point)), np.diff(self.first))
        count = np.bincount(point[marks], minlength=len(self.point))
        rows = np.flatnonzero(marks & (count[point] >= 2))
        kept, first = np.unique(point[rows], return_index=True)
        return self._of(self.point[kept], np.append(first, len(rows)).astype(np.int64), rows)

    def _of(self, point: ArrayI, first: ArrayI, rows: ArrayI | slice) -> "Tracks":
        names = ("mark", "image", "xy_px", "sigma_px", "view", "along")
        return Tracks(point=point, first=first, **{name: getattr(self, name)[rows] for name in names})

    @property
    def at(self) -> ArrayI:
        """(m,) point of each mark."""
        return np.repeat(self.point, np.diff(self.first))

    def chunks(self) -> Iterator["Tracks"]:
        """Tracks in parts of limited size."""
        begin = 0
        while begin < len(self.point):
            end = int(np.searchsorted(self.first, self.first[begin] + CHUNK, side="right")) - 1
            end = min(max(end, begin + 1), len(self.point))
            rows = slice(int(self.first[begin]), int(self.first[end]))
            yield self._of(self.point[begin:end], self.first[begin : end + 1] - self.first[begin], rows)
            begin = end


def tracks_of(
    problem: Problem, used: ArrayB, sigma_px: ArrayF, view: ArrayF, along: ArrayF | None = None
) -> Tracks:
    """Tracks of the used marks (m,) of all points that keep at least two of them.

    ``along`` (m, 2) is the parallax of all marks; None: along the rows.
    """
    block = problem.block
    rows = np.flatnonzero(used)
    rows = rows[np.lexsort((rows, block.mark_image[rows], block.mark_point[rows]))]
    point, first = np.unique(block.mark_point[rows], return_index=True)
    every = Tracks(
        point=point.astype(np.int64),
        first=np.append(first, len(rows)).astype(np.int64),
        mark=rows,
        image=block.mark_image[rows].astype(np.int64),
        xy_px=block.mark_px[rows],
        sigma_px=sigma_px[rows],
        view=view[rows],
        along=np.tile([1.0, 0.0], (len(rows), 1)) if along is None else along[rows],
    )
    return every.chosen(np.ones(len(rows), np.bool_))


@dataclass(slots=True)
class Marks:
    """Linearised marks: residual (m, 2) measured minus computed, derivatives (m, 2, 6 | q | 3)."""

    residual: ArrayF
    by_pose: ArrayF
    by_rest: ArrayF
    by_point: ArrayF


def linearised(problem: Problem, layout: Layout, x: State, image: ArrayI, X: ArrayF, xy_px: ArrayF) -> Marks:
    """Marks of points ``X`` (m, 3) in images, and their derivatives.

    See `thalweg.calibration.collinear`; an error of a rig's pose turns the lens about the centre of the rig,
    and one of the place of the lens is one of its pose, turned by ``R_wcs_rig``.
    """
    m, q = len(image), layout.n_interior
    camera = problem.block.camera[image]
    R, C = x.R[image], x.C[image]
    arm = None
    if x.T_rig_lens:
        R_lens, c_lens = x.lenses(camera)
        R_rig = R @ np.swapaxes(R_lens, 1, 2)
        arm = X - C + np.einsum("mij,mj->mi", R_rig, c_lens)
    xy, by_pose, by_point, by_camera = collinear(x.cameras, camera, R, C, X, arm)
    by_rest = np.zeros((m, 2, q))
    for k, (interior, place) in enumerate(zip(layout.interior, layout.places, strict=True)):
        rows: AnyArray = np.flatnonzero(camera == k) if len(x.cameras) > 1 else np.arange(m)
        for parameter in np.flatnonzero(interior >= 0):
            # tied parameters share a column
            by_rest[rows, :, interior[parameter] - layout.n_poses] += by_camera[rows, :, parameter]
        if place[0] >= 0:
            turned = by_point[rows] @ cross_matrix((X - C)[rows])
            by_place = np.concatenate([-by_point[rows] @ R_rig[rows], turned @ R_rig[rows]], axis=2)
            by_rest[rows, :, place[0] - layout.n_poses : place[5] + 1 - layout.n_poses] = by_place
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
        np.einsum("mij,mj->mi", turn, part.residual),
        turn @ part.by_pose,
        turn @ part.by_rest,
        turn @ part.by_point,
    )


def linearised_tracks(problem: Problem, layout: Layout, x: State, tracks: Tracks) -> Marks:
    """Marks of tracks, along and across the parallax."""
    part = linearised(problem, layout, x, tracks.image, x.X[tracks.at], tracks.xy_px)
    return along_and_across(part, tracks.along)


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
    for some in tracks.chunks():
        part = linearised_tracks(problem, layout, x, some)
        tie += add_tracks(
            some.first,
            layout.exposure[some.image],
            part.by_pose,
            part.by_rest,
            part.by_point,
            part.residual,
            some.sigma_px,
            some.view,
            model.model,
            damping,
            layout.n_poses,
            N,
            g,
        )
    # blocks on the diagonal are filled on both sides
    N = np.triu(N)
    N += np.triu(N, 1).T
    cost = {"tie": tie, "control marks": 0.0, "control points": 0.0}
    counts = {"tie": 2 * len(tracks.mark), "control marks": 0, "control points": 0}
    for name, J, W, off in _other_groups(problem, layout, x, control_sigma_px):
        at = np.unique(J.indices)
        by, weighted = J[:, at], W @ off
        part = by.T @ (W @ by)
        N[np.ix_(at, at)] += part if isinstance(part, np.ndarray) else part.toarray()
        g[at] += by.T @ weighted
        if name != HELD:
            cost[name] = cost.get(name, 0.0) + float(off @ weighted)
            counts[name] = counts.get(name, 0) + len(off)
    return Reduced(N, g, cost, counts)


def point_steps(
    problem: Problem, layout: Layout, x: State, tracks: Tracks, model: Correlation, damping: float, d: ArrayF
) -> ArrayF:
    """(p, 3) changes of the tie points that go with the change ``d`` (u,) of the shared unknowns."""
    step = np.zeros_like(x.X)
    poses = d[: layout.n_poses].reshape(-1, 6)
    rest = d[layout.n_poses : layout.n_poses + layout.n_interior]
    for some in tracks.chunks():
        part = linearised_tracks(problem, layout, x, some)
        by_pose = np.einsum("maj,mj->ma", part.by_pose, poses[layout.exposure[some.image]])
        left = part.residual - by_pose - part.by_rest @ rest
        step[some.point] = solve_points(
            some.first, part.by_point, left, some.sigma_px, some.view, model.model, damping
        )
    return step


def cost_of(
    problem: Problem, layout: Layout, x: State, tracks: Tracks, model: Correlation, control_sigma_px: ArrayF
) -> float:
    """Weighted square sum of all observations at a state."""
    total = 0.0
    for some in tracks.chunks():
        xy = projected(problem, x, some.image, x.X[some.at])
        residual = np.nan_to_num(some.xy_px - xy, nan=NO_IMAGE_PX)
        residual = np.einsum("mij,mj->mi", _turns(some.along), residual)
        total += track_costs(some.first, residual, some.sigma_px, some.view, model.model)
    for name, _, W, off in _other_groups(problem, layout, x, control_sigma_px):
        total += float(off @ (W @ off)) if name != HELD else 0.0
    return total


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
    seen = collinear(x.cameras, problem.block.camera[image], x.R[image], x.C[image], X)
    return np.asarray(np.nan_to_num(seen.by_point))


def _other_groups(
    problem: Problem, layout: Layout, x: State, control_sigma_px: ArrayF
) -> Iterator[tuple[str, Any, Any, ArrayF]]:
    """All observations but tie marks: their group, derivatives (r, u), weights (r, r), residuals (r,)."""

    def rows(at: AnyArray, J: AnyArray) -> Any:
        """Derivatives (b, r, k) by the unknowns ``at`` (b, k) as a sparse matrix."""
        b, r, k = J.shape
        columns = np.repeat(at, r, axis=0).ravel()
        return sparse.csr_array(
            (J.ravel(), columns, k * np.arange(b * r + 1)), shape=(b * r, len(layout.names))
        )

    marks, control, q = problem.marks, problem.control, layout.n_interior
    seen = np.flatnonzero(np.isfinite(control_sigma_px))
    if len(seen):
        image, point = marks.image[seen], marks.point[seen]
        part = linearised(problem, layout, x, image, x.G[point], marks.xy_px[seen])
        rest = np.broadcast_to(layout.n_poses + np.arange(q), (len(seen), q))
        pose, place = 6 * layout.exposure[image, None], layout.control + 3 * point[:, None]
        at = np.concatenate([pose + np.arange(6), rest, place + np.arange(3)], axis=1)
        J = np.concatenate([part.by_pose, part.by_rest, part.by_point], axis=2)
        weight = np.repeat(1.0 / np.square(control_sigma_px[seen]), 2)
        yield "control marks", rows(at, J), sparse.diags_array(weight), part.residual.ravel()
    held = np.flatnonzero(~control.check)
    if len(held):
        each, n = np.arange(len(held)), 3 * len(held)
        W = sparse.bsr_array(
            (np.linalg.inv(control.cov_wcs_m2[held]), each, np.append(each, len(held))), shape=(n, n)
        )
        J = rows(layout.control + 3 * held[:, None] + np.arange(3), np.tile(np.eye(3), (len(held), 1, 1)))
        yield "control points", J, W, (control.points_wcs_m[held] - x.G[held]).ravel()
    if problem.antenna is not None and len(problem.antenna.image):
        for name, columns, by, weights, off in _antenna_groups(problem.antenna, layout, x):
            yield name, rows(columns, by), weights, off
    for unknowns, weights, off in interior_priors(problem, layout, x):
        yield "interior", rows(unknowns[None], np.eye(len(off))[None]), weights, off


def _antenna_groups(
    seen: Antenna, layout: Layout, x: State
) -> Iterator[tuple[str, AnyArray, AnyArray, AnyArray, ArrayF]]:
    """Antenna positions, and what is known of their lever arm and of the camera's clock."""
    R, C = (a[seen.image] for a in layout.poses(x))
    lever, t = seen.lever_ccs_m, (seen.t_s - seen.t_s.mean())[:, None]
    n, at = len(t), 0
    eye = np.broadcast_to(np.eye(3), (n, 3, 3))
    common = np.zeros((n, 3))
    extra: list[ArrayF] = []
    if seen.shift:
        common, at = common + x.extras[at : at + 3], at + 3
        extra.append(eye)
    if seen.drift:
        common, at = common + t * x.extras[at : at + 3], at + 3
        extra.append(eye * t[:, None])
    known = seen.sigma_lever_m > 0
    if known.any():
        change, place = x.extras[at : at + 3], layout.extras + at + np.arange(3)
        lever = lever + change
        extra.append(R)
        # components that are held get a micrometre
        for name, some, sigma in (("lever arm", known, seen.sigma_lever_m), (HELD, ~known, np.full(3, 1e-6))):
            if some.any():
                yield (
                    name,
                    place[None, some],
                    np.eye(some.sum())[None],
                    np.diag(sigma[some] ** -2),
                    -change[some],
                )
    arm = R @ lever
    off = seen.position_wcs_m - (C + arm + common)
    if seen.velocity_wcs_m_s is not None and seen.late:
        late = x.extras[-1:]
        off += seen.velocity_wcs_m_s * late
        extra.append(-seen.velocity_wcs_m_s[:, :, None])
        clock = np.array([[layout.control - 1]])
        yield "clock", clock, np.ones((1, 1, 1)), np.full((1, 1), seen.sigma_clock_s**-2), -late
    J = np.concatenate([eye, -cross_matrix(arm), *extra], axis=2)
    shared = np.broadcast_to(layout.extras + np.arange(J.shape[2] - 6), (n, J.shape[2] - 6))
    columns = np.concatenate([6 * seen.image[:, None] + np.arange(6), shared], axis=1)
    yield "antenna", columns, J, seen.inverse_covariance.reshape(3 * n, 3 * n), off.ravel()


# ---------------------------------------------------------------- correlation of the errors of a point's
# image points
#
# A slow boat sees the same texture in neighbouring images from nearly the same side. What shifts a mark
# there - relief below the size of the feature, its oblique picture, light - shifts it alike in both images,
# and changes with the view. So each coordinate of a mark errs by ::
#
#     e = s (white w + slow c),      E[c_i c_j] = exp(-(|v_i - v_j| / reach)^power)
#
# with the stated sigma ``s``, independent ``w``, and the place of view ``v``: the unit vector from the
# point to the camera, and the logarithm of their distance. Two views that differ by ``reach`` (a change of
# direction in radians, or of distance in nepers) are correlated by 1/e. The distance of places is
# Euclidean, so this is a covariance on any set of views for powers up to 2 (Schoenberg 1938): at 1 errors
# wander like a drunkard, at 2 they drift smoothly.
#
# What is nearer than the feature's own depth passes before what is farther, along the parallax. There marks
# err more than across it, by factors that are estimated, too. Along is where the main direction of the
# cameras that see a point appears in the image; on a boat that is mostly the horizontal.
#
# Some tracks are much worse than others: a leaf that moves, an edge that hides. The errors of a track
# follow Student's distribution, jointly for all its marks: with ``q = r^T P r`` and ``d = 2 n - 3`` it
# counts with the weight ``(freedom + d) / (freedom + q)`` (Lange, Little and Taylor 1989).
#
# All numbers and the size of the errors maximise the restricted likelihood of the residuals (Patterson and
# Thompson 1971): the coordinates of each point are integrated out exactly; the images, which share six
# unknowns among hundreds of marks, are taken as they are.


def views(points_m: ArrayF, centres_m: ArrayF) -> ArrayF:
    """(m, 4) place of view of each mark: unit vector from the point to the camera, logarithm of distance."""
    away = centres_m - points_m
    r = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
    return np.concatenate([away / r, np.log(r)], axis=1)


def parallax(by_point: ArrayF, point: ArrayI, centres_m: ArrayF, n_points: int) -> ArrayF:
    """(m, 2) unit vector in the image along the parallax of each mark.

    Parameters
    ----------
    by_point : (m, 2, 3) derivatives of the pixel by the point.
    point : (m,) points of the marks.
    centres_m : (m, 3) projection centres of their images.
    n_points : number of points.
    """
    count = np.maximum(np.bincount(point, minlength=n_points), 1)[:, None]
    mean = np.stack([np.bincount(point, c, n_points) for c in centres_m.T], axis=1) / count
    off = centres_m - mean[point]
    spread = np.empty((n_points, 3, 3))
    for a in range(3):
        for b in range(a, 3):
            spread[:, a, b] = spread[:, b, a] = np.bincount(point, off[:, a] * off[:, b], n_points)
    main = np.linalg.eigh(spread)[1][:, :, 2]
    along = np.einsum("mij,mj->mi", by_point, main[point])
    length = np.linalg.norm(along, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(length > 0, along / length, [1.0, 0.0])


def estimate(
    first: ArrayI,
    by_point: ArrayF,
    residual_px: ArrayF,
    sigma_px: ArrayF,
    view: ArrayF,
    start: Correlation | None = None,
) -> Correlation:
    """The numbers that make the residuals most likely.

    Parameters
    ----------
    first : (p + 1,) first mark of each track.
    by_point : (m, 2, 3) derivatives of the pixel by the point; along and across the parallax.
    residual_px, sigma_px : (m, 2) along and across, (m,).
    view : (m, 4) of `views`.
    start : an earlier estimate to begin from.
    """
    length = np.diff(first)
    usable = np.flatnonzero(length >= _LEAST_MARKS)
    if len(usable) == 0:
        return Correlation()
    # evenly spread, not random: the same block gives the same numbers
    chosen = usable[np.linspace(0, len(usable) - 1, min(MOST_TRACKS, len(usable))).astype(np.int64)]
    rows = np.concatenate([np.arange(first[k], first[k + 1]) for k in chosen])
    starts = np.concatenate([[0], np.cumsum(length[chosen])])
    parts = tuple(np.ascontiguousarray(a[rows]) for a in (by_point, residual_px, sigma_px, view))
    degrees = (2 * length[chosen] - 3).astype(np.float64)
    freedoms = np.array(_FREEDOMS)
    constants = np.array([_constant(degrees, freedom) for freedom in _FREEDOMS])

    def profile(shape: Correlation) -> tuple[float, float, float]:
        """-2 ln L for the best size and freedom of errors of that shape, and these."""
        logarithm, square, _ = restricted_parts(starts, *parts, shape.model, False)
        value, variance, freedom = _best_sized(square, degrees, freedoms, constants)
        return value + float(logarithm.sum()), variance, freedom

    fresh = start is None or start.slow == 0
    tries = (
        [_numbers(start)]
        if start is not None and not fresh
        else [
            _numbers(Correlation(white=np.sqrt(1 - share), slow=np.sqrt(share), reach_rad=reach, power=power))
            for share, reach, power in _STARTS
        ]
    )
    best = min(tries, key=lambda x: profile(_shape(x))[0])
    minimise: Any = optimize.minimize
    # a simplex may shrink beside the minimum; another from there does not
    for size, most in ((1.0, 150), (0.5, 100)) if fresh else ((_LATER_STEPS, 50),):
        search: Any = {
            "initial_simplex": best + np.vstack([np.zeros(5), size * np.diag(_FIRST_STEPS)]),
            "xatol": 0.02,
            "fatol": 0.1,
            "maxfev": most,
        }
        found = minimise(lambda x: profile(_shape(x))[0], best, method="Nelder-Mead", options=search)
        best = found.x
    independent, variance, freedom = profile(Correlation())
    if independent <= float(found.fun) + _MORE:
        return Correlation(white=float(np.sqrt(variance)), freedom=freedom)
    shape = _shape(found.x)
    _, variance, freedom = profile(shape)
    size = float(np.sqrt(variance))
    return replace(shape, white=size * shape.white, slow=size * shape.slow, freedom=freedom)


def _numbers(shape: Correlation) -> ArrayF:
    """(5,) numbers without bounds for the search.

    Not the whole slow part is known but what of it is new at some distance, so that is the first number; it
    hardly depends on the reach, the fourth.
    """
    low, high = _POWERS
    inner = float(np.clip((shape.power - low) / (high - low), 0.01, 0.99))
    new = (shape.slow / shape.white) ** 2 * -np.expm1(-((_APART_RAD / shape.reach_rad) ** shape.power))
    return np.array(
        [
            np.log(max(new, 1e-6)),
            np.log(shape.white_across),
            np.log(shape.slow_across),
            np.log(shape.reach_rad),
            np.log(inner / (1 - inner)),
        ]
    )


def _shape(x: ArrayF) -> Correlation:
    """Errors of unit variance along the parallax."""
    x = np.minimum(np.maximum(x, _NUMBERS[0]), _NUMBERS[1])
    inner = float(1.0 / (1.0 + np.exp(-x[4])))
    power = _POWERS[0] + (_POWERS[1] - _POWERS[0]) * inner
    reach = float(np.exp(x[3]))
    ratio = float(np.exp(x[0])) / -np.expm1(-((_APART_RAD / reach) ** power))
    white = max(1.0 / (1.0 + ratio), _LEAST_SHARE)
    across = np.exp(x[1:3])
    return Correlation(
        white=float(np.sqrt(white)),
        slow=float(np.sqrt(1.0 - white)),
        reach_rad=reach,
        power=power,
        white_across=float(across[0]),
        slow_across=float(across[1]),
    )


def _constant(degrees: ArrayF, freedom: float) -> float:
    """The part of `_sized` that does not depend on the errors."""
    if not np.isfinite(freedom):
        return 0.0
    each = gammaln((freedom + degrees) / 2) - gammaln(freedom / 2) - degrees / 2 * np.log(freedom / 2)
    return float(-2 * each.sum())


@njit(cache=True, error_model="numpy")
def _best_sized(
    square: ArrayF, degrees: ArrayF, freedoms: ArrayF, constants: ArrayF
) -> tuple[float, float, float]:
    """-2 ln L for the best variance and freedom of tracks, and these; ``constants`` of `_constant`.

    Compiled: the search for a shape asks some thousand times.
    """
    middle = max(np.median(square / degrees), 1e-12)
    best, size, freedom = np.inf, middle, freedoms[0]
    for k in range(len(freedoms)):
        value, variance = _sized(square, degrees, freedoms[k], middle)
        if value + constants[k] < best:
            best, size, freedom = value + constants[k], variance, freedoms[k]
    return best, size, freedom


@njit(cache=True, error_model="numpy")
def _sized(square: ArrayF, degrees: ArrayF, freedom: float, variance: float) -> tuple[float, float]:
    """-2 ln L of Student's (normal) distribution of tracks for the best variance, and that variance.

    Without `_constant`; ``variance`` is where the search begins.
    """
    total = degrees.sum()
    if not np.isfinite(freedom):
        variance = max(square.sum() / total, 1e-12)
        return total * np.log(variance) + square.sum() / variance, variance
    for _ in range(40):
        weighted = 0.0
        for k in range(len(square)):
            weighted += (freedom + degrees[k]) / (freedom + square[k] / variance) * square[k]
        new = max(weighted / total, 1e-12)
        done = abs(new / variance - 1) < 1e-5
        variance = new
        if done:
            break
    body = 0.0
    for k in range(len(square)):
        body += (freedom + degrees[k]) * np.log1p(square[k] / (variance * freedom))
    return total * np.log(variance) + body, variance


# ---------------------------------------------------------------- compiled passes over the tracks of tie
# points
#
# A track is all marks of one point. Its errors are correlated: marks ``i`` and ``j`` of a track have, in
# coordinate ``a`` (along and across the parallax of the track), the covariance ::
#
#     C_ij = s_i s_j (white_a^2 [i = j] + slow_a^2 exp(-(|v_i - v_j| / reach)^power))
#
# with the standard deviations ``s`` and the places ``v`` from where the point was seen (see
# `thalweg.images.bundle.normals`). With ``W_a = C_a^-1``, ``W_ij = diag(W_1ij, W_2ij)``, the
# derivatives ``A_i`` (2, 3) by the point, and ``V = sum_ij A_i^T W_ij A_j``, the point is eliminated (Brown
# 1958; Triggs et al. 2000)::
#
#     P_ij = W_ij - (W A)_i V^-1 (W A)_j^T,      S += J_i^T P_ij J_j,      g += J_i^T P_ij r_j
#
# ``model`` holds white (2), slow (2), reach and power. Residuals and derivatives come in the coordinates
# along and across.


@njit(cache=True, error_model="numpy")
def _inverse_track(n: int, s: ArrayF, v: ArrayF, model: ArrayF, W: ArrayF) -> float:
    """Fill ``W`` (2, n, n) with the inverse covariances of a track; returns the logarithm of determinants."""
    log_determinant = 0.0
    wanders = n > 1 and (model[2] > 0.0 or model[3] > 0.0)
    if wanders:
        # how alike the slow errors are, in the upper half of the second matrix until it is its turn
        half = 0.5 * model[5]
        for i in range(n):
            for j in range(i + 1, n):
                d2 = 0.0
                for a in range(v.shape[1]):
                    d2 += (v[i, a] - v[j, a]) ** 2
                W[1, i, j] = np.exp(-((d2 / (model[4] * model[4])) ** half))
    for a in range(2):
        white, slow = model[a] * model[a], model[2 + a] * model[2 + a]
        if not wanders:
            for i in range(n):
                for j in range(n):
                    W[a, i, j] = 0.0
                W[a, i, i] = 1.0 / ((white + slow) * s[i] * s[i])
                log_determinant -= np.log(W[a, i, i])
        else:
            log_determinant += _inverse_coordinate(n, s, W[1], white, slow, W[a])
    return log_determinant


@njit(cache=True, error_model="numpy")
def _inverse_coordinate(n: int, s: ArrayF, alike: ArrayF, white: float, slow: float, W: ArrayF) -> float:
    """Inverse covariance of one coordinate; ``alike`` is read from its upper half, and may be ``W``."""
    # Cholesky factor of the correlation part, in the lower half of W; the sigmas are put in at the end
    for i in range(n):
        for j in range(i + 1):
            value = white + slow if i == j else slow * alike[j, i]
            for k in range(j):
                value -= W[i, k] * W[j, k]
            W[i, j] = np.sqrt(value) if i == j else value / W[j, j]
    log_determinant = 0.0
    for i in range(n):
        log_determinant += 2.0 * np.log(W[i, i] * s[i])
    # inverse of the factor, in place
    for j in range(n):
        W[j, j] = 1.0 / W[j, j]
        for i in range(j + 1, n):
            value = 0.0
            for k in range(j, i):
                value -= W[i, k] * W[k, j]
            W[i, j] = value / W[i, i]
    # L^-T L^-1
    for i in range(n):
        for j in range(i + 1):
            value = 0.0
            for k in range(i, n):
                value += W[k, i] * W[k, j]
            W[j, i] = value
    for i in range(n):
        for j in range(i, n):
            W[i, j] /= s[i] * s[j]
            W[j, i] = W[i, j]
    return log_determinant


@njit(cache=True, error_model="numpy")
def _inverse3(V: ArrayF, out: ArrayF) -> float:
    """Inverse of a symmetric 3x3 matrix; returns its determinant."""
    a, b, c = V[0, 0], V[0, 1], V[0, 2]
    d, e, f = V[1, 1], V[1, 2], V[2, 2]
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * A + b * B + c * C
    out[0, 0], out[0, 1], out[0, 2] = A / determinant, B / determinant, C / determinant
    out[1, 1], out[1, 2] = (a * f - c * c) / determinant, (b * c - a * e) / determinant
    out[2, 2] = (a * d - b * b) / determinant
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    return determinant


@njit(cache=True, error_model="numpy")
def _buffers(first: ArrayI) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF, ArrayF, ArrayF, ArrayF]:
    """Room for what `_eliminated` fills, as large as the longest track needs."""
    n = 0
    for k in range(len(first) - 1):
        n = max(n, first[k + 1] - first[k])
    W, WA, WAV = np.empty((2, n, n)), np.empty((n, 2, 3)), np.empty((n, 2, 3))
    return W, WA, WAV, np.empty((n, 2)), np.empty(3), np.empty((3, 3)), np.empty((3, 3))


@njit(cache=True, error_model="numpy")
def _eliminated(
    at: int, n: int, A: ArrayF, r: ArrayF, sigma: ArrayF, view: ArrayF, model: ArrayF, damping: float,
    W: ArrayF, WA: ArrayF, WAV: ArrayF, Wr: ArrayF, AWr: ArrayF, V: ArrayF, Vi: ArrayF,
) -> tuple[float, float]:  # fmt: skip
    """Fill what eliminates a point: ``W``, ``W A``, ``W A V^-1``, ``W r``, ``A^T W r``, V and ``V^-1``.

    The track has n marks from ``at`` on. Returns the logarithm of the determinants of its covariances, and
    the determinant of ``V``.
    """
    log_determinant = _inverse_track(n, sigma[at : at + n], view[at : at + n], model, W)
    V[:] = 0.0
    AWr[:] = 0.0
    for i in range(n):
        for a in range(2):
            value = 0.0
            for j in range(n):
                value += W[a, i, j] * r[at + j, a]
            Wr[i, a] = value
            for x in range(3):
                value = 0.0
                for j in range(n):
                    value += W[a, i, j] * A[at + j, a, x]
                WA[i, a, x] = value
                AWr[x] += value * r[at + i, a]
                for y in range(3):
                    V[y, x] += A[at + i, a, y] * value
    for x in range(3):
        V[x, x] *= 1.0 + damping
    determinant = _inverse3(V, Vi)
    for i in range(n):
        for a in range(2):
            for x in range(3):
                WAV[i, a, x] = WA[i, a, 0] * Vi[0, x] + WA[i, a, 1] * Vi[1, x] + WA[i, a, 2] * Vi[2, x]
    return log_determinant, determinant


@njit(cache=True, error_model="numpy", nogil=True)
def add_tracks(
    first: ArrayI,
    image: ArrayI,
    by_pose: ArrayF,
    by_rest: ArrayF,
    by_point: ArrayF,
    residual: ArrayF,
    sigma: ArrayF,
    view: ArrayF,
    model: ArrayF,
    damping: float,
    n_poses: int,
    S: ArrayF,
    g: ArrayF,
) -> float:
    """Add all tracks to the reduced normal equations; returns their weighted square sum.

    Parameters
    ----------
    first : (p + 1,) first mark of each track; marks are sorted by track.
    image : (m,) exposure of each mark.
    by_pose, by_rest, by_point : (m, 2, 6), (m, 2, q), (m, 2, 3) derivatives of the pixel.
    residual : (m, 2) measured minus computed.
    sigma : (m,) standard deviations; view : (m, d) places of view; model : (6,).
    damping : Levenberg's share that is added to the diagonal of each point.
    n_poses : 6 times the number of exposures.
    S, g : (u, u), (u,) poses first, then the q others; only the upper half of S is filled.
    """
    W, WA, WAV, Wr, AWr, V, Vi = _buffers(first)
    P, T = np.empty((2, 2)), np.empty((2, 6))
    q = by_rest.shape[2]
    PR, rest = np.empty((len(WA), 2, q)), np.empty((3, q))
    cost = 0.0
    for k in range(len(first) - 1):
        at, n = first[k], first[k + 1] - first[k]
        _eliminated(
            at, n, by_point, residual, sigma, view, model, damping, W, WA, WAV, Wr, AWr, V, Vi
        )  # fmt: skip
        rest[:] = 0.0
        for i in range(n):
            for a in range(2):
                cost += residual[at + i, a] * Wr[i, a]
                for x in range(3):
                    for c in range(q):
                        rest[x, c] += WA[i, a, x] * by_rest[at + i, a, c]
        # P applied to the residuals, in place, and to the derivatives by what all images share
        for i in range(n):
            for a in range(2):
                for x in range(3):
                    Wr[i, a] -= WAV[i, a, x] * AWr[x]
                for c in range(q):
                    value = 0.0
                    for j in range(n):
                        value += W[a, i, j] * by_rest[at + j, a, c]
                    for x in range(3):
                        value -= WAV[i, a, x] * rest[x, c]
                    PR[i, a, c] = value
        for i in range(n):
            at_i = 6 * image[at + i]
            for b in range(6):
                g[at_i + b] += by_pose[at + i, 0, b] * Wr[i, 0] + by_pose[at + i, 1, b] * Wr[i, 1]
                for c in range(q):
                    S[at_i + b, n_poses + c] += (
                        by_pose[at + i, 0, b] * PR[i, 0, c] + by_pose[at + i, 1, b] * PR[i, 1, c]
                    )
            for b in range(q):
                g[n_poses + b] += by_rest[at + i, 0, b] * Wr[i, 0] + by_rest[at + i, 1, b] * Wr[i, 1]
                for c in range(b, q):
                    S[n_poses + b, n_poses + c] += (
                        by_rest[at + i, 0, b] * PR[i, 0, c] + by_rest[at + i, 1, b] * PR[i, 1, c]
                    )
            for j in range(n):
                at_j = 6 * image[at + j]
                if at_j < at_i:
                    continue
                for a in range(2):
                    for b in range(2):
                        P[a, b] = W[a, i, j] if a == b else 0.0
                        for x in range(3):
                            P[a, b] -= WAV[i, a, x] * WA[j, b, x]
                for b in range(6):
                    T[0, b] = P[0, 0] * by_pose[at + j, 0, b] + P[0, 1] * by_pose[at + j, 1, b]
                    T[1, b] = P[1, 0] * by_pose[at + j, 0, b] + P[1, 1] * by_pose[at + j, 1, b]
                for b in range(6):
                    one, two = by_pose[at + i, 0, b], by_pose[at + i, 1, b]
                    for c in range(6):
                        S[at_i + b, at_j + c] += one * T[0, c] + two * T[1, c]
    return cost


@njit(cache=True, error_model="numpy", nogil=True)
def solve_points(
    first: ArrayI,
    by_point: ArrayF,
    residual: ArrayF,
    sigma: ArrayF,
    view: ArrayF,
    model: ArrayF,
    damping: float,
) -> ArrayF:
    """Best change (p, 3) of each point for residuals (m, 2) that remain after the change of the images."""
    W, WA, WAV, Wr, AWr, V, Vi = _buffers(first)
    step = np.empty((len(first) - 1, 3))
    for k in range(len(step)):
        at, n = first[k], first[k + 1] - first[k]
        _eliminated(
            at, n, by_point, residual, sigma, view, model, damping, W, WA, WAV, Wr, AWr, V, Vi
        )  # fmt: skip
        for x in range(3):
            step[k, x] = Vi[x, 0] * AWr[0] + Vi[x, 1] * AWr[1] + Vi[x, 2] * AWr[2]
    return step


@njit(cache=True, error_model="numpy", nogil=True)
def track_costs(first: ArrayI, residual: ArrayF, sigma: ArrayF, view: ArrayF, model: ArrayF) -> float:
    """Weighted square sum ``r^T W r`` of all tracks."""
    W = _buffers(first)[0]
    cost = 0.0
    for k in range(len(first) - 1):
        at, n = first[k], first[k + 1] - first[k]
        _inverse_track(n, sigma[at : at + n], view[at : at + n], model, W)
        for i in range(n):
            for j in range(n):
                for a in range(2):
                    cost += residual[at + i, a] * W[a, i, j] * residual[at + j, a]
    return cost


@njit(cache=True, error_model="numpy", nogil=True)
def restricted_parts(
    first: ArrayI, by_point: ArrayF, residual: ArrayF, sigma: ArrayF, view: ArrayF, model: ArrayF, fits: bool
) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Parts of the restricted likelihood (Patterson and Thompson 1971) of each track, and how a mark fits.

    Of the residuals all that a change of the point could explain is left out: ``logarithm`` (p,) is
    ``ln |C| + ln |V|``, ``square`` (p,) is ``r^T P r``. ``fit`` (m,), if ``fits``, is
    ``sqrt(z^T P_ii^-1 z)`` with ``z = (P r)_i``: how far a mark is, in units of its own sigma, from what all
    others of its track say of it.
    """
    W, WA, WAV, Wr, AWr, V, Vi = _buffers(first)
    logarithm, square = np.zeros(len(first) - 1), np.zeros(len(first) - 1)
    fit = np.empty(len(residual) if fits else 0)
    for k in range(len(square)):
        at, n = first[k], first[k + 1] - first[k]
        if n < 2:
            continue
        log_det, determinant = _eliminated(
            at, n, by_point, residual, sigma, view, model, 0.0, W, WA, WAV, Wr, AWr, V, Vi
        )  # fmt: skip
        logarithm[k] = log_det + np.log(determinant)
        for i in range(n):
            for a in range(2):
                for x in range(3):
                    Wr[i, a] -= WAV[i, a, x] * AWr[x]
                square[k] += residual[at + i, a] * Wr[i, a]
            if fits:
                # a direction that only this mark shows has no check: it gets a little weight of its own
                xx, yy = 1.001 * W[0, i, i], 1.001 * W[1, i, i]
                xy = 0.0
                for x in range(3):
                    xx -= WAV[i, 0, x] * WA[i, 0, x]
                    yy -= WAV[i, 1, x] * WA[i, 1, x]
                    xy -= WAV[i, 0, x] * WA[i, 1, x]
                value = (
                    yy * Wr[i, 0] * Wr[i, 0] - 2 * xy * Wr[i, 0] * Wr[i, 1] + xx * Wr[i, 1] * Wr[i, 1]
                ) / (xx * yy - xy * xy)
                fit[at + i] = np.sqrt(max(value, 0.0))
    return logarithm, square, fit
