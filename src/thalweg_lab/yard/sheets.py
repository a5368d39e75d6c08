"""Printed sheets of the field: where each module lies in space, and which module a point of space shows.

Module coordinates are those of `thalweg.calibration.markers.sheets`: u to the right and v down from (0, 0) to
(10, 10), half a module of white margin outside, saddles at (1, 1), (9, 1), (9, 9), (1, 9).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.calibration.markers.sheets import MARGIN_MODULES, SADDLES_MODULES, SHEET_MODULES
from thalweg.core.types import ArrayF
from thalweg_lab.yard.cones import FieldCone, Plane

_MIDDLE: Final = SHEET_MODULES / 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Sheet:
    """One sheet on a surface.

    Parameters
    ----------
    marker : printed id.
    module_m : side of a module.
    thing : name of the object of the scene that it is glued on.
    surface : cone or plane.
    place : middle of the sheet on the surface: slant distance and azimuth, or metres right and down.
    turn_rad : by which the print is turned clockwise.
    mirrored : printed in a mirror.
    """

    marker: int
    module_m: float
    thing: str
    surface: FieldCone | Plane
    place: tuple[float, float] = (0.0, 0.0)
    turn_rad: float = 0.0
    mirrored: bool = False

    @property
    def cone(self) -> str | None:
        """Name of the cone that it is glued on, if it is one."""
        return self.surface.name if isinstance(self.surface, FieldCone) else None

    @property
    def half_side_m(self) -> float:
        """Half the side of the paper with its margin."""
        return (_MIDDLE + MARGIN_MODULES) * self.module_m

    def _turn(self) -> ArrayF:
        """(2, 2) from the print to right and down on the surface."""
        cos, sin = np.cos(self.turn_rad), np.sin(self.turn_rad)
        return np.array([[-cos if self.mirrored else cos, -sin], [-sin if self.mirrored else sin, cos]])

    def to_wcs(self, modules: ArrayLike) -> ArrayF:
        """Points (n, 3) of module coordinates (n, 2)."""
        flat = (np.asarray(modules, dtype=np.float64) - _MIDDLE) * self.module_m
        return self.surface.roll(flat @ self._turn().T, self.place)

    def to_modules(self, points_wcs_m: ArrayLike) -> ArrayF:
        """Module coordinates (n, 2) of points (n, 3) on the surface."""
        flat = self.surface.unroll(np.asarray(points_wcs_m, dtype=np.float64), self.place)
        return np.asarray(flat @ self._turn() / self.module_m + _MIDDLE)

    def saddles_wcs_m(self) -> ArrayF:
        """(4, 3) the four saddles."""
        return self.to_wcs(SADDLES_MODULES)

    def centre_wcs_m(self) -> ArrayF:
        """(3,) mean of the saddles: what RTK measured of a target."""
        return np.asarray(self.saddles_wcs_m().mean(axis=0))

    def normal_wcs(self) -> ArrayF:
        """(3,) in the middle, toward whoever looks at the print."""
        middle, right, down = self.surface.roll(np.array([[0, 0], [1e-6, 0], [0, 1e-6]]), self.place)
        across = -np.cross(right - middle, down - middle)
        return np.asarray(across / np.linalg.norm(across))


def covers(modules: ArrayF) -> ArrayF:
    """Whether module coordinates (n, 2) lie on the paper, its margin included."""
    low, high = -MARGIN_MODULES, SHEET_MODULES + MARGIN_MODULES
    return np.asarray(np.all((modules >= low) & (modules <= high), axis=1))
