"""Names of other images, damaged files, and what is not there."""

import re
from dataclasses import replace

import numpy as np
import pytest

from tests.images.finished_scene import (
    TRUTH,
    Scene,
    assert_poses,
    imported,
    predictions,
    table,
    write_colmap_text,
    write_metashape,
)
from thalweg.core import InputError
from thalweg.images.imports.poses import NOT_IN_FILE
from thalweg.images.model import matched

# ---------------------------------------------------------------- names


def test_names_are_matched_from_strict_to_loose():
    images = ["a/IMG_1.JPG", "b/IMG_1.JPG", "IMG_2.JPG", "img_3.png"]
    names = ["b/IMG_1.JPG", "C:\\photos\\img_2.jpg", "IMG_3", "IMG_1", "other"]
    assert matched(names, images, "file").tolist() == [1, 2, 3, -1, -1]
    with pytest.raises(InputError, match=r"IMG_2 and img_2\.JPG both mean the image IMG_2\.JPG"):
        matched(["IMG_2", "img_2.JPG"], images, "file")


def test_images_that_the_file_lacks_have_a_reason(tmp_path):
    path = table(tmp_path / "eo.txt", names=TRUTH.images[:9], of=Scene((), TRUTH.C[:9], TRUTH.R[:9]))
    path.write_text(path.read_text() + "stranger.jpg\t0\t0\t0\t0\t0\t0\n")
    found = imported(path)
    assert found.poses.reasons == ("",) * 9 + (NOT_IN_FILE,) * 3
    assert found.facts["files"][0]["not_of_the_campaign"] == ["stranger.jpg"]
    assert found.facts["oriented"] == 9


def test_a_file_of_other_images_is_refused(tmp_path):
    path = table(tmp_path / "eo.txt", names=[f"DSC{k}.jpg" for k in range(12)])
    with pytest.raises(InputError, match=r"0 of 12 images .* not so DSC0\.jpg, DSC1\.jpg"):
        imported(path)


def test_without_predictions_nothing_is_checked_and_that_is_said(tmp_path):
    blind = replace(predictions(), oriented=np.zeros(12, np.bool_))
    found = imported(table(tmp_path / "eo.txt"), given=blind)
    assert_poses(found)
    assert "could not be checked" in found.facts["notes"][1]


# ---------------------------------------------------------------- damaged files


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "the file is empty"),
        ("image,x,y,z,omega,phi,kappa\n", "no row"),
        ("a.jpg 1 2 3\n", "no column image, x, y, z, omega, phi, kappa among column 1"),
        ("a.jpg 1 2 3 4 5 six\n", "kappa 'six'"),
        ("a b.jpg 1 2 3 4 5 6\nc.jpg 1 2 3 4 5 6\nd.jpg 1 2 3 4 5 6\n", "eo.txt:1: 1 of 3 rows have more"),
        ("label,x,y,z,yaw,pitch,roll\na,1,2,3,4,5,6\n", "export omega, phi, kappa"),
        ("image,x,y,omega,phi,kappa\na,1,2,4,5,6\n", "no column z"),
        ("image,x,y,z,omega [deg],phi [gon],kappa\na,1,2,3,4,5,6\n", "angles in deg and gon"),
        ("image,x,y,z,omega,phi,kappa,sx\na,1,2,3,4,5,6,0\n", "a standard deviation of 0 m of a"),
        ("a.jpg 1 2 3 4 5 6\na.jpg 1 2 3 4 5 6\n", r"two poses of a.jpg"),
        ("a.jpg 1 2 nan 4 5 6\n", "z 'nan'"),
        (",1,2,3,4,5,6\n", "eo.txt:1: no image"),
    ],
)
def test_damaged_tables(tmp_path, text, words):
    path = tmp_path / "eo.txt"
    path.write_text(text)
    with pytest.raises(InputError) as found:
        imported(path)
    assert words in str(found.value)
    assert "eo.txt" in str(found.value)


@pytest.mark.parametrize(
    ("crs", "words"), [(None, "coordinates without a CRS"), ("EPSG:1", "'EPSG:1' is not known")]
)
def test_a_table_without_a_known_crs_is_refused(tmp_path, crs, words):
    with pytest.raises(InputError, match=words):
        imported(table(tmp_path / "eo.txt"), crs=crs)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("<chunk ", "<other ", "no XML"),
        ("</document>", "<chunk><camera/></chunk></document>", "2 chunks"),
        ("<transform><rotation>", "<transform><rotation>x ", "9 numbers"),
        ("<scale>3.7", "<scale>-3.7", "positive number"),
        ("<f>582.0", "<f>wide", "'wide' of f of Sensor 'boat'"),
        ("metre&quot;,1", "foot&quot;,0.3048", "Local Coordinates (m)'; expected metres"),
    ],
)
def test_damaged_xml(tmp_path, old, new, words):
    path = write_metashape(tmp_path / "c.xml")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as found:
        imported(path)
    assert words in str(found.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("582 583 361 270", "50 50 18 12", "focal lengths 50, 50 and principal point"),
        (" 7 run/IMG_0003.JPG", "", "no pose"),
        (r"^4 \S+", "4 9.0", "length"),
        ("7 OPENCV 720", "7 OPENCV wide", "no camera"),
        (" -2e-4", "", "7 parameters"),
    ],
)
def test_damaged_colmap_text(tmp_path, old, new, words):
    folder = write_colmap_text(tmp_path / "m", points=False)
    for path in (folder / "images.txt", folder / "cameras.txt"):
        text = path.read_text()
        path.write_text(re.sub(rf"(?m){old}", new, text))
    with pytest.raises(InputError) as found:
        imported(folder)
    assert words in str(found.value)


def test_damaged_binary_models_give_our_errors_only(tmp_path, rng):
    pycolmap = pytest.importorskip("pycolmap")
    folder = write_colmap_text(tmp_path / "text", points=False)
    binary = tmp_path / "binary"
    binary.mkdir()
    pycolmap.Reconstruction(str(folder)).write_binary(str(binary))
    whole = {name: (binary / name).read_bytes() for name in ("images.bin", "cameras.bin")}
    clean = 0
    for k in range(200):
        name = ("images.bin", "cameras.bin")[k % 2]
        data = bytearray(whole[name])
        for at in rng.integers(len(data), size=3):
            data[at] = int(rng.integers(256))
        (binary / name).write_bytes(bytes(data[: len(data) - (k % 5)]))
        try:
            imported(binary)
            clean += 1
        except InputError:
            pass
        (binary / name).write_bytes(whole[name])
    # digits behind the eighth of a number, or a letter of one name, do no harm
    assert 0 < clean < 150


def test_what_is_not_there_or_no_model(tmp_path):
    for path, words in ((tmp_path / "none.txt", "file not found"), (tmp_path, "without images")):
        with pytest.raises(InputError, match=words):
            imported(path, crs=None)
    with pytest.raises(InputError, match="no file"):
        imported(crs=None)
