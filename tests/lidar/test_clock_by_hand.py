"""Sigma of the lidar's clock: what the attitudes add, and that copies of a point tell nothing new."""

from types import SimpleNamespace

import numpy as np
import pytest

from thalweg.lidar import clock
from thalweg.lidar.clock import PAIR_S, STEP_S, LidarOffset, Turns, _covariance, fine_offset, rough_offset

TRUE_S = 0.02


def adjusted(monkeypatch: pytest.MonkeyPatch, *, copies: int, by_attitude_s: float) -> LidarOffset:
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


def test_twice_as_many_dependent_points_leave_the_sigma_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    one, two = (adjusted(monkeypatch, copies=n, by_attitude_s=0.0) for n in (1, 2))
    assert one.offset_s == pytest.approx(TRUE_S, abs=5 * one.sigma_offset_s)
    for name in ("offset_s", "sigma_offset_s", "sigma_drift"):
        assert getattr(two, name) == pytest.approx(getattr(one, name), rel=1e-6), name


def test_the_share_of_the_attitudes_adds_in_squares(monkeypatch: pytest.MonkeyPatch) -> None:
    """To the offset as it is, to the drift as the slope of even values over the span."""
    without, with_it = (adjusted(monkeypatch, copies=1, by_attitude_s=s) for s in (0.0, 1e-4))
    assert with_it.sigma_offset_s == pytest.approx(np.hypot(without.sigma_offset_s, 1e-4))
    span_s = 19.9
    by_slope = np.sqrt(12.0) * 1e-4 / span_s
    assert with_it.sigma_drift == pytest.approx(min(50e-6, np.hypot(without.sigma_drift, by_slope)))
    assert with_it.facts["sigma_by_attitudes_s"] == 1e-4


def test_scores_of_one_moment_are_one_observation() -> None:
    """Twice the points double weight and scores: the covariance stays; moments that differ add."""
    rng = np.random.default_rng(6)
    t = np.repeat(np.arange(0.0, 60.0, 5.0) + 0.05, 3)  # farther apart than errors last
    scores = rng.normal(size=(len(t), 8))
    H, none = 5.0 * np.eye(8), np.zeros((8, 8))
    once = _covariance(H, scores, t, none)
    assert _covariance(2 * H, np.repeat(scores, 2, axis=0), np.repeat(t, 2), none) == pytest.approx(once)
    sums = scores.reshape(-1, 3, 8).sum(axis=1)
    assert once == pytest.approx(sums.T @ sums / 25.0)


def test_scores_of_neighbours_count_by_how_near_they_are() -> None:
    """Newey and West: lag j of L counts by 1 - j / (L + 1), on both sides."""
    t = np.array([0.05, 0.05 + 3 * STEP_S])
    scores = np.zeros((2, 8))
    scores[:, 0] = 2.0, 5.0
    found = _covariance(np.eye(8), scores, t, np.zeros((8, 8)))
    lags = round(clock.CORRELATED_S / STEP_S)
    assert found[0, 0] == pytest.approx(4.0 + 25.0 + 2 * 10.0 * (1 - 3 / (lags + 1)))


def test_pairs_of_sweeps_that_overlap_are_no_new_observations(monkeypatch: pytest.MonkeyPatch) -> None:
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
