"""The papers' own way, kept for comparison: the fan is halved by distances of skew rays, and Snell as
printed.

P4 4.2: "This sub-beam can be found recursively by splitting the lightsheet in two halves until the nearest
points of the skew image- and laser rays is underneath a given threshold." A distance has no sign: where the
true sub-beam lies near the border of two halves, the nearer of the two sub-beams that stand for them may
belong to the wrong half, and no further halving comes back. Such pixels keep a distance that never gets
small.
"""

from dataclasses import dataclass
from typing import Final, Literal

import numba as nb
import numpy as np
from numpy.typing import ArrayLike

from thalweg.core.types import ArrayF, ArrayI
from thalweg.lightsheet.optics.intersection import laser_window, media
from thalweg.lightsheet.optics.refracted_rays import refract_to_water
from thalweg.lightsheet.optics.sensor import Sensor, Window

nb.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]

THRESHOLD_MM: Final = 1e-3
"""Distance between the skew rays below which the halving ends; P4 does not print its own."""


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
        image.A, image.B, *laser_window(sensor.sheet, window), sensor.sheet.v, media(window),
        sensor.sheet.half_angle_rad, compare == "ends", threshold_mm, most, out, halvings,
    )  # fmt: skip
    local = np.concatenate([out[:, :2], -out[:, 2:3] - window.thickness_mm], axis=1)
    return HalvedPoints(
        xyz_lcs_mm=local @ window.R_lcs_window.T, depth_mm=out[:, 2], fan_angle_rad=out[:, 4],
        skew_mm=out[:, 3], halvings=halvings,
    )  # fmt: skip


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


def _printed_lines(path: tuple[ArrayF, ArrayF], window: Window) -> tuple[ArrayF, ArrayF]:
    """A and B of rays in the frame of the window."""
    outer, water = (a @ window.R_lcs_window for a in path)
    return outer[:, :2], -water[:, :2] / water[:, 2:]


@nb.njit(inline="always", cache=True, error_model="numpy")
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


@nb.njit(inline="always", cache=True, error_model="numpy")
def _skew(px: float, py: float, bx: float, by: float, x: float, y: float, s: float, r: float) -> float:
    """Distance between the lines (px, py) + (bx, by) D and (x, y) + (s, r) D; infinite for none."""
    nx, ny, nz = by - r, s - bx, s * by - r * bx
    distance = abs((x - px) * nx + (y - py) * ny) / np.sqrt(nx * nx + ny * ny + nz * nz)
    return distance if np.isfinite(distance) else np.inf


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _halve(
    A: ArrayF, B: ArrayF, L: ArrayF, origin: ArrayF, v: float, media: ArrayF,
    half: float, ends: bool, threshold: float, most: int, out: ArrayF, halvings: ArrayI,
) -> None:  # fmt: skip
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
