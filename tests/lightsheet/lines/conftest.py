"""Images of straight, curved and uneven lines with speckle, whose places are known."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest

from tests.lightsheet.laser_images import grey_values, line_intensity
from thalweg.core import AnyArray, ArrayF
from thalweg.lightsheet.lines import LinePoints
from thalweg_lab.random_numbers import generator
from thalweg_lab.tank.render import SpeckleOptics

BORDER = 12
"""Rows at both ends of an image that are not judged: the simulated field is periodic there."""


@dataclass(frozen=True)
class Picture:
    """An image, and where its line runs in the centre of each row."""

    image: AnyArray
    centre_px: ArrayF

    def errors(self, points: LinePoints) -> tuple[ArrayF, ArrayF]:
        """Errors along the direction of measurement, and the same divided by sigma."""
        rows = np.arange(self.centre_px.size) + 0.5
        inside = (points.y_px > BORDER) & (points.y_px < rows.size - BORDER)
        along_row = points.x_px - np.interp(points.y_px, rows, self.centre_px)
        slope = np.interp(points.y_px, rows, np.gradient(self.centre_px))
        # to a point on a normal the line is as far as its distance along the row times the cosine
        error = np.where(points.angle_rad == 0.0, along_row, along_row / np.hypot(1.0, slope))
        return error[inside], (error / points.sigma_px)[inside]


Maker = Callable[..., Picture]


@pytest.fixture(scope="session")
def picture():
    @cache
    def plain(**how: Any) -> Picture:
        """A straight line: many tests look at the same few."""
        return new(**how)

    def make(centre_px: ArrayF | None = None, **how: Any) -> Picture:
        """See `new`; pictures are for looking at only."""
        return plain(**how) if centre_px is None and "brightness" not in how else new(centre_px, **how)

    def new(
        centre_px: ArrayF | None = None,
        *,
        seed: int = 1,
        rows: int = 1024,
        width: int = 90,
        half_width_px: float = 5.0,
        peak_dn: float = 150.0,
        optics: SpeckleOptics | None = None,
        brightness: ArrayF | None = None,
        change: Callable[[ArrayF], ArrayF] = lambda light: light,
    ) -> Picture:
        """F/8, 5 px, two polarisations unless asked otherwise; ``brightness`` of each row."""
        centre = np.full(rows, width / 2 + 0.13) if centre_px is None else centre_px
        light = line_intensity(
            centre, width, half_width_px, optics or SpeckleOptics(), generator(seed, "speckle")
        )
        light = light * (np.ones(centre.size) if brightness is None else brightness)[:, None]
        grey = grey_values(change(light), generator(seed, "noise"), peak_dn)
        return Picture(grey, centre)

    return make
