"""The own boat as a laser sees it: a HyDrone catamaran of 1.17 m by 0.74 m (T 2.1), as a small mesh.

Two floats with pointed ends, a deck plate with the battery box, the mast of the GNSS antenna and the bracket
of the camera, all in the body frame of the INS (x forward, y right, z down). The boat does not move there, so
one mesh serves the whole voyage.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.geometry.raycast import RayCaster
from thalweg.core.types import ArrayB, ArrayF, ArrayI

LENGTH_M: Final = 1.17
WIDTH_M: Final = 0.74
REFLECTANCE: Final = 0.5
"""Painted plastic and aluminium at 905 nm."""
HULL_MATERIAL: Final = 255
"""Stands for the boat where the scene's materials have numbers."""
REACH_M: Final = 1.5
"""Beams are blocked by the boat within this way only; it is longer than the boat."""

_FLOAT_M: Final = 0.20
"""Width of a float."""
_DRAUGHT_M: Final = 0.10
_FREEBOARD_M: Final = 0.12
_POINTED_M: Final = 0.22
"""Length over which a float runs out to its end."""

_BOXES: Final = (
    # deck plate, battery box, mast and antenna, bracket and camera: low and high corners, z from the deck up
    ((-0.45, -0.20, -0.01), (0.42, 0.20, 0.01)),
    ((0.00, -0.12, -0.11), (0.30, 0.12, -0.01)),
    ((0.085, -0.065, -0.53), (0.115, -0.035, -0.11)),
    ((0.01, -0.14, -0.56), (0.19, 0.04, -0.53)),
    ((0.32, -0.22, -0.30), (0.36, -0.18, -0.01)),
    ((0.28, -0.27, -0.40), (0.40, -0.17, -0.30)),
)
_QUADS: Final = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
"""Faces of a box whose corner number counts x, y, z in bits of 4, 2, 1."""


def _box(low: ArrayF, high: ArrayF) -> tuple[ArrayF, ArrayI]:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
    triangles = [t for a, b, c, d in _QUADS for t in ((a, b, c), (a, c, d))]
    return low + corners * (high - low), np.array(triangles, dtype=np.int64)


def _float(y_m: float, top_m: float, bottom_m: float) -> tuple[ArrayF, ArrayI]:
    """A float along x: four rings of four corners, of which the outer ones are narrow and lie high."""
    half, x = _FLOAT_M / 2, LENGTH_M / 2
    rings = []
    for at, wide, deep in ((-x, 0.1, 0.4), (-x + _POINTED_M, 1, 1), (x - _POINTED_M, 1, 1), (x, 0.1, 0.4)):
        low = top_m + deep * (bottom_m - top_m)
        rings += [
            [at, y_m + side * wide * half, z] for side, z in ((-1, top_m), (1, top_m), (1, low), (-1, low))
        ]
    triangles = [[0, 1, 2], [0, 2, 3], [12, 14, 13], [12, 15, 14]]
    for ring in (0, 4, 8):
        for k in range(4):
            a, b = ring + k, ring + (k + 1) % 4
            triangles += [[a, a + 4, b + 4], [a, b + 4, b]]
    return np.array(rings), np.array(triangles, dtype=np.int64)


def _parts(height_m: float) -> list[tuple[ArrayF, ArrayI]]:
    deck = height_m - _FREEBOARD_M
    side = (WIDTH_M - _FLOAT_M) / 2
    parts = [_float(y, deck, height_m + _DRAUGHT_M) for y in (-side, side)]
    down = np.array([0.0, 0.0, deck])
    return parts + [_box(np.array(low) + down, np.array(high) + down) for low, high in _BOXES]


def hull_mesh(*, height_m: float = 0.2) -> tuple[ArrayF, ArrayI]:
    """The boat as a triangle mesh.

    Parameters
    ----------
    height_m : height of the ics origin above the water line, ``twin.boat.height_m``.

    Returns
    -------
    vertices_ics_m : (n, 3), x forward, y right, z down.
    triangles : (m, 3) corners; their order has no meaning.
    """
    parts = _parts(height_m)
    counts = np.cumsum([0] + [len(v) for v, _ in parts])
    return (
        np.concatenate([v for v, _ in parts]),
        np.concatenate([t + first for (_, t), first in zip(parts, counts[:-1], strict=True)]),
    )


@dataclass(frozen=True, slots=True)
class Hull:
    """The boat in the way of a scanner's beams.

    Parameters
    ----------
    caster : the mesh, in ics.
    table : (3600, k) whether a beam of tenths of a degree of azimuth and laser can meet the boat at all.
    """

    caster: RayCaster
    table: ArrayB

    @classmethod
    def seen_from(
        cls,
        R_ics_scs: ArrayF,
        lever_ics_scs_m: ArrayF,
        elevation_rad: ArrayF,
        *,
        height_m: float,
        margin_m: float,
    ) -> "Hull":
        """The boat around a scanner.

        Parameters
        ----------
        R_ics_scs, lever_ics_scs_m : mount of the scanner.
        elevation_rad : (k,) of its lasers.
        height_m : height of the ics origin above the water line.
        margin_m : beams run beside the nominal ones by less than this.

        Notes
        -----
        The table is exact in what it leaves out: a beam is tried if the middle one of its tenth of a degree
        passes a box about a part of the boat, grown by the margin and by what a twentieth of a degree makes
        within reach.
        """
        azimuth = np.deg2rad((np.arange(3600) + 0.5) / 10)[:, None]
        e = elevation_rad[None, :]
        beams = [np.cos(e) * np.sin(azimuth), np.cos(e) * np.cos(azimuth), np.sin(e) + 0 * azimuth]
        direction = np.stack(beams, axis=-1).reshape(-1, 3) @ R_ics_scs.T
        # No component may be exactly zero: the slabs divide by it.
        direction = np.where(np.abs(direction) < 1e-12, 1e-12, direction)
        grown = margin_m + np.deg2rad(0.05) * REACH_M
        table = np.zeros(len(direction), dtype=np.bool_)
        for corners, _ in _parts(height_m):
            first = (corners.min(axis=0) - grown - lever_ics_scs_m) / direction
            second = (corners.max(axis=0) + grown - lever_ics_scs_m) / direction
            enter = np.maximum(np.minimum(first, second).max(axis=1), 0.0)
            table |= (np.maximum(first, second).min(axis=1) >= enter) & (enter < REACH_M)
        mesh = hull_mesh(height_m=height_m)
        return cls(RayCaster(*mesh), table.reshape(3600, len(elevation_rad)))

    def may_hit(self, azimuth_deg: ArrayF) -> ArrayB:
        """Which shots (n, k) of azimuths (n, k), not reduced to one turn, can meet the boat."""
        tenth = np.floor(10.0 * azimuth_deg).astype(np.int64) % 3600
        return np.asarray(self.table[tenth, np.arange(self.table.shape[1])])

    def cast(self, origin_ics_m: ArrayF, direction_ics: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Way (n,) to the boat, infinite where a ray passes it, and cosine of incidence (n,)."""
        hits = self.caster.cast(origin_ics_m, direction_ics)
        cosine = np.abs(np.einsum("ni,ni->n", hits.normal, direction_ics))
        return np.where(hits.t_hit_m < REACH_M, hits.t_hit_m, np.inf), cosine
