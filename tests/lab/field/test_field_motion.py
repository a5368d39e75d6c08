"""The run about the field turns, changes its speed and stays off the cones; the standing boat stands."""

import datetime as dt

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from thalweg.core import CoverageError, gps_from_unix, rotation_enu_body
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import FieldRun, Voyage, motion_of, standing, static_seed
from thalweg_lab.voyage.motion import eight, static_recording
from thalweg_lab.yard import Field

SEED = 4


@pytest.fixture(scope="module", params=["field", "field_tiny"])
def run(request: pytest.FixtureRequest) -> FieldRun:
    return FieldRun(TwinConfig.of_size(request.param), SEED)


def times(run: FieldRun) -> np.ndarray:
    return np.arange(-5.0, run.config.duration_s + 5.0, 0.01)


def test_the_eight_closes_has_length_one_and_turns_to_both_sides() -> None:
    phase = np.linspace(0, 2 * np.pi, 20_001)
    way = np.diff(eight(phase))
    assert abs(eight(phase[[0, -1]]) @ [1, -1]) < 1e-12
    # Chords of 20,000 pieces: 1e-8 shorter.
    assert np.abs(way).sum() == pytest.approx(1.0, abs=1e-7)
    heading = np.unwrap(np.angle(way))
    # First zero of J0.
    assert np.ptp(heading) / 2 == pytest.approx(2.404825557695773, abs=1e-6)


def test_speed_swings_and_turns_are_those_of_a_boat_moved_by_hand(run: FieldRun) -> None:
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


def test_all_headings_are_met(run: FieldRun) -> None:
    heading = np.rad2deg(run.angles_at(times(run))[2])
    count, _ = np.histogram(heading, np.arange(0, 361, 30))
    assert (count > 0).all()


def test_the_run_stays_in_the_middle_and_clear_of_the_cones(run: FieldRun, field: Field) -> None:
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


def test_rates_and_velocities_are_derivatives(run: FieldRun) -> None:
    t, h = np.linspace(1, 30, 200), 1e-4
    R = rotation_enu_body(*run.angles_at(t))
    turned = Rotation.from_matrix(np.swapaxes(R, 1, 2) @ rotation_enu_body(*run.angles_at(t + h))).as_rotvec()
    back = Rotation.from_matrix(np.swapaxes(R, 1, 2) @ rotation_enu_body(*run.angles_at(t - h))).as_rotvec()
    # Central differences err by h^2 / 6 of the third derivative, and by 1e-15 / h in rounding.
    np.testing.assert_allclose((turned - back) / (2 * h), run.rates_at(t), atol=2e-6)
    for order in (1, 2):
        lower = run.position_at if order == 1 else run.velocity_at
        slope = (lower(t + h) - lower(t - h)) / (2 * h)
        np.testing.assert_allclose(slope, run.velocity_at(t, order), atol=2e-6)


def test_heading_follows_the_course(run: FieldRun) -> None:
    t = times(run)
    v = run.velocity_at(t)
    off = np.rad2deg(run.angles_at(t)[2] - np.arctan2(v[:, 0], v[:, 1]))
    # Yawing of one degree.
    assert np.abs((off + 180) % 360 - 180).max() < 1.001


def test_seeds_give_other_runs_and_each_its_own(run: FieldRun) -> None:
    t = np.array([3.0, 20.0])
    again, other = FieldRun(run.config, SEED), FieldRun(run.config, SEED + 1)
    np.testing.assert_array_equal(run.position_at(t), again.position_at(t))
    assert np.abs(run.position_at(t) - other.position_at(t)).max() > 0.1


def test_the_boat_stands_where_the_settings_say() -> None:
    config = TwinConfig.of_size("field_tiny")
    for number, place in enumerate(config.field.positions, start=1):
        boat = standing(config, number)
        t = boat.start_gps_s + np.array([0.0, 1.0])
        np.testing.assert_array_equal(boat.position_wcs_m(t), [[place.east_m, place.north_m, 0.6]] * 2)
        roll, pitch, heading = (np.rad2deg(a) for a in boat.angles_rad(t))
        np.testing.assert_allclose(roll, place.roll_deg)
        np.testing.assert_allclose(pitch, place.pitch_deg)
        np.testing.assert_allclose(heading, place.heading_deg % 360)
        assert not boat.velocity_wcs_mps(t).any()
        assert not boat.rates_ics_radps(t).any()
        pose = boat.T_wcs_ics
        np.testing.assert_allclose(
            boat.sensor_wcs_m(t, np.array([1.0, 2, 3]))[0], pose.apply([[1.0, 2, 3]])[0]
        )


def test_positions_differ_mostly_in_orientation() -> None:
    config = TwinConfig.of_size("field")
    poses = [standing(config, n).T_wcs_ics for n in (1, 2, 3)]
    assert max(np.linalg.norm(a.shift_m - b.shift_m) for a in poses for b in poses) < 0.8
    turns = [
        np.rad2deg(Rotation.from_matrix(a.R @ b.R.T).magnitude()) for a in poses for b in poses if a is not b
    ]
    assert min(turns) > 10
    assert max(turns) > 160


def test_static_recordings_come_before_the_run_and_have_noise_of_their_own() -> None:
    config = TwinConfig.of_size("field")
    run_begin = dt.datetime.fromisoformat(config.start_utc)
    begins = [dt.datetime.fromisoformat(static_recording(config, n).start_utc) for n in (1, 2, 3)]
    assert begins == sorted(begins)
    assert (run_begin - begins[-1]).total_seconds() > config.field.position_s + 10
    assert len({static_seed(SEED, n) for n in (1, 2, 3)} | {SEED}) == 4
    boat = standing(config, 2)
    assert boat.start_gps_s == gps_from_unix(int(begins[1].timestamp()), 0)
    with pytest.raises(CoverageError):
        boat.position_wcs_m(np.array([boat.start_gps_s + 20.0]))


def test_the_configuration_chooses_the_motion() -> None:
    assert isinstance(motion_of(TwinConfig.of_size("field"), 1), FieldRun)
    assert isinstance(motion_of(TwinConfig.of_size("tiny"), 1), Voyage)
