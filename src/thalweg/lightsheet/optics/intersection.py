"""Image rays and the refracted light sheet: millions of pixels to points (P3 2.2, P4 4.2).

Each image ray meets one sub-beam of the fan. `intersection_kernels` says how it is found; what has no point
gets a `Status` and no number. The halving of the papers is in `intersection_paper`, the slow reference with
many digits in `intersection_reference`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayB, ArrayF, ArrayI, ArrayU8
from thalweg.lightsheet.optics import intersection_kernels
from thalweg.lightsheet.optics.refracted_rays import Status
from thalweg.lightsheet.optics.sensor import LightSheet, Sensor, Window
from thalweg.lightsheet.optics.threads import threads_for

__all__ = [
    "GRAZING_SINE",
    "NODES",
    "FanTable",
    "SheetPoints",
    "Status",
    "fan_table",
    "intersect",
    "laser_window",
]

NODES: Final = 33
"""Sub-beams that bracket the roots: less than three degrees apart on a fan of 90 degrees."""

GRAZING_SINE: Final = 0.01
"""Sine of the least angle between ray and window, and between ray and sheet.

At 0.01 an error of a pixel, some 0.1 mm across the ray, would be 10 mm along it.
"""


_EACH: Final = 4096
"""Rays for a thread, 0.7 ms of work; fewer than two such shares run in one thread."""

MARGIN_RAD: Final = 1e-9
"""By which the fan is wider than stated, so that rounding loses no pixel of its very last sub-beam."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetPoints:
    """Points of the sheet on image rays; NaN wherever ``status`` (n,) is not `Status.OK`.

    ``xyz_lcs_mm`` (n, 3); ``depth_mm`` (n,) below the outer face; ``fan_angle_rad`` (n,) of the sub-beam.
    """

    xyz_lcs_mm: ArrayF
    depth_mm: ArrayF
    fan_angle_rad: ArrayF
    status: ArrayU8

    @property
    def ok(self) -> ArrayB:
        """(n,) true where there is a point."""
        return self.status == Status.OK

    def counts(self) -> dict[str, int]:
        """How many pixels have each status, for reports."""
        n: ArrayI = np.bincount(self.status, minlength=len(Status))
        return {status.name: int(n[status]) for status in Status}


@dataclass(frozen=True, slots=True, kw_only=True)
class FanTable:
    """Sub-beams spread over the part of a fan that reaches the water.

    ``u`` (m,) fan parameters (`intersection_kernels`), ``angle_rad`` (m,) fan angles, ``beams`` (m, 8) their
    A, B in the water and the derivatives by u, in the frame of the window.
    """

    u: ArrayF
    angle_rad: ArrayF
    beams: ArrayF


def intersect(sensor: Sensor, xy_px: ArrayLike) -> SheetPoints:
    """Points of the sheet on the rays of pixels.

    Parameters
    ----------
    sensor : any line, also a diffracted one.
    xy_px : (n, 2) pixels, the centre of the first one being (0.5, 0.5).

    Returns
    -------
    SheetPoints in the order of the pixels. Where a ray meets the sheet twice, the nearer place.

    Raises
    ------
    GeometryError : no (n, 2) pixels, or no sub-beam of the fan reaches the water.
    """
    xy = np.ascontiguousarray(np.atleast_2d(np.asarray(xy_px, dtype=np.float64)))
    if xy.ndim != 2 or xy.shape[1] != 2:
        raise GeometryError(f"pixels of the shape {xy.shape}", expected="(n, 2)")
    n = len(xy)
    table = fan_table(sensor.sheet, sensor.window, margin_rad=MARGIN_RAD)
    rows = np.empty((5, len(table.u)))
    rows[:4] = table.beams[:, :4].T
    rows[4] = rows[0] * rows[3] - rows[1] * rows[2]
    xyz, depth, fan, status = np.empty((n, 3)), np.empty(n), np.empty(n), np.empty(n, dtype=np.uint8)
    R = np.ascontiguousarray(sensor.window.R_lcs_window)
    with threads_for(n, each=_EACH):
        intersection_kernels.intersect(
            xy, sensor.camera.parameters, *camera_window(sensor), *laser_window(sensor.sheet, sensor.window),
            sensor.sheet.v, media(sensor.window), R, table.u, rows, GRAZING_SINE, xyz, depth, fan, status,
        )  # fmt: skip
    return SheetPoints(xyz_lcs_mm=xyz, depth_mm=depth, fan_angle_rad=fan, status=status)


def fan_table(sheet: LightSheet, window: Window, n: int = NODES, *, margin_rad: float = 0.0) -> FanTable:
    """Sub-beams at equal angles over the part of the fan that reaches the water, and a margin at its own
    ends.

    Raises
    ------
    GeometryError : there is no such part.
    """
    low, high = fan_limits(sheet, window)
    top = _top(sheet)
    low -= margin_rad * (low == -top)
    high += margin_rad * (high == top)
    w = np.sqrt(1.0 - sheet.v**2)
    u = np.tan(np.linspace(low, high, n))
    beams = np.empty((n, 8))
    intersection_kernels.sub_beams(u, *laser_window(sheet, window), sheet.v, media(window), beams)
    return FanTable(u=u, angle_rad=np.arctan2(w * u, np.sqrt(1.0 + (u * sheet.v) ** 2)), beams=beams)


def fan_limits(sheet: LightSheet, window: Window) -> tuple[float, float]:
    """Least and largest angle atan(u) about the laser's y axis whose sub-beams reach the water.

    Sub-beams that run along the window or away from it, or are reflected totally, are cut off. They lie at
    the ends of the fan; if they part it in two, the longer part counts.

    Raises
    ------
    GeometryError : no sub-beam reaches the water.
    """
    top = _top(sheet)
    L, _ = laser_window(sheet, window)
    least_n = min(window.n_glass, window.n_water)

    def wet(b: ArrayF) -> ArrayB:
        """Whether the beam at an angle ``b`` of the fan passes the window into the water."""
        w = np.sqrt(1.0 - sheet.v**2)
        d = np.stack([w * np.sin(b), np.full_like(b, sheet.v), -w * np.cos(b)], axis=-1) @ L.T
        sine = np.hypot(d[..., 0], d[..., 1])
        # a hair inside of the limits, so that the last sub-beam is still one
        return np.asarray((d[..., 2] < -GRAZING_SINE) & (window.n_air * sine < least_n * (1 - 1e-12)))

    grid = np.linspace(-top, top, 721)
    good = wet(grid)
    if good.all():
        return -top, top
    if not good.any():
        raise GeometryError(
            f"no sub-beam of the fan of the laser {sheet.name!r} reaches the water",
            expected="a laser that shines along its -z axis through the window",
            cure="Check omega, phi and kappa of the laser, and that they are in degrees in the file",
        )
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(np.int8)))
    starts, stops = edges[::2], edges[1::2] - 1
    k = int(np.argmax(stops - starts))
    first, last = int(starts[k]), int(stops[k])
    low = grid[first] if first == 0 else _edge(wet, grid[first], grid[first - 1])
    high = grid[last] if last == len(grid) - 1 else _edge(wet, grid[last], grid[last + 1])
    return float(low), float(high)


def _top(sheet: LightSheet) -> float:
    """The angle about the laser's y axis of the last sub-beam."""
    return float(np.arcsin(np.sin(sheet.half_angle_rad) / np.sqrt(1.0 - sheet.v**2)))


def _edge(wet: Callable[[ArrayF], ArrayB], inside: float, outside: float) -> float:
    """The last angle that is wet, by halving."""
    for _ in range(60):
        middle = 0.5 * (inside + outside)
        if wet(np.array([middle]))[0]:
            inside = middle
        else:
            outside = middle
    return inside


def media(window: Window) -> ArrayF:
    """(4,) refractive indices of air, glass, water and the thickness of the glass, for the kernels."""
    return np.array([window.n_air, window.n_glass, window.n_water, window.thickness_mm])


def camera_window(sensor: Sensor) -> tuple[ArrayF, ArrayF]:
    """Rotation (3, 3) from ccs to the frame of the window, and the camera's place (3,) in it."""
    R = sensor.window.R_lcs_window
    return np.ascontiguousarray(R.T @ sensor.R_lcs_ccs), np.ascontiguousarray(
        R.T @ sensor.camera_origin_lcs_mm
    )


def laser_window(sheet: LightSheet, window: Window) -> tuple[ArrayF, ArrayF]:
    """Rotation (3, 3) from the laser to the frame of the window, and the laser's place (3,) in it."""
    R = window.R_lcs_window
    return np.ascontiguousarray(R.T @ sheet.R_lcs_las), np.ascontiguousarray(R.T @ sheet.origin_lcs_mm)
