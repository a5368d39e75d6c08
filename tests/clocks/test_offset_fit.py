"""The estimate of a camera's clock against plain linear algebra, on observations linear by design."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from thalweg.clocks import OffsetOptions
from thalweg.clocks.camera_offset import (
    NAMES,
    TURN_NAMES,
    OffsetState,
    Stacked,
    _known,
    estimate_component,
    fit_offset,
    image_times,
)
from thalweg.core import ArrayF, GeometryError, exp_rotation

N = 7
DRIFT_UNIT = 1e-6
JITTER_S = 0.02
R_0 = Rotation.from_euler("xyz", [0.4, -0.7, 1.9]).as_matrix()
"""Turn from camera to INS about which the observations are linear."""


def random_covariance(rng, n, sigma):
    root = 0.3 * rng.standard_normal((n, n)) / np.sqrt(n) + np.diag(rng.uniform(0.5, 1.5, n))
    return np.asarray(sigma**2 * root @ root.T)


@dataclass
class Linear:
    """What `OffsetModel` gives, with residuals ``J x - y`` of (offset, drift, antenna, turn, slow errors)."""

    attitude: bool
    noise_mps: float = 0.0
    turn: ArrayF = field(default_factory=lambda: np.zeros(3))
    calls: int = 0
    restless_s: float = 0.0

    def __post_init__(self):
        rng = np.random.default_rng(17 + self.attitude)
        m = N * 3 * (1 + self.attitude)
        slow = ("slow_roll_1", "slow_pitch_1", "slow_heading_1")
        self.names = (*NAMES, *TURN_NAMES, *slow) if self.attitude else NAMES
        self.reference_s = 1003.0
        self.image = np.tile(np.repeat(np.arange(N), 3), 1 + self.attitude)
        stamps = 1000.0 + np.array([0.0, 1.0, 2.5, 3.0, 4.2, 6.0, 7.0])
        self.motion = rng.standard_normal(m)
        self.J = 0.3 * rng.standard_normal((m, len(self.names)))
        self.J[:, 0] = self.motion
        self.J[:, 1] = self.motion * (stamps - self.reference_s)[self.image]
        if self.attitude:
            self.J[: m // 2, 5:], self.J[m // 2 :, 2:5] = 0.0, 0.0
        self.V = random_covariance(rng, m, 0.02)
        self.noise = random_covariance(rng, 3 * N, self.noise_mps)
        self.rate_noise = random_covariance(rng, 3 * N, 0.6 * self.noise_mps)
        truth = np.zeros(len(self.names))
        truth[:5] = [0.2, 40 * DRIFT_UNIT, 0.3, -0.1, 0.5]
        jitter = JITTER_S * rng.standard_normal(N)
        self.y = self.J @ truth + self.motion * jitter[self.image] + 0.02 * rng.standard_normal(m)
        # attitudes of the INS and of the camera apart by R_0, and by how far the start is to be off it
        R_ins = Rotation.from_rotvec(0.5 * rng.standard_normal((N, 3))).as_matrix()
        self.poses = SimpleNamespace(
            t_device_s=stamps, R_wcs_ccs=R_ins @ exp_rotation(self.turn) @ R_0, file=np.arange(N)
        )
        self.track = SimpleNamespace(velocity_covariance=lambda between: self.noise)
        self.ins = (
            SimpleNamespace(at=lambda t: (R_ins, None, None), rate_covariance=lambda t: self.rate_noise)
            if self.attitude
            else None
        )

    def times(self, state):
        t = self.poses.t_device_s
        return np.asarray(t + state.offset_s + state.drift * (t - self.reference_s))

    def unknowns(self, state):
        turn = Rotation.from_matrix(state.R_ics_ccs @ R_0.T).as_rotvec()
        x = [state.offset_s, state.drift, *state.lever_m]
        return np.array([*x, *turn, *state.slow] if self.attitude else x)

    def observe(self, state):
        self.calls += 1
        residual = self.J @ self.unknowns(state) - self.y + self.restless_s * self.calls * self.motion
        between = SimpleNamespace(t_gps_s=self.times(state))
        return Stacked(
            residual=residual, jacobian=self.J, motion=self.motion, image=self.image, between=between
        )

    def covariance(self, state, between):
        return self.V

    @property
    def effects(self):
        Z = np.zeros((len(self.y), N))
        for row, image in enumerate(self.image):
            Z[row, image] = self.motion[row]
        return Z


def start(model):
    return OffsetState(offset_s=0.0, drift=0.0, lever_m=np.zeros(3))


def fitted(model, options):
    return fit_offset(model, start(model), options)


LEVER = np.array([0.25, -0.05, 0.6])
COV_LEVER = np.array([[4e-4, 1e-4, 0.0], [1e-4, 9e-4, -2e-4], [0.0, -2e-4, 1e-4]])
OPTIONS = {
    "held jitter": OffsetOptions(jitter_s=JITTER_S),
    "known antenna": OffsetOptions(
        jitter_s=JITTER_S, sigma_drift=30e-6, lever_m=LEVER, cov_lever_m2=COV_LEVER
    ),
}


def knowledge(options, u):
    """Weights (u, u) of what is known beforehand, and weights times values (u,)."""
    W, w = np.zeros((u, u)), np.zeros(u)
    W[1, 1] = options.sigma_drift**-2
    if options.lever_m is not None:
        W[2:5, 2:5] = np.linalg.inv(COV_LEVER + 1e-10 * np.eye(3))
        w[2:5] = W[2:5, 2:5] @ options.lever_m
    return W, w


def projector(A, V):
    W = np.linalg.inv(V)
    return np.asarray(W - W @ A @ np.linalg.inv(A.T @ W @ A) @ A.T @ W)


@pytest.mark.parametrize("name", list(OPTIONS))
@pytest.mark.parametrize("attitude", [False, True])
def test_the_estimate_is_generalised_least_squares(attitude, name):
    """Jitter held: one weighted solution with ``V + s Z Z^T`` and what is known beforehand."""
    model, options = Linear(attitude, turn=np.array([0.02, -0.01, 0.03])), OPTIONS[name]
    found = fitted(model, options)
    A, Z = model.J, model.effects
    V = model.V + JITTER_S**2 * Z @ Z.T
    W, w = knowledge(options, A.shape[1])
    Q = np.linalg.inv(A.T @ np.linalg.inv(V) @ A + W)
    x = Q @ (A.T @ np.linalg.inv(V) @ model.y + w)
    sigma = np.sqrt(np.diag(Q))
    # turns end where the offset moves by less than 1e-5 s: the last step is linear
    assert_allclose((model.unknowns(found.state) - x) / sigma, 0.0, atol=1e-3)
    assert_allclose(found.cov / np.outer(sigma, sigma), Q / np.outer(sigma, sigma), atol=1e-6)
    assert found.converged
    assert (found.jitter.variance, found.jitter.sigma_variance) == (pytest.approx(JITTER_S**2), 0.0)
    assert found.redundancy == len(model.y) + (4 if options.lever_m is not None else 1) - len(x)
    r = A @ x - model.y
    before = x @ W @ x - 2 * x @ w + (LEVER @ w[2:5] if options.lever_m is not None else 0.0)
    assert found.sigma0_squared * found.redundancy == pytest.approx(
        r @ np.linalg.solve(V, r) + before, rel=1e-4
    )
    assert_array_equal(found.V0, model.V)
    assert found.state.oriented == attitude
    # an image's own error: three or six more unknowns, one for each of its residuals
    P = projector(A, V)
    for image in range(N):
        rows = np.flatnonzero(model.image == image)
        own = P[np.ix_(rows, rows)]
        assert found.tests[image] == pytest.approx(
            (P @ r)[rows] @ np.linalg.solve(own, (P @ r)[rows]), rel=1e-4
        )
    # jitters: the mean of a normal variable given the residuals; times that are late make residuals larger
    assert_allclose(found.effects_s, -(JITTER_S**2) * Z.T @ P @ r, rtol=1e-3, atol=1e-7)


@pytest.mark.parametrize("attitude", [False, True])
def test_the_jitter_is_the_component_of_all_residuals_and_of_what_is_known(attitude):
    model = Linear(attitude)
    options = OffsetOptions(sigma_drift=30e-6, lever_m=LEVER, cov_lever_m2=COV_LEVER)
    found = fitted(model, options)
    u = model.J.shape[1]
    known = np.eye(u)[1:5]
    A = np.vstack([model.J, known])
    V = block_diag(model.V, [[30e-6**2]], COV_LEVER + 1e-10 * np.eye(3))
    Z = np.vstack([model.effects, np.zeros((4, N))])
    y = np.r_[model.y, 0.0, LEVER]
    expected = estimate_component(y, A, Z, V)
    assert 0.3 * JITTER_S < expected.sigma < 3 * JITTER_S
    assert found.jitter.variance == pytest.approx(expected.variance, rel=1e-3)
    assert found.jitter.sigma_variance == pytest.approx(expected.sigma_variance, rel=1e-3)
    # and the estimate is that of a jitter held at it
    held = fitted(model, replace(options, jitter_s=expected.sigma))
    assert_allclose(found.cov, held.cov, rtol=2e-3, atol=1e-12)
    assert found.state.offset_s == pytest.approx(held.state.offset_s, abs=1e-5)


@pytest.mark.parametrize("attitude", [False, True])
def test_slopes_that_are_noise_make_the_clock_uncertain(attitude):
    """Of the information ``N`` about offset and drift the noise makes ``tr P Cov``: ``B^-1 N B^-1`` is left.

    What is estimated with them errs along: the part of its covariance that goes with the clock is replaced.
    """
    plain, noisy = (fitted(Linear(attitude, noise_mps=v), OPTIONS["held jitter"]) for v in (0.0, 0.25))
    model = Linear(attitude, noise_mps=0.25)
    C = plain.cov
    assert_allclose(noisy.state.offset_s, plain.state.offset_s)
    noise = block_diag(model.noise, model.rate_noise) if attitude else model.noise
    Z = model.effects
    P = projector(model.J, model.V + JITTER_S**2 * Z @ Z.T)
    since = (model.poses.t_device_s - model.reference_s)[model.image]
    told = np.zeros((2, 2))
    for i in range(len(since)):
        for j in range(len(since)):
            by = np.array([[1.0, since[j]], [since[i], since[i] * since[j]]])
            told += P[i, j] * noise[i, j] * (by + by.T) / 2
    N_clock = np.linalg.inv(C[:2, :2])
    left = np.linalg.inv(N_clock - told)
    clock = left @ N_clock @ left
    unit = np.sqrt(np.diag(clock))
    assert_allclose(noisy.cov[:2, :2] / np.outer(unit, unit), clock / np.outer(unit, unit), atol=1e-6)
    assert noisy.cov[0, 0] > 1.02 * C[0, 0]
    # given the clock, the others are as certain as before
    K = C[2:, :2] @ N_clock
    others = C[2:, 2:] + K @ (clock - C[:2, :2]) @ K.T
    assert_allclose(noisy.cov[2:, 2:], others, rtol=1e-6, atol=1e-12)
    assert_allclose(noisy.cov[2:, :2], K @ clock, rtol=1e-5, atol=1e-12)


def test_where_nothing_but_noise_is_left_the_offset_is_unknown():
    found = fitted(Linear(True, noise_mps=5.0), OPTIONS["held jitter"])
    assert found.cov[0, 0] == np.inf
    assert np.isfinite(found.cov[1:, 1:]).all()


@pytest.mark.parametrize("noise_mps", [0.0, 0.25])
@pytest.mark.parametrize("name", list(OPTIONS))
def test_times_of_images_join_clock_and_jitters(name, noise_mps):
    """By another way: what errs given the clock, plus what errs with the clock, jitters along with it."""
    model, options = Linear(True, noise_mps=noise_mps), OPTIONS[name]
    fit = fitted(model, options)
    best, sigma, mean, sigma_mean = image_times(fit, 2.25, options)
    u = model.J.shape[1]
    both = np.hstack([model.J, model.effects])
    weight = both.T @ np.linalg.inv(model.V) @ both
    weight[:u, :u] += knowledge(options, u)[0]
    weight[u:, u:] += np.eye(N) / JITTER_S**2
    given = np.linalg.inv(weight[2:, 2:])
    with_clock = (-given @ weight[2:, :2])[u - 2 :]
    by_clock = np.column_stack([np.ones(N), model.poses.t_device_s - model.reference_s]) + with_clock
    cov = 2.25 * (by_clock @ fit.cov[:2, :2] @ by_clock.T + given[u - 2 :, u - 2 :])
    assert_allclose(sigma, np.sqrt(np.diag(cov)), rtol=1e-4)
    assert sigma_mean == pytest.approx(np.sqrt(cov.mean()), rel=1e-4)
    assert_allclose(best, model.times(fit.state) + fit.effects_s, rtol=0, atol=1e-12)
    assert mean == pytest.approx(fit.state.offset_s + fit.effects_s.mean(), abs=1e-12)


def test_without_jitter_all_times_are_those_of_the_clock():
    model, options = Linear(False), OffsetOptions(jitter_s=0.0)
    fit = fitted(model, options)
    best, sigma, mean, sigma_mean = image_times(fit, 1.0, options)
    assert_allclose(best, model.times(fit.state), rtol=0, atol=1e-12)
    since = model.poses.t_device_s - model.reference_s
    line = np.column_stack([np.ones(N), since]) @ fit.cov[:2, :2] @ np.stack([np.ones(N), since])
    # a jitter of 0.1 us stands for none
    assert_allclose(sigma, np.sqrt(np.diag(line)), rtol=1e-6)
    assert sigma_mean == pytest.approx(np.sqrt(line.mean()), rel=1e-6)
    assert mean == fit.state.offset_s


@pytest.mark.parametrize("which", [(0, 0), (1, 1), (0, 1)])
def test_a_clock_without_a_variance_leaves_every_time_unknown(which):
    model, options = Linear(False), OPTIONS["held jitter"]
    fit = fitted(model, options)
    fit.cov[which] = np.inf
    _, sigma, mean, sigma_mean = image_times(fit, 1.0, options)
    assert np.isinf(sigma).all()
    assert np.isinf(sigma_mean)
    assert np.isfinite(mean)


def test_what_is_known_beforehand():
    """The drift always, held at a trillionth if its sigma is zero; the antenna with lever arm and sigma."""
    state = OffsetState(offset_s=9.0, drift=5e-6, lever_m=np.array([1.0, 2.0, 3.0]))
    for sigma, variance in ((2e-6, 4e-12), (0.0, 1e-24)):
        known = _known(OffsetOptions(sigma_drift=sigma), state, 8)
        assert list(known) == ["drift"]
        assert_array_equal(known["drift"].jacobian, np.eye(8)[1:2])
        assert known["drift"].residual.tolist() == [5e-6]
        assert known["drift"].cov.tolist() == [pytest.approx(variance)]
    assert list(_known(OffsetOptions(lever_m=LEVER), state, 8)) == ["drift"]
    assert list(_known(OffsetOptions(cov_lever_m2=COV_LEVER), state, 8)) == ["drift"]
    antenna = _known(OffsetOptions(lever_m=LEVER, cov_lever_m2=COV_LEVER), state, 8)["antenna"]
    assert_array_equal(antenna.jacobian, np.eye(8)[2:5])
    assert_allclose(antenna.residual, [0.75, 2.05, 2.4])
    # a hundredth of a millimetre on top: a matrix of zeros could not be inverted
    assert_allclose(antenna.cov, (COV_LEVER + 1e-10 * np.eye(3))[None], rtol=1e-12)


def test_the_turn_between_ins_and_camera_is_set_once():
    """It starts as the mean of what both say; a state that is oriented keeps its own, and its slow errors."""
    seen = []
    turn = np.array([0.02, -0.01, 0.03])
    model = Linear(True, turn=turn)
    observe = model.observe

    def watched(state):
        seen.append(state)
        return observe(state)

    model.observe = watched
    own = replace(start(model), R_ics_ccs=R_0, slow=np.full(3, 1e-3), oriented=True)
    other = {
        "new": (start(model), exp_rotation(turn) @ R_0, 0.0),
        "oriented": (own, R_0, 1e-3),
        # the choice of images has changed, and with it the number of slow errors
        "of other images": (replace(own, slow=np.full(6, 1e-3)), exp_rotation(turn) @ R_0, 0.0),
    }
    for state, R, slow in other.values():
        seen.clear()
        fit_offset(model, state, OPTIONS["held jitter"])
        assert_allclose(seen[0].R_ics_ccs, R, atol=1e-12)
        assert_array_equal(seen[0].slow, np.full(3, slow))
        assert seen[0].oriented


def test_turns_that_come_to_no_end_are_told():
    """Observations that move by 1 ms each time they are asked: thirty turns, and one look at the last."""
    model = Linear(False, restless_s=1e-3)
    found = fitted(model, OPTIONS["held jitter"])
    assert not found.converged
    assert model.calls == 31


def test_an_antenna_that_nothing_shows_is_refused():
    model = Linear(False)
    model.J[:, 3] = 0.0
    with pytest.raises(GeometryError, match="do not determine dy"):
        fitted(model, OPTIONS["held jitter"])
