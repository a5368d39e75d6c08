"""What the integrity report says about an ANPP log: device, clock, gaps, alarms."""

from typing import Final

import numpy as np
import pandas as pd

from thalweg.core.types import ArrayF
from thalweg.ingest.anpp import packets as ap
from thalweg.ingest.anpp.records import AnppRecords, Clock
from thalweg.ingest.integrity import IntegrityReport, find_gaps

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
