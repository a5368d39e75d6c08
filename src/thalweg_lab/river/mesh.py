"""Meshes of the scene: pieces, simple bodies, the own boat's hull, materials."""

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final

import numpy as np
from scipy.spatial import ConvexHull

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayF32, ArrayI, ArrayU8, njit
from thalweg.core.geometry import RayCaster

_BOX = np.array([[x, y, z] for z in (0, 1) for y in (-0.5, 0.5) for x in (-0.5, 0.5)], dtype=np.float64)
BOX_FACES = np.array(
    [[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4],
     [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5]]
)  # fmt: skip
"""Faces of a box from `boxes`, outward."""

LENGTH_M: Final = 1.17
WIDTH_M: Final = 0.74
HULL_REFLECTANCE: Final = 0.5
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


# ---------------------------------------------------------------- pieces and simple bodies


@dataclass(slots=True)
class MeshParts:
    """Collects pieces of a mesh."""

    vertices: list[ArrayF] = field(default_factory=list)
    triangles: list[ArrayI] = field(default_factory=list)
    material: list[ArrayU8] = field(default_factory=list)
    variation: list[ArrayF32] = field(default_factory=list)
    count: int = 0

    def add(
        self,
        vertices: AnyArray,
        triangles: AnyArray,
        material: AnyArray | Material,
        variation: AnyArray | float = 0.5,
    ) -> None:
        """Add a piece.

        Parameters
        ----------
        vertices : (n, 3) in wcs, metres; kept to the step of float32.
        triangles : (m, 3) corners, counter-clockwise seen from outside or above.
        material : one, or (m,).
        variation : one number from 0 to 1, or (m,): what tells like things apart.
        """
        m = len(triangles)
        self.vertices.append(np.asarray(vertices, dtype=np.float32).astype(np.float64))
        self.triangles.append(np.asarray(triangles, dtype=np.int64) + self.count)
        self.material.append(np.broadcast_to(np.asarray(material).astype(np.uint8), (m,)))
        self.variation.append(np.broadcast_to(np.asarray(variation, dtype=np.float32), (m,)))
        self.count += len(vertices)

    def add_copies(
        self, faces: ArrayI, copies: ArrayF, material: AnyArray | Material, variation: AnyArray | float = 0.5
    ) -> None:
        """Add many bodies of the same faces.

        Parameters
        ----------
        faces : (f, 3) corners of one body.
        copies : (n, k, 3) vertices of each body in wcs.
        material : one, or (f,) of the faces.
        variation : one, or (n,) of the bodies.
        """
        n, k = copies.shape[:2]
        if n == 0:
            return
        triangles = (faces[None] + (np.arange(n) * k)[:, None, None]).reshape(-1, 3)
        if np.ndim(material) == 1:
            material = np.tile(np.asarray(material), n)
        if np.ndim(variation) == 1:
            variation = np.repeat(np.asarray(variation), len(faces))
        self.add(copies.reshape(-1, 3), triangles, material, variation)

    def joined(self) -> tuple[ArrayF, ArrayI, ArrayU8, ArrayF32]:
        """Vertices, triangles, materials and variations of all pieces."""
        return (
            np.concatenate(self.vertices),
            np.concatenate(self.triangles),
            np.concatenate(self.material),
            np.concatenate(self.variation),
        )


def ball(corners: int) -> tuple[ArrayF, ArrayI]:
    """Points spread over the unit sphere (Fibonacci lattice) and their hull, faces outward."""
    i = np.arange(corners) + 0.5
    z = 1.0 - 2.0 * i / corners
    turn = np.pi * (1.0 + 5.0**0.5) * i
    p = np.stack([np.cos(turn) * np.sqrt(1 - z * z), np.sin(turn) * np.sqrt(1 - z * z), z], axis=1)
    faces = ConvexHull(p).simplices.astype(np.int64)
    normal = np.cross(p[faces[:, 1]] - p[faces[:, 0]], p[faces[:, 2]] - p[faces[:, 0]])
    inward = np.sum(normal * p[faces[:, 0]], axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return p, faces


def tube_faces(sides: int, rings: int) -> ArrayI:
    """Faces of a tube over ``rings`` rings of ``sides`` vertices, outward, closed at its end by one tip.

    The vertices are the rings in order, each counter-clockwise seen from the end, then the tip.
    """
    i = np.arange(sides)
    k = (i + 1) % sides
    faces = []
    for ring in range(rings - 1):
        a, b = ring * sides, (ring + 1) * sides
        faces += [np.stack([a + i, a + k, b + k], axis=1), np.stack([a + i, b + k, b + i], axis=1)]
    last = (rings - 1) * sides
    faces.append(np.stack([last + i, last + k, np.full(sides, rings * sides)], axis=1))
    return np.concatenate(faces).astype(np.int64)


def tubes(axis: ArrayF, radius: ArrayF, sides: int) -> ArrayF:
    """Vertices of tubes along polylines, for `tube_faces`.

    Parameters
    ----------
    axis : (n, r, 3) points along each axis.
    radius : (n, r) at these points.
    sides : corners of the cross-section.

    Returns
    -------
    vertices : (n, r * sides + 1, 3).
    """
    along = np.gradient(axis, axis=1)
    along /= np.maximum(np.linalg.norm(along, axis=2, keepdims=True), 1e-12)
    # A side vector that is not parallel to the axis: upright axes take east, the others up.
    upright = np.abs(along[..., 2:]) > 0.9
    aside = np.where(upright, np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    u = np.cross(aside, along)
    u /= np.linalg.norm(u, axis=2, keepdims=True)
    v = np.cross(along, u)
    turn = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    ring = np.cos(turn)[:, None] * u[:, :, None] + np.sin(turn)[:, None] * v[:, :, None]
    points = axis[:, :, None] + radius[:, :, None, None] * ring
    return np.concatenate([points.reshape(len(axis), axis.shape[1] * sides, 3), axis[:, -1:]], axis=1)


def boxes(foot: ArrayF, size: ArrayF, turn_rad: ArrayF) -> ArrayF:
    """Vertices (n, 8, 3) of upright boxes.

    Parameters
    ----------
    foot : (n, 3) middle of the lower face, wcs.
    size : (n, 3) length, width, height, metres.
    turn_rad : (n,) direction of the length, counter-clockwise from east.
    """
    local = _BOX[None] * np.asarray(size)[:, None, :]
    return turned(local, np.asarray(turn_rad)) + np.asarray(foot)[:, None, :]


def turned(local: ArrayF, turn_rad: ArrayF) -> ArrayF:
    """Points (n, k, 3) turned about the vertical by (n,) angles, counter-clockwise."""
    cos, sin = np.cos(turn_rad)[:, None], np.sin(turn_rad)[:, None]
    x, y = local[..., 0], local[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y, np.broadcast_to(local[..., 2], x.shape)], axis=-1)


# ---------------------------------------------------------------- hull of the own boat
#
# Two floats with pointed ends, a deck plate with the battery box, the mast of the GNSS antenna and the
# bracket of the camera, all in the body frame of the INS (x forward, y right, z down). The boat does not
# move there, so one mesh serves the whole voyage.


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
        parts = [corners for corners, _ in _parts(height_m)]
        low = np.stack([c.min(axis=0) - grown - lever_ics_scs_m for c in parts])
        high = np.stack([c.max(axis=0) + grown - lever_ics_scs_m for c in parts])
        table = _pass_boxes(direction, low, high, REACH_M)
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


@njit(cache=True, error_model="numpy")
def _pass_boxes(direction: ArrayF, low: ArrayF, high: ArrayF, reach: float) -> ArrayB:
    """Whether rays (n, 3) from the origin pass one of the boxes (k, 3) within reach."""
    found = np.zeros(len(direction), dtype=np.bool_)
    for i in range(len(direction)):
        for k in range(len(low)):
            enter, leave = 0.0, np.inf
            for a in range(3):
                first, second = low[k, a] / direction[i, a], high[k, a] / direction[i, a]
                enter, leave = max(enter, min(first, second)), min(leave, max(first, second))
            if leave >= enter and enter < reach:
                found[i] = True
                break
    return found


# ---------------------------------------------------------------- materials: reflection of lasers and
# daylight
#
# All numbers are round values. They follow the usual spectral libraries: USGS Spectral Library Version 7
# (Kokaly et al. 2017) for leaves, grass, soil, gravel and bark, the ECOSTRESS library (Meerdink et al.
# 2019) for rock, concrete, roof tiles and plaster. Water absorbs near-infrared light (Hale and Querry
# 1973): at both wavelengths next to nothing comes back from below the surface. Green leaves reflect about
# half at 905 nm; at 1550 nm their water absorbs.


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
