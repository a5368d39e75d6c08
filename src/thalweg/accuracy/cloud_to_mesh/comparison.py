"""A cloud against a reference mesh: the signed distance of each point, and what its sigmas predict for it.

A distance from a surface sees the part of a point's error along the surface's normal. Its prediction is
therefore ``n^T C n`` with the point's own covariance, plus the variance of the reference. The 3D total of
P2 eq. 9, ``sqrt(trace C)``, stands beside it: it is larger, by the square root of three where errors are
the same in all directions, and no comparison of a cloud with a surface can show that much. Distances are
positive in front of the reference, toward the boat, and negative behind it.

**Outliers** are judged by the distance over its sigma, not by the distance: sigmas grow with the range by a
factor of five, and one limit in metres would keep bushes near the boat and cut honest points far away.

Memory is bounded by the number of points that are compared, not by that of the cloud.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal, Self

import numpy as np
import pandas as pd
import pyarrow as pa

from thalweg.accuracy.cloud_to_mesh.overlap_check import (
    LEAST_POINTS,
    OTHER_HEIGHTS_M,
    Reach,
    explain_too_few,
    heights_apart,
)
from thalweg.accuracy.cloud_to_mesh.statistics import outlier_limits
from thalweg.core.cells import CellGrid
from thalweg.core.errors import InputError
from thalweg.core.geometry.mesh import TriangleMesh
from thalweg.core.las.files import iter_laz
from thalweg.core.tables import column, frame_of, table_kind
from thalweg.core.types import AnyArray, ArrayF
from thalweg.lidar.cloud import CORRELATIONS, SIGMAS, cloud_covariance
from thalweg.surface.area import Area
from thalweg.surface.cloud_to_mesh import Distances, Surface

# ---------------------------------------------------------------- what a comparison covers: heights of a
# cloud over its reference, and the parts that nothing lies on


PLAN_CELL_M: Final = 1.0
"""Heights are compared in cells of this width."""

SEEN_CELL_M: Final = 0.5
"""A reference without a compared point in a cell of this width is not seen."""

LEAST_PLAN_M2: Final = 1.0


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


# ---------------------------------------------------------------- comparison


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

CLOUD_TO_MESH: Final = table_kind("cloud_to_mesh", 1, [
    column("t_gps_s", pa.float64(), "s", "adjusted standard GPS time of the point"),
    column("east_m", pa.float64(), "m", "point in wcs, east"),
    column("north_m", pa.float64(), "m", "point in wcs, north"),
    column("up_m", pa.float64(), "m", "point in wcs, up"),
    column("range_m", pa.float32(), "m", "measured range"),
    column("distance_m", pa.float64(), "m", "signed distance, positive in front of the reference"),
    column("normal_east", pa.float32(), "1", "unit normal of the reference at the nearest place, east"),
    column("normal_north", pa.float32(), "1", "unit normal of the reference at the nearest place, north"),
    column("normal_up", pa.float32(), "1", "unit normal of the reference at the nearest place, up"),
    column("sigma_normal_m", pa.float32(), "m", "predicted, along that normal: sqrt(n^T C n)"),
    column("sigma_reference_m", pa.float32(), "m", "of the reference: its noise and its registration"),
    column("sigma_3d_m", pa.float32(), "m", "predicted, all directions: sqrt(trace C), P2 eq. 9"),
    column("at_border", pa.bool_(), "1", "the nearest place lies on the border of the mesh"),
    column("used", pa.bool_(), "1", "compared: near enough, and not left out for the border"),
    column("outlier", pa.bool_(), "1", "used, and its distance over its sigma outside the outlier rule"),
])  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparisonSettings:
    """How a cloud is compared with a mesh; see the sections `accuracy` and `reference` of a campaign file.

    Parameters
    ----------
    border : whether points whose nearest place lies on the mesh's border are left out.
    max_distance_m : points farther from the mesh have no counterpart.
    max_points : points compared at most.
    outlier_nmads : the outlier rule, see `normalised_distances`.
    correlation_s : correlation time of the slowest error of the trajectory.
    reference_sigma_m : standard deviation of the reference as a whole, along its normal.
    seed : of the random sample and of permutations.
    """

    border: Literal["exclude", "keep"] = "exclude"
    max_distance_m: float = 2.0
    max_points: int = 1_000_000
    outlier_nmads: float = 5.0
    correlation_s: float = 20.0
    reference_sigma_m: float = 0.005
    seed: int = 0

    @classmethod
    def from_sections(
        cls,
        accuracy: Mapping[str, Any],
        reference: Mapping[str, Any],
        seed: int = 0,
        *,
        estimated_correlation_s: float = 20.0,
    ) -> Self:
        """Settings of the sections `accuracy` and `reference` as plain values.

        ``estimated_correlation_s`` stands in where ``correlation_s`` is ``auto``.
        """
        names = ("border", "max_distance_m", "max_points", "outlier_nmads")
        stated = accuracy["correlation_s"]
        return cls(
            **{n: accuracy[n] for n in names},
            correlation_s=estimated_correlation_s if stated == "auto" else stated,
            reference_sigma_m=reference["sigma_m"],
            seed=seed,
        )


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
        **asdict(settings),
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
