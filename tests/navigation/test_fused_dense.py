"""The smoother against a slow and clear least-squares solution with one dense covariance of all states."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from thalweg.core import ErrorChain
from thalweg.navigation.fusion import (
    FusionSettings,
    Layout,
    Observed,
    Reference,
    camera_of,
    make_reference,
    place_nodes,
)
from thalweg.navigation.fusion.model import GROUPS, MODEL, RESET, Nodes, antenna_of, transitions
from thalweg.navigation.fusion.solver import linearised, smooth
from thalweg.navigation.fusion.trajectory import pose_states
from thalweg_lab.studies import outage

SETTINGS = FusionSettings(clock_walk_s=1e-3)
OWN = {"gnss": 1.3, "gnss_white": 0.8, "velocity": 0.7, "camera": 1.1, "roll_pitch": 1.2}
FACTORS = dict.fromkeys(GROUPS, 1.0) | OWN


@dataclass
class Task:
    reference: Reference
    nodes: Nodes
    observed: Observed
    layout: Layout
    x: np.ndarray
    start: np.ndarray


def task(settings=SETTINGS, hole=True):
    """Three seconds with 31 positions, 3 images and a hole in the INS's velocity."""
    survey = outage.make_survey(3, outage.VoyageSpec(duration_s=12.0))
    t0 = survey.motion.start_gps_s
    states = survey.states[(survey.states["t_gps_s"] >= t0) & (survey.states["t_gps_s"] <= t0 + 3.0)].copy()
    if hole:
        gone = (states["t_gps_s"] > t0 + 1.6) & (states["t_gps_s"] < t0 + 2.1)
        states.loc[gone, ["v_north_mps", "v_east_mps", "v_down_mps"]] = np.nan
    positions = survey.positions[survey.positions["t_gps_s"].between(t0, t0 + 3.0)].assign(cov_en_m2=1e-4)
    positions["fix"] = np.where(positions["t_gps_s"].between(t0 + 0.95, t0 + 1.45), "float", "fixed")
    near = outage.FRAME.from_geodetic(positions["lat_deg"], positions["lon_deg"], positions["h_ell_m"])
    how = {"sigma_attitude_rad": np.deg2rad([0.1, 0.1, 0.2]), "max_attitude_gap_s": 0.1}
    how |= {"near_t_s": positions["t_gps_s"].to_numpy(), "near_wcs_m": near}
    reference = make_reference(states, outage.FRAME, use_velocity=settings.use_ins_velocity, **how)
    antenna = antenna_of(positions, outage.FRAME, outage.LEVER_ANTENNA_M, [0.01, 0.02, 0.03])
    use = reference.inside(survey.images.t_gps_s)
    camera = camera_of(survey.images, use, survey.T_ccs_ics, settings.sigma_jitter_s)
    nodes, of_antenna, of_camera = place_nodes(reference, settings, antenna.t_gps_s, camera.t_gps_s)
    # steps of the boat's own motion walk more in one direction than in another
    nodes = replace(nodes, walk=np.where((nodes.kind == MODEL)[:, None], [3.0, 0.2, 0.7], 1.0))
    layout = Layout.of(gnss=True, camera=True)
    a, c = replace(antenna, node=of_antenna), replace(camera, node=of_camera)
    observed = Observed.of(a, c, np.zeros(len(of_antenna), bool), np.zeros(len(of_camera), bool))
    x = 0.1 * np.random.default_rng(1).standard_normal((len(nodes.t_gps_s), layout.n))
    return Task(reference, nodes, observed, layout, x, np.array([1.0, 2.0, 3.0]))


def solved(t, settings=SETTINGS, **more):
    known = (t.reference.at(t.nodes.t_gps_s), t.nodes, t.observed, t.layout, settings, FACTORS)
    return smooth(t.x, *known, start_m=t.start, clock_start_s=0.003, **more)


def full(chain, layout, k):
    """Transition and noise of all states into node k as full matrices."""
    f, g, dd, de, ee = chain.pair[k]
    F, Q = np.diag(chain.phi[k]), np.diag(chain.q[k])
    for i in range(3):
        F[i, i], F[i, 3 + i], F[3 + i, 3 + i] = 1.0, f, g
        Q[i, i], Q[i, 3 + i], Q[3 + i, i], Q[3 + i, 3 + i] = np.multiply(chain.walk[k, i], [dd, de, de, ee])
    if chain.image_of[k] >= 0:
        part = slice(layout.camera, layout.camera + 6)
        F[part, part], Q[part, part] = chain.G[chain.image_of[k]], chain.W[chain.image_of[k]]
    return F, Q


def dense(t, settings=SETTINGS):
    """Mean (m n,) and covariance (m n, m n) of all states of all nodes, and all parts of the prior."""
    at = t.reference.at(t.nodes.t_gps_s)
    streams = {"antenna": t.observed.antenna, "camera": t.observed.camera}
    start = {"start_m": t.start, "clock_start_s": 0.003}
    chain = transitions(t.nodes, t.layout, settings, FACTORS, **streams, **start)
    rows = linearised(t.x, at, t.observed, t.layout, settings).weighted(FACTORS)
    m, n = t.x.shape
    mean = np.zeros((m, n))
    mean[0] = chain.x0
    spread = np.zeros((m * n, m * n))  # each column block: how one node's noise reaches all nodes
    noise = np.zeros((m * n, m * n))
    noise[:n, :n] = np.diag(chain.p0)
    spread[:n, :n] = np.eye(n)
    for k in range(1, m):
        F, Q = full(chain, t.layout, k)
        mean[k] = F @ mean[k - 1]
        here, before = slice(k * n, (k + 1) * n), slice((k - 1) * n, k * n)
        spread[here] = F @ spread[before]
        spread[here, here] = np.eye(n)
        noise[here, here] = Q
    H = np.zeros((len(rows.y), m * n))
    for r, k in enumerate(rows.node):
        H[r, k * n : (k + 1) * n] = rows.H[r]
    prior = spread @ noise @ spread.T
    S = H @ prior @ H.T + np.eye(len(rows.y))
    gain = np.linalg.solve(S, H @ prior).T
    left = rows.y - H @ mean.ravel()
    x = mean.ravel() + gain @ left
    return x.reshape(m, n), prior - gain @ H @ prior, (H @ spread, noise, S, left, rows)


@pytest.fixture(autouse=True)
def _nearer_start(monkeypatch):
    """A start known to 1 m: with 300 m the dense solution, not the smoother, loses the digits compared."""
    monkeypatch.setattr("thalweg.navigation.fusion.model.START_SIGMA_M", 1.0)


def test_states_and_covariances_agree_with_the_dense_solution():
    t = task()
    assert {MODEL, RESET} <= set(t.nodes.kind.tolist())  # the hole is in it
    found = solved(t)
    x, cov, _ = dense(t)
    m, n = x.shape
    # 1e-9 m, m/s and sigmas: double precision; variances from 1 m to 0.3 mm are apart by 1e7
    assert_allclose(found.x, x, rtol=0, atol=1e-9)
    blocks = cov.reshape(m, n, m, n)
    for k in range(m):
        own = blocks[k, :10, k, :10]
        scale = np.sqrt(np.outer(np.diag(own), np.diag(own)))
        assert_allclose(found.cov[k] / scale, own / scale, rtol=0, atol=1e-8)
        if k < m - 1:
            after = blocks[k, :10, k + 1, :10]
            scale = np.sqrt(np.outer(np.diag(own), np.diag(blocks[k + 1, :10, k + 1, :10])))
            assert_allclose(found.cross[k] / scale, after / scale, rtol=0, atol=1e-8)
    last = blocks[-1, :, -1, :]
    assert_allclose(found.last, last, rtol=0, atol=1e-9)


def test_errors_of_any_two_nodes_hang_together_as_in_the_dense_solution():
    """As one Markov chain of all states, thinned; of the states of the pose alone it would not be one."""
    t = task()
    n = t.layout.n
    found = solved(t, part=n)
    m = len(t.nodes.t_gps_s)
    cov = dense(t)[1].reshape(m, n, m, n)
    pose = np.broadcast_to(np.eye(6, 10), (m, 6, 10))  # the first six states stand for a pose
    worst = []
    for states in (n, 10):
        chain = ErrorChain.of_covariances(
            "all", t.nodes.t_gps_s, found.cov[:, :states, :states], found.cross[:, :states, :states], pose,
            step_s=0.15,
        )  # fmt: skip
        assert 15 < len(chain.t_gps_s) < m / 2
        kept = np.searchsorted(t.nodes.t_gps_s, chain.t_gps_s, side="right") - 1
        apart, link = [], np.eye(chain.link.shape[1])
        for k in range(len(kept)):
            link = chain.link[k] @ link if k else link
            true = cov[kept[k], :6, 0, :6]
            sigma = np.sqrt(np.outer(np.diag(cov[kept[k], :6, kept[k], :6]), np.diag(cov[0, :6, 0, :6])))
            apart.append(np.abs(chain.root[k] @ link @ chain.root[0].T - true) / sigma)
        worst.append(np.max(apart))
    # eigenvalues of a correlation matrix below 1e-9 are cut
    assert worst[0] < 1e-5
    assert worst[1] > 0.05


def test_squares_and_redundancies_of_groups_agree_with_the_dense_solution():
    """``v^T P v`` and redundancy of a group by its own part of the covariance of all observations."""
    t = task()
    found = solved(t)
    x, _, (reach, noise, S, left, rows) = dense(t)
    m, n = x.shape
    weighted = np.linalg.solve(S, left)
    total = 0.0
    for group in GROUPS:
        states = np.array(t.layout.states_of(group), dtype=np.int64)
        if group in ("velocity", "acceleration"):
            nodes = [k for k in range(1, m) if (t.nodes.kind[k] == MODEL) == (group == "acceleration")]
            states = np.arange(6)
        else:
            nodes = list(range(m))
        own = np.zeros(m * n, bool)
        own[[k * n + i for k in nodes for i in states]] = True
        part = np.where(np.outer(own, own), noise, 0.0)
        C = reach @ part @ reach.T
        observations = {"gnss_white": 1, "camera": 0}.get(group)
        if observations is not None:
            C += np.diag(rows.of_antenna == observations)
        square, redundancy = found.groups[group]
        assert square == pytest.approx(weighted @ C @ weighted, rel=1e-7, abs=1e-9), group
        assert redundancy == pytest.approx(np.trace(np.linalg.solve(S, C)), rel=1e-7, abs=1e-9), group
        total += redundancy
    # what is left of the observations are the six states of the start, next to unknown
    assert total == pytest.approx(len(rows.y) - 6, abs=4)


@pytest.mark.parametrize("velocity", [True, False])
def test_between_nodes_the_pose_is_that_of_a_node_placed_there(velocity):
    """Adding nodes without observations changes nothing; the states between follow from both neighbours."""
    settings = SETTINGS.replace(use_ins_velocity=velocity)
    t = task(settings, hole=False)
    t.x[:] = 0.0
    found = solved(t, settings)
    close = settings.replace(node_s=0.03)
    more = task(close, hole=False)
    more.x[:] = 0.0
    finer = solved(more, close)
    at = more.nodes.t_gps_s
    mean, cov = pose_states(at, t.nodes, found, settings)
    # 1e-8: the inverse of the noise over 0.1 s has a condition of 1e5
    assert_allclose(mean, finer.x[:, :10], atol=1e-8)
    scale = np.sqrt(np.einsum("nii,njj->nij", finer.cov, finer.cov))
    assert_allclose(cov / scale, finer.cov / scale, atol=1e-7)


def test_rows_are_the_derivatives_of_the_observations():
    """``y - H x`` is what the observation misses; differences of the states leave second order."""
    t = task(hole=False)
    at = t.reference.at(t.nodes.t_gps_s)
    rows = linearised(t.x, at, t.observed, t.layout, SETTINGS).weighted(FACTORS)
    rng = np.random.default_rng(2)
    step = 1e-4 * rng.standard_normal(t.x.shape)
    step[:, 3:6] = 0.0  # the velocity times the clock's offset is of second order by design
    missed = rows.y - np.einsum("ri,ri->r", rows.H, t.x[rows.node])
    moved = linearised(t.x + step, at, t.observed, t.layout, SETTINGS).weighted(FACTORS)
    missed_there = moved.y - np.einsum("ri,ri->r", moved.H, (t.x + step)[rows.node])
    change = -np.einsum("ri,ri->r", rows.H, step[rows.node])
    # steps of 1e-4 m and 1e-4 sigmas, noise of 0.3 mm and 1e-3 deg: change of 1, remainder of 1e-3
    assert np.abs(change).max() > 0.1
    assert_allclose(missed_there - missed, change, atol=2e-3)
