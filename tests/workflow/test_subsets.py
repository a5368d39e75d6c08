"""Surveys without a lidar and without an INS: from a folder with a real log to its front page."""

import json
import shutil

import pandas as pd
import pytest

from thalweg.cli import main

pytestmark = [pytest.mark.workflow, pytest.mark.real]


@pytest.fixture(scope="module")
def yacht(repository, tmp_path_factory, house_builder, data_dir):
    """A sounder and a receiver of a yacht on the IJsselmeer (NMEA 0183), as a new user would run them."""
    house = house_builder(repository, tmp_path_factory.mktemp("yacht"))
    logs = house.root / "logs_of_yacht"
    logs.mkdir()
    shutil.copy(data_dir / "nmea_gpsd_depth" / "bundg_zeus_9.log", logs)
    campaigns = house.root / "config" / "campaigns"
    assert main(["new-campaign", "yacht", "--from-logs", str(logs), "--folder", str(campaigns)]) == 0
    path = campaigns / "yacht.yaml"
    text = path.read_text()
    assert "lat_deg: 52.8" in text
    assert "crs: EPSG:32631" in text
    assert "  lidar:" not in text
    path.write_text(text.replace("lever_ics_m: CHANGE", "lever_ics_m: [0.0, 0.0, -1.5]"))
    house.snakemake("--config", "campaign=yacht")
    return house


def test_check_config_says_what_the_logs_give(yacht, capsys) -> None:
    assert main(["check-config", str(yacht.root / "config" / "campaigns" / "yacht.yaml")]) == 0
    text = capsys.readouterr().out
    gives, adds = (line for line in text.splitlines() if line.startswith(("  gives", "  more logs")))
    assert "soundings in the world" in gives
    assert "point cloud" not in gives
    assert "point cloud of the banks (logs.lidar" in adds


def test_soundings_in_the_world(yacht) -> None:
    folder = yacht.root / "results" / "yacht" / "bathymetry"
    facts = json.loads((folder / "soundings.json").read_text())
    assert facts["pings"] == 149  # DPT sentences of the log
    table = pd.read_csv(folder / "soundings.csv")
    assert len(table) == facts["by_reason"][""] > 140
    assert sum(facts["by_reason"].values()) == 149
    # a DPT of 5.2 to 6.7 m below a transducer that is level with the antenna's stated lever arm
    assert table["depth"].between(3.0, 8.0).all()
    assert table["east"].between(655_000, 656_500).all()
    assert table["north"].between(5_857_000, 5_859_000).all()
    assert table["height"].std() < 2.0
    # positions without accuracy: what is stated counts, enlarged for its own uncertainty
    assert table["sigma"].between(4.0, 8.0).all()


def test_the_front_page_links_all(yacht) -> None:
    folder = yacht.root / "results" / "yacht"
    text = (folder / "index.html").read_text()
    for name in ("soundings", "survey_map", "trajectory", "streams_in_time", "sounding_errors"):
        assert f'src="figures/{name}.png"' in text
        assert (folder / "figures" / f"{name}.png").is_file()
    assert 'href="bathymetry/soundings.csv"' in text
    assert "point cloud of the banks" in text
    assert not (folder / "lidar").exists()
