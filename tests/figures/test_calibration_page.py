"""The page on a calibration: its first sentence, its tables, and that it needs nothing from elsewhere."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from thalweg.core import InputError, Rigid, rotation_opk
from thalweg.core.calibration import Block, Calibration, Source, lever_block, pose_block
from thalweg.figures import Finding, empty_figure, save
from thalweg.figures.calibration import calibration_page, with_units
from thalweg.figures.calibration.page import block_table, head


@pytest.fixture
def boat():
    sigma = np.array([1e-3, 4e-4, 2e-4, *np.deg2rad([0.067, 0.035, 0.015])])
    pose = Rigid(
        R=rotation_opk(0.0, np.deg2rad(-90.2), 0.0),
        shift_m=np.array([0.12, 0.08, -0.07]),
        cov=np.diag(sigma**2),
    )
    block, cov = pose_block("camera_lidar", pose)
    clock = Block(
        name="camera_clock",
        quantities=("offset_s", "drift_ppm"),
        values=np.array([2.3471, -3.0]),
        equation="t_gps_s = t_camera_s + offset_s",
        facts={"camera": "left"},
    )
    joint = np.zeros((8, 8))
    joint[:6, :6], joint[6, 6] = cov, 0.0031**2
    source = Source(run="field", method="cones", observations=8_821, sigma0=1.013)
    return Calibration(title="Camera & lidar", blocks=(block, clock), cov=joint, source=source)


@pytest.mark.parametrize(
    ("sigma0", "verdict", "words"),
    [
        (1.013, "consistent", "2 of 2 agree with the residuals"),
        (1.4, "too optimistic", "2 of 2 are too small"),
        (np.nan, "", "too few data to judge"),
    ],
)
def test_the_head_has_the_sigmas_and_what_residuals_say_of_them(boat, sigma0, verdict, words):
    told = replace(boat, source=replace(boat.source, sigma0=sigma0))
    sentence, findings = head([told, boat] if sigma0 == 1.4 else [told])
    assert sentence == f"Predicted standard deviations: {words}."
    told = f"; {verdict}" if verdict else ""
    assert findings == [
        Finding(
            "camera to lidar, length of the lever arm",
            "16.0 cm",
            f"σ in x, y, z: 1, 0.4, 0.2 mm, about them: 0.067, 0.035, 0.015°{told}",
        ),
        Finding("camera clock, offset", "+2.3471 s", f"σ 3.1 ms{told}"),
    ]
    bare = Calibration(
        title="x", blocks=(lever_block("antenna", [0, 0, 0]),), cov=np.eye(3), source=boat.source
    )
    assert head([bare]) == ("No block has sigmas of its own.", [])


def test_values_have_the_places_of_their_sigmas(boat):
    table = block_table(boat, boat.find("camera_lidar")).set_index("quantity")
    assert table.loc["phi", "value"] == "-90.200"
    assert table.loc["phi", "sigma"] == "0.035"
    assert table.loc["x", "value"] == "0.1200"
    assert list(table.loc["x", ["sigma", "unit of sigma"]]) == ["1", "mm"]
    clock = block_table(boat, boat.find("camera_clock")).set_index("quantity")
    assert list(clock.loc["offset", ["value", "sigma", "unit of sigma"]]) == ["2.3471", "3.1", "ms"]
    assert clock.loc["drift", "sigma"] == "fixed"


def test_the_page_is_whole(boat, tmp_path):
    picture = tmp_path / "correlations.png"
    save(empty_figure("Correlations", "a test"), picture, dpi=50)
    truth = pd.DataFrame(
        {
            "block": "camera_lidar",
            "quantity": ["rotation_x_deg", "x_m", "together"],
            "estimated_minus_true": [0.01, 3e-4, 1.1],
            "sigma": [0.067, 1e-3, 0.9],
            "unit": ["deg", "m", "1"],
            "normalised": [0.15, 0.3, 1.1],
        }
    )
    page = calibration_page(
        [boat],
        [
            ("Cones that were found", pd.DataFrame({"cone": ["C1", "C2"], "used": [812, 0]})),
            ("Marks rejected", pd.DataFrame({"mark": []})),
        ],
        pictures=[picture],
        captions={"correlations": "Which <quantities> hang together"},
        truth=truth,
        notes=["The antenna defines the origin of ics."],
        title="Calibration: yard",
        twin=True,
    )
    html = page.html()
    plain = re.sub(r"<[^>]+>", " ", html)
    assert html.count("data:image/png;base64,") == 1
    assert "http" not in html
    for words in (
        "not of a real boat",
        "Run field; cones; 8\N{NO-BREAK SPACE}821 observations; sigma0 1.013",
        "Which &lt;quantities&gt; hang together",
        "Marks rejected: none.",
        "Cones that were found",
        "1.0, 0.4 and 0.2 mm",
        "about one axis",
        "The antenna defines the origin",
        "Camera &amp; lidar",
        "camera_lidar: x_ccs = R_ccs_scs x_scs",
    ):
        assert words in plain, words
    # metres of the truth are shown in millimetres
    row = re.search(r"<tr><td>camera lidar</td><td>x</td>.*?</tr>", html)
    assert row
    assert re.findall(r"<td[^>]*>([^<]*)</td>", row.group())[2:] == ["0.3", "1", "mm", "0.3"]
    page.write(tmp_path / "index.html")
    assert (tmp_path / "index.html").read_text(encoding="utf-8") == html


def test_a_missing_picture_is_refused(boat, tmp_path):
    with pytest.raises(InputError, match="file not found"):
        calibration_page([boat], pictures=[tmp_path / "none.png"])


CLOCK = {
    "offset_s": -2.348,
    "sigma_offset_s": 0.002,
    "drift_ppm": -17.6,
    "sigma_drift_ppm": 34.0,
    "jitter_s": 0.0229,
    "sigma_jitter_s": 0.0014,
    "images_used": 148,
    "variant": "positions and attitude",
    "sigma0_squared": 1.025,
    "sigma0_squared_band": [0.85, 1.17],
    "variants": [
        {
            "variant": "p2",
            "offset_s": -2.35,
            "sigma_offset_s": 0.0139,
            "drift_ppm": 0.0,
            "sigma_drift_ppm": 1e-6,
            "jitter_s": 0.0,
            "sigma0_squared": 4.8,
            "images_used": 148,
        }
    ],
}


def plain_text(page):
    return " ".join(re.sub(r"<[^>]+>", " ", page.html()).split())


def test_the_page_says_how_the_clock_runs(boat):
    words = plain_text(calibration_page([boat], facts={"camera_clock": CLOCK}))
    assert "clock of the camera, offset −2.3480 s σ 2.0 ms; consistent" in words
    assert "off by 22.9 ms (standard deviation, sigma 1.4 ms)" in words
    assert "148 images and on positions and attitude" in words
    # the drift of the published variant is held: no numbers
    assert "p2 −2.35 13.9 – – 0 4.8 148" in words


def test_long_tables_are_cut_and_reasons_counted(boat):
    long = pd.DataFrame({"cone": [f"C{k}" for k in range(113)], "shift_x_mm": 0.5})
    rejected = pd.DataFrame({"image": ["a.jpg"] * 40, "reason": ["glare"] * 25 + ["no saddles"] * 15})
    words = plain_text(calibration_page([boat], [("Cones (c.csv)", long), ("Marks (m.csv)", rejected)]))
    assert "Cones (c.csv): first 30 of 113 rows, all of them in the file" in words
    assert "C29" in words
    assert "C30" not in words
    assert "shift x / mm" in words
    assert "Marks (m.csv): 40 rows, counted by reason reason rows glare 25 no saddles 15" in words
    assert with_units(pd.DataFrame({"x_m": [1], "x_mm": [2]}))[1] == {}


def test_a_block_stands_once(boat):
    words = plain_text(calibration_page([boat, boat]))
    assert words.count("lever arm 16.0 cm") == 1
    assert "Block camera_lidar: as under Camera &amp; lidar." in words


def test_what_was_left_out_is_counted_by_reason(boat):
    rejected = [{"what": "image", "name": f"{k}.jpg", "reason": "too few marks"} for k in range(7)]
    words = plain_text(calibration_page([boat], facts={"camera": {"rejected": rejected}}))
    assert "7 images left out, too few marks: 0.jpg, 1.jpg, 2.jpg, 3.jpg, 4.jpg ..." in words
    words = plain_text(calibration_page([boat], facts={"field": {"notes": ["cone C7: 0 of 8 markers"]}}))
    assert "Cone C7: 0 of 8 markers." in words


def test_the_page_says_what_the_run_shows_of_its_own_errors(boat):
    size = {"stated": 0.03, "estimated": 0.0312, "low": 0.028, "high": 0.035, "determined_by_survey": True}
    time = {"stated": 20.0, "estimated": 18.0, "low": 4.0, "high": 80.0, "determined_by_survey": False}
    run = {"facts": {"processes": {"position_size": size, "heading_time": time}}}
    text = calibration_page([boat], facts={"ins_lidar": run}).html()
    assert "The run determines position size." in text
    assert "It says little of heading time: there the width of the prior counts." in text
    assert "0.0312" in text
    # stated errors that were not asked of the run: no section
    assert "Errors of the poses" not in calibration_page([boat], facts={"ins_lidar": {"facts": {}}}).html()
