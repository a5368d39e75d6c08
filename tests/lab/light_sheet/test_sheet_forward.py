"""Rays to the water and points to the image: against Fermat's principle and against the processing."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from thalweg.lightsheet.optics import Sensor, intersect, paper_3, paper_4, project
from thalweg_lab.tank.forward import beams_in_water, camera_rays, see


def tilted(sensor: Sensor) -> Sensor:
    return replace(sensor, window=replace(sensor.window, tilt_x_rad=0.02, tilt_y_rad=-0.013))


def water_points(sensor: Sensor, n: int = 200) -> np.ndarray:
    rng = np.random.default_rng(3)
    local = np.stack([rng.uniform(-90, 90, n), rng.uniform(-130, -40, n), -rng.uniform(30, 220, n)], axis=1)
    local[:, 2] -= sensor.window.thickness_mm
    return local @ sensor.window.R_lcs_window.T


def test_a_seen_point_lies_on_the_ray_of_its_pixel() -> None:
    sensor = tilted(paper_4())
    points = water_points(sensor)
    seen = see(sensor, points)
    rays = camera_rays(sensor, seen.xy_px)
    off = np.cross(points - rays.start_mm, rays.direction)
    # rounding: 1e-16 of 300 mm and of the inverse of the lens
    assert np.linalg.norm(off, axis=1).max() < 1e-9
    assert np.allclose(seen.up, -rays.direction, atol=1e-12)
    assert np.allclose(seen.water_mm, np.linalg.norm(points - rays.start_mm, axis=1), atol=1e-9)


def test_the_way_of_the_light_is_the_shortest_in_time() -> None:
    sensor = paper_4()
    point = np.array([35.0, -95.0, -sensor.window.thickness_mm - 140.0])
    eye, t, w = sensor.camera_origin_lcs_mm, sensor.window.thickness_mm, sensor.window

    def optical_way(q: np.ndarray) -> float:
        inner, outer = np.array([q[0], q[1], 0.0]), np.array([q[2], q[3], -t])
        legs = [np.linalg.norm(inner - eye), np.linalg.norm(outer - inner), np.linalg.norm(point - outer)]
        return float(np.dot(legs, [w.n_air, w.n_glass, w.n_water]))

    found = minimize(optical_way, np.tile(point[:2] / 2, 2), method="BFGS", options={"gtol": 1e-10})
    seen = see(sensor, point[None])
    outer = point + seen.up[0] * seen.water_mm[0]
    # the minimum is flat: 1e-9 of 300 mm in the way are some 1e-4 mm in the place
    assert outer[:2] == pytest.approx(found.x[2:], abs=5e-4)


@pytest.mark.parametrize("sensor", [paper_3(), paper_4(), tilted(paper_4())], ids=["P3", "P4", "tilted"])
def test_the_processing_projects_alike(sensor: Sensor) -> None:
    points = water_points(sensor)
    # two codes, the same physics: rounding of the lens in pixels
    assert np.allclose(see(sensor, points).xy_px, project(sensor, points), atol=1e-8, equal_nan=True)


def test_the_processing_finds_the_lit_point_again() -> None:
    sensor = tilted(paper_4())
    a = np.deg2rad(np.linspace(-40, 40, 81))
    origins = np.broadcast_to(sensor.sheet.origin_lcs_mm, (len(a), 3))
    beams = beams_in_water(origins, sensor.sheet.beams(a), sensor.window)
    lit = beams.start_mm + 130.0 * beams.direction
    found = intersect(sensor, see(sensor, lit).xy_px)
    # acceptance of the intersection: 1e-6 mm
    assert np.abs(found.xyz_lcs_mm - lit).max() < 1e-6
    assert np.abs(found.fan_angle_rad - a).max() < 1e-8


def test_a_point_above_the_window_has_no_image() -> None:
    assert np.isnan(see(paper_4(), np.array([[0.0, -80.0, -1.0]])).xy_px).all()
