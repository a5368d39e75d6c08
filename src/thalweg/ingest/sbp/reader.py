"""The SBP reader: logs of Swift Navigation's receivers as tables and an integrity report.

Frames are found and decoded in compiled code and numpy; the library ``sbp`` names the message types and is
the oracle of the tests. Sender 0 relays the base, any other sender is the rover.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from thalweg.core.timescales import gps_from_week
from thalweg.core.types import ArrayF
from thalweg.ingest.framing.stream import CHUNK_BYTES
from thalweg.ingest.integrity import IntegrityReport
from thalweg.ingest.sbp import messages as sm
from thalweg.ingest.sbp import tables
from thalweg.ingest.sbp.records import SbpRecords, collect
from thalweg.ingest.sbp.report import describe_log
from thalweg.ingest.sbp.time import build_track, measured_gps_minus_utc, possible_week

__all__ = ["SbpLog", "read_sbp"]


@dataclass(frozen=True, slots=True, kw_only=True)
class SbpLog:
    """What an SBP log holds.

    Attributes
    ----------
    positions : table kind ``gnss_position``: the receiver's own solution, epochs with a fix.
    baselines : table kind ``gnss_baseline``.
    velocities : table kind ``gnss_velocity``.
    events : table kind ``gnss_event``: camera triggers, PPS.
    base_ecef_m : (3,) median of the base positions that the log states, earth-centred; None if none.
    obs_epochs : by sender (0 = base) number of epochs with raw observations, first and last of them in
        adjusted GPS time.
    gps_minus_utc_s : as the receiver states it; None if it states no UTC.
    message_counts : messages by (type, sender), of any type.
    report : integrity report, stream ``"gnss"``.
    """

    positions: pd.DataFrame
    baselines: pd.DataFrame
    velocities: pd.DataFrame
    events: pd.DataFrame
    base_ecef_m: ArrayF | None
    obs_epochs: dict[int, tuple[int, float, float]]
    gps_minus_utc_s: float | None
    message_counts: dict[tuple[int, int], int]
    report: IntegrityReport


def read_sbp(files: Sequence[Path], *, chunk_bytes: int = CHUNK_BYTES) -> SbpLog:
    """Read an SBP log.

    Parameters
    ----------
    files : parts of one recording in the order of recording. Epochs that two files share are kept once; a
        message split between two files is whole again.
    chunk_bytes : bytes read at a time.

    Raises
    ------
    InputError : no files, a file that cannot be read or holds no SBP message, or all files are empty.
    """
    records = collect([Path(f) for f in files], chunk_bytes)
    # a number that no receiver should send is a finding in the report, not an error of arithmetic
    with np.errstate(over="ignore", invalid="ignore"):
        return _log_of(records)


def _log_of(records: SbpRecords) -> SbpLog:
    sender, others = _rover(records)
    track = build_track(records, sender or None)
    dropped = tables.Dropped()
    positions, kinds = tables.positions_table(records, track, sender, dropped)
    baselines = tables.baselines_table(records, track, sender)
    velocities = tables.velocities_table(records, track, sender)
    events = tables.events_table(records)
    base = tables.base_positions(records)
    offset_s, unix_s = measured_gps_minus_utc(records, track, sender or None)
    report = IntegrityReport(stream="gnss", format="SBP", files=[])
    obs_epochs = _observation_epochs(records)
    describe_log(report, records, track, positions, kinds, base, offset_s, unix_s, obs_epochs)
    for name, table in (
        ("positions", positions),
        ("baselines", baselines),
        ("velocities", velocities),
        ("events", events),
    ):
        report.count(name, len(table))
    impossible = dropped.counts.pop("positions_impossible_dropped", 0)
    if impossible:
        report.lose("positions_impossible", impossible)
    for name, n in dropped.counts.items():
        report.count(name, n)
    if others:
        report.note(
            f"Positions of sender {sender} are used; those of {', '.join(map(str, sorted(others)))} "
            f"({sum(others.values()):,} messages) are not."
        )
    return SbpLog(
        positions=positions,
        baselines=baselines,
        velocities=velocities,
        events=events,
        base_ecef_m=np.median(base, axis=0) if base.shape[0] else None,
        obs_epochs=obs_epochs,
        gps_minus_utc_s=_most_common(offset_s),
        message_counts=dict(sorted(records.counts.items())),
        report=report,
    )


def _rover(records: SbpRecords) -> tuple[int, dict[int, int]]:
    """The sender with most positions (else times, else observations; 0 if none), and the other ones."""
    for kinds in (tables.POSITION_KINDS, (sm.GPS_TIME, sm.GPS_TIME_DEP_A), (sm.OBS,)):
        found = records.senders(kinds)
        if found:
            best = max(sorted(found), key=lambda sender: found[sender])
            others = {s: n for s, n in found.items() if s != best}
            return best, others if kinds == tables.POSITION_KINDS else {}
    return 0, {}


def _observation_epochs(records: SbpRecords) -> dict[int, tuple[int, float, float]]:
    """Epochs of MsgObs by sender: number, first, last (adjusted GPS time); power-up epochs left out."""
    obs = records.of(sm.OBS)
    obs = obs.take(possible_week(obs))
    out = {}
    for sender in np.unique(obs.sender):
        f = obs.fields[obs.sender == sender]
        t = np.unique(gps_from_week(f["wn"], f["tow"] * 1e-3))
        out[int(sender)] = (int(t.size), float(t[0]), float(t[-1]))
    return out


def _most_common(values: ArrayF) -> float | None:
    if not values.size:
        return None
    found, counts = np.unique(values, return_counts=True)
    return float(found[np.argmax(counts)])
