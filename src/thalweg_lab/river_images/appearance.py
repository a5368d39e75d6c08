"""Colour and fine relief of the scene as a function of place: procedural and band-limited.

Every detail is made of value noise or of cells at a known spacing. A detail fades out where its spacing comes
down to the footprint of what looks at it, so that a far surface shows the mean of a near one instead of
aliases. Nothing depends on the view or on time: two pictures of a place see the same stone.
"""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import ArrayF, ArrayI, GeometryError, njit, prange
from thalweg_lab.reach import mixed, noise_and_slope, noise_at, seen_share
from thalweg_lab.river import COLOUR, Material

WET_M: Final = 0.2
"""Height above the water up to which ground is wet by waves and creeping water."""

PLAIN, GRAVEL, ROCK, SOIL, GRASS, LEAF, BARK, WALL, ROOF = range(9)
"""Kinds of texture."""

_KIND: Final = {
    "BED": GRAVEL,
    "GRAVEL": GRAVEL,
    "STONE": ROCK,
    "SOIL": SOIL,
    "GRASS": GRASS,
    "LEAF": LEAF,
    "REED": LEAF,
    "BLADE": LEAF,
    "WOOD": BARK,
    "BARK": BARK,
    "WALL": WALL,
    "CONCRETE": WALL,
    "ROOF": ROOF,
}

# Mean cover of the patches: what is left of them from afar.
LICHEN: Final = 0.043
COVER: Final = 0.259
DRY: Final = 0.206
MOSS: Final = 0.234

# Longest lattice spacing (m), amplitude of each finer octave over the one before, contrast of the brightness,
# slope of the relief, stretch of the pattern along the vertical, spread of the brightness by `variation`.
_GRAIN: Final = np.array([
    [0.40, 0.60, 0.10, 0.05, 1.0, 0.20],  # plain
    [0.60, 0.70, 0.16, 0.10, 1.0, 0.10],  # gravel
    [0.20, 0.92, 0.26, 0.75, 1.0, 0.55],  # rock
    [0.90, 0.80, 0.24, 0.50, 1.0, 0.15],  # soil
    [0.30, 0.97, 0.32, 1.10, 1.4, 0.20],  # grass
    [0.02, 0.60, 0.14, 0.10, 2.0, 0.50],  # leaf
    [0.06, 0.75, 0.34, 0.60, 7.0, 0.30],  # bark
    [1.50, 0.62, 0.10, 0.06, 1.6, 0.35],  # wall
    [0.80, 0.62, 0.16, 0.10, 1.0, 0.25],  # roof
])  # fmt: skip


def kinds() -> ArrayI:
    """Kind of texture of each `Material`."""
    return np.array([_KIND.get(m.name, PLAIN) for m in Material])


def surface_appearance(
    points_wcs_m: ArrayLike,
    normal_wcs: ArrayLike,
    material: ArrayLike,
    variation: ArrayLike,
    footprint_m: ArrayLike,
    *,
    water_level_m: float,
) -> tuple[ArrayF, ArrayF]:
    """Linear RGB (n, 3) that surface points reflect, and normals (n, 3) with the fine relief.

    Parameters
    ----------
    points_wcs_m : (n, 3) places.
    normal_wcs : (n, 3) unit normals of the mesh; only walls and roofs ask for their direction.
    material : (n,) values of `Material`.
    variation : (n,) 0 to 1, the same for all of a stone, a leaf or a building.
    footprint_m : (n,) size of what looks at the point, on the surface.
    water_level_m : up coordinate of the water.

    Raises
    ------
    GeometryError : arrays of different lengths, or an unknown material.
    """
    p, normal = (np.ascontiguousarray(a, dtype=np.float64) for a in (points_wcs_m, normal_wcs))
    code = np.ascontiguousarray(material, dtype=np.int64)
    same, footprint = (np.ascontiguousarray(a, dtype=np.float64) for a in (variation, footprint_m))
    n = len(p)
    if p.shape != (n, 3) or normal.shape != (n, 3) or not code.shape == same.shape == footprint.shape == (n,):
        raise GeometryError(
            f"points {p.shape}, normals {normal.shape}, material {code.shape}, variation {same.shape}, "
            f"footprint {footprint.shape}",
            expected="(n, 3), (n, 3), (n,), (n,), (n,)",
        )
    if n and not 0 <= code.min() <= code.max() < len(COLOUR):
        raise GeometryError(f"materials {code.min()} to {code.max()}", expected=f"0 to {len(COLOUR) - 1}")
    colour, relief = np.empty((n, 3)), np.empty((n, 3))
    table = np.ascontiguousarray(COLOUR, dtype=np.float64)
    _look(p, normal, code, same, footprint, kinds(), table, _GRAIN, water_level_m, colour, relief)
    return colour, relief


def noise(points: ArrayLike, spacing: float, octaves: int, gain: float, seed: int) -> ArrayF:
    """Fractal value noise (n,) about zero at points (n, 3), for skies and the like."""
    p = np.ascontiguousarray(points, dtype=np.float64)
    out = np.empty(len(p))
    _noise_at(p, spacing, octaves, gain, seed, out)
    return out


@njit(cache=True, error_model="numpy")
def _fractal(x, y, z, spacing, gain, footprint, finest, seed):  # type: ignore[no-untyped-def]
    """Noise over octaves down to the footprint, and slopes of a relief of the same shape.

    Every other octave is turned, so that the lattices do not show.
    """
    total, gx, gy, gz = 0.0, 0.0, 0.0, 0.0
    amplitude = 1.0
    for octave in range(12):
        seen = seen_share(spacing, footprint)
        if seen <= 0.0 or spacing < finest:
            break
        part = seen * amplitude
        if octave % 2:
            px, py, pz = 0.6 * x + 0.8 * z, y, -0.8 * x + 0.6 * z
            px, py = 0.8 * px + 0.6 * py, -0.6 * px + 0.8 * py
            v, a, b, c = noise_and_slope(px / spacing, py / spacing, pz / spacing, seed + octave)
            a, b = 0.8 * a - 0.6 * b, 0.6 * a + 0.8 * b
            a, c = 0.6 * a - 0.8 * c, 0.8 * a + 0.6 * c
        else:
            v, a, b, c = noise_and_slope(x / spacing, y / spacing, z / spacing, seed + octave)
        total += part * v
        gx, gy, gz = gx + part * a, gy + part * b, gz + part * c
        amplitude *= gain
        spacing *= 0.5
    return total, gx, gy, gz


@njit(cache=True, error_model="numpy", parallel=True)
def _noise_at(p, spacing, octaves, gain, seed, out):  # type: ignore[no-untyped-def]
    for i in prange(len(p)):
        finest = spacing * 0.5**octaves * 1.5
        out[i] = _fractal(p[i, 0], p[i, 1], p[i, 2], spacing, gain, 1e-9, finest, seed)[0]


@njit(cache=True, error_model="numpy")
def _pebble(x, y, size, share, seed):  # type: ignore[no-untyped-def]
    """The topmost of the oval stones that lie scattered at a spacing.

    Returns distance from its middle (0 to 1 at its rim, 2 where no stone is), offsets east and north in
    radii, and two numbers in [0, 1) that belong to it.
    """
    u, v = x / size, y / size
    bend = noise_at(2.3 * u, 2.3 * v, 0.5, seed + 3)
    u, v = u + 0.10 * bend, v - 0.08 * bend
    iu, iv = np.int64(np.floor(u)), np.int64(np.floor(v))
    best, rank, ox, oy, tint, hue = 2.0, -1.0, 0.0, 0.0, 0.0, 0.0
    for j in range(-1, 2):
        for i in range(-1, 2):
            order = mixed(iu + i, iv + j, 0, seed)
            if order >= share or order <= rank:
                continue
            cx = iu + i + 0.15 + 0.7 * mixed(iu + i, iv + j, 1, seed)
            cy = iv + j + 0.15 + 0.7 * mixed(iu + i, iv + j, 2, seed)
            turn = 3.1416 * mixed(iu + i, iv + j, 3, seed)
            form = mixed(iu + i, iv + j, 4, seed)
            length, width = 0.42 + 0.28 * form, 0.34 + 0.16 * (1 - form)
            ca, sa = np.cos(turn), np.sin(turn)
            a, b = (ca * (u - cx) + sa * (v - cy)) / length, (-sa * (u - cx) + ca * (v - cy)) / width
            distance = a * a + b * b
            if distance < 1.0:
                best, rank, ox, oy = np.sqrt(distance), order, u - cx, v - cy
                tint, hue = mixed(iu + i, iv + j, 5, seed), mixed(iu + i, iv + j, 6, seed)
    return best, 2 * ox, 2 * oy, tint, hue


@njit(cache=True, error_model="numpy")
def _gravel(x, y, footprint, largest, share, seed):  # type: ignore[no-untyped-def]
    """Stones of four sizes: brightness (mean 1), warmth (mean 0), slopes east and north.

    A stone hides the smaller ones; between the smallest there is dark.
    """
    bright, warm, gx, gy, left = 0.0, 0.0, 0.0, 0.0, 1.0
    size, chance = largest, share
    for level in range(4):
        seen = seen_share(size / 2, footprint)
        if seen <= 0.0:
            break
        distance, ox, oy, tint, hue = _pebble(x, y, size, chance, seed + 11 * level)
        if distance < 1.0:
            rim = 1.0 - 0.6 * max(distance - 0.55, 0.0) / 0.45
            f = (0.90 + 1.33 * tint * tint) * rim
            bright += left * seen * f
            warm += left * seen * (hue - 0.5)
            gx, gy = gx - left * seen * distance * ox, gy - left * seen * distance * oy
            left *= 1.0 - seen
        elif level == 3:
            bright += left * seen * 0.45
            left *= 1.0 - seen
        size *= 0.4
        chance = min(chance * 1.9, 1.0)
        if left < 0.01:
            break
    return bright + left, warm, gx, gy


@njit(cache=True, error_model="numpy")
def _patches(x, y, z, spacing, gain, threshold, soft, mean, footprint, seed):  # type: ignore[no-untyped-def]
    """Spots with ragged edges, 0 to 1, where noise passes a threshold; from afar their mean."""
    seen = seen_share(spacing, footprint)
    if seen <= 0.0:
        return mean
    v = _fractal(x, y, z, spacing, gain, footprint, 0.004, seed)[0]
    return mean + seen * (min(max((v - threshold) / soft, 0.0), 1.0) - mean)


@njit(cache=True, error_model="numpy")
def _bricks(u, v, width, height, joint, footprint, seed):  # type: ignore[no-untyped-def]
    """Brightness of a brick and how far a place (u, v) on a wall is in a joint, both less their means."""
    row = np.floor(v / height)
    x = u / width + 0.5 * (np.int64(row) % 2)
    column = np.floor(x)
    du, dv = (x - column) * width, v - row * height
    edge = min(min(du, width - du), min(dv, height - dv))
    seen = seen_share(height / 2, footprint)
    tint = mixed(np.int64(column), np.int64(row), 0, seed) - 0.5
    mean = 1.0 - (1.0 - 2.0 * joint / width) * (1.0 - 2.0 * joint / height)
    return seen * tint, seen * (min(max(1.5 - edge / joint, 0.0), 1.0) - mean)


@njit(cache=True, error_model="numpy", parallel=True)
def _look(p, normal, code, variation, footprint, kind, table, grain, water, colour, relief):  # type: ignore[no-untyped-def]
    for i in prange(len(p)):
        x, y, z = p[i, 0], p[i, 1], p[i, 2]
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        what, same = kind[code[i]], variation[i]
        seed = 100 + 40 * code[i]
        foot = max(footprint[i], 1e-6)
        above = z - water
        g = grain[what]
        n, sx, sy, sz = _fractal(x, y, z / g[4], g[0], g[1], foot, 0.001, seed)
        sz /= g[4]
        broad = _fractal(x, y, z, 6.0, 0.6, foot, 0.7, seed + 20)[0]
        bright = 1.0 + g[5] * (same - 0.5) + g[2] * n + 0.10 * broad
        slope = 0.10 * g[3]
        sx, sy, sz = slope * sx, slope * sy, slope * sz
        # Red and blue over green: warmth by place and by thing.
        warm = 0.06 * broad + 0.10 * (same - 0.5)
        mix, mr, mg, mb = 0.0, 0.0, 0.0, 0.0
        # Directions along and up a wall or a roof.
        flat = np.sqrt(nx * nx + ny * ny)
        along = (nx * y - ny * x) / flat if flat > 0.05 else x
        up = z / flat if flat > 0.05 else y
        if what == 1:
            f, hue, gx, gy = _gravel(x, y, foot, 0.17, 0.30, seed + 21)
            bright *= f
            warm += 0.34 * hue
            sx, sy = sx + 0.75 * gx, sy + 0.75 * gy
        elif what == 2:
            speck = seen_share(0.004, foot) * noise_at(x / 0.004, y / 0.004, z / 0.004, seed + 22)
            vein = _fractal(x, y, z, 0.18, 0.5, foot, 0.02, seed + 23)[0] + 6.0 * (same - 0.5)
            bright *= 1.0 + 0.25 * speck + 0.12 * np.sin(5.0 * vein) * seen_share(0.18, foot)
            band = _fractal(x, y, z / 0.4, 0.30, 0.6, foot, 0.004, seed + 30)[0]
            bright *= 1.0 + 0.16 * band
            mix = 0.6 * _patches(x, y, z, 0.05, 0.75, 0.75, 0.35, LICHEN, foot, seed + 26)
            mix *= min(max(above / 0.5 - 0.6, 0.0), 1.0)
            pick = noise_at(x / 0.4, y / 0.4, z / 0.4, seed + 27)
            blend = min(max(0.5 + 3.0 * (pick - 0.3) * seen_share(0.4, foot), 0.0), 1.0)
            mr, mg, mb = 0.40 - 0.06 * blend, 0.40 - 0.10 * blend, 0.33 - 0.22 * blend
            warm += 0.06 * (same - 0.3)
        elif what == 3:
            f, hue, gx, gy = _gravel(x, y, foot, 0.11, 0.10, seed + 21)
            bright *= 0.45 + 0.55 * f
            sx, sy = sx + 0.5 * gx, sy + 0.5 * gy
            mix = 0.8 * _patches(x, y, z, 1.1, 0.75, 0.15, 0.45, COVER, foot, seed + 28)
            mix *= min(max(above / 0.6 - 0.5, 0.0), 1.0)
            blade = 1.0 + 0.5 * n
            mr, mg, mb = 0.105 * blade, 0.130 * blade, 0.045 * blade
        elif what == 4:
            tuft = noise_at(x / 0.09, y / 0.09, z / 0.14, seed + 21)
            bright *= 1.0 + 0.45 * seen_share(0.09, foot) * (0.5 - abs(tuft) - 0.13)
            blade = noise_at((x + 0.4 * y) / 0.004, (y - 0.4 * x) / 0.030, z / 0.04, seed + 22)
            blade += noise_at((x - 0.9 * y) / 0.005, (y + 0.9 * x) / 0.035, z / 0.05, seed + 23)
            bright *= 1.0 + 0.35 * blade * seen_share(0.004, foot)
            mix = 0.5 * _patches(x, y, z, 1.7, 0.8, 0.1, 0.9, DRY, foot, seed + 24)
            mr, mg, mb = 0.25 * bright, 0.22 * bright, 0.09 * bright
        elif what == 5:
            warm += 0.5 * (same - 0.5) + 0.15 * n
        elif what == 6:
            ridge = noise_at(x / 0.025, y / 0.025, z / 0.30, seed + 22)
            bright *= 1.0 + seen_share(0.025, foot) * (0.17 - 0.5 * (1.0 - abs(ridge)) ** 3)
            mix = 0.4 * _patches(x, y, z, 0.12, 0.6, 0.20, 0.3, MOSS, foot, seed + 23)
            mr, mg, mb = 0.13, 0.15, 0.07
        elif what == 7:
            rain = noise_at(along / 0.25, 0.5, up / 4.0, seed + 22) * seen_share(0.25, foot)
            bright *= 1.0 + 0.07 * rain
            tint, joint = _bricks(along, up, 0.50, 0.25, 0.008, foot, seed + 23)
            if same > 0.66 or same < 0.2:
                bright *= 1.0 + 0.16 * tint - 0.22 * joint
            warm += 0.7 * (same - 0.5) if same > 0.35 else 0.0
        elif what == 8:
            tint, joint = _bricks(along, up, 0.22, 0.34, 0.02, foot, seed + 23)
            bright *= 1.0 + 0.45 * tint - 0.45 * joint
            mix = 0.5 * _patches(x, y, z, 0.6, 0.6, 0.20, 0.3, MOSS, foot, seed + 24)
            mr, mg, mb = 0.10, 0.10, 0.06
        if bright < 0.08:
            bright = 0.08
        c = table[code[i]]
        r, gr, b = c[0] * bright * (1 + warm), c[1] * bright, c[2] * bright * (1 - 0.8 * warm)
        r, gr, b = r + mix * (mr - r), gr + mix * (mg - gr), b + mix * (mb - b)
        # Wet ground is darker; its upper edge wanders with the place. Beneath, algae grow, and above it the
        # mud of the last higher water has dried.
        if what != 5 and what != 8:
            edge = (
                above + 0.05 * noise_at(x / 0.35, y / 0.35, z / 0.35, 7) * seen_share(0.35, foot) + 0.02 * n
            )
            wet = min(max((0.2 - edge) / 0.08, 0.0), 1.0)
            silt = min(max((0.55 - edge) / 0.25, 0.0), 1.0) * (1 - wet) * 0.30
            algae = min(max((0.07 - edge) / 0.06, 0.0), 1.0) * 0.45
            r, gr, b = r + silt * (0.27 - r), gr + silt * (0.24 - gr), b + silt * (0.19 - b)
            r, gr, b = r + algae * (0.07 - r), gr + algae * (0.085 - gr), b + algae * (0.03 - b)
            dark = 1.0 - 0.52 * wet
            r, gr, b = r * dark, gr * dark, b * dark * (1 - 0.08 * wet)
        colour[i, 0], colour[i, 1], colour[i, 2] = min(r, 0.95), min(gr, 0.95), min(b, 0.95)
        # The relief bends the normal by the part of its slope that lies in the surface.
        inside = sx * nx + sy * ny + sz * nz
        nx, ny, nz = nx - sx + inside * nx, ny - sy + inside * ny, nz - sz + inside * nz
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        relief[i, 0], relief[i, 1], relief[i, 2] = nx / length, ny / length, nz / length
