"""The land of the scene: terrain and water, boulders and cobbles, bushes, trees, grass and reeds.

Rows of vertices run along the reach, each at its own distance from a shore, each with a step that is the
finest one times a power of two. Neighbouring rows differ by a factor of two at most and share all vertices
that lie on their common edge: there are no holes and no vertices in the middle of an edge.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayI, ArrayU8
from thalweg_lab.changes import slope_width, smoothstep, stretch
from thalweg_lab.random_numbers import generator
from thalweg_lab.reach import (
    BAR_PLACE,
    LAND_M,
    TRACK_BEHIND_CREST_M,
    WATER_M,
    River,
    beach_width,
    fractal_noise,
)
from thalweg_lab.river.mesh import Material, MeshParts, ball, tube_faces, tubes, turned

WET_M: Final = 1.2
"""The water reaches this far under the banks, so that its line follows their relief."""
_FLOODED: Final = 12.0
"""For each metre of a higher stage it reaches so many metres further: over the beaches up to the scarps."""
_FADE_M: Final = 40.0
"""Behind this distance the retreat of the bank does not shift the rows any more."""

GROWTH: Final = 1.3
"""How much larger bushes, grass and reeds are after ``grown_vegetation``."""
_PLANT_OVERDRAW: Final = 2.5
_BLADES: Final = 11
_BUSH_LOBES, _TREE_LOBES, _FAR_LOBES = 6, 16, 9
_FAR_LEAVES: Final = 0.13
"""Leaves of a tree of the background, as a share of those of one on the banks."""
_BLADE_FACES: Final = np.array([[0, 1, 3], [0, 3, 2], [2, 3, 4]])
_COVER: Final = 0.5
"""Area of the leaves over the area of the lobes' surfaces."""
_LEAF_LENGTH_M: Final = (0.045, 0.9)
_SIDES: Final = 5

_SHAPES: Final = 32
_BOULDER_CORNERS: Final = ((0.0, 26), (0.32, 60), (0.5, 120))
"""From which diameter in metres a boulder has how many corners."""
_COBBLE_CORNERS: Final = 10
_STONE_OVERDRAW: Final = 1.8
"""Candidates for each thing that is kept where noise makes clumps."""


@dataclass(frozen=True, slots=True)
class Plants:
    """Bushes or trees.

    Parameters
    ----------
    foot : (p, 3) where the trunk leaves the ground, wcs, metres.
    height : (p,) metres.
    spread : (p,) half width of the crown, metres.
    variation : (p,) 0 to 1.
    stays : (p,) false where a later epoch has lost the plant. Its numbers are drawn all the same, so that
        the others keep theirs.
    """

    foot: ArrayF
    height: ArrayF
    spread: ArrayF
    variation: ArrayF
    stays: ArrayB


# ---------------------------------------------------------------- terrain and water


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


def _row_n(row: _Row, right: ArrayF, left: ArrayF, base: ArrayF, narrow: float) -> ArrayF:
    """Offsets n of a row at places with these distances of both shores and of those of the first epoch."""
    if row.side == 0:
        # Where a bank has retreated, the rows of its half follow it, those of the other one do not.
        across = np.asarray(2.0 * row.place - 1.0)
        moved = (left - base) * smoothstep(across) - (right - base) * smoothstep(-across)
        return np.asarray((base - narrow) * across + moved)
    fade = 1.0 - smoothstep(np.asarray((row.place - 3.0) / (_FADE_M - 3.0)))
    if row.side < 0:
        return np.asarray(-(base + (right - base) * fade) - row.place)
    return np.asarray(base + (left - base) * fade + row.place)


def add_terrain(parts: MeshParts, river: River) -> None:
    """Bed and banks, from the right edge of the land to the left one."""
    c = river.config
    rows = _rows(river)
    narrow = max(-r.place for r in rows if r.side != 0)
    coarsest = 2 ** max(r.level for r in rows)
    cells = coarsest * int(np.ceil(c.length_m / (c.grid_m * coarsest)))
    s_all, n_all, first, count = [], [], [], 0
    at: dict[int, tuple[ArrayF, ArrayF, ArrayF, ArrayF]] = {}
    for level in {row.level for row in rows}:
        # Exactly the same places for rows of all levels.
        s = -c.length_m / 2 + c.length_m * (np.arange(0, cells + 1, 2**level) / cells)
        at[level] = (s, *river.shores(s), river.half_width(s))
    for row in rows:
        s, right, left, base = at[row.level]
        s_all.append(s)
        n_all.append(_row_n(row, right, left, base, narrow))
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
    fresh = river.lost(s, n)
    steep = ((left > 0) | fresh) & (upright < 0.72 + 0.06 * ragged)
    kind = np.where(steep, Material.SOIL, kind)
    worn = np.minimum(river.retreat(s), 1.0)
    beach = beach_width(s, river.bend(s), worn, river.noise_seed)
    gravel = np.where(right > 0, right < 0.6 + 0.4 * ragged, left < beach + 0.1 + 0.25 * ragged)
    gravel &= ~steep
    behind = -river.half_width(s) - n - slope_width(c)
    if c.railway:
        gravel |= (behind > 0.7 + 0.2 * ragged) & (behind < 6.0 + 0.5 * ragged)
    kind = np.where(gravel, Material.GRAVEL, kind)
    kind = np.where(over <= 0, Material.BED, kind)
    # A bar of a second epoch that stands out of the water.
    dry = (over <= 0) & (river.depth(s, n) < -0.02)
    return np.where(dry, Material.GRAVEL, kind).astype(np.uint8)


def add_water(parts: MeshParts, river: River) -> None:
    """The water surface, even, falling as the reach does, reaching under the banks."""
    c = river.config
    s = np.linspace(-c.length_m / 2, c.length_m / 2, int(c.length_m / 2.0) + 1)
    share = np.linspace(0.0, 1.0, 9)[None, :]
    right, left = river.shores(s)
    base, across = river.half_width(s)[:, None], 2.0 * share - 1.0
    reach = WET_M + _FLOODED * max(c.stage_m, 0.0)
    moved = (left[:, None] - base) * smoothstep(across) - (right[:, None] - base) * smoothstep(-across)
    n = (base + reach) * across + moved
    xy = river.to_wcs(np.broadcast_to(s[:, None], n.shape), n)
    up = np.broadcast_to(c.water_level_m + c.stage_m - river.fallen_m(s)[:, None], n.shape)
    vertices = np.concatenate([xy, up[..., None]], axis=-1).reshape(-1, 3)
    rows, columns = n.shape
    i, j = np.arange(rows - 1)[:, None], np.arange(columns - 1)[None, :]
    a = (i * columns + j).ravel()
    b, d, e = a + 1, a + columns, a + columns + 1
    triangles = np.concatenate([np.stack([a, d, e], axis=1), np.stack([a, e, b], axis=1)])
    parts.add(vertices, triangles, Material.WATER)


# ---------------------------------------------------------------- plants
#
# Plants stand where noise lets them, each class by its own random stream. Numbers are drawn for all
# candidates before any is dropped: a second epoch that takes some away leaves the others as they are.


def _growth(river: River) -> float:
    return GROWTH if "grown_vegetation" in river.config.changes else 1.0


def _draw(
    river: River, rng: np.random.Generator, per_m: float, overdraw: float = _PLANT_OVERDRAW
) -> tuple[int, ArrayF, ArrayF, ArrayB]:
    """Number of candidates, their places along the reach, chances, and whether they are on the right."""
    count = int(per_m * river.config.length_m * overdraw)
    half = river.config.length_m / 2
    s, chance = rng.uniform(-half, half, count), rng.uniform(0, 1, count)
    return count, s, chance, rng.uniform(size=count) < 0.5


def _kept(
    river: River, s: ArrayF, chance: ArrayF, density: ArrayF, overdraw: float = _PLANT_OVERDRAW
) -> ArrayB:
    """Which candidates grow in the first epoch; nothing does under the bridge and on the weir."""
    c = river.config
    clear = np.ones(len(s), dtype=np.bool_)
    for there, place, half in ((c.bridge, river.bridge_s_m(), 5.5), (c.weir, river.weir_s_m(), 4.0)):
        if there:
            clear &= np.abs(s - place) > half
    return np.asarray((chance < density / overdraw) & clear)


def _stays(river: River, s: ArrayF, n: ArrayF) -> ArrayB:
    """Which plants the river has not washed away with their bank."""
    _, left = river.shores(s)
    return np.asarray(~((river.retreat(s) > 0) & (n > 0) & (n - left < 0.5)) & ~river.lost(s, n))


def _groups(river: River, s: ArrayF, n: ArrayF, wavelength_m: float, number: int) -> ArrayF:
    """Density that is 1 on average, 0 in the gaps and up to 2.5 in the groups."""
    noise = fractal_noise(s, n, wavelength_m, 3, river.noise_seed + number)
    return np.asarray(np.clip(1.0 + 2.2 * noise, 0.0, 2.5))


def _behind_beach(river: River, s: ArrayF) -> ArrayF:
    """Distance behind the left shore at which the gravel of the first epoch ends."""
    return beach_width(s, river.bend(s), np.zeros_like(s), river.noise_seed).clip(0.2)


def _off_track(river: River, right: ArrayF) -> ArrayB:
    behind = right - slope_width(river.config)
    return np.asarray((np.abs(behind - TRACK_BEHIND_CREST_M) > 3.4) | (not river.config.railway))


def add_bushes(parts: MeshParts, river: River, seed: int) -> None:
    """Bushes on the embankment, along its crest and on the left bank."""
    c = river.config
    rng = generator(seed, "scene bushes")
    count, s, chance, on_right = _draw(river, rng, c.bushes_per_100m / 100)
    width = slope_width(c)
    right = 0.8 + (width + 0.8) * rng.beta(1.3, 1.1, count)
    left = _behind_beach(river, s) + 0.3 + 16.0 * rng.beta(0.7, 2.6, count)
    spread = np.exp(rng.normal(np.log(0.6), 0.45, count)).clip(0.2, 1.6)
    # From brambles, broad and low, to young willows.
    height = np.maximum(spread * rng.uniform(0.7, 2.3, count), 0.35)
    variation = rng.uniform(size=count)
    n = np.where(on_right, -river.half_width(s) - right, river.half_width(s) + left)
    keep = _kept(river, s, chance, _groups(river, s, n, 9.0, 91)) & (~on_right | _off_track(river, right))
    grow = _growth(river)
    bushes = _plant(river, s, n, height * grow, spread * grow, variation, keep)
    centre, radius = crown_lobes(rng, bushes, _BUSH_LOBES, low=0.18)
    add_wood(parts, generator(seed, "scene bush wood"), bushes, centre, 0.012, 0)
    add_leaves(parts, generator(seed, "scene bush leaves"), bushes, centre, radius, c.leaves_per_bush)


def _plant(
    river: River, s: ArrayF, n: ArrayF, height: ArrayF, spread: ArrayF, variation: ArrayF, keep: ArrayB
) -> Plants:
    s, n = s[keep], n[keep]
    foot = stand(river, s, n)
    return Plants(foot, height[keep], spread[keep], variation[keep], _stays(river, s, n))


def add_trees(parts: MeshParts, river: River, seed: int) -> None:
    """Small trees on the embankment, alders and willows along the left shore, single ones on the meadow."""
    c = river.config
    rng = generator(seed, "scene trees")
    count, s, chance, _ = _draw(river, rng, c.trees_per_100m / 100)
    on_right = rng.uniform(size=count) < 0.42
    width = slope_width(c)
    right = 1.5 + (width - 0.7) * rng.beta(1.5, 0.9, count)
    by_shore = rng.uniform(size=count) < 0.7
    left = _behind_beach(river, s) + np.where(
        by_shore, rng.uniform(1.0, 3.8, count), rng.uniform(5.0, 26.0, count)
    )
    height = np.where(on_right, rng.uniform(2.6, 5.5, count), rng.uniform(5.0, 12.0, count))
    spread = height * rng.uniform(0.22, 0.34, count)
    variation = rng.uniform(size=count)
    n = np.where(on_right, -river.half_width(s) - right, river.half_width(s) + left)
    keep = _kept(river, s, chance, _groups(river, s, n, 31.0, 92)) & (~on_right | _off_track(river, right))
    trees = _plant(river, s, n, height, spread, variation, keep)
    centre, radius = crown_lobes(rng, trees, _TREE_LOBES, low=0.22)
    add_wood(parts, generator(seed, "scene tree wood"), trees, centre, 0.017, 6)
    add_leaves(parts, generator(seed, "scene tree leaves"), trees, centre, radius, c.leaves_per_tree)


def add_background(parts: MeshParts, river: River, seed: int) -> None:
    """The wood on the valley side behind the railway and the rows of trees behind the meadow."""
    c = river.config
    rng = generator(seed, "scene background")
    count, s, chance, on_right = _draw(river, rng, 5.0 * c.trees_per_100m / 100, 1.6)
    right = slope_width(c) + rng.uniform(12.0, 56.0, count)
    rows = rng.uniform(size=count) < 0.5
    left = np.where(rows, 48.0 + rng.normal(0, 1.5, count), rng.uniform(50.0, 64.0, count))
    height = rng.uniform(9.0, 19.0, count)
    spread = height * rng.uniform(0.22, 0.32, count)
    variation = rng.uniform(size=count)
    n = np.where(on_right, -river.half_width(s) - right, river.half_width(s) + left)
    keep = _kept(river, s, chance, np.clip(_groups(river, s, n, 45.0, 93), 0.0, 1.6), 1.6)
    trees = _plant(river, s, n, height, spread, variation, keep)
    centre, radius = crown_lobes(rng, trees, _FAR_LOBES, low=0.05)
    add_wood(parts, generator(seed, "scene background wood"), trees, centre, 0.016, 4)
    leaves = _FAR_LEAVES * c.leaves_per_tree
    add_leaves(parts, generator(seed, "scene background leaves"), trees, centre, radius, leaves)


def add_grass(parts: MeshParts, river: River, seed: int) -> None:
    """Tufts of grass where turf grows, tallest near the water."""
    c = river.config
    rng = generator(seed, "scene grass")
    count, s, chance, on_right = _draw(river, rng, c.grass_per_m, 3.0)
    if count == 0:
        return
    width = slope_width(c)
    right = 0.6 + (width + 0.5) * rng.beta(0.9, 1.4, count)
    left = 0.15 + 9.0 * rng.beta(0.8, 2.6, count)
    height = np.exp(rng.normal(np.log(0.30), 0.4, count)).clip(0.10, 0.75)
    variation = rng.uniform(size=count)
    n = np.where(on_right, -river.half_width(s) - right, river.half_width(s) + left)
    density = 1.7 * grassy(river, s, n, river.half_width(s)) * _groups(river, s, n, 1.6, 94)
    keep = _kept(river, s, chance, density, 3.0)
    s, n, m = s[keep], n[keep], int(np.count_nonzero(keep))
    foot, tall = stand(river, s, n), height[keep] * _growth(river)
    place = foot[:, None, :] + rng.normal(0, 1, (m, _BLADES, 3)) * np.array([0.09, 0.09, 0.0])
    place[..., 2] -= 0.03
    length = tall[:, None] * rng.uniform(0.5, 1.15, (m, _BLADES))
    lean = rng.uniform(0.05, 0.75, (m, _BLADES))
    turn = rng.uniform(0, 2 * np.pi, (m, _BLADES))
    blades = blade_corners(place, length, lean, turn, 0.009)
    tint = 0.6 * variation[keep][:, None] + 0.4 * rng.uniform(size=(m, _BLADES))
    stays = np.repeat(_stays(river, s, n), _BLADES)
    parts.add_copies(_BLADE_FACES, blades[stays], Material.BLADE, tint.reshape(-1)[stays])


def blade_corners(place: ArrayF, length: ArrayF, lean: ArrayF, turn: ArrayF, half_width_m: float) -> ArrayF:
    """Corners (m * k, 5, 3) of bent blades: two at the foot, two at half length, the tip.

    Parameters
    ----------
    place : (m, k, 3) feet.
    length, lean, turn : (m, k) metres, how far the tip leans over as a share of the length, direction.
    half_width_m : half the width of a blade at its foot.
    """
    way = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=-1)
    aside = np.stack([-way[..., 1], way[..., 0], np.zeros_like(turn)], axis=-1) * half_width_m
    up = np.array([0.0, 0.0, 1.0])
    out, rise = (length * lean)[..., None], (length * np.sqrt(1.0 - 0.6 * lean**2))[..., None]
    knee = place + 0.28 * out * way + 0.62 * rise * up
    tip = place + out * way + 0.95 * rise * up
    corners = np.stack([place - aside, place + aside, knee - 0.8 * aside, knee + 0.8 * aside, tip], axis=2)
    return np.asarray(corners.reshape(-1, 5, 3))


def add_reeds(parts: MeshParts, river: River, seed: int) -> None:
    """Stalks of reed with their leaves, in beds along both margins."""
    c = river.config
    rng = generator(seed, "scene reeds")
    count, s, chance, _ = _draw(river, rng, c.reeds_per_m, 4.0)
    if count == 0:
        return
    on_right = rng.uniform(size=count) < 0.2
    off = rng.normal(-0.25, 0.4, count).clip(-1.3, 0.7)
    height = rng.uniform(0.9, 1.9, count)
    variation = rng.uniform(size=count)
    n = np.where(on_right, -river.half_width(s) - off, river.half_width(s) + off)
    beds = np.clip(9.0 * fractal_noise(s, 0.3 * n, 11.0, 2, river.noise_seed + 95) - 1.5, 0.0, 4.0)
    keep = _kept(river, s, chance, beds, 4.0)
    s, n, m = s[keep], n[keep], int(np.count_nonzero(keep))
    foot, tall = stand(river, s, n), height[keep] * _growth(river)
    lean = rng.normal(0, 0.10, (m, 3)) * tall[:, None]
    u = np.array([0.0, 0.55, 1.0])
    axis = foot[:, None] + u[None, :, None] * np.array([0.0, 0.0, 1.0]) * tall[:, None, None]
    axis[..., :2] += (u**2)[None, :, None] * lean[:, None, :2]
    axis[:, 0, 2] -= 0.1
    stays = _stays(river, s, n)
    girth = np.broadcast_to(np.array([0.005, 0.004, 0.002]), (m, 3))
    parts.add_copies(tube_faces(3, 3), tubes(axis, girth, 3)[stays], Material.REED, variation[keep][stays])
    at = rng.uniform(0.25, 0.85, (m, 4))
    place = foot[:, None] + at[..., None] * (axis[:, 2] - foot)[:, None, :]
    length, turn = rng.uniform(0.25, 0.55, (m, 4)), rng.uniform(0, 2 * np.pi, (m, 4))
    blades = blade_corners(place, length, rng.uniform(0.3, 0.95, (m, 4)), turn, 0.009)
    tint = np.repeat(variation[keep], 4)
    stays = np.repeat(stays, 4)
    parts.add_copies(_BLADE_FACES, blades[stays], Material.REED, tint[stays])


def add_fallen_tree(parts: MeshParts, river: River, seed: int) -> None:
    """A tree that a flood has felled: its root on the left bank, its crown in the margin, without leaves."""
    if "fallen_tree" not in river.config.changes:
        return
    rng = generator(seed, "scene fallen tree")
    where = stretch(river.config, "fallen_tree")
    u = np.linspace(0.0, 1.0, 6)
    s = where.middle_m + where.half_m * (0.5 * u - 0.25)
    _, left = river.shores(s)
    n = left + 2.0 - u * (2.0 + 0.085 * river.config.width_m)
    axis = np.concatenate([river.to_wcs(s, n), np.zeros((6, 1))], axis=1)
    begin = float(river.height(s[:1], n[:1])[0]) + 0.35
    end = river.config.water_level_m - float(river.fallen_m(s[0])) - 0.15
    axis[:, 2] = begin + (end - begin) * u
    trunk = tubes(axis[None], (0.24 * (1 - 0.7 * u))[None], 9)
    parts.add_copies(tube_faces(9, 6), trunk, Material.BARK, 0.5)
    # Bare branches from the outer part of the trunk, and the roots that have come out of the ground.
    k, roots = 36, 12
    at = np.concatenate([rng.integers(2, 6, k), np.zeros(roots, dtype=np.int64)])
    way = rng.normal(0, 1, (k + roots, 3)) * [1.0, 1.0, 0.8] + (axis[-1] - axis[0]) * 0.12
    way[:k, 2] = np.abs(way[:k, 2])
    reach = np.concatenate([rng.uniform(0.5, 1.6, k), rng.uniform(0.4, 0.8, roots)])
    way *= reach[:, None] / np.linalg.norm(way, axis=1, keepdims=True)
    steps = np.array([0.0, 0.5, 1.0])
    paths = axis[at][:, None] + way[:, None] * steps[None, :, None]
    paths[:, 1] += rng.normal(0, 0.07, (k + roots, 3))
    girth = np.broadcast_to(np.array([0.05, 0.03, 0.008]), (k + roots, 3))
    parts.add_copies(tube_faces(5, 3), tubes(paths, girth, 5), Material.BARK, 0.5)


# ---------------------------------------------------------------- leaves, branches and trunks: how bushes and
# trees are built from lobes
#
# A crown is a group of lobes, balls of foliage at the ends of branches. Leaves lie near the surface of a
# lobe, turned outwards and upwards; each is a rhombus folded along its midrib. The number of leaves is given;
# their size follows from the area that they have to cover, so that fewer leaves are larger ones.


def crown_lobes(rng: np.random.Generator, plants: Plants, lobes: int, *, low: float) -> tuple[ArrayF, ArrayF]:
    """Centres (p, lobes, 3) and radii (p, lobes) of the lobes, in wcs.

    Parameters
    ----------
    rng : randomness.
    plants : what they belong to.
    lobes : how many each has.
    low : where the crown begins, as a share of the height.
    """
    p = len(plants.height)
    way = rng.standard_normal((p, lobes, 3))
    way /= np.linalg.norm(way, axis=2, keepdims=True)
    way *= rng.uniform(0.35, 1.0, (p, lobes, 1)) ** 0.5
    share = rng.uniform(0.22, 0.55, (p, lobes))
    radius = share * plants.spread[:, None]
    middle = (1.0 + low) / 2
    tall = (1.0 - low) / 2 * plants.height
    room = np.stack([plants.spread, plants.spread, tall], axis=1)[:, None, :] - 0.75 * radius[:, :, None]
    centre = way * np.maximum(room, 0.15 * plants.spread[:, None, None])
    centre[..., 2] += (middle * plants.height)[:, None]
    # Crowns are broadest below their middle.
    upper = np.clip((centre[..., 2] / plants.height[:, None] - middle) / (1.0 - middle), 0.0, 1.0)
    centre[..., :2] *= (1.0 - 0.45 * upper)[..., None]
    return centre + plants.foot[:, None, :], radius


def add_leaves(
    parts: MeshParts, rng: np.random.Generator, plants: Plants, centre: ArrayF, radius: ArrayF, leaves: float
) -> None:
    """Leaves on the lobes of plants; ``leaves`` on a plant of mean lobe surface."""
    p, lobes = radius.shape
    if p == 0:
        return
    area = np.sum(4 * np.pi * radius**2, axis=1)
    count = np.maximum((leaves * area / np.mean(area)).astype(np.int64), 8)
    owner = np.repeat(np.arange(p), count)
    m = len(owner)
    # Lobes get leaves in proportion to their surface.
    share = np.cumsum(radius**2, axis=1)
    share /= share[:, -1:]
    lobe = np.minimum(np.sum(rng.uniform(size=m)[:, None] > share[owner], axis=1), lobes - 1)
    length = np.sqrt(_COVER * area / count / 0.25).clip(*_LEAF_LENGTH_M)[owner]
    length *= rng.uniform(0.7, 1.25, m)
    out = rng.standard_normal((m, 3), dtype=np.float32).astype(np.float64)
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    # Mostly near the surface, some inside.
    ragged = 1.0 + 0.16 * rng.standard_normal(m).clip(-2.0, 2.0)
    inside = (0.35 + 0.65 * rng.uniform(size=m) ** 0.5) * ragged
    place = centre[owner, lobe] + out * (radius[owner, lobe] * inside)[:, None]
    up = np.array([0.0, 0.0, 1.0])
    normal = 0.5 * out + 0.55 * up + 0.75 * _normals(rng, m)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    along = 0.8 * out - 0.25 * up + 0.8 * _normals(rng, m)
    along -= np.sum(along * normal, axis=1, keepdims=True) * normal
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    variation = 0.55 * plants.variation[owner] + 0.45 * rng.uniform(size=m)
    stays = plants.stays[owner]
    corners = leaf_corners(place[stays], along[stays], normal[stays], length[stays])
    parts.add_copies(np.array([[0, 1, 2], [0, 2, 3]]), corners, Material.LEAF, variation[stays])


def _normals(rng: np.random.Generator, m: int) -> ArrayF:
    return rng.standard_normal((m, 3), dtype=np.float32).astype(np.float64)


def leaf_corners(place: ArrayF, along: ArrayF, normal: ArrayF, length: ArrayF) -> ArrayF:
    """Corners (m, 4, 3) of folded rhombi: base, right, tip, left."""
    aside = np.cross(normal, along) * (0.25 * length)[:, None]
    reach = along * (0.5 * length)[:, None]
    lift = normal * (0.06 * length)[:, None]
    return np.stack([place - reach, place - aside + lift, place + reach, place + aside + lift], axis=1)


def add_wood(
    parts: MeshParts, rng: np.random.Generator, plants: Plants, centre: ArrayF, thick: float, rings: int
) -> None:
    """Trunk of each plant, and a branch to each of its lobes.

    Parameters
    ----------
    parts : target.
    rng : randomness.
    plants : the plants.
    centre : (p, lobes, 3) ends of the branches.
    thick : radius of the trunk over the height.
    rings : sections of a trunk; 0: no trunk, the branches leave the ground.
    """
    p, lobes = centre.shape[:2]
    if p == 0:
        return
    root = plants.foot - [0.0, 0.0, 0.25]
    top = np.mean(centre, axis=1)
    top[:, 2] = plants.foot[:, 2] + 0.86 * plants.height
    bend = rng.normal(0, 0.035, (p, max(rings, 2), 3)) * plants.height[:, None, None]
    u = np.linspace(0.0, 1.0, max(rings, 2))
    bend *= (u * (1 - u) * 4)[None, :, None]
    axis = root[:, None] + (top - root)[:, None] * u[None, :, None] + bend
    radius = (
        (thick * plants.height)[:, None] * (1.0 - 0.88 * u[None, :]) * (1.0 + 0.5 * np.exp(-9 * u))[None, :]
    )
    if rings:
        trunks = tubes(axis, radius, _SIDES + 2)[plants.stays]
        faces = tube_faces(_SIDES + 2, rings)
        parts.add_copies(faces, trunks, Material.BARK, plants.variation[plants.stays])
    # Branches leave the trunk below their lobe; those of bushes leave the ground.
    rise = (centre[..., 2] - root[:, None, 2]) / (top - root)[:, None, 2]
    start_u = np.clip(0.6 * rise - 0.05, 0.0, 0.9) if rings else np.zeros((p, lobes))
    start = _on_axis(axis, u, start_u)
    v = np.array([0.0, 0.5, 1.0])
    sag = rng.normal(0, 0.08, (p, lobes, 1, 3)) * (v * (1 - v) * 4)[None, None, :, None]
    sag = sag * np.linalg.norm(centre - start, axis=2)[:, :, None, None]
    path = start[:, :, None] + (centre - start)[:, :, None] * v[None, None, :, None] + sag
    first = 0.5 * thick * plants.height[:, None] * (1.0 - 0.8 * start_u)
    girth = first[:, :, None] * np.array([1.0, 0.65, 0.3])[None, None, :]
    bodies = tubes(path.reshape(p * lobes, 3, 3), girth.reshape(p * lobes, 3), _SIDES - 1)
    stays = np.repeat(plants.stays, lobes)
    variation = np.repeat(plants.variation, lobes)[stays]
    parts.add_copies(tube_faces(_SIDES - 1, 3), bodies[stays], Material.BARK, variation)


def _on_axis(axis: ArrayF, u: ArrayF, at: ArrayF) -> ArrayF:
    """Points (p, k, 3) of polylines at parameters (p, k)."""
    step = u[1] - u[0]
    i: ArrayI = np.minimum((at / step).astype(np.int64), len(u) - 2)
    rest = (at / step - i)[..., None]
    row: AnyArray = np.arange(len(axis))[:, None]
    return np.asarray(axis[row, i] * (1 - rest) + axis[row, i + 1] * rest)


# ---------------------------------------------------------------- stones
#
# Quarried stone is angular with worn edges: a shape is the part of space within a dozen planes, rounded where
# they meet. River cobbles are rounder and flatter. A few dozen shapes, each turned and stretched anew, do.


def stand(river: River, s: ArrayF, n: ArrayF) -> ArrayF:
    """Points (m, 3) of the ground in wcs."""
    return np.concatenate([river.to_wcs(s, n), river.height(s, n)[:, None]], axis=1)


def rock_shapes(rng: np.random.Generator, corners: int, sharpness: float) -> tuple[ArrayF, AnyArray]:
    """Shapes (k, corners, 3) of about unit half axes, and their faces.

    Parameters
    ----------
    rng : randomness.
    corners : vertices of each.
    sharpness : exponent by which planes are joined; great ones leave sharp edges.
    """
    way, faces = ball(corners)
    normal = rng.standard_normal((_SHAPES, 9, 3))
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    axes = np.broadcast_to(np.concatenate([np.eye(3), -np.eye(3)]), (_SHAPES, 6, 3))
    normal = np.concatenate([axes, normal], axis=1)
    distance = np.concatenate(
        [rng.uniform(0.85, 1.0, (_SHAPES, 6)), rng.uniform(0.62, 1.05, (_SHAPES, 9))], axis=1
    )
    towards = np.maximum(np.einsum("vd,kpd->kvp", way, normal), 0.0) / distance[:, None, :]
    radius = np.sum(towards**sharpness, axis=2) ** (-1.0 / sharpness)
    radius *= 1.0 + 0.03 * rng.standard_normal(radius.shape).clip(-2, 2)
    return way[None] * radius[:, :, None], faces


@dataclass(frozen=True, slots=True)
class _Stones:
    """Where stones lie and how large they are."""

    s: ArrayF
    n: ArrayF
    diameter: ArrayF


def _slopes(river: River, s: ArrayF, n: ArrayF, base_m: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Slope of the ground along east and north, averaged over a base of the stone's size."""
    d = base_m
    along = (river.height(s + d, n) - river.height(s - d, n)) / (2 * d)
    across = (river.height(s, n + d) - river.height(s, n - d)) / (2 * d)
    theta = river.angle(s)
    east = along * np.cos(theta) - across * np.sin(theta)
    north = along * np.sin(theta) + across * np.cos(theta)
    return np.clip(east, -1.0, 1.0), np.clip(north, -1.0, 1.0)


@dataclass(frozen=True, slots=True)
class _Looks:
    """What decides on the looks of each stone; drawn for all candidates, so that none shifts another."""

    shape: AnyArray
    turn: ArrayF
    roll: ArrayF
    axes: ArrayF
    sunk: ArrayF
    variation: ArrayF

    @classmethod
    def draw(cls, rng: np.random.Generator, count: int, flat: float) -> "_Looks":
        """So many stones by chance, ``flat`` times as high as wide."""
        return cls(
            shape=rng.integers(_SHAPES, size=count),
            turn=rng.uniform(0, 2 * np.pi, count),
            roll=rng.uniform(-0.5, 0.5, count),
            axes=np.array([1.0, 0.82, flat]) * rng.uniform(0.82, 1.18, (count, 3)),
            sunk=rng.uniform(-0.35, 0.25, count),
            variation=rng.uniform(0, 1, count),
        )

    def bodies(self, pick: ArrayB, shapes: ArrayF, stones: _Stones, river: River) -> ArrayF:
        """Vertices (m, k, 3) of the stones that ``pick`` takes of all candidates."""
        s, n = stones.s[pick], stones.n[pick]
        half = stones.diameter[pick] / 2
        local = shapes[self.shape[pick]] * (self.axes[pick] * half[:, None])[:, None, :]
        # Turn about x first, so that the flat sides lie askew, then about the vertical.
        cos, sin = np.cos(self.roll[pick])[:, None], np.sin(self.roll[pick])[:, None]
        y, z = local[..., 1], local[..., 2]
        local = np.stack([local[..., 0], cos * y - sin * z, sin * y + cos * z], axis=-1)
        local = turned(local, self.turn[pick])
        top = local[..., 2].max(axis=1)
        # Stones lie against the slope: lift each vertex by most of the slope below it.
        east, north = _slopes(river, s, n, 0.5 * half + 0.02)
        local[..., 2] += 0.85 * (east[:, None] * local[..., 0] + north[:, None] * local[..., 1])
        foot = stand(river, s, n)
        foot[:, 2] += self.sunk[pick] * top
        return np.asarray(local + foot[:, None, :])


def _rests(river: River, s: ArrayF, n: ArrayF) -> ArrayB:
    """Where the ground is flat enough for a stone to lie; on upright banks none does."""
    east, north = _slopes(river, s, n, np.full(len(s), 0.15))
    return np.asarray(np.hypot(east, north) < 0.95)


def _candidates(river: River, rng: np.random.Generator, per_m: float) -> tuple[int, ArrayF, ArrayF]:
    """How many candidates, their places along the reach and a uniform number that decides on keeping."""
    count = int(per_m * river.config.length_m * _STONE_OVERDRAW)
    half = river.config.length_m / 2
    return count, rng.uniform(-half, half, count), rng.uniform(0, 1, count)


def _clumped(river: River, s: ArrayF, n: ArrayF, chance: ArrayF, wavelength_m: float, number: int) -> ArrayB:
    """Which candidates stay: more in some places, fewer in others, 1 / overdraw on average."""
    noise = fractal_noise(s, n, wavelength_m, 3, river.noise_seed + number)
    return np.asarray(chance < np.clip(1.0 + 1.2 * noise, 0.15, 2.2) / _STONE_OVERDRAW)


def add_boulders(parts: MeshParts, river: River, seed: int) -> None:
    """Riprap: 0.2 to 0.85 m, densest and largest at the toe of the embankment; a few on the left bank."""
    rng = generator(seed, "scene boulders")
    count, s, chance = _candidates(river, rng, river.config.stones_per_m)
    if count == 0:
        return
    width = slope_width(river.config)
    toe, lone = rng.uniform(size=count) < 0.62, rng.uniform(size=count) < 0.04
    at_toe = rng.normal(0.4, 0.7, count).clip(-1.4, 2.6)
    up = 0.2 + 0.95 * width * rng.beta(1.0, 2.2, count)
    left = rng.normal(0.2, 0.5, count).clip(-1.0, 1.4)
    diameter = np.exp(rng.normal(np.log(0.40), 0.36, count)).clip(0.2, 0.85)
    diameter *= np.where(toe, 1.0, 0.8)
    diameter = diameter.clip(0.2, 0.85)
    looks = _Looks.draw(rng, count, 0.68)
    right_offset = np.where(toe, at_toe, up)
    s, right_offset = _moved(river, seed, s, right_offset, lone)
    n = np.where(lone, river.half_width(s) + left, -river.half_width(s) - right_offset)
    keep = _clumped(river, s, n, chance, 6.0, 81) & ~(lone & (river.retreat(s) > 0)) & ~river.lost(s, n)
    keep[keep] = _rests(river, s[keep], n[keep])
    stones = _Stones(s, n, diameter)
    _add_boulders(parts, river, seed, stones, looks, keep)


def add_new_boulders(parts: MeshParts, river: River, seed: int) -> None:
    """Three large boulders on the toe of the right bank that only this epoch has."""
    if "new_boulders" not in river.config.changes:
        return
    where = stretch(river.config, "new_boulders")
    s = where.middle_m + where.half_m * np.array([-0.6, 0.0, 0.6])
    n = -river.half_width(s) - np.array([0.9, 1.6, 1.1])
    stones = _Stones(s, n, np.array([0.8, 1.3, 1.0]))
    looks = _Looks.draw(generator(seed, "scene new boulders"), 3, 0.75)
    _add_boulders(parts, river, seed, stones, looks, np.ones(3, dtype=np.bool_))


def _add_boulders(
    parts: MeshParts, river: River, seed: int, stones: _Stones, looks: _Looks, keep: ArrayB
) -> None:
    diameter = stones.diameter
    for k, (least, corners) in enumerate(_BOULDER_CORNERS):
        most = _BOULDER_CORNERS[k + 1][0] if k + 1 < len(_BOULDER_CORNERS) else np.inf
        pick = keep & (diameter >= least) & (diameter < most)
        shapes, faces = rock_shapes(generator(seed, f"scene boulder shapes {corners}"), corners, 30.0)
        bodies = looks.bodies(pick, shapes, stones, river)
        parts.add_copies(faces, bodies, Material.STONE, looks.variation[pick])


def _moved(river: River, seed: int, s: ArrayF, offset: ArrayF, fixed: ArrayB) -> tuple[ArrayF, ArrayF]:
    """Places of the boulders, in a second epoch with half of those of one stretch moved."""
    if "moved_boulders" not in river.config.changes:
        return s, offset
    rng = generator(seed, "scene moved boulders")
    where = stretch(river.config, "moved_boulders")
    chosen = where.holds(s) & ~fixed & (rng.uniform(size=len(s)) < 0.5)
    down, along = rng.uniform(0.3, 2.0, len(s)), rng.uniform(0.5, 3.0, len(s))
    new_s = np.minimum(s + along, where.middle_m + where.half_m)
    return np.where(chosen, new_s, s), np.where(chosen, np.maximum(offset - down, -1.5), offset)


def add_cobbles(parts: MeshParts, river: River, seed: int) -> None:
    """Stones of 3 to 11 cm on both sides of the water lines, and over the beaches of inner bends."""
    rng = generator(seed, "scene cobbles")
    count, s, chance = _candidates(river, rng, river.config.cobbles_per_m)
    if count:
        on_right = rng.uniform(size=count) < 0.5
        right = rng.normal(0.08, 0.34, count).clip(-1.0, 1.3)
        share, spread = rng.uniform(0, 1, count), rng.normal(0, 0.25, count)
        beach = beach_width(s, river.bend(s), np.zeros(count), river.noise_seed)
        left = share * (np.maximum(beach, 0.1) + 0.9) - 0.7 + spread
        diameter = np.exp(rng.normal(np.log(0.055), 0.36, count)).clip(0.03, 0.11)
        looks = _Looks.draw(rng, count, 0.6)
        n = np.where(on_right, -river.half_width(s) - right, river.half_width(s) + left)
        keep = _clumped(river, s, n, chance, 3.0, 82) & (on_right | (river.retreat(s) <= 0))
        keep &= ~river.lost(s, n)
        keep[keep] = _rests(river, s[keep], n[keep])
        _add_cobbles(parts, river, seed, _Stones(s, n, diameter), looks, keep)
    if "gravel_bar" in river.config.changes and count:
        _cover_bar(parts, river, seed)


def _add_cobbles(
    parts: MeshParts, river: River, seed: int, stones: _Stones, looks: _Looks, keep: ArrayB
) -> None:
    shapes, faces = rock_shapes(generator(seed, "scene cobble shapes"), _COBBLE_CORNERS, 7.0)
    bodies = looks.bodies(keep, shapes, stones, river)
    parts.add_copies(faces, bodies, Material.STONE, looks.variation[keep])


def _cover_bar(parts: MeshParts, river: River, seed: int) -> None:
    """Cobbles on the gravel bar of a second epoch."""
    rng = generator(seed, "scene bar cobbles")
    where = stretch(river.config, "gravel_bar")
    count = int(0.6 * river.config.cobbles_per_m * where.half_m)
    s = where.middle_m + where.half_m * rng.uniform(-0.8, 0.8, count)
    middle = river.half_width(s) - BAR_PLACE * river.config.width_m
    n = middle + 0.035 * river.config.width_m * rng.uniform(-1, 1, count)
    diameter = np.exp(rng.normal(np.log(0.055), 0.36, count)).clip(0.03, 0.11)
    looks = _Looks.draw(rng, count, 0.6)
    _add_cobbles(parts, river, seed, _Stones(s, n, diameter), looks, np.ones(count, dtype=np.bool_))


# ---------------------------------------------------------------- a niche in the right bank
#
# The ground has the hollow; its roof is a body of its own, so that the bank truly overhangs.


_ROOF_M: Final = (1.45, 3.2)
"""From the edge of the roof to its end inside the bank: distances behind the shore."""
_ROOF_THICK_M: Final = 0.35


def add_niche(parts: MeshParts, river: River, seed: int) -> None:
    """The roof of the niche, or, once it has fallen, its lumps of soil on the heap."""
    c = river.config
    where = stretch(c, "niche")
    if "niche" in c.changes:
        _add_roof(parts, river, where.middle_m, where.half_m + 0.4)
    if "collapsed_niche" in c.changes:
        rng = generator(seed, "scene collapsed niche")
        s = where.middle_m + where.half_m * np.array([-0.55, -0.1, 0.25, 0.6])
        n = -river.half_width(s) - np.array([0.9, 1.5, 0.8, 1.4])
        looks = _Looks.draw(rng, 4, 0.6)
        shapes, faces = rock_shapes(generator(seed, "scene slumped soil"), 60, 12.0)
        stones = _Stones(s, n, np.array([0.8, 1.1, 0.7, 0.9]))
        bodies = looks.bodies(np.ones(4, dtype=np.bool_), shapes, stones, river)
        parts.add_copies(faces, bodies, Material.SOIL, looks.variation)


def _add_roof(parts: MeshParts, river: River, middle_m: float, half_m: float) -> None:
    """A closed slab whose upper side is the ground without the niche."""
    c = river.config
    plain = River(c.model_copy(update={"changes": ()}), river.seed)
    step = 2.0 * c.grid_m
    s = np.linspace(middle_m - half_m, middle_m + half_m, max(int(2 * half_m / step), 2) + 1)
    right = np.linspace(*_ROOF_M, max(int((_ROOF_M[1] - _ROOF_M[0]) / step), 2) + 1)
    n = -plain.half_width(s)[:, None] - right[None, :]
    s = np.broadcast_to(s[:, None], n.shape)
    xy, top = plain.to_wcs(s, n), plain.height(s, n)
    # A little lower where the slab lies in the bank, so that both surfaces never coincide.
    top = top - 0.02
    low = top - _ROOF_THICK_M
    upper = np.concatenate([xy, top[..., None]], axis=-1)
    lower = np.concatenate([xy, low[..., None]], axis=-1)
    rows, columns = n.shape
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, d, e = (number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:])
    # Rows run along the flow, columns to its right: so the upper side is counter-clockwise from above.
    sheet = np.concatenate(
        [np.stack([a, b, e], axis=-1).reshape(-1, 3), np.stack([a, e, d], axis=-1).reshape(-1, 3)]
    )
    rim = np.concatenate([number[0, :-1], number[:-1, -1], number[-1, :0:-1], number[:0:-1, 0]])
    after = np.roll(rim, -1)
    below = rows * columns
    side = np.concatenate(
        [np.stack([rim, after, after + below], axis=1), np.stack([rim, after + below, rim + below], axis=1)]
    )[:, ::-1]
    faces = np.concatenate([sheet, sheet[:, ::-1] + below, side])
    turf = np.repeat([Material.GRASS, Material.SOIL], [len(sheet), len(sheet) + len(side)])
    parts.add(np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)]), faces, turf)
