"""Relative orientation from boards that camera and lidar measured before: middle and normal of each.

The form in which other programs keep their observations. Middles give the shift and, where they spread, the
rotation; normals give the rotation. The scatter of both is estimated from what is left over.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from thalweg.calibration.camera_lidar.model import ORIENTATION
from thalweg.core.adjustment.solve import Linear, Observations, adjust
from thalweg.core.errors import GeometryError
from thalweg.core.propagation import beam_axes, cross_matrix
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayF

_ROUNDS = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardPoses:
    """Boards as one sensor saw them: ``middle_m`` (n, 3) and ``normal`` (n, 3) toward the sensors."""

    middle_m: ArrayF
    normal: ArrayF

    @classmethod
    def of(cls, middle_m: ArrayLike, normal: ArrayLike) -> "BoardPoses":
        """From any arrays; normals are made unit vectors.

        Raises
        ------
        GeometryError : shapes that do not match.
        """
        c, n = np.asarray(middle_m, dtype=np.float64), np.asarray(normal, dtype=np.float64)
        if c.ndim != 2 or c.shape[1] != 3 or n.shape != c.shape:
            raise GeometryError(
                f"middles {c.shape} and normals {n.shape} of boards", expected="(n, 3) and (n, 3)"
            )
        return cls(middle_m=c, normal=n / np.linalg.norm(n, axis=1, keepdims=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class PosesCalibration:
    """Result: ``T_ccs_scs`` with covariance, standard deviations found, RMS distance of the middles."""

    T_ccs_scs: Rigid
    sigma_middle_m: float
    sigma_normal_rad: float
    rms_middle_m: float


def calibrate_board_poses(
    camera: BoardPoses, lidar: BoardPoses, *, sigma_middle_m: float = 0.01, sigma_normal_deg: float = 1.0
) -> PosesCalibration:
    """Relative orientation from boards seen by camera and lidar.

    Parameters
    ----------
    camera, lidar : the same boards, in ccs and in scs.
    sigma_middle_m, sigma_normal_deg : standard deviations to begin with, in each direction.

    Raises
    ------
    UnobservableError : the boards leave the orientation undetermined.
    GeometryError : other numbers of boards, or fewer than three.
    """
    n = len(camera.middle_m)
    if len(lidar.middle_m) != n or n < 3:
        raise GeometryError(
            f"{n} boards of the camera and {len(lidar.middle_m)} of the lidar",
            expected="the same number, at least three",
        )
    sigma = np.array([sigma_middle_m, np.deg2rad(sigma_normal_deg)])
    T = _start(camera, lidar)
    for _ in range(_ROUNDS):
        adjusted = adjust(
            _groups(camera, lidar, sigma), T, ORIENTATION, update=Rigid.moved,
            cure="Add boards at other places and with other tilts",
        )  # fmt: skip
        T = adjusted.x
        found = np.array([adjusted.group_sigma0["middles"], adjusted.group_sigma0["normals"]])
        sigma = sigma * np.maximum(found, 1e-3)
        if np.all(np.abs(found - 1) < 0.01):
            break
    off = adjusted.residuals["middles"].reshape(-1, 3)
    return PosesCalibration(
        T_ccs_scs=T.with_cov(adjusted.cov),
        sigma_middle_m=float(sigma[0]),
        sigma_normal_rad=float(sigma[1]),
        rms_middle_m=float(np.sqrt(np.mean(np.sum(off**2, axis=1)))),
    )


def _start(camera: BoardPoses, lidar: BoardPoses) -> Rigid:
    """Closed form: rotation of normals and of middles about their mean (Kabsch 1976), then the shift."""
    a, b = camera.middle_m - camera.middle_m.mean(axis=0), lidar.middle_m - lidar.middle_m.mean(axis=0)
    H = np.vstack([a, camera.normal]).T @ np.vstack([b, lidar.normal])
    U, _, Vt = np.linalg.svd(H)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return Rigid(R=R, shift_m=camera.middle_m.mean(axis=0) - R @ lidar.middle_m.mean(axis=0))


def _groups(camera: BoardPoses, lidar: BoardPoses, sigma: ArrayF) -> Sequence[Observations[Rigid]]:
    n = len(camera.middle_m)
    across = np.swapaxes(beam_axes(camera.normal)[:, :, 1:], 1, 2)

    def middles(T: Rigid) -> Linear:
        """Three differences a board."""
        residual = T.apply(lidar.middle_m) - camera.middle_m
        J = T.by_error(lidar.middle_m).reshape(-1, 6)
        return Linear(residual=residual.ravel(), jacobian=J, cov=np.full(3 * n, sigma[0] ** 2))

    def normals(T: Rigid) -> Linear:
        """Two differences across the camera's normal."""
        turned = lidar.normal @ T.R.T
        J = np.concatenate([np.zeros((n, 2, 3)), -across @ cross_matrix(turned)], axis=2)
        residual = np.einsum("nij,nj->ni", across, turned)
        return Linear(residual=residual.ravel(), jacobian=J.reshape(-1, 6), cov=np.full(2 * n, sigma[1] ** 2))

    return [Observations("middles", middles), Observations("normals", normals)]
