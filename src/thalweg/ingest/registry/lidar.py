"""Formats of lidars, and the reader of a recording."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.ingest import (
    LidarOptions,
    LidarReader,
    OusterReader,
    TrackOptions,
    describe_metadata,
    is_ouster_capture,
    is_ouster_metadata,
)
from thalweg.ingest.recorders import (
    BagLidar,
    describe_bag,
    has_velodyne_packets,
    is_bag,
    read_bag_poses,
    read_bag_positions,
    streams_of_bag,
    velodyne_capture,
)
from thalweg.ingest.registry.base import Format, Recording, find_format

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
    if all(has_velodyne_packets(path) for path in files):
        return _velodyne([velodyne_capture(path) for path in files], options)
    return BagLidar(files=files, options=options)


def _describe_bag(kind: str, files: list[Path], options: dict[str, Any], points: bool) -> Recording:
    recording = Recording(kind=kind, report=describe_bag(files[0]))
    streams = streams_of_bag(files[0])
    if points and "lidar" in streams:
        recording = replace(_describe(kind, files, options, points), report=recording.report)
    for stream, reader in (("ins", read_bag_poses), ("pos", read_bag_positions)):
        if stream in streams:
            log = reader(files, TrackOptions())
            tables = {
                "positions": log.positions,
                "depths": log.depths,
                "states": getattr(log, "states", None),
            }
            recording.tables |= {name: table for name, table in tables.items() if table is not None}
    return recording


def _describe_metadata(kind: str, files: list[Path], options: dict[str, Any], points: bool) -> Recording:
    return Recording(kind=kind, report=describe_metadata(files[0]))


def _describe(kind: str, files: list[Path], options: dict[str, Any], points: bool) -> Recording:
    reader = lidar_reader(files, LidarOptions(**options))
    scan = reader.scan()
    recording = Recording(kind=kind, report=scan.report)
    if points:
        blocks = list(reader.points(scan.clock))
        if blocks:
            recording.points_scs_m = np.concatenate([b.xyz_scs_m for b in blocks])
            recording.intensity = np.concatenate([b.intensity for b in blocks])
            recording.ring = np.concatenate([b.ring for b in blocks])
    return recording


def _is_payloads(head: bytes, size: int) -> bool:
    starts = range(0, min(len(head), 8 * _PAYLOAD) - 2, _PAYLOAD)
    return len(head) >= _PAYLOAD and all(head[i : i + 2] == b"\xff\xee" for i in starts)


BAG: Final = Format(
    kind="rosbag",
    words="bag of ROS (bag, db3, mcap)",
    streams=("lidar", "ins", "pos", "depth"),
    matches=is_bag,
    lidar=_bag,
    poses=read_bag_poses,
    positions=read_bag_positions,
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
        describe=_describe,
    ),
    Format(
        kind="ouster_metadata",
        words="metadata of an Ouster (JSON)",
        streams=("lidar",),
        matches=is_ouster_metadata,
        lidar=_ouster,
        describe=_describe_metadata,
    ),
    Format(
        kind="capture",
        words="network capture (pcap, pcapng)",
        streams=("lidar",),
        magic=_PCAP,
        lidar=_velodyne,
        describe=_describe,
    ),
    Format(
        kind="velodyne_payloads",
        words="bare Velodyne payloads",
        streams=("lidar",),
        matches=_is_payloads,
        lidar=_velodyne,
        describe=_describe,
    ),
)
