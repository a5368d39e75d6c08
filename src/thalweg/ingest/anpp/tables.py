"""Tables out of decoded ANPP packets."""

from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa

from thalweg.core.tables import column, frame_of, table_kind
from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayI
from thalweg.ingest.anpp import packets as ap
from thalweg.ingest.anpp.records import AnppRecords, Clock, gps_time, possible_utc
from thalweg.ingest.schemas import DEPTH, GNSS_POSITION, INS_RAW, INS_STATE

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
