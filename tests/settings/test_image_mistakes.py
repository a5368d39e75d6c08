"""What a campaign file may say wrong about photographs of the bank."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from thalweg.core import ConfigError
from thalweg.settings import load_campaigns
from thalweg.settings.checks_campaign import check_images

PLACED = {"camera": {"omega_deg": -90.0}}
WHOLE = {"images": ["photos"], "control_points": ["targets.csv"]}


@pytest.mark.parametrize(
    ("logs", "mounts", "images", "twin"),
    [
        (WHOLE, PLACED, None, None),
        (WHOLE, {"calibration": "field"}, None, None),
        ({"images": ["photos"]}, PLACED, {"adjustment": {"antenna": {"use": True}}}, None),
        ({"images": ["photos"], "orientations": ["cameras.xml"]}, PLACED, None, None),
        (None, PLACED, None, {"time_lapse": {"rate_hz": 2.0}}),
        (None, None, None, {"size": "tiny"}),
    ],
)
def test_complete_campaigns_have_no_mistake(logs, mounts, images, twin):
    assert list(check_images(logs, mounts, images, twin)) == []


@pytest.mark.parametrize(
    ("logs", "mounts", "twin", "where", "words"),
    [
        (WHOLE, None, None, "mounts", "no place of the camera"),
        (None, {"lidar": {}}, {"time_lapse": {"rate_hz": 2.0}}, "mounts", "no place of the camera"),
        ({"images": ["photos"]}, PLACED, None, "logs.time_lapse", "without control points"),
        ({"masks": ["made"]}, PLACED, None, "logs.time_lapse.masks", "there are none"),
    ],
)
def test_a_mistake_names_its_place_and_a_cure(logs, mounts, twin, where, words):
    (mistake,) = check_images(logs, mounts, None, twin)
    assert mistake.dotted == where
    assert words in mistake.found
    assert mistake.cure


def write_campaign(folder: Path, **time_lapse: Any) -> Path:
    (folder / "photos").mkdir(exist_ok=True)
    for name in ("a.pcap", "b.anpp", "c.pos", "photos/1.JPG", "photos/notes.txt", "gcp_list.txt"):
        (folder / name).write_text("x")
    path = folder / "good.yaml"
    origin = {"lat_deg": 51.05, "lon_deg": 13.25, "h_ell_m": 300.0}
    path.write_text(
        yaml.safe_dump(
            {
                "campaign": {"id": "good", "title": "t", "crs": "EPSG:25833", "origin": origin, "seed": 1},
                "logs": {
                    "lidar": ["a.pcap"],
                    "ins": ["b.anpp"],
                    "positions": ["c.pos"],
                    "time_lapse": time_lapse,
                },
                "mounts": {name: {"lever_ics_m": [0.1, 0.0, 0.0]} for name in ("lidar", "antenna", "camera")},
            }
        )
    )
    return path


def test_folders_of_photographs_and_masks(tmp_path):
    """The manual says `images: [photos]`."""
    (tmp_path / "masks").mkdir()
    (tmp_path / "masks" / "1.JPG.png").write_text("x")
    path = write_campaign(tmp_path, images=["photos"], masks=["masks"], control_points=["gcp_list.txt"])
    campaign = load_campaigns([str(path)], tmp_path)["good"]
    assert campaign.log_files("time_lapse") == [tmp_path / "photos"]
    assert campaign.log_files("masks") == [tmp_path / "masks"]


def test_a_folder_without_photographs(tmp_path):
    path = write_campaign(tmp_path, images=["photos"], control_points=["gcp_list.txt"])
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
    points = {"control_points": ["gcp_list.txt"]}
    path = write_campaign(tmp_path, images=["photos"], masks=["photos/masks"], **points)
    load_campaigns([str(path)], tmp_path)
    for images, masks in ((["photos", "photos/left"], []), (["photos"], ["photos/left"])):
        path = write_campaign(tmp_path, images=images, masks=masks, **points)
        with pytest.raises(ConfigError, match=r"left lies below photos of logs\.time_lapse\.images\[0\]"):
            load_campaigns([str(path)], tmp_path)


def test_interior_orientations_of_folders(tmp_path):
    (tmp_path / "left.yaml").write_text("x")
    given = {"images": ["photos"], "control_points": ["gcp_list.txt"]}
    interiors = {"left": ["left.yaml"], "right/low": ["left.yaml"]}
    campaign = load_campaigns([str(write_campaign(tmp_path, interiors=interiors, **given))], tmp_path)["good"]
    assert list(campaign.logs.time_lapse.interiors) == ["left", "right/low"]
    assert campaign.log_files("interior.left") == [tmp_path / "left.yaml"]
    assert campaign.plain()["logs"]["time_lapse"]["interiors"]["left"] == [str(tmp_path / "left.yaml")]
    for wrong, words in (
        ({"left": ["absent.yaml"]}, r"interiors\.left\[0\].*absent.yaml: no such file"),
        ({"left": ["left.yaml", "b.anpp"]}, r"interiors\.left: 2 files"),
        ({"left/": ["left.yaml"]}, "left/"),
    ):
        with pytest.raises(ConfigError, match=words):
            load_campaigns([str(write_campaign(tmp_path, interiors=wrong, **given))], tmp_path)


@pytest.mark.parametrize(("source", "wrong"), [("ins", True), ("sbet", True), ("pos", False), ("ppk", False)])
def test_positions_that_an_ins_has_filtered_are_none_of_the_antenna(source, wrong):
    antenna = {"adjustment": {"antenna": {"use": True}}}
    found = list(check_images(WHOLE, PLACED, antenna, None, {"position_source": source}))
    assert [m.dotted for m in found] == ["images.adjustment.antenna.use"] * wrong
    assert all("count twice" in m.cure for m in found)
    (without,) = check_images({"images": ["photos"]}, PLACED, None, None, {"position_source": source})
    assert ("cannot take their place" in without.cure) == wrong
    # without the antenna, or with finished orientations, nothing is counted twice
    assert not list(check_images(WHOLE, PLACED, None, None, {"position_source": source}))
    finished = {**WHOLE, "orientations": ["cameras.xml"]}
    assert not list(check_images(finished, PLACED, antenna, None, {"position_source": source}))


def test_one_file_may_hold_points_and_marks(tmp_path):
    """OpenDroneMap's gcp_list.txt does."""
    both = {"control_points": ["gcp_list.txt"], "marks": ["gcp_list.txt"]}
    load_campaigns([str(write_campaign(tmp_path, images=["photos"], **both))], tmp_path)
    with pytest.raises(ConfigError, match="already named"):
        load_campaigns([str(write_campaign(tmp_path, images=["photos"], times=["c.pos"], **both))], tmp_path)
