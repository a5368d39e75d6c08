"""Ouster lidars: captures beside their metadata, read through the maker's ``ouster-sdk`` (extra ``ouster``).

The frame ``scs`` has the axes of every lidar here, x right, y forward, z up; Ouster's sensor frame has x
forward (away from the connector), y left, z up. The SDK applies the factory calibration of the metadata.

Times of columns are nanoseconds of a clock that the metadata names: the internal oscillator (no GPS time),
sync pulses with NMEA (UTC, Unix time), or PTP (IEEE 1588: TAI; software masters often distribute UTC: which
of both it is shows beside the host's stamps, 37 s apart).
Source: Ouster Firmware User Manual 3.1, "Time Synchronization"; Ouster SDK 1.0, "Lidar Packet Format".
"""

import math
import sys
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.core import (
    ArrayI,
    InputError,
    UnsupportedError,
    gps_from_unix,
    gps_from_week,
    gps_minus_utc,
    read_json,
)
from thalweg.ingest.integrity import Gap, IntegrityReport
from thalweg.ingest.readers import LidarClock, LidarOptions, LidarScan, LogWindow, PointBlock

PORT: Final = 7502
"""UDP port that an Ouster sends lidar packets to unless it is told another."""

_TAI_MINUS_GPS_S: Final = 19.0
_GPS_EPOCH_UNIX_S: Final = 315_964_800
_SET_S: Final = 1e9
"""A clock that was never set counts from its start; one that was is beyond 2001."""
_SAME_S: Final = 10.0
"""A host clock is not more wrong than that, and TAI is 37 s ahead of UTC."""


def is_ouster_capture(head: bytes, size: int) -> bool:
    """True if UDP packets of the head go to Ouster's port; classic pcap or pcapng over Ethernet and IPv4."""
    port = PORT.to_bytes(2, "big")
    at = head.find(b"\x08\x00\x45")
    while at >= 0 and at + 26 <= len(head):
        if head[at + 11] == 17 and head[at + 24 : at + 26] == port:
            return True
        at = head.find(b"\x08\x00\x45", at + 1)
    return False


def is_ouster_metadata(head: bytes, size: int) -> bool:
    """True if a text is the metadata of an Ouster."""
    return b'"beam_altitude_angles"' in head and b'"lidar_origin_to_beam_origin_mm"' in head


def metadata_of(files: Sequence[Path]) -> Path:
    """The metadata of a recording: a JSON file among its files, or beside them with the begin of their name.

    Raises
    ------
    InputError : there is none.
    """
    given = [path for path in files if path.suffix.lower() == ".json"]
    captures = [path for path in files if path not in given]
    beside = [
        path
        for path in sorted(captures[0].parent.glob("*.json") if captures else [])
        if captures[0].stem.startswith(path.stem) and is_ouster_metadata(path.read_bytes()[:65_536], 0)
    ]
    if len(given) > 1 or not (given or beside):
        raise InputError(
            f"{len(given) or 'no'} metadata files beside an Ouster capture",
            expected="one JSON file of the sensor: without it packets cannot be decoded",
            where=", ".join(map(str, files)),
            cure="Save it from the sensor (http://SENSOR/api/v1/sensor/metadata) and name it in logs.lidar",
        )
    return given[0] if given else max(beside, key=lambda path: len(path.stem))


def describe_metadata(path: Path) -> IntegrityReport:
    """What the metadata of an Ouster say about it."""
    data = read_json(path, "metadata of an Ouster")
    info = data.get("sensor_info", data) if isinstance(data, dict) else None
    if not isinstance(info, dict):
        raise InputError("JSON without keys", expected="metadata of an Ouster", where=path)
    report = IntegrityReport.of("lidar", "Ouster metadata", [path])
    report.model = str(info.get("prod_line", ""))
    report.note("The metadata of a lidar: name it in logs.lidar beside its captures.")
    return report


def _sdk() -> tuple[Any, Any]:
    """Modules ``core`` and ``pcap`` of the SDK."""
    try:
        from ouster.sdk import core, pcap
    except ImportError as error:
        raise UnsupportedError(
            f"a recording of an Ouster, and its reader is not installed ({error})",
            expected="ouster-sdk 1.0 or later",
            cure=f'Run: {sys.executable} -m pip install "ouster-sdk>=1.0" (it puts back click, psutil and '
            "Flask; pip then warns of snakefmt and ipython, and surveys run as before)",
        ) from error
    return core, pcap


@dataclass(frozen=True, slots=True, kw_only=True)
class OusterReader:
    """A recording of an Ouster: a `thalweg.ingest.readers.LidarReader`.

    ``files`` are captures in the order of time and the metadata among them or beside; ``options`` as for
    every lidar, but for model, ports and vertical corrections, which are in the metadata.
    """

    files: Sequence[Path]
    options: LidarOptions

    def _info(self) -> Any:
        core, _ = _sdk()
        path = metadata_of(self.files)
        try:
            return core.SensorInfo(path.read_text(encoding="utf-8"))
        except (RuntimeError, ValueError) as error:
            raise InputError(
                f"metadata that the SDK refuses: {error}", expected="metadata of an Ouster", where=path
            ) from error

    def _frames(self, errors: Counter[str] | None = None) -> Iterator[Any]:
        _, pcap = _sdk()
        meta = [str(metadata_of(self.files))]
        for path in self.files:
            if path.suffix.lower() == ".json":
                continue
            if not path.is_file():
                raise InputError("file not found", where=path, cure="Check the path")
            try:
                source = pcap.PcapFrameSetSource(str(path), meta=meta)
                for frames in source:
                    yield from (frame for frame in frames if frame is not None)
            except (RuntimeError, ValueError) as error:
                raise InputError(
                    f"the SDK cannot read it: {error}", expected="a capture of this Ouster", where=path
                ) from error
            if errors is not None:
                errors["packets_of_another_sensor"] += source.id_error_count
                errors["packets_of_wrong_size"] += source.size_error_count
            source.close()

    def _cut(self, port: int) -> str:
        """Whether the capture cut the packets, in words: the SDK passes over such packets in silence."""
        from thalweg.ingest.pcap import CaptureTally, Stream, read_payloads

        core, _ = _sdk()
        tally = CaptureTally()
        streams = [Stream(port=port, size=core.PacketFormat(self._info()).lidar_packet_size)]
        for path in self.files:
            if path.suffix.lower() != ".json":
                deque(read_payloads(path, streams, tally=tally), maxlen=0)
        return tally.cut_in_words()

    def scan(self) -> LidarScan:
        """Read the recording once.

        Raises
        ------
        InputError : a file is missing or damaged, there are no metadata, or no packets of the sensor.
        UnsupportedError : the SDK is not installed.
        """
        info, errors = self._info(), Counter[str]()
        report = IntegrityReport.of(
            "lidar",
            f"Ouster packets ({info.format.udp_profile_lidar}), ouster-sdk",
            self.files,
            model=str(info.prod_line),
            bytes_read=sum(path.stat().st_size for path in self.files if path.is_file()),
        )
        tally = _Tally(info)
        n_points = 0
        for frame in self._frames(errors):
            tally.feed(frame)
            n_points += sum(part.n for part in _points(frame, info, self.options, LidarClock(), 0, None))
        if not tally.frames:
            port = info.config.udp_port_lidar or PORT
            cut = self._cut(port)
            raise InputError(
                f"no lidar packet is whole: {cut}"
                if cut
                else "no lidar packets of the sensor that the metadata name",
                expected=f"packets of a {info.prod_line} on UDP port {port}",
                where=", ".join(report.files),
                cure="Capture with -s 0 (tcpdump), that is without a limit of the packets' length"
                if cut
                else "Check that metadata and capture belong together",
            )
        clock = _clock(info, tally, report)
        report.count("points", n_points)
        tally.write(report, clock)
        for name, n in errors.items():
            report.lose(name, n)
        mode = "dual" if info.num_returns > 1 else "strongest"
        report.details["return_mode"] = mode
        return LidarScan(report=report, clock=clock, model=report.model, return_mode=mode, n_points=n_points)

    def length_s(self) -> float:
        """Not known: the SDK would have to read all of it."""
        return math.nan

    def points(
        self, clock: LidarClock | None = None, *, max_points: int = 1_000_000, window: LogWindow | None = None
    ) -> Iterator[PointBlock]:
        """Points, a frame at a time or less, in the order of columns.

        Raises
        ------
        UnsupportedError : a window is asked for.
        """
        if window is not None:
            raise UnsupportedError("a window of an Ouster's recording", expected="all of it in one part")
        info = self._info()
        clock = self.scan().clock if clock is None else clock
        core, _ = _sdk()
        lut = core.XYZLut(info)
        packet = 0
        for frame in self._frames():
            for block in _points(frame, info, self.options, clock, packet, lut, max_points):
                if block.n:
                    yield block
            packet += len(frame.packet_timestamp)


def _points(
    frame: Any,
    info: Any,
    options: LidarOptions,
    clock: LidarClock,
    first_packet: int,
    lut: Any,
    max_points: int = 1_000_000,
) -> Iterator[PointBlock]:
    """Points of a frame in pieces of whole columns; without ``lut`` their places are left out."""
    names = ["RANGE", "RANGE2"] if "RANGE2" in frame.fields else ["RANGE"]
    valid = (np.asarray(frame.status) & 1).astype(bool)
    # (columns, rows, returns), nearer return first
    range_mm = np.stack([np.asarray(frame.field(name), dtype=np.int64).T for name in names], axis=-1)
    brightness = np.stack(
        [np.asarray(frame.field(name.replace("RANGE", "REFLECTIVITY"))).T for name in names], axis=-1
    )
    places = None
    if lut is not None:
        parts = [np.swapaxes(np.asarray(lut(np.asarray(frame.field(name)))), 0, 1) for name in names]
        places = np.stack(parts, axis=-2)
    there = (range_mm > 0) & valid[:, None, None]
    n_returns = there.sum(axis=-1)
    swapped = np.where(there, range_mm, np.iinfo(np.int64).max)
    number = np.argsort(np.argsort(swapped, axis=-1, kind="stable"), axis=-1, kind="stable") + 1
    wanted = there & (range_mm >= 1000 * options.min_range_m) & (range_mm <= 1000 * options.max_range_m)
    if options.returns == "strongest":
        wanted[..., 1:] = False  # the SDK's first return is the strongest by default
    elif options.returns == "last":
        wanted &= number == n_returns[..., None]
    rows = range_mm.shape[1]
    ring = np.argsort(np.argsort(np.asarray(info.beam_altitude_angles)))
    t_s = np.asarray(frame.timestamp, dtype=np.float64) * 1e-9
    step = max(1, max_points // (rows * len(names)))
    for start in range(0, len(t_s), step):
        column, row, which = np.nonzero(wanted[start : start + step])
        column += start
        packet = first_packet + column // info.format.columns_per_packet
        xyz = np.zeros((len(column), 3), dtype=np.float32)
        if places is not None:
            ouster = places[column, row, which]
            xyz[:, 0], xyz[:, 1], xyz[:, 2] = -ouster[:, 1], ouster[:, 0], ouster[:, 2]
        yield PointBlock(
            t_gps_s=t_s[column] + clock.offset_s(packet),
            t_device_s=t_s[column],
            xyz_scs_m=xyz,
            range_m=(range_mm[column, row, which] * 1e-3).astype(np.float32),
            azimuth_rad=np.mod(np.arctan2(xyz[:, 0], xyz[:, 1]), np.float32(2 * np.pi)),
            ring=ring[row].astype(np.uint8),
            laser=row.astype(np.uint8),
            intensity=np.minimum(brightness[column, row, which], 255).astype(np.uint8),
            return_number=number[column, row, which].astype(np.uint8),
            n_returns=n_returns[column, row].astype(np.uint8),
            packet=packet,
        )


class _Tally:
    """Frames, columns and what is missing of them, while they stream by."""

    def __init__(self, info: Any) -> None:
        self.info = info
        self.frames = self.columns = self.end = 0
        self.returns = Counter[str]()
        self.first_s = self.last_s = math.nan
        self.host: list[tuple[float, float]] = []
        self.missing: list[ArrayI] = []
        self.starts: list[float] = []

    def feed(self, frame: Any) -> None:
        """Take in the next frame."""
        first, last = self.info.format.column_window
        width = len(frame.status)
        window = (np.arange(width) - first) % width <= (last - first) % width
        valid = (np.asarray(frame.status) & 1).astype(bool) & window
        if not valid.any():
            return
        t_s = np.asarray(frame.timestamp, dtype=np.int64)[valid] * 1e-9
        self.frames += 1
        self.columns += int(valid.sum())
        self.missing.append(np.flatnonzero(window & ~valid))
        if self.frames == 1:
            # what lies before the begin of the recording is no loss
            self.missing[0] = self.missing[0][self.missing[0] > int(np.argmax(valid))]
            self.first_s = float(t_s[0])
        self.end = int(np.flatnonzero(valid)[-1])
        self.last_s = float(t_s[-1])
        self.starts.append(float(t_s[0]))
        for name in ("RANGE", "RANGE2"):
            if name in frame.fields:
                n = int(np.count_nonzero(np.asarray(frame.field(name))[:, valid]))
                self.returns[name] += n
        stamps = np.asarray(frame.packet_timestamp, dtype=np.int64)
        got = np.flatnonzero(stamps)
        if got.size:
            column = min(int(got[0]) * self.info.format.columns_per_packet, width - 1)
            self.host.append((float(frame.timestamp[column]) * 1e-9, float(stamps[got[0]]) * 1e-9))

    def write(self, report: IntegrityReport, clock: LidarClock) -> None:
        """Put counts, losses, gaps and times into the report."""
        self.missing[-1] = self.missing[-1][self.missing[-1] < self.end]
        report.count("frames", self.frames)
        report.count("columns", self.columns)
        for name, words in (("RANGE", "first_returns"), ("RANGE2", "second_returns")):
            report.count_some(words, self.returns[name])
        lost = sum(part.size for part in self.missing)
        report.lose("columns_lost", lost)
        offset = float(clock.gps_minus_device_s[0])
        shift = offset if report.synchronised else 0.0
        report.t_first_s, report.t_last_s = self.first_s + shift, self.last_s + shift
        starts = np.array(self.starts)
        if len(starts) > 1:
            step = np.diff(starts)
            turn = float(np.median(step))
            report.rates_hz["frames"] = 1.0 / turn
            for i in np.flatnonzero(step > 1.5 * turn):
                n = round(float(step[i]) / turn) - 1
                report.gaps.append(Gap(t_start_s=starts[i] + turn + shift, duration_s=step[i] - turn, lost=n))
                report.lose("frames_lost_estimated", n)
            if np.any(step < 0):
                report.lose("clock_set_back", int((step < 0).sum()))
        report.timing.describe_stamps(starts + shift)
        if report.synchronised and self.host:
            device, host = np.array(self.host).T
            report.timing.describe_host(device + offset, host)
        report.timing.unsynchronised_s = 0.0 if report.synchronised else self.last_s - self.first_s


def _clock(info: Any, tally: _Tally, report: IntegrityReport) -> LidarClock:
    """GPS time from the sensor's, by the mode that its metadata state."""
    mode = str(info.config.timestamp_mode or "").rsplit(".", 1)[-1]
    offset, t = math.nan, tally.first_s
    if mode == "TIME_FROM_SYNC_PULSE_IN" and t > _SET_S:
        leap = float(info.config.nmea_leap_seconds or 0)
        offset = float(gps_from_unix(t - leap)) - t
        report.time_scale = "utc"
    elif mode == "TIME_FROM_PTP_1588" and t > _SET_S:
        ahead = float(np.median([device - host for device, host in tally.host])) if tally.host else math.nan
        tai_minus_utc = float(gps_minus_utc(t)) + _TAI_MINUS_GPS_S
        if abs(ahead - tai_minus_utc) < _SAME_S:
            offset = float(gps_from_week(0, t - _GPS_EPOCH_UNIX_S - _TAI_MINUS_GPS_S)) - t
            report.time_scale = "gps"
        elif abs(ahead) < _SAME_S:
            offset = float(gps_from_unix(t)) - t
            report.time_scale = "utc"
    report.details["time_mode"] = mode or "not stated"
    report.synchronised = math.isfinite(offset)
    if not report.synchronised:
        report.time_scale = "device"
        why = {
            "": "the metadata do not state where its time comes from",
            "TIME_FROM_INTERNAL_OSC": "its time is that of the internal oscillator",
            "TIME_FROM_SYNC_PULSE_IN": "no NMEA sentence set its clock",
            "TIME_FROM_PTP_1588": "its PTP time is neither TAI nor UTC by the stamps of the capture",
        }.get(mode, f"its time mode {mode} is not known")
        report.note(f"The lidar is unsynchronised: {why}. Its points have no GPS time.")
    return LidarClock(gps_minus_device_s=(offset,))
