"""Derivatives in closed form against difference quotients, and the light's way to given points."""

from dataclasses import replace

import numpy as np
import pytest

from tests.lightsheet.beams import beams_at_points, sheet_normals
from thalweg.lightsheet.optics import (
    PARAMETERS,
    fan_angles,
    intersect,
    paper_4,
    point_derivatives,
    sheet_derivatives,
    sheet_in_water,
)


@pytest.fixture(scope="module")
def case():
    """A distorted lens, a tilted window, a diffracted line: nothing is zero."""
    sensor = paper_4()
    x = sensor.vector()
    x[7] += 3.0
    x[10:15] = [-0.08, 0.05, 0.001, -0.0007, 0.01]
    x[24:] = [0.02, -0.03]
    sensor = sensor.with_vector(x)
    sensor = sensor.with_sheet(replace(sensor.sheet, v=0.05))
    xy = np.random.default_rng(1).uniform(200, 1848, (60, 2))
    return sensor, xy, sheet_derivatives(sensor, xy)


def assert_close(analytic, quotient, name) -> None:
    """Within 1e-6 of the largest one: the demand; quotients of 1e-5 steps are good to some 1e-8."""
    scale = np.nanmax(np.abs(quotient))
    assert np.nanmax(np.abs(analytic - quotient)) <= 1e-6 * max(scale, 1e-6), name


def test_by_every_parameter(case):
    sensor, xy, found = case
    ok, x = found.points.ok, sensor.vector()
    assert ok.sum() > 40
    for i, name in enumerate(PARAMETERS):
        small = name.endswith("_rad") or name.startswith(("n_", "k", "p"))
        e = np.zeros(len(x))
        e[i] = 1e-6 if small else 1e-5 * max(1.0, abs(x[i]))
        high, low = (intersect(sensor.with_vector(x + s * e), xy) for s in (1, -1))
        for what, got in (
            ("xyz_lcs_mm", found.by_parameters[:, :, i]),
            ("depth_mm", found.depth_by_parameters[:, i]),
            ("fan_angle_rad", found.fan_by_parameters[:, i]),
        ):
            quotient = (getattr(high, what) - getattr(low, what)) / (2 * e[i])
            assert_close(got[ok], quotient[ok], (name, what))


def test_by_pixel_and_by_the_line(case):
    sensor, xy, found = case
    ok = found.points.ok
    for c in (0, 1):
        e = np.zeros(2)
        e[c] = 1e-3
        high, low = intersect(sensor, xy + e), intersect(sensor, xy - e)
        assert_close(found.by_pixel[ok][:, :, c], ((high.xyz_lcs_mm - low.xyz_lcs_mm) / 2e-3)[ok], c)
        assert_close(found.fan_by_pixel[ok][:, c], ((high.fan_angle_rad - low.fan_angle_rad) / 2e-3)[ok], c)
        assert_close(found.depth_by_pixel[ok][:, c], ((high.depth_mm - low.depth_mm) / 2e-3)[ok], c)
    high, low = (intersect(sensor.with_sheet(replace(sensor.sheet, v=0.05 + h)), xy) for h in (1e-6, -1e-6))
    assert_close(found.by_v[ok], ((high.xyz_lcs_mm - low.xyz_lcs_mm) / 2e-6)[ok], "v")
    assert_close(found.fan_by_v[ok], ((high.fan_angle_rad - low.fan_angle_rad) / 2e-6)[ok], "v")
    assert_close(found.depth_by_v[ok], ((high.depth_mm - low.depth_mm) / 2e-6)[ok], "v")


def test_no_point_has_no_derivatives(case):
    sensor, _, _ = case
    points, by_parameters, by_pixel = point_derivatives(
        sensor, [[5.0, 2000.0], [1024.0, 1024.0], [2047.0, 10.0]]
    )
    bad = ~points.ok
    assert bad.any()
    assert not bad.all()
    assert np.isnan(by_parameters[bad]).any(axis=(1, 2)).all()
    assert np.isnan(by_pixel[bad]).any(axis=(1, 2)).all()
    assert np.isfinite(by_parameters[~bad]).all()


def test_a_shift_of_camera_and_laser_shifts_the_points(case):
    """Along the window the whole sensor is free to move: the derivatives by both places add up to the unit
    matrix."""
    sensor, _, found = case
    ok = found.points.ok
    both = found.by_parameters[:, :, 0:3] + found.by_parameters[:, :, 15:18]
    R = sensor.window.R_lcs_window
    along = (both @ R)[:, :, :2]
    assert np.abs(along[ok] - R[:, :2]).max() < 1e-9  # a symmetry of the equations: rounding only


# ---------------------------------------------------------------- light


def test_light_that_reaches_a_point_beside_the_sheet(case):
    sensor, _, _ = case
    D = np.array([30.0, 100.0, 220.0])
    a = np.array([-0.4, 0.1, 0.5])
    at, normal = sheet_normals(sensor.sheet, sensor.window, a, D)
    for shift in (0.3, -0.2):
        light = beams_at_points(sensor, at + shift * normal)
        # to first order: the sheet is bent by less than 1 / 100 mm
        assert np.abs(light.distance_mm - shift).max() < 1e-3 * abs(shift)
        assert ((light.v - sensor.sheet.v) * shift > 0).all()
        assert light.inside.all()


def test_fan_angles_span_the_fan():
    angles = fan_angles(paper_4(), 7)
    assert np.allclose(np.rad2deg(angles), [-45, -30, -15, 0, 15, 30, 45])
    assert sheet_in_water(paper_4(), [], angles).shape == (0, 7, 3)
    assert sheet_in_water(paper_4(), [1.0, 2.0], angles).shape == (2, 7, 3)
