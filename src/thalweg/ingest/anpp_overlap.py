"""Packets that occur in two files of one recording."""

import numpy as np

from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.ingest import anpp_packets as ap
from thalweg.ingest.anpp_records import AnppRecords, Clock, Records, build_clock


def drop_repeated(records: AnppRecords) -> int:
    """Drop packets of a later file that an earlier file holds already; returns how many.

    A packet is repeated if its bytes and the device time of the time packet before it are the same.
    """
    if len(records.tally.files) < 2:
        return 0
    clock = build_clock(records)
    dropped = 0
    for packet_id, found in list(records.by_id.items()):
        if packet_id in (ap.DEVICE, ap.GNSS_RECEIVER):
            continue
        file = records.tally.file_of(found.position)
        again = _repeated(found, file, _time_of(found.packet, clock))
        if again.any():
            records.by_id[packet_id] = found.take(~again)
            dropped += int(again.sum())
    return dropped


def _time_of(packet: ArrayI, clock: Clock) -> ArrayF:
    index = clock.before(packet)
    t = np.full(packet.size, -1.0)
    t[index >= 0] = clock.t_device_s[index[index >= 0]]
    return t


def _repeated(found: Records, file: ArrayI, t: ArrayF) -> ArrayB:
    """True where an earlier file holds the same bytes at the same time."""
    again = np.zeros(t.size, dtype=np.bool_)
    for number in np.unique(file)[1:]:
        new = np.flatnonzero(file == number)
        old = np.flatnonzero((file < number) & (t >= t[new].min()) & (t <= t[new].max()))
        if not old.size:
            continue
        seen = {(t[i], found.fields[i].tobytes()) for i in old}
        again[new] = [(t[i], found.fields[i].tobytes()) in seen for i in new]
    return again
