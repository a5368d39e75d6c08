"""The Velodyne reader: what a recording holds (`scan_lidar`) and its points (`iter_points`).

Both read the files in pieces: memory does not grow with the recording. The frame ``scs`` is that of the
manual: x right, y forward (azimuth 0), z up along the axis of rotation.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from thalweg.core import ArrayF, ArrayI, InputError, UnsupportedError
from thalweg.ingest import (
    IntegrityReport,
    LidarClock,
    LidarOptions,
    LidarScan,
    LogWindow,
    PointBlock,
    empty_points,
)
from thalweg.ingest.pcap import CHUNK_BYTES
from thalweg.ingest.velodyne.clock import ClockBuilder
from thalweg.ingest.velodyne.decode import N_COUNTERS, RETURNS, count_points, decode
from thalweg.ingest.velodyne.model import DUAL, VLP16, Model, choose_model
from thalweg.ingest.velodyne.packets import PacketBlock, StreamTally, first_product, read_packets
from thalweg.ingest.velodyne.report import Findings, check_interval, check_senders, no_packets, write_report

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
        for block in _packets(paths, self.options, model, CHUNK_BYTES):
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


def _packets(
    files: Sequence[Path],
    options: LidarOptions,
    model: Model,
    chunk_bytes: int,
    tally: StreamTally | None = None,
) -> Iterator[PacketBlock]:
    return read_packets(
        files,
        model=model,
        any_product=options.model.lower() != "auto",
        data_port=options.data_port,
        position_port=options.position_port,
        tally=tally,
        chunk_bytes=chunk_bytes,
    )


def _count(block: PacketBlock, options: LidarOptions, model: Model, counters: ArrayI) -> ArrayI:
    points = np.empty(block.payload.shape[0], dtype=np.int64)
    low, high = _range_ticks(options, model.range_unit_m)
    count_points(block.payload, block.keep, RETURNS[options.returns], low, high, points, counters)
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
    clock.file_starts = findings.parts.file_starts = tally.file_starts
    counters = np.zeros(N_COUNTERS, dtype=np.int64)
    n_points = 0
    for block in _packets(paths, options, model, chunk_bytes, tally):
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
    report = IntegrityReport(
        stream="lidar",
        format=f"Velodyne packets, {' + '.join(dict.fromkeys(tally.formats))}",
        files=[str(p) for p in paths],
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
        report=report, clock=finished, model=model.name, return_mode=findings.return_mode, n_points=n_points
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
    for block, start, end in _rows_of(_packets(paths, options, model, chunk_bytes), window):
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
