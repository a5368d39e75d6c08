"""What the antenna sees of the sky: free, dimmed and blocked satellites, and the solutions that are left.

Shadows of vegetation, steep banks and bridges and reflections from the water are what makes GNSS on rivers
"sub-optimal" (P2 1; T 1, 3.1.4). The sky is sampled once a second along the true track of the antenna:

- a ray that meets ground, stones, wood, walls or a bridge is *blocked*;
- one that meets leaves, or passes an edge within half a metre, is *dimmed*: about 6 dB less, a quarter of the
  weight. An edge that cuts into the first Fresnel zone weakens a signal, by 6 dB where it reaches the line of
  sight (knife edge, ITU-R P.526); 0.6 of that zone's radius ``sqrt(wavelength distance)`` are 0.5 m at 4 m;
- a ray mirrored at the horizon that meets water first is a *reflection*; only satellites below 30 degrees,
  where the antenna suppresses it little.

=========  ==============================  ====================
solution   satellites                      dilution (3D)
=========  ==============================  ====================
fixed      6 free, half of those in view   3
float      5 free or dimmed                10
single     4 free or dimmed                30
none       fewer                           worse
=========  ==============================  ====================

The limits are this twin's rule of thumb: a receiver that loses more than half of its satellites at once, as
under a bridge, has cycle slips in most double differences. Ambiguities are lost at once and fixed again only
after ``refix_s`` of a sky that would do.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from thalweg.core.frames import LocalFrame
from thalweg.core.geometry.raycast import RayCaster
from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.settings.twin.navigation import TwinGnss
from thalweg_lab.river.materials import Material
from thalweg_lab.river.scene import Scene
from thalweg_lab.river.sky import Constellation, dilution

STEP_S: Final = 1.0
"""Step of the sampled sky; at 0.4 m/s the boat moves by less than a crown in it."""

_DIMMING: Final = (Material.LEAF, Material.REED, Material.BLADE)
_DIMMED_WEIGHT: Final = 0.25
_FRESNEL_M: Final = 0.5
_REFLECTED_BELOW: Final = float(np.sin(np.deg2rad(30.0)))


class Solution(IntEnum):
    """Kinds of solution, in the order of their quality."""

    NONE = 0
    SINGLE = 1
    FLOAT = 2
    FIXED = 3


_NEEDS: Final = ((Solution.SINGLE, 4, 30.0), (Solution.FLOAT, 5, 10.0))
_FIX_FREE: Final = 6
_FIX_SHARE: Final = 0.5
_FIX_DILUTION: Final = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SkyView:
    """What the antenna sees, at m times.

    ``t_gps_s`` (m,); ``free``, ``dimmed``, ``blocked``, ``reflected`` (m,) numbers of satellites above the
    mask; ``dilution`` (m, 3) east, north, up; ``growth`` (m, 3) its ratio to that of the unobstructed sky.
    """

    t_gps_s: ArrayF
    free: ArrayI
    dimmed: ArrayI
    blocked: ArrayI
    reflected: ArrayI
    dilution: ArrayF
    growth: ArrayF

    @property
    def used(self) -> ArrayI:
        """Satellites (m,) that enter a solution."""
        return self.free + self.dimmed

    def at(self, t_gps_s: ArrayF) -> ArrayI:
        """Index (n,) of the sample that holds at each time: the last one before it."""
        return np.clip(np.searchsorted(self.t_gps_s, t_gps_s + 1e-6, side="right") - 1, 0, None)


def look_at_sky(
    gnss: TwinGnss, seed: int, frame: LocalFrame, scene: Scene, t_gps_s: ArrayF, antenna_wcs_m: ArrayF
) -> SkyView:
    """The sky above the antenna at sampled times.

    Parameters
    ----------
    gnss : section ``twin.gnss``.
    seed : seed of the campaign.
    frame : the world frame.
    scene : what stands around the river.
    t_gps_s : (m,) times.
    antenna_wcs_m : (m, 3) true place of the antenna.
    """
    satellites = Constellation.draw(seed)
    e = satellites.directions_wcs(frame, t_gps_s)
    up = e[..., 2] > np.sin(np.deg2rad(gnss.mask_deg))
    row, _ = np.nonzero(up)
    origins, rays = antenna_wcs_m[row], e[up]
    around = _Obstacles.of(scene)
    blocked, weakened, mirrored = (np.zeros(up.shape, dtype=np.bool_) for _ in range(3))
    blocked[up] = np.isfinite(_distance_m(around.opaque, origins, rays))
    weakened[up] = _weakened(around, origins, rays)
    down = rays * [1.0, 1.0, -1.0]
    water = _distance_m(around.water, origins, down)
    others = np.minimum(*(_distance_m(c, origins, down) for c in (around.opaque, around.leaves)))
    mirrored[up] = (water < others) & (rays[:, 2] < _REFLECTED_BELOW)
    dimmed = weakened & ~blocked
    free = up & ~blocked & ~weakened
    weights = free + _DIMMED_WEIGHT * dimmed
    seen = dilution(e, satellites.system, weights)
    return SkyView(
        t_gps_s=np.asarray(t_gps_s, dtype=np.float64),
        free=free.sum(axis=1),
        dimmed=dimmed.sum(axis=1),
        blocked=blocked.sum(axis=1),
        reflected=(mirrored & (free | dimmed)).sum(axis=1),
        dilution=seen,
        growth=np.maximum(seen / dilution(e, satellites.system, up.astype(np.float64)), 1.0),
    )


def solutions(view: SkyView, refix_s: float, *, both_ways: bool) -> ArrayI:
    """Kind of solution (m,), values of `Solution`.

    Parameters
    ----------
    view : what the antenna sees.
    refix_s : time that fixing takes after a loss.
    both_ways : post-processing, forward and backward: it fixes wherever one of both can.
    """
    total = np.linalg.norm(view.dilution, axis=1)
    best = np.full(len(total), int(Solution.NONE))
    for kind, satellites, limit in _NEEDS:
        best[(view.used >= satellites) & (total <= limit)] = kind
    enough = (view.free >= _FIX_FREE) & (view.free >= _FIX_SHARE * (view.used + view.blocked))
    best[(best == Solution.FLOAT) & enough & (total <= _FIX_DILUTION)] = Solution.FIXED
    forward = _after_losses(view.t_gps_s, best, refix_s)
    if not both_ways:
        return forward
    return np.maximum(forward, _after_losses(-view.t_gps_s[::-1], best[::-1], refix_s)[::-1])


def multipath_share(view: SkyView, water_reflection: float) -> ArrayF:
    """Share (m,) of the used satellites that are dimmed or reflected, at most 1: it scales multipath."""
    share = (view.dimmed + water_reflection * view.reflected) / np.maximum(view.used, 1)
    return np.asarray(np.minimum(share, 1.0))


def spans(t_s: ArrayF, kinds: ArrayI, step_s: float) -> list[tuple[float, float, str]]:
    """Runs of solutions other than fixed: begin, length, kind."""
    edges = np.flatnonzero(np.diff(kinds)) + 1
    begins = np.concatenate([[0], edges]).astype(np.int64)
    ends = np.concatenate([edges, [len(kinds)]])
    out = []
    for i, j in zip(begins.tolist(), ends.tolist(), strict=True):
        if j > i and kinds[i] != Solution.FIXED:
            length = float(t_s[j - 1] - t_s[i]) + step_s
            out.append((round(float(t_s[i]), 3), round(length, 3), Solution(int(kinds[i])).name.lower()))
    return out


def _after_losses(t: ArrayF, best: ArrayI, refix_s: float) -> ArrayI:
    """Fixed only where the last sample that could not fix is longer ago than ``refix_s``; float else."""
    broken = np.where(best == Solution.FIXED, -np.inf, t)
    since = t - np.maximum.accumulate(broken)
    return np.where((best == Solution.FIXED) & (since <= refix_s), int(Solution.FLOAT), best)


@dataclass(frozen=True, slots=True)
class _Obstacles:
    """Ray casters of what blocks, what dims and the water; None where the scene has nothing of a kind."""

    opaque: RayCaster | None
    leaves: RayCaster | None
    water: RayCaster | None

    @classmethod
    def of(cls, scene: Scene) -> "_Obstacles":
        """The parts of a scene that block, dim and mirror."""
        parts = (
            scene.without(*_DIMMING, Material.WATER),
            scene.only(*_DIMMING),
            scene.only(Material.WATER),
        )
        return cls(*(part.caster() if len(part.triangles) else None for part in parts))


def _weakened(around: _Obstacles, origins_wcs_m: ArrayF, rays: ArrayF) -> ArrayB:
    """Which rays meet leaves, or have something in the inner part of their first Fresnel zone."""
    weak = np.isfinite(_distance_m(around.leaves, origins_wcs_m, rays))
    side = np.cross(rays, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    for offset in (side, -side, np.cross(side, rays), -np.cross(side, rays)):
        beside = origins_wcs_m + _FRESNEL_M * offset
        for caster in (around.opaque, around.leaves):
            weak |= np.isfinite(_distance_m(caster, beside, rays))
    return weak


def _distance_m(caster: RayCaster | None, origins_wcs_m: ArrayF, rays: ArrayF) -> ArrayF:
    """Distance (n,) to the first hit, infinite where there is none."""
    if caster is None or not len(rays):
        return np.full(len(rays), np.inf)
    return caster.cast(origins_wcs_m, rays).t_hit_m
