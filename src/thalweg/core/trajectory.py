"""The pose of the boat over time: ``T_wcs_ics`` with covariance at nodes, and what lies between them.

A trajectory is a list of nodes in the world frame: position of the INS reference point (``ics`` origin),
attitude as a unit quaternion of ``R_wcs_ics``, and the covariance of both. Between nodes positions are
linear and attitudes follow the shortest arc; nodes are dense enough for that (the INS rate; at 50 Hz and
1 m/s^2 the chord error is a dt^2 / 8 = 0.05 mm). A node may be invalid: nothing is interpolated across it.

The pose error of a node is ``(dx, dtheta)``: a shift of the ics origin in wcs and a small rotation vector in
wcs, ``R_true = exp([dtheta]x) R_estimated``. Its covariance is a full 6x6 matrix, so that a position and an
attitude that err together are told apart from two that do not: a position measured at an antenna gives an ics
origin whose error depends on that of the attitude. Between nodes the covariance is interpolated linearly.
That is an upper bound: it exceeds the covariance of the interpolated pose by ``u (1 - u)`` times the
covariance of the difference of both nodes' errors, which is small for the strongly correlated errors of
neighbouring nodes.

A trajectory holds the covariance of each pose. What the errors of two poses have in common stands in chains:
independent parts (`ErrorChain`), each of them a Markov chain over nodes,

    e(t_k) = root_k z_k,      z_k = link_k z_(k-1) + noise,      cov z_k = 1,

so that the covariance of the errors of two nodes i < k is ``root_k link_k ... link_(i+1) root_i'``. Between
nodes errors are interpolated linearly. A smoother's errors are such a chain (Rauch, Tung and Striebel 1965),
and so are those of photographs of a series, of their times and of their clock.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy.spatial.transform import Rotation

from thalweg.core.errors import CoverageError, GeometryError, InputError
from thalweg.core.frames import LocalFrame, attitude_axes
from thalweg.core.tables import column, read_table, table_kind, write_table
from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayI

_F = pa.float64()

_PARTS: Final = ("east", "north", "up", "rotation_east", "rotation_north", "rotation_up")
_UPPER: Final = np.triu_indices(6, 1)
_SIGMAS: Final = tuple(f"sigma_{part}_{'rad' if 'rotation' in part else 'm'}" for part in _PARTS)
_CORRELATIONS: Final = tuple(f"correlation_{_PARTS[i]}_{_PARTS[j]}" for i, j in zip(*_UPPER, strict=True))

TRAJECTORY = table_kind(
    "trajectory",
    2,
    [
        column("t_gps_s", _F, "s", "adjusted standard GPS time, strictly increasing"),
        *(column(f"{a}_m", _F, "m", f"{a} of the ics origin in wcs") for a in ("east", "north", "up")),
        *(column(f"q{a}", _F, "1", f"quaternion of R_wcs_ics, {a} (scalar last)") for a in "xyzw"),
        *(column(name, _F, name.rpartition("_")[2], "standard deviation") for name in _SIGMAS),
        *(column(name, _F, "1", "correlation of two errors of the pose") for name in _CORRELATIONS),
        column("valid", pa.bool_(), "1", "false inside a gap: no point gets a pose from such a node"),
    ],
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectory:
    """Nodes of ``T_wcs_ics`` over time.

    Parameters
    ----------
    frame : the world frame.
    t_gps_s : (n,) strictly increasing.
    position_wcs_m : (n, 3) position of the ics origin.
    quaternion_wcs_ics : (n, 4) scalar last, unit length, neighbours in the same hemisphere.
    cov_pose_wcs : (n, 6, 6) covariance of (east, north, up of the ics origin in metres; small rotation about
        east, north, up in radians).
    valid : (n,) false where the pose is not to be used.

    Raises
    ------
    GeometryError : fewer than two nodes, shapes that differ, or times that do not increase.
    """

    frame: LocalFrame
    t_gps_s: ArrayF
    position_wcs_m: ArrayF
    quaternion_wcs_ics: ArrayF
    cov_pose_wcs: ArrayF
    valid: ArrayB

    def __post_init__(self) -> None:
        n = len(self.t_gps_s)
        shapes = {
            "position_wcs_m": (self.position_wcs_m.shape, (n, 3)),
            "quaternion_wcs_ics": (self.quaternion_wcs_ics.shape, (n, 4)),
            "cov_pose_wcs": (self.cov_pose_wcs.shape, (n, 6, 6)),
            "valid": (self.valid.shape, (n,)),
        }
        for name, (found, expected) in shapes.items():
            if found != expected:
                raise GeometryError(f"{name}.shape={found}", expected=str(expected))
        if n < 2:
            raise GeometryError(f"a trajectory of {n} nodes", expected="at least 2")
        step = np.diff(self.t_gps_s)
        if not np.all(step > 0):
            worst = int(np.argmin(step))
            raise GeometryError(
                f"node times step by {step[worst]:.6f} s at node {worst}",
                expected="strictly increasing times",
                cure="Sort the nodes and drop repeated times",
            )
        # q and -q are the same rotation; interpolation needs neighbours on the same side.
        q = self.quaternion_wcs_ics
        flips = np.cumprod(np.where(np.sum(q[1:] * q[:-1], axis=1) < 0, -1.0, 1.0))
        if np.any(flips < 0):
            q = q.copy()
            q[1:] *= flips[:, None]
            object.__setattr__(self, "quaternion_wcs_ics", q)

    def at(self, t_gps_s: ArrayF) -> tuple[ArrayF, ArrayF, ArrayB]:
        """Position (m, 3), rotation matrices ``R_wcs_ics`` (m, 3, 3) and validity (m,) at any times.

        The slow, clear form of what the georeferencing kernel does; invalid outside the nodes.
        """
        left, right, u = self._between(t_gps_s)
        inside = (u >= 0) & (u <= 1) & self.valid[left] & self.valid[right]
        position = self.position_wcs_m[left] * (1 - u)[:, None] + self.position_wcs_m[right] * u[:, None]
        start = Rotation.from_quat(self.quaternion_wcs_ics[left])
        arc = (start.inv() * Rotation.from_quat(self.quaternion_wcs_ics[right])).as_rotvec()
        rotation = (start * Rotation.from_rotvec(arc * u[:, None])).as_matrix()
        return position, rotation, inside

    def cov_at(self, t_gps_s: ArrayF) -> ArrayF:
        """Covariance (m, 6, 6) of the pose at times within the nodes, interpolated linearly."""
        left, right, u = self._between(t_gps_s)
        v = u[:, None, None]
        return np.asarray(self.cov_pose_wcs[left] * (1 - v) + self.cov_pose_wcs[right] * v)

    def rates(self) -> tuple[ArrayF, ArrayF]:
        """Velocity (n - 1, 3) of the ics origin, m/s, and angular velocity (n - 1, 3) in wcs, rad/s.

        One row for each interval between nodes.
        """
        step = np.diff(self.t_gps_s)[:, None]
        rotation = Rotation.from_quat(self.quaternion_wcs_ics)
        turned = (rotation[1:] * rotation[:-1].inv()).as_rotvec()
        return np.diff(self.position_wcs_m, axis=0) / step, turned / step

    @property
    def sigma_position_m(self) -> ArrayF:
        """Standard deviations (n, 3) of east, north, up of the ics origin."""
        return np.sqrt(np.diagonal(self.cov_pose_wcs, axis1=1, axis2=2)[:, :3])

    def sigma_roll_pitch_heading_rad(self) -> ArrayF:
        """Standard deviations (n, 3) of roll, pitch and heading, radians."""
        axes = attitude_axes(Rotation.from_quat(self.quaternion_wcs_ics).as_matrix())
        to_angles = np.linalg.inv(np.swapaxes(axes, 1, 2))
        cov = to_angles @ self.cov_pose_wcs[:, 3:, 3:] @ np.swapaxes(to_angles, 1, 2)
        return np.sqrt(np.diagonal(cov, axis1=1, axis2=2))

    def _between(self, t_gps_s: ArrayF) -> tuple[ArrayI, ArrayI, ArrayF]:
        """Nodes left and right of times, and the share of the way from one to the other."""
        t = np.asarray(t_gps_s, dtype=np.float64)
        right = np.clip(np.searchsorted(self.t_gps_s, t, side="right"), 1, len(self.t_gps_s) - 1)
        left = right - 1
        return left, right, (t - self.t_gps_s[left]) / (self.t_gps_s[right] - self.t_gps_s[left])

    def span(self) -> tuple[float, float]:
        """First and last node time.

        Raises
        ------
        CoverageError : no node is valid.
        """
        if not self.valid.any():
            raise CoverageError(
                "the trajectory has no valid node",
                expected="INS and positions that overlap in time",
                cure="Look at the integrity reports of the INS and the position stream",
            )
        t = self.t_gps_s[self.valid]
        return float(t[0]), float(t[-1])

    def write(self, path: Path, meta: dict[str, Any] | None = None) -> None:
        """Write as Parquet table of kind ``trajectory``, with the frame's origin in its facts."""
        sigma = np.sqrt(np.diagonal(self.cov_pose_wcs, axis1=1, axis2=2))
        scale = np.where(sigma > 0, sigma, 1.0)
        correlation = self.cov_pose_wcs / scale[:, :, None] / scale[:, None, :]
        columns: dict[str, Any] = {"t_gps_s": self.t_gps_s}
        columns |= {f"{a}_m": self.position_wcs_m[:, i] for i, a in enumerate(_PARTS[:3])}
        columns |= {f"q{a}": self.quaternion_wcs_ics[:, i] for i, a in enumerate("xyzw")}
        columns |= {name: sigma[:, i] for i, name in enumerate(_SIGMAS)}
        columns |= {name: correlation[:, i, j] for name, i, j in zip(_CORRELATIONS, *_UPPER, strict=True)}
        columns["valid"] = self.valid
        origin = {"lat_deg": self.frame.lat_deg, "lon_deg": self.frame.lon_deg, "h_ell_m": self.frame.h_ell_m}
        write_table(path, pd.DataFrame(columns), TRAJECTORY, {**(meta or {}), "origin": origin})

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a trajectory written by `write`."""
        table, meta = read_table(path, TRAJECTORY)
        sigma = table[list(_SIGMAS)].to_numpy()
        correlation = np.tile(np.eye(6), (len(table), 1, 1))
        for name, i, j in zip(_CORRELATIONS, *_UPPER, strict=True):
            correlation[:, i, j] = correlation[:, j, i] = table[name].to_numpy()
        return cls(
            frame=LocalFrame(**meta["origin"]),
            t_gps_s=table["t_gps_s"].to_numpy(),
            position_wcs_m=table[["east_m", "north_m", "up_m"]].to_numpy(),
            quaternion_wcs_ics=table[["qx", "qy", "qz", "qw"]].to_numpy(),
            cov_pose_wcs=correlation * sigma[:, :, None] * sigma[:, None, :],
            valid=table["valid"].to_numpy(dtype=np.bool_),
        )


# ---------------------------------------------------------------- errors of poses over time

_LEAST: Final = 1e-9
"""Eigenvalues of a correlation matrix below this are rounding."""
_MOST_ALIKE: Final = 1.0 - 1e-12
"""Greatest correlation of two nodes of a chain whose errors change."""
_AT_ONCE: Final = 2000
"""Nodes whose matrices are taken apart at once: some 100 MB."""
_SAME_S: Final = 1e-6
"""Nodes that are nearer are one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorChain:
    """One part of the errors of poses, independent of the other parts.

    Attributes
    ----------
    name : what errs.
    t_gps_s : (m,) times of the nodes, ascending. Two nodes of one time are a jump.
    root : (m, 6, d) the error of the pose (shift of the ics origin, small rotation; wcs, metres and radians)
        is ``root z`` with d independent components of unit variance.
    link : (m, d, d) covariance of the components of a node with those of the node before; that of the first
        node is not used.

    Raises
    ------
    GeometryError : no node, shapes that differ, or times that go back.
    """

    name: str
    t_gps_s: ArrayF
    root: ArrayF
    link: ArrayF

    def __post_init__(self) -> None:
        m, d = len(self.t_gps_s), self.root.shape[-1]
        if not m or self.root.shape != (m, 6, d) or self.link.shape != (m, d, d):
            raise GeometryError(
                f"errors of the {self.name}: {m} times, roots {self.root.shape}, links {self.link.shape}",
                expected="(m,) times with m > 0, (m, 6, d) and (m, d, d)",
            )
        if (np.diff(self.t_gps_s) < 0).any():
            raise GeometryError(f"errors of the {self.name}: times that go back", expected="ascending times")

    def between(self, t_gps_s: ArrayF) -> tuple[ArrayI, ArrayI, ArrayF]:
        """Nodes left and right of times (n,), and the share of the right one; the nearest one outside."""
        right = np.searchsorted(self.t_gps_s, t_gps_s, side="right")
        left = np.clip(right - 1, 0, len(self.t_gps_s) - 1)
        right = np.clip(right, 0, len(self.t_gps_s) - 1)
        gap = self.t_gps_s[right] - self.t_gps_s[left]
        share = np.where(gap > 0, (t_gps_s - self.t_gps_s[left]) / np.where(gap > 0, gap, 1.0), 0.0)
        return left, right, share

    def covariance_at(self, t_gps_s: ArrayF) -> ArrayF:
        """Covariance (n, 6, 6) of the interpolated error at times (n,)."""
        left, right, share = self.between(t_gps_s)
        u = share[:, None, None]
        one, two = (1 - u) * self.root[left], u * self.root[right]
        mixed = two @ self.link[right] @ np.swapaxes(one, 1, 2)
        mixed = np.where((left == right)[:, None, None], 0.0, mixed)
        own = one @ np.swapaxes(one, 1, 2) + two @ np.swapaxes(two, 1, 2)
        return np.asarray(own + mixed + np.swapaxes(mixed, 1, 2))

    @classmethod
    def of_covariances(
        cls, name: str, t_gps_s: ArrayF, cov: ArrayF, following: ArrayF, pose: ArrayF, *, step_s: float
    ) -> Self:
        """A chain of states with known covariances, thinned.

        Parameters
        ----------
        name : what errs.
        t_gps_s : (m,) times of all nodes.
        cov, following : (m, n, n) covariance of the states of a node, and with those of the next node (rows:
            this node).
        pose : (m, 6, k) derivative of the pose to the first k states.
        step_s : nodes nearer to the one before are left out; the last one stays.
        """
        kept, roots, chain = [0], [], [np.zeros(cov.shape[1:])]
        link = np.eye(cov.shape[1])
        last = len(t_gps_s) - 1
        for first in range(0, last + 1, _AT_ONCE):
            # the last node of a piece is the first one of the next
            own = cov[first : first + _AT_ONCE + 1]
            root, inverse = _root_and_inverse(own)
            raw = inverse[1:] @ np.swapaxes(following[first : first + len(own) - 1], 1, 2)
            left, alike, right = np.linalg.svd(raw @ np.swapaxes(inverse[:-1], 1, 2))
            links = (left * np.minimum(alike, 1.0)[:, None, :]) @ right
            if first == 0:
                roots.append(root[0, : pose.shape[2]])
            for k in range(first + 1, first + len(own)):
                link = links[k - first - 1] @ link
                if t_gps_s[k] - t_gps_s[kept[-1]] >= step_s or k == last:
                    kept.append(k)
                    roots.append(root[k - first, : pose.shape[2]])
                    chain.append(link)
                    link = np.eye(cov.shape[1])
        return cls(name=name, t_gps_s=t_gps_s[kept], root=pose[kept] @ np.array(roots), link=np.array(chain))


def _root_and_inverse(cov: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Roots (m, n, n) of covariances and their pseudo-inverses."""
    scale = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2), 0.0))
    scale = np.where(scale > 0, scale, 1.0)
    value, vector = np.linalg.eigh(cov / scale[:, :, None] / scale[:, None, :])
    shown = value > _LEAST * value[:, -1:]
    size = np.where(shown, np.sqrt(np.maximum(value, 0.0)), 0.0)
    inverse = np.swapaxes(vector / np.where(shown, size, np.inf)[:, None, :], 1, 2) / scale[:, None, :]
    return scale[:, :, None] * vector * size[:, None, :], inverse


def with_rest(
    trajectory: Trajectory, chains: Sequence[ErrorChain], fixed_gps_s: ArrayF, *, step_s: float
) -> list[ErrorChain]:
    """Chains of the errors of a trajectory, with one more for what they do not explain of its covariance.

    Between fixed times other errors may grow and shrink again (those of an INS between photographs). They are
    zero at these times and correlated between two of them as a Brownian bridge is: ``sqrt(s (T - t) / (t (T -
    s)))`` at times s < t of a gap of length T.

    Parameters
    ----------
    trajectory : with the covariance of all errors.
    chains : what is known.
    fixed_gps_s : (k,) ascending times at which the chains are all; k > 0.
    step_s : least interval of the nodes of the rest.
    """
    node = fixed_gps_s
    t = trajectory.t_gps_s[trajectory.valid]
    kept = np.unique(np.floor((t - t[0]) / step_s), return_index=True)[1] if len(t) else np.zeros(0, int)
    t = np.unique(np.concatenate([t[kept], node, *(chain.t_gps_s for chain in chains)]))
    t = t[np.append(True, np.diff(t) > _SAME_S)]
    gap = np.clip(np.searchsorted(node, t + _SAME_S, side="right") - 1, 0, max(len(node) - 2, 0))
    begin, end = node[gap], node[np.minimum(gap + 1, len(node) - 1)]
    since, left = t - begin, end - t
    at_node = (np.abs(since) < _SAME_S) | (np.abs(left) < _SAME_S)
    whole = trajectory.cov_at(t)
    rest = whole - sum(chain.covariance_at(t) for chain in chains)
    rest[at_node] = 0.0
    left_over, total = (np.diagonal(each, axis1=1, axis2=2) for each in (rest, whole))
    if not (left_over > _LEAST * total).any():
        return list(chains)
    _, R, _ = trajectory.at(np.clip(t, trajectory.t_gps_s[0], trajectory.t_gps_s[-1]))
    axes = np.zeros((len(t), 6, 6))
    axes[:, :3, :3] = axes[:, 3:, 3:] = R
    root = symmetric_roots(rest, axes)
    share = np.zeros(len(t))
    same = (gap[1:] == gap[:-1]) & ~at_node[1:] & ~at_node[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        bridge = np.sqrt(since[:-1] * left[1:] / (since[1:] * left[:-1]))
        # outside of the nodes nothing holds the other end
        ratio = np.where((left[1:] > 0) & (since[:-1] > 0), bridge, 1.0)
    share[1:] = np.where(same, np.minimum(ratio, _MOST_ALIKE), 0.0)
    link = share[:, None, None] * np.eye(6)
    return [*chains, ErrorChain(name="between the nodes", t_gps_s=t, root=root, link=link)]


def symmetric_roots(cov: ArrayF, axes: ArrayF) -> ArrayF:
    """Roots L (m, k, k) of covariances, semi-definite ones too, whose components keep to axes.

    Between two moments errors have the covariance ``L(t) L(t')' exp(-|t - t'| / tau)``: any root has the
    variances of single moments, but only one whose components are the same errors at all moments has this.
    Here it is the symmetric root in the axes (m, k, k) in which the error lasts (columns: their directions in
    the world): those of the boat for what turns with it, of the world for antennas.
    """
    turned = np.swapaxes(axes, 1, 2) @ cov @ axes
    # metres beside radians: in one scale for all moments, as a root in other units is another root
    scale = np.sqrt(np.maximum(np.diagonal(turned, axis1=1, axis2=2), 0.0).mean(axis=0))
    scale = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(turned / scale[:, None] / scale)
    own = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    return np.asarray(axes @ (scale[:, None] * own))


def write_chains(path: Path, chains: Sequence[ErrorChain]) -> None:
    """Write chains as npz; roots and links in single precision."""
    arrays: dict[str, AnyArray] = {"names": np.array([chain.name for chain in chains])}
    for i, chain in enumerate(chains):
        arrays |= {
            f"t_gps_s_{i}": chain.t_gps_s,
            f"root_{i}": chain.root.astype(np.float32),
            f"link_{i}": chain.link.astype(np.float32),
        }
    np.savez_compressed(path, allow_pickle=False, **arrays)


def read_chains(path: Path) -> list[ErrorChain]:
    """Read what `write_chains` wrote.

    Raises
    ------
    InputError : the file holds no chains of errors.
    """
    with np.load(path) as stored:
        if "names" not in stored:
            raise InputError("no errors of poses", where=path, expected="a file of `write_chains`")
        return [
            ErrorChain(
                name=str(name),
                t_gps_s=stored[f"t_gps_s_{i}"],
                root=stored[f"root_{i}"].astype(np.float64),
                link=stored[f"link_{i}"].astype(np.float64),
            )
            for i, name in enumerate(stored["names"])
        ]
