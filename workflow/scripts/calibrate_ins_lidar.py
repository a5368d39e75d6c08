"""Lidar log, trajectory and cones of a calibration run -> mount of the lidar on the boat."""

import logging
from pathlib import Path
from typing import Any

import numpy as np

from thalweg.calibration import read_mounts
from thalweg.calibration.field import read_field, read_place, read_points
from thalweg.calibration.ins_lidar import START, InsLidarSettings, NearCones, calibrate, file as files
from thalweg.core import Rigid, Trajectory, read_json
from thalweg.ingest import LidarClock, LidarOptions
from thalweg.ingest.registry import lidar_reader
from thalweg.lidar import georeference_points
from thalweg.workflow import run_job

log = logging.getLogger("thalweg")


def main(
    *,
    lidar: list[Path],
    clock: Path,
    trajectory: Path,
    mounts: Path,
    field: Path,
    points: Path,
    facts: Path,
    poses: list[Path],
    camera_lidar: list[Path],
    ins_lidar: Path,
    mount: Path,
    passes: Path,
    before: Path,
    after: Path,
    run: str,
    lidar_options: dict[str, Any],
    settings: dict[str, Any],
    antenna_position: str,
) -> None:
    description, known, place = read_field(field), read_points(points), read_place(facts)
    path, how = Trajectory.read(trajectory), InsLidarSettings.from_section(settings)
    nominal = read_mounts(mounts)
    lever = np.asarray(nominal["antenna"]["lever_ics_m"], dtype=np.float64)
    antenna = files.seen_antenna(description, known, nominal, poses, camera_lidar, antenna_position)
    if antenna is None and description.antenna is not None:
        log.warning(files.BLIND, description.antenna.marker)
    cones, refused = files.field_cones(description, known, form_sigma_m=how.form_sigma_m)
    stamps = LidarClock.from_dict(read_json(clock))
    start = Rigid(R=START.R, shift_m=START.shift_m)
    near = NearCones(trajectory=path, cones=cones, T_wcs_pcs=place, reach_m=how.search.reach_m)
    for block in lidar_reader(lidar, LidarOptions(**lidar_options)).points(stamps):
        world = georeference_points(block.xyz_scs_m, block.t_gps_s, path, start)
        near.add(block.xyz_scs_m, block.t_gps_s, world.points_wcs_m, world.has_pose)
    found = calibrate(
        near.points(),
        cones,
        place,
        how,
        lever_ics_antenna_m=lever,
        antenna=None if antenna is None else antenna.point,
    )
    for name, why in (refused | found.dropped).items():
        log.warning("cone %s is left out: %s", name, why)
    files.write_mount_result(mount, found, antenna, lever)
    files.write_tables(found, passes=passes, before=before, after=after)
    files.write_calibrated(ins_lidar, found, run)


if "snakemake" in globals():
    run_job(main, snakemake)
