"""The part of a reference cloud that is meshed: the area of interest and a margin about it.

Were the mesh to end where the area ends, the nearest place of points at its rim would be the mesh's border,
and their distances would say where the reference was cut.
"""

from dataclasses import replace
from pathlib import Path
from typing import Final

import numba as nb
import numpy as np

from thalweg.core.errors import CoverageError, InputError
from thalweg.core.frames import LocalFrame
from thalweg.core.las import iter_laz, laz_header
from thalweg.core.types import ArrayB, ArrayF
from thalweg.surface.area import Area
from thalweg.surface.reference_cloud import ReferenceSettings

# Open3D brings an old TBB into the process, which numba would try first and complain about.
nb.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]

_LEAST_MARGIN_M: Final = 2.0
_EDGES_OF_MARGIN: Final = 4.0
_HEIGHTS: Final = (
    "In plan they meet: compare min_height_m and max_height_m of accuracy.area with the heights of the "
    "reference. A difference of tens of metres is that between ellipsoid and geoid"
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


def read_reference(
    path: Path, frame: LocalFrame, area: Area, *, margin_m: float
) -> tuple[ArrayF, dict[str, int]]:
    """Points (n, 3) of a reference cloud in an area and its margin, and counts of what was read and left out.

    Parameters
    ----------
    path : LAZ in the world frame.
    frame : the world frame of the campaign.
    area : of interest.
    margin_m : how far around it points are taken.

    Raises
    ------
    InputError : the cloud is empty, or not in the world frame of the campaign.
    CoverageError : all points lie outside; the message says where they and the area are.
    """
    theirs = laz_header(path).frame
    if theirs != frame:
        raise InputError(
            f"the reference is in the frame {theirs}",
            expected=f"the campaign's world frame, {frame}",
            where=path,
            cure="Run the rule read_reference again",
        )
    parts, n = [], 0
    low, high, meets = np.full(3, np.inf), np.full(3, -np.inf), False
    plan = replace(area, lowest_m=-np.inf, highest_m=np.inf)
    for chunk in iter_laz(path):
        points = chunk["xyz_m"]
        keep = near_area(points, area, margin_m)
        if not keep.any():
            meets = meets or bool(plan.contains(points).any())
        n += len(points)
        low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
        parts.append(points[keep])
    kept = np.concatenate([np.zeros((0, 3)), *parts])
    if not n:
        raise InputError("the reference cloud has no points", expected="a terrestrial scan", where=path)
    if not len(kept):
        axes = zip(("east", "north", "height"), low, high, strict=True)
        raise CoverageError(
            f"none of {n:,} reference points lies in the area of interest: they reach from "
            + ", ".join(f"{name} {a:.1f} to {b:.1f} m" for name, a, b in axes),
            expected=f"points in {area.describe()}, or no more than {margin_m:g} m from it",
            where=path,
            cure=_HEIGHTS if meets else _PLACES,
        )
    return kept, {"read": n, "outside_area": n - len(kept)}
