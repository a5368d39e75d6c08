"""Points of a cloud in nodes of an octree, coarse to fine."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tests.figures.test_viewer import hills
from thalweg.core import CoverageError
from thalweg.core.geometry import CELLS_BITS, LEAF_POINTS, build_octree


def test_each_point_stands_in_one_node_and_each_node_is_even(rng, monkeypatch):
    monkeypatch.setattr("thalweg.core.geometry.octree._AT_ONCE", 30_000)
    xyz = np.vstack([hills(), rng.normal(0, 0.3, (50_000, 3))])
    nodes = build_octree(xyz, len(xyz))
    rows = np.concatenate([node.rows for node in nodes])
    assert len(np.unique(rows)) == len(rows)
    assert len(xyz) - len(rows) <= 5  # points in one of 2 million cells along an edge
    keys = [node.key for node in nodes]
    assert keys[0] == ""
    assert all(key[:-1] in keys[:i] for i, key in enumerate(keys) if key)
    for node in nodes:
        place = (xyz[node.rows] - node.corner_m) / node.size_m
        assert ((place >= -1e-9) & (place <= 1 + 1e-9)).all()
        cells = np.unique((place * 2**CELLS_BITS).astype(int), axis=0)
        assert node.spacing_m == pytest.approx(
            node.size_m / 64 * np.sqrt(len(cells) / len(node.rows)), rel=0.01
        )
        # one point a cell, or all that are left
        assert len(cells) >= len(node.rows) - 5 or len(node.rows) <= LEAF_POINTS
    # the root alone shows the whole surface: no place is farther from it than two of its cells
    root = xyz[nodes[0].rows, :2]
    assert cKDTree(root).query(rng.uniform(-79, 79, (2000, 2)))[0].max() < 160 / 64 * 2


def test_a_large_cloud_is_thinned_evenly_to_what_is_asked(rng):
    """Ten times as dense in one quarter: thinned, hardly denser than elsewhere."""
    sparse, dense = rng.uniform(-50, 50, (100_000, 3)), rng.uniform(0, 50, (250_000, 3))
    xyz = np.vstack([sparse, dense]) * [1, 1, 0.001]
    nodes = build_octree(xyz, 60_000)
    rows = np.concatenate([node.rows for node in nodes])
    assert 59_000 <= len(rows) <= 60_000
    inside = (xyz[rows, :2] > 0).all(axis=1).mean()
    assert 0.25 < inside < 0.5  # of all points: 0.79
    with pytest.raises(CoverageError, match="a cloud of no points"):
        build_octree(np.empty((0, 3)), 10)
    # or each of them, those at one place too
    whole = build_octree(np.vstack([xyz[:20_000], np.tile(xyz[:1], (20_000, 1))]))
    assert sorted(np.concatenate([node.rows for node in whole])) == list(range(40_000))
