"""The light of the laser that reaches given points, to check the points of the sheet."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import ArrayB, ArrayF
from thalweg.lightsheet.optics import LightSheet, Sensor, Window, directions_to_points, refract_to_water


@dataclass(frozen=True, slots=True, kw_only=True)
class BeamsAtPoints:
    """The sub-beams that would reach given points of the water.

    ``fan_angle_rad`` (n,) and ``v`` (n,) direction cosine of the light that reaches each point;
    ``distance_mm`` (n,) from the sheet along its normal, positive on the side of its larger v; ``inside``
    (n,) whether the fan is as wide. NaN and false for points that no light from the laser can reach.
    """

    fan_angle_rad: ArrayF
    v: ArrayF
    distance_mm: ArrayF
    inside: ArrayB


def sheet_normals(
    sheet: LightSheet, window: Window, fan_angles_rad: ArrayF, depths_mm: ArrayF
) -> tuple[ArrayF, ArrayF]:
    """Points (n, 3) of the sheet and its unit normals (n, 3) there, lcs, to the side of larger v."""
    step = 1e-6  # rad: the difference quotient of a smooth curve is good to some 1e-9 of its length
    beams = [sheet.beams(fan_angles_rad + k * step) for k in (0.0, 1.0, -1.0)]
    rays = [refract_to_water(sheet.origin_lcs_mm, b, window) for b in beams]
    at, ahead, back = (r.at_depth(depths_mm) for r in rays)
    normal = np.cross(ahead - back, rays[0].directions())
    with np.errstate(invalid="ignore"):
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return at, normal


def beams_at_points(sensor: Sensor, xyz_lcs_mm: ArrayLike) -> BeamsAtPoints:
    """Which light of the laser reaches points (n, 3) of the water, and how far these lie from the sheet."""
    sheet, window = sensor.sheet, sensor.window
    points = np.atleast_2d(np.asarray(xyz_lcs_mm, dtype=np.float64))
    local = directions_to_points(sheet.origin_lcs_mm, points, window) @ sheet.R_lcs_las
    with np.errstate(invalid="ignore"):
        a = np.arcsin(local[:, 0])
        behind = ~(local[:, 2] < 0.0) | ~(np.sin(a) ** 2 + sheet.v**2 < 1.0)
    a = np.where(behind, np.nan, a)
    v = np.where(behind, np.nan, local[:, 1])
    D = window.depth_mm(points)
    foot, normal = sheet_normals(sheet, window, a, D)
    distance = np.einsum("ni,ni->n", points - foot, normal)
    with np.errstate(invalid="ignore"):
        inside = np.abs(a) <= sheet.half_angle_rad
    return BeamsAtPoints(fan_angle_rad=a, v=v, distance_mm=distance, inside=inside)
