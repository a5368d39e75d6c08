"""A drive of KITTI (raw, synchronised, rectified) as a bag of ROS, as `drive.yaml` beside this file names it.

    python config/campaigns/voyage/kitti.py FOLDER_OF_THE_DAY [raise the beams by DEGREES]

The folder is such as `2011_09_26`: calibrations and one drive. It writes `data/drive.bag`, which holds what
the files say and no more: revolutions of the lidar with time and laser of each point, and the poses of the
OxTS RT3003 with the position accuracy that it states. With 0.205 degrees it writes `data/drive_raised.bag`,
whose beams all point so much higher, as programs of lidar odometry (KISS-ICP) correct the scans of KITTI.

A revolution begins behind the car and turns counterclockwise (readme of the raw data), so that a point's
time lies between those of `timestamps_start` and `timestamps_end` as its direction does between -180 and
180 degrees. A file holds the lasers one after the other, each counterclockwise from the front.
"""

import sys
from pathlib import Path
from typing import Final

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

HERE: Final = Path(__file__).parent / "data"
ROLL_PITCH_RAD, HEADING_RAD = np.deg2rad([0.03, 0.1])
"""Standard deviations of an RT3003 by its data sheet: the files state those of positions alone."""
STORE: Final = get_typestore(Stores.ROS1_NOETIC)
TYPES: Final = STORE.types
POINT: Final = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("t", "<u4"), ("ring", "u1")]
)
"""A point: lidar frame (forward, left, up), metres; brightness 0 to 255; nanoseconds since the header."""


def stamps_ns(file: Path) -> np.ndarray:
    """Times of a drive's table, nanoseconds (n,): the computer's clock, taken as UTC."""
    return np.array(file.read_text().split("\n")[: -1 or None], "datetime64[ns]").astype(np.int64)


def header(t_ns: int, frame: str) -> object:
    """Header of a message."""
    time = TYPES["builtin_interfaces/msg/Time"](sec=int(t_ns // 10**9), nanosec=int(t_ns % 10**9))
    return TYPES["std_msgs/msg/Header"](seq=0, stamp=time, frame_id=frame)


def cloud(file: Path, begin_ns: int, end_ns: int, raised_rad: float) -> object:
    """One revolution as PointCloud2."""
    x, y, z, bright = np.fromfile(file, "<f4").reshape(-1, 4).T
    level, cos, sin = np.hypot(x, y), np.cos(raised_rad), np.sin(raised_rad)
    stretched = cos - sin * z / level
    x, y, z = x * stretched, y * stretched, z * cos + level * sin
    turn = np.arctan2(y, x)
    points = np.empty(len(x), POINT)
    points["x"], points["y"], points["z"], points["intensity"] = x, y, z, 255.0 * bright
    points["t"] = (end_ns - begin_ns) * (turn + np.pi) / (2.0 * np.pi)
    points["ring"] = np.concatenate([[0], np.cumsum(np.diff(np.mod(turn, 2.0 * np.pi)) < -np.pi)])
    fields = [
        TYPES["sensor_msgs/msg/PointField"](name=name, offset=POINT.fields[name][1], datatype=kind, count=1)
        for name, kind in zip(POINT.names, (7, 7, 7, 7, 6, 2), strict=True)
    ]
    return TYPES["sensor_msgs/msg/PointCloud2"](
        header=header(begin_ns, "velodyne"),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=POINT.itemsize,
        row_step=points.nbytes,
        data=points.view(np.uint8),
        is_dense=True,
    )


def poses(values: np.ndarray, t_ns: int) -> tuple[object, object]:
    """One state of the OxTS as NavSatFix and Imu: axes forward, left, up; yaw from east to north."""
    lat, lon, height, roll, pitch, yaw = values[:6]
    variance = np.diag(np.full(3, values[23] ** 2)).ravel()
    fix = TYPES["sensor_msgs/msg/NavSatFix"](
        header=header(t_ns, "imu"),
        status=TYPES["sensor_msgs/msg/NavSatStatus"](status=2, service=1),
        latitude=lat,
        longitude=lon,
        altitude=height,
        position_covariance=variance,
        position_covariance_type=2,
    )
    vector, quaternion = TYPES["geometry_msgs/msg/Vector3"], TYPES["geometry_msgs/msg/Quaternion"]
    q = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat()
    unknown = np.zeros(9)
    imu = TYPES["sensor_msgs/msg/Imu"](
        header=header(t_ns, "imu"),
        orientation=quaternion(*q),
        orientation_covariance=np.diag([ROLL_PITCH_RAD**2, ROLL_PITCH_RAD**2, HEADING_RAD**2]).ravel(),
        angular_velocity=vector(*values[17:20]),
        angular_velocity_covariance=unknown,
        linear_acceleration=vector(*values[11:14]),
        linear_acceleration_covariance=unknown,
    )
    return fix, imu


def main(day: Path, target: Path, raised_deg: float = 0.0) -> None:
    """Write the bag of the first drive of a day."""
    drive = min(day.glob("*_drive_*_sync"))
    target.parent.mkdir(parents=True, exist_ok=True)
    target.unlink(missing_ok=True)
    begin_ns, end_ns = (
        stamps_ns(drive / f"velodyne_points/timestamps_{word}.txt") for word in ("start", "end")
    )
    states = [np.loadtxt(file) for file in sorted((drive / "oxts/data").glob("*.txt"))]
    with Writer(target) as bag:
        kinds = {"/gps/fix": "NavSatFix", "/imu/data": "Imu", "/velodyne_points": "PointCloud2"}
        links = {
            kind: bag.add_connection(topic, f"sensor_msgs/msg/{kind}", typestore=STORE)
            for topic, kind in kinds.items()
        }

        def write(t_ns: int, kind: str, message: object) -> None:
            bag.write(links[kind], int(t_ns), STORE.serialize_ros1(message, f"sensor_msgs/msg/{kind}"))

        for t_ns, values in zip(stamps_ns(drive / "oxts/timestamps.txt"), states, strict=True):
            fix, imu = poses(values, t_ns)
            write(t_ns, "NavSatFix", fix)
            write(t_ns, "Imu", imu)
        files = sorted((drive / "velodyne_points/data").glob("*.bin"))
        for file, first_ns, last_ns in zip(files, begin_ns, end_ns, strict=True):
            write(last_ns, "PointCloud2", cloud(file, first_ns, last_ns, np.deg2rad(raised_deg)))


if __name__ == "__main__":
    raised = float(sys.argv[2]) if len(sys.argv) > 2 else 0.0
    main(Path(sys.argv[1]), HERE / ("drive_raised.bag" if raised else "drive.bag"), raised)
