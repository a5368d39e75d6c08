"""The printed sheet: where its saddles are, and that it is printed in true scale."""

import cv2
import numpy as np
import pytest
from PIL import Image

from thalweg.calibration import (
    SADDLES_MODULES,
    MarkerLayout,
    mark_name,
    parse_mark,
    sheet_picture,
    write_sheets,
)
from thalweg.calibration.marker_sheets import DOTS_PER_MM, sheet_page
from thalweg.core import GeometryError, InputError

LAYOUT = MarkerLayout(sizes=((60, 99, 0.016),))


def test_saddles_are_crossings_of_black_and_white():
    k = 10
    picture = sheet_picture(17, LAYOUT, k)
    assert picture.shape == (110, 110)
    for number, (u, v) in enumerate(SADDLES_MODULES):
        x, y = int((u + 0.5) * k), int((v + 0.5) * k)
        quadrants = [picture[y + dy, x + dx] for dy in (-5, 4) for dx in (-5, 4)]
        # upper left, upper right, lower left, lower right
        expected = [255, 0, 0, 255] if number % 2 == 0 else [0, 255, 255, 0]
        assert quadrants == expected, number


def test_tag_is_that_of_aruco_with_a_white_frame():
    picture = sheet_picture(17, LAYOUT, 2)
    tag = cv2.aruco.generateImageMarker(LAYOUT.tags, 17, 6)
    np.testing.assert_array_equal(picture[5:17:2, 5:17:2], tag)
    assert (picture[3:19, 3:5] == 255).all()
    assert (picture[:, 0] == 255).all()


def test_the_size_of_a_marker_is_that_of_its_range():
    assert [LAYOUT.module_of(i) for i in (59, 60, 99, 100)] == [0.012, 0.016, 0.016, 0.012]
    saddles = LAYOUT.saddles_m(0)
    np.testing.assert_allclose(np.linalg.norm(np.diff(saddles, axis=0), axis=1), 0.096)
    # upper left first, z out of the print: clockwise seen from there
    assert saddles[0].tolist() == pytest.approx([-0.048, 0.048, 0.0])
    assert np.cross(saddles[1] - saddles[0], saddles[2] - saddles[1])[2] < 0


def test_pages_have_true_scale(tmp_path):
    (path,) = write_sheets(tmp_path / "sheets.pdf", [3, 60], LAYOUT)
    assert path.read_bytes().count(b"/MediaBox [ 0 0 595.27") == 2  # A4 in points of 1/72 inch
    files = write_sheets(tmp_path / "sheets", [3], LAYOUT)
    assert [f.name for f in files] == ["marker_003.png"]
    with Image.open(files[0]) as page:
        assert page.info["dpi"][0] == pytest.approx(DOTS_PER_MM * 25.4, rel=1e-3)
    for marker, module_mm in ((3, 12), (60, 16)):
        dots = ~np.asarray(sheet_page(marker, LAYOUT))
        top = int(np.flatnonzero(dots.any(axis=1))[0])
        frame = np.flatnonzero(dots[top])
        side = 11 * module_mm * DOTS_PER_MM
        assert frame[-1] - frame[0] + 1 == side + 2  # the cutting line is outside of the margin
        sheet = np.argwhere(dots[top + 1 : top + 1 + side, frame[0] + 1 : frame[-1]])
        # from the first to the last black square: ten modules, to a dot of 0.05 mm
        assert (sheet.max(axis=0) - sheet.min(axis=0) + 1).tolist() == [10 * module_mm * DOTS_PER_MM] * 2


def test_names_of_marks():
    assert mark_name(17, 0) == "17/0"
    assert parse_mark("17/3") == (17, 3)
    for wrong in ("17", "17/4", "a/1", "17/1/2", "-1/0"):
        with pytest.raises(InputError, match="is no mark"):
            parse_mark(wrong)


def test_what_cannot_be_printed_is_refused(tmp_path):
    with pytest.raises(GeometryError, match="even number"):
        sheet_picture(1, LAYOUT, 5)
    with pytest.raises(GeometryError, match="0 to 249"):
        sheet_picture(250, LAYOUT, 4)
    with pytest.raises(GeometryError, match=r"209 mm wide; expected modules up to 18\.2 mm.*smaller module"):
        sheet_page(1, MarkerLayout(module_m=0.019))
    with pytest.raises(GeometryError, match=r"modules of 0\.1 mm; expected at least 2 mm: a camera needs"):
        sheet_page(1, MarkerLayout(module_m=0.0001))
    # the bounds themselves can be printed
    for module_m in (0.002, 0.018):
        assert sheet_page(1, MarkerLayout(module_m=module_m)).size == (4200, 5940)
    with pytest.raises(InputError, match=r"\[4\] are asked for twice"):
        write_sheets(tmp_path / "a.pdf", [4, 5, 4], LAYOUT)
    with pytest.raises(InputError, match="no marker"):
        write_sheets(tmp_path / "a.pdf", [], LAYOUT)
    with pytest.raises(InputError, match="unknown dictionary 'DICT_9'"):
        MarkerLayout("DICT_9")
    with pytest.raises(InputError, match="module of 12"):
        MarkerLayout(module_m=12.0)


def test_what_exists_stays_and_half_a_set_is_never_written(tmp_path):
    pdf, folder = tmp_path / "sheets.pdf", tmp_path / "sheets"
    for path in (pdf, folder):
        # the last of them cannot be printed
        with pytest.raises(GeometryError, match="marker 250"):
            write_sheets(path, [249, 250], LAYOUT)
        assert not path.exists()
    pdf.write_text("mine")
    with pytest.raises(InputError, match=r"sheets\.pdf exists already.*--force"):
        write_sheets(pdf, [1], LAYOUT)
    assert pdf.read_text() == "mine"
    write_sheets(pdf, [1], LAYOUT, overwrite=True)
    assert pdf.read_bytes().startswith(b"%PDF")
    folder.mkdir()
    (folder / "marker_002.png").write_text("mine")
    with pytest.raises(InputError, match=r"marker_002\.png exists already\."):
        write_sheets(folder, [1, 2, 3], LAYOUT)
    assert [file.name for file in folder.iterdir()] == ["marker_002.png"]
    # others of the folder are in nobody's way
    write_sheets(folder, [3], LAYOUT)
    with pytest.raises(InputError, match=r"'marker\.png' is the name of a picture"):
        write_sheets(tmp_path / "marker.png", [3], LAYOUT)
