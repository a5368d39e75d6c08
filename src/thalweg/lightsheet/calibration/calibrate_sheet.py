"""Calibration of the light sheet; where pictures contradict what is stated of them, which reading would fit.

Readings are another medium in front of the window, and pictures that were turned or mirrored: each comes with
the sensor and the line points as they would be then, and with what a user should do if it fits.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core import GeometryError, InputError, ThalwegError, UnobservableError
from thalweg.lightsheet.calibration.grid import GridObject
from thalweg.lightsheet.calibration.model import LINE
from thalweg.lightsheet.calibration.settings import CalibrationSettings
from thalweg.lightsheet.calibration.sheet_calibration import SheetCalibration, fit_sheet
from thalweg.lightsheet.optics import LASER, Sensor

_BETTER: Final = 0.4
"""A misfit that many times smaller is an explanation."""
_DOUBT: Final = 3.0
_FAR_SIGMAS: Final = 4.5
_NEARER: Final = 0.6
_AS_WELL: Final = 1.5
_ROUGH_MM: Final = 4.0
_ROUGH_RAD: Final = float(np.deg2rad(1.5))
"""Sigmas of a design that states none: "10 mm and 4 degrees off is near enough"."""
_DOUBT_PX: Final = 0.5
"""Scatter, in units of the sigmas and in pixels, that makes one look for another explanation."""

WATER: Final = 1.335
"""Fresh water at 520 nm, 20 degrees: 1.336 (IAPWS); near enough to tell water from air."""
_WET: Final = 1.2
_COLUMNS: Final = ("x_px", "y_px", "angle_rad")


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """Another reading of the same pictures.

    ``cure`` a sentence without its full stop; ``sensor`` and ``points`` (a table of line points) that belong
    to it, or the same objects that were given where they do not differ.
    """

    cure: str
    sensor: Sensor
    points: pd.DataFrame


def calibrate_sheet(
    sensor: Sensor, points: pd.DataFrame, grid: GridObject, settings: CalibrationSettings | None = None
) -> SheetCalibration:
    """Calibrate the light sheet from the line points of one picture of the grid object.

    Parameters
    ----------
    sensor : camera, window and media with their covariance, and approximate values of the laser, such as the
        nominal design; 10 mm and 4 degrees off is near enough.
    points : line points with x_px, y_px, sigma_px, angle_rad (direction along which sigma holds); peak_dn and
        flags are used if they are there.
    grid : calibration object.
    settings : see `CalibrationSettings`.

    Raises
    ------
    InputError : columns are missing, or too few points.
    FreeDirectionError : unknowns that the observations leave free.
    GeometryError : the picture contradicts the object or the sensor; the cure names another assumption that
        would explain it, if one was found (other medium, picture turned or mirrored).
    """
    chosen = settings or CalibrationSettings()
    try:
        found = fit_sheet(sensor, points, grid, chosen)
    except (UnobservableError, InputError):
        raise
    except GeometryError as error:
        explained = explanation(sensor, points, grid, chosen, misfit_px=np.inf)
        if not explained:
            raise
        raise GeometryError(
            error.found, expected=error.expected, where=error.where, cure=explained
        ) from error
    _require_not_mirrored(found, sensor, points, grid, chosen)
    if found.sigma0[LINE] < _DOUBT or found.misfit_px < _DOUBT_PX:
        return found
    explained = explanation(sensor, points, grid, chosen, misfit_px=_BETTER * found.misfit_px)
    if not explained:
        return found
    raise GeometryError(
        f"the line points lie {found.misfit_px:.2f} px (root mean square) off the levels, "
        f"{found.sigma0[LINE]:.1f} times "
        "their sigma",
        expected="what their sigmas say, if the model is right",
        where=f"sensor {sensor.name!r}, calibration object {grid.name!r}",
        cure=explained,
    )


def design_sigmas(found: Sensor, design: Sensor) -> float:
    """Largest distance of the laser's place and of the sheet's normal from the design, in its sigmas."""
    sigma = np.sqrt(np.maximum(np.diag(design.cov)[LASER], 0.0))
    sigma_mm = np.where(sigma[:3] > 0, sigma[:3], _ROUGH_MM)
    off_mm = np.abs(found.sheet.origin_lcs_mm - design.sheet.origin_lcs_mm)
    normals = [s.sheet.R_lcs_las[:, 1] for s in (found, design)]
    turn = float(np.arccos(np.clip(normals[0] @ normals[1], -1.0, 1.0)))
    sigma_rad = float(sigma[3:].max()) or _ROUGH_RAD
    return float(max((off_mm / sigma_mm).max(), turn / sigma_rad))


def explanation(
    sensor: Sensor, points: pd.DataFrame, grid: GridObject, settings: CalibrationSettings, *, misfit_px: float
) -> str:
    """What would explain a picture that does not fit; "" if nothing that is known of does.

    Parameters
    ----------
    sensor, points, grid, settings : see `calibrate_sheet`.
    misfit_px : root mean square of the residuals that an explanation must stay below.
    """
    best, told = min(misfit_px, settings.largest_misfit_px), ""
    for reading in other_readings(sensor, points):
        try:
            fit = fit_sheet(reading.sensor, reading.points, grid, settings)
        except (ThalwegError, np.linalg.LinAlgError):
            continue
        # points of a wrong assumption may be rejected rather than misfit
        cost = fit.misfit_px / max(float(fit.adjusted.used[LINE].mean()), 0.1)
        if cost < best:
            best, told = cost, f"{reading.cure} (then {fit.misfit_px:.2f} px root mean square)"
    return told


def other_readings(sensor: Sensor, points: pd.DataFrame) -> Iterator[Reading]:
    """The other medium, then the picture turned by 180 degrees and mirrored both ways.

    Parameters
    ----------
    sensor : as stated.
    points : line points with x_px, y_px, angle_rad; without these columns only the medium is read otherwise.
    """
    n = sensor.window.n_water
    if n < _WET:
        yield Reading(
            cure=f"The picture fits with n_water = {WATER}: state the index of water, not {n:g} of air",
            sensor=sensor.with_water(WATER),
            points=points,
        )
    else:
        yield Reading(
            cure=f"The picture fits with the index of air, 1.0, instead of n_water = {n:g}: was the housing "
            "dry, the object not under water?",
            sensor=sensor.with_water(sensor.window.n_air),
            points=points,
        )
    if any(name not in points.columns for name in _COLUMNS):
        return
    for cure, x_sign, y_sign in (
        (
            "The picture fits if it is turned by 180 degrees: camera mounted upside down, or picture rotated",
            -1,
            -1,
        ),
        ("The picture fits if it is mirrored left to right: switch the mirroring of the camera off", -1, 1),
        ("The picture fits if it is mirrored top to bottom: switch the mirroring of the camera off", 1, -1),
    ):
        yield Reading(cure=cure, sensor=sensor, points=_turned(points, sensor, x_sign, y_sign))


def _require_not_mirrored(
    found: SheetCalibration,
    sensor: Sensor,
    points: pd.DataFrame,
    grid: GridObject,
    settings: CalibrationSettings,
) -> None:
    """Refuse a picture that fits, but mirrored or turned fits as well with a laser that is near its design.

    Sensors are nearly symmetric about the plane of camera and laser, and so is the grid: the mirrored picture
    has a light sheet of its own, and only the design tells which one is there.
    """
    far = design_sigmas(found.sensor, sensor)
    if far < _FAR_SIGMAS:
        return
    for reading in other_readings(sensor, points):
        if reading.sensor is not sensor:
            continue
        try:
            fit = fit_sheet(sensor, reading.points, grid, settings)
        except (ThalwegError, np.linalg.LinAlgError):
            continue
        near = design_sigmas(fit.sensor, sensor)
        if near < _NEARER * far and fit.misfit_px < _AS_WELL * found.misfit_px:
            raise GeometryError(
                f"the laser lies {far:.0f} sigmas from its design",
                expected="a laser near its design, as the design's own sigmas say",
                where=f"sensor {sensor.name!r}, calibration object {grid.name!r}",
                cure=f"{reading.cure} (then {near:.1f} sigmas, with {fit.misfit_px:.2f} instead of "
                f"{found.misfit_px:.2f} px root mean square)",
            )


def _turned(points: pd.DataFrame, sensor: Sensor, x_sign: int, y_sign: int) -> pd.DataFrame:
    """Line points of the picture turned or mirrored about its centre."""
    moved = points.copy()
    width, height = sensor.camera.size_px
    if x_sign < 0:
        moved["x_px"] = width - points["x_px"]
    if y_sign < 0:
        moved["y_px"] = height - points["y_px"]
    moved["angle_rad"] = points["angle_rad"] * x_sign * y_sign
    return moved
