"""Compiled loops of `thalweg.surface.cloud_to_mesh`: nearest place of triangles, and which way it faces.

A nearest place lies inside a face, on an edge, or at a corner. Its *feature* is a number: 0 for the face,
1 to 3 for the edge from corner k - 1 to the next, 4 to 6 for corner k - 4. Coordinates are taken relative to
the point before anything is multiplied, so that map coordinates lose nothing.
"""

import numba as nb
import numpy as np

from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayI

# Open3D brings an old TBB into the process, which numba would try first and complain about.
nb.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]

_FLAT = 1e-12
"""Triangles lower than this share of their longest edge have no area: their normal would be rounding."""

_OPPOSED = 1e-6
"""Normals whose sum is shorter than this share of their weight name no side."""

_SHORT = 1.0 - 1e-12
"""Rounding of squared distances, and much more."""

_STACK = 128
"""Open nodes: at most 7 more a level, and 2**31 faces have 11 levels."""

_BLOCK = 2048
"""Points of a task."""

_UNKNOWN, _INNER, _BORDER = 0, 1, 2
"""What is known of a corner."""


@nb.njit(cache=True, nogil=True, error_model="numpy")
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


@nb.njit(inline="always", cache=True, error_model="numpy")
def _cross(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> tuple[float, float, float]:
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@nb.njit(cache=True, nogil=True, error_model="numpy")
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


@nb.njit(cache=True, nogil=True, error_model="numpy")
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


@nb.njit(cache=True, nogil=True, error_model="numpy")
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


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _corner_of(faces: ArrayI, f: int, v: int) -> int:
    """Which corner of face ``f`` the vertex ``v`` is."""
    return 0 if faces[f, 0] == v else 1 if faces[f, 1] == v else 2


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _is_border_corner(faces: ArrayI, start: ArrayI, around: AnyArray, u: int) -> bool:
    """Whether an edge at the corner has not exactly one face on each side.

    Else the faces there lead to each neighbouring corner once and come back from each once.
    """
    n = start[u + 1] - start[u]
    ahead, behind = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    for i in range(n):
        g = around[start[u] + i]
        k = _corner_of(faces, g, u)
        ahead[i], behind[i] = faces[g, (k + 1) % 3], faces[g, (k + 2) % 3]
    ahead.sort()
    behind.sort()
    bad = False
    for i in range(n):
        bad |= ahead[i] != behind[i] or (i > 0 and ahead[i] == ahead[i - 1])
    return bad


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _edge_normal(
    vertices: ArrayF, faces: ArrayI, start: ArrayI, around: AnyArray, u: int, v: int
) -> tuple[float, float, float, float, bool]:
    """Sum of the normals at an edge, its weight, and whether the edge is a border."""
    x = y = z = weight = 0.0
    there = back = 0
    for i in range(start[u], start[u + 1]):
        g = around[i]
        k = _corner_of(faces, g, u)
        ahead, behind = faces[g, (k + 1) % 3] == v, faces[g, (k + 2) % 3] == v
        if ahead or behind:
            nx, ny, nz = _normal(vertices, faces, g)
            x, y, z, weight = x + nx, y + ny, z + nz, weight + 1.0
            there, back = there + ahead, back + behind
    return x, y, z, weight, there != 1 or back != 1


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _corner_normal(
    vertices: ArrayF, faces: ArrayI, start: ArrayI, around: AnyArray, u: int
) -> tuple[float, float, float, float]:
    """Sum of the normals at a corner, each times the angle of its face there, and the sum of the angles."""
    x = y = z = weight = 0.0
    for i in range(start[u], start[u + 1]):
        g = around[i]
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


@nb.njit(cache=True, nogil=True, error_model="numpy")
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


@nb.njit(inline="always", cache=True, error_model="numpy")
def _boxes_away(px: float, py: float, pz: float, boxes: ArrayF, node: int, away: ArrayF) -> None:
    """Squared distances of the point from eight boxes, a little short so that rounding leaves none out."""
    for s in range(8):
        dx = max(max(boxes[node, 0, s] - px, px - boxes[node, 3, s]), 0.0)
        dy = max(max(boxes[node, 1, s] - py, py - boxes[node, 4, s]), 0.0)
        dz = max(max(boxes[node, 2, s] - pz, pz - boxes[node, 5, s]), 0.0)
        away[s] = (dx * dx + dy * dy + dz * dz) * _SHORT


@nb.njit(cache=True, nogil=True, error_model="numpy")
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
                g = order[i]
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


@nb.njit(parallel=True, cache=True, nogil=True, error_model="numpy")
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
    for block in nb.prange((n + _BLOCK - 1) // _BLOCK):
        stack = (
            np.empty(_STACK), np.empty(_STACK, dtype=np.int64), np.empty(_STACK, dtype=np.int64), np.empty(8)
        )  # fmt: skip
        f = 0
        for j in range(block * _BLOCK, min((block + 1) * _BLOCK, n)):
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


@nb.njit(cache=True, nogil=True, error_model="numpy")
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
