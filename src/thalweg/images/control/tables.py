"""Tables of control points and of their marks, as people and other programs write them.

Read are CSV tables with named columns, the CSV of Metashape's reference pane, its XML of markers, and the
``gcp_list.txt`` of OpenDroneMap. Pixels of Metashape and of our own tables count from the upper left corner;
those of OpenDroneMap from the centre of the first pixel (OpenSfM adds the half when it normalises), so half a
pixel is added.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from thalweg.core.errors import GeometryError, InputError
from thalweg.core.frames import LocalFrame
from thalweg.core.types import ArrayB, ArrayF
from thalweg.images.control.foreign import (
    gcp_points,
    gcp_rows,
    is_gcp_list,
    metashape_marks,
    metashape_points,
)
from thalweg.images.control.place import FORMS, crs_of, near_world
from thalweg.images.control.text import (
    LINE,
    listed,
    number,
    place_of,
    read_text,
    required,
    table_rows,
)
from thalweg.images.model.control_points import ControlMarks, ControlPoints
from thalweg.images.model.names import matched

_ROLES: Final = {
    "": False, "control": False, "control point": False, "gcp": False, "ground control point": False,
    "check": True, "check point": True, "checkpoint": True, "validation": True,
}  # fmt: skip
"""Words for control (false) and check points (true), small letters."""


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
        keep = np.array([name not in images for name in self.image], np.bool_)
        return MarkTable(
            image=tuple(name for name, k in zip(self.image, keep, strict=True) if k),
            point=tuple(name for name, k in zip(self.point, keep, strict=True) if k),
            xy_px=self.xy_px[keep],
            sigma_px=self.sigma_px[keep],
            used=self.used[keep],
            skipped=self.skipped,
        )


def read_control_points(
    path: Path,
    frame: LocalFrame,
    *,
    crs: str | None,
    sigma_m: Sequence[float],
    height_offset_m: float = 0.0,
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
    text, given = read_text(path), crs
    if path.suffix.lower() == ".xml":
        rows, crs = metashape_points(path, text, crs)
    elif is_gcp_list(text):
        rows, crs = gcp_points(path, text)
    else:
        rows = table_rows(path, text, ("id", *FORMS[0]))
    if not rows:
        raise InputError(
            "no control points", expected="at least one row", where=path,
            cure="Add the surveyed points, or let the antenna's positions take their place: "
            "images.adjustment.antenna.use: true",
        )  # fmt: skip
    sigmas = [
        [number(row, f"sigma_{axis}_m", path, number(row, "accuracy", path, default)) for axis, default in
         zip(("east", "north", "up"), sigma_m, strict=True)] for row in rows
    ]  # fmt: skip
    for row, values in zip(rows, sigmas, strict=True):
        if min(values) <= 0:
            raise InputError(
                f"a standard deviation of {min(values):g} m of {row.get('id', '')}",
                expected="metres above zero", where=place_of(row, path),
                cure="State how well the point was surveyed; 0 would make it perfect",
            )  # fmt: skip
    try:
        return ControlPoints(
            names=tuple(required(row, "id", path) for row in rows),
            points_wcs_m=_coordinates(rows, frame, crs, path, height_offset_m, own=crs is not given),
            cov_wcs_m2=np.array([np.diag(np.square(s)) for s in sigmas]),
            check=np.array([_is_check(row, path) for row in rows]),
        )
    except GeometryError as error:
        raise GeometryError(error.found, expected=error.expected, where=path, cure=error.cure) from error


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
    for k, (path, part) in enumerate(zip(paths, parts, strict=True)):
        for other, before in zip(paths[:k], parts[:k], strict=True):
            both = sorted(set(part.names) & set(before.names))
            if both:
                raise InputError(
                    f"{listed(both)} stand{'s' if len(both) == 1 else ''} in {other.name}, too", where=path,
                    expected="each control point in one file",
                    cure="Leave one of the files out, or rename the points",
                )  # fmt: skip
    return ControlPoints.joined(parts)


def _is_check(row: dict[str, str], path: Path) -> bool:
    word = " ".join(row.get("role", "").lower().replace("_", " ").replace("-", " ").split())
    if word not in _ROLES:
        both = "CP is used for control and for check points alike: w" if word == "cp" else "W"
        raise InputError(
            f"the role '{row.get('role', '')}' of {row.get('id', '')}", expected="control or check",
            where=place_of(row, path), cure=f"{both}rite control for points that fix the block",
        )  # fmt: skip
    return _ROLES[word]


def read_marks(path: Path) -> MarkTable:
    """Marks of any of the known forms.

    Raises
    ------
    InputError : no such file, unknown columns, or numbers that are none.
    """
    text = read_text(path)
    skipped: dict[str, int] = {}
    if path.suffix.lower() == ".xml":
        rows, skipped = metashape_marks(path, text)
    elif is_gcp_list(text):
        rows = [
            {"image": r["image"], "point": r["id"], "x_px": r["x_px"], "y_px": r["y_px"]}
            for r in gcp_rows(path, text)
        ]
    else:
        rows = table_rows(path, text, ("image", "point", "x_px", "y_px"))
    xy = np.array([[number(r, "x_px", path), number(r, "y_px", path)] for r in rows]).reshape(-1, 2)
    if is_gcp_list(text):
        xy = xy + 0.5
    return MarkTable(
        image=tuple(required(r, "image", path) for r in rows),
        point=tuple(required(r, "point", path) for r in rows),
        xy_px=xy,
        sigma_px=np.array([number(r, "sigma_px", path, math.nan) for r in rows]),
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
    of_point = _by_case(control.names)
    strange = sorted(name for name in names if index_of[name] < 0)
    unknown = sorted({name for name in table.point if name.strip().casefold() not in of_point})
    for what, names, known, cure in (
        ("images", strange, all_images, "Check the names in the table; they are those of the files"),
        (
            "control points", unknown, control.names,
            "Add their coordinates, or check the names; points without names in a gcp_list.txt are gcp1, "
            "gcp2 and so on",
        ),
    ):  # fmt: skip
        if names:
            raise InputError(
                f"marks of {what} that do not occur: {listed(names)}", where=where, cure=cure,
                expected=f"{what} such as {listed(known[:3])}",
            )  # fmt: skip
    rows, dropped = [], dict(table.skipped)
    seen: set[tuple[int, int]] = set()
    for row, (image, point) in enumerate(zip(table.image, table.point, strict=True)):
        if not table.used[row]:
            dropped["not to be used"] = dropped.get("not to be used", 0) + 1
            continue
        at = index_of[image]
        if at >= len(images):
            dropped["in images without a pose"] = dropped.get("in images without a pose", 0) + 1
            continue
        xy, size = table.xy_px[row], sizes_px[at]
        if not ((xy >= 0).all() and xy[0] <= size[0] and xy[1] <= size[1]):
            raise InputError(
                f"the mark of {point} at ({xy[0]:g}, {xy[1]:g}) in {image}", where=where,
                expected=f"pixels inside of {size[0]} x {size[1]}",
                cure="Check that the marks are those of these images, in the same size",
            )  # fmt: skip
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
    return marks, dropped


def _by_case(names: Sequence[str]) -> dict[str, int]:
    """Index by the name in small letters.

    Raises
    ------
    InputError : two names differ in case only.
    """
    small = sorted((name.strip().casefold(), name) for name in names)
    for (a, one), (b, other) in pairwise(small):
        if a == b:
            raise InputError(
                f"control points {one} and {other}", expected="names that differ in more than their case"
            )
    return {name.strip().casefold(): k for k, name in enumerate(names)}


def _coordinates(
    rows: list[dict[str, str]],
    frame: LocalFrame,
    crs: str | None,
    path: Path,
    height_offset_m: float,
    *,
    own: bool,
) -> ArrayF:
    form = next((f for f in FORMS if all(name in rows[0] for name in f)), None)
    if form is None:
        raise InputError(
            f"columns {', '.join(sorted(set(rows[0]) - {LINE}))}",
            expected="; or ".join(", ".join(f) for f in FORMS),
            where=path,
            cure="Name the columns of the coordinates in the first line",
        )
    values = np.array([[number(row, name, path) for name in form] for row in rows])
    if form[0] != "east_m":
        values[:, 2] += height_offset_m
    return near_world(values, form, crs_of(crs, path) if form[0] == "x" else None, frame, path, own=own)
