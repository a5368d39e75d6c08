"""What the literature found about single-beam surveys of rivers, asked of a meander whose bed is known.

Krüger et al. (2018) and Santillan et al. (2016): the pattern of the lines matters more than the interpolator,
and kriging is the best of those; Merwade et al. (2006): coordinates along the flow with an anisotropy are at
least 40 % better on a meander than the same range in all directions.
"""

from functools import cache

import numpy as np
import pandas as pd
import pytest

from thalweg.bathymetry import Across, BedModel, CovarianceModel, Drift, FlowLine, Observations, choose_model
from thalweg.bathymetry.kriging import krige
from thalweg.bathymetry.validation import _blocks, _lines, _some, by_class, measures, methods
from thalweg.core import ArrayF
from thalweg.settings.sections import Bathymetry

HALF_M = 12.0
SETTINGS = Bathymetry(model="exponential", drift="none")


def line() -> FlowLine:
    x = np.arange(-40.0, 261.0, 4.0)
    return FlowLine.through(np.column_stack([x, 25 * np.sin(x / 35)]))


def bed_m(s: ArrayF, n: ArrayF) -> ArrayF:
    """A channel whose thalweg wanders, with pools and bars along it."""
    q = (n - 4 * np.sin(s / 45)) / HALF_M
    return -1.8 * (1 - q**2) - 0.4 * np.sin(s / 25) - 0.15 * np.cos(s / 11) * q


def widths(s: ArrayF) -> tuple[ArrayF, ArrayF]:
    return np.full(np.shape(s), HALF_M), np.full(np.shape(s), HALF_M)


@cache
def survey(pattern: str, leg_m: float) -> tuple[Observations, BedModel]:
    """Soundings of a pattern with so much river a leg, and the covariance that those of a zigzag show."""
    s = np.arange(40.0, 280.0, 0.3)
    phase = s / leg_m
    if pattern == "zigzag":
        n = 10.0 * 2 / np.pi * np.arcsin(np.sin(np.pi * phase))
    else:  # from bank to bank, and along it to the next section
        s, n = (
            np.repeat(np.arange(40.0, 280.0, leg_m), 30),
            np.tile(np.linspace(-10, 10, 30), int(np.ceil(240 / leg_m))),
        )
        phase = s / leg_m
    z = bed_m(s, n) + 0.02 * np.random.default_rng(5).standard_normal(len(s))
    data = Observations(
        s_m=s,
        n_m=n,
        height_m=z,
        sigma_white_m=np.full(len(s), 0.02),
        sigma_slow_m=np.zeros(len(s)),
        t_s=np.full(len(s), np.nan),
        line=np.floor(phase + 0.5 * (pattern == "zigzag")).astype(np.int64),
    )
    if (pattern, leg_m) != ("zigzag", 15.0):
        return data, survey("zigzag", 15.0)[1]
    return data, choose_model(data, widths, SETTINGS, slow_time_s=0.0, seed=1)


@cache
def rmse(pattern: str, leg_m: float, method: str = "kriging") -> float:
    """Of the bed within the outermost soundings, metres."""
    data, model = survey(pattern, leg_m)
    s, n = (a.ravel() for a in np.meshgrid(np.arange(45.0, 275.0, 1.7), np.arange(-9.5, 9.6, 0.9)))
    found = methods(model, SETTINGS)[method](data, np.column_stack([s, n]))[0]
    return float(np.sqrt(np.nanmean((found - bed_m(s, n)) ** 2)))


@pytest.mark.parametrize(
    "other",
    ["inverse distance, elliptical", "inverse distance", "triangles", "kriging, same range along and across"],
)
def test_kriging_is_as_good_as_the_others(other):
    assert rmse("zigzag", 15.0) <= 1.05 * rmse("zigzag", 15.0, other)


def test_pattern_and_legs_matter_more_than_the_method():
    """Legs four times as long against the better of two other methods that are in use."""
    of_method = min(rmse("zigzag", 15.0, m) for m in ("inverse distance, elliptical", "triangles"))
    assert rmse("zigzag", 60.0) / rmse("zigzag", 15.0) > of_method / rmse("zigzag", 15.0)


def test_flow_coordinates_with_an_anisotropy_are_40_percent_better_on_a_meander():
    """Against kriging with one range in east and north, its parameters chosen in the same way."""
    data, _ = survey("zigzag", 15.0)
    river = line()
    xy = river.to_map(data.s_m, data.n_m)
    on_map = Observations(
        s_m=xy[:, 0],
        n_m=xy[:, 1],
        height_m=data.height_m,
        sigma_white_m=data.sigma_white_m,
        sigma_slow_m=data.sigma_slow_m,
        t_s=data.t_s,
        line=data.line,
    )
    s, n = (a.ravel() for a in np.meshgrid(np.arange(45.0, 275.0, 1.7), np.arange(-9.5, 9.6, 0.9)))
    places = river.to_map(s, n)
    errors = []
    for range_m in (5.0, 8.0, 12.0, 20.0, 30.0):  # the best of them all is what it is held against
        even = CovarianceModel(
            kind="exponential", sill_m2=0.5, range_s_m=range_m, range_n_m=range_m, micro_m2=1e-4
        )
        errors.append(float(np.sqrt(np.mean((krige(on_map, places, even)[0] - bed_m(s, n)) ** 2))))
    assert rmse("zigzag", 15.0) < 0.6 * min(errors)


def test_a_model_needs_no_banks():
    """Without half widths a place is channel everywhere, and nothing is rougher."""
    data, model = survey("zigzag", 15.0)
    bare = BedModel(
        drift=Drift(kind="none", across=Across()),
        covariance=model.covariance,
        margin=3.0,
        compared={},
        reason="",
    )
    assert (bare.roughness(data.places_m) == 1.0).all()


# ---------------------------------------------------------------- what is left out, and its measures


def test_measures_of_what_was_foretold_by_hand():
    table = pd.DataFrame(
        {
            "up_m": [1.0, 1.0, 1.0, 1.0, 5.0],
            "predicted_m": [1.1, 0.8, 1.0, 1.3, np.nan],
            "sigma_m": [0.1, 0.1, 0.1, np.nan, 0.1],
        }
    )
    found = measures(table)
    assert found == pytest.approx(
        {
            "rmse_m": np.sqrt(0.14 / 4),
            "bias_m": 0.05,
            "normalised_square": 5 / 3,
            "outside_95": 1 / 3,
            "n": 4,
            "not_foretold": 1,
        }
    )
    none = measures(table.assign(predicted_m=np.nan))
    assert (none["n"], none["not_foretold"]) == (0, 5)
    assert np.isnan([none[k] for k in ("rmse_m", "bias_m", "normalised_square", "outside_95")]).all()
    assert np.isnan(measures(table.assign(sigma_m=np.nan))["normalised_square"])


def test_classes_of_what_was_foretold_have_their_limits_and_ten_places():
    distance = np.repeat([0.0, 1.0, 3.9, 16.0], [10, 9, 10, 11])
    table = pd.DataFrame({"distance_m": distance, "up_m": 0.0, "predicted_m": distance, "sigma_m": 1.0})
    found = by_class(table)
    assert {name: each["n"] for name, each in found.items()} == {
        "0 m to 1 m from data": 10,
        "2 m to 4 m from data": 10,
        "16 m to more from data": 11,
    }
    assert found["2 m to 4 m from data"]["bias_m"] == pytest.approx(3.9)
    assert "slope 0.1 to 0.2" in by_class(table.assign(slope=0.1))
    assert set(by_class(table.assign(depth_m=-1.0))) - set(found) == {"0 m to 0.5 m deep"}


def test_lines_and_stretches_that_are_left_out():
    """85 lines of ten places: each third is foretold; of 16 even stretches each second within the ends."""
    s = np.linspace(0.0, 160.0, 850)
    n = len(s)
    data = Observations(
        s_m=s,
        n_m=np.zeros(n),
        height_m=np.zeros(n),
        sigma_white_m=np.full(n, 0.1),
        sigma_slow_m=np.zeros(n),
        t_s=np.full(n, np.nan),
        line=np.repeat(np.arange(85), 10),
    )
    sounding = np.arange(n) != 3
    lines = list(_lines(data, sounding))
    assert [number for number, _, _ in lines] == list(range(0, 85, 3))
    assert [len(at) for _, _, at in lines] == [9] + [10] * 28
    assert lines[1][2].tolist() == list(range(30, 40))
    assert np.flatnonzero(lines[1][1]).tolist() == list(range(30, 40))
    blocks = list(_blocks(data, sounding))
    assert [number for number, _, _ in blocks] == list(range(7))
    for number, out, at in blocks:
        low = 10.0 * (2 * number + 1)
        assert (out == ((s >= low) & (s < low + 10.0))).all()
        assert np.flatnonzero(out).tolist() == at.tolist()
    assert _some(np.ones(450, bool)).tolist() == list(range(0, 450, 3))
