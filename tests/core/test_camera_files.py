"""Camera files of COLMAP, OpenCV and ROS: conventions, round trips, refusals."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from thalweg.core import (
    Camera,
    InputError,
    UnsupportedError,
    read_colmap,
    read_metashape,
    read_opencv,
    write_colmap,
    write_opencv,
)
from thalweg.core.camera import check_lens

BROWN = Camera(
    model="perspective",
    size_px=(4592, 3448),
    parameters=np.array([3717.25, 3711.0, 2301.0, 1720.0, -0.11, 0.08, 3e-4, -5e-4, -0.02]),
    name="boat",
)
FISHEYE = Camera(
    model="fisheye",
    size_px=(1920, 1208),
    parameters=np.array([1176.93, 1177.72, 962.775, 613.225, -0.0540096, -0.0784275, 0.0959641, -0.0515253]),
    name="boat",
)


@pytest.mark.parametrize("camera", [BROWN, FISHEYE], ids=lambda c: c.model)
@pytest.mark.parametrize("name", ["camera.yaml", "camera.json", "cameras.txt"])
def test_round_trip(tmp_path, camera, name):
    path = tmp_path / name
    if name.endswith(".txt"):
        write_colmap(path, {3: camera})
        found = read_colmap(path)[3]
    else:
        write_opencv(path, camera)
        found = read_opencv(path)
        assert found.name == "boat"
    assert (found.model, found.size_px) == (camera.model, camera.size_px)
    # repr of a float64 is exact; 0.5 off and on rounds the last digit of cx
    assert_allclose(found.parameters, camera.parameters, rtol=1e-15)


@pytest.mark.parametrize("suffix", ["yaml", "json"])
def test_opencv_reads_ours_and_we_read_opencvs(tmp_path, suffix):
    path = tmp_path / f"camera.{suffix}"
    K = np.array([[3717.25, 0, 2300.5], [0, 3711.0, 1719.5], [0, 0, 1.0]])
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 4592)
    storage.write("image_height", 3448)
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", BROWN.parameters[None, 4:])
    storage.release()
    # OpenCV writes 16 digits
    assert_allclose(read_opencv(path).parameters, BROWN.parameters, rtol=1e-14)
    ours = tmp_path / "ours.yaml"
    write_opencv(ours, BROWN)
    storage = cv2.FileStorage(str(ours), cv2.FILE_STORAGE_READ)
    assert_allclose(storage.getNode("camera_matrix").mat(), K)
    assert_allclose(storage.getNode("distortion_coefficients").mat().ravel(), BROWN.parameters[4:])


def test_camera_info_of_a_real_set(tmp_path):
    """As the ACFR calibration set has it: lists K and D, ROS's centre of the first pixel as (0, 0)."""
    path = tmp_path / "camera_info.yaml"
    path.write_text(
        'distortion_model: "fisheye"\nwidth: 1920\nheight: 1208\n'
        "D: [-0.0540096,-0.0784275,0.0959641,-0.0515253]\n"
        "K: [1176.93,0.0,962.275,0.0,1177.72,612.725,0.0,0.0,1]\n"
    )
    found = read_opencv(path)
    assert (found.model, found.size_px, found.name) == ("fisheye", (1920, 1208), "camera_info")
    assert_allclose(found.parameters, FISHEYE.parameters, rtol=1e-12)


@pytest.mark.parametrize(
    ("line", "parameters"),
    [
        ("1 SIMPLE_PINHOLE 100 80 90 50 40", [90, 90, 50, 40, 0, 0, 0, 0, 0]),
        ("1 PINHOLE 100 80 90 91 50 40", [90, 91, 50, 40, 0, 0, 0, 0, 0]),
        ("1 SIMPLE_RADIAL 100 80 90 50 40 -0.1", [90, 90, 50, 40, -0.1, 0, 0, 0, 0]),
        ("1 RADIAL 100 80 90 50 40 -0.1 0.2", [90, 90, 50, 40, -0.1, 0.2, 0, 0, 0]),
        ("1 OPENCV 100 80 90 91 50 40 1 2 3 4", [90, 91, 50, 40, 1, 2, 3, 4, 0]),
        ("1 FULL_OPENCV 100 80 90 91 50 40 1 2 3 4 5 0 0 0", [90, 91, 50, 40, 1, 2, 3, 4, 5]),
        ("1 SIMPLE_RADIAL_FISHEYE 100 80 90 50 40 0.1", [90, 90, 50, 40, 0.1, 0, 0, 0]),
        ("1 RADIAL_FISHEYE 100 80 90 50 40 0.1 0.2", [90, 90, 50, 40, 0.1, 0.2, 0, 0]),
        ("1 OPENCV_FISHEYE 100 80 90 91 50 40 1 2 3 4", [90, 91, 50, 40, 1, 2, 3, 4]),
    ],
)
def test_models_of_colmap(tmp_path, line, parameters):
    path = tmp_path / "cameras.txt"
    path.write_text(f"# Camera list\n{line}\n")
    assert_array_equal(read_colmap(path)[1].parameters, parameters)


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        ("1 OPENCV 100 80 90 91 50", "expected number model width height fx, fy"),
        ("1 FOV 100 80 90 91 50 40 1", "camera model FOV"),
        ("1 FULL_OPENCV 100 80 90 91 50 40 1 2 3 4 5 0.1 0 0", "rational distortion"),
        ("1 PINHOLE 100 80 -90 91 50 40", "positive focal lengths"),
        ("1 PINHOLE 100 80 90 91 50 40\n1 PINHOLE 100 80 90 91 50 40", "stands twice"),
        ("# nothing", "no camera"),
    ],
)
def test_wrong_colmap_files(tmp_path, text, answer):
    path = tmp_path / "cameras.txt"
    path.write_text(text + "\n")
    with pytest.raises(InputError, match=answer):
        read_colmap(path)


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        ("K: [1, 0, 5, 0, 1, 5, 0, 0, 1]\nD: [1, 2, 3, 4]\nwidth: 9\nheight: 9", "no distortion_model"),
        ("K: [1, 0.2, 5, 0, 1, 5, 0, 0, 1]\nD: [0, 0, 0, 0, 0]\nwidth: 9\nheight: 9", "skew"),
        *(
            (f"K: [1, 0, 5, 0, 1, 5, 0, 0, 1]\nD: [0, 0, 0, 0, 0]{size}", "no size of the picture")
            for size in (
                "",
                "\nwidth: 9",
                "\nheight: 9",
                "\nwidth: 9\nheight: tall",
                "\nwidth: wide\nheight: 9",
            )
        ),
        ("K: [1, 0, 5]\nD: [0, 0, 0, 0, 0]\nwidth: 9\nheight: 9", "3 numbers"),
        ("D: [0, 0, 0, 0, 0]\nwidth: 9\nheight: 9", "none of the keys K"),
        ("K: [a]\nD: [0, 0, 0, 0, 0]\nwidth: 9\nheight: 9", "no numbers"),
        ("- 1", "no keys"),
        (
            "K: [9, 0, 5, 0, 9, 5, 0, 0, 1]\nD: [0, 0, 0, 0]\ndist_coeffs: [1, 0, 0, 0]\nwidth: 9\nheight: 9",
            "D and dist_coeffs, which differ",
        ),
        (
            "K: [450, 0, 376, 0, 450, 240, 0, 0, 1]\nD: [0, 0, 0, 0, 0]\nwidth: 480\nheight: 752",
            r"principal point 376.5, 240.5 of 480 x 752 .* middle of 752 x 480",
        ),
        *(
            (f"K: [9, 0, 5, 0, 9, 5, 0, 0, 1]\nD: [0.1, 0, 0, 0, 0]\nwidth: 9\nheight: 9\n{words}", answer)
            for words, answer in (
                (
                    "distortion_model: Inverse Brown Conrady",
                    "distortion_model: Inverse Brown Conrady; expected",
                ),
                ("distortion_model: none", "distortion_model: none"),
                ("camera_model: omni", "camera_model: omni"),
                ("model_type: MEI", "model_type: MEI"),
                ("roi: {x_offset: 4, y_offset: 0, width: 5, height: 9}", "a part of 9 x 9 pixels"),
            )
        ),
    ],
)
def test_wrong_opencv_files(tmp_path, text, answer):
    path = tmp_path / "camera.yaml"
    path.write_text(text + "\n")
    with pytest.raises((InputError, UnsupportedError), match=answer):
        read_opencv(path)


def test_a_missing_file_is_told(tmp_path):
    for read in (read_colmap, read_opencv):
        with pytest.raises(InputError, match="file not found"):
            read(tmp_path / "none.txt")


@pytest.mark.parametrize(
    ("words", "model"),
    [
        ("camera_model: brown", "perspective"),
        ("distortion_model: pinhole", "perspective"),
        ("model: pinhole\nfisheye: true", "fisheye"),
        ("camera_model: pinhole\ndistortion_model: equidistant", "fisheye"),
        ("distortion_model: Brown-Conrady", "perspective"),
        ("camera_model: Canon EOS\nfisheye: false\ndistortion_model: none", "perspective"),
    ],
)
def test_words_for_a_lens(tmp_path, words, model):
    """Four coefficients may be either lens; 'pinhole' says nothing but as the model of the distortion."""
    path = tmp_path / "camera.yaml"
    path.write_text(
        f"K: [500, 0, 320, 0, 500, 240, 0, 0, 1]\nD: [0, 0, 0, 0]\nwidth: 640\nheight: 480\n{words}\n"
    )
    assert read_opencv(path).model == model


def test_files_of_a_camera_number_by_number(tmp_path):
    """Pixels of OpenCV count from the middle of the first one, those of COLMAP from its corner."""
    camera = Camera(
        model="perspective",
        size_px=(640, 480),
        parameters=np.array([500.0, 501.0, 320.5, 240.5, 0.1, 0.2, 0.01, 0.02, 0.3]),
        name="left",
    )
    write_opencv(tmp_path / "camera.yaml", camera)
    text = (tmp_path / "camera.yaml").read_text()
    assert (
        "   rows: 3\n   cols: 3\n   dt: d\n   data: [ 500.0, 0.0, 320.0, 0.0, 501.0, 240.0, 0.0, 0.0, 1.0 ]"
        in text
    )
    assert "   rows: 1\n   cols: 5\n   dt: d\n" in text
    write_colmap(tmp_path / "cameras.txt", {3: camera})
    last = (tmp_path / "cameras.txt").read_text().splitlines()[-1].split()
    assert last[:4] == ["3", "FULL_OPENCV", "640", "480"]
    p = dict(zip(camera.parameter_names, camera.parameters, strict=True))
    names = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
    assert [float(v) for v in last[4:]] == [*(p[n] for n in names), 0.0, 0.0, 0.0]


METASHAPE = """<?xml version="1.0" encoding="UTF-8"?>
<calibration>
  <projection>{kind}</projection>
  <width>640</width> <height>480</height>
  <f>500</f> <cx>3</cx> <cy>-2</cy> {more}
  <k1>0.1</k1> <k2>0.2</k2> <k3>0.3</k3>
</calibration>
"""


@pytest.mark.parametrize(
    ("kind", "more", "model", "parameters"),
    [
        # its cx, cy count from the middle of the picture; its p1 and p2 are the other way round
        (
            "frame", "<b1>7</b1><p1>0.01</p1><p2>0.02</p2><k4>0</k4>", "perspective",
            [507, 500, 323, 238, 0.1, 0.2, 0.02, 0.01, 0.3],
        ),
        ("frame", "", "perspective", [500, 500, 323, 238, 0.1, 0.2, 0, 0, 0.3]),
        ("fisheye", "<k4>0.4</k4><b2>0</b2>", "fisheye", [500, 500, 323, 238, 0.1, 0.2, 0.3, 0.4]),
    ],
)  # fmt: skip
def test_a_lens_of_metashape(tmp_path, kind, more, model, parameters):
    path = tmp_path / "lens.xml"
    path.write_text(METASHAPE.format(kind=kind, more=more))
    found = read_metashape(path)
    assert (found.model, found.size_px, found.name) == (model, (640, 480), "camera")
    assert found.parameters.tolist() == parameters
    path.write_text(METASHAPE.format(kind=kind, more=more).replace("<projection>frame</projection>", ""))
    assert read_metashape(path).model == model  # a frame where it says nothing


@pytest.mark.parametrize(
    ("kind", "more", "words"),
    [
        ("frame", "<b2>0.5</b2>", "perspective model has not: {'b2': 0.5}; expected them to be zero"),
        ("frame", "<p3>0.5</p3><p4>-1</p4>", "{'p3': 0.5, 'p4': -1.0}"),
        ("frame", "<k4>0.4</k4>", "{'k4': 0.4}"),
        ("fisheye", "<p1>0.4</p1>", "fisheye model has not: {'p1': 0.4}"),
        ("fisheye", "<p2>0.4</p2>", "{'p2': 0.4}"),
        ("frame", "<b1>wide</b1>", "no lens"),
        ("equisolid_fisheye", "", "the projection equisolid_fisheye; expected frame or equidistant_fisheye"),
        ("cylindrical", "", "the projection cylindrical"),
    ],
)
def test_terms_of_metashape_that_are_not_known_are_refused(tmp_path, kind, more, words):
    path = tmp_path / "lens.xml"
    path.write_text(METASHAPE.format(kind=kind, more=more))
    with pytest.raises(InputError) as caught:
        read_metashape(path)
    assert words in str(caught.value)


def test_a_lens_in_one_line_of_numbers(tmp_path):
    path = tmp_path / "lens.txt"
    path.write_text("640 480 500 0 320 0 501 240 0 0 1 0.1 0.2 0.01 0.02 0.3\n")
    found = read_opencv(path)
    assert found.size_px == (640, 480)
    assert found.parameters.tolist() == [500, 501, 320.5, 240.5, 0.1, 0.2, 0.01, 0.02, 0.3]


def test_files_that_are_no_text_or_lie_in_new_folders(tmp_path):
    (tmp_path / "bin.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="no text file"):
        read_colmap(tmp_path / "bin.txt")
    (tmp_path / "cameras.txt").write_text("one PINHOLE 100 80 90 91 50 40\n")
    with pytest.raises(InputError, match="no camera"):
        read_colmap(tmp_path / "cameras.txt")
    for _ in range(2):  # the folder is made, and may be there
        write_colmap(tmp_path / "a/b/cameras.txt", {1: BROWN})
        write_opencv(tmp_path / "c/d/camera.yaml", BROWN)
    assert read_colmap(tmp_path / "a/b/cameras.txt")[1].name == "camera_1"


def test_focal_lengths_and_principal_points_that_no_lens_has():
    """A picture of 1000 x 400: both sides of each limit."""

    def lens(fx=800.0, fy=800.0, cx=500.0, cy=200.0, size_px=(1000, 400)):
        numbers = np.array([fx, fy, cx, cy, 0, 0, 0, 0, 0])
        check_lens(Camera(model="perspective", size_px=size_px, parameters=numbers), "a.yaml")

    for good in (
        {"fx": 101.0, "fy": 101.0}, {"fx": 9.9e4, "fy": 9.9e4}, {"cx": 849.0}, {"cx": 151.0},
        {"cy": 339.0}, {"cy": 61.0},
    ):  # fmt: skip
        lens(**good)
    for bad in (
        {"fx": 99.0}, {"fy": 99.0}, {"fx": 1.01e5}, {"fy": 1.01e5}, {"cx": 851.0}, {"cx": 149.0},
        {"cy": 341.0}, {"cy": 59.0},
    ):  # fmt: skip
        with pytest.raises(InputError, match="pixels of this very picture"):
            lens(**bad)
    lens(cy=480.0, size_px=(1000, 960))  # the middle of 960 x 1000, nearly, too
    # the middle of a picture of 400 x 1000, by less than a twentieth
    for cx, cy in ((219.0, 481.0), (181.0, 520.0), (200.0, 549.0), (200.0, 451.0)):
        with pytest.raises(InputError, match="middle of 400 x 1000"):
            lens(cx=cx, cy=cy)
    for cx, cy in ((221.0, 481.0), (179.0, 481.0), (200.0, 551.0)):
        with pytest.raises(InputError, match="pixels of this very picture"):
            lens(cx=cx, cy=cy)
