"""Lidar log and stated trajectory -> error model of the poses, and the trajectory with its sigmas."""

import json
from pathlib import Path
from typing import Any

from thalweg.calibration import read_mounts
from thalweg.core import Rigid, Trajectory, read_table
from thalweg.ingest import GNSS_POSITION, LidarClock, LidarOptions
from thalweg.ingest.registry import lidar_reader
from thalweg.lidar import LogSettings, error_model_of_log
from thalweg.settings.sections import Filters, LidarAccuracy
from thalweg.workflow import run_job


def main(
    *,
    lidar: list[Path],
    clock: Path,
    stated: Path,
    positions: Path,
    mounts: Path,
    trajectory: Path,
    error_model: Path,
    lidar_options: dict[str, Any],
    lidar_accuracy: LidarAccuracy,
    georeferencing: dict[str, Any],
    filters: Filters,
    orientation: dict[str, Any],
) -> None:
    sensors = read_mounts(mounts)
    own = orientation["position_source"] in ("ins", "sbet")  # positions of the ics origin itself
    lever = [0.0, 0.0, 0.0] if own else sensors["antenna"]["lever_ics_m"]
    poses = Trajectory.read(stated)
    model = error_model_of_log(
        lidar_reader(lidar, LidarOptions(**lidar_options)),
        LidarClock.from_dict(json.loads(clock.read_text())),
        poses,
        LogSettings(
            mount=Rigid.from_mount(sensors["lidar"]), beam=lidar_accuracy, filters=filters, **georeferencing
        ),
        positions_t_gps_s=None if own else read_table(positions, GNSS_POSITION)[0]["t_gps_s"].to_numpy(),
        lever_ics_antenna_m=lever,
        settings=orientation["error_model"],
    )
    model.write(error_model)
    model.apply(poses, lever).write(trajectory)


if "snakemake" in globals():
    run_job(main, snakemake)
