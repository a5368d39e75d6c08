"""Marks on the calibration object for the exterior orientation of the sensor's camera, with scale bars.

P4 4.3 determines it before water and housing are there; a picture through window and water serves as well.
The marks' plane coordinates come from a bundle adjustment, their depths from a calliper.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from thalweg.core.types import ArrayF, ArrayI
from thalweg.lightsheet.optics.sensor import Sensor
from thalweg_lab.base.random import generator
from thalweg_lab.tank.forward import see

SIGMA_MARK_MM: Final = 0.03
SIGMA_BAR_MM: Final = 0.01
SIGMA_PX: Final = 0.08


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """Marks in lcs.

    ``marker`` (m,), true ``xyz_lcs_mm`` (m, 3), ``measured_lcs_mm`` (m, 3); ``bars`` (b, 2) markers at the
    ends of the scale bars, ``bar_mm`` (b,) their certified lengths.
    """

    marker: ArrayI
    xyz_lcs_mm: ArrayF
    measured_lcs_mm: ArrayF
    bars: ArrayI
    bar_mm: ArrayF


def build_board(sensor: Sensor, seed: int, *, depths_mm: tuple[float, float] = (60.0, 150.0)) -> Board:
    """Marks on two levels of the field of view: 6 x 5 on each; two bars lie on the lower one."""
    t = sensor.window.thickness_mm
    places = []
    for depth in depths_mm:
        reach = 40.0 + 0.35 * depth
        X, Y = np.meshgrid(np.linspace(-reach, reach, 6), np.linspace(-130.0, -40.0, 5))
        places.append(np.stack([X.ravel(), Y.ravel(), np.full(X.size, -t - depth)], axis=1))
    true = np.concatenate(places)
    marker = np.arange(1, len(true) + 1)
    error = generator(seed, "light sheet board marks").standard_normal(true.shape)
    lower = marker[30:].reshape(5, 6)
    bars = np.array([[lower[0, 0], lower[0, 5]], [lower[4, 0], lower[4, 5]]])
    length = np.linalg.norm(true[bars[:, 0] - 1] - true[bars[:, 1] - 1], axis=1)
    bar_error = generator(seed, "light sheet board bars").standard_normal(2)
    return Board(
        marker=marker,
        xyz_lcs_mm=true,
        measured_lcs_mm=true + SIGMA_MARK_MM * error,
        bars=bars,
        bar_mm=length + SIGMA_BAR_MM * bar_error,
    )


def dry(sensor: Sensor) -> Sensor:
    """The sensor without water and without its window."""
    n = sensor.window.n_air
    return replace(sensor, window=replace(sensor.window, thickness_mm=0.0, n_glass=n, n_water=n))


def observe_board(
    sensor: Sensor, board: Board, seed: int, *, name: str, sigma_px: float = SIGMA_PX
) -> tuple[ArrayI, ArrayF]:
    """Markers (n,) in the picture and their image coordinates (n, 2) with noise."""
    xy = see(sensor, board.xyz_lcs_mm).xy_px
    noise = generator(seed, f"light sheet {name} marks").standard_normal(xy.shape)
    inside = sensor.camera.inside(xy)
    return board.marker[inside], (xy + sigma_px * noise)[inside]
