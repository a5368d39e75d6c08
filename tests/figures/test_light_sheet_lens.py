"""The lens on the light-sheet page."""

from thalweg.figures import Page
from thalweg.lightsheet.figures.page import lens_section

REPORT = {
    "views": {"pictures": 24, "largest_angle_deg": 85.4, "rolled": 1},
    "adjustment": {
        "markers": 40,
        "marks": 2784,
        "marks_rejected": 3,
        "sigma0": 0.9998,
        "sigma0_band": [0.98, 1.02],
    },
    "sigma_over_constant": {"camera_constant": 1.8e-4, "published_camera_constant": 3.3e-4},
    "images": [{"image": "field_001.png", "marks": 132, "rejected": 0, "rms_px": 0.077, "largest": 3.4}],
    "scale_bars": [{"name": "bar 1", "stated_m": 0.203, "off_mm": -0.012, "sigma_off_mm": None}],
    "notes": ["one picture is blurred"],
}


def test_pictures_bars_and_precision_are_told():
    text = lens_section(Page("Sensor", "-"), REPORT).html()
    for words in (
        "24 pictures of a field of 40 markers, directions up to 85° apart, 1 rolled",
        "784 marks, 3 rejected",
        "sigma0 1.000 (95 % band 0.980 to 1.020)",
        "0.00018 of its length, that of P4 to 0.00033",
        "field_001.png",
        "bar 1",
        "largest over its sigma",
        "Note: one picture is blurred.",
    ):
        assert words in text, words
