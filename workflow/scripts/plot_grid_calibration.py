"""Image, residuals and pairs of a calibration of the light sheet -> figure."""

from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.figures.style import save
from thalweg.lightsheet.figures.grid_calibration import grid_calibration
from thalweg.lightsheet.figures.views import first_image
from thalweg.lightsheet.optics.sensor_files import read_sensor
from thalweg.workflow.job import run_job


def main(
    *, sensor: Path, images: list[Path], line_points: Path, residuals: Path, pairs: Path,
    grid_calibration_png: Path, figures: dict[str, Any], twin: bool, campaign: dict[str, Any],
) -> None:  # fmt: skip
    figure = grid_calibration(
        read_sensor(sensor), first_image(images, line_points)[0], pd.read_csv(residuals), pd.read_csv(pairs),
        title=campaign["title"], twin=twin,
    )  # fmt: skip
    save(figure, grid_calibration_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
