"""What a campaign file may say wrong about photographs of the bank."""

from typing import Any

import pytest

from thalweg.config.check_images import check_images

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
