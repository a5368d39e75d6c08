"""Lidar log and stated trajectory -> error model of the poses, and the trajectory with its sigmas."""

from pathlib import Path
from typing import Any

import numpy as np

from thalweg.calibration import read_mounts
from thalweg.core import Rigid, Trajectory, read_json, read_table
from thalweg.ingest import GNSS_POSITION, LidarClock, LidarOptions
from thalweg.ingest.registry import lidar_reader
from thalweg.lidar import LogSettings, error_model_of_log
from thalweg.navigation.ins_gnss import ErrorModel, PriorErrors
from thalweg.settings.sections import Filters, LidarAccuracy
from thalweg.workflow import run_job


def main(
    *,
    lidar: list[Path],
    clock: list[Path],
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
    poses = Trajectory.read(stated)
    own = orientation["position_source"] in ("ins", "sbet")  # positions of the ics origin itself
    lever = np.array([0.0, 0.0, 0.0] if own else sensors["antenna"]["lever_ics_m"])
    if lidar:
        timed = LidarClock.from_dict(read_json(clock[0]))
        model = error_model_of_log(
            lidar_reader(lidar, LidarOptions(**lidar_options)),
            timed,
            poses,
            LogSettings(
                mount=Rigid.from_mount(sensors["lidar"]),
                beam=lidar_accuracy.with_clock(timed.sigma_s),
                filters=filters,
                **georeferencing,
            ),
            positions_t_gps_s=None if own else read_table(positions, GNSS_POSITION)[0]["t_gps_s"].to_numpy(),
            lever_ics_antenna_m=lever,
            settings=orientation["error_model"],
        )
    else:
        prior = PriorErrors.of_survey(poses, lever, orientation["error_model"])
        note = "no lidar, so that nothing says how large the errors are: what is stated, with its width"
        model = ErrorModel.of_prior(prior, note=note)
    model.write(error_model)
    model.apply(poses, lever).write(trajectory)


if "snakemake" in globals():
    run_job(main, snakemake)
