"""Line points on a grid object, and sensors of which more or less is known."""

import numpy as np

from thalweg.lightsheet.optics import Sensor
from thalweg_lab.random_numbers import generator
from thalweg_lab.studies.prior_study import OBJECT, grid_object, line_points

__all__ = ["OBJECT", "THREE", "grid_object", "line_points", "off_start", "without_sigmas"]

THREE = OBJECT.replace(
    "  - {name: plate", "  - {name: middle, pattern: grid, depth_mm: 105.0, sigma_mm: 0.05}\n  - {name: plate"
)
"""A third level under every other gap."""


def without_sigmas(sensor: Sensor) -> Sensor:
    """A sensor of which everything is known exactly."""
    return sensor.with_vector(sensor.vector(), cov=np.zeros((26, 26)))


def off_start(sensor: Sensor, seed: int, mm: float = 10.0, deg: float = 4.0) -> Sensor:
    """The sensor with a laser that is off by up to so much in each coordinate and angle."""
    rng, x = generator(seed, "start"), sensor.vector()
    x[15:18] += rng.uniform(-mm, mm, 3)
    x[18:21] += np.deg2rad(rng.uniform(-deg, deg, 3))
    return sensor.with_vector(x)
