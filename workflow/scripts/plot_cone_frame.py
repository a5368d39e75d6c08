"""Sketch of a cone's coordinate system."""

from pathlib import Path
from typing import Any

from thalweg.figures.calibration.cone_frame import cone_frame
from thalweg.figures.style import save
from thalweg.workflow.job import run_job


def main(*, cone_frame_png: Path, figures: dict[str, Any]) -> None:
    save(cone_frame(), cone_frame_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
