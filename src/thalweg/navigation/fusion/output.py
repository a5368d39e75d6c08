"""The pose between nodes: mean and covariance given the states of both neighbours.

Between two nodes no observation lies, so the states there depend on those of both nodes only::

    x(t) = A x_k + B x_k+1 + w,     B = Q_s F_r^T Q^-1,     A = F_s - B F,     cov w = Q_s - B F_r Q_s

with transition and noise ``F_s, Q_s`` from the node to ``t``, ``F_r`` from there to the next node, and
``F, Q`` of the whole interval.
"""

from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from thalweg.core.frames import LocalFrame
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayF, ArrayI
from thalweg.navigation.fusion.inputs import RESET, Nodes
from thalweg.navigation.fusion.model import Factors, attitude, pair_transition
from thalweg.navigation.fusion.settings import POSE, FusionSettings
from thalweg.navigation.fusion.solver import Solved
from thalweg.navigation.ins_gnss.reference import Reference

_CHUNK: Final = 5000
"""Times that are computed at once: some 10 MB of matrices."""


def pose_states(
    t_gps_s: ArrayF, nodes: Nodes, solved: Solved, settings: FusionSettings
) -> tuple[ArrayF, ArrayF]:
    """States of the pose (k, 10) and their covariance (k, 10, 10) at times within the nodes."""
    t = np.asarray(t_gps_s, dtype=np.float64)
    node = nodes.t_gps_s
    left = np.searchsorted(node, t, side="right") - 1
    # the last node, and those of the same time, belong to the interval before them
    left = np.minimum(left, int(np.searchsorted(node, node[-1], side="left")) - 1)
    A, B, extra = _between(t, left, nodes, settings, solved.factors)
    here, there = solved.x[left, :POSE], solved.x[left + 1, :POSE]
    mean = (A @ here[:, :, None] + B @ there[:, :, None])[:, :, 0]
    C, D, X = solved.cov[left], solved.cov[left + 1], solved.cross[left]
    At, Bt = np.swapaxes(A, 1, 2), np.swapaxes(B, 1, 2)
    mixed = A @ X @ Bt
    cov = A @ C @ At + B @ D @ Bt + mixed + np.swapaxes(mixed, 1, 2) + extra
    return mean, (cov + np.swapaxes(cov, 1, 2)) / 2


def poses(
    t_gps_s: ArrayF, reference: Reference, nodes: Nodes, solved: Solved, settings: FusionSettings
) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Position (k, 3), ``R_wcs_ics`` (k, 3, 3) and covariance (k, 6, 6) at times within the nodes."""
    t = np.asarray(t_gps_s, dtype=np.float64)
    parts = [
        _poses(t[first : first + _CHUNK], reference, nodes, solved, settings)
        for first in range(0, max(len(t), 1), _CHUNK)
    ]
    position, R, cov = (np.concatenate(values) for values in zip(*parts, strict=True))
    return position, R, cov


def _poses(
    t_gps_s: ArrayF, reference: Reference, nodes: Nodes, solved: Solved, settings: FusionSettings
) -> tuple[ArrayF, ArrayF, ArrayF]:
    mean, cov = pose_states(t_gps_s, nodes, solved, settings)
    at = reference.at(t_gps_s)
    R, by_angle = attitude(mean, at, settings)
    J = np.zeros((len(mean), 6, POSE))
    J[:, :3, :3] = np.eye(3)
    J[:, 3:, 6:] = by_angle
    return at.way_m + mean[:, :3], R, J @ cov @ np.swapaxes(J, 1, 2)


def trajectory_of(
    frame: LocalFrame, reference: Reference, nodes: Nodes, solved: Solved, settings: FusionSettings
) -> Trajectory:
    """Trajectory at the times of the INS; valid where position and attitude are known well enough."""
    t = reference.t_gps_s
    position, R, cov = poses(t, reference, nodes, solved, settings)
    made = Trajectory(
        frame=frame, t_gps_s=t, position_wcs_m=position, quaternion_wcs_ics=Rotation.from_matrix(R).as_quat(),
        cov_pose_wcs=cov, valid=np.ones(len(t), dtype=np.bool_),
    )  # fmt: skip
    valid = (made.sigma_position_m < settings.max_sigma_position_m).all(axis=1)
    limit = np.deg2rad(settings.max_sigma_attitude_deg)
    valid &= (made.sigma_roll_pitch_heading_rad() < limit).all(axis=1)
    made.valid[:] = valid
    return made


def _between(
    t: ArrayF, left: ArrayI, nodes: Nodes, settings: FusionSettings, factors: Factors
) -> tuple[ArrayF, ArrayF, ArrayF]:
    """``A, B, cov w`` (k, 10, 10) of times in the intervals from nodes ``left``."""
    k = len(t)
    T = nodes.t_gps_s[left + 1] - nodes.t_gps_s[left]
    s = np.clip(t - nodes.t_gps_s[left], 0.0, T)
    kind = nodes.kind[left + 1]
    A, B, extra = (np.zeros((k, POSE, POSE)) for _ in range(3))
    F, Q = _pair(T, kind, settings, factors)
    Fs, Qs = _pair(s, kind, settings, factors)
    Fr, _ = _pair(T - s, kind, settings, factors)
    b = Qs @ np.swapaxes(Fr, 1, 2) @ np.linalg.inv(Q)
    a = Fs - b @ F
    w = Qs - b @ Fr @ Qs
    for axis in range(3):
        both = np.ix_(np.arange(k), np.array([axis, 3 + axis]), np.array([axis, 3 + axis]))
        A[both], B[both] = a, b
        # the factor of the noise drops out of a and b
        extra[both] = w * nodes.walk[left + 1, axis, None, None]
    singles = ("roll_pitch", 6), ("roll_pitch", 7), ("heading", 8), ("disturbance", 9)
    for group, i in singles:
        time = settings.disturbance_time_s if group == "disturbance" else settings.attitude_time_s
        phi, phi_s, phi_r = (np.exp(-x / time) for x in (T, s, T - s))
        q, q_s = -np.expm1(-2 * T / time), -np.expm1(-2 * s / time)
        B[:, i, i] = q_s * phi_r / q
        A[:, i, i] = phi_s - B[:, i, i] * phi
        extra[:, i, i] = np.maximum(q_s - B[:, i, i] * phi_r * q_s, 0.0) * factors[group] ** 2
    return A, B, extra


def _pair(step_s: ArrayF, kind: ArrayI, settings: FusionSettings, factors: Factors) -> tuple[ArrayF, ArrayF]:
    """Transition and noise (k, 2, 2) of position and rate."""
    f, g, dd, de, ee = pair_transition(step_s, np.where(kind == RESET, 0, kind), settings, factors).T
    one, zero = np.ones_like(f), np.zeros_like(f)
    F = np.stack([one, f, zero, g], axis=-1).reshape(-1, 2, 2)
    return F, np.stack([dd, de, de, ee], axis=-1).reshape(-1, 2, 2)
