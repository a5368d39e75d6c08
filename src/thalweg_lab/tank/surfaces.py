"""Surfaces in front of the sensor: triangle meshes with paint, the pieces they are put together from, their
places.

A mesh lives in the frame of its object, in millimetres; a pose ``x_lcs = R_lcs_obj x_obj + shift`` puts it
under the sensor. For a scan only the pose changes: rays are turned into the frame of the object, so that the
search tree of the mesh is built once. Open3D casts in float32; the point of a hit is then computed again in
float64 from the plane of its triangle.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from thalweg.core import ArrayB, ArrayF, ArrayI, ArrayU8, GeometryError, rotation_opk
from thalweg.core.geometry import RayCaster

GREEN: Final = 1
"""Channel of the laser in an albedo (red, green, blue)."""

_START_MM: Final = 0.02
"""A ray of sight starts so far above its point, or it would meet the point's own triangle: float32 steps are
2e-5 mm at 250 mm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Spots:
    """Round marks on a surface that do not overlap.

    ``centre_mm`` (s, 3) in the frame of the object, ``radius_mm`` (s,), ``albedo`` (3,) red, green, blue.
    """

    centre_mm: ArrayF
    radius_mm: ArrayF
    albedo: tuple[float, float, float] = (0.9, 0.9, 0.9)


@dataclass(frozen=True, slots=True, kw_only=True)
class Texture:
    """Variation of the albedo: a sum of plane waves through space, the same in each channel.

    ``waves`` (k, 3) wave vectors in radians per mm, ``phases`` (k,), ``strength`` standard deviation as a
    share.
    """

    waves: ArrayF
    phases: ArrayF
    strength: float

    @classmethod
    def draw(cls, rng: np.random.Generator, *, strength: float, lengths_mm: tuple[float, float]) -> "Texture":
        """Eight waves of random directions with lengths between two limits."""
        k = 8
        direction = rng.standard_normal((k, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        lengths = np.exp(rng.uniform(np.log(lengths_mm[0]), np.log(lengths_mm[1]), k))
        return cls(
            waves=direction * (2 * np.pi / lengths)[:, None],
            phases=rng.uniform(0, 2 * np.pi, k),
            strength=strength,
        )

    def factor(self, points_mm: ArrayF) -> ArrayF:
        """Factor (n,) of the albedo at points (n, 3), never below a tenth."""
        total = np.cos(points_mm @ self.waves.T + self.phases).sum(axis=1)
        return np.maximum(1.0 + self.strength * total / np.sqrt(len(self.phases) / 2), 0.1)


@dataclass(frozen=True, kw_only=True)
class Surface:
    """A painted triangle mesh.

    Parameters
    ----------
    vertices_mm : (n, 3) in the frame of the object.
    faces : (m, 3) corners.
    material : (m,) row of the palette.
    palette : (k, 3) albedo of each material, red, green, blue.
    spots, texture : see `Spots`, `Texture`.
    name : for files and messages.
    """

    vertices_mm: ArrayF
    faces: ArrayI
    material: ArrayU8
    palette: ArrayF
    spots: Spots | None = None
    texture: Texture | None = None
    name: str = "surface"

    def __post_init__(self) -> None:
        """Refuse paint that does not fit the mesh.

        Raises
        ------
        GeometryError : another number of materials than faces, or a material outside the palette.
        """
        if self.material.shape != (len(self.faces),) or int(self.material.max(initial=0)) >= len(
            self.palette
        ):
            raise GeometryError(
                f"{self.material.shape} materials up to {int(self.material.max(initial=0))} for "
                f"{len(self.faces)} faces and {len(self.palette)} colours",
                expected="one material for each face, and a colour for each material",
                where=f"surface {self.name!r}",
            )

    @cached_property
    def caster(self) -> RayCaster:
        """Search tree of the mesh; its unit is the millimetre here."""
        return RayCaster(self.vertices_mm, self.faces)

    @cached_property
    def normals(self) -> ArrayF:
        """(m, 3) unit normals by the order of the corners."""
        a, b, c = (self.vertices_mm[self.faces[:, k]] for k in range(3))
        n = np.cross(b - a, c - a)
        return np.asarray(n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-30))

    def albedo(self, points_mm: ArrayF, faces: ArrayI) -> ArrayF:
        """Albedo (n, 3) at points (n, 3) of faces (n,)."""
        out = self.palette[self.material[faces]]
        if self.texture is not None:
            out = out * self.texture.factor(points_mm)[:, None]
        if self.spots is not None and len(self.spots.radius_mm):
            reach = float(self.spots.radius_mm.max())
            found = cKDTree(self.spots.centre_mm).query(points_mm, distance_upper_bound=reach)
            away, number = np.asarray(found[0]), np.asarray(found[1])
            near = np.isfinite(away)
            near[near] = away[near] < self.spots.radius_mm[number[near]]
            out[near] = self.spots.albedo
        return np.asarray(np.minimum(out, 1.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Hits:
    """Where rays meet a surface; rays that meet nothing have ``met`` false and NaN.

    ``xyz_lcs_mm`` (n, 3), ``normal_lcs`` (n, 3) turned against the ray, ``way_mm`` (n,), ``albedo`` (n, 3).
    """

    met: ArrayB
    xyz_lcs_mm: ArrayF
    normal_lcs: ArrayF
    way_mm: ArrayF
    albedo: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class Posed:
    """A surface in its place: ``x_lcs = R_lcs_obj x_obj + shift_lcs_mm``."""

    surface: Surface
    R_lcs_obj: ArrayF = field(default_factory=lambda: np.eye(3))
    shift_lcs_mm: ArrayF = field(default_factory=lambda: np.zeros(3))

    def to_lcs(self, points_obj_mm: ArrayF) -> ArrayF:
        """Points (n, 3) of the object in lcs."""
        return np.asarray(points_obj_mm @ self.R_lcs_obj.T + self.shift_lcs_mm)

    def to_object(self, points_lcs_mm: ArrayF) -> ArrayF:
        """Points (n, 3) of lcs in the frame of the object."""
        return np.asarray((points_lcs_mm - self.shift_lcs_mm) @ self.R_lcs_obj)

    def first_hits(self, origins_lcs_mm: ArrayF, directions_lcs: ArrayF) -> Hits:
        """First hits of rays (n, 3) with unit directions; rays with NaN meet nothing."""
        surface = self.surface
        origins, directions = self.to_object(origins_lcs_mm), directions_lcs @ self.R_lcs_obj
        face = surface.caster.cast(origins, directions).primitive
        met = face >= 0
        face = np.where(met, face, 0)
        normal = surface.normals[face]
        along = np.einsum("ni,ni->n", normal, directions)
        corner = surface.vertices_mm[surface.faces[face, 0]]
        with np.errstate(divide="ignore", invalid="ignore"):
            way = np.einsum("ni,ni->n", normal, corner - origins) / along
        met &= np.isfinite(way)
        way = np.where(met, way, np.nan)
        points = origins + directions * way[:, None]
        albedo = np.zeros((len(points), 3))
        albedo[met] = surface.albedo(points[met], face[met])
        normal = np.where(along[:, None] > 0, -normal, normal) @ self.R_lcs_obj.T
        return Hits(met=met, xyz_lcs_mm=self.to_lcs(points), normal_lcs=normal, way_mm=way, albedo=albedo)

    def blocked(self, points_lcs_mm: ArrayF, up_lcs: ArrayF, way_mm: ArrayF) -> ArrayB:
        """Whether something stands in the way (n,) from points (n, 3) along unit directions (n, 3)."""
        start = self.to_object(points_lcs_mm + _START_MM * up_lcs)
        hits = self.surface.caster.cast(start, up_lcs @ self.R_lcs_obj)
        return np.asarray(hits.t_hit_m < way_mm)


@dataclass(slots=True)
class Pieces:
    """Collects pieces of one surface; a material is a row of the palette."""

    vertices: list[ArrayF] = field(default_factory=list)
    faces: list[ArrayI] = field(default_factory=list)
    material: list[ArrayI] = field(default_factory=list)
    count: int = 0

    def add(self, piece: tuple[ArrayF, ArrayI], material: int) -> None:
        """Add vertices (n, 3) and faces (m, 3)."""
        vertices, faces = piece
        self.vertices.append(vertices)
        self.faces.append(faces + self.count)
        self.material.append(np.full(len(faces), material))
        self.count += len(vertices)

    def surface(
        self, palette: ArrayF, name: str, *, spots: Spots | None = None, texture: Texture | None = None
    ) -> Surface:
        """All pieces as one surface."""
        return Surface(
            vertices_mm=np.concatenate(self.vertices),
            faces=np.concatenate(self.faces).astype(np.int64),
            material=np.concatenate(self.material).astype(np.uint8),
            palette=palette,
            spots=spots,
            texture=texture,
            name=name,
        )


def at_depth(surface: Surface, window_mm: float, depth_mm: float, **turn: float) -> Posed:
    """A surface whose origin lies at a depth below the outer face of an untilted window.

    Parameters
    ----------
    surface : with Z up in its own frame.
    window_mm : thickness of the window.
    depth_mm : of the object's origin.
    **turn : ``omega_deg``, ``phi_deg``, ``kappa_deg`` of ``R_lcs_obj = R_x R_y R_z``.
    """
    angles = [np.deg2rad(turn.pop(f"{name}_deg", 0.0)) for name in ("omega", "phi", "kappa")]
    if turn:
        raise GeometryError(f"unknown turns {sorted(turn)}", expected="omega_deg, phi_deg, kappa_deg")
    return Posed(
        surface=surface,
        R_lcs_obj=rotation_opk(*angles),
        shift_lcs_mm=np.array([0.0, 0.0, -window_mm - depth_mm]),
    )


def sheet(points: ArrayF) -> tuple[ArrayF, ArrayI]:
    """A grid of points (rows, columns, 3) as triangles; facing up if columns run along x and rows along y."""
    rows, columns = points.shape[:2]
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b = number[:-1, :-1].ravel(), number[:-1, 1:].ravel()
    c, d = number[1:, 1:].ravel(), number[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return points.reshape(-1, 3).astype(np.float64), faces


def relief(x_mm: ArrayF, y_mm: ArrayF, z_mm: ArrayF) -> tuple[ArrayF, ArrayI]:
    """Heights (len(y), len(x)) over a rectangular grid."""
    X, Y = np.meshgrid(x_mm, y_mm)
    return sheet(np.stack([X, Y, z_mm], axis=2))


def rectangle(x_mm: tuple[float, float], y_mm: tuple[float, float], z_mm: float) -> tuple[ArrayF, ArrayI]:
    """A level rectangle."""
    return relief(np.array(x_mm), np.array(y_mm), np.full((2, 2), z_mm))


def box(low_mm: ArrayF, high_mm: ArrayF) -> tuple[ArrayF, ArrayI]:
    """A closed box between two corners (3,)."""
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    vertices = np.where(corners == 1, high_mm, low_mm).astype(np.float64)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return vertices, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def rod(start_mm: ArrayF, end_mm: ArrayF, radius_mm: float) -> tuple[ArrayF, ArrayI]:
    """A closed cylinder between two points (3,)."""
    axis = (end_mm - start_mm) / np.linalg.norm(end_mm - start_mm)
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    u = np.cross(axis, other)
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    sides = 24
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = radius_mm * (np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v)
    vertices = np.concatenate([start_mm + ring, end_mm + ring, [start_mm, end_mm]])
    i, j = np.arange(sides), (np.arange(sides) + 1) % sides
    faces = np.concatenate(
        [
            np.stack([i, j, j + sides], axis=1),
            np.stack([i, j + sides, i + sides], axis=1),
            np.stack([np.full(sides, 2 * sides), j, i], axis=1),
            np.stack([np.full(sides, 2 * sides + 1), i + sides, j + sides], axis=1),
        ]
    )
    return vertices, faces


def pebble(centre_mm: ArrayF, radii_mm: ArrayF, rng: np.random.Generator) -> tuple[ArrayF, ArrayI]:
    """A rounded stone: an ellipsoid with radii (3,), turned about the vertical, with smooth bumps."""
    n = 28
    polar = np.linspace(1e-3, np.pi - 1e-3, n)
    around = np.linspace(0.0, 2 * np.pi, 2 * n + 1)
    T, P = np.meshgrid(polar, around, indexing="ij")
    unit = np.stack([np.sin(T) * np.cos(P), np.sin(T) * np.sin(P), np.cos(T)], axis=2)
    waves, phases = rng.standard_normal((5, 3)) * 2.5, rng.uniform(0, 2 * np.pi, 5)
    size = 1.0 + 0.06 * np.cos(unit @ waves.T + phases).sum(axis=2)
    turn = rng.uniform(0, 2 * np.pi)
    c, s = np.cos(turn), np.sin(turn)
    local = unit * size[:, :, None] * radii_mm
    turned = local @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    return sheet(turned + centre_mm)


def noise_relief(
    x_mm: ArrayF,
    y_mm: ArrayF,
    rng: np.random.Generator,
    *,
    amplitude_mm: float,
    lengths_mm: tuple[float, float],
) -> ArrayF:
    """Heights (len(y), len(x)) of a rough surface: 48 waves, standard deviation ``amplitude_mm``."""
    k = 48
    angle, phase = rng.uniform(0, np.pi, k), rng.uniform(0, 2 * np.pi, k)
    wave = 2 * np.pi / np.exp(rng.uniform(np.log(lengths_mm[0]), np.log(lengths_mm[1]), k))
    along_x = np.outer(wave * np.cos(angle), x_mm) + phase[:, None]
    along_y = np.outer(wave * np.sin(angle), y_mm)
    # cos(a + b) as two products of matrices
    total = np.cos(along_y).T @ np.cos(along_x) - np.sin(along_y).T @ np.sin(along_x)
    return np.asarray(amplitude_mm * total / np.sqrt(k / 2))
