"""Lidar points of a calibration run on the moving boat, and the cones of the field they may lie on."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import savgol_filter

from thalweg.calibration import Cone
from thalweg.clocks import apart_words, span_text
from thalweg.core import ArrayB, ArrayF, ArrayI, CoverageError, Rigid, Trajectory, njit, plane_rates, rows_of
from thalweg.settings.sections import InsLidarFit

_SMOOTHED_S: Final = 1.5
"""Half of the time over which velocities are smoothed."""
_DEGREE: Final = 3
_HOLE: Final = 3.0
"""Nodes that are farther apart than so many usual steps have a gap between them."""

SAMPLED: Final = 500
"""Points of each block that are kept to say where the lidar's points are."""

SCORE_WIDTH_M: Final = 0.10
"""Width of the score's kernel: wider than the errors of trajectory and scanner, narrower than a cone."""
ANNEAL_M: Final = (0.20, 0.12, 0.08, 0.05)
"""Widths of the robust fit; the last one is three sigma of a point (P2 eq. 7)."""
_CHUNK: Final = 200


# ---------------------------------------------------------------- points of a run


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldCones:
    """The reference cones of a calibration field.

    Parameters
    ----------
    names : of the cones, for messages and tables.
    cones : in pcs.
    length_m : (c,) from the apex to the base along the axis.
    cov : (6 c, 6 c) joint covariance of the parameters of all cones; nothing given: that of each by itself.
    """

    names: tuple[str, ...]
    cones: tuple[Cone, ...]
    length_m: ArrayF
    cov: ArrayF = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        c = len(self.cones)
        length = np.asarray(self.length_m, dtype=np.float64)
        cov = np.asarray(self.cov, dtype=np.float64)
        if cov.size == 0:
            cov = np.zeros((6 * c, 6 * c))
            for k, cone in enumerate(self.cones):
                cov[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = cone.cov
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
            xyz_scs_m=xyz[keep],
            t_gps_s=t[keep],
            position_wcs_m=position,
            R_wcs_ics=R,
            velocity_wcs_mps=velocity[left],
            rate_wcs_radps=rate[left],
        )

    def __len__(self) -> int:
        return len(self.t_gps_s)

    def taken(self, rows: ArrayI | ArrayB) -> Self:
        """Some of the points."""
        return rows_of(self, rows)

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
    return CoverageError(
        f"{count} of {span_text(*lidar)}, but the trajectory covers {span_text(first, last)}"
        + (f"; the lidar's log: {apart}" if apart else ", with gaps then"),
        expected="lidar, INS and positions of the same run, with poses while the lidar sees the cones",
        cure="Check that the logs belong together, the hour of the lidar's clock and its offset from UTC, "
        "and the gaps of INS and positions in the table of streams",
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


# ---------------------------------------------------------------- points of a lidar log that may lie on cones
#
# A log is read in blocks. Of each block the points near the cones are kept, and some of all others: if none
# comes near, these say where the lidar's points are and where the cones should be.


@dataclass(slots=True, kw_only=True)
class NearCones:
    """Collects the points of a lidar log near the cones of a field, block by block.

    Parameters
    ----------
    trajectory : of the run.
    cones, T_wcs_pcs : the field, and its place in the world.
    reach_m : how far from a cone points may lie with the mount by which they were put into the world.
    """

    trajectory: Trajectory
    cones: FieldCones
    T_wcs_pcs: Rigid
    reach_m: float
    n: int = 0
    _near: list[ArrayF] = field(default_factory=list)
    _times: list[ArrayF] = field(default_factory=list)
    _sample: list[ArrayF] = field(default_factory=list)

    def add(self, xyz_scs_m: ArrayF, t_gps_s: ArrayF, points_wcs_m: ArrayF, has_pose: ArrayB) -> None:
        """A block: points (n, 3) in scs, their times (n,), and in the world (n, 3) where they have a pose."""
        self.n += len(t_gps_s)
        timed = t_gps_s[np.isfinite(t_gps_s)]
        if timed.size:
            self._times.append(np.array([timed.min(), timed.max()]))
        posed = np.flatnonzero(has_pose)
        self._sample.append(points_wcs_m[posed[:: max(posed.size // SAMPLED, 1)]])
        near = posed[self.cones.near(points_wcs_m[posed], self.T_wcs_pcs, self.reach_m) >= 0]
        self._near.append(np.column_stack([xyz_scs_m[near], t_gps_s[near]]))

    def points(self) -> RunPoints:
        """The points near the cones, with poses.

        Raises
        ------
        CoverageError : the log is empty, has no clock or none that overlaps with the trajectory; or no point
            is near a cone: with distance and direction of the field, and what may be the cause.
        """
        if not self.n:
            raise CoverageError(
                "the lidar log holds no points",
                expected="a run past the cones of the field",
                cure="Check logs.lidar, and the limits of the range in the section lidar",
            )
        sample = np.concatenate(self._sample)
        if not len(sample):
            raise no_pose(self.trajectory, np.concatenate([np.zeros(0), *self._times]), self.n)
        rows = np.concatenate(self._near)
        if not len(rows):
            centre = np.median(self.cones.spheres(self.T_wcs_pcs)[0], axis=0)
            east, north, up = centre - np.median(sample, axis=0)
            raise CoverageError(
                f"the lidar and the trajectory overlap in time, but none of {self.n:,} lidar points comes "
                f"within {self.reach_m:.1f} m of a cone: the cones {', '.join(self.cones.names)} are "
                f"{east:+,.1f} m east, {north:+,.1f} m north, {up:+,.1f} m up of the middle of the points",
                expected="a run past the cones of the field, in the world frame of its targets",
                cure="Check coordinates (lat_deg, lon_deg), datum and ellipsoidal heights (the pole taken "
                "off) of the targets and of the base, and that the run was recorded at this field",
            )
        return RunPoints.on(self.trajectory, rows[:, :3], rows[:, 3])


# ---------------------------------------------------------------- cones in the points of a moving scanner,
# from coarse to fine
#
# The mount is known roughly: the angles to some degrees, the lever arm to some decimetres (T 3.1.1 starts
# with 0). A grid of lever arms, then one of angles, is scored by how many points come to lie on the cones'
# surfaces; each cone counts by the logarithm of its own score, so that one near cone cannot outvote the
# others, and the ground beneath a cone has no say beside its surface. From the best place a robust fit goes
# on with weights ``(w^2 / (w^2 + d^2))^2`` (Geman and McClure 1987) whose width ``w`` shrinks.
#
# Which points then enter an adjustment is decided by the surface alone: near it, between apex and base, and
# not met at a grazing angle, where a beam that leaves aside passes or comes from elsewhere.


@dataclass(frozen=True, slots=True, kw_only=True)
class MountRange:
    """How far from the start the mount may be.

    Parameters
    ----------
    lever_m : in each component of the lever arm.
    angle_deg : about each axis of ics.
    points_per_cone : points that are tried for each cone at most.
    """

    lever_m: float = InsLidarFit().search_lever_m
    angle_deg: float = InsLidarFit().search_angle_deg
    points_per_cone: int = 600

    @property
    def reach_m(self) -> float:
        """How far from a cone its points may lie with the start's lever arm."""
        return float(self.lever_m * np.sqrt(3) + 0.1)


@dataclass(frozen=True, slots=True, kw_only=True)
class OnCones:
    """Points (n,) on the surface of a cone by the present state of knowledge.

    ``cone`` number of the cone in whose neighbourhood a point lies, -1 none; ``used``; and why others are
    not: ``far`` from the surface, beyond the ``ends``, met at a ``grazing`` angle or beside the outline.
    """

    cone: ArrayI
    used: ArrayB
    far: ArrayB
    ends: ArrayB
    grazing: ArrayB


def find_mount(
    points: RunPoints, field: FieldCones, T_wcs_pcs: Rigid, start: Rigid, search: MountRange
) -> Rigid:
    """The mount ``T_ics_scs`` to some centimetres, from a start that is decimetres off.

    Raises
    ------
    CoverageError : no point of the run comes near any cone, or none lies on one.
    """
    reach = search.reach_m
    near = field.near(points.in_wcs(start), T_wcs_pcs, reach)
    if not np.any(near >= 0):
        raise CoverageError(
            f"none of {len(points)} lidar points comes within {reach:.1f} m of one of the cones "
            f"{', '.join(field.names)}",
            expected="a run past the cones of the field",
            cure="Check heights and datum of the field's targets, and record a run along the cones",
        )
    parts, cones = [], []
    for k, cone in enumerate(field.cones):
        rows = np.flatnonzero(near == k)
        if rows.size:
            rows = rows[:: -(-rows.size // search.points_per_cone)]
            parts.append(points.taken(rows))
            cones.append((cone.in_frame(T_wcs_pcs), float(field.length_m[k])))
    mount = start
    steps = np.arange(-search.lever_m, search.lever_m + 0.05, 0.1)
    turns = np.deg2rad(np.arange(-search.angle_deg, search.angle_deg + 0.5, 1.0))
    for grid, turning in ((steps, False), (turns, True), (np.linspace(-0.2, 0.2, 9), False)):
        mount = _best(parts, cones, mount, grid, turning=turning)
    for width in ANNEAL_M:
        for _ in range(4):
            mount = _robust_step(parts, cones, mount, width)
    return mount


def _best(
    parts: list[RunPoints], cones: list[tuple[Cone, float]], mount: Rigid, grid: ArrayF, *, turning: bool
) -> Rigid:
    """The mount with the best score on a grid of shifts, or of rotation vectors, in ics."""
    changes = np.stack(np.meshgrid(grid, grid, grid, indexing="ij"), axis=-1).reshape(-1, 3)
    total = np.zeros(len(changes))
    for part, (cone, length) in zip(parts, cones, strict=True):
        arm = part.xyz_scs_m @ mount.R.T
        beam = np.einsum("nij,nj->ni", part.R_wcs_ics, arm / np.linalg.norm(arm, axis=1, keepdims=True))
        start = part.to_wcs(mount.apply(part.xyz_scs_m))
        score = np.empty(len(changes))
        for at in range(0, len(changes), _CHUNK):
            some = changes[at : at + _CHUNK]
            if turning:
                moved = np.einsum("nij,gnj->gni", part.R_wcs_ics, np.cross(some[:, None], arm[None]))
            else:
                moved = np.einsum("nij,gj->gni", part.R_wcs_ics, some)
            score[at : at + _CHUNK] = _score(
                cone.apex_m, cone.axis, cone.half_angle_rad, length, start, moved, beam
            )
        total += np.log(0.05 + score / max(float(score.max()), 1e-9))
    error = np.zeros(6)
    error[3 if turning else 0 :][:3] = changes[int(np.argmax(total))]
    return mount.moved(error)


@njit(cache=True, error_model="numpy")
def _score(
    apex_m: ArrayF, axis: ArrayF, half_angle_rad: float, length_m: float,
    start_m: ArrayF, moved_m: ArrayF, beam: ArrayF,
) -> ArrayF:  # fmt: skip
    """How many of points (n, 3), moved by (g, n, 3), lie on the side of a cone that beams (n, 3) see, softly
    counted, (g,).
    """
    cos_a, sin_a = np.cos(half_angle_rad), np.sin(half_angle_rad)
    score = np.zeros(len(moved_m))
    d = np.empty(3)
    for g in range(len(moved_m)):
        for i in range(len(start_m)):
            z = against = along = rho = 0.0
            for j in range(3):
                d[j] = start_m[i, j] + moved_m[g, i, j] - apex_m[j]
                z += d[j] * axis[j]
                along += beam[i, j] * axis[j]
            for j in range(3):
                across = d[j] - z * axis[j]
                rho += across * across
                against += across * beam[i, j]
            rho = np.sqrt(rho)
            toward = cos_a * against / max(rho, 1e-9) - sin_a * along
            if 0.0 < z < length_m and toward < 0.0:
                distance = rho * cos_a - z * sin_a
                score[g] += np.exp(-0.5 * (distance / SCORE_WIDTH_M) ** 2)
    return score


def _robust_step(
    parts: list[RunPoints], cones: list[tuple[Cone, float]], mount: Rigid, width_m: float
) -> Rigid:
    N, n = np.zeros((6, 6)), np.zeros(6)
    for part, (cone, length) in zip(parts, cones, strict=True):
        seen = cone.see(part.in_wcs(mount))
        slant = length / np.cos(cone.half_angle_rad)
        J = mount_rows(part, mount, seen.normal)
        toward = np.einsum("ni,ni->n", J[:, :3], part.xyz_scs_m @ mount.R.T)
        on = (seen.slant_m > 0) & (seen.slant_m < slant) & (toward < 0)
        weight = np.where(on, (width_m**2 / (width_m**2 + seen.distance_m**2)) ** 2, 0.0)
        # one vote a cone: near cones have many more points
        weight /= max(float(weight.sum()), 1e-9)
        N += J.T @ (J * weight[:, None])
        n -= J.T @ (weight * seen.distance_m)
    if not np.trace(N) > 0:
        raise CoverageError(
            f"lidar points come near {len(cones)} cones, but none lies on the side that its beam can see",
            expected="points on the surfaces of the cones",
            cure="Check heights and datum of the field's targets (a pole that was not taken off is 2 m), "
            "that the cones stand as they were measured, and calibration.ins_lidar.search_lever_m",
        )
    # 1e-9 of the largest: a direction that no point determines stays where it is
    return mount.moved(np.linalg.solve(N + 1e-9 * np.trace(N) * np.eye(6), n))


def mount_rows(points: RunPoints, T_ics_scs: Rigid, normal_wcs: ArrayF) -> ArrayF:
    """Change (n, 6) of a component of points in wcs with the error (shift; rotation) of the mount in ics."""
    normal_ics = np.einsum("nij,ni->nj", points.R_wcs_ics, normal_wcs)
    arm = points.xyz_scs_m @ T_ics_scs.R.T
    return plane_rates(normal_ics, arm)


def select(
    cone: ArrayI,
    distance_m: ArrayF,
    slant_m: ArrayF,
    cosine: ArrayF,
    *,
    ends_m: ArrayF,
    gate_m: ArrayF | float,
    end_margin_m: float,
    max_incidence_deg: float,
) -> OnCones:
    """Which points lie on the surfaces.

    Parameters
    ----------
    cone : (n,) number of the cone in whose neighbourhood a point lies, -1 none.
    distance_m, slant_m, cosine : (n,) distance from the surface, and where and at which cosine of incidence
        the nominal beam meets it; NaN where it does not.
    ends_m : (c,) length of each cone along its surface.
    gate_m : half width of the layer about the surface, for each point (n,) or for all.
    end_margin_m : points nearer to apex or base are left out.
    max_incidence_deg : points met at a larger angle are left out.
    """
    met = (cone >= 0) & np.isfinite(distance_m)
    away = met & (np.abs(np.nan_to_num(distance_m)) > gate_m)
    on = met & ~away
    outside = (slant_m < end_margin_m) | (slant_m > ends_m[cone] - end_margin_m)
    flat = cosine < np.cos(np.deg2rad(max_incidence_deg))
    return OnCones(
        cone=cone,
        used=on & ~outside & ~flat,
        far=away,
        ends=on & outside,
        grazing=(on & ~outside & flat) | ((cone >= 0) & ~met),
    )
