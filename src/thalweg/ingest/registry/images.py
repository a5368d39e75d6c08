"""Formats of photographs and of the tables beside them, and what they hold in lines for a terminal."""

import re
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.core import ClockError
from thalweg.ingest import PositionLog, read_text
from thalweg.ingest.photos import CivilStamp, read_head, read_image_stamps
from thalweg.ingest.registry.base import Format
from thalweg.ingest.registry.calibrations import CalibrationReport, is_text

_TABLES: Final = (
    (
        "metashape_markers",
        "markers of Metashape (XML)",
        "control_points",
        "logs.time_lapse.control_points and logs.time_lapse.marks",
    ),
    (
        "metashape_cameras",
        "cameras of Metashape (XML)",
        "finished_orientations",
        "logs.time_lapse.orientations",
    ),
    (
        "gcp_list",
        "control points of OpenDroneMap (gcp_list.txt)",
        "control_points",
        "logs.time_lapse.control_points and logs.time_lapse.marks",
    ),
    (
        "orientations",
        "table of orientations of images",
        "finished_orientations",
        "logs.time_lapse.orientations",
    ),
    ("camera_positions", "table of positions of the camera", "camera_positions", "logs.time_lapse.positions"),
    ("marks", "table of control points in images", "image_marks", "logs.time_lapse.marks"),
    ("image_times", "table of times of images", "time_lapse_times", "logs.time_lapse.times"),
    ("control_points", "table of control points", "control_points", "logs.time_lapse.control_points"),
)
"""Kind, words, stream, and the keys of a campaign file that the table belongs in."""

_POSES: Final = "poses of photographs (image_poses.parquet of Thalweg)"
_PHOTOGRAPH: Final = "photograph (JPEG, PNG, TIFF)"

_CRS_LINE: Final = re.compile(rb"\s*(EPSG:\d+|WGS84 UTM|\+proj=)", re.IGNORECASE)
_IMAGE: Final = frozenset({"image", "photo", "camera", "image_name", "file", "filename", "camera_label"})
_POINT: Final = frozenset({"id", "label", "name", "point", "gcp", "marker", "gcp_name", "marker_label"})
_PIXELS: Final = frozenset({"x_px", "u", "u_px", "im_x", "image_u"})
_PLACES: Final = (
    {"east_m", "north_m", "up_m"},
    {"lat_deg", "lon_deg", "h_ell_m"},
    {"latitude", "longitude"},
    {"easting", "northing"},
    {"east", "north"},
    {"x", "y", "z"},
    {"x/easting", "y/northing"},
    {"x/east", "y/north"},
    {"x/longitude", "y/latitude"},
)
_PICTURE: Final = re.compile(rb"[^,;\t]+\.(jpe?g|png|tiff?)\b", re.IGNORECASE)
"""First cell of a row that names a picture: what stands there is no surveyed point but a camera."""
_TIMES: Final = frozenset({"time_utc", "unix_s", "t_gps_s"})
"""Headings of tables that people write about photographs, small letters."""


def _photograph(kind: str, files: list[Path], options: dict[str, Any]) -> PositionLog:
    head = read_head(files[0])
    report = CalibrationReport.of("camera", _PHOTOGRAPH, files[:1])
    report.model = f"{head.make} {head.model}".strip()
    report.details["size"] = f"{head.width} x {head.height} pixels"
    if np.isfinite(head.focal_mm):
        report.details["lens"] = f"{head.focal_mm:g} mm by EXIF"
    try:
        stamps = read_image_stamps(files[0])
    except ClockError as error:
        report.note(error.found)
    else:
        known = stamps.table["source"][0]
        changed = ", of the last change of the file" if head.of_change else ""
        report.details["time"] = _civil(head.stamp) + changed if known == "exif" else f"from {known}"
        report.details["gps time"] = f"{stamps.table['t_device_s'][0]:.3f} s less 1e9"
    return PositionLog(report=report)


def _table(kind: str, words: str, stream: str, keys: str) -> Format:
    """A table that belongs to photographs, in ``keys`` of a campaign file."""

    def told(kind: str, files: list[Path], options: dict[str, Any]) -> PositionLog:
        """What the table holds, in lines for a terminal."""
        text, notes = read_text(files[0])
        report = CalibrationReport.of("images", words, files[:1], notes=notes)
        if kind.startswith("metashape"):
            counted = {
                name: len(re.findall(rf"<{name}\s", text)) for name in ("camera", "marker", "location")
            }
            report.details["holds"] = ", ".join(f"{n} elements {name}" for name, n in counted.items() if n)
        else:
            lines = [line for line in text.splitlines() if line.strip()]
            report.details["begins"] = lines[0].strip()[:100]
            report.details["rows"] = str(len(lines) - 1)
        report.details["belongs"] = f"in {keys} of a campaign file"
        return PositionLog(report=report)

    return Format(
        kind=kind,
        words=words,
        streams=(stream,),
        matches=lambda head, _: _image_kind(head) == kind,
        describe=told,
    )


def _civil(stamp: CivilStamp | None) -> str:
    """Date and time as the camera's clock showed them, and on which scale."""
    if stamp is None:
        return "none"
    shown = datetime.fromtimestamp(stamp.second_s, tz=UTC).strftime("%Y-%m-%d %H:%M:%S")
    if stamp.utc_offset_s is None:
        return f"{shown} by EXIF, zone not stated: read as UTC"
    return f"{shown} by EXIF, UTC {stamp.utc_offset_s / 3600:+g} h"


@lru_cache(maxsize=1)
def _image_kind(head: bytes) -> str | None:
    """Kind of a table that belongs to photographs; None for other bytes."""
    if not is_text(head):
        return None
    if b"<cameras" in head and b"<chunk" in head and b"<document" in head:
        return "metashape_markers" if b"<markers" in head else "metashape_cameras"
    lines = [line.strip() for line in head.removeprefix(b"\xef\xbb\xbf").splitlines() if line.strip()]
    if len(lines) > 1 and _CRS_LINE.match(lines[0]) and len(lines[1].split()) >= 6:
        return "gcp_list"
    for k, line in enumerate(lines[:10]):
        cells = re.split(rb"[,;\t]", line.lstrip(b"#").strip().lower())
        names = {re.sub(r"[_ ]\((m|px|deg)\)$", "", c.decode("utf-8", "replace").strip(' "')) for c in cells}
        if names & _IMAGE and {"omega", "phi", "kappa"} <= names:
            return "orientations"
        if names & _IMAGE and names & _POINT and (names & _PIXELS or {"x", "y"} <= names):
            return "marks"
        if names & _IMAGE and names & _TIMES:
            return "image_times"
        if names & _IMAGE and any(place <= names for place in _PLACES):
            return "camera_positions"
        if names & _POINT and any(place <= names for place in _PLACES):
            named = lines[k + 1 : k + 2]
            return "camera_positions" if named and _PICTURE.match(named[0]) else "control_points"
        if not line.startswith(b"#"):
            break
    return None


def _describe_poses(kind: str, files: list[Path], options: dict[str, Any]) -> PositionLog:
    import pyarrow.parquet as pq

    report = CalibrationReport.of("images", _POSES, files[:1])
    report.details["rows"] = str(pq.read_metadata(files[0]).num_rows)
    report.details["belongs"] = "in logs.time_lapse.orientations of a campaign file"
    return PositionLog(report=report)


IMAGES: Final = (
    Format(
        kind="photograph",
        words=_PHOTOGRAPH,
        streams=("time_lapse",),
        magic=(b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n", b"II*\x00", b"MM\x00*"),
        describe=_photograph,
    ),
    *(_table(*row) for row in _TABLES),
    Format(
        kind="image_poses",
        words=_POSES,
        streams=("finished_orientations",),
        matches=lambda head, size: 0.0,  # told by the end of the file: `recognise`
        describe=_describe_poses,
    ),
)
