"""Do a cloud and a reference belong together? What is said if they do not meet.

The commonest mistakes of such comparisons are told by where both lie: another map grid or origin puts them
kilometres apart, heights above a geoid instead of the ellipsoid some tens of metres, and an area of
interest in other coordinates holds nothing.
"""

from pathlib import Path
from typing import Final, NoReturn

import numpy as np
from scipy.ndimage import binary_dilation

from thalweg.core.errors import CoverageError, InputError
from thalweg.core.frames import LocalFrame
from thalweg.core.geometry.mesh import TriangleMesh
from thalweg.core.las.files import laz_header
from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.lidar.cloud import sample_cloud
from thalweg.surface.area import Area
from thalweg.surface.cloud_to_mesh import Surface

LEAST_POINTS: Final = 300
"""Fewer points give no statistics worth a table."""

OTHER_HEIGHTS_M: Final = 10.0
"""A cloud that far above or below its reference is in another height system."""

MAP_COORDINATES_M: Final = 20_000.0
"""A corner of the area that far from the cloud is in map coordinates."""

_MOST_CELLS: Final = 50_000_000


class Reach:
    """Cells of space that may hold points within a distance of a mesh; a fast test before the exact one.

    Parameters
    ----------
    mesh : the reference.
    max_distance_m : every point within this distance of the mesh is found; some others are too.
    """

    def __init__(self, mesh: TriangleMesh, max_distance_m: float) -> None:
        # no place of a triangle is farther from its nearest corner than its longest edge over sqrt(3)
        cell = max_distance_m + _longest_edge_m(mesh) / np.sqrt(3.0)
        low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
        while np.prod((high - low) / cell + 3.0) > _MOST_CELLS:
            cell *= 1.2
        self._cell_m = float(cell)
        self._low = low - cell
        shape = np.floor((high - self._low) / cell).astype(np.int64) + 2
        size = (int(shape[0]), int(shape[1]), int(shape[2]))
        occupied = np.zeros(size, dtype=np.bool_)
        occupied.put(np.ravel_multi_index(tuple(self._place(mesh.vertices_m).T), size), True)
        self._near: ArrayB = np.asarray(binary_dilation(occupied, np.ones((3, 3, 3), dtype=np.bool_)))

    def contains(self, points_m: ArrayF) -> ArrayB:
        """Whether each point (n, 3) lies in one of the cells."""
        place = self._place(points_m)
        inside: ArrayB = np.all((place >= 0) & (place < np.array(self._near.shape)), axis=1)
        inside[inside] = self._near[tuple(place[inside].T)]
        return inside

    def _place(self, points_m: ArrayF) -> ArrayI:
        return np.floor((points_m - self._low) / self._cell_m).astype(np.int64)


def _longest_edge_m(mesh: TriangleMesh) -> float:
    longest = 0.0
    for first in range(0, len(mesh.faces), 1 << 20):
        corners = mesh.vertices_m[mesh.faces[first : first + (1 << 20)]]
        edges = corners - np.roll(corners, 1, axis=1)
        longest = max(longest, float(np.einsum("fij,fij->fi", edges, edges).max(initial=0.0)))
    return float(np.sqrt(longest))


def check_frames(points: Path, mesh: Path, mesh_frame: LocalFrame) -> LocalFrame:
    """The frame of a cloud, if that of the mesh is the same.

    Raises
    ------
    InputError : the cloud is in no local frame, or in another one than the mesh.
    """
    frame = laz_header(points).frame
    if not isinstance(frame, LocalFrame):
        raise InputError(
            "the cloud is not in a local frame",
            expected="a cloud made by Thalweg, not its export to a map grid",
            where=points,
        )
    if frame != mesh_frame:
        apart = float(np.linalg.norm(frame.from_ecef(mesh_frame.origin_ecef_m)))
        raise InputError(
            f"the mesh is in the local frame at {_origin(mesh_frame)}, {_far(apart)} from that of the cloud",
            expected=f"the frame of {points}: {_origin(frame)}",
            where=mesh,
            cure="Make the mesh again with the campaign's own origin: wcs coordinates of two frames differ",
        )
    return frame


def explain_too_few(
    points: Path,
    surface: Surface,
    area: Area,
    *,
    counts: dict[str, int],
    extent_m: ArrayF,
    above_m: ArrayF,
    max_distance_m: float,
) -> NoReturn:
    """Say why a cloud and a mesh cannot be compared.

    Parameters
    ----------
    points : the cloud.
    surface, area : with what it was to be compared, and where.
    counts : what became of its points.
    extent_m : (2, 3) lowest and highest coordinates of the cloud.
    above_m : heights over the reference of points inside the area that have any above or below them.
    max_distance_m : points farther away were not compared.

    Raises
    ------
    InputError : both are in different frames or height systems.
    CoverageError : too few points are inside the area, or near the reference.
    """
    if not counts["points"]:
        raise CoverageError("the cloud holds no points", where=points)
    vertices = surface.mesh.vertices_m
    reference = np.array([vertices.min(axis=0), vertices.max(axis=0)])
    _refuse_apart_in_plan(points, extent_m, reference)
    if counts["points"] == counts["outside_area"]:
        _refuse_area(points, area, extent_m)
    cloud = sample_cloud(points, 500_000)["xyz_m"]
    cloud = cloud[area.contains(cloud)]
    if len(cloud) and not len(above_m):
        held = np.array([cloud.min(axis=0), cloud.max(axis=0)])
        raise CoverageError(
            f"the reference does not cover the area: {_box(held)} are the points inside it, "
            f"{_box(reference)} is the reference",
            expected="an area of interest on the reference",
            where="accuracy.area",
            cure="Move the area, or give a reference that covers it",
        )
    distances = np.abs(surface.distances(cloud).distance_m) if len(cloud) else np.full(1, np.inf)
    offset = float(np.median(above_m)) if len(above_m) else 0.0
    if abs(offset) > OTHER_HEIGHTS_M:
        _refuse_heights(points, offset, len(above_m))
    if abs(offset) > max_distance_m:
        raise CoverageError(
            f"only {counts['compared']:,} of {counts['points']:,} points can be compared: {_apart(offset)} "
            f"(median of {len(above_m):,} points over it), and points farther than {max_distance_m:g} m from "
            f"it have no counterpart; the nearest one is {distances.min():.2f} m away",
            expected="a cloud that lies on its reference",
            where=points,
            cure="Check the heights of both: the antenna's height over the mark, the height of the base "
            "station, the levels of mounts and lever arms, the height system; on a slope also the place in "
            "plan. A larger accuracy.max_distance_m would compare the wrong surfaces",
        )
    if distances.min() > max_distance_m:
        raise CoverageError(
            f"all points are farther than {max_distance_m:g} m from the reference, the nearest "
            f"{distances.min():.2f} m, in the median {np.median(distances):.2f} m",
            expected="a cloud that lies on its reference",
            where=points,
            cure="Check origin, CRS and heights of both, or raise accuracy.max_distance_m",
        )
    what = {
        "outside the area": counts["outside_area"],
        "too far from the reference": counts["far_from_reference"] + counts["beyond_max_distance"],
        "nearest to its border": counts["left_out_at_border"],
    }
    raise CoverageError(
        f"only {counts['compared']:,} of {counts['points']:,} points can be compared: "
        + ", ".join(f"{n:,} {why}" for why, n in what.items()),
        expected=f"at least {LEAST_POINTS}",
        where=points,
        cure="Enlarge accuracy.area or accuracy.max_distance_m, or give a reference that covers more",
    )


def heights_apart(above_m: ArrayF, max_distance_m: float) -> str:
    """What is to be said if most points are too far above or below the reference to be compared.

    Enough others may lie near it by chance, such as crowns on a reference that is too high.

    Parameters
    ----------
    above_m : heights over the reference of points inside the area.
    max_distance_m : points farther away were not compared.
    """
    offset = float(np.median(above_m)) if len(above_m) else 0.0
    if abs(offset) <= max_distance_m:
        return ""
    return (
        f"{_apart(offset)} (median of {len(above_m):,} points over it), more than accuracy.max_distance_m: "
        "most points were not compared, and those that were may lie on other things than the reference. "
        "Check the heights of both; plants that hide the ground are the other reason"
    )


def _refuse_apart_in_plan(points: Path, cloud: ArrayF, reference: ArrayF) -> None:
    apart = _box_distance(cloud[:, :2], reference[:, :2])
    if apart > 0:
        raise InputError(
            f"cloud and reference do not overlap in plan: the cloud lies at {_box(cloud)}, the reference at "
            f"{_box(reference)}, {_far(apart)} apart",
            expected="both in the same frame",
            where=points,
            cure="Another CRS or origin? Compare campaign.crs and campaign.origin with the CRS of the "
            "reference files",
        )


def _refuse_area(points: Path, area: Area, cloud: ArrayF) -> NoReturn:
    polygon = area.polygon_en_m
    apart = 0.0
    if polygon is not None:
        outline = np.array([polygon.min(axis=0), polygon.max(axis=0)])
        apart = _box_distance(outline, cloud[:, :2])
    heights = Area(lowest_m=area.lowest_m, highest_m=area.highest_m, ellipsoid=area.ellipsoid)
    corners = np.array(
        [[cloud[i, 0], cloud[j, 1], cloud[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    )
    span = heights.heights_m(corners)
    if apart > 0:
        why, cure = f"the area is {_far(apart)} away from it", "Check accuracy.area.polygon"
        if apart > MAP_COORDINATES_M and area.ellipsoid is None:
            cure = "These look like map coordinates: set accuracy.area.frame to map"
    elif span.max() < area.lowest_m or span.min() > area.highest_m:
        gap = max(area.lowest_m - span.max(), span.min() - area.highest_m)
        why = f"its heights, {span.min():.1f} to {span.max():.1f} m, miss those of the area by {gap:.1f} m"
        cure = "Check accuracy.area.min_height_m and max_height_m: wcs up in frame local, ellipsoidal in map"
    else:
        why, cure = "the area lies in a gap of it", "Check accuracy.area: no point has been measured there"
    raise CoverageError(
        f"no point of the cloud lies inside the area of interest ({area.describe()}); "
        f"the cloud lies at {_box(cloud)}, and {why}",
        expected="an area that holds points",
        where=points,
        cure=cure,
    )


def _refuse_heights(points: Path, offset_m: float, n: int) -> NoReturn:
    lower, higher = ("reference", "cloud") if offset_m > 0 else ("cloud", "reference")
    raise InputError(
        f"{_apart(offset_m)} (median of {n:,} points over it)",
        expected="ellipsoidal heights in both",
        where=points,
        cure="Geoid? Ellipsoidal height = height above the geoid + undulation; the undulation is 35 to 50 m "
        "in Germany, -107 to 86 m on Earth. Where it is positive, heights above the geoid are the lower "
        f"ones: here those of the {lower}. Where it is negative (India, most of North America), they are the "
        f"higher ones: here those of the {higher}. Add the undulation of the geoid model that was used",
    )


def _apart(offset_m: float) -> str:
    return f"the cloud lies {abs(offset_m):.1f} m {'above' if offset_m > 0 else 'below'} the reference"


def _box_distance(a: ArrayF, b: ArrayF) -> float:
    """Distance between two boxes (2, k), 0 if they overlap."""
    return float(np.linalg.norm(np.maximum(np.maximum(a[0] - b[1], b[0] - a[1]), 0.0)))


def _box(extent: ArrayF) -> str:
    (e0, n0, u0), (e1, n1, u1) = extent
    return f"east {e0:,.1f} to {e1:,.1f} m, north {n0:,.1f} to {n1:,.1f} m, up {u0:,.1f} to {u1:,.1f} m"


def _far(distance_m: float) -> str:
    return f"{distance_m / 1000:,.1f} km" if distance_m >= 2000 else f"{distance_m:,.1f} m"


def _origin(frame: LocalFrame) -> str:
    return f"latitude {frame.lat_deg:.6f}, longitude {frame.lon_deg:.6f}, height {frame.h_ell_m:.3f} m"
