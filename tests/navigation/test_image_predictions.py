"""Approximate poses of images from clock, trajectory and mount."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tests.core.conftest import trajectory_of
from thalweg.clocks import ClockModel
from thalweg.core import CoverageError, Rigid, exp_rotation
from thalweg.navigation.camera import predict_image_poses, stated_clock
from thalweg.navigation.camera.image_predictions import NO_STAMP, OFF_BOAT, OUTSIDE
from thalweg.settings.sections import StatedClock

MOUNT = Rigid(R=exp_rotation([0.1, -0.2, 0.3]), shift_m=np.array([0.5, -0.1, 0.2]))
SPEED_MPS, TURN_RADPS = 2.0, 0.3


def turning(n=201, heel_rad=0.0):
    """A boat that goes north-east at 2 m/s and turns at 0.3 rad/s about the vertical for 20 s."""
    s = np.linspace(0.0, 20.0, n)
    turned = Rotation.from_rotvec(np.outer(TURN_RADPS * s, [0, 0, 1.0]))
    position = np.outer(SPEED_MPS * s / np.sqrt(2), [1.0, 1.0, 0.0])
    cov = np.diag([1e-4, 1e-4, 4e-4, 1e-6, 1e-6, 1e-6])
    return trajectory_of(1000.0 + s, position, turned * Rotation.from_rotvec([heel_rad, 0.0, 0.0]), cov)


def predicted(t, model, trajectory=None, mount=MOUNT, **more):
    return predict_image_poses(stamps(*t), model, trajectory or turning(), mount, **more)


def clock(offset_s, sigma_s=0.0):
    return ClockModel(offset_s=offset_s, reference_s=1000.0, cov=np.diag([sigma_s**2, 0.0]), source="test")


def stamps(*t):
    return pd.DataFrame({"file": [f"{k}.jpg" for k in range(len(t))], "t_device_s": t})


def test_pose_is_that_of_the_boat_at_the_corrected_time_times_the_mount():
    found = predicted([1008.0], clock(2.0))
    R = exp_rotation([0.0, 0.0, TURN_RADPS * 10.0])
    place = np.array([10.0, 10.0, 0.0]) * np.sqrt(2)
    assert found.t_gps_s[0] == 1010.0
    # closed form; positions of nodes are exact, arcs of 0.03 rad are exact as well
    assert_allclose(found.centre_wcs_m[0], place + R @ MOUNT.shift_m, atol=1e-9)
    assert_allclose(found.R_wcs_ccs[0], R @ MOUNT.R, atol=1e-9)


def test_an_uncertain_time_counts_with_the_speed_of_the_boat():
    still = Rigid(R=np.eye(3), shift_m=np.zeros(3))
    heeled = turning(heel_rad=0.3)  # rates are of the world, whatever the axes of the boat
    sharp, blurred = (
        predicted([1010.0], clock(0.0, sigma_s), heeled, still).cov_pose_wcs[0] for sigma_s in (0.0, 0.1)
    )
    rate = np.array([SPEED_MPS / np.sqrt(2), SPEED_MPS / np.sqrt(2), 0, 0, 0, TURN_RADPS])
    # rates are chords of 0.4 s about the time, exact for even motion
    assert_allclose(blurred - sharp, 0.01 * np.outer(rate, rate), atol=1e-12)


def test_images_without_stamp_or_trajectory_stay_in_the_table_and_say_why():
    found = predicted([1005.0, np.nan, 2000.0], clock(0.0))
    assert found.oriented.tolist() == [True, False, False]
    assert found.reasons == ("", NO_STAMP, OUTSIDE)
    assert np.isnan(found.centre_wcs_m[1:]).all()


def test_images_of_a_camera_that_is_not_on_the_boat_get_neither_pose_nor_time():
    table = stamps(1005.0, 1006.0, 1007.0).assign(file=["left/1.jpg", "bank/1.jpg", "bank/low/2.jpg"])
    found = predict_image_poses(table, clock(0.0), turning(), MOUNT, off_boat=["bank"])
    assert found.oriented.tolist() == [True, False, False]
    assert found.reasons == ("", OFF_BOAT, OFF_BOAT)
    assert np.isfinite(found.t_gps_s).tolist() == [True, False, False]


def test_a_gap_of_the_trajectory_gives_no_pose():
    whole = turning()
    broken = replace(whole, valid=np.abs(whole.t_gps_s - 1010.0) > 1.0)
    assert predicted([1010.0, 1015.0], clock(0.0), broken).oriented.tolist() == [False, True]


def test_a_clock_in_another_zone_is_named_with_both_spans():
    with pytest.raises(CoverageError, match=r"1 images .* none inside .* covers"):
        predicted([1010.0], clock(3600.0))
    with pytest.raises(CoverageError, match="none of 1 images has a time stamp"):
        predicted([np.nan], clock(0.0))


def test_what_all_times_share_is_told_apart_from_jitter():
    shaky = replace(clock(0.0, 0.1), jitter_s=0.05)
    found = predicted([1005.0, np.nan, 1010.0], shaky)
    assert found.facts["sigma_common_s"] == pytest.approx(0.1)
    assert_allclose(found.sigma_t_s[[0, 2]], np.hypot(0.1, 0.05))


def test_a_clock_that_a_campaign_file_states():
    """Whole seconds are uncertain by their steps, too: 1 / sqrt(12)."""
    stated = StatedClock(offset_s=7.0, sigma_offset_s=0.5, jitter_s=0.4)
    table = stamps(1000.0, 1010.0, 1050.0, np.nan).assign(resolution_s=[0.5, 1.0, 1.0, 9.0])
    found = stated_clock(table, stated, "the file")
    assert (found.offset_s, found.reference_s, found.source) == (7.0, 1010.0, "the file")
    assert_allclose(found.cov, [[0.25, 0.0], [0.0, 0.0]])
    assert found.jitter_s**2 == pytest.approx(0.16 + 1 / 12)
    empty = stated_clock(table[3:], stated, "the file")
    assert (empty.reference_s, empty.jitter_s) == (0.0, pytest.approx(0.4))
