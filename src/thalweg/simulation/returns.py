"""What comes back from a lidar beam: which surface, how far, how bright, or nothing."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.config.twin_lidar import TwinLidar
from thalweg.core.raycast import RayCaster
from thalweg.core.types import ArrayB, ArrayF, ArrayU8
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
    """Echoes of rays.

    ``range_m`` (n,) is infinite where there is none; ``strength`` (n,) is reflectance times cosine of
    incidence; ``point_wcs_m`` (n, 3) is the surface point that was met; ``material`` (n,) what it is made of.
    """

    range_m: ArrayF
    strength: ArrayF
    point_wcs_m: ArrayF
    material: ArrayU8

    @property
    def there(self) -> ArrayB:
        """Which rays have an echo."""
        return np.isfinite(self.range_m)

    def or_else(self, other: "Echoes", use_other: ArrayB) -> "Echoes":
        """These echoes, but the other ones where ``use_other`` is true."""
        return Echoes(
            range_m=np.where(use_other, other.range_m, self.range_m),
            strength=np.where(use_other, other.strength, self.strength),
            point_wcs_m=np.where(use_other[:, None], other.point_wcs_m, self.point_wcs_m),
            material=np.where(use_other, other.material, self.material),
        )


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
    weak = strength < _WEAKEST * (range_m / 100.0) ** 2
    water = kind == Material.WATER
    # A mirror seen from straight above returns by itself; its diffuse part is never seen.
    seen = np.where(water, config.water_returns * cosine**_WATER_POWER, 1.0 - config.dropouts)
    lost = rng.uniform(size=len(range_m)) >= seen
    gone = lost | (weak & ~water) | (range_m > config.max_range_m) | (range_m < MIN_RANGE_M)
    length = np.where(gone, 0.0, range_m)
    return Echoes(
        range_m=np.where(gone, np.inf, range_m),
        strength=strength,
        point_wcs_m=origin_wcs_m + length[:, None] * direction_wcs,
        material=kind,
    )


def combine(first: Echoes, second: Echoes, *, mixed: bool) -> tuple[Echoes, Echoes]:
    """Strongest and last return of beams that were sampled by two rays each.

    Two surfaces more than a pulse length apart give two returns; nearer ones give one, at the first ray's
    range or, for mixed pixels, half-way between both.
    """
    both = first.there & second.there
    gap = np.where(both, second.range_m, 0.0) - np.where(both, first.range_m, 0.0)
    apart = both & (np.abs(gap) >= PULSE_M)
    one = first.or_else(second, ~first.there & second.there)
    if mixed:
        merged = both & ~apart
        middle = np.where(merged, one.range_m + gap / 2, one.range_m)
        one = Echoes(
            range_m=middle, strength=one.strength, point_wcs_m=one.point_wcs_m, material=one.material
        )
    strongest = one.or_else(second, apart & (second.strength > first.strength))
    last = one.or_else(second, apart & (gap > 0))
    return strongest, last


def quantise(echo: Echoes, noise_m: ArrayF, max_range_m: float) -> tuple[ArrayF, ArrayF]:
    """Distances in units of 2 mm (0 = none) and reflectivity 1 to 100, as the sensor reports them."""
    measured = np.where(echo.there, echo.range_m, 0.0) + noise_m
    distance = np.where(echo.there & (measured <= max_range_m), np.rint(measured / 0.002), 0.0)
    distance = np.clip(distance, 0, 65535)
    brightness = np.clip(np.rint(100.0 * echo.strength), 1, 100)
    return distance, np.where(distance > 0, brightness, 0.0)
