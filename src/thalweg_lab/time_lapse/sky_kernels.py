"""Loops over rays that leave the scene: the clear sky of `thalweg_lab.river_images.daylight` with drifting
clouds.

One pass over float32 rays; six octaves of cloud are enough at the size of a pixel.
"""

import numba as nb
import numpy as np

from thalweg.core.types import ArrayF, ArrayF32
from thalweg_lab.river_images.daylight import HAZE, Sun

# Open3D brings an old TBB into the process, which numba would try first and complain about.
nb.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]

ZENITH = np.array([0.12, 0.27, 0.68])
"""Colour of the clear sky overhead."""


def sky_light(rays_wcs: ArrayF32, sun: Sun, *, cover: float, t_s: float, glare: bool) -> ArrayF32:
    """Linear RGB (n, 3) of the sky in directions (n, 3).

    Parameters
    ----------
    rays_wcs : (n, 3) unit vectors.
    sun : lights sky and clouds.
    cover : share of clouds, about 0 to 1; 0: none.
    t_s : time; the clouds drift to the east by 8 m/s at a height of 1200 m.
    glare : whether the sun's disc and the glow close to it are there.
    """
    out = np.empty((len(rays_wcs), 3), dtype=np.float32)
    drift = t_s * 8.0 / 1200.0
    _sky(rays_wcs, sun.direction_wcs, sun.colour, HAZE, ZENITH, cover, drift, float(glare), out)
    return out


def mean_sky(sun: Sun) -> ArrayF:
    """Mean light (3,) of the upper half of the sky, for what has no rays of its own."""
    i = np.arange(400) + 0.5
    up, turn = i / 400, np.pi * (1 + 5**0.5) * i
    flat = np.sqrt(1 - up * up)
    d = np.stack([flat * np.cos(turn), flat * np.sin(turn), up], axis=1).astype(np.float32)
    return np.asarray(sky_light(d, sun, cover=0.4, t_s=0.0, glare=False).mean(axis=0), dtype=np.float64)


@nb.njit(cache=True, error_model="numpy")
def _mixed(ix, iy, seed):  # type: ignore[no-untyped-def]
    """A number in [0, 1) that belongs to a lattice point."""
    h = ix * 374761393 + iy * 668265263 + seed * 1274126177
    h = (h ^ (h >> 29)) * 5871781006564002453
    h = (h ^ (h >> 32)) * 1181783497276652981
    return ((h >> 24) & 16777215) * 5.9604644775390625e-08


@nb.njit(cache=True, error_model="numpy")
def _value(x, y, seed):  # type: ignore[no-untyped-def]
    fx, fy = np.floor(x), np.floor(y)
    ix, iy = np.int64(fx), np.int64(fy)
    x, y = x - fx, y - fy
    u, v = x * x * (3 - 2 * x), y * y * (3 - 2 * y)
    a, b = _mixed(ix, iy, seed), _mixed(ix + 1, iy, seed)
    c, d = _mixed(ix, iy + 1, seed), _mixed(ix + 1, iy + 1, seed)
    low, high = a + (b - a) * u, c + (d - c) * u
    return 2 * (low + (high - low) * v) - 1


@nb.njit(cache=True, error_model="numpy")
def _density(x, y, cover, octaves):  # type: ignore[no-untyped-def]
    """Thickness of the clouds at a place of their layer, 0 to about 1."""
    total, amplitude, size = 0.0, 1.0, 1.6
    for octave in range(octaves):
        # Turned from octave to octave, so that the lattices do not show.
        x, y = 0.8 * x + 0.6 * y, -0.6 * x + 0.8 * y
        total += amplitude * _value(x / size, y / size, 4001 + octave)
        amplitude *= 0.52
        size *= 0.5
    return min(max((total - 0.75 + 1.1 * cover) / 0.9, 0.0), 1.2)


@nb.njit(cache=True, error_model="numpy", parallel=True)
def _sky(d, sun, sun_colour, haze, zenith, cover, drift, disc, out):  # type: ignore[no-untyped-def]
    for i in nb.prange(len(d)):
        dx, dy, up = np.float64(d[i, 0]), np.float64(d[i, 1]), np.float64(d[i, 2])
        low = np.exp(-4.6 * abs(up))
        dim = 1.0 if up >= 0.0 else 0.35
        angle = dx * sun[0] + dy * sun[1] + up * sun[2]
        ahead = max(angle, 0.0)
        glow = 0.30 * ahead**6 + disc * 0.9 * ahead**90
        bright = 40.0 * disc if angle > 0.99998 else 0.0
        side = 0.88 + 0.12 * angle
        opaque, shine, thick, far = 0.0, 0.0, 0.0, 0.0
        if up > 0.015 and cover > 0.0:
            # A layer of clouds, bent down towards the horizon, in units of its height.
            scale = 1.0 / (up + 0.07)
            x, y = dx * scale + drift, 1.25 * dy * scale
            thick = _density(x, y, cover, 6)
            if thick > 0.0:
                behind = _density(x + 0.12 * sun[0], y + 0.15 * sun[1], cover, 4)
                shine = min(max(0.5 + 1.3 * (thick - behind), 0.0), 1.0)
                opaque = (1.0 - np.exp(-3.0 * thick)) * min((up - 0.015) / 0.10, 1.0)
                far = 0.7 * np.exp(-up / 0.10)
        for k in range(3):
            clear = dim * (
                (zenith[k] + (haze[k] - zenith[k]) * low) * side + (0.16 * glow + bright) * sun_colour[k]
            )
            grey = (0.72, 0.75, 0.80)[k]
            white = (1.75, 1.72, 1.66)[k]
            cloud = (grey + (white - grey) * shine) * (1.0 - 0.25 * min(max(thick - 0.5, 0.0), 1.0))
            cloud = cloud * (1.0 - far) + haze[k] * 1.15 * far
            out[i, k] = clear + (cloud - clear) * opaque
