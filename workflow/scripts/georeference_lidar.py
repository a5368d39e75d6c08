"""Lidar packets and trajectory -> cloud in the world frame (LAZ), and what was left out of it and why."""

import json
from pathlib import Path
from typing import Any

from thalweg.calibration.boat.mounts import read_mounts
from thalweg.core.trajectory import Trajectory
from thalweg.ingest.velodyne.reader import LidarClock, LidarOptions
from thalweg.lidar.cloud import LogSettings, georeference_log
from thalweg.lidar.covariance import BeamErrors
from thalweg.lidar.filters import FilterSettings
from thalweg.lidar.mount import Mount
from thalweg.navigation.ins_gnss.error_model import beam_factors
from thalweg.workflow.job import run_job


def main(
    *,
    lidar: list[Path],
    clock: Path,
    trajectory: Path,
    mounts: Path,
    error_model: Path,
    points: Path,
    removed: Path,
    counts: Path,
    lidar_options: dict[str, Any],
    lidar_accuracy: dict[str, Any],
    georeferencing: dict[str, Any],
    filters: dict[str, Any],
) -> None:
    table = georeference_log(
        lidar,
        LidarOptions(**lidar_options),
        LidarClock.from_dict(json.loads(clock.read_text())),
        Trajectory.read(trajectory),
        LogSettings(
            mount=Mount.from_section(read_mounts(mounts)["lidar"]),
            beam=BeamErrors.from_section(lidar_accuracy).scaled(**beam_factors(error_model)),
            filters=FilterSettings.from_section(filters),
            **georeferencing,
        ),
        points,
        out_removed=removed,
    )
    table.to_csv(counts, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
