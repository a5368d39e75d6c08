"""A window of a lidar log: where its points lie (first pass), then its part of the cloud (second pass)."""

from pathlib import Path
from typing import Any

from thalweg.core import Trajectory, read_json
from thalweg.ingest import LidarClock, LidarOptions, LogWindow
from thalweg.ingest.registry import lidar_reader
from thalweg.lidar import LogSettings, georeference_window, write_density
from thalweg.settings.sections import Filters, LidarAccuracy
from thalweg.workflow import run_job


def main(
    *,
    lidar: list[Path],
    clock: Path,
    trajectory: Trajectory,
    mounts: Path,
    error_model: Path,
    densities: list[Path],
    out: list[Path],
    lidar_options: dict[str, Any],
    lidar_accuracy: LidarAccuracy,
    georeferencing: dict[str, Any],
    filters: Filters,
    window: LogWindow,
) -> None:
    timed = LidarClock.from_dict(read_json(clock))
    log = (
        lidar_reader(lidar, LidarOptions(**lidar_options)),
        timed,
        trajectory,
        LogSettings.of_survey(mounts, error_model, timed, lidar_accuracy, filters, georeferencing),
        window,
    )
    if densities:
        georeference_window(*log, densities, *out)
    else:
        write_density(*log, *out)


if "snakemake" in globals():
    run_job(main, snakemake)
