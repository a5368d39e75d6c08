"""Frames of a video as photographs, with a table of their times and what these are worth.

The container of MP4 and MOV (ISO/IEC 14496-12) states when it was made, in whole seconds since 1904, UTC,
of which the middle is taken; each frame has a time of presentation from its first one. Cameras differ in
whether they write the begin or the end of the recording, and some write local time: where the begin is known
better it should be stated.
"""

import datetime as dt
import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core import AnyArray, ArrayF, InputError, optional

cv2 = optional("cv2")

_EPOCH: Final = dt.datetime(1904, 1, 1, tzinfo=dt.UTC)
_WHOLE_SECOND_S: Final = 1.0 / math.sqrt(12.0)
"""Standard deviation of what is cut to whole seconds."""
_QUALITY: Final = 95
"""Of the JPEG files: its errors are below those of a video."""
_DIGITS: Final = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoFrames:
    """Frames that were written.

    Parameters
    ----------
    table : a row a frame: ``file``, ``time_utc`` (ISO 8601, for `thalweg.ingest.photos.read_image_stamps`),
        ``since_begin_s``.
    sigma_offset_s : standard deviation that the times of all frames share.
    jitter_s : standard deviation of single frames about their times.
    notes : what is uncertain, for people.
    """

    table: pd.DataFrame
    sigma_offset_s: float
    jitter_s: float
    notes: tuple[str, ...]


def container_time(path: Path) -> dt.datetime | None:
    """When an MP4 or MOV file says it was made, UTC; None where it says nothing.

    Raises
    ------
    InputError : no such container.
    """
    data = _movie_header(path)
    if data is None:
        raise InputError("no MP4 or MOV container", expected="a box moov with mvhd", where=path)
    seconds = struct.unpack_from(">Q", data, 4)[0] if data[0] == 1 else struct.unpack_from(">I", data, 4)[0]
    return _EPOCH + dt.timedelta(seconds=seconds) if seconds else None


def _movie_header(path: Path) -> bytes | None:
    """Content of the box ``mvhd`` (version, flags, creation time, ...)."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        at = 0
        while at + 16 <= size:
            stream.seek(at)
            length, kind, wide = struct.unpack(">I4sQ", stream.read(16))
            header = 16 if length == 1 else 8
            length = wide if length == 1 else size - at if length == 0 else length
            if length < header:
                return None
            if kind == b"moov":
                stream.seek(at + header)
                inner = stream.read(8)
                found = inner[4:8] == b"mvhd" and struct.unpack(">I", inner[:4])[0] >= 20
                return stream.read(32) if found else None
            at += length
    return None


def write_frames(
    video: Path,
    folder: Path,
    *,
    every_s: float = 0.0,
    begin: dt.datetime | None = None,
    sigma_begin_s: float | None = None,
) -> VideoFrames:
    """Write frames of a video as JPEG, and ``times.csv`` beside them.

    Parameters
    ----------
    video : MP4, MOV, or what OpenCV reads if ``begin`` is given.
    folder : made if it is not there; frames are called ``<video>_000012.jpg`` by their number.
    every_s : time between frames that are written; 0: all.
    begin : UTC of the first frame, with zone; None: of the container.
    sigma_begin_s : its standard deviation; None: that of a whole second, and only for the container's time.

    Raises
    ------
    InputError : no video, no frame, times of frames that do not grow, or no time.
    """
    notes = []
    if begin is None:
        begin = container_time(video)
        if begin is None:
            raise InputError(
                "the container does not say when it was made",
                expected="a time of the first frame",
                where=video,
                cure="State it: --begin 2026-05-12T09:30:00Z --sigma-begin 0.5",
            )
        notes.append(
            f"Begin {begin:%Y-%m-%dT%H:%M:%SZ} as the container says, cut to whole seconds (half a second is "
            "added): some cameras write the end of the recording, or local time"
        )
        begin += dt.timedelta(seconds=0.5)
        sigma = _WHOLE_SECOND_S if sigma_begin_s is None else sigma_begin_s
    elif begin.tzinfo is None or sigma_begin_s is None:
        raise InputError(
            f"a begin {begin.isoformat()} without zone or standard deviation",
            expected="UTC, and how well it is known",
            cure="Write --begin 2026-05-12T09:30:00Z --sigma-begin 0.5",
        )
    else:
        sigma = sigma_begin_s
    folder.mkdir(parents=True, exist_ok=True)
    rows: list[tuple[str, str, float]] = []
    times: list[float] = []
    due = 0.0
    for number, t_s, picture in _frames(video):
        if times and t_s <= times[-1]:
            raise InputError(
                f"frame {number} at {t_s:.4f} s, not behind the one before",
                expected="times that grow",
                where=video,
                cure="Write the video anew: ffmpeg -i IN -c copy -fflags +genpts OUT",
            )
        times.append(t_s)
        if t_s + 1e-9 < due:
            continue
        due = (math.floor(t_s / every_s + 1e-9) + 1) * every_s if every_s > 0 else 0.0
        name = f"{video.stem}_{number:06d}.jpg"
        if not cv2.imwrite(str(folder / name), picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY]):
            raise InputError("the frame could not be written", where=folder / name)
        when = begin.astimezone(dt.UTC) + dt.timedelta(seconds=t_s)
        rows.append((name, f"{when:%Y-%m-%dT%H:%M:%S.%f}Z", round(t_s, _DIGITS)))
    if not rows:
        raise InputError("no frame", expected="a video that OpenCV can decode", where=video)
    table = pd.DataFrame(rows, columns=["file", "time_utc", "since_begin_s"])
    table.to_csv(folder / "times.csv", index=False)
    jitter = _jitter_s(np.array(times))
    return VideoFrames(table=table, sigma_offset_s=sigma, jitter_s=jitter, notes=tuple(notes))


def _frames(video: Path) -> Iterator[tuple[int, float, AnyArray]]:
    """Number, seconds since the first frame, and picture (h, w, 3) of each frame."""
    with video.open("rb") as stream:
        capture = cv2.VideoCapture(stream, cv2.CAP_FFMPEG, [])  # any reader
        if not capture.isOpened():
            raise InputError("no video that OpenCV can decode", expected="MP4 or MOV", where=video)
        first, number = math.nan, 0
        while True:
            good, picture = capture.read()
            if not good:
                break
            t_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
            first = t_s if math.isnan(first) else first
            yield number, t_s - first, picture
            number += 1
        capture.release()


def _jitter_s(times_s: ArrayF) -> float:
    """Scatter of frames about a constant rate; at least what whole milliseconds cut off.

    A container may state a constant rate that the sensor did not keep: nothing in the file tells that.
    """
    least = 1e-3 / math.sqrt(12.0)
    if len(times_s) < 3:
        return least
    number = np.arange(len(times_s))
    left = times_s - np.polyval(np.polyfit(number, times_s, 1), number)
    return max(float(left.std(ddof=2)), least)
