"""Attitudes of a boat without an INS, and positions whose log states no accuracy or height."""

import numpy as np
import pytest

from thalweg.core import InputError, LocalFrame
from thalweg.ingest import GNSS_POSITION
from thalweg.navigation.ins_gnss import build_trajectory, states_along_course, with_stated

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
HOW = {"accept_fixes": ["single"], "max_gap_s": 1.5, "sigma_level_deg": 3.0}


def positions(enu_m, sigma_m, step_s=1.0):
    """Positions of kind ``gnss_position`` at places of the local frame."""
    table = GNSS_POSITION.empty_table().to_pandas().reindex(range(len(enu_m)))
    lat, lon, h = FRAME.to_geodetic(enu_m)
    table = table.assign(t_gps_s=1e9 + step_s * np.arange(len(enu_m)), lat_deg=lat, lon_deg=lon, h_ell_m=h)
    sigmas = dict.fromkeys(("sigma_east_m", "sigma_north_m", "sigma_up_m"), sigma_m)
    return table.assign(fix="single", n_sats=8, **sigmas)


def straight(n, course_deg, speed_mps=2.0):
    """Places of a boat on one course."""
    along = speed_mps * np.arange(n)
    course = np.deg2rad(course_deg)
    return np.column_stack([along * np.sin(course), along * np.cos(course), np.zeros(n)])


def turned(a_rad, b_rad):
    """Difference of two headings within half a turn."""
    return (a_rad - b_rad + np.pi) % (2 * np.pi) - np.pi


@pytest.mark.parametrize("course_deg", [0.0, 40.0, 135.0, 200.0, 359.5])
def test_the_heading_is_the_course(course_deg):
    states = states_along_course(
        positions(straight(20, course_deg), 1e-4), FRAME, sigma_course_deg=10.0, **HOW
    )
    assert np.abs(turned(states["heading_rad"].to_numpy(), np.deg2rad(course_deg))).max() < 1e-3
    assert states["sigma_heading_rad"].to_numpy() == pytest.approx(np.deg2rad(10.0), rel=1e-3)
    assert (states[["roll_rad", "pitch_rad"]] == 0).all(axis=None)


def test_errors_of_positions_turn_the_course_as_predicted():
    rng = np.random.default_rng(5)
    n, sigma_m = 4000, 0.2
    noisy = straight(n, 70.0) + sigma_m * rng.standard_normal((n, 3))
    states = states_along_course(positions(noisy, sigma_m), FRAME, sigma_course_deg=1e-6, **HOW)
    # the ends have half the baseline
    error = turned(states["heading_rad"].to_numpy(), np.deg2rad(70.0))[1:-1]
    square = float(np.mean((error / states["sigma_heading_rad"].to_numpy()[1:-1]) ** 2))
    assert 0.9 < square < 1.1


def test_a_boat_that_stands_has_any_heading():
    states = states_along_course(positions(np.zeros((10, 3)), 0.5), FRAME, sigma_course_deg=10.0, **HOW)
    assert states["sigma_heading_rad"].to_numpy() == pytest.approx(np.pi / np.sqrt(3))


def test_positions_that_are_too_rare_are_refused():
    with pytest.raises(InputError, match=r"positions come every 2 s.*max_gap_s = 1.5"):
        states_along_course(positions(straight(9, 10.0), 0.1, 2.0), FRAME, sigma_course_deg=10.0, **HOW)


def test_an_uncertain_attitude_enters_the_sigma_of_the_boat():
    """A lever arm of 2 m below the antenna swings by 3 degrees: 10 cm on top of 1 cm of the antenna."""
    measured = positions(straight(30, 0.0), 0.01)
    states = states_along_course(measured, FRAME, sigma_course_deg=10.0, **HOW)
    found, _ = build_trajectory(
        measured,
        states,
        FRAME,
        lever_ics_antenna_m=(0.0, 0.0, -2.0),
        sigma_lever_m=(0.0, 0.0, 0.0),
        accept_fixes=["single"],
        max_gap_s=1.5,
        max_attitude_gap_s=1.5,
        sigma_attitude_rad=(0.1, 0.1, 0.1),
    )
    assert found.position_wcs_m[15] == pytest.approx([0.0, 30.0, -2.0], abs=1e-3)
    assert found.sigma_position_m[15] == pytest.approx([0.1052, 0.1052, 0.01], rel=0.02)


def test_what_a_log_does_not_state_is_stated():
    bare = positions(straight(6, 0.0), np.nan).assign(h_ell_m=np.nan)
    found = with_stated(bare, sigma_position_m=(1.0, 2.0, 3.0), antenna_h_ell_m=120.0)
    assert (found["h_ell_m"] == 120.0).all()
    assert found[["sigma_east_m", "sigma_north_m", "sigma_up_m"]].iloc[0].tolist() == [1.0, 2.0, 3.0]
    mixed = bare.assign(h_ell_m=[100.0, *[np.nan] * 5])
    found = with_stated(mixed, sigma_position_m=None, antenna_h_ell_m=120.0)
    assert found["h_ell_m"].notna().sum() == 1  # a jump of 20 m would look like a wave
    assert found["sigma_east_m"].isna().all()
