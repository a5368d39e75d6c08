"""Plane polygons: the crossing that is found is one, and none is missed."""

import numpy as np
import pytest

from thalweg.core.geometry import crossing_in_words, first_crossing, polygon_area_m2

SHIFT = np.array([377_000.0, 5_657_000.0])


@pytest.mark.parametrize("shift", [0.0, SHIFT], ids=["local", "map"])
def test_a_bow_crosses_and_a_star_does_not(rng, shift):
    angle = 2 * np.pi * np.arange(40) / 40
    star = rng.uniform(20, 60, (40, 1)) * np.stack([np.cos(angle), np.sin(angle)], axis=1) + shift
    assert first_crossing(star) is None
    swapped = 40.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1) + shift
    swapped[[11, 12]] = swapped[[12, 11]]
    assert first_crossing(swapped) == (10, 12)
    assert "corner 11 to 12" in crossing_in_words(swapped, (10, 12))
    # the last edge takes part too
    assert first_crossing(np.array([[0.0, 0], [4, 0], [0, 4], [4, 4]]) + shift) == (1, 3)


def test_area_does_not_depend_on_place_and_sense():
    bay = np.array([[0.0, 0], [10, 0], [10, 8], [6, 8], [6, 2], [4, 2], [4, 8], [0, 8]])
    for corners in (bay, bay[::-1], bay + SHIFT):
        assert polygon_area_m2(corners) == pytest.approx(68.0, abs=1e-6)
