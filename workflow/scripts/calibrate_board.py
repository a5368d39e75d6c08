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
    calibrate_board_poses,
    pose_table,
    read_board_poses,
    read_camera,
    read_observations,
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
    observations: list[Path],
    camera_lidar: Path,
    table: Path,
    campaign: dict[str, Any],
    mounts: dict[str, Any],
    lidar_options: dict[str, Any],
    lidar_accuracy: LidarAccuracy,
    board: dict[str, Any],
    settings: dict[str, Any],
) -> None:
    run = str(campaign["id"])
    if observations:
        seen = read_observations(observations[0])
        found = calibrate_board_poses(*seen)
        n = len(seen[0].middle_m)
        write_calibration(camera_lidar, board_calibration(found.T_ccs_scs, run, observations=n))
        table.write_text(
            "boards,rms_middle_mm,sigma_middle_mm,sigma_normal_deg\n"
            f"{n},{1e3 * found.rms_middle_m:.3f},{1e3 * found.sigma_middle_m:.3f},"
            f"{np.rad2deg(found.sigma_normal_rad):.4f}\n"
        )
        return
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
