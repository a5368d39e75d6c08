"""Loops over rays that meet the land: normals, kinds of ground, footprints, light, boards, edges."""

import numba as nb
import numpy as np

# Open3D brings an old TBB into the process, which numba would try first and complain about.
nb.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]


@nb.njit(cache=True, error_model="numpy")
def _mixed(ix, iy, iz, seed):  # type: ignore[no-untyped-def]
    """A number in [0, 1) that belongs to a lattice point."""
    h = ix * 374761393 + iy * 668265263 + iz * 2147483647 + seed * 1274126177
    h = (h ^ (h >> 29)) * 5871781006564002453
    h = (h ^ (h >> 32)) * 1181783497276652981
    return ((h >> 24) & 16777215) * 5.9604644775390625e-08


@nb.njit(cache=True, error_model="numpy")
def _value(x, y, z, seed):  # type: ignore[no-untyped-def]
    """Value noise in [-1, 1] of spacing 1."""
    fx, fy, fz = np.floor(x), np.floor(y), np.floor(z)
    ix, iy, iz = np.int64(fx), np.int64(fy), np.int64(fz)
    x, y, z = x - fx, y - fy, z - fz
    u, v, w = x * x * (3 - 2 * x), y * y * (3 - 2 * y), z * z * (3 - 2 * z)
    a, b = _mixed(ix, iy, iz, seed), _mixed(ix + 1, iy, iz, seed)
    c, d = _mixed(ix, iy + 1, iz, seed), _mixed(ix + 1, iy + 1, iz, seed)
    e, f = _mixed(ix, iy, iz + 1, seed), _mixed(ix + 1, iy, iz + 1, seed)
    g, h = _mixed(ix, iy + 1, iz + 1, seed), _mixed(ix + 1, iy + 1, iz + 1, seed)
    ab, cd, ef, gh = a + (b - a) * u, c + (d - c) * u, e + (f - e) * u, g + (h - g) * u
    low, high = ab + (cd - ab) * v, ef + (gh - ef) * v
    return 2 * (low + (high - low) * w) - 1


@nb.njit(cache=True, error_model="numpy", parallel=True)
def classify(eye_up, level, rays, t_land, primitive, way, kind):  # type: ignore[no-untyped-def]
    """Way (n,) to what each ray meets first and its kind: 0 sky, 1 water, 2 land."""
    for i in nb.prange(len(rays)):
        dz = np.float64(rays[i, 2])
        water = (level - eye_up) / dz if dz < 0.0 else np.inf
        if primitive[i] >= 0 and t_land[i] <= water:
            way[i], kind[i] = t_land[i], 2
        elif water < np.inf:
            way[i], kind[i] = water, 1
        else:
            way[i], kind[i] = np.inf, 0


@nb.njit(cache=True, error_model="numpy", parallel=True)
def edge_parts(kind, primitive, t, rays, normal, thin, board, plain, print_, long_, out):  # type: ignore[no-untyped-def]
    """How each pixel (h, w) is divided.

    ``plain`` where it and a neighbour meet different things, ``print_`` at boards, ``long_`` on ground that
    is seen at a flat angle, 1 elsewhere.
    """
    h, w = kind.shape
    for y in nb.prange(h):
        for x in range(w):
            parts = 1
            p = primitive[y, x]
            if kind[y, x] == 2:
                if board[p] >= 0:
                    parts = print_
                else:
                    slant = 0.0
                    for k in range(3):
                        slant += normal[y, x, k] * rays[y, x, k]
                    if abs(slant) < 0.4 and not thin[p]:
                        parts = long_
            for step in range(4):
                j = y + (1 if step == 0 else (-1 if step == 1 else 0))
                i = x + (1 if step == 2 else (-1 if step == 3 else 0))
                if j < 0 or i < 0 or j >= h or i >= w or parts == print_:
                    continue
                q = primitive[j, i]
                if kind[j, i] == 2 and board[q] >= 0:
                    parts = print_
                elif kind[j, i] != kind[y, x]:
                    parts = plain
                elif kind[y, x] == 2 and p != q:
                    near, far = min(t[y, x], t[j, i]), max(t[y, x], t[j, i])
                    if thin[p] or thin[q] or far > 1.04 * near:
                        parts = plain
            out[y, x] = parts


@nb.njit(cache=True, error_model="numpy", parallel=True)
def meet(  # type: ignore[no-untyped-def]
    origin, rays, way, primitive, uv, vertices, triangles, corner_normal, smooth, border, shares, grounds,
    material, corner_light, face_light, size, flat, spread, point, normal, start, code, footprint, light,
):  # fmt: skip
    """Places, normals toward the viewer, kinds and footprints of what rays meet on land, and its baked light.

    ``start`` is where shadow rays begin: off the surface that the smooth normals pretend (Hanika 2021, Ray
    Tracing Gems II, chapter 4). Where kinds of ground compete, noise decides, so that borders are frayed.
    """
    for i in nb.prange(len(rays)):
        f = primitive[i]
        o = origin[i % len(origin)]
        a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        u, v = np.float64(uv[i, 0]), np.float64(uv[i, 1])
        q = 1.0 - u - v
        dx, dy, dz = np.float64(rays[i, 0]), np.float64(rays[i, 1]), np.float64(rays[i, 2])
        px, py, pz = o[0] + way[i] * dx, o[1] + way[i] * dy, o[2] + way[i] * dz
        ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
        ux, uy, uz = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
        vx, vy, vz = vertices[c, 0] - ax, vertices[c, 1] - ay, vertices[c, 2] - az
        fx, fy, fz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = max(np.sqrt(fx * fx + fy * fy + fz * fz), 1e-30)
        fx, fy, fz = fx / length, fy / length, fz / length
        nx, ny, nz = fx, fy, fz
        sx, sy, sz = 0.0, 0.0, 0.0
        if smooth[f]:
            mx = q * corner_normal[a, 0] + u * corner_normal[b, 0] + v * corner_normal[c, 0]
            my = q * corner_normal[a, 1] + u * corner_normal[b, 1] + v * corner_normal[c, 1]
            mz = q * corner_normal[a, 2] + u * corner_normal[b, 2] + v * corner_normal[c, 2]
            length = np.sqrt(mx * mx + my * my + mz * mz)
            if length > 0.2 and mx * fx + my * fy + mz * fz > 0.2 * length:
                nx, ny, nz = mx / length, my / length, mz / length
                for k in range(3):
                    e = a if k == 0 else (b if k == 1 else c)
                    weight = q if k == 0 else (u if k == 1 else v)
                    gx, gy, gz = corner_normal[e, 0], corner_normal[e, 1], corner_normal[e, 2]
                    below = (
                        (px - vertices[e, 0]) * gx + (py - vertices[e, 1]) * gy + (pz - vertices[e, 2]) * gz
                    )
                    if below < 0.0:
                        sx, sy, sz = (
                            sx - weight * below * gx,
                            sy - weight * below * gy,
                            sz - weight * below * gz,
                        )
        slant = nx * dx + ny * dy + nz * dz
        if slant > 0.0:
            nx, ny, nz = -nx, -ny, -nz
        what = material[f]
        if border[f]:
            most = -1.0
            for k in range(len(grounds)):
                share = q * shares[a, k] + u * shares[b, k] + v * shares[c, k]
                if share > 0.0:
                    spacing, gain = 0.35, 0.35
                    for octave in range(5):
                        share += gain * _value(
                            px / spacing, py / spacing, pz / spacing, 900 + 10 * k + octave
                        )
                        spacing, gain = 0.5 * spacing, 0.75 * gain
                    if share > most:
                        most, what = share, grounds[k]
        point[i, 0], point[i, 1], point[i, 2] = px, py, pz
        normal[i, 0], normal[i, 1], normal[i, 2] = nx, ny, nz
        start[i, 0], start[i, 1], start[i, 2] = px + sx, py + sy, pz + sz
        code[i] = what
        # The spot is longer than wide by 1 / slant; less so where rays divide a pixel along it.
        longer = max(flat / max(abs(slant), 0.02), 1.0)
        footprint[i] = way[i] * size * longer ** (0.5 if flat == 1.0 else 0.75) + spread * way[i]
        for k in range(4):
            if smooth[f]:
                light[i, k] = q * corner_light[a, k] + u * corner_light[b, k] + v * corner_light[c, k]
            else:
                light[i, k] = face_light[f, k]


@nb.njit(cache=True, error_model="numpy", parallel=True)
def detail(point, code, footprint, strength, colour):  # type: ignore[no-untyped-def]
    """Contrast of the finest grain that the eye still sees, down to two footprints; changes ``colour``."""
    for i in nb.prange(len(point)):
        strong = strength[code[i]]
        if strong <= 0.0:
            continue
        foot = max(footprint[i], 1e-4)
        # The finest octave that is in the world at all is 4 mm.
        level = np.int64(np.floor(np.log2(foot / 0.004)))
        total = 0.0
        for octave in range(1, 5):
            at = octave + (level if level > -1 else -1)
            spacing = 0.004 * 2.0**at
            seen = min(max(2.0 * spacing / foot - 2.0, 0.0), 1.0) * min(
                max(4.0 - np.log2(spacing / foot), 0.0), 1.0
            )
            if seen > 0.0:
                x, y, z = point[i, 0] / spacing, point[i, 1] / spacing, point[i, 2] / spacing
                if at % 2:
                    x, y = 0.8 * x + 0.6 * y, -0.6 * x + 0.8 * y
                    y, z = 0.8 * y + 0.6 * z, -0.6 * y + 0.8 * z
                total += seen * _value(x, y, z, 700 + at)
        factor = np.exp(strong * total)
        for k in range(3):
            colour[i, k] = min(colour[i, k] * factor, 0.95)


@nb.njit(cache=True, error_model="numpy", parallel=True)
def paint_boards(board, primitive, point, centre, right, size, rim, white, black, colour):  # type: ignore[no-untyped-def]
    """Albedo of the printed fronts of boards."""
    for i in nb.prange(len(point)):
        n = board[primitive[i]]
        if n < 0:
            continue
        x = (point[i, 0] - centre[n, 0]) * right[n, 0] + (point[i, 1] - centre[n, 1]) * right[n, 1]
        z = point[i, 2] - centre[n, 2]
        inside = max(abs(x), abs(z)) < (0.5 - rim) * size
        dark = inside and ((x < 0.0) == (z > 0.0))
        for k in range(3):
            colour[i, k] = black if dark else white


@nb.njit(cache=True, error_model="numpy", parallel=True)
def shade(  # type: ignore[no-untyped-def]
    colour, relief, normal, thin, code, light, sunlit, sun, sun_colour, way, haze, visibility, out
):
    """Light from matt surfaces through the air toward the viewer; leaves also let the sun through."""
    for i in nb.prange(len(colour)):
        facing = relief[i, 0] * sun[0] + relief[i, 1] * sun[1] + relief[i, 2] * sun[2]
        front = max(facing, 0.0) * sunlit[i]
        through = max(-facing, 0.0) * sunlit[i] if thin[code[i]] else 0.0
        dents = min(max(1.0 + 0.7 * (relief[i, 2] - normal[i, 2]), 0.4), 1.5)
        left = np.exp(-way[i] / visibility)
        for k in range(3):
            # Light that has passed a leaf is yellower.
            yellow = (0.85, 0.95, 0.30)[k]
            total = (front + yellow * through) * sun_colour[k] + light[i, k] * dents
            out[i, k] = colour[i, k] * total * left + haze[k] * (1.0 - left)
