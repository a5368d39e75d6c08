"""No local accuracy dependency: said of white errors, denied of a deformation, and measured beside it."""

import numpy as np
import pytest

from thalweg.accuracy.reference_comparison import (
    PERMUTATIONS,
    SIGNIFICANT,
    Cells,
    _spread,
    cells_of,
    correlogram_of,
    dependency_in_words,
    local_dependency,
    morans_i,
    share_of_variance,
)


def bank(rng: np.random.Generator, n: int) -> np.ndarray:
    """Places on an inclined plane of 80 m by 10 m."""
    along, up = rng.uniform(0, 80, n), rng.uniform(0, 10, n)
    return np.stack([along, -0.87 * up, 0.5 * up], axis=1)


def values(table) -> dict[str, float]:
    once = table[table["distance_m"].isna()]
    return dict(zip(once["quantity"], once["value"], strict=True))


def smooth_field(rng: np.random.Generator, places: np.ndarray, length_m: float) -> np.ndarray:
    """A field of unit variance with correlation exp(-d^2 / (2 L^2)): many waves of random direction."""
    waves = rng.normal(size=(100, 3)) / length_m
    phase = rng.uniform(0, 2 * np.pi, 100)
    return np.sqrt(2 / 100) * np.cos(places @ waves.T + phase).sum(axis=1)


def test_white_errors_depend_on_no_place(rng):
    places = bank(rng, 60_000)
    table = local_dependency(places, 0.05 * rng.normal(size=60_000), seed=1)
    found = values(table)
    assert dependency_in_words(table).startswith("no local accuracy dependency")
    # 60 points a cell: components of variance of white errors scatter by 0.05 %
    assert found["share_of_variance"] < 0.003
    assert found["moran_i_expected"] == pytest.approx(-1 / (found["cells"] - 1))
    assert abs(found["moran_z"]) < 3.5


def test_white_errors_of_uneven_size_and_density_give_even_p_values(rng):
    """Errors grow along the bank by a factor of ten, as with range: still no dependency of their mean."""
    places = bank(rng, 12_000)
    places = places[rng.random(len(places)) < 0.2 + 0.8 * (places[:, 0] / 80)]
    sigma = 0.02 * (1 + 9 * places[:, 0] / 80)
    tests = [local_dependency(places, sigma * rng.normal(size=len(places)), seed=k) for k in range(60)]
    p = np.array([values(table)["moran_p"] for table in tests])
    # 60 even numbers between 0 and 1: their mean scatters by 0.037; a share of 0.05 below 0.05 by 0.028
    assert 0.38 < p.mean() < 0.62
    assert np.mean(p < 0.05) < 0.15
    assert np.mean(p < SIGNIFICANT) < 0.06


def test_a_smooth_deformation_of_3_cm_is_found_and_measured(rng):
    places = bank(rng, 60_000)
    field = 0.03 * np.sin(places[:, 0] / 6.0)
    table = local_dependency(places, field + 0.05 * rng.normal(size=60_000), seed=1)
    found = values(table)
    assert found["moran_p"] == 1 / (PERMUTATIONS + 1)
    # the wave moves little within a cell of 1 m: nearly all of its variance lies between cells
    assert found["std_of_places"] == pytest.approx(np.std(field), rel=0.05)
    assert found["share_of_variance"] == pytest.approx(np.var(field) / (np.var(field) + 0.05**2), rel=0.08)
    words = dependency_in_words(table)
    assert words.startswith("mean distances differ by place, or by the moment at which it was measured")
    assert "; one pass cannot tell the place from the moment. No local dependency of the spread" in words


def test_a_deformation_of_a_millimetre_is_significant_and_negligible(rng):
    places = bank(rng, 300_000)
    values_m = 0.0015 * np.sin(places[:, 0] / 6.0) + 0.05 * rng.normal(size=300_000)
    words = dependency_in_words(local_dependency(places, values_m, seed=1))
    assert words.startswith(
        "a local accuracy dependency of the mean distance that is significant, but negligible"
    )
    assert "of the variance, 1 mm. " in words


def test_the_correlation_length_of_a_known_field(rng):
    """Correlation exp(-d^2 / (2 L^2)) falls to 1/e of that at d_0 where d^2 = 2 L^2 + d_0^2."""
    found, first = [], []
    for _ in range(4):
        places = np.column_stack([rng.uniform(0, 150, 20_000), rng.uniform(0, 60, 20_000), np.zeros(20_000)])
        field = 0.05 * smooth_field(rng, places, 5.0) + 0.005 * rng.normal(size=20_000)
        table = local_dependency(places, field, seed=1, width_m=2.0)
        found.append(values(table)["correlation_length"])
        first.append(table["distance_m"].min())
    # fields of 30 by 12 lengths: four of them know it to about 6 %; classes are 4 m wide
    assert np.mean(found) == pytest.approx(np.sqrt(2 * 5.0**2 + np.mean(first) ** 2), rel=0.15)


def grid(rng: np.random.Generator, size: int = 12) -> Cells:
    x, y = (a.ravel().astype(float) for a in np.meshgrid(range(size), range(size)))
    n = rng.integers(10, 90, size**2)
    return Cells(
        middle_m=np.stack([x, y, 0 * x], axis=1),
        mean_m=np.sin(x / 3) + 0.2 * rng.normal(size=size**2),
        std_m=rng.uniform(0.5, 1.5, size**2),
        n=n,
        width_m=1.0,
        n_left_out=0,
    )


def test_morans_i_is_its_formula(rng):
    cells = grid(rng)
    z = (cells.mean_m - np.average(cells.mean_m, weights=cells.n)) * np.sqrt(cells.n) / cells.std_m
    z -= z.mean()
    distance = np.linalg.norm(cells.middle_m[:, None] - cells.middle_m[None], axis=2)
    w = (distance > 0) & (distance <= 1.6)
    expected = len(z) / w.sum() * (z @ w @ z) / (z @ z)
    observed, _, z_score, p, pairs = morans_i(cells, seed=3)
    assert observed == pytest.approx(expected, rel=1e-12)
    assert pairs == w.sum() / 2
    assert p == 1 / (PERMUTATIONS + 1)
    # normal approximation of the spread without dependency (Cliff and Ord): about 1 / sqrt(pairs)
    assert z_score == pytest.approx((observed + 1 / 143) * np.sqrt(pairs), rel=0.15)
    assert morans_i(cells, seed=3) == morans_i(cells, seed=3)


def test_components_of_variance_of_uneven_cells(rng):
    """One-way random model with known components, cells of 10 to 90 points."""
    shares, stds = [], []
    for _ in range(40):
        n = rng.integers(10, 90, 144)
        cell = np.repeat(np.arange(144), n)
        values_m = 0.02 * rng.normal(size=144)[cell] + 0.04 * rng.normal(size=len(cell))
        mean = np.bincount(cell, values_m) / n
        std = np.sqrt(np.bincount(cell, (values_m - mean[cell]) ** 2) / (n - 1))
        cells = Cells(middle_m=np.zeros((144, 3)), mean_m=mean, std_m=std, n=n, width_m=1.0, n_left_out=0)
        share, place = share_of_variance(cells)
        shares.append(share)
        stds.append(place)
    # 144 places know a variance to 12 %, forty times that to 2 %
    assert np.mean(shares) == pytest.approx(0.2, rel=0.06)
    assert np.mean(stds) == pytest.approx(0.02, rel=0.04)


def test_cells_hold_what_lies_in_them(rng):
    places, values_m = bank(rng, 20_000), rng.normal(size=20_000)
    cells = cells_of(places, values_m)
    assert cells.n.sum() + cells.n_left_out == 20_000
    assert cells.n.min() >= 10
    number = np.floor(places - places.min(axis=0)).astype(int)
    rows = [np.flatnonzero((number == place).all(axis=1)) for place in np.unique(number, axis=0)]
    rows = [row for row in rows if len(row) >= 10]
    assert len(rows) == len(cells.n) > 100
    for k, row in enumerate(rows):
        assert cells.n[k] == len(row)
        np.testing.assert_allclose(cells.middle_m[k], places[row].mean(axis=0))
        assert cells.mean_m[k] == pytest.approx(values_m[row].mean())
        assert cells.std_m[k] == pytest.approx(values_m[row].std(ddof=1))


def cell_of(places: np.ndarray) -> np.ndarray:
    return np.unique(np.floor(places - places.min(axis=0)), axis=0, return_inverse=True)[1].ravel()


def test_places_that_differ_alone_are_no_absence_of_dependency(rng):
    """Offsets of 5 cm, each cell its own: neighbours are not alike, and half the variance is the place's."""
    places = bank(rng, 60_000)
    cell = cell_of(places)
    offset = 0.05 * rng.normal(size=cell.max() + 1)[cell]
    table = local_dependency(places, offset + 0.05 * rng.normal(size=60_000), seed=1)
    # 800 offsets know their variance to 5 %, its share of the whole to 2.5 %
    assert values(table)["share_of_variance"] == pytest.approx(0.5, abs=0.06)
    words = dependency_in_words(table)
    assert words.startswith("places differ (")
    assert "but neighbours are not alike" in words


def test_spread_that_depends_on_the_place_is_found_where_sigmas_do_not_say_it(rng):
    places = bank(rng, 60_000)
    sigma = 0.05 * (1 + 0.4 * np.sin(places[:, 0] / 6.0))
    errors = sigma * rng.normal(size=60_000)
    table = local_dependency(places, errors, seed=1)
    found = values(table)
    assert found["spread_moran_p"] == 1 / (PERMUTATIONS + 1)
    # the wave moves little within a cell of 1 m; its own variation over its mean
    assert found["spread_variation"] == pytest.approx(np.std(sigma) / np.mean(sigma), rel=0.06)
    words = dependency_in_words(table)
    assert words.startswith("no local accuracy dependency of the mean distance")
    assert "The spread depends on the place" in words
    told = local_dependency(places, errors, seed=1, sigma_m=sigma)
    assert "No local dependency of the spread over sigma" in dependency_in_words(told)
    assert values(told)["spread_variation"] < 0.03


def test_the_spread_of_cells_of_uneven_size_by_hand():
    """Values m +- d in cells of 30, 40 and 70 deviate by d / sqrt(1 - 1/n): one-way components of those."""
    n, d = np.array([30, 40, 70]), np.array([0.01, 0.02, 0.04])
    cell = np.repeat(np.arange(3), n)
    places = np.column_stack([10.0 * cell + 0.5, np.full(140, 0.5), np.full(140, 0.5)])
    value = 0.3 * cell + d[cell] * np.where(np.arange(140) % 2, 1, -1)
    for sigma in (None, np.full(140, 4.0)):
        mean = d / np.sqrt(1 - 1 / n) / (1.0 if sigma is None else 4.0)
        whole = np.sum(n * mean) / 140
        size = (140 - np.sum(n**2) / 140) / 2
        variation = np.sqrt(np.sum(n * (mean - whole) ** 2) / 2 / size) / whole
        rows = _spread(places, value, 1.0, sigma, seed=0)
        assert rows[2][2:4] == (3, pytest.approx(variation))
        assert rows[3][2:4] == (3, float(sigma is not None))


def test_spread_of_even_errors_gives_even_p_values(rng):
    """Cells of few and of many points: deviations from the mean of few are smaller; that is allowed for."""
    p = []
    for k in range(60):
        places = bank(rng, 12_000)
        places = places[rng.random(len(places)) < 0.3 + 0.7 * (places[:, 0] / 80)]
        p.append(values(local_dependency(places, rng.normal(size=len(places)), seed=k))["spread_moran_p"])
    # 60 even numbers between 0 and 1: their mean scatters by 0.037
    assert 0.38 < np.mean(p) < 0.62
    assert np.mean(np.array(p) < 0.05) < 0.15


def test_few_cells_are_said_to_be_few(rng):
    places = rng.uniform(0, 3, (2000, 3)) * [1, 1, 0]
    words = dependency_in_words(local_dependency(places, rng.normal(size=2000), seed=1))
    assert words == "not tested: 9 cells with enough points, 30 are needed"


def test_equal_distances_depend_on_nothing(rng):
    table = local_dependency(bank(rng, 30_000), np.full(30_000, 0.02), seed=1)
    assert values(table)["moran_p"] == 1.0
    assert dependency_in_words(table).startswith("no local accuracy dependency")


def test_the_correlogram_of_many_cells_is_that_of_a_sample(rng):
    cells = grid(rng, 60)
    found = correlogram_of(cells, seed=1)
    assert found == correlogram_of(cells, seed=1)
    assert sum(n for _, n, _, _ in found) < 2500 * 2499 / 2
    assert found[0][2] > 0.8
