"""Derivatives in closed form against difference quotients."""

from dataclasses import replace

import numpy as np
import pytest

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


def largest_error(case, got, high, low, step):
    """Derivatives of place, depth and fan angle against difference quotients, by the largest of each."""
    ok = case[2].points.ok
    errors = []
    for name, analytic in zip(("xyz_lcs_mm", "depth_mm", "fan_angle_rad"), got, strict=True):
        quotient = (getattr(high, name) - getattr(low, name))[ok] / step
        errors.append(np.abs(analytic[ok] - quotient).max() / max(np.abs(quotient).max(), 1e-6))
    return max(errors)


DEMAND = 1e-6
"""Quotients of 1e-5 steps are good to some 1e-8."""


@pytest.mark.parametrize("name", PARAMETERS)
def test_by_every_parameter(case, name):
    sensor, xy, found = case
    x, i = sensor.vector(), PARAMETERS.index(name)
    assert found.points.ok.sum() > 40
    small = name.endswith("_rad") or name.startswith(("n_", "k", "p"))
    e = np.zeros(len(x))
    e[i] = 1e-6 if small else 1e-5 * max(1.0, abs(x[i]))
    high, low = (intersect(sensor.with_vector(x + s * e), xy) for s in (1, -1))
    got = found.by_parameters[:, :, i], found.depth_by_parameters[:, i], found.fan_by_parameters[:, i]
    assert largest_error(case, got, high, low, 2 * e[i]) < DEMAND


@pytest.mark.parametrize("c", [0, 1], ids=["x", "y"])
def test_by_pixel(case, c):
    sensor, xy, found = case
    e = 1e-3 * np.eye(2)[c]
    got = found.by_pixel[:, :, c], found.depth_by_pixel[:, c], found.fan_by_pixel[:, c]
    assert largest_error(case, got, intersect(sensor, xy + e), intersect(sensor, xy - e), 2e-3) < DEMAND


def test_by_the_line(case):
    sensor, xy, found = case
    high, low = (intersect(sensor.with_sheet(replace(sensor.sheet, v=0.05 + h)), xy) for h in (1e-6, -1e-6))
    assert largest_error(case, (found.by_v, found.depth_by_v, found.fan_by_v), high, low, 2e-6) < DEMAND


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


def test_fan_angles_span_the_fan():
    angles = fan_angles(paper_4(), 7)
    assert np.allclose(np.rad2deg(angles), [-45, -30, -15, 0, 15, 30, 45])
    assert sheet_in_water(paper_4(), [], angles).shape == (0, 7, 3)
    assert sheet_in_water(paper_4(), [1.0, 2.0], angles).shape == (2, 7, 3)
