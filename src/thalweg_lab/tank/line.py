"""A light sheet on a surface: what each sub-beam meets, and whether the camera sees it."""

from dataclasses import dataclass

import numpy as np

from thalweg.core.types import ArrayB, ArrayF
from thalweg.lightsheet.optics.sensor import Sensor
from thalweg_lab.tank.fans import Fan, rays_of
from thalweg_lab.tank.forward import Seen, WaterBeams, beams_in_water, see
from thalweg_lab.tank.surfaces import GREEN, Posed


@dataclass(frozen=True, slots=True, kw_only=True)
class LinePoints:
    """Points (n) where sub-beams meet a surface.

    ``fan_angle_rad``; ``xyz_lcs_mm`` (n, 3); ``lit``: the sub-beam meets the surface; ``visible``: the
    camera sees the point, within its picture or beside it; ``albedo`` in green; ``laser_mm``: way of the
    laser in the water; ``cosine`` between the normal and the way to the camera; ``along`` (n, 3): the part
    of the sub-beam's direction along the surface. ``seen``: the image of each point.
    """

    fan_angle_rad: ArrayF
    xyz_lcs_mm: ArrayF
    lit: ArrayB
    visible: ArrayB
    albedo: ArrayF
    laser_mm: ArrayF
    cosine: ArrayF
    along: ArrayF
    seen: Seen

    @property
    def xy_px(self) -> ArrayF:
        """(n, 2) pixels, NaN where the sub-beam meets nothing."""
        return self.seen.xy_px


def line_on(sensor: Sensor, posed: Posed, fan: Fan, a_rad: ArrayF) -> LinePoints:
    """What sub-beams of the fan angles (n,) meet: the exact line, without width."""
    return meet(sensor, posed, a_rad, beams_in_water(*rays_of(fan, a_rad), sensor.window))


def meet(sensor: Sensor, posed: Posed, a_rad: ArrayF, beams: WaterBeams) -> LinePoints:
    """Where rays in the water meet a surface, and which of these points the camera sees."""
    hits = posed.first_hits(beams.start_mm, beams.direction)
    under = sensor.window.depth_mm(np.where(hits.met[:, None], hits.xyz_lcs_mm, 0.0)) > 0
    lit = hits.met & under
    seen = see(sensor, np.where(lit[:, None], hits.xyz_lcs_mm, np.nan))
    cosine = np.einsum("ni,ni->n", hits.normal_lcs, seen.up)
    visible = lit & np.isfinite(seen.xy_px).all(axis=1) & (cosine > 0)
    at = np.flatnonzero(visible)
    visible[at] = ~posed.blocked(hits.xyz_lcs_mm[at], seen.up[at], seen.water_mm[at])
    into = np.einsum("ni,ni->n", hits.normal_lcs, beams.direction)
    return LinePoints(
        fan_angle_rad=a_rad,
        xyz_lcs_mm=np.where(lit[:, None], hits.xyz_lcs_mm, np.nan),
        lit=lit,
        visible=visible,
        albedo=hits.albedo[:, GREEN],
        laser_mm=hits.way_mm,
        cosine=cosine,
        along=beams.direction - into[:, None] * hits.normal_lcs,
        seen=seen,
    )
