"""The Velodyne reader: what a recording holds (`scan_lidar`) and its points (`iter_points`).

Both read the files in pieces: memory does not grow with the recording. The frame ``scs`` is that of the
manual: x right, y forward (azimuth 0), z up along the axis of rotation.
"""

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayI, InputError, UnsupportedError, unix_from_gps
from thalweg.ingest import (
    Gap,
    IntegrityReport,
    LidarClock,
    LidarOptions,
    LidarScan,
    LogWindow,
    PointBlock,
    empty_points,
    fit_clock,
)
from thalweg.ingest.pcap import CHUNK_BYTES, CaptureTally
from thalweg.ingest.velodyne.clock import ClockBuilder, clocks_apart
from thalweg.ingest.velodyne.decode import (
    BAD_AZIMUTH,
    BAD_FLAG,
    GAP_COUNT,
    GAP_SUM,
    JUMPS,
    N_COUNTERS,
    RETURNS,
    TWO_RETURNS,
    count_points,
    decode,
)
from thalweg.ingest.velodyne.model import (
    DUAL,
    MODELS,
    RETURN_MODES,
    STRONGEST,
    VLP16,
    Model,
    choose_model,
    product_name,
)
from thalweg.ingest.velodyne.packets import (
    BAD_STAMP,
    DUPLICATE,
    GAP_STEPS,
    LATE,
    STEP_BACK,
    UNUSABLE,
    PacketBlock,
    StreamTally,
    first_product,
    read_packets,
)

# ---------------------------------------------------------------- the clock of a recording in numbers:
# steps, PPS, capture host, and times without GPS


# ---------------------------------------------------------------- what a scan finds

LONGEST_STEP_US: Final = 20_000
"""Longer steps from packet to packet are holes; a packet takes 1.3 ms or 0.7 ms."""

_PACKETS_A_PAIR: Final = 64
"""Of so many packets one stands beside its host stamp: 24 MB in a day."""
_RESOLUTION_S: Final = 1e-6
_SET_S: Final = 0.1
"""A free-running clock is not wrong by that much within a stretch; a larger jump is the clock being set."""
_LEAST_PAIRS: Final = 10
_SAME_RATE: Final = 0.1
"""Packets of different models come at rates that differ by a fifth and more."""
_LEAST_SPAN_S: Final = 2.0
"""Pairs of stamps, and the time that they span, without which the drift of a free-running clock is noise."""


def write_timing(
    report: IntegrityReport, found: "Findings", builder: ClockBuilder, clock: LidarClock, stops_s: list[float]
) -> None:
    """Fill in the clock state of a recording.

    Parameters
    ----------
    report : takes the numbers.
    found, builder, clock : of the scan; a stretch of the clock is locked or not.
    stops_s : end of each stretch on the device's clock.
    """
    timing = report.timing
    timing.resolution_s = _RESOLUTION_S
    starts_s = [s.t_us * 1e-6 + s.extra_s for s in builder.stretches]
    offset_s = np.array(clock.gps_minus_device_s)
    locked = np.isfinite(offset_s).tolist()
    step_s = found.model.packet_s(max(found.modes))
    # a jump by which the sensor set its clock within a stretch is no time
    runs = found.runs.table
    set_s = {int(run["packet"]): run["jump_us"] * 1e-6 - step_s for run in runs[found.clock_set(builder)]}
    lengths = [
        max(b - a - sum(jump for k, jump in set_s.items() if first < k < end), 0.0)
        for a, b, first, end in zip(
            starts_s, stops_s, clock.first_packet, [*clock.first_packet[1:], math.inf], strict=True
        )
    ]
    if builder.counts.get("position_packets"):
        total = sum(lengths)
        held = sum(length for length, good in zip(lengths, locked, strict=True) if good)
        timing.pps_locked_share = held / total if total > 0 else float(any(locked))
        first = locked.index(True) if any(locked) else len(locked)
        timing.pps_unlocked_start_s = sum(lengths[:first])
        timing.pps_losses = sum(1 for before, after in pairwise(locked) if before and not after)
    # both ends of each stretch; of the device's clock only differences count
    ends = np.column_stack([starts_s, stops_s]) + offset_s[:, None]
    timing.place_unsynchronised(np.repeat(np.cumsum([0.0, *lengths]), 2)[1:-1], ends.ravel())
    steps = np.flatnonzero(found.step_counts[:-1])
    if steps.size:
        timing.describe_steps(np.asarray(steps * 1e-6), found.step_counts[steps].astype(np.float64))
    _write_host(report, np.concatenate(found.host or [np.empty((0, 3))]), clock)


def _write_host(report: IntegrityReport, host: ArrayF, clock: LidarClock) -> None:
    """The capture host's clock against UTC, and the sensor's free-running clock against the host's.

    ``host`` (n, 3) holds index, unrolled stamp in microseconds and host stamp of some packets.
    """
    packet = host[:, 0].astype(np.int64)
    device_s = host[:, 1] * 1e-6 + clock.extra_s(packet)
    gps_s = device_s + clock.offset_s(packet)
    known = np.isfinite(gps_s)
    drift_ppm = 0.0
    if known.any():
        report.timing.describe_host(gps_s, host[:, 2])
        drift_ppm = report.timing.clock_drift_ppm or 0.0
        shift_s = float(np.median(host[known, 2] - unix_from_gps(gps_s[known])))
        report.details["host_minus_sensor_s"] = round(shift_s, 6)
        if words := clocks_apart(shift_s, float(gps_s[known][0])):
            report.note(words)
    stretch = np.searchsorted(np.array(clock.first_packet), packet, side="right") - 1
    for number in np.unique(stretch[~known]):
        free = stretch == number
        # the clock may have been set within the stretch, before the first report that it is locked
        ahead_s = device_s - host[:, 2]
        typical_s = np.sort(ahead_s[free])[free.sum() // 2]  # one of them, not the middle between two
        free &= np.abs(ahead_s - typical_s) < _SET_S
        if free.sum() < _LEAST_PAIRS or np.ptp(device_s[free]) < _LEAST_SPAN_S:
            continue
        fit = fit_clock(host[free, 2], device_s[free])
        if fit is not None:
            # the host's own drift, as far as GPS shows it, is taken off
            report.details["free_running_drift_ppm"] = round(fit.drift_ppm + drift_ppm, 3)
            report.details["free_running_drift_sigma_ppm"] = round(fit.sigma_drift_ppm, 3)
            break


# ---------------------------------------------------------------- what a recording covers, and whether its
# files were given in the order of time


ORDER_S: Final = 0.1
"""Packets that the network has delivered in another order are closer together than this."""

_RUN: Final = np.dtype([
    (name, np.int64)
    for name in ("packet", "first_us", "last_packet", "last_us", "mode", "file", "event", "jump_us")
])  # fmt: skip
"""Index and unrolled stamp of the first and of the last packet of a run, return mode of the last; number of
the file that begins with it, -1 inside of a file; event of the first, see `velodyne.packets`, and its
distance from the newest packet before."""


@dataclass(slots=True)
class Runs:
    """Runs of packets without a hole that grow while packets stream by; a late packet is one by itself.

    ``file_starts`` is the list of the packet stream: index of the first data packet of each file. ``table``
    holds the runs in stream order, see `_RUN`.
    """

    file_starts: list[int] = field(default_factory=list)
    table: AnyArray = field(default_factory=lambda: np.empty(0, _RUN))
    _open: int = 0
    """The run that packets in the order of time prolong."""
    _file: int = -1

    def feed(self, block: PacketBlock, keep: ArrayI) -> None:
        """Take in the next block, of which the rows ``keep`` are used."""
        file = np.searchsorted(self.file_starts, block.first_packet + keep, side="right") - 1
        begins, event = np.diff(file, prepend=self._file) != 0, block.event[keep]
        starts, on_time = begins | (event >= LATE), event != LATE
        first = keep[starts]
        runs = np.empty(first.size, _RUN)
        runs["packet"] = runs["last_packet"] = block.first_packet + first
        runs["first_us"] = runs["last_us"] = block.t_us[first]
        runs["mode"], runs["event"] = block.payload[first, 1204], block.event[first]
        runs["file"], runs["jump_us"] = np.where(begins, file, -1)[starts], block.jump_us[first]
        run = np.r_[self._open, self.table.size + np.flatnonzero(on_time[starts])]
        last = np.r_[np.flatnonzero(starts[on_time]), np.count_nonzero(on_time)] - 1
        run, last = run[last >= 0], keep[on_time][last[last >= 0]]
        self.table = np.concatenate([self.table, runs])
        self.table["last_packet"][run], self.table["last_us"][run] = (
            block.first_packet + last,
            block.t_us[last],
        )
        self.table["mode"][run] = block.payload[last, 1204]
        self._open, self._file = int(run[-1]) if run.size else self._open, int(file[-1])

    def spans_s(self, clock: LidarClock) -> tuple[ArrayF, ArrayF, ArrayF]:
        """Begin and end (n,) of the runs in device time, and time from the newest packet before each."""
        t, extra_s = self.table, clock.extra_s
        first_s = t["first_us"] * 1e-6 + extra_s(t["packet"])
        last_s = t["last_us"] * 1e-6 + extra_s(t["last_packet"])
        return first_s, last_s, t["jump_us"] * 1e-6 + extra_s(t["packet"]) - extra_s(t["packet"] - 1)

    def early(self, jump_s: ArrayF) -> ArrayB:
        """Runs (n,) that begin a file before the end of the one before it; ``jump_s`` is that of `spans_s`.

        Packets that both files hold are none: they are dropped before.
        """
        turned = (self.table["event"] == LATE) | (self.table["event"] == STEP_BACK)
        return (self.table["file"] > 0) & turned & (jump_s < -ORDER_S)

    def newest_s(self, clock: LidarClock) -> float:
        """Device time of the newest packet, since the clock was last set back inside a file."""
        inside = np.flatnonzero((self.table["event"] == STEP_BACK) & (self.table["file"] < 0))
        return float(self.spans_s(clock)[1][inside[-1] if inside.size else 0 :].max())


# ---------------------------------------------------------------- report


_NAMED = 10
_SILENCE_S = 10.0
_EVENT_LOSSES = {
    UNUSABLE: "unusable_packets",
    DUPLICATE: "duplicate_packets",
    BAD_STAMP: "packets_with_wrong_stamp",
    LATE: "out_of_order_packets",
}


@dataclass(slots=True)
class Findings:
    """Counts that grow while packets of a model stream by."""

    model: Model
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
    first: tuple[int, int] = (0, 0)
    last: tuple[int, int] = (0, 0)
    """Index and unrolled stamp of the first and of the last packet kept that was not late."""
    host: list[ArrayF] = field(default_factory=list)
    """Index, unrolled stamp and host stamp (n, 3) of some packets of each piece."""
    runs: Runs = field(default_factory=Runs)

    @property
    def product(self) -> int:
        """Most frequent product byte."""
        return self.products.most_common(1)[0][0]

    def clock_set(self, builder: ClockBuilder) -> ArrayB:
        """Runs (n,) before which the sensor set its clock on locking."""
        return np.isin(self.runs.table["packet"], list(builder.clock_set))

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
            self.runs.feed(block, keep)
            some = keep[(block.first_packet + keep) % _PACKETS_A_PAIR == 0]
            some = some[np.isfinite(block.t_host_s[some])]
            pairs = [block.first_packet + some, block.t_us[some], block.t_host_s[some]]
            self.host.append(np.column_stack(pairs).astype(np.float64))


def _add(counter: Counter[int], values: "np.typing.NDArray[np.integer]") -> None:
    for value, n in zip(*np.unique(values, return_counts=True), strict=True):
        counter[int(value)] += int(n)


_OTHER_MAKERS: Final = {  # what the first bytes of their payloads, or their two UDP ports, are
    "Hesai": rb"\xee\xff[\x01-\x06][\x00-\x0f]",
    "Livox": rb"\xdb[\xec-\xf1]\xdb[\xec-\xf1]",
    "RoboSense": rb"\x55\xaa\x05[\x0a\x5a]",
}
_LEAST_OF_A_MAKER: Final = 5


def _other_maker(where: str) -> str:
    """Maker of the lidar whose packets a capture holds instead, empty if none that is known."""
    path = Path(where)
    if not path.is_file():
        return ""
    with path.open("rb") as stream:
        head = stream.read(1 << 18)
    return next(
        (m for m, mark in _OTHER_MAKERS.items() if len(re.findall(mark, head)) >= _LEAST_OF_A_MAKER), ""
    )


def no_packets(tally: CaptureTally, port: int, where: str, found: Findings | None = None) -> InputError:
    """The error for a recording without a usable data packet."""
    if found is not None:
        mode = found.all_modes.most_common(1)[0][0]
        return UnsupportedError(
            f"none of {found.n_packets} data packets can be used (return mode byte 0x{mode:02x}, "
            f"{product_name(found.product)})",
            expected="return mode 0x37, 0x38 or 0x39, block flags ff ee and stamps within the hour",
            where=where,
            cure="Check that it is the log of a lidar that is read, a VLP-16 with firmware 3.0.29 or later",
        )
    held = {**tally.counts, **tally.losses}
    text = ", ".join(f"{name} {n}" for name, n in held.items() if n) or "nothing"
    cure = "Check lidar.data_port and that the capture was made on the lidar's network"
    if cut := tally.cut_in_words():
        return InputError(
            f"no lidar packet is whole: {cut}",
            expected=f"1206-byte payloads on UDP port {port}",
            where=where,
            cure="Capture with -s 0 (tcpdump), that is without a limit of the packets' length",
        )
    if tally.foreign_ports:
        other, n = tally.foreign_ports.most_common(1)[0]
        cure = f"{n} payloads of the right size went to port {other}: set lidar.data_port to it"
    if maker := _other_maker(where):
        return UnsupportedError(
            f"packets of a {maker}",
            expected="packets of a Velodyne, or of an Ouster with the extra `ouster`",
            where=where,
            cure=f"Play the capture through {maker}'s driver for ROS and record its PointCloud2 with a time "
            "for each point: bags are read with the extra `ros`",
        )
    return InputError(
        f"no lidar packets (the file holds: {text})",
        expected=f"1206-byte payloads on UDP port {port}",
        where=where,
        cure=cure,
    )


def check_interval(found: Findings, where: str, *, chosen: bool = False) -> None:
    """Refuse packets that come at the rate of another model than the one that they are decoded as.

    Early firmware of the VLP-16 writes the product byte of the HDL-32E: decoded as such its cloud would look
    plausible and be wrong; so would that of an HDL-32E where `lidar.model` says VLP-16 for that reason.

    Parameters
    ----------
    chosen : whether the setting `lidar.model` and not the product byte names the model.

    Raises
    ------
    UnsupportedError : another model's packets come at this rate.
    """
    until = np.cumsum(found.step_counts)
    if until[-1] < _LEAST_PAIRS:
        return
    step_s = 1e-6 * float(np.searchsorted(until, until[-1] / 2))
    mode = found.modes.most_common(1)[0][0]
    if math.isclose(step_s, found.model.packet_s(mode), rel_tol=_SAME_RATE):
        return
    like = [m.name for m in MODELS if math.isclose(step_s, m.packet_s(mode), rel_tol=_SAME_RATE)]
    if like:
        expected_us = 1e6 * found.model.packet_s(mode)
        named = product_name(found.product)
        if chosen:
            right = any(model.name in like and model.product == found.product for model in MODELS)
            cure = f"Set lidar.model to {'auto' if right else like[0]}"
        else:
            cure = f"Old firmware names a wrong model: set lidar.model to {like[0]}"
        raise UnsupportedError(
            f"packets of a {named} that come every {1e6 * step_s:.0f} us, as those of a {' or '.join(like)}",
            expected=f"{expected_us:.0f} us from packet to packet of a {found.model.name}",
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
        report.rates_hz["rotation"] = float(degrees / 360 / found.model.block_s)
    report.details["return_mode"] = found.return_mode
    report.details["product"] = product_name(found.product)
    write_timing(report, found, builder, clock, stops)
    if found.return_mode == "mixed":
        modes = ", ".join(f"{RETURN_MODES[m]} {n}" for m, n in sorted(found.modes.items()))
        report.note(f"The return mode changes within the recording (packets: {modes}).")
    foreign = {p: n for p, n in found.products.items() if p != found.model.product}
    if foreign and found.product == found.model.product:
        names = ", ".join(f"{n} of {product_name(p)}" for p, n in sorted(foreign.items()))
        report.note(f"Packets that name another model: {names}.")
    if counters[JUMPS]:
        report.note(
            f"The azimuth jumps within a packet {int(counters[JUMPS])} times (a limited field of view or "
            "damaged blocks): times behind such a jump may be early."
        )
    for port, n in tally.capture.foreign_ports.most_common():
        report.note(
            f"{n:,} payloads of the same size went to UDP port {port} and are not read: another lidar? "
            "lidar.data_port names the port of the one that is read."
        )
    if cut := tally.capture.cut_in_words():
        report.note(f"{cut[0].upper()}{cut[1:]}; capture with -s 0.")
    for note in builder.notes + tally.capture.notes:
        report.note(note)


def _write_times(
    report: IntegrityReport, found: Findings, builder: ClockBuilder, clock: LidarClock, position_port: int
) -> list[float]:
    """Span and synchronisation; returns the ends of the clock's stretches on the device's clock."""
    ends = [*clock.first_packet[1:], found.n_packets]
    device = [s.t_us * 1e-6 + s.extra_s for s in builder.stretches]
    last_s = found.runs.newest_s(clock)
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
    report.lose("unsynchronised_packets", unsynchronised)
    silence_s = builder.silence_s(found.last[1])
    if silence_s > _SILENCE_S:
        report.note(
            f"No position packets for up to {silence_s:.0f} s: the PPS state is taken to be unchanged there."
        )
    report.details["rmc_age_s"] = round(builder.worst_lag_s, 3)
    return stops


def _write_order(report: IntegrityReport, found: Findings, clock: LidarClock) -> None:
    """Name the files that were given in another order than that of time."""
    runs = found.runs.table
    first_s, _, jump_s = found.runs.spans_s(clock)
    early = found.runs.early(jump_s)
    if not early.any():
        return
    named = ", ".join(
        f"{Path(report.files[file]).name} begins {ahead_s:.3f} s before the end of the file before it"
        for file, ahead_s in zip(runs["file"][early][:_NAMED], -jump_s[early], strict=False)
    )
    report.note(
        f"Files out of order: list them in order of time ({named}). If the order is right, "
        "the sensor's clock was set back between the files, or they lie more than half an hour apart."
    )
    report.lose("files_out_of_order", np.count_nonzero(early))
    offset_s = clock.offset_s(runs["packet"]) if report.synchronised else 0.0
    report.t_first_s = float(np.fmin.reduce(np.r_[report.t_first_s, first_s + offset_s]))  # NaN: not known


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
    report.count_some("shots_with_two_returns", counters[TWO_RETURNS])
    for name, n in tally.capture.counts.items():
        report.count(name, n)
    for name, n in tally.capture.losses.items():
        report.lose(name, n)
    for event, name in _EVENT_LOSSES.items():
        report.lose(name, found.events[event])
    report.lose("blocks_with_bad_flag", counters[BAD_FLAG])
    report.lose("blocks_with_bad_azimuth", counters[BAD_AZIMUTH])


def _write_gaps(report: IntegrityReport, found: Findings, builder: ClockBuilder, clock: LidarClock) -> None:
    """List the holes that no packet fills, on GPS time if the report is on it (NaN where it is not known)."""
    runs, clock_set = found.runs.table, found.clock_set(builder)
    first_s, last_s, jump_s = found.runs.spans_s(clock)
    for run in runs[clock_set]:
        report.note(
            f"The sensor set its clock by {run['jump_us'] * 1e-6:+.6f} s (whole hours apart) before packet "
            f"{run['packet']}, when it locked to the PPS; no packet is taken to be missing there."
        )
    back = (runs["event"] == STEP_BACK) & (jump_s <= 0) & ~clock_set & ~found.runs.early(jump_s)
    report.lose("clock_set_back", np.count_nonzero(back))
    step_s = np.where(runs["mode"] == DUAL, found.model.packet_s(DUAL), found.model.packet_s(STRONGEST))
    # a clock that was set tells nothing of the time between what came before and what came after
    for rows in np.split(np.arange(runs.size), np.flatnonzero(clock_set | back)):
        # late packets before all others are of another time, such as a clock set back right before the end
        rows = rows[(runs["event"][rows] != LATE) | (first_s[rows] > first_s[rows[:1]])]
        rows = rows[np.argsort(first_s[rows], kind="stable")]
        newest_s = np.maximum.accumulate(last_s[rows])
        newest = rows[np.maximum.accumulate(np.where(last_s[rows] == newest_s, np.arange(rows.size), 0))]
        length_s = first_s[rows[1:]] - newest_s[:-1]
        for i in np.flatnonzero(length_s > GAP_STEPS * step_s[newest[:-1]]):
            start_s = newest_s[i]
            if report.synchronised:
                start_s += clock.offset_s(runs["last_packet"][newest[[i]]])[0]
            lost = round(length_s[i] / step_s[newest[i]]) - 1
            report.gaps.append(Gap(t_start_s=float(start_s), duration_s=float(length_s[i]), lost=lost))
    report.lose("packets_lost_estimated", sum(gap.lost for gap in report.gaps))


# ---------------------------------------------------------------- the reader

_MIN_BLOCK_POINTS = 384
_LEAD_PACKETS = 64
"""Packets before a window that tell how fast the rotor turns, should the first one in it be damaged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VelodyneReader:
    """A recording of a Velodyne: a `thalweg.ingest.readers.LidarReader`."""

    files: Sequence[Path]
    options: LidarOptions

    def scan(self) -> LidarScan:
        """See `scan_lidar`."""
        return scan_lidar(self.files, self.options)

    def length_s(self) -> float:
        """By the rate of its first piece; NaN if that holds no packets."""
        paths = [Path(f) for f in self.files]
        model = _first_model(paths, self.options, CHUNK_BYTES)
        sizes = [path.stat().st_size for path in paths]
        for block in read_packets(paths, self.options, model, chunk_bytes=CHUNK_BYTES):
            t_us = block.t_us[block.keep]
            if t_us.size:
                return float(np.ptp(t_us)) * 1e-6 * sum(sizes) / min(CHUNK_BYTES, sizes[0])
        return math.nan

    def points(
        self, clock: LidarClock | None = None, *, max_points: int = 1_000_000, window: LogWindow | None = None
    ) -> Iterator[PointBlock]:
        """See `iter_points`."""
        return iter_points(self.files, self.options, clock, max_points, window=window)


def _range_ticks(options: LidarOptions, unit_m: float) -> tuple[int, int]:
    """Limits of the range in units of the model."""
    low = max(1, math.ceil(options.min_range_m / unit_m - 1e-6))
    high = math.floor(min(options.max_range_m, 65536 * unit_m) / unit_m + 1e-6)
    return low, high


def _first_model(files: Sequence[Path], options: LidarOptions, chunk_bytes: int) -> Model:
    """The model that the first packets name, or the setting."""
    product = first_product(files, options.data_port, chunk_bytes)
    return choose_model(
        options.model, VLP16.product if product is None else product, ", ".join(map(str, files))
    )[0]


def _count(block: PacketBlock, options: LidarOptions, model: Model, counters: ArrayI) -> ArrayI:
    points = np.empty(block.payload.shape[0], dtype=np.int64)
    low, high = _range_ticks(options, model.range_unit_m)
    room = np.empty(12, np.int64), np.empty(12)
    count_points(block.payload, block.keep, RETURNS[options.returns], low, high, *room, points, counters)
    return points


def scan_lidar(
    files: Sequence[Path], options: LidarOptions | None = None, chunk_bytes: int = CHUNK_BYTES
) -> LidarScan:
    """Read a recording once: integrity, clock, model, return mode and number of points.

    Parameters
    ----------
    files : pcap, pcapng or bare payloads; parts of one recording in the order of recording. Packets that
        overlap are dropped and counted, a hole between files is a gap. Files in another order than that of
        time are told by name in the report.
    options : see `LidarOptions`.
    chunk_bytes : bytes read at a time.

    Raises
    ------
    InputError : a file is missing or no capture, there are no data packets, or two lidars are mixed.
    UnsupportedError : the packets are of a model, or in a form, that is not known.
    """
    options = LidarOptions() if options is None else options
    paths = [Path(f) for f in files]
    if not paths:
        raise InputError("no lidar files", expected="at least one log", cure="Set logs.lidar")
    model = _first_model(paths, options, chunk_bytes)
    tally, clock, findings = StreamTally(), ClockBuilder(), Findings(model)
    clock.file_starts = findings.runs.file_starts = tally.file_starts
    counters = np.zeros(N_COUNTERS, dtype=np.int64)
    n_points = 0
    for block in read_packets(paths, options, model, tally=tally, chunk_bytes=chunk_bytes):
        n_points += int(_count(block, options, model, counters).sum())
        findings.feed(block)
        clock.feed(block)
    where = ", ".join(str(p) for p in paths)
    if findings.n_packets == 0:
        raise no_packets(tally.capture, options.data_port, where)
    _, disagreement = choose_model(options.model, findings.product, where)
    if findings.all_modes[DUAL] and not model.dual:
        raise UnsupportedError(
            f"{findings.all_modes[DUAL]} dual-return packets of a {model.name}",
            expected=f"one return a shot of a {model.name}; dual return of a VLP-16 or Puck Hi-Res",
            where=where,
            cure="Record the strongest or the last return; there was no recording to test the dual form with",
        )
    if findings.n_kept:
        check_interval(findings, where, chosen=options.model.lower() != "auto")
    check_senders(findings.senders, where)
    if findings.n_kept == 0:
        raise no_packets(tally.capture, options.data_port, where, findings)
    finished = clock.finish()
    report = IntegrityReport.of(
        "lidar",
        f"Velodyne packets, {' + '.join(dict.fromkeys(tally.formats))}",
        paths,
        model=model.name,
        bytes_read=tally.capture.bytes_read,
    )
    if disagreement:
        report.note(disagreement)
    report.count("points", n_points)
    write_report(report, findings, tally, clock, finished, counters, options.position_port)
    if options.returns != "all" and findings.return_mode not in (options.returns, "dual", "mixed"):
        report.note(
            f"lidar.returns is '{options.returns}', but the sensor recorded the {findings.return_mode} "
            "return only: all its points are kept."
        )
    return LidarScan(
        report=report,
        clock=finished,
        model=model.name,
        return_mode=findings.return_mode,
        n_points=n_points,
        sentences=tuple(clock.sentences),
    )


def iter_points(
    files: Sequence[Path],
    options: LidarOptions | None = None,
    clock: LidarClock | None = None,
    max_points: int = 1_000_000,
    chunk_bytes: int = CHUNK_BYTES,
    window: LogWindow | None = None,
) -> Iterator[PointBlock]:
    """Points of a recording, block by block, in stream order.

    Parameters
    ----------
    files, options : as given to `scan_lidar`.
    clock : from `scan_lidar`; without it the files are scanned first.
    max_points : no block is larger (at least 384, the most that one packet holds).
    chunk_bytes : bytes read at a time.
    window : only the points of its packets, the very same as without it. A packet belongs to the window of
        the newest stamp up to it, so that a late one stays where it is in the stream.

    Raises
    ------
    InputError, UnsupportedError : as `scan_lidar`.
    """
    options = LidarOptions() if options is None else options
    paths = [Path(f) for f in files]
    if clock is None:
        clock = scan_lidar(paths, options, chunk_bytes).clock
    model = _first_model(paths, options, chunk_bytes)
    limit = max(int(max_points), _MIN_BLOCK_POINTS)
    counters = np.zeros(N_COUNTERS, dtype=np.int64)
    rate = 40.0
    lead: tuple[PacketBlock, slice] | None = None
    for block, start, end in _rows_of(read_packets(paths, options, model, chunk_bytes=chunk_bytes), window):
        if start:
            lead = block, slice(max(0, start - _LEAD_PACKETS), start)
        if start == end:
            continue
        if lead is not None:
            before, rows = lead
            n = _count(before, options, model, counters)[rows]
            rate = _decode(before, rows, n, np.zeros(n.size), np.zeros(n.size), options, model, rate)[1]
            lead = None
        points = _count(block, options, model, counters)
        packet = block.first_packet + np.arange(points.size)
        t_device_s = block.t_us * 1e-6 + clock.extra_s(packet)
        offset_s = clock.offset_s(packet)
        total = np.cumsum(points)
        while start < end:
            done = int(total[start - 1]) if start else 0
            stop = min(end, max(start + 1, int(np.searchsorted(total, done + limit, side="right"))))
            piece = slice(start, stop)
            out, rate = _decode(
                block, piece, points[piece], t_device_s[piece], offset_s[piece], options, model, rate
            )
            if out.n:
                yield out
            start = stop


def _rows_of(
    blocks: Iterator[PacketBlock], window: LogWindow | None
) -> Iterator[tuple[PacketBlock, int, int]]:
    """Blocks up to the end of a window, with the first row that lies in it and the one behind the last.

    Those before the window must be read: duplicates and the turn of the hour are known by what went before.
    """
    first_us, newest_us = math.nan, -math.inf
    for block in blocks:
        n = block.t_us.size
        if window is None:
            yield block, 0, n
            continue
        t_us = np.where(block.keep, block.t_us, -math.inf)
        t_us = np.maximum.accumulate(np.r_[newest_us, t_us])[1:]
        if math.isnan(first_us) and math.isfinite(t_us[-1]):
            first_us = float(t_us[np.isfinite(t_us)][0])
        newest_us = float(t_us[-1])
        number = window.number_of(np.nan_to_num((t_us - first_us) * 1e-6))
        start, end = np.searchsorted(number, [window.index, window.index + 1])
        yield block, int(start), int(end)
        if end < n:
            return


def _decode(
    block: PacketBlock,
    piece: slice,
    points: ArrayI,
    t_device_s: ArrayF,
    offset_s: ArrayF,
    options: LidarOptions,
    model: Model,
    rate: float,
) -> tuple[PointBlock, float]:
    out = empty_points(int(points.sum()))
    low, high = _range_ticks(options, model.range_unit_m)
    rate = decode(
        block.payload[piece],
        points,
        block.first_packet + int(piece.start),
        t_device_s,
        offset_s,
        model.block_s,
        model.shots,
        model.vertical_offset_m(options.vertical_corrections),
        RETURNS[options.returns],
        low,
        high,
        model.range_unit_m,
        rate,
        out.t_gps_s,
        out.t_device_s,
        out.xyz_scs_m,
        out.range_m,
        out.azimuth_rad,
        out.ring,
        out.laser,
        out.intensity,
        out.return_number,
        out.n_returns,
        out.packet,
    )
    return out, rate
