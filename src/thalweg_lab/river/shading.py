"""Light on surfaces: smooth normals, sun and sky light, water, air, and the tone of a picture.

Arrays in, arrays out; `picture` says which rays are cast.
"""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import AnyArray, ArrayF, ArrayF32, ArrayI, ArrayU8, njit, prange

WATER_INDEX: Final = 1.333
"""Refractive index of water for visible light."""

_LUMINANCE: Final = np.array([0.2126, 0.7152, 0.0722])
_UPPER: Final = 0.21
"""Exposed light of the upper quartile of a picture, which the tone curve makes 0.6 of white in sRGB: a camera
meters for the middle tones, and the sky or a wet stone may burn out."""

EXTINCTION_PM: Final = np.array([1.9, 1.35, 2.3])
"""Diffuse extinction of turbid river water for red, green and blue, 1/m: the bed is seen to about a metre."""

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


def refracted(direction: ArrayF, normal: ArrayF, index: float = WATER_INDEX) -> ArrayF:
    """Directions (n, 3) after refraction into water; normals (n, 3) look into the air (Snell)."""
    cos_in = -np.sum(direction * normal, axis=1, keepdims=True)
    cos_out = np.sqrt(1.0 - (1.0 - cos_in**2) / index**2)
    return np.asarray(direction / index + (cos_in / index - cos_out) * normal)


def vertex_normals(vertices_m: ArrayF, triangles: ArrayI) -> ArrayF:
    """Unit normals (n, 3) of vertices: mean of the triangles around, weighted by area; 0 without triangle."""
    total = np.zeros((len(vertices_m), 3))
    _sum_normals(np.ascontiguousarray(vertices_m), np.ascontiguousarray(triangles), total)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(total / np.where(length > 0, length, 1.0))


def smooth_normals(
    facet: ArrayF,
    vertices_m: ArrayF,
    corner_normals: ArrayF,
    triangles: ArrayI,
    primitive: ArrayI,
    uv: ArrayF,
) -> tuple[ArrayF, ArrayF]:
    """Normals (n, 3) blended between the corners of the triangles that rays met, and shifts (n, 3) off them.

    The shift leads from the triangle to the rounded surface that the normals pretend, so that shadow rays
    from there do not meet the edges of the mesh (Hanika 2021, Ray Tracing Gems II, chapter 4).

    Parameters
    ----------
    facet : (n, 3) unit normals of the triangles; kept where the blend fails.
    vertices_m : (v, 3) corners.
    corner_normals : (v, 3) from `vertex_normals`.
    triangles : (m, 3) corners.
    primitive : (n,) triangle of each hit.
    uv : (n, 2) barycentric coordinates of each hit.
    """
    normal, shift = np.empty((len(primitive), 3)), np.zeros((len(primitive), 3))
    _blend(facet, vertices_m, corner_normals, triangles, primitive, uv, normal, shift)
    return normal, shift


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


def spread_ambient(
    ambient: ArrayF,
    known_range_m: ArrayF,
    known_normal: ArrayF,
    known: AnyArray,
    range_m: ArrayF,
    normal: ArrayF,
    radius_px: int,
) -> ArrayF:
    """Ambient light (h, w, 3) of all pixels from that of some: weighted by likeness of range and normal.

    Parameters
    ----------
    ambient, known_normal : (h, w, 3) light and normals where it was sampled.
    known_range_m : (h, w) range where it was sampled.
    known : (h, w) where that is.
    range_m, normal : (h, w) and (h, w, 3) where it is wanted; not finite ranges get none.
    radius_px : half size of the window.
    """
    out = np.zeros_like(ambient)
    _bilateral(ambient, known_range_m, known_normal, known, range_m, normal, radius_px, out)
    return out


def in_air(light: ArrayF, range_m: ArrayF, haze: ArrayF, visibility_m: float) -> ArrayF:
    """Light (n, 3) after a way through air: dimmed, and with the haze of the way added."""
    left = np.exp(-range_m / visibility_m)[:, None]
    return np.asarray(light * left + haze * (1.0 - left))


def under_water(bed_colour: ArrayF, depth_m: ArrayF, way_m: ArrayF, daylight: ArrayF) -> ArrayF:
    """Light (n, 3) that comes up through the surface: the bed's, dimmed twice, and the murk's.

    Parameters
    ----------
    bed_colour : (n, 3) colour of the bed.
    depth_m : (n,) of the bed: the way of the light down to it.
    way_m : (n,) from the bed to the surface along the ray.
    daylight : (3,) light on the water.
    """
    up = np.exp(-way_m[:, None] * EXTINCTION_PM)
    down = np.exp(-depth_m[:, None] * EXTINCTION_PM)
    return np.asarray(0.9 * daylight * (bed_colour * down * up + MURK * (1.0 - up)))


def metered(light: ArrayF) -> float:
    """Exposure as a camera chooses it: after the upper quartile of the luminance of a picture (..., 3)."""
    luminance = np.maximum(light, 0.0) @ _LUMINANCE
    return _UPPER / max(float(np.percentile(luminance, 75.0)), 1e-6)


def developed(light: ArrayF, exposure: float | None) -> ArrayU8:
    """A picture (..., 3) of 8 bits from linear light: filmic tone curve (Narkowicz 2016), then sRGB.

    Without an exposure that of `metered` is taken.
    """
    x = np.maximum(light * (metered(light) if exposure is None else exposure), 0.0)
    x = np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0.0, 1.0)
    encoded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(x, 1 / 2.4) - 0.055)
    return np.asarray(np.rint(255.0 * encoded), dtype=np.uint8)


def lit(
    colour: ArrayF,
    normal: ArrayF,
    direction: ArrayF,
    thin: AnyArray,
    sunlit: ArrayF,
    ambient: ArrayF,
    sun: ArrayF,
    sun_colour: ArrayF,
) -> ArrayF:
    """Light (n, 3) from matt surfaces; leaves also let the sun through.

    Parameters
    ----------
    colour, normal, direction : (n, 3) colour, unit normals towards the viewer, unit directions of view.
    thin : (n,) true for leaves.
    sunlit : (n,) 0 in the shade, 1 in the sun.
    ambient : (n, 3) light from sky and surroundings.
    sun, sun_colour : (3,) direction towards it and its light.
    """
    out = np.empty_like(colour)
    _light(colour, normal, direction, thin, sunlit, ambient, sun, sun_colour, out)
    return out


@njit(cache=True, error_model="numpy")
def _sum_normals(vertices, triangles, total):  # type: ignore[no-untyped-def]
    for f in range(len(triangles)):
        a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        u, v = vertices[b] - vertices[a], vertices[c] - vertices[a]
        n = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
        for corner in (a, b, c):
            for k in range(3):
                total[corner, k] += n[k]


@njit(cache=True, error_model="numpy", parallel=True)
def _blend(facet, vertices, corner, triangles, primitive, uv, normal, shift):  # type: ignore[no-untyped-def]
    for i in prange(len(primitive)):
        corners = triangles[primitive[i]]
        weight = (1 - uv[i, 0] - uv[i, 1], uv[i, 0], uv[i, 1])
        n, p = np.zeros(3), np.zeros(3)
        for j in range(3):
            n += weight[j] * corner[corners[j]]
            p += weight[j] * vertices[corners[j]]
        length = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        if length <= 0.2 or np.sum(n * facet[i]) <= 0.2 * length:
            normal[i] = facet[i]
            continue
        normal[i] = n / length
        for j in range(3):
            m = corner[corners[j]]
            below = np.sum((p - vertices[corners[j]]) * m)
            if below < 0.0:
                shift[i] -= weight[j] * below * m


@njit(cache=True, error_model="numpy", parallel=True)
def _bilateral(ambient, known_range, known_normal, known, range_m, normal, radius, out):  # type: ignore[no-untyped-def]
    h, w = range_m.shape
    for y in prange(h):
        for x in range(w):
            here = range_m[y, x]
            if not np.isfinite(here):
                continue
            r, g, b, total = 0.0, 0.0, 0.0, 1e-9
            for j in range(max(y - radius, 0), min(y + radius + 1, h)):
                for i in range(max(x - radius, 0), min(x + radius + 1, w)):
                    if not known[j, i]:
                        continue
                    apart = (known_range[j, i] - here) / (0.008 * here)
                    alike = (
                        known_normal[j, i, 0] * normal[y, x, 0]
                        + known_normal[j, i, 1] * normal[y, x, 1]
                        + known_normal[j, i, 2] * normal[y, x, 2]
                    )
                    weight = 1e-4 + max(alike, 0.0) ** 3 / (1.0 + apart * apart * apart * apart)
                    r += weight * ambient[j, i, 0]
                    g += weight * ambient[j, i, 1]
                    b += weight * ambient[j, i, 2]
                    total += weight
            out[y, x, 0], out[y, x, 1], out[y, x, 2] = r / total, g / total, b / total


@njit(cache=True, error_model="numpy", parallel=True)
def _light(colour, normal, direction, thin, sunlit, ambient, sun, sun_colour, out):  # type: ignore[no-untyped-def]
    for i in prange(len(colour)):
        facing = normal[i, 0] * sun[0] + normal[i, 1] * sun[1] + normal[i, 2] * sun[2]
        front = max(facing, 0.0) * sunlit[i]
        through = max(-facing, 0.0) * sunlit[i] if thin[i] else 0.0
        # Light that has passed a leaf is yellower.
        red, green, blue = 0.85 * through, 0.95 * through, 0.30 * through
        out[i, 0] = colour[i, 0] * ((front + red) * sun_colour[0] + ambient[i, 0])
        out[i, 1] = colour[i, 1] * ((front + green) * sun_colour[1] + ambient[i, 1])
        out[i, 2] = colour[i, 2] * ((front + blue) * sun_colour[2] + ambient[i, 2])
