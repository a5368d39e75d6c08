"""Formats of antenna positions, and the positions of a campaign from whichever source it chooses."""

import datetime as dt
import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core import InputError, ThalwegError, frame_of, read_table, utc_text_from_gps
from thalweg.ingest import (
    GNSS_POSITION,
    INS_STATE,
    IntegrityReport,
    PositionLog,
    PositionReader,
    TrackOptions,
    pings_of,
)
from thalweg.ingest.framing import intact_bytes
from thalweg.ingest.nmea import read_nmea
from thalweg.ingest.ppk import PpkOptions, describe_rinex, replace_covariances, run_ppk
from thalweg.ingest.recorders import (
    is_deeper,
    is_depth_table,
    is_gopro,
    is_lowrance,
    is_matlab,
    is_pd0,
    is_track_table,
    read_deeper,
    read_depth_table,
    read_gopro,
    read_lowrance,
    read_pd0,
    read_sontek,
    read_track_table,
    read_ubx,
    ubx_share,
)
from thalweg.ingest.registry.base import Format, find_format, framed_share
from thalweg.ingest.registry.converted import CONVERTED
from thalweg.ingest.registry.lidar import BAG
from thalweg.ingest.registry.poses import POSES
from thalweg.ingest.tracks import event_marks, read_gpx, read_pos

_NMEA = re.compile(rb"[$!][A-Z]{2}[A-Z]{3},[^\r\n*]*(\*[0-9A-Fa-f]{2})?")
_POS_LINE = re.compile(
    rb"(?m)^\s*(\d{4}/\d\d/\d\d[ ,;\t]+\d\d:\d\d:\d\d(\.\d+)?|\d{4}[ ,;\t]+\d{1,6}\.\d+)"
    rb"([ ,;\t]+[-\d.:]+){6,}"
)

MOST_STEP_S: Final = 2.0
"""Positions this far apart in time, or three usual steps, have soundings between them."""


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
        return log.positions, log.report
    report = describe_rinex(files[0])
    report.stream = "gnss"
    return GNSS_POSITION.empty_table().to_pandas(), report


def read_depths(files: list[Path], date: dt.date | None = None, topics: Sequence[str] = ()) -> PositionLog:
    """Soundings of any recording that may hold some: NMEA, extensions of a GPX track, logs of an autopilot.

    Parameters
    ----------
    files : parts of one recording in the order of time.
    date : UTC date of the first sentence of NMEA without dates.
    topics : of a bag with several.

    Raises
    ------
    InputError : the files hold no depths.
    """
    log = _of_soundings(files[0])(files, TrackOptions(date=date, topics=topics))
    if not (log.depths["depth_m"] > 0).any():
        told = "".join(f"; {note.rstrip('.')}" for note in log.report.notes)
        raise InputError(
            f"no depths in this recording{told}",
            expected="NMEA sentences DBT or DPT, depths in extensions of GPX, or messages of an echo sounder",
            where=files[0],
            cure="Give another log in logs.depth, or a table of soundings to `thalweg bed`",
        )
    return log


def soundings_table(path: Path) -> tuple[pd.DataFrame, list[str]] | None:
    """Soundings of a recording with their places, as a table of soundings has them.

    Parameters
    ----------
    path : any file.

    Returns
    -------
    Columns ``latitude``, ``longitude``, ``depth_m`` and ``time`` (UTC), and notes; None where the file is of
    no format that holds depths.

    Raises
    ------
    InputError : the recording has no depths, no positions, or no time in common.
    """
    if find_format(_WITH_DEPTHS, path) is None:
        other = find_format(CONVERTED, path)
        if other is not None:
            raise InputError(
                f"a {other.words}",
                expected="soundings",
                where=path,
                cure=other.use[:1].upper() + other.use[1:],
            )
        return None
    log = read_depths([path])
    if len(log.soundings):
        return log.soundings, list(log.report.notes)
    depths, again = pings_of(log.depths)
    unfixed, reckoned = (int((log.positions["fix"] == fix).sum()) for fix in ("none", "dead_reckoning"))
    track = log.positions[log.positions["fix"] != "none"].dropna(subset=["t_gps_s", "lat_deg"])
    if len(track) < 2:
        raise InputError(
            f"{len(log.depths):,} depths and no positions with times beside them"
            + (f" ({unfixed:,} have no fix, or one of a simulator)" if unfixed else ""),
            where=path,
            expected="a recording that holds both, on one clock",
            cure="Put depths and track into a campaign (`thalweg new-campaign`), or give a table with places",
        )
    track = track.drop_duplicates("t_gps_s").sort_values("t_gps_s")
    t = depths["t_gps_s"].to_numpy(np.float64)
    after = np.clip(np.searchsorted(track["t_gps_s"], t), 1, len(track) - 1)
    step = np.diff(track["t_gps_s"])[after - 1]
    within = (t >= track["t_gps_s"].iloc[0]) & (t <= track["t_gps_s"].iloc[-1])
    near = within & (step <= max(MOST_STEP_S, 3 * float(np.median(step[within])) if within.any() else 0.0))
    depth = depths["depth_m"].to_numpy(np.float64)
    seen = near & (depth > 0)
    if not seen.any():
        raise InputError(
            f"none of {len(t):,} depths has a bottom and a position at its time",
            where=path,
            expected="depths and positions of the same minutes",
            cure="Look at it with `thalweg describe`",
        )
    from_water = set(depths["sentence"]) == {"DBS"}
    below = "water line" if from_water else "transducer, as recorded: its draught is not added"
    notes = [*log.report.notes, f"Depths are below the {below}."]
    for what, n in (
        ("depths that state the same pings again are left out", again),
        ("positions without a fix are left out", unfixed),
        ("positions are dead reckoning, not fixes", reckoned),
    ):
        if n:
            notes.append(f"{n:,} {what}")
    for what, n in (("without a bottom", near & (depth <= 0)), ("without a position at their time", ~near)):
        if n.any():
            notes.append(f"{int(n.sum()):,} of {len(t):,} depths {what} are left out")
    table = {
        name: np.interp(t[seen], track["t_gps_s"], track[column])
        for name, column in (("latitude", "lat_deg"), ("longitude", "lon_deg"))
    }
    return pd.DataFrame(
        table | {"depth_m": depth[seen], "time": [utc_text_from_gps(x) for x in t[seen]]}
    ), notes


def read_positions(
    source: str,
    logs: list[Path],
    *,
    states: Path | None,
    date: dt.date | None = None,
    topics: Sequence[str] = (),
    base: list[Path],
    nav: list[Path],
    ppk: dict[str, Any],
    base_position: dict[str, Any],
) -> tuple[pd.DataFrame, IntegrityReport]:
    """Positions of the antenna.

    Parameters
    ----------
    source : ``pos`` (any format of finished positions, by its content), ``sbp``, ``nmea``, ``gpx``, ``ppk``,
        ``sbet`` or ``ins``.
    logs : the source's own files: .pos, SBP, or the rover's raw GNSS.
    states : table of INS states, for the sources ``sbet`` and ``ins``.
    date : UTC date of the first sentence of NMEA without dates.
    topics : of a bag with several.
    base, nav : the base's raw GNSS and navigation files, for ``ppk``.
    ppk : options of the engine, as in the section ``ppk`` of a campaign file.
    base_position : one of the keys ``base_ecef_m``, ``base_llh`` and ``base_from``.

    Raises
    ------
    InputError : the source is unknown, or its files cannot be used.
    """
    known = next((row for row in POSITIONS if row.kind == source and row.positions), None)
    if source == "pos" and logs:  # a receiver's own log or a bag may stand there too
        known = find_format([row for row in POSITIONS if "pos" in row.streams], logs[0]) or known
    if known is not None and known.positions is not None:
        log = known.positions(logs, TrackOptions(date=date, topics=topics))
        positions, report = log.positions, log.report
    elif source == "ppk":
        solution = run_ppk(logs, base or None, nav, PpkOptions.from_sections(ppk, base_position))
        positions, report = solution.positions, solution.report
    elif source in ("ins", "sbet") and states is not None:
        table, _ = read_table(states, INS_STATE)
        positions = positions_from_states(table)
        report = IntegrityReport.of(
            "positions",
            f"positions of the {'INS' if source == 'ins' else 'SBET'} states",
            [states],
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
        if table["t_gps_s"].notna().any():
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


def _of_soundings(path: Path) -> PositionReader:
    known = find_format(_WITH_DEPTHS, path)
    reader = None if known is None else known.depths or known.positions or known.poses
    if reader is None:
        raise InputError(
            "a recording of no kind that holds depths",
            where=path,
            expected=", ".join(row.words for row in _WITH_DEPTHS),
            cure="Look at it with `thalweg describe`",
        )
    return reader


def _kind(path: Path) -> str | None:
    known = find_format(POSITIONS, path)
    return None if known is None else known.kind


def _sbp(files: Sequence[Path], options: TrackOptions) -> PositionLog:
    from thalweg.ingest.sbp import read_sbp

    return read_sbp(files)


def _streams_of_sounder(reader: PositionReader, path: Path) -> dict[str, Sequence[tuple[str, ...]]]:
    """Its own places make a track; without times it is of no use to a campaign."""
    log = reader([path], TrackOptions())
    return dict.fromkeys(("depth", "pos") if log.report.synchronised else (), ())


def _streams_of_nmea(path: Path) -> dict[str, Sequence[tuple[str, ...]]]:
    """With depths it is the log of an echo sounder, whose positions its own source takes from there."""
    log = read_nmea([path])
    return {"depth": ()} if log.report.counts.get("depths") else {"pos": ()}


def _streams_of_ubx(path: Path) -> dict[str, Sequence[tuple[str, ...]]]:
    """A log of raw observations alone is for PPK; depths are those of NMEA between."""
    log = read_ubx([path], TrackOptions())
    own = "pos" if log.report.counts.get("positions") else "rover"
    return dict.fromkeys((own, "depth") if len(log.depths) else (own,), ())


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
    return framed_share(intact_bytes(head, sbp=True), head)


POSITIONS: Final = (
    BAG,
    Format(
        kind="ubx",
        words="u-blox UBX log",
        streams=("pos", "rover", "base", "depth"),
        holds=_streams_of_ubx,
        matches=ubx_share,
        positions=read_ubx,
    ),
    *(
        Format(
            kind=kind,
            words=words,
            streams=("depth", "pos"),
            holds=partial(_streams_of_sounder, reader),
            use="soundings with places and without times, for `thalweg bed`",
            matches=matches,
            positions=reader,
        )
        for kind, words, matches, reader in (
            ("lowrance", "Lowrance SL2 or SL3 log", is_lowrance, read_lowrance),
            ("pd0", "TRDI ADCP log (PD0)", is_pd0, read_pd0),
            ("sontek", "SonTek RiverSurveyor export (MATLAB)", is_matlab, read_sontek),
            ("deeper", "Deeper export", is_deeper, read_deeper),
        )
    ),
    *(
        Format(kind=kind, words=words, streams=(stream,), matches=matches, positions=reader)
        for kind, words, stream, matches, reader in (
            ("gopro", "GoPro video (GPMF)", "pos", is_gopro, read_gopro),
            ("track_table", "table of positions with times", "pos", is_track_table, read_track_table),
            ("depth_table", "table of depths with times", "depth", is_depth_table, read_depth_table),
        )
    ),
    Format(
        kind="rinex",
        words="RINEX file",
        streams=("rover", "base", "nav"),
        matches=_is_rinex,
        describe=lambda kind, files, options: PositionLog(report=describe_rinex(files[0])),
    ),
    Format(
        kind="pos",
        words="RTKLIB .pos solution",
        streams=("pos",),
        matches=_is_pos,
        positions=lambda files, options: read_pos(files),
    ),
    Format(
        kind="nmea",
        words="NMEA 0183 log",
        streams=("depth", "pos"),
        holds=_streams_of_nmea,
        matches=_is_nmea,
        positions=lambda files, options: read_nmea(files, options.date),
    ),
    Format(
        kind="gpx",
        words="track (GPX)",
        streams=("pos", "depth"),
        matches=lambda head, size: b"<gpx" in head,
        positions=lambda files, options: read_gpx(files),
    ),
    Format(kind="sbp", words="Swift SBP log", streams=("rover", "base"), matches=_sbp_share, positions=_sbp),
)

_WITH_DEPTHS: Final = tuple(row for row in (*POSITIONS, *POSES) if "depth" in row.streams)
