"""Speckle factors and line images against the theory of speckle."""

import numpy as np
import pytest
from scipy.special import j1

from tests.lightsheet.laser_images import GreyValues, grey_values, line_intensity, mean_line_intensity
from thalweg_lab.random_numbers import generator
from thalweg_lab.tank.render import SpeckleOptics, SpeckleTile, speckle_factor

OPTICS = SpeckleOptics()


def contrast_in_theory(optics: SpeckleOptics) -> float:
    """Square pixels behind a round pupil: the mean of |2 J1(q) / q|^2 over all pairs of points in a pixel."""
    step = 1 / 200
    d = np.arange(-1, 1 + step / 2, step)
    both = (1 - np.abs(d))[:, None] * (1 - np.abs(d))
    q = 2 * np.pi * optics.cutoff_per_px * np.hypot(d[:, None], d)
    coherence = np.where(q > 0, 2 * j1(q) / np.where(q > 0, q, 1), 1.0)
    return float(np.sqrt(np.sum(both * coherence**2) * step**2 / optics.polarisations))


@pytest.mark.parametrize("optics", [OPTICS, SpeckleOptics(f_number=16, polarisations=1)])
def test_contrast_and_mean_are_those_of_the_theory(optics):
    factor = np.concatenate([speckle_factor((256, 256), optics, generator(s, "speckle")) for s in range(4)])
    assert factor.min() >= 0
    # 512^2 pixels, of which about every second is independent: 0.4 % for the mean of contrast 0.9
    assert factor.mean() == pytest.approx(1, abs=0.012)
    # pixels are means of 2 to 3 samples an axis instead of integrals: 2-3 % too much; and the sampling, 1 %
    assert factor.std() == pytest.approx(1.025 * contrast_in_theory(optics), rel=0.025)


def test_windows_of_a_tile_fit_together_and_a_moved_tile_is_another_pattern():
    tile = SpeckleTile.make(OPTICS, generator(5, "speckle"), size_px=64)
    whole = tile.window(-10, 50, 100, 120)
    np.testing.assert_array_equal(tile.window(20, 90, 30, 40), whole[30:60, 40:80])
    moved = tile.moved(generator(1, "speckle")).window(-10, 50, 100, 120)
    assert abs(np.corrcoef(moved.ravel(), whole.ravel())[0, 1]) < 0.1  # 64^2 pixels: sigma about 0.02
    # no seam: neighbours across the tile's border are as alike as elsewhere (0.17 for this lens)
    seam = SpeckleTile.make(OPTICS, generator(6, "speckle"), size_px=512)
    left, right = seam.window(0, 511, 512, 1).ravel() - 1, seam.window(0, 512, 512, 1).ravel() - 1
    assert np.mean(left * right) / np.mean(left**2) == pytest.approx(0.17, abs=0.15)  # 512 pairs: 3 sigma


def test_a_line_fluctuates_about_its_mean_and_lies_where_it_was_put():
    centre = np.full(1500, 30.37)
    mean = mean_line_intensity(centre, 60, 5, OPTICS)
    seen = line_intensity(centre, 60, 5, OPTICS, generator(3, "speckle"))
    # 1500 rows of contrast 0.47: 1.5 %, three of them
    np.testing.assert_allclose(seen.mean(axis=0)[24:37], mean.mean(axis=0)[24:37], rtol=0.05)
    columns = np.arange(60) + 0.5
    sharp = mean_line_intensity(centre, 60, 5)
    # corner origin: a shift of half a sample (1/6 pixel) or of half a pixel would show
    assert np.sum(sharp[700] * columns) / np.sum(sharp[700]) == pytest.approx(30.37, abs=1e-3)
    near = np.abs(columns - 30.37) < 12
    weight = mean[700] * near
    assert np.sum(weight * columns) / np.sum(weight) == pytest.approx(30.37, abs=0.01)  # the cut is uneven


def test_grey_values_have_shot_noise_and_an_end():
    flat = np.full((300, 300), 0.5)
    grey = grey_values(flat, GreyValues(peak_dn=200), generator(1, "noise")).astype(float)
    assert grey.mean() == pytest.approx(103, abs=0.05)  # 90 000 pixels of 1.4: 0.005
    expected = 100 * 255 / 13_500 + (13 * 255 / 13_500) ** 2 + 1 / 12
    assert grey.var() == pytest.approx(expected, rel=0.03)  # 90 000 pixels: 0.5 %
    assert grey_values(20 * flat, GreyValues(), generator(1, "noise")).max() == 255
    deep = grey_values(20 * flat, GreyValues(bits=12), generator(1, "noise"))
    assert deep.dtype == np.uint16
    assert deep.max() <= 4095
