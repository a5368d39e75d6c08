"""Bags of ROS 1 (``.bag``) and ROS 2 (``.db3``, ``.mcap``), read by ``rosbags`` (extra ``ros``).

One file holds many topics; each stream of a survey takes those of its type: clouds of a lidar (PointCloud2,
Livox CustomMsg, else packets of a Velodyne or an Ouster), poses (Imu beside NavSatFix, else Odometry,
PoseStamped, PoseWithCovarianceStamped), positions (NavSatFix), depths (Range). Where several topics could be
meant, the choice is asked for: ``file.bag#/topic``.

Stamps are those of the headers, Unix time of the computer or of a sensor that it disciplines, taken as UTC;
where the recorder's clock says otherwise (a replay), a note tells. Bodies and clouds have axes forward, left,
up (REP 103), scs has right, forward, up. An Imu's attitude is against east, north, up (REP 145). The fixed
frame of Odometry and poses is taken for the local frame at the campaign's origin (REP 105: x east, y north).
Source: ROS message definitions sensor_msgs; drivers of Velodyne, Ouster, Hesai, Livox, RoboSense and Luminar
for the names of fields.
"""

import atexit
import math
import re
import struct
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from thalweg.core import (
    AnyArray,
    ArrayB,
    ArrayF,
    InputError,
    frame_of,
    gps_from_unix,
    missing_package,
    opk_of,
    roll_pitch_heading,
    utc_text_from_unix,
)
from thalweg.ingest import (
    DEPTH,
    GNSS_POSITION,
    INS_STATE,
    NAVIGATION_INITIALISED,
    IntegrityReport,
    LidarClock,
    LidarOptions,
    LidarScan,
    LogWindow,
    PointBlock,
    PoseLog,
    PositionLog,
    TrackOptions,
    interpolated,
    is_ouster_metadata,
)
from thalweg.ingest.tracks import BODY_AXES, TextPoses, states_of_poses

_CLOUDS: Final = (
    "sensor_msgs/msg/PointCloud2",
    "livox_ros_driver/msg/CustomMsg",
    "livox_ros_driver2/msg/CustomMsg",
)
_VELODYNE: Final = "velodyne_msgs/msg/VelodyneScan"
_FIXES: Final = "sensor_msgs/msg/NavSatFix"
_IMU: Final = "sensor_msgs/msg/Imu"
_RANGE: Final = "sensor_msgs/msg/Range"
_POSES: Final = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/PoseStamped",
)
_IMAGES: Final = ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image")
_CHANNELS: Final = {"mono8": ("L", 1), "8UC1": ("L", 1), "rgb8": ("RGB", 1), "bgr8": ("RGB", -1)}
"""Encodings of whole pictures: mode of Pillow, order of the channels; others are patterns of a chip."""
_MEND: Final = "Mend it: rosbag reindex (ROS 1), ros2 bag reindex (ROS 2), mcap recover"
_ENDINGS: Final = {b"\xff\xd8": ".jpg", b"\x89P": ".png"}
"""By the first bytes of a compressed image."""
_OUSTER: Final = ("ouster_ros/msg/PacketMsg", "ouster_sensor_msgs/msg/PacketMsg")
_TEXT: Final = "std_msgs/msg/String"
_MOUNTING: Final = "tf2_msgs/msg/TFMessage"
_NOT_READ: Final = {
    "pandar_msgs/msg/PandarScan": "Packets of a Hesai are not read: play them to PointCloud2 by its driver"
}
"""Raw packets of drivers, and what to do with them."""
_VELODYNE_PACKET: Final = "builtin_interfaces/Time stamp\nuint8[1206] data\n"
_VELODYNE_SCAN: Final = "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n"
_LIVOX: Final = """std_msgs/Header header
uint64 timebase
uint32 point_num
uint8 lidar_id
uint8[3] rsvd
{package}/CustomPoint[] points
"""
_LIVOX_POINT: Final = (
    "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line\n"
)
_TYPES: Final = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""Numbers of types in PointField."""
_FIX_STATUS: Final = {-1: "none", 0: "single", 1: "sbas", 2: "dgnss"}
_TO_FORWARD_LEFT_UP: Final = {
    "lidar": np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "antenna": np.eye(3),
    "echo_sounder": np.eye(3),
}
"""Axes of a sensor here (scs: right, forward, up) into those of ROS; of a mere point none count."""
_UNIT: Final = 0.01
"""Squares of a quaternion differ less than this from 1, or it is none."""
_BODY: Final = np.diag([1.0, -1.0, -1.0])
"""Body of ROS (forward, left, up) into ics (forward, right, down), and back."""
_ADDRESSES: Final = b"\xc0\xa8\x01\xc9" + b"\xff" * 4
_ABSOLUTE_NS: Final = 1e15
_LIVOX_ROW: Final = np.dtype(
    [("offset_time", "u4"), ("x", "f4"), ("y", "f4"), ("z", "f4"), ("reflectivity", "u1"), ("line", "u1")]
)
_FIXED_FRAMES: Final = frozenset({"map", "odom", "world", "earth", "utm", "camera_init"})
"""Frames of REP 105 and of programs of odometry that stand still."""
_TIME_FIELDS: Final = (
    "timestamp", "time_stamp", "offset_time", "time_offset", "time_offset_ns", "time", "t"
)  # fmt: skip
_TIME_UNITS_S: Final = {1.0: "seconds", 1e-3: "milliseconds", 1e-6: "microseconds", 1e-9: "nanoseconds"}
_DATED_S: Final = (1e9, 4e9)
"""Unix times of lidars, 2001 to 2096."""
_DEVICE_S: Final = 1e3
"""A header later than this is told from an offset."""
_TURN_S: Final = 2.5
"""No lidar takes longer for a cloud."""
_POINTS_A_SECOND: Final = 5e7
"""No lidar measures more."""
_FINE_S: Final = 1e-3
_REPLAYED_S: Final = 5.0
_GRAVITY_MPS2: Final = 9.81
_TILTED_DEG: Final = 20.0
"""Accelerations of a boat point up within this in the median; other axes are 90 or 180 degrees off."""


def is_bag(head: bytes, size: int) -> bool:
    """True for bags of ROS 1, sqlite bags of ROS 2 and MCAP."""
    sqlite = head.startswith(b"SQLite format 3\0") and b"topics" in head and b"messages" in head
    return sqlite or head.startswith((b"#ROSBAG V2.0", b"\x89MCAP0\r\n"))


@lru_cache(maxsize=1)
def _types() -> Any:
    """Definitions of messages, for bags that hold none (ROS 2 before Iron)."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(_VELODYNE_PACKET, "velodyne_msgs/msg/VelodynePacket"))
    store.register(get_types_from_msg(_VELODYNE_SCAN, _VELODYNE))
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _MOUNTING))
    for kind in _OUSTER:
        store.register(get_types_from_msg("uint8[] buf\n", kind))
    for package in ("livox_ros_driver", "livox_ros_driver2"):
        store.register(get_types_from_msg(_LIVOX_POINT, f"{package}/msg/CustomPoint"))
        store.register(get_types_from_msg(_LIVOX.format(package=package), f"{package}/msg/CustomMsg"))
    return store


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        from rosbags.highlevel import AnyReader
    except ImportError as error:
        raise missing_package(error, path) from error
    try:
        reader = AnyReader([path], default_typestore=_types())
        reader.open()
    except Exception as error:  # of damaged bags it raises whatever its bytes lead to
        raise InputError(
            f"the bag cannot be opened ({error or type(error).__name__})",
            expected="a whole bag",
            where=path,
            cure=_MEND
            if path.suffix in (".bag", ".db3", ".mcap")
            else "Give it the ending of its kind: .bag, .db3 or .mcap",
        ) from error
    try:
        yield reader
    finally:
        reader.close()


def _held(path: Path) -> dict[str, tuple[str, int]]:
    """Type and number of messages of each topic of a bag."""
    about = path.stat()
    return _held_of(path, about.st_size, about.st_mtime_ns)


@lru_cache(maxsize=8)
def _held_of(path: Path, size: int, mtime_ns: int) -> dict[str, tuple[str, int]]:
    with _opened(path) as bag:
        found: dict[str, tuple[str, int]] = {}
        for each in bag.connections:
            found[each.topic] = each.msgtype, found.get(each.topic, ("", 0))[1] + each.msgcount
    return found


def _messages(
    path: Path, topic: str, report: IntegrityReport | None = None
) -> Iterator[tuple[float, float, Any]]:
    """Header stamp and time of recording, Unix seconds, and the message, of one topic.

    A message without header or stamp has the time of its recording twice.
    """
    with _opened(path) as bag:
        stored = bag.messages([each for each in bag.connections if each.topic == topic])
        while True:
            try:
                connection, t_ns, raw = next(stored)
            except StopIteration:
                return
            except Exception as error:  # as for the opening
                raise InputError(
                    f"the bag is damaged ({error or type(error).__name__})",
                    expected="a whole bag",
                    where=path,
                    cure=_MEND,
                ) from error
            try:
                message = bag.deserialize(raw, connection.msgtype)
            except (AssertionError, IndexError, KeyError, TypeError, ValueError, UnicodeDecodeError):
                if report is not None:
                    report.lose("damaged_messages", 1)
                continue
            recorded_s = stamp_s = t_ns * 1e-9
            if (header := getattr(message, "header", None)) is not None:
                stamp_s = header.stamp.sec + header.stamp.nanosec * 1e-9
                if stamp_s == 0.0:
                    stamp_s = recorded_s
                    if report is not None:
                        report.count("messages_without_stamp")
                elif report is not None and stamp_s < _DATED_S[0]:
                    raise InputError(
                        f"stamps of {topic} that count from elsewhere: {stamp_s:,.1f} s in the header",
                        expected="Unix time in the headers",
                        where=path,
                        cure="Let the driver stamp with the computer's clock (Ouster: timestamp_mode "
                        "TIME_FROM_ROS_TIME or PTP; no use_sim_time), or name another topic",
                    )
            yield stamp_s, recorded_s, message


# ---------------------------------------------------------------- which topic gives which stream


def _offers(held: Mapping[str, tuple[str, int]]) -> dict[str, list[list[tuple[str, ...]]]]:
    """Streams of ``logs``; for each, in the order of worth, lists of equals: topics that together give it."""

    def of(*kinds: str) -> list[str]:
        """Topics of these types that hold messages, the fullest first."""
        found = [name for name, (kind, n) in held.items() if kind in kinds and n]
        return sorted(found, key=lambda name: (-held[name][1], name))

    lidar = [of(*_CLOUDS), of(_VELODYNE), [name for name in of(*_OUSTER) if "imu" not in name]]
    offers: dict[str, list[list[tuple[str, ...]]]] = {
        "lidar": [[(name,) for name in equals] for equals in lidar],
        "ins": [[(imu, fix) for imu in of(_IMU) for fix in of(_FIXES)], [(name,) for name in of(*_POSES)]],
        "pos": [[(name,) for name in of(_FIXES)]],
        "depth": [[(name,) for name in of(_RANGE) if _looks_down(name)]],
    }
    return {stream: kept for stream, ranks in offers.items() if (kept := [each for each in ranks if each])}


def streams_of_bag(path: Path) -> dict[str, list[tuple[str, ...]]]:
    """Streams of ``logs`` that a bag gives, each with the topics that it may be read from.

    The first are those that are meant where none is named; positions stand beside no attitudes.
    """
    offers = {stream: ranks[0] for stream, ranks in _offers(_held(path)).items()}
    if "ins" in offers and len(offers["ins"][0]) > 1:
        del offers["pos"]
    return offers


def _chosen(path: Path, stream: str, topics: Sequence[str]) -> tuple[str, ...]:
    """Topics that a stream is read from: those that are named, else the only ones.

    Raises
    ------
    InputError : none, several, or a named one that the bag does not hold.
    """
    held = _held(path)
    offers = _offers(held)
    ranks = offers.get(stream, [])
    own = {name for name in topics if any(name in each for equals in ranks for each in equals)}
    among = [each for equals in ranks for each in equals if own <= set(each)] if own else (ranks or [[]])[0]
    # topics of a track stand for positions, attitudes and depths together
    near: tuple[str, ...] = ("lidar",) if stream == "lidar" else ("ins", "pos", "depth")
    known = {n for s in near for equals in offers.get(s, []) for each in equals for n in each}
    strange = [name for name in topics if name not in known]
    if len(among) == 1 and not strange:
        return among[0]
    listed = ", ".join(f"{name} ({kind.rsplit('/', 1)[-1]})" for name, (kind, _) in sorted(held.items()))
    unread = next((words for kind, words in _NOT_READ.items() if kind in dict(held.values())), "")
    words = {
        "lidar": "clouds",
        "ins": "poses (Imu with NavSatFix, Odometry)",
        "pos": "positions (NavSatFix)",
        "depth": "depths (Range)",
    }[stream]
    key = {"pos": "positions"}.get(stream, stream)
    raise InputError(
        f"no topic {strange[0]} of {words}; it holds {listed}"
        if strange
        else f"{len(among) or 'no'} topics of {words}; it holds {listed}",
        expected=f"one topic of {words}",
        where=path,
        cure=f"Name the one that is meant behind the file: logs.{key}: [{path.name}#{among[0][0]}]"
        if among
        else unread or "Record the topic, or take another bag",
    )


def describe_bag(path: Path) -> IntegrityReport:
    """Topics of a bag with their numbers of messages, and what of them can be read."""
    report = IntegrityReport.of("bag", "ROS bag", [path], bytes_read=path.stat().st_size, time_scale="host")
    held = _held(path)
    with _opened(path) as bag:
        report.t_first_s, report.t_last_s = (
            float(gps_from_unix(t * 1e-9)) for t in (bag.start_time, bag.end_time)
        )
    report.synchronised = True
    report.details["topics"] = {
        f"{name} ({kind.replace('/msg/', '/')})": n for name, (kind, n) in sorted(held.items())
    }
    report.count("messages", sum(n for _, n in held.values()))
    for kind, words in _NOT_READ.items():
        if kind in dict(held.values()):
            report.note(f"{words}.")
    streams = streams_of_bag(path)
    for stream, choices in streams.items():
        report.details[f"gives {stream}"] = " or ".join(" with ".join(each) for each in choices)
    report.details |= {f"mounting of {name}": words for name, words in mounts_of_bag(path).items()}
    if not streams:
        report.note("It holds nothing that Thalweg reads.")
    return report


def _looks_down(topic: str) -> bool:
    return any(word in topic.lower() for word in ("depth", "echo", "sonar", "altimeter", "ping", "sounder"))


def mounts_of_bag(path: Path) -> dict[str, str]:
    """Places of sensors on the body as ``/tf_static`` states them, in the words of ``mounts``.

    Of each sensor the frame of its first message counts, of the body that of the attitudes.
    """
    held = _held(path)
    tree: dict[str, tuple[str, ArrayF]] = {}
    for name, (kind, _) in held.items():
        if kind != _MOUNTING or "static" not in name:
            continue
        for _, _, message in _messages(path, name):
            for each in message.transforms:
                q, shift = _unit_of(each.transform.rotation), each.transform.translation
                if q is None:
                    continue
                step = np.eye(4)
                step[:3, :3] = Rotation.from_quat(q).as_matrix()
                step[:3, 3] = shift.x, shift.y, shift.z
                tree[each.child_frame_id] = each.header.frame_id, step

    def from_root(frame: str) -> tuple[str, ArrayF]:
        """Root of the tree that a frame hangs in, and the frame's place in it."""
        place = np.eye(4)
        for _ in tree:
            if frame in tree:
                frame, step = tree[frame]
                place = step @ place
        return frame, place

    offers = {stream: ranks[0][0] for stream, ranks in _offers(held).items()} if tree else {}
    topics = {"lidar": "lidar", "antenna": "pos", "echo_sounder": "depth"}
    frames = {
        sensor: _frame_of(path, offers[stream][-1]) for sensor, stream in topics.items() if stream in offers
    }
    body = _frame_of(path, offers["ins"][0]) if "ins" in offers else ""
    found = {}
    for sensor, frame in frames.items():
        (root, T_root_body), (other, T_root_sensor) = from_root(body), from_root(frame)
        if root != other or frame not in tree:
            continue
        T = np.linalg.inv(T_root_body) @ T_root_sensor
        lever = ", ".join(f"{x:.3f}" for x in _BODY @ T[:3, 3])
        found[sensor] = f"lever_ics_m: [{lever}]"
        if sensor == "lidar":
            turn = np.rad2deg(opk_of(_BODY @ T[:3, :3] @ _TO_FORWARD_LEFT_UP[sensor]))
            angles = zip(("omega", "phi", "kappa"), turn, strict=True)
            found[sensor] += "".join(f", {name}_deg: {x:.2f}" for name, x in angles)
    return found


def _unit_of(q: Any) -> list[float] | None:
    """A quaternion x, y, z, w; None if it is no unit one, as where nothing was measured."""
    own = [q.x, q.y, q.z, q.w]
    return own if abs(sum(x * x for x in own) - 1.0) < _UNIT else None


def _frame_of(path: Path, topic: str) -> str:
    """Frame of the body or sensor that the first message of a topic names."""
    message: Any = next((message for _, _, message in _messages(path, topic)), None)
    if child := getattr(message, "child_frame_id", ""):
        return str(child)
    return str(message.header.frame_id) if hasattr(message, "header") else ""


# ---------------------------------------------------------------- lidar


@dataclass(frozen=True, slots=True, kw_only=True)
class _Layout:
    """How the points of a topic are written, told from its first cloud that holds some.

    ``unit_s`` of the field ``time`` are a second; they count from 1970 (or as the header does) or from the
    header. Without times ``time`` is empty and ``why`` says what was found.
    """

    fields: Any
    dtype: np.dtype[Any]
    time: str
    unit_s: float
    from_header: bool
    why: str
    ring: str
    bright: str
    full: float
    """Brightness that 255 stands for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BagLidar:
    """Clouds of a lidar in bags: a `thalweg.ingest.readers.LidarReader`.

    ``files`` are bags in the order of time; of ``options`` ranges count, and the topics of several.
    """

    files: Sequence[Path]
    options: LidarOptions

    def _clouds(
        self, report: IntegrityReport | None = None
    ) -> Iterator[tuple[float, float, _Layout | None, Any]]:
        """Stamp, time of recording, layout and message; a cloud before any point is seen has no layout."""
        for path in self.files:
            (topic,) = _chosen(path, "lidar", self.options.topics)
            layout: _Layout | None = None
            for stamp_s, recorded_s, message in _messages(path, topic, report):
                if (frame := message.header.frame_id.strip("/")) in _FIXED_FRAMES:
                    raise InputError(
                        f"clouds in the frame {frame}, which does not move with the lidar",
                        expected="clouds in the frame of the lidar, as its driver writes them",
                        where=f"{path}#{topic}",
                        cure="Name the topic of the driver; finished clouds are read as LAS or PLY",
                    )
                if hasattr(message, "timebase") and message.timebase > _ABSOLUTE_NS:
                    stamp_s = message.timebase * 1e-9
                if layout is None or layout.fields != getattr(message, "fields", None):
                    layout = _layout(message, stamp_s)
                yield stamp_s, recorded_s, layout, message

    def scan(self) -> LidarScan:
        """Read the recording once.

        Raises
        ------
        InputError : no topic of clouds, several, or clouds without coordinates.
        UnsupportedError : rosbags is not installed.
        """
        report = IntegrityReport.of(
            "lidar",
            "ROS clouds",
            self.files,
            time_scale="host",
            synchronised=True,
            bytes_read=sum(path.stat().st_size for path in self.files),
        )
        stamps: list[float] = []
        lags: list[float] = []
        apart: list[float] = []
        n_points, empty = 0, 0
        layouts: dict[str, _Layout] = {}
        for stamp_s, recorded_s, layout, message in self._clouds(report):
            stamps.append(stamp_s)
            lags.append(recorded_s - stamp_s)
            report.model = str(message.header.frame_id)
            if layout is None:
                empty += getattr(message, "point_num", None) or message.width * message.height
                continue
            points = _points_of(message, stamp_s, layout, report)
            n_points += int(np.count_nonzero(_within(points["range"], self.options)))
            empty += int((points["range"] == 0).sum())
            apart.extend(points["t_s"][-1:] - stamp_s)
            layouts[layout.why or layout.time] = layout
        if not stamps:
            raise InputError("no cloud in the bag", expected="messages of a lidar", where=report.files[0])
        t_unix_s = np.array(stamps)
        report.take_times(gps_from_unix(t_unix_s), "clouds")
        report.count("clouds", len(stamps))
        report.count("points", n_points)
        report.count_some("shots_without_return", empty)
        _say_stamps(report, np.array(lags))
        for layout in layouts.values():
            report.note(
                f"{layout.why}: all of a cloud get the time of its header, up to a turn "
                "of the lidar off. Record the time of each point (field t, time or timestamp)."
                if layout.why
                else f"Times of points: field {layout.time}, {_TIME_UNITS_S[layout.unit_s]} since "
                f"{'the header' if layout.from_header else '1970'}."
            )
            if abs(late_s := float(np.median(apart))) > _TURN_S:
                report.note(f"The points are {late_s:,.1f} s from their headers: their own times are taken.")
            if layout.full == 1.0:
                report.note("Brightness is between 0 and 1: multiplied by 255.")
        clock = _clock(t_unix_s[0])
        return LidarScan(
            report=report, clock=clock, model=report.model, return_mode="strongest", n_points=n_points
        )

    def length_s(self) -> float:
        """Time between the first and the last message of all files."""
        total = 0.0
        for path in self.files:
            with _opened(path) as bag:
                total += (bag.end_time - bag.start_time) * 1e-9
        return total

    def points(
        self, clock: LidarClock | None = None, *, max_points: int = 1_000_000, window: LogWindow | None = None
    ) -> Iterator[PointBlock]:
        """Points, a message at a time or less; ``clock`` is always that of the headers."""
        first_s = None
        for packet, (stamp_s, _, layout, message) in enumerate(self._clouds()):
            first_s = stamp_s if first_s is None else first_s
            if window is not None and window.number_of(np.array([stamp_s - first_s]))[0] != window.index:
                continue
            if layout is None:
                continue
            block = _block(_points_of(message, stamp_s, layout, None), self.options, packet, clock)
            if block.n <= max_points:
                yield block
                continue
            for start in range(0, block.n, max_points):
                rows = np.arange(block.n)
                yield block.where((rows >= start) & (rows < start + max_points))


def _clock(unix_s: float) -> LidarClock:
    return LidarClock(gps_minus_device_s=(float(gps_from_unix(unix_s)) - unix_s,))


def _rows_of(message: Any, dtype: np.dtype[Any], report: IntegrityReport | None) -> AnyArray:
    """Points of a cloud as a structured array, without what pads its rows."""
    if hasattr(message, "points"):  # Livox
        names = dtype.names or ()
        return np.array([tuple(getattr(p, name) for name in names) for p in message.points], dtype)
    data, line = np.asarray(message.data), message.width * dtype.itemsize
    if message.height > 1 and message.row_step > line:
        whole = len(data) // message.row_step
        data = data[: whole * message.row_step].reshape(whole, message.row_step)[:, :line]
    rows = np.frombuffer(data.tobytes()[: data.size // dtype.itemsize * dtype.itemsize], dtype)
    promised = message.width * message.height
    if report is not None and len(rows) < promised:
        report.lose("points_cut_off", promised - len(rows))
    return rows[:promised]


def _dtype_of(message: Any) -> np.dtype[Any]:
    if hasattr(message, "points"):
        return _LIVOX_ROW
    fields = {f.name: f for f in message.fields if f.datatype in _TYPES}
    if not {"x", "y", "z"} <= set(fields):
        raise InputError(
            f"clouds with fields {', '.join(fields)}",
            expected="x, y and z",
            cure="Record the cloud with coordinates, or convert its packets with the driver",
        )
    order = ">" if message.is_bigendian else "<"
    places = {name: (np.dtype(f"{order}{_TYPES[f.datatype]}"), f.offset) for name, f in fields.items()}
    if max(offset + kind.itemsize for kind, offset in places.values()) > message.point_step:
        raise InputError(
            f"clouds whose fields reach beyond the {message.point_step} bytes of a point",
            expected="fields within a point",
            cure="Record the topic again: its driver states the fields wrongly",
        )
    formats, offsets = zip(*places.values(), strict=True)
    return np.dtype(
        {"names": list(places), "formats": formats, "offsets": offsets, "itemsize": message.point_step}
    )


def _layout(message: Any, stamp_s: float) -> _Layout | None:
    """Layout of the clouds of a topic; None if this one has no points to tell it from."""
    dtype = _dtype_of(message)
    rows = _rows_of(message, dtype, None)
    seen = rows[np.isfinite(rows["x"]) & (rows["x"] != 0)]
    if not len(seen):
        return None
    names = dtype.names or ()
    time, unit_s, from_header, why = _times(seen, stamp_s)
    bright = next((name for name in ("reflectivity", "intensity", "i") if name in names), "")
    parts = bright and dtype[bright].kind == "f" and 0 < np.nanmax(seen[bright]) <= 1
    return _Layout(
        fields=getattr(message, "fields", None),
        dtype=dtype,
        time=time,
        unit_s=unit_s,
        from_header=from_header,
        why=why,
        ring=next((name for name in ("ring", "channel", "line", "laser_id") if name in names), ""),
        bright=bright,
        full=1.0 if parts else 255.0,
    )


def _times(rows: AnyArray, stamp_s: float) -> tuple[str, float, bool, str]:
    """Field with the times of points, its unit in seconds, whether it counts from the header; why it is none.

    Drivers differ in the unit, which no file states. A number of 64 bits that is a date since 1970 in one of
    the units is one; so is one near the stamp of the header. Others are offsets: in the usual unit (seconds
    of a real number, nanoseconds of an integer), or in that in which the cloud lasts neither longer than any
    turn of a lidar nor shorter than any lidar takes for so many points.
    """
    names = rows.dtype.names or ()
    if {"time_sec", "time_nsec"} <= set(names):
        return "time_sec", 1.0, False, ""
    name = next((each for each in _TIME_FIELDS if each in names), "")
    if not name:
        return "", 1.0, True, "The points have no times of their own"
    values = rows[name].astype(np.float64)
    low, high = float(values.min()), float(values.max())
    for unit_s in _TIME_UNITS_S:
        dated = rows.dtype[name].itemsize == 8 and _DATED_S[0] < high * unit_s < _DATED_S[1]
        if dated or (stamp_s > _DEVICE_S and abs(high * unit_s - stamp_s) < _TURN_S):
            if rows.dtype[name].kind != "f" or np.spacing(rows[name].max()) * unit_s < _FINE_S:
                return name, unit_s, False, ""
            return "", 1.0, True, f"The times of the points (field {name}) are rounded by their float32"
    usual_s = 1e-9 if rows.dtype[name].kind in "ui" else 1.0
    for unit_s in (usual_s, *_TIME_UNITS_S):
        lasts = max(abs(low), abs(high)) * unit_s < _TURN_S
        if lasts and len(rows) <= 100 + (high - low) * unit_s * _POINTS_A_SECOND:
            return name, unit_s, True, ""
    span = f"{low:g}" if low == high else f"{low:g} to {high:g}"
    why = f"The times of the points (field {name}, {span}) count neither from 1970 nor from the header"
    return "", 1.0, True, why


def _points_of(
    message: Any, stamp_s: float, layout: _Layout, report: IntegrityReport | None
) -> dict[str, Any]:
    """Columns of a cloud: coordinates (n, 3) in axes of ROS, Unix time, ring, brightness, range."""
    rows = _rows_of(message, layout.dtype, report)
    xyz = np.stack([rows[axis] for axis in "xyz"], axis=1)
    squares = np.einsum("ij,ij->i", xyz, xyz)
    if not np.isfinite(squares).all():
        xyz[~np.isfinite(squares)] = 0.0
        squares = np.einsum("ij,ij->i", xyz, xyz)
    t_s = np.full(len(xyz), stamp_s)
    if layout.time:
        own = rows[layout.time].astype(np.float64) * layout.unit_s
        if layout.time == "time_sec":
            own += rows["time_nsec"] * 1e-9
        t_s = t_s + own if layout.from_header else own
    none = np.zeros(len(xyz))
    return {
        "xyz": xyz,
        "t_s": t_s,
        "ring": rows[layout.ring] if layout.ring else none,
        "bright": rows[layout.bright] * (255.0 / layout.full) if layout.bright else none,
        "range": np.sqrt(squares),
    }


def _within(range_m: AnyArray, options: LidarOptions) -> ArrayB:
    """Which returns (n,) count."""
    near = max(options.min_range_m, np.finfo(np.float32).tiny)
    return (range_m >= near) & (range_m <= options.max_range_m)


def _block(
    points: dict[str, Any], options: LidarOptions, packet: int, clock: LidarClock | None = None
) -> PointBlock:
    keep: Any = _within(points["range"], options)
    if keep.all():
        keep = slice(None)
    x, y, z = points["xyz"][keep].T
    t_s = points["t_s"][keep]
    azimuth = np.arctan2(-y, x)
    ones = np.ones(len(x), np.uint8)
    ring = points["ring"][keep].astype(np.uint8)
    clock = clock or _clock(float(t_s[0]) if len(t_s) else 1e9)
    return PointBlock(
        t_gps_s=clock.gps_time(np.array([packet]), t_s),
        t_device_s=t_s,
        xyz_scs_m=np.stack([-y, x, z], axis=1).astype(np.float32, copy=False),
        range_m=points["range"][keep].astype(np.float32, copy=False),
        azimuth_rad=np.where(azimuth < 0, azimuth + 2 * np.pi, azimuth).astype(np.float32, copy=False),
        ring=ring,
        laser=ring,
        intensity=np.clip(np.nan_to_num(points["bright"][keep]), 0, 255).astype(np.uint8),
        return_number=ones,
        n_returns=ones,
        packet=np.full(len(x), packet, np.int64),
    )


def _say_stamps(report: IntegrityReport, lag_s: ArrayF) -> None:
    typical = float(np.median(lag_s)) if len(lag_s) else 0.0
    report.note(
        "Stamps are those of the messages' headers, taken as UTC: the clock of the computer or sensor."
    )
    if unstamped := report.counts.get("messages_without_stamp"):
        report.note(f"{unstamped:,} messages have no stamp: they get the time of their recording.")
    if abs(typical) > _REPLAYED_S:
        days = abs(typical) / 86_400.0
        report.note(
            f"The recorder's clock is {days:,.1f} days ahead of the headers: recorded from a replay."
            if days > 0.5
            else f"The recorder's clock differs from the headers by {typical:,.1f} s."
        )


def packets_of_bag(path: Path, topics: Sequence[str]) -> tuple[str, list[Path]]:
    """Maker and capture of the lidar's packets in a bag, for the reader of such packets; none of clouds.

    Captures lie in a temporary folder as long as this process runs; beside one of an Ouster its metadata.

    Raises
    ------
    InputError : no topic of a lidar, several, or packets of an Ouster without its metadata.
    """
    (topic,) = _chosen(path, "lidar", topics)
    kind = _held(path)[topic][0]
    if kind in _CLOUDS:
        return "", []
    return ("velodyne" if kind == _VELODYNE else "ouster"), list(_captured(path, topic, kind))


@lru_cache(maxsize=8)
def _captured(path: Path, topic: str, kind: str) -> tuple[Path, ...]:
    folder = tempfile.TemporaryDirectory(prefix="thalweg-bag-")
    atexit.register(folder.cleanup)
    target = Path(folder.name) / f"{path.stem}.pcap"
    port, metadata = 2368, []
    if kind in _OUSTER:
        text = _ouster_metadata(path)
        metadata = [target.with_suffix(".json")]
        metadata[0].write_text(text, encoding="utf-8")
        port = int((re.findall(r'"udp_port_lidar":\s*(\d+)', text) or [7502])[0])
    with target.open("wb") as out:
        out.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65_535, 1))
        for _, t_s, message in _messages(path, topic):
            for data, stamp_s in (
                [(bytes(message.buf), t_s)]
                if kind in _OUSTER
                else [(bytes(p.data), p.stamp.sec + p.stamp.nanosec * 1e-9) for p in message.packets]
            ):
                ip = struct.pack(">BBHHHBBH", 0x45, 0, 28 + len(data), 0, 0, 64, 17, 0) + _ADDRESSES
                udp = struct.pack(">HHHH", port, port, 8 + len(data), 0) + data
                frame = bytes(12) + b"\x08\0" + ip + udp
                stamp = divmod(round(stamp_s * 1e6), 1_000_000)
                out.write(struct.pack("<IIII", *stamp, len(frame), len(frame)) + frame)
    return (*metadata, target)


def _ouster_metadata(path: Path) -> str:
    """Metadata of an Ouster out of the topic of text that its driver writes them to."""
    for name, (kind, _) in _held(path).items():
        for _, _, message in _messages(path, name) if kind == _TEXT else ():
            if is_ouster_metadata(message.data.encode(), 0):
                return str(message.data)
    raise InputError(
        "packets of an Ouster without its metadata",
        expected="a topic of std_msgs/String with the metadata, as the driver writes it",
        where=path,
        cure="Record the driver's topic metadata too, or the cloud (PointCloud2)",
    )


# ---------------------------------------------------------------- positions, poses, depths


def read_bag_positions(files: Sequence[Path], options: TrackOptions) -> PositionLog:
    """Positions of NavSatFix, and depths of a Range that looks down, where one topic gives them.

    Raises
    ------
    InputError : no topic of positions, or several and none is named.
    """
    report = IntegrityReport.of("gnss", "ROS NavSatFix", files, time_scale="host")
    return _read("pos", "positions", files, options, report)


def read_bag_depths(files: Sequence[Path], options: TrackOptions) -> PositionLog:
    """Depths of a Range that looks down, and positions of NavSatFix, where one topic gives them.

    Raises
    ------
    InputError : no topic of depths, or several and none is named.
    """
    report = IntegrityReport.of("depth", "ROS Range", files, time_scale="host")
    return _read("depth", "depths", files, options, report)


def _read(
    stream: str, what: str, files: Sequence[Path], options: TrackOptions, report: IntegrityReport
) -> PositionLog:
    """Positions and depths, of which ``stream`` must be there."""
    tables = {
        name: (_all if name == stream else _beside)(name, files, options, report) for name in ("pos", "depth")
    }
    report.take_gps_times(tables[stream]["t_gps_s"], what)
    return PositionLog(positions=tables["pos"], depths=tables["depth"], report=report)


def _all(stream: str, files: Sequence[Path], options: TrackOptions, report: IntegrityReport) -> pd.DataFrame:
    """Positions or depths of all files."""
    read = {"pos": _fixes, "depth": _depths}[stream]
    chosen = [(path, topic) for path in files for topic in _chosen(path, stream, options.topics)]
    return pd.concat([read(path, topic, report) for path, topic in chosen], ignore_index=True)


def _beside(
    stream: str, files: Sequence[Path], options: TrackOptions, report: IntegrityReport
) -> pd.DataFrame:
    """What bags hold beside the stream that is read; of several topics none, which a note tells."""
    holding = [path for path in files if stream in _offers(_held(path))]
    try:
        if holding:
            return _all(stream, holding, options, report)
    except InputError as error:
        report.note(f"{error.found.split(';')[0]}: none is read beside. {error.cure}.")
    return {"pos": GNSS_POSITION, "depth": DEPTH}[stream].empty_table().to_pandas()


def _fixes(path: Path, topic: str, report: IntegrityReport) -> pd.DataFrame:
    rows: list[tuple[float, ...]] = []
    covs: list[bytes] = []
    for stamp_s, recorded_s, fix in _messages(path, topic, report):
        status, kind = fix.status.status, fix.position_covariance_type
        rows.append((stamp_s, recorded_s, status, fix.latitude, fix.longitude, fix.altitude, kind))
        covs.append(fix.position_covariance.tobytes())  # much faster than one array for each
    t_unix_s, t_recorded_s, status, lat, lon, height, kind = np.array(rows, np.float64).reshape(-1, 7).T
    cov = np.frombuffer(b"".join(covs)).reshape(-1, 9).T
    placed = (status >= 0) & (np.abs(lat) <= 90.0) & (np.abs(lon) <= 180.0) & ((lat != 0.0) | (lon != 0.0))
    report.count_some("positions_without_fix", (~placed).sum())
    known, full = kind > 0, kind == 3
    # zeros stand for unknown, whatever the kind says
    sigmas = [np.sqrt(np.where(known & (cov[k] > 0), cov[k], np.nan)) for k in (0, 4, 8)]
    _say_stamps(report, (t_recorded_s - t_unix_s)[placed])
    report.note("Heights of NavSatFix are above the ellipsoid, if its driver keeps to the definition.")
    table = pd.DataFrame(
        {
            "t_gps_s": gps_from_unix(t_unix_s),
            "lat_deg": lat,
            "lon_deg": lon,
            "h_ell_m": height,
            "fix": pd.Series(status).map(_FIX_STATUS).fillna("single"),
            "n_sats": -1,
            **dict(zip(("sigma_east_m", "sigma_north_m", "sigma_up_m"), sigmas, strict=True)),
            "cov_en_m2": np.where(full, cov[1], np.nan),
            "cov_eu_m2": np.where(full, cov[2], np.nan),
            "cov_nu_m2": np.where(full, cov[5], np.nan),
        }
    )
    return frame_of(GNSS_POSITION, dict(table[placed].reset_index(drop=True)), unknown=np.nan)


def _depths(path: Path, topic: str, report: IntegrityReport) -> pd.DataFrame:
    rows = [
        # drivers older than REP 117 write the end of the reach where they saw nothing
        (stamp_s, each.range if each.min_range <= each.range < (each.max_range or math.inf) else 0.0)
        for stamp_s, _, each in _messages(path, topic, report)
    ]
    stamp_s, depth = np.array(rows, np.float64).reshape(-1, 2).T
    found = {"t_gps_s": gps_from_unix(stamp_s), "depth_m": depth, "sentence": topic}
    return frame_of(DEPTH, {**found, "line": np.arange(1, len(depth) + 1)}, unknown=np.nan)


def read_bag_poses(files: Sequence[Path], options: TrackOptions) -> PoseLog:
    """Attitudes of an Imu with the positions of NavSatFix beside it, or poses of Odometry.

    Parameters
    ----------
    files : bags in the order of time.
    options : ``topics`` of several; for Odometry and poses ``frame`` and, against REP 103, ``body_axes``.

    Raises
    ------
    InputError : no or several topics, or an Imu that gives no orientation.
    """
    chosen = [_chosen(path, "ins", options.topics) for path in files]
    if all(len(topics) == 1 for topics in chosen):
        return _poses([(path, topic) for path, (topic,) in zip(files, chosen, strict=True)], options)
    report = IntegrityReport.of("ins", "ROS Imu and NavSatFix", files, time_scale="host")
    parts = list(zip(files, chosen, strict=True))
    positions = pd.concat([_fixes(path, fix, report) for path, (_, fix) in parts], ignore_index=True)
    if positions.empty:
        n = report.counts.get("positions_without_fix", 0)
        raise InputError(
            f"{n:,} positions of {', '.join(dict.fromkeys(fix for _, (_, fix) in parts))}, none with a fix",
            expected="positions beside the attitudes (NavSatFix with a status of 0 and above)",
            where=report.files[0],
            cure="Record with the sky in sight, or name the topic of another receiver",
        )
    states = pd.concat(
        [_attitudes(path, imu, report, options.body_axes) for path, (imu, _) in parts], ignore_index=True
    )
    depths = _beside("depth", files, options, report)
    t, at = states["t_gps_s"].to_numpy(), positions.drop_duplicates("t_gps_s").sort_values("t_gps_s")
    for name in ("lat_deg", "lon_deg", "h_ell_m", "sigma_east_m", "sigma_north_m", "sigma_up_m"):
        states[name] = interpolated(t, at["t_gps_s"], at[name])
    placed = states["lat_deg"].notna()
    states["filter_status"] = np.where(placed.cummax(), NAVIGATION_INITIALISED, 0).astype(np.uint16)
    report.take_gps_times(t, "states")
    report.count("positions", len(positions))
    report.count_some("states_without_position", (~placed).sum())
    report.note("Positions are those of the receiver's antenna, between its fixes.")
    return PoseLog(states=states, positions=positions, depths=depths, report=report)


def _poses(parts: Sequence[tuple[Path, str]], options: TrackOptions) -> PoseLog:
    """Poses of messages that hold position and orientation together, in the frame that options state."""
    report = IntegrityReport.of("ins", "ROS poses", [path for path, _ in parts])
    stamps, places, quaternions, covariances, lags = [], [], [], [], []
    frames: dict[str, None] = {}
    for path, topic in parts:
        for stamp_s, recorded_s, message in _messages(path, topic, report):
            covered = message.pose if hasattr(message.pose, "pose") else None
            pose = message.pose if covered is None else covered.pose
            p, q = pose.position, _unit_of(pose.orientation)
            if q is None:
                report.count("messages_without_orientation")
                continue
            stamps.append(stamp_s)
            lags.append(recorded_s - stamp_s)
            places.append([p.x, p.y, p.z])
            quaternions.append(q)
            covariances.append(np.zeros(36) if covered is None else covered.covariance)
            frames[str(message.header.frame_id)] = None
    if not stamps:
        raise InputError("no pose", expected="poses with an orientation", where=report.files[0])
    R = Rotation.from_quat(np.array(quaternions)).as_matrix()
    table = TextPoses(
        t_s=np.array(stamps), position_m=np.array(places), R_world_body=R, velocity_mps=None, report=report
    )
    axes, scale = options.body_axes or "forward-left-up", options.time_scale or "utc"
    log = states_of_poses(table, replace(options, body_axes=axes, time_scale=scale))
    cov = np.array(covariances, np.float64).reshape(-1, 6, 6)
    cov[~(np.diagonal(cov, axis1=1, axis2=2) > 0).all(axis=1)] = np.nan  # zeros stand for unknown
    turned = np.diagonal(np.swapaxes(R, 1, 2) @ cov[:, 3:, 3:] @ R, axis1=1, axis2=2)
    variances = {
        **{f"sigma_{axis}_m": cov[:, k, k] for k, axis in enumerate(("east", "north", "up"))},
        **{f"sigma_{angle}_rad": turned[:, k] for k, angle in enumerate(("roll", "pitch"))},
        "sigma_heading_rad": cov[:, 5, 5],
    }
    for name, variance in variances.items():
        log.states[name] = np.where(np.isnan(variance), log.states[name], np.sqrt(np.abs(variance)))
    _say_stamps(report, np.array(lags))
    report.note(
        f"The frame {', '.join(frames)} of the poses is taken for the local frame at campaign.origin: "
        "x east, y north, z up. Odometry without GNSS has an origin and a direction of its own."
    )
    return log


def _attitudes(path: Path, topic: str, report: IntegrityReport, axes: str | None) -> pd.DataFrame:
    """Orientations of an Imu; axes that are stated are believed, those of REP 103 tried by gravity."""
    stamps, quaternions, variances, rates, felt_mps2 = [], [], [], [], []
    for stamp_s, _, message in _messages(path, topic, report):
        a = message.linear_acceleration
        q = _unit_of(message.orientation)
        if message.orientation_covariance[0] == -1 or q is None:
            report.count("messages_without_orientation")
            continue
        stamps.append(stamp_s)
        quaternions.append(q)
        variances.append(np.asarray(message.orientation_covariance)[[0, 4, 8]])
        rates.append([message.angular_velocity.x, -message.angular_velocity.y, -message.angular_velocity.z])
        felt_mps2.append([a.x, a.y, a.z])
    if not stamps:
        raise InputError(
            f"the Imu {topic} gives no orientation",
            expected="an orientation with each message, as filters and drivers of an INS publish it",
            where=path,
            cure="Record the filter's topic, or take the poses of another program (SBET, TUM)",
        )
    turn = Rotation.from_quat(np.array(quaternions)).as_matrix()
    felt = turn @ np.array(felt_mps2)[:, :, None]
    up = felt[:, 2, 0] / np.maximum(np.linalg.norm(felt[:, :, 0], axis=1), 1e-9)
    still = np.abs(np.linalg.norm(felt[:, :, 0], axis=1) - _GRAVITY_MPS2) < _GRAVITY_MPS2 / 4
    doubt = ""
    if len(turn) > 1 and np.all(turn == np.eye(3)):
        doubt = "is level, bow to the east, in every message: none was measured"
    elif (
        still.any()
        and (tilt_deg := np.rad2deg(np.arccos(np.clip(np.median(up[still]), -1, 1)))) > _TILTED_DEG
    ):
        doubt = f"contradicts its accelerations: these point {tilt_deg:.0f} degrees away from up"
    if doubt and axes is None:
        raise InputError(
            f"the orientation of the Imu {topic} {doubt}",
            expected="the body forward, left, up (REP 103) against east, north, up (REP 145)",
            where=path,
            cure="Record a filter or driver that keeps to this, or state ins.body_axes if you know them",
        )
    R = turn @ BODY_AXES[axes or "forward-left-up"]
    roll, pitch, heading = roll_pitch_heading(R)
    sigma = np.sqrt(np.where(np.array(variances) > 0, np.array(variances), np.nan))
    rate = np.array(rates)
    return frame_of(
        INS_STATE,
        {
            "t_gps_s": gps_from_unix(np.array(stamps)),
            "t_device_s": np.array(stamps),
            "roll_rad": roll,
            "pitch_rad": pitch,
            "heading_rad": heading,
            **{f"rate_{axis}_radps": rate[:, k] for k, axis in enumerate("xyz")},
            **{f"sigma_{name}_rad": sigma[:, k] for k, name in enumerate(("roll", "pitch", "heading"))},
            "fix": "3d",
            "system_status": 0,
            "filter_status": NAVIGATION_INITIALISED,
        },
        unknown=np.nan,
    )


# ---------------------------------------------------------------- images


def write_bag_images(path: Path, folder: Path, topic: str = "", every_s: float = 0.0) -> pd.DataFrame:
    """Write the images of a bag as files, and ``times.csv`` with the stamps of their headers beside them.

    Compressed images are written as they are, others as PNG.

    Parameters
    ----------
    path : the bag.
    folder : made if it is not there.
    topic : of several cameras.
    every_s : time between images that are written; 0: all.

    Returns
    -------
    Columns ``file`` and ``time_utc``.

    Raises
    ------
    InputError : no images, several cameras and none is named, or a pattern of colours on a chip.
    """
    cameras = {name: n for name, (kind, n) in _held(path).items() if kind in _IMAGES and n}
    named = [name for name in cameras if topic in ("", name)]
    if len(named) != 1:
        raise InputError(
            f"{len(named) or 'no'} topics of images{f' named {topic}' if topic else ''}; "
            f"it holds {', '.join(cameras) or 'none'}",
            expected="images of one camera",
            where=path,
            cure="Name it by --topic" if cameras else "Record the topic of the camera",
        )
    folder.mkdir(parents=True, exist_ok=True)
    rows, due_s = [], -math.inf
    for number, (stamp_s, _, message) in enumerate(_messages(path, named[0])):
        if stamp_s + 1e-9 < due_s:
            continue
        due_s = stamp_s + every_s
        data = np.asarray(message.data, np.uint8)
        ending = _ENDINGS.get(data[:2].tobytes()) if hasattr(message, "format") else ".png"
        name = f"{path.stem}_{number:06d}{ending}"
        if ending is None:
            raise InputError(
                f"compressed images of the format {message.format}",
                expected="JPEG or PNG",
                where=path,
                cure="Record the topic of the camera's images, no depths",
            )
        if hasattr(message, "format"):
            (folder / name).write_bytes(data.tobytes())
        else:
            _picture(message, data, path).save(folder / name)
        rows.append((name, utc_text_from_unix(stamp_s)))
    table = pd.DataFrame(rows, columns=["file", "time_utc"])
    table.to_csv(folder / "times.csv", index=False)
    return table


def _picture(message: Any, data: AnyArray, path: Path) -> Any:
    from PIL import Image

    if message.encoding not in _CHANNELS:
        raise InputError(
            f"images of the encoding {message.encoding}",
            expected=", ".join(_CHANNELS),
            where=path,
            cure="Convert them by image_proc, and record its topic",
        )
    mode, order = _CHANNELS[message.encoding]
    rows = data[: message.height * message.step].reshape(message.height, message.step)
    channels = len(Image.new(mode, (1, 1)).getbands())
    pixels = rows[:, : message.width * channels].reshape(message.height, message.width, channels)
    return Image.fromarray(np.ascontiguousarray(pixels[:, :, 0] if channels == 1 else pixels[:, :, ::order]))
