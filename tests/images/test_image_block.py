"""The block of images as a file and in other frames."""

from dataclasses import replace

import numpy as np
import pytest

from tests.images import block_scene
from thalweg.core import GeometryError, InputError, exp_rotation
from thalweg.images.model import ImageBlock


@pytest.fixture
def block(rng):
    found: ImageBlock = block_scene.scene(rng, images=6, points=60, start_off=0.0)[0].block
    return found


def test_a_block_comes_back_from_its_file(block, tmp_path):
    cov = np.diag(np.arange(9.0))
    camera = block.cameras[0].with_parameters(block.cameras[0].parameters, cov)
    block = replace(block, cameras=(camera,))
    block.write(tmp_path / "deep" / "block.npz")
    again = ImageBlock.read(tmp_path / "deep" / "block.npz")
    assert again.images == block.images
    assert again.cameras[0].model == "perspective"
    np.testing.assert_array_equal(again.cameras[0].cov, cov)
    for name in ("R_block_ccs", "centre_block_m", "points_block_m", "mark_image", "mark_px", "sigma_px"):
        np.testing.assert_array_equal(getattr(again, name), getattr(block, name))


def test_residuals_are_the_noise_and_do_not_depend_on_the_frame(block):
    r = block.residuals_px()
    assert np.sqrt(np.square(r).mean()) == pytest.approx(0.2, rel=0.15)
    moved = block.transformed(exp_rotation([0.2, -1.0, 3.0]), np.array([4e5, 5.6e6, 100.0]), 3.7)
    # 5,600 km leave 1e-9 m, seen from 15 m with 580 px
    np.testing.assert_allclose(moved.residuals_px(), r, atol=1e-6)
    back = moved.transformed(exp_rotation([0.2, -1.0, 3.0]).T, np.zeros(3), 1 / 3.7)
    assert np.ptp(back.centre_block_m - block.centre_block_m, axis=0).max() < 1e-8


def test_points_behind_a_camera_have_no_residual(block):
    points = block.points_block_m.copy()
    points[block.mark_point[0]] = block.centre_block_m[block.mark_image[0]] - [0, 5, 0]
    r = replace(block, points_block_m=points).residuals_px()
    assert np.isnan(r[0]).all()


@pytest.mark.parametrize(
    ("change", "answer"),
    [
        ({"mark_image": np.array([99])}, r"mark_\w+\.shape"),
        ({"sigma_px": np.ones(3)}, r"sigma_px\.shape=\(3,\)"),
        ({"camera": np.zeros(2, np.int64)}, r"camera\.shape=\(2,\)"),
    ],
)
def test_wrong_shapes_are_refused(block, change, answer):
    with pytest.raises(GeometryError, match=answer):
        replace(block, **change)


def test_marks_of_what_does_not_exist_are_refused(block):
    for name, n in (("mark_image", 6), ("mark_point", len(block.points_block_m))):
        for value in (n, -1):
            wrong = getattr(block, name).copy()
            wrong[3] = value
            with pytest.raises(GeometryError, match=f"a mark of {name[5:]}"):
                replace(block, **{name: wrong})


def test_files_that_are_no_block(tmp_path):
    (tmp_path / "text.npz").write_text("no block")
    np.savez(tmp_path / "other.npz", head=np.array('{"kind": "image_block", "version": 99}'))
    for name, told in (
        ("no", "file not found"),
        ("text", "not readable"),
        ("other", r"version 99.*Rebuild it"),
    ):
        with pytest.raises(InputError, match=told):
            ImageBlock.read(tmp_path / f"{name}.npz")
