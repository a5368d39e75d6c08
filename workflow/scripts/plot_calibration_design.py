"""Study of numbers of cones and positions -> figure of the sigmas."""

from pathlib import Path
from typing import Any

from thalweg.figures.calibration.design import calibration_design
from thalweg.figures.calibration.tables import STUDY, read_figure_table
from thalweg.figures.style import save
from thalweg.workflow.job import run_job


def main(*, study: Path, calibration_design_png: Path, figures: dict[str, Any], twin: bool) -> None:
    figure = calibration_design(read_figure_table(study, STUDY), twin=twin)
    save(figure, calibration_design_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
