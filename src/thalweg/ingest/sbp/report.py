"""What the integrity report says about an SBP log: messages, clock, UTC offset, base, gaps."""

from typing import Final

import numpy as np
import pandas as pd
from sbp.table import lookup

from thalweg.core.timescales import LEAP_TABLE_VALID_UNTIL, gps_minus_utc, utc_text_from_unix
from thalweg.core.types import ArrayF
from thalweg.ingest.integrity import IntegrityReport, find_gaps
from thalweg.ingest.sbp import messages as sm
from thalweg.ingest.sbp.records import SbpRecords
from thalweg.ingest.sbp.time import WeekTrack

_BASE_MOVE_M: Final = 0.001
_MILLISECOND_S: Final = 1e-3
_NANOSECOND_S: Final = 1e-9
_UTC_TOLERANCE_S: Final = 0.0015
"""Offsets are rounded to a millisecond; leap seconds differ by whole seconds."""


def message_name(kind: int) -> str | None:
    """Name of a message type in the library ``sbp``, None if it knows none.

    Examples
    --------
    >>> message_name(0x020A), message_name(0xFFF0)
    ('MsgPosLLH', None)
    """
    found = lookup(kind)
    return None if found is None else str(found.__name__)


def describe_log(
    report: IntegrityReport,
    records: SbpRecords,
    track: WeekTrack,
    positions: pd.DataFrame,
    kinds: tuple[int, ...],
    base_ecef_m: ArrayF,
    offset_s: ArrayF,
    unix_s: ArrayF,
    obs_epochs: dict[int, tuple[int, float, float]],
) -> None:
    """Fill in messages, losses, clock state, UTC offset, base and gaps."""
    _clock(report, track, positions)
    records.tally.write(report, "message")
    _messages(report, records)
    _utc(report, offset_s, unix_s)
    if len(positions):
        report.details["positions from"] = " + ".join(str(message_name(k)) for k in kinds)
        report.details["fixes"] = {str(k): int(v) for k, v in positions["fix"].value_counts().items()}
    else:
        report.note("The log holds no position with a fix.")
    if base_ecef_m.shape[0]:
        spread = float(np.ptp(base_ecef_m, axis=0).max())
        report.count("base_positions", base_ecef_m.shape[0])
        if spread > _BASE_MOVE_M:
            report.note(
                f"The base positions stated in the log differ by up to {spread:.3f} m; the median is used."
            )
    for sender, (n, _, _) in obs_epochs.items():
        report.count("observation_epochs_base" if sender == 0 else f"observation_epochs_{sender}", n)


def _clock(report: IntegrityReport, track: WeekTrack, positions: pd.DataFrame) -> None:
    t = positions["t_gps_s"].to_numpy()
    t = t[np.isfinite(t)]
    what = "positions" if t.size else "time messages"
    t = t if t.size else track.t_gps_s
    report.synchronised = bool(t.size)
    report.time_scale = "gps" if t.size else "none"
    if not t.size:
        report.note(
            "No message states a valid GPS week (MsgGPSTime, MsgObs): the time of the week alone is no date, "
            "and nothing in this log can be timed."
        )
        return
    report.t_first_s, report.t_last_s = float(t.min()), float(t.max())
    report.gaps = find_gaps(t)
    report.timing.describe_stamps(t, _NANOSECOND_S if track.ns.any() else _MILLISECOND_S)
    untimed = len(positions) - int(np.isfinite(positions["t_gps_s"]).sum())
    report.timing.unsynchronised_s = untimed * (report.timing.period_s or 0.0)
    report.details["GPS week from"] = track.source
    step = np.diff(t)
    if (step > 0).any():
        report.rates_hz[what] = 1.0 / float(np.median(step[step > 0]))
    backwards = int((step < 0).sum())
    if backwards:
        report.lose("time_steps_backwards", backwards)
        report.note(f"Time steps backwards {backwards:,} times among {t.size:,} {what}.")


def _messages(report: IntegrityReport, records: SbpRecords) -> None:
    by_name: dict[str, int] = {}
    unknown: dict[int, int] = {}
    for (kind, sender), n in sorted(records.counts.items(), key=lambda item: -item[1]):
        name = message_name(kind)
        by_name[f"{name or f'0x{kind:04X}'} {sender}"] = n
        if name is None:
            unknown[kind] = unknown.get(kind, 0) + n
    if unknown:
        report.count("messages_of_unknown_type", sum(unknown.values()))
        report.note(
            "Message types that the SBP specification does not name: "
            + ", ".join(f"0x{kind:04X} ({n:,})" for kind, n in unknown.items())
            + "."
        )
    wrong = sum(records.wrong_size.values())
    if wrong:
        report.lose("messages_of_wrong_size", wrong)
        report.note(
            "Messages not of the documented size, left out: "
            + ", ".join(f"{message_name(kind)} ({n:,})" for kind, n in records.wrong_size.items())
            + "."
        )
    for name, kind in (("imu_raw", sm.IMU_RAW), ("mag_raw", sm.MAG_RAW)):
        n = sum(count for (k, _), count in records.counts.items() if k == kind)
        if n:
            report.count(name, n)
    ephemerides = sum(n for name, n in by_name.items() if name.startswith("MsgEphemeris"))
    if ephemerides:
        report.count("ephemerides", ephemerides)
    for sender in sorted({s for s, _ in records.signals}):
        report.details[f"signals by code, sender {sender}"] = {
            str(code): n for (s, code), n in sorted(records.signals.items()) if s == sender
        }
    report.details["messages by type and sender"] = by_name


def _utc(report: IntegrityReport, offset_s: ArrayF, unix_s: ArrayF) -> None:
    """Compare the receiver's GPS - UTC with the table of leap seconds."""
    if not offset_s.size:
        return
    values, counts = np.unique(offset_s, return_counts=True)
    report.details["GPS - UTC"] = {f"{value:.3f} s": int(n) for value, n in zip(values, counts, strict=True)}
    table = gps_minus_utc(unix_s)
    wrong = np.abs(offset_s - table) > _UTC_TOLERANCE_S
    if wrong.any():
        first = int(np.argmax(wrong))
        moment = utc_text_from_unix(unix_s[first])
        report.note(
            f"The receiver states GPS - UTC = {offset_s[first]:.3f} s at {moment}, "
            f"the table of leap seconds (complete until {LEAP_TABLE_VALID_UNTIL}) {table[first]:.0f} s "
            f"({int(wrong.sum()):,} of {wrong.size:,} stamps differ). GPS times come from MsgGPSTime and do "
            "not depend on it."
        )
