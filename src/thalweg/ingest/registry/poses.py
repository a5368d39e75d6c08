"""Formats of poses of the boat: logs of an INS, trajectories of other programs."""

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core import WEEK_S, ArrayF, InputError, gps_from_week
from thalweg.ingest import PoseLog, PoseReader, PositionLog, TrackOptions, doubtful_date
from thalweg.ingest.anpp import read_anpp
from thalweg.ingest.framing import intact_bytes
from thalweg.ingest.recorders import is_dataflash, is_telemetry, read_ardupilot, ubx_share
from thalweg.ingest.registry.base import Format, find_format, framed_share, read_head
from thalweg.ingest.registry.calibrations import CalibrationReport
from thalweg.ingest.registry.lidar import BAG
from thalweg.ingest.tracks import (
    is_inertial_explorer,
    pose_columns,
    read_inertial_explorer,
    read_sbet,
    read_text_poses,
    states_of_poses,
)

_NO_WEEK = 1
"""Stands in for the week of a file that is only described, before any survey; taken off again."""
_SBET_RECORD = 136
_SMRMSG_RECORD = 80
_ROUGH: Final = (100.0, 100.0, 1200.0)
"""Standard deviations that an SMRMSG stays below: metres, metres a second, arc minutes."""
_MOST_UPSIDE_DOWN = 0.5
"""Share of poses that lie keel up, or on end, beyond which the axes are wrong."""
_STEEPEST_DEG = 60.0
"""Pitch that no boat keeps; in a world of a camera, z forward, it is 90 degrees."""
_DEGREE_M: Final = 111_195.0
_UNDER_WAY_MPS, _FASTEST_MPS, _FEWEST_STEPS = 0.8, 50.0, 20
"""Speeds at which a boat points where it goes, and seconds of them that tell something."""
_ALIKE, _STRAIGHT, _FAR_OFF_DEG = 0.9, 0.99, 40.0
"""Length of a mean direction from which on all are alike; more than a boat drifts."""
_BY_VALUES = 0.05
"""Sureness of content that is told by plausible numbers alone."""


def read_poses(files: Sequence[Path], source: str | None, options: TrackOptions | None = None) -> PoseLog:
    """States of the boat from the files of one source.

    Parameters
    ----------
    files : parts of one recording in the order of time.
    source : stream of ``logs`` that they stand in, ``ins`` or ``sbet``: there any trajectory on Earth; None:
        whatever the content shows.
    options : what the files do not state.

    Raises
    ------
    InputError : of the reader, or the body is upside down throughout and nobody states that it is.
    """
    rows = [row for row in POSES if row.poses is not None and (source is None or source in row.streams)]
    known = rows[-1]
    if len(rows) > 1:
        found = find_format(rows, files[0])
        if found is None and source != "sbet":
            of_receiver = ubx_share(read_head(files[0]), files[0].stat().st_size) > 0
            raise InputError(
                "no trajectory with attitudes is recognised",
                expected=", ".join(row.words for row in rows),
                where=files[0],
                cure="A receiver knows no roll and pitch, even if two antennas tell its heading: record an "
                "INS or an autopilot beside it, and name this log in logs.positions"
                if of_receiver
                else "Look at it with `thalweg describe`",
            )
        known = found or known
    assert known.poses is not None
    options = options or TrackOptions()
    if source == "ins":  # whose trajectory takes standard deviations from the campaign
        options = replace(options, sigma_position_m=np.nan, sigma_attitude_deg=np.nan)
    log = known.poses(files, options)
    if doubt := doubtful_date(log.states["t_gps_s"]):
        log.report.note(doubt)
    if not options.upside_down:
        _refuse_upside_down(log, files[0])
    if doubt := doubtful_heading(log.states):
        log.report.note(doubt)
    return log


def doubtful_heading(states: pd.DataFrame) -> str:
    """How headings contradict the way over ground of a boat under way; empty if they suit it, or do not tell.

    Parameters
    ----------
    states : of table kind ``ins_state``.
    """
    of = states[["t_gps_s", "lat_deg", "lon_deg", "heading_rad"]].dropna()
    of = of.groupby(np.floor(of["t_gps_s"].to_numpy()), sort=True).first()
    north = np.diff(of["lat_deg"]) * _DEGREE_M
    east = np.diff(of["lon_deg"]) * _DEGREE_M * np.cos(np.deg2rad(of["lat_deg"].to_numpy()[:-1]))
    away = np.hypot(north, east) / np.diff(of["t_gps_s"])
    under_way = (away > _UNDER_WAY_MPS) & (away < _FASTEST_MPS)
    if np.count_nonzero(under_way) < _FEWEST_STEPS:
        return ""
    course = np.arctan2(east, north)[under_way]
    heading = of["heading_rad"].to_numpy()[:-1][under_way]
    apart, mirrored = (np.exp(1j * (heading - sign * course)).mean() for sign in (1.0, -1.0))
    if abs(apart) > _ALIKE and abs(off := float(np.rad2deg(np.angle(apart)))) > _FAR_OFF_DEG:
        return (
            f"The heading differs from the course over ground by {off:+.0f} deg throughout: a sensor mounted "
            "so, a current, or mistaken axes, order of the quaternion or zero of the heading?"
        )
    turns = [abs(np.exp(1j * angle).mean()) for angle in (heading, course)]
    if turns[0] > _STRAIGHT and turns[1] < _ALIKE:
        return "The heading hardly turns while the course does: degrees taken for radians, or no heading?"
    if abs(mirrored) > _ALIKE and abs(apart) < _ALIKE - 0.2:
        return (
            "The heading turns against the course over ground: does it count counterclockwise, as from east?"
        )
    return ""


def _refuse_upside_down(log: PoseLog, where: Path) -> None:
    """A boat floats upright: a wrong order of the quaternion or wrong axes turn it over or on end."""
    pitch = np.abs(np.rad2deg(log.states["pitch_rad"].dropna().to_numpy()))
    if len(pitch) and np.mean(pitch > _STEEPEST_DEG) > _MOST_UPSIDE_DOWN:
        raise InputError(
            f"the bow points up or down by {np.median(pitch):.0f} deg (median of {len(pitch):,} poses)",
            expected="a boat that floats upright, in a world x east, y north, z up",
            where=where,
            cure="Are angles in degrees taken for radians? Else turn the world (of a camera's odometry: z "
            "forward, y down), or correct body_axes",
        )
    roll = log.states["roll_rad"].dropna().to_numpy()
    over = np.cos(roll) < 0.0
    if len(roll) and over.mean() > _MOST_UPSIDE_DOWN:
        angle = np.rad2deg(np.median(np.abs(roll[over])))
        raise InputError(
            f"the body is upside down in {over.mean():.0%} of {len(roll):,} poses (roll about {angle:.0f} "
            "deg)",
            expected="a boat that floats upright",
            where=where,
            cure="Check the order of the quaternion (w first or last) and the axes of the body (body_axes); "
            "if the INS is mounted so, state so by ins.upside_down",
        )


def _sbet(files: Sequence[Path], options: TrackOptions) -> PoseLog:
    return read_sbet(files, gps_week=options.gps_week, smrmsg=options.smrmsg)


def _poses(kind: str, files: Sequence[Path], options: TrackOptions) -> PoseLog:
    return states_of_poses(read_text_poses(kind, files, options.times), options)


def _describe_poses(kind: str, files: list[Path], options: dict[str, Any]) -> PositionLog:
    """As it stands, or on Earth if the options say where."""
    if options.keys() - {"times"}:
        return _poses(kind, files, TrackOptions(**options))
    report = read_text_poses(kind, files, options.get("times")).report
    report.note(
        "The table states neither frame on Earth, axes of the body, scale of time nor standard deviations: "
        "the reader asks for them."
    )
    return PositionLog(report=report)


def _describe_weekless(
    reader: PoseReader, lacking: str, kind: str, files: list[Path], options: dict[str, Any]
) -> PositionLog:
    """Stamps as they stand in a file that is only described and tells no week, and no GPS time."""
    log = reader(files, TrackOptions(**({"gps_week": _NO_WEEK} | options)))
    report, t0 = log.report, float(gps_from_week(_NO_WEEK, 0.0))
    if report.t_first_s is None or report.t_last_s is None or report.t_first_s > t0 + 2 * WEEK_S:
        if doubt := doubtful_date(log.states["t_gps_s"]):
            report.note(doubt)
        return log
    report.synchronised = False
    report.t_first_s, report.t_last_s = report.t_first_s - t0, report.t_last_s - t0
    report.note(
        f"The file holds {lacking}, only seconds of the week: give its GPS week (logs.gps_week) to place it."
    )
    log.states["t_gps_s"] = np.nan
    return log


def _is_table(kind: str, head: bytes, size: int) -> bool:
    """True if the first lines hold nothing but the numbers of the format, with a rotation among them."""
    lines = [line.strip(b", \t\r") for line in head.removeprefix(b"\xef\xbb\xbf").splitlines()[:30]]
    lines = [line for line in lines if line]
    first = next((k for k, line in enumerate(lines) if re.match(rb"[-+.\d]", line)), len(lines))
    heads = [line.decode("utf-8", "replace") for line in lines[:first]]
    lines = lines[first : -1 if size > len(head) and len(lines) > first + 1 else None]
    try:
        rows = [[float(cell) for cell in re.split(rb"[,\s]+", line)] for line in lines[:10]]
    except ValueError:
        return False
    if not rows or len({len(row) for row in rows}) > 1:
        return False
    n, commas = len(rows[0]), b"," in lines[0]
    if kind == "kitti":
        return n == 12 and not commas and all(_is_unit(row[k : k + 3]) for row in rows for k in (0, 4, 8))
    if n < 8:
        return False
    at = pose_columns(kind, heads, n)
    unit = all(_is_unit([row[at[name]] for name in ("qw", "qx", "qy", "qz")]) for row in rows)
    in_ns = all(row[at["t"]] > 1e12 for row in rows)
    if kind == "tum":
        named = at == pose_columns("euroc", heads, n)  # only lines above the numbers make both alike
        return unit and (not commas or not in_ns) and (named or (n == 8 and not commas))
    return unit and in_ns and commas


def _is_unit(values: Sequence[float]) -> bool:
    return abs(sum(v * v for v in values) - 1.0) < 1e-2


def _anpp_share(head: bytes, size: int) -> float:
    return framed_share(intact_bytes(head, sbp=False), head)


def _records(head: bytes, size: int, record_bytes: int) -> list[ArrayF]:
    """Records (n, k) of doubles in both orders of bytes; none of a file that holds less than two."""
    whole = head[: len(head) // record_bytes * record_bytes if size >= 2 * record_bytes else 0]
    return [np.frombuffer(whole, f"{order}f8").reshape(-1, record_bytes // 8) for order in "<>" if len(whole)]


def _is_sbet(head: bytes, size: int) -> float:
    for records in _records(head, size, _SBET_RECORD):
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
            return _BY_VALUES
    return 0.0


def _is_smrmsg(head: bytes, size: int) -> float:
    """Times that go up, and beside them nothing but small positive numbers."""
    limits = np.repeat(_ROUGH, 3)
    for records in _records(head, size, _SMRMSG_RECORD) if size % _SMRMSG_RECORD == 0 else ():
        with np.errstate(invalid="ignore"):
            small = (records[:, 1:] > 1e-9) & (records[:, 1:] < limits)
            step = np.diff(records[:, 0])
        if small.all() and (records[:, 0] >= 0).all() and ((step > 0) & (step < 10)).mean() > 0.9:
            return _BY_VALUES
    return 0.0


def _describe_smrmsg(kind: str, files: list[Path], options: dict[str, Any]) -> PositionLog:
    size = files[0].stat().st_size
    details = {"records": f"{size // _SMRMSG_RECORD:,}", "use": "logs.smrmsg, beside its SBET"}
    report = CalibrationReport.of(
        "smrmsg", "standard deviations of an SBET", files[:1], bytes_read=size, details=details
    )
    return PositionLog(report=report)


POSES: Final = (
    BAG,
    Format(
        kind="inertial_explorer",
        words="NovAtel Inertial Explorer text",
        streams=("sbet",),
        matches=is_inertial_explorer,
        poses=read_inertial_explorer,
        describe=partial(_describe_weekless, read_inertial_explorer, "neither week nor date"),
    ),
    *(
        Format(
            kind=kind,
            words=words,
            streams=() if kind == "kitti" else ("ins",),  # whose times stand in another file
            matches=partial(_is_table, kind),
            poses=partial(_poses, kind),
            describe=_describe_poses,
        )
        for kind, words in (
            ("tum", "TUM trajectory"),
            ("euroc", "EuRoC trajectory"),
            ("kitti", "KITTI poses"),
        )
    ),
    Format(
        kind="anpp",
        words="Advanced Navigation ANPP log",
        streams=("ins", "depth"),
        matches=_anpp_share,
        poses=lambda files, options: read_anpp(files),
    ),
    *(
        Format(kind=kind, words=words, streams=("ins", "depth"), matches=matches, poses=read_ardupilot)
        for kind, words, matches in (
            ("dataflash", "ArduPilot dataflash log", is_dataflash),
            ("mavlink", "MAVLink telemetry", is_telemetry),
        )
    ),
    Format(
        kind="sbet",
        words="SBET trajectory",
        streams=("sbet",),
        matches=_is_sbet,
        poses=_sbet,
        describe=partial(_describe_weekless, _sbet, "no week"),
    ),
    Format(
        kind="smrmsg",
        words="SMRMSG, standard deviations of an SBET",
        streams=("smrmsg",),
        matches=_is_smrmsg,
        describe=_describe_smrmsg,
    ),
)
