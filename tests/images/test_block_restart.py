"""A block that structure from motion has put together in a wrong shape."""

from dataclasses import replace

import numpy as np
import pytest

from tests.images import block_scene
from thalweg.core import LocalFrame, exp_rotation
from thalweg.images.bundle.adjustment import adjust_block
from thalweg.images.bundle.run import adjust_from_either_start, misfit, predicted_block
from thalweg.images.model import ImagePoses

IMAGES = 16
UP_M = np.array([0.0, 0.0, 8.0])


def predictions(problem, truth, rng: np.random.Generator, known: int = IMAGES) -> ImagePoses:
    """Poses by clock, trajectory and mount: 0.1 m and 0.3 degrees, the last ones unknown."""
    names, n = problem.block.images[:known], known
    return ImagePoses(
        frame=LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0),
        images=names,
        t_gps_s=np.arange(n, dtype=float),
        sigma_t_s=np.full(n, 0.05),
        oriented=np.ones(n, bool),
        reasons=("",) * n,
        centre_wcs_m=truth.C[:n] + rng.normal(0, 0.1, (n, 3)),
        R_wcs_ccs=exp_rotation(rng.normal(0, 0.005, (n, 3))) @ truth.R[:n],
        cov_pose_wcs=np.tile(np.diag([0.01] * 3 + [2.5e-5] * 3), (n, 1, 1)),
        cov_next=np.zeros((n, 6, 6)),
        n_marks=np.zeros(n),
        rms_px=np.full(n, np.nan),
        facts={},
    )


@pytest.fixture(scope="module")
def block():
    """A block, and the same that begins so far tilted that it settles in another minimum."""
    problem, truth = block_scene.scene(np.random.default_rng(0), images=IMAGES, points=300)
    wrong = replace(truth, R=exp_rotation(np.tile([1.0, 0, 0], (IMAGES, 1))) @ truth.R, C=truth.C + UP_M)
    start = predicted_block(problem.block, predictions(problem, wrong, np.random.default_rng(1)))
    return replace(problem, block=start), truth


def position_rms_m(found, truth) -> float:
    return float(np.sqrt(np.square(block_scene.pose_errors(found, truth)[:, :3]).mean()))


def test_a_wrong_shape_is_left_for_the_predicted_one(block):
    problem, truth = block
    alone = adjust_block(problem, block_scene.OPTIONS)
    assert position_rms_m(alone, truth) > 1.0
    where = predictions(problem, truth, np.random.default_rng(2))
    again, found, result, notes = adjust_from_either_start(problem, block_scene.OPTIONS, where)
    assert position_rms_m(found, truth) < 0.12
    assert block_scene.normalised(found, truth)[1] < 1.5
    assert again.block is not problem.block
    assert not result.suspect.any()
    (note,) = notes
    assert "wrong shape, off by a median of" in note
    assert misfit(found, alone, found) < misfit(alone, alone, found)


def test_without_predictions_or_doubt_nothing_changes(block):
    problem, truth = block
    assert adjust_from_either_start(problem, block_scene.OPTIONS, None)[3] == []
    good, truth = block_scene.scene(np.random.default_rng(0), images=IMAGES, points=300)
    same, found, _, notes = adjust_from_either_start(
        good, block_scene.OPTIONS, predictions(good, truth, np.random.default_rng(2))
    )
    assert same is good
    assert notes == []
    assert position_rms_m(found, truth) < 0.12


def test_wrong_predictions_do_not_spoil_a_good_block():
    good, truth = block_scene.scene(np.random.default_rng(0), images=IMAGES, points=300)
    wrong = replace(truth, R=exp_rotation(np.tile([1.0, 0, 0], (IMAGES, 1))) @ truth.R, C=truth.C + UP_M)
    _, found, _, notes = adjust_from_either_start(
        good, block_scene.OPTIONS, predictions(good, wrong, np.random.default_rng(2))
    )
    assert position_rms_m(found, truth) < 0.12
    assert notes == []


def test_images_without_prediction_keep_their_place_beside_their_neighbour(block):
    problem, truth = block
    good = replace(problem.block, R_block_ccs=truth.R, centre_block_m=truth.C)
    exact = replace(
        predictions(problem, truth, np.random.default_rng(0), 12),
        centre_wcs_m=truth.C[:12],
        R_wcs_ccs=truth.R[:12],
    )
    # seen from a frame of its own
    turned = good.transformed(exp_rotation([0.1, 0.2, 0.3]), np.array([5.0, 6.0, 7.0]), 1.0)
    found = predicted_block(turned, exact)
    assert found is not None
    np.testing.assert_allclose(found.centre_block_m, truth.C, atol=1e-9)
    np.testing.assert_allclose(found.R_block_ccs, truth.R, atol=1e-9)
    off = np.linalg.norm(found.points_block_m - truth.X, axis=1)
    # 0.2 px at 580 px from 20 m, under some degrees
    assert np.median(off) < 0.3
    assert predicted_block(turned, replace(exact, oriented=np.zeros(12, bool))) is None
