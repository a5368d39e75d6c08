"""Photographs of the yard: one ray a pixel, sixteen at silhouettes, exact prints, light of sun and sky.

Each pixel's ray is that of the true camera, so a lens of any model needs no resampling. The print of a sheet
is averaged over the pixel exactly (`sheet_paint`); at silhouettes 4 x 4 rays are averaged.
"""

from copy import copy
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from thalweg.core.geometry.raycast import RayCaster
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayF, ArrayF32, ArrayI
from thalweg_lab.river.shading import half_sphere, hash01
from thalweg_lab.river_images.daylight import Sun
from thalweg_lab.yard.yard import Yard
from thalweg_lab.yard_images.lens_rays import LensRays
from thalweg_lab.yard_images.render_kernels import (
    edges,
    surface_light,
    turned,
    unlike_corners,
)
from thalweg_lab.yard_images.sheet_paint import PaintTable
from thalweg_lab.yard_images.yard_look import INK, PAPER, Look, albedo, look_of, panorama, surroundings

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
_APART: Final = ((-0.5, -0.5), (0.5, 0.5))
"""Places in every second pixel that lie evenly apart from those of the next one."""
_WITHIN: Final = ((-0.25, -0.25), (0.25, -0.25), (0.25, 0.25), (-0.25, 0.25))
_LIFT_M: Final = 5e-4
_CELL_M: Final = 0.05
_SKY_RAYS: Final = 16


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
        self._look = np.array([look_of(name) for name in yard.names], dtype=np.int64)[yard.things]
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
            dx, dy = _changes(grid, some)
            light[some] = self._surface(
                eye, rays[some], dx, dy, t[some], primitive[some], sunlit[some], lens.size_rad, _PARTS
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

    def _facing(self, rays: ArrayF32, primitive: ArrayI) -> ArrayF32:
        """Normals (n, 3) of met triangles, toward the viewer."""
        normal = self._normal[primitive]
        away = np.einsum("ij,ij->i", normal, rays) > 0
        normal[away] *= -1
        return normal

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
                eye, rays[some], t[some], primitive[some], some, _APART, _changes(grid, some)
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
                eye, rays[some], t[some], primitive[some], some, _WITHIN, _changes(grid, some)
            )
        return sunlit

    def _in_sun(
        self,
        eye: ArrayF,
        rays: ArrayF32,
        t: ArrayF32,
        primitive: ArrayI,
        index: ArrayI,
        places: tuple[tuple[float, float], ...] = ((0.0, 0.0),),
        changes: tuple[ArrayF32, ArrayF32] | None = None,
    ) -> ArrayF32:
        """Share (n,) of the sun's disc that is seen from met surfaces, from some ``places`` in each pixel."""
        normal = self._facing(rays, primitive)
        sun = self.sun.direction_wcs
        toward = np.flatnonzero(normal @ sun.astype(np.float32) > 0)
        share = np.zeros(len(t), dtype=np.float32)
        normal, ray, count = normal[toward], rays[toward], len(places)
        facing = np.einsum("ij,ij->i", normal, ray)
        right = np.array([-sun[1], sun[0], 0.0]) / np.hypot(sun[0], sun[1])
        up = np.cross(sun, right)
        for k, (across, down) in enumerate(places):
            way_m, seen = t[toward], ray
            if changes is not None:
                # The same plane, met by a ray through another place of the pixel.
                seen = ray + np.float32(across) * changes[0][toward] + np.float32(down) * changes[1][toward]
                way_m = way_m * np.clip(facing / np.einsum("ij,ij->i", normal, seen), 0.9, 1.1)
            start = eye + way_m[:, None].astype(np.float64) * seen + _LIFT_M * normal
            turn = 2 * np.pi * (k + hash01(index[toward], 2 * k + 1)) / count
            out = HAZY_SUN_RAD * np.sqrt(hash01(index[toward], 2 * k + 2))
            way = sun + (out * np.cos(turn))[:, None] * right + (out * np.sin(turn))[:, None] * up
            share[toward] += np.isinf(self._caster.cast(start, way).t_hit_m).astype(np.float32) / count
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
        """Light (n, 3) from what rays met."""
        normal = self._facing(rays, primitive)
        points = (eye + t[:, None].astype(np.float64) * rays).astype(np.float32)
        slant = np.abs(np.einsum("ij,ij->i", normal, rays))
        stretch = 1.0 / np.sqrt(np.maximum(slant, np.float32(0.02)))
        footprint = t * np.float32(size_rad) * stretch
        look, thing = self._look[primitive], self.yard.things[primitive]
        colour = albedo(points, normal, look, footprint, stretch)
        if self.yard.colours is not None:
            given = self.yard.colours[thing].astype(np.float32)
            colour = np.where(np.isnan(given), colour, given)
        painted = np.flatnonzero(np.diff(self._table.first)[thing] > 0)
        paper, ink = self._table.paint(
            eye, rays[painted], dx[painted], dy[painted], t[painted].astype(np.float64), thing[painted], cells
        )
        print_ = (paper - ink) * np.float32(PAPER) + ink * np.float32(INK)
        colour[painted] = colour[painted] * (1 - paper)[:, None] + print_[:, None]
        return surface_light(
            colour, normal, sunlit, self._open_sky(points, normal, look), self.sun.direction_wcs,
            SUN_SHARE * self.sun.colour, SKY_COLOUR, GROUND_COLOUR,
        )  # fmt: skip

    def _divided(
        self, eye: ArrayF, grid: ArrayF32, rays: ArrayF32, pixels: ArrayI, size_rad: float
    ) -> ArrayF32:
        """Light (n, 3) of pixels at silhouettes: the mean of 4 x 4 rays."""
        dx, dy = _changes(grid, pixels)
        off = (np.arange(_PARTS) + 0.5) / _PARTS - 0.5
        a, b = (o.ravel().astype(np.float32) for o in np.meshgrid(off, off))
        some = rays[pixels][:, None] + a[:, None] * dx[:, None] + b[:, None] * dy[:, None]
        some = np.ascontiguousarray(some.reshape(-1, 3))
        t, primitive = self._cast(eye, some)
        light = np.zeros_like(some)
        miss, met = np.flatnonzero(primitive < 0), np.flatnonzero(primitive >= 0)
        light[miss] = surroundings(some[miss], self._panorama, self.sun, size_rad / _PARTS)
        index = np.repeat(pixels, _PARTS**2) * _PARTS**2 + np.tile(np.arange(_PARTS**2), len(pixels))
        sunlit = self._in_sun(eye, some[met], t[met], primitive[met], index[met])
        small = np.float32(1 / _PARTS)
        wide, high = (np.repeat(d * small, _PARTS**2, axis=0)[met] for d in (dx, dy))
        light[met] = self._surface(
            eye, some[met], wide, high, t[met], primitive[met], sunlit, size_rad / _PARTS, 1
        )
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
            share += np.isinf(self._caster.cast(start, way).t_hit_m)
        return share.reshape(n, n) / np.float32(_SKY_RAYS)

    def _open_sky(self, points: ArrayF32, normal: ArrayF32, look: ArrayI) -> ArrayF32:
        """Share (n,) of the sky that is open: from the grid on the ground, a rule of thumb elsewhere."""
        n = len(self._sky_cells)
        near = 1.0 - 0.35 * np.exp(-np.maximum(points[:, 2], 0) / 0.25)
        out = (0.92 * near).astype(np.float32)
        flat = np.flatnonzero((look == Look.GROUND) & (np.abs(points[:, 2]) < 0.05))
        v = np.clip(points[flat, :2] / np.float32(_CELL_M) + np.float32(n / 2 - 0.5), 0, n - 1.001)
        i = v.astype(np.int64)
        a = v - i
        cells = self._sky_cells
        low = cells[i[:, 1], i[:, 0]] * (1 - a[:, 0]) + cells[i[:, 1], i[:, 0] + 1] * a[:, 0]
        high = cells[i[:, 1] + 1, i[:, 0]] * (1 - a[:, 0]) + cells[i[:, 1] + 1, i[:, 0] + 1] * a[:, 0]
        out[flat] = low * (1 - a[:, 1]) + high * a[:, 1]
        return out


def _changes(grid: ArrayF32, pixels: ArrayI) -> tuple[ArrayF32, ArrayF32]:
    """Change (n, 3) of the ray over each pixel, across and down, from its neighbours."""
    h, w, _ = grid.shape
    y, x = np.divmod(pixels, w)
    changes = []
    for dy, dx in ((0, 1), (1, 0)):
        y0, y1 = np.maximum(y - dy, 0), np.minimum(y + dy, h - 1)
        x0, x1 = np.maximum(x - dx, 0), np.minimum(x + dx, w - 1)
        change = (grid[y1, x1] - grid[y0, x0]) / ((y1 - y0) + (x1 - x0)).astype(np.float32)[:, None]
        # At the rim of an image circle one neighbour has no ray.
        changes.append(np.nan_to_num(change))
    return changes[0], changes[1]
