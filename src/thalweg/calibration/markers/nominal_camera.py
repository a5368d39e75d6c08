"""Nominal interior orientation where nobody knows it: focal lengths are tried, the field says which fits."""

from collections.abc import Callable
from typing import Final

import numpy as np

from thalweg.core.camera.model import PARAMETERS, Camera, Model
from thalweg.core.errors import GeometryError

TRIED: Final = {
    "perspective": (0.62, 0.8, 1.0, 1.25, 1.6, 2.1),
    "fisheye": (0.24, 0.3, 0.36, 0.44, 0.54),
}
"""Focal lengths over the longer side: 22 to 76 mm on full frame; fisheyes of 106 to 240 degrees."""


def nominal_camera(name: str, model: Model, size_px: tuple[int, int], focal_px: float) -> Camera:
    """A camera with its principal point in the middle and without distortion."""
    p = np.zeros(len(PARAMETERS[model]))
    p[:4] = focal_px, focal_px, size_px[0] / 2, size_px[1] / 2
    return Camera(model=model, size_px=size_px, parameters=p, name=name)


def starting_camera_by(
    misfit: Callable[[Camera], float],
    name: str,
    model: Model,
    size_px: tuple[int, int],
    focal_px: float | None,
) -> Camera:
    """The nominal camera of a stated focal length, or else that of the tried ones with the smallest misfit.

    Raises
    ------
    GeometryError : none of them gives any solution.
    """
    if focal_px is not None:
        return nominal_camera(name, model, size_px, focal_px)
    return best_nominal(name, model, size_px, misfit)


def best_nominal(
    name: str, model: Model, size_px: tuple[int, int], misfit: Callable[[Camera], float]
) -> Camera:
    """The tried focal length with the smallest misfit.

    Parameters
    ----------
    name, model, size_px : of the camera.
    misfit : of a camera; `GeometryError` counts as infinite.

    Raises
    ------
    GeometryError : none of them gives any solution; the last reason is told.
    """
    best: tuple[float, Camera] | None = None
    reason: GeometryError | None = None
    for share in TRIED[model]:
        camera = nominal_camera(name, model, size_px, share * max(size_px))
        try:
            value = misfit(camera)
        except GeometryError as error:
            reason = error
            continue
        if best is None or value < best[0]:
            best = (value, camera)
    if best is None:
        assert reason is not None
        raise reason
    return best[1]
