"""Cells of equal width: the same as a dictionary of places, and no wrong answer for odd input."""

import numpy as np
import pytest

from thalweg.core import GeometryError
from thalweg.core.geometry import CellGrid, cell_numbers


@pytest.mark.parametrize("k", [2, 3])
def test_numbers_are_those_of_a_dictionary(rng, k):
    points = rng.normal(scale=[5.0, 3.0, 0.7][:k], size=(3000, k)) + 1e4
    found = cell_numbers(points, 0.8)
    places = [tuple(p) for p in np.floor((points - points.min(axis=0)) / 0.8).astype(int).tolist()]
    wanted = {place: number for number, place in enumerate(sorted(set(places)))}
    assert found.tolist() == [wanted[place] for place in places]
    assert np.bincount(found).min() >= 1


def test_other_points_are_found_in_the_same_cells(rng):
    points = rng.uniform(0, 10, (500, 2))
    grid = CellGrid.around(points, 2.0)
    low = points.min(axis=0)
    assert grid.contains(points).all()
    assert grid.keys(low[None] + [[0.1, 0.1], [1.9, 0.1], [0.1, 2.1]]).tolist() == [0, 0, 1]
    assert grid.contains(low[None] + [[-0.1, 1.0], [1.0, 12.1], [1.0, 1.0]]).tolist() == [False, False, True]


def test_one_point_is_one_cell():
    assert cell_numbers(np.array([[3.0, 4.0, 5.0]]), 1.0).tolist() == [0]


def test_what_cannot_be_numbered():
    with pytest.raises(GeometryError, match="0 points to be put into cells"):
        cell_numbers(np.zeros((0, 3)), 1.0)
    with pytest.raises(GeometryError, match="1 of their coordinates not finite"):
        cell_numbers(np.array([[0.0, np.nan, 1.0]]), 1.0)
    # without the check the product of three sizes of 1e9 wraps around, and cells far apart are one
    with pytest.raises(GeometryError, match=r"points over 1e\+09 m in cells of 1 m"):
        cell_numbers(np.array([[0.0, 0.0, 0.0], [1e9, 1e9, 1e9]]), 1.0)
