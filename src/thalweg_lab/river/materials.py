"""Materials of the scene: how they reflect lasers and daylight.

All numbers are round values. They follow the usual spectral libraries: USGS Spectral Library Version 7
(Kokaly et al. 2017) for leaves, grass, soil, gravel and bark, the ECOSTRESS library (Meerdink et al. 2019)
for rock, concrete, roof tiles and plaster. Water absorbs near-infrared light (Hale and Querry 1973): at both
wavelengths next to nothing comes back from below the surface. Green leaves reflect about half at 905 nm; at
1550 nm their water absorbs.
"""

from enum import IntEnum
from typing import Final

import numpy as np

from thalweg.core.types import ArrayB, ArrayF


class Material(IntEnum):
    """What a triangle of the scene is made of."""

    BED = 0
    SOIL = 1
    GRASS = 2
    STONE = 3
    LEAF = 4
    WOOD = 5
    WALL = 6
    WATER = 7
    GRAVEL = 8
    BARK = 9
    ROOF = 10
    GLASS = 11
    CONCRETE = 12
    REED = 13
    BLADE = 14
    RAIL = 15


_TABLE: Final[dict[Material, tuple[float, float, tuple[float, float, float]]]] = {
    # 905 nm, 1550 nm, linear RGB
    Material.BED: (0.20, 0.12, (0.135, 0.115, 0.080)),
    Material.SOIL: (0.28, 0.34, (0.190, 0.130, 0.080)),
    Material.GRASS: (0.45, 0.22, (0.085, 0.135, 0.035)),
    Material.STONE: (0.32, 0.34, (0.235, 0.220, 0.195)),
    Material.LEAF: (0.55, 0.26, (0.060, 0.125, 0.028)),
    Material.WOOD: (0.35, 0.30, (0.200, 0.150, 0.100)),
    Material.WALL: (0.60, 0.52, (0.600, 0.550, 0.450)),
    Material.WATER: (0.02, 0.01, (0.020, 0.032, 0.028)),
    Material.GRAVEL: (0.30, 0.32, (0.220, 0.195, 0.155)),
    Material.BARK: (0.33, 0.28, (0.120, 0.095, 0.072)),
    Material.ROOF: (0.30, 0.30, (0.260, 0.085, 0.048)),
    Material.GLASS: (0.08, 0.06, (0.030, 0.035, 0.040)),
    Material.CONCRETE: (0.40, 0.36, (0.330, 0.320, 0.295)),
    Material.REED: (0.48, 0.24, (0.155, 0.175, 0.060)),
    Material.BLADE: (0.50, 0.24, (0.095, 0.160, 0.040)),
    Material.RAIL: (0.25, 0.27, (0.130, 0.085, 0.060)),
}

REFLECTANCE: Final[ArrayF] = np.array([_TABLE[m][0] for m in Material])
"""Diffuse reflectance at 905 nm (VLP-16) by material."""

REFLECTANCE_1550: Final[ArrayF] = np.array([_TABLE[m][1] for m in Material])
"""Diffuse reflectance at 1550 nm (terrestrial scanner) by material."""

COLOUR: Final[ArrayF] = np.array([_TABLE[m][2] for m in Material])
"""(n, 3) mean colour in daylight by material, linear RGB (not gamma-encoded)."""

VEGETATION: Final[ArrayB] = np.isin(
    np.arange(len(Material)), [Material.LEAF, Material.BARK, Material.REED, Material.BLADE]
)
"""Whether a material belongs to a plant that stands on the ground; turf is ground."""

BARE_GROUND: Final[ArrayB] = np.isin(
    np.arange(len(Material)), [Material.BED, Material.SOIL, Material.GRASS, Material.GRAVEL]
)
"""Whether a material is that of the terrain; stones are none."""
