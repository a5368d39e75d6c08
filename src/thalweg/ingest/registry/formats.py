"""All formats that Thalweg reads: which one a file is of, by its content, and what it holds.

Names and endings of files are not trusted. A new format is a row in the family that it belongs to.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from thalweg.core import InputError, ThalwegError
from thalweg.ingest import IntegrityReport, PositionLog
from thalweg.ingest.registry.base import Format, find_format, read_head
from thalweg.ingest.registry.calibrations import CALIBRATIONS
from thalweg.ingest.registry.clouds import CLOUDS
from thalweg.ingest.registry.converted import CONVERTED
from thalweg.ingest.registry.images import IMAGES
from thalweg.ingest.registry.lidar import LIDARS
from thalweg.ingest.registry.others import OTHERS
from thalweg.ingest.registry.poses import POSES
from thalweg.ingest.registry.positions import POSITIONS, read_depths

FORMATS: Final = (*LIDARS, *CLOUDS, *POSES, *POSITIONS, *CALIBRATIONS, *CONVERTED, *OTHERS, *IMAGES)
"""In the order in which a file is tried against them."""

FORMAT_OF_KIND: Final[Mapping[str, Format]] = {each.kind: each for each in FORMATS}
LIDAR_KINDS: Final = frozenset(each.kind for each in LIDARS)
KINDS: Final[Mapping[str, str]] = {each.kind: each.words for each in FORMATS}
"""Kind -> words for people."""

_INSTRUMENTS: Final = (*LIDARS, *POSITIONS, *POSES, *CLOUDS)
KINDS_OF_STREAM: Final[Mapping[str, tuple[str, ...]]] = {
    **{
        stream: tuple(each.kind for each in _INSTRUMENTS if stream in each.streams)
        for stream in sorted({stream for each in _INSTRUMENTS for stream in each.streams})
    },
    "smrmsg": (),  # known by plausible numbers alone: other ones are no mistake
    "cloud": (*(each.kind for each in CLOUDS), "xyz", "pcd", "geotiff"),
}
"""Kinds of content that fit a stream of ``logs``, empty where it cannot be told; tables that people write,
and pictures, are not judged.
"""

ALSO_MARKS: Final = frozenset({"gcp_list", "metashape_markers"})
"""Kinds of files that hold control points and where they are in the images."""

LOOSE_KINDS: Final[Mapping[str, str]] = {
    **dict.fromkeys(("colmap", "opencv", "metashape_lens"), "interior"),
    **dict.fromkeys(("xyz", "pcd", "geotiff"), "cloud"),
    "image_points": "fixed_marks",
}
"""Kinds that are of use beside certain others only, such as a lens beside photographs, and their streams."""

TABLE_KINDS: Final = frozenset({"track_table", "depth_table"})
"""Told by names of columns alone: what a program exports beside its log (SonTek) is no second log."""

_BINARY: Final = re.compile(rb"[^\t\n\r\x20-\xff]")
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


def recognise(path: Path) -> str:
    """Kind of a file, one of the keys of `KINDS`.

    Raises
    ------
    InputError : the file is missing, empty, a folder, or of no kind that Thalweg reads.
    """
    known = find_format(FORMATS, path)
    if known is not None:
        return known.kind
    head = read_head(path)
    if head.startswith(b"PAR1") and _is_image_poses(path):
        return "image_poses"
    for mark, words, cure in _WRAPPED:
        if head.startswith(mark):
            raise InputError(words, where=path, expected="the raw log itself", cure=cure)
    begins = head[:12].hex(" ") if _BINARY.search(head[:40]) else repr(head[:40].decode("utf-8", "replace"))
    raise InputError(
        f"unrecognised file (begins with {begins})",
        where=path,
        expected="a raw log, a photograph, a cloud, or a table of one of the known forms",
        cure="Check that the file is a raw log and not compressed; the README lists the kinds",
    )


def _is_image_poses(path: Path) -> bool:
    """Whether a Parquet file is a table of poses of photographs: its kind stands at its end."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        return (pq.read_schema(path).metadata or {}).get(b"kind") == b"image_poses"
    except (OSError, pa.ArrowInvalid):
        return False


def stream_of(kind: str, path: Path) -> str | None:
    """Stream of ``logs`` in which a file of a recognised kind belongs; None for kinds without a place.

    A raw GNSS log whose name holds ``base`` or ``ref`` is the base's; RINEX says itself whether it is
    navigation. Photographs in a folder whose name holds ``mask`` are masks.

    Examples
    --------
    >>> stream_of("sbp", Path("base_station.sbp")), stream_of("anpp", Path("boat.bin"))
    ('base', 'ins')
    """
    if kind == "rinex" and _rinex_type(path) in {"N", "G", "H"}:
        return "nav"
    stream = next(iter(_held(kind, path)), None)
    if stream == "time_lapse" and "mask" in path.parent.name.lower():
        return "masks"
    if stream == "rover" and any(mark in path.name.lower() for mark in ("base", "ref")):
        return "base"
    return stream


def also_streams(kind: str, path: Path) -> list[str]:
    """Further streams of ``logs`` that one file of a recognised kind gives, beside that of `stream_of`."""
    row = FORMAT_OF_KIND[kind]
    if row.holds is not None:
        return list(row.holds(path))[1:]
    if "depth" not in row.streams[1:]:
        return []
    try:
        read_depths([path])
    except ThalwegError:
        return []
    return ["depth"]


def what_it_is_for(kind: str, path: Path) -> str:
    """What to do with a file that no stream takes, in words."""
    if kind == "rosbag":
        return "; ".join(describe(path).notes)
    return FORMAT_OF_KIND[kind].use or "no stream of a survey"


def topics_to_choose(kind: str, path: Path) -> dict[str, list[tuple[str, ...]]]:
    """Streams of a container that several topics could give, with these, the likeliest first."""
    return {stream: list(topics) for stream, topics in _held(kind, path).items() if len(topics) > 1}


def _held(kind: str, path: Path) -> Mapping[str, Sequence[tuple[str, ...]]]:
    row = FORMAT_OF_KIND[kind]
    return dict.fromkeys(row.streams[:1], ()) if row.holds is None else row.holds(path)


def _rinex_type(path: Path) -> str:
    """Letter in column 21 of the first line: O observations, N navigation (G, H in RINEX 2)."""
    with path.open("rb") as stream:
        return stream.readline(100)[20:21].decode("ascii", "replace").upper()


def describe(path: Path, options: Mapping[str, Any] | None = None) -> IntegrityReport:
    """Integrity report of one file of any kind that Thalweg reads.

    Parameters
    ----------
    path : the file; its kind is told from its content.
    options : for the reader, see `load_recording`.

    Raises
    ------
    InputError : the file is missing, empty, of no known kind, or damaged beyond reading.
    """
    return load_recording([path], options).report


def load_recording(files: list[Path], options: Mapping[str, Any] | None = None) -> PositionLog:
    """Read a log of any kind.

    Parameters
    ----------
    files : parts of one recording in order of time.
    options : keywords of the reader: of `LidarOptions` or of `TrackOptions`.

    Raises
    ------
    InputError : see `describe`.
    """
    return FORMAT_OF_KIND[recognise(files[0])].read(files, dict(options or {}))
