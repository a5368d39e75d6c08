"""What a campaign file may say wrong about photographs of the bank."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from thalweg.config.check_images import check_images
from thalweg.config.load import load_campaigns
from thalweg.core.errors import ConfigError

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
def test_complete_campaigns_have_no_mistake(logs: Any, mounts: Any, images: Any, twin: Any) -> None:
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
def test_a_mistake_names_its_place_and_a_cure(
    logs: Any, mounts: Any, twin: Any, where: str, words: str
) -> None:
    (mistake,) = check_images(logs, mounts, None, twin)
    assert mistake.dotted == where
    assert words in mistake.found
    assert mistake.cure


def write_campaign(folder: Path, **time_lapse: list[str]) -> Path:
    (folder / "photos").mkdir(exist_ok=True)
    for name in ("a.pcap", "b.anpp", "c.pos", "photos/1.JPG", "photos/notes.txt", "gcp_list.txt"):
        (folder / name).write_text("x")
    path = folder / "good.yaml"
    origin = {"lat_deg": 51.05, "lon_deg": 13.25, "h_ell_m": 300.0}
    path.write_text(yaml.safe_dump({
        "campaign": {"id": "good", "title": "t", "crs": "EPSG:25833", "origin": origin, "seed": 1},
        "logs": {"lidar": ["a.pcap"], "ins": ["b.anpp"], "positions": ["c.pos"], "time_lapse": time_lapse},
        "mounts": {name: {"lever_ics_m": [0.1, 0.0, 0.0]} for name in ("lidar", "antenna", "camera")},
    }))  # fmt: skip
    return path


def test_folders_of_photographs_and_masks(tmp_path: Path) -> None:
    """The manual says `images: [photos]`."""
    (tmp_path / "masks").mkdir()
    (tmp_path / "masks" / "1.JPG.png").write_text("x")
    path = write_campaign(tmp_path, images=["photos"], masks=["masks"], control_points=["gcp_list.txt"])
    campaign = load_campaigns([str(path)], tmp_path)["good"]
    assert campaign.log_files("time_lapse") == [tmp_path / "photos"]
    assert campaign.log_files("masks") == [tmp_path / "masks"]


def test_a_folder_without_photographs(tmp_path: Path) -> None:
    path = write_campaign(tmp_path, images=["photos"], control_points=["gcp_list.txt"])
    (tmp_path / "photos" / "1.JPG").unlink()
    with pytest.raises(ConfigError, match=r"photos: there is no photograph in this folder.*below it are not"):
        load_campaigns([str(path)], tmp_path)


def test_one_file_may_hold_points_and_marks(tmp_path: Path) -> None:
    """OpenDroneMap's gcp_list.txt does."""
    both = {"control_points": ["gcp_list.txt"], "marks": ["gcp_list.txt"]}
    load_campaigns([str(write_campaign(tmp_path, images=["photos"], **both))], tmp_path)
    with pytest.raises(ConfigError, match="already named"):
        load_campaigns([str(write_campaign(tmp_path, images=["photos"], times=["c.pos"], **both))], tmp_path)
