"""Surfaces in front of the sensor: triangle meshes with paint, and where they stand.

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

from thalweg.core.errors import GeometryError
from thalweg.core.frames import rotation_opk
from thalweg.core.geometry.raycast import RayCaster
from thalweg.core.types import ArrayB, ArrayF, ArrayI, ArrayU8

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


def at_depth(
    surface: Surface,
    window_mm: float,
    depth_mm: float,
    *,
    xy_mm: tuple[float, float] = (0.0, 0.0),
    **turn: float,
) -> Posed:
    """A surface whose origin lies at a depth below the outer face of an untilted window.

    Parameters
    ----------
    surface : with Z up in its own frame.
    window_mm : thickness of the window.
    depth_mm : of the object's origin.
    xy_mm : its place along the window.
    **turn : ``omega_deg``, ``phi_deg``, ``kappa_deg`` of ``R_lcs_obj = R_x R_y R_z``.
    """
    angles = [np.deg2rad(turn.pop(f"{name}_deg", 0.0)) for name in ("omega", "phi", "kappa")]
    if turn:
        raise GeometryError(f"unknown turns {sorted(turn)}", expected="omega_deg, phi_deg, kappa_deg")
    return Posed(
        surface=surface,
        R_lcs_obj=rotation_opk(*angles),
        shift_lcs_mm=np.array([xy_mm[0], xy_mm[1], -window_mm - depth_mm]),
    )
