"""Pieces that the scene's mesh is put together from, and simple bodies."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import ConvexHull

from thalweg.core.types import AnyArray, ArrayF, ArrayF32, ArrayI, ArrayU8
from thalweg_lab.river.materials import Material


@dataclass(slots=True)
class MeshParts:
    """Collects pieces of a mesh."""

    vertices: list[ArrayF] = field(default_factory=list)
    triangles: list[ArrayI] = field(default_factory=list)
    material: list[ArrayU8] = field(default_factory=list)
    variation: list[ArrayF32] = field(default_factory=list)
    count: int = 0

    def add(
        self,
        vertices: AnyArray,
        triangles: AnyArray,
        material: AnyArray | Material,
        variation: AnyArray | float = 0.5,
    ) -> None:
        """Add a piece.

        Parameters
        ----------
        vertices : (n, 3) in wcs, metres; kept to the step of float32.
        triangles : (m, 3) corners, counter-clockwise seen from outside or above.
        material : one, or (m,).
        variation : one number from 0 to 1, or (m,): what tells like things apart.
        """
        m = len(triangles)
        self.vertices.append(np.asarray(vertices, dtype=np.float32).astype(np.float64))
        self.triangles.append(np.asarray(triangles, dtype=np.int64) + self.count)
        self.material.append(np.broadcast_to(np.asarray(material).astype(np.uint8), (m,)))
        self.variation.append(np.broadcast_to(np.asarray(variation, dtype=np.float32), (m,)))
        self.count += len(vertices)

    def add_copies(
        self,
        faces: ArrayI,
        copies: ArrayF,
        material: AnyArray | Material,
        variation: AnyArray | float = 0.5,
    ) -> None:
        """Add many bodies of the same faces.

        Parameters
        ----------
        faces : (f, 3) corners of one body.
        copies : (n, k, 3) vertices of each body in wcs.
        material : one, or (f,) of the faces.
        variation : one, or (n,) of the bodies.
        """
        n, k = copies.shape[:2]
        if n == 0:
            return
        triangles = (faces[None] + (np.arange(n) * k)[:, None, None]).reshape(-1, 3)
        if np.ndim(material) == 1:
            material = np.tile(np.asarray(material), n)
        if np.ndim(variation) == 1:
            variation = np.repeat(np.asarray(variation), len(faces))
        self.add(copies.reshape(-1, 3), triangles, material, variation)

    def joined(self) -> tuple[ArrayF, ArrayI, ArrayU8, ArrayF32]:
        """Vertices, triangles, materials and variations of all pieces."""
        return (
            np.concatenate(self.vertices),
            np.concatenate(self.triangles),
            np.concatenate(self.material),
            np.concatenate(self.variation),
        )


def ball(corners: int) -> tuple[ArrayF, ArrayI]:
    """Points spread over the unit sphere (Fibonacci lattice) and their hull, faces outward."""
    i = np.arange(corners) + 0.5
    z = 1.0 - 2.0 * i / corners
    turn = np.pi * (1.0 + 5.0**0.5) * i
    p = np.stack([np.cos(turn) * np.sqrt(1 - z * z), np.sin(turn) * np.sqrt(1 - z * z), z], axis=1)
    faces = ConvexHull(p).simplices.astype(np.int64)
    normal = np.cross(p[faces[:, 1]] - p[faces[:, 0]], p[faces[:, 2]] - p[faces[:, 0]])
    inward = np.sum(normal * p[faces[:, 0]], axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return p, faces


def tube_faces(sides: int, rings: int) -> ArrayI:
    """Faces of a tube over ``rings`` rings of ``sides`` vertices, outward, closed at its end by one tip.

    The vertices are the rings in order, each counter-clockwise seen from the end, then the tip.
    """
    i = np.arange(sides)
    k = (i + 1) % sides
    faces = []
    for ring in range(rings - 1):
        a, b = ring * sides, (ring + 1) * sides
        faces += [np.stack([a + i, a + k, b + k], axis=1), np.stack([a + i, b + k, b + i], axis=1)]
    last = (rings - 1) * sides
    faces.append(np.stack([last + i, last + k, np.full(sides, rings * sides)], axis=1))
    return np.concatenate(faces).astype(np.int64)


def tubes(axis: ArrayF, radius: ArrayF, sides: int) -> ArrayF:
    """Vertices of tubes along polylines, for `tube_faces`.

    Parameters
    ----------
    axis : (n, r, 3) points along each axis.
    radius : (n, r) at these points.
    sides : corners of the cross-section.

    Returns
    -------
    vertices : (n, r * sides + 1, 3).
    """
    along = np.gradient(axis, axis=1)
    along /= np.maximum(np.linalg.norm(along, axis=2, keepdims=True), 1e-12)
    # A side vector that is not parallel to the axis: upright axes take east, the others up.
    upright = np.abs(along[..., 2:]) > 0.9
    aside = np.where(upright, np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    u = np.cross(aside, along)
    u /= np.linalg.norm(u, axis=2, keepdims=True)
    v = np.cross(along, u)
    turn = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    ring = np.cos(turn)[:, None] * u[:, :, None] + np.sin(turn)[:, None] * v[:, :, None]
    points = axis[:, :, None] + radius[:, :, None, None] * ring
    return np.concatenate([points.reshape(len(axis), axis.shape[1] * sides, 3), axis[:, -1:]], axis=1)


_BOX = np.array([[x, y, z] for z in (0, 1) for y in (-0.5, 0.5) for x in (-0.5, 0.5)], dtype=np.float64)

BOX_FACES = np.array(
    [[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4],
     [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5]]
)  # fmt: skip
"""Faces of a box from `boxes`, outward."""


def boxes(foot: ArrayF, size: ArrayF, turn_rad: ArrayF) -> ArrayF:
    """Vertices (n, 8, 3) of upright boxes.

    Parameters
    ----------
    foot : (n, 3) middle of the lower face, wcs.
    size : (n, 3) length, width, height, metres.
    turn_rad : (n,) direction of the length, counter-clockwise from east.
    """
    local = _BOX[None] * np.asarray(size)[:, None, :]
    return turned(local, np.asarray(turn_rad)) + np.asarray(foot)[:, None, :]


def turned(local: ArrayF, turn_rad: ArrayF) -> ArrayF:
    """Points (n, k, 3) turned about the vertical by (n,) angles, counter-clockwise."""
    cos, sin = np.cos(turn_rad)[:, None], np.sin(turn_rad)[:, None]
    x, y = local[..., 0], local[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y, np.broadcast_to(local[..., 2], x.shape)], axis=-1)
