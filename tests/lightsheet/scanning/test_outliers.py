"""Outlier rules: both numbers, the published rule and a robust one (P4 Tables 2 and 3, E28)."""

import numpy as np
import pytest

from thalweg.core import GeometryError
from thalweg.lightsheet.scanning import bimodality, filtered
from thalweg.lightsheet.scanning.distances import (
    TABLE_2,
    TABLE_3,
    MeshDistances,
    _shift,
    border_effect,
    consistency,
    normality,
    otsu,
)


def marker_errors(rng):
    """Errors like those of P4 Table 2: 1448 of 0.22 mm and 13 gross ones."""
    return np.concatenate([0.22 * rng.standard_normal(1448), np.sign(rng.standard_normal(13)) * 7.6])


def test_the_published_effect_of_thirteen_gross_errors(rng):
    once = filtered(marker_errors(rng))
    # 0.75 = sqrt(0.22^2 + 13/1461 7.6^2); the sample of 1448 is good to 2 %
    assert once.std_mm == pytest.approx(0.75, abs=0.02)
    assert once.limit_mm == pytest.approx(2.24, abs=0.06)
    assert (once.n, once.n_kept) == (1461, 1448)
    assert once.std_kept_mm == pytest.approx(0.22, rel=0.06)
    row = once.row()
    assert row["share_kept"] == pytest.approx(1448 / 1461)
    assert "kept" not in row
    assert all(row[name] == getattr(once, name) for name in row if name != "share_kept")


def test_the_rule_decides_about_the_result(rng):
    errors = np.concatenate([marker_errors(rng), 1.0 + 0.3 * rng.random(60)])
    once, again, robust = (filtered(errors, rule) for rule in ("3 sigma", "3 sigma repeated", "robust"))
    # 60 points of 1 mm lie inside 3 x 0.77 mm, and outside what the rest says of itself
    assert once.n_kept == 1508
    assert again.n_kept < 1450
    assert robust.n_kept < 1450
    assert once.std_kept_mm > 1.3 * robust.std_kept_mm
    assert robust.limit_mm == pytest.approx(3 * 0.22, rel=0.12)


def test_published_limits_are_three_times_the_printed_deviation():
    for printed in (TABLE_2, TABLE_3):  # to its rounding
        assert printed["limit_mm"].to_numpy() == pytest.approx(3 * printed["std_mm"].to_numpy(), abs=0.016)


def test_distances_that_are_none_are_refused():
    with pytest.raises(GeometryError, match="1 of them not finite"):
        filtered(np.array([0.1, np.nan, 0.2, 0.3]))


@pytest.mark.parametrize("seed", range(5))
def test_one_mode_is_not_two(seed):
    one = np.random.default_rng(seed).normal(0.0, 0.2, 500)
    level = np.random.default_rng(seed + 100).uniform(40, 200, 500)
    found = bimodality(one, level)
    assert not found.bimodal
    assert not found.by_brightness
    assert "one mode" in found.words()


def test_correlated_neighbours_do_not_make_modes(rng):
    wanders = 0.2 * np.repeat(rng.standard_normal(30), 40)
    alone = bimodality(wanders + 0.02 * rng.standard_normal(1200), 100 + rng.random(1200))
    consistent = bimodality(
        wanders + 0.02 * rng.standard_normal(1200), 100 + rng.random(1200), independent_share=1 / 40
    )
    assert consistent.bic_gain < alone.bic_gain / 10
    assert not consistent.bimodal


@pytest.mark.parametrize("rule", ["3 sigma", "3 sigma repeated", "robust"])
def test_the_rule_is_about_the_middle_and_not_about_zero(rule):
    """A reference that lies 10 mm off moves all distances, and changes no verdict on any of them."""
    errors = np.r_[np.tile([-0.2, 0.2], 200), 8.0]
    here, off = filtered(errors, rule), filtered(errors + 10.0, rule)
    np.testing.assert_array_equal(off.kept, here.kept)
    assert off.n_kept == 400
    assert off.centre_mm == pytest.approx(here.centre_mm + 10.0)
    assert off.mean_kept_mm == pytest.approx(10.0)
    assert off.std_kept_mm == pytest.approx(0.2, rel=0.002)  # n - 1 of 400


def test_spread_counts_one_degree_of_freedom_less():
    """-1, 0 and 1 have a mean square of 2/3, and a standard deviation of 1."""
    for rule in ("3 sigma", "3 sigma repeated", "robust"):
        found = filtered(np.array([-1.0, 0.0, 1.0]), rule)
        assert (found.std_mm, found.std_kept_mm) == pytest.approx((1.0, 1.0))
        assert (found.mean_mm, found.mean_kept_mm) == (0.0, 0.0)
        assert found.nmad_mm == pytest.approx(1.4826, abs=1e-4)


def test_shape_of_distances_by_hand():
    """Of 1, 1, 1, 5: mean 2, variance 3, third moment 6, fourth 21; skewness 2/sqrt(3), kurtosis 7/3."""
    found = normality(np.array([1.0, 1.0, 1.0, 5.0]))
    assert (found["mean_mm"], found["std_mm"], found["nmad_mm"]) == pytest.approx((2.0, 2.0, 0.0))
    assert found["skewness"] == pytest.approx(2 / np.sqrt(3))
    assert found["excess"] == pytest.approx(7 / 3 - 3)
    # fewer than eight free points count as eight: sqrt(6/8) and sqrt(24/8)
    assert found["skewness_sigmas"] == pytest.approx(4 / 3)
    assert found["excess_sigmas"] == pytest.approx((7 / 3 - 3) / np.sqrt(3))
    many = normality(np.tile([1.0, 1.0, 1.0, 5.0], 60), independent_share=0.1)
    assert many["skewness_sigmas"] == pytest.approx(2 / np.sqrt(3) / np.sqrt(6 / 24))
    assert many["excess_sigmas"] == pytest.approx(7 / 3 - 3)
    assert normality(np.array([-2.0, 0.0, 1.0, 1.0, 9.0]))["nmad_mm"] == pytest.approx(1.4826, abs=1e-4)


def flat(distance_mm, border, far):
    n = len(distance_mm)
    return MeshDistances(
        distance_mm=np.array(distance_mm),
        normal=np.tile([0.0, 0.0, 1.0], (n, 1)),
        sigma_own_mm=np.full(n, 2.0),
        sigma_pose_mm=np.full(n, 3.0),
        sigma_shared_mm=np.full(n, 6.0),
        sigma_reference_mm=np.zeros(n),
        at_border=np.array(border),
        far=np.array(far),
    )


def test_what_the_border_of_the_mesh_does_by_hand():
    """1 and 3 inside, 8 at the border; 50 and 60 are far, the last one at the border, too."""
    found = flat([1.0, 3.0, 8.0, 50.0, 60.0], [False, False, True, False, True], [False] * 3 + [True] * 2)
    told = border_effect(found)
    assert (told["n"], told["n_border"]) == (2, 1)
    assert (told["mean_mm"], told["mean_border_mm"], told["mean_with_border_mm"]) == (2.0, 8.0, 4.0)
    assert told["std_mm"] == pytest.approx(np.sqrt(2))
    assert told["std_with_border_mm"] == pytest.approx(np.sqrt(13))
    assert found.counts() == {"points": 5, "far": 2, "at_border": 1, "used": 2}
    alone = border_effect(flat([1.0, 3.0], [False] * 2, [False] * 2))
    assert (alone["n_border"], alone["mean_with_border_mm"]) == (0, 2.0)
    assert np.isnan(alone["mean_border_mm"])
    with pytest.raises(GeometryError, match="1 points off the border"):
        border_effect(flat([1.0, 3.0], [False, True], [False] * 2))


def test_observed_against_predicted_by_hand():
    """3 and 4 with sigmas 1 and 2; the third is left out."""
    d, s = np.array([3.0, -4.0, 100.0]), np.array([1.0, 2.0, 1.0])
    assert consistency(d, s, np.array([True, True, False])) == pytest.approx(
        {"n": 2, "rms_mm": np.sqrt(12.5), "predicted_mm": np.sqrt(2.5), "rms_over_sigma": np.sqrt(6.5)}
    )


def test_modes_far_apart_are_told_apart():
    """100 sigmas: the density of the other mode is no number above zero."""
    step = 0.01 * np.tile([-1.0, 1.0], 50)
    found = bimodality(np.r_[step, 1.0 + step], np.r_[np.full(100, 10.0), np.full(100, 90.0)])
    assert found.bimodal
    assert found.by_brightness
    assert "two modes" in found.words()
    assert found.modes_mm == pytest.approx((0.0, 1.0), abs=1e-9)
    assert found.shares == pytest.approx((0.5, 0.5))
    assert found.sigma_mm == pytest.approx(0.01)
    assert found.ashman == pytest.approx(100.0)
    assert found.shift_mm == pytest.approx(1.0)
    # of 100 points each: variance 1e-4 100/99, over 100, twice
    assert found.sigma_shift_mm == pytest.approx(np.sqrt(2e-4 / 99))
    # geometric mean
    assert found.threshold_dn == pytest.approx(30.0)


def test_bright_points_less_dark_ones_by_hand():
    """Means 2 and 1, variances 1 and 3 of three points each, of which half are independent: 1.5 each."""
    d, bright = np.array([1.0, 2.0, 3.0, 0.0, 0.0, 3.0]), np.arange(6) < 3
    shift, sigma = _shift(d, bright, 0.5)
    assert shift == pytest.approx(1.0)
    assert sigma == pytest.approx(np.sqrt(1 / 1.5 + 3 / 1.5))
    # a share that leaves less than one point counts as one
    assert _shift(d, bright, 0.1)[1] == pytest.approx(2.0)
    found = _shift(d, np.arange(6) < 2, 1.0)
    assert np.isnan(found[0])
    assert found[1] == 0.0


@pytest.mark.parametrize(
    ("values", "cut", "above"),
    [
        pytest.param([1.0, 100.0], 10.0, [False, True], id="the geometric mean of two"),
        pytest.param([5.0], 5.0, [False], id="one"),
        pytest.param(
            [10.0, 11.0, 12.0, 200.0, 220.0],
            np.sqrt(12.0 * 200.0),
            [False] * 3 + [True] * 2,
            id="two classes",
        ),
    ],
)
def test_the_threshold_lies_between_two_classes(values, cut, above):
    found, bright = otsu(np.array(values))
    assert found == pytest.approx(cut)
    assert bright.tolist() == above
