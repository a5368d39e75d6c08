"""Materials of the scene and how much of a near-infrared laser they reflect."""

from enum import IntEnum
from typing import Final

import numpy as np

from thalweg.core.types import ArrayF


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


REFLECTANCE: Final[ArrayF] = np.array([0.20, 0.28, 0.45, 0.32, 0.55, 0.35, 0.60, 0.02])
"""Diffuse reflectance at 905 nm by material: round values of the usual spectral libraries."""
