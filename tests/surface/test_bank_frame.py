"""The frame of a bank: right-handed, toward the boat, not fooled by trees, walls and bends."""

import numpy as np
import pytest

from thalweg.core import GeometryError
from thalweg.surface import BankFrame
from thalweg.surface.meshing import fit_bank, front_direction, thin_track

TRACK = np.column_stack([np.linspace(-40, 40, 200), np.full(200, 15.0), np.zeros(200)])
"""A boat north of a bank whose water line is north = 0: the right bank of a river that flows west."""


def bank(rng: np.random.Generator, n: int, slope_deg: float, *, long_m: float = 60.0) -> np.ndarray:
    """Points of a bank that rises to the south, 10 m along the slope, with 2 cm of roughness."""
    a, u = rng.uniform(-long_m / 2, long_m / 2, n), rng.uniform(0, 10, n)
    t = np.deg2rad(slope_deg)
    rough = rng.normal(0, 0.02, n)
    return np.column_stack([a, -u * np.cos(t) + rough * np.sin(t), u * np.sin(t) + rough * np.cos(t)])


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.rad2deg(np.arccos(np.clip(a @ b, -1, 1))))


def normal_of(slope_deg: float) -> np.ndarray:
    return np.array([0.0, np.sin(np.deg2rad(slope_deg)), np.cos(np.deg2rad(slope_deg))])


@pytest.mark.parametrize("slope_deg", [2.0, 33.0, 70.0, 90.0])
def test_axes_of_a_plain_bank(rng, slope_deg):
    frame = fit_bank(bank(rng, 40_000, slope_deg), TRACK).frame
    # 1 deg: patches are cubes that cut the bank askew, small slices of it are as thick as wide
    assert angle_deg(frame.out, normal_of(slope_deg)) < 1.0
    if slope_deg > 30:  # on flat ground the direction to the river decides, and that is less sharp
        assert angle_deg(frame.along, np.array([-1.0, 0.0, 0.0])) < 1.0
    assert abs(frame.along[2]) < 1e-12
    assert frame.up_slope[2] >= 0
    np.testing.assert_allclose(np.cross(frame.along, frame.up_slope), frame.out, atol=1e-12)


def test_right_is_to_the_right_when_one_looks_at_the_bank():
    frame = BankFrame.of(np.zeros(3), [0.0, 1.0, 0.5], [0.0, 1.0, 0.0])
    np.testing.assert_allclose(frame.along, [-1, 0, 0])  # looking south, west is to the right


def test_coordinates_come_back(rng):
    frame = BankFrame.of([1.0, 2.0, 3.0], [0.3, -0.5, 0.8], [0.0, -1.0, 0.0])
    p = rng.normal(0, 100, (50, 3))
    np.testing.assert_allclose(frame.to_wcs(frame.to_bank(p)), p, atol=1e-10)
    np.testing.assert_allclose(frame.to_bank(frame.origin_m + 2 * frame.out), [0, 0, 2], atol=1e-12)


def test_the_other_bank_looks_the_other_way(rng):
    p = bank(rng, 20_000, 40.0) * [1, -1, 1]
    frame = fit_bank(p, TRACK * [1, -1, 1]).frame
    assert angle_deg(frame.out, normal_of(40.0) * [1, -1, 1]) < 0.5
    assert frame.along[0] > 0.99


def test_trees_and_a_house_do_not_turn_it(rng):
    """As many points in crowns as on the ground, and a wall."""
    ground = bank(rng, 30_000, 33.0)
    tree = rng.uniform(-20, 20, (30, 1)) * [1, 0, 0] + [0, -6, 8]
    leaves = tree[rng.integers(0, 30, 30_000)] + rng.normal(0, 1.2, (30_000, 3))
    wall = np.column_stack([rng.uniform(5, 15, 5000), np.full(5000, -9.0), rng.uniform(6, 11, 5000)])
    frame = fit_bank(np.concatenate([ground, leaves, wall]), TRACK).frame
    # 6 deg: the wall's 50 m2 of 600 m2, 57 deg off, draw by 5 deg; the plane of least squares is 25 deg off
    assert angle_deg(frame.out, normal_of(33.0)) < 6


def test_a_wall_with_a_meadow_is_seen_from_between(rng):
    wall = np.column_stack([rng.uniform(-30, 30, 20_000), np.zeros(20_000), rng.uniform(0, 6, 20_000)])
    meadow = np.column_stack([rng.uniform(-30, 30, 20_000), rng.uniform(-6, 0, 20_000), np.full(20_000, 6.0)])
    fit = fit_bank(np.concatenate([wall, meadow]), TRACK)
    assert angle_deg(fit.frame.out, normal_of(45.0)) < 3
    # patches that hold both lie in between; none is seen on edge
    assert fit.steep_share < 0.01
    assert not fit.vertical


def test_around_a_bend_a_bank_is_seen_from_above(rng):
    """A loop of 200 degrees, its bank 70 degrees steep: no inclined direction shows both its ends."""
    end, slope = np.deg2rad(100), np.deg2rad(70)
    turn, u = rng.uniform(-end, end, 60_000), rng.uniform(0, 8, 60_000)
    radius = 40 + u * np.cos(slope)
    p = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), u * np.sin(slope)])
    t = np.linspace(-end, end, 300)
    track = np.column_stack([30 * np.cos(t), 30 * np.sin(t), 0 * t])
    fit = fit_bank(p, track)
    assert fit.vertical
    np.testing.assert_allclose(fit.frame.out, [0, 0, 1], atol=1e-12)
    assert fit.steep_share < 0.01


def test_front_is_toward_the_nearest_place_of_the_boat():
    front = front_direction([[0.0, 0.0, 5.0], [100.0, 15.0, -3.0], thin_track(TRACK)[40] + [0, 0, 9]], TRACK)
    half = np.sqrt(0.5)
    # 0.01: the track's places are half a metre apart
    np.testing.assert_allclose(front, [[0, half, half], [-half, 0, half], [0, 0, 1]], atol=0.02)
    np.testing.assert_allclose(np.linalg.norm(front, axis=1), 1.0)


def test_a_track_of_a_boat_at_rest_is_thinned():
    track = np.concatenate([np.zeros((1000, 3)), [[3.0, 0, 0]]])
    assert len(thin_track(track)) == 2


@pytest.mark.parametrize("track", [np.zeros((0, 3)), np.full((4, 3), np.nan), np.zeros(3)], ids=str)
def test_a_track_without_places_is_told(track):
    with pytest.raises(GeometryError, match="finite places"):
        front_direction(np.zeros((1, 3)), track)


@pytest.mark.parametrize(
    ("points", "answer"),
    [
        (np.zeros((2, 3)), "a cloud of 2 points"),
        (np.zeros((50, 3)), "a line or a place"),
        (np.linspace(0, 1, 500)[:, None] * [3.0, 4.0, 1.0] + 700.0, "a line or a place"),
    ],
)
def test_a_cloud_without_surface_is_told(points, answer):
    with pytest.raises(GeometryError, match=answer):
        fit_bank(points, TRACK)


def test_few_points_are_enough():
    frame = fit_bank([[0.0, 0, 0], [3.0, 0, 0], [0.0, -1, 1]], TRACK).frame
    assert angle_deg(frame.out, normal_of(45.0)) < 1e-6
