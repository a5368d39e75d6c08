"""Colours of the yard: asphalt, boards of the fence, paint, paper, hull; and the sky with trees around.

Procedural and fixed in place; a detail fades out where its spacing comes down to what a pixel covers.
"""

from enum import IntEnum
from typing import Final

import numba as nb
import numpy as np

from thalweg.core.types import ArrayF32, ArrayI
from thalweg_lab.river_images.daylight import Sun, sky

# Open3D brings an old TBB into the process, which numba would try first and complain about.
nb.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]


class Look(IntEnum):
    """How the surface of a thing looks."""

    GROUND = 0
    FENCE = 1
    CONE = 2
    BOARD = 3
    POST = 4
    PERSON = 5
    BOAT = 6
    METAL = 7
    SENSOR = 8


PAPER: Final = 0.80
"""Share of light that white paper reflects."""

INK: Final = 0.045

_COLOUR: Final = np.array([
    [0.168, 0.166, 0.164],  # asphalt
    [0.300, 0.205, 0.125],  # fence
    [0.430, 0.420, 0.395],  # cone
    [0.330, 0.345, 0.350],  # board
    [0.240, 0.250, 0.260],  # post
    [0.070, 0.090, 0.160],  # person
    [0.640, 0.400, 0.050],  # boat
    [0.330, 0.340, 0.350],  # metal
    [0.045, 0.047, 0.050],  # sensor
])  # fmt: skip

# Longest spacing of the noise (m), its contrast, that of broad stains, that of grains, size of a grain.
_GRAIN: Final = np.array([
    [0.110, 0.14, 0.16, 0.42, 0.0065],
    [0.300, 0.10, 0.10, 0.10, 0.0030],
    [0.120, 0.06, 0.07, 0.05, 0.0040],
    [0.150, 0.05, 0.06, 0.03, 0.0040],
    [0.060, 0.12, 0.05, 0.08, 0.0030],
    [0.200, 0.16, 0.10, 0.10, 0.0100],
    [0.200, 0.04, 0.05, 0.02, 0.0040],
    [0.200, 0.05, 0.05, 0.04, 0.0040],
    [0.200, 0.05, 0.05, 0.04, 0.0040],
])  # fmt: skip

_PANORAMA: Final = (512, 2048)
"""Rows from the nadir to the zenith, columns around."""

_LOOKS: Final = {
    "ground": Look.GROUND, "fence": Look.FENCE, "posts": Look.POST, "person": Look.PERSON, "boat": Look.BOAT,
    "trolley": Look.METAL, "sensors": Look.SENSOR,
}  # fmt: skip


def look_of(name: str) -> Look:
    """Look of a thing by its name: ``ground``, ``C1``, ``board 64`` and so on."""
    if name in _LOOKS:
        return _LOOKS[name]
    return Look.CONE if name[:1] == "C" and name[1:].isdigit() else Look.BOARD


def albedo(
    points_wcs_m: ArrayF32, normal_wcs: ArrayF32, look: ArrayI, footprint_m: ArrayF32, stretch: ArrayF32
) -> ArrayF32:
    """Share of light (n, 3) that surfaces reflect, linear RGB, without the sheets on them.

    Parameters
    ----------
    points_wcs_m, normal_wcs : (n, 3) places and normals.
    look : (n,) values of `Look`, -1 for none.
    footprint_m : (n,) mean side of what a pixel covers there.
    stretch : (n,) its longer side over the mean one.
    """
    out = np.zeros((len(look), 3), dtype=np.float32)
    _albedo(points_wcs_m, normal_wcs, look, footprint_m, stretch, _COLOUR, _GRAIN, out)
    return out


def panorama(sun: Sun, *, cover: float = 0.55) -> ArrayF32:
    """The sky with its clouds (512, 2048, 3) as linear light.

    Rows run from the nadir to the zenith, columns counter-clockwise from east.
    """
    rows, columns = _PANORAMA
    elevation = ((np.arange(rows) + 0.5) / rows - 0.5) * np.pi
    azimuth = (np.arange(columns) + 0.5) / columns * 2 * np.pi
    el, az = (a.ravel() for a in np.meshgrid(elevation, azimuth, indexing="ij"))
    way = np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)], axis=1)
    light = np.minimum(sky(way, sun, cover=cover), 6.0)
    return np.ascontiguousarray(light.reshape(rows, columns, 3), dtype=np.float32)


def surroundings(rays_wcs: ArrayF32, sky_map: ArrayF32, sun: Sun, size_rad: float) -> ArrayF32:
    """Light (n, 3) from where rays meet nothing: sky, and trees behind the fence that stand far away.

    Parameters
    ----------
    rays_wcs : (n, 3) directions.
    sky_map : from `panorama`.
    sun : lights the trees.
    size_rad : angle of a pixel.
    """
    out = np.empty_like(rays_wcs)
    _surroundings(rays_wcs, sky_map, sun.direction_wcs, size_rad, out)
    return out


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
    total = 0.0
    for k in range(8):
        a, b, c = k & 1, (k >> 1) & 1, k >> 2
        share = (u if a else 1 - u) * (v if b else 1 - v) * (w if c else 1 - w)
        total += share * _mixed(ix + a, iy + b, iz + c, seed)
    return 2 * total - 1


@nb.njit(cache=True, error_model="numpy")
def _seen(spacing, footprint):  # type: ignore[no-untyped-def]
    """Share of a detail that is left at a footprint: none from one lattice spacing on (Nyquist)."""
    return min(max(spacing / footprint - 1.0, 0.0), 1.0)


@nb.njit(cache=True, error_model="numpy")
def _line(place, spacing, wide, footprint):  # type: ignore[no-untyped-def]
    """Share of a dark joint that repeats at a spacing in what a pixel covers."""
    off = abs(place / spacing - np.floor(place / spacing + 0.5)) * spacing
    reach = max(wide, footprint)
    return (wide / reach) * min(max((0.5 * (reach + wide) - off) / reach, 0.0), 1.0)


@nb.njit(cache=True, error_model="numpy", parallel=True)
def _albedo(points, normal, look, footprint, stretch, colour, grain, out):  # type: ignore[no-untyped-def]
    for i in nb.prange(len(look)):
        what = look[i]
        if what < 0:
            continue
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        foot = max(np.float64(footprint[i]), 1e-6)
        g = grain[what]
        seed = 50 + 17 * what
        # Planks and stretched grain run upwards.
        squeeze = 0.12 if what == 1 or what == 4 else 1.0
        total, spacing, part = 0.0, g[0], 1.0
        for octave in range(4):
            seen = _seen(spacing, foot)
            if seen <= 0.0:
                break
            # Every other octave is turned, so that the lattices do not show.
            px, py = (x, y) if octave % 2 == 0 else (0.8 * x + 0.6 * y, -0.6 * x + 0.8 * y)
            total += seen * part * _value(px / spacing, py / spacing, z * squeeze / spacing, seed + octave)
            part *= 0.75
            spacing *= 0.45
        bright = 1.0 + g[1] * total
        broad = _value(x / 1.9, y / 1.9, z / 1.9, seed + 9) + 0.6 * _value(
            x / 0.6, y / 0.6, z / 0.6, seed + 10
        )
        bright += g[2] * broad
        seen = _seen(g[4], foot)
        if seen > 0.0:
            bright += g[3] * seen * _value(x / g[4], y / g[4], z * squeeze / g[4], seed + 11)
        warm = 0.03 * broad
        if what == 0:
            # Joints of the paving, patches of another age, and spots of oil.
            long = foot * stretch[i]
            joint = max(_line(x + 0.35, 3.1, 0.012, long), _line(y - 0.6, 4.3, 0.012, long))
            bright *= 1.0 - 0.55 * joint
            oil = _value(x / 0.45, y / 0.45, 3.7, seed + 12)
            bright *= 1.0 - 0.35 * min(max(4.0 * (oil - 0.62), 0.0), 1.0)
            seen = _seen(0.02, foot)
            if seen > 0.0:
                stone = _value(x / 0.02, y / 0.02, 0.3, seed + 13)
                bright += seen * 0.55 * min(max(4.0 * (stone - 0.60), 0.0), 1.0)
        elif what == 1:
            flat = np.sqrt(normal[i, 0] ** 2 + normal[i, 1] ** 2)
            if flat > 0.5:
                along = (normal[i, 0] * y - normal[i, 1] * x) / flat
                plank = np.int64(np.floor(along / 0.14))
                bright *= 0.82 + 0.36 * _mixed(plank, np.int64(10 * normal[i, 0]), 1, seed)
                bright *= 1.0 - 0.75 * _line(along, 0.14, 0.008, foot)
                bright *= 1.0 - 0.5 * (_line(z - 0.4, 100.0, 0.07, foot) + _line(z - 1.9, 100.0, 0.07, foot))
        bright = max(bright, 0.15)
        out[i, 0] = min(colour[what, 0] * bright * (1 + warm), 0.95)
        out[i, 1] = min(colour[what, 1] * bright, 0.95)
        out[i, 2] = min(colour[what, 2] * bright * (1 - warm), 0.95)


@nb.njit(cache=True, error_model="numpy")
def _octaves(x, y, z, spacing, gain, count, footprint, seed):  # type: ignore[no-untyped-def]
    total, part = 0.0, 1.0
    for octave in range(count):
        seen = _seen(spacing, footprint)
        if seen <= 0.0:
            break
        total += seen * part * _value(x / spacing, y / spacing, z / spacing, seed + octave)
        part *= gain
        spacing *= 0.5
    return total


@nb.njit(cache=True, error_model="numpy", parallel=True)
def _surroundings(rays, panorama, sun, size, out):  # type: ignore[no-untyped-def]
    rows, columns = panorama.shape[0], panorama.shape[1]
    for i in nb.prange(len(rays)):
        x, y = np.float64(rays[i, 0]), np.float64(rays[i, 1])
        z = min(max(np.float64(rays[i, 2]), -1.0), 1.0)
        high = np.arcsin(z)
        flat = max(np.sqrt(x * x + y * y), 1e-9)
        v = min(max((high / np.pi + 0.5) * rows - 0.5, 0.0), rows - 1.001)
        u = np.arctan2(y, x) / (2 * np.pi) * columns - 0.5
        u -= np.floor(u / columns) * columns
        j, k = np.int64(v), np.int64(u)
        b, a = v - j, u - k
        k, k1 = k % columns, (k + 1) % columns
        for c in range(3):
            below = panorama[j, k, c] * (1 - a) + panorama[j, k1, c] * a
            above = panorama[j + 1, k, c] * (1 - a) + panorama[j + 1, k1, c] * a
            out[i, c] = below * (1 - b) + above * b
        if high > 0.45:
            continue
        # Crowns: broad ones, then branches, then leaves at their rim.
        crown = 0.19 + 0.08 * _octaves(x / flat, y / flat, 0.0, 0.45, 0.5, 2, size, 31)
        crown += 0.022 * _octaves(x, y, z, 0.05, 0.8, 5, size, 33)
        cover = min(max(0.5 + (crown - high) / (0.6 * size + 0.0015), 0.0), 1.0)
        if cover <= 0.0:
            continue
        leaves = _octaves(x, y, z, 0.035, 0.85, 6, size, 40)
        clump = _octaves(x, y, z, 0.11, 0.6, 2, size, 50)
        facing = 0.5 - 0.5 * (x * sun[0] + y * sun[1]) / flat
        bright = max((0.45 + 0.75 * facing) * (1.0 + 0.55 * clump + 0.45 * leaves), 0.06)
        warm = 0.5 + 0.5 * clump
        for c in range(3):
            tree = bright * (0.070 + 0.045 * warm if c == 0 else (0.115 + 0.025 * warm if c == 1 else 0.040))
            out[i, c] += cover * (1.5 * tree - out[i, c])
