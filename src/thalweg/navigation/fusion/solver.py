"""Iterated solution: poses, weights against wrong observations, and sizes of the errors.

Wrong observations are met in three stages. First Huber's weights on the *total* error of an observation (its
slow part and its white part together, in units of its stated covariance): a jump by multipath that lasts for
seconds looks like a slow error, and only its size tells. Then weights that fall with the fourth power. Last,
an observation counts fully or not at all. Weights act on the white part: extra noise of its own.

Sizes of the errors are variance components (Foerstner 1979; Koch 1999, 3.6): the weighted squares of the
residuals of a group over its redundancy, both from the smoother.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.navigation.fusion import kernels
from thalweg.navigation.fusion.inputs import INS, MODEL, RESET, Antenna, Camera, Nodes
from thalweg.navigation.fusion.model import (
    Factors,
    Rows,
    antenna_rows,
    camera_rows,
    stacked,
    transitions,
    weighted,
)
from thalweg.navigation.fusion.settings import (
    FACTORS,
    GROUPS,
    POSE,
    PRIOR_REDUNDANCY,
    SCALED,
    WHITE_SHARE,
    FusionSettings,
    Layout,
)
from thalweg.navigation.ins_gnss.reference import Reference, Sampled

_HUBER, _STEEP = 3, 5
"""Solutions with Huber's weights, and those until an observation counts fully or not at all."""

_READMIT = 6
"""Solutions of the last stage after which a rejected observation stays rejected."""

_STILL_M, _STILL_RAD, _STILL_FACTOR = 5e-5, 5e-6, 0.02
"""Greatest change of positions, angles and factors (relative) of the last solution."""


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
    the next one, ``last`` (n, n) covariance of all states at the last node, ``groups`` weighted squares and
    redundancy by group, ``factors`` of the sigmas, ``n_solutions``, ``settled`` whether nothing moved at the
    end.
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
        x=found.x, cov=found.cov, cross=found.cross, last=found.last, groups=found.groups, factors=last,
        n_solutions=stage - first + 1, settled=settled,
    )  # fmt: skip


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
) -> Solved:
    """One solution, linearised at states ``x`` (m, n)."""
    t = transitions(
        nodes, layout, settings, factors,
        start_m=start_m, antenna=observed.antenna, camera=observed.camera, clock_start_s=clock_start_s,
    )  # fmt: skip
    rows = linearised(x, at, observed, layout, settings, factors)
    m, n, r = len(nodes.t_gps_s), layout.n, len(rows.y)
    first_row = np.searchsorted(rows.node, np.arange(m + 1))
    xf, Pf = np.empty((m, n)), np.empty((m, n, n))
    K, S, nu = np.empty((r, n)), np.empty(r), np.empty(r)
    chain = (t.walk, t.phi, t.q, layout.camera, t.image_of, t.G, t.W, first_row, rows.H)
    kernels.forward(t.x0, t.p0, t.pair, *chain, rows.y, xf, Pf, K, S, nu)
    xs, cov, cross = np.empty((m, n)), np.empty((m, POSE, POSE)), np.zeros((m, POSE, POSE))
    squares, redundancy, pairs, of_rows = np.zeros(n), np.zeros(n), np.zeros((3, 2)), np.empty((r, 2))
    kernels.backward(
        t.p0, t.pair, nodes.kind, *chain, xf, Pf, K, S, nu, POSE, xs, cov, cross, squares, redundancy, pairs,
        of_rows,
    )  # fmt: skip
    groups = {g: (float(squares[s].sum()), float(redundancy[s].sum()))
              for g in GROUPS for s in [np.array(layout.states_of(g), dtype=np.int64)]}  # fmt: skip
    groups["velocity"] = (float(pairs[[INS, RESET], 0].sum()), float(pairs[[INS, RESET], 1].sum()))
    groups["acceleration"] = (float(pairs[MODEL, 0]), float(pairs[MODEL, 1]))
    white, own = of_rows[rows.of_antenna == 1], of_rows[rows.of_antenna == 0]
    for group, share in (("gnss_white", white), ("camera", own)):
        square, taken = groups[group]
        groups[group] = (square + float(share[:, 0].sum()), taken + float(share[:, 1].sum()))
    return Solved(
        x=xs, cov=cov, cross=cross, last=Pf[-1], groups=groups, factors=factors, n_solutions=1, settled=False
    )


def linearised(
    x: ArrayF, at: Sampled, observed: Observed, layout: Layout, settings: FusionSettings, factors: Factors
) -> Rows:
    """Weighted rows of all observations that are not rejected."""
    parts = []
    antenna, camera = observed.antenna, observed.camera
    n = layout.n
    if antenna is not None:
        use = observed.weight_antenna > 0
        H, y = antenna_rows(x[antenna.node], _take(at, antenna.node), antenna, layout, settings)
        variance = settings.gnss_white_share + 1.0 / np.where(use, observed.weight_antenna, 1.0) - 1.0
        H, y = weighted(H[use], y[use], antenna.root_m[use], variance[use] * factors["gnss_white"] ** 2)
        parts.append((H, y, antenna.node[use]))
    else:
        parts.append((np.zeros((0, 3, n)), np.zeros((0, 3)), np.zeros(0, dtype=np.int64)))
    if camera is not None:
        use = observed.weight_camera > 0
        H, y = camera_rows(x[camera.node], _take(at, camera.node), camera, layout, settings)
        variance = WHITE_SHARE + 1.0 / np.where(use, observed.weight_camera, 1.0) - 1.0
        H, y = weighted(H[use], y[use], camera.root[use], variance[use] * factors["camera"] ** 2)
        parts.append((H, y, camera.node[use]))
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
        R_wcs_ics=at.R_wcs_ics[node], axes=at.axes[node], sigma_rad=at.sigma_rad[node], way_m=at.way_m[node],
        velocity_mps=at.velocity_mps[node], rate_radps=at.rate_radps[node],
    )  # fmt: skip


def _moved(old: ArrayF, new: ArrayF, at: Sampled) -> bool:
    """Whether a solution left positions and attitudes where they were."""
    d = np.abs(new[:, :3] - old[:, :3]).max()
    a = (np.abs(new[:, 6:9] - old[:, 6:9]) * at.sigma_rad).max()
    return bool(d < _STILL_M and a < _STILL_RAD)
