"""What the scan of a VLP-16 recording finds, and how it is put into the integrity report."""

import math
from collections import Counter
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from thalweg.core.errors import InputError, UnsupportedError
from thalweg.core.timescales import unix_from_gps
from thalweg.core.types import ArrayI
from thalweg.ingest.integrity import Gap, IntegrityReport
from thalweg.ingest.pcap.capture import CaptureTally
from thalweg.ingest.velodyne.clock import ClockBuilder, LidarClock
from thalweg.ingest.velodyne.decode import (
    BAD_AZIMUTH,
    BAD_FLAG,
    GAP_COUNT,
    GAP_SUM,
    JUMPS,
    TWO_RETURNS,
)
from thalweg.ingest.velodyne.model import BLOCK_S, PACKET_S, RETURN_MODES, VLP16_PRODUCT, product_name
from thalweg.ingest.velodyne.packets import (
    BAD_STAMP,
    DUPLICATE,
    GAP,
    LATE,
    STEP_BACK,
    UNUSABLE,
    PacketBlock,
    StreamTally,
)
from thalweg.ingest.velodyne.parts import Parts
from thalweg.ingest.velodyne.timing import LONGEST_STEP_US, HostPairs, write_timing

_RECENT_GAPS = 64
_NAMED = 10
_SILENCE_S = 10.0
_EVENT_LOSSES = {
    UNUSABLE: "unusable_packets",
    DUPLICATE: "duplicate_packets",
    BAD_STAMP: "packets_with_wrong_stamp",
    LATE: "out_of_order_packets",
    STEP_BACK: "clock_set_back",
}


@dataclass(slots=True)
class Hole:
    """Missing packets: the packet behind it, its end on the unrolled clock, its length, packets lost."""

    packet: int
    end_us: int
    jump_us: int
    lost: int
    step_s: float


@dataclass(slots=True)
class Findings:
    """Counts that grow while packets stream by."""

    n_packets: int = 0
    n_kept: int = 0
    products: Counter[int] = field(default_factory=Counter)
    modes: Counter[int] = field(default_factory=Counter)
    """Return mode bytes of the packets kept."""
    all_modes: Counter[int] = field(default_factory=Counter)
    senders: Counter[int] = field(default_factory=Counter)
    events: Counter[int] = field(default_factory=Counter)
    n_steps: int = 0
    steps_us: int = 0
    """Steps of less than a second from packet to packet, and their sum."""
    step_counts: ArrayI = field(default_factory=lambda: np.zeros(LONGEST_STEP_US + 1, dtype=np.int64))
    """How often each step in microseconds occurred; the last entry holds all longer ones."""
    holes: list[Hole] = field(default_factory=list)
    first: tuple[int, int] = (0, 0)
    last: tuple[int, int] = (0, 0)
    """Index and unrolled stamp of the first and of the last packet kept that was not late."""
    host: list[tuple[int, int, float]] = field(default_factory=list)
    """Index, unrolled stamp and host stamp of one packet of each piece."""
    host_pairs: HostPairs = field(default_factory=HostPairs)
    parts: Parts = field(default_factory=Parts)

    @property
    def product(self) -> int:
        """Most frequent product byte."""
        return self.products.most_common(1)[0][0]

    @property
    def return_mode(self) -> str:
        """Return mode of the packets kept, ``"mixed"`` if it changes."""
        names = [RETURN_MODES[m] for m in self.modes if m in RETURN_MODES]
        return names[0] if len(names) == 1 else "mixed"

    def feed(self, block: PacketBlock) -> None:
        """Take in the next block."""
        keep = np.flatnonzero(block.keep)
        self.n_packets += block.event.size
        self.n_kept += keep.size
        _add(self.products, block.payload[:, 1205])
        _add(self.senders, block.sender)
        _add(self.events, block.event)
        _add(self.all_modes, block.payload[:, 1204])
        _add(self.modes, block.payload[keep, 1204])
        step_us = block.jump_us[keep]
        step_us = step_us[(step_us > 0) & (step_us < 1_000_000)]
        self.n_steps += step_us.size
        self.steps_us += int(step_us.sum())
        self.step_counts += np.bincount(np.minimum(step_us, LONGEST_STEP_US), minlength=LONGEST_STEP_US + 1)
        if keep.size:
            if self.n_kept == keep.size:
                self.first = (block.first_packet + int(keep[0]), int(block.t_us[keep[0]]))
            newest = keep[block.event[keep] != LATE]
            if newest.size:
                self.last = (block.first_packet + int(newest[-1]), int(block.t_us[newest[-1]]))
            self.parts.feed(block, keep)
            self.host_pairs.feed(block, keep)
            if math.isfinite(block.t_host_s[keep[0]]):
                packet = block.first_packet + int(keep[0])
                self.host.append((packet, int(block.t_us[keep[0]]), float(block.t_host_s[keep[0]])))
        for i in np.flatnonzero((block.event == GAP) | (block.event == LATE) | (block.event == STEP_BACK)):
            self._hole(block, int(i))

    def _hole(self, block: PacketBlock, i: int) -> None:
        t_us, jump_us = int(block.t_us[i]), int(block.jump_us[i])
        if block.event[i] != LATE:
            step_s = PACKET_S[int(block.payload[i, 1204])]
            lost = round(jump_us * 1e-6 / step_s) - 1
            self.holes.append(Hole(block.first_packet + i, t_us, jump_us, lost, step_s))
            return
        for hole in self.holes[-_RECENT_GAPS:]:
            if hole.end_us - hole.jump_us < t_us < hole.end_us:
                hole.lost -= 1
        self.holes[-_RECENT_GAPS:] = [h for h in self.holes[-_RECENT_GAPS:] if h.lost > 0 or h.jump_us < 0]


def _add(counter: Counter[int], values: "np.typing.NDArray[np.integer]") -> None:
    for value, n in zip(*np.unique(values, return_counts=True), strict=True):
        counter[int(value)] += int(n)


def no_packets(tally: CaptureTally, port: int, where: str, found: Findings | None = None) -> InputError:
    """The error for a recording without a usable data packet."""
    if found is not None:
        mode = found.all_modes.most_common(1)[0][0]
        return UnsupportedError(
            f"none of {found.n_packets} data packets can be used (return mode byte 0x{mode:02x}, "
            f"{product_name(found.product)})",
            expected="return mode 0x37, 0x38 or 0x39, block flags ff ee and stamps within the hour",
            where=where,
            cure="Check that it is the log of a VLP-16 with firmware 3.0.29 or later",
        )
    held = {**tally.counts, **tally.losses}
    text = ", ".join(f"{name} {n}" for name, n in held.items() if n) or "nothing"
    cure = "Check lidar.data_port and that the capture was made on the lidar's network"
    if tally.foreign_ports:
        other, n = max(tally.foreign_ports.items(), key=lambda item: item[1])
        cure = f"{n} payloads of the right size went to port {other}: set lidar.data_port to it"
    return InputError(
        f"no lidar packets (the file holds: {text})",
        expected=f"1206-byte payloads on UDP port {port}",
        where=where,
        cure=cure,
    )


def check_senders(senders: Counter[int], where: str) -> None:
    """Refuse a capture of two lidars: their packets cannot be told apart behind this point.

    Raises
    ------
    InputError : more than one address has sent a noticeable share of the packets.
    """
    total = sum(senders.values())
    loud = [address for address, n in senders.items() if n >= max(10, 0.01 * total)]
    if len(loud) > 1:
        names = sorted(".".join(str(a >> s & 255) for s in (24, 16, 8, 0)) for a in loud)
        raise InputError(
            f"data packets of {len(loud)} senders: {', '.join(names)}",
            expected="one lidar",
            where=where,
            cure=f"Split the capture, for example: tcpdump -r IN -w OUT src host {names[0]}",
        )


def write_report(
    report: IntegrityReport,
    found: Findings,
    tally: StreamTally,
    builder: ClockBuilder,
    clock: LidarClock,
    counters: ArrayI,
    position_port: int,
) -> None:
    """Put the findings of a scan into its report."""
    stops = _write_times(report, found, builder, clock, position_port)
    _write_counts(report, found, tally, builder, counters)
    _write_order(report, found, clock)
    _write_gaps(report, found, builder, clock)
    if found.steps_us > 0:
        report.rates_hz["packets"] = found.n_steps / (found.steps_us * 1e-6)
    if counters[GAP_COUNT]:
        degrees = counters[GAP_SUM] / counters[GAP_COUNT] / 100
        report.rates_hz["rotation"] = float(degrees / 360 / BLOCK_S)
    report.details["return_mode"] = found.return_mode
    report.details["product"] = product_name(found.product)
    set_s = {h.packet: h.jump_us * 1e-6 for h in found.holes if h.packet in builder.clock_set}
    write_timing(report, found.step_counts, found.host_pairs.table(), builder, clock, stops, set_s)
    host = np.array(found.host).reshape(-1, 3)
    packet = host[:, 0].astype(np.int64)
    gps_s = host[:, 1] * 1e-6 + clock.extra_s(packet) + clock.offset_s(packet)
    difference_s = (host[:, 2] - unix_from_gps(gps_s))[np.isfinite(gps_s)]
    if difference_s.size:
        report.details["host_minus_sensor_s"] = round(float(np.median(difference_s)), 6)
    if found.return_mode == "mixed":
        modes = ", ".join(f"{RETURN_MODES[m]} {n}" for m, n in sorted(found.modes.items()))
        report.note(f"The return mode changes within the recording (packets: {modes}).")
    foreign = {p: n for p, n in found.products.items() if p != VLP16_PRODUCT}
    if foreign and found.product == VLP16_PRODUCT:
        names = ", ".join(f"{n} of {product_name(p)}" for p, n in sorted(foreign.items()))
        report.note(f"Packets that name another model: {names}.")
    if counters[JUMPS]:
        report.note(
            f"The azimuth jumps within a packet {int(counters[JUMPS])} times (a limited field of view or "
            "damaged blocks): times behind such a jump may be early."
        )
    for note in builder.notes + tally.capture.notes:
        report.note(note)


def _write_times(
    report: IntegrityReport, found: Findings, builder: ClockBuilder, clock: LidarClock, position_port: int
) -> list[float]:
    """Span and synchronisation; returns the ends of the clock's stretches on the device's clock."""
    ends = [*clock.first_packet[1:], found.n_packets]
    device = [s.t_us * 1e-6 + s.extra_s for s in builder.stretches]
    last_s = found.parts.newest_s(clock)
    stops = [after.before_us * 1e-6 + s.extra_s for s, after in pairwise(builder.stretches)] + [last_s]
    locked = [not math.isnan(v) for v in clock.gps_minus_device_s]
    report.synchronised = any(locked)
    report.time_scale = "utc" if report.synchronised else "device"
    if report.synchronised:
        first = locked.index(True)
        last = len(locked) - 1 - locked[::-1].index(True)
        report.t_first_s = device[first] + clock.gps_minus_device_s[first]
        report.t_last_s = stops[last] + clock.gps_minus_device_s[last]
    else:
        report.t_first_s = found.first[1] * 1e-6
        report.t_last_s = last_s
        report.note(
            f"The lidar is unsynchronised: {_why(builder, position_port)}. Its points have no GPS time, "
            "t_device_s is the sensor's free-running clock."
        )
        return stops
    free = [i for i, good in enumerate(locked) if not good]
    for i in free[:_NAMED]:
        report.note(
            f"Unsynchronised for {stops[i] - device[i]:.3f} s, from {device[i]:.6f} to {stops[i]:.6f} s "
            f"of device time (packets {clock.first_packet[i]} to {ends[i] - 1}; {builder.stretches[i].why}): "
            "points there have no GPS time."
        )
    if len(free) > _NAMED:
        report.note(f"Unsynchronised in {len(free) - _NAMED} more stretches.")
    unsynchronised = sum(ends[i] - clock.first_packet[i] for i in free)
    if unsynchronised:
        report.lose("unsynchronised_packets", unsynchronised)
    silence_s = builder.silence_s(found.last[1])
    if silence_s > _SILENCE_S:
        report.note(
            f"No position packets for up to {silence_s:.0f} s: the PPS state is taken to be unchanged there."
        )
    report.details["rmc_age_s"] = round(builder.worst_lag_s, 3)
    return stops


def _write_order(report: IntegrityReport, found: Findings, clock: LidarClock) -> None:
    """Name the files that were given in another order than that of time; what they fill is no hole."""
    early = found.parts.early(clock)
    if not early:
        return
    named = ", ".join(
        f"{Path(report.files[part.file]).name} begins {ahead_s:.3f} s before the end of the file before it"
        for part, ahead_s in early[:_NAMED]
    )
    report.note(
        f"Files out of order: list them in order of time ({named}). If the order is right, "
        "the sensor's clock was set back between the files, or they lie more than half an hour apart."
    )
    report.lose("files_out_of_order", len(early))
    for _ in (part for part, _ in early if part.event == STEP_BACK):
        _undo_set_back(report)
    device_s, gps_s = found.parts.first_s(clock)
    first_s = gps_s if report.synchronised else device_s
    if report.t_first_s is not None and first_s < report.t_first_s:
        report.t_first_s = first_s
    for hole in found.holes:
        hole.lost -= found.parts.within(hole.end_us - hole.jump_us, hole.end_us) if hole.jump_us > 0 else 0
    found.holes = [hole for hole in found.holes if hole.lost > 0 or hole.jump_us < 0]


def _why(builder: ClockBuilder, position_port: int) -> str:
    counts = builder.counts
    total = counts.get("position_packets", 0)
    if not total:
        return f"there are no position packets on UDP port {position_port}"
    if counts.get("pps_locked"):
        return f"the PPS was locked, but no sentence named the hour ({builder.stretches[-1].why})"
    states = ", ".join(f"{k[4:]} in {n}" for k, n in counts.items() if k.startswith("pps_"))
    return f"the PPS was never locked ({states or 'unreadable'} of {total} position packets)"


def _write_counts(
    report: IntegrityReport, found: Findings, tally: StreamTally, builder: ClockBuilder, counters: ArrayI
) -> None:
    report.count("data_packets", found.n_packets)
    for name, n in builder.counts.items():
        if name == "position_packets_damaged":
            report.lose(name, n)
        elif name == "rmc_bad_checksum":
            report.lose("rmc_with_bad_checksum", n)
        else:
            report.count(name, n)
    if counters[TWO_RETURNS]:
        report.count("shots_with_two_returns", int(counters[TWO_RETURNS]))
    for name, n in tally.capture.counts.items():
        report.count(name, n)
    for name, n in tally.capture.losses.items():
        if n:
            report.lose(name, n)
    for event, name in _EVENT_LOSSES.items():
        if found.events[event]:
            report.lose(name, found.events[event])
    for index, name in ((BAD_FLAG, "blocks_with_bad_flag"), (BAD_AZIMUTH, "blocks_with_bad_azimuth")):
        if counters[index]:
            report.lose(name, int(counters[index]))


def _write_gaps(report: IntegrityReport, found: Findings, builder: ClockBuilder, clock: LidarClock) -> None:
    """List the holes, on GPS time if the report is on it (NaN where it is not known)."""
    holes = {hole.packet: hole for hole in found.holes}
    step_s = PACKET_S[max(found.modes)]
    for before, after in pairwise(builder.stretches):
        if after.extra_s > before.extra_s and after.first not in holes:
            holes[after.first] = Hole(after.first, after.t_us, round(step_s * 1e6), 0, step_s)
    for packet, hole in sorted(holes.items()):
        if packet in builder.clock_set:
            if hole.jump_us < 0:
                _undo_set_back(report)
            report.note(
                f"The sensor set its clock by {hole.jump_us * 1e-6:+.6f} s (whole hours apart) before packet "
                f"{packet}, when it locked to the PPS; no packet is taken to be missing there."
            )
            continue
        around = np.array([packet - 1, packet])
        extra_s = clock.extra_s(around)
        hidden_s = float(extra_s[1] - extra_s[0])
        duration_s = hole.jump_us * 1e-6 + hidden_s
        if duration_s <= 0:
            continue  # the clock was set back: counted as such, nothing is missing
        if hole.jump_us < 0:
            _undo_set_back(report)
        start_s = (hole.end_us - hole.jump_us) * 1e-6 + float(extra_s[0])
        if report.synchronised:
            start_s += float(clock.offset_s(around)[0])
        lost = hole.lost + round(hidden_s / hole.step_s)
        report.gaps.append(Gap(t_start_s=start_s, duration_s=duration_s, lost=lost))
    lost = sum(gap.lost for gap in report.gaps)
    if lost:
        report.lose("packets_lost_estimated", lost)


def _undo_set_back(report: IntegrityReport) -> None:
    """Take back a loss that turned out to be none."""
    report.losses["clock_set_back"] -= 1
    if not report.losses["clock_set_back"]:
        del report.losses["clock_set_back"]
