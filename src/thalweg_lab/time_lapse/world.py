"""What the images show, ready for rays: the land with its boards, and its light where it is needed.

The light of a place does not depend on who looks at it: sky and surroundings reach a corner of the ground or
a leaf by a few rays that belong to that corner or leaf. So it is computed once, when the first image shows
the place, and any order of images gives the same.
"""

from typing import Final

import numpy as np

from thalweg.core.types import ArrayB, ArrayF, ArrayF32, ArrayI
from thalweg_lab.river.materials import BARE_GROUND, Material
from thalweg_lab.river.scene import Scene
from thalweg_lab.river.shading import corner_shares, vertex_normals
from thalweg_lab.river_images.daylight import HAZE, Sun
from thalweg_lab.time_lapse.light_kernels import claim_new, gathered, rays_to_sky
from thalweg_lab.time_lapse.sky_kernels import ZENITH
from thalweg_lab.time_lapse.targets import Targets

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
