"""Cleaning and thinning of reference clouds: what goes, what must stay, consistent sigmas."""

import numpy as np
import pytest

from thalweg.core import GeometryError, InputError
from thalweg.settings.sections import ReferenceSettings
from thalweg.surface import BankFrame
from thalweg.surface.reference import clean_reference, finite_and_single, first_of_equals
from thalweg.surface.thinning import heights_above_envelope, spikes, thin

FLAT = BankFrame(origin_m=np.zeros(3), R_bank_wcs=np.eye(3))
CLEARANCE_M = 0.3


def ground(rng: np.random.Generator, n: int = 60_000, size_m: float = 20.0) -> np.ndarray:
    """Points of gentle ground in the frame of the bank: 3 cm waves, 4 mm of noise."""
    p = rng.uniform(0, size_m, (n, 3))
    p[:, 2] = 0.03 * np.sin(p[:, 0] * 2) * np.cos(p[:, 1] * 3) + rng.normal(0, 0.004, n)
    return p


def kept(points: np.ndarray) -> np.ndarray:
    height = heights_above_envelope(points, clearance_m=CLEARANCE_M)
    return (height <= CLEARANCE_M) & (height >= -2 * CLEARANCE_M)


# ---------------------------------------------------------------- lower envelope


def test_bushes_and_trees_go_and_ground_stays(rng):
    p = ground(rng)
    bush = rng.normal(0, 1, (4000, 3))
    bush = bush / np.linalg.norm(bush, axis=1)[:, None] * 0.8 + [6.0, 6.0, 1.0]
    crown = rng.normal(0, 1.2, (20_000, 3)) + np.array([14.0, 13.0, 7.0])
    trunk = np.column_stack([np.full((800, 2), [14.0, 13.0]), rng.uniform(0, 6, 800)])
    keep = kept(np.concatenate([p, bush, crown, trunk]))
    assert keep[: len(p)].all()
    # below the clearance a bush and a trunk cannot be told from ground: 0.1 of 1.6 m, 0.3 of 6 m
    assert keep[len(p) : len(p) + 4000].mean() < 0.1
    assert keep[len(p) + 4000 : -800].mean() < 0.001
    assert keep[-800:].mean() < 0.08


def test_a_crown_that_hides_the_ground_goes(rng):
    """A cell of the coarsest level that holds nothing but leaves, 6 m above the rest."""
    p = ground(rng)
    p = p[~((abs(p[:, 0] - 10) < 2.5) & (abs(p[:, 1] - 10) < 2.5))]
    crown = rng.uniform([7.5, 7.5, 6.0], [12.5, 12.5, 9.0], (20_000, 3))
    keep = kept(np.concatenate([p, crown]))
    # at the rim of what is hidden the finest cells hold both: the envelope between them is in the air
    assert keep[: len(p)].mean() > 0.99
    assert keep[len(p) :].mean() < 0.02


def test_riprap_stays(rng):
    """Blocks of half a metre side by side, half sunk in: 25 cm high, with gaps down to the ground."""
    p = rng.uniform(0, 15, (80_000, 3))
    from_middle = np.linalg.norm((p[:, :2] + 0.25) % 0.5 - 0.25, axis=1)
    p[:, 2] = np.sqrt(np.maximum(0.25**2 - from_middle**2, 0)) + rng.normal(0, 0.003, len(p))
    assert kept(p).all()
    single = ground(rng)
    d = np.linalg.norm(single[:, :2] - [8.2, 8.3], axis=1)
    block = np.sqrt(np.maximum(0.4**2 - d**2, 0))  # one boulder 0.8 m wide and 0.4 m high
    single[:, 2] = np.maximum(single[:, 2], block)
    # its uppermost part is cut where it stands more than the clearance above all about it
    assert kept(single)[d < 0.4].mean() > 0.5
    assert kept(single)[d >= 0.4].all()


@pytest.mark.parametrize("sign", [-1.0, 1.0], ids=["ridge", "valley"])
def test_edges_of_a_steep_bank_stay(rng, sign):
    """A wall and a meadow, each 45 degrees from the direction of view, meet at an edge."""
    p = rng.uniform(-10, 10, (80_000, 3))
    p[:, 2] = sign * np.abs(p[:, 1]) + rng.normal(0, 0.01, len(p))
    assert kept(p).all()


def test_points_behind_the_surface_go_and_do_not_draw_it_down(rng):
    p = ground(rng)
    mirror = rng.uniform([4.5, 4.5, -9], [5.5, 5.5, -6], (300, 3))  # as dense as the ground there
    height = heights_above_envelope(np.concatenate([p, mirror]), clearance_m=CLEARANCE_M)
    assert (np.abs(height[: len(p)]) < CLEARANCE_M).all()
    assert (height[len(p) :] < -2 * CLEARANCE_M).all()


def test_the_order_of_points_does_not_matter(rng):
    p = ground(rng, 5000)
    order = rng.permutation(len(p))
    one, other = heights_above_envelope(p, clearance_m=0.3), heights_above_envelope(p[order], clearance_m=0.3)
    np.testing.assert_array_equal(one[order], other)


def test_an_endless_raster_is_refused():
    with pytest.raises(GeometryError, match="km2"):
        heights_above_envelope(np.array([[0.0, 0, 0], [90_000.0, 90_000, 0]]), clearance_m=0.3)


# ---------------------------------------------------------------- thinning


@pytest.mark.parametrize("slope", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("density_m2", [100, 1200, 8000])
def test_sigmas_of_vertices_are_consistent(rng, slope, density_m2):
    """A surface rough by 4 mm; a quarter of a point, 3 and 20 points a cell of 5 cm."""
    n = density_m2 * 25
    normal = np.array([-slope, 0.0, 1.0]) / np.hypot(slope, 1)
    p = rng.uniform(0, 5, (n, 3))
    p[:, 2] = slope * p[:, 0]
    p += rng.normal(0, 0.004, (n, 1)) * normal
    thinned = thin(p, 0.05, cubes=False)
    error = thinned.points @ normal
    # of 2000 cells: the RMSE is sure to 1.6 %, the pooled sigmas are not independent; 10 % either way
    assert 0.9 < np.sqrt(np.mean(error**2) / np.mean(thinned.sigma_m**2)) < 1.1
    assert 0.9 < np.sqrt(np.mean((error / thinned.sigma_m) ** 2)) < 1.15
    assert abs(error.mean()) < 4 * 0.004 / np.sqrt(n)
    assert thinned.sigma_m.min() > 0.004 / np.sqrt(thinned.n_merged.max()) / 3
    assert thinned.n_merged.sum() + thinned.n_trimmed == n


def test_a_cell_of_one_point_has_the_scatter_of_its_neighbours(rng):
    p = rng.uniform(0, 2, (16_000, 3))
    p[:, 2] = rng.normal(0, 0.01, len(p))
    p[0] = 0.0  # the cells begin here
    lonely = (np.abs(p[:, :2] - 1.025) < 0.026).all(axis=1)
    thinned = thin(np.concatenate([p[~lonely], [[1.025, 1.025, 0.0]]]), 0.05, cubes=False)
    at = np.argmin(np.linalg.norm(thinned.points[:, :2] - 1.025, axis=1))
    assert thinned.n_merged[at] == 1
    # some 150 points about it: their scatter is known to 6 %
    assert 0.008 < thinned.sigma_m[at] < 0.012


@pytest.mark.parametrize("cubes", [False, True])
def test_grass_does_not_draw_the_ground_outward(rng, cubes):
    """Three of ten points on blades up to 2 dm high: a mean would stand 3 cm off, a median 3 mm."""
    p = rng.uniform(0, 3, (60_000, 3))
    p[:, 2] = rng.normal(0, 0.004, len(p))
    blade = rng.random(len(p)) < 0.3
    p[blade, 2] += rng.uniform(0.02, 0.2, blade.sum())
    thinned = thin(p + np.array([0, 0, 0.2]), 0.4 if cubes else 0.05, cubes=cubes)
    assert p[:, 2].mean() > 0.03
    assert abs(np.median(thinned.points[:, 2]) - 0.2) < 0.005


def test_one_point_a_cell(rng):
    p = ground(rng, 20_000, 3.0)
    thinned = thin(p, 0.1, cubes=False)
    low = p[:, :2].min(axis=0)
    cells = {tuple(c) for c in np.floor((p[:, :2] - low) / 0.1).astype(int).tolist()}
    assert len(thinned.points) == len(cells)
    assert {tuple(c) for c in np.floor((thinned.points[:, :2] - low) / 0.1).astype(int).tolist()} == cells
    np.testing.assert_allclose(np.linalg.norm(thinned.normals, axis=1), 1.0)


def test_blades_are_spikes_and_stones_and_ridges_are_not(rng):
    i, j = np.meshgrid(np.arange(80), np.arange(80), indexing="ij")
    p = np.stack([i * 0.05, j * 0.05, 0.0 * i], axis=-1).reshape(-1, 3) + rng.normal(0, 0.004, (6400, 3))
    blade = rng.choice(6400, 60, replace=False)
    stone = (np.linalg.norm(p[:, :2] - 2.0, axis=1) < 0.3).nonzero()[0]
    blade = blade[~np.isin(blade, stone)]
    p[stone, 2] += 0.25
    p[blade, 2] += 0.15
    found = spikes(p)
    # neighbouring blades protect each other; the corners of a stone's outline may go
    assert found[blade].mean() > 0.95
    assert found[stone].mean() < 0.1
    assert found.sum() == found[blade].sum() + found[stone].sum()
    ridge = p.copy()
    ridge[:, 2] = -1.5 * np.abs(ridge[:, 0] - 2.0)
    assert not spikes(ridge).any()


# ---------------------------------------------------------------- the whole of it


def test_every_point_is_accounted_for(rng):
    p = ground(rng)
    bush = rng.normal(0, 0.3, (2000, 3)) + np.array([6.0, 6.0, 2.0])
    alone = np.array([[5.0, 5.0, 9.0], [12.0, 3.0, 15.0]])
    broken = np.array([[np.nan, 1, 1], [1, np.inf, 1]])
    cloud = clean_reference(
        np.concatenate([p, p[:500], bush, alone, broken]), FLAT, ReferenceSettings(isolated_radius_m=0.4)
    )
    c = cloud.counts
    assert (c["not_finite"], c["duplicates"]) == (2, 500)
    assert c["isolated"] >= 2
    assert 1900 < c["in_front"] <= 2000
    lost = (
        "not_finite",
        "duplicates",
        "isolated",
        "in_front",
        "behind",
        "off_surface",
        "merged",
        "spikes",
        "kept",
    )
    assert sum(c[name] for name in lost) == c["given"] == len(p) + 500 + 2000 + 2 + 2
    assert len(cloud.points_m) == len(cloud.sigma_m) == len(cloud.n_merged) == c["kept"]


def test_isolated_points_and_clearance_can_be_switched_off(rng):
    p = np.concatenate([ground(rng, 5000, 5.0), [[2.0, 2.0, 4.0]]])
    cloud = clean_reference(p, FLAT, ReferenceSettings(isolated_neighbours=0, clearance_m=None, cell_m=0.02))
    assert not {"isolated", "in_front", "behind"} & set(cloud.counts)


def test_repeated_points_are_found_in_any_order(rng):
    p = rng.normal(0, 1, (300, 3))
    again = np.concatenate([p, p[::-1], [[0.0, 0, 0], [-0.0, 0, 0]]])
    first = first_of_equals(again)
    assert first.sum() == 301
    assert first[:300].all()


@pytest.mark.parametrize(
    ("points", "answer"),
    [
        (np.zeros((0, 3)), "0 usable points: 0 given"),
        (np.full((9, 3), np.nan), "9 given, 9 not finite"),
        (np.ones((100, 3)), "1 usable points: 100 given, 0 not finite, 99 duplicates"),
        (np.zeros((4, 2)), "of shape"),
    ],
)
def test_clouds_without_points_are_told(points, answer):
    with pytest.raises(InputError, match=answer):
        finite_and_single(points)


def test_cleaning_that_takes_all_is_told(rng):
    with pytest.raises(InputError, match=r"leaves 0 points .* 200 isolated;.*isolated_radius_m"):
        clean_reference(rng.uniform(0, 100, (200, 3)), FLAT, ReferenceSettings())
