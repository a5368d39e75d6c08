"""Rigid transforms that carry their covariance.

``x_target = R_target_source x_source + shift_target``. A transform errs by a shift and by a small rotation
vector, both in the *target* frame and in this order, as the links of `thalweg.core.rigid`::

    R_true = exp([dtheta]x) R,      shift_true = shift + dshift
    dx_target = dshift + dtheta x (R x_source)
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from thalweg.core.errors import GeometryError
from thalweg.core.frames import opk_axes, rotation_opk, transform
from thalweg.core.types import ArrayF

_ONE: Final = np.eye(3)
_ALLOWED: Final = 1e-9 + 1e-5 * _ONE
"""What ``R R^T`` may be off. A product of a few rotations in float64 is orthogonal to some 1e-16, a matrix
with 9 digits to 1e-9; rows of such a matrix have unit length to 1e-5."""

SHIFT: Final = slice(0, 3)
TURN: Final = slice(3, 6)
"""Columns of the derivatives by a link: three of the shift, three of the small rotation vector."""
_HALVES: Final = np.r_[3:6, 0:3]
"""Rotation before shift, as people write them -> shift before rotation."""


# ---------------------------------------------------------------- transforms


@dataclass(frozen=True, slots=True, kw_only=True)
class Rigid:
    """``T_target_source`` with the covariance of its error; by default both frames are the same.

    Parameters
    ----------
    R : (3, 3) rotation from the source to the target frame.
    shift_m : (3,) origin of the source in the target frame.
    cov : (6, 6) covariance of (shift in metres; small rotation vector in radians), in the target frame.

    Raises
    ------
    GeometryError : the matrix is no rotation, or the covariance is none.

    Examples
    --------
    >>> turn = Rigid(R=rotation_opk(0.0, 0.0, np.pi / 2), shift_m=np.array([1.0, 0.0, 0.0]))
    >>> (turn.inverse() @ turn).apply([[1.0, 2.0, 3.0]]).round(12)
    array([[1., 2., 3.]])
    """

    R: ArrayF = field(default_factory=lambda: np.eye(3))
    shift_m: ArrayF = field(default_factory=lambda: np.zeros(3))
    cov: ArrayF = field(default_factory=lambda: np.zeros((6, 6)))

    def __post_init__(self) -> None:
        R, shift, C = (np.asarray(a, dtype=np.float64) for a in (self.R, self.shift_m, self.cov))
        known = R.shape == (3, 3) and shift.shape == (3,) and np.isfinite(shift).all()
        if not known or not (np.abs(R @ R.T - _ONE) <= _ALLOWED).all() or np.linalg.det(R) < 0:
            raise GeometryError(
                "these nine numbers are no rotation matrix, or the shift is no point",
                expected="an orthogonal matrix with determinant +1, and three metres",
                cure="Check the order of the elements, and that they have no scale and no reflection",
            )
        if C.shape != (6, 6) or (C.any() and not _is_covariance(C)):
            raise GeometryError(
                "no covariance matrix of a transform",
                expected="a symmetric 6x6 matrix without negative eigenvalues: shift, rotation vector",
            )
        for name, value in (("R", R), ("shift_m", shift), ("cov", C)):
            object.__setattr__(self, name, value)

    @classmethod
    def from_matrix(cls, T_target_source: ArrayLike, cov: ArrayLike | None = None) -> Self:
        """From a 4x4 matrix.

        Raises
        ------
        GeometryError : the matrix has another shape, another last row, a scale or a reflection.
        """
        T = np.asarray(T_target_source, dtype=np.float64)
        if T.shape != (4, 4) or not np.array_equal(T[3], [0.0, 0.0, 0.0, 1.0]):
            raise GeometryError(
                f"a matrix of the shape {T.shape}"
                + (f" with the last row {T[3]}" if T.shape == (4, 4) else ""),
                expected="4x4 with the last row 0 0 0 1",
                cure="If the last column is 0 0 0 1 the matrix is transposed",
            )
        given = np.zeros((6, 6)) if cov is None else np.asarray(cov, dtype=np.float64)
        return cls(R=T[:3, :3], shift_m=T[:3, 3], cov=given)

    @classmethod
    def from_opk(cls, angles_rad: ArrayLike, shift_m: ArrayLike, cov: ArrayLike | None = None) -> Self:
        """From ``R_x(omega) R_y(phi) R_z(kappa)``; ``cov`` (6, 6) is that of (shift; omega, phi, kappa)."""
        omega, phi, kappa = np.asarray(angles_rad, dtype=np.float64)
        J = np.eye(6)
        J[3:, 3:] = opk_axes(omega, phi)
        given = np.zeros((6, 6)) if cov is None else J @ np.asarray(cov, dtype=np.float64) @ J.T
        return cls(R=rotation_opk(omega, phi, kappa), shift_m=np.asarray(shift_m, np.float64), cov=given)

    @classmethod
    def from_mount(cls, section: Mapping[str, Any]) -> Self:
        """``T_ics_sensor`` of a sensor as a campaign file describes it, with its sigmas and correlations.

        ``omega_deg, phi_deg, kappa_deg, lever_ics_m``, ``sigma_omega_deg`` and so on, ``sigma_lever_m``, and
        ``correlation``, a 6x6 matrix in the order omega, phi, kappa, x, y, z or None. With
        ``sigma_axes: ics`` the first three sigmas are of rotations about the axes of ics.
        """
        names = ("omega", "phi", "kappa")
        omega, phi, kappa = np.deg2rad([section[f"{name}_deg"] for name in names])
        turn = np.deg2rad([section[f"sigma_{name}_deg"] for name in names])
        sigma = np.concatenate([turn, np.asarray(section["sigma_lever_m"], dtype=np.float64)])
        given = section.get("correlation")
        correlation = np.eye(6) if given is None else np.asarray(given, dtype=np.float64)
        J = np.eye(6)
        if section.get("sigma_axes", "angles") == "angles":
            J[:3, :3] = opk_axes(omega, phi)
        correlation = (correlation + correlation.T) / 2  # equal to the digits that people write
        cov = J @ (correlation * np.outer(sigma, sigma)) @ J.T
        return cls(
            R=rotation_opk(omega, phi, kappa),
            shift_m=np.asarray(section["lever_ics_m"], dtype=np.float64),
            cov=cov[np.ix_(_HALVES, _HALVES)],
        )

    @property
    def matrix(self) -> ArrayF:
        """4x4 matrix."""
        return transform(self.R, self.shift_m)

    @property
    def sigma_shift_m(self) -> ArrayF:
        """(3,) standard deviations of the shift."""
        return np.sqrt(np.maximum(np.diag(self.cov)[:3], 0.0))

    @property
    def sigma_rotation_rad(self) -> ArrayF:
        """(3,) standard deviations of the rotation vector about the axes of the target frame."""
        return np.sqrt(np.maximum(np.diag(self.cov)[3:], 0.0))

    def apply(self, points_m: ArrayLike) -> ArrayF:
        """Points (n, 3) of the source in the target frame."""
        return np.asarray(np.asarray(points_m, dtype=np.float64) @ self.R.T + self.shift_m)

    def by_error(self, points_m: ArrayLike) -> ArrayF:
        """Derivatives (n, 3, 6) of `apply` by the error (shift; rotation vector)."""
        arm = np.atleast_2d(np.asarray(points_m, dtype=np.float64)) @ self.R.T
        J = np.empty((len(arm), 3, 6))
        J[:, :, :3] = np.eye(3)
        J[:, :, 3:] = -cross_matrix(arm)
        return J

    def moved(self, error: ArrayLike) -> Self:
        """The transform with an error (6,) put on: the update step of an adjustment. The covariance stays."""
        d = np.asarray(error, dtype=np.float64)
        return type(self)(R=exp_rotation(d[3:]) @ self.R, shift_m=self.shift_m + d[:3], cov=self.cov)

    def with_cov(self, cov: ArrayF) -> Self:
        """The same transform with another covariance (6, 6)."""
        return type(self)(R=self.R, shift_m=self.shift_m, cov=(cov + cov.T) / 2)

    def inverse(self) -> Self:
        """``T_source_target`` with its covariance."""
        J = self.by_inverse()
        cov = J @ self.cov @ J.T
        return type(self)(R=self.R.T, shift_m=-self.R.T @ self.shift_m, cov=(cov + cov.T) / 2)

    def by_inverse(self) -> ArrayF:
        """(6, 6) derivative of the inverse's error by this one's.

        ``-R^T (dshift - dtheta x shift)`` and ``-R^T dtheta``.
        """
        J = np.zeros((6, 6))
        J[:3, :3] = -self.R.T
        J[:3, 3:] = -self.R.T @ cross_matrix(self.shift_m[None])[0]
        J[3:, 3:] = -self.R.T
        return J

    def __matmul__(self, other: "Rigid") -> "Rigid":
        """``T_a_b @ T_b_c = T_a_c``; the errors of both are taken as independent."""
        first, second = self.by_product(other)
        cov = first @ self.cov @ first.T + second @ other.cov @ second.T
        return Rigid(R=self.R @ other.R, shift_m=self.R @ other.shift_m + self.shift_m, cov=(cov + cov.T) / 2)

    def by_product(self, other: "Rigid") -> tuple[ArrayF, ArrayF]:
        """(6, 6) derivatives of the error of ``self @ other`` by the errors of both."""
        first, second = np.eye(6), np.zeros((6, 6))
        first[:3, 3:] = -cross_matrix((self.R @ other.shift_m)[None])[0]
        second[:3, :3] = second[3:, 3:] = self.R
        return first, second

    def error_from(self, other: "Rigid") -> ArrayF:
        """(6,) error that moves ``other`` to this transform: what `moved` takes."""
        return np.concatenate([self.shift_m - other.shift_m, rotation_vector(self.R @ other.R.T)])


def _is_covariance(C: ArrayF) -> bool:
    """Whether a matrix is symmetric and has no negative eigenvalue but for rounding.

    Symmetric to 1e-9 of the product of both sigmas, eigenvalues to 1e-9 of the trace.
    """
    s = np.sqrt(np.clip(np.diag(C), 0.0, None))
    symmetric = (np.abs(C - C.T) <= 1e-9 * np.outer(s, s) + 1e-300).all()
    return bool(symmetric and np.linalg.eigvalsh(C)[0] >= -1e-9 * max(float(np.trace(C)), 1e-30))


def exp_rotation(vector_rad: ArrayLike) -> ArrayF:
    """Rotation matrix (..., 3, 3) of rotation vectors (..., 3)."""
    if np.shape(vector_rad) == (3,):
        return _exp_one(*map(float, np.asarray(vector_rad)))
    return np.asarray(Rotation.from_rotvec(np.asarray(vector_rad, dtype=np.float64)).as_matrix())


def _exp_one(x: float, y: float, z: float) -> ArrayF:
    """`exp_rotation` of one vector by its quaternion: adjustments take thousands of such steps."""
    angle = math.sqrt(x * x + y * y + z * z)
    half = angle / 2
    share = math.sin(half) / angle if angle > 1e-3 else 0.5 - angle**2 / 48 + angle**4 / 3840
    x, y, z, w = x * share, y * share, z * share, math.cos(half)
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), w * w - x * x + y * y - z * z, 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), w * w - x * x - y * y + z * z],
        ]
    )


def rotation_vector(R: ArrayLike) -> ArrayF:
    """Rotation vectors (..., 3) in radians of rotation matrices (..., 3, 3)."""
    return np.asarray(Rotation.from_matrix(np.asarray(R, dtype=np.float64)).as_rotvec())


def opk_of(R: ArrayLike) -> ArrayF:
    """Omega, phi, kappa (3,) in radians of ``R = R_x(omega) R_y(phi) R_z(kappa)``; phi in +-90 degrees.

    At phi = +-90 degrees omega and kappa turn about the same axis; omega is 0 there.
    """
    M = np.asarray(R, dtype=np.float64)
    phi = float(np.arctan2(M[0, 2], np.hypot(M[0, 0], M[0, 1])))
    if np.hypot(M[0, 0], M[0, 1]) < 1e-9:
        return np.array([0.0, phi, float(np.arctan2(M[1, 0], M[1, 1]))])
    return np.array([np.arctan2(-M[1, 2], M[2, 2]), phi, np.arctan2(-M[0, 1], M[0, 0])])


# ---------------------------------------------------------------- propagation through a chain of frames
#
# A point known in the innermost frame goes outwards through links (P2 eq. 3, T 3.1.1)::
#
#     x_0 = T_01 T_12 ... x_k,        T_ij: x_i = R_ij x_j + t_ij
#
# Each link errs by a shift ``dt`` and by a small rotation vector ``dtheta``, both in its *outer* frame, so
# that ``R_true = exp([dtheta]x) R``. The point itself errs by ``dx``. To first order::
#
#     dx_0 = sum over links of  P ( dt + dtheta x (R_ij x_j) )  +  P_k dx,       P = R_01 ... R_(i-1)i
#
# which is ``J`` of ``cov = J S J^T`` (P2 eq. 8). `thalweg.lidar.georeference` is this chain with two links,
# error budgets (`thalweg.budgets`) are it with any number.


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """One transform of the chain: ``x_outer = rotation @ x_inner + shift_m``.

    Parameters
    ----------
    rotation : (3, 3), or (n, 3, 3) if each point has its own.
    shift_m : (3,) or (n, 3), the inner origin in the outer frame.
    """

    rotation: ArrayF
    shift_m: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class Chain:
    """Points of a chain in its outermost frame, and their derivatives.

    ``points_m`` (n, 3); ``by_link``, for each link from the outermost inwards, (n, 3, 6) by shift and by
    rotation vector in the link's outer frame; ``by_point`` (n, 3, 3) by the coordinates in the innermost
    frame, which is the rotation of the whole chain.
    """

    points_m: ArrayF
    by_link: tuple[ArrayF, ...]
    by_point: ArrayF


def chain_derivatives(links: Sequence[Link], points_m: ArrayLike) -> Chain:
    """Points of the innermost frame in the outermost one, with the derivatives of P2 eq. 8.

    Parameters
    ----------
    links : from the outermost frame inwards; at least one.
    points_m : (n, 3) in the innermost frame.

    Raises
    ------
    GeometryError : no link, or shapes that do not match.
    """
    x = np.asarray(points_m, dtype=np.float64)
    n = len(x) if x.ndim == 2 else -1
    if n < 0 or x.shape[1] != 3 or not links:
        raise GeometryError(
            f"{len(links)} links and points of the shape {x.shape}",
            expected="at least one link, (n, 3) points",
        )
    for k, link in enumerate(links):
        turn, shift = np.shape(link.rotation), np.shape(link.shift_m)
        if turn not in ((3, 3), (n, 3, 3)) or shift not in ((3,), (n, 3)):
            raise GeometryError(
                f"link {k} has a rotation {turn} and a shift {shift} for {n} points",
                expected="(3, 3) or (n, 3, 3), and (3,) or (n, 3)",
            )
    arms: list[ArrayF] = []
    for link in reversed(links):
        arms.append(_turned(link.rotation, x))
        x = arms[-1] + link.shift_m
    by_link: list[ArrayF] = []
    outer: ArrayF | None = None
    for link, arm in zip(links, reversed(arms), strict=True):
        J = np.empty((n, 3, 6))
        turn_part = -cross_matrix(arm)
        J[:, :, SHIFT] = np.eye(3) if outer is None else outer
        J[:, :, TURN] = turn_part if outer is None else outer @ turn_part
        by_link.append(J)
        outer = link.rotation if outer is None else outer @ link.rotation
    assert outer is not None
    return Chain(points_m=x, by_link=tuple(by_link), by_point=np.broadcast_to(outer, (n, 3, 3)))


def propagated(jacobian: ArrayF, covariance: ArrayF) -> ArrayF:
    """Covariance (n, 3, 3) of points: ``J S J^T`` (P2 eq. 8 with all correlations).

    Parameters
    ----------
    jacobian : (n, 3, k).
    covariance : (k, k) or (n, k, k) of the inputs.
    """
    return np.asarray(jacobian @ covariance @ np.swapaxes(jacobian, 1, 2))


def cross_matrix(a: ArrayF) -> ArrayF:
    """``[a]x`` (n, 3, 3), so that ``[a]x b = a x b``, of vectors (n, 3)."""
    out = np.zeros((len(a), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -a[:, 2], a[:, 1], -a[:, 0]
    return out - np.swapaxes(out, 1, 2)


def plane_rates(normals: ArrayF, arms: ArrayF) -> ArrayF:
    """How distances from planes change with a motion (shift; rotation vector) of their points, (n, 6).

    Parameters
    ----------
    normals : (n, 3) of the planes, unit vectors.
    arms : (n, 3) from the point about which the motion turns to each point, in the same frame.
    """
    return np.hstack([normals, _crossed(arms, normals)])


def _crossed(a: ArrayF, b: ArrayF) -> ArrayF:
    """``a x b`` (n, 3); several times as fast as that of NumPy for some hundred vectors."""
    (x, y, z), (u, v, w) = a.T, b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)


def beam_axes(beam: ArrayF) -> ArrayF:
    """Unit vectors along beams (n, 3) and in two directions across them, as columns (n, 3, 3), right-handed.

    The two directions across are free. The first is perpendicular to the coordinate axis from which the beam
    is farthest, so that it is defined for every beam.
    """
    along = beam / np.linalg.norm(beam, axis=1, keepdims=True)
    least = np.argmin(np.abs(along), axis=1)
    first = _crossed(along, np.eye(3)[least])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([along, first, _crossed(along, first)], axis=2)


def _turned(rotation: ArrayF, x: ArrayF) -> ArrayF:
    return x @ rotation.T if rotation.ndim == 2 else np.einsum("nij,nj->ni", rotation, x)
