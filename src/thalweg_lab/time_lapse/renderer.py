"""The light in each pixel of an image of the reach: land with its own texture, moving water, sky, own boat.

Each pixel's ray is that of the true lens, so that no image is resampled. One ray a pixel is enough where it
and its neighbours meet the same thing, because all textures fade out at the size of a pixel; where something
ends, several rays are averaged, and sixteen on the boards.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core import ArrayB, ArrayF, ArrayF32, ArrayI, ArrayU8, Rigid, njit, prange
from thalweg_lab.reach import chance_of, mixed, noise_at
from thalweg_lab.river import (
    BARE_GROUND,
    MURK,
    Material,
    Scene,
    Waves,
    corner_shares,
    fresnel,
    mirrored,
    vertex_normals,
)
from thalweg_lab.river_images import HAZE, Sun, surface_appearance
from thalweg_lab.time_lapse.foreground import RIM, OwnBoat, Targets
from thalweg_lab.yard_images import LensRays, changes, turned

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
_INDEX: Final = 1.333

LIFT_M: Final = 0.002
"""Rays to the light begin this far off a surface."""
THIN: Final[ArrayB] = np.isin(np.arange(len(Material)), [Material.LEAF, Material.REED, Material.BLADE])
"""Kinds that light passes through."""
_SMOOTH: Final = np.isin(
    np.arange(len(Material)),
    [Material.BED, Material.SOIL, Material.GRASS, Material.GRAVEL, Material.STONE, Material.BARK],
)
_RAYS_OF_CORNER: Final = 8
_RAYS_OF_FACE: Final = 4
_UNDER_WATER_M: Final = 0.3
_BAND: Final = 60_000
_GREY: Final = np.array([0.62, 0.64, 0.68])
"""Mean light of clouds, which even out and brighten what the clear sky gives."""
_LIKE_LAND: Final = np.array([0.20, 0.20, 0.12])
"""Light from land in the distance; what is near is as dark as the place itself."""

ZENITH = np.array([0.12, 0.27, 0.68])
"""Colour of the clear sky overhead."""


class World:
    """Land and boards of a reach in the light of one sun.

    Parameters
    ----------
    scene : the twin's world.
    targets : boards on the bank; None: none.
    sun : where the light comes from.
    """

    def __init__(self, scene: Scene, targets: Targets | None, sun: Sun) -> None:
        self.sun, self.level_m = sun, scene.water_level_m
        dry = scene.without(Material.WATER)
        # Nothing below the surface is seen, but the slopes of the margins close the ground at the water line.
        height = dry.vertices_wcs_m[dry.triangles, 2].max(axis=1)
        keep = height > scene.water_level_m - _UNDER_WATER_M
        vertices, triangles = dry.vertices_wcs_m, dry.triangles[keep]
        material, variation = dry.material[keep], dry.variation[keep]
        board = np.full(len(triangles), -1, dtype=np.int64)
        if targets is not None and len(targets.names):
            more, faces, numbers = targets.mesh()
            triangles = np.concatenate([triangles, faces + len(vertices)])
            vertices = np.concatenate([vertices, more])
            kind = np.where(numbers >= 0, int(Material.CONCRETE), int(Material.WOOD)).astype(np.uint8)
            material = np.concatenate([material, kind])
            variation = np.concatenate([variation, np.full(len(faces), 0.5, dtype=np.float32)])
            board = np.concatenate([board, numbers])
        self.vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        self.triangles = np.ascontiguousarray(triangles)
        self.material, self.variation, self.board = material, variation, board
        self.targets = targets
        self.thin = THIN[material]
        self.smooth = _SMOOTH[material]
        self.grounds = np.flatnonzero(BARE_GROUND).astype(np.uint8)
        self.shares = corner_shares(self.triangles, material, self.grounds, len(self.vertices))
        mixed = self.shares[self.triangles].max(axis=2).min(axis=1) < 0.999
        self.border = mixed & np.isin(material, self.grounds)
        self.corner_normal = vertex_normals(self.vertices, self.triangles[self.smooth])
        scene_with_boards = Scene(
            vertices_wcs_m=self.vertices,
            triangles=self.triangles,
            material=material,
            water_level_m=self.level_m,
            variation=variation,
        )
        self.caster = scene_with_boards.caster()
        self.corner_light = np.zeros((len(self.vertices), 4), dtype=np.float32)
        """Light of sky and surroundings in red, green and blue, and 1 where the sun shines, at corners."""
        self.face_light = np.zeros((len(self.triangles), 4), dtype=np.float32)
        """The same at the middle of triangles that are not smooth."""
        self._lit_corner = np.zeros(len(self.vertices), dtype=np.bool_)
        self._lit_face = np.zeros(len(self.triangles), dtype=np.bool_)

    def light_up(self, primitive: ArrayI) -> None:
        """Compute the light of all triangles (n,) that are met and have none yet."""
        corner, face = np.empty(3 * len(primitive), dtype=np.int64), np.empty(len(primitive), dtype=np.int64)
        corners, faces = claim_new(
            primitive, self.triangles, self.smooth, self._lit_corner, self._lit_face, corner, face
        )
        for begin in range(0, corners, _BAND):
            some = corner[begin : min(begin + _BAND, corners)]
            normal = self.corner_normal[some]
            self.corner_light[some] = self._light(self.vertices[some], normal, some, _RAYS_OF_CORNER)
        for begin in range(0, faces, _BAND):
            some = face[begin : min(begin + _BAND, faces)]
            a, b, c = (self.vertices[self.triangles[some, k]] for k in range(3))
            normal = np.cross(b - a, c - a)
            normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
            # Leaves have two sides: their light is that of the upper one.
            down = self.thin[some] & (normal[:, 2] < 0)
            normal[down] *= -1.0
            self.face_light[some] = self._light((a + b + c) / 3.0, normal, some, _RAYS_OF_FACE)

    def sunlit(self, start_wcs_m: ArrayF, normal_wcs: ArrayF) -> ArrayF32:
        """1 where the way (n,) from surfaces to the sun is free, 0 where not."""
        sun = self.sun.direction_wcs
        side = np.where(normal_wcs @ sun >= 0, LIFT_M, -LIFT_M)[:, None]
        way = np.broadcast_to(sun, normal_wcs.shape)
        return self.caster.free(start_wcs_m + side * normal_wcs, way).astype(np.float32)

    def _light(self, place: ArrayF, normal: ArrayF, index: ArrayI, rays: int) -> ArrayF32:
        n, sun = len(place), self.sun
        start = np.empty((n, rays + 1, 3))
        way, light = np.empty((n, rays + 1, 3), dtype=np.float32), np.empty((n, 4), dtype=np.float32)
        rays_to_sky(place, normal, index, 2 * LIFT_M, sun.direction_wcs, rays, start, way)
        t = self.caster.cast(start.reshape(-1, 3), way.reshape(-1, 3)).t_hit_m.reshape(n, rays + 1)
        gathered(way, t, sun.direction_wcs, sun.colour, HAZE, ZENITH, _GREY, _LIKE_LAND, light)
        return light


# ---------------------------------------------------------------- light in each pixel


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
            *grids,
            *deep,
            self.world.thin,
            self.world.board,
            self._parts,
            PRINT_PARTS,
            1 if self._parts == 1 else _LONG,
            out.reshape(shape),
        )
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
            back[met],
            hits.t_hit_m[met].astype(np.float32),
            seen.kind[met],
            hits.primitive[met],
            hits.uv[met],
            hits.normal[met],
        )
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
            origin,
            seen.rays,
            seen.way,
            seen.primitive,
            seen.uv,
            world.vertices,
            world.triangles,
            world.corner_normal,
            world.smooth,
            world.border,
            world.shares,
            world.grounds,
            world.material,
            world.corner_light,
            world.face_light,
            2 * size_rad if mirror else size_rad,
            flat,
            _BLUR_OF_MIRROR if mirror else 0.0,
            point,
            normal,
            start,
            code,
            footprint,
            light,
        )
        colour, relief = surface_appearance(
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
                world.board,
                seen.primitive,
                point,
                targets.centre_wcs_m,
                targets.right_wcs,
                targets.size_m,
                RIM,
                WHITE,
                BLACK,
                colour,
            )
            # The prints are flat: the texture's relief belongs to what carries them.
            print_ = np.flatnonzero(world.board[seen.primitive] >= 0)
            relief[print_] = normal[print_]
        out = np.empty((n, 3), dtype=np.float32)
        haze = HAZE if not mirror else np.zeros(3)
        shade(
            colour,
            relief,
            normal,
            THIN,
            code,
            light,
            sunlit,
            sun,
            world.sun.colour,
            seen.way,
            haze,
            VISIBILITY_M if not mirror else np.inf,
            out,
        )
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
            self.rays[which],
            self.way[which],
            self.kind[which],
            self.primitive[which],
            self.uv[which],
            self.normal[which],
        )


def _subrays(grid: ArrayF32, pixels: ArrayI, across: int, along: int) -> ArrayF32:
    """Rays (n * across * along, 3) through a raster of places in each pixel, ``along`` of them down."""
    wide, high = (((np.arange(k) + 0.5) / k - 0.5).astype(np.float32) for k in (across, along))
    right, down = changes(grid, pixels)
    a, b = (o.ravel()[None, :, None] for o in np.meshgrid(wide, high))
    rays = grid.reshape(-1, 3)[pixels][:, None] + a * right[:, None] + b * down[:, None]
    return np.ascontiguousarray(rays.reshape(-1, 3))


# ---------------------------------------------------------------- rays that meet the water: where they go,
# and how much of the light comes by reflection


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


@njit(cache=True, error_model="numpy")
def _chance_of_ray(i, grain, stream):  # type: ignore[no-untyped-def]
    """A number in [0, 1) that belongs to a ray of a picture."""
    h = np.uint64(i) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(grain) * np.uint64(0xC2B2AE3D27D4EB4F)
    h += np.uint64(stream) * np.uint64(0x165667B19E3779F9)
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    h ^= h >> np.uint64(31)
    return np.float64(h >> np.uint64(11)) * 2.0**-53


@njit(cache=True, error_model="numpy", parallel=True)
def _mirror(  # type: ignore[no-untyped-def]
    eye, rays, way, amplitude, k_east, k_north, omega, phase, t, size, grain, index, points, back, share
):
    for i in prange(len(rays)):
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
            radius = np.sqrt(-np.log(1.0 - _chance_of_ray(i, grain, 1)) * hidden)
            turn = 2 * np.pi * _chance_of_ray(i, grain, 2)
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


# ---------------------------------------------------------------- what the images show, ready for rays
#
# The light of a place does not depend on who looks at it: sky and surroundings reach a corner of the ground
# or a leaf by a few rays that belong to that corner or leaf. So it is computed once, when the first image
# shows the place, and any order of images gives the same.


# ---------------------------------------------------------------- loops over places that get their light:
# which are new, rays to their sky, and what these bring


@njit(cache=True, error_model="numpy")
def claim_new(primitive, triangles, smooth, lit_corner, lit_face, corner, face):  # type: ignore[no-untyped-def]
    """Numbers of corners and faces that are met and not lit yet; marks them as lit.

    ``corner`` and ``face`` have room for all; returns how many of them were filled.
    """
    corners, faces = 0, 0
    for i in range(len(primitive)):
        p = primitive[i]
        if smooth[p]:
            for k in range(3):
                v = triangles[p, k]
                if not lit_corner[v]:
                    lit_corner[v] = True
                    corner[corners] = v
                    corners += 1
        elif not lit_face[p]:
            lit_face[p] = True
            face[faces] = p
            faces += 1
    return corners, faces


@njit(cache=True, error_model="numpy", parallel=True)
def rays_to_sky(place, normal, index, lift, sun, rays, start, way):  # type: ignore[no-untyped-def]
    """Rays (n, rays + 1, 3) with a density of the cosine about normals (n, 3); the last one to the sun."""
    for i in prange(len(place)):
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        # Orthonormal frame without branches (Duff et al. 2017).
        sign = 1.0 if nz >= 0.0 else -1.0
        a = -1.0 / (sign + nz)
        b = nx * ny * a
        for k in range(rays + 1):
            for j in range(3):
                start[i, k, j] = place[i, j] + lift * normal[i, j]
            if k == rays:
                way[i, k, 0], way[i, k, 1], way[i, k, 2] = sun[0], sun[1], sun[2]
                continue
            turn = 2 * np.pi * (k + chance_of(index[i], 2 * k + 1)) / rays
            out = chance_of(index[i], 2 * k + 2)
            flat, high = np.sqrt(out), np.sqrt(1.0 - out)
            x, y = flat * np.cos(turn), flat * np.sin(turn)
            way[i, k, 0] = x * (1.0 + sign * nx * nx * a) + y * b + high * nx
            way[i, k, 1] = x * sign * b + y * (sign + ny * ny * a) + high * ny
            way[i, k, 2] = -x * sign * nx - y * ny + high * nz


@njit(cache=True, error_model="numpy", parallel=True)
def gathered(way, t_hit, sun, sun_colour, haze, zenith, grey, like_land, light):  # type: ignore[no-untyped-def]
    """Mean light (n, 3) that the rays of `rays_to_sky` bring, and in the fourth place whether the sun shines.

    The sky is that of `thalweg_lab.river_images.daylight.clear_sky`, half whitened by clouds; what is near
    is as dark as the place itself, what is far is lit like the land at large.
    """
    n, rays = t_hit.shape[0], t_hit.shape[1] - 1
    for i in prange(n):
        r, g, b = 0.0, 0.0, 0.0
        for k in range(rays):
            if t_hit[i, k] < np.inf:
                far = 1.0 - np.exp(-t_hit[i, k] / 0.6)
                r, g, b = r + far * like_land[0], g + far * like_land[1], b + far * like_land[2]
                continue
            up = np.float64(way[i, k, 2])
            low = np.exp(-4.6 * abs(up))
            angle = way[i, k, 0] * sun[0] + way[i, k, 1] * sun[1] + up * sun[2]
            glow = 0.16 * 0.30 * max(angle, 0.0) ** 6
            side = 0.88 + 0.12 * angle
            dim = 0.5 if up >= 0.0 else 0.15 * 0.35
            cloud = 0.5 if up >= 0.0 else 0.15
            r += (
                dim * ((zenith[0] + (haze[0] - zenith[0]) * low) * side + glow * sun_colour[0])
                + cloud * grey[0]
            )
            g += (
                dim * ((zenith[1] + (haze[1] - zenith[1]) * low) * side + glow * sun_colour[1])
                + cloud * grey[1]
            )
            b += (
                dim * ((zenith[2] + (haze[2] - zenith[2]) * low) * side + glow * sun_colour[2])
                + cloud * grey[2]
            )
        light[i, 0], light[i, 1], light[i, 2] = r / rays, g / rays, b / rays
        light[i, 3] = 0.0 if t_hit[i, rays] < np.inf else 1.0


# ---------------------------------------------------------------- compiled loops: rays that meet the land


@njit(cache=True, error_model="numpy", parallel=True)
def classify(eye_up, level, rays, t_land, primitive, way, kind):  # type: ignore[no-untyped-def]
    """Way (n,) to what each ray meets first and its kind: 0 sky, 1 water, 2 land."""
    for i in prange(len(rays)):
        dz = np.float64(rays[i, 2])
        water = (level - eye_up) / dz if dz < 0.0 else np.inf
        if primitive[i] >= 0 and t_land[i] <= water:
            way[i], kind[i] = t_land[i], 2
        elif water < np.inf:
            way[i], kind[i] = water, 1
        else:
            way[i], kind[i] = np.inf, 0


@njit(cache=True, error_model="numpy", parallel=True)
def edge_parts(kind, primitive, t, rays, normal, thin, board, plain, print_, long_, out):  # type: ignore[no-untyped-def]
    """How each pixel (h, w) is divided.

    ``plain`` where it and a neighbour meet different things, ``print_`` at boards, ``long_`` on ground that
    is seen at a flat angle, 1 elsewhere.
    """
    h, w = kind.shape
    for y in prange(h):
        for x in range(w):
            parts = 1
            p = primitive[y, x]
            if kind[y, x] == 2:
                if board[p] >= 0:
                    parts = print_
                else:
                    slant = 0.0
                    for k in range(3):
                        slant += normal[y, x, k] * rays[y, x, k]
                    if abs(slant) < 0.4 and not thin[p]:
                        parts = long_
            for step in range(4):
                j = y + (1 if step == 0 else (-1 if step == 1 else 0))
                i = x + (1 if step == 2 else (-1 if step == 3 else 0))
                if j < 0 or i < 0 or j >= h or i >= w or parts == print_:
                    continue
                q = primitive[j, i]
                if kind[j, i] == 2 and board[q] >= 0:
                    parts = print_
                elif kind[j, i] != kind[y, x]:
                    parts = plain
                elif kind[y, x] == 2 and p != q:
                    near, far = min(t[y, x], t[j, i]), max(t[y, x], t[j, i])
                    if thin[p] or thin[q] or far > 1.04 * near:
                        parts = plain
            out[y, x] = parts


@njit(cache=True, error_model="numpy", parallel=True)
def meet(  # type: ignore[no-untyped-def]
    origin,
    rays,
    way,
    primitive,
    uv,
    vertices,
    triangles,
    corner_normal,
    smooth,
    border,
    shares,
    grounds,
    material,
    corner_light,
    face_light,
    size,
    flat,
    spread,
    point,
    normal,
    start,
    code,
    footprint,
    light,
):
    """Places, normals toward the viewer, kinds and footprints of what rays meet on land, and its baked light.

    ``start`` is where shadow rays begin: off the surface that the smooth normals pretend (Hanika 2021, Ray
    Tracing Gems II, chapter 4). Where kinds of ground compete, noise decides, so that borders are frayed.
    """
    for i in prange(len(rays)):
        f = primitive[i]
        o = origin[i % len(origin)]
        a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        u, v = np.float64(uv[i, 0]), np.float64(uv[i, 1])
        q = 1.0 - u - v
        dx, dy, dz = np.float64(rays[i, 0]), np.float64(rays[i, 1]), np.float64(rays[i, 2])
        px, py, pz = o[0] + way[i] * dx, o[1] + way[i] * dy, o[2] + way[i] * dz
        ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
        ux, uy, uz = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
        vx, vy, vz = vertices[c, 0] - ax, vertices[c, 1] - ay, vertices[c, 2] - az
        fx, fy, fz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = max(np.sqrt(fx * fx + fy * fy + fz * fz), 1e-30)
        fx, fy, fz = fx / length, fy / length, fz / length
        nx, ny, nz = fx, fy, fz
        sx, sy, sz = 0.0, 0.0, 0.0
        if smooth[f]:
            mx = q * corner_normal[a, 0] + u * corner_normal[b, 0] + v * corner_normal[c, 0]
            my = q * corner_normal[a, 1] + u * corner_normal[b, 1] + v * corner_normal[c, 1]
            mz = q * corner_normal[a, 2] + u * corner_normal[b, 2] + v * corner_normal[c, 2]
            length = np.sqrt(mx * mx + my * my + mz * mz)
            if length > 0.2 and mx * fx + my * fy + mz * fz > 0.2 * length:
                nx, ny, nz = mx / length, my / length, mz / length
                for k in range(3):
                    e = a if k == 0 else (b if k == 1 else c)
                    weight = q if k == 0 else (u if k == 1 else v)
                    gx, gy, gz = corner_normal[e, 0], corner_normal[e, 1], corner_normal[e, 2]
                    below = (
                        (px - vertices[e, 0]) * gx + (py - vertices[e, 1]) * gy + (pz - vertices[e, 2]) * gz
                    )
                    if below < 0.0:
                        sx, sy, sz = (
                            sx - weight * below * gx,
                            sy - weight * below * gy,
                            sz - weight * below * gz,
                        )
        slant = nx * dx + ny * dy + nz * dz
        if slant > 0.0:
            nx, ny, nz = -nx, -ny, -nz
        what = material[f]
        if border[f]:
            most = -1.0
            for k in range(len(grounds)):
                share = q * shares[a, k] + u * shares[b, k] + v * shares[c, k]
                if share > 0.0:
                    spacing, gain = 0.35, 0.35
                    for octave in range(5):
                        share += gain * noise_at(
                            px / spacing, py / spacing, pz / spacing, 900 + 10 * k + octave
                        )
                        spacing, gain = 0.5 * spacing, 0.75 * gain
                    if share > most:
                        most, what = share, grounds[k]
        point[i, 0], point[i, 1], point[i, 2] = px, py, pz
        normal[i, 0], normal[i, 1], normal[i, 2] = nx, ny, nz
        start[i, 0], start[i, 1], start[i, 2] = px + sx, py + sy, pz + sz
        code[i] = what
        # The spot is longer than wide by 1 / slant; less so where rays divide a pixel along it.
        longer = max(flat / max(abs(slant), 0.02), 1.0)
        footprint[i] = way[i] * size * longer ** (0.5 if flat == 1.0 else 0.75) + spread * way[i]
        for k in range(4):
            if smooth[f]:
                light[i, k] = q * corner_light[a, k] + u * corner_light[b, k] + v * corner_light[c, k]
            else:
                light[i, k] = face_light[f, k]


@njit(cache=True, error_model="numpy", parallel=True)
def detail(point, code, footprint, strength, colour):  # type: ignore[no-untyped-def]
    """Contrast of the finest grain that the eye still sees, down to two footprints; changes ``colour``."""
    for i in prange(len(point)):
        strong = strength[code[i]]
        if strong <= 0.0:
            continue
        foot = max(footprint[i], 1e-4)
        # The finest octave that is in the world at all is 4 mm.
        level = np.int64(np.floor(np.log2(foot / 0.004)))
        total = 0.0
        for octave in range(1, 5):
            at = octave + (level if level > -1 else -1)
            spacing = 0.004 * 2.0**at
            seen = min(max(2.0 * spacing / foot - 2.0, 0.0), 1.0) * min(
                max(4.0 - np.log2(spacing / foot), 0.0), 1.0
            )
            if seen > 0.0:
                x, y, z = point[i, 0] / spacing, point[i, 1] / spacing, point[i, 2] / spacing
                if at % 2:
                    x, y = 0.8 * x + 0.6 * y, -0.6 * x + 0.8 * y
                    y, z = 0.8 * y + 0.6 * z, -0.6 * y + 0.8 * z
                total += seen * noise_at(x, y, z, 700 + at)
        factor = np.exp(strong * total)
        for k in range(3):
            colour[i, k] = min(colour[i, k] * factor, 0.95)


@njit(cache=True, error_model="numpy", parallel=True)
def paint_boards(board, primitive, point, centre, right, size, rim, white, black, colour):  # type: ignore[no-untyped-def]
    """Albedo of the printed fronts of boards."""
    for i in prange(len(point)):
        n = board[primitive[i]]
        if n < 0:
            continue
        x = (point[i, 0] - centre[n, 0]) * right[n, 0] + (point[i, 1] - centre[n, 1]) * right[n, 1]
        z = point[i, 2] - centre[n, 2]
        inside = max(abs(x), abs(z)) < (0.5 - rim) * size
        dark = inside and ((x < 0.0) == (z > 0.0))
        for k in range(3):
            colour[i, k] = black if dark else white


@njit(cache=True, error_model="numpy", parallel=True)
def shade(  # type: ignore[no-untyped-def]
    colour, relief, normal, thin, code, light, sunlit, sun, sun_colour, way, haze, visibility, out
):
    """Light from matt surfaces through the air toward the viewer; leaves also let the sun through."""
    for i in prange(len(colour)):
        facing = relief[i, 0] * sun[0] + relief[i, 1] * sun[1] + relief[i, 2] * sun[2]
        front = max(facing, 0.0) * sunlit[i]
        through = max(-facing, 0.0) * sunlit[i] if thin[code[i]] else 0.0
        dents = min(max(1.0 + 0.7 * (relief[i, 2] - normal[i, 2]), 0.4), 1.5)
        left = np.exp(-way[i] / visibility)
        for k in range(3):
            # Light that has passed a leaf is yellower.
            yellow = (0.85, 0.95, 0.30)[k]
            total = (front + yellow * through) * sun_colour[k] + light[i, k] * dents
            out[i, k] = colour[i, k] * total * left + haze[k] * (1.0 - left)


# ---------------------------------------------------------------- compiled loops: rays that leave the scene
#
# clouds.
#
# One pass over float32 rays; six octaves of cloud are enough at the size of a pixel.


def sky_light(rays_wcs: ArrayF32, sun: Sun, *, cover: float, t_s: float, glare: bool) -> ArrayF32:
    """Linear RGB (n, 3) of the sky in directions (n, 3).

    Parameters
    ----------
    rays_wcs : (n, 3) unit vectors.
    sun : lights sky and clouds.
    cover : share of clouds, about 0 to 1; 0: none.
    t_s : time; the clouds drift to the east by 8 m/s at a height of 1200 m.
    glare : whether the sun's disc and the glow close to it are there.
    """
    out = np.empty((len(rays_wcs), 3), dtype=np.float32)
    drift = t_s * 8.0 / 1200.0
    _sky(rays_wcs, sun.direction_wcs, sun.colour, HAZE, ZENITH, cover, drift, float(glare), out)
    return out


def mean_sky(sun: Sun) -> ArrayF:
    """Mean light (3,) of the upper half of the sky, for what has no rays of its own."""
    i = np.arange(400) + 0.5
    up, turn = i / 400, np.pi * (1 + 5**0.5) * i
    flat = np.sqrt(1 - up * up)
    d = np.stack([flat * np.cos(turn), flat * np.sin(turn), up], axis=1).astype(np.float32)
    return np.asarray(sky_light(d, sun, cover=0.4, t_s=0.0, glare=False).mean(axis=0), dtype=np.float64)


@njit(cache=True, error_model="numpy")
def _value_plane(x, y, seed):  # type: ignore[no-untyped-def]
    fx, fy = np.floor(x), np.floor(y)
    ix, iy = np.int64(fx), np.int64(fy)
    x, y = x - fx, y - fy
    u, v = x * x * (3 - 2 * x), y * y * (3 - 2 * y)
    a, b = mixed(ix, iy, 0, seed), mixed(ix + 1, iy, 0, seed)
    c, d = mixed(ix, iy + 1, 0, seed), mixed(ix + 1, iy + 1, 0, seed)
    low, high = a + (b - a) * u, c + (d - c) * u
    return 2 * (low + (high - low) * v) - 1


@njit(cache=True, error_model="numpy")
def _density(x, y, cover, octaves):  # type: ignore[no-untyped-def]
    """Thickness of the clouds at a place of their layer, 0 to about 1."""
    total, amplitude, size = 0.0, 1.0, 1.6
    for octave in range(octaves):
        # Turned from octave to octave, so that the lattices do not show.
        x, y = 0.8 * x + 0.6 * y, -0.6 * x + 0.8 * y
        total += amplitude * _value_plane(x / size, y / size, 4001 + octave)
        amplitude *= 0.52
        size *= 0.5
    return min(max((total - 0.75 + 1.1 * cover) / 0.9, 0.0), 1.2)


@njit(cache=True, error_model="numpy", parallel=True)
def _sky(d, sun, sun_colour, haze, zenith, cover, drift, disc, out):  # type: ignore[no-untyped-def]
    for i in prange(len(d)):
        dx, dy, up = np.float64(d[i, 0]), np.float64(d[i, 1]), np.float64(d[i, 2])
        low = np.exp(-4.6 * abs(up))
        dim = 1.0 if up >= 0.0 else 0.35
        angle = dx * sun[0] + dy * sun[1] + up * sun[2]
        ahead = max(angle, 0.0)
        glow = 0.30 * ahead**6 + disc * 0.9 * ahead**90
        bright = 40.0 * disc if angle > 0.99998 else 0.0
        side = 0.88 + 0.12 * angle
        opaque, shine, thick, far = 0.0, 0.0, 0.0, 0.0
        if up > 0.015 and cover > 0.0:
            # A layer of clouds, bent down towards the horizon, in units of its height.
            scale = 1.0 / (up + 0.07)
            x, y = dx * scale + drift, 1.25 * dy * scale
            thick = _density(x, y, cover, 6)
            if thick > 0.0:
                behind = _density(x + 0.12 * sun[0], y + 0.15 * sun[1], cover, 4)
                shine = min(max(0.5 + 1.3 * (thick - behind), 0.0), 1.0)
                opaque = (1.0 - np.exp(-3.0 * thick)) * min((up - 0.015) / 0.10, 1.0)
                far = 0.7 * np.exp(-up / 0.10)
        for k in range(3):
            clear = dim * (
                (zenith[k] + (haze[k] - zenith[k]) * low) * side + (0.16 * glow + bright) * sun_colour[k]
            )
            grey = (0.72, 0.75, 0.80)[k]
            white = (1.75, 1.72, 1.66)[k]
            cloud = (grey + (white - grey) * shine) * (1.0 - 0.25 * min(max(thick - 0.5, 0.0), 1.0))
            cloud = cloud * (1.0 - far) + haze[k] * 1.15 * far
            out[i, k] = clear + (cloud - clear) * opaque
