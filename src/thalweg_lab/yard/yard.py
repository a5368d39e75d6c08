"""What stands in front of the camera, in the form that pictures are made from."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from thalweg.calibration.markers.sheets import MarkerLayout
from thalweg.core.types import ArrayF, ArrayI
from thalweg_lab.yard.scene import FieldScene
from thalweg_lab.yard.sheets import Sheet


@dataclass(frozen=True, slots=True, kw_only=True)
class Yard:
    """What is photographed: a mesh in wcs, the thing of each triangle, and the sheets.

    Parameters
    ----------
    vertices_wcs_m : (n, 3).
    triangles : (m, 3) corners.
    things : (m,) number of each triangle's thing.
    names : of the things.
    sheets : printed sheets on things.
    layout : dictionary of the prints.
    colours : (things, 3) colour that replaces that of a thing, NaN where it keeps its own; None: all do.
    """

    vertices_wcs_m: ArrayF
    triangles: ArrayI
    things: ArrayI
    names: tuple[str, ...]
    sheets: tuple[Sheet, ...] = ()
    layout: MarkerLayout = MarkerLayout()  # noqa: RUF009 - frozen
    colours: ArrayF | None = None

    @classmethod
    def of(cls, scene: FieldScene, sheets: Iterable[Sheet], layout: MarkerLayout | None = None) -> Self:
        """The yard of the twin's field."""
        return cls(
            vertices_wcs_m=scene.scene.vertices_wcs_m,
            triangles=scene.scene.triangles,
            things=scene.things,
            names=scene.names,
            sheets=tuple(sheets),
            layout=MarkerLayout() if layout is None else layout,
        )

    def with_thing(
        self, name: str, vertices_wcs_m: ArrayF, triangles: ArrayI, sheets: Iterable[Sheet] = ()
    ) -> Self:
        """The yard with one more thing in it, and sheets on it."""
        number = len(self.names)
        return replace(
            self,
            vertices_wcs_m=np.concatenate([self.vertices_wcs_m, vertices_wcs_m]),
            triangles=np.concatenate([self.triangles, triangles + len(self.vertices_wcs_m)]),
            things=np.concatenate([self.things, np.full(len(triangles), number, dtype=np.int64)]),
            names=(*self.names, name),
            sheets=(*self.sheets, *sheets),
        )
