"""Calibration of the light sheet; where it fails, which other assumption would explain the picture."""

from typing import Final

import numpy as np
import pandas as pd

from thalweg.core.adjustment.normal_equations import UnobservableError
from thalweg.core.errors import GeometryError, InputError, ThalwegError
from thalweg.lightsheet.calibration.grid import GridObject
from thalweg.lightsheet.calibration.model import LINE
from thalweg.lightsheet.calibration.other_readings import other_readings
from thalweg.lightsheet.calibration.settings import CalibrationSettings
from thalweg.lightsheet.calibration.sheet_calibration import SheetCalibration, fit_sheet
from thalweg.lightsheet.optics.sensor import LASER, Sensor

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


def _require_not_mirrored(
    found: SheetCalibration, sensor: Sensor, points: pd.DataFrame, grid: GridObject,
    settings: CalibrationSettings,
) -> None:  # fmt: skip
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
