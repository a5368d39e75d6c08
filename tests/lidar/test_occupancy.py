"""The sparse grid of counts: what it promises, whatever the order and the pieces of the cloud."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.spatial import cKDTree

from thalweg.core import GeometryError
from thalweg.lidar import MOST_COUNTED, Occupancy
from thalweg.lidar.filters import CELLS_PER_RADIUS, blocks_within

RADIUS_M = 0.5


def cloud(rng, n=6000):
    """A surface on both sides of the origin with points strewn about it."""
    surface = np.column_stack([rng.uniform(-8, 8, (n, 2)), rng.normal(scale=0.05, size=n)])
    return np.concatenate([surface, rng.uniform(-8, 8, (n // 4, 3))])


def filled(points, use=None, radius_m=RADIUS_M, pieces=1):
    """The counts of points, added in so many pieces."""
    grid = Occupancy(radius_m)
    use = np.ones(len(points), bool) if use is None else np.asarray(use)
    for part in np.array_split(np.arange(len(points)), pieces):
        grid.add(points[part], use[part])
    grid.freeze()
    return grid


def slow_count(points, places, radius_m=RADIUS_M):
    """Points in the cells that the sphere touches: by distance of each place to each cell's box."""
    cell_m = radius_m / CELLS_PER_RADIUS
    cells, n = np.unique(np.floor(points / cell_m), axis=0, return_counts=True)
    low = cells * cell_m
    gap = np.maximum(np.maximum(low - places[:, None], places[:, None] - low - cell_m), 0.0)
    # 1e-9: the grid compares in cells, this in metres
    return ((gap**2).sum(axis=2) <= radius_m**2 + 1e-9) @ np.minimum(n, 255)


def test_counts_are_those_of_the_touched_cells(rng):
    points = cloud(rng)
    grid = filled(points)
    places = np.concatenate([points[::60], rng.uniform(-9, 9, (100, 3))])
    assert grid.reach_m == pytest.approx(1.866 * RADIUS_M, abs=1e-3 * RADIUS_M)
    assert_array_equal(
        grid.neighbours(points[::60]), np.minimum(slow_count(points, points[::60]), MOST_COUNTED) - 1
    )
    expected = np.minimum(slow_count(points, places), MOST_COUNTED)
    assert_array_equal(grid.near(places, enough=MOST_COUNTED), expected)
    for enough in (1, 4, 50):
        assert_array_equal(grid.near(places, enough=enough), np.minimum(expected, enough))


def test_order_and_pieces_do_not_matter(rng):
    points = cloud(rng, 40_000) * 4.0  # enough blocks that the table grows
    use, order = rng.random(len(points)) < 0.7, rng.permutation(len(points))
    whole = filled(points, use)
    assert len(whole._counts) > 4096  # it has grown
    expected = whole.near(points, enough=100)
    for grid in (filled(points[order], use[order], pieces=37), filled(points[use])):
        assert_array_equal(grid.near(points, enough=100), expected)
        assert grid.n_points == use.sum()
    assert_array_equal(whole.near(points[::-1].copy(), enough=100), expected[::-1])


def test_points_that_do_not_count_may_lie_anywhere():
    points = np.array([[0.0, 0, 0], [np.nan, 0, 0], [np.inf, 0, 0], [1e12, 0, 0], [0.1, 0, 0]])
    grid = filled(points, [True, False, False, False, True])
    assert grid.near(points, enough=5).tolist() == [2, 0, 0, 0, 2]
    assert grid.neighbours(points, enough=5).tolist() == [1, 0, 0, 0, 1]


def test_a_crowded_cell_does_not_overflow():
    grid = filled(np.full((500, 3), 0.1), pieces=5)
    assert grid.near([[0.1, 0.1, 0.1]], enough=MOST_COUNTED).tolist() == [MOST_COUNTED]
    assert grid.n_points == 500


@pytest.mark.parametrize("bad", [np.nan, np.inf, -2.0e6])
def test_a_counted_point_without_a_place_is_refused(bad):
    with pytest.raises(GeometryError, match=r"a point at \[0.0, (nan|inf|-2000000.0), 0.0\] m.*trajectory"):
        Occupancy(RADIUS_M).add([[0.0, 0.0, 0.0], [0.0, bad, 0.0]])


def test_wrong_use_is_refused():
    grid = Occupancy(RADIUS_M)
    with pytest.raises(GeometryError, match=r"expected \(n, 3\) points and \(n,\) where"):
        grid.add(np.zeros((3, 3)), [True])
    with pytest.raises(GeometryError, match=r"points of shape \(3, 2\)"):
        grid.add(np.zeros((3, 2)))
    # an answer before the last point would depend on the pieces of the cloud
    with pytest.raises(RuntimeError, match="after freeze"):
        grid.near(np.zeros((1, 3)), enough=1)
    grid.freeze()
    with pytest.raises(RuntimeError, match="frozen"):
        grid.add(np.zeros((1, 3)))
    for enough in (0, 255):
        with pytest.raises(GeometryError, match="1 to 254"):
            grid.near(np.zeros((1, 3)), enough=enough)
    for radius in (0.0, -1.0, np.nan):
        with pytest.raises(GeometryError, match="a positive number"):
            Occupancy(radius)


def test_memory_follows_the_surface_not_the_points(rng):
    points = rng.random((550_000, 3)) * [20.0, 20.0, 0.0]
    few, many = filled(points[:50_000]), filled(points[50_000:], pieces=10)
    assert many.n_bytes <= 1.1 * few.n_bytes


def test_grids_of_parts_add_up_to_that_of_all(rng):
    points = rng.normal(0.0, 30.0, (60_000, 3)) * [1.0, 1.0, 0.2]
    points[:400] = [5.0, -7.0, 1.0]  # more than a cell can count, in several parts
    whole, joined = Occupancy(0.5), Occupancy(0.5)
    whole.add(points)
    for part in np.array_split(rng.permutation(points), 3):
        grid = Occupancy(0.5)
        grid.add(part)
        joined.add_blocks(*grid.blocks())
    for mine, other in zip(joined.blocks(), whole.blocks(), strict=True):
        assert_array_equal(mine, other)
    # of a box only what touches it is needed, with the reach of the question about it
    low, high = np.array([-10.0, -20.0]), np.array([15.0, 4.0])
    keys, counts = whole.blocks()
    near = blocks_within(keys, whole.cell_m, low - whole.reach_m, high + whole.reach_m)
    assert 0 < near.sum() < 0.2 * len(keys)
    some = Occupancy(0.5)
    some.add_blocks(keys[near], counts[near])
    for grid in (whole, some):
        grid.freeze()
    inside = points[((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1)]
    assert_array_equal(some.near(inside, enough=200), whole.near(inside, enough=200))
    assert some.near(points[:1], enough=254)[0] == 254
    with pytest.raises(RuntimeError, match="frozen"):
        some.add_blocks(keys, counts)


def test_no_neighbour_within_the_radius_is_missed_and_none_beyond_the_reach_counts(rng):
    points = cloud(rng, 3000)
    grid = filled(points)
    found = grid.neighbours(points)
    tree = cKDTree(points)
    at_least = tree.query_ball_point(points, RADIUS_M, return_length=True) - 1
    at_most = tree.query_ball_point(points, grid.reach_m, return_length=True) - 1
    assert (found >= np.minimum(at_least, MOST_COUNTED - 1)).all()
    assert (found <= at_most).all()
    assert grid.reach_m == pytest.approx(1.866 * RADIUS_M, abs=1e-3 * RADIUS_M)
    # the bounds are no empty words: both numbers differ for most points
    assert np.mean(at_least < at_most) > 0.5
