"""Parts of the smoother: transitions, derivatives, covariances of the inputs, pieces of tracks."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.core.conftest import image_poses_of
from thalweg.core import ConfigError, LocalFrame, Rigid
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
from thalweg.navigation.fusion.model import antenna_of, antenna_rows, camera_rows
from thalweg.navigation.fusion.solver import jumped_positions
from thalweg.navigation.ins_gnss import build_trajectory
from thalweg_lab.studies import outage

SETTINGS = FusionSettings()
FAR = LocalFrame(lat_deg=51.063, lon_deg=13.25, h_ell_m=300.0)
HOW = {"sigma_attitude_rad": np.deg2rad([0.1, 0.1, 0.2]), "max_attitude_gap_s": 0.1}


@pytest.fixture(scope="module")
def survey():
    return outage.make_survey(5, outage.VoyageSpec(duration_s=30.0))


@pytest.fixture(scope="module")
def reference(survey):
    t = survey.states["t_gps_s"].to_numpy()
    near = {"near_t_s": t, "near_wcs_m": survey.motion.position_wcs_m(t)}
    return make_reference(survey.states, outage.FRAME, use_velocity=True, **near, **HOW)


def antenna_at(positions, sigma_lever_m):
    return antenna_of(positions, outage.FRAME, outage.LEVER_ANTENNA_M, sigma_lever_m)


def camera_at(survey, use=True):
    """Those of the images that are used."""
    return camera_of(survey.images, np.broadcast_to(use, len(survey.images.images)), survey.T_ccs_ics, 0.016)


@pytest.mark.parametrize("kind", ["antenna", "camera"])
def test_derivatives_by_each_state(survey, reference, kind):
    """What an observation misses changes by ``-H dx``, for each state on its own."""
    layout = Layout.of(gnss=True, camera=True)
    if kind == "antenna":
        observed, rows = antenna_at(survey.positions[100:103], [0.01] * 3), antenna_rows
    else:
        use = np.isin(np.arange(len(survey.images.images)), [8, 9, 10])
        observed, rows = camera_at(survey, use), camera_rows
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
        assert_allclose(change, -H[:, :, i], atol=1e-2 * np.abs(H[:, :, i]).max() + 1e-9)


def test_image_poses_at_the_body_have_the_covariance_of_the_product(survey):
    """With a lever arm of metres, so that the turn of the image moves the body."""
    mount = Rigid(
        R=survey.T_ccs_ics.R, shift_m=np.array([3.0, -2.0, 1.0]), cov=np.diag([1e-6] * 3 + [1e-7] * 3)
    )
    one = camera_of(survey.images, np.arange(len(survey.images.images)) == 4, mount, 0.016)
    product = survey.images.pose(4) @ mount
    assert_allclose(one.position_wcs_m[0], product.shift_m, atol=1e-12)
    own = one.root[0] @ one.root[0].T + one.by_mount[0] @ one.by_mount[0].T
    scale = np.sqrt(np.outer(np.diag(product.cov), np.diag(product.cov)))
    assert_allclose(own / scale, product.cov / scale, atol=1e-8)


def test_a_chain_of_images_keeps_covariances_and_neighbours_covariances(survey):
    """Of an image in the chain and, over one that is left out, of the one behind it."""
    images = survey.images
    use = np.ones(len(images.images), dtype=bool)
    use[10] = False
    chain = camera_at(survey, use)
    keep = np.exp(-1.0 / 4.0)
    assert_allclose(chain.G[5], np.eye(6) * keep / 0.999, atol=1e-9)
    assert chain.index[9:11].tolist() == [9, 11]
    assert_allclose(chain.G[10], np.eye(6) * (keep / 0.999) ** 2, atol=1e-9)
    for G, W in zip(chain.G, chain.W, strict=True):
        assert_allclose(G @ G.T + W, np.eye(6), atol=1e-12)


def test_far_from_the_origin_the_level_of_the_ins_is_turned(survey):
    """1.4 km from the origin the verticals differ by 2.3e-4 rad; the older way knows it too."""
    positions, how = survey.positions, HOW | {"lever_ics_antenna_m": outage.LEVER_ANTENNA_M}
    alone = fuse_trajectory(survey.states, FAR, SETTINGS, positions=positions, **how).trajectory
    how |= {"sigma_lever_m": np.zeros(3), "accept_fixes": ["fixed"], "max_gap_s": 1.0}
    older, _ = build_trajectory(positions, survey.states, FAR, **how)
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
    assert_allclose(nodes.t_gps_s[of_antenna], antenna, atol=1e-6)
    assert_allclose(nodes.t_gps_s[of_image], image, atol=1e-6)
    assert len(set(of_image.tolist())) == 3  # images of the same time have nodes of their own
    assert np.diff(nodes.t_gps_s).min() >= 0
    assert np.diff(nodes.t_gps_s).max() <= SETTINGS.node_s + 1e-6
    assert nodes.t_gps_s[[0, -1]].tolist() == reference.t_gps_s[[0, -1]].tolist()


def test_sound_observations_are_never_doubtful(survey, reference):
    antenna = antenna_at(survey.positions, np.zeros(3))
    assert not jumped_positions(antenna, reference, SETTINGS).any()
    assert not jumped_images(camera_at(survey), reference, SETTINGS).any()


def test_jumps_at_the_ends_and_twice_are_found(survey, reference):
    antenna = antenna_at(survey.positions, np.zeros(3))
    off = np.zeros((len(antenna.t_gps_s), 3))
    off[:20, 0] = 0.4
    off[100:130, 2] = -0.4
    off[200:201, 1] = 1.0
    off[-15:] = [0.0, 0.5, 0.0]
    moved = replace(antenna, position_wcs_m=antenna.position_wcs_m + off)
    found = jumped_positions(moved, reference, SETTINGS)
    assert_array_equal(found, off.any(axis=1))


def test_times_of_images_count_once():
    def poses(**told):
        facts = {"image_times": told} if told else {}
        one = {"sigma_t_s": np.array([0.025]), "facts": facts}
        return image_poses_of(np.zeros((1, 3)), np.eye(3), [5.0], **one)

    # 25^2 = 20^2 + 15^2: the common part is the state of the clock
    own = with_own_jitter(poses(sigma_common_s=0.015, independent_of_ins=True))
    assert_allclose(own.sigma_t_s, [0.020])
    assert_allclose(with_own_jitter(poses()).sigma_t_s, [0.025])
    with pytest.raises(ConfigError, match="image_times"):
        with_own_jitter(poses(independent_of_ins=False))
