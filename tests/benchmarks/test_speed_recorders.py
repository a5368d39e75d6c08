"""Recorders of small boats beside the library alone that reads their bytes: CPU time, in turns."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from tests.ingest import test_ardupilot, test_ros, test_ubx
from thalweg.ingest import TrackOptions
from thalweg.ingest.recorders import read_ardupilot, read_bag_positions, read_ubx
from thalweg.ingest.registry import lidar_reader

MOST = 1.3
TURNS = 5


def ratio(ours: Callable[[], Any], theirs: Callable[[], Any]) -> tuple[float, float, float]:
    """CPU seconds of ours and theirs, the least of some turns, and their ratio."""
    spent: dict[Callable[[], Any], list[float]] = {ours: [], theirs: []}
    for _ in range(TURNS):
        for each, found in spent.items():
            begin = time.process_time()
            each()
            found.append(time.process_time() - begin)
    return min(spent[ours]), min(spent[theirs]), min(spent[ours]) / min(spent[theirs])


def dataflash_alone(path: Path) -> None:
    from pymavlink.DFReader import DFReader_binary

    log = DFReader_binary(str(path))
    while log.recv_msg() is not None:
        pass
    log.filehandle.close()


def telemetry_alone(path: Path) -> None:
    from pymavlink import mavutil

    log = mavutil.mavlogfile(str(path))
    while (message := log.recv_msg()) is not None:
        message.to_dict()
    log.close()


def ubx_alone(path: Path) -> None:
    from pyubx2 import UBXReader

    with path.open("rb") as stream:
        for _, message in UBXReader(stream):
            vars(message)


def bag_alone(path: Path) -> None:
    with AnyReader([path]) as bag:
        for connection, _, raw in bag.messages():
            bag.deserialize(raw, connection.msgtype)


def clouds_alone(path: Path) -> None:
    """The same points: rosbags hands on bytes alone, of which views are taken and copied."""
    with AnyReader([path]) as bag:
        for connection, _, raw in bag.messages():
            cloud = bag.deserialize(raw, connection.msgtype)
            dtype = np.dtype(
                {
                    "names": [f.name for f in cloud.fields],
                    "formats": [test_ros.FORMAT[f.datatype] for f in cloud.fields],
                    "offsets": [f.offset for f in cloud.fields],
                    "itemsize": cloud.point_step,
                }
            )
            rows = np.frombuffer(cloud.data, dtype)
            xyz = np.stack([-rows["y"], rows["x"], rows["z"]], axis=1)
            far = np.linalg.norm(xyz, axis=1)
            keep = far > 0
            stamp = cloud.header.stamp
            t_s = stamp.sec + stamp.nanosec * 1e-9 + rows["time"].astype(np.float64)
            for column in (xyz, far, t_s, rows["ring"].astype(np.uint8), rows["intensity"].astype(np.uint8)):
                column[keep]


@pytest.mark.slow
def test_recorders_beside_their_libraries(tmp_path, capsys):
    log, told, ubx = (tmp_path / name for name in ("boat.bin", "boat.tlog", "boat.ubx"))
    log.write_bytes(test_ardupilot.heads() + test_ardupilot.boat_log()[len(test_ardupilot.heads()) :] * 20)
    told.write_bytes(test_ardupilot.telemetry() * 100)
    ubx.write_bytes(b"".join(test_ubx.pvt(k) for k in range(5_000)))
    bag = test_ros.Bag(tmp_path / "boat.bag")
    rng = np.random.default_rng(1)
    rows = np.zeros(30_000, test_ros.points("time", "f4", [0, 0, 0]).dtype)
    for axis in "xyz":
        rows[axis] = rng.uniform(1, 50, len(rows))
    rows["time"] = np.linspace(0.0, 0.1, len(rows))
    for k in range(30):
        bag.cloud("/points", test_ros.UNIX_S + 0.1 * k, rows)
    bag.writer.close()
    fixes = test_ros.Bag(tmp_path / "fixes.bag")
    for k in range(20_000):
        fixes.fix(test_ros.UNIX_S + 0.2 * k, k)
    fixes.writer.close()
    clouds = lidar_reader([tmp_path / "boat.bag"])
    stated = TrackOptions()
    found = {
        "ArduPilot dataflash, pymavlink": ratio(
            lambda: read_ardupilot([log], stated), lambda: dataflash_alone(log)
        ),
        "MAVLink telemetry, pymavlink": ratio(
            lambda: read_ardupilot([told], stated), lambda: telemetry_alone(told)
        ),
        "u-blox UBX, pyubx2": ratio(lambda: read_ubx([ubx], stated), lambda: ubx_alone(ubx)),
        "ROS NavSatFix, rosbags": ratio(
            lambda: read_bag_positions([tmp_path / "fixes.bag"], stated),
            lambda: bag_alone(tmp_path / "fixes.bag"),
        ),
        "ROS PointCloud2 scan, rosbags": ratio(clouds.scan, lambda: clouds_alone(tmp_path / "boat.bag")),
        "ROS PointCloud2 points, rosbags": ratio(
            lambda: sum(block.n for block in clouds.points()), lambda: clouds_alone(tmp_path / "boat.bag")
        ),
    }
    with capsys.disabled():
        for name, (ours, theirs, by) in found.items():
            print(f"\n{name:32s} {ours:6.3f} s {theirs:6.3f} s {by:5.2f}", end="")
    slow = {name: by for name, (_, _, by) in found.items() if by > MOST}
    assert not slow
