"""Tables of control points and of their marks, as people and other programs write them.

Read are CSV tables with named columns, the CSV of Metashape's reference pane, its XML of markers, and the
``gcp_list.txt`` of OpenDroneMap. Pixels of Metashape and of our own tables count from the upper left corner;
those of OpenDroneMap from the centre of the first pixel (OpenSfM adds the half when it normalises), so half a
pixel is added.
"""

import csv
import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

import numpy as np
from pyproj import CRS
from pyproj.exceptions import CRSError

from thalweg.core.errors import GeometryError, InputError
from thalweg.core.frames import LocalFrame
from thalweg.core.types import ArrayB, ArrayF
from thalweg.images.model.control_points import ControlMarks, ControlPoints
from thalweg.images.model.names import matched

# ---------------------------------------------------------------- tables with named columns as people and
# other programs write them: text to rows by our own names


_NAMED: Final = 5
"""Names that a message lists."""

NAMES: Final[Mapping[str, tuple[str, ...]]] = {
    "id": ("id", "label", "name", "point", "gcp", "marker", "gcp_name"),
    "image": ("image", "photo", "camera", "image_name", "file", "filename", "camera_label"),
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
    "used": ("used",),
}
"""Headings, in small letters, by which a column is known."""

LINE: Final = "line"
"""Key of a row under which the number of its line stands."""


def read_text(path: Path) -> str:
    """Text of a table.

    Raises
    ------
    InputError : no such file, or no text in UTF-8.
    """
    if not path.is_file():
        raise InputError("file not found", expected="a table", where=path)
    data = path.read_bytes()
    if data.startswith(b"PK\x03\x04"):
        raise InputError(
            "a workbook or a zip archive", expected="a table as text", where=path,
            cure="Save the sheet as CSV (UTF-8)",
        )  # fmt: skip
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError("no UTF-8 text", expected="a table", where=path, cure="Save it as UTF-8") from error
    if "\0" in text:
        raise InputError("zero bytes", expected="a table as text", where=path, cure="Save it as CSV (UTF-8)")
    return text


def table_rows(path: Path, text: str, needed: Sequence[str] = ()) -> list[dict[str, str]]:
    """Rows of a table with named columns, by our names of these.

    Decimal commas are read where columns are apart by semicolons or tabs.

    Parameters
    ----------
    needed : our names of columns without which the table is of no use, for the message.

    Raises
    ------
    InputError : an empty table, no headings, or a row that is too short.
    """
    numbered = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    while (
        numbered
        and numbered[0][1].startswith("#")
        and not re.match(r"#\s*label", numbered[0][1], re.IGNORECASE)
    ):
        numbered = numbered[1:]
    if not numbered:
        raise InputError("an empty table", expected="a first line with the names of the columns", where=path)
    first = numbered[0][1].lstrip("#").lstrip()
    numbered = [item for item in numbered[1:] if not item[1].startswith("#")]
    separator = max(",;\t", key=first.count)
    head = [re.sub(r"[_ ]\((m|px|deg|°)\)$", "", name.strip().lower()) for name in _cells(first, separator)]
    ours = {
        name: head.index(found)
        for name, known in NAMES.items()
        if (found := next((k for k in known if k in head), None)) is not None
    }
    lacking = [name for name in needed if name not in ours]
    if lacking and sum(_is_number(cell) for cell in head) >= 2:
        raise InputError(
            f"no names of columns: the first line is '{first[:60]}'",
            expected=f"a first line such as {','.join(needed)}", where=path,
            cure="Write the names of the columns above the numbers",
        )  # fmt: skip
    rows = []
    for number, line in numbered:
        cells = _cells(line, separator)
        if len(cells) < len(head):
            raise InputError(
                f"{len(cells)} columns",
                expected=f"{len(head)} as in the first line",
                where=f"{path}:{number}",
            )
        if separator != ",":
            cells = [re.sub(r"^\s*([-+]?\d+),(\d+)\s*$", r"\1.\2", cell) for cell in cells]
        rows.append({name: cells[at].strip() for name, at in ours.items()} | {LINE: str(number)})
    return rows


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
            f"no {name}", expected=f"a column {known} with a value in each row", where=place_of(row, path)
        )
    return value


def number(row: Mapping[str, str], name: str, path: Path, default: float | None = None) -> float:
    """A finite number, or the default where the row has none.

    Raises
    ------
    InputError : no number, and no default.
    """
    text = row.get(name, "").strip()
    if not text or (default is not None and text.casefold() in ("nan", "none", "-")):
        if default is None:
            required(row, name, path)
        return float(default if default is not None else math.nan)
    if not _is_number(text):
        comma = "" if "," not in text else "Write decimals with a point"
        raise InputError(f"{name} '{text}'", expected="a number", where=place_of(row, path), cure=comma)
    return float(text)


def place_of(row: Mapping[str, str], path: Path) -> str:
    """File and line of a row."""
    return f"{path}:{row[LINE]}" if LINE in row else str(path)


def listed(names: Sequence[str]) -> str:
    """The first names, and how many more."""
    return ", ".join(names[:_NAMED]) + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")


def _cells(line: str, separator: str) -> list[str]:
    return next(csv.reader([line], delimiter=separator))


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


# ---------------------------------------------------------------- coordinates of control points into wcs, and
# what they may be where they lie far from the survey


FAR_M: Final = 10_000.0
"""Distance of control points from the survey beyond which the coordinates are others."""

FORMS: Final = (("east_m", "north_m", "up_m"), ("lat_deg", "lon_deg", "h_ell_m"), ("x", "y", "z"))
"""Columns of coordinates: in the world frame, geodetic, in a CRS."""

_FOOT_M: Final = 0.3048
_UTM: Final = ((32601, 32660), (32701, 32760), (25828, 25838))
"""EPSG codes of zones of UTM that lie beside each other."""


def world_of(values: ArrayF, form: tuple[str, ...], crs: CRS | None, frame: LocalFrame) -> ArrayF:
    """(n, 3) coordinates of one of `FORMS` in wcs.

    Raises
    ------
    GeometryError : coordinates outside of the CRS, or a latitude beyond the poles.
    """
    if form[0] == "east_m":
        return values
    if form[0] == "lat_deg" or (crs is not None and crs.is_geographic):
        lat, lon = (0, 1) if form[0] == "lat_deg" else (1, 0)
        if (np.abs(values[:, lat]) > 90).any() or (np.abs(values[:, lon]) > 360).any():
            raise GeometryError(
                f"latitude {values[0, lat]:g} and longitude {values[0, lon]:g}", expected="degrees"
            )
        return frame.from_geodetic(values[:, lat], values[:, lon], values[:, 2])
    assert crs is not None
    return frame.from_map(values, crs)


def near_world(
    values: ArrayF,
    form: tuple[str, ...],
    crs: CRS | None,
    frame: LocalFrame,
    path: Path,
    *,
    own: bool = False,
) -> ArrayF:
    """The same, refused where the points lie far from the campaign's origin and another reading does not.

    Parameters
    ----------
    own : whether the file itself states its CRS.

    Raises
    ------
    GeometryError : the coordinates are those of another CRS, order or unit; the message says which.
    """
    problem: GeometryError | None = None
    try:
        found = world_of(values, form, crs, frame)
    except GeometryError as error:
        problem, found = error, np.full(values.shape, np.inf)
    away = np.linalg.norm(found, axis=1)
    if problem is None and np.median(away) <= FAR_M:
        return found
    # a place to 10 km tells a CRS, a unit or an order from any other
    other = next((o for o in _readings(values, form, crs, frame) if _median(*o[2:], frame) <= FAR_M), None)
    if other is None:
        if problem is None:
            return found
        raise GeometryError(problem.found, expected=problem.expected, where=path, cure=problem.cure)
    words, cure = other[:2]
    if own:
        cure = cure.replace("Set images.control.crs:", "Correct the CRS that the file states:")
    far = f"control points {np.median(away) / 1000:.0f} km from campaign.origin"
    said = problem.found if problem else far
    raise GeometryError(
        f"{said}; {words} would fit", expected=f"coordinates {_stated(form, crs)}", where=path, cure=cure
    )


def crs_of(text: str | None, path: Path) -> CRS:
    """A CRS by its name, as OpenDroneMap, Metashape and people write it.

    Raises
    ------
    InputError : none is given, or PROJ does not know it.
    """
    if not text:
        raise InputError(
            "coordinates x, y, z without a CRS", expected="its code", where=path,
            cure="Set images.control.crs or campaign.crs, or name the columns east_m, north_m, up_m if they "
            "are in the world frame",
        )  # fmt: skip
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


def _median(values: ArrayF, form: tuple[str, ...], crs: CRS | None, frame: LocalFrame) -> float:
    try:
        found = world_of(values, form, crs, frame)
    except GeometryError:
        return np.inf
    return float(np.median(np.linalg.norm(found[:, :2], axis=1)))


def _readings(
    values: ArrayF, form: tuple[str, ...], crs: CRS | None, frame: LocalFrame
) -> Iterator[tuple[str, str, ArrayF, tuple[str, ...], CRS | None]]:
    """Usual mistakes: words, cure, and the coordinates as they would be meant."""
    world, geodetic, grid = FORMS
    swapped = values[:, [1, 0, 2]]
    swap = "Swap these columns, or their names"
    names = "Name the columns {}, {}, {}"
    pair = "latitude and longitude" if form == geodetic else "east and north"
    yield f"{pair} swapped", swap, swapped, form, crs
    if form != geodetic:
        yield "latitude and longitude", names.format(*geodetic), values, geodetic, None
        yield "longitude and latitude", names.format("lon_deg", "lat_deg", "h_ell_m"), swapped, geodetic, None
    for other in _grids(crs, frame):
        cure = f"Set images.control.crs: EPSG:{other.to_epsg()}"
        if form != grid:
            cure = f"{names.format(*grid)}. {cure}"
        yield other.name, cure, values, grid, other
        zone = np.floor(values[:, 0] / 1e6)
        if (zone >= 1).all() and (zone <= 60).all():
            bare = values - np.stack([zone * 1e6, 0 * zone, 0 * zone], axis=1)
            yield f"{other.name} with the zone before the easting", "Take the zone off", bare, grid, other
    for words, factor in (("millimetres", 1e-3), ("centimetres", 1e-2), ("feet", _FOOT_M)):
        if form != geodetic:
            yield words, "Write the coordinates in metres", factor * values, form, crs
    if form != world:
        yield "coordinates of the world frame", names.format(*world), values, world, None


def _grids(own: CRS | None, frame: LocalFrame) -> list[CRS]:
    """The stated grid, those beside it, and the zones of UTM about the campaign."""
    zone = int((frame.lon_deg + 180) // 6) + 1
    code = None if own is None else own.to_epsg()
    codes = [] if code is None else [code]
    if code is not None and any(low <= code <= high for low, high in _UTM):
        codes += [code - 1, code + 1]
    base = 32600 if frame.lat_deg >= 0 else 32700
    codes += [base + z for z in (zone, zone - 1, zone + 1) if 1 <= z <= 60]
    return [CRS.from_epsg(c) for c in dict.fromkeys(codes) if any(a <= c <= b for a, b in _UTM) or c == code]


def _stated(form: tuple[str, ...], crs: CRS | None) -> str:
    if form[0] == "x" and crs is not None:
        return f"in '{crs.name}'"
    return "of the world frame" if form[0] == "east_m" else "in degrees"


# ---------------------------------------------------------------- control points and marks as other programs
# write them: OpenDroneMap and Metashape
#
# Rows come out as texts by our own names of the columns.


def is_gcp_list(text: str) -> bool:
    """Whether a text begins with a CRS, as ``gcp_list.txt`` does."""
    first = next((line for line in text.splitlines() if line.strip()), "")
    return bool(re.match(r"\s*(EPSG:\d+|WGS84 UTM|\+proj=)", first, re.IGNORECASE))


def gcp_rows(path: Path, text: str) -> list[dict[str, str]]:
    """Rows ``x y z im_x im_y image [name]``; a point without name is known by its coordinates."""
    rows: list[dict[str, str]] = []
    unnamed: dict[tuple[str, ...], str] = {}
    numbered = [(k, line.split()) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    for number, cells in numbered[1:]:
        if cells[0].startswith("#"):
            continue
        if len(cells) < 6:
            raise InputError(
                f"{len(cells)} columns", expected="x y z im_x im_y image [name]", where=f"{path}:{number}"
            )
        name = cells[6] if len(cells) > 6 else unnamed.setdefault(tuple(cells[:3]), f"gcp{len(unnamed) + 1}")
        keys = ("x", "y", "z", "x_px", "y_px", "image")
        rows.append({**dict(zip(keys, cells, strict=False)), "id": name})
    return rows


def gcp_points(path: Path, text: str) -> tuple[list[dict[str, str]], str]:
    """Points of a ``gcp_list.txt``, each once, and its CRS."""
    points: dict[str, dict[str, str]] = {}
    for row in gcp_rows(path, text):
        first = points.setdefault(row["id"], row)
        if any(first[a] != row[a] for a in "xyz"):
            raise InputError(
                f"two places of {row['id']}", expected="the same coordinates in each row", where=path
            )
    return list(points.values()), next(line for line in text.splitlines() if line.strip()).strip()


def _metashape(path: Path, text: str) -> ElementTree.Element:
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(
            f"no XML ({error})", expected="markers as Metashape exports them", where=path
        ) from error
    if root.find(".//markers") is None:
        raise InputError("no markers", expected="markers as Metashape exports them", where=path)
    return root


def metashape_points(path: Path, text: str, crs: str | None) -> tuple[list[dict[str, str]], str | None]:
    """Markers with reference coordinates, and the CRS that the file states, or ``crs``."""
    root = _metashape(path, text)
    rows = []
    for marker in root.iter("marker"):
        reference = marker.find("reference")
        if reference is None or reference.get("x") is None:
            continue
        row = {"id": marker.get("label", ""), **{a: reference.get(a, "") for a in "xyz"}}
        for axis, name in zip("xyz", ("east", "north", "up"), strict=True):
            row[f"sigma_{name}_m"] = reference.get(f"s{axis}") or reference.get("sxyz") or ""
        row["role"] = "control" if reference.get("enabled", "true") in ("true", "1") else "check"
        rows.append(row)
    places = (".//markers/../reference", ".//coordinate_system/wkt", ".//coordinate_system", ".//reference")
    stated = [element.text for place in places if (element := root.find(place)) is not None]
    found = next((t.strip() for t in stated if t and t.strip()), None)
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
            rows.append({
                "image": cameras[camera], "point": labels[point],
                "x_px": location.get("x", ""), "y_px": location.get("y", ""),
            })  # fmt: skip
    return rows, {"placed by the program, not by a person": guessed} if guessed else {}


# ---------------------------------------------------------------- tables


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
