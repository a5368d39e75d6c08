"""A picture of the scene as a camera would see it: rays, light of sun and sky, water, air.

Each pixel's ray meets land, water or sky. Land gets the sun where a shadow ray is free, and light from the
sky and the surroundings by a few more rays of some pixels, spread to their neighbours. Water reflects by a
second ray off its waves and shows the bed by a third one. The water is a level plane without end; where land
rises above it, the land is met first.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayF32, ArrayI, ArrayU8, GeometryError
from thalweg.core.geometry import Hits
from thalweg_lab.river import (
    BARE_GROUND,
    Material,
    Scene,
    Waves,
    corner_shares,
    developed,
    fresnel,
    half_sphere,
    hash01,
    in_air,
    lit,
    mirrored,
    refracted,
    smooth_normals,
    spread_ambient,
    under_water,
    vertex_normals,
)
from thalweg_lab.river_images.appearance import noise, surface_look
from thalweg_lab.river_images.daylight import HAZE, Sun, clear_sky, sky
from thalweg_lab.river_images.pinhole import PictureCamera

SKY: Final = 255
"""Code of the sky in the map of materials."""

VISIBILITY_M: Final = 900.0
"""Way through air after which 1/e of the light is left: a clear day with some haze."""

EXPOSURE: Final = 0.74
"""Light of 1 becomes this before the tone curve."""

_THIN: Final = np.isin(np.arange(len(Material)), [Material.LEAF, Material.REED, Material.BLADE])
_ROUND: Final = np.isin(
    np.arange(len(Material)),
    [Material.BED, Material.SOIL, Material.GRASS, Material.GRAVEL, Material.STONE, Material.BARK],
)
_SUN_RADIUS_RAD: Final = 0.00465
_LIFT_M: Final = 0.002
_AMBIENT_STEP_PX: Final = 2
_AMBIENT_RADIUS_PX: Final = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A picture with its truth.

    Parameters
    ----------
    image : (h, w, 3) uint8, sRGB.
    range_m : (h, w) distance of what the (first) ray of each pixel met, infinite for the sky.
    material : (h, w) its `Material`, `SKY` for the sky.
    """

    image: ArrayU8
    range_m: ArrayF
    material: ArrayU8


def render(
    scene: Scene, camera: PictureCamera, *, sun: Sun, waves: Waves, t_s: float = 0.0, samples: int = 1
) -> Picture:
    """One picture of a scene; use a `Painter` for several.

    Parameters
    ----------
    scene : the twin's world.
    camera : where it is seen from.
    sun : where the light comes from.
    waves : of the water.
    t_s : time for waves and clouds.
    samples : rays along each side of a pixel; 2 smooths edges and takes four times as long.
    """
    return Painter(scene, sun=sun, waves=waves).paint(camera, t_s=t_s, samples=samples)


class Painter:
    """Makes pictures of one scene in one light, ``sun``; ``caster`` casts rays onto its land and bed.

    Parameters
    ----------
    scene : the twin's world.
    sun : where the light comes from.
    waves : of the water.
    cover : share of clouds in the sky.
    """

    def __init__(self, scene: Scene, *, sun: Sun, waves: Waves, cover: float = 0.4) -> None:
        dry = scene.without(Material.WATER)
        self.sun, self._waves, self._cover = sun, waves, cover
        self.caster = dry.caster()
        self._vertices = np.ascontiguousarray(dry.vertices_wcs_m, dtype=np.float64)
        self._triangles, self._material = dry.triangles, dry.material
        self._variation = dry.variation
        self._grounds = np.flatnonzero(BARE_GROUND).astype(np.uint8)
        self._shares = corner_shares(dry.triangles, dry.material, self._grounds, len(self._vertices))
        mixed = self._shares[dry.triangles].max(axis=2).min(axis=1) < 0.999
        self._border = mixed & np.isin(dry.material, self._grounds)
        self._level_m = dry.water_level_m
        corners = dry.triangles[_ROUND[dry.material]]
        self._corner_normals = vertex_normals(self._vertices, corners)

    def paint(
        self,
        camera: PictureCamera,
        *,
        t_s: float = 0.0,
        samples: int = 1,
        ambient_rays: int = 4,
        exposure: float | None = EXPOSURE,
    ) -> Picture:
        """A picture.

        Parameters
        ----------
        camera : where the scene is seen from.
        t_s : time for waves and clouds.
        samples : rays along each side of a pixel.
        ambient_rays : rays for the light of sky and surroundings, each at a quarter of the pixels.
        exposure : light of 1 becomes this before the tone curve; None: after the picture's brightness.

        Raises
        ------
        GeometryError : the camera is under water.
        """
        if camera.position_wcs_m[2] <= self._level_m:
            raise GeometryError(
                f"camera at {camera.position_wcs_m[2]:.2f} m, water at {self._level_m:.2f} m",
                expected="a camera above the water",
            )
        width, height = camera.size_px
        total = np.zeros((height * width, 3))
        offsets = (np.arange(samples) + 0.5) / samples
        first: _Passing | None = None
        for number, (dy, dx) in enumerate((dy, dx) for dy in offsets for dx in offsets):
            seen = self._first_hits(camera, (float(dx), float(dy)), samples, number)
            if first is None:
                first = seen
                first.ambient = self._sampled_ambient(first, ambient_rays)
            total += self._light(seen, first, t_s)
        assert first is not None
        return Picture(
            image=developed((total / samples**2).reshape(height, width, 3), exposure),
            range_m=first.range_m.reshape(height, width),
            material=first.material.reshape(height, width),
        )

    def _first_hits(
        self, camera: PictureCamera, offset: tuple[float, float], samples: int, number: int
    ) -> "_Passing":
        ray = camera.rays(offset)
        origin = np.broadcast_to(camera.position_wcs_m, ray.shape)
        land = self.caster.cast(camera.position_wcs_m, ray)
        with np.errstate(divide="ignore", invalid="ignore"):
            water = np.where(ray[:, 2] < 0, (self._level_m - origin[:, 2]) / ray[:, 2], np.inf)
        range_m = np.minimum(land.t_hit_m, water)
        material = np.full(len(ray), SKY, dtype=np.uint8)
        on_land = np.isfinite(land.t_hit_m) & (land.t_hit_m <= water)
        where = np.flatnonzero(on_land)
        material[where] = self._materials(land, where, origin[where] + range_m[where, None] * ray[where])
        material[np.isfinite(range_m) & ~on_land] = Material.WATER
        normal, shift = np.zeros_like(ray), np.zeros_like(ray)
        normal[where], shift[where] = self._normals(land, where, ray[where])
        # Pixels count rays from the middle: the angle of one is 1 / focal length there.
        size = 1.0 / (camera.focal_px * samples)
        grain = np.arange(len(ray)) + len(ray) * number
        return _Passing(
            shape=camera.size_px[::-1],
            origin=origin,
            ray=ray,
            range_m=range_m,
            material=material,
            land=where,
            hits=land,
            normal=normal,
            shift=shift,
            size_rad=size,
            grain=grain,
            ambient=None,
        )

    def _normals(self, hits: Hits, where: ArrayI, ray: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Smooth normals of hits, towards the viewer, and shifts to where shadow rays begin."""
        primitive = hits.primitive[where]
        normal, shift = hits.normal[where], np.zeros((len(where), 3))
        round_ = np.flatnonzero(_ROUND[self._material[primitive]])
        away = np.sum(normal * ray, axis=1) > 0
        normal[round_], shift[round_] = smooth_normals(
            normal[round_],
            self._vertices,
            self._corner_normals,
            self._triangles,
            primitive[round_],
            hits.uv[where[round_]],
        )
        normal[away] *= -1.0
        return normal, shift

    def _materials(self, hits: Hits, where: ArrayI, points: ArrayF) -> ArrayU8:
        """Materials of hits; the borders between kinds of ground are frayed instead of running along edges.

        The shares of the kinds are blended between the corners of a triangle, and where they compete, noise
        decides.
        """
        primitive = hits.primitive[where]
        material = self._material[primitive]
        which = np.flatnonzero(self._border[primitive])
        u, v = hits.uv[where][which].T
        corner = self._shares[self._triangles[primitive[which]]]
        share = np.einsum("nc,nck->nk", np.stack([1 - u - v, u, v], axis=1), corner)
        for k in range(len(self._grounds)):
            share[:, k] += np.where(share[:, k] > 0, 0.35 * noise(points[which], 0.35, 6, 0.75, 900 + k), 0.0)
        material[which] = self._grounds[np.argmax(share, axis=1)]
        return material

    def _sampled_ambient(self, seen: "_Passing", rays: int) -> ArrayF:
        """Light from sky and surroundings at every second pixel of every second line, 0 elsewhere."""
        height, width = seen.shape
        on_grid = np.zeros((height, width), dtype=bool)
        on_grid[::_AMBIENT_STEP_PX, ::_AMBIENT_STEP_PX] = True
        where = seen.land[on_grid.ravel()[seen.land]]
        ambient = np.zeros((height * width, 3))
        ambient[where] = self._ambient(seen.points(where), seen.normal[where], seen.grain[where], rays)
        return ambient

    def _ambient(self, points: ArrayF, normal: ArrayF, grain: AnyArray, rays: int) -> ArrayF:
        total = np.zeros_like(points)
        for ray in range(rays):
            way = half_sphere(normal, grain, ray, rays)
            hits = self.caster.cast(points + _LIFT_M * normal, way)
            light = clear_sky(way, self.sun, with_sun=False)
            # Clouds even out, whiten and brighten what the clear sky gives.
            light = 0.5 * light + 0.5 * np.array([0.62, 0.64, 0.68])
            light[way[:, 2] < 0] *= 0.3
            # What is near is as dark as the place itself; what is far is lit like the land at large.
            struck = np.isfinite(hits.t_hit_m)
            far = 1.0 - np.exp(-hits.t_hit_m[struck] / 0.6)
            light[struck] = far[:, None] * np.array([0.20, 0.20, 0.12])
            total += light
        return total / rays

    def _sunlit(self, points: ArrayF, normal: ArrayF, grain: AnyArray) -> ArrayF:
        """1 where the way to a random point of the sun is free, 0 where not."""
        turn = 2 * np.pi * hash01(grain, 1)
        out = _SUN_RADIUS_RAD * np.sqrt(hash01(grain, 2))
        sun = self.sun.direction_wcs
        right = np.array([sun[1], -sun[0], 0.0]) / max(float(np.hypot(sun[0], sun[1])), 1e-9)
        way = (
            sun + (out * np.cos(turn))[:, None] * right + (out * np.sin(turn))[:, None] * np.cross(sun, right)
        )
        side = np.where(np.sum(normal * sun, axis=1) >= 0, 1.0, -1.0)[:, None]
        return self.caster.free(points + _LIFT_M * side * normal, way).astype(np.float64)

    def _surface(
        self,
        points: ArrayF,
        ray: ArrayF,
        normal: ArrayF,
        shift: ArrayF,
        material: ArrayU8,
        variation: ArrayF32,
        footprint_m: ArrayF,
        ambient: ArrayF,
        grain: AnyArray,
    ) -> ArrayF:
        """Light (n, 3) from places of the land towards a viewer."""
        colour, relief = surface_look(
            points, normal, material, variation, footprint_m, water_level_m=self._level_m
        )
        sun = self.sun.direction_wcs
        thin = _THIN[material]
        faces = (np.sum(relief * sun, axis=1) > 0) | thin
        sunlit = np.zeros(len(points))
        sunlit[faces] = self._sunlit(points[faces] + shift[faces], normal[faces], grain[faces])
        dents = np.clip(1.0 + 0.7 * (relief[:, 2] - normal[:, 2]), 0.4, 1.5)[:, None]
        light = lit(colour, relief, ray, thin, sunlit, ambient * dents, sun, self.sun.colour)
        panes = np.flatnonzero(material == Material.GLASS)
        if len(panes):
            share = fresnel(-np.sum(ray[panes] * normal[panes], axis=1), 1.52)[:, None] * 1.7
            light[panes] += share * sky(mirrored(ray[panes], normal[panes]), self.sun, cover=self._cover)
        return light

    def _light(self, seen: "_Passing", first: "_Passing", t_s: float) -> ArrayF:
        """Linear light (n, 3) of all pixels for one ray each."""
        light = np.zeros_like(seen.ray)
        high = np.flatnonzero(seen.material == SKY)
        light[high] = sky(seen.ray[high], self.sun, cover=self._cover, t_s=t_s)
        land = seen.land
        ambient = first.spread_to(seen)[land]
        light[land] = self._surface(
            seen.points(land),
            seen.ray[land],
            seen.normal[land],
            seen.shift[land],
            seen.material[land],
            self._variation[seen.hits.primitive[land]],
            seen.footprint(land),
            ambient,
            seen.grain[land],
        )
        wet = np.flatnonzero(seen.material == Material.WATER)
        light[wet] = self._water(seen, wet, t_s)
        near = np.flatnonzero(np.isfinite(seen.range_m))
        light[near] = in_air(light[near], seen.range_m[near], HAZE, VISIBILITY_M)
        return light

    def _water(self, seen: "_Passing", wet: ArrayI, t_s: float) -> ArrayF:
        points, ray, grain = seen.points(wet), seen.ray[wet], seen.grain[wet]
        footprint = seen.range_m[wet] * seen.size_rad / np.sqrt(np.maximum(-ray[:, 2], 0.01))
        normal = self._waves.normal(points[:, 0], points[:, 1], t_s, footprint_m=footprint)
        # Waves too short for the pixel: one facet of theirs, drawn by the pixel.
        sigma = np.sqrt(self._waves.hidden_slope_variance(footprint) / 2)
        radius = np.sqrt(-2 * np.log(1.0 - hash01(grain, 3))) * sigma
        turn = 2 * np.pi * hash01(grain, 4)
        normal[:, 0] += radius * np.cos(turn)
        normal[:, 1] += radius * np.sin(turn)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        cos_in = np.maximum(-np.sum(ray * normal, axis=1), 0.02)
        share = fresnel(cos_in)[:, None]
        back = mirrored(ray, normal)
        # A facet that would send the ray down is hidden behind its neighbour: the ray leaves upwards.
        back[:, 2] = np.maximum(np.abs(back[:, 2]), 0.004)
        back /= np.linalg.norm(back, axis=1, keepdims=True)
        light = share * self._seen_from_water(points, back, seen.range_m[wet] * seen.size_rad, grain, t_s)
        through = np.flatnonzero(share[:, 0] < 0.9)
        light += (1 - share) * self._murk()
        down = refracted(ray[through], normal[through])
        light[through] += (1 - share[through]) * self._bed(points[through], down, footprint[through])
        return light

    def _daylight(self) -> ArrayF:
        return np.asarray(self.sun.colour * np.sin(self.sun.elevation_rad) + 0.5)

    def _murk(self) -> ArrayF:
        """Light (1, 3) from deep water."""
        return under_water(np.zeros((1, 3)), np.full(1, 50.0), np.full(1, 50.0), self._daylight())

    def _seen_from_water(
        self, points: ArrayF, back: ArrayF, spot_m: ArrayF, grain: AnyArray, t_s: float
    ) -> ArrayF:
        """Light (n, 3) that arrives at the water from the directions ``back``."""
        light = sky(back, self.sun, cover=self._cover, t_s=t_s)
        hits = self.caster.cast(points, back)
        where = np.flatnonzero(np.isfinite(hits.t_hit_m))
        ray, range_m = back[where], hits.t_hit_m[where]
        normal, shift = self._normals(hits, where, ray)
        # Light from sky and surroundings without rays of its own: half the sky is hidden on a bank.
        ambient = (0.42 + 0.16 * normal[:, 2:]) * np.array([0.80, 0.92, 1.0])
        place = points[where] + range_m[:, None] * ray
        light[where] = self._surface(
            place,
            ray,
            normal,
            shift,
            self._materials(hits, where, place),
            self._variation[hits.primitive[where]],
            2.0 * spot_m[where] + 0.02 * range_m,
            ambient,
            grain[where],
        )
        return light

    def _bed(self, points: ArrayF, down: ArrayF, footprint_m: ArrayF) -> ArrayF:
        """What the bed adds (n, 3) to the murk, seen through the water."""
        hits = self.caster.cast(points, down)
        where = np.flatnonzero(hits.t_hit_m < 3.0)
        added = np.zeros_like(points)
        way = hits.t_hit_m[where]
        place = points[where] + way[:, None] * down[where]
        primitive = hits.primitive[where]
        colour, relief = surface_look(
            place,
            self._normals(hits, where, down[where])[0],
            self._materials(hits, where, place),
            self._variation[primitive],
            footprint_m[where],
            water_level_m=self._level_m,
        )
        shade = 0.45 + 0.55 * np.clip(relief @ self.sun.direction_wcs, 0.0, 1.0)
        depth = self._level_m - place[:, 2]
        added[where] = under_water(colour * shade[:, None], depth, way, self._daylight()) - self._murk()
        return added


@dataclass(slots=True, kw_only=True)
class _Passing:
    """One ray of each pixel and what it met."""

    shape: tuple[int, int]
    origin: ArrayF
    ray: ArrayF
    range_m: ArrayF
    material: ArrayU8
    land: ArrayI
    hits: Hits
    normal: ArrayF
    shift: ArrayF
    size_rad: float
    grain: AnyArray
    ambient: ArrayF | None

    def points(self, where: ArrayI | ArrayB) -> ArrayF:
        """Where rays met something, (n, 3)."""
        return np.asarray(self.origin[where] + self.range_m[where, None] * self.ray[where])

    def footprint(self, where: ArrayI) -> ArrayF:
        """Size (n,) of a ray's spot on the land: geometric mean of its two axes."""
        slant = np.abs(np.sum(self.normal[where] * self.ray[where], axis=1))
        return np.asarray(self.range_m[where] * self.size_rad / np.sqrt(np.maximum(slant, 0.1)))

    def spread_to(self, seen: "_Passing") -> ArrayF:
        """Ambient light (n, 3) for the rays of another pass."""
        assert self.ambient is not None
        h, w = self.shape
        land_only = [np.full(h * w, np.inf), np.full(h * w, np.inf)]
        for target, passing in zip(land_only, (self, seen), strict=True):
            target[passing.land] = passing.range_m[passing.land]
        spread = spread_ambient(
            self.ambient.reshape(h, w, 3),
            land_only[0].reshape(h, w),
            self.normal.reshape(h, w, 3),
            (self.ambient.sum(axis=1) > 0).reshape(h, w),
            land_only[1].reshape(h, w),
            seen.normal.reshape(h, w, 3),
            _AMBIENT_RADIUS_PX,
        )
        return spread.reshape(-1, 3)
