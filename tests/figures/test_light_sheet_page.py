"""The page on a light-sheet sensor."""

import pandas as pd
from PIL import Image

from thalweg.lightsheet.figures import light_sheet_page
from thalweg.lightsheet.figures.page import flag_counts, parameter_rows
from thalweg.lightsheet.lines import LineFlag

CALIBRATION = {
    "object": "grid over a plate",
    "parameters": [
        {
            "name": "laser_x_mm",
            "value": -7.0377,
            "sigma": 0.0907,
            "sigma_image": 0.045,
            "treated": "estimated",
        },
        {
            "name": "fx",
            "value": 1091.017,
            "sigma": 0.2,
            "sigma_image": None,
            "treated": "held fixed, considered",
        },
        {"name": "camera_x_mm", "value": 0.0, "sigma": 0.0, "sigma_image": None, "treated": "held fixed"},
    ],
    "correlations": [["laser_kappa_rad", "camera_kappa_rad", 0.9245]],
    "line_points": {"used": 989, "rejected": 3, "sigma0": 1.01, "neighbours_with_one_error": 4.0},
    "pairs": {"used": 20, "rejected": 1, "sigma0": 1.9},
    "dropped": {"ends without a partner": 2},
    "levels": {"grid 1": {"depth_mm": 60.0, "points": 622, "gaps": 11, "rms_px": 0.044, "bias_px": 0.0}},
    "sigma_of_depth": [{"depth_mm": 60.0, "most_mm": 0.05, "most_uncorrelated_mm": 0.28}],
    "warnings": ["the window may be tilted"],
}
BUDGET = pd.DataFrame(
    [
        (d, c, p, s * d / 50)
        for d in (50.0, 200.0)
        for c, p, s in (("image", "a", 0.02), ("total", "g", 0.2), ("total with correlations", "g", 0.05))
        for _ in range(2)
    ],
    columns=["depth_mm", "cause", "panel", "sigma_depth_mm"],
)
PANELS = pd.DataFrame(
    [("a.png", 128.9, 0.0, 1024, -0.052, 0.11, 0.12, 0.12, 0.03, 0.21, 7)],
    columns=[
        "file",
        "depth_mm",
        "sigma_mm",
        "n",
        "mean_mm",
        "std_mm",
        "rms_mm",
        "predicted_mm",
        "published_mean_mm",
        "published_std_mm",
        "n_off_sheet",
    ],
)


def page(**more):
    return light_sheet_page(CALIBRATION, BUDGET, **more).html()


def test_the_page_says_what_was_found_and_what_was_left_out(tmp_path):
    Image.new("L", (8, 8)).save(tmp_path / "depth_budget.png")
    counts = pd.DataFrame(
        {
            "file": ["a.png", "b.png"],
            "points": [500, 0],
            "candidates": [600, 0],
            "short_pieces": [8, 0],
            "reason": ["", "no line"],
        }
    )
    points = pd.DataFrame({"flags": pd.Series([0, 1, 5], dtype="uint8")})
    truth = pd.DataFrame(
        [("laser_x", 0.01, 0.09, "mm", 0.11, 1)],
        columns=["what", "estimated_minus_true", "sigma", "unit", "normalised", "n"],
    )
    camera = {"camera": {"z_mm": {"value": 78.04, "sigma": 0.05}}, "window_flatness_mm": 0.012}
    text = page(
        panels=PANELS,
        truth=truth,
        camera=camera,
        counts={"panels": counts},
        points={"panels": points},
        pictures=[tmp_path / "depth_budget.png"],
        captions={"depth_budget": "Budget by cause"},
        title="Light-sheet sensor: Basin",
        twin=True,
    )
    for words in (
        "<h1>Light-sheet sensor: Basin</h1>",
        "<td>989 line points, 20 pairs of ends; 4 rejected</td>",
        "<td>residuals of line points over their sigmas</td><td>1.01</td><td>consistent</td>",
        "<td>residuals of pairs of ends over their sigmas</td><td>1.90</td><td>too optimistic</td>",
        "<td>predicted sigma of depths of 50 to 200 mm</td><td>0.050 to 0.200 mm</td>",
        "means off by at most 0.052 mm, standard deviations at most 0.110 mm</td><td>too few data</td>",
        "Depth check on panels: too few data to judge the predicted standard deviations.",
        "digital twin made these recordings",
        "within 0.012 mm of one plane",
        "Warning: the window may be tilted.",
        "+0.924  laser kappa, camera kappa",
        "0.020 to 0.020",
        "ends without a partner",
        "images without a line",
        "line points that do not meet the light sheet",
        "short pieces",
        "near jump",
        "calibrated minus true",
        "Budget by cause",
    ):
        assert words in text.replace("\N{NO-BREAK SPACE}", " "), words
    # what stood before a line was found is no loss
    assert "candidates" not in text


def test_a_page_without_panels_and_pictures():
    text = page()
    assert "Panel in known depths" not in text
    assert "No panel in known depths judges the sigmas of the depths." in text
    assert "digital twin" not in text
    assert "<img" not in text


def test_parameters_have_as_many_places_as_their_sigmas_warrant():
    rows = parameter_rows(CALIBRATION["parameters"])
    assert rows.to_numpy().tolist() == [
        ["laser x", "-7.038", "mm", "0.091", "0.045", "estimated"],
        ["fx", "1091.02", "px", "0.2", "", "held fixed, considered"],
        ["camera x", "0", "mm", "fixed", "", "held fixed"],
    ]


def test_points_are_counted_under_each_of_their_flags():
    flags = [0, LineFlag.SATURATED, LineFlag.SATURATED | LineFlag.ALBEDO_EDGE]
    table = flag_counts({"stepped": pd.DataFrame({"flags": pd.Series(flags, dtype="uint8")})})
    assert table.to_dict("records") == [
        {
            "series": "stepped",
            "points": 3,
            "saturated": 2,
            "weak": 0,
            "near jump": 0,
            "albedo edge": 1,
            "apart": 0,
        }
    ]
    assert not len(flag_counts({}))
