"""Clouds of others compared, with each other or with a surface: files in, tables out."""

import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
from pyproj import CRS
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from thalweg.accuracy import describe_errors, hotelling, outlier_limits, register_places
from thalweg.core import (
    ArrayF,
    ArrayI,
    CoverageError,
    Frame,
    GeometryError,
    InputError,
    LazWriter,
    column,
    read_dsm,
    table_kind,
    write_table,
)
from thalweg.core.geometry import TriangleMesh
from thalweg.core.values import METRE, check_degrees, check_heights, check_stated, units_of_crs
from thalweg.deformation import CHANGES, Comparison, cloud_to_cloud, judge_changes, measure_distances
from thalweg.deformation.foreign.surfaces import one_frame
from thalweg.ingest import Table, read_text_table
from thalweg.ingest.clouds import NO_USE, corners_of_mesh, read_cloud
from thalweg.settings.sections import DSM_ENDINGS, TEXT_ENDINGS, Accuracy, ReferenceSettings
from thalweg.surface import (
    Surface,
    Texture,
    mesh_reference,
    meshing_by_data,
    read_triangles,
    texture_of,
    usual_side_m,
)

log = logging.getLogger("thalweg")
TEXT = frozenset(TEXT_ENDINGS)
"""Suffixes of tables of points: x, y, z in the first three columns, a head of any number of lines."""
TABLES = {".csv", ".parquet", ".laz"}
"""Suffixes of results."""
DISTANCES: Final = table_kind(
    "cloud_to_surface",
    1,
    [
        column("east_m", "m", "point, first coordinate of its frame"),
        column("north_m", "m", "point, second coordinate"),
        column("up_m", "m", "point, height"),
        column("distance_m", "m", "signed distance, positive in front of the reference"),
        column("sigma_reference_m", "m", "of the reference: its noise and its registration"),
        column("at_border", "1", "the nearest place lies on the border of the mesh", pa.bool_()),
        column("used", "1", "compared: near enough, and not beside the border", pa.bool_()),
        column("outlier", "1", "used, and outside the outlier rule", pa.bool_()),
    ],
)
_MOST_COUNTED: Final = 100_000.0
"""Rows and columns of a scan are fewer, eastings of maps are more."""
_ROWS: Final = 1000
"""By so many rows is judged whether columns count."""
_MUCH_DENSER = 20.0
_RADIUS: Final = 3.0
"""Radius of a cylinder in spacings."""
_ROUGH: Final = 10.0
"""Least radius of a normal in scatters."""
_REACH: Final = 30.0
"""Reach of a cylinder to both sides in radii."""
_FEWEST_CORES: Final = 1000
"""Of small clouds more points are core points than one a cylinder."""
_SIDES: Final = 100.0
"""Points as many usual sides of its triangles from a reference are not of it."""
_OF_EXTENT: Final = 0.1
"""Nor are those farther than this share of its extent, where the triangles are large."""
_SAME: Final = 1e-6
"""Places nearer than this share of a side are the same: formats round."""


@dataclass(frozen=True, slots=True)
class Points:
    """Points (n, 3) of a file, in metres, the frame that it states, and what was left out and converted."""

    xyz_m: ArrayF
    frame: Frame
    path: Path
    notes: tuple[str, ...] = ()


def read_points(path: Path) -> Points:
    """Points of a cloud (LAS, LAZ, PLY, E57, PCD), of a table of coordinates, or centres of a raster's cells.

    Raises
    ------
    InputError : no such file, no points, or a table without three columns of numbers.
    """
    if path.suffix.lower() in DSM_ENDINGS:
        dsm = read_dsm(path)
        return Points(dsm.points_m(), dsm.frame, path, dsm.notes)
    if path.suffix.lower() not in TEXT or not path.is_file():
        cloud = read_cloud(path)
        if cloud.frame is None:
            check_degrees(
                cloud.points[:, :2],
                where=path,
                cure="Transform the cloud to a map projection, or state its coordinate system in the file",
            )
            check_heights(cloud.points[:, 2], where=path)
        elif isinstance(cloud.frame, CRS) and units_of_crs(cloud.frame)[0] == METRE:
            check_stated(cloud.points, cloud.frame, where=path)
        told = (f"{path.name}: {text}" for text in cloud.sentences() if text not in NO_USE)
        return Points(cloud.points, cloud.frame, path, tuple(told))
    table = read_text_table(path, bare=("x", "y", "z"))
    if not table.named and len(table.columns) > 3:  # colours and intensities stand behind the coordinates
        _refuse_counts(table, path)
        table = read_text_table(path, order=("x", "y", "z"))
        table.notes.append("The file names no columns: taken as x, y, z and others")
    places, up = table.places(None, any_system=True), table.find("height")
    if up is None:
        raise InputError(
            f"columns {table.listed()}",
            expected="x, y, z by their names, or in this order without names",
            where=path,
            cure="Name the columns in the first line",
        )
    xyz = np.column_stack([places.xy_m, table.numbers(up, "height")])
    known = np.isfinite(xyz).all(axis=1)
    if not known.any():
        raise InputError(
            "no point",
            expected="x, y, z in each line",
            where=path,
            cure="Export it again, or name another file",
        )
    check_heights(xyz[known, 2], where=path)
    if places.crs is None:
        check_degrees(xyz[known, :2], where=path, cure="Name the columns lon, lat, z, or transform them")
    notes = (*table.notes, *places.notes, *table.loss_notes())
    return Points(np.ascontiguousarray(xyz[known]), places.crs, path, notes)


def _refuse_counts(table: Table, path: Path) -> None:
    """Refuse columns without names of which the first count points, or rows and columns of a scan (FARO).

    Raises
    ------
    InputError : whole numbers stand before three columns that are none.
    """
    cells = [table.cells[k][:_ROWS] for k in range(min(len(table.columns), 5))]
    first = [pd.to_numeric(each, errors="coerce") for each in cells]
    whole = [bool((values % 1 == 0).all()) for values in first]
    n = whole.index(False) if False in whole else 0
    counts = n == 2 and max(values.max() for values in first[:2]) < _MOST_COUNTED
    counts |= n == 1 and bool((np.diff(first[0]) > 0).all())
    if counts and len(first) >= n + 3 and not any(whole[n : n + 3]):
        raise InputError(
            f"{len(first)} columns without names, of which the first {'two count' if n > 1 else 'counts'}",
            expected="x, y, z in the first three columns, or names",
            where=path,
            cure=f"Name all columns in a first line, such as {'row, column' if n > 1 else 'number'}, x, y, z",
        )


def point_spacing_m(path: Path, most: int = 2000) -> float | None:
    """Median distance of the points of a cloud from their nearest neighbours; None for a mesh.

    Parameters
    ----------
    path : a file as of `read_points`.
    most : so many points are asked, evenly spread over the file.
    """
    if read_triangles(path) is not None:
        return None
    xyz = np.unique(read_points(path).xyz_m, axis=0)
    if len(xyz) < 2:
        return None
    near = np.asarray(cKDTree(xyz).query(xyz[:: max(len(xyz) // most, 1)], k=2)[0])
    return float(np.median(near[:, 1]))


def _two(before: Path, after: Path) -> tuple[ArrayF, ArrayF, ArrayF, Frame, list[str]]:
    """Points (n, 3) of two clouds, the shift that was taken off, their frame, and notes."""
    clouds = [read_points(path) for path in (before, after)]
    frame, notes = one_frame(clouds)
    shift = np.round(clouds[0].xyz_m.mean(axis=0))  # so that squares of coordinates of maps keep their digits
    for cloud in clouds:
        np.subtract(cloud.xyz_m, shift, out=cloud.xyz_m)
    return clouds[0].xyz_m, clouds[1].xyz_m, shift, frame, [*clouds[0].notes, *clouds[1].notes, *notes]


def compare_clouds(
    before: Path,
    after: Path,
    options: Comparison | Mapping[str, Any],
    *,
    core_every: int | None = 50,
    towards: tuple[float, float, float] = (0.0, 0.0, 1.0),
    sigma_m: tuple[float | None, float | None] = (None, None),
    sigma_registration_m: float = 0.0,
    correlation_m: float = 0.0,
) -> tuple[pd.DataFrame, Frame, list[str]]:
    """Compare two clouds from files at every n-th point of the first.

    Parameters
    ----------
    before, after : clouds in one frame.
    options : radii, level of significance. A mapping holds what is stated; other lengths are by the data
        (`lengths_by_data`).
    core_every : every how many-th point of the first cloud is a core point; None: as many as a cylinder
        holds.
    towards : direction to which normals point.
    sigma_m : standard deviation of each cloud along the normal that neighbouring points share; None if
        unknown.
    sigma_registration_m : standard deviation of the registration of both.
    correlation_m : above zero, a note tells the standard deviation of the mean (`sigma_of_mean`).

    Returns
    -------
    Table `CHANGES`, the frame of the clouds, and notes for the reader, with the lengths that the data told.

    Raises
    ------
    InputError : files that cannot be read or state different frames, or core points of no cloud.
    GeometryError : clouds that do not overlap.
    """
    if core_every is not None and core_every < 1:
        raise InputError(f"core points at each {core_every}-th point", expected="1 or more")
    first, second, shift, frame, notes = _two(before, after)
    if core_every is None or not isinstance(options, Comparison):
        textures = [texture_of(cloud, first.mean(axis=0) + towards) for cloud in (first, second)]
        if not isinstance(options, Comparison):
            options = lengths_by_data(textures, options)
        n = np.pi * (options.radius_m / textures[0].spacing_m) ** 2
        core_every = core_every or max(round(min(n, len(first) / _FEWEST_CORES)), 1)
        told = " and ".join(
            f"{each.spacing_m:.3g} m apart, scatter {each.scatter_m:.2g} m" for each in textures
        )
        notes.append(
            f"Points of the clouds are {told}: cylinders of radius {options.radius_m:.3g} m reach "
            f"{options.half_length_m:.3g} m to both sides, normals are of radii "
            f"{', '.join(f'{radius:.3g}' for radius in options.scales_m)} m, 1 of {core_every} points is "
            "a core point."
        )
    cores = first[::core_every].copy()
    found = measure_distances(cores, first, second, options, towards=np.asarray(towards, float))
    if None in sigma_m:
        notes.append(ROUGHNESS_ALONE)
    notes += density_notes(found.n)
    shared = np.hypot(sigma_m[0] or 0.0, sigma_m[1] or 0.0)
    k = len(cores)
    table = judge_changes(
        found,
        options,
        sigma_field_m=np.full(k, shared),
        sigma_white_m=np.zeros(k),
        sigma_registration_m=sigma_registration_m,
    )
    if correlation_m and None not in sigma_m:
        whole = sigma_of_mean(table, options.radius_m, correlation_m)
        notes.append(f"The stated sigmas give a standard deviation of the mean of {whole:.4g} m.")
    table[["east_m", "north_m", "up_m"]] += shift
    return table, frame, notes


def lengths_by_data(textures: Sequence[Texture], stated: Mapping[str, Any]) -> Comparison:
    """How two clouds are compared: as stated, and with lengths of their own where nothing is.

    A cylinder has a radius of three spacings of the sparser cloud, so that it holds some 28 of its points,
    and reaches 30 radii to both sides. Normals are fitted in one, two and four radii, or in ten times the
    scatter if that is more: with diameters of 20 to 25 times the roughness they err by less than 2 % of a
    distance (Lague, Brodu and Leroux 2013, 4.1).

    Parameters
    ----------
    textures : of both clouds.
    stated : fields of `Comparison`; None counts as not stated.
    """
    known = {name: value for name, value in stated.items() if value is not None}
    spacing = max(each.spacing_m for each in textures)
    radius = known.setdefault("radius_m", _RADIUS * spacing)
    widest = max(radius, _ROUGH * max(each.scatter_m for each in textures))
    known.setdefault("scales_m", (widest, 2.0 * widest, 4.0 * widest))
    known.setdefault("half_length_m", _REACH * radius)
    return Comparison(**known)


ROUGHNESS_ALONE: Final = (
    "Without sigmas of both clouds the level of detection is that of roughness alone: errors that the points "
    "of a cloud share are in no limit, and what counts as significant may be theirs."
)


def density_notes(n: ArrayI) -> list[str]:
    """A sentence where one cloud is much denser than the other, by their points (k, 2) in the cylinders."""
    both = n[(n > 0).all(axis=1)]
    denser = float(np.median(both[:, 0] / both[:, 1])) if len(both) else 1.0
    if 1.0 / _MUCH_DENSER < denser < _MUCH_DENSER:
        return []
    which = ("first", "second") if denser > 1.0 else ("second", "first")
    return [
        f"The {which[0]} cloud is {max(denser, 1.0 / denser):.0f} times as dense as the {which[1]}, "
        "whose few points rule the level of detection; where cylinders hold too few, take wider ones."
    ]


def compare_nearest(
    before: Path, after: Path, *, every: int = 1, towards: tuple[float, float, float] = (0.0, 0.0, 1.0)
) -> tuple[pd.DataFrame, Frame, list[str]]:
    """Distances of every n-th point of the second cloud to the first (`cloud_to_cloud`), from files.

    Returns
    -------
    Table `CLOUD_TO_CLOUD`, the frame of the clouds, and notes for the reader.

    Raises
    ------
    InputError : files that cannot be read or state different frames, or no point is asked for.
    GeometryError : the first cloud has too few points.
    """
    if every < 1:
        raise InputError(f"each {every}-th point", expected="1 or more")
    first, second, shift, frame, notes = _two(before, after)
    table = cloud_to_cloud(first, second[::every], towards=np.asarray(towards, float))
    table[["east_m", "north_m", "up_m"]] += shift
    notes.append(
        f"Points of the first cloud lie {table['spacing_m'].median():.3f} m apart in the median: distances "
        "to the nearest point are not zero without change, and have no limit."
    )
    return table, frame, notes


_SAMPLE = 1500
"""Core points whose pairs tell how errors add up in a mean."""


def sigma_of_mean(table: pd.DataFrame, radius_m: float, correlation_m: float) -> float:
    """Standard deviation of the mean of all distances of `compare_clouds`.

    Errors that points share have the correlation ``exp(-d / L)`` at a distance d, noise that of the share of
    their cylinders that two core points have in common, a registration one of 1. The means over all pairs are
    those over the pairs of a sample.

    Parameters
    ----------
    table : `CHANGES`, with stated sigmas.
    radius_m : of the cylinders.
    correlation_m : L, at which the correlation of shared errors is 1/e.

    Raises
    ------
    InputError : no distance has a standard deviation.
    """
    known = table[table["sigma_m"].notna()]
    k = len(known)
    if not k:
        raise InputError("no distance has a standard deviation", expected="clouds that overlap")
    some = known.sample(min(k, _SAMPLE), random_state=0)
    lag = pdist(some[["east_m", "north_m", "up_m"]].to_numpy())
    apart = np.minimum(0.5 * lag / radius_m, 1.0)
    overlap = 2.0 / np.pi * (np.arccos(apart) - apart * np.sqrt(1.0 - apart**2))
    alike = np.exp(-lag / correlation_m) if correlation_m else np.zeros(len(lag))
    variance = 0.0
    parts = ((alike, "field"), (overlap, "white"), (np.ones(len(lag)), "registration"))
    for correlation, name in parts:
        sigma = some[f"sigma_{name}_m"].to_numpy()
        i, j = np.triu_indices(len(some), 1)
        pairs = float(np.mean(sigma[i] * sigma[j] * correlation)) if len(lag) else 0.0
        variance += (1.0 - 1.0 / k) * pairs + float(np.mean(sigma**2)) / k
    return float(np.sqrt(variance))


def compare_with_surface(
    cloud: Path,
    reference: Path,
    settings: ReferenceSettings | Mapping[str, Any],
    *,
    seen_from_m: tuple[float, float, float] | None = None,
    max_distance_m: float | None = None,
    outlier_nmads: float = 3.0,
    registration: bool = False,
) -> tuple[pd.DataFrame, Frame, dict[str, Any], list[str]]:
    """Signed distances of a cloud's points from a reference surface (cloud to mesh; P2 section 6.2).

    Parameters
    ----------
    cloud : a file as of `read_points`.
    reference : a mesh (PLY with faces), a surface model (GeoTIFF; the centres of its cells are joined by
        triangles), or a cloud, which is meshed.
    settings : how a cloud is meshed; its ``sigma_m`` joins that of the surface's own noise. A mapping holds
        what is stated; the rest is by the data (`thalweg.surface.meshing_by_data`).
    seen_from_m : place in the common frame from which the reference is seen: its front, where distances are
        positive; None: from above. A mesh has its front by itself.
    max_distance_m : points that are farther from the surface are not compared; None: than 100 times the usual
        side of its triangles, or than a tenth of its extent.
    outlier_nmads : limits of outliers about the median, in NMAD.
    registration : whether the cloud is also fitted to the reference by a rigid motion.

    Returns
    -------
    table : kind `DISTANCES`, a row a point of the cloud.
    frame : of both files.
    facts : ``counts`` of what became of the points (those that are points of the reference too have the
        distance 0), ``lengths`` that were used, statistics ``all`` and ``without_outliers`` (see
        `describe_errors`), ``mesh`` facts of a meshed reference, ``registration``: the motion with its
        standard deviations, and statistics after it, or why there is none.
    notes : sentences for the reader.

    Raises
    ------
    InputError : files that cannot be read, or that state different frames.
    GeometryError : the reference is no surface, or lies kilometres away.
    CoverageError : no point is near enough.
    """
    points = read_points(cloud)
    dsm = read_dsm(reference) if reference.suffix.lower() in DSM_ENDINGS else None
    triangles = read_triangles(reference)
    if dsm is not None:
        raster = dsm.mesh()
        triangles = raster.vertices_m, raster.faces
        vertices = Points(dsm.points_m(), dsm.frame, reference, dsm.notes)
    elif triangles is not None:
        told = corners_of_mesh(reference, triangles[0])
        about = tuple(f"{reference.name}: {text}" for text in told.report.notes)
        vertices = Points(told.points, told.frame, reference, about)
    else:
        vertices = read_points(reference)
    frame, notes = one_frame([points, vertices])
    notes = [*points.notes, *vertices.notes, *notes]
    origin = np.round(np.median(vertices.xyz_m, axis=0))  # large coordinates would cost digits
    facts: dict[str, Any] = {}
    lengths: dict[str, float] = {}
    sigma_m = settings.sigma_m if isinstance(settings, ReferenceSettings) else settings.get("sigma_m") or 0.0
    if triangles is None:
        above = vertices.xyz_m.mean(axis=0) - origin + [0.0, 0.0, np.ptp(vertices.xyz_m[:, :2]) / 1e3 + 50.0]
        seen = np.atleast_2d(above if seen_from_m is None else np.asarray(seen_from_m) - origin)
        if not isinstance(settings, ReferenceSettings):
            settings, texture = meshing_by_data(vertices.xyz_m - origin, seen, settings)
            lengths = {"spacing_m": texture.spacing_m, "scatter_m": texture.scatter_m}
        lengths |= {"cell_m": settings.cell_m, "longest_edge_m": settings.longest_edge_m}
        mesh, facts["mesh"] = mesh_reference(vertices.xyz_m - origin, track_m=seen, settings=settings)
        notes += facts["mesh"]["notes"]
    else:
        corners, faces = triangles
        mesh = TriangleMesh(vertices_m=corners - origin, faces=faces, sigma_m=np.zeros(len(corners)))
    surface = Surface(mesh)
    found = surface.distances(points.xyz_m - origin)
    side = usual_side_m(mesh.vertices_m, mesh.faces)
    extent = float(np.linalg.norm(np.ptp(mesh.vertices_m, axis=0)))
    reach = min(_SIDES * side, _OF_EXTENT * extent) if max_distance_m is None else max_distance_m
    lengths["max_distance_m"] = reach
    facts["lengths"] = lengths
    # what is taken as ground is an estimate, the reference's own points are the reference
    apart = cKDTree(vertices.xyz_m).query(points.xyz_m, distance_upper_bound=_SAME * side, workers=-1)[0]
    shared = np.isfinite(apart)
    distance = np.where(shared, 0.0, found.distance_m)
    at_border = found.at_border & (np.abs(distance) > _SAME * side)
    far = np.abs(distance) > reach
    used = ~far & ~at_border
    if not used.any():
        raise CoverageError(
            f"none of {len(distance):,} points: {far.sum():,} are farther than {reach:.3g} m from the "
            f"reference (nearest {np.abs(distance).min():#.4g} m), the others lie beside its border",
            expected="a cloud and a reference of one place",
            where=cloud,
            cure="Compare their coordinates and height systems, or raise accuracy.max_distance_m",
        )
    if n := int(shared.sum()):
        notes.append(f"{n:,} of {len(shared):,} points are points of the reference: their distance is zero.")
    low, high = outlier_limits(distance[used], outlier_nmads)
    outlier = used & ((distance < low) | (distance > high))
    table = pd.DataFrame(
        {
            **{name: points.xyz_m[:, k] for k, name in enumerate(("east_m", "north_m", "up_m"))},
            "distance_m": distance,
            "sigma_reference_m": np.hypot(found.sigma_m, sigma_m),
            "at_border": at_border,
            "used": used,
            "outlier": outlier,
        }
    )
    facts |= {
        "counts": {
            "points": len(table),
            "too_far": int(far.sum()),
            "at_border": int((at_border & ~far).sum()),
            "compared": int(used.sum()),
            "points_of_the_reference": int(shared.sum()),
            "outliers": int(outlier.sum()),
        },
        "all": describe_errors(distance[used]),
        "without_outliers": describe_errors(distance[used & ~outlier]),
    }
    if registration and shared.all():
        facts["registration"] = {"done": False, "reason": "all points are points of the reference"}
    elif registration:
        compared = points.xyz_m[used & ~shared] - origin
        facts["registration"] = _registered(compared, surface, origin, reach, outlier_nmads)
    return table, frame, facts, notes


def _registered(
    points_m: ArrayF, surface: Surface, origin_m: ArrayF, max_distance_m: float, outlier_nmads: float
) -> dict[str, Any]:
    """The motion that brings a cloud onto a surface, its standard deviations, statistics after it."""
    try:
        found = register_places(points_m, surface, max_distance_m)
    except GeometryError as error:
        return {"done": False, "reason": error.found}
    after = surface.distances(found.motion.apply(points_m))
    left = after.distance_m[~after.at_border & (np.abs(after.distance_m) <= max_distance_m)]
    low, high = outlier_limits(left, outlier_nmads)
    turn = Rotation.from_matrix(found.motion.R).as_rotvec(degrees=True)
    sigma = None if found.cov is None else np.sqrt(np.maximum(np.diag(found.cov), 0.0))
    test: tuple[float | None, float | None] = (None, None)
    if found.cov is not None:
        test = hotelling(found.motion, found.cov, 6 - len(found.undetermined), found.cells)
    names = ("east", "north", "up")

    def named(values: ArrayF) -> dict[str, float]:
        """Three values under the names of their axes."""
        return dict(zip(names, values.tolist(), strict=True))

    return {
        "done": True,
        "centre_m": named(found.motion.centre_m + origin_m),
        "shift_m": named(found.motion.shift_m),
        "rotation_deg": named(turn),
        "sigma_shift_m": None if sigma is None else named(sigma[:3]),
        "sigma_rotation_deg": None if sigma is None else named(np.rad2deg(sigma[3:])),
        "f": test[0],
        "f_exceeded_in_5_percent": test[1],
        "undetermined": list(found.undetermined),
        "points": found.n,
        "cells": found.cells,
        "cell_m": found.cell_m,
        "all": describe_errors(left),
        "without_outliers": describe_errors(left[(left >= low) & (left <= high)]),
    }


def compare_files(
    *,
    cloud: Path,
    reference: Path,
    distances: Path,
    points: Path,
    facts: Path,
    settings: ReferenceSettings,
    accuracy: Accuracy,
) -> None:
    """The finished cloud of a campaign and its reference -> distances as a table and as LAZ, and facts.

    Parameters
    ----------
    settings, accuracy : sections ``reference`` and ``accuracy``.
    """
    table, frame, told, notes = compare_with_surface(
        cloud,
        reference,
        settings,
        seen_from_m=settings.seen_from_m,
        max_distance_m=accuracy.max_distance_m,
        outlier_nmads=accuracy.outlier_nmads,
        registration=accuracy.registration,
    )
    for path in (distances, points):
        write_changes(path, table, frame, DISTANCES)
    told |= {"cloud": cloud.name, "reference": reference.name, "notes": notes}
    told["outlier_nmads"] = accuracy.outlier_nmads
    facts.write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
    for note in notes:
        log.warning(note)


def write_changes(path: Path, table: pd.DataFrame, frame: Frame, kind: pa.Schema = CHANGES) -> None:
    """Write a table of places, such as `CHANGES`, as CSV, Parquet or LAZ (columns as extra dimensions).

    Raises
    ------
    InputError : another suffix, or a folder that is not there.
    """
    if path.suffix.lower() not in TABLES:
        raise InputError(f"suffix {path.suffix!r}", expected=" or ".join(sorted(TABLES)), where=path)
    if not path.parent.is_dir():
        raise InputError("no such folder", where=path.parent, cure="Make it, or name another file")
    if path.suffix.lower() == ".csv":
        table.to_csv(path, index=False)
    elif path.suffix.lower() == ".parquet":
        write_table(path, table, kind)
    else:
        place = ["east_m", "north_m", "up_m"]
        kept = [item for item in kind if item.name not in {"core", "state", *place}]
        extra = {
            item.name: ("u1" if item.type == pa.bool_() else "f8", (item.metadata or {})[b"unit"].decode())
            for item in kept
        }
        with LazWriter(path, frame, extra_dimensions=extra) as writer:
            writer.append(table[place].to_numpy(), extra={name: table[name].to_numpy() for name in extra})
