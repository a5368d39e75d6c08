"""Depths of a panel: the table, the comparison, and what does not belong together."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from tests.lightsheet.scanning.scan_files import pixel_table
from thalweg.core import InputError
from thalweg.lightsheet.optics import paper_4, project, sheet_in_water
from thalweg.lightsheet.poses.panels import compare_panels, measure_panels, read_panels

NAMES = ("a.png", "b.png", "c.png")
DEPTHS = (128.9, 100.0, 72.7)


def series(errors_mm, sigma_mm=0.05):
    """Points, panels and images; an empty list is an image without points on the sheet."""
    rows = [
        {"file": name, "depth_mm": depth + e, "sigma_depth_mm": sigma_mm}
        for name, depth, image in zip(NAMES, DEPTHS, errors_mm, strict=True)
        for e in image
    ]
    points = pd.DataFrame(rows, columns=["file", "depth_mm", "sigma_depth_mm"])
    panels = pd.DataFrame({"file": NAMES, "depth_mm": DEPTHS, "sigma_mm": 0.02})
    images = pd.DataFrame({"file": NAMES, "points": [len(e) for e in errors_mm], "reason": ""})
    return points, panels, images


def test_errors_are_measured_minus_stated():
    points, panels, images = series([[0.1, 0.3], [-0.2], [0.0, 0.0, 0.6]])
    images.loc[2, "points"] = 5
    found, table = compare_panels(points, panels, images)
    assert table["file"].tolist() == list(NAMES)
    assert_allclose(table["mean_mm"], [0.2, -0.2, 0.2], atol=1e-9)
    assert_allclose(table["std_mm"], [np.sqrt(0.02), np.nan, np.sqrt(0.12)], atol=1e-9)
    assert_allclose(table["rms_mm"], [np.sqrt(0.05), 0.2, np.sqrt(0.12)], atol=1e-9)
    assert_allclose(table["largest_mm"], [0.3, 0.2, 0.6], atol=1e-9)
    assert_allclose(table["predicted_mm"], 0.05, atol=1e-12)
    assert table["n"].tolist() == [2, 1, 3]
    assert table["n_off_sheet"].tolist() == [0, 0, 2]
    # P3 3.1.2 measured at 128.9 and 72.7, not at 100 mm
    assert table["published_mean_mm"].tolist()[::2] == [0.03, 0.07]
    assert np.isnan(table["published_std_mm"][1])
    assert_allclose(found["expected_depth_mm"], np.repeat(DEPTHS, [2, 1, 3]))


def test_an_image_that_gives_nothing_keeps_its_row_and_its_reason():
    points, panels, images = series([[0.1], [], []])
    images["points"], images["reason"] = [1, 0, 7], [np.nan, "the image is over-exposed", np.nan]
    _, table = compare_panels(points, panels, images)
    assert table["n"].tolist() == [1, 0, 0]
    assert np.isnan(table["mean_mm"][1])
    told = ["", "the image is over-exposed", "no line point lies on the light sheet"]
    assert table["reason"].tolist() == told
    assert table["n_off_sheet"].tolist() == [0, 0, 7]


def test_names_that_do_not_agree():
    points, panels, images = series([[0.1], [0.1], [0.1]])
    other = panels.assign(file=["a.png", "b.png", "C.PNG"])
    with pytest.raises(InputError, match=r"1 images without a depth, such as c.png.*column file"):
        compare_panels(points, other, images)
    with pytest.raises(InputError, match=r"1 depths without image, such as c.png; .*such as a.png"):
        compare_panels(points[points["file"] != "c.png"], panels, images[:2])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("file,depth,sigma_mm\na.png,1,1\n", r"columns missing: depth_mm"),
        ("name,depth_mm,sigma_mm\na.png,1,1\n", r"columns missing: file"),
        ("file,depth_mm,sigma_mm\n", "no row"),
        ("", "the file is empty"),
        ("file,depth_mm,sigma_mm\na.png,deep,0.02\n", "'deep' in column depth_mm, row 1"),
        ("file,depth_mm,sigma_mm\na.png,128.9,\n", "'' in column sigma_mm, row 1"),
        ("file,depth_mm,sigma_mm\na.png,128.9,0.02\na.png,72.7,0.02\n", "two depths for a.png"),
        ("file,depth_mm,sigma_mm\na.png,-128.9,0.02\n", "a depth of -128.9 mm.*row 1 .a.png"),
        ("file,depth_mm,sigma_mm\na.png,128.9,-1\n", "a sigma of -1 mm"),
        ("file,depth_mm,sigma_mm\na.png,0.1289,0.00002\n", "no depth exceeds 0.1289 mm.*by 1000"),
    ],
)
def test_tables_that_are_wrong(tmp_path, text, words):
    path = tmp_path / "panels.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        read_panels(path)
    assert str(path) in str(caught.value)
    assert caught.value.expected


def test_a_table_as_people_write_it(tmp_path):
    path = tmp_path / "panels.csv"
    path.write_text("file, object, depth_mm, sigma_mm\n 0012, panel, 128.9, 0.02\n")
    table = read_panels(path)
    assert table.to_dict("records") == [{"file": "0012", "depth_mm": 128.9, "sigma_mm": 0.02}]
    with pytest.raises(InputError, match="not found"):
        read_panels(tmp_path / "none.csv")


def test_panels_of_a_good_sensor_come_back():
    sensor = paper_4()
    lines = sheet_in_water(sensor, DEPTHS, np.linspace(-0.25, 0.25, 60))
    table = pixel_table({name: project(sensor, line) for name, line in zip(NAMES, lines, strict=True)}, 0.1)
    _, panels, images = series([[0.0] * 60] * 3)
    _, rows = measure_panels(sensor, table, panels, images)
    # no noise: solver and projection agree to 1e-9 mm
    assert rows["mean_mm"].abs().max() < 1e-6
    assert rows["n"].tolist() == [60] * 3
