"""A small light-sheet sensor without anything random, and helpers that know the geometry by themselves."""

from dataclasses import dataclass

import numpy as np
import pytest

from thalweg.core import ArrayF
from thalweg.lightsheet.optics import Sensor, paper_4
from thalweg_lab.settings import SheetImage
from thalweg_lab.tank import sized

SEED = 7


@dataclass(frozen=True)
class Small:
    """Sensor of 512 pixels with the full light and with the clean one."""

    sensor: Sensor
    settings: SheetImage
    clean: SheetImage


@pytest.fixture(scope="session")
def small():
    sensor, settings = sized(paper_4(), SheetImage(), "tiny")
    return Small(sensor=sensor, settings=settings, clean=settings.clean())


def row_centres(image: ArrayF) -> ArrayF:
    """Centre of gravity of each row, pixels from the left edge; NaN in rows without light."""
    image = image.astype(np.float64)
    columns = np.arange(image.shape[1]) + 0.5
    total = image.sum(axis=1)
    return np.divide(image @ columns, total, out=np.full(len(image), np.nan), where=total > 0)


def at_rows(xy_px: ArrayF, rows_px: ArrayF) -> ArrayF:
    """Column of a line of points where it crosses the heights of rows; NaN beyond its ends."""
    order = np.argsort(xy_px[:, 1])
    return np.interp(rows_px, xy_px[order, 1], xy_px[order, 0], left=np.nan, right=np.nan)
