"""`snakemake real_logs` on three small recordings of other people: page, table, pictures, help."""

import os
import subprocess

import pandas as pd
import pytest
import yaml

pytestmark = [pytest.mark.workflow, pytest.mark.real]

CHOSEN = ("vlp16_mrpt_gps", "anpp_sdk_log", "nmea_humminbird")


@pytest.fixture(scope="module")
def house(repository, tmp_path_factory, house_builder):
    house = house_builder(repository, tmp_path_factory.mktemp("real"))
    listing = house.root / "resources/real_recordings.yaml"
    entries = [entry for entry in yaml.safe_load(listing.read_text()) if entry["id"] in CHOSEN]
    listing.write_text(yaml.safe_dump(entries))
    return house


def run(house, data: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        house.command("real_logs"),
        cwd=house.root,
        env={**house.environment(), "THALWEG_DATA": data},
        capture_output=True,
        text=True,
        check=False,
    )


def test_without_the_folder_people_are_told_what_to_set(house) -> None:
    result = run(house, os.devnull)
    assert result.returncode != 0
    assert "Set THALWEG_DATA to their folder" in result.stdout + result.stderr


def test_the_page_of_real_recordings(house, data_dir) -> None:
    result = run(house, str(data_dir))
    assert result.returncode == 0, result.stderr
    assert "Error" not in result.stderr
    folder = house.root / "results/real_logs"
    table = pd.read_csv(folder / "recordings.csv")
    assert len(table) == 3
    assert "points 73,486" in table["counts"].str.cat(sep=" ")
    assert {p.name for p in (folder / "nmea_humminbird").glob("*.png")} == {"depths.png", "positions.png"}
    html = (folder / "index.html").read_text()
    assert html.count("data:image/png;base64,") == 5
    assert 'src="http' not in html
    assert "unsynchronised" in html
