"""An image of the stepped object and its line points -> figure of their flags."""

from pathlib import Path
from typing import Any

from thalweg.figures.style import save
from thalweg.lightsheet.figures.line_on_markers import line_on_markers
from thalweg.lightsheet.figures.views import first_image
from thalweg.workflow.job import run_job


def main(
    *, images: list[Path], line_points: Path, line_on_markers_png: Path, figures: dict[str, Any], twin: bool,
    campaign: dict[str, Any],
) -> None:  # fmt: skip
    image, points = first_image(images, line_points)
    figure = line_on_markers(image, points, title=campaign["title"], twin=twin)
    save(figure, line_on_markers_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
