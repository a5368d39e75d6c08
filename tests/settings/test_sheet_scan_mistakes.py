"""What a campaign file may say wrong about the scans of the light-sheet sensor."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.settings.test_light_sheet_mistakes import PLACE, told
from thalweg.settings import load_campaign

SCAN: dict[str, list[str]] = yaml.safe_load("""
images: [wreck]
pulses: [wreck/pulses.csv]
panel: [panel.csv]
marks: [wreck/marks.csv]
camera: [camera.json]
reference: [wreck.ply]
pairs: [wreck/pairs.csv]
""")
BASIN = yaml.safe_load("""
sensor: [sensor.yaml]
camera_marks: [camera_marks.csv]
mark_points: [mark_points.csv]
grid_images: [grid.png]
grid: [grid.yaml]
""")


def campaign(folder: Path, scans: Any, basin: dict[str, list[str]] = BASIN) -> Path:
    """A basin with all files that the good scan names."""
    (folder / "wreck").mkdir(exist_ok=True)
    (folder / "wreck" / "1.png").write_text("x")
    for (name,) in (*BASIN.values(), *SCAN.values()):
        if "." in name:
            (folder / name).write_text("x")
    path = folder / "good.yaml"
    data = yaml.safe_load(PLACE) | {"logs": {"light_sheet": basin | {"scans": scans}}}
    path.write_text(yaml.safe_dump(data))
    return path


def without(*parts: str) -> dict[str, list[str]]:
    """The good scan without some of its parts."""
    return {key: files for key, files in SCAN.items() if key not in parts}


def test_a_complete_scan_has_absolute_paths(tmp_path):
    found = load_campaign(campaign(tmp_path, {"wreck": SCAN}))
    assert found.log_files("wreck") == [tmp_path / "wreck"]
    assert found.log_files("wreck.marks") == [tmp_path / "wreck" / "marks.csv"]
    assert list(found.logs.light_sheet.scans) == ["wreck"]


@pytest.mark.parametrize("part", ["images", "panel", "marks", "camera"])
def test_what_a_scan_needs(tmp_path, part):
    text = told(campaign(tmp_path, {"wreck": without(part)}))
    assert f"logs.light_sheet.scans.wreck.{part}: missing" in text
    assert f"Add the line `{part}: [...]`" in text


def test_a_scan_without_reference_or_pulses_is_none_the_less_a_scan(tmp_path):
    found = load_campaign(campaign(tmp_path, {"wreck": without("reference", "pairs", "pulses")}))
    assert found.log_files("wreck.reference") == []


@pytest.mark.parametrize(("one", "other"), [("reference", "pairs"), ("pairs", "reference")])
def test_a_reference_needs_pairs_and_pairs_a_reference(tmp_path, one, other):
    text = told(campaign(tmp_path, {"wreck": without(other)}))
    assert f"scans.wreck.{other}: missing" in text
    assert f"beside {one}" in text
    assert "Pick three or more places" in text


def test_two_files_where_one_belongs(tmp_path):
    (tmp_path / "other.csv").write_text("x")
    text = told(campaign(tmp_path, {"wreck": SCAN | {"marks": ["wreck/marks.csv", "other.csv"]}}))
    assert "scans.wreck.marks: 2 files" in text
    assert "expected one file" in text


@pytest.mark.parametrize("name", ["calibration", "panels", "strip", "lidar", "sheet_sensor"])
def test_names_that_other_series_have(tmp_path, name):
    text = told(campaign(tmp_path, {name: SCAN}))
    assert f"scans.{name}: a scan called {name}" in text
    assert "Call the scan by its object" in text


def test_unknown_keys_and_missing_files_are_named(tmp_path):
    text = told(campaign(tmp_path, {"wreck": SCAN | {"marcs": ["x"], "camera": ["camra.json"]}}))
    assert "scans.wreck.marcs" in text
    assert "marks" in text
    text = told(campaign(tmp_path, {"wreck": SCAN | {"camera": ["camra.json"]}}))
    assert "camra.json: no such file" in text
    assert "Did you mean camera.json" in text


@pytest.mark.parametrize("scans", [["wreck"], "wreck", {"wreck": ["1.png"]}, {"wreck": None}])
def test_scans_that_are_no_table(tmp_path, scans):
    assert "scans" in told(campaign(tmp_path, scans))


@pytest.mark.parametrize("name", ["Wreck", "1wreck", "wreck of 1902", "", "a" * 41, "../up"])
def test_names_that_make_no_folder(tmp_path, name):
    assert "scans" in told(campaign(tmp_path, {name: SCAN}))


def test_all_mistakes_of_two_scans_stand_in_one_message(tmp_path):
    text = told(campaign(tmp_path, {"one": without("panel"), "two": without("camera")}))
    assert "scans.one.panel: missing" in text
    assert "scans.two.camera: missing" in text


def test_a_scan_alone_is_no_campaign(tmp_path):
    """Its points need a calibrated sensor."""
    basin = {key: files for key, files in BASIN.items() if key != "grid_images"}
    assert "logs.light_sheet.grid_images: missing" in told(campaign(tmp_path, {"wreck": SCAN}, basin))
