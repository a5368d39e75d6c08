"""The VLP-16 reader: what a recording holds (`scan_lidar`) and its points (`iter_points`).

Both read the files in pieces: memory does not grow with the recording. The frame ``scs`` is that of the
manual: x right, y forward (azimuth 0), z up along the axis of rotation.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from thalweg.core.errors import ConfigError, InputError
from thalweg.core.types import ArrayF, ArrayI
from thalweg.ingest.integrity import IntegrityReport
from thalweg.ingest.pcap.capture import CHUNK_BYTES
from thalweg.ingest.velodyne.clock import ClockBuilder, LidarClock
from thalweg.ingest.velodyne.decode import (
    N_COUNTERS,
    RETURNS,
    SHOT_TABLE,
    PointBlock,
    count_points,
    decode,
    empty_points,
    vertical_offset_m,
)
from thalweg.ingest.velodyne.model import BLOCK_S, DATA_PORT, POSITION_PORT, RANGE_UNIT_M, choose_model
from thalweg.ingest.velodyne.packets import PacketBlock, StreamTally, read_packets
from thalweg.ingest.velodyne.report import Findings, check_senders, no_packets, write_report

__all__ = ["LidarClock", "LidarOptions", "LidarScan", "PointBlock", "iter_points", "scan_lidar"]

_MIN_BLOCK_POINTS = 384


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarOptions:
    """How to read a recording.

    Parameters
    ----------
    model : ``"auto"`` (product byte of the packets) or ``"VLP-16"`` (whatever that byte says).
    vertical_corrections : add the manual's height of each laser to z.
    min_range_m, max_range_m : returns outside are left out, limits included.
    returns : ``"all"``; in dual mode also ``"strongest"`` or ``"last"`` (the farthest) return of each
        shot. A single-return recording has one return a shot, which is kept in any case.
    data_port, position_port : UDP ports.

    Raises
    ------
    ConfigError : a value is out of its domain.
    """

    model: str = "auto"
    vertical_corrections: bool = True
    min_range_m: float = 0.0
    max_range_m: float = math.inf
    returns: Literal["all", "strongest", "last"] = "all"
    data_port: int = DATA_PORT
    position_port: int = POSITION_PORT

    def __post_init__(self) -> None:
        if self.returns not in RETURNS:
            raise ConfigError(
                f"lidar.returns '{self.returns}'", expected="all, strongest or last", cure="Set lidar.returns"
            )
        if not 0 <= self.min_range_m < self.max_range_m:
            raise ConfigError(
                f"lidar ranges {self.min_range_m} .. {self.max_range_m} m",
                expected="0 <= min_range_m < max_range_m",
                cure="Set lidar.min_range_m and lidar.max_range_m",
            )
        for port in (self.data_port, self.position_port):
            if not 0 < port < 65536:
                raise ConfigError(
                    f"UDP port {port}", expected="1 .. 65535", cure="Set the ports of the lidar"
                )

    @property
    def range_ticks(self) -> tuple[int, int]:
        """Limits of the range in units of 2 mm."""
        low = max(1, math.ceil(self.min_range_m / RANGE_UNIT_M - 1e-6))
        high = math.floor(min(self.max_range_m, 200.0) / RANGE_UNIT_M + 1e-6)
        return low, high


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarScan:
    """What a recording holds.

    Attributes
    ----------
    report : integrity report, stream ``"lidar"``.
    clock : puts its packets on GPS time; give it to `iter_points`.
    model : decoded as this model.
    return_mode : strongest, last, dual, or mixed if it changes.
    n_points : points that `iter_points` yields with the same options.
    """

    report: IntegrityReport
    clock: LidarClock
    model: str
    return_mode: str
    n_points: int


def _packets(
    files: Sequence[Path], options: LidarOptions, chunk_bytes: int, tally: StreamTally | None = None
) -> Iterator[PacketBlock]:
    return read_packets(
        files,
        any_product=options.model.lower() != "auto",
        data_port=options.data_port,
        position_port=options.position_port,
        tally=tally,
        chunk_bytes=chunk_bytes,
    )


def _count(block: PacketBlock, options: LidarOptions, counters: ArrayI) -> ArrayI:
    points = np.empty(block.payload.shape[0], dtype=np.int64)
    low, high = options.range_ticks
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
    InputError : a file is missing or no capture, there are no VLP-16 packets, or two lidars are mixed.
    UnsupportedError : the packets are of another model.
    """
    options = LidarOptions() if options is None else options
    paths = [Path(f) for f in files]
    if not paths:
        raise InputError("no lidar files", expected="at least one log", cure="Set logs.lidar")
    tally, clock, findings = StreamTally(), ClockBuilder(), Findings()
    clock.file_starts = findings.parts.file_starts = tally.file_starts
    counters = np.zeros(N_COUNTERS, dtype=np.int64)
    n_points = 0
    for block in _packets(paths, options, chunk_bytes, tally):
        n_points += int(_count(block, options, counters).sum())
        findings.feed(block)
        clock.feed(block)
    where = ", ".join(str(p) for p in paths)
    if findings.n_packets == 0:
        raise no_packets(tally.capture, options.data_port, where)
    model, disagreement = choose_model(options.model, findings.product, where)
    check_senders(findings.senders, where)
    if findings.n_kept == 0:
        raise no_packets(tally.capture, options.data_port, where, findings)
    finished = clock.finish()
    report = IntegrityReport(
        stream="lidar",
        format=f"Velodyne packets, {' + '.join(dict.fromkeys(tally.formats))}",
        files=[str(p) for p in paths],
        model=model,
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
        model=model,
        return_mode=findings.return_mode,
        n_points=n_points,
    )


def iter_points(
    files: Sequence[Path],
    options: LidarOptions | None = None,
    clock: LidarClock | None = None,
    max_points: int = 1_000_000,
    chunk_bytes: int = CHUNK_BYTES,
) -> Iterator[PointBlock]:
    """Points of a recording, block by block, in stream order.

    Parameters
    ----------
    files, options : as given to `scan_lidar`.
    clock : from `scan_lidar`; without it the files are scanned first.
    max_points : no block is larger (at least 384, the most that one packet holds).
    chunk_bytes : bytes read at a time.

    Raises
    ------
    InputError, UnsupportedError : as `scan_lidar`.
    """
    options = LidarOptions() if options is None else options
    paths = [Path(f) for f in files]
    if clock is None:
        clock = scan_lidar(paths, options, chunk_bytes).clock
    limit = max(int(max_points), _MIN_BLOCK_POINTS)
    counters = np.zeros(N_COUNTERS, dtype=np.int64)
    rate = 40.0
    for block in _packets(paths, options, chunk_bytes):
        points = _count(block, options, counters)
        packet = block.first_packet + np.arange(points.size)
        t_device_s = block.t_us * 1e-6 + clock.extra_s(packet)
        offset_s = clock.offset_s(packet)
        total = np.cumsum(points)
        start = 0
        while start < points.size:
            done = int(total[start - 1]) if start else 0
            stop = max(start + 1, int(np.searchsorted(total, done + limit, side="right")))
            piece = slice(start, stop)
            out, rate = _decode(
                block, piece, points[piece], t_device_s[piece], offset_s[piece], options, rate
            )
            if out.n:
                yield out
            start = stop


def _decode(
    block: PacketBlock,
    piece: slice,
    points: ArrayI,
    t_device_s: ArrayF,
    offset_s: ArrayF,
    options: LidarOptions,
    rate: float,
) -> tuple[PointBlock, float]:
    out = empty_points(int(points.sum()))
    low, high = options.range_ticks
    rate = decode(
        block.payload[piece],
        points,
        block.first_packet + int(piece.start),
        t_device_s,
        offset_s,
        BLOCK_S,
        SHOT_TABLE,
        vertical_offset_m(options.vertical_corrections),
        RETURNS[options.returns],
        low,
        high,
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
