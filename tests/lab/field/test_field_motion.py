"""The run about the field turns, changes its speed and stays off the cones; the standing boat stands."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from thalweg.core import rotation_enu_body
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import FieldRun, standing

SEED = 4


@pytest.fixture(scope="module", params=["field", "field_tiny"])
def run(request):
    return FieldRun(TwinConfig.of_size(request.param), SEED)


def times(run):
    return np.arange(-5.0, run.config.duration_s + 5.0, 0.01)


def test_speed_swings_and_turns_are_those_of_a_boat_moved_by_hand(run):
    t = times(run)
    speed = np.linalg.norm(run.velocity_at(t)[:, :2], axis=1)
    # 0.65 m/s and 35 % less, 0.07 m/s less by the turn of the eight.
    assert 0.33 < speed.min() < 0.45
    assert 0.75 < speed.max() < 1.2
    rate = np.rad2deg(run.rates_at(t)[:, 2])
    # Loops to both sides in equal parts; yawing comes on top of some 25 degrees/s.
    assert 18 < np.percentile(rate, 98) < 32
    assert 18 < -np.percentile(rate, 2) < 32
    assert np.mean(np.abs(rate) > 10) > 0.5


def test_the_run_stays_in_the_middle_and_clear_of_the_cones(run, field):
    t = times(run)
    place = run.position_at(t)
    reach = np.linalg.norm(place[:, :2], axis=1)
    assert 2.6 < reach.max() < 2.9 + 1e-6
    assert np.abs(place[:, 2] - 0.6).max() < 0.021  # heave of 2 cm
    # The corners of the boat.
    for corner in ([0.6, 0.37, 0.0], [0.6, -0.37, 0.0], [-0.6, 0.37, 0.0], [-0.6, -0.37, 0.0]):
        there = place + np.einsum("nij,j->ni", rotation_enu_body(*run.angles_at(t)), np.array(corner))
        for cone in field.cones:
            centre, radius = cone.sphere
            assert np.linalg.norm((there - centre)[:, :2], axis=1).min() > radius - 0.15


def test_rates_and_velocities_are_derivatives(run):
    t, h = np.linspace(1, 30, 200), 1e-4
    R = rotation_enu_body(*run.angles_at(t))
    turned = Rotation.from_matrix(np.swapaxes(R, 1, 2) @ rotation_enu_body(*run.angles_at(t + h))).as_rotvec()
    back = Rotation.from_matrix(np.swapaxes(R, 1, 2) @ rotation_enu_body(*run.angles_at(t - h))).as_rotvec()
    # Central differences err by h^2 / 6 of the third derivative, and by 1e-15 / h in rounding.
    assert_allclose((turned - back) / (2 * h), run.rates_at(t), atol=2e-6)
    for order in (1, 2):
        lower = run.position_at if order == 1 else run.velocity_at
        slope = (lower(t + h) - lower(t - h)) / (2 * h)
        assert_allclose(slope, run.velocity_at(t, order), atol=2e-6)


def test_the_boat_stands_where_the_settings_say():
    config = TwinConfig.of_size("field_tiny")
    for number, place in enumerate(config.field.positions, start=1):
        boat = standing(config, number)
        t = boat.start_gps_s + np.array([0.0, 1.0])
        assert_array_equal(boat.position_wcs_m(t), [[place.east_m, place.north_m, 0.6]] * 2)
        roll, pitch, heading = (np.rad2deg(a) for a in boat.angles_rad(t))
        assert_allclose(roll, place.roll_deg)
        assert_allclose(pitch, place.pitch_deg)
        assert_allclose(heading, place.heading_deg % 360)
        assert not boat.velocity_wcs_mps(t).any()
        assert not boat.rates_ics_radps(t).any()
        pose = boat.T_wcs_ics
        assert_allclose(boat.sensor_wcs_m(t, np.array([1.0, 2, 3]))[0], pose.apply([[1.0, 2, 3]])[0])
