"""Two epochs compared at core points: distance, its standard deviation by parts, and significance.

The variance of a distance has three parts: errors that points share (of the poses,
`thalweg.deformation.field`, or a stated sigma of a foreign cloud), white noise and roughness (the spread
within the cylinder over n, as in Lague, Brodu and Leroux 2013), and the registration of the epochs. M3C2
itself knows roughness and a registration error that it adds linearly; here independent parts are added in
squares.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy.spatial import cKDTree
from scipy.stats import norm

from thalweg.core import ArrayF, ArrayI, GeometryError, InputError, column, frame_of, table_kind
from thalweg.deformation.field import benjamini_hochberg
from thalweg.deformation.m3c2 import ColumnIndex, Cylinders, cut_cylinders, multiscale_normals

CHANGES = table_kind(
    "changes",
    1,
    [
        column("core", "1", "number of the core point", pa.int64()),
        *(column(f"{axis}_m", "m", f"core point, {axis}") for axis in ("east", "north", "up")),
        *(column(f"normal_{axis}", "1", f"normal, {axis}") for axis in ("east", "north", "up")),
        column("scale_m", "m", "radius at which the normal was fitted"),
        column("n_before", "1", "points of the first epoch in the cylinder", pa.int64()),
        column("n_after", "1", "points of the second epoch in the cylinder", pa.int64()),
        column("distance_m", "m", "second minus first epoch along the normal"),
        column("sigma_m", "m", "standard deviation of the distance"),
        column("sigma_field_m", "m", "its part from errors that points share"),
        column("sigma_white_m", "m", "its part from roughness and noise of single points"),
        column("sigma_registration_m", "m", "its part from the registration of the epochs"),
        column("lod95_m", "m", "level of detection: 1.96 standard deviations"),
        column("p_value", "1", "probability of such a distance without change"),
        column("q_value", "1", "rate of false discoveries at which it counts (Benjamini-Hochberg)"),
        column("significant", "1", "counts at the chosen level", pa.bool_()),
        column("state", "1", "what is known of the place", pa.string()),
    ],
)
"""One row for each core point."""

CLOUD_TO_CLOUD = table_kind(
    "cloud_to_cloud",
    1,
    [
        *(column(f"{axis}_m", "m", f"point, {axis}") for axis in ("east", "north", "up")),
        column("distance_m", "m", "to the nearest point of the first epoch; never negative"),
        column(
            "plane_distance_m", "m",
            "to the plane of the nearest points of the first epoch; positive towards the given side",
        ),
        column("spacing_m", "m", "of the first epoch's points there"),
    ],
)  # fmt: skip
"""One row for each point of the second epoch."""

_POINTS_A_TILE = 1_500_000
_POINTS_A_CHUNK = 200_000
_ASKED = 1000
"""Core points that tell whether clouds lie at one place."""
CONTROLS = ("fdr", "none")
"""What the level of significance holds for: the rate of false discoveries, or each core point alone."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """How two clouds are compared; lengths in metres.

    Attributes
    ----------
    scales_m : radii at which normals are fitted; the most planar counts.
    radius_m : of the cylinders.
    half_length_m : reach of the cylinders along the normal, to both sides.
    least_points : that a mean needs in each epoch.
    level : of significance.
    control : see `CONTROLS`.
    """

    scales_m: tuple[float, ...] = (0.5, 1.0, 2.0)
    radius_m: float = 0.5
    half_length_m: float = 5.0
    least_points: int = 5
    level: float = 0.05
    control: str = "fdr"

    def __post_init__(self) -> None:
        lengths = (*self.scales_m, self.radius_m, self.half_length_m)
        if not self.scales_m or not all(0 < each < np.inf for each in lengths):
            raise InputError(
                f"radii and lengths {lengths} m", expected="positive lengths, at least one scale"
            )
        if self.control not in CONTROLS or not 0 < self.level < 1 or self.least_points < 1:
            raise InputError(
                f"control {self.control!r}, level {self.level:g}, {self.least_points} points",
                expected=f"one of {', '.join(CONTROLS)}, a level between 0 and 1, at least one point",
            )


@dataclass(frozen=True, slots=True)
class Distances:
    """Distances at core points and what a sigma is made from, before errors are known.

    Attributes
    ----------
    cores_m, normals : (k, 3); scale_m : (k,) radius of each normal's fit.
    n : (k, 2) points of the first and second epoch; distance_m : (k,), NaN where an epoch has too few.
    roughness_m : (k,) standard deviation of the distance from the spread in both cylinders.
    """

    cores_m: ArrayF
    normals: ArrayF
    scale_m: ArrayF
    n: ArrayI
    distance_m: ArrayF
    roughness_m: ArrayF


def measure_distances(
    cores_m: ArrayF,
    before_m: ArrayF,
    after_m: ArrayF,
    options: Comparison,
    *,
    towards: ArrayF,
    tiles: int | None = None,
) -> Distances:
    """Distances from the first to the second cloud along normals of the first.

    Parameters
    ----------
    cores_m : (k, 3) core points.
    before_m, after_m : (n, 3) clouds in one frame.
    towards : (3,) or (k, 3) direction to which normals point: a positive distance is a surface that came that
        way.
    tiles : pieces along the longest side, whose points are indexed one after the other; None: as many as keep
        the memory of an index small. The distances do not depend on it.

    Raises
    ------
    GeometryError : no core point has points of both clouds around it: the epochs do not overlap.
    """
    k = len(cores_m)
    clouds = (before_m, after_m)
    pieces = -(-max(len(before_m), len(after_m)) // _POINTS_A_TILE) if tiles is None else tiles
    sight = np.broadcast_to(towards, (k, 3))
    axis = int(np.argmax(np.ptp(cores_m, axis=0)))
    margin = max(*options.scales_m, float(np.hypot(options.radius_m, options.half_length_m)))
    width = max(options.radius_m, 0.5 * max(options.scales_m))
    normals, scale = np.full((k, 3), np.nan), np.full(k, np.nan)
    n = np.zeros((2, k), dtype=np.int64)
    along, std = np.full((2, k), np.nan), np.full((2, k), np.nan)
    for rows in np.array_split(np.argsort(cores_m[:, axis], kind="stable"), pieces):
        if not len(rows):
            continue
        place = cores_m[rows, axis]
        for i, cloud in enumerate(clouds):
            near = (cloud[:, axis] >= place.min() - margin) & (cloud[:, axis] <= place.max() + margin)
            if not near.any():
                continue
            index = ColumnIndex.of(cloud[near], width)
            if i == 0:
                normals[rows], scale[rows] = multiscale_normals(
                    cores_m[rows], index, options.scales_m, towards=sight[rows]
                )
            cut = cut_cylinders(
                cores_m[rows],
                normals[rows],
                index,
                radius_m=options.radius_m,
                half_length_m=options.half_length_m,
                least=options.least_points,
            )
            n[i, rows], along[i, rows], std[i, rows] = cut.n, cut.along_m, cut.std_m
            del index
    cuts = [Cylinders(*each) for each in zip(n, along, std, strict=True)]
    meet = np.isfinite(along).all(axis=0).any()
    if not meet:  # cylinders between sparse points are empty although the clouds lie at one place
        near = cKDTree(after_m).query(cores_m[:: -(-k // _ASKED)])[0]
        meet = float(np.median(near)) <= options.half_length_m
    return distances_along(cores_m, normals, scale, cuts[0], cuts[1], one_place=bool(meet))


def distances_along(
    cores_m: ArrayF,
    normals: ArrayF,
    scale_m: ArrayF,
    before: Cylinders,
    after: Cylinders,
    *,
    one_place: bool = False,
) -> Distances:
    """Distances from what cylinders about core points cut out of both clouds.

    Parameters
    ----------
    cores_m, normals : (k, 3) core points and axes of their cylinders; scale_m : (k,) radius of each normal's
        fit.
    before, after : what they cut out of the first and the second epoch.
    one_place : the second epoch is known to have points near the core points.

    Raises
    ------
    GeometryError : no core point has points of both clouds around it: the epochs do not overlap.
    """
    distance = after.along_m - before.along_m
    if not np.isfinite(distance).any():
        k, n = len(cores_m), [int((each.n > 0).sum()) for each in (before, after)]
        if not np.isfinite(normals).any():
            raise GeometryError(
                f"none of {k:,} core points has three neighbours of the first epoch for a normal",
                expected="radii that fit the spacing of the points",
                cure="Raise deformation.scales_m",
            )
        few = one_place or bool(((before.n > 0) & (after.n > 0)).any())
        raise GeometryError(
            f"none of {k:,} core points has enough points of both epochs; {n[0]:,} have points of "
            f"the first, {n[1]:,} of the second",
            expected="cylinders that hold enough points" if few else "clouds that overlap, in one frame",
            cure="Raise deformation.cylinder_radius_m above the spacing of the points, or lower "
            "deformation.least_in_cylinder"
            if few
            else "Check that both have the same coordinate system, heights and units; raise "
            "deformation.reach_m where the change is larger",
        )
    with np.errstate(invalid="ignore", divide="ignore"):
        roughness = np.sqrt(before.std_m**2 / before.n + after.std_m**2 / after.n)
    return Distances(cores_m, normals, scale_m, np.column_stack([before.n, after.n]), distance, roughness)


_OF_PLANE: Final = 8
"""Nearest points that a plane is laid through."""


def cloud_to_cloud(before_m: ArrayF, after_m: ArrayF, *, towards: ArrayF) -> pd.DataFrame:
    """Table `CLOUD_TO_CLOUD`: distances of the second epoch's points from the first (C2C; T 4.1).

    The distance to the nearest point has no sign, and without any change it is not zero but some half of the
    spacing of the first cloud; a plane through the nearest points takes most of that away. Neither has a
    standard deviation of its own: what counts as change, M3C2 tells.

    Parameters
    ----------
    before_m, after_m : (n, 3) and (m, 3) in one frame.
    towards : (3,) side on which the distance from a plane is positive.

    Raises
    ------
    GeometryError : the first cloud has fewer points than a plane needs.
    """
    if len(before_m) < _OF_PLANE:
        raise GeometryError(
            f"{len(before_m)} points in the first epoch", expected=f"at least {_OF_PLANE}, as a plane needs"
        )
    tree = cKDTree(before_m)
    parts = []
    for first in range(0, len(after_m), _POINTS_A_CHUNK):
        chunk = after_m[first : first + _POINTS_A_CHUNK]
        found, index = (np.asarray(each) for each in tree.query(chunk, k=_OF_PLANE))
        near = before_m[index]
        middle = near.mean(axis=1)
        centred = near - middle[:, None]
        _, vectors = np.linalg.eigh(np.swapaxes(centred, 1, 2) @ centred)
        normal = vectors[:, :, 0]
        normal = normal * np.where(normal @ towards < 0, -1.0, 1.0)[:, None]
        along = np.einsum("ni,ni->n", chunk - middle, normal)
        own = np.asarray(tree.query(near[:, 0], k=2)[0])[:, 1]
        parts.append(np.column_stack([chunk, found[:, 0], along, own]))
    columns = np.concatenate(parts).T
    return frame_of(CLOUD_TO_CLOUD, dict(zip(CLOUD_TO_CLOUD.names, columns, strict=True)))


def judge_changes(
    found: Distances,
    options: Comparison,
    *,
    sigma_field_m: ArrayF,
    sigma_white_m: ArrayF,
    sigma_registration_m: ArrayF | float = 0.0,
) -> pd.DataFrame:
    """Table `CHANGES`: sigma by parts, level of detection, significance and state of each core point.

    Parameters
    ----------
    found : measured distances.
    sigma_field_m : (k,) from errors that the points of a moment, or of a cloud, share.
    sigma_white_m : (k,) predicted from the noise of single points; the larger of it and the roughness counts.
    sigma_registration_m : (k,) or one value.
    """
    k = len(found.distance_m)
    # one point has no spread: without a predicted sigma nothing is known of it
    known = np.isfinite(found.roughness_m) | (np.asarray(sigma_white_m) > 0)
    white = np.where(known, np.fmax(found.roughness_m, sigma_white_m), np.nan)
    parts = [
        np.broadcast_to(np.asarray(each, float), k) for each in (sigma_field_m, white, sigma_registration_m)
    ]
    measured = np.isfinite(found.distance_m)
    sigma = np.where(measured, np.sqrt(sum(part**2 for part in parts)), np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        p = 2.0 * norm.sf(np.abs(found.distance_m) / sigma)
    q = benjamini_hochberg(p)
    significant = (q if options.control == "fdr" else p) <= options.level
    seen = found.n >= options.least_points
    state = np.select(
        [
            ~seen[:, 0] & ~seen[:, 1],
            ~seen[:, 0],
            ~seen[:, 1],
            ~measured,
            ~known,
            significant & (found.distance_m > 0),
            significant,
        ],
        [
            "not seen",
            "not seen in first",
            "not seen in second",
            "no normal",
            "no sigma",
            "deposition",
            "erosion",
        ],
        default="no significant change",
    )
    axes = ("east", "north", "up")
    return frame_of(
        CHANGES,
        {
            "core": np.arange(k),
            **{f"{axis}_m": found.cores_m[:, i] for i, axis in enumerate(axes)},
            **{f"normal_{axis}": found.normals[:, i] for i, axis in enumerate(axes)},
            "scale_m": found.scale_m,
            "n_before": found.n[:, 0],
            "n_after": found.n[:, 1],
            "distance_m": found.distance_m,
            "sigma_m": sigma,
            "sigma_field_m": np.where(measured, parts[0], np.nan),
            "sigma_white_m": np.where(measured, parts[1], np.nan),
            "sigma_registration_m": np.where(measured, parts[2], np.nan),
            "lod95_m": norm.isf(0.025) * sigma,
            "p_value": p,
            "q_value": q,
            "significant": significant,
            "state": state,
        },
    )
