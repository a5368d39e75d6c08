"""The true sensor of a campaign: a nominal one with the tolerances of its making, in its true water."""

from dataclasses import replace
from typing import Final

import numpy as np

from thalweg.core.errors import ConfigError
from thalweg.core.types import ArrayF
from thalweg.lightsheet.optics.refractive_index import air, water
from thalweg.lightsheet.optics.sensor import LENS, Sensor
from thalweg.settings.twin.light_sheet import SheetImage
from thalweg_lab.base.random import generator

SIZES: Final = {"tiny": 512, "demo": 1024, "full": 2048}
"""Pixels a side of the images of a campaign."""

LASER_TOLERANCE: Final = (3.0, 3.0, 3.0, 0.8, 0.8, 0.8)
"""How well a laser is mounted without calibration: millimetres and degrees, standard deviations."""

CAMERA_TOLERANCE: Final = (0.0, 0.0, 0.5, 0.3, 0.3, 0.3)
"""The same for the camera; its plumb point defines the origin of lcs (P4 6.3)."""

GLASS_TOLERANCE_MM: Final = 0.05
FOCAL_TOLERANCE: Final = 0.002


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
        sensor,
        camera=sensor.camera.scaled((SIZES[size], height)),
        cov=sensor.cov * np.outer(scale, scale),
    )
    laser = settings.laser.model_copy(update={"waist_mm": settings.laser.waist_mm / factor})
    return smaller, settings.model_copy(update={"laser": laser})


def in_water_of(sensor: Sensor, temperature_c: float, wavelength_nm: float = 520.0) -> Sensor:
    """The same sensor in fresh water of a temperature: IAPWS's index over that of air in the housing."""
    return sensor.with_water(water(wavelength_nm, temperature_c) / air(wavelength_nm) * sensor.window.n_air)


def true_sensor(nominal: Sensor, seed: int, *, n_water: float | None = None, tilt_deg: float = 0.0) -> Sensor:
    """A sensor as it was really built: the nominal one with errors of mounting, of the lens and of the glass.

    Parameters
    ----------
    nominal : what the drawing says.
    seed : of the campaign; the streams are ``light sheet true laser``, ``... camera``, ``... lens``, ``...
        glass``.
    n_water : index of the true water, None: the nominal one.
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
        n_water=nominal.window.n_water if n_water is None else n_water,
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


def _draw(seed: int, part: str, tolerance: tuple[float, ...]) -> ArrayF:
    """Errors (6,) in millimetres and radians."""
    drawn = generator(seed, f"light sheet true {part}").standard_normal(6) * tolerance
    drawn[3:] = np.deg2rad(drawn[3:])
    return np.asarray(drawn)
