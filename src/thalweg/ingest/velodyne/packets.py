"""The stream of Velodyne packets of one or several files: order, duplicates, holes, position packets.

Packets are put on a device time that does not turn over at the hour. What arrives late, twice or with an
impossible stamp is told apart from an hour rollover by its distance from the newest packet.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from thalweg.core import AnyArray, ArrayB, ArrayI, ArrayU8, njit
from thalweg.ingest import LidarOptions
from thalweg.ingest.pcap import CHUNK_BYTES, BarePayloads, CaptureTally, PayloadBlock, Stream, read_payloads
from thalweg.ingest.velodyne.model import (
    BLOCK_FLAG,
    BLOCK_SIZE,
    BLOCKS,
    DATA_SIZE,
    POSITION_SIZE,
    STRONGEST,
    Model,
)

NORMAL: Final = 0
UNUSABLE: Final = 1
"""No block flag, unknown return mode, other model, or a stamp beyond the hour: dropped."""
DUPLICATE: Final = 2
"""Seen before: dropped."""
BAD_STAMP: Final = 3
"""A stamp more than a second off, after which the stream goes on as before it: dropped."""
LATE: Final = 4
"""Older than the newest packet: kept, its own stamp is right."""
GAP: Final = 5
"""Packets are missing before this one."""
STEP_BACK: Final = 6
"""The device clock was set back: this packet and all behind it are older than the newest one."""

GAP_STEPS: Final = 1.5
"""A longer step, in packet intervals, is a hole."""

_LOOK_AHEAD: Final = 32
_MEMORY: Final = 1 << 20
"""Packets within which a duplicate is recognised: 23 minutes of single, 11 of dual return."""
_SECOND_US: Final = 1_000_000
_BARE: Final = BarePayloads(marks=tuple(BLOCK_SIZE * i for i in range(BLOCKS)), mark=BLOCK_FLAG)
_NEWEST, _STEP, _COUNT, _START, _HINT = range(5)


@dataclass(frozen=True, slots=True, kw_only=True)
class PositionPacket:
    """A position (telemetry) packet.

    Attributes
    ----------
    after_packet : number of data packets before it.
    toh_us : microseconds past the hour, same counter as the data packets.
    pps : 0 absent, 1 synchronising, 2 locked, 3 error.
    sentence : NMEA text as received, without trailing NUL and line end.
    """

    after_packet: int
    toh_us: int
    pps: int
    sentence: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class PacketBlock:
    """Data packets in stream order, with the position packets among them.

    Attributes
    ----------
    payload : (n, 1206) bytes.
    first_packet : index of the first row, counted over all files and all packets, dropped ones included.
    t_us : (n,) unrolled device time of the first firing, microseconds past the hour of the first packet.
    event : (n,) `NORMAL` .. `STEP_BACK`.
    jump_us : (n,) distance from the newest packet before, 0 where it is unknown.
    sender, t_host_s : as in `PayloadBlock`.
    positions : position packets among and right behind these packets, ordered.
    """

    payload: ArrayU8
    first_packet: int
    t_us: ArrayI
    event: ArrayU8
    jump_us: ArrayI
    sender: ArrayI
    t_host_s: AnyArray
    positions: tuple[PositionPacket, ...]

    @property
    def keep(self) -> ArrayB:
        """Packets that are not dropped."""
        return (self.event == NORMAL) | (self.event >= LATE)


@dataclass(slots=True)
class StreamTally:
    """Findings about the files of a packet stream."""

    capture: CaptureTally = field(default_factory=CaptureTally)
    formats: list[str] = field(default_factory=list)
    file_starts: list[int] = field(default_factory=list)
    """Index of the first data packet of each file."""


@njit(cache=True, nogil=True)
def _headers(
    payload: ArrayU8,
    product: int,
    single_us: float,
    toh_us: ArrayI,
    valid: ArrayB,
    step_us: AnyArray,
    mark: ArrayI,
) -> None:
    """Stamp, usability, expected interval to the next packet, and a signature that duplicates share."""
    for i in range(payload.shape[0]):
        row = payload[i]
        toh = (
            np.int64(row[1200])
            | np.int64(row[1201]) << 8
            | np.int64(row[1202]) << 16
            | np.int64(row[1203]) << 24
        )
        mode = row[1204]
        flags = 0
        h = np.int64(mode)
        for b in range(12):
            q = 100 * b
            flags += row[q] == 0xFF and row[q + 1] == 0xEE
            j = q + 4 + 3 * ((5 * b) % 32)
            word = np.int64(row[q + 2]) | np.int64(row[q + 3]) << 8
            word |= np.int64(row[j]) << 16 | np.int64(row[j + 1]) << 24 | np.int64(row[j + 2]) << 32
            h = (h ^ word) * np.int64(1099511628211)
        toh_us[i] = toh
        mark[i] = h
        step_us[i] = 0.5 * single_us if mode == 0x39 else single_us
        known = mode == 0x37 or mode == 0x38 or mode == 0x39
        valid[i] = flags > 0 and known and toh < 3_600_000_000 and (product < 0 or row[1205] == product)


@njit(cache=True, nogil=True, inline="always")
def _wrap(d_us: int) -> int:
    """A difference of stamps, modulo the hour, in [-30 min, 30 min)."""
    return (d_us + 1_800_000_000) % 3_600_000_000 - 1_800_000_000


@njit(cache=True, nogil=True)
def _seen(t: int, mark: int, state: ArrayI, old_t: ArrayI, old_mark: ArrayI) -> int:
    """Number of the remembered packet with this time and signature, else -1."""
    count, size = state[_COUNT], old_t.size
    low = max(state[_START], count - size)
    guess = state[_HINT] + 1
    if low <= guess < count and old_t[guess % size] == t and old_mark[guess % size] == mark:
        return guess
    a, b = low, count
    while a < b:
        m = (a + b) // 2
        if old_t[m % size] < t:
            a = m + 1
        else:
            b = m
    # Late packets leave the memory sorted only nearly.
    for i in range(max(low, a - 64), min(count, a + 64)):
        if old_t[i % size] == t and old_mark[i % size] == mark:
            return i
    return -1


@njit(cache=True, nogil=True, inline="always")
def _set_back(
    i: int, toh_us: ArrayI, valid: ArrayB, mark: ArrayI, state: ArrayI, old_t: ArrayI, old_mark: ArrayI
) -> bool:
    """True if packets from ``i`` on stay behind the newest one and none of them was seen before."""
    newest, checked = state[_NEWEST], 0
    for j in range(i + 1, min(toh_us.size, i + 1 + _LOOK_AHEAD)):
        if valid[j]:
            d = _wrap(toh_us[j] - newest)
            if d > 0 or _seen(newest + d, mark[j], state, old_t, old_mark) >= 0:
                return False
            checked += 1
    return checked >= _LOOK_AHEAD // 2


@njit(cache=True, nogil=True, inline="always")
def _next_valid(i: int, valid: ArrayB) -> int:
    j = i + 1
    while j < valid.size and not valid[j]:
        j += 1
    return j


@njit(cache=True, nogil=True)
def _sequence(
    n: int,
    toh_us: ArrayI,
    valid: ArrayB,
    step_us: AnyArray,
    mark: ArrayI,
    state: ArrayI,
    old_t: ArrayI,
    old_mark: ArrayI,
    t_us: ArrayI,
    event: ArrayU8,
    jump_us: ArrayI,
) -> None:
    """Unroll and judge the first ``n`` packets; the rows behind them only serve to look ahead."""
    for i in range(n):
        newest = state[_NEWEST]
        t_us[i] = newest
        jump_us[i] = 0
        if not valid[i]:
            event[i] = UNUSABLE
            continue
        event[i] = NORMAL
        j = _next_valid(i, valid)
        if state[_COUNT] == 0:
            k = _next_valid(j, valid)
            if k < valid.size:
                jump, on = _wrap(toh_us[j] - toh_us[i]), _wrap(toh_us[k] - toh_us[j])
                if abs(jump) > _SECOND_US and abs(on) <= _SECOND_US:
                    event[i] = BAD_STAMP
                    continue
            t = toh_us[i]
        else:
            d = _wrap(toh_us[i] - newest)
            t = newest + d
            jump_us[i] = d
            if d <= 0:
                found = _seen(t, mark[i], state, old_t, old_mark)
                if found >= 0:
                    state[_HINT] = found
                    event[i] = DUPLICATE
                    t_us[i] = t
                    continue
            if abs(d) > _SECOND_US and j < valid.size and 0 < _wrap(toh_us[j] - newest) <= _SECOND_US:
                event[i] = BAD_STAMP
                continue
            if d <= 0:
                event[i] = LATE
                if _set_back(i, toh_us, valid, mark, state, old_t, old_mark):
                    event[i] = STEP_BACK
                    state[_START] = state[_COUNT]
            elif d > GAP_STEPS * state[_STEP] * 1e-3:
                event[i] = GAP
        t_us[i] = t
        slot = state[_COUNT] % old_t.size
        old_t[slot] = t
        old_mark[slot] = mark[i]
        state[_COUNT] += 1
        if event[i] != LATE:
            state[_NEWEST] = t
            state[_STEP] = np.int64(1000.0 * step_us[i])


class _Sequencer:
    """Judges one piece of the stream when the head of the next one is known."""

    def __init__(self, model: Model, any_product: bool) -> None:
        self.product = -1 if any_product else model.product
        self.single_us = 1e6 * model.packet_s(STRONGEST)
        self.state = np.array([0, 0, 0, 0, -2], dtype=np.int64)
        self.old_t = np.empty(_MEMORY, dtype=np.int64)
        self.old_mark = np.empty(_MEMORY, dtype=np.int64)

    def headers(self, payload: ArrayU8) -> tuple[ArrayI, ArrayB, AnyArray, ArrayI]:
        """Stamp, usability, expected step and signature of each packet, see `_headers`."""
        n = payload.shape[0]
        out = np.empty(n, np.int64), np.empty(n, np.bool_), np.empty(n), np.empty(n, np.int64)
        _headers(payload, self.product, self.single_us, *out)
        return out

    def judge(self, payload: ArrayU8, ahead: Sequence[ArrayU8]) -> tuple[ArrayI, ArrayU8, ArrayI]:
        """Unrolled time, event and jump of the clock at each packet, knowing the packets ``ahead``."""
        n = payload.shape[0]
        heads = self.headers(payload)
        for rows in ahead:
            more = self.headers(rows)
            heads = tuple(np.concatenate(pair) for pair in zip(heads, more, strict=True))  # type: ignore[assignment]
        out = np.empty(n, np.int64), np.empty(n, np.uint8), np.empty(n, np.int64)
        _sequence(n, *heads, self.state, self.old_t, self.old_mark, *out)
        return out


def _positions(
    block: PayloadBlock, own: ArrayB, data: PayloadBlock, first_packet: int
) -> list[PositionPacket]:
    after = first_packet + np.searchsorted(data.record, block.record[own])
    payload = block.payload[own]
    toh = payload[:, 198:202].copy().view("<u4").ravel()
    return [
        PositionPacket(
            after_packet=int(a),
            toh_us=int(t),
            pps=int(row[202]),
            sentence=row[206:].tobytes().split(b"\0", 1)[0].rstrip(b"\r\n "),
        )
        for a, t, row in zip(after, toh, payload, strict=True)
    ]


def read_packets(
    files: Sequence[Path],
    options: LidarOptions,
    model: Model,
    *,
    tally: StreamTally | None = None,
    chunk_bytes: int = CHUNK_BYTES,
) -> Iterator[PacketBlock]:
    """Data and position packets of the files, in stream order.

    The same files give the same packet indices, times and events each time they are read.

    Parameters
    ----------
    files : parts of one recording, in the order of recording.
    options : UDP ports; ``model``: any but ``auto`` takes packets whatever model they name.
    model : of the scanner.
    tally : takes the findings about the files.

    Raises
    ------
    InputError, UnsupportedError : as `read_payloads`.
    """
    found = StreamTally() if tally is None else tally
    streams = (
        Stream(port=options.data_port, size=DATA_SIZE),
        Stream(port=options.position_port, size=POSITION_SIZE),
    )
    sequencer = _Sequencer(model, any_product=options.model.lower() != "auto")
    waiting: deque[tuple[PayloadBlock, int]] = deque()
    positions: deque[PositionPacket] = deque()
    senders: set[int] = set()
    n_data = 0
    for path in files:
        found.file_starts.append(n_data)
        for data, position in read_payloads(
            path, streams, bare=_BARE, tally=found.capture, chunk_bytes=chunk_bytes
        ):
            if data.record.size:
                waiting.append((data, n_data))
            senders.update(np.unique(data.sender).tolist())
            # all lidars of a network send these to one port, whatever the port of their data
            own = np.isin(position.sender, list(senders)) | (not senders)
            if other := int(np.count_nonzero(~own)):
                found.capture.counts["position_packets_of_other_senders"] += other
            positions.extend(_positions(position, own, data, n_data))
            n_data += data.record.size
            while waiting and n_data - waiting[0][1] - waiting[0][0].record.size >= 2 * _LOOK_AHEAD:
                yield _next_block(waiting, positions, sequencer)
        found.formats.append(found.capture.format)
    while waiting:
        yield _next_block(waiting, positions, sequencer)


def first_product(files: Sequence[Path], data_port: int, chunk_bytes: int = CHUNK_BYTES) -> int | None:
    """Most frequent product byte of the first data packets; None if there are none."""
    streams = (Stream(port=data_port, size=DATA_SIZE),)
    for path in files:
        for (data,) in read_payloads(
            path, streams, bare=_BARE, tally=CaptureTally(), chunk_bytes=chunk_bytes
        ):
            if data.record.size:
                return int(np.bincount(data.payload[:, 1205]).argmax())
    return None


def _next_block(
    waiting: "deque[tuple[PayloadBlock, int]]", positions: "deque[PositionPacket]", sequencer: _Sequencer
) -> PacketBlock:
    """Judge the first waiting piece by the heads of those behind it."""
    data, first_packet = waiting.popleft()
    heads: list[ArrayU8] = []
    for behind, _ in waiting:
        heads.append(behind.payload[: 2 * _LOOK_AHEAD])
        if sum(len(head) for head in heads) >= 2 * _LOOK_AHEAD:
            break
    t_us, event, jump_us = sequencer.judge(data.payload, heads)
    mine: list[PositionPacket] = []
    while positions and (not waiting or positions[0].after_packet <= waiting[0][1]):
        mine.append(positions.popleft())
    return PacketBlock(
        payload=data.payload,
        first_packet=first_packet,
        t_us=t_us,
        event=event,
        jump_us=jump_us,
        sender=data.sender,
        t_host_s=data.t_host_s,
        positions=tuple(mine),
    )
