"""The equirectangular projection against COLMAP's, and the width and attitude of a panorama."""

import numpy as np
import pytest

from thalweg.core import Camera, GeometryError, exp_rotation
from thalweg.panorama import default_width_px, level_attitude, pixels_of, sphere_rays


def test_projection_is_that_of_colmap():
    pycolmap = pytest.importorskip("pycolmap")
    width = 5376
    judge = pycolmap.Camera.create_from_model_name(1, "EQUIRECTANGULAR", float(width), width, width // 2)
    directions = np.random.default_rng(3).standard_normal((2000, 3))
    expected = np.array(judge.img_from_cam(directions))
    off = np.abs(pixels_of(directions, width) - expected)
    assert off.max() <= 0.01


def test_rays_are_those_of_the_centres_of_pixels():
    width = 96
    xy = pixels_of(sphere_rays(width).reshape(-1, 3), width).reshape(width // 2, width, 2)
    row, column = np.mgrid[0 : width // 2, 0:width] + 0.5
    assert np.abs(xy - np.stack([column, row], axis=-1)).max() < 1e-9
    assert np.isnan(pixels_of(np.zeros((1, 3)), width)[0, 1])


def test_a_panorama_is_level_and_looks_where_the_front_lens_heads():
    front = exp_rotation([0.1, 0.2, 1.0]) @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=float)
    R = level_attitude(front)
    assert pytest.approx(np.eye(3), abs=1e-12) == R @ R.T
    assert np.linalg.det(R) == pytest.approx(1.0)
    assert R[:, 1] == pytest.approx([0, 0, -1])
    heading = front[:2, 2] / np.linalg.norm(front[:2, 2])
    assert R[:2, 2] == pytest.approx(heading)
    with pytest.raises(GeometryError, match="straight up or down"):
        level_attitude(np.diag([1.0, -1.0, -1.0]))


def test_width_is_that_of_the_lens():
    lens = Camera(
        model="fisheye", size_px=(640, 640), parameters=np.array([190.9, 190.9, 320, 320, 0, 0, 0, 0])
    )
    assert default_width_px(lens) == 1200  # 2 pi 190.9 = 1199.5
