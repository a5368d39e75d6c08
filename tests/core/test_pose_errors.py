"""Chains of errors of poses: interpolation, thinning, what lies between the nodes, files."""

from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tests.core.conftest import trajectory_of
from thalweg.core import (
    ErrorChain,
    GeometryError,
    InputError,
    even_time,
    read_chains,
    symmetric_roots,
    with_rest,
    write_chains,
)

T0 = 1e9


def random_walk(m, rng):
    """Covariance (m, 7, m, 7) of m states of a chain of seven, each with the one before, and their own."""
    root = rng.standard_normal((m, 7, 7))
    full = np.zeros((m, 7, m, 7))
    full[0, :, 0] = root[0] @ root[0].T
    for k in range(1, m):
        F = 0.5 * rng.standard_normal((7, 7))
        for i in range(k):
            full[k, :, i] = F @ full[k - 1, :, i]
            full[i, :, k] = full[k, :, i].T
        full[k, :, k] = F @ full[k - 1, :, k - 1] @ F.T + root[k] @ root[k].T
    own = np.array([full[k, :, k] for k in range(m)])
    following = np.array([full[k, :, min(k + 1, m - 1)] for k in range(m)])
    return full, own, following


@pytest.mark.parametrize("at_once", [2000, 4])
def test_a_thinned_chain_keeps_the_covariance_of_any_two_nodes(at_once, monkeypatch):
    monkeypatch.setattr("thalweg.core.pose_errors._AT_ONCE", at_once)
    rng = np.random.default_rng(1)
    full, own, following = random_walk(12, rng)
    pose = rng.standard_normal((12, 6, 5))  # by the first five of seven states
    t = T0 + 0.1 * np.arange(12)
    chain = ErrorChain.of_covariances("states", t, own, following, pose, step_s=0.25)
    kept = np.array([0, 3, 6, 9, 11])
    assert chain.t_gps_s == pytest.approx(t[kept], abs=1e-6)
    for (a, i), (b, k) in combinations_with_replacement(enumerate(kept), 2):
        expected = pose[k] @ full[k, :5, i, :5] @ pose[i].T
        assert between(chain, a, b) == pytest.approx(expected, rel=1e-6, abs=1e-9 * np.abs(full).max())


def a_trajectory(cov):
    """Ten seconds at 20 Hz, turning; covariances (201, 6, 6)."""
    s = np.linspace(0.0, 10.0, 201)
    turning = Rotation.from_euler("z", 10.0 * s[:, None], degrees=True)
    return trajectory_of(T0 + s, np.outer(s, [1.0, 0.0, 0.0]), turning, cov)


def chain_of(t, root, link, name="all"):
    """A chain whose root and link, given once, are those of all its nodes."""
    n = len(t)
    root, link = (np.tile(each, (n, 1, 1)) if each.ndim == 2 else each for each in (root, link))
    return ErrorChain(name=name, t_gps_s=t, root=root, link=link)


def between(chain, i, k):
    """Covariance of the errors of node k with those of an earlier node i."""
    link = np.eye(chain.link.shape[1])
    for j in range(i + 1, k + 1):
        link = chain.link[j] @ link
    return chain.root[k] @ link @ chain.root[i].T


def test_the_rest_is_what_grows_and_shrinks_between_fixed_times():
    """Known at every second, and a Brownian bridge of 0.01 m^2/s between."""
    since = np.linspace(0.0, 10.0, 201) % 1.0
    cov = np.tile(np.diag([4e-4, 4e-4, 4e-4, 1e-6, 1e-6, 1e-6]), (201, 1, 1))
    cov[:, 2, 2] += 0.01 * since * (1.0 - since)
    t = T0 + np.arange(11.0)
    known = chain_of(t, np.sqrt(cov[0]), np.eye(6), "known")
    trajectory = a_trajectory(cov)
    chains = with_rest(trajectory, [known], t, step_s=0.05)
    assert [chain.name for chain in chains] == ["known", "between the nodes"]
    rest = chains[1]
    at = T0 + np.array([3.0, 3.25, 3.5, 4.0])
    assert rest.covariance_at(at)[:, 2, 2] == pytest.approx([0.0, 0.001875, 0.0025, 0.0], abs=2e-6)
    i, k = (int(np.argmin(np.abs(rest.t_gps_s - T0 - s))) for s in (3.25, 3.5))
    assert between(rest, i, k)[2, 2] == pytest.approx(0.01 * 0.25 * 0.5, rel=1e-3)  # s (T - t) / T
    after = int(np.argmin(np.abs(rest.t_gps_s - T0 - 4.5)))
    assert not between(rest, k, after).any()  # nothing is left from one gap to the next
    # where the chains say all, there is no rest
    assert with_rest(a_trajectory(np.tile(cov[0], (201, 1, 1))), [known], t, step_s=0.05) == [known]


def test_roots_of_mixed_units_have_their_covariance_and_keep_to_their_axes():
    rng = np.random.default_rng(3)
    R = Rotation.from_euler("z", np.linspace(0.0, 360.0, 50)[:, None], degrees=True).as_matrix()
    axes = np.zeros((50, 6, 6))
    axes[:, :3, :3] = axes[:, 3:, 3:] = R
    body = rng.standard_normal((6, 6)) * np.array([[0.02] * 3 + [1e-4] * 3]).T
    cov = axes @ (body @ body.T) @ np.swapaxes(axes, 1, 2)
    root = symmetric_roots(cov, axes)
    assert root @ np.swapaxes(root, 1, 2) == pytest.approx(cov, rel=1e-6, abs=1e-14)
    own = np.swapaxes(axes, 1, 2) @ root
    assert own == pytest.approx(np.broadcast_to(own[0], own.shape), rel=1e-6, abs=1e-10)
    # the same errors in millimetres and milliradians have the same root in these
    unit = np.array([1e3] * 6)
    unit[3:] *= 17.0
    finer = symmetric_roots(cov * np.outer(unit, unit), axes)
    assert finer == pytest.approx(unit[:, None] * root, rel=1e-6, abs=1e-9)


def test_chains_are_read_as_they_were_written(tmp_path):
    rng = np.random.default_rng(4)
    chains = [
        chain_of(T0 + np.arange(float(m)), rng.normal(size=(m, 6, d)), rng.normal(size=(m, d, d)), name)
        for name, m, d in (("images", 4, 6), ("clock", 3, 1))
    ]
    write_chains(tmp_path / "errors.npz", chains)
    again = read_chains(tmp_path / "errors.npz")
    for one, two in zip(chains, again, strict=True):
        assert one.name == two.name
        assert (one.t_gps_s == two.t_gps_s).all()
        assert two.root == pytest.approx(one.root, rel=1e-6)
        assert two.link == pytest.approx(one.link, rel=1e-6)
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    with pytest.raises(InputError, match="no errors of poses"):
        read_chains(tmp_path / "other.npz")


def test_chains_that_are_none_are_refused():
    root, link = np.zeros((2, 6, 1)), np.zeros((2, 1, 1))
    with pytest.raises(GeometryError, match="times that go back"):
        chain_of(np.array([1.0, 0.0]), root, link)
    with pytest.raises(GeometryError, match=r"2 times, roots \(1, 6, 1\)"):
        chain_of(np.array([0.0, 1.0]), root[:1], link)


@pytest.mark.parametrize("smooth", [False, True])
def test_means_of_heights_keep_their_variance_in_even_time(smooth):
    """A height error that is new at a rate, or follows a velocity that is; exact sums by the whole matrix."""
    t = T0 + np.arange(0.0, 300.0, 0.5)
    if smooth:
        # height beside its velocity, critically damped: (1 + a) exp(-a), a = lag / 4 s
        a = 0.5 / 4.0
        link = np.exp(-a) * np.array([[1 + a, a], [-a, 1 - a]])
        row = np.array([1.0, 0.0])
    else:
        link, row = np.exp(-0.5 / 9.0) * np.eye(1), np.ones(1)
    chain = chain_of(t, np.outer(np.eye(6)[2], 0.02 * row), link)
    lag = np.abs(t[:, None] - t)
    exact = 0.02**2 * ((1 + lag / 4) * np.exp(-lag / 4) if smooth else np.exp(-lag / 9))
    at, even, time_s = even_time([chain])
    told = np.interp(t, at, even)
    ours = 0.02**2 * np.exp(-np.abs(told[:, None] - told) / time_s)
    assert time_s == pytest.approx(8.0 if smooth else 9.0, rel=0.05)
    assert ours.sum() == pytest.approx(exact.sum(), rel=0.05)
    if not smooth:
        assert_allclose(ours, exact, rtol=0, atol=0.03 * 0.02**2)
    with pytest.raises(GeometryError, match="no errors of heights"):
        even_time([replace(chain, root=0.0 * chain.root)])


@pytest.mark.parametrize("sigma_m", [0.03, 1.0, 20.0])
def test_even_time_runs_by_the_rate_at_which_errors_are_forgotten(sigma_m):
    """Forgotten in 3 s at first and in 12 s later: four times as fast, however large the errors are."""
    t = np.arange(0.0, 120.5, 0.5)
    keep = np.exp(-0.5 / np.where(t <= 60.0, 3.0, 12.0))
    chain = chain_of(t, np.diag([5.0, 5.0, sigma_m, 1.0, 1.0, 1.0]), keep[:, None, None] * np.eye(6))
    at, even, time_s = even_time([chain])
    first, second = (np.diff(np.interp(span, at, even))[0] for span in ([15.0, 45.0], [75.0, 105.0]))
    assert first / second == pytest.approx(4.0, rel=0.1)
    assert time_s / (first / 30.0) == pytest.approx(3.0, rel=0.1)
    assert (even[0], even[-1]) == pytest.approx((0.0, 120.0))


def test_errors_that_never_end_or_are_forgotten_at_once_have_the_limits_of_the_search():
    """A thousandth of the survey and a thousand surveys, where the sum over it tells no time."""
    t = np.arange(0.0, 100.5, 0.5)
    at_once, never = (even_time([chain_of(t, 0.02 * np.eye(6), k * np.eye(6))])[2] for k in (0.0, 1.0))
    assert at_once < 2.0
    assert never > 1e4


def test_chains_with_links_in_all_directions_by_hand():
    """Two components that turn into each other: the later error is ``link`` times the earlier one.

    Between two nodes errors are interpolated, and outside they stay.
    """
    rng = np.random.default_rng(8)
    root, link = rng.standard_normal((4, 6, 2)), 0.5 * rng.standard_normal((4, 2, 2))
    t = np.array([0.0, 1.0, 2.0, 4.0])
    chain = chain_of(t, root, link)
    mixed = root[2] @ link[2] @ root[1].T  # of node 2 with node 1
    expected = 0.49 * root[1] @ root[1].T + 0.09 * root[2] @ root[2].T + 0.21 * (mixed + mixed.T)
    before, found, behind = chain.covariance_at(np.array([-5.0, 1.3, 9.0]))
    assert found == pytest.approx(expected, rel=1e-12)
    assert before == pytest.approx(root[0] @ root[0].T)
    assert behind == pytest.approx(root[3] @ root[3].T)
    up = root[:, 2]
    own, following = chain.heights_along(np.array([0.4, 0.6, 3.5]))  # the nodes 0, 1 and 3
    assert own == pytest.approx([up[0] @ up[0], up[1] @ up[1], up[3] @ up[3]])
    assert following == pytest.approx([up[1] @ link[1] @ up[0], up[3] @ link[3] @ link[2] @ up[1]])
    full = np.zeros((4, 4))
    for i, k in combinations_with_replacement(range(4), 2):
        full[i, k] = full[k, i] = between(chain, i, k)[2, 2]
    own, whole = chain.heights_over_time()
    assert own == pytest.approx(np.diag(full))
    assert whole == pytest.approx(full @ [0.5, 1.0, 1.5, 1.0])  # trapezia
