"""Iterated solution: poses, weights against wrong observations, and sizes of the errors.

Wrong observations are met in three stages. First Huber's weights on the *total* error of an observation (its
slow part and its white part together, in units of its stated covariance): a jump by multipath that lasts for
seconds looks like a slow error, and only its size tells. Then weights that fall with the fourth power. Last,
an observation counts fully or not at all. Weights act on the white part: extra noise of its own.

Sizes of the errors are variance components (Foerstner 1979; Koch 1999, 3.6): the weighted squares of the
residuals of a group over its redundancy, both from the smoother.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import chi2

from thalweg.core import ArrayB, ArrayF, ArrayI, njit, rotation_vector
from thalweg.navigation.fusion.model import (
    FACTORS,
    GROUPS,
    INS,
    MODEL,
    POSE,
    PRIOR_REDUNDANCY,
    RESET,
    SCALED,
    WHITE_SHARE,
    Antenna,
    Camera,
    Factors,
    FusionSettings,
    Layout,
    Nodes,
    Reference,
    Rows,
    Sampled,
    antenna_rows,
    camera_rows,
    stacked,
    transitions,
    whitened,
)

_HUBER, _STEEP = 3, 5
"""Solutions with Huber's weights, and those until an observation counts fully or not at all."""
_READMIT = 6
"""Solutions of the last stage after which a rejected observation stays rejected."""
_STILL_M, _STILL_RAD, _STILL_FACTOR = 5e-5, 5e-6, 0.02
"""Greatest change of positions, angles and factors (relative) of the last solution."""

Variance = Callable[[ArrayI, ArrayI], ArrayF]
"""Variances (m, d) of the differences between members i (m,) and j (m,) of a series."""
_IMPROBABLE: Final = 1e-6
"""Probability of a step at which a series is cut: one in a day at 10 Hz."""
_BLIND_MPS: Final = 2.0
"""How far the boat may go a second where the INS gives no velocity."""
_ENDS: Final = 10
"""Members at the end of a piece whose median is compared."""
_MOST: Final = 0.5
"""Share of a series beyond which it is no longer clear which of its members are wrong."""


# ---------------------------------------------------------------- solution


@dataclass(slots=True, kw_only=True)
class Observed:
    """Antenna and images at their nodes, and what is taken of them.

    ``weight_*`` of the white part, 0 for what is rejected; ``normalised_*`` the total error in units of its
    covariance, root of the quadratic form; what is ``doubtful_*`` counts fully or not at all from the start.
    """

    antenna: Antenna | None
    camera: Camera | None
    weight_antenna: ArrayF
    weight_camera: ArrayF
    normalised_antenna: ArrayF
    normalised_camera: ArrayF
    doubtful_antenna: ArrayB
    doubtful_camera: ArrayB

    @classmethod
    def of(
        cls, antenna: Antenna | None, camera: Camera | None, doubtful_antenna: ArrayB, doubtful_camera: ArrayB
    ) -> "Observed":
        """All weights 1, but 0 for the doubtful; (k,) flags, empty for what is not there."""
        return cls(
            antenna=antenna,
            camera=camera,
            weight_antenna=np.where(doubtful_antenna, 0.0, 1.0),
            weight_camera=np.where(doubtful_camera, 0.0, 1.0),
            normalised_antenna=np.zeros(len(doubtful_antenna)),
            normalised_camera=np.zeros(len(doubtful_camera)),
            doubtful_antenna=doubtful_antenna,
            doubtful_camera=doubtful_camera,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Solved:
    """Smoothed states.

    ``x`` (m, n) at the nodes, ``cov`` and ``cross`` (m, 10, 10) of the states of the pose at a node and with
    the next one (or of all states, if asked for), ``last`` (n, n) covariance of all states at the last node,
    ``groups`` weighted squares and redundancy by group, ``factors`` of the sigmas, ``n_solutions``,
    ``settled`` whether nothing moved at the end.
    """

    x: ArrayF
    cov: ArrayF
    cross: ArrayF
    last: ArrayF
    groups: dict[str, tuple[float, float]]
    factors: Factors
    n_solutions: int
    settled: bool


def solve(
    reference: Reference,
    nodes: Nodes,
    observed: Observed,
    layout: Layout,
    settings: FusionSettings,
    *,
    clock_start_s: float = 0.0,
    factors: Factors | None = None,
    start: ArrayF | None = None,
) -> Solved:
    """Solve until poses, weights and sizes of errors stand; ``observed`` receives the weights.

    Parameters
    ----------
    reference, nodes, observed, layout, settings : the task.
    clock_start_s : prior mean of the clock offset about the nodes of the images.
    factors : of the sigmas to start from; 1 if None.
    start : (m, n) states to start from.
    """
    at = reference.at(nodes.t_gps_s)
    now = dict.fromkeys(GROUPS, 1.0) if factors is None else dict(factors)
    x = np.zeros((len(nodes.t_gps_s), layout.n)) if start is None else start
    start_m = first_offset(at, observed)
    if start is None:
        x[:, :3] = start_m
    stage, settled, found = 0, False, None
    first = _HUBER + _STEEP if start is not None else 0
    for stage in range(first, first + settings.max_iterations):
        found = smooth(
            x, at, nodes, observed, layout, settings, now, start_m=start_m, clock_start_s=clock_start_s
        )
        moved = _moved(x, found.x, at)
        before = observed.weight_antenna.copy(), observed.weight_camera.copy()
        x = found.x
        judge(x, at, observed, layout, settings, now, stage=stage)
        last = dict(now)
        if settings.estimate_errors and stage >= _HUBER:
            now = rescaled(now, found.groups)
        same = np.array_equal(before[0], observed.weight_antenna) and np.array_equal(
            before[1], observed.weight_camera
        )
        steady = max(abs(now[g] / last[g] - 1.0) for g in GROUPS) < _STILL_FACTOR
        if stage >= _HUBER + _STEEP and same and steady and moved:
            settled = True
            break
    assert found is not None  # max_iterations is at least 4
    return Solved(
        x=found.x,
        cov=found.cov,
        cross=found.cross,
        last=found.last,
        groups=found.groups,
        factors=last,
        n_solutions=stage - first + 1,
        settled=settled,
    )


def first_offset(at: Sampled, observed: Observed) -> ArrayF:
    """Median place (3,) off the way of the first hundred observations."""
    off = []
    if observed.antenna is not None:
        off.append((observed.antenna.position_wcs_m - at.way_m[observed.antenna.node])[:100])
    if observed.camera is not None:
        off.append((observed.camera.position_wcs_m - at.way_m[observed.camera.node])[:100])
    return np.asarray(np.median(np.concatenate(off), axis=0))


def smooth(
    x: ArrayF,
    at: Sampled,
    nodes: Nodes,
    observed: Observed,
    layout: Layout,
    settings: FusionSettings,
    factors: Factors,
    *,
    start_m: ArrayF,
    clock_start_s: float,
    part: int = POSE,
    rows: Rows | None = None,
) -> Solved:
    """One solution, linearised at states ``x`` (m, n); covariances of the first ``part`` states.

    ``rows``: `linearised` at ``x``, if they are known already.
    """
    t = transitions(
        nodes,
        layout,
        settings,
        factors,
        start_m=start_m,
        antenna=observed.antenna,
        camera=observed.camera,
        clock_start_s=clock_start_s,
    )
    rows = (linearised(x, at, observed, layout, settings) if rows is None else rows).weighted(factors)
    m, n, r = len(nodes.t_gps_s), layout.n, len(rows.y)
    first_row = np.searchsorted(rows.node, np.arange(m + 1))
    xf, Pf = np.empty((m, n)), np.empty((m, n, n))
    K, S, nu = np.empty((r, n)), np.empty(r), np.empty(r)
    chain = (t.walk, t.phi, t.q, layout.camera, t.image_of, t.G, t.W, first_row, rows.H)
    forward(t.x0, t.p0, t.pair, *chain, rows.y, xf, Pf, K, S, nu)
    xs, cov, cross = np.empty((m, n)), np.empty((m, part, part)), np.zeros((m, part, part))
    squares, redundancy, pairs, of_rows = np.zeros(n), np.zeros(n), np.zeros((3, 2)), np.empty((r, 2))
    backward(
        t.p0,
        t.pair,
        nodes.kind,
        *chain,
        xf,
        Pf,
        K,
        S,
        nu,
        part,
        xs,
        cov,
        cross,
        squares,
        redundancy,
        pairs,
        of_rows,
    )
    groups = {
        g: (float(squares[s].sum()), float(redundancy[s].sum()))
        for g in GROUPS
        for s in [np.array(layout.states_of(g), dtype=np.int64)]
    }
    groups["velocity"] = (float(pairs[[INS, RESET], 0].sum()), float(pairs[[INS, RESET], 1].sum()))
    groups["acceleration"] = (float(pairs[MODEL, 0]), float(pairs[MODEL, 1]))
    white, own = of_rows[rows.of_antenna == 1], of_rows[rows.of_antenna == 0]
    for group, share in (("gnss_white", white), ("camera", own)):
        square, taken = groups[group]
        groups[group] = (square + float(share[:, 0].sum()), taken + float(share[:, 1].sum()))
    return Solved(
        x=xs, cov=cov, cross=cross, last=Pf[-1], groups=groups, factors=factors, n_solutions=1, settled=False
    )


def linearised(x: ArrayF, at: Sampled, observed: Observed, layout: Layout, settings: FusionSettings) -> Rows:
    """Rows of all observations that are not rejected, for sigmas as stated."""
    parts = []
    antenna, camera = observed.antenna, observed.camera
    n = layout.n
    if antenna is not None:
        use = observed.weight_antenna > 0
        H, y = antenna_rows(x[antenna.node], _take(at, antenna.node), antenna, layout, settings)
        H, y = whitened(H[use], y[use], antenna.root_m[use])
        variance = settings.gnss_white_share + 1.0 / observed.weight_antenna[use] - 1.0
        parts.append((H, y, antenna.node[use], variance))
    else:
        parts.append((np.zeros((0, 3, n)), np.zeros((0, 3)), np.zeros(0, dtype=np.int64), np.zeros(0)))
    if camera is not None:
        use = observed.weight_camera > 0
        H, y = camera_rows(x[camera.node], _take(at, camera.node), camera, layout, settings)
        H, y = whitened(H[use], y[use], camera.root[use])
        variance = WHITE_SHARE + 1.0 / observed.weight_camera[use] - 1.0
        parts.append((H, y, camera.node[use], variance))
    return stacked(parts)


def judge(
    x: ArrayF,
    at: Sampled,
    observed: Observed,
    layout: Layout,
    settings: FusionSettings,
    factors: Factors,
    *,
    stage: int,
) -> None:
    """Total errors of all observations at states ``x``, and the weights of the next solution."""
    antenna, camera = observed.antenna, observed.camera
    probability = settings.outlier_probability
    if antenna is not None:
        states = x[antenna.node]
        H, y = antenna_rows(states, _take(at, antenna.node), antenna, layout, settings)
        H[:, :, layout.gnss : layout.gnss + 3] = 0.0
        left = np.linalg.solve(antenna.root_m, y[:, :, None] - H @ states[:, :, None])[:, :, 0]
        white = settings.gnss_white_share
        scale = (1 - white) * factors["gnss"] ** 2 + white * factors["gnss_white"] ** 2
        size = np.linalg.norm(left, axis=1) / np.sqrt(scale)
        limit = float(np.sqrt(chi2.isf(probability, 3)))
        weight = _weights(size / _scale(size, 3, stage), limit, stage)
        weight = np.where(observed.doubtful_antenna, (size <= limit) * 1.0, weight)
        observed.weight_antenna = _kept_out(weight, observed.weight_antenna, stage)
        observed.normalised_antenna = size
    if camera is not None:
        states = x[camera.node]
        H, y = camera_rows(states, _take(at, camera.node), camera, layout, settings)
        H[:, :, layout.camera : layout.camera + 6] = 0.0
        left = np.linalg.solve(camera.root, y[:, :, None] - H @ states[:, :, None])[:, :, 0]
        late = states[:, layout.jitter] / factors["jitter"]
        size = np.sqrt(np.sum((left / factors["camera"]) ** 2, axis=1) + late**2)
        limit = float(np.sqrt(chi2.isf(probability, 7)))
        weight = _weights(size / _scale(size, 7, stage), limit, stage)
        weight = np.where(observed.doubtful_camera, (size <= limit) * 1.0, weight)
        observed.weight_camera = _kept_out(weight, observed.weight_camera, stage)
        observed.normalised_camera = size


def rescaled(factors: Factors, groups: dict[str, tuple[float, float]]) -> Factors:
    """Factors of the sigmas by the variance components of a solution; what is stated weighs a little."""
    out = dict(factors)
    for group in SCALED:
        square, redundancy = groups[group]
        # the prior observations are of the stated size: in units of the present one 1 / factor^2
        prior = PRIOR_REDUNDANCY / factors[group] ** 2
        change = np.sqrt((square + prior) / (redundancy + PRIOR_REDUNDANCY))
        out[group] = float(np.clip(factors[group] * change, *FACTORS))
    return out


def _scale(size: ArrayF, k: int, stage: int) -> float:
    """How much too small the sigmas are at least, before they are estimated: else all would be rejected."""
    if stage >= _HUBER + _STEEP or not len(size):
        return 1.0
    return max(1.0, float(np.median(size) / np.sqrt(chi2.ppf(0.5, k))))


def _weights(size: ArrayF, limit: float, stage: int) -> ArrayF:
    """Weights (k,) of errors by their sizes, by the stage."""
    share = np.minimum(1.0, limit / np.maximum(size, 1e-12))
    if stage < _HUBER:
        return np.asarray(share)
    if stage < _HUBER + _STEEP:
        return np.asarray(np.maximum(share**4, 1e-9))
    return np.where(share < 1.0, 0.0, 1.0)


def _kept_out(weight: ArrayF, before: ArrayF, stage: int) -> ArrayF:
    """In the end nothing that was rejected comes back: two sets could take turns for ever."""
    return np.where(before == 0, 0.0, weight) if stage >= _HUBER + _STEEP + _READMIT else weight


def _take(at: Sampled, node: ArrayI) -> Sampled:
    return Sampled(
        R_wcs_ics=at.R_wcs_ics[node],
        axes=at.axes[node],
        sigma_rad=at.sigma_rad[node],
        way_m=at.way_m[node],
        velocity_mps=at.velocity_mps[node],
        rate_radps=at.rate_radps[node],
    )


def _moved(old: ArrayF, new: ArrayF, at: Sampled) -> bool:
    """Whether a solution left positions and attitudes where they were."""
    d = np.abs(new[:, :3] - old[:, :3]).max()
    a = (np.abs(new[:, 6:9] - old[:, 6:9]) * at.sigma_rad).max()
    return bool(d < _STILL_M and a < _STILL_RAD)


# ---------------------------------------------------------------- observations that jump against the INS
#
# By multipath or a wrong fix a track jumps aside and, seconds later, back; a wrong image stands alone. A
# smoother that starts with them follows them, because that is how it is told that the INS errs, and no
# later test sees what is wrong. But what is left against the INS alone, ``z - way - R l`` and the turn
# between image and INS, changes slowly. The series is cut where it does not; from the longest piece on,
# each next piece must continue the last good one within what the INS can have drifted in between.


def jumped_positions(antenna: Antenna, reference: Reference, settings: FusionSettings) -> ArrayB:
    """Positions (k,) in pieces of the track that do not fit to its longest piece along the INS's way."""
    t = antenna.t_gps_s
    at = reference.at(t)
    b = antenna.position_wcs_m - at.way_m - at.R_wcs_ics @ antenna.lever_ics_m
    sigma = np.linalg.norm(antenna.root_m, axis=2)
    without = _without_velocity(t, reference)
    white = settings.gnss_white_share

    def variance(i: ArrayI, j: ArrayI) -> ArrayF:
        """Noise of both, what their slow errors can have changed, and the drift of the way."""
        both = np.maximum(sigma[i], sigma[j]) ** 2
        alike = np.exp(-np.abs(t[j] - t[i]) / settings.gnss_time_s)[:, None]
        drift = _way_m2(np.abs(t[j] - t[i]), np.abs(without[j] - without[i]), settings)
        return np.asarray(2 * both * (white + (1 - white) * (1 - alike)) + drift[:, None])

    return _doubtful(b, variance, _ENDS)


def jumped_images(camera: Camera, reference: Reference, settings: FusionSettings) -> ArrayB:
    """Images (k,) whose poses do not fit to the others along the INS's way and turns."""
    t = camera.t_gps_s
    at = reference.at(t)
    turn = rotation_vector(camera.R_wcs_ics @ np.swapaxes(at.R_wcs_ics, 1, 2))
    b = np.concatenate([camera.position_wcs_m - at.way_m, turn], axis=1)
    own = np.sum(camera.root**2, axis=2)
    # without the INS's velocity the motion is not known here; the time's jitter moves the boat by it
    moving = np.concatenate([at.velocity_mps, at.rate_radps], axis=1)
    own = own + (camera.jitter_s[:, None] * moving) ** 2
    without = _without_velocity(t, reference)
    heading = np.deg2rad(settings.heading_disturbance_deg)
    angle = np.sqrt(np.max(at.sigma_rad, axis=1) ** 2 + heading**2)

    def variance(i: ArrayI, j: ArrayI) -> ArrayF:
        """Errors of both images, and the drift of the INS."""
        step = np.abs(t[j] - t[i])
        drift = np.empty((len(step), 6))
        drift[:, :3] = _way_m2(step, np.abs(without[j] - without[i]), settings)[:, None]
        turned = 2 * np.maximum(angle[i], angle[j]) ** 2 * -np.expm1(-step / settings.attitude_time_s)
        drift[:, 3:] = turned[:, None]
        return np.asarray(own[i] + own[j] + drift)

    return _doubtful(b, variance, 1)


def _doubtful(b: ArrayF, variance: Variance, ends: int) -> ArrayB:
    """Members (k,) of a series (k, d) in pieces that do not continue its longest one."""
    n, d = b.shape
    out = np.zeros(n, dtype=np.bool_)
    if n < 3:
        return out
    every = np.arange(n)
    step = np.sqrt(np.sum(np.diff(b, axis=0) ** 2 / variance(every[:-1], every[1:]), axis=1))
    # sigmas that are stated too small must not cut everything
    scale = max(1.0, float(np.median(step) / np.sqrt(chi2.ppf(0.5, d))))
    limit = scale * float(np.sqrt(chi2.isf(_IMPROBABLE, d)))
    bounds = np.concatenate([[0], np.flatnonzero(step > limit) + 1, [n]])
    anchor = int(np.argmax(np.diff(bounds)))

    def continues(first: int, second: int) -> bool:
        """Whether a piece goes on where an earlier one stopped."""
        i, j = int(bounds[first + 1]), int(bounds[second])
        jump = np.median(b[j : min(j + ends, int(bounds[second + 1]))], axis=0)
        jump = jump - np.median(b[max(i - ends, int(bounds[first])) : i], axis=0)
        spread = variance(np.array([i - 1]), np.array([j]))[0]
        return bool(np.sqrt(np.sum(jump**2 / spread)) <= limit)

    last = anchor
    for piece in range(anchor + 1, len(bounds) - 1):
        if continues(last, piece):
            last = piece
        else:
            out[bounds[piece] : bounds[piece + 1]] = True
    last = anchor
    for piece in range(anchor - 1, -1, -1):
        if continues(piece, last):
            last = piece
        else:
            out[bounds[piece] : bounds[piece + 1]] = True
    return out if out.mean() <= _MOST else np.zeros(n, dtype=np.bool_)


def _without_velocity(t: ArrayF, reference: Reference) -> ArrayF:
    """Seconds (k,) without a velocity of the INS until each time."""
    blind = np.append(0.0, np.cumsum(np.where(reference.blind, np.diff(reference.t_gps_s), 0.0)))
    return np.asarray(np.interp(t, reference.t_gps_s, blind))


def _way_m2(step_s: ArrayF, blind_s: ArrayF, settings: FusionSettings) -> ArrayF:
    """Variance (m,) of the way over steps, an upper bound."""
    tau = settings.velocity_time_s
    along = settings.sigma_velocity_mps**2 * np.minimum(step_s**2, 2 * tau * step_s)
    return np.asarray(along + (_BLIND_MPS * blind_s) ** 2)


# ---------------------------------------------------------------- compiled loops: Kalman filter forwards,
# modified Bryson-Frazier smoother backwards
#
# The smoother gives the least-squares solution of all observations and of the transitions between nodes
# (Rauch, Tung and Striebel 1965; Bierman 1977, ch. 10). In Bryson and Frazier's form it carries the adjoint
# ``lam`` and its matrix ``Lam`` instead of inverting covariances, so states that do not change from node to
# node (mounts, clock) and states without noise are no trouble::
#
#     x_s = x - P lam                          P_s = P - P Lam P
#     lam- = lam - H^T u                       u = nu / S + K^T lam
#     Lam- = (I - K H)^T Lam (I - K H) + H^T H / S
#     lam of the node before = F^T lam-        w_s = -Q lam-
#
# The same quantities give each group's share of the weighted squares of all residuals and of the redundancy
# (Koopman 1993): ``R u^2`` and ``R (1 / S + K^T Lam K)`` of an observation, ``lam-^T Q lam-`` and
# ``tr(Q Lam-)`` of a transition.
#
# Order of the states: position (3), its rate (3), then single processes ``x' = phi x + w``; six of them may
# be the errors of an image's pose, whose transitions are full matrices.


@njit(cache=True, error_model="numpy")
def _rows(A: ArrayF, f: float, g: float, phi: ArrayF, cam: int, G: ArrayF, keep: ArrayF) -> None:
    """``A <- F A``."""
    n, m = A.shape
    for i in range(3):
        for j in range(m):
            A[i, j] += f * A[3 + i, j]
            A[3 + i, j] *= g
    for i in range(6, n):
        if phi[i] != 1.0:
            for j in range(m):
                A[i, j] *= phi[i]
    if cam >= 0:
        for j in range(m):
            for i in range(6):
                keep[i] = 0.0
                for k in range(6):
                    keep[i] += G[i, k] * A[cam + k, j]
            for i in range(6):
                A[cam + i, j] = keep[i]


@njit(cache=True, error_model="numpy")
def _rows_transposed(A: ArrayF, f: float, g: float, phi: ArrayF, cam: int, G: ArrayF, keep: ArrayF) -> None:
    """``A <- F^T A``."""
    n, m = A.shape
    for i in range(3):
        for j in range(m):
            A[3 + i, j] = f * A[i, j] + g * A[3 + i, j]
    for i in range(6, n):
        if phi[i] != 1.0:
            for j in range(m):
                A[i, j] *= phi[i]
    if cam >= 0:
        for j in range(m):
            for i in range(6):
                keep[i] = 0.0
                for k in range(6):
                    keep[i] += G[k, i] * A[cam + k, j]
            for i in range(6):
                A[cam + i, j] = keep[i]


@njit(cache=True, error_model="numpy")
def _columns(A: ArrayF, f: float, g: float, phi: ArrayF, cam: int, G: ArrayF, keep: ArrayF) -> None:
    """``A <- A F^T``."""
    n, m = A.shape
    for i in range(n):
        for j in range(3):
            A[i, j] += f * A[i, 3 + j]
            A[i, 3 + j] *= g
        for j in range(6, m):
            A[i, j] *= phi[j]
        if cam >= 0:
            for j in range(6):
                keep[j] = 0.0
                for k in range(6):
                    keep[j] += G[j, k] * A[i, cam + k]
            for j in range(6):
                A[i, cam + j] = keep[j]


@njit(cache=True, error_model="numpy")
def _columns_transposed(
    A: ArrayF, f: float, g: float, phi: ArrayF, cam: int, G: ArrayF, keep: ArrayF
) -> None:
    """``A <- A F``."""
    n, m = A.shape
    for i in range(n):
        for j in range(3):
            A[i, 3 + j] = f * A[i, j] + g * A[i, 3 + j]
        for j in range(6, m):
            A[i, j] *= phi[j]
        if cam >= 0:
            for j in range(6):
                keep[j] = 0.0
                for k in range(6):
                    keep[j] += G[k, j] * A[i, cam + k]
            for j in range(6):
                A[i, cam + j] = keep[j]


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "nsz"})
def _dot(a: ArrayF, b: ArrayF) -> float:
    """``a . b``, summed in any order."""
    s = 0.0
    for i in range(len(a)):
        s += a[i] * b[i]
    return s


@njit(cache=True, error_model="numpy")
def forward(
    x0: ArrayF,
    p0: ArrayF,
    pair: ArrayF,
    walk: ArrayF,
    phi: ArrayF,
    q: ArrayF,
    cam: int,
    image_of: ArrayI,
    G: ArrayF,
    W: ArrayF,
    first_row: ArrayI,
    H: ArrayF,
    y: ArrayF,
    x_out: ArrayF,
    P_out: ArrayF,
    K_out: ArrayF,
    S_out: ArrayF,
    nu_out: ArrayF,
) -> None:
    """Filter through all nodes; observations have the variance 1.

    Parameters
    ----------
    x0, p0 : (n,) start and its variances.
    pair : (m, 5) of the transition into each node: ``f, g`` of position and rate, and the noise's variances
        and covariance ``dd, de, ee``; row 0 is not used.
    walk : (m, 3) factors of that noise, east, north, up.
    phi, q : (m, n) of the single processes; columns 0 to 5 are not used.
    cam : first state of the image's errors, or -1.
    image_of : (m,) row of ``G``, ``W`` for the transition into a node, or -1 for none.
    G, W : (k, 6, 6) transitions and noise of the image's errors.
    first_row : (m + 1,) rows of ``H`` by node.
    H, y : (r, n) and (r,) observations.
    x_out, P_out : (m, n), (m, n, n) of the filter, written; or of no length, for the innovations alone.
    K_out, S_out, nu_out : (r, n), (r,), (r,) gain, variance and innovation of each observation, written;
        without ``P_out`` no gain.
    """
    n, m = len(x0), len(first_row) - 1
    x = x0.copy()
    P = np.diag(p0)
    column = np.empty((n, 1))
    keep = np.empty(6)
    ph, gain = np.empty(n), np.empty(n)
    every = len(P_out) > 0
    for node in range(m):
        if node > 0:
            f, g, image = pair[node, 0], pair[node, 1], image_of[node]
            at = cam if image >= 0 else -1
            Gk = G[max(image, 0)]
            column[:, 0] = x
            _rows(column, f, g, phi[node], at, Gk, keep)
            x[:] = column[:, 0]
            _rows(P, f, g, phi[node], at, Gk, keep)
            _columns(P, f, g, phi[node], at, Gk, keep)
            for i in range(3):
                P[i, i] += walk[node, i] * pair[node, 2]
                P[i, 3 + i] += walk[node, i] * pair[node, 3]
                P[3 + i, i] += walk[node, i] * pair[node, 3]
                P[3 + i, 3 + i] += walk[node, i] * pair[node, 4]
            for i in range(6, n):
                P[i, i] += q[node, i]
            if at >= 0:
                for i in range(6):
                    for j in range(6):
                        P[at + i, at + j] += W[image, i, j]
        for row in range(first_row[node], first_row[node + 1]):
            h = H[row]
            S, nu = 1.0, y[row]
            ph[:] = 0.0
            # by the few states that the observation depends on; P is symmetric
            for j in range(n):
                hj = h[j]
                if hj != 0.0:
                    for i in range(n):
                        ph[i] += P[j, i] * hj
                    nu -= hj * x[j]
            for i in range(n):
                S += h[i] * ph[i]
            # Joseph's form: the loss of digits by a weak start stays small
            for i in range(n):
                gain[i] = ph[i] / S
                x[i] += gain[i] * nu
            for i in range(n):
                ki, pi = gain[i], ph[i]
                for j in range(n):
                    P[i, j] += ki * gain[j] * S - (ki * ph[j] + pi * gain[j])
            if every:
                K_out[row] = gain
            S_out[row], nu_out[row] = S, nu
        if every:
            x_out[node] = x
            P_out[node] = P


@njit(cache=True, error_model="numpy")
def backward(
    p0: ArrayF,
    pair: ArrayF,
    kind: ArrayI,
    walk: ArrayF,
    phi: ArrayF,
    q: ArrayF,
    cam: int,
    image_of: ArrayI,
    G: ArrayF,
    W: ArrayF,
    first_row: ArrayI,
    H: ArrayF,
    x: ArrayF,
    P: ArrayF,
    K: ArrayF,
    S: ArrayF,
    nu: ArrayF,
    part: int,
    x_out: ArrayF,
    cov_out: ArrayF,
    cross_out: ArrayF,
    squares: ArrayF,
    redundancy: ArrayF,
    pairs: ArrayF,
    rows: ArrayF,
) -> None:
    """Smooth what `forward` found.

    Parameters
    ----------
    p0, pair, walk, phi, q, cam, image_of, G, W, first_row, H : as in `forward`.
    kind : (m,) kind of the transition of position and rate into each node, row of ``pairs``.
    x, P, K, S, nu : what `forward` wrote.
    part : the first ``part`` states get covariances; no transition may lead into them from others, and the
        image's errors are among them as a whole or not at all.
    x_out : (m, n) smoothed states, written.
    cov_out, cross_out : (m, part, part) covariance of a node, and with the next node, written.
    squares, redundancy : (n,) by single process, the image's errors under their first state; added to.
    pairs : (kinds, 2) squares and redundancy of position and rate by kind of transition; added to.
    rows : (r, 2) squares and redundancy of each observation, written.
    """
    m, n = x.shape
    lam = np.zeros(n)
    Lam = np.zeros((n, n))
    column = np.empty((n, 1))
    keep = np.empty(6)
    kl = np.empty(n)
    U, less = np.empty((part, n)), np.empty((part, part))
    for node in range(m - 1, -1, -1):
        Pk = P[node]
        for i in range(n):
            x_out[node, i] = x[node, i]
            for j in range(n):
                x_out[node, i] -= Pk[i, j] * lam[j]
        # covariance of the first states: P - P Lam P
        np.dot(Pk[:part], Lam, U)
        np.dot(U, Pk[:part].T, less)
        for i in range(part):
            for j in range(part):
                cov_out[node, i, j] = Pk[i, j] - less[i, j]
        for i in range(part):
            for j in range(i):
                s = 0.5 * (cov_out[node, i, j] + cov_out[node, j, i])
                cov_out[node, i, j] = s
                cov_out[node, j, i] = s
        if node < m - 1:
            # cross_out holds P F^T Lam- Q of the transition; P_s F^T goes before it
            f, g = pair[node + 1, 0], pair[node + 1, 1]
            for i in range(part):
                for j in range(3):
                    a, b = cov_out[node, i, j], cov_out[node, i, 3 + j]
                    cross_out[node, i, j] = a + f * b - cross_out[node, i, j]
                    cross_out[node, i, 3 + j] = g * b - cross_out[node, i, 3 + j]
                for j in range(6, part):
                    cross_out[node, i, j] = phi[node + 1, j] * cov_out[node, i, j] - cross_out[node, i, j]
                if 0 <= cam < part and image_of[node + 1] >= 0:
                    for j in range(6):
                        # phi is 1 there: what stands there is P_s less the part by the noise
                        s = cross_out[node, i, cam + j] - cov_out[node, i, cam + j]
                        for k in range(6):
                            s += G[image_of[node + 1], j, k] * cov_out[node, i, cam + k]
                        cross_out[node, i, cam + j] = s
        for row in range(first_row[node + 1] - 1, first_row[node] - 1, -1):
            u, d = nu[row] / S[row], 1.0 / S[row]
            kl[:] = 0.0
            for j in range(n):
                a = K[row, j]
                for i in range(n):
                    kl[i] += Lam[j, i] * a
                u += a * lam[j]
            for i in range(n):
                d += K[row, i] * kl[i]
            # (I - K H)^T first, then (I - K H): at a weak start, where K H is nearly 1, the expanded
            # product would leave rounding errors of Lam that the great P multiplies twice
            for i in range(n):
                hi, s = H[row, i], kl[i]
                if hi != 0.0:
                    lam[i] -= hi * u
                    for j in range(n):
                        Lam[i, j] -= hi * kl[j]
                    s = _dot(Lam[i], K[row])
                own = hi / S[row]
                for j in range(n):
                    Lam[i, j] = (Lam[i, j] - s * H[row, j]) + own * H[row, j]
            rows[row, 0], rows[row, 1] = u * u, d
        if node == 0:
            for i in range(6, n):
                squares[i] += p0[i] * lam[i] * lam[i]
                redundancy[i] += p0[i] * Lam[i, i]
            break
        image = image_of[node]
        at = cam if image >= 0 else -1
        Gk = G[max(image, 0)]
        dd, de, ee = pair[node, 2], pair[node, 3], pair[node, 4]
        for i in range(3):
            a, b = lam[i], lam[3 + i]
            own = dd * Lam[i, i] + 2.0 * de * Lam[i, 3 + i] + ee * Lam[3 + i, 3 + i]
            pairs[kind[node], 0] += walk[node, i] * (dd * a * a + 2.0 * de * a * b + ee * b * b)
            pairs[kind[node], 1] += walk[node, i] * own
        for i in range(6, n):
            squares[i] += q[node, i] * lam[i] * lam[i]
            redundancy[i] += q[node, i] * Lam[i, i]
        if at >= 0:
            for i in range(6):
                for j in range(6):
                    squares[at] += W[image, i, j] * lam[at + i] * lam[at + j]
                    redundancy[at] += W[image, i, j] * Lam[at + i, at + j]
        f, g = pair[node, 0], pair[node, 1]
        column[:, 0] = lam
        _rows_transposed(column, f, g, phi[node], at, Gk, keep)
        lam[:] = column[:, 0]
        _rows_transposed(Lam, f, g, phi[node], at, Gk, keep)
        Pb = P[node - 1]
        for i in range(part):
            for j in range(part):
                U[i, j] = 0.0
            for k in range(n):
                a = Pb[i, k]
                for j in range(part):
                    U[i, j] += a * Lam[k, j]
            for j in range(3):
                a, b = U[i, j], U[i, 3 + j]
                cross_out[node - 1, i, j] = walk[node, j] * (a * dd + b * de)
                cross_out[node - 1, i, 3 + j] = walk[node, j] * (a * de + b * ee)
            for j in range(6, part):
                cross_out[node - 1, i, j] = U[i, j] * q[node, j]
            if at >= 0 and at < part:
                for j in range(6):
                    s = 0.0
                    for k in range(6):
                        s += U[i, at + k] * W[image, k, j]
                    cross_out[node - 1, i, at + j] = s
        _columns_transposed(Lam, f, g, phi[node], at, Gk, keep)
        for i in range(n):
            for j in range(i):
                Lam[i, j] = 0.5 * (Lam[i, j] + Lam[j, i])
                Lam[j, i] = Lam[i, j]
