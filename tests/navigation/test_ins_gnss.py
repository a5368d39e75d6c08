"""Antenna positions + INS attitudes -> trajectory: signs, lever arms, gaps, fixes, covariance."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from thalweg.core import CoverageError, InputError, LocalFrame, roll_pitch_heading, rotation_enu_body
from thalweg.navigation.ins_gnss import build_trajectory, trajectory_from_states
from thalweg.navigation.ins_gnss.trajectory import (
    TrajectorySummary,
    check_origin,
    usable_positions,
    usable_states,
)

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
LEVER = np.array([0.30, -0.20, -0.80])  # forward, right, down: the antenna is above the INS
T0 = 4.0e8


def motion(t, far_m=0.0):
    """Position of the ics origin and R_wcs_ics of a boat that turns and rolls."""
    s = t - T0
    position = np.column_stack([far_m + 0.4 * s, 2 * np.sin(0.3 * s), 0.02 * np.sin(2 * s)])
    return position, rotation_enu_body(0.05 * np.sin(1.9 * s), 0.03 * np.sin(1.4 * s), 1.0 + 0.12 * s)


def survey(far_m=0.0, duration_s=20.0):
    t_ins = T0 + np.arange(0, duration_s, 0.02)
    position, R = motion(t_ins, far_m)
    lat, lon, h = FRAME.to_geodetic(position)
    R_wcs_enu = FRAME.R_wcs_enu(lat, lon)
    roll, pitch, heading = roll_pitch_heading(np.swapaxes(R_wcs_enu, 1, 2) @ R)  # of its own local level
    step = 1e-3  # differences over 2 ms: motion of 2 rad/s changes its rate by 1e-6 of itself
    wcs_mps = (motion(t_ins + step, far_m)[0] - motion(t_ins - step, far_m)[0]) / (2 * step)
    v_east, v_north, v_up = np.einsum("nji,nj->in", R_wcs_enu, wcs_mps)
    states = {"t_gps_s": t_ins, "roll_rad": roll, "pitch_rad": pitch, "heading_rad": heading}
    states |= {"lat_deg": lat, "lon_deg": lon, "h_ell_m": h, "filter_status": np.uint16(0b1111)}
    states |= {"v_north_mps": v_north, "v_east_mps": v_east, "v_down_mps": -v_up}
    states |= {"sigma_north_m": 0.6, "sigma_east_m": 0.5, "sigma_up_m": 1.0}
    states |= dict.fromkeys(("sigma_roll_rad", "sigma_pitch_rad", "sigma_heading_rad"), np.nan)
    t_gnss = T0 + np.arange(0, duration_s, 0.1)
    position, R = motion(t_gnss, far_m)
    lat, lon, h = FRAME.to_geodetic(position + R @ LEVER)
    positions = {"t_gps_s": t_gnss, "lat_deg": lat, "lon_deg": lon, "h_ell_m": h, "fix": "fixed"}
    positions |= {"sigma_east_m": 0.02, "sigma_north_m": 0.02, "sigma_up_m": 0.03}
    positions |= {"cov_en_m2": 1e-4, "cov_eu_m2": np.nan, "cov_nu_m2": np.nan}
    return pd.DataFrame(positions), pd.DataFrame(states)


def build(positions, states, **changes):
    options = {
        "lever_ics_antenna_m": LEVER,
        "sigma_lever_m": np.array([0.01, 0.02, 0.03]),
        "accept_fixes": ["fixed"],
        "max_gap_s": 0.5,
        "max_attitude_gap_s": 0.2,
        "sigma_attitude_rad": np.deg2rad([0.1, 0.1, 0.2]),
    }
    return build_trajectory(positions, states, FRAME, **(options | changes))


def by_states(states, sigma_attitude_rad=(3e-3, 4e-3, 5e-3), **more):
    how = {"max_attitude_gap_s": 0.2, "sigma_attitude_rad": sigma_attitude_rad}
    return trajectory_from_states(states, FRAME, **how, **more)


def covered(trajectory, *after_s):
    """Whether there are poses so many seconds after the begin."""
    return trajectory.at(T0 + np.array(after_s))[2].tolist()


@pytest.mark.parametrize("far_m", [0.0, 1500.0])
def test_the_motion_comes_back(far_m):
    """1500 m from the origin the local vertical of the INS is tilted by 0.013 deg: must be taken off."""
    positions, states = survey(far_m)
    trajectory, summary = build(positions, states)
    use = trajectory.valid
    position, R = motion(trajectory.t_gps_s[use], far_m)
    # cubic spline of a sine of 0.3 rad at 0.1 s steps (antenna swings with roll): below 0.1 mm
    assert_allclose(trajectory.position_wcs_m[use], position, atol=1e-4)
    R_found = trajectory.at(trajectory.t_gps_s[use][:-1])[1]
    # 1e-6 rad: the antenna's level is taken instead of the INS's, 0.9 m / 6371 km = 1.4e-7 rad
    assert_allclose(R_found, R[:-1], atol=1e-6)
    assert summary.n_positions_used == len(positions)
    assert use.mean() > 0.99


def test_covariance_holds_position_and_lever_arm():
    """Six different numbers of the antenna; node 100 is an epoch: nothing is added for the interpolation."""
    positions, states = survey()
    positions[["sigma_east_m", "sigma_north_m", "sigma_up_m"]] = [0.02, 0.03, 0.04]
    positions[["cov_en_m2", "cov_eu_m2", "cov_nu_m2"]] = [1e-4, 2e-4, -3e-4]
    trajectory, _ = build(positions, states)
    R = motion(trajectory.t_gps_s[[100]])[1][0]
    # an error of the attitude turns the boat about its antenna: the ics origin moves by the lever arm
    arm = np.cross(np.eye(3), R @ LEVER)
    turned = arm.T @ trajectory.cov_pose_wcs[100, 3:, 3:] @ arm
    antenna = np.array([[4e-4, 1e-4, 2e-4], [1e-4, 9e-4, -3e-4], [2e-4, -3e-4, 16e-4]])
    lever = R @ np.diag([1e-4, 4e-4, 9e-4]) @ R.T
    cov = trajectory.cov_pose_wcs[100, :3, :3]
    assert_allclose(cov, antenna + lever + turned, rtol=1e-4, atol=1e-9)
    assert_allclose(trajectory.sigma_roll_pitch_heading_rad()[100], np.deg2rad([0.1, 0.1, 0.2]))


def test_sigmas_of_the_log_win_over_the_configured_ones():
    positions, states = survey()
    trajectory, _ = build(positions, states.assign(sigma_heading_rad=0.01))
    assert_allclose(trajectory.sigma_roll_pitch_heading_rad()[:, 2], 0.01)


def test_a_hole_in_the_positions_is_not_bridged():
    positions, states = survey()
    s = positions["t_gps_s"] - T0
    trajectory, summary = build(positions[(s < 8.05) | (s > 10.05)], states)
    inside = (trajectory.t_gps_s > T0 + 8.01) & (trajectory.t_gps_s < T0 + 10.09)
    assert not trajectory.valid[inside].any()
    assert trajectory.valid[(trajectory.t_gps_s < T0 + 8) & (trajectory.t_gps_s >= T0)].all()
    assert len(summary.gaps) == 1
    assert summary.gaps[0][1] == pytest.approx(2.1, abs=1e-6)


def test_a_hole_in_the_attitudes_is_not_bridged():
    positions, states = survey()
    s = states["t_gps_s"] - T0
    trajectory, summary = build(positions, states[(s < 5) | (s > 7)])
    assert covered(trajectory, 4.5, 5.5, 6.0, 6.9, 7.5) == [True, False, False, False, True]
    assert summary.gaps[-1][1] == pytest.approx(2.04, abs=1e-6)


def test_a_float_solution_enters_only_if_accepted():
    positions, states = survey()
    positions.loc[positions.index[50:80], "fix"] = "float"
    strict, summary = build(positions, states)
    assert summary.fixes == {"fixed": 170, "float": 30}
    assert summary.n_positions_used == 170
    loose, _ = build(positions, states, accept_fixes=["fixed", "float"])
    assert covered(strict, 6.5) + covered(loose, 6.5) == [False, True]


@pytest.mark.parametrize(
    ("floats", "used"),
    [
        ((50, 80), 200),  # a hole of 3 s is filled
        ((50, 53), 197),  # one of 0.4 s is interpolated, without what is less certain
        ((0, 200), 200),  # a base far away: all are float
        ((0, 60), 200),  # before the first fix
    ],
)
def test_auto_takes_float_positions_in_holes_of_fixed_ones(floats, used):
    positions, states = survey()
    positions.loc[positions.index[slice(*floats)], "fix"] = "float"
    trajectory, summary = build(positions, states, accept_fixes="auto")
    assert summary.n_positions_used == used
    assert covered(trajectory, 5.15) == [True]
    positions.loc[positions.index[190:195], "fix"] = "single"
    assert build(positions, states, accept_fixes="auto")[1].n_positions_used < used


def test_bad_input_is_told_with_numbers():
    positions, states = survey()
    single = positions.assign(fix="single")
    with pytest.raises(InputError, match=r"0 usable positions of 200 \(fixes met: \{'single': 200\}\)"):
        build(single, states)
    with pytest.raises(InputError, match="0 of 1000 INS states carry GPS time"):
        build(positions, states.assign(t_gps_s=np.nan))
    for hour in (3600, -3600):
        with pytest.raises(CoverageError, match=r"INS states cover .*, positions .* overlap in time"):
            build(positions.assign(t_gps_s=positions["t_gps_s"] + hour), states)


def test_an_ins_alone_gives_a_trajectory():
    _, states = survey(1500.0)
    trajectory, _ = by_states(states)
    position, R = motion(trajectory.t_gps_s, 1500.0)
    assert_allclose(trajectory.position_wcs_m, position, atol=1e-6)
    assert_allclose(trajectory.at(trajectory.t_gps_s[:-1])[1], R[:-1], atol=1e-9)
    assert_allclose(np.diag(trajectory.cov_pose_wcs[0])[:3], [0.25, 0.36, 1.0])


def test_states_from_before_the_filter_was_ready_are_left_out():
    """A Spatial logs attitudes at once; before heading is initialised they are arbitrary."""
    positions, states = survey()
    states.loc[states.index[:300], "filter_status"] = np.uint16(0b1001)  # orientation and UTC, no heading
    trajectory, summary = build(positions, states)
    assert trajectory.t_gps_s[0] == pytest.approx(T0 + 6.0, abs=1e-6)
    assert any("300 INS states from before the filter was initialised" in note for note in summary.notes)
    with pytest.raises(InputError, match="0 of 1000 INS states carry GPS time and an initialised attitude"):
        build(positions, states.assign(filter_status=np.uint16(0b1000)))


def test_a_rate_of_just_the_limit_is_no_row_of_gaps(rng):
    """Stamps of a 10 Hz INS scatter by microseconds: half of all steps are above a limit of 0.1 s."""
    positions, states = survey()
    slow = states.iloc[::5].copy()
    slow["t_gps_s"] += rng.normal(scale=20e-6, size=len(slow))
    trajectory, summary = build(positions, slow, max_attitude_gap_s=0.1)
    assert summary.gaps == []
    assert trajectory.valid.mean() > 0.98


def test_an_ins_slower_than_the_limit_is_told_the_key():
    positions, states = survey()
    with pytest.raises(InputError, match=r"come every 0\.2 s.*orientation\.max_attitude_gap_s = 0\.1 s"):
        build(positions, states.iloc[::10], max_attitude_gap_s=0.1)


def test_states_without_position_or_sigma():
    _, states = survey()
    holey = states.copy()
    holey.loc[holey.index[100:110], "lat_deg"] = np.nan
    trajectory, summary = by_states(holey)
    assert any("10 INS states without a position" in note for note in summary.notes)
    assert np.isfinite(trajectory.position_wcs_m).all()
    bare = states.assign(sigma_north_m=np.nan)
    with pytest.raises(InputError, match=r"none of them with sigmas.*logs\.smrmsg, or ins\.sigma_position_m"):
        by_states(bare)
    given, _ = by_states(bare, sigma_position_m=[0.05, 0.06, 0.1])
    assert_allclose(np.diag(given.cov_pose_wcs[0])[:3], [0.25, 0.0036, 1.0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lat_deg": 500 / 111_200}, r"200 of 200 positions disagree.* 50\d\.\d m in plan"),  # base 500 m off
        ({"h_ell_m": -45.0}, r"positions disagree.*-4[45]\.\d m in height"),  # heights above the geoid
    ],
)
def test_positions_that_contradict_the_ins_are_refused(change, message):
    positions, states = survey()
    for name, value in change.items():
        positions[name] += value
    with pytest.raises(InputError, match=message):
        build(positions, states)


def test_a_damaged_position_is_left_out():
    positions, states = survey()
    positions.loc[positions.index[100], "lat_deg"] += 10.0
    trajectory, summary = build(positions, states)
    assert any("1 positions far from the INS's own were left out" in note for note in summary.notes)
    position, _ = motion(trajectory.t_gps_s[trajectory.valid])
    assert_allclose(trajectory.position_wcs_m[trajectory.valid], position, atol=1e-3)


def test_an_origin_on_another_river_is_refused():
    positions, states = survey(far_m=161_000.0, duration_s=5.0)
    with pytest.raises(InputError, match=r"16\d km from the origin.*campaign\.origin"):
        build(positions, states)


def test_velocities_of_the_ins_keep_what_sparse_epochs_miss():
    """At 1 Hz a spline cannot follow roll and heave; the INS's own velocity can."""
    positions, states = survey()
    sparse = positions.iloc[::10]
    errors = {}
    for interpolation in ("cubic", "ins_velocity"):
        trajectory, summary = build(sparse, states, max_gap_s=1.5, interpolation=interpolation)
        use = trajectory.valid
        position, _ = motion(trajectory.t_gps_s[use])
        errors[interpolation] = np.sqrt(np.mean((trajectory.position_wcs_m[use] - position) ** 2))
        assert summary.sigma_interpolation_m is not None
    assert errors["ins_velocity"] < 0.2 * errors["cubic"], errors


def test_a_velocity_without_one_of_its_components_guides_no_position():
    positions, states = survey()
    states.loc[100:109, "v_down_mps"] = np.nan
    _, summary = build(positions, states, interpolation="ins_velocity")
    assert "10 INS states without a velocity guide no position" in summary.notes


def test_states_within_the_first_or_last_interval_of_positions_are_enough():
    """Positions every 0.1 s; three states that end before the second, or begin behind the last but one."""
    positions, states = survey()
    s = states["t_gps_s"] - T0
    # the last position is at 19.9 s
    for some in (states[s < 0.05], states[(s > 19.85) & (s < 19.905)]):
        trajectory, _ = build(positions, some)
        assert trajectory.valid.tolist() == [True] * 3


def test_an_ins_alone_keeps_the_sigmas_that_it_states():
    """Roll is stated with 2 mrad; pitch and heading are not, and get the configured ones."""
    _, states = survey()
    trajectory, _ = by_states(states.assign(sigma_roll_rad=2e-3))
    assert_allclose(trajectory.sigma_roll_pitch_heading_rad()[0], [2e-3, 4e-3, 5e-3])


def test_a_state_without_one_of_its_sigmas_has_no_pose():
    """Ten states lack the sigma of their height, the others are stated with 0.5, 0.6 and 1.0 m."""
    _, states = survey()
    states.loc[states.index[100:110], "sigma_up_m"] = np.nan
    trajectory, summary = by_states(states)
    assert np.flatnonzero(~trajectory.valid).tolist() == [*range(100, 110)]
    assert summary.n_nodes_valid == len(states) - 10
    assert_allclose(np.diag(trajectory.cov_pose_wcs[99])[:3], [0.25, 0.36, 1.0], rtol=1e-4)


def test_streams_that_meet_by_less_than_an_interval_overlap():
    """States at 19.895 s and later, the last position is at 19.9 s: one node has a pose; beyond it, none."""
    positions, states = survey(duration_s=22.0)
    positions = positions[positions["t_gps_s"] < T0 + 19.95]
    late = states[states["t_gps_s"] > T0 + 19.89].assign(t_gps_s=lambda s: s["t_gps_s"] - 0.005)
    trajectory, _ = build(positions, late)
    assert np.flatnonzero(trajectory.valid).tolist() == [0]
    with pytest.raises(CoverageError, match="streams of the same survey"):
        build(positions, late.iloc[1:])


def test_states_without_time_and_repeated_ones_are_counted():
    positions, states = survey()
    _, summary = build(positions, states)
    assert not any("without GPS time or repeated" in note for note in summary.notes)
    states.loc[states.index[100:103], "t_gps_s"] = np.nan
    states.loc[states.index[200], "t_gps_s"] = states.loc[states.index[199], "t_gps_s"]
    _, summary = build(positions, states)
    assert [note for note in summary.notes if "without GPS time or repeated" in note] == [
        "4 INS states without GPS time or repeated were left out"
    ]


def test_one_long_pause_does_not_make_an_ins_slow():
    """Ten states a second with a hole of 1000 s: the usual step counts, not the mean one."""
    t = np.concatenate([np.arange(50) / 10, 1000.0 + np.arange(50) / 10])
    states = pd.DataFrame(
        {"t_gps_s": t, "filter_status": 0, "roll_rad": 0.0, "pitch_rad": 0.0, "heading_rad": 0.0}
    )
    assert len(usable_states(states, TrajectorySummary(), 0.2, 0)) == 100
    with pytest.raises(InputError, match=r"states come every 0\.1 s"):
        usable_states(states, TrajectorySummary(), 0.05, 0)


def test_four_positions_are_enough_and_three_are_not():
    positions = survey()[0][:4]
    assert len(usable_positions(positions, ["fixed"], TrajectorySummary())) == 4
    with pytest.raises(InputError, match="3 usable positions of 3"):
        usable_positions(positions[:3], ["fixed"], TrajectorySummary())


def test_single_places_far_away_make_no_survey_of_another_river():
    frame = LocalFrame(lat_deg=51.0, lon_deg=13.0, h_ell_m=100.0)
    places = np.zeros((9, 3))
    places[7:, 0] = 1e9
    check_origin(places, frame)
    check_origin(places[:0], frame)
    with pytest.raises(InputError, match="km from the origin"):
        check_origin(places[6:], frame)
