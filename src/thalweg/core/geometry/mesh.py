"""Open triangle meshes of surfaces: normals, borders, orientation."""

from dataclasses import dataclass
from typing import Final

import numba as nb
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

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
        if v.shape != (len(v), 3) or f.shape != (len(f), 3) or self.sigma_m.shape != (len(v),):
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
        faces = np.ascontiguousarray(self.faces, dtype=np.int64)
        return _neighbours(faces, len(self.vertices_m), NO_FACE)

    def border_faces(self) -> ArrayB:
        """Faces (m,) with at least one edge of their own alone, or shared by more than two."""
        return np.asarray((self.neighbours() == NO_FACE).any(axis=1))

    def areas_m2(self) -> ArrayF:
        """Areas (m,) of the faces."""
        a, b, c = (self.vertices_m[self.faces[:, k]] for k in range(3))
        return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)

    def part(self, keep: ArrayB) -> "TriangleMesh":
        """The faces for which ``keep`` (m,) is true, and the vertices that they need."""
        faces = self.faces[keep]
        used = np.zeros(len(self.vertices_m), dtype=np.bool_)
        used[faces] = True
        number = np.cumsum(used) - 1
        return TriangleMesh(vertices_m=self.vertices_m[used], faces=number[faces], sigma_m=self.sigma_m[used])

    def pieces(self) -> ArrayI:
        """Number (m,) of the connected piece of each face; faces are connected by a common edge."""
        across = self.neighbours()
        face, corner = np.nonzero(across != NO_FACE)
        links = coo_array(
            (np.ones(len(face), dtype=np.int8), (face, across[face, corner])), shape=(len(across),) * 2
        )
        return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _neighbours(faces: ArrayI, n: int, no_face: int) -> ArrayI:
    """Faces across each edge: edges are laid down at their lower corner, and partners looked for there.

    A corner has some six edges, so nothing needs to be sorted: 5 million faces take well below a second,
    a sort of their 15 million edges several.
    """
    m = len(faces)
    start = np.zeros(n + 1, dtype=np.int64)
    for f in range(m):
        for k in range(3):
            start[min(faces[f, k], faces[f, (k + 1) % 3]) + 1] += 1
    for v in range(n):
        start[v + 1] += start[v]
    fill = start[:n].copy()
    edge, other = np.empty(3 * m, dtype=np.int64), np.empty(3 * m, dtype=np.int64)
    for f in range(m):
        for k in range(3):
            a, b = faces[f, k], faces[f, (k + 1) % 3]
            at = fill[min(a, b)]
            edge[at], other[at] = 3 * f + k, max(a, b)
            fill[min(a, b)] += 1
    out = np.full((m, 3), no_face, dtype=np.int64)
    for v in range(n):
        first, end = start[v], start[v + 1]
        if end - first > 64:  # the hub of a fan: every edge against every other would be slow
            order = np.argsort(other[first:end], kind="mergesort")
            edge[first:end] = edge[first:end][order]
            other[first:end] = other[first:end][order]
        else:
            for i in range(first + 1, end):
                e, o, j = edge[i], other[i], i - 1
                while j >= first and other[j] > o:
                    edge[j + 1], other[j + 1] = edge[j], other[j]
                    j -= 1
                edge[j + 1], other[j + 1] = e, o
        i = first
        while i < end:
            j = i + 1
            while j < end and other[j] == other[i]:
                j += 1
            if j - i == 2:
                one, two = edge[i], edge[i + 1]
                out[one // 3, one % 3], out[two // 3, two % 3] = two // 3, one // 3
            i = j
    return out
