"""The pose of the boat over time: ``T_wcs_ics`` with sigmas at nodes, and what lies between them.

A trajectory is a list of nodes in the world frame: position of the INS reference point (``ics`` origin),
attitude as a unit quaternion of ``R_wcs_ics``, and their standard deviations. Between nodes positions are
linear and attitudes follow the shortest arc; nodes are dense enough for that (the INS rate; at 50 Hz and
1 m/s^2 the chord error is a dt^2 / 8 = 0.05 mm). A node may be invalid: nothing is interpolated across it.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy.spatial.transform import Rotation

from thalweg.core.errors import CoverageError, GeometryError
from thalweg.core.frames import LocalFrame
from thalweg.core.tables import column, read_table, table_kind, write_table
from thalweg.core.types import ArrayB, ArrayF

_F = pa.float64()

TRAJECTORY = table_kind(
    "trajectory",
    1,
    [
        column("t_gps_s", _F, "s", "adjusted standard GPS time, strictly increasing"),
        *(column(f"{a}_m", _F, "m", f"{a} of the ics origin in wcs") for a in ("east", "north", "up")),
        *(column(f"q{a}", _F, "1", f"quaternion of R_wcs_ics, {a} (scalar last)") for a in "xyzw"),
        *(column(f"sigma_{a}_m", _F, "m", f"standard deviation {a}") for a in ("east", "north", "up")),
        *(column(f"cov_{a}_m2", _F, "m^2", f"position covariance {a}") for a in ("en", "eu", "nu")),
        column("sigma_roll_rad", _F, "rad", "standard deviation about body x (forward)"),
        column("sigma_pitch_rad", _F, "rad", "standard deviation about body y (right)"),
        column("sigma_heading_rad", _F, "rad", "standard deviation about the vertical"),
        column("valid", pa.bool_(), "1", "false inside a gap: no point gets a pose from such a node"),
    ],
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectory:
    """Nodes of ``T_wcs_ics`` over time.

    Parameters
    ----------
    frame : the world frame.
    t_gps_s : (n,) strictly increasing.
    position_wcs_m : (n, 3) position of the ics origin.
    quaternion_wcs_ics : (n, 4) scalar last, unit length, neighbours in the same hemisphere.
    cov_position_m2 : (n, 3, 3) in wcs.
    sigma_attitude_rad : (n, 3) about body x, body y and the vertical (roll, pitch, heading).
    valid : (n,) false where the pose is not to be used.
    pivot_ics_m : (3,) the point of the boat whose position was measured (the antenna): an error of the
        attitude turns the boat about it, not about the ics origin.

    Raises
    ------
    GeometryError : fewer than two nodes, shapes that differ, or times that do not increase.
    """

    frame: LocalFrame
    t_gps_s: ArrayF
    position_wcs_m: ArrayF
    quaternion_wcs_ics: ArrayF
    cov_position_m2: ArrayF
    sigma_attitude_rad: ArrayF
    valid: ArrayB
    pivot_ics_m: ArrayF = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        n = len(self.t_gps_s)
        shapes = {
            "position_wcs_m": (self.position_wcs_m.shape, (n, 3)),
            "quaternion_wcs_ics": (self.quaternion_wcs_ics.shape, (n, 4)),
            "cov_position_m2": (self.cov_position_m2.shape, (n, 3, 3)),
            "sigma_attitude_rad": (self.sigma_attitude_rad.shape, (n, 3)),
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
        t = np.asarray(t_gps_s, dtype=np.float64)
        right = np.clip(np.searchsorted(self.t_gps_s, t, side="right"), 1, len(self.t_gps_s) - 1)
        left = right - 1
        u = (t - self.t_gps_s[left]) / (self.t_gps_s[right] - self.t_gps_s[left])
        inside = (u >= 0) & (u <= 1) & self.valid[left] & self.valid[right]
        position = self.position_wcs_m[left] * (1 - u)[:, None] + self.position_wcs_m[right] * u[:, None]
        start = Rotation.from_quat(self.quaternion_wcs_ics[left])
        arc = (start.inv() * Rotation.from_quat(self.quaternion_wcs_ics[right])).as_rotvec()
        rotation = (start * Rotation.from_rotvec(arc * u[:, None])).as_matrix()
        return position, rotation, inside

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
        c = self.cov_position_m2
        columns: dict[str, Any] = {"t_gps_s": self.t_gps_s}
        columns |= {f"{a}_m": self.position_wcs_m[:, i] for i, a in enumerate(("east", "north", "up"))}
        columns |= {f"q{a}": self.quaternion_wcs_ics[:, i] for i, a in enumerate("xyzw")}
        columns |= {f"sigma_{a}_m": np.sqrt(c[:, i, i]) for i, a in enumerate(("east", "north", "up"))}
        columns |= {"cov_en_m2": c[:, 0, 1], "cov_eu_m2": c[:, 0, 2], "cov_nu_m2": c[:, 1, 2]}
        angles = ("roll", "pitch", "heading")
        columns |= {f"sigma_{a}_rad": self.sigma_attitude_rad[:, i] for i, a in enumerate(angles)}
        columns["valid"] = self.valid
        origin = {
            "lat_deg": self.frame.lat_deg, "lon_deg": self.frame.lon_deg, "h_ell_m": self.frame.h_ell_m,
        }  # fmt: skip
        facts = {**(meta or {}), "origin": origin, "pivot_ics_m": self.pivot_ics_m.tolist()}
        write_table(path, pd.DataFrame(columns), TRAJECTORY, facts)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a trajectory written by `write`."""
        table, meta = read_table(path, TRAJECTORY)
        sigma = table[["sigma_east_m", "sigma_north_m", "sigma_up_m"]].to_numpy()
        cov = np.zeros((len(table), 3, 3))
        cov[:, [0, 1, 2], [0, 1, 2]] = sigma**2
        for name, i, j in (("cov_en_m2", 0, 1), ("cov_eu_m2", 0, 2), ("cov_nu_m2", 1, 2)):
            cov[:, i, j] = cov[:, j, i] = table[name].to_numpy()
        return cls(
            frame=LocalFrame(**meta["origin"]),
            t_gps_s=table["t_gps_s"].to_numpy(),
            position_wcs_m=table[["east_m", "north_m", "up_m"]].to_numpy(),
            quaternion_wcs_ics=table[["qx", "qy", "qz", "qw"]].to_numpy(),
            cov_position_m2=cov,
            sigma_attitude_rad=table[["sigma_roll_rad", "sigma_pitch_rad", "sigma_heading_rad"]].to_numpy(),
            valid=table["valid"].to_numpy(dtype=np.bool_),
            pivot_ics_m=np.array(meta["pivot_ics_m"], dtype=np.float64),
        )
