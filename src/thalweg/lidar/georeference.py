"""Lidar points into the world frame, each with the pose of its own moment (P1 eq. 7-8, T 3.1.1).

``x_ics = R_ics_scs @ x_scs + lever_ics_scs`` and ``x_wcs = R_wcs_ics(t) @ x_ics + x_wcs_ics(t)``.

Attitudes are interpolated along the chord and normalised, which differs from slerp by less than
``a**3 / 124`` for an angle ``a`` between nodes (1e-9 rad at 50 Hz and 7 deg/s). The covariance is that of
`thalweg.lidar.georeference`, written out; the tests compare both.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayF32, GeometryError, Rigid, Trajectory, njit, prange
from thalweg.settings.sections import WEAK_RANGE_M, WEAK_REFLECTIVITY, LidarAccuracy

_SIDE = 128
"""Points that are computed side by side: 12 columns of them fit the innermost cache."""
_BLOCK = 16384
"""Points of a task: large enough to amortise one binary search, small enough to balance two cores."""

# ---------------------------------------------------------------- georeferencing


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldPoints:
    """Points in the world.

    ``points_wcs_m`` (n, 3), NaN where there is no valid pose; ``has_pose`` (n,), false outside the
    trajectory, in its gaps, and for points without GPS time; ``cov_m2`` (n, 6) float32: the elements ee, en,
    eu, nn, nu, uu of each covariance in wcs, NaN where there is no pose, or None if it was not asked for.
    """

    points_wcs_m: ArrayF
    has_pose: ArrayB
    cov_m2: ArrayF32 | None = None

    def sigmas_m(self) -> ArrayF32:
        """Standard deviations (n, 3) east, north, up.

        Raises
        ------
        GeometryError : the points were made without covariances.
        """
        return np.asarray(np.sqrt(self._cov()[:, [0, 3, 5]]))

    def correlations(self) -> ArrayF32:
        """Correlations (n, 3) east-north, east-up, north-up.

        Raises
        ------
        GeometryError : the points were made without covariances.
        """
        e, n, u = self.sigmas_m().T
        en, eu, nu = self._cov()[:, [1, 2, 4]].T
        return np.stack([en / (e * n), eu / (e * u), nu / (n * u)], axis=1)

    def where(self, keep: ArrayB) -> "WorldPoints":
        """The points for which ``keep`` (n,) is true."""
        return WorldPoints(
            points_wcs_m=self.points_wcs_m[keep],
            has_pose=self.has_pose[keep],
            cov_m2=None if self.cov_m2 is None else self.cov_m2[keep],
        )

    def _cov(self) -> ArrayF32:
        if self.cov_m2 is None:
            raise GeometryError("points without covariances", expected="georeferenced with `beam`")
        return self.cov_m2


def georeference_points(
    xyz_scs_m: ArrayLike,
    t_gps_s: ArrayLike,
    trajectory: Trajectory,
    mount: Rigid,
    *,
    beam: LidarAccuracy | None = None,
    range_m: ArrayLike | None = None,
    reflectivity: ArrayLike | None = None,
) -> WorldPoints:
    """Transform points of a moving scanner into the world frame.

    Parameters
    ----------
    xyz_scs_m : (n, 3) float32 or float64, scanner frame.
    t_gps_s : (n,) time of each point; NaN gives no pose.
    trajectory : poses of the boat with their covariance.
    mount : pose of the scanner on the boat with its covariance.
    beam : accuracy of the scanner; with it, and ``range_m`` (n,) and ``reflectivity`` (n,) in percent, the
        covariance of each point is predicted.

    Raises
    ------
    GeometryError : arrays whose shapes do not match.
    """
    xyz = np.ascontiguousarray(xyz_scs_m, dtype=np.float32)
    t = np.ascontiguousarray(t_gps_s, dtype=np.float64)
    if xyz.ndim != 2 or xyz.shape[1] != 3 or t.shape != (len(xyz),):
        raise GeometryError(f"{xyz.shape=}, {t.shape=}", expected="(n, 3) points and (n,) times")
    points = np.empty((len(xyz), 3))
    has_pose = np.zeros(len(xyz), dtype=np.bool_)
    poses = (trajectory.t_gps_s, trajectory.position_wcs_m, trajectory.quaternion_wcs_ics, trajectory.valid)
    R = np.ascontiguousarray(mount.R, dtype=np.float64)
    lever = np.ascontiguousarray(mount.shift_m, dtype=np.float64)
    if beam is None:
        georeference(xyz, t, *poses, R, lever, points, has_pose)
        return WorldPoints(points_wcs_m=points, has_pose=has_pose)
    along, across = _per_point(xyz, range_m), _per_point(xyz, reflectivity)
    cov = np.empty((len(xyz), 6), dtype=np.float32)
    georeference_with_covariance(
        xyz,
        t,
        along,
        across,
        *poses,
        np.ascontiguousarray(trajectory.cov_pose_wcs),
        R,
        lever,
        np.ascontiguousarray(mount.cov, dtype=np.float64),
        _beam_numbers(beam),
        points,
        has_pose,
        cov,
    )
    return WorldPoints(points_wcs_m=points, has_pose=has_pose, cov_m2=cov)


def _per_point(xyz: ArrayF32, values: ArrayLike | None) -> AnyArray:
    array = np.ascontiguousarray(np.zeros(0) if values is None else values)
    if array.shape != (len(xyz),):
        raise GeometryError(
            f"{array.shape} values for {len(xyz)} points",
            expected="one range and one reflectivity for each point if its covariance is asked for",
        )
    return array


def _beam_numbers(beam: LidarAccuracy) -> ArrayF:
    """The beam's variances as coefficients of range and reflectivity, for the kernel."""
    weak = beam.sigma_weak_m * WEAK_REFLECTIVITY / WEAK_RANGE_M**2
    spot = beam.footprint_share * beam.divergence_rad
    return np.array([beam.sigma_component_m**2, spot**2, weak**2, beam.sigma_time_s**2])


# ---------------------------------------------------------------- compiled loops
#
# They make one pass over the points. These come nearly in time order, so the node interval is carried along
# instead of searched. Points that follow each other in one interval are copied into columns of one small
# array, computed there side by side without a branch, and copied out: of such a loop the compiler makes
# vector instructions.


@njit(inline="always", cache=True, error_model="numpy")
def _interval(ti: float, j: int, node_t: ArrayF) -> int:
    """The node interval of a time near to interval ``j``."""
    m = len(node_t)
    while j < m - 2 and ti >= node_t[j + 1]:
        j += 1
    while j > 0 and ti < node_t[j]:
        j -= 1
    return j


@njit(inline="always", cache=True, error_model="numpy")
def _run_end(first: int, stop: int, low: float, high: float, t: ArrayF) -> int:
    """End of the run of points behind ``first`` whose times lie in [low, high)."""
    k = first + 1
    while k < stop and t[k] >= low and t[k] < high:
        k += 1
    return k


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def georeference(
    xyz: ArrayF32,
    t: ArrayF,
    node_t: ArrayF,
    node_x: ArrayF,
    node_q: ArrayF,
    node_valid: ArrayB,
    R: ArrayF,
    lever: ArrayF,
    out: ArrayF,
    has_pose: ArrayB,
) -> None:
    """Points ``xyz`` (n, 3) of scs at times ``t`` into wcs; NaN and false where there is no pose."""
    n, m = len(t), len(node_t)
    for b in prange((n + _BLOCK - 1) // _BLOCK):
        s = np.empty(4 * _SIDE)
        i, stop = b * _BLOCK, min((b + 1) * _BLOCK, n)
        j = min(max(np.searchsorted(node_t, t[i], side="right") - 1, 0), m - 2)
        while i < stop:
            k = i + 1
            inside = t[i] >= node_t[0] and t[i] <= node_t[m - 1]
            if inside:
                j = _interval(t[i], j, node_t)
                k = _run_end(i, min(stop, i + _SIDE), node_t[j], node_t[j + 1], t)
                inside = node_valid[j] and node_valid[j + 1]
            if inside:
                _columns(xyz[i:k], t[i:k], s)
                _place(s, k - i, j, node_t, node_x, node_q, R, lever)
                _rows(s, out[i:k])
            else:
                out[i:k] = np.nan
            has_pose[i:k] = inside
            i = k


@njit(cache=True, nogil=True, error_model="numpy")
def _columns(xyz: ArrayF32, t: ArrayF, s: ArrayF) -> None:
    """Points and times into columns 0 to 3."""
    for i in range(len(t)):
        s[i] = xyz[i, 0]
        s[_SIDE + i] = xyz[i, 1]
        s[2 * _SIDE + i] = xyz[i, 2]
        s[3 * _SIDE + i] = t[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _rows(s: ArrayF, out: ArrayF) -> None:
    """Columns 0 to 2 into points."""
    for i in range(len(out)):
        out[i, 0] = s[i]
        out[i, 1] = s[_SIDE + i]
        out[i, 2] = s[2 * _SIDE + i]


@njit(inline="always", cache=True, error_model="numpy")
def _three(a: ArrayF) -> tuple[float, float, float]:
    return a[0], a[1], a[2]


@njit(inline="always", cache=True, error_model="numpy")
def _four(a: ArrayF) -> tuple[float, float, float, float]:
    return a[0], a[1], a[2], a[3]


@njit(cache=True, nogil=True, error_model="numpy")
def _place(
    s: ArrayF, n: int, j: int, node_t: ArrayF, node_x: ArrayF, node_q: ArrayF, R: ArrayF, lever: ArrayF
) -> None:
    """Columns 0 to 2 of points in one node interval from scs into wcs."""
    # Everything that is the same for all points becomes a scalar first: the compiler cannot know that
    # writing to ``s`` leaves the other arrays as they are.
    t0, per_s = node_t[j], 1.0 / (node_t[j + 1] - node_t[j])
    a0, a1, a2, a3 = _four(node_q[j])
    b0, b1, b2, b3 = _four(node_q[j + 1])
    ex, ey, ez = _three(node_x[j])
    fx, fy, fz = _three(node_x[j + 1])
    m00, m01, m02 = _three(R[0])
    m10, m11, m12 = _three(R[1])
    m20, m21, m22 = _three(R[2])
    lx, ly, lz = _three(lever)
    for i in range(n):
        u = (s[3 * _SIDE + i] - t0) * per_s
        v = 1.0 - u
        x, y, z = s[i], s[_SIDE + i], s[2 * _SIDE + i]
        bx = m00 * x + m01 * y + m02 * z + lx
        by = m10 * x + m11 * y + m12 * z + ly
        bz = m20 * x + m21 * y + m22 * z + lz
        q0, q1, q2, q3 = v * a0 + u * b0, v * a1 + u * b1, v * a2 + u * b2, v * a3 + u * b3
        # x' = x + 2/|q|^2 q_v x (q_v x x + q_w x): rotation by an unnormalised quaternion
        g = 2.0 / (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
        cx = q1 * bz - q2 * by + q3 * bx
        cy = q2 * bx - q0 * bz + q3 * by
        cz = q0 * by - q1 * bx + q3 * bz
        s[i] = bx + g * (q1 * cz - q2 * cy) + v * ex + u * fx
        s[_SIDE + i] = by + g * (q2 * cx - q0 * cz) + v * ey + u * fy
        s[2 * _SIDE + i] = bz + g * (q0 * cy - q1 * cx) + v * ez + u * fz


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def georeference_with_covariance(
    xyz: ArrayF32,
    t: ArrayF,
    range_m: AnyArray,
    reflectivity: AnyArray,
    node_t: ArrayF,
    node_x: ArrayF,
    node_q: ArrayF,
    node_valid: ArrayB,
    node_cov: ArrayF,
    R: ArrayF,
    lever: ArrayF,
    mount_cov: ArrayF,
    beam: ArrayF,
    out: ArrayF,
    has_pose: ArrayB,
    cov: ArrayF32,
) -> None:
    """As `georeference`; ``cov`` (n, 6) becomes the elements ee, en, eu, nn, nu, uu of the covariance."""
    n, m = len(t), len(node_t)
    for b in prange((n + _BLOCK - 1) // _BLOCK):
        s = np.empty(12 * _SIDE)
        i, stop = b * _BLOCK, min((b + 1) * _BLOCK, n)
        j = min(max(np.searchsorted(node_t, t[i], side="right") - 1, 0), m - 2)
        while i < stop:
            k = i + 1
            inside = t[i] >= node_t[0] and t[i] <= node_t[m - 1]
            if inside:
                j = _interval(t[i], j, node_t)
                k = _run_end(i, min(stop, i + _SIDE), node_t[j], node_t[j + 1], t)
                inside = node_valid[j] and node_valid[j + 1]
            if inside:
                _columns(xyz[i:k], t[i:k], s)
                for p in range(k - i):
                    s[4 * _SIDE + p] = range_m[i + p]
                    s[5 * _SIDE + p] = reflectivity[i + p]
                _place_with_covariance(
                    s, k - i, j, node_t, node_x, node_q, node_cov, R, lever, mount_cov, beam
                )
                _rows(s, out[i:k])
                for p in range(k - i):
                    for c in range(6):
                        cov[i + p, c] = s[(6 + c) * _SIDE + p]
            else:
                out[i:k] = np.nan
                cov[i:k] = np.nan
            has_pose[i:k] = inside
            i = k


@njit(cache=True, nogil=True, error_model="numpy")
def _place_with_covariance(
    s: ArrayF,
    n: int,
    j: int,
    node_t: ArrayF,
    node_x: ArrayF,
    node_q: ArrayF,
    node_cov: ArrayF,
    R: ArrayF,
    lever: ArrayF,
    mount_cov: ArrayF,
    beam: ArrayF,
) -> None:
    """As `_place`; columns 4 and 5 are range and reflectivity, 6 to 11 become the covariance."""
    t0, per_s = node_t[j], 1.0 / (node_t[j + 1] - node_t[j])
    a0, a1, a2, a3 = _four(node_q[j])
    b0, b1, b2, b3 = _four(node_q[j + 1])
    ex, ey, ez = _three(node_x[j])
    fx, fy, fz = _three(node_x[j + 1])
    m00, m01, m02 = _three(R[0])
    m10, m11, m12 = _three(R[1])
    m20, m21, m22 = _three(R[2])
    lx, ly, lz = _three(lever)
    vx, vy, vz = (fx - ex) * per_s, (fy - ey) * per_s, (fz - ez) * per_s
    ox, oy, oz = _turn_rate(node_q[j], node_q[j + 1], per_s)
    before, behind = _shift_and_turn(node_cov[j]), _shift_and_turn(node_cov[j + 1])
    mount = _shift_and_turn(mount_cov)
    base, spot, weak, late = _four(beam)
    for i in range(n):
        u = (s[3 * _SIDE + i] - t0) * per_s
        v = 1.0 - u
        x, y, z = s[i], s[_SIDE + i], s[2 * _SIDE + i]
        sx = m00 * x + m01 * y + m02 * z
        sy = m10 * x + m11 * y + m12 * z
        sz = m20 * x + m21 * y + m22 * z
        bx, by, bz = sx + lx, sy + ly, sz + lz
        q0, q1, q2, q3 = v * a0 + u * b0, v * a1 + u * b1, v * a2 + u * b2, v * a3 + u * b3
        g = 2.0 / (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
        r00, r01, r02 = 1.0 - g * (q1 * q1 + q2 * q2), g * (q0 * q1 - q2 * q3), g * (q0 * q2 + q1 * q3)
        r10, r11, r12 = g * (q0 * q1 + q2 * q3), 1.0 - g * (q0 * q0 + q2 * q2), g * (q1 * q2 - q0 * q3)
        r20, r21, r22 = g * (q0 * q2 - q1 * q3), g * (q1 * q2 + q0 * q3), 1.0 - g * (q0 * q0 + q1 * q1)
        ax = r00 * bx + r01 * by + r02 * bz
        ay = r10 * bx + r11 * by + r12 * bz
        az = r20 * bx + r21 * by + r22 * bz
        s[i] = ax + v * ex + u * fx
        s[_SIDE + i] = ay + v * ey + u * fy
        s[2 * _SIDE + i] = az + v * ez + u * fz

        # pose: the map from its covariance to that of the point is linear, so both nodes are mapped
        f0, f1, f2, f3, f4, f5 = _turn_covariance(before, ax, ay, az)
        g0, g1, g2, g3, g4, g5 = _turn_covariance(behind, ax, ay, az)
        # mount, in the body frame, then turned into the world
        h0, h1, h2, h3, h4, h5 = _turn_covariance(mount, sx, sy, sz)
        w00, w01, w02 = _times(r00, r01, r02, h0, h1, h2, h3, h4, h5)
        w10, w11, w12 = _times(r10, r11, r12, h0, h1, h2, h3, h4, h5)
        w20, w21, w22 = _times(r20, r21, r22, h0, h1, h2, h3, h4, h5)
        # beam: `across` in all directions, and what is more along it
        r2 = s[4 * _SIDE + i] * s[4 * _SIDE + i]
        across = base + spot * r2
        faint = r2 / max(s[5 * _SIDE + i], 1.0)
        more = (weak * faint * faint - spot * r2) / (sx * sx + sy * sy + sz * sz)
        dx = r00 * sx + r01 * sy + r02 * sz
        dy = r10 * sx + r11 * sy + r12 * sz
        dz = r20 * sx + r21 * sy + r22 * sz
        # time
        px, py, pz = vx + oy * az - oz * ay, vy + oz * ax - ox * az, vz + ox * ay - oy * ax
        ee = v * f0 + u * g0 + w00 * r00 + w01 * r01 + w02 * r02 + across
        en = v * f1 + u * g1 + w00 * r10 + w01 * r11 + w02 * r12
        eu = v * f2 + u * g2 + w00 * r20 + w01 * r21 + w02 * r22
        nn = v * f3 + u * g3 + w10 * r10 + w11 * r11 + w12 * r12 + across
        nu = v * f4 + u * g4 + w10 * r20 + w11 * r21 + w12 * r22
        uu = v * f5 + u * g5 + w20 * r20 + w21 * r21 + w22 * r22 + across
        s[6 * _SIDE + i] = ee + more * dx * dx + late * px * px
        s[7 * _SIDE + i] = en + more * dx * dy + late * px * py
        s[8 * _SIDE + i] = eu + more * dx * dz + late * px * pz
        s[9 * _SIDE + i] = nn + more * dy * dy + late * py * py
        s[10 * _SIDE + i] = nu + more * dy * dz + late * py * pz
        s[11 * _SIDE + i] = uu + more * dz * dz + late * pz * pz


@njit(cache=True, nogil=True, error_model="numpy")
def _turn_rate(p: ArrayF, q: ArrayF, per_s: float) -> tuple[float, float, float]:
    """Angular velocity in wcs that turns attitude ``p`` into ``q``: the rotation vector of ``q p*``."""
    x = -q[3] * p[0] + q[0] * p[3] - q[1] * p[2] + q[2] * p[1]
    y = -q[3] * p[1] + q[1] * p[3] - q[2] * p[0] + q[0] * p[2]
    z = -q[3] * p[2] + q[2] * p[3] - q[0] * p[1] + q[1] * p[0]
    w = q[3] * p[3] + q[0] * p[0] + q[1] * p[1] + q[2] * p[2]
    sine = np.sqrt(x * x + y * y + z * z)
    scale = per_s * (2.0 * np.arctan2(sine, w) / sine if sine > 0.0 else 2.0)
    return x * scale, y * scale, z * scale


@njit(inline="always", cache=True, error_model="numpy")
def _times(
    r0: float, r1: float, r2: float, h0: float, h1: float, h2: float, h3: float, h4: float, h5: float
) -> tuple[float, float, float]:
    """A row times a symmetric matrix, given by its elements 00, 01, 02, 11, 12, 22."""
    return r0 * h0 + r1 * h1 + r2 * h2, r0 * h1 + r1 * h3 + r2 * h4, r0 * h2 + r1 * h4 + r2 * h5


@njit(cache=True, nogil=True, error_model="numpy")
def _shift_and_turn(C: ArrayF) -> tuple[float, ...]:
    """Covariance P of a shift (upper half), X of both, T / 2 of a turn (upper half) out of 6x6."""
    d, e, f = C[0], C[1], C[2]
    a, b, c = C[3], C[4], C[5]
    return (
        d[0],
        d[1],
        d[2],
        e[1],
        e[2],
        f[2],
        d[3],
        d[4],
        d[5],
        e[3],
        e[4],
        e[5],
        f[3],
        f[4],
        f[5],
        0.5 * a[3],
        0.5 * a[4],
        0.5 * a[5],
        0.5 * b[4],
        0.5 * b[5],
        0.5 * c[5],
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _turn_covariance(
    parts: tuple[float, ...], ax: float, ay: float, az: float
) -> tuple[float, float, float, float, float, float]:
    """Covariance ee, en, eu, nn, nu, uu of ``d + theta x a`` from `_shift_and_turn`.

    With ``S = -[a]x`` it is ``P + M S^T + S M^T`` and ``M = X + S T / 2``: P, T the covariances of d and
    theta, X that between them.
    """
    (
        p00,
        p01,
        p02,
        p11,
        p12,
        p22,
        x00,
        x01,
        x02,
        x10,
        x11,
        x12,
        x20,
        x21,
        x22,
        t00,
        t01,
        t02,
        t11,
        t12,
        t22,
    ) = parts
    # S = [0 az -ay; -az 0 ax; ay -ax 0]
    m00, m01, m02 = x00 + az * t01 - ay * t02, x01 + az * t11 - ay * t12, x02 + az * t12 - ay * t22
    m10, m11, m12 = x10 + ax * t02 - az * t00, x11 + ax * t12 - az * t01, x12 + ax * t22 - az * t02
    m20, m21, m22 = x20 + ay * t00 - ax * t01, x21 + ay * t01 - ax * t11, x22 + ay * t02 - ax * t12
    return (
        p00 + 2.0 * (m01 * az - m02 * ay),
        p01 + m02 * ax - m00 * az + m11 * az - m12 * ay,
        p02 + m00 * ay - m01 * ax + m21 * az - m22 * ay,
        p11 + 2.0 * (m12 * ax - m10 * az),
        p12 + m10 * ay - m11 * ax + m22 * ax - m20 * az,
        p22 + 2.0 * (m20 * ay - m21 * ax),
    )


# ---------------------------------------------------------------- covariance of a point (T Table 3.1)
#
# ``x_wcs = x_wcs_ics + R_wcs_ics (R_ics_scs x_scs + l)`` (P1 eq. 7-8) has fifteen inputs in T Table 3.1:
# three angles and three coordinates of the platform, three angles and three coordinates of the mount, three
# of the point in the scanner. Time is the sixteenth: what the platform moves until the stamp is right. With
# small rotations ``dtheta`` as vectors, in wcs for the platform and in ics for the mount, the derivatives
# are::
#
#     dx_wcs = dx + dtheta x (x_wcs - x_wcs_ics) + R_wcs_ics (dtheta_mount x R_ics_scs x_scs + dl)
#              + (range, right, up) errors of the beam + (v + omega x (x_wcs - x_wcs_ics)) dt
#
# The table takes 17 mm for each coordinate in the scanner at any range (P2 eq. 7). Here the beam adds to that
# where in its footprint the echo arose, across the beam, and how weak the echo was, along it. An inclined
# surface needs no term of its own: an echo that is off by ``d`` across the beam lies ``d sin(i)`` off the
# surface along its normal, which is what ``n^T C n`` gives for incidence ``i``.
#
# The tests compare the kernel with `thalweg.core.chain_derivatives`, the chain of frames of error budgets.
