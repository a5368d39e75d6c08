"""The trajectory by images that the INS carries (P2 section 4): closed forms, consistency, and bad input."""

from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tests.core.conftest import image_poses_of, trajectory_of
from thalweg.core import (
    ClockError,
    CoverageError,
    InputError,
    Rigid,
    cross_matrix,
    exp_rotation,
    rotation_enu_body,
)
from thalweg.navigation.camera import CloudSettings, camera_trajectory
from thalweg.navigation.camera.trajectory import (
    CONTRADICTS,
    NO_INS,
    NO_TIME,
    TWICE,
    CarriedErrors,
    _with_positions,
    bridged,
    bridged_integral,
    scaled,
)
from thalweg.navigation.fusion.errors import FusionErrors, Prior
from thalweg.settings.sections import CameraCloud
from thalweg_lab.studies.outage import CAMERA, FRAME, VoyageSpec, make_survey, pose_errors

HALF = CloudSettings(estimate_errors=False)
BRIDGE = HALF.replace(frames="bridge")
"""Closed forms hold for errors as stated; surveys of seconds do not tell them."""
SIGMA_RAD = np.deg2rad([0.1, 0.1, 0.2])
JITTER_S, COMMON_S = 0.020, 0.004


@cache
def survey(seed=1, duration_s=14.0):
    """Zigzag of the twin; the mount is exact, because its error is no part of the covariance."""
    how = {"sigma_clock_s": COMMON_S, "jitter_s": JITTER_S, "sigma_mount_m": 0.0, "sigma_mount_deg": 0.0}
    return make_survey(seed, VoyageSpec(duration_s=duration_s, **how))


def timed(poses):
    """The poses with what is known of their times."""
    sigma = np.full(len(poses.images), np.hypot(JITTER_S, COMMON_S))
    facts = {"image_times": {"sigma_common_s": COMMON_S}}
    return replace(poses.with_times(poses.t_gps_s, sigma), facts=facts)


def run(recorded, settings, poses=None):
    poses = timed(recorded.images) if poses is None else poses
    return follow(poses, recorded.states, settings, recorded.T_ccs_ics.inverse())


def time_is_accounted_for(facts):
    total = facts["time_with_pose_s"] + sum(facts["time_lost_s"].values())
    return total == pytest.approx(facts["time_s"], abs=1e-6)


# ---------------------------------------------------------------- consistency


@pytest.mark.parametrize("settings", [HALF, BRIDGE], ids=["half rotation", "bridge"])
def test_normalised_errors_lie_in_their_band_over_sixteen_seeds(settings):
    """One image a seed, so that errors are independent; 16 x 6 squares have a band of 0.67 to 1.41 (99 %)."""
    after = np.array([0.0, 0.0499, -0.033]) if settings is HALF else np.array([0.0, 0.27, 0.5])
    squares = []
    for seed in range(1, 17):
        recorded = survey(seed)
        found = run(recorded, settings).trajectory
        at = recorded.images.t_gps_s[6] + after
        position, R, inside = found.at(at)
        assert inside.all()
        e = pose_errors(position, R, recorded.motion, at)
        squares.append([v @ np.linalg.solve(C, v) for v, C in zip(e, found.cov_at(at), strict=True)])
    low, high = chi2.ppf([0.005, 0.995], 96) / 96
    mean = np.mean(squares, axis=0) / 6
    assert np.all((low < mean) & (mean < high)), mean


def test_the_images_rule_and_the_time_is_in_the_covariance():
    """A jitter of 20 ms at the boat's own speed, P2 eq. 6: without it the normalised error is far off."""
    recorded = survey()
    exact = recorded.images.with_times(recorded.images.t_gps_s, np.zeros(len(recorded.images.images)))
    with_time, without = run(recorded, HALF), run(recorded, HALF, exact)
    at = recorded.images.t_gps_s[2:-2]
    v = with_time.images["speed_mps"].to_numpy()[2:-2]
    cov, cov_without = (found.trajectory.cov_at(at)[:, :3, :3] for found in (with_time, without))
    more = np.trace(cov - cov_without, axis1=1, axis2=2)
    assert_allclose(more, v**2 * (JITTER_S**2 + COMMON_S**2), rtol=1e-6)
    assert with_time.images["by_time_m"].to_numpy()[3] == pytest.approx(1.2 * 0.0204, rel=0.1)


# ---------------------------------------------------------------- closed forms


def circle(t):
    """Position, velocity, heading and R_wcs_ics of a boat on a circle of 5 m at 0.2 rad/s."""
    a = 0.2 * (t - 3.0e8)
    position = np.column_stack([5 * np.sin(a), 5 * np.cos(a), 0 * t])
    velocity = np.column_stack([np.cos(a), -np.sin(a), 0 * t])
    heading = a + np.pi / 2
    return position, velocity, heading, rotation_enu_body(0 * t, 0 * t, heading)


def perfect(image_s, *, heading_bias_rad=0.0, velocity_bias_mps=0.0):
    """Exact images on the circle, and an INS with constant errors."""
    t = 3.0e8 + np.arange(0, 10, 0.02)
    _, velocity, heading, _ = circle(t)
    level = dict.fromkeys(("roll_rad", "pitch_rad", "v_down_mps"), 0.0)
    sigmas = {"sigma_roll_rad": 0.002, "sigma_pitch_rad": 0.002, "sigma_heading_rad": 0.004}
    moving = {"heading_rad": heading + heading_bias_rad, "v_north_mps": velocity[:, 1]}
    moving |= {"t_gps_s": t, "v_east_mps": velocity[:, 0] + velocity_bias_mps}
    states = pd.DataFrame(moving | level | sigmas | {"filter_status": np.uint16(0b1111)})
    position, _, _, R = circle(3.0e8 + image_s)
    exact = {"sigma_t_s": np.zeros(len(image_s)), "frame": FRAME}
    return image_poses_of(position + R @ CAMERA.shift_m, R @ CAMERA.R, 3.0e8 + image_s, **exact), states


def follow(poses, states, settings, camera=CAMERA, **more):
    return camera_trajectory(
        poses, camera, settings, states=states, sigma_attitude_rad=SIGMA_RAD, max_attitude_gap_s=0.1, **more
    )


@pytest.mark.parametrize("motion", ["velocity", "trajectory"])
def test_constant_errors_of_the_ins_do_no_harm(motion):
    poses, states = perfect(np.arange(1.0, 9.0), heading_bias_rad=0.05, velocity_bias_mps=0.3)
    at = 3.0e8 + np.linspace(1.0, 8.0, 141)
    position, _, _, R = circle(at)
    t = states["t_gps_s"].to_numpy()
    shifted, _, _, turned = circle(t)
    turned = Rotation.from_matrix(exp_rotation([0, 0, -0.05]) @ turned)
    boat = trajectory_of(t, np.add(shifted, [3.0, -2.0, 1.0]), turned, frame=FRAME)
    found = follow(poses, states, BRIDGE.replace(motion=motion), trajectory=boat).trajectory
    place, rotation, inside = found.at(at)
    assert inside.all()
    # chord of the circle between nodes: 0.2 m/s^2 (0.02 s)^2 / 8 = 1e-5 m; times are exact to 6e-8 s
    assert np.abs(place - position).max() < 3e-5
    # the levels of the INS and of wcs differ by 5 m / 6370 km
    assert np.abs(rotation - R).max() < 3e-6


def test_covariance_between_two_images_is_that_of_their_weighted_sum():
    poses, states = perfect(np.arange(1.0, 5.0))
    rng = np.random.default_rng(4)
    root = 1e-3 * rng.standard_normal((12, 12))
    joint = root @ root.T
    cov, following = poses.cov_pose_wcs.copy(), poses.cov_next.copy()
    cov[1], cov[2], following[1] = joint[:6, :6], joint[6:, 6:], joint[:6, 6:]
    poses = replace(
        poses,
        cov_pose_wcs=cov,
        cov_next=following,
        sigma_t_s=np.full(4, 0.02),
        facts={"image_times": {"sigma_common_s": 0.01}},
    )
    # no error of the INS, so that only the images count
    quiet = BRIDGE.replace(sigma_velocity_mps=1e-9, attitude_time_s=1e12, outlier_probability=0.0)
    found = follow(poses, states, quiet).trajectory
    A = np.zeros((6, 14))
    velocity, rate = circle(poses.t_gps_s)[1], [0.0, 0.0, -0.2]
    for k, share in ((1, 0.75), (2, 0.25)):
        J = np.eye(6)
        (J[:3, 3:],) = -cross_matrix((poses.R_wcs_ccs[k] @ CAMERA.inverse().shift_m)[None])
        A[:, 6 * (k - 1) : 6 * k] = share * J
        A[:, 11 + k] = share * np.concatenate([velocity[k], rate])
    whole = np.zeros((14, 14))
    whole[:12, :12] = joint
    whole[12:, 12:] = 0.01**2 + (0.02**2 - 0.01**2) * np.eye(2)
    expected = A @ whole @ A.T
    got = found.cov_at(poses.t_gps_s[[1]] + 0.25)[0]
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    # nodes are 0.02 s apart: a parabola joined by chords; singular values are cut at 0.9999
    assert np.abs((got - expected) / scale).max() < 2e-3


def test_chains_of_errors_are_the_covariance_of_each_pose_and_of_neighbours():
    """Images with what they share, their times alone, one clock, and the INS between."""
    recorded = survey()
    found = run(recorded, BRIDGE)
    chains = {chain.name: chain for chain in found.error_chains()}
    assert set(chains) == {"images", "times of images", "clock of the camera", "between the nodes"}
    inside = found.trajectory.t_gps_s[found.trajectory.valid]
    total = sum(chain.covariance_at(inside) for chain in chains.values())
    expected = found.trajectory.cov_at(inside)
    sigma = np.sqrt(np.diagonal(expected, axis1=1, axis2=2))
    scale = sigma[:, :, None] * sigma[:, None, :]
    # errors of the INS grow with the root of the time, and are interpolated over a fiftieth of a second
    assert_allclose(total / scale, expected / scale, rtol=0, atol=0.03)
    at = [int(np.argmin(np.abs(chains["images"].t_gps_s - t))) for t in found.used_gps_s[3:5]]
    assert at[1] == at[0] + 1
    # the arm of the body turns both errors alike
    images = timed(recorded.images)
    order = np.argsort(images.t_gps_s)[3]
    link = chains["images"].link[at[1]]
    shared = chains["images"].root[at[0]] @ link.T @ chains["images"].root[at[1]].T
    assert shared[3:, 3:] == pytest.approx(images.cov_next[order][3:, 3:], rel=1e-6, abs=1e-12)
    assert not chains["times of images"].link[at[1]].any()
    assert (chains["clock of the camera"].link == 1.0).all()
    rest = chains["between the nodes"]
    assert np.abs(rest.covariance_at(found.used_gps_s)).max() < 1e-15
    middle = np.mean(found.used_gps_s[3:5])
    assert rest.covariance_at(np.array([middle]))[0, 5, 5] > 0


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5])
def test_growth_of_the_ins_errors_against_a_simulated_process(share):
    """Sums over the exact covariance of a finely sampled Gauss-Markov process."""
    time_s, gap, step = 3.0, 2.0, 0.002
    t = np.arange(0, gap + step / 2, step)
    C = np.exp(-np.abs(t[:, None] - t) / time_s)
    x = 0.6 if share == 0.0 else share * gap
    at = np.zeros(len(t))
    at[[0, round(x / step), -1]] += [-(1 - share), 1.0, -share]
    assert bridged(np.array([x]), np.array([share]), np.array([gap]), time_s)[0] == pytest.approx(at @ C @ at)
    way = np.where(t < x, step, 0.0) - share * step
    # rectangles of 2 ms: 1e-3 of the integral
    expected = way @ C @ way
    got = bridged_integral(np.array([x]), np.array([share]), np.array([gap]), time_s)[0]
    assert got == pytest.approx(expected, rel=2e-2)


@pytest.mark.parametrize("settings", [HALF, BRIDGE], ids=["half rotation", "bridge"])
def test_errors_of_the_ins_grow_between_exact_images(settings):
    poses, states = perfect(np.array([1.0, 2.0, 5.0]))
    poses = replace(poses, cov_pose_wcs=1e-12 * poses.cov_pose_wcs)
    found = follow(poses, states, settings).trajectory
    # 0.04 s behind the second image, that nothing joins with the third
    alone = found.cov_at(poses.t_gps_s[[1]] + 0.04)[0]
    # heading: 2 sigma^2 (1 - exp(-dt / tau)); way: (sigma dt)^2 (1 - dt / (3 tau)); nodes every 0.02 s
    assert alone[5, 5] == pytest.approx(0.004**2 * 2 * 0.04 / 20.0, rel=0.01)
    assert alone[0, 0] == pytest.approx((0.05 * 0.04) ** 2, rel=0.01)
    if settings is BRIDGE:
        middle = found.cov_at(poses.t_gps_s[[0]] + 0.5)[0]
        # for short bridges u (1 - u) 2 T / tau, and T^3 / (12 tau) / 2
        assert middle[5, 5] == pytest.approx(0.004**2 * 0.5 / 20.0, rel=0.01)
        assert middle[3, 3] == pytest.approx(0.002**2 * 0.5 / 20.0, rel=0.01)
        assert middle[0, 0] == pytest.approx(0.05**2 / (24 * 10.0), rel=0.05)


# ---------------------------------------------------------------- frames and gaps


def test_a_frame_is_half_a_rotation_on_either_side_and_nothing_more():
    poses, states = perfect(np.arange(1.0, 9.0))
    found = follow(poses, states, HALF)
    t = poses.t_gps_s[:, None] + [-0.0502, -0.0499, 0.0, 0.0499, 0.0502, 0.3]
    inside = found.trajectory.at(t.ravel())[2].reshape(t.shape)
    assert np.array_equal(inside, np.tile([False, True, True, True, False, False], (8, 1)))
    facts = found.facts
    assert (facts["frames_made"], facts["spans"]) == (8, 8)
    assert facts["time_with_pose_s"] == pytest.approx(0.8, abs=1e-5)
    assert time_is_accounted_for(facts)
    assert np.isin(poses.t_gps_s, found.trajectory.t_gps_s).all()


def test_images_too_far_apart_are_not_bridged():
    poses, states = perfect(np.array([1.0, 2.0, 5.0, 6.0]))
    found = follow(poses, states, BRIDGE)
    inside = found.trajectory.at(3.0e8 + np.array([1.5, 2.04, 2.06, 3.5, 4.94, 4.96, 5.5]))[2]
    assert inside.tolist() == [True, True, False, False, False, True, True]
    assert found.images["joined_with_next"].tolist() == [True, False, True, False]
    lost = found.facts["time_lost_s"]
    assert lost["images farther apart than max_gap_s"] == pytest.approx(2.9, abs=1e-5)
    assert found.facts["neighbours_not_joined"] == 1


def test_a_hole_of_the_ins_ends_frames_and_bridges():
    poses, states = perfect(np.array([1.0, 2.0, 3.0, 3.53, 5.0]))
    t = states["t_gps_s"].to_numpy() - 3.0e8
    holed = states[(t < 2.03) | (t > 3.5)]
    found = follow(poses, holed, BRIDGE)
    assert found.images["reason"].tolist() == ["", "", NO_INS, "", ""]
    inside = found.trajectory.at(3.0e8 + np.array([1.5, 2.0, 2.019, 2.045, 3.0, 3.49, 3.522, 4.5]))[2]
    assert inside.tolist() == [True, True, True, False, False, False, True, True]
    assert found.facts["time_lost_s"]["hole of the INS"] == pytest.approx(1.5, abs=0.05)
    assert time_is_accounted_for(found.facts)


def test_a_single_image_makes_one_frame():
    poses, states = perfect(np.array([4.0]))
    found = follow(poses, states, BRIDGE)
    assert found.trajectory.at(3.0e8 + np.array([3.96, 4.04, 4.06]))[2].tolist() == [True, True, False]
    assert found.facts["longest_interval_s"] is None


# ---------------------------------------------------------------- images that cannot be used


def test_images_without_pose_or_time_and_twins_are_counted():
    poses, states = perfect(np.array([1.0, 2.0, 2.0, 3.0, 4.0, 20.0]))
    t = poses.t_gps_s.copy()
    t[3] = np.nan
    oriented = poses.oriented.copy()
    oriented[0] = False
    poses = replace(poses, t_gps_s=t, oriented=oriented, reasons=("too few matches", "", "", "", "", ""))
    found = follow(poses, states, BRIDGE)
    assert found.images["reason"].tolist() == ["no pose: too few matches", "", TWICE, NO_TIME, "", NO_INS]
    assert found.facts["images_left_out"] == {"no pose": 1, NO_INS: 1, NO_TIME: 1, TWICE: 1}
    assert found.facts["images_used"] == 2


def test_the_order_of_the_table_does_not_matter():
    recorded = survey()
    poses = timed(recorded.images)
    back = np.arange(len(poses.images))[::-1]
    names = [
        "t_gps_s",
        "sigma_t_s",
        "oriented",
        "centre_wcs_m",
        "R_wcs_ccs",
        "cov_pose_wcs",
        "n_marks",
        "rms_px",
    ]
    turned = replace(
        poses,
        images=poses.images[::-1],
        reasons=poses.reasons[::-1],
        cov_next=np.concatenate([np.swapaxes(poses.cov_next[:-1][::-1], 1, 2), np.zeros((1, 6, 6))]),
        **{name: getattr(poses, name)[back] for name in names},
    )
    one, other = (run(recorded, BRIDGE, each).trajectory for each in (poses, turned))
    assert_allclose(one.position_wcs_m, other.position_wcs_m, rtol=0, atol=1e-9)
    assert_allclose(one.cov_pose_wcs, other.cov_pose_wcs, rtol=1e-6, atol=1e-12)


def test_common_errors_pass_through_an_image_without_time():
    """Of three images the middle one has no time: the outer two are as alike as the chain says."""
    recorded = survey()
    poses = timed(recorded.images)
    t = poses.t_gps_s.copy()
    t[5] = np.nan
    settings = BRIDGE.replace(sigma_velocity_mps=1e-9, attitude_time_s=1e12)
    found = run(recorded, settings, replace(poses, t_gps_s=t, sigma_t_s=0 * t)).trajectory
    middle = found.cov_at(poses.t_gps_s[[5]])[0]
    keep = np.exp(-1.0 / 4.0)
    # half the sum of two with the correlation keep^2; the up of the lever is not turned by the mount
    assert middle[5, 5] == pytest.approx(poses.cov_pose_wcs[5, 5, 5] * (1 + keep**2) / 2, rel=1e-3)


def test_a_wrong_pose_is_left_out_and_its_neighbours_stay():
    recorded = survey()
    poses = timed(recorded.images)
    centre = poses.centre_wcs_m.copy()
    centre[6] += [0.4, -0.3, 0.1]
    reasons = run(recorded, BRIDGE, replace(poses, centre_wcs_m=centre)).images["reason"]
    assert reasons.tolist() == [CONTRADICTS if k == 6 else "" for k in range(len(reasons))]


def test_times_that_are_a_second_off_are_refused():
    spec = VoyageSpec(duration_s=30.0, twin={"boat": {"speed_mps": 2.4, "turn_rate_degps": 24.0}})
    recorded = make_survey(3, spec)
    poses = recorded.images
    assert run(recorded, BRIDGE, poses).facts["images_used"] == len(poses.images)
    with pytest.raises(ClockError, match=r"otherwise than the INS says.*clock of the camera"):
        run(recorded, BRIDGE, poses.with_times(poses.t_gps_s + 1.0, poses.sigma_t_s))


def test_sigmas_that_are_too_small_are_named():
    recorded = survey(duration_s=30.0)
    too_small = replace(recorded.images, sigma_t_s=np.full(29, 1e-4))
    for poses, named in ((too_small, True), (None, False)):
        notes = run(recorded, BRIDGE, poses).facts["notes"]
        assert any("times what their sigmas" in note for note in notes) == named


def test_nothing_usable_is_an_error_with_both_spans():
    poses, states = perfect(np.array([20.0, 21.0]))
    with pytest.raises(CoverageError, match=r"none of 2 images can be used.*the INS of"):
        follow(poses, states, HALF)
    with pytest.raises(CoverageError, match="both a pose"):
        follow(poses.with_times(np.full(2, np.nan), np.full(2, np.nan)), states, HALF)
    poses, states = perfect(np.array([2.0, 3.0]))
    with pytest.raises(InputError, match="have a velocity"):
        follow(poses, states.assign(v_north_mps=np.nan), HALF)
    with pytest.raises(CoverageError, match="no trajectory"):
        follow(poses, states, HALF.replace(motion="trajectory"))


def test_settings_are_those_of_the_campaign_file():
    assert CloudSettings.of(CameraCloud()) == CloudSettings()


@pytest.mark.parametrize("mount", [CAMERA, CAMERA.moved([0.02, -0.01, 0.03, 0.01, -0.02, 0.015])])
def test_the_mount_moves_the_boat_but_not_the_camera(mount):
    """The camera, put back through the mount, is where the images say: any mount drops out."""
    poses, states = perfect(np.arange(1.0, 9.0))
    position, R, _ = follow(poses, states, HALF, mount).trajectory.at(poses.t_gps_s[[3]])
    camera = Rigid(R=R[0], shift_m=position[0]) @ mount
    assert_allclose(camera.shift_m, poses.centre_wcs_m[3], atol=1e-9)
    assert_allclose(camera.R, poses.R_wcs_ccs[3], atol=1e-9)


def test_sigmas_of_poses_and_times_grow_with_the_mean_of_their_squares():
    """What all images share of their times stays as it is."""
    poses = timed(survey().images)
    poses = poses.with_times(poses.t_gps_s, np.full(len(poses.images), 0.05))
    errors = dict.fromkeys(
        ("velocity_time_s", "attitude_time_s", "position_time_s", "position_white_share"), 1.0
    )
    draws = (CarriedErrors(**errors, camera=1.0, jitter=2.0), CarriedErrors(**errors, camera=3.0, jitter=4.0))
    found = scaled(poses, BRIDGE.model_copy(update={"draws": draws}), 0.03)
    assert_allclose(found.cov_pose_wcs, 5.0 * poses.cov_pose_wcs)
    assert_allclose(found.cov_next, 5.0 * poses.cov_next)
    assert_allclose(found.sigma_t_s**2, 0.03**2 + 10.0 * (0.05**2 - 0.03**2))
    assert_allclose(scaled(poses, BRIDGE, 0.08).sigma_t_s, 0.05)  # all of it is shared


def test_errors_of_positions_are_those_that_are_stated_beside_the_estimated_ones():
    model = FusionErrors(
        priors={"velocity": Prior(kind="size", centre=0.1, width=2.0)},
        h=np.array([0.7]), cov=np.array([[0.04]]),
    )  # fmt: skip
    settings = CloudSettings(position_time_s=12.0, position_white_share=0.2, fixed=[])
    settings = settings.model_copy(update={"spread": {"time": 3.0, "share": 1.5, "position_time_s": 2.0}})
    found = _with_positions(model, settings)
    assert list(found.priors) == ["velocity", "position_time_s", "position_white_share"]
    assert found.priors["position_time_s"] == Prior(kind="time", centre=12.0, width=2.0)
    assert found.priors["position_white_share"] == Prior(kind="share", centre=0.2, width=1.5)
    assert_allclose(np.diag(found.cov), [0.04, np.log(2.0) ** 2, np.log(1.5) ** 2])
    assert found.h[0] == 0.7
    values = found.values(found.h)
    assert values["position_time_s"] == pytest.approx(12.0)
    assert values["position_white_share"] == pytest.approx(0.2)
    for share in (0.0, 1.0):  # no prior: it is meant
        meant = settings.model_copy(update={"position_white_share": share})
        assert list(_with_positions(model, meant).priors) == ["velocity", "position_time_s"]
    fixed = settings.model_copy(update={"fixed": ["position_time_s"]})
    assert list(_with_positions(model, fixed).priors) == ["velocity", "position_white_share"]
