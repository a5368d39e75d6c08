"""Lidar points of the cones before and after the calibration -> figure of one cone."""

from pathlib import Path
from typing import Any

from thalweg.figures.calibration.cone_before_after import cone_before_after
from thalweg.figures.calibration.tables import CONE_POINTS, read_cones, read_figure_table
from thalweg.figures.style import save
from thalweg.workflow.job import run_job


def main(
    *,
    before: Path,
    after: Path,
    cones: Path,
    field: Path,
    cone_before_after_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    figure = cone_before_after(
        read_figure_table(before, (*CONE_POINTS, "t_gps_s")),
        read_figure_table(after, (*CONE_POINTS, "t_gps_s")),
        read_cones(cones, field),
        title="Lidar points of a cone from the moving boat",
        twin=twin,
    )
    save(figure, cone_before_after_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
