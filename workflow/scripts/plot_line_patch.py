"""An image of the laser line on a panel -> figure of the matching of one place."""

from pathlib import Path
from typing import Any

from thalweg.figures.style import save
from thalweg.lightsheet.figures.line_measurement import measured
from thalweg.lightsheet.figures.line_patch import line_patch
from thalweg.lightsheet.figures.views import first_image
from thalweg.workflow.job import run_job


def main(
    *, images: list[Path], line_points: Path, line_patch_png: Path, figures: dict[str, Any], twin: bool,
    campaign: dict[str, Any],
) -> None:  # fmt: skip
    image, _ = first_image(images, line_points)
    figure = line_patch(image, measured(image, ["lsm"])["lsm"], title=campaign["title"], twin=twin)
    save(figure, line_patch_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
