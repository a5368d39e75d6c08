"""The search of cones and boards near the nominal orientation: beams whose meetings are drawn by hand."""

import numpy as np
import pytest
from scipy.stats import norm

from thalweg.calibration import Cone, SearchRange
from thalweg.calibration.target_search import Targets, balance, normal_set, passing, search_targets
from thalweg.core import GeometryError, Rigid, exp_rotation

AT = Rigid(R=exp_rotation(np.array([0.3, -0.2, 1.0])), shift_m=np.array([4.0, -3.0, 1.0]))
MOUNT = Rigid(R=exp_rotation(np.array([1.2, 0.5, -0.4])), shift_m=np.array([0.3, -0.1, 0.2]))
POSE = AT @ MOUNT


def cone(length_m: float) -> Targets:
    """Upright, apex 2 m above the origin of pcs, 30 degrees."""
    apex, down = np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, -1.0])
    return Targets.cones([Cone(apex_m=apex, axis=down, half_angle_rad=np.pi / 6)], [length_m])


def met(scanner_m: np.ndarray, n: int, rng: np.random.Generator, lowest_m: float = 0.9) -> np.ndarray:
    """Points (n, 3) of the front of the cone, seen from a place: a beam enters at each."""
    depth, angle = rng.uniform(0.1, lowest_m, n), rng.uniform(-0.8, 0.8, n)
    angle += np.arctan2(scanner_m[1], scanner_m[0])
    radius = depth * np.tan(np.pi / 6)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), 2.0 - depth], axis=1)


def test_the_balance_counts_beams_that_met_and_that_went_through():
    """A point on the surface is one more, behind it one less, before it none; six centimetres count."""
    rng = np.random.default_rng(7)
    on = met(POSE.shift_m, 60, rng)
    ray = (on - POSE.shift_m) / np.linalg.norm(on - POSE.shift_m, axis=1, keepdims=True)
    along = np.repeat([0.0, 0.05, -0.05, 0.07, -0.07, 3.0], 10)
    # below the end of the cone, behind the scanner, and through its back alone
    aside = np.concatenate([met(POSE.shift_m, 20, rng, 0.1) - [0, 0, 1.2], 2 * POSE.shift_m - on[:10]])

    def of(targets: Targets, points: np.ndarray) -> float:
        return balance(targets, AT, POSE.inverse().apply(points), MOUNT)

    assert of(cone(1.0), np.concatenate([on + along[:, None] * ray, aside])) == pytest.approx((30 - 20) / 60)
    assert of(cone(1.0), on[:24]) == -1.0  # too few
    # a shorter cone ends above the lowest points
    assert 0 < (2.0 - on[:10, 2] <= 0.5).sum() < 10
    assert of(cone(0.5), np.concatenate([on[:10], np.repeat(on[on[:, 2] > 1.6][:1], 30, axis=0)])) == 1.0
    spheres = cone(1.5)
    np.testing.assert_allclose(spheres.centre, [[0.0, 0.0, 1.25]])
    np.testing.assert_allclose(spheres.radius_m, np.hypot(0.75, 1.5 * np.tan(np.pi / 6)))


def test_a_board_is_met_from_its_front_within_its_sides_in_its_own_scan():
    front = Rigid(R=exp_rotation(np.array([0.2, -0.3, 0.1])), shift_m=np.array([0.5, 0.2, 0.0]))
    pose = Rigid(R=exp_rotation(np.array([0.1, 0.2, 2.0])), shift_m=front.apply(np.array([0.3, -0.4, 3.0])))
    at = pose @ MOUNT.inverse()
    rng = np.random.default_rng(1)
    local = np.column_stack([rng.uniform(-0.7, 0.7, 200), rng.uniform(-0.5, 0.5, 200), np.zeros(200)])
    inside = (np.abs(local[:, 0]) < 0.4) & (np.abs(local[:, 1]) < 0.25)
    points = pose.inverse().apply(front.apply(local))
    targets = Targets.boards([front], np.array([[0.4, 0.25]]))
    np.testing.assert_allclose(targets.radius_m, [np.hypot(0.4, 0.25)])
    assert balance(targets, at, points, MOUNT) == 1.0
    through = points.copy()
    through[np.flatnonzero(inside)[:10]] *= 1.5
    n = inside.sum()
    assert balance(targets, at, through, MOUNT) == pytest.approx((n - 20) / n)
    facing_away = Rigid(R=front.R @ np.diag([1.0, -1, -1]), shift_m=front.shift_m)
    back = Targets.boards([facing_away], np.array([[0.4, 0.25]]))
    assert balance(back, at, points, MOUNT) == -1.0
    later = Targets.boards([front, front], np.array([[0.01, 0.01], [0.4, 0.25]]))
    assert balance(later, at, points, MOUNT) == -1.0, "the second board is in the second scan alone"
    assert len(later.near(1, points, pose, 0.0, 500)) > len(later.near(0, points, pose, 0.0, 500))


def test_beams_near_a_target_are_thinned_evenly():
    arm = -POSE.shift_m
    beam = np.array([arm, -arm, arm + np.array([0.0, 0.0, 3.0])])
    beam /= np.linalg.norm(beam, axis=1, keepdims=True)
    miss = np.linalg.norm(np.cross(beam[2], arm))
    assert passing(np.zeros(3), miss * 1.01, POSE.shift_m, beam).tolist() == [0, 2]
    assert passing(np.zeros(3), miss * 0.99, POSE.shift_m, beam).tolist() == [0]
    points = POSE.inverse().apply(met(POSE.shift_m, 101, np.random.default_rng(2)))
    for most, kept in ((101, points), (5, points[::25])):
        np.testing.assert_array_equal(cone(1.0).near(0, points, POSE, 0.0, most), kept)


def test_tries_fill_a_normal_distribution_and_begin_with_the_sequence_of_roberts():
    tries = normal_set(4000)
    base = np.roots([1, 0, 0, 0, 0, 0, -1, -1])
    ratio = float(base[np.isreal(base)].real[0])
    uniform = np.mod(0.5 + 3 * ratio ** -np.arange(1.0, 7.0), 1)
    np.testing.assert_allclose(tries[2], norm.ppf(0.0228 + uniform * (1 - 0.0456)), atol=1e-9)
    assert np.abs(tries).max() < 2.0
    np.testing.assert_allclose(tries.mean(axis=0), 0, atol=0.01)
    # of a normal distribution that is cut at two sigmas
    np.testing.assert_allclose(
        tries.std(axis=0), np.sqrt(1 - 4 * norm.pdf(2) / (1 - 2 * norm.sf(2))), rtol=0.01
    )
    np.testing.assert_allclose(np.corrcoef(tries.T), np.eye(6), atol=0.05)
    within = SearchRange(shift_m=0.3, angle_deg=6.0)
    np.testing.assert_allclose(within.sigmas, [0.3] * 3 + [np.deg2rad(6.0)] * 3)


def test_the_search_finds_a_scanner_that_no_noise_hides():
    """Four boards, each in a scan: to 5 mm and a tenth of a degree, of 8 cm and 3 degrees."""
    rng = np.random.default_rng(3)
    poses, at, scans = [], [], []
    for k in range(4):
        view = Rigid(R=exp_rotation(rng.normal(0, 0.3, 3)), shift_m=np.array([0.5 * k - 1, 0.3 * k, 4.0]))
        facing = Rigid(R=view.R @ np.diag([1.0, -1.0, -1.0]), shift_m=view.shift_m)
        local = np.column_stack([rng.uniform(-0.5, 0.5, (200, 2)), np.zeros(200)])
        poses.append(facing)
        at.append(Rigid(R=np.eye(3), shift_m=np.zeros(3)))
        scans.append(MOUNT.inverse().apply(facing.apply(local)))
    targets = Targets.boards(poses, np.full((4, 2), 0.5))
    nominal = MOUNT.moved([0.08, -0.06, 0.05, 0.03, -0.04, 0.02])
    found = search_targets(
        targets, at, scans, nominal, SearchRange(shift_m=0.1, angle_deg=3.0, tries=100), what="board"
    )
    error = found.T_ccs_scs.error_from(MOUNT)
    assert np.abs(error[:3]).max() < 5e-3
    assert np.abs(np.rad2deg(error[3:])).max() < 0.1
    assert 0.95 < found.score <= 1.0
    assert 0.9 * 800 < found.beams <= 800
    # along a single board nothing is seen: there the nominal orientation stays
    within = SearchRange(shift_m=0.1, angle_deg=3.0, tries=0)
    alone = search_targets(
        Targets.boards(poses[:1], np.full((1, 2), 0.5)), at[:1], scans[:1], nominal, within
    )
    moved = alone.T_ccs_scs.error_from(nominal)
    assert 0.01 < np.abs(moved @ np.r_[poses[0].R[:, 2], np.zeros(3)]) < 0.2
    assert np.abs(moved[:3] @ poses[0].R[:, :2]).max() < 0.01
    with pytest.raises(GeometryError, match="no beam of the lidar passes near a board"):
        search_targets(
            targets, at, [-s for s in scans], MOUNT, SearchRange(shift_m=0.01, angle_deg=0.1), what="board"
        )
