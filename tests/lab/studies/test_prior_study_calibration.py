"""Calibrations with another model than stated: what a study gives, and that wrong sizes show."""

import runpy
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from thalweg_lab.studies import prior_study_calibration as study
from thalweg_lab.studies import prior_study_navigation as navigation
from thalweg_lab.studies.cone_runs import RunSpec

ROOT = Path(__file__).parents[3]


def squares(rows, quantity):
    """Normalised squares of a quantity by model."""
    return {row["model"]: row["nees"] for row in rows if row["quantity"] == quantity}


def test_variants_are_what_the_processing_does_not_know():
    assert len(study.VARIANTS) == 12
    for variant in study.VARIANTS.values():
        if variant.boat is not None:
            RunSpec(**variant.boat)
    # twice what is stated, in degrees
    assert study.VARIANTS["stated_half"].boat["sigma_attitude_deg"] == pytest.approx((0.2, 0.2, 0.4))
    assert study.VARIANTS["times_fifth"].boat == {"position_time_s": 2.0, "attitude_time_s": 4.0}


def test_a_line_that_scatters_twice_as_much_is_noticed():
    wrong = study.VARIANTS["stated_half"].sheet
    runs = [squares(study.light_sheet(wrong, seed), "sheet") for seed in (1, 2, 3)]
    presumed, estimated = (np.mean([run[model] for run in runs]) for model in study.MODELS)
    # all sigmas twice as large; three surveys of five components leave the mean itself open by a half
    assert presumed / estimated == pytest.approx(4.0, rel=0.3)


def test_a_run_gives_a_row_for_each_model_and_quantity():
    rows = study.moving_boat(study.VARIANTS["stated_double"].boat, 1, duration_s=40.0, points=20_000)
    assert [(row["model"], row["quantity"], row["n"]) for row in rows[:4]] == [
        ("presumed", "mount", 6), ("presumed", "lever arm", 3), ("presumed", "tilt", 2),
        ("presumed", "heading", 1),
    ]  # fmt: skip
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
    job = runpy.run_path(str(ROOT / "workflow/scripts/prior_survey.py"))
    job["main"](table=tmp_path / "rows.csv", kind=kind, seed=1)
    assert set(pd.read_csv(tmp_path / "rows.csv")["variant"]) == set(
        navigation.VARIANTS if kind == "navigation" else study.VARIANTS
    )


def test_a_table_names_chain_variant_and_seed(monkeypatch):
    # the run of 150 s is long for a test: the light sheet alone
    monkeypatch.setattr(study, "moving_boat", lambda truth, seed: [])
    table = study.run("heavy_tails", 2)
    assert list(table)[:3] == ["chain", "variant", "seed"]
    assert {"model", "quantity", "nees", "n", "coverage_95", "undetermined"} <= set(table)
    assert set(table["model"]) == set(study.MODELS)
    assert set(table["chain"]) == {"light_sheet"}
