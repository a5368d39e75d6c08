"""Interior orientations to COLMAP and back."""

import numpy as np
import pytest
from PIL import Image

from thalweg.core import Camera, InputError
from thalweg.images.sfm import colmap, from_colmap
from thalweg.images.sfm.colmap import cameras_by_size, start_given, start_guessed, to_colmap


def camera(model: str, *shape: float, size: tuple[int, int] = (640, 480)) -> Camera:
    p = np.array([520.0, 523.0, 322.5, 236.0, *shape])
    return Camera(model="fisheye" if model == "fisheye" else "perspective", size_px=size, parameters=p)


BROWN = camera("perspective", -0.12, 0.05, 0.0006, -0.0004, 0.0)
BROWN_K3 = camera("perspective", -0.12, 0.05, 0.0006, -0.0004, 0.03)
FISH = camera("fisheye", 0.02, -0.004, 0.001, -0.0002)


@pytest.mark.parametrize(
    ("given", "lens", "fixed", "took"),
    [
        (BROWN, "auto", False, "OPENCV"),
        (BROWN, "FULL_OPENCV", False, "FULL_OPENCV"),
        (BROWN_K3, "auto", True, "FULL_OPENCV"),
        (FISH, "auto", False, "OPENCV_FISHEYE"),
    ],
)
def test_both_sides_image_the_same_ray_at_the_same_pixel(given, lens, fixed, took):
    start = start_given(given, lens, fixed=fixed)
    assert (start.lens, start.known) == (took, True)
    made, error_px = to_colmap(start, 1)
    rays = np.random.default_rng(1).uniform([-0.5, -0.4, 1], [0.5, 0.4, 1], (50, 3))
    # the same formulas in double precision
    np.testing.assert_allclose(made.img_from_cam(rays), given.project(rays), atol=1e-9)
    assert error_px < 1e-6
    back, error_px = from_colmap(made)
    np.testing.assert_array_equal(back.parameters, given.parameters)
    assert (back.model, back.size_px, error_px) == (given.model, given.size_px, 0.0)


def test_a_k3_that_opencv_has_not_goes_into_k1_and_k2():
    made, error_px = to_colmap(start_given(BROWN_K3), 1)
    assert made.model_name == "OPENCV"
    # without the fit the corners would be off by fx k3 r^7 = 1.9 px (r = 0.77)
    # and with it they keep a fifth of that
    assert 0 < error_px < 0.4
    x, y = np.meshgrid(np.linspace(0, 640, 30), np.linspace(0, 480, 30))
    xy = np.column_stack([x.ravel(), y.ravel()])
    off = np.asarray(made.img_from_cam(BROWN_K3.rays(xy))) - xy
    assert np.abs(off).max() < 1.3 * error_px  # told on a coarser grid
    whole, lost_px = to_colmap(start_given(camera("perspective", *np.zeros(5)), "SIMPLE_RADIAL"), 1)
    assert whole.params[0] == 521.5
    assert lost_px > 0.5  # 1.5 px of 520 px are lost at the edge of the picture


def test_a_denominator_is_folded_into_browns_model():
    pc = colmap()
    params = [520, 523, 322.5, 236, -0.05, 0.01, 0.0004, -0.0002, 0.002, 0.03, -0.01, 0.002]
    made = pc.Camera(camera_id=1, model=pc.CameraModelId.FULL_OPENCV, width=640, height=480, params=params)
    back, error_px = from_colmap(made)
    # three radial terms against a ratio of two polynomials up to r = 0.77
    assert 0 < error_px < 0.05
    rays = np.random.default_rng(1).uniform([-0.55, -0.4, 1], [0.55, 0.4, 1], (200, 3))
    off = back.project(rays) - np.asarray(made.img_from_cam(rays))
    assert np.abs(off).max() < 0.05


def test_a_guess_says_that_it_is_one(tmp_path):
    plain = tmp_path / "plain.jpg"
    Image.new("L", (640, 480)).save(plain)
    start = start_guessed(plain, (640, 480))
    assert not start.known
    assert start.camera.parameters[0] == 1.2 * 640
    assert "a guess" in start.source
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 28  # focal length of a 35 mm film
    Image.new("L", (640, 480)).save(tmp_path / "told.jpg", exif=exif)
    told = start_guessed(tmp_path / "told.jpg", (640, 480))
    assert told.known
    # COLMAP takes the 35 mm of the film as its diagonal: 28 mm / 43.27 mm * 800 px
    assert told.camera.parameters[0] == pytest.approx(28 / 43.267 * 800, rel=1e-3)
    fish = start_guessed(plain, (640, 480), "OPENCV_FISHEYE")
    assert fish.camera.model == "fisheye"


def test_a_lens_of_the_other_kind_is_refused():
    with pytest.raises(InputError, match=r"images.mapping.lens: lens OPENCV for the fisheye camera"):
        start_given(FISH, "OPENCV")


def test_cameras_are_told_apart_by_the_size_of_their_pictures():
    other = camera("perspective", *np.zeros(5), size=(320, 240))
    found, reasons = cameras_by_size([(640, 480), (320, 240), (480, 640)], [BROWN, other])
    assert found == [0, 1, -1]
    assert reasons == ["", "", "480 x 640 pixels, the camera has 640 x 480 or 320 x 240"]
    with pytest.raises(InputError, match=r"images of 800 x 600 pixels; expected 640 x 480"):
        cameras_by_size([(800, 600)], [BROWN])
    with pytest.raises(InputError, match="two given cameras with pictures of the same size"):
        cameras_by_size([(640, 480)], [BROWN, BROWN])
