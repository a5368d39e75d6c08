"""Profiles of the banks: the railway embankment on the right, the meadow on the left, grading of the mesh."""

from typing import Final

import numpy as np

from thalweg.core.types import ArrayF
from thalweg.settings.twin.scene import TwinScene
from thalweg_lab.base.noise import fractal_noise, value_noise

REACH_M: Final = 70.0
"""How far the land goes on behind the shores."""

LAND_M: Final = np.array([0.0, 1.1, 3.6, 11.0, 19.0, 34.0, REACH_M])
"""Distances behind the shore at which the cells of the terrain double, from the second one on."""

WATER_M: Final = np.array([0.0, 0.9, 2.1, 4.0, 8.0])
"""The same before the shore, in the water."""

RELIEF_CELLS: Final = np.array([1.0, 1.5, 3.0, 6.0, 12.0, 24.0, 40.0])
"""Smallest detail of the relief at these distances, in grid steps: as much as the cells carry."""

BALLAST_M: Final = 0.5
"""Height of the ballast under the track."""

TRACK_BEHIND_CREST_M: Final = 3.2
"""Distance of the track's middle from the crest."""

BRIDGE_CLEARANCE_M: Final = 4.2
"""Least height of the bridge above the water."""

GULLY_M: Final = 0.45
"""Depth of the deepest gullies."""


def smoothstep(x: ArrayF) -> ArrayF:
    """0 below 0, 1 above 1, smooth to the first derivative between."""
    u = np.clip(x, 0.0, 1.0)
    return np.asarray(u * u * (3.0 - 2.0 * u))


def slope_width(config: TwinScene) -> float:
    """Horizontal width of the embankment's slope, metres."""
    return float(config.embankment_height_m / np.tan(np.deg2rad(config.embankment_slope_deg)))


def track_offset(config: TwinScene) -> float:
    """Distance of the track's middle behind the right shore, metres."""
    return slope_width(config) + TRACK_BEHIND_CREST_M


def embankment(config: TwinScene, s: ArrayF, right: ArrayF, seed: int) -> tuple[ArrayF, ArrayF]:
    """Height over the water of the right bank, metres, and how rough it is (1: as configured).

    Parameters
    ----------
    config : section ``twin.scene``.
    s : places along the flow, metres.
    right : distance behind the right shore, metres, at least 0.
    seed : seed of the noise.
    """
    c = config
    top, width = c.embankment_height_m, slope_width(c)
    wobble = (
        1.0 + 0.10 * value_noise(s, right, 23.0, seed + 20) + 0.05 * value_noise(s, right, 6.0, seed + 21)
    )
    rise = np.tan(np.deg2rad(c.embankment_slope_deg)) * right * wobble
    # Water runs down the slope: gullies that begin below the crest and end above the toe.
    on_slope = np.clip(right / width, 0.0, 1.0)
    reach = 4.0 * on_slope * (1.0 - on_slope)
    # Noise that is drawn out along the slope, bent a little.
    ridge = fractal_noise(
        s + 0.35 * value_noise(s, right, 4.0, seed + 22), 0.12 * right, 7.0, 3, seed + 23, ridged=True
    )
    gully = GULLY_M * reach * (np.maximum(ridge, 0.0) - 0.45)
    # The crest is rounded over half a metre of height.
    blunt = 0.35
    z = -blunt * np.logaddexp(-rise / blunt, -top / blunt) + blunt * np.logaddexp(0.0, -top / blunt)
    behind = right - width
    if c.railway:
        away = np.abs(behind - TRACK_BEHIND_CREST_M)
        z = z + BALLAST_M * smoothstep((2.4 - away) / 0.9)
    # Behind the track a ditch, then the side of the valley.
    far = np.maximum(behind - 7.5, 0.0)
    z = z - 0.9 * smoothstep((behind - 6.0) / 2.5)
    hills = fractal_noise(s, right, 40.0, 3, seed + 24)
    z = z + 0.34 * far * smoothstep(far / 15.0) + 1.8 * hills * smoothstep(far / 12.0)
    rough = 1.7 - 1.3 * smoothstep((behind + 0.6) / 1.2)
    # At the toe the slope meets the bed's roughness.
    rough = 0.5 + (rough - 0.5) * smoothstep(right / 0.8)
    return np.asarray(z + gully), np.asarray(rough)


def meadow(
    config: TwinScene, s: ArrayF, n: ArrayF, left: ArrayF, bend: ArrayF, worn: ArrayF, seed: int
) -> tuple[ArrayF, ArrayF]:
    """Height over the water of the left bank, metres, and how rough it is (1: as configured).

    Parameters
    ----------
    config : section ``twin.scene``.
    s, n : flow coordinates, metres.
    left : distance behind the left shore, metres, at least 0.
    bend : curvature over the greatest one, positive to the left: the left bank is the inner one.
    worn : 0 to 1, how far a flood has freshly cut the bank.
    seed : seed of the noise.
    """
    along = np.full_like(s, 3.3)
    outer = np.maximum(np.maximum(-bend, worn), 0.0)
    scarp = 1.35 + 0.35 * value_noise(s, along, 31.0, seed + 30) + 0.5 * worn
    beach = beach_width(s, bend, worn, seed)
    # Undercut outer banks stand nearly upright, inner ones are flat.
    edge = 0.32 * fractal_noise(s, along, 2.6, 4, seed + 32) * outer
    width = np.maximum(
        2.6 - 2.3 * outer**0.5 + 0.5 * value_noise(s, along, 13.0, seed + 33) * (1 - outer), 0.28
    )
    beach = np.maximum(beach + edge, 0.1)
    foot = 0.10 * np.minimum(left, beach)
    step = smoothstep((left - beach) / width)
    behind = np.maximum(left - beach - width, 0.0)
    ground = 0.018 * behind + 0.25 * value_noise(s, n, 14.0, seed + 34) * smoothstep(behind / 6.0)
    ground = ground + 0.9 * fractal_noise(s, n, 60.0, 2, seed + 35) * smoothstep((behind - 10.0) / 25.0)
    ground = ground + 0.2 * np.maximum(behind - 44.0, 0.0)
    z = foot + (scarp - 0.10 * beach) * step + ground
    face = 4.0 * step * (1.0 - step)
    rough = 0.5 + (0.7 + 1.3 * outer) * face + 0.2 * smoothstep(behind / 3.0)
    return np.asarray(z), np.asarray(rough)


def bridge_soffit_m(config: TwinScene) -> float:
    """Height of the lower edge of the bridge's girders above the water, metres."""
    return max(BRIDGE_CLEARANCE_M, config.embankment_height_m - 1.6)


def ramp(config: TwinScene, s: ArrayF, left: ArrayF) -> ArrayF:
    """Height over the water of the earth ramp that leads from the meadow to the bridge, metres.

    Deep below the ground where there is none; the higher of both is the surface.
    """
    top = bridge_soffit_m(config) + 1.15
    away = np.abs(s - config.bridge_place * config.length_m / 2)
    crest = top - 0.07 * np.maximum(left - 14.0, 0.0)
    front = np.maximum(3.0 - left, 0.0) / 0.6
    return np.asarray(crest - front - np.maximum(away - 3.6, 0.0) / 1.6)


def beach_width(s: ArrayF, bend: ArrayF, worn: ArrayF, seed: int) -> ArrayF:
    """Width of the gravel before the left bank, metres: wide on inner bends."""
    along = np.full_like(s, 3.3)
    inner = np.maximum(bend, 0.0) * (1.0 - worn)
    return np.asarray(0.25 + (3.2 + 1.4 * value_noise(s, along, 19.0, seed + 31)) * inner)
