"""First value of a camera's offset, and what its estimate takes from INS and track: by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from thalweg.clocks import CameraPoses, InsAttitude, Track
from thalweg.clocks.camera_offset import (
    OffsetModel,
    OffsetState,
    _apart,
    _best,
    _medians,
    _seen,
    at_the_end,
    find_start,
)
from thalweg.core import ClockError, CoverageError, exp_rotation, rotation_enu_body, rotation_opk


def track(t, x=None):
    """Positions with x = t^2 / 10 and y = 5, unless stated."""
    t = np.asarray(t, dtype=np.float64)
    x = t**2 / 10 if x is None else x
    place = np.column_stack([x, np.full(len(t), 5.0), 0.0 * t])
    return Track(t_gps_s=t, position_m=place, cov_m2=np.tile(1e-4 * np.eye(3), (len(t), 1, 1)))


def poses(stamp, centre, R=None):
    n = len(stamp)
    return CameraPoses(
        file=np.array([f"{i}.jpg" for i in range(n)], dtype=object),
        t_device_s=np.asarray(stamp, dtype=np.float64),
        R_wcs_ccs=np.tile(np.eye(3) if R is None else R, (n, 1, 1)),
        centre_wcs_m=np.asarray(centre, dtype=np.float64),
        cov_pose_wcs=np.tile(1e-6 * np.eye(6), (n, 1, 1)),
    )


def boat(stamp, offset_s, lever_m):
    """A camera that looks as wcs does, with the antenna at ``lever_m``."""
    t = np.asarray(stamp) + offset_s
    antenna = np.column_stack([t**2 / 10, np.full(len(t), 5.0), 0.0 * t])
    return poses(stamp, antenna - lever_m)


def run_of_twenty(offset_s=0.0, lever_m=(0.3, -0.2, -0.1)):
    return boat(np.arange(5.0, 25.0), offset_s, lever_m)


LONG = np.arange(0.0, 40.0, 0.1)


def start_of(run, t=LONG, largest_offset_s=2.0, largest_lever_m=1.0):
    limits = {"largest_offset_s": largest_offset_s, "largest_lever_m": largest_lever_m}
    return find_start(run, track(t), **limits)


def test_the_antenna_is_seen_in_the_frame_of_the_camera():
    """At 2.5 s between 0.4 and 0.9 m: 0.65. The camera at (0.65, 3, 0) is turned by a quarter."""
    seen, inside = _seen(
        poses([1.5], [[0.65, 3.0, 0.0]], rotation_opk(0.0, 0.0, np.pi / 2)), track(np.arange(9)), 1.0
    )
    assert_allclose(seen, [[2.0, 0.0, 0.0]], atol=1e-12)
    assert inside.tolist() == [True]


@pytest.mark.parametrize("hole", [0, 3, 6])
def test_a_hole_of_the_track_shows_nothing(hole):
    """Eight epochs each second; after one of them 2.5 steps are missing, also after the first one."""
    t = np.arange(8.0)
    t[hole + 1 :] += 1.5
    middle = 0.5 * (t[1:] + t[:-1])
    _, inside = _seen(poses(middle, np.zeros((7, 3))), track(t), 0.0)
    assert np.flatnonzero(~inside).tolist() == [hole]
    # 2.4 steps are bridged
    t[hole + 1 :] -= 0.1
    assert _seen(poses(t[hole : hole + 1] + 1.0, np.zeros((1, 3))), track(t), 0.0)[1].all()


def test_times_off_the_track_show_nothing():
    _, inside = _seen(poses([-0.1, 0.0, 7.0, 7.1], np.zeros((4, 3))), track(np.arange(8)), 0.0)
    assert inside.tolist() == [False, True, True, False]


def test_the_best_offset_has_an_antenna_that_is_near_enough():
    """With x = t^2 / 10 the antenna stands still at the right offset alone."""
    t = np.arange(0.0, 20.0, 0.5)
    run = boat(np.arange(2.0, 14.0), 1.3, (0.6, -0.8, 0.0))
    offsets = np.array([0.9, 1.1, 1.3, 1.5])
    assert _best(run, track(t), offsets, 1.01) == 1.3
    # the antenna is 1 m away: no offset is right where none may be farther than 0.9 m ...
    far = _best(run, track(t), offsets, 0.9)
    assert far is None or far != 1.3
    assert _best(run, track(t), offsets, 0.1) is None
    # ... and fewer than eight images tell nothing
    assert _best(run.take(np.arange(7)), track(t), offsets, 1.01) is None
    assert _best(run.take(np.arange(8)), track(t), offsets, 1.01) == 1.3


def test_medians_of_some_of_each_row():
    inside = np.array([[1, 1, 1, 1], [1, 1, 0, 1], [0, 0, 1, 0]], dtype=np.bool_)
    assert _medians(np.tile([4.0, 1.0, 9.0, 2.0], (3, 1)), inside).tolist() == [3.0, 2.0, 9.0]


@pytest.mark.parametrize("offset_s", [-1.37, 0.0, 1.42])
def test_the_start_by_hand(offset_s):
    """Twenty images, one of them 0.5 m off."""
    run = run_of_twenty(offset_s)
    run.centre_wcs_m[4] += [0.0, 0.0, 0.5]
    found = start_of(run)
    assert found.offset_s == pytest.approx(offset_s, abs=2e-3)
    # 2 ms at up to 5 m/s
    assert_allclose(found.lever_m, [0.3, -0.2, -0.1], atol=0.01)
    assert np.flatnonzero(found.gross).tolist() == [4]
    assert found.misfit_m < 0.01
    assert found.overlapping == 20


@pytest.mark.parametrize("sign", [1, -1])
def test_the_end_of_the_search(sign):
    """One and a half steps of 0.1 s before either end."""
    near, far = (SimpleNamespace(offset_s=sign * offset_s) for offset_s in (1.84, 1.86))
    assert (at_the_end(near, 2.0), at_the_end(far, 2.0)) == (False, True)


@pytest.mark.parametrize(("extra_s", "shift_s"), [(1.4, 7201.5), (-1.4, 7198.5)])
def test_a_shift_by_hours_is_named_with_its_rest(extra_s, shift_s):
    """The camera's clock is two hours early and some seconds off: looked for in steps of 0.5 s."""
    t0, run = 3.0e8, run_of_twenty()
    moved = poses(run.t_device_s + t0 - 7200.0 - extra_s, run.centre_wcs_m)
    there = replace(track(LONG), t_gps_s=LONG + t0)
    error = _apart(moved, there, 2.0, 1.0)
    assert isinstance(error, ClockError)
    assert f"shifted by {shift_s:+.1f} s" in error.found
    assert "stand still on the boat within 0.0" in error.found
    assert "offset from UTC" in error.cure
    with pytest.raises(ClockError, match="do not overlap"):
        find_start(moved, there, largest_offset_s=2.0, largest_lever_m=1.0)


def test_an_antenna_that_would_wander_is_another_run():
    """Two hours off; the camera stands while the antenna goes on by 1 m/s.

    Of images at 0, 1, .. 14 s, 30, 40, .. 70 s the median is 9.5 s; ten are within 4.5 s of it, the next one
    is 5.5 s away.
    """
    t0 = 3.0e8
    stamp = np.r_[np.arange(15.0), np.arange(30.0, 71.0, 10.0)]
    t = np.arange(-5.0, 80.0, 0.1)
    there = replace(track(t, t - 9.5), t_gps_s=t + t0)
    error = _apart(poses(stamp + t0 - 7200.0, np.tile([0.0, 5.0, 0.0], (20, 1))), there, 2.0, 1.0)
    assert "wander by 5.0 m on the boat" in error.found
    assert "the same run" in error.cure


def test_images_of_another_day_have_no_shift():
    run = poses(np.arange(20.0) + 1e5 + 3000.0 * np.arange(20.0), np.zeros((20, 3)))
    error = _apart(run, track(np.arange(40.0) + 3.0e8), 2.0, 1.0)
    assert "shifted" not in error.found
    assert "offset from UTC" in error.cure


def test_too_few_images_are_told_by_their_number():
    run = run_of_twenty(lever_m=(0.0, 0.0, 0.0))
    with pytest.raises(ClockError, match="7 images with a pose"):
        start_of(run.take(np.arange(7)))
    with pytest.raises(CoverageError, match="of 20 images lie where positions are complete"):
        start_of(run, LONG[(LONG % 10) < 1], largest_offset_s=0.2)
    with pytest.raises(ClockError, match=r"within 0\.5 m of the camera"):
        start_of(run_of_twenty(lever_m=(0.0, 0.0, 3.0)), largest_offset_s=1.0, largest_lever_m=0.5)


# ---------------------------------------------------------------- attitudes of the INS

RATE = np.array([0.02, -0.03, 0.4])


def ins(**changed):
    """Turns with a steady angular velocity, from t = 0 to 10 s each 0.05 s."""
    t = np.arange(0.0, 10.001, 0.05)
    R = np.stack([exp_rotation(RATE * s) for s in t])
    values = {"t_gps_s": t, "R_wcs_ics": R, "sigma_rad": np.array([1e-3, 2e-3, 3e-3])}
    return InsAttitude(**(values | changed))


def test_a_steady_turn_has_its_attitude_and_rate():
    R, rate, inside = ins().at(np.array([0.19, 0.21, 5.033, 9.79, 9.81]))
    assert inside.tolist() == [False, True, True, True, False]
    assert_allclose(R[2], exp_rotation(RATE * 5.033), atol=1e-12)
    assert_allclose(rate[1:4], np.tile(RATE, (3, 1)), atol=1e-10)
    t = ins().t_gps_s
    keep = (t < 4.0) | (t > 4.19)
    _, _, inside = ins(t_gps_s=t[keep], R_wcs_ics=ins().R_wcs_ics[keep]).at(np.array([3.9, 4.1, 4.3]))
    # 0.25 s between two attitudes, and 0.2 s may be
    assert inside.tolist() == [True, False, True]


def test_covariance_of_attitudes_by_hand():
    """Level and northward: heading about -z, pitch about x or y, roll about the other; e^-1 after 20 s."""
    t = np.arange(0.0, 40.001, 0.05)
    R = np.tile(rotation_enu_body(0.0, 0.0, 0.0), (len(t), 1, 1))
    level = ins(t_gps_s=t, R_wcs_ics=R, sigma_rad=np.array([1e-3, 1e-3, 3e-3]))
    times = np.array([10.0, 30.0])
    one = np.diag([1e-6, 1e-6, 9e-6])
    assert_allclose(level.covariance(times), np.block([[one, one / np.e], [one / np.e, one]]), atol=1e-15)
    # difference of two attitudes 0.2 s apart, over 0.2 s
    own = 2 * (1 - np.exp(-0.01)) / 0.04
    between = (2 * np.exp(-1.0) - np.exp(-0.99) - np.exp(-1.01)) / 0.04
    assert_allclose(
        level.rate_covariance(times),
        np.block([[own * one, between * one], [between * one, own * one]]),
        atol=1e-15,
    )


def test_cosines_of_periods_above_the_limit():
    """90 s with slow errors above 60 s: half periods of 90, 45 and 30 s, so three cosines."""
    run = poses(np.array([0.0, 30.0, 45.0, 90.0]), np.zeros((4, 3)))
    model = OffsetModel(poses=run, track=track(np.arange(200.0)), reference_s=10.0, ins=ins(high_pass_s=60.0))
    expected = [[1.0, 0.5, 0.0, -1.0], [1.0, -0.5, -1.0, 1.0], [1.0, -1.0, 0.0, -1.0]]
    assert_allclose(model.cosines(), expected, atol=1e-12)
    assert model.names[8:11] == ("slow_roll_1", "slow_pitch_1", "slow_heading_1")
    assert len(model.names) == 17
    state = OffsetState(offset_s=2.0, drift=1e-3, lever_m=np.zeros(3))
    assert_allclose(model.times(state), [1.99, 32.02, 47.035, 92.08])
    none = OffsetModel(poses=run, track=track(np.arange(9.0)), reference_s=0.0, ins=ins(high_pass_s=0.0))
    assert none.cosines().shape == (0, 4)


def test_a_small_change_of_the_unknowns():
    state = OffsetState(offset_s=1.0, drift=2.0, lever_m=np.array([1.0, 2.0, 3.0]), slow=np.array([5.0]))
    found = state.moved(np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.0, 0.0, np.pi / 2, 7.0]))
    assert (found.offset_s, found.drift) == (1.1, 2.2)
    assert_allclose(found.lever_m, [1.3, 2.4, 3.5])
    assert_allclose(found.R_ics_ccs @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)
    assert found.slow.tolist() == [12.0]
    short = state.moved(np.array([0.1, 0.2, 0.3, 0.4, 0.5]))
    assert (short.R_ics_ccs == state.R_ics_ccs).all()
    assert short.slow.tolist() == [5.0]


def test_a_gap_at_either_end_of_the_attitudes_is_not_covered():
    """Ten attitudes a second between 10 and 20 s, one at 0 and one at 30 s: the gaps are covered nowhere."""
    t = np.concatenate([[0.0], np.arange(100, 201) / 10, [30.0]])
    attitudes = ins(t_gps_s=t, R_wcs_ics=np.tile(np.eye(3), (len(t), 1, 1)))
    assert attitudes.at(np.array([5.0, 15.0, 25.0]))[2].tolist() == [False, True, False]
