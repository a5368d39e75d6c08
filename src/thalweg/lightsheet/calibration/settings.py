"""What a calibration of the light sheet estimates, and how it treats the measured line."""

from dataclasses import dataclass
from typing import Final

from thalweg.core import GeometryError
from thalweg.lightsheet.calibration.grid import GridObject
from thalweg.lightsheet.optics import CAMERA, LENS, PARAMETERS, WINDOW
from thalweg.settings.sections import SheetCalibration

GROUPS: Final = ("camera", "lens", "window", "water", "levels", "slopes")
"""What can be estimated together with the sheet."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationSettings:
    """Settings of `calibrate_sheet`.

    Parameters
    ----------
    estimate : unknowns without any knowledge beforehand, names of `PARAMETERS`; empty for the five laser
        parameters that can be estimated.
    jointly : groups of `GROUPS`, or single names, that are unknowns known beforehand with their sigmas: those
        of the sensor's covariance and of the calibration object. What has a sigma and is not estimated is
        held fixed, and its uncertainty is carried into the result ("consider" covariance).
    sigma_slope : of the slopes of the levels, where these are estimated (millimetre a millimetre).
    sigma_edge_px : of the end of a piece of line, along the line.
    sigma_edge_shift_px : by how far all ends may seem to lie too far out.
    reject_sigmas : beyond which line points and pairs are taken as wrong.
    rescale : whether the sigmas of line points and pairs are those that their scatter shows, the stated ones
        being prior knowledge, and errors that neighbouring line points share (a matching patch covers many
        rows) enlarge them; see `scatter`.
    largest_misfit_px : root mean square distance of the line points from the adjusted levels beyond which the
        model, not the measurement, is wrong.
    drop_flags : bits of flags whose points take no part as line points; they still show where pieces end.
    least_points, least_gap_px, trim : shortest piece of line, shortest gap, points left out at each end of a
        piece.
    """

    estimate: tuple[str, ...] = ()
    jointly: tuple[str, ...] = ()
    sigma_slope: float = 5e-4
    sigma_edge_px: float = 0.5
    sigma_edge_shift_px: float = 1.0
    reject_sigmas: float = SheetCalibration().reject_sigmas
    rescale: bool = True
    largest_misfit_px: float = SheetCalibration().largest_misfit_px
    drop_flags: int = 0
    least_points: int = 5
    least_gap_px: float = 4.0
    trim: int = 1


def joint_names(settings: CalibrationSettings, grid: GridObject) -> tuple[str, ...]:
    """Names of the unknowns known beforehand, in the order of the sensor's and the object's parameters.

    Raises
    ------
    GeometryError : an unknown name.
    """
    depths = tuple(f"depth_{level.name}_mm" for level in grid.levels)
    slopes = tuple(f"slope_{axis}_{level.name}" for axis in "xy" for level in grid.levels)
    window = PARAMETERS[WINDOW]
    members = {
        "camera": PARAMETERS[CAMERA],
        "lens": PARAMETERS[LENS],
        "window": tuple(name for name in window if name != "n_water"),
        "water": ("n_water",),
        "levels": depths,
        "slopes": slopes,
    }
    every = (*PARAMETERS, *depths, *slopes)
    wanted: set[str] = set()
    for word in settings.jointly:
        if word not in members and word not in every:
            raise GeometryError(
                f"{word!r} among what is estimated jointly",
                expected=f"some of {', '.join(GROUPS)}, or parameters",
            )
        wanted |= set(members.get(word, (word,)))
    unknown = [name for name in settings.estimate if name not in PARAMETERS]
    if unknown:
        raise GeometryError(
            f"{', '.join(unknown)} among the unknowns", expected=f"some of {', '.join(PARAMETERS)}"
        )
    return tuple(name for name in every if name in wanted and name not in settings.estimate)
