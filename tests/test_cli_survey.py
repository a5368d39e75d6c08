"""`thalweg ppk`: from raw observations of a car and a public base to track, KML and page."""

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import pandas as pd
import pytest

from thalweg.cli import main

pytestmark = pytest.mark.real


@pytest.fixture(scope="module")
def words(data_dir: Path) -> list[str]:
    """The command but for its target: Septentrio rover, GEONET base 5.3 km away, published base position."""
    k = data_dir / "rinex_cssrlib_kinematic_2021"
    return [
        "ppk",
        str(k / "SEPT265G.21O"),
        *("--base", str(k / "3034265G.21O"), "--nav", str(k / "SEPT2650.21P")),
        *("--base-ecef", "-3959400.631", "3385704.533", "3667523.111"),
        *("--systems", "GPS", "GAL", "QZS"),
    ]


def test_a_track_with_its_page(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*words, "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "348 fixed, 12 float" in said
    assert "baseline 5.32 km" in said
    table = pd.read_csv(tmp_path / "positions.csv")
    assert len(table) == 360
    # at rest for 45 s at the published start; 24 mm is what the public solution leaves
    start = table[(table["fix"] == "fixed")].iloc[5]
    assert abs(start["lat_deg"] - 35.342058098) * 111_320 < 0.05
    assert abs(start["h_ell_m"] - 47.5515) < 0.06
    # 1 mm/km of 5.3 km stands in every sigma
    assert (table["sigma_east_m"] > 0.0053).all()
    assert table[table["fix"] == "fixed"]["sigma_up_m"].between(0.0106, 0.25).all()
    facts = json.loads((tmp_path / "ppk.json").read_text())
    assert facts["n_fixes_refused"] == {"baseline": 0, "duration": 0, "float": 0}
    lines = json.loads((tmp_path / "positions.geojson").read_text())["features"]
    assert {line["properties"]["fix"] for line in lines} == {"fixed", "float"}
    names = [e.text for e in ET.parse(tmp_path / "positions.kml").iter() if e.tag.endswith("name")]
    assert names[0] == "SEPT265G.21O"
    page = (tmp_path / "index.html").read_text()
    assert page.count("data:image/png") == 2
    assert "96.7 % of 360 epochs have fixed ambiguities" in page


def test_a_base_that_is_farther_than_trusted(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words, "--trusted-baseline", "5", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "0 fixed, 360 float" in said
    assert "348 fixes refused" in said
    assert "348 fixed epochs count as float: the baseline is longer" in said
    table = pd.read_csv(tmp_path / "positions.csv")
    assert (table["fix"] == "float").all()
    assert table["sigma_up_m"].median() > 0.05
