"""What comes back from a lidar beam: which surface, how far, how bright, or nothing."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.config.twin import TwinLidar
from thalweg.core.raycast import RayCaster
from thalweg.core.types import ArrayF, ArrayU8
from thalweg.simulation.materials import REFLECTANCE, Material

MIN_RANGE_M: Final = 0.4
PULSE_M: Final = 1.0
"""Surfaces nearer to each other than this give one echo."""
_WEAKEST: Final = 0.1
"""Reflectance times cosine of incidence that is just seen at 100 m; the limit grows with range squared."""
_WATER_POWER: Final = 8
"""Returns of water fall with this power of the cosine of incidence."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Echoes:
    """Echoes of rays: ``range_m`` (n,), infinite where none; ``strength`` (n,) reflectance times cosine."""

    range_m: ArrayF
    strength: ArrayF


def echoes(
    caster: RayCaster,
    material: ArrayU8,
    origin_wcs_m: ArrayF,
    direction_wcs: ArrayF,
    config: TwinLidar,
    rng: np.random.Generator,
) -> Echoes:
    """Noise-free echoes of (n, 3) rays; some are lost on water, at long range and by chance."""
    hits = caster.cast(origin_wcs_m, direction_wcs)
    range_m = hits.t_hit_m
    kind = material[np.maximum(hits.primitive, 0)]
    cosine = np.abs(np.sum(hits.normal * direction_wcs, axis=1))
    strength = REFLECTANCE[kind] * cosine
    with np.errstate(invalid="ignore"):
        weak = strength < _WEAKEST * (range_m / 100.0) ** 2
    water = kind == Material.WATER
    # A mirror seen from straight above returns by itself; its diffuse part is never seen.
    seen = np.where(water, config.water_returns * cosine**_WATER_POWER, 1.0 - config.dropouts)
    lost = rng.uniform(size=len(range_m)) >= seen
    gone = lost | (weak & ~water) | (range_m > config.max_range_m) | (range_m < MIN_RANGE_M)
    return Echoes(range_m=np.where(gone, np.inf, range_m), strength=strength)


def combine(first: Echoes, second: Echoes, returns: str, mixed: bool) -> tuple[Echoes, Echoes]:
    """Strongest and last return of beams that were sampled by two rays each.

    Two surfaces more than a pulse length apart give two returns; nearer ones give one, at the first ray's
    range or, for mixed pixels, between both.
    """
    both = np.isfinite(first.range_m) & np.isfinite(second.range_m)
    gap = np.abs(np.where(both, second.range_m, 0.0) - np.where(both, first.range_m, 0.0))
    merged = both & (gap < PULSE_M)
    base = np.where(np.isfinite(first.range_m), first.range_m, second.range_m)
    strength = np.where(np.isfinite(first.range_m), first.strength, second.strength)
    if mixed:
        base = np.where(merged, (first.range_m + np.where(both, second.range_m, 0.0)) / 2, base)
    if returns == "strongest" and not mixed:
        base, strength = first.range_m, first.strength
    apart = both & ~merged
    stronger_first = first.strength >= second.strength
    strongest = Echoes(
        range_m=np.where(apart, np.where(stronger_first, first.range_m, second.range_m), base),
        strength=np.where(apart, np.maximum(first.strength, second.strength), strength),
    )
    second_is_last = second.range_m > first.range_m
    last = Echoes(
        range_m=np.where(apart, np.where(second_is_last, second.range_m, first.range_m), base),
        strength=np.where(apart, np.where(second_is_last, second.strength, first.strength), strength),
    )
    return strongest, last


def quantise(echo: Echoes, noise_m: ArrayF, max_range_m: float) -> tuple[ArrayF, ArrayF]:
    """Distances in units of 2 mm (0 = none) and reflectivity 1 to 100, as the sensor reports them."""
    there = np.isfinite(echo.range_m)
    measured = np.where(there, echo.range_m, 0.0) + noise_m
    distance = np.where(there & (measured <= max_range_m), np.rint(measured / 0.002), 0.0)
    distance = np.clip(distance, 0, 65535)
    brightness = np.clip(np.rint(100.0 * echo.strength), 1, 100)
    return distance, np.where(distance > 0, brightness, 0.0)
