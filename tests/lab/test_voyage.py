"""The true motion: derivatives agree with differences, the boat stays in the water and sees both banks."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from tests.lab.conftest import FRAME
from thalweg.core import ConfigError
from thalweg_lab.random_numbers import gauss_markov
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import Voyage, true_trajectory


@pytest.fixture(scope="module", params=["tiny", "demo", "mulde", "reach"])
def voyage(request):
    return Voyage(TwinConfig.of_size(request.param), 3)


def test_rates_and_velocities_are_the_derivatives_of_the_pose(voyage, rng):
    t = voyage.start_gps_s + rng.uniform(0, voyage.config.duration_s, 400)
    h = 1e-3
    # Time differences are taken as the floats give them: at 3e8 s they step by 60 ns.
    before, after = t - h, t + h
    step = (after - before)[:, None]
    velocity = (voyage.position_wcs_m(after) - voyage.position_wcs_m(before)) / step
    # h^2/6 times the third derivative (50 rad/s^3 of sway at most) is 1e-7 m/s; 60 ns stamps give 2e-4 of it.
    assert_allclose(voyage.velocity_wcs_mps(t), velocity, atol=2e-5)
    acceleration = (voyage.velocity_wcs_mps(after) - voyage.velocity_wcs_mps(before)) / step
    # The Hermite spline's second derivative is right to the square of its 20 ms nodes.
    assert_allclose(voyage.velocity_wcs_mps(t, 2), acceleration, atol=2e-3)
    turn = Rotation.from_matrix(voyage.R_wcs_ics(before)).inv() * Rotation.from_matrix(
        voyage.R_wcs_ics(after)
    )
    assert_allclose(voyage.rates_ics_radps(t), turn.as_rotvec() / step, atol=2e-5)
    lever = np.array([1.0, -2.0, 0.5])
    moved = (voyage.sensor_wcs_m(after, lever) - voyage.sensor_wcs_m(before, lever)) / step
    assert_allclose(voyage.sensor_velocity_wcs_mps(t, lever), moved, atol=5e-5)


def test_speed_and_turn_rate_are_those_of_the_settings(voyage):
    boat = voyage.config.boat
    t = voyage.start_gps_s + np.arange(0, voyage.config.duration_s, 0.05)
    speed = np.linalg.norm(voyage.velocity_wcs_mps(t)[:, :2], axis=1)
    # 1e-6: error of the Hermite spline between nodes.
    assert_allclose(speed, boat.speed_mps, rtol=1e-6)
    v = voyage.velocity_wcs_mps(t)
    turning = np.abs(np.gradient(np.unwrap(np.arctan2(v[:, 1], v[:, 0])), t))
    # The zigzag leaves the river's own bends room within the rate: it is reached where both add up, and the
    # reach may have no turn just there.
    assert np.rad2deg(turning.max()) <= boat.turn_rate_degps + 1e-3
    assert np.rad2deg(turning.max()) > 0.95 * boat.turn_rate_degps


def test_the_zigzag_reaches_both_sides_and_stays_in_the_water_clear_of_weir_and_ends(voyage):
    config = voyage.config
    t = voyage.start_gps_s + np.arange(-4.9, config.duration_s + 4.9, 0.1)
    p = voyage.position_wcs_m(t)
    s, n = voyage.river.to_flow(p[:, 0], p[:, 1])
    assert_allclose(voyage.river.to_wcs(s, n), p[:, :2], atol=1e-9)
    amplitude = 0.94 * config.scene.width_m / 2 - config.boat.bank_distance_m
    assert n.max() == pytest.approx(amplitude, rel=0.05)
    assert n.min() == pytest.approx(-amplitude, rel=0.05)
    draught_m = 0.2
    assert np.min(voyage.river.depth(s, n)) > draught_m + 0.3
    assert np.max(np.abs(s)) < config.scene.length_m / 2 - 15.0
    if config.scene.weir:
        assert np.min(np.abs(s - voyage.river.weir_s_m())) > 15.0
    if config.size == "reach":
        assert np.ptp(s) == pytest.approx(1500.0, rel=0.02)
        # The weir closes the reach in the west.
        weir = voyage.river.to_wcs(np.array(voyage.river.weir_s_m()), np.array(0.0))
        assert weir[0] < p[:, 0].min()


def test_the_boat_heels_outwards_in_turns():
    still = {"roll_deg": 0.0, "pitch_deg": 0.0, "yaw_deg": 0.0, "heave_m": 0.0}
    voyage = Voyage(TwinConfig.of_size("tiny", boat=still), 3)
    t = voyage.start_gps_s + np.arange(0.0, 25.0, 0.05)
    roll, pitch, heading = voyage.angles_rad(t)
    rate = np.gradient(np.unwrap(heading), t)
    boat = voyage.config.boat
    # A turn to the right (heading grows) throws the boat's top to the left: the right side rises.
    expected = -boat.heel_share * boat.speed_mps * rate / 9.81
    # 4e-4: second difference of a rate that bends by 0.3 rad/s^3 over 0.05 s.
    assert_allclose(roll, expected, atol=4e-4)
    assert np.rad2deg(np.max(np.abs(roll))) == pytest.approx(2.9, abs=0.3)
    assert_array_equal(pitch, 0.0)


def test_waves_sway_the_boat_within_the_amplitudes_and_together():
    voyage = Voyage(TwinConfig.of_size("mulde", boat={"heel_share": 0.0}), 3)
    boat = voyage.config.boat
    t = voyage.start_gps_s + np.arange(0.0, 1000.0, 0.1)
    roll, pitch, _ = voyage.angles_rad(t)
    heave = voyage.position_wcs_m(t)[:, 2] - voyage.config.scene.water_level_m - boat.height_m
    limits = np.array([np.deg2rad(boat.roll_deg), np.deg2rad(boat.pitch_deg), boat.heave_m])
    for motion, limit in zip((roll, pitch, heave), limits, strict=True):
        # Amplitudes that add up to the limit come close to it together within a thousand seconds, not always.
        assert 0.55 * limit < np.max(np.abs(motion)) <= limit + 1e-12
    # A boat tilts most where the water rises fastest: roll and pitch go with the rate of heave.
    rate = voyage.velocity_wcs_mps(t)[:, 2]
    tilt = np.linalg.lstsq(np.stack([roll, pitch], axis=1), rate, rcond=None)[0]
    with_rate = np.corrcoef(np.stack([roll, pitch], axis=1) @ tilt, rate)[0, 1]
    assert with_rate > 0.3
    assert abs(np.corrcoef(pitch, heave)[0, 1]) < 0.1


def test_the_truth_file_holds_the_motion(voyage):
    truth = true_trajectory(voyage, FRAME)
    t = voyage.start_gps_s + np.linspace(0, min(20.0, voyage.config.duration_s), 333)
    position, rotation, valid = truth.at(t)
    assert valid.all()
    # Chord error of 5 ms nodes: a dt^2 / 8 with a < 1.1 m/s^2 is 3.5 um.
    assert_allclose(position, voyage.position_wcs_m(t), atol=5e-6)
    assert_allclose(rotation, voyage.R_wcs_ics(t), atol=5e-6)


def test_gauss_markov_has_its_sigma_and_its_correlation_two_sided():
    x = gauss_markov(np.random.default_rng(1), 400_000, 0.1, 2.0, 1.0)
    # 400,000 samples with 20 correlated steps each: 20,000 independent ones, sigma known to 0.5 %.
    assert np.std(x) == pytest.approx(2.0, rel=0.02)
    for lag in (1, 10, 20):
        found = np.mean(x[lag:] * x[:-lag]) / np.mean(x * x)
        assert found == pytest.approx(np.exp(-0.1 * lag), abs=0.02)
    # Stationary from the first epoch: 3,000 starts give sigma to 1.3 %.
    starts = [gauss_markov(np.random.default_rng(k), 2, 0.1, 2.0, 1.0) for k in range(3000)]
    assert np.std([s[0] for s in starts]) == pytest.approx(2.0, rel=0.05)
    assert np.std([s[1] for s in starts]) == pytest.approx(2.0, rel=0.05)


def test_a_course_beside_the_middle_against_the_flow_on_a_drier_day():
    plain = Voyage(TwinConfig.of_size("tiny"), 3)
    dry = Voyage(TwinConfig.of_size("tiny", scene={"stage_m": -0.25}), 3)
    t = np.linspace(0.0, 25.0, 251)
    assert_allclose(dry.position_at(t) - plain.position_at(t), np.tile([0, 0, -0.25], (251, 1)))
    other = Voyage(
        TwinConfig.of_size("tiny", boat={"course_offset_m": -1.5, "upstream": True, "yaw_deg": 0.0}), 3
    )
    s, n = other.river.to_flow(*other.position_at(t)[:, :2].T)
    ahead, _ = plain.river.to_flow(*plain.position_at(t)[:, :2].T)
    assert np.all(np.diff(s) < 0)
    assert np.all(np.diff(ahead) > 0)
    assert (n.min() + n.max()) / 2 == pytest.approx(-1.5, abs=0.7)
    # The boat looks where it goes.
    v, heading = other.velocity_at(t), other.angles_at(t)[2]
    assert_allclose(np.cos(heading) * v[:, 1] + np.sin(heading) * v[:, 0], 2.4, rtol=1e-5)
    with pytest.raises(ConfigError, match="stage_m"):
        Voyage(TwinConfig.of_size("tiny", scene={"stage_m": -1.5}), 3)
    with pytest.raises(ConfigError, match="course_offset_m"):
        Voyage(TwinConfig.of_size("tiny", boat={"course_offset_m": 6.0}), 3)
