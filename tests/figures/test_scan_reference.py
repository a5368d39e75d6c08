"""Figure of a scanned object."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from thalweg.core import InputError
from thalweg.core.geometry import TriangleMesh
from thalweg.lightsheet.figures.scan_reference import read_orthophoto, scan_reference, share_of_noise

EXTENT_MM = (-60.0, 60.0, -40.0, 40.0)


@pytest.fixture
def mesh():
    """Two level squares, 20 mm apart in height."""
    square = np.array([[-50.0, -30, 0], [0, -30, 0], [0, 30, 0], [-50, 30, 0]])
    vertices = 1e-3 * np.concatenate([square, square + np.array([50.0, 0.0, 20.0])])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    return TriangleMesh(vertices_m=vertices, faces=faces, sigma_m=np.full(8, 1e-5))


@pytest.fixture
def points(rng):
    """Six lines across both levels; what lies beside the object is not used."""
    x = np.tile(np.linspace(-0.058, 0.049, 46), 6)
    off = rng.normal(0.0, 0.03, len(x))
    return pd.DataFrame(
        {
            "file": np.repeat([f"{k}.png" for k in range(6)], 46),
            "x_m": x,
            "used": x > -0.05,
            "y_m": np.repeat(np.linspace(-0.02, 0.02, 6), 46),
            "z_m": np.where(x > 0, 0.02, 0.0) + 1e-3 * off,
            "distance_mm": off,
        }
    )


def test_the_object_and_its_scan(mesh, points, rng, look):
    photo = np.full((80, 120, 3), 50, np.uint8)
    photo[20:60, 30:90] = (180, 150, 90)
    figure = scan_reference(photo, EXTENT_MM, mesh, points, title="Steps", twin=True)
    words = look.texts(figure)
    n = int(points["used"].sum())
    assert f"Steps: reference of 4 faces, n = {n} points of 6 lines on it" in words
    assert "orthophoto, brightened" in words


def test_a_picture_of_noise(mesh, points, rng, look):
    photo = rng.integers(1, 250, (80, 120), dtype=np.uint8)
    # a mean of 25 has a 25th of the variance
    assert share_of_noise(photo) == pytest.approx(0.96, abs=0.01)
    assert share_of_noise(np.tile(np.linspace(10, 200, 120), (80, 1))) < 0.05
    assert share_of_noise(np.zeros((80, 120))) == 1.0
    figure = scan_reference(photo, EXTENT_MM, mesh, points)
    words = look.texts(figure)
    assert "noise: no light but the laser's" in words


def test_a_picture_lies_where_its_world_file_says(tmp_path):
    picture, world = tmp_path / "a.png", tmp_path / "a.pgw"
    Image.new("RGB", (20, 10)).save(picture)
    world.write_text("0.0005\n0\n0\n-0.0005\n-0.00475\n0.00225\n")
    photo, extent_mm = read_orthophoto(picture, world)
    assert photo.shape == (10, 20, 3)
    assert_allclose(extent_mm, (-5.0, 5.0, -2.5, 2.5), atol=1e-9)
    for text, words in (("0.1\n0\n0\n-0.1\n0\n", "cannot be read"), ("0.1\n1\n0\n-0.1\n0\n0\n", "turned")):
        world.write_text(text)
        with pytest.raises(InputError, match=words):
            read_orthophoto(picture, world)
    with pytest.raises(InputError, match="file not found"):
        read_orthophoto(picture, tmp_path / "none.pgw")
