"""Loggers that write plain tables: the track of a receiver, the depths of a sounder, each with its times.

A table of place and depth in one row is no log of a stream: `thalweg bed` reads it as it is. Columns are
known by their names, times as `thalweg.ingest.moments` reads them.
"""

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from pyproj import CRS

from thalweg.core import InputError, frame_of, gps_from_unix
from thalweg.ingest import (
    DEPTH,
    GNSS_POSITION,
    NAMES,
    IntegrityReport,
    PositionLog,
    Table,
    TrackOptions,
    column_of,
    read_text_table,
)

_NAMED: Final = frozenset({"image", "file", "photo", "label", "name", "point", "id", "marker", "line"})
"""Columns of tables about something else: photographs, surveyed points, lines of soundings."""
_SURE: Final = 0.3
"""Less than any format that is told by more than names."""


def _quantities(head: bytes) -> set[str]:
    """Quantities that the first line of a text names; none where it names things too."""
    line = head.split(b"\n", 1)[0].decode("utf-8-sig", "replace").strip().lstrip("#%/! ")
    separator = max(",;\t|", key=line.count)
    words = {column_of(cell).words for cell in line.split(separator)}
    return set() if words & _NAMED else {q for q, names in NAMES.items() if words & set(names.split())}


def is_track_table(head: bytes, size: int) -> float:
    """Some sureness of a table with times, latitudes and longitudes and no depths."""
    found = _quantities(head)
    return _SURE if {"lat", "lon", "time"} <= found and "depth" not in found else 0.0


def is_depth_table(head: bytes, size: int) -> float:
    """Some sureness of a table with times and depths and no places."""
    found = _quantities(head)
    return _SURE if {"depth", "time"} <= found and not found & {"lat", "lon", "east", "north"} else 0.0


def read_track_table(files: Sequence[Path], options: TrackOptions) -> PositionLog:
    """Positions of a table with times.

    Parameters
    ----------
    files : in the order of time, with the same columns.
    options : not needed.

    Raises
    ------
    InputError : no row with a time and a place; see `thalweg.ingest.read_text_table`.
    """
    report, positions = _read("gnss", "table of positions", files, _positions)
    return PositionLog(report=report, positions=positions)


def read_depth_table(files: Sequence[Path], options: TrackOptions) -> PositionLog:
    """Depths of a table with times; as `read_track_table`."""
    report, depths = _read("depth", "table of depths", files, _depths)
    return PositionLog(report=report, depths=depths)


def _read(
    stream: str, words: str, files: Sequence[Path], values: Callable[[Table, IntegrityReport], pd.DataFrame]
) -> tuple[IntegrityReport, pd.DataFrame]:
    report = IntegrityReport.of(stream, words, files, time_scale="utc")
    parts = []
    for path in files:
        report.bytes_read += path.stat().st_size
        table = read_text_table(path)
        moments = table.times()
        unix_s = np.full(len(table), np.nan) if moments is None else moments[0]
        part = values(table, report).assign(unix_s=unix_s)
        whole = part.notna().drop(columns="h_ell_m", errors="ignore").all(axis=1)
        report.lose("rows_without_values", (~whole).sum())
        for sentence in (*table.notes, *(moments[1] if moments else ()), *table.loss_notes()):
            report.note(sentence)
        parts.append(part[whole])
    found = pd.concat(parts, ignore_index=True)
    if found.empty:
        raise InputError(
            "no row with a time and values",
            expected=f"a {words} with times",
            where=", ".join(report.files),
            cure="Look at its columns with `thalweg describe`",
        )
    t_gps_s = gps_from_unix(found["unix_s"].to_numpy(np.float64))
    report.take_gps_times(t_gps_s, "rows")
    kind = DEPTH if stream == "depth" else GNSS_POSITION
    return report, frame_of(kind, {**found.assign(t_gps_s=t_gps_s)}, unknown=np.nan)


def _positions(table: Table, report: IntegrityReport) -> pd.DataFrame:
    names = [column.name.lower() for column in table.columns]
    # the separation of geoid and ellipsoid is no height
    k = next(
        (k for k, n in enumerate(names) if "ellips" in n and not re.search("separ|geoid|undul", n)), None
    )
    if k is None:
        report.note("No column of ellipsoidal heights: positions have none.")
    report.note("Positions without a kind of fix: taken as single, without standard deviations.")
    height = np.full(len(table), np.nan) if k is None else table.numbers(k, "height")
    places = {"lat_deg": table.angles("lat"), "lon_deg": table.angles("lon"), "h_ell_m": height}
    if table.degrees not in (None, 4326):
        way, words = table.way_of_degrees(CRS.from_epsg(4326))
        places["lon_deg"], places["lat_deg"] = way.transform(places["lon_deg"], places["lat_deg"])
        report.note(f"latitude and longitude {words} and transformed to WGS 84")
    return pd.DataFrame(places).assign(fix="single", n_sats=-1)


def _depths(table: Table, report: IntegrityReport) -> pd.DataFrame:
    k = table.find("depth")
    assert k is not None
    for sentence in table.unit_notes(k):
        report.note(sentence)
    depth = table.numbers(k, "depth")
    return pd.DataFrame({"depth_m": depth, "sentence": table.columns[k].name, "line": table.line})
