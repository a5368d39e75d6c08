"""What a calibration of the sensor's camera refuses, each with its cause."""

from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.calibration.field.job import MeasuredField
from thalweg.core.camera.model import Camera
from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayF
from thalweg.lightsheet.lens.design import ONE_DIRECTION

LEAST_PICTURES: Final = 6
"""With fewer hardly a mark is checked by another."""

LARGEST_SIGMA: Final = 1e-3
"""Of camera constant and principal point over the camera constant: three times P4's 0.004 mm of 12 mm; that
alone makes 0.15 mm in depth, as much as P4's whole budget near the window (P4 6.6)."""

_LARGEST_SCATTER_PX: Final = 1.0
_LARGEST_START_PX: Final = 2.0
"""A lens that is 0.4 % off its design and has 16 px of distortion in the corners leaves 0.4 px."""
_FAR: Final = 0.1
"""Relative difference of the camera constant from the design at which it is another camera."""
_LEVEL: Final = 1e-4
"""Probability with which a steady camera is called changed."""
_AT_LARGE: Final = (
    "Check that markers and corners have the same numbers in all pictures (corner 0 is the upper left one of "
    "the printed sheet), that the field stood still, and that size and camera constant of the design are "
    "those of the pictures"
)


def require_determined(
    camera: Camera, cov: ArrayF, correlations: pd.DataFrame, views: dict[str, Any], *, where: str = ""
) -> None:
    """Refuse an interior orientation whose camera constant or principal point is not determined.

    Parameters
    ----------
    camera, cov : values, and covariance (9, 9).
    correlations, views : see `lens_correlations` and `view_facts`.
    where : name of the table of marks.

    Raises
    ------
    GeometryError : names the parameters, their sigmas and what they are correlated with.
    """
    sigma = np.sqrt(np.maximum(np.diag(cov)[:4], 0.0))
    free = np.flatnonzero(~(sigma <= LARGEST_SIGMA * camera.parameters[0]))
    if not free.size:
        return
    told = []
    for k in free:
        name = camera.parameter_names[k]
        # that fx goes with fy, or cx with p2, is nothing that pictures could change
        most = correlations[correlations["parameter"] == name].iloc[-1]
        size = f"{sigma[k]:.1f} px" if sigma[k] < camera.size_px[0] else "more than the picture's width"
        told.append(f"{name} (sigma {size}, correlation {most['correlation']:+.4f} with {most['with']})")
    raise GeometryError(
        f"the pictures do not determine {', '.join(told)}; {_view_words(views)}",
        expected=f"sigmas below {LARGEST_SIGMA * camera.parameters[0]:.1f} px",
        where=where,
        cure="Take more pictures: tilted by 30 to 45 degrees from all sides, each second one with the camera "
        "rolled by 90 degrees about its view, and put some markers on posts of different heights",
    )


def _view_words(views: dict[str, Any]) -> str:
    angle = views["largest_angle_deg"]
    if np.deg2rad(angle) < ONE_DIRECTION:
        words = f"all look in one direction within {angle:.2g} degrees"
    else:
        words = f"they look in directions that differ by up to {angle:.0f} degrees"
    rolled = f"{views['rolled']} of {views['pictures']} are" if views["rolled"] else "none is"
    return f"{words}, and {rolled} rolled"


def require_pictures(marks: pd.DataFrame, where: str) -> None:
    """Refuse a table of marks of too few pictures."""
    n = int(marks["image"].nunique())
    if n < LEAST_PICTURES:
        raise GeometryError(
            f"{n} picture{'s' * (n != 1)} of the field",
            expected=f"at least {LEAST_PICTURES}, better 20",
            where=where,
            cure="Take more pictures of the field: tilted by 30 to 45 degrees from all sides, each second "
            "one with the camera rolled by 90 degrees",
        )


def require_design(camera: Camera, design: Camera, where: str) -> None:
    """Refuse a camera whose constant is another one than the design's."""
    ratio = float(camera.parameters[0] / design.parameters[0])
    if abs(ratio - 1) > _FAR:
        raise GeometryError(
            f"by the pictures the camera constant is {camera.parameters[0]:.0f} px, {ratio:.3g} times that "
            "of the design",
            expected="pictures of the sensor's camera, in the mode and at the focus of the sensor",
            where=where,
            cure="Check which camera and which lens took the pictures, or correct fx and fy in the design",
        )


def with_misfit(error: GeometryError, start_px: float) -> GeometryError:
    """The error; where already the approximate values do not fit, with what may be wrong at large."""
    if start_px < _LARGEST_START_PX:
        return error
    found = f"{error.found}; already the approximate values leave {start_px:.0f} px (median)"
    cure = f"{_AT_LARGE}; else: {error.cure}"
    return GeometryError(found, expected=error.expected, where=error.where, cure=cure)


def require_fit(scatter_px: float, where: str) -> None:
    """Refuse marks that scatter by more than a pixel after the adjustment."""
    if scatter_px > _LARGEST_SCATTER_PX:
        raise GeometryError(
            f"the marks fit one rigid field to {scatter_px:.1f} px only",
            expected=f"less than {_LARGEST_SCATTER_PX:g} px, in sharp pictures 0.1 px",
            where=where,
            cure=_AT_LARGE,
        )


def require_steady(measured: MeasuredField, where: str) -> None:
    """Refuse a change of the camera: even if it leaves the field as it is, the result mixes two cameras."""
    for change in measured.network.changes:
        if change.probability < _LEVEL:
            raise GeometryError(
                f"the camera changed between {change.before} and {change.since}: camera constant by "
                f"{change.constant:+.2%} (sigma {change.sigma_constant:.2%}), principal point by "
                f"{change.shift_px[0]:+.1f} and {change.shift_px[1]:+.1f} pixels",
                expected="one focus and one mount of the lens for all pictures, those of the sensor",
                where=where,
                cure="Take all pictures again with the focus ring fixed, or leave out those before or since",
            )
