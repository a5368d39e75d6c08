"""Speckle factors against the theory of speckle."""

import numpy as np
import pytest
from scipy.special import j1

from thalweg_lab.random_numbers import generator
from thalweg_lab.tank.render import SpeckleOptics, SpeckleTile, speckle_factor

OPTICS = SpeckleOptics()


def contrast_in_theory(optics):
    """Square pixels behind a round pupil: the mean of |2 J1(q) / q|^2 over all pairs of points in a pixel."""
    step = 1 / 200
    d = np.arange(-1, 1 + step / 2, step)
    both = (1 - np.abs(d))[:, None] * (1 - np.abs(d))
    q = 2 * np.pi * optics.cutoff_per_px * np.hypot(d[:, None], d)
    coherence = np.where(q > 0, 2 * j1(q) / np.where(q > 0, q, 1), 1.0)
    return np.sqrt(np.sum(both * coherence**2) * step**2 / optics.polarisations)


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
