"""What a campaign file may say wrong about photographs of the bank."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from thalweg.core import ConfigError, Mistake
from thalweg.settings import load_campaigns
from thalweg.settings.checks_campaign import check_images

PLACED = "mounts: {camera: {omega_deg: -90.0}}\n"
WHOLE = "logs: {images: [photos], control_points: [targets.csv]}\n"
ALONE = "logs: {images: [photos]}\n"
ANTENNA = "images: {adjustment: {antenna: {use: true}}}\n"
TWIN = "twin: {time_lapse: {rate_hz: 2.0}}\n"


def checked(text: str, *source: Any) -> list[Mistake]:
    """Mistakes of a campaign's images by its sections, of which any may be absent."""
    absent = dict.fromkeys(("logs", "mounts", "images", "twin"))
    return list(check_images(*(absent | yaml.safe_load(text)).values(), *source))


@pytest.mark.parametrize(
    "text",
    [
        WHOLE + PLACED,
        WHOLE + "mounts: {calibration: field}",
        ALONE + PLACED + ANTENNA,
        PLACED + "logs: {images: [photos], orientations: [cameras.xml]}",
        PLACED + TWIN,
        "twin: {size: tiny}",
    ],
)
def test_complete_campaigns_have_no_mistake(text):
    assert checked(text) == []


@pytest.mark.parametrize(
    ("text", "where", "words"),
    [
        (WHOLE, "mounts", "no place of the camera"),
        (TWIN + "mounts: {lidar: {}}", "mounts", "no place of the camera"),
        (ALONE + PLACED, "logs.time_lapse", "without control points"),
        (PLACED + "logs: {masks: [made]}", "logs.time_lapse.masks", "there are none"),
    ],
)
def test_a_mistake_names_its_place_and_a_cure(text, where, words):
    (mistake,) = checked(text)
    assert mistake.dotted == where
    assert words in mistake.found
    assert mistake.cure


def write_campaign(folder: Path, time_lapse: str) -> Path:
    (folder / "photos").mkdir(exist_ok=True)
    for name in ("a.pcap", "b.anpp", "c.pos", "photos/1.JPG", "photos/notes.txt", "gcp_list.txt"):
        (folder / name).write_text("x")
    path = folder / "good.yaml"
    path.write_text(f"""
campaign:
  {{id: good, title: t, crs: EPSG:25833, seed: 1, origin: {{lat_deg: 51.05, lon_deg: 13.25, h_ell_m: 300.0}}}}
logs: {{lidar: [a.pcap], ins: [b.anpp], positions: [c.pos], time_lapse: {{{time_lapse}}}}}
mounts: {{lidar: &arm {{lever_ics_m: [0.1, 0.0, 0.0]}}, antenna: *arm, camera: *arm}}
""")
    return path


def loaded(folder: Path, time_lapse: str) -> Any:
    return load_campaigns([str(write_campaign(folder, time_lapse))], folder)["good"]


GIVEN = "images: [photos], control_points: [gcp_list.txt]"


def test_folders_of_photographs_and_masks(tmp_path):
    """The manual says `images: [photos]`."""
    (tmp_path / "masks").mkdir()
    (tmp_path / "masks" / "1.JPG.png").write_text("x")
    campaign = loaded(tmp_path, f"{GIVEN}, masks: [masks]")
    assert campaign.log_files("time_lapse") == [tmp_path / "photos"]
    assert campaign.log_files("masks") == [tmp_path / "masks"]


def test_a_folder_without_photographs(tmp_path):
    path = write_campaign(tmp_path, GIVEN)
    (tmp_path / "photos" / "1.JPG").unlink()
    with pytest.raises(ConfigError, match=r"photos: there is no photograph in this folder.*or one above it"):
        load_campaigns([str(path)], tmp_path)
    (tmp_path / "photos" / "left").mkdir()
    (tmp_path / "photos" / "left" / "1.JPG").write_text("x")
    assert load_campaigns([str(path)], tmp_path)["good"].log_files("time_lapse") == [tmp_path / "photos"]


def test_what_lies_below_a_folder_of_photographs(tmp_path):
    """Masks may; photographs of another key, or a folder named twice, would be read as well."""
    for name in ("masks", "left"):
        (tmp_path / "photos" / name).mkdir(parents=True)
        (tmp_path / "photos" / name / "1.JPG.png").write_text("x")
    assert loaded(tmp_path, f"{GIVEN}, masks: [photos/masks]").log_files("masks")
    for images, masks in (("photos, photos/left", ""), ("photos", "photos/left")):
        text = f"images: [{images}], masks: [{masks}], control_points: [gcp_list.txt]"
        with pytest.raises(ConfigError, match=r"left lies below photos of logs\.time_lapse\.images\[0\]"):
            loaded(tmp_path, text)


def test_interior_orientations_of_folders(tmp_path):
    (tmp_path / "left.yaml").write_text("x")
    campaign = loaded(tmp_path, f"{GIVEN}, interiors: {{left: [left.yaml], right/low: [left.yaml]}}")
    assert list(campaign.logs.time_lapse.interiors) == ["left", "right/low"]
    assert campaign.log_files("interior.left") == [tmp_path / "left.yaml"]
    assert campaign.plain()["logs"]["time_lapse"]["interiors"]["left"] == [str(tmp_path / "left.yaml")]
    for wrong, words in (
        ("left: [absent.yaml]", r"interiors\.left\[0\].*absent.yaml: no such file"),
        ("left: [left.yaml, b.anpp]", r"interiors\.left: 2 files"),
        ("left/: [left.yaml]", "left/"),
    ):
        with pytest.raises(ConfigError, match=words):
            loaded(tmp_path, f"{GIVEN}, interiors: {{{wrong}}}")


@pytest.mark.parametrize(("source", "wrong"), [("ins", True), ("sbet", True), ("pos", False), ("ppk", False)])
def test_positions_that_an_ins_has_filtered_are_none_of_the_antenna(source, wrong):
    by = {"position_source": source}
    found = checked(WHOLE + PLACED + ANTENNA, by)
    assert [m.dotted for m in found] == ["images.adjustment.antenna.use"] * wrong
    assert all("count twice" in m.cure for m in found)
    (without,) = checked(ALONE + PLACED, by)
    assert ("cannot take their place" in without.cure) == wrong
    # without the antenna, or with finished orientations, nothing is counted twice
    assert not checked(WHOLE + PLACED, by)
    finished = "logs: {images: [photos], control_points: [targets.csv], orientations: [cameras.xml]}\n"
    assert not checked(finished + PLACED + ANTENNA, by)


def test_one_file_may_hold_points_and_marks(tmp_path):
    """OpenDroneMap's gcp_list.txt does."""
    both = f"{GIVEN}, marks: [gcp_list.txt]"
    assert loaded(tmp_path, both).id == "good"
    with pytest.raises(ConfigError, match="already named"):
        loaded(tmp_path, f"{both}, times: [c.pos]")
