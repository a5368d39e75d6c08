"""Satellites above the boat, what hides them, and which kind of solution is left."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.lab.conftest import FRAME, SEED
from tests.lab.sheets import GROUND, scene_of, sheet
from thalweg_lab.instruments import Solution
from thalweg_lab.instruments.gnss import (
    Constellation,
    SkyView,
    dilution,
    look_at_sky,
    multipath_share,
    solutions,
)
from thalweg_lab.river import Material
from thalweg_lab.settings import TwinConfig

T0 = 304_800_000.0
GNSS = TwinConfig.of_size("tiny", gnss={"shadow": True}).gnss


def test_some_twenty_satellites_cross_the_sky_slowly():
    t = T0 + np.arange(0, 7200, 60.0)
    low = np.sin(np.deg2rad(10.0))
    for seed in range(5):
        sky = Constellation.draw(seed)
        e = sky.directions_wcs(FRAME, t)
        assert_allclose(np.linalg.norm(e, axis=-1), 1.0, atol=1e-12)
        above = e[..., 2] > low
        assert above.sum(axis=1).min() >= 14
        assert above.sum(axis=1).max() <= 30
        assert {0, 1, 2} == set(sky.system[above[0]].tolist())
        # Medium orbits: half a degree a minute at most (12 h period, and 1.35 times that seen from below).
        step = np.rad2deg(np.arccos(np.clip(np.sum(e[1:] * e[:-1], axis=-1), -1, 1)))
        assert 0.1 < np.median(step[above[1:]]) < 0.65
        # Orbits of 55 to 65 degrees: nothing in the low north, but the passes of GLONASS across the pole.
        azimuth = np.rad2deg(np.arctan2(e[..., 0], e[..., 1]))
        elevation = np.rad2deg(np.arcsin(e[..., 2]))
        gap = (np.abs(azimuth) < 20) & (elevation > 15) & (elevation < 35) & (sky.system == 0)
        assert not gap.any()


def test_periods_and_radii_of_the_orbits():
    sky = Constellation.draw(1)
    r = np.linalg.norm(sky.ecef_m(np.array([0.0])), axis=-1)[0]
    assert_allclose(r, sky.axis_m, rtol=1e-12)
    # Half a sidereal day for GPS: after a whole one a satellite is back over the same place.
    day = 86_164.0905
    there = sky.ecef_m(np.array([T0, T0 + day]))[:, sky.system == 0]
    # The nominal axis allows for the flattening of the Earth, these orbits do not: 39 km after two turns.
    assert np.linalg.norm(there[1] - there[0], axis=-1).max() < 60_000.0
    inclination = np.rad2deg(
        np.arcsin(np.abs(sky.ecef_m(T0 + np.arange(0, 60_000, 100.0))[..., 2]).max(0) / r)
    )
    assert_allclose(inclination, np.array([55.0, 64.8, 56.0])[sky.system], atol=0.1)


def test_dilution_of_a_geometry_that_one_can_reckon():
    """One satellite in the zenith, three on the horizon: E^2 = N^2 = 2/3, U^2 = 4/3."""
    a = np.deg2rad([0.0, 120.0, 240.0])
    e = np.concatenate([[[0.0, 0.0, 1.0]], np.stack([np.sin(a), np.cos(a), np.zeros(3)], axis=1)])[None]
    one = dilution(e, np.zeros(4, dtype=int), np.ones((1, 4)))
    assert_allclose(one[0] ** 2, [2 / 3, 2 / 3, 4 / 3], rtol=1e-6)
    # A quarter of the weight doubles all; the zenith's satellite alone in its system says nothing of height.
    quarter = dilution(e, np.zeros(4, dtype=int), np.full((1, 4), 0.25))
    assert_allclose(quarter, 2 * one, rtol=1e-6)
    assert dilution(e, np.array([1, 0, 0, 0]), np.ones((1, 4)))[0, 2] > 1000.0
    assert dilution(e, np.zeros(4, dtype=int), np.array([[1.0, 1.0, 1.0, 0.0]]))[0].max() > 1000.0


def test_what_blocks_what_dims_and_what_reflects():
    t, place = np.array([T0]), np.array([[0.0, 0.0, 1.0]])

    def look(*parts):
        return look_at_sky(GNSS, SEED, FRAME, scene_of(GROUND, *parts), t, place)

    e = Constellation.draw(SEED).directions_wcs(FRAME, t)[0]
    up = e[:, 2] > np.sin(np.deg2rad(10.0))
    n = int(up.sum())
    free = look()
    assert (free.free[0], free.dimmed[0], free.blocked[0], free.reflected[0]) == (n, 0, 0, 0)
    assert_array_equal(free.growth, np.ones((1, 3)))
    # A wall in the east, 5 m away, 400 m long and as high as it likes.
    east = sheet([5, 0, 0], [0, 400, 0], [0, 0, 400])
    behind = int(np.sum(up & (e[:, 0] > 0) & (np.abs(e[:, 1]) < 80 * e[:, 0]) & (e[:, 2] < 79.8 * e[:, 0])))
    assert 3 < behind < n
    for kind, where in ((Material.WALL, "blocked"), (Material.WOOD, "blocked"), (Material.LEAF, "dimmed")):
        view = look((east, kind))
        assert getattr(view, where)[0] == behind
        assert view.free[0] == n - behind
        assert (view.growth > 1.0).all()
    hidden = look((east, Material.WALL), (sheet([6, 0, 0], [0, 400, 0], [0, 0, 400]), Material.LEAF))
    assert (hidden.blocked[0], hidden.dimmed[0]) == (behind, 0), "blocked wins over dimmed"
    # Water 2 m below: every satellite below 30 degrees is mirrored, but not where a wall hides the mirror.
    water = (sheet([0, 0, -1.0], [300, 0, 0], [0, 300, 0]), Material.WATER)
    low = int(np.sum(up & (e[:, 2] < 0.5)))
    wet = look(water)
    assert wet.reflected[0] == low > 2
    assert wet.free[0] == n, "water below the antenna hides no satellite"
    low_west = int(np.sum(up & (e[:, 2] < 0.5) & (e[:, 0] < 0)))
    assert look(water, (sheet([0.5, 0, 0], [0, 400, 0], [0, 0, 400]), Material.WALL)).reflected[0] == low_west
    assert multipath_share(wet)[0] == pytest.approx(0.2 * low / n)


@pytest.mark.parametrize(
    ("free", "dimmed", "blocked", "pdop", "kind"),
    [
        (6, 0, 0, 2.9, "FIXED"),
        (6, 0, 0, 3.1, "FLOAT"),
        (5, 3, 0, 2.0, "FLOAT"),
        (0, 5, 0, 9.9, "FLOAT"),
        (9, 4, 5, 2.0, "FIXED"),
        (9, 4, 6, 2.0, "FLOAT"),
        (9, 10, 0, 2.0, "FLOAT"),
        (5, 0, 0, 10.1, "SINGLE"),
        (4, 0, 0, 2.0, "SINGLE"),
        (2, 2, 20, 29.0, "SINGLE"),
        (4, 0, 0, 31.0, "NONE"),
        (3, 0, 0, 1.0, "NONE"),
        (12, 0, 0, 31.0, "NONE"),
    ],
)
def test_thresholds_of_the_solutions(free, dimmed, blocked, pdop, kind):
    none = np.zeros(1, dtype=np.int64)
    view = SkyView(
        t_gps_s=np.array([T0]),
        free=none + free,
        dimmed=none + dimmed,
        blocked=none + blocked,
        reflected=none,
        dilution=np.full((1, 3), pdop / np.sqrt(3)),
        growth=np.ones((1, 3)),
    )
    found = solutions(view, 10.0, both_ways=False)
    assert Solution(int(found[0])).name == kind
