"""A cloud against a reference mesh: the signed distance of each point, and what its sigmas predict for it.

A distance from a surface sees the part of a point's error along the surface's normal. Its prediction is
therefore ``n^T C n`` with the point's own covariance, plus the variance of the reference. The 3D total of
P2 eq. 9, ``sqrt(trace C)``, stands beside it: it is larger, by the square root of three where errors are
the same in all directions, and no comparison of a cloud with a surface can show that much. Distances are
positive in front of the reference, toward the boat, and negative behind it.

**Outliers** are judged by the distance over its sigma, not by the distance: sigmas grow with the range by a
factor of five, and one limit in metres would keep bushes near the boat and cut consistent points far away.

Memory is bounded by the number of points that are compared, not by that of the cloud.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NoReturn, Self

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy.ndimage import binary_dilation

from thalweg.accuracy.statistics import outlier_limits
from thalweg.core import (
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayI,
    CoverageError,
    InputError,
    LocalFrame,
    column,
    frame_of,
    iter_laz,
    laz_header,
    table_kind,
)
from thalweg.core.geometry import CellGrid, TriangleMesh
from thalweg.lidar import CORRELATIONS, SIGMAS, cloud_covariance, sample_cloud
from thalweg.settings.sections import Accuracy, NonNegative, Positive, ReferenceSettings
from thalweg.surface import Area, Distances, Surface

CHUNK: Final = 1 << 18
"""Points whose covariances are unpacked at once."""
EVERY_HEIGHT: Final = 7
"""Of the points inside the area every so many-th is held against the heights of the reference; a number that
shares no factor with the number of beams of a scanner."""
SIGMA_FLOOR_M: Final = 1e-4
"""Standard deviations are kept to this; smaller ones do not count in a distance over its sigma."""
PLAN_95: Final = float(np.sqrt(-2 * np.log(0.05)))
HEIGHT_95: Final = 1.959964
"""95 % of errors lie within so many standard deviations: of two equal axes, and of one."""
_NEEDED: Final = ("xyz_m", "t_gps_s", "range", *SIGMAS, *CORRELATIONS)
_KEPT_AS: Final = {"xyz_m": np.float64, "t_gps_s": np.float64}
CLOUD_TO_MESH: Final = table_kind(
    "cloud_to_mesh",
    1,
    [
        column("t_gps_s", "s", "adjusted standard GPS time of the point"),
        column("east_m", "m", "point in wcs, east"),
        column("north_m", "m", "point in wcs, north"),
        column("up_m", "m", "point in wcs, up"),
        column("range_m", "m", "measured range", pa.float32()),
        column("distance_m", "m", "signed distance, positive in front of the reference"),
        column("normal_east", "1", "unit normal of the reference at the nearest place, east", pa.float32()),
        column("normal_north", "1", "unit normal of the reference at the nearest place, north", pa.float32()),
        column("normal_up", "1", "unit normal of the reference at the nearest place, up", pa.float32()),
        column("sigma_normal_m", "m", "predicted, along that normal: sqrt(n^T C n)", pa.float32()),
        column("sigma_reference_m", "m", "of the reference: its noise and its registration", pa.float32()),
        column("sigma_3d_m", "m", "predicted, all directions: sqrt(trace C), P2 eq. 9", pa.float32()),
        column("at_border", "1", "the nearest place lies on the border of the mesh", pa.bool_()),
        column("used", "1", "compared: near enough, and not left out for the border", pa.bool_()),
        column("outlier", "1", "used, and its distance over its sigma outside the outlier rule", pa.bool_()),
    ],
)
PLAN_CELL_M: Final = 1.0
"""Heights are compared in cells of this width."""
SEEN_CELL_M: Final = 0.5
"""A reference without a compared point in a cell of this width is not seen."""
LEAST_PLAN_M2: Final = 1.0

LEAST_POINTS: Final = 300
"""Fewer points give no statistics worth a table."""
OTHER_HEIGHTS_M: Final = 10.0
"""A cloud that far above or below its reference is in another height system."""
MAP_COORDINATES_M: Final = 20_000.0
"""A corner of the area that far from the cloud is in map coordinates."""
_MOST_CELLS: Final = 50_000_000


# ---------------------------------------------------------------- comparison


class ComparisonSettings(Accuracy):
    """How a cloud is compared with a mesh: section ``accuracy``, and what stands elsewhere.

    Parameters
    ----------
    correlation_s : correlation time of the slowest error of the trajectory.
    reference_sigma_m : standard deviation of the reference as a whole, along its normal.
    seed : of the random sample and of permutations.
    """

    correlation_s: Positive = 20.0
    reference_sigma_m: NonNegative = ReferenceSettings().sigma_m
    seed: int = 0

    @classmethod
    def of(
        cls,
        accuracy: Accuracy,
        reference: ReferenceSettings,
        seed: int = 0,
        *,
        estimated_correlation_s: float = 20.0,
    ) -> Self:
        """From both sections; ``estimated_correlation_s`` stands in where ``correlation_s`` is ``auto``."""
        values = dict(accuracy) | {"reference_sigma_m": reference.sigma_m, "seed": seed}
        if accuracy.correlation_s == "auto":
            values["correlation_s"] = estimated_correlation_s
        return cls(**values)


def compare_with_mesh(
    points: Path,
    mesh: TriangleMesh,
    *,
    area: Area,
    settings: ComparisonSettings,
    surface: Surface | None = None,
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Distances of a cloud's points from a reference mesh, with their predicted standard deviations.

    Parameters
    ----------
    points : LAZ in wcs with ``range``, standard deviations and correlations of each point.
    mesh : the reference in wcs, its front toward the river.
    area : which part of the cloud is compared.
    settings : see `ComparisonSettings`.
    surface : the mesh prepared for distances, if it is at hand.

    Returns
    -------
    table : kind `CLOUD_TO_MESH`, in the order of the cloud. If there are more points than
        ``settings.max_points``, a random sample of that many, the same in each run: every k-th point would
        take the same beams of the scanner again and again.
    facts : ``counts`` of what became of every point of the cloud, which add up; the settings;
        ``outlier_limits_sigmas``, limits of a distance over its sigma, or None; ``survey_gps_s``, first and
        last time of the compared points; ``height_above_reference_m``, median of the points inside the area
        that have the reference above or below them, or None; ``warning``, if that is more than
        ``max_distance_m``, otherwise empty; ``predicted_95`` of single points in plan and
        height; ``coverage``, see there.

    Raises
    ------
    InputError : the cloud has no covariances or no times, or lies in another frame or height system.
    CoverageError : too few points are left to compare.
    """
    surface = Surface(mesh) if surface is None else surface
    cloud, counts, extent, above = _candidates(points, mesh, area, settings)
    table = _distances(cloud, surface, settings, points)
    counts |= _counts_of(table, settings)
    used = table["used"].to_numpy()
    gap = float(np.median(table["distance_m"].to_numpy()[used])) if used.any() else 0.0
    if counts["compared"] < LEAST_POINTS or abs(gap) > OTHER_HEIGHTS_M:
        explain_too_few(
            points,
            surface,
            area,
            counts=counts,
            extent_m=extent,
            above_m=above,
            max_distance_m=settings.max_distance_m,
        )
    low, high = outlier_limits(normalised_distances(table)[used], settings.outlier_nmads)
    facts = {
        "area": area.describe(),
        "counts": counts,
        "outlier_limits_sigmas": [low, high] if np.isfinite(low) else None,
        "survey_gps_s": [float(t) for t in (table["t_gps_s"][used].min(), table["t_gps_s"][used].max())],
        "height_above_reference_m": float(np.median(above)) if len(above) else None,
        "warning": heights_apart(above, settings.max_distance_m),
        "predicted_95": _predicted_95({name: cloud[name][used] for name in SIGMAS}),
        "coverage": coverage(_nearest_places(table[used]), mesh, area),
        **settings.model_dump(exclude={"area", "registration", "sections"}),
    }
    return table, facts


def predicted_sigma_m(table: pd.DataFrame) -> ArrayF:
    """What is predicted for each distance (n,): of the point along the normal, and of the reference."""
    return _sigma_m(table["sigma_normal_m"].to_numpy(), table["sigma_reference_m"].to_numpy())


def normalised_distances(table: pd.DataFrame) -> ArrayF:
    """Distances (n,) over the predicted sigma of each."""
    return np.asarray(table["distance_m"].to_numpy() / predicted_sigma_m(table))


def _sigma_m(sigma_normal_m: AnyArray, sigma_reference_m: AnyArray) -> ArrayF:
    sigma = np.hypot(sigma_normal_m.astype(np.float64), sigma_reference_m.astype(np.float64))
    return np.asarray(np.maximum(sigma, SIGMA_FLOOR_M))


def after_motion(
    table: pd.DataFrame, points_m: ArrayF, surface: Surface, settings: ComparisonSettings
) -> pd.DataFrame:
    """The table of the same points elsewhere: distances, normals and what follows from them anew.

    Parameters
    ----------
    table : kind `CLOUD_TO_MESH`.
    points_m : (n, 3) where the points are now. Predicted standard deviations stay as they are: the motion is
        small, and with it the change of the normals.
    surface, settings : as for `compare_with_mesh`.
    """
    found = surface.distances(points_m)
    columns: dict[str, AnyArray] = {name: table[name].to_numpy() for name in table.columns}
    columns |= _places(points_m, found, columns["sigma_normal_m"], settings)
    return frame_of(CLOUD_TO_MESH, columns)


def _places(
    points_m: ArrayF, found: Distances, sigma_normal_m: AnyArray, settings: ComparisonSettings
) -> dict[str, AnyArray]:
    """Columns that follow from where points lie."""
    near = np.abs(found.distance_m) <= settings.max_distance_m
    used = near & found.normal.any(axis=1)
    if settings.border == "exclude":
        used &= ~found.at_border
    # as the table keeps them, so that its readers find the same points
    sigma_reference_m = np.hypot(found.sigma_m, settings.reference_sigma_m).astype(np.float32)
    z = found.distance_m / _sigma_m(sigma_normal_m, sigma_reference_m)
    low, high = outlier_limits(z[used], settings.outlier_nmads)
    return {
        "east_m": points_m[:, 0],
        "north_m": points_m[:, 1],
        "up_m": points_m[:, 2],
        "distance_m": found.distance_m,
        "normal_east": found.normal[:, 0],
        "normal_north": found.normal[:, 1],
        "normal_up": found.normal[:, 2],
        "sigma_reference_m": sigma_reference_m,
        "at_border": found.at_border,
        "used": used,
        "outlier": used & ~((z >= low) & (z <= high)),
    }


def _nearest_places(table: pd.DataFrame) -> ArrayF:
    """Places (n, 3) on the reference that the points are compared with; near an edge to a few millimetres."""
    normal = table[["normal_east", "normal_north", "normal_up"]].to_numpy().astype(np.float64)
    points = table[["east_m", "north_m", "up_m"]].to_numpy()
    return np.asarray(points - table["distance_m"].to_numpy()[:, None] * normal)


def _counts_of(table: pd.DataFrame, settings: ComparisonSettings) -> dict[str, int]:
    """What became of the points of a table; a point that is too far is not counted for the border too."""
    far = np.abs(table["distance_m"].to_numpy()) > settings.max_distance_m
    border = table["at_border"].to_numpy() & ~far
    used = table["used"].to_numpy()
    excluded = border & (settings.border == "exclude")
    return {
        "beyond_max_distance": int(far.sum()),
        "left_out_at_border": int(excluded.sum()),
        "without_normal": int((~far & ~excluded & ~used).sum()),
        "compared": int(used.sum()),
        "compared_at_border": int((border & used).sum()),
        "outliers": int(table["outlier"].sum()),
    }


def _distances(
    cloud: dict[str, AnyArray], surface: Surface, settings: ComparisonSettings, where: Path
) -> pd.DataFrame:
    points = cloud["xyz_m"]
    found = surface.distances(points)
    sigma_normal = np.empty(len(points), dtype=np.float32)
    for first in range(0, len(points), CHUNK):
        part = slice(first, first + CHUNK)
        cov = cloud_covariance({name: values[part] for name, values in cloud.items()}, where)
        normal = found.normal[part]
        variance = np.einsum("ni,nij,nj->n", normal, cov, normal)
        # correlations are stored to four digits: a direction without error may come out as -1e-9 m2
        sigma_normal[part] = np.sqrt(np.maximum(variance, 0.0))
    columns = _places(points, found, sigma_normal, settings) | {
        "t_gps_s": cloud["t_gps_s"],
        "range_m": cloud["range"],
        "sigma_normal_m": sigma_normal,
        "sigma_3d_m": np.sqrt(sum(cloud[name].astype(np.float64) ** 2 for name in SIGMAS)),
    }
    return frame_of(CLOUD_TO_MESH, columns)


def _candidates(
    points: Path, mesh: TriangleMesh, area: Area, settings: ComparisonSettings
) -> tuple[dict[str, AnyArray], dict[str, int], ArrayF, ArrayF]:
    """A sample of the points inside the area and not far from the mesh, and what all points are like.

    Returns
    -------
    The sample, counts, the extent (2, 3) of the whole cloud, and heights over the reference of some of the
    points inside the area.
    """
    reach = Reach(mesh, settings.max_distance_m)
    sample, heights = _Sample(settings.max_points, settings.seed), HeightMap(mesh)
    above = [np.zeros(0)]
    n = outside = far = 0
    extent = np.array([np.full(3, np.inf), np.full(3, -np.inf)])
    for chunk in iter_laz(points):
        _check_columns(chunk, points)
        xyz = chunk["xyz_m"]
        extent = np.array([np.minimum(extent[0], xyz.min(axis=0)), np.maximum(extent[1], xyz.max(axis=0))])
        inside = area.contains(xyz)
        above.append(heights.above(xyz[inside][::EVERY_HEIGHT]))
        take = inside.copy()
        take[inside] = reach.contains(xyz[inside])
        n += len(xyz)
        outside += int((~inside).sum())
        far += int((inside & ~take).sum())
        sample.add({name: chunk[name][take] for name in _NEEDED})
    kept = sample.columns()
    counts = {
        "points": n,
        "outside_area": outside,
        "far_from_reference": far,
        "not_in_sample": n - outside - far - len(kept["xyz_m"]),
    }
    return kept, counts, extent, np.concatenate(above)


def _predicted_95(sigmas: Mapping[str, AnyArray]) -> dict[str, float]:
    """What 95 % of the errors of a point stay below, in plan and in height: of the middle point, and of 95 %.

    In plan the radius of a circle, both axes taken as equal: 2.45 times the root of their mean variance. For
    errors along one axis alone it would be 13 % more.
    """
    east, north, up = (sigmas[name].astype(np.float64) for name in SIGMAS)
    out: dict[str, float] = {}
    for what, each in (("plan", PLAN_95 * np.sqrt((east**2 + north**2) / 2)), ("height", HEIGHT_95 * up)):
        if len(each):
            out |= {
                f"{what}_median_m": float(np.median(each)),
                f"{what}_p95_m": float(np.percentile(each, 95)),
            }
    return out


def _check_columns(chunk: dict[str, AnyArray], where: Path) -> None:
    cloud_covariance({name: values[:1] for name, values in chunk.items()}, where)
    if "range" not in chunk or not np.isfinite(chunk["t_gps_s"]).all():
        raise InputError(
            "the points have no measured range, or no GPS time",
            expected="a cloud georeferenced by Thalweg: range, time and covariance of each point",
            where=where,
            cure="Georeference the lidar log with this campaign",
        )
    if not all((chunk[name] > 0).all() for name in SIGMAS):
        raise InputError(
            "points with a standard deviation of zero",
            expected="what each point's sigma is",
            where=where,
            cure="Check the sigmas of the campaign file: lidar_accuracy, mounts, ins",
        )


class _Sample:
    """A random sample of rows that come in chunks, of bounded size, in the order in which they came."""

    def __init__(self, most: int, seed: int) -> None:
        self._most = most
        self._rng = np.random.default_rng([seed, *b"cloud_to_mesh"])
        self._limit = np.inf
        self._parts: list[dict[str, AnyArray]] = []
        self._size = 0

    def add(self, columns: dict[str, AnyArray]) -> None:
        """Give each row a random number; only the smallest ones stay."""
        draw = self._rng.random(len(columns["xyz_m"]))
        keep = draw < self._limit
        part = {n: v[keep].astype(_KEPT_AS.get(n, np.float32)) for n, v in columns.items()}
        self._parts.append(part | {"draw": draw[keep]})
        self._size += int(keep.sum())
        if self._size > 2 * self._most:
            self._thin()

    def columns(self) -> dict[str, AnyArray]:
        """The rows of the sample."""
        if self._size > self._most:
            self._thin()
        return {name: values for name, values in self._joined().items() if name != "draw"}

    def _joined(self) -> dict[str, AnyArray]:
        if not self._parts:
            empty = {
                n: np.zeros((0, 3) if n == "xyz_m" else 0, dtype=_KEPT_AS.get(n, np.float32)) for n in _NEEDED
            }
            return empty | {"draw": np.zeros(0)}
        return {name: np.concatenate([part[name] for part in self._parts]) for name in self._parts[0]}

    def _thin(self) -> None:
        rows = self._joined()
        keep = np.sort(np.argpartition(rows["draw"], self._most - 1)[: self._most])
        self._parts = [{name: values[keep] for name, values in rows.items()}]
        self._size = len(keep)
        self._limit = float(self._parts[0]["draw"].max())


# ---------------------------------------------------------------- what a comparison covers: heights of a
# cloud over its reference, and the parts that nothing lies on


class HeightMap:
    """Mean heights of a mesh in plan.

    Parameters
    ----------
    mesh : the reference.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        vertices = mesh.vertices_m
        self._grid = CellGrid.around(vertices[:, :2], PLAN_CELL_M)
        self._keys, number, count = np.unique(
            self._grid.keys(vertices[:, :2]), return_inverse=True, return_counts=True
        )
        self._height_m = np.bincount(number, weights=vertices[:, 2]) / count

    def above(self, points_m: ArrayF) -> ArrayF:
        """Heights of the points that have mesh above or below them, over the mean height of the mesh there.

        The others are left out.
        """
        points = points_m[self._grid.contains(points_m[:, :2])]
        key = self._grid.keys(points[:, :2])
        at = np.minimum(np.searchsorted(self._keys, key), len(self._keys) - 1)
        found = self._keys[at] == key
        return np.asarray(points[found, 2] - self._height_m[at[found]])


def coverage(places_m: ArrayF, mesh: TriangleMesh, area: Area) -> dict[str, float]:
    """How much of the area the reference covers, and how much of the reference the cloud.

    Parameters
    ----------
    places_m : (n, 3) places on the reference that points were compared with.
    mesh : the reference.
    area : the area of interest.

    Returns
    -------
    ``reference_area_m2`` of the triangles whose middle lies in the area; ``without_points``, the share of it
    in cubes of `SEEN_CELL_M` that hold none of the places. With a polygon also ``without_reference``, the
    share of the polygon in plan that has no triangle above or below it. A polygon that holds part of the
    river has no reference there.
    """
    middle = mesh.vertices_m[mesh.faces].mean(axis=1)
    inside = area.contains(middle)
    middle, size_m2 = middle[inside], mesh.areas_m2()[inside]
    out = {"reference_area_m2": float(size_m2.sum())}
    if len(middle):
        grid = CellGrid.around(middle, SEEN_CELL_M)
        near = places_m[grid.contains(places_m)]
        seen = np.isin(grid.keys(middle), grid.keys(near))
        out["without_points"] = float(size_m2[~seen].sum() / size_m2.sum()) if size_m2.any() else 1.0
    if area.polygon_en_m is not None and area.size_m2() > LEAST_PLAN_M2:
        plan_m2 = size_m2 * np.abs(mesh.face_normals()[inside, 2])
        out["without_reference"] = max(1.0 - float(plan_m2.sum()) / area.size_m2(), 0.0)
    return out


# ---------------------------------------------------------------- do cloud and reference belong together?
#
# The commonest mistakes of such comparisons are told by where both lie: another map grid or origin puts them
# kilometres apart, heights above a geoid instead of the ellipsoid some tens of metres, and an area of
# interest in other coordinates holds nothing.


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
