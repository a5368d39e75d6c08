"""Terrain and water as meshes whose cells grow with the distance from the shores.

Rows of vertices run along the reach, each at its own distance from a shore, each with a step that is the
finest one times a power of two. Neighbouring rows differ by a factor of two at most and share all vertices
that lie on their common edge: there are no holes and no vertices in the middle of an edge.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from thalweg.core.types import AnyArray, ArrayF, ArrayI, ArrayU8
from thalweg_lab.base.banks import LAND_M, WATER_M, beach_width, slope_width, smoothstep
from thalweg_lab.base.noise import fractal_noise
from thalweg_lab.base.river import River
from thalweg_lab.river.materials import Material
from thalweg_lab.river.mesh import MeshParts

WET_M: Final = 1.2
"""The water reaches this far under the banks, so that its line follows their relief."""

_CALM_M: Final = 40.0
"""Behind this distance the retreat of the bank does not shift the rows any more."""


@dataclass(frozen=True, slots=True)
class _Row:
    """Distance behind a shore (negative: in the water), or share of the way between them, and level."""

    side: int  # -1 right shore, +1 left shore, 0 between them
    place: float
    level: int


def _offsets(limits: ArrayF, grid: float) -> list[tuple[float, int]]:
    """Distances from 0 to the last limit and the level of the cells that begin there."""
    rows: list[tuple[float, int]] = [(0.0, 0)]
    for level, (begin, end) in enumerate(pairwise(limits)):
        count = max(1, round((end - begin) / (grid * 2.0**level)))
        inner = begin + (end - begin) * np.arange(1, count + 1) / count
        rows += [(float(x), level) for x in inner]
    return rows


def _rows(river: River) -> list[_Row]:
    """The rows from the right edge to the left one."""
    grid = river.config.grid_m
    land = _offsets(LAND_M, grid)
    narrow = min(0.7 * river.config.width_m / 2 * 0.9, WATER_M[-1])
    limits = np.append(WATER_M[narrow > WATER_M], narrow)
    water = _offsets(limits, grid)
    rows = [_Row(-1, x, level) for x, level in land[:0:-1]]
    rows += [_Row(-1, -x, level) for x, level in water]
    deepest = water[-1][1]
    between = river.config.width_m - 2 * narrow
    count = max(2, round(between / (grid * 2.0 ** (deepest + 1))))
    rows += [_Row(0, k / count, deepest + 1) for k in range(1, count)]
    rows += [_Row(1, -x, level) for x, level in water[:0:-1]]
    rows += [_Row(1, x, level) for x, level in land]
    return _balanced(rows)


def _balanced(rows: list[_Row]) -> list[_Row]:
    """Rows whose levels differ by one at most from one to the next."""
    levels = np.array([r.level for r in rows])
    for _ in range(len(LAND_M)):
        shifted = np.minimum(np.append(levels[1:], 99), np.insert(levels[:-1], 0, 99)) + 1
        levels = np.minimum(levels, shifted)
    return [_Row(r.side, r.place, int(level)) for r, level in zip(rows, levels, strict=True)]


def _row_n(river: River, row: _Row, s: ArrayF, narrow: float) -> ArrayF:
    """Offsets n of a row at places s."""
    right, left = river.shores(s)
    if row.side < 0:
        return np.asarray(-right - row.place)
    base = river.half_width(s)
    if row.side == 0:
        # Where the left bank has retreated, the rows of the left half follow it, those of the right do not.
        with_bank = smoothstep(np.asarray(2.0 * row.place - 1.0))
        return np.asarray((base - narrow) * (2.0 * row.place - 1.0) + (left - base) * with_bank)
    calm = 1.0 - smoothstep(np.asarray((row.place - 3.0) / (_CALM_M - 3.0)))
    return np.asarray(base + (left - base) * calm + row.place)


def add_terrain(parts: MeshParts, river: River) -> None:
    """Bed and banks, from the right edge of the land to the left one."""
    c = river.config
    rows = _rows(river)
    narrow = max(-r.place for r in rows if r.side != 0)
    coarsest = 2 ** max(r.level for r in rows)
    cells = coarsest * int(np.ceil(c.length_m / (c.grid_m * coarsest)))
    s_all, n_all, first, count = [], [], [], 0
    for row in rows:
        # Exactly the same places for rows of all levels.
        s = -c.length_m / 2 + c.length_m * (np.arange(0, cells + 1, 2**row.level) / cells)
        s_all.append(s)
        n_all.append(_row_n(river, row, s, narrow))
        first.append(count)
        count += len(s)
    s, n = np.concatenate(s_all), np.concatenate(n_all)
    vertices = np.concatenate([river.to_wcs(s, n), river.height(s, n)[:, None]], axis=1)
    strips = [_strip(first[k], first[k + 1], len(s_all[k]), len(s_all[k + 1])) for k in range(len(rows) - 1)]
    triangles = np.concatenate(strips)
    ms, mn = s[triangles].mean(axis=1), n[triangles].mean(axis=1)
    material = ground_material(river, ms, mn, vertices[triangles])
    variation = 0.5 + 0.25 * fractal_noise(ms, mn, 3.0, 6, river.noise_seed + 77, 0.75)
    parts.add(vertices, triangles, material, np.clip(variation, 0.0, 1.0))


def _strip(low: int, high: int, n_low: int, n_high: int) -> ArrayI:
    """Triangles between two rows, the second one to the left of the first."""
    if n_low == n_high:
        i = np.arange(n_low - 1)
        a, b = low + i, low + i + 1
        c, d = high + i, high + i + 1
        # Alternating diagonals: no grain runs across the terrain.
        even = (i + low) % 2 == 0
        first = np.where(even[:, None], np.stack([a, b, d], axis=1), np.stack([a, b, c], axis=1))
        second = np.where(even[:, None], np.stack([a, d, c], axis=1), np.stack([b, d, c], axis=1))
        return np.concatenate([first, second])
    if n_low > n_high:
        i = np.arange(n_high - 1)
        f0, f1, f2, c0, c1 = low + 2 * i, low + 2 * i + 1, low + 2 * i + 2, high + i, high + i + 1
        fans = [(f0, f1, c0), (f1, f2, c1), (f1, c1, c0)]
    else:
        i = np.arange(n_low - 1)
        f0, f1, f2, c0, c1 = high + 2 * i, high + 2 * i + 1, high + 2 * i + 2, low + i, low + i + 1
        fans = [(f0, c0, f1), (f1, c1, f2), (f1, c0, c1)]
    return np.concatenate([np.stack(f, axis=1) for f in fans])


def grassy(river: River, s_m: AnyArray, n_m: AnyArray, left_shore_m: AnyArray) -> ArrayF:
    """Share of turf on the banks, 0 to 1, in patches; none at the water line.

    Parameters
    ----------
    river : the river.
    s_m, n_m : flow coordinates.
    left_shore_m : distance of the left shore from the centre line, of the epoch that is meant.
    """
    s, n = np.broadcast_arrays(np.asarray(s_m, dtype=np.float64), np.asarray(n_m, dtype=np.float64))
    right, left = -river.half_width(s) - n, n - left_shore_m
    seed = river.noise_seed + 51
    patches = fractal_noise(s, n, 7.0, 7, seed, gain=0.72)
    width = slope_width(river.config)
    on_right = 0.1 + 0.75 * smoothstep(right / width) + 0.4 * patches - 0.9 * smoothstep((1.6 - right) / 1.2)
    on_left = 1.1 + 0.25 * patches - 1.2 * smoothstep((1.2 - left) / 1.0)
    return np.asarray(np.clip(np.where(right > 0, on_right, on_left), 0.0, 1.0))


def ground_material(river: River, s: ArrayF, n: ArrayF, corners: ArrayF) -> ArrayU8:
    """Materials (m,) of terrain triangles with middles (s, n) and corners (m, 3, 3)."""
    c = river.config
    right_shore, left_shore = river.shores(s)
    right, left = -right_shore - n, n - left_shore
    over = np.maximum(right, left)
    seed = river.noise_seed + 61
    ragged = fractal_noise(s, n, 2.0, 6, seed, 0.7)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    upright = normal[:, 2] / np.linalg.norm(normal, axis=1)
    kind = np.where(grassy(river, s, n, left_shore) > 0.5, Material.GRASS, Material.SOIL)
    steep = (left > 0) & (upright < 0.72 + 0.06 * ragged)
    kind = np.where(steep, Material.SOIL, kind)
    worn = np.minimum(river.retreat(s), 1.0)
    beach = beach_width(s, river.bend(s), worn, river.noise_seed)
    gravel = np.where(right > 0, right < 0.6 + 0.4 * ragged, left < beach + 0.1 + 0.25 * ragged)
    gravel &= ~steep
    behind = right - slope_width(c)
    if c.railway:
        gravel |= (behind > 0.7 + 0.2 * ragged) & (behind < 6.0 + 0.5 * ragged)
    kind = np.where(gravel, Material.GRAVEL, kind)
    kind = np.where(over <= 0, Material.BED, kind)
    # A bar of a second epoch that stands out of the water.
    dry = (over <= 0) & (river.depth(s, n) < -0.02)
    return np.where(dry, Material.GRAVEL, kind).astype(np.uint8)


def add_water(parts: MeshParts, river: River) -> None:
    """The water surface, flat, reaching under the banks."""
    c = river.config
    s = np.linspace(-c.length_m / 2, c.length_m / 2, int(c.length_m / 2.0) + 1)
    share = np.linspace(0.0, 1.0, 9)[None, :]
    _, left = river.shores(s)
    base = river.half_width(s)[:, None]
    n = (base + WET_M) * (2.0 * share - 1.0) + (left[:, None] - base) * smoothstep(2.0 * share - 1.0)
    xy = river.to_wcs(np.broadcast_to(s[:, None], n.shape), n)
    vertices = np.concatenate([xy, np.full((*n.shape, 1), c.water_level_m)], axis=-1).reshape(-1, 3)
    rows, columns = n.shape
    i, j = np.arange(rows - 1)[:, None], np.arange(columns - 1)[None, :]
    a = (i * columns + j).ravel()
    b, d, e = a + 1, a + columns, a + columns + 1
    triangles = np.concatenate([np.stack([a, d, e], axis=1), np.stack([a, e, b], axis=1)])
    parts.add(vertices, triangles, Material.WATER)
