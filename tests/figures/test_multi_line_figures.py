"""Figures of a laser of several lines, and shaded pictures of meshes."""

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from thalweg.core import GeometryError, InputError, rotation_opk
from thalweg.figures.calibration.field import PLAN
from thalweg.lightsheet.figures.scan_reference import mesh_picture
from thalweg.lightsheet.optics import paper_4
from thalweg_lab.figures.multi_line import (
    NAMES,
    SeenObject,
    across_direction,
    multi_line_geometry,
    multi_line_images_view,
    read_objects,
)
from thalweg_lab.multi_line import Lines, line_table

DEPTHS_MM = (60.0, 120.0)
N = 4


@pytest.fixture
def lines():
    """Four lines on two levels, as `line_table` gives them."""
    sensor = paper_4()
    angles = sensor.sheet.angles_rad + np.deg2rad(3.0) * (np.arange(N)[:, None] - 1.5) * np.eye(3)[0]
    fan = Lines(
        labels=np.arange(N),
        origins_lcs_mm=np.tile(sensor.sheet.origin_lcs_mm, (N, 1)),
        R_lcs_las=rotation_opk(*angles.T),
        v=np.zeros(N),
        half_angle_rad=0.2,
    )
    return line_table(sensor, fan, DEPTHS_MM, beams_per_line=9)


def test_the_geometry_is_drawn_line_by_line(lines, look):
    figure = multi_line_geometry(lines)
    assert "n = 4 lines" in look.texts(figure)


def test_across_is_level_and_at_right_angles_to_the_lines(lines):
    across = across_direction(lines)
    one = lines[(lines["line"] == 1) & (lines["depth_mm"] == 120.0)][["x_mm", "y_mm"]].to_numpy()
    along = (one[-1] - one[0]) / np.linalg.norm(one[-1] - one[0])
    assert np.linalg.norm(across) == pytest.approx(1.0)
    # the fans of this sensor are bent by less than five degrees
    assert abs(across[:2] @ along) < np.sin(np.deg2rad(5.0))


# ---------------------------------------------------------------- images


def plane_object(sensor):
    """A level square below the sensor, and an empty image of 64 pixels."""
    x, y = np.meshgrid([-200.0, 200.0], [-250.0, 150.0])
    vertices = np.stack([x.ravel(), y.ravel(), np.full(4, -sensor.window.thickness_mm - 120.0)], axis=1)
    image = np.random.default_rng(1).integers(0, 9, (64, 64), dtype=np.uint8)
    return SeenObject(image=image, vertices_lcs_mm=vertices, faces=np.array([[0, 1, 2], [1, 3, 2]]))


@pytest.fixture
def measured(lines):
    """Points of three objects; those of the wreck have no label, every fourth guess is right."""
    level = lines[lines["depth_mm"] == 120.0]
    rows = []
    for name in NAMES:
        mine = level[["line", "x_mm", "y_mm", "z_mm"]].assign(
            object=name,
            best_line=level["line"],
            true_line=level["line"],
            x_px=level["x_px"] / 32.0,
            y_px=level["y_px"] / 32.0,
        )
        if name == "wreck":
            mine = mine.assign(line=-1, x_mm=np.nan, y_mm=np.nan, z_mm=np.nan, best_line=2)
        rows.append(mine)
    return pd.concat(rows, ignore_index=True)


def test_images_show_labelled_points_and_those_without(measured, look):
    objects = dict.fromkeys(NAMES, plane_object(paper_4()))
    figure = multi_line_images_view(objects, measured)
    words = look.texts(figure)
    n = len(measured) // 3
    assert f"n = {3 * n} measured points, {2 * n} with a label, of which 100.0 % are right" in words
    assert f"{n} of {n} points labelled" in words
    assert f"{n} points, none labelled; guesses right: 25 %" in words


def test_objects_are_read_in_order(tmp_path):
    seen = plane_object(paper_4())
    arrays = {}
    for name in reversed(NAMES):
        arrays |= {
            f"image_{name}": seen.image,
            f"vertices_{name}": seen.vertices_lcs_mm,
            f"faces_{name}": seen.faces,
        }
    np.savez(tmp_path / "all.npz", **arrays)
    found = read_objects(tmp_path / "all.npz")
    assert list(found) == list(NAMES)
    assert_array_equal(found["plane"].faces, seen.faces)
    del arrays["image_plane"]
    np.savez(tmp_path / "some.npz", **arrays)
    with pytest.raises(InputError, match="no plane"):
        read_objects(tmp_path / "some.npz")
    with pytest.raises(InputError, match="file not found"):
        read_objects(tmp_path / "none.npz")


# ---------------------------------------------------------------- meshes


def test_a_mesh_covers_what_it_covers_and_hides_what_is_behind():
    # a small roof 10 above a square of 100
    low = np.array([[0.0, 0, 0], [100, 0, 0], [100, 100, 0], [0, 100, 0]])
    roof = np.array([[20.0, 20, 10], [60, 20, 10], [60, 60, 10], [20, 60, 10]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    vertices = np.concatenate([low, roof])
    picture = mesh_picture(vertices, faces, PLAN, colours=mpl.colormaps["gray"], pixels=100)
    assert_allclose(picture.extent, (0.0, 100.0, 0.0, 100.0), atol=1e-9)
    assert picture.covered == 1.0
    # seen from above: black ground, and white light times the shade of a level face on the roof
    bright = picture.rgba[..., 0] > 0.1
    assert bright.mean() == pytest.approx(0.16, abs=0.01)  # a pixel along its edges
    assert bright[25:55, 25:55].all()
    only = mesh_picture(vertices, faces, PLAN, colours="red", inside=(np.zeros(3), np.array([50.0, 100, 5])))
    # of the left half the roof hides 30 x 40
    assert only.covered == pytest.approx(1.0 - 0.24, abs=0.01)


def test_an_empty_mesh_is_refused():
    with pytest.raises(GeometryError, match="no vertex"):
        mesh_picture(np.zeros((0, 3)), np.zeros((0, 3), dtype=int), PLAN, colours="white")
