"""Parts of the smoother: transitions, derivatives, covariances of the inputs, pieces of tracks."""

from dataclasses import replace

import numpy as np
import pytest

from thalweg.core import ConfigError, LocalFrame, Rigid
from thalweg.images.model import ImagePoses
from thalweg.navigation.fusion import (
    FusionSettings,
    Layout,
    camera_of,
    fuse_trajectory,
    jumped_images,
    make_reference,
    place_nodes,
    with_own_jitter,
)
from thalweg.navigation.fusion.model import (
    GROUPS,
    INS,
    MODEL,
    RESET,
    antenna_of,
    antenna_rows,
    camera_rows,
    pair_transition,
)
from thalweg.navigation.fusion.solver import jumped_positions
from thalweg.navigation.ins_gnss import build_trajectory
from thalweg_lab.studies import outage

SETTINGS = FusionSettings()
ONES = dict.fromkeys(GROUPS, 1.0)
FAR = LocalFrame(lat_deg=51.063, lon_deg=13.25, h_ell_m=300.0)
SIGMA = np.deg2rad([0.1, 0.1, 0.2])


@pytest.fixture(scope="module")
def survey():
    return outage.make_survey(5, outage.VoyageSpec(duration_s=30.0))


@pytest.fixture(scope="module")
def reference(survey):
    t = survey.states["t_gps_s"].to_numpy()
    return make_reference(
        survey.states,
        outage.FRAME,
        sigma_attitude_rad=SIGMA,
        max_attitude_gap_s=0.1,
        use_velocity=True,
        near_t_s=t,
        near_wcs_m=survey.motion.position_wcs_m(t),
    )


def matrices(step_s: float, kind: int) -> tuple[np.ndarray, np.ndarray]:
    f, g, dd, de, ee = pair_transition(np.array([step_s]), np.array([kind]), SETTINGS, ONES)[0]
    return np.array([[1.0, f], [0.0, g]]), np.array([[dd, de], [de, ee]])


@pytest.mark.parametrize("kind", [INS, MODEL])
@pytest.mark.parametrize(("first_s", "second_s"), [(0.03, 0.07), (0.15, 0.1), (3.0, 40.0)])
def test_two_steps_are_one_step(kind, first_s, second_s):
    """Also across the border between series and closed form at 0.2 s."""
    (F, Q), (G, R) = matrices(first_s, kind), matrices(second_s, kind)
    H, S = matrices(first_s + second_s, kind)
    np.testing.assert_allclose(G @ F, H, rtol=1e-12)
    # 1e-7: the fifth term of the series at 0.02
    np.testing.assert_allclose(G @ Q @ G.T + R, S, rtol=1e-7)


def test_an_error_of_the_velocity_keeps_its_variance_and_grows_the_way():
    F, Q = matrices(2.0, INS)
    assert F[1, 1] ** 2 * 0.05**2 + Q[1, 1] == pytest.approx(0.05**2)
    # way of a short step: sigma T
    F, Q = matrices(0.1, INS)
    way = np.array([F[0, 1], 1.0]) @ np.diag([0.05**2, 0.0]) @ np.array([F[0, 1], 1.0]) + Q[0, 0]
    assert way == pytest.approx((0.05 * 0.1) ** 2, rel=0.01)


def test_the_velocity_begins_again_behind_a_hole():
    row = pair_transition(np.zeros(1), np.array([RESET]), SETTINGS, ONES)[0]
    np.testing.assert_allclose(row, [0.0, 0.0, 0.0, 0.0, 0.05**2])


@pytest.mark.parametrize("kind", ["antenna", "camera"])
def test_derivatives_by_each_state(survey, reference, kind):
    """What an observation misses changes by ``-H dx``, for each state on its own."""
    layout = Layout.of(gnss=True, camera=True)
    if kind == "antenna":
        observed = antenna_of(survey.positions[100:103], outage.FRAME, outage.LEVER_ANTENNA_M, [0.01] * 3)
        rows = antenna_rows
    else:
        use = np.isin(np.arange(len(survey.images.images)), [8, 9, 10])
        observed = camera_of(survey.images, use, survey.T_ccs_ics, 0.016)
        rows = camera_rows
    at = reference.at(observed.t_gps_s)
    x = 0.3 * np.random.default_rng(4).standard_normal((3, layout.n))
    if kind == "camera":
        x[:, 3:6] = 0.0
    H, y = rows(x, at, observed, layout, SETTINGS)
    missed = y - np.einsum("nij,nj->ni", H, x)
    for i in [*range(3), *range(6, layout.n)]:
        moved = x.copy()
        moved[:, i] += 1e-3
        G, z = rows(moved, at, observed, layout, SETTINGS)
        change = (z - np.einsum("nij,nj->ni", G, moved) - missed) / 1e-3
        # 1 %: angles of 0.2 deg in all, to second order 0.004 rad; rounding of 500 m over 1e-3 is 1e-10
        np.testing.assert_allclose(change, -H[:, :, i], atol=1e-2 * np.abs(H[:, :, i]).max() + 1e-9)


def test_image_poses_at_the_body_have_the_covariance_of_the_product(survey):
    """With a lever arm of metres, so that the turn of the image moves the body."""
    mount = Rigid(
        R=survey.T_ccs_ics.R, shift_m=np.array([3.0, -2.0, 1.0]), cov=np.diag([1e-6] * 3 + [1e-7] * 3)
    )
    one = camera_of(survey.images, np.arange(len(survey.images.images)) == 4, mount, 0.016)
    product = survey.images.pose(4) @ mount
    np.testing.assert_allclose(one.position_wcs_m[0], product.shift_m, atol=1e-12)
    own = one.root[0] @ one.root[0].T + one.by_mount[0] @ one.by_mount[0].T
    scale = np.sqrt(np.outer(np.diag(product.cov), np.diag(product.cov)))
    np.testing.assert_allclose(own / scale, product.cov / scale, atol=1e-8)


def test_a_chain_of_images_keeps_covariances_and_neighbours_covariances(survey):
    """Of an image in the chain and, over one that is left out, of the one behind it."""
    images = survey.images
    use = np.ones(len(images.images), dtype=bool)
    use[10] = False
    chain = camera_of(images, use, survey.T_ccs_ics, 0.016)
    keep = np.exp(-1.0 / 4.0)
    np.testing.assert_allclose(chain.G[5], np.eye(6) * keep / 0.999, atol=1e-9)
    assert chain.index[9:11].tolist() == [9, 11]
    np.testing.assert_allclose(chain.G[10], np.eye(6) * (keep / 0.999) ** 2, atol=1e-9)
    for G, W in zip(chain.G, chain.W, strict=True):
        np.testing.assert_allclose(G @ G.T + W, np.eye(6), atol=1e-12)


def test_far_from_the_origin_the_level_of_the_ins_is_turned(survey):
    """1.4 km from the origin the verticals differ by 2.3e-4 rad; the older way knows it too."""
    alone = fuse_trajectory(
        survey.states,
        FAR,
        SETTINGS,
        positions=survey.positions,
        lever_ics_antenna_m=outage.LEVER_ANTENNA_M,
        sigma_attitude_rad=SIGMA,
        max_attitude_gap_s=0.1,
    ).trajectory
    older, _ = build_trajectory(
        survey.positions,
        survey.states,
        FAR,
        lever_ics_antenna_m=outage.LEVER_ANTENNA_M,
        sigma_lever_m=np.zeros(3),
        accept_fixes=["fixed"],
        max_gap_s=1.0,
        max_attitude_gap_s=0.1,
        sigma_attitude_rad=SIGMA,
    )
    at = survey.motion.start_gps_s + np.arange(5.0, 25.0, 0.5)
    here, there = alone.at(at)[1], older.at(at)[1]
    turned = here @ np.swapaxes(there, 1, 2)
    # positions of 20 mm at a lever arm of 0.45 m say little of the level: 2e-5 rad
    assert np.abs(np.stack([turned[:, 2, 1], turned[:, 0, 2]])).max() < 5e-5
    assert np.linalg.norm(alone.at(at)[0] - older.at(at)[0], axis=1).max() < 0.06


def test_nodes_lie_at_observations_and_never_far_apart(reference):
    t0 = reference.t_gps_s[0]
    antenna, image = t0 + np.array([1.0, 1.1, 9.0]), t0 + np.array([1.1, 5.0, 5.0])
    nodes, of_antenna, of_image = place_nodes(reference, SETTINGS, antenna, image)
    np.testing.assert_allclose(nodes.t_gps_s[of_antenna], antenna, atol=1e-6)
    np.testing.assert_allclose(nodes.t_gps_s[of_image], image, atol=1e-6)
    assert len(set(of_image.tolist())) == 3  # images of the same time have nodes of their own
    assert np.diff(nodes.t_gps_s).min() >= 0
    assert np.diff(nodes.t_gps_s).max() <= SETTINGS.node_s + 1e-6
    assert nodes.t_gps_s[[0, -1]].tolist() == reference.t_gps_s[[0, -1]].tolist()


def test_sound_observations_are_never_doubtful(survey, reference):
    antenna = antenna_of(survey.positions, outage.FRAME, outage.LEVER_ANTENNA_M, np.zeros(3))
    use = np.ones(len(survey.images.images), dtype=bool)
    camera = camera_of(survey.images, use, survey.T_ccs_ics, 0.016)
    assert not jumped_positions(antenna, reference, SETTINGS).any()
    assert not jumped_images(camera, reference, SETTINGS).any()


def test_jumps_at_the_ends_and_twice_are_found(survey, reference):
    antenna = antenna_of(survey.positions, outage.FRAME, outage.LEVER_ANTENNA_M, np.zeros(3))
    off = np.zeros((len(antenna.t_gps_s), 3))
    off[:20, 0] = 0.4
    off[100:130, 2] = -0.4
    off[200:201, 1] = 1.0
    off[-15:] = [0.0, 0.5, 0.0]
    moved = replace(antenna, position_wcs_m=antenna.position_wcs_m + off)
    found = jumped_positions(moved, reference, SETTINGS)
    np.testing.assert_array_equal(found, off.any(axis=1))


def test_times_of_images_count_once():
    def poses(**told: object) -> ImagePoses:
        return ImagePoses(
            frame=LocalFrame(lat_deg=51.0, lon_deg=13.0, h_ell_m=100.0),
            images=("a.jpg",),
            t_gps_s=np.array([5.0]),
            sigma_t_s=np.array([0.025]),
            oriented=np.array([True]),
            reasons=("",),
            centre_wcs_m=np.zeros((1, 3)),
            R_wcs_ccs=np.eye(3)[None],
            cov_pose_wcs=np.eye(6)[None],
            cov_next=np.zeros((1, 6, 6)),
            n_marks=np.zeros(1),
            rms_px=np.ones(1),
            facts={"image_times": told} if told else {},
        )

    # 25^2 = 20^2 + 15^2: the common part is the state of the clock
    own = with_own_jitter(poses(sigma_common_s=0.015, independent_of_ins=True))
    np.testing.assert_allclose(own.sigma_t_s, [0.020])
    np.testing.assert_allclose(with_own_jitter(poses()).sigma_t_s, [0.025])
    with pytest.raises(ConfigError, match="image_times"):
        with_own_jitter(poses(independent_of_ins=False))
