"""Cloud, removed points and their counts -> what each filter left out."""

from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.core.tables import read_table
from thalweg.core.trajectory import Trajectory
from thalweg.figures.cloud.removed import removed_points
from thalweg.figures.style import save
from thalweg.lidar.cloud import sample_cloud
from thalweg.lidar.removed import REMOVED_POINTS
from thalweg.workflow.job import run_job

MOST_KEPT = 200_000
"""Points of the cloud that show a small picture where the banks are."""


def main(
    *,
    points: Path,
    removed: Path,
    counts: Path,
    trajectory: Path,
    removed_points_png: Path,
    filters: dict[str, Any],
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    figure = removed_points(
        read_table(removed, REMOVED_POINTS)[0],
        pd.read_csv(counts),
        sample_cloud(points, min(MOST_KEPT, figures["max_points"]))["xyz_m"],
        Trajectory.read(trajectory),
        filters=filters,
        title=f"Points left out of the cloud: {campaign['title']}",
        twin=twin,
    )
    save(figure, removed_points_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
