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
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy.spatial.transform import Rotation

from thalweg.core.errors import CoverageError, GeometryError
from thalweg.core.frames import LocalFrame, attitude_axes
from thalweg.core.tables import column, read_table, table_kind, write_table
from thalweg.core.types import ArrayB, ArrayF, ArrayI

_PARTS: Final = ("east", "north", "up", "rotation_east", "rotation_north", "rotation_up")
_UPPER: Final = np.triu_indices(6, 1)
_SIGMAS: Final = tuple(f"sigma_{part}_{'rad' if 'rotation' in part else 'm'}" for part in _PARTS)
_CORRELATIONS: Final = tuple(f"correlation_{_PARTS[i]}_{_PARTS[j]}" for i, j in zip(*_UPPER, strict=True))

TRAJECTORY = table_kind(
    "trajectory",
    2,
    [
        column("t_gps_s", "s", "adjusted standard GPS time, strictly increasing"),
        *(column(f"{a}_m", "m", f"{a} of the ics origin in wcs") for a in ("east", "north", "up")),
        *(column(f"q{a}", "1", f"quaternion of R_wcs_ics, {a} (scalar last)") for a in "xyzw"),
        *(column(name, name.rpartition("_")[2], "standard deviation") for name in _SIGMAS),
        *(column(name, "1", "correlation of two errors of the pose") for name in _CORRELATIONS),
        column("valid", "1", "false inside a gap: no point gets a pose from such a node", pa.bool_()),
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
