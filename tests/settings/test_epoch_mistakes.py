"""What a campaign of epochs may say wrong, and what it brings along."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from thalweg.cli import main
from thalweg.core import ConfigError
from thalweg.settings import load_campaigns, with_calibrations
from thalweg.workflow import CampaignFiles

PLACE = {"crs": "EPSG:25833", "origin": {"lat_deg": 51.05, "lon_deg": 13.25, "h_ell_m": 300.0}}
MOUNTS = {"lidar": {"phi_deg": -90.0, "lever_ics_m": [0, 0, 0]}, "antenna": {"lever_ics_m": [0.1, 0.0, -0.4]}}


def write(folder: Path, name: str, **sections: Any) -> None:
    identity = {"id": name, "title": name, **PLACE, **sections.pop("campaign", {})}
    (folder / f"{name}.yaml").write_text(yaml.safe_dump({"campaign": identity, **sections}))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("spring", "autumn", "winter"):
        write(tmp_path, name, twin={"size": "tiny", "time_lapse": None}, mounts=MOUNTS)
    write(tmp_path, "change", epochs=[{"campaign": "spring"}, {"campaign": "autumn"}])
    return tmp_path


def told(folder: Path) -> str:
    with pytest.raises(ConfigError) as caught:
        load_campaigns("change", folder)
    return str(caught.value)


def test_epochs_join_the_campaigns_and_bring_their_results(folder: Path) -> None:
    campaigns = with_calibrations(load_campaigns("change", folder), folder)
    assert list(campaigns) == ["spring", "autumn", "change"]
    files = CampaignFiles(name="change", campaigns=campaigns)
    assert files.epoch_pairs() == ["1-2"]
    assert files.epoch_points("autumn") == "results/autumn/lidar/points.laz"
    assert files.epochs_of("1-2", "points.npz")[1] == "results/change/deformation/epochs/autumn/points.npz"
    assert files.is_twin()
    # points of epochs need their full covariance
    assert files.of("spring").is_epoch()
    assert files.of("spring").georeferencing()["correlations"]


def test_three_epochs_are_compared_one_after_the_other_and_first_with_last(folder: Path) -> None:
    write(folder, "change", epochs=[{"campaign": name} for name in ("spring", "autumn", "winter")])
    campaigns = with_calibrations(load_campaigns("change", folder), folder)
    assert CampaignFiles(name="change", campaigns=campaigns).epoch_pairs() == ["1-2", "2-3", "1-3"]


def test_how_errors_last_comes_from_the_chain_of_each_epoch(folder: Path) -> None:
    camera = {"omega_deg": -90.0, "kappa_deg": 180.0, "lever_ics_m": [-0.25, 0.1, -0.2]}
    write(folder, "photos", twin={"size": "tiny", "time_lapse": {}}, mounts=MOUNTS | {"camera": camera})
    epochs = [{"campaign": "spring"}, {"campaign": "photos", "chain": "fused"}]
    write(folder, "change", epochs=epochs)
    campaigns = with_calibrations(load_campaigns("change", folder), folder)
    files = CampaignFiles(name="change", campaigns=campaigns)
    assert files.epoch_errors("spring") == "results/spring/orientation/error_model.json"
    assert files.epoch_errors("photos") == "results/photos/orientation/errors_fused.npz"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"epochs": [{"campaign": "spring"}]}, "at least 2"),
        ({"epochs": [{"campaign": "spring"}, {"campaign": "spring"}]}, "'spring' a second time"),
        ({"epochs": [{"campaign": "spring"}, {"campaign": "change"}]}, "'change' is this campaign itself"),
        ({"epochs": [{"campaign": "spring"}, {"campaign": "autunm"}]}, "Did you mean autumn?"),
        (
            {"epochs": [{"campaign": "spring"}, {"campaign": "autumn", "chain": "camera"}]},
            "has no time-lapse images",
        ),
        (
            {
                "campaign": {
                    "crs": "EPSG:25832",
                    "origin": {"lat_deg": 51.05, "lon_deg": 9.0, "h_ell_m": 0.0},
                },
                "epochs": [{"campaign": "spring"}, {"campaign": "autumn"}],
            },
            "is in EPSG:25833, this campaign in EPSG:25832",
        ),
        (
            {"epochs": [{"campaign": "spring"}, {"campaign": "autumn"}], "twin": {"size": "tiny"}},
            "both twin and epochs are given",
        ),
        (
            {"epochs": [{"campaign": "spring"}, {"campaign": "autumn"}], "deformation": {"reach_m": 0.2}},
            "the cylinders would be discs",
        ),
    ],
)
def test_mistakes_name_what_to_do(folder: Path, change: dict[str, Any], words: str) -> None:
    write(folder, "change", **change)
    assert words in told(folder)


def test_mistakes_of_an_epoch_are_told_with_its_file(folder: Path) -> None:
    write(folder, "autumn", twin={"size": "huge"}, mounts=MOUNTS)
    text = told(folder)
    assert "the campaign 'autumn' has mistakes of its own" in text
    assert "autumn.yaml" in text


def test_a_new_campaign_of_epochs_is_a_good_one(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["new-campaign", "flood", "--epochs", "spring", "autumn", "--folder", str(folder)]
    assert main(arguments) == 0
    text = (folder / "flood.yaml").read_text().replace("flood  # CHANGE", "flood # changed")
    (folder / "flood.yaml").write_text(text)
    assert load_campaigns("flood", folder)["flood"].is_change
