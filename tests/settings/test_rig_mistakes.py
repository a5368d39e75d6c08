"""Files of a rig that lack something: told before the first job, with the place and the cure."""

import re
import shutil
from typing import Any

import pytest
import yaml

from thalweg.core import Mistake
from thalweg.settings.checks_campaign import check_images, check_rig
from thalweg.settings.load import check_campaign

FIELD = "field: [room.yaml], field_images: [room], field_points: [points.csv]"
RIG = {"mount": {"omega_deg": 90.0}}


def checked(logs: str, rig: Any, lidar: bool, mode: str = "") -> list[Mistake]:
    """Mistakes of a rig with these logs, in braces, and this mode of panoramas."""
    return list(check_rig(yaml.safe_load(logs), rig, lidar, {"mode": mode} if mode else None))


@pytest.mark.parametrize(
    ("logs", "rig", "lidar", "mode"),
    [
        ("null", None, False, ""),
        (f"{{images: [theta], {FIELD}}}", RIG, True, ""),
        ("{images: [theta], calibration: [rig.yaml]}", RIG, True, "depth"),
        ("{images: [theta], calibration: [rig.yaml]}", RIG, False, "sphere"),
        (f"{{{FIELD}}}", None, False, ""),
    ],
)
def test_whole_sets_are_taken(logs, rig, lidar, mode):
    assert checked(logs, rig, lidar, mode) == []


@pytest.mark.parametrize(
    ("logs", "rig", "lidar", "path", "words"),
    [
        (
            "{field: [room.yaml], calibration: [rig.yaml]}",
            RIG,
            True,
            "logs.rig.field",
            "without logs.rig.field_images and logs.rig.field_points",
        ),
        ("{images: [theta]}", RIG, True, "logs.rig.images", "nothing that calibrates it"),
        (f"{{images: [theta], {FIELD}}}", {}, True, "rig", "no place of it on the boat"),
        (f"{{images: [theta], {FIELD}}}", RIG, False, "panorama.mode", "no lidar"),
    ],
)
def test_what_is_missing_is_told(logs, rig, lidar, path, words):
    (mistake,) = checked(logs, rig, lidar)
    assert mistake.dotted == path
    assert words in mistake.found
    assert mistake.cure


def test_the_calibration_of_the_boat_may_calibrate_its_rig(repository, tmp_path):
    """What it names has to, which is seen where both campaigns are."""
    logs = {"images": ["theta"]}
    assert list(check_rig(logs, RIG, True, None, mounts={"calibration": "yard"})) == []
    assert len(list(check_rig(logs, RIG, True, None, mounts={"calibration": "yard/boat.yaml"}))) == 1
    for name in ("demo", "field_small", "basin_small"):
        shutil.copy(repository / f"config/campaigns/{name}.yaml", tmp_path)
    assert check_campaign(tmp_path / "demo.yaml", tmp_path)[1] == []
    yard = tmp_path / "field_small.yaml"
    text, n = re.subn(r"(?m)^  dual_fisheye: .*\n", "", yard.read_text())
    yard.write_text(text)
    assert n == 1
    (mistake,) = check_campaign(tmp_path / "demo.yaml", tmp_path)[1]
    assert mistake.dotted == "mounts.calibration"
    assert mistake.found == "files of a rig, and the calibration field_small calibrates none"


def test_a_rig_that_orients_the_boat_needs_files_and_a_datum():
    images = {"source": "rig"}
    (mistake,) = check_rig(None, None, True, None, images)
    assert mistake.path == ("images", "source")
    assert "no files of a rig" in mistake.found
    assert list(check_rig(None, None, True, None, images, {"dual_fisheye": {"images": 9}})) == []
    (mistake,) = check_images(None, None, images, None)
    assert mistake.found == "images without control points"
    assert "images.adjustment.antenna.use: true" in mistake.cure
    images["adjustment"] = {"antenna": {"use": True}}
    assert list(check_images(None, None, images, None)) == []
    assert list(check_images({"control_points": ["a.csv"], "marks": ["b.csv"]}, None, images, None)) == []
