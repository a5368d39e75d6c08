"""Image poses, control points and their report -> map of both with residual vectors."""

from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.core.trajectory import Trajectory
from thalweg.figures.images.image_positions import image_positions
from thalweg.figures.style import save
from thalweg.images.control.tables import read_control_points
from thalweg.images.model.control_points import ControlPoints
from thalweg.images.model.poses import ImagePoses
from thalweg.workflow.job import run_job


def main(
    *,
    poses: Path,
    control_points: list[Path],
    report: Path,
    trajectory: Path,
    image_positions_png: Path,
    sigma_m: list[float],
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    images, points = ImagePoses.read(poses), ControlPoints.none()
    if control_points:
        points = read_control_points(control_points[0], images.frame, crs=campaign["crs"], sigma_m=sigma_m)
    figure = image_positions(
        images,
        points,
        pd.read_csv(report, dtype={"point": str}),
        trajectory=Trajectory.read(trajectory),
        title=f"Images and control points: {campaign['title']}",
        twin=twin,
    )
    save(figure, image_positions_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
