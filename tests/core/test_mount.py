"""The mount of a sensor: what its sigmas belong to, and the order of its covariance."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from thalweg.core import GeometryError, Rigid, rotation_opk

SECTION = {
    "omega_deg": 0.0,
    "phi_deg": -90.0,
    "kappa_deg": 0.0,
    "lever_ics_m": (-0.35, 0.02, -0.25),
    "sigma_omega_deg": 0.01,
    "sigma_phi_deg": 0.02,
    "sigma_kappa_deg": 0.04,
    "sigma_lever_m": (0.001, 0.002, 0.003),
    "correlation": None,
}
"""The scanner of the published boat: at phi = -90 degrees kappa and omega both turn about x of ics."""


def test_sigmas_of_angles_at_minus_ninety_degrees():
    """``R = R_x(omega) R_y(phi) R_z(kappa)``: kappa's axis is then ``R_y(-90) z = -x``."""
    for section in (SECTION, SECTION | {"sigma_axes": "angles"}):
        sigma_deg = np.rad2deg(Rigid.from_mount(section).sigma_rotation_rad)
        # x: omega and kappa together; nothing turns about z. 1e-9: cosine of -90 degrees in float64
        assert_allclose(sigma_deg, [np.hypot(0.01, 0.04), 0.02, 0.0], atol=1e-9)


def test_sigmas_about_the_axes_of_ics_are_taken_as_they_stand():
    mount = Rigid.from_mount(SECTION | {"sigma_axes": "ics"})
    assert_allclose(np.rad2deg(mount.sigma_rotation_rad), [0.01, 0.02, 0.04])
    assert_allclose(mount.sigma_shift_m, [0.001, 0.002, 0.003])


def test_a_correlation_belongs_to_the_order_of_the_section():
    """Omega, phi, kappa, x, y, z: phi and z are the second and the sixth."""
    correlation = np.eye(6)
    correlation[1, 5] = correlation[5, 1] = 0.5
    mount = Rigid.from_mount(SECTION | {"sigma_axes": "ics", "correlation": correlation})
    assert mount.cov[4, 2] == pytest.approx(0.5 * np.deg2rad(0.02) * 0.003)
    assert np.count_nonzero(mount.cov) == 8


def test_no_rotation_is_refused_for_its_rounding(rng):
    """The determinant of every other product of three rotations is a few 1e-16 below one."""
    for angles in rng.uniform(-np.pi, np.pi, (50, 3)):
        Rigid(R=rotation_opk(*angles), shift_m=np.zeros(3))
    with pytest.raises(GeometryError, match="no rotation matrix"):
        Rigid(R=-np.eye(3), shift_m=np.zeros(3))
