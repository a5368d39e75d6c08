"""What comes back at a second visit is the place's; what does not is the moment's."""

import numpy as np
import pytest

from thalweg.accuracy.reference_comparison import (
    LEAST_CELLS,
    _visits,
    dependency_in_words,
    independent_cells,
    local_dependency,
    repeated_places,
)
from thalweg.core.geometry import cell_numbers
from thalweg_lab.random_numbers import gauss_markov, generator

TAU_S = 2.0


def two_passes(
    rng: np.random.Generator, *, offset_m: float, pose_m: float = 0.03, n: int = 30_000
) -> tuple[np.ndarray, ...]:
    """A bank of 80 m by 5 m, there and back in 400 s: poses err by ``pose_m`` and in tilt, the lidar by 3 cm.

    Each square metre has an offset of its own of ``offset_m``, the same at both passes.
    """
    t = np.sort(rng.uniform(0.0, 400.0, n))
    share = np.where(t < 200.0, t, 400.0 - t) / 200.0
    places = np.stack([80 * share + rng.normal(0, 3, n), rng.uniform(0, 5, n), np.zeros(n)], axis=1)
    nodes = np.arange(0.0, 400.0, TAU_S / 20)

    def pose(sigma: float) -> np.ndarray:
        return np.interp(t, nodes, gauss_markov(rng, len(nodes), nodes[1], sigma, TAU_S))

    error = pose(pose_m) + pose(0.01) * (places[:, 1] - 2.5) + rng.normal(0, 0.03, n)
    cell = cell_numbers(places, 1.0)
    return places, error + offset_m * rng.normal(size=cell.max() + 1)[cell], t


def repeated(places: np.ndarray, error: np.ndarray, t: np.ndarray):
    return repeated_places(places, error, t, width_m=1.0, correlation_s=TAU_S, least_points=10)


def test_errors_of_poses_do_not_come_back():
    rng = generator(3, "repeated places")
    p = [repeated(*two_passes(rng, offset_m=0.0, n=15_000)).p for _ in range(60)]
    # 60 even numbers between 0 and 1: their mean scatters by 0.037, the share below 0.05 by 0.028;
    # the test is on the safe side, as the number of independent cells is that of noisy maps
    assert 0.38 < np.mean(p) < 0.62
    assert np.mean(np.array(p) < 0.05) < 0.13
    # not so if cells counted as independent: correlations of 0.2 among 375 would be significant
    found = repeated(*two_passes(rng, offset_m=0.0))
    assert 300 < found.n_cells < 420
    assert 8 < found.independent < found.n_cells / 5


def test_offsets_of_places_come_back_with_their_size():
    rng = generator(4, "repeated places")
    found = [repeated(*two_passes(rng, offset_m=0.03)) for _ in range(10)]
    # 370 offsets know their size to 4 %; the moments' means of 2 cm add 5 mm2 by chance in each survey
    assert np.mean([f.std_of_places_m for f in found]) == pytest.approx(0.03, rel=0.08)
    assert max(f.p for f in found) < 0.001


@pytest.mark.parametrize(
    ("offset_m", "wanted"),
    [(0.0, "it is not shown that it is the place"), (0.03, "it is the place, at least in part")],
)
def test_the_words_say_which(offset_m, wanted):
    places, error, t = two_passes(generator(6, "words"), offset_m=offset_m, pose_m=0.1)
    words = dependency_in_words(local_dependency(places, error, seed=1, t_gps_s=t, correlation_s=TAU_S))
    assert words.startswith(("mean distances differ by place, or by the moment", "places differ"))
    assert wanted in words
    once = t < 200.0
    table = local_dependency(places[once], error[once], seed=1, t_gps_s=t[once], correlation_s=TAU_S)
    assert "one pass cannot tell the place from the moment" in dependency_in_words(table)
    assert "repeated_p" not in set(table["quantity"])


def test_visits_are_parted_at_the_longest_pause(rng):
    times = {
        0: [0, 1, 2, 9, 10, 30, 31],
        1: [0, 1, 2, 3, 4, 5, 6],
        2: [0, 50, 51, 52, 70, 71, 72],
        3: [0, 90],
    }
    number = np.concatenate([np.full(len(t), k) for k, t in times.items()])
    t = np.concatenate([np.array(t, dtype=float) for t in times.values()])
    mixed = rng.permutation(len(t))
    cell, start, split, end = _visits(number[mixed], t[mixed], 5.0, 2)
    # one point before 50 s is no visit of cell 2; cell 1 has no pause; cell 3 too few points
    assert cell.tolist() == [0, 2]
    assert (split - start).tolist() == [5, 4]
    assert (end - split).tolist() == [2, 3]


def test_independent_cells_of_known_maps(rng):
    x, y = (a.ravel().astype(float) for a in np.meshgrid(range(24), range(24)))
    middle = np.stack([x, y, 0 * x], axis=1)
    found = []
    for _ in range(20):
        white = rng.normal(size=(2, 576))
        blocks = rng.normal(size=(2, 6, 6)).repeat(4, axis=1).repeat(4, axis=2).reshape(2, 576)
        found.append(
            [
                independent_cells(middle, *(m - m.mean() for m in maps), class_m=2.0)
                for maps in (white, blocks)
            ]
        )
    white_cells, block_cells = np.mean(found, axis=0)
    assert white_cells > 400
    # blocks of 4 by 4 cells: correlation (1 - dx / 4) (1 - dy / 4), the sum of its squares is 2.75^2
    assert block_cells == pytest.approx(576 / 2.75**2, rel=0.15)


def test_too_few_repeated_cells_give_no_answer(rng):
    places = rng.uniform(0, 4, (4000, 3)) * [1, 1, 0]
    found = repeated(places, rng.normal(size=4000), np.linspace(0, 100, 4000) // 50 * 100)
    assert found.n_cells == 16 < LEAST_CELLS
    assert found.correlation is None
