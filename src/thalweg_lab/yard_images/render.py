"""Photographs of the yard: one ray a pixel, sixteen at silhouettes, exact prints, light of sun and sky.

Each pixel's ray is that of the true camera, so a lens of any model needs no resampling. The print of a sheet
is averaged over the pixel exactly (`sheet_paint`); at silhouettes 4 x 4 rays are averaged.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from typing import Final, NamedTuple, Self

import numpy as np

from thalweg.calibration import SHEET_MODULES, MarkerLayout, sheet_picture
from thalweg.core import ArrayB, ArrayF, ArrayF32, ArrayI, ArrayU8, Rigid, njit, prange
from thalweg.core.geometry import RayCaster
from thalweg_lab.reach import chance_of, mixed, noise_at, seen_share
from thalweg_lab.river import half_sphere
from thalweg_lab.river_images import Sun, sky
from thalweg_lab.yard import FieldCone, Sheet, Yard
from thalweg_lab.yard_images.camera import LensRays

HAZY_SUN_RAD: Final = 0.012
"""Half the angle that the sun seems to have through thin cloud: its shadows have soft borders."""
SUN_SHARE: Final = 0.62
"""Light that thin cloud leaves of the sun."""
SKY_COLOUR: Final = np.array([0.66, 0.72, 0.80])
GROUND_COLOUR: Final = np.array([0.26, 0.255, 0.25])
_BAND_PX: Final = 400_000
"""Rays that are cast at a time."""
_PARTS: Final = 4
"""Parts of a pixel along each side."""
_SHADOW_STEP_PX: Final = 2
_APART: Final = np.array([(-0.5, -0.5), (0.5, 0.5)], dtype=np.float32)
"""Places in every second pixel that lie evenly apart from those of the next one."""
_WITHIN: Final = np.array([(-0.25, -0.25), (0.25, -0.25), (0.25, 0.25), (-0.25, 0.25)], dtype=np.float32)
_MIDDLE_OF_PIXEL: Final = np.zeros((1, 2), dtype=np.float32)
_LIFT_M: Final = 5e-4
_CELL_M: Final = 0.05
_SKY_RAYS: Final = 16
_MIDDLE: Final = SHEET_MODULES / 2
_NEAR_M: Final = 0.001
"""A point of the mesh belongs to the surface of a sheet if it lies this close to it."""

PAPER: Final = 0.80
"""Share of light that white paper reflects."""
INK: Final = 0.045
_COLOUR: Final = np.array([
    [0.168, 0.166, 0.164],  # asphalt
    [0.300, 0.205, 0.125],  # fence
    [0.430, 0.420, 0.395],  # cone
    [0.330, 0.345, 0.350],  # board
    [0.240, 0.250, 0.260],  # post
    [0.070, 0.090, 0.160],  # person
    [0.640, 0.400, 0.050],  # boat
    [0.330, 0.340, 0.350],  # metal
    [0.045, 0.047, 0.050],  # sensor
])  # fmt: skip
# Longest spacing of the noise (m), its contrast, that of broad stains, that of grains, size of a grain.
_GRAIN: Final = np.array([
    [0.110, 0.14, 0.16, 0.42, 0.0065],
    [0.300, 0.10, 0.10, 0.10, 0.0030],
    [0.120, 0.06, 0.07, 0.05, 0.0040],
    [0.150, 0.05, 0.06, 0.03, 0.0040],
    [0.060, 0.12, 0.05, 0.08, 0.0030],
    [0.200, 0.16, 0.10, 0.10, 0.0100],
    [0.200, 0.04, 0.05, 0.02, 0.0040],
    [0.200, 0.05, 0.05, 0.04, 0.0040],
    [0.200, 0.05, 0.05, 0.04, 0.0040],
])  # fmt: skip
_PANORAMA: Final = (512, 2048)
"""Rows from the nadir to the zenith, columns around."""


# ---------------------------------------------------------------- rendering


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """A picture as light, with what each pixel's middle met.

    Parameters
    ----------
    light : (h, w, 3) linear light, the mean over each pixel.
    range_m : (h, w) distance, infinite where nothing was met.
    thing : (h, w) number of the thing, -1 for none.
    """

    light: ArrayF32
    range_m: ArrayF32
    thing: ArrayI


class Photographer:
    """Takes pictures of one yard in one light.

    Parameters
    ----------
    yard : what stands there.
    sun : where the sun stands.
    """

    def __init__(self, yard: Yard, sun: Sun) -> None:
        self.sun = sun
        self._load(yard)
        self._panorama = panorama(sun)
        self._sky_cells = self._bake_sky()

    def with_yard(self, yard: Yard) -> Self:
        """The same light on another yard; the open sky over the ground stays that of the first one."""
        other = copy(self)
        other._load(yard)
        return other

    def _load(self, yard: Yard) -> None:
        self.yard = yard
        self._caster = RayCaster(yard.vertices_wcs_m, yard.triangles)
        corners = yard.vertices_wcs_m[yard.triangles]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._normal = (normal / np.maximum(np.linalg.norm(normal, axis=1), 1e-30)[:, None]).astype(
            np.float32
        )
        self._look = np.array([appearance_of(name) for name in yard.names], dtype=np.int64)
        self._table = PaintTable.of(yard.sheets, yard.names, yard.layout)

    def see(self, lens: LensRays, T_wcs_ccs: Rigid) -> Seen:
        """The light in each pixel of a camera at a pose."""
        h, w, _ = lens.rays_ccs.shape
        eye = T_wcs_ccs.shift_m
        rays = turned(lens.rays_ccs.reshape(-1, 3), T_wcs_ccs.R)
        t, primitive = self._cast(eye, rays)
        thing = self._things(primitive)
        shape = (h, w)
        edge = edges(
            eye,
            rays.reshape(h, w, 3),
            t.reshape(shape),
            primitive.reshape(shape),
            self.yard.things,
            self._normal,
        ).ravel()
        sunlit = self._shadows(eye, rays.reshape(h, w, 3), t, primitive)
        light = np.zeros((h * w, 3), dtype=np.float32)
        dark = ~np.isfinite(rays[:, 0])
        miss = np.flatnonzero((primitive < 0) & ~edge & ~dark)
        light[miss] = surroundings(rays[miss], self._panorama, self.sun, lens.size_rad)
        whole = np.flatnonzero((primitive >= 0) & ~edge)
        step = max(_BAND_PX, 1)
        grid = rays.reshape(h, w, 3)
        for begin in range(0, len(whole), step):
            some = whole[begin : begin + step]
            light[some] = self._surface(
                eye,
                rays[some],
                *changes(grid, some),
                t[some],
                primitive[some],
                sunlit[some],
                lens.size_rad,
                _PARTS,
            )
        some = np.flatnonzero(edge & ~dark)
        for begin in range(0, len(some), step // _PARTS**2):
            part = some[begin : begin + step // _PARTS**2]
            light[part] = self._divided(eye, grid, rays, part, lens.size_rad)
        return Seen(light=light.reshape(h, w, 3), range_m=t.reshape(shape), thing=thing.reshape(shape))

    def _things(self, primitive: ArrayI) -> ArrayI:
        return np.where(primitive >= 0, self.yard.things[np.maximum(primitive, 0)], -1)

    def _cast(self, eye: ArrayF, rays: ArrayF32) -> tuple[ArrayF32, ArrayI]:
        """Distances (n,) and triangles (n,), in bands."""
        t, primitive = np.empty(len(rays), dtype=np.float32), np.empty(len(rays), dtype=np.int64)
        for begin in range(0, len(rays), _BAND_PX):
            band = slice(begin, begin + _BAND_PX)
            hits = self._caster.cast(eye, rays[band])
            t[band], primitive[band] = hits.t_hit_m, hits.primitive
        return t, primitive

    def _shadows(self, eye: ArrayF, grid: ArrayF32, t: ArrayF32, primitive: ArrayI) -> ArrayF32:
        """Share (n,) of the sun that shines on each pixel's place: rays from some pixels, more at borders."""
        h, w, _ = grid.shape
        rays = grid.reshape(-1, 3)
        index = np.arange(h * w).reshape(h, w)[::_SHADOW_STEP_PX, ::_SHADOW_STEP_PX]
        state = np.full(index.size, 2, dtype=np.uint8)
        met = np.flatnonzero(primitive[index.ravel()] >= 0)
        for begin in range(0, len(met), _BAND_PX):
            part = met[begin : begin + _BAND_PX]
            some = index.ravel()[part]
            share = self._in_sun(
                eye, rays[some], *changes(grid, some), t[some], primitive[some], some, _APART
            )
            state[part] = np.where(share > 0.9, 1, np.where(share < 0.1, 0, 2))
        coarse, open_ = unlike_corners(
            state.reshape(index.shape), primitive.reshape(h, w), self.yard.things, _SHADOW_STEP_PX
        )
        sunlit = coarse.ravel().astype(np.float32)
        rest = np.flatnonzero(open_.ravel())
        for begin in range(0, len(rest), _BAND_PX):
            some = rest[begin : begin + _BAND_PX]
            sunlit[some] = self._in_sun(
                eye, rays[some], *changes(grid, some), t[some], primitive[some], some, _WITHIN
            )
        return sunlit

    def _in_sun(
        self,
        eye: ArrayF,
        rays: ArrayF32,
        dx: ArrayF32,
        dy: ArrayF32,
        t: ArrayF32,
        primitive: ArrayI,
        index: ArrayI,
        places: ArrayF32,
    ) -> ArrayF32:
        """Share (n,) of the sun's disc that met surfaces see, from ``places`` (k, 2) in each pixel."""
        sun, n, k = self.sun.direction_wcs, len(t), len(places)
        right = np.array([-sun[1], sun[0], 0.0]) / np.hypot(sun[0], sun[1])
        up = np.cross(sun, right)
        side = np.empty(n, dtype=np.bool_)
        _faces_sun(rays, primitive, self._normal, sun, side)
        toward = np.flatnonzero(side)
        start = np.empty((len(toward), k, 3))
        way = np.empty((len(toward), k, 3), dtype=np.float32)
        _rays_to_sun(
            eye, rays, dx, dy, t, primitive, index, places, self._normal, sun, right, up, toward, start, way
        )
        free = self._caster.free(start.reshape(-1, 3), way.reshape(-1, 3)).reshape(-1, k)
        share = np.zeros(n, dtype=np.float32)
        share[toward] = free.mean(axis=1, dtype=np.float32)
        return share

    def _surface(
        self,
        eye: ArrayF,
        rays: ArrayF32,
        dx: ArrayF32,
        dy: ArrayF32,
        t: ArrayF32,
        primitive: ArrayI,
        sunlit: ArrayF32,
        size_rad: float,
        cells: int,
    ) -> ArrayF32:
        """Light (n, 3) from what rays met; a pixel's print is the mean of ``cells`` x ``cells`` parts."""
        out = np.empty_like(rays)
        surface_light(
            eye,
            rays,
            dx,
            dy,
            t,
            primitive,
            sunlit,
            np.float32(size_rad),
            cells,
            self._normal,
            self.yard.things,
            self._look,
            self._table,
            self._sky_cells,
            self.sun.direction_wcs,
            SUN_SHARE * self.sun.colour,
            out,
        )
        return out

    def _divided(
        self, eye: ArrayF, grid: ArrayF32, rays: ArrayF32, pixels: ArrayI, size_rad: float
    ) -> ArrayF32:
        """Light (n, 3) of pixels at silhouettes: the mean of 4 x 4 rays."""
        dx, dy = changes(grid, pixels)
        off = (np.arange(_PARTS) + 0.5) / _PARTS - 0.5
        a, b = (o.ravel().astype(np.float32) for o in np.meshgrid(off, off))
        some = rays[pixels][:, None] + a[:, None] * dx[:, None] + b[:, None] * dy[:, None]
        some = np.ascontiguousarray(some.reshape(-1, 3))
        t, primitive = self._cast(eye, some)
        light = np.zeros_like(some)
        miss, met = np.flatnonzero(primitive < 0), np.flatnonzero(primitive >= 0)
        light[miss] = surroundings(some[miss], self._panorama, self.sun, size_rad / _PARTS)
        index = np.repeat(pixels, _PARTS**2) * _PARTS**2 + np.tile(np.arange(_PARTS**2), len(pixels))
        small = np.float32(1 / _PARTS)
        wide, high = (np.repeat(d * small, _PARTS**2, axis=0)[met] for d in (dx, dy))
        hits = (eye, some[met], wide, high, t[met], primitive[met])
        sunlit = self._in_sun(*hits, index[met], _MIDDLE_OF_PIXEL)
        light[met] = self._surface(*hits, sunlit, size_rad / _PARTS, 1)
        return np.asarray(light.reshape(len(pixels), _PARTS**2, 3).mean(axis=1))

    def _bake_sky(self) -> ArrayF32:
        """Share of the sky that is open over the ground, on a grid of 5 cm about the origin."""
        low, high = self.yard.vertices_wcs_m.min(axis=0)[:2], self.yard.vertices_wcs_m.max(axis=0)[:2]
        half = min(float(np.abs([low, high]).max()), 15.0)
        n = int(2 * half / _CELL_M)
        xy = (np.arange(n) + 0.5) * _CELL_M - half
        x, y = (a.ravel() for a in np.meshgrid(xy, xy))
        start = np.stack([x, y, np.full(n * n, 0.004)], axis=1)
        up = np.tile([0.0, 0.0, 1.0], (n * n, 1))
        index = np.arange(n * n)
        share = np.zeros(n * n, dtype=np.float32)
        for ray in range(_SKY_RAYS):
            way = half_sphere(up, index, ray, _SKY_RAYS)
            share += self._caster.free(start, way)
        return share.reshape(n, n) / np.float32(_SKY_RAYS)


# ---------------------------------------------------------------- printed sheets in a picture: the share of
# ink that a pixel sees, without a bias of its crossings
#
# For each pixel that meets a thing with sheets the ray and its four neighbours half a pixel away are cut with
# the *exact* cone or plane of each sheet, not with the mesh, whose chords lie up to 0.01 mm inside. That
# gives the place on the print and its change over the pixel. The pixel is then divided, and each part takes
# the mean of the print over its own small rectangle, exactly. So an edge along the pixels is as true as a
# slanted one.


class PaintTable(NamedTuple):
    """Sheets as arrays, sorted by the thing that they are glued on; kernels take it as it is.

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
        _paint(eye_wcs_m, rays_wcs, dx, dy, t_m, thing, cells, self, paper, ink)
        return paper, ink


def _print_axes(sheet: Sheet) -> ArrayF:
    """(2, 2) from right and down on the surface to the print, turned as it is glued."""
    cos, sin = np.cos(sheet.turn_rad), np.sin(sheet.turn_rad)
    return np.array([[cos, sin], [-sin, cos]])


@njit(cache=True, error_model="numpy", inline="always")
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


@njit(cache=True, error_model="numpy", inline="always")
def _overlap(low, high, a, b):  # type: ignore[no-untyped-def]
    """Share of [low, high] inside [a, b]."""
    return max(min(high, b) - max(low, a), 0.0) / (high - low)


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def _print_seen(eye, ray, dx, dy, t, what, cells, table):  # type: ignore[no-untyped-def]
    """Shares of paper and of ink in what a pixel sees of a thing."""
    paper, ink = 0.0, 0.0
    x, y, z = ray[0], ray[1], ray[2]
    for k in range(table.first[what], table.first[what + 1]):
        m, on = table.to_modules[k], table.is_cone[k]
        origin, axes, angle, place = table.origin[k], table.axes[k], table.half_angle_rad[k], table.place[k]
        fu, fv, off = _flat(eye, x, y, z, t, on, origin, axes, angle, place)
        if off > _NEAR_M:
            continue
        u, v = fu * m[0, 0] + fv * m[0, 1] + _MIDDLE, fu * m[1, 0] + fv * m[1, 1] + _MIDDLE
        if u < -2.5 or u > 12.5 or v < -2.5 or v > 12.5:
            continue
        hx, hy, hz = 0.5 * dx[0], 0.5 * dx[1], 0.5 * dx[2]
        au, av, _ = _flat(eye, x + hx, y + hy, z + hz, t, on, origin, axes, angle, place)
        bu, bv, _ = _flat(eye, x - hx, y - hy, z - hz, t, on, origin, axes, angle, place)
        xx, yx = (au - bu) * m[0, 0] + (av - bv) * m[0, 1], (au - bu) * m[1, 0] + (av - bv) * m[1, 1]
        hx, hy, hz = 0.5 * dy[0], 0.5 * dy[1], 0.5 * dy[2]
        au, av, _ = _flat(eye, x + hx, y + hy, z + hz, t, on, origin, axes, angle, place)
        bu, bv, _ = _flat(eye, x - hx, y - hy, z - hz, t, on, origin, axes, angle, place)
        xy, yy = (au - bu) * m[0, 0] + (av - bv) * m[0, 1], (au - bu) * m[1, 0] + (av - bv) * m[1, 1]
        wide = max(np.sqrt(xx**2 + xy**2) / cells, 1e-6)
        high = max(np.sqrt(yx**2 + yy**2) / cells, 1e-6)
        sum_paper, sum_ink = 0.0, 0.0
        for row in range(cells):
            b = (row + 0.5) / cells - 0.5
            for col in range(cells):
                a = (col + 0.5) / cells - 0.5
                p, q = _mean_of_print(u + a * xx + b * xy, v + a * yx + b * yy, wide, high, table.black[k])
                sum_paper += p
                sum_ink += q
        paper = min(paper + sum_paper / cells**2, 1.0)
        ink = min(ink + sum_ink / cells**2, 1.0)
    return np.float32(paper), np.float32(ink)


@njit(cache=True, error_model="numpy", parallel=True)
def _paint(eye, rays, dx, dy, t, thing, cells, table, paper, ink):  # type: ignore[no-untyped-def]
    for i in prange(len(t)):
        if thing[i] >= 0:
            paper[i], ink[i] = _print_seen(eye, rays[i], dx[i], dy[i], t[i], thing[i], cells, table)


# ---------------------------------------------------------------- compiled loops: edges, shadows, light


def turned(rays_ccs: ArrayF32, R_wcs_ccs: ArrayF) -> ArrayF32:
    """Rays (n, 3) in wcs."""
    out = np.empty_like(rays_ccs)
    _turned(rays_ccs, np.ascontiguousarray(R_wcs_ccs), out)
    return out


def edges(
    eye: ArrayF, rays: ArrayF32, t_m: ArrayF32, primitive: ArrayI, thing: ArrayI, normal: ArrayF32
) -> ArrayB:
    """Pixels (h, w) that meet another surface than a neighbour does.

    Parameters
    ----------
    eye : (3,) projection centre.
    rays : (h, w, 3) directions.
    t_m : (h, w) distances.
    primitive : (h, w) triangles, -1 for none.
    thing : (m,) thing of each triangle.
    normal : (m, 3) of each triangle.
    """
    out = np.zeros(t_m.shape, dtype=np.bool_)
    _edges(eye, rays, t_m, primitive, thing, normal, out)
    return out


def unlike_corners(state: ArrayU8, primitive: ArrayI, thing: ArrayI, step: int) -> tuple[ArrayU8, ArrayB]:
    """Shadow of all pixels from that of some, and which pixels need a ray of their own.

    Parameters
    ----------
    state : (a, b) 0 shade, 1 sun, 2 nothing met: of each ``step``-th pixel in each direction.
    primitive : (h, w) triangle of each pixel, -1 for none.
    thing : (m,) thing of each triangle.
    step : between known pixels.
    """
    out = np.zeros(primitive.shape, dtype=np.uint8)
    open_ = np.zeros(primitive.shape, dtype=np.bool_)
    _unlike(state, primitive, thing, step, out, open_)
    return out, open_


def changes(grid: ArrayF32, pixels: ArrayI) -> tuple[ArrayF32, ArrayF32]:
    """Change (n, 3) of the ray over each pixel, across and down, from its neighbours in a grid (h, w, 3)."""
    across, down = (np.empty((len(pixels), 3), dtype=np.float32) for _ in range(2))
    _changes(grid, pixels, across, down)
    return across, down


@njit(cache=True, error_model="numpy", parallel=True)
def _changes(grid, pixels, across, down):  # type: ignore[no-untyped-def]
    h, w, _ = grid.shape
    for i in prange(len(pixels)):
        y, x = pixels[i] // w, pixels[i] % w
        x0, x1, y0, y1 = max(x - 1, 0), min(x + 1, w - 1), max(y - 1, 0), min(y + 1, h - 1)
        for k in range(3):
            a = (grid[y, x1, k] - grid[y, x0, k]) / np.float32(x1 - x0)
            b = (grid[y1, x, k] - grid[y0, x, k]) / np.float32(y1 - y0)
            # At the rim of an image circle one neighbour has no ray.
            across[i, k] = 0.0 if np.isnan(a) else a
            down[i, k] = 0.0 if np.isnan(b) else b


@njit(cache=True, error_model="numpy", parallel=True)
def _faces_sun(rays, primitive, normal, sun, side):  # type: ignore[no-untyped-def]
    """Whether the side (n,) of met triangles that the viewer sees is turned to the sun."""
    for i in prange(len(rays)):
        n = normal[primitive[i]]
        facing = n[0] * rays[i, 0] + n[1] * rays[i, 1] + n[2] * rays[i, 2]
        lit = n[0] * sun[0] + n[1] * sun[1] + n[2] * sun[2]
        side[i] = lit < 0.0 if facing > 0.0 else lit > 0.0


@njit(cache=True, error_model="numpy", parallel=True)
def _rays_to_sun(  # type: ignore[no-untyped-def]
    eye, rays, dx, dy, t, primitive, index, places, normal, sun, right, up, toward, start, way
):
    """Rays from ``places`` in each pixel to points of the sun's disc, one sector of it for each place."""
    count = len(places)
    for j in prange(len(toward)):
        i = toward[j]
        n = normal[primitive[i]]
        facing = n[0] * rays[i, 0] + n[1] * rays[i, 1] + n[2] * rays[i, 2]
        lift = -_LIFT_M if facing > 0.0 else _LIFT_M
        for k in range(count):
            a, b = places[k, 0], places[k, 1]
            # The same plane, met by a ray through another place of the pixel.
            x = rays[i, 0] + a * dx[i, 0] + b * dy[i, 0]
            y = rays[i, 1] + a * dx[i, 1] + b * dy[i, 1]
            z = rays[i, 2] + a * dx[i, 2] + b * dy[i, 2]
            way_m = t[i] * min(max(facing / (n[0] * x + n[1] * y + n[2] * z), 0.9), 1.1)
            start[j, k, 0] = eye[0] + way_m * x + lift * n[0]
            start[j, k, 1] = eye[1] + way_m * y + lift * n[1]
            start[j, k, 2] = eye[2] + way_m * z + lift * n[2]
            turn = 2 * np.pi * (k + chance_of(index[i], 2 * k + 1)) / count
            out = HAZY_SUN_RAD * np.sqrt(chance_of(index[i], 2 * k + 2))
            c, s = out * np.cos(turn), out * np.sin(turn)
            for axis in range(3):
                way[j, k, axis] = sun[axis] + c * right[axis] + s * up[axis]


@njit(cache=True, error_model="numpy", parallel=True)
def surface_light(  # type: ignore[no-untyped-def]
    eye,
    rays,
    dx,
    dy,
    t,
    primitive,
    sunlit,
    size,
    cells,
    normals,
    things,
    looks,
    table,
    sky,
    sun,
    sun_colour,
    out,
):
    """Light (n, 3) from matt surfaces that rays (n, 3) meet at distances and triangles (n,)."""
    for i in prange(len(rays)):
        f = primitive[i]
        what = things[f]
        nx, ny, nz = normals[f, 0], normals[f, 1], normals[f, 2]
        slant = nx * rays[i, 0] + ny * rays[i, 1] + nz * rays[i, 2]
        if slant > 0.0:
            nx, ny, nz = -nx, -ny, -nz
        stretch = np.float32(1.0) / np.sqrt(max(abs(slant), np.float32(0.02)))
        # Single precision, because the borders of planks and joints lie where it rounds them to.
        x, y, z = (
            np.float32(eye[0] + np.float64(t[i]) * rays[i, 0]),
            np.float32(eye[1] + np.float64(t[i]) * rays[i, 1]),
            np.float32(eye[2] + np.float64(t[i]) * rays[i, 2]),
        )
        colour = _albedo(x, y, z, nx, ny, looks[what], t[i] * size * stretch, stretch)
        paper, ink = _print_seen(eye, rays[i], dx[i], dy[i], np.float64(t[i]), what, cells, table)
        facing = nx * sun[0] + ny * sun[1] + nz * sun[2]
        direct = max(facing, 0.0) * sunlit[i]
        open_sky = _open_sky(x, y, z, looks[what], sky)
        up = 0.5 + 0.5 * nz
        for k in range(3):
            share = colour[k] * (1 - paper) + (paper - ink) * PAPER + ink * INK
            around = open_sky * (up * SKY_COLOUR[k] + (1 - up) * GROUND_COLOUR[k])
            out[i, k] = share * (direct * sun_colour[k] + around)


@njit(cache=True, error_model="numpy")
def _open_sky(x, y, z, look, cells):  # type: ignore[no-untyped-def]
    """Share of the sky that is open: from the grid on the ground, a rule of thumb elsewhere."""
    if look != Look.GROUND or abs(z) >= 0.05:
        return 0.92 * (1.0 - 0.35 * np.exp(-max(z, 0.0) / 0.25))
    n = len(cells)
    u = min(max(x / _CELL_M + n / 2 - 0.5, 0.0), n - 1.001)
    v = min(max(y / _CELL_M + n / 2 - 0.5, 0.0), n - 1.001)
    i, j = int(u), int(v)
    a, b = u - i, v - j
    low = cells[j, i] * (1 - a) + cells[j, i + 1] * a
    high = cells[j + 1, i] * (1 - a) + cells[j + 1, i + 1] * a
    return low * (1 - b) + high * b


@njit(cache=True, error_model="numpy", parallel=True)
def _turned(rays, R, out):  # type: ignore[no-untyped-def]
    for i in prange(len(rays)):
        x, y, z = np.float64(rays[i, 0]), np.float64(rays[i, 1]), np.float64(rays[i, 2])
        for k in range(3):
            out[i, k] = R[k, 0] * x + R[k, 1] * y + R[k, 2] * z


@njit(cache=True, error_model="numpy", inline="always")
def _differ(eye, rays, t, primitive, thing, normal, y0, x0, y1, x1):  # type: ignore[no-untyped-def]
    a, b = primitive[y0, x0], primitive[y1, x1]
    if a == b:
        return False
    if a < 0 or b < 0 or thing[a] != thing[b]:
        return True
    alike = normal[a, 0] * normal[b, 0] + normal[a, 1] * normal[b, 1] + normal[a, 2] * normal[b, 2]
    if alike < 0.97:
        return True
    off, way = 0.0, 0.0
    for k in range(3):
        d = t[y1, x1] * rays[y1, x1, k] - t[y0, x0] * rays[y0, x0, k]
        off += d * normal[a, k]
        way += d * d
    return abs(off) > 0.001 + 0.25 * np.sqrt(way)


@njit(cache=True, error_model="numpy", parallel=True)
def _edges(eye, rays, t, primitive, thing, normal, out):  # type: ignore[no-untyped-def]
    h, w = t.shape
    for y in prange(h):
        for x in range(w):
            found = False
            if x + 1 < w:
                found = _differ(eye, rays, t, primitive, thing, normal, y, x, y, x + 1)
            if not found and x > 0:
                found = _differ(eye, rays, t, primitive, thing, normal, y, x, y, x - 1)
            if not found and y + 1 < h:
                found = _differ(eye, rays, t, primitive, thing, normal, y, x, y + 1, x)
            if not found and y > 0:
                found = _differ(eye, rays, t, primitive, thing, normal, y, x, y - 1, x)
            out[y, x] = found


@njit(cache=True, error_model="numpy", parallel=True)
def _unlike(state, primitive, thing, step, out, open_):  # type: ignore[no-untyped-def]
    h, w = primitive.shape
    rows, columns = state.shape
    for y in prange(h):
        for x in range(w):
            p = primitive[y, x]
            if p < 0:
                continue
            j, i = y // step, x // step
            j1 = min(j + 1, rows - 1) if y % step else j
            i1 = min(i + 1, columns - 1) if x % step else i
            s = state[j, i]
            same = s != 2 and state[j, i1] == s and state[j1, i] == s and state[j1, i1] == s
            if same:
                for a in (j, j1):
                    for b in (i, i1):
                        q = primitive[a * step, b * step]
                        same = same and q >= 0 and thing[q] == thing[p]
            if same:
                out[y, x] = s
            else:
                open_[y, x] = True


# ---------------------------------------------------------------- colours of the yard and of the sky
#
# Procedural and fixed in place; a detail fades out where its spacing comes down to what a pixel covers.


class Look(IntEnum):
    """How the surface of a thing looks."""

    GROUND = 0
    FENCE = 1
    CONE = 2
    BOARD = 3
    POST = 4
    PERSON = 5
    BOAT = 6
    METAL = 7
    SENSOR = 8


_LOOKS: Final = {
    "ground": Look.GROUND,
    "fence": Look.FENCE,
    "posts": Look.POST,
    "person": Look.PERSON,
    "boat": Look.BOAT,
    "trolley": Look.METAL,
    "sensors": Look.SENSOR,
}


def appearance_of(name: str) -> Look:
    """Look of a thing by its name: ``ground``, ``C1``, ``board 64`` and so on."""
    if name in _LOOKS:
        return _LOOKS[name]
    return Look.CONE if name[:1] == "C" and name[1:].isdigit() else Look.BOARD


@lru_cache(maxsize=1)  # pictures of a yard are taken under one sky
def panorama(sun: Sun) -> ArrayF32:
    """The sky with its clouds (512, 2048, 3) as linear light, not to be written to.

    Rows run from the nadir to the zenith, columns counter-clockwise from east.
    """
    rows, columns = _PANORAMA
    elevation = ((np.arange(rows) + 0.5) / rows - 0.5) * np.pi
    azimuth = (np.arange(columns) + 0.5) / columns * 2 * np.pi
    el, az = (a.ravel() for a in np.meshgrid(elevation, azimuth, indexing="ij"))
    way = np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)], axis=1)
    light = np.minimum(sky(way, sun, cover=0.55), 6.0)
    return np.ascontiguousarray(light.reshape(rows, columns, 3), dtype=np.float32)


def surroundings(rays_wcs: ArrayF32, sky_map: ArrayF32, sun: Sun, size_rad: float) -> ArrayF32:
    """Light (n, 3) from where rays meet nothing: sky, and trees behind the fence that stand far away.

    Parameters
    ----------
    rays_wcs : (n, 3) directions.
    sky_map : from `panorama`.
    sun : lights the trees.
    size_rad : angle of a pixel.
    """
    out = np.empty_like(rays_wcs)
    _surroundings(rays_wcs, sky_map, sun.direction_wcs, size_rad, out)
    return out


@njit(cache=True, error_model="numpy")
def _line(place, spacing, wide, footprint):  # type: ignore[no-untyped-def]
    """Share of a dark joint that repeats at a spacing in what a pixel covers."""
    off = abs(place / spacing - np.floor(place / spacing + 0.5)) * spacing
    reach = max(wide, footprint)
    return (wide / reach) * min(max((0.5 * (reach + wide) - off) / reach, 0.0), 1.0)


@njit(cache=True, error_model="numpy")
def _albedo(x, y, z, nx, ny, what, footprint, stretch):  # type: ignore[no-untyped-def]
    """Share of light that a surface reflects without the sheets on it, linear RGB.

    ``footprint`` is the mean side of what a pixel covers there, ``stretch`` the longer one over it.
    """
    x, y, z, foot = np.float64(x), np.float64(y), np.float64(z), max(np.float64(footprint), 1e-6)
    g = _GRAIN[what]
    seed = 50 + 17 * what
    # Planks and stretched grain run upwards.
    squeeze = 0.12 if what == 1 or what == 4 else 1.0
    total, spacing, part = 0.0, g[0], 1.0
    for octave in range(4):
        seen = seen_share(spacing, foot)
        if seen <= 0.0:
            break
        # Every other octave is turned, so that the lattices do not show.
        px, py = (x, y) if octave % 2 == 0 else (0.8 * x + 0.6 * y, -0.6 * x + 0.8 * y)
        total += seen * part * noise_at(px / spacing, py / spacing, z * squeeze / spacing, seed + octave)
        part *= 0.75
        spacing *= 0.45
    bright = 1.0 + g[1] * total
    broad = noise_at(x / 1.9, y / 1.9, z / 1.9, seed + 9) + 0.6 * noise_at(
        x / 0.6, y / 0.6, z / 0.6, seed + 10
    )
    bright += g[2] * broad
    seen = seen_share(g[4], foot)
    if seen > 0.0:
        bright += g[3] * seen * noise_at(x / g[4], y / g[4], z * squeeze / g[4], seed + 11)
    warm = 0.03 * broad
    if what == 0:
        # Joints of the paving, patches of another age, and spots of oil.
        long = foot * stretch
        joint = max(_line(x + 0.35, 3.1, 0.012, long), _line(y - 0.6, 4.3, 0.012, long))
        bright *= 1.0 - 0.55 * joint
        oil = noise_at(x / 0.45, y / 0.45, 3.7, seed + 12)
        bright *= 1.0 - 0.35 * min(max(4.0 * (oil - 0.62), 0.0), 1.0)
        seen = seen_share(0.02, foot)
        if seen > 0.0:
            stone = noise_at(x / 0.02, y / 0.02, 0.3, seed + 13)
            bright += seen * 0.55 * min(max(4.0 * (stone - 0.60), 0.0), 1.0)
    elif what == 1:
        flat = np.sqrt(nx**2 + ny**2)
        if flat > 0.5:
            along = (nx * y - ny * x) / flat
            plank = np.int64(np.floor(along / 0.14))
            bright *= 0.82 + 0.36 * mixed(plank, np.int64(10 * nx), 1, seed)
            bright *= 1.0 - 0.75 * _line(along, 0.14, 0.008, foot)
            bright *= 1.0 - 0.5 * (_line(z - 0.4, 100.0, 0.07, foot) + _line(z - 1.9, 100.0, 0.07, foot))
    bright = max(bright, 0.15)
    c = _COLOUR[what]
    return (
        np.float32(min(c[0] * bright * (1 + warm), 0.95)),
        np.float32(min(c[1] * bright, 0.95)),
        np.float32(min(c[2] * bright * (1 - warm), 0.95)),
    )


@njit(cache=True, error_model="numpy")
def _octaves(x, y, z, spacing, gain, count, footprint, seed):  # type: ignore[no-untyped-def]
    total, part = 0.0, 1.0
    for octave in range(count):
        seen = seen_share(spacing, footprint)
        if seen <= 0.0:
            break
        total += seen * part * noise_at(x / spacing, y / spacing, z / spacing, seed + octave)
        part *= gain
        spacing *= 0.5
    return total


@njit(cache=True, error_model="numpy", parallel=True)
def _surroundings(rays, panorama, sun, size, out):  # type: ignore[no-untyped-def]
    rows, columns = panorama.shape[0], panorama.shape[1]
    for i in prange(len(rays)):
        x, y = np.float64(rays[i, 0]), np.float64(rays[i, 1])
        z = min(max(np.float64(rays[i, 2]), -1.0), 1.0)
        high = np.arcsin(z)
        flat = max(np.sqrt(x * x + y * y), 1e-9)
        v = min(max((high / np.pi + 0.5) * rows - 0.5, 0.0), rows - 1.001)
        u = np.arctan2(y, x) / (2 * np.pi) * columns - 0.5
        u -= np.floor(u / columns) * columns
        j, k = np.int64(v), np.int64(u)
        b, a = v - j, u - k
        k, k1 = k % columns, (k + 1) % columns
        for c in range(3):
            below = panorama[j, k, c] * (1 - a) + panorama[j, k1, c] * a
            above = panorama[j + 1, k, c] * (1 - a) + panorama[j + 1, k1, c] * a
            out[i, c] = below * (1 - b) + above * b
        if high > 0.45:
            continue
        # Crowns: broad ones, then branches, then leaves at their rim.
        crown = 0.19 + 0.08 * _octaves(x / flat, y / flat, 0.0, 0.45, 0.5, 2, size, 31)
        crown += 0.022 * _octaves(x, y, z, 0.05, 0.8, 5, size, 33)
        cover = min(max(0.5 + (crown - high) / (0.6 * size + 0.0015), 0.0), 1.0)
        if cover <= 0.0:
            continue
        leaves = _octaves(x, y, z, 0.035, 0.85, 6, size, 40)
        clump = _octaves(x, y, z, 0.11, 0.6, 2, size, 50)
        facing = 0.5 - 0.5 * (x * sun[0] + y * sun[1]) / flat
        bright = max((0.45 + 0.75 * facing) * (1.0 + 0.55 * clump + 0.45 * leaves), 0.06)
        warm = 0.5 + 0.5 * clump
        for c in range(3):
            tree = bright * (0.070 + 0.045 * warm if c == 0 else (0.115 + 0.025 * warm if c == 1 else 0.040))
            out[i, c] += cover * (1.5 * tree - out[i, c])
