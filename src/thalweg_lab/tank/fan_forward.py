"""The way of the light of many lines forwards: sub-beams of a laser to levels, and points to the image.

A sub-beam is followed layer by layer by the angle in each, Snell's law in its schoolbook form: in each layer
it runs aside by the thickness times the tangent of its angle, always in its own vertical plane::

    sin(w_2) = n_1 sin(w_1) / n_2,      r = h tan(w_air) + t tan(w_glass) + D tan(w_water)

Points are seen by the solution of `thalweg_lab.tank.forward`. The processing of lines
(`thalweg.lightsheet.multi_line`) has a closed form by the slowness along the faces for both, and no
function of refraction is common to the two sides.
"""

from dataclasses import dataclass

import numpy as np

from thalweg.core.types import ArrayB, ArrayF
from thalweg.lightsheet.optics.sensor import Sensor, Window
from thalweg_lab.tank.forward import see


@dataclass(frozen=True, slots=True, kw_only=True)
class SubBeams:
    """Rays in the water in the frame of the window: the place is ``start_mm + slope * depth``.

    ``start_mm`` (n, 2) on the outer face; ``slope`` (n, 2) mm for each mm of depth; NaN for rays that never
    get into the water.
    """

    start_mm: ArrayF
    slope: ArrayF

    def at_depth(self, depth_mm: ArrayF, window: Window) -> ArrayF:
        """Points (n, 3) in lcs at depths (n,) below the outer face."""
        xy = self.start_mm + self.slope * depth_mm[:, None]
        local = np.column_stack([xy, -depth_mm - window.thickness_mm])
        return np.asarray(local @ window.R_lcs_window.T)


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenPoints:
    """Points (n) in the image.

    ``xy_px`` (n, 2), NaN without an image; ``inside`` (n,) the picture; ``slope`` (n, 2) change of x and y of
    the camera's ray for each mm of depth, in the frame of the window.
    """

    xy_px: ArrayF
    inside: ArrayB
    slope: ArrayF


def sub_beams(origins_mm: ArrayF, directions: ArrayF, window: Window) -> SubBeams:
    """Rays behind the window from origins (n, 3) and unit directions (n, 3) in air, lcs."""
    R = window.R_lcs_window
    o, d = origins_mm @ R, directions @ R
    sine = np.hypot(d[:, 0], d[:, 1])
    azimuth = np.arctan2(d[:, 1], d[:, 0])
    with np.errstate(invalid="ignore"):
        in_air = np.where(d[:, 2] < 0, np.arctan2(sine, -d[:, 2]), np.nan)
        in_glass = np.arcsin(window.n_air * sine / window.n_glass)
        in_water = np.arcsin(window.n_glass * np.sin(in_glass) / window.n_water)
    reach = o[:, 2] * np.tan(in_air) + window.thickness_mm * np.tan(in_glass)
    aside = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    return SubBeams(
        start_mm=o[:, :2] + reach[:, None] * aside,
        slope=np.where(np.isnan(reach), np.nan, np.tan(in_water))[:, None] * aside,
    )


def seen_points(sensor: Sensor, xyz_lcs_mm: ArrayF) -> SeenPoints:
    """Points (n, 3) of the water, lcs, as the camera sees them; hidden or not."""
    seen = see(sensor, xyz_lcs_mm)
    up = seen.up @ sensor.window.R_lcs_window
    return SeenPoints(
        xy_px=seen.xy_px,
        inside=np.asarray(sensor.camera.inside(seen.xy_px), dtype=np.bool_),
        slope=-up[:, :2] / up[:, 2:],
    )
