"""Space resection: the pose of one camera picture from marks of known points (P1 eq. 1-3, P2 3.1).

The robust start needs no approximate values (`thalweg.calibration.field.resection`). The adjustment
takes each mark with its own sigma and that of its point, and the interior orientation as unknowns that were
observed with their covariance: held fixed, its errors would make good marks near the border look wrong. The
covariance of the pose then also carries what marks share through the joint covariance of the points.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Self

import numpy as np
import pandas as pd
from scipy import sparse

from thalweg.calibration.field.points import FieldPoints
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
    ThalwegError,
    adjust,
    cross_matrix,
)
from thalweg.core.geometry import fit_points

LEAST_MARKS: Final = 4
LEAST_MARKERS: Final = 2
REJECT_SIGMAS: Final = 4.0
_CAP_RAD: Final = 0.01
_WIDE_CAP_RAD: Final = 0.05
"""The same where the lens is only roughly known."""
_LEAST_SHARE: Final = 0.5
_MOST: Final = 0.9
"""Of the marks that must fit for another reading of them to count."""
_LARGEST_SIGMA_M: Final = 0.25
"""A pose worse than this comes from marks that are too few or too close together."""
_CLEAR_MARKERS: Final = 5
"""With more markers in the picture a second solution is out of the question."""
_TIMES_WORSE: Final = 3.0
"""A second solution is told from the first by residuals that many times larger, or than the sigmas allow."""
_NAMES: Final = ("x", "y", "z", "rotation about x", "rotation about y", "rotation about z")
_NO_IMAGE_PX: Final = 1e4
LARGEST_SIGMA0: Final = 20.0
"""Sigma of unit weight beyond which the marks, not their sigmas, are wrong: a panel read backwards."""
FITS: Final = 4.0
"""Sigma of unit weight below which a reading explains the marks."""
_BETTER: Final = 0.2

_TRIPLES: Final = 300
_SEED: Final = np.array([7, *b"resection"])
_REAL: Final = 0.02
"""Largest imaginary part of a root that counts as real: noise turns double roots into complex pairs."""


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
    with_interior: bool = True,
    sigma_factor: float = 1.0,
    where: str = "",
    explain: bool = True,
    largest_sigma_m: float = _LARGEST_SIGMA_M,
) -> Resected:
    """Pose of a picture.

    Parameters
    ----------
    camera : interior orientation with its covariance.
    marks : marker, corner, x_px, y_px, sigma_px of one picture.
    points : reference points; marks of other markers are left out.
    with_interior : count the covariance of the interior orientation in; else it is held fixed.
    sigma_factor : what the stated sigmas of marks must be multiplied with, as the bundle adjustment found.
    where : name of the picture, for messages.
    explain : look for another reading of marks that fit no pose (in reverse order, mirrored).
    largest_sigma_m : a place that is known worse is refused.

    Raises
    ------
    GeometryError : fewer than four known marks on two markers; marks that do not fit together; a pose that is
        hardly determined or has a second solution. The cure names the reading that fits, if one does.
    """

    def pose(read: pd.DataFrame) -> Resected:
        """The resection by marks that were read in some way."""
        return _pose(camera, read, points, with_interior, sigma_factor, where, largest_sigma_m)

    sigma0 = np.inf
    try:
        found = pose(marks)
        if not found.sigma0 > LARGEST_SIGMA0:
            return found
        sigma0 = found.sigma0
        error = GeometryError(
            f"the marks are {sigma0:.0f} times their sigmas off any pose",
            expected=f"at most {LARGEST_SIGMA0:g} times",
            where=where,
            cure="Check the numbers of the marks, the interior orientation and that no mark was moved",
        )
    except GeometryError as refused:
        error = refused

    def misfit(read: pd.DataFrame) -> float:
        """Its sigma0; infinite if it fits only by leaving marks out."""
        one = pose(read)
        return one.sigma0 if one.used.mean() > _MOST else np.inf

    reading = reading_that_fits(marks, camera.size_px, misfit, sigma0) if explain else ""
    if not reading:
        raise error
    raise GeometryError(error.found, expected=error.expected, where=error.where, cure=reading) from error


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
    sigma_factor: float,
    where: str,
    cap_rad: float,
    triples: int = _TRIPLES,
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
    sigma = marks["sigma_px"].to_numpy(np.float64)[known] * sigma_factor
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
            cure="Check that the picture shows this field and that no marker has been moved since",
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
    off = _seen(camera, marks, points, 1.0, "", _WIDE_CAP_RAD, _TRIPLES // 3).off_rad
    return float(camera.parameters[0] * np.minimum(off, _WIDE_CAP_RAD).mean())


def _pose(
    camera: Camera,
    marks: pd.DataFrame,
    points: FieldPoints,
    with_interior: bool,
    sigma_factor: float,
    where: str,
    largest_sigma_m: float,
) -> Resected:
    """Pose of a picture, however well it fits, see `resect`."""
    seen = _seen(camera, marks, points, sigma_factor, where, _CAP_RAD)
    return _Fit.of(
        camera if with_interior else replace(camera, cov=np.zeros_like(camera.cov)), [seen], points, {}
    ).resected(0, largest_sigma_m)


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
            seen.append(_seen(camera, table, points, 1.0, image, _WIDE_CAP_RAD))
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
    cov = fit.propagated(slice(6 * len(seen), None)).cov
    return replace(fit.adjusted.x.camera, cov=fit.change @ cov @ fit.change.T), poses, refused


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


def _project(camera: Camera, pose: Rigid, X: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF]:
    """Pixels, and derivatives by the pose (n, 2, 6), by the points (n, 2, 3), by the camera (n, 2, k)."""
    away = X - pose.shift_m
    xy, by_local, by_parameters = camera.project_with_derivatives(away @ pose.R)
    by_point = by_local @ pose.R.T
    return xy, np.concatenate([-by_point, by_point @ cross_matrix(away)], axis=2), by_point, by_parameters


@dataclass(frozen=True, slots=True)
class _State:
    poses: tuple[Rigid, ...]
    camera: Camera


@dataclass(frozen=True, slots=True)
class _Propagated:
    """Covariance of unknowns (n,), the part of the marks, derivatives by the camera and the points."""

    cov: ArrayF
    cov_marks: ArrayF
    by_interior: ArrayF
    by_points: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fit:
    """An adjustment of pictures with one camera, whose unknowns are six a picture and then the lens.

    ``loose`` are the parameters that the camera's own covariance observes, ``change`` (k, f) how parameters
    follow the unknowns of the lens: first those, then the free ones.
    """

    camera: Camera
    pictures: Sequence[_Seen]
    points: FieldPoints
    loose: ArrayI
    change: ArrayF
    adjusted: Adjusted[_State]

    @classmethod
    def of(
        cls, camera: Camera, pictures: Sequence[_Seen], points: FieldPoints, free: Mapping[str, ArrayF]
    ) -> Self:
        """Adjust poses, and what is known with an error or free of the lens."""
        loose = np.flatnonzero(np.diag(camera.cov) > 0)
        change = np.column_stack([np.eye(len(camera.parameters))[:, loose], *free.values()])
        first = 6 * len(pictures)
        xy, sigma = (np.concatenate([getattr(p, name) for p in pictures]) for name in ("xy", "sigma"))
        cov_X = _blocks(points, np.concatenate([p.at for p in pictures]))

        def marks(x: _State) -> Linear:
            """Pixels of the marks less the measured ones."""
            got, by_point, J = _projected(x, pictures, points, change)
            residual = got - xy
            lost = ~np.isfinite(residual).all(axis=1)
            residual[lost], by_point[lost] = _NO_IMAGE_PX, 0.0
            cov = by_point @ cov_X @ np.swapaxes(by_point, 1, 2) + np.square(sigma)[:, None, None] * np.eye(2)
            return Linear(residual=residual.ravel(), jacobian=J, cov=cov)

        def interior(x: _State) -> Linear:
            """The interior orientation as an observation of itself."""
            J = np.zeros((len(loose), first + change.shape[1]))
            J[:, first:] = change[loose]
            off = (x.camera.parameters - camera.parameters)[loose]
            return Linear(residual=off, jacobian=J, cov=camera.cov[np.ix_(loose, loose)][None])

        def update(x: _State, dx: ArrayF) -> _State:
            """Small changes put on the state; a focal length stays positive."""
            p = x.camera.parameters + change @ dx[first:]
            p[:2] = np.maximum(p[:2], 0.05 * camera.parameters[:2])
            steps = dx[:first].reshape(-1, 6)
            moved = tuple(T.moved(step) for T, step in zip(x.poses, steps, strict=True))
            return _State(moved, x.camera.with_parameters(p))

        groups = [Observations("marks", marks)]
        if len(loose):
            groups.append(Observations("interior orientation", interior))
        of = [""] if len(pictures) == 1 else [f"{p.where} " for p in pictures]
        adjusted = adjust(
            groups,
            _State(tuple(p.start for p in pictures), camera),
            [
                *(f"{picture}{name}" for picture in of for name in _NAMES),
                *(camera.parameter_names[i] for i in loose),
                *free,
            ],
            update=update,
            loss="huber",
            reject_sigmas=REJECT_SIGMAS,
            max_iterations=200,
            cure="Estimate less of the lens, or measure points at more different distances"
            if free
            else "Record the picture again with markers spread over it",
        )
        return cls(
            camera=camera, pictures=pictures, points=points, loose=loose, change=change, adjusted=adjusted
        )

    def propagated(self, rows: slice) -> _Propagated:
        """Covariance of some unknowns, and where it comes from.

        The adjustment weights marks by ``S = s^2 I + P C P^T`` with each point's own block ``C``, and the
        interior orientation by ``Q``. Its solution ``dx = -N^-1 (A^T S^-1 r + B^T Q^-1 r_interior)`` carries
        the errors of the marks, of the points with all their correlations, and of the interior orientation.
        """
        used = self.adjusted.used["marks"]
        at = np.concatenate([p.at for p in self.pictures])[used]
        variance = np.square(np.concatenate([p.sigma for p in self.pictures])[used])
        _, by_point, J = _projected(self.adjusted.x, self.pictures, self.points, self.change)
        by_point, columns = by_point[used], self.adjusted.cov[:, rows]
        S = by_point @ _blocks(self.points, at) @ np.swapaxes(by_point, 1, 2)
        S += variance[:, None, None] * np.eye(2)
        # (m, 2, n): derivatives of the unknowns by the marks
        K = np.linalg.solve(S, np.asarray(J @ columns).reshape(-1, 2, columns.shape[1])[used])
        n, loose = columns.shape[1], self.loose
        cov_marks = np.einsum("mia,m,mib->ab", K, variance, K)
        by_interior = np.zeros((n, len(self.camera.cov)))
        if len(loose):
            first = 6 * len(self.pictures)
            Q = self.camera.cov[np.ix_(loose, loose)]
            by_interior[:, loose] = np.linalg.solve(Q, columns[first : first + len(loose)]).T
        parts = np.zeros((len(self.points.points), n, 3))
        np.add.at(parts, at, -np.swapaxes(K, 1, 2) @ by_point)
        by_points = np.swapaxes(parts, 0, 1).reshape(n, -1)
        cov = cov_marks + by_points @ self.points.cov @ by_points.T
        cov += by_interior @ self.camera.cov @ by_interior.T
        return _Propagated((cov + cov.T) / 2, (cov_marks + cov_marks.T) / 2, by_interior, by_points)

    def resected(self, k: int, largest_sigma_m: float) -> Resected:
        """Pose of the k-th picture.

        Raises
        ------
        GeometryError : half of its marks do not fit, or they hardly determine the pose.
        """
        one, x = self.pictures[k], self.adjusted.x
        rows = np.repeat(np.arange(len(self.pictures)), [len(p.at) for p in self.pictures]) == k
        used = self.adjusted.used["marks"][rows]
        _require(one.marker[used], one.where, "fitting marks on", len(one.marker))
        if used.mean() < _LEAST_SHARE:
            raise GeometryError(
                f"{int((~used).sum())} of {len(used)} marks do not fit",
                expected="less than half of them wrong",
                where=one.where,
                cure="Look at the picture: motion blur, a moved marker, or a camera that was refocused",
            )
        X = self.points.points_pcs[one.at][used]
        _require_one_solution(
            x.poses[k], x.camera, X, one.xy[used], one.sigma[used], one.marker[used], one.where
        )
        found = self.propagated(slice(6 * k, 6 * k + 6))
        T = x.poses[k].with_cov(found.cov)
        if float(T.sigma_shift_m.max()) > largest_sigma_m:
            raise GeometryError(
                f"the pose has a sigma of {T.sigma_shift_m.max():.2f} m from {int(used.sum())} marks",
                expected=f"at most {largest_sigma_m:g} m",
                where=one.where,
                cure="Record it again with markers spread over the whole picture",
            )
        v = -self.adjusted.residuals["marks"].reshape(-1, 2)[rows]
        residuals = pd.DataFrame(
            {
                "marker": one.marker,
                "corner": [self.points.points[i][1] for i in one.at],
                "vx_px": v[:, 0],
                "vy_px": v[:, 1],
                "standardised": self.adjusted.standardised["marks"][rows],
                "used": used,
            }
        )
        return Resected(
            T_pcs_ccs=T,
            cov_marks=found.cov_marks,
            by_interior=found.by_interior,
            by_points=found.by_points,
            residuals=residuals,
            redundancy=self.adjusted.redundancy,
            sigma0=float(np.sqrt(self.adjusted.sigma0_squared)),
            moved=_moved(one.marker, used),
        )


def _blocks(points: FieldPoints, at: ArrayI) -> ArrayF:
    """(m, 3, 3) covariances of single points."""
    return np.array([points.cov[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i in at])


def _projected(
    x: _State, pictures: Sequence[_Seen], points: FieldPoints, change: ArrayF
) -> tuple[ArrayF, ArrayF, Any]:
    """Pixels (m, 2) of all marks, derivatives by their points (m, 2, 3), and by the unknowns (2m, u)."""
    parts = [_project(x.camera, T, points.points_pcs[p.at]) for T, p in zip(x.poses, pictures, strict=True)]
    xy, by_pose, by_point, by_parameters = (np.concatenate(each) for each in zip(*parts, strict=True))
    by_lens = by_parameters @ change
    lost = ~np.isfinite(xy).all(axis=1)
    by_pose[lost], by_lens[lost] = 0.0, 0.0
    of = [each[1].shape[0] for each in parts]
    if len(of) == 1:
        return xy, by_point, np.concatenate([by_pose, by_lens], axis=2).reshape(2 * len(xy), -1)
    ends = np.cumsum(of)
    poses = [by_pose[end - m : end].reshape(2 * m, 6) for m, end in zip(of, ends, strict=True)]
    diagonal = sparse.block_diag([sparse.csr_array(part) for part in poses], format="csr")
    lens = sparse.csr_array(by_lens.reshape(2 * len(xy), -1))
    return xy, by_point, sparse.hstack([diagonal, lens], format="csr")


def _require_one_solution(
    pose: Rigid, camera: Camera, X: ArrayF, xy: ArrayF, sigma: ArrayF, marker: ArrayI, where: str
) -> None:
    """Few markers that are nearly in a plane may fit a second pose nearly as well."""
    if len(set(marker.tolist())) > _CLEAR_MARKERS:
        return
    best = _misfit(camera, pose, X, xy, sigma)
    reach = float(np.median(np.linalg.norm(X - pose.shift_m, axis=1)))
    for other in other_poses(pose, X, camera.rays(xy), marker, apart_m=0.05 * reach):
        misfit = _misfit(camera, other, X, xy, sigma)
        apart = float(np.linalg.norm(other.shift_m - pose.shift_m))
        if misfit < _TIMES_WORSE * max(best, 1.0):
            raise GeometryError(
                f"two poses {apart:.2f} m apart fit {len(X)} marks of {len(set(marker.tolist()))} markers",
                expected="marks that leave one solution",
                where=where,
                cure="Record it again so that the camera sees more markers, at different distances",
            )


def _misfit(camera: Camera, pose: Rigid, X: ArrayF, xy: ArrayF, sigma: ArrayF) -> float:
    """Root mean square of the residuals in units of their sigma."""
    off = np.linalg.norm(_project(camera, pose, X)[0] - xy, axis=1) / sigma
    return float(np.sqrt(np.nan_to_num(np.square(off), nan=1e12).mean() / 2))


def _moved(marker: ArrayI, used: ArrayB) -> tuple[int, ...]:
    """Markers seen with three corners or more of which not more than one fits."""
    found = []
    for m in np.unique(marker):
        mine = used[marker == m]
        if len(mine) >= 3 and mine.sum() <= 1:
            found.append(int(m))
    return tuple(found)


# ---------------------------------------------------------------- other readings of the marks of a picture
# that fits no pose: in reverse order, or of a mirrored picture


def reading_that_fits(
    marks: pd.DataFrame, size_px: tuple[int, int], sigma0_of: Callable[[pd.DataFrame], float], sigma0: float
) -> str:
    """Which other reading fits a pose, as a sentence without its full stop; "" if none does.

    Parameters
    ----------
    marks : marker, corner, x_px, y_px, sigma_px of one picture.
    size_px : width and height of the picture.
    sigma0_of : sigma of unit weight of marks, infinite if many do not fit; may refuse.
    sigma0 : of the marks as they are, infinite if they fit no pose at all.
    """
    width, height = size_px
    xy = marks[["x_px", "y_px"]].to_numpy(np.float64)
    readings = {
        "in reverse order": xy[::-1],
        "if the picture is mirrored left to right": xy * [-1.0, 1.0] + [width, 0.0],
        "if the picture is mirrored top to bottom": xy * [1.0, -1.0] + [0.0, height],
    }
    found: dict[str, float] = {}
    for words, moved in readings.items():
        try:
            found[words] = sigma0_of(marks.assign(x_px=moved[:, 0], y_px=moved[:, 1]))
        except (ThalwegError, np.linalg.LinAlgError):
            continue
    limit = min(FITS, _BETTER * sigma0)
    # a symmetric panel read backwards looks as in a mirror: then both are named
    fitting = [words for words, value in found.items() if value < limit]
    if not fitting:
        return ""
    return f"The marks fit {', and '.join(fitting)}: check their numbers, and use the files as stored"


# ---------------------------------------------------------------- start: from known points and the directions
# to them, without approximate values
#
# Three points and the angles between their rays leave up to four poses (Grunert 1841, in the form of Haralick
# et al. 1994). Many triples are solved at once, each pose is judged by its angles to all rays, and the best
# one is kept, as in RANSAC. Directions are unit vectors, not image coordinates, so that lenses beyond 90
# degrees off the axis work too.


def pose_from_rays(
    points_pcs: ArrayF, rays_ccs: ArrayF, groups: ArrayI, *, cap_rad: float, triples: int = _TRIPLES
) -> tuple[Rigid, ArrayF]:
    """Pose ``T_pcs_ccs`` that most rays agree with.

    Parameters
    ----------
    points_pcs : (n, 3) known points, n >= 4.
    rays_ccs : (n, 3) unit directions to them in the camera frame.
    groups : (n,) marker of each point; triples take three different markers where there are as many, because
        the corners of one marker are too close together.
    cap_rad : angle beyond which a ray is taken as wrong: each counts with its angle, but at most with this.
    triples : how many triples are tried.

    Returns
    -------
    The pose, without covariance, and the angle (n,) between each ray and the direction to its point.

    Raises
    ------
    GeometryError : fewer than four points, or no triple gives a pose.
    """
    n = len(points_pcs)
    if n < 4:
        raise GeometryError(f"{n} points", expected="at least 4: three leave up to four poses")
    chosen = _triples(groups, triples)
    R, C = _three_point_poses(points_pcs[chosen], rays_ccs[chosen])
    if len(R) == 0:
        raise GeometryError(
            f"no pose fits any three of {n} points",
            expected="rays that could have seen these points",
            cure="Check that the ids of the markers and the interior orientation belong to this picture",
        )
    cost = np.empty(len(R))
    for first in range(0, len(R), 256):
        part = slice(first, first + 256)
        cost[part] = np.minimum(_angles(R[part], C[part], points_pcs, rays_ccs), cap_rad).sum(axis=1)
    best = int(cost.argmin())
    pose = Rigid(R=R[best], shift_m=C[best])
    for _ in range(5):
        angles = _angles(pose.R[None], pose.shift_m[None], points_pcs, rays_ccs)[0]
        near = angles < cap_rad
        if near.sum() < 4:
            break
        pose = improved_pose(pose, points_pcs[near], rays_ccs[near])
    refined = _angles(pose.R[None], pose.shift_m[None], points_pcs, rays_ccs)[0]
    if np.minimum(refined, cap_rad).sum() > cost[best]:
        pose = Rigid(R=R[best], shift_m=C[best])
        refined = _angles(pose.R[None], pose.shift_m[None], points_pcs, rays_ccs)[0]
    return pose, refined


def _triples(groups: ArrayI, triples: int) -> AnyArray:
    rng = np.random.default_rng(_SEED)
    n = len(groups)
    draws = rng.random((4 * triples, n)).argsort(axis=1)[:, :3]
    kinds = groups[draws]
    different = (kinds[:, 0] != kinds[:, 1]) & (kinds[:, 0] != kinds[:, 2]) & (kinds[:, 1] != kinds[:, 2])
    best = draws[different] if different.any() else draws
    return best[:triples]


def _three_point_poses(P: ArrayF, r: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Rotations (k, 3, 3) from ccs to pcs and centres (k, 3) of triples (m, 3, 3) of points and rays."""
    a2 = ((P[:, 1] - P[:, 2]) ** 2).sum(axis=1)
    b2 = ((P[:, 0] - P[:, 2]) ** 2).sum(axis=1)
    c2 = ((P[:, 0] - P[:, 1]) ** 2).sum(axis=1)
    size = np.maximum(np.maximum(a2, b2), c2)
    wide = np.minimum(np.minimum(a2, b2), c2) > 1e-6 * size
    P, r, a2, b2, c2 = P[wide], r[wide], a2[wide], b2[wide], c2[wide]
    ca, cb, cg = (r[:, 1] * r[:, 2]).sum(1), (r[:, 0] * r[:, 2]).sum(1), (r[:, 0] * r[:, 1]).sum(1)
    q, p, s = (a2 - c2) / b2, (a2 + c2) / b2, c2 / b2
    A4 = (q - 1) ** 2 - 4 * s * ca**2
    A3 = 4 * (q * (1 - q) * cb - (1 - p) * ca * cg + 2 * s * ca**2 * cb)
    A2 = 2 * (
        q**2 - 1 + 2 * q**2 * cb**2 + 2 * (1 - s) * ca**2 - 4 * p * ca * cb * cg + 2 * (1 - a2 / b2) * cg**2
    )
    A1 = 4 * (-q * (1 + q) * cb + 2 * a2 / b2 * cg**2 * cb - (1 - p) * ca * cg)
    A0 = (1 + q) ** 2 - 4 * a2 / b2 * cg**2
    quartic = np.abs(A4) > 1e-12
    P, r, b2, q, ca, cb, cg = (x[quartic] for x in (P, r, b2, q, ca, cb, cg))
    if len(P) == 0:
        return np.empty((0, 3, 3)), np.empty((0, 3))
    companion = np.zeros((len(P), 4, 4))
    companion[:, 0] = -np.stack([A3, A2, A1, A0], axis=1)[quartic] / A4[quartic, None]
    companion[:, 1, 0] = companion[:, 2, 1] = companion[:, 3, 2] = 1.0
    roots = np.linalg.eigvals(companion)
    v = roots.real
    with np.errstate(divide="ignore", invalid="ignore"):
        u = ((q[:, None] - 1) * v**2 - 2 * (q * cb)[:, None] * v + 1 + q[:, None]) / (
            2 * (cg[:, None] - v * ca[:, None])
        )
        s1 = np.sqrt(b2[:, None] / (1 + v**2 - 2 * v * cb[:, None]))
        good = (np.abs(roots.imag) < _REAL * (1 + np.abs(v))) & (v > 0) & (u > 0) & np.isfinite(s1)
    k, root = np.nonzero(good)
    distances = np.stack([s1[k, root], u[k, root] * s1[k, root], v[k, root] * s1[k, root]], axis=1)
    R, shift_m, _ = fit_points(distances[:, :, None] * r[k], P[k])
    return R, shift_m


def _angles(R: ArrayF, C: ArrayF, points: ArrayF, rays: ArrayF) -> ArrayF:
    """(k, n) angles between rays and the directions to their points."""
    away = points[None] - C[:, None]
    turned = rays @ np.swapaxes(R, 1, 2)
    x, y, z = away[..., 0], away[..., 1], away[..., 2]
    u, v, w = turned[..., 0], turned[..., 1], turned[..., 2]
    across = np.sqrt((v * z - w * y) ** 2 + (w * x - u * z) ** 2 + (u * y - v * x) ** 2)
    return np.arctan2(across, u * x + v * y + w * z)


def improved_pose(pose: Rigid, points: ArrayF, rays: ArrayF) -> Rigid:
    """One Gauss-Newton step of a pose on the parts of unit directions across the rays, all of one weight.

    With the unit direction ``u`` to a point in pcs, its distance ``l``, its ray ``w`` turned into pcs and
    ``A = 1 - u u^T``, the derivatives of the direction in pcs are ``-A / l`` by the shift and ``[u]x`` by the
    rotation.
    """
    away = points - pose.shift_m
    length = np.sqrt(np.add.reduce(away * away, axis=1))
    u = away / length[:, None]
    near = u / length[:, None]
    w = rays @ pose.R.T
    N = np.zeros((6, 6))
    N[:3, :3] = np.square(1 / length).sum() * np.eye(3) - near.T @ near
    N[3:, 3:] = len(points) * np.eye(3) - u.T @ u
    N[:3, 3:] = -cross_matrix(near.sum(axis=0)[None])[0]
    N[3:, :3] = N[:3, 3:].T
    along = np.add.reduce(u * w, axis=1)
    (x, y, z), (a, b, c) = u.T, w.T
    turn = [np.sum(z * b - y * c), np.sum(x * c - z * a), np.sum(y * a - x * b)]
    n = np.concatenate([-((w - along[:, None] * u) / length[:, None]).sum(axis=0), turn])
    dx = np.linalg.lstsq(N, n, rcond=1e-12)[0]
    limit = float(np.linalg.norm(dx[3:]))
    return pose.moved(dx * min(1.0, 0.5 / max(limit, 1e-12)))


def other_poses(
    pose: Rigid, points_pcs: ArrayF, rays_ccs: ArrayF, groups: ArrayI, *, apart_m: float
) -> list[Rigid]:
    """The best few poses that fit the rays from somewhere else, at least ``apart_m`` away from ``pose``."""
    chosen = _triples(groups, 100)
    R, C = _three_point_poses(points_pcs[chosen], rays_ccs[chosen])
    elsewhere = np.linalg.norm(C - pose.shift_m, axis=1) > apart_m
    R, C = R[elsewhere], C[elsewhere]
    if len(R) == 0:
        return []
    cost = np.square(_angles(R, C, points_pcs, rays_ccs)).mean(axis=1)
    found = []
    for k in np.argsort(cost)[:6]:
        other = Rigid(R=R[k], shift_m=C[k])
        for _ in range(20):
            other = improved_pose(other, points_pcs, rays_ccs)
        if np.linalg.norm(other.shift_m - pose.shift_m) > apart_m:
            found.append(other)
    return found
