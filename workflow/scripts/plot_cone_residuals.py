"""Lidar points of the cones with their distances -> figure of the unrolled cones."""

from pathlib import Path
from typing import Any

from thalweg.figures.calibration.cone_residuals import cone_residuals
from thalweg.figures.calibration.tables import CONE_POINTS, read_cones, read_figure_table
from thalweg.figures.style import save
from thalweg.workflow.job import run_job


def main(
    *,
    cone_points: Path,
    cones: Path,
    field: Path,
    cone_residuals_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    figure = cone_residuals(
        read_figure_table(cone_points, CONE_POINTS),
        read_cones(cones, field),
        title="Residuals on the cones",
        twin=twin,
    )
    save(figure, cone_residuals_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
