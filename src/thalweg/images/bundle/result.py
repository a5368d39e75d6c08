"""What an adjusted block tells: poses with covariances, cameras, points, control points with their tests."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.stats import chi2

from thalweg.core.camera.model import Camera
from thalweg.core.frames import LocalFrame
from thalweg.core.types import ArrayB, ArrayF
from thalweg.images.bundle.adjustment import Adjusted
from thalweg.images.bundle.linear import along_and_across, linearised
from thalweg.images.bundle.weights import LEAST_IMAGE_MARKS
from thalweg.images.model.block import ImageBlock
from thalweg.images.model.poses import ImagePoses
from thalweg.images.model.start import swapped

_LEAST_SHARE: Final = 0.05
"""Share of a coordinate's variance that must be left to its residual for a test."""
FEW_MARKS: Final = f"fewer than {LEAST_IMAGE_MARKS} marks fit the rest of the block"


def pose_covariance(adjusted: Adjusted) -> ArrayF:
    """(6 i, 6 i) joint covariance of all poses: shift and rotation vector of each image, in wcs."""
    n = adjusted.layout.n_poses
    return adjusted.cov[:n, :n]


def adjusted_cameras(adjusted: Adjusted) -> tuple[Camera, ...]:
    """Cameras with the covariance of their parameters; held ones keep what was known of them."""
    out = []
    for camera, at in zip(adjusted.x.cameras, adjusted.layout.interior, strict=True):
        sought = np.flatnonzero(at >= 0)
        cov = camera.cov.copy()
        if len(sought):
            # parameters that are held are taken as known: no correlation with those that are sought
            cov[sought] = 0.0
            cov[:, sought] = 0.0
            cov[np.ix_(sought, sought)] = adjusted.cov[np.ix_(at[sought], at[sought])]
        out.append(camera.with_parameters(camera.parameters, (cov + cov.T) / 2))
    return tuple(out)


def adjusted_block(adjusted: Adjusted) -> ImageBlock:
    """The block in the world frame with adjusted poses, cameras and points; all marks stay."""
    b, x = adjusted.problem.block, adjusted.x
    return ImageBlock(
        cameras=adjusted_cameras(adjusted),
        images=b.images,
        camera=b.camera,
        R_block_ccs=x.R,
        centre_block_m=x.C + adjusted.origin_m,
        points_block_m=x.X + adjusted.origin_m,
        mark_image=b.mark_image,
        mark_point=b.mark_point,
        mark_px=b.mark_px,
        sigma_px=b.sigma_px,
    )


def image_poses(
    adjusted: Adjusted,
    frame: LocalFrame,
    images: Sequence[str],
    reasons: dict[str, str],
    times: dict[str, tuple[float, float]],
    facts: dict[str, Any] | None = None,
) -> ImagePoses:
    """Poses of all images of a run, in the order given; those without a pose keep their reason.

    Parameters
    ----------
    images : all names.
    reasons : why an image has no pose.
    times : GPS time and its standard deviation by name.
    """
    block = adjusted.problem.block
    at = {name: k for k, name in enumerate(block.images)}
    n, Q = len(images), pose_covariance(adjusted)
    index = np.array([at.get(name, -1) for name in images], np.int64)
    lost = (index >= 0) & adjusted.lost_images[index]
    reasons = {**reasons, **{images[k]: FEW_MARKS for k in np.flatnonzero(lost).tolist()}}
    known = (index >= 0) & ~lost
    centre, R = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    cov, following = np.full((n, 6, 6), np.nan), np.zeros((n, 6, 6))
    centre[known] = adjusted.x.C[index[known]] + adjusted.origin_m
    R[known] = adjusted.x.R[index[known]]
    rows = np.flatnonzero(known)
    for a, row in enumerate(rows):
        own = slice(6 * index[row], 6 * index[row] + 6)
        cov[row] = (Q[own, own] + Q[own, own].T) / 2
        if a + 1 < len(rows):
            other = index[rows[a + 1]]
            following[row] = Q[own, 6 * other : 6 * other + 6]
    following[~known] = np.nan
    count, rms = image_statistics(adjusted)
    t = np.array([times.get(name, (np.nan, np.nan)) for name in images], np.float64).reshape(n, 2)
    return ImagePoses(
        frame=frame,
        images=tuple(images),
        t_gps_s=t[:, 0],
        sigma_t_s=t[:, 1],
        oriented=known,
        reasons=tuple(
            "" if k else reasons.get(name, "not in the block") for name, k in zip(images, known, strict=True)
        ),
        centre_wcs_m=centre,
        R_wcs_ccs=R,
        cov_pose_wcs=cov,
        cov_next=following,
        n_marks=np.where(known, count[index], 0.0).astype(np.float64),
        rms_px=np.where(known, rms[index], np.nan),
        facts=facts or {},
    )


def image_statistics(adjusted: Adjusted) -> tuple[ArrayF, ArrayF]:
    """(i,) used marks of each image, and the rms of their residuals in pixels, both coordinates together."""
    block, marks = adjusted.problem.block, adjusted.problem.marks
    n = len(block.images)
    tie, control = adjusted.used, adjusted.control_used
    image = np.concatenate([block.mark_image[tie], marks.image[control]])
    off = np.concatenate([adjusted.residual_px[tie], adjusted.control_residual_px[control]])
    count = np.bincount(image, minlength=n).astype(np.float64)
    square = np.bincount(image, np.square(off).sum(axis=1) / 2, minlength=n)
    with np.errstate(invalid="ignore", divide="ignore"):
        return count, np.sqrt(square / count)


def point_covariances(adjusted: Adjusted, points: Sequence[int]) -> ArrayF:
    """(n, 3, 3) covariances of tie points, their correlation with images and cameras included.

    NaN for points that take no part. With ``dX = V^-1 A^T W (r - J d)`` the error of a point is
    ``V^-1 + K Q K^T`` with ``K = V^-1 A^T W J``.
    """
    tracks, layout, x = adjusted.tracks, adjusted.layout, adjusted.x
    where = {int(p): k for k, p in enumerate(tracks.point)}
    out = np.full((len(points), 3, 3), np.nan)
    q = layout.n_interior
    for row, p in enumerate(points):
        k = where.get(int(p))
        if k is None:
            continue
        s = slice(int(tracks.first[k]), int(tracks.first[k + 1]))
        image, n = tracks.image[s], s.stop - s.start
        part = linearised(adjusted.problem, layout, x, image, np.repeat(x.X[[p]], n, axis=0), tracks.xy_px[s])
        part = along_and_across(part, tracks.along[s])
        W = np.linalg.inv(adjusted.correlation.covariances(tracks.view[s], tracks.sigma_px[s]))
        WA = np.einsum("aij,jax->iax", W, part.by_point)
        V = np.einsum("iax,iay->xy", part.by_point, WA)
        columns = np.concatenate(
            [*(np.arange(6 * i, 6 * i + 6) for i in image), layout.n_poses + np.arange(q)]
        )
        K = np.concatenate(
            [*(np.einsum("ax,ab->xb", WA[i], part.by_pose[i]) for i in range(n)),
             np.einsum("iax,iab->xb", WA, part.by_rest)], axis=1,
        )  # fmt: skip
        K = np.linalg.solve(V, K)
        scale = adjusted.cov_scale
        # an image may hold two marks of a point: its columns then stand twice, which the sum allows
        out[row] = scale * np.linalg.inv(V) + K @ adjusted.cov[np.ix_(columns, columns)] @ K.T
    return out


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlResult:
    """How control and check points came out.

    ``off_m`` (k, 3) adjusted minus surveyed; ``cov_m2`` (k, 3, 3) predicted covariance of it; ``without_m``
    (k, 3) the same if the point's own coordinates had taken no part, with ``cov_without_m2``; ``test`` (k,)
    chi-square of three degrees of freedom of either; ``n_marks``, ``rms_px`` (k,) of used marks;
    ``suspect`` (k,) points that do not fit the others; ``notes`` for people.
    """

    off_m: ArrayF
    cov_m2: ArrayF
    without_m: ArrayF
    cov_without_m2: ArrayF
    test: ArrayF
    n_marks: ArrayF
    rms_px: ArrayF
    suspect: ArrayB
    notes: list[str]


def _against_others(off: ArrayF, cov: ArrayF, C: ArrayF) -> tuple[float, ArrayF, ArrayF]:
    """Test of a control point's residual (3,), difference without its own coordinates, covariance of it.

    In directions that nothing else fixes a residual is what iterations and robust weights left: it is not
    tested there, and stays as it is with the covariance of the coordinates.
    """
    L = np.linalg.cholesky(C)
    share, axes = np.linalg.eigh(np.linalg.solve(L, np.linalg.solve(L, cov).T))
    told = share > _LEAST_SHARE
    r = axes.T @ np.linalg.solve(L, off)
    factor = np.where(told, 1.0 / np.where(told, share, 1.0), 1.0)
    turn = L @ axes
    return float((np.square(r) * factor)[told].sum()), turn @ (r * factor), (turn * factor) @ turn.T


def control_result(adjusted: Adjusted, *, risk: float = 1e-4) -> ControlResult:
    """Differences of control and check points, each tested against all others.

    A check point's difference has the covariance ``C + Q`` of survey and block, a control point's ``C - Q``,
    because it has pulled the block to itself. Without its own coordinates a control point would be at
    ``C (C - Q)^-1 (adjusted - surveyed)``, with the covariance ``C (C - Q)^-1 C`` of that difference.

    Parameters
    ----------
    risk : share of good points that the test accuses.
    """
    control, marks, layout = adjusted.problem.control, adjusted.problem.marks, adjusted.layout
    k = len(control.names)
    off = adjusted.x.G - control.points_wcs_m
    # what was stated counts with the same factor as what came out
    C = adjusted.cov_scale * control.cov_wcs_m2
    Q = np.array([adjusted.cov[layout.point(i), layout.point(i)] for i in range(k)]).reshape(k, 3, 3)
    check = control.check[:, None, None]
    cov = np.where(check, C + Q, C - adjusted.control_cov_m2)
    # a check point that lost its marks has no place
    lost = control.check & ~adjusted.layout.free[layout.control :: 3]
    off[lost], cov[lost] = np.nan, np.nan
    test, without, cov_without = np.empty(k), off.copy(), cov.copy()
    for p in range(k):
        if control.check[p]:
            test[p] = off[p] @ np.linalg.solve(cov[p], off[p]) if np.isfinite(off[p]).all() else np.nan
        else:
            test[p], without[p], cov_without[p] = _against_others(off[p], cov[p], C[p])
    used = adjusted.control_used
    count = np.bincount(marks.point[used], minlength=k).astype(np.float64)
    square = np.bincount(
        marks.point[used], np.square(adjusted.control_residual_px[used]).sum(axis=1) / 2, minlength=k
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        rms = np.sqrt(square / count)
    with np.errstate(invalid="ignore"):
        suspect = test > chi2.isf(risk, 3)
    notes = [
        f"{'Check' if control.check[i] else 'Control'} point {control.names[i]} lies "
        f"{np.linalg.norm(without[i]):.3f} m from where all others put it, {np.sqrt(test[i] / 3):.1f} times "
        "what its sigma allows"
        for i in np.flatnonzero(suspect)
    ]
    found = control.points_wcs_m + without
    notes += swapped(
        found, control.points_wcs_m, control.names, np.flatnonzero(suspect),
        max(0.3, 0.5 * float(np.median(np.linalg.norm(without[suspect], axis=1))) if suspect.any() else 0.3),
    )  # fmt: skip
    strange = np.flatnonzero((count == 0) & (marks.counts(k) > 0))
    notes += [
        f"None of the {int(marks.counts(k)[i])} marks of {control.names[i]} fits: is it another point?"
        for i in strange
    ]
    return ControlResult(
        off_m=off, cov_m2=cov, without_m=without, cov_without_m2=cov_without, test=test, n_marks=count,
        rms_px=rms, suspect=suspect, notes=notes,
    )  # fmt: skip
