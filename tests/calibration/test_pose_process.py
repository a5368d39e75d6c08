"""Processes of pose errors estimated from a run, and what their uncertainty does to the covariance."""

from dataclasses import replace

import numpy as np
import pytest

from thalweg.calibration.ins_lidar import BorderedNormals, Knots, PoseErrors, pose_rows
from thalweg.calibration.ins_lidar.adjustment import (
    NAMES,
    Processes,
    changed,
    estimate_processes,
    total_covariance,
)
from thalweg.calibration.ins_lidar.model import State, Step
from thalweg.core import ArrayF, Rigid
from thalweg_lab.random_numbers import gauss_markov

STATED = PoseErrors(
    sigma_position_m=np.array([0.02, 0.02, 0.03]),
    sigma_attitude_rad=np.deg2rad([0.1, 0.1, 0.2]),
    epoch_s=0.5,
    position_time_s=4.0,
    attitude_time_s=4.0,
)


def step_of(true: PoseErrors, seconds: float, seed: int) -> tuple[Step, Knots]:
    """Normal equations of a run whose points see the errors of a boat at rest in all directions."""
    rng = np.random.default_rng([3, seed])
    n = int(50 * seconds)
    t = np.sort(rng.uniform(0.0, seconds, n))
    normal = rng.standard_normal((n, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    arm = rng.uniform(-6.0, 6.0, (n, 3))
    rows = pose_rows(normal, arm, np.broadcast_to(np.eye(3), (n, 3, 3)))
    grid = np.arange(0.0, seconds + 1.0, 0.5)
    slow = np.sqrt(1 - true.white_share)
    sizes = [*(slow * true.sigma_position_m), *true.sigma_attitude_rad]
    error = np.stack(
        [
            np.interp(t, grid, gauss_markov(rng, len(grid), 0.5, float(sigma), float(time)))
            for sigma, time in zip(sizes, true.times_s, strict=True)
        ],
        axis=1,
    )
    for axis, sigma in enumerate(true.sigma_position_m):
        white = np.sqrt(true.white_share) * sigma * rng.standard_normal(len(grid))
        error[:, axis] += np.interp(t, grid, white)
    y = np.sum(rows * error, axis=1) + 0.017 * rng.standard_normal(n)
    knots = Knots.over(float(t[0]), float(t[-1]), STATED)
    border = np.concatenate([normal, np.cross(arm + np.array([2.0, 0.0, 1.0]), normal)], axis=1)
    normals = BorderedNormals.of(knots, t, border, rows, y, np.full(n, 0.017**-2))
    prior_border = np.zeros((6, 6))
    solution = normals.solve(knots.prior(STATED)[0], prior_border)
    state = State(mount=Rigid(R=np.eye(3), shift_m=np.zeros(3)), z=np.zeros(0), e=np.zeros(knots.n))
    return Step(
        normals=normals, prior_border=prior_border, solution=solution, state=state, residual_m=y, share=1.0
    ), knots


def test_one_width_of_the_prior_is_a_factor_of_two_three_and_five():
    for i, name in enumerate(NAMES):
        far = changed(STATED, np.eye(7)[i])
        sizes = np.r_[
            far.sigma_position_m / STATED.sigma_position_m, far.sigma_attitude_rad / STATED.sigma_attitude_rad
        ]
        expected = np.ones(6)
        if name.endswith("size"):
            expected[{"position": [0, 1, 2], "tilt": [3, 4], "heading": [5]}[name.split("_")[0]]] = 2.0
        assert sizes == pytest.approx(expected)
        expected = np.full(6, 4.0)
        if name.endswith("time"):
            expected[{"position": [0, 1, 2], "tilt": [3, 4], "heading": [5]}[name.split("_")[0]]] = 12.0
        assert far.times_s == pytest.approx(expected)
        # 0.25 : 0.75 times five is 5 : 3
        assert far.white_share == pytest.approx(0.625 if name == "white_share" else 0.25)


def test_a_long_run_determines_sizes_times_and_white_share():
    true = replace(
        STATED,
        sigma_position_m=0.5 * STATED.sigma_position_m,
        position_time_s=2.0,
        white_share=0.6,
        sigma_attitude_rad=2.0 * STATED.sigma_attitude_rad,
        attitude_time_s=2.0,
    )
    step, knots = step_of(true, 150.0, 1)
    found = estimate_processes(step, knots, STATED)
    assert found.errors.white_share == pytest.approx(0.6, abs=0.12)
    # three axes of 75 correlation times: a size to 8 %, a time to 20 %; the heading alone 12 and 25 %
    ratio = found.errors.sigma_position_m / true.sigma_position_m
    assert ratio == pytest.approx(np.ones(3), rel=0.25)
    assert found.errors.sigma_attitude_rad == pytest.approx(true.sigma_attitude_rad, rel=0.4)
    assert found.errors.position_time_s == pytest.approx(2.0, rel=0.6)
    assert {"position_size", "tilt_size", "white_share"}.isdisjoint(found.undetermined())
    facts = found.facts()
    assert facts["white_share"]["determined_by_survey"]
    assert facts["white_share"]["low"] < 0.6 < facts["white_share"]["high"]
    assert facts["position_size"]["stated_within_factor"] == 2.0


def test_a_run_that_sees_nothing_leaves_the_prior_with_its_width():
    step, knots = step_of(STATED, 10.0, 2)
    blind = replace(
        step,
        normals=replace(
            step.normals,
            band=1e-9 * step.normals.band,
            coupling=1e-9 * step.normals.coupling,
            rhs_band=1e-9 * step.normals.rhs_band,
        ),
    )
    found = estimate_processes(blind, knots, STATED)
    assert np.abs(found.z) == pytest.approx(np.zeros(7), abs=0.05)
    # 64 weighted draws of a standard normal number
    assert found.width == pytest.approx(np.ones(7), abs=0.3)
    assert found.undetermined() == NAMES


def test_the_covariance_is_that_of_all_processes_together():
    """Law of total covariance by hand, of two processes with weights of a quarter and three quarters."""
    step, knots = step_of(STATED, 20.0, 3)
    draws = np.array([[1.0, 1.0, 0.5, 0.0, 1.0, 0.0, 0.0], [-1.0, -0.5, 0.0, 0.5, 0.0, 0.0, 1.0]])
    weights = np.array([0.25, 0.75])
    both = Processes(stated=STATED, errors=STATED, z=np.zeros(7), draws=draws, weights=weights)

    def mount(errors: PoseErrors) -> tuple[ArrayF, ArrayF]:
        found = step.normals.solve(knots.prior(errors)[0], step.prior_border)
        return found.border, found.cov_border

    x0, _ = mount(STATED)
    parts = [mount(changed(STATED, z)) for z in draws]
    expected = sum(w * (C + np.outer(x - x0, x - x0)) for w, (x, C) in zip(weights, parts, strict=True))
    np.testing.assert_allclose(total_covariance(step.normals, step.prior_border, knots, both), expected)


def test_what_a_short_run_leaves_open_enlarges_the_covariance():
    step, knots = step_of(STATED, 8.0, 4)
    found = estimate_processes(step, knots, STATED)
    alone = step.normals.solve(knots.prior(found.errors)[0], step.prior_border).cov_border
    total = total_covariance(step.normals, step.prior_border, knots, found)
    # two correlation times tell next to nothing of a size: E f^2 of a factor of two is 2.6
    assert np.all(np.diag(total) > 1.2 * np.diag(alone))
    # equal runs give equal results
    again = estimate_processes(step, knots, STATED)
    np.testing.assert_array_equal(again.weights, found.weights)


def test_a_white_share_of_zero_stays_zero():
    stated = replace(STATED, white_share=0.0, knot_s=0.5)
    assert changed(stated, np.zeros(6)).white_share == 0.0
