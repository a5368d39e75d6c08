"""Points on a panel in known depths -> figure of their distances, beside published ones."""

from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.core.tables import read_parquet
from thalweg.figures.light_sheet_views import find_image
from thalweg.figures.panel_distances import first_with_points, panel_distances
from thalweg.figures.style import save
from thalweg.jobs.job import run_job
from thalweg.triangulation.sensor_files import read_sensor


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
