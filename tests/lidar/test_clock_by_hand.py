"""Sigma of the lidar's clock: what the attitudes add, and that copies of a point tell nothing new."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tests.core.conftest import trajectory_of
from thalweg.core import Rigid
from thalweg.lidar import clock
from thalweg.lidar.clock import PAIR_S, STEP_S, Turns, _covariance, fine_offset, rough_offset
from thalweg.settings.sections import Filters

TRUE_S = 0.02


def adjusted(monkeypatch, *, copies, by_attitude_s):
    """200 moments of ten points on planes; each point as often as asked for."""
    rng = np.random.default_rng(5)
    t = np.repeat(np.arange(200) * STEP_S + 0.05, 10)
    J = rng.normal(size=(len(t), 7))
    noise = 0.02 * rng.standard_normal(len(t))

    def rows(points, trajectory, mount, filters, late_s):
        """Distances from planes where the clock is ``late_s`` (n,) late."""
        d = noise + J[:, 0] * (late_s[0] - TRUE_S)
        return np.tile(d, copies), np.tile(J, (copies, 1)), np.tile(t, copies), 100

    monkeypatch.setattr(clock, "_device_points", lambda *_: [np.column_stack([np.zeros((len(t), 3)), t])])
    monkeypatch.setattr(clock, "_rows", rows)
    monkeypatch.setattr(clock, "attitude_share_s", lambda *_: by_attitude_s)
    mount = SimpleNamespace(cov=1e-12 * np.eye(6))
    return fine_offset(None, None, None, mount, None, ends_s=(0.0, 20.0), rough_s=0.0)


def test_twice_as_many_dependent_points_leave_the_sigma_as_it_is(monkeypatch):
    one, two = (adjusted(monkeypatch, copies=n, by_attitude_s=0.0) for n in (1, 2))
    assert one.offset_s == pytest.approx(TRUE_S, abs=5 * one.sigma_offset_s)
    for name in ("offset_s", "sigma_offset_s", "sigma_drift"):
        assert getattr(two, name) == pytest.approx(getattr(one, name), rel=1e-6), name


def test_the_share_of_the_attitudes_adds_in_squares(monkeypatch):
    """To the offset as it is, to the drift as the slope of even values over the span."""
    without, with_it = (adjusted(monkeypatch, copies=1, by_attitude_s=s) for s in (0.0, 1e-4))
    assert with_it.sigma_offset_s == pytest.approx(np.hypot(without.sigma_offset_s, 1e-4))
    span_s = 19.9
    by_slope = np.sqrt(12.0) * 1e-4 / span_s
    assert with_it.sigma_drift == pytest.approx(min(50e-6, np.hypot(without.sigma_drift, by_slope)))
    assert with_it.facts["sigma_by_attitudes_s"] == 1e-4


def test_scores_of_one_moment_are_one_observation():
    """Twice the points double weight and scores: the covariance stays; moments that differ add."""
    rng = np.random.default_rng(6)
    t = np.repeat(np.arange(0.0, 60.0, 5.0) + 0.05, 3)  # farther apart than errors last
    scores = rng.normal(size=(len(t), 8))
    H, none = 5.0 * np.eye(8), np.zeros((8, 8))
    once = _covariance(H, scores, t, none)
    assert _covariance(2 * H, np.repeat(scores, 2, axis=0), np.repeat(t, 2), none) == pytest.approx(once)
    sums = scores.reshape(-1, 3, 8).sum(axis=1)
    assert once == pytest.approx(sums.T @ sums / 25.0)


def test_scores_of_neighbours_count_by_how_near_they_are():
    """Newey and West: lag j of L counts by 1 - j / (L + 1), on both sides."""
    t = np.array([0.05, 0.05 + 3 * STEP_S])
    scores = np.zeros((2, 8))
    scores[:, 0] = 2.0, 5.0
    found = _covariance(np.eye(8), scores, t, np.zeros((8, 8)))
    lags = round(clock.CORRELATED_S / STEP_S)
    assert found[0, 0] == pytest.approx(4.0 + 25.0 + 2 * 10.0 * (1 - 3 / (lags + 1)))


def test_pairs_of_sweeps_that_overlap_are_no_new_observations(monkeypatch):
    """A misfit of 1.21 beside 1: sqrt(0.21 n), with n the pairs that share no time."""
    n = 900
    t = np.tile(np.arange(n)[:, None] * STEP_S, 3)
    info = np.tile(np.eye(3), (n, 1, 1))
    turns = Turns(phi_rad=np.zeros((n, 3)), info=info, first_s=t, second_s=t + PAIR_S)
    theta = SimpleNamespace(t_s=np.array([100.0, 250.0]), theta_rad=np.zeros((2, 3)))
    monkeypatch.setattr(clock._Theta, "of", lambda _: theta)
    monkeypatch.setattr(clock, "replace", lambda of, **_: of)
    best = 120.0
    monkeypatch.setattr(clock, "_misfit", lambda _t, _o, _w, s: 1.0 if abs(s - best) < 0.3 else 1.21)
    found, facts = rough_offset(turns, None, np.eye(3), near_s=best, search_s=5.0)
    assert found == pytest.approx(best, abs=0.35)
    assert facts["better_than_the_next_by_sigmas"] == pytest.approx(np.sqrt(0.21 * n * STEP_S / PAIR_S))


def turning(rates, valid):
    """Nodes each 0.1 s of a boat that turns by so many radians a second about its own axes."""
    t = 0.1 * np.arange(len(valid))
    steps = Rotation.from_rotvec(np.tile(0.1 * np.array(rates), (len(t) - 1, 1)))
    R = [Rotation.identity()]
    for step in steps:
        R.append(R[-1] * step)
    return trajectory_of(t, attitude=Rotation.concatenate(R), valid=valid)


def test_turns_of_the_body_are_summed_and_gaps_counted():
    valid = [True] * 4 + [False] + [True] * 6
    theta = clock._Theta.of(turning((0.3, -0.2, 0.1), valid))
    assert theta.t_s == pytest.approx(np.delete(0.1 * np.arange(11), 4))
    assert theta.theta_rad == pytest.approx(theta.t_s[:, None] * [0.3, -0.2, 0.1])
    assert theta.gaps.tolist() == [0, 0, 0, 0, 1, 1, 1, 1, 1, 1]
    # each component has times of its own
    first, second = np.array([[0.05, 0.1, 0.15]]), np.array([[0.25, 0.2, 0.95]])
    assert theta.between(first, second) == pytest.approx(np.array([[0.06, -0.02, 0.08]]))
    starts, ends = np.array([0.0, 0.05, 0.05, 0.55, 0.55]), np.array([0.2, 0.2, 0.6, 0.9, 1.0])
    assert theta.covers(starts, ends).tolist() == [False, True, False, True, False]


def test_what_a_trajectory_leaves_unexplained_by_hand():
    """A constant part of each component counts for nothing; rows with no poses are left out, to a fifth."""
    theta = clock._Theta.of(turning((0.3, -0.2, 0.1), [True] * 11))
    start = np.array([0.05, 0.1, 0.15, 0.2, 0.7])
    first, second = np.tile(start[:, None], 3), np.tile(start[:, None] + 0.2, 3)
    wobble = np.array([[1.0, 2.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 3.0], [0.0, 1.0, 0.0], [9.0, 9.0, 9.0]])
    phi = np.array([0.06, -0.04, 0.02]) + 0.01 * wobble
    info = np.tile(np.diag([1.0, 2.0, 4.0]), (5, 1, 1))
    turns = Turns(phi_rad=phi, info=info, first_s=first - 5.0, second_s=second - 5.0)
    weight = np.diagonal(info, axis1=1, axis2=2)
    off = 0.01 * (wobble[:4] - wobble[:4].mean(axis=0))
    expected = np.sum(off**2 * [1.0, 2.0, 4.0]) / (4 * 7)
    # 0.15 s later the last pair ends after the last node
    assert clock._misfit(turns, theta, weight, 5.15) == pytest.approx(expected)
    assert np.isnan(clock._misfit(turns, theta, weight, 5.75))


def test_surroundings_that_are_plane_are_surfaces():
    rng = np.random.default_rng(2)
    flat = np.column_stack([rng.uniform(0, 4, (400, 2)), 0.01 * rng.standard_normal(400)])
    _, normal, plane = clock._normals(flat)
    assert plane.mean() > 0.95
    assert np.abs(normal[plane][:, 2]).min() > 0.99
    assert not clock._normals(rng.uniform(0, 4, (400, 3)))[2].mean() > 0.2  # a bush
    line = np.column_stack([np.linspace(0, 4, 400), 1e-4 * rng.standard_normal((400, 2))])
    assert not clock._normals(line)[2].any()
    assert not clock._normals(20.0 * flat)[2].any()  # neighbours metres away
    assert not clock._normals(flat[: clock._FEWEST_POINTS - 1])[2].any()


def test_rows_are_what_a_wrong_time_and_mount_do_to_distances_from_planes():
    """A boat that drives and turns before plane spots; late by 2 ms, its mount turned and moved."""
    trajectory, spots = spots_seen_again()
    mount = Rigid(
        R=Rotation.from_euler("z", 30.0, degrees=True).as_matrix(), shift_m=np.array([0.4, -0.2, 0.1])
    )
    points = scanned(spots, trajectory, mount)
    filters = Filters(below_water_m=None)

    def distances(late_s, mount):
        d, J, _, n = clock._rows(points, trajectory, mount, filters, np.full(len(points), late_s))
        assert n == len(spots)
        assert len(d) == len(points)
        return d, J

    base, J = distances(0.0, mount)
    assert np.abs(base).max() < 1e-6
    late, _ = distances(0.002, mount)
    assert_allclose(late, 0.002 * J[:, 0], atol=0.05 * np.abs(late).max())
    for k, axis in enumerate(np.eye(3)):
        turned = replace(mount, R=Rotation.from_rotvec(1e-3 * axis).as_matrix() @ mount.R)
        moved = replace(mount, shift_m=mount.shift_m + 1e-3 * axis)
        for column, other in ((1 + k, turned), (4 + k, moved)):
            d, _ = distances(0.0, other)
            assert_allclose(d, 1e-3 * J[:, column], atol=0.05 * np.abs(1e-3 * J[:, column]).max())


def spots_seen_again():
    """Ten seconds of a boat that drives east and swings; centres and normals of spots within cells."""
    t = np.arange(0.0, 10.05, 0.05)
    swinging = Rotation.from_euler("zx", np.stack([0.5 * np.sin(t), 0.1 * np.sin(2 * t)], axis=1))
    trajectory = trajectory_of(t, np.stack([0.8 * t, 0.3 * np.sin(t), 0 * t], axis=1), swinging)
    rng = np.random.default_rng(4)
    normals = rng.normal(size=(12, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return trajectory, [(np.array([k + 0.25, 8.25, 1.25 + k % 3]), n) for k, n in enumerate(normals)]


def scanned(spots, trajectory, mount):
    """Points (n, 4) in the scanner's frame and their times, 40 of each spot."""
    rng = np.random.default_rng(6)
    centre, normal = (np.repeat([spot[k] for spot in spots], 40, axis=0) for k in (0, 1))
    # on a square of 0.34 m, which every turn keeps within the cell
    axis = np.cross(normal, rng.normal(size=normal.shape))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    u, v = 0.17 * rng.choice([-1.0, 1.0], (2, len(centre), 1))
    x = centre + u * axis + v * np.cross(normal, axis)
    t = rng.uniform(0.5, 9.5, len(x))
    position, R, _ = trajectory.at(t)
    body = np.einsum("nji,nj->ni", R, x - position)
    return np.column_stack([(body - mount.shift_m) @ mount.R, t])
