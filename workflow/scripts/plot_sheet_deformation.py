"""Picture of how refraction bends a light sheet."""

from pathlib import Path
from typing import Any

from thalweg.figures.style import save
from thalweg.lightsheet.figures.sheet_deformation import sheet_deformation
from thalweg.workflow.job import run_job


def main(*, sheet_deformation_png: Path, figures: dict[str, Any]) -> None:
    save(sheet_deformation(), sheet_deformation_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
