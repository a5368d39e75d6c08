"""Tables of control points and of their marks, as people and other programs write them.

Read are CSV tables with named columns, the CSV of Metashape's reference pane, its XML of markers, and the
``gcp_list.txt`` of OpenDroneMap. Pixels of Metashape and of our own tables count from the upper left corner;
those of OpenDroneMap from the centre of the first pixel (OpenSfM adds the half when it normalises), so half a
pixel is added.
"""

import csv
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from pyproj import CRS
from pyproj.exceptions import CRSError

from thalweg.core.errors import GeometryError, InputError
from thalweg.core.frames import LocalFrame
from thalweg.core.types import ArrayB, ArrayF
from thalweg.orientation.control_foreign import (
    gcp_points,
    gcp_rows,
    is_gcp_list,
    metashape_marks,
    metashape_points,
)
from thalweg.orientation.control_points import ControlMarks, ControlPoints

_NAMED: Final = 5
"""Names that a message lists."""
NAMES: Final[Mapping[str, tuple[str, ...]]] = {
    "id": ("id", "label", "name", "point", "gcp", "marker", "gcp_name"),
    "image": ("image", "photo", "camera", "image_name", "file", "camera_label"),
    "point": ("point", "gcp", "marker", "label", "id", "gcp_name", "marker_label"),
    "x_px": ("x_px", "u", "u_px", "im_x", "image_u", "x"),
    "y_px": ("y_px", "v", "v_px", "im_y", "image_v", "y"),
    "sigma_px": ("sigma_px", "accuracy_px"),
    "east_m": ("east_m",),
    "north_m": ("north_m",),
    "up_m": ("up_m",),
    "lat_deg": ("lat_deg", "latitude", "y/latitude"),
    "lon_deg": ("lon_deg", "longitude", "x/longitude"),
    "h_ell_m": ("h_ell_m", "h_m", "altitude", "z/altitude"),
    "x": ("x", "x/east", "x/easting", "easting", "east"),
    "y": ("y", "y/north", "y/northing", "northing", "north"),
    "z": ("z", "z/altitude", "altitude", "height"),
    "sigma_east_m": ("sigma_east_m", "sigma_x_m", "x/east accuracy", "x accuracy", "sx"),
    "sigma_north_m": ("sigma_north_m", "sigma_y_m", "y/north accuracy", "y accuracy", "sy"),
    "sigma_up_m": ("sigma_up_m", "sigma_z_m", "z/altitude accuracy", "z accuracy", "sz"),
    "accuracy": ("accuracy", "accuracy (m)"),
    "role": ("role", "type"),
}
"""Headings, in small letters, by which a column is known."""


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


def read_control_points(
    path: Path, frame: LocalFrame, *, crs: str | None, sigma_m: Sequence[float]
) -> ControlPoints:
    """Control and check points of any of the known forms, in wcs.

    Parameters
    ----------
    frame : the world frame.
    crs : of coordinates ``x, y, z`` of tables that state none themselves.
    sigma_m : (3,) standard deviations where the file states none.

    Raises
    ------
    InputError : no such file, unknown columns, numbers that are none, or an unknown CRS.
    GeometryError : coordinates outside of the CRS.
    """
    text = _text(path)
    if path.suffix.lower() == ".xml":
        rows, crs = metashape_points(path, text, crs)
    elif is_gcp_list(text):
        rows, crs = gcp_points(path, text)
    else:
        rows = _table(path, text)
    if not rows:
        raise InputError("no control points", expected="at least one row", where=path)
    sigmas = [
        [_number(row, f"sigma_{axis}_m", path, _number(row, "accuracy", path, default)) for axis, default in
         zip(("east", "north", "up"), sigma_m, strict=True)] for row in rows
    ]  # fmt: skip
    roles = [(row.get("role") or "control").strip().lower() for row in rows]
    odd = sorted(set(roles) - {"control", "check"})
    if odd:
        raise InputError(f"the role '{odd[0]}'", expected="control or check", where=path)
    try:
        return ControlPoints(
            names=tuple(_required(row, "id", path) for row in rows),
            points_wcs_m=_coordinates(rows, frame, crs, path),
            cov_wcs_m2=np.array([np.diag(np.square(s)) for s in sigmas]),
            check=np.array([role == "check" for role in roles]),
        )
    except GeometryError as error:
        raise GeometryError(error.found, expected=error.expected, where=path, cure=error.cure) from error


def read_marks(path: Path) -> MarkTable:
    """Marks of any of the known forms.

    Raises
    ------
    InputError : no such file, unknown columns, or numbers that are none.
    """
    text = _text(path)
    skipped: dict[str, int] = {}
    if path.suffix.lower() == ".xml":
        rows, skipped = metashape_marks(path, text)
    elif is_gcp_list(text):
        rows = [
            {"image": r["image"], "point": r["id"], "x_px": r["x_px"], "y_px": r["y_px"]}
            for r in gcp_rows(path, text)
        ]
    else:
        rows = _table(path, text)
    xy = np.array([[_number(r, "x_px", path), _number(r, "y_px", path)] for r in rows]).reshape(-1, 2)
    if is_gcp_list(text):
        xy = xy + 0.5
    return MarkTable(
        image=tuple(_required(r, "image", path) for r in rows),
        point=tuple(_required(r, "point", path) for r in rows),
        xy_px=xy,
        sigma_px=np.array([_number(r, "sigma_px", path, math.nan) for r in rows]),
        used=np.array([(r.get("used") or "true").strip().lower() in ("true", "1", "yes") for r in rows]),
        skipped=skipped,
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

    Names of images may lack their suffix, as Metashape's labels do.

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
    of_image, of_every = _by_name(images), _by_name(all_images)
    of_point = {name: k for k, name in enumerate(control.names)}
    strange = sorted({name for name in table.image if name not in of_every and name not in of_image})
    unknown = sorted({name for name in table.point if name not in of_point})
    for what, names, known, cure in (
        ("images", strange, all_images, "Check the names in the table; they are those of the files"),
        ("control points", unknown, control.names, "Add their coordinates, or check the names"),
    ):
        if names:
            raise InputError(
                f"marks of {what} that do not occur: {_listed(names)}", where=where, cure=cure,
                expected=f"{what} such as {_listed(known[:3])}",
            )  # fmt: skip
    rows, dropped = [], dict(table.skipped)
    seen: set[tuple[int, int]] = set()
    for row, (image, point) in enumerate(zip(table.image, table.point, strict=True)):
        if not table.used[row]:
            dropped["not to be used"] = dropped.get("not to be used", 0) + 1
            continue
        at = of_image.get(image)
        if at is None:
            dropped["in images without a pose"] = dropped.get("in images without a pose", 0) + 1
            continue
        xy, size = table.xy_px[row], sizes_px[at]
        if not ((xy >= 0).all() and xy[0] <= size[0] and xy[1] <= size[1]):
            raise InputError(
                f"the mark of {point} at ({xy[0]:g}, {xy[1]:g}) in {image}", where=where,
                expected=f"pixels inside of {size[0]} x {size[1]}",
                cure="Check that the marks are those of these images, in the same size",
            )  # fmt: skip
        if (at, of_point[point]) in seen:
            raise InputError(f"{point} is marked twice in {image}", where=where, expected="one mark")
        seen.add((at, of_point[point]))
        rows.append((row, at, of_point[point]))
    index = np.array(rows, np.int64).reshape(-1, 3)
    sigma = table.sigma_px[index[:, 0]]
    marks = ControlMarks(
        image=index[:, 1],
        point=index[:, 2],
        xy_px=table.xy_px[index[:, 0]],
        sigma_px=np.where(np.isfinite(sigma), sigma, sigma_px),
    )
    return marks, dropped


def _by_name(images: Sequence[str]) -> dict[str, int]:
    """Index by name, and by the name without suffix where that is unique."""
    stems = [Path(name).stem for name in images]
    times = Counter(stems)
    out = {stem: k for k, stem in enumerate(stems) if times[stem] == 1}
    out |= {Path(name).name: k for k, name in enumerate(images)}
    return out | {name: k for k, name in enumerate(images)}


def _coordinates(rows: list[dict[str, str]], frame: LocalFrame, crs: str | None, path: Path) -> ArrayF:
    forms = (("east_m", "north_m", "up_m"), ("lat_deg", "lon_deg", "h_ell_m"), ("x", "y", "z"))
    form = next((f for f in forms if all(name in rows[0] for name in f)), None)
    if form is None:
        raise InputError(
            f"columns {sorted(rows[0])}",
            expected="; or ".join(", ".join(f) for f in forms),
            where=path,
            cure="Name the columns of the coordinates in the first line",
        )
    values = np.array([[_number(row, name, path) for name in form] for row in rows])
    if form[0] == "east_m":
        return values
    geodetic = None if form[0] == "lat_deg" else _crs(crs, path)
    if form[0] == "lat_deg":
        return frame.from_geodetic(values[:, 0], values[:, 1], values[:, 2])
    if geodetic is not None and geodetic.is_geographic:
        return frame.from_geodetic(values[:, 1], values[:, 0], values[:, 2])
    assert geodetic is not None
    return frame.from_map(values, geodetic)


def _crs(text: str | None, path: Path) -> CRS:
    if not text:
        raise InputError(
            "coordinates x, y, z without a CRS", expected="its code", where=path,
            cure="Set campaign.crs, or name the columns east_m, north_m, up_m if they are in the world frame",
        )  # fmt: skip
    utm = re.fullmatch(r"WGS84 UTM (\d{1,2})\s*([NS])", text.strip(), re.IGNORECASE)
    if utm:
        text = f"EPSG:{(32600 if utm[2].upper() == 'N' else 32700) + int(utm[1])}"
    try:
        return CRS.from_user_input(text)
    except CRSError as error:
        raise InputError(
            f"the CRS '{text[:80]}' is not known", expected="such as EPSG:25833", where=path
        ) from error


def _table(path: Path, text: str) -> list[dict[str, str]]:
    """Rows of a table with named columns, by our names of these."""
    lines = [line for line in text.splitlines() if line.strip()]
    while lines and lines[0].startswith("#") and not re.match(r"#\s*label", lines[0], re.IGNORECASE):
        lines = lines[1:]
    if not lines:
        raise InputError("an empty table", expected="a first line with the names of the columns", where=path)
    lines[0] = lines[0].lstrip("#").lstrip()
    lines = [lines[0]] + [line for line in lines[1:] if not line.startswith("#")]
    separator = max(",;\t", key=lines[0].count)
    reader = csv.reader(lines, delimiter=separator)
    head = [re.sub(r"[_ ]\((m|px|deg|°)\)$", "", name.strip().lower()) for name in next(reader)]
    ours = {
        name: head.index(found)
        for name, known in NAMES.items()
        if (found := next((k for k in known if k in head), None)) is not None
    }
    if "used" in head:
        ours["used"] = head.index("used")
    rows = []
    for number, cells in enumerate(reader, 2):
        if len(cells) < len(head):
            raise InputError(
                f"{len(cells)} columns",
                expected=f"{len(head)} as in the first line",
                where=f"{path}:{number}",
            )
        rows.append({name: cells[at].strip() for name, at in ours.items()})
    return rows


def _required(row: Mapping[str, str], name: str, path: Path) -> str:
    value = row.get(name, "")
    if not value:
        known = " or ".join(NAMES.get(name, (name,))[:3])
        raise InputError(f"no {name}", expected=f"a column {known} with a value in each row", where=path)
    return value


def _number(row: Mapping[str, str], name: str, path: Path, default: float | None = None) -> float:
    text = row.get(name, "").strip()
    if not text:
        if default is None:
            _required(row, name, path)
        return float(default if default is not None else math.nan)
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{name} '{text}'", expected="a number", where=path)
    return value


def _text(path: Path) -> str:
    if not path.is_file():
        raise InputError("file not found", expected="a table", where=path)
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError("no UTF-8 text", expected="a table", where=path, cure="Save it as UTF-8") from error


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:_NAMED]) + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")
