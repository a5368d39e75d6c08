"""Images of a fifteen-line laser: labels by known depths are right, those of a wreck are not given."""

import numpy as np
import pandas as pd
import pytest

from thalweg_lab.studies.sensors import multi_line_images, write_images
from thalweg_lab.studies.sensors.laser_lines import OBJECTS


@pytest.fixture(scope="module")
def images():
    return list(multi_line_images(1, size="tiny"))


def test_known_depths_tell_the_line(images):
    assert tuple(one.name for one in images) == OBJECTS
    for one in images[:2]:
        p = one.points
        given = p["line"] >= 0
        # 8 pixels from line to line: a few points lie between two, and some pieces are of two lines
        assert given.mean() > 0.97
        assert (p["line"] == p["true_line"])[given].mean() > 0.95
        assert p.loc[given, ["x_mm", "y_mm", "z_mm"]].notna().all(axis=None)
        assert set(p["line"]) >= set(range(1, 14))
    plane = images[1]
    z = plane.points.loc[plane.points["line"] >= 0, "z_mm"]
    # an image of 512 pixels measures a plane to some tenths of a millimetre
    assert np.abs(z - plane.vertices_lcs_mm[:, 2].mean()).median() < 0.3


def test_one_image_of_a_wreck_does_not_tell_the_line(images):
    p = images[2].points
    assert (p["line"] == -1).all()
    assert p["x_mm"].isna().all()
    # the guesses are there, and most of them are off by whole lines
    assert (p["best_line"] == p["true_line"]).mean() < 0.5
    assert (p["true_line"] >= 0).mean() > 0.9


def test_pictures_and_points_are_written(images, tmp_path):
    write_images(images, tmp_path / "a.npz", tmp_path / "a.csv")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as data:
        for one in images:
            np.testing.assert_array_equal(data[f"image_{one.name}"], one.image)
            assert len(data[f"faces_{one.name}"]) == len(one.faces)
    table = pd.read_csv(tmp_path / "a.csv")
    assert table.groupby("object").size().to_dict() == {one.name: len(one.points) for one in images}
    write_images(images, tmp_path / "b.npz", tmp_path / "b.csv")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
