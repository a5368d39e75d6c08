"""Trajectories that other programs wrote as text: TUM, EuRoC, KITTI, NovAtel Inertial Explorer, GPX.

========= =============================================== ===================== ==========================
format    columns                                         quaternion, rotation  frame, time
========= =============================================== ===================== ==========================
TUM       t tx ty tz qx qy qz qw                          Hamilton, x y z w     metres in its world frame
EuRoC     t_ns, p_x p_y p_z, q_w q_x q_y q_z [, v, b]     Hamilton, w x y z     metres in its world frame
KITTI     3x4 row-major, times in a file beside           rotation matrix       metres in its world frame
Inertial  named in its header: Week, GPSTime, Latitude,   roll, pitch, heading  geodetic; GPS week and
Explorer  Longitude, H-Ell, Roll, Pitch, Heading, SD...                         seconds of the week
========= =============================================== ===================== ==========================

Rotations turn from the body into the world frame. Where a line above the numbers names the columns, the names
decide, and so does a remark such as ``(w x y z)``. The first three state neither frame, scale of time nor
accuracy: these are asked for. Inertial Explorer's attitude is that of ``ins_state``: roll right side down,
pitch nose up, heading clockwise from north. GPX (Topografix 2004, version 1.1) holds positions in UTC without
standard deviations.
"""

import datetime as dt
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from thalweg.core import (
    DAY_S,
    GPS_EPOCH_UNIX_S,
    ArrayF,
    InputError,
    frame_of,
    gps_from_unix,
    gps_from_week,
    parse_xml,
    roll_pitch_heading,
)
from thalweg.core.values import is_nothing, matters, unit_of_word
from thalweg.ingest import (
    DEPTH,
    GNSS_POSITION,
    INS_STATE,
    TIME_SCALES,
    UNITS_A_SECOND,
    IntegrityReport,
    PoseLog,
    PositionLog,
    TrackOptions,
    column_of,
    doubtful_date,
    find_gaps,
    gps_from_scale,
    possible_unix,
    tell_time_scale,
    time_scale_words,
)
from thalweg.ingest.tracks.sbet import FINISHED, half_turn

_POSE: Final = ("t", "px", "py", "pz", "qx", "qy", "qz", "qw")
_VELOCITY: Final = ("vx", "vy", "vz")
_ORDER: Final = {"tum": _POSE, "euroc": (*_POSE[:4], "qw", *_POSE[4:7], *_VELOCITY)}
"""Columns where no line names them."""
_NAME: Final = re.compile(
    r"(?:(q|quat\w*|ori\w*|rot\w*)|(v|vel\w*)|(?:|[tp]|pos\w*|trans\w*))(?:_[a-z_]+?)??_?([wxyz])"
)
_REMARKS: Final = {
    "qw qx qy qz": re.compile(r"(?<![a-z])q?w[\s,/]*q?x[\s,/]*q?y[\s,/]*q?z(?![a-z])", re.IGNORECASE),
    "qx qy qz qw": re.compile(r"(?<![a-z])q?x[\s,/]*q?y[\s,/]*q?z[\s,/]*q?w(?![a-z])", re.IGNORECASE),
}
"""Orders of a quaternion as people write them in comments."""
_FRAMES: Final = re.compile(
    r"(?i)\b(?-i:T_[A-Z][A-Z]\b|T_[a-z]+_[a-z]+)|\binverse|\b[zx] *(?:is )?down|world2|w2c|\bodom\b"
)
"""Words on the frames of poses; one that is not read is quoted."""
_OTHER_COLUMNS: Final = (
    (r"(?:^|[\s,;#])(?:lat|latitude)(?:_?deg)?[\s,;]+(?:lon|long|lng|longitude)(?:_?deg)?[\s,;\w]*q_?[wx]",
     "latitudes and longitudes", "Give it as a table of positions, or turn its places into metres"),
    (r"(?i)^(?!.*(?:q_?[wxyz]|quat)).*(?<![a-z])[tp]?_?z\W+(?:roll|yaw|pitch|heading|omega)",
     "angles instead of a quaternion", "Turn them into a quaternion"),
    (r"(?i)(?<![a-z])[tp]?_?[xyz]\s?[\[(_](?:[cm]m|km|ft|feet|us.?ft)\b",
     "places in another unit than metres", "Convert them to metres"),
    (r"(?i)\b[pq]_SR_", "poses of the world in the body (SR)", "Invert them: the body in the world (RS)"),
)  # fmt: skip
"""Columns that name something else than poses of the body in a world in metres."""
_FARTHEST_M: Final = 200_000.0
"""No survey reaches farther from its origin."""

BODY_AXES: Final = {
    "forward-right-down": np.eye(3),
    "forward-left-up": np.diag([1.0, -1.0, -1.0]),
    "right-down-forward": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
}
"""Axes x, y, z of the file's body -> rotation from ics (x forward, y right, z down) into them."""

_ORTHONORMAL: Final = 1e-3
"""Rotations are written with four digits and more."""


@dataclass(slots=True, kw_only=True)
class TextPoses:
    """Poses as a table states them.

    Attributes
    ----------
    t_s : (n,) stamps in seconds, NaN where the format holds none.
    position_m : (n, 3) in the file's world frame.
    R_world_body : (n, 3, 3).
    velocity_mps : (n, 3) in the world frame, or None.
    report : counts, without a time on any scale.
    """

    t_s: ArrayF
    position_m: ArrayF
    R_world_body: ArrayF
    velocity_mps: ArrayF | None
    report: IntegrityReport


def read_text_poses(kind: str, files: Sequence[Path], times: Path | None = None) -> TextPoses:
    """Read a table of poses as it stands, without a frame on Earth.

    Parameters
    ----------
    kind : ``tum``, ``euroc`` or ``kitti``.
    files : in the order of time.
    times : for KITTI: one stamp a line, in seconds.

    Raises
    ------
    InputError : a line does not hold the numbers of the format, a rotation is none, or the times do not fit.
    """
    report = IntegrityReport.of("ins", f"{_NAMES[kind]} poses", files)
    rows = np.concatenate([_numbers(kind, Path(path), report) for path in files])
    where = ", ".join(map(str, files))
    velocity = None
    if kind == "kitti":
        T = rows[:, :12].reshape(-1, 3, 4)
        R, position = T[:, :, :3], T[:, :, 3]
        wrong = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) > _ORTHONORMAL
        wrong |= np.linalg.det(R) < 0
        t_s = np.full(len(rows), np.nan)
        if times is not None:
            _, told = _lines(times, "Check the path of the times")
            try:
                t_s = np.loadtxt(told, ndmin=1, dtype=np.float64)
            except ValueError as error:
                raise InputError(str(error), expected="one time in seconds a line", where=times) from error
            if t_s.shape != (len(rows),):
                raise InputError(
                    f"{t_s.size} times beside {len(rows)} poses of {where}",
                    expected="one time a pose",
                    where=times,
                    cure="Give the times of this very table",
                )
    else:
        position, q_xyzw = rows[:, 1:4], rows[:, 4:8]
        wrong = np.abs(np.linalg.norm(q_xyzw, axis=1) - 1.0) > _ORTHONORMAL
        unit = next(iter(tell_time_scale(rows[:, 0])), "")
        if kind == "euroc" and unit not in UNITS_A_SECOND:
            unit = "unix_ns"
        elif unit in UNITS_A_SECOND and (kind == "tum" or unit != "unix_ns"):
            report.note(f"Its stamps are taken as {TIME_SCALES[unit]}.")
        t_s = rows[:, 0] / UNITS_A_SECOND.get(unit, 1.0)
        if rows.shape[1] > len(_POSE):
            velocity = rows[:, 8:11]
        R = np.empty((0, 3, 3)) if wrong.any() else Rotation.from_quat(q_xyzw).as_matrix()
    if wrong.any():
        raise InputError(
            f"pose {int(np.flatnonzero(wrong)[0]) + 1} of {len(rows)}: the rotation is none",
            expected="a quaternion of length 1, or an orthonormal matrix",
            where=where,
            cure=f"Check that the table is one of {_NAMES[kind]}",
        )
    report.count("poses", len(rows))
    report.time_scale = "device" if np.isfinite(t_s).all() else "none"
    if np.isfinite(t_s).all():
        report.t_first_s, report.t_last_s = float(t_s.min()), float(t_s.max())
        report.gaps = find_gaps(t_s)
    report.details["world"] = "metres in a frame of its own; rotations from the body into it"
    return TextPoses(t_s=t_s, position_m=position, R_world_body=R, velocity_mps=velocity, report=report)


_NAMES: Final = {"tum": "TUM", "euroc": "EuRoC", "kitti": "KITTI"}


def pose_columns(kind: str, heads: Sequence[str], width: int) -> dict[str, int]:
    """Places of time ``t``, position ``px``, quaternion ``qw`` and velocity ``vx`` in a table of poses.

    Parameters
    ----------
    kind : ``tum`` or ``euroc``, whose order counts where no line tells another.
    heads : lines above the numbers.
    width : columns of the table.

    Examples
    --------
    >>> pose_columns("tum", ["# timestamp tx ty tz qw qx qy qz"], 8)["qw"]
    4
    """
    for line in reversed(heads):
        names = re.split(r"[,;\s]+", re.sub(r"\[[^]]*\]|\([^)]*\)", " ", line).strip("#%/ ,;\t").lower())
        found: dict[str, int] = {}
        for k, name in enumerate(names[-width:] if len(names) >= width else ()):
            bare = re.sub(r"[./]", "_", re.sub(r"\b(?:field|pose|transform)[./]", "", name))
            if known := _NAME.fullmatch(bare):
                found.setdefault(("q" if known[1] else "v" if known[2] else "p") + known[3], k)
            elif bare in ("t", "time", "timestamp", "stamp", "sec", "seconds"):
                found.setdefault("t", k)
        if found.keys() >= set(_POSE) - {"t"}:
            return {"t": 0, **found}
        # PX4 and its like count from the real part (Hamilton)
        parts = [
            k
            for k, name in enumerate(re.split(r"[,;\s]+", line.lower()))
            if re.fullmatch(r".*q\w*\[[0-3]\]", name)
        ]
        if len(parts) == 4 and found.keys() >= {"px", "py", "pz"}:
            return {"t": 0, **found, **dict(zip(("qw", "qx", "qy", "qz"), parts, strict=True))}
    order: tuple[str, ...] = _ORDER[kind][:width]
    remarks = {names for names, form in _REMARKS.items() if any(form.search(line) for line in heads)}
    if len(remarks) == 1:
        order = (*order[:4], *remarks.pop().split(), *order[8:])
    return {name: k for k, name in enumerate(order)}


def _numbers(kind: str, path: Path, report: IntegrityReport) -> ArrayF:
    """(n, 12) of KITTI, else (n, 8) time, position, quaternion x y z w, or (n, 11) with velocities behind.

    The first line that does not fit is named.
    """
    n_bytes, lines = _lines(path)
    report.bytes_read += n_bytes
    rows: list[list[float]] = []
    heads: list[str] = []
    for number, line in enumerate(lines, start=1):
        text = line.strip()
        if not text or text.startswith("#"):
            heads += [text] if not rows else []
            continue
        try:
            row = [float(cell) for cell in re.split(r"[,\s]+", text.strip(","))]
        except ValueError:
            row = []
            if not rows and not re.search(r"(?<![a-z_\[])[-+]?\d", text, re.IGNORECASE):
                heads.append(text)
                continue
        fits = len(row) == 12 if kind == "kitti" else len(row) >= 8
        if not fits or not np.isfinite(row).all():
            raise InputError(
                f"line {number}: '{text[:60]}'",
                expected=f"{'12' if kind == 'kitti' else '8 or more'} numbers, as {_NAMES[kind]} has them",
                where=path,
                cure="Check the format of the table",
            )
        rows.append(row)
    if not rows or len({len(row) for row in rows}) > 1:
        raise InputError(
            "no poses" if not rows else "lines of different length",
            expected=f"a {_NAMES[kind]} table",
            where=path,
            cure="Check the file",
        )
    table = np.array(rows)
    for form, found, cure in _OTHER_COLUMNS:
        if head := next((head for head in heads if re.search(form, head)), ""):
            raise InputError(
                f"{found}: '{head[:60]}'",
                expected="metres in a world, and rotations from the body into it",
                where=path,
                cure=cure,
            )
    for head in (head for head in heads if matters(head) or _FRAMES.search(head)):
        report.note(f"{path.name} says '{head[:80]}', which is not read.")
    if kind == "kitti":
        return table
    at = pose_columns(kind, heads, table.shape[1])
    usual = {name: k for k, name in enumerate(_ORDER[kind])}
    if [at[name] for name in _POSE] != [usual[name] for name in _POSE]:
        order = " ".join(sorted(("qw", "qx", "qy", "qz"), key=lambda name: at[name]))
        report.note(f"{path.name} names its columns: the quaternion is read as {order}.")
    return table[:, [at[name] for name in (*_POSE, *(_VELOCITY if at.keys() >= set(_VELOCITY) else ()))]]


def _lines(path: Path, cure: str = "Check the path") -> tuple[int, list[str]]:
    """Number of the bytes, and the lines, of a text file."""
    if not path.is_file():
        raise InputError("file not found", where=path, cure=cure)
    raw = path.read_bytes()
    return len(raw), raw.decode("utf-8-sig", "replace").splitlines()


def states_of_poses(poses: TextPoses, options: TrackOptions) -> PoseLog:
    """Poses of a table as states on Earth, with what the options state.

    The file's world frame is taken for the local frame ``options.frame`` (x east, y north, z up), its body is
    ics but for the direction of its axes.

    Raises
    ------
    InputError : the options lack what the table does not hold; all that is missing is named.
    """
    where, report = ", ".join(poses.report.files), poses.report
    frame, axes, scale = options.frame, options.body_axes, options.time_scale
    sigmas = (options.sigma_position_m, options.sigma_attitude_deg)
    stated = {
        "frame": frame,
        "body_axes": axes,
        "time_scale": scale,
        "sigma_position_m": sigmas[0],
        "sigma_attitude_deg": sigmas[1],
        "times": None if np.isnan(poses.t_s).any() else poses.t_s,
    }
    missing = [name for name, value in stated.items() if value is None]
    if missing or frame is None or axes is None or sigmas[0] is None or sigmas[1] is None:
        raise InputError(
            f"not stated: {', '.join(missing)}",
            expected="what a table of poses does not hold: frame on Earth, axes of the body, scale of time, "
            "standard deviations",
            where=where,
            cure="State them: in a campaign ins.body_axes and ins.time_scale, else as options of the command",
        )
    if axes not in BODY_AXES or scale not in ("utc", "gps"):
        raise InputError(
            f"body_axes '{axes}', time_scale '{scale}'",
            expected=f"one of {', '.join(BODY_AXES)}; utc (Unix time) or gps (seconds since 1980-01-06)",
            where=where,
        )
    told = tell_time_scale(poses.t_s)
    unit = next((each for each in told if each.startswith("unix") == (scale == "utc")), None)
    if unit is None or unit in ("week_s", "day_s"):
        raise InputError(
            time_scale_words(poses.t_s, told),
            expected="Unix time (time_scale utc)" if scale == "utc" else "GPS seconds (time_scale gps)",
            where=where,
            cure="Correct time_scale, or the times of the table",
        )
    t_gps_s = gps_from_scale(poses.t_s, unit)
    if unit not in ("unix_s", "gps_s"):
        report.note(f"Its times are taken as {TIME_SCALES[unit]}.")
    if len(poses.t_s) and (away_m := float(np.abs(poses.position_m).max())) > _FARTHEST_M:
        raise InputError(
            f"poses up to {away_m / 1000:,.0f} km from the origin of their world",
            expected="metres east, north, up from the origin (campaign.origin)",
            where=where,
            cure="If they are places on a map (UTM), take off those of the origin",
        )
    lat, lon, height = frame.to_geodetic(poses.position_m)
    # attitudes are stated in the local level of each position, not in that of the frame's origin
    R_enu_wcs = np.swapaxes(frame.R_wcs_enu(lat, lon), -1, -2)
    roll, pitch, heading = roll_pitch_heading(R_enu_wcs @ poses.R_world_body @ BODY_AXES[axes])
    velocity = np.full((len(lat), 3), np.nan)
    if poses.velocity_mps is not None:
        velocity = np.einsum("nij,nj->ni", R_enu_wcs, poses.velocity_mps)
    attitude_rad = np.deg2rad(sigmas[1])
    states = frame_of(
        INS_STATE,
        {
            **FINISHED,
            "t_gps_s": t_gps_s,
            "t_device_s": poses.t_s,
            "lat_deg": lat,
            "lon_deg": lon,
            "h_ell_m": height,
            "v_east_mps": velocity[:, 0],
            "v_north_mps": velocity[:, 1],
            "v_down_mps": -velocity[:, 2],
            "roll_rad": roll,
            "pitch_rad": pitch,
            "heading_rad": heading,
            **{f"sigma_{axis}_m": sigmas[0] for axis in ("north", "east", "up")},
            **{f"sigma_{angle}_rad": attitude_rad for angle in ("roll", "pitch", "heading")},
        },
        unknown=np.nan,
    )
    report.synchronised, report.time_scale = True, "utc" if scale == "utc" else "gps"
    report.take_times(t_gps_s, "poses")
    if np.isfinite(attitude_rad):
        each = f"{sigmas[0]} m and {sigmas[1]} deg for each pose"
        report.note(f"Standard deviations are stated, not the table's: {each}.")
    return PoseLog(states=states, report=report)


# ---------------------------------------------------------------- NovAtel Inertial Explorer


_ALIASES: Final = {
    "tow": ("GPSTime", "CorrTime", "SoW", "GPSSec", "Seconds", "GPSSeconds", "TimeOfWeek"),
    "week": ("Week", "GPSWeek"),
    "date": ("Date", "GPSDate", "LocalDate"),
    "lat": ("Latitude", "Lat"),
    "lon": ("Longitude", "Lon", "Long"),
    "height": ("H-Ell", "H-Ellips", "EllHeight", "HEll"),
    "v_east": ("VEast", "VE"),
    "v_north": ("VNorth", "VN"),
    "v_up": ("VUp", "VU"),
    "roll": ("Roll",),
    "pitch": ("Pitch",),
    "heading": ("Heading", "Azimuth", "Yaw"),
    "sd_east": ("SDEast", "SD-E", "EastSD"),
    "sd_north": ("SDNorth", "SD-N", "NorthSD"),
    "sd_horizontal": ("SDHoriz", "HorizSD"),
    "sd_up": ("SDHeight", "SDUp", "SD-VT", "SDVert", "HeightSD", "UpSD"),
    "sd_roll": ("RollSD", "SDRoll"),
    "sd_pitch": ("PitchSD", "PtchSD", "SDPitch"),
    "sd_heading": ("HdngSD", "HeadingSD", "SDHeading", "AzimuthSD"),
}
"""Our names of the columns -> those of export profiles, told without regard to capitals and hyphens."""
_METRES: Final = re.compile(r"(?:\+/-)?m(?:et(?:er|re)s?)?(?:/s(?:ec)?)?")
_EXPORT_REMARKS: Final = re.compile(
    r"(?i)^\s*datum:(?! *(?:wgs ?-?84|itrf))|\btime\b(?!.*offset).*\butc\b|\b9\d(?:\.\d+)? ?%"
    r"|\b[23][ -]?sigma"
)
"""Lines of a header on datum, time and standard deviations that change what the columns mean."""
_MOST_DAYS_APART: Final = 1.5
"""Middle of the stated day from a time: half a day, and one that a zone may shift the date."""
_NEEDED: Final = ("tow", "lat", "lon", "height", "roll", "pitch", "heading")
_NO_HYPHENS: Final = str.maketrans("", "", "-_")
_OURS: Final = {x.lower().translate(_NO_HYPHENS): ours for ours, names in _ALIASES.items() for x in names}
_DEG_OF_UNIT: Final = {"deg": 1.0, "degrees": 1.0, "d": 1.0, "min": 1 / 60, "arcmin": 1 / 60, "sec": 1 / 3600,
                       "arcsec": 1 / 3600, "rad": 180 / np.pi}  # fmt: skip


def is_inertial_explorer(head: bytes, size: int) -> bool:
    """True if a file has the column header of an export of Inertial Explorer."""
    return _header(head.decode("ascii", "replace").splitlines()) is not None


def _header(lines: Sequence[str]) -> int | None:
    """Number of the line with the names of the columns."""
    for number, line in enumerate(lines[:200]):
        if {"tow", "lat", "lon", "roll"} <= {
            _OURS.get(name.lower().translate(_NO_HYPHENS)) for name in line.split()
        }:
            return number
    return None


def read_inertial_explorer(files: Sequence[Path], options: TrackOptions | None = None) -> PoseLog:
    """States of text exports of NovAtel Inertial Explorer, by the names and units of their header.

    Parameters
    ----------
    files : in the order of time.
    options : ``gps_week`` where there is no column of it or of the date; standard deviations where the export
        has none, else they are NaN.

    Raises
    ------
    InputError : a column that is needed is missing, a unit is not known, or a line is damaged.
    """
    options = options or TrackOptions()
    report = IntegrityReport.of(
        "ins", "NovAtel Inertial Explorer", files, time_scale="gps", synchronised=True
    )
    columns = pd.concat([_columns(Path(path), report) for path in files], ignore_index=True)
    where = ", ".join(map(str, files))
    if "week" not in columns and "date" in columns:
        columns["week"] = _weeks(columns["date"].to_numpy(), columns["tow"].to_numpy(), where)
    if "week" not in columns:
        if options.gps_week is None:
            raise InputError(
                "no column Week or Date",
                expected="the GPS week",
                where=where,
                cure="Export it, or set logs.gps_week",
            )
        columns["week"] = float(options.gps_week)
    zero = [
        name for name in columns.columns.astype(str) if name.startswith("sd_") and not columns[name].any()
    ]
    columns = columns.drop(columns=zero)  # of a profile with too few digits, or of no filter
    if "sd_horizontal" in columns:
        report.note("SDHoriz holds both axes: east and north are taken as alike, SDHoriz over the root of 2.")
        for name in ("sd_east", "sd_north"):
            if name not in columns:
                columns[name] = columns["sd_horizontal"] / np.sqrt(2.0)
    for names, value, what in (
        (("sd_east", "sd_north", "sd_up"), options.sigma_position_m, "positions"),
        (("sd_roll", "sd_pitch", "sd_heading"), options.sigma_attitude_deg, "attitudes"),
    ):
        lacking = [name for name in names if name not in columns]
        for name in lacking:
            columns[name] = np.nan if value is None else value
        if lacking and value is None:
            absent = ", ".join(_ALIASES[name][0] for name in lacking)
            report.note(f"It states no standard deviations of {what} ({absent}): to be exported, or stated.")
    c = {name: columns[name].to_numpy(dtype=np.float64) for name in columns}
    t_gps_s = gps_from_week(c["week"], c["tow"])
    states = frame_of(
        INS_STATE,
        {
            **FINISHED,
            "t_gps_s": t_gps_s,
            "lat_deg": c["lat"],
            "lon_deg": half_turn(c["lon"]),
            "h_ell_m": c["height"],
            "v_east_mps": c.get("v_east", np.nan),
            "v_north_mps": c.get("v_north", np.nan),
            "v_down_mps": -c.get("v_up", np.nan),
            "roll_rad": np.deg2rad(c["roll"]),
            "pitch_rad": np.deg2rad(c["pitch"]),
            "heading_rad": np.mod(np.deg2rad(c["heading"]), 2 * np.pi),
            "sigma_east_m": c["sd_east"],
            "sigma_north_m": c["sd_north"],
            "sigma_up_m": c["sd_up"],
            "sigma_roll_rad": np.deg2rad(c["sd_roll"]),
            "sigma_pitch_rad": np.deg2rad(c["sd_pitch"]),
            "sigma_heading_rad": np.deg2rad(c["sd_heading"]),
        },
        unknown=np.nan,
    )
    report.count("poses", len(states))
    report.take_times(t_gps_s, "poses")
    return PoseLog(states=states, report=report)


def _columns(path: Path, report: IntegrityReport) -> pd.DataFrame:
    """The known columns of one export, angles in degrees."""
    n_bytes, lines = _lines(path)
    report.bytes_read += n_bytes
    first = _header(lines)
    if first is None:
        raise InputError(
            "no line with the names of the columns",
            expected="GPSTime, Latitude, Longitude, H-Ell, Roll, Pitch, Heading among them",
            where=path,
            cure="Export with a header",
        )
    for line in filter(_EXPORT_REMARKS.search, lines[:first]):
        report.note(f"{path.name} says '{line.strip()[:80]}', which is not read.")
    names = lines[first].split()
    if "yaw" in map(str.lower, names):
        report.note(
            f"{path.name} names its heading Yaw: taken as clockwise from north. NovAtel's own yaw counts "
            "counterclockwise: export Heading."
        )
    units = re.findall(r"\(([^)]*)\)", "".join(lines[first + 1 : first + 2]))
    if len(units) > len(names):  # degrees, minutes and seconds in brackets of their own
        text = "\n".join(map(str.strip, units))
        units = re.sub(r"(?im)^(?:\+/-)?d(?:eg)?\nm(?:in)?\ns(?:ec)?$", "D M S", text).split("\n")
    if len(units) != len(names):
        raise InputError(
            f"{len(units)} units below {len(names)} names of columns",
            expected="a line of units in brackets, one a column",
            where=path,
            cure="Export with a header of names and units",
        )
    at: dict[str, tuple[int, int, str]] = {}
    place = 0
    for name, unit in zip(names, units, strict=True):
        parts = 3 if "M S" in unit.upper().replace("-", " ") else 1  # degrees, minutes, seconds
        known = _OURS.get(name.lower().translate(_NO_HYPHENS))
        if known is not None:
            at.setdefault(known, (place, parts, unit))
        place += parts
    day_at, _, form = at.get("date", (-1, 1, ""))
    lacking = [_ALIASES[name][0] for name in _NEEDED if name not in at]
    if lacking:
        raise InputError(
            f"no column {', '.join(lacking)}",
            expected="time, geodetic position and attitude",
            where=path,
            cure="Add them to the export profile",
        )
    rows = []
    for number, line in enumerate(lines[first + 2 :], start=first + 3):
        cells = line.split()
        if not cells:
            continue
        try:
            rows.append(
                [_day(cell, form) if k == day_at else _number(cell) for k, cell in enumerate(cells[:place])]
            )
        except ValueError:
            rows.append([])
        if len(rows[-1]) != place:
            if number == len(lines):  # cut short while it was written
                report.lose("damaged_lines")
                rows.pop()
                continue
            raise InputError(
                f"line {number}: '{line.strip()[:60]}'",
                expected=f"{place} numbers",
                where=path,
                cure="Export again",
            )
    if not rows:
        raise InputError("no poses", expected="lines of numbers below the header", where=path)
    table = np.array(rows)
    columns = {}
    for name, (k, parts, unit) in at.items():
        values = table[:, k]
        if parts == 3:
            sign = np.where(np.signbit(values), -1.0, 1.0)
            values = sign * (np.abs(values) + table[:, k + 1] / 60 + table[:, k + 2] / 3600)
        elif name in ("lat", "lon", "roll", "pitch", "heading", "sd_roll", "sd_pitch", "sd_heading"):
            word = unit.strip().lower().removeprefix("+/-").strip()
            if word not in _DEG_OF_UNIT:
                raise InputError(
                    f"unit '{unit}' of {_ALIASES[name][0]}",
                    expected=", ".join(_DEG_OF_UNIT),
                    where=path,
                    cure="Export angles in degrees",
                )
            values = values * _DEG_OF_UNIT[word]
        elif name == "tow" and "utc" in unit.lower():
            raise InputError(
                f"times in '{unit}'",
                expected="seconds of the GPS week, without leap seconds",
                where=path,
                cure="Export GPS time",
            )
        elif name not in ("tow", "week", "date") and not _METRES.fullmatch(unit.strip().lower()):
            raise InputError(
                f"unit '{unit}' of {_ALIASES[name][0]}", expected="m, m/s", where=path, cure="Export metres"
            )
        columns[name] = values
    if "h" in at["tow"][2].lower():  # hours, minutes and seconds of the day
        if "date" not in columns:
            raise InputError(
                "times of the day without a date",
                expected="a column Date, or seconds of the GPS week",
                where=path,
                cure="Add one of them to the export profile",
            )
        columns["tow"] += (columns["date"] + 4) % 7 * DAY_S  # 1970 began on a Thursday
    return pd.DataFrame(columns)


def _number(cell: str) -> float:
    """A number, or seconds of the day of a clock such as 10:00:18.5."""
    hours, *rest = cell.split(":")
    if not rest:
        return float(cell)
    minutes, seconds = rest
    return int(hours) * 3600.0 + int(minutes) * 60.0 + float(seconds)


@lru_cache(maxsize=64)
def _day(cell: str, form: str) -> float:
    """Day since 1970 of a date in the order of its unit, such as ``MDY``; the year first needs none.

    Raises
    ------
    ValueError : it is no date, or its order is not stated.
    """
    numbers = [int(x) for x in re.split(r"[-/.]", cell)]
    order = "".join(dict.fromkeys(re.sub("[^dmy]", "", form.lower())))
    if numbers[0] > 999:
        order = "ymd"
    if len(numbers) != 3 or sorted(order) != ["d", "m", "y"]:
        raise ValueError(f"date {cell} ({form})")
    day = dict(zip(order, numbers, strict=True))
    year = day["y"] + (2000 if day["y"] < 100 else 0)
    return float(dt.date(year, day["m"], day["d"]).toordinal() - dt.date(1970, 1, 1).toordinal())


def _weeks(day: ArrayF, tow_s: ArrayF, where: str) -> ArrayF:
    """GPS week (n,) in which second ``tow_s`` of the week lies at the date ``day`` (since 1970).

    Raises
    ------
    InputError : the seconds are on another day of the week; a zone or UTC may shift it by one.
    """
    middle = day + 0.5 - GPS_EPOCH_UNIX_S / DAY_S - tow_s / DAY_S
    week = np.rint(middle / 7.0)
    apart = np.abs(middle - 7.0 * week)
    if np.median(apart) > _MOST_DAYS_APART:
        k = int(np.argmax(apart))
        date = dt.date(1970, 1, 1) + dt.timedelta(days=int(day[k]))
        raise InputError(
            f"second {tow_s[k]:,.0f} of the week on {date:%Y-%m-%d}, a {date:%A}",
            expected="seconds of the GPS week that lie on the date beside them",
            where=where,
            cure="Export the time as GPS seconds of the week",
        )
    return week


# ---------------------------------------------------------------- GPX

_UNUSED: Final = {"wpt": "waypoints", "rtept": "points of routes"}
_UNIT_IN_WORDS: Final = re.compile(rb"(?i)\b(?:depths?|units?)\b[^<>]{0,30}\b(?:feet|foot|ft|fathoms?)\b")
_UNIT_OF_DEPTHS: Final = re.compile(rb"(?i)depth[^<>]*(?:unit|uom|ft|feet|fathom)[^<>]*>")
_TAKE_TURNS: Final = 0.1
"""Share of points whose next one in time is of another track, where a receiver makes one after the other."""
_FIX_OF_GPX: Final = {"none": "none", "dgps": "dgnss"}


def read_gpx(files: Sequence[Path]) -> PositionLog:
    """Track points of GPX files in the order of the files.

    ``ele`` is above the geoid: with ``geoidheight`` beside it the ellipsoidal height is their sum, else it is
    NaN. Points without a time are counted and left out. Depths in extensions of any name space, such as
    ``depth`` or ``water_depth``, come as soundings; times without a zone count as UTC, which a note says.

    Raises
    ------
    InputError : a file is no GPX, or no track point in them has a time.
    """
    report = IntegrityReport.of("positions", "GPX", files, time_scale="utc", synchronised=True)
    rows: list[tuple[float, float, float, float, str, int]] = []
    depths: list[tuple[float, float]] = []
    foreign: Counter[str] = Counter()
    without_zone = below = 0
    remark = ""
    for path in files:
        data = path.read_bytes()
        if (said := _UNIT_IN_WORDS.search(data.split(b"<trk", 1)[0])) and not _UNIT_OF_DEPTHS.search(data):
            remark = said[0].decode("utf-8", "replace")
        report.bytes_read += len(data)
        root = parse_xml(data, path, "track points with lat, lon and time")
        try:
            foreign.update(each.tag.split("}")[-1] for each in root.iter() if isinstance(each.tag, str))
            for point in root.iterfind(".//{*}trkpt"):
                told = {each.tag.split("}")[-1]: (each.text or "").strip() for each in point}
                if not told.get("time"):
                    report.lose("track_points_without_time")
                    continue
                moment = dt.datetime.fromisoformat(told["time"])
                without_zone += moment.tzinfo is None
                unix_s = (moment if moment.tzinfo else moment.replace(tzinfo=dt.UTC)).timestamp()
                if not possible_unix(unix_s):
                    report.lose("track_points_at_impossible_times")
                    continue
                below += float(told.get("ele", "nan")) < 0
                h = float(told.get("ele", "nan")) + float(told.get("geoidheight", "nan"))
                fix = _FIX_OF_GPX.get(told.get("fix", ""), "single")
                place = float(point.attrib["lat"]), float(point.attrib["lon"])
                rows.append((unix_s, *place, h, fix, int(told.get("sat", "-1"))))
                depth_m = _depth_m(point)
                if depth_m is not None and np.isnan(depth_m):
                    report.lose("depths_of_nothing")
                elif depth_m is not None:
                    depths.append((unix_s, depth_m))
        except (KeyError, ValueError) as error:
            raise InputError(
                f"no readable GPX ({error})",
                expected="track points with lat, lon and time",
                where=path,
                cure="Export the track again as GPX 1.1",
            ) from error
    if not rows:
        raise InputError(
            "no track point with a time",
            expected="a recorded track; routes and waypoints have no times",
            where=files[0],
            cure="Export the recorded track, not the route",
        )
    table = pd.DataFrame(rows, columns=["t_gps_s", "lat_deg", "lon_deg", "h_ell_m", "fix", "n_sats"])
    table["t_gps_s"] = gps_from_unix(table["t_gps_s"])
    t = table["t_gps_s"].to_numpy()
    report.take_times(t, "positions")
    report.count("positions", len(table))
    if table["h_ell_m"].isna().any():
        report.note("Heights of GPX are above the geoid, and the file does not say how high that is.")
    report.note("GPX states no standard deviations: orientation.sigma_position_m says them.")
    if doubt := doubtful_date(t):
        report.note(doubt)
    segment = np.cumsum(np.diff(t, prepend=t[0]) < 0)
    if len(t) > 1 and np.mean(np.diff(segment[np.argsort(t, kind="stable")]) != 0) > _TAKE_TURNS:
        report.note("Its tracks are of the same time, of two receivers or recorded twice: give one of them.")
    if without_zone:
        report.note(
            f"{without_zone:,} times state no zone: taken as UTC. Some programs write local time: "
            "compare them with another log."
        )
    if unused := [f"{foreign[tag]:,} {words}" for tag, words in _UNUSED.items() if foreign[tag]]:
        report.note(f"Only tracks are read, not the {' and '.join(unused)}.")
    if below > 0.9 * len(rows):
        report.note("Its elevations are negative: depths, perhaps, which are not read from there.")
    log = PositionLog(report=report, positions=frame_of(GNSS_POSITION, dict(table), unknown=np.nan))
    if depths and remark:
        raise InputError(
            f"depths without a unit of their own beside '{remark}'",
            expected="metres, or depths that state their unit",
            where=files[0],
            cure="Name the unit in the elements (depth_ft, or unit='ft'), or export metres",
        )
    if depths:
        unix_s, depth_m = np.array(depths).T
        values = {"t_gps_s": gps_from_unix(unix_s), "depth_m": depth_m, "line": np.arange(1, len(depths) + 1)}
        log.depths = frame_of(DEPTH, {**values, "sentence": "GPX"}, unknown=np.nan)
        report.count("depths", len(depths))
        report.note(
            "Its depths do not say whether they begin at the transducer or the water line: they are taken as "
            "below the transducer (logs.depth)."
        )
    return log


def _depth_m(point: Element) -> float | None:
    """Depth of a track point in metres, wherever its extensions hold it; NaN where it stands for none."""
    for each in point.iter():
        name = column_of(each.tag.split("}")[-1].replace("_", " "))
        text = (each.text or "").strip()
        if name.words != "depth" or not text:
            continue
        stated = next(
            (each.attrib[key] for key in ("unit", "units", "uom") if key in each.attrib),
            name.unit.name if name.unit else "m",
        )
        unit = unit_of_word(stated)
        if unit is None or name.unit not in (None, unit):
            raise ValueError(f"{name.name} in '{stated}'")
        value = float(text)
        return float("nan") if is_nothing(value, "depth") else value * unit.metres
    return None
