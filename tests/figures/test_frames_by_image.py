"""The cloud by image number (P2 Fig. 11)."""

import numpy as np
import pytest

from tests.core.conftest import FRAME, image_poses_of
from thalweg.core import LazWriter
from thalweg.figures.cloud.frames_by_image import FrameImages, FrameViews, frames_by_image

T0 = 3.0e8


def poses():
    """Twelve images along a track to the east, one without pose, not in order of time."""
    order = np.array([3, 0, 1, 2, *range(4, 12)])
    centre = np.column_stack([4.0 * order, np.sin(order), np.ones(12)])
    names = [f"{k}.jpg" for k in order]
    return image_poses_of(centre, np.eye(3), T0 + order, oriented=order != 5, names=names)


@pytest.fixture
def cloud(tmp_path, rng):
    """3000 points of a bank in the north, in the frames of all images but the last."""
    n = 3000
    image = np.sort(rng.choice([0, 1, 2, 3, 4, 6, 7, 8, 9, 10], n))
    xyz = np.column_stack([4.0 * image + rng.normal(0, 2, n), rng.uniform(10, 14, n), rng.uniform(0, 3, n)])
    path = tmp_path / "points.laz"
    with LazWriter(path, FRAME, scale_m=0.001) as writer:
        writer.append(
            xyz, t_gps_s=T0 + image + rng.uniform(-0.05, 0.05, n), intensity=np.full(n, 50, np.uint16)
        )
    return path, image


def test_points_get_the_number_of_their_image(cloud):
    path, image = cloud
    images = FrameImages.of(poses())
    # the sixth image has no pose, but keeps its number
    assert images.number.tolist() == [1, 2, 3, 4, 5, 7, 8, 9, 10, 11, 12]
    views = FrameViews.of_cloud(path, images)
    expected = [int(np.sum(image == number - 1)) for number in images.number]
    assert views.points.tolist() == expected
    # the bank lies in the north
    assert abs(np.sin(views.side.view.azimuth_rad)) < 0.1
    assert np.cos(views.side.view.azimuth_rad) > 0.9


def test_the_figure_says_how_many(cloud, look):
    images = FrameImages.of(poses())
    figure = frames_by_image(FrameViews.of_cloud(cloud[0], images), images, twin=True)
    words = look.texts(figure)
    assert "n = 10 frames" in words
    assert "n = 3 000 points" in words
    assert "11 of 12 images oriented, 1 of them without points" in words


def test_points_between_two_images_belong_to_the_nearer_one():
    images = FrameImages.of(poses())
    assert images.nearest(T0 + np.array([-5.0, 0.4, 0.6, 5.2, 99.0])).tolist() == [0, 0, 1, 5, 10]
