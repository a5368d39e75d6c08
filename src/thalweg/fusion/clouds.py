r"""Clouds of the surroundings on the ground that the boat has measured, and all clouds as one.

**Fit.** Both clouds become one point a cell. A small motion ``p -> c + exp([w]x)(p - c) + t`` of the foreign
cloud changes the distance of a cell along the normal of the boat's ground by ``n . t + ((p - c) x n) . w``
(Chen and Medioni 1992); it is solved with Tukey's weights. Motions that the ground does not show are left
alone and named; each may move the points by ``sigma_datum_m`` (root mean square), which the covariance holds.

**Covariance.** Errors of a photogrammetric cloud are alike over metres, so the number of cells says nothing.
Blocks of ground are left out one after the other (jackknife, MacKinnon, Nielsen and Webb 2023), and the
shared error of the boat's own ground, which no block shows, is added to the shift.

**Refusals.** Too little common ground; a motion larger than a datum may err; a scatter after the fit that is
no ground.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from pyproj import CRS
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from thalweg.core import (
    NMAD,
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayI,
    CoverageError,
    ExtraDimension,
    GeometryError,
    InputError,
    LazWriter,
    LocalFrame,
    Trajectory,
    cross_matrix,
    iter_laz,
    laz_header,
    plane_rates,
    read_raster,
    root_mean_square,
)
from thalweg.core.geometry import cell_numbers
from thalweg.fusion.ground import GroundOfPieces, extremes_en_m
from thalweg.settings.sections import CloudFit, GroundFilter
from thalweg.surface import (
    LEAST_VISIBLE,
    Area,
    Motion,
    jackknife,
    motions_in_words,
    tukey,
    tukey_slope,
    visible_motions,
)

LEAST_CELLS: Final = 50
"""Cells of common ground that a fit needs."""
MOST_ITERATIONS: Final = 40
SHORE_M: Final = 10.0
"""Farther from the water line ground may lie below it, behind a dyke."""
STEP_M: Final = 1e-5
NEIGHBOURS: Final = 9


_COLUMNS: Final = ("return_number", "number_of_returns", "t_gps_s")
"""What the filter of the ground and the pose's part of the errors need of each point besides its place."""


class Source(IntEnum):
    """Where a height of the model comes from."""

    NONE = 0
    BED = 1
    LIGHT_SHEET = 2
    LIDAR = 3
    SURROUNDINGS = 4
    FILLED = 5


SOURCE_WORDS: Final = {
    Source.NONE: "no height",
    Source.BED: "bed from soundings",
    Source.LIGHT_SHEET: "bed by the light sheet",
    Source.LIDAR: "banks by the lidar",
    Source.SURROUNDINGS: "cloud of the surroundings",
    Source.FILLED: "interpolated over a gap",
}
EXTRA_DIMENSIONS: Final[dict[str, ExtraDimension]] = {
    "sigma_horizontal": ("u4", "standard deviation, m", 0.0001),
    "sigma_up": ("u4", "standard deviation, m", 0.0001),
}
"""Extra bytes of a joined cloud; its ``point_source_id`` is the `Source`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cloud:
    """Points with sigmas.

    Parameters
    ----------
    xyz_m : (n, 3) wcs.
    sigma_horizontal_m, sigma_up_m : (n,) standard deviations; horizontal: of one axis.
    rgb : (n, 3) uint16 colours, or None.
    pose : (n, 3) variances, horizontal and up, that come by the pose of the boat, which neighbouring points
        share, and the time in which they decay evenly, in units of their correlation time; None: not known.

    Raises
    ------
    GeometryError : coordinates that are not finite.
    """

    xyz_m: ArrayF
    sigma_horizontal_m: ArrayF
    sigma_up_m: ArrayF
    rgb: AnyArray | None = None
    pose: ArrayF | None = None

    def __post_init__(self) -> None:
        if n := len(self.xyz_m) - int(np.isfinite(self.xyz_m).all(axis=1).sum()):
            raise GeometryError(
                f"{n:,} of {len(self.xyz_m):,} points without finite coordinates",
                expected="points with three numbers",
                where="a cloud",
                cure="Leave these points out",
            )

    def part(self, keep: ArrayB | ArrayI) -> "Cloud":
        """Those points alone."""
        columns = {name: getattr(self, name) for name in self.__dataclass_fields__}
        kept: dict[str, Any] = {name: None if of is None else of[keep] for name, of in columns.items()}
        return Cloud(**kept)


def read_cloud(paths: Sequence[Path], frame: LocalFrame, crs: CRS, *, sigma_m: float) -> Cloud:
    """Points of LAS or LAZ files in wcs.

    Parameters
    ----------
    frame : wcs.
    crs : map grid of files that state neither a frame nor a grid.
    sigma_m : standard deviation of points whose file states none.

    Raises
    ------
    InputError : a file is missing, damaged, without points, or in the local frame of another origin.
    GeometryError : coordinates that do not lie in their grid.
    """
    parts = [part for path in paths for part, _ in _pieces(path, frame, crs, sigma_m)]
    if not parts:
        raise InputError("no files", expected="clouds as LAS or LAZ")
    return _joined(parts)


def read_ground(
    path: Path,
    frame: LocalFrame,
    crs: CRS,
    settings: GroundFilter,
    *,
    sigma_m: float,
    shore_m: ArrayF | None = None,
    trajectory: Trajectory | None = None,
    decay: Callable[[ArrayF], ArrayF] | None = None,
) -> tuple[Cloud, dict[str, Any]]:
    """Ground of a cloud of the boat's lidar, which is read three times: the rest of it is never held.

    The water mirrors beams: what stands within some centimetres above it has its image as far below, where no
    filter of single points tells it from noise. Left in, images are the lower envelope, and the toe of
    the bank lies above its clearance. So points below the water line near by are no ground.

    Parameters
    ----------
    path : LAZ with the numbers of echoes.
    frame, crs, sigma_m : as of `read_cloud`.
    settings : see `filter_ground`.
    shore_m : (k, 3) places of the water line in wcs; None: there is none.
    trajectory : that the cloud was made with; None: the pose's part of the errors is not told apart.
    decay : of GPS times (n,) those in which errors of the poses decay evenly, in units of their correlation
        time; None: they last.

    Returns
    -------
    Points that are ground, and what the filter tells of them.

    Raises
    ------
    InputError : as of `read_cloud` and of `filter_ground`.
    """
    shore, wet = (None if shore_m is None else (cKDTree(shore_m[:, :2]), shore_m[:, 2])), 0

    def pieces() -> Iterator[tuple[Cloud, dict[str, AnyArray]]]:
        """The cloud from its begin, piece by piece, without what lies below the water."""
        nonlocal wet
        wet = 0
        for part, chunk in _pieces(path, frame, crs, sigma_m):
            dry = _not_below(shore, part.xyz_m)
            wet += int((~dry).sum())
            yield part.part(dry), {name: chunk[name][dry] for name in _COLUMNS}

    ground = GroundOfPieces(*extremes_en_m(part.xyz_m for part, _ in pieces()), settings)
    for part, _ in pieces():
        ground.add(part.xyz_m)
    kept = []
    for part, chunk in pieces():
        is_ground = ground.take(part.xyz_m, chunk["return_number"], chunk["number_of_returns"])[0]
        part = part.part(is_ground)
        if trajectory is not None:
            t = chunk["t_gps_s"][is_ground]
            age = np.zeros(len(t)) if decay is None else decay(t)
            part = replace(part, pose=np.column_stack([_by_pose(trajectory, t, part.xyz_m), age]))
        kept.append(part)
    return _joined(kept), ground.facts() | {"below_the_water": wet}


def _not_below(shore: tuple[Any, ArrayF] | None, xyz_m: ArrayF) -> ArrayB:
    """Which points (n, 3) do not lie below the nearest place of the water line, or far from all of them."""
    dry = np.ones(len(xyz_m), dtype=np.bool_)
    if shore is not None:
        tree, up_m = shore
        low = np.flatnonzero(xyz_m[:, 2] < up_m.max())
        apart, at = tree.query(xyz_m[low, :2], distance_upper_bound=SHORE_M)
        dry[low] = ~np.isfinite(apart) | (xyz_m[low, 2] >= np.append(up_m, -np.inf)[at])
    return dry


def _by_pose(trajectory: Trajectory, t_gps_s: ArrayF, xyz_m: ArrayF) -> ArrayF:
    """Variances (n, 2), horizontal (of one axis) and up, of points in wcs by the pose of their moment."""
    at = np.searchsorted(trajectory.t_gps_s, t_gps_s).clip(max=len(trajectory.t_gps_s) - 1)
    turned = -cross_matrix(xyz_m - trajectory.position_wcs_m[at])
    J = np.concatenate([np.broadcast_to(np.eye(3), turned.shape), turned], axis=2)
    variance = np.einsum("nai,nij,naj->na", J, trajectory.cov_pose_wcs[at], J)
    return np.column_stack([variance[:, :2].mean(axis=1), variance[:, 2]])


def _joined(parts: Sequence[Cloud]) -> Cloud:
    joined: dict[str, Any] = {}
    for name in Cloud.__dataclass_fields__:
        columns = [getattr(part, name) for part in parts]
        joined[name] = None if any(c is None for c in columns) else np.concatenate(columns)
    return Cloud(**joined)


def _pieces(
    path: Path, frame: LocalFrame, crs: CRS, sigma_m: float
) -> Iterator[tuple[Cloud, dict[str, AnyArray]]]:
    """Points of a file in wcs, piece by piece, with the columns of the file."""
    header = laz_header(path)
    if not header.n_points:
        raise InputError("a cloud without points", expected="points", where=path)
    if isinstance(header.frame, LocalFrame) and header.frame != frame:
        raise InputError(
            "a cloud in the local frame of another origin",
            expected=f"the origin of this campaign, {frame.lat_deg:.6f}, {frame.lon_deg:.6f}",
            where=path,
            cure="Export it in campaign.crs",
        )
    for chunk in iter_laz(path):
        points = chunk["xyz_m"]
        if not isinstance(header.frame, LocalFrame):
            points = frame.from_map(points, header.frame or crs)
        if "sigma_up" in chunk:
            up = horizontal = np.asarray(chunk["sigma_up"], float)
            if "sigma_horizontal" in chunk:
                horizontal = np.asarray(chunk["sigma_horizontal"], float)
            elif "sigma_east" in chunk and "sigma_north" in chunk:
                horizontal = np.sqrt((chunk["sigma_east"] ** 2 + chunk["sigma_north"] ** 2) / 2)
        else:
            up = horizontal = np.full(len(points), sigma_m)
        part = Cloud(xyz_m=points, sigma_horizontal_m=horizontal, sigma_up_m=up, rgb=chunk.get("rgb"))
        yield part, chunk


# ---------------------------------------------------------------- fit


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """Motion that lays a cloud on the boat's ground.

    Parameters
    ----------
    motion : of the cloud.
    cov : (6, 6) of shift (east, north, up) and rotation vector.
    undetermined : motions that the common ground does not show, in words.
    overlap : a row a block of common ground: place, cells, median before and after, spread, sigma foretold.
    facts : for people.
    """

    motion: Motion
    cov: ArrayF
    undetermined: tuple[str, ...]
    overlap: pd.DataFrame
    facts: dict[str, Any]

    def moved(self, cloud: Cloud) -> Cloud:
        """A cloud after the motion, its sigmas grown by that of the motion."""
        points = self.motion.apply(cloud.xyz_m)
        arm = points - (self.motion.centre_m + self.motion.shift_m)
        variance = np.empty((len(points), 3))
        for axis in range(3):
            unit = np.zeros_like(arm)
            unit[:, axis] = 1.0
            rates = plane_rates(unit, arm)
            variance[:, axis] = np.einsum("ni,ij,nj->n", rates, self.cov, rates)
        return Cloud(
            xyz_m=points,
            sigma_horizontal_m=np.sqrt(cloud.sigma_horizontal_m**2 + variance[:, :2].mean(axis=1)),
            sigma_up_m=np.sqrt(cloud.sigma_up_m**2 + variance[:, 2]),
            rgb=cloud.rgb,
        )

    def write(self, path: Path) -> None:
        """Motion, covariance and facts as JSON."""
        told = {
            "centre_m": self.motion.centre_m.tolist(),
            "shift_m": self.motion.shift_m.tolist(),
            "rotation": self.motion.R.tolist(),
            "cov": self.cov.tolist(),
            "undetermined": list(self.undetermined),
            **self.facts,
        }
        path.write_text(json.dumps(told, indent=2) + "\n")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Cells:
    """One point a cell: middle (k, 3), sigma of its height (k,), normal (k, 3)."""

    xyz_m: ArrayF
    sigma_m: ArrayF
    normal: ArrayF


def fit_cloud(cloud: Cloud, ground: Cloud, settings: CloudFit, *, sigma_shared_m: float) -> Fit:
    """Lay a cloud on the ground of the banks.

    Parameters
    ----------
    cloud : of the surroundings.
    ground : of the boat, ground alone.
    settings : motion, stable areas, limits.
    sigma_shared_m : error that all heights of the ground share; it goes into the covariance of the shift.

    Raises
    ------
    CoverageError : too little common ground.
    GeometryError : the motion is too large, or the clouds do not show the same ground.
    """
    ours, theirs = _ground_cells(_stable(ground, settings), settings), _stable(cloud, settings)
    foreign = _ground_cells(_near(theirs, ours, settings), settings)
    _need(len(foreign.xyz_m), settings)
    motion = Motion(centre_m=foreign.xyz_m.mean(axis=0), R=np.eye(3), shift_m=np.zeros(3))
    tree = cKDTree(ours.xyz_m[:, :2])
    before, normal, near, arm = _distances(foreign, ours, tree, motion, settings)
    _need(int(near.sum()), settings)
    visibility, motions = visible_motions(
        foreign.xyz_m[near], plane_rates(normal[near], arm[near]), motion.centre_m
    )
    allowed = {"none": np.zeros((6, 0)), "shift": np.eye(6)[:, :3]}.get(settings.motion)
    shown = visibility >= LEAST_VISIBLE
    free = motions[:, shown] if allowed is None else allowed
    # what a campaign excludes (none, shift) counts as none; what the ground does not show does not
    hidden = motions[:, ~shown] if allowed is None else np.zeros((6, 0))
    distance = before
    if free.shape[1]:
        for _ in range(MOST_ITERATIONS):
            d, design = distance[near], plane_rates(normal[near], arm[near]) @ free
            weight = tukey(d)
            step = (
                free
                @ np.linalg.lstsq(
                    design.T @ (weight[:, None] * design), -design.T @ (weight * d), rcond=1e-10
                )[0]
            )
            motion = motion.followed_by(*np.split(step, 2))
            _refuse_large(motion, settings)
            distance, normal, near, arm = _distances(foreign, ours, tree, motion, settings)
            _need(int(near.sum()), settings)
            if np.linalg.norm(step[:3]) + np.linalg.norm(step[3:]) * np.ptp(foreign.xyz_m[:, :2]) < STEP_M:
                break
    spread = NMAD * float(np.median(np.abs(distance[near] - np.median(distance[near]))))
    if spread > settings.largest_spread_m:
        raise GeometryError(
            f"after the fit both clouds differ by {spread:.2f} m (robust standard deviation)",
            expected=f"at most fusion.fit.largest_spread_m = {settings.largest_spread_m:g} m",
            where="logs.uav",
            cure="Draw bare ground as fusion.fit.stable: plants and new ground make clouds differ",
        )
    cov, blocks = _covariance(foreign, distance, normal, near, arm, free, settings)
    cov[:3, :3] += (sigma_shared_m**2) * _held(free)
    # about the place where each of them moves the points by an RMS of 1 m
    cov += settings.sigma_datum_m**2 * hidden @ hidden.T
    block = cell_numbers(foreign.xyz_m[:, :2], settings.block_m)
    overlap = _overlap(foreign, ours, tree, before, distance, near, block)
    facts = {
        "cells": int(near.sum()),
        "blocks": blocks,
        "shift_m": motion.shift_m.tolist(),
        "rotation_deg": np.rad2deg(Rotation.from_matrix(motion.R).as_rotvec()).tolist(),
        "sigma_shift_m": np.sqrt(np.diag(cov)[:3]).tolist(),
        "sigma_rotation_deg": np.rad2deg(np.sqrt(np.diag(cov)[3:])).tolist(),
        "median_before_m": float(np.median(before[np.isfinite(before)])),
        "median_after_m": float(np.median(distance[near])),
        "spread_after_m": spread,
    }
    facts["fitted_shift_m"] = facts.pop("shift_m")
    if hidden.size:
        facts["sigma_left_alone_m"] = settings.sigma_datum_m
    return Fit(motion=motion, cov=cov, undetermined=motions_in_words(hidden), overlap=overlap, facts=facts)


def _stable(cloud: Cloud, settings: CloudFit) -> Cloud:
    if settings.stable is None:
        return cloud
    inside = np.zeros(len(cloud.xyz_m), dtype=np.bool_)
    for corners in settings.stable:
        inside |= Area(polygon_en_m=np.asarray(corners, float)).contains(cloud.xyz_m)
    return cloud.part(inside)


def _near(cloud: Cloud, ours: _Cells, settings: CloudFit) -> Cloud:
    """Points of a cloud above or beside the cells of the boat's ground."""
    if not len(ours.xyz_m):
        return cloud.part(np.zeros(len(cloud.xyz_m), dtype=np.bool_))
    reach = settings.largest_shift_m + settings.cell_m
    distance = cKDTree(ours.xyz_m[:, :2]).query(cloud.xyz_m[:, :2], distance_upper_bound=reach)[0]
    return cloud.part(np.isfinite(distance))


def _ground_cells(cloud: Cloud, settings: CloudFit) -> _Cells:
    """The mean of the points of each cell, and a normal from the cells about it."""
    if not len(cloud.xyz_m):
        return _Cells(xyz_m=np.zeros((0, 3)), sigma_m=np.zeros(0), normal=np.zeros((0, 3)))
    key = cell_numbers(cloud.xyz_m[:, :2], settings.cell_m)
    order = np.argsort(key, kind="stable")
    n = np.bincount(key)
    start = np.concatenate([[0], np.cumsum(n)[:-1]])
    mean = np.add.reduceat(cloud.xyz_m[order], start, axis=0) / n[:, None]
    variance = np.add.reduceat(cloud.sigma_up_m[order] ** 2, start) / n
    near = cKDTree(mean[:, :2]).query(mean[:, :2], k=min(NEIGHBOURS, len(mean)))[1].reshape(len(mean), -1)
    around = mean[near] - mean[near].mean(axis=1, keepdims=True)
    normal = np.linalg.eigh(np.einsum("kij,kil->kjl", around, around))[1][:, :, 0]
    normal *= np.where(normal[:, 2:] < 0, -1.0, 1.0)
    return _Cells(xyz_m=mean, sigma_m=np.sqrt(variance), normal=normal)


def _distances(
    foreign: _Cells, ours: _Cells, tree: Any, motion: Motion, settings: CloudFit
) -> tuple[ArrayF, ArrayF, ArrayB, ArrayF]:
    """Distance of each foreign cell along the normal of our nearest one, that normal, near, and the arm."""
    moved = motion.apply(foreign.xyz_m)
    apart, at = tree.query(moved[:, :2], distance_upper_bound=1.5 * settings.cell_m)
    near = np.isfinite(apart)
    at = np.where(near, at, 0)
    normal = ours.normal[at]
    distance = np.einsum("ni,ni->n", moved - ours.xyz_m[at], normal)
    # far off along the normal lies another thing: a crown, a roof, the water
    near &= np.abs(distance) <= settings.largest_shift_m + settings.cell_m
    arm = moved - (motion.centre_m + motion.shift_m)
    return np.where(near, distance, np.nan), normal, near, arm


def _need(n: int, settings: CloudFit) -> None:
    if n < LEAST_CELLS:
        raise CoverageError(
            f"{n} cells of {settings.cell_m:g} m of ground that both clouds have",
            expected=f"at least {LEAST_CELLS}",
            where="logs.uav",
            cure="Does the cloud cover the banks, in grid and ellipsoidal heights of the campaign? A "
            "cloud with orthometric heights lies metres off",
        )


def _refuse_large(motion: Motion, settings: CloudFit) -> None:
    size = float(np.linalg.norm(motion.shift_m))
    if size > settings.largest_shift_m:
        raise GeometryError(
            f"the cloud lies {size:.2f} m off the ground of the banks",
            expected=f"at most fusion.fit.largest_shift_m = {settings.largest_shift_m:g} m",
            where="logs.uav",
            cure="Look at datum, grid and heights of the cloud; a larger limit takes the motion as it is",
        )


def _covariance(
    foreign: _Cells,
    distance: ArrayF,
    normal: ArrayF,
    near: ArrayB,
    arm: ArrayF,
    free: ArrayF,
    settings: CloudFit,
) -> tuple[ArrayF, int]:
    if not free.shape[1]:
        return np.zeros((6, 6)), 0
    block = cell_numbers(foreign.xyz_m[near, :2], settings.block_m)
    blocks = int(block.max()) + 1
    p = free.shape[1]
    if blocks < p + 3:
        raise CoverageError(
            f"common ground in {blocks} blocks of {settings.block_m:g} m",
            expected=f"at least {p + 3} for the covariance of {p} parameters",
            where="fusion.fit",
            cure="Set fusion.fit.motion to shift, or a smaller fusion.fit.block_m if errors last less",
        )
    d, design = distance[near], plane_rates(normal[near], arm[near]) @ free
    psi, slope = tukey(d) * d, tukey_slope(d)
    score = np.stack([np.bincount(block, weights=psi * c) for c in design.T], axis=1).astype(float)
    curvature = np.empty((blocks, p, p))
    for i in range(p):
        for j in range(p):
            curvature[:, i, j] = np.bincount(block, weights=slope * design[:, i] * design[:, j])
    cov = jackknife(score, curvature)
    if cov is None:
        raise CoverageError(
            "a motion rests on one block of common ground alone",
            expected="ground on both banks or along the river",
            where="fusion.fit",
            cure="Set fusion.fit.motion to shift",
        )
    return np.asarray(free @ cov @ free.T), blocks


def _held(free: ArrayF) -> ArrayF:
    """Vertical part (3, 3) of a shared height error that the fit takes over; zero without a fit."""
    return np.diag([0.0, 0.0, 1.0]) if free.shape[1] else np.zeros((3, 3))


def _overlap(
    foreign: _Cells, ours: _Cells, tree: Any, before: ArrayF, after: ArrayF, near: ArrayB, block: ArrayI
) -> pd.DataFrame:
    at = tree.query(foreign.xyz_m[:, :2])[1]
    sigma = np.hypot(foreign.sigma_m, ours.sigma_m[at])
    rows = []
    for number in np.unique(block[near]):
        here = near & (block == number)
        d = after[here]
        middle = float(np.median(d))
        rows.append(
            {
                "east_m": float(foreign.xyz_m[here, 0].mean()),
                "north_m": float(foreign.xyz_m[here, 1].mean()),
                "cells": int(here.sum()),
                "median_before_m": float(np.nanmedian(before[here]))
                if np.isfinite(before[here]).any()
                else np.nan,
                "median_after_m": middle,
                "nmad_m": NMAD * float(np.median(np.abs(d - middle))),
                "sigma_foretold_m": root_mean_square(sigma[here]),
            }
        )
    return pd.DataFrame(rows)


# ---------------------------------------------------------------- one cloud


def cloud_of_bed(bed: Path, frame: LocalFrame) -> Cloud:
    """Cells of the riverbed that have a height as points: their centres, in wcs.

    Parameters
    ----------
    bed : ``bed.tif``.
    frame : wcs.
    """
    grid, bands, _ = read_raster(bed)
    height, sigma = (bands[name].ravel() for name in ("height_m", "sigma_m"))
    known = np.isfinite(height)
    places = np.column_stack([grid.centres_m()[known], height[known]])
    up = np.hypot(sigma, bands["sigma_common_m"].ravel())[known]
    # a cell stands for all places in it
    across = np.full(len(places), grid.cell_m / np.sqrt(12.0))
    return Cloud(xyz_m=frame.from_map(places, grid.crs), sigma_horizontal_m=across, sigma_up_m=up)


def join_clouds(path: Path, parts: Iterable[tuple[Source, Cloud]], frame: LocalFrame) -> dict[str, int]:
    """Write all clouds as one LAZ with source and sigmas; returns points by source.

    Parameters
    ----------
    path : target, ``.laz``.
    parts : source and points of each, wcs.
    frame : wcs.

    Raises
    ------
    InputError : no points at all, or sigmas that are not finite.
    """
    counts: dict[str, int] = {}
    with LazWriter(path, frame, extra_dimensions=EXTRA_DIMENSIONS) as writer:
        for source, cloud in parts:
            n = len(cloud.xyz_m)
            if not n:
                continue
            if not (np.isfinite(cloud.sigma_up_m).all() and np.isfinite(cloud.sigma_horizontal_m).all()):
                raise InputError(
                    f"sigmas of '{SOURCE_WORDS[source]}' that are not finite",
                    expected="a sigma for each point",
                )
            rgb = np.zeros((n, 3), np.uint16) if cloud.rgb is None else cloud.rgb
            writer.append(
                cloud.xyz_m,
                rgb=rgb,
                classification=np.full(n, 9 if source in (Source.BED, Source.LIGHT_SHEET) else 2, np.uint8),
                point_source_id=np.full(n, int(source), np.uint16),
                extra={"sigma_horizontal": cloud.sigma_horizontal_m, "sigma_up": cloud.sigma_up_m},
            )
            counts[SOURCE_WORDS[source]] = counts.get(SOURCE_WORDS[source], 0) + n
        if not counts:
            raise InputError("no cloud has points", expected="at least one of bed, banks, surroundings")
    return counts


def joined_parts(path: Path) -> Mapping[Source, Cloud]:
    """Clouds of a file of `join_clouds` by source.

    Raises
    ------
    InputError : no such file, or one without sources and sigmas.
    """
    if "sigma_up" not in laz_header(path).extra_dimensions:
        raise InputError("a cloud without sigmas", expected="a file of join_clouds", where=path)
    chunks = list(iter_laz(path))
    source = np.concatenate([c["point_source_id"] for c in chunks])
    whole = Cloud(
        xyz_m=np.concatenate([c["xyz_m"] for c in chunks]),
        sigma_horizontal_m=np.concatenate([c["sigma_horizontal"] for c in chunks]),
        sigma_up_m=np.concatenate([c["sigma_up"] for c in chunks]),
    )
    return {Source(int(k)): whole.part(source == k) for k in np.unique(source)}
