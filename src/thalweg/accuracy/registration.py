"""Rigid registration of a cloud to a reference mesh: how much of an offset a motion removes (P2 section 7).

Point-to-plane ICP with Tukey's robust loss (Chen and Medioni 1992; scale by the median absolute distance).
For a small motion, ``p -> c + exp([w]x)(p - c) + t`` about the middle ``c`` of the points, the distance of a
point changes by ``n . t + ((p - c) x n) . w``. Nearest places and normals are found anew in each iteration;
points whose nearest place lies on the border take no part.

**What a surface does not determine.** A plane is the same after a shift within it. A motion is as visible as
the change of the distances is large against the motion of the points, both as RMS: 1 for a shift along the
normal of a plane, 0 for one within it. The mean normals of cells of one metre are asked: those of single
triangles also vary by the noise of the reference, which would make anything look determined. Motions that
are less visible than `LEAST_VISIBLE` are left alone and named.

**Standard deviations.** From what single stretches of time would change (`block_covariance`), not from the
number of points: formal ones would be too small by a factor of a hundred. They hold the errors of the
trajectory and all else that changes with time. They do not hold what is the same at all times: an error of
the mount, one of the reference, plants in front. A motion that is larger than they explain may be owed to
these.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation
from scipy.stats import f as fisher

from thalweg.accuracy.comparison import ComparisonSettings
from thalweg.core import NMAD, ArrayB, ArrayF, ArrayI, GeometryError, plane_rates
from thalweg.surface import (
    LEAST_VISIBLE,
    Distances,
    Motion,
    Surface,
    jackknife,
    motions_in_words,
    tukey,
    tukey_slope,
    visible_motions,
)

MOST_POINTS: Final = 100_000
"""Points that take part; more of them share the same pose errors."""
MOST_ITERATIONS: Final = 60
STEP_M: Final = 1e-5
"""Converged if a step moves the points by less than this RMS."""
LEAST_GAIN: Final = 0.2
"""Where a step leaves more than ``1 - LEAST_GAIN * share`` of the way, steps are halved: on rough ground
nearest places jump to and fro between faces, and full steps circle around the solution."""
JITTER: Final = 0.05
"""Largest full step that may be left, as a share of the spread of the distances."""
LARGEST_ROTATION_DEG: Final = 10.0
LEAST_POINTS: Final = 100
SHORTEST: Final = 2.0
"""Blocks last at least so many correlation times; sums over shorter ones hold too little of the variance."""
LONGEST: Final = 10.0
"""Longer blocks than so many correlation times hold no more than 90 % of the variance, and are fewer."""
ENOUGH_BLOCKS: Final = 20
"""Blocks are only made longer than the shortest as long as so many are left."""
CELLS: Final = 40
"""Cells that a cloud without times is cut into, about."""
SPARE_BLOCKS: Final = 3
"""So many more blocks than parameters are needed; the spread of fewer says nothing."""


# ---------------------------------------------------------------- registration


@dataclass(frozen=True, slots=True, kw_only=True)
class Registration:
    """Result of `register`.

    ``motion`` brings the cloud onto the reference. ``cov`` (6, 6) is the covariance of (shift east, north, up
    in metres; rotation vector in radians), zero in directions that are held fixed; None if the survey is too
    short to tell: it is worth ``blocks`` time blocks of ``block_s`` seconds, and ``blocks_needed`` are asked
    for. ``visibility`` (6,) says how visible six independent motions are; ``undetermined`` names those that
    were not solved for. ``n`` points took part; ``spread_m`` is the robust standard deviation of their
    distances afterwards.
    """

    motion: Motion
    cov: ArrayF | None
    visibility: ArrayF
    undetermined: tuple[str, ...]
    iterations: int
    n: int
    blocks: float
    block_s: float
    blocks_needed: int
    last_step_m: float
    spread_m: float

    @property
    def rotation_rad(self) -> ArrayF:
        """Rotation vector (3,) in wcs."""
        return np.asarray(Rotation.from_matrix(self.motion.R).as_rotvec())

    def significance(self) -> tuple[float, float] | None:
        """Size of the motion over its covariance, and what that exceeds by chance in 5 % of cases.

        Hotelling's ``F = T^2 (B - p) / (p (B - 1))`` with ``T^2 = x^T C^-1 x`` of ``p`` motions and ``B``
        blocks, against Fisher's distribution for p and B - p degrees of freedom. None without a covariance.
        """
        if self.cov is None:
            return None
        return hotelling(self.motion, self.cov, 6 - len(self.undetermined), self.blocks)


def hotelling(motion: Motion, cov: ArrayF, p: int, n: float) -> tuple[float, float]:
    """Size of a motion over its covariance (6, 6), and what that exceeds by chance in 5 % of cases.

    Parameters
    ----------
    motion, cov : as of `Registration`.
    p : number of motions that were determined.
    n : number of blocks that the covariance rests on.
    """
    x = np.concatenate([motion.shift_m, Rotation.from_matrix(motion.R).as_rotvec()])
    squared = float(x @ np.linalg.pinv(cov, rcond=1e-12, hermitian=True) @ x)
    return squared * (n - p) / (p * (n - 1)), float(fisher.ppf(0.95, p, n - p))


def register(table: pd.DataFrame, surface: Surface, settings: ComparisonSettings) -> Registration:
    """Fit a cloud to a mesh by a rigid motion.

    Parameters
    ----------
    table : kind ``cloud_to_mesh``; the points that are used and not nearest to the border take part, at most
        `MOST_POINTS` of them.
    surface : the reference.
    settings : those of the comparison.

    Raises
    ------
    GeometryError : nothing is determined, too few points, or no convergence near the start.
    """
    points, t_gps_s = _points_of(table, settings)
    fit = _fit(points, surface, settings.max_distance_m)
    known = block_covariance(
        fit.design, fit.psi_m, fit.slope, t_gps_s=t_gps_s[fit.use], correlation_s=settings.correlation_s
    )
    return Registration(
        motion=fit.motion,
        cov=None if known.cov is None else fit.free @ known.cov @ fit.free.T,
        visibility=fit.visibility,
        undetermined=fit.undetermined,
        iterations=fit.iterations,
        n=int(fit.use.sum()),
        blocks=known.blocks,
        block_s=known.block_s,
        blocks_needed=known.needed,
        last_step_m=fit.last_step_m,
        spread_m=fit.spread_m,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacedCloud:
    """Result of `register_places`: a motion, its covariance as of `Registration`, cells that it rests on."""

    motion: Motion
    cov: ArrayF | None
    undetermined: tuple[str, ...]
    n: int
    cells: int
    cell_m: float
    spread_m: float


def register_places(points_m: ArrayF, surface: Surface, max_distance_m: float) -> PlacedCloud:
    """Fit a cloud without times to a mesh by a rigid motion, with a covariance from single places.

    As `register`; the covariance is a jackknife over square cells in plan in place of blocks of time, some
    `CELLS` of them. It holds errors that change within a few cells, and none that the whole cloud shares.

    Parameters
    ----------
    points_m : (n, 3) points that are compared; of more than `MOST_POINTS` a random sample takes part.
    surface : the reference, in the frame of the points.
    max_distance_m : points farther from it take no part.

    Raises
    ------
    GeometryError : as of `register`.
    """
    if len(points_m) < LEAST_POINTS:
        raise GeometryError(f"{len(points_m)} points to register", expected=f"at least {LEAST_POINTS}")
    if len(points_m) > MOST_POINTS:
        rng = np.random.default_rng([0, *b"registration"])
        points_m = points_m[np.sort(rng.choice(len(points_m), MOST_POINTS, replace=False))]
    fit = _fit(points_m, surface, max_distance_m)
    plan = points_m[fit.use, :2]
    span = np.maximum(np.ptp(plan, axis=0), 1e-3)
    cell_m = float(np.sqrt(np.prod(span) / CELLS))
    cell_m = max(cell_m, float(span.max()) / CELLS)  # a cloud as thin as a line
    number = np.floor((plan - plan.min(axis=0)) / cell_m).astype(np.int64)
    _, cell = np.unique(number, axis=0, return_inverse=True)
    n_cells = int(cell.max()) + 1
    p = fit.design.shape[1]
    cov = None
    if n_cells >= p + SPARE_BLOCKS:
        cov = jackknife(*block_sums(fit.design, fit.psi_m, fit.slope, cell.ravel()))
    return PlacedCloud(
        motion=fit.motion,
        cov=None if cov is None else fit.free @ cov @ fit.free.T,
        undetermined=fit.undetermined,
        n=int(fit.use.sum()),
        cells=n_cells,
        cell_m=cell_m,
        spread_m=fit.spread_m,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fit:
    """A converged robust fit: motion, directions ``free`` (6, p), design, psi and slope of its residuals."""

    motion: Motion
    free: ArrayF
    visibility: ArrayF
    undetermined: tuple[str, ...]
    use: ArrayB
    design: ArrayF
    psi_m: ArrayF
    slope: ArrayF
    iterations: int
    last_step_m: float
    spread_m: float


def _fit(points: ArrayF, surface: Surface, max_distance_m: float) -> _Fit:
    """Point-to-plane ICP with Tukey's loss, in the directions that the surface determines."""
    motion = Motion(centre_m=points.mean(axis=0), R=np.eye(3), shift_m=np.zeros(3))
    moved, found = points, surface.distances(points)
    use = _taking_part(found, max_distance_m)
    rates = _rates(moved, found.normal, motion)
    visibility, motions = visible_motions(moved[use], rates[use], motion.centre_m)
    free = motions[:, visibility >= LEAST_VISIBLE]
    if not free.shape[1]:
        raise GeometryError("the surface determines no motion at all", expected="an area with normals")
    iterations, share, size, applied = 0, 1.0, np.inf, np.inf
    while applied > STEP_M and iterations < MOST_ITERATIONS:
        distance = found.distance_m[use]
        weight = tukey(distance)
        design = rates[use] @ free
        normal_matrix = design.T @ (weight[:, None] * design)
        step = np.linalg.solve(normal_matrix, -design.T @ (weight * distance))
        last, size = size, float(np.linalg.norm(step))
        share = share / 2 if size > (1 - LEAST_GAIN * share) * last else share
        motion = motion.followed_by(*np.split(free @ (share * step), 2))
        _refuse_large(motion, max_distance_m)
        moved = motion.apply(points)
        found = surface.distances(moved)
        use = _taking_part(found, max_distance_m)
        rates = _rates(moved, found.normal, motion)
        iterations, applied = iterations + 1, share * size
    spread_m = NMAD * float(np.median(np.abs(found.distance_m[use])))
    if size > max(JITTER * spread_m, STEP_M):
        raise GeometryError(
            f"no convergence in {iterations} iterations; the last step was {1000 * size:.2g} mm",
            expected=f"steps below {100 * JITTER:g} % of the distances' spread of {1000 * spread_m:.2g} mm",
            cure="Is the reference rough or small there? Choose another accuracy.area, or do without "
            "accuracy.registration",
        )
    distance = found.distance_m[use]
    return _Fit(
        motion=motion,
        free=free,
        visibility=visibility,
        undetermined=motions_in_words(motions[:, visibility < LEAST_VISIBLE]),
        use=use,
        design=rates[use] @ free,
        psi_m=tukey(distance) * distance,
        slope=tukey_slope(distance),
        iterations=iterations,
        last_step_m=size,
        spread_m=spread_m,
    )


def _points_of(table: pd.DataFrame, settings: ComparisonSettings) -> tuple[ArrayF, ArrayF]:
    """Places (n, 3) and times (n,) of the points that take part."""
    rows = np.flatnonzero(table["used"].to_numpy() & ~table["at_border"].to_numpy())
    if len(rows) < LEAST_POINTS:
        raise GeometryError(f"{len(rows)} points to register", expected=f"at least {LEAST_POINTS}")
    if len(rows) > MOST_POINTS:
        rng = np.random.default_rng([settings.seed, *b"registration"])
        rows = np.sort(rng.choice(rows, MOST_POINTS, replace=False))
    return table[["east_m", "north_m", "up_m"]].to_numpy()[rows], table["t_gps_s"].to_numpy()[rows]


def _taking_part(found: Distances, max_distance_m: float) -> ArrayB:
    near = np.abs(found.distance_m) <= max_distance_m
    return np.asarray(near & ~found.at_border & found.normal.any(axis=1))


def _rates(points: ArrayF, normal: ArrayF, motion: Motion) -> ArrayF:
    """Change of each distance with the shift and with the rotation vector, (n, 6)."""
    arm = points - (motion.centre_m + motion.shift_m)
    return plane_rates(normal, arm)


def _refuse_large(motion: Motion, max_distance_m: float) -> None:
    angle = float(np.rad2deg(Rotation.from_matrix(motion.R).magnitude()))
    shift, limit = float(np.linalg.norm(motion.shift_m)), 2 * max_distance_m
    if angle > LARGEST_ROTATION_DEG or shift > limit:
        raise GeometryError(
            f"the registration wanders off: {shift:.2f} m, {angle:.1f} degrees",
            expected=f"at most {limit:g} m and {LARGEST_ROTATION_DEG:g} degrees",
            cure="Enlarge the area, or compare without registration",
        )


# ---------------------------------------------------------------- covariance of a robust fit to points that
# share the errors of their poses: a jackknife over time blocks
#
# Points of one moment err together, those of another by themselves; how errors are alike within a moment, by
# the place, the range or a tilt, need not be known. The survey is cut into ``B`` blocks of time. With the
# residuals ``e``, their rates ``D`` of change with the parameters and a robust weight ``w(e)``, each block
# has a score and a curvature,
#
#     g_b = sum w e D^T,    H_b = sum psi'(e) D^T D,    psi(e) = w(e) e
#
# and the fit without block ``b`` differs from that with all by ``(H - H_b)^-1 g_b``, ``H = sum H_b``. Then
#
#     cov = c (B - 1) / B sum_b d_b d_b^T,    d_b = (H - H_b)^-1 g_b       (CV3: MacKinnon, Nielsen, Webb
#     2023)
#
# Three things matter, and each alone makes sigmas too small. Residuals are smaller than errors where a block
# rules the fit: leaving it out shows that. A robust fit holds on to its points by the slope of ``psi``, not
# by the weights, which are larger (Huber 1981, 7.6). Neighbouring blocks are not independent: with errors of
# correlation time ``tau`` the sums over blocks of length ``L`` hold a share of the variance, and ``c`` is its
# inverse,
#
#     1 / c = 1 - (tau / L) (1 - exp(-L / tau))
#
# For ``L = 2 tau`` this is 0.57. Errors that are white in time would need no ``c``: for them sigmas are up to
# a third too large. Therefore blocks are longer where the survey is long enough for many of them.


@dataclass(frozen=True, slots=True, kw_only=True)
class BlockCovariance:
    """Result of `block_covariance`.

    ``cov`` (p, p), or None if there are too few blocks or a parameter rests on one of them. ``blocks`` is the
    effective number of blocks, ``(sum n)^2 / sum n^2`` (Kish 1965), each ``block_s`` long; ``needed`` so many
    are asked for.
    """

    cov: ArrayF | None
    blocks: float
    block_s: float
    needed: int


def time_blocks(t_gps_s: ArrayF, correlation_s: float) -> tuple[ArrayI, float]:
    """The block (n,) of each point, from 0 without gaps, and the length of the blocks in seconds.

    Times without points count for nothing, so a survey in several passes has as many blocks as it measured.
    """
    since = t_gps_s - t_gps_s.min()
    shortest = SHORTEST * correlation_s
    measured_s = shortest * len(np.unique(np.floor(since / shortest)))
    length = float(np.clip(measured_s / ENOUGH_BLOCKS, shortest, LONGEST * correlation_s))
    number = np.unique(np.floor(since / length), return_inverse=True)[1]
    return np.asarray(number, dtype=np.int64), length


def share_within_blocks(block_s: float, correlation_s: float) -> float:
    """Share of the variance of a sum of Gauss-Markov errors that sums over blocks hold.

    Examples
    --------
    >>> [round(share_within_blocks(k, 1.0), 2) for k in (2.0, 4.0, 10.0)]
    [0.57, 0.75, 0.9]
    """
    ratio = correlation_s / block_s
    return float(1 + ratio * np.expm1(-1 / ratio))


def block_covariance(
    design: ArrayF, psi_m: ArrayF, slope: ArrayF, *, t_gps_s: ArrayF, correlation_s: float
) -> BlockCovariance:
    """Covariance of the parameters of a converged robust fit.

    Parameters
    ----------
    design : (n, p) change of each residual with the parameters.
    psi_m : (n,) weight times residual.
    slope : (n,) derivative of that with respect to the residual.
    t_gps_s : (n,) time of each point.
    correlation_s : correlation time of the slowest error that changes.
    """
    number, length = time_blocks(t_gps_s, correlation_s)
    n_points = np.bincount(number).astype(np.float64)
    p = design.shape[1]
    effective = float(n_points.sum() ** 2 / np.sum(n_points**2))
    cov = None
    if effective >= p + SPARE_BLOCKS:
        cov = jackknife(*block_sums(design, psi_m, slope, number))
    if cov is not None:
        cov = cov / share_within_blocks(length, correlation_s)
    return BlockCovariance(cov=cov, blocks=effective, block_s=length, needed=p + SPARE_BLOCKS)


def block_sums(design: ArrayF, psi_m: ArrayF, slope: ArrayF, number: ArrayI) -> tuple[ArrayF, ArrayF]:
    """Score (blocks, p) and curvature (blocks, p, p) of each block, for `jackknife`.

    Parameters
    ----------
    design, psi_m, slope : as of `block_covariance`.
    number : (n,) block of each point, 0 ... .
    """
    p = design.shape[1]
    score: ArrayF = np.stack([np.bincount(number, weights=psi_m * d) for d in design.T], axis=1)
    curvature = np.empty((len(score), p, p))
    for i in range(p):
        for j in range(i + 1):
            sums = np.bincount(number, weights=slope * design[:, i] * design[:, j])
            curvature[:, i, j] = curvature[:, j, i] = sums
    return score, curvature
