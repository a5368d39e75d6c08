"""Points of a cloud in nodes of an octree, coarse to fine."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tests.figures.test_viewer import hills
from thalweg.core import CoverageError
from thalweg.core.geometry import CELLS_BITS, LEAF_POINTS, build_octree, codes_of, grow, octree, parts_of

LAST = 15
"""The finest level: 21 bits of a coordinate less the 6 of the cells."""


def place_on_curve(cell):
    """Digits of a cell of 2^21 along an edge, coarse to fine, each 1 for x + 2 for y + 4 for z."""
    bits = [f"{k:021b}" for k in cell]
    return "".join(str(int(x) + 2 * int(y) + 4 * int(z)) for x, y, z in zip(*bits, strict=True))


def dealt_out(places, leaf, level=0):
    """Key, rows and occupied cells of nodes by level: of each cell the middle point, of a leaf all.

    ``places`` are the digits and rows of the points of one node, in the order of the curve.
    """
    if not places:
        return []
    cells = {}
    for digits, row in places:
        cells.setdefault(digits[: level + CELLS_BITS], []).append((digits, row))
    taken = [inside[len(inside) // 2] for inside in cells.values()]
    if len(places) <= leaf or level == LAST:
        taken = places
    node = (level, places[0][0][:level], [row for _, row in taken], len(cells))
    left = [each for each in places if each not in taken]
    return [node] + [
        deeper
        for child in "01234567"
        for deeper in dealt_out([p for p in left if p[0][level] == child], leaf, level + 1)
    ]


def test_nodes_are_those_of_the_octree_point_by_point(rng, monkeypatch):
    """Few points, so that cells can be counted by hand; in two places more than any cell tells apart."""
    monkeypatch.setattr(octree, "LEAF_POINTS", 5)
    corner, size = np.array([100.0, -7.0, 3.0]), 8.0
    xyz = (
        corner + np.vstack([rng.uniform(0, 1, (120, 3)), rng.uniform(0.3, 0.3001, (40, 3)), np.eye(3)]) * size
    )
    xyz = np.vstack(
        [xyz, corner, np.tile(corner + np.array([2.0, 3.0, 5.0]), (25, 1)), np.tile(corner + 7.9, (4, 1))]
    )
    # the far border lies in the last cell
    cell = np.minimum(np.floor((xyz - corner) / size * 2**21), 2**21 - 1).astype(int)
    places = sorted((place_on_curve(each), row) for row, each in enumerate(cell))
    expected = sorted(dealt_out(places, 5), key=lambda node: node[:2])
    nodes = build_octree(xyz)
    assert [(len(n.key), n.key, n.rows.tolist()) for n in nodes] == [node[:3] for node in expected]
    for node, (level, key, rows, occupied) in zip(nodes, expected, strict=True):
        assert node.size_m == size / 2**level
        steps = [sum(int(d) >> axis & 1 and 2.0 ** -(k + 1) for k, d in enumerate(key)) for axis in range(3)]
        assert node.corner_m.tolist() == pytest.approx(corner + np.multiply(steps, size), abs=1e-12)
        assert node.spacing_m == pytest.approx(size / 2**level / 64 * (occupied / len(rows)) ** 0.5)
    assert max(len(node.key) for node in nodes) == LAST
    # one point has a cube of a centimetre
    assert build_octree(np.zeros((1, 3)))[0].size_m == 0.01


def test_parts_of_a_cloud_grow_into_its_tree(rng):
    """Clumps from a tenth of the cloud to a single place; pieces of any length."""
    low = np.array([0.0, 0.0, 0.0])
    clumps = [(8000, 0.5, 0.3), (70_000, 0.4, 2e-3), (60_000, 0.41, 2e-4), (55_000, 0.8, 0.0)]
    xyz = np.clip(np.vstack([rng.normal(at, sigma, (n, 3)) for n, at, sigma in clumps]), 0, 1)
    code = codes_of(rng.permutation(xyz), low, 1.0)
    parts = parts_of(lambda: iter(np.array_split(code, 3)), 50_000)
    ordered = np.sort(code)
    assert [part.begin for part in parts] == [0, *np.cumsum([part.n for part in parts])[:-1]]
    assert sum(part.n for part in parts) == len(code)
    assert [part.n > 50_000 for part in parts] == [part.level == LAST for part in parts]
    nodes = {}
    for part in parts:
        of = slice(part.begin, part.begin + part.n)
        assert set(ordered[of] >> np.uint64(3 * (21 - part.level))) == {part.cube}
        for level, cube, places, occupied in grow(ordered[of], part):
            node = nodes.setdefault((level, cube), [0, []])
            node[0] += occupied
            node[1] += (places + part.begin).tolist()
    whole = {(level, cube): [n, rows.tolist()] for level, cube, rows, n in grow(ordered)}
    assert whole == {key: node for key, node in nodes.items() if node[1]}
    # of coarse nodes, whose cells hold whole parts, some take points of them one after another
    assert sorted({level for part in parts for level in part.taken}) == list(range(8 - CELLS_BITS + 7))


def test_thinned_to_what_is_asked():
    """64 places in a row, of which the eight of a cell of the second level are eight neighbours."""
    code = np.arange(64, dtype=np.uint64)
    assert octree._thinned(code, 64).tolist() == list(range(64))
    assert octree._thinned(np.repeat(code, 3), 64).tolist() == list(range(1, 192, 3))
    eight = {4 + 8 * k for k in range(8)}
    assert octree._thinned(code, 8).tolist() == sorted(eight)
    assert octree._thinned(code, 12).tolist() == sorted(eight | {0, 21, 41, 63})
    assert set(range(64)) - set(octree._thinned(code, 63).tolist()) < set(range(64)) - eight
    assert octree._thinned(code, 1).tolist() == [32]


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
