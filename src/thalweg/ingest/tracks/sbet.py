"""SBET trajectories (smoothed best estimate of trajectory, Applanix POSPac) with their sigmas.

A record is 17 doubles: GPS second of the week, latitude, longitude (rad), ellipsoidal height (m),
velocity x, y, z (m/s), roll, pitch, platform heading, wander angle (rad), body accelerations (m/s^2),
body rates (rad/s). The companion ``smrmsg`` has 10: time, sigmas of north, east, down (m), of their
velocities (m/s), of roll, pitch, heading (arc minutes).

Platform heading and velocity refer to the wander frame, which is level but not aligned with north
(POSPac: x north, y west, z up at a wander angle of zero). With the wander angle ``a``::

    heading = platform heading - a
    v_north =  v_x cos a - v_y sin a
    v_east  = -v_x sin a - v_y cos a
    v_down  = -v_z

Software of other makers writes velocities otherwise (north-east-down, east-north-up, or none), so the
velocities are compared with the steps of the positions, and the convention that fits is used and named.
"""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core import (
    DAY_S,
    GPS_EPOCH_UNIX_S,
    WEEK_S,
    AnyArray,
    ArrayF,
    InputError,
    frame_of,
    gps_from_unix,
    gps_from_week,
    utc_text_from_gps,
)
from thalweg.ingest import (
    INS_STATE,
    NAVIGATION_INITIALISED,
    TIME_SCALES,
    IntegrityReport,
    PoseLog,
    gps_from_scale,
    interpolated,
    tell_time_scale,
    time_scale_words,
)

_FIELDS: Final = 17
_SMRMSG_FIELDS: Final = 10
_ARC_MINUTE_RAD: Final = np.pi / 180 / 60
_EARTH_M: Final = 6_378_137.0
# Below this speed the steps of the positions are too noisy to tell one velocity convention from another.
_TELLING_SPEED_MPS: Final = 0.5
_MAX_WEEK: Final = 10_000
_FINEST_DEG: Final = 1e-3
"""No INS of a boat knows its roll better."""
FINISHED: Final = {"fix": "none", "system_status": 0, "filter_status": NAVIGATION_INITIALISED}
"""Columns of ``ins_state`` for a trajectory that other software finished."""
_LAST_TIME_S: Final = 3e9
"""More than any count of seconds that has a date."""


def read_sbet(
    files: Sequence[Path], gps_week: int | None, smrmsg: Sequence[Path] = (), *, utc: bool = False
) -> PoseLog:
    """Read one or several SBET files.

    Parameters
    ----------
    files : in the order of time; records that two of them hold alike are kept once.
    gps_week : full GPS week of the first record; an SBET does not state it, unless its times hold the date
        (GPS seconds since 1980, with or without 1e9, or Unix time), which their size shows. From a date:
        ``week_from_gps(gps_from_unix(unix_time_of_the_date))[0]``.
    smrmsg : companions with the standard deviations, taken at the time of each record (linear).
    utc : times are seconds of the week in UTC (an export option of POSPac).

    Returns
    -------
    States; ``fix`` is ``none`` and the status words are 0, for an SBET knows neither. Sigmas are NaN
    without ``smrmsg``. Records with impossible values are dropped and counted.

    Raises
    ------
    InputError : no week, a missing file, or content that is no SBET.
    """
    if not files:
        raise InputError("no SBET file given", expected="at least one file")
    report = IntegrityReport.of("ins", "SBET", files, time_scale="utc" if utc else "gps", synchronised=True)
    records = _joined(files, _FIELDS, "records", report)
    records = records[_plausible(records, report)]
    if not len(records):
        raise InputError(
            "no record has possible values",
            expected="latitude and longitude in radians, times of a GPS week",
            where=", ".join(map(str, files)),
            cure="Check that this is an SBET with latitude and longitude (not a projected export)",
        )
    scale = _dated_scale(records[:, 0])
    if not scale and (gps_week is None or not 0 < int(gps_week) < _MAX_WEEK):
        raise InputError(
            f"GPS week {gps_week}",
            expected="the full GPS week of the first record, such as 1948 (not modulo 1024)",
            where=files[0],
            cure="An SBET holds seconds of the week only: give the week of the survey",
        )
    if scale:
        told = time_scale_words(records[:, 0], tell_time_scale(records[:, 0]))
        report.note(f"Its times hold the date and are taken as {TIME_SCALES[scale]}: {told}.")
    t = _times(records[:, 0], int(gps_week or 0), report, utc=utc)
    if scale and gps_week and not -WEEK_S < float(t[0] - gps_from_week(gps_week, 0.0)) < 2 * WEEK_S:
        date = utc_text_from_gps(float(t[0]))[:10]
        raise InputError(
            f"times from {date}, taken as {TIME_SCALES[scale]}, and GPS week {gps_week}",
            expected="one date",
            where=files[0],
            cure="Look at the unit of the times, or leave the week out",
        )
    if not scale and records[:, 0].max() <= DAY_S:
        report.note("All times lie within the first day of the GPS week, a Sunday: or do they count the day?")
    sigmas = _sigmas(smrmsg, t, int(gps_week or 0), report, utc=utc)
    states = frame_of(INS_STATE, {**_states(records, t, report), **sigmas, **FINISHED}, unknown=np.nan)
    report.count("records", len(states))
    report.take_times(t, "records")
    report.note("An SBET states no GPS fix and no filter status: those columns are empty.")
    return PoseLog(states=states, report=report)


def _joined(files: Sequence[Path], n_fields: int, what: str, report: IntegrityReport) -> ArrayF:
    """Records of all files, those that two files hold alike once."""
    parts = [_records(path, n_fields, report) for path in files]
    records = np.concatenate(parts)
    file = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    return records[report.keep_once(pd.DataFrame(records), file, what)]


def _records(path: Path, n_fields: int, report: IntegrityReport) -> ArrayF:
    """(n, n_fields) of a file; a cut record at its end is counted, a foreign byte order is turned."""
    if not path.is_file():
        raise InputError("file not found", expected="an SBET", where=path, cure="Check the path")
    raw = path.read_bytes()
    report.bytes_read += len(raw)
    size = 8 * n_fields
    whole = len(raw) // size
    if not whole:
        raise InputError(
            f"{len(raw)} bytes",
            expected=f"at least one record of {size} bytes",
            where=path,
            cure="Copy it again",
        )
    if rest := len(raw) - whole * size:
        report.lose("bytes_of_a_cut_record", rest)
        report.note(f"{path.name} ends inside a record: {rest} bytes are left out.")
    orders = {
        order: np.frombuffer(raw, f"{order}f8", whole * n_fields).reshape(-1, n_fields) for order in "<>"
    }
    shares = {order: float(np.mean(_possible_times(a[:, 0]))) for order, a in orders.items()}
    best = max(shares, key=lambda order: shares[order])
    if shares[best] < 0.5:
        first = ", ".join(f"{x:.6g}" for x in orders["<"][0, :4])
        raise InputError(
            f"is not made of records of {n_fields} doubles (the first begins with {first})",
            expected="GPS seconds of the week that increase",
            where=path,
            cure="Check that this is an SBET (or smrmsg) file, and of which software",
        )
    if best == ">":
        report.note(f"{path.name} is big-endian; it was read so.")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # converting a damaged double may signal "invalid"
        return orders[best].astype(np.float64)


def _possible_times(t: AnyArray) -> AnyArray:
    # Files may run on behind the end of the week; a denormal number is the sign of the wrong byte order.
    with np.errstate(invalid="ignore"):
        return (t >= 0) & (t < (_LAST_TIME_S if _dated_scale(t) else 2 * WEEK_S)) & ((t == 0) | (t > 1e-6))


def _dated_scale(t: AnyArray) -> str:
    """Scale of times with their date, which other programs write; empty for seconds of the week."""
    with np.errstate(invalid="ignore"):
        if not (2 * WEEK_S < np.median(t) < _LAST_TIME_S):
            return ""
    told = [scale for scale in tell_time_scale(t) if scale.endswith("_s")]
    return next((scale for scale in told if scale != "unix_s"), told[0] if told else "")


def _plausible(records: ArrayF, report: IntegrityReport) -> AnyArray:
    with np.errstate(invalid="ignore"):
        checks = {
            "impossible_times": _possible_times(records[:, 0]),
            "impossible_positions": (np.abs(records[:, 1]) <= np.pi / 2)
            & (np.abs(records[:, 2]) <= 2 * np.pi)
            & (np.abs(records[:, 3]) < 1e5),
            "impossible_attitudes": (np.abs(records[:, 7:11]) <= np.pi * np.array([1.01, 0.51, 4, 4])).all(
                axis=1
            ),
            "not_finite_or_huge": (np.abs(records[:, 1:]) < 1e9).all(axis=1),
        }
    keep = np.ones(len(records), dtype=np.bool_)
    for what, good in checks.items():
        report.lose(what, np.count_nonzero(keep & ~good))
        keep &= good
    return keep


def _times(second: ArrayF, week: int, report: IntegrityReport, *, utc: bool) -> ArrayF:
    """Adjusted GPS time; a step back by most of a week is the next week."""
    step = np.diff(second)
    weeks = np.concatenate([[0], np.cumsum(step < -0.5 * WEEK_S)])
    if weeks[-1]:
        report.note(f"The times pass the end of the GPS week {weeks[-1]} times.")
    if scale := _dated_scale(second):
        return gps_from_scale(second, scale)
    if not utc:
        return gps_from_week(week + weeks, second)
    whole = np.floor(second)
    return gps_from_unix(GPS_EPOCH_UNIX_S + (week + weeks) * WEEK_S + whole) + (second - whole)


def _states(records: ArrayF, t: ArrayF, report: IntegrityReport) -> dict[str, ArrayF]:
    north, east, down = _velocity(records, t, report)
    return {
        "t_gps_s": t,
        "lat_deg": np.rad2deg(records[:, 1]),
        "lon_deg": half_turn(np.rad2deg(records[:, 2])),
        "h_ell_m": records[:, 3],
        "v_north_mps": north,
        "v_east_mps": east,
        "v_down_mps": down,
        "roll_rad": records[:, 7],
        "pitch_rad": records[:, 8],
        "heading_rad": np.mod(records[:, 9] - records[:, 10], 2 * np.pi),
        "rate_x_radps": records[:, 14],
        "rate_y_radps": records[:, 15],
        "rate_z_radps": records[:, 16],
    }


def half_turn(longitude_deg: ArrayF) -> ArrayF:
    """Longitudes of up to a whole turn in -180 to 180 degrees."""
    return np.where(longitude_deg > 180, longitude_deg - 360, longitude_deg)


def _velocity(records: ArrayF, t: ArrayF, report: IntegrityReport) -> tuple[ArrayF, ArrayF, ArrayF]:
    """North, east, down velocity in the convention that agrees with the positions."""
    x, y, z, wander = records[:, 4], records[:, 5], records[:, 6], records[:, 10]
    c, s = np.cos(wander), np.sin(wander)
    candidates = {
        "wander frame, x north, y west, z up (POSPac)": (x * c - y * s, -x * s - y * c, -z),
        "north, east, down": (x, y, z),
        "east, north, up": (y, x, -z),
    }
    names = list(candidates)
    default = names[0]
    step = np.diff(t)
    good = step > 0
    if np.count_nonzero(good) < 2:
        report.details["velocity"] = f"{default}; not checked, too few records"
        return candidates[default]
    middle_lat = records[:-1, 1]
    with np.errstate(all="ignore"):
        moved_north = np.diff(records[:, 1]) * _EARTH_M / step
        moved_east = np.diff(records[:, 2]) * _EARTH_M * np.cos(middle_lat) / step
    misfit = {
        name: float(
            np.median(np.hypot((n[1:] + n[:-1]) / 2 - moved_north, (e[1:] + e[:-1]) / 2 - moved_east)[good])
        )
        for name, (n, e, _) in candidates.items()
    }
    speed = float(np.median(np.hypot(moved_north, moved_east)[good]))
    if speed < _TELLING_SPEED_MPS:
        report.details["velocity"] = f"{default}; not checked, the median speed is {speed:.2f} m/s"
        return candidates[default]
    best = min(names, key=lambda name: misfit[name])
    # 20 %: the earth's radius and the noise of the steps stay below; a wrong convention is off by 100 %
    if misfit[best] > 0.2 * speed + 0.1:
        report.note(
            f"The velocities contradict the steps of the positions (by {misfit[best]:.2f} m/s at "
            f"{speed:.2f} m/s) in every known convention: they are left empty."
        )
        report.details["velocity"] = "none that agrees with the positions"
        nan = np.full(len(t), np.nan)
        return nan, nan, nan
    if misfit[default] <= misfit[best] + 0.05 * speed:
        best = default
    report.details["velocity"] = f"{best}; agrees with the positions within {misfit[best]:.3f} m/s"
    return candidates[best]


def _sigmas(
    files: Sequence[Path], t: ArrayF, week: int, report: IntegrityReport, *, utc: bool
) -> dict[str, ArrayF]:
    columns = {
        "sigma_north_m": (1, 1.0),
        "sigma_east_m": (2, 1.0),
        "sigma_up_m": (3, 1.0),
        "sigma_roll_rad": (7, _ARC_MINUTE_RAD),
        "sigma_pitch_rad": (8, _ARC_MINUTE_RAD),
        "sigma_heading_rad": (9, _ARC_MINUTE_RAD),
    }
    if not files:
        report.note("Without the smrmsg file nothing is known about the standard deviations.")
        return {}
    report.files += [str(f) for f in files]
    records = _joined(files, _SMRMSG_FIELDS, "smrmsg records", report)
    with np.errstate(invalid="ignore"):
        good = _possible_times(records[:, 0]) & ((records[:, 1:] >= 0) & (records[:, 1:] < 1e9)).all(axis=1)
    report.lose("impossible_smrmsg_records", np.count_nonzero(~good))
    records = records[good]
    where = ", ".join(map(str, files))
    if not len(records):
        raise InputError("no record has possible values", expected="standard deviations", where=where)
    scratch = IntegrityReport.of("", "", ())
    t_sigma = _times(records[:, 0], week, scratch, utc=utc)
    order = np.argsort(t_sigma, kind="stable")
    if t_sigma[order[-1]] < t.min() or t_sigma[order[0]] > t.max():
        spans = [" .. ".join(utc_text_from_gps(float(f(x))) for f in (np.min, np.max)) for x in (t_sigma, t)]
        raise InputError(
            f"spans {spans[0]}",
            expected=f"{spans[1]} as the SBET",
            where=where,
            cure="Give the smrmsg file of the same solution",
        )
    if zero := [name for name, (index, _) in columns.items() if not records[:, index].any()]:
        report.note(f"The smrmsg states 0 throughout for {', '.join(zero)}: taken as unknown.")
    roll_deg = float(np.rad2deg(np.median(records[:, 7]) * _ARC_MINUTE_RAD))
    if 0 < roll_deg < _FINEST_DEG:
        report.note(
            f"The smrmsg states roll to {roll_deg:.1g} deg (median, as arc minutes), finer than any INS: "
            "written in degrees or radians?"
        )
    return {
        name: interpolated(t, t_sigma[order], records[order, index] * unit)
        for name, (index, unit) in columns.items()
        if name not in zero
    }
