"""Whether the parts of a block agree on the lens."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from tests.images import block_scene, test_block_gold
from thalweg.images.bundle import AdjustedBlock
from thalweg.images.bundle.adjustment import Agreement, adjust_block, parts_agreement
from thalweg.images.bundle.problem import Problem
from thalweg.settings.sections import BlockAdjustment


def agreement(found: AdjustedBlock) -> Agreement:
    return parts_agreement(found.problem, found.x, found.tracks, found.correlation)


def scene(seed: int) -> Problem:
    problem, _ = block_scene.scene(np.random.default_rng(seed), images=18, points=300)
    return problem


def bent(problem: Problem, by: float) -> Problem:
    """The radial distortion k1 is larger in the second half of the images."""
    block, marks = problem.block, problem.marks
    centre, f = block.cameras[0].parameters[2:4], block.cameras[0].parameters[0]
    k1 = np.where(np.arange(len(block.images)) < len(block.images) // 2, 0.0, by)

    def moved(xy_px: np.ndarray, image: np.ndarray) -> np.ndarray:
        away = xy_px - centre
        r2 = np.square(away / f).sum(axis=1)
        return centre + away * (1.0 + k1[image] * r2)[:, None]

    return replace(
        problem,
        block=replace(block, mark_px=moved(block.mark_px, block.mark_image)),
        marks=replace(marks, xy_px=moved(marks.xy_px, marks.image)),
    )


@pytest.fixture(scope="module")
def still():
    return adjust_block(scene(1), BlockAdjustment(interior_variance=2.0), scale_by_sigma0=False)


def test_parts_with_independent_errors_agree_as_chi_square_says(still):
    found = agreement(still)
    # 8 unknowns of the lens: focal lengths, principal point, k1, k2, p1, p2; two parts
    assert (found.degrees, found.parts) == (8, 2)
    assert chi2.ppf(0.005, 8) < found.square < chi2.ppf(0.995, 8)
    assert still.interior_variance == 2.0
    assert not any("disagree about the lens" in note for note in still.notes)


def test_a_lens_that_changes_between_exposures_is_found_out():
    moved = adjust_block(bent(scene(1), 0.05), BlockAdjustment(interior_variance=2.0))
    assert moved.interior_variance > 4.0
    assert any("disagree about the lens" in note for note in moved.notes)


def test_the_factor_adds_what_parts_have_in_common_and_what_they_differ_by():
    assert Agreement(square=10.0, degrees=8, parts=2).interior_variance(2.0, 1.0) == 2.0
    assert Agreement(square=40.0, degrees=8, parts=2).interior_variance(2.0, 1.0) == pytest.approx(6.0)
    # covariances that are multiplied already
    assert Agreement(square=40.0, degrees=8, parts=2).interior_variance(2.0, 4.0) == 2.0
    assert Agreement(square=0.0, degrees=0, parts=1).interior_variance(1.5, 1.0) == 1.5
    # 99 % of chi-square of 8: 20.09 in any table
    assert Agreement(square=20.0, degrees=8, parts=2).interior_variance(1.0, 1.0) == 1.0
    assert Agreement(square=20.2, degrees=8, parts=2).interior_variance(1.0, 1.0) == pytest.approx(2.525)


def test_few_images_or_a_lens_that_is_held_have_no_parts_to_compare(still):
    held = replace(still.problem, free=((),), prior_sigma={})
    assert parts_agreement(held, still.x, still.tracks, still.correlation).degrees == 0
    few = replace(still.problem.block, camera=np.arange(18) // 6, cameras=still.problem.block.cameras * 3)
    cameras = replace(still.problem, block=few, free=still.problem.free * 3, weighted=(False,) * 3)
    x = replace(still.x, cameras=still.x.cameras * 3)
    assert parts_agreement(cameras, x, still.tracks, still.correlation).degrees == 0


@pytest.mark.real
def test_the_lens_of_a_real_block_moved(data_dir):
    """60 pictures of an arch in Rome; the published adjustment finds a principal point for each picture.

    With one for each, DBAT's sigma0 falls from 0.567 to 0.503 px, and they scatter by 0.05 and 0.08 mm where
    their sigmas say 0.01: one lens for all is then known much worse than residuals say. Every 16th point
    of the block, to be quick.
    """
    block = test_block_gold.rome(data_dir / "dbat_roma/script/romabundledemo", corrected=False)
    rows = block.mark_point % 16 == 0
    point = block.mark_point[rows] // 16
    block = replace(
        block,
        points_block_m=block.points_block_m[::16],
        mark_image=block.mark_image[rows],
        mark_point=point,
        mark_px=block.mark_px[rows],
        sigma_px=block.sigma_px[rows],
    )
    problem = test_block_gold.free_network(block, ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"))
    found = adjust_block(problem, BlockAdjustment(interior_variance=2.0))
    parts = agreement(found)
    assert (parts.parts, parts.degrees) == (4, 21)
    assert found.interior_variance > 4.0
