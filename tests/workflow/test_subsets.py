"""Surveys without a lidar and without an INS: from a folder with a real log to its front page."""

import contextlib
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.test_readme import as_a_shell_splits, commands
from thalweg.cli import main
from thalweg.core import utc_text_from_gps
from thalweg.ingest.nmea import read_nmea

pytestmark = [pytest.mark.workflow, pytest.mark.real]


def printed(page: Path, begin: str, end: str) -> list[str]:
    """Commands between two headings of a page."""
    return list(commands(page.read_text().split(begin)[1].split(end)[0]))


@pytest.fixture(scope="module")
def yacht(repository, tmp_path_factory, house_builder, data_dir):
    """Sounder and receiver of a yacht on the IJsselmeer (NMEA 0183), by README's five commands as printed."""
    house = house_builder(repository, tmp_path_factory.mktemp("yacht"))
    logs = house.root / "surveys/mulde"
    logs.mkdir(parents=True)
    shutil.copy(data_dir / "nmea_gpsd_depth" / "bundg_zeus_9.log", logs)
    five = printed(repository / "README.md", "## Your survey in five commands", "\n## ")[:5]
    assert [line.split()[0] for line in five] == ["thalweg"] * 3 + ["snakemake", "thalweg"]
    with contextlib.chdir(house.root):
        for line in five:
            words = as_a_shell_splits(line, house.root)
            if words[0] == "snakemake":
                house.snakemake(*words[1:])
            else:
                assert main(words[1:]) == 0, line
            if words[1] == "new-campaign":
                path = house.root / "config/campaigns/mulde_2026.yaml"
                text = path.read_text()
                assert "lat_deg: 52.8" in text
                assert "crs: EPSG:32631" in text
                assert "  lidar:" not in text
                path.write_text(text.replace("lever_ics_m: CHANGE", "lever_ics_m: [0.0, 0.0, -1.5]"))
    return house


def test_commands_of_the_tutorial(yacht, repository):
    """The plan and the parts: what the logs give is made by now, what they do not give is said."""
    lines = printed(repository / "docs/tutorial.md", "## 5. Run it", "## 6.")
    said = {}
    for line in lines:
        run = yacht.snakemake(*as_a_shell_splits(line, yacht.root)[1:], check=False)
        said[line.split("--config")[0].split()[-1]] = run.stdout + run.stderr
    assert list(said) == ["host", "4", "ingest", "lidar", "images", "accuracy", "figures"]
    for asked in ("4", "ingest", "figures"):
        assert "Nothing to be done" in said[asked], said[asked]
    for asked in ("lidar", "images", "accuracy"):
        assert f"The logs of mulde_2026 give nothing of the part `{asked}`." in said[asked], said[asked]


def test_check_config_says_what_the_logs_give(yacht, capsys):
    assert main(["check-config", str(yacht.root / "config" / "campaigns" / "mulde_2026.yaml")]) == 0
    text = capsys.readouterr().out
    gives, adds = (line for line in text.splitlines() if line.startswith(("  gives", "  more logs")))
    assert "georeferenced soundings" in gives
    assert "point cloud" not in gives
    assert "point cloud of the banks (logs.lidar" in adds


def test_soundings_in_the_world(yacht, record_property):
    folder = yacht.root / "results" / "mulde_2026" / "bathymetry"
    facts = json.loads((folder / "soundings.json").read_text())
    assert facts["pings"] == 149  # DPT sentences of the log
    table = pd.read_csv(folder / "soundings.csv")
    # four come after the last position, one before the first time
    record_property("in_the_world", len(table))
    assert len(table) == facts["by_reason"][""] == 144
    assert sum(facts["by_reason"].values()) == 149
    # a DPT of 5.2 to 6.7 m below a transducer that is level with the antenna's stated lever arm
    assert table["depth"].between(3.0, 8.0).all()
    assert table["east"].between(655_000, 656_500).all()
    assert table["north"].between(5_857_000, 5_859_000).all()
    assert table["height"].std() < 2.0
    # positions without accuracy: what is stated counts, enlarged for its own uncertainty
    assert table["sigma"].between(4.0, 8.0).all()


def test_the_front_page_links_all(yacht):
    folder = yacht.root / "results" / "mulde_2026"
    text = (folder / "index.html").read_text()
    for name in ("sounding_lines", "survey_map", "trajectory", "streams_in_time"):
        assert f'href="figures/{name}.png"' in text
        assert (folder / "figures" / f"{name}.png").is_file()
    assert 'href="bathymetry/soundings.csv"' in text
    assert (folder / "report.pdf").read_bytes().startswith(b"%PDF")
    assert (folder / "survey.qgz").is_file()
    assert "digital twin" not in text
    assert "point cloud of the banks" in text
    assert not (folder / "lidar").exists()


def test_a_log_without_dates_and_heights(yacht, data_dir, capsys, record_property):
    """Four hours of a yacht, places by GLL alone: what is missing is said before the first job."""
    logs, campaigns = str(data_dir / "nmea_plaka_yacht"), yacht.root / "config" / "campaigns"
    assert main(["new-campaign", "plaka", "--from-logs", logs, "--folder", str(campaigns)]) == 0
    path = campaigns / "plaka.yaml"
    text = path.read_text().replace("lever_ics_m: CHANGE", "lever_ics_m: [0.0, 0.0, 0.0]")
    for line, words in (
        ("", "logs.depth_date"),
        ("  depth_date: 2014-07-01\n", "orientation.antenna_h_ell_m, as the log has no heights"),
    ):
        text = text.replace("  # reference:", f"{line}  # reference:", 1)
        path.write_text(text)
        assert main(["check-config", str(path)]) == 2
        assert words in capsys.readouterr().err
    path.write_text(text.replace("# antenna_h_ell_m: 0.0", "antenna_h_ell_m: 20.0"))
    assert main(["check-config", str(path)]) == 0
    yacht.snakemake("results/plaka/bathymetry/soundings.json", "--config", "campaign=plaka")
    facts = json.loads((yacht.root / "results/plaka/bathymetry/soundings.json").read_text())
    assert facts["pings"] == 7250  # DBT sentences, PROVENANCE.md
    record_property("in_the_world", facts["by_reason"][""])
    assert facts["by_reason"][""] == pytest.approx(6891, abs=70)
    assert sum(facts["by_reason"].values()) == 7250


def test_an_empty_folder_apart_from_the_checkout(yacht, tmp_path, monkeypatch):
    """Two commands there; the campaign is found by its name, and nothing is written into the checkout."""
    monkeypatch.chdir(tmp_path)
    assert main(["new-campaign", "away", "--from-logs", str(yacht.root / "surveys/mulde")]) == 0
    path = tmp_path / "config/campaigns/away.yaml"
    path.write_text(path.read_text().replace("lever_ics_m: CHANGE", "lever_ics_m: [0.0, 0.0, -1.5]"))
    words = yacht.command("-s", str(yacht.root / "Snakefile"), "--config", "campaign=away", "--dry-run")
    run = subprocess.run(words, env=yacht.environment(), capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert {"locate_soundings", "front_page"} <= set(re.findall(r"\w+", run.stdout + run.stderr))
    assert not (yacht.root / "results/away").exists()


def write_gpx(log: Path, target: Path) -> None:
    """The yacht's positions as a plotter would export them (GPX 1.1); its depths stay in the log."""
    rows = read_nmea([log]).positions.dropna(subset=["t_gps_s", "h_ell_m"]).drop_duplicates("t_gps_s")
    points = "".join(
        f'<trkpt lat="{row.lat_deg:.8f}" lon="{row.lon_deg:.8f}"><ele>{row.h_ell_m - 40.0:.2f}</ele>'
        f"<time>{utc_text_from_gps(row.t_gps_s)}</time><geoidheight>40.0</geoidheight></trkpt>\n"
        for row in rows.itertuples()
    )
    space = "http://www.topografix.com/GPX/1/1"
    target.write_text(f'<gpx version="1.1" xmlns="{space}"><trk><trkseg>{points}</trkseg></trk></gpx>')


def test_a_track_in_gpx_places_the_same_soundings(yacht):
    """As a new user would: sounder and plotter in one folder."""
    logs, campaigns = yacht.root / "logs_of_gpx", yacht.root / "config" / "campaigns"
    logs.mkdir()
    log = shutil.copy(yacht.root / "surveys/mulde" / "bundg_zeus_9.log", logs)
    write_gpx(Path(log), logs / "track.gpx")
    assert main(["new-campaign", "gpx", "--from-logs", str(logs), "--folder", str(campaigns)]) == 0
    path = campaigns / "gpx.yaml"
    text = path.read_text()
    assert "position_source: gpx" in text
    path.write_text(text.replace("lever_ics_m: CHANGE", "lever_ics_m: [0.0, 0.0, -1.5]"))
    assert main(["check-config", str(path)]) == 0
    yacht.snakemake("results/gpx/bathymetry/soundings.csv", "--config", "campaign=gpx")
    ours, theirs = (
        pd.read_csv(yacht.root / "results" / name / "bathymetry" / "soundings.csv")
        for name in ("gpx", "mulde_2026")
    )
    assert len(ours) == len(theirs)
    for name in ("east", "north", "height"):
        np.testing.assert_allclose(ours[name], theirs[name], atol=0.05)
