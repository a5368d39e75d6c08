"""Sub-beams of many lines and what the camera sees of them: against the rays of the processing."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose

from thalweg.lightsheet.optics import paper_4, refract_to_water
from thalweg_lab.tank import make_grating, seen_points, sub_beams


def tilted():
    sensor = paper_4()
    return replace(sensor, window=replace(sensor.window, tilt_x_rad=0.02, tilt_y_rad=-0.013))


def rays(sensor):
    """Origins and directions of 15 lines, 21 sub-beams each."""
    grating = make_grating(sensor, 1)
    return grating.beams(np.repeat(np.arange(15), 21), np.tile(np.linspace(-0.24, 0.24, 21), 15))


def test_the_processing_has_the_same_rays_by_another_formula():
    sensor = tilted()
    origins, directions = rays(sensor)
    beams, closed = (
        sub_beams(origins, directions, sensor.window),
        refract_to_water(origins, directions, sensor.window),
    )
    for depth in (0.0, 60.0, 200.0):
        there = beams.at_depth(np.full(len(origins), depth), sensor.window)
        # rounding of some hundred millimetres
        assert_allclose(there, closed.at_depth(depth), atol=1e-11)


def test_a_seen_point_and_its_slope_are_on_the_ray_of_the_pixel():
    sensor = tilted()
    beams = sub_beams(*rays(sensor), sensor.window)
    points = beams.at_depth(np.full(len(beams.slope), 130.0), sensor.window)
    seen = seen_points(sensor, points)
    assert seen.inside.sum() > 100
    at = seen.inside
    pixel_rays = sensor.camera.rays(seen.xy_px[at]) @ sensor.R_lcs_ccs.T
    back = refract_to_water(sensor.camera_origin_lcs_mm, pixel_rays, sensor.window)
    # rounding, and the inverse of the lens: 1e-9 px
    assert_allclose(back.at_depth(130.0), points[at], atol=1e-8)
    assert_allclose(back.B, seen.slope[at], atol=1e-10)


def test_what_never_gets_into_the_water_is_nan():
    window = paper_4().window
    up = sub_beams(np.array([[0.0, 0.0, 20.0]]), np.array([[0.0, 0.6, 0.8]]), window)
    assert np.isnan(up.start_mm).all()
    assert np.isnan(up.slope).all()
