"""Files of a rig that lack something: told before the first job, with the place and the cure."""

from typing import Any

import pytest

from thalweg.settings.checks_campaign import check_images, check_rig

FIELD = {"field": ["room.yaml"], "field_images": ["room"], "field_points": ["points.csv"]}
RIG = {"mount": {"omega_deg": 90.0}}


@pytest.mark.parametrize(
    ("logs", "rig", "lidar", "panorama"),
    [
        (None, None, False, None),
        ({"images": ["theta"], **FIELD}, RIG, True, None),
        ({"images": ["theta"], "calibration": ["rig.yaml"]}, RIG, True, {"mode": "depth"}),
        ({"images": ["theta"], "calibration": ["rig.yaml"]}, RIG, False, {"mode": "sphere"}),
        (FIELD, None, False, None),
    ],
)
def test_whole_sets_are_taken(logs: Any, rig: Any, lidar: bool, panorama: Any) -> None:
    assert list(check_rig(logs, rig, lidar, panorama)) == []


@pytest.mark.parametrize(
    ("logs", "rig", "lidar", "path", "words"),
    [
        (
            {"field": ["room.yaml"], "calibration": ["rig.yaml"]},
            RIG,
            True,
            ("logs", "rig", "field"),
            "without logs.rig.field_images and logs.rig.field_points",
        ),
        ({"images": ["theta"]}, RIG, True, ("logs", "rig", "images"), "nothing that calibrates it"),
        ({"images": ["theta"], **FIELD}, {}, True, ("rig",), "no place of it on the boat"),
        ({"images": ["theta"], **FIELD}, RIG, False, ("panorama", "mode"), "no lidar"),
    ],
)
def test_what_is_missing_is_told(logs: Any, rig: Any, lidar: bool, path: tuple, words: str) -> None:
    (mistake,) = check_rig(logs, rig, lidar, None)
    assert mistake.path == path
    assert words in mistake.found
    assert mistake.cure


def test_a_rig_that_orients_the_boat_needs_files_and_a_datum() -> None:
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
