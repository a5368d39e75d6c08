"""Simpler models of the sheet, the papers' own way to its points, and the errors that they leave.

Models beside the strict intersection:

``plane``
    the refracted sheet as a plane, fitted to it (Matos et al. 2018, van der Lucht et al. 2019); image rays
    refracted.
``elliptical cone``
    the refracted sheet as a cone of the second order with a free apex, fitted to it (Palomer et al. 2017, who
    state remaining errors of about 2 mm); image rays refracted.
``no glass``, ``no refraction``
    the strict intersection with parts of the media left out.
``Snell as printed``
    the law of refraction with the misprint of P3 and P4, eq. 1.

The papers' way, kept for comparison: the fan is halved by distances of skew rays.
P4 4.2: "This sub-beam can be found recursively by splitting the lightsheet in two halves until the nearest
points of the skew image- and laser rays is underneath a given threshold." A distance has no sign: where the
true sub-beam lies near the border of two halves, the nearer of the two sub-beams that stand for them may
belong to the wrong half, and no further halving comes back. Such pixels keep a distance that never gets
small.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from thalweg.core import ArrayF, ArrayI, GeometryError, njit
from thalweg.lightsheet.optics.intersection import intersect, laser_window, media
from thalweg.lightsheet.optics.refraction import WaterRays, refract_to_water
from thalweg.lightsheet.optics.sensor import Sensor, Window
from thalweg.lightsheet.optics.volume import depth_lines, fan_angles, measurement_volume

DEPTHS_MM: Final = (50.0, 125.0, 200.0)
"""Reference depths of P4."""

THRESHOLD_MM: Final = 1e-3
"""Distance between the skew rays below which the halving ends; P4 does not print its own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetPlane:
    """``normal . x = offset`` in lcs; ``residual_mm`` (n,) of the points that it was fitted to."""

    normal: ArrayF
    offset_mm: float
    residual_mm: ArrayF

    def depths(self, rays: WaterRays) -> ArrayF:
        """Depths (n,) at which rays meet the plane."""
        start, direction = _lines(rays)
        return np.asarray((self.offset_mm - start @ self.normal) / (direction @ self.normal))


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetCone:
    """``(x - apex)^T Q (x - apex) = 0`` in lcs; ``residual_mm`` (n,) distances of the fitted points."""

    apex_lcs_mm: ArrayF
    Q: ArrayF
    residual_mm: ArrayF
    plane: SheetPlane

    def depths(self, rays: WaterRays) -> ArrayF:
        """Depths (n,) at which rays meet the cone: of both places the one nearer to the fitted plane."""
        start, direction = _lines(rays)
        off = start - self.apex_lcs_mm
        a, b, c = (
            np.einsum("ni,ij,nj->n", u, self.Q, v)
            for u, v in ((direction, direction), (off, direction), (off, off))
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            root = np.sqrt(b * b - a * c)
            # q and c/q are free of the cancellation of the school formula
            q = -(b + np.where(b < 0, -1.0, 1.0) * root)
            both = np.stack([q / a, c / q])
        near = np.argmin(np.where(np.isfinite(both), np.abs(both - self.plane.depths(rays)), np.inf), axis=0)
        return both[near, np.arange(both.shape[1])]


@dataclass(frozen=True, slots=True, kw_only=True)
class HalvedPoints:
    """Points by halving: ``xyz_lcs_mm`` (n, 3), ``depth_mm`` (n,), ``fan_angle_rad`` (n,), ``skew_mm`` (n,)
    distance left between the rays, ``halvings`` (n,). The papers have no mark for rays that meet no sub-beam:
    all get numbers.
    """

    xyz_lcs_mm: ArrayF
    depth_mm: ArrayF
    fan_angle_rad: ArrayF
    skew_mm: ArrayF
    halvings: ArrayI


def fit_plane(
    sensor: Sensor, depths_mm: Sequence[float] = (40, 80, 125, 170, 220), n: int = 61
) -> SheetPlane:
    """The plane with the least square distances from the sheet where the picture sees it."""
    points = _seen(sensor, depths_mm, n)
    centre = points.mean(axis=0)
    normal = np.linalg.svd(points - centre, full_matrices=False)[2][2]
    return SheetPlane(normal=normal, offset_mm=float(centre @ normal), residual_mm=(points - centre) @ normal)


def fit_cone(sensor: Sensor, depths_mm: Sequence[float] = (40, 80, 125, 170, 220), n: int = 61) -> SheetCone:
    """The elliptical cone with the least square distances from the sheet where the picture sees it.

    It starts from the place that is nearest to all sub-beams of the water and the quadric through their
    directions.
    """
    points = _seen(sensor, depths_mm, n)
    rays = refract_to_water(
        sensor.sheet.origin_lcs_mm, sensor.sheet.beams(fan_angles(sensor, n)), sensor.window
    )
    start, direction = rays.at_depth(0.0), rays.directions()
    across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    apex = np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, start))
    quadric = np.linalg.svd(_monomials(direction), full_matrices=False)[2][5]
    scale = float(np.linalg.norm(points - apex, axis=1).mean())

    def distances(x: ArrayF) -> ArrayF:
        """Distances of the points from the quadric cone, to first order, in millimetres."""
        off = points / scale - x[:3]
        Q = _symmetric(x[3:])
        return np.asarray(
            np.einsum("ni,ij,nj->n", off, Q, off) / (2.0 * np.linalg.norm(off @ Q, axis=1)) * scale
        )

    found = least_squares(distances, np.concatenate([apex / scale, quadric]), x_scale="jac", max_nfev=200)
    Q = _symmetric(found.x[3:])
    return SheetCone(
        apex_lcs_mm=found.x[:3] * scale,
        Q=Q / np.linalg.norm(Q),
        residual_mm=distances(found.x),
        plane=fit_plane(sensor, depths_mm, n),
    )


def model_errors(sensor: Sensor, depths_mm: Sequence[float] = DEPTHS_MM, n: int = 61) -> pd.DataFrame:
    """Errors in depth that each model leaves along lines of equal depth, in millimetres.

    Returns
    -------
    A row for each model and depth: ``model, depth_mm, mean_mm, std_mm, low_mm, high_mm, n, lost``; errors are
    the model's depth minus the true one, ``lost`` counts pixels for which the model has no depth.
    """
    plane, cone = fit_plane(sensor), fit_cone(sensor)
    window = sensor.window
    air = replace(window, n_glass=window.n_air, n_water=window.n_air)
    thin = replace(sensor, window=replace(window, thickness_mm=0.0))
    wide = _widened(sensor)
    models: dict[str, Callable[[ArrayF], ArrayF]] = {
        "plane": lambda xy: plane.depths(image_rays(sensor, xy)),
        "elliptical cone": lambda xy: cone.depths(image_rays(sensor, xy)),
        # without the plate the water begins at its inner face
        "no glass": lambda xy: intersect(_widened(thin), xy).depth_mm - window.thickness_mm,
        "no refraction": lambda xy: intersect(replace(wide, window=air), xy).depth_mm,
        "Snell as printed": lambda xy: intersect_as_printed(sensor, xy),
    }
    rows = []
    for line in depth_lines(sensor, depths_mm, n):
        for name, depth_of in models.items():
            error = depth_of(line.xy_px) - line.depth_mm
            good = error[np.isfinite(error)]
            numbers = (good.mean(), good.std(), good.min(), good.max()) if len(good) else (float("nan"),) * 4
            rows.append((name, line.depth_mm, *numbers, len(error), len(error) - len(good)))
    columns = ["model", "depth_mm", "mean_mm", "std_mm", "low_mm", "high_mm", "n", "lost"]
    return pd.DataFrame(rows, columns=columns).sort_values(["model", "depth_mm"], ignore_index=True)


def image_rays(sensor: Sensor, xy_px: ArrayF) -> WaterRays:
    """Rays of pixels (n, 2) in the water."""
    rays = sensor.camera.rays(xy_px) @ sensor.R_lcs_ccs.T
    return refract_to_water(sensor.camera_origin_lcs_mm, rays, sensor.window)


def intersect_by_halving(
    sensor: Sensor,
    xy_px: ArrayLike,
    *,
    compare: Literal["middles", "ends"] = "middles",
    threshold_mm: float = THRESHOLD_MM,
    most: int = 50,
) -> HalvedPoints:
    """Points of pixels (n, 2) as the papers find them, with the right law of refraction.

    Parameters
    ----------
    sensor, xy_px : see `thalweg.lightsheet.optics.intersection.intersect`.
    compare : which sub-beams stand for the two halves, their middle or their outer ones; P4 does not say.
    threshold_mm : see `THRESHOLD_MM`.
    most : halvings; beyond 50 a fan has no more float64 numbers.
    """
    window = sensor.window
    rays = sensor.camera.rays(xy_px) @ sensor.R_lcs_ccs.T
    image = refract_to_water(sensor.camera_origin_lcs_mm, rays, window)
    out, halvings = np.empty((len(rays), 5)), np.empty(len(rays), dtype=np.int64)
    _halve(
        image.A,
        image.B,
        *laser_window(sensor.sheet, window),
        sensor.sheet.v,
        media(window),
        sensor.sheet.half_angle_rad,
        compare == "ends",
        threshold_mm,
        most,
        out,
        halvings,
    )
    local = np.concatenate([out[:, :2], -out[:, 2:3] - window.thickness_mm], axis=1)
    return HalvedPoints(
        xyz_lcs_mm=local @ window.R_lcs_window.T,
        depth_mm=out[:, 2],
        fan_angle_rad=out[:, 4],
        skew_mm=out[:, 3],
        halvings=halvings,
    )


def intersect_as_printed(sensor: Sensor, xy_px: ArrayLike, *, samples: int = 4001) -> ArrayF:
    """Depths (n,) of pixels (n, 2) by the law of refraction as P3 and P4 print it; NaN where there is none.

    Only to show what the misprint would do: the sub-beam is found among ``samples``, between which F is
    straight.
    """
    window, sheet = sensor.window, sensor.sheet
    rays = sensor.camera.rays(xy_px) @ sensor.R_lcs_ccs.T
    A, B = _printed_lines(trace_as_printed(sensor.camera_origin_lcs_mm, rays, window), window)
    # sub-beams beyond the fan: the misprint moves the place where a ray meets the sheet
    wide = min(1.3 * sheet.half_angle_rad, np.deg2rad(80.0))
    beams = sheet.beams(np.linspace(-wide, wide, samples))
    fan_A, fan_B = _printed_lines(trace_as_printed(sheet.origin_lcs_mm, beams, window), window)
    depth = np.full(len(A), np.nan)
    for i in range(len(A)):
        dA, dB = fan_A - A[i], fan_B - B[i]
        F = dA[:, 0] * dB[:, 1] - dA[:, 1] * dB[:, 0]
        at = np.flatnonzero(F[:-1] * F[1:] <= 0.0)
        if len(at):
            k = at[0]
            share = F[k] / (F[k] - F[k + 1])
            a, b = dA[k] + share * (dA[k + 1] - dA[k]), dB[k] + share * (dB[k + 1] - dB[k])
            depth[i] = -(a @ b) / (b @ b)
    return depth


def trace_as_printed(origin_mm: ArrayLike, directions: ArrayLike, window: Window) -> tuple[ArrayF, ArrayF]:
    """Points (n, 3) on the outer face and directions (n, 3) in the water, by `refract_as_printed`."""
    v = np.atleast_2d(np.asarray(directions, dtype=np.float64))
    start, N = np.broadcast_to(np.asarray(origin_mm, dtype=np.float64), v.shape), window.normal_lcs
    inner = start - v * ((start @ N) / (v @ N))[:, None]
    glass = refract_as_printed(v, N, window.n_air, window.n_glass)
    outer = inner - glass * (window.thickness_mm / (glass @ N))[:, None]
    return outer, refract_as_printed(glass, N, window.n_glass, window.n_water)


def refract_as_printed(directions: ArrayLike, normal: ArrayLike, n_1: float, n_2: float) -> ArrayF:
    """P3 eq. 1 and P4 eq. 1 as they stand: with ``1 + r^2 (c - 1)^2`` under the root. Wrong but for c = 1."""
    v, N = np.atleast_2d(np.asarray(directions, dtype=np.float64)), np.asarray(normal, dtype=np.float64)
    r, c = n_1 / n_2, -(v @ N)
    return np.asarray(r * v + (r * c - np.sqrt(1.0 + r * r * (c - 1.0) ** 2))[:, None] * N)


def _widened(sensor: Sensor) -> Sensor:
    """With a wider fan: a wrong model finds its sub-beam elsewhere, perhaps beyond the end."""
    half = min(1.3 * sensor.sheet.half_angle_rad, np.deg2rad(80.0))
    return sensor.with_sheet(replace(sensor.sheet, half_angle_rad=half))


def _seen(sensor: Sensor, depths_mm: Sequence[float], n: int) -> ArrayF:
    """Points (k, 3) of the sheet at depths that the picture sees."""
    most = measurement_volume(sensor, step_px=64).depth_mm[1]
    inside = [depth for depth in depths_mm if depth < most]
    points = np.concatenate(
        [line.xyz_lcs_mm for line in depth_lines(sensor, inside, n)] or [np.zeros((0, 3))]
    )
    if len(points) < 20:
        raise GeometryError(
            f"{len(points)} points of the sheet in the picture at the depths {list(depths_mm)} mm",
            expected="20 or more",
            where=f"sensor {sensor.name!r}",
        )
    return points


def _lines(rays: WaterRays) -> tuple[ArrayF, ArrayF]:
    """Places at depth 0 and changes a millimetre of depth, (n, 3) lcs."""
    start = rays.at_depth(0.0)
    return start, rays.at_depth(1.0) - start


def _monomials(x: ArrayF) -> ArrayF:
    return np.stack(
        [
            x[:, 0] ** 2,
            x[:, 1] ** 2,
            x[:, 2] ** 2,
            2 * x[:, 0] * x[:, 1],
            2 * x[:, 0] * x[:, 2],
            2 * x[:, 1] * x[:, 2],
        ],
        axis=1,
    )


def _symmetric(x: ArrayF) -> ArrayF:
    return np.array([[x[0], x[3], x[4]], [x[3], x[1], x[5]], [x[4], x[5], x[2]]])


def _printed_lines(path: tuple[ArrayF, ArrayF], window: Window) -> tuple[ArrayF, ArrayF]:
    """A and B of rays in the frame of the window."""
    outer, water = (a @ window.R_lcs_window for a in path)
    return outer[:, :2], -water[:, :2] / water[:, 2:]


@njit(inline="always", cache=True, error_model="numpy")
def _beam(a: float, L: ArrayF, origin: ArrayF, v: float, media: ArrayF) -> tuple[float, float, float, float]:
    """A and B of the sub-beam of a fan angle."""
    s = np.sin(a)
    c = -np.sqrt(1.0 - s * s - v * v)
    qx = media[0] * (L[0, 0] * s + L[0, 1] * v + L[0, 2] * c)
    qy = media[0] * (L[1, 0] * s + L[1, 1] * v + L[1, 2] * c)
    down = -(L[2, 0] * s + L[2, 1] * v + L[2, 2] * c)
    q2 = qx * qx + qy * qy
    if down <= 0.0 or q2 >= media[1] * media[1] or q2 >= media[2] * media[2]:
        return np.nan, np.nan, np.nan, np.nan
    k = origin[2] / (media[0] * down) + media[3] / np.sqrt(media[1] * media[1] - q2)
    water = 1.0 / np.sqrt(media[2] * media[2] - q2)
    return origin[0] + qx * k, origin[1] + qy * k, qx * water, qy * water


@njit(inline="always", cache=True, error_model="numpy")
def _skew(px: float, py: float, bx: float, by: float, x: float, y: float, s: float, r: float) -> float:
    """Distance between the lines (px, py) + (bx, by) D and (x, y) + (s, r) D; infinite for none."""
    nx, ny, nz = by - r, s - bx, s * by - r * bx
    distance = abs((x - px) * nx + (y - py) * ny) / np.sqrt(nx * nx + ny * ny + nz * nz)
    return distance if np.isfinite(distance) else np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def _halve(
    A: ArrayF,
    B: ArrayF,
    L: ArrayF,
    origin: ArrayF,
    v: float,
    media: ArrayF,
    half: float,
    ends: bool,
    threshold: float,
    most: int,
    out: ArrayF,
    halvings: ArrayI,
) -> None:
    """``out`` (n, 5): X, Y, depth, distance left, fan angle."""
    for i in range(len(A)):
        px, py, bx, by = A[i, 0], A[i, 1], B[i, 0], B[i, 1]
        low, high, a, left, steps = -half, half, 0.0, np.inf, 0
        while left > threshold and steps < most:
            middle = 0.5 * (low + high)
            first, second = 0.5 * (low + middle), 0.5 * (middle + high)
            if ends:
                first, second = low, high
            x, y, s, r = _beam(first, L, origin, v, media)
            d1 = _skew(px, py, bx, by, x, y, s, r)
            x, y, s, r = _beam(second, L, origin, v, media)
            d2 = _skew(px, py, bx, by, x, y, s, r)
            if d1 <= d2:
                high, a, left = middle, first, d1
            else:
                low, a, left = middle, second, d2
            steps += 1
        x, y, s, r = _beam(a, L, origin, v, media)
        # nearest points P + p c, Q + q d with p = (bx, by, -1), q = (s, r, -1); the point is half-way
        ox, oy = x - px, y - py
        pp, qq, pq = bx * bx + by * by + 1.0, s * s + r * r + 1.0, bx * s + by * r + 1.0
        po, qo = bx * ox + by * oy, s * ox + r * oy
        det = pp * qq - pq * pq
        c, d = (qq * po - pq * qo) / det, (pq * po - pp * qo) / det
        out[i, 0] = 0.5 * (px + bx * c + x + s * d)
        out[i, 1] = 0.5 * (py + by * c + y + r * d)
        out[i, 2], out[i, 3], out[i, 4] = 0.5 * (c + d), left, a
        halvings[i] = steps
