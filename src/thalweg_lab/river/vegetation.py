"""Where plants grow: bushes, trees, grass and reeds on both banks, in groups.

Plants stand where noise lets them, each class by its own random stream. Numbers are drawn for all candidates
before any is dropped: a second epoch that takes some away leaves the others as they are.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayI
from thalweg_lab.base.banks import TRACK_BEHIND_CREST_M, beach_width, slope_width
from thalweg_lab.base.epochs import stretch
from thalweg_lab.base.noise import fractal_noise
from thalweg_lab.base.random import generator
from thalweg_lab.base.river import River
from thalweg_lab.river.materials import Material
from thalweg_lab.river.mesh import MeshParts, tube_faces, tubes
from thalweg_lab.river.stones import stand
from thalweg_lab.river.terrain import grassy

# ---------------------------------------------------------------- leaves, branches and trunks: how bushes and
# trees are built from lobes
#
# A crown is a group of lobes, balls of foliage at the ends of branches. Leaves lie near the surface of a
# lobe, turned outwards and upwards; each is a rhombus folded along its midrib. The number of leaves is given;
# their size follows from the area that they have to cover, so that fewer leaves are larger ones.


_COVER: Final = 0.5
"""Area of the leaves over the area of the lobes' surfaces."""

_LEAF_LENGTH_M: Final = (0.045, 0.9)
_SIDES: Final = 5


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
    parts: MeshParts,
    rng: np.random.Generator,
    plants: Plants,
    centre: ArrayF,
    radius: ArrayF,
    leaves: float,
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


# ---------------------------------------------------------------- vegetation


GROWTH: Final = 1.3
"""How much larger bushes, grass and reeds are after ``grown_vegetation``."""

_OVERDRAW: Final = 2.5
_BLADES: Final = 11
_BUSH_LOBES, _TREE_LOBES, _FAR_LOBES = 6, 16, 9
_FAR_LEAVES: Final = 0.13
"""Leaves of a tree of the background, as a share of those of one on the banks."""


def _growth(river: River) -> float:
    return GROWTH if "grown_vegetation" in river.config.changes else 1.0


def _draw(
    river: River, rng: np.random.Generator, per_m: float, overdraw: float = _OVERDRAW
) -> tuple[int, ArrayF, ArrayF, ArrayB]:
    """Number of candidates, their places along the reach, chances, and whether they are on the right."""
    count = int(per_m * river.config.length_m * overdraw)
    half = river.config.length_m / 2
    s, chance = rng.uniform(-half, half, count), rng.uniform(0, 1, count)
    return count, s, chance, rng.uniform(size=count) < 0.5


def _kept(river: River, s: ArrayF, chance: ArrayF, density: ArrayF, overdraw: float = _OVERDRAW) -> ArrayB:
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
    return np.asarray(~((river.retreat(s) > 0) & (n > 0) & (n - left < 0.5)))


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


_BLADE_FACES: Final = np.array([[0, 1, 3], [0, 3, 2], [2, 3, 4]])


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
    begin, end = float(river.height(s[:1], n[:1])[0]) + 0.35, river.config.water_level_m - 0.15
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
