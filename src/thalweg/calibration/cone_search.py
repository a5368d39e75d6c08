"""Cones in lidar scans: which points lie on which cone, and why a cone is not seen."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Final, Self

import numpy as np
from scipy.spatial import cKDTree

from thalweg.calibration.cones import Cone, ConeBeams, beam_spread
from thalweg.calibration.target_search import Found, SearchRange, Targets, balance, passing, search_targets
from thalweg.core import AnyArray, ArrayF, InputError, Rigid, rows_of
from thalweg.settings.sections import CameraLidarFit, LidarAccuracy

AGAIN: Final = "photograph the field and record the positions again, or leave the cone out"
_BESIDE_SIGMAS: Final = 2.5
"""Mean offset of the points of a cone in sigmas of one; the search is right to a fraction of that."""


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
        beam_errors: LidarAccuracy,
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
        return rows_of(self, rows)


# ---------------------------------------------------------------- relative orientation from all cones at
# once, without cropping by hand


def search(
    cones: Sequence[Cone],
    lengths_m: Sequence[float],
    positions: Sequence[Position],
    nominal: Rigid,
    within: SearchRange,
) -> Found:
    """Orientation ``T_ccs_scs`` near the nominal one by cones in pcs, see `search_targets`."""
    at, scans = [p.T_pcs_ccs for p in positions], [p.points_scs_m for p in positions]
    return search_targets(Targets.cones(cones, lengths_m), at, scans, nominal, within)


def fit_of(
    T_ccs_scs: Rigid, cones: Sequence[Cone], lengths_m: Sequence[float], T_pcs_ccs: Rigid, position: Position
) -> float:
    """Balance of the beams of one scan with one exterior orientation of the camera; -1 if few meet a cone.

    Parameters
    ----------
    T_ccs_scs : orientation of the scanner.
    cones, lengths_m : in pcs.
    T_pcs_ccs : exterior orientation of the camera.
    position : whose points are taken.
    """
    return balance(Targets.cones(cones, lengths_m), T_pcs_ccs, position.points_scs_m, T_ccs_scs)


# ---------------------------------------------------------------- points on cones, by where their beams
# should go
#
# A point near the outline of a cone is seen only if its beam errs toward the cone, and at a grazing angle a
# sideways error of the beam becomes a large error of range. Both are biases of selection: no mean of such
# points is right. So a beam takes part if its *nominal* direction meets the cone far enough inside the
# outline and the ends, and not too obliquely. What it measured then decides only whether something else was
# in the way. What stood in the way has an outline, too: beams beside it are left out as well, because those
# that err toward it are missing.


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
class SelectionLimits:
    """What a beam must keep to.

    Parameters
    ----------
    max_incidence_deg : greatest nominal angle between beam and normal.
    margin_sigmas : how far inside outline and ends a beam must be, in standard deviations across the beam.
    reject_sigmas : distance from the surface, beyond which a point belongs to something else.
    slack_m : further allowance of that distance, for a cone or an orientation that is only roughly known.
    """

    max_incidence_deg: float = CameraLidarFit().max_incidence_deg
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
    mean excess and variance (n,) of its range, see `thalweg.calibration.cones.beam_spread`.
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
    spheres = Targets.cones(cones, lengths_m)
    for k, (cone, length) in enumerate(zip(cones, lengths_m, strict=True)):
        rows = passing(spheres.centre[k], spheres.radius_m[k], origin, beam)
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


# ---------------------------------------------------------------- why a lidar does not see a cone where the
# reference says


def without_support(counts: Mapping[Verdict, int], *, least_points: int, least_support: float) -> str:
    """Why a cone takes no part at a position before anything is adjusted; empty if it does.

    Parameters
    ----------
    counts : of its beams.
    least_points : beams that must meet it inside its outline.
    least_support : share of the beams through its place that must end on it rather than behind.
    """
    used, through, before = (counts[v] for v in (Verdict.USED, Verdict.BEHIND, Verdict.IN_FRONT))
    aimed = used + through + before
    if sum(counts.values()) == 0:
        return (
            "no beam meets it: it stands outside of what the lidar sees or recorded (whole rotations?), "
            "hidden, or too far off. Set it up beside the boat, in the plane in which the scanner turns, "
            f"then {AGAIN}"
        )
    if before > used + through:
        return (
            f"hidden: {before} of {aimed} beams were reflected before it, by something in front or by the "
            f"cone itself, fallen toward the boat. Clear the view or set it up, then {AGAIN}"
        )
    if aimed < least_points:
        return (
            f"too few points: {aimed} beams meet it inside its outline, at least {least_points} are "
            f"needed. Record longer, or set it up nearer to the boat and amid the lidar's view; then {AGAIN}"
        )
    if used < least_support * (used + through):
        return (
            f"not where the reference says: {through} of {used + through} beams went through its place; it "
            f"fell over or was moved. Set it up, then {AGAIN}"
        )
    return ""


def nowhere(selection: Selection, cones: int, out: Mapping[int, str]) -> bool:
    """Whether none of several cones that the beams of a position should meet is where it should be.

    Parameters
    ----------
    selection : of the position.
    cones : number of cones.
    out : cones that take no part there.
    """
    met = [k for k in range(cones) if sum(selection.counts(k).values())]
    return len(met) > 1 and all(k in out for k in met)


def beside_its_place(
    cones: Sequence[Cone], T_pcs_scs: Rigid, position: Position, selection: Selection
) -> dict[int, str]:
    """Cones whose points lie clearly before or behind them, the worst first, with words for it.

    Parameters
    ----------
    cones : in pcs.
    T_pcs_scs : where the scanner stands.
    position, selection : its points, and which of them were taken.
    """
    points = position.points_scs_m
    found: list[tuple[float, int, str]] = []
    for k, cone in enumerate(cones):
        rows = selection.rows(k)
        if not len(rows):
            continue
        reach = np.linalg.norm(points[rows], axis=1)
        met = cone.meet(T_pcs_scs.shift_m, points[rows] @ T_pcs_scs.R.T / reach[:, None])
        off = reach - met.range_m - selection.excess_m[rows]
        sigmas = float(np.mean(off / np.sqrt(selection.variance_m2[rows])))
        if abs(sigmas) > _BESIDE_SIGMAS:
            where = "before" if sigmas < 0 else "behind"
            words = f"its points lie {1e3 * abs(float(np.mean(off))):.0f} mm {where} it on average"
            told = (
                f"not where the reference says: {words}; it fell over or was moved. Set it up, then {AGAIN}"
            )
            found.append((-abs(sigmas), k, told))
    return {k: words for _, k, words in sorted(found)}
