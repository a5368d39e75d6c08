"""What a campaign file may say wrong about the underwater light-sheet sensor."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.settings.conftest import mistakes_of
from thalweg.settings import load_campaign
from thalweg_lab.settings import check_sheet_twin

PLACE = """
campaign:
  {id: good, title: t, crs: EPSG:25833, seed: 1, origin: {lat_deg: 51.05, lon_deg: 13.25, h_ell_m: 300.0}}
"""
FILES: dict[str, list[str]] = yaml.safe_load("""
sensor: [sensor.yaml]
camera_marks: [camera_marks.csv]
mark_points: [mark_points.csv]
grid_images: [grid/*.png]
grid: [grid.yaml]
panel_images: [panels]
panels: [panels.csv]
""")


def campaign(folder: Path, twin: Any = None, more: dict[str, Any] | None = None, **changes: Any) -> Path:
    """A campaign of dummy files; ``None`` takes a key out."""
    for name in ("grid", "panels"):
        (folder / name).mkdir(exist_ok=True)
    names = ["grid/1.png", "panels/1.png", "panels/2.png", *(f[0] for f in FILES.values() if "." in f[0])]
    for name in names:
        if "*" not in name:
            (folder / name).write_text("x")
    logs = {key: files for key, files in (FILES | changes).items() if files is not None}
    data = yaml.safe_load(PLACE)
    data |= {"twin": twin} if twin else {"logs": {"light_sheet": logs, **(more or {})}}
    path = folder / "good.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def told(path: Path) -> str:
    return str(mistakes_of(path))


def test_a_complete_campaign_has_absolute_paths(tmp_path):
    found = load_campaign(campaign(tmp_path))
    assert found.is_basin
    assert not found.is_calibration
    assert found.log_files("grid_images") == [tmp_path / "grid" / "1.png"]
    assert found.log_files("panel_images") == [tmp_path / "panels"]
    assert found.log_files("sheet_sensor") == [tmp_path / "sensor.yaml"]


def test_panels_may_be_left_out_together(tmp_path):
    found = load_campaign(campaign(tmp_path, panel_images=None, panels=None))
    assert found.is_basin
    assert found.log_files("panels") == []


@pytest.mark.parametrize("key", ["sensor", "camera_marks", "mark_points", "grid_images", "grid"])
def test_what_is_missing_is_told_with_what_it_is_needed_for(tmp_path, key):
    text = told(campaign(tmp_path, **{key: None}))
    assert f"logs.light_sheet.{key}: missing" in text
    assert f"Add the line `{key}: [...]`" in text
    # a basin has no boat: nothing is asked for that only a boat has
    assert "lidar" not in text
    assert "positions" not in text


@pytest.mark.parametrize(("key", "other"), [("panels", "panel_images"), ("panel_images", "panels")])
def test_panels_without_their_other_half(tmp_path, key, other):
    text = told(campaign(tmp_path, **{key: None}))
    assert f"logs.light_sheet.{key}: missing" in text
    assert f"beside logs.light_sheet.{other}" in text


def marker_field(folder: Path, *keys: str) -> dict[str, list[str]]:
    """Those keys of a marker field, with dummy files."""
    (folder / "field").mkdir()
    for name in ("camera_field.yaml", "camera_field_marks.csv", "field/1.png", "field/2.png"):
        (folder / name).write_text("x")
    files = ("camera_field.yaml", "field", "camera_field_marks.csv")
    named = zip(("camera_field", "camera_field_images", "camera_field_marks"), files, strict=True)
    return {key: [file] for key, file in named if key in keys}


@pytest.mark.parametrize("seen", ["camera_field_images", "camera_field_marks"])
def test_a_marker_field_has_a_description_and_what_was_seen(tmp_path, seen):
    found = load_campaign(campaign(tmp_path, **marker_field(tmp_path, "camera_field", seen)))
    assert found.log_files("camera_field") == [tmp_path / "camera_field.yaml"]
    assert len(found.log_files(seen)) == 1


def test_a_marker_field_without_a_part_and_with_too_many(tmp_path):
    files = marker_field(tmp_path, "camera_field", "camera_field_images", "camera_field_marks")
    assert "camera_field_marks: marks beside the pictures" in told(campaign(tmp_path, **files))
    for seen in ("camera_field_images", "camera_field_marks"):
        text = told(campaign(tmp_path, **{seen: files[seen]}))
        assert "logs.light_sheet.camera_field: missing" in text
        assert f"beside logs.light_sheet.{seen}" in text
    text = told(campaign(tmp_path, camera_field=files["camera_field"]))
    assert "camera_field_images: missing" in text
    assert "or camera_field_marks" in text
    (tmp_path / "other.csv").write_text("x")
    two = {**files, "camera_field_images": [], "camera_field_marks": ["camera_field_marks.csv", "other.csv"]}
    assert "camera_field_marks: 2 files; expected one file" in told(campaign(tmp_path, **two))


def test_files_that_are_not_there(tmp_path):
    text = told(campaign(tmp_path, sensor=["sensr.yaml"], grid_images=["grid/*.tif"], panel_images=["panel"]))
    assert "sensr.yaml: no such file" in text
    assert "Did you mean sensor.yaml" in text
    assert "grid/*.tif: the pattern matches no file" in text
    assert "panel: no such file" in text


def test_an_empty_file_and_a_folder_without_images(tmp_path):
    path = campaign(tmp_path, panel_images=["notes"])
    (tmp_path / "grid.yaml").write_text("")
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "read.txt").write_text("x")
    text = told(path)
    assert "grid.yaml: the file is empty" in text
    assert "notes: there is no photograph in this folder" in text


@pytest.mark.parametrize("named", [["grid/*.png"], ["grid"], ["grid/1.png", "grid/2.png"]])
def test_more_than_one_image_of_the_grid(tmp_path, named):
    path = campaign(tmp_path, grid_images=named)
    (tmp_path / "grid" / "2.png").write_text("x")
    text = told(path)
    assert "logs.light_sheet.grid_images: 2 images; expected one image" in text


def test_two_files_where_one_belongs(tmp_path):
    (tmp_path / "old.yaml").write_text("x")
    text = told(campaign(tmp_path, grid=["grid.yaml", "old.yaml"]))
    assert "logs.light_sheet.grid: 2 files; expected one file" in text


def test_the_same_file_twice(tmp_path):
    assert "panels.csv is already named at" in told(campaign(tmp_path, camera_marks=["panels.csv"]))


def test_a_boat_beside_the_basin(tmp_path):
    (tmp_path / "a.pcap").write_text("x")
    text = told(campaign(tmp_path, more={"lidar": ["a.pcap"]}))
    assert "logs.lidar: recordings of a boat beside those of the light-sheet sensor" in text


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ("calibration: {levels: 4}", "light_sheet.calibration.levels"),
        ("calibration: {jointly: [windw]}", "windw"),
        ("calibration: {window_marker: [1]}", "Did you mean window_markers"),
        ("lines: {method: magic}", "light_sheet.lines.method"),
        ("lines: {least_contrast_dn: -1}", "light_sheet.lines.least_contrast_dn"),
    ],
)
def test_settings_without_a_meaning(tmp_path, section, words):
    path = campaign(tmp_path)
    path.write_text(f"{path.read_text()}\nlight_sheet: {{{section}}}")
    assert words in told(path)


# ---------------------------------------------------------------- the twin


def test_a_twin_whose_levels_agree(tmp_path):
    assert load_campaign(campaign(tmp_path, twin={"size": "basin_tiny"})).is_basin
    three = {"size": "basin_tiny", "light_sheet": {"levels_mm": [60.0, 105.0, 150.0]}}
    assert list(check_sheet_twin(three, {"calibration": {"levels": 3}})) == []
    # a twin of a river has no such object, whatever the section says
    assert list(check_sheet_twin({"size": "tiny"}, {"calibration": {"levels": 3}})) == []


@pytest.mark.parametrize(
    ("twin", "section", "words"),
    [
        ("light_sheet: {levels_mm: [60.0, 105.0, 150.0]}", None, "levels is 2, the twin's object has 3"),
        ("{}", 3, "levels is 3, the twin's object has 2"),
        ("light_sheet: {levels_mm: [150.0, 60.0]}", None, "found [150.0, 60.0]"),
        ("light_sheet: {levels_mm: [60.0, 60.0]}", None, "found [60.0, 60.0]"),
    ],
)
def test_a_twin_whose_levels_do_not(tmp_path, twin, section, words):
    path = campaign(tmp_path, twin={"size": "basin_tiny"} | yaml.safe_load(twin))
    if section:
        path.write_text(f"{path.read_text()}\nlight_sheet: {{calibration: {{levels: {section}}}}}")
    text = told(path)
    assert words in text
    assert "Write" in text


def test_panels_of_the_twin_are_some(tmp_path):
    path = campaign(tmp_path, twin={"size": "basin_tiny", "light_sheet": {"panels_mm": []}})
    assert "panels_mm" in told(path)
