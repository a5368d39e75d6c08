"""States and observations of the fused trajectory: nodes, transitions, linearisation."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final, Self

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from pydantic import Field
from scipy.spatial.transform import Rotation, Slerp

from thalweg.core import (
    ArrayB,
    ArrayF,
    ArrayI,
    ConfigError,
    LocalFrame,
    Rigid,
    attitude_axes,
    cross_matrix,
    exp_rotation,
    rotation_enu_body,
    rotation_vector,
)
from thalweg.images.model import ImagePoses
from thalweg.navigation.ins_gnss import JITTER_S
from thalweg.settings.sections import Fused, Positive, Section

INS, MODEL, RESET = 0, 1, 2
"""How position and rate pass from node to node: along the INS's velocity, by a random walk of the boat's own
velocity, and the step of no length with which the INS's velocity begins again."""
_MOST_ALIKE: Final = 0.9995
"""Greatest correlation of two images' errors: at 1 their difference would be free of error."""
_SAME_S: Final = 1e-6
"""Times that differ by less share a node."""
_LEAST_SIGMA: Final = 1e-7
"""Least sigma of an image's coordinate or angle, metres or radians: none is free of error."""

Factors = dict[str, float]
"""By group of errors: factor of its sigma."""
LEAST_CLOCK_S: Final = 1e-12
"""Unit of the clock's state where no offset and no walk are allowed."""

_RATE_SPAN_S = 0.05
"""Angular velocities are differences over this time to both sides: single attitudes jitter."""

GROUPS: Final = (
    "velocity",
    "acceleration",
    "roll_pitch",
    "heading",
    "disturbance",
    "gnss",
    "gnss_white",
    "lever",
    "camera",
    "mount",
    "clock",
    "jitter",
)
"""Groups of observations and of prior knowledge whose residuals are judged; ``gnss`` is the slow part of the
positions' errors. What the sigmas of positions lack, as multipath, is slow: with the many white errors in one
group it would not show."""
SCALED: Final = (
    "velocity",
    "acceleration",
    "roll_pitch",
    "disturbance",
    "gnss",
    "gnss_white",
    "camera",
    "jitter",
)
"""Groups whose sigmas follow the residuals until wrong observations are found."""
PRIOR_REDUNDANCY: Final = 10.0
"""What is stated of a sigma weighs as this many observations meanwhile."""
FACTORS: Final = (0.2, 20.0)
"""Bounds of the factors of the sigmas meanwhile."""
TIMES: Final = ("velocity_time_s", "attitude_time_s", "gnss_time_s")
"""Correlation times that are estimated."""
SIZE_OF: Final[Mapping[str, str]] = MappingProxyType(
    {
        "sigma_velocity_mps": "velocity",
        "sigma_acceleration": "acceleration",
        "heading_disturbance_deg": "disturbance",
        "sigma_jitter_s": "jitter",
    }
)
"""Group of errors whose size a setting states."""
SPREAD: Final[Mapping[str, float]] = MappingProxyType(
    {"size": 2.0, "time": 3.0, "share": 5.0, "acceleration": 3.0}
)
"""Factors that one sigma of what is stated stands for: of sizes, of times, of ``w / (1 - w)`` of a share
``w``, and of groups that are known worse: boats differ."""
WHITE_SHARE: Final = 1e-3
"""Share of an image's covariance that is taken as new in each image: no observation is free of noise."""
START_SIGMA_M: Final = 300.0
START_SPEED_MPS: Final = 5.0
"""Prior knowledge of the first node about the median of the first observations: next to nothing."""
POSE: Final = 10
"""States that make the pose: position, rate, attitude errors, disturbance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sampled:
    """The reference at n times.

    ``R_wcs_ics`` (n, 3, 3), ``axes`` (n, 3, 3) of roll, pitch, heading in wcs, ``sigma_rad`` (n, 3) of the
    three, ``way_m`` (n, 3), ``velocity_mps`` (n, 3) of the way, ``rate_radps`` (n, 3) in wcs.
    """

    R_wcs_ics: ArrayF
    axes: ArrayF
    sigma_rad: ArrayF
    way_m: ArrayF
    velocity_mps: ArrayF
    rate_radps: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class Reference:
    """Attitudes and way of the INS over time.

    Parameters
    ----------
    t_gps_s : (m,) times of the INS states.
    R_wcs_ics : (m, 3, 3) their attitudes.
    sigma_rad : (m, 3) of roll, pitch, heading.
    velocity_mps, way_m : (m, 3) velocity in wcs (bridged linearly where there is none) and its integral.
    hole : (m - 1,) the interval is longer than attitudes may be interpolated over.
    blind : (m - 1,) the INS gives no velocity in the interval.
    """

    t_gps_s: ArrayF
    R_wcs_ics: ArrayF
    sigma_rad: ArrayF
    velocity_mps: ArrayF
    way_m: ArrayF
    hole: ArrayB
    blind: ArrayB

    def inside(self, t_gps_s: ArrayF) -> ArrayB:
        """Whether the INS gives an attitude at times (n,): within its span and in no hole."""
        t = np.asarray(t_gps_s, dtype=np.float64)
        with np.errstate(invalid="ignore"):
            within = (t >= self.t_gps_s[0]) & (t <= self.t_gps_s[-1])
        left = np.clip(np.searchsorted(self.t_gps_s, t, side="right") - 1, 0, len(self.hole) - 1)
        return np.asarray(within & (~self.hole[left] | (t == self.t_gps_s[left])))

    def at(self, t_gps_s: ArrayF) -> Sampled:
        """The reference at times within its span."""
        t = np.clip(t_gps_s, self.t_gps_s[0], self.t_gps_s[-1])
        since = self.t_gps_s - self.t_gps_s[0]
        turn = Slerp(since, Rotation.from_matrix(self.R_wcs_ics))
        s = t - self.t_gps_s[0]
        R = turn(s)
        before, after = np.maximum(s - _RATE_SPAN_S, 0.0), np.minimum(s + _RATE_SPAN_S, since[-1])
        rate = (turn(after) * turn(before).inv()).as_rotvec() / (after - before)[:, None]
        left = np.clip(np.searchsorted(since, s, side="right") - 1, 0, len(since) - 2)
        step, u = (since[left + 1] - since[left])[:, None], (s - since[left])[:, None]
        slope = (self.velocity_mps[left + 1] - self.velocity_mps[left]) / step
        matrix = R.as_matrix()
        return Sampled(
            R_wcs_ics=matrix,
            axes=attitude_axes(matrix),
            sigma_rad=self.sigma_rad[left] * (1 - u / step) + self.sigma_rad[left + 1] * (u / step),
            way_m=self.way_m[left] + self.velocity_mps[left] * u + slope * u**2 / 2,
            velocity_mps=self.velocity_mps[left] + slope * u,
            rate_radps=rate,
        )

    def blind_spans(self) -> ArrayF:
        """Begin and end (k, 2) of the stretches without velocity."""
        edge = np.diff(np.concatenate([[0], self.blind.astype(np.int64), [0]]))
        return np.column_stack([self.t_gps_s[:-1][edge[:-1] == 1], self.t_gps_s[1:][edge[1:] == -1]])


class FusionSettings(Fused):
    """Section ``fused`` with numbers where a file says ``auto``: the centres of the prior knowledge."""

    velocity_time_s: Positive = 10.0
    attitude_time_s: Positive = 20.0
    gnss_time_s: Positive = 10.0
    gnss_white_share: float = 0.25
    spread: Mapping[str, float] = Field(default_factory=lambda: dict(SPREAD))
    """Factors of one sigma of what is stated: of ``size``, ``time``, ``share`` in general, and by name of a
    time or of one of `GROUPS`."""

    @classmethod
    def of(cls, section: Fused) -> Self:
        """With what the section states."""
        return cls(**stated(section))


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Where the states of a node stand; -1: not there.

    Always: position of the ics origin off the INS's way (0:3), its rate (3:6), errors of roll, pitch, heading
    in units of their sigmas (6:9), the heading's disturbance (9). Then the slow error of the antenna (3) and
    its lever arm (3), and of the camera: the image's pose error (6), the mount (6), clock offset, jitter; all
    in units of their sigmas.
    """

    n: int
    gnss: int
    lever: int
    camera: int
    mount: int
    clock: int
    jitter: int

    @classmethod
    def of(cls, *, gnss: bool, camera: bool) -> Self:
        """States for the inputs that are there."""
        n = POSE
        g = lever = c = mount = clock = jitter = -1
        if gnss:
            g, lever, n = n, n + 3, n + 6
        if camera:
            c, mount, clock, jitter, n = n, n + 6, n + 12, n + 13, n + 14
        return cls(n=n, gnss=g, lever=lever, camera=c, mount=mount, clock=clock, jitter=jitter)

    def states_of(self, group: str) -> range:
        """Single processes of a group; the image's errors count under their first one."""
        first, length = {
            "roll_pitch": (6, 2), "heading": (8, 1), "disturbance": (9, 1), "gnss": (self.gnss, 3),
            "lever": (self.lever, 3), "camera": (self.camera, 6), "mount": (self.mount, 6),
            "clock": (self.clock, 1), "jitter": (self.jitter, 1),
        }.get(group, (-1, 0))  # fmt: skip
        return range(first, first + length) if first >= 0 else range(0)


# ---------------------------------------------------------------- observations and nodes


@dataclass(frozen=True, slots=True, kw_only=True)
class Antenna:
    """Antenna positions: ``t_gps_s`` (n,), ``position_wcs_m`` (n, 3), ``root_m`` (n, 3, 3) with
    ``root root^T`` the stated covariance, ``node`` (n,); ``lever_ics_m``, ``sigma_lever_m`` (3,);
    ``begins`` (n,) the kind of solution is another than before: its slow error tells nothing of that one's.
    """

    t_gps_s: ArrayF
    position_wcs_m: ArrayF
    root_m: ArrayF
    lever_ics_m: ArrayF
    sigma_lever_m: ArrayF
    node: ArrayI
    begins: ArrayB


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """Image poses as observed poses of the body.

    ``index`` (n,) rows of the table of poses; ``t_gps_s``, ``jitter_s`` (n,); ``position_wcs_m`` (n, 3) and
    ``R_wcs_ics`` (n, 3, 3) of the body by image and mount; ``root`` (n, 6, 6) with ``root root^T`` the
    covariance of the image's error, moved to the body; ``by_mount`` (n, 6, 6) derivative of the body's pose
    by the mount's error in units of ``mount_root`` (6, 6); ``G``, ``W`` (n, 6, 6) transition of the error, in
    units of its root, from the image before, and its noise; ``node`` (n,).
    """

    index: ArrayI
    t_gps_s: ArrayF
    jitter_s: ArrayF
    position_wcs_m: ArrayF
    R_wcs_ics: ArrayF
    root: ArrayF
    by_mount: ArrayF
    mount_root: ArrayF
    G: ArrayF
    W: ArrayF
    node: ArrayI


@dataclass(frozen=True, slots=True, kw_only=True)
class Nodes:
    """Times (m,) of the nodes and the kind (m,) of the transition into each.

    ``walk`` (m, 3) factors, east, north, up, of the noise of position and rate in these transitions.
    """

    t_gps_s: ArrayF
    kind: ArrayI
    walk: ArrayF


def antenna_of(
    positions: pd.DataFrame, frame: LocalFrame, lever_ics_m: ArrayLike, sigma_lever_m: ArrayLike
) -> Antenna:
    """Observed antenna positions of usable rows of the table kind ``gnss_position``."""
    sigma = positions[["sigma_east_m", "sigma_north_m", "sigma_up_m"]].to_numpy()
    correlation = np.tile(np.eye(3), (len(positions), 1, 1))
    for name, i, j in (("cov_en_m2", 0, 1), ("cov_eu_m2", 0, 2), ("cov_nu_m2", 1, 2)):
        value = np.nan_to_num(positions[name].to_numpy()) / (sigma[:, i] * sigma[:, j])
        correlation[:, i, j] = correlation[:, j, i] = value
    return Antenna(
        t_gps_s=positions["t_gps_s"].to_numpy(),
        position_wcs_m=frame.from_geodetic(positions["lat_deg"], positions["lon_deg"], positions["h_ell_m"]),
        root_m=sigma[:, :, None] * _root(correlation),
        lever_ics_m=np.asarray(lever_ics_m, dtype=np.float64),
        sigma_lever_m=np.asarray(sigma_lever_m, dtype=np.float64),
        node=np.zeros(len(positions), dtype=np.int64),
        begins=_changes(positions["fix"]),
    )


def _changes(fix: pd.Series) -> ArrayB:
    """Rows (n,) of another kind than the row before; the first is none."""
    kinds = fix.to_numpy(dtype=object)
    return np.append(False, kinds[1:] != kinds[:-1])


def camera_of(poses: ImagePoses, use: ArrayB, T_ccs_ics: Rigid, sigma_jitter_s: float) -> Camera:
    """Observed poses of the body by the images that may be used.

    Errors of images follow each other as a Markov chain with the covariances and neighbours' covariances that
    the table states; an image that is not used keeps its link in the chain.

    Parameters
    ----------
    poses : of all images.
    use : (n,) oriented, timed and within the INS.
    T_ccs_ics : mount with its covariance.
    sigma_jitter_s : stands in where the table states no sigma of a time.
    """
    oriented = np.flatnonzero(poses.oriented)
    t = np.where(np.isfinite(poses.t_gps_s), poses.t_gps_s, -np.inf)
    root, inverse = _pose_roots(poses.cov_pose_wcs[oriented], least=_LEAST_SIGMA)
    chosen: list[int] = []
    G, W = [], []
    link, noise = np.zeros((6, 6)), np.eye(6)
    for k, image in enumerate(oriented.tolist()):
        if k:
            M = _alike(inverse[k] @ poses.cov_next[oriented[k - 1]].T @ inverse[k - 1].T)
            link, noise = M @ link, M @ noise @ M.T + np.eye(6) - M @ M.T
        if use[image]:
            # images out of order in time cannot follow each other in a chain
            if chosen and t[image] < t[oriented[chosen[-1]]]:
                link, noise = np.zeros((6, 6)), np.eye(6)
            chosen.append(k)
            G.append(link)
            W.append(noise)
            link, noise = np.eye(6), np.zeros((6, 6))
    at = np.array(chosen, dtype=np.int64)
    order = np.argsort(t[oriented[at]], kind="stable")
    at, index = at[order], oriented[at][order]
    links, noises = np.array(G).reshape(-1, 6, 6)[order], np.array(W).reshape(-1, 6, 6)[order]
    broken = np.append(False, np.diff(order) != 1)
    links[broken], noises[broken] = 0.0, np.eye(6)
    R_wcs_ccs = poses.R_wcs_ccs[index]
    by_image = np.tile(np.eye(6), (len(index), 1, 1))
    by_image[:, :3, 3:] = -cross_matrix(R_wcs_ccs @ T_ccs_ics.shift_m)
    by_mount = np.zeros((len(index), 6, 6))
    by_mount[:, :3, :3] = by_mount[:, 3:, 3:] = R_wcs_ccs
    mount_root = _pose_roots(T_ccs_ics.cov[None])[0][0]
    jitter = poses.sigma_t_s[index]
    return Camera(
        index=index,
        t_gps_s=poses.t_gps_s[index],
        jitter_s=np.where(np.isfinite(jitter), jitter, sigma_jitter_s),
        position_wcs_m=poses.centre_wcs_m[index] + R_wcs_ccs @ T_ccs_ics.shift_m,
        R_wcs_ics=R_wcs_ccs @ T_ccs_ics.R,
        root=by_image @ root[at],
        by_mount=by_mount @ mount_root,
        mount_root=mount_root,
        G=links,
        W=noises,
        node=np.zeros(len(index), dtype=np.int64),
    )


def with_own_jitter(poses: ImagePoses) -> ImagePoses:
    """Poses whose ``sigma_t_s`` is the scatter of single images: the offset of the clock is a state here.

    Raises
    ------
    ConfigError : the times were estimated with the INS and the positions, which would then count twice.
    """
    told = poses.facts.get("image_times", {})
    if not told.get("independent_of_ins", True):
        raise ConfigError(
            "times of images that were estimated from positions and INS",
            expected="images.cloud.image_times: clock",
            cure="The fused trajectory estimates these times itself; take those of the camera's clock",
        )
    common_s = float(told.get("sigma_common_s", 0.0))
    single = np.sqrt(np.clip(poses.sigma_t_s**2 - common_s**2, 0.0, None))
    return poses.with_times(poses.t_gps_s, single)


def place_nodes(
    reference: Reference, settings: FusionSettings, antenna_t_s: ArrayF, image_t_s: ArrayF
) -> tuple[Nodes, ArrayI, ArrayI]:
    """Nodes at all observations, at most ``node_s`` apart, and at both ends of stretches without velocity.

    Returns
    -------
    nodes, node of each antenna position, node of each image : images have nodes of their own.
    """
    first, last = float(reference.t_gps_s[0]), float(reference.t_gps_s[-1])
    spans = reference.blind_spans()
    fixed = np.unique(np.concatenate([[first, last], antenna_t_s, image_t_s, spans.ravel()]))
    fixed = fixed[np.append(True, np.diff(fixed) > _SAME_S)]
    pieces = np.ceil(np.diff(fixed) / settings.node_s).astype(np.int64)
    left = np.repeat(np.arange(len(pieces)), pieces)
    place = np.arange(len(left)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    base = np.append(fixed[left] + place / pieces[left] * np.diff(fixed)[left], fixed[-1])
    middle = (base[1:] + base[:-1]) / 2
    k = np.searchsorted(spans[:, 0], middle) - 1
    blind = (k >= 0) & (middle < spans[np.maximum(k, 0), 1]) if len(spans) else np.zeros(len(middle), bool)
    begins_again = np.flatnonzero(blind[:-1] & ~blind[1:]) + 1
    at = np.concatenate([base, base[begins_again], image_t_s])
    # beside each other: a node, the step with which the velocity begins again, images of that time
    rank = np.repeat([0, 1, 2], [len(base), len(begins_again), len(image_t_s)])
    near = np.searchsorted(base, at - _SAME_S)
    shared = np.where(np.abs(base[np.minimum(near, len(base) - 1)] - at) <= _SAME_S, base[near], at)
    order = np.lexsort((rank, shared))
    kinds = np.full(len(at), INS)
    into = np.append(False, blind)
    kinds[: len(base)] = np.where(into, MODEL, INS)
    kinds[len(base) : len(base) + len(begins_again)] = RESET
    place_of = np.empty(len(at), dtype=np.int64)
    place_of[order] = np.arange(len(at))
    kind = kinds[order]
    antenna_node = place_of[np.searchsorted(base, antenna_t_s - _SAME_S)]
    nodes = Nodes(t_gps_s=shared[order], kind=kind, walk=np.ones((len(at), 3)))
    return nodes, antenna_node, place_of[len(at) - len(image_t_s) :]


def _root(cov: ArrayF) -> ArrayF:
    """Symmetric roots (n, k, k) of correlation matrices, negative eigenvalues of bad ones cut."""
    value, vector = np.linalg.eigh(cov)
    return np.asarray(vector * np.sqrt(np.maximum(value, 1e-9))[:, None, :] @ np.swapaxes(vector, 1, 2))


def _pose_roots(cov: ArrayF, least: float = 0.0) -> tuple[ArrayF, ArrayF]:
    """Roots (n, 6, 6) of covariances of poses, and their inverses; zero rows where nothing varies."""
    sigma = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2), 0.0))
    scale = np.where(sigma > 0, sigma, 1.0)
    correlation = np.nan_to_num(cov) / scale[:, :, None] / scale[:, None, :]
    every = np.arange(6)
    correlation[:, every, every] = 1.0
    root = _root(correlation)
    sigma = np.maximum(np.nan_to_num(sigma), least)
    inverse = np.linalg.inv(root) / np.where(sigma > 0, sigma, 1.0)[:, None, :]
    return sigma[:, :, None] * root, inverse


def _alike(correlation: ArrayF) -> ArrayF:
    """Correlation (6, 6) of two images' errors in units of their roots, with singular values below 1."""
    known = np.where(np.isfinite(correlation), correlation, 0.0) / (1.0 - WHITE_SHARE)
    left, value, right = np.linalg.svd(known)
    return np.asarray(left * np.minimum(value, _MOST_ALIKE) @ right)


# ---------------------------------------------------------------- transitions and linearised observations
#
# Position ``p = way + d`` with ``d' = e``; along the INS's velocity ``e`` is its error, a Gauss-Markov
# process (so ``d`` is an integrated one), without it the boat's own velocity, a random walk. The attitude
# is ``R = exp([theta]x) R_ins`` with ``theta`` the sum of the errors of roll, pitch and heading about their
# axes.
#
#     antenna   z = p + R (l + dl) + L g + white
#     image     z_p = p + v (c + j) - e_p,    z_R = exp(-e_R) exp(omega (c + j)) R


@dataclass(frozen=True, slots=True, kw_only=True)
class Transitions:
    """What `thalweg.navigation.fusion.solver` takes: see there."""

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
    """Observations ``H`` (r, n), ``y`` (r,) of a ``variance`` (r,), and the node (r,) of each, in order.

    ``of_antenna`` (r,) tells the group of each.
    """

    H: ArrayF
    y: ArrayF
    variance: ArrayF
    node: ArrayI
    of_antenna: ArrayI

    def unit(self, factors: Factors) -> ArrayF:
        """Factors (r,) of the sigmas of the white errors."""
        return np.where(self.of_antenna == 1, factors["gnss_white"], factors["camera"])

    def weighted(self, factors: Factors) -> Self:
        """Of the variance 1, with factors of the sigmas."""
        scale = 1.0 / np.sqrt(self.variance * self.unit(factors) ** 2)
        return replace(
            self, H=self.H * scale[:, None], y=self.y * scale, variance=np.ones_like(self.variance)
        )


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
        own = np.array(layout.states_of(group), dtype=np.int64)
        phi[:, own] = np.exp(-step / time)[:, None]
        q[:, own] = (-np.expm1(-2 * step / time) * factors[group] ** 2)[:, None]
        p0[own] = factors[group] ** 2
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
    by_angle = np.concatenate(
        [
            np.swapaxes(reference.axes, 1, 2) * reference.sigma_rad[:, None, :],
            disturbance * reference.axes[:, 2, :, None],
        ],
        axis=2,
    )
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
    off = np.concatenate(
        [
            camera.position_wcs_m - at.way_m - x[:, :3],
            rotation_vector(camera.R_wcs_ics @ np.swapaxes(R, 1, 2)),
        ],
        axis=1,
    )
    linear = H[:, :, 10:] @ x[:, 10:, None]
    y = off - linear[:, :, 0] + np.einsum("nij,nj->ni", H, x)
    return H, y


def whitened(H: ArrayF, y: ArrayF, root: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Rows in units of ``root`` (k, d, d): what was ``root`` times white noise becomes white noise."""
    both = np.linalg.solve(root, np.concatenate([H, y[:, :, None]], axis=2))
    return both[:, :, :-1], both[:, :, -1]


def stacked(parts: list[tuple[ArrayF, ArrayF, ArrayI, ArrayF]]) -> Rows:
    """Rows of antenna (first part) and images, of a variance (k,) each, in the order of their nodes."""
    H = np.concatenate([h.reshape(-1, h.shape[-1]) for h, _, _, _ in parts])
    y = np.concatenate([v.ravel() for _, v, _, _ in parts])
    node = np.concatenate([np.repeat(k, v.shape[1]) for _, v, k, _ in parts])
    variance = np.concatenate([np.repeat(w, v.shape[1]) for _, v, _, w in parts])
    group = np.concatenate([np.full(v.size, i) for i, (_, v, _, _) in enumerate(parts)])
    order = np.argsort(node, kind="stable")
    return Rows(
        H=np.ascontiguousarray(H[order]),
        y=np.ascontiguousarray(y[order]),
        variance=variance[order],
        node=node[order],
        of_antenna=(group[order] == 0).astype(np.int64),
    )


# ---------------------------------------------------------------- the path about which is linearised
#
# Attitudes are the INS's own, turned into wcs; the way is the integral of its velocity. The states of the
# smoother are what is missing from both, so that motion faster than the observations stays in.


def make_reference(
    states: pd.DataFrame,
    frame: LocalFrame,
    *,
    sigma_attitude_rad: ArrayLike,
    max_attitude_gap_s: float,
    use_velocity: bool,
    near_t_s: ArrayF,
    near_wcs_m: ArrayF,
) -> Reference:
    """The reference of usable INS states.

    Parameters
    ----------
    states : as `thalweg.navigation.ins_gnss.trajectory.usable_states` leaves them.
    frame : the world frame.
    sigma_attitude_rad : (3,) roll, pitch, heading; stands in where the log states none.
    max_attitude_gap_s : longest hole between states that is interpolated.
    use_velocity : whether the INS's velocity carries the way.
    near_t_s, near_wcs_m : (k,), (k, 3) where the boat is to a few metres: the level of the INS's angles.
    """
    t = states["t_gps_s"].to_numpy()
    place = np.stack([np.interp(t, near_t_s, axis) for axis in near_wcs_m.T], axis=1)
    lat_deg, lon_deg, _ = frame.to_geodetic(place)
    R_wcs_enu = frame.R_wcs_enu(lat_deg, lon_deg)
    angles = (states[name].to_numpy() for name in ("roll_rad", "pitch_rad", "heading_rad"))
    R = np.asarray(R_wcs_enu @ rotation_enu_body(*angles))
    stated = states[["sigma_roll_rad", "sigma_pitch_rad", "sigma_heading_rad"]].to_numpy()
    known_sigma = np.isfinite(stated) & (stated > 0)
    sigma = np.where(known_sigma, stated, np.asarray(sigma_attitude_rad, dtype=np.float64))
    enu = states[["v_east_mps", "v_north_mps", "v_down_mps"]].to_numpy() * [1.0, 1.0, -1.0]
    known = np.isfinite(enu).all(axis=1)
    hole = np.diff(t) > max_attitude_gap_s + JITTER_S
    velocity = np.zeros((len(t), 3))
    if use_velocity and known.sum() >= 2:
        wcs = np.einsum("nij,nj->ni", R_wcs_enu[known], enu[known])
        velocity = np.stack([np.interp(t, t[known], axis) for axis in wcs.T], axis=1)
        blind = hole | ~known[1:] | ~known[:-1]
    else:
        blind = np.ones(len(t) - 1, dtype=np.bool_)
    step = (velocity[1:] + velocity[:-1]) / 2 * np.diff(t)[:, None]
    return Reference(
        t_gps_s=t,
        R_wcs_ics=R,
        sigma_rad=sigma,
        velocity_mps=velocity,
        way_m=np.concatenate([np.zeros((1, 3)), np.cumsum(step, axis=0)]),
        hole=hole,
        blind=blind,
    )


# ---------------------------------------------------------------- settings


def stated(section: Section) -> dict[str, Any]:
    """The values of a section but those of which it says that it knows nothing, ``auto``."""
    return {name: value for name, value in section if value != "auto"}
