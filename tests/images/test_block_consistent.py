"""Covariances of the block adjustment are consistent when errors along a track are related."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from tests.images import block_scene
from thalweg.core import exp_rotation
from thalweg.images.bundle import pose_covariance
from thalweg.images.bundle.adjustment import adjust_block, control_result, neighbours_noise
from thalweg.images.bundle.normals import (
    Correlation,
    derivatives_by_point,
    estimate,
    linearised,
    parallax,
    tracks_of,
    views,
)
from thalweg.images.bundle.problem import Layout, State
from thalweg.settings.sections import BlockAdjustment

scene, normalised = block_scene.scene, block_scene.normalised

SEEDS = 6
FORMAL = BlockAdjustment(correlated=False, interior_variance=1.0)
WANDERING = {"slow_px": 0.6, "reach": 0.5, "white_px": 0.1}


def band(degrees: int) -> tuple[float, float]:
    """Where chi-square over its degrees of freedom lies with 99.9 %."""
    low, high = chi2.ppf([0.0005, 0.9995], degrees) / degrees
    return float(low), float(high)


def study(options: BlockAdjustment, effects: dict, seeds: int = SEEDS) -> tuple[np.ndarray, float, float]:
    """Mean normalised error of each image, of all poses together, and of check points."""
    images, joint, checks = [], [], []
    for seed in range(seeds):
        problem, truth = scene(np.random.default_rng(1000 + seed), images=24, points=400, **effects)
        found = adjust_block(problem, options)
        one, together = normalised(found, truth)
        result = control_result(found)
        known = problem.control.check & np.isfinite(result.test)
        images.append(one)
        joint.append(together)
        checks.append(result.test[known].mean() / 3)
    return np.mean(images, axis=0), float(np.mean(joint)), float(np.mean(checks))


def check_consistent(effects: dict, seeds: int = SEEDS) -> None:
    each, joint, checks = study(block_scene.OPTIONS, effects, seeds)
    low, high = band(6 * seeds)
    # 24 images of a block err alike: no more than one of them may be just outside the band of one
    assert ((each > low) & (each < high)).sum() >= 23, each
    low, high = band(6 * 24 * seeds)
    # the model's numbers are estimated from 1,700 marks: 1 % on top of the band
    assert low - 0.01 < joint < high + 0.01
    # some 3 check points a block that share its bending
    low, high = band(3 * seeds)
    assert low < checks < high


def test_poses_are_consistent_for_errors_that_wander():
    check_consistent(WANDERING)


def test_formal_sigmas_are_too_small():
    """The same blocks without the model: what the test above must be able to see."""
    _, joint, _ = study(FORMAL, WANDERING, 10)
    assert joint > band(6 * 24 * 10)[1]


def residuals_at_truth(seed: int, **effects):
    problem, truth = scene(np.random.default_rng(seed), images=40, points=1000, start_off=0.0, **effects)
    b = problem.block
    x = State(b.cameras, b.R_block_ccs, b.centre_block_m, b.points_block_m, truth.G, np.zeros(0))
    view = views(x.X[b.mark_point], x.C[b.mark_image])
    tracks = tracks_of(problem, np.ones(len(b.mark_image), bool), b.sigma_px, view)
    at = np.repeat(tracks.point, np.diff(tracks.first))
    part = linearised(problem, Layout(problem), x, tracks.image, x.X[at], tracks.xy_px)
    return tracks, part


def along_the_rows(tracks, part):
    """Errors of the scenes are drawn in rows and columns, whatever the parallax."""
    return tracks.first, part.by_point, part.residual, tracks.sigma_px, tracks.view


def test_errors_along_and_across_and_their_smoothness_are_found():
    rng = np.random.default_rng(21)
    tracks, part = residuals_at_truth(21)
    true = Correlation(white=0.8, slow=3.0, reach_rad=0.5, power=1.6, white_across=0.5, slow_across=0.6)
    for a, b in itertools.pairwise(tracks.first):
        C = true.covariances(tracks.view[a:b], tracks.sigma_px[a:b])
        draw = np.linalg.cholesky(C) @ rng.standard_normal((2, b - a, 1))
        part.residual[a:b] = draw[:, :, 0].T
    found = estimate(*along_the_rows(tracks, part))
    for apart in np.radians([3.0, 6.0, 12.0]):
        assert found.change(apart) == pytest.approx(true.change(apart), rel=0.06)
    # errors of either kind in one number would be off by a quarter
    assert found.white_across < 0.75
    assert found.slow_across < 0.85
    assert found.power > 1.2


def test_parallax_is_the_way_of_a_point_as_the_camera_moves(rng):
    problem, truth = scene(rng, images=12, points=100, start_off=0.0)
    b = problem.block
    x = State(b.cameras, b.R_block_ccs, b.centre_block_m, b.points_block_m, truth.G, np.zeros(0))
    by_point = derivatives_by_point(problem, x, b.mark_image, x.X[b.mark_point])
    along = parallax(by_point, b.mark_point, x.C[b.mark_image], len(x.X))
    np.testing.assert_allclose(np.linalg.norm(along, axis=1), 1.0, atol=1e-12)
    # the boat goes east and looks north: along the rows, but for its zigzag and roll
    assert np.median(np.abs(along[:, 0])) > 0.95
    turned = exp_rotation([0.0, 0.0, np.pi / 2])[:2, :2]
    rolled = parallax(turned @ by_point, b.mark_point, x.C[b.mark_image], len(x.X))
    np.testing.assert_allclose(rolled, along @ turned.T, atol=1e-12)


def test_independent_errors_stay_independent():
    tracks, part = residuals_at_truth(8, white_px=0.24)
    found = estimate(tracks.first, part.by_point, part.residual, tracks.sigma_px, tracks.view)
    near = np.hypot(found.white, found.slow * np.sqrt(-np.expm1(-0.05 / found.reach_rad)))
    assert near == pytest.approx(0.8, rel=0.03)
    assert found.slow * np.sqrt(-np.expm1(-0.2 / found.reach_rad)) < 0.2


def test_heavy_tails_of_tracks_are_found():
    tracks, part = residuals_at_truth(9, white_px=0.24)
    rng = np.random.default_rng(0)
    size = 1 / np.sqrt(rng.chisquare(4, len(tracks.point)) / 4)
    wild = part.residual * np.repeat(size, np.diff(tracks.first))[:, None]
    found = estimate(tracks.first, part.by_point, wild, tracks.sigma_px, tracks.view)
    assert found.freedom in (3.0, 4.0, 5.0)
    assert found.white == pytest.approx(0.8, rel=0.08)


def test_the_likelihood_prefers_the_truth_to_other_reaches():
    a = Correlation(white=0.5, slow=1.0, reach_rad=0.1)
    assert a.differs(Correlation(white=0.5, slow=1.0, reach_rad=0.2), 0.03)
    assert not a.differs(Correlation(white=0.505, slow=1.0, reach_rad=0.1), 0.03)
    # a wander is told by slow^2 / reach only
    assert not Correlation(slow=1, reach_rad=30).differs(Correlation(slow=2**0.5, reach_rad=60), 0.03)


def test_leaves_in_the_wind_take_no_part():
    """Points of one place that move together from image to image, by half a pixel."""
    rng = np.random.default_rng(11)
    problem, truth = scene(rng, images=24, points=600)
    b = problem.block
    tree = np.linalg.norm(truth.X - [12.0, 9.0, 3.0], axis=1) < 5.0
    moving = tree[b.mark_point]
    assert 30 < tree.sum() < 200
    sway = rng.normal(0, 1.0, (24, 2))
    px = b.mark_px + moving[:, None] * (sway[b.mark_image] + rng.normal(0, 0.5, b.mark_px.shape))
    swayed = replace(problem, block=replace(b, mark_px=px))
    found = adjust_block(swayed, block_scene.OPTIONS)
    assert found.used[moving].mean() < 0.25
    assert found.used[~moving].mean() > 0.9
    _, joint = normalised(found, truth)
    _, spoilt = normalised(
        adjust_block(
            swayed, BlockAdjustment(disturbed_limit=1000.0, interior_variance=1.0, correlated=False)
        ),
        truth,
    )
    low, high = band(6 * 24)
    # a few points at the edge of the tree stay
    assert low < joint < 1.3 * high
    assert spoilt > 1.3 * high
    calm = neighbours_noise(truth.X, np.full(len(truth.X), 5.0), np.full(len(truth.X), 5.0))
    assert (calm == 1).all()


def test_neighbours_err_alike(rng):
    """The covariance between neighbours is that of their difference over seeds, not zero."""
    problem, _ = scene(rng, images=24, points=400, **WANDERING)
    Q = pose_covariance(adjust_block(problem, block_scene.OPTIONS))
    a, b = slice(6 * 11, 6 * 11 + 6), slice(6 * 12, 6 * 12 + 6)
    apart = np.diag(Q[a, a] + Q[b, b] - Q[a, b] - Q[b, a])
    alone = np.diag(Q[a, a]) + np.diag(Q[b, b])
    assert (apart > 0).all()
    assert (apart[:3] < 0.3 * alone[:3]).all()
