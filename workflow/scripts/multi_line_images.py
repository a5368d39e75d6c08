"""Images of the twin's fifteen-line laser -> pictures and meshes, and the measured points with labels."""

from pathlib import Path

from thalweg.workflow import run_job
from thalweg_lab.studies import multi_line_images, write_images


def main(*, images: Path, points: Path, seed: int) -> None:
    write_images(list(multi_line_images(seed)), images, points)


if "snakemake" in globals():
    run_job(main, snakemake)
