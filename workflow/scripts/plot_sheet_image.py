"""Images of a scan and their line points -> figure of the middle image with its line."""

from pathlib import Path
from typing import Any

from thalweg.core.tables import read_table
from thalweg.figures.style import save
from thalweg.lightsheet.figures.sheet_image import sheet_image
from thalweg.lightsheet.figures.views import find_image
from thalweg.lightsheet.poses.series import SERIES_POINTS
from thalweg.workflow.job import run_job


def main(
    *, images: list[Path], line_points: Path, sheet_image_png: Path, figures: dict[str, Any], twin: bool,
    campaign: dict[str, Any], scanned: str,
) -> None:  # fmt: skip
    points, _ = read_table(line_points, SERIES_POINTS)
    names = points["file"].unique()
    name = str(names[len(names) // 2])
    title = f"{campaign['title']}, {scanned}"
    figure = sheet_image(find_image(images, name), points[points["file"] == name], title=title, twin=twin)
    save(figure, sheet_image_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
