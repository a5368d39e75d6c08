"""Lidar points of a calibration run on the moving boat, and the cones of the field they may lie on."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import savgol_filter

from thalweg.calibration.cones.cone import Cone
from thalweg.clocks.streams.spans import apart_words, span_text
from thalweg.core.errors import CoverageError, GeometryError
from thalweg.core.rigid import Rigid
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayB, ArrayF, ArrayI

_SMOOTHED_S: Final = 1.5
"""Half of the time over which velocities are smoothed."""

_DEGREE: Final = 3
_HOLE: Final = 3.0
"""Nodes that are farther apart than so many usual steps have a gap between them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldCones:
    """The reference cones of a calibration field.

    Parameters
    ----------
    names : of the cones, for messages and tables.
    cones : in pcs.
    length_m : (c,) from the apex to the base along the axis.
    cov : (6 c, 6 c) joint covariance of the parameters of all cones; nothing given: that of each by itself.

    Raises
    ------
    GeometryError : numbers of names, cones and lengths differ, or a name stands twice.
    """

    names: tuple[str, ...]
    cones: tuple[Cone, ...]
    length_m: ArrayF
    cov: ArrayF = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        c = len(self.cones)
        length = np.asarray(self.length_m, dtype=np.float64)
        if len(self.names) != c or length.shape != (c,) or len(set(self.names)) != c or not c:
            raise GeometryError(
                f"{len(set(self.names))} names, {c} cones, {length.size} lengths",
                expected="a name and a length for each cone",
            )
        cov = np.asarray(self.cov, dtype=np.float64)
        if cov.size == 0:
            cov = np.zeros((6 * c, 6 * c))
            for k, cone in enumerate(self.cones):
                cov[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = cone.cov
        if cov.shape != (6 * c, 6 * c):
            raise GeometryError(f"a covariance {cov.shape} of {c} cones", expected=f"{(6 * c, 6 * c)}")
        object.__setattr__(self, "length_m", length)
        object.__setattr__(self, "cov", cov)

    def only(self, keep: Sequence[int]) -> Self:
        """Some of the cones."""
        at = np.concatenate([np.arange(6 * k, 6 * k + 6) for k in keep])
        return type(self)(
            names=tuple(self.names[k] for k in keep),
            cones=tuple(self.cones[k] for k in keep),
            length_m=self.length_m[list(keep)],
            cov=self.cov[np.ix_(at, at)],
        )

    def moved(self, change: ArrayF) -> tuple[Cone, ...]:
        """The cones with all their parameters changed by (6 c,)."""
        return tuple(cone.moved(d) for cone, d in zip(self.cones, change.reshape(-1, 6), strict=True))

    def spheres(self, T_wcs_pcs: Rigid) -> tuple[ArrayF, ArrayF]:
        """Centres (c, 3) in wcs and radii (c,) of spheres about the cones."""
        middle = [c.apex_m + 0.5 * h * c.axis for c, h in zip(self.cones, self.length_m, strict=True)]
        base = self.length_m * np.tan([cone.half_angle_rad for cone in self.cones])
        return T_wcs_pcs.apply(np.asarray(middle)), np.hypot(0.5 * self.length_m, base)

    def near(self, points_wcs_m: ArrayF, T_wcs_pcs: Rigid, margin_m: float) -> ArrayI:
        """Number (n,) of the nearest cone within whose sphere, widened by a margin, points lie; else -1."""
        centre, radius = self.spheres(T_wcs_pcs)
        out = np.full(len(points_wcs_m), -1, dtype=np.int64)
        least = np.full(len(points_wcs_m), np.inf)
        for k, (c, r) in enumerate(zip(centre, radius, strict=True)):
            beyond = np.linalg.norm(points_wcs_m - c, axis=1) - r
            closer = (beyond < margin_m) & (beyond < least)
            out[closer], least[closer] = k, beyond[closer]
        return out


@dataclass(frozen=True, slots=True, kw_only=True)
class RunPoints:
    """Points of the moving scanner with the pose of the moment of each.

    Parameters
    ----------
    xyz_scs_m : (n, 3) in the scanner frame.
    t_gps_s : (n,).
    position_wcs_m, R_wcs_ics : (n, 3), (n, 3, 3) pose of ics.
    velocity_wcs_mps, rate_wcs_radps : (n, 3) of the ics origin, and angular velocity, both smoothed.
    """

    xyz_scs_m: ArrayF
    t_gps_s: ArrayF
    position_wcs_m: ArrayF
    R_wcs_ics: ArrayF
    velocity_wcs_mps: ArrayF
    rate_wcs_radps: ArrayF

    @classmethod
    def on(cls, trajectory: Trajectory, xyz_scs_m: ArrayLike, t_gps_s: ArrayLike) -> Self:
        """Points with poses, in the order of time; those without a valid pose are left out.

        Raises
        ------
        CoverageError : the points and the trajectory do not overlap in time.
        """
        xyz = np.atleast_2d(np.asarray(xyz_scs_m, dtype=np.float64))
        t = np.asarray(t_gps_s, dtype=np.float64)
        first, last = trajectory.span()
        keep = np.flatnonzero(np.isfinite(t) & (t >= first) & (t <= last))
        keep = keep[np.argsort(t[keep], kind="stable")]
        position, R, valid = trajectory.at(t[keep])
        keep, position, R = keep[valid], position[valid], R[valid]
        if not keep.size:
            raise no_pose(trajectory, t)
        left = np.clip(np.searchsorted(trajectory.t_gps_s, t[keep], side="right") - 1, 0, None)
        velocity, rate = smooth_rates(trajectory)
        left = np.minimum(left, len(rate) - 1)
        return cls(
            xyz_scs_m=xyz[keep], t_gps_s=t[keep], position_wcs_m=position, R_wcs_ics=R,
            velocity_wcs_mps=velocity[left], rate_wcs_radps=rate[left],
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.t_gps_s)

    def taken(self, rows: ArrayI | ArrayB) -> Self:
        """Some of the points."""
        return type(self)(
            xyz_scs_m=self.xyz_scs_m[rows], t_gps_s=self.t_gps_s[rows],
            position_wcs_m=self.position_wcs_m[rows], R_wcs_ics=self.R_wcs_ics[rows],
            velocity_wcs_mps=self.velocity_wcs_mps[rows], rate_wcs_radps=self.rate_wcs_radps[rows],
        )  # fmt: skip

    def in_wcs(self, T_ics_scs: Rigid) -> ArrayF:
        """Points (n, 3) in the world for a mount (P1 eq. 7-8)."""
        return self.to_wcs(T_ics_scs.apply(self.xyz_scs_m))

    def to_wcs(self, points_ics_m: ArrayF) -> ArrayF:
        """One point of ics (3,), or one for each point (n, 3), in the world at the time of each."""
        points = np.broadcast_to(points_ics_m, (len(self), 3))
        return np.asarray(np.einsum("nij,nj->ni", self.R_wcs_ics, points) + self.position_wcs_m)

    def heading_rad(self) -> ArrayF:
        """Heading (n,) of the boat at each point, clockwise from north."""
        return np.asarray(np.arctan2(self.R_wcs_ics[:, 0, 0], self.R_wcs_ics[:, 1, 0]))


def no_pose(trajectory: Trajectory, t_gps_s: ArrayF, n: int | None = None) -> CoverageError:
    """The error about lidar points of which none has a pose.

    Logs of different times are told from a log without clock, and from points in the trajectory's gaps.

    Parameters
    ----------
    trajectory : of the run.
    t_gps_s : (m,) times of the points, or the first and last of each part of them; NaN without a clock.
    n : number of points, if there are more than times.
    """
    timed = t_gps_s[np.isfinite(t_gps_s)]
    first, last = trajectory.span()
    count = f"{len(t_gps_s) if n is None else n:,} lidar points"
    if not timed.size:
        return CoverageError(
            f"{count} of no time with a clock",
            expected="lidar stamps that are tied to GPS time",
            cure="Check pulse per second and NMEA of the lidar, and the reception of its GNSS receiver",
        )
    lidar = (float(timed.min()), float(timed.max()))
    apart = apart_words(lidar, (first, last))
    if not apart:
        return CoverageError(
            f"{count} of {span_text(*lidar)} lie in gaps of the trajectory, which covers "
            f"{span_text(first, last)}",
            expected="poses while the lidar sees the cones",
            cure="Look at the gaps of INS and positions in the table of streams",
        )
    return CoverageError(
        f"{count} of {span_text(*lidar)}, but the trajectory covers "
        f"{span_text(first, last)}; the lidar's log: {apart}",
        expected="lidar, INS and positions of the same run",
        cure="Set the hour of the lidar's clock right, or its offset from UTC"
        if "hour" in apart
        else "Record lidar, INS and GNSS at the same time; check that the logs belong together",
    )


def smooth_rates(trajectory: Trajectory) -> tuple[ArrayF, ArrayF]:
    """Velocity and angular velocity (n - 1, 3) of the intervals of a trajectory, smoothed over three seconds.

    Differences of positions hold the noise of these positions, so an offset in time that is estimated with
    them is wrong: 1 cm of noise at 10 Hz is more velocity than the boat has. A cubic polynomial is fitted to
    the neighbourhood of each interval (Savitzky and Golay 1964), which treats errors before and after alike.

    Nothing is smoothed across a gap: at an invalid node, or where nodes are missing, a piece ends. Pieces
    that are shorter than the window get a shorter one; those of less than five intervals, and intervals
    inside a gap, which no point uses, keep their plain differences.
    """
    velocity, rate = trajectory.rates()
    steps = np.diff(trajectory.t_gps_s)
    step = float(np.median(steps))
    whole = trajectory.valid[:-1] & trajectory.valid[1:] & (steps < _HOLE * step)
    both = np.concatenate([velocity, rate], axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], whole, [False]]).astype(np.int8)))
    for start, end in edges.reshape(-1, 2):
        n = int(end - start)
        window = min(2 * round(_SMOOTHED_S / step) + 1, n - 1 + n % 2)
        if window >= _DEGREE + 2:
            both[start:end] = savgol_filter(both[start:end], window, _DEGREE, axis=0)
    return both[:, :3], both[:, 3:]
