"""Reference cloud -> the points of the ground, one robust point a cell, each loss counted."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, Self

import numba as nb
import numpy as np

from thalweg.core.errors import InputError
from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.lidar.occupancy import MOST_COUNTED, Occupancy
from thalweg.surface.bank_frame import BankFrame
from thalweg.surface.lower_envelope import heights_above_envelope
from thalweg.surface.thinning import spikes, thin

LEAST_POINTS: Final = 3

Method = Literal["delaunay", "poisson"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceSettings:
    """Section ``reference`` of a campaign, as far as it makes the mesh; see there for the meaning."""

    method: Method = "delaunay"
    cell_m: float = 0.05
    longest_edge_m: float = 0.5
    isolated_radius_m: float = 0.25
    isolated_neighbours: int = 4
    clearance_m: float | None = 0.3
    poisson_depth: int | None = None

    @classmethod
    def from_section(cls, section: Mapping[str, Any]) -> Self:
        """From the section as plain values; keys that do not concern the mesh are passed over."""
        return cls(**{name: section[name] for name in cls.__slots__ if name in section})


@dataclass(frozen=True, slots=True, kw_only=True)
class CleanCloud:
    """Points of the ground.

    Parameters
    ----------
    points_m : (n, 3) wcs.
    normals : (n, 3) unit normals in wcs, on the side of `out` of the bank.
    sigma_m : (n,) standard deviation of each point along its normal.
    n_merged : (n,) points that it is the mean of.
    counts : what was given, and what became of it.
    front_m : median height above the lower envelope of the points in front of it; 0 without any.
    """

    points_m: ArrayF
    normals: ArrayF
    sigma_m: ArrayF
    n_merged: ArrayI
    counts: dict[str, int]
    front_m: float = 0.0


def clean_reference(points_m: ArrayF, frame: BankFrame, settings: ReferenceSettings) -> CleanCloud:
    """Leave out what is no ground, and thin the rest to one point a cell.

    In this order: coordinates that are not finite, repeated points, isolated points, points in front of the
    lower envelope (plants, loose objects) and behind it (multipath), in each cell the points that do not
    belong to its surface, and cells that stand alone in front of those about them.

    Parameters
    ----------
    points_m : (n, 3) wcs.
    frame : of the bank; "lower" is against its `out`.
    settings : radius, neighbours, clearance, width of the cells.

    Raises
    ------
    InputError : fewer than three points are given or left; the message says which step took them.
    """
    points, counts = finite_and_single(points_m)
    front_m = 0.0
    if settings.isolated_neighbours:
        points = _step(points, _has_company(points, settings), "isolated", counts)
    if settings.clearance_m is not None and len(points):
        height = heights_above_envelope(frame.to_bank(points), clearance_m=settings.clearance_m)
        front, behind = height > settings.clearance_m, height < -2 * settings.clearance_m
        counts["in_front"], counts["behind"] = int(front.sum()), int(behind.sum())
        front_m = float(np.median(height[front])) if front.any() else 0.0
        points = points[~(front | behind)]
    if len(points) < LEAST_POINTS:
        raise InputError(
            f"cleaning leaves {len(points)} points of the reference: {_told(counts)}",
            expected=f"at least {LEAST_POINTS} points of a surface",
            cure="Look at reference.isolated_radius_m and isolated_neighbours (they must fit the spacing of "
            "the points) and at reference.clearance_m",
        )
    thinned = thin(frame.to_bank(points), settings.cell_m, cubes=settings.method == "poisson")
    counts["off_surface"] = thinned.n_trimmed
    counts["merged"] = int(thinned.n_merged.sum()) - len(thinned.points)
    # cubes stand one above the other on a wall: there a column has more than one point
    single = (
        ~spikes(thinned.points) if settings.method == "delaunay" and settings.clearance_m else slice(None)
    )
    points = thinned.points[single]
    counts["spikes"], counts["kept"] = len(thinned.points) - len(points), len(points)
    return CleanCloud(
        points_m=frame.to_wcs(points),
        normals=thinned.normals[single] @ frame.R_bank_wcs,
        sigma_m=thinned.sigma_m[single],
        n_merged=thinned.n_merged[single],
        counts=counts,
        front_m=front_m,
    )


def finite_and_single(points_m: ArrayF) -> tuple[ArrayF, dict[str, int]]:
    """Points (m, 3) with finite coordinates, each place once, and the counts of the others.

    Raises
    ------
    InputError : the array is no list of points, or fewer than three are left.
    """
    points = np.asarray(points_m, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"reference points of shape {points.shape}", expected="(n, 3)")
    counts = {"given": len(points)}
    points = _step(points, np.asarray(np.isfinite(points).all(axis=1)), "not_finite", counts)
    # Points that two exports share would count as each other's company, and make a mean look better.
    points = _step(points, first_of_equals(points), "duplicates", counts)
    if len(points) < LEAST_POINTS:
        raise InputError(
            f"a reference of {len(points)} usable points: {_told(counts)}",
            expected=f"at least {LEAST_POINTS} points of a surface",
            cure="Look at the reference file, at its CRS, and at accuracy.area",
        )
    return points, counts


def first_of_equals(points_m: ArrayF) -> ArrayB:
    """True (n,) for the first of points with the same coordinates, to the last bit."""
    code = _stirred(np.ascontiguousarray(points_m + 0.0).view(np.uint64))  # + 0.0: -0.0 is 0.0
    order = np.argsort(code, kind="stable")
    same = np.diff(code[order]) == 0
    same[same] = (points_m[order[1:][same]] == points_m[order[:-1][same]]).all(axis=1)
    first = np.ones(len(points_m), dtype=np.bool_)
    first[order[1:][same]] = False
    return first


@nb.njit(cache=True, nogil=True)
def _stirred(bits: Any) -> Any:
    """One number (n,) for three each, by the finaliser of MurmurHash3 (Appleby)."""
    out = np.empty(len(bits), dtype=np.int64)
    for i in range(len(bits)):
        h = np.uint64(0)
        for axis in range(3):
            h = h * np.uint64(0x9E3779B97F4A7C15) + bits[i, axis]
            h ^= h >> np.uint64(33)
            h *= np.uint64(0xFF51AFD7ED558CCD)
            h ^= h >> np.uint64(33)
            h *= np.uint64(0xC4CEB9FE1A85EC53)
            h ^= h >> np.uint64(33)
        out[i] = np.int64(h)
    return out


def _has_company(points: ArrayF, settings: ReferenceSettings) -> ArrayB:
    # the grid counts from the origin of wcs: a middle near the cloud keeps its block numbers small
    local = points - np.round(points.mean(axis=0))
    grid = Occupancy(settings.isolated_radius_m)
    grid.add(local)
    grid.freeze()
    enough = min(settings.isolated_neighbours, MOST_COUNTED - 1)
    return np.asarray(grid.neighbours(local, enough=enough) >= enough)


def _step(points: ArrayF, keep: ArrayB, name: str, counts: dict[str, int]) -> ArrayF:
    counts[name] = int(len(keep) - np.count_nonzero(keep))
    return points if keep.all() else points[keep]


def _told(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{n:,} {name.replace('_', ' ')}" for name, n in counts.items())
