"""Which beams of a scan take part: outline, ends, incidence, and what stands in the way."""

import numpy as np
import pytest

from tests.calibration.cone_yard import scanned
from thalweg.calibration import Cone, Selection, SelectionLimits, Verdict, select
from thalweg.core import Rigid

CONE = Cone(
    apex_m=np.array([-0.2, 5.0, 0.1]), axis=np.array([0.8, 0.6, 0.0]), half_angle_rad=np.deg2rad(25.0)
)
LENGTH_M = 0.7
SIGMA_M = 0.01
HERE = Rigid(R=np.eye(3), shift_m=np.zeros(3))


def beams() -> np.ndarray:
    x, z = np.meshgrid(np.linspace(-0.8, 1.2, 161), np.linspace(-0.6, 0.7, 105))
    d = np.stack([x.ravel(), np.full(x.size, 5.0), z.ravel()], axis=1)
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def selected(
    change=lambda r, d: r, factor: float = 1.0, **limits
) -> tuple[Selection, np.ndarray, np.ndarray]:
    """Points where beams meet the cone, or at 9 m; ``change`` puts other things in their way."""
    d = beams()
    met = CONE.meet(np.zeros(3), d)
    on = met.hit & (met.slant_m < LENGTH_M / np.cos(CONE.half_angle_rad))
    r = change(np.where(on, met.range_m, 9.0), d)
    scan = scanned("p", HERE, d * r[:, None], SIGMA_M)
    found = select([CONE], [LENGTH_M], HERE, scan, SelectionLimits(**limits), variance_factor=factor)
    return found, d, on


def test_all_beams_that_meet_the_cone_have_a_verdict():
    found, d, on = selected()
    np.testing.assert_array_equal(found.cone >= 0, on)
    np.testing.assert_array_equal(found.verdict != Verdict.AWAY, on)
    assert sum(found.counts(0).values()) == on.sum()
    used = found.rows(0)
    assert len(used) > 0.3 * on.sum()
    assert np.isfinite(found.variance_m2[used]).all()
    met = CONE.meet(np.zeros(3), d[used])
    # three sigmas inside the outline, 65 degrees of incidence at most
    assert met.depth_m.min() >= 3 * SIGMA_M
    assert met.cosine.min() >= np.cos(np.deg2rad(65.0))
    end = LENGTH_M / np.cos(CONE.half_angle_rad) - met.slant_m.max()
    assert 3 * SIGMA_M <= end < 6 * SIGMA_M


def test_margins_follow_the_noise_not_the_measured_points(rng):
    plain, _, _ = selected()
    noisy, _, _ = selected(lambda r, d: r + SIGMA_M * rng.standard_normal(len(r)))
    nominal = [Verdict.GRAZING, Verdict.OUTLINE, Verdict.END]
    np.testing.assert_array_equal(np.isin(plain.verdict, nominal), np.isin(noisy.verdict, nominal))
    wide, _, _ = selected(margin_sigmas=6.0)
    assert set(wide.rows(0)) < set(plain.rows(0))


def test_points_before_and_behind_are_told_apart():
    far, _, _ = selected(lambda r, d: np.full(len(r), 9.0))
    assert far.counts(0)[Verdict.USED] == 0
    assert far.counts(0)[Verdict.BEHIND] > 1000
    near, _, _ = selected(lambda r, d: np.full(len(r), 3.0))
    assert near.counts(0)[Verdict.IN_FRONT] == far.counts(0)[Verdict.BEHIND]


def test_beams_beside_an_obstacle_are_left_out():
    """Those that err toward it are missing, so the mean of the others is biased."""

    def post(r: np.ndarray, d: np.ndarray) -> np.ndarray:
        return np.where(np.abs(d[:, 0] / d[:, 1] - 0.03) < 0.01, 2.0, r)

    plain, d, _ = selected()
    found, _, _ = selected(post)
    lost = np.setdiff1d(plain.rows(0), found.rows(0))
    front, beside = (found.rows(0, v) for v in (Verdict.IN_FRONT, Verdict.BESIDE))
    assert set(lost) == set(front) | set(beside)
    assert len(beside) > 50
    # sideways at 5 m: the post is 10 cm wide there, and 3 sigmas are 3 cm, to the spacing of the beams
    aside = np.abs(5 * (d[:, 0] / d[:, 1] - 0.03))
    assert aside[beside].max() < 0.05 + 0.03 + 0.0125
    assert aside[found.rows(0)].min() > 0.05 + 0.03 - 0.0125


def test_slack_lets_a_cone_be_roughly_known():
    def moved(r: np.ndarray, d: np.ndarray) -> np.ndarray:
        return r + 0.06

    whole = len(selected()[0].rows(0))
    # the ranges of grazing beams scatter more
    assert len(selected(moved)[0].rows(0)) < 0.2 * whole
    assert len(selected(moved, slack_m=0.05)[0].rows(0)) == whole


def test_the_nearer_of_two_cones_is_met():
    behind = CONE.moved(np.array([0, 1.5, 0, 0, 0, 0]))
    d = beams()
    scan = scanned("p", HERE, 5 * d, SIGMA_M)
    for order, near in (((CONE, behind), 0), ((behind, CONE), 1)):
        found = select(order, [LENGTH_M] * 2, HERE, scan, SelectionLimits())
        both = (CONE.meet(np.zeros(3), d).slant_m < 0.7) & (behind.meet(np.zeros(3), d).slant_m < 0.7)
        assert both.sum() > 100
        assert (found.cone[both] == near).all()


@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_the_variance_factor_scales_all_margins(factor):
    found, d, _ = selected(factor=factor)
    depth = CONE.meet(np.zeros(3), d[found.rows(0)]).depth_m
    assert depth.min() == pytest.approx(3 * SIGMA_M * np.sqrt(factor), abs=0.01)
