"""The ANPP reader: logs of Advanced Navigation's INS as tables and an integrity report.

Times are UTC once the device says so (bit 3 of the filter status). Before, they are the device's own
clock: ``t_gps_s`` is NaN and ``t_device_s`` is kept. Packets without time take that of the time packet
before them. States refer to the configured reference point, raw GNSS positions to the antenna.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core import AnyArray, ArrayB, ArrayI, frame_of
from thalweg.ingest import DEPTH, GNSS_POSITION, INS_STATE, IntegrityReport, PoseLog
from thalweg.ingest.anpp import packets as ap
from thalweg.ingest.anpp.packets import AnppRecords, Clock, build_clock, collect, gps_time, possible_utc
from thalweg.ingest.framing import CHUNK_BYTES, Records

# ---------------------------------------------------------------- tables out of decoded ANPP packets


_MAX_SIGMA_AGE_S: Final = 1.0
"""Orientation sigmas older than this and than 1.5 of their own steps belong to no state."""


def states_table(records: AnppRecords) -> pd.DataFrame:
    """System state packets (20) as table kind ``ins_state``, without the sigmas of the orientation."""
    f = records.of(ap.STATE).fields
    utc = (f["filter"] & ap.FILTER_UTC != 0) & possible_utc(f["unix_s"], f["us"])
    heading = np.mod(f["orientation"][:, 2].astype(np.float64), 2 * np.pi)
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
            "fix": ap.fix_of(f["filter"], 4, ap.STATE_FIX),
            "system_status": f["system"],
            "filter_status": f["filter"],
        },
        unknown=np.nan,
    )


def add_orientation_sigmas(states: pd.DataFrame, records: AnppRecords, clock: Clock) -> int:
    """Give each state the sigmas of the nearest packet 26 in time; returns how many states got them."""
    euler = records.of(ap.EULER_SIGMA)
    of_packet = pd.DataFrame(euler.fields["sigma"].astype(np.float64))
    of_packet["t_device_s"] = clock.at(euler.number)[1]
    of_packet = of_packet.dropna(subset="t_device_s").sort_values("t_device_s", kind="stable")
    if of_packet.empty or states.empty:
        return 0
    step = of_packet["t_device_s"].diff().median()
    limit = max(_MAX_SIGMA_AGE_S, 1.5 * step if len(of_packet) > 1 else 0.0)
    at = states["t_device_s"].sort_values(kind="stable")
    near = pd.merge_asof(
        at.to_frame(),
        of_packet,
        on="t_device_s",
        direction="nearest",
        tolerance=limit,  # type: ignore[arg-type]  # the stubs know times only
    )
    near = near.set_index(at.index).reindex(states.index)
    for k, name in enumerate(("roll", "pitch", "heading")):
        states[f"sigma_{name}_rad"] = near[k]
    return int(near[0].notna().sum())


def gnss_table(records: AnppRecords, clock: Clock) -> tuple[pd.DataFrame, int, int]:
    """Antenna positions (29, or 92) as ``gnss_position``; how many had no fix, how many cannot be.

    Positions without fix are left out. Packets 29 win if both are logged.
    Satellites are those of the packet 30 of the same moment, else -1.
    """
    source = ap.RAW_GNSS if records.of(ap.RAW_GNSS).number.size else ap.GNSS_PVT
    time_bit = 1 << 4 if source == ap.RAW_GNSS else 1 << 10
    r = records.of(source)
    has_fix = r.fields["flags"] & 7 != 0
    possible = _possible(np.rad2deg(r.fields["lat"]), np.rad2deg(r.fields["lon"]), r.fields["height"])
    kept = r.take(np.asarray(has_fix & possible))
    f = kept.fields
    valid = (f["flags"] & time_bit != 0) & possible_utc(f["unix_s"], f["us"])
    sigma = np.where(f["sigma"] > 0, f["sigma"].astype(np.float64), np.nan)  # 0 stands for unknown
    table = frame_of(
        GNSS_POSITION,
        {
            "t_gps_s": gps_time(f["unix_s"], f["us"].astype(np.float64), np.asarray(valid)),
            "lat_deg": np.rad2deg(f["lat"]),
            "lon_deg": np.rad2deg(f["lon"]),
            "h_ell_m": f["height"],
            "fix": ap.fix_of(f["flags"], 0, ap.GNSS_FIX),
            "n_sats": _satellites(records, clock, kept.number),
            "sigma_east_m": sigma[:, 1],
            "sigma_north_m": sigma[:, 0],
            "sigma_up_m": sigma[:, 2],
        },
        unknown=np.nan,
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
    used = satellites.fields["used"].astype(np.int64).sum(axis=1)
    of_moment = pd.Series(used, index=clock.before(satellites.number))
    of_moment = of_moment[~of_moment.index.duplicated()]
    return of_moment.reindex(clock.before(packet), fill_value=-1).to_numpy(np.int64)


def depth_table(records: AnppRecords, clock: Clock) -> tuple[pd.DataFrame, int]:
    """External depth packets (53) as table kind ``depth``; and how many were no number."""
    r = records.of(ap.DEPTH_IN)
    kept = r.take(np.asarray(np.isfinite(r.fields["depth"])))
    values = {
        "t_gps_s": clock.at(kept.number)[0],
        "depth_m": kept.fields["depth"],
        "sentence": np.full(kept.number.size, "ANPP53", dtype=object),
        "line": kept.number + 1,
    }
    return frame_of(DEPTH, values, unknown=np.nan), int(r.number.size - kept.number.size)


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
    report.details["packets by id"] = {ap.describe(k): n for k, n in records.by_id.items()}


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
    report.take_times(t, what, _RESOLUTION_S)
    for name in ("time_steps_back", "repeated_times"):
        if n := report.losses.get(name, 0):
            report.note(f"{name.replace('_', ' ').capitalize()}: {n:,} among {t.size:,} {what}.")
    step = np.diff(t)
    short = (step > 0) & (step * report.rates_hz.get(what, 0.0) < 0.5)
    report.count_some("time_steps_shorter_than_half", short.sum())
    report.timing.place_unsynchronised(device, gps)
    begins = np.flatnonzero(known[1:] & ~known[:-1])
    if begins.size:
        i = int(begins[0])
        report.timing.clock = "device"
        report.timing.clock_set_s = float(device[i + 1] - device[i]) - (report.timing.period_s or 0.0)
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
    report.count_some("states_with_event_flag", (flags & 0x180 != 0).sum())


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
    for packet_id in records.parts.keys() - {ap.DEVICE, ap.GNSS_RECEIVER}:
        found = records.of(packet_id)
        again = _repeated(found, first_packet, clock)
        records.parts[packet_id] = [found.take(~again)]
        dropped += int(again.sum())
    return dropped


def _repeated(found: Records, first_packet: ArrayI, clock: Clock) -> ArrayB:
    """True where an earlier file holds the same bytes at the same time."""
    file, clock_file = (
        np.searchsorted(first_packet, p, side="right") - 1 for p in (found.number, clock.packet)
    )
    index = clock.before(found.number)
    timed = (index >= 0) & (np.append(clock_file, -1)[index] == file)
    t = np.append(clock.t_device_s, np.nan)[index]
    content = [row.tobytes() for row in found.fields]
    again = np.zeros(t.size, dtype=np.bool_)
    for number in np.unique(file)[1:]:
        new = np.flatnonzero(file == number)
        begin = clock.t_device_s[clock_file == number].min(initial=np.inf)
        seen = {(t[i], content[i]) for i in np.flatnonzero((file < number) & timed & (t >= begin))}
        again[new] = [bool(timed[i]) and (t[i], content[i]) in seen for i in new]
        earlier = clock.t_device_s[clock_file < number]
        if earlier.size and earlier.min() < begin <= earlier.max():
            seen_bytes = {content[i] for i in np.flatnonzero(file < number)}
            ahead = new[~timed[new]]
            again[ahead] = [content[i] in seen_bytes for i in ahead]
    return again


# ---------------------------------------------------------------- reader


def read_anpp(files: Sequence[Path], *, chunk_bytes: int = CHUNK_BYTES) -> PoseLog:
    """States of the packets 20, positions of the antenna (29, else 92) with a fix, and depths (53).

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


def _log_of(records: AnppRecords) -> PoseLog:
    repeated = drop_repeated(records)
    clock = build_clock(records)
    report = IntegrityReport.of("ins", "ANPP", ())
    states = states_table(records)
    describe_log(report, records, clock, states)
    records.tally.write(report, "packet")
    with_sigma = add_orientation_sigmas(states, records, clock)
    gnss, no_fix, impossible_gnss = gnss_table(records, clock)
    depth, no_depth = depth_table(records, clock)
    report.count("states", len(states))
    for name, n in {
        "gnss_positions": len(gnss),
        "depths": len(depth),
        "gnss_positions_without_fix": no_fix,
        "states_with_orientation_sigma": with_sigma,
        "repeated_packets_dropped": repeated,
    }.items():
        report.count_some(name, n)
    for name, n in {
        "depths_not_a_number": no_depth,
        "packets_of_wrong_size": sum(records.wrong_size.values()),
        "impossible_times": clock.n_impossible,
        "states_with_impossible_position": blank_impossible(states),
        "gnss_positions_impossible": impossible_gnss,
    }.items():
        report.lose(name, n)
    if repeated:
        report.note(f"The files overlap: {repeated:,} packets that occur in two of them are kept once.")
    for packet_id, n in records.wrong_size.items():
        report.note(
            f"{n:,} packets {ap.describe(packet_id)} are not of the documented size of "
            f"{ap.LAYOUTS[packet_id].itemsize} bytes and are left out (another device family?)."
        )
    ids = records.by_id
    if 27 in ids and ap.EULER_SIGMA not in ids:
        report.note(
            "Orientation sigmas are logged as quaternion (27) only, which is not converted: log packet 26."
        )
    unread = [f"{ap.describe(k)} {ids[k]:,}" for k in ap.UNREAD if k in ids]
    if unread:
        report.note("Not read: packets " + ", ".join(unread) + ".")
    return PoseLog(states=states, positions=gnss, depths=depth, report=report)
