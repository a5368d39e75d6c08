"""Orthophotos of the bed: heights, colours and sight checked against the twin's own surface (C081)."""

import numpy as np
import pytest
from PIL import Image

from tests.lightsheet.scanning.scan_files import true_poses
from thalweg.core import GeometryError, InputError
from thalweg.lightsheet.lines import detect_lines
from thalweg.lightsheet.optics import paper_4
from thalweg.lightsheet.scanning import merge, orthophoto, profile
from thalweg.lightsheet.scanning.ortho import HeightGrid, Orthophoto, colours, height_grid, write_orthophoto
from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import SheetImage
from thalweg_lab.tank import render_sheet_image, sized
from thalweg_lab.tank.plan import strip_plan

LINES = 5


def test_the_orthophoto_shows_the_albedo_of_the_bed():
    sensor, settings = sized(paper_4(), SheetImage(), "tiny")
    plan = strip_plan(sensor, 5, lines=LINES, speed_mmps=40.0, step_mm=2.0)
    names = [f"i{k}" for k in range(LINES)]
    images = {
        name: render_sheet_image(sensor, plan.scene(k), settings, generator(5, f"test ortho {k}"))
        for k, name in enumerate(names)
    }
    cloud = merge(
        [profile(sensor, detect_lines(images[name]), image=name) for name in names],
        true_poses(plan.path, range(LINES)),
    )
    photo = orthophoto(sensor, cloud, images.__getitem__, cell_m=0.001)
    seen = (photo.images > 0).ravel()
    assert photo.counts["cells_seen"] == seen.sum() > 1400
    assert photo.counts["views_beside_the_line"] > 0
    bed = plan.surfaces[plan.seen[0]]
    at = photo.grid.points_m[seen] * 1e3
    down = bed.caster.cast(
        np.column_stack([at[:, :2], np.full(len(at), 200.0)]), np.tile([0.0, 0.0, -1.0], (len(at), 1))
    )
    top = np.column_stack([at[:, :2], 200.0 - down.t_hit_m])
    # between lines 4 mm apart the surface is interpolated over ripples of 8 mm
    assert np.median(np.abs(top[:, 2] - at[:, 2])) < 0.25
    albedo = bed.albedo(top, down.primitive)
    for channel in range(3):
        match = np.corrcoef(albedo[:, channel], photo.dn.reshape(-1, 3)[seen, channel])[0, 1]
        assert match > 0.7  # a shift by half a line spacing, 2 mm, leaves less than 0.5
    picture = photo.picture()
    assert picture.shape == (*photo.images.shape, 3)
    assert (picture[::-1][photo.images == 0] == 0).all()
    with pytest.raises(GeometryError, match="none of 5 images sees any"):
        orthophoto(sensor, cloud, images.__getitem__, cell_m=0.001, line_margin_px=5000.0)


def test_heights_of_a_plane_with_a_gap(rng):
    xy = rng.uniform(0.0, 0.2, (4000, 2))
    xy = xy[np.abs(xy[:, 0] - 0.1) > 0.03]
    points = np.column_stack([xy, 0.1 * xy[:, 0] - 0.3 * xy[:, 1] + 5.0])
    grid = height_grid(points, 0.005, largest_gap_m=0.008)
    centres = grid.points_m
    known = np.isfinite(centres[:, 2])
    inner = known & (np.abs(centres[:, :2] - 0.1) < 0.09).all(axis=1)
    true = 0.1 * centres[:, 0] - 0.3 * centres[:, 1] + 5.0
    assert centres[inner, 2] == pytest.approx(true[inner], abs=1e-6)
    assert not known[np.abs(centres[:, 0] - 0.1) < 0.02].any()
    vertices, faces = grid.mesh()
    assert np.isfinite(vertices).all()
    assert known[faces].all()
    with pytest.raises(GeometryError, match="four and more finite points"):
        height_grid(points[:2], 0.005, largest_gap_m=0.01)
    with pytest.raises(GeometryError, match="choose wider cells"):
        height_grid(points, 1e-6, largest_gap_m=0.01)


def test_colours_of_each_kind_of_image():
    mosaic = np.zeros((8, 8), dtype=np.uint8)
    mosaic[::2, ::2], mosaic[1::2, 1::2] = 200, 50  # red and blue of RGGB
    mosaic[::2, 1::2] = mosaic[1::2, ::2] = 100
    assert colours(mosaic)[2:6, 2:6] == pytest.approx(np.broadcast_to([200.0, 100.0, 50.0], (4, 4, 3)))
    assert colours(mosaic, "mono")[1, 1].tolist() == [50.0, 50.0, 50.0]
    assert colours(np.dstack([mosaic] * 3)).shape == (8, 8, 3)
    with pytest.raises(InputError, match="layout 'xyz'"):
        colours(mosaic, "xyz")


def test_a_world_file_has_the_centre_of_the_upper_left_cell(tmp_path):
    """Three rows of 2 cm, the first one the lowest."""
    grid = HeightGrid(x0_m=10.0, y0_m=-5.0, cell_m=0.02, height_m=np.zeros((3, 4)))
    found = Orthophoto(grid=grid, dn=np.arange(36.0).reshape(3, 4, 3), images=np.ones((3, 4), int), counts={})
    write_orthophoto(found, tmp_path / "a.png", tmp_path / "a.pgw")
    numbers = [float(line) for line in (tmp_path / "a.pgw").read_text().split()]
    assert numbers == pytest.approx([0.02, 0.0, 0.0, -0.02, 10.0, -4.96], abs=1e-9)
    with Image.open(tmp_path / "a.png") as picture:
        np.testing.assert_array_equal(np.asarray(picture), found.picture())
