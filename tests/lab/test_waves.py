"""Waves: height and slope as asked for, dispersion, footprint, repeatability."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from thalweg.core import GeometryError
from thalweg_lab.river import Waves
from thalweg_lab.river.waves import angular_frequency


@pytest.fixture(scope="module")
def places():
    rng = np.random.default_rng(1)
    return rng.uniform(-800, 800, 200_000), rng.uniform(-800, 800, 200_000), rng.uniform(0, 900, 200_000)


@pytest.mark.parametrize(("slope", "height"), [(0.04, None), (0.03, 0.003), (0.05, 0.010)])
def test_height_and_slope_are_what_was_asked_for(places, slope, height):
    waves = Waves.draw(7, rms_slope=slope, rms_height_m=height)
    wanted = 0.12 * slope if height is None else height
    assert waves.rms_slope == pytest.approx(slope, rel=1e-9)
    assert waves.rms_height_m == pytest.approx(wanted, rel=1e-6)
    normal = waves.normal(*places)
    gradient = -normal[:, :2] / normal[:, 2:]
    # 200,000 independent samples: sampling error of an rms about 1/sqrt(2 n) = 0.2 %, taken five times.
    assert np.sqrt(np.mean(np.sum(gradient**2, axis=1))) == pytest.approx(slope, rel=0.01)
    assert np.std(waves.height_m(*places)) == pytest.approx(wanted, rel=0.01)


def test_the_normal_is_that_of_the_height(places):
    waves = Waves.draw(3, rms_slope=0.05)
    east, north, t = (a[:500] for a in places)
    h = 1e-5
    gradient = np.stack(
        [
            (waves.height_m(east + h, north, t) - waves.height_m(east - h, north, t)) / (2 * h),
            (waves.height_m(east, north + h, t) - waves.height_m(east, north - h, t)) / (2 * h),
        ],
        axis=1,
    )
    normal = waves.normal(east, north, t)
    # Central differences over 1e-5 m of waves of 5 cm: relative error (k h)^2 / 6 = 3e-7, rounding 1e-10.
    assert_allclose(-normal[:, :2] / normal[:, 2:], gradient, atol=1e-7)
    assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-12)


def test_waves_travel_at_the_speed_of_the_dispersion_relation():
    # Phase speed of a wave of 1 m: sqrt(g / k) = 1.2495 m/s, capillarity adds 0.01 %.
    k = 2 * np.pi
    assert angular_frequency(k) / k == pytest.approx(np.sqrt(9.81 / k), rel=2e-4)
    # The slowest wave on water: 0.23 m/s at 17 mm (Lamb 1932, art. 267).
    lengths = np.geomspace(0.002, 1.0, 20_000)
    speed = angular_frequency(2 * np.pi / lengths) * lengths / (2 * np.pi)
    assert speed.min() == pytest.approx(0.231, abs=0.002)
    assert lengths[np.argmin(speed)] == pytest.approx(0.0171, abs=0.0003)
    waves = Waves.draw(5, rms_slope=0.04)
    assert_allclose(waves.omega_radps, angular_frequency(waves.k_radpm), rtol=1e-12)
    # One wave alone comes to another place after the time that its speed takes.
    one = Waves(
        amplitude_m=np.array([0.01]),
        k_east_radpm=np.array([k]),
        k_north_radpm=np.array([0.0]),
        omega_radps=angular_frequency([k]),
        phase_rad=np.array([0.3]),
    )
    there = one.height_m(np.array([2.0]), np.array([0.0]), 2.0 * k / angular_frequency(k))
    assert_allclose(there, one.height_m(np.array([0.0]), np.array([0.0]), 0.0), atol=1e-12)


def test_a_mirror_and_what_is_refused():
    flat = Waves.draw(1, rms_slope=0.0)
    assert_array_equal(flat.normal(np.zeros(2), np.ones(2), 3.0), [[0, 0, 1], [0, 0, 1]])
    with pytest.raises(GeometryError, match="steeper waves break"):
        Waves.draw(1, rms_slope=0.5)
    with pytest.raises(GeometryError, match=r"rms height 0\.1 m"):
        Waves.draw(1, rms_slope=0.04, rms_height_m=0.1)
    with pytest.raises(GeometryError, match="without slope"):
        Waves.draw(1, rms_slope=0.0, rms_height_m=0.1)
    with pytest.raises(GeometryError, match="or one time"):
        flat.normal(np.zeros(3), np.zeros(3), np.zeros(2))
