"""Which points of a lidar scan lie on which cone, told by where their beams should go.

A point near the outline of a cone is seen only if its beam errs toward the cone, and at a grazing angle a
sideways error of the beam becomes a large error of range. Both are biases of selection: no mean of such
points is right. So a beam takes part if its *nominal* direction meets the cone far enough inside the outline
and the ends, and not too obliquely. What it measured then decides only whether something else was in the way.
What stood in the way has an outline, too: beams beside it are left out as well, because those that err
toward it are missing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Final, Protocol, Self

import numpy as np
from scipy.spatial import cKDTree

from thalweg.calibration.cones.cone import Cone, ConeBeams, beam_spread
from thalweg.core.errors import InputError
from thalweg.core.rigid import Rigid
from thalweg.core.types import AnyArray, ArrayF


class BeamVariances(Protocol):
    """What a single measurement of a scanner is worth, as `thalweg.lidar.covariance.BeamErrors`."""

    def variances(self, range_m: ArrayF, reflectivity: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Variances (n,) along the beam and across it in each direction, m^2."""
        ...


class Verdict(IntEnum):
    """What became of a beam that should meet a cone, and `AWAY` for all other beams."""

    AWAY = 0
    USED = 1
    GRAZING = 2
    OUTLINE = 3
    END = 4
    IN_FRONT = 5
    BEHIND = 6
    BESIDE = 7


@dataclass(frozen=True, slots=True, kw_only=True)
class Position:
    """A static position of the boat: what the camera and the lidar saw there.

    Parameters
    ----------
    name : of the position.
    T_pcs_ccs : exterior orientation of the camera in the frame of the field; without covariance it is
        taken as free of error.
    points_scs_m : (n, 3) in the frame of the scanner.
    var_along_m2, var_across_m2 : (n,) variances of a point along its beam and in each direction across.
    """

    name: str
    T_pcs_ccs: Rigid
    points_scs_m: ArrayF
    var_along_m2: ArrayF
    var_across_m2: ArrayF

    @classmethod
    def measured(
        cls,
        name: str,
        T_pcs_ccs: Rigid,
        points_scs_m: ArrayF,
        beam_errors: BeamVariances,
        reflectivity: ArrayF | None = None,
    ) -> Self:
        """From points and the accuracy of the scanner.

        Raises
        ------
        InputError : no points, or coordinates that are not finite.
        """
        points = np.asarray(points_scs_m, dtype=np.float64)
        if points.ndim != 2 or points.shape[1:] != (3,) or not len(points):
            raise InputError(
                f"points of the shape {points.shape}",
                expected="(n, 3) with at least one point",
                where=f"position {name}",
                cure="Check that the recording of this position holds the scan",
            )
        if not np.isfinite(points).all():
            raise InputError("points that are not finite", where=f"position {name}")
        reach = np.linalg.norm(points, axis=1)
        along, across = beam_errors.variances(
            reach, np.full(len(reach), 50.0) if reflectivity is None else reflectivity
        )
        return cls(
            name=name, T_pcs_ccs=T_pcs_ccs, points_scs_m=points, var_along_m2=along, var_across_m2=across
        )

    def at(self, T_pcs_ccs: Rigid) -> "Position":
        """The same scan with another exterior orientation of the camera."""
        return replace(self, T_pcs_ccs=T_pcs_ccs)

    def taken(self, rows: AnyArray) -> "Position":
        """Some of the points."""
        return Position(
            name=self.name, T_pcs_ccs=self.T_pcs_ccs, points_scs_m=self.points_scs_m[rows],
            var_along_m2=self.var_along_m2[rows], var_across_m2=self.var_across_m2[rows],
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectionLimits:
    """What a beam must keep to.

    Parameters
    ----------
    max_incidence_deg : greatest nominal angle between beam and normal.
    margin_sigmas : how far inside outline and ends a beam must be, in standard deviations across the beam.
    reject_sigmas : distance from the surface, beyond which a point belongs to something else.
    slack_m : further allowance of that distance, for a cone or an orientation that is only roughly known.
    """

    max_incidence_deg: float = 65.0
    margin_sigmas: float = 3.0
    reject_sigmas: float = 4.0
    slack_m: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """For each point (n,): number of the cone that its beam should meet, -1 for none; and its `Verdict`.

    ``excess_m`` and ``variance_m2`` (n,) are mean and variance of the measured range about the nominal one,
    NaN for points that are not used.
    """

    cone: AnyArray
    verdict: AnyArray
    excess_m: ArrayF
    variance_m2: ArrayF

    def rows(self, cone: int, verdict: Verdict = Verdict.USED) -> AnyArray:
        """Points of a cone with a verdict."""
        return np.flatnonzero((self.cone == cone) & (self.verdict == verdict))

    def counts(self, cone: int) -> dict[Verdict, int]:
        """How many beams of a cone had which verdict."""
        mine = self.verdict[self.cone == cone]
        return {v: int(np.count_nonzero(mine == v)) for v in Verdict if v is not Verdict.AWAY}


@dataclass(frozen=True, slots=True, kw_only=True)
class ConeScan:
    """Points of a position that take part: ``points_scs_m`` (n, 3), number of the ``cone`` (n,) of each, and
    mean excess and variance (n,) of its range, see `thalweg.calibration.cones.cone.beam_spread`.
    """

    points_scs_m: ArrayF
    cone: AnyArray
    excess_m: ArrayF
    variance_m2: ArrayF


def select(
    cones: Sequence[Cone],
    lengths_m: Sequence[float],
    T_pcs_scs: Rigid,
    position: Position,
    limits: SelectionLimits,
    *,
    variance_factor: float = 1.0,
) -> Selection:
    """Which points lie on which cone.

    Parameters
    ----------
    cones : in pcs.
    lengths_m : of each cone along its axis.
    T_pcs_scs : where the scanner stands.
    position : its points.
    limits : see there.
    variance_factor : of the lidar's variances.
    """
    points = position.points_scs_m
    reach = np.linalg.norm(points, axis=1)
    beam = points @ T_pcs_scs.R.T / reach[:, None]
    origin = T_pcs_scs.shift_m
    across = np.sqrt(variance_factor * position.var_across_m2)
    along = variance_factor * position.var_along_m2
    nearest = np.full(len(points), np.inf)
    out = Selection(
        cone=np.full(len(points), -1, dtype=np.int64),
        verdict=np.zeros(len(points), dtype=np.int64),
        excess_m=np.full(len(points), np.nan),
        variance_m2=np.full(len(points), np.nan),
    )
    for k, (cone, length) in enumerate(zip(cones, lengths_m, strict=True)):
        rows = passing(cone, length, origin, beam)
        met = cone.meet(origin, beam[rows])
        slant = length / np.cos(cone.half_angle_rad)
        on = met.hit & (met.slant_m <= slant) & (np.nan_to_num(met.range_m, nan=np.inf) < nearest[rows])
        rows, met = rows[on], ConeBeams(*(values[on] for values in met))
        nearest[rows] = met.range_m
        margin = limits.margin_sigmas * across[rows]
        end = margin / np.maximum(met.sine_ruling, 0.05)
        verdict = np.full(len(rows), int(Verdict.USED))
        verdict[(met.slant_m < end) | (met.slant_m > slant - end)] = Verdict.END
        verdict[met.depth_m < margin] = Verdict.OUTLINE
        verdict[met.cosine < np.cos(np.deg2rad(limits.max_incidence_deg))] = Verdict.GRAZING
        inner = np.flatnonzero(verdict == Verdict.USED)
        at = rows[inner]
        excess, variance = beam_spread(cone, origin, beam[at], across[at])
        variance = variance + along[at]
        off = reach[at] - met.range_m[inner] - excess
        allowed = limits.reject_sigmas * np.sqrt(variance) + limits.slack_m / met.cosine[inner]
        verdict[inner[off < -allowed]] = Verdict.IN_FRONT
        verdict[inner[off > allowed]] = Verdict.BEHIND
        verdict[_beside(beam[rows], met.range_m, margin, verdict)] = Verdict.BESIDE
        out.cone[rows], out.verdict[rows] = k, verdict
        out.excess_m[at], out.variance_m2[at] = excess, variance
    return out


def _beside(beam: ArrayF, range_m: ArrayF, margin_m: ArrayF, verdict: AnyArray) -> AnyArray:
    """Rows of used beams that pass within the margin of one that was reflected in front."""
    used, front = np.flatnonzero(verdict == Verdict.USED), np.flatnonzero(verdict == Verdict.IN_FRONT)
    if not len(front) or not len(used):
        return used[:0]
    apart, _ = cKDTree(beam[front]).query(beam[used])
    return used[apart * range_m[used] < margin_m[used]]


def passing(cone: Cone, length_m: float, origin_m: ArrayF, beam: ArrayF, margin_m: float = 0.0) -> AnyArray:
    """Rows of the beams (n, 3) that pass the sphere around a cone, a cheap first choice."""
    rim = length_m * np.tan(cone.half_angle_rad)
    radius = float(np.hypot(length_m / 2, rim)) + margin_m
    arm = cone.apex_m + cone.axis * length_m / 2 - origin_m
    along = beam @ arm
    return np.flatnonzero((along > 0) & (arm @ arm - along**2 < radius**2))


WORDS: Final[Mapping[Verdict, str]] = {
    Verdict.USED: "used",
    Verdict.GRAZING: "grazing",
    Verdict.OUTLINE: "outline",
    Verdict.END: "end",
    Verdict.IN_FRONT: "in_front",
    Verdict.BEHIND: "behind",
    Verdict.BESIDE: "beside",
}
"""Column names of the detection table."""
