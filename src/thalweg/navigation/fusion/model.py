"""Transitions between nodes, and observations linearised at a trajectory.

Position ``p = way + d`` with ``d' = e``; along the INS's velocity ``e`` is its error, a Gauss-Markov process
(so ``d`` is an integrated one), without it the boat's own velocity, a random walk. The attitude is
``R = exp([theta]x) R_ins`` with ``theta`` the sum of the errors of roll, pitch and heading about their axes.

    antenna   z = p + R (l + dl) + L g + white
    image     z_p = p + v (c + j) - e_p,    z_R = exp(-e_R) exp(omega (c + j)) R
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.propagation import cross_matrix
from thalweg.core.rigid import exp_rotation, rotation_vector
from thalweg.core.types import ArrayF, ArrayI
from thalweg.navigation.fusion.inputs import MODEL, RESET, Antenna, Camera, Nodes
from thalweg.navigation.fusion.settings import (
    START_SIGMA_M,
    START_SPEED_MPS,
    WHITE_SHARE,
    FusionSettings,
    Layout,
)
from thalweg.navigation.ins_gnss.reference import Sampled

Factors = dict[str, float]
"""By group of errors: factor of its sigma."""

LEAST_CLOCK_S: Final = 1e-12
"""Unit of the clock's state where no offset and no walk are allowed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Transitions:
    """What `thalweg.navigation.fusion.kernels` takes: see there."""

    x0: ArrayF
    p0: ArrayF
    pair: ArrayF
    walk: ArrayF
    phi: ArrayF
    q: ArrayF
    image_of: ArrayI
    G: ArrayF
    W: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class Rows:
    """Observations with the variance 1: ``H`` (r, n), ``y`` (r,), and the node (r,) of each, in order.

    ``of_antenna`` (r,) tells the group of each.
    """

    H: ArrayF
    y: ArrayF
    node: ArrayI
    of_antenna: ArrayI


def pair_transition(step_s: ArrayF, kind: ArrayI, settings: FusionSettings, factors: Factors) -> ArrayF:
    """``f, g, dd, de, ee`` (m, 5) of position and rate over steps of a kind.

    Integrated Gauss-Markov process (Gelb 1974, 4.6) with ``E = exp(-T / tau)``: ``f = tau (1 - E)``,
    ``ee = s^2 (1 - E^2)``, ``de = s^2 tau (1 - E)^2``,
    ``dd = 2 s^2 tau^2 (T / tau - 2 (1 - E) + (1 - E^2) / 2)``; or the random walk of a velocity.
    """
    T = np.asarray(step_s, dtype=np.float64)
    tau, s2 = settings.velocity_time_s, (settings.sigma_velocity_mps * factors["velocity"]) ** 2
    x = T / tau
    loss = -np.expm1(-x)
    # below 0.02 the three terms cancel to their third order
    exact = x - 2 * loss - np.expm1(-2 * x) / 2
    series = x**3 * (1 / 3 - x / 4 + 7 * x**2 / 60 - x**3 / 24)
    dd = 2 * s2 * tau**2 * np.where(x < 0.02, series, exact)
    along = [tau * loss, 1 - loss, dd, s2 * tau * loss**2, -s2 * np.expm1(-2 * x)]
    walk = (settings.sigma_acceleration * factors["acceleration"]) ** 2
    free = [T, np.ones_like(T), walk * T**3 / 3, walk * T**2 / 2, walk * T]
    out = np.where((kind == MODEL)[:, None], np.stack(free, axis=-1), np.stack(along, axis=-1))
    out[kind == RESET] = [0.0, 0.0, 0.0, 0.0, s2]
    return np.asarray(out)


def transitions(
    nodes: Nodes,
    layout: Layout,
    settings: FusionSettings,
    factors: Factors,
    *,
    start_m: ArrayF,
    antenna: Antenna | None,
    camera: Camera | None,
    clock_start_s: float,
) -> Transitions:
    """Start and transitions of all states.

    ``start_m`` (3,): first guess of the position off the way; ``clock_start_s``: prior mean of the clock
    offset, which is not zero once the images' nodes have been moved by what was found.
    """
    m, n = len(nodes.t_gps_s), layout.n
    step = np.diff(nodes.t_gps_s, prepend=nodes.t_gps_s[0])
    phi, q = np.ones((m, n)), np.zeros((m, n))
    x0, p0 = np.zeros(n), np.ones(n)
    x0[:3], p0[:3] = start_m, START_SIGMA_M**2
    starts_blind = len(nodes.kind) > 1 and nodes.kind[1] == MODEL
    sigma_rate = START_SPEED_MPS if starts_blind else settings.sigma_velocity_mps * factors["velocity"]
    p0[3:6] = sigma_rate**2
    processes = [
        ("roll_pitch", settings.attitude_time_s),
        ("heading", settings.attitude_time_s),
        ("disturbance", settings.disturbance_time_s),
        ("gnss", settings.gnss_time_s),
    ]
    for group, time in processes:
        for i in layout.states_of(group):
            phi[:, i] = np.exp(-step / time)
            q[:, i] = -np.expm1(-2 * step / time) * factors[group] ** 2
            p0[i] = factors[group] ** 2
    if antenna is not None:
        anew = np.ix_(antenna.node[antenna.begins], np.array(layout.states_of("gnss"), dtype=np.int64))
        phi[anew], q[anew] = 0.0, factors["gnss"] ** 2
    image_of = np.full(m, -1, dtype=np.int64)
    G, W = np.zeros((1, 6, 6)), np.zeros((1, 6, 6))
    if camera is not None:
        image_of[camera.node] = np.arange(len(camera.node))
        G, W = camera.G, camera.W * factors["camera"] ** 2
        p0[layout.camera : layout.camera + 6] = factors["camera"] ** 2
        unit = clock_unit(settings)
        x0[layout.clock] = clock_start_s / unit
        p0[layout.clock] = (settings.sigma_clock_offset_s / unit) ** 2
        q[:, layout.clock] = step * (settings.clock_walk_s / unit) ** 2
        phi[camera.node, layout.jitter] = 0.0
        q[camera.node, layout.jitter] = p0[layout.jitter] = factors["jitter"] ** 2
    pair = pair_transition(step, nodes.kind, settings, factors)
    return Transitions(x0=x0, p0=p0, pair=pair, walk=nodes.walk, phi=phi, q=q, image_of=image_of, G=G, W=W)


def clock_unit(settings: FusionSettings) -> float:
    """Unit of the clock's state, seconds."""
    return max(settings.sigma_clock_offset_s, settings.clock_walk_s, LEAST_CLOCK_S)


def attitude(x: ArrayF, reference: Sampled, settings: FusionSettings) -> tuple[ArrayF, ArrayF]:
    """``R_wcs_ics`` (n, 3, 3) and the derivative (n, 3, 4) of its small rotation vector in wcs.

    By the errors of roll, pitch, heading and by the heading's disturbance.

    Parameters
    ----------
    x : (n, 10) or more states, of which 6 to 9 are used.
    reference : the INS at the same times.
    """
    disturbance = np.deg2rad(settings.heading_disturbance_deg)
    by_angle = np.concatenate([
        np.swapaxes(reference.axes, 1, 2) * reference.sigma_rad[:, None, :],
        disturbance * reference.axes[:, 2, :, None],
    ], axis=2)  # fmt: skip
    theta = np.einsum("nij,nj->ni", by_angle, x[:, 6:10])
    K = cross_matrix(theta)
    # left Jacobian of the exponential to second order: 0.2 rad to the third over 24 are 3e-4 of an error
    J = np.eye(3) + K / 2 + K @ K / 6
    return exp_rotation(theta) @ reference.R_wcs_ics, J @ by_angle


def antenna_rows(
    x: ArrayF, at: Sampled, antenna: Antenna, layout: Layout, settings: FusionSettings
) -> tuple[ArrayF, ArrayF]:
    """Derivatives (k, 3, n) and reduced observations (k, 3) of the antenna, not yet weighted.

    ``x`` (k, n) states at the nodes of the positions; ``y = z - h(x) + H x``.
    """
    R, by_angle = attitude(x, at, settings)
    dl = x[:, layout.lever : layout.lever + 3] * antenna.sigma_lever_m
    arm = np.einsum("nij,nj->ni", R, antenna.lever_ics_m + dl)
    slow = np.einsum("nij,nj->ni", antenna.root_m, x[:, layout.gnss : layout.gnss + 3])
    share = np.sqrt(1 - settings.gnss_white_share)
    H = np.zeros((len(x), 3, layout.n))
    H[:, :, :3] = np.eye(3)
    H[:, :, 6:10] = -cross_matrix(arm) @ by_angle
    H[:, :, layout.gnss : layout.gnss + 3] = share * antenna.root_m
    H[:, :, layout.lever : layout.lever + 3] = R * antenna.sigma_lever_m
    off = antenna.position_wcs_m - at.way_m - x[:, :3] - arm - share * slow
    return H, off + np.einsum("nij,nj->ni", H, x)


def camera_rows(
    x: ArrayF, at: Sampled, camera: Camera, layout: Layout, settings: FusionSettings
) -> tuple[ArrayF, ArrayF]:
    """Derivatives (k, 6, n) and reduced observations (k, 6) of the images, not yet weighted."""
    R, by_angle = attitude(x, at, settings)
    moving = np.concatenate([at.velocity_mps + x[:, 3:6], at.rate_radps], axis=1)
    H = np.zeros((len(x), 6, layout.n))
    H[:, :3, :3] = np.eye(3)
    H[:, 3:, 6:10] = by_angle
    H[:, :, layout.camera : layout.camera + 6] = -np.sqrt(1 - WHITE_SHARE) * camera.root
    H[:, :, layout.mount : layout.mount + 6] = -camera.by_mount
    H[:, :, layout.clock] = moving * clock_unit(settings)
    H[:, :, layout.jitter] = moving * camera.jitter_s[:, None]
    off = np.concatenate([
        camera.position_wcs_m - at.way_m - x[:, :3],
        rotation_vector(camera.R_wcs_ics @ np.swapaxes(R, 1, 2)),
    ], axis=1)  # fmt: skip
    linear = H[:, :, 10:] @ x[:, 10:, None]
    y = off - linear[:, :, 0] + np.einsum("nij,nj->ni", H, x)
    return H, y


def weighted(H: ArrayF, y: ArrayF, root: ArrayF, variance: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Rows of the variance 1: noise is ``root`` times white noise of a variance (k,) a component."""
    scale = 1.0 / np.sqrt(variance)
    both = np.linalg.solve(root, np.concatenate([H, y[:, :, None]], axis=2)) * scale[:, None, None]
    return both[:, :, :-1], both[:, :, -1]


def stacked(parts: list[tuple[ArrayF, ArrayF, ArrayI]]) -> Rows:
    """Rows of antenna (first part) and images in the order of their nodes."""
    H = np.concatenate([h.reshape(-1, h.shape[-1]) for h, _, _ in parts])
    y = np.concatenate([v.ravel() for _, v, _ in parts])
    node = np.concatenate([np.repeat(k, v.shape[1]) for _, v, k in parts])
    group = np.concatenate([np.full(v.size, i) for i, (_, v, _) in enumerate(parts)])
    order = np.argsort(node, kind="stable")
    return Rows(
        H=np.ascontiguousarray(H[order]), y=np.ascontiguousarray(y[order]), node=node[order],
        of_antenna=(group[order] == 0).astype(np.int64),
    )  # fmt: skip
