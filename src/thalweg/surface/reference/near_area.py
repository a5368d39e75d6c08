"""The part of a reference cloud that is meshed: the area of interest and a margin about it.

Were the mesh to end where the area ends, the nearest place of points at its rim would be the mesh's border,
and their distances would say where the reference was cut.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numba as nb
import numpy as np

from thalweg.core.errors import CoverageError, InputError
from thalweg.core.frames import LocalFrame
from thalweg.core.las.files import iter_laz, laz_header
from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.surface.area import Area
from thalweg.surface.reference.cloud import LEAST_POINTS, ReferenceSettings

# Open3D brings an old TBB into the process, which numba would try first and complain about.
nb.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]

_LEAST_MARGIN_M: Final = 2.0
_EDGES_OF_MARGIN: Final = 4.0
GEOID_M: Final = 10.0
"""A larger difference of heights is one of height systems, not of the terrain."""
_ANOTHER_GRID_M: Final = 2000.0

_GEOID: Final = (
    "As large as a difference between ellipsoid and geoid: bring the reference, accuracy.area and "
    "campaign.origin.h_ell_m to heights above the ellipsoid"
)
_HEIGHTS: Final = "Compare min_height_m and max_height_m of accuracy.area with the heights of the reference"
_GRID: Final = (
    "Another CRS or zone than that of the campaign? ingest/reference.integrity.json tells which one was "
    "stated or assumed"
)
_PLACES: Final = (
    "Compare the corners of accuracy.area with the reference: are both in the same coordinates "
    "(accuracy.area.frame), in the order east, north, and in the CRS of the campaign?"
)


def area_margin_m(settings: ReferenceSettings) -> float:
    """How far around the area of interest the reference is meshed, so that the mesh's border lies outside."""
    return max(_LEAST_MARGIN_M, _EDGES_OF_MARGIN * settings.longest_edge_m)


def near_area(points_m: ArrayF, area: Area, margin_m: float) -> ArrayB:
    """Points (n,) inside an area or no farther than ``margin_m`` from it, in plan and in height."""
    lowest, highest = area.lowest_m - margin_m, area.highest_m + margin_m
    inside = replace(area, lowest_m=lowest, highest_m=highest).contains(points_m)
    if area.polygon_en_m is None:
        return inside
    low, high = area.polygon_en_m.min(axis=0) - margin_m, area.polygon_en_m.max(axis=0) + margin_m
    at_height = replace(area, polygon_en_m=None, lowest_m=lowest, highest_m=highest).contains(points_m)
    plan = points_m[:, :2]
    about = np.flatnonzero(~inside & at_height & ((plan >= low) & (plan <= high)).all(axis=1))
    corners = np.ascontiguousarray(area.polygon_en_m, dtype=np.float64)
    inside[about] = _near_outline(np.ascontiguousarray(plan[about]), corners, margin_m)
    return inside


@nb.njit(parallel=True, cache=True, error_model="numpy")
def _near_outline(plan: ArrayF, corners: ArrayF, reach: float) -> ArrayB:
    out = np.zeros(len(plan), dtype=np.bool_)
    k = len(corners)
    for i in nb.prange(len(plan)):
        for j in range(k):
            ax, ay = corners[j, 0], corners[j, 1]
            bx, by = corners[(j + 1) % k, 0] - ax, corners[(j + 1) % k, 1] - ay
            px, py = plan[i, 0] - ax, plan[i, 1] - ay
            length = bx * bx + by * by
            u = min(1.0, max(0.0, (px * bx + py * by) / length)) if length > 0.0 else 0.0
            if (px - u * bx) ** 2 + (py - u * by) ** 2 <= reach * reach:
                out[i] = True
                break
    return out


@dataclass(slots=True, kw_only=True)
class ReferencePoints:
    """What was read of a reference cloud.

    Parameters
    ----------
    points_m : (n, 3) wcs, in the area and its margin.
    source : (n,) number of the file that each point comes from, from 1.
    counts : points read, and outside the area.
    files : of each file its name, its points, and how many of them lie in the area and its margin.
    notes : sentences for people.
    """

    points_m: ArrayF
    source: ArrayI
    counts: dict[str, int]
    files: dict[int, dict[str, Any]]
    notes: list[str]


@dataclass(slots=True)
class _Seen:
    """Where the points of one file lie."""

    n: int = 0
    kept: int = 0
    low: ArrayF = field(default_factory=lambda: np.full(3, np.inf))
    high: ArrayF = field(default_factory=lambda: np.full(3, -np.inf))
    in_plan: int = 0
    sum_of_heights_m: float = 0.0

    def add(self, points: ArrayF, keep: ArrayB, area: Area) -> None:
        """Count some points (n, 3) of the file, of which those of ``keep`` are near the area."""
        self.n, self.kept = self.n + len(points), self.kept + int(np.count_nonzero(keep))
        self.low = np.minimum(self.low, points.min(axis=0))
        self.high = np.maximum(self.high, points.max(axis=0))
        plan = replace(area, lowest_m=-np.inf, highest_m=np.inf).contains(points)
        self.in_plan += int(np.count_nonzero(plan))
        self.sum_of_heights_m += float(area.heights_m(points[plan]).sum())

    def above_m(self, area: Area) -> float:
        """How far the mean height in plan is above the heights of the area; NaN if they do not meet in plan.

        From the middle of its limits, or from the one limit that there is.
        """
        limits = [z for z in (area.lowest_m, area.highest_m) if np.isfinite(z)]
        if not self.in_plan or not limits:
            return float("nan")
        return self.sum_of_heights_m / self.in_plan - sum(limits) / len(limits)

    def away_m(self, area: Area) -> float:
        """Distance in plan between the boxes about the points and about the area."""
        if area.polygon_en_m is None:
            return 0.0
        low, high = area.polygon_en_m.min(axis=0), area.polygon_en_m.max(axis=0)
        return float(np.linalg.norm(np.maximum(0.0, np.maximum(low - self.high[:2], self.low[:2] - high))))

    def offset(self, area: Area) -> tuple[str, str]:
        """Where the points lie against the area, and what may be the cause."""
        above = self.above_m(area)
        if np.isfinite(above):
            side = "above" if above > 0 else "below"
            both = np.isfinite(area.lowest_m) and np.isfinite(area.highest_m)
            of = "the middle of its heights" if both else "its limit"
            words = f"in plan they meet it, but on average {abs(above):.1f} m {side} {of}"
            return words, _GEOID if abs(above) > GEOID_M else _HEIGHTS
        away = self.away_m(area)
        return f"in plan they end {away:,.0f} m from it", _GRID if away > _ANOTHER_GRID_M else _PLACES


def read_reference(
    path: Path, frame: LocalFrame, area: Area, *, margin_m: float, files: Sequence[str] = ()
) -> ReferencePoints:
    """The part of a reference cloud that lies in an area and its margin, and where the rest is.

    Parameters
    ----------
    path : LAZ in the world frame; ``point_source_id`` counts the files that it was gathered from.
    frame : the world frame of the campaign.
    area : of interest.
    margin_m : how far around it points are taken.
    files : names of the files that the cloud was gathered from, for messages.

    Raises
    ------
    InputError : the cloud is empty, or not in the world frame of the campaign.
    CoverageError : fewer than three points lie inside, or all points of one file lie in the area in plan but
        more than 10 m above or below; the message says where they and the area are.
    """
    theirs = laz_header(path).frame
    if theirs != frame:
        raise InputError(
            f"the reference is in the frame {theirs}",
            expected=f"the campaign's world frame, {frame}",
            where=path,
            cure="Run the rule read_reference again",
        )
    parts, sources = [], []
    total, seen = _Seen(), {}  # type: _Seen, dict[int, _Seen]
    for chunk in iter_laz(path):
        points, source = chunk["xyz_m"], np.asarray(chunk["point_source_id"], dtype=np.int64)
        keep = near_area(points, area, margin_m)
        for number in np.flatnonzero(np.bincount(source)).tolist():
            mine = source == number
            seen.setdefault(number, _Seen()).add(points[mine], keep[mine], area)
        total.add(points, keep, area)
        parts.append(points[keep])
        sources.append(source[keep])
    if not total.n:
        raise InputError("the reference cloud has no points", expected="a terrestrial scan", where=path)
    named = {k: files[k - 1] if 0 < k <= len(files) else f"file {k} of {path.name}" for k in sorted(seen)}
    if total.kept < LEAST_POINTS:
        raise _none_near(total, area, margin_m, next(iter(named.values())) if len(seen) == 1 else str(path))
    notes = []
    for number, name in named.items():
        if seen[number].kept:
            continue
        if abs(seen[number].above_m(area)) > GEOID_M:
            raise _none_near(seen[number], area, margin_m, name)
        words, cause = seen[number].offset(area)
        notes.append(
            f"{name}: none of {seen[number].n:,} points lies in the area of interest: {words}. {cause}."
        )
    return ReferencePoints(
        points_m=np.concatenate(parts),
        source=np.concatenate(sources),
        counts={"read": total.n, "outside_area": total.n - total.kept},
        files={
            k: {"file": name, "points": seen[k].n, "near_area": seen[k].kept} for k, name in named.items()
        },
        notes=notes,
    )


def _none_near(seen: _Seen, area: Area, margin_m: float, where: str) -> CoverageError:
    axes = zip(("east", "north", "height"), seen.low, seen.high, strict=True)
    words, cause = seen.offset(area)
    many = f"only {seen.kept} of {seen.n:,} reference points lie" if seen.kept else (
        f"none of {seen.n:,} reference points lies"
    )  # fmt: skip
    return CoverageError(
        f"{many} in the area of interest: they reach from "
        + ", ".join(f"{name} {a:.1f} to {b:.1f} m" for name, a, b in axes)
        + ("" if seen.kept else f"; {words}"),
        expected=f"points in {area.describe()}, or no more than {margin_m:g} m from it",
        where=where,
        cure=_PLACES if seen.kept else cause,
    )
