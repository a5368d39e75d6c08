"""Open any log that Thalweg reads, and say what it is: model, time span, counts, rates, gaps, defects."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core.errors import ClockError, InputError
from thalweg.core.timescales import gps_from_week
from thalweg.core.types import AnyArray, ArrayF32
from thalweg.ingest.integrity import IntegrityReport
from thalweg.ingest.photos.exif import read_head
from thalweg.ingest.photos.stamps import read_image_stamps
from thalweg.ingest.registry.describe_calibration import CalibrationReport
from thalweg.ingest.registry.recognise import KINDS, recognise

# ---------------------------------------------------------------- what photographs and the tables beside them
# hold, in lines for a terminal


_KEYS: Final = {
    "control_points": "logs.time_lapse.control_points",
    "marks": "logs.time_lapse.marks",
    "gcp_list": "logs.time_lapse.control_points and logs.time_lapse.marks",
    "metashape_markers": "logs.time_lapse.control_points and logs.time_lapse.marks",
    "metashape_cameras": "logs.time_lapse.orientations",
    "orientations": "logs.time_lapse.orientations",
    "image_times": "logs.time_lapse.times",
}


def describe_images(kind: str, path: Path) -> IntegrityReport:
    """Report on a photograph, or on a table that belongs to photographs.

    Parameters
    ----------
    kind : one of those of `recognise` that photographs have to do with.
    path : the file.

    Raises
    ------
    InputError : the photograph is damaged, or the table is no UTF-8 text.
    """
    if kind == "photograph":
        head = read_head(path)
        report = CalibrationReport(stream="camera", format=KINDS[kind], files=[str(path)])
        report.model = f"{head.make} {head.model}".strip()
        report.details["size"] = f"{head.width} x {head.height} pixels"
        try:
            stamps = read_image_stamps(path)
        except ClockError as error:
            report.note(error.found)
        else:
            known = stamps.table["source"][0]
            report.details["time"] = f"{stamps.table['t_device_s'][0]:.3f} s (GPS time less 1e9) from {known}"
        return report
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            "no UTF-8 text", expected=KINDS[kind], where=path, cure="Save it as UTF-8"
        ) from error
    lines = [line for line in text.splitlines() if line.strip()]
    report = CalibrationReport(stream="images", format=KINDS[kind], files=[str(path)])
    if kind.startswith("metashape"):
        counted = {name: len(re.findall(rf"<{name}\s", text)) for name in ("camera", "marker", "location")}
        report.details["holds"] = ", ".join(f"{n} elements {name}" for name, n in counted.items() if n)
    else:
        report.details["begins"] = lines[0].strip()[:100]
        report.details["rows"] = str(len(lines) - 1)
    report.details["belongs"] = f"in {_KEYS[kind]} of a campaign file"
    return report


# ---------------------------------------------------------------- describe


_ANY_WEEK = 2000
"""Stands in for the week of an SBET that is only described; taken off again."""


@dataclass(slots=True, kw_only=True)
class Recording:
    """What a log holds, as far as a first look needs it.

    ``tables`` has any of ``positions`` (kind ``gnss_position``), ``states`` (``ins_state``) and ``depths``
    (``depth``); ``points_scs_m`` (n, 3) with ``intensity`` and ``ring`` are a lidar's, ``cloud_m`` (n, 3)
    is a finished point cloud's.
    """

    kind: str
    report: IntegrityReport
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    points_scs_m: ArrayF32 | None = None
    intensity: AnyArray | None = None
    ring: AnyArray | None = None
    cloud_m: AnyArray | None = None


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
    return load_recording([path], options=options, points=False).report


def load_recording(
    files: list[Path],
    *,
    reader: str = "auto",
    base: list[Path] | None = None,
    nav: list[Path] | None = None,
    options: Mapping[str, Any] | None = None,
    points: bool = True,
) -> Recording:
    """Read a log of any kind.

    Parameters
    ----------
    files : parts of one recording in order of time.
    reader : ``"auto"`` tells the kind from the content; ``"ppk"`` solves raw GNSS.
    base, nav : for ``ppk``.
    options : keywords of the reader: `LidarOptions`, ``date`` for NMEA, ``gps_week`` for SBET, PPK options.
    points : also read the points of a lidar; False scans them only.

    Raises
    ------
    InputError : see `describe`.
    """
    options = dict(options or {})
    if reader == "ppk":
        from thalweg.ingest.ppk.options import PpkOptions
        from thalweg.ingest.ppk.solution import run_ppk

        solution = run_ppk(files, base or None, nav or [], PpkOptions.from_sections({}, options))
        return Recording(kind="ppk", report=solution.report, tables={"positions": solution.positions})
    kind = recognise(files[0])
    return _READERS[kind](kind, files, options, points)


def _lidar(kind: str, files: list[Path], options: dict[str, Any], points: bool) -> Recording:
    from thalweg.ingest.velodyne.reader import LidarOptions, iter_points, scan_lidar

    lidar = LidarOptions(**options)
    scan = scan_lidar(files, lidar)
    recording = Recording(kind=kind, report=scan.report)
    if points:
        blocks = list(iter_points(files, lidar, clock=scan.clock))
        if blocks:
            recording.points_scs_m = np.concatenate([b.xyz_scs_m for b in blocks])
            recording.intensity = np.concatenate([b.intensity for b in blocks])
            recording.ring = np.concatenate([b.ring for b in blocks])
    return recording


def _anpp(kind: str, files: list[Path], options: dict[str, Any], points: bool) -> Recording:
    from thalweg.ingest.anpp.reader import read_anpp

    log = read_anpp(files, **options)
    return Recording(kind=kind, report=log.report, tables={"states": log.states, "positions": log.gnss})


def _sbp(kind: str, files: list[Path], options: dict[str, Any], points: bool) -> Recording:
    from thalweg.ingest.sbp.reader import read_sbp

    log = read_sbp(files, **options)
    return Recording(kind=kind, report=log.report, tables={"positions": log.positions})


def _pos(kind: str, files: list[Path], options: dict[str, Any], points: bool) -> Recording:
    from thalweg.ingest.tracks.rtklib_pos import read_pos

    log = read_pos(files, **options)
    return Recording(kind=kind, report=log.report, tables={"positions": log.positions})


def _nmea(kind: str, files: list[Path], options: dict[str, Any], points: bool) -> Recording:
    from thalweg.ingest.nmea.reader import read_nmea

    log = read_nmea(files, **options)
    return Recording(kind=kind, report=log.report, tables={"positions": log.positions, "depths": log.depths})


def _rinex(kind: str, files: list[Path], options: dict[str, Any], points: bool) -> Recording:
    from thalweg.ingest.ppk.rinex import describe_rinex

    return Recording(kind=kind, report=describe_rinex(files[0]))


def _sbet(kind: str, files: list[Path], options: dict[str, Any], points: bool) -> Recording:
    from thalweg.ingest.tracks.sbet import read_sbet

    week = options.get("gps_week")
    log = read_sbet(files, gps_week=_ANY_WEEK if week is None else week)
    if week is None:
        # Enough to describe the file: its stamps as they stand there, and no GPS time.
        t0 = float(gps_from_week(_ANY_WEEK, 0.0))
        report = log.report
        report.synchronised = False
        report.t_first_s = None if report.t_first_s is None else report.t_first_s - t0
        report.t_last_s = None if report.t_last_s is None else report.t_last_s - t0
        report.note("An SBET holds seconds of the week only: give its GPS week (logs.gps_week) to place it.")
        log.states["t_gps_s"] = np.nan
    return Recording(kind=kind, report=log.report, tables={"states": log.states})


def _cloud(kind: str, files: list[Path], options: dict[str, Any], points: bool) -> Recording:
    from thalweg.ingest.clouds.reader import read_cloud

    cloud = read_cloud(files[0])
    return Recording(
        kind=kind, report=cloud.report, cloud_m=cloud.points if points else None, intensity=cloud.intensity
    )


def _calibration(kind: str, files: list[Path], options: dict[str, Any], points: bool) -> Recording:
    from thalweg.ingest.registry.describe_calibration import describe_calibration

    return Recording(kind=kind, report=describe_calibration(kind, files[0]))


def _images(kind: str, files: list[Path], options: dict[str, Any], points: bool) -> Recording:

    return Recording(kind=kind, report=describe_images(kind, files[0]))


_READERS: dict[str, Callable[[str, list[Path], dict[str, Any], bool], Recording]] = {
    "capture": _lidar,
    "velodyne_payloads": _lidar,
    "anpp": _anpp,
    "sbp": _sbp,
    "pos": _pos,
    "nmea": _nmea,
    "rinex": _rinex,
    "sbet": _sbet,
    "las": _cloud,
    "ply": _cloud,
    "e57": _cloud,
    "calibration": _calibration,
    "kalibr": _calibration,
    "matrix": _calibration,
    "colmap": _calibration,
    "opencv": _calibration,
    "photograph": _images,
    "control_points": _images,
    "marks": _images,
    "gcp_list": _images,
    "metashape_markers": _images,
    "metashape_cameras": _images,
    "orientations": _images,
    "image_times": _images,
}
if set(_READERS) != set(KINDS):
    raise InputError(f"kinds without reader: {set(KINDS) ^ set(_READERS)}", where=__name__)
