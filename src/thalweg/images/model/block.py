"""A block of images: who sees which point where, and a start for every pose and point.

This is what structure from motion hands to the adjustment. Pixels count from the upper left corner of the
image, as in `thalweg.core.camera`. The frame is either that of the structure-from-motion model (any
scale, any attitude) or, once the block has been transformed, the world frame wcs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Final, Self

import numpy as np

from thalweg.calibration.field import agreeing
from thalweg.core import (
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayI,
    Camera,
    GeometryError,
    cross_matrix,
    exp_rotation,
    root_mean_square,
    rotation_vector,
    rows_of,
)
from thalweg.core.geometry import fit_points, nearest_rotation
from thalweg.images.model.poses import ImagePoses
from thalweg.images.model.records import camera_of_record, camera_record, read_arrays, write_arrays

_FORMAT: Final = 1

FAR_M: Final = 10_000.0
"""Distance of control points from a block whose place is known beyond which the coordinates are others."""
_FIT_SHARE: Final = 0.03
"""Misfit of a point, as a share of the extent of all, that a bent model may have."""
_LEAST_FIT_M: Final = 0.3
_LINE_SHARE: Final = 0.01
"""Spread across the longest direction, as a share of that along it, below which points are a line."""
_MOST_PAIRS: Final = 150
_LEAST_ANGLE_RAD: Final = 0.003
"""Rays that meet within so much are never called wrong: two pixels of a wide lens."""
CURE_LINE: Final = (
    "Add a control point off the line, at another height or farther up the bank, or positions of the camera "
    "from a track that is not straight"
)

LEAST_IMAGES: Final = 3
"""Images with predictions below which nothing can be compared."""
_STEPS: Final = 30
_LEAST_SIGMA_M: Final = 0.01
_LEAST_SIGMA_RAD: Final = 1e-4
_HUBER: Final = 2.0
_MOTION: Final = 10.0
"""The extent of the projection centres over the sigma of predictions that a scale needs at least."""


# ---------------------------------------------------------------- block


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageBlock:
    """Images with poses, points, and the marks that join them.

    Parameters
    ----------
    cameras : interior orientations.
    images : i names, sorted.
    camera : (i,) index into ``cameras``.
    R_block_ccs : (i, 3, 3) rotations from the camera into the frame of the block.
    centre_block_m : (i, 3) projection centres; not metres before the block is scaled.
    points_block_m : (p, 3) object points.
    mark_image, mark_point : (m,) image and point of each measurement.
    mark_px : (m, 2) measured pixels.
    sigma_px : (m,) standard deviation of each coordinate of a measurement.

    Raises
    ------
    GeometryError : shapes that differ, or a mark of an image or a point that does not exist.
    """

    cameras: tuple[Camera, ...]
    images: tuple[str, ...]
    camera: ArrayI
    R_block_ccs: ArrayF
    centre_block_m: ArrayF
    points_block_m: ArrayF
    mark_image: ArrayI
    mark_point: ArrayI
    mark_px: ArrayF
    sigma_px: ArrayF

    def __post_init__(self) -> None:
        i, p, m = len(self.images), len(self.points_block_m), len(self.mark_image)
        shapes: dict[str, tuple[tuple[int, ...], tuple[int, ...]]] = {
            "camera": (self.camera.shape, (i,)),
            "R_block_ccs": (self.R_block_ccs.shape, (i, 3, 3)),
            "centre_block_m": (self.centre_block_m.shape, (i, 3)),
            "points_block_m": (self.points_block_m.shape, (p, 3)),
            "mark_point": (self.mark_point.shape, (m,)),
            "mark_px": (self.mark_px.shape, (m, 2)),
            "sigma_px": (self.sigma_px.shape, (m,)),
        }
        for name, (found, expected) in shapes.items():
            if found != expected:
                raise GeometryError(f"{name}.shape={found}", expected=str(expected))
        for name, at, n in (("image", self.mark_image, i), ("point", self.mark_point, p)):
            if m and not (int(at.min()) >= 0 and int(at.max()) < n):
                raise GeometryError(f"a mark of {name} {int(at.max())}", expected=f"{name}s 0 to {n - 1}")

    def transformed(self, R: ArrayF, shift_m: ArrayF, scale: float) -> "ImageBlock":
        """The block in another frame: ``x -> scale R x + shift``."""
        return replace(
            self,
            R_block_ccs=R @ self.R_block_ccs,
            centre_block_m=scale * self.centre_block_m @ R.T + shift_m,
            points_block_m=scale * self.points_block_m @ R.T + shift_m,
        )

    def residuals_px(self) -> ArrayF:
        """Measured minus projected pixels (m, 2); NaN for points behind their camera."""
        out = np.empty_like(self.mark_px)
        for k in range(len(self.images)):
            rows = np.flatnonzero(self.mark_image == k)
            seen = self.points_block_m[self.mark_point[rows]] - self.centre_block_m[k]
            xy = self.cameras[self.camera[k]].project(seen @ self.R_block_ccs[k])
            out[rows] = self.mark_px[rows] - xy
        return out

    def write(self, path: Path) -> None:
        """Write all arrays and cameras as one ``.npz``."""
        head = {"images": list(self.images), "cameras": [camera_record(c) for c in self.cameras]}
        names = [name for name in self.__dataclass_fields__ if name not in ("cameras", "images")]
        write_arrays(path, "image_block", _FORMAT, head, {name: getattr(self, name) for name in names})

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a block written by `write`.

        Raises
        ------
        InputError : no such file, or of another kind or version.
        """
        head, arrays = read_arrays(path, "image_block", _FORMAT)
        cameras = tuple(camera_of_record(camera) for camera in head["cameras"])
        return cls(cameras=cameras, images=tuple(head["images"]), **arrays)


# ---------------------------------------------------------------- control and check points


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlPoints:
    """Surveyed points in wcs.

    Parameters
    ----------
    names : k names.
    points_wcs_m : (k, 3) surveyed coordinates.
    cov_wcs_m2 : (k, 3, 3) their covariances.
    check : (k,) whether a point only checks the result.

    Raises
    ------
    GeometryError : shapes that differ, a name twice, or a covariance that is not positive.
    """

    names: tuple[str, ...]
    points_wcs_m: ArrayF
    cov_wcs_m2: ArrayF
    check: ArrayB

    def __post_init__(self) -> None:
        k = len(self.names)
        if len(set(self.names)) != k:
            twice = sorted({n for n in self.names if self.names.count(n) > 1})
            raise GeometryError(
                f"control point{'s' if len(twice) > 1 else ''} {', '.join(twice)} more than once",
                expected="one row for each point",
            )
        shapes = (self.points_wcs_m.shape, self.cov_wcs_m2.shape, self.check.shape)
        if shapes != ((k, 3), (k, 3, 3), (k,)):
            raise GeometryError(f"control points of the shapes {shapes}", expected=f"{k} points")
        bad = [
            n
            for n, c in zip(self.names, self.cov_wcs_m2, strict=True)
            if not np.isfinite(c).all() or np.linalg.eigvalsh(c)[0] <= 0
        ]
        if bad:
            raise GeometryError(
                f"no positive standard deviations of {', '.join(bad[:5])}",
                expected="metres above zero for each coordinate",
                cure="State how well the point was surveyed; 0 would make it perfect",
            )

    @classmethod
    def none(cls) -> "ControlPoints":
        """No points at all."""
        return cls(
            names=(),
            points_wcs_m=np.empty((0, 3)),
            cov_wcs_m2=np.empty((0, 3, 3)),
            check=np.empty(0, np.bool_),
        )

    @classmethod
    def joined(cls, parts: Sequence["ControlPoints"]) -> "ControlPoints":
        """Points of several surveys as one."""
        every = [cls.none(), *parts]
        return cls(
            names=tuple(name for part in every for name in part.names),
            points_wcs_m=np.concatenate([part.points_wcs_m for part in every]),
            cov_wcs_m2=np.concatenate([part.cov_wcs_m2 for part in every]),
            check=np.concatenate([part.check for part in every]),
        )

    def chosen(self, rows: AnyArray) -> "ControlPoints":
        """Some of the points, by index or mask."""
        return rows_of(self, rows)

    def as_check(self, names: Sequence[str]) -> "ControlPoints":
        """The same points, some of them made check points."""
        return replace(self, check=self.check | np.isin(np.array(self.names, object), list(names)))


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlMarks:
    """Marks of control and check points in images.

    Parameters
    ----------
    image, point : (n,) indices of images of the block and of control points.
    xy_px, sigma_px : (n, 2) pixels from the upper left corner, (n,) standard deviation of each coordinate.
    """

    image: ArrayI
    point: ArrayI
    xy_px: ArrayF
    sigma_px: ArrayF

    def __post_init__(self) -> None:
        n = len(self.image)
        shapes = (self.point.shape, self.xy_px.shape, self.sigma_px.shape)
        if shapes != ((n,), (n, 2), (n,)):
            raise GeometryError(f"marks of the shapes {shapes}", expected=f"{n} marks")
        if n and not (self.sigma_px > 0).all():
            raise GeometryError(
                f"a standard deviation of {self.sigma_px.min():g} px of a mark", expected="positive pixels"
            )

    @classmethod
    def none(cls) -> "ControlMarks":
        """No marks at all."""
        empty = np.empty(0, np.int64)
        return cls(image=empty, point=empty, xy_px=np.empty((0, 2)), sigma_px=np.empty(0))

    def chosen(self, rows: AnyArray) -> "ControlMarks":
        """Some of the marks, by index or mask."""
        return rows_of(self, rows)

    def counts(self, n_points: int) -> ArrayI:
        """Number of marks of each point."""
        return np.bincount(self.point, minlength=n_points).astype(np.int64)


# ---------------------------------------------------------------- where a block lies in the world: a
# similarity from control points or camera positions
#
# The frame of structure from motion has any scale and attitude. Three points that are not on a line fix it;
# more points tell which of them are wrong before the adjustment takes them for true.


@dataclass(frozen=True, slots=True, kw_only=True)
class Similarity:
    """``x_target = scale R x_source + shift``, and how points fit it.

    ``misfit_m`` (n,) distance of each point; ``fits`` (n,) those that made it; ``notes`` for people.
    """

    scale: float
    R: ArrayF
    shift_m: ArrayF
    misfit_m: ArrayF
    fits: ArrayB
    notes: list[str] = field(default_factory=list)

    def apply(self, points: ArrayF) -> ArrayF:
        """Points (n, 3) of the source in the target frame."""
        return np.asarray(self.scale * points @ self.R.T + self.shift_m)


def spread_share(points: ArrayF) -> float:
    """Second extent of points (n, 3) as a share of the first: 0 on a line."""
    s = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(s[1] / s[0]) if s[0] > 0 else 0.0


def is_line(points: ArrayF) -> bool:
    """Whether points (n, 3) lie on a line, as far as a block is concerned that they are to hold."""
    return spread_share(points) < _LINE_SHARE


def robust_similarity(
    source: ArrayF, target: ArrayF, names: Sequence[str], *, what: str, tolerance_m: float | None = None
) -> Similarity:
    """Similarity between points of which some may be wrong.

    The similarity of three that most points agree with wins, and the fitting points are adjusted together.
    Points that do not fit are named with their misfit.

    Parameters
    ----------
    source, target : (n, 3) in the frame of the block and in the world.
    names : of the points.
    what : what the points are, for messages.
    tolerance_m : misfit that is still good; None: 3 % of the extent, at least 0.3 m.

    Raises
    ------
    GeometryError : fewer than three points, or all on a line; or fewer than half of them agree.
    """
    n = len(source)
    if n < 3:
        raise GeometryError(
            f"{n} {what} measured in two images or more",
            expected="at least 3 that are not on a line",
            cure="Measure more of them, or give approximate positions of the camera",
        )
    for points in (source, target):
        if is_line(points):
            raise GeometryError(
                f"all {n} {what} lie on a line, about which the block can turn",
                expected=f"a spread across it of {100 * _LINE_SHARE:g} % of its length at least",
                cure=CURE_LINE,
            )
    extent = float(np.linalg.norm(np.ptp(target, axis=0)))
    tolerance = max(_LEAST_FIT_M, _FIT_SHARE * extent) if tolerance_m is None else tolerance_m
    fits = agreeing(source, target, np.full(n, tolerance), scaled=True)[0]
    if fits.sum() < max(3, n / 2):
        found = fit_points(source, target, scaled=True)
        off = _misfit(found, source, target)
        worst = int(np.argmax(off))
        raise GeometryError(
            f"{what} and the block do not have the same shape: after the best similarity {names[worst]} is "
            f"off by {off[worst]:.2f} m, the median is {np.median(off):.2f} m",
            expected=f"most of them within {tolerance:.2f} m",
            cure="Check the names of the points, the order of the coordinates and their CRS",
        )
    for _ in range(5):
        found = fit_points(source[fits], target[fits], scaled=True)
        off = _misfit(found, source, target)
        if np.array_equal(off < tolerance, fits) or (off < tolerance).sum() < 3:
            break
        fits = off < tolerance
    notes = [
        f"{names[i]} is {off[i]:.2f} m away from where the other {what} put it: left out"
        for i in np.flatnonzero(~fits).tolist()
    ]
    R, shift, scale = found
    return Similarity(scale=float(scale), R=R, shift_m=shift, misfit_m=off, fits=fits, notes=notes)


def _misfit(found: tuple[ArrayF, ArrayF, ArrayF], source: ArrayF, target: ArrayF) -> ArrayF:
    R, shift, scale = found
    return np.asarray(np.linalg.norm(scale * source @ R.T + shift - target, axis=1))


def triangulated(block: ImageBlock, marks: ControlMarks, n_points: int) -> ArrayF:
    """(k, 3) points of control marks in the frame of the block; NaN where fewer than two rays meet."""
    out = np.full((n_points, 3), np.nan)
    rays = np.empty((len(marks.image), 3))
    for c in np.unique(block.camera[marks.image]):
        of = np.flatnonzero(block.camera[marks.image] == c)
        seen = block.cameras[c].rays(marks.xy_px[of])
        rays[of] = np.einsum("mij,mj->mi", block.R_block_ccs[marks.image[of]], seen)
    centres = block.centre_block_m[marks.image]
    for k in range(n_points):
        rows = np.flatnonzero((marks.point == k) & np.isfinite(rays).all(axis=1))
        if len(rows) >= 2:
            out[k] = nearest_to_rays(centres[rows], rays[rows])
    return out


def nearest_to_rays(centres: ArrayF, rays: ArrayF) -> ArrayF:
    """Point (3,) nearest to most of the rays (n, 3); NaN where they are parallel.

    Of the points of all pairs, or an even choice of them, that with the least median angle to all rays tells
    which rays belong together.
    """
    n = len(rays)
    if n <= 2:
        return _meeting(centres, rays)
    pairs = np.array(list(combinations(range(n), 2)))
    pairs = pairs[:: max(1, len(pairs) // _MOST_PAIRS)]
    points = _meeting(centres[pairs], rays[pairs])
    # the pair itself fits by itself
    off = np.sort(_angles(points[:, None], centres, rays), axis=1)[:, (n + 2) // 2]
    if not np.isfinite(off).any():
        return np.full(3, np.nan)
    best = int(np.nanargmin(off))
    keep = _angles(points[best], centres, rays) <= max(3.0 * off[best], _LEAST_ANGLE_RAD)
    return _meeting(centres[keep], rays[keep])


def _meeting(centres: ArrayF, rays: ArrayF) -> ArrayF:
    """Points (..., 3) nearest to rays (..., n, 3); NaN where they are parallel."""
    across = np.eye(3) - rays[..., :, None] * rays[..., None, :]
    A = across.sum(axis=-3)
    b = np.einsum("...nij,...nj->...i", across, centres)
    known = np.isfinite(A).all(axis=(-2, -1))
    A = np.where(known[..., None, None], A, 0.0)
    known &= np.linalg.eigvalsh(A)[..., 0] >= 1e-7 * rays.shape[-2]
    A = np.where(known[..., None, None], A, np.eye(3))
    return np.where(known[..., None], np.linalg.solve(A, b[..., None])[..., 0], np.nan)


def _angles(point: ArrayF, centres: ArrayF, rays: ArrayF) -> ArrayF:
    away = point - centres
    length = np.maximum(np.linalg.norm(away, axis=-1), 1e-12)
    return np.asarray(np.linalg.norm(np.cross(away, rays), axis=-1) / length)


def start_from_control(block: ImageBlock, control: ControlPoints, marks: ControlMarks) -> Similarity:
    """Similarity from control points that are marked in two images or more; check points stay out of it."""
    found = triangulated(block, marks, len(control.names))
    rows = np.flatnonzero(np.isfinite(found[:, 0]) & ~control.check)
    result = robust_similarity(
        found[rows], control.points_wcs_m[rows], [control.names[i] for i in rows], what="control points"
    )
    fits = np.ones(len(control.names), np.bool_)
    fits[rows] = result.fits
    misfit = np.full(len(control.names), np.nan)
    misfit[rows] = result.misfit_m
    return Similarity(
        scale=result.scale, R=result.R, shift_m=result.shift_m, misfit_m=misfit, fits=fits, notes=result.notes
    )


def start_from_positions(block: ImageBlock, at: ArrayI, positions_wcs_m: ArrayF) -> Similarity:
    """Similarity from approximate positions (n, 3) of the cameras of images ``at`` (n,)."""
    return robust_similarity(
        block.centre_block_m[at],
        positions_wcs_m,
        [block.images[i] for i in at],
        what="camera positions",
        tolerance_m=max(2.0, _FIT_SHARE * float(np.linalg.norm(np.ptp(positions_wcs_m, axis=0)))),
    )


def check_place(control: ControlPoints, near_wcs_m: ArrayF) -> None:
    """Raise if control points lie far from where the images were taken.

    Raises
    ------
    GeometryError : a control point is more than 10 km from the middle of ``near_wcs_m`` (n, 3).
    """
    if not len(control.names) or not len(near_wcs_m):
        return
    middle = np.median(near_wcs_m, axis=0)
    away = np.linalg.norm(control.points_wcs_m - middle, axis=1)
    nearest, worst = int(np.argmin(away)), int(np.argmax(away))
    if away[worst] <= FAR_M:
        return
    single = away[nearest] <= FAR_M
    raise GeometryError(
        f"control point {control.names[worst]} lies {away[worst] / 1000:.1f} km from the images"
        + ("" if single else f", and the nearest, {control.names[nearest]}, {away[nearest] / 1000:.1f} km"),
        expected=f"control points within {FAR_M / 1000:g} km",
        cure="Check its coordinates" if single else "Check the CRS of the control points, and campaign.crs",
    )


# ---------------------------------------------------------------- a model in its own frame on the predicted
# trajectory
#
# Predictions come from INS and clock. They fix scale, place and attitude of a model only as well as they are
# themselves, so that an aligned model errs as a whole by what they err by.


@dataclass(frozen=True, slots=True, kw_only=True)
class Aligned:
    """``x_wcs = scale R x_file + shift``; poses in wcs, and their rms distance and angle from predictions."""

    scale: float
    R: ArrayF
    shift_m: ArrayF
    centre_wcs_m: ArrayF
    R_wcs_ccs: ArrayF
    rms_m: float
    rms_rad: float


def mean_rotation(turns: ArrayF) -> ArrayF:
    """Rotation (3, 3) nearest to most of the rotations (n, 3, 3): chordal mean, the farthest left out."""
    keep = np.ones(len(turns), np.bool_)
    R = np.eye(3)
    for _ in range(5):
        R = nearest_rotation(turns[keep].sum(axis=0))
        off = angles_between(turns, np.broadcast_to(R, turns.shape))
        keep = off <= max(3.0 * float(np.median(off)), 1e-9)
    return R


def angles_between(a: ArrayF, b: ArrayF) -> ArrayF:
    """Angles (n,) in radians between rotations (n, 3, 3)."""
    return np.linalg.norm(rotation_vector(a @ np.swapaxes(b, 1, 2)), axis=1)


def comparable(predictions: ImagePoses) -> ArrayB:
    """Which images have a prediction."""
    return predictions.oriented & np.isfinite(predictions.centre_wcs_m).all(axis=1)


def predicted_sigmas(predictions: ImagePoses) -> tuple[float, float]:
    """Median sigmas of the predicted positions (3D, m) and rotations (rad); 0 where none is stated."""
    cov = predictions.cov_pose_wcs[comparable(predictions)]
    cov = cov[np.isfinite(cov).all(axis=(1, 2))]
    if not len(cov):
        return 0.0, 0.0
    variance = np.maximum(np.diagonal(cov, axis1=1, axis2=2), 0.0)
    place, turn = np.sqrt(variance[:, :3].sum(axis=1)), np.sqrt(variance[:, 3:].sum(axis=1))
    return float(np.median(place)), float(np.median(turn))


def align(
    centre: ArrayF,
    R_file_ccs: ArrayF,
    predicted_m: ArrayF,
    R_wcs_ccs: ArrayF,
    sigma_m: float,
    sigma_rad: float,
) -> Aligned:
    """Similarity that brings poses of a free frame closest to predicted ones, positions and attitudes at
    once.

    Weighted least squares with Huber's weights; on a straight track the attitudes keep the model from
    turning about it, which positions alone cannot.

    Parameters
    ----------
    centre, R_file_ccs : (n, 3), (n, 3, 3) in the file's frame.
    predicted_m, R_wcs_ccs : (n, 3), (n, 3, 3) in wcs.
    sigma_m, sigma_rad : of predicted positions and rotations.

    Raises
    ------
    GeometryError : fewer than three images, or all of them at one place: no scale.
    """
    sigma_m, sigma_rad = max(sigma_m, _LEAST_SIGMA_M), max(sigma_rad, _LEAST_SIGMA_RAD)
    extent = float(np.linalg.norm(np.ptp(predicted_m, axis=0))) if len(centre) else 0.0
    spread = float(np.linalg.norm(np.ptp(centre, axis=0))) if len(centre) else 0.0
    if len(centre) < LEAST_IMAGES or extent < _MOTION * sigma_m or not spread > 0:
        raise GeometryError(
            f"{len(centre)} images over {extent:.2f} m with predictions good to {sigma_m:.2f} m, and a model "
            "without scale",
            expected=f"at least {LEAST_IMAGES} images over {_MOTION * sigma_m:.1f} m",
            cure="Scale and place the model with control points",
        )
    R = mean_rotation(R_wcs_ccs @ np.swapaxes(R_file_ccs, 1, 2))
    middle = np.median(centre, axis=0)
    turned = (centre - middle) @ R.T
    away = predicted_m - np.median(predicted_m, axis=0)
    log_scale = float(np.log(extent / spread))
    if (turned * away).sum() > 0:
        log_scale = float(np.log((turned * away).sum() / (turned * turned).sum()))
    shift = np.median(predicted_m - np.exp(log_scale) * turned, axis=0)
    for _ in range(_STEPS):
        moved = np.exp(log_scale) * (centre - middle) @ R.T
        off_m = predicted_m - moved - shift
        off_rad = rotation_vector(R_wcs_ccs @ np.swapaxes(R @ R_file_ccs, 1, 2))
        A = np.zeros((len(centre), 6, 7))
        A[:, :3, :3] = -cross_matrix(moved)
        A[:, :3, 3:6] = np.eye(3)
        A[:, :3, 6] = moved
        A[:, 3:, :3] = np.eye(3)
        w_m = _huber(off_m / sigma_m) / sigma_m
        w_rad = _huber(off_rad / sigma_rad) / sigma_rad
        root = np.concatenate([np.repeat(w_m, 3, axis=1), np.repeat(w_rad, 3, axis=1)], axis=1)
        y = np.concatenate([off_m, off_rad], axis=1) * root
        d = np.linalg.lstsq((A * root[:, :, None]).reshape(-1, 7), y.ravel(), rcond=None)[0]
        R = exp_rotation(d[:3]) @ R
        shift, log_scale = shift + d[3:6], log_scale + float(d[6])
        if np.abs(d[:3]).max() < 1e-12 and abs(d[6]) < 1e-12 and np.abs(d[3:6]).max() < 1e-9:
            break
    scale = float(np.exp(log_scale))
    placed, turned_R = scale * (centre - middle) @ R.T + shift, R @ R_file_ccs
    return Aligned(
        scale=scale,
        R=R,
        shift_m=shift - scale * R @ middle,
        centre_wcs_m=placed,
        R_wcs_ccs=turned_R,
        rms_m=float(np.sqrt(np.square(placed - predicted_m).sum(axis=1).mean())),
        rms_rad=root_mean_square(angles_between(turned_R, R_wcs_ccs)),
    )


def _huber(v: ArrayF) -> ArrayF:
    """Square roots (n, 1) of Huber's weights of vectors (n, 3) in units of their sigmas."""
    size = np.linalg.norm(v, axis=1, keepdims=True) / np.sqrt(3.0)
    return np.asarray(np.sqrt(np.minimum(1.0, _HUBER / np.maximum(size, 1e-12))))
