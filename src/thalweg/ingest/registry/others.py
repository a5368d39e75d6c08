"""Files that lie beside logs and that no stream takes: known by name, with what to do with them.

Unknown, they would be called something else: a surface model in GeoTIFF a photograph, a project of DBAT
cameras of Metashape, camera poses control points.
"""

import re
import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.core import InputError, open_raster, read_dsm, read_metashape
from thalweg.core.values import VECTOR_FORMATS, describe_layers, vector_format
from thalweg.ingest import NAMES, PositionLog, column_of, read_text_table
from thalweg.ingest.registry.base import Format
from thalweg.ingest.registry.calibrations import CalibrationReport, camera_lines, is_text

_GEO_TAGS: Final = frozenset({33550, 33922, 34264, 34735})
"""ModelPixelScale, ModelTiepoint, ModelTransformation, GeoKeyDirectory (OGC 19-008r4)."""
_TAGS: Final = {
    b"II*\x00": ("<", "I", 4, "H", 12),
    b"MM\x00*": (">", "I", 4, "H", 12),
    b"II+\x00": ("<", "Q", 8, "Q", 20),
    b"MM\x00+": (">", "Q", 8, "Q", 20),
}
"""By the first bytes of a TIFF, and of one beyond 4 GB (BigTIFF): order of bytes, kind and place of the
offset of the directory, kind of its number of entries, bytes of each."""
_ANGLES: Final = ({b"yaw", b"pitch", b"roll"}, {b"heading", b"pitch", b"roll"})
_NUMBER: Final = rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_XYZ: Final = re.compile(
    rb"\A(?:[#/][^\n]*\n)*(?:[ \t]*" + (_NUMBER + rb"[ \t,;]+") * 2 + _NUMBER + rb"[^\n]*\n){3}"
)
_LEAST_SURE: Final = 0.05
"""Of what any other kind may be too."""
_QUATERNION: Final = 1e-3
"""By which the length of four numbers may differ from 1 that are a rotation."""


def _is_geotiff(head: bytes, size: int) -> bool:
    """Whether a TIFF states a place on the earth; its directory has to lie within the head."""
    if head[:4] not in _TAGS or len(head) < 16:
        return False
    order, offset, place, number, entry = _TAGS[head[:4]]
    at = struct.unpack_from(order + offset, head, place)[0]
    first = at + struct.calcsize(number)
    if first > len(head):
        return False
    ends = min(first + entry * struct.unpack_from(order + number, head, at)[0], len(head) - 1)
    return any(struct.unpack_from(f"{order}H", head, k)[0] in _GEO_TAGS for k in range(first, ends, entry))


def _cells(head: bytes) -> set[bytes]:
    """Names of columns in the first line of a table, small letters."""
    line = head.removeprefix(b"\xef\xbb\xbf").lstrip(b"#\r\n ").splitlines()[:1]
    return {cell.strip(b' "') for cell in re.split(rb"[,;\t]", (line or [b""])[0].lower())}


def _has(*words: bytes) -> Callable[[bytes, int], bool]:
    """Text in which all words stand."""
    return lambda head, size: is_text(head) and all(word in head for word in words)


def _is_images_bin(head: bytes, size: int) -> bool:
    """COLMAP's images.bin: number of images, then for each a key, a quaternion, a shift, a camera, a name."""
    if len(head) < 73:
        return False
    n, key = struct.unpack_from("<QI", head)
    q = np.array(struct.unpack_from("<4d", head, 12))
    length = float(q @ q) if np.isfinite(q).all() and np.abs(q).max() <= 1.01 else 0.0
    return 0 < n < 10_000_000 and key > 0 and abs(length - 1.0) < _QUATERNION


def _is_images_txt(head: bytes, size: int) -> bool:
    """COLMAP's images.txt: lines ``key qw qx qy qz tx ty tz camera name``, each with a line of points."""
    if not is_text(head):
        return False
    words = next(
        (line.split() for line in head.splitlines() if line.strip() and not line.startswith(b"#")), []
    )
    if len(words) != 10 or not (words[0].isdigit() and words[8].isdigit()):
        return False
    try:
        q = np.array([float(word) for word in words[1:5]])
    except ValueError:
        return False
    return abs(float(q @ q) - 1.0) < _QUATERNION


def _is_pose_table(head: bytes, size: int) -> bool:
    names = _cells(head) if is_text(head) else set()
    return any(angles <= names for angles in _ANGLES) and {b"x", b"y", b"z"} <= {
        n.split(b"/")[0] for n in names
    }


def _columns(*names: bytes) -> Callable[[bytes, int], bool]:
    """A table of these columns and no others."""
    return lambda head, size: is_text(head) and _cells(head) == set(names)


def _names_places(head: bytes) -> bool:
    """Whether the first line of a text names two columns of places, heights or depths."""
    text = head.decode("utf-16" if head[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig", "replace")
    first = next((x.lstrip("#%/! ") for x in text.splitlines() if x.strip("#%/! ")), "")
    words = {column_of(cell).words for cell in re.split(r"[,;|\t]|\s{2,}", first)}
    known = ("lat", "lon", "east", "north", "height", "depth")
    return "\0" not in text and sum(bool(words & set(NAMES[q].split())) for q in known) >= 2


def _is_xyz(head: bytes, size: int) -> bool:
    return is_text(head) and _XYZ.match(head) is not None and b"image" not in _cells(head)


def _is_drawn(kind: str) -> Callable[[bytes, int], bool]:
    """Vectors of this format; of JSON only what has coordinates."""

    def matches(head: bytes, size: int) -> bool:
        """Whether a file begins like this format."""
        if vector_format(head) != kind:
            return False
        return kind != "geojson" or (is_text(head) and b'"type"' in head and b'"coordinates"' in head)

    return matches


def _is_part_of_shapefile(head: bytes, size: int) -> bool:
    """Its index, its coordinate system (ESRI WKT), its encoding, or its table (dBASE III)."""
    if head.startswith(b"\0\0\x27\x0a") or re.match(rb"(PROJ|GEOG|COMPD|LOCAL)(CS|_CS)\[", head):
        return True
    if head.strip().upper() in {b"UTF-8", b"ISO-8859-1", b"ANSI 1252", b"1252", b"LDID/87"}:
        return True
    if len(head) < 33 or head[0] != 3 or not (0 < head[2] <= 12 and 0 < head[3] <= 31):
        return False
    n, begins, row = struct.unpack_from("<IHH", head, 4)
    return begins % 32 == 1 and abs(begins + n * row - size) <= 1


_DRAWN: Final = (
    "banks, islands, a centre line or soundings: `thalweg bed`, `thalweg plan-survey`, logs.bank_lines, "
    "logs.centre_line; areas left out: epochs.leave_out"
)


def _describe(words: str, use: str, kind: str, files: list[Path], options: dict[str, Any]) -> PositionLog:
    report = CalibrationReport.of("other", words, files[:1])
    report.bytes_read = files[0].stat().st_size
    if kind == "geotiff":
        report.details |= _raster(files[0])
        try:
            for sentence in read_dsm(files[0]).notes:
                report.note(sentence.removeprefix(f"{files[0].name}: "))
        except InputError as error:  # a photograph on the map has no heights
            report.note(f"No heights: {error.found}.")
    if kind == "metashape_lens":
        report.details["camera"] = camera_lines(read_metashape(files[0]))
    if kind in ("table", "xyz"):
        _tell_table(files[0], report)
    if kind in VECTOR_FORMATS:
        report.details |= _drawn(files[0], report)
    report.details["use"] = use
    return PositionLog(report=report)


def _tell_table(path: Path, report: CalibrationReport) -> None:
    """Columns of a table with what they hold, rows, and what is left out of them."""
    table = read_text_table(path, bare=("x", "y", "z"))
    report.count("rows", len(table))
    told = []
    for k, column in enumerate(table.columns):
        quantity = next((q for q in NAMES if column.words in NAMES[q].split()), "")
        unit = column.unit.name if column.unit is not None else column.foreign
        told.append(" ".join(filter(None, (column.name, f"= {quantity}" if quantity else "", unit))))
        if quantity in ("lat", "lon", "east", "north", "height", "depth"):
            values = table.angles(quantity) if quantity in ("lat", "lon") else table.numbers(k, quantity)
            if np.isfinite(values).any():
                told[-1] += f" {np.nanmin(values):.10g} .. {np.nanmax(values):.10g}"
    report.details["columns"] = "; ".join(told)
    for sentence in (*table.notes, *table.loss_notes()):
        report.note(sentence)


def _drawn(path: Path, report: CalibrationReport) -> dict[str, str]:
    """A line for each layer of a file of vectors."""
    try:
        layers = describe_layers(path)
    except InputError as error:
        report.note(str(error))
        return {}
    return {
        f"layer {of['name']}": f"{of['n']:,} {of['geometry']}, coordinate system: {of['crs']}"
        for of in layers
    }


def _raster(path: Path) -> dict[str, str]:
    """Size, cell, reference system and gaps of a raster."""
    with open_raster(path, whole=False) as source:
        nodata = "none stated" if source.nodata is None else f"{source.nodata:g}"
        return {
            "size": f"{source.width} x {source.height} cells of {source.res[0]:g} x {source.res[1]:g}, "
            f"{source.count} band{'s' if source.count > 1 else ''}",
            "crs": source.crs.to_string() if source.crs else "none stated",
            "nodata": nodata,
        }


def _other(
    kind: str,
    words: str,
    use: str,
    matches: Callable[[bytes, int], float] | None,
    magic: tuple[bytes, ...] = (),
) -> Format:
    return Format(
        kind=kind, words=words, use=use, magic=magic, matches=matches, describe=partial(_describe, words, use)
    )


OTHERS: Final = (
    _other(
        "geotiff", "raster of heights (GeoTIFF)", "`thalweg compare-clouds` takes surface models", _is_geotiff
    ),
    _other(
        "dbat_project",
        "project of the Damped Bundle Adjustment Toolbox (XML)",
        "its tables of points and marks, with names of columns, belong in logs.time_lapse",
        _has(b"dbat_script_version"),
    ),
    _other(
        "dbat_camera",
        "camera of the Damped Bundle Adjustment Toolbox (XML)",
        "its distortion corrects measured places, ours ideal ones: leave it out, the lens is estimated",
        _has(b"dbat_camera_version"),
    ),
    _other(
        "dbat_report",
        "report of the Damped Bundle Adjustment Toolbox",
        "a result, no input",
        _has(b"Damped Bundle Adjustment Toolbox result"),
    ),
    _other(
        "metashape_lens",
        "lens of Metashape (XML)",
        "`thalweg import-camera`, or logs.time_lapse.interior",
        _has(b"<calibration>", b"<projection>"),
    ),
    _other(
        "colmap_images",
        "orientations of COLMAP (images.txt)",
        "name the folder of the model in logs.time_lapse.orientations",
        _is_images_txt,
    ),
    _other(
        "colmap_images_bin",
        "orientations of COLMAP (images.bin)",
        "name the folder of the model in logs.time_lapse.orientations",
        _is_images_bin,
    ),
    _other(
        "camera_poses",
        "camera poses with yaw, pitch, roll",
        "export them with omega, phi, kappa: logs.time_lapse.orientations",
        _is_pose_table,
    ),
    _other(
        "image_points",
        "points of one image (label, x, y)",
        "one table of all images, with a column image: logs.time_lapse.marks, `thalweg resect`",
        _columns(b"label", b"x", b"y"),
    ),
    _other(
        "corners",
        "corners of a checkerboard",
        "`thalweg calibrate-lens`",
        _columns(b"image", b"column", b"row", b"x_px", b"y_px"),
    ),
    _other(
        "table",
        "table with named columns",
        "`thalweg bed` for soundings, `thalweg compare` for clouds",
        lambda head, size: _LEAST_SURE if _names_places(head) else 0.0,
    ),
    _other(
        "xyz",
        "points as text (x, y, z)",
        "`thalweg bed` for soundings, `thalweg compare` for clouds",
        _is_xyz,
    ),
    *(
        _other(kind, f"points, lines or areas ({name})", _DRAWN, _is_drawn(kind))
        for kind, name in VECTOR_FORMATS.items()
    ),
    _other(
        "shapefile_part",
        "part of a Shapefile (.shx, .dbf, .prj, .cpg)",
        "keep it beside the .shp of the same name",
        _is_part_of_shapefile,
    ),
    _other(
        "pcd", "PCD cloud", "logs.calibration.board_scans", None, (b"# .PCD", b"VERSION .7", b"VERSION 0.7")
    ),
    _other("sqlite", "SQLite database", "of COLMAP: export its model", None, (b"SQLite format 3\x00",)),
)
