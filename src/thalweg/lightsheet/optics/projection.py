"""From points of the water to pixels, through the window."""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayF
from thalweg.lightsheet.optics import intersection_kernels
from thalweg.lightsheet.optics.intersection import camera_window
from thalweg.lightsheet.optics.refracted_rays import directions_to_points
from thalweg.lightsheet.optics.sensor import Sensor
from thalweg.lightsheet.optics.threads import threads_for

_EACH: Final = 16384
"""Points for a thread."""


def project(sensor: Sensor, xyz_lcs_mm: ArrayLike) -> ArrayF:
    """Pixels (n, 2) of points (n, 3) in lcs, seen from the air through glass and water.

    NaN for points above the outer face of the window, behind the camera, or beyond where the lens model folds
    back. A point outside the picture keeps its numbers; ask ``sensor.camera.inside``.

    Raises
    ------
    GeometryError : no (n, 3) points.
    """
    points = np.atleast_2d(np.asarray(xyz_lcs_mm, dtype=np.float64))
    if points.ndim != 2 or points.shape[1] != 3:
        raise GeometryError(f"points of the shape {points.shape}", expected="(n, 3)")
    directions = directions_to_points(sensor.camera_origin_lcs_mm, points, sensor.window)
    out = np.empty((len(points), 2))
    C, _ = camera_window(sensor)
    local = np.ascontiguousarray(directions @ sensor.window.R_lcs_window)
    with threads_for(len(out), each=_EACH):
        intersection_kernels.pixels(local, sensor.camera.parameters, C, out)
    return out
