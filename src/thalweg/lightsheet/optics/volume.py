"""The light sheet in the water, and what a sensor can measure of it: lines of equal depth in the picture, the
box in the water (P3 2.5, P4 5).

Refraction bends the plane fan: a sheet that is tilted about one axis becomes a curved surface, one that is
tilted about two an S-shaped one (P3 Fig. 1, P4 Fig. 1 and 2).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import ArrayF, ArrayU8, GeometryError
from thalweg.lightsheet.optics.intersection import fan_table, intersect, project
from thalweg.lightsheet.optics.refraction import Status, refract_to_water
from thalweg.lightsheet.optics.sensor import Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthLine:
    """The line of one depth where it is in the picture, along the fan.

    ``fan_angle_rad`` (n,), ``xy_px`` (n, 2), ``xyz_lcs_mm`` (n, 3); empty if no part of it is seen.
    """

    depth_mm: float
    fan_angle_rad: ArrayF
    xy_px: ArrayF
    xyz_lcs_mm: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class Volume:
    """What the picture covers of the sheet in the water.

    ``low_lcs_mm``, ``high_lcs_mm`` (3,) corners of the box; ``depth_mm`` least and largest depth; ``share``
    of the pixels that see the sheet in the water; ``shares`` by the name of the status; ``border_lcs_mm`` (n,
    3) points of the picture's border in order, without those that see no sheet.
    """

    low_lcs_mm: ArrayF
    high_lcs_mm: ArrayF
    depth_mm: tuple[float, float]
    shares: dict[str, float]
    border_lcs_mm: ArrayF

    @property
    def size_mm(self) -> ArrayF:
        """(3,) sides of the box along x, y, z."""
        return self.high_lcs_mm - self.low_lcs_mm

    @property
    def share(self) -> float:
        """Part of the pixels that see the sheet in the water."""
        return self.shares["OK"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureGrid:
    """Points of a grid of pixels: ``x_px`` (c,), ``y_px`` (r,), ``xyz_lcs_mm`` (r, c, 3), ``depth_mm`` (r,
    c), ``fan_angle_rad`` (r, c), ``status`` (r, c).
    """

    x_px: ArrayF
    y_px: ArrayF
    xyz_lcs_mm: ArrayF
    depth_mm: ArrayF
    fan_angle_rad: ArrayF
    status: ArrayU8


def sheet_in_water(sensor: Sensor, depths_mm: ArrayLike, fan_angles_rad: ArrayLike) -> ArrayF:
    """Points (k, m, 3) in lcs of m sub-beams at k depths; NaN for sub-beams that do not reach the water."""
    D = np.atleast_1d(np.asarray(depths_mm, dtype=np.float64))
    rays = refract_to_water(sensor.sheet.origin_lcs_mm, sensor.sheet.beams(fan_angles_rad), sensor.window)
    return np.stack([rays.at_depth(depth) for depth in D]) if len(D) else np.zeros((0, len(rays.A), 3))


def fan_angles(sensor: Sensor, n: int) -> ArrayF:
    """Fan angles (n,) spread over the part of the fan that reaches the water."""
    return fan_table(sensor.sheet, sensor.window, n).angle_rad


def depth_lines(sensor: Sensor, depths_mm: Sequence[float], n: int = 401) -> list[DepthLine]:
    """Lines of equal depth, from ``n`` sub-beams each.

    Raises
    ------
    GeometryError : a negative depth, which lies above the water.
    """
    if any(not depth >= 0.0 for depth in depths_mm):
        raise GeometryError(f"depths {list(depths_mm)}", expected="zero or more below the outer face")
    angles = fan_angles(sensor, n)
    lines = []
    for depth in depths_mm:
        xyz = sheet_in_water(sensor, [depth], angles)[0]
        xy = project(sensor, xyz)
        seen = sensor.camera.inside(xy)
        lines.append(
            DepthLine(depth_mm=float(depth), fan_angle_rad=angles[seen], xy_px=xy[seen], xyz_lcs_mm=xyz[seen])
        )
    return lines


def picture_grid(sensor: Sensor, step_px: int = 16) -> PictureGrid:
    """Points of every ``step_px``-th pixel centre, from border to border (P4 Fig. 11)."""
    width, height = sensor.camera.size_px
    x, y = _steps(width, step_px), _steps(height, step_px)
    found = intersect(sensor, np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    shape = (len(y), len(x))
    return PictureGrid(
        x_px=x,
        y_px=y,
        xyz_lcs_mm=found.xyz_lcs_mm.reshape(*shape, 3),
        depth_mm=found.depth_mm.reshape(shape),
        fan_angle_rad=found.fan_angle_rad.reshape(shape),
        status=found.status.reshape(shape),
    )


def measurement_volume(sensor: Sensor, step_px: int = 8) -> Volume:
    """The box of what the picture covers: its border, its inside, and the water's surface.

    Raises
    ------
    GeometryError : no pixel sees the sheet in the water.
    """
    width, height = sensor.camera.size_px
    grid = picture_grid(sensor, step_px)
    border = intersect(sensor, _border_px(width, height))
    surface = depth_lines(sensor, [0.0])[0].xyz_lcs_mm
    inside = grid.xyz_lcs_mm[grid.status == 0]
    points = np.concatenate([inside, border.xyz_lcs_mm[border.ok], surface])
    if not len(points):
        raise GeometryError(
            "no pixel sees the light sheet in the water",
            expected="a camera and a laser that look at the same part of the water",
            where=f"sensor {sensor.name!r}",
            cure="Check the angles of camera and laser, and which way the Z axis points",
        )
    depth = sensor.window.depth_mm(points)
    found, counts = np.unique(grid.status, return_counts=True)
    shares = {status.name: 0.0 for status in Status}
    shares |= {Status(s).name: float(c / grid.status.size) for s, c in zip(found, counts, strict=True)}
    return Volume(
        low_lcs_mm=points.min(axis=0),
        high_lcs_mm=points.max(axis=0),
        depth_mm=(float(depth.min()), float(depth.max())),
        shares=shares,
        border_lcs_mm=border.xyz_lcs_mm[border.ok],
    )


def _steps(side: int, step: int) -> ArrayF:
    """Pixel centres from the first to the last one."""
    return np.unique(np.concatenate([np.arange(0.5, side, step), [side - 0.5]]))


def _border_px(width: int, height: int) -> ArrayF:
    """Places all around the edge of the picture, in order."""
    x, y = np.arange(0.0, width + 0.5), np.arange(0.0, height + 0.5)
    sides = [
        np.stack([x, np.zeros_like(x)], axis=1),
        np.stack([np.full_like(y, width), y], axis=1),
        np.stack([x[::-1], np.full_like(x, height)], axis=1),
        np.stack([np.zeros_like(y), y[::-1]], axis=1),
    ]
    return np.concatenate(sides)
