"""Decoded SBP messages by type."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from thalweg.core.types import AnyArray, ArrayB, ArrayI
from thalweg.ingest.framing.stream import CHUNK_BYTES, PacketBlock, StreamTally, read_packets
from thalweg.ingest.sbp import messages as sm
from thalweg.ingest.sbp.frames import find_sbp

CURE = "Give files as the receiver logs them (.sbp, .bin), not the JSON of Swift Console"


@dataclass(frozen=True, slots=True, kw_only=True)
class Messages:
    """Messages of one type.

    Attributes
    ----------
    fields : (n,) structured array.
    number : (n,) number of the message in the log, from 0.
    sender : (n,) who sent it; 0 relays the base.
    size : (n,) bytes of the payload.
    """

    fields: AnyArray
    number: ArrayI
    sender: ArrayI
    size: ArrayI

    def take(self, keep: ArrayB) -> "Messages":
        """Some of the messages."""
        return Messages(
            fields=self.fields[keep],
            number=self.number[keep],
            sender=self.sender[keep],
            size=self.size[keep],
        )


@dataclass(slots=True, kw_only=True)
class SbpRecords:
    """All decoded messages of a log, and how many of which type and sender there were."""

    tally: StreamTally = field(default_factory=StreamTally)
    by_type: dict[int, Messages] = field(default_factory=dict)
    counts: dict[tuple[int, int], int] = field(default_factory=dict)
    wrong_size: dict[int, int] = field(default_factory=dict)
    signals: dict[tuple[int, int], int] = field(default_factory=dict)
    """Observed signals by (sender, code)."""

    def of(self, kind: int, sender: int | None = None) -> Messages:
        """Messages of a type (of one sender), maybe none."""
        none = np.empty(0, dtype=np.int64)
        found = self.by_type.get(kind) or Messages(
            fields=np.empty(0, dtype=sm.LAYOUTS[kind]), number=none, sender=none, size=none
        )
        return found if sender is None else found.take(found.sender == sender)

    def senders(self, kinds: Iterable[int]) -> dict[int, int]:
        """Senders of some types other than 0, and how many messages each sent."""
        wanted = set(kinds)
        out: dict[int, int] = {}
        for (kind, sender), n in self.counts.items():
            if kind in wanted and sender:
                out[sender] = out.get(sender, 0) + n
        return out


def collect(files: Sequence[Path], chunk_bytes: int = CHUNK_BYTES) -> SbpRecords:
    """Read all messages of a log that are of interest.

    Raises
    ------
    InputError : no files, a file that cannot be read, is no SBP log, or all files are empty.
    """
    out = SbpRecords()
    parts: dict[int, list[Messages]] = {}
    for block in read_packets(
        files, find_sbp, out.tally, what="SBP message", cure=CURE, chunk_bytes=chunk_bytes
    ):
        both = block.kind.astype(np.int64) << 16 | block.sender
        for value, n in zip(*np.unique(both, return_counts=True), strict=True):
            key = (int(value) >> 16, int(value) & 0xFFFF)
            out.counts[key] = out.counts.get(key, 0) + int(n)
        for kind in sm.LAYOUTS:
            _decode(block, kind, out, parts)
    for kind, pieces in parts.items():
        out.by_type[kind] = Messages(
            fields=np.concatenate([p.fields for p in pieces]),
            number=np.concatenate([p.number for p in pieces]),
            sender=np.concatenate([p.sender for p in pieces]),
            size=np.concatenate([p.size for p in pieces]),
        )
    return out


def _decode(block: PacketBlock, kind: int, out: SbpRecords, parts: dict[int, list[Messages]]) -> None:
    rows = np.flatnonzero(block.kind == kind)
    if not rows.size:
        return
    size = sm.LAYOUTS[kind].itemsize
    if kind == sm.OBS:
        body = block.length[rows] - size
        good = (body >= 0) & (body % sm.OBS_SIGNAL_BYTES == 0)
    else:
        good = block.length[rows] == size
    if not good.all():
        out.wrong_size[kind] = out.wrong_size.get(kind, 0) + int((~good).sum())
        rows = rows[good]
    if not rows.size:
        return
    if kind == sm.OBS:
        _count_signals(block, rows, out)
    parts.setdefault(kind, []).append(
        Messages(
            fields=block.payloads(rows, size).view(sm.LAYOUTS[kind])[:, 0],
            number=block.first + rows,
            sender=block.sender[rows].astype(np.int64),
            size=block.length[rows],
        )
    )


def _count_signals(block: PacketBlock, rows: ArrayI, out: SbpRecords) -> None:
    head = sm.LAYOUTS[sm.OBS].itemsize
    n = (block.length[rows] - head) // sm.OBS_SIGNAL_BYTES
    message = np.repeat(rows, n)
    inside = np.arange(message.size) - np.repeat(np.cumsum(n) - n, n)
    last_byte = block.offset[message] + head + (inside + 1) * sm.OBS_SIGNAL_BYTES - 1
    both = block.sender[message].astype(np.int64) << 8 | block.buf[last_byte]
    for value, count in zip(*np.unique(both, return_counts=True), strict=True):
        key = (int(value) >> 8, int(value) & 0xFF)
        out.signals[key] = out.signals.get(key, 0) + int(count)
