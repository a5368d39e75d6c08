"""What kind of log a file is, by its content; names and endings are not trusted."""

import re
from pathlib import Path
from typing import Final

import numpy as np

from thalweg.core.errors import InputError
from thalweg.core.types import AnyArray

HEAD_BYTES: Final = 65_536

KINDS: Final[dict[str, str]] = {
    "capture": "network capture (pcap, pcapng)",
    "velodyne_payloads": "bare Velodyne payloads",
    "anpp": "Advanced Navigation ANPP log",
    "sbp": "Swift SBP log",
    "pos": "RTKLIB .pos solution",
    "nmea": "NMEA 0183 log",
    "rinex": "RINEX file",
    "sbet": "SBET trajectory",
    "las": "LAS/LAZ cloud",
    "ply": "PLY cloud or mesh",
    "e57": "E57 cloud",
    "calibration": "calibration file",
    "kalibr": "Kalibr camera chain",
    "matrix": "4x4 matrix in a text file",
    "colmap": "COLMAP cameras.txt",
    "opencv": "camera file of OpenCV or ROS",
    "photograph": "photograph (JPEG, PNG, TIFF)",
    "control_points": "table of control points",
    "marks": "table of control points in images",
    "gcp_list": "control points of OpenDroneMap (gcp_list.txt)",
    "metashape_markers": "markers of Metashape (XML)",
    "metashape_cameras": "cameras of Metashape (XML)",
    "orientations": "table of orientations of images",
    "image_times": "table of times of images",
}
"""Kind -> words for people."""

_MAGIC: Final = (
    (b"\xd4\xc3\xb2\xa1", "capture"),
    (b"\xa1\xb2\xc3\xd4", "capture"),
    (b"\x4d\x3c\xb2\xa1", "capture"),
    (b"\xa1\xb2\x3c\x4d", "capture"),
    (b"\x0a\x0d\x0d\x0a", "capture"),
    (b"LASF", "las"),
    (b"ply", "ply"),
    (b"ASTM-E57", "e57"),
    (b"\xff\xd8\xff", "photograph"),
    (b"\x89PNG\r\n\x1a\n", "photograph"),
    (b"II*\x00", "photograph"),
    (b"MM\x00*", "photograph"),
)
_NMEA = re.compile(rb"[$!][A-Z]{2}[A-Z]{3},[^\r\n*]*(\*[0-9A-Fa-f]{2})?")
_POS_LINE = re.compile(
    rb"(?m)^\s*(\d{4}/\d\d/\d\d[ ,;\t]+\d\d:\d\d:\d\d(\.\d+)?|\d{4}[ ,;\t]+\d{1,6}\.\d+)"
    rb"([ ,;\t]+[-\d.:]+){6,}"
)
_TEXTS: Final = (
    ("calibration", re.compile(rb"(?m)^thalweg_calibration[ \t]*:")),
    ("kalibr", re.compile(rb"(?m)^cam0[ \t]*:")),
    (
        "matrix",
        re.compile(
            rb"\A(?:\s*(?:#|//)[^\n]*\n)*(?:[ \t]*(?:[-+.\deE]+(?:[ \t,;]+|(?=[\r\n]|\Z))){4}[\r\n]*){4}\s*\Z"
        ),
    ),
    (
        "colmap",
        re.compile(
            rb"(?m)\A(?:[ \t]*#[^\n]*\n)*\d+[ \t]+[A-Z_]+[ \t]+\d+[ \t]+\d+(?:[ \t]+[-+.\deE]+)+[ \t\r]*$"
        ),
    ),
    (
        "opencv",
        re.compile(
            rb"(?m)^[ \t{]*\"?(?:camera_matrix|cameraMatrix|Camera_Matrix|camera_intrinsics|intrinsic_matrix"
            rb"|K)\"?[ \t]*:"
        ),
    ),
)
"""Files of calibrations, which are text: kind and what its content holds."""

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
_TIMES: Final = frozenset({"time_utc", "unix_s", "t_gps_s"})
"""Headings of tables that people write about photographs, small letters."""

_CONTROL = re.compile(rb"[^\t\n\r\x20-\xff]")
_WRAPPED: Final = (
    (b"\x1f\x8b", "the file is compressed (gzip)", "Unpack it with gunzip"),
    (b"PK\x03\x04", "the file is a zip archive", "Unpack it with unzip"),
    (b"BZh", "the file is compressed (bzip2)", "Unpack it with bunzip2"),
    (b"\xfd7zXZ", "the file is compressed (xz)", "Unpack it with unxz"),
    (b"\xff\xfe", "the file is text in UTF-16", "Save it as plain text (ASCII or UTF-8 without mark)"),
    (b"\xfe\xff", "the file is text in UTF-16", "Save it as plain text (ASCII or UTF-8 without mark)"),
    (
        b"\xef\xbb\xbf",
        "the file begins with a UTF-8 byte order mark",
        "Save it as plain text without the mark",
    ),
)
"""First bytes of files that may be a log in a wrapping: what to say and to do."""

_PAYLOAD = 1206
_SBET_RECORD = 136


def recognise(path: Path) -> str:
    """Kind of a file, one of the keys of `KINDS`.

    Raises
    ------
    InputError : the file is missing, empty, a folder, or of no kind that Thalweg reads.
    """
    if not path.exists():
        raise InputError("file not found", where=path, cure="Check the path")
    if path.is_dir():
        raise InputError("this is a folder", where=path, expected="a file")
    if not path.is_file():
        raise InputError("this is a pipe or a device", where=path, expected="a file")
    try:
        with path.open("rb") as stream:
            head = stream.read(HEAD_BYTES)
    except OSError as error:
        raise InputError(
            f"the file cannot be read: {error.strerror}",
            where=path,
            cure="Check its permissions and the disk",
        ) from error
    if not head:
        raise InputError(
            "the file is empty", where=path, expected="a raw log", cure="Check the logger and copy"
        )
    for magic, kind in _MAGIC:
        if head.startswith(magic):
            return kind
    for kind, matches in (
        ("rinex", _is_rinex),
        ("velodyne_payloads", _is_payloads),
        ("pos", _is_pos),
        ("nmea", _is_nmea),
    ):
        if matches(head):
            return kind
    text = _text_kind(head) or _image_kind(head)
    if text is not None:
        return text
    framed = {"sbp": _sbp_bytes(head), "anpp": _anpp_bytes(head)}
    best = max(framed, key=lambda kind: framed[kind])
    # a tenth: real logs begin with garbage, and a chance CRC match covers a few bytes of 65,536 only
    if framed[best] > 0.1 * len(head):
        return best
    if _is_sbet(head, path.stat().st_size):
        return "sbet"
    for mark, words, cure in _WRAPPED:
        if head.startswith(mark):
            raise InputError(words, where=path, expected="the raw log itself", cure=cure)
    raise InputError(
        f"the content is of no known kind (begins with {head[:12].hex(' ')})",
        where=path,
        expected=", ".join(KINDS.values()),
        cure="Check that the file is a raw log and not compressed",
    )


def _is_rinex(head: bytes) -> bool:
    first = head.split(b"\n", 1)[0]
    return b"RINEX VERSION / TYPE" in first or b"CRINEX VERS" in first


def _is_payloads(head: bytes) -> bool:
    starts = range(0, min(len(head), 8 * _PAYLOAD) - 2, _PAYLOAD)
    return len(head) >= _PAYLOAD and all(head[i : i + 2] == b"\xff\xee" for i in starts)


def _is_pos(head: bytes) -> bool:
    comment = head.startswith(b"%") and (b"GPST" in head or b"UTC" in head or b"JST" in head)
    return comment or (head.isascii() and _POS_LINE.search(head) is not None)


def _is_nmea(head: bytes) -> bool:
    covered = sum(len(found.group()) for found in _NMEA.finditer(head))
    return covered > 0.3 * len(head)


def _text_kind(head: bytes) -> str | None:
    """Kind of a calibration of any program; None for bytes that are no text."""
    if _CONTROL.search(head):
        return None
    return next((kind for kind, pattern in _TEXTS if pattern.search(head)), None)


def _image_kind(head: bytes) -> str | None:
    """Kind of a table that belongs to photographs; None for other bytes."""
    if _CONTROL.search(head):
        return None
    if b"<cameras" in head and b"<document" in head:
        return "metashape_markers" if b"<markers" in head else "metashape_cameras"
    lines = [line.strip() for line in head.removeprefix(b"\xef\xbb\xbf").splitlines() if line.strip()]
    if len(lines) > 1 and _CRS_LINE.match(lines[0]) and len(lines[1].split()) >= 6:
        return "gcp_list"
    for line in lines[:10]:
        cells = re.split(rb"[,;\t]", line.lstrip(b"#").strip().lower())
        names = {re.sub(r"[_ ]\((m|px|deg)\)$", "", c.decode("utf-8", "replace").strip(' "')) for c in cells}
        if names & _IMAGE and {"omega", "phi", "kappa"} <= names:
            return "orientations"
        if names & _IMAGE and names & _POINT and (names & _PIXELS or {"x", "y"} <= names):
            return "marks"
        if names & _IMAGE and names & _TIMES:
            return "image_times"
        if names & _POINT and any(place <= names for place in _PLACES):
            return "control_points"
        if not line.startswith(b"#"):
            break
    return None


def _sbp_bytes(head: bytes) -> int:
    """Bytes of the head inside SBP messages whose CRC is right."""
    from thalweg.ingest.sbp.frames import find_messages

    return _covered(find_messages(np.frombuffer(head, dtype=np.uint8)).length, 8)


def _anpp_bytes(head: bytes) -> int:
    """Bytes of the head inside ANPP frames whose LRC and CRC are right."""
    from thalweg.ingest.anpp.frames import find_packets

    return _covered(find_packets(np.frombuffer(head, dtype=np.uint8)).length, 5)


def _covered(length: AnyArray, frame_bytes: int) -> int:
    return int(length.sum()) + frame_bytes * length.size


def _is_sbet(head: bytes, size: int) -> bool:
    if size < 2 * _SBET_RECORD:
        return False
    for byte_order in "<>":
        records = np.frombuffer(head[: len(head) // _SBET_RECORD * _SBET_RECORD], f"{byte_order}f8").reshape(
            -1, 17
        )
        time, lat, lon, height = records[:, :4].T
        if not np.isfinite(records[:, :4]).all():
            continue
        step = np.diff(time)
        if (
            (np.abs(lat) <= np.pi / 2).all()
            and (np.abs(lon) <= 2 * np.pi).all()
            and (np.abs(height) < 20_000).all()
            # zeros and denormal numbers are bytes of something else: a survey is not at latitude 0.000000
            and (np.abs(lat) > 1e-9).all()
            and (time >= 0).all()
            and (step > 0).mean() > 0.9
            and np.median(step) < 10
        ):
            return True
    return False
