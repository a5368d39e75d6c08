"""Pose of a picture from known points and the directions to them, without approximate values.

Three points and the angles between their rays leave up to four poses (Grunert 1841, in the form of Haralick
et al. 1994). Many triples are solved at once, each pose is judged by its angles to all rays, and the best
one is kept, as in RANSAC. Directions are unit vectors, not image coordinates, so that lenses beyond 90
degrees off the axis work too.
"""

from typing import Final

import numpy as np

from thalweg.core import AnyArray, ArrayF, ArrayI, GeometryError, Rigid, cross_matrix
from thalweg.core.geometry import fit_points

TRIPLES: Final = 300
_SEED: Final = np.array([7, *b"resection"])
_REAL: Final = 0.02
"""Largest imaginary part of a root that counts as real: noise turns double roots into complex pairs."""


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
