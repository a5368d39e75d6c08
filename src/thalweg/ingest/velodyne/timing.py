"""The clock of a VLP-16 recording in numbers: steps, PPS, capture host, and times without GPS."""

import itertools
import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from thalweg.core.types import ArrayF, ArrayI
from thalweg.ingest.integrity import IntegrityReport
from thalweg.ingest.stamps import StreamTiming, fit_clock
from thalweg.ingest.velodyne.clock import ClockBuilder, LidarClock
from thalweg.ingest.velodyne.packets import PacketBlock

LONGEST_STEP_US: Final = 20_000
"""Longer steps from packet to packet are holes; a packet takes 1.3 ms or 0.7 ms."""

_MOST_PAIRS: Final = 1024
_RESOLUTION_S: Final = 1e-6
_SET_S: Final = 0.1
"""A free-running clock is not wrong by that much within a stretch; a larger jump is the clock being set."""
_LEAST_PAIRS: Final = 10
_LEAST_SPAN_S: Final = 2.0
"""Pairs of stamps, and the time that they span, without which the drift of a free-running clock is noise."""


@dataclass(slots=True)
class HostPairs:
    """Sensor stamps beside stamps of the capture host, evenly spread over a recording of any length.

    One of ``every`` packets is taken; if the list is full, every second entry goes and ``every`` doubles.
    """

    every: int = 64
    rows: ArrayF = field(default_factory=lambda: np.empty((_MOST_PAIRS, 3)))
    n: int = 0

    def feed(self, block: PacketBlock, keep: ArrayI) -> None:
        """Take in some of the kept packets of the next block."""
        good = keep[np.isfinite(block.t_host_s[keep])]
        good = good[(block.first_packet + good) % self.every == 0]
        for i in good.tolist():
            if self.n == _MOST_PAIRS:
                self.every *= 2
                half = self.rows[: self.n][self.rows[: self.n, 0] % self.every == 0]
                self.n = len(half)
                self.rows[: self.n] = half
            if (block.first_packet + i) % self.every == 0:
                self.rows[self.n] = block.first_packet + i, block.t_us[i], block.t_host_s[i]
                self.n += 1

    def table(self) -> ArrayF:
        """Index, unrolled stamp in microseconds and host stamp (n, 3)."""
        return self.rows[: self.n].copy()


def write_timing(
    report: IntegrityReport,
    step_counts: ArrayI,
    host: ArrayF,
    builder: ClockBuilder,
    clock: LidarClock,
    stops_s: list[float],
    set_s: dict[int, float],
) -> None:
    """Fill in the clock state of a recording.

    Parameters
    ----------
    report : takes the numbers.
    step_counts : how often a packet followed another after so many microseconds; the last entry: or more.
    host : (n, 3) index, unrolled stamp in microseconds and host stamp of some packets.
    builder, clock : of the scan; a stretch of the clock is locked or not.
    stops_s : end of each stretch on the device's clock.
    set_s : packets before which the sensor set its clock, and by how much.
    """
    timing = report.timing
    timing.resolution_s = _RESOLUTION_S
    steps = np.flatnonzero(step_counts[:-1])
    if steps.size:
        timing.describe_steps(np.asarray(steps * 1e-6), step_counts[steps].astype(np.float64))
    starts = [s.t_us * 1e-6 + s.extra_s for s in builder.stretches]
    locked = [not math.isnan(v) for v in clock.gps_minus_device_s]
    step_s = timing.period_s or 0.0
    lengths = [
        max(b - a - sum(jump - step_s for k, jump in set_s.items() if first < k < end), 0.0)
        for a, b, first, end in zip(
            starts, stops_s, clock.first_packet, [*clock.first_packet[1:], math.inf], strict=True
        )
    ]
    _write_pps(timing, builder, lengths, locked)
    _write_unsynchronised(timing, clock, (starts, stops_s, lengths), locked)
    _write_host(report, host, clock)


def _write_pps(timing: StreamTiming, builder: ClockBuilder, lengths: list[float], locked: list[bool]) -> None:
    """Share of locked time, time before the first lock, and losses; unknown without position packets."""
    if not builder.counts.get("position_packets"):
        return
    total = sum(lengths)
    held = sum(length for length, good in zip(lengths, locked, strict=True) if good)
    timing.pps_locked_share = held / total if total > 0 else float(any(locked))
    first = locked.index(True) if any(locked) else len(locked)
    timing.pps_unlocked_start_s = sum(lengths[:first])
    timing.pps_losses = sum(1 for before, after in itertools.pairwise(locked) if before and not after)


def _write_unsynchronised(
    timing: StreamTiming,
    clock: LidarClock,
    spans: tuple[list[float], list[float], list[float]],
    locked: list[bool],
) -> None:
    """Stretches without GPS time; their place follows from the locked stretches beside them."""
    starts, stops, lengths = spans
    offset = clock.gps_minus_device_s
    timing.unsynchronised_s = 0.0
    for free, group in itertools.groupby(range(len(locked)), key=lambda i: not locked[i]):
        if not free:
            continue
        run = list(group)
        length = sum(lengths[i] for i in run)
        timing.unsynchronised_s += length
        i, j = run[0] - 1, run[-1] + 1
        after = starts[j] + offset[j] if j < len(locked) else None
        if i >= 0:
            before = stops[i] + offset[i]
            timing.unsynchronised.append((before, before + length if after is None else max(after, before)))
        elif after is not None:
            timing.unsynchronised.append((after - length, after))


def _write_host(report: IntegrityReport, host: ArrayF, clock: LidarClock) -> None:
    """The capture host's clock against UTC, and the sensor's free-running clock against the host's."""
    packet = host[:, 0].astype(np.int64)
    device_s = host[:, 1] * 1e-6 + clock.extra_s(packet)
    gps_s = device_s + clock.offset_s(packet)
    known = np.isfinite(gps_s)
    drift_ppm = 0.0
    if known.any():
        report.timing.describe_host(gps_s, host[:, 2])
        drift_ppm = report.timing.clock_drift_ppm or 0.0
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
