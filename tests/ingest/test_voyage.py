"""A drive of KITTI as a bag: made up, one revolution with known times and lasers; and the real one."""

import os
import runpy
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from thalweg.core import gps_from_unix
from thalweg.ingest import TrackOptions
from thalweg.ingest.recorders import read_bag_poses
from thalweg.ingest.registry import lidar_reader

SCRIPT = "config/campaigns/voyage/kitti.py"
BEGIN_UNIX_S = 1_317_042_651.0
"""2011-09-26T13:10:51Z, by `date -u -d`."""


def stamp(second: float) -> str:
    return f"2011-09-26 13:10:{second:012.9f}\n"


@pytest.fixture
def day(tmp_path):
    """Two lasers, each counterclockwise from the front; two states of a car that heads north."""
    drive = tmp_path / "2011_09_26/2011_09_26_drive_0099_sync"
    for folder in ("oxts/data", "velodyne_points/data"):
        (drive / folder).mkdir(parents=True)
    turn = np.deg2rad([10.0, 90.0, -20.0] * 2)
    points = np.column_stack([10 * np.cos(turn), 10 * np.sin(turn), np.zeros(6), np.full(6, 0.5)])
    points.astype("<f4").tofile(drive / "velodyne_points/data/0000000000.bin")
    (drive / "velodyne_points/timestamps_start.txt").write_text(stamp(51.0))
    (drive / "velodyne_points/timestamps_end.txt").write_text(stamp(51.1))
    (drive / "oxts/timestamps.txt").write_text(stamp(51.0) + stamp(51.1))
    state = np.zeros(30)
    state[[0, 1, 2, 3, 4, 5, 23]] = 49.0, 8.4, 115.0, 0.01, -0.02, np.pi / 2, 0.2
    for k in range(2):
        np.savetxt(drive / f"oxts/data/{k:010d}.txt", state[None])
    return drive.parent


def test_points_have_the_time_and_the_laser_of_their_direction(day, repository, tmp_path):
    bag = tmp_path / "data/drive.bag"
    runpy.run_path(str(repository / SCRIPT))["main"](day, bag)
    reader = lidar_reader([bag])
    block = next(iter(reader.points(reader.scan().clock)))
    share = np.array([190.0, 270.0, 160.0] * 2) / 360.0
    assert_allclose(block.t_device_s - BEGIN_UNIX_S, 0.1 * share, atol=1e-6)
    assert_array_equal(block.ring, [0, 0, 0, 1, 1, 1])
    assert_allclose(block.xyz_scs_m[1], [-10.0, 0.0, 0.0], atol=1e-5)  # left of scs is -x
    poses = read_bag_poses([bag], TrackOptions()).states
    assert_allclose(poses["t_gps_s"], gps_from_unix(BEGIN_UNIX_S) + np.array([0.0, 0.1]), atol=1e-6)
    assert_allclose(np.mod(poses["heading_rad"] + 1.0, 2 * np.pi), 1.0, atol=1e-9)
    assert_allclose(poses["roll_rad"], 0.01, atol=1e-9)  # left side up is right side down
    assert_allclose(poses["pitch_rad"], 0.02, atol=1e-9)  # front down is nose down
    assert_allclose(poses["sigma_up_m"], 0.2, atol=1e-9)


def test_raised_beams_look_higher_at_the_same_range(day, repository, tmp_path):
    bag = tmp_path / "data/raised.bag"
    runpy.run_path(str(repository / SCRIPT))["main"](day, bag, 0.205)
    reader = lidar_reader([bag])
    block = next(iter(reader.points(reader.scan().clock)))
    assert_allclose(block.range_m, 10.0, atol=1e-5)
    assert_allclose(block.xyz_scs_m[:, 2], 10.0 * np.sin(np.deg2rad(0.205)), atol=1e-5)


@pytest.mark.real
@pytest.mark.skipif("THALWEG_VOYAGE" not in os.environ, reason="THALWEG_VOYAGE names no folder 2011_09_26")
def test_the_drive_has_the_points_that_the_page_says(repository, tmp_path):
    bag = tmp_path / "drive.bag"
    runpy.run_path(str(repository / SCRIPT))["main"](Path(os.environ["THALWEG_VOYAGE"]), bag)
    scan = lidar_reader([bag]).scan()
    assert scan.report.counts["clouds"] == 144
    assert scan.n_points == 17_347_579
    assert max(block.ring.max() for block in lidar_reader([bag]).points()) == 63
    assert len(read_bag_poses([bag], TrackOptions()).states) == 144
