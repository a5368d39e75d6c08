"""Space resection: the pose of one camera picture from marks of known points (P1 eq. 1-3, P2 3.1).

The robust start needs no approximate values (`thalweg.calibration.field.rays`). The adjustment
takes each mark with its own sigma and that of its point, and the interior orientation as unknowns that were
observed with their covariance: held fixed, its errors would make good marks near the border look wrong. The
covariance of the pose then also carries what marks share through the joint covariance of the points.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np
import pandas as pd

from thalweg.calibration import Block, collinear
from thalweg.calibration.field.bundle import MARKS, Layout, Problem, State, marks_model, solve, start_state
from thalweg.calibration.field.points import FieldPoints
from thalweg.calibration.field.rays import TRIPLES, other_poses, pose_from_rays
from thalweg.core import Adjusted, ArrayB, ArrayF, ArrayI, Camera, GeometryError, Rigid

LEAST_MARKS: Final = 4
LEAST_MARKERS: Final = 2
REJECT_SIGMAS: Final = 4.0
_CAP_RAD: Final = 0.01
_WIDE_CAP_RAD: Final = 0.05
"""The same where the lens is only roughly known."""
_LEAST_SHARE: Final = 0.5
_LARGEST_SIGMA_M: Final = 0.25
"""A pose worse than this comes from marks that are too few or too close together."""
_CLEAR_MARKERS: Final = 5
"""With more markers in the picture a second solution is out of the question."""
_TIMES_WORSE: Final = 3.0
"""A second solution is told from the first by residuals that many times larger, or than the sigmas allow."""
LARGEST_SIGMA0: Final = 20.0
"""Sigma of unit weight beyond which the marks, not their sigmas, are wrong: a panel read backwards."""
_CHECK: Final = (
    "Check the numbers and the order of the marks, that the picture is stored neither turned nor mirrored, "
    "the interior orientation, and that no marker has been moved since"
)


# ---------------------------------------------------------------- resection


@dataclass(frozen=True, slots=True, kw_only=True)
class Resected:
    """Pose of one picture.

    Parameters
    ----------
    T_pcs_ccs : with the covariance of everything that was asked for.
    cov_marks : (6, 6) the part of it that comes from this picture's own marks.
    by_interior : (6, k) derivative of the pose's error by that of the camera's parameters, which all
    pictures share.
    by_points : (6, 3n) derivative by the points of the field, which all pictures share.
    residuals : marker, corner, vx_px, vy_px (observed minus computed), standardised, used.
    redundancy, sigma0 : of the adjustment.
    moved : markers of which all corners are off alike, though the others fit: they stand elsewhere now.
    """

    T_pcs_ccs: Rigid
    cov_marks: ArrayF
    by_interior: ArrayF
    by_points: ArrayF
    residuals: pd.DataFrame
    redundancy: float
    sigma0: float
    moved: tuple[int, ...]

    @property
    def used(self) -> ArrayB:
        """(m,) marks that took part."""
        return self.residuals["used"].to_numpy(np.bool_)


def resect(
    camera: Camera,
    marks: pd.DataFrame,
    points: FieldPoints,
    *,
    where: str = "",
    largest_sigma_m: float = _LARGEST_SIGMA_M,
) -> Resected:
    """Pose of a picture.

    Parameters
    ----------
    camera : interior orientation with its covariance.
    marks : marker, corner, x_px, y_px, sigma_px of one picture.
    points : reference points; marks of other markers are left out.
    where : name of the picture, for messages.
    largest_sigma_m : a place that is known worse is refused.

    Raises
    ------
    GeometryError : fewer than four known marks on two markers; marks that do not fit together; a pose that is
        hardly determined or has a second solution.
    """
    seen = _seen(camera, marks, points, where, _CAP_RAD)
    found = _Fit.of(camera, [seen], points, {}).resected(0, largest_sigma_m)
    if found.sigma0 > LARGEST_SIGMA0:
        raise GeometryError(
            f"the marks are {found.sigma0:.0f} times their sigmas off any pose",
            expected=f"at most {LARGEST_SIGMA0:g} times",
            where=where,
            cure=_CHECK,
        )
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class _Seen:
    """Known marks of a picture, their places in the field, and a pose to begin with."""

    where: str
    start: Rigid
    marker: ArrayI
    at: ArrayI
    xy: ArrayF
    sigma: ArrayF
    off_rad: ArrayF
    """Angles between the rays and the directions to the points at the start."""


def _seen(
    camera: Camera,
    marks: pd.DataFrame,
    points: FieldPoints,
    where: str,
    cap_rad: float,
    triples: int = TRIPLES,
) -> _Seen:
    """The marks of a picture with a start.

    Raises
    ------
    GeometryError : too few marks, or half of them further than ``cap_rad`` from any pose.
    """
    index = points.index
    keys = list(zip(marks["marker"].astype(int), marks["corner"].astype(int), strict=True))
    known = np.array([k in index for k in keys], dtype=np.bool_)
    marker = np.array([k[0] for k in keys], np.int64)[known]
    _require(marker, where, "known marks on", len(marks))
    at = np.array([index[k] for k, ok in zip(keys, known, strict=True) if ok], np.int64)
    xy = marks[["x_px", "y_px"]].to_numpy(np.float64)[known]
    sigma = marks["sigma_px"].to_numpy(np.float64)[known]
    rays = camera.rays(xy)
    seen = np.isfinite(rays).all(axis=1)
    _require(marker[seen], where, "marks inside the lens model, on", len(marks))
    start, angles = pose_from_rays(
        points.points_pcs[at[seen]], rays[seen], marker[seen], cap_rad=cap_rad, triples=triples
    )
    good = angles < cap_rad
    if good.mean() < _LEAST_SHARE or good.sum() < LEAST_MARKS:
        raise GeometryError(
            f"only {int(good.sum())} of {len(good)} marks agree with any pose",
            expected="most of them",
            where=where,
            cure=f"Check that the picture shows this field. {_CHECK}",
        )
    return _Seen(
        where=where,
        start=start,
        marker=marker[seen],
        at=at[seen],
        xy=xy[seen],
        sigma=sigma[seen],
        off_rad=angles,
    )


def start_misfit_px(camera: Camera, marks: pd.DataFrame, points: FieldPoints) -> float:
    """Mean distance of the marks of a picture from where its start puts them; gross errors are cut off.

    Raises
    ------
    GeometryError : there is no start.
    """
    off = _seen(camera, marks, points, "", _WIDE_CAP_RAD, TRIPLES // 3).off_rad
    return float(camera.parameters[0] * np.minimum(off, _WIDE_CAP_RAD).mean())


def resect_together(
    camera: Camera,
    marks: Mapping[str, pd.DataFrame],
    points: FieldPoints,
    free: Mapping[str, ArrayF],
    *,
    largest_sigma_m: float = _LARGEST_SIGMA_M,
) -> tuple[Camera, dict[str, Resected], dict[str, str]]:
    """Poses of pictures and the interior orientation that they share, in one adjustment.

    Parameters
    ----------
    camera : start; parameters with a variance are observed with its covariance.
    marks, points, largest_sigma_m : as of `resect`, marks by picture.
    free : unknowns that nothing but the marks tells: name -> (k,) change of the camera's parameters by it.

    Returns
    -------
    camera : with the covariance of what was estimated.
    poses : by picture, with the covariance of everything.
    refused : picture -> why it has no pose.

    Raises
    ------
    UnobservableError : the marks do not determine an unknown, which is named.
    GeometryError : no picture has a start, or there are no more marks than unknowns.
    """
    seen: list[_Seen] = []
    poses: dict[str, Resected] = {}
    refused: dict[str, str] = {}
    for image, table in marks.items():
        try:
            seen.append(_seen(camera, table, points, image, _WIDE_CAP_RAD))
        except GeometryError as error:
            refused[image] = error.found
    got, sought = 2 * sum(len(one.at) for one in seen), 6 * len(seen) + len(free)
    if not seen or got <= sought:
        raise GeometryError(
            f"{got} image coordinates for {sought} unknowns" if seen else next(iter(refused.values())),
            expected="more observations than unknowns, so that they check each other",
            cure="Measure more control points, or estimate less of the lens",
        )
    fit = _Fit.of(camera, seen, points, free)
    for k, one in enumerate(seen):
        try:
            poses[one.where] = fit.resected(k, largest_sigma_m)
        except GeometryError as error:
            refused[one.where] = error.found
    (change,), (lens,) = fit.layout.change, fit.layout.lens
    cov = fit.propagated(lens)[0]
    return replace(fit.adjusted.x.cameras[0], cov=change @ cov @ change.T), poses, refused


def _require(marker: ArrayI, where: str, what: str, seen: int) -> None:
    n, markers = len(marker), len(set(marker.tolist()))
    if n < LEAST_MARKS or markers < LEAST_MARKERS:
        raise GeometryError(
            f"{n} {what} {markers} marker{'s' if markers != 1 else ''} ({seen} marks were detected)",
            expected=f"at least {LEAST_MARKS} on {LEAST_MARKERS} markers: three marks have up to four "
            "solutions without any contradiction",
            where=where,
            cure="Record it again so that the camera sees more markers of the field",
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fit:
    """A bundle of pictures with one camera on known points.

    Unknowns are the parameters that the camera's own covariance observes, the free ones, and six a picture.
    """

    camera: Camera
    pictures: Sequence[_Seen]
    points: FieldPoints
    problem: Problem
    layout: Layout
    adjusted: Adjusted[State]

    @classmethod
    def of(
        cls, camera: Camera, pictures: Sequence[_Seen], points: FieldPoints, free: Mapping[str, ArrayF]
    ) -> Self:
        """Adjust poses, and what is known with an error or free of the lens."""
        loose = tuple(np.array(camera.parameter_names)[np.diag(camera.cov) > 0].tolist())
        block = Block(
            images=tuple(p.where for p in pictures),
            camera_of=(camera.name,) * len(pictures),
            points=points.points,
            image=np.repeat(np.arange(len(pictures)), [len(p.at) for p in pictures]),
            point=np.concatenate([p.at for p in pictures]),
            xy_px=np.concatenate([p.xy for p in pictures]),
            sigma_px=np.concatenate([p.sigma for p in pictures]),
            rays=np.empty((0, 3)),
        )
        n = len(points.points)
        problem = Problem(
            block,
            np.zeros(len(pictures), np.int64),
            np.ones(len(block.image), np.bool_),
            ((*loose, *free),),
            weighted=bool(loose),
            tied=free,
            cov_known=points.cov.reshape(n, 3, n, 3)[np.arange(n), :, np.arange(n)],
        )
        adjusted, layout = solve(
            problem,
            start_state(
                block.images, (camera,), {k: p.start for k, p in enumerate(pictures)}, points.points_pcs
            ),
            robust_sigmas=REJECT_SIGMAS,
            cure="Estimate less of the lens, or measure points at more different distances"
            if free
            else "Record the picture again with markers spread over it",
        )
        return cls(
            camera=camera, pictures=pictures, points=points, problem=problem, layout=layout, adjusted=adjusted
        )

    def propagated(self, rows: slice) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF]:
        """Covariance of some unknowns, the part of the marks, derivatives by the camera and the points.

        The adjustment weights marks by ``S = s^2 I + P C P^T`` with each point's own block ``C``, and the
        interior orientation by ``Q``. Its solution ``dx = -N^-1 (A^T S^-1 r + B^T Q^-1 r_interior)`` carries
        the errors of the marks, of the points with all their correlations, and of the interior orientation.
        """
        problem, x = replace(self.problem, used=self.adjusted.used[MARKS]), self.adjusted.x
        block, columns = problem.block, self.adjusted.cov[:, rows]
        image, at = block.image[problem.used], block.point[problem.used]
        variance, n = np.square(block.sigma_px[problem.used]), columns.shape[1]
        part = marks_model(problem, self.layout, x)
        by_point = collinear(x.cameras, 0 * image, x.R[image], x.C[image], x.X[at]).by_point
        # (m, 2, n): derivatives of the unknowns by the marks
        K = np.linalg.solve(part.cov, np.asarray(part.jacobian @ columns).reshape(-1, 2, n))
        cov_marks = np.einsum("mia,m,mib->ab", K, variance, K)
        by_interior = np.zeros((n, len(self.camera.cov)))
        loose = np.flatnonzero(np.diag(self.camera.cov) > 0)
        Q = self.camera.cov[np.ix_(loose, loose)]
        by_interior[:, loose] = np.linalg.solve(Q, columns[: len(loose)]).T
        parts = np.zeros((len(self.points.points), n, 3))
        np.add.at(parts, at, -np.swapaxes(K, 1, 2) @ by_point)
        by_points = np.swapaxes(parts, 0, 1).reshape(n, -1)
        cov = cov_marks + by_points @ self.points.cov @ by_points.T
        cov += by_interior @ self.camera.cov @ by_interior.T
        return (cov + cov.T) / 2, (cov_marks + cov_marks.T) / 2, by_interior, by_points

    def resected(self, k: int, largest_sigma_m: float) -> Resected:
        """Pose of the k-th picture.

        Raises
        ------
        GeometryError : half of its marks do not fit, or they hardly determine the pose.
        """
        one, x = self.pictures[k], self.adjusted.x
        pose = Rigid(R=x.R[k], shift_m=x.C[k])
        rows = self.problem.block.image == k
        used = self.adjusted.used[MARKS][rows]
        _require(one.marker[used], one.where, "fitting marks on", len(one.marker))
        if used.mean() < _LEAST_SHARE:
            raise GeometryError(
                f"{int((~used).sum())} of {len(used)} marks do not fit",
                expected="less than half of them wrong",
                where=one.where,
                cure="Look at the picture: motion blur, a moved marker, or a camera that was refocused",
            )
        self.require_one_solution(k, pose, used)
        cov, cov_marks, by_interior, by_points = self.propagated(self.layout.pose(k))
        T = pose.with_cov(cov)
        if float(T.sigma_shift_m.max()) > largest_sigma_m:
            raise GeometryError(
                f"the pose has a sigma of {T.sigma_shift_m.max():.2f} m from {int(used.sum())} marks",
                expected=f"at most {largest_sigma_m:g} m",
                where=one.where,
                cure="Record it again with markers spread over the whole picture",
            )
        v = -self.adjusted.residuals[MARKS].reshape(-1, 2)[rows]
        residuals = pd.DataFrame(
            {
                "marker": one.marker,
                "corner": [self.points.points[i][1] for i in one.at],
                "vx_px": v[:, 0],
                "vy_px": v[:, 1],
                "standardised": self.adjusted.standardised[MARKS][rows],
                "used": used,
            }
        )
        return Resected(
            T_pcs_ccs=T,
            cov_marks=cov_marks,
            by_interior=by_interior,
            by_points=by_points,
            residuals=residuals,
            redundancy=self.adjusted.redundancy,
            sigma0=float(np.sqrt(self.adjusted.sigma0_squared)),
            moved=_moved(one.marker, used),
        )

    def require_one_solution(self, k: int, pose: Rigid, used: ArrayB) -> None:
        """Few markers that are nearly in a plane may fit a second pose nearly as well.

        Raises
        ------
        GeometryError : another pose fits the used marks of the k-th picture.
        """
        one, camera = self.pictures[k], self.adjusted.x.cameras[0]
        X, xy, marker = self.points.points_pcs[one.at][used], one.xy[used], one.marker[used]
        markers = len(set(marker.tolist()))
        if markers > _CLEAR_MARKERS:
            return
        sigma = one.sigma[used]
        limit = _TIMES_WORSE * max(_misfit(camera, pose, X, xy, sigma), 1.0)
        reach = float(np.median(np.linalg.norm(X - pose.shift_m, axis=1)))
        for other in other_poses(pose, X, camera.rays(xy), marker, apart_m=0.05 * reach):
            if _misfit(camera, other, X, xy, sigma) < limit:
                raise GeometryError(
                    f"two poses {np.linalg.norm(other.shift_m - pose.shift_m):.2f} m apart fit {len(X)} "
                    f"marks of {markers} markers",
                    expected="marks that leave one solution",
                    where=one.where,
                    cure="Record it again so that the camera sees more markers, at different distances",
                )


def _misfit(camera: Camera, pose: Rigid, X: ArrayF, xy: ArrayF, sigma: ArrayF) -> float:
    """Root mean square of the residuals in units of their sigma."""
    off = np.linalg.norm(camera.project((X - pose.shift_m) @ pose.R) - xy, axis=1) / sigma
    return float(np.sqrt(np.nan_to_num(np.square(off), nan=1e12).mean() / 2))


def _moved(marker: ArrayI, used: ArrayB) -> tuple[int, ...]:
    """Markers seen with three corners or more of which not more than one fits."""
    found = []
    for m in np.unique(marker):
        mine = used[marker == m]
        if len(mine) >= 3 and mine.sum() <= 1:
            found.append(int(m))
    return tuple(found)
