"""The true multi-line laser: grating equation, tilt, caustic and the lines that they make."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose

from thalweg.lightsheet.optics import paper_4
from thalweg_lab.tank import GratingErrors, make_grating

SENSOR = paper_4()
IDEAL = GratingErrors(
    tilt_deg=(0.0, 0.0),
    grooves_deg=0.0,
    cover_mm=0.0,
    sigma_spacing_deg=0.0,
    sigma_rotation_deg=0.0,
    sigma_origin_mm=(0.0, 0.0, 0.0),
    sigma_bow=0.0,
)


def _local(errors, seed=1, n=41):
    grating = make_grating(SENSOR, seed, errors=errors)
    a = np.linspace(-0.24, 0.24, n)
    line = np.repeat(np.arange(15), n)
    origins, directions = grating.beams(line, np.tile(a, 15))
    R = SENSOR.sheet.R_lcs_las
    return (origins - SENSOR.sheet.origin_lcs_mm) @ R, directions @ R, line


def test_ideal_grating_makes_cones_in_equal_steps_of_sine():
    origins, d, line = _local(IDEAL)
    assert_allclose(np.linalg.norm(d, axis=1), 1.0, atol=1e-14)
    assert_allclose(origins, 0.0, atol=1e-12)
    v = d[:, 1].reshape(15, -1)
    assert_allclose(np.ptp(v, axis=1), 0.0, atol=1e-14)
    assert_allclose(np.diff(v[:, 0]), np.sin(np.deg2rad(1.7)), atol=1e-14)
    assert line.max() == 14


def test_tilt_bends_lines_that_are_no_cones():
    """The grating equation holds in the frame of the tilted grating; here for the middle of the fan."""
    tilted = replace(IDEAL, tilt_deg=(3.0, 0.0))
    _, d, _ = _local(tilted)
    v = d[:, 1].reshape(15, -1)
    assert np.ptp(v[14]) > 1e-5  # a cone has 1e-14
    t, j = np.deg2rad(3.0), 7
    # plane problem: sin(out) = sin(in) + j step, angles from the grating's normal, which leans by t
    out = np.arcsin(-np.sin(t) + j * np.sin(np.deg2rad(1.7))) + t
    assert_allclose(v[14, 20], np.sin(out), atol=1e-12)


def test_cover_moves_origins_along_a_caustic():
    """Behind a plate a ray at t seems to come from T sin t (1 / sqrt(n^2 - sin^2 t) - 1 / cos t) aside."""
    covered = replace(IDEAL, cover_mm=2.0)
    origins, d, _ = _local(covered)
    sine = np.hypot(d[:, 0], d[:, 1])
    expected = 2.0 * sine * (1 / np.sqrt(1.52**2 - sine**2) - 1 / np.sqrt(1 - sine**2))
    assert_allclose(np.hypot(origins[:, 0], origins[:, 1]), np.abs(expected), atol=1e-12)
    assert np.abs(origins).max() > 0.1
