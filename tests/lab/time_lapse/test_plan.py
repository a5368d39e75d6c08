"""Times, names, poses, and lens of the time-lapse images."""

import numpy as np
from numpy.testing import assert_allclose

from tests.lab.time_lapse.conftest import CONFIG, MOUNTS, SEED, settings
from thalweg.core import Rigid
from thalweg_lab.time_lapse.record import plan_images
from thalweg_lab.voyage import Voyage
from thalweg_lab.writers import start_us
from thalweg_lab.yard_records import clock_minus_utc_s

CAMERA = MOUNTS["camera"]
ANGLES_DEG = [CAMERA[f"{a}_deg"] for a in ("omega", "phi", "kappa")]
MOUNT = Rigid.from_opk(np.deg2rad(ANGLES_DEG), CAMERA["lever_ics_m"])


def test_poses_are_those_of_boat_and_mount_at_the_true_exposure():
    plan = plan_images(CONFIG, settings(), SEED, MOUNTS)
    voyage = Voyage(CONFIG, SEED)
    t = np.array([s.t_gps_s for s in plan.shots])
    R = voyage.R_wcs_ics(t) @ MOUNT.R
    centre = voyage.sensor_wcs_m(t, MOUNT.shift_m)
    assert_allclose(np.stack([s.T_wcs_ccs.R for s in plan.shots]), R, atol=1e-12)
    assert_allclose(np.stack([s.T_wcs_ccs.shift_m for s in plan.shots]), centre, atol=1e-9)
    # The camera looks to the right, and upright: its y axis points down.
    assert (R[:, 2, 1] < -0.95).all()


def test_stamps_follow_the_cameras_clock_with_its_jitter():
    plan = plan_images(CONFIG, settings(share=1.0, rate_hz=10.0), SEED, MOUNTS)
    since = np.array([s.since_s for s in plan.shots])
    shown = (np.array([s.stamp_us for s in plan.shots]) - start_us(CONFIG)) * 1e-6
    error = shown - since - clock_minus_utc_s(CONFIG.camera, since)
    n, jitter = len(error), CONFIG.camera.jitter_s
    assert n > 200
    # Five sigma of mean and standard deviation of n normal numbers.
    assert abs(error.mean()) < 5 * jitter / np.sqrt(n)
    assert abs(error.std() / jitter - 1) < 5 / np.sqrt(2 * n)
    assert np.allclose(np.diff(since), 0.1, atol=0.2)
    assert all(s.stamp_us % 1000 == 0 for s in plan.shots)


def test_smear_is_the_way_of_a_place_in_the_image_while_the_shutter_is_open():
    plan = plan_images(CONFIG, settings(), SEED, MOUNTS)
    open_s, voyage = CONFIG.camera.exposure_s, Voyage(CONFIG, SEED)
    for shot in plan.shots[::4]:
        place = shot.T_wcs_ccs.apply([[0.0, 0.0, 12.0]])
        at = []
        for t in (shot.t_gps_s - open_s / 2, shot.t_gps_s + open_s / 2):
            R = voyage.R_wcs_ics(np.array([t]))[0] @ MOUNT.R
            at.append(plan.camera.project((place - voyage.sensor_wcs_m(np.array([t]), MOUNT.shift_m)) @ R)[0])
        # 0.01 px: GPS seconds of 3e8 step by 6e-8 s, that is 1e-4 of 0.8 ms; the motion is not quite even.
        assert_allclose(shot.smear_px, at[1] - at[0], atol=0.01)
    assert max(np.hypot(*s.smear_px) for s in plan.shots) > 0.05
