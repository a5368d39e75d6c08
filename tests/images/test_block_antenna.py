"""Positions of the antenna at images whose camera's clock is off."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from tests.images import block_scene
from thalweg.images.bundle import AdjustedBlock, pose_covariance
from thalweg.images.bundle.adjustment import adjust_block
from thalweg.images.bundle.problem import CLOCK, Antenna, clock_notes

SEEDS = 4
IMAGES = 14
LEVER_M = np.array([0.1, -1.2, -0.3])
CLOCK_S, JITTER_S, GNSS_M = 0.3, 0.02, 0.01


def late_block(seed: int, *, told: bool, late_s: float | None = None, control: int = 0):
    """A block whose images were taken later than stamped, by one time and a jitter; antenna at 1 m/s.

    ``told``: the common part is known as such; else it hides in the sigmas of single images.
    """
    rng = np.random.default_rng(seed)
    problem, truth = block_scene.scene(rng, images=IMAGES, points=120, control=control, check=0)
    t = np.arange(IMAGES) * 1.0
    velocity = np.gradient(truth.C, axis=0)
    late = CLOCK_S * rng.standard_normal() if late_s is None else late_s
    after = late + JITTER_S * rng.standard_normal(IMAGES)
    rho = np.exp(-np.abs(t[:, None] - t) / 10.0)
    error = GNSS_M * np.linalg.cholesky(rho) @ rng.standard_normal((IMAGES, 3))
    antenna = Antenna(
        image=np.arange(IMAGES),
        t_s=t,
        sigma_m=np.full((IMAGES, 3), GNSS_M),
        lever_ccs_m=LEVER_M,
        position_wcs_m=truth.C + truth.R @ LEVER_M - velocity * after[:, None] + error,
        velocity_wcs_m_s=velocity,
        correlation_time_s=10.0,
        sigma_clock_s=CLOCK_S if told else 0.0,
        sigma_jitter_s=np.full(IMAGES, JITTER_S if told else np.hypot(JITTER_S, CLOCK_S)),
    )
    return (adjust_block(replace(problem, antenna=antenna), block_scene.OPTIONS), truth, late)


def clock_of(found: AdjustedBlock) -> tuple[float, float]:
    """Estimate and sigma, seconds."""
    k = found.layout.names.index(CLOCK)
    return float(found.x.extras[k - found.layout.extras]), float(np.sqrt(found.cov[k, k]))


def along_track(found: AdjustedBlock, truth) -> float:
    """Normalised square of the error of the block's place along its track, where clock errors move it."""
    way = np.gradient(truth.C, axis=0).sum(axis=0)
    row = np.zeros((IMAGES, 6))
    row[:, :3] = way / np.linalg.norm(way) / IMAGES
    error = block_scene.pose_errors(found, truth)
    return float((row * error).sum() ** 2 / (row.ravel() @ pose_covariance(found) @ row.ravel()))


def inside(values: list[float], degrees: int) -> bool:
    """Whether the mean of normalised squares is in the two-sided band of 99 %."""
    low, high = chi2.ppf([0.005, 0.995], degrees) / degrees
    return bool(low < np.mean(values) < high)


def test_poses_are_consistent_when_the_clock_is_off():
    """Without control points the clock moves all images along the track, and the covariance says so."""
    single, joint, clock, along, hidden = [], [], [], [], []
    for seed in range(SEEDS):
        found, truth, late = late_block(seed, told=True)
        each, whole = block_scene.normalised(found, truth)
        single.append(float(each.mean()))
        joint.append(whole)
        value, sigma = clock_of(found)
        clock.append(((value - late) / sigma) ** 2)
        along.append(along_track(found, truth))
        hidden.append(along_track(late_block(seed, told=False)[0], truth))
    assert inside(clock, SEEDS)
    assert inside(along, SEEDS)
    assert inside(joint, 6 * IMAGES * SEEDS)
    # positions of one block share clock and GNSS errors, attitudes their tilt: six independent errors each
    assert inside(single, 6 * SEEDS)
    assert not inside(hidden, SEEDS)


def test_control_points_tell_the_clock():
    """With control points on the bank the positions tell when the images were taken."""
    found, _, late = late_block(3, told=True, late_s=0.25, control=6)
    value, sigma = clock_of(found)
    assert abs(value - late) < 3 * sigma
    # 14 images at 1 m/s with 20 ms of jitter: 5 ms; 10 mm of GNSS that all share: 10 ms; poses of 20 mm that
    # err alike: 20 ms
    assert 0.01 < sigma < 0.03


def test_a_clock_far_off_is_told():
    found, _, _ = late_block(3, told=True, late_s=1.5, control=6)
    antenna = found.problem.antenna
    (note,) = clock_notes(antenna, clock_of(found)[0])
    assert "later than by the camera's clock" in note
    assert "images.clock" in note
    assert clock_notes(antenna, 0.9) == []
    assert clock_notes(None, 9.0) == []


def test_jitter_lies_along_the_motion():
    antenna = Antenna(
        image=np.arange(2),
        t_s=np.array([0.0, 1.0]),
        position_wcs_m=np.zeros((2, 3)),
        sigma_m=np.full((2, 3), 0.01),
        lever_ccs_m=np.zeros(3),
        correlation_time_s=10.0,
        velocity_wcs_m_s=np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]]),
        sigma_jitter_s=np.full(2, 0.01),
    )
    cov = np.linalg.inv(antenna.inverse_covariance.reshape(6, 6)).reshape(2, 3, 2, 3)
    along = np.array([0.6, 0.8, 0.0])
    assert along @ cov[0, :, 0] @ along == pytest.approx(0.01**2 + 0.05**2)
    across = np.array([-0.8, 0.6, 0.0])
    assert across @ cov[0, :, 0] @ across == pytest.approx(0.01**2)
    # the jitter of one image is not that of the next, the errors of GNSS are
    np.testing.assert_allclose(cov[0, :, 1], 0.01**2 * np.exp(-0.1) * np.eye(3), atol=1e-12)
