"""What a comparison covers: heights of a cloud over its reference, and the parts that nothing lies on."""

from typing import Final

import numpy as np

from thalweg.core.cells import CellGrid
from thalweg.core.geometry.mesh import TriangleMesh
from thalweg.core.types import ArrayF
from thalweg.surface.area import Area

PLAN_CELL_M: Final = 1.0
"""Heights are compared in cells of this width."""

SEEN_CELL_M: Final = 0.5
"""A reference without a compared point in a cell of this width is not seen."""

LEAST_PLAN_M2: Final = 1.0


class HeightMap:
    """Mean heights of a mesh in plan.

    Parameters
    ----------
    mesh : the reference.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        vertices = mesh.vertices_m
        self._grid = CellGrid.around(vertices[:, :2], PLAN_CELL_M)
        self._keys, number, count = np.unique(
            self._grid.keys(vertices[:, :2]), return_inverse=True, return_counts=True
        )
        self._height_m = np.bincount(number, weights=vertices[:, 2]) / count

    def above(self, points_m: ArrayF) -> ArrayF:
        """Heights of the points that have mesh above or below them, over the mean height of the mesh there.

        The others are left out.
        """
        points = points_m[self._grid.contains(points_m[:, :2])]
        key = self._grid.keys(points[:, :2])
        at = np.minimum(np.searchsorted(self._keys, key), len(self._keys) - 1)
        found = self._keys[at] == key
        return np.asarray(points[found, 2] - self._height_m[at[found]])


def coverage(places_m: ArrayF, mesh: TriangleMesh, area: Area) -> dict[str, float]:
    """How much of the area the reference covers, and how much of the reference the cloud.

    Parameters
    ----------
    places_m : (n, 3) places on the reference that points were compared with.
    mesh : the reference.
    area : the area of interest.

    Returns
    -------
    ``reference_area_m2`` of the triangles whose middle lies in the area; ``without_points``, the share of it
    in cubes of `SEEN_CELL_M` that hold none of the places. With a polygon also ``without_reference``, the
    share of the polygon in plan that has no triangle above or below it. A polygon that holds part of the
    river has no reference there.
    """
    middle = mesh.vertices_m[mesh.faces].mean(axis=1)
    inside = area.contains(middle)
    middle, size_m2 = middle[inside], mesh.areas_m2()[inside]
    out = {"reference_area_m2": float(size_m2.sum())}
    if len(middle):
        grid = CellGrid.around(middle, SEEN_CELL_M)
        near = places_m[grid.contains(places_m)]
        seen = np.isin(grid.keys(middle), grid.keys(near))
        out["without_points"] = float(size_m2[~seen].sum() / size_m2.sum()) if size_m2.any() else 1.0
    if area.polygon_en_m is not None and area.size_m2() > LEAST_PLAN_M2:
        plan_m2 = size_m2 * np.abs(mesh.face_normals()[inside, 2])
        out["without_reference"] = max(1.0 - float(plan_m2.sum()) / area.size_m2(), 0.0)
    return out
