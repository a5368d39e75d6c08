"""A calibration file -> figure of its correlation matrix."""

from pathlib import Path
from typing import Any

from thalweg.core.calibration.files import read_calibration
from thalweg.figures.calibration.correlations import correlation_matrix
from thalweg.figures.style import save
from thalweg.workflow.job import run_job


def main(*, calibration: Path, correlations_png: Path, figures: dict[str, Any], twin: bool) -> None:
    save(correlation_matrix(read_calibration(calibration), twin=twin), correlations_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
