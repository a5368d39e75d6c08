"""Images by the twin's fifteen-line laser -> pictures and labelled points."""

from pathlib import Path

from thalweg.workflow import run_job
from thalweg_lab.studies.sensors import multi_line_images, write_images


def main(*, images: Path, image_points: Path, seed: int) -> None:
    write_images(list(multi_line_images(seed)), images, image_points)


if "snakemake" in globals():
    run_job(main, snakemake)
