"""Lidar packets and trajectory -> cloud in the world frame (LAZ), and what was left out of it and why.

Where the log was cut into windows their clouds are joined.
"""

from pathlib import Path
from typing import Any

from thalweg.core import Trajectory, read_json
from thalweg.ingest import LidarClock, LidarOptions
from thalweg.ingest.registry import lidar_reader
from thalweg.lidar import LogSettings, georeference_log, join_windows
from thalweg.settings.sections import Filters, LidarAccuracy
from thalweg.workflow import run_job


def main(
    *,
    lidar: list[Path],
    clock: Path,
    trajectory: Path,
    mounts: Path,
    error_model: Path,
    window_points: list[Path],
    window_rests: list[Path],
    points: Path,
    removed: Path,
    counts: Path,
    lidar_options: dict[str, Any],
    lidar_accuracy: LidarAccuracy,
    georeferencing: dict[str, Any],
    filters: Filters,
) -> None:
    poses, timed = Trajectory.read(trajectory), LidarClock.from_dict(read_json(clock))
    how = LogSettings.of_survey(mounts, error_model, timed, lidar_accuracy, filters, georeferencing)
    if window_points:
        table = join_windows(
            window_points, window_rests, poses, how, points, out_removed=removed, log_files=lidar
        )
    else:
        table = georeference_log(
            lidar_reader(lidar, LidarOptions(**lidar_options)), timed, poses, how, points, out_removed=removed
        )
    table.to_csv(counts, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
