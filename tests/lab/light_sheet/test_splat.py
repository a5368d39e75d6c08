"""Points of light on the pixels: place, width and sum."""

import numpy as np
import pytest
from scipy.stats import norm

from thalweg_lab.tank.glow import splat


def drawn(x, y, sigma, size=40):
    image = np.zeros((size, size), dtype=np.float32)
    splat(image, np.array([[x, y]]), np.array([2.5]), np.array([sigma]))
    return image.astype(np.float64)


@pytest.mark.parametrize("sigma", [0.3, 0.5, 1.3])
@pytest.mark.parametrize("part", [0.0, 0.13, 0.5, 0.77])
def test_a_point_keeps_its_place(part, sigma):
    # a finer grid without the half of its step shifts everything by 0.25 px: a pixel covers i to i + 1
    image = drawn(19.0 + part, 21.0 - part, sigma)
    centres = np.arange(40) + 0.5
    # pixels sample a narrow point too coarsely, which moves its centre of gravity by up to this; and the
    # reach of 4 sigma ends at different parts of a pixel on both sides
    close = np.exp(-2 * (np.pi * sigma) ** 2) / np.pi + 5e-4
    assert (image.sum(axis=0) @ centres) / image.sum() == pytest.approx(19.0 + part, abs=close)
    assert (image.sum(axis=1) @ centres) / image.sum() == pytest.approx(21.0 - part, abs=close)


def test_a_point_keeps_its_light_and_width():
    image = drawn(20.3, 20.6, 1.2)
    assert image.sum() == pytest.approx(2.5, rel=1e-6)  # float32
    x = np.arange(41)
    exact = 2.5 * np.outer(np.diff(norm.cdf(x, 20.6, 1.2)), np.diff(norm.cdf(x, 20.3, 1.2)))
    # beyond 4 sigma nothing is drawn, and its share is given to the rest
    assert np.abs(image - exact).max() < 2e-4 * exact.max()
