"""Formats of lidars, and the reader of a recording."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from thalweg.ingest import (
    LidarClock,
    LidarOptions,
    LidarReader,
    LidarScan,
    OusterReader,
    PointBlock,
    PositionLog,
    TrackOptions,
    describe_metadata,
    is_ouster_capture,
    is_ouster_metadata,
)
from thalweg.ingest.recorders import (
    BagLidar,
    describe_bag,
    is_bag,
    mounts_of_bag as mounts_of_bag,
    packets_of_bag,
    read_bag_depths,
    read_bag_poses,
    read_bag_positions,
    streams_of_bag,
)
from thalweg.ingest.registry.base import Format, find_format

_PAYLOAD = 1206
_PCAP: Final = (
    b"\xd4\xc3\xb2\xa1",
    b"\xa1\xb2\xc3\xd4",
    b"\x4d\x3c\xb2\xa1",
    b"\xa1\xb2\x3c\x4d",
    b"\x0a\x0d\x0d\x0a",
)


def lidar_reader(files: Sequence[Path], options: LidarOptions | None = None) -> LidarReader:
    """The reader for a recording.

    Parameters
    ----------
    files : parts of one recording in the order of time.
    options : how to decode them.
    """
    paths, chosen = [Path(path) for path in files], options or LidarOptions()
    for path in paths:
        known = find_format(LIDARS, path) if path.is_file() and path.stat().st_size else None
        if known is not None and known.lidar is not None:
            return known.lidar(paths, chosen)
    return _velodyne(paths, chosen)  # which says what it finds instead


def _velodyne(files: Sequence[Path], options: LidarOptions) -> LidarReader:
    from thalweg.ingest.velodyne import VelodyneReader

    return VelodyneReader(files=files, options=options)


def _ouster(files: Sequence[Path], options: LidarOptions) -> LidarReader:
    return OusterReader(files=files, options=options)


def _bag(files: Sequence[Path], options: LidarOptions) -> LidarReader:
    maker, captures = "", list[Path]()
    for path in files:
        maker, found = packets_of_bag(path, options.topics)
        captures += [each for each in found if each.suffix != ".json" or not captures]
    if not maker:
        return BagLidar(files=files, options=options)
    return _OfPackets(files=files, reader=(_ouster if maker == "ouster" else _velodyne)(captures, options))


@dataclass(frozen=True, slots=True, kw_only=True)
class _OfPackets:
    """Packets of a bag in the words of their own reader, but for the names of files."""

    files: Sequence[Path]
    reader: LidarReader

    def scan(self) -> LidarScan:
        """As of every lidar."""
        scan = self.reader.scan()
        scan.report.files = [str(path) for path in self.files]
        scan.report.bytes_read = sum(path.stat().st_size for path in self.files)
        scan.report.format += ", in a bag of ROS"
        return scan

    def length_s(self) -> float:
        """As of every lidar."""
        return self.reader.length_s()

    def points(self, clock: LidarClock | None = None, **how: Any) -> Iterator[PointBlock]:
        """As of every lidar."""
        return self.reader.points(clock, **how)


def _describe_bag(kind: str, files: list[Path], options: dict[str, Any]) -> PositionLog:
    found = PositionLog(report=describe_bag(files[0]))
    streams = streams_of_bag(files[0])
    on_earth = [(imu, fix) for imu, *fixes in streams.get("ins", []) for fix in fixes]
    for choices, reader in (
        (streams.get("depth", []), read_bag_depths),
        (streams.get("pos", []), read_bag_positions),
        (on_earth, read_bag_poses),
    ):
        if len(choices) == 1:  # of several the reader would ask which
            log = reader(files, TrackOptions())
            found.positions, found.depths = log.positions, log.depths
    return found


def _is_payloads(head: bytes, size: int) -> bool:
    starts = range(0, min(len(head), 8 * _PAYLOAD) - 2, _PAYLOAD)
    return len(head) >= _PAYLOAD and all(head[i : i + 2] == b"\xff\xee" for i in starts)


BAG: Final = Format(
    kind="rosbag",
    words="bag of ROS (bag, db3, mcap)",
    streams=("lidar", "ins", "pos", "depth"),
    holds=streams_of_bag,
    matches=is_bag,
    lidar=_bag,
    poses=read_bag_poses,
    positions=read_bag_positions,
    depths=read_bag_depths,
    describe=_describe_bag,
)
"""A bag is a row of lidars, of poses and of positions."""

LIDARS: Final = (
    BAG,
    Format(
        kind="ouster",
        words="Ouster capture (pcap, pcapng)",
        streams=("lidar",),
        magic=_PCAP,
        matches=is_ouster_capture,
        lidar=_ouster,
    ),
    Format(
        kind="ouster_metadata",
        words="metadata of an Ouster (JSON)",
        streams=("lidar",),
        matches=is_ouster_metadata,
        lidar=_ouster,
        describe=lambda kind, files, options: PositionLog(report=describe_metadata(files[0])),
    ),
    Format(
        kind="capture",
        words="network capture (pcap, pcapng)",
        streams=("lidar",),
        magic=_PCAP,
        lidar=_velodyne,
    ),
    Format(
        kind="velodyne_payloads",
        words="bare Velodyne payloads",
        streams=("lidar",),
        matches=_is_payloads,
        lidar=_velodyne,
    ),
)
