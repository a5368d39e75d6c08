"""Measurement volume, lines of equal depth, look-up table."""

from dataclasses import replace

import numpy as np
import pytest

from thalweg.core import GeometryError
from thalweg.lightsheet.optics import (
    Status,
    depth_lines,
    intersect,
    measurement_volume,
    paper_4,
    picture_grid,
    write_look_up_table,
)
from thalweg.lightsheet.optics.lookup import EXACT


def test_volume_of_paper_4():
    """The fitted geometry gives 246.5, 217.8, 81.6 mm; P4 5 prints 248, 227, 81."""
    volume = measurement_volume(paper_4())
    assert volume.depth_mm[0] == pytest.approx(0.0, abs=1e-9)
    assert volume.depth_mm[1] == pytest.approx(246.5, abs=0.5)
    assert volume.size_mm[:2] == pytest.approx([217.8, 81.6], abs=0.5)
    # 16 % never see the sheet, 3 % meet it above the window
    assert volume.shares["NO_SHEET"] == pytest.approx(0.16, abs=0.01)
    assert volume.shares["ABOVE_WINDOW"] == pytest.approx(0.03, abs=0.005)
    assert sum(volume.shares.values()) == pytest.approx(1.0)
    assert volume.share == volume.shares["OK"]


def test_lines_of_equal_depth_run_from_right_to_left():
    """P4 Fig. 11: 0, 50, 125 and 250 mm from right to left; 250 mm lies outside the picture here, 246 at its
    edge."""
    lines = depth_lines(paper_4(), [0, 50, 125, 240])
    places = [float(line.xy_px[:, 0].mean()) for line in lines]
    assert places == sorted(places, reverse=True)
    assert not len(depth_lines(paper_4(), [300])[0].xy_px)
    found = intersect(paper_4(), lines[2].xy_px)
    assert found.ok.all()
    assert np.abs(found.depth_mm - 125).max() < 1e-9
    with pytest.raises(GeometryError, match="zero or more"):
        depth_lines(paper_4(), [-1.0])


def test_grid_covers_the_picture_to_its_borders():
    grid = picture_grid(paper_4(), 100)
    assert grid.x_px[0] == 0.5
    assert grid.x_px[-1] == 2047.5
    assert grid.xyz_lcs_mm.shape == (len(grid.y_px), len(grid.x_px), 3)
    j, i = 10, 5
    one = intersect(paper_4(), [[grid.x_px[j], grid.y_px[i]]])
    assert np.array_equal(one.xyz_lcs_mm[0], grid.xyz_lcs_mm[i, j])


def test_a_sensor_that_sees_nothing_says_so():
    sensor = paper_4()
    away = replace(
        sensor.with_sheet(replace(sensor.sheet, angles_rad=np.deg2rad([-27.0, 0.0, 0.0]))),
        camera_angles_rad=np.deg2rad([41.47, 0.0, 0.0]),
    )
    with pytest.raises(GeometryError, match="no pixel sees"):
        measurement_volume(away, 128)


@pytest.mark.parametrize("distortion", [0.0, -0.08])
def test_table_and_solver_agree(tmp_path, distortion):
    """By cubic polynomials through 4 x 4 nodes, as the table says of itself: 5e-5 mm are demanded."""
    sensor = paper_4()
    x = sensor.vector()
    x[10] = distortion
    sensor = sensor.with_vector(x)
    write_look_up_table(tmp_path / "table.npz", sensor)
    with np.load(tmp_path / "table.npz") as table:
        values, cells, step = table["values"], table["cells"], int(table["step_px"])
    corners = [[0.0, 0.0], [2047.9, 2047.9], [0.0, 2047.9], [2047.9, 0.0], [0.0, 1000.0]]
    xy = np.concatenate([np.random.default_rng(1).uniform(0, 2048, (150_000, 2)), corners])
    strict = intersect(sensor, xy)
    (j, i), (u, v) = np.floor(xy / step).astype(int).T + 1, (xy / step - np.floor(xy / step)).T
    mark = cells[i, j]
    told = mark != EXACT
    assert np.array_equal(mark[told], strict.status[told])
    # solved strictly: cells along the ends of the fan only
    assert np.mean(cells[1:-2, 1:-2] == EXACT) < 0.08
    assert np.mean(cells[1:-2, 1:-2] == Status.OK) > 0.7

    def weights(t):
        """Of the nodes -1, 0, 1, 2 in Lagrange's polynomial."""
        nodes = (-1, 0, 1, 2)
        return [np.prod([(t - m) / (k - m) for m in nodes if m != k], axis=0) for k in nodes]

    ok = mark == Status.OK
    quick = np.zeros((len(xy), 4))
    for a, row in enumerate(weights(v)):
        for b, column in enumerate(weights(u)):
            quick += (row * column)[:, None] * np.nan_to_num(values[i - 1 + a, j - 1 + b])
    assert np.abs(quick[ok, :3] - strict.xyz_lcs_mm[ok]).max() < 5e-5
    assert np.abs(quick[ok, 3] - strict.fan_angle_rad[ok]).max() < 1e-6
