"""Formats of antenna positions, and the positions of a campaign from whichever source it chooses."""

import datetime as dt
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core import InputError, ThalwegError, frame_of, read_table
from thalweg.ingest import GNSS_POSITION, INS_STATE, IntegrityReport, PositionLog, TrackOptions
from thalweg.ingest.nmea import read_nmea
from thalweg.ingest.ppk import PpkOptions, describe_rinex, replace_covariances, run_ppk
from thalweg.ingest.registry.base import Format, Recording, find_format, framed_share
from thalweg.ingest.tracks import event_marks, read_gpx, read_pos

_NMEA = re.compile(rb"[$!][A-Z]{2}[A-Z]{3},[^\r\n*]*(\*[0-9A-Fa-f]{2})?")
_POS_LINE = re.compile(
    rb"(?m)^\s*(\d{4}/\d\d/\d\d[ ,;\t]+\d\d:\d\d:\d\d(\.\d+)?|\d{4}[ ,;\t]+\d{1,6}\.\d+)"
    rb"([ ,;\t]+[-\d.:]+){6,}"
)


def positions_from_states(states: pd.DataFrame) -> pd.DataFrame:
    """The positions inside INS states as table kind ``gnss_position``: of the ics origin, not an antenna."""
    return frame_of(GNSS_POSITION, {**states.reset_index(drop=True), "n_sats": -1}, unknown=np.nan)


def read_receiver(files: list[Path]) -> tuple[pd.DataFrame, IntegrityReport]:
    """The solution that a GNSS receiver computed on board, from its SBP log.

    A receiver that logged raw observations only (RINEX) has none: the table is then empty, and the report is
    that of the observations.

    Parameters
    ----------
    files : log of the rover, SBP or RINEX observations.

    Raises
    ------
    InputError : a file is neither.
    """
    sbp = [path for path in files if _kind(path) == "sbp"]
    if sbp:
        log = _sbp(sbp, TrackOptions())
        assert log.positions is not None
        return log.positions, log.report
    report = describe_rinex(files[0])
    report.stream = "gnss"
    return GNSS_POSITION.empty_table().to_pandas(), report


def read_depths(files: list[Path], date: dt.date | None = None) -> PositionLog:
    """Soundings of an NMEA log, or those in the extensions of a GPX track.

    Parameters
    ----------
    files : parts of one recording in the order of time.
    date : UTC date of the first sentence of NMEA without dates.

    Raises
    ------
    InputError : the files hold no depths.
    """
    if _kind(files[0]) != "gpx":
        found = read_nmea(files, date=date).with_depths()
        return PositionLog(report=found.report, depths=found.depths)
    log = read_gpx(files)
    if log.depths is None:
        raise InputError(
            "no depths in the extensions of the track points",
            expected="an element depth or water_depth",
            where=files[0],
            cure="Give an NMEA log in logs.depth, or a table of soundings to `thalweg bed`",
        )
    return log


def read_positions(
    source: str,
    logs: list[Path],
    *,
    states: Path | None,
    date: dt.date | None = None,
    base: list[Path],
    nav: list[Path],
    ppk: dict[str, Any],
    base_position: dict[str, Any],
) -> tuple[pd.DataFrame, IntegrityReport]:
    """Positions of the antenna.

    Parameters
    ----------
    source : ``pos``, ``sbp``, ``nmea``, ``gpx``, ``ppk``, ``sbet`` or ``ins``.
    logs : the source's own files: .pos, SBP, or the rover's raw GNSS.
    states : table of INS states, for the sources ``sbet`` and ``ins``.
    date : UTC date of the first sentence of NMEA without dates.
    base, nav : the base's raw GNSS and navigation files, for ``ppk``.
    ppk : options of the engine, as in the section ``ppk`` of a campaign file.
    base_position : one of the keys ``base_ecef_m``, ``base_llh`` and ``base_from``.

    Raises
    ------
    InputError : the source is unknown, or its files cannot be used.
    """
    reader = next((row.positions for row in POSITIONS if row.kind == source), None)
    if reader is not None:
        log = reader(logs, TrackOptions(date=date))
        assert log.positions is not None
        positions, report = log.positions, log.report
    elif source == "ppk":
        solution = run_ppk(logs, base or None, nav, PpkOptions.from_sections(ppk, base_position))
        positions, report = solution.positions, solution.report
    elif source in ("ins", "sbet") and states is not None:
        table, _ = read_table(states, INS_STATE)
        positions = positions_from_states(table)
        report = IntegrityReport(
            stream="positions",
            format=f"positions of the {'INS' if source == 'ins' else 'SBET'} states",
            files=[str(states)],
            time_scale="gps",
            synchronised=bool(positions["t_gps_s"].notna().any()),
            counts={"positions": len(positions)},
        )
        report.take_times(positions["t_gps_s"], "positions")
    else:
        raise InputError(f"position source '{source}'", expected="pos, sbp, nmea, gpx, ppk, sbet or ins")
    report.stream = "positions"
    if source != "ppk":  # which has done so itself
        positions, n_replaced = replace_covariances(positions)
        if n_replaced:
            report.count("covariances_replaced", n_replaced)
            report.note(
                f"{n_replaced} covariances were not positive definite, or below 0.5 mm: replaced by the "
                "median of their neighbours of the same fix."
            )
    return positions, report


def choose_tracks(files: Sequence[Path]) -> tuple[list[Path], dict[Path, str]]:
    """Files of positions that make one track: of those that hold the same time one.

    Parameters
    ----------
    files : solutions and tracks of one antenna.

    Returns
    -------
    Files that are kept, in the given order, and the others with the reason in words: times of events, and
    tracks of the time of a better one (more fixed positions, then smaller sigma, then more positions).
    """
    tables: dict[Path, pd.DataFrame] = {}
    left: dict[Path, str] = {}
    for path in files:
        known = find_format(POSITIONS, path)
        if known is None or known.positions is None:
            continue
        try:
            table = known.positions([path], TrackOptions()).positions
        except ThalwegError:
            continue  # which the checks of the campaign say
        if table is not None and table["t_gps_s"].notna().any():
            tables[path] = table
    marks = event_marks(list(tables), list(tables.values()))
    left |= {path: f"{n} times of events, interpolated on a track" for path, n in marks.items()}
    for path in marks:
        del tables[path]
    ranked = sorted(tables, key=lambda path: _goodness(tables[path]), reverse=True)
    kept: list[Path] = []
    for path in ranked:
        better = next((other for other in kept if _same_time(tables[path], tables[other])), None)
        if better is None:
            kept.append(path)
        else:
            left[path] = f"of the same time as {better.name}, which has {_why(tables[better], tables[path])}"
    return [path for path in files if path not in left], left


def _goodness(track: pd.DataFrame) -> tuple[float, float, int]:
    """Share of fixed positions, negative median sigma, number: larger is better."""
    sigma = float(np.nan_to_num(track["sigma_east_m"].astype(float).median(), nan=np.inf))
    return float((track["fix"] == "fixed").mean()), -sigma, len(track)


def _why(better: pd.DataFrame, other: pd.DataFrame) -> str:
    words = ("more fixed positions", "smaller standard deviations", "more positions")
    pairs = zip(_goodness(better), _goodness(other), words, strict=True)
    return next((word for a, b, word in pairs if a > b), "as good positions")


def _same_time(one: pd.DataFrame, other: pd.DataFrame) -> bool:
    """Whether most of the shorter of two tracks lies in the time of the other."""
    (a, b), (c, d) = ((t.min(), t.max()) for t in (one["t_gps_s"], other["t_gps_s"]))
    return bool(min(b, d) - max(a, c) > 0.5 * min(b - a, d - c))


def _kind(path: Path) -> str | None:
    known = find_format(POSITIONS, path)
    return None if known is None else known.kind


def _sbp(files: Sequence[Path], options: TrackOptions) -> PositionLog:
    from thalweg.ingest.sbp import read_sbp

    log = read_sbp(files)
    return PositionLog(positions=log.positions, report=log.report)


def _pos(files: Sequence[Path], options: TrackOptions) -> PositionLog:
    log = read_pos(files)
    return PositionLog(positions=log.positions, report=log.report)


def _gpx(files: Sequence[Path], options: TrackOptions) -> PositionLog:
    return read_gpx(files)


def _nmea(files: Sequence[Path], options: TrackOptions) -> PositionLog:
    log = read_nmea(files, date=options.date)
    return PositionLog(positions=log.positions, depths=log.depths, report=log.report)


def _describe(kind: str, files: list[Path], options: dict[str, Any], points: bool) -> Recording:
    reader = next(row.positions for row in POSITIONS if row.kind == kind)
    assert reader is not None
    log = reader(files, TrackOptions(**options))
    tables = {"positions": log.positions, "depths": log.depths}
    held = {name: table for name, table in tables.items() if table is not None}
    return Recording(kind=kind, report=log.report, tables=held)


def _describe_rinex(kind: str, files: list[Path], options: dict[str, Any], points: bool) -> Recording:
    return Recording(kind=kind, report=describe_rinex(files[0]))


def _is_rinex(head: bytes, size: int) -> bool:
    first = head.split(b"\n", 1)[0]
    return b"RINEX VERSION / TYPE" in first or b"CRINEX VERS" in first


def _is_pos(head: bytes, size: int) -> bool:
    comment = head.startswith(b"%") and (b"GPST" in head or b"UTC" in head or b"JST" in head)
    return comment or (head.isascii() and _POS_LINE.search(head) is not None)


def _is_nmea(head: bytes, size: int) -> bool:
    covered = sum(len(found.group()) for found in _NMEA.finditer(head))
    return covered > 0.3 * len(head)


def _sbp_share(head: bytes, size: int) -> float:
    from thalweg.ingest.sbp import find_messages

    return framed_share(find_messages(np.frombuffer(head, dtype=np.uint8)).length, 8, head)


POSITIONS: Final = (
    Format(
        kind="rinex",
        words="RINEX file",
        streams=("rover", "base", "nav"),
        matches=_is_rinex,
        describe=_describe_rinex,
    ),
    Format(
        kind="pos",
        words="RTKLIB .pos solution",
        streams=("pos",),
        matches=_is_pos,
        positions=_pos,
        describe=_describe,
    ),
    Format(
        kind="nmea",
        words="NMEA 0183 log",
        streams=("depth", "pos"),
        matches=_is_nmea,
        positions=_nmea,
        describe=_describe,
    ),
    Format(
        kind="gpx",
        words="track (GPX)",
        streams=("pos", "depth"),
        matches=lambda head, size: b"<gpx" in head,
        positions=_gpx,
        describe=_describe,
    ),
    Format(
        kind="sbp",
        words="Swift SBP log",
        streams=("rover", "base"),
        matches=_sbp_share,
        positions=_sbp,
        describe=_describe,
    ),
)
