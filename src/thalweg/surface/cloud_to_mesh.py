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
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayI, GeometryError, get_num_threads, njit, prange
from thalweg.core.geometry import MAX_EXTENT_M, TriangleMesh

CHUNK: Final = 1 << 20
"""Points that are searched at once; bounds the memory beside the results."""
FAR_M: Final = 1000.0
"""If no point at all is nearer to the mesh's box than this, both are not in one frame."""
LEAF: Final = 4
"""Faces of a leaf: 2 is no faster and doubles the memory, 8 is a quarter slower."""
_CELLS = 65536.0
"""Cells of the Morton curve along each axis: 16 bits, so that a key is four digits of 12 bits."""
_FACES_OF_TASK = 16384
"""Faces of a task."""

_FLAT = 1e-12
"""Triangles lower than this share of their longest edge have no area: their normal would be rounding."""
_OPPOSED = 1e-6
"""Normals whose sum is shorter than this share of their weight name no side."""
_SHORT = 1.0 - 1e-12
"""Rounding of squared distances, and much more."""
_STACK = 128
"""Open nodes: at most 7 more a level, and 2**31 faces have 11 levels."""
_POINTS_OF_TASK = 2048
"""Points of a task."""
_UNKNOWN, _INNER, _BORDER = 0, 1, 2
"""What is known of a corner."""


# ---------------------------------------------------------------- distances


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


# ---------------------------------------------------------------- A packed tree of boxes over triangles: what
# `thalweg.surface.cloud_to_mesh` searches
#
# Faces are sorted along a Morton curve and packed: `LEAF` of them into a leaf, eight leaves into a node,
# eight nodes into the next, up to one (a packed R-tree). Nothing is balanced or searched while it is built,
# so that this takes little longer than a sort. Boxes are float64: the nearest face found with them is the
# nearest.


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
        return _sorted(keys, get_num_threads())


def triangle_tree(vertices_m: ArrayF, faces: ArrayI) -> TriangleTree:
    """Tree over the faces (m, 3) of vertices (n, 3), both contiguous; m > 0."""
    low, high = _bounds(vertices_m, faces)
    order = _sorted(_keys(vertices_m, faces, low, _scale(low, high)), get_num_threads())
    boxes, level = _boxes(vertices_m, faces, order, LEAF)
    return TriangleTree(order=order, boxes=boxes, level=level, low_m=low, high_m=high)


def _scale(low: ArrayF, high: ArrayF) -> float:
    width = float((high - low).max())
    return _CELLS / width if width > 0 else 0.0


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def _bounds(vertices: ArrayF, faces: ArrayI) -> tuple[ArrayF, ArrayF]:
    """Box of the vertices that faces use."""
    m = len(faces)
    blocks = (m + _FACES_OF_TASK - 1) // _FACES_OF_TASK
    low, high = np.empty((blocks, 3)), np.empty((blocks, 3))
    for block in prange(blocks):
        for axis in range(3):
            least, most = np.inf, -np.inf
            for f in range(block * _FACES_OF_TASK, min((block + 1) * _FACES_OF_TASK, m)):
                for k in range(3):
                    x = vertices[faces[f, k], axis]
                    least, most = min(least, x), max(most, x)
            low[block, axis], high[block, axis] = least, most
    for block in range(1, blocks):
        for axis in range(3):
            low[0, axis] = min(low[0, axis], low[block, axis])
            high[0, axis] = max(high[0, axis], high[block, axis])
    return low[0].copy(), high[0].copy()


@njit(inline="always", cache=True)
def _spread(cell: int) -> int:
    """The 16 bits of a cell number, with two zeros between them."""
    v = np.uint64(cell)
    v = (v | (v << np.uint64(16))) & np.uint64(0x0000FF0000FF)
    v = (v | (v << np.uint64(8))) & np.uint64(0x00F00F00F00F)
    v = (v | (v << np.uint64(4))) & np.uint64(0x0C30C30C30C3)
    return (v | (v << np.uint64(2))) & np.uint64(0x249249249249)  # type: ignore[return-value]


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def _keys(vertices: ArrayF, members: ArrayI, low: ArrayF, scale: float) -> AnyArray:
    """Morton keys (m,) uint64 of the means of members (m, k); what lies outside counts as on the border."""
    m, count = members.shape
    keys = np.empty(m, dtype=np.uint64)
    for f in prange(m):
        key = np.uint64(0)
        for axis in range(3):
            total = 0.0
            for k in range(count):
                total += vertices[members[f, k], axis]
            cell = min(max((total / count - low[axis]) * scale, 0.0), _CELLS - 1)
            key |= _spread(np.uint64(cell)) << np.uint64(axis)
        keys[f] = key
    return keys


@njit(parallel=True, cache=True, nogil=True)
def _sorted(keys: AnyArray, parts: int) -> AnyArray:
    """Stable order (n,) int32 of keys (n,) below 2**48: four passes of counting; ``keys`` is overwritten."""
    n, mask = len(keys), np.uint64(4095)
    order, next_order = np.empty(n, dtype=np.int32), np.empty(n, dtype=np.int32)
    next_keys = np.empty(n, dtype=np.uint64)
    for i in prange(n):
        order[i] = i
    for digit in range(4):
        shift = np.uint64(12 * digit)
        place = np.zeros((parts, 4096), dtype=np.int64)
        for part in prange(parts):
            for i in range(n * part // parts, n * (part + 1) // parts):
                place[part, (keys[i] >> shift) & mask] += 1
        total = 0
        for value in range(4096):
            for part in range(parts):
                total, place[part, value] = total + place[part, value], total
        for part in prange(parts):
            for i in range(n * part // parts, n * (part + 1) // parts):
                value = (keys[i] >> shift) & mask
                at = place[part, value]
                place[part, value] = at + 1
                next_keys[at], next_order[at] = keys[i], order[i]
        keys, next_keys = next_keys, keys
        order, next_order = next_order, order
    return order


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
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
    for node in prange(level[1]):
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


# ---------------------------------------------------------------- compiled loops: nearest place of triangles,
# and its side
#
# A nearest place lies inside a face, on an edge, or at a corner. Its *feature* is a number: 0 for the face,
# 1 to 3 for the edge from corner k - 1 to the next, 4 to 6 for corner k - 4. Coordinates are taken relative
# to the point before anything is multiplied, so that map coordinates lose nothing.


@njit(cache=True, nogil=True, error_model="numpy")
def faces_around(faces: ArrayI, n_vertices: int) -> tuple[ArrayI, AnyArray]:
    """``start`` (n + 2,) and ``around`` int32: faces of corner v are ``around[start[v]:start[v + 1]]``.

    They stand in the order of their numbers. A face that names a corner twice is no surface and left out.
    """
    start = np.zeros(n_vertices + 2, dtype=np.int64)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if a != b and b != c and c != a:
            start[a + 2] += 1
            start[b + 2] += 1
            start[c + 2] += 1
    for v in range(2, n_vertices + 2):
        start[v] += start[v - 1]
    around = np.empty(start[n_vertices + 1], dtype=np.int32)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if a != b and b != c and c != a:
            for v in (a, b, c):
                around[start[v + 1]] = f
                start[v + 1] += 1
    return start, around


@njit(inline="always", cache=True, error_model="numpy")
def _cross(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> tuple[float, float, float]:
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@njit(cache=True, nogil=True, error_model="numpy")
def _on_edge(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float
) -> tuple[float, float, float, float, float]:
    """Squared distance of the origin from an edge, share of the way from a to b, and the place."""
    ex, ey, ez = bx - ax, by - ay, bz - az
    square = ex * ex + ey * ey + ez * ez
    along = -(ax * ex + ay * ey + az * ez)
    if along <= 0.0:
        return ax * ax + ay * ay + az * az, 0.0, ax, ay, az
    if along >= square:
        return bx * bx + by * by + bz * bz, 1.0, bx, by, bz
    t = along / square
    x, y, z = ax + t * ex, ay + t * ey, az + t * ez
    return x * x + y * y + z * z, t, x, y, z


@njit(cache=True, nogil=True, error_model="numpy")
def _place(
    px: float, py: float, pz: float, vertices: ArrayF, faces: ArrayI, f: int
) -> tuple[float, int, float, float, float, float, float]:
    """Nearest place of a face: squared distance, feature, place minus point, weights of corners 1 and 2."""
    a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
    ax, ay, az = vertices[a, 0] - px, vertices[a, 1] - py, vertices[a, 2] - pz
    bx, by, bz = vertices[b, 0] - px, vertices[b, 1] - py, vertices[b, 2] - pz
    cx, cy, cz = vertices[c, 0] - px, vertices[c, 1] - py, vertices[c, 2] - pz
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = cx - bx, cy - by, cz - bz
    wx, wy, wz = ax - cx, ay - cy, az - cz
    nx, ny, nz = _cross(ux, uy, uz, vx, vy, vz)
    square = nx * nx + ny * ny + nz * nz
    longest = max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz)
    of_a = of_b = of_c = 0.0
    if square > (_FLAT * longest) ** 2:
        # twice the areas that the foot of the perpendicular spans with each edge, times that of the face
        mx, my, mz = _cross(nx, ny, nz, ux, uy, uz)
        of_c = -(ax * mx + ay * my + az * mz)
        mx, my, mz = _cross(nx, ny, nz, vx, vy, vz)
        of_a = -(bx * mx + by * my + bz * mz)
        mx, my, mz = _cross(nx, ny, nz, wx, wy, wz)
        of_b = -(cx * mx + cy * my + cz * mz)
        if of_a > 0.0 and of_b > 0.0 and of_c > 0.0:
            height = (nx * ax + ny * ay + nz * az) / square
            total = of_a + of_b + of_c
            x, y, z = height * nx, height * ny, height * nz
            return height * height * square, 0, x, y, z, of_b / total, of_c / total
    # outside, the nearest place is on an edge behind which the foot lies; without area on any edge
    best, feature, x, y, z, w1, w2 = np.inf, 0, 0.0, 0.0, 0.0, 0.0, 0.0
    if of_c <= 0.0:
        best, t, x, y, z = _on_edge(ax, ay, az, bx, by, bz)
        feature = 4 if t == 0.0 else 5 if t == 1.0 else 1
        w1 = t
    if of_a <= 0.0:
        d, t, ex, ey, ez = _on_edge(bx, by, bz, cx, cy, cz)
        if d < best:
            best, x, y, z = d, ex, ey, ez
            feature = 5 if t == 0.0 else 6 if t == 1.0 else 2
            w1, w2 = 1.0 - t, t
    if of_b <= 0.0:
        d, t, ex, ey, ez = _on_edge(cx, cy, cz, ax, ay, az)
        if d < best:
            best, x, y, z = d, ex, ey, ez
            feature = 6 if t == 0.0 else 4 if t == 1.0 else 3
            w1, w2 = 0.0, 1.0 - t
    return best, feature, x, y, z, w1, w2


@njit(cache=True, nogil=True, error_model="numpy")
def _normal(vertices: ArrayF, faces: ArrayI, f: int) -> tuple[float, float, float]:
    """Unit normal of a face to its front, zero without area."""
    a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
    ux, uy, uz = (
        vertices[b, 0] - vertices[a, 0],
        vertices[b, 1] - vertices[a, 1],
        vertices[b, 2] - vertices[a, 2],
    )
    vx, vy, vz = (
        vertices[c, 0] - vertices[b, 0],
        vertices[c, 1] - vertices[b, 1],
        vertices[c, 2] - vertices[b, 2],
    )
    wx, wy, wz = ux + vx, uy + vy, uz + vz
    nx, ny, nz = _cross(ux, uy, uz, vx, vy, vz)
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    longest = max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz)
    if not length > _FLAT * longest:
        return 0.0, 0.0, 0.0
    return nx / length, ny / length, nz / length


@njit(cache=True, nogil=True, error_model="numpy")
def _corner_of(faces: ArrayI, f: int, v: int) -> int:
    """Which corner of face ``f`` the vertex ``v`` is."""
    return 0 if faces[f, 0] == v else 1 if faces[f, 1] == v else 2


@njit(cache=True, nogil=True, error_model="numpy")
def _is_border_corner(faces: ArrayI, start: ArrayI, around: AnyArray, u: int) -> bool:
    """Whether an edge at the corner has not exactly one face on each side.

    Else the faces there lead to each neighbouring corner once and come back from each once.
    """
    n = start[u + 1] - start[u]
    ahead, behind = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    for i in range(n):
        g = np.int64(around[start[u] + i])
        k = _corner_of(faces, g, u)
        ahead[i], behind[i] = faces[g, (k + 1) % 3], faces[g, (k + 2) % 3]
    ahead.sort()
    behind.sort()
    bad = False
    for i in range(n):
        bad |= ahead[i] != behind[i] or (i > 0 and ahead[i] == ahead[i - 1])
    return bad


@njit(cache=True, nogil=True, error_model="numpy")
def _edge_normal(
    vertices: ArrayF, faces: ArrayI, start: ArrayI, around: AnyArray, u: int, v: int
) -> tuple[float, float, float, float, bool]:
    """Sum of the normals at an edge, its weight, and whether the edge is a border."""
    x = y = z = weight = 0.0
    there = back = 0
    for i in range(start[u], start[u + 1]):
        g = np.int64(around[i])
        k = _corner_of(faces, g, u)
        ahead, behind = faces[g, (k + 1) % 3] == v, faces[g, (k + 2) % 3] == v
        if ahead or behind:
            nx, ny, nz = _normal(vertices, faces, g)
            x, y, z, weight = x + nx, y + ny, z + nz, weight + 1.0
            there, back = there + ahead, back + behind
    return x, y, z, weight, there != 1 or back != 1


@njit(cache=True, nogil=True, error_model="numpy")
def _corner_normal(
    vertices: ArrayF, faces: ArrayI, start: ArrayI, around: AnyArray, u: int
) -> tuple[float, float, float, float]:
    """Sum of the normals at a corner, each times the angle of its face there, and the sum of the angles."""
    x = y = z = weight = 0.0
    for i in range(start[u], start[u + 1]):
        g = np.int64(around[i])
        k = _corner_of(faces, g, u)
        b, c = faces[g, (k + 1) % 3], faces[g, (k + 2) % 3]
        px, py, pz = (
            vertices[b, 0] - vertices[u, 0],
            vertices[b, 1] - vertices[u, 1],
            vertices[b, 2] - vertices[u, 2],
        )
        qx, qy, qz = (
            vertices[c, 0] - vertices[u, 0],
            vertices[c, 1] - vertices[u, 1],
            vertices[c, 2] - vertices[u, 2],
        )
        cx, cy, cz = _cross(px, py, pz, qx, qy, qz)
        angle = np.arctan2(np.sqrt(cx * cx + cy * cy + cz * cz), px * qx + py * qy + pz * qz)
        nx, ny, nz = _normal(vertices, faces, g)
        x, y, z, weight = x + angle * nx, y + angle * ny, z + angle * nz, weight + angle
    return x, y, z, weight


@njit(cache=True, nogil=True, error_model="numpy")
def _side(
    vertices: ArrayF,
    faces: ArrayI,
    start: ArrayI,
    around: AnyArray,
    corner_state: AnyArray,
    f: int,
    feature: int,
) -> tuple[float, float, float, bool]:
    """Unit pseudo-normal at a feature of face ``f``, and whether it is a border or has no two sides."""
    nx, ny, nz = _normal(vertices, faces, f)
    if feature == 0:
        return nx, ny, nz, False
    u = faces[f, (feature - 1) % 3]
    if feature < 4:
        v = faces[f, feature % 3]
        x, y, z, weight, border = _edge_normal(vertices, faces, start, around, u, v)
    else:
        x, y, z, weight = _corner_normal(vertices, faces, start, around, u)
        if corner_state[u] == _UNKNOWN:
            # threads that meet here write the same
            bad = _is_border_corner(faces, start, around, u)
            corner_state[u] = _BORDER if bad else _INNER
        border = corner_state[u] == _BORDER
    length = np.sqrt(x * x + y * y + z * z)
    if length > _OPPOSED * weight:
        return x / length, y / length, z / length, border
    return nx, ny, nz, True


@njit(inline="always", cache=True, error_model="numpy")
def _boxes_away(px: float, py: float, pz: float, boxes: ArrayF, node: int, away: ArrayF) -> None:
    """Squared distances of the point from eight boxes, a little short so that rounding leaves none out."""
    for s in range(8):
        dx = max(max(boxes[node, 0, s] - px, px - boxes[node, 3, s]), 0.0)
        dy = max(max(boxes[node, 1, s] - py, py - boxes[node, 4, s]), 0.0)
        dz = max(max(boxes[node, 2, s] - pz, pz - boxes[node, 5, s]), 0.0)
        away[s] = (dx * dx + dy * dy + dz * dz) * _SHORT


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest_face(
    px: float,
    py: float,
    pz: float,
    vertices: ArrayF,
    faces: ArrayI,
    tree: tuple[AnyArray, ArrayF, ArrayI, int],
    stack: tuple[ArrayF, ArrayI, ArrayI, ArrayF],
    f: int,
) -> int:
    """Nearest face, the lowest of several; ``f`` is a guess."""
    order, boxes, first, leaf = tree
    away, child, level, of_eight = stack
    best = _place(px, py, pz, vertices, faces, f)[0]
    away[0], child[0], level[0], size = 0.0, 0, len(first) - 1, 1
    while size > 0:
        size -= 1
        if away[size] > best:
            continue
        here, at = child[size], level[size]
        if at == 0:
            for i in range(here * leaf, min((here + 1) * leaf, len(order))):
                g: Any = np.int64(order[i])
                d = _place(px, py, pz, vertices, faces, g)[0]
                if d < best or (d == best and g < f):
                    best, f = d, g
            continue
        _boxes_away(px, py, pz, boxes, first[at - 1] + here, of_eight)
        bottom = size
        for s in range(8):
            d = of_eight[s]
            if d <= best:
                # the nearest box goes on top
                k = size
                while k > bottom and away[k - 1] < d:
                    away[k], child[k], level[k] = away[k - 1], child[k - 1], level[k - 1]
                    k -= 1
                away[k], child[k], level[k] = d, here * 8 + s, at - 1
                size += 1
    return f


@njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def distances(
    points: ArrayF,
    turn: AnyArray,
    vertices: ArrayF,
    faces: ArrayI,
    sigma: ArrayF,
    tree: tuple[AnyArray, ArrayF, ArrayI, int],
    start: ArrayI,
    around: AnyArray,
    corner_state: AnyArray,
    distance: ArrayF,
    nearest: ArrayF,
    normal: ArrayF,
    face: ArrayI,
    at_border: ArrayB,
    sigma_out: ArrayF,
) -> None:
    """Signed distances of points (n, 3), taken in the order ``turn`` so that one is near to the next.

    ``tree`` is order, boxes, level and faces of a leaf of `thalweg.surface.cloud_to_mesh`; ``corner_state``
    (vertices,) remembers which corners are borders, 0 at first.
    """
    n = len(points)
    for block in prange((n + _POINTS_OF_TASK - 1) // _POINTS_OF_TASK):
        stack = (
            np.empty(_STACK),
            np.empty(_STACK, dtype=np.int64),
            np.empty(_STACK, dtype=np.int64),
            np.empty(8),
        )
        f = np.int64(0)  # of the type of all faces: with 0 each function below is compiled twice
        for j in range(block * _POINTS_OF_TASK, min((block + 1) * _POINTS_OF_TASK, n)):
            i = turn[j]
            px, py, pz = points[i, 0], points[i, 1], points[i, 2]
            f = _nearest_face(px, py, pz, vertices, faces, tree, stack, f)
            square, feature, x, y, z, w1, w2 = _place(px, py, pz, vertices, faces, f)
            nx, ny, nz, border = _side(vertices, faces, start, around, corner_state, f, feature)
            behind = x * nx + y * ny + z * nz > 0.0
            distance[i] = -np.sqrt(square) if behind else np.sqrt(square)
            nearest[i, 0], nearest[i, 1], nearest[i, 2] = px + x, py + y, pz + z
            normal[i, 0], normal[i, 1], normal[i, 2] = nx, ny, nz
            face[i], at_border[i] = f, border
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            sigma_out[i] = (1.0 - w1 - w2) * sigma[a] + w1 * sigma[b] + w2 * sigma[c]


@njit(cache=True, nogil=True, error_model="numpy")
def check(points: ArrayF, low: ArrayF, high: ArrayF) -> tuple[int, int, float]:
    """Number of points that are not finite, the first of them, and the least distance from a box."""
    bad, first, gap = 0, -1, np.inf
    for i in range(len(points)):
        square = total = 0.0
        for axis in range(3):
            x = points[i, axis]
            total += x - x  # NaN if x is not finite
            out = max(max(low[axis] - x, x - high[axis]), 0.0)
            square += out * out
        if total != 0.0:
            bad += 1
            first = i if first < 0 else first
        gap = min(gap, square)
    return bad, first, np.sqrt(gap)
