"""The ANPP reader: logs of Advanced Navigation's INS as tables and an integrity report.

Times are UTC once the device says so (bit 3 of the filter status). Before, they are the device's own
clock: ``t_gps_s`` is NaN and ``t_device_s`` is kept. Packets without time take that of the time packet
before them. States refer to the configured reference point, raw GNSS positions to the antenna.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from thalweg.ingest.anpp import packets as ap
from thalweg.ingest.anpp import tables
from thalweg.ingest.anpp.overlap import drop_repeated
from thalweg.ingest.anpp.records import AnppRecords, build_clock, collect
from thalweg.ingest.anpp.report import describe_log
from thalweg.ingest.anpp.text import passthrough_table
from thalweg.ingest.framing.stream import CHUNK_BYTES
from thalweg.ingest.integrity import IntegrityReport

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
    states = tables.states_table(records)
    describe_log(report, records, clock, states)
    records.tally.write(report, "packet")
    with_sigma = tables.add_orientation_sigmas(states, records, clock)
    raw, raw_counts = tables.raw_table(records, clock)
    gnss, no_fix, impossible_gnss = tables.gnss_table(records, clock)
    depth, no_depth = tables.depth_table(records, clock)
    heave = tables.heave_table(records, clock)
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
        "states_with_impossible_position": tables.blank_impossible(states),
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
