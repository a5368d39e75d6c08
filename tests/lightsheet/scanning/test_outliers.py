"""Outlier rules: both numbers, the published rule and a robust one (P4 Tables 2 and 3, E28)."""

import numpy as np
import pytest

from thalweg.core import GeometryError
from thalweg.lightsheet.scanning import bimodality, filtered
from thalweg.lightsheet.scanning.distances import TABLE_2, TABLE_3, otsu, statistics_table


def marker_errors(rng: np.random.Generator) -> np.ndarray:
    """Errors like those of P4 Table 2: 1448 of 0.22 mm and 13 gross ones."""
    return np.concatenate([0.22 * rng.standard_normal(1448), np.sign(rng.standard_normal(13)) * 7.6])


def test_the_published_effect_of_thirteen_gross_errors(rng: np.random.Generator) -> None:
    once = filtered(marker_errors(rng))
    # 0.75 = sqrt(0.22^2 + 13/1461 7.6^2); the sample of 1448 is good to 2 %
    assert once.std_mm == pytest.approx(0.75, abs=0.02)
    assert once.limit_mm == pytest.approx(2.24, abs=0.06)
    assert (once.n, once.n_kept) == (1461, 1448)
    assert once.std_kept_mm == pytest.approx(0.22, rel=0.06)


def test_the_rule_decides_about_the_result(rng: np.random.Generator) -> None:
    errors = np.concatenate([marker_errors(rng), 1.0 + 0.3 * rng.random(60)])
    once, again, robust = (filtered(errors, rule) for rule in ("3 sigma", "3 sigma repeated", "robust"))
    # 60 points of 1 mm lie inside 3 x 0.77 mm, and outside what the rest says of itself
    assert once.n_kept == 1508
    assert again.n_kept < 1450
    assert robust.n_kept < 1450
    assert once.std_kept_mm > 1.3 * robust.std_kept_mm
    assert robust.limit_mm == pytest.approx(3 * 0.22, rel=0.12)


def test_tables_hold_the_published_row(rng: np.random.Generator) -> None:
    table = statistics_table(
        {"stepped_object": marker_errors(rng), "bed": rng.standard_normal(50)},
        {"stepped_object": 7, "bed": 3},
    )
    published = table[table["rule"] == "published"]
    assert published[["object", "n", "std_kept_mm"]].to_numpy().tolist() == [["stepped_object", 4656, 0.20]]
    assert len(table) == 7
    for printed in (TABLE_2, TABLE_3):  # three times the printed std, to its rounding
        assert printed["limit_mm"].to_numpy() == pytest.approx(3 * printed["std_mm"].to_numpy(), abs=0.016)


def test_distances_that_are_none_are_refused() -> None:
    with pytest.raises(GeometryError, match="1 of them not finite"):
        filtered(np.array([0.1, np.nan, 0.2, 0.3]))


def test_two_modes_are_found_and_one_is_not(rng: np.random.Generator) -> None:
    dark, bright = 0.1 * rng.standard_normal(900), -0.5 + 0.1 * rng.standard_normal(250)
    peak = np.concatenate([40 + 8 * rng.random(900), 250 + rng.random(250)])
    found = bimodality(np.concatenate([dark, bright]), peak, independent_share=0.2)
    assert found.bimodal
    assert found.by_brightness
    assert found.modes_mm == pytest.approx((-0.5, 0.0), abs=0.03)
    assert found.shares == pytest.approx((250 / 1150, 900 / 1150), abs=0.02)
    assert found.shift_mm == pytest.approx(-0.5, abs=4 * found.sigma_shift_mm)
    assert 48 < found.threshold_dn < 250
    assert "two modes" in found.words()
    for seed in range(20):
        one = np.random.default_rng(seed).normal(0.0, 0.2, 500)
        level = np.random.default_rng(seed + 100).uniform(40, 200, 500)
        answer = bimodality(one, level)
        assert not answer.bimodal
        assert not answer.by_brightness
        assert "one mode" in answer.words()


def test_correlated_neighbours_do_not_make_modes(rng: np.random.Generator) -> None:
    wanders = 0.2 * np.repeat(rng.standard_normal(30), 40)
    alone = bimodality(wanders + 0.02 * rng.standard_normal(1200), 100 + rng.random(1200))
    honest = bimodality(
        wanders + 0.02 * rng.standard_normal(1200), 100 + rng.random(1200), independent_share=1 / 40
    )
    assert honest.bic_gain < alone.bic_gain / 10
    assert not honest.bimodal


def test_otsu_parts_two_classes() -> None:
    threshold, above = otsu(np.array([10.0, 11.0, 12.0, 200.0, 220.0]))
    assert above.tolist() == [False, False, False, True, True]
    assert 12 < threshold < 200


@pytest.mark.parametrize("rule", ["3 sigma", "3 sigma repeated", "robust"])
def test_the_rule_is_about_the_middle_and_not_about_zero(rule) -> None:
    """A reference that lies 10 mm off moves all distances, and changes no verdict on any of them."""
    errors = np.r_[np.tile([-0.2, 0.2], 200), 8.0]
    here, off = filtered(errors, rule), filtered(errors + 10.0, rule)
    np.testing.assert_array_equal(off.kept, here.kept)
    assert off.n_kept == 400
    assert off.centre_mm == pytest.approx(here.centre_mm + 10.0)
    assert off.mean_kept_mm == pytest.approx(10.0)
    assert off.std_kept_mm == pytest.approx(0.2, rel=0.002)  # n - 1 of 400


def test_the_published_tables_are_of_single_profiles_and_of_scans() -> None:
    """P4: Table 2 holds profiles of one line; the scans of Table 3 have 7 and 70."""
    profile = statistics_table({"wreck": np.array([-0.1, 0.0, 0.1])})
    scan = statistics_table({"wreck": np.array([-0.1, 0.0, 0.1])}, {"wreck": 70})
    printed = [table[table["rule"] == "published"].iloc[0] for table in (profile, scan)]
    assert [(row["lines"], row["n"]) for row in printed] == [(1, 1105), (70, 66666)]
    assert TABLE_2["lines"].tolist() == [1, 1]
    assert TABLE_3["lines"].tolist() == [7, 70]
