"""A model in a frame of its own on the predicted trajectory, and how far poses are from predicted ones.

Predictions come from INS and clock. They fix scale, place and attitude of a model only as well as they are
themselves, so that an aligned model errs as a whole by what they err by.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.errors import GeometryError
from thalweg.core.propagation import cross_matrix
from thalweg.core.rigid import exp_rotation, rotation_vector
from thalweg.core.types import ArrayB, ArrayF
from thalweg.images.model.poses import ImagePoses

LEAST_IMAGES: Final = 3
"""Images with predictions below which nothing can be compared."""
_STEPS: Final = 30
_LEAST_SIGMA_M: Final = 0.01
_LEAST_SIGMA_RAD: Final = 1e-4
_HUBER: Final = 2.0
_MOTION: Final = 10.0
"""The extent of the projection centres over the sigma of predictions that a scale needs at least."""


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
        U, _, Vt = np.linalg.svd(turns[keep].sum(axis=0))
        R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        off = angles_between(turns, np.broadcast_to(R, turns.shape))
        keep = off <= max(3.0 * float(np.median(off)), 1e-9)
    return np.asarray(R)


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


def align(centre: ArrayF, R_file_ccs: ArrayF, predicted_m: ArrayF, R_wcs_ccs: ArrayF,
          sigma_m: float, sigma_rad: float) -> Aligned:  # fmt: skip
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
        scale=scale, R=R, shift_m=shift - scale * R @ middle, centre_wcs_m=placed, R_wcs_ccs=turned_R,
        rms_m=float(np.sqrt(np.square(placed - predicted_m).sum(axis=1).mean())),
        rms_rad=float(np.sqrt(np.square(angles_between(turned_R, R_wcs_ccs)).mean())),
    )  # fmt: skip


def _huber(v: ArrayF) -> ArrayF:
    """Square roots (n, 1) of Huber's weights of vectors (n, 3) in units of their sigmas."""
    size = np.linalg.norm(v, axis=1, keepdims=True) / np.sqrt(3.0)
    return np.asarray(np.sqrt(np.minimum(1.0, _HUBER / np.maximum(size, 1e-12))))
