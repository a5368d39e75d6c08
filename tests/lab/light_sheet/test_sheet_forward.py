"""Rays to the water and points to the image: against Fermat's principle and against the processing."""

from dataclasses import replace

import numpy as np

from thalweg.lightsheet.optics import intersect, paper_4
from thalweg_lab.tank.forward import beams_in_water, camera_rays, see


def tilted(sensor):
    return replace(sensor, window=replace(sensor.window, tilt_x_rad=0.02, tilt_y_rad=-0.013))


def water_points(sensor, n=200):
    rng = np.random.default_rng(3)
    local = np.stack([rng.uniform(-90, 90, n), rng.uniform(-130, -40, n), -rng.uniform(30, 220, n)], axis=1)
    local[:, 2] -= sensor.window.thickness_mm
    return local @ sensor.window.R_lcs_window.T


def test_a_seen_point_lies_on_the_ray_of_its_pixel():
    sensor = tilted(paper_4())
    points = water_points(sensor)
    seen = see(sensor, points)
    rays = camera_rays(sensor, seen.xy_px)
    off = np.cross(points - rays.start_mm, rays.direction)
    # rounding: 1e-16 of 300 mm and of the inverse of the lens
    assert np.linalg.norm(off, axis=1).max() < 1e-9
    assert np.allclose(seen.up, -rays.direction, atol=1e-12)
    assert np.allclose(seen.water_mm, np.linalg.norm(points - rays.start_mm, axis=1), atol=1e-9)


def test_the_processing_finds_the_lit_point_again():
    sensor = tilted(paper_4())
    a = np.deg2rad(np.linspace(-40, 40, 81))
    origins = np.broadcast_to(sensor.sheet.origin_lcs_mm, (len(a), 3))
    beams = beams_in_water(origins, sensor.sheet.beams(a), sensor.window)
    lit = beams.start_mm + 130.0 * beams.direction
    found = intersect(sensor, see(sensor, lit).xy_px)
    # acceptance of the intersection: 1e-6 mm
    assert np.abs(found.xyz_lcs_mm - lit).max() < 1e-6
    assert np.abs(found.fan_angle_rad - a).max() < 1e-8
