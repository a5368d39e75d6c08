"""The covariance of a lens that a block finds out for itself."""

from dataclasses import replace

import numpy as np
import pytest

from tests.images import block_scene, test_block_gold
from thalweg.images.bundle import AdjustedBlock, with_shared_errors
from thalweg.images.bundle.adjustment import adjust_block
from thalweg.images.bundle.problem import interior_priors
from thalweg.settings.sections import BlockAdjustment

FACTOR = 2.5


@pytest.fixture(scope="module")
def adjusted():
    problem, _ = block_scene.scene(np.random.default_rng(5), images=14, points=250)
    # a lens of which some is known beforehand
    return adjust_block(
        replace(problem, prior_sigma={"p1": 2e-4, "p2": 1e-7}), block_scene.OPTIONS, scale_by_sigma0=False
    )


def lens(found: AdjustedBlock) -> np.ndarray:
    begin = found.layout.n_poses
    own = np.arange(begin, begin + found.layout.n_interior)
    return own[found.layout.free[own]]


def larger(found: AdjustedBlock, factor: float) -> np.ndarray:
    return with_shared_errors(found.problem, found.layout, found.x, found.cov, factor)


def test_it_is_the_inverse_of_normal_equations_that_tell_less(adjusted):
    free, own = np.flatnonzero(adjusted.layout.free), lens(adjusted)
    P = np.zeros_like(adjusted.cov)
    for at, weights, _ in interior_priors(adjusted.problem, adjusted.layout, adjusted.x):
        P[np.ix_(at, at)] += weights
    P = P[np.ix_(own, own)]
    scale = np.sqrt(np.diag(adjusted.cov))[free]
    N = np.linalg.inv(adjusted.cov[np.ix_(free, free)] / np.outer(scale, scale))
    # what is left of the lens's equations without all others is P + M; M counts less
    inside = np.searchsorted(free, own)
    unit = np.outer(scale[inside], scale[inside])
    M = np.linalg.inv(adjusted.cov[np.ix_(own, own)] / unit) - P * unit
    N[np.ix_(inside, inside)] -= M * (1 - 1 / FACTOR)
    expected = np.linalg.inv(N) * np.outer(scale, scale)
    # two inversions of 130 unknowns
    np.testing.assert_allclose(
        larger(adjusted, FACTOR)[np.ix_(free, free)] / np.outer(scale, scale),
        expected / np.outer(scale, scale),
        atol=1e-6,
    )


def test_what_the_images_tell_counts_less_and_what_is_known_stays(adjusted):
    own = lens(adjusted)
    names = [adjusted.layout.names[k].split()[-1] for k in own]
    ratio = dict(zip(names, np.diag(larger(adjusted, FACTOR))[own] / np.diag(adjusted.cov)[own], strict=True))
    assert ratio["cy"] == pytest.approx(FACTOR, rel=0.02)
    # known 1000 times better than the images tell
    assert ratio["p2"] == pytest.approx(1.0, abs=1e-3)
    n = adjusted.layout.n_poses
    poses = np.diag(larger(adjusted, FACTOR))[:n] / np.diag(adjusted.cov)[:n]
    # what hangs on the lens grows with it, and by no more
    assert poses.max() > 1.3
    assert ((poses > 1 - 1e-9) & (poses < FACTOR)).all()


def test_a_lens_that_is_held_or_a_factor_of_one_changes_nothing(adjusted):
    assert larger(adjusted, 1.0) is adjusted.cov
    held = adjust_block(replace(adjusted.problem, free=((),), prior_sigma={}))
    assert larger(held, FACTOR) is held.cov


def test_the_adjustment_does_it(adjusted):
    options = BlockAdjustment(interior_variance=FACTOR)
    again = adjust_block(adjusted.problem.shifted(adjusted.origin_m), options, scale_by_sigma0=False)
    sigma = np.sqrt(np.diag(again.cov)[lens(again)] / np.diag(larger(adjusted, FACTOR))[lens(adjusted)])
    np.testing.assert_allclose(sigma, 1.0, rtol=0.02)
    assert BlockAdjustment().interior_variance == 2.0


@pytest.mark.real
def test_a_real_block_errs_in_its_lens_by_twice_its_variance(data_dir, record_property):
    """Five aerial images of Strasbourg: the camera, sought freely, against its calibration.

    Camera constant, principal point and distortion, 7 numbers: their mean square is 1 in a band of 0.24 to
    2.29 with 95 %; 2.37 with what the images tell alone, 1.19 with twice its variance.
    """
    problem = test_block_gold.strasbourg(data_dir / "dbat_sxb/script/sxb")
    known = problem.block.cameras[0]
    names = ("fx", "cx", "cy", "k1", "k2", "p1", "p2")
    problem = replace(
        problem,
        free=(("fy", *names, "k3"),),
        square_pixels=True,
        prior_sigma={"k3": 0.05},
        control=replace(problem.control, check=np.zeros(len(problem.control.names), np.bool_)),
    )
    found = adjust_block(problem, block_scene.OPTIONS)
    rows = [known.parameter_names.index(name) for name in names]
    off = found.x.cameras[0].parameters[rows] - known.parameters[rows]
    own = found.layout.interior[0][rows]
    square = {}
    for factor in (1.0, 2.0):
        C = (
            with_shared_errors(found.problem, found.layout, found.x, found.cov / found.cov_scale, factor)[
                np.ix_(own, own)
            ]
            * found.cov_scale
        )
        s = np.sqrt(np.diag(C))
        square[factor] = float((off / s) @ np.linalg.solve(C / np.outer(s, s), off / s) / len(off))
        record_property(f"nees_{factor:.0f}", square[factor])
    assert square[1.0] == pytest.approx(2.37, abs=0.05)
    assert square[2.0] == pytest.approx(1.19, abs=0.03)
