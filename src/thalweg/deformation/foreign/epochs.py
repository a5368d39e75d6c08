r"""Epochs from elsewhere: clouds and surface models with a date, in the frame of all epochs.

Of their errors is known what somebody states: a standard deviation that neighbouring points share, and how
far (`SpatialErrors`). They have no trajectory: nothing is known of what they could have seen.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from pyproj import CRS

from thalweg.core import (
    AnyArray,
    ArrayF,
    ArrayI,
    CoverageError,
    Dsm,
    Frame,
    InputError,
    LocalFrame,
    gps_from_unix,
    laz_header,
    mask_missing,
    read_dsm,
    read_json,
)
from thalweg.core.values import Vectors, heights_in_words, horizontal_of, read_vectors, same_heights
from thalweg.deformation import (
    COMMON,
    ColumnIndex,
    Epoch,
    ErrorField,
    ErrorGroup,
    SpatialErrors,
    between_frames,
    place_in_cells,
    pose_weights,
    rows_of_weights,
)
from thalweg.deformation.foreign.clouds import ROUGHNESS_ALONE, Points, density_notes, read_points
from thalweg.deformation.foreign.surfaces import HeightErrors, one_frame, onto_map
from thalweg.ingest.clouds import to_world
from thalweg.settings import utm_code
from thalweg.settings.sections import DSM_ENDINGS, Deformation, Epoch as Statement
from thalweg.surface import Area

log = logging.getLogger("thalweg")

# ---------------------------------------------------------------- epochs

KIND: Final = "files"
"""Of epochs from elsewhere, in ``errors.json``."""
STATED, UNKNOWN = "stated", "not stated"
"""Groups of errors."""
_LAS: Final = (".las", ".laz")


@dataclass(frozen=True, slots=True, kw_only=True)
class ForeignEpoch(Epoch):
    """Points of files in the frame of all epochs; its "moments" are cells of the plan.

    Attributes
    ----------
    statement : ``heights`` (system, in words), ``notes`` (sentences for the reader), ``sigma_known``,
        ``is_raster``, ``whole``: nothing was left out by polygons.
    """

    statement: Mapping[str, Any]

    @property
    def is_raster(self) -> bool:
        """Whether it is a raster of heights, which shows no shift in plan."""
        return bool(self.statement["is_raster"])

    @property
    def heights(self) -> str:
        """System of heights, in words."""
        return str(self.statement["heights"])

    @property
    def notes(self) -> tuple[str, ...]:
        """What was assumed and left out."""
        return tuple(self.statement["notes"])

    @property
    def sigma_known(self) -> bool:
        """Whether errors that points share are stated."""
        return bool(self.statement["sigma_known"])

    def field(
        self, cores_m: ArrayF, normals: ArrayF, index: ColumnIndex, *, radius_m: float, half_length_m: float
    ) -> ErrorField:
        """Shared errors of the mean positions along normals of `thalweg.deformation.m3c2.cut_cylinders`."""
        m = len(self.t_s)
        how = {"radius_m": radius_m, "half_length_m": half_length_m}
        weights = pose_weights(cores_m, normals, index, self.moment, np.zeros((m, 3)), **how)
        rows = rows_of_weights(weights, weights.shift, m)
        return ErrorField(self.groups, (rows,) * len(self.groups))

    def report(self) -> dict[str, Any]:
        """Facts about the epoch and its errors, for people and for `read`."""
        return {"kind": KIND, **Epoch.report(self), **self.statement}

    @staticmethod
    def stated(facts: Mapping[str, Any]) -> dict[str, Any]:
        """What was stated of its files."""
        names = ("heights", "notes", "sigma_known", "is_raster", "whole")
        return {"statement": {key: facts[key] for key in names}}


def read_epoch(folder: Path) -> Epoch:
    """A prepared epoch, of a survey or of files, by its ``errors.json``."""
    kind = read_json(folder / "errors.json").get("kind")
    return ForeignEpoch.read(folder) if kind == KIND else Epoch.read(folder)


def notes_of_pair(
    before: Epoch, after: Epoch, n: ArrayI, registration: Mapping[str, Any] | None = None
) -> list[str]:
    """What a reader of a comparison has to know: assumptions, motions, unknown sigmas, densities.

    Parameters
    ----------
    n : (k, 2) points of both epochs in the cylinders.
    registration : facts of `thalweg.deformation.Registration`.
    """
    facts = registration or {}
    notes = [f"{epoch.name}: {note}" for epoch in (before, after) for note in epoch.notes]
    whole = [
        each.name for each in (before, after) if isinstance(each, ForeignEpoch) and each.statement["whole"]
    ]
    if whole:
        notes.append(
            f"Nothing is left out of {' and '.join(whole)} by polygons (leave_out): water, breaking waves, "
            "plants, cars and holes that a program filled count as ground."
        )
    if "would_be" in facts:
        moved = facts["would_be"]
        words = ", ".join(f"{axis} {moved[f'{axis}_m']:+.3f} m" for axis in ("east", "north", "up"))
        notes.append(
            "No stable ground is drawn (deformation.stable), so that no offset was removed: the majority of "
            f"a surface may have changed. It suggests {words}; the epochs may differ by it as a whole. "
            + (
                "Sigmas and intervals hold what is stated of that (sigma_common_m)."
                if facts["whole_stated"]
                else f"Sigmas and intervals hold {facts['sigma_as_a_whole_m'][2]:.3f} m of one error of all "
                "heights: this offset, the scatter of all differences, and stated sigmas. Draw stable "
                "ground, or state sigma_common_m of both epochs."
            )
        )
    unknown = [epoch.name for epoch in (before, after) if not epoch.sigma_known]
    if unknown and "estimated" in facts and facts["sigma"] == "estimated":
        found = facts["estimated"]
        notes.append(
            f"No sigma is stated of {' and '.join(unknown)}. Stable ground shows {found['sigma_m']:.3f} m of "
            f"an epoch, alike over {found['correlation_m']:.2g} m, which counts instead."
        )
    elif unknown:
        notes.append(f"No sigma is stated of {' and '.join(unknown)}. {ROUGHNESS_ALONE}")
    return notes + density_notes(n)


def with_drawn_areas(settings: Deformation, frame: LocalFrame, crs: str) -> Deformation:
    """Settings whose stable ground is polygons of the local frame, of the file that they name.

    Lines and points are as wide as a quarter of a cell of core points.

    Parameters
    ----------
    frame : of all epochs; crs : map grid of the campaign.

    Raises
    ------
    InputError : the file cannot be read, lies elsewhere, or has an area with a hole.
    """
    if not isinstance(settings.stable, str):
        return settings
    drawn = read_vectors(settings.stable).on_map(CRS.from_user_input(crs))
    for note in drawn.notes:
        log.warning("deformation.stable: %s", note)
    half_m = 0.25 * settings.core_spacing_m / np.sqrt(2.0)
    areas = [each if each.geom_type == "Polygon" else each.buffer(half_m) for each in drawn.table.geometry]
    if any(area.interiors for area in areas):
        raise InputError(
            "stable ground with a hole", expected="polygons without holes", where=settings.stable,
            cure="Cut the polygon in two through the hole",
        )  # fmt: skip
    corners = []
    for area in areas:
        plan = np.asarray(area.exterior.coords)[:-1, :2]
        in_map = np.column_stack([plan, np.full(len(plan), frame.h_ell_m)])
        local = to_world(in_map, CRS.from_user_input(crs), frame, crs, Path(settings.stable))[0]
        corners.append([(float(east), float(north)) for east, north in local[:, :2]])
    return settings.replace(stable=corners)


# ---------------------------------------------------------------- from files


@dataclass(frozen=True, slots=True)
class _Heights:
    """Points (n, 3) of the world frame, standard deviations (n,) or None, system of heights, notes."""

    xyz_m: ArrayF
    sigma_m: ArrayF | None
    common_m: ArrayF | None
    heights: str
    notes: list[str]


def prepare_foreign_epoch(
    name: str,
    stated: Statement,
    *,
    frame: LocalFrame,
    crs: str,
    area: Area,
    margin_m: float,
    start_gps_s: float | None = None,
) -> ForeignEpoch:
    """Points of a cloud or surface model and their stated errors, in the frame of all epochs.

    Parameters
    ----------
    name : of the epoch.
    stated : files, date, map grid, sigma and correlation length.
    frame : of all epochs; crs : map grid of the campaign, of files that state none.
    area : points farther outside than ``margin_m`` are left out.
    start_gps_s : time of the survey where ``stated`` has no date.

    Raises
    ------
    InputError : files that cannot be read, are empty, state another grid, or hold values that may be no
        heights; no date.
    GeometryError : files that lie elsewhere.
    CoverageError : no point lies in the area.
    """
    moment = stated.moment_utc
    if moment is None and start_gps_s is None:
        raise InputError("no date", expected="date_utc: the day of the survey", where=f"epochs, {name}",
                         cure="Write date_utc")  # fmt: skip
    time_s = float(gps_from_unix(moment.timestamp())) if moment is not None else float(start_gps_s or 0.0)
    masks = masks_of(stated)
    if stated.dsm is not None:
        files: list[Points | Dsm] = [dsm_of(stated)]
    else:
        files = [read_points(Path(path)) for path in stated.clouds]
    parts = [_heights(file, stated, frame, crs, masks) for file in files]
    heights = sorted({part.heights for part in parts})
    if len(heights) > 1:
        raise InputError(f"files with heights {' and '.join(heights)}", expected="one system of heights",
                         where=f"epochs, {name}", cure="Transform one of them")  # fmt: skip
    xyz = np.concatenate([part.xyz_m for part in parts])
    low, high = area.box(margin_m)
    near = ((xyz >= low) & (xyz <= high)).all(axis=1)
    if not near.any():
        middle = np.median(xyz, axis=0)
        raise CoverageError(
            f"none of {len(xyz):,} points lies in deformation.area; their middle is at east {middle[0]:.1f}, "
            f"north {middle[1]:.1f}, height {middle[2]:.1f} m",
            where=f"epochs, {name}",
            expected="an area that the survey covers",
            cure="Check the polygon and its frame, crs and heights of the files, and campaign.origin",
        )
    xyz = xyz[near]
    first = parts[0]  # of several files all are clouds, whose sigma is one number
    banded = None if first.sigma_m is None else first.sigma_m[near]
    common = None if first.common_m is None else first.common_m[near]
    groups, node, white = _errors(xyz, stated, banded, common)
    m = len(groups[0].root)
    return ForeignEpoch(
        name=name,
        start_gps_s=time_s,
        xyz_m=xyz,
        moment=node,
        white_m2=white.astype(np.float32),
        several_returns=np.zeros(len(xyz), dtype=np.bool_),
        t_s=np.zeros(m),
        boat_m=np.empty((0, 3)),
        scanner_m=np.empty((0, 3)),
        groups=groups,
        levers=np.empty((2, 0, 3, 3)),
        water_m=np.empty(0),
        statement={
            "heights": heights[0],
            "notes": [note for part in parts for note in part.notes],
            "sigma_known": stated.sigma_m is not None or banded is not None,
            "is_raster": stated.dsm is not None,
            "whole": not masks and banded is None,
        },
    )


def check_epoch_files(stated: Statement, frame: LocalFrame, crs: str) -> None:
    """What can be known of the files of an epoch before anything is computed, by the code that reads them.

    Surface models and masks are read as a whole, of LAS and LAZ the headers.

    Raises
    ------
    InputError, GeometryError : as `prepare_foreign_epoch`.
    """
    masks = masks_of(stated)
    if stated.dsm is not None:
        _heights(dsm_of(stated), stated, frame, crs, masks)
    for path in map(Path, stated.clouds):
        if path.suffix.lower() in _LAS:
            header = laz_header(path)
            if not header.n_points:
                raise InputError("a cloud without points", expected="the points of a survey", where=path,
                                 cure="Export it again, or name another file")  # fmt: skip
            if not (isinstance(header.frame, CRS) and header.frame.is_geographic):  # that becomes UTM
                _grid_of(header.frame, stated, crs, path)


def place_of_file(
    path: Path, origin: tuple[float, float, float] | None = None
) -> tuple[str, tuple[float, float, float]]:
    """Map grid and origin (latitude, longitude, degrees; ellipsoidal height, m) for a campaign of files.

    Parameters
    ----------
    origin : as stated; None: the middle of the file.

    Raises
    ------
    InputError : the file cannot be read, or has neither a grid nor a stated origin.
    """
    if path.suffix.lower() in DSM_ENDINGS:
        dsm = read_dsm(path, nodata=float("nan"))
        points, file = dsm.points_m(), dsm.frame
    else:
        cloud = read_points(path)
        points, file = cloud.xyz_m, cloud.frame
    if isinstance(file, LocalFrame):
        origin = origin or (file.lat_deg, file.lon_deg, file.h_ell_m)
        file = None
    if origin is None:
        if file is None:
            raise InputError(
                "no grid is stated", expected="a file with the coordinate system of its points", where=path,
                cure="State --origin LAT_DEG LON_DEG H_ELL_M, a point near the survey",
            )  # fmt: skip
        anywhere = LocalFrame(lat_deg=0.0, lon_deg=0.0, h_ell_m=0.0)
        lat, lon, h = anywhere.to_geodetic(anywhere.from_map(np.median(points, axis=0)[None], file)[0])
        origin = (round(float(lat), 4), round(float(lon), 4), round(float(h)))
    horizontal = None if file is None else horizontal_of(file)
    code = None if horizontal is None else horizontal.to_epsg()
    return (utm_code(*origin[:2]) if code is None else f"EPSG:{code}"), origin


def masks_of(stated: Statement) -> list[Vectors]:
    """Polygons that are left out of an epoch."""
    return [read_vectors(text) for text in stated.leave_out]


def dsm_of(stated: Statement) -> Dsm:
    """The surface model of an epoch."""
    return read_dsm(Path(str(stated.dsm)), nodata=_nodata(stated))


def _nodata(stated: Statement) -> float | None:
    return float("nan") if stated.nodata == "none" else stated.nodata


def _grid_of(file: Frame, stated: Statement, crs: str, path: Path) -> tuple[Frame, str, list[str]]:
    """Frame of a file's coordinates, its system of heights in words, and what was assumed.

    Raises
    ------
    InputError : the file states another grid or other heights than the campaign file says of it.
    """
    if isinstance(file, LocalFrame):
        return file, "ellipsoidal", []
    said = None if stated.crs is None else CRS.from_user_input(stated.crs)
    if file is not None and said is not None:
        a, b = horizontal_of(file), horizontal_of(said)
        found = (
            f"{a.name}, the campaign file {b.name}"
            if not a.equals(b, ignore_axis_order=True)
            else ""
            if same_heights(file, said)
            else f"heights {heights_in_words(file)}, the campaign file {heights_in_words(said)}"
        )
        if found:
            raise InputError(
                f"the file states {found}",
                expected="one of them to be right",
                where=path,
                cure="Correct crs in the campaign file, or the file",
            )
    grid = file or said or CRS.from_user_input(crs)
    notes = [] if file is not None or said is not None else [f"{path.name} states no grid: taken as {crs}."]
    heights = heights_in_words(file) or heights_in_words(said)
    if not heights and stated.crs is None:
        notes.append(f"{path.name} states no system of heights: taken as ellipsoidal.")
    return grid, heights or "ellipsoidal", notes


def _heights(
    file: Points | Dsm, stated: Statement, frame: LocalFrame, crs: str, masks: Sequence[Vectors]
) -> _Heights:
    """Points of a cloud, or centres of the cells of a raster that have a height, in the world frame."""
    path, sigma, common = file.path, None, None
    masked: tuple[str, ...] = ()
    masks = onto_map(masks, file.frame)
    grid, heights, notes = _grid_of(file.frame, stated, crs, path)
    notes += one_frame([file, *masks])[1] if masks else []
    if isinstance(file, Dsm):
        plan, z = file.centres_m(), file.height_m.ravel()
        if stated.sigma_m is None and HeightErrors.of_bands(file, stated.correlation_m) is not None:
            sigma, common = (None if each is None else each.ravel() for each in (file.sigma_m, file.common_m))
    else:
        plan, z = file.xyz_m[:, :2], file.xyz_m[:, 2]
        # a height of zero is one height among others where there are heights about it
        gap = 2 * int((z == 0.0).sum()) > int((np.abs(z) < 1.0).sum())
        z, masked = mask_missing(z, path, "points", nodata=_nodata(stated), zeros=gap)
    keep = np.isfinite(z)
    words = [note for mask in masks for note in mask.notes]
    if masks:
        out = np.any([mask.contain(plan) for mask in masks], axis=0)
        keep &= ~out
        words.insert(0, f"{path.name}: {out.sum():,} of {len(plan):,} points left out by polygons.")
    if sigma is not None:
        unknown = keep & ~np.isfinite(sigma)
        keep &= ~unknown
        if unknown.any():
            words.append(f"{path.name}: {unknown.sum():,} cells without a standard deviation left out.")
    xyz = np.column_stack([plan, z])[keep]
    if not len(xyz):
        raise InputError(
            "no point is left", expected="points outside of the polygons of leave_out", where=path,
            cure="Check which polygons are meant (FILE?COLUMN=VALUE)",
        )  # fmt: skip
    if isinstance(grid, LocalFrame):
        turn, shift = between_frames(grid, frame)
        xyz = xyz @ turn.T + shift
    else:
        xyz = to_world(xyz, grid, frame, crs, path)[0]
    bands = [None if band is None else band[keep] for band in (sigma, common)]
    return _Heights(xyz, bands[0], bands[1], heights, [*masked, *file.notes, *words, *notes])


def _errors(
    xyz_m: ArrayF, stated: Statement, banded: ArrayF | None, common: ArrayF | None
) -> tuple[tuple[SpatialErrors | ErrorGroup, ...], ArrayI, ArrayF]:
    """Groups of shared errors, node (n,) of each point, and noise (n, 6) of single points."""
    white = np.zeros((len(xyz_m), 6))
    length = stated.correlation_m or 0.0
    shares = length > 0
    axes = np.array([0.0, 0.0, 1.0]) if stated.dsm is not None else np.ones(3)
    sigma: AnyArray = np.zeros(len(xyz_m))
    if stated.sigma_m is not None:
        sigma = np.full(len(xyz_m), stated.sigma_m)
    elif banded is not None:
        sigma = banded
    if not shares:  # noise of single points, which the cylinders average; unknown errors have no size
        white[:, [0, 3, 5]] = sigma[:, None] ** 2 * axes
    extent = max(float(np.ptp(xyz_m[:, :2], axis=0).max()), 1.0)
    length = length if shares else extent
    node, cell, cell_m = place_in_cells(xyz_m[:, :2], length)
    n = np.bincount(node)
    of_node = np.sqrt(np.bincount(node, sigma**2) / n) if shares else np.zeros(len(cell))
    root = of_node[:, None, None] * np.diag(axes)
    known = stated.sigma_m is not None or banded is not None
    groups: list[SpatialErrors | ErrorGroup] = [
        SpatialErrors(STATED if known else UNKNOWN, cell, cell_m, root, length)
    ]
    if stated.sigma_common_m is not None:
        common = np.full(len(xyz_m), stated.sigma_common_m)
    if common is not None:
        of_all = np.bincount(node, np.nan_to_num(common)) / n
        groups.append(ErrorGroup(COMMON, np.zeros(len(cell)), of_all[:, None, None] * np.diag(axes), np.inf))
    return tuple(groups), node, white
