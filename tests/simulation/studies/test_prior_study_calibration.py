"""Calibrations with another model than stated: what a study gives, and that wrong sizes show."""

import numpy as np
import pytest

from thalweg.simulation.studies import prior_study_calibration as study
from thalweg.simulation.studies.cone_runs import RunSpec


def squares(rows, quantity):
    """Normalised squares of a quantity by model."""
    return {row["model"]: row["nees"] for row in rows if row["quantity"] == quantity}


def test_variants_are_what_the_processing_does_not_know():
    names = [variant.name for variant in study.VARIANTS]
    assert len(set(names)) == len(names) == 12
    for variant in study.VARIANTS:
        if variant.boat is not None:
            RunSpec(**variant.boat)
    # twice what is stated, in degrees
    assert study.by_name("stated sigmas half").boat["sigma_attitude_deg"] == pytest.approx((0.2, 0.2, 0.4))
    assert study.by_name("correlation time x 1/5").boat == {"position_time_s": 2.0, "attitude_time_s": 4.0}
    with pytest.raises(KeyError):
        study.by_name("another")


def test_a_line_that_scatters_twice_as_much_is_noticed():
    wrong = study.by_name("stated sigmas half").sheet
    runs = [squares(study.light_sheet(wrong, seed), "sheet") for seed in (1, 2, 3)]
    presumed, estimated = (np.mean([run[model] for run in runs]) for model in study.MODELS)
    # all sigmas twice as large; three surveys of five components leave the mean itself open by a half
    assert presumed / estimated == pytest.approx(4.0, rel=0.3)


def test_a_run_gives_a_row_for_each_model_and_quantity():
    rows = study.moving_boat(study.by_name("stated sigmas double").boat, 1, duration_s=40.0, points=20_000)
    assert [(row["model"], row["quantity"], row["n"]) for row in rows[:4]] == [
        ("presumed", "mount", 6), ("presumed", "lever arm", 3), ("presumed", "tilt", 2),
        ("presumed", "heading", 1),
    ]  # fmt: skip
    assert len(rows) == 8
    assert all(0 <= row["coverage_95"] <= 1 and row["nees"] > 0 for row in rows)
    # two correlation times say nothing of the time of the heading
    assert "heading_time" in rows[-1]["undetermined"]


def test_a_table_names_chain_variant_and_seed(monkeypatch):
    # the run of 150 s is long for a test: the light sheet alone
    monkeypatch.setattr(study, "moving_boat", lambda truth, seed: [])
    table = study.run("heavy tails", 2)
    assert list(table)[:3] == ["chain", "variant", "seed"]
    assert {"model", "quantity", "nees", "n", "coverage_95", "undetermined"} <= set(table)
    assert set(table["model"]) == set(study.MODELS)
    assert set(table["chain"]) == {"light_sheet"}
