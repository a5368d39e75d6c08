"""Smooth noise over the plane for terrain; a function of place and seed, no state."""

import numpy as np

from thalweg.core.types import AnyArray, ArrayF


def _lattice(ix: AnyArray, iy: AnyArray, seed: int) -> ArrayF:
    """Uniform numbers in [-1, 1) that belong to lattice points (integer mixing of splitmix64)."""
    with np.errstate(over="ignore"):
        h = ix.astype(np.int64).view(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        h ^= iy.astype(np.int64).view(np.uint64) * np.uint64(0xC2B2AE3D27D4EB4F)
        h += np.uint64(seed) * np.uint64(0x165667B19E3779F9)
        h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        h ^= h >> np.uint64(31)
    return np.asarray((h >> np.uint64(11)).astype(np.float64) * 2.0**-52 - 1.0)


def value_noise(x: ArrayF, y: ArrayF, wavelength_m: float, seed: int) -> ArrayF:
    """Value noise in [-1, 1], smooth to the first derivative, of one wavelength."""
    u, v = np.broadcast_arrays(x / wavelength_m, y / wavelength_m)
    iu, iv = np.floor(u), np.floor(v)
    u, v = u - iu, v - iv
    u, v = u * u * (3 - 2 * u), v * v * (3 - 2 * v)
    a, b = _lattice(iu, iv, seed), _lattice(iu + 1, iv, seed)
    c, d = _lattice(iu, iv + 1, seed), _lattice(iu + 1, iv + 1, seed)
    low = a + (b - a) * u
    return np.asarray(low + (c + (d - c) * u - low) * v)


def fractal_noise(
    x: ArrayF, y: ArrayF, longest_m: float, octaves: int, seed: int, gain: float = 0.55
) -> ArrayF:
    """Sum of value noises; each octave has half the wavelength and ``gain`` times the amplitude."""
    total = np.zeros(np.broadcast_shapes(np.shape(x), np.shape(y)))
    for octave in range(octaves):
        total += gain**octave * value_noise(x, y, longest_m * 0.5**octave, seed + 7919 * octave)
    return total
