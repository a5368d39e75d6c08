"""Signed distances of points from a triangle mesh, correct on open meshes (P2 section 6.2).

The sign is the side of the nearest place: of its face, of the sum of both faces' normals on an edge, of the
sum of normals weighted by their angles at a corner (Baerentzen and Aanaes 2005, IEEE TVCG 11(3), theorem 1).
Counting how often a ray crosses the mesh, as Open3D's signed distance does, is wrong on an open mesh: a ray
that leaves through the open side crosses nothing.

Everything is float64, and the face found is the nearest of all. Open3D's own nearest points are float32: on a
mesh of 200 m they are up to 3 um farther than the nearest place, on faces of 10 m by 0.1 m up to 1 mm, which
cannot be mended at the faces beside.
"""

from dataclasses import dataclass
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import ArrayLike

from thalweg.core.errors import GeometryError
from thalweg.core.geometry.mesh import TriangleMesh
from thalweg.core.geometry.raycast import MAX_EXTENT_M
from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayI
from thalweg.surface.triangle_kernels import check, distances, faces_around

# ---------------------------------------------------------------- A packed tree of boxes over triangles: what
# `thalweg.surface.triangle_kernels` searches
#
# Faces are sorted along a Morton curve and packed: `LEAF` of them into a leaf, eight leaves into a node,
# eight nodes into the next, up to one (a packed R-tree). Nothing is balanced or searched while it is built,
# so that this takes little longer than a sort. Boxes are float64: the nearest face found with them is the
# nearest.


# Open3D brings an old TBB into the process, which numba would try first and complain about.
nb.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]

LEAF: Final = 4
"""Faces of a leaf: 2 is no faster and doubles the memory, 8 is a quarter slower."""

_CELLS = 65536.0
"""Cells of the Morton curve along each axis: 16 bits, so that a key is four digits of 12 bits."""

_BLOCK = 16384
"""Faces of a task."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TriangleTree:
    """Boxes over a mesh.

    ``order`` (m,) int32 the faces along the curve; ``boxes`` (k, 6, 8): low x, y, z and high x, y, z of the
    eight children of a node, empty boxes where there are fewer; ``level`` first node of each level, from the
    parents of the leaves to the top, and the number of nodes; ``low_m``, ``high_m`` (3,) the whole box.
    """

    order: AnyArray
    boxes: ArrayF
    level: ArrayI
    low_m: ArrayF
    high_m: ArrayF

    def curve(self, points_m: ArrayF) -> AnyArray:
        """Order (n,) int32 in which points (n, 3) come along the curve: neighbours search the same boxes."""
        n = len(points_m)
        keys = _keys(points_m, np.arange(n).reshape(n, 1), self.low_m, _scale(self.low_m, self.high_m))
        return _sorted(keys, nb.get_num_threads())


def triangle_tree(vertices_m: ArrayF, faces: ArrayI) -> TriangleTree:
    """Tree over the faces (m, 3) of vertices (n, 3), both contiguous; m > 0."""
    low, high = _bounds(vertices_m, faces)
    order = _sorted(_keys(vertices_m, faces, low, _scale(low, high)), nb.get_num_threads())
    boxes, level = _boxes(vertices_m, faces, order, LEAF)
    return TriangleTree(order=order, boxes=boxes, level=level, low_m=low, high_m=high)


def _scale(low: ArrayF, high: ArrayF) -> float:
    width = float((high - low).max())
    return _CELLS / width if width > 0 else 0.0


@nb.njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def _bounds(vertices: ArrayF, faces: ArrayI) -> tuple[ArrayF, ArrayF]:
    """Box of the vertices that faces use."""
    m = len(faces)
    blocks = (m + _BLOCK - 1) // _BLOCK
    low, high = np.empty((blocks, 3)), np.empty((blocks, 3))
    for block in nb.prange(blocks):
        for axis in range(3):
            least, most = np.inf, -np.inf
            for f in range(block * _BLOCK, min((block + 1) * _BLOCK, m)):
                for k in range(3):
                    x = vertices[faces[f, k], axis]
                    least, most = min(least, x), max(most, x)
            low[block, axis], high[block, axis] = least, most
    for block in range(1, blocks):
        for axis in range(3):
            low[0, axis] = min(low[0, axis], low[block, axis])
            high[0, axis] = max(high[0, axis], high[block, axis])
    return low[0].copy(), high[0].copy()


@nb.njit(inline="always", cache=True)
def _spread(cell: int) -> int:
    """The 16 bits of a cell number, with two zeros between them."""
    v = np.uint64(cell)
    v = (v | (v << np.uint64(16))) & np.uint64(0x0000FF0000FF)
    v = (v | (v << np.uint64(8))) & np.uint64(0x00F00F00F00F)
    v = (v | (v << np.uint64(4))) & np.uint64(0x0C30C30C30C3)
    return (v | (v << np.uint64(2))) & np.uint64(0x249249249249)  # type: ignore[return-value]


@nb.njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def _keys(vertices: ArrayF, members: ArrayI, low: ArrayF, scale: float) -> AnyArray:
    """Morton keys (m,) uint64 of the means of members (m, k); what lies outside counts as on the border."""
    m, count = members.shape
    keys = np.empty(m, dtype=np.uint64)
    for f in nb.prange(m):
        key = np.uint64(0)
        for axis in range(3):
            total = 0.0
            for k in range(count):
                total += vertices[members[f, k], axis]
            cell = min(max((total / count - low[axis]) * scale, 0.0), _CELLS - 1)
            key |= _spread(np.uint64(cell)) << np.uint64(axis)
        keys[f] = key
    return keys


@nb.njit(parallel=True, cache=True, nogil=True)
def _sorted(keys: AnyArray, parts: int) -> AnyArray:
    """Stable order (n,) int32 of keys (n,) below 2**48: four passes of counting; ``keys`` is overwritten."""
    n, mask = len(keys), np.uint64(4095)
    order, next_order = np.empty(n, dtype=np.int32), np.empty(n, dtype=np.int32)
    next_keys = np.empty(n, dtype=np.uint64)
    for i in nb.prange(n):
        order[i] = i
    for digit in range(4):
        shift = np.uint64(12 * digit)
        place = np.zeros((parts, 4096), dtype=np.int64)
        for part in nb.prange(parts):
            for i in range(n * part // parts, n * (part + 1) // parts):
                place[part, (keys[i] >> shift) & mask] += 1
        total = 0
        for value in range(4096):
            for part in range(parts):
                total, place[part, value] = total + place[part, value], total
        for part in nb.prange(parts):
            for i in range(n * part // parts, n * (part + 1) // parts):
                value = (keys[i] >> shift) & mask
                at = place[part, value]
                place[part, value] = at + 1
                next_keys[at], next_order[at] = keys[i], order[i]
        keys, next_keys = next_keys, keys
        order, next_order = next_order, order
    return order


@nb.njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def _boxes(vertices: ArrayF, faces: ArrayI, order: AnyArray, leaf: int) -> tuple[ArrayF, ArrayI]:
    """Boxes of all nodes, and the first node of each level."""
    m = len(faces)
    children, level = [(m + leaf - 1) // leaf], [0]
    while True:
        nodes = (children[-1] + 7) // 8
        level.append(level[-1] + nodes)
        if nodes == 1:
            break
        children.append(nodes)
    boxes = np.empty((level[-1], 6, 8))
    for node in nb.prange(level[1]):
        for s in range(8):
            low_x = low_y = low_z = np.inf
            high_x = high_y = high_z = -np.inf
            first = (node * 8 + s) * leaf
            for i in range(first, min(first + leaf, m)):
                for k in range(3):
                    v = faces[order[i], k]
                    x, y, z = vertices[v, 0], vertices[v, 1], vertices[v, 2]
                    low_x, low_y, low_z = min(low_x, x), min(low_y, y), min(low_z, z)
                    high_x, high_y, high_z = max(high_x, x), max(high_y, y), max(high_z, z)
            boxes[node, 0, s], boxes[node, 1, s], boxes[node, 2, s] = low_x, low_y, low_z
            boxes[node, 3, s], boxes[node, 4, s], boxes[node, 5, s] = high_x, high_y, high_z
    for here in range(1, len(children)):
        for node in range(level[here], level[here + 1]):
            for s in range(8):
                child = (node - level[here]) * 8 + s
                for axis in range(3):
                    low, high = np.inf, -np.inf
                    if child < children[here]:
                        below = level[here - 1] + child
                        for k in range(8):
                            low = min(low, boxes[below, axis, k])
                            high = max(high, boxes[below, axis + 3, k])
                    boxes[node, axis, s], boxes[node, axis + 3, s] = low, high
    return boxes, np.array(level)


# ---------------------------------------------------------------- cloud to mesh


CHUNK: Final = 1 << 20
"""Points that are searched at once; bounds the memory beside the results."""

FAR_M: Final = 1000.0
"""If no point at all is nearer to the mesh's box than this, both are not in one frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Distances:
    """Distances of points from a surface, in the order of the points.

    ``distance_m`` (n,) positive in front of the surface, negative behind it; ``nearest_m`` (n, 3) the nearest
    place; ``normal`` (n, 3) its unit pseudo-normal to the front, zero where only faces without area meet;
    ``face`` (n,) a face that holds the place; ``at_border`` (n,) whether the place lies on a border edge or
    at a corner of one, so that the distance says where the mesh ends, or where the surface has no two sides
    (edges of more than two faces, or of two that face opposite ways); ``sigma_m`` (n,) the vertices' standard
    deviations, interpolated.
    """

    distance_m: ArrayF
    nearest_m: ArrayF
    normal: ArrayF
    face: ArrayI
    at_border: ArrayB
    sigma_m: ArrayF


class Surface:
    """A mesh to which distances are asked.

    Parameters
    ----------
    mesh : open or closed, faces turned alike. Corners that only coincide are not joined: a seam of doubled
        vertices is a border.

    Raises
    ------
    GeometryError : the mesh has no face, or is wider than 20 km.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        if len(mesh.faces) == 0:
            raise GeometryError(
                f"a mesh of {len(mesh.vertices_m)} vertices without a face",
                expected="at least one triangle",
                cure="Enlarge the area, or the longest edge that triangles may have",
            )
        self.mesh = mesh
        self._vertices = np.ascontiguousarray(mesh.vertices_m, dtype=np.float64)
        self._faces = np.ascontiguousarray(mesh.faces, dtype=np.int64)
        self._tree = triangle_tree(self._vertices, self._faces)
        if (width := float((self._tree.high_m - self._tree.low_m).max())) > MAX_EXTENT_M:
            raise GeometryError(
                f"a mesh {width / 1000:.1f} km wide",
                expected=f"at most {MAX_EXTENT_M / 1000:.0f} km",
                cure="Cut the mesh to the survey area and drop broken vertices",
            )
        self._sigma = np.ascontiguousarray(mesh.sigma_m, dtype=np.float64)
        self._start, self._around = faces_around(self._faces, len(self._vertices))
        self._corner_state = np.zeros(len(self._vertices), dtype=np.int8)

    def distances(self, points_m: ArrayLike) -> Distances:
        """Signed distances of points from the mesh.

        Parameters
        ----------
        points_m : (n, 3), in the frame of the mesh.

        Raises
        ------
        GeometryError : another shape, points that are not finite, or all of them kilometres away.
        """
        p = np.ascontiguousarray(points_m, dtype=np.float64)
        self._check(p)
        n, tree = len(p), self._tree
        out = Distances(
            distance_m=np.empty(n),
            nearest_m=np.empty((n, 3)),
            normal=np.empty((n, 3)),
            face=np.empty(n, dtype=np.int64),
            at_border=np.empty(n, dtype=np.bool_),
            sigma_m=np.empty(n),
        )
        for first in range(0, n, CHUNK):
            part = slice(first, min(first + CHUNK, n))
            distances(
                p[part],
                tree.curve(p[part]),
                self._vertices,
                self._faces,
                self._sigma,
                (tree.order, tree.boxes, tree.level, LEAF),
                self._start,
                self._around,
                self._corner_state,
                out.distance_m[part],
                out.nearest_m[part],
                out.normal[part],
                out.face[part],
                out.at_border[part],
                out.sigma_m[part],
            )
        return out

    def _check(self, p: ArrayF) -> None:
        if p.ndim != 2 or p.shape[1] != 3:
            raise GeometryError(f"points of shape {p.shape}", expected="(n, 3)")
        low, high = self._tree.low_m, self._tree.high_m
        bad, first, gap_m = check(p, low, high)
        if bad:
            raise GeometryError(
                f"{bad} of {len(p)} points are not finite, the first is number {first}: {p[first]}",
                expected="finite coordinates",
                cure="Drop points without a pose before the comparison",
            )
        if len(p) and gap_m > FAR_M:
            raise GeometryError(
                f"all {len(p)} points lie at least {gap_m / 1000:.1f} km from the mesh, "
                f"which spans {low.round(1)} to {high.round(1)} m",
                expected="points and mesh in one frame",
                cure="Bring both into the local frame of the campaign: one may be in map coordinates",
            )
