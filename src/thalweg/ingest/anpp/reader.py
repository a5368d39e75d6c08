"""The ANPP reader: logs of Advanced Navigation's INS as tables and an integrity report.

Times are UTC once the device says so (bit 3 of the filter status). Before, they are the device's own
clock: ``t_gps_s`` is NaN and ``t_device_s`` is kept. Packets without time take that of the time packet
before them. States refer to the configured reference point, raw GNSS positions to the antenna.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayI, column, frame_of, table_kind
from thalweg.ingest import DEPTH, GNSS_POSITION, INS_RAW, INS_STATE, IntegrityReport, find_gaps
from thalweg.ingest.anpp import packets as ap
from thalweg.ingest.anpp.packets import (
    AnppRecords,
    Clock,
    Records,
    build_clock,
    collect,
    gps_time,
    possible_utc,
)
from thalweg.ingest.framing import CHUNK_BYTES

# ---------------------------------------------------------------- tables out of decoded ANPP packets


_F = pa.float64()
_T_GPS = column("t_gps_s", _F, "s", "adjusted standard GPS time of the time packet before; NaN if unknown")
_T_DEVICE = column("t_device_s", _F, "s", "Unix time of the device's own clock")

HEAVE = table_kind(
    "anpp_heave",
    1,
    [_T_GPS, _T_DEVICE, *(column(f"heave_{i}_m", _F, "m", f"heave at point {i}") for i in (1, 2, 3, 4))],
)

PASSTHROUGH = table_kind(
    "anpp_passthrough",
    1,
    [
        _T_GPS,
        _T_DEVICE,
        column("route", pa.string(), "1", "port that the text came through: gpio, auxiliary or its number"),
        column("sentence", pa.string(), "1", "NMEA sentence with a right checksum"),
        column("packet", pa.int64(), "1", "packet of the log in which it ends, from 1"),
    ],
)

_MAX_SIGMA_AGE_S: Final = 1.0
"""Orientation sigmas older than this and than 1.5 of their own steps belong to no state."""


def states_table(records: AnppRecords) -> pd.DataFrame:
    """System state packets (20) as table kind ``ins_state``, without the sigmas of the orientation."""
    f = records.of(ap.STATE).fields
    n = f.size
    utc = (f["filter"] & ap.FILTER_UTC != 0) & possible_utc(f["unix_s"], f["us"])
    heading = np.mod(f["orientation"][:, 2].astype(np.float64), 2 * np.pi)
    nan = np.full(n, np.nan)
    return frame_of(
        INS_STATE,
        {
            "t_gps_s": gps_time(f["unix_s"], f["us"].astype(np.float64), utc),
            "t_device_s": f["unix_s"] + f["us"] * 1e-6,
            "lat_deg": np.rad2deg(f["lat"]),
            "lon_deg": np.rad2deg(f["lon"]),
            "h_ell_m": f["height"],
            "v_north_mps": f["velocity"][:, 0],
            "v_east_mps": f["velocity"][:, 1],
            "v_down_mps": f["velocity"][:, 2],
            "roll_rad": f["orientation"][:, 0],
            "pitch_rad": f["orientation"][:, 1],
            # a tiny negative angle rounds to 2 pi itself
            "heading_rad": np.where(heading >= 2 * np.pi, 0.0, heading),
            "rate_x_radps": f["rate"][:, 0],
            "rate_y_radps": f["rate"][:, 1],
            "rate_z_radps": f["rate"][:, 2],
            "sigma_north_m": f["sigma"][:, 0],
            "sigma_east_m": f["sigma"][:, 1],
            "sigma_up_m": f["sigma"][:, 2],
            "sigma_roll_rad": nan,
            "sigma_pitch_rad": nan,
            "sigma_heading_rad": nan,
            "fix": ap.fix_of(f["filter"], 4, ap.STATE_FIX),
            "system_status": f["system"],
            "filter_status": f["filter"],
        },
    )


def add_orientation_sigmas(states: pd.DataFrame, records: AnppRecords, clock: Clock) -> int:
    """Give each state the sigmas of the nearest packet 26 in time; returns how many states got them."""
    euler = records.of(ap.EULER_SIGMA)
    known, t = _times(clock, euler.packet)
    t, values = t[known], euler.fields["sigma"][known]
    if not t.size or states.empty:
        return 0
    order = np.argsort(t, kind="stable")
    t, values = t[order], values[order]
    step = np.diff(t)
    limit = max(_MAX_SIGMA_AGE_S, 1.5 * float(np.median(step)) if step.size else 0.0)
    at = states["t_device_s"].to_numpy()
    right = (
        np.clip(np.searchsorted(t, at), 1, t.size - 1) if t.size > 1 else np.zeros(at.size, dtype=np.int64)
    )
    left = np.maximum(right - 1, 0)
    nearest = np.where(np.abs(at - t[left]) <= np.abs(t[right] - at), left, right)
    fits = np.abs(at - t[nearest]) <= limit
    for k, name in enumerate(("roll", "pitch", "heading")):
        states[f"sigma_{name}_rad"] = np.where(fits, values[nearest, k].astype(np.float64), np.nan)
    return int(fits.sum())


def raw_table(records: AnppRecords, clock: Clock) -> tuple[pd.DataFrame, dict[str, int]]:
    """Raw sensor packets (28) as table kind ``ins_raw``, and counts about their times.

    A packet takes the time of the time packet before it. If several follow one time packet (raw sensors
    logged faster than states, or a lost state), the later ones are counted on at their own rate.
    """
    raw = records.of(ap.RAW_SENSORS)
    f = raw.fields
    index = clock.before(raw.packet)
    known = index >= 0
    t_device, t_gps = np.full(f.size, np.nan), np.full(f.size, np.nan)
    ahead = _ahead_s(index[known], clock)
    t_device[known] = clock.t_device_s[index[known]] + ahead
    t_gps[known] = clock.t_gps_s[index[known]] + ahead
    values: dict[str, Any] = {"t_gps_s": t_gps, "t_device_s": t_device}
    for k, axis in enumerate("xyz"):
        values[f"accel_{axis}_mps2"] = f["accel"][:, k]
        values[f"gyro_{axis}_radps"] = f["gyro"][:, k]
        values[f"mag_{axis}_mg"] = f["mag"][:, k]
    values["imu_temperature_degc"] = f["temperature"]
    values["pressure_pa"] = f["pressure"]
    values["pressure_temperature_degc"] = f["pressure_temperature"]
    counts = {
        "raw_sensors_between_states": int(np.count_nonzero(ahead)),
        "raw_sensors_without_time": int(np.count_nonzero(~known)),
    }
    return frame_of(INS_RAW, values), counts


def _ahead_s(index: ArrayI, clock: Clock) -> ArrayF:
    """Seconds by which packets lie behind the time packet ``index`` (increasing) before them."""
    if index.size == 0:
        return np.empty(0)
    used, first, n = np.unique(index, return_index=True, return_counts=True)
    behind = np.arange(index.size) - np.repeat(first, n)
    if used.size < 2 or not behind.any():
        return np.zeros(index.size)
    step = np.diff(clock.t_device_s[used])
    regular = step[step > 0]
    step_s = float(np.median(regular)) / float(np.median(n)) if regular.size else 0.0
    t = clock.t_device_s
    following = np.minimum(index + 1, t.size - 1)
    room = np.where(following > index, t[following] - t[index], np.inf)
    # a clock that is set back leaves no room: such packets keep the time of their state
    return np.minimum(behind * step_s, np.maximum(room, 0.0))


def _times(clock: Clock, packet: ArrayI) -> tuple[AnyArray, ArrayF]:
    index = clock.before(packet)
    known = index >= 0
    t = np.full(packet.size, np.nan)
    t[known] = clock.t_device_s[index[known]]
    return known, t


def stamps(clock: Clock, packet: ArrayI) -> tuple[ArrayF, ArrayF]:
    """GPS and device time of the time packet before each packet, NaN where there is none."""
    index = clock.before(packet)
    known = index >= 0
    t_gps = np.full(packet.size, np.nan)
    t_gps[known] = clock.t_gps_s[index[known]]
    return t_gps, _times(clock, packet)[1]


def gnss_table(records: AnppRecords, clock: Clock) -> tuple[pd.DataFrame, int, int]:
    """Antenna positions (29, or 92) as ``gnss_position``; how many had no fix, how many cannot be.

    Positions without fix are left out. Packets 29 win if both are logged.
    Satellites are those of the packet 30 of the same moment, else -1.
    """
    source = ap.RAW_GNSS if records.of(ap.RAW_GNSS).packet.size else ap.GNSS_PVT
    time_bit = 1 << 4 if source == ap.RAW_GNSS else 1 << 10
    r = records.of(source)
    has_fix = r.fields["flags"] & 7 != 0
    possible = _possible(np.rad2deg(r.fields["lat"]), np.rad2deg(r.fields["lon"]), r.fields["height"])
    kept = r.take(np.asarray(has_fix & possible))
    f = kept.fields
    valid = (f["flags"] & time_bit != 0) & possible_utc(f["unix_s"], f["us"])
    nan = np.full(f.size, np.nan)
    table = frame_of(
        GNSS_POSITION,
        {
            "t_gps_s": gps_time(f["unix_s"], f["us"].astype(np.float64), np.asarray(valid)),
            "lat_deg": np.rad2deg(f["lat"]),
            "lon_deg": np.rad2deg(f["lon"]),
            "h_ell_m": f["height"],
            "fix": ap.fix_of(f["flags"], 0, ap.GNSS_FIX),
            "n_sats": _satellites(records, clock, kept.packet),
            "sigma_east_m": _positive(f["sigma"][:, 1]),
            "sigma_north_m": _positive(f["sigma"][:, 0]),
            "sigma_up_m": _positive(f["sigma"][:, 2]),
            **dict.fromkeys(("cov_en_m2", "cov_eu_m2", "cov_nu_m2", "age_s", "ratio"), nan),
        },
    )
    return table, int((~has_fix).sum()), int((has_fix & ~possible).sum())


def _possible(lat_deg: AnyArray, lon_deg: AnyArray, h_m: AnyArray) -> ArrayB:
    """False for positions that are not on this planet (one metre around the poles is let through)."""
    return np.asarray((np.abs(lat_deg) <= 90.00001) & (np.abs(lon_deg) <= 360.0) & (np.abs(h_m) < 1e7))


def blank_impossible(states: pd.DataFrame) -> int:
    """Set positions that cannot be to NaN, in place; returns how many."""
    columns = ["lat_deg", "lon_deg", "h_ell_m"]
    wrong = ~_possible(*(states[name].to_numpy() for name in columns))
    if wrong.any():
        states.loc[wrong, columns] = np.nan
    return int(wrong.sum())


def _satellites(records: AnppRecords, clock: Clock, packet: ArrayI) -> ArrayI:
    """Satellites in use by the packet 30 of the same moment as each packet, -1 where there is none."""
    satellites = records.of(ap.SATELLITES)
    out = np.full(packet.size, -1, dtype=np.int64)
    if satellites.packet.size and packet.size:
        used = satellites.fields["used"].astype(np.int64).sum(axis=1)
        moment, own = clock.before(satellites.packet), clock.before(packet)
        at = np.clip(np.searchsorted(moment, own), 0, moment.size - 1)
        same = moment[at] == own
        out[same] = used[at[same]]
    return out


def _positive(sigma: AnyArray) -> ArrayF:
    """Standard deviations as float64; zero stands for unknown."""
    value = sigma.astype(np.float64)
    return np.where(value > 0, value, np.nan)


def depth_table(records: AnppRecords, clock: Clock) -> tuple[pd.DataFrame, int]:
    """External depth packets (53) as table kind ``depth``; and how many were no number."""
    r = records.of(ap.DEPTH_IN)
    kept = r.take(np.asarray(np.isfinite(r.fields["depth"])))
    t_gps, _ = stamps(clock, kept.packet)
    n = kept.packet.size
    table = frame_of(
        DEPTH,
        {
            "t_gps_s": t_gps,
            "t_host_s": np.full(n, np.nan),
            "t_day_s": np.full(n, np.nan),
            "depth_m": kept.fields["depth"],
            "offset_m": np.full(n, np.nan),
            "sentence": np.full(n, "ANPP53", dtype=object),
            "line": kept.packet + 1,
        },
    )
    return table, int(r.packet.size - n)


def heave_table(records: AnppRecords, clock: Clock) -> pd.DataFrame:
    """Heave packets (58) as table kind ``anpp_heave``."""
    r = records.of(ap.HEAVE)
    t_gps, t_device = stamps(clock, r.packet)
    heave = {f"heave_{i + 1}_m": r.fields["heave"][:, i] for i in range(4)}
    return frame_of(HEAVE, {"t_gps_s": t_gps, "t_device_s": t_device, **heave})


# ---------------------------------------------------------------- what the integrity report says about an
# ANPP log: device, clock, gaps, alarms


_RESOLUTION_S: Final = 1e-6
"""Packets 20, 21 and 22 state whole microseconds."""


def describe_log(report: IntegrityReport, records: AnppRecords, clock: Clock, states: pd.DataFrame) -> None:
    """Fill in device, time span, gaps, rates, alarms and packets by id."""
    _device(report, records)
    _time(report, clock, states)
    _status(report, states)
    used = records.of(ap.SATELLITES).fields["used"]
    if used.size:
        report.details["satellites in use, median"] = float(np.median(used.astype(np.int64).sum(axis=1)))
    if records.satellites_31:
        report.details["satellites in view, median"] = float(np.median(records.satellites_31))
    report.details["packets by id"] = {ap.describe(k): n for k, n in records.counts.items()}


def _device(report: IntegrityReport, records: AnppRecords) -> None:
    found = np.unique(records.of(ap.DEVICE).fields)
    for row in found:
        name = ap.DEVICES.get(int(row["device"]), f"device id {int(row['device'])}")
        report.model = f"{report.model}, {name}" if report.model and name not in report.model else name
        report.details["firmware"] = int(row["firmware"])
        report.details["hardware"] = int(row["hardware"])
        report.details["serial number"] = "-".join(f"{int(part):08X}" for part in row["serial"])
    if found.size > 1:
        report.note(f"The log names {found.size} different devices or firmwares: is it one recording?")
    for row in np.unique(records.of(ap.GNSS_RECEIVER).fields):
        maker = ap.GNSS_MAKERS.get(int(row["manufacturer"]), f"manufacturer {int(row['manufacturer'])}")
        report.details["GNSS receiver"] = f"{maker}, model {int(row['model'])}"


def _time(report: IntegrityReport, clock: Clock, states: pd.DataFrame) -> None:
    """Clock state, span, gaps and steps; of the states if there are any, else of all time packets."""
    device = states["t_device_s"].to_numpy() if len(states) else clock.t_device_s
    gps = states["t_gps_s"].to_numpy() if len(states) else clock.t_gps_s
    what = "states" if len(states) else "time packets"
    known = np.isfinite(gps)
    if not device.size:
        report.note("There is no packet with a time (20, 21 or 22): nothing in this log can be timed.")
        return
    report.synchronised = bool(known.any())
    report.time_scale = "utc" if report.synchronised else "device"
    t = gps[known] if report.synchronised else device
    report.t_first_s, report.t_last_s = float(t.min()), float(t.max())
    report.gaps = find_gaps(t)
    _timing(report, device, gps, t)
    _steps(report, t, what)
    if not known.any():
        report.note(
            f"UTC was never initialised: all {device.size:,} {what} carry the device's own clock and have no "
            "GPS time. The log cannot be joined with other sensors by time."
        )
    elif not known.all():
        report.note(
            f"{int((~known).sum()):,} of {device.size:,} {what} carry no valid UTC (UTC not initialised, or "
            "an impossible date) and have no GPS time; they are kept with the device's own clock."
        )


def _timing(report: IntegrityReport, device: ArrayF, gps: ArrayF, t: ArrayF) -> None:
    """Period and jitter, times before UTC was initialised, and the step of the clock when it was."""
    timing = report.timing
    timing.describe_stamps(t, _RESOLUTION_S)
    timing.place_unsynchronised(device, gps)
    known = np.isfinite(gps)
    begins = np.flatnonzero(known[1:] & ~known[:-1])
    if begins.size:
        i = int(begins[0])
        timing.clock = "device"
        timing.clock_set_s = float(device[i + 1] - device[i]) - (timing.period_s or 0.0)


def _steps(report: IntegrityReport, t: ArrayF, what: str) -> None:
    step = np.diff(t)
    regular = step[step > 0]
    if not regular.size:
        return
    normal = float(np.median(regular))
    report.rates_hz[what] = 1.0 / normal
    for name, n in (
        ("time_steps_backwards", int((step < 0).sum())),
        ("times_repeated", int((step == 0).sum())),
    ):
        if n:
            report.lose(name, n)
            report.note(f"{name.replace('_', ' ').capitalize()}: {n:,} among {t.size:,} {what}.")
    short = int(((step > 0) & (step < 0.5 * normal)).sum())
    if short:
        report.count("time_steps_shorter_than_half", short)


def _status(report: IntegrityReport, states: pd.DataFrame) -> None:
    """Alarms and what the filter had not initialised yet."""
    n = len(states)
    if not n:
        return
    system, flags = states["system_status"].to_numpy(), states["filter_status"].to_numpy()
    for bit, name in enumerate(ap.SYSTEM_ALARMS):
        raised = int((system & (1 << bit) != 0).sum())
        if raised:
            report.note(f"The device reports {name} in {raised:,} of {n:,} states.")
    for mask, name in (
        (ap.FILTER_ORIENTATION, "orientation filter"),
        (ap.FILTER_INS, "navigation filter"),
        (ap.FILTER_HEADING, "heading"),
    ):
        missing = int((flags & mask == 0).sum())
        if missing:
            report.note(f"The {name} was not initialised in {missing:,} of {n:,} states.")
    report.details["fixes"] = {str(k): int(v) for k, v in states["fix"].value_counts().items()}
    events = int((flags & 0x180 != 0).sum())
    if events:
        report.count("states_with_event_flag", events)


# ---------------------------------------------------------------- packets that occur in two files of one
# recording


def drop_repeated(records: AnppRecords) -> int:
    """Drop packets of a later file that an earlier file holds already; returns how many.

    A packet is repeated if its bytes and the device time of the time packet before it are the same. At the
    beginning of a file, ahead of its first time packet, the bytes decide alone, and only if that first time
    lies within the files before.
    """
    if len(records.tally.files) < 2:
        return 0
    clock = build_clock(records)
    first_packet = np.cumsum([0, *records.tally.packets])[:-1]
    dropped = 0
    for packet_id, found in list(records.by_id.items()):
        if packet_id in (ap.DEVICE, ap.GNSS_RECEIVER):
            continue
        again = _repeated(found, first_packet, clock)
        if again.any():
            records.by_id[packet_id] = found.take(~again)
            dropped += int(again.sum())
    return dropped


def _file_of(packet: ArrayI, first_packet: ArrayI) -> ArrayI:
    return np.searchsorted(first_packet, packet, side="right").astype(np.int64) - 1


def _repeated(found: Records, first_packet: ArrayI, clock: Clock) -> ArrayB:
    """True where an earlier file holds the same bytes at the same time."""
    file, clock_file = _file_of(found.packet, first_packet), _file_of(clock.packet, first_packet)
    index = clock.before(found.packet)
    t_device = clock.t_device_s
    t = np.where(index >= 0, t_device[np.maximum(index, 0)] if t_device.size else np.nan, np.nan)
    timed = (index >= 0) & (clock_file[np.maximum(index, 0)] == file) if t_device.size else index >= 0
    again = np.zeros(t.size, dtype=np.bool_)
    for number in np.unique(file)[1:]:
        new = np.flatnonzero(file == number)
        begin = _first_time(t_device, clock_file == number)
        old = np.flatnonzero((file < number) & timed & (t >= begin))
        seen = {(t[i], found.fields[i].tobytes()) for i in old}
        again[new] = [bool(timed[i]) and (t[i], found.fields[i].tobytes()) in seen for i in new]
        earlier = t_device[clock_file < number]
        if earlier.size and earlier.min() < begin <= earlier.max():
            bytes_seen = {found.fields[i].tobytes() for i in np.flatnonzero(file < number)}
            ahead = new[~timed[new]]
            again[ahead] = [found.fields[i].tobytes() in bytes_seen for i in ahead]
    return again


def _first_time(t_device_s: ArrayF, inside: ArrayB) -> float:
    """Earliest time in a file, infinity if it has none."""
    t = t_device_s[inside]
    return float(t.min()) if t.size else np.inf


# ---------------------------------------------------------------- NMEA sentences inside ANPP serial port
# passthrough packets (10)


_ROUTES: Final = {0: "gpio", 1: "auxiliary"}
_SENTENCE: Final = re.compile(rb"[$!]([ \"#%-)+-~]{1,250})\*([0-9A-Fa-f]{2})")


def passthrough_table(records: AnppRecords, clock: Clock) -> tuple[pd.DataFrame, int]:
    """Sentences with a right checksum as table kind ``anpp_passthrough``; and how many had a wrong one.

    The bytes of each route are joined over packets, because a sentence may be split between two. A sentence
    takes the time of the time packet before the packet in which it ends.
    """
    rows: list[tuple[int, str, str]] = []
    wrong = 0
    for route in sorted({r for _, r, _ in records.passthrough}):
        pieces = [(packet, data) for packet, r, data in records.passthrough if r == route]
        ends = np.cumsum([len(data) for _, data in pieces])
        for found in _SENTENCE.finditer(b"".join(data for _, data in pieces)):
            if reduce(int.__xor__, found[1]) != int(found[2], 16):
                wrong += 1
                continue
            packet = pieces[int(np.searchsorted(ends, found.end()))][0]
            rows.append((packet, _ROUTES.get(route, str(route)), found[0].decode("ascii")))
    rows.sort(key=lambda row: row[0])
    packet_number = np.array([row[0] for row in rows], dtype=np.int64)
    t_gps, t_device = stamps(clock, packet_number)
    table = frame_of(
        PASSTHROUGH,
        {
            "t_gps_s": t_gps,
            "t_device_s": t_device,
            "route": np.array([row[1] for row in rows], dtype=object),
            "sentence": np.array([row[2] for row in rows], dtype=object),
            "packet": packet_number + 1,
        },
    )
    return table, wrong


# ---------------------------------------------------------------- reader


__all__ = ["AnppLog", "read_anpp"]


@dataclass(frozen=True, slots=True, kw_only=True)
class AnppLog:
    """What an ANPP log holds.

    Attributes
    ----------
    states : table kind ``ins_state``, one row a system state packet (20).
    raw : table kind ``ins_raw``, one row a raw sensors packet (28).
    gnss : table kind ``gnss_position`` at the antenna: packets 29 (else 92) that have a fix.
    depth : table kind ``depth``: external depth packets (53).
    heave : table kind ``anpp_heave``: heave packets (58).
    passthrough : table kind ``anpp_passthrough``: NMEA sentences in packets 10.
    report : integrity report, stream ``"ins"``.
    packet_counts : packets by id, of any id.
    """

    states: pd.DataFrame
    raw: pd.DataFrame
    gnss: pd.DataFrame
    depth: pd.DataFrame
    heave: pd.DataFrame
    passthrough: pd.DataFrame
    report: IntegrityReport
    packet_counts: dict[int, int]


def read_anpp(files: Sequence[Path], *, chunk_bytes: int = CHUNK_BYTES) -> AnppLog:
    """Read an ANPP log.

    Parameters
    ----------
    files : parts of one recording in the order of recording. Packets that two files share are kept once
        and counted; a packet split between two files is whole again.
    chunk_bytes : bytes read at a time.

    Raises
    ------
    InputError : no files, a file that cannot be read or holds no ANPP packet, or all files are empty.
    """
    records = collect([Path(f) for f in files], chunk_bytes)
    # a number that no device should send is a finding in the report, not an error of arithmetic
    with np.errstate(over="ignore", invalid="ignore"):
        return _log_of(records)


def _log_of(records: AnppRecords) -> AnppLog:
    repeated = drop_repeated(records)
    clock = build_clock(records)
    report = IntegrityReport(stream="ins", format="ANPP", files=[])
    states = states_table(records)
    describe_log(report, records, clock, states)
    records.tally.write(report, "packet")
    with_sigma = add_orientation_sigmas(states, records, clock)
    raw, raw_counts = raw_table(records, clock)
    gnss, no_fix, impossible_gnss = gnss_table(records, clock)
    depth, no_depth = depth_table(records, clock)
    heave = heave_table(records, clock)
    text, wrong_text = passthrough_table(records, clock)
    named = {"states": states, "raw_sensors": raw, "gnss_positions": gnss, "depths": depth}
    for name, table in {**named, "heaves": heave, "nmea_sentences": text}.items():
        if len(table) or name in ("states", "raw_sensors"):
            report.count(name, len(table))
    for name, n in {
        **raw_counts,
        "gnss_positions_without_fix": no_fix,
        "states_with_orientation_sigma": with_sigma,
        "repeated_packets_dropped": repeated,
    }.items():
        if n:
            report.count(name, n)
    for name, n in {
        "depths_not_a_number": no_depth,
        "nmea_sentences_with_wrong_checksum": wrong_text,
        "packets_of_wrong_size": sum(records.wrong_size.values()),
        "impossible_times": clock.n_impossible,
        "states_with_impossible_position": blank_impossible(states),
        "gnss_positions_impossible": impossible_gnss,
    }.items():
        if n:
            report.lose(name, n)
    _say(report, records, raw_counts, repeated)
    return AnppLog(
        states=states,
        raw=raw,
        gnss=gnss,
        depth=depth,
        heave=heave,
        passthrough=text,
        report=report,
        packet_counts=dict(records.counts),
    )


def _say(report: IntegrityReport, records: AnppRecords, raw: dict[str, int], repeated: int) -> None:
    """Sentences about what was dropped or estimated."""
    if repeated:
        report.note(f"The files overlap: {repeated:,} packets that occur in two of them are kept once.")
    if raw["raw_sensors_between_states"]:
        report.note(
            f"Raw sensor packets that follow another one without a time packet between: "
            f"{raw['raw_sensors_between_states']:,}; their times are counted on at their own rate."
        )
    if raw["raw_sensors_without_time"]:
        report.note(
            f"Raw sensor packets before the first time packet: {raw['raw_sensors_without_time']:,}; they "
            "have no time."
        )
    for packet_id, n in records.wrong_size.items():
        report.note(
            f"{n:,} packets {ap.describe(packet_id)} are not of the documented size of "
            f"{ap.LAYOUTS[packet_id].itemsize} bytes and are left out (another device family?)."
        )
    if 27 in records.counts and ap.EULER_SIGMA not in records.counts:
        report.note(
            "Orientation sigmas are logged as quaternion (27) only, which is not converted: log packet 26."
        )
