"""Camera models by a sphere as a fisheye: the pixel of rays up to each corner of the picture."""

import numpy as np
import pytest

from thalweg.core.calibration.imports import fisheye_of_sphere
from thalweg.core.camera import Camera

UNIT = {"ds": (-0.2, 0.6), "eucm": (0.65, 1.1)}


def by_sphere(kind: str, shape: tuple[float, ...], rays: np.ndarray) -> np.ndarray:
    """Places (n, 2) in units of the focal length, by the models' own projection equations."""
    x, y, z = rays.T
    if kind == "eucm":  # Khomutenko et al. (2016), eq. 10
        alpha, beta = shape
        below = alpha * np.sqrt(beta * (x**2 + y**2) + z**2) + (1 - alpha) * z
    else:  # Usenko et al. (2018), eq. 40 to 42
        xi, alpha = shape
        d1 = np.linalg.norm(rays, axis=1)
        below = alpha * np.sqrt(x**2 + y**2 + (xi * d1 + z) ** 2) + (1 - alpha) * (xi * d1 + z)
    return np.column_stack([x, y]) / below[:, None]


@pytest.mark.parametrize("kind", list(UNIT))
@pytest.mark.parametrize("size_px", [(700, 260), (260, 700)])
def test_the_whole_picture_is_imaged_as_by_the_sphere(kind, size_px):
    """A wide and a high picture whose principal point lies near one corner: the other one is far."""
    f, middle = (420.0, 400.0), (100.0, 90.0)
    values = np.array([*UNIT[kind], *f, *middle])
    camera = Camera(
        model="fisheye",
        size_px=size_px,
        parameters=fisheye_of_sphere(kind, values, np.array(size_px)),
        name="a",
    )
    angle, around = np.meshgrid(
        np.deg2rad(np.arange(1.0, 100.0, 1.0)), np.deg2rad(np.arange(0.0, 360.0, 5.0))
    )
    rays = np.column_stack(
        [
            (np.sin(angle) * np.cos(around)).ravel(),
            (np.sin(angle) * np.sin(around)).ravel(),
            np.cos(angle).ravel(),
        ]
    )
    stated = by_sphere(kind, UNIT[kind], rays) * f + middle
    seen = ((stated >= 0) & (stated <= size_px)).all(axis=1)
    assert np.linalg.norm(stated[seen] - middle, axis=1).max() > 580.0
    np.testing.assert_allclose(camera.project(rays[seen]), stated[seen], atol=0.03)
