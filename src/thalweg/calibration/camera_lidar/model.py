"""Unknowns and observations of the camera-lidar adjustment (P2 eq. 1-3; P1 eq. 4-6).

Unknowns are the cones in the frame of the field (six each, or five with a fixed half angle), the relative
orientation ``T_ccs_scs`` (six), the exterior orientation of the camera at each position if it has a
covariance (six each, with itself as an observation), and on request one offset of all ranges. With six cones
and fixed exterior orientations these are P2's 42; with one position and the field as "camera" they are P1's 5
per cone + 6.

Observations are distances of reference points from their cone, with the variance ``n^T C n``, and ranges of
lidar points: the measured one less the one at which the nominal beam, through ``x_pcs = T_pcs_ccs T_ccs_scs
x_scs``, meets the cone. To first order that is P2's condition ``distance(x_pcs) = 0`` divided by ``n . d``.
Beyond it there is a difference: derivatives of a distance at a noisy point depend on the noise, which moves
the point around the cone and along it, and least squares then has a mean error (errors in variables) of the
size of the curvature's. The place where the nominal beam meets the cone has no noise. Variances are kept
while an adjustment runs, for the same reason.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np
from scipy import sparse
from scipy.linalg import block_diag

from thalweg.calibration import PARAMETERS, Cone, ConeReference, ConeScan
from thalweg.core import AnyArray, ArrayF, Linear, Observations, Rigid, plane_rates

ORIENTATION: Final = ("lever_x", "lever_y", "lever_z", "rotation_x", "rotation_y", "rotation_z")
"""Six of the relative orientation: shift and small rotation vector, in ccs."""

LIDAR, FIELD = "lidar", "field"
"""First words of the names of groups; the cone or the position follows."""

_LEAST_SLOPE: Final = -0.05
"""A beam never counts as more grazing than this: 87 degrees."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Unknowns:
    """State of the adjustment."""

    cones: tuple[Cone, ...]
    T_ccs_scs: Rigid
    poses: tuple[Rigid, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Where each unknown stands in the vector of changes.

    Parameters
    ----------
    cones, positions : names, in order.
    free_half_angle : six unknowns a cone; five otherwise.
    free_pose : whether each position's exterior orientation is unknown.
    """

    cones: tuple[str, ...]
    positions: tuple[str, ...]
    free_half_angle: bool
    free_pose: tuple[bool, ...]

    @property
    def per_cone(self) -> int:
        """Unknowns of a cone."""
        return 6 if self.free_half_angle else 5

    @property
    def orientation(self) -> slice:
        """Place of the relative orientation."""
        first = self.per_cone * len(self.cones)
        return slice(first, first + 6)

    def cone(self, k: int) -> slice:
        """Place of a cone."""
        return slice(self.per_cone * k, self.per_cone * (k + 1))

    def pose(self, p: int) -> slice | None:
        """Place of an exterior orientation; None if it is fixed."""
        if not self.free_pose[p]:
            return None
        first = self.orientation.stop + 6 * sum(self.free_pose[:p])
        return slice(first, first + 6)

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return self.orientation.stop + 6 * sum(self.free_pose)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        cones = [f"{c}.{p}" for c in self.cones for p in PARAMETERS[: self.per_cone]]
        axes = [w.replace("lever", "shift") for w in ORIENTATION]
        poses = [
            f"{p}.{w}" for p, free in zip(self.positions, self.free_pose, strict=True) if free for w in axes
        ]
        return (*cones, *ORIENTATION, *poses)

    def update(self, x: Unknowns, dx: ArrayF) -> Unknowns:
        """Small changes put on the state."""
        change = np.zeros((len(self.cones), 6))
        change[:, : self.per_cone] = dx[: self.orientation.start].reshape(len(self.cones), -1)
        poses = [
            pose if (at := self.pose(p)) is None else pose.moved(dx[at]) for p, pose in enumerate(x.poses)
        ]
        return replace(
            x,
            cones=tuple(cone.moved(d) for cone, d in zip(x.cones, change, strict=True)),
            T_ccs_scs=x.T_ccs_scs.moved(dx[self.orientation]),
            poses=tuple(poses),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldErrors:
    """Joint errors of exterior orientations and reference points.

    Exterior orientations of one camera share the errors of its interior orientation and of the field, so that
    three positions are not three independent ones.

    Parameters
    ----------
    cov : (6p + 3n, 6p + 3n): shift and rotation vector in pcs of each position, then the coordinates of the
        points of each cone, in the order of both.
    points : number of points of each cone, by name, in that order.
    """

    cov: ArrayF
    points: Mapping[str, int]

    @classmethod
    def independent(cls, references: Sequence[ConeReference], measured: Sequence[Rigid]) -> Self:
        """Errors that neither orientations nor cones share."""
        cov = block_diag(*(T.cov for T in measured), *(r.cov for r in references))
        return cls(cov=cov, points={r.name: len(r.points_m) for r in references})

    def rows_of(self, positions: int, cone: str, used: AnyArray) -> AnyArray:
        """Places of the coordinates of some points of a cone."""
        names = list(self.points)
        first = 6 * positions + 3 * sum(self.points[n] for n in names[: names.index(cone)])
        return (first + 3 * np.flatnonzero(used)[:, None] + np.arange(3)).ravel()


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarRows:
    """Residuals of the lidar points of a position.

    ``residual`` (n,) of the range, metres; ``jacobian`` (n, u); ``normal_pcs`` and ``at_pcs`` (n, 3) of the
    place where the nominal beam meets the cone; ``slope`` (n,) ``n . d`` there, negative.
    """

    residual: ArrayF
    jacobian: ArrayF
    normal_pcs: ArrayF
    at_pcs: ArrayF
    slope: ArrayF

    def by_transform(self, arm: ArrayF) -> ArrayF:
        """Derivatives (n, 6) of the residuals by shift and rotation of the points in pcs; ``arm`` (n, 3)."""
        return plane_rates(self.normal_pcs, arm) / self.slope[:, None]


def field_group(
    layout: Layout,
    references: Sequence[tuple[ConeReference, AnyArray]],
    measured: Sequence[Rigid],
    errors: FieldErrors,
) -> Observations[Unknowns]:
    """All exterior orientations and reference points as one group with their joint covariance."""
    free = [p for p in range(len(measured)) if layout.free_pose[p]]
    n_pose = 6 * len(free)
    poses = [6 * p + np.arange(6) for p in free]
    taken = np.concatenate([*poses, *(errors.rows_of(len(measured), r.name, used) for r, used in references)])
    cov = errors.cov[np.ix_(taken, taken)]
    counts = [int(np.count_nonzero(used)) for _, used in references]
    ends = n_pose + np.cumsum(counts)
    form = np.repeat([r.form_sigma_m**2 for r, _ in references], counts)

    def model(x: Unknowns) -> Linear:
        """At a state."""
        residual = np.empty(ends[-1])
        J = np.zeros((ends[-1], layout.n))
        B = np.zeros((ends[-1], len(cov)))
        # an error of a measured pose goes into "state minus measured" with the other sign than one of a point
        # into its distance from the cone: both share the network's errors, and the sign decides how
        B[:n_pose, :n_pose] = -np.eye(n_pose)
        for i, p in enumerate(free):
            residual[6 * i : 6 * i + 6] = x.poses[p].error_from(measured[p])
            J[6 * i : 6 * i + 6, layout.pose(p)] = np.eye(6)
        for k, (r, used) in enumerate(references):
            own = np.arange(ends[k] - counts[k], ends[k])
            seen = x.cones[k].see(r.points_m[used])
            residual[own] = seen.distance_m
            J[own, layout.cone(k)] = seen.by_parameters[:, : layout.per_cone]
            columns = n_pose + 3 * (own - n_pose)
            for i in range(3):
                B[own, columns + i] = seen.normal[:, i]
        by_errors = sparse.csr_array(B)
        S = by_errors @ (by_errors @ cov).T
        S[np.arange(n_pose, ends[-1]), np.arange(n_pose, ends[-1])] += form
        return Linear(residual=residual, jacobian=J, cov=S[None])

    return Observations(FIELD, model)


def lidar_group(layout: Layout, p: int, scan: ConeScan) -> Observations[Unknowns]:
    """Ranges of the lidar points of position ``p``."""

    def model(x: Unknowns) -> Linear:
        """At a state."""
        rows = lidar_rows(layout, x, p, scan)
        return Linear(residual=rows.residual, jacobian=rows.jacobian, cov=scan.variance_m2)

    return Observations(f"{LIDAR} {layout.positions[p]}", model)


def lidar_rows(layout: Layout, x: Unknowns, p: int, scan: ConeScan) -> LidarRows:
    """Measured ranges less those at which nominal beams meet the cones, with derivatives."""
    reach = np.linalg.norm(scan.points_scs_m, axis=1)
    pose, T = x.poses[p], x.T_ccs_scs
    whole = pose @ T
    beam = (scan.points_scs_m / reach[:, None]) @ whole.R.T
    n = len(reach)
    nominal, slope, normal = np.empty(n), np.empty(n), np.empty((n, 3))
    J = np.zeros((n, layout.n))
    for k in np.unique(scan.cone):
        on = np.flatnonzero(scan.cone == k)
        cone = x.cones[k]
        entry = cone.ranges_m(whole.shift_m, beam[on])
        hit = np.isfinite(entry)
        # On the way a beam may miss the cone; it is then judged where the measured point lies.
        way = np.where(hit, entry, reach[on])
        seen = cone.see(whole.shift_m + way[:, None] * beam[on])
        normal[on] = seen.normal
        slope[on] = np.minimum(np.einsum("ij,ij->i", seen.normal, beam[on]), _LEAST_SLOPE)
        nominal[on] = way - np.where(hit, 0.0, seen.distance_m / slope[on])
        J[on, layout.cone(k)] = seen.by_parameters[:, : layout.per_cone]
    at_pcs = whole.shift_m + nominal[:, None] * beam
    in_ccs = (at_pcs - pose.shift_m) @ pose.R
    J[:, layout.orientation] = plane_rates(normal @ pose.R, in_ccs - T.shift_m)
    if (at := layout.pose(p)) is not None:
        J[:, at] = plane_rates(normal, at_pcs - pose.shift_m)
    J /= slope[:, None]
    return LidarRows(
        residual=reach - nominal - scan.excess_m, jacobian=J, normal_pcs=normal, at_pcs=at_pcs, slope=slope
    )


def groups_of(
    layout: Layout,
    references: Sequence[tuple[ConeReference, AnyArray]],
    measured: Sequence[Rigid],
    scans: Sequence[ConeScan],
    errors: FieldErrors | None = None,
) -> list[Observations[Unknowns]]:
    """All groups of observations; ``references`` with the mask (n,) of the points that are used."""
    lidar = [lidar_group(layout, p, scan) for p, scan in enumerate(scans) if len(scan.cone)]
    joint = errors or FieldErrors.independent([r for r, _ in references], measured)
    return [field_group(layout, references, measured, joint), *lidar]
