"""Folders of pictures to a table of marks, and what is told about pictures that cannot be used."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from thalweg.calibration import (
    MARKS,
    MarkerLayout,
    detect_pictures,
    recordings_folder,
    report_of,
    sheet_picture,
)
from thalweg.calibration.markers import FolderMarks, read_grey
from thalweg.core import InputError, read_table, write_table
from thalweg.ingest.photos import list_images

LAYOUT = MarkerLayout()


def picture(ids: list[int], width: int = 600) -> np.ndarray:
    """Sheets side by side on grey."""
    image = np.full((180, width), 120, np.uint8)
    for k, marker in enumerate(ids):
        image[20:152, 20 + 145 * k : 152 + 145 * k] = sheet_picture(marker, LAYOUT, 12) // 2 + 60
    return image


def saved(folder: Path, images: dict[str, np.ndarray]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, image in images.items():
        cv2.imwrite(str(folder / name), image)
    return folder


def found_in(folder: Path, images: dict[str, np.ndarray]) -> FolderMarks:
    return detect_pictures({"slr": list_images(saved(folder, images))}, LAYOUT)


def test_table_of_marks(tmp_path):
    folder = saved(
        tmp_path / "reference", {"b.jpg": picture([1, 2, 3]), "a.png": picture([4]), "c.jpg": picture([])}
    )
    (folder / "notes.txt").write_text("no picture")
    told: list[str] = []
    found = detect_pictures({"slr": list_images(folder)}, LAYOUT, base=tmp_path, threads=2, told=told.append)
    write_table(tmp_path / "marks.parquet", found.marks, MARKS)
    table, _ = read_table(tmp_path / "marks.parquet", MARKS)
    assert table.groupby("image")["marker"].unique().map(list).to_dict() == {"a.png": [4], "b.jpg": [1, 2, 3]}
    assert table["file"].unique().tolist() == ["reference/a.png", "reference/b.jpg"]
    # drawn upright: saddle 0 is 1.5 modules of 12 px from the sheet's corner; JPEG moves it by 0.05 px
    first = table[(table["marker"] == 2) & (table["corner"] == 0)].iloc[0]
    assert (first.x_px, first.y_px) == (pytest.approx(165 + 18, abs=0.05), pytest.approx(20 + 18, abs=0.05))
    assert first.size_px == pytest.approx(96, abs=1.0)
    counts = {"images": 3, "images_without_markers": 1, "markers": 4, "marks": 16}
    report = report_of(found)
    assert report | counts == report
    assert report["notes"] == ["no marker in 1 of 3 pictures: c.jpg"]
    assert sorted(told)[0] == "a.png: 4 marks of 1 markers"
    assert found.size_px("slr") == (600, 180)


def test_a_note_on_how_the_camera_was_held_turns_no_pixels(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(picture([1])).save(tmp_path / "a.jpg", exif=exif)
    assert read_grey(tmp_path / "a.jpg").shape == (180, 600)


def test_an_id_that_exists_twice_is_left_out_everywhere(tmp_path):
    found = found_in(tmp_path, {"a.png": picture([1, 2, 1]), "b.png": picture([1, 3])})
    assert sorted(set(found.marks["marker"])) == [2, 3]
    (note,) = report_of(found)["notes"]
    assert note.startswith("marker 1 in a.png: seen twice in one picture; the id exists twice")


def test_mirrored_sheets_and_pictures(tmp_path):
    sheet = picture([1, 2, 3])
    sheet[20:152, 165:297] = sheet[20:152, 165:297][:, ::-1]
    found = found_in(tmp_path / "one", {"a.png": sheet})
    assert sorted(set(found.marks["marker"])) == [1, 3]
    assert report_of(found)["notes"] == [
        "marker 2 in a.png: reads only in the mirror; the sheet is printed mirrored: print it again"
    ]
    with pytest.raises(InputError, match=r"3 markers read only in the mirror, so in a.png") as caught:
        found_in(tmp_path / "all", {"a.png": np.fliplr(picture([1, 2, 3]))})
    assert "original files" in caught.value.cure


def test_what_is_no_set_of_pictures(tmp_path):
    with pytest.raises(InputError, match="no photograph in this folder"):
        list_images(tmp_path)
    with pytest.raises(InputError, match="no pictures"):
        recordings_folder([])
    with pytest.raises(InputError, match=r"differ in size \(a.png: 600 x 180; b.png: 700 x 180\)"):
        found_in(tmp_path / "mixed", {"a.png": picture([1]), "b.png": picture([1], 700)})
    again = saved(tmp_path / "again", {"a.png": picture([1])})
    with pytest.raises(InputError, match=r"two pictures are called a.png"):
        detect_pictures({"slr": [*list_images(again), tmp_path / "mixed/a.png"]}, LAYOUT)
    (tmp_path / "broken.jpg").write_bytes(b"\xff\xd8\xff broken")
    for name, answer in (("broken.jpg", "not a picture"), ("none.jpg", "file not found")):
        with pytest.raises(InputError, match=answer):
            read_grey(tmp_path / name)
