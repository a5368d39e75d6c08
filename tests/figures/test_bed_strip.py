"""Figure and page of a strip of the bed under the boat."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from thalweg.core import InputError
from thalweg.lightsheet.figures import strip_page
from thalweg.lightsheet.figures.survey import along_lines, bed_strip

LINES, N = 8, 60
STEP_S = 0.02


@pytest.fixture
def points():
    """Eight lines along the north-east, 20 mm apart, on a bed that rises to the north-west."""
    s = np.linspace(-0.1, 0.1, N)
    parts = []
    for k in range(LINES):
        east, north = s / np.sqrt(2) - 0.02 * k, s / np.sqrt(2) + 0.02 * k
        parts.append(
            pd.DataFrame(
                {
                    "file": f"{k}.png",
                    "t_gps_s": 3e8 + STEP_S * k,
                    "east_m": east - 77.0,
                    "north_m": north + 11.0,
                    "up_m": -0.17 + 0.1 * (north - east),
                    "cov_uu_m2": 0.03**2,
                    "sigma_line_m": 2e-5,
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


@pytest.fixture
def truth():
    rows = pd.DataFrame({"file": [f"{k}.png" for k in range(LINES)], "n": N, "mean_m": 0.04, "std_m": 0.002})
    return pd.DataFrame([{"mean_m": 0.04, "std_within_lines_m": 0.002}]), rows


def test_the_strip_beside_the_true_bed(points, truth, look):
    figure = bed_strip(points, truth=truth[0], truth_lines=truth[1], title="Strip", twin=True)
    words = look.texts(figure)
    assert "Strip, strip of the bed: n = 480 points of 8 lines, sigma of the height 3.0 cm" in words
    assert "minus true bed +4.0 cm, within lines 2.0 mm" in words


def test_a_real_boat_has_heights_only(points, look):
    figure = bed_strip(points, title="Strip")
    assert "true bed" not in look.texts(figure)
    last = next(ax for ax in figure.axes if ax.get_title(loc="left").startswith("c: mean of each line"))
    means = last.containers[0].lines[0].get_ydata(orig=False)
    # 2 cm to the west and 2 cm to the north from line to line: 4 mm higher
    assert_allclose(np.diff(means), 0.4)
    with pytest.raises(InputError, match="cov_uu_m2"):
        bed_strip(points.drop(columns="cov_uu_m2"), title="Strip")


def test_lines_are_followed_in_their_own_direction(points):
    along = along_lines(points)
    one = along[points["file"] == "3.png"]
    assert np.ptp(one) == pytest.approx(0.2)
    # the lines lie side by side
    assert points.assign(a=along).groupby("file")["a"].mean().abs().max() < 1e-9


def test_the_page_counts_what_was_left_out(tmp_path):
    Image.new("L", (8, 8)).save(tmp_path / "bed_strip.png")
    counts = {
        "lines": {"line_points": 24400, "no_sheet": 56, "points": 24344},
        "merged": {"images": 24, "images_without_pose": 1, "points_without_pose": 980, "points": 24344},
        "images_left_out": {"a.png": "no line"},
        "times": {"images_without_pulse": ["b.png", "c.png"], "pulses_without_image_s": [1.0]},
        "trajectory": "fused",
    }
    page = strip_page(
        counts,
        [tmp_path / "bed_strip.png"],
        captions={"bed_strip": "From above"},
        title="Strip: Demo",
        twin=True,
    )
    text = page.html().replace("\N{NO-BREAK SPACE}", " ")
    for words in (
        "<h1>Strip: Demo</h1>",
        "24 images of the bed",
        "24 344 georeferenced points",
        "digital twin made",
        "images: no line",
        "line points: no sheet",
        "images without a pulse",
        "From above",
        "INS, antenna positions and image poses together",
    ):
        assert words in text, words
    for words, n in (
        ("images without a pulse", "2"),
        ("pulses without an image", "1"),
        ("points of images without a pose", "980"),
    ):
        assert text.split(f"<td>{words}</td>")[1].split("</td>")[0].endswith(f">{n}")
