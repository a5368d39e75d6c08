"""The line on surfaces: its place in the image, shadows, occlusion, gaps of the grid."""

import numpy as np
import pytest

from tests.lab.light_sheet.conftest import at_rows, row_centres
from thalweg.core import rotation_opk
from thalweg_lab.tank import Posed, line_on, stepped_object
from thalweg_lab.tank.forward import beams_in_water
from thalweg_lab.tank.glow import on_sheet, rays_of
from thalweg_lab.tank.objects import STEP_HEIGHTS_MM, STEP_SIZE_MM, GridPattern, grid_object, panel
from thalweg_lab.tank.render import laser_light

DENSE = np.deg2rad(np.linspace(-44.5, 44.5, 6001))


def on_panel(small, depth_mm, tilt_deg=0.0):
    tilt = np.deg2rad(tilt_deg)
    at, _ = on_sheet(small.sensor, small.sensor.sheet, depth_mm)
    return Posed(surface=panel(), R_lcs_obj=rotation_opk(tilt, tilt / 2, 0.0), shift_lcs_mm=at)


@pytest.mark.parametrize(
    ("depth_mm", "tilt_deg"), [(60.0, 0.0), (122.7, 0.0), (200.0, 0.0), (125.0, 12.0), (125.0, -12.0)]
)
def test_the_line_of_the_image_is_the_line_of_the_geometry(small, depth_mm, tilt_deg):
    posed = on_panel(small, depth_mm, tilt_deg)
    image = laser_light(small.sensor, posed, small.clean)
    rows = np.arange(len(image)) + 0.5
    line = line_on(small.sensor, posed, small.sensor.sheet, DENSE)
    exact = at_rows(line.xy_px[line.visible], rows)
    # away from the ends of the line and from the borders, which cut the profile
    light = image.sum(axis=1)
    whole = (light > 0.8 * np.nanmedian(light[light > 0])) & (exact > 25) & (exact < image.shape[1] - 25)
    whole &= np.interp(rows, rows, np.convolve(whole, np.ones(31), "same")) > 30
    assert whole.sum() > 120
    # the profile is not quite symmetric: the scale changes across the line. A lost half of a fine step: 0.23
    assert np.abs(row_centres(image)[whole] - exact[whole]).max() < 0.002


def test_defocus_moves_no_line(small):
    posed = on_panel(small, 75.0)
    blurred = small.clean.model_copy(update={"lens": small.clean.lens.model_copy(update={"defocus": True})})
    sharp_image, image = (
        laser_light(small.sensor, posed, small.clean),
        laser_light(small.sensor, posed, blurred),
    )
    rows = slice(150, 350)
    assert np.abs(row_centres(sharp_image)[rows] - row_centres(image)[rows]).max() < 0.002  # even kernels
    assert image.max() < 0.95 * sharp_image.max()


def steps(small):
    at, _ = on_sheet(small.sensor, small.sensor.sheet, 150.0)
    return Posed(surface=stepped_object(markers=False), shift_lcs_mm=at - [0.0, 0.0, 20.0])


def beams_about(small, posed):
    """Starts on the window and directions (n, 3) of sub-beams in the water, in the frame of the object."""
    beams = beams_in_water(*rays_of(small.sensor.sheet, DENSE), small.sensor.window)
    return posed.to_object(beams.start_mm), beams.direction @ posed.R_lcs_obj


def object_points(posed, line):
    return posed.to_object(line.xyz_lcs_mm)


def test_a_step_throws_the_shadow_that_its_height_throws(small):
    posed = steps(small)
    line = line_on(small.sensor, posed, small.sensor.sheet, DENSE)
    points = object_points(posed, line)
    low, high = STEP_HEIGHTS_MM[0], STEP_HEIGHTS_MM[1]
    start, d = beams_about(small, posed)
    over = start + d * ((high - start[:, 2]) / d[:, 2])[:, None]
    under = start + d * ((low - start[:, 2]) / d[:, 2])[:, None]
    # level 2 ends at x = -50 and lies higher; beams run outwards
    passes = (over[:, 0] < -50.0) & (under[:, 0] > -150.0) & (np.abs(under[:, 1]) < 32.0)
    assert passes.sum() > 50
    assert np.abs(points[passes, 2] - low).max() < 1e-6
    edge = under[passes, 0].max()
    assert -70.0 < edge < -52.0  # a shadow of some millimetres
    dark = line.lit & (points[:, 0] > edge + 1e-3) & (points[:, 0] < -50.001) & (points[:, 2] < high - 1e-3)
    assert not dark.any()


def test_the_camera_misses_what_an_object_hides(small):
    ground = STEP_HEIGHTS_MM[-1] - STEP_SIZE_MM[-1]
    at, _ = on_sheet(small.sensor, small.sensor.sheet, 160.0)
    # the object stands beside the line on the ground, on the side of the camera
    posed = Posed(surface=stepped_object(markers=False), shift_lcs_mm=at + np.array([0.0, 42.0, -ground]))
    line = line_on(small.sensor, posed, small.sensor.sheet, DENSE)
    points, up = object_points(posed, line), line.seen.up
    on_ground = line.lit & (np.abs(points[:, 2] - ground) < 1e-6)
    at_face = points + up * ((-STEP_SIZE_MM[1] / 2 - points[:, 1]) / up[:, 1])[:, None]
    level = np.clip(np.floor((at_face[:, 0] + 150.0) / 100.0), 0, 2).astype(int)
    top = np.array(STEP_HEIGHTS_MM)[level]
    hidden = (at_face[:, 2] < top) & (np.abs(at_face[:, 0]) < 150.0)
    near_edge = (np.abs(at_face[:, 2] - top) < 0.05) | (np.abs(np.abs(at_face[:, 0]) - 50.0) < 0.05)
    assert (hidden & on_ground).sum() > 500
    assert (~hidden & on_ground).sum() > 500
    assert (line.visible == ~hidden)[on_ground & ~near_edge].all()


@pytest.mark.parametrize("levels_mm", [(0.0, -90.0), (0.0, -45.0, -90.0)])
def test_the_light_falls_through_where_the_grid_has_gaps(small, levels_mm):
    at, _ = on_sheet(small.sensor, small.sensor.sheet, 60.0)
    pattern = GridPattern.regular(levels_mm=levels_mm)
    posed = Posed(
        surface=grid_object(pattern), R_lcs_obj=rotation_opk(0, 0, np.deg2rad(-2.0)), shift_lcs_mm=at
    )
    line = line_on(small.sensor, posed, small.sensor.sheet, DENSE)
    start, d = beams_about(small, posed)
    top = start - d * (start[:, 2] / d[:, 2])[:, None]
    on_plate = np.abs(top[:, 0]) < pattern.half_size_mm[0]
    gap = ((top[:, :1] > pattern.gaps_mm[:, 0]) & (top[:, :1] < pattern.gaps_mm[:, 1])).any(axis=1)
    clear = on_plate & (np.abs(top[:, :1] - pattern.gaps_mm.ravel()).min(axis=1) > 1e-3)
    level = np.argmin(np.abs(object_points(posed, line)[:, 2:3] - np.array(levels_mm)), axis=1)
    assert (level[clear & ~gap] == 0).all()
    # the middle level fills the half with x > 0, well away from its edge
    below = np.where(top[:, 0] > 0, 1, len(levels_mm) - 1) if len(levels_mm) == 3 else np.ones(len(top))
    through = clear & gap & (np.abs(top[:, 0]) > 3.0)
    assert (level[through] == below[through]).all()
    assert gap.sum() > 300
