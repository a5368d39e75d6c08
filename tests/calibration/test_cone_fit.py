"""Cones from marks: from nothing, with wrong marks, and what cannot be a cone."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from thalweg.calibration import Cone, ConeReference, fit_reference
from thalweg.calibration.cones import _cost, _directions, _weights, parameter_cov, refine, start_cone
from thalweg.core import GeometryError

HALF = np.deg2rad(25.0)
SIGMA_M = 0.0002


def cone_of(rng: np.random.Generator) -> Cone:
    return Cone(apex_m=5 * rng.standard_normal(3), axis=rng.standard_normal(3), half_angle_rad=HALF + 0.003)


def on_surface(cone: Cone, slant: np.ndarray, psi: np.ndarray) -> np.ndarray:
    """Points (n, 3) at distances from the apex and turns about the axis."""
    across = np.column_stack([np.cos(psi), np.sin(psi)]) @ cone.tangents
    a = cone.half_angle_rad
    return np.asarray(cone.apex_m + slant[:, None] * (np.cos(a) * cone.axis + np.sin(a) * across))


def marks(cone: Cone, rng: np.random.Generator, n: int = 32, around: float = 2 * np.pi) -> np.ndarray:
    points = on_surface(cone, rng.uniform(0.3, 0.75, n), rng.uniform(0, around, n))
    return points + SIGMA_M * rng.standard_normal((n, 3))


def reference(points: np.ndarray, name: str = "C1", half: float = HALF) -> ConeReference:
    cov = np.eye(3 * len(points)) * SIGMA_M**2
    return ConeReference(name=name, points_m=points, cov=cov, half_angle_rad=half, length_m=0.7)


def test_cones_of_all_directions_are_found_from_nothing():
    for seed in range(10):
        rng = np.random.default_rng([3, seed])
        true = cone_of(rng)
        points = marks(true, rng, around=2 * np.pi if seed % 2 else 3.0)
        found = start_cone(points, HALF)
        # the half angle is off by 0.17 degrees, 2 mm at the base
        assert np.median(np.abs(found.see(points).distance_m)) < 0.002
        assert found.axis @ true.axis > np.cos(np.deg2rad(3.0))


@pytest.mark.parametrize("share", [0.05, 0.15])
def test_wrong_marks_are_rejected_and_change_nothing(share):
    squares = []
    for seed in range(5):
        rng = np.random.default_rng([4, seed])
        true = cone_of(rng)
        points = marks(true, rng)
        clean = fit_reference(reference(points))
        wrong = rng.permutation(32)[: max(1, round(32 * share))]
        off = rng.choice([-1, 1], len(wrong)) * rng.uniform(0.01, 0.05, len(wrong))
        points[wrong] += off[:, None] * true.see(points[wrong]).normal
        found = fit_reference(reference(points))
        assert set(np.flatnonzero(~found.used)) == set(wrong)
        assert np.linalg.norm(found.cone.apex_m - clean.cone.apex_m) < 0.003
        squares.append(np.sum(true.see(points[found.used]).distance_m ** 2) / SIGMA_M**2)
    # all good marks stayed: their true distances are those of the noise
    n = 5 * (32 - max(1, round(32 * share)))
    assert sum(squares) < chi2.ppf(0.9999, n)


def test_correlated_marks_keep_their_covariance(rng):
    root = 1e-4 * rng.standard_normal((12, 12))
    whole = replace(reference(marks(cone_of(rng), rng, n=4)), cov=root @ root.T)
    largest = [np.linalg.eigvalsh(whole.cov[3 * i : 3 * i + 3, 3 * i : 3 * i + 3])[-1] for i in range(4)]
    np.testing.assert_allclose(whole.sigma_m**2, largest, rtol=1e-9)


def parameters_off(found: Cone, true: Cone) -> np.ndarray:
    across = found.tangents @ true.axis
    return np.r_[true.apex_m - found.apex_m, across, true.half_angle_rad - found.half_angle_rad]


def test_derivatives_by_the_points_are_those_of_the_fit(rng):
    """Every other point has three times the sigma; one point is not used. By differences of the fit."""
    points = marks(cone_of(rng), rng)
    points[3] += 0.05
    cov = np.diag(np.repeat(SIGMA_M * np.where(np.arange(32) % 2, 3.0, 1.0), 3) ** 2)
    found = fit_reference(replace(reference(points), cov=cov))
    assert not found.used[3]
    step = 1e-5 * rng.standard_normal((32, 3))
    ahead, back = (fit_reference(replace(reference(points + s * step), cov=cov)).cone for s in (1, -1))
    change = (parameters_off(found.cone, ahead) - parameters_off(found.cone, back)) / 2
    # 2 %: Gauss-Newton derivatives leave out residuals times curvature, 0.2 mm of 200 mm; sigmas of 1e-5 m
    sigma = np.sqrt(np.diag(found.by_points @ found.by_points.T)) * 1e-5
    assert np.abs(found.by_points @ step.ravel() - change) / sigma == pytest.approx(np.zeros(6), abs=0.02)


def test_a_fixed_half_angle_stays_and_has_no_covariance(rng):
    fixed = fit_reference(reference(marks(cone_of(rng), rng), half=HALF + 0.003), free_half_angle=False).cone
    assert fixed.half_angle_rad == HALF + 0.003
    assert np.all(fixed.cov[5] == 0)
    assert np.linalg.eigvalsh(fixed.cov[:5, :5])[0] > 0


# ---------------------------------------------------------------- bad input


def test_too_few_marks_are_told_with_the_cone(rng):
    with pytest.raises(GeometryError, match=r"cone C7: 5 reference points; expected at least 7"):
        fit_reference(reference(marks(cone_of(rng), rng, n=5), "C7"))


def test_marks_of_a_ball_are_no_cone(rng):
    ball = rng.standard_normal((32, 3))
    ball *= 0.4 / np.linalg.norm(ball, axis=1, keepdims=True)
    with pytest.raises(GeometryError, match=r"cone C3: .*marker numbers"):
        fit_reference(reference(ball, "C3"))


def test_half_of_the_markers_of_another_cone(rng):
    points = np.concatenate([marks(cone_of(rng), rng, n=16), marks(cone_of(rng), rng, n=16)])
    with pytest.raises(GeometryError, match="cone C2"):
        fit_reference(reference(points, "C2"))


@pytest.mark.parametrize("free", [True, False])
@pytest.mark.parametrize("times", [0.4, 1.3, 2.0])
def test_a_stated_opening_angle_that_does_not_fit(rng, times, free):
    points = marks(cone_of(rng), rng)
    with pytest.raises(GeometryError, match="half angle") as caught:
        fit_reference(reference(points, "C4", half=times * HALF), free_half_angle=free)
    assert "Check half_angle_deg of the cone" in caught.value.cure


def test_few_marks_tell_no_half_angle():
    """Seven lie on some cone whatever they are: on a part of it the angle is free, and no mistake."""
    off, missed = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        few = marks(cone_of(rng), rng, n=7, around=1.2)
        try:
            off.append(np.rad2deg(fit_reference(reference(few)).cone.half_angle_rad - HALF))
        except GeometryError as error:  # the start was too far off
            missed.append(str(error))
    assert len(off) >= 10
    assert not any("opening angle" in each for each in missed)
    assert np.max(np.abs(off)) > 3.0


def test_a_fixed_angle_may_not_put_half_of_the_points_out(rng):
    points = marks(cone_of(rng), rng, n=60)
    with pytest.raises(GeometryError, match="the opening angle does not fit"):
        fit_reference(reference(points, half=HALF + np.deg2rad(1.2)), free_half_angle=False)


def ring(cone: Cone, slants_m: list[float], n: int = 8) -> np.ndarray:
    """Points on the surface, ``n`` at each distance from the apex."""
    psi = np.linspace(0, 2 * np.pi, n, endpoint=False)
    return on_surface(cone, np.repeat(slants_m, n), np.tile(psi, len(slants_m)))


TRUE = Cone(apex_m=np.array([1.0, -2.0, 0.5]), axis=np.array([0.2, 0.1, 1.0]), half_angle_rad=HALF)


@pytest.mark.parametrize("robust", [True, False])
def test_steps_go_on_until_the_cone_is_met(robust):
    """From 2 cm, 2 degrees and 1 degree off to a cone without noise; no step more is needed at the end."""
    points = ring(TRUE, [0.3, 0.5, 0.7])
    start = TRUE.moved(np.array([0.02, -0.01, 0.015, 0.03, -0.02, 0.017]))
    sigma = np.full(len(points), 0.01)
    found = refine(start, points, sigma, free_half_angle=True, robust=robust)
    np.testing.assert_allclose(found.apex_m, TRUE.apex_m, atol=1e-8)
    np.testing.assert_allclose(found.axis, TRUE.axis, atol=1e-8)
    assert found.half_angle_rad == pytest.approx(HALF, abs=1e-8)
    held = refine(start, points, sigma, free_half_angle=False, robust=robust)
    assert held.half_angle_rad == start.half_angle_rad


def test_gross_points_have_no_part_in_a_robust_cone():
    """Three of 24 points are 20 sigmas off: beyond 4.685 sigmas their weight is zero."""
    points = ring(TRUE, [0.3, 0.5, 0.7])
    points[[2, 11, 17]] += 0.2 * TRUE.see(points[[2, 11, 17]]).normal
    start = TRUE.moved(np.array([0.005, 0.0, 0.0, 0.0, 0.0, 0.0]))
    sigma = np.full(len(points), 0.01)
    found = refine(start, points, sigma, free_half_angle=True)
    np.testing.assert_allclose(found.apex_m, TRUE.apex_m, atol=1e-6)
    plain = refine(start, points, sigma, free_half_angle=True, robust=False)
    assert np.linalg.norm(plain.apex_m - TRUE.apex_m) > 0.02


def test_the_loss_by_hand():
    """Points 0, 4.685 / 2, 4.685 and 9.37 sigmas off: 0, 1 - 0.75^3, 1 and 1; weights 1, 0.75^2, 0, 0."""
    points = ring(TRUE, [0.5], n=4)
    off = 4.685 * np.array([0.0, 0.5, 1.0, 2.0])
    points += 0.01 * off[:, None] * TRUE.see(points).normal
    sigma = np.full(4, 0.01)
    assert _cost(TRUE.see(points).distance_m / sigma, robust=True) == pytest.approx(1 - 0.75**3 + 1 + 1)
    assert _cost(TRUE.see(points).distance_m / sigma, robust=False) == pytest.approx(4.685**2 * 5.25)
    np.testing.assert_allclose(_weights(off, True), [1.0, 0.5625, 0.0, 0.0], atol=1e-15)
    assert _weights(off, False).tolist() == [1.0] * 4


def test_points_of_a_plane_do_not_open_a_cone_to_a_disc():
    """A disc is the limit of 90 degrees: steps stop before 1.5 rad, and a needle's before 0.01 rad."""
    flat, thin = (
        replace(TRUE, apex_m=np.zeros(3), axis=np.eye(3)[2], half_angle_rad=a) for a in (1.45, 0.02)
    )
    disc = ring(flat, [0.3, 0.5, 0.7]) * [1.0, 1.0, 0.0]
    opened = refine(flat, disc, np.full(24, 0.01), free_half_angle=True, robust=False)
    assert 1.45 < opened.half_angle_rad < 1.5
    line = np.column_stack([np.zeros((24, 2)), np.linspace(0.3, 0.7, 24)])
    assert 0.01 < refine(thin, line, np.full(24, 0.01), free_half_angle=True).half_angle_rad <= 0.02


def test_errors_of_points_and_of_the_form_by_hand():
    """One parameter from two points: by 2 along x of the first and by 3 along y of the second."""
    by_points = np.array([[2.0, 0.0, 0.0, 0.0, 3.0, 0.0]])
    own = np.diag([1e-6, 5.0, 5.0, 5.0, 4e-6, 5.0])
    assert parameter_cov(by_points, own, 0.0)[0, 0] == pytest.approx(4e-6 + 36e-6)
    together = own.copy()
    together[0, 4] = together[4, 0] = 1e-6
    assert parameter_cov(by_points, together, 0.0)[0, 0] == pytest.approx(40e-6 + 12e-6)
    assert parameter_cov(by_points, own, 1e-3)[0, 0] == pytest.approx(40e-6 + 13e-6)


def test_starts_look_into_all_directions():
    """40 directions: heights in equal steps, each a golden angle further."""
    d = _directions(40)
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1.0)
    np.testing.assert_allclose(d[:, 2], 1 - (2 * np.arange(40) + 1) / 40)
    turn = np.diff(np.unwrap(np.arctan2(d[:, 1], d[:, 0])))
    np.testing.assert_allclose(np.mod(turn, 2 * np.pi), np.mod(np.pi * (1 + np.sqrt(5.0)), 2 * np.pi))
    np.testing.assert_allclose(d.mean(axis=0), 0.0, atol=0.02)
