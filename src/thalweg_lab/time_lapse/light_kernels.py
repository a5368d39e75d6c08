"""Loops over places that get their light: which are new, rays to their sky, and what these bring."""

import numba as nb
import numpy as np

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
