"""Smooth noise over the plane for terrain; a function of place and seed, no state."""

from typing import Final

import numba as nb
import numpy as np

from thalweg.core.types import AnyArray, ArrayF

# Open3D brings an old TBB into the process, which numba would try first and complain about.
nb.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]

_MANY: Final = 100_000


@nb.njit(cache=True, error_model="numpy", inline="always")
def _lattice(ix, iy, seed):  # type: ignore[no-untyped-def]
    """Uniform number in [-1, 1) that belongs to a lattice point (integer mixing of splitmix64)."""
    h = np.uint64(ix) * np.uint64(0x9E3779B97F4A7C15)
    h ^= np.uint64(iy) * np.uint64(0xC2B2AE3D27D4EB4F)
    h += np.uint64(seed) * np.uint64(0x165667B19E3779F9)
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    h ^= h >> np.uint64(31)
    return np.float64(h >> np.uint64(11)) * 2.0**-52 - 1.0


@nb.njit(cache=True, error_model="numpy")
def _value(x, y, seed):  # type: ignore[no-untyped-def]
    fx, fy = np.floor(x), np.floor(y)
    ix, iy = np.int64(fx), np.int64(fy)
    u, v = x - fx, y - fy
    u, v = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v)
    a, b = _lattice(ix, iy, seed), _lattice(ix + 1, iy, seed)
    c, d = _lattice(ix, iy + 1, seed), _lattice(ix + 1, iy + 1, seed)
    low = a + (b - a) * u
    return low + (c + (d - c) * u - low) * v


@nb.njit(cache=True, error_model="numpy")
def _sum(x, y, cell, longest_m, octaves, seed, gain, ridged):  # type: ignore[no-untyped-def]
    total, amplitude, wavelength = 0.0, 1.0, longest_m
    for octave in range(octaves):
        # An octave fades out between 2.5 and 1.5 cells a wave: a coarser mesh cannot carry it.
        weight = min(wavelength / cell - 1.5, 1.0)
        if weight <= 0.0:
            break
        value = _value(x / wavelength, y / wavelength, seed + 7919 * octave)
        if ridged:
            value = 1.0 - 2.0 * abs(value)
        total += weight * amplitude * value
        amplitude *= gain
        wavelength *= 0.5
    return total


@nb.njit(cache=True, error_model="numpy")
def _few(x, y, cell, longest_m, octaves, seed, gain, ridged, out):  # type: ignore[no-untyped-def]
    for k in range(x.size):
        out[k] = _sum(x[k], y[k], cell[k], longest_m, octaves, seed, gain, ridged)


@nb.njit(cache=True, error_model="numpy", parallel=True)
def _many(x, y, cell, longest_m, octaves, seed, gain, ridged, out):  # type: ignore[no-untyped-def]
    for k in nb.prange(x.size):
        out[k] = _sum(x[k], y[k], cell[k], longest_m, octaves, seed, gain, ridged)


def fractal_noise(
    x: ArrayF,
    y: ArrayF,
    longest_m: float,
    octaves: int,
    seed: int,
    gain: float = 0.55,
    *,
    cell_m: AnyArray | float = 1e-9,
    ridged: bool = False,
) -> ArrayF:
    """Sum of value noises; each octave has half the wavelength and ``gain`` times the amplitude.

    Parameters
    ----------
    x, y : places, metres; broadcast against each other.
    longest_m : wavelength of the first octave.
    octaves : how many of them.
    seed : seed of the field.
    gain : amplitude of an octave over that of the one before.
    cell_m : size of the cells that the noise is sampled with; octaves of less than 1.5 cells a wave are left
        out and those of more than 2.5 are whole.
    ridged : fold each octave, so that sharp crests stand between round hollows.

    Returns
    -------
    noise : within +-(1 + gain + gain^2 ...), smooth to the first derivative (ridged: continuous).
    """
    px, py, pc = np.broadcast_arrays(x, y, cell_m)
    flat = [np.ascontiguousarray(a, dtype=np.float64).reshape(-1) for a in (px, py, pc)]
    out = np.empty(px.size)
    # Threads cost more than they bring on few points.
    kernel = _many if px.size > _MANY else _few
    kernel(*flat, float(longest_m), int(octaves), int(seed), float(gain), ridged, out)
    return out.reshape(px.shape)


def value_noise(x: ArrayF, y: ArrayF, wavelength_m: float, seed: int) -> ArrayF:
    """Value noise in [-1, 1], smooth to the first derivative, of one wavelength."""
    return fractal_noise(x, y, wavelength_m, 1, seed)
