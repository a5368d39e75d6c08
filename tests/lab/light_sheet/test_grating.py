"""The true multi-line laser: grating equation, tilt, caustic and the lines that they make."""

import numpy as np

from thalweg.lightsheet.optics import paper_4
from thalweg_lab.tank import GratingErrors, calibration_points, make_grating
from thalweg_lab.tank.grating import image_of_level

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


def _local(errors: GratingErrors, seed: int = 1, n: int = 41):
    grating = make_grating(SENSOR, seed, errors=errors)
    a = np.linspace(-0.24, 0.24, n)
    line = np.repeat(np.arange(15), n)
    origins, directions = grating.beams(line, np.tile(a, 15))
    R = SENSOR.sheet.R_lcs_las
    return (origins - SENSOR.sheet.origin_lcs_mm) @ R, directions @ R, line


def test_ideal_grating_makes_cones_in_equal_steps_of_sine() -> None:
    origins, d, line = _local(IDEAL)
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1.0, atol=1e-14)
    np.testing.assert_allclose(origins, 0.0, atol=1e-12)
    v = d[:, 1].reshape(15, -1)
    np.testing.assert_allclose(np.ptp(v, axis=1), 0.0, atol=1e-14)
    np.testing.assert_allclose(np.diff(v[:, 0]), np.sin(np.deg2rad(1.7)), atol=1e-14)
    assert line.max() == 14


def test_tilt_bends_lines_that_are_no_cones() -> None:
    """The grating equation holds in the frame of the tilted grating; here for the middle of the fan."""
    tilted = GratingErrors(**{**_fields(IDEAL), "tilt_deg": (3.0, 0.0)})
    _, d, _ = _local(tilted)
    v = d[:, 1].reshape(15, -1)
    assert np.ptp(v[14]) > 1e-5  # a cone has 1e-14
    t, j = np.deg2rad(3.0), 7
    # plane problem: sin(out) = sin(in) + j step, angles from the grating's normal, which leans by t
    out = np.arcsin(-np.sin(t) + j * np.sin(np.deg2rad(1.7))) + t
    np.testing.assert_allclose(v[14, 20], np.sin(out), atol=1e-12)


def test_cover_moves_origins_along_a_caustic() -> None:
    """Behind a plate a ray at t seems to come from T sin t (1 / sqrt(n^2 - sin^2 t) - 1 / cos t) aside."""
    covered = GratingErrors(**{**_fields(IDEAL), "cover_mm": 2.0})
    origins, d, _ = _local(covered)
    sine = np.hypot(d[:, 0], d[:, 1])
    expected = 2.0 * sine * (1 / np.sqrt(1.52**2 - sine**2) - 1 / np.sqrt(1 - sine**2))
    np.testing.assert_allclose(np.hypot(origins[:, 0], origins[:, 1]), np.abs(expected), atol=1e-12)
    assert np.abs(origins).max() > 0.1


def test_irregular_spacing_keeps_the_opening() -> None:
    even = make_grating(SENSOR, 1, errors=IDEAL)
    uneven = make_grating(SENSOR, 1, errors=GratingErrors(**{**_fields(IDEAL), "irregular": 0.3}))
    np.testing.assert_allclose(uneven.cosine_offsets[[0, -1]], even.cosine_offsets[[0, -1]], atol=1e-12)
    steps = np.diff(uneven.cosine_offsets) / np.diff(even.cosine_offsets)
    assert 0.1 < np.std(steps) < 0.25  # uniform in +-0.3: 0.17
    assert steps.min() > 0.6


def test_streams_are_separate() -> None:
    """Another bow changes neither spacing nor noise."""
    one = make_grating(SENSOR, 1)
    two = make_grating(SENSOR, 1, errors=GratingErrors(sigma_bow=0.0))
    np.testing.assert_array_equal(one.cosine_offsets, two.cosine_offsets)
    np.testing.assert_array_equal(one.offsets_mm, two.offsets_mm)


def test_points_scatter_as_stated() -> None:
    grating = make_grating(SENSOR, 1)
    a = np.zeros(15) + 0.01
    xy, angle = image_of_level(SENSOR, grating, np.arange(15), a, np.full(15, 100.0))
    assert np.isfinite(xy).all()
    # lines run along the columns: they are measured nearly along the rows
    assert np.abs(np.sin(angle)).max() < 0.2
    quiet = calibration_points(SENSOR, grating, (75.0, 140.0), 1, sigma_px=1e-9, sigma_along_px=1e-9)
    noisy = calibration_points(SENSOR, grating, (75.0, 140.0), 1, sigma_px=0.3, sigma_along_px=1e-9)
    u = np.stack([np.cos(quiet.angle_rad), np.sin(quiet.angle_rad)], axis=1)
    across = np.einsum("ni,ni->n", noisy.xy_px - quiet.xy_px, u)
    # 1,900 points: 1.6 % statistical
    np.testing.assert_allclose(np.std(across), 0.3, rtol=0.06)
    assert (quiet.depth_mm[quiet.pairs[:, 0]] == 75.0).all()
    assert (quiet.depth_mm[quiet.pairs[:, 1]] == 140.0).all()


def _fields(errors: GratingErrors) -> dict:
    return {name: getattr(errors, name) for name in GratingErrors.__dataclass_fields__}
