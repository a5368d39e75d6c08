"""Calibrations with another model than stated: what a study gives, and that wrong sizes show."""

import numpy as np
import pytest
from scipy.stats import chi2

from thalweg.core import read_parquet
from thalweg_lab.studies import Batch, prior_study as navigation, prior_study as study, run_seeds
from thalweg_lab.studies.cone_runs import RunSpec
from thalweg_lab.studies.prior_study import STUDY


def squares(rows, quantity):
    """Normalised squares of a quantity by model."""
    return {row["model"]: row["nees"] for row in rows if row["quantity"] == quantity}


def test_variants_are_what_the_processing_does_not_know():
    assert len(study.CALIBRATION_VARIANTS) == 12
    for variant in study.CALIBRATION_VARIANTS.values():
        if variant.boat is not None:
            RunSpec(**variant.boat)
    # twice what is stated, in degrees
    assert study.CALIBRATION_VARIANTS["stated_half"].boat["sigma_attitude_deg"] == pytest.approx(
        (0.2, 0.2, 0.4)
    )
    assert study.CALIBRATION_VARIANTS["times_fifth"].boat == {"position_time_s": 2.0, "attitude_time_s": 4.0}


def test_a_line_that_scatters_twice_as_much_is_noticed():
    wrong = study.CALIBRATION_VARIANTS["stated_half"].sheet
    runs = [squares(study.light_sheet(wrong, seed), "sheet") for seed in range(1, 7)]
    presumed, estimated = (np.mean([run[model] for run in runs]) for model in study.MODELS)
    # six surveys of five components: 95 % of the means of consistent covariances
    low, high = chi2.ppf([0.025, 0.975], 30) / 30
    assert presumed > high
    assert low < estimated < high


def test_the_light_sheet_errs_by_everything_that_its_covariance_counts():
    # depths of the levels and shift of the ends too: without them the mean is 0.4
    rows = [squares(study.light_sheet({}, seed), "sheet")["presumed"] for seed in range(11, 17)]
    low, high = chi2.ppf([0.025, 0.975], 30) / 30
    assert low < np.mean(rows) < high


def test_a_run_gives_a_row_for_each_model_and_quantity():
    rows = study.moving_boat(
        study.CALIBRATION_VARIANTS["stated_double"].boat, 1, duration_s=40.0, points=20_000
    )
    assert [(row["model"], row["quantity"], row["n"]) for row in rows[:4]] == [
        ("presumed", "mount", 6),
        ("presumed", "lever arm", 3),
        ("presumed", "tilt", 2),
        ("presumed", "heading", 1),
    ]
    assert len(rows) == 8
    assert all(0 <= row["coverage_95"] <= 1 and row["nees"] > 0 for row in rows)
    # two correlation times say nothing of the time of the heading
    assert "heading_time" in rows[-1]["undetermined"]


@pytest.mark.parametrize("kind", ["calibration", "navigation"])
def test_the_job_of_a_survey_takes_all_variants(kind, monkeypatch, tmp_path):
    # the calibrations and chains themselves are long
    monkeypatch.setattr(study, "moving_boat", lambda truth, seed: [{"chain": "moving_boat", "nees": 1.0}])
    monkeypatch.setattr(study, "light_sheet", lambda truth, seed: [])
    error = navigation.Processed(error=np.ones((3, 6)), cov=np.tile(np.eye(6), (3, 1, 1)))
    monkeypatch.setattr(navigation, "survey_of", lambda variant, seed, duration_s: None)
    monkeypatch.setattr(navigation, "processed", lambda survey, *, estimate: {"fused": error})
    run_seeds(STUDY, Batch(kind=kind, seeds=(1,)), {}, tmp_path / "rows")
    assert set(read_parquet(tmp_path / f"rows/{kind}.parquet")["variant"]) == set(
        navigation.VARIANTS if kind == "navigation" else study.CALIBRATION_VARIANTS
    )


def test_a_table_names_chain_variant_and_seed(monkeypatch):
    # the run of 150 s is long for a test: the light sheet alone
    monkeypatch.setattr(study, "moving_boat", lambda truth, seed: [])
    table = study.run_calibration("heavy_tails", 2)
    assert list(table)[:3] == ["chain", "variant", "seed"]
    assert {"model", "quantity", "nees", "n", "coverage_95", "undetermined"} <= set(table)
    assert set(table["model"]) == set(study.MODELS)
    assert set(table["chain"]) == {"light_sheet"}
