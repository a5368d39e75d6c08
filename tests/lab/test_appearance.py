"""Colours: band-limited with the mean kept, a function of place alone, wet at the water."""

from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from thalweg_lab.river import Material
from thalweg_lab.river_images import surface_appearance

appearance = partial(surface_appearance, water_level_m=0.0)

GROUND = [Material.BED, Material.GRAVEL, Material.SOIL, Material.GRASS]
UPRIGHT = [Material.STONE, Material.BARK, Material.WALL, Material.ROOF, Material.CONCRETE, Material.WOOD]


def places(n, material, size_m=200.0):
    rng = np.random.default_rng(int(material))
    p = rng.uniform(0, size_m, (n, 3))
    p[:, 2] += 5.0
    normal = [0.0, 0.0, 1.0] if material in GROUND else [0.6, 0.0, 0.8]
    return p, np.tile(normal, (n, 1)), np.full(n, material), np.full(n, 0.5)


def colour(material, footprint_m, n=40_000):
    p, normal, code, same = places(n, material)
    return appearance(p, normal, code, same, np.full(n, footprint_m))[0]


@pytest.mark.parametrize("material", [*GROUND, *UPRIGHT])
def test_detail_fades_out_and_leaves_the_mean(material):
    near, far, farther = (colour(material, f) for f in (0.001, 1.0, 20.0))
    contrast = near.std(axis=0) / near.mean(axis=0)
    # Plaster and concrete are the smoothest: 6 %.
    assert contrast.min() > 0.05
    # Details of half a metre and less are gone at 1 m; patches and stains of some metres stay.
    assert np.all(far.std(axis=0) < 0.85 * near.std(axis=0))
    # The longest spacing is 6 m.
    assert_allclose(farther.std(axis=0), 0.0, atol=1e-12)
    # Constants of the means are rounded and contrast is cut at black: 8 %.
    assert_allclose(farther.mean(axis=0), near.mean(axis=0), rtol=0.08)


@pytest.mark.parametrize("material", [Material.GRAVEL, Material.STONE])
def test_detail_goes_down_to_millimetres(material):
    """Neighbours 2 mm apart differ where the footprint is 1 mm, and are alike where it is 5 cm."""
    p, normal, code, same = places(20_000, material)
    step = np.zeros_like(p)
    step[:, 0] = 0.002
    differ = []
    for f in (0.001, 0.05):
        a, b = (appearance(q, normal, code, same, np.full(len(p), f))[0] for q in (p, p + step))
        differ.append(np.sqrt(np.mean((a - b) ** 2)) / a.mean())
    assert differ[0] > 0.03
    assert differ[1] < 0.25 * differ[0]


def test_a_place_has_one_colour():
    p, normal, code, same = places(5000, Material.GRAVEL)
    f = np.full(len(p), 0.003)
    first = appearance(p, normal, code, same, f)[0]
    order = np.random.default_rng(1).permutation(len(p))
    again = appearance(p[order], normal[order], code, same, f)[0]
    assert_array_equal(again, first[order])
    # The direction that the surface is seen or met from has no say on ground.
    tilted = surface_appearance(p, np.tile([0.6, 0, 0.8], (len(p), 1)), code, same, f, water_level_m=0.0)[0]
    assert_array_equal(tilted, first)


def test_the_relief_bends_normals_about_the_mesh():
    p, normal, code, same = places(20_000, Material.SOIL)
    near = appearance(p, normal, code, same, np.full(len(p), 0.002))[1]
    far = appearance(p, normal, code, same, np.full(len(p), 2.0))[1]
    assert_allclose(np.linalg.norm(near, axis=1), 1.0, atol=1e-12)
    tilt = np.rad2deg(np.arccos(np.clip(np.sum(near * normal, axis=1), -1, 1)))
    assert 3.0 < np.median(tilt) < 30.0
    assert_allclose(far, normal, atol=1e-12)
    # No side is preferred: mean tilt within five standard errors of a few hundred independent clods.
    assert np.all(np.abs(near[:, :2].mean(axis=0)) < 0.02)
