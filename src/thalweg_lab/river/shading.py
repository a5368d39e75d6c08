"""Light on surfaces: normals, reflection, rays to the sky, exposure of a picture. Arrays in, arrays out."""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import AnyArray, ArrayF, ArrayF32, ArrayI, ArrayU8, njit

WATER_INDEX: Final = 1.333
"""Refractive index of water for visible light."""

_LUMINANCE: Final = np.array([0.2126, 0.7152, 0.0722])
_UPPER: Final = 0.21
"""Exposed light of the upper quartile of a picture, which the tone curve makes 0.6 of white in sRGB: a camera
meters for the middle tones, and the sky or a wet stone may burn out."""

MURK: Final = np.array([0.036, 0.050, 0.030])
"""Share of daylight that deep turbid water sends back."""


def fresnel(cos_incidence: ArrayLike, index: float = WATER_INDEX) -> ArrayF:
    """Reflected share (n,) of unpolarised light at the surface of a denser medium (Born and Wolf, 1.5.2).

    Parameters
    ----------
    cos_incidence : (n,) cosine of the angle between ray and normal in air, 0 to 1.
    index : refractive index of the medium.
    """
    c = np.clip(np.asarray(cos_incidence, dtype=np.float64), 0.0, 1.0)
    inside = np.sqrt(1.0 - (1.0 - c * c) / index**2)
    across = (c - index * inside) / (c + index * inside)
    within = (index * c - inside) / (index * c + inside)
    return np.asarray((across**2 + within**2) / 2)


def mirrored(direction: ArrayF, normal: ArrayF) -> ArrayF:
    """Directions (n, 3) after reflection at surfaces with unit normals (n, 3)."""
    return np.asarray(direction - 2.0 * np.sum(direction * normal, axis=1, keepdims=True) * normal)


def vertex_normals(vertices_m: ArrayF, triangles: ArrayI) -> ArrayF:
    """Unit normals (n, 3) of vertices: mean of the triangles around, weighted by area; 0 without triangle."""
    total = np.zeros((len(vertices_m), 3))
    _sum_normals(np.ascontiguousarray(vertices_m), np.ascontiguousarray(triangles), total)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(total / np.where(length > 0, length, 1.0))


def corner_shares(triangles: ArrayI, material: ArrayU8, kinds: ArrayU8, vertices: int) -> ArrayF32:
    """Share (v, k) of each kind of material among the triangles of these kinds around a vertex."""
    count = np.zeros((vertices, len(kinds)), dtype=np.float32)
    for k, kind in enumerate(kinds):
        count[:, k] = np.bincount(triangles[material == kind].ravel(), minlength=vertices)
    total = count.sum(axis=1, keepdims=True)
    return np.asarray(count / np.where(total > 0, total, np.float32(1)))


def hash01(index: AnyArray, stream: int) -> ArrayF:
    """Numbers (n,) in [0, 1) that belong to indices: the grain of soft shadows, the same at each run."""
    with np.errstate(over="ignore"):
        h = np.asarray(index).astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        h += np.uint64(stream) * np.uint64(0xC2B2AE3D27D4EB4F)
        h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        h ^= h >> np.uint64(31)
    return np.asarray((h >> np.uint64(11)).astype(np.float64) * 2.0**-53)


def half_sphere(normal: ArrayF, index: AnyArray, ray: int, rays: int) -> ArrayF:
    """Directions (n, 3) about normals with a density of the cosine; ``ray`` of ``rays`` sectors around."""
    turn = 2 * np.pi * (ray + hash01(index, 2 * ray + 11)) / rays
    out = hash01(index, 2 * ray + 12)
    flat, high = np.sqrt(out), np.sqrt(1.0 - out)
    # Orthonormal frame without branches (Duff et al. 2017).
    sign = np.where(normal[:, 2] >= 0, 1.0, -1.0)
    a = -1.0 / (sign + normal[:, 2])
    b = normal[:, 0] * normal[:, 1] * a
    u = np.stack([1 + sign * normal[:, 0] ** 2 * a, sign * b, -sign * normal[:, 0]], axis=1)
    v = np.stack([b, sign + normal[:, 1] ** 2 * a, -normal[:, 1]], axis=1)
    x, y = (flat * np.cos(turn))[:, None], (flat * np.sin(turn))[:, None]
    return np.asarray(x * u + y * v + high[:, None] * normal)


def metered(light: ArrayF) -> float:
    """Exposure as a camera chooses it: after the upper quartile of the luminance of a picture (..., 3)."""
    luminance = np.maximum(light, 0.0) @ _LUMINANCE
    return _UPPER / max(float(np.percentile(luminance, 75.0)), 1e-6)


@njit(cache=True, error_model="numpy")
def _sum_normals(vertices, triangles, total):  # type: ignore[no-untyped-def]
    for f in range(len(triangles)):
        a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        u, v = vertices[b] - vertices[a], vertices[c] - vertices[a]
        n = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
        for corner in (a, b, c):
            for k in range(3):
                total[corner, k] += n[k]
