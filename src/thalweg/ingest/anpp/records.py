"""Decoded ANPP packets by id, and the time of those that carry none.

A device sends the packets of one moment in the order of their ids, so a packet without time belongs to the
time packet before it. In the manufacturer's sample log the raw gyroscopes correlate by 0.93 to 0.97 with the
angular velocity of the state before them, and negatively with that of the state behind.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from thalweg.core.timescales import gps_from_unix
from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayI
from thalweg.ingest.anpp import packets as ap
from thalweg.ingest.anpp.frames import find_anpp
from thalweg.ingest.framing.stream import CHUNK_BYTES, PacketBlock, StreamTally, read_packets
from thalweg.ingest.stamps import possible_unix

CURE = "Give files as the device or its Manager program logs them (.anpp), not exported text"


@dataclass(frozen=True, slots=True, kw_only=True)
class Records:
    """Packets of one id: fields as a structured array, and (n,) number of the packet and byte in the log."""

    fields: AnyArray
    packet: ArrayI
    position: ArrayI

    def take(self, keep: ArrayB) -> "Records":
        """Some of the packets."""
        return Records(fields=self.fields[keep], packet=self.packet[keep], position=self.position[keep])


@dataclass(slots=True, kw_only=True)
class AnppRecords:
    """All decoded packets of a log."""

    tally: StreamTally = field(default_factory=StreamTally)
    by_id: dict[int, Records] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    wrong_size: dict[int, int] = field(default_factory=dict)
    passthrough: list[tuple[int, int, bytes]] = field(default_factory=list)
    """Packet number, route and bytes of each serial port passthrough packet."""
    satellites_31: list[int] = field(default_factory=list)
    """Satellites listed in each packet 31."""

    def of(self, packet_id: int) -> Records:
        """Packets of an id, maybe none."""
        return self.by_id.get(packet_id) or Records(
            fields=np.empty(0, dtype=ap.LAYOUTS[packet_id]),
            packet=np.empty(0, dtype=np.int64),
            position=np.empty(0, dtype=np.int64),
        )


def collect(files: Sequence[Path], chunk_bytes: int = CHUNK_BYTES) -> AnppRecords:
    """Read all packets of a log that are of interest.

    Raises
    ------
    InputError : no files, a file that cannot be read, is no ANPP log, or all files are empty.
    """
    out = AnppRecords()
    parts: dict[int, list[Records]] = {}
    for block in read_packets(
        files, find_anpp, out.tally, what="ANPP packet", cure=CURE, chunk_bytes=chunk_bytes
    ):
        counts = np.bincount(block.kind, minlength=256)
        for packet_id in np.flatnonzero(counts):
            key = int(packet_id)
            out.counts[key] = out.counts.get(key, 0) + int(counts[key])
            _decode(block, key, out, parts)
    for key, pieces in parts.items():
        out.by_id[key] = Records(
            fields=np.concatenate([p.fields for p in pieces]),
            packet=np.concatenate([p.packet for p in pieces]),
            position=np.concatenate([p.position for p in pieces]),
        )
    out.counts = dict(sorted(out.counts.items()))
    return out


def _decode(block: PacketBlock, key: int, out: AnppRecords, parts: dict[int, list[Records]]) -> None:
    rows = np.flatnonzero(block.kind == key)
    if key == ap.PASSTHROUGH:
        for row in rows[block.length[rows] > 1]:
            start, size = int(block.offset[row]), int(block.length[row])
            data = block.buf[start : start + size].tobytes()
            out.passthrough.append((block.first + int(row), data[0], data[1:]))
    elif key == 31:
        out.satellites_31 += (block.length[rows] // 7).tolist()
    layout = ap.LAYOUTS.get(key)
    if layout is None:
        return
    size = layout.itemsize
    good = block.length[rows] >= size if key in ap.VARIABLE else block.length[rows] == size
    if not good.all():
        out.wrong_size[key] = out.wrong_size.get(key, 0) + int((~good).sum())
        rows = rows[good]
    if rows.size:
        parts.setdefault(key, []).append(
            Records(
                fields=block.payloads(rows, size).view(layout)[:, 0],
                packet=block.first + rows,
                position=block.position[rows],
            )
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Clock:
    """The log's own time axis: one entry a time packet (20, 21 or 22), in the order of the log.

    Attributes
    ----------
    packet : (n,) number of the packet.
    unix_s, us : (n,) whole seconds and microseconds of the device's clock.
    utc : (n,) true once the filter status says that UTC is initialised, and the date can be.
    """

    packet: ArrayI
    unix_s: ArrayF
    us: ArrayF
    utc: ArrayB
    n_impossible: int

    @property
    def t_device_s(self) -> ArrayF:
        """Device clock as Unix time, seconds."""
        return np.asarray(self.unix_s + self.us * 1e-6)

    @property
    def t_gps_s(self) -> ArrayF:
        """Adjusted GPS time, NaN before UTC was initialised."""
        return gps_time(self.unix_s, self.us, self.utc)

    def before(self, packet: ArrayI) -> ArrayI:
        """Index of the time packet before each packet (or that packet itself); -1 where there is none."""
        return np.searchsorted(self.packet, packet, side="right").astype(np.int64) - 1


def gps_time(unix_s: AnyArray, us: AnyArray, valid: ArrayB) -> ArrayF:
    """Adjusted GPS time of UTC stamps, NaN where not valid."""
    out = np.full(unix_s.size, np.nan)
    out[valid] = gps_from_unix(unix_s[valid].astype(np.float64), us[valid])
    return out


def possible_utc(unix_s: AnyArray, us: AnyArray) -> ArrayB:
    """False where no survey can have been made, or where a stamp has more than a second of microseconds."""
    return possible_unix(unix_s) & (us < 1_000_000)


def build_clock(records: AnppRecords) -> Clock:
    """Time axis out of packets 20, 21 and 22; 21 and 22 take the UTC bit from the status before them."""
    state, unix = records.of(ap.STATE), records.of(ap.UNIX_TIME)
    formatted, status = records.of(ap.FORMATTED_TIME), records.of(ap.STATUS)
    calendar_s, calendar_ok = _calendar(formatted.fields)
    packet = np.concatenate([state.packet, unix.packet, formatted.packet])
    unix_s = np.concatenate([state.fields["unix_s"], unix.fields["unix_s"], calendar_s]).astype(np.float64)
    us = np.concatenate([state.fields["us"], unix.fields["us"], formatted.fields["us"]]).astype(np.float64)
    readable = np.concatenate([np.ones(state.packet.size + unix.packet.size, dtype=np.bool_), calendar_ok])
    readable &= us < 1_000_000
    utc_packet = np.concatenate([state.packet, status.packet])
    utc_bit = np.concatenate([state.fields["filter"], status.fields["filter"]]) & ap.FILTER_UTC != 0
    order = np.argsort(utc_packet, kind="stable")
    utc_packet, utc_bit = utc_packet[order], utc_bit[order]
    if utc_packet.size:
        last = np.searchsorted(utc_packet, packet, side="right") - 1
        utc = utc_bit[np.maximum(last, 0)]
    else:
        utc = np.zeros(packet.size, dtype=np.bool_)
    impossible = (utc & ~possible_utc(unix_s, us)) | ~readable
    order = np.argsort(packet, kind="stable")
    order = order[readable[order]]
    return Clock(
        packet=packet[order],
        unix_s=unix_s[order],
        us=us[order],
        utc=(utc & ~impossible)[order],
        n_impossible=int(impossible.sum()),
    )


def _calendar(fields: AnyArray) -> tuple[ArrayF, ArrayB]:
    """Unix time of packet 22, whose month (not its day) counts from 0, and whether the date exists."""
    ok = (
        (fields["month"] < 12)
        & (fields["day"] >= 1)
        & (fields["day"] <= 31)
        & (fields["year"] >= 1970)
        & (fields["year"] < 2107)
    )
    ok &= (fields["hour"] < 24) & (fields["minute"] < 60) & (fields["second"] < 61)
    months = np.where(ok, (fields["year"].astype(np.int64) - 1970) * 12 + fields["month"], 0)
    days = months.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64)
    seconds = (fields["hour"].astype(np.int64) * 60 + fields["minute"]) * 60 + fields["second"]
    return ((days + fields["day"] - 1) * 86_400 + seconds).astype(np.float64), np.asarray(ok)
