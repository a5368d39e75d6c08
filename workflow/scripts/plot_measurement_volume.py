"""A light-sheet sensor -> figure of what it can measure."""

from pathlib import Path
from typing import Any

from thalweg.figures.style import save
from thalweg.lightsheet.figures.measurement_volume import measurement_volume_view
from thalweg.lightsheet.optics.sensor_files import read_sensor
from thalweg.workflow.job import run_job


def main(
    *,
    sensor: Path,
    measurement_volume_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    figure = measurement_volume_view(read_sensor(sensor), title=campaign["title"], twin=twin)
    save(figure, measurement_volume_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
