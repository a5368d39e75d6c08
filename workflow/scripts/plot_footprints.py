"""Cloud and trajectory -> one revolution of the lidar and its footprints on the bank."""

from pathlib import Path
from typing import Any

import numpy as np

from thalweg.calibration.boat.mounts import read_mounts
from thalweg.core.las.files import iter_laz
from thalweg.core.trajectory import Trajectory
from thalweg.figures.cloud.footprints import REVOLUTION_S, best_moment, footprints, scanner_positions
from thalweg.figures.style import save
from thalweg.lidar.cloud import sample_cloud
from thalweg.workflow.job import run_job


def main(
    *,
    points: Path,
    trajectory: Path,
    mounts: Path,
    footprints_png: Path,
    lidar_accuracy: dict[str, Any],
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    sample, track = sample_cloud(points, 2_000_000), Trajectory.read(trajectory)
    lever_m = read_mounts(mounts)["lidar"]["lever_ics_m"]
    start = best_moment(sample["xyz_m"], sample["t_gps_s"], sample["range"], track, lever_m)
    xyz_m, t_gps_s = [], []
    for chunk in iter_laz(points, 1_000_000):
        turn = (chunk["t_gps_s"] >= start) & (chunk["t_gps_s"] < start + REVOLUTION_S)
        xyz_m.append(chunk["xyz_m"][turn])
        t_gps_s.append(chunk["t_gps_s"][turn])
    scanner_m, has_pose = scanner_positions(np.concatenate(t_gps_s), track, lever_m)
    figure = footprints(
        np.concatenate(xyz_m)[has_pose],
        scanner_m[has_pose],
        divergence_mrad=lidar_accuracy["divergence_mrad"],
        title=f"Footprints of the mobile lidar: {campaign['title']}",
        twin=twin,
    )
    save(figure, footprints_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
