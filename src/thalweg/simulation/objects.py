"""Things that stand on the banks: stones, bushes, posts, buildings."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import ConvexHull

from thalweg.core.types import AnyArray, ArrayF, ArrayI, ArrayU8
from thalweg.simulation.materials import Material
from thalweg.simulation.river import River

_LEAVES = 220
_STONE_CORNERS = 24


@dataclass(slots=True)
class MeshParts:
    """Collects pieces of a mesh."""

    vertices: list[ArrayF] = field(default_factory=list)
    triangles: list[ArrayI] = field(default_factory=list)
    material: list[ArrayU8] = field(default_factory=list)
    count: int = 0

    def add(self, vertices: ArrayF, triangles: ArrayI, material: AnyArray) -> None:
        """Add a piece: (n, 3) vertices, (m, 3) corners, (m,) materials."""
        self.vertices.append(np.asarray(vertices, dtype=np.float64))
        self.triangles.append(np.asarray(triangles, dtype=np.int64) + self.count)
        self.material.append(np.asarray(material).astype(np.uint8))
        self.count += len(vertices)

    def joined(self) -> tuple[ArrayF, ArrayI, ArrayU8]:
        """Vertices, triangles and materials of all pieces."""
        return (
            np.concatenate(self.vertices),
            np.concatenate(self.triangles),
            np.concatenate(self.material),
        )


def _repeat(faces: ArrayI, copies: ArrayF) -> tuple[ArrayF, ArrayI]:
    """Vertices and triangles of many copies, each given by its own (k, 3) vertices."""
    n, k = copies.shape[:2]
    shift = (np.arange(n) * k)[:, None, None]
    return copies.reshape(-1, 3), (faces[None] + shift).reshape(-1, 3)


def _sphere(corners: int) -> tuple[ArrayF, ArrayI]:
    """Points spread over the unit sphere (Fibonacci lattice) and their hull, outward."""
    i = np.arange(corners) + 0.5
    z = 1.0 - 2.0 * i / corners
    turn = np.pi * (1.0 + 5.0**0.5) * i
    p = np.stack([np.cos(turn) * np.sqrt(1 - z * z), np.sin(turn) * np.sqrt(1 - z * z), z], axis=1)
    faces = ConvexHull(p).simplices.astype(np.int64)
    normal = np.cross(p[faces[:, 1]] - p[faces[:, 0]], p[faces[:, 2]] - p[faces[:, 0]])
    inward = np.sum(normal * p[faces[:, 0]], axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return p, faces


def _stand(river: River, s: ArrayF, n: ArrayF) -> ArrayF:
    return np.concatenate([river.to_wcs(s, n), river.height(s, n)[:, None]], axis=1)


def add_stones(parts: MeshParts, river: River, rng: np.random.Generator) -> None:
    """Boulders on the embankment, more of them near the water, half sunk into it."""
    c = river.config
    count = int(c.stones_per_m * c.length_m)
    if count == 0:
        return
    s = rng.uniform(-c.length_m / 2, c.length_m / 2, count)
    up_slope = c.embankment_height_m / np.tan(np.deg2rad(c.embankment_slope_deg))
    n = -river.half_width(s) - up_slope * (rng.beta(1.2, 2.0, count) * 1.05 - 0.05)
    size = np.exp(rng.normal(np.log(0.22), 0.45, count)).clip(0.08, 0.8)
    ball, faces = _sphere(_STONE_CORNERS)
    axes = np.array([1.0, 0.8, 0.65]) * rng.uniform(0.8, 1.2, (count, 3))
    bumpy = 1.0 + 0.18 * rng.standard_normal((count, len(ball))).clip(-2.5, 2.5)
    local = ball[None] * bumpy[:, :, None] * (axes * size[:, None])[:, None, :]
    turn = rng.uniform(0, 2 * np.pi, count)
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    x = cos * local[..., 0] - sin * local[..., 1]
    y = sin * local[..., 0] + cos * local[..., 1]
    stones = np.stack([x, y, local[..., 2]], axis=-1) + _stand(river, s, n)[:, None, :]
    vertices, triangles = _repeat(faces, stones)
    parts.add(vertices, triangles, np.full(len(triangles), Material.STONE))


def add_bushes(parts: MeshParts, river: River, rng: np.random.Generator) -> None:
    """Bushes of single leaves, so that beams meet some and pass others."""
    c = river.config
    count = int(c.bushes_per_100m * c.length_m / 100)
    if count == 0:
        return
    s = rng.uniform(-c.length_m / 2, c.length_m / 2, count)
    up_slope = c.embankment_height_m / np.tan(np.deg2rad(c.embankment_slope_deg))
    on_right = rng.uniform(size=count) < 0.4
    behind = np.where(on_right, rng.uniform(0.2, 1.3, count) * up_slope, rng.uniform(1.0, 18.0, count))
    n = np.where(on_right, -1.0, 1.0) * (river.half_width(s) + behind)
    radius = rng.uniform(0.35, 1.2, count)
    way = rng.standard_normal((count, _LEAVES, 3))
    way /= np.linalg.norm(way, axis=2, keepdims=True)
    way *= rng.uniform(0.25, 1.0, (count, _LEAVES, 1)) ** 0.5
    centre = _stand(river, s, n) + np.stack([np.zeros(count), np.zeros(count), 0.8 * radius], axis=1)
    leaves = (centre[:, None] + way * radius[:, None, None]).reshape(-1, 3)
    _add_leaves(parts, leaves, rng)


def _add_leaves(parts: MeshParts, centres: ArrayF, rng: np.random.Generator) -> None:
    m = len(centres)
    u = rng.standard_normal((m, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = rng.standard_normal((m, 3))
    v -= np.sum(v * u, axis=1, keepdims=True) * u
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    size = rng.uniform(0.03, 0.07, (m, 1))
    corners = np.stack([centres - u * size, centres + v * size / 2, centres + u * size], axis=1)
    vertices, triangles = _repeat(np.array([[0, 1, 2]]), corners)
    parts.add(vertices, triangles, np.full(len(triangles), Material.LEAF))


def _prism(sides: int) -> tuple[ArrayF, ArrayI]:
    """A closed upright prism of radius 1 and height 1 over the ground, corners at half steps."""
    turn = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros(sides)], axis=1)
    vertices = np.concatenate([ring, ring + np.array([0.0, 0.0, 1.0]), [[0.0, 0.0, 1.0]]])
    i, k = np.arange(sides), (np.arange(sides) + 1) % sides
    top = np.full(sides, 2 * sides)
    faces = np.concatenate(
        [
            np.stack([i, k, k + sides], axis=1),
            np.stack([i, k + sides, i + sides], axis=1),
            np.stack([i + sides, k + sides, top], axis=1),
        ]
    )
    return vertices, faces


def add_posts(parts: MeshParts, river: River, rng: np.random.Generator) -> None:
    """Wooden posts along both banks."""
    c = river.config
    count = int(c.posts_per_100m * c.length_m / 100)
    if count == 0:
        return
    s = rng.uniform(-c.length_m / 2, c.length_m / 2, count)
    side = np.where(rng.uniform(size=count) < 0.5, -1.0, 1.0)
    n = side * (river.half_width(s) + rng.uniform(0.8, 9.0, count))
    shape, faces = _prism(8)
    radius, height = rng.uniform(0.05, 0.14, count), rng.uniform(1.2, 3.0, count)
    scale = np.stack([radius, radius, height + 0.3], axis=1)
    foot = _stand(river, s, n) - [0.0, 0.0, 0.3]
    vertices, triangles = _repeat(faces, shape[None] * scale[:, None] + foot[:, None])
    parts.add(vertices, triangles, np.full(len(triangles), Material.WOOD))


def add_buildings(parts: MeshParts, river: River, rng: np.random.Generator) -> None:
    """Plain houses behind the left bank."""
    c = river.config
    if c.buildings == 0:
        return
    shape, faces = _prism(4)
    s = (np.arange(c.buildings) + 0.5) / c.buildings * c.length_m - c.length_m / 2
    s += rng.uniform(-0.2, 0.2, c.buildings) * c.length_m / c.buildings
    n = river.half_width(s) + rng.uniform(22.0, 35.0, c.buildings)
    scale = np.stack([rng.uniform(5, 8, c.buildings), rng.uniform(4, 6, c.buildings),
                      rng.uniform(5, 9, c.buildings)], axis=1)  # fmt: skip
    foot = _stand(river, s, n) - [0.0, 0.0, 1.0]
    vertices, triangles = _repeat(faces, shape[None] * scale[:, None] + foot[:, None])
    parts.add(vertices, triangles, np.full(len(triangles), Material.WALL))
