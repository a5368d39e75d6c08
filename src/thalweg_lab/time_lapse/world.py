"""What the images show, ready for rays: the land with its boards, and its light where it is needed.

The light of a place does not depend on who looks at it: sky and surroundings reach a corner of the ground or
a leaf by a few rays that belong to that corner or leaf. So it is computed once, when the first image shows
the place, and any order of images gives the same.
"""

from typing import Final

import numba as nb
import numpy as np

from thalweg.core.types import ArrayB, ArrayF, ArrayF32, ArrayI
from thalweg_lab.river.materials import BARE_GROUND, Material
from thalweg_lab.river.scene import Scene
from thalweg_lab.river.shading import corner_shares, vertex_normals
from thalweg_lab.river_images.daylight import HAZE, Sun
from thalweg_lab.time_lapse.sky_kernels import ZENITH
from thalweg_lab.time_lapse.targets import Targets

# ---------------------------------------------------------------- loops over places that get their light:
# which are new, rays to their sky, and what these bring


# Open3D brings an old TBB into the process, which numba would try first and complain about.
nb.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]


@nb.njit(cache=True, error_model="numpy")
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


@nb.njit(cache=True, error_model="numpy")
def _chance(index, stream):  # type: ignore[no-untyped-def]
    """A number in [0, 1) that belongs to a place."""
    h = np.uint64(index) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(stream) * np.uint64(0xC2B2AE3D27D4EB4F)
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    h ^= h >> np.uint64(31)
    return np.float64(h >> np.uint64(11)) * 2.0**-53


@nb.njit(cache=True, error_model="numpy", parallel=True)
def rays_to_sky(place, normal, index, lift, sun, rays, start, way):  # type: ignore[no-untyped-def]
    """Rays (n, rays + 1, 3) with a density of the cosine about normals (n, 3); the last one to the sun."""
    for i in nb.prange(len(place)):
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
            turn = 2 * np.pi * (k + _chance(index[i], 2 * k + 1)) / rays
            out = _chance(index[i], 2 * k + 2)
            flat, high = np.sqrt(out), np.sqrt(1.0 - out)
            x, y = flat * np.cos(turn), flat * np.sin(turn)
            way[i, k, 0] = x * (1.0 + sign * nx * nx * a) + y * b + high * nx
            way[i, k, 1] = x * sign * b + y * (sign + ny * ny * a) + high * ny
            way[i, k, 2] = -x * sign * nx - y * ny + high * nz


@nb.njit(cache=True, error_model="numpy", parallel=True)
def gathered(way, t_hit, sun, sun_colour, haze, zenith, grey, like_land, light):  # type: ignore[no-untyped-def]
    """Mean light (n, 3) that the rays of `rays_to_sky` bring, and in the fourth place whether the sun shines.

    The sky is that of `thalweg_lab.river_images.daylight.clear_sky`, half whitened by clouds; what is near
    is as dark as the place itself, what is far is lit like the land at large.
    """
    n, rays = t_hit.shape[0], t_hit.shape[1] - 1
    for i in nb.prange(n):
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


# ---------------------------------------------------------------- world


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
            vertices_wcs_m=self.vertices, triangles=self.triangles, material=material,
            water_level_m=self.level_m, variation=variation,
        )  # fmt: skip
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
        hits = self.caster.cast(start_wcs_m + side * normal_wcs, np.broadcast_to(sun, normal_wcs.shape))
        return np.isinf(hits.t_hit_m).astype(np.float32)

    def _light(self, place: ArrayF, normal: ArrayF, index: ArrayI, rays: int) -> ArrayF32:
        n, sun = len(place), self.sun
        start = np.empty((n, rays + 1, 3))
        way, light = np.empty((n, rays + 1, 3), dtype=np.float32), np.empty((n, 4), dtype=np.float32)
        rays_to_sky(place, normal, index, 2 * LIFT_M, sun.direction_wcs, rays, start, way)
        t = self.caster.cast(start.reshape(-1, 3), way.reshape(-1, 3)).t_hit_m.reshape(n, rays + 1)
        gathered(way, t, sun.direction_wcs, sun.colour, HAZE, ZENITH, _GREY, _LIKE_LAND, light)
        return light
