"""Bags of ROS: written here by rosbags, and real ones beside its counts."""

import io
import re
from functools import partial
from pathlib import Path
from typing import Any

import dpkt
import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose
from PIL import Image
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from tests.ingest.writers import new_campaign, noted, read_or_refused
from thalweg.cli import main
from thalweg.core import InputError, LocalFrame, gps_from_unix, rotation_opk
from thalweg.ingest import NAVIGATION_INITIALISED, IntegrityReport, LidarOptions, TrackOptions
from thalweg.ingest.photos import read_image_stamps
from thalweg.ingest.recorders import (
    mounts_of_bag,
    packets_of_bag,
    read_bag_positions,
    streams_of_bag,
    write_bag_images,
)
from thalweg.ingest.recorders.ros import _say_stamps, _times
from thalweg.ingest.registry import (
    describe,
    lidar_reader,
    read_depths,
    read_poses,
    read_positions,
    recognise,
    stream_of,
)
from thalweg.settings import load_campaign
from thalweg.workflow import CampaignFiles

UNIX_S = 1_700_000_000
FORMAT = {7: "f4", 8: "f8", 6: "u4", 4: "u2", 2: "u1"}
KIND = {name: number for number, name in FORMAT.items()}


class Bag:
    """A bag of ROS 1 or 2 that grows by messages."""

    def __init__(self, path: Path, ros: int = 1) -> None:
        self.path, self.ros = path, ros
        self.store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
        frames = "geometry_msgs/TransformStamped[] transforms"
        self.store.register(get_types_from_msg(frames, "tf2_msgs/msg/TFMessage"))
        self.writer: Any = Writer1(path) if ros == 1 else Writer2(path, version=9)
        self.writer.open()
        self.topics: dict[str, Any] = {}

    def of(self, name: str, /, **fields: Any) -> Any:
        if name == "std_msgs/msg/Header" and self.ros == 1:
            fields["seq"] = 0
        return self.store.types[name](**fields)

    def axes(self, name: str, *values: float) -> Any:
        """A Vector3, Point or Quaternion."""
        return self.of(f"geometry_msgs/msg/{name}", **dict(zip("xyzw", values, strict=False)))

    def header(self, t_s: float, frame: str = "body") -> Any:
        whole = int(np.floor(t_s))
        stamp = self.of("builtin_interfaces/msg/Time", sec=whole, nanosec=round((t_s - whole) * 1e9))
        return self.of("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def write(self, topic: str, name: str, t_s: float, **fields: Any) -> None:
        """A message with these fields that was recorded then."""
        if topic not in self.topics:
            self.topics[topic] = self.writer.add_connection(topic, name, typestore=self.store)
        serialize = self.store.serialize_ros1 if self.ros == 1 else self.store.serialize_cdr
        self.writer.write(self.topics[topic], round(t_s * 1e9), serialize(self.of(name, **fields), name))

    def say(self, topic: str, name: str, t_s: float, *, frame: str = "body", **fields: Any) -> None:
        """A message with a header of the time at which it was recorded."""
        self.write(topic, name, t_s, header=self.header(t_s, frame), **fields)

    def rows(self, kind: np.dtype, data: bytes, height: int, width: int, row_step: int) -> dict[str, Any]:
        """What a PointCloud2 says of points as they lie in memory; the field ``_`` is padding."""
        fields = [
            self.of("sensor_msgs/msg/PointField", name=n, offset=at, datatype=KIND[of.str[1:]], count=1)
            for n, (of, at) in (kind.fields or {}).items()
            if n != "_"
        ]
        return {
            "height": height, "width": width, "fields": fields, "is_bigendian": kind["x"].str[0] == ">",
            "point_step": kind.itemsize, "row_step": row_step, "data": np.frombuffer(data, np.uint8),
            "is_dense": True,
        }  # fmt: skip

    def cloud(
        self, topic: str, t_s: float, rows: Any, *, recorded_s: float | None = None, frame: str = "os_lidar"
    ) -> None:
        """A cloud whose fields are the columns of a structured array; 5 bytes of padding behind each."""
        padded = np.zeros(len(rows), [*rows.dtype.descr, ("_", "V5")])
        padded[[*rows.dtype.names]] = rows
        whole = self.rows(padded.dtype, padded.tobytes(), 1, len(rows), padded.nbytes)
        name = "sensor_msgs/msg/PointCloud2"
        self.write(topic, name, recorded_s or t_s, header=self.header(t_s, frame), **whole)

    def fix(self, t_s: float, k: int, *, status: int = 2, topic: str = "/fix", known: int = 3) -> None:
        """A fix; ``known`` of its covariance: 0 nothing, 1 and 2 the variances, 3 all of it."""
        cov = 1e-4 * np.array([[4, 1, -2], [1, 9, 3], [-2, 3, 16]])
        self.say(
            topic, "sensor_msgs/msg/NavSatFix", t_s, latitude=51.0 + 1e-6 * k, longitude=13.0, altitude=146.5,
            status=self.of("sensor_msgs/msg/NavSatStatus", status=status, service=1),
            position_covariance=cov.ravel(), position_covariance_type=known,
        )  # fmt: skip

    def imu(
        self,
        t_s: float,
        xyzw: tuple[float, ...],
        *,
        known: bool = True,
        topic: str = "/imu/data",
        felt: Any = (),
    ) -> None:
        felt = felt or Rotation.from_quat(xyzw).inv().apply([0.0, 0.0, 9.8])
        orientation_covariance = np.diag([1e-6 if known else -1.0, 4e-6, 9e-6]).ravel()
        self.say(
            topic, "sensor_msgs/msg/Imu", t_s, orientation=self.axes("Quaternion", *xyzw),
            orientation_covariance=orientation_covariance,
            angular_velocity=self.axes("Vector3", 0.1, 0.2, 0.3), angular_velocity_covariance=np.zeros(9),
            linear_acceleration=self.axes("Vector3", *felt), linear_acceleration_covariance=np.zeros(9),
        )  # fmt: skip

    def odometry(
        self, t_s: float, place: tuple[float, ...], xyzw: tuple[float, ...], covariance: Any
    ) -> None:
        place, turn = self.axes("Point", *place), self.axes("Quaternion", *xyzw)
        pose = self.of("geometry_msgs/msg/Pose", position=place, orientation=turn)
        zero = self.axes("Vector3", 0.0, 0.0, 0.0)
        twist = self.of("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        self.say(
            "/odom", "nav_msgs/msg/Odometry", t_s, frame="map", child_frame_id="base_link",
            pose=self.of("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.ravel(covariance)),
            twist=self.of("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )  # fmt: skip

    def mounting(self, frame: str, child: str, shift: tuple[float, ...], xyzw: tuple[float, ...]) -> None:
        shift, turn = self.axes("Vector3", *shift), self.axes("Quaternion", *xyzw)
        step = self.of("geometry_msgs/msg/Transform", translation=shift, rotation=turn)
        name, header = "geometry_msgs/msg/TransformStamped", self.header(UNIX_S, frame)
        stamped = self.of(name, header=header, child_frame_id=child, transform=step)
        self.write("/tf_static", "tf2_msgs/msg/TFMessage", UNIX_S, transforms=[stamped])

    def depth(self, topic: str, t_s: float, metres: float) -> None:
        reach = {"field_of_view": 0.1, "min_range": 0.3, "max_range": 50.0, "range": metres}
        self.say(topic, "sensor_msgs/msg/Range", t_s, radiation_type=0, **reach)

    def close(self) -> Path:
        self.writer.close()
        return self.path if self.ros == 1 else next(self.path.glob("*.db3"))

    def lidar(self, *topics: str) -> tuple[Any, Any]:
        """The closed bag's reader of clouds, and its scan."""
        reader = lidar_reader([self.close()], LidarOptions(topics=list(topics)))
        return reader, reader.scan()


@pytest.fixture
def bag(tmp_path):
    return Bag(tmp_path / "boat.bag")


def points(time: str, kind: str, values: list[float]) -> Any:
    """Three points: 10 m ahead, 5 m to the left, none."""
    dtype = [("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "f4"), (time, kind), ("ring", "u2")]
    rows = np.zeros(3, np.dtype(dtype))
    rows["x"], rows["y"], rows["z"] = [10, 0, 0], [0, 5, 0], [1, 2, 0]
    rows["intensity"], rows["ring"], rows[time] = [7, 300, 0], [4, 5, 6], values
    return rows


def test_points_have_their_own_times(bag):
    for k in range(3):
        bag.cloud("/points", UNIX_S + 0.1 * k, points("time", "f4", [0.05, -0.05, 0.0]))
    reader, scan = bag.lidar()
    assert (scan.n_points, scan.report.counts["shots_without_return"]) == (6, 3)
    assert not noted(scan, "no times of their own")
    assert reader.length_s() == pytest.approx(0.2)
    for clock in (None, scan.clock):
        block = next(reader.points(clock))
        assert block.t_gps_s - float(gps_from_unix(UNIX_S)) == pytest.approx([0.05, -0.05], abs=1e-6)
    # right, forward, up
    assert block.xyz_scs_m.tolist() == [[0, 10, 1], [-5, 0, 2]]
    assert block.azimuth_rad.tolist() == pytest.approx([0.0, 1.5 * np.pi])
    assert (block.ring.tolist(), block.intensity.tolist()) == ([4, 5], [7, 255])


def test_times_in_two_fields(bag):
    """Seconds since 1970 and nanoseconds of them, whatever the header says."""
    kinds = [("x", "f4"), ("y", "f4"), ("z", "f4"), ("time_sec", "u4"), ("time_nsec", "u4")]
    rows = np.array([(10, 0, 0, UNIX_S, 250_000_000), (10, 0, 0, UNIX_S + 1, 500_000_000)], kinds)
    for late_s in (0.5, 10.0, 40.0):
        bag.cloud("/points", UNIX_S + 1.5 + late_s, rows)
    reader, scan = bag.lidar()
    block = next(reader.points(scan.clock))
    assert block.t_gps_s - float(gps_from_unix(UNIX_S)) == pytest.approx([0.25, 1.5], abs=1e-6)
    assert noted(scan, "The points are -10.0 s from their headers")


def test_points_without_times_are_told(bag):
    bag.cloud("/points", UNIX_S, points("other", "f4", [0, 0, 0]), recorded_s=UNIX_S + 20 * 86_400)
    notes = " ".join(bag.lidar()[1].report.notes)
    assert "up to a turn of the lidar off" in notes
    assert "20.0 days ahead of the headers: recorded from a replay" in notes


def sweep(time: str, kind: str, values: Any, n: int = 20_000) -> Any:
    """A turn of some points in 0.1 s, 10 m ahead."""
    rows = np.zeros(n, np.dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), (time, kind), ("ring", "u2")]))
    rows["x"], rows[time] = 10.0, values
    return rows


TURN = np.linspace(0.0, 0.1, 20_000)


UNITS = """\
time      f4 header  1    seconds since the header
t         u4 header  1e-9 nanoseconds since the header
t         u4 header  1e-6 microseconds since the header
time      f4 header  1e-6 microseconds since the header
time      f4 header  1e-3 milliseconds since the header
time      f4 end     1    seconds since the header
timestamp f8 epoch   1    seconds since 1970
timestamp f8 epoch   1e-6 microseconds since 1970
timestamp f8 epoch   1e-9 nanoseconds since 1970
"""
"""Field of a cloud, its type, from where it counts, its unit in seconds, and what is told."""


@pytest.mark.parametrize("case", UNITS.splitlines())
def test_units_of_times_of_points(bag, case):
    field, kind, zero, unit_s, told = case.split(maxsplit=4)
    since_s = {"header": 0.0, "end": -0.1, "epoch": UNIX_S}[zero]
    bag.cloud("/points", UNIX_S, sweep(field, kind, (since_s + TURN) / float(unit_s)))
    reader, scan = bag.lidar()
    words = f"Times of points: field {field}, {told}."
    assert [note for note in scan.report.notes if "Times of points" in note] == [words]
    t = np.concatenate([block.t_gps_s for block in reader.points(scan.clock)])
    assert t - float(gps_from_unix(UNIX_S)) == pytest.approx(TURN + min(since_s, 0.0), abs=2e-6)


@pytest.mark.parametrize(
    ("rows", "why"),
    [
        (sweep("t", "u4", 0), r"field t, 0\) count neither"),  # many points at once
        (sweep("timestamp", "f8", 291.0 + TURN), r"field timestamp, 291 to 291\.1\) count neither"),
        (sweep("timestamp", "f4", UNIX_S + TURN), r"field timestamp\) are rounded by their float32"),
        (sweep("stamp", "f4", TURN), "no times of their own"),
    ],
)
def test_times_that_are_none_are_told(bag, rows, why):
    bag.cloud("/points", UNIX_S, rows)
    reader, scan = bag.lidar()
    assert re.search(why + r".*all of a cloud get the time of its header", " ".join(scan.report.notes))
    assert set(next(reader.points(scan.clock)).t_gps_s) == {float(gps_from_unix(UNIX_S))}


@pytest.mark.parametrize(("big_endian", "cut"), [(False, 0), (True, 0), (True, 1)])
def test_organized_clouds_with_padded_rows(bag, big_endian, cut):
    """Two rows of three points, 7 bytes behind each; of a row that is cut off no point is taken."""
    order = ">" if big_endian else "<"
    one = np.zeros(6, [("x", f"{order}f4"), ("y", f"{order}f4"), ("z", f"{order}f4"), ("_", "u1")])
    one["x"] = [1, 2, np.nan, 4, 5, 6]
    rows = b"".join(part.tobytes() + bytes(7) for part in (one[:3], one[3:]))
    whole = bag.rows(one.dtype, rows[: len(rows) - cut], 2, 3, 46)
    bag.say("/points", "sensor_msgs/msg/PointCloud2", UNIX_S, frame="os_lidar", **whole)
    reader, scan = bag.lidar()
    ahead = np.concatenate([block.xyz_scs_m[:, 1] for block in reader.points(scan.clock)]).tolist()
    assert ahead == ([1, 2] if cut else [1, 2, 4, 5, 6])
    assert scan.report.losses == ({"points_cut_off": 3} if cut else {})
    assert scan.report.counts["shots_without_return"] == 1


@pytest.mark.parametrize("timebase", [1_000_000_000 * UNIX_S, 42_000_000])
def test_messages_of_a_livox(bag, timebase):
    """Offsets in nanoseconds from the time base, or, where that counts from the start, from the header."""
    point, cloud = (f"livox_ros_driver2/msg/Custom{name}" for name in ("Point", "Msg"))
    kinds = "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line\n"
    bag.store.register(get_types_from_msg(kinds, point))
    head = "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n"
    bag.store.register(get_types_from_msg(f"{head}livox_ros_driver2/CustomPoint[] points\n", cloud))
    two = [
        bag.of(point, offset_time=ns, x=10.0, y=0.0, z=k, reflectivity=7, tag=0, line=3)
        for k, ns in enumerate((0, 50_000_000))
    ]
    numbers = {"timebase": timebase, "point_num": 2, "lidar_id": 0, "rsvd": np.zeros(3, np.uint8)}
    bag.say("/livox/lidar", cloud, UNIX_S + (timebase < 1e9), points=two, **numbers)
    reader, scan = bag.lidar()
    block = next(reader.points(scan.clock))
    begin = float(gps_from_unix(UNIX_S)) + (timebase < 1e9)
    assert block.t_gps_s - begin == pytest.approx([0.0, 0.05], abs=1e-6)
    assert block.xyz_scs_m.tolist() == [[0, 10, 0], [0, 10, 1]]
    assert (block.ring.tolist(), block.intensity.tolist()) == ([3, 3], [7, 7])


@pytest.mark.parametrize(
    ("field", "kind", "first", "last", "n", "stamp_s", "unit_s", "from_header"),
    [
        ("time", "f4", 0.0, 2.4, 1000, UNIX_S, 1.0, True),
        ("time", "f4", 0.0, 2.6, 1000, UNIX_S, 1e-3, True),  # no lidar takes so long for a turn
        ("time", "f4", -2.4, 0.1, 1000, UNIX_S, 1.0, True),
        ("time", "f4", -2.6, 0.1, 1000, UNIX_S, 1e-3, True),
        ("t", "u4", 0, 100_000, 5000, UNIX_S, 1e-9, True),
        ("t", "u4", 0, 100_000, 5200, UNIX_S, 1e-6, True),  # no lidar measures so many in 0.1 ms
        ("t", "i4", -100_000_000, 0, 5200, UNIX_S, 1e-9, True),
        ("timestamp", "f8", 1.0e9 - 1.0, 1.0e9 + 0.1, 9, 5.0, 1.0, False),
        ("timestamp", "f8", 1.0e9 - 1.0, 1.0e9 - 0.1, 9, 5.0, 1e-9, True),
        ("timestamp", "f8", 4.0e9 - 1.0, 4.0e9 - 0.1, 9, 5.0, 1.0, False),
        ("timestamp", "f8", 1.7e12, 1.7e12 + 1.0, 9, 5.0, 1e-3, False),
        ("time", "f8", 1500.0, 1502.4, 9, 1500.0, 1.0, False),  # near the stamp of a device
        ("time", "f8", 1500.0, 1502.6, 9, 1500.0, 1e-3, True),
        ("time", "f8", 900.0, 900.1, 9, 900.0, 1e-3, True),
        ("time", "f4", 1500.0, 1500.1, 9, 1500.0, 1.0, False),  # rounded to 0.1 ms
        ("time_offset", "f4", 0.0, 0.1, 9, UNIX_S, 1.0, True),
    ],
)
def test_units_of_times_on_both_sides_of_their_limits(
    field, kind, first, last, n, stamp_s, unit_s, from_header
):
    rows = np.zeros(n, [("x", "f4"), (field, kind)])
    rows[field] = np.linspace(first, last, n)
    assert _times(rows, stamp_s) == (field, unit_s, from_header, "")


@pytest.mark.parametrize(
    ("lag_s", "note"),
    [
        (4.9, ""), (-5.1, "differs from the headers by -5.1 s"), (43_000.0, "by 43,000.0 s"),
        (43_300.0, "is 0.5 days ahead"), (-86_400.0, "is 1.0 days ahead"),
    ],
)  # fmt: skip
def test_the_recorders_clock_beside_the_headers(lag_s, note):
    report = IntegrityReport(stream="lidar", format="bag", files=["a.bag"])
    _say_stamps(report, np.array([0.0, lag_s, lag_s, lag_s, 1e9]))
    assert len(report.notes) == 1 + bool(note)
    assert note in report.notes[-1]


def test_clouds_of_a_fixed_frame_are_refused(bag):
    bag.cloud("/cloud_registered", UNIX_S, sweep("t", "u4", 0), frame="map")
    with pytest.raises(InputError, match="frame map, which does not move with the lidar"):
        bag.lidar()


def test_brightness_up_to_one_and_headers_without_stamps(bag):
    rows = points("t", "u4", [0, 0, 0])
    rows["intensity"] = [0.2, 1.0, 0.0]
    bag.cloud("/points", 0, rows, recorded_s=UNIX_S)
    reader, scan = bag.lidar()
    block = next(reader.points(scan.clock))
    assert block.intensity.tolist() == [51, 255]
    assert block.t_gps_s[0] == float(gps_from_unix(UNIX_S))
    assert noted(scan, "1 messages have no stamp")


def test_stamps_of_a_device_are_no_dates(bag):
    bag.cloud("/points", 291.1, sweep("t", "u4", 1e9 * TURN), recorded_s=UNIX_S)
    with pytest.raises(InputError, match=r"stamps of /points that count from elsewhere: 291\.1 s"):
        bag.lidar()


LEVEL = (0.0, 0.0, 0.0, 1.0)
HEELED = tuple(Rotation.from_euler("XZ", [5.0, 70.0], degrees=True).as_quat())


def felt(tilt_deg, size=1.0):
    """Acceleration in the body that stands so far from up for the attitude `HEELED`, in parts of gravity."""
    away = np.deg2rad(tilt_deg)
    seen = 9.81 * size * np.array([0.0, np.sin(away), np.cos(away)])
    return tuple(Rotation.from_quat(HEELED).inv().apply(seen))


@pytest.mark.parametrize(
    ("q", "felt", "why"),
    [
        (LEVEL, (0.1, 0.0, 9.8), "in every message: none was measured"),
        (HEELED, (0.0, 0.8, -9.8), "these point 1[678][0-9] degrees away from up"),  # forward, right, down
        (HEELED, (0.0, 0.1, 0.0), None),  # gravity as a filter takes it off
        (HEELED, felt(19.0), None),
        (HEELED, felt(21.0), "these point 21 degrees away from up"),
        (HEELED, felt(90.0, 0.76), "these point 90 degrees away from up"),
        (HEELED, felt(90.0, 1.24), "these point 90 degrees away from up"),
        (HEELED, felt(90.0, 0.74), None),  # that is no gravity
        (HEELED, felt(90.0, 1.26), None),
    ],
)
def test_an_imu_that_contradicts_itself_is_refused(bag, q, felt, why):
    for k in range(5):
        bag.imu(UNIX_S + k, q, felt=felt)
        bag.fix(UNIX_S + k, k)
    files = [bag.close()]
    if why is not None:
        with pytest.raises(InputError, match=why):
            read_poses(files, "ins")
    options = TrackOptions(body_axes="forward-left-up") if why else TrackOptions()
    assert len(read_poses(files, "ins", options).states) == 5


def test_of_two_lidars_one_is_asked_for(bag):
    bag.cloud("/front", UNIX_S, points("time", "f4", [0, 0, 0]))
    bag.cloud("/rear", UNIX_S, points("time", "f4", [0, 0, 0])[:1])
    path = bag.close()
    with pytest.raises(InputError, match=r"2 topics of clouds.*logs\.lidar: \[boat\.bag#/front\]"):
        lidar_reader([path]).scan()
    assert lidar_reader([path], LidarOptions(topics=["/rear"])).scan().n_points == 1
    with pytest.raises(InputError, match=r"no topic /read of clouds; it holds /front .*, /rear"):
        lidar_reader([path], LidarOptions(topics=["/read"])).scan()


@pytest.mark.parametrize("ros", [1, 2])
def test_a_boat_in_a_bag(tmp_path, ros):
    """Heading 30 degrees east of north is yaw 60 from east, roll 10 to starboard."""
    bag = Bag(tmp_path / ("boat.bag" if ros == 1 else "boat"), ros)
    q = tuple(Rotation.from_euler("ZYX", [60.0, 0.0, 10.0], degrees=True).as_quat())
    for k in range(20):
        bag.fix(UNIX_S + 0.2 * k, k, status=-1 if k == 7 else 2, known=max(3 - k, 0))
        bag.imu(UNIX_S + 0.2 * k + 0.1, q)
        bag.depth("/range/ahead", UNIX_S + 0.2 * k, 30.0)
        bag.depth("/echo_sounder", UNIX_S + 0.2 * k, 99.0 if k == 3 else 4.0)
    path = bag.close()
    assert recognise(path) == "rosbag"
    assert streams_of_bag(path) == {"ins": [("/imu/data", "/fix")], "depth": [("/echo_sounder",)]}
    log = read_poses([path], "ins")
    assert len(log.states) == 20
    row = log.states.iloc[10]
    assert np.rad2deg([row.roll_rad, row.pitch_rad, row.heading_rad]) == pytest.approx([10, 0, 30], abs=1e-6)
    assert row.lat_deg == pytest.approx(51.0 + 1.05e-5, abs=1e-12)
    assert row.t_gps_s == pytest.approx(float(gps_from_unix(UNIX_S + 2.1)), abs=1e-6)
    assert (row.rate_x_radps, row.rate_y_radps, row.rate_z_radps) == pytest.approx((0.1, -0.2, -0.3))
    angles = (row.sigma_roll_rad, row.sigma_pitch_rad, row.sigma_heading_rad)
    assert angles == pytest.approx((0.001, 0.002, 0.003))
    assert np.isnan(log.states["lat_deg"].iloc[-1]), "after the last fix"
    fix = read_bag_positions([path], TrackOptions()).positions
    assert len(fix) == 19
    sigmas = fix[["sigma_east_m", "sigma_north_m", "sigma_up_m"]].to_numpy()
    assert_allclose(sigmas[:3], [[0.02, 0.03, 0.04]] * 3)
    covariances = fix[["cov_en_m2", "cov_eu_m2", "cov_nu_m2"]].to_numpy()
    assert_allclose(covariances[0], [1e-4, -2e-4, 3e-4])
    assert np.isnan([*sigmas[3:], *covariances[1:]]).all()
    assert_allclose(fix[["lat_deg", "lon_deg", "h_ell_m"]].iloc[9], [51.00001, 13.0, 146.5])
    assert_allclose(fix["t_gps_s"].iloc[9], gps_from_unix(UNIX_S + 2.0))
    depths = read_depths([path]).depths
    assert depths["depth_m"].value_counts().to_dict() == {4.0: 19, 0.0: 1}


def test_poses_of_odometry_lie_at_the_origin_of_the_campaign(bag):
    """100 m east, 50 m north; bow 20 degrees east of north, that is yaw 70; roll 10."""
    origin = LocalFrame(lat_deg=51.0, lon_deg=13.0, h_ell_m=100.0)
    attitude = Rotation.from_euler("ZYX", [70.0, 0.0, 10.0], degrees=True)
    q, turn = tuple(attitude.as_quat()), attitude.as_matrix()
    bow, aside = np.deg2rad([1.0, 2.0]) ** 2
    cov = np.zeros((6, 6))
    cov[:3, :3] = np.diag([0.01, 0.04, 0.09])
    cov[3:, 3:] = turn @ np.diag([bow, aside, np.deg2rad(3.0) ** 2]) @ turn.T
    for k in range(3):
        bag.odometry(UNIX_S + k, (100.0, 50.0, 2.0), q, cov if k else np.zeros((6, 6)))
    path = bag.close()
    assert stream_of("rosbag", path) == "ins"
    log = read_poses([path], "ins", TrackOptions(frame=origin))
    row = log.states.iloc[1]
    place = origin.from_geodetic(row.lat_deg, row.lon_deg, row.h_ell_m)
    assert np.ravel(place) == pytest.approx([100.0, 50.0, 2.0], abs=1e-6)
    # the meridians of origin and boat differ by arc seconds
    assert np.rad2deg([row.roll_rad, row.pitch_rad, row.heading_rad]) == pytest.approx([10, 0, 20], abs=2e-3)
    assert (row.sigma_east_m, row.sigma_north_m, row.sigma_up_m) == pytest.approx((0.1, 0.2, 0.3))
    angles = np.rad2deg([row.sigma_roll_rad, row.sigma_pitch_rad, row.sigma_heading_rad])
    # about the axes of the boat, but the heading about the vertical
    assert angles == pytest.approx([1.0, 2.0, np.sqrt(cov[5, 5]) * 180 / np.pi])
    assert angles[2] < 2.99
    assert log.states[["sigma_east_m", "sigma_roll_rad"]].iloc[0].isna().all()
    assert noted(log, "frame map of the poses is taken for the local frame")


def test_topics_that_are_named_are_taken(bag):
    """Two attitudes, two receivers, two sounders: each reader takes those that are named behind the file."""
    heeled = tuple(Rotation.from_euler("X", 10.0, degrees=True).as_quat())
    for k in range(4):
        bag.imu(UNIX_S + k, LEVEL, topic="/imu/a")
        bag.imu(UNIX_S + k, heeled, topic="/imu/b")
        bag.fix(UNIX_S + k, 0, topic="/gnss/a")
        bag.fix(UNIX_S + k, 1000, topic="/gnss/b")
        bag.depth("/echo/a", UNIX_S + k, 3.0)
        bag.depth("/echo/b", UNIX_S + k, 4.0)
    path = bag.close()
    with pytest.raises(InputError, match=r"4 topics of poses .*logs\.ins: \[boat\.bag#/imu/a\]"):
        read_poses([path], "ins")
    topics = ("/imu/b", "/gnss/b", "/echo/b")
    log = read_poses([path], "ins", TrackOptions(topics=topics[:2]))
    assert log.depths.empty
    assert noted(log, "2 topics of depths (Range): none is read beside. Name")
    log = read_poses([path], "ins", TrackOptions(topics=topics))
    assert set(log.depths["depth_m"]) == {4.0}
    assert np.rad2deg(log.states["roll_rad"].median()) == pytest.approx(10.0)
    assert log.states["lat_deg"].iloc[0] == pytest.approx(51.001)
    with pytest.raises(InputError, match=r"2 topics of depths .*logs\.depth: \[boat\.bag#/echo/a\]"):
        read_depths([path], topics=["/gnss/a"])
    assert set(read_depths([path], topics=["/echo/b"]).depths["depth_m"]) == {4.0}
    positions, _ = read_positions(
        "pos", [path], states=None, base=[], nav=[], ppk={}, base_position={}, topics=["/gnss/b"]
    )
    assert positions["lat_deg"].iloc[0] == pytest.approx(51.001)


def test_attitudes_in_a_hole_of_the_fixes_have_no_position(bag):
    """A receiver that lost its fix for 10 s under a bridge: the boat need not have kept its course."""
    for k in range(20):
        bag.imu(UNIX_S + k, (0.0, 0.0, 0.6, 0.8))
        bag.fix(UNIX_S + k, k, status=-1 if k == 0 or 4 < k < 15 else 2)
    log = read_poses([bag.close()], "ins")
    assert np.flatnonzero(log.states["lat_deg"].isna()).tolist() == [0, *range(5, 15)]
    # the attitude goes on in the hole
    assert log.states["filter_status"].tolist() == [0] + [NAVIGATION_INITIALISED] * 19
    assert log.report.counts["states_without_position"] == 11


def test_attitudes_without_a_fix_are_refused(bag):
    for k in range(4):
        bag.imu(UNIX_S + k, LEVEL)
        bag.fix(UNIX_S + k, k, status=-1)
    path = bag.close()
    for read in (describe, lambda each: read_poses([each], "ins")):
        with pytest.raises(InputError, match="4 positions of /fix, none with a fix"):
            read(path)


def test_depths_without_positions_are_read(bag):
    """The end of its reach, 50 m, is what a driver writes that saw nothing."""
    for k, metres in enumerate([3.0, 50.0, np.inf, 0.1, np.nan]):
        bag.depth("/echo", UNIX_S + k, metres)
    log = read_depths([bag.close()])
    assert log.depths["depth_m"].tolist() == [3.0, 0.0, 0.0, 0.0, 0.0]
    assert (len(log.positions), log.report.synchronised) == (0, True)


def test_mounting_of_tf_static(bag):
    """The lidar is 1 m ahead of the INS, 0.2 to starboard, 0.5 above, and looks to the left by 30 degrees."""
    bag.imu(UNIX_S, LEVEL)
    bag.fix(UNIX_S, 0)
    bag.cloud("/points", UNIX_S, points("time", "f4", [0, 0, 0]))
    # the body is turned in the hull by 90 degrees, and the lidar hangs on a mast
    half, quarter = (Rotation.from_euler("Z", angle, degrees=True) for angle in (60.0, 90.0))
    bag.mounting("hull", "body", (0.0, 0.0, 1.0), tuple(quarter.as_quat()))
    bag.mounting("hull", "mast", (0.0, 2.0, 0.0), tuple(half.as_quat()))
    arm = np.add(quarter.apply([1.0, -0.2, 0.5]), [0.0, -2.0, 1.0])
    bag.mounting("mast", "os_lidar", tuple(half.inv().apply(arm)), tuple(half.as_quat()))
    path = bag.close()
    found = mounts_of_bag(path)
    assert set(found) == {"lidar", "antenna"}
    mount = yaml.safe_load("{" + found["lidar"] + "}")
    assert mount["lever_ics_m"] == [1.0, 0.2, -0.5]
    R = rotation_opk(*np.deg2rad([mount[f"{name}_deg"] for name in ("omega", "phi", "kappa")]))
    ahead_of_the_lidar = R @ [0.0, 1.0, 0.0]  # forward, right, down of the body
    assert ahead_of_the_lidar == pytest.approx([np.cos(np.pi / 6), -0.5, 0.0], abs=1e-4)
    assert pytest.approx([0, 0, -1], abs=1e-4) == R @ [0.0, 0.0, 1.0]


@pytest.mark.parametrize("maker", ["velodyne", "ouster"])
def test_packets_of_a_bag_become_a_capture(bag, maker):
    """Each packet with its time and its port, an Ouster's with the metadata beside it; read by dpkt."""
    times = UNIX_S + np.array([0.25, 0.250001, 1.75])
    data = [np.random.default_rng(k).integers(0, 256, 1206).astype(np.uint8) for k in range(3)]
    if maker == "velodyne":
        packet = "builtin_interfaces/Time stamp\nuint8[1206] data\n"
        scan = "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n"
        bag.store.register(get_types_from_msg(packet, "velodyne_msgs/msg/VelodynePacket"))
        bag.store.register(get_types_from_msg(scan, "velodyne_msgs/msg/VelodyneScan"))
        packets = [
            bag.of("velodyne_msgs/msg/VelodynePacket", stamp=bag.header(t).stamp, data=values)
            for t, values in zip(times, data, strict=True)
        ]
        bag.say("/packets", "velodyne_msgs/msg/VelodyneScan", UNIX_S, packets=packets)
        port = 2368
    else:
        bag.store.register(get_types_from_msg("uint8[] buf\n", "ouster_ros/msg/PacketMsg"))
        for t, values in zip(times, data, strict=True):
            for kind in ("lidar", "imu"):
                bag.write(f"/os/{kind}_packets", "ouster_ros/msg/PacketMsg", t, buf=values)
        text = '{"beam_altitude_angles": 1, "lidar_origin_to_beam_origin_mm": 2, "udp_port_lidar": 7777}'
        bag.write("/os/metadata", "std_msgs/msg/String", UNIX_S, data=text)
        port = 7777
    kind, files = packets_of_bag(bag.close(), [])
    assert kind == maker
    if maker == "ouster":
        assert files.pop(0).read_text() == text
    (capture,) = files
    with capture.open("rb") as stream:
        rows = [(t, dpkt.ethernet.Ethernet(frame).data) for t, frame in dpkt.pcap.Reader(stream)]
    assert [t for t, _ in rows] == pytest.approx(times, abs=1e-7)
    for (_, ip), values in zip(rows, data, strict=True):
        assert (ip.data.sport, ip.data.dport, ip.data.ulen, ip.len) == (port, port, 1214, 1234)
        assert ip.data.data == values.tobytes()


def test_a_new_campaign_names_the_topics(tmp_path, bag, capsys):
    """Of two lidars the fuller is named, the other told; the plan knows file and topic apart."""
    for k in range(4):
        bag.cloud("/front", UNIX_S + k, points("time", "f4", [0, 0, 0]))
        bag.fix(UNIX_S + k, k)
        bag.imu(UNIX_S + k, LEVEL)
    bag.cloud("/rear", UNIX_S, points("time", "f4", [0, 0, 0]))
    bag.mounting("body", "os_lidar", (1.0, -0.2, 1.5), LEVEL)
    path = str(bag.close())
    file = new_campaign(tmp_path, tmp_path / "campaigns")
    assert "lidar from /front; or name /rear" in capsys.readouterr().err
    text = file.read_text(encoding="utf-8")
    assert "boat.bag#/front]" in text
    assert "lever_ics_m: [1.000, 0.200, -1.500]" in text
    files = CampaignFiles(name="boat", campaigns={"boat": load_campaign(file)})
    assert (files.logs("lidar"), files.logs("ins")) == ([path], [path])
    options = LidarOptions(**files.lidar_options())
    assert lidar_reader([Path(path)], options).scan().report.counts["clouds"] == 4
    assert files.topics("ins") == []
    file.write_text(text.replace("#/front]", "#/front, ../boat.bag#/rear]"), encoding="utf-8")
    assert load_campaign(file).topics("lidar") == ["/front", "/rear"]


def test_images_of_a_bag_are_photographs_with_times(tmp_path, bag, capsys):
    """A red pixel of a raw image in blue, green, red stays red; a JPEG stays what it was, byte for byte."""
    out = tmp_path / "photos"
    jpeg = io.BytesIO()
    Image.new("RGB", (4, 2), (0, 255, 0)).save(jpeg, "JPEG")
    whole = {"format": "jpeg", "data": np.frombuffer(jpeg.getvalue(), np.uint8)}
    for k in range(4):
        header = bag.header(UNIX_S + 0.25 * k)
        bag.write("/left", "sensor_msgs/msg/CompressedImage", UNIX_S + k, header=header, **whole)
    raw = np.zeros((2, 3 * 3 + 1), np.uint8)  # a byte of padding behind each row
    raw[0, 2] = 255
    fields = {"height": 2, "width": 3, "encoding": "bgr8", "is_bigendian": 0, "step": 10, "data": raw.ravel()}
    bag.say("/right", "sensor_msgs/msg/Image", UNIX_S, **fields)
    path = bag.close()
    with pytest.raises(InputError, match=r"2 topics of images; it holds /left, /right.*--topic"):
        write_bag_images(path, out)
    command = ["frames", str(path), "--topic", "/left", "--every", "0.5", "--out", str(out)]
    assert main(command) == 0
    assert "2 images with the stamps of their headers" in capsys.readouterr().out
    stamps = read_image_stamps(out, times=out / "times.csv").table
    assert stamps["file"].tolist() == ["boat_000000.jpg", "boat_000002.jpg"]
    expected = gps_from_unix(np.array([UNIX_S, UNIX_S + 0.5]))
    assert stamps["t_device_s"].to_numpy() == pytest.approx(expected, abs=1e-5)
    assert (out / "boat_000002.jpg").read_bytes() == jpeg.getvalue()
    write_bag_images(path, tmp_path / "raw", "/right")
    with Image.open(tmp_path / "raw/boat_000000.png") as picture:
        assert picture.size == (3, 2)
        assert [picture.getpixel((k, 0)) for k in (0, 1)] == [(255, 0, 0), (0, 0, 0)]


def test_an_imu_without_orientation_is_no_pose(bag):
    bag.fix(UNIX_S, 0)
    bag.imu(UNIX_S, LEVEL, known=False)
    path = bag.close()
    with pytest.raises(InputError, match="gives no orientation"):
        read_poses([path], "ins")


def test_damaged_bags_are_read_or_refused(tmp_path, bag, fuzz):
    for k in range(20):
        bag.fix(UNIX_S + k, k)
    read = partial(read_bag_positions, options=TrackOptions())
    for _, log in read_or_refused(fuzz, tmp_path / "fuzz.bag", read, bag.close().read_bytes()):
        assert len(log.positions) <= 20
    fuzz.check(read=0.01, troubled=0.8)  # an index that is damaged is mended by the tools of ROS


def test_a_cut_bag_is_refused_with_its_cure(tmp_path, bag):
    for k in range(50):
        bag.fix(UNIX_S + k, k)
    path = bag.close()
    path.write_bytes(path.read_bytes()[:6_000])
    with pytest.raises(InputError, match=r"cannot be opened.*rosbag reindex"):
        describe(path)
    with pytest.raises(InputError, match=r"cannot be opened.*Give it the ending"):
        describe(path.rename(tmp_path / "boat"))


@pytest.mark.real
def test_real_bags(data_dir):
    """Points, stamps, the 237.8 days of a replay; as many packets of a Velodyne as its capture has."""
    today = data_dir / "today"
    reader = lidar_reader([today / "ros1_luminar_pointcloud2/test.bag"])
    scan = reader.scan()
    assert noted(scan, "237.8 days")
    blocks = list(reader.points(scan.clock))
    assert [block.n for block in blocks[:3]] == [35_707, 36_055, 36_267]
    assert blocks[0].t_gps_s[0] == pytest.approx(float(gps_from_unix(1583971570.0)), abs=0.2)
    packets = lidar_reader([next((today / "ros2_velodyne_vlp32_packets").glob("*.db3"))]).scan()
    assert (packets.model, packets.report.counts["data_packets"]) == ("VLP-32C", 379)
    path = next((today / "ros2_hesai_xt32_packets").glob("*.db3"))
    with pytest.raises(InputError, match="Packets of a Hesai are not read: play them to PointCloud2"):
        lidar_reader([path]).scan()


@pytest.mark.real
def test_real_packets_of_an_ouster(data_dir):
    """Columns and device time as ouster-sdk's own reader of the bag states them."""
    pytest.importorskip("ouster.sdk.core", reason="the extra thalweg[ouster] is not installed")
    reader = lidar_reader([data_dir / "today/ros1_ouster_packets/512x10_raw.bag"])
    scan = reader.scan()
    assert (scan.model, scan.report.counts["frames"], scan.report.counts["columns"]) == ("OS-0-128", 1, 512)
    assert (scan.report.t_first_s, scan.report.t_last_s) == pytest.approx((291.159252580, 291.258956760))
    assert scan.report.files == [str(path) for path in reader.files]
    assert sum(block.n for block in reader.points(scan.clock)) == scan.n_points
