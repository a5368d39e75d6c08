"""Photographs in folders below folders: which are read, how they are called, what is counted."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from thalweg.core import InputError
from thalweg.ingest.photos import by_any_name, list_images, named_images, read_image_stamps, read_mask
from thalweg.ingest.photos.files import find_images


def photographs(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if name.lower().endswith((".jpg", ".png")):
            Image.new("L", (8, 6)).save(folder / name)
        else:
            (folder / name).write_text("x")
    return folder


STAMPED = ("left/a_20210512_083107.jpg", "left/a_20210512_083108.jpg", "right/a_20210512_083107.jpg")


def test_folders_below_are_read_and_the_rest_is_counted(tmp_path):
    folder = photographs(
        tmp_path / "photos",
        "IMG_10.jpg",
        "IMG_2.JPG",
        "low/IMG_1.jpg",
        "low/deep/IMG_3.jpg",
        "notes.txt",
        "IMG_2.cr2",
        "._IMG_2.jpg",
        ".thumbs/IMG_2.jpg",
        "@eaDir/IMG_2.jpg",
        "IMG_2.JPG.png",
        "IMG_10_mask.png",
        "masks/IMG_10.png",
        "low/IMG_9_mask.png",
    )
    found = find_images(folder)
    names = [path.relative_to(folder).as_posix() for path in found.files]
    # a mask of no photograph is a photograph whose name happens to end so
    assert names == ["IMG_2.JPG", "IMG_10.jpg", "low/IMG_1.jpg", "low/IMG_9_mask.png", "low/deep/IMG_3.jpg"]
    assert len(found.files) + len(found.others) == 13
    assert found.others_in_words().startswith("8 other files beside the photographs are not read: ")
    assert "1 .cr2" in found.others_in_words()
    assert list(named_images([folder])) == names


def test_one_folder_of_images_keeps_the_names_of_its_files(tmp_path):
    folder = photographs(tmp_path / "photos", "b.jpg", "a_10.jpg", "a_9.jpg")
    assert list(named_images([folder])) == ["a_9.jpg", "a_10.jpg", "b.jpg"]
    assert named_images([folder / "b.jpg"]) == {"b.jpg": folder / "b.jpg"}
    # what has names keeps them
    assert list(named_images({"z_10": folder / "b.jpg", "z_9": folder / "a_9.jpg"})) == ["z_9", "z_10"]
    # who reads a missing file says so
    assert list(named_images([folder / "b.jpg", folder / "absent.jpg"])) == ["absent.jpg", "b.jpg"]


def test_names_are_those_below_the_common_folder(tmp_path):
    photographs(tmp_path, "left/1.jpg", "right/1.jpg", "right/low/2.jpg")
    names = ["left/1.jpg", "right/1.jpg", "right/low/2.jpg"]
    assert list(named_images([tmp_path / "right", tmp_path / "left"])) == names
    assert list(named_images([tmp_path])) == names
    assert list(named_images([tmp_path / name for name in names])) == names
    with pytest.raises(InputError, match=r"right/1.jpg is named twice.*no folder beside one that holds it"):
        named_images([tmp_path, tmp_path / "right"])
    with pytest.raises(InputError, match="no photographs"):
        named_images([])


def test_readers_that_know_names_of_files_only_refuse_two_of_them(tmp_path):
    photographs(tmp_path, "left/1.jpg", "right/1.jpg")
    with pytest.raises(InputError, match=r"two images of the name 1.jpg below one folder.*Rename one"):
        list_images(tmp_path)
    # two folders that were named may hold the same name: their reader says what it makes of it
    assert len(list_images([tmp_path / "left", tmp_path / "right"])) == 2


def test_a_folder_that_links_to_itself_is_read_once(tmp_path):
    photographs(tmp_path / "photos", "1.jpg")
    photographs(tmp_path / "elsewhere", "2.jpg")
    (tmp_path / "photos" / "round").symlink_to(tmp_path / "photos")
    (tmp_path / "photos" / "more").symlink_to(tmp_path / "elsewhere")
    assert list(named_images([tmp_path / "photos"])) == ["1.jpg", "more/2.jpg"]


def test_stamps_of_images_of_one_name_in_two_folders(tmp_path):
    photographs(tmp_path, *STAMPED, "notes.txt")
    found = read_image_stamps(tmp_path, folders=True)
    assert found.table["file"].tolist() == [STAMPED[0], STAMPED[2], STAMPED[1]]
    assert found.report.counts["other_files"] == 1
    with pytest.raises(InputError, match=r"two images of the name a_20210512_083107.jpg"):
        read_image_stamps(tmp_path)
    # the clock of neither camera went back
    assert "steps_back" not in found.report.losses
    assert "1 other files beside the photographs are not read: 1 .txt." in found.report.notes


def test_a_table_of_times_names_images_with_folders_where_it_must(tmp_path):
    photographs(tmp_path / "photos", "left/1.jpg", "left/2.jpg", "right/1.jpg")
    table = tmp_path / "times.csv"

    def stamps(*rows):
        table.write_text("file,unix_s\n" + "".join(f"{row}\n" for row in rows))
        found = read_image_stamps(tmp_path / "photos", times=table, folders=True).table
        return dict(zip(found["file"], found["t_device_s"] - found["t_device_s"].min(), strict=True))

    second = 1_620_808_267
    given = stamps(f"left/1.jpg,{second}", f"C:\\photos\\left\\2.jpg,{second + 1}", f"right\\1,{second + 2}")
    assert given == {"left/1.jpg": 0.0, "left/2.jpg": 1.0, "right/1.jpg": 2.0}
    with pytest.raises(InputError, match=r"'1\.jpg' may mean images of several folders; expected names with"):
        stamps(f"1.jpg,{second}")
    with pytest.raises(InputError, match="stands there twice"):
        stamps(f"left/2.jpg,{second}", f"2.jpg,{second}")


def test_names_as_people_write_them():
    found = by_any_name(["left/a.jpg", "right/a.jpg", "right/b.b.jpg"])
    assert found["left/a"] == "left/a.jpg"
    assert found["b.b"] == found["b.b.jpg"] == "right/b.b.jpg"
    assert "a.jpg" not in found


@pytest.mark.parametrize("mode", ["L", "1", "LA", "RGBA", "P", "I;16"])
def test_a_mask_leaves_out_what_is_black_or_transparent(tmp_path, mode):
    """Of pictures that were cut out, transparent around what is meant, nothing was masked."""
    usable = np.arange(12).reshape(3, 4) % 2 > 0
    if mode in ("LA", "RGBA"):
        picture = Image.new(mode, (4, 3), (200,) * len(mode))
        picture.putalpha(Image.fromarray(usable.astype(np.uint8) * 255))
    elif mode == "I;16":
        picture = Image.fromarray(usable.astype(np.uint16) * 65_535)
    else:
        picture = Image.fromarray(usable.astype(np.uint8) * 255).convert(mode)
    picture.save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "a.png", (8, 6)), usable)
    with pytest.raises(InputError, match="a mask of 4 x 3 pixels, the image has 6 x 8"):
        read_mask(tmp_path / "a.png", (6, 8))
