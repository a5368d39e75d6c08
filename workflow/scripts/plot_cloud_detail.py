"""Cloud and trajectory -> a detail of the bank by intensity."""

from pathlib import Path
from typing import Any

import numpy as np

from thalweg.core.las.files import iter_laz
from thalweg.core.trajectory import Trajectory
from thalweg.figures.cloud.bank import choose_segment
from thalweg.figures.cloud.overview import cloud_detail
from thalweg.figures.style import save
from thalweg.lidar.cloud import sample_cloud
from thalweg.workflow.job import run_job


def main(
    *,
    points: Path,
    trajectory: Path,
    cloud_detail_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    sample, track = sample_cloud(points, 500_000)["xyz_m"], Trajectory.read(trajectory)
    segment = choose_segment(sample, track, length_m=40.0, background_m=80.0)
    xyz, intensity = [], []
    for chunk in iter_laz(points, 1_000_000):
        inside = segment.contains(chunk["xyz_m"])
        xyz.append(chunk["xyz_m"][inside])
        intensity.append(chunk["intensity"][inside])
    figure = cloud_detail(
        np.concatenate(xyz),
        np.concatenate(intensity),
        segment=segment,
        title=f"Detail of the bank, seen from the water: {campaign['title']}",
        twin=twin,
    )
    save(figure, cloud_detail_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
