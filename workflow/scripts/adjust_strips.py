"""Lidar log and best trajectory -> trajectory and mount that surfaces seen again have corrected, a page."""

from pathlib import Path
from typing import Any

import numpy as np

from thalweg.calibration import read_mounts, write_mounts
from thalweg.core import Trajectory, read_chains, read_json, read_table
from thalweg.figures.survey import strips_page
from thalweg.ingest import GNSS_POSITION, LidarClock, LidarOptions
from thalweg.ingest.registry import lidar_reader
from thalweg.lidar import LogSettings, adjust_strips, mounts_by_strips, read_stable, thin_log
from thalweg.navigation.ins_gnss import PoseCorrelation
from thalweg.settings.sections import Filters, LidarAccuracy, Strips
from thalweg.workflow import run_job


def main(
    *,
    lidar: list[Path],
    clock: Path,
    trajectory: Path,
    errors: Path,
    stable: list[Path],
    mounts: Path,
    positions: Path,
    error_model: Path,
    mounts_strips: Path,
    facts: Path,
    page: Path,
    lidar_options: dict[str, Any],
    lidar_accuracy: LidarAccuracy,
    georeferencing: dict[str, Any],
    filters: Filters,
    orientation: dict[str, Any],
    strips: Strips,
    crs: str,
    title: str,
    twin: bool,
) -> None:
    poses, timed = Trajectory.read(trajectory), LidarClock.from_dict(read_json(clock))
    sensors = read_mounts(mounts)
    if errors.suffix == ".npz":
        chains = read_chains(errors)
    else:
        own = orientation["position_source"] in ("ins", "sbet")  # positions of the ics origin itself
        lever = np.array([0.0, 0.0, 0.0] if own else sensors["antenna"]["lever_ics_m"])
        epochs = poses.t_gps_s if own else read_table(positions, GNSS_POSITION)[0]["t_gps_s"].to_numpy()
        receiver_s = float(np.median(np.diff(np.unique(epochs))))
        chains = PoseCorrelation.of_survey(errors, receiver_s=receiver_s).chains(poses, lever)
    how = LogSettings.of_survey(mounts, error_model, timed, lidar_accuracy, filters, georeferencing)
    points = thin_log(lidar_reader(lidar, LidarOptions(**lidar_options)), timed, poses, how)
    surfaces, notes = read_stable(stable, poses.frame, crs)
    found = adjust_strips(points, poses, how.mount, chains, strips, surfaces)
    found.write(facts.parent)
    write_mounts(mounts_strips, mounts_by_strips(sensors, found))
    strips_page(found, title=f"Overlapping lidar strips: {title}", twin=twin, notes=notes).write(page)


if "snakemake" in globals():
    run_job(main, snakemake)
