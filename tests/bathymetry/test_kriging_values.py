"""Kriging of a few soundings, whose answers can be worked out on paper."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from thalweg.bathymetry.kriging import (
    KINDS,
    CovarianceModel,
    Observations,
    krige,
    krige_by_pykrige,
    krige_dense,
)
from thalweg.bathymetry.variogram import BedModel, _by_slope, _thinned
from thalweg.core import GeometryError
from thalweg.settings.sections import Bathymetry

MODEL = {"kind": "exponential", "sill_m2": 1.0, "range_s_m": 30.0, "range_n_m": 15.0}


def observed(places: list[list[float]], height_m: list[float], **changes: object) -> Observations:
    n = len(places)
    columns = np.array(places, dtype=np.float64)
    return Observations(
        **{
            "s_m": columns[:, 0],
            "n_m": columns[:, 1],
            "height_m": np.array(height_m),
            "sigma_white_m": np.full(n, 0.1),
            "sigma_slow_m": np.zeros(n),
            "t_s": 4.0 * np.arange(n),
            "line": np.arange(n),
        }
        | changes
    )


@pytest.mark.parametrize("way", [krige, krige_dense, krige_by_pykrige])
@pytest.mark.parametrize("places", [[[0.0, 0.0], [10.0, 0.0]], [[5.0, -2.5], [5.0, 2.5]]])
def test_half_way_between_two_soundings(way, places):
    """Weights of a half each: sigma^2 = C0 - 2 c(5 m) + (C0 + noise + c(10 m)) / 2; half as far across."""
    data = observed(places, [-2.0, -3.0])
    height, sigma = way(data, np.array([[5.0, 0.0]]), CovarianceModel(**MODEL, micro_m2=0.02))
    assert height[0] == pytest.approx(-2.5, abs=1e-12)
    assert sigma[0] ** 2 == pytest.approx(1 - 2 * np.exp(-0.5) + (1 + 0.03 + np.exp(-1)) / 2, rel=1e-9)


@pytest.mark.parametrize("way", [krige, krige_dense])
@pytest.mark.parametrize(
    ("time_s", "variance_m2", "shared_m2"), [(0.0, 0.04, 0.0), (8.0, 0.04, 0.04 * np.exp(-0.5))]
)
def test_errors_that_last_do_not_average(way, time_s, variance_m2, shared_m2):
    """4 s between the soundings, errors of 0.2 m that last 8 s or not at all."""
    data = observed([[0.0, 0.0], [10.0, 0.0]], [-2.0, -3.0], sigma_slow_m=np.full(2, 0.2))
    _, sigma = way(data, np.array([[5.0, 0.0]]), CovarianceModel(**MODEL, slow_time_s=time_s))
    noise = (0.01 + variance_m2 + shared_m2) / 2
    assert sigma[0] ** 2 == pytest.approx(1 - 2 * np.exp(-0.5) + (1 + np.exp(-1)) / 2 + noise, rel=1e-9)
    # without times each error is of its sounding alone
    alone = observed(
        [[0.0, 0.0], [10.0, 0.0]], [-2.0, -3.0], sigma_slow_m=np.full(2, 0.2), t_s=np.full(2, np.nan)
    )
    _, sigma = way(alone, np.array([[5.0, 0.0]]), CovarianceModel(**MODEL, slow_time_s=time_s))
    assert sigma[0] ** 2 == pytest.approx(1 - 2 * np.exp(-0.5) + (1 + np.exp(-1)) / 2 + 0.025, rel=1e-9)


def test_far_from_all_soundings_is_their_mean_and_more_than_the_sill():
    """Far away the weights are those of the mean: variance C0 + 1 / (1' C^-1 1)."""
    data = observed([[0.0, 0.0], [1e6, 0.0], [2e6, 0.0]], [-1.0, -2.0, -6.0])
    for way in (krige, krige_dense):
        height, sigma = way(data, np.array([[0.0, 1e7]]), CovarianceModel(**MODEL))
        assert height[0] == pytest.approx(-3.0, abs=1e-9)
        assert sigma[0] ** 2 == pytest.approx(1 + 1.01 / 3, rel=1e-9)


def test_correlations_are_those_of_the_models():
    """5 % are left at the practical range; at a half of it (1 + a / 2) exp(-a / 2) and 1 - 3/4 + 1/16."""
    of = {kind: CovarianceModel(**MODEL | {"kind": kind}).correlation for kind in KINDS}
    h = np.array([0.0, 0.5, 1.0, 1.5])
    assert of["exponential"](h) == pytest.approx([1, 0.22313016, 0.04978707, 0.011109], rel=1e-4)
    assert of["matern32"](h) == pytest.approx([1, 0.31458, 0.05, 0.00659], rel=1e-3)
    assert of["spherical"](h) == pytest.approx([1, 0.3125, 0, 0], abs=1e-12)


def test_an_octant_gives_its_nearest_soundings_alone():
    """Three soundings upstream in one octant, one downstream; eight neighbours are one an octant."""
    data = observed([[1.0, 0.1], [2.0, 0.2], [3.0, 0.3], [-9.0, 0.4]], [-1.0, -2.0, -3.0, -4.0])
    cell, of = np.zeros((1, 2)), CovarianceModel(**MODEL)
    for neighbours, taken in ((8, [0, 3]), (16, [0, 1, 3]), (24, [0, 1, 2, 3])):
        found = krige(data, cell, of, neighbours=neighbours)
        expected = krige_dense(data.where(np.array(taken)), cell, of)
        assert found[0] == pytest.approx(expected[0], abs=1e-9)
        assert found[1] == pytest.approx(expected[1], abs=1e-9)


def test_each_octant_is_one_eighth_of_the_circle():
    """A sounding in the middle of each octant and a farther one 10 degrees beside it: the eight near ones."""
    angle = np.deg2rad(22.5 + 45 * np.arange(8))
    near = np.column_stack([2 * np.cos(angle), np.sin(angle)])  # scaled by the ranges 30 and 15: a circle
    far = 2 * np.column_stack([2 * np.cos(angle + 0.17), np.sin(angle + 0.17)])
    heights = np.arange(16.0) ** 2
    data = observed(np.concatenate([near, far]).tolist(), heights.tolist())
    cell, of = np.zeros((1, 2)), CovarianceModel(**MODEL)
    found = krige(data, cell, of, neighbours=8)[0][0]
    assert found == pytest.approx(krige_dense(data.where(slice(0, 8)), cell, of)[0][0], abs=1e-9)


def test_a_line_gives_so_many_soundings_and_no_more():
    data = observed(
        [[1.0, 0.0], [2.0, 0.0], [3.0, 0.0], [0.0, 4.0], [0.0, 5.0]],
        [-1.0, -2.0, -3.0, -4.0, -5.0],
        line=np.array([7, 7, 7, 2, 2]),
    )
    cell, of = np.zeros((1, 2)), CovarianceModel(**MODEL)
    for of_line, taken in ((1, [0, 3]), (2, [0, 1, 3, 4]), (0, [0, 1, 2, 3, 4])):
        found = krige(data, cell, of, octants=False, of_line=of_line)[0][0]
        assert found == pytest.approx(krige_dense(data.where(taken), cell, of)[0][0], abs=1e-9)


def test_soundings_to_foretell_and_those_from_which():
    """Of 3 lines of 500, each second (1500 > 1200); of 3 of 10 all; from 3000 data each second (> 1500)."""
    for each, step, thin in ((500, 2, 1), (10, 1, 1), (1000, 3, 2)):
        data = observed([[0.0, 0.0]] * 3 * each, [0.0] * 3 * each, line=np.repeat([4, 7, 9], each))
        test, train = _thinned(data, np.array([9, 4, 7]), np.random.default_rng(0))
        assert [of.tolist() for of in test] == [list(range(k * each, (k + 1) * each, step)) for k in range(3)]
        assert train.tolist() == list(range(0, 3 * each, thin))


def test_models_without_a_meaning_are_refused():
    for change in ({"sill_m2": 0.0}, {"range_s_m": 0.0}, {"range_n_m": -1.0}, {"micro_m2": -1e-6}):
        with pytest.raises(GeometryError, match="ranges above zero"):
            CovarianceModel(**MODEL | change)
    with pytest.raises(GeometryError, match=r"sigma_white_m: 0 of 3 values .* shape \(3,\)"):
        observed([[0.0, 0.0], [1.0, 0.0]], [1.0, 2.0], sigma_white_m=np.full(3, 0.1))


@pytest.mark.parametrize(("level", "per_slope"), [(0.5, 1.5), (1.6, 0.4)])
def test_level_and_growth_of_errors_are_those_of_left_out_lines(level, per_slope):
    """1,500 lines of two soundings, variances ``level (1 + (per_slope slope)^2)`` times those foretold.

    A line counts as one value: the logarithm of a variance has a sigma of sqrt(2 / 1500) = 0.04 where the
    growth is known, and what is usual draws by a hundredth.
    """
    rng = np.random.default_rng(31)
    slope = rng.uniform(0.0, 2.0, 3000)
    data = observed(
        np.column_stack([np.zeros(3000), slope]).tolist(),
        (np.sqrt(level * (1 + (per_slope * slope) ** 2)) * rng.standard_normal(3000)).tolist(),
        line=np.repeat(np.arange(1500), 2),
    )
    model = SimpleNamespace(
        fitted_to=lambda _: model,
        predict_slope=lambda _, places, **__: (0.0, np.sqrt(0.75), places[:, 1]),
        own_variance=lambda _: 0.25,
    )
    found = _by_slope(cast(BedModel, model), data, np.split(np.arange(3000), 1500), Bathymetry())
    assert found == pytest.approx((level, per_slope), rel=0.15)
