"""Observations of a camera's clock: its poses against GNSS positions (P2 eq. 5) and against the INS's
attitude.

P2 eq. 5, turned into the world frame, with the antenna at ``d`` in ccs::

    r_i   = X(t_i + dt_i) - c_i - R_i d  = 0          three equations an image
    rho_i = log( R_ins(t_i + dt_i) R_ics_ccs R_i^T )  = 0     three more, if the INS is used
    dt_i  = offset + drift (t_i - reference) + jitter_i

The jitter of an image acts on all six, along the velocity and the angular velocity of that moment.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from thalweg.clocks.camera.track import Between, Track, gauss_markov
from thalweg.core.errors import GeometryError
from thalweg.core.frames import attitude_axes
from thalweg.core.propagation import cross_matrix
from thalweg.core.rigid import exp_rotation
from thalweg.core.types import AnyArray, ArrayB, ArrayF

NAMES: Final = ("offset", "drift", "dx", "dy", "dz")
"""Unknowns: of the clock, and the antenna in ccs."""

TURN_NAMES: Final = ("turn_x", "turn_y", "turn_z")
"""Small rotation of R_ics_ccs, in ics."""

_RATE_REACH_S: Final = 0.1
"""Half of the time over which the angular velocity is taken from the attitudes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraPoses:
    """Images with the pose of the camera.

    ``file`` (n,) names; ``t_device_s`` (n,) increasing stamps; ``R_wcs_ccs`` (n, 3, 3); ``centre_wcs_m`` (n,
    3); ``cov_pose_wcs`` (n, 6, 6) of (shift; small rotation vector), both in wcs.

    Raises
    ------
    GeometryError : shapes that differ.
    """

    file: AnyArray
    t_device_s: ArrayF
    R_wcs_ccs: ArrayF
    centre_wcs_m: ArrayF
    cov_pose_wcs: ArrayF

    def __post_init__(self) -> None:
        n = len(self.t_device_s)
        shapes = [np.shape(a) for a in (self.file, self.R_wcs_ccs, self.centre_wcs_m, self.cov_pose_wcs)]
        if shapes != [(n,), (n, 3, 3), (n, 3), (n, 6, 6)]:
            raise GeometryError(f"{n} stamps with arrays {shapes}", expected="(n,), (n,3,3), (n,3), (n,6,6)")

    def take(self, which: AnyArray) -> "CameraPoses":
        """Some of the images."""
        return CameraPoses(
            file=self.file[which],
            t_device_s=self.t_device_s[which],
            R_wcs_ccs=self.R_wcs_ccs[which],
            centre_wcs_m=self.centre_wcs_m[which],
            cov_pose_wcs=self.cov_pose_wcs[which],
        )


@dataclass(frozen=True, kw_only=True)
class InsAttitude:
    """Attitudes of the INS on GPS time.

    ``t_gps_s`` (m,); ``R_wcs_ics`` (m, 3, 3); ``sigma_rad`` (3,) of roll, pitch, heading;
    ``correlation_time_s`` of their Gauss-Markov errors. Errors slower than ``high_pass_s`` (drift of the
    heading) are free: a series of cosines of longer periods is estimated and thrown away, so that only
    faster turns tell of time.
    """

    t_gps_s: ArrayF
    R_wcs_ics: ArrayF
    sigma_rad: ArrayF
    correlation_time_s: float = 20.0
    high_pass_s: float = 60.0

    @cached_property
    def _slerp(self) -> Slerp:
        return Slerp(self.t_gps_s - self.t_gps_s[0], Rotation.from_matrix(self.R_wcs_ics))

    def at(self, t_gps_s: ArrayF) -> tuple[ArrayF, ArrayF, ArrayB]:
        """``R_wcs_ics`` (n, 3, 3), angular velocity in wcs (n, 3), and which times are covered (n,)."""
        t = self.t_gps_s
        inside = (t_gps_s > t[0] + 2 * _RATE_REACH_S) & (t_gps_s < t[-1] - 2 * _RATE_REACH_S)
        right = np.clip(np.searchsorted(t, t_gps_s), 1, len(t) - 1)
        inside &= t[right] - t[right - 1] < 2 * _RATE_REACH_S
        slerp = self._slerp
        at = np.clip(t_gps_s - t[0], _RATE_REACH_S, t[-1] - t[0] - _RATE_REACH_S)
        turned = slerp(at + _RATE_REACH_S) * slerp(at - _RATE_REACH_S).inv()
        return slerp(at).as_matrix(), turned.as_rotvec() / (2 * _RATE_REACH_S), inside

    def covariance(self, t_gps_s: ArrayF) -> ArrayF:
        """Covariance (3 n, 3 n) of the rotation errors, in wcs."""
        return self._spread(t_gps_s, gauss_markov(t_gps_s[:, None] - t_gps_s, self.correlation_time_s))

    def rate_covariance(self, t_gps_s: ArrayF) -> ArrayF:
        """Covariance (3 n, 3 n) of the errors of the angular velocity, which is a difference of attitudes."""
        apart, reach, tau = t_gps_s[:, None] - t_gps_s, 2 * _RATE_REACH_S, self.correlation_time_s
        middle, behind, ahead = (gauss_markov(apart + lag, tau) for lag in (0.0, -reach, reach))
        return self._spread(t_gps_s, (2 * middle - behind - ahead) / reach**2)

    def _spread(self, t_gps_s: ArrayF, kernel: ArrayF) -> ArrayF:
        axes = attitude_axes(self.at(t_gps_s)[0]) * self.sigma_rad
        full = np.einsum("ij,iap,jbp->iajb", kernel, axes, axes, optimize=True)
        return np.asarray(full.reshape(3 * len(kernel), 3 * len(kernel)))


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldError:
    """Error that all camera poses share: of the georeferencing of the calibration field.

    ``cov`` (6, 6) of (shift; small rotation vector) about ``about_wcs_m`` (3,), in wcs.
    """

    cov: ArrayF
    about_wcs_m: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetState:
    """Values of the unknowns.

    ``slow`` (k,) are the coefficients of the INS's slow errors, none in a short run; ``oriented`` is False as
    long as ``R_ics_ccs`` says nothing.
    """

    offset_s: float
    drift: float
    lever_m: ArrayF
    R_ics_ccs: ArrayF = field(default_factory=lambda: np.eye(3))
    slow: ArrayF = field(default_factory=lambda: np.zeros(0))
    oriented: bool = False

    def moved(self, dx: ArrayF) -> "OffsetState":
        """The state with a small change: offset, drift, antenna, turn, slow errors."""
        turn = exp_rotation(dx[5:8]) @ self.R_ics_ccs if len(dx) > 5 else self.R_ics_ccs
        return OffsetState(
            offset_s=self.offset_s + float(dx[0]),
            drift=self.drift + float(dx[1]),
            lever_m=self.lever_m + dx[2:5],
            R_ics_ccs=turn,
            slow=self.slow + dx[8:] if len(dx) > 8 else self.slow,
            oriented=self.oriented,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Stacked:
    """All observations at a state.

    ``residual`` (m,) and ``jacobian`` (m, u); ``motion`` (m,) how each residual changes with the time of its
    image, ``image`` (m,) which image it is of; ``between`` the track at the images' times.
    """

    residual: ArrayF
    jacobian: ArrayF
    motion: ArrayF
    image: AnyArray
    between: Between


@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetModel:
    """What is observed, for a fixed choice of images."""

    poses: CameraPoses
    track: Track
    reference_s: float
    ins: InsAttitude | None = None
    field_error: FieldError | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        if self.ins is None:
            return NAMES
        axes = ("roll", "pitch", "heading")
        slow = tuple(f"slow_{axis}_{k + 1}" for k in range(len(self.cosines())) for axis in axes)
        return (*NAMES, *TURN_NAMES, *slow)

    def cosines(self) -> ArrayF:
        """Cosines (k, n) of the images' times with periods above ``high_pass_s``; a constant is the turn."""
        t = self.poses.t_device_s
        span = float(t[-1] - t[0])
        if self.ins is None or self.ins.high_pass_s <= 0 or span <= 0:
            return np.zeros((0, len(t)))
        k = np.arange(1, int(2 * span / self.ins.high_pass_s) + 1)
        return np.asarray(np.cos(np.pi * k[:, None] * (t - t[0])[None, :] / span))

    def times(self, state: OffsetState) -> ArrayF:
        """GPS times (n,) of the images, without their jitter."""
        t = self.poses.t_device_s
        return np.asarray(t + state.offset_s + state.drift * (t - self.reference_s))

    def covered(self, state: OffsetState) -> ArrayB:
        """Which images (n,) lie where the track, and the INS if it is used, have no gap."""
        t = self.times(state)
        inside = self.track.at(t).inside
        return inside if self.ins is None else inside & self.ins.at(t)[2]

    def observe(self, state: OffsetState) -> Stacked:
        """Residuals and derivatives at a state, images one after the other within each group."""
        t = self.times(state)
        n, since = len(t), self.poses.t_device_s - self.reference_s
        between = self.track.at(t)
        R = self.poses.R_wcs_ccs
        r = between.position_m - self.poses.centre_wcs_m - R @ state.lever_m
        v = between.velocity_mps
        J = np.zeros((n, 3, len(self.names)))
        J[:, :, 0], J[:, :, 1], J[:, :, 2:5] = v, v * since[:, None], -R
        image = np.repeat(np.arange(n), 3)
        if self.ins is None:
            return Stacked(
                residual=r.ravel(),
                jacobian=J.reshape(3 * n, -1),
                motion=v.ravel(),
                image=image,
                between=between,
            )
        R_ins, rate, _ = self.ins.at(t)
        axes = attitude_axes(R_ins)
        wave = self.cosines()
        slow = state.slow.reshape(len(wave), 3)
        rho = Rotation.from_matrix(R_ins @ state.R_ics_ccs @ np.swapaxes(R, 1, 2)).as_rotvec()
        rho = rho + np.einsum("nij,kn,kj->ni", axes, wave, slow)
        K = np.zeros_like(J)
        K[:, :, 0], K[:, :, 1], K[:, :, 5:8] = rate, rate * since[:, None], R_ins
        if len(wave):
            K[:, :, 8:] = np.einsum("nij,kn->nikj", axes, wave).reshape(n, 3, -1)
        return Stacked(
            residual=np.concatenate([r.ravel(), rho.ravel()]),
            jacobian=np.concatenate([J.reshape(3 * n, -1), K.reshape(3 * n, -1)]),
            motion=np.concatenate([v.ravel(), rate.ravel()]),
            image=np.concatenate([image, image]),
            between=between,
        )

    def covariance(self, state: OffsetState, between: Between) -> ArrayF:
        """Covariance (m, m) of the residuals without the jitter of the images."""
        n, R = len(self.poses.t_device_s), self.poses.R_wcs_ccs
        arm = R @ state.lever_m
        groups = 1 if self.ins is None else 2
        J = np.zeros((n, groups, 3, 6))
        J[:, 0, :, :3], J[:, 0, :, 3:] = np.eye(3), -cross_matrix(arm)
        if groups == 2:
            J[:, 1, :, 3:] = np.eye(3)
        own = np.einsum("ngap,npq,nhbq->ngahb", J, self.poses.cov_pose_wcs, J)
        full = np.zeros((groups, n, 3, groups, n, 3))
        i = np.arange(n)
        # indexing with arrays on both sides puts the images first
        full[:, i, :, :, i, :] = own
        cov = full.reshape(groups * 3 * n, groups * 3 * n)
        cov[: 3 * n, : 3 * n] += self.track.covariance(between)
        if self.ins is not None:
            cov[3 * n :, 3 * n :] += self.ins.covariance(self.times(state))
        if self.field_error is not None:
            F = np.zeros((groups, n, 3, 6))
            F[0, :, :, :3] = np.eye(3)
            F[0, :, :, 3:] = -cross_matrix(self.poses.centre_wcs_m + arm - self.field_error.about_wcs_m)
            if groups == 2:
                F[1, :, :, 3:] = np.eye(3)
            flat = F.reshape(groups * 3 * n, 6)
            cov += flat @ self.field_error.cov @ flat.T
        return np.asarray(cov)
