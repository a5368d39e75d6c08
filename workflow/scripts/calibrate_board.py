"""Poses of a checkerboard before camera and lidar -> relative orientation of both."""

import logging
from pathlib import Path
from typing import Any

import numpy as np

from thalweg.calibration import (
    BoardSettings,
    Checkerboard,
    board_calibration,
    calibrate_board,
    pose_table,
    read_board_poses,
    read_camera,
)
from thalweg.calibration.camera_lidar import nominal_orientation
from thalweg.core.calibration import write_calibration
from thalweg.ingest import LidarOptions
from thalweg.settings.sections import LidarAccuracy
from thalweg.workflow import run_job


def main(
    *,
    images: list[Path],
    scans: list[Path],
    camera: list[Path],
    camera_lidar: Path,
    table: Path,
    run: str,
    mounts: dict[str, Any],
    lidar_options: dict[str, Any],
    lidar_accuracy: LidarAccuracy,
    board: dict[str, Any],
    settings: dict[str, Any],
) -> None:
    run = run
    options = LidarOptions(**lidar_options)
    poses, lost = read_board_poses(images, scans, Checkerboard(**board), read_camera(camera[0]), options)
    result = calibrate_board(poses, nominal_orientation(mounts), lidar_accuracy, BoardSettings(**settings))
    rows = pose_table(result, lost)
    for line in rows[~rows["used"].astype(bool)].itertuples():
        logging.getLogger("thalweg").warning("%s: %s", line.pose, line.reason)
    points, sigma0 = int(result.table["points"].sum()), float(np.sqrt(result.adjusted.sigma0_squared))
    write_calibration(
        camera_lidar, board_calibration(result.T_ccs_scs, run, observations=points, sigma0=sigma0)
    )
    rows.to_csv(table, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
