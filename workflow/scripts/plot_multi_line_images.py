"""Images of a fifteen-line laser and their points -> figure of set-ups and images."""

from pathlib import Path

import pandas as pd

from thalweg.figures.style import save
from thalweg.lightsheet.figures.multi_line_images import multi_line_images_view, read_objects
from thalweg.workflow.job import run_job


def main(*, images: Path, points: Path, multi_line_images_png: Path, dpi: int) -> None:
    figure = multi_line_images_view(read_objects(images), pd.read_csv(points))
    save(figure, multi_line_images_png, dpi=dpi)


if "snakemake" in globals():
    run_job(main, snakemake)
