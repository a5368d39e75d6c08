"""Calibration of the light sheet, and the refusal of pictures that fit only because they are mirrored."""

from typing import Final

import numpy as np
import pandas as pd

from thalweg.core import GeometryError, ThalwegError
from thalweg.lightsheet.calibration.grid import GridObject
from thalweg.lightsheet.calibration.settings import CalibrationSettings
from thalweg.lightsheet.calibration.sheet_calibration import SheetCalibration, fit_sheet
from thalweg.lightsheet.optics import LASER, Sensor

_FAR_SIGMAS: Final = 4.5
_NEARER: Final = 0.6
_AS_WELL: Final = 1.5
_ROUGH_MM: Final = 4.0
_ROUGH_RAD: Final = float(np.deg2rad(1.5))
"""Sigmas of a design that states none: "10 mm and 4 degrees off is near enough"."""


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
    GeometryError : the picture contradicts the object or the sensor; or it fits, but turned or mirrored it
        fits as well with a laser that is near its design.
    """
    chosen = settings or CalibrationSettings()
    found = fit_sheet(sensor, points, grid, chosen)
    far = design_sigmas(found.sensor, sensor)
    if far < _FAR_SIGMAS:
        return found
    width, height = sensor.camera.size_px
    x, y, angle = (points[name] for name in ("x_px", "y_px", "angle_rad"))
    for words, other in (
        ("turned by 180 degrees", {"x_px": width - x, "y_px": height - y}),
        ("mirrored left to right", {"x_px": width - x, "angle_rad": -angle}),
        ("mirrored top to bottom", {"y_px": height - y, "angle_rad": -angle}),
    ):
        try:
            fit = fit_sheet(sensor, points.assign(**other), grid, chosen)
        except (ThalwegError, np.linalg.LinAlgError):
            continue
        near = design_sigmas(fit.sensor, sensor)
        if near < _NEARER * far and fit.misfit_px < _AS_WELL * found.misfit_px:
            raise GeometryError(
                f"the laser lies {far:.0f} sigmas from its design",
                expected="a laser near its design, as the design's own sigmas say",
                where=f"sensor {sensor.name!r}, calibration object {grid.name!r}",
                cure=f"The picture fits if it is {words}: use the files as the camera stores them (then "
                f"{near:.1f} sigmas, with {fit.misfit_px:.2f} instead of {found.misfit_px:.2f} px)",
            )
    return found


def design_sigmas(found: Sensor, design: Sensor) -> float:
    """Largest distance of the laser's place and of the sheet's normal from the design, in its sigmas."""
    sigma = np.sqrt(np.maximum(np.diag(design.cov)[LASER], 0.0))
    sigma_mm = np.where(sigma[:3] > 0, sigma[:3], _ROUGH_MM)
    off_mm = np.abs(found.sheet.origin_lcs_mm - design.sheet.origin_lcs_mm)
    normals = [s.sheet.R_lcs_las[:, 1] for s in (found, design)]
    turn = float(np.arccos(np.clip(normals[0] @ normals[1], -1.0, 1.0)))
    sigma_rad = float(sigma[3:].max()) or _ROUGH_RAD
    return float(max((off_mm / sigma_mm).max(), turn / sigma_rad))
