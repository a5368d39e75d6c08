"""Statistics and range classes: consistent sigmas are found so, others by their factor; P2 eq. 9 and 10."""

import numpy as np
import pandas as pd
import pytest

from thalweg.accuracy import (
    ALL,
    CLOUD_TO_MESH,
    REGISTERED,
    WITHOUT_OUTLIERS,
    ComparisonSettings,
    by_range_table,
    classes_in_words,
)
from thalweg.accuracy.comparison_tables import (
    BY_RANGE_COLUMNS,
    STATISTICS_COLUMNS,
    parts_in_words,
    statistics_table,
    verdicts,
)
from thalweg.core import frame_of
from thalweg_lab.random_numbers import gauss_markov

TAU_S = 2.0
SETTINGS = ComparisonSettings(correlation_s=TAU_S, reference_sigma_m=0.0)


def survey(
    rng: np.random.Generator, *, factor: float = 1.0, seconds: float = 2000.0, **columns
) -> pd.DataFrame:
    """Ten points a second with a Gauss-Markov error of 2 mm a metre of range, times ``factor``."""
    n = round(10 * seconds)
    t = np.arange(n) / 10.0
    range_m = 25.0 + 15.0 * np.sin(t / 40.0)
    sigma = 0.002 * range_m
    error = factor * sigma * gauss_markov(rng, n, 0.1, 1.0, TAU_S)
    given = {
        "t_gps_s": t,
        "east_m": t,
        "north_m": t * 0,
        "up_m": t * 0,
        "range_m": range_m,
        "distance_m": error,
        "normal_east": t * 0,
        "normal_north": t * 0,
        "normal_up": t * 0 + 1,
        "sigma_normal_m": sigma,
        "sigma_reference_m": t * 0,
        "sigma_3d_m": sigma * np.sqrt(3.0),
        "at_border": t < 0,
        "used": t >= 0,
        "outlier": t < 0,
    } | columns
    return frame_of(CLOUD_TO_MESH, given)


def values(table: pd.DataFrame, points: str = ALL) -> dict[str, float]:
    rows = statistics_table(table, SETTINGS).query("points == @points")
    return dict(zip(rows["quantity"], rows["value"], strict=True))


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_ratios_tell_by_how_much_sigmas_are_wrong(rng, factor):
    table = survey(rng, factor=factor)
    found = values(table)
    assert list(statistics_table(table, SETTINGS).columns) == list(STATISTICS_COLUMNS)
    # 650 independent values know a ratio to 2.8 %, a square to 5.6 %: two and a half of them
    assert found["ratio"] == pytest.approx(1 / factor, rel=0.07)
    assert found["normalised_squared_error"] == pytest.approx(factor**2, rel=0.14)
    assert found["normalised_nmad"] == pytest.approx(factor, rel=0.1)
    # duration over correlation time, less because the errors at long range weigh more
    variance = table["sigma_normal_m"].to_numpy().astype(float) ** 2
    expected = 2000.0 / TAU_S * np.mean(variance) ** 2 / np.mean(variance**2)
    assert found["independent_values"] == pytest.approx(expected, rel=0.01)
    consistent = found["ratio_low95"] < found["ratio"] < found["ratio_high95"]
    assert consistent == (factor == 1.0)
    assert (
        found["consistent_low95"] < found["normalised_squared_error"] < found["consistent_high95"]
    ) == consistent
    (words, _) = verdicts(statistics_table(table, SETTINGS), by_range_table(table, SETTINGS))
    size = f"{1 / found['ratio']:.1f} times as large as predicted"
    assert (size if factor != 1.0 else "sigmas are consistent") in words["sigmas"]
    assert found["ratio_of_middle"] == pytest.approx(1 / factor, rel=0.1)
    assert ("inside" if factor == 1.0 else "outside") in words["parts"]
    assert "tails" not in words["parts"]
    # the errors are correlated over 2 s; 2000 s of them know that to 10 %
    assert found["observed_correlation"] == pytest.approx(TAU_S, rel=0.35)


def test_classes_are_those_of_p2_with_bands_of_their_own(rng):
    table = survey(rng)
    classes = by_range_table(table, SETTINGS).query("points == @ALL")
    assert list(classes.columns) == list(BY_RANGE_COLUMNS)
    assert classes["range_m"].tolist() == list(range(10, 41))
    assert classes["n"].sum() == len(table)
    np.testing.assert_allclose(classes["rmse_predicted_m"], 0.002 * classes["range_m"], rtol=0.03)
    np.testing.assert_allclose(
        classes["rmse_predicted_3d_m"], classes["rmse_predicted_m"] * np.sqrt(3), rtol=1e-5
    )
    np.testing.assert_allclose(classes["ratio"], classes["rmse_predicted_m"] / classes["rmse_observed_m"])
    # the boat stays longest at the nearest and the farthest range: most values there, the narrowest bands
    width = (classes["ratio_high95"] - classes["ratio_low95"]).to_numpy()
    assert width[0] < width[10]
    assert width[-1] < width[20]
    assert classes["independent_values"].sum() < 31 * 100
    assert classes["inside"].dtype == bool


def test_classes_are_inside_their_bands_as_often_as_promised(rng):
    """Eight consistent surveys: 95 % of 248 classes, which share errors; overconfident ones are caught."""
    consistent, wrong = [], []
    for _ in range(8):
        consistent.append(by_range_table(survey(rng), SETTINGS).query("points == @ALL")["inside"].mean())
        wrong.append(
            by_range_table(survey(rng, factor=2.0), SETTINGS).query("points == @ALL")["inside"].mean()
        )
    # classes of one survey are correlated: their shares of 0.95 scatter by some percent
    assert 0.91 < np.mean(consistent) < 0.995
    assert np.mean(wrong) < 0.25


def test_the_reference_is_part_of_the_prediction(rng):
    n = 20_000
    table = survey(rng, sigma_reference_m=np.full(n, 0.05))
    sigma = table["sigma_normal_m"].to_numpy().astype(float)
    found = values(table)
    assert found["predicted_rmse"] == pytest.approx(np.sqrt(np.mean(sigma**2 + 0.05**2)), rel=1e-6)
    # an error of the reference as a whole is one value: the band widens, and the mean is known no better
    shared = ComparisonSettings(correlation_s=TAU_S, reference_sigma_m=0.05)
    rows = statistics_table(table, shared).query("points == @ALL").set_index("quantity")["value"]
    assert rows["independent_values"] < 0.1 * found["independent_values"]
    assert rows["sigma_of_bias"] == pytest.approx(0.05, rel=0.01)
    assert found["sigma_of_bias"] < 0.005


def test_the_predicted_error_of_the_mean_is_met(rng):
    tables = [survey(rng, seconds=100.0) for _ in range(300)]
    found = values(tables[0])
    means = [table["distance_m"].mean() for table in tables]
    # 300 means know their spread to 4 %
    assert np.std(means) == pytest.approx(found["sigma_of_bias"], rel=0.13)


def test_numbers_with_and_without_the_outlier_rule(rng):
    table = survey(rng)
    distance = table["distance_m"].to_numpy().copy()
    wild = np.arange(len(distance)) % 100 == 0
    distance[wild] = 1.5
    distance[np.flatnonzero(wild)[:20]] = -1.5
    table["distance_m"], table["outlier"] = distance, wild
    with_all, without = values(table), values(table, WITHOUT_OUTLIERS)
    assert with_all["n"] == len(table)
    assert without["n"] == len(table) - wild.sum()
    assert with_all["rmse"] > 2 * without["rmse"]
    assert without["outliers"] == wild.sum()
    assert (without["outliers_in_front"], without["outliers_behind"]) == (wild.sum() - 20, 20)
    # in sigmas: five NMAD
    assert without["outlier_limit_high"] == pytest.approx(5.0, rel=0.12)
    both = by_range_table(table, SETTINGS, REGISTERED)
    assert set(both["registration"]) == {REGISTERED}
    assert both.groupby("points")["n"].sum().to_dict() == {ALL: len(table), WITHOUT_OUTLIERS: without["n"]}
    words = verdicts(statistics_table(table, SETTINGS), by_range_table(table, SETTINGS))
    assert [entry["points"] for entry in words] == [ALL, WITHOUT_OUTLIERS]
    assert "more in the middle and far out" in words[0]["normal"]
    assert "31 of 31 range classes are outside their band (10 to 40 m)" in words[0]["classes"]
    assert "about 1.6 are expected there by chance (neighbouring classes share poses)" in words[0]["classes"]
    assert "The tails bring the ratio from" in words[0]["parts"]
    assert "plants and objects that the reference does not have" in words[0]["parts"]
    (fitted, _) = verdicts(statistics_table(table, SETTINGS, REGISTERED), both)
    assert fitted["sigmas"] == "a cloud that was fitted to the reference cannot test its sigmas"
    assert fitted["classes"] == fitted["parts"] == ""


def test_classes_that_say_little_are_counted(rng):
    """A short survey: few independent values a class, most of them where the boat stays longest."""
    table = survey(rng, seconds=500.0)
    classes = by_range_table(table, SETTINGS).query("points == @ALL")
    wide = (classes["ratio_high95"] > 2 * classes["ratio_low95"]) & classes["inside"].astype(bool)
    assert wide.sum() > 5
    assert wide.sum() < classes["inside"].sum()
    assert f"{wide.sum()} have a band wider than a factor of 2" in classes_in_words(classes)
    only = classes[wide]
    assert f"Of the {len(only)} inside, all have" in classes_in_words(only)


def test_a_mean_beyond_its_sigma_is_named(rng):
    table = survey(rng)
    found = values(table)
    parts = parts_in_words(found | {"bias": 2.1 * found["sigma_of_bias"]})
    assert "the mean offset, +" in parts
    assert "beyond 2 sigma" in parts
    assert "within 2 sigma" in parts_in_words(found | {"bias": -1.9 * found["sigma_of_bias"]})


def test_points_that_are_not_used_count_nowhere(rng):
    table = survey(rng)
    table.loc[::2, "used"] = False
    table.loc[::2, "distance_m"] = 99.0
    assert values(table)["n"] == len(table) / 2
    assert values(table)["rmse"] < 0.1
    assert by_range_table(table, SETTINGS).query("points == @ALL")["n"].sum() == len(table) / 2
