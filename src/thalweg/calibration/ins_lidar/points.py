"""The points of a lidar log that may lie on the cones of a field; and if there are none, why.

A log is read in blocks. Of each block the points near the cones are kept, and some of all others: if none
comes near, these say where the lidar's points are and where the cones should be. A field whose heights are of
another system lies tens of metres above or below the scan; one with a wrong datum or zone lies beside it.
"""

from dataclasses import dataclass, field
from typing import Final, Self

import numpy as np

from thalweg.calibration.ins_lidar.run_points import FieldCones, RunPoints, no_pose
from thalweg.core.errors import CoverageError
from thalweg.core.rigid import Rigid
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayB, ArrayF

SAMPLED: Final = 500
"""Points of each block that are kept to say where the lidar's points are."""

_AROUND_M: Final = 10.0
"""Heights of points as near to a cone in plan are compared with it."""

_WIND: Final = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
_POLE_M: Final = 5.0
"""A pole that was not taken off explains no greater difference of heights."""

_DATUM_M: Final = 1000.0
"""Datums of one country differ by less; farther away the place itself is another one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Way:
    """From a lidar's points to the cones of a field: the nearest pair, and how the whole field lies.

    ``nearest_m`` in space, ``nearest_plan_m`` in plan; ``plan_m`` (2,) east and north from the middle of the
    points to that of the cones; ``height_m`` of the cones above the points around them, or above all points
    if none is around.
    """

    nearest_m: float
    nearest_plan_m: float
    plan_m: ArrayF
    height_m: float

    @classmethod
    def between(cls, points_wcs_m: ArrayF, centres_wcs_m: ArrayF) -> Self:
        """The way from points (n, 3) to the centres (c, 3) of cones."""
        apart = centres_wcs_m[None] - points_wcs_m[:, None]
        plan = np.linalg.norm(apart[..., :2], axis=2)
        around = plan < _AROUND_M
        heights = apart[..., 2][around if around.any() else np.ones_like(around)]
        return cls(
            nearest_m=float(np.linalg.norm(apart, axis=2).min()),
            nearest_plan_m=float(plan.min()),
            plan_m=np.asarray(centres_wcs_m[:, :2].mean(axis=0) - np.median(points_wcs_m[:, :2], axis=0)),
            height_m=float(np.median(heights)),
        )

    @property
    def words(self) -> str:
        """The way as a part of a sentence about the cones."""
        wind = _WIND[round(np.degrees(np.arctan2(*self.plan_m)) / 45.0) % 8]
        return (
            f"{np.linalg.norm(self.plan_m):,.1f} m {wind} of the middle of the points, "
            f"{abs(self.height_m):,.1f} m {'above' if self.height_m > 0 else 'below'} them; the nearest "
            f"point is {self.nearest_m:,.1f} m away, in plan {self.nearest_plan_m:,.1f} m"
        )

    def cure(self, reach_m: float) -> str:
        """What to look at: heights, datum, or place."""
        if self.nearest_plan_m <= reach_m:
            if abs(self.height_m) <= _POLE_M:
                return (
                    "In plan the field is where the lidar was: check that the height of the pole was taken "
                    "off the heights of the targets, and the lever arm of the boat's antenna"
                )
            return (
                "In plan the field is where the lidar was, its height is not: heights of targets and "
                "positions are of two systems. Both must be ellipsoidal (h_ell_m); heights above sea level "
                "differ from these by the geoid, 36 to 50 m in Germany. Check the base's height as well"
            )
        if np.linalg.norm(self.plan_m) <= _DATUM_M:
            return (
                "Check the datum of the targets and of the base's coordinates: national datums are some "
                "100 m apart from ITRS; and that the run was recorded at this field"
            )
        return (
            "Check lat_deg and lon_deg of the targets: exchanged, of another EPSG code or zone before they "
            "were converted, or of another field; and the coordinates of the base"
        )


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
            way = Way.between(sample, self.cones.spheres(self.T_wcs_pcs)[0])
            raise CoverageError(
                f"the lidar and the trajectory overlap in time, but none of {self.n:,} lidar points comes "
                f"within {self.reach_m:.1f} m of a cone: the cones {', '.join(self.cones.names)} are "
                + way.words,
                expected="a run past the cones of the field, in the world frame of its targets",
                cure=way.cure(self.reach_m + float(self.cones.spheres(self.T_wcs_pcs)[1].max())),
            )
        return RunPoints.on(self.trajectory, rows[:, :3], rows[:, 3])
