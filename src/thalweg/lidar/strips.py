r"""Strips adjusted: surfaces that the lidar saw on several passes correct the trajectory, with covariances.

A measured point is ``x = x_true + e`` with what the pose, the mount and the scanner err,

    e = dx(t) + dtheta(t) x (x - X) + R (theta_m x R_m x_s + l_m) + r_0 ray + (v + omega x (x - X)) tau

with the errors ``dx, dtheta`` of the ics origin and of the attitude in the world, those of the mount
``theta_m, l_m``, one offset ``r_0`` of all ranges and one ``tau`` of the scanner's clock. Where a cell of the
bank is plane, with the normal ``n``, all of its points of one span of time make one observation of

    n . (mean x) = a_0 + a_1 u + a_2 v + n . e + noise

whose plane ``a`` is nobody's business and eliminated cell by cell. What is left are normal equations ``N y =
h`` of the mean errors of the poses in even spans of time (the knots) and of the border of mount, range and
clock, and of the datum of stable surfaces, whose points observe the same planes. Their prior covariance
``K`` is that of the trajectory that the adjustment starts from
(`thalweg.core.ErrorChain`): of INS and GNSS, of the camera, of all sensors. With ``K = L L'`` the most
probable errors and their covariance are

    y = L (1 + L' N L)^-1 L' h,      Q = L (1 + L' N L)^-1 L'

which needs no inverse of ``K`` and leaves what nothing tells at its prior. ``1 - Q_ii / K_ii`` is the share
of an unknown that the bank told. The matrices are dense: places seen again after any time join any two
knots. Memory grows with the square of the knots and not with the points, of which each cell keeps a few for
each span.

Robust weights are Huber's (1964) as long as the planes are those of the uncorrected cloud, then Tukey's
biweight; sigmas of the observations are those of the scatter about each plane in one moment, times a factor
for smooth, middling and rough planes each, from the residuals. Planes are found anew with the corrected
poses in each round (Glira, Pfeifer and Mandlburger 2016, who adjust airborne strips by such correspondences).
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import scipy.sparse as sp
from scipy.linalg import block_diag, cho_solve, cholesky, solve_triangular
from scipy.linalg.blas import dtrmm
from scipy.linalg.lapack import dtrtri
from scipy.sparse.linalg import LinearOperator, cg
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from scipy.special import expit, logit
from scipy.stats import norm

from thalweg.core import (
    SHIFT,
    TURN,
    ArrayF,
    ArrayI,
    CoverageError,
    ErrorChain,
    InputError,
    LocalFrame,
    Rigid,
    Trajectory,
    covariance_of_means,
    cross_matrix,
    plane_rates,
    robust_sigma,
    root_mean_square,
    steps,
    with_rest,
    write_chains,
)
from thalweg.core.calibration import Calibration, Source, pose_block
from thalweg.ingest import LidarClock, LidarReader
from thalweg.ingest.clouds import read_cloud, to_world
from thalweg.lidar.cloud import LogSample, LogSettings, kept_points
from thalweg.lidar.overlap import (
    CELL_M,
    LEAST_PLANES,
    ROUGHNESS,
    THICKEST_M,
    Planes,
    joined_by_epoch,
    plane_basis,
    planes_seen_again,
    scatter_about,
    sums,
    without_planes,
)
from thalweg.settings.sections import Strips

ROUNDS: Final = 3
"""Times that planes are found; the third moves poses by less than a tenth of their sigmas."""
SOLUTIONS: Final = 3
"""Solutions with new weights a round."""
HUBER_LIMIT: Final = 1.5
"""Standardised residual at which Huber's weights begin to fall, as in `thalweg.core.adjustment`."""
TUKEY_LIMIT: Final = 4.685
"""Standardised residual beyond which an observation counts nothing: 95 % efficient on normal errors."""
LONGEST_KNOT_S: Final = 2.0
LEAST_SIGMA: Final = 1e-9
"""Of an unknown that is not asked for."""
MOST_POINTS: Final = 2_000_000
"""Of longer logs a half, a quarter ... of the points is kept, so that memory grows with the knots alone."""
A_CELL: Final = 4
SAME_S: Final = 0.5
"""Points of a cell and so many seconds that are kept: the scatter of more is roughness that they share."""
PLACE_M: Final = 5.0
"""Length of bank that is one place where planes are chosen evenly."""
REACH_M: Final = 1.5
ALIKE_RAD: Final = float(np.deg2rad(3.0))
"""Planes so near and so alike in direction are one surface."""
LEAST_FREEDOM: Final = 8
LEAST_SPANS: Final = 3
"""A plane tells something with so many degrees of freedom of its scatter, seen in so many spans of time."""
ON_CORNER: Final = Rotation.from_euler("ZX", [-np.pi / 4, -np.arctan(np.sqrt(2.0))]).as_matrix()
"""Turns the scene (wcs) so that cells stand on a corner. A side of a cell that runs along a wall or a floor
cuts off the points that err most to one side, and the rest lie as if ranges were off by millimetres; so
turned, sides meet all that is upright or level at 35 degrees and more."""
GROUPS: Final = ("smooth", "middling", "rough", "stable")
STABLE: Final = GROUPS.index("stable")
LEAST_STABLE: Final = 5
"""Points of a stable surface that a cell needs."""
NEAR: Final = 1e-8
"""Of solutions between the factors, relative; the last one has its own factor."""
LEAST_TOLD: Final = 0.2
"""An unknown of which the bank told a smaller share of the variance stays as it was."""
BORDER: Final = (
    *(f"mount rotation {a} [rad]" for a in "xyz"),
    *(f"mount shift {a} [m]" for a in "xyz"),
    "range offset [m]",
    "clock offset [s]",
    *(f"stable surfaces {a} [m]" for a in ("east", "north", "up")),
    *(f"stable surfaces rotation {a} [rad]" for a in ("east", "north", "up")),
)
SCANNER: Final = 8
"""Unknowns of the border that move the points of the boat; the others move the stable surfaces."""
SURE: Final = 5.0
"""Poses that are corrected by more or less than stated are named where it is so many times what chance makes
of it."""
ODD: Final = 0.05
"""Share of surveys without a fault in which any unknown of the border is named."""
WRONG: Final = 0.05
"""Share of what is stated of a mount, of range or clock that is taken to be wrong before the survey."""
SETTINGS: Final = {
    "range offset [m]": "sigma_range_m",
    "clock offset [s]": "sigma_clock_s",
    **dict.fromkeys(BORDER[SCANNER:], "sigma_stable_shift_m"),
}
"""Settings of section ``strips`` that ask for an unknown."""
POSE: Final = ("east", "north", "up", "rotation east", "rotation north", "rotation up")


@dataclass(frozen=True, slots=True, kw_only=True)
class Adjusted:
    """What strips say of a trajectory.

    Attributes
    ----------
    trajectory : corrected poses with their covariances.
    mount : corrected pose of the scanner on the boat, with its covariance.
    of_lidar : the same poses with the covariances that its points have of poses and mount together: their
        errors are told from each other worse than both together are known. With it the mount is exact. Its
        times are those of the lidar's clock, where an offset of that was asked for.
    chains, chains_of_lidar : how the errors of each of both hang together over time.
    knots : one row a span: ``t_gps_s``, and for each of `POSE` the correction, its sigma before and after,
        and the ``told`` share; ``observations``.
    border : one row for each unknown of mount, range and clock: value, sigma before and after, ``told``.
    observations : ``t_gps_s``, ``range_m``, ``before_m``, ``after_m`` (distances from the plane of all
        passes), ``z`` (residual by its sigma), ``weight``, and ``group`` of each.
    facts : JSON-able.
    """

    trajectory: Trajectory
    mount: Rigid
    of_lidar: Trajectory
    chains: list[ErrorChain]
    chains_of_lidar: list[ErrorChain]
    knots: pd.DataFrame
    border: pd.DataFrame
    observations: pd.DataFrame
    facts: dict[str, Any]

    def write(self, folder: Path) -> None:
        """Write poses for the boat and for the lidar's points, their errors, the mount, tables and facts."""
        self.trajectory.write(folder / "trajectory_strips.parquet")
        self.of_lidar.write(folder / "trajectory_strips_lidar.parquet")
        write_chains(folder / "errors_strips.npz", self.chains)
        write_chains(folder / "errors_strips_lidar.npz", self.chains_of_lidar)
        for name in ("knots", "border", "observations"):
            getattr(self, name).to_csv(folder / f"strips_{name}.csv", index=False, float_format="%.9g")
        mount = {"R_ics_scs": self.mount.R.tolist(), "lever_ics_m": self.mount.shift_m.tolist()}
        facts = self.facts | {"mount": mount}
        (folder / "strips.json").write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")


def mounts_by_strips(mounts: Mapping[str, Any], found: Adjusted) -> dict[str, Any]:
    """Mounts of a boat with the lidar where strips put it, exact beside the poses `Adjusted.of_lidar`."""
    block, cov = pose_block("lidar", found.mount.with_cov(np.zeros((6, 6))))
    source = Source(run="", method="overlapping strips of the survey")
    placed = Calibration(title="lidar by strips", blocks=(block,), cov=cov, source=source).to_mounts()[
        "lidar"
    ]
    return {**mounts, "lidar": {**placed, "source": source.method}}


def adjust_strips(
    points: LogSample,
    trajectory: Trajectory,
    mount: Rigid,
    chains: Sequence[ErrorChain],
    settings: Strips,
    stable_m: ArrayF | None = None,
) -> Adjusted:
    """Correct a trajectory by the surfaces that the lidar saw again.

    Parameters
    ----------
    points : of the whole survey, made with ``trajectory`` and ``mount``: see `thin_log`.
    trajectory : poses to correct.
    mount : of the scanner, with its covariance.
    chains : how the errors of the poses hang together: of `PoseCorrelation.chains` for INS and GNSS,
        or those of a trajectory by camera or by all sensors.
    settings : section ``strips``.
    stable_m : (k, 3) points in wcs of surfaces that are known, of a terrestrial scan or an earlier epoch.

    Raises
    ------
    CoverageError : fewer plane spots than `thalweg.lidar.overlap.LEAST_PLANES` were seen again, or none of
        the stable surfaces among them.
    """
    edges = knots_over(trajectory, settings)
    task = _Task(
        points, trajectory, mount, edges, settings, np.empty((0, 3)) if stable_m is None else stable_m
    )
    sigma = np.concatenate([np.sqrt(np.diag(mount.cov)[np.r_[TURN, SHIFT]]), task.sigma_fixed])
    K = covariance_of_means(chains, edges)
    before = _chain("before", task.centre, *_neighbours(K))
    K = block_diag(K, np.diag(np.maximum(sigma, LEAST_SIGMA) ** 2))
    prior = np.diag(K).copy()
    K[np.diag_indices_from(K)] += 1e-9 * prior
    L = cholesky(K, lower=True, overwrite_a=True, check_finite=False)
    y, grown = np.zeros(len(L)), 1.0
    for round_ in range(ROUNDS):
        seen = task.observe(y)
        N, h = seen.equations()
        y, G = _solved(L, N, h)
        seen.weigh(y, tukey=round_ > 0)
        for _ in range(SOLUTIONS - 1):
            y = _solved_near(L, *seen.equations(), G, y)
            seen.weigh(y, tukey=round_ > 0)
        if round_ == ROUNDS - 2:
            # less than 1 by chance would be a sigma that is too small: the stated one stays
            grown = max(_expected(L, dtrtri(G, lower=1)[0], y)["corrections_over_stated"], 1.0)
            L[: 6 * task.n_spans] *= np.sqrt(grown)
    # of the last weights
    N, h = seen.equations()
    y, G = _solved(L, N, h)
    return _result(task, seen, y, (N, h), L, G, prior, before, grown)


def knots_over(trajectory: Trajectory, settings: Strips) -> ArrayF:
    """Edges (b + 1,) of the spans: as short as asked, unless that makes too many of them.

    Raises
    ------
    CoverageError : the log is so long that spans would be too long for the poses' errors.
    """
    first, last = trajectory.span()
    step = max(settings.knot_s, (last - first) / settings.max_knots)
    if step > LONGEST_KNOT_S:
        raise CoverageError(
            f"a survey of {last - first:.0f} s: {settings.max_knots} knots would be {step:.1f} s apart",
            expected=f"knots at most {LONGEST_KNOT_S:g} s apart",
            cure="Set strips.max_knots higher (memory grows with its square), or cut the log into parts",
        )
    return np.linspace(first, last, max(int(np.ceil((last - first) / step)), 2) + 1)


def read_stable(files: Sequence[Path], frame: LocalFrame, crs: str | None) -> tuple[ArrayF, list[str]]:
    """Points (k, 3) of stable surfaces in wcs, and what was assumed or noticed.

    Parameters
    ----------
    files : LAS, LAZ, PLY, E57.
    frame : wcs.
    crs : map grid of files that state none.

    Raises
    ------
    InputError : a file is unreadable, or its grid is not known.
    GeometryError : it lies elsewhere.
    """
    parts, notes = [np.empty((0, 3))], list[str]()
    for path in files:
        cloud = read_cloud(path)
        if cloud.frame is None and crs is None:
            raise InputError(
                "the cloud of stable surfaces states no CRS",
                expected="a map grid, or the local frame of the trajectory",
                where=path,
                cure="Name its map grid with --crs",
            )
        xyz, note = to_world(cloud.points, cloud.frame, frame, str(crs), path)
        parts.append(xyz)
        notes += [*filter(None, [note]), *(f"{path.name}: {sentence}" for sentence in cloud.sentences())]
    return np.concatenate(parts), notes


def thin_log(
    reader: LidarReader, clock: LidarClock, trajectory: Trajectory, settings: LogSettings
) -> LogSample:
    """A few points of each cell and span of time of a whole log, above the water.

    Parameters
    ----------
    reader, clock, trajectory, settings : as for `thalweg.lidar.cloud.georeference_log`.
    """
    parts, share = [np.empty((0, 6))], 1.0
    rng = np.random.default_rng(1)
    for block in steps(reader.points(clock, max_points=settings.chunk_points), "strips, block"):
        rows = kept_points(block, trajectory, settings)
        if not len(rows):
            continue
        key = np.floor(np.column_stack([rows[:, :3] / CELL_M, rows[:, 3] / SAME_S])).astype(np.int64)
        key -= key.min(axis=0)
        cell = np.ravel_multi_index(tuple(key.T), tuple(key.max(axis=0) + 1))
        order = rng.permutation(len(cell))
        order = order[np.argsort(cell[order], kind="stable")]
        first = np.flatnonzero(np.diff(cell[order], prepend=-1))
        turn = np.arange(len(cell)) - np.repeat(first, np.diff(first, append=len(cell)))
        found = rows[np.sort(order[turn < A_CELL])]
        parts.append(found if share == 1.0 else found[rng.random(len(found)) < share])
        while sum(map(len, parts)) > MOST_POINTS:
            share /= 2
            parts = [part[rng.random(len(part)) < 0.5] for part in parts]
    rows = np.concatenate(parts)
    return LogSample(xyz_wcs_m=rows[:, :3], t_gps_s=rows[:, 3], range_m=rows[:, 4], reflectivity=rows[:, 5])


def _solved(L: ArrayF, N: ArrayF, h: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Most probable errors (u,), and the Cholesky factor G of ``1 + L' N L``."""
    M = dtrmm(1.0, L, dtrmm(1.0, L, N, side=1, lower=1), side=0, lower=1, trans_a=1)
    M[np.diag_indices_from(M)] += 1.0
    G = cholesky(M, lower=True, overwrite_a=True, check_finite=False)
    return np.asarray(L @ cho_solve((G, True), L.T @ h, check_finite=False)), G


def _solved_near(L: ArrayF, N: ArrayF, h: ArrayF, G: ArrayF, y: ArrayF) -> ArrayF:
    """The same (u,) by conjugate gradients from the factor G and the errors y of somewhat other weights.

    A few products with matrices in place of a factor: a round takes one factor and not three.
    """
    shape = L.shape
    M = LinearOperator(shape, matvec=lambda x: x + L.T @ (N @ (L @ x)))
    inverse = LinearOperator(shape, matvec=lambda x: cho_solve((G, True), x, check_finite=False))
    start = solve_triangular(L, y, lower=True, check_finite=False)
    found, _ = cg(M, L.T @ h, start, rtol=NEAR, M=inverse)
    return np.asarray(L @ found)


class _Task:
    """The points of a survey, and how they move with the unknowns."""

    def __init__(
        self,
        points: LogSample,
        trajectory: Trajectory,
        mount: Rigid,
        edges: ArrayF,
        settings: Strips,
        stable_m: ArrayF,
    ) -> None:
        inside = (points.t_gps_s >= edges[0]) & (points.t_gps_s < edges[-1])
        self.x, self.t, self.range_m = (a[inside] for a in (points.xyz_wcs_m, points.t_gps_s, points.range_m))
        self.trajectory, self.mount, self.edges, self.settings = trajectory, mount, edges, settings
        self.n_spans = len(edges) - 1
        self.centre = (edges[1:] + edges[:-1]) / 2
        self.boat, self.R, _ = trajectory.at(self.t)
        velocity, turning = trajectory.rates()
        before = np.searchsorted(trajectory.t_gps_s, self.t, side="right") - 1
        step = np.clip(before, 0, len(velocity) - 1)
        self.velocity = velocity[step] + np.cross(turning[step], self.x - self.boat)
        span = np.clip(np.searchsorted(edges, self.t, side="right") - 1, 0, self.n_spans - 1)
        amid, R_amid, _ = trajectory.at(self.centre)
        self.arm, self.R_span = self.x - amid[span], R_amid[span]
        at_edge, R_edge, _ = trajectory.at(edges)
        turned = Rotation.from_matrix(R_edge[1:] @ np.swapaxes(R_edge[:-1], 1, 2)).as_rotvec()
        moved = np.hstack([np.diff(at_edge, axis=0), turned]) / np.diff(edges)[:, None]
        self.velocity_span = moved[span, :3] + np.cross(moved[span, 3:], self.arm)
        self.stable = stable_m
        self.stable_arm = stable_m - (stable_m.mean(axis=0) if len(stable_m) else 0.0)
        # a rotation about their middle moves stable surfaces as far as their shift does, root mean square
        shift_m = settings.sigma_stable_shift_m
        reach_m = np.linalg.norm(self.stable_arm) / np.sqrt(max(len(stable_m), 1))
        self.sigma_fixed = np.repeat(
            [settings.sigma_range_m, settings.sigma_clock_s, shift_m, shift_m / max(reach_m, 1.0)],
            [1, 1, 3, 3],
        )

    def errors_at(self, y: ArrayF, t: ArrayF) -> ArrayF:
        """Errors (n, 6) of the poses at times."""
        means = y[: 6 * self.n_spans].reshape(-1, 6)
        return np.stack([np.interp(t, self.centre, column) for column in means.T], axis=1)

    def border_rows(self, vector: ArrayF, arm: ArrayF, R: ArrayF, velocity: ArrayF) -> ArrayF:
        """Derivatives (n, 8) of points along vectors (n, 3) by mount, range and clock.

        ``arm`` (n, 3) from the ics origin to the points, ``R`` (n, 3, 3) and the points' ``velocity`` (n, 3)
        are those of the moment, or of its span.
        """
        own = np.einsum("nji,nj->ni", R, vector)
        arm = np.einsum("nji,nj->ni", R, arm) - self.mount.shift_m
        ray = np.sum(own * arm, axis=1) / np.maximum(np.linalg.norm(arm, axis=1), 1e-9)
        late = np.sum(vector * velocity, axis=1)
        return np.column_stack([np.cross(arm, own), own, ray, late])

    def places(self, y: ArrayF) -> ArrayF:
        """The points (n, 3) without the errors ``y``."""
        e = self.errors_at(y, self.t)
        border = y[6 * self.n_spans :][:SCANNER]
        moved = np.stack(
            [
                self.border_rows(axis, self.x - self.boat, self.R, self.velocity) @ border
                for axis in np.broadcast_to(np.eye(3)[:, None], (3, *self.x.shape))
            ],
            axis=1,
        )
        arm = self.x - moved - self.boat
        return np.asarray(self.boat - e[:, :3] + Rotation.from_rotvec(-e[:, 3:]).apply(arm))

    def observe(self, y: ArrayF) -> "_Seen":
        """Planes of the points as far as they are corrected, and what they observe.

        Raises
        ------
        CoverageError : too few planes.
        """
        x = self.places(y)
        found = planes_seen_again(x @ ON_CORNER.T, self.t, self.settings.max_planes, _place)
        planes = replace(found, centre_m=found.centre_m @ ON_CORNER, axes=ON_CORNER.T @ found.axes)
        k, owner = planes.order, planes.owner
        normals = _with_neighbours(planes)
        axes, normal = planes.axes[owner], normals[owner]
        from_centre = x[k] - planes.centre_m[owner]
        local = np.einsum("ni,nij->nj", from_centre, axes)
        off = np.einsum("ni,ni->n", from_centre, normal)
        since, span = self.t[k] - self.edges[0], float(self.edges[1] - self.edges[0])
        scatter, freedom = scatter_about(local[:, 0], owner, since, planes.n)
        joined, owner = joined_by_epoch(owner, since, span, float(self.edges[-1] - self.edges[0]))
        n = np.bincount(joined).astype(np.float64)
        # By the pose amid the span. How the boat moves within it would seem to tell a tilt or the mount from
        # the slope of the distances in time, but the errors have slopes of their own there.
        pose = np.concatenate([normal, np.cross(self.arm[k], normal)], axis=1)
        border = self.border_rows(normal, self.arm[k], self.R_span[k], self.velocity_span[k])
        by_errors = (
            np.sum(pose * self.errors_at(y, self.t[k]), axis=1) + border @ y[6 * self.n_spans :][:SCANNER]
        )
        columns = np.column_stack([off + by_errors, local[:, 1:], since, self.range_m[k], pose, border])
        mean = sums(columns, joined, len(n)) / n[:, None]
        enough = (freedom >= LEAST_FREEDOM) & (np.bincount(owner, minlength=planes.n) >= LEAST_SPANS)
        keep = enough[owner]
        n_planes = len(np.unique(owner[keep]))
        if n_planes < LEAST_PLANES:
            raise CoverageError(
                f"{n_planes} plane spots of the bank were seen again",
                expected=f"at least {LEAST_PLANES}, each with {LEAST_SPANS} spans of "
                f"{span:.2g} s and a thickness of some centimetres",
                cure="Pass the bank again, nearer or from another side; check the trajectory and the clock "
                "of the lidar, whose errors spread what is plane",
            )
        mean, n, owner = mean[keep], n[keep], owner[keep]
        variance = scatter[owner] * (1 / n + ROUGHNESS)
        tercile = np.searchsorted(np.quantile(scatter[enough], [1 / 3, 2 / 3]), scatter[owner])
        own = _Seen(
            d=mean[:, 0], uv=mean[:, 1:3], owner=owner, range_m=mean[:, 4],
            t_gps_s=mean[:, 3] + self.edges[0], group=tercile, sigma=np.sqrt(variance),
            A=self._design(mean[:, 3], span, mean[:, 5:11], mean[:, 11:]), n_planes=n_planes,
        )  # fmt: skip
        if not len(self.stable):
            return own
        return own.beside(self._stable(y, np.unique(owner), planes, normals))

    def _stable(self, y: ArrayF, which: ArrayI, planes: Planes, normals: ArrayF) -> "_Seen":
        """What the stable surfaces observe of planes: one mean of their points in each cell."""
        centre, normal, axes = planes.centre_m[which], normals[which], planes.axes[which]
        errs = y[6 * self.n_spans + SCANNER :]
        moved = errs[:3] + np.cross(errs[3:], self.stable_arm)
        near: Any = cKDTree(self.stable - moved).query_ball_point(centre, CELL_M / 2)
        owner = np.repeat(np.arange(len(which)), [len(each) for each in near])
        k = np.concatenate([np.empty(0, np.int64), *near]).astype(np.int64)
        from_centre = self.stable[k] - moved[k] - centre[owner]
        off = np.einsum("ni,ni->n", from_centre, normal[owner])
        on = np.abs(off) < THICKEST_M
        k, owner, off, from_centre = k[on], owner[on], off[on], from_centre[on]
        pose = plane_rates(normal[owner], self.stable_arm[k])
        local = np.einsum("ni,nij->nj", from_centre, axes[owner])[:, 1:]
        n = np.bincount(owner, minlength=len(which)).astype(np.float64)
        columns = np.column_stack([off + pose @ errs, off, off**2, local, pose])
        mean = sums(columns, owner, len(which)) / np.maximum(n, 1)[:, None]
        scatter = np.maximum(mean[:, 2] - mean[:, 1] ** 2, 0.0) / np.maximum(n, 1)
        good = n >= LEAST_STABLE
        if not good.any():
            raise CoverageError(
                f"none of {len(self.stable):,} points of stable surfaces lies on a plane seen again",
                expected=f"cells of {CELL_M:g} m with {LEAST_STABLE} of them within {THICKEST_M:g} m",
                cure="Check that both are in the same coordinates and heights, or state how far the surfaces "
                "may be off with strips.sigma_stable_shift_m and bring them that near",
            )
        none = np.full(int(good.sum()), np.nan)
        of_boat = sp.csr_matrix((len(none), 6 * self.n_spans + SCANNER))
        return _Seen(
            d=mean[good, 0], uv=mean[good, 3:5], owner=which[good], range_m=none, t_gps_s=none,
            group=np.full(len(none), STABLE), sigma=np.sqrt(self.settings.sigma_stable_m**2 + scatter[good]),
            A=sp.hstack([of_boat, sp.csr_matrix(mean[good, 5:])]).tocsr(), n_planes=0,
        )  # fmt: skip

    def _design(self, since: ArrayF, span_s: float, pose: ArrayF, border: ArrayF) -> sp.csr_matrix:
        of = np.clip((since / span_s).astype(np.int64), 0, self.n_spans - 1)
        column = 6 * of[:, None] + np.arange(6)
        row = np.repeat(np.arange(len(of)), 6)
        own = sp.csr_matrix((pose.ravel(), (row, column.ravel())), shape=(len(of), 6 * self.n_spans))
        of_stable = sp.csr_matrix((len(of), len(BORDER) - SCANNER))
        return sp.hstack([own, sp.csr_matrix(border), of_stable]).tocsr()


def _with_neighbours(planes: Planes) -> ArrayF:
    """Normals (p, 3), each the mean of those of planes near by that go on in it.

    A normal's own error lets a shift along the plane seem to be seen: of one cell of a wall by a hundredth of
    what is seen across, which thousands of cells add up to a figure for what no wall tells.
    """
    n, c = planes.axes[:, :, 0], planes.centre_m
    i, j = cKDTree(c).query_pairs(REACH_M, output_type="ndarray").T
    i, j = np.concatenate([i, j]), np.concatenate([j, i])
    same = np.einsum("ni,ni->n", n[i], n[j])
    goes_on = np.abs(same) > np.cos(ALIKE_RAD)
    goes_on &= np.abs(np.einsum("ni,ni->n", c[j] - c[i], n[i])) < REACH_M * ALIKE_RAD
    i, j, same = i[goes_on], j[goes_on], same[goes_on]
    mean = n + sums(n[j] * np.sign(same)[:, None], i, len(n))
    return np.asarray(mean / np.linalg.norm(mean, axis=1, keepdims=True))


def _place(centre: ArrayF, normal: ArrayF) -> ArrayI:
    """Number of the stretch of bank and of the direction that planes look in: 26 of these."""
    centre, normal = centre @ ON_CORNER, normal @ ON_CORNER
    at = np.floor(centre[:, :2] / PLACE_M).astype(np.int64)
    upward = normal * np.where(normal[:, 2:] < 0, -1.0, 1.0)
    key = np.column_stack([at, np.rint(1.2 * upward).astype(np.int64)])
    return np.asarray(np.unique(key, axis=0, return_inverse=True)[1].ravel())


@dataclass(slots=True, kw_only=True)
class _Seen:
    """Observations of a round; ``A`` their derivatives by all unknowns, ``sigma`` as the scatter says."""

    d: ArrayF
    uv: ArrayF
    owner: ArrayI
    range_m: ArrayF
    t_gps_s: ArrayF
    group: ArrayI
    sigma: ArrayF
    A: sp.csr_matrix
    n_planes: int
    robust: ArrayF | None = None
    factors: ArrayF | None = None
    z: ArrayF | None = None

    def beside(self, other: "_Seen") -> "_Seen":
        """The observations of both, of the planes of the first."""
        names = ("d", "uv", "owner", "range_m", "t_gps_s", "group", "sigma")
        joined = {name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in names}
        return _Seen(**joined, A=sp.vstack([self.A, other.A]).tocsr(), n_planes=self.n_planes)

    def root_weight(self) -> ArrayF:
        """One over the sigmas (m,), with the factors of the groups and robust weights."""
        robust = 1.0 if self.robust is None else np.sqrt(np.maximum(self.robust, 1e-6))
        factors = np.ones(len(GROUPS)) if self.factors is None else self.factors
        return np.asarray(robust / (self.sigma * factors[self.group]))

    def equations(self) -> tuple[ArrayF, ArrayF]:
        """Normal equations without the planes."""
        root = self.root_weight()
        basis = plane_basis(self.owner, self.uv, root)
        return without_planes(sp.diags(root) @ self.A, root * self.d, basis)

    def from_planes_m(self, y: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Distances (m,) from each plane with errors ``y``, and the shares (m,) that the planes left."""
        root = self.root_weight()
        basis = plane_basis(self.owner, self.uv, root)
        left = root * (self.d - self.A @ y)
        left -= basis @ (basis.T @ left)
        return left / root, np.clip(1.0 - np.asarray(basis.power(2).sum(axis=1)).ravel(), 0.05, 1.0)

    def weigh(self, y: ArrayF, *, tukey: bool) -> None:
        """New factors of the groups and robust weights from the residuals."""
        left, free = self.from_planes_m(y)
        z = left / self.sigma / np.sqrt(free)
        of_group = [z[self.group == g] for g in range(len(GROUPS))]
        factors = [robust_sigma(each, 0.0) if len(each) else 1.0 for each in of_group]
        self.factors = np.maximum(factors, [0.3] * STABLE + [1.0])
        self.z = z / self.factors[self.group]
        size = np.abs(self.z)
        if tukey:
            self.robust = np.clip(1.0 - (size / TUKEY_LIMIT) ** 2, 0.0, None) ** 2
        else:
            self.robust = np.minimum(1.0, HUBER_LIMIT / np.maximum(size, 1e-9))


def _neighbours(K: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Covariances (b, 6, 6) of spans, and with the next span, of a covariance (6 b, 6 b)."""
    n = len(K) // 6
    blocks = K.reshape(n, 6, n, 6)
    own, k = np.arange(n), np.arange(n - 1)
    following = np.zeros((n, 6, 6))
    following[:-1] = blocks[k, :, k + 1]
    return blocks[own, :, own].copy(), following


def _chain(name: str, t_gps_s: ArrayF, own: ArrayF, following: ArrayF) -> ErrorChain:
    pose = np.tile(np.eye(6), (len(t_gps_s), 1, 1))
    return ErrorChain.of_covariances(name, t_gps_s, own, following, pose, step_s=0.0)


def _positive_part(cov: ArrayF) -> ArrayF:
    """Covariances (n, 6, 6) without negative eigenvalues, metres beside radians in one scale."""
    scale = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2), 0.0).mean(axis=0))
    scale = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(cov / scale[:, None] / scale)
    vectors *= scale[:, None]
    return np.asarray(vectors * np.maximum(values, 0.0)[:, None, :] @ np.swapaxes(vectors, 1, 2))


def _result(
    task: _Task,
    seen: _Seen,
    y: ArrayF,
    equations: tuple[ArrayF, ArrayF],
    L: ArrayF,
    G: ArrayF,
    prior: ArrayF,
    before: ErrorChain,
    grown: float,
) -> Adjusted:
    """Corrected trajectory and mount, and what the adjustment says of itself."""
    n_spans, u = task.n_spans, 6 * task.n_spans
    inverse = dtrtri(G, lower=1)[0]
    F = np.asarray(inverse @ L.T)  # F' F is the covariance
    expected = _expected(L, inverse, y)
    expected["corrections_over_stated"] *= grown
    expects = prior * np.where(np.arange(len(prior)) < u, grown, 1.0)
    found = claims(*_border_alone(equations, L, G), prior[u:])
    for i, claim in found.items():
        if prior[u + i] > (10 * LEAST_SIGMA) ** 2:
            # all else hangs on the unknown as its covariance says
            along = F.T @ F[:, u + i]
            along /= along[u + i]
            y = y + claim.shift * along
            F = np.vstack([F, np.sqrt(claim.variance) * along])
            expects[u + i] += claim.widened_by
    by_span = np.ascontiguousarray(F[:, :u].reshape(len(F), n_spans, 6).transpose(1, 0, 2))
    own = np.swapaxes(by_span, 1, 2) @ by_span
    cov_border = F[:, u:].T @ F[:, u:]
    posterior = np.concatenate([np.diagonal(own, axis1=1, axis2=2).ravel(), np.diag(cov_border)])
    told = np.clip(1.0 - posterior / expects, 0.0, 1.0)

    poses = task.trajectory
    t = np.clip(poses.t_gps_s, task.edges[0], task.edges[-1])
    e = task.errors_at(y, t)
    attitude = Rotation.from_rotvec(-e[:, 3:]) * Rotation.from_quat(poses.quaternion_wcs_ics)
    # what is faster than the knots stays as it was
    rest = _positive_part(poses.cov_pose_wcs - before.covariance_at(t))
    R = poses.at(task.centre)[1]
    by_mount = np.zeros((n_spans, 6, 6))
    by_mount[:, :3, :3] = cross_matrix(R @ task.mount.shift_m) @ R
    by_mount[:, :3, 3:] = by_mount[:, 3:, :3] = R
    made = []
    for of_span in (by_span, by_span + F[:, u : u + 6] @ np.swapaxes(by_mount, 1, 2)):
        following = np.zeros_like(own)
        following[:-1] = np.swapaxes(of_span[:-1], 1, 2) @ of_span[1:]
        square = np.swapaxes(of_span, 1, 2) @ of_span
        chain = _chain("adjusted strips", task.centre, square, following)
        trajectory = replace(
            poses,
            position_wcs_m=poses.position_wcs_m - e[:, :3],
            quaternion_wcs_ics=attitude.as_quat(),
            cov_pose_wcs=chain.covariance_at(t) + rest,
        )
        step_s = float(np.diff(task.edges)[0])
        made.append((trajectory, with_rest(trajectory, [chain], chain.t_gps_s, step_s=step_s)))
    (trajectory, chains), (of_lidar, chains_of_lidar) = made
    late_s = float(y[u + SCANNER - 1])
    of_lidar = replace(of_lidar, t_gps_s=of_lidar.t_gps_s + late_s)
    chains_of_lidar = [replace(each, t_gps_s=each.t_gps_s + late_s) for each in chains_of_lidar]
    border, order = y[u:], np.r_[3:6, 0:3]
    turned = Rotation.from_rotvec(-border[:3]).as_matrix() @ task.mount.R
    moved_m = task.mount.shift_m - border[3:6]
    return Adjusted(
        trajectory=trajectory,
        mount=Rigid(R=turned, shift_m=moved_m, cov=cov_border[np.ix_(order, order)]),
        of_lidar=of_lidar,
        chains=chains,
        chains_of_lidar=chains_of_lidar,
        **_report(task, seen, y, np.sqrt(posterior), np.sqrt(prior), told, found, expected),
    )


def _expected(L: ArrayF, inverse: ArrayF, y: ArrayF) -> dict[str, float]:
    """How many unknowns the bank tells, and the square sum of corrections over what the prior expects of it.

    ``inverse`` is that of the factor G. The square sum ``y' K^-1 y`` of a prior that is right is about the
    number of the unknowns that are told, ``tr(1 - Q K^-1)``.
    """
    told = len(L) - float(np.sum(inverse**2))
    size = solve_triangular(L, y, lower=True, check_finite=False)
    return {"told_unknowns": told, "corrections_over_stated": float(size @ size) / told}


@dataclass(frozen=True, slots=True)
class Claim:
    """What the distances alone say of one unknown of mount, range and clock, and what follows from it.

    Attributes
    ----------
    value, sigma : without what is stated of it; of the error, not of the correction.
    z : by the standard deviation that this has if the statement is right.
    widened_by : variance that the prior is found to lack, in the mean of both possibilities.
    shift, variance : added to its most probable value and to its variance.
    """

    value: float
    sigma: float
    z: float
    widened_by: float
    shift: float
    variance: float


def claims(C: ArrayF, g: ArrayF, variance: ArrayF) -> dict[int, Claim]:
    """Test what is stated of each unknown of the border against the distances, the most doubtful one first.

    With the poses integrated out, ``C b = g`` are the normal equations of the border. If its prior variances
    ``S`` are right, ``r = (1 + C S)^-1 g`` has the covariance ``D = (1 + C S)^-1 C``: ``r_i / D_ii`` is one
    step of Newton's from the solution without the prior of unknown i, ``b_i``, of variance ``1 / D_ii = S_i +
    V_i``. The prior variance that makes it most probable is ``b_i^2 - V_i``. Either that is right or the
    stated one, with odds of `WRONG` and their likelihoods; error and variance are those of the mixture. The
    next unknown is tested with the wider prior.

    Parameters
    ----------
    C, g : (k, k), (k,) normal equations.
    variance : (k,) as stated.
    """
    S, left, found = np.diag(variance), set(np.flatnonzero(np.diag(C) > 0).tolist()), {}
    while left:
        T = np.linalg.inv(np.eye(len(g)) + C @ S)
        r, D = T @ g, np.diag(T @ C)
        i = max(left, key=lambda k: abs(r[k]) / np.sqrt(D[k]))
        left.remove(i)
        b, total, own = r[i] / D[i], 1.0 / D[i], S[i, i]
        z, others = b / np.sqrt(total), total - own
        lacks = max(b**2 - total, 0.0)
        odds = expit(logit(WRONG) + (z**2 - 1) / 2 - np.log(abs(z))) if lacks else 0.0
        mean, spread = np.array([own / total, (own + lacks) / (total + lacks)]) * [[b], [others]]
        shift = odds * (mean[1] - mean[0])
        variance_more = odds * (spread[1] - spread[0]) + odds * (1 - odds) * (mean[1] - mean[0]) ** 2
        found[i] = Claim(*map(float, (b, np.sqrt(others), z, odds * lacks, shift, variance_more)))
        S[i, i] += lacks
    return found


def _border_alone(equations: tuple[ArrayF, ArrayF], L: ArrayF, G: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Normal equations (k, k), (k,) of the border with the poses integrated out; 0 of what nothing tells.

    The factor ``G`` begins with that of the poses alone, since the border stands last.
    """
    N, h = equations
    u = len(N) - len(BORDER)
    X = solve_triangular(G[:u, :u], L[:u, :u].T @ np.column_stack([N[:u, u:], h[:u]]), lower=True)
    left = np.column_stack([N[u:, u:], h[u:]]) - X[:, :-1].T @ X
    seen = np.diag(left) > 1e-9 * np.diag(N)[u:]
    return left[:, :-1] * np.outer(seen, seen), left[:, -1] * seen


def _report(
    task: _Task,
    seen: _Seen,
    y: ArrayF,
    after: ArrayF,
    before: ArrayF,
    told: ArrayF,
    found: Mapping[int, Claim],
    expected: Mapping[str, float],
) -> dict[str, Any]:
    """Tables and facts of `Adjusted`, of all unknowns with their sigmas."""
    u = 6 * task.n_spans
    first, left = seen.from_planes_m(np.zeros_like(y))[0], seen.from_planes_m(y)[0]
    every = pd.DataFrame({
        "t_gps_s": seen.t_gps_s, "range_m": seen.range_m, "before_m": first, "after_m": left, "z": seen.z,
        "weight": seen.robust, "group": np.array(GROUPS)[seen.group],
    })  # fmt: skip
    observations = every[seen.group != STABLE].reset_index(drop=True)
    knots = pd.DataFrame({"t_gps_s": task.centre})
    for i, name in enumerate(POSE):
        key, unit = name.replace(" ", "_"), "rad" if i >= 3 else "m"
        for what, values in (
            (f"{key}_{unit}", -y), (f"sigma_{key}_before_{unit}", before),
            (f"sigma_{key}_{unit}", after), (f"told_{key}", told),
        ):  # fmt: skip
            knots[what] = values[i:u:6]
    at = np.searchsorted(task.edges, observations["t_gps_s"], side="right") - 1
    knots["observations"] = np.bincount(np.clip(at, 0, task.n_spans - 1), minlength=task.n_spans)
    border = pd.DataFrame({
        "unknown": BORDER, "correction": -y[u:], "sigma_before": before[u:], "sigma": after[u:],
        "told": told[u:], "z": [-found[i].z if i in found else np.nan for i in range(len(BORDER))],
    })  # fmt: skip
    border = border[before[u:] > 10 * LEAST_SIGMA].reset_index(drop=True)
    said = {BORDER[i]: claim for i, claim in found.items()}
    mean = {name: float(told[i:u:6].mean()) for i, name in enumerate(POSE)}
    used = observations[observations["weight"] > 0.1]
    stable = every[seen.group == STABLE]
    facts = {
        "planes": seen.n_planes,
        "observations": len(observations),
        "not_on_planes": len(observations) - len(used),
        "knots": task.n_spans,
        "knot_s": float(np.diff(task.edges)[0]),
        "redundancy": float(len(every) - 3 * seen.n_planes - expected["told_unknowns"]),
        **expected,
        "distance_before_m": root_mean_square(used["before_m"].to_numpy()),
        "distance_after_m": root_mean_square(used["after_m"].to_numpy()),
        "stable_observations": len(stable),
        "stable_not_on_planes": int((stable["weight"] <= 0.1).sum()),
        "sigma_factors": dict(zip(GROUPS, np.asarray(seen.factors).tolist(), strict=True)),
        "told": mean,
        "not_told": [name for name, share in mean.items() if share < LEAST_TOLD]
        + border["unknown"][border["told"] < LEAST_TOLD].tolist(),
        "not_asked": {
            name: {"correction": -claim.value, "sigma": claim.sigma, "z": -claim.z}
            for name, claim in said.items()
            if name not in set(border["unknown"])
        },
        "notes": _notes(border, said, expected),
    }
    return {"knots": knots, "border": border, "observations": observations, "facts": facts}


def _notes(border: pd.DataFrame, said: Mapping[str, Claim], expected: Mapping[str, float]) -> list[str]:
    """Sentences about what is off: by more than was stated, or though nobody asked for it."""
    notes, ratio = [], expected["corrections_over_stated"]
    if abs(ratio - 1.0) > SURE * np.sqrt(2.0 / expected["told_unknowns"]):
        sizes, times = ("small", "long") if ratio > 1.0 else ("large", "short")
        notes.append(
            f"poses are corrected by {np.sqrt(ratio):.1f} times what their standard deviations and "
            f"correlation times expect: the former are stated too {sizes} or the latter too {times}"
            + ("; standard deviations after the adjustment are as much larger" if ratio > 1.0 else "")
        )
    stated = dict(zip(border["unknown"], border["sigma_before"], strict=True))
    limit = norm.isf(ODD / 2 / max(len(said), 1))
    for full, claim in said.items():
        if abs(claim.z) < limit:
            continue
        name, unit = full[:-1].split(" [")
        scale, unit = (np.rad2deg(1.0), "degrees") if unit == "rad" else (1e3, f"m{unit}")
        digits = 2 if unit == "degrees" else 1
        off = f"{scale * claim.value:.{digits}f} {unit} (standard deviation {scale * claim.sigma:.{digits}f})"
        if full in stated:
            notes.append(
                f"distances of strips look as if the {name} were off by {off}, {abs(claim.z):.1f} times what "
                f"its standard deviation of {scale * stated[full]:.{digits}f} {unit} and those of the poses "
                "expect: check it, or state it larger; standard deviations after the adjustment count with it"
            )
        else:
            notes.append(
                f"distances of strips look as if the {name.removesuffix(' offset')} were off by {off}: ask "
                f"for it with strips.{SETTINGS[full]}"
            )
    return notes
