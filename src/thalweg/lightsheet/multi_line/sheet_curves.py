"""Where the sub-beams of several sheets lie in water, and how far an image point is from its line.

For parallel plates the horizontal slowness ``q = n_air (dx, dy)`` of a unit direction ``d`` in air is
conserved by both refractions, so that a beam reaches the depth ``D`` below the outer glass face at::

    c = (x, y)_origin + q (h / sqrt(n_air^2 - q^2) + t / sqrt(n_glass^2 - q^2) + D / sqrt(n_water^2 - q^2))

with ``h`` the height of its origin above the glass of thickness ``t``. A measured image point whose object
point lies on a known level (a depth) gives two equations for the sub-beam ``a`` that met it and for the
error ``e`` of the image point along the direction in which it was measured::

    P - e m = c(a),      m = movement of the object point on its level for one pixel

All of this in the frame of the window: its normal is Z, which a tilted window turns out of lcs.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.lightsheet.optics.sensor import LightSheet, Window

COMPONENTS: Final = 7
"""Origin (3), small rotation about the laser's own axes (3), direction cosine of the line."""

_STEPS: Final = 12
_CLOSE: Final = 1e-13


@dataclass(frozen=True, slots=True, kw_only=True)
class Lines:
    """Geometry of n lines.

    Parameters
    ----------
    labels : (n,) number of each line, ascending.
    origins_lcs_mm : (n, 3).
    R_lcs_las : (n, 3, 3).
    v : (n,) direction cosines along the laser's own y axis.
    half_angle_rad : of the fans.
    """

    labels: ArrayI
    origins_lcs_mm: ArrayF
    R_lcs_las: ArrayF
    v: ArrayF
    half_angle_rad: float

    def sheets(self) -> tuple[LightSheet, ...]:
        """The same lines for `thalweg.lightsheet.optics.intersection`."""
        return tuple(
            LightSheet(
                origin_lcs_mm=self.origins_lcs_mm[i],
                angles_rad=opk_angles(self.R_lcs_las[i]),
                half_angle_rad=self.half_angle_rad,
                v=float(self.v[i]),
                name=f"line {self.labels[i]}",
            )
            for i in range(len(self.labels))
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class LineResiduals:
    """Misclosures of image points against their lines.

    Parameters
    ----------
    error_px : (n,) along the measuring direction, measured minus line; NaN where no beam meets the point.
    fan_angle_rad : (n,) of the sub-beam that met the point.
    error_by_geometry, angle_by_geometry : (n, 7) derivatives by `COMPONENTS` of the point's line.
    angle_by_move : (n, 2) derivatives of the angle by a movement of the object point (mm) on its level.
    """

    error_px: ArrayF
    fan_angle_rad: ArrayF
    error_by_geometry: ArrayF
    angle_by_geometry: ArrayF
    angle_by_move: ArrayF


def opk_angles(R: ArrayF) -> ArrayF:
    """Angles (omega, phi, kappa) of ``R = R_x R_y R_z``."""
    return np.array(
        [np.arctan2(-R[1, 2], R[2, 2]), np.arcsin(np.clip(R[0, 2], -1, 1)), np.arctan2(-R[0, 1], R[0, 0])]
    )


def rotation_rad(angles_rad: ArrayF) -> ArrayF:
    """``R_x R_y R_z`` of angles (..., 3), shape (..., 3, 3)."""
    a = np.asarray(angles_rad, dtype=np.float64)
    (cw, cp, ck), (sw, sp, sk) = np.moveaxis(np.cos(a), -1, 0), np.moveaxis(np.sin(a), -1, 0)
    return np.stack([
        np.stack([cp * ck, -cp * sk, sp], axis=-1),
        np.stack([cw * sk + sw * sp * ck, cw * ck - sw * sp * sk, -sw * cp], axis=-1),
        np.stack([sw * sk - cw * sp * ck, sw * ck + cw * sp * sk, cw * cp], axis=-1),
    ], axis=-2)  # fmt: skip


def water_curve(
    origins_mm: ArrayF, directions: ArrayF, depth_mm: ArrayF, window: Window
) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF]:
    """Places of beams at depths, all in the window's frame.

    Parameters
    ----------
    origins_mm : (n, 3) with Z above the inner glass face.
    directions : (n, 3) unit vectors in air.
    depth_mm : (n,) below the outer glass face.

    Returns
    -------
    Places (n, 2), their derivatives by depth (n, 2), by the height of the origin (n, 2), and by the
    horizontal part of the direction (n, 2, 2). NaN where a beam does not go down.
    """
    q = window.n_air * directions[:, :2]
    q2 = np.square(q).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        down = np.where(directions[:, 2] < 0, 1.0, np.nan)
        air, glass, water = (
            down / np.sqrt(np.where(n * n > q2, n * n - q2, np.nan))
            for n in (window.n_air, window.n_glass, window.n_water)
        )
        h = origins_mm[:, 2]
        sum_1 = h * air + window.thickness_mm * glass + depth_mm * water
        sum_3 = h * air**3 + window.thickness_mm * glass**3 + depth_mm * water**3
    places = origins_mm[:, :2] + q * sum_1[:, None]
    by_q = sum_1[:, None, None] * np.eye(2) + sum_3[:, None, None] * q[:, :, None] * q[:, None, :]
    return places, q * water[:, None], q * air[:, None], window.n_air * by_q


def line_residuals(
    lines: Lines, at: ArrayI, points_mm: ArrayF, move_mm: ArrayF, window: Window
) -> LineResiduals:
    """How far image points lie from their lines.

    Parameters
    ----------
    lines : geometry in lcs.
    at : (n,) index of each point's line in ``lines``.
    points_mm : (n, 3) object points (x, y, depth below the outer face) in the window's frame.
    move_mm : (n, 2) their horizontal movement for one pixel along the measuring direction.
    window : the plate.

    Raises
    ------
    GeometryError : an index of a line that does not exist.
    """
    if len(at) and (at.min() < 0 or at.max() >= len(lines.labels)):
        raise GeometryError("a point of a line that the model does not have", expected="labels of the model")
    R_window_lcs = window.R_lcs_window.T
    R = R_window_lcs @ lines.R_lcs_las[at]
    origins = (lines.origins_lcs_mm @ R_window_lcs.T)[at]
    v = lines.v[at]
    to_point = np.einsum("nji,nj->ni", R, points_mm * [1, 1, -1] - [0, 0, window.thickness_mm] - origins)
    a = 0.8 * np.arctan2(to_point[:, 0], -to_point[:, 2])
    e = np.zeros(len(at))
    for _ in range(_STEPS):
        _, by_a, places, _, by_d = _beams(R, origins, v, a, points_mm[:, 2], window)
        f = points_mm[:, :2] + e[:, None] * move_mm - places
        J = _system(by_a, by_d, move_mm)
        step = _solve_2x2(J, f[:, :, None])[:, :, 0]
        e, a = e - step[:, 0], a - np.clip(step[:, 1], -0.3, 0.3)
        if not np.nanmax(np.abs(step[:, 1]), initial=0.0) > _CLOSE:
            break
    beam, by_a, _, by_height, by_d = _beams(R, origins, v, a, points_mm[:, 2], window)
    J = _system(by_a, by_d, move_mm)
    by_geometry = _by_geometry(R, R_window_lcs, beam, v, a, by_height, by_d)
    solved = _solve_2x2(J, by_geometry)
    moved = _solve_2x2(J, np.broadcast_to(-np.eye(2), (len(at), 2, 2)))
    good = np.abs(a) < np.pi / 2
    return LineResiduals(
        error_px=np.where(good, -e, np.nan),
        fan_angle_rad=a,
        error_by_geometry=-solved[:, 0],
        angle_by_geometry=solved[:, 1],
        angle_by_move=moved[:, 1],
    )


def fan_directions(a_rad: ArrayF, v: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Directions (n, 3) in the laser's frame, and their derivatives by angle and by direction cosine."""
    s, c = np.sin(a_rad), np.cos(a_rad)
    inside: ArrayB = c * c > v * v
    z = np.sqrt(np.where(inside, c * c - v * v, np.nan))
    zero = np.zeros_like(s)
    return (
        np.stack([s, v, -z], axis=1),
        np.stack([c, zero, s * c / z], axis=1),
        np.stack([zero, zero + 1.0, v / z], axis=1),
    )


def _beams(
    R: ArrayF, origins: ArrayF, v: ArrayF, a: ArrayF, depth: ArrayF, window: Window
) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF, ArrayF]:
    local, local_by_a, _ = fan_directions(a, v)
    d, by_a = (np.einsum("nij,nj->ni", R, w) for w in (local, local_by_a))
    places, _, by_height, by_d = water_curve(origins, d, depth, window)
    return local, by_a, places, by_height, by_d


def _system(by_a: ArrayF, by_d: ArrayF, move: ArrayF) -> ArrayF:
    along = np.einsum("nij,nj->ni", by_d, by_a[:, :2])
    return np.stack([move, -along], axis=2)


def _solve_2x2(J: ArrayF, rhs: ArrayF) -> ArrayF:
    det = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
    first = J[:, 1, 1, None] * rhs[:, 0] - J[:, 0, 1, None] * rhs[:, 1]
    second = J[:, 0, 0, None] * rhs[:, 1] - J[:, 1, 0, None] * rhs[:, 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.stack([first, second], axis=1) / det[:, None, None]


def _by_geometry(
    R: ArrayF, R_window_lcs: ArrayF, local: ArrayF, v: ArrayF, a: ArrayF, by_height: ArrayF, by_d: ArrayF
) -> ArrayF:
    """Derivatives (n, 2, 7) of places by origin (lcs), small rotation about the laser's axes, and v."""
    out = np.empty((len(R), 2, COMPONENTS))
    by_origin = np.zeros((len(R), 2, 3))
    by_origin[:, 0, 0] = by_origin[:, 1, 1] = 1.0
    by_origin[:, :, 2] = by_height
    out[:, :, :3] = by_origin @ R_window_lcs
    turned = np.stack([np.cross(np.eye(3)[k], local) for k in range(3)], axis=2)
    out[:, :, 3:6] = by_d @ (R @ turned)[:, :2]
    _, _, local_by_v = fan_directions(a, v)
    out[:, :, 6] = np.einsum("nij,nj->ni", by_d, np.einsum("nij,nj->ni", R, local_by_v)[:, :2])
    return out
