"""Trajectory, positions and cloud -> survey map."""

from pathlib import Path
from typing import Any

from thalweg.core.tables import read_table
from thalweg.core.trajectory import Trajectory
from thalweg.figures.style import save
from thalweg.figures.survey.maps import survey_map
from thalweg.ingest.schemas import GNSS_POSITION
from thalweg.lidar.cloud import sample_cloud
from thalweg.workflow.job import run_job


def main(
    *,
    trajectory: Path,
    positions: Path,
    points: Path,
    survey_map_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    figure = survey_map(
        Trajectory.read(trajectory),
        read_table(positions, GNSS_POSITION)[0],
        cloud_en=sample_cloud(points, figures["max_points"])["xyz_m"],
        crs=campaign["crs"],
        title=f"Survey map: {campaign['title']}",
        twin=twin,
    )
    save(figure, survey_map_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
