"""Pose of a picture from known points and the directions to them, without approximate values.

Three points and the angles between their rays leave up to four poses (Grunert 1841; here by OpenCV). Many
triples are solved, each pose is judged by its angles to all rays, and the best one is kept, as in RANSAC.
Directions are unit vectors, not image coordinates, so that lenses beyond 90 degrees off the axis work too.
"""

from typing import Final

import numpy as np

from thalweg.core import (
    AnyArray,
    ArrayF,
    ArrayI,
    GeometryError,
    Rigid,
    beam_axes,
    cross_matrix,
    exp_rotation,
    optional,
)

cv2 = optional("cv2")

TRIPLES: Final = 300
_SEED: Final = np.array([7, *b"resection"])
_AHEAD: Final = 0.05
"""Cosine of the largest angle between three rays and their middle."""


def pose_from_rays(
    points_pcs: ArrayF, rays_ccs: ArrayF, groups: ArrayI, *, cap_rad: float, triples: int = TRIPLES
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
    # seen by a camera that looks at the middle of each three, for which they are a picture
    turn = np.swapaxes(beam_axes(r.sum(axis=1))[:, :, [1, 2, 0]], 1, 2)
    local = r @ np.swapaxes(turn, 1, 2)
    of: list[int] = []
    turns: list[ArrayF] = []
    shifts: list[ArrayF] = []
    for k in np.flatnonzero((local[:, :, 2] > _AHEAD).all(axis=1)).tolist():
        flat = local[k, :, :2] / local[k, :, 2:]
        n, rotations, moves = cv2.solveP3P(P[k], flat, np.eye(3), None, flags=cv2.SOLVEPNP_P3P)
        of += [k] * n
        turns += rotations[:n]
        shifts += moves[:n]
    good = np.isfinite(np.reshape(turns + shifts, (2, -1, 3))).all(axis=(0, 2))
    R = np.swapaxes(exp_rotation(np.reshape(turns, (-1, 3))[good]), 1, 2)
    C = -(R @ np.reshape(shifts, (-1, 3, 1))[good])[:, :, 0]
    return R @ turn[np.array(of, np.int64)[good]], C


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
