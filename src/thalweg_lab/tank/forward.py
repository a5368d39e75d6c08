"""The true sensor of a campaign, and the way of its light forwards: sub-beams to the water, points to the
image.

The true sensor is a nominal one with the tolerances of its making, in its true water.

The processing goes the other way, from a pixel to the sheet, and never uses this module; the generator never
uses that intersection. Both share the refraction of one ray and the lens.

A point at the distance r from the camera's plumb line is seen along the ray whose invariant ``q = n
sin(angle)`` solves, with the heights h in air, t of the glass and D in the water, ::

    r(q) = q (h / sqrt(n_air^2 - q^2) + t / sqrt(n_glass^2 - q^2) + D / sqrt(n_water^2 - q^2))

r grows with q, so a bracket from 0 to the smallest index always holds the root.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from thalweg.core import ArrayB, ArrayF, ConfigError, njit
from thalweg.lightsheet.optics import LENS, Sensor, Window, air, trace, water
from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import SheetImage

SIZES: Final = {"tiny": 512, "demo": 1024, "full": 2048}
"""Pixels a side of the images of a campaign."""

LASER_TOLERANCE: Final = (3.0, 3.0, 3.0, 0.8, 0.8, 0.8)
"""How well a laser is mounted without calibration: millimetres and degrees, standard deviations."""

CAMERA_TOLERANCE: Final = (0.0, 0.0, 0.5, 0.3, 0.3, 0.3)
"""The same for the camera; its plumb point defines the origin of lcs (P4 6.3)."""

GLASS_TOLERANCE_MM: Final = 0.05
FOCAL_TOLERANCE: Final = 0.002

_STEPS: Final = 60
"""Newton takes 4 to 6; halving of the bracket is bound by 52."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WaterBeams:
    """Rays in the water, lcs.

    ``start_mm`` (n, 3) on the outer face of the window, ``direction`` (n, 3) unit vectors, NaN where a ray
    never gets there.
    """

    start_mm: ArrayF
    direction: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """Points as the camera sees them.

    ``xy_px`` (n, 2), NaN where there is no image; ``up`` (n, 3) unit directions in the water from the point
    towards the camera, lcs; ``water_mm`` (n,) way in the water; ``apparent_mm`` (n,) distance from the
    projection centre as it seems, each way divided by its index relative to air; ``axial_mm`` (n,) the same
    along the optical axis.
    """

    xy_px: ArrayF
    up: ArrayF
    water_mm: ArrayF
    apparent_mm: ArrayF
    axial_mm: ArrayF


def sized(sensor: Sensor, settings: SheetImage, size: str) -> tuple[Sensor, SheetImage]:
    """The same sensor with larger pixels, and light that is as many pixels wide as before.

    The geometry in millimetres stays, and so does everything in pixels: the laser's waist becomes wider,
    speckle and blur keep their size in pixels. So a small image asks the same of line detection as a large
    one, and all errors in millimetres grow by the ratio of the sizes.

    Raises
    ------
    ConfigError : another size than `SIZES` has.
    """
    if size not in SIZES:
        raise ConfigError(f"size '{size}'", expected=f"one of {', '.join(SIZES)}")
    full = sensor.camera.size_px[0]
    factor = SIZES[size] / full
    height = round(sensor.camera.size_px[1] * factor)
    scale = np.ones(len(sensor.cov))
    scale[LENS][:4] = factor
    smaller = replace(
        sensor, camera=sensor.camera.scaled((SIZES[size], height)), cov=sensor.cov * np.outer(scale, scale)
    )
    laser = settings.laser.model_copy(update={"waist_mm": settings.laser.waist_mm / factor})
    return smaller, settings.model_copy(update={"laser": laser})


def in_water_of(sensor: Sensor, temperature_c: float, wavelength_nm: float = 520.0) -> Sensor:
    """The same sensor in fresh water of a temperature: IAPWS's index over that of air in the housing."""
    return sensor.with_water(water(wavelength_nm, temperature_c) / air(wavelength_nm) * sensor.window.n_air)


def true_sensor(nominal: Sensor, seed: int, *, tilt_deg: float = 0.0) -> Sensor:
    """A sensor as it was really built: the nominal one with errors of mounting, of the lens and of the glass.

    Parameters
    ----------
    nominal : what the drawing says.
    seed : of the campaign; the streams are ``light sheet true laser``, ``... camera``, ``... lens``, ``...
        glass``.
    tilt_deg : standard deviation of the window's tilt about each axis.
    """
    laser, camera = _draw(seed, "laser", LASER_TOLERANCE), _draw(seed, "camera", CAMERA_TOLERANCE)
    glass = generator(seed, "light sheet true glass").standard_normal(3)
    lens = generator(seed, "light sheet true lens").standard_normal(3)
    parameters = nominal.camera.parameters.copy()
    parameters[:2] *= 1.0 + FOCAL_TOLERANCE * lens[0]
    parameters[2:4] += 0.002 * nominal.camera.size_px[0] * lens[1:]
    window = replace(
        nominal.window,
        thickness_mm=nominal.window.thickness_mm + GLASS_TOLERANCE_MM * float(glass[0]),
        tilt_x_rad=nominal.window.tilt_x_rad + float(np.deg2rad(tilt_deg) * glass[1]),
        tilt_y_rad=nominal.window.tilt_y_rad + float(np.deg2rad(tilt_deg) * glass[2]),
    )
    sheet = replace(
        nominal.sheet,
        origin_lcs_mm=nominal.sheet.origin_lcs_mm + laser[:3],
        angles_rad=nominal.sheet.angles_rad + laser[3:],
    )
    return replace(
        nominal,
        camera=nominal.camera.with_parameters(parameters),
        camera_origin_lcs_mm=nominal.camera_origin_lcs_mm + camera[:3],
        camera_angles_rad=nominal.camera_angles_rad + camera[3:],
        sheet=sheet,
        window=window,
    )


def beams_in_water(origins_mm: ArrayF, directions: ArrayF, window: Window) -> WaterBeams:
    """Rays behind the window from origins (n, 3) or (3,) and unit directions (n, 3) in air, lcs."""
    path = trace(origins_mm, directions, window)
    return WaterBeams(start_mm=path.at_outer_mm, direction=path.in_water)


def see(sensor: Sensor, xyz_lcs_mm: ArrayF) -> Seen:
    """Points (n, 3) in lcs, under the window, as the sensor's camera sees them; hidden or not."""
    window, R = sensor.window, sensor.window.R_lcs_window
    points = np.ascontiguousarray(xyz_lcs_mm @ R)
    centre = sensor.camera_origin_lcs_mm @ R
    media = np.array([window.n_air, window.n_glass, window.n_water, window.thickness_mm])
    out = np.empty((len(points), 8))
    _towards(points, centre, media, out)
    rays_ccs = out[:, :3] @ R.T @ sensor.R_lcs_ccs
    return Seen(
        xy_px=sensor.camera.project(rays_ccs),
        up=out[:, 3:6] @ R.T,
        water_mm=out[:, 6],
        apparent_mm=out[:, 7],
        axial_mm=out[:, 7] * rays_ccs[:, 2],
    )


def camera_rays(sensor: Sensor, xy_px: ArrayF) -> WaterBeams:
    """Rays in the water of pixels (n, 2)."""
    return beams_in_water(
        sensor.camera_origin_lcs_mm, sensor.camera.rays(xy_px) @ sensor.R_lcs_ccs.T, sensor.window
    )


def in_picture(sensor: Sensor, xy_px: ArrayF, margin_px: float) -> ArrayB:
    """Which pixels (n, 2) lie in the picture or at most a margin outside; NaN does not."""
    return np.asarray(sensor.camera.inside(xy_px, -margin_px), dtype=np.bool_)


def _draw(seed: int, part: str, tolerance: tuple[float, ...]) -> ArrayF:
    """Errors (6,) in millimetres and radians."""
    drawn = generator(seed, f"light sheet true {part}").standard_normal(6) * tolerance
    drawn[3:] = np.deg2rad(drawn[3:])
    return np.asarray(drawn)


@njit(cache=True, nogil=True, error_model="numpy")
def _towards(points: ArrayF, centre: ArrayF, media: ArrayF, out: ArrayF) -> None:
    """Fill ``out`` (n, 8): ray in air (3), direction up in water (3), way in water, apparent distance.

    Everything is in the frame of the window.
    """
    n_air, n_glass, n_water, thickness = media[0], media[1], media[2], media[3]
    height = centre[2]
    least = min(n_air, n_glass, n_water)
    for i in range(len(points)):
        dx, dy = points[i, 0] - centre[0], points[i, 1] - centre[1]
        depth = -points[i, 2] - thickness
        r = np.sqrt(dx * dx + dy * dy)
        if not depth >= 0.0:
            out[i] = np.nan
            continue
        low, high = 0.0, least
        q = r / np.sqrt(r * r + (height / n_air + thickness / n_glass + depth / n_water) ** 2)
        q = min(q, 0.999 * least)
        for _ in range(_STEPS):
            a, g, w = n_air**2 - q * q, n_glass**2 - q * q, n_water**2 - q * q
            sa, sg, sw = np.sqrt(a), np.sqrt(g), np.sqrt(w)
            f = q * (height / sa + thickness / sg + depth / sw) - r
            if f > 0.0:
                high = q
            else:
                low = q
            slope = (
                height * n_air**2 / (a * sa)
                + thickness * n_glass**2 / (g * sg)
                + depth * n_water**2 / (w * sw)
            )
            new = q - f / slope
            if not (low <= new <= high):
                new = 0.5 * (low + high)
            moved = abs(new - q)
            q = new
            if moved < 1e-15:
                break
        cx, cy = (dx / r, dy / r) if r > 0.0 else (0.0, 0.0)
        sine = q / n_air
        out[i, 0], out[i, 1], out[i, 2] = sine * cx, sine * cy, -np.sqrt(1.0 - sine * sine)
        sine = q / n_water
        cosine = np.sqrt(1.0 - sine * sine)
        out[i, 3], out[i, 4], out[i, 5] = -sine * cx, -sine * cy, cosine
        out[i, 6] = depth / cosine
        in_air = height / np.sqrt(1.0 - (q / n_air) ** 2)
        in_glass = thickness / np.sqrt(1.0 - (q / n_glass) ** 2)
        out[i, 7] = in_air + (in_glass / n_glass + out[i, 6] / n_water) * n_air
