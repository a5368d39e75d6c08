"""Tracks in the videos of GoPro cameras (GPMF), read by ``telemetry-parser`` (extra ``gopro``).

HERO5 to HERO11 write GPS5: positions some 18 times a second, and one UTC (GPSU) for each payload of about a
second. The receiver's rate is constant, single stamps are late by more than a second: a line through all of
them (Theil and Sen) times the positions. HERO11 and HERO13 write GPS9: each position has its time.
Both come without standard deviations, and some tenths of a second late by an amount that no document states.
Source: GoPro, gpmf-parser, "GPMF Introduction".
"""

import datetime as dt
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.stats import theilslopes

from thalweg.core import ArrayF, InputError, ThalwegError, frame_of, gps_from_unix, missing_package
from thalweg.ingest import GNSS_POSITION, IntegrityReport, PositionLog, TrackOptions

# keys that the library hands over as the numbers of their four letters
_FIX, _UTC_MS, _ALTITUDE_SYSTEM, _GPS9 = "0x47505346", "0x47505355", "0x47505341", "0x47505339"
_ROW9: Final = np.dtype([("value", ">i4", 7), ("dop", ">u2"), ("fix", ">u2")])
_KLV_HEAD_BYTES: Final = 8
_YEAR_2000_UNIX_S: Final = 946_684_800.0
_FIX_2D: Final = 2
_LATE_S: Final = 0.3
"""Stamps farther than this from the line through all belong to another position than the first."""


def is_gopro(head: bytes, size: int) -> bool:
    """True for an MP4 that a GoPro camera wrote."""
    return head[4:8] == b"ftyp" and b"GoPro" in head[:4096]


def read_gopro(files: Sequence[Path], options: TrackOptions) -> PositionLog:
    """Positions of the camera from the telemetry of its videos.

    Parameters
    ----------
    files : videos (MP4) of one recording in the order of time.
    options : not needed.

    Raises
    ------
    UnsupportedError : telemetry-parser is not installed.
    InputError : no position with a fix: switched off, or a model without a receiver (HERO12).
    """
    report = IntegrityReport.of("pos", "GoPro video (GPMF)", files, time_scale="utc")
    parts = [part for path in files for part in _payloads(path, report)]
    rows = np.concatenate([np.empty((0, 4)), *parts])
    track = pd.DataFrame(rows, columns=["unix_s", "lat_deg", "lon_deg", "fix"])
    held = (track["fix"] >= _FIX_2D) & track["unix_s"].notna()
    if not held.any():
        raise InputError(
            f"{len(track):,} positions, none with a fix",
            expected="a recording with GPS switched on (the HERO12 has no receiver)",
            where=files[0],
            cure="Take the track of another receiver; `thalweg frames` makes photographs of the video",
        )
    report.count_some("positions_without_fix", (~held).sum())
    report.note(
        "Heights of the camera are not taken: they are above mean sea level or without a stated zero."
    )
    report.note(
        "The receiver states no standard deviations, and its positions come some tenths of a second late."
    )
    kept = track[held].sort_values("unix_s", kind="stable").reset_index(drop=True)
    t_gps_s = gps_from_unix(kept["unix_s"].to_numpy())
    report.take_gps_times(t_gps_s, "positions")
    place = {name: kept[name] for name in ("lat_deg", "lon_deg")}
    positions = frame_of(
        GNSS_POSITION, {**place, "t_gps_s": t_gps_s, "fix": "single", "n_sats": -1}, unknown=np.nan
    )
    return PositionLog(report=report, positions=positions)


def _payloads(path: Path, report: IntegrityReport) -> Iterator[ArrayF]:
    """Time (Unix), latitude, longitude, kind of fix (n, 4) of each payload that has positions."""
    try:
        import telemetry_parser
    except ImportError as error:
        raise missing_package(error, path) from error
    report.bytes_read += path.stat().st_size
    try:
        telemetry = telemetry_parser.Parser(str(path)).telemetry()
    except Exception as error:  # the library raises Exception itself
        raise InputError(
            f"a video whose telemetry cannot be read: {error}",
            expected="GPMF as GoPro cameras write it",
            where=path,
            cure="Copy the file from the card again, uncut and with its ending .MP4",
        ) from None
    own_times = [block["GPS9"] for block in telemetry if _GPS9 in block.get("GPS9", {})]
    for block in own_times:
        rows = np.frombuffer(bytes(block[_GPS9])[_KLV_HEAD_BYTES:], _ROW9)
        values = rows["value"] / np.array(block["Scale"], np.float64)[:7]
        t_s = _YEAR_2000_UNIX_S + values[:, 5] * 86_400.0 + values[:, 6]
        yield np.column_stack([t_s, values[:, :2], rows["fix"]])
    blocks: list[dict[str, Any]] = [block["GPS"] for block in telemetry if block.get("GPS", {}).get("Data")]
    if own_times or not blocks:
        return
    counts = np.array([len(block["Data"]) for block in blocks])
    first = np.cumsum(counts) - counts
    fix = np.array([block.get(_FIX, 0) for block in blocks])
    stamps_s = np.array([block.get(_UTC_MS, np.nan) for block in blocks], np.float64) * 1e-3
    told = (fix >= _FIX_2D) & np.isfinite(stamps_s)
    step_s, begin_s = 1.0 / counts[0], np.nan
    if told.sum() > 1:
        step_s, begin_s = theilslopes(stamps_s[told], first[told])[:2]
    elif told.any():
        begin_s = float((stamps_s - first * step_s)[told][0])
    late = told & (np.abs(stamps_s - begin_s - first * step_s) > _LATE_S)
    report.count_some("payloads_with_a_stamp_of_another_second", late.sum())
    for block, at, kind in zip(blocks, first, fix, strict=True):
        values = np.array(block["Data"], np.float64)[:, :2] / np.array(block["Scale"], np.float64)[:2]
        t_s = begin_s + (at + np.arange(len(values))) * step_s
        yield np.column_stack([t_s, values, np.full(len(values), kind)])


def begin_by_gps(video: Path) -> dt.datetime | None:
    """UTC of the first frame of a GoPro video by its receiver; None without a fix or telemetry-parser.

    Positions come at a constant rate from the first frame on, with or without a fix.
    """
    report = IntegrityReport.of("pos", "", [video], time_scale="utc")
    try:
        payloads = list(_payloads(video, report))
    except ThalwegError:
        return None
    told = any((rows[:, 3] >= _FIX_2D).any() for rows in payloads)
    return dt.datetime.fromtimestamp(payloads[0][0, 0], dt.UTC) if told else None
