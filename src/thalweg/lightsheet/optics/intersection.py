"""Image rays and the refracted light sheet: millions of pixels to points, and points to pixels (P3 2.2, P4
4.2).

All happens in the frame of the window, where a ray of the water is ``A + B D`` (`refraction`). An image
ray (A_c, B_c) and the sub-beam (A, B) of the fan parameter u lie in one plane where ::

    F(u) = (A(u) - A_c) x (B(u) - B_c) = 0        (cross product of two plane vectors)

F has a sign, so a change of sign between two sub-beams is a root for certain; the distance of two skew rays
has none. Sub-beams that are spread over the fan once for all images (the *nodes*) give the brackets, Newton's
steps within them the root, and ``D = -(dA . dB) / (dB . dB)`` the depth.

The fan parameter u is the tangent of the angle about the laser's y axis: ``d_las = (w u / h, v, -w / h)``
with ``h = sqrt(1 + u^2)`` and ``w = sqrt(1 - v^2)``, so that ``sin a = w u / h``; on a plane fan u = tan a.

What has no point gets a `Status` and no number. The halving of the papers is in `approximations`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import ArrayB, ArrayF, ArrayI, ArrayU8, GeometryError, njit, prange
from thalweg.lightsheet.optics.refraction import Status, directions_to_points, threads_for
from thalweg.lightsheet.optics.sensor import LightSheet, Sensor, Window

NODES: Final = 33
"""Sub-beams that bracket the roots: less than three degrees apart on a fan of 90 degrees."""

GRAZING_SINE: Final = 0.01
"""Sine of the least angle between ray and window, and between ray and sheet.

At 0.01 an error of a pixel, some 0.1 mm across the ray, would be 10 mm along it.
"""


_EACH_PIXEL: Final = 4096
"""Rays for a thread, 0.7 ms of work; fewer than two such shares run in one thread."""

MARGIN_RAD: Final = 1e-9
"""By which the fan is wider than stated, so that rounding loses no pixel of its very last sub-beam."""

_EACH_POINT: Final = 16384
"""Points for a thread."""

_OK, _NO_SHEET, _ABOVE, _GRAZING, _REFLECTED, _NO_RAY = 0, 1, 2, 3, 4, 5
"""As `thalweg.lightsheet.optics.refraction.Status`."""

_BLOCK = 4096
"""Pixels of a task."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetPoints:
    """Points of the sheet on image rays; NaN wherever ``status`` (n,) is not `Status.OK`.

    ``xyz_lcs_mm`` (n, 3); ``depth_mm`` (n,) below the outer face; ``fan_angle_rad`` (n,) of the sub-beam.
    """

    xyz_lcs_mm: ArrayF
    depth_mm: ArrayF
    fan_angle_rad: ArrayF
    status: ArrayU8

    @property
    def ok(self) -> ArrayB:
        """(n,) true where there is a point."""
        return self.status == Status.OK

    def counts(self) -> dict[str, int]:
        """How many pixels have each status, for reports."""
        n: ArrayI = np.bincount(self.status, minlength=len(Status))
        return {status.name: int(n[status]) for status in Status}


@dataclass(frozen=True, slots=True, kw_only=True)
class FanTable:
    """Sub-beams spread over the part of a fan that reaches the water.

    ``u`` (m,) fan parameters (head of this module), ``angle_rad`` (m,) fan angles, ``beams`` (m, 8) their
    A, B in the water and the derivatives by u, in the frame of the window.
    """

    u: ArrayF
    angle_rad: ArrayF
    beams: ArrayF


def intersect(sensor: Sensor, xy_px: ArrayLike) -> SheetPoints:
    """Points of the sheet on the rays of pixels.

    Parameters
    ----------
    sensor : any line, also a diffracted one.
    xy_px : (n, 2) pixels, the centre of the first one being (0.5, 0.5).

    Returns
    -------
    SheetPoints in the order of the pixels. Where a ray meets the sheet twice, the nearer place.

    Raises
    ------
    GeometryError : no (n, 2) pixels, or no sub-beam of the fan reaches the water.
    """
    xy = np.ascontiguousarray(np.atleast_2d(np.asarray(xy_px, dtype=np.float64)))
    if xy.ndim != 2 or xy.shape[1] != 2:
        raise GeometryError(f"pixels of the shape {xy.shape}", expected="(n, 2)")
    n = len(xy)
    table = fan_table(sensor.sheet, sensor.window, margin_rad=MARGIN_RAD)
    rows = np.empty((5, len(table.u)))
    rows[:4] = table.beams[:, :4].T
    rows[4] = rows[0] * rows[3] - rows[1] * rows[2]
    xyz, depth, fan, status = np.empty((n, 3)), np.empty(n), np.empty(n), np.empty(n, dtype=np.uint8)
    R = np.ascontiguousarray(sensor.window.R_lcs_window)
    with threads_for(n, each=_EACH_PIXEL):
        intersect_rays(
            xy,
            sensor.camera.parameters,
            *camera_window(sensor),
            *laser_window(sensor.sheet, sensor.window),
            sensor.sheet.v,
            media(sensor.window),
            R,
            table.u,
            rows,
            GRAZING_SINE,
            xyz,
            depth,
            fan,
            status,
        )
    return SheetPoints(xyz_lcs_mm=xyz, depth_mm=depth, fan_angle_rad=fan, status=status)


def fan_table(sheet: LightSheet, window: Window, n: int = NODES, *, margin_rad: float = 0.0) -> FanTable:
    """Sub-beams at equal angles over the part of the fan that reaches the water, and a margin at its own
    ends.

    Raises
    ------
    GeometryError : there is no such part.
    """
    low, high = fan_limits(sheet, window)
    top = _top(sheet)
    low -= margin_rad * (low == -top)
    high += margin_rad * (high == top)
    w = np.sqrt(1.0 - sheet.v**2)
    u = np.tan(np.linspace(low, high, n))
    beams = np.empty((n, 8))
    sub_beams(u, *laser_window(sheet, window), sheet.v, media(window), beams)
    return FanTable(u=u, angle_rad=np.arctan2(w * u, np.sqrt(1.0 + (u * sheet.v) ** 2)), beams=beams)


def fan_limits(sheet: LightSheet, window: Window) -> tuple[float, float]:
    """Least and largest angle atan(u) about the laser's y axis whose sub-beams reach the water.

    Sub-beams that run along the window or away from it, or are reflected totally, are cut off. They lie at
    the ends of the fan; if they part it in two, the longer part counts.

    Raises
    ------
    GeometryError : no sub-beam reaches the water.
    """
    top = _top(sheet)
    L, _ = laser_window(sheet, window)
    least_n = min(window.n_glass, window.n_water)

    def wet(b: ArrayF) -> ArrayB:
        """Whether the beam at an angle ``b`` of the fan passes the window into the water."""
        w = np.sqrt(1.0 - sheet.v**2)
        d = np.stack([w * np.sin(b), np.full_like(b, sheet.v), -w * np.cos(b)], axis=-1) @ L.T
        sine = np.hypot(d[..., 0], d[..., 1])
        # a hair inside of the limits, so that the last sub-beam is still one
        return np.asarray((d[..., 2] < -GRAZING_SINE) & (window.n_air * sine < least_n * (1 - 1e-12)))

    grid = np.linspace(-top, top, 721)
    good = wet(grid)
    if good.all():
        return -top, top
    if not good.any():
        raise GeometryError(
            f"no sub-beam of the fan of the laser {sheet.name!r} reaches the water",
            expected="a laser that shines along its -z axis through the window",
            cure="Check omega, phi and kappa of the laser, and that they are in degrees in the file",
        )
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(np.int8)))
    starts, stops = edges[::2], edges[1::2] - 1
    k = int(np.argmax(stops - starts))
    first, last = int(starts[k]), int(stops[k])
    low = grid[first] if first == 0 else _edge(wet, grid[first], grid[first - 1])
    high = grid[last] if last == len(grid) - 1 else _edge(wet, grid[last], grid[last + 1])
    return float(low), float(high)


def media(window: Window) -> ArrayF:
    """(4,) refractive indices of air, glass, water and the thickness of the glass, for the kernels."""
    return np.array([window.n_air, window.n_glass, window.n_water, window.thickness_mm])


def camera_window(sensor: Sensor) -> tuple[ArrayF, ArrayF]:
    """Rotation (3, 3) from ccs to the frame of the window, and the camera's place (3,) in it."""
    R = sensor.window.R_lcs_window
    return np.ascontiguousarray(R.T @ sensor.R_lcs_ccs), np.ascontiguousarray(
        R.T @ sensor.camera_origin_lcs_mm
    )


def laser_window(sheet: LightSheet, window: Window) -> tuple[ArrayF, ArrayF]:
    """Rotation (3, 3) from the laser to the frame of the window, and the laser's place (3,) in it."""
    R = window.R_lcs_window
    return np.ascontiguousarray(R.T @ sheet.R_lcs_las), np.ascontiguousarray(R.T @ sheet.origin_lcs_mm)


def project(sensor: Sensor, xyz_lcs_mm: ArrayLike) -> ArrayF:
    """Pixels (n, 2) of points (n, 3) in lcs, seen from the air through glass and water.

    NaN for points above the outer face of the window, behind the camera, or beyond where the lens model folds
    back. A point outside the picture keeps its numbers; ask ``sensor.camera.inside``.

    Raises
    ------
    GeometryError : no (n, 3) points.
    """
    points = np.atleast_2d(np.asarray(xyz_lcs_mm, dtype=np.float64))
    if points.ndim != 2 or points.shape[1] != 3:
        raise GeometryError(f"points of the shape {points.shape}", expected="(n, 3)")
    directions = directions_to_points(sensor.camera_origin_lcs_mm, points, sensor.window)
    out = np.empty((len(points), 2))
    C, _ = camera_window(sensor)
    local = np.ascontiguousarray(directions @ sensor.window.R_lcs_window)
    with threads_for(len(out), each=_EACH_POINT):
        project_rays(local, sensor.camera.parameters, C, out)
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def sub_beams(u: ArrayF, L: ArrayF, origin: ArrayF, v: float, media: ArrayF, out: ArrayF) -> None:
    """A, B and their derivatives by u, ``out`` (n, 8), of sub-beams ``u`` (n,)."""
    for i in range(len(u)):
        out[i] = _beam(u[i], L, origin, v, media)


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def intersect_rays(
    xy: ArrayF,
    lens: ArrayF,
    C: ArrayF,
    camera: ArrayF,
    L: ArrayF,
    laser: ArrayF,
    v: float,
    media: ArrayF,
    R: ArrayF,
    nodes: ArrayF,
    table: ArrayF,
    grazing: float,
    xyz: ArrayF,
    depth: ArrayF,
    fan: ArrayF,
    status: ArrayU8,
) -> None:
    """Points of the sheet on the rays of pixels.

    ``xy`` (n, 2) pixels; ``lens`` (9,); ``C``, ``L`` (3, 3) rotations from camera and laser to the window;
    ``camera``, ``laser`` (3,) origins in its frame; ``media`` indices of air, glass, water, and the
    thickness; ``R`` (3, 3) from the window to lcs; ``nodes`` (m,) fan parameters with the columns A, B of
    `sub_beams` as ``table`` (5, m), the fifth being ``A x B``; ``grazing`` least sine. Out: ``xyz`` (n, 3)
    lcs, ``depth``, ``fan`` angle, ``status`` (n,).
    """
    n, m = len(xy), len(nodes)
    for block in prange((n + _BLOCK - 1) // _BLOCK):
        f = np.empty(m)
        for i in range(block * _BLOCK, min((block + 1) * _BLOCK, n)):
            xyz[i, 0] = xyz[i, 1] = xyz[i, 2] = depth[i] = fan[i] = np.nan
            ax, ay, bx, by, state = _image_ray(xy[i, 0], xy[i, 1], lens, C, camera, media, grazing)
            if state != _OK:
                status[i] = state
                continue
            k = ax * by - ay * bx
            for j in range(m):
                f[j] = (
                    table[4, j]
                    + k
                    - ax * table[3, j]
                    + ay * table[2, j]
                    - table[0, j] * by
                    + table[1, j] * bx
                )
            state, best, best_u = _NO_SHEET, np.inf, np.nan
            for j in range(m - 1):
                if f[j] * f[j + 1] > 0.0 or not f[j] * f[j + 1] <= 0.0:
                    continue
                u, D, sine = _root(nodes[j], nodes[j + 1], f[j], f[j + 1], ax, ay, bx, by, L, laser, v, media)
                # Of several places on one ray the first counts: it hides those behind it.
                if 0.0 <= D < best:
                    best, best_u = D, u
                    state = _OK if sine >= grazing else _GRAZING
                elif D < 0.0 and state == _NO_SHEET:
                    state = _ABOVE
                elif np.isnan(D) and state == _NO_SHEET:
                    state = _GRAZING  # F is zero without a slope: the ray lies in the sheet
            status[i] = state
            if state == _OK:
                X, Y, Z = ax + bx * best, ay + by * best, -best - media[3]
                for c in range(3):
                    xyz[i, c] = R[c, 0] * X + R[c, 1] * Y + R[c, 2] * Z
                depth[i] = best
                fan[i] = np.arctan2(np.sqrt(1.0 - v * v) * best_u, np.sqrt(1.0 + best_u * best_u * v * v))


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def project_rays(directions: ArrayF, lens: ArrayF, C: ArrayF, xy: ArrayF) -> None:
    """Pixels ``xy`` (n, 2) of directions (n, 3) in the frame of the window; NaN behind the camera."""
    for i in prange(len(directions)):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        along = C[0, 2] * x + C[1, 2] * y + C[2, 2] * z
        if not along > 0.0:
            xy[i, 0] = xy[i, 1] = np.nan
            continue
        a = (C[0, 0] * x + C[1, 0] * y + C[2, 0] * z) / along
        b = (C[0, 1] * x + C[1, 1] * y + C[2, 1] * z) / along
        xy[i, 0], xy[i, 1] = _distort(a, b, lens)


def _top(sheet: LightSheet) -> float:
    """The angle about the laser's y axis of the last sub-beam."""
    return float(np.arcsin(np.sin(sheet.half_angle_rad) / np.sqrt(1.0 - sheet.v**2)))


def _edge(wet: Callable[[ArrayF], ArrayB], inside: float, outside: float) -> float:
    """The last angle that is wet, by halving."""
    for _ in range(60):
        middle = 0.5 * (inside + outside)
        if wet(np.array([middle]))[0]:
            inside = middle
        else:
            outside = middle
    return inside


@njit(inline="always", cache=True, error_model="numpy")
def _undistort(x: float, y: float, lens: ArrayF) -> tuple[float, float]:
    """Directions X/Z, Y/Z of a pixel; NaN where the lens has none (`thalweg.core.camera`)."""
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    k1, k2, p1, p2, k3 = lens[4], lens[5], lens[6], lens[7], lens[8]
    goal_a, goal_b = (x - cx) / fx, (y - cy) / fy
    a, b = goal_a, goal_b
    if k1 == 0.0 and k2 == 0.0 and k3 == 0.0 and p1 == 0.0 and p2 == 0.0:
        return a, b
    for _ in range(30):
        q = a * a + b * b
        radial = 1.0 + q * (k1 + q * (k2 + q * k3))
        slope = k1 + q * (2.0 * k2 + 3.0 * k3 * q)
        if not radial + 2.0 * q * slope > 0.0:  # where the polynomial folds back
            return np.nan, np.nan
        off_a = goal_a - (a * radial + 2.0 * p1 * a * b + p2 * (q + 2.0 * a * a))
        off_b = goal_b - (b * radial + p1 * (q + 2.0 * b * b) + 2.0 * p2 * a * b)
        aa = radial + 2.0 * a * a * slope + 2.0 * p1 * b + 6.0 * p2 * a
        ab = 2.0 * a * b * slope + 2.0 * p1 * a + 2.0 * p2 * b
        bb = radial + 2.0 * b * b * slope + 6.0 * p1 * b + 2.0 * p2 * a
        det = aa * bb - ab * ab
        da, db = (bb * off_a - ab * off_b) / det, (aa * off_b - ab * off_a) / det
        a, b = a + da, b + db
        if abs(da) < 1e-13 and abs(db) < 1e-13:
            return a, b
    return np.nan, np.nan


@njit(inline="always", cache=True, error_model="numpy")
def _distort(a: float, b: float, lens: ArrayF) -> tuple[float, float]:
    """Pixel of the direction a = X/Z, b = Y/Z; NaN beyond where the lens model folds back."""
    k1, k2, p1, p2, k3 = lens[4], lens[5], lens[6], lens[7], lens[8]
    q = a * a + b * b
    radial = 1.0 + q * (k1 + q * (k2 + q * k3))
    if not radial + 2.0 * q * (k1 + q * (2.0 * k2 + 3.0 * k3 * q)) > 0.0:
        return np.nan, np.nan
    x = a * radial + 2.0 * p1 * a * b + p2 * (q + 2.0 * a * a)
    y = b * radial + p1 * (q + 2.0 * b * b) + 2.0 * p2 * a * b
    return lens[0] * x + lens[2], lens[1] * y + lens[3]


@njit(inline="always", cache=True, error_model="numpy")
def _beam(
    u: float, L: ArrayF, origin: ArrayF, v: float, media: ArrayF
) -> tuple[float, float, float, float, float, float, float, float]:
    """A and B of the sub-beam ``u`` in the water, and their derivatives by u."""
    n_air, n_glass, n_water, t = media[0], media[1], media[2], media[3]
    w = np.sqrt(1.0 - v * v)
    g = 1.0 / np.sqrt(1.0 + u * u)
    dx = w * g * (L[0, 0] * u - L[0, 2]) + L[0, 1] * v
    dy = w * g * (L[1, 0] * u - L[1, 2]) + L[1, 1] * v
    dz = w * g * (L[2, 0] * u - L[2, 2]) + L[2, 1] * v
    g3 = w * g * g * g
    ex, ey = g3 * (L[0, 0] + L[0, 2] * u), g3 * (L[1, 0] + L[1, 2] * u)
    qx, qy, rx, ry = n_air * dx, n_air * dy, n_air * ex, n_air * ey
    q2, slope = qx * qx + qy * qy, qx * rx + qy * ry
    air = -1.0 / (n_air * dz)
    glass = 1.0 / np.sqrt(n_glass * n_glass - q2)
    water = 1.0 / np.sqrt(n_water * n_water - q2)
    k = origin[2] * air + t * glass
    dk = (origin[2] * air * air * air + t * glass * glass * glass) * slope
    dm = water * water * water * slope
    return (
        origin[0] + qx * k,
        origin[1] + qy * k,
        qx * water,
        qy * water,
        rx * k + qx * dk,
        ry * k + qy * dk,
        rx * water + qx * dm,
        ry * water + qy * dm,
    )


@njit(inline="always", cache=True, error_model="numpy")
def _image_ray(
    x: float, y: float, lens: ArrayF, C: ArrayF, origin: ArrayF, media: ArrayF, grazing: float
) -> tuple[float, float, float, float, int]:
    """A and B of the ray of a pixel in the water, and its status."""
    a, b = _undistort(x, y, lens)
    if not (np.isfinite(a) and np.isfinite(b)):
        return np.nan, np.nan, np.nan, np.nan, _NO_RAY
    g = 1.0 / np.sqrt(1.0 + a * a + b * b)
    dx = g * (C[0, 0] * a + C[0, 1] * b + C[0, 2])
    dy = g * (C[1, 0] * a + C[1, 1] * b + C[1, 2])
    dz = g * (C[2, 0] * a + C[2, 1] * b + C[2, 2])
    if dz > -grazing:
        return np.nan, np.nan, np.nan, np.nan, _ABOVE if dz >= 0.0 else _GRAZING
    n_air, n_glass, n_water, t = media[0], media[1], media[2], media[3]
    qx, qy = n_air * dx, n_air * dy
    q2 = qx * qx + qy * qy
    if q2 >= n_glass * n_glass or q2 >= n_water * n_water:
        return np.nan, np.nan, np.nan, np.nan, _REFLECTED
    k = -origin[2] / (n_air * dz) + t / np.sqrt(n_glass * n_glass - q2)
    water = 1.0 / np.sqrt(n_water * n_water - q2)
    return origin[0] + qx * k, origin[1] + qy * k, qx * water, qy * water, _OK


@njit(inline="always", cache=True, error_model="numpy")
def _root(
    low: float,
    high: float,
    f_low: float,
    f_high: float,
    ax: float,
    ay: float,
    bx: float,
    by: float,
    L: ArrayF,
    origin: ArrayF,
    v: float,
    media: ArrayF,
) -> tuple[float, float, float]:
    """Fan parameter, depth and sine of the angle between ray and sheet of the root in a bracket."""
    u = low if f_low == f_high else low - f_low * (high - low) / (f_high - f_low)
    rising = f_low < f_high
    depth = sine = np.nan
    for _ in range(60):
        x, y, s, r, xu, yu, su, ru = _beam(u, L, origin, v, media)
        px, py, ex, ey = x - ax, y - ay, s - bx, r - by
        f = px * ey - py * ex
        slope = xu * ey - yu * ex + px * ru - py * su
        if (f < 0.0) == rising:
            low = u
        else:
            high = u
        new = u - f / slope
        if not (new >= low and new <= high):
            new = 0.5 * (low + high)
        step = new - u
        # The error behind a step of Newton is some step^2; 60 halvings end by themselves.
        if abs(step) < 1e-8 * (1.0 + abs(u)):
            e2 = ex * ex + ey * ey
            depth = -(px * ex + py * ey) / e2
            tx, ty = xu + su * depth, yu + ru * depth  # along the sheet, at this depth
            by_u = -(xu * ex + yu * ey + px * su + py * ru + 2.0 * depth * (ex * su + ey * ru)) / e2
            depth += by_u * step
            side, flat = ex * ty - ey * tx, s * ty - r * tx
            sine = abs(side) / np.sqrt((1.0 + bx * bx + by * by) * (tx * tx + ty * ty + flat * flat))
            u = new
            break
        u = new
    return u, depth, sine
