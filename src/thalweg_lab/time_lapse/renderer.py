"""The light in each pixel of an image of the reach: land with its own texture, moving water, sky, own boat.

Each pixel's ray is that of the true lens, so that no image is resampled. One ray a pixel is enough where it
and its neighbours meet the same thing, because all textures fade out at the size of a pixel; where something
ends, several rays are averaged, and sixteen on the boards.
"""

from dataclasses import dataclass
from typing import Final

import numba as nb
import numpy as np

from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayF, ArrayF32, ArrayI, ArrayU8
from thalweg_lab.river.materials import Material
from thalweg_lab.river.shading import MURK, fresnel, mirrored
from thalweg_lab.river.waves import Waves
from thalweg_lab.river_images.appearance import surface_look
from thalweg_lab.river_images.daylight import HAZE
from thalweg_lab.time_lapse.land_kernels import (
    classify,
    detail,
    edge_parts,
    meet,
    paint_boards,
    shade,
)
from thalweg_lab.time_lapse.own_boat import OwnBoat
from thalweg_lab.time_lapse.sky_kernels import mean_sky, sky_light
from thalweg_lab.time_lapse.targets import RIM
from thalweg_lab.time_lapse.world import THIN, World
from thalweg_lab.yard_images.lens_rays import LensRays
from thalweg_lab.yard_images.render_kernels import turned

# ---------------------------------------------------------------- rays that meet the water: where they go,
# and how much of the light comes by reflection


# Open3D brings an old TBB into the process, which numba would try first and complain about.
nb.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]

_INDEX: Final = 1.333


def mirror_rays(
    eye_wcs_m: ArrayF,
    rays_wcs: ArrayF32,
    way_m: ArrayF32,
    waves: Waves | None,
    *,
    t_s: float,
    size_rad: float,
    grain: int,
) -> tuple[ArrayF, ArrayF32, ArrayF32]:
    """Rays after the water.

    Parameters
    ----------
    eye_wcs_m : (3,) where the rays come from.
    rays_wcs : (n, 3) unit vectors.
    way_m : (n,) to the level water.
    waves : of the water; None: a mirror.
    t_s : time for the waves.
    size_rad : angle of a ray's cone; waves shorter than its spot become chance, one facet a ray.
    grain : number of the picture, so that this chance is another one in each.

    Returns
    -------
    points_wcs_m : (n, 3) on the water.
    back_wcs : (n, 3) directions of what is mirrored, upwards.
    share : (n,) reflected share of the light (Fresnel, unpolarised).
    """
    n = len(rays_wcs)
    points, back, share = np.empty((n, 3)), np.empty((n, 3), dtype=np.float32), np.empty(n, dtype=np.float32)
    if waves is None:
        table = (np.zeros(0),) * 5
    else:
        table = (
            waves.amplitude_m,
            waves.k_east_radpm,
            waves.k_north_radpm,
            waves.omega_radps,
            waves.phase_rad,
        )
    _mirror(eye_wcs_m, rays_wcs, way_m, *table, t_s, size_rad, grain, _INDEX, points, back, share)
    return points, back, share


@nb.njit(cache=True, error_model="numpy")
def _chance(i, grain, stream):  # type: ignore[no-untyped-def]
    """A number in [0, 1) that belongs to a ray of a picture."""
    h = np.uint64(i) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(grain) * np.uint64(0xC2B2AE3D27D4EB4F)
    h += np.uint64(stream) * np.uint64(0x165667B19E3779F9)
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    h ^= h >> np.uint64(31)
    return np.float64(h >> np.uint64(11)) * 2.0**-53


@nb.njit(cache=True, error_model="numpy", parallel=True)
def _mirror(  # type: ignore[no-untyped-def]
    eye, rays, way, amplitude, k_east, k_north, omega, phase, t, size, grain, index, points, back, share
):  # fmt: skip
    for i in nb.prange(len(rays)):
        dx, dy, dz = np.float64(rays[i, 0]), np.float64(rays[i, 1]), np.float64(rays[i, 2])
        x, y = eye[0] + way[i] * dx, eye[1] + way[i] * dy
        points[i, 0], points[i, 1], points[i, 2] = x, y, eye[2] + way[i] * dz
        footprint = way[i] * size / np.sqrt(max(-dz, 0.01))
        east, north, hidden = 0.0, 0.0, 0.0
        for j in range(len(amplitude)):
            k2 = k_east[j] * k_east[j] + k_north[j] * k_north[j]
            seen = min(max(np.pi / np.sqrt(k2) / max(footprint, 1e-9) - 1.0, 0.0), 1.0)
            hidden += amplitude[j] * amplitude[j] * k2 * 0.5 * (1.0 - seen * seen)
            if seen > 0.0:
                angle = k_east[j] * x + k_north[j] * y - omega[j] * t + phase[j]
                wave = -seen * amplitude[j] * np.sin(angle)
                east += wave * k_east[j]
                north += wave * k_north[j]
        if hidden > 0.0:
            # Of the waves that are too short for the pixel the ray meets one facet.
            radius = np.sqrt(-np.log(1.0 - _chance(i, grain, 1)) * hidden)
            turn = 2 * np.pi * _chance(i, grain, 2)
            east += radius * np.cos(turn)
            north += radius * np.sin(turn)
        scale = 1.0 / np.sqrt(1.0 + east * east + north * north)
        nx, ny, nz = -east * scale, -north * scale, scale
        c = max(-(dx * nx + dy * ny + dz * nz), 0.02)
        bx, by, bz = dx + 2 * c * nx, dy + 2 * c * ny, dz + 2 * c * nz
        # A facet that would send the ray down is hidden behind its neighbour: the ray leaves upwards.
        bz = max(abs(bz), 0.004)
        length = np.sqrt(bx * bx + by * by + bz * bz)
        back[i, 0], back[i, 1], back[i, 2] = bx / length, by / length, bz / length
        inside = np.sqrt(1.0 - (1.0 - c * c) / (index * index))
        across = (c - index * inside) / (c + index * inside)
        within = (index * c - inside) / (index * c + inside)
        share[i] = 0.5 * (across * across + within * within)


# ---------------------------------------------------------------- renderer


COVER: Final = 0.4
"""Share of clouds in the sky."""

VISIBILITY_M: Final = 900.0
"""Way through air after which 1/e of the light is left."""

WHITE: Final = 0.80
BLACK: Final = 0.045
"""Albedo of the paint of the boards."""

PRINT_PARTS: Final = 4
"""Rays along each side of a pixel on boards."""

_LONG: Final = 9
_LONG_PARTS: Final = 4
"""Ground at a flat angle is divided along the view only, into so many rays."""

_RAYS_AT_A_TIME: Final = 600_000
_BLUR_OF_MIRROR: Final = 0.02
"""Waves blur what they mirror: its detail fades out at this share of its distance from the water."""

_GRAIN: Final = {
    Material.BED: 0.8, Material.SOIL: 0.85, Material.GRASS: 0.9, Material.STONE: 0.7, Material.GRAVEL: 0.9,
    Material.BARK: 0.6, Material.WALL: 0.3, Material.CONCRETE: 0.4, Material.ROOF: 0.55, Material.WOOD: 0.4,
}  # fmt: skip
"""Contrast of the finest grain of a material that is seen from far."""


class Renderer:
    """Sees one world through one lens.

    Parameters
    ----------
    world : land and boards.
    lens : ray of each pixel.
    waves : of the water; None: a mirror.
    boat : what is seen of the own boat; None: nothing.
    clouds, glare : whether there are clouds, and the sun's own light in sky and water.
    supersampling : rays along each side of a pixel in which something ends.
    """

    def __init__(
        self,
        world: World,
        lens: LensRays,
        *,
        waves: Waves | None,
        boat: OwnBoat | None,
        clouds: bool = True,
        glare: bool = True,
        supersampling: int = 2,
    ) -> None:
        self.world, self.lens, self.boat = world, lens, boat
        self._waves, self._glare = waves, glare
        self._cover = COVER if clouds else 0.0
        self._parts = supersampling
        self._grain = np.array([_GRAIN.get(m, 0.0) for m in Material])
        sun = world.sun
        self._mean_sky = mean_sky(sun)
        self._murk = (0.9 * MURK * (sun.colour * np.sin(sun.elevation_rad) + 0.5)).astype(np.float32)

    def see(self, T_wcs_ccs: Rigid, R_wcs_ics: ArrayF, *, t_s: float, grain: int) -> ArrayF32:
        """Linear light (h, w, 3), the mean over each pixel.

        Parameters
        ----------
        T_wcs_ccs : pose of the camera.
        R_wcs_ics : (3, 3) attitude of the boat.
        t_s : time for waves and clouds.
        grain : number of the picture; chance of the water's smallest waves.
        """
        h, w, _ = self.lens.rays_ccs.shape
        eye, size = T_wcs_ccs.shift_m, self.lens.size_rad
        rays = turned(self.lens.rays_ccs.reshape(-1, 3), T_wcs_ccs.R)
        # Pixels without a ray (fisheye) or behind the own boat stay dark.
        hidden = ~np.isfinite(rays[:, 0]) if self.boat is None else self.boat.full.ravel()
        open_ = np.flatnonzero(~hidden)
        seen = self._first(eye, rays[open_])
        parts = self._edges(seen, open_, (h, w))
        light = np.zeros((h * w, 3), dtype=np.float32)
        single = np.flatnonzero(parts[open_] == 1)
        light[open_[single]] = self._shaded(eye, seen.only(single), size, t_s, grain)
        for kind in sorted({self._parts, PRINT_PARTS, _LONG} - {1}):
            across, down = (1, _LONG_PARTS) if kind == _LONG else (kind, kind)
            some, step = np.flatnonzero((parts == kind) & ~hidden), _RAYS_AT_A_TIME // (across * down)
            for begin in range(0, len(some), step):
                pixels = some[begin : begin + step]
                divided = self._first(eye, _subrays(rays.reshape(h, w, 3), pixels, across, down))
                fine = self._shaded(
                    eye, divided, size / across, t_s, grain + (kind << 20), flat=across / down
                )
                light[pixels] = fine.reshape(len(pixels), across * down, 3).mean(axis=1)
        picture = np.asarray(light.reshape(h, w, 3))
        if self.boat is None:
            return picture
        return self.boat.over(picture, R_wcs_ics, self.world.sun, self._mean_sky)

    def _first(self, eye: ArrayF, rays: ArrayF32) -> "_Seen":
        hits = self.world.caster.cast(eye, rays)
        way, kind = np.empty(len(rays), dtype=np.float32), np.empty(len(rays), dtype=np.uint8)
        classify(float(eye[2]), self.world.level_m, rays, hits.t_hit_m, hits.primitive, way, kind)
        return _Seen(rays, way, kind, hits.primitive, hits.uv, hits.normal)

    def _edges(self, seen: "_Seen", open_: ArrayI, shape: tuple[int, int]) -> ArrayU8:
        """Rays along each side of each pixel (h * w,)."""
        n = shape[0] * shape[1]
        kind, primitive = np.full(n, 3, dtype=np.uint8), np.full(n, -1, dtype=np.int64)
        way, out = np.full(n, np.inf, dtype=np.float32), np.empty(n, dtype=np.uint8)
        kind[open_], primitive[open_], way[open_] = seen.kind, seen.primitive, seen.way
        ray, normal = np.zeros((n, 3), dtype=np.float32), np.zeros((n, 3), dtype=np.float32)
        ray[open_], normal[open_] = seen.rays, seen.normal
        grids = (a.reshape(shape) for a in (kind, primitive, way))
        deep = (a.reshape(*shape, 3) for a in (ray, normal))
        edge_parts(
            *grids, *deep, self.world.thin, self.world.board, self._parts, PRINT_PARTS,
            1 if self._parts == 1 else _LONG, out.reshape(shape),
        )  # fmt: skip
        return out

    def _shaded(
        self, eye: ArrayF, seen: "_Seen", size_rad: float, t_s: float, grain: int, *, flat: float = 1.0
    ) -> ArrayF32:
        light = np.empty_like(seen.rays)
        land, wet, high = (np.flatnonzero(seen.kind == k) for k in (2, 1, 0))
        light[land] = self._land(eye[None], seen.only(land), size_rad, flat=flat)
        if len(wet):
            light[wet] = self._water(eye, seen.only(wet), size_rad, t_s, grain)
        light[high] = self._sky(seen.rays[high], t_s)
        return light

    def _sky(self, rays: ArrayF32, t_s: float) -> ArrayF32:
        return sky_light(rays, self.world.sun, cover=self._cover, t_s=t_s, glare=self._glare)

    def _water(self, eye: ArrayF, seen: "_Seen", size_rad: float, t_s: float, grain: int) -> ArrayF32:
        points, back, share = mirror_rays(
            eye, seen.rays, seen.way, self._waves, t_s=t_s, size_rad=size_rad, grain=grain
        )
        hits = self.world.caster.cast(points, back)
        met = np.flatnonzero(hits.primitive >= 0)
        miss = np.flatnonzero(hits.primitive < 0)
        light = np.empty_like(seen.rays)
        light[miss] = self._sky(back[miss], t_s)
        again = _Seen(
            back[met], hits.t_hit_m[met].astype(np.float32), seen.kind[met], hits.primitive[met],
            hits.uv[met], hits.normal[met],
        )  # fmt: skip
        light[met] = self._land(points[met], again, size_rad, mirror=True)
        light = share[:, None] * light + (1 - share)[:, None] * self._murk
        left = np.exp(-seen.way / np.float32(VISIBILITY_M))[:, None]
        return np.asarray(light * left + HAZE.astype(np.float32) * (1 - left))

    def _land(
        self, origin: ArrayF, seen: "_Seen", size_rad: float, *, flat: float = 1.0, mirror: bool = False
    ) -> ArrayF32:
        """Light (n, 3) from land; in the water's mirror with blurred detail and shadows as of the corners."""
        world, n = self.world, len(seen.rays)
        world.light_up(seen.primitive)
        point, normal, start = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
        code, footprint = np.empty(n, dtype=np.int64), np.empty(n)
        light = np.empty((n, 4), dtype=np.float32)
        meet(
            origin, seen.rays, seen.way, seen.primitive, seen.uv, world.vertices, world.triangles,
            world.corner_normal, world.smooth, world.border, world.shares, world.grounds, world.material,
            world.corner_light, world.face_light, 2 * size_rad if mirror else size_rad, flat,
            _BLUR_OF_MIRROR if mirror else 0.0, point, normal, start, code, footprint, light,
        )  # fmt: skip
        colour, relief = surface_look(
            point, normal, code, world.variation[seen.primitive], footprint, water_level_m=world.level_m
        )
        sun = world.sun.direction_wcs
        if mirror:
            sunlit = light[:, 3]
        else:
            detail(point, code, footprint, self._grain, colour)
            sunlit = np.zeros(n, dtype=np.float32)
            toward = np.flatnonzero((relief @ sun > 0) | THIN[code])
            sunlit[toward] = world.sunlit(start[toward], normal[toward])
        targets = world.targets
        if targets is not None and len(targets.names):
            paint_boards(
                world.board, seen.primitive, point, targets.centre_wcs_m, targets.right_wcs, targets.size_m,
                RIM, WHITE, BLACK, colour,
            )  # fmt: skip
            # The prints are flat: the texture's relief belongs to what carries them.
            print_ = np.flatnonzero(world.board[seen.primitive] >= 0)
            relief[print_] = normal[print_]
        out = np.empty((n, 3), dtype=np.float32)
        haze = HAZE if not mirror else np.zeros(3)
        shade(
            colour, relief, normal, THIN, code, light, sunlit, sun, world.sun.colour, seen.way, haze,
            VISIBILITY_M if not mirror else np.inf, out,
        )  # fmt: skip
        panes = np.flatnonzero(code == Material.GLASS)
        if len(panes) and not mirror:
            ray = seen.rays[panes].astype(np.float64)
            share = 1.7 * fresnel(-np.sum(ray * normal[panes], axis=1), 1.52)[:, None]
            out[panes] += (share * self._sky(mirrored(ray, normal[panes]).astype(np.float32), 0.0)).astype(
                np.float32
            )
        return out


@dataclass(frozen=True, slots=True)
class _Seen:
    """Rays and what each met first: way, kind (0 sky, 1 water, 2 land), triangle, place in it, its normal."""

    rays: ArrayF32
    way: ArrayF32
    kind: ArrayU8
    primitive: ArrayI
    uv: ArrayF
    normal: ArrayF

    def only(self, which: ArrayI) -> "_Seen":
        """The hits of some rays."""
        return _Seen(
            self.rays[which], self.way[which], self.kind[which], self.primitive[which], self.uv[which],
            self.normal[which],
        )  # fmt: skip


def _subrays(grid: ArrayF32, pixels: ArrayI, across: int, along: int) -> ArrayF32:
    """Rays (n * across * along, 3) through a raster of places in each pixel, ``along`` of them down."""
    h, w, _ = grid.shape
    y, x = np.divmod(pixels, w)
    wide, high = (((np.arange(k) + 0.5) / k - 0.5).astype(np.float32) for k in (across, along))
    right = grid[y, np.minimum(x + 1, w - 1)] - grid[y, np.maximum(x - 1, 0)]
    right /= (np.minimum(x + 1, w - 1) - np.maximum(x - 1, 0)).astype(np.float32)[:, None]
    down = grid[np.minimum(y + 1, h - 1), x] - grid[np.maximum(y - 1, 0), x]
    down /= (np.minimum(y + 1, h - 1) - np.maximum(y - 1, 0)).astype(np.float32)[:, None]
    # At the rim of an image circle a neighbour has no ray.
    right, down = np.nan_to_num(right), np.nan_to_num(down)
    a, b = (o.ravel()[None, :, None] for o in np.meshgrid(wide, high))
    return np.ascontiguousarray((grid[y, x][:, None] + a * right[:, None] + b * down[:, None]).reshape(-1, 3))
