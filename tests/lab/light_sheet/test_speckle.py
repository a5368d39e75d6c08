"""Speckle factors and line images against the theory of speckle."""

import dataclasses

import numpy as np
import pytest
from scipy.special import j1

from tests.lightsheet.laser_images import (
    GreyValues,
    grey_values,
    laser_mosaic,
    line_intensity,
    mean_line_intensity,
    one_sided_halo,
)
from thalweg.core import GeometryError
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
def test_contrast_and_mean_are_those_of_the_theory(optics: SpeckleOptics) -> None:
    factor = np.concatenate([speckle_factor((256, 256), optics, generator(s, "speckle")) for s in range(4)])
    assert factor.min() >= 0
    # 512^2 pixels, of which about every second is independent: 0.4 % for the mean of contrast 0.9
    assert factor.mean() == pytest.approx(1, abs=0.012)
    # pixels are means of 2 to 3 samples an axis instead of integrals: 2-3 % too much; and the sampling, 1 %
    assert factor.std() == pytest.approx(1.025 * contrast_in_theory(optics), rel=0.025)


def test_two_polarisations_are_two_independent_patterns() -> None:
    one = speckle_factor((256, 256), dataclasses.replace(OPTICS, polarisations=1), generator(1, "speckle"))
    two = speckle_factor((256, 256), OPTICS, generator(2, "speckle"))
    assert one.std() / two.std() == pytest.approx(np.sqrt(2), rel=0.03)  # 1 % each from the sampling


def test_the_same_seed_gives_the_same_bytes() -> None:
    first, second = (SpeckleTile.make(OPTICS, generator(5, "speckle"), size_px=64) for _ in range(2))
    assert first.factor.tobytes() == second.factor.tobytes()
    assert first.factor.dtype == np.float32
    line = [line_intensity(np.full(20, 20.0), 40, 4, OPTICS, generator(5, "speckle")) for _ in range(2)]
    assert line[0].tobytes() == line[1].tobytes()


def test_windows_of_a_tile_fit_together_and_a_moved_tile_is_another_pattern() -> None:
    tile = SpeckleTile.make(OPTICS, generator(5, "speckle"), size_px=64)
    whole = tile.window(-10, 50, 100, 120)
    np.testing.assert_array_equal(tile.window(20, 90, 30, 40), whole[30:60, 40:80])
    moved = tile.moved(generator(1, "speckle")).window(-10, 50, 100, 120)
    assert abs(np.corrcoef(moved.ravel(), whole.ravel())[0, 1]) < 0.1  # 64^2 pixels: sigma about 0.02
    # no seam: neighbours across the tile's border are as alike as elsewhere (0.17 for this lens)
    seam = SpeckleTile.make(OPTICS, generator(6, "speckle"), size_px=512)
    left, right = seam.window(0, 511, 512, 1).ravel() - 1, seam.window(0, 512, 512, 1).ravel() - 1
    assert np.mean(left * right) / np.mean(left**2) == pytest.approx(0.17, abs=0.15)  # 512 pairs: 3 sigma


def test_a_line_fluctuates_about_its_mean_and_lies_where_it_was_put() -> None:
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


def test_defocus_widens_a_line_and_keeps_its_light() -> None:
    centre = np.full(120, 60.0)
    sharp = mean_line_intensity(centre, 120, 4, OPTICS)[60]
    soft = mean_line_intensity(centre, 120, 4, dataclasses.replace(OPTICS, defocus_px=10.0))[60]
    assert soft.sum() == pytest.approx(sharp.sum(), rel=1e-6)
    assert soft.max() < 0.85 * sharp.max()


def test_a_halo_keeps_the_light_and_lies_on_one_side() -> None:
    line = mean_line_intensity(np.full(4, 100.0), 200, 4)
    left = one_sided_halo(line, share=0.1, length_px=6)
    assert left.sum() == pytest.approx(line.sum(), rel=1e-6)
    shift = np.sum((left - line)[0] * (np.arange(200) + 0.5)) / line[0].sum()
    # mean of an exponential on the grid of pixels: 1 / (e^(1/6) - 1) = 5.51
    assert shift == pytest.approx(-0.1 * 5.51, abs=0.01)
    np.testing.assert_allclose(
        one_sided_halo(line, share=0.1, length_px=6, to_left=False), left[:, ::-1], atol=1e-12
    )


def test_grey_values_have_shot_noise_and_an_end() -> None:
    flat = np.full((300, 300), 0.5)
    grey = grey_values(flat, GreyValues(peak_dn=200), generator(1, "noise")).astype(float)
    assert grey.mean() == pytest.approx(103, abs=0.05)  # 90 000 pixels of 1.4: 0.005
    expected = 100 * 255 / 13_500 + (13 * 255 / 13_500) ** 2 + 1 / 12
    assert grey.var() == pytest.approx(expected, rel=0.03)  # 90 000 pixels: 0.5 %
    assert grey_values(20 * flat, GreyValues(), generator(1, "noise")).max() == 255
    deep = grey_values(20 * flat, GreyValues(bits=12), generator(1, "noise"))
    assert deep.dtype == np.uint16
    assert deep.max() <= 4095


def test_a_mosaic_of_a_green_laser_is_bright_where_it_is_green() -> None:
    mosaic = laser_mosaic(np.full((4, 4), 103, np.uint8))
    assert mosaic[0, 1] == mosaic[1, 0] == 103
    assert (mosaic[0, 0], mosaic[1, 1]) == (11, 23)


@pytest.mark.parametrize(
    "wrong", [{"f_number": 0.0}, {"polarisations": 3}, {"pixel_um": -1.0}, {"defocus_px": -1.0}]
)
def test_optics_that_do_not_exist_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(GeometryError, match="expected"):
        SpeckleOptics(**wrong)  # type: ignore[arg-type]


def test_a_window_without_frequencies_is_refused() -> None:
    with pytest.raises(GeometryError, match="SpeckleTile"):
        speckle_factor((2, 2), SpeckleOptics(f_number=60), generator(1, "speckle"))
