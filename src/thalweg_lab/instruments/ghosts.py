"""Mirror ghosts: beams that water reflects onto something else come back along the same way.

The echo carries the length of the whole way and the direction in which the beam left: a point of the bank
appears below the water, where its mirror image is.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.types import ArrayF, ArrayU8
from thalweg_lab.instruments.footprint import Surfaces
from thalweg_lab.river.materials import Material
from thalweg_lab.river.waves import Waves

REFRACTIVE_INDEX: Final = 1.33
"""Water at 905 nm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ghosts:
    """Echoes by way of the water, each array over n beams.

    ``range_m`` (n,) the whole way, infinite where nothing is met; ``strength`` (n,); ``point_wcs_m`` (n, 3)
    the surface point that the beam came back from, above the water; ``material`` (n,) of it.
    """

    range_m: ArrayF
    strength: ArrayF
    point_wcs_m: ArrayF
    material: ArrayU8


def fresnel(cosine: ArrayF) -> ArrayF:
    """Share (n,) of unpolarised light that water reflects, by cosine of incidence (Born and Wolf, 1.5.2)."""
    c = np.clip(cosine, 0.0, 1.0)
    inside = np.sqrt(1.0 - (1.0 - c * c) / REFRACTIVE_INDEX**2)
    across = (c - REFRACTIVE_INDEX * inside) / (c + REFRACTIVE_INDEX * inside)
    along = (inside - REFRACTIVE_INDEX * c) / (inside + REFRACTIVE_INDEX * c)
    return np.asarray((across**2 + along**2) / 2)


def overlap(
    divergence_rad: float, hidden_slope_variance: ArrayF, cosine: ArrayF, beyond: ArrayF | float = 1.0
) -> ArrayF:
    """Share (n,) of the mirrored light that the receiver looks at, as waves within the footprint scatter it.

    Parameters
    ----------
    divergence_rad : full divergence of the beam and of the receiver's view.
    hidden_slope_variance : (n,) mean square length of the slopes of waves that the footprint hides.
    cosine : (n,) of incidence on the water.
    beyond : (n,) or one share of the way that lies behind the water.

    Notes
    -----
    Waves longer than the footprint turn the beam as a whole and its way back with it. Shorter ones scatter
    it: a facet of slope s turns the light by ``2 s`` in the plane of incidence and ``2 s cos(i)`` across it
    (Cox and Munk 1954). At the surface behind the water, a way R1 + R2 from the scanner, light that left at
    an angle a and was turned by b lies ``(R1 + R2) a + R2 b`` off the middle. Seen from the scanner, the spot
    of light has in each direction the variance ``v + d^2``: ``v = divergence^2 / 16`` of the beam, and d^2
    the variance of ``b R2 / (R1 + R2)``. What the receiver sees is found by following its rays backwards, so
    it is a spot of the same variance, whose facets are others. The echo is the integral of the product of
    both densities, ``N(0; 2 (v + d^2))`` for normal ones. Over that without waves, ``N(0; 2 v)``, it is
    ``sqrt(v / (v + d^2))`` in each of the two directions.
    """
    if divergence_rad == 0:
        return np.ones_like(cosine)
    own = divergence_rad**2 / 16
    # Half of the mean square slope belongs to each direction.
    in_plane = 4 * hidden_slope_variance / 2 * np.square(beyond)
    share = own / np.sqrt((own + in_plane) * (own + in_plane * cosine**2))
    return np.asarray(share)


def ghosts(
    surfaces: Surfaces,
    waves: Waves,
    origin_wcs_m: ArrayF,
    direction_wcs: ArrayF,
    range_m: ArrayF,
    t_s: ArrayF,
    divergence_rad: float,
) -> Ghosts:
    """Echoes of beams that have met water.

    Parameters
    ----------
    surfaces : scene.
    waves : the water's surface.
    origin_wcs_m, direction_wcs : (n, 3) rays.
    range_m : (n,) way to the water.
    t_s : (n,) time of the shots, seconds since the start.
    divergence_rad : full divergence of the beams.
    """
    place = origin_wcs_m + range_m[:, None] * direction_wcs
    flat = np.maximum(np.abs(direction_wcs[:, 2]), 1e-3)
    # The footprint is an ellipse, long where the beam grazes; a circle of its area stands for it.
    footprint = divergence_rad * range_m / np.sqrt(flat)
    normal = waves.normal(place[:, 0], place[:, 1], t_s, footprint_m=footprint)
    towards = np.einsum("ni,ni->n", normal, direction_wcs)
    mirrored = direction_wcs - 2.0 * towards[:, None] * normal
    # A ray that meets the back of a wave, or is mirrored into the water, is lost.
    fine = (towards < 0) & (mirrored[:, 2] > 0)
    hits = surfaces.caster.cast(place + 1e-3 * mirrored, mirrored)
    kind = surfaces.kinds(hits)
    met = fine & np.isfinite(hits.t_hit_m) & (kind != Material.WATER)
    way = np.where(met, hits.t_hit_m + 1e-3, 0.0)
    point = place + way[:, None] * mirrored
    cosine = np.clip(-towards, 0.0, 1.0)
    strength = (
        fresnel(cosine) ** 2
        * overlap(divergence_rad, waves.hidden_slope_variance(footprint), cosine, way / (range_m + way))
        * surfaces.strength(kind, hits.normal, mirrored, point[:, 2])
    )
    return Ghosts(
        range_m=np.where(met, range_m + way, np.inf),
        strength=np.where(met, strength, 0.0),
        point_wcs_m=point,
        material=kind,
    )
