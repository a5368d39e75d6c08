"""GPS time of Velodyne packets: hour from NMEA RMC, minutes and seconds from the packets themselves.

The sensor stamps packets with microseconds past the hour (TOH). With a PPS signal and RMC sentences it
sets this counter to UTC; without them it runs freely. RMC lags by up to about a second, so it only names
the hour: the one that brings TOH within half an hour of it. The host clock is never used.

Source: VLP-16 User Manual 63-9243 Rev. D, sections 7.4 (GPS), 9.3.1.6 and 9.3.3; HDL-32E and VLP-32C alike.
"""

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from thalweg.core import gps_from_unix, unix_from_gps, utc_text_from_gps
from thalweg.ingest import LidarClock, explain_shift
from thalweg.ingest.nmea import days_of_date, second_of_day
from thalweg.ingest.velodyne.model import HOUR_US
from thalweg.ingest.velodyne.packets import GAP, STEP_BACK, PacketBlock, PositionPacket

PPS_STATES: Final = ("absent", "synchronising", "locked", "error")
LOCKED: Final = 2

MAX_LAG_S: Final = 2.5
"""RMC may be older than TOH by its own interval and its transmission, about 1.1 s in real logs."""
HEAD_S: Final = 5.0
"""Packets this long before the first position packet of a recording share its PPS state."""
BREAK_S: Final = 10.0
"""After a hole this long the PPS state counts as unknown until it is reported again."""
SET_S: Final = 1.0
"""A longer jump of the free-running clock, up to `HEAD_S` before it locks, is the clock being set."""
_WRONG_S: Final = 10.0
"""Clocks of computers that follow no time server are some seconds off."""
_WEEK_S: Final = 7 * 86_400
_HOUR_S: Final = 3600


def parse_rmc(sentence: bytes) -> tuple[float, str]:
    """UTC of an RMC sentence as Unix time, and why it has none.

    Returns
    -------
    Unix time and ``""``; or NaN and one of ``"empty"``, ``"not RMC"``, ``"bad checksum"``, ``"no fix"``
    (status V), ``"no date"``.

    Examples
    --------
    >>> parse_rmc(b"$GPRMC,081802.00,A,3649.7478558,N,00224.4542928,W,0.034,212.5,210116,0.0,E,A*2E")
    (1453364282.0, '')
    """
    if not sentence:
        return math.nan, "empty"
    body, star, check = sentence.partition(b"*")
    total = 0
    for byte in body[1:]:
        total ^= byte
    if not star or check[:2].upper() != b"%02X" % total:
        return math.nan, "bad checksum"
    fields = body.decode("ascii", "replace").split(",")
    if len(fields) < 10 or not fields[0].startswith("$") or fields[0][3:] != "RMC":
        return math.nan, "not RMC"
    if fields[2] != "A":
        return math.nan, "no fix"
    clock, date = fields[1], fields[9]
    if len(date) != 6:
        return math.nan, "no date"
    try:
        days = days_of_date(int(date[:2]), int(date[2:4]), int(date[4:]))
        return float(86_400 * days + second_of_day(clock)), ""
    except ValueError:
        return math.nan, "no date"


def clocks_apart(host_minus_sensor_s: float, t_gps_s: float) -> str:
    """A sentence where the capture's clock and the sentences differ by no clock error; else empty.

    Parameters
    ----------
    host_minus_sensor_s : clock of the capturing computer minus UTC by RMC and packets.
    t_gps_s : a time of the sensor, whose date is named.
    """
    words = explain_shift(host_minus_sensor_s)
    if not words or abs(host_minus_sensor_s) < _WRONG_S:
        return ""
    sensor, host = (utc_text_from_gps(t_gps_s + shift, 0) for shift in (0.0, host_minus_sensor_s))
    sentence = f"NMEA says {sensor}, the clock of the capture {host}: {words}"
    weeks = 1024 * round(host_minus_sensor_s / (1024 * _WEEK_S))
    if not weeks:
        return f"{sentence}. Times follow NMEA."
    # UTC is what the receiver got right but for its date: the leap seconds since then count, too
    true_s = float(gps_from_unix(unix_from_gps(t_gps_s) + weeks * _WEEK_S))
    return (
        f"{sentence}. The true date is probably {host[:10]}: set lidar.clock.offset_s to "
        f"{true_s - t_gps_s:.0f} (with the leap seconds since then), and update the firmware of the receiver."
    )


@dataclass(slots=True)
class _Stretch:
    first: int
    before_us: int
    """Unrolled stamp of the packet before the first one."""
    t_us: int
    extra_s: float
    offset_s: float
    why: str


@dataclass(slots=True)
class ClockBuilder:
    """Builds a `LidarClock` while the packets stream by.

    ``counts`` holds position packets by PPS state and by what was wrong with their sentence.
    """

    counts: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)
    stretches: list[_Stretch] = field(default_factory=list)
    file_starts: list[int] = field(default_factory=list)
    extra_s: float = 0.0
    known_offset_s: float = math.nan
    unconfirmed_from: int = 0
    """Packets from here on had no report of the PPS state yet, -1 if there was one."""
    unconfirmed_t_us: int = 0
    unconfirmed_before_us: int = 0
    last_locked_packet: int = 0
    last_sentence: bytes = b""
    last_report_t_us: int | None = None
    holes_s: float = 0.0
    """Holes in the data since the last report."""
    longest_silence_s: float = 0.0
    worst_lag_s: float = 0.0
    newest_us: int | None = None
    free_jumps: dict[int, int] = field(default_factory=dict)
    """Packets behind a jump of the free-running clock, and their stamps."""
    pending_s: float = math.nan
    """GPS time minus unrolled stamp from the next jump on, told by a position packet ahead of the data."""
    clock_set: set[int] = field(default_factory=set)
    """Packets before which the sensor set its clock on locking."""
    sentences: list[tuple[float, float]] = field(default_factory=list)
    """Device time and GPS time of fresh sentences without PPS."""
    jumps: list[tuple[int, float]] = field(default_factory=list)
    """Packets behind a hole since the last locked report, with its length in seconds."""

    def feed(self, block: PacketBlock) -> None:
        """Take in the next block of the stream."""
        if not self.stretches:
            self.unconfirmed_t_us = self.unconfirmed_before_us = int(block.t_us[0])
            self._push(block, 0, math.nan, "no position packet yet")
        marked = np.flatnonzero((block.event == GAP) | (block.event == STEP_BACK))
        queue = [(block.first_packet + int(i), float(block.jump_us[i]) * 1e-6) for i in marked]
        for position in block.positions:
            while queue and queue[0][0] < position.after_packet:
                self._hole(block, *queue.pop(0))
            self._report(block, position)
        for hole in queue:
            self._hole(block, *hole)
        self.newest_us = int(block.t_us[-1])

    def _t_us(self, block: PacketBlock, packet: int) -> int:
        """Unrolled stamp of a packet, of the nearest one of the block if it lies outside."""
        if packet == self.unconfirmed_from:
            return self.unconfirmed_t_us
        return int(block.t_us[min(max(packet - block.first_packet, 0), block.t_us.size - 1)])

    def _before_us(self, block: PacketBlock, packet: int) -> int:
        """Unrolled stamp of the packet before ``packet``."""
        if packet == self.unconfirmed_from:
            return self.unconfirmed_before_us
        if packet <= block.first_packet and self.newest_us is not None:
            return self.newest_us
        return self._t_us(block, packet - 1)

    def _push(self, block: PacketBlock, first: int, offset_s: float, why: str) -> None:
        before_us, t_us = self._before_us(block, first), self._t_us(block, first)
        while self.stretches and self.stretches[-1].first >= first:
            self.stretches.pop()
        self.stretches.append(_Stretch(first, before_us, t_us, self.extra_s, offset_s, why))

    def _hole(self, block: PacketBlock, packet: int, jump_s: float) -> None:
        if not math.isnan(self.pending_s) and abs(jump_s) > SET_S:
            self.holes_s += jump_s
            self.clock_set.add(packet)
            self._lock(block, packet, self.pending_s)
            return
        self.jumps.append((packet, jump_s))
        self.holes_s += jump_s
        locked = not math.isnan(self.stretches[-1].offset_s)
        if not locked and self.unconfirmed_from < 0 and (jump_s > SET_S or jump_s < 0):
            self.free_jumps[packet] = self._t_us(block, packet)
        if (jump_s > BREAK_S or jump_s < 0) and (locked or self.unconfirmed_from >= 0):
            self.unconfirmed_from = packet
            self.unconfirmed_t_us = int(block.t_us[packet - block.first_packet])
            self.unconfirmed_before_us = self.unconfirmed_t_us - round(jump_s * 1e6)
            if locked:
                self._push(block, packet, math.nan, "PPS state unknown after a hole")

    def silence_s(self, now_us: int) -> float:
        """Longest time that had data but no report, up to now."""
        if self.last_report_t_us is None:
            return 0.0
        return max(self.longest_silence_s, (now_us - self.last_report_t_us) * 1e-6 - self.holes_s)

    def _report(self, block: PacketBlock, position: PositionPacket) -> None:
        self.counts["position_packets"] += 1
        if position.pps >= len(PPS_STATES) or position.toh_us >= HOUR_US:
            self.counts["position_packets_damaged"] += 1
            return
        self.counts[f"pps_{PPS_STATES[position.pps]}"] += 1
        if position.after_packet == block.first_packet and self.newest_us is not None:
            reference = self.newest_us
        else:
            reference = self._t_us(block, position.after_packet - 1)
        half = HOUR_US // 2
        now_us = reference + (position.toh_us - reference + half) % HOUR_US - half
        self.longest_silence_s = self.silence_s(reference)
        self.last_report_t_us, self.holes_s, self.pending_s = reference, 0.0, math.nan
        if position.pps != LOCKED:
            if position.sentence != self.last_sentence and not (parsed := parse_rmc(position.sentence))[1]:
                self.sentences.append((now_us * 1e-6 + self.extra_s, float(gps_from_unix(parsed[0]))))
            self.last_sentence = position.sentence
            self._unlock(block, position, f"PPS {PPS_STATES[position.pps]}")
            return
        rmc_s, wrong = parse_rmc(position.sentence)
        fresh = position.sentence != self.last_sentence
        self.last_sentence = position.sentence
        if wrong:
            self.counts[f"rmc_{wrong.replace(' ', '_')}"] += 1
            if math.isnan(self.stretches[-1].offset_s):
                self.stretches[-1].why = f"PPS locked, but RMC: {wrong}"
            return
        lag_s = (rmc_s - position.toh_us * 1e-6 + _HOUR_S / 2) % _HOUR_S - _HOUR_S / 2
        if abs(lag_s) > MAX_LAG_S:
            self.counts["rmc_not_of_this_second"] += 1
            if fresh or math.isnan(self.stretches[-1].offset_s):
                self._unlock(block, position, f"RMC and packet stamps disagree by {abs(lag_s):.0f} s")
            return
        self.worst_lag_s = max(self.worst_lag_s, -lag_s)
        hour_unix_s = _HOUR_S * round((rmc_s - position.toh_us * 1e-6) / _HOUR_S)
        total_s = float(gps_from_unix(hour_unix_s)) - (now_us - position.toh_us) // 1_000_000
        free = math.isnan(self.stretches[-1].offset_s) and self.unconfirmed_from < 0
        if free and abs(now_us - reference) > SET_S * 1e6:
            # The new time stands in this packet, but data packets fired before it may still be under way.
            self.pending_s = total_s
        else:
            self._lock(block, position.after_packet, total_s)

    def _unlock(self, block: PacketBlock, position: PositionPacket, why: str) -> None:
        packet = position.after_packet if self.unconfirmed_from < 0 else self.unconfirmed_from
        if not math.isnan(self.stretches[-1].offset_s) or self.stretches[-1].why != why:
            self._push(block, packet, math.nan, why)
        self.unconfirmed_from = -1

    def _lock(self, block: PacketBlock, packet: int, total_s: float) -> None:
        """GPS time minus unrolled stamp is ``total_s``; it holds from ``packet`` on."""
        first = packet
        now_us = self._t_us(block, packet - 1)
        self.clock_set |= {k for k, t_us in self.free_jumps.items() if abs(now_us - t_us) <= HEAD_S * 1e6}
        self.free_jumps = {}
        if math.isnan(self.known_offset_s):
            self.known_offset_s = total_s - self.extra_s
        difference_s = total_s - self.extra_s - self.known_offset_s
        if difference_s:
            hours = round(difference_s / _HOUR_S)
            self.known_offset_s += difference_s - _HOUR_S * hours
            self.extra_s += _HOUR_S * hours
            first = self._place_of_hidden_hours(packet)
            self.notes.append(
                f"A hole before packet {first} is {abs(hours)} h longer than the packet stamps can tell; "
                "the position packets say so."
            )
        if self.unconfirmed_from >= 0:
            earliest_us = self._t_us(block, packet - 1) - int(HEAD_S * 1e6)
            if self.unconfirmed_t_us >= earliest_us:
                first = min(first, self.unconfirmed_from)
            else:
                first = min(first, block.first_packet + int(np.searchsorted(block.t_us, earliest_us)))
        if difference_s or math.isnan(self.stretches[-1].offset_s):
            self._push(block, first, self.known_offset_s, "")
        self.unconfirmed_from = -1
        self.last_locked_packet = packet
        self.jumps = []

    def _place_of_hidden_hours(self, packet: int) -> int:
        """Packet behind the longest hole, else of a new file, since the last locked report."""
        if self.jumps:
            return max(self.jumps, key=lambda jump: abs(jump[1]))[0]
        starts = [s for s in self.file_starts if self.last_locked_packet <= s <= packet]
        return starts[-1] if starts else packet

    def finish(self) -> LidarClock:
        """The clock of all packets that were fed."""
        if not self.stretches:
            return LidarClock()
        return LidarClock(
            first_packet=tuple(s.first for s in self.stretches),
            device_extra_s=tuple(s.extra_s for s in self.stretches),
            gps_minus_device_s=tuple(s.offset_s for s in self.stretches),
        )
