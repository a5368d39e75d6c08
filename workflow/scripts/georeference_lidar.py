"""Lidar packets and trajectory -> cloud in the world frame (LAZ) and the count of what was left out."""

import json
from pathlib import Path
from typing import Any

from thalweg.core.trajectory import Trajectory
from thalweg.ingest.velodyne import LidarClock, LidarOptions
from thalweg.jobs.job import run_job
from thalweg.lidar.cloud import georeference_log
from thalweg.lidar.georeference import Mount


def main(
    *,
    lidar: list[Path],
    clock: Path,
    trajectory: Path,
    points: Path,
    counts: Path,
    lidar_options: dict[str, Any],
    mounts: dict[str, Any],
    georeferencing: dict[str, Any],
) -> None:
    tally = georeference_log(
        lidar,
        LidarOptions(**lidar_options),
        LidarClock.from_dict(json.loads(clock.read_text())),
        Trajectory.read(trajectory),
        Mount.from_section(mounts["lidar"]),
        points,
        min_range_m=georeferencing["min_range_m"],
        max_range_m=georeferencing["max_range_m"],
        laz_scale_m=georeferencing["laz_scale_m"],
        chunk_points=georeferencing["chunk_points"],
    )
    tally.table().to_csv(counts, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
