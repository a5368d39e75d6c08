"""Lidar log, trajectory and cones of a calibration run -> mount of the lidar on the boat."""

import json
import logging
from pathlib import Path
from typing import Any

import numpy as np

from thalweg.calibration import ins_lidar_file as files
from thalweg.calibration.camera_poses import read_poses
from thalweg.calibration.field_description import read_field
from thalweg.calibration.field_facts import read_place
from thalweg.calibration.field_points import read_points
from thalweg.calibration.ins_lidar import START, InsLidarSettings, calibrate
from thalweg.calibration.mounts import read_mounts
from thalweg.calibration.run_points import RunPoints
from thalweg.core.calibration_file import read_calibration
from thalweg.core.trajectory import Trajectory
from thalweg.ingest.velodyne import LidarClock, LidarOptions, iter_points
from thalweg.jobs.job import run_job
from thalweg.lidar.georeference import georeference_points
from thalweg.lidar.mount import Mount


def main(
    *, lidar: list[Path], clock: Path, trajectory: Path, mounts: Path, field: Path, points: Path, facts: Path,
    poses: Path, camera_lidar: Path, ins_lidar: Path, mount: Path, passes: Path, before: Path, after: Path,
    campaign: dict[str, Any], lidar_options: dict[str, Any], settings: dict[str, Any], antenna_position: str,
) -> None:  # fmt: skip
    description, known, place = read_field(field), read_points(points), read_place(facts)
    path, how = Trajectory.read(trajectory), InsLidarSettings.from_section(settings)
    lever = np.asarray(read_mounts(mounts)["antenna"]["lever_ics_m"], dtype=np.float64)
    relative = read_calibration(camera_lidar).pose("camera_lidar")
    antenna = files.field_antenna(description, known, read_poses(poses)[1], antenna_position, relative)
    cones, refused = files.field_cones(description, known, form_sigma_m=how.form_sigma_m)
    stamps = LidarClock.from_dict(json.loads(clock.read_text()))
    start, rows = Mount(R_ics_sensor=START.R, lever_ics_m=START.shift_m), np.zeros((0, 4))
    for block in iter_points(lidar, LidarOptions(**lidar_options), clock=stamps):
        world = georeference_points(block.xyz_scs_m, block.t_gps_s, path, start)
        near = np.flatnonzero(world.has_pose)
        near = near[cones.near(world.points_wcs_m[near], place, how.search.reach_m) >= 0]
        rows = np.concatenate([rows, np.column_stack([block.xyz_scs_m[near], block.t_gps_s[near]])])
    found = calibrate(
        RunPoints.on(path, rows[:, :3], rows[:, 3]), cones, place, how, lever_ics_antenna_m=lever,
        antenna=None if antenna is None else antenna.point,
    )  # fmt: skip
    for name, why in (refused | found.dropped).items():
        logging.getLogger("thalweg").warning("cone %s is left out: %s", name, why)
    files.write_mount_result(mount, found, antenna, lever)
    files.write_tables(found, passes=passes, before=before, after=after)
    files.write_calibrated(ins_lidar, found, str(campaign["id"]))


if "snakemake" in globals():
    run_job(main, snakemake)
