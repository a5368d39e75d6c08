"""Campaigns without a boat: photographs, a camera that stays, a finished cloud, and what they may lack."""

from pathlib import Path

import pytest

from thalweg.core import ConfigError
from thalweg.settings import campaign_text, load_campaign, load_campaigns

FILES = "points.csv marks.csv lens.yaml positions.csv poses.csv a.laz b.laz boat.anpp photos/a.jpg"
PHOTOGRAPHS = "images: [photos], control_points: [points.csv], marks: [marks.csv]"
FIXED = "marks: [marks.csv], control_points: [points.csv], interior: [lens.yaml]"
CLOUD = "{cloud: [a.laz], reference: [b.laz]}"


def written(folder: Path, logs: str, *, crs: str = "local", more: str = "") -> Path:
    (folder / "photos").mkdir()
    for name in FILES.split():
        (folder / name).write_text(name)
    path = folder / "alone.yaml"
    path.write_text(f"campaign: {{id: alone, title: A, crs: '{crs}'}}\nlogs: {logs}\n{more}")
    return path


@pytest.mark.parametrize(
    ("logs", "kind"),
    [
        (f"{{time_lapse: {{{PHOTOGRAPHS}}}}}", "photographs"),
        ("{time_lapse: {images: [photos], positions: [positions.csv]}}", "photographs"),
        ("{time_lapse: {images: [photos], orientations: [poses.csv]}}", "photographs"),
        (f"{{fixed_camera: {{{FIXED}}}}}", "fixed_camera"),
        (CLOUD, "cloud"),
    ],
)
def test_complete_ones_need_neither_origin_nor_mounts(tmp_path, logs, kind):
    campaign = load_campaign(written(tmp_path, logs))
    assert campaign.kind == kind
    assert campaign.campaign.origin is None


@pytest.mark.parametrize(
    ("logs", "crs", "where", "words"),
    [
        ("{time_lapse: {images: [photos]}}", "local", "logs.time_lapse", "photographs alone"),
        (
            "{time_lapse: {images: [photos], control_points: [points.csv]}}",
            "local",
            "logs.time_lapse.marks",
            "where the control points are",
        ),
        (
            "{time_lapse: {images: [photos], positions: [positions.csv], orientations: [poses.csv]}}",
            "local",
            "logs.time_lapse.positions",
            "which hold them",
        ),
        (
            "{time_lapse: {images: [photos], orientations: [poses.csv]}}",
            "EPSG:25833",
            "campaign.origin",
            "a place on the earth",
        ),
        (
            f"{{time_lapse: {{{PHOTOGRAPHS}, positions: [positions.csv]}}, ins: [boat.anpp]}}",
            "EPSG:25833",
            "logs.time_lapse.positions",
            "beside other logs",
        ),
        ("{fixed_camera: {marks: [marks.csv]}}", "local", "logs.fixed_camera.control_points", "missing"),
        (f"{{fixed_camera: {{{FIXED}}}, ins: [boat.anpp]}}", "local", "logs.ins", "would not be used"),
        ("{cloud: [a.laz]}", "local", "logs.reference", "missing"),
        ("{cloud: [a.laz, b.laz], reference: [points.csv]}", "local", "logs.cloud", "2 files"),
        (f"{{time_lapse: {{{PHOTOGRAPHS}}}}}", "EPSG:4326", "campaign.crs", "not projected"),
        ("{ins: [boat.anpp]}", "local", "campaign.crs", "is no CRS"),
        ("{ins: [boat.anpp]}", "EPSG:25833", "campaign.origin", "missing"),
    ],
)
def test_what_is_missing_is_named(tmp_path, logs, crs, where, words):
    with pytest.raises(ConfigError) as caught:
        load_campaigns([str(written(tmp_path, logs, crs=crs))], tmp_path)
    assert any(f" {where}: " in line and words in line for line in str(caught.value).splitlines())


def test_a_stated_time_needs_its_standard_deviation(tmp_path):
    path = written(tmp_path, CLOUD, more="lidar: {clock: {first_packet_utc: '2026-05-12T12:00:00Z'}}\n")
    with pytest.raises(ConfigError, match=r"lidar_accuracy.sigma_time_s"):
        load_campaign(path)
    path.write_text(path.read_text() + "lidar_accuracy: {sigma_time_s: 0.1}\n")
    assert load_campaign(path).lidar.clock.first_packet_unix_s == 1_778_587_200.0


def test_the_points_of_a_fixed_camera_tell_its_lens(tmp_path):
    """No calibration file is needed: the setting says what is estimated instead."""
    campaign = load_campaign(
        written(tmp_path, "{fixed_camera: {marks: [marks.csv], control_points: [points.csv]}}")
    )
    assert not campaign.logs.fixed_camera.interior
    assert campaign.images.fixed_camera.free == ["focal", "k1"]
    files = {"fixed_marks": [tmp_path / "marks.csv"], "fixed_points": [tmp_path / "points.csv"]}
    text = campaign_text("alone", folder=tmp_path, files=files)
    assert "interior" not in text


@pytest.mark.parametrize(
    ("kind", "listed"),
    [
        ("photographs", "time_lapse=photos control_points=points.csv image_marks=marks.csv"),
        ("fixed_camera", "fixed_marks=marks.csv fixed_points=points.csv fixed_interior=lens.yaml"),
        ("cloud", "cloud=a.laz reference=b.laz"),
    ],
)
def test_a_new_campaign_is_one_of_its_kind(tmp_path, kind, listed):
    written(tmp_path, CLOUD)
    files = {stream: [tmp_path / name] for stream, name in (word.split("=") for word in listed.split())}
    text = campaign_text("alone", folder=tmp_path, files=files, spacing_m=0.4)
    (tmp_path / "alone.yaml").write_text(text)
    campaign = load_campaign(tmp_path / "alone.yaml")
    assert campaign.kind == kind
    # as dense as the reference is: edges five times its spacing, cells half of it
    assert campaign.reference.longest_edge_m == (2.0 if kind == "cloud" else 0.5)
    assert campaign.reference.cell_m == (0.2 if kind == "cloud" else 0.05)


def test_many_files_are_a_pattern_and_of_several_tables_one_is_to_be_kept(tmp_path):
    """A pattern is written only where it finds the listed files and no others."""
    marks = [tmp_path / f"marks/IMG_{k}.csv" for k in range(9)]
    for path in (*marks, tmp_path / "marks/points.csv"):
        path.parent.mkdir(exist_ok=True)
        path.write_text("label,x,y\n")
    lenses = [tmp_path / "left.yaml", tmp_path / "right.yaml"]
    files = {"fixed_marks": marks, "fixed_points": [tmp_path / "points.csv"], "fixed_interior": lenses}
    text = campaign_text("alone", folder=tmp_path, files=files)
    assert '    marks: ["marks/IMG_*.csv"]  #' in text
    assert "interior:  # interior orientation; CHANGE: keep one of 2" in text
    (tmp_path / "marks/IMG_other.csv").write_text("label,x,y\n")
    assert "      - marks/IMG_8.csv" in campaign_text("alone", folder=tmp_path, files=files)
