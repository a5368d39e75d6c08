"""Derivatives of measured points by every parameter of the sensor, in closed form.

A point is where image ray and sub-beam meet in the water: with the unknowns depth D and fan angle a ::

    r(D, a; p) = A_l(a) + B_l(a) D - A_c - B_c D = 0                     (two plane coordinates)

so that ``(dD, da) = -[r_D r_a]^-1 r_p dp``, and ``X = (A_c + B_c D, -D - t)`` follows in the frame of the
window. Rays depend on their origin, their direction, the media and the tilt (`ray_derivatives`); direction of
the image ray on pixel, lens and angles of the camera, that of the sub-beam on fan angle, v and angles of the
laser.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import ArrayF, cross_matrix, opk_axes, rotation_x
from thalweg.lightsheet.optics.intersection import SheetPoints, intersect
from thalweg.lightsheet.optics.sensor import CAMERA, LASER, LENS, PARAMETERS, Sensor, Window

X_AXIS = np.array([1.0, 0.0, 0.0])
Y_AXIS = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, slots=True, kw_only=True)
class Derivatives:
    """Points and their derivatives; NaN where there is no point.

    ``by_parameters`` (n, 3, 26), ``by_pixel`` (n, 3, 2), ``by_v`` (n, 3) of the points in lcs;
    ``fan_by_parameters`` (n, 26), ``fan_by_pixel`` (n, 2), ``fan_by_v`` (n,) of the fan angle;
    ``depth_by_parameters`` (n, 26), ``depth_by_pixel`` (n, 2), ``depth_by_v`` (n,) of the depth below the
    outer face.
    """

    points: SheetPoints
    by_parameters: ArrayF
    by_pixel: ArrayF
    by_v: ArrayF
    fan_by_parameters: ArrayF
    fan_by_pixel: ArrayF
    fan_by_v: ArrayF
    depth_by_parameters: ArrayF
    depth_by_pixel: ArrayF
    depth_by_v: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class RayDerivatives:
    """A, B (n, 2) of rays in the water and their derivatives, stacked as (n, 4, k).

    ``by_origin`` and ``by_direction`` k = 3, both in lcs; ``by_window`` k = 5: thickness, n_glass, n_water
    and the tilts.
    """

    A: ArrayF
    B: ArrayF
    by_origin: ArrayF
    by_direction: ArrayF
    by_window: ArrayF


def point_derivatives(sensor: Sensor, xy_px: ArrayLike) -> tuple[SheetPoints, ArrayF, ArrayF]:
    """Points of pixels (n, 2), their derivatives (n, 3, 26) by `PARAMETERS` and (n, 3, 2) by the pixel."""
    found = sheet_derivatives(sensor, xy_px)
    return found.points, found.by_parameters, found.by_pixel


def sheet_derivatives(sensor: Sensor, xy_px: ArrayLike) -> Derivatives:
    """Points of pixels (n, 2) with all derivatives of place, depth and fan angle."""
    xy = np.atleast_2d(np.asarray(xy_px, dtype=np.float64))
    points = intersect(sensor, xy)
    n, window = len(xy), sensor.window
    k = len(PARAMETERS)
    # columns: parameters, pixel, v
    J = np.zeros((n, 4, k + 3))  # of the image ray's A and B
    K = np.zeros((n, 4, k + 3))  # of the sub-beam's
    direction, by_pixel, by_lens, by_turn = camera_directions(sensor, xy)
    image = ray_derivatives(sensor.camera_origin_lcs_mm, direction, window)
    J[:, :, CAMERA] = np.concatenate([image.by_origin, image.by_direction @ by_turn], axis=2)
    J[:, :, LENS] = image.by_direction @ by_lens
    J[:, :, 21:26] = image.by_window
    J[:, :, k : k + 2] = image.by_direction @ by_pixel
    beam, by_fan, by_v, by_turn = beam_directions(sensor, points.fan_angle_rad)
    laser = ray_derivatives(sensor.sheet.origin_lcs_mm, beam, window)
    K[:, :, LASER] = np.concatenate([laser.by_origin, laser.by_direction @ by_turn], axis=2)
    K[:, :, 21:26] = laser.by_window
    K[:, :, k + 2] = np.einsum("nij,nj->ni", laser.by_direction, by_v)
    fan = np.einsum("nij,nj->ni", laser.by_direction, by_fan)

    D = points.depth_mm
    r_D = laser.B - image.B
    r_a = fan[:, :2] + fan[:, 2:] * D[:, None]
    r_p = (K - J)[:, :2] + (K - J)[:, 2:] * D[:, None, None]
    det = r_D[:, 0] * r_a[:, 1] - r_D[:, 1] * r_a[:, 0]
    dD = -(r_a[:, 1, None] * r_p[:, 0] - r_a[:, 0, None] * r_p[:, 1]) / det[:, None]
    da = -(r_D[:, 0, None] * r_p[:, 1] - r_D[:, 1, None] * r_p[:, 0]) / det[:, None]

    local = np.empty((n, 3, k + 3))
    local[:, :2] = J[:, :2] + J[:, 2:] * D[:, None, None] + image.B[:, :, None] * dD[:, None, :]
    local[:, 2] = -dD
    local[:, 2, 21] -= 1.0
    place = np.concatenate([image.A + image.B * D[:, None], (-D - window.thickness_mm)[:, None]], axis=1)
    R = window.R_lcs_window
    out = R @ local
    for column, axis in zip((24, 25), _tilt_axes(window), strict=True):
        out[:, :, column] += place @ R.T @ cross_matrix(axis[None])[0].T
    return Derivatives(
        points=points,
        by_parameters=out[:, :, :k],
        by_pixel=out[:, :, k : k + 2],
        by_v=out[:, :, k + 2],
        fan_by_parameters=da[:, :k],
        fan_by_pixel=da[:, k : k + 2],
        fan_by_v=da[:, k + 2],
        depth_by_parameters=dD[:, :k],
        depth_by_pixel=dD[:, k : k + 2],
        depth_by_v=dD[:, k + 2],
    )


def ray_derivatives(origin_mm: ArrayF, directions: ArrayF, window: Window) -> RayDerivatives:
    """Rays of the water from an origin (3,) and unit directions (n, 3), lcs, and their derivatives.

    The derivatives by the direction hold for changes that keep its length.
    """
    R = window.R_lcs_window
    d, o = directions @ R, np.asarray(origin_mm @ R)
    n = len(d)
    n_air, n_glass, n_water, t = window.n_air, window.n_glass, window.n_water, window.thickness_mm
    q, down = n_air * d[:, :2], -d[:, 2]
    q2 = np.einsum("ni,ni->n", q, q)
    with np.errstate(invalid="ignore"):
        glass, water = np.sqrt(n_glass**2 - q2), np.sqrt(n_water**2 - q2)
    air = n_air * down
    k = o[2] / air + t / glass
    qq = q[:, :, None] * q[:, None, :]
    eye = np.eye(2)
    by_o, by_d = np.zeros((n, 4, 3)), np.zeros((n, 4, 3))
    by_o[:, :2, :2] = eye
    by_o[:, :2, 2] = q / air[:, None]
    by_d[:, :2, :2] = n_air * (k[:, None, None] * eye + qq * (t / glass**3)[:, None, None])
    by_d[:, :2, 2] = q * (o[2] / (air * down))[:, None]
    by_d[:, 2:, :2] = n_air * (eye / water[:, None, None] + qq / (water**3)[:, None, None])
    by_window = np.zeros((n, 4, 5))
    by_window[:, :2, 0] = q / glass[:, None]
    by_window[:, :2, 1] = -q * (t * n_glass / glass**3)[:, None]
    by_window[:, 2:, 2] = -q * (n_water / water**3)[:, None]
    # a turn of the window by +e about an axis turns origin and direction by -e in its frame
    for column, axis in zip((3, 4), _tilt_axes(window), strict=True):
        turn = cross_matrix(axis[None])[0]  # row vectors: a @ turn is a x axis
        by_window[:, :, column] = by_o @ (origin_mm @ turn @ R) + np.einsum(
            "nij,nj->ni", by_d, directions @ turn @ R
        )
    return RayDerivatives(
        A=o[:2] + q * k[:, None],
        B=q / water[:, None],
        by_origin=by_o @ R.T,
        by_direction=by_d @ R.T,
        by_window=by_window,
    )


def camera_directions(sensor: Sensor, xy_px: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF]:
    """Directions (n, 3) of pixels in lcs; their derivatives (n, 3, k) by pixel, lens and angles."""
    rays = sensor.camera.rays(xy_px)
    _, by_ray, by_lens = sensor.camera.project_with_derivatives(rays)
    # P r = 0: the projection does not see the length of the ray, so its pseudo-inverse keeps it
    across = by_ray @ np.swapaxes(by_ray, 1, 2)
    bad = ~np.isfinite(across).all(axis=(1, 2))
    across[bad] = np.eye(2)
    back = np.swapaxes(by_ray, 1, 2) @ np.linalg.inv(across)
    R = sensor.R_lcs_ccs
    direction, by_pixel = rays @ R.T, R @ back
    return direction, by_pixel, -by_pixel @ by_lens, _turned(sensor.camera_angles_rad, direction)


def beam_directions(sensor: Sensor, fan_angle_rad: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF]:
    """Directions (n, 3) of sub-beams in lcs; derivatives by fan angle and v (n, 3), angles (n, 3, 3)."""
    sheet = sensor.sheet
    s, c, v = np.sin(fan_angle_rad), np.cos(fan_angle_rad), sheet.v
    down = np.sqrt(1.0 - s * s - v * v)
    R = sheet.R_lcs_las
    zero = np.zeros_like(s)
    by_fan = np.stack([c, zero, s * c / down], axis=1) @ R.T
    by_v = np.stack([zero, zero + 1.0, v / down], axis=1) @ R.T
    direction = np.stack([s, zero + v, -down], axis=1) @ R.T
    return direction, by_fan, by_v, _turned(sheet.angles_rad, direction)


def _turned(angles_rad: ArrayF, directions: ArrayF) -> ArrayF:
    """(n, 3, 3) derivatives of turned directions by omega, phi, kappa."""
    axes = opk_axes(angles_rad[0], angles_rad[1])
    return np.stack([directions @ turn.T for turn in cross_matrix(axes.T)], axis=2)


def _tilt_axes(window: Window) -> tuple[ArrayF, ArrayF]:
    """Axes in lcs about which the window turns with its tilts, ``R_x(tilt_x) R_y(tilt_y)``."""
    return X_AXIS, rotation_x(window.tilt_x_rad) @ Y_AXIS
