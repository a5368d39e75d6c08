"""Packets that occur in two files of one recording."""

import numpy as np

from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.ingest.anpp import packets as ap
from thalweg.ingest.anpp.records import AnppRecords, Clock, Records, build_clock


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
