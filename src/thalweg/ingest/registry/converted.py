"""Recordings that are read after another program has converted them: known by name, with what to do."""

from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.ingest import PositionLog
from thalweg.ingest.registry.base import Format
from thalweg.ingest.registry.calibrations import CalibrationReport, is_text

_OF_PICTURES: Final = (b"heic", b"heix", b"heim", b"heis", b"mif1", b"msf1", b"avif", b"avis")
"""Brands of containers (ISO/IEC 14496-12) that hold photographs (23008-12), no videos."""


def _is_humminbird(head: bytes, size: int) -> bool:
    """Records of a channel (SON), places of these in it and their times (IDX), or the head of all (DAT)."""
    if head.startswith(b"\xc0\xde\xab\x21"):
        return True
    if size == 64 and head[:2] in (b"\xc1\0", b"\xc3\0") and b".SON" in head:
        return True
    pairs = np.frombuffer(head[: len(head) // 8 * 8], ">u4").reshape(-1, 2).astype(np.int64)
    grow = len(pairs) > 3 and size % 8 == 0 and pairs[0, 1] == 0 and bool((np.diff(pairs[:, 1]) > 64).all())
    return grow and bool((np.diff(pairs[:, 0]) >= 0).all())


def _describe(words: str, use: str, kind: str, files: list[Path], options: dict[str, Any]) -> PositionLog:
    size = files[0].stat().st_size
    report = CalibrationReport.of("other", words, files[:1], bytes_read=size)
    report.details["use"] = use
    return PositionLog(report=report)


CONVERTED: Final = tuple(
    Format(kind=kind, words=words, use=use, matches=matches, describe=partial(_describe, words, use))
    for kind, words, use, matches in (
        (
            "tcx",
            "workout (TCX)",
            "convert it to GPX: logs.positions, logs.depth",
            lambda head, size: is_text(head) and b"<TrainingCenterDatabase" in head,
        ),
        (
            "fit",
            "recording of a watch or sounder (FIT)",
            "convert it to GPX with the depths: logs.positions, logs.depth",
            lambda head, size: head[8:12] == b".FIT",
        ),
        (
            "humminbird",
            "recording of a Humminbird (DAT, SON, IDX)",
            "not read: export it with its places as CSV, by PINGMapper or SonarTRX, for `thalweg bed`",
            _is_humminbird,
        ),
        (
            "hypack",
            "raw data of Hypack (RAW, HSX)",
            "not read: export soundings with places as XYZ from Hypack, for `thalweg bed`",
            lambda head, size: head.startswith((b"FTP NEW", b"FTP HYP")) and b"\nTND " in head,
        ),
        (
            "riversurveyor",
            "raw recording of a SonTek ADCP (RIV, RIVR)",
            "not read: export it from RiverSurveyor Live as MATLAB, or as ASCII for `thalweg bed`",
            lambda head, size: head.startswith(b"YDFF") and b"Sontek" in head[:16],
        ),
        (
            "heif",
            "photograph as HEIF (HEIC, AVIF)",
            "not read: convert it to JPEG that keeps its EXIF, or set the camera to JPEG",
            lambda head, size: head[4:8] == b"ftyp" and head[8:12] in _OF_PICTURES,
        ),
        (
            "video",
            "video (MP4, MOV)",
            "`thalweg frames` makes photographs of it with a table of their times",
            lambda head, size: head[4:8] == b"ftyp" and head[8:12] not in _OF_PICTURES,
        ),
    )
)
