"""Sections on scanned objects of the page on a light-sheet sensor."""

import json
from pathlib import Path

import pytest
from PIL import Image

from thalweg.core import InputError
from thalweg.figures import Page
from thalweg.lightsheet.figures import read_scans
from thalweg.lightsheet.figures.page import kind_of, left_out, scan_section, scan_words

COUNTS = {
    "lines": {"line_points": 9000, "no_sheet": 12, "points": 8988},
    "merged": {"images": 39, "images_without_pose": 2, "points_without_pose": 30, "points": 8988},
    "images_left_out": {"a.png": "no line", "b.png": "no line"},
}
FACTS = {
    "reference": "mesh",
    "counts": {"points_without_pose": 30, "far": 700, "at_border": 11, "used": 8247, "on_bad_lines": 400},
    "images_with_bad_pose": ["c.png"],
    "consistency": {"rms_mm": 0.0627, "predicted_mm": 0.0575, "rms_over_sigma": 1.119},
    "warnings": ["no line can be told from the others by its pose"],
    "levels": [{"height_mm": 20.195, "measured_mm": 20.189, "rms_own_plane_mm": 0.032, "n": 119}],
}
STATISTICS = (
    "points,lines,rule,n,mean_mm,std_mm,n_kept,std_kept_mm\n"
    "all lines,22,3 sigma,8247,0.004,0.0625,8200,0.0586\n"
    "published,70,3 sigma,66666,,0.4,65987,0.29\n"
)
FEW = "fewer than 30 points"
LINES = f"image,n,reason,bad\na.png,3,{FEW},False\nc.png,400,,True\nd.png,0,{FEW},False\n"
PROFILE = "points,lines,rule,n,std_mm,std_kept_mm\nmiddle line,1,3 sigma,621,0.058,0.041\n"


@pytest.fixture
def files(tmp_path):
    """What the rules write for a scan with a reference and for one without."""
    written = {
        "old_wreck/counts.json": json.dumps(COUNTS),
        "old_wreck/facts.json": json.dumps(FACTS),
        "old_wreck/statistics.csv": STATISTICS,
        "old_wreck/lines.csv": LINES,
        "old_wreck/profile.csv": PROFILE,
        "old_wreck/profile.json": json.dumps({"rms_mm": 0.0581, "bimodality": "one mode (D 3.4)"}),
        "wreck/counts.json": json.dumps(COUNTS | {"images_left_out": {}}),
    }
    for name, text in written.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    return [tmp_path / name for name in written]


def picture(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("L", (8, 8)).save(path)
    return path


def test_each_scan_has_its_numbers_and_pictures(files, tmp_path):
    pictures = [
        picture(tmp_path / "figures/scan_old_wreck.png"),
        picture(tmp_path / "old_wreck/orthophoto.png"),
        picture(tmp_path / "figures/sheet_image_wreck.png"),
    ]
    captions = {"scan_distances": "Coloured by distance", "sheet_image": "The green channel"}
    first, second = read_scans(["old_wreck", "wreck"], files, pictures, captions)
    # the name of one scan ends with that of the other
    assert [words for _, words in first.pictures] == ["Coloured by distance", "orthophoto"]
    assert [words for _, words in second.pictures] == ["The green channel"]
    page = Page("Sensor")
    for scan in (first, second):
        scan_section(page, scan)
    text = page.html().replace("\N{NO-BREAK SPACE}", " ")
    before, after = text.split(">Scan: wreck</h2>")
    for words in (
        "39 images with 8 988 points of the line. 8 247 points lie on the mesh; 1 line with a bad pose.",
        "Root mean square of the distances 0.063 mm, predicted 0.058 mm; of the distances over their sigmas "
        "1.12.",
        "Middle line: 0.058 mm root mean square; distribution with one mode (D 3.4).",
        "Warning: no line can be told from the others by its pose.",
        "beside P4 Table 3",
        "beside P4 Table 2",
        "20.195",
        "66 666",
        "line points: no sheet",
    ):
        assert words in before, words
    assert "There is no reference to compare with." in after
    assert before.count("<img") == 2
    assert after.count("<img") == 1


def test_everything_left_out_is_counted(files):
    first, second = read_scans(["old_wreck", "wreck"], files, [], {})
    found = dict(left_out(first).itertuples(index=False))
    assert found == {
        "images: no line": 2,
        "line points: no sheet": 12,
        "points of images without a pose": 30,
        "points not on the object": 700,
        "points at a border of the mesh": 11,
        "points of lines with a bad pose": 400,
        "lines not judged: fewer than 30 points": 2,
    }
    assert left_out(second).to_numpy().tolist() == [
        ["line points: no sheet", 12],
        ["points of images without a pose", 30],
    ]
    assert scan_words(second).startswith("39 images")


def test_files_of_no_scan_are_refused(files, tmp_path):
    with pytest.raises(InputError, match="'old_wreck' belongs to no scan"):
        read_scans(["wreck"], files, [], {})
    with pytest.raises(InputError, match=r"scan_ship\.png"):
        read_scans(["old_wreck", "wreck"], files, [tmp_path / "scan_ship.png"], {})


@pytest.mark.parametrize(
    ("name", "scan", "kind"),
    [
        ("sheet_image_wreck", "wreck", "sheet_image"),
        ("scan_wreck", "wreck", "scan_distances"),
        ("setup_of_wreck", "wreck", "scan_setup"),
        ("profile_of_wreck", "wreck", "scan_profile"),
        ("reference_of_wreck", "wreck", "scan_reference"),
        ("scan_old_wreck", "wreck", ""),
        ("scan_setup_of_wreck", "wreck", ""),
        ("setup_of_scan_wreck", "wreck", ""),
    ],
)
def test_pictures_belong_to_scans_by_their_whole_name(name, scan, kind):
    assert kind_of(Path(f"figures/{name}.png"), scan) == kind
