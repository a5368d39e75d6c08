"""Lidar packets and trajectory -> cloud in the world frame (LAZ), and what was left out of it and why."""

import json
from pathlib import Path
from typing import Any

from thalweg.calibration import read_mounts
from thalweg.core import Rigid, Trajectory
from thalweg.ingest import LidarClock, LidarOptions
from thalweg.ingest.registry import lidar_reader
from thalweg.lidar import LogSettings, georeference_log
from thalweg.navigation.ins_gnss import beam_factors
from thalweg.settings.sections import Filters, LidarAccuracy
from thalweg.workflow import run_job


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
    lidar_accuracy: LidarAccuracy,
    georeferencing: dict[str, Any],
    filters: Filters,
) -> None:
    timed = LidarClock.from_dict(json.loads(clock.read_text()))
    table = georeference_log(
        lidar_reader(lidar, LidarOptions(**lidar_options)),
        timed,
        Trajectory.read(trajectory),
        LogSettings(
            mount=Rigid.from_mount(read_mounts(mounts)["lidar"]),
            beam=lidar_accuracy.scaled(**beam_factors(error_model)).with_clock(timed.sigma_s),
            filters=filters,
            **georeferencing,
        ),
        points,
        out_removed=removed,
    )
    table.to_csv(counts, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
