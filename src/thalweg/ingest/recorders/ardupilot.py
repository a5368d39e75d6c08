"""ArduPilot autopilots: dataflash logs (``.BIN``) and MAVLink telemetry (``.tlog``), read by ``pymavlink``.

Both stamp with the time since the autopilot started. GPS time comes from fixes (dataflash: week and
milliseconds) or from ``SYSTEM_TIME`` (telemetry); without either the stamps stay those of the device, and
have no GPS time. A fix is logged when it has arrived: later than its epoch by the lag of the receiver, which
is the parameter ``GPS_DELAY_MS`` or, where that is 0, the `USUAL_LAG_S` of ArduPilot's driver.

Attitude and position are those of the filter (ATT, POS), their standard deviations from its covariance
(XKV1: quaternion, velocity, position; XKF4.errRP: tilt). Depths are WATER_DEPTH and DPTH, else those of
rangefinders that look down. Heights are above mean sea level; only a stated undulation makes them
ellipsoidal: GPA.Und, which is that of the ellipsoid above the sea (negative in Europe; NovAtel's driver
writes that of the sea above the ellipsoid), or GPS_RAW_INT.alt_ellipsoid.
Source: ArduPilot, "Onboard Message Log Messages"; MAVLink common and ardupilotmega message sets.
"""

import contextlib
import math
import os
import re
import struct
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core import AnyArray, ArrayF, InputError, frame_of, gps_from_unix, gps_from_week, missing_package
from thalweg.ingest import (
    DEPTH,
    GNSS_POSITION,
    INS_STATE,
    NAVIGATION_INITIALISED,
    IntegrityReport,
    PoseLog,
    TrackOptions,
    interpolated,
)

Messages = Mapping[str, pd.DataFrame]
"""Messages by name, a column ``t_s`` (since the start of the autopilot) beside the format's own fields."""

USUAL_LAG_S: Final = 0.12
"""Lag of u-blox M8 and F9 receivers that ArduPilot presumes (AP_GPS_UBLOX::get_lag)."""
_JUMP_S: Final = 0.9
_DATED_S: Final = 1e9
"""No autopilot runs so long: later times count from 1970."""
DOWN: Final = 25
"""Orientation of a rangefinder that looks down (MAV_SENSOR_ROTATION_PITCH_270)."""
_FIX: Final = {2: "2d", 3: "single", 4: "dgnss", 5: "float", 6: "fixed", 7: "fixed", 8: "ppp"}
_AUTOPILOT: Final = 1
"""Component of MAVLink that is the autopilot; ground stations and companions repeat its messages."""
_RESTART_MS: Final = 5_000
"""A clock that falls back by more has begun anew; by less, messages came in another order."""
_NO_SIGNAL: Final = 1
"""Signal quality of DISTANCE_SENSOR that stands for none."""
_UNITS: Final = {"TimeUS": 1e-6, "time_boot_ms": 1e-3, "time_usec": 1e-6}
"""Fields with the time since the start of the autopilot, to seconds."""
_DATAFLASH: Final = (
    *("GPS", "GPS2", "GPA", "ATT", "POS", "AHR2", "XKF1", "NKF1", "XKF4", "XKV1", "RFND", "DPTH", "CAM"),
    *("PARM", "MSG"),
)
_TELEMETRY: Final = (
    *("ATTITUDE", "GLOBAL_POSITION_INT", "GPS_RAW_INT", "SYSTEM_TIME", "WATER_DEPTH", "DISTANCE_SENSOR"),
    *("CAMERA_FEEDBACK", "STATUSTEXT"),
)


def is_dataflash(head: bytes, size: int) -> bool:
    """True if a file begins as a dataflash log: the format of the messages that state formats."""
    return head.startswith((b"\xa3\x95\x80\x80\x59FMT\x00", b"FMT, 128, 89, FMT,"))


def is_telemetry(head: bytes, size: int) -> bool:
    """True if MAVLink frames follow each other in the head, each behind a stamp in microseconds."""
    at, frames = 0, 0
    while at + 12 <= len(head) and frames < 20:
        first, length = head[at + 8], head[at + 9]
        signed = first == 0xFD and head[at + 10] & 1
        whole = 8 + {0xFE: 8, 0xFD: 12}.get(first, 0) + length + 13 * signed
        if first not in (0xFE, 0xFD) or not 1e15 < int.from_bytes(head[at : at + 8], "big") < 4e15:
            return False
        at, frames = at + whole, frames + 1
    return frames >= min(20, max(2, size // 300))


def read_ardupilot(files: Sequence[Path], options: TrackOptions) -> PoseLog:
    """States, GNSS positions and depths of an ArduPilot vehicle.

    Parameters
    ----------
    files : logs in the order of time; the autopilot's clock starts anew in each.
    options : not needed.

    Raises
    ------
    InputError : a file holds neither attitudes, positions nor depths.
    UnsupportedError : pymavlink is not installed.
    """
    report = IntegrityReport.of("ins", "", files, time_scale="device")
    logs = [_read(path, report) for path in files]
    *tables, triggers = zip(*logs, strict=True)
    states, positions, depths = (pd.concat(parts, ignore_index=True) for parts in tables)
    report.synchronised = bool(states["t_gps_s"].notna().any())
    if report.synchronised:
        report.time_scale = "gps"
    report.take_times(states["t_gps_s" if report.synchronised else "t_device_s"], "states")
    for name, table in (("states", states), ("positions", positions), ("depths", depths)):
        report.count(name, len(table))
    triggers_gps_s = np.concatenate(triggers)
    if n := len(triggers_gps_s):
        report.count("camera_triggers", n)
        report.note(
            f"{n:,} camera triggers: named in logs.time_lapse.times, the log gives as many photographs their "
            "times."
        )
    return PoseLog(
        states=states, positions=positions, depths=depths, report=report, triggers_gps_s=triggers_gps_s
    )


def _read(path: Path, report: IntegrityReport) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame, ArrayF]:
    with path.open("rb") as stream:
        dataflash = is_dataflash(stream.read(64), 0)
    report.bytes_read += path.stat().st_size
    report.format = "ArduPilot dataflash log" if dataflash else "MAVLink telemetry log"
    read, tables = (_dataflash, _of_dataflash) if dataflash else (_telemetry, _of_telemetry)
    messages = read(path, report)
    try:
        found = tables(messages, report)
    except KeyError as error:
        raise InputError(
            f"messages without the field {error}",
            expected="the fields of ArduPilot's messages",
            where=path,
            cure="Download the log from the autopilot again: its formats are damaged",
        ) from error
    attitude, place, fixes, depths, gps_minus_boot_s = found
    if attitude.empty and fixes.empty and depths.empty:
        raise InputError(
            "neither attitudes, positions nor depths",
            expected="messages ATT, POS, GPS, DPTH or RFND (telemetry: ATTITUDE, GPS_RAW_INT, WATER_DEPTH)",
            where=path,
            cure="Set LOG_BITMASK to log attitude and GPS; LOG_DISARMED 1 logs from the start",
        )
    if np.isnan(gps_minus_boot_s):
        report.note("No GPS time in the log: its stamps are seconds since the autopilot started.")
    undulation = fixes["h_ell_m"] - fixes["alt_m"]
    states = _states(
        attitude, _joined(place, fixes[["t_s", "fix"]]), float(undulation.median()), gps_minus_boot_s
    )
    if states["h_ell_m"].isna().all() and states["lat_deg"].notna().any():
        report.note(
            "Heights are above mean sea level, no undulation of the geoid is stated: no ellipsoidal height."
        )
    depths = frame_of(DEPTH, {**depths, "t_gps_s": depths["t_s"] + gps_minus_boot_s}, unknown=np.nan)
    pictures = messages.get("CAM", messages.get("CAMERA_FEEDBACK", _NONE))["t_s"].to_numpy(np.float64)
    triggers = pictures + gps_minus_boot_s
    dated = pictures > _DATED_S  # feedback of telemetry is in Unix time, where the autopilot knew it
    triggers[dated] = gps_from_unix(pictures[dated])
    return states, frame_of(GNSS_POSITION, dict(fixes), unknown=np.nan), depths, triggers


def _states(
    attitude: pd.DataFrame, place: pd.DataFrame, undulation_m: float, offset_s: float
) -> pd.DataFrame:
    """Attitudes with the filter's position at their times, table kind ``ins_state``."""
    t_s = attitude["t_s"].to_numpy(np.float64)

    def at(name: str) -> ArrayF:
        """A quantity of the positions (n,) at the times of the attitudes."""
        known = place[place[name].notna()] if name in place else place.iloc[:0]
        if known.empty:
            return np.full(len(t_s), np.nan)
        return interpolated(t_s, known["t_s"], known[name])

    heading = np.mod(attitude["yaw_rad"].to_numpy(np.float64), 2 * np.pi)
    tilt = at("sigma_tilt_rad") / np.sqrt(2.0)
    names = ("lat_deg", "lon_deg", "v_north_mps", "v_east_mps", "v_down_mps")
    return frame_of(
        INS_STATE,
        {
            **{name: at(name) for name in names},
            **{f"sigma_{axis}_m": at(f"sigma_{axis}_m") for axis in ("north", "east", "up")},
            **{name: attitude[name] for name in attitude.columns.difference(["t_s", "yaw_rad"]).tolist()},
            "t_gps_s": t_s + offset_s,
            "t_device_s": t_s,
            "h_ell_m": at("alt_m") + undulation_m,
            "heading_rad": np.where(heading >= 2 * np.pi, 0.0, heading),
            "sigma_roll_rad": tilt,
            "sigma_pitch_rad": tilt,
            "sigma_heading_rad": at("sigma_heading_rad"),
            "fix": _nearest(place, t_s),
            "system_status": 0,
            "filter_status": np.where(
                np.maximum.accumulate(np.isfinite(at("lat_deg"))), NAVIGATION_INITIALISED, 0
            ),
        },
        unknown=np.nan,
    )


def _nearest(place: pd.DataFrame, t_s: ArrayF) -> AnyArray:
    """Fix (n,) of the nearest position, in the words of ``ins_state``."""
    if "fix" not in place or place.empty:
        return np.full(len(t_s), "none", dtype=object)
    times = place["t_s"].to_numpy(np.float64)
    after = np.clip(np.searchsorted(times, t_s), 1, max(len(times) - 1, 1))
    at = np.where(t_s - times[after - 1] < times[np.minimum(after, len(times) - 1)] - t_s, after - 1, after)
    fix = place["fix"].to_numpy(object)[np.minimum(at, len(times) - 1)]
    return np.where(fix == "single", "3d", fix)


# ---------------------------------------------------------------- dataflash


def _dataflash(path: Path, report: IntegrityReport) -> Messages:
    """Messages of a dataflash log; pymavlink finds them, whole columns are unpacked at once."""
    DFReader = _pymavlink("DFReader")
    with path.open("rb") as stream:
        text = stream.read(3) == b"FMT"
    kind = DFReader.DFReader_text if text else DFReader.DFReader_binary
    log = kind.__new__(kind)
    with contextlib.ExitStack() as at_the_end:
        # it leaves its file open where its constructor raises
        at_the_end.callback(lambda: log.filehandle.close())
        try:
            with _silent():  # it prints a line for each byte between messages, which are counted here
                kind.__init__(log, str(path))
        except Exception as error:  # it raises no narrower one
            raise InputError(
                f"damaged formats of messages ({error})",
                expected="a whole dataflash log",
                where=path,
                cure="Download it from the autopilot again",
            ) from error
        return _recv(log, _DATAFLASH, report) if text else _columns(log, report)


def _columns(log: Any, report: IntegrityReport) -> Messages:
    """Messages of a binary log, whole columns at once."""
    found, numbers = {}, {}
    covered = 0
    for name, kind in sorted(log.name_to_id.items()):
        form = log.formats[kind]
        at = np.asarray(log.offsets[kind], dtype=np.int64)
        at = at[at + form.len <= log.data_len]
        covered += at.size * form.len
        if at.size:
            numbers[name] = int(at.size)
        whole = struct.calcsize(form.msg_struct) == form.len - 3 and len(form.columns) == len(form.msg_mults)
        if at.size and name in _DATAFLASH and form.columns and whole:
            data = np.frombuffer(log.data_map, np.uint8)
            rows = data[at[:, None] + np.arange(3, form.len)].tobytes()
            table = pd.DataFrame(list(struct.iter_unpack(form.msg_struct, rows)), columns=form.columns)
            scales = dict(zip(form.columns, form.msg_mults, strict=True))
            found[name] = table.assign(**{key: table[key] * by for key, by in scales.items() if by})
    report.details["messages"] = numbers
    report.lose("bytes_outside_messages", log.data_len - covered)
    stamped = {name: _stamped(table) for name, table in found.items()}
    return {name: table for name, table in stamped.items() if "t_s" in table}


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Nothing of what a library writes to the terminal, from C too."""
    kept = [os.dup(1), os.dup(2)]
    with Path(os.devnull).open("wb") as nowhere:
        try:
            for stream in (1, 2):
                os.dup2(nowhere.fileno(), stream)
            yield
        finally:
            for stream, copy in zip((1, 2), kept, strict=True):
                os.dup2(copy, stream)
                os.close(copy)


def _of_dataflash(
    log: Messages, report: IntegrityReport
) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame, pd.DataFrame, float]:
    fixes, offset_s = _dataflash_fixes(log, report)
    angles = {f"{name}_rad": (name.capitalize(), math.pi / 180.0) for name in ("roll", "pitch", "yaw")}
    attitude = _named(log.get("ATT", _NONE), angles)
    core = int(log["XKF4"]["PI"].mode().iloc[0]) if "XKF4" in log and "PI" in log["XKF4"] else 0
    fields = {"lat_deg": ("Lat", 1.0), "lon_deg": ("Lng", 1.0), "alt_m": ("Alt", 1.0)}
    place = _named(log.get("POS", log.get("AHR2", _NONE)), fields)
    place = place[_on_earth(place)]
    speed = _named(
        _main(log.get("XKF1", log.get("NKF1", _NONE)), "C", core),
        {f"v_{axis}_mps": (f"V{axis[0].upper()}", 1.0) for axis in ("north", "east", "down")},
    )
    sigmas = _filter_sigmas(log, core)
    if sigmas.empty and fixes["sigma_up_m"].notna().any():
        report.note(
            "The filter's covariance is not logged: positions have the receiver's standard deviations."
        )
        sigmas = fixes[["t_s", "sigma_east_m", "sigma_north_m", "sigma_up_m"]]
    place = _joined(place, speed, sigmas)
    pings = log.get("DPTH", _NONE).rename(columns={"Depth": "depth_m"}).assign(sentence="DPTH")
    if pings.empty and "RFND" in log:
        ranges = _one_a_row(log["RFND"])
        down = ranges.query("Orient == @DOWN" if "Orient" in ranges else "index == index")
        pings = down.rename(columns={"Dist": "depth_m"}).assign(sentence="RFND")
        if "Stat" in pings:  # 4: a good distance
            pings["depth_m"] = pings["depth_m"].where(pings["Stat"] == 4, 0.0)
    words = _texts(log.get("MSG", _NONE).get("Message", ()))
    report.model = next((w.strip("\0") for w in words if w.startswith("Ardu") or "Rover" in w), "")
    return attitude, place, fixes, _depths(pings, report), offset_s


def _dataflash_fixes(log: Messages, report: IntegrityReport) -> tuple[pd.DataFrame, float]:
    """Fixes of the better receiver (``gnss_position``, ``t_s``, ``alt_m``); GPS minus boot time, seconds."""
    gps = log.get("GPS", _NONE)
    numbers = gps["I"].unique().tolist() if "I" in gps else [0]
    receivers = {int(i): _main(gps, "I", int(i)) for i in numbers}
    if "GPS2" in log:
        receivers[1] = log["GPS2"]
    chosen = max(receivers, key=lambda i: float(receivers[i].get("Status", _EMPTY).mean() or 0.0))
    if len(receivers) > 1:
        report.note(f"{len(receivers)} GNSS receivers: fixes of number {chosen}, by status, are taken.")
    gps = receivers[chosen]
    if gps.empty:
        return _fixes(gps, {}), np.nan
    week = gps["GWk"].where(gps["GWk"] > 1024)
    t_gps_s = gps_from_week(week, gps["GMS"] * 1e-3)
    offset_s = np.nan
    if week.notna().any():
        params = log.get("PARM", pd.DataFrame({"Name": [], "Value": []}))
        stated = zip(_texts(params["Name"]), params["Value"], strict=True)
        delay_ms = next((float(value) for name, value in stated if re.search("GPS1?_DELAY_MS", name)), 0.0)
        lag_s = delay_ms * 1e-3 if delay_ms > 0 else USUAL_LAG_S
        lead_s = (t_gps_s - gps["t_s"]).dropna()
        # of the fix that was on its way the shortest; a receiver that corrects its leap seconds jumps
        offset_s = float(lead_s[(lead_s - lead_s.median()).abs() < _JUMP_S].max()) + lag_s
        whence = "stated" if lag_s != USUAL_LAG_S else "presumed"
        report.note(
            f"The autopilot's clock is on GPS time by its fixes, which arrive {lag_s:.2f} s late ({whence})."
        )
    quality = _main(log.get("GPA", _NONE), "I", chosen)
    near = _joined(gps[["t_s"]], quality)
    # drivers that know no undulation or accuracy leave 0
    near = near.assign(
        **{name: near[name].where(near[name] != 0) for name in ("Und", "VAcc") if name in near}
    )
    said = _texts(log.get("MSG", _NONE).get("Message", ()))
    novatel = any(re.match(rf"GPS {chosen + 1}\b.*\bNOVA\b", text) for text in said)
    alt = gps["Alt"].astype(float)
    return (
        _fixes(
            gps,
            {
                "t_s": gps["t_s"],
                "t_gps_s": t_gps_s,
                "lat_deg": gps["Lat"],
                "lon_deg": gps["Lng"],
                "alt_m": alt,
                "h_ell_m": alt + (1 if novatel else -1) * near["Und"].to_numpy() if "Und" in near else np.nan,
                "status": gps["Status"],
                "n_sats": gps["NSats"],
                "horizontal_m": near["HAcc"].to_numpy() if "HAcc" in near else np.nan,
                "sigma_up_m": near["VAcc"].to_numpy() if "VAcc" in near else np.nan,
            },
        ),
        offset_s,
    )


def _one_a_row(ranges: pd.DataFrame) -> pd.DataFrame:
    """Rangefinders, of which firmware before 4.0 writes two in a message (Dist1, Orient1, Dist2 ...)."""
    if "Dist1" not in ranges:
        return ranges
    each = [
        ranges.rename(columns={f"{name}{k}": name for name in ("Dist", "Stat", "Orient")}).assign(Instance=k)
        for k in (1, 2)
    ]
    return pd.concat(each).sort_values("t_s", kind="stable", ignore_index=True)


def _filter_sigmas(log: Messages, core: int) -> pd.DataFrame:
    """Standard deviations out of the diagonal of the filter's covariance.

    The quaternion's error is half the small rotation: four times the trace of its covariance is the sum of
    the variances of all three angles, of which ``errRP`` squared is the part of roll and pitch.
    """
    variances, health = (_main(log.get(name, _NONE), "C", core) for name in ("XKV1", "XKF4"))
    if variances.empty or health.empty:
        return pd.DataFrame()
    both = _joined(variances, health[["t_s", "errRP"]])
    turn = 4.0 * both[["V00", "V01", "V02", "V03"]].sum(axis=1)
    sigmas = {
        f"sigma_{axis}_m": np.sqrt(both[v].where(both[v] > 0))
        for axis, v in (("north", "V07"), ("east", "V08"), ("up", "V09"))
    }
    return pd.DataFrame(
        {
            "t_s": both["t_s"],
            **sigmas,
            "sigma_tilt_rad": both["errRP"],
            "sigma_heading_rad": np.sqrt(np.maximum(turn - both["errRP"] ** 2, 0.0)),
        }
    )


# ---------------------------------------------------------------- telemetry


def _telemetry(path: Path, report: IntegrityReport) -> Messages:
    mavutil = _pymavlink("mavutil")
    mavutil.set_dialect("ardupilotmega")
    with contextlib.closing(mavutil.mavlogfile(str(path))) as log:
        return _recv(log, _TELEMETRY, report)


def _recv(log: Any, wanted: Sequence[str], report: IntegrityReport) -> Messages:
    rows: dict[tuple[int, int], dict[tuple[str, ...], list[list[Any]]]] = {}
    numbers: Counter[str] = Counter()
    starts: dict[int, tuple[int, float]] = {}
    while (message := log.recv_msg()) is not None:
        name = message.get_type()
        if name == "BAD_DATA":
            report.lose("bad_messages", 1)
            continue
        numbers[name] += 1
        system = 0
        if hasattr(message, "get_srcComponent"):
            system = message.get_srcSystem()
            if message.get_srcComponent() != _AUTOPILOT:
                continue
        if name in wanted:
            fields = message.get_fieldnames()
            values = [getattr(message, field) for field in fields]
            start, last_ms = starts.get(system, (0, -math.inf))
            if (boot_ms := getattr(message, "time_boot_ms", last_ms)) < last_ms - _RESTART_MS:
                start += 1
            starts[system] = start, boot_ms
            own = rows.setdefault((system, start), {})
            own.setdefault((name, *fields), []).append([*values, message._timestamp])
    report.details["messages"] = dict(sorted(numbers.items()))
    sizes = {key: sum(map(len, own.values())) for key, own in rows.items()}
    chosen = max(sizes, key=lambda key: sizes[key], default=(0, 0))
    if other := sum(sizes.values()) - sizes.get(chosen, 0):
        report.count("messages_of_other_vehicles_or_starts", other)
        report.note(
            f"{len(starts)} vehicles with {len(sizes)} starts of their autopilots: of vehicle {chosen[0]} "
            "the start with most messages is taken. Split the log for the others."
        )
    return {
        name: _stamped(pd.DataFrame(part, columns=[*fields, "t_host_s"]))
        for (name, *fields), part in rows.get(chosen, {}).items()
    }


def _of_telemetry(
    log: Messages, report: IntegrityReport
) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame, pd.DataFrame, float]:
    clock = log.get("SYSTEM_TIME", _NONE)
    clock = clock[clock["time_unix_usec"] > 1e15] if len(clock) else clock
    offset_s = np.nan
    if len(clock):
        offset_s = float((gps_from_unix(clock["time_unix_usec"] * 1e-6) - clock["t_s"]).median())
    elif len(spoken := log.get("ATTITUDE", log.get("GPS_RAW_INT", _NONE))):
        host = spoken["t_host_s"].iloc[[0, -1]].to_list()
        when = " .. ".join(f"{pd.Timestamp(t, unit='s'):%Y-%m-%d %H:%M:%S}" for t in host)
        report.note(f"The ground station received it {when} by its own clock (UTC, if that clock was right).")
    raw = log.get("GPS_RAW_INT", _NONE)
    # it counts from the start or, as MAVLink permits too, from 1970
    dated = raw["t_s"] > _DATED_S
    raw = raw.assign(t_s=raw["t_s"].mask(dated, gps_from_unix(raw["t_s"].where(dated)) - offset_s))
    report.lose("fixes_on_another_clock", raw["t_s"].isna().sum())
    raw = raw[raw["t_s"].notna()]
    fixes = _fixes(raw, {})
    if len(raw):
        alt, ellipsoidal = raw["alt"] * 1e-3, raw.get("alt_ellipsoid", pd.Series(0, index=raw.index)) * 1e-3
        accuracy = [
            (raw[name] * 1e-3).where(raw[name] > 0) if name in raw else np.nan for name in ("h_acc", "v_acc")
        ]
        fixes = _fixes(
            raw,
            {
                "t_s": raw["t_s"],
                "t_gps_s": raw["t_s"] + offset_s,
                "lat_deg": raw["lat"] * 1e-7,
                "lon_deg": raw["lon"] * 1e-7,
                "alt_m": alt,
                "h_ell_m": ellipsoidal.where(ellipsoidal != 0.0),
                "status": raw["fix_type"],
                "n_sats": raw["satellites_visible"].replace(255, -1),
                "horizontal_m": accuracy[0],
                "sigma_up_m": accuracy[1],
            },
        )
    angles = dict(zip("xyz", ("roll", "pitch", "yaw"), strict=True))
    attitude = _named(
        log.get("ATTITUDE", _NONE),
        {f"{name}_rad": (name, 1.0) for name in angles.values()}
        | {f"rate_{axis}_radps": (f"{name}speed", 1.0) for axis, name in angles.items()},
    )
    place = _named(
        log.get("GLOBAL_POSITION_INT", _NONE),
        {
            "lat_deg": ("lat", 1e-7),
            "lon_deg": ("lon", 1e-7),
            "alt_m": ("alt", 1e-3),
            "v_north_mps": ("vx", 1e-2),
            "v_east_mps": ("vy", 1e-2),
            "v_down_mps": ("vz", 1e-2),
        },
    )
    place = place[_on_earth(place)]
    sigmas = fixes[["t_s", "sigma_east_m", "sigma_north_m", "sigma_up_m"]]
    pings = (
        log.get("WATER_DEPTH", _NONE).rename(columns={"distance": "depth_m"}).assign(sentence="WATER_DEPTH")
    )
    if len(pings):
        pings["depth_m"] = pings["depth_m"].where(pings["healthy"] != 0, 0.0)
    elif "DISTANCE_SENSOR" in log:
        pings = log["DISTANCE_SENSOR"].query("orientation == @DOWN").assign(sentence="DISTANCE_SENSOR")
        farthest = pings["max_distance"].where(pings["max_distance"] > 0, math.inf)
        # at its end the sensor saw nothing nearer
        seen = (pings["current_distance"] >= pings["min_distance"]) & (pings["current_distance"] < farthest)
        if "signal_quality" in pings:
            seen &= pings["signal_quality"] != _NO_SIGNAL
        pings["depth_m"] = (pings["current_distance"] * 1e-2).where(seen, 0.0)
    words = log.get("STATUSTEXT", _NONE).get("text", ())
    report.model = next((str(w) for w in words if str(w).startswith("Ardu")), "")
    return attitude, _joined(place, sigmas), fixes, _depths(pings, report), offset_s


# ---------------------------------------------------------------- what both have in common


_EMPTY: Final = pd.Series(dtype=np.float64)
_NONE: Final = pd.DataFrame({"t_s": _EMPTY})


def _pymavlink(module: str) -> Any:
    import importlib

    try:
        return importlib.import_module(f"pymavlink.{module}")
    except ImportError as error:
        raise missing_package(error) from error


def _stamped(table: pd.DataFrame) -> pd.DataFrame:
    unit = next((name for name in _UNITS if name in table), None)
    return table if unit is None else table.assign(t_s=table[unit] * _UNITS[unit])


def _named(table: pd.DataFrame, fields: Mapping[str, tuple[str, float]]) -> pd.DataFrame:
    """``t_s``, and by our names fields of a message times their units."""
    columns = {ours: table.get(theirs, _EMPTY).astype(float) * by for ours, (theirs, by) in fields.items()}
    return pd.DataFrame({"t_s": table.get("t_s", _EMPTY), **columns})


def _main(table: pd.DataFrame, instance: str, number: int) -> pd.DataFrame:
    """Rows of one instance of a sensor or filter, all where the message has none."""
    return table[table[instance] == number] if instance in table else table


def _joined(left: pd.DataFrame, *others: pd.DataFrame) -> pd.DataFrame:
    """Columns of other messages at the times of ``left``, from the nearest in time."""
    found = left.sort_values("t_s", kind="stable")
    for other in others:
        if len(other):
            new = [name for name in other if name == "t_s" or name not in found]
            found = pd.merge_asof(found, other[new].sort_values("t_s"), on="t_s", direction="nearest")
    return found


def _texts(values: Iterable[Any]) -> list[str]:
    """Texts of messages, which may be bytes of any kind in a damaged log."""
    return [each.decode("latin-1") if isinstance(each, bytes) else str(each) for each in values]


def _on_earth(table: pd.DataFrame) -> "pd.Series[bool]":
    """Rows with a place: both are 0 without a fix, and damage gives any number."""
    lat, lon = table["lat_deg"].astype(float), table["lon_deg"].astype(float)
    return (lat.abs() <= 90.0) & (lon.abs() <= 180.0) & ((lat != 0.0) | (lon != 0.0))


def _fixes(rows: pd.DataFrame, columns: Mapping[str, Any]) -> pd.DataFrame:
    """Fixes as ``gnss_position`` and what else is known of them; those without a fix are left out."""
    names = ("t_s", "alt_m", "horizontal_m", "status", *(field.name for field in GNSS_POSITION))
    table = pd.DataFrame(dict.fromkeys(names, np.nan) | dict(columns), index=rows.index)
    table = table[(table["status"] >= 2) & _on_earth(table)]
    # accuracies of receivers are radial: each axis has its share of the square
    radial = table["horizontal_m"].where(table["horizontal_m"] > 0) / np.sqrt(2.0)
    table = table.assign(sigma_east_m=radial, sigma_north_m=radial, fix=table["status"].map(_FIX))
    return table.reset_index(drop=True)


def _depths(pings: pd.DataFrame, report: IntegrityReport) -> pd.DataFrame:
    """Soundings of one sounder with ``t_s``; a message of no number is no sounding, one below 0 no bottom."""
    if "depth_m" not in pings:
        return pd.DataFrame({"t_s": [], "depth_m": [], "sentence": [], "line": []})
    instance = next((name for name in ("Inst", "Instance", "id") if name in pings), None)
    if instance and pings[instance].nunique() > 1:
        seen = (pings["depth_m"] > 0).groupby(pings[instance]).sum()
        chosen = int(seen.index[int(np.argmax(seen))])
        report.count("pings_of_other_sounders", int((pings[instance] != chosen).sum()))
        report.note(f"{pings[instance].nunique()} sounders: number {chosen} sees the bottom most often.")
        pings = pings[pings[instance] == chosen]
    kept = pings[["t_s", "depth_m", "sentence"]].dropna().reset_index(drop=True)
    return kept.assign(depth_m=kept["depth_m"].clip(lower=0.0), line=np.arange(1, len(kept) + 1))
