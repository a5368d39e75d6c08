"""Rays that meet the water: where they go, and how much of the light comes by reflection."""

from typing import Final

import numba as nb
import numpy as np

from thalweg.core.types import ArrayF, ArrayF32
from thalweg_lab.river.waves import Waves

# Open3D brings an old TBB into the process, which numba would try first and complain about.
nb.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]

_INDEX: Final = 1.333


def mirror_rays(
    eye_wcs_m: ArrayF,
    rays_wcs: ArrayF32,
    way_m: ArrayF32,
    waves: Waves | None,
    *,
    t_s: float,
    size_rad: float,
    grain: int,
) -> tuple[ArrayF, ArrayF32, ArrayF32]:
    """Rays after the water.

    Parameters
    ----------
    eye_wcs_m : (3,) where the rays come from.
    rays_wcs : (n, 3) unit vectors.
    way_m : (n,) to the level water.
    waves : of the water; None: a mirror.
    t_s : time for the waves.
    size_rad : angle of a ray's cone; waves shorter than its spot become chance, one facet a ray.
    grain : number of the picture, so that this chance is another one in each.

    Returns
    -------
    points_wcs_m : (n, 3) on the water.
    back_wcs : (n, 3) directions of what is mirrored, upwards.
    share : (n,) reflected share of the light (Fresnel, unpolarised).
    """
    n = len(rays_wcs)
    points, back, share = np.empty((n, 3)), np.empty((n, 3), dtype=np.float32), np.empty(n, dtype=np.float32)
    if waves is None:
        table = (np.zeros(0),) * 5
    else:
        table = (
            waves.amplitude_m,
            waves.k_east_radpm,
            waves.k_north_radpm,
            waves.omega_radps,
            waves.phase_rad,
        )
    _mirror(eye_wcs_m, rays_wcs, way_m, *table, t_s, size_rad, grain, _INDEX, points, back, share)
    return points, back, share


@nb.njit(cache=True, error_model="numpy")
def _chance(i, grain, stream):  # type: ignore[no-untyped-def]
    """A number in [0, 1) that belongs to a ray of a picture."""
    h = np.uint64(i) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(grain) * np.uint64(0xC2B2AE3D27D4EB4F)
    h += np.uint64(stream) * np.uint64(0x165667B19E3779F9)
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    h ^= h >> np.uint64(31)
    return np.float64(h >> np.uint64(11)) * 2.0**-53


@nb.njit(cache=True, error_model="numpy", parallel=True)
def _mirror(  # type: ignore[no-untyped-def]
    eye, rays, way, amplitude, k_east, k_north, omega, phase, t, size, grain, index, points, back, share
):  # fmt: skip
    for i in nb.prange(len(rays)):
        dx, dy, dz = np.float64(rays[i, 0]), np.float64(rays[i, 1]), np.float64(rays[i, 2])
        x, y = eye[0] + way[i] * dx, eye[1] + way[i] * dy
        points[i, 0], points[i, 1], points[i, 2] = x, y, eye[2] + way[i] * dz
        footprint = way[i] * size / np.sqrt(max(-dz, 0.01))
        east, north, hidden = 0.0, 0.0, 0.0
        for j in range(len(amplitude)):
            k2 = k_east[j] * k_east[j] + k_north[j] * k_north[j]
            seen = min(max(np.pi / np.sqrt(k2) / max(footprint, 1e-9) - 1.0, 0.0), 1.0)
            hidden += amplitude[j] * amplitude[j] * k2 * 0.5 * (1.0 - seen * seen)
            if seen > 0.0:
                angle = k_east[j] * x + k_north[j] * y - omega[j] * t + phase[j]
                wave = -seen * amplitude[j] * np.sin(angle)
                east += wave * k_east[j]
                north += wave * k_north[j]
        if hidden > 0.0:
            # Of the waves that are too short for the pixel the ray meets one facet.
            radius = np.sqrt(-np.log(1.0 - _chance(i, grain, 1)) * hidden)
            turn = 2 * np.pi * _chance(i, grain, 2)
            east += radius * np.cos(turn)
            north += radius * np.sin(turn)
        scale = 1.0 / np.sqrt(1.0 + east * east + north * north)
        nx, ny, nz = -east * scale, -north * scale, scale
        c = max(-(dx * nx + dy * ny + dz * nz), 0.02)
        bx, by, bz = dx + 2 * c * nx, dy + 2 * c * ny, dz + 2 * c * nz
        # A facet that would send the ray down is hidden behind its neighbour: the ray leaves upwards.
        bz = max(abs(bz), 0.004)
        length = np.sqrt(bx * bx + by * by + bz * bz)
        back[i, 0], back[i, 1], back[i, 2] = bx / length, by / length, bz / length
        inside = np.sqrt(1.0 - (1.0 - c * c) / (index * index))
        across = (c - index * inside) / (c + index * inside)
        within = (index * c - inside) / (index * c + inside)
        share[i] = 0.5 * (across * across + within * within)
