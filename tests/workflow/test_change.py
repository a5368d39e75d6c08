"""Two epochs from logs to the page of change, and what it says against the truth."""

import json

import numpy as np
import pandas as pd
import pytest
import rasterio
import yaml

from tests.bands import band
from tests.golden.kept_numbers import moved_since_kept
from thalweg.cli import main

pytestmark = pytest.mark.workflow

ORIGIN = {"lat_deg": 51.05, "lon_deg": 13.25, "h_ell_m": 300.0}
FOLDER = "results/tiny_change/deformation"


OF_FILES = "results/files/deformation"


@pytest.fixture(scope="module")
def changed(house_builder, repository, tmp_path_factory):
    """Folder of the results of `tiny_change`; beside it those of clouds from elsewhere."""
    house = house_builder(repository, tmp_path_factory.mktemp("change"))
    write_files(house.root / "config/campaigns")
    targets = ("results/tiny_change/index.html", f"{FOLDER}/truth_1-2.csv", f"{OF_FILES}/dod_1-2.tif")
    house.snakemake("--config", "campaign=[tiny_change,files]", "--", *targets)
    return house.root / FOLDER


def write_files(folder) -> None:
    """A campaign ``files``: two clouds of a slope, 10 cm apart, on a map."""
    rng = np.random.default_rng(1)
    for name, lift in (("a", 0.0), ("b", 0.1)):
        plan = rng.uniform(0.0, (12.0, 10.0), (3000, 2))
        height = 295.0 + lift + 0.1 * plan[:, 0] + rng.normal(0.0, 0.01, 3000)
        xyz = np.column_stack([plan + np.array([377_320.0, 5_656_830.0]), height])
        np.savetxt(folder / f"{name}.xyz", xyz, fmt="%.4f")
    stated = {"sigma_m": 0.01, "correlation_m": 3.0, "crs": "EPSG:25833"}
    campaign = {
        "campaign": {"id": "files", "title": "Files", "crs": "EPSG:25833", "origin": ORIGIN},
        "epochs": [
            {"clouds": ["a.xyz"], "date_utc": "2019-03-13", "name": "spring", **stated},
            {"clouds": ["b.xyz"], "date_utc": "2019-10-13", **stated},
        ],
        "deformation": {"core_spacing_m": 1.0, "cylinder_radius_m": 0.8, "registration": "none"},
    }
    (folder / "files.yaml").write_text(yaml.safe_dump(campaign))


def test_no_number_has_moved_unseen(changed):
    assert moved_since_kept(changed.parent) == []


def test_sigmas_agree_with_the_truth(changed):
    found = pd.read_csv(changed / "truth_1-2.csv").set_index("measure")["value"]
    # One observation: places along a bank share the errors of pose of both surveys, of which a pair has some
    # two dozen. The guard is `change_study`, of sixty pairs.
    low, high = band(24)
    assert low < found["normalised_square_unchanged"] < high
    assert low < found["normalised_square_changed"] < high
    assert found["false_alarm_95"] < 0.15
    assert found["specificity"] >= 0.97
    assert found["sensitivity_0.1_m"] >= 0.72
    assert found["false_discovery"] <= 0.06
    assert abs(found["net_volume_error_over_sigma"]) < 3.0
    assert found["largest_retreat_measured_m"] == pytest.approx(found["largest_retreat_true_m"], abs=0.2)


def test_nothing_unseen_is_called_eroded(changed):
    table = pd.read_parquet(changed / "changes_1-2.parquet")
    seen = pd.read_parquet(changed / "visibility_1-2.parquet")
    unseen = table["distance_m"].isna().to_numpy()
    called = table["state"].isin(["erosion", "deposition"]).to_numpy()
    assert unseen.any()
    free = (seen["reason_1"] == "free space") | (seen["reason_2"] == "free space")
    assert free.to_numpy()[unseen & called].all()
    reasons = set(seen["reason_1"]) | set(seen["reason_2"])
    assert "water" in reasons  # the second epoch was drier


def test_four_patches_are_found_with_their_sign_and_size(changed):
    patches = pd.read_csv(changed / "patches_1-2.csv")
    large = patches[patches["area_m2"] > 15.0]
    for what, size in (("erosion", 0.2), ("erosion", 0.1), ("deposition", 0.2), ("deposition", 0.1)):
        off = (large.loc[large["what"] == what, "mean_distance_m"].abs() - size).abs()
        assert off.min() < 0.05, (what, size)


def test_parts_of_sigma_add_up(changed):
    table = pd.read_parquet(changed / "changes_1-2.parquet").dropna(subset=["distance_m"])
    parts = table[["sigma_field_m", "sigma_white_m", "sigma_registration_m"]].to_numpy()
    assert np.sqrt((parts**2).sum(axis=1)) == pytest.approx(table["sigma_m"].to_numpy())
    # errors that points share are the larger part on ground that many points cover
    assert np.median(table["sigma_field_m"] / table["sigma_white_m"]) > 2.0


def test_the_registration_says_what_the_ground_does_not_show(changed):
    facts = json.loads((changed / "registration_1-2.json").read_text())
    lost = np.array(facts["not_shown"])
    assert len(lost) == 1
    assert abs(lost[0, 0]) > 0.9  # along the bank, which runs from west to east


def test_volumes_of_each_change_agree_with_the_truth(changed):
    table = pd.read_csv(changed / "truth_polygons_1-2.csv").set_index("name")
    patches = table[table.index.str.startswith("patch")]
    assert len(patches) == 5
    assert (patches["measured_m2"] > 0.9 * patches["area_m2"]).all()
    z = (patches["measured_m3"] - patches["expected_m3"]) / patches["sigma_m3"]
    assert z.abs().max() < 3.5  # fifty draws know a sigma to 10 %
    # what a patch of 6 x 4 m with this displacement holds, and the sign of it
    for name, row in patches.iterrows():
        assert row["true_m3"] == pytest.approx(24.0 * float(name.removeprefix("patch_")), rel=0.05)
    found = pd.read_csv(changed / "truth_1-2.csv").set_index("measure")["value"]
    assert found["true_changes_seen"] > 0.95
    low, high = band(24)  # one observation, as for distances
    assert low < found["height_normalised_square_unchanged"] < high
    places = pd.read_parquet(changed.parent / "simulation/truth/change_1-2.parquet")
    assert {"unchanged", "erosion", "deposition"} <= set(places["kind"])


def test_differences_of_heights_show_the_patches_in_the_map(changed):
    with rasterio.open(changed / "dod_1-2.tif") as file:
        assert file.descriptions == ("difference_m", "sigma_m")
        assert file.crs.to_epsg() == 25833
        difference, sigma = file.read()
    known = np.isfinite(difference)
    assert (np.isfinite(sigma) == known).all()
    assert 0.01 < np.median(sigma[known]) < 0.1
    z = difference[known] / sigma[known]
    assert np.median(np.abs(z)) / 0.6745 < 2.0  # most of the bank did not change
    table = pd.read_csv(changed / "dod_1-2.csv").set_index("part")
    assert table.loc["net", "volume_m3"] == pytest.approx(np.nansum(difference) * 0.25, rel=1e-4)
    assert abs(table.loc["net", "volume_m3"]) < 4.0 * table.loc["net", "sigma_m3"]


def test_clouds_from_elsewhere_are_compared_on_a_map(changed):
    folder = changed.parents[2] / OF_FILES
    facts = json.loads((folder / "epochs/spring/errors.json").read_text())
    assert (facts["kind"], facts["points"], facts["heights"]) == ("files", 3000, "ellipsoidal")
    row = pd.read_csv(folder / "dod_1-2.csv").set_index("part").loc["net"]
    assert row["volume_m3"] / row["area_m2"] == pytest.approx(0.1, abs=0.005)
    # of a mean over four correlation lengths each way
    assert 0.002 < row["sigma_m3"] / row["area_m2"] < 0.01
    assert (folder / "epochs/epoch_2/points.npz").is_file()


def test_the_summary_says_what_changed(changed, capsys):
    assert main(["summary", str(changed.parent)]) == 0
    told = capsys.readouterr().out
    erosion = pd.read_csv(changed / "volumes_1-2.csv").set_index("what").loc["erosion"]
    assert f"erosion    {erosion['volume_m3']:+9.2f} m3, sigma {erosion['sigma_m3']:.2f} m3" in told
    assert "vegetation" in told
    assert (changed / "index.html").is_file()


def test_drawn_errors_have_the_sigmas_of_the_distances(changed):
    table = pd.read_parquet(changed / "changes_1-2.parquet")
    drawn = pd.read_parquet(changed / "draws_1-2.parquet").drop(columns="core")
    ratio = (drawn**2).mean(axis=1) / table["sigma_m"] ** 2
    assert ratio.mean() == pytest.approx(1.0, abs=0.25)  # fifty draws of errors that all places share
    assert (drawn.isna().all(axis=1) == table["distance_m"].isna()).all()


def test_the_bank_line_retreats_where_the_bank_was_cut(changed):
    lines = pd.read_csv(changed / "retreat_1-2.csv")
    assert set(lines["line"]) == {"bank line", "bank top"}
    moved = lines[(lines["high_m"] < -0.15)]
    assert moved["line"].tolist() == ["bank line"] * len(moved)  # the crest stays
    assert 1 <= len(moved) <= 3
    assert (lines["epr_m_a"] * 1.99 - lines["nsm_m"]).abs().max() < 0.02  # two years
