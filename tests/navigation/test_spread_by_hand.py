"""Noise of a step, and the law of total covariance where sizes of errors are known roughly: by hand."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm

from thalweg.navigation.fusion import FusionSettings, errors
from thalweg.navigation.fusion.errors import spread_over
from thalweg.navigation.fusion.model import GROUPS, INS, MODEL, RESET, pair_transition


@dataclass
class Solved:
    """What a smoother leaves of two nodes with three states, two of them of the pose."""

    x: np.ndarray
    cov: np.ndarray
    cross: np.ndarray
    last: np.ndarray


def test_covariances_count_the_mean_of_all_and_their_scatter(monkeypatch):
    """Cov = E[cov] + E[d d'], also between neighbours and of the last state; the states stay."""
    rng = np.random.default_rng(4)
    best = Solved(rng.normal(size=(2, 3)), np.zeros((2, 2, 2)), np.zeros((2, 2, 2)), np.zeros((3, 3)))
    draws = [Solved(*(rng.normal(size=s) for s in ((2, 3), (2, 2, 2), (2, 2, 2), (3, 3)))) for _ in range(4)]
    for each in draws:
        each.cross[-1] = 0.0  # the last node has no neighbour
    found = iter(draws)
    monkeypatch.setattr(errors, "smooth", lambda *_, **__: next(found))
    monkeypatch.setattr(errors, "linearised", lambda *_: None)
    monkeypatch.setattr(errors, "first_offset", lambda *_: None)
    monkeypatch.setattr(errors, "applied", lambda *_: (None, None))
    model = SimpleNamespace(points=lambda: iter(range(4)), values=lambda h: h)
    task = (SimpleNamespace(at=lambda t: t), SimpleNamespace(t_gps_s=np.zeros(2)), None, best, None, None)
    out = spread_over(model, *task, clock_start_s=0.0, part=2)
    away = np.array([d.x - best.x for d in draws])
    for k in range(2):
        scatter = np.mean([np.outer(a[k, :2], a[k, :2]) for a in away], axis=0)
        assert out.cov[k] == pytest.approx(np.mean([d.cov[k] for d in draws], axis=0) + scatter)
    both = np.mean([np.outer(a[0, :2], a[1, :2]) for a in away], axis=0)
    assert out.cross[0] == pytest.approx(np.mean([d.cross[0] for d in draws], axis=0) + both)
    assert out.cross[1] == pytest.approx(0.0)
    end = np.mean([np.outer(a[1], a[1]) for a in away], axis=0)
    assert out.last == pytest.approx(np.mean([d.last for d in draws], axis=0) + end)
    assert out.x is best.x


# ---------------------------------------------------------------- transitions


def exact_noise(T, rate, density):
    """Transition and noise of d' = e, e' = -rate e + white noise, by the matrix exponential of Van Loan."""
    A = np.array([[0.0, 1.0], [0.0, -rate]])
    block = np.zeros((4, 4))
    block[:2, :2], block[:2, 2:], block[2:, 2:] = -A, np.diag([0.0, density]), A.T
    found = expm(block * T)
    phi = found[2:, 2:].T
    return phi, phi @ found[:2, 2:]


@pytest.mark.parametrize(
    ("T", "rel"),
    # at 0.0599 s the fourth term of the series is a millionth of the first
    [(0.001, 1e-6), (0.0599, 1e-7), (0.0601, 1e-7), (0.3, 1e-6), (4.0, 1e-6), (60.0, 1e-6)],
)
def test_the_noise_of_a_step_is_that_of_the_process(T, rel):
    """Along the INS an integrated Gauss-Markov process, without it a random walk of the velocity."""
    settings = FusionSettings(velocity_time_s=3.0, sigma_velocity_mps=0.05, sigma_acceleration=0.4)
    factors = dict.fromkeys(GROUPS, 1.0) | {"velocity": 2.0, "acceleration": 0.5}
    found = pair_transition(np.full(3, T), np.array([INS, MODEL, RESET]), settings, factors)
    for row, rate, density in ((0, 1 / 3.0, 2 * 0.1**2 / 3.0), (1, 0.0, 0.2**2)):
        phi, Q = exact_noise(T, rate, density)
        expected = [phi[0, 1], phi[1, 1], Q[0, 0], Q[0, 1], Q[1, 1]]
        assert found[row] == pytest.approx(expected, rel=rel, abs=0.0)
    assert found[2] == pytest.approx([0.0, 0.0, 0.0, 0.0, 0.1**2])
