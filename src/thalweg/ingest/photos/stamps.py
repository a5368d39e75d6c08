"""When photographs were taken, as the camera's clock says: from file names, from EXIF, or from a table.

The camera's clock shows UTC, or local time with an offset from UTC. Its stamps are put on the axis of
adjusted GPS time *as if that clock were right*: ``t_device_s = UTC shown + (GPS - UTC)``. What is wrong with
the clock is then one small number, ``t_gps_s = t_device_s + dt`` (P2 3.2), and no zone or leap second hides
in it.
"""

import datetime as dt
import logging
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Final, Literal

import numpy as np
import pandas as pd
import pyarrow as pa

from thalweg.core import (
    ArrayF,
    ClockError,
    InputError,
    column,
    frame_of,
    gps_from_unix,
    table_kind,
    unix_from_gps,
)
from thalweg.ingest import (
    IntegrityReport,
    TrackOptions,
    doubtful_date,
    explain_shift,
    find_gaps,
    possible_unix,
    read_head as read_raw_head,
    read_text_table,
    tell_time_scale,
    time_scale_words,
)
from thalweg.ingest.photos.exif import CivilStamp, ImageHead, civil_second, offset_seconds, read_head
from thalweg.ingest.photos.files import (
    by_any_name,
    files_by_name,
    find_images,
    list_images,
    named_images,
    natural_key,
)

log = logging.getLogger("thalweg")

# ---------------------------------------------------------------- times in the names of photographs: the
# usual patterns, and a pattern of the user


_TOKENS: Final = {
    "%Y": r"(?P<Y>\d{4})",
    "%m": r"(?P<m>\d\d)",
    "%d": r"(?P<d>\d\d)",
    "%H": r"(?P<H>\d\d)",
    "%M": r"(?P<M>\d\d)",
    "%S": r"(?P<S>\d\d)",
    "%f": r"(?P<f>\d{1,9})",
    "%s": r"(?P<s>\d{9,10})",
    "%%": "%",
    "*": r".*?",
}

_USUAL: Final = (
    # R20210512_083107123, IMG_20210512_083107_123, 2021-05-12T08-31-07.123, PXL_20210512_083107123
    re.compile(
        r"(?<!\d)(?P<Y>(?:19|20)\d\d)[-_.:]?(?P<m>[01]\d)[-_.:]?(?P<d>[0-3]\d)[-_.T ]{0,3}"
        r"(?P<H>[0-2]\d)[-_.:h]?(?P<M>[0-5]\d)[-_.:m]?(?P<S>[0-5]\d)(?:[-_., s]?(?P<f>\d{9}|\d{6}|\d{3}))?"
        r"(?:(?P<z>Z|\+(?:0\d|1[0-4])[-_.:]?(?:[034]0|[14]5))(?![0-9A-Za-z]))?(?!\d)"
        r"(?: ?(?P<half>[AaPp])[Mm]\b)?"
    ),
    # Unix time in ms, us or ns, 1620808267123, and in seconds with a fraction, 1620808267.123
    re.compile(r"(?<!\d)(?P<s>1\d{9})[._]?(?P<f>\d{9}|\d{6}|\d{3})(?!\d)"),
)


def stamp_from_name(stem: str, pattern: str | None = None) -> CivilStamp | None:
    """Time in the name of a file without its ending; None if there is none.

    The usual names are year to second with or without separators, with three, six or nine digits behind the
    second or none, then maybe ``Z`` or ``+02:00``; and Unix time in ms, us or ns.

    Parameters
    ----------
    stem : name without folder and ending.
    pattern : the user's own, see `compile_pattern`.

    Examples
    --------
    >>> stamp_from_name("R20210512_083107125").shown_s
    1620808267.125
    >>> stamp_from_name("1620808267125").resolution_s
    0.001
    >>> stamp_from_name("boat 12.05.2021 083107", "*%d.%m.%Y %H%M%S").shown_s
    1620808267.0
    """
    for form in [compile_pattern(pattern)] if pattern else _USUAL:
        found = form.fullmatch(stem) if pattern else form.search(stem)
        if not found:
            continue
        parts = found.groupdict()
        digits = parts.get("f") or ""
        if parts.get("s"):
            second: int | None = int(parts["s"])
        else:
            if half := parts.get("half"):  # of the day, on a clock of twelve hours
                parts["H"] = str(int(parts["H"]) % 12 + (12 if half in "pP" else 0))
            second = civil_second(*(int(parts.get(name) or 0) for name in "YmdHMS"))
        if second is None or not possible_unix(second):
            continue
        return CivilStamp(
            second_s=second,
            fraction_s=int(digits) / 10 ** len(digits) if digits else 0.0,
            resolution_s=10.0 ** -len(digits),
            utc_offset_s=offset_seconds(re.sub(r"[-_.]", ":", parts.get("z") or "")),
        )
    return None


def compile_pattern(pattern: str) -> re.Pattern[str]:
    """The user's pattern for names without ending: %Y %m %d %H %M %S, %f (fraction), %s (Unix), * (any).

    Raises
    ------
    InputError : the pattern holds no full time, an unknown token or a token twice.
    """
    text, expression, seen = pattern, "", set()
    while text:
        head = text[:2] if text[0] == "%" else text[0]
        if head[0] == "%" and head not in _TOKENS:
            raise InputError(
                f"the pattern '{pattern}' holds '{head}'", expected="%Y %m %d %H %M %S %f %s, * or plain text"
            )
        if head in seen:
            raise InputError(f"the pattern '{pattern}' holds '{head}' twice", expected="each part once")
        if len(head) == 2 and head != "%%":
            seen.add(head)
        expression += _TOKENS.get(head, re.escape(head))
        text = text[len(head) :]
    if not ({"%Y", "%m", "%d", "%H", "%M", "%S"} <= seen or "%s" in seen):
        raise InputError(
            f"the pattern '{pattern}' holds no full time",
            expected="%Y %m %d %H %M %S, or %s",
            cure="A name without date cannot be placed: give a table of times instead",
        )
    return re.compile(expression)


# ---------------------------------------------------------------- times of photographs from a table that a
# person or another program wrote


TIME_COLUMNS: Final = ("time_utc", "unix_s", "t_gps_s")
"""ISO 8601 text (UTC, or with its own offset), Unix time, or adjusted GPS time."""


def read_time_table(path: Path) -> dict[str, CivilStamp]:
    """Stamps by file name, from a CSV table with the columns ``file`` and one of `TIME_COLUMNS`.

    An empty cell is an image without time. The unit of a stamp is that of its last digit.

    Raises
    ------
    InputError : the table is missing, lacks a column, or holds a time that is none, or a file twice.
    """
    table = read_text_table(path)
    for note in table.notes:
        log.warning("%s: %s", path.name, note)
    at = {column.name.lower(): k for k, column in enumerate(table.columns)}
    known = [name for name in TIME_COLUMNS if name in at]
    if "file" not in at or len(known) != 1:
        raise InputError(
            f"columns {table.listed()}",
            where=path,
            expected=f"the columns file and one of {', '.join(TIME_COLUMNS)}",
            cure="Name the columns in the first line",
        )
    out: dict[str, CivilStamp] = {}
    for file, value, line in zip(table.text(at["file"]), table.text(at[known[0]]), table.line, strict=True):
        where = f"{path}:{line}"
        if not file:
            raise InputError("a row without file name", where=where, expected="the name of an image")
        if file in out:
            raise InputError(f"'{file}' stands there twice", where=where, expected="each image once")
        if value:
            out[file] = _stamp(value, known[0], where)
    return out


def _stamp(text: str, form: str, where: str) -> CivilStamp:
    digits = len(found.group(1)) if (found := re.search(r"[.,](\d+)", text)) else 0
    fraction = int(found.group(1)) / 10**digits if found else 0.0
    whole, step_s = re.sub(r"[.,]\d+", "", text), 1.0
    try:
        if form == "time_utc":
            clock = re.search(r"[Tt _]\d\d:?\d\d(:?\d\d)?(?=[Zz+-]|$)", whole)
            step_s = 1.0 if clock and clock[1] else 60.0
            # neither a day alone nor parts of a minute are told to the second
            moment = dt.datetime.fromisoformat(whole if clock and (clock[1] or not found) else "")
            offset_s = (moment.utcoffset() or dt.timedelta()).total_seconds()
            second = int(moment.replace(tzinfo=dt.UTC).timestamp())
        else:
            value, offset_s = float(text.replace(",", ".")), 0.0
            if form == "t_gps_s":
                value = float(unix_from_gps(value))
            second = math.floor(value)  # of what is not finite it raises
            if form != "unix_s" or re.search("[eE]", text):
                fraction = value - second
                digits = min(digits, 6)  # a float64 of Unix time has no more
    except (ValueError, OverflowError) as error:
        raise InputError(
            f"'{text}' is no time",
            where=where,
            expected="ISO 8601, such as 2021-05-12T08:31:07.123Z" if form == "time_utc" else "a number",
        ) from error
    if not possible_unix(second):
        size = [] if form == "time_utc" else [float(text.replace(",", "."))]
        raise InputError(
            f"'{text}' is no date of a survey",
            where=where,
            expected="a time after 1980",
            cure=time_scale_words(size, tell_time_scale(size)) if size else "Look at the clock of the camera",
        )
    return CivilStamp(
        second_s=second, fraction_s=fraction, resolution_s=step_s * 10.0**-digits, utc_offset_s=offset_s
    )


# ---------------------------------------------------------------- stamps


__all__ = ["IMAGE_STAMPS", "ImageStamps", "Source", "list_images", "natural_key", "read_image_stamps"]

Source = Literal["auto", "name", "exif", "table"]


IMAGE_STAMPS = table_kind(
    "image_stamps",
    1,
    [
        column("file", "1", "name of the image; of a survey below its common folder", pa.string()),
        column("t_device_s", "s", "adjusted GPS time if the camera's clock were right; NaN if without"),
        column("source", "1", "what the time is from: name, exif, table, none", pa.string()),
        column("resolution_s", "s", "unit of the stamp"),
        column("width", "px", "columns of the image; -1 if unreadable", pa.int32()),
        column("height", "px", "rows of the image; -1 if unreadable", pa.int32()),
        column("make", "1", "maker of the camera", pa.string()),
        column("model", "1", "model of the camera", pa.string()),
        column("focal_mm", "mm", "focal length as EXIF states it; NaN if unknown"),
    ],
)

_NAMED: Final = 5
_MOST_GPS_S: Final = 30.0
"""Cameras write the last position that they had: its time is some seconds older."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageStamps:
    """Table kind ``image_stamps`` in order of time, images without time at the end, and its report."""

    table: pd.DataFrame
    report: IntegrityReport


def read_image_stamps(
    images: Path | Sequence[Path],
    *,
    source: Source = "auto",
    pattern: str | None = None,
    times: Path | None = None,
    utc_offset: str | None = None,
    folders: bool = False,
) -> ImageStamps:
    """Times of photographs.

    Parameters
    ----------
    images : a folder or a file, or a list of them; folders below are searched (`image_files`).
    source : ``name``, ``exif`` or ``table``; ``auto`` takes the table if one is given, else whichever of
        names and EXIF resolves time finer, and the other one for images that have no such time, if both
        agree.
    pattern : how times stand in the names, see `image_names.compile_pattern`; None: the usual ones.
    times : CSV table of times, see `image_table.read_time_table`; or the log of an autopilot with as many
        camera triggers as there are images, which are then in its order by their names.
    folders : names hold the folders below the common one, as of `image_files.named_images`; false: the names
        of the files alone, each once.
    utc_offset : camera's clock minus UTC such as ``+02:00``, for stamps that do not state it; None: UTC.

    Raises
    ------
    InputError : no images, an unusable pattern, offset or table.
    ClockError : no image has a time.
    """
    given = [images] if isinstance(images, Path) else list(images)
    others = find_images(given)
    named = named_images(given) if folders else files_by_name(others.files)
    names, files = list(named), list(named.values())
    if pattern:
        compile_pattern(pattern)
    offset_s = 0.0 if utc_offset is None else offset_seconds(utc_offset)
    if offset_s is None:
        raise InputError(f"'{utc_offset}' is no offset from UTC", expected="a text like +02:00")
    report = IntegrityReport(stream="camera", format="photographs", files=_few(files), time_scale="device")
    if others.others:
        report.count("other_files", len(others.others))
        report.note(others.others_in_words())
    heads = _heads(named, report)
    listed = {}
    if times is not None:
        triggered = _triggers(times, names, report)
        listed = _by_image(read_time_table(times), names, times) if triggered is None else triggered
    if source == "table" and times is None:
        raise InputError("times shall come from a table, but none is given", expected="a CSV file")
    stamps: dict[str, list[CivilStamp | None]] = {
        "table": [listed.pop(name, None) for name in names],
        "name": [stamp_from_name(path.stem, pattern) for path in files],
        "exif": [head.stamp if head else None for head in heads],
    }
    # where EXIF has sub-seconds it is compared with the names
    if _are_counters(stamps["name"]) and all(s is None or s.resolution_s >= 1.0 for s in stamps["exif"]):
        report.note("Three digits behind the second count the images in the names: not read as a fraction.")
        stamps["name"] = [
            stamp and replace(stamp, fraction_s=0.0, resolution_s=1.0) for stamp in stamps["name"]
        ]
    if listed:
        report.lose("table_rows_without_image", len(listed))
        report.note(f"{len(listed)} rows of {times} name no image: {_names(sorted(listed))}.")
    order = _order(source, stamps, times is not None, offset_s, report)
    chosen = [
        next(((name, stamp) for name in order if (stamp := stamps[name][i]) is not None), ("none", None))
        for i in range(len(files))
    ]
    unix_s, undeclared = _utc([stamp for _, stamp in chosen], offset_s)
    if undeclared and utc_offset is None:
        report.note(f"{undeclared} stamps state no offset from UTC: read as UTC.")
    used = [head for (name, _), head in zip(chosen, heads, strict=True) if head and name == "exif"]
    if changed := sum(head.of_change for head in used):
        report.note(
            f"{changed} stamps are of the last change of the file (EXIF DateTime): none of the exposure."
        )
    gps_s = [h.gps_unix_s if h else None for h in heads]
    off = [t - g for t, g in zip(unix_s.tolist(), gps_s, strict=True) if g is not None and math.isfinite(t)]
    if off and abs(shift_s := float(np.median(off))) > _MOST_GPS_S:
        words = explain_shift(shift_s) or "no whole quarter of an hour"
        report.note(
            f"The stamps are {shift_s:+.0f} s from the times of GPS (UTC) in EXIF ({words}): if the clock "
            "shows local time, give its offset from UTC."
        )
    known = np.isfinite(unix_s)
    whole = np.floor(unix_s)
    t_device_s = np.full(len(files), np.nan)
    t_device_s[known] = gps_from_unix(whole[known], np.round((unix_s - whole)[known] * 1e6))
    table = frame_of(
        IMAGE_STAMPS,
        {
            "file": names,
            "t_device_s": t_device_s,
            "source": [name for name, _ in chosen],
            "resolution_s": [stamp.resolution_s if stamp else np.nan for _, stamp in chosen],
            "width": [head.width if head else -1 for head in heads],
            "height": [head.height if head else -1 for head in heads],
            "make": [head.make if head else "" for head in heads],
            "model": [head.model if head else "" for head in heads],
            "focal_mm": [head.focal_mm if head else np.nan for head in heads],
        },
    )
    _describe(table, report)
    if not known.any():
        raise ClockError(
            f"none of {len(files)} images has a time",
            where=files[0].parent,
            expected="a date and time in the file names, in EXIF (DateTimeOriginal), or in a table",
            cure="Give the pattern of the names or a CSV table with the columns file and time_utc",
        )
    return ImageStamps(table=table.sort_values("t_device_s", kind="stable", ignore_index=True), report=report)


def _are_counters(stamps: Sequence[CivilStamp | None]) -> bool:
    """Whether three digits behind the second grow by one from name to name: a counter, not milliseconds."""
    known = [stamp for stamp in stamps if stamp is not None and stamp.resolution_s == 1e-3]
    steps = np.diff([round(stamp.fraction_s * 1e3) for stamp in known])
    return len(known) == len(stamps) > 3 and bool((steps == 1).all())


def _triggers(path: Path, names: Sequence[str], report: IntegrityReport) -> dict[str, CivilStamp] | None:
    """Times at which an autopilot triggered the images, in the order of their names; None for other files."""
    from thalweg.ingest.recorders import is_dataflash, is_telemetry, read_ardupilot

    head, size = read_raw_head(path), path.stat().st_size
    if not (is_dataflash(head, size) or is_telemetry(head, size)):
        return None
    log = read_ardupilot([path], TrackOptions())
    found = np.empty(0) if log.triggers_gps_s is None else log.triggers_gps_s
    if len(found) != len(names) or np.isnan(found).any():
        raise InputError(
            f"{len(found):,} camera triggers{' without GPS time' if np.isnan(found).any() else ''} beside "
            f"{len(names):,} photographs",
            expected="a trigger with GPS time for each photograph",
            where=path,
            cure="Take out photographs that the autopilot did not trigger, or write a table (file, t_gps_s)",
        )
    for note in log.report.notes:
        if "clock is on GPS time" in note:
            report.note(note)
    report.note("Photographs and triggers of the autopilot are as many: paired in the order of names.")
    unix_s = unix_from_gps(np.sort(found))
    whole = np.floor(unix_s).astype(np.int64)
    return {
        name: CivilStamp(
            second_s=int(second), fraction_s=float(t - second), resolution_s=1e-3, utc_offset_s=0.0
        )
        for name, t, second in zip(sorted(names, key=natural_key), unix_s, whole, strict=True)
    }


def _by_image(listed: dict[str, CivilStamp], names: Sequence[str], where: Path) -> dict[str, CivilStamp]:
    """Stamps of a table by the names of the images; those of no image keep their own name."""
    meant = by_any_name(names)
    bases = {Path(name).name for name in names} | {Path(name).stem for name in names}
    out: dict[str, CivilStamp] = {}
    for written, stamp in listed.items():
        text = written.replace("\\", "/")
        name = meant.get(text, meant.get(text.rsplit("/", 1)[-1], text))
        if name == text and name not in meant and text.rsplit("/", 1)[-1] in bases:
            raise InputError(
                f"'{written}' may mean images of several folders",
                where=where,
                expected=f"names with folders, as {names[0]}",
            )
        if name in out:
            raise InputError(f"'{name}' stands there twice", where=where, expected="each image once")
        out[name] = stamp
    return out


def _heads(images: Mapping[str, Path], report: IntegrityReport) -> list[ImageHead | None]:
    heads: list[ImageHead | None] = []
    bad = []
    for name, path in images.items():
        try:
            heads.append(read_head(path))
        except InputError as error:
            heads.append(None)
            bad.append(f"{name} ({error.found})")
        else:
            report.bytes_read += path.stat().st_size
    if bad:
        report.lose("images_unreadable", len(bad))
        report.note(f"{len(bad)} images cannot be read: {_names(bad)}.")
    return heads


def _order(
    source: Source,
    stamps: dict[str, list[CivilStamp | None]],
    with_table: bool,
    offset_s: float,
    report: IntegrityReport,
) -> list[str]:
    """Sources in the order in which an image's time is looked for."""
    if source != "auto":
        return [source]
    if with_table:
        return ["table"]
    ranked = sorted(("name", "exif"), key=lambda name: _fineness(stamps[name]))
    both = [
        (a, b) for a, b in zip(stamps["name"], stamps["exif"], strict=True) if a is not None and b is not None
    ]
    if not both:
        return ranked
    (names, _), (exif, _) = (_utc([pair[k] for pair in both], offset_s) for k in (0, 1))
    shift_s = float(np.median(names - exif))
    unit_s = max(stamp.resolution_s for pair in both for stamp in pair)
    if abs(shift_s) <= unit_s + 0.5:
        return ranked
    words = explain_shift(shift_s)
    used = "the names" if ranked[0] == "name" else "EXIF"
    report.note(
        f"The times in the names are {shift_s:+.3f} s from those in EXIF "
        f"({words or 'no whole quarter of an hour'}); those of {used} are used. If they are local time, give "
        "the offset from UTC."
    )
    return ranked[:1]


def _fineness(stamps: list[CivilStamp | None]) -> tuple[float, int]:
    """Median unit, and how many images are without: smaller is better."""
    known = [stamp.resolution_s for stamp in stamps if stamp is not None]
    return (float(np.median(known)) if known else float("inf"), len(stamps) - len(known))


def _utc(stamps: list[CivilStamp | None], offset_s: float) -> tuple[ArrayF, int]:
    """UTC as Unix time (n,), NaN without stamp, and how many stamps did not state their offset."""
    unix_s = np.full(len(stamps), np.nan)
    undeclared = 0
    for i, stamp in enumerate(stamps):
        if stamp is not None:
            own = stamp.utc_offset_s
            undeclared += own is None
            unix_s[i] = stamp.shown_s - (offset_s if own is None else own)
    return unix_s, undeclared


def _describe(table: pd.DataFrame, report: IntegrityReport) -> None:
    """Counts, losses, gaps and notes about stamps in the order of the names."""
    t = table["t_device_s"].to_numpy()
    known = np.isfinite(t)
    report.count("images", len(table))
    sources = Counter(table["source"])
    for name in ("name", "exif", "table"):
        if sources[name]:
            report.count(f"times_from_{name}", sources[name])
    if sources["none"]:
        report.lose("images_without_time", sources["none"])
        report.note(f"{sources['none']} images have no time: {_names(table['file'][~known])}.")
    used = [name for name in ("name", "exif", "table") if sources[name]]
    if len(used) > 1:
        report.note(f"Times are of mixed sources: {', '.join(f'{sources[n]} from {n}' for n in used)}.")
    again = table["t_device_s"].duplicated() & known
    if again.any():
        report.lose("repeated_stamps", int(again.sum()))
        report.note(
            f"{int(again.sum())} images have the stamp of another one: {_names(table['file'][again])}."
        )
    shown = np.flatnonzero(known)
    folder = np.array([str(PurePosixPath(name).parent) for name in table["file"]], dtype=object)[shown]
    back = shown[1:][(np.diff(t[shown]) < 0) & (folder[1:] == folder[:-1])]
    if back.size:
        report.lose("steps_back", back.size)
        report.note(
            f"Time steps back {back.size} times in the order of the names, first at "
            f"{table['file'][back[0]]}: the clock was set, or images of several recordings share a folder."
        )
    units = table["resolution_s"][known].unique()
    ordered = np.unique(t[known])
    if ordered.size:
        report.t_first_s, report.t_last_s = float(ordered[0]), float(ordered[-1])
        report.timing.describe_stamps(ordered, float(units.max()))
        report.gaps = find_gaps(ordered)
        if doubt := doubtful_date(ordered).partition(" A week counter")[0]:
            report.note(f"{doubt} Was the clock of the camera set?")
    if report.timing.period_s:
        report.rates_hz["images"] = 1.0 / report.timing.period_s
    if len(units) > 1 or (units.size and units.max() >= 1.0):
        report.note(f"Stamps are in units of {', '.join(f'{unit:g}' for unit in sorted(units))} s.")
    _describe_cameras(table, report)


def _describe_cameras(table: pd.DataFrame, report: IntegrityReport) -> None:
    seen = table[table["width"] > 0]
    cameras = Counter(
        (f"{row.make} {row.model}".strip(), f"{row.width} x {row.height}") for row in seen.itertuples()
    ).most_common(4)
    if not cameras:
        return
    (report.model, report.details["size"]), _ = cameras[0]
    if len(cameras) > 1:
        listed = ", ".join(f"{n} of {name or 'unknown'} {pixels}" for (name, pixels), n in cameras)
        report.note(f"Images of several cameras or sizes: {listed}.")


def _names(names: Sequence[str] | pd.Series) -> str:
    listed = list(names)
    more = f" and {len(listed) - _NAMED} more" if len(listed) > _NAMED else ""
    return ", ".join(listed[:_NAMED]) + more


def _few(files: Sequence[Path]) -> list[str]:
    """The folder of many files, else the files."""
    folders = {path.parent for path in files}
    return (
        [str(path) for path in files] if len(files) <= _NAMED else sorted(str(folder) for folder in folders)
    )
