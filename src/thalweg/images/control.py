"""Control points in files and in images: tables of people and programs, boards that are measured.

Read are CSV tables with named columns, the CSV of Metashape's reference pane, its XML of markers, and the
``gcp_list.txt`` of OpenDroneMap. Pixels of Metashape and of our own tables count from the upper left corner;
those of OpenDroneMap from the centre of the first pixel (OpenSfM adds the half when it normalises), so half a
pixel is added.
"""

import contextlib
import logging
import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

import numpy as np
import pandas as pd
from pyproj import CRS
from pyproj.exceptions import CRSError

from thalweg.calibration import fit_saddles
from thalweg.core import (
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayU8,
    GeometryError,
    InputError,
    LocalFrame,
    ellipsoid_of,
    optional,
    parse_xml,
    rows_of,
)
from thalweg.core.values import FORMS, HUGE, in_metres, is_nothing, is_vector_file, near_world, world_of
from thalweg.images.model import (
    ControlMarks,
    ControlPoints,
    ImageBlock,
    Similarity,
    at_pixels,
    matched,
    nearest_to_rays,
    robust_similarity,
)
from thalweg.ingest import NAMES as WORDS, Table, read_places, read_text, read_text_table
from thalweg.settings.sections import LOCAL, ControlSettings

cv2 = optional("cv2")

_ROLES: Final = {
    "": False, "control": False, "control point": False, "gcp": False, "ground control point": False,
    "check": True, "check point": True, "checkpoint": True, "validation": True,
}  # fmt: skip
"""Words for control (false) and check points (true), small letters."""
_FLAGS: Final = {
    **dict.fromkeys(("true", "1", "yes", "y", "on", "x"), True),
    **dict.fromkeys(("false", "0", "no", "n", "off"), False),
}
"""Words of a cell that answers yes or no, small letters."""
_NAMED: Final = 5
"""Names that a message lists."""
_OF_SIGMA: Final = ("sigma", "std", "sd", "stdev", "stddev", "std_dev", "rms", "rmse")
_OF_PLANE: Final = (
    "accuracy_horizontal",
    "horizontal_accuracy",
    "rms_horizontal",
    "horizontal_rms",
    "lateral_rms",
    "sigma_horizontal",
    "hrms",
    "h_rms",
)
"""Standard deviations of east and north alike."""


def _sigma_names(*axes: str) -> tuple[str, ...]:
    """Words by which a column of standard deviations along an axis is known, without their unit."""
    pairs = [(word, axis) for axis in axes for word in ("accuracy", *_OF_SIGMA, "s")]
    glued = [f"{word}{axis}" for word, axis in pairs if len(axis) == 1 and len(word) < 6]
    return (
        *(f"{a}_{b}" for pair in pairs for a, b in (pair, pair[::-1])),
        *glued,
        *(f"{a}rms" for a in "v" if a in axes),
    )


NAMES: Final[Mapping[str, tuple[str, ...]]] = {
    "id": ("id", "label", "name", "point", "gcp", "marker", "gcp_name", "point_id", "pointid", "punkt", "nr"),
    "image": ("image", "photo", "camera", "image_name", "imagename", "file", "filename", "camera_label"),
    "point": ("point", "gcp", "marker", "label", "id", "gcp_name", "marker_label"),
    "x_px": ("x_px", "u", "u_px", "im_x", "image_u", "x"),
    "y_px": ("y_px", "v", "v_px", "im_y", "image_v", "y"),
    "sigma_px": ("sigma_px", "accuracy_px", "sigma_x_px"),
    "east_m": ("east_m",),
    "north_m": ("north_m",),
    "up_m": ("up_m",),
    "lat_deg": ("lat_deg", *WORDS["lat"].split()),
    "lon_deg": ("lon_deg", *WORDS["lon"].split()),
    "h_ell_m": ("h_ell_m", "h_m", "ellipsoidal_height", "ell_height", "h_ell", *WORDS["height"].split()),
    "x": ("x", *WORDS["east"].split()),
    "y": ("y", *WORDS["north"].split()),
    "z": ("z", *WORDS["height"].split()),
    "sigma_east_m": (*_sigma_names("east", "x", "e", "easting"), *_OF_PLANE),
    "sigma_north_m": (*_sigma_names("north", "y", "n", "northing"), *_OF_PLANE),
    "sigma_up_m": _sigma_names("up", "z", "v", "vertical", "u", "elevation", "altitude", "height", "h"),
    "accuracy": ("accuracy", "accuracy (m)", "accuracy_x/y/z", *_OF_SIGMA),
    "role": ("role", "type"),
    "used": ("used", "use", "enabled", "enable", "active", "control", "is_control"),
    "check": ("check", "is_check", "checkpoint", "check_point"),
}
"""Headings, in small letters, by which a column is known."""
_SIGMAS: Final = ("sigma_east_m", "sigma_north_m", "sigma_up_m")
_LIKE_SIGMA: Final = re.compile(
    r"(?:^|_)(?:sigma|std|stdev|stddev|standard|rms|rmse|accuracy|precision)(?:_|$)"
)
log = logging.getLogger("thalweg")
_LEAST_PX: Final = 2.0
"""No picture has all of its marks in its first pixels."""
_TEXTS: Final = {"id", "image", "point", "role", "used", "check"}
"""Columns that hold names and words, also where they look like numbers."""
LINE: Final = "line"
"""Key of a row under which the number of its line stands."""
Loader = Callable[[str], "ArrayU8 | None"]
"""Grey values (h, w) of an image by its name; None if there are none."""
COLUMNS: Final = ("image", "point", "x_px", "y_px", "sigma_px", "score", "used", "reason")
_BREADTHS: Final = (1.0, 0.75, 0.5)
"""Breadths of the templates: a board turned by 0, 41 and 60 degrees about its vertical."""
_REACH_MODULES: Final = 0.85
_CANDIDATES: Final = 3
_AGREE_MODULES: Final = 0.35
"""How far a candidate may be from where the others put the point, modules."""
_AGREE_PX: Final = 1.5
_NARROW_MODULES: Final = 0.7
_NARROW_PX: Final = 3.0
_DIFFER_MODULES: Final = 0.8
_CLEAR: Final = 0.05
"""Correlation by which the best place is better than the next."""
_FLOOR_PX: Final = 0.1
"""What the fit cannot see of a board of 8 to 30 pixels, to begin with: the adjustment estimates the size of
these errors from the block where its marks have enough redundancy (``control_scale`` of
`thalweg.images.bundle.adjustment`). A cautious value for a few marks in moving pictures: photographs of a
standing board made as small have 0.024 px (`tests/calibration/test_saddles.py`), three rendered blocks 0.05
to 0.06."""


# ---------------------------------------------------------------- tables of control points and of their image
# points


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkTable:
    """Marks as a file has them: names, (n, 2) pixels from the upper left corner, (n,) sigmas (NaN: unstated).

    ``score`` (n,) and ``used`` (n,) come with automatic measurements; ``skipped`` counts rows by reason.
    """

    image: tuple[str, ...]
    point: tuple[str, ...]
    xy_px: ArrayF
    sigma_px: ArrayF
    used: ArrayB
    skipped: dict[str, int] = field(default_factory=dict)

    def without(self, images: Collection[str]) -> "MarkTable":
        """The marks that are not in some images; names as the campaign has them."""
        return rows_of(self, np.flatnonzero([name not in images for name in self.image]))


def read_control_points(
    path: Path, frame: LocalFrame, *, crs: str | None, sigma_m: Sequence[float], height_offset_m: float = 0.0
) -> ControlPoints:
    """Control and check points of any of the known forms, in wcs.

    Parameters
    ----------
    frame : the world frame.
    crs : of coordinates ``x, y, z`` of tables that state none themselves.
    sigma_m : (3,) standard deviations where the file states none.
    height_offset_m : added to the heights of a file that are not those of the world frame.

    Raises
    ------
    InputError : no such file, unknown columns or roles, numbers that are none, or an unknown CRS.
    GeometryError : coordinates outside of the CRS, or far from the survey where another reading is near.
    """
    rows, stated = _point_rows(path, crs)
    if not rows:
        raise InputError(
            "no control points",
            expected="at least one row",
            where=path,
            cure="Add the surveyed points, or let the antenna's positions take their place: "
            "images.adjustment.antenna.use: true",
        )
    sigma = sigmas(rows, path, sigma_m)
    try:
        return ControlPoints(
            names=tuple(required(row, "id", path) for row in rows),
            points_wcs_m=_coordinates(rows, frame, stated, path, height_offset_m, own=stated is not crs),
            cov_wcs_m2=np.square(sigma)[:, :, None] * np.eye(3),
            check=np.array([_is_check(row, path) for row in rows]),
        )
    except GeometryError as error:
        raise GeometryError(error.found, expected=error.expected, where=path, cure=error.cure) from error


def _point_rows(path: Path, crs: str | None) -> tuple[list[dict[str, str]], str | None]:
    """Rows of surveyed points in any of the known forms, and the CRS that the file states, or ``crs``."""
    if is_vector_file(path):
        return _placed_rows(path, (), crs)
    text = read_text(path)[0]
    if path.suffix.lower() == ".xml":
        return metashape_points(path, text, crs)
    if not is_gcp_list(text):
        return _placed_rows(path, ("id", *FORMS[0]), crs)
    points: dict[str, dict[str, str]] = {}
    rows, stated = _gcp_rows(path, text)
    for row in rows:
        first = points.setdefault(row["id"], row)
        if any(first[a] != row[a] for a in "xyz"):
            raise InputError(
                f"two places of {row['id']}", expected="the same coordinates in each row", where=path
            )
    return list(points.values()), stated


def _placed_rows(
    path: Path, needed: Sequence[str], crs: str | None
) -> tuple[list[dict[str, str]], str | None]:
    """Rows of a table, or of points of a GIS, and the CRS that the file states, or ``crs``."""
    if not is_vector_file(path):
        rows, table = _rows_and_table(path, needed)
        _note_sigmas(rows, table)
        if crs == LOCAL or (stated := _stated_crs(table)) is None:
            if crs not in (None, LOCAL) and rows and not rows[0].keys() & {"lat_deg", "east_m"}:
                table.refuse_other_map(crs_of(crs, path))
            return rows, crs
        return rows, stated
    table, found = read_places(path, None, any_system=True)
    return named_rows(table), crs if found.crs is None else found.crs.to_wkt()


def read_all_control_points(
    paths: Sequence[Path],
    frame: LocalFrame,
    *,
    crs: str | None,
    sigma_m: Sequence[float],
    height_offset_m: float = 0.0,
) -> ControlPoints:
    """Control points of several files as one, see `read_control_points`; none of no file.

    Raises
    ------
    InputError, GeometryError : as there; or a name that stands in two files.
    """
    parts = [
        read_control_points(path, frame, crs=crs, sigma_m=sigma_m, height_offset_m=height_offset_m)
        for path in paths
    ]
    held: dict[str, Path] = {}
    for path, part in zip(paths, parts, strict=True):
        if both := sorted(set(part.names) & held.keys()):
            raise InputError(
                f"{listed(both)} stand{'s' if len(both) == 1 else ''} in {held[both[0]].name}, too",
                where=path,
                expected="each control point in one file",
                cure="Leave one of the files out, or rename the points",
            )
        held |= dict.fromkeys(part.names, path)
    return ControlPoints.joined(parts)


def frame_about(paths: Sequence[Path], *, crs: str | None) -> LocalFrame:
    """World frame with its origin amid control points; that of a local frame stands for no place.

    Parameters
    ----------
    paths : tables as of `read_control_points`.
    crs : of coordinates ``x, y, z``, or `LOCAL`.

    Raises
    ------
    InputError, GeometryError : as there; or coordinates that state no place, as ``east_m, north_m, up_m``.
    """
    nowhere = LocalFrame(lat_deg=0.0, lon_deg=0.0, h_ell_m=0.0)
    if crs == LOCAL or not paths:
        return nowhere
    # Points and results in one national grid need no other datum than its own.
    nowhere = replace(nowhere, ellipsoid=ellipsoid_of(crs_of(crs, paths[0])) if crs else nowhere.ellipsoid)
    places = []
    for path in paths:
        rows, stated = _point_rows(path, crs)
        form = next((f for f in FORMS[1:] if rows and rows[0].keys() >= set(f)), None)
        if form is not None:
            values, own = numbers(rows, form, path), None
            if form[0] == "x":
                values, own = _metric(values, crs_of(stated, path), path)
            places.append(world_of(values, form, own, nowhere))
    if not places:
        raise InputError(
            "control points without a place on the earth",
            expected="columns x, y, z of a CRS, or lat_deg, lon_deg, h_ell_m",
            where=paths[0],
            cure=f"Name the columns x, y, z and give --crs EPSG:..., or --crs {LOCAL}",
        )
    lat, lon, h = nowhere.to_geodetic(np.median(np.concatenate(places), axis=0))
    return replace(nowhere, lat_deg=float(lat), lon_deg=float(lon), h_ell_m=float(h))


def _is_check(row: dict[str, str], path: Path) -> bool:
    word = " ".join(row.get("role", "").lower().replace("_", " ").replace("-", " ").split())
    if word not in _ROLES:
        both = "CP is used for control and for check points alike: w" if word == "cp" else "W"
        raise InputError(
            f"the role '{row.get('role', '')}' of {row.get('id', '')}",
            expected="control or check",
            where=place_of(row, path),
            cure=f"{both}rite control for points that fix the block",
        )
    return _ROLES[word] or not _answer(row, "used", True) or _answer(row, "check", False)


def _answer(row: Mapping[str, str], name: str, default: bool) -> bool:
    """Whether a cell says yes; the default where it is empty or says neither."""
    return _FLAGS.get(row.get(name, "").lower(), default)


def read_marks(path: Path) -> MarkTable:
    """Marks of any of the known forms; a table without images is of the one that it is called like.

    Raises
    ------
    InputError : no such file, unknown columns, or numbers that are none.
    """
    text = read_text(path)[0]
    skipped, first_px = dict[str, int](), 0.0
    if path.suffix.lower() == ".xml":
        rows, skipped = metashape_marks(path, text)
    elif is_gcp_list(text):
        (rows, _), first_px = _gcp_rows(path, text), 0.5
    else:
        rows = table_rows(path, ("image", "point", "x_px", "y_px"))
        if rows and "accuracy" in rows[0] and not {"sigma_px", "z", "up_m"} & rows[0].keys():
            rows = [row | {"sigma_px": row["accuracy"]} for row in rows]
        if rows and "image" not in rows[0]:  # a table for each picture, which it is called like
            rows = [row | {"image": path.stem} for row in rows]
    xy_px = _meant(rows, ("x_px", "y_px"), path)
    if len(xy_px) > 1 and np.abs(xy_px).max() < _LEAST_PX:
        raise InputError(
            f"image points up to {np.abs(xy_px).max():g}",
            expected="pixels from the upper left corner",
            where=path,
            cure="Write pixels: these are shares of the picture, or lengths on the sensor",
        )
    return MarkTable(
        image=tuple(required(r, "image", path) for r in rows),
        point=tuple(required(r, "point", path) for r in rows),
        xy_px=xy_px + first_px,
        sigma_px=numbers(rows, ("sigma_px",), path, math.nan)[:, 0],
        used=np.array([_answer(r, "used", not r.get("used")) for r in rows]),
        skipped=skipped,
    )


def read_all_marks(paths: Sequence[Path]) -> MarkTable:
    """Marks of several files as one table, see `read_marks`.

    Raises
    ------
    InputError : as there; or a point that is measured twice in one image.
    """
    parts = [read_marks(path) for path in paths]
    rows = [(i, p) for part in parts for i, p in zip(part.image, part.point, strict=True)]
    twice = next((row for row, n in Counter(rows).items() if n > 1), None)
    if twice is not None:
        raise InputError(
            f"point {twice[1]} stands twice in image {twice[0]}",
            expected="each point once in an image",
            where=", ".join(str(path) for path in paths[:3]),
            cure="Keep the better of both rows",
        )
    return MarkTable(
        image=tuple(image for image, _ in rows),
        point=tuple(point for _, point in rows),
        xy_px=np.concatenate([part.xy_px for part in parts]),
        sigma_px=np.concatenate([part.sigma_px for part in parts]),
        used=np.concatenate([part.used for part in parts]),
        skipped=dict(sum((Counter(part.skipped) for part in parts), Counter())),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraPositions:
    """Measured projection centres: names of images, (n, 3) in wcs, (n, 3) standard deviations in metres."""

    images: tuple[str, ...]
    centre_wcs_m: ArrayF
    sigma_m: ArrayF


def read_camera_positions(
    path: Path, frame: LocalFrame, *, crs: str | None, height_offset_m: float = 0.0
) -> CameraPositions:
    """Where the camera was at each image, as a table with columns as of `read_control_points`.

    Parameters
    ----------
    frame, crs, height_offset_m : as of `read_control_points`.

    Raises
    ------
    InputError : no such file, unknown columns, numbers that are none, an image twice, or no standard
        deviations.
    """
    rows, stated = _placed_rows(path, ("image", *FORMS[2]), crs)
    rows = [{"image": row.get("id", ""), **row} for row in rows]  # whose column may be called a label
    if not rows:
        raise InputError("no positions", expected="at least one row", where=path)
    if not all("accuracy" in row or row.keys() >= set(_SIGMAS) for row in rows):
        raise InputError(
            "positions of the camera without standard deviations",
            expected="a column accuracy, or sigma_x_m, sigma_y_m, sigma_z_m, in metres",
            where=path,
            cure="State how well they were measured: by them the block is weighted and judged",
        )
    names = tuple(required(row, "image", path) for row in rows)
    twice = next((name for name, n in Counter(names).items() if n > 1), None)
    if twice is not None:
        raise InputError(f"two positions of {twice}", expected="each image once", where=path)
    return CameraPositions(
        images=names,
        centre_wcs_m=_coordinates(rows, frame, stated, path, height_offset_m, own=stated is not crs),
        sigma_m=sigmas(rows, path, (0.0, 0.0, 0.0)),
    )


def matched_marks(
    table: MarkTable,
    control: ControlPoints,
    images: Sequence[str],
    sizes_px: Sequence[tuple[int, int]],
    all_images: Sequence[str],
    *,
    sigma_px: float,
    where: str | Path = "",
) -> tuple[ControlMarks, dict[str, int]]:
    """Marks with the indices of images of a block and of control points, and what was dropped, counted.

    Names of images may lack their suffix, as Metashape's labels do, stand with folders or in another case;
    names of points may differ in case.

    Parameters
    ----------
    images, sizes_px : of the block.
    all_images : of the campaign: a mark in an image that has no pose is dropped, one in an image that does
        not exist is a mistake.
    sigma_px : where the table states none.

    Raises
    ------
    InputError : images or points that do not exist, pixels outside of their image, or a mark twice.
    """
    every = list(dict.fromkeys([*images, *all_images]))
    names = list(dict.fromkeys(table.image))
    index_of = dict(zip(names, matched(names, every, str(where), once=False).tolist(), strict=True))
    of_point = {name.strip().casefold(): k for k, name in enumerate(control.names)}
    if len(of_point) < len(control.names):
        alike = [n for k, n in enumerate(control.names) if of_point[n.strip().casefold()] != k]
        raise InputError(
            f"control points called {listed(alike)} in another case, too",
            expected="names that differ in more than their case",
        )
    strange = sorted(name for name in names if index_of[name] < 0)
    unknown = sorted({name for name in table.point if name.strip().casefold() not in of_point})
    for what, names, known, cure in (
        ("images", strange, all_images, "Check the names in the table; they are those of the files"),
        (
            "control points",
            unknown,
            control.names,
            "Add their coordinates, or check the names; points without names in a gcp_list.txt are gcp1, "
            "gcp2 and so on",
        ),
    ):
        if names:
            raise InputError(
                f"marks of {what} that do not occur: {listed(names)}",
                where=where,
                cure=cure,
                expected=f"{what} such as {listed(known[:3])}",
            )
    rows, dropped = [], Counter(table.skipped)
    seen: set[tuple[int, int]] = set()
    for row, (image, point) in enumerate(zip(table.image, table.point, strict=True)):
        if not table.used[row]:
            dropped["not to be used"] += 1
            continue
        at = index_of[image]
        if at >= len(images):
            dropped["in images without a pose"] += 1
            continue
        xy, size = table.xy_px[row], sizes_px[at]
        if not ((xy >= 0).all() and xy[0] <= size[0] and xy[1] <= size[1]):
            raise InputError(
                f"the mark of {point} at ({xy[0]:g}, {xy[1]:g}) in {image}",
                where=where,
                expected=f"pixels inside of {size[0]} x {size[1]}",
                cure="Check that the marks are those of these images, in the same size",
            )
        k = of_point[point.strip().casefold()]
        if (at, k) in seen:
            raise InputError(f"{point} is marked twice in {image}", where=where, expected="one mark")
        seen.add((at, k))
        rows.append((row, at, k))
    index = np.array(rows, np.int64).reshape(-1, 3)
    sigma = table.sigma_px[index[:, 0]]
    marks = ControlMarks(
        image=index[:, 1],
        point=index[:, 2],
        xy_px=table.xy_px[index[:, 0]],
        sigma_px=np.where(np.isfinite(sigma), sigma, sigma_px),
    )
    return marks, dict(dropped)


def _meant(rows: Sequence[Mapping[str, str]], names: Sequence[str], path: Path) -> ArrayF:
    """Coordinates (n, k), each of which stands for a value; see `numbers`."""
    values = numbers(rows, names, path)
    none = is_nothing(values, "position")
    none[:, 2:] = is_nothing(values[:, 2:], "height")
    none &= (np.abs(values) < HUGE) | (np.abs(values) > 1000.0 * HUGE)  # between are millimetres of a map
    if none.any():
        k, axis = np.argwhere(none)[0]
        raise InputError(
            f"{names[axis]} {values[k, axis]:g}, which stands for no value",
            expected="coordinates of each point",
            where=place_of(rows[k], path),
            cure="Correct the cell, or leave the row out",
        )
    return values


def _coordinates(
    rows: list[dict[str, str]],
    frame: LocalFrame,
    crs: str | None,
    path: Path,
    height_offset_m: float,
    *,
    own: bool,
) -> ArrayF:
    form = next((f for f in FORMS if rows[0].keys() >= set(f)), None)
    if form is None:
        raise InputError(
            f"columns {', '.join(sorted(set(rows[0]) - {LINE}))}",
            expected="; or ".join(", ".join(f) for f in FORMS),
            where=path,
            cure="Name the columns of the coordinates in the first line",
        )
    values = _meant(rows, form, path)
    known = None
    if form == FORMS[2] and crs != LOCAL:
        values, known = _metric(values, crs_of(crs, path), path)
    if form != FORMS[0]:
        values[:, 2] += height_offset_m
    if form == FORMS[2] and crs == LOCAL:
        return values
    return near_world(values, form, known, frame, path, own=own)


def _metric(values: ArrayF, crs: CRS, path: Path) -> tuple[ArrayF, CRS]:
    """Coordinates (n, 3) and their CRS in metres, whose units are not the same across and upwards."""
    stated = in_metres(crs)
    if stated.crs is None or stated.factors == (1.0, 1.0, 1.0):
        return values, crs
    for note in stated.notes:
        log.warning("%s: %s", path.name, note)
    return values * stated.factors, stated.crs


# ---------------------------------------------------------------- tables with named columns as people and
# other programs write them: text to rows by our own names


def table_rows(path: Path, needed: Sequence[str] = ()) -> list[dict[str, str]]:
    """Rows of a table with named columns, by our names of these, numbers with points and in metres.

    Parameters
    ----------
    needed : our names of columns without which the table is of no use, for the message.

    Raises
    ------
    InputError : see `thalweg.ingest.read_text_table`; no names of columns.
    """
    return _rows_and_table(path, needed)[0]


def _rows_and_table(path: Path, needed: Sequence[str]) -> tuple[list[dict[str, str]], Table]:
    table = read_text_table(path)
    if not table.named:
        raise InputError(
            f"no names of columns: the first line is '{','.join(table.cells.iloc[0])[:60]}'",
            expected=f"a first line such as {','.join(needed)}",
            where=path,
            cure="Write the names of the columns above the numbers",
        )
    rows = named_rows(table)
    flags = {*NAMES["used"], *NAMES["check"]}
    for note in table.notes:
        marks = re.match(r"column (.+) may mark rows", note)
        if marks is None or marks[1].lower() not in flags:  # these are read here
            log.warning("%s: %s", path.name, note)
    return rows, table


def _note_sigmas(rows: list[dict[str, str]], table: Table) -> None:
    """Say which standard deviations a table seems to have that are not read."""
    known = {name for names in NAMES.values() for name in names}
    stated = [name for name in _SIGMAS if rows and name in rows[0]]
    unread = [
        c.name for c in table.columns if _LIKE_SIGMA.search(c.words) and not {c.name.lower(), c.words} & known
    ]
    if unread or (len(stated) in (1, 2) and "accuracy" not in rows[0]):
        log.warning(
            "%s: standard deviations are read of %s%s; for the others the settings count",
            table.path.name,
            ", ".join(stated) or "no axis",
            f", not of the columns {', '.join(unread)}" if unread else "",
        )


def _stated_crs(table: Table) -> str | None:
    """The CRS that a table states in a remark or in a column; None: none, or one that PROJ does not know."""
    for line in table.remarks:
        found = re.match(r"(?i)\W*(?:coordinate ?system|crs)\s*:\s*(\S.*)$", line)
        if found and not found[1].startswith("LOCAL_CS"):
            with contextlib.suppress(InputError):
                return crs_of(found[1], table.path).to_wkt()
    return None if table.code is None else f"EPSG:{table.code}"


def named_rows(table: Table, names: Mapping[str, tuple[str, ...]] = NAMES) -> list[dict[str, str]]:
    """Rows of a table by our names of the columns, with their lines.

    Raises
    ------
    InputError : a row with more cells than there are columns; a unit that none of the columns can have.
    """
    if long := next((words for words in table.loss_notes() if " cells" in words), None):
        raise InputError(
            long,
            expected=f"the cells {table.listed()} in each row",
            where=table.path,
            cure="Correct these rows: a separator too many, or a name with a blank",
        )
    rows = table.rows(names) or [{} for _ in range(len(table))]
    for ours in _TEXTS & names.keys():  # what looks like a number, or like one with a unit, is a name here
        heads = [
            k for n in names[ours] for k, c in enumerate(table.columns) if n in (c.name.lower(), c.words)
        ]
        for k in heads[:1]:
            rows = [row | {ours: text} for row, text in zip(rows, table.text(k), strict=True)]
    meant = {"id", "image", "point", "x_px", "y_px", *(name for form in FORMS for name in form)}
    return [
        row | {LINE: str(line)}
        for row, line in zip(rows, table.line.tolist(), strict=True)
        # Metashape ends its tables with a row of mean errors
        if not meant & row.keys() or any(row[name] for name in meant & row.keys())
    ]


def required(row: Mapping[str, str], name: str, path: Path) -> str:
    """A value that must be there.

    Raises
    ------
    InputError : no such column, or no value in this row.
    """
    value = row.get(name, "")
    if not value:
        known = " or ".join(NAMES.get(name, (name,))[:3])
        raise InputError(
            f"no {name}",
            expected=f"a column {known} with a value in each row",
            where=place_of(row, path),
            cure="Add it, or leave the row out",
        )
    return value


def number(row: Mapping[str, str], name: str, path: Path, default: float | None = None) -> float:
    """A finite number, or the default where the row has none.

    Raises
    ------
    InputError : no number, and no default.
    """
    text = row.get(name, "")
    if default is not None and text.casefold() in ("", "nan", "none", "-"):
        return default
    text = text or required(row, name, path)
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(
            f"{name} '{text}'",
            expected="a number",
            where=place_of(row, path),
            cure="Correct the cell, or leave the row out",
        )
    return value


def numbers(
    rows: Sequence[Mapping[str, str]], names: Sequence[str], path: Path, default: float | None = None
) -> ArrayF:
    """Some columns (n, k) as numbers, see `number`."""
    values = [[number(row, name, path, default) for name in names] for row in rows]
    return np.array(values, np.float64).reshape(-1, len(names))


def sigmas(
    rows: Sequence[Mapping[str, str]], path: Path, default: Sequence[float], names: Sequence[str] = ()
) -> ArrayF:
    """Standard deviations (n, 3) of coordinates in metres, or of the columns ``names``.

    Parameters
    ----------
    default : (3,) where the file states none, neither for each axis nor as one ``accuracy``; NaN is taken.

    Raises
    ------
    InputError : one is not above zero.
    """
    common = "" if names else "accuracy"
    out = np.array(
        [
            [
                number(row, name, path, number(row, common, path, known))
                for name, known in zip(names or _SIGMAS, default, strict=True)
            ]
            for row in rows
        ]
    )
    for row, values in zip(rows, out, strict=True):
        if (values <= 0).any():
            raise InputError(
                f"a standard deviation of {np.nanmin(values):g}{' m' if common else ''} of "
                f"{row.get('id') or row.get('image', '')}",
                expected="numbers above zero",
                where=place_of(row, path),
                cure="State how well it was measured; 0 would make it perfect",
            )
    return out


def place_of(row: Mapping[str, str], path: Path) -> str:
    """File and line of a row."""
    return f"{path}:{row[LINE]}" if LINE in row else str(path)


def listed(names: Sequence[str]) -> str:
    """The first names, and how many more."""
    return ", ".join(names[:_NAMED]) + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")


# ---------------------------------------------------------------- coordinates of control points into wcs, and
# what they may be where they lie far from the survey


def crs_of(text: str | None, path: Path) -> CRS:
    """A CRS by its name, as OpenDroneMap, Metashape and people write it.

    Raises
    ------
    InputError : none is given, or PROJ does not know it.
    """
    if not text:
        raise InputError(
            "coordinates x, y, z without a CRS",
            expected="its code",
            where=path,
            cure="Set images.control.crs or campaign.crs, or name the columns east_m, north_m, up_m if they "
            "are in the world frame",
        )
    utm = re.fullmatch(r"WGS84 UTM (\d{1,2})\s*([NS])", text.strip(), re.IGNORECASE)
    if utm:
        text = f"EPSG:{(32600 if utm[2].upper() == 'N' else 32700) + int(utm[1])}"
    text = re.sub(r"^\s*EPSG::", "EPSG:", text)
    try:
        return CRS.from_user_input(text.strip())
    except CRSError as error:
        raise InputError(
            f"the CRS '{text.strip()[:80]}' is not known", expected="such as EPSG:25833", where=path
        ) from error


def map_grid(text: str, path: Path) -> CRS:
    """The grid in which results are wanted: their columns are metres.

    Raises
    ------
    InputError : an unknown CRS, or none of a map in metres.
    """
    crs = crs_of(text, path)
    if not crs.is_projected or any(abs(axis.unit_conversion_factor - 1) > 1e-9 for axis in crs.axis_info):
        raise InputError(
            f"the CRS '{crs.name}'",
            expected=f"a projected one in metres, or {LOCAL}",
            cure="Give the map grid in which results are wanted, such as EPSG:25833; a table of points may "
            "state another one above its rows (# CRS: EPSG:2226)",
        )
    return crs


# ---------------------------------------------------------------- control points and marks as other programs
# write them: OpenDroneMap and Metashape
#
# Rows come out as texts by our own names of the columns.


def is_gcp_list(text: str) -> bool:
    """Whether a text begins with a CRS, as ``gcp_list.txt`` does."""
    first = next((line for line in text.splitlines() if line.strip()), "")
    return bool(re.match(r"\s*(EPSG:\d+|WGS84 UTM|\+proj=)", first, re.IGNORECASE))


def _gcp_rows(path: Path, text: str) -> tuple[list[dict[str, str]], str]:
    """Rows ``x y z im_x im_y image [name]`` of a ``gcp_list.txt`` by our names of the columns, and its CRS.

    Nothing is to be told of its form: blanks or tabs stand between the cells, and the last one may be
    missing in some rows. A point without name is known by its coordinates.
    """
    (_, crs), *lines = [(k, line.strip()) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    rows, unnamed = [], dict[tuple[str, ...], str]()
    for number, line in lines:
        if line.startswith("#"):
            continue
        cells = line.split()
        if len(cells) < 6:
            raise InputError(
                f"{len(cells)} columns", expected="x y z im_x im_y image [name]", where=f"{path}:{number}"
            )
        name = cells[6] if len(cells) > 6 else unnamed.setdefault(tuple(cells[:3]), f"gcp{len(unnamed) + 1}")
        keys = ("x", "y", "z", "x_px", "y_px", "image", "id", "point", LINE)
        rows.append(dict(zip(keys, (*cells[:6], name, name, str(number)), strict=True)))
    return rows, crs


def _metashape(path: Path, text: str) -> ElementTree.Element:
    root = parse_xml(text, path, "markers as Metashape exports them")
    if root.find(".//markers") is None:
        raise InputError("no markers", expected="markers as Metashape exports them", where=path)
    chunks = [chunk for chunk in root.iter("chunk") if chunk.find(".//markers/marker") is not None]
    if len(chunks) > 1:  # each numbers its cameras and markers from 0
        raise InputError(
            f"{len(chunks)} chunks with markers",
            expected="one",
            where=path,
            cure="Export the markers of one chunk",
        )
    return root


def metashape_points(path: Path, text: str, crs: str | None) -> tuple[list[dict[str, str]], str | None]:
    """Markers with reference coordinates, and the CRS that the file states, or ``crs``."""
    root = _metashape(path, text)
    settings = {p.get("name"): p.get("value") for p in root.iterfind(".//settings/property")}
    usual = settings.get("accuracy_markers") or ""
    usual = usual if re.search(r"[1-9]", usual) else ""
    rows = []
    for marker in root.iter("marker"):
        reference = marker.find("reference")
        if reference is None or reference.get("x") is None:
            continue
        row = {"id": marker.get("label", ""), **{a: reference.get(a, "") for a in "xyz"}}
        for axis, name in zip("xyz", ("east", "north", "up"), strict=True):
            row[f"sigma_{name}_m"] = reference.get(f"s{axis}") or reference.get("sxyz") or usual
        row["role"] = "control" if reference.get("enabled", "true") in ("true", "1") else "check"
        rows.append(row)
    if usual and any(row["sigma_east_m"] == usual for row in rows):
        log.warning(
            "%s: markers without an accuracy have that of the chunk (accuracy_markers), %s m",
            path.name,
            usual,
        )
    places = (".//markers/../reference", ".//coordinate_system/wkt", ".//coordinate_system", ".//reference")
    stated = [element.text for place in places if (element := root.find(place)) is not None]
    found = next((t.strip() for t in stated if t and t.strip()), None)
    if found and crs == LOCAL and CRS.from_user_input(found).is_engineering:
        if CRS.from_user_input(found).axis_info[0].unit_conversion_factor != 1.0:
            raise InputError(
                f"coordinates in '{CRS.from_user_input(found).name}'", expected="metres", where=path
            )
        return rows, crs
    return rows, found or crs


def metashape_marks(path: Path, text: str) -> tuple[list[dict[str, str]], dict[str, int]]:
    """Marks that a person has placed, and how many the program has guessed."""
    root = _metashape(path, text)
    cameras = {c.get("id"): c.get("label", "") for c in root.iter("camera") if c.get("label")}
    labels = {m.get("id"): m.get("label", "") for m in root.iter("marker") if m.get("label")}
    rows, guessed = [], 0
    for marker in root.iter("marker"):
        for location in marker.findall("location"):
            if location.get("pinned", "true") not in ("true", "1"):
                guessed += 1
                continue
            camera, point = location.get("camera_id"), marker.get("marker_id")
            if camera not in cameras or point not in labels:
                raise InputError(
                    f"a mark of camera {camera} and marker {point}", expected="both in the file", where=path
                )
            rows.append(
                {
                    "image": cameras[camera],
                    "point": labels[point],
                    "x_px": location.get("x", ""),
                    "y_px": location.get("y", ""),
                }
            )
    return rows, {"placed by the program, not by a person": guessed} if guessed else {}


# ---------------------------------------------------------------- 2 by 2 checker boards, found where the
# poses predict them
#
# A board is upright and looks toward the river. Its picture is predicted from the pose of each image; a
# window as large as the prediction may err is searched by normalised cross-correlation with checkers of
# several breadths. What several images agree on in space is taken; the block is then moved onto these
# points, searched again in narrow windows, and the crossings are fitted to sub-pixels
# (`thalweg.calibration.markers`).


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """Marks as a table with the columns of `COLUMNS`, and what was found: counts by reason, notes."""

    table: pd.DataFrame
    counts: dict[str, int]
    notes: list[str] = field(default_factory=list)


@dataclass(slots=True)
class _Sight:
    """A board in an image: indices, prediction (2,), pixels by module (2, 2), window, candidates, outcome."""

    image: int
    point: int
    xy: ArrayF
    by_module: ArrayF
    reach_px: float
    found: list[tuple[float, ArrayF, int]]
    reason: str = ""
    score: float = float("nan")
    fitted: ArrayF | None = None
    sigma_px: float = float("nan")


def measure_boards(
    block: ImageBlock, control: ControlPoints, boards: ControlSettings, grey: Loader, mask: Loader
) -> Measured:
    """Measure all boards in all images of a block that lies roughly in the world frame.

    Parameters
    ----------
    grey, mask : grey values, and 0 where nothing may be measured, by the name of the image.

    Raises
    ------
    GeometryError : no control points.
    """
    if not len(control.names):
        raise GeometryError("no control points to look for", expected="a table of their coordinates")
    notes: list[str] = []
    wide = _sights(block, control, boards, boards.search_m, mask)
    _search(block, wide, boards, grey)
    points = _agreed(block, wide, len(control.names), boards)
    moved = _moved(points, control, notes)
    if moved is not None:
        block = block.transformed(moved.R, moved.shift_m, moved.scale)
    known = np.isfinite(points[:, 0])
    # the board's own place as the images see it, where they do: the survey may be off
    place = control.points_wcs_m.copy()
    if moved is not None:
        place[known] = moved.apply(points[known])
    elif known.any():
        place[known] = points[known]
    narrow = _sights(block, control, boards, 0.0, mask, place)
    for sight in narrow:
        # boards that no images agreed on keep their wide window, but now in a block that fits better
        if not known[sight.point]:
            sight.reach_px = _reach_px(block, sight, boards, 0.3 * boards.search_m)
    _search(block, narrow, boards, grey, fit=True)
    _consistent(block, narrow, len(control.names), boards)
    return _table(block, control, narrow, notes)


def _sights(
    block: ImageBlock,
    control: ControlPoints,
    boards: ControlSettings,
    search_m: float,
    mask: Loader,
    place: ArrayF | None = None,
) -> list[_Sight]:
    """Where each board should be in each image; boards outside of an image are left out without a word."""
    place = control.points_wcs_m if place is None else place
    out = []
    mask = cache(mask)
    for k, centre in enumerate(place):
        near = np.argsort(np.linalg.norm(block.centre_block_m - centre, axis=1))[:10]
        toward = block.centre_block_m[near].mean(axis=0) - centre
        right = np.cross([0.0, 0.0, 1.0], toward)
        if np.linalg.norm(right) < 1e-6:
            continue
        # seen from the river, its right is to the left of the direction toward the river
        axes = np.stack([right / np.linalg.norm(right), [0.0, 0.0, -1.0]], axis=1) * boards.module_m
        seen = np.einsum("ij,ijk->ik", centre - block.centre_block_m, block.R_block_ccs)
        for i in range(len(block.images)):
            camera = block.cameras[block.camera[i]]
            if camera.model == "perspective" and seen[i, 2] <= 0:
                continue
            xy, by_seen, _ = camera.project_with_derivatives(seen[i : i + 1])
            if not np.isfinite(xy).all() or not camera.inside(xy, 3.0)[0]:
                continue
            by_module = by_seen[0] @ block.R_block_ccs[i].T @ axes
            sight = _Sight(i, k, xy[0], by_module, 0.0, [])
            sight.reach_px = _reach_px(block, sight, boards, search_m)
            height = 2.0 * float(np.linalg.norm(by_module[:, 1]))
            if height < boards.least_board_px:
                sight.reason = f"too small: {height:.0f} px"
            veil = mask(block.images[i])
            hidden = veil is not None and not at_pixels(veil > 0, xy[:, 0], xy[:, 1], camera.size_px).all()
            if hidden and search_m == 0.0 and not sight.reason:
                sight.reason = "masked"
            out.append(sight)
    return out


def _reach_px(block: ImageBlock, sight: _Sight, boards: ControlSettings, search_m: float) -> float:
    """Half width of the window: three sigmas of the place, and a part of the board."""
    module = float(np.linalg.norm(sight.by_module[:, 1]))
    return max(_NARROW_PX, _NARROW_MODULES * module) + 3.0 * search_m * module / boards.module_m


def _search(
    block: ImageBlock, sights: Sequence[_Sight], boards: ControlSettings, grey: Loader, *, fit: bool = False
) -> None:
    """Candidates of each sight, best first; with ``fit`` also the fitted crossing of the best."""
    for image in sorted({s.image for s in sights if not s.reason}):
        own = [s for s in sights if s.image == image and not s.reason]
        picture = grey(block.images[image])
        if picture is None:
            for sight in own:
                sight.reason = "no picture"
            continue
        for sight in own:
            _correlate(picture, sight, boards)
        found = [s for s in own if s.found]
        if fit and found:
            start = np.array([s.found[0][1] for s in found])
            sign = np.array([float(s.found[0][2]) for s in found])
            crossing = fit_saddles(picture, start, np.array([s.by_module for s in found]), sign)
            for k, sight in enumerate(found):
                if crossing.good[k]:
                    sight.fitted, sight.sigma_px = (
                        crossing.xy_px[k],
                        float(np.hypot(crossing.sigma_px[k], _FLOOR_PX)),
                    )
                else:
                    sight.reason = "no clean crossing"


def _correlate(picture: ArrayU8, sight: _Sight, boards: ControlSettings) -> None:
    """Fill in the candidates of a sight: score, place, sign (+1: lower right and upper left white)."""
    half = np.ceil(np.abs(sight.by_module).sum(axis=1) * _REACH_MODULES).astype(int) + 1
    low = np.floor(sight.xy - sight.reach_px).astype(int) - half
    high = np.ceil(sight.xy + sight.reach_px).astype(int) + half + 1
    h, w = picture.shape
    low, high = np.maximum(low, 0), np.minimum(high, [w, h])
    window = picture[low[1] : high[1], low[0] : high[0]].astype(np.float32)
    best: AnyArray | None = None
    for breadth in _BREADTHS:
        shape = _template(sight.by_module * np.array([breadth, 1.0]))
        if window.shape[0] < shape.shape[0] or window.shape[1] < shape.shape[1]:
            continue
        score = cv2.matchTemplate(window, shape, cv2.TM_CCOEFF_NORMED)
        # the middle of the template in the picture; smaller templates begin nearer to the edge
        full = np.zeros(window.shape, np.float32)
        y, x = shape.shape[0] // 2, shape.shape[1] // 2
        full[y : y + score.shape[0], x : x + score.shape[1]] = score
        best = full if best is None else np.where(np.abs(full) > np.abs(best), full, best)
    sight.found = []
    if best is None:
        sight.reason = "at the edge of the image"
        return
    rank = {"white": best, "black": -best}.get(boards.upper_left, np.abs(best))
    yy, xx = np.mgrid[: best.shape[0], : best.shape[1]]
    away = np.hypot(xx + low[0] + 0.5 - sight.xy[0], yy + low[1] + 0.5 - sight.xy[1])
    rank = np.where(away <= sight.reach_px, rank, 0.0)
    apart = max(2.0, _DIFFER_MODULES * float(np.linalg.norm(sight.by_module[:, 1])))
    for _ in range(_CANDIDATES):
        y, x = (int(v) for v in np.unravel_index(int(np.argmax(rank)), rank.shape))
        if rank[y, x] < boards.least_score:
            break
        sight.found.append(
            (float(rank[y, x]), np.array([x + low[0] + 0.5, y + low[1] + 0.5]), 1 if best[y, x] > 0 else -1)
        )
        rank[np.hypot(xx - x, yy - y) < apart] = 0.0
    if sight.found:
        sight.score = sight.found[0][0]
    else:
        sight.score = float(rank.max())
        sight.reason = "no crossing found"


def _template(by_module: ArrayF) -> AnyArray:
    """Grey values of a checker, white where both sheet coordinates grow or both fall; odd sides."""
    half = np.maximum(np.ceil(np.abs(by_module).sum(axis=1) * _REACH_MODULES).astype(int), 2)
    x, y = np.meshgrid(np.arange(-half[0], half[0] + 1), np.arange(-half[1], half[1] + 1))
    u, v = np.einsum("ij,jhw->ihw", np.linalg.inv(by_module), np.stack([x, y]).astype(np.float64))
    soft = 0.7 / np.linalg.norm(by_module, axis=0)
    inside = (np.abs(u) < 1.0) & (np.abs(v) < 1.0)
    return (np.tanh(u / soft[0]) * np.tanh(v / soft[1]) * inside).astype(np.float32)


def _agreed(block: ImageBlock, sights: Sequence[_Sight], n_points: int, boards: ControlSettings) -> ArrayF:
    """(k, 3) places on which most images agree, each by one of its candidates; NaN if too few do."""
    out = np.full((n_points, 3), np.nan)
    for k in range(n_points):
        own = [s for s in sights if s.point == k and s.found]
        if len({s.image for s in own}) < boards.least_images:
            continue
        options = [(s, xy) for s in own for _, xy, _ in s.found]
        rays, centres = _rays(block, options)
        best, agree = np.full(3, np.nan), 0.0
        order = np.argsort([-s.score for s, _ in options], kind="stable")[:12]
        for a in order:
            for b in order:
                if options[a][0].image >= options[b][0].image:
                    continue
                point = nearest_to_rays(centres[[a, b]], rays[[a, b]])
                if not np.isfinite(point).all():
                    continue
                good = _near(block, options, point)
                votes = sum({s.image: s.score for s, _ in good}.values())
                if votes > agree:
                    r, c = _rays(block, good)
                    best, agree = nearest_to_rays(c, r), votes
        good = _near(block, options, best) if np.isfinite(best).all() else []
        if len({s.image for s, _ in good}) >= boards.least_images:
            out[k] = best
    return out


def _near(
    block: ImageBlock, options: Sequence[tuple[_Sight, ArrayF]], point: ArrayF
) -> list[tuple[_Sight, ArrayF]]:
    def is_near(sight: _Sight, xy: ArrayF) -> bool:
        """Whether the point is seen where this candidate is."""
        seen = (point - block.centre_block_m[sight.image]) @ block.R_block_ccs[sight.image]
        at = block.cameras[block.camera[sight.image]].project(seen)[0]
        limit = max(_AGREE_PX, _AGREE_MODULES * float(np.linalg.norm(sight.by_module[:, 1])))
        return bool(np.linalg.norm(at - xy) < limit)

    return [option for option in options if is_near(*option)]


def _rays(block: ImageBlock, options: Sequence[tuple[_Sight, ArrayF]]) -> tuple[ArrayF, ArrayF]:
    rays = [
        block.R_block_ccs[s.image] @ block.cameras[block.camera[s.image]].rays(xy[None])[0]
        for s, xy in options
    ]
    return np.array(rays).reshape(-1, 3), block.centre_block_m[[s.image for s, _ in options]].reshape(-1, 3)


def _moved(points: ArrayF, control: ControlPoints, notes: list[str]) -> Similarity | None:
    """Similarity that moves the block onto the survey of the boards found; None for too few of them."""
    rows = np.flatnonzero(np.isfinite(points[:, 0]))
    if len(rows) < 3:
        notes.append(f"Only {len(rows)} boards were found in the first search; the block stays where it was")
        return None
    try:
        found = robust_similarity(
            points[rows], control.points_wcs_m[rows], [control.names[i] for i in rows], what="boards"
        )
    except GeometryError as error:
        notes.append(f"The block stays where it was: {error.found}")
        return None
    notes += found.notes
    return found


def _consistent(block: ImageBlock, sights: Sequence[_Sight], n_points: int, boards: ControlSettings) -> None:
    """Crossings that the other images of a board contradict are marked."""
    for k in range(n_points):
        options = [(s, s.fitted) for s in sights if s.point == k and s.fitted is not None]
        own = [s for s, _ in options]
        if len(options) < 2:
            for sight in own:
                sight.reason = "in one image only"
            continue
        rays, centres = _rays(block, options)
        point = nearest_to_rays(centres, rays)
        good = {id(s) for s, _ in _near(block, options, point)} if np.isfinite(point).all() else set()
        for sight in own:
            second = sight.found[1][0] if len(sight.found) > 1 else 0.0
            if id(sight) not in good:
                sight.reason = "not where the other images put it"
            elif second > sight.score - _CLEAR:
                sight.reason = "ambiguous"


def _table(block: ImageBlock, control: ControlPoints, sights: Sequence[_Sight], notes: list[str]) -> Measured:
    rows = []
    for s in sorted(sights, key=lambda s: (s.point, s.image)):
        xy = s.xy if s.fitted is None else s.fitted
        used = s.fitted is not None and not s.reason
        rows.append((block.images[s.image], control.names[s.point], *xy, s.sigma_px, s.score, used, s.reason))
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    # the part of a reason before its number
    causes = Counter(str(row[7]).partition(":")[0] for row in rows if not row[6])
    counts = {"used": sum(bool(row[6]) for row in rows), **dict(causes.most_common())}
    for k, name in enumerate(control.names):
        n = int(table.loc[table["point"] == name, "used"].sum())
        if n < 2:
            why = "no image shows its place" if not any(s.point == k for s in sights) else f"{n} marks"
            notes.append(f"{name} was not measured: {why}")
    return Measured(table=table, counts=counts, notes=notes)
