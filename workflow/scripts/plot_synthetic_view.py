"""Picture of the field with heights, and a coarse lidar frame -> figure of both."""

from pathlib import Path
from typing import Any

from thalweg.figures.calibration.synthetic_view import read_height_view, synthetic_view
from thalweg.figures.calibration.tables import LIDAR_FRAME, read_figure_table
from thalweg.figures.style import save
from thalweg.workflow.job import run_job


def main(
    *,
    view: Path,
    lidar_frame: Path,
    synthetic_view_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    figure = synthetic_view(
        read_height_view(view),
        read_figure_table(lidar_frame, LIDAR_FRAME),
        title=f"{campaign['title']}: synthetic image and lidar frame",
        twin=twin,
    )
    save(figure, synthetic_view_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
