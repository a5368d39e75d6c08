"""Bags of ROS 1 (``.bag``) and ROS 2 (``.db3``, ``.mcap``), read by ``rosbags`` (extra ``ros``).

One file holds many topics; each stream of a survey takes those of its type: clouds of a lidar (PointCloud2,
Livox CustomMsg, Velodyne packets), poses (Imu beside NavSatFix), positions (NavSatFix), depths (Range). Where
several topics could be meant, the choice is asked for.

Stamps are those of the headers, Unix time of the computer or of a sensor that it disciplines, taken as UTC;
where the recorder's clock says otherwise (a replay), a note tells. Bodies and clouds have axes forward, left,
up (REP 103), scs has right, forward, up. An Imu's attitude is against east, north, up (REP 145).
Source: ROS message definitions sensor_msgs; drivers of Velodyne, Ouster, Hesai, Livox, RoboSense and Luminar
for the names of fields.
"""

import atexit
import math
import struct
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from thalweg.core import ArrayF, InputError, UnsupportedError, frame_of, gps_from_unix, roll_pitch_heading
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
)

_CLOUDS: Final = (
    "sensor_msgs/msg/PointCloud2",
    "livox_ros_driver/msg/CustomMsg",
    "livox_ros_driver2/msg/CustomMsg",
)
_VELODYNE: Final = "velodyne_msgs/msg/VelodyneScan"
_FIXES: Final = "sensor_msgs/msg/NavSatFix"
_IMU: Final = "sensor_msgs/msg/Imu"
_RANGE: Final = "sensor_msgs/msg/Range"
_PACKETS: Final = {
    "pandar_msgs/msg/PandarScan": "Packets of a Hesai are not read: play them to PointCloud2 by its driver",
    **dict.fromkeys(
        ("ouster_ros/msg/PacketMsg", "ouster_sensor_msgs/msg/PacketMsg"),
        "Packets of an Ouster are not read: make a pcap of them with the maker's ouster-cli",
    ),
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
_ADDRESSES: Final = b"\xc0\xa8\x01\xc9" + b"\xff" * 4
_ABSOLUTE_NS: Final = 1e15
_REPLAYED_S: Final = 5.0


def is_bag(head: bytes, size: int) -> bool:
    """True for bags of ROS 1, sqlite bags of ROS 2 and MCAP."""
    sqlite = head.startswith(b"SQLite format 3\0") and b"topics" in head and b"messages" in head
    return sqlite or head.startswith((b"#ROSBAG V2.0", b"\x89MCAP0\r\n"))


_Stamped = tuple[float, float, Any]


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        raise UnsupportedError(
            "a bag of ROS, and rosbags is not installed",
            expected="the library rosbags",
            where=path,
            cure="Install it: pip install 'thalweg[ros]'",
        ) from error
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(_VELODYNE_PACKET, "velodyne_msgs/msg/VelodynePacket"))
    store.register(get_types_from_msg(_VELODYNE_SCAN, _VELODYNE))
    for package in ("livox_ros_driver", "livox_ros_driver2"):
        store.register(get_types_from_msg(_LIVOX_POINT, f"{package}/msg/CustomPoint"))
        store.register(get_types_from_msg(_LIVOX.format(package=package), f"{package}/msg/CustomMsg"))
    try:
        reader = AnyReader([path], default_typestore=store)
        reader.open()
    except (AnyReaderError, OSError, ValueError, KeyError) as error:
        raise InputError(
            f"the bag cannot be opened ({error})",
            expected="a whole bag",
            where=path,
            cure="Mend it: rosbag reindex (ROS 1), ros2 bag reindex (ROS 2), mcap recover"
            if path.suffix in (".bag", ".db3", ".mcap")
            else "Give it the ending of its kind: .bag, .db3 or .mcap",
        ) from error
    try:
        yield reader
    finally:
        reader.close()


def _topics(path: Path, *types: str, topic: str = "") -> list[str]:
    with _opened(path) as bag:
        found = sorted({each.topic for each in bag.connections if each.msgtype in types and each.msgcount})
    return [name for name in found if not topic or name == topic]


def _messages(
    path: Path, topic: str, report: IntegrityReport | None = None
) -> Iterator[tuple[float, float, Any]]:
    """Header stamp and time of recording, Unix seconds, and the message, of one topic."""
    with _opened(path) as bag:
        for connection, t_ns, raw in bag.messages([each for each in bag.connections if each.topic == topic]):
            try:
                message = bag.deserialize(raw, connection.msgtype)
            except (AssertionError, IndexError, KeyError, TypeError, ValueError, UnicodeDecodeError):
                if report is not None:
                    report.lose("damaged_messages", 1)
                continue
            stamp = message.header.stamp
            yield stamp.sec + stamp.nanosec * 1e-9, t_ns * 1e-9, message


def _one(path: Path, words: str, *types: str, topic: str = "", setting: str = "") -> str:
    found = _topics(path, *types, topic=topic)
    if len(found) == 1:
        return found[0]
    with _opened(path) as bag:
        held = {each.topic: each.msgtype for each in bag.connections}
    packets = next((words for kind, words in _PACKETS.items() if kind in held.values()), "")
    listed = ", ".join(f"{name} ({kind.rsplit('/', 1)[-1]})" for name, kind in sorted(held.items()))
    raise InputError(
        f"{len(found) or 'no'} topics of {words}"
        + (f" named {topic}" if topic else "")
        + f"; it holds {listed}",
        expected=f"one topic of {words}",
        where=path,
        cure=f"Name the one that is meant in {setting}"
        if len(found) > 1 and setting
        else packets or "Record the topic, or take another bag",
    )


def describe_bag(path: Path) -> IntegrityReport:
    """Topics of a bag with their numbers of messages, and what of them can be read."""
    report = IntegrityReport(
        stream="bag", format="ROS bag", files=[str(path)], bytes_read=path.stat().st_size, time_scale="host"
    )
    with _opened(path) as bag:
        numbers: Counter[str] = Counter()
        for each in bag.connections:
            numbers[f"{each.topic} ({each.msgtype.replace('/msg/', '/')})"] += each.msgcount
        report.t_first_s, report.t_last_s = (
            float(gps_from_unix(t * 1e-9)) for t in (bag.start_time, bag.end_time)
        )
        kinds = {each.msgtype for each in bag.connections}
    report.synchronised = True
    report.details["topics"] = dict(sorted(numbers.items()))
    report.count("messages", sum(numbers.values()))
    for kind, words in _PACKETS.items():
        if kind in kinds:
            report.note(f"{words}.")
    streams = streams_of_bag(path)
    report.note(f"It gives {', '.join(streams)}." if streams else "It holds nothing that Thalweg reads.")
    return report


def streams_of_bag(path: Path) -> list[str]:
    """Streams of ``logs`` that a bag gives."""
    has = {
        "lidar": _topics(path, *_CLOUDS, _VELODYNE),
        "ins": _topics(path, _FIXES) and _topics(path, _IMU),
        "pos": _topics(path, _FIXES),
        "depth": [name for name in _topics(path, _RANGE) if _looks_down(name)],
    }
    return [name for name, topics in has.items() if topics and not (name == "pos" and has["ins"])]


def has_velodyne_packets(path: Path) -> bool:
    """Whether a bag holds packets of a Velodyne and no cloud."""
    return bool(_topics(path, _VELODYNE)) and not _topics(path, *_CLOUDS)


def _looks_down(topic: str) -> bool:
    return any(word in topic.lower() for word in ("depth", "echo", "sonar", "altimeter", "ping", "sounder"))


# ---------------------------------------------------------------- lidar


@dataclass(frozen=True, slots=True, kw_only=True)
class BagLidar:
    """Clouds of a lidar in bags: a `thalweg.ingest.readers.LidarReader`.

    ``files`` are bags in the order of time; of ``options`` ranges count, and the topic of several.
    """

    files: Sequence[Path]
    options: LidarOptions

    def _clouds(self, report: IntegrityReport | None = None) -> Iterator[tuple[float, float, Any]]:
        for path in self.files:
            topic = _one(path, "clouds", *_CLOUDS, topic=self.options.topic, setting="lidar.topic")
            yield from _messages(path, topic, report)

    def scan(self) -> LidarScan:
        """Read the recording once.

        Raises
        ------
        InputError : no topic of clouds, several, or clouds without coordinates.
        UnsupportedError : rosbags is not installed.
        """
        report = IntegrityReport(
            stream="lidar",
            format="ROS clouds",
            files=[str(path) for path in self.files],
            time_scale="host",
            synchronised=True,
            bytes_read=sum(path.stat().st_size for path in self.files),
        )
        stamps: list[float] = []
        lags: list[float] = []
        n_points, empty, timed = 0, 0, True
        for stamp_s, recorded_s, message in self._clouds(report):
            points = _points_of(message, stamp_s)
            block = _block(points, self.options, len(stamps))
            stamps.append(stamp_s)
            lags.append(recorded_s - stamp_s)
            n_points += block.n
            empty += int((points["range"] == 0).sum())
            timed &= points["timed"]
            report.model = str(message.header.frame_id)
        if not stamps:
            raise InputError("no cloud in the bag", expected="messages of a lidar", where=report.files[0])
        t_unix_s = np.array(stamps)
        report.take_times(gps_from_unix(t_unix_s), "clouds")
        report.count("clouds", len(stamps))
        report.count("points", n_points)
        if empty:
            report.count("shots_without_return", empty)
        _say_stamps(report, np.array(lags))
        if not timed:
            report.note(
                "The points have no times of their own: all of a cloud get that of its header, up to a turn "
                "of the lidar off. Record the time of each point (field t, time or timestamp)."
            )
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
        for packet, (stamp_s, _, message) in enumerate(self._clouds()):
            first_s = stamp_s if first_s is None else first_s
            if window is not None and window.number_of(np.array([stamp_s - first_s]))[0] != window.index:
                continue
            block = _block(_points_of(message, stamp_s), self.options, packet, clock)
            for start in range(0, block.n, max_points):
                rows = np.arange(block.n)
                yield block.where((rows >= start) & (rows < start + max_points))


def _clock(unix_s: float) -> LidarClock:
    return LidarClock(gps_minus_device_s=(float(gps_from_unix(unix_s)) - unix_s,))


def _points_of(message: Any, stamp_s: float) -> dict[str, Any]:
    """Columns of a cloud: x, y, z (axes of ROS), Unix time, ring, brightness, range; whether it has times."""
    if hasattr(message, "points"):  # Livox
        names = ("offset_time", "x", "y", "z", "reflectivity", "line")
        table = {name: np.array([getattr(p, name) for p in message.points], np.float64) for name in names}
        table["t"] = table.pop("offset_time")
        stamp_s = message.timebase * 1e-9 if message.timebase > _ABSOLUTE_NS else stamp_s
        timed_as: tuple[str, float] | None = ("t", 1e-9)
    else:
        order = ">" if message.is_bigendian else "<"
        fields = [f for f in message.fields if f.datatype in _TYPES]
        dtype = np.dtype(
            {
                "names": [f.name for f in fields],
                "formats": [f"{order}{_TYPES[f.datatype]}" for f in fields],
                "offsets": [f.offset for f in fields],
                "itemsize": message.point_step,
            }
        )
        data = np.asarray(message.data).tobytes()
        rows = np.frombuffer(data, dtype, min(message.width * message.height, len(data) // dtype.itemsize))
        table = {name: rows[name] for name in dtype.names or ()}
        timed_as = _time_field(dtype)
    if not {"x", "y", "z"} <= set(table):
        raise InputError(
            f"clouds with fields {', '.join(table)}",
            expected="x, y and z",
            cure="Record the cloud with coordinates, or convert its packets with the driver",
        )
    xyz = np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=1)
    xyz[~np.isfinite(xyz).all(axis=1)] = 0.0
    t_s = np.full(len(xyz), stamp_s)
    if timed_as and timed_as[0] == "time_sec":
        t_s = table["time_sec"] + table["time_nsec"] * 1e-9
    elif timed_as:
        own = table[timed_as[0]].astype(np.float64) * timed_as[1]
        if own.size and own.max() > _ABSOLUTE_NS:  # Livox's PointCloud2 has nanoseconds in a double
            own = own * 1e-9
        t_s = own if own.size and own.max() > 1e9 else stamp_s + own
    none = np.zeros(len(xyz))
    ring = next((table[name] for name in ("ring", "channel", "line", "laser_id") if name in table), none)
    bright = next((table[name] for name in ("reflectivity", "intensity", "i") if name in table), none)
    return {
        "xyz": xyz,
        "t_s": t_s,
        "ring": ring,
        "bright": np.nan_to_num(bright.astype(np.float64)),
        "range": np.linalg.norm(xyz, axis=1),
        "timed": timed_as is not None,
    }


def _time_field(dtype: np.dtype[Any]) -> tuple[str, float] | None:
    """Name of the field with the time of each point, and its unit in seconds."""
    names = dtype.names or ()
    if {"time_sec", "time_nsec"} <= set(names):
        return "time_sec", 1.0
    for name in ("timestamp", "time_stamp", "offset_time", "time", "t"):
        if name in names:
            return name, 1e-9 if dtype[name].kind in "ui" else 1.0
    return None


def _block(
    points: dict[str, Any], options: LidarOptions, packet: int, clock: LidarClock | None = None
) -> PointBlock:
    far = points["range"]
    keep = (far > 0) & (far >= options.min_range_m) & (far <= options.max_range_m)
    x, y, z = points["xyz"][keep].T
    t_s = points["t_s"][keep]
    n = int(keep.sum())
    ones = np.ones(n, np.uint8)
    where = np.full(n, packet, np.int64)
    return PointBlock(
        t_gps_s=(clock or _clock(float(t_s[0]) if n else 1e9)).gps_time(where, t_s),
        t_device_s=t_s,
        xyz_scs_m=np.stack([-y, x, z], axis=1).astype(np.float32),
        range_m=far[keep].astype(np.float32),
        azimuth_rad=np.mod(np.arctan2(-y, x), 2 * np.pi).astype(np.float32),
        ring=points["ring"][keep].astype(np.uint8),
        laser=points["ring"][keep].astype(np.uint8),
        intensity=np.clip(points["bright"][keep], 0, 255).astype(np.uint8),
        return_number=ones,
        n_returns=ones,
        packet=where,
    )


def _say_stamps(report: IntegrityReport, lag_s: ArrayF) -> None:
    typical = float(np.median(lag_s)) if len(lag_s) else 0.0
    report.note(
        "Stamps are those of the messages' headers, taken as UTC: the clock of the computer or sensor."
    )
    if abs(typical) > _REPLAYED_S:
        days = abs(typical) / 86_400.0
        report.note(
            f"The recorder's clock is {days:,.1f} days ahead of the headers: recorded from a replay."
            if days > 0.5
            else f"The recorder's clock differs from the headers by {typical:,.1f} s."
        )


@lru_cache(maxsize=8)
def velodyne_capture(path: Path) -> Path:
    """Velodyne packets of a bag as a network capture with their stamps, for the reader of Velodyne's packets.

    It lies in a temporary folder as long as this process runs.

    Raises
    ------
    InputError : no topic of packets, or several.
    """
    topic = _one(path, "Velodyne packets", _VELODYNE)
    folder = tempfile.TemporaryDirectory(prefix="thalweg-bag-")
    atexit.register(folder.cleanup)
    target = Path(folder.name) / f"{path.stem}.pcap"
    with target.open("wb") as out:
        out.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65_535, 1))
        for _, _, message in _messages(path, topic):
            for packet in message.packets:
                data = bytes(packet.data)
                ip = struct.pack(">BBHHHBBH", 0x45, 0, 28 + len(data), 0, 0, 64, 17, 0) + _ADDRESSES
                frame = bytes(12) + b"\x08\0" + ip + struct.pack(">HHHH", 2368, 2368, 8 + len(data), 0) + data
                stamp = (packet.stamp.sec, packet.stamp.nanosec // 1000)
                out.write(struct.pack("<IIII", *stamp, len(frame), len(frame)) + frame)
    return target


# ---------------------------------------------------------------- positions, poses, depths


def read_bag_positions(files: Sequence[Path], options: TrackOptions) -> PositionLog:
    """Positions of NavSatFix, and depths of a Range that looks down.

    Raises
    ------
    InputError : no topic of positions, or several.
    """
    report = IntegrityReport(
        stream="gnss", format="ROS NavSatFix", files=[str(path) for path in files], time_scale="host"
    )
    positions = pd.concat([_fixes(path, report) for path in files], ignore_index=True)
    depths = pd.concat([_depths(path, report) for path in files], ignore_index=True)
    report.synchronised = len(positions) > 0
    report.take_times(positions["t_gps_s"], "positions")
    report.count("positions", len(positions))
    return PositionLog(positions=positions, depths=depths if len(depths) else None, report=report)


def _fixes(path: Path, report: IntegrityReport) -> pd.DataFrame:
    topic = _one(path, "NavSatFix", _FIXES)
    rows, lags = [], []
    for stamp_s, recorded_s, fix in _messages(path, topic, report):
        status = int(fix.status.status)
        if status < 0 or not np.isfinite([fix.latitude, fix.longitude]).all():
            report.count("positions_without_fix")
            continue
        lags.append(recorded_s - stamp_s)
        cov = np.asarray(fix.position_covariance, np.float64).reshape(3, 3)
        known = int(fix.position_covariance_type) > 0
        sigma = np.sqrt(np.maximum(np.diag(cov), 0.0)) if known else np.full(3, math.nan)
        full = int(fix.position_covariance_type) == 3
        rows.append(
            {
                "t_gps_s": float(gps_from_unix(stamp_s)),
                "lat_deg": float(fix.latitude),
                "lon_deg": float(fix.longitude),
                "h_ell_m": float(fix.altitude),
                "fix": _FIX_STATUS.get(status, "single"),
                "n_sats": -1,
                "sigma_east_m": sigma[0],
                "sigma_north_m": sigma[1],
                "sigma_up_m": sigma[2],
                "cov_en_m2": cov[0, 1] if full else math.nan,
                "cov_eu_m2": cov[0, 2] if full else math.nan,
                "cov_nu_m2": cov[1, 2] if full else math.nan,
            }
        )
    _say_stamps(report, np.array(lags))
    report.note("Heights of NavSatFix are above the ellipsoid, if its driver keeps to the definition.")
    return frame_of(GNSS_POSITION, dict(pd.DataFrame(rows, columns=GNSS_POSITION.names)), unknown=np.nan)


def _depths(path: Path, report: IntegrityReport) -> pd.DataFrame:
    rows = []
    topics = [name for name in _topics(path, _RANGE) if _looks_down(name)]
    for topic in topics[:1]:
        for k, (stamp_s, _, message) in enumerate(_messages(path, topic, report), start=1):
            seen = message.min_range <= message.range <= message.max_range
            depth = float(message.range) if seen else 0.0
            rows.append(
                {"t_gps_s": float(gps_from_unix(stamp_s)), "depth_m": depth, "sentence": topic, "line": k}
            )
    for other in topics[1:]:
        report.note(f"Depths are those of {topics[0]}; {other} is left out.")
    return frame_of(DEPTH, dict(pd.DataFrame(rows, columns=DEPTH.names)), unknown=np.nan)


def read_bag_poses(files: Sequence[Path], options: TrackOptions) -> PoseLog:
    """Attitudes of an Imu with the positions of NavSatFix beside it.

    Raises
    ------
    InputError : no or several topics of either, or an Imu that gives no orientation.
    """
    report = IntegrityReport(
        stream="ins", format="ROS Imu and NavSatFix", files=[str(path) for path in files], time_scale="host"
    )
    positions = pd.concat([_fixes(path, report) for path in files], ignore_index=True)
    depths = pd.concat([_depths(path, report) for path in files], ignore_index=True)
    states = pd.concat([_attitudes(path, report) for path in files], ignore_index=True)
    t, at = states["t_gps_s"].to_numpy(), positions.drop_duplicates("t_gps_s").sort_values("t_gps_s")
    for name in ("lat_deg", "lon_deg", "h_ell_m", "sigma_east_m", "sigma_north_m", "sigma_up_m"):
        states[name] = np.interp(t, at["t_gps_s"], at[name], left=np.nan, right=np.nan)
    states["filter_status"] = np.where(states["lat_deg"].notna(), NAVIGATION_INITIALISED, 0).astype(np.uint16)
    report.synchronised = True
    report.take_times(t, "states")
    report.count("states", len(states))
    report.count("positions", len(positions))
    report.note("Positions are those of the receiver's antenna, between its fixes.")
    return PoseLog(states=states, positions=positions, depths=depths if len(depths) else None, report=report)


def _attitudes(path: Path, report: IntegrityReport) -> pd.DataFrame:
    topic = _one(path, "Imu", _IMU)
    stamps, quaternions, variances, rates = [], [], [], []
    for stamp_s, _, message in _messages(path, topic, report):
        q = message.orientation
        unit = abs(q.x**2 + q.y**2 + q.z**2 + q.w**2 - 1.0) < 0.01
        if message.orientation_covariance[0] == -1 or not unit:
            report.count("messages_without_orientation")
            continue
        stamps.append(stamp_s)
        quaternions.append([q.x, q.y, q.z, q.w])
        variances.append(np.asarray(message.orientation_covariance)[[0, 4, 8]])
        rates.append([message.angular_velocity.x, -message.angular_velocity.y, -message.angular_velocity.z])
    if not stamps:
        raise InputError(
            f"the Imu {topic} gives no orientation",
            expected="an orientation with each message, as filters and drivers of an INS publish it",
            where=path,
            cure="Record the filter's topic, or take the poses of another program (SBET, TUM)",
        )
    R = Rotation.from_quat(np.array(quaternions)).as_matrix() @ np.diag([1.0, -1.0, -1.0])
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
