"""Open triangle meshes of surfaces: normals, borders, orientation."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayB, ArrayF, ArrayI

NO_FACE: Final = -1
"""Stands for the face on the other side of a border edge."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TriangleMesh:
    """A surface of triangles; the front is the side from which their corners run counter-clockwise.

    Parameters
    ----------
    vertices_m : (n, 3) wcs.
    faces : (m, 3) indices of corners.
    sigma_m : (n,) standard deviation of each vertex along the surface normal.

    Raises
    ------
    GeometryError : shapes do not fit, values are not finite, or a face refers to a missing vertex.
    """

    vertices_m: ArrayF
    faces: ArrayI
    sigma_m: ArrayF

    def __post_init__(self) -> None:
        v, f = self.vertices_m, self.faces
        if v.ndim != 2 or v.shape[1] != 3 or f.ndim != 2 or f.shape[1] != 3 or self.sigma_m.shape != (len(v),):
            raise GeometryError(
                f"vertices {v.shape}, faces {f.shape}, sigmas {self.sigma_m.shape}",
                expected="(n, 3), (m, 3) and (n,)",
            )
        if not (np.isfinite(v).all() and np.isfinite(self.sigma_m).all() and (self.sigma_m >= 0).all()):
            raise GeometryError("a mesh whose vertices or sigmas are not finite, or a negative sigma")
        if len(f) and (f.min() < 0 or f.max() >= len(v)):
            raise GeometryError(f"corners from {f.min()} to {f.max()}", expected=f"0 to {len(v) - 1}")

    def face_normals(self) -> ArrayF:
        """Unit normals (m, 3) to the front; zero for faces without area."""
        a, b, c = (self.vertices_m[self.faces[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        return np.asarray(np.divide(normal, length, out=np.zeros_like(normal), where=length > 0))

    def neighbours(self) -> ArrayI:
        """Face (m, 3) across the edge from corner k to corner k + 1, `NO_FACE` on a border.

        An edge of more than two faces counts as a border: its surface has no two sides there.
        """
        m, n = len(self.faces), len(self.vertices_m)
        first, second = self.faces.ravel(), np.roll(self.faces, -1, axis=1).ravel()
        key = np.minimum(first, second).astype(np.int64) * n + np.maximum(first, second)
        order = np.argsort(key, kind="stable")
        _, start, size = np.unique(key[order], return_index=True, return_counts=True)
        out = np.full(3 * m, NO_FACE, dtype=np.int64)
        pairs = start[size == 2]
        one, other = order[pairs], order[pairs + 1]
        out[one], out[other] = other // 3, one // 3
        return out.reshape(m, 3)

    def border_faces(self) -> ArrayB:
        """Faces (m,) with at least one edge of their own alone."""
        return np.asarray((self.neighbours() == NO_FACE).any(axis=1))
