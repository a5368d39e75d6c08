"""Boulders of the embankment's riprap, and cobbles along the water lines, as closed bodies partly sunk.

Quarried stone is angular with worn edges: a shape is the part of space within a dozen planes, rounded where
they meet. River cobbles are rounder and flatter. A few dozen shapes, each turned and stretched anew, do.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.types import AnyArray, ArrayB, ArrayF
from thalweg_lab.base.banks import beach_width, slope_width
from thalweg_lab.base.epochs import stretch
from thalweg_lab.base.noise import fractal_noise
from thalweg_lab.base.random import generator
from thalweg_lab.base.river import BAR_PLACE, River
from thalweg_lab.river.materials import Material
from thalweg_lab.river.mesh import MeshParts, ball, turned

_SHAPES: Final = 32
_BOULDER_CORNERS: Final = ((0.0, 26), (0.32, 60), (0.5, 120))
"""From which diameter in metres a boulder has how many corners."""

_COBBLE_CORNERS: Final = 10
_OVERDRAW: Final = 1.8
"""Candidates for each thing that is kept where noise makes clumps."""


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
    count = int(per_m * river.config.length_m * _OVERDRAW)
    half = river.config.length_m / 2
    return count, rng.uniform(-half, half, count), rng.uniform(0, 1, count)


def _clumped(river: River, s: ArrayF, n: ArrayF, chance: ArrayF, wavelength_m: float, number: int) -> ArrayB:
    """Which candidates stay: more in some places, fewer in others, 1 / overdraw on average."""
    noise = fractal_noise(s, n, wavelength_m, 3, river.noise_seed + number)
    return np.asarray(chance < np.clip(1.0 + 1.2 * noise, 0.15, 2.2) / _OVERDRAW)


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
    keep = _clumped(river, s, n, chance, 6.0, 81) & ~(lone & (river.retreat(s) > 0))
    keep[keep] = _rests(river, s[keep], n[keep])
    stones = _Stones(s, n, diameter)
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
