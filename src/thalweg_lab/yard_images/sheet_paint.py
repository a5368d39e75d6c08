"""Printed sheets in a picture: the share of ink that a pixel sees, without a bias of its crossings.

For each pixel that meets a thing with sheets the ray and its four neighbours half a pixel away are cut with
the *exact* cone or plane of each sheet, not with the mesh, whose chords lie up to 0.01 mm inside. That gives
the place on the print and its change over the pixel. The pixel is then divided, and each part takes the mean
of the print over its own small rectangle, exactly. So an edge along the pixels is as true as a slanted one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numba as nb
import numpy as np

from thalweg.calibration.markers.sheets import SHEET_MODULES, MarkerLayout, sheet_picture
from thalweg.core.types import ArrayB, ArrayF, ArrayF32, ArrayI
from thalweg_lab.yard.cones import FieldCone
from thalweg_lab.yard.sheets import Sheet

# Open3D brings an old TBB into the process, which numba would try first and complain about.
nb.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]

_MIDDLE: Final = SHEET_MODULES / 2
_NEAR_M: Final = 0.001
"""A point of the mesh belongs to the surface of a sheet if it lies this close to it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PaintTable:
    """Sheets as arrays, sorted by the thing that they are glued on.

    Parameters
    ----------
    first : (things + 1,) where the sheets of each thing begin.
    is_cone : (k,) whether the surface is a cone.
    origin : (k, 3) apex, or origin of the plane, wcs.
    axes : (k, 3, 3) rows: axes of the cone's frame; or right, down, normal of the plane.
    half_angle_rad : (k,) of the cone.
    place : (k, 2) middle of the sheet: slant distance and azimuth, or right and down.
    to_modules : (k, 2, 2) from metres right and down of the middle to modules.
    black : (k, 10, 10) modules with ink, row first.
    """

    first: ArrayI
    is_cone: ArrayB
    origin: ArrayF
    axes: ArrayF
    half_angle_rad: ArrayF
    place: ArrayF
    to_modules: ArrayF
    black: ArrayB

    @classmethod
    def of(cls, sheets: Sequence[Sheet], things: Sequence[str], layout: MarkerLayout) -> Self:
        """Table of the sheets on things; sheets on other things are left out."""
        number = {name: i for i, name in enumerate(things)}
        kept = sorted((s for s in sheets if s.thing in number), key=lambda s: number[s.thing])
        on = np.array([number[s.thing] for s in kept], dtype=np.int64)
        cones = [s.surface if isinstance(s.surface, FieldCone) else None for s in kept]
        k = len(kept)
        black = np.zeros((k, SHEET_MODULES, SHEET_MODULES), dtype=np.bool_)
        origin, axes, matrix = np.zeros((k, 3)), np.zeros((k, 3, 3)), np.zeros((k, 2, 2))
        for i, sheet in enumerate(kept):
            # Two pixels a module and half a module of margin: each module's first pixel tells its colour.
            black[i] = sheet_picture(sheet.marker, layout, 2)[1:-1:2, 1:-1:2] == 0
            surface = sheet.surface
            if isinstance(surface, FieldCone):
                origin[i], axes[i] = surface.apex_wcs_m, surface.R_cocs_wcs
            else:
                origin[i] = surface.origin_wcs_m
                axes[i] = np.stack([surface.right_wcs, surface.down_wcs, surface.normal_wcs])
            matrix[i] = _print_axes(sheet) / sheet.module_m
        return cls(
            first=np.searchsorted(on, np.arange(len(things) + 1)).astype(np.int64),
            is_cone=np.array([c is not None for c in cones], dtype=np.bool_),
            origin=origin,
            axes=axes,
            half_angle_rad=np.array([0.1 if c is None else c.half_angle_rad for c in cones]),
            place=np.array([s.place for s in kept]).reshape(k, 2),
            to_modules=matrix,
            black=black,
        )

    def paint(
        self,
        eye_wcs_m: ArrayF,
        rays_wcs: ArrayF32,
        dx: ArrayF32,
        dy: ArrayF32,
        t_m: ArrayF,
        thing: ArrayI,
        cells: int,
    ) -> tuple[ArrayF32, ArrayF32]:
        """Shares (n,) of paper and of ink that pixels see; ink is a part of the paper.

        Parameters
        ----------
        eye_wcs_m : (3,) projection centre.
        rays_wcs : (n, 3) directions.
        dx, dy : (n, 3) change of the direction from one side of the pixel, or of its part, to the other.
        t_m : (n,) where the ray meets the mesh.
        thing : (n,) number of the thing that it meets, -1 for none.
        cells : parts along each side that a pixel is divided into.
        """
        paper, ink = (np.zeros(len(t_m), dtype=np.float32) for _ in range(2))
        if len(self.place):
            _paint(
                eye_wcs_m, rays_wcs, dx, dy, t_m, thing, cells, self.first, self.is_cone, self.origin,
                self.axes, self.half_angle_rad, self.place, self.to_modules, self.black, _NEAR_M, _MIDDLE,
                paper, ink,
            )  # fmt: skip
        return paper, ink


def _print_axes(sheet: Sheet) -> ArrayF:
    """(2, 2) from right and down on the surface to the print, turned and mirrored as it is glued."""
    cos, sin = np.cos(sheet.turn_rad), np.sin(sheet.turn_rad)
    flip = -1.0 if sheet.mirrored else 1.0
    return np.array([[flip * cos, flip * sin], [-sin, cos]])


@nb.njit(cache=True, error_model="numpy", inline="always")
def _flat(eye, x, y, z, near, cone, origin, axes, angle, place):  # type: ignore[no-untyped-def]
    """Where a ray (x, y, z) cuts a sheet's surface near a distance: right, down, distance off, share."""
    ox, oy, oz = eye[0] - origin[0], eye[1] - origin[1], eye[2] - origin[2]
    px = axes[0, 0] * ox + axes[0, 1] * oy + axes[0, 2] * oz
    py = axes[1, 0] * ox + axes[1, 1] * oy + axes[1, 2] * oz
    pz = axes[2, 0] * ox + axes[2, 1] * oy + axes[2, 2] * oz
    dx = axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z
    dy = axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z
    dz = axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z
    if not cone:
        t = -pz / dz
        off = abs(pz + near * dz)
        if dz >= 0.0:
            off = 1.0
        return px + t * dx - place[0], py + t * dy - place[1], off
    sine, cosine = np.sin(angle), np.cos(angle)
    across = np.sqrt((px + near * dx) ** 2 + (py + near * dy) ** 2)
    off = abs(across * cosine - (pz + near * dz) * sine)
    # x^2 + y^2 - tan^2 z^2 = 0 along the ray: the root next to the mesh.
    tan2 = (sine / cosine) ** 2
    a = dx * dx + dy * dy - tan2 * dz * dz
    b = px * dx + py * dy - tan2 * pz * dz
    c = px * px + py * py - tan2 * pz * pz
    root = b * b - a * c
    t = near
    if root > 0.0 and abs(a) > 1e-12:
        root = np.sqrt(root)
        one, other = (-b - root) / a, (-b + root) / a
        t = one if abs(one - near) < abs(other - near) else other
    qx, qy, qz = px + t * dx, py + t * dy, pz + t * dz
    slant = qz * cosine + np.sqrt(qx * qx + qy * qy) * sine
    turn = place[1] - np.arctan2(qy, qx)
    turn = (turn + np.pi) - 2 * np.pi * np.floor((turn + np.pi) / (2 * np.pi)) - np.pi
    turn *= sine
    return slant * np.sin(turn), slant * np.cos(turn) - place[0], off


@nb.njit(cache=True, error_model="numpy", inline="always")
def _overlap(low, high, a, b):  # type: ignore[no-untyped-def]
    """Share of [low, high] inside [a, b]."""
    return max(min(high, b) - max(low, a), 0.0) / (high - low)


@nb.njit(cache=True, error_model="numpy")
def _mean_of_print(u, v, wide, high, black):  # type: ignore[no-untyped-def]
    """Paper and ink in a rectangle of the print about (u, v), wide by high modules."""
    u0, u1, v0, v1 = u - wide / 2, u + wide / 2, v - high / 2, v + high / 2
    paper = _overlap(u0, u1, -0.5, 10.5) * _overlap(v0, v1, -0.5, 10.5)
    ink = 0.0
    if paper > 0.0:
        for row in range(max(int(np.floor(v0)), 0), min(int(np.floor(v1)), 9) + 1):
            share = _overlap(v0, v1, row, row + 1)
            for col in range(max(int(np.floor(u0)), 0), min(int(np.floor(u1)), 9) + 1):
                if black[row, col]:
                    ink += share * _overlap(u0, u1, col, col + 1)
    return paper, ink


@nb.njit(cache=True, error_model="numpy", parallel=True)
def _paint(  # type: ignore[no-untyped-def]
    eye, rays, dx, dy, t, thing, cells, first, is_cone, origin, axes, angle, place, matrix, black, close,
    middle, paper, ink,
):  # fmt: skip
    for i in nb.prange(len(t)):
        what = thing[i]
        if what < 0:
            continue
        x, y, z = rays[i, 0], rays[i, 1], rays[i, 2]
        for k in range(first[what], first[what + 1]):
            m = matrix[k]
            fu, fv, off = _flat(eye, x, y, z, t[i], is_cone[k], origin[k], axes[k], angle[k], place[k])
            if off > close:
                continue
            u, v = fu * m[0, 0] + fv * m[0, 1] + middle, fu * m[1, 0] + fv * m[1, 1] + middle
            if u < -2.5 or u > 12.5 or v < -2.5 or v > 12.5:
                continue
            j = np.zeros((2, 2))
            for side in range(2):
                d = dx[i] if side == 0 else dy[i]
                hx, hy, hz = 0.5 * d[0], 0.5 * d[1], 0.5 * d[2]
                au, av, _ = _flat(eye, x + hx, y + hy, z + hz, t[i], is_cone[k], origin[k], axes[k], angle[k],
                                  place[k])  # fmt: skip
                bu, bv, _ = _flat(eye, x - hx, y - hy, z - hz, t[i], is_cone[k], origin[k], axes[k], angle[k],
                                  place[k])  # fmt: skip
                j[0, side] = (au - bu) * m[0, 0] + (av - bv) * m[0, 1]
                j[1, side] = (au - bu) * m[1, 0] + (av - bv) * m[1, 1]
            wide = max(np.sqrt(j[0, 0] ** 2 + j[0, 1] ** 2) / cells, 1e-6)
            high = max(np.sqrt(j[1, 0] ** 2 + j[1, 1] ** 2) / cells, 1e-6)
            sum_paper, sum_ink = 0.0, 0.0
            for row in range(cells):
                b = (row + 0.5) / cells - 0.5
                for col in range(cells):
                    a = (col + 0.5) / cells - 0.5
                    p, q = _mean_of_print(
                        u + a * j[0, 0] + b * j[0, 1], v + a * j[1, 0] + b * j[1, 1], wide, high, black[k]
                    )
                    sum_paper += p
                    sum_ink += q
            paper[i] = min(paper[i] + sum_paper / cells**2, 1.0)
            ink[i] = min(ink[i] + sum_ink / cells**2, 1.0)
