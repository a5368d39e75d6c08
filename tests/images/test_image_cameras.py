"""Which images one camera took, and the interior orientation that each camera begins with."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from tests.images.block_scene import FREE, OPTIONS, scene, without_points
from tests.images.sfm_scene import PERSPECTIVE, longer
from thalweg.core import Camera, GeometryError, InputError
from thalweg.images.bundle import interiors_of
from thalweg.images.bundle.adjustment import adjust_block, adjusted_cameras
from thalweg.images.bundle.job import camera_table, main_camera
from thalweg.images.bundle.run import orient_block
from thalweg.images.masks import make_masks_of_cameras
from thalweg.images.masks.images import KnownCameras
from thalweg.images.model import ImageBlock, Picture, camera_note, cameras_of, in_folders
from thalweg.images.sfm.matching import Known, assign_cameras
from thalweg.ingest.photos import named_images
from thalweg.settings.sections import MaskSettings

LONG = longer(1.6)
"""A camera of the same picture size with 432 px instead of 270 px."""


def photograph(path: Path, size: tuple[int, int] = (320, 240), **tags: Any) -> None:
    """An image whose EXIF states make, model, serial, focal_mm and focal_35mm, where given."""
    path.parent.mkdir(parents=True, exist_ok=True)
    exif = Image.Exif()
    for name, tag in (("make", 0x010F), ("model", 0x0110)):
        if name in tags:
            exif[tag] = tags[name]
    for name, tag in (("serial", 0xA431), ("focal_mm", 0x920A), ("focal_35mm", 0xA405)):
        if name in tags:
            exif.get_ifd(0x8769)[tag] = tags[name]
    Image.new("L", size).save(path, exif=exif)


def grouped(folder: Path, by: str, folders: tuple[str, ...] = ()) -> dict[str, list[str]]:
    return {c.name: list(c.images) for c in cameras_of(named_images([folder]), by, folders)}


@pytest.fixture
def two_folders(tmp_path):
    for name in ("left/1.jpg", "left/2.jpg", "right/1.jpg"):
        photograph(tmp_path / name, make="A", model="B", focal_mm=24.0)
    return tmp_path


def test_folders_tell_cameras_apart(two_folders):
    apart = {"left": ["left/1.jpg", "left/2.jpg"], "right": ["right/1.jpg"]}
    assert grouped(two_folders, "auto") == grouped(two_folders, "folder") == apart
    whole = {"camera": ["left/1.jpg", "left/2.jpg", "right/1.jpg"]}
    assert grouped(two_folders, "exif") == grouped(two_folders, "size") == whole
    # an interior orientation of its own makes a camera of a folder whatever else tells them apart
    assert list(grouped(two_folders, "size", ("right",))) == ["left", "right"]
    note = camera_note(cameras_of(named_images([two_folders])))
    assert "images of 2 cameras" in note
    assert "left (2 images), right (1 images)" in note
    assert in_folders(["left/1.jpg", "leftover/1.jpg", "1.jpg"], ["left"]).tolist() == [True, False, False]


def test_folders_below_that_of_an_interior_belong_to_it(tmp_path):
    for name in ("left/100/1.jpg", "left/101/2.jpg", "right/1.jpg"):
        photograph(tmp_path / name)
    assert len(grouped(tmp_path, "auto")) == 3
    assert grouped(tmp_path, "auto", ("left",)) == {
        "left": ["left/100/1.jpg", "left/101/2.jpg"],
        "right": ["right/1.jpg"],
    }
    with pytest.raises(InputError, match=r"no image in the folder 'mid'; expected one of left/100, left/101"):
        grouped(tmp_path, "auto", ("mid",))
    with pytest.raises(InputError, match="told apart by 'colour'"):
        grouped(tmp_path, "colour")


def test_one_serial_number_in_two_folders_is_one_camera(tmp_path):
    """A card holds 100CANON and 101CANON."""
    for name in ("100/1.jpg", "101/2.jpg"):
        photograph(tmp_path / name, make="A", model="B", serial="77", focal_mm=24.0)
    assert grouped(tmp_path, "auto") == {"camera": ["100/1.jpg", "101/2.jpg"]}
    assert len(grouped(tmp_path, "folder")) == 2


@pytest.mark.parametrize(
    "other",
    [{"model": "C"}, {"make": "Z"}, {"serial": "78"}, {"focal_mm": 35.0}],
    ids=lambda o: next(iter(o)),
)
def test_exif_tells_cameras_of_one_folder_apart(tmp_path, other):
    usual = {"make": "A", "model": "B", "serial": "77", "focal_mm": 24.0}
    for k in (1, 2, 4):
        photograph(tmp_path / f"{k}.jpg", **usual)
    photograph(tmp_path / "3.jpg", **{**usual, **other})
    for by in ("auto", "exif"):
        assert grouped(tmp_path, by) == {"camera": ["1.jpg", "2.jpg", "4.jpg"], "camera 2": ["3.jpg"]}
    assert grouped(tmp_path, "folder") == {"camera": [f"{k}.jpg" for k in range(1, 5)]}


def assigned(folder: Path, given: Known, by: str = "auto", **options: str) -> Any:
    images = named_images([folder])
    pictures = []
    for name, path in images.items():
        with Image.open(path) as image:
            pictures.append(Picture(name=name, size_px=image.size))
    groups = cameras_of(images, by, tuple(given.of_folder))
    return assign_cameras(pictures, images, groups, given, **options)


def test_each_camera_begins_with_its_own_interior_orientation(two_folders):
    found = assigned(two_folders, Known(cameras=(PERSPECTIVE,), of_folder={"right": LONG}))
    assert found.camera.tolist() == [0, 0, 1]
    assert [s.camera.parameters[0] for s in found.starts] == [270.0, 432.0]
    assert [s.camera.name for s in found.starts] == ["left", "right"]
    assert [s.source for s in found.starts] == ["given", "given"]
    # the common one for both, each with parameters of its own
    same = assigned(two_folders, Known(cameras=(PERSPECTIVE,)))
    assert same.camera.tolist() == [0, 0, 1]
    assert [s.camera.parameters[0] for s in same.starts] == [270.0, 270.0]
    # none for the left one: a guess there, and none is allowed to be held fixed
    one = assigned(two_folders, Known(of_folder={"right": LONG}))
    assert [s.source == "given" for s in one.starts] == [False, True]
    with pytest.raises(InputError, match=r"none is given for left/1\.jpg"):
        assigned(two_folders, Known(of_folder={"right": LONG}), interior="fixed")


def test_an_interior_orientation_is_scaled_to_the_pictures_of_its_folder(tmp_path):
    photograph(tmp_path / "left" / "1.jpg", (640, 480))
    photograph(tmp_path / "left" / "2.jpg", (640, 400))
    photograph(tmp_path / "right" / "1.jpg")
    found = assigned(tmp_path, Known(cameras=(PERSPECTIVE,), of_folder={"left": LONG}))
    assert found.starts[0].camera.size_px == (640, 480)
    assert found.starts[0].camera.parameters[0] == 864.0
    assert found.camera.tolist() == [0, -1, 1]
    assert [p.cause for p in found.pictures] == ["", "size", ""]
    assert "640 x 400 pixels, the camera has 320 x 240" in found.pictures[1].problem


def test_another_zoom_is_estimated_and_another_lens_alone_refused(tmp_path):
    # COLMAP takes the diagonal of the film: 29.2 mm and 46.7 mm are 270 px and 432 px of 400 px
    for k, focal in enumerate((29, 29, 47)):
        photograph(tmp_path / f"{k}.jpg", focal_35mm=focal, focal_mm=float(focal))
    found = assigned(tmp_path, Known(cameras=(PERSPECTIVE,)))
    assert found.camera.tolist() == [0, 0, 1]
    assert found.starts[0].camera.parameters[0] == 270.0
    assert found.starts[1].camera.parameters[0] == pytest.approx(47 / 43.267 * 400, rel=1e-3)
    assert any("theirs is estimated" in note for note in found.notes)
    with pytest.raises(InputError, match=r"a focal length of 600 px .* and 268 px by the EXIF"):
        assigned(tmp_path, Known(cameras=(longer(600 / 270),)), by="size")


def block_of(images: list[str], camera: list[int], cameras: tuple[Camera, ...]) -> ImageBlock:
    n = len(images)
    found = without_points(cameras, images, np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)))
    return replace(found, camera=np.array(camera))


def test_each_camera_of_a_block_has_its_calibration():
    left, right = replace(PERSPECTIVE, name="left"), replace(LONG, name="right")
    block = block_of(["left/1.jpg", "right/1.jpg", "right/2.jpg"], [0, 1, 1], (left, right))
    assert interiors_of([block_of(["1.jpg"], [0], (LONG,))], PERSPECTIVE, {}) is PERSPECTIVE
    both = interiors_of([block], PERSPECTIVE, {"right": LONG})
    assert {name: c.parameters[0] for name, c in both.items()} == {"left": 270.0, "right": 432.0}
    # 432 px are not of a calibration with 270 px
    assert list(interiors_of([block], PERSPECTIVE, {})) == ["left"]
    # the innermost folder counts
    deep = block_of(["right/100/1.jpg"], [0], (right,))
    folders = {"right": LONG, "right/100": longer(1.7), "right/1": PERSPECTIVE}
    assert interiors_of([deep], None, folders)["right"].parameters[0] == pytest.approx(1.7 * 270.0)
    assert main_camera((left, right), block).name == "right"
    table = camera_table([(left, right)], [block])
    assert table[["camera", "images", "first", "fx"]].values.tolist() == [
        ["left", 1, "left/1.jpg", 270.0],
        ["right", 2, "right/1.jpg", 432.0],
    ]


def test_two_cameras_in_one_adjustment():
    """Every second image with 1.4 times the focal length: distances from the principal point grow by it."""
    problem, truth = scene(np.random.default_rng(3), images=24, points=500)
    block, own, of = problem.block, problem.marks, np.arange(24) % 2
    middle, times = truth.camera.parameters[2:4], np.array([1.0, 1.4])
    marks_px, own_px = (
        middle + times[of[image], None] * (xy - middle)
        for image, xy in ((block.mark_image, block.mark_px), (own.image, own.xy_px))
    )
    cameras = (block.cameras[0], longer(1.4, block.cameras[0]))
    problem = replace(
        problem,
        block=replace(block, cameras=cameras, camera=of, mark_px=marks_px),
        marks=replace(own, xy_px=own_px),
        free=(FREE, FREE),
        weighted=(False, False),
    )
    found = adjust_block(problem, OPTIONS)
    for camera, factor in zip(adjusted_cameras(found), (1.0, 1.4), strict=True):
        sigma = np.sqrt(camera.cov[0, 0])
        assert 0 < sigma < 3.0
        # four sigmas of two cameras: one draw in 8000 is beyond
        assert abs(camera.parameters[0] - factor * truth.camera.parameters[0]) < 4 * sigma


def test_one_camera_is_weighted_and_the_other_estimated():
    """The given one keeps its sigma of 0.5 px or less, in the world that control points make."""
    problem, truth = scene(np.random.default_rng(4), images=24, points=500)
    cov = np.diag([0.25, 0.25, 0.25, 0.25, 1e-6, 1e-6, 1e-8, 1e-8, 0.0])
    left = replace(problem.block.cameras[0], name="left")
    block = replace(problem.block, cameras=(left, replace(left, name="right")), camera=np.arange(24) % 2)
    given = replace(truth.camera, cov=cov, name="given")
    given_to = block, problem.control, problem.marks
    found = orient_block(*given_to, OPTIONS, known={"left": given})
    assert found.adjusted.problem.weighted == (True, False)
    sigma = [np.sqrt(camera.cov[0, 0]) for camera in adjusted_cameras(found.adjusted)]
    assert sigma[0] < 0.5
    assert sigma[0] < sigma[1]
    with pytest.raises(GeometryError, match="no interior orientation is given for right"):
        orient_block(*given_to, OPTIONS.replace(interior="fixed"), known={"left": given})


def test_masks_are_learned_for_each_camera(tmp_path):
    """One picture of each camera has a supplied mask; masks stand in folders like their images."""
    rng = np.random.default_rng(5)
    for name in ("left/1.png", "left/2.png", "right/1.png"):
        (tmp_path / "photos" / name).parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(tmp_path / "photos" / name), rng.integers(0, 256, (60, 80, 3)).astype(np.uint8))
    images = named_images([tmp_path / "photos"])
    (tmp_path / "given" / "left").mkdir(parents=True)
    Image.new("L", (80, 60)).save(tmp_path / "given" / "left" / "1.png.png")
    out, how = tmp_path / "out", (MaskSettings(), KnownCameras())
    table = make_masks_of_cameras(images, out, *how, supplied=tmp_path / "given")
    assert table["image"].tolist() == list(images)
    assert table["source"].tolist() == ["supplied", "automatic", "automatic"]
    assert all((out / f"{name}.png").is_file() for name in images)
    assert "right: none of its 1 images has a supplied mask" in table.attrs["notes"]
    # in one folder it cannot be told whose mask 1.png is
    (tmp_path / "flat").mkdir()
    Image.new("L", (80, 60)).save(tmp_path / "flat" / "1.png.png")
    with pytest.raises(
        InputError, match=r"one mask 1.png.png for left/1.png and right/1.png; expected folders"
    ):
        make_masks_of_cameras(images, out, *how, supplied=tmp_path / "flat")
