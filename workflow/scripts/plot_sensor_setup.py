"""Calibrated light-sheet sensor -> figure of its set-up and of one measured point."""

from pathlib import Path
from typing import Any

from thalweg.figures.style import save
from thalweg.lightsheet.figures.sensor_setup import sensor_setup
from thalweg.lightsheet.optics.sensor_files import read_sensor
from thalweg.workflow.job import run_job


def main(
    *, sensor: Path, sensor_setup_png: Path, figures: dict[str, Any], twin: bool, campaign: dict[str, Any],
) -> None:  # fmt: skip
    save(sensor_setup(read_sensor(sensor), title=campaign["title"], twin=twin), sensor_setup_png,
         dpi=figures["dpi"])  # fmt: skip


if "snakemake" in globals():
    run_job(main, snakemake)
