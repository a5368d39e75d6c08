"""Points on a panel in known depths -> figure of their distances, beside published ones."""

from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.core.tables import read_parquet
from thalweg.figures.style import save
from thalweg.lightsheet.figures.panel_distances import first_with_points, panel_distances
from thalweg.lightsheet.figures.views import find_image
from thalweg.lightsheet.optics.sensor_files import read_sensor
from thalweg.workflow.job import run_job


def main(
    *, sensor: Path, images: list[Path], points: Path, panels: Path, panel_distances_png: Path,
    figures: dict[str, Any], twin: bool, campaign: dict[str, Any],
) -> None:  # fmt: skip
    rows = pd.read_csv(panels)
    image = find_image(images, str(first_with_points(rows)["file"]))
    figure = panel_distances(
        read_sensor(sensor), image, read_parquet(points), rows, title=campaign["title"], twin=twin
    )
    save(figure, panel_distances_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
