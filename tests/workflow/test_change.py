"""Two epochs from logs to the page of change, and what it says against the truth."""

import json

import numpy as np
import pandas as pd
import pytest

from thalweg.cli import main

pytestmark = pytest.mark.workflow

FOLDER = "results/tiny_change/deformation"


@pytest.fixture(scope="module")
def changed(house_builder, repository, tmp_path_factory):
    """Folder of the results of `tiny_change`."""
    house = house_builder(repository, tmp_path_factory.mktemp("change"))
    house.snakemake("--config", "campaign=tiny_change")
    return house.root / FOLDER


def test_sigmas_agree_with_the_truth(changed) -> None:
    found = pd.read_csv(changed / "truth_1-2.csv").set_index("measure")["value"]
    # one pair: errors that the whole bank shares leave a wide band; the study of many pairs is the proof
    assert 0.3 < found["normalised_square_unchanged"] < 2.5
    assert 0.3 < found["normalised_square_changed"] < 2.5
    assert found["false_alarm_95"] < 0.15
    assert found["specificity"] >= 0.97
    assert found["sensitivity_0.1_m"] >= 0.72
    assert found["false_discovery"] <= 0.06
    assert abs(found["net_volume_error_over_sigma"]) < 3.0
    assert found["largest_retreat_measured_m"] == pytest.approx(found["largest_retreat_true_m"], abs=0.2)


def test_nothing_unseen_is_called_eroded(changed) -> None:
    table = pd.read_parquet(changed / "changes_1-2.parquet")
    seen = pd.read_parquet(changed / "visibility_1-2.parquet")
    unseen = table["distance_m"].isna().to_numpy()
    called = table["state"].isin(["erosion", "deposition"]).to_numpy()
    assert unseen.any()
    free = (seen["reason_1"] == "free space") | (seen["reason_2"] == "free space")
    assert free.to_numpy()[unseen & called].all()
    reasons = set(seen["reason_1"]) | set(seen["reason_2"])
    assert "water" in reasons  # the second epoch was drier


def test_four_patches_are_found_with_their_sign_and_size(changed) -> None:
    patches = pd.read_csv(changed / "patches_1-2.csv")
    large = patches[patches["area_m2"] > 15.0]
    for what, size in (("erosion", 0.2), ("erosion", 0.1), ("deposition", 0.2), ("deposition", 0.1)):
        off = (large.loc[large["what"] == what, "mean_distance_m"].abs() - size).abs()
        assert off.min() < 0.05, (what, size)


def test_parts_of_sigma_add_up(changed) -> None:
    table = pd.read_parquet(changed / "changes_1-2.parquet").dropna(subset=["distance_m"])
    parts = table[["sigma_field_m", "sigma_white_m", "sigma_registration_m"]].to_numpy()
    assert np.sqrt((parts**2).sum(axis=1)) == pytest.approx(table["sigma_m"].to_numpy())
    # errors that points share are the larger part on ground that many points cover
    assert np.median(table["sigma_field_m"] / table["sigma_white_m"]) > 2.0


def test_the_registration_says_what_the_ground_does_not_show(changed) -> None:
    facts = json.loads((changed / "registration_1-2.json").read_text())
    lost = np.array(facts["not_shown"])
    assert len(lost) == 1
    assert abs(lost[0, 0]) > 0.9  # along the bank, which runs from west to east


def test_the_summary_says_what_changed(changed, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["summary", str(changed.parent)]) == 0
    told = capsys.readouterr().out
    erosion = pd.read_csv(changed / "volumes_1-2.csv").set_index("what").loc["erosion"]
    assert f"erosion    {erosion['volume_m3']:+9.2f} m3, sigma {erosion['sigma_m3']:.2f} m3" in told
    assert "vegetation" in told
    assert (changed / "index.html").is_file()


def test_drawn_errors_have_the_sigmas_of_the_distances(changed) -> None:
    table = pd.read_parquet(changed / "changes_1-2.parquet")
    drawn = pd.read_parquet(changed / "draws_1-2.parquet").drop(columns="core")
    ratio = (drawn**2).mean(axis=1) / table["sigma_m"] ** 2
    assert ratio.mean() == pytest.approx(1.0, abs=0.25)  # fifty draws of errors that all places share
    assert (drawn.isna().all(axis=1) == table["distance_m"].isna()).all()


def test_the_bank_line_retreats_where_the_bank_was_cut(changed) -> None:
    lines = pd.read_csv(changed / "retreat_1-2.csv")
    assert set(lines["line"]) == {"bank line", "bank top"}
    moved = lines[(lines["high_m"] < -0.15)]
    assert moved["line"].tolist() == ["bank line"] * len(moved)  # the crest stays
    assert 1 <= len(moved) <= 3
    assert (lines["epr_m_a"] * 1.99 - lines["nsm_m"]).abs().max() < 0.02  # two years
