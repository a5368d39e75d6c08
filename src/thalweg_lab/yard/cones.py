"""Cones of the calibration field, and planes; both are surfaces that printed sheets are glued on.

A cone unrolls onto a plane without stretching: a point at the slant distance s from the apex and the azimuth
psi about the axis comes to lie at the distance s and the angle ``psi sin(half angle)``. A sheet of paper
therefore keeps all its lengths when it is glued on a cone.
"""

from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core.types import ArrayB, ArrayF, ArrayI

SIDES: Final = 480
"""Of a cone's mesh: at the base, 0.33 m from the axis, chords then lie less than 0.008 mm inside."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldCone:
    """A cone as it really stands.

    Parameters
    ----------
    name : C1 to C8.
    apex_wcs_m : (3,) where its surface would come to a point.
    axis_wcs : (3,) unit vector from the apex into the cone.
    zero_wcs : (3,) unit vector across the axis at which the azimuth is zero.
    half_angle_rad : between axis and surface.
    start_m, length_m : blunt tip and base, from the apex along the axis.
    markers : ids of the sheets on it by the description of the field.
    """

    name: str
    apex_wcs_m: ArrayF
    axis_wcs: ArrayF
    zero_wcs: ArrayF
    half_angle_rad: float
    start_m: float
    length_m: float
    markers: tuple[int, ...] = ()

    @property
    def base_wcs_m(self) -> ArrayF:
        """(3,) middle of the base."""
        return np.asarray(self.apex_wcs_m + self.length_m * self.axis_wcs)

    @property
    def middle_wcs_m(self) -> ArrayF:
        """(3,) middle of the axis between blunt tip and base."""
        return np.asarray(self.apex_wcs_m + (self.start_m + self.length_m) / 2 * self.axis_wcs)

    @property
    def sphere(self) -> tuple[ArrayF, float]:
        """Centre (3,) in wcs and radius of the smallest sphere about it, metres."""
        near, far = self.start_m / np.cos(self.half_angle_rad), self.length_m / np.cos(self.half_angle_rad)
        along = (far**2 - near**2) / (2 * (self.length_m - self.start_m))
        wide = self.length_m * np.tan(self.half_angle_rad)
        return self.apex_wcs_m + along * self.axis_wcs, float(np.hypot(self.length_m - along, wide))

    @property
    def R_cocs_wcs(self) -> ArrayF:
        """(3, 3) rotation into the frame of the cone: z along the axis, x at the azimuth zero."""
        return np.stack([self.zero_wcs, np.cross(self.axis_wcs, self.zero_wcs), self.axis_wcs])

    def to_cocs(self, points_wcs_m: ArrayLike) -> ArrayF:
        """Points (n, 3) in the frame of the cone."""
        return np.asarray((np.asarray(points_wcs_m, dtype=np.float64) - self.apex_wcs_m) @ self.R_cocs_wcs.T)

    def distance_m(self, points_wcs_m: ArrayLike) -> ArrayF:
        """Distance (n,) of points from the endless surface, positive outside."""
        return self._off(self.to_cocs(points_wcs_m))

    def _off(self, points_cocs_m: ArrayF) -> ArrayF:
        across = np.hypot(points_cocs_m[:, 0], points_cocs_m[:, 1])
        along = points_cocs_m[:, 2]
        return np.asarray(across * np.cos(self.half_angle_rad) - along * np.sin(self.half_angle_rad))

    def holds(self, points_wcs_m: ArrayLike, tolerance_m: float) -> ArrayB:
        """Which points (n,) lie on the surface between tip and base, within a tolerance."""
        local = self.to_cocs(points_wcs_m)
        along, near = local[:, 2], np.abs(self._off(local)) <= tolerance_m
        return np.asarray(near & (along >= self.start_m) & (along <= self.length_m))

    def at(self, slant_m: ArrayLike, azimuth_rad: ArrayLike) -> ArrayF:
        """Points (n, 3) in wcs of the surface at slant distances and azimuths (n,)."""
        s, psi = np.asarray(slant_m, dtype=np.float64), np.asarray(azimuth_rad, dtype=np.float64)
        across = s * np.sin(self.half_angle_rad)
        local = np.stack(
            [across * np.cos(psi), across * np.sin(psi), s * np.cos(self.half_angle_rad)], axis=-1
        )
        return np.asarray(self.apex_wcs_m + local @ self.R_cocs_wcs)

    def roll(self, flat_m: ArrayF, place: tuple[float, float]) -> ArrayF:
        """Points of a sheet on the surface.

        Parameters
        ----------
        flat_m : (n, 2) to the right and down on the sheet, from its middle. Down is away from the apex.
        place : slant distance and azimuth of the middle.

        Returns
        -------
        (n, 3) in wcs.
        """
        slant, azimuth = place
        right, down = flat_m[:, 0], flat_m[:, 1] + slant
        # Seen from outside with the apex up, the azimuth grows to the left.
        turn = np.arctan2(right, down) / np.sin(self.half_angle_rad)
        return self.at(np.hypot(right, down), azimuth - turn)

    def unroll(self, points_wcs_m: ArrayF, place: tuple[float, float]) -> ArrayF:
        """Inverse of `roll`: (n, 2) right and down; points off the surface are projected onto it."""
        p = self.to_cocs(points_wcs_m)
        sine, cosine = np.sin(self.half_angle_rad), np.cos(self.half_angle_rad)
        slant = p[:, 2] * cosine + np.hypot(p[:, 0], p[:, 1]) * sine
        turn = place[1] - np.arctan2(p[:, 1], p[:, 0])
        turn = (np.mod(turn + np.pi, 2 * np.pi) - np.pi) * sine
        return np.stack([slant * np.sin(turn), slant * np.cos(turn) - place[0]], axis=1)

    def moved(self, R: ArrayF, about_wcs_m: ArrayF) -> Self:
        """The cone turned about a point."""
        return replace(
            self,
            apex_wcs_m=about_wcs_m + R @ (self.apex_wcs_m - about_wcs_m),
            axis_wcs=R @ self.axis_wcs,
            zero_wcs=R @ self.zero_wcs,
        )

    def mesh(self) -> tuple[ArrayF, ArrayI]:
        """Vertices (2 SIDES + 2, 3) in wcs and triangles (4 SIDES, 3), outward, closed at tip and base."""
        turn = 2 * np.pi * np.arange(SIDES) / SIDES
        slants = np.array([self.start_m, self.length_m]) / np.cos(self.half_angle_rad)
        rings = [self.at(np.full(SIDES, s), turn) for s in slants]
        ends = [self.apex_wcs_m + z * self.axis_wcs for z in (self.start_m, self.length_m)]
        i = np.arange(SIDES)
        k, tip, base = (i + 1) % SIDES, np.full(SIDES, 2 * SIDES), np.full(SIDES, 2 * SIDES + 1)
        faces = [(i, i + SIDES, k + SIDES), (i, k + SIDES, k), (tip, i, k), (base, k + SIDES, i + SIDES)]
        # The azimuth turns about the axis into the cone, so outside lies to the left of this order.
        triangles = np.concatenate([np.stack(f, axis=1) for f in faces])[:, ::-1]
        return np.concatenate([*rings, np.stack(ends)]), triangles.astype(np.int64)


@dataclass(frozen=True, slots=True, kw_only=True)
class Plane:
    """A plane with directions to the right and down on the print; right x down points into it."""

    origin_wcs_m: ArrayF
    right_wcs: ArrayF
    down_wcs: ArrayF

    @property
    def normal_wcs(self) -> ArrayF:
        """(3,) toward whoever looks at the print."""
        return np.asarray(-np.cross(self.right_wcs, self.down_wcs))

    def roll(self, flat_m: ArrayF, place: tuple[float, float]) -> ArrayF:
        """Points (n, 3) in wcs of a sheet: right and down (n, 2) from its middle at ``place``."""
        at = flat_m + np.asarray(place)
        return np.asarray(self.origin_wcs_m + at[:, :1] * self.right_wcs + at[:, 1:] * self.down_wcs)

    def unroll(self, points_wcs_m: ArrayF, place: tuple[float, float]) -> ArrayF:
        """Inverse of `roll`; points off the plane are projected onto it."""
        off = points_wcs_m - self.origin_wcs_m
        return np.stack([off @ self.right_wcs, off @ self.down_wcs], axis=1) - np.asarray(place)
