"""Surface through points by a Delaunay triangulation in the plane of the bank (2.5D)."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay, QhullError

from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayF, ArrayI
from thalweg.surface.bank_frame import BankFrame


@dataclass(frozen=True, slots=True, kw_only=True)
class Triangles:
    """Faces (m, 3) over given points, all with their front to `out`, and what was left out."""

    faces: ArrayI
    counts: dict[str, int]


def triangulate(points_m: ArrayF, frame: BankFrame, *, longest_edge_m: float) -> Triangles:
    """Triangles of points seen along `out` of the bank.

    Parameters
    ----------
    points_m : (n, 3) wcs.
    frame : of the bank.
    longest_edge_m : triangles with a longer edge (in space) are holes.

    Raises
    ------
    GeometryError : all points lie on a line when seen along `out`.
    """
    bank = frame.to_bank(points_m)
    try:
        # Qhull works on one scale: about the middle the digits are those of the bank, not of its place
        faces = np.asarray(Delaunay(bank[:, :2] - bank[:, :2].mean(axis=0)).simplices, dtype=np.int64)
    except QhullError as error:
        raise GeometryError(
            "the reference points lie on a line when seen from the front of the bank",
            expected="points of a surface",
            cure="Look at the reference file: a profile cannot be meshed",
        ) from error
    corners = bank[faces]
    area = _doubled_area(corners)
    edges = corners - np.roll(corners, -1, axis=1)
    too_long = (np.einsum("fkx,fkx->fk", edges, edges) > longest_edge_m**2).any(axis=1)
    flat = ~too_long & (np.abs(area) <= _smallest_area(bank))
    keep = ~(too_long | flat)
    faces = faces[keep]
    turned = area[keep] < 0
    faces[turned] = faces[turned][:, ::-1]
    return Triangles(
        faces=np.ascontiguousarray(faces),
        counts={"long_faces": int(too_long.sum()), "flat_faces": int(flat.sum())},
    )


def _doubled_area(corners: ArrayF) -> ArrayF:
    """Twice the signed area (m,) in the plane of the bank."""
    a, b = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _smallest_area(bank: ArrayF) -> float:
    """Below, the sign of an area is rounding: the digits of a coordinate times the width of the bank."""
    width = float(np.max(np.ptp(bank[:, :2], axis=0)))
    return 8 * np.finfo(np.float64).eps * width**2
